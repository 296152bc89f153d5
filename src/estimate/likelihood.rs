//! The likelihood of one spherical wave.
//!
//! Along a window of the motion, a wave from `q` with an unknown complex amplitude on each column of the channel leaves the
//! share `1 - rho` of the energy. With the amplitudes and the noise's variance at their most likely values the likelihood of
//! `N` independent samples is `(1 - rho)^-N`. Odometry and reflections keep a wave coherent over an unknown part of the
//! motion, so its logarithm is averaged over windows of the whole motion, halves, quarters and eighths, and over the channels:
//!
//! `ln L = mean over channels and window lengths of (N - windows) (-ln(1 - rho))`.

use super::signal::{Aperture, COLUMNS};
use super::tuning;
use crate::bartlett::{Tier, direction};
use crate::signal::samples::Samples;
use csi5300_kernels::simd::{V, on_tier, sin_cos_turns};
use fearless_simd::{Level, Simd, SimdBase, SimdFloat, f32x8};
use nalgebra::Vector3;
use num_complex::Complex64;
use std::ops::Range;

/// Lanes of the widest vector: `f32` of 512 bits.
pub(crate) const WIDEST: usize = 16;

/// Where a wave may come from, seen from the middle of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    /// Azimuth, radians.
    pub azimuth: f64,
    /// Elevation, radians; at least 0 where only its magnitude shows.
    pub elevation: f64,
    /// 1 / range, 1/m; 0 is a plane wave.
    pub curve: f64,
}

impl Place {
    /// The unit vector towards it.
    pub fn towards(&self) -> Vector3<f64> {
        direction(self.azimuth, self.elevation)
    }

    /// By how much the way from it to a point is longer than to the middle, metres: `|u / c - p| - 1 / c` without the difference of
    /// two large numbers; of a plane wave, `c = 0`, it is `-u.p`.
    pub fn ways_m(&self) -> impl Fn(&Vector3<f64>) -> f64 + use<> {
        let (towards, curve) = (self.towards(), self.curve);
        move |p| {
            let bend = curve * p.norm_squared() - 2.0 * towards.dot(p);
            bend / ((1.0 + curve * bend).max(0.0).sqrt() + 1.0)
        }
    }
}

/// The ways that samples hold: to a point, less the way to its foot if there are feet. Each part, up to the next of `ends`, has a phase
/// of its own; without ends there is one part.
#[derive(Clone, Copy)]
pub(crate) struct Ways<'a> {
    /// Displacements about the middle, metres.
    pub points: &'a [Vector3<f64>],
    pub feet: &'a [Vector3<f64>],
    pub ends: &'a [usize],
}

impl<'a> Ways<'a> {
    pub fn to(points: &'a [Vector3<f64>]) -> Self {
        Self { points, feet: &[], ends: &[] }
    }

    /// A function of each point less that of its foot.
    pub fn each<T: std::ops::Sub<Output = T>>(self, of: impl Fn(&Vector3<f64>) -> T) -> impl Iterator<Item = T> {
        self.points.iter().enumerate().map(move |(k, point)| match self.feet.get(k) {
            Some(foot) => of(point) - of(foot),
            None => of(point),
        })
    }

    /// The samples of each part.
    pub fn parts(self) -> impl Iterator<Item = Range<usize>> {
        let ends = if self.ends.is_empty() { vec![self.points.len()] } else { self.ends.to_vec() };
        let starts = std::iter::once(0).chain(ends.clone());
        starts.zip(ends).map(|(from, to)| from..to)
    }

    /// The share of the samples' power that a wave from a place explains.
    pub fn explained(self, samples: &Samples, place: &Place) -> f64 {
        let turned = self.turned(samples, place);
        let sum: f64 = self.parts().map(|part| turned[part].iter().sum::<Complex64>().norm()).sum();
        let full: f64 = samples.z().iter().map(|z| z.norm()).sum();
        (sum / full).powi(2)
    }

    /// What a wave from a place leaves of the samples' phases, about the mean of each part, radians.
    pub fn residuals_rad(self, samples: &Samples, place: &Place) -> Vec<f64> {
        let turned = self.turned(samples, place);
        let about_mean = |part: Range<usize>| {
            let mean: Complex64 = turned[part.clone()].iter().sum();
            turned[part].iter().map(move |z| (z * mean.conj()).arg()).collect::<Vec<f64>>()
        };
        self.parts().flat_map(about_mean).collect()
    }

