//! From two CSI vectors to one coherent sample: the round-trip product, the channel centre, and what the product
//! leaves of the carrier frequency offset (CFO).
//!
//! With the forward frame heard at `t` and the backward one at `t + tau`, the product of the two CSI vectors holds the
//! path twice and the CFO only as `2 pi df tau`. `df tau` would be a constant, were it not that the turn-around `tau`
//! jitters by microseconds to hundreds of them: at `df` of several kHz that is most of the phase noise left.
//! Both cards' 1 MHz clocks (`timestamp_low`) measure the jitter, so it can be taken out again.
//!
//! Convention: `z * exp(+j 2 pi df d)`, with `d = clock_tx - clock_rx` less the drift `df / carrier`. The drift has the same
//! crystals behind it as `df`: `df ~ drift * carrier` to within about 1 kHz while the turn-around itself is steady
//! (measured on the paper's and the WSR data set's captures).

use crate::maths::{upper_median, wrap_rad};
use crate::signal::channel::SUBCARRIERS;
use crate::signal::samples::Coherent;
use num_complex::{Complex32, Complex64};
use std::f64::consts::TAU;

/// The round trip of one antenna pair: `forward[k] * backward[k]`, no conjugate, so the path is in it twice and the
/// CFO, which has opposite signs, cancels.
#[must_use]
pub fn round_trip(forward: &[Complex32; SUBCARRIERS], backward: &[Complex32; SUBCARRIERS]) -> [Complex32; SUBCARRIERS] {
    std::array::from_fn(|k| forward[k] * backward[k])
}

/// The round trip at the channel centre: [`at_centre`] of the product, with the slopes of the two directions taken out
/// one by one.
///
/// Path and radios together turn one direction by about 0.8 rad from one reported subcarrier to the next and the product
/// by twice that (measured); taken one by one the slopes stay unambiguous up to 800 ns each way (about 180 m of path).
/// `None` if one of them is all zero.
#[must_use]
pub fn round_trip_at_centre(
    forward: &[Complex32; SUBCARRIERS],
    backward: &[Complex32; SUBCARRIERS],
    indices: &[i8; SUBCARRIERS],
) -> Option<Coherent> {
    let slope = slope(forward, indices) + slope(backward, indices);
    let h = centre(&round_trip(forward, backward), indices, slope)?;
    Some(Coherent { h, path_gain: 2 })
}

/// Brings the CSI of one direction to the channel centre (subcarrier index 0, which the card does not report): the
/// least-squares line through the unwrapped phase over the true subcarrier `indices`, evaluated at 0.
///
/// So that unwrapping does not slip on noise the slope is first taken out as the phase of the summed neighbour products,
/// and the rest unwrapped and fitted; nothing is lost, the fit is of the sum of both.
/// The magnitude is the root mean square over the subcarriers. `None` if all are zero.
#[must_use]
pub fn at_centre(csi: &[Complex32; SUBCARRIERS], indices: &[i8; SUBCARRIERS]) -> Option<Coherent> {
    Some(Coherent { h: centre(csi, indices, slope(csi, indices))?, path_gain: 1 })
}

/// The usual phase step from one subcarrier to the next, radians per index.
fn slope(csi: &[Complex32; SUBCARRIERS], indices: &[i8; SUBCARRIERS]) -> f64 {
    let usual = indices[1] - indices[0];
    // Steps of the usual width only; the centre and one edge have narrower ones.
    let steps = (1..SUBCARRIERS).filter(|&k| indices[k] - indices[k - 1] == usual);
    let turn: Complex32 = steps.map(|k| csi[k] * csi[k - 1].conj()).sum();
    f64::from(turn.arg()) / f64::from(usual)
}

fn centre(csi: &[Complex32; SUBCARRIERS], indices: &[i8; SUBCARRIERS], slope: f64) -> Option<Complex64> {
    let power: f32 = csi.iter().map(Complex32::norm_sqr).sum();
    if !(power > 0.0 && power.is_finite()) {
        return None;
    }
    let mut last = 0.0;
    let (mut sum, mut sum_x, mut sum_xx, mut sum_xy) = (0.0, 0.0, 0.0, 0.0);
    for k in 0..SUBCARRIERS {
        let x = f64::from(indices[k]);
        let phase = f64::from(csi[k].arg()) - slope * x;
        let phase = if k == 0 { phase } else { last + wrap_rad(phase - last) };
        last = phase;
        sum += phase;
        sum_x += x;
        sum_xx += x * x;
        sum_xy += x * phase;
    }
    let n = SUBCARRIERS as f64;
    let rest = (n * sum_xy - sum_x * sum) / (n * sum_xx - sum_x * sum_x);
    let phase = (sum - rest * sum_x) / n;
    Some(Complex64::from_polar((f64::from(power) / n).sqrt(), phase))
}

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
    offsets_hz: Vec<f64>,
}

