//! The search that is guaranteed to find the continuous maximum over azimuth.
//!
//! Around a ring of constant elevation, `F = |f|^2` is a non-negative trigonometric polynomial of degree `2 M`, `M`
//! from the Bessel tail of the radius. By M. Riesz `F(a + d) >= F_max cos^2(M d)` for `|d| <= pi / (2 M)`: with at least
//! `4 M` samples the cell of the global maximum holds a sample of at least `F_max cos^2(M h / 2)`, `h` the step. Every
//! cell above that bound is kept and climbed with Newton's method, exactly, in double. A one-degree grid has no such
//! property: from a radius of 0.39 m at 5.5 GHz it undersamples the profile.
//!
//! The elevation is searched along with it on rings whose phases differ by at most [`RING_STEP`] from one to the
//! next; the same kind of bound holds between them with the profile's maximum on the disc of all cosines in the
//! place of the maximum over the circle.

use std::f64::consts::{PI, TAU};

use num_complex::Complex;

use super::bessel::tail_order;
use super::choose::unit_costs;
use super::crb::{Fit, Spread, deviations, elevation_deviation, independence};
use super::error::Error;
use super::explain::{ElevationSearch, Precision, SearchPlan};
use super::fft::{Ffts, good_size, near_size};
use super::newton::{Hill, Point, Second, Top};
use super::resample::{Resample, ResampleWork};
use super::scene::{Geometry, Scene, Shape};
use super::sums::{Columns, PairSum, Sines, pairs};
use crate::maths::simd::{ROUGH, Real, Tier};
use crate::maths::wrap_rad;
use crate::signal::samples::Samples;

/// Largest change of any phase between neighbouring rings of elevation, radians: no more than 0.4 to the nearest.
const RING_STEP: f64 = 0.8;
/// Samples per ring, in units of the profile's degree `M`: `4 M` suffice, more leave fewer candidates. They are
/// interpolated from `2 M + 2` evaluated ones.
const SAMPLES_PER_ORDER: usize = 8;
/// What the band limit of a ring leaves out, relative to `sum w |z|`; as much again is folded back.
const TAIL: f64 = 1e-4;
/// Above this radius (radians of phase) sampling is done in double: single precision loses 1e-4 of a turn there.
const SINGLE_RADIUS: f64 = 600.0;
/// Above this radius (radians of phase) there is no search: about 2 km at 5.5 GHz, round trip.
const LIMIT_RADIUS: f64 = 5e5;
/// Peaks that are reported; those that the bound rules out as the highest as they were sampled.
const REPORTED: usize = 6;
/// A trajectory at most this wide for its length has a mirror worth a look.
const ELONGATED: f64 = 0.15;
/// Azimuth and elevation must turn the phases differently by this share of their variance before the elevation is
/// searched. On a line they turn them alike; millimetres of wobble would then decide between them, and millimetres are
/// what odometry, a curved wave front and reflections get wrong, whatever the noise allows.
const INDEPENDENT: f64 = 0.1;
/// A mirror peak at least this high (relative) is reported.
const MIRROR_RATIO: f64 = 0.8;

/// What to search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchOptions {
    /// Largest |elevation| of the search, radians, 0 to pi/2. Default 20 degrees. 0 fixes the horizon.
    pub elevation_max_rad: f64,
    /// The SIMD tier to run on. Default: the widest of this machine.
    pub tier: Tier,
}

impl Default for SearchOptions {
    fn default() -> Self {
        Self { elevation_max_rad: 20f64.to_radians(), tier: Tier::detect() }
    }
}

/// A local maximum of the profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Azimuth, radians in (-pi, pi], from +x towards +y.
    pub azimuth_rad: f64,
    /// |elevation|, radians.
    pub abs_elevation_rad: f64,
    /// `F / (sum w |z|)^2`, 0 to 1.
    pub value: f64,
}

