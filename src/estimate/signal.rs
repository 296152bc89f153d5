//! From aligned round trips to the two channels that the likelihood looks at.
//!
//! Each packet's sampling time turns its phases by a slope over the subcarriers, which the round trip keeps. [`align`] takes
//! out what differs from the neighbouring packets' slopes, in one step. [`take_roots`] makes the one-way channel out of the
//! round trip: the product of forward and backward channel is the square of one channel, so it also holds a wave midway
//! between each two paths that no source sends; its root holds the paths alone, but its sign is open for each packet and
//! subcarrier. [`Aperture`] then averages both over short stretches of the motion and keeps the strongest combinations of
//! subcarriers.

use super::tuning;
use crate::bartlett::Tier;
use crate::signal::channel::SUBCARRIERS;
use crate::signal::planes::{LANES, Lanes, Planes, lanes, sum};
use crate::signal::samples::Samples;
use csi5300_kernels::simd::{V, on_tier, sin_cos_turns};
use fearless_simd::{Simd, SimdBase};
use nalgebra::{DMatrix, SymmetricEigen, Vector3};
use num_complex::{Complex32, Complex64};
use std::f32::consts::TAU;

/// Combinations of subcarriers that the likelihood keeps of each channel: at 20 MHz they hold 98 % of the energy.
pub(crate) const COLUMNS: usize = 8;
/// Samples closer together than this along the motion are averaged, wavelengths: a wave straight ahead then loses 3 % of
/// the round trip's amplitude.
const BIN_WAVELENGTHS: f64 = 0.06;
/// The share of a round trip's amplitude that a wave loses by it at most.
pub(crate) const MEANS_LOSE: f64 = 0.03;
/// Means stand in for samples where on average at least so many samples make one, and there are at least so many means.
const SAMPLES_PER_MEAN: usize = 2;
const LEAST_MEANS: usize = 64;
/// The same for a search that only gives least squares a start: a steep wave, which turns less along the motion, loses an eighth of the power.
const START_WAVELENGTHS: f64 = 0.2;

/// Which subcarriers have their lower neighbour at the usual distance, and that distance in indices.
struct Comb {
    neighbours: Lanes,
    step: f32,
    index: Lanes,
}

impl Comb {
    fn new(indices: &[i8; SUBCARRIERS]) -> Self {
        let step = indices[1] - indices[0];
        let is_next = |k: usize| (1..SUBCARRIERS).contains(&k) && indices[k] - indices[k - 1] == step;
        Self {
            neighbours: lanes(|k| f32::from(is_next(k))),
            step: f32::from(step),
            index: lanes(|k| indices.get(k).map_or(0.0, |index| f32::from(*index))),
        }
    }

    /// `sum h[k] conj(h[k-1])` over neighbouring subcarriers.
    #[inline(always)]
    fn products(&self, row: &Planes) -> Complex32 {
        let mut before = Planes::ZERO;
        before.re[1..].copy_from_slice(&row.re[..LANES - 1]);
        before.im[1..].copy_from_slice(&row.im[..LANES - 1]);
        let product = row.against(&before);
        let chosen = |part: &Lanes| sum(&lanes(|k| part[k] * self.neighbours[k]));
        Complex32::new(chosen(&product.re), chosen(&product.im))
    }

    /// What takes a slope out of a row, radians per subcarrier index.
    #[inline(always)]
    fn turns<S: Simd>(&self, simd: S, slope: f32) -> Planes {
        let (mut turns, by) = (Planes::ZERO, V::<S, f32>::splat(simd, -slope / TAU));
        for from in (0..LANES).step_by(V::<S, f32>::LEN) {
            let own = from..from + V::<S, f32>::LEN;
            let (sin, cos) =
                sin_cos_turns::<S, f32>(simd, V::<S, f32>::from_slice(simd, &self.index[own.clone()]) * by);
            cos.store_slice(&mut turns.re[own.clone()]);
            sin.store_slice(&mut turns.im[own]);
        }
        turns
    }
}

/// Takes the slope that all rows have in common out of each: neighbouring subcarriers then differ by the channel only.
pub(crate) fn remove_slope(rows: &mut [Planes], indices: &[i8; SUBCARRIERS], tier: Tier) {
    let comb = Comb::new(indices);
    on_tier!(tier.level_or_portable(), simd => {
        let total: Complex32 = rows.iter().map(|row| comb.products(row)).sum();
        let turns = comb.turns(simd, total.arg() / comb.step);
        rows.iter_mut().for_each(|row| *row = row.times(&turns));
    });
}