/// Outliers of the turn-around are further than this from the line, microseconds.
const OUTLIER_US: f64 = 25.0;
/// How far from `drift * carrier` the offset is looked for, Hz: the turn-around's own drift has been seen to fake up to
/// 2 ppm (11 kHz).
const SEARCH_HZ: f64 = 20_000.0;
/// Step of the search, Hz: the coherence over `df` is about 1 / (2 pi 20 us) = 8 kHz wide.
const STEP_HZ: f64 = 400.0;
/// Pairs that an offset of their own is looked for in: 2 s at the usual rate. What so few leave open of it turns no phase,
/// since it is the jitter that would have to show it.
const BLOCK: usize = 200;
/// How far a block's offset is looked for from that of all, Hz: 2.4 kHz within six seconds has been seen.
const DRIFT_HZ: f64 = 4_000.0;
/// By how much a block's own offset must raise the sum of its unit phasors, on average: chance gives half of one.
const GAIN_PER_BLOCK: f64 = 2.0;
/// Cards agree to 40 parts per million (802.11 allows each 20); more is a clock that was set anew, or no clock.
const MAX_DRIFT: f64 = 100e-6;
/// Second differences of the jitter beyond this are left out of the search, microseconds.
const MAX_SECOND_DIFFERENCE_US: i64 = 500;

impl TurnAround {
    /// Estimates the offset from samples, the receiver's card clock and the clock difference `tx - rx` (both unwrapped,
    /// microseconds), one entry per pair in time order. `None` with fewer than 8 pairs, where a clock stands still or
    /// drifts by more than any two cards do (it was reset), or if the lengths differ.
    #[must_use]
    pub fn estimate(z: &[Complex64], clock_rx_us: &[i64], difference_us: &[i64], carrier_hz: f64) -> Option<Self> {
        let n = z.len();
        if n < 8 || clock_rx_us.len() != n || difference_us.len() != n || clock_rx_us[n - 1] <= clock_rx_us[0] {
            return None;
        }
        let line = drift_line(clock_rx_us, difference_us);
        if line.slope.abs() > MAX_DRIFT {
            return None;
        }
        let residual = |k: usize| (difference_us[k] as f64 - line.at(clock_rx_us[k] as f64)).abs();
        let jitter_median_us = median((0..n).map(residual).collect());
        let terms = second_differences(z, clock_rx_us, difference_us);
        let total: f64 = terms.iter().map(|term| term.count).sum();
        if total < 4.0 {
            return None;
        }
        let coherence = |df_hz: f64| sum_at(&terms, df_hz).norm() / total;
        let df_hz = maximise(coherence, line.slope * carrier_hz, SEARCH_HZ);
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
            jitter_us: jitter_us(clock_rx_us, difference_us, df_hz / carrier_hz),
            jitter_median_us,
            coherence_before: before,
            coherence_after: after,
            worthwhile: after > before + 1.0 / total.sqrt(),
        })
    }

    /// From the lowest to the highest offset in the course of the record, Hz; 0 where one explains all.
    #[must_use]
    pub fn df_span_hz(&self) -> f64 {
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

/// The clock difference less a drift of `slope`, about its median.
///
/// The drift is that of the carriers, since one crystal makes both: a line through the differences themselves would
/// also take out what the turn-around drifts (measured: up to 3 ppm, a radian over the motion), which the product of
/// the frames holds.
fn jitter_us(clock_us: &[i64], difference_us: &[i64], slope: f64) -> Vec<f64> {
    let less_drift = |(clock, difference): (&i64, &i64)| *difference as f64 - slope * (clock - clock_us[0]) as f64;
    let left: Vec<f64> = clock_us.iter().zip(difference_us).map(less_drift).collect();
    let level = median(left.clone());
    left.into_iter().map(|d| d - level).collect()
}

/// `value = middle + slope * (x - middle_x)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    slope: f64,
    x: f64,
    y: f64,
}

impl Line {
    /// The value at `x`.
    #[must_use]
    pub fn at(&self, x: f64) -> f64 {
        self.y + self.slope * (x - self.x)
    }
}

