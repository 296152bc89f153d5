//! Decides whether two logs are of the same run.
//!
//! A pair is one exchange if the second frame answers the first. Then both cards' clocks measured the same pause since
//! the last exchange, except for the jitter of the turn-around. In two logs of different runs, paired by numbers that
//! both count from 1, the pauses are unrelated. The correlation of the pauses (each side's deviations from its median)
//! is 1 for one run and 0 +- `1 / sqrt(n)` for two, whatever the clocks' offset, drift and rate.
//!
//! A very regular initiator leaves nothing to correlate; then the pairs' clock difference must be steady by itself.

use crate::maths::upper_median;

/// Deviations of pauses are clipped to this many median deviations: lost frames and stalls of an operating system.
const CLIP: f64 = 5.0;
/// Fewest pauses that decide.
const LEAST: usize = 24;

/// How the pauses of two logs correlate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kinship {
    /// Correlation of the pauses, -1 to 1.
    pub correlation: f64,
    /// Median deviation of the receiver's pauses from their median, microseconds.
    pub pause_us: f64,
    /// Pauses compared.
    pub pauses: usize,
}

/// Compares the pauses between pairs on both cards' clocks: `clock_rx_us` is the receiver's, `difference_us` the
/// transmitter's less the receiver's, both unwrapped, one entry a pair. `None` with fewer than 24 ordinary pauses.
#[must_use]
pub fn kinship(clock_rx_us: &[i64], difference_us: &[i64]) -> Option<Kinship> {
    let step = |values: &[i64]| values.windows(2).map(|w| (w[1] - w[0]) as f64).collect::<Vec<f64>>();
    let receiver = step(clock_rx_us);
    let transmitter: Vec<f64> = receiver.iter().zip(step(difference_us)).map(|(pause, more)| pause + more).collect();
    let usual = [upper_median(&mut receiver.clone())?, upper_median(&mut transmitter.clone())?];
    // Lost frames make longer pauses on both sides, in any two logs.
    let ordinary = |pause: f64, side: usize| pause > 0.5 * usual[side] && pause < 1.5 * usual[side];
    let both: Vec<(f64, f64)> =
        receiver.into_iter().zip(transmitter).filter(|(r, t)| ordinary(*r, 0) && ordinary(*t, 1)).collect();
    if both.len() < LEAST {
        return None;
    }
    let (r, pause_us) = clipped(both.iter().map(|pair| pair.0).collect())?;
    let (t, _) = clipped(both.iter().map(|pair| pair.1).collect())?;
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let norm = (dot(&r, &r) * dot(&t, &t)).sqrt();
    let correlation = if norm > 0.0 { dot(&r, &t) / norm } else { 0.0 };
    Some(Kinship { correlation, pause_us, pauses: both.len() })
}

/// Deviations from the median, clipped, their mean removed, and their median size.
fn clipped(values: Vec<f64>) -> Option<(Vec<f64>, f64)> {
    let middle = upper_median(&mut values.clone())?;
    let usual = upper_median(&mut values.iter().map(|v| (v - middle).abs()).collect::<Vec<_>>())?;
    let limit = CLIP * usual.max(1.0);
    let mut off: Vec<f64> = values.iter().map(|v| (v - middle).clamp(-limit, limit)).collect();
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    off.iter_mut().for_each(|v| *v -= mean);
    Some((off, usual))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pauses of 10 ms with a jitter of `jitter_us`, as a card's clock shows their ends.
    fn ends(seed: u64, jitter_us: i64) -> Vec<i64> {
        let mut state = seed;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as i64
        };
        (0..600).map(|k| 10_000 * k + if jitter_us > 0 { random() % jitter_us } else { 0 }).collect()
    }

    fn of(rx: &[i64], tx: &[i64]) -> Kinship {
        let difference: Vec<i64> = rx.iter().zip(tx).map(|(rx, tx)| tx - rx).collect();
        kinship(rx, &difference).unwrap()
    }

    #[test]
    fn the_pauses_of_an_exchange_go_together_whatever_the_clocks() {
        let rx = ends(1, 200);
        let turn_around = ends(2, 30);
        // Another zero, 20 ppm of drift, a turn-around that jitters, every fiftieth frame lost.
        let tx: Vec<i64> = rx
            .iter()
            .zip(&turn_around)
            .enumerate()
            .map(|(k, (r, t))| r - t % 10_000 + 7_000_000 + r / 50_000 + k as i64 % 2)
            .collect();
        let keep = |v: &[i64]| v.iter().enumerate().filter(|(k, _)| k % 50 != 7).map(|(_, v)| *v).collect::<Vec<_>>();
        let found = of(&keep(&rx), &keep(&tx));
        // 588 of 600 frames, without the pauses over lost ones.
        assert!(found.correlation > 0.9 && found.pauses == 587 - 12, "{found:?}");
    }

    #[test]
    fn the_pauses_of_two_runs_do_not() {
        let found = of(&ends(1, 200), &ends(9, 200));
        assert!(found.correlation.abs() < 0.2, "{found:?}");
        // Two runs at two rates.
        let slower: Vec<i64> = ends(9, 200).iter().map(|end| 2 * end).collect();
        assert!(of(&ends(1, 200), &slower).correlation.abs() < 0.2);
        let regular = of(&ends(1, 0), &ends(1, 0));
        assert_eq!((regular.correlation, regular.pause_us), (0.0, 0.0));
        let few = |records: usize| kinship(&ends(1, 5)[..records], &vec![0; records]).map(|found| found.pauses);
        assert_eq!([few(20), few(24), few(25)], [None, None, Some(24)]);
    }

    #[test]
    fn a_pause_far_from_the_others_counts_no_more_than_five_usual_ones() {
        // The median is 1,000, the median deviation 10.
        let values = vec![980.0, 990.0, 990.0, 1_000.0, 1_010.0, 1_010.0, 5_000.0];
        let (off, usual) = clipped(values).unwrap();
        let clipped_off = [-20.0, -10.0, -10.0, 0.0, 10.0, 10.0, 50.0];
        let mean = 30.0 / 7.0;
        assert_eq!(usual, 10.0);
        assert!(off.iter().zip(clipped_off).all(|(off, is)| (off - (is - mean)).abs() < 1e-9), "{off:?}");
        // Pauses that are all equal, in whole microseconds.
        let (off, usual) = clipped(vec![7.0, 7.0, 7.0, 90.0]).unwrap();
        assert_eq!((usual, off), (0.0, vec![-1.25, -1.25, -1.25, 3.75]));
    }

    #[test]
    fn a_pause_of_half_as_much_again_is_over_a_lost_frame() {
        let at = |long: i64| (0..200).map(|k| 10_000 * k + long * (k / 10)).collect::<Vec<i64>>();
        let pauses = |rx: &[i64], tx: &[i64]| of(rx, tx).pauses;
        let (short, long) = (at(4_999), at(5_000));
        assert_eq!(pauses(&short, &short), 199);
        assert_eq!([pauses(&long, &long), pauses(&long, &short), pauses(&short, &long)], [199 - 19; 3]);
        // One of half the length is not this initiator's.
        let (half, more) = (at(-5_000), at(-4_999));
        assert_eq!([pauses(&half, &half), pauses(&half, &more), pauses(&more, &more)], [199 - 19, 199 - 19, 199]);
    }
}
