//! Decides whether two logs are of the same run: by the pauses of their exchanges and by the shape of their channel.
//!
//! A pair is one exchange if the second frame answers the first. Then both cards' clocks measured the same pause since
//! the last exchange, except for the jitter of the turn-around. In two logs of different runs, paired by numbers that
//! both count from 1, the pauses are unrelated. The correlation of the pauses (each side's deviations from its median)
//! is 1 for one run and 0 +- `1 / sqrt(n)` for two, whatever the clocks' offset, drift and rate.
//!
//! A very regular initiator leaves nothing to correlate; then the pairs' clock difference must be steady by itself.
//!
//! Both logs also heard one channel: its shape over the subcarriers is the same in both directions. The magnitudes of a packet in
//! decibels less their mean over the subcarriers do not depend on gains. While robots move the shape changes; in the two directions of
//! one link it changes alike (correlation 0.91 to 0.99 on 70 real links), in two logs of different runs it does not (-0.16 to 0.21 on
//! 30 pairs of real logs).

use crate::maths::upper_median;
use crate::signal::channel::SUBCARRIERS;
use num_complex::Complex32;

/// Deviations of pauses are clipped to this many median deviations: lost frames and stalls of an operating system.
const CLIP: f64 = 5.0;
/// Fewest pauses, or pairs, that decide.
pub(crate) const LEAST: usize = 24;

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

/// Magnitudes below this count as this: less than one step of the card's numbers.
const SMALLEST: f32 = 0.5;

type Shape = [f64; SUBCARRIERS];

/// Sums over the pairs of one subcarrier, forward and backward: values, squares, product, products with the pair before.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    one: [f64; 2],
    square: [f64; 2],
    product: f64,
    before: [f64; 2],
}

/// Sums over the pairs of a link, from which the shapes' correlation follows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Reciprocity {
    pairs: f64,
    sums: [Sums; SUBCARRIERS],
    last: Option<[Shape; 2]>,
}

/// What the sums say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reciprocal {
    /// Correlation of the two directions' changes of shape, -1 to 1.
    pub correlation: f64,
    /// The lower of the two directions' correlations from one pair to the next: near 0 where the shape changes by noise alone.
    pub steadiness: f64,
}

impl Reciprocity {
    /// Takes the two frames of a pair.
    pub fn add(&mut self, forward: &[Complex32; SUBCARRIERS], backward: &[Complex32; SUBCARRIERS]) {
        let now = [shape(forward), shape(backward)];
        self.pairs += 1.0;
        for (k, sums) in self.sums.iter_mut().enumerate() {
            sums.product += now[0][k] * now[1][k];
            for (side, own) in now.iter().enumerate() {
                sums.one[side] += own[k];
                sums.square[side] += own[k] * own[k];
                sums.before[side] += self.last.map_or(own[k], |last| last[side][k]) * own[k];
            }
        }
        self.last = Some(now);
    }

    /// The correlations; none with too few pairs, or where a side's shape never changes.
    pub fn get(&self) -> Option<Reciprocal> {
        let n = self.pairs;
        let mean = |a: f64, b: f64| a * b / (n * n);
        let sum = |of: &dyn Fn(&Sums) -> f64| self.sums.iter().map(of).sum::<f64>();
        let square = [0, 1].map(|side| sum(&|s| s.square[side] / n - mean(s.one[side], s.one[side])));
        let before = [0, 1].map(|side| sum(&|s| s.before[side] / n - mean(s.one[side], s.one[side])));
        let product = sum(&|s| s.product / n - mean(s.one[0], s.one[1]));
        let norm = (square[0] * square[1]).sqrt();
        (n >= LEAST as f64 && norm > 1e-12).then(|| Reciprocal {
            correlation: product / norm,
            steadiness: (before[0] / square[0]).min(before[1] / square[1]),
        })
    }
}

/// Logarithms of the magnitudes less their mean.
fn shape(csi: &[Complex32; SUBCARRIERS]) -> Shape {
    let level = csi.map(|h| f64::from(0.5 * h.norm_sqr().max(SMALLEST * SMALLEST).ln()));
    let mean = level.iter().sum::<f64>() / SUBCARRIERS as f64;
    level.map(|v| v - mean)
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

    /// A channel of two paths, `k` pairs on, with noise of its own for each direction.
    fn channel(k: u32, seed: u32, noise: f32) -> [Complex32; SUBCARRIERS] {
        let turn = 0.05 * k as f32 + seed as f32;
        let mut state = k.wrapping_mul(0x9e37_79b9) ^ seed.wrapping_mul(0x85eb_ca6b);
        std::array::from_fn(|s| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let phase = (state >> 8) as f32 * 1e-6;
            let paths = Complex32::new(20.0, 0.0) + Complex32::from_polar(12.0, turn + 0.3 * s as f32);
            paths + Complex32::from_polar(noise, phase)
        })
    }

    fn shapes(forward: u32, backward: u32, noise: f32) -> Reciprocal {
        let mut sums = Reciprocity::default();
        for k in 0..400 {
            let turned = if backward == forward { k } else { 3 * k + k * k / 97 };
            let back = channel(turned, backward, 0.0);
            let own = channel(k, forward, noise);
            sums.add(&own, &back.map(|h| h * 0.3));
        }
        sums.get().unwrap()
    }

    #[test]
    fn one_channel_is_told_from_two() {
        let (same, other) = (shapes(1, 1, 1.0), shapes(1, 5, 1.0));
        assert!(same.correlation > 0.9 && same.steadiness > 0.8, "{same:?}");
        assert!(other.correlation.abs() < 0.3 && other.steadiness > 0.5, "{other:?}");
        let mut few = Reciprocity::default();
        (0..20).for_each(|k| few.add(&channel(k, 1, 0.0), &channel(k, 1, 1.0)));
        assert_eq!(few.get(), None);
    }

    #[test]
    fn a_shape_that_never_changes_says_nothing() {
        let mut still = Reciprocity::default();
        (0..100).for_each(|_| still.add(&channel(7, 2, 0.0), &channel(7, 2, 1.0)));
        assert_eq!(still.get(), None);
    }
}