/// A bearing and what can be said about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Azimuth of the highest peak, radians in (-pi, pi], from +x towards +y in the trajectory's frame.
    pub azimuth_rad: f64,
    /// |elevation| of the peak, radians; 0 where it was not searched or cannot be observed.
    pub abs_elevation_rad: f64,
    /// The elevation with its sign, where the motion tells the two apart.
    pub signed_elevation_rad: Option<f64>,
    /// Predicted standard deviation of the azimuth (Cramer-Rao), radians; with the elevation as a nuisance where that
    /// was searched. At most that of a uniform guess, pi / sqrt 3.
    pub azimuth_sd_rad: f64,
    /// Predicted standard deviation of |elevation|, radians; pi/2 where it was not searched or cannot be observed.
    pub elevation_sd_rad: f64,
    /// True if the elevation was searched: it was asked for, and this motion can observe it.
    pub elevation_searched: bool,
    /// The mirror bearing, radians, for motion along (nearly) a line: reflected about that line, it explains the
    /// samples (nearly) as well. Neither is preferred for a reason.
    pub mirror_rad: Option<f64>,
    /// `|sum w z a| / sum w |z|` at the peak, 0 to 1.
    pub coherence: f64,
    /// Estimated signal-to-noise ratio of one sample (a power ratio); other paths count as noise.
    pub snr: f64,
    /// Second highest peak of a different azimuth over the highest, 0 to 1; none if there is no other. The mirror of a
    /// line does not count.
    pub peak_ratio: Option<f64>,
    /// The highest peaks, falling; the first is the estimate.
    pub peaks: Vec<Peak>,
    /// Shape of the motion.
    pub shape: Shape,
    /// Geometry class of the motion.
    pub geometry: Geometry,
    /// `F / (sum w |z|)^2` at the peak.
    pub value: f64,
    /// Directions in which the profile was evaluated.
    pub evaluations: usize,
    /// What the search computed and what it left out.
    pub plan: SearchPlan,
}

/// Finds the bearing: the continuous maximum of the Bartlett profile over azimuth and |elevation|.
///
/// # Errors
/// [`Error`] for input that is empty or without energy, for positions not finite in wavelengths; for an elevation limit outside 0
/// to 90 degrees; [`Error::NoMotion`] where the receiver did not move horizontally.
pub fn search(samples: &Samples, options: &SearchOptions) -> Result<Estimate, Error> {
    Searcher::new(options.tier).search(samples, options.elevation_max_rad)
}

/// A search that keeps its FFTs from call to call.
pub struct Searcher {
    tier: Tier,
    single: Sampler<f32>,
    double: Sampler<f64>,
    /// The last band limit, and the radius that it is for.
    last: (f64, usize),
}

/// FFTs and buffers of one precision.
struct Sampler<T: Real> {
    ffts: Ffts<T>,
    columns: [Vec<T>; 5],
    /// Cosines and sines of the azimuths of a ring.
    circle: Vec<[f64; 2]>,
    directions: Vec<[T; 3]>,
    rows: Vec<Complex<T>>,
    work: ResampleWork<T>,
}

impl Searcher {
    /// A searcher for a tier; one that this machine lacks runs the portable code.
    #[must_use]
    pub fn new(tier: Tier) -> Self {
        Self { tier, single: Sampler::new(tier), double: Sampler::new(tier), last: (0.0, 0) }
    }

    /// The band limit for a radius in radians of phase: the last one if that was for one at most two percent larger.
    fn order(&mut self, radius: f64) -> usize {
        if !(0.98 * self.last.0..=self.last.0).contains(&radius) {
            let above = 1.005 * radius;
            self.last = (above, tail_order(above, TAIL));
        }
        self.last.1
    }

    /// As [`search`], up to `elevation_max_rad`.
    ///
    /// # Errors
    /// As [`search`].
    pub fn search(&mut self, samples: &Samples, elevation_max_rad: f64) -> Result<Estimate, Error> {
        let scene = Scene::on(self.tier, samples)?;
        if !(0.0..=PI / 2.0).contains(&elevation_max_rad) {
            return Err(Error::ElevationMax { elevation_max_rad });
        }
        scene.require_motion()?;
        let radius = TAU * scene.radius.hypot(scene.half_height);
        if radius > LIMIT_RADIUS {
            return Err(Error::Aperture {
                extent_m: radius / TAU * scene.turn_m,
                limit_m: LIMIT_RADIUS / TAU * scene.turn_m,
            });
        }
        let order = self.order(TAU * scene.radius);
        let evaluated = near_size(2 * order + 2, 2);
        let ring = good_size(SAMPLES_PER_ORDER * order + 16);
        let shape = scene.shape();
        let search = Search { scene: &scene, shape, tools: self, order, evaluated, ring, evaluations: 0, exact: 0 };
        Ok(search.run(elevation_max_rad))
    }
}

