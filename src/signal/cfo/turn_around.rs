//! The phase `2 pi df d` that the jitter `d` of the turn-around leaves: `df` estimated, the phase removed.

use super::drift_line::{DriftLine, drift_line_of, median, slope_between};
use super::offset::{Term, along, course, maximise, second_differences, sum_at};
use num_complex::Complex64;
use std::f64::consts::TAU;

/// Clocks that drift apart by more are not two cards' (802.11 allows each 20 ppm).
const MAX_DRIFT: f64 = 100e-6;

/// How far from the clocks' drift the offset is searched, Hz (the turn-around's own drift fakes up to 2 ppm, 11 kHz).
const SEARCH_HZ: f64 = 20_000.0;

/// What [`TurnAround::estimate`] found.
#[derive(Clone, Debug, PartialEq)]
pub struct TurnAround {
    /// Carrier frequency offset between the two cards, Hz, in the sign of the convention above.
    pub df_hz: f64,
    /// Drift of `clock_tx - clock_rx`, parts per million of the receiver's clock.
    pub drift_ppm: f64,
    /// Turn-around `d` of each pair against the median, microseconds, the clocks' drift taken to be that of the carriers.
    pub jitter_us: Vec<f64>,
    /// Median of its distance from a straight line, microseconds.
    pub jitter_median_us: f64,
    /// Coherence of second differences before, 0..1: `|mean(u)|`, `u = z[k-1] conj(z[k])^2 z[k+1]` of unit modulus.
    pub coherence_before: f64,
    /// The same after taking out `df`.
    pub coherence_after: f64,
    /// Whether the compensation pays: the coherence rose by more than one free parameter explains.
    pub worthwhile: bool,
    /// Where the offset was seen to drift: (receiver's clock in microseconds, Hz) in the middle of each block of pairs.
    /// Empty where one offset explains all.
    pub course: Vec<(f64, f64)>,
    /// The offset at each pair, Hz, where it drifts.
    pub(super) offsets_hz: Vec<f64>,
}

impl TurnAround {
    /// Estimates the offset from samples, the receiver's card clock and the clock difference `tx - rx` (both unwrapped,
    /// microseconds), one entry per pair in time order. `None` with fewer than 8 pairs, where a clock stands still or
    /// drifts by more than any two cards do (it was reset), or if the lengths differ.
    ///
    /// The search rounds the differences to whole microseconds; the compensation uses them as they are.
    #[must_use]
    pub fn estimate(z: &[Complex64], clock_rx_us: &[i64], difference_us: &[f64], carrier_hz: f64) -> Option<Self> {
        let n = z.len();
        let fine_us = difference_us;
        let difference_us: &[i64] = &fine_us.iter().map(|us| us.round() as i64).collect::<Vec<i64>>();
        if n < 8 || clock_rx_us.len() != n || difference_us.len() != n || clock_rx_us[n - 1] <= clock_rx_us[0] {
            return None;
        }
        let slopes = [2, 4, 8].map(|parts| slope_between(clock_rx_us, difference_us, (n / parts).max(1)));
        let line = |slope: f64| drift_line_of(clock_rx_us, difference_us, slope);
        let terms = second_differences(z, clock_rx_us, difference_us);
        let total: f64 = terms.iter().map(|term| term.count).sum();
        if total < 4.0 {
            return None;
        }
        let coherence = |df_hz: f64| sum_at(&terms, df_hz).norm() / total;
        let (line, df_hz) = by_lines(&slopes, &line, &terms, carrier_hz, 2.0 * total.sqrt())?;
        let residual = |k: usize| (difference_us[k] as f64 - line.at(clock_rx_us[k] as f64)).abs();
        let jitter_median_us = median((0..n).map(residual).collect());
        let (before, mut after) = (coherence(0.0), coherence(df_hz));
        let course = match course(z, clock_rx_us, difference_us, df_hz) {
            Some((course, coherent)) => {
                after = coherent / total;
                course
            }
            None => Vec::new(),
        };
        Some(Self {
            offsets_hz: clock_rx_us
                .iter()
                .map(|us| along(&course, *us as f64))
                .take_while(Option::is_some)
                .flatten()
                .collect(),
            course,
            df_hz,
            drift_ppm: line.slope * 1e6,
            jitter_us: jitter_us(clock_rx_us, fine_us, df_hz / carrier_hz),
            jitter_median_us,
            coherence_before: before,
            coherence_after: after,
            worthwhile: after > before + 1.0 / total.sqrt(),
        })
    }

    /// From the lowest to the highest offset in the course of the record, Hz; 0 where one explains all.
    #[must_use]
    pub(crate) fn df_span_hz(&self) -> f64 {
        let (low, high) = self.course.iter().fold((f64::MAX, f64::MIN), |(l, h), (_, hz)| (l.min(*hz), h.max(*hz)));
        (high - low).max(0.0)
    }

    /// Takes the offset out: `z[k] *= exp(+j 2 pi df d[k])`. Samples beyond the estimate's own are left alone.
    pub fn apply(&self, z: &mut [Complex64]) {
        let offsets_hz = self.offsets_hz.iter().copied().chain(std::iter::repeat(self.df_hz));
        for ((z, d_us), df_hz) in z.iter_mut().zip(&self.jitter_us).zip(offsets_hz) {
            *z *= Complex64::cis(TAU * (df_hz * d_us * 1e-6).fract());
        }
    }
}

/// The offset near the drift by one of the lines, each through a slope, and that line: the first, unless the sum of the terms is
/// greater by `gain` with an offset that was not within its reach. `None` without lines.
///
/// A turn-around that steps by 140 us in the middle of 20 s tilts the first line by 14 ppm, 75 kHz of a carrier at 5.3 GHz.
fn by_lines(
    slopes: &[f64],
    line: &dyn Fn(f64) -> DriftLine,
    terms: &[Term],
    carrier_hz: f64,
    gain: f64,
) -> Option<(DriftLine, f64)> {
    let mut searched: Vec<f64> = Vec::new();
    let mut best: Option<(f64, DriftLine, f64)> = None;
    let is_searched = |searched: &[f64], slope: f64| {
        slope.abs() > MAX_DRIFT || searched.iter().any(|hz| (hz - slope * carrier_hz).abs() < 0.5 * SEARCH_HZ)
    };
    for slope in slopes {
        if is_searched(&searched, *slope) {
            continue;
        }
        let line = line(*slope);
        if is_searched(&searched, line.slope) {
            continue;
        }
        let near_hz = line.slope * carrier_hz;
        searched.push(near_hz);
        let df_hz = maximise(terms, near_hz, SEARCH_HZ);
        let sum = sum_at(terms, df_hz).norm();
        if best.as_ref().is_none_or(|(greatest, ..)| sum > greatest + gain) {
            best = Some((sum, line, df_hz));
        }
    }
    best.map(|(_, line, df_hz)| (line, df_hz))
}

/// The clock difference less a drift of `slope`, about its median.
///
/// The drift is that of the carriers, since one crystal makes both: a line through the differences themselves would
/// also take out what the turn-around drifts (measured: up to 3 ppm, a radian over the motion), which the product of
/// the frames holds.
fn jitter_us(clock_us: &[i64], difference_us: &[f64], slope: f64) -> Vec<f64> {
    let less_drift = |(clock, difference): (&i64, &f64)| difference - slope * (clock - clock_us[0]) as f64;
    let left: Vec<f64> = clock_us.iter().zip(difference_us).map(less_drift).collect();
    let level = median(left.clone());
    left.into_iter().map(|d| d - level).collect()
}