/// Turns each row, in the order of time, to the mean slope of the rows about it. The phase at the channel centre stays.
/// Returns the standard deviation of the slopes that were removed, radians per subcarrier index.
pub(crate) fn align(rows: &mut [Planes], indices: &[i8; SUBCARRIERS], tier: Tier) -> f64 {
    let comb = Comb::new(indices);
    let products: Vec<Complex32> = on_tier!(tier.level_or_portable(), _simd => {
        rows.iter().map(|row| comb.products(row)).collect()
    });
    let common: Complex32 = products.iter().sum();
    let slopes: Vec<f32> = products.iter().map(|product| (product * common.conj()).arg() / comb.step).collect();
    let reach = tuning::SLOPE_PACKETS.min(slopes.len().saturating_sub(1)) as isize;
    let last = slopes.len() as isize - 1;
    // The ends are mirrored, so that a window is as long there.
    let mirrored = |k: isize| {
        slopes[(if k < 0 {
            -k
        } else if k > last {
            2 * last - k
        } else {
            k
        }) as usize]
    };
    let mut window: f32 = if slopes.is_empty() { 0.0 } else { (-reach..=reach).map(mirrored).sum() };
    let mut square = 0.0;
    on_tier!(tier.level_or_portable(), simd => {
        for (n, row) in rows.iter_mut().enumerate() {
            let n = n as isize;
            let own = mirrored(n) - window / (2 * reach + 1) as f32;
            *row = row.times(&comb.turns(simd, own));
            square += f64::from(own) * f64::from(own);
            if n < last {
                window += mirrored(n + 1 + reach) - mirrored(n - reach);
            }
        }
    });
    (square / slopes.len().max(1) as f64).sqrt()
}

/// Whether packets so far apart, in wavelengths, tell the signs of a one-way channel: motion towards the source by a
/// quarter of a wavelength turns it by a quarter of a circle, beyond which the other sign is nearer.
pub(crate) fn is_dense_enough(spacing_wavelengths: f64) -> bool {
    spacing_wavelengths < 0.25
}

/// Takes the square root of `rows` (round trips, common slope removed, in the order of time), its signs by continuity: along
/// the subcarriers of the first packet, then from a running mean of the packets before.
pub(crate) fn take_roots(rows: &mut [Planes], tier: Tier) {
    on_tier!(tier.level_or_portable(), _simd => {
        rows.iter_mut().for_each(root);
        track(rows);
    });
}

/// The square root with a positive real part, without the polar form.
#[inline(always)]
fn root(value: &mut Planes) {
    let sizes = value.sizes();
    for (k, size) in sizes.into_iter().enumerate() {
        let (re, im) = (value.re[k], value.im[k]);
        let large = (0.5 * (size + re.abs())).sqrt();
        let small = if large > 0.0 { 0.5 * im.abs() / large } else { 0.0 };
        value.re[k] = if re >= 0.0 { large } else { small };
        value.im[k] = (if re >= 0.0 { small } else { large }).copysign(im);
    }
}

#[inline(always)]
fn track(roots: &mut [Planes]) {
    let Some((first, others)) = roots.split_first_mut() else { return };
    for k in 1..SUBCARRIERS {
        let before = |plane: &Lanes| plane[k.saturating_sub(3)..k].iter().sum::<f32>();
        if first.re[k] * before(&first.re) + first.im[k] * before(&first.im) < 0.0 {
            (first.re[k], first.im[k]) = (-first.re[k], -first.im[k]);
        }
    }
    let mut predicted = *first;
    for row in others {
        for k in 0..LANES {
            let agrees = row.re[k] * predicted.re[k] + row.im[k] * predicted.im[k] >= 0.0;
            let sign = if agrees { 1.0 } else { -1.0 };
            (row.re[k], row.im[k]) = (sign * row.re[k], sign * row.im[k]);
            predicted.re[k] = predicted.re[k] * tuning::SIGN_MEMORY + row.re[k];
            predicted.im[k] = predicted.im[k] * tuning::SIGN_MEMORY + row.im[k];
        }
    }
}

/// Which samples are averaged.
pub(crate) struct Bins {
    /// The bin of each sample.
    pub of: Vec<usize>,
    counts: Vec<f64>,
}

impl Bins {
    /// By the distance driven along `points_m`.
    pub fn along(points_m: &[Vector3<f64>], wavelength_m: f64) -> Self {
        Self::every(BIN_WAVELENGTHS * wavelength_m, points_m).0
    }