/// The drift of one card's clock against another's: the median slope over half the record, then least squares without outliers.
pub fn drift_line(clock_us: &[i64], difference_us: &[i64]) -> Line {
    let n = clock_us.len();
    let half = n / 2;
    let slope_between = |k: usize| {
        let run = (clock_us[k + half] - clock_us[k]) as f64;
        (run > 0.0).then(|| (difference_us[k + half] - difference_us[k]) as f64 / run)
    };
    let slope = median((0..n - half).filter_map(slope_between).collect());
    let origin = clock_us[0] as f64;
    let y = median((0..n).map(|k| difference_us[k] as f64 - slope * (clock_us[k] as f64 - origin)).collect());
    let mut line = Line { slope, x: origin, y };
    for _ in 0..4 {
        let near = (0..n).filter(|&k| (difference_us[k] as f64 - line.at(clock_us[k] as f64)).abs() <= OUTLIER_US);
        let (mut count, mut sx, mut sy) = (0.0, 0.0, 0.0);
        for k in near.clone() {
            count += 1.0;
            sx += clock_us[k] as f64 - origin;
            sy += difference_us[k] as f64 - y;
        }
        if count < 4.0 {
            break;
        }
        let (mx, my) = (sx / count, sy / count);
        let (mut sxx, mut sxy) = (0.0, 0.0);
        for k in near {
            let x = clock_us[k] as f64 - origin - mx;
            sxx += x * x;
            sxy += x * (difference_us[k] as f64 - y - my);
        }
        if sxx <= 0.0 {
            break;
        }
        line = Line { slope: sxy / sxx, x: origin + mx, y: y + my };
    }
    line
}

/// The upper median; 0 if there are no values.
fn median(mut values: Vec<f64>) -> f64 {
    upper_median(&mut values).unwrap_or(0.0)
}

/// Unit second differences summed by the (integer) second difference of the turn-around that goes with them: the
/// histogram makes the search over `df` as cheap as the jitter is small.
struct Term {
    second_us: f64,
    sum: Complex64,
    count: f64,
}

fn second_differences(z: &[Complex64], clock_us: &[i64], difference_us: &[i64]) -> Vec<Term> {
    let width = 2 * MAX_SECOND_DIFFERENCE_US as usize + 1;
    let mut sums = vec![(Complex64::default(), 0.0); width];
    for k in 1..z.len() - 1 {
        let (before, after) = (clock_us[k] - clock_us[k - 1], clock_us[k + 1] - clock_us[k]);
        let second = difference_us[k - 1] - 2 * difference_us[k] + difference_us[k + 1];
        let even = before > 0 && after > 0 && 2 * (before - after).abs() < before + after;
        if !even || second.abs() > MAX_SECOND_DIFFERENCE_US {
            continue;
        }
        let product = z[k - 1] * z[k].conj() * z[k].conj() * z[k + 1];
        let norm = product.norm();
        if norm > 0.0 && norm.is_finite() {
            let bin = &mut sums[(second + MAX_SECOND_DIFFERENCE_US) as usize];
            bin.0 += product / norm;
            bin.1 += 1.0;
        }
    }
    let term = |(k, &(sum, count)): (usize, &(Complex64, f64))| Term {
        second_us: (k as i64 - MAX_SECOND_DIFFERENCE_US) as f64,
        sum,
        count,
    };
    sums.iter().enumerate().filter(|(_, bin)| bin.1 > 0.0).map(term).collect()
}

fn sum_at(terms: &[Term], df_hz: f64) -> Complex64 {
    let rate = TAU * df_hz * 1e-6;
    terms.iter().map(|term| term.sum * Complex64::cis(rate * term.second_us)).sum()
}

/// Offsets block by block, and the sum of the blocks' coherent sums, if they gain more than their number explains.
fn course(z: &[Complex64], clock_us: &[i64], difference_us: &[i64], df_hz: f64) -> Option<(Vec<(f64, f64)>, f64)> {
    let blocks = z.len() / BLOCK;
    if blocks < 2 {
        return None;
    }
    let (mut course, mut with, mut without) = (Vec::new(), 0.0, 0.0);
    for block in 0..blocks {
        let (from, to) = (block * z.len() / blocks, (block + 1) * z.len() / blocks);
        let terms = second_differences(&z[from..to], &clock_us[from..to], &difference_us[from..to]);
        let coherent = |hz: f64| sum_at(&terms, hz).norm();
        let own_hz = maximise(coherent, df_hz, DRIFT_HZ);
        (with, without) = (with + coherent(own_hz), without + coherent(df_hz));
        course.push((0.5 * (clock_us[from] + clock_us[to - 1]) as f64, own_hz));
    }
    (with - without > GAIN_PER_BLOCK * blocks as f64).then_some((course, with))
}