/// Above this many samples noise alone would be sampled as badly as rough sines are.
const ROUGH_SAMPLES: usize = 4_096;

/// One search under way.
struct Search<'a> {
    scene: &'a Scene,
    shape: Shape,
    tools: &'a mut Searcher,
    /// The band limit of a ring.
    order: usize,
    /// Evaluated azimuths per ring, even.
    evaluated: usize,
    /// Samples per ring, even, interpolated.
    ring: usize,
    evaluations: usize,
    /// Of those, exact ones.
    exact: usize,
}

/// A sampled profile: rows of rising elevation, `ring` azimuths each from 0.
struct Sampled {
    elevations: Vec<f64>,
    values: Vec<f64>,
}

impl<'a> Search<'a> {
    fn run(mut self, elevation_max: f64) -> Estimate {
        let horizon = self.sample(&[0.0]);
        let observable = elevation_max > 0.0 && self.elevation_observable(&horizon, elevation_max);
        let limit = if observable { elevation_max } else { 0.0 };
        let sampled = if observable { self.sample(&elevation_rings(self.scene, limit)) } else { horizon };
        let kind = if self.scene.is_flat() { Second::Cosine } else { Second::Elevation };
        let hill = self.hill(kind, limit, &sampled);
        let tops = self.climb(&hill, &sampled);
        self.evaluations += self.exact;
        let elevation = match (observable, elevation_max > 0.0) {
            (true, _) => ElevationSearch::Searched,
            (false, true) => ElevationSearch::NotObservable,
            (false, false) => ElevationSearch::NotAsked,
        };
        let plan = self.plan(elevation, sampled.elevations.len());
        self.estimate(&hill, tops, plan)
    }

    fn plan(&self, elevation: ElevationSearch, rings: usize) -> SearchPlan {
        let precision = if self.in_double() { Precision::Double } else { Precision::Single };
        let (tier, samples) = (self.tools.tier, self.scene.len());
        let [pair, ..] = unit_costs(tier, precision);
        // An exact look, with its derivatives in double, takes about as long as four pairs; the horizon comes first.
        let horizon = if rings > 1 { self.evaluated } else { 0 };
        let pairs = (rings * self.evaluated + horizon) as f64 / 2.0 + 4.0 * self.exact as f64;
        SearchPlan {
            tier,
            precision,
            band_limit: self.order,
            summed: self.evaluated,
            sampled: self.ring,
            rings,
            exact: self.exact,
            samples,
            elevation,
            level: self.scene.is_flat(),
            estimate_us: pairs * samples as f64 * pair / 1e3,
        }
    }