    /// The samples without the phases of the ways from a place.
    pub fn turned(self, samples: &Samples, place: &Place) -> Vec<Complex64> {
        let ways_m = self.each(place.ways_m());
        samples.z().iter().zip(ways_m).map(|(z, way_m)| z * Complex64::cis(samples.kappa() * way_m)).collect()
    }
}

/// A motion and its channels, ready for any place.
#[derive(Clone)]
pub(crate) struct Field {
    points: Axes,
    /// The feet of the points, of a [`Ways`] that has them.
    feet: Option<Axes>,
    apertures: Vec<Own>,
    /// Ends of the shortest windows, the first being 0.
    cuts: Vec<usize>,
    /// Independent samples left by each window length's amplitudes, the longest first.
    freedom: Vec<f64>,
    wavelength_m: f64,
    level: Level,
}

/// Displacements from the middle and their squares, in wavelengths, with zeros up to whole vectors of any width.
#[derive(Clone, Default)]
struct Axes {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    square: Vec<f32>,
}

impl Axes {
    fn set(&mut self, points_m: &[Vector3<f64>], wavelength_m: f64) {
        let whole = points_m.len().next_multiple_of(WIDEST);
        let fill = |axis: &mut Vec<f32>, of: &dyn Fn(&Vector3<f64>) -> f64| {
            axis.clear();
            axis.extend(points_m.iter().map(|p| of(p) as f32));
            axis.resize(whole, 0.0);
        };
        fill(&mut self.x, &|p| p.x / wavelength_m);
        fill(&mut self.y, &|p| p.y / wavelength_m);
        fill(&mut self.z, &|p| p.z / wavelength_m);
        fill(&mut self.square, &|p| p.norm_squared() / (wavelength_m * wavelength_m));
    }
}

#[derive(Clone)]
struct Own {
    aperture: Aperture,
    /// What a wave that explains everything would give at each window length.
    full: Vec<f64>,
}

impl Field {
    /// `points_m` are displacements about the middle of the motion. `independent` is the number of independent samples.
    /// `lengths` is the number of window lengths: 1 is the whole motion alone.
    pub fn new(
        points_m: &[Vector3<f64>],
        apertures: Vec<Aperture>,
        wavelength_m: f64,
        independent: f64,
        lengths: usize,
        tier: Tier,
    ) -> Self {
        let mut field =
            Self::over(&[points_m], apertures, wavelength_m, independent, lengths, tier.level_or_portable());
        field.set_points(points_m);
        field
    }

    /// The same of an array on a robot that drives.
    pub fn of_array(ways: Ways<'_>, apertures: Vec<Aperture>, wavelength_m: f64, independent: f64, tier: Tier) -> Self {
        let arms: Vec<Vector3<f64>> = ways.each(|p| *p).collect();
        let parts: Vec<&[Vector3<f64>]> = ways.parts().map(|part| &arms[part]).collect();
        let level = tier.level_or_portable();
        let mut field = Self::over(&parts, apertures, wavelength_m, independent, tuning::WINDOW_LENGTHS, level);
        field.set_points(ways.points);
        field.feet.get_or_insert_default().set(ways.feet, wavelength_m);
        field
    }

    /// Channels and windows, without points.
    fn over(
        parts_m: &[&[Vector3<f64>]],
        apertures: Vec<Aperture>,
        wavelength_m: f64,
        independent: f64,
        lengths: usize,
        level: Level,
    ) -> Self {
        let mut cuts = vec![0];
        for part in parts_m {
            let (from, count) = (cuts[cuts.len() - 1], part.len());
            let path_m: f64 = part.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
            // A motion longer than stays coherent is more than one of the longest windows.
            let longest = (path_m / tuning::COHERENT_M).ceil().max(1.0) as usize;
            let blocks = (longest << (lengths - 1)).min(count.max(1));
            cuts.extend((1..=blocks).map(|k| from + (k * count + blocks / 2) / blocks));
        }
        let blocks = cuts.len() - 1;
        let windows = |length: usize| blocks.div_ceil(1 << (lengths - 1 - length));
        let freedom = (0..lengths).map(|length| (independent - windows(length) as f64).max(0.0)).collect();
        let own = |aperture: Aperture| {
            let full = full_of_each(&aperture.energy, &cuts, lengths);
            Own { aperture, full }
        };
        let apertures = apertures.into_iter().map(own).collect();
        Self { points: Axes::default(), feet: None, apertures, cuts, freedom, wavelength_m, level }
    }