/// The value at `x` between the points of `course`, and that of the nearest beyond its ends; `None` if it is empty.
fn along(course: &[(f64, f64)], x: f64) -> Option<f64> {
    let after = course.partition_point(|point| point.0 <= x);
    let (Some(left), Some(right)) = (course.get(after.saturating_sub(1)), course.get(after).or(course.last())) else {
        return None;
    };
    let run = right.0 - left.0;
    Some(if run > 0.0 { left.1 + (right.1 - left.1) * ((x - left.0) / run).clamp(0.0, 1.0) } else { left.1 })
}

/// The maximum of `f` within `reach_hz` of `near_hz`: a grid, then golden sections.
fn maximise(f: impl Fn(f64) -> f64, near_hz: f64, reach_hz: f64) -> f64 {
    let steps = (reach_hz / STEP_HZ) as i32;
    let mut best = (f64::NEG_INFINITY, near_hz);
    for k in -steps..=steps {
        let at = near_hz + f64::from(k) * STEP_HZ;
        let value = f(at);
        if value > best.0 {
            best = (value, at);
        }
    }
    let ratio = (5f64.sqrt() - 1.0) / 2.0;
    let (mut low, mut high) = (best.1 - STEP_HZ, best.1 + STEP_HZ);
    while high - low > 0.5 {
        let (a, b) = (high - ratio * (high - low), low + ratio * (high - low));
        if f(a) >= f(b) { high = b } else { low = a }
    }
    0.5 * (low + high)
}