    fn hill(&self, kind: Second, limit: f64, sampled: &Sampled) -> Hill<'a> {
        let (low, high) = match kind {
            Second::Cosine => (limit.cos(), 1.0),
            Second::Elevation => (-limit, limit),
        };
        let rows = sampled.elevations.len().max(2);
        let reach = [TAU / self.ring as f64, (high - low) / (rows - 1) as f64];
        Hill { level: self.tools.tier.level_or_portable(), samples: self.scene.columns(), kind, low, high, reach }
    }

    /// `F` on rings at the given elevations (from 0 upwards) and, unless the motion is level, at their negatives.
    fn sample(&mut self, elevations: &[f64]) -> Sampled {
        let ring = Ring { evaluated: self.evaluated, dense: self.ring, flat: self.scene.is_flat() };
        let sampled = if self.in_double() {
            self.tools.double.sample(self.tools.tier, self.scene, elevations, ring)
        } else {
            self.tools.single.sample(self.tools.tier, self.scene, elevations, ring)
        };
        self.evaluations += sampled.elevations.len() * self.evaluated;
        sampled
    }

    fn in_double(&self) -> bool {
        TAU * self.scene.radius.hypot(self.scene.half_height) > SINGLE_RADIUS
    }

    /// The least amplitude with which the sample of a cell that holds the maximum can have come out, given that the
    /// maximum is at least `best^2`: what the band limit leaves out is missing from the maximum, and once more, with
    /// what is folded back and rounded, from the sample.
    fn least(&self, best: f64, rows: usize) -> f64 {
        let along = (self.order as f64 * PI / self.ring as f64).cos();
        let across = if rows > 1 { (RING_STEP / 2.0).cos() } else { 1.0 };
        let radius = TAU * self.scene.radius.hypot(self.scene.half_height);
        let rough = if self.scene.sines() == Sines::Rough { ROUGH } else { 0.0 };
        let rounding = if self.in_double() { 1e-15 * radius } else { 1e-6 + 2e-7 * radius + rough };
        let [tail, lost] = [TAIL, TAIL + rounding].map(|share| share * self.scene.sum_abs);
        (along * across * (best - tail) - lost).max(0.0)
    }

    /// True if the data can say more about the elevation than its limits do: the predicted deviation, azimuth as a
    /// nuisance, is below that of a uniform guess (range / sqrt 12) in the cosine or, off the plane, in the angle.
    fn elevation_observable(&self, horizon: &Sampled, limit: f64) -> bool {
        let (index, value) = argmax(&horizon.values);
        let azimuth = TAU * index as f64 / self.ring as f64;
        let (fit, spread) = (Fit::new(self.scene, value), Spread::new(self.scene, azimuth));
        let uniform = 12f64.sqrt();
        let cosine = deviations(fit, spread, Second::Cosine, Point { azimuth, second: 1.0 }, false)[1];
        let angle = deviations(fit, spread, Second::Elevation, Point { azimuth, second: 0.0 }, false)[1];
        let apart = |kind, second| independence(spread, kind, Point { azimuth, second }) > INDEPENDENT;
        (cosine < (1.0 - limit.cos()) / uniform && apart(Second::Cosine, 1.0))
            || (angle < 2.0 * limit / uniform && apart(Second::Elevation, 0.0))
    }

    /// Climbs from every candidate that the bound does not rule out; a few more are reported as they were sampled.
    fn climb(&mut self, hill: &Hill<'_>, sampled: &Sampled) -> Vec<Top> {
        let mut candidates = local_maxima(sampled, self.ring);
        candidates.sort_by(|a, b| b.1.total_cmp(&a.1));
        let (mut tops, mut best) = (Vec::<Top>::new(), 0f64);
        for (rank, (index, value)) in candidates.into_iter().enumerate() {
            let elevation = sampled.elevations[index / self.ring];
            let azimuth =
                TAU * ((index % self.ring) as f64 + vertex(&sampled.values, index, self.ring)) / self.ring as f64;
            let at = Point { azimuth, second: hill.kind.of_elevation(elevation) };
            if value.sqrt() >= self.least(best.sqrt(), sampled.elevations.len()) {
                let top = hill.climb(at);
                self.exact += top.evaluations;
                best = best.max(top.value);
                tops.push(top);
            } else if rank < 4 * REPORTED {
                tops.push(Top { at, value, evaluations: 0 });
            } else {
                break;
            }
        }
        if let Some(mirror) = self.mirror_start(&tops) {
            let top = hill.climb(mirror);
            self.exact += top.evaluations;
            tops.push(top);
        }
        tops.sort_by(|a, b| b.value.total_cmp(&a.value));
        tops
    }

    /// Azimuth of a long, narrow horizontal trajectory's axis.
    fn axis(&self) -> Option<f64> {
        let shape = &self.shape;
        let [long, wide, _] = shape.half_extent_m;
        let axis = shape.axes[0];
        (wide <= ELONGATED * long && axis.x.hypot(axis.y) > 0.5).then(|| axis.y.atan2(axis.x))
    }

    fn mirror_start(&self, tops: &[Top]) -> Option<Point> {
        let axis = self.axis()?;
        let best = tops.iter().max_by(|a, b| a.value.total_cmp(&b.value))?;
        Some(Point { azimuth: 2.0 * axis - best.at.azimuth, second: best.at.second })
    }

    /// Half the width of a main lobe at half its height, radians: peaks nearer than that are one.
    fn resolution(&self) -> f64 {
        (1.126 / (TAU * self.scene.radius)).min(PI / 2.0)
    }

    fn estimate(self, hill: &Hill<'_>, tops: Vec<Top>, plan: SearchPlan) -> Estimate {
        let observable = plan.elevation == ElevationSearch::Searched;
        let scene = self.scene;
        let full = scene.sum_abs * scene.sum_abs;
        let peak = |top: &Top| Peak {
            azimuth_rad: wrap_rad(top.at.azimuth),
            abs_elevation_rad: hill.kind.elevation(top.at.second).abs(),
            value: (top.value / full).min(1.0),
        };
        let near = |a: f64, b: f64| wrap_rad(a - b).abs() < self.resolution();
        let mut peaks: Vec<Peak> = Vec::new();
        for candidate in tops.iter().map(peak) {
            if !peaks.iter().any(|p| near(p.azimuth_rad, candidate.azimuth_rad)) {
                peaks.push(candidate);
            }
        }
        let (top, best) = (tops[0], peak(&tops[0]));
        let mirror = self.axis().and_then(|axis| {
            let reflected = 2.0 * axis - best.azimuth_rad;
            let close = |p: &&Peak| wrap_rad(p.azimuth_rad - reflected).abs() < 2.0 * self.resolution();
            peaks.iter().skip(1).find(close).filter(|p| p.value >= MIRROR_RATIO * best.value).copied()
        });
        let other = peaks.iter().skip(1).find(|p| mirror.is_none_or(|m| m != **p));
        let peak_ratio = other.map(|p| p.value / best.value);
        let (fit, spread) = (Fit::new(scene, top.value), Spread::new(scene, top.at.azimuth));
        let [azimuth_sd_rad, second_sd] = deviations(fit, spread, hill.kind, top.at, !observable);
        let signed = hill.kind.elevation(top.at.second);
        let elevation_sd_rad = match (observable, hill.kind) {
            (false, _) => PI / 2.0,
            (true, Second::Cosine) => elevation_deviation(signed, second_sd),
            (true, Second::Elevation) => {
                let cosine = Point { azimuth: top.at.azimuth, second: signed.cos() };
                let by_cosine = deviations(fit, spread, Second::Cosine, cosine, false)[1];
                second_sd.min(elevation_deviation(signed.abs(), by_cosine))
            }
        };
        peaks.truncate(REPORTED);
        Estimate {
            azimuth_rad: best.azimuth_rad,
            abs_elevation_rad: best.abs_elevation_rad,
            signed_elevation_rad: (observable && self.shape.geometry == Geometry::Spatial).then_some(signed),
            azimuth_sd_rad,
            elevation_sd_rad,
            elevation_searched: observable,
            mirror_rad: mirror.map(|p| p.azimuth_rad),
            coherence: best.value.sqrt(),
            snr: fit.snr,
            peak_ratio,
            peaks,
            shape: self.shape,
            geometry: self.shape.geometry,
            value: best.value,
            evaluations: self.evaluations,
            plan,
        }
    }
}