    /// The same channels and windows along other points.
    pub fn set_points(&mut self, points_m: &[Vector3<f64>]) {
        self.points.set(points_m, self.wavelength_m);
    }

    /// The same channels after a wave from a place is taken out. Its complex amplitude is estimated anew in each of the shortest windows.
    pub fn without(&self, place: &Place) -> Self {
        let (mut rest, mut work) = (self.clone(), Work::new(self.points.x.len(), self.cuts.len()));
        on_tier!(self.level, simd => self.steer(simd, place, &mut work));
        for own in &mut rest.apertures {
            let Aperture { path_gain, rows, energy } = &mut own.aperture;
            let (cos, sin) = if *path_gain == 1 { (&work.cos, &work.sin) } else { (&work.cos2, &work.sin2) };
            for cut in self.cuts.windows(2) {
                let (rows, cos, sin) = (&mut rows[cut[0]..cut[1]], &cos[cut[0]..cut[1]], &sin[cut[0]..cut[1]]);
                let sum = on_tier!(self.level, simd => window(simd, rows, cos, sin));
                let mean = sum.map(|part| part / rows.len().max(1) as f32);
                for ((row, cos), sin) in rows.iter_mut().zip(cos).zip(sin) {
                    for k in 0..COLUMNS {
                        row[k] -= mean[k] * cos + mean[COLUMNS + k] * sin;
                        row[COLUMNS + k] -= mean[COLUMNS + k] * cos - mean[k] * sin;
                    }
                }
                let taken: f32 = mean.iter().map(|part| part * part).sum();
                energy[cut[0]..cut[1]].iter_mut().for_each(|energy| *energy -= f64::from(taken));
            }
            own.full = full_of_each(energy, &self.cuts, self.freedom.len());
        }
        rest
    }

    /// `ln L` of each place.
    pub fn log_likelihoods(&self, places: &[Place]) -> Vec<f64> {
        let mut work = Work::new(self.points.x.len(), self.cuts.len());
        let mut rho = vec![0.0; self.apertures.len() * self.freedom.len()];
        let mut log_of = |place: &Place| {
            on_tier!(self.level, simd => self.shares(simd, place, &mut work, &mut rho));
            self.log_of(&rho)
        };
        places.iter().map(&mut log_of).collect()
    }

    /// `|sum z e|^2` of each place, of one phasor `z` for each point with its path `path_gain` times, summed over windows of so many
    /// blocks of [`WIDEST`] points.
    pub fn powers(&self, z: &[Complex64], path_gain: u8, places: &[Place], blocks: usize) -> Vec<f64> {
        let part = |of: fn(&Complex64) -> f64| {
            let mut part: Vec<f32> = z.iter().map(|z| of(z) as f32).collect();
            part.resize(self.points.x.len(), 0.0);
            part
        };
        let (re, im) = (part(|z| z.re), part(|z| z.im));
        let mut work = Work::new(self.points.x.len(), self.cuts.len());
        let points = blocks.saturating_mul(WIDEST);
        let mut power = |place: &Place| {
            on_tier!(self.level, simd => {
                self.steer(simd, place, &mut work);
                let (cos, sin) = if path_gain == 1 { (&work.cos, &work.sin) } else { (&work.cos2, &work.sin2) };
                let windows = re.chunks(points).zip(im.chunks(points)).zip(cos.chunks(points).zip(sin.chunks(points)));
                windows.map(|((re, im), (cos, sin))| along(simd, [re, im], [cos, sin])).sum()
            })
        };
        places.iter().map(&mut power).collect()
    }

    fn log_of(&self, rho: &[f64]) -> f64 {
        let log = |(rho, freedom): (&f64, &f64)| -freedom * (1.0 - rho.min(1.0 - 1e-7)).ln();
        rho.iter().zip(self.freedom.iter().cycle()).map(log).sum::<f64>() / rho.len().max(1) as f64
    }

