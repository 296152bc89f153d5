//! The one-way channel out of the round trip: `h` from `h^2`, its sign kept by continuity.
//!
//! Forward and backward channel are the same but for the radios, so their product is the square of one channel. With
//! several paths the square also holds each pair of them, at the mean of their directions: sources that are not
//! there. The square root has only the paths, each once (path gain 1), but its sign is open for every packet and
//! subcarrier.
//!
//! Signs are chosen so that the channel varies as little as it can: from packet to packet along each subcarrier, then
//! in sweeps against the mean of the neighbourhood in time and frequency until nothing changes any more. That is
//! reliable where the channel is strong; where it fades, the sign matters little, and samples count by their
//! magnitude. It needs a channel whose slope over the subcarriers and turn-around phase have been taken out first.

use crate::alignment::{Row, running_sums};
use crate::channel::SUBCARRIERS;
use num_complex::Complex32;

/// Packets on either side that a sample is compared with.
const REACH: usize = 5;
/// How much of the prediction a packet inherits while tracking.
const MEMORY: f32 = 0.7;
/// Sweeps at most.
const SWEEPS: usize = 12;

/// What [`one_way`] gives.
#[derive(Clone, Debug, PartialEq)]
pub struct OneWay {
    /// The one-way channel, up to one common sign: path gain 1.
    pub rows: Vec<Row>,
    /// Signs that the sweeps still changed after tracking, as a share of all samples, 0..1.
    pub corrected: f64,
    /// Share of the power whose sign disagrees with the packet before it on the same subcarrier: slips, 0..1.
    pub slips: f64,
    /// Coherence of neighbouring packets, 0..1.
    pub coherence: f64,
}

/// Takes the square root of `rows` (round trips, common slope removed, in the order of time).
#[must_use]
pub fn one_way(rows: &[Row]) -> OneWay {
    let mut roots: Vec<Row> = rows.iter().map(|row| row.map(root)).collect();
    track(&mut roots);
    let mut corrected = 0;
    for _ in 0..SWEEPS {
        let changed = sweep(&mut roots);
        corrected += changed;
        if changed == 0 {
            break;
        }
    }
    let (mut slipped, mut aligned, mut full) = (0.0, Complex32::default(), 0.0);
    for pair in roots.windows(2) {
        for (a, b) in pair[0].iter().zip(&pair[1]) {
            let product = b * a.conj();
            aligned += product;
            let size = product.norm_sqr().sqrt();
            full += size;
            slipped += if product.re < 0.0 { size } else { 0.0 };
        }
    }
    let share = |part: f32| if full > 0.0 { f64::from(part / full) } else { 0.0 };
    let samples = (roots.len() * SUBCARRIERS).max(1) as f64;
    OneWay {
        corrected: corrected as f64 / samples,
        slips: share(slipped),
        coherence: share(aligned.norm()),
        rows: roots,
    }
}

/// The square root with a positive real part, without the polar form.
fn root(value: Complex32) -> Complex32 {
    let large = (0.5 * (value.norm_sqr().sqrt() + value.re.abs())).sqrt();
    let small = if large > 0.0 { 0.5 * value.im.abs() / large } else { 0.0 };
    let (re, im) = if value.re >= 0.0 { (large, small) } else { (small, large) };
    Complex32::new(re, im.copysign(value.im))
}

/// The first packet by continuity over the subcarriers, every other by a prediction from those before it.
fn track(roots: &mut [Row]) {
    let Some(first) = roots.first_mut() else { return };
    for k in 1..SUBCARRIERS {
        let before: Complex32 = first[k.saturating_sub(3)..k].iter().sum();
        flip(&mut first[k], before);
    }
    let mut predicted = *first;
    for row in &mut roots[1..] {
        for (value, expected) in row.iter_mut().zip(&mut predicted) {
            flip(value, *expected);
            *expected = *expected * MEMORY + *value;
        }
    }
}

/// Turns `value` into the half plane of `expected`; true if its sign changed.
fn flip(value: &mut Complex32, expected: Complex32) -> bool {
    let against = (*value * expected.conj()).re < 0.0;
    if against {
        *value = -*value;
    }
    against
}

/// Compares every sample with the sum of its neighbours in time and on the subcarriers beside it. Returns how many
/// signs changed.
fn sweep(roots: &mut [Row]) -> usize {
    let sums = running_sums(roots, REACH);
    let mut changed = 0;
    for (row, sum) in roots.iter_mut().zip(&sums) {
        let old = *row;
        for k in 0..SUBCARRIERS {
            let beside = k.saturating_sub(1)..(k + 2).min(SUBCARRIERS);
            let around = sum[beside].iter().sum::<Complex32>() - old[k];
            changed += usize::from(flip(&mut row[k], around));
        }
    }
    changed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_paths_come_back_out_of_their_square() {
        let channel = |t: usize, k: usize| {
            let (t, k) = (t as f32, k as f32);
            Complex32::cis(0.11 * t) + Complex32::from_polar(0.6, 1.0 - 0.09 * t + 0.05 * k)
        };
        let truth: Vec<Row> = (0..600).map(|t| std::array::from_fn(|k| channel(t, k))).collect();
        let squared: Vec<Row> = truth.iter().map(|row| row.map(|v| v * v)).collect();
        let found = one_way(&squared);
        let product: Complex32 =
            truth.iter().flatten().zip(found.rows.iter().flatten()).map(|(a, b)| a * b.conj()).sum();
        let power: f32 = truth.iter().flatten().map(Complex32::norm_sqr).sum();
        assert!(product.norm() / power > 0.999, "{}", product.norm() / power);
        assert!(found.slips < 1e-3 && found.coherence > 0.98, "{} {}", found.slips, found.coherence);
    }

    #[test]
    fn roots_are_those_of_the_polar_form() {
        for k in 0..64 {
            let value = Complex32::from_polar(0.1 + 0.3 * k as f32, 0.1 * k as f32 - 3.1);
            assert!((root(value) - value.sqrt()).norm() < 1e-5, "{value}");
        }
        assert_eq!(root(Complex32::default()), Complex32::default());
    }

    #[test]
    fn random_phases_are_seen_as_slips() {
        let mut state = 3u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u32 << 24) as f32
        };
        let rows: Vec<Row> =
            (0..300).map(|_| std::array::from_fn(|_| Complex32::cis(std::f32::consts::TAU * random()))).collect();
        assert!(one_way(&rows).coherence < 0.8);
        assert!(one_way(&rows).slips > 0.05);
        assert!(one_way(&[]).rows.is_empty());
    }
}