/// Elevations from 0 to `limit` whose phases differ by at most [`RING_STEP`] from one to the next.
fn elevation_rings(scene: &Scene, limit: f64) -> Vec<f64> {
    let change = |e: f64| TAU * (scene.radius * (1.0 - e.cos()) + scene.half_height * e.sin());
    let steps = (change(limit) / RING_STEP).ceil().max(1.0);
    let elevation = |target: f64| {
        let (mut low, mut high) = (0.0, limit);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if change(middle) < target { low = middle } else { high = middle }
        }
        high
    };
    (0..=steps as usize).map(|i| if i == 0 { 0.0 } else { elevation(change(limit) * i as f64 / steps) }).collect()
}

impl Scene {
    /// The sines that a search of these samples needs: errors count against the highest peak of noise.
    fn sines(&self) -> Sines {
        if self.len() <= ROUGH_SAMPLES { Sines::Rough } else { Sines::Fine }
    }
}

/// How a ring is sampled.
#[derive(Clone, Copy)]
struct Ring {
    /// Azimuths that are summed.
    evaluated: usize,
    /// Azimuths that are interpolated from them.
    dense: usize,
    /// Level motion: the antipode of a direction is on its ring.
    flat: bool,
}

impl<T: Real> Sampler<T> {
    fn new(tier: Tier) -> Self {
        let (columns, work) = (Default::default(), ResampleWork::default());
        Self { ffts: Ffts::new(tier), columns, circle: Vec::new(), directions: Vec::new(), rows: Vec::new(), work }
    }