    /// The share that a wave from `place` explains: `shares[channel * lengths + length]`, the longest windows first.
    #[inline(always)]
    fn shares<S: Simd>(&self, simd: S, place: &Place, work: &mut Work, shares: &mut [f64]) {
        self.steer(simd, place, work);
        let lengths = self.freedom.len();
        for (own, shares) in self.apertures.iter().zip(shares.chunks_mut(lengths)) {
            let (cos, sin) =
                if own.aperture.path_gain == 1 { (&work.cos, &work.sin) } else { (&work.cos2, &work.sin2) };
            for (slot, cut) in work.sums.iter_mut().zip(self.cuts.windows(2)) {
                let inside = cut[0]..cut[1];
                *slot = window(simd, &own.aperture.rows[inside.clone()], &cos[inside.clone()], &sin[inside]);
            }
            let mut blocks = self.cuts.len() - 1;
            for length in (0..lengths).rev() {
                let mut power = f32x8::splat(simd, 0.0);
                for sum in &work.sums[..blocks] {
                    let (re, im) = (f32x8::from_slice(simd, &sum[..COLUMNS]), f32x8::from_slice(simd, &sum[COLUMNS..]));
                    power = re.mul_add(re, im.mul_add(im, power));
                }
                let power: f32 = power.as_slice().iter().sum();
                shares[length] = if own.full[length] > 0.0 { f64::from(power) / own.full[length] } else { 0.0 };
                let halves = blocks.div_ceil(2);
                for k in 0..halves {
                    let mut joined = work.sums[2 * k];
                    if 2 * k + 1 < blocks {
                        joined.iter_mut().zip(work.sums[2 * k + 1]).for_each(|(a, b)| *a += b);
                    }
                    work.sums[k] = joined;
                }
                blocks = halves;
            }
        }
    }

    /// `exp(j 2 pi (|q - p| - r) / lambda)` of every sample, and its square: what undoes the path one way and both ways.
    #[inline(always)]
    fn steer<S: Simd>(&self, simd: S, place: &Place, work: &mut Work) {
        let ((sin_a, cos_a), (sin_e, cos_e)) = (place.azimuth.sin_cos(), place.elevation.sin_cos());
        let splat = |value: f64| V::<S, f32>::splat(simd, value as f32);
        let towards = [splat(-2.0 * cos_e * cos_a), splat(-2.0 * cos_e * sin_a), splat(-2.0 * sin_e)];
        let (curve, one) = (splat(place.curve * self.wavelength_m), splat(1.0));
        let lanes = V::<S, f32>::LEN;
        let count = self.points.x.len();
        let mut from = 0;
        while from < count {
            let mut turns = way(simd, &self.points, from, towards, curve);
            if let Some(feet) = &self.feet {
                turns -= way(simd, feet, from, towards, curve);
            }
            let (sin, cos) = sin_cos_turns::<S, f32>(simd, turns);
            let twice_sin = sin * cos;
            (cos).store_slice(&mut work.cos[from..from + lanes]);
            (sin).store_slice(&mut work.sin[from..from + lanes]);
            (one - (sin * sin + sin * sin)).store_slice(&mut work.cos2[from..from + lanes]);
            (twice_sin + twice_sin).store_slice(&mut work.sin2[from..from + lanes]);
            from += lanes;
        }
    }
}

/// By how much ways to points from `from` on are longer than to the middle, wavelengths; `towards` is -2 times the unit vector.
#[inline(always)]
fn way<S: Simd>(simd: S, axes: &Axes, from: usize, towards: [V<S, f32>; 3], curve: V<S, f32>) -> V<S, f32> {
    let load = |values: &[f32]| V::<S, f32>::from_slice(simd, &values[from..from + V::<S, f32>::LEN]);
    let ([x, y, z], one) = (towards, V::<S, f32>::splat(simd, 1.0));
    let along = load(&axes.x).mul_add(x, load(&axes.y).mul_add(y, load(&axes.z) * z));
    let bend = load(&axes.square).mul_add(curve, along);
    let ratio = curve.mul_add(bend, one).max(V::<S, f32>::splat(simd, 0.0)).sqrt();
    bend / (ratio + one)
}

/// `sum over windows of (samples in it) (energy in it)`: what a wave that explains everything would give.
fn full(energy: &[f64], cuts: &[usize], blocks: usize) -> f64 {
    let count = cuts.len() - 1;
    let ends = (0..count).step_by(blocks).map(|k| (cuts[k], cuts[(k + blocks).min(count)]));
    ends.map(|(from, to)| (to - from) as f64 * energy[from..to].iter().sum::<f64>()).sum()
}