/// How steady the phase of `z` is from sample to sample, 0..1, whatever its slow course: the coherence of unit second
/// differences. `None` with fewer than three samples.
#[must_use]
pub fn second_difference_coherence(z: &[Complex64]) -> Option<f64> {
    let unit = |w: &[Complex64]| {
        let product = w[0] * w[1].conj() * w[1].conj() * w[2];
        if product.norm() > 0.0 { product / product.norm() } else { Complex64::default() }
    };
    (z.len() >= 3).then(|| z.windows(3).map(unit).sum::<Complex64>().norm() / (z.len() - 2) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    const INDICES: [i8; SUBCARRIERS] = crate::signal::channel::INDICES_20_MHZ;

    #[test]
    fn centre_phase_is_exact_for_any_delay_the_card_has() {
        let wave = |size: f32, phase: f32, slope: f32| {
            std::array::from_fn(|k| Complex32::from_polar(size, phase + slope * f32::from(INDICES[k])))
        };
        for slope in [-1.4f32, -0.81, -0.3, 0.0, 0.4, 0.9] {
            for phase in [-3.0f32, -1.0, 0.0, 2.5] {
                let one = at_centre(&wave(3.0, phase, slope), &INDICES).unwrap();
                assert!((one.h - Complex64::from_polar(3.0, f64::from(phase))).norm() < 1e-4, "{slope} {phase}");
                // Two such slopes together turn by more than pi from one reported subcarrier to the next.
                let both = round_trip_at_centre(&wave(1.0, phase, slope), &wave(3.0, 0.5, slope), &INDICES).unwrap();
                assert!((both.h - Complex64::from_polar(3.0, f64::from(phase) + 0.5)).norm() < 1e-4, "{slope} {phase}");
                assert_eq!((one.path_gain, both.path_gain), (1, 2));
            }
        }
        assert_eq!(at_centre(&[Complex32::default(); SUBCARRIERS], &INDICES), None);
        assert_eq!(at_centre(&[Complex32::new(f32::NAN, 0.0); SUBCARRIERS], &INDICES), None);
    }

    /// A link of `n` pairs at 10 ms with a slowly turning phase, an offset of `df_hz`, and a jitter with outliers.
    fn link(n: usize, df_hz: f64, drift_ppm: f64) -> (Vec<Complex64>, Vec<i64>, Vec<i64>) {
        let mut state = 1u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1u32 << 24)
        };
        let (mut z, mut clock, mut difference) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..n {
            let t_us = 10_000.0 * k as f64 + 300.0 * random();
            let jitter_us = if random() < 0.03 { 180.0 * random() } else { 16.0 * (random() - 0.5) };
            let d = jitter_us.round();
            z.push(Complex64::cis(3.0 * (t_us * 1e-6).sin() - TAU * df_hz * d * 1e-6));
            clock.push(4_294_967_000 + t_us as i64);
            difference.push(-7_000_000 + (d + drift_ppm * 1e-6 * t_us).round() as i64);
        }
        (z, clock, difference)
    }

    #[test]
    fn the_offset_is_found_from_the_jitter_and_taken_out() {
        for df_hz in [-21_000.0, -4_100.0, 9_000.0] {
            let (mut z, clock, difference) = link(900, df_hz, df_hz / 5.54e9 * 1e6);
            let found = TurnAround::estimate(&z, &clock, &difference, 5.54e9).unwrap();
            assert!((found.df_hz - df_hz).abs() < 150.0, "{} for {df_hz}", found.df_hz);
            assert!((found.drift_ppm - df_hz / 5_540.0).abs() < 0.05);
            assert!(found.worthwhile && found.coherence_after > 0.98, "{found:?}");
            found.apply(&mut z);
            assert!(second_difference_coherence(&z).unwrap() > 0.97);
        }
    }

    #[test]
    fn an_offset_that_drifts_is_followed_and_a_steady_one_is_left_alone() {
        let (mut z, clock, difference) = link(3_000, -15_000.0, -15_000.0 / 5_540.0);
        assert!(TurnAround::estimate(&z, &clock, &difference, 5.54e9).unwrap().course.is_empty());
        // From -15 kHz on it drifts by 2.4 kHz; `d` is the jitter that `link` made.
        let extra_hz = |k: usize| -2_400.0 * k as f64 / 3_000.0;
        let drift = -15_000.0 / 5.54e9;
        for (k, z) in z.iter_mut().enumerate() {
            let d_us = difference[k] as f64 + 7e6 - (drift * (clock[k] - clock[0]) as f64).round();
            *z *= Complex64::cis(-TAU * extra_hz(k) * d_us * 1e-6);
        }
        let found = TurnAround::estimate(&z, &clock, &difference, 5.54e9).unwrap();
        assert!((found.df_span_hz() - 2_240.0).abs() < 500.0, "{:?}", found.course);
        assert!(
            found.course.windows(2).all(|pair| (pair[1].1 - pair[0].1 + 160.0).abs() < 300.0),
            "{:?}",
            found.course
        );
        let mut one = z.clone();
        TurnAround { offsets_hz: Vec::new(), ..found.clone() }.apply(&mut one);
        found.apply(&mut z);
        let (with, without) = (second_difference_coherence(&z).unwrap(), second_difference_coherence(&one).unwrap());
        assert!(with > 0.97 && with > without + 0.005, "{with} {without}");
    }

    #[test]
    fn points_beyond_a_course_have_its_end() {
        let course = [(10.0, 1.0), (20.0, 3.0)];
        assert_eq!([0.0, 10.0, 15.0, 20.0, 99.0].map(|x| along(&course, x)), [1.0, 1.0, 2.0, 3.0, 3.0].map(Some));
        assert_eq!((along(&course[..1], 5.0), along(&[], 5.0)), (Some(1.0), None));
    }

    #[test]
    fn a_turn_around_that_drifts_is_no_drift_of_the_clocks() {
        let (z, clock, mut difference) = link(900, 9_000.0, 9_000.0 / 5_540.0);
        difference.iter_mut().enumerate().for_each(|(k, d)| *d += k as i64 / 40);
        // The product of the frames holds the longer turn-arounds too.
        let drifts = |(k, z): (usize, &Complex64)| z * Complex64::cis(-TAU * 9_000.0 * 1e-6 * (k / 40) as f64);
        let mut z: Vec<Complex64> = z.iter().enumerate().map(drifts).collect();
        let (still, _, _) = link(900, 0.0, 0.0);
        TurnAround::estimate(&z, &clock, &difference, 5.54e9).unwrap().apply(&mut z);
        let left: Complex64 = z.iter().zip(&still).map(|(a, b)| a * b.conj()).sum();
        assert!(left.norm() / z.len() as f64 > 0.98, "{left}");
    }

    #[test]
    fn without_clocks_or_offset_nothing_is_done() {
        let (z, clock, difference) = link(500, 0.0, 1.0);
        assert!(!TurnAround::estimate(&z, &clock, &difference, 5.54e9).unwrap().worthwhile);
        let stopped = vec![4; z.len()];
        assert_eq!(TurnAround::estimate(&z, &stopped, &stopped, 5.54e9), None);
        assert_eq!(TurnAround::estimate(&z, &clock[1..], &difference, 5.54e9), None);
    }
}