    /// Longer bins than [`Bins::along`]'s, for a search that only gives least squares a start.
    pub fn for_start(points_m: &[Vector3<f64>], wavelength_m: f64) -> Self {
        Self::every(START_WAVELENGTHS * wavelength_m, points_m).0
    }

    /// A bin for each stretch of the way, and the way driven at each sample, metres.
    pub fn every(step_m: f64, points_m: &[Vector3<f64>]) -> (Self, Vec<f64>) {
        let (mut way_m, mut last) = (0.0, None);
        let (mut of, mut counts, mut driven_m) = (Vec::new(), Vec::new(), Vec::with_capacity(points_m.len()));
        for (k, point) in points_m.iter().enumerate() {
            way_m += if k > 0 { (point - points_m[k - 1]).norm() } else { 0.0 };
            let bin = (way_m / step_m) as usize;
            if last != Some(bin) {
                counts.push(0.0);
                last = Some(bin);
            }
            let own = counts.len() - 1;
            counts[own] += 1.0;
            of.push(own);
            driven_m.push(way_m);
        }
        (Self { of, counts }, driven_m)
    }

    /// By the distance driven, at most `step_m`, and by the time, at most `step_s`: a robot that stands gets bins, too.
    pub fn of_way_and_time((step_m, points_m): (f64, &[Vector3<f64>]), (step_s, times_s): (f64, &[f64])) -> Self {
        let (mut of, mut counts, mut start) = (Vec::with_capacity(points_m.len()), Vec::<f64>::new(), None);
        let mut way_m = 0.0;
        for (k, (point, t_s)) in points_m.iter().zip(times_s).enumerate() {
            way_m += if k > 0 { (point - points_m[k - 1]).norm() } else { 0.0 };
            let is_new = start.is_none_or(|(at_m, at_s)| way_m - at_m >= step_m || t_s - at_s >= step_s);
            if is_new {
                counts.push(0.0);
                start = Some((way_m, *t_s));
            }
            let own = counts.len() - 1;
            counts[own] += 1.0;
            of.push(own);
        }
        Self { of, counts }
    }

    pub fn len(&self) -> usize {
        self.counts.len()
    }

    /// The mean place of each bin, metres.
    pub fn points_m(&self, points_m: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let mut means = vec![Vector3::zeros(); self.len()];
        self.of.iter().zip(points_m).for_each(|(bin, point)| means[*bin] += point);
        means.iter_mut().zip(&self.counts).for_each(|(mean, count)| *mean /= *count);
        means
    }

    /// The mean of each bin's values.
    pub fn means_of(&self, values: &[f64]) -> Vec<f64> {
        let mut means = vec![0.0; self.len()];
        self.of.iter().zip(values).for_each(|(bin, value)| means[*bin] += value);
        means.iter_mut().zip(&self.counts).for_each(|(mean, count)| *mean /= count);
        means
    }

    /// The means of the samples, where there are enough of them and they are much fewer.
    pub fn means(&self, samples: &Samples, points_m: &[Vector3<f64>]) -> Option<Samples> {
        let is_dense = self.len() >= LEAST_MEANS && SAMPLES_PER_MEAN * self.len() <= samples.len();
        is_dense.then(|| self.samples(samples, points_m)).flatten()
    }

    /// The mean phasor of each bin.
    pub fn phasors(&self, z: &[Complex64]) -> Vec<Complex64> {
        let mut sums = vec![Complex64::ZERO; self.len()];
        self.of.iter().zip(z).for_each(|(bin, z)| sums[*bin] += z);
        sums.iter().zip(&self.counts).map(|(sum, count)| sum / *count).collect()
    }

    /// The weighted mean of the samples in each bin, with the weight of the bin. Displacements, `points_m`, become the
    /// receiver's positions, metres; the transmitter's are zero.
    pub fn samples(&self, samples: &Samples, points_m: &[Vector3<f64>]) -> Option<Samples> {
        let mut sums = vec![(0.0, Complex64::ZERO, Vector3::zeros()); self.len()];
        let each = samples.z().iter().zip(points_m).zip(samples.weight());
        for (bin, ((z, place), &weight)) in self.of.iter().zip(each) {
            let sum = &mut sums[*bin];
            *sum = (sum.0 + weight, sum.1 + weight * z, sum.2 + weight * place);
        }
        let mut means = Samples::new(samples.wavelength_m(), samples.path_gain()).ok()?;
        for (weight, z, place) in sums.into_iter().filter(|(weight, ..)| *weight > 0.0) {
            means.push_weighted(0.0, z / weight, place / weight, Vector3::zeros(), weight).ok()?;
        }
        Some(means)
    }