/// The same at each of so many window lengths, the longest first.
fn full_of_each(energy: &[f64], cuts: &[usize], lengths: usize) -> Vec<f64> {
    (0..lengths).map(|length| full(energy, cuts, 1 << (lengths - 1 - length))).collect()
}

/// What one place needs for a moment.
struct Work {
    cos: Vec<f32>,
    sin: Vec<f32>,
    cos2: Vec<f32>,
    sin2: Vec<f32>,
    sums: Vec<[f32; 2 * COLUMNS]>,
}

impl Work {
    fn new(count: usize, cuts: usize) -> Self {
        let zeros = || vec![0.0; count.next_multiple_of(WIDEST)];
        Self { cos: zeros(), sin: zeros(), cos2: zeros(), sin2: zeros(), sums: vec![[0.0; 2 * COLUMNS]; cuts] }
    }
}

/// Adds a row to the sums of `re cos`, `im sin`, `re sin` and `im cos`. A closure in its place would not always be inlined
/// into the code for AVX; each vector operation is then a call.
#[inline(always)]
fn add<S: Simd>(simd: S, sums: &mut [f32x8<S>; 4], row: &[f32; 2 * COLUMNS], cos: f32, sin: f32) {
    let (re, im) = (f32x8::from_slice(simd, &row[..COLUMNS]), f32x8::from_slice(simd, &row[COLUMNS..]));
    let (cos, sin) = (f32x8::splat(simd, cos), f32x8::splat(simd, sin));
    sums[0] = re.mul_add(cos, sums[0]);
    sums[1] = im.mul_add(sin, sums[1]);
    sums[2] = re.mul_add(sin, sums[2]);
    sums[3] = im.mul_add(cos, sums[3]);
}

/// `|sum z e|^2` of whole vectors.
#[inline(always)]
fn along<S: Simd>(simd: S, [re, im]: [&[f32]; 2], [cos, sin]: [&[f32]; 2]) -> f64 {
    let lanes = V::<S, f32>::LEN;
    let mut sums = [V::<S, f32>::splat(simd, 0.0); 2];
    for from in (0..re.len()).step_by(lanes) {
        let load = |values: &[f32]| V::<S, f32>::from_slice(simd, &values[from..from + lanes]);
        let (re, im, cos, sin) = (load(re), load(im), load(cos), load(sin));
        sums[0] = re.mul_add(cos, sums[0]) - im * sin;
        sums[1] = re.mul_add(sin, im.mul_add(cos, sums[1]));
    }
    sums.iter().map(|sum| f64::from(sum.as_slice().iter().sum::<f32>()).powi(2)).sum()
}

