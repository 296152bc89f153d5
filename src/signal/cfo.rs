//! From two CSI vectors to one coherent sample: the round-trip product, the channel centre, and what the product
//! leaves of the carrier frequency offset (CFO).
//!
//! With the forward frame heard at `t` and the backward one at `t + tau`, the product of the two CSI vectors holds the
//! path twice and the CFO only as `2 pi df tau`. `df tau` would be a constant, were it not that the turn-around `tau`
//! jitters by microseconds to hundreds of them: at `df` of several kHz that is most of the phase noise left.
//! Both cards' 1 MHz clocks (`timestamp_low`) measure the jitter, so it can be removed again.
//!
//! Convention: `z * exp(+j 2 pi df d)`, with `d = clock_tx - clock_rx` less the drift `df / carrier`. The drift has the same
//! crystals behind it as `df`: `df ~ drift * carrier` to within about 1 kHz while the turn-around itself is steady
//! (measured on the captures of \[paper\] and \[wsr\]).
//!
//! [`round_trip_at_centre`] brings the product of the two directions to the channel's centre, `round_trips_at_centre` of many pairs at
//! once; `drift_line` fits the drift of one card's clock against the other's; [`TurnAround`] searches for `df` and removes it.

use crate::maths::{upper_median, wrap_rad};
use crate::signal::channel::SUBCARRIERS;
use csi5300_kernels::simd::{Tier, V, on_tier, sin_cos_turns, turns_of};
use driver_iface::bfee::Iq;
use fearless_simd::{Select, Simd, SimdBase, SimdFloat};
use num_complex::{Complex32, Complex64};
use std::f64::consts::TAU;

/// Brings the CSI of one direction to the channel centre (subcarrier index 0, which the card does not report): the
/// least-squares line through the unwrapped phase over the true subcarrier `indices`, evaluated at 0.
///
/// So that unwrapping does not slip on noise the slope is first removed as the phase of the summed neighbour products,
/// and the rest unwrapped and fitted; nothing is lost, the fit is of the sum of both.
/// A subcarrier at (0, 0) has no phase and no part in the line. The magnitude is the root mean square over all subcarriers.
/// `None` if all are zero.
#[must_use]
pub fn at_centre(csi: &[Complex32; SUBCARRIERS], indices: &[i8; SUBCARRIERS]) -> Option<Complex64> {
    centre(csi, indices, slope(csi, indices))
}

/// The usual phase step from one subcarrier to the next, radians per index.
fn slope(csi: &[Complex32; SUBCARRIERS], indices: &[i8; SUBCARRIERS]) -> f64 {
    let usual = indices[1] - indices[0];
    // Steps of the usual width only; the centre and one edge have narrower ones.
    let steps = (1..SUBCARRIERS).filter(|&k| indices[k] - indices[k - 1] == usual);
    let turn: Complex32 = steps.map(|k| csi[k] * csi[k - 1].conj()).sum();
    f64::from(turn.arg()) / f64::from(usual)
}