    fn rows<'a>(&self, rows: impl Iterator<Item = &'a Planes>) -> Vec<Planes> {
        let mut means = vec![Planes::ZERO; self.len()];
        self.of.iter().zip(rows).for_each(|(bin, row)| means[*bin].add(row));
        for (mean, count) in means.iter_mut().zip(&self.counts) {
            let by = 1.0 / *count as f32;
            *mean = Planes { re: lanes(|k| mean.re[k] * by), im: lanes(|k| mean.im[k] * by) };
        }
        means
    }
}

/// One channel along the motion, ready to be steered.
#[derive(Clone, Debug)]
pub(crate) struct Aperture {
    /// How many times a path's phase is in it: 2 for a round trip, 1 one way.
    pub path_gain: u8,
    /// Its strongest combinations of subcarriers at each place: real parts, then imaginary ones.
    pub rows: Vec<[f32; 2 * COLUMNS]>,
    /// Its energy at each place, over all subcarriers.
    pub energy: Vec<f64>,
}

impl Aperture {
    /// `rows` of all subcarriers, averaged by `bins`.
    pub fn of_subcarriers<'a>(rows: impl Iterator<Item = &'a Planes>, bins: &Bins, path_gain: u8, tier: Tier) -> Self {
        let means = bins.rows(rows);
        let energy = means.iter().map(|row| row.sizes().iter().map(|v| f64::from(v * v)).sum()).collect();
        let basis = strongest(&means, tier);
        let mut rows = vec![[0.0; 2 * COLUMNS]; means.len()];
        on_tier!(tier.level_or_portable(), _simd => {
            for (out, row) in rows.iter_mut().zip(&means) {
                for (column, own) in basis.iter().enumerate() {
                    let part = row.times(own).sum();
                    (out[column], out[COLUMNS + column]) = (part.re, part.im);
                }
            }
        });
        Self { path_gain, rows, energy }
    }

    /// One phasor for each sample, averaged by `bins`.
    pub fn of_phasors(z: &[Complex64], bins: &Bins, path_gain: u8) -> Self {
        let means = bins.phasors(z);
        let row = |z: &Complex64| {
            let mut out = [0.0; 2 * COLUMNS];
            (out[0], out[COLUMNS]) = (z.re as f32, z.im as f32);
            out
        };
        let energy = means.iter().map(Complex64::norm_sqr).collect();
        Self { path_gain, rows: means.iter().map(row).collect(), energy }
    }
}