/// `sum row e` over a window, column by column.
#[inline(always)]
fn window<S: Simd>(simd: S, rows: &[[f32; 2 * COLUMNS]], cos: &[f32], sin: &[f32]) -> [f32; 2 * COLUMNS] {
    // Two rows at a time, four sums each: no sum waits for another.
    let mut sums = [[f32x8::splat(simd, 0.0); 4]; 2];
    let (two_rows, last_row) = rows.as_chunks::<2>();
    let ((two_cos, last_cos), (two_sin, last_sin)) = (cos.as_chunks::<2>(), sin.as_chunks::<2>());
    for ((rows, cos), sin) in two_rows.iter().zip(two_cos).zip(two_sin) {
        add(simd, &mut sums[0], &rows[0], cos[0], sin[0]);
        add(simd, &mut sums[1], &rows[1], cos[1], sin[1]);
    }
    for ((row, cos), sin) in last_row.iter().zip(last_cos).zip(last_sin) {
        add(simd, &mut sums[0], row, *cos, *sin);
    }
    let [[re_cos, im_sin, re_sin, im_cos], odd] = sums;
    let mut out = [0.0; 2 * COLUMNS];
    ((re_cos + odd[0]) - (im_sin + odd[1])).store_slice(&mut out[..COLUMNS]);
    ((re_sin + odd[2]) + (im_cos + odd[3])).store_slice(&mut out[COLUMNS..]);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::signal::Bins;
    use std::f64::consts::TAU;

    const WAVELENGTH_M: f64 = 0.054;

    fn arc(count: usize) -> Vec<Vector3<f64>> {
        let at = |k: usize| {
            let (sin, cos) = (2.5 * k as f64 / count as f64).sin_cos();
            Vector3::new(0.4 * cos, 0.4 * sin, 0.01 * k as f64 / count as f64)
        };
        let points: Vec<Vector3<f64>> = (0..count).map(at).collect();
        let middle = points.iter().sum::<Vector3<f64>>() / count as f64;
        points.iter().map(|p| p - middle).collect()
    }

    /// A wave from `place` with another one, as a phasor for each point.
    fn heard(points: &[Vector3<f64>], place: &Place, gain: f64) -> Vec<Complex64> {
        let wave = |p: &Vector3<f64>, place: &Place| Complex64::cis(-TAU * gain * way(p, place) / WAVELENGTH_M);
        let other = Place { azimuth: place.azimuth + 1.9, ..*place };
        points.iter().map(|p| wave(p, place) + 0.5 * wave(p, &other)).collect()
    }

    fn way(p: &Vector3<f64>, place: &Place) -> f64 {
        let u = crate::bartlett::direction(place.azimuth, place.elevation);
        if place.curve > 0.0 { (u / place.curve - p).norm() - 1.0 / place.curve } else { -u.dot(p) }
    }

    /// The formula of this file, slowly: one column, in double.
    fn slow(points: &[Vector3<f64>], channels: &[(Vec<Complex64>, f64)], place: &Place, independent: f64) -> f64 {
        let (count, mut sum) = (points.len(), 0.0);
        for (z, gain) in channels {
            for length in 0..4u32 {
                let windows = 1usize << length;
                let (mut found, mut full) = (0.0, 0.0);
                for w in 0..windows {
                    // Eight blocks of equal count, joined.
                    let edge = |k: usize| (k * (8 / windows) * count + 4) / 8;
                    let inside = edge(w)..edge(w + 1);
                    let turn = |k: usize| z[k] * Complex64::cis(TAU * gain * way(&points[k], place) / WAVELENGTH_M);
                    found += inside.clone().map(turn).sum::<Complex64>().norm_sqr();
                    full += inside.len() as f64 * inside.map(|k| z[k].norm_sqr()).sum::<f64>();
                }
                sum += (independent - windows as f64).max(0.0) * -(1.0 - found / full).ln();
            }
        }
        sum / (4 * channels.len()) as f64
    }

    #[test]
    fn every_tier_gives_the_formula() {
        let points = arc(137);
        let truth = Place { azimuth: 0.7, elevation: 0.2, curve: 0.3 };
        let channels = [(heard(&points, &truth, 2.0), 2.0), (heard(&points, &truth, 1.0), 1.0)];
        let bins = Bins::along(&points.iter().map(|p| p * 100.0).collect::<Vec<_>>(), WAVELENGTH_M);
        assert_eq!(bins.len(), 137);
        for tier in Tier::available() {
            let apertures = channels.iter().map(|(z, gain)| Aperture::of_phasors(z, &bins, *gain as u8)).collect();
            let field = Field::new(&points, apertures, WAVELENGTH_M, 70.0, 4, tier);
            for curve in [0.0, 0.1, 0.3, 0.55] {
                for k in 0..24 {
                    let place = Place { azimuth: 0.26 * f64::from(k), elevation: 0.1 * f64::from(k % 4), curve };
                    let (fast, exact) = (field.log_likelihoods(&[place])[0], slow(&points, &channels, &place, 70.0));
                    assert!((fast - exact).abs() < 2e-3 * (1.0 + exact), "{tier:?} {place:?}: {fast} {exact}");
                }
            }
        }
    }

    #[test]
    fn motions_of_no_or_few_samples_say_nothing_and_do_not_panic() {
        for count in [0, 1, 2, 5] {
            let points = arc(8)[..count].to_vec();
            let z = vec![Complex64::ONE; count];
            let bins = Bins::along(&points, WAVELENGTH_M);
            let aperture = Aperture::of_phasors(&z, &bins, 2);
            let field = Field::new(&bins.points_m(&points), vec![aperture], WAVELENGTH_M, 1.0, 4, Tier::detect());
            let place = Place { azimuth: 1.0, elevation: 0.0, curve: 0.1 };
            assert_eq!(field.log_likelihoods(&[place]), [0.0], "{count}");
        }
    }
}