    fn sample(&mut self, tier: Tier, scene: &Scene, elevations: &[f64], ring: Ring) -> Sampled {
        if self.circle.len() != ring.evaluated {
            let angle = |j: usize| TAU * j as f64 / ring.evaluated as f64;
            self.circle = (0..ring.evaluated).map(|j| [angle(j).cos(), angle(j).sin()]).collect();
        }
        self.directions.clear();
        for &elevation in elevations {
            let (sin_el, cos_el) = elevation.sin_cos();
            let turned = |[cos, sin]: &[f64; 2]| [cos_el * cos, cos_el * sin, sin_el].map(T::of);
            self.directions.extend(self.circle[..ring.columns(elevation)].iter().map(turned));
        }
        let c = scene.columns();
        for (column, from) in self.columns.iter_mut().zip([c.x, c.y, c.z, c.re, c.im]) {
            column.clear();
            column.extend(from.iter().map(|v| T::of(*v)));
        }
        let [x, y, z, re, im] = &self.columns;
        let columns = Columns { x, y, z, re, im };
        let sums = pairs::<T>(tier.level_or_portable(), columns, &self.directions, scene.sines());
        let elevations = self.arrange(elevations, &sums, ring);
        Resample::new(ring.evaluated, ring.dense, &mut self.ffts).run(&self.rows, &mut self.work);
        let values = self.work.dense.iter().map(|f| f.norm_sqr().into()).collect();
        Sampled { elevations, values }
    }

    /// Rows of rising elevation from the sums of antipodal pairs: the antipode of (a, e) is (a + pi, -e).
    fn arrange(&mut self, elevations: &[f64], sums: &[PairSum], ring: Ring) -> Vec<f64> {
        let half = ring.evaluated / 2;
        let narrow = |c: num_complex::Complex64| Complex::new(T::of(c.re), T::of(c.im));
        self.rows.clear();
        // Below the horizon first, from the lowest ring up.
        let mut below = Vec::new();
        let mut end = sums.len();
        for &elevation in elevations.iter().rev() {
            let row = &sums[end - ring.columns(elevation)..end];
            end -= row.len();
            if row.len() == ring.evaluated {
                let (first, second) = row.split_at(half);
                self.rows.extend(second.iter().chain(first).map(|s| narrow(s.opposite())));
                below.push(-elevation);
            }
        }
        let mut rest = sums;
        for &elevation in elevations {
            let (row, tail) = rest.split_at(ring.columns(elevation));
            rest = tail;
            self.rows.extend(row.iter().map(|s| narrow(s.here())));
            if row.len() == half {
                self.rows.extend(row.iter().map(|s| narrow(s.opposite())));
            }
        }
        below.extend_from_slice(elevations);
        below
    }
}

impl Ring {
    /// Directions to be summed at an elevation: half a ring where the antipodes complete it.
    fn columns(&self, elevation: f64) -> usize {
        if self.flat || elevation == 0.0 { self.evaluated / 2 } else { self.evaluated }
    }
}

/// Samples that none of their eight neighbours exceeds, with their values.
fn local_maxima(sampled: &Sampled, ring: usize) -> Vec<(usize, f64)> {
    let rows = sampled.elevations.len();
    let mut maxima = Vec::new();
    let around = |i: usize| (if i == 0 { ring - 1 } else { i - 1 }, if i + 1 == ring { 0 } else { i + 1 });
    if rows == 1 {
        let values = &sampled.values;
        let top = |&i: &usize| {
            let (before, after) = around(i);
            values[i] >= values[before] && values[i] >= values[after]
        };
        maxima.extend((0..ring).filter(top).map(|i| (i, values[i])));
        return maxima;
    }
    for row in 0..rows {
        for column in 0..ring {
            let value = sampled.values[row * ring + column];
            let (before, after) = around(column);
            let columns = [column, before, after];
            if (row.saturating_sub(1)..(row + 2).min(rows))
                .all(|r| columns.iter().all(|c| sampled.values[r * ring + c] <= value))
            {
                maxima.push((row * ring + column, value));
            }
        }
    }
    maxima
}

/// Offset, in steps, of the vertex of the parabola through the logarithms of a sample and its neighbours around the ring.
fn vertex(values: &[f64], index: usize, ring: usize) -> f64 {
    let (row, column) = (index / ring * ring, index % ring);
    let [before, here, after] = [ring - 1, 0, 1].map(|d| values[row + (column + d) % ring].max(f64::MIN_POSITIVE).ln());
    let bend = before - 2.0 * here + after;
    if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

fn argmax(values: &[f64]) -> (usize, f64) {
    values.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0))
}
