//! The search for the carrier frequency offset `df` that makes the product's phase steady.

use crate::maths::vertex;
use num_complex::Complex64;
use std::f64::consts::TAU;

/// Second differences of the jitter beyond this are skipped, microseconds.
const MAX_SECOND_DIFFERENCE_US: i64 = 500;

/// Pairs that an offset of their own is searched in.
const BLOCK: usize = 200;

/// How far a block's offset is searched from that of all, Hz (2.4 kHz within six seconds).
const DRIFT_HZ: f64 = 4_000.0;

/// By how much a block's own offset must raise the sum of its unit phasors, on average (chance gives half of one).
const GAIN_PER_BLOCK: f64 = 2.0;

/// Step of the search, Hz (the coherence is 8 kHz wide).
const STEP_HZ: f64 = 800.0;

/// Unit second differences summed by the (integer) second difference of the turn-around that goes with them: the
/// histogram makes the search over `df` as cheap as the jitter is small.
pub(super) struct Term {
    /// Second difference of the turn-around, whole microseconds.
    pub second_us: f64,
    /// Sum of the unit second differences of the phase.
    pub sum: Complex64,
    /// How many there are.
    pub count: f64,
}

/// The terms of a record, by rising second differences.
pub(super) fn second_differences(z: &[Complex64], clock_us: &[i64], difference_us: &[i64]) -> Vec<Term> {
    let most_us = MAX_SECOND_DIFFERENCE_US;
    let width = 2 * most_us as usize + 1;
    let mut sums = vec![(Complex64::default(), 0.0); width];
    for k in 1..z.len() - 1 {
        let (before, after) = (clock_us[k] - clock_us[k - 1], clock_us[k + 1] - clock_us[k]);
        let second = difference_us[k - 1] - 2 * difference_us[k] + difference_us[k + 1];
        let even = before > 0 && after > 0 && 2 * (before - after).abs() < before + after;
        if !even || second.abs() > most_us {
            continue;
        }
        let product = z[k - 1] * z[k].conj() * z[k].conj() * z[k + 1];
        let norm = product.norm();
        if norm > 0.0 && norm.is_finite() {
            let bin = &mut sums[(second + most_us) as usize];
            bin.0 += product / norm;
            bin.1 += 1.0;
        }
    }
    let term =
        |(k, &(sum, count)): (usize, &(Complex64, f64))| Term { second_us: (k as i64 - most_us) as f64, sum, count };
    sums.iter().enumerate().filter(|(_, bin)| bin.1 > 0.0).map(term).collect()
}

/// The sum of all terms with an offset of `df_hz` removed.
pub(super) fn sum_at(terms: &[Term], df_hz: f64) -> Complex64 {
    let Some(first) = terms.first() else { return Complex64::ZERO };
    let rate = TAU * df_hz * 1e-6;
    // Terms rise by whole microseconds, each of which turns by the same.
    let by = Complex64::cis(rate);
    let (mut at_us, mut turn, mut sum) = (first.second_us, Complex64::cis(rate * first.second_us), Complex64::ZERO);
    for term in terms {
        while at_us < term.second_us {
            (at_us, turn) = (at_us + 1.0, turn * by);
        }
        sum += term.sum * turn;
    }
    sum
}

/// Offsets block by block, and the sum of the blocks' coherent sums, if they gain more than their number explains.
pub(super) fn course(
    z: &[Complex64],
    clock_us: &[i64],
    difference_us: &[i64],
    df_hz: f64,
) -> Option<(Vec<(f64, f64)>, f64)> {
    let blocks = z.len() / BLOCK;
    if blocks < 2 {
        return None;
    }
    let (mut course, mut with, mut without) = (Vec::new(), 0.0, 0.0);
    for block in 0..blocks {
        let (from, to) = (block * z.len() / blocks, (block + 1) * z.len() / blocks);
        let terms = second_differences(&z[from..to], &clock_us[from..to], &difference_us[from..to]);
        let coherent = |hz: f64| sum_at(&terms, hz).norm();
        let own_hz = maximise(&terms, df_hz, DRIFT_HZ);
        (with, without) = (with + coherent(own_hz), without + coherent(df_hz));
        course.push((0.5 * (clock_us[from] + clock_us[to - 1]) as f64, own_hz));
    }
    (with - without > GAIN_PER_BLOCK * blocks as f64).then_some((course, with))
}