/// The centre of `csi`, given about how steep its phase is, radians per index.
fn centre(csi: &[Complex32; SUBCARRIERS], indices: &[i8; SUBCARRIERS], slope: f64) -> Option<Complex64> {
    let power: f32 = csi.iter().map(Complex32::norm_sqr).sum();
    if !(power > 0.0 && power.is_finite()) {
        return None;
    }
    let mut last = None;
    let (mut n, mut sum, mut sum_x, mut sum_xx, mut sum_xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for k in (0..SUBCARRIERS).filter(|&k| csi[k] != Complex32::default()) {
        let x = f64::from(indices[k]);
        let phase = f64::from(csi[k].arg()) - slope * x;
        let phase = last.map_or(phase, |last| last + wrap_rad(phase - last));
        last = Some(phase);
        n += 1.0;
        sum += phase;
        sum_x += x;
        sum_xx += x * x;
        sum_xy += x * phase;
    }
    let spread = n * sum_xx - sum_x * sum_x;
    // Of a single subcarrier the line has no slope of its own.
    let rest = if spread > 0.0 { (n * sum_xy - sum_x * sum) / spread } else { 0.0 };
    let phase = (sum - rest * sum_x) / n;
    Some(Complex64::from_polar((f64::from(power) / SUBCARRIERS as f64).sqrt(), phase))
}

/// The round trip at the channel centre: [`at_centre`] of the product `forward[k] * backward[k]`, with the slopes of the two
/// directions removed one by one. No conjugate, so the path is in it twice and the CFO, which has opposite signs, cancels \[paper\]
/// \[wsr\].
///
/// Path and radios together turn one direction by about 0.8 rad from one reported subcarrier to the next and the product
/// by twice that (measured); taken one by one the slopes stay unambiguous up to 800 ns each way (about 180 m of path).
/// `None` if one of them is all zero.
#[must_use]
pub fn round_trip_at_centre(
    forward: &[Complex32; SUBCARRIERS],
    backward: &[Complex32; SUBCARRIERS],
    indices: &[i8; SUBCARRIERS],
) -> Option<Complex64> {
    let slope = slope(forward, indices) + slope(backward, indices);
    let product = std::array::from_fn(|k| forward[k] * backward[k]);
    centre(&product, indices, slope)
}

/// What one antenna heard of a frame.
pub(crate) type Heard = [Iq; SUBCARRIERS];

/// The round trip of each pair (forward, backward) at the channel centre, on `tier`; `None` of a pair of which one frame is
/// all zero.
pub(crate) fn round_trips_at_centre(
    pairs: &[[&Heard; 2]],
    indices: &[i8; SUBCARRIERS],
    tier: Tier,
) -> Vec<Option<Complex64>> {
    let mut found = Vec::with_capacity(pairs.len());
    on_tier!(tier.level_or_portable(), simd => centres(simd, pairs, indices, &mut found));
    found
}

/// One direction of a vector of pairs on one subcarrier, real and imaginary.
type Lane<S> = (V<S, f32>, V<S, f32>);

/// One direction of a vector of pairs on subcarrier `k`; lanes beyond them are zero.
#[inline(always)]
fn load<S: Simd>(simd: S, pairs: &[[&Heard; 2]], side: usize, k: usize) -> Lane<S> {
    let iq = |lane: usize| pairs.get(lane).map_or_else(Iq::default, |pair| pair[side][k]);
    let part = |lane: usize| f32::from(iq(lane).i);
    (V::<S, f32>::from_fn(simd, part), V::<S, f32>::from_fn(simd, |lane| f32::from(iq(lane).q)))
}

#[inline(always)]
fn centres<S: Simd>(simd: S, pairs: &[[&Heard; 2]], indices: &[i8; SUBCARRIERS], found: &mut Vec<Option<Complex64>>) {
    let zero = V::<S, f32>::splat(simd, 0.0);
    let usual = indices[1] - indices[0];
    for pairs in pairs.chunks(V::<S, f32>::LEN) {
        // Phase steps of the usual width, and the product of the directions: integers that single precision holds.
        let mut steps = [(zero, zero); 2];
        let mut before = [(zero, zero); 2];
        let mut products = [(zero, zero); SUBCARRIERS];
        for k in 0..SUBCARRIERS {
            let now = [load(simd, pairs, 0, k), load(simd, pairs, 1, k)];
            let (a, b) = (now[0], now[1]);
            products[k] = (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
            if k > 0 && indices[k] - indices[k - 1] == usual {
                for ((re, im), ((x, y), (u, v))) in steps.iter_mut().zip(now.into_iter().zip(before)) {
                    *re += x * u + y * v;
                    *im += y * u - x * v;
                }
            }
            before = now;
        }
        let [forward, backward] = steps.map(|(re, im)| turns_of(simd, re, im));
        let slope = (forward + backward) * V::<S, f32>::splat(simd, 1.0 / f32::from(usual));
        let (re, im, power) = line(simd, &products, indices, slope);
        found.extend((0..pairs.len()).map(|lane| {
            let h = Complex64::new(f64::from(re[lane]), f64::from(im[lane]));
            (power[lane] > 0.0).then_some(h)
        }));
    }
}

/// Least squares through the unwrapped phases of `products`, whose slope is about `slope` turns per index: the value at
/// index 0 of unit magnitude times the root mean square, and the power. A product of zero has no phase and no part in it.
#[inline(always)]
fn line<S: Simd>(
    simd: S,
    products: &[Lane<S>; SUBCARRIERS],
    indices: &[i8; SUBCARRIERS],
    slope: V<S, f32>,
) -> (V<S, f32>, V<S, f32>, V<S, f32>) {
    let splat = |value: f32| V::<S, f32>::splat(simd, value);
    let (zero, one) = (splat(0.0), splat(1.0));
    let [mut n, mut sum_x, mut sum_xx, mut sum, mut sum_xy, mut power, mut last] = [zero; 7];
    for ((re, im), index) in products.iter().zip(indices) {
        let x = splat(f32::from(*index));
        let own = *re * *re + *im * *im;
        let turns = turns_of(simd, *re, *im) - slope * x;
        let step = turns - last;
        let (is_heard, is_first) = (own.simd_gt(zero), n.simd_le(zero));
        let unwrapped = is_first.select(turns, last + (step - step.round_ties_even()));
        last = is_heard.select(unwrapped, last);
        let weight = is_heard.select(one, zero);
        power += own;
        n += weight;
        sum_x += weight * x;
        sum_xx += weight * x * x;
        sum += weight * last;
        sum_xy += weight * last * x;
    }
    // Of a single subcarrier the line has no slope of its own: its spread is 0, and so is what is divided by it.
    let rest = (sum_xy * n - sum * sum_x) / (n * sum_xx - sum_x * sum_x).max(one);
    let (sin, cos) = sin_cos_turns::<S, f32>(simd, (sum - rest * sum_x) / n.max(one));
    let size = (power * splat(1.0 / SUBCARRIERS as f32)).sqrt();
    (cos * size, sin * size, power)
}

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
    offsets_hz: Vec<f64>,
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
        let lines: Vec<DriftLine> = [2, 4, 8]
            .map(|parts| drift_line_by(clock_rx_us, difference_us, (n / parts).max(1)))
            .into_iter()
            .filter(|line| line.slope.abs() <= MAX_DRIFT)
            .collect();
        let terms = second_differences(z, clock_rx_us, difference_us);
        let total: f64 = terms.iter().map(|term| term.count).sum();
        if total < 4.0 {
            return None;
        }
        let coherence = |df_hz: f64| sum_at(&terms, df_hz).norm() / total;
        let (line, df_hz) = by_lines(&lines, &terms, carrier_hz, 2.0 * total.sqrt())?;
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

/// The offset near the drift by one of the lines, and that line: the first, unless the sum of the terms is greater by `gain`
/// with an offset that was not within its reach. `None` without lines.
///
/// A turn-around that steps by 140 us in the middle of 20 s tilts the first line by 14 ppm, 75 kHz of a carrier at 5.3 GHz.
fn by_lines(lines: &[DriftLine], terms: &[Term], carrier_hz: f64, gain: f64) -> Option<(DriftLine, f64)> {
    let mut searched: Vec<f64> = Vec::new();
    let mut best: Option<(f64, DriftLine, f64)> = None;
    for line in lines {
        let near_hz = line.slope * carrier_hz;
        if searched.iter().any(|hz| (hz - near_hz).abs() < 0.5 * SEARCH_HZ) {
            continue;
        }
        searched.push(near_hz);
        let df_hz = maximise(terms, near_hz, SEARCH_HZ);
        let sum = sum_at(terms, df_hz).norm();
        if best.as_ref().is_none_or(|(greatest, ..)| sum > greatest + gain) {
            best = Some((sum, *line, df_hz));
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

/// Outliers are further than this from the line, microseconds (the jitter is 4 to 22).
const OUTLIER_US: f64 = 25.0;

/// `value = middle + slope * (x - middle_x)`.
#[doc(hidden)] // for the crates of this workspace
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriftLine {
    /// Counts of drift per count of the clock.
    slope: f64,
    x: f64,
    y: f64,
}

impl DriftLine {
    /// The value at `x`.
    #[must_use]
    pub fn at(&self, x: f64) -> f64 {
        self.y + self.slope * (x - self.x)
    }
}

/// The drift of one card's clock against another's: a line through `difference_us` (their difference) over `clock_us` (one
/// of them), both unwrapped, microseconds, one entry per pair in time order.
///
/// The median of the slopes between pairs half a record apart (after Theil and Sen \[theil-sen\]), then least squares without
/// the pairs that are further than 25 us from the line, four times over.
#[doc(hidden)] // for the crates of this workspace
#[must_use]
pub fn drift_line(clock_us: &[i64], difference_us: &[i64]) -> DriftLine {
    drift_line_by(clock_us, difference_us, clock_us.len() / 2)
}

/// The same by the slopes between pairs `lag` apart. A turn-around that steps to another level tilts the line only if more than
/// half of them have the step between them, and the shorter they are the fewer have.
fn drift_line_by(clock_us: &[i64], difference_us: &[i64], lag: usize) -> DriftLine {
    let n = clock_us.len();
    let slope_between = |k: usize| {
        let run = (clock_us[k + lag] - clock_us[k]) as f64;
        (run > 0.0).then(|| (difference_us[k + lag] - difference_us[k]) as f64 / run)
    };
    let slope = median((0..n - lag).filter_map(slope_between).collect());
    let origin = clock_us[0] as f64;
    let y = median((0..n).map(|k| difference_us[k] as f64 - slope * (clock_us[k] as f64 - origin)).collect());
    let mut line = DriftLine { slope, x: origin, y };
    for _ in 0..4 {
        let is_near = |k: &usize| (difference_us[*k] as f64 - line.at(clock_us[*k] as f64)).abs() <= OUTLIER_US;
        let about = |k: usize| (clock_us[k] as f64 - origin, difference_us[k] as f64 - y);
        let near: Vec<(f64, f64)> = (0..n).filter(is_near).map(about).collect();
        if near.len() < 4 {
            break;
        }
        let (sx, sy) = near.iter().fold((0.0, 0.0), |(sx, sy), (x, y)| (sx + x, sy + y));
        let (mx, my) = (sx / near.len() as f64, sy / near.len() as f64);
        let (mut sxx, mut sxy) = (0.0, 0.0);
        for (x, y) in near {
            sxx += (x - mx) * (x - mx);
            sxy += (x - mx) * (y - my);
        }
        if sxx <= 0.0 {
            break;
        }
        line = DriftLine { slope: sxy / sxx, x: origin + mx, y: y + my };
    }
    line
}

/// The upper median; 0 if there are no values.
fn median(mut values: Vec<f64>) -> f64 {
    upper_median(&mut values).unwrap_or(0.0)
}

/// Second differences of the jitter beyond this are skipped, microseconds.
const MAX_SECOND_DIFFERENCE_US: i64 = 500;

/// Pairs that an offset of their own is searched in.
const BLOCK: usize = 200;

/// How far a block's offset is searched from that of all, Hz (2.4 kHz within six seconds).
const DRIFT_HZ: f64 = 4_000.0;

/// By how much a block's own offset must raise the sum of its unit phasors, on average (chance gives half of one).
const GAIN_PER_BLOCK: f64 = 2.0;

/// Step of the search, Hz (the coherence is 8 kHz wide).
const STEP_HZ: f64 = 400.0;
/// The same about its best. On 71 WSR links the vertex is within 0.15 Hz of golden sections.
const CLOSE_HZ: f64 = 50.0;

/// Unit second differences summed by the (integer) second difference of the turn-around that goes with them: the
/// histogram makes the search over `df` as cheap as the jitter is small.
struct Term {
    /// Second difference of the turn-around, whole microseconds.
    second_us: f64,
    /// Sum of the unit second differences of the phase.
    sum: Complex64,
    /// How many there are.
    count: f64,
}

/// The terms of a record, by rising second differences.
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

/// The sum of all terms with an offset of `df_hz` removed.
fn sum_at(terms: &[Term], df_hz: f64) -> Complex64 {
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
        let own_hz = maximise(&terms, df_hz, DRIFT_HZ);
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

/// The offset within `reach_hz` of `near_hz` at which the terms' sum is largest: the vertex of a parabola through the best of a
/// grid and its neighbours, and once more through three offsets closer together.
fn maximise(terms: &[Term], near_hz: f64, reach_hz: f64) -> f64 {
    let steps = (reach_hz / STEP_HZ) as i32;
    let from_hz = near_hz - f64::from(steps) * STEP_HZ;
    let mut turning = Turning::new(terms, from_hz, STEP_HZ);
    let mut best = (f64::NEG_INFINITY, near_hz);
    for k in 0..=2 * steps {
        let value = turning.next().norm_sqr();
        if value > best.0 {
            best = (value, from_hz + f64::from(k) * STEP_HZ);
        }
    }
    [STEP_HZ, CLOSE_HZ].into_iter().fold(best.1, |hz, step_hz| {
        let [before, here, after] = [-step_hz, 0.0, step_hz].map(|by| sum_at(terms, hz + by).norm_sqr());
        let bend = before - 2.0 * here + after;
        hz + if bend < 0.0 { step_hz * (0.5 * (before - after) / bend).clamp(-1.0, 1.0) } else { 0.0 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::channel::INDICES_20_MHZ as INDICES;

    #[test]
    fn angles_are_those_of_the_library() {
        fn all<S: Simd>(simd: S, points: &[Complex32]) -> Vec<f32> {
            let lane = |z: &Complex32| {
                let part = |value: f32| V::<S, f32>::splat(simd, value);
                turns_of(simd, part(z.re), part(z.im))[0]
            };
            points.iter().map(lane).collect()
        }
        let around = (0..4_000).map(|k| Complex32::from_polar(1.0 + k as f32, k as f32 * 0.001_571 - 3.1));
        let axes = [
            (0.0, 0.0),
            (1.0, 0.0),
            (0.0, 3.0),
            (0.0, -2.0),
            (-7.0, 0.0),
            (5.0, 5.0),
            (-5.0, 5.0),
            (-0.0, 0.0),
            (-0.0, -0.0),
        ];
        let points: Vec<Complex32> = around.chain(axes.map(|(re, im)| Complex32::new(re, im))).collect();
        for tier in Tier::available() {
            let found = on_tier!(tier.level_or_portable(), simd => all(simd, &points));
            for (z, turns) in points.iter().zip(found) {
                let expected = f64::from(z.im).atan2(f64::from(z.re)) / TAU;
                assert!((f64::from(turns) - expected).abs() < 1e-7, "{tier:?} {z} {turns} {expected}");
            }
        }
    }

    #[test]
    fn every_tier_gives_what_one_pair_at_a_time_gives() {
        let mut state = 5u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u32 << 24) as f32 - 0.5
        };
        // A wave with a slope and noise, quantised as the card does; every seventh is silent, and of every fifth some
        // subcarriers are, the first among them.
        let mut heard = |k: usize| -> Heard {
            let (phase, slope) = (6.0 * random(), 1.5 * random());
            std::array::from_fn(|s| {
                let noise = Complex32::new(random(), random()) * 12.0;
                let wave = Complex32::from_polar(50.0, phase + slope * f32::from(INDICES[s])) + noise;
                let is_silent = k % 7 == 3 || k % 5 == 1 && s % 4 == 0;
                if is_silent { Iq::default() } else { Iq { i: wave.re as i8, q: wave.im as i8 } }
            })
        };
        let frames: Vec<[Heard; 2]> = (0..203).map(|k| [heard(k), heard(k / 2)]).collect();
        let pairs: Vec<[&Heard; 2]> = frames.iter().map(|[forward, backward]| [forward, backward]).collect();
        let csi = |heard: &Heard| heard.map(|iq| Complex32::new(f32::from(iq.i), f32::from(iq.q)));
        let expected: Vec<Option<Complex64>> = frames
            .iter()
            .map(|[forward, backward]| round_trip_at_centre(&csi(forward), &csi(backward), &INDICES))
            .collect();
        assert!(expected.iter().flatten().count() > 100 && expected.iter().any(Option::is_none));
        for tier in Tier::available() {
            let found = round_trips_at_centre(&pairs, &INDICES, tier);
            assert_eq!(found.len(), expected.len());
            for (found, expected) in found.iter().zip(&expected) {
                match (found, expected) {
                    (Some(found), Some(expected)) => {
                        assert!((found - expected).norm() < 2e-5 * expected.norm(), "{tier:?} {found} {expected}");
                    }
                    _ => assert_eq!(found, expected),
                }
            }
        }
    }

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

    #[test]
    fn centre_phase_is_exact_for_any_delay_the_card_has() {
        let wave = |size: f32, phase: f32, slope: f32| {
            std::array::from_fn(|k| Complex32::from_polar(size, phase + slope * f32::from(INDICES[k])))
        };
        for slope in [-1.4f32, -0.81, -0.3, 0.0, 0.4, 0.9] {
            for phase in [-3.0f32, -1.0, 0.0, 2.5] {
                let one = at_centre(&wave(3.0, phase, slope), &INDICES).unwrap();
                assert!((one - Complex64::from_polar(3.0, f64::from(phase))).norm() < 1e-4, "{slope} {phase}");
                // Two such slopes together turn by more than pi from one reported subcarrier to the next.
                let both = round_trip_at_centre(&wave(1.0, phase, slope), &wave(3.0, 0.5, slope), &INDICES).unwrap();
                assert!((both - Complex64::from_polar(3.0, f64::from(phase) + 0.5)).norm() < 1e-4, "{slope} {phase}");
            }
        }
        assert_eq!(at_centre(&[Complex32::default(); SUBCARRIERS], &INDICES), None);
        assert_eq!(at_centre(&[Complex32::new(f32::NAN, 0.0); SUBCARRIERS], &INDICES), None);
    }

    #[test]
    fn a_subcarrier_at_zero_has_no_part_in_the_line() {
        let wave: [Complex32; SUBCARRIERS] =
            std::array::from_fn(|k| Complex32::from_polar(3.0, 2.0 + 0.3 * f32::from(INDICES[k])));
        for silent in [&[0][..], &[0, 1, 2], &[7], &[3, 4, 20, 29], &[29]] {
            let mut csi = wave;
            silent.iter().for_each(|k| csi[*k] = Complex32::default());
            let found = at_centre(&csi, &INDICES).unwrap();
            assert!((found.arg() - 2.0).abs() < 1e-5, "{silent:?} {found}");
            assert!((found.norm_sqr() - 9.0 * (30.0 - silent.len() as f64) / 30.0).abs() < 1e-4, "{silent:?} {found}");
        }
        // One alone gives its own phase.
        let mut csi = [Complex32::default(); SUBCARRIERS];
        csi[4] = Complex32::from_polar(1.0, 0.7);
        assert!((at_centre(&csi, &INDICES).unwrap().arg() - 0.7).abs() < 1e-6);
    }

    /// [`TurnAround::estimate`] with differences of whole microseconds.
    fn estimate(z: &[Complex64], clock_us: &[i64], difference_us: &[i64], carrier_hz: f64) -> Option<TurnAround> {
        let difference_us: Vec<f64> = difference_us.iter().map(|us| *us as f64).collect();
        TurnAround::estimate(z, clock_us, &difference_us, carrier_hz)
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
            let found = estimate(&z, &clock, &difference, 5.54e9).unwrap();
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
        assert!(estimate(&z, &clock, &difference, 5.54e9).unwrap().course.is_empty());
        // From -15 kHz on it drifts by 2.4 kHz; `d` is the jitter that `link` made.
        let extra_hz = |k: usize| -2_400.0 * k as f64 / 3_000.0;
        let drift = -15_000.0 / 5.54e9;
        for (k, z) in z.iter_mut().enumerate() {
            let d_us = difference[k] as f64 + 7e6 - (drift * (clock[k] - clock[0]) as f64).round();
            *z *= Complex64::cis(-TAU * extra_hz(k) * d_us * 1e-6);
        }
        let found = estimate(&z, &clock, &difference, 5.54e9).unwrap();
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

    /// A program that answers from user space goes over to another path for good, 140 us longer: the line through the clocks'
    /// differences is tilted by that, and the offset is far from where it points.
    #[test]
    fn a_turn_around_that_steps_hides_no_offset() {
        for step_at in [300, 450, 600] {
            let (mut z, clock, mut difference) = link(900, -16_000.0, -16_000.0 / 5_540.0);
            for (z, d) in z.iter_mut().zip(&mut difference).skip(step_at) {
                *d += 140;
                *z *= Complex64::cis(TAU * 16_000.0 * 140e-6);
            }
            let found = estimate(&z, &clock, &difference, 5.54e9).unwrap();
            assert!((found.df_hz + 16_000.0).abs() < 150.0, "{} with a step at {step_at}", found.df_hz);
            assert!(found.worthwhile && found.coherence_after > 0.98, "{found:?}");
            found.apply(&mut z);
            let (still, _, _) = link(900, 0.0, 0.0);
            let left: Complex64 = z.iter().zip(&still).map(|(a, b)| a * b.conj()).sum();
            assert!(left.norm() / z.len() as f64 > 0.98, "{left}");
        }
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
        estimate(&z, &clock, &difference, 5.54e9).unwrap().apply(&mut z);
        let left: Complex64 = z.iter().zip(&still).map(|(a, b)| a * b.conj()).sum();
        assert!(left.norm() / z.len() as f64 > 0.98, "{left}");
    }

    /// At 100 kHz a microsecond is a tenth of a turn: whole ones leave half a radian, ticks of 3.125 ns next to nothing.
    #[test]
    fn a_finer_clock_leaves_less_of_the_offset() {
        let df_hz = 100_000.0;
        let (mut z, clock, mut whole) = link(900, 0.0, df_hz / 5_540.0);
        let still = z.clone();
        let mut fine_us: Vec<f64> = whole.iter().map(|us| *us as f64).collect();
        let drift = df_hz / 5.54e9;
        for (k, (z, d)) in z.iter_mut().zip(&mut fine_us).enumerate() {
            // What `link` rounded, and a part of a microsecond beside it, in ticks of the FTM clock.
            let since_us = (clock[k] - clock[0]) as f64;
            let jitter_us = *d + 7e6 - drift * since_us + ((k * 97) % 320) as f64 / 320.0;
            *z *= Complex64::cis(-TAU * df_hz * jitter_us * 1e-6);
            *d = ((drift * since_us + jitter_us - 7e6) * 320.0).floor() / 320.0;
            whole[k] = d.floor() as i64;
        }
        let left = |found: &TurnAround| {
            let mut z = z.clone();
            found.apply(&mut z);
            let turned: Complex64 = z.iter().zip(&still).map(|(a, b)| a * b.conj()).sum();
            let turned = turned / turned.norm();
            let sum: f64 = z.iter().zip(&still).map(|(a, b)| (a * b.conj() * turned.conj()).arg().powi(2)).sum();
            (sum / z.len() as f64).sqrt()
        };
        let finely = left(&TurnAround::estimate(&z, &clock, &fine_us, 5.54e9).unwrap());
        let coarsely = left(&estimate(&z, &clock, &whole, 5.54e9).unwrap());
        assert!(finely < 0.3 * coarsely && coarsely > 0.15, "{finely} {coarsely}");
    }

    #[test]
    fn without_clocks_or_offset_nothing_is_done() {
        let (z, clock, difference) = link(500, 0.0, 1.0);
        assert!(!estimate(&z, &clock, &difference, 5.54e9).unwrap().worthwhile);
        let stopped = vec![4; z.len()];
        assert_eq!(estimate(&z, &stopped, &stopped, 5.54e9), None);
        assert_eq!(estimate(&z, &clock[1..], &difference, 5.54e9), None);
    }

    /// How steady the phase of `z` is from sample to sample, 0..1, whatever its slow course: the coherence of unit second
    /// differences. `None` with fewer than three samples.
    fn second_difference_coherence(z: &[Complex64]) -> Option<f64> {
        let unit = |w: &[Complex64]| {
            let product = w[0] * w[1].conj() * w[1].conj() * w[2];
            if product.norm() > 0.0 { product / product.norm() } else { Complex64::default() }
        };
        (z.len() >= 3).then(|| z.windows(3).map(unit).sum::<Complex64>().norm() / (z.len() - 2) as f64)
    }
}