/// The eigenvectors of the greatest eigenvalues of `sum row^H row`.
fn strongest(rows: &[Planes], tier: Tier) -> Vec<Planes> {
    const WHOLE: usize = 8;
    let mut scatter = DMatrix::<Complex32>::zeros(SUBCARRIERS, SUBCARRIERS);
    let mut sums = vec![Planes::ZERO; SUBCARRIERS];
    on_tier!(tier.level_or_portable(), _simd => {
        for row in rows {
            // Of a matrix that is its own adjoint what is right of the diagonal is enough; whole vectors are summed.
            for (k, sum) in sums.iter_mut().enumerate() {
                let (re, im) = (row.re[k], -row.im[k]);
                for i in k / WHOLE * WHOLE..LANES {
                    sum.re[i] += re * row.re[i] - im * row.im[i];
                    sum.im[i] += re * row.im[i] + im * row.re[i];
                }
            }
        }
    });
    for (k, sum) in sums.iter().enumerate() {
        for i in k..SUBCARRIERS {
            scatter[(k, i)] = Complex32::new(sum.re[i], sum.im[i]);
            scatter[(i, k)] = scatter[(k, i)].conj();
        }
    }
    let eigen = SymmetricEigen::new(scatter);
    let mut order: Vec<usize> = (0..SUBCARRIERS).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let column = |&k: &usize| {
        let vector = eigen.eigenvectors.column(k);
        let own = |k: usize| vector.get(k).copied().unwrap_or_default();
        Planes { re: lanes(|k| own(k).re), im: lanes(|k| own(k).im) }
    };
    order.iter().take(COLUMNS).map(column).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::channel::INDICES_20_MHZ;

    fn planes(row: impl Fn(usize) -> Complex32) -> Planes {
        let own = |k: usize| if k < SUBCARRIERS { row(k) } else { Complex32::default() };
        Planes { re: lanes(|k| own(k).re), im: lanes(|k| own(k).im) }
    }

    fn value(row: &Planes, k: usize) -> Complex32 {
        Complex32::new(row.re[k], row.im[k])
    }

    fn random() -> impl FnMut() -> f32 {
        let mut state = 7u64;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u32 << 24) as f32 - 0.5
        }
    }

    /// Packets along a path of two rays.
    fn channel(t: usize, k: usize) -> Complex32 {
        let (t, x) = (t as f32, f32::from(INDICES_20_MHZ[k]));
        Complex32::cis(0.05 * t - 0.1 * x) + Complex32::from_polar(0.4, -0.04 * t - 0.13 * x)
    }

    #[test]
    fn packets_are_turned_to_a_common_slope_and_keep_their_centre_phase() {
        let mut random = random();
        let slopes: Vec<f32> = (0..300).map(|_| 0.3 * random()).collect();
        let jittered = |t: usize| planes(|k| channel(t, k) * Complex32::cis(-slopes[t] * f32::from(INDICES_20_MHZ[k])));
        for tier in Tier::available() {
            let mut rows: Vec<Planes> = (0..300).map(jittered).collect();
            remove_slope(&mut rows, &INDICES_20_MHZ, tier);
            let sd_rad = align(&mut rows, &INDICES_20_MHZ, tier);
            remove_slope(&mut rows, &INDICES_20_MHZ, tier);
            assert!((sd_rad - 0.3 / 12f64.sqrt()).abs() < 0.02, "{tier:?} {sd_rad}");
            let mut edges = Complex32::default();
            for (t, row) in rows.iter().enumerate() {
                let centre = value(row, 14) * channel(t, 14).conj() + value(row, 15) * channel(t, 15).conj();
                assert!(centre.arg().abs() < 0.15, "{t}: {centre}");
                let edge = value(row, 29) * channel(t, 29).conj() * centre.conj();
                edges += edge / edge.norm();
            }
            // At the edge of the band slopes of 0.09 radians per index turn by 2.4 radians: the mean phasor would be 0.1.
            assert!(edges.norm() / 300.0 > 0.8, "{tier:?} {edges}");
        }
    }

    #[test]
    fn two_paths_come_back_out_of_their_square() {
        let truth = |t: usize| planes(|k| channel(t, k));
        let mut rows: Vec<Planes> = (0..600).map(truth).map(|row| row.times(&row)).collect();
        take_roots(&mut rows, Tier::detect());
        let (mut alike, mut power) = (Complex32::default(), 0.0);
        for (t, row) in rows.iter().enumerate() {
            for k in 0..SUBCARRIERS {
                alike += value(row, k) * channel(t, k).conj();
                power += channel(t, k).norm_sqr();
            }
        }
        assert!(alike.norm() / power > 0.99, "{}", alike.norm() / power);
    }

    #[test]
    fn roots_are_those_of_the_polar_form() {
        for k in 0..64 {
            let expected = Complex32::from_polar(0.1 + 0.3 * k as f32, 0.1 * k as f32 - 3.1);
            let mut row = planes(|_| expected);
            root(&mut row);
            assert!((value(&row, 5) - expected.sqrt()).norm() < 1e-5, "{expected}");
        }
        let mut silent = Planes::ZERO;
        root(&mut silent);
        assert_eq!(silent, Planes::ZERO);
    }

    #[test]
    fn averages_keep_the_energy_that_eight_columns_hold() {
        let points: Vec<Vector3<f64>> = (0..400).map(|t| Vector3::new(0.001 * f64::from(t), 0.0, 0.0)).collect();
        let bins = Bins::along(&points, 0.054);
        assert!(bins.len() > 110 && bins.len() < 140, "{}", bins.len());
        let rows: Vec<Planes> = (0..400).map(|t| planes(|k| channel(t, k))).collect();
        let aperture = Aperture::of_subcarriers(rows.iter(), &bins, 2, Tier::detect());
        let kept: f64 = aperture.rows.iter().flatten().map(|v| f64::from(v * v)).sum();
        let all: f64 = aperture.energy.iter().sum();
        assert!(kept / all > 0.999 && kept / all < 1.0 + 1e-5, "{kept} of {all}");
        assert!(Bins::along(&[], 0.054).len() == 0 && align(&mut [], &INDICES_20_MHZ, Tier::detect()) == 0.0);
    }
}