/// The value at `x` between the points of `course`, and that of the nearest beyond its ends; `None` if it is empty.
pub(super) fn along(course: &[(f64, f64)], x: f64) -> Option<f64> {
    let after = course.partition_point(|point| point.0 <= x);
    let (Some(left), Some(right)) = (course.get(after.saturating_sub(1)), course.get(after).or(course.last())) else {
        return None;
    };
    let run = right.0 - left.0;
    Some(if run > 0.0 { left.1 + (right.1 - left.1) * ((x - left.0) / run).clamp(0.0, 1.0) } else { left.1 })
}

/// Terms side by side, and partial sums.
const ABREAST: usize = 8;

/// Some terms: real and imaginary parts as they are turned, and those of what turns each from one offset to the next.
#[derive(Clone, Copy, Default)]
struct Turned {
    re: [f64; ABREAST],
    im: [f64; ABREAST],
    by_re: [f64; ABREAST],
    by_im: [f64; ABREAST],
}

/// The terms on a grid of offsets: from one to the next each turns by the same.
struct Turning(Vec<Turned>);

impl Turning {
    fn new(terms: &[Term], from_hz: f64, step_hz: f64) -> Self {
        let turn = |term: &Term, hz: f64| Complex64::cis(TAU * hz * 1e-6 * term.second_us);
        let abreast = |terms: &[Term]| {
            let mut turned = Turned::default();
            for (i, term) in terms.iter().enumerate() {
                let (first, by) = (term.sum * turn(term, from_hz), turn(term, step_hz));
                (turned.re[i], turned.im[i], turned.by_re[i], turned.by_im[i]) = (first.re, first.im, by.re, by.im);
            }
            turned
        };
        Self(terms.chunks(ABREAST).map(abreast).collect())
    }

    /// The sum of all terms at this offset, the first on the grid at first; turns them to the next.
    fn next(&mut self) -> Complex64 {
        let (mut re, mut im) = ([0.0; ABREAST], [0.0; ABREAST]);
        for own in &mut self.0 {
            for i in 0..ABREAST {
                re[i] += own.re[i];
                im[i] += own.im[i];
                let turned = own.re[i] * own.by_re[i] - own.im[i] * own.by_im[i];
                own.im[i] = own.re[i] * own.by_im[i] + own.im[i] * own.by_re[i];
                own.re[i] = turned;
            }
        }
        Complex64::new(re.iter().sum(), im.iter().sum())
    }
}

/// The offset within `reach_hz` of `near_hz` at which the terms' sum is largest: on a grid, and between its points by a parabola.
pub(super) fn maximise(terms: &[Term], near_hz: f64, reach_hz: f64) -> f64 {
    let steps = (reach_hz / STEP_HZ) as i32;
    let from_hz = near_hz - f64::from(steps) * STEP_HZ;
    let mut turning = Turning::new(terms, from_hz, STEP_HZ);
    let values: Vec<f64> = (0..=2 * steps).map(|_| turning.next().norm_sqr()).collect();
    from_hz + STEP_HZ * vertex(&values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terms_turn_from_offset_to_offset_as_each_by_itself() {
        for count in [1, 7, 8, 41] {
            let term = |k: usize| Term {
                second_us: 3.0 * k as f64 - 50.0,
                sum: Complex64::from_polar(1.0 + k as f64, 0.7 * k as f64),
                count: 1.0,
            };
            let terms: Vec<Term> = (0..count).map(term).collect();
            let mut turning = Turning::new(&terms, -2_000.0, 25.0);
            for k in 0..200 {
                let df_hz = -2_000.0 + 25.0 * f64::from(k);
                let own = |term: &Term| term.sum * Complex64::cis(TAU * df_hz * 1e-6 * term.second_us);
                let expected: Complex64 = terms.iter().map(own).sum();
                for found in [turning.next(), sum_at(&terms, df_hz)] {
                    assert!((found - expected).norm() < 1e-9 * (1.0 + expected.norm()), "{count} {k}: {found}");
                }
            }
        }
    }
}
