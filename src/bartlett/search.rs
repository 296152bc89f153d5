//! The search that is guaranteed to find the continuous maximum over azimuth.
//!
//! Around a ring of constant elevation `F = |f|^2` is a non-negative trigonometric polynomial of degree `2 M`, `M` from the
//! Bessel tail of the radius. Riesz's inequality \[riesz1914\], applied to `F - F_max / 2`, gives
//!
//! `F(a + d) >= F_max cos^2(M d)  for |d| <= pi / (2 M)`:
//!
//! with at least `4 M` samples the cell of the global maximum holds a sample of at least `F_max cos^2(M h / 2)`, `h` the
//! step. Every cell above that bound is kept and climbed with Newton's method, exactly, in double. A one-degree grid has
//! no such property: from a radius of 0.39 m at 5.5 GHz it undersamples the profile.
//!
//! The elevation is searched along with it on rings whose phases differ by at most [`RING_STEP`] from one to the next; the
//! same kind of bound holds between them with the profile's maximum on the disc of all cosines in the place of the maximum
//! over the circle.
//!
//! # Sampling
//! Around a ring `f` is band limited: it is summed at `2 M + 2` azimuths or a few more and interpolated; `M` is that of the
//! radius as seen from the ring, which falls with the cosine of its elevation. Antipodes share their sums: `f(-u)` has the
//! same terms conjugated in their phases. Rings are taken some at a time, from the horizon outwards, and only their maxima
//! are kept: all of a sphere would be megabytes.
//!
//! # Deviations
//! The Cramer-Rao bound of a bearing \[stoica-nehorai1989\], from the geometry and an estimated signal-to-noise ratio.
//!
//! The model is `z_t = A exp(j 2 pi q_t . u) + n_t` with an unknown complex `A` and white complex noise of variance
//! `sigma^2 / w_t`. The Fisher information of a direction coordinate is then `2 |A|^2 / sigma^2` times the weighted,
//! centred second moment of the phase's derivative; for one coordinate and unit weights that is
//! `sd^2 = 1 / (2 g kappa^2 sum ((p_t - mean) . u_perp)^2)`. Samples that are products of a forward and a backward
//! channel have the signal-to-noise ratio `g / (2 + 1/g)` of the product, which is what is estimated here.

use super::mirror::{Reflections, axis, is_thin, odometry_tells};
use super::planner::{Precision, instructions, pair_ns, tail_order};
use super::scene::{Geometry, Scene, Shape};
use super::{Error, Estimate, Peak, SearchOptions};
use crate::estimate::tuning::sensor;
use crate::maths::{UNIFORM_RAD, wrap_rad};
use crate::signal::samples::Samples;
use csi5300_kernels::fft::{Ffts, good_size, near_size};
use csi5300_kernels::rings::{Resample, ResampleWork};
use csi5300_kernels::simd::{ROUGH, Real, Tier};
use csi5300_kernels::sums::{Aim, Columns, PairSum, Sines, Wanted, moments, pairs};
use fearless_simd::Level;
use nalgebra::Vector3;
use num_complex::{Complex, Complex64};
use serde::Serialize;
use std::f64::consts::{PI, TAU};
use std::fmt;

/// What became of the elevation in a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum ElevationSearch {
    /// The limit of |elevation| was 0: only the horizon was searched.
    NotAsked,
    /// Its predicted deviation is above that of a uniform guess within the limits: only the horizon was searched.
    NotObservable,
    /// It was searched along with the azimuth.
    Searched,
}

/// Computed and skipped parts of a guaranteed search, as a value that prints.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SearchPlan {
    /// The SIMD tier.
    pub tier: Tier,
    /// The precision of the samples of the profile; peaks are climbed in double.
    #[doc(hidden)]
    pub precision: Precision,
    /// Modes around a ring that phases can reach.
    pub band_limit: usize,
    /// Azimuths of a ring that are summed, half of them as antipodes where the motion is level.
    pub summed: usize,
    /// Azimuths of a ring that are interpolated from them: enough that no maximum is missed.
    pub sampled: usize,
    /// Rings of constant elevation.
    pub rings: usize,
    /// Directions in which the profile was computed exactly, on the way to its peaks.
    pub exact: usize,
    /// Samples that each of these sums is over.
    pub samples: usize,
    /// What became of the elevation.
    #[doc(hidden)]
    pub elevation: ElevationSearch,
    /// True if the motion is level: rings below the horizon are those above it.
    pub level: bool,
    /// The estimate of its cost, microseconds (a model, not a measurement).
    pub estimate_us: f64,
}

impl SearchPlan {
    /// The directions not computed, and why.
    #[must_use]
    fn skipped(&self) -> Vec<String> {
        let mut list = vec![format!(
            "the profile on any grid: {} azimuths a ring hold its {} modes, and its maximum is found between them",
            self.summed, self.band_limit
        )];
        match self.elevation {
            ElevationSearch::NotAsked => list.push("every elevation: not asked for".into()),
            ElevationSearch::NotObservable => {
                list.push("every elevation but the horizon: this motion cannot observe it".into());
            }
            ElevationSearch::Searched if self.level => list.push("the lower hemisphere: the motion is level".into()),
            ElevationSearch::Searched => {}
        }
        list
    }
}

impl fmt::Display for SearchPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "search in {} precision with {}, about {:.0} us: {} rings of {} sums over {} samples, {} exact looks in double",
            self.precision,
            instructions(self.tier),
            self.estimate_us,
            self.rings,
            self.summed,
            self.samples,
            self.exact
        )?;
        self.skipped().iter().try_for_each(|skipped| writeln!(f, "  skipped: {skipped}"))
    }
}

/// Azimuth and elevation must differ by this share of the phases' variance for elevation to be searched (odometry's
/// millimetres must not decide).
const INDEPENDENT: f64 = 0.1;

/// Samples per ring, in units of the profile's degree `M`: `4 M` suffice, more leave fewer candidates. They are
/// interpolated from `2 M + 2` evaluated ones.
const SAMPLES_PER_ORDER: usize = 6;
/// What the band limit of a ring leaves out, relative to `sum w |z|`; as much again is folded back.
const TAIL: f64 = 1e-4;
/// Above this radius (radians of phase) sampling is done in double: single precision loses 1e-4 of a turn there.
const SINGLE_RADIUS: f64 = 600.0;
/// Above this radius (radians of phase) there is no search: about 2 km at 5.5 GHz, round trip.
const LIMIT_RADIUS: f64 = 5e5;

/// Finds the bearing: the continuous maximum of the Bartlett profile over azimuth and |elevation|.
///
/// # Errors
/// [`Error`] for input that is empty or without energy, for positions not finite in wavelengths; for an elevation limit outside 0
/// to 90 degrees; [`Error::NoMotion`] where the receiver did not move horizontally.
pub fn search(samples: &Samples, options: &SearchOptions) -> Result<Estimate, Error> {
    Searcher::new(options.tier).search_with(samples, None, options.elevation_max_rad, options.odometry_sd_m)
}

/// Averages of neighbouring samples, whose profile has its peaks where that of all samples has them.
pub(crate) struct Means<'a> {
    pub samples: &'a Samples,
    /// The share of a wave's amplitude that they lose at most.
    pub lost: f64,
}

/// A search that keeps its FFTs from call to call.
pub struct Searcher {
    tier: Tier,
    single: Sampler<f32>,
    double: Sampler<f64>,
    /// The last band limit, and the radius that it is for.
    last: (f64, usize),
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
        self.search_with(samples, None, elevation_max_rad, sensor::POSITION_M)
    }

    /// As [`Searcher::search`], with the assumed error of the positions, metres. With `means`, rings are sampled of these, and peaks
    /// are climbed in the profile of all samples.
    ///
    /// # Errors
    /// As [`search`].
    pub(crate) fn search_with(
        &mut self,
        samples: &Samples,
        means: Option<Means<'_>>,
        elevation_max_rad: f64,
        odometry_sd_m: f64,
    ) -> Result<Estimate, Error> {
        let scene = Scene::on(self.tier, samples)?;
        let lost = means.as_ref().map_or(0.0, |means| means.lost);
        let thinned = means.map(|means| Scene::on(self.tier, means.samples)).transpose()?;
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
        let ring = good_size(SAMPLES_PER_ORDER * order + 16);
        let shape = scene.shape();
        let sampled = thinned.as_ref().unwrap_or(&scene);
        let search = Search { scene: &scene, sampled, lost, shape, tools: self, order, ring, evaluations: 0, exact: 0 };
        Ok(search.run(elevation_max_rad, odometry_sd_m))
    }
}

/// One search under way.
struct Search<'a> {
    scene: &'a Scene,
    /// What rings are sampled of.
    sampled: &'a Scene,
    /// The share of a wave's amplitude that this lacks at most.
    lost: f64,
    shape: Shape,
    tools: &'a mut Searcher,
    /// The band limit of a ring.
    order: usize,
    /// Samples per ring, even, interpolated.
    ring: usize,
    evaluations: usize,
    /// Of those, exact ones.
    exact: usize,
}

impl<'a> Search<'a> {
    fn run(mut self, elevation_max: f64, odometry_sd_m: f64) -> Estimate {
        let horizon = self.sample(&[0.0]);
        let observable = elevation_max > 0.0 && self.elevation_observable(&horizon, elevation_max, odometry_sd_m);
        let limit = if observable { elevation_max } else { 0.0 };
        let sampled = if observable { self.sample(&elevation_rings(self.scene, limit)) } else { horizon };
        let kind = if self.scene.is_flat() { Second::Cosine } else { Second::Elevation };
        let hill = self.hill(kind, limit, sampled.rows);
        let rows = sampled.rows;
        let tops = self.climb(&hill, sampled);
        self.evaluations += self.exact;
        let elevation = match (observable, elevation_max > 0.0) {
            (true, _) => ElevationSearch::Searched,
            (false, true) => ElevationSearch::NotObservable,
            (false, false) => ElevationSearch::NotAsked,
        };
        let plan = self.plan(elevation, rows);
        let evaluations = self.evaluations;
        Findings { scene: self.scene, shape: self.shape, hill: &hill, tops: &tops, plan, odometry_sd_m, evaluations }
            .estimate()
    }

    fn plan(&self, elevation: ElevationSearch, rings: usize) -> SearchPlan {
        let precision = if self.in_double() { Precision::Double } else { Precision::Single };
        let (tier, samples) = (self.tools.tier, self.sampled.len());
        let pair = pair_ns(tier, precision);
        // An exact look, with its derivatives in double, takes about as long as four pairs.
        let per_mean = self.scene.len() as f64 / samples as f64;
        let pairs = (self.evaluations - self.exact) as f64 / 2.0 + 4.0 * per_mean * self.exact as f64;
        SearchPlan {
            tier,
            precision,
            band_limit: self.order,
            summed: Rings::summed(self.order),
            sampled: self.ring,
            rings,
            exact: self.exact,
            samples,
            elevation,
            level: self.scene.is_flat(),
            estimate_us: pairs * samples as f64 * pair / 1e3,
        }
    }

    fn hill(&self, kind: Second, limit: f64, rows: usize) -> Hill<'a> {
        let (low, high) = match kind {
            Second::Cosine => (limit.cos(), 1.0),
            Second::Elevation => (-limit, limit),
        };
        let reach = [TAU / self.ring as f64, (high - low) / (rows.max(2) - 1) as f64];
        Hill { level: self.tools.tier.level_or_portable(), samples: self.scene.columns(), kind, low, high, reach }
    }

    /// `F` on rings at the given elevations (from 0 upwards) and, unless the motion is level, at their negatives.
    fn sample(&mut self, elevations: &[f64]) -> Sampled {
        let order_of = |share: f64| tail_order(1.005 * share * TAU * self.scene.radius, TAIL);
        let highest = elevations.last().copied().unwrap_or_default();
        let rings = Rings::new(self.order, self.ring, self.scene.is_flat(), highest, order_of);
        let mut sampled = if self.in_double() {
            self.tools.double.sample(self.tools.tier, self.sampled, elevations, &rings)
        } else {
            self.tools.single.sample(self.tools.tier, self.sampled, elevations, &rings)
        };
        self.evaluations += sampled.summed;
        sampled.scale(2f64.powi(2 * (self.scene.exponent - self.sampled.exponent)));
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
        let rough = if self.sampled.sines() == Sines::Rough { ROUGH } else { 0.0 };
        let rounding = if self.in_double() { 1e-15 * radius } else { 1e-6 + 2e-7 * radius + rough };
        let [tail, lost] = [TAIL, TAIL + rounding].map(|share| share * self.scene.sum_abs);
        (along * across * (1.0 - self.lost) * (best - tail) - lost).max(0.0)
    }

    /// True if the data determine the elevation better than its limits do: the predicted deviation, azimuth as a
    /// nuisance, is below that of a uniform guess (range / sqrt 12) in the cosine or, where the odometry is good enough for the
    /// height of the motion, in the angle.
    fn elevation_observable(&self, horizon: &Sampled, limit: f64, odometry_sd_m: f64) -> bool {
        let (column, value) = horizon.highest();
        let azimuth = TAU * column as f64 / self.ring as f64;
        let (fit, spread) = (Fit::new(self.scene, value), Spread::new(self.scene, azimuth));
        let uniform = 12f64.sqrt();
        let cosine = deviations(fit, spread, Second::Cosine, Point { azimuth, second: 1.0 }, false)[1];
        let angle = deviations(fit, spread, Second::Elevation, Point { azimuth, second: 0.0 }, false)[1];
        let high = odometry_tells(self.scene.depth_squared(Vector3::z()), odometry_sd_m / self.scene.turn_m);
        let apart = |kind, second| independence(spread, kind, Point { azimuth, second }) > INDEPENDENT;
        (cosine < (1.0 - limit.cos()) / uniform && apart(Second::Cosine, 1.0))
            || (high && angle < 2.0 * limit / uniform && apart(Second::Elevation, 0.0))
    }

    /// Climbs from every candidate that the bound does not rule out; a few more are reported as they were sampled.
    fn climb(&mut self, hill: &Hill<'_>, sampled: Sampled) -> Vec<Top> {
        let mut candidates = sampled.maxima;
        candidates.sort_by(|a, b| b.value().total_cmp(&a.value()));
        let (mut tops, mut best) = (Vec::<Top>::new(), 0f64);
        for (rank, candidate) in candidates.into_iter().enumerate() {
            let (value, azimuth) = (candidate.value(), TAU * candidate.vertex() / self.ring as f64);
            let at = Point { azimuth, second: hill.kind.of_elevation(candidate.elevation) };
            if value.sqrt() >= self.least(best.sqrt(), sampled.rows) {
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
        if let Some(mirror) = mirror_start(&self.shape, &tops) {
            let top = hill.climb(mirror);
            self.exact += top.evaluations;
            tops.push(top);
        }
        tops.sort_by(|a, b| b.value.total_cmp(&a.value));
        tops
    }
}

/// Peaks that are reported; those that the bound rules out as the highest as they were sampled.
const REPORTED: usize = 6;

/// Where to climb for the mirror of the highest top: reflected about the axis of the motion, if it is long and narrow.
fn mirror_start(shape: &Shape, tops: &[Top]) -> Option<Point> {
    let axis = axis(shape).filter(|_| is_thin(shape, 1))?;
    let best = tops.iter().max_by(|a, b| a.value.total_cmp(&b.value))?;
    Some(Point { azimuth: 2.0 * axis - best.at.azimuth, second: best.at.second })
}

/// What a search found.
struct Findings<'a> {
    scene: &'a Scene,
    shape: Shape,
    hill: &'a Hill<'a>,
    /// Falling, at least one.
    tops: &'a [Top],
    plan: SearchPlan,
    /// Assumed error of the positions, metres.
    odometry_sd_m: f64,
    /// Directions in which the profile was evaluated.
    evaluations: usize,
}

impl Findings<'_> {
    fn estimate(self) -> Estimate {
        let observable = self.plan.elevation == ElevationSearch::Searched;
        let mut peaks = self.peaks();
        let (top, best) = (self.tops[0], self.peak(&self.tops[0]));
        let errors = [self.odometry_sd_m / self.scene.turn_m, self.resolution()];
        let reflections = Reflections::new(self.scene, &self.shape, self.hill, top, errors, observable);
        let (mirror, geometry) = (reflections.mirror(), reflections.geometry());
        let is_mirror = |peak: &Peak, of: f64| wrap_rad(peak.azimuth_rad - of).abs() < 2.0 * self.resolution();
        let other = peaks.iter().skip(1).find(|p| mirror.is_none_or(|m| !is_mirror(p, m.azimuth)));
        let peak_ratio = other.map(|p| p.value / best.value);
        let fit = Fit::new(self.scene, top.value);
        let [azimuth_sd_rad, elevation_sd_rad] = self.deviations(fit, top, observable);
        let signed = self.hill.kind.elevation(top.at.second);
        let has_sign = geometry == Geometry::Spatial || geometry == Geometry::TiltedPlane && mirror.is_some();
        peaks.truncate(REPORTED);
        Estimate {
            azimuth_rad: best.azimuth_rad,
            abs_elevation_rad: best.abs_elevation_rad,
            signed_elevation_rad: (observable && has_sign).then_some(signed),
            azimuth_sd_rad,
            elevation_sd_rad,
            elevation_searched: observable,
            mirror_rad: mirror.map(|mirror| mirror.azimuth),
            mirror_elevation_rad: mirror.map(|mirror| mirror.elevation).filter(|_| observable),
            mirror_share: mirror.map(|mirror| mirror.share),
            mirror_normal: mirror.map(|mirror| mirror.normal),
            coherence: best.value.sqrt(),
            snr: fit.snr,
            peak_ratio,
            peaks,
            shape: Shape { geometry, ..self.shape },
            geometry,
            value: best.value,
            evaluations: self.evaluations,
            plan: self.plan,
        }
    }

    fn peak(&self, top: &Top) -> Peak {
        let full = self.scene.sum_abs * self.scene.sum_abs;
        Peak {
            azimuth_rad: wrap_rad(top.at.azimuth),
            abs_elevation_rad: self.hill.kind.elevation(top.at.second).abs(),
            value: (top.value / full).min(1.0),
        }
    }

    /// Half the width of a main lobe at half its height, radians: peaks nearer than that are one.
    ///
    /// On a circle of `r` turns the lobe is `J0(2 pi r d)^2`, which is 1/2 at `2 pi r d = 1.126`.
    fn resolution(&self) -> f64 {
        (1.126 / (TAU * self.scene.radius)).min(PI / 2.0)
    }

    /// The tops of different azimuth.
    fn peaks(&self) -> Vec<Peak> {
        let near = |a: f64, b: f64| wrap_rad(a - b).abs() < self.resolution();
        let mut peaks: Vec<Peak> = Vec::new();
        for candidate in self.tops.iter().map(|top| self.peak(top)) {
            if !peaks.iter().any(|p| near(p.azimuth_rad, candidate.azimuth_rad)) {
                peaks.push(candidate);
            }
        }
        peaks
    }

    /// Predicted deviations of azimuth and |elevation| at a top, radians.
    fn deviations(&self, fit: Fit, top: Top, observable: bool) -> [f64; 2] {
        let spread = Spread::new(self.scene, top.at.azimuth);
        let kind = self.hill.kind;
        let [azimuth_sd_rad, second_sd] = deviations(fit, spread, kind, top.at, !observable);
        let signed = kind.elevation(top.at.second);
        let elevation_sd_rad = match (observable, kind) {
            (false, _) => PI / 2.0,
            (true, Second::Cosine) => elevation_deviation(signed, second_sd),
            (true, Second::Elevation) => {
                let cosine = Point { azimuth: top.at.azimuth, second: signed.cos() };
                let by_cosine = deviations(fit, spread, Second::Cosine, cosine, false)[1];
                second_sd.min(elevation_deviation(signed.abs(), by_cosine))
            }
        };
        [azimuth_sd_rad, elevation_sd_rad]
    }
}

/// Largest change of any phase between neighbouring rings of elevation, radians: no more than 0.5 to the nearest.
const RING_STEP: f64 = 1.0;

/// Above this many samples noise alone would be sampled as badly as rough sines are.
const ROUGH_SAMPLES: usize = 4_096;

/// FFTs and buffers of one precision.
struct Sampler<T: Real> {
    ffts: Ffts<T>,
    columns: [Vec<T>; 5],
    directions: Vec<[T; 3]>,
    rows: Vec<Complex<T>>,
    work: ResampleWork<T>,
}

/// A sampled profile.
#[derive(Default)]
struct Sampled {
    /// Its rows, those below the horizon among them.
    pub rows: usize,
    /// Directions that were summed, antipodes among them.
    pub summed: usize,
    /// Its local maxima.
    pub maxima: Vec<Maximum>,
}

impl Sampled {
    /// Place in its row and value of the highest sample; (0, 0) if there is none.
    pub fn highest(&self) -> (usize, f64) {
        let highest = self.maxima.iter().max_by(|a, b| a.value().total_cmp(&b.value()));
        highest.map_or((0, 0.0), |maximum| (maximum.column, maximum.value()))
    }

    /// Multiplies the samples: from one scene's scale to another's.
    fn scale(&mut self, by: f64) {
        self.maxima.iter_mut().flat_map(|maximum| &mut maximum.around).for_each(|value| *value *= by);
    }
}

/// Elevations from 0 to `limit` whose phases differ by at most [`RING_STEP`] from one to the next.
fn elevation_rings(scene: &Scene, limit: f64) -> Vec<f64> {
    let (radius, height) = (scene.radius, scene.half_height);
    let change = TAU * (radius * (1.0 - limit.cos()) + height * limit.sin());
    let steps = (change / RING_STEP).ceil().max(1.0);
    // r (1 - cos e) + h sin e = c: with w = hypot(r, h) and p = atan2(h, r), e = acos((r - c) / w) - p.
    let (width, phase) = (radius.hypot(height), height.atan2(radius));
    let elevation = |part: f64| (((radius - part / TAU) / width).clamp(-1.0, 1.0).acos() - phase).clamp(0.0, limit);
    let ring = |i: usize| if i == 0 { 0.0 } else { elevation(change * i as f64 / steps) };
    (0..steps as usize).map(ring).chain([limit]).collect()
}

impl Scene {
    /// The sines that a search of these samples needs: errors count against the highest peak of noise.
    fn sines(&self) -> Sines {
        if self.len() <= ROUGH_SAMPLES { Sines::Rough } else { Sines::Fine }
    }
}

/// Into how many parts the cosine of the elevation is cut: each has a band limit.
const PARTS: usize = 4;
/// Directions that are summed before their rings are interpolated: what fits a core's own memory.
const AT_ONCE: usize = 2_048;

/// How rings are sampled.
#[derive(Clone, Copy)]
struct Rings {
    /// Azimuths that are summed on rings whose elevation's cosine is at most 1/4, 1/2, 3/4 and 1.
    evaluated: [usize; PARTS],
    /// Azimuths that are interpolated from them.
    pub dense: usize,
    /// Level motion: the antipode of a direction is on its ring.
    flat: bool,
}

impl Rings {
    /// Of a motion whose ring on the horizon needs modes up to `order`, for elevations up to `highest`; the modes of a share of
    /// the radius are asked for by `order_of`, where rings are as high.
    pub fn new(order: usize, dense: usize, flat: bool, highest: f64, order_of: impl Fn(f64) -> usize) -> Self {
        let size = |k: usize| match (k + 1) as f64 / PARTS as f64 {
            share if share < 1.0 && highest.cos() <= share => Self::summed(order_of(share).min(order)),
            _ => Self::summed(order),
        };
        Self { evaluated: std::array::from_fn(size), dense, flat }
    }

    /// The azimuths that hold the modes up to `order`.
    pub fn summed(order: usize) -> usize {
        near_size(2 * order + 2, 2)
    }

    fn evaluated(&self, elevation: f64) -> usize {
        let part = (PARTS as f64 * elevation.cos()).ceil() as usize;
        self.evaluated[part.clamp(1, PARTS) - 1]
    }

    /// Whether the antipodes of half a ring are its other half; those of any other ring are the ring below the horizon.
    fn is_whole(&self, elevation: f64) -> bool {
        self.flat || elevation == 0.0
    }

    /// Directions to be summed at an elevation.
    fn columns(&self, elevation: f64) -> usize {
        let evaluated = self.evaluated(elevation);
        if self.is_whole(elevation) { evaluated / 2 } else { evaluated }
    }

    /// `elevations` from the front that are sampled as the first of them is, no more than are taken at once.
    fn alike(&self, elevations: &[f64]) -> usize {
        let Some(first) = elevations.first() else { return 0 };
        let evaluated = self.evaluated(*first);
        let most = (AT_ONCE / evaluated).max(1);
        elevations.iter().take(most).take_while(|e| self.evaluated(**e) == evaluated).count()
    }
}

impl<T: Real> Sampler<T> {
    pub fn new(tier: Tier) -> Self {
        let (columns, work) = (Default::default(), ResampleWork::default());
        Self { ffts: Ffts::new(tier), columns, directions: Vec::new(), rows: Vec::new(), work }
    }

    /// `F` on rings at the given elevations (from 0 upwards) and, unless the motion is level, at their negatives.
    pub fn sample(&mut self, tier: Tier, scene: &Scene, elevations: &[f64], rings: &Rings) -> Sampled {
        let c = scene.columns();
        for (column, from) in self.columns.iter_mut().zip([c.x, c.y, c.z, c.re, c.im]) {
            column.clear();
            column.extend(from.iter().map(|v| T::of(*v)));
        }
        let mut sides = Sides::default();
        let mut rest = elevations;
        while !rest.is_empty() {
            let (group, tail) = rest.split_at(rings.alike(rest));
            rest = tail;
            self.sum(tier, scene, group, rings);
            let mut dense = self.work.dense.chunks_exact(rings.dense);
            for &elevation in group {
                let evaluated = rings.evaluated(elevation);
                if !rings.is_whole(elevation) {
                    sides.below(dense.next().unwrap_or_default(), elevation, evaluated);
                }
                sides.above(dense.next().unwrap_or_default(), elevation, evaluated);
            }
        }
        sides.end()
    }

    /// Fills `work.dense` with the rows of `elevations`, which are summed alike: before each comes the one below the horizon,
    /// if it has one.
    fn sum(&mut self, tier: Tier, scene: &Scene, elevations: &[f64], rings: &Rings) {
        let evaluated = elevations.first().map_or(0, |first| rings.evaluated(*first));
        let angle = |j: usize| (TAU * j as f64 / evaluated as f64).sin_cos();
        let circle: Vec<(f64, f64)> = (0..evaluated).map(angle).collect();
        self.directions.clear();
        for &elevation in elevations {
            let (sin_el, cos_el) = elevation.sin_cos();
            let turned = |(sin, cos): &(f64, f64)| [cos_el * cos, cos_el * sin, sin_el].map(T::of);
            self.directions.extend(circle[..rings.columns(elevation)].iter().map(turned));
        }
        let [x, y, z, re, im] = &self.columns;
        let columns = Columns { x, y, z, re, im };
        let sums = pairs::<T>(tier.level_or_portable(), columns, &self.directions, scene.sines());
        self.rows.clear();
        let mut rest = sums.as_slice();
        for &elevation in elevations {
            let (row, tail) = rest.split_at(rings.columns(elevation));
            rest = tail;
            self.arrange(row, rings.is_whole(elevation));
        }
        Resample::new(evaluated, rings.dense, &mut self.ffts).run(&self.rows, &mut self.work);
    }

    /// Rows from the sums of antipodal pairs: the antipode of (a, e) is (a + pi, -e).
    fn arrange(&mut self, row: &[PairSum], is_whole: bool) {
        let narrow = |c: num_complex::Complex64| Complex::new(T::of(c.re), T::of(c.im));
        let here = row.iter().map(|s| narrow(s.here()));
        if is_whole {
            self.rows.extend(here.chain(row.iter().map(|s| narrow(s.opposite()))));
        } else {
            let (first, second) = row.split_at(row.len() / 2);
            self.rows.extend(second.iter().chain(first).map(|s| narrow(s.opposite())).chain(here));
        }
    }
}

/// Both sides of the horizon, as their rows come: of each elevation the one below first.
#[derive(Default)]
struct Sides {
    up: Side,
    down: Option<Side>,
    row: Vec<f64>,
    sampled: Sampled,
}

impl Sides {
    /// Takes the sums of a row.
    fn take<T: Real>(&mut self, row: &[Complex<T>], evaluated: usize) {
        self.row.clear();
        self.row.extend(row.iter().map(|f| -> f64 { f.norm_sqr().into() }));
        self.sampled.rows += 1;
        self.sampled.summed += evaluated;
    }

    fn above<T: Real>(&mut self, row: &[Complex<T>], elevation: f64, evaluated: usize) {
        self.take(row, evaluated);
        self.up.push(&self.row, elevation, &mut self.sampled.maxima);
    }

    fn below<T: Real>(&mut self, row: &[Complex<T>], elevation: f64, evaluated: usize) {
        self.take(row, evaluated);
        // The first of them is a neighbour of the horizon, which is the last row above as yet.
        let down = self.down.get_or_insert_with(|| self.up.met_by(&self.row));
        down.push(&self.row, -elevation, &mut self.sampled.maxima);
    }

    fn end(mut self) -> Sampled {
        for side in std::iter::once(&mut self.up).chain(&mut self.down) {
            side.end(&mut self.sampled.maxima);
        }
        self.sampled
    }
}

/// A sample that none of its eight neighbours exceeds.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Maximum {
    /// Elevation of its row, radians.
    pub elevation: f64,
    /// Its place in the row.
    column: usize,
    /// The sample before it on its row, itself, and the one after it.
    around: [f64; 3],
}

impl Maximum {
    pub fn value(&self) -> f64 {
        self.around[1]
    }

    /// Where it is in its row, in steps: the vertex of the parabola through the logarithms of the three samples.
    pub fn vertex(&self) -> f64 {
        let [before, here, after] = self.around.map(|value| value.max(f64::MIN_POSITIVE).ln());
        let bend = before - 2.0 * here + after;
        let offset = if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        self.column as f64 + offset
    }
}

/// The rows on one side of the horizon, from the horizon outwards: each is searched once the next one is there. Three rows are kept,
/// and never all of them.
#[derive(Default)]
struct Side {
    /// The row before the last one, and the last one; empty if there is none.
    before: Vec<f64>,
    last: Vec<f64>,
    elevation: f64,
    /// The last row is searched by another side.
    only_beside: bool,
    /// Which samples of a row may be maxima of it.
    high: Vec<bool>,
}

impl Side {
    /// The other side of a horizon that is the only row as yet; `row` is the first one there. The horizon is searched by this
    /// side alone.
    fn met_by(&mut self, row: &[f64]) -> Self {
        self.before = row.to_vec();
        Self { last: self.last.clone(), only_beside: true, ..Self::default() }
    }

    /// Takes the next row.
    fn push(&mut self, row: &[f64], elevation: f64, maxima: &mut Vec<Maximum>) {
        self.search(row, maxima);
        std::mem::swap(&mut self.before, &mut self.last);
        self.last.clear();
        self.last.extend_from_slice(row);
        (self.elevation, self.only_beside) = (elevation, false);
    }

    /// Searches the last row, after which there is none.
    fn end(&mut self, maxima: &mut Vec<Maximum>) {
        self.search(&[], maxima);
    }

    fn search(&mut self, next: &[f64], maxima: &mut Vec<Maximum>) {
        let ring = self.last.len();
        if self.only_beside || ring == 0 {
            return;
        }
        let row = &self.last;
        // Most are below a neighbour on their own ring: said of all in a plain loop, which is vector code.
        self.high.clear();
        self.high.resize(ring, false);
        for (high, around) in self.high[1..].iter_mut().zip(row.windows(3)) {
            *high = (around[1] >= around[0]) & (around[1] >= around[2]);
        }
        (self.high[0], self.high[ring - 1]) = (true, true);
        for (column, _) in self.high.iter().enumerate().filter(|(_, high)| **high) {
            let (before, after) =
                (if column == 0 { ring - 1 } else { column - 1 }, if column + 1 == ring { 0 } else { column + 1 });
            let around = [row[before], row[column], row[after]];
            let value = around[1];
            let below = |row: &[f64]| row.is_empty() || [before, column, after].iter().all(|c| row[*c] <= value);
            if around[0] <= value && around[2] <= value && below(&self.before) && below(next) {
                maxima.push(Maximum { elevation: self.elevation, column, around });
            }
        }
    }
}

/// The second coordinate of a search; its meaning depends on the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Second {
    /// Level motion sees the cosine of the elevation and nothing else of it.
    Cosine,
    /// Any other motion sees the elevation.
    Elevation,
}

/// A direction: azimuth (radians) and the second coordinate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Point {
    pub azimuth: f64,
    pub second: f64,
}

/// A profile `F = |f|^2` with its search region in the second coordinate.
#[derive(Clone, Copy)]
pub(crate) struct Hill<'a> {
    pub level: Level,
    pub samples: Columns<'a, f64>,
    pub kind: Second,
    pub low: f64,
    pub high: f64,
    /// Trust region: largest steps in azimuth and in the second coordinate.
    pub reach: [f64; 2],
}

/// A local maximum.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Top {
    pub at: Point,
    pub value: f64,
    pub evaluations: usize,
}

/// `F`, its gradient and its Hessian (aa, ab, bb).
#[derive(Clone, Copy, Debug)]
struct Local {
    value: f64,
    gradient: [f64; 2],
    hessian: [f64; 3],
}

impl Local {
    /// How much `F` rises along a small step, to second order.
    fn rise(&self, step: [f64; 2]) -> f64 {
        let ([a, b], [aa, ab, bb]) = (step, self.hessian);
        self.gradient[0] * a + self.gradient[1] * b + 0.5 * (aa * a * a + 2.0 * ab * a * b + bb * b * b)
    }
}

/// How the direction depends on the second coordinate: `s` and height, their first and second derivatives.
struct Bend {
    s: [f64; 3],
    height: [f64; 3],
}

impl Second {
    fn bend(self, b: f64) -> Bend {
        match self {
            Self::Cosine => Bend { s: [b, 1.0, 0.0], height: [0.0; 3] },
            Self::Elevation => {
                let (sin, cos) = b.sin_cos();
                Bend { s: [cos, -sin, -cos], height: [sin, cos, -sin] }
            }
        }
    }

    pub fn elevation(self, b: f64) -> f64 {
        match self {
            Self::Cosine => b.clamp(-1.0, 1.0).acos(),
            Self::Elevation => b,
        }
    }

    pub fn of_elevation(self, elevation: f64) -> f64 {
        match self {
            Self::Cosine => elevation.cos(),
            Self::Elevation => elevation,
        }
    }
}

/// Steps this small, in units of the reach, are taken without another look: the value there follows from the derivatives
/// here to `(2 M step)^3 / 6`, below 2e-12 for the `6 M` samples that make the reach.
const NEAR: f64 = 1e-4;

impl Hill<'_> {
    /// True if the second coordinate is fixed: derivatives by it are then not computed.
    fn is_ring(&self) -> bool {
        self.low >= self.high
    }

    /// Value and derivatives at a point, from the moments of the samples.
    fn local(&self, at: Point) -> Local {
        let Bend { s: [s, ds, dds], height: [height, dh, ddh] } = self.kind.bend(at.second);
        let (sin, cos) = at.azimuth.sin_cos();
        let wanted = if self.is_ring() { Wanted::Azimuth } else { Wanted::Both };
        let m = moments(self.level, self.samples, Aim { cos, sin, s, height }, wanted);
        let j = Complex64::i();
        // With theta = 2 pi (s h + height z): dh/da = v, dv/da = -h.
        let fa = -j * TAU * s * m.v;
        let fb = -j * TAU * (m.h * ds + m.z * dh);
        let faa = j * TAU * s * m.h - TAU * TAU * s * s * m.vv;
        let fab = -j * TAU * ds * m.v - TAU * TAU * s * (m.hv * ds + m.vz * dh);
        let fbb = -j * TAU * (m.h * dds + m.z * ddh)
            - TAU * TAU * (m.hh * (ds * ds) + m.hz * (2.0 * ds * dh) + m.zz * (dh * dh));
        let with = |g: Complex64| 2.0 * (m.one.conj() * g).re;
        let cross = |g: Complex64, h: Complex64| 2.0 * (g.conj() * h).re;
        Local {
            value: m.one.norm_sqr(),
            gradient: [with(fa), with(fb)],
            hessian: [with(faa) + cross(fa, fa), with(fab) + cross(fa, fb), with(fbb) + cross(fb, fb)],
        }
    }

    /// The value at a point.
    pub fn value(&self, at: Point) -> f64 {
        self.local(at).value
    }

    /// Climbs from `start` to the local maximum of its hill.
    pub fn climb(&self, start: Point) -> Top {
        let mut at = Point { azimuth: start.azimuth, second: start.second.clamp(self.low, self.high) };
        let mut here = self.local(at);
        let mut evaluations = 1;
        for _ in 0..40 {
            let mut step = self.step(at, &here);
            if (0..2).all(|i| step[i].abs() <= NEAR * self.reach[i]) && here.hessian[0] < 0.0 {
                let second = (at.second + step[1]).clamp(self.low, self.high);
                here.value += here.rise([step[0], second - at.second]).max(0.0);
                at = Point { azimuth: at.azimuth + step[0], second };
                break;
            }
            let mut moved = false;
            for _ in 0..12 {
                let to =
                    Point { azimuth: at.azimuth + step[0], second: (at.second + step[1]).clamp(self.low, self.high) };
                let there = self.local(to);
                evaluations += 1;
                if there.value >= here.value {
                    (at, here, moved) = (to, there, true);
                    break;
                }
                if step[0].abs() < 1e-9 && step[1].abs() < 1e-9 {
                    break;
                }
                step = step.map(|d| d / 4.0);
            }
            if !moved || (step[0].abs() < 1e-8 && step[1].abs() < 1e-8) {
                break;
            }
        }
        Top { at, value: here.value, evaluations }
    }

    /// A Newton step where the hill is concave, else a step along the gradient; within reach, and along the edge
    /// where the gradient points out of the region.
    fn step(&self, at: Point, local: &Local) -> [f64; 2] {
        let [ga, gb] = local.gradient;
        let [haa, hab, hbb] = local.hessian;
        let at_edge = (at.second <= self.low && gb <= 0.0) || (at.second >= self.high && gb >= 0.0);
        let [ra, rb] = self.reach;
        let fallback = |g: f64, h: f64, r: f64| if h < 0.0 { (-g / h).clamp(-r, r) } else { r.copysign(g) };
        if at_edge || self.is_ring() {
            return [fallback(ga, haa, ra), 0.0];
        }
        let det = haa * hbb - hab * hab;
        if haa < 0.0 && det > 0.0 {
            let step = [(hab * gb - hbb * ga) / det, (hab * ga - haa * gb) / det];
            let shrink = (ra / step[0].abs()).min(rb / step[1].abs()).min(1.0);
            return step.map(|d| d * shrink);
        }
        // Along the gradient of the profile in units of the reach, as far as the reach.
        let (na, nb) = (ga * ra, gb * rb);
        let norm = na.hypot(nb);
        if norm == 0.0 { [0.0; 2] } else { [ra * na / norm, rb * nb / norm] }
    }
}

/// What a fit of one plane wave leaves.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fit {
    /// `|A|^2 / sigma^2` for unit (scaled) weight.
    ratio: f64,
    /// The same for a sample of mean weight: the signal-to-noise ratio.
    pub snr: f64,
}

impl Fit {
    /// From `F = |f|^2` at the estimate. The amplitude is relieved of the noise's own share.
    pub fn new(scene: &Scene, value: f64) -> Self {
        let used = scene.weight.iter().filter(|w| **w > 0.0).count() as f64;
        let w = scene.weight_sum;
        let residual = (scene.energy - value / w).max(0.0);
        // One complex amplitude and two angles are fitted: two complex degrees of freedom.
        let variance = if used > 2.0 { residual / (used - 2.0) } else { f64::INFINITY };
        let amplitude = (value / (w * w) - variance / w).max(0.0);
        let ratio = if variance == f64::INFINITY { 0.0 } else { amplitude / variance };
        Self { ratio, snr: ratio * w / used }
    }
}

/// Weighted, centred second moments of the positions about an azimuth, turns squared: hh, hv, vv, hz, vz, zz.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Spread([f64; 6]);

impl Spread {
    pub fn new(scene: &Scene, azimuth: f64) -> Self {
        let [xx, xy, yy, xz, yz, zz] = scene.weighted_scatter();
        let (s, c) = azimuth.sin_cos();
        // h = c x + s y, v = c y - s x.
        Self([
            c * c * xx + 2.0 * c * s * xy + s * s * yy,
            c * s * (yy - xx) + (c * c - s * s) * xy,
            s * s * xx - 2.0 * c * s * xy + c * c * yy,
            c * xz + s * yz,
            c * yz - s * xz,
            zz,
        ])
    }
}

/// Standard deviations of azimuth and of the second coordinate, each with the other as a nuisance: the Cramer-Rao bound.
///
/// With `second_known` the azimuth stands alone (and the second deviation is infinite); along the motion it is known by the
/// square of its change. Nothing exceeds a uniform guess for the azimuth.
pub(crate) fn deviations(fit: Fit, spread: Spread, kind: Second, at: Point, second_known: bool) -> [f64; 2] {
    let gain = 2.0 * fit.ratio * TAU * TAU;
    let [aa, ab, bb] = information(spread, kind, at);
    let det = aa * bb - ab * ab;
    let sd = |information: f64| if information > 0.0 { (1.0 / information).sqrt() } else { f64::INFINITY };
    if second_known {
        // Towards or away from the motion phases do not change with the azimuth to first order, and by half of its square to
        // second: then that square is what is known.
        let [s, ..] = kind.bend(at.second).s;
        let by_square = (2.0 * sd(gain * s * s * spread.0[0])).sqrt();
        return [sd(gain * aa).min(by_square).min(UNIFORM_RAD), f64::INFINITY];
    }
    // A determinant of the size of rounding errors: the two coordinates have the same effect on the phases.
    if det <= 1e-13 * aa * bb {
        return [UNIFORM_RAD, f64::INFINITY];
    }
    [sd(gain * det / bb).min(UNIFORM_RAD), sd(gain * det / aa)]
}

/// How far the phases that a change of azimuth makes differ from those that a change of the second coordinate makes:
/// `1 - r^2` of their correlation over the trajectory, 0 (the same, as on a line) to 1 (a circle).
pub(crate) fn independence(spread: Spread, kind: Second, at: Point) -> f64 {
    let [aa, ab, bb] = information(spread, kind, at);
    if aa * bb > 0.0 { (1.0 - ab * ab / (aa * bb)).max(0.0) } else { 0.0 }
}

/// Information on azimuth, on both, and on the second coordinate, but for a common factor.
fn information(spread: Spread, kind: Second, at: Point) -> [f64; 3] {
    let Bend { s: [s, ds, _], height: [_, dh, _] } = kind.bend(at.second);
    let [hh, hv, vv, hz, vz, zz] = spread.0;
    [s * s * vv, s * (ds * hv + dh * vz), ds * ds * hh + 2.0 * ds * dh * hz + dh * dh * zz]
}

/// Standard deviation of |elevation|, radians, from that of its cosine.
///
/// Near the horizon the cosine is flat: an error `d` of it is an elevation of `sqrt(2 d)`.
pub(crate) fn elevation_deviation(elevation: f64, cosine_sd: f64) -> f64 {
    let sin = elevation.sin();
    (cosine_sd / (sin * sin + 2.0 * cosine_sd).sqrt()).min(PI / 2.0)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::bartlett::planner::{oracle, oracle_sum};
    use crate::bartlett::{Grid, direction, profile};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const WAVELENGTH: f64 = 0.054;

    /// A standard normal pair as a complex number of unit variance.
    pub(in crate::bartlett) fn noise(rng: &mut ChaCha8Rng) -> Complex64 {
        let radius = (-(1.0 - rng.random::<f64>()).ln()).sqrt();
        Complex64::from_polar(radius, TAU * rng.random::<f64>())
    }

    /// Plane waves (azimuth, elevation, amplitude) over `points`, in white noise of variance `variance`.
    pub(in crate::bartlett) fn samples(
        points: &[Vector3<f64>],
        paths: &[(f64, f64, Complex64)],
        variance: f64,
        rng: &mut ChaCha8Rng,
    ) -> Samples {
        let mut samples = Samples::new(WAVELENGTH, 2).unwrap();
        for (t, p) in points.iter().enumerate() {
            let wave = |&(a, e, g): &(f64, f64, Complex64)| {
                g * Complex64::from_polar(1.0, TAU * 2.0 / WAVELENGTH * direction(a, e).dot(p))
            };
            let z = paths.iter().map(wave).sum::<Complex64>() + noise(rng) * variance.sqrt();
            samples.push(t as f64 * 0.01, z, *p, Vector3::zeros()).unwrap();
        }
        samples
    }

    pub(in crate::bartlett) fn track(shape: usize, radius: f64, n: usize, rng: &mut ChaCha8Rng) -> Vec<Vector3<f64>> {
        let turn = TAU * rng.random::<f64>();
        let mut walk = Vector3::zeros();
        (0..n)
            .map(|t| {
                let s = t as f64 / (n - 1).max(1) as f64;
                let a = turn + TAU * s;
                match shape {
                    0 => Vector3::new(radius * a.cos(), radius * a.sin(), 0.0),
                    1 => Vector3::new(turn.cos(), turn.sin(), 0.0) * (radius * (2.0 * s - 1.0)),
                    2 => Vector3::new(radius * (turn + 2.0 * s).cos(), radius * (turn + 2.0 * s).sin(), 0.0),
                    3 => {
                        let step = noise(rng) * (radius / (n as f64).sqrt());
                        walk += Vector3::new(step.re, step.im, 0.0);
                        walk
                    }
                    _ => Vector3::new(radius * a.cos(), radius * a.sin(), radius * s),
                }
            })
            .collect()
    }

    pub(in crate::bartlett) fn random_scene(case: usize, rng: &mut ChaCha8Rng) -> Samples {
        let radius = 0.05 * 30f64.powf(rng.random::<f64>());
        let n = rng.random_range(20..90);
        let points = track(case % 5, radius, n, rng);
        let paths: Vec<_> = (0..rng.random_range(1..=3))
            .map(|_| {
                let gain = Complex64::from_polar(rng.random_range(0.5..1.0), TAU * rng.random::<f64>());
                (TAU * rng.random::<f64>(), rng.random_range(-0.3..0.3), gain)
            })
            .collect();
        samples(&points, &paths, 10f64.powf(rng.random_range(-3.0..0.5)), rng)
    }

    /// The highest value on a grid far denser than any bound asks for, at the given elevations.
    fn dense_max(samples: &Samples, elevations: &[f64], oversampling: f64) -> f64 {
        let scene = Scene::new(samples).unwrap();
        let half = (oversampling * (TAU * scene.radius + 10.0)).ceil() as usize;
        let directions: Vec<[f64; 3]> = elevations
            .iter()
            .flat_map(|&e| (0..2 * half).map(move |i| direction(PI * i as f64 / half as f64, e).into()))
            .collect();
        let sums = pairs::<f64>(Tier::detect().level_or_portable(), scene.columns(), &directions, Sines::Fine);
        let top = sums.iter().map(|s| s.here().norm_sqr().max(s.opposite().norm_sqr())).fold(0.0, f64::max);
        top / (scene.sum_abs * scene.sum_abs)
    }

    #[test]
    fn the_azimuth_search_finds_the_continuous_maximum() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for case in 0..400 {
            let samples = random_scene(case, &mut rng);
            let options = SearchOptions { elevation_max_rad: 0.0, ..SearchOptions::default() };
            let estimate = search(&samples, &options).unwrap();
            let dense = dense_max(&samples, &[0.0], 20.0);
            assert!(estimate.value >= dense * (1.0 - 1e-12), "case {case}: {} below {dense}", estimate.value);
            // Not above what the profile really is.
            let exact = oracle(&samples, &Grid::directions(vec![(estimate.azimuth_rad, 0.0)])).unwrap();
            assert!((exact.values[0] - estimate.value).abs() < 1e-12);
        }
    }

    #[test]
    fn the_search_over_elevation_finds_the_continuous_maximum() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut searched = 0;
        for case in 0..120 {
            let samples = random_scene(case, &mut rng);
            let estimate = search(&samples, &SearchOptions::default()).unwrap();
            if !estimate.elevation_searched {
                continue;
            }
            searched += 1;
            let limit = 20f64.to_radians();
            let elevations: Vec<f64> = (0..=40).map(|i| limit * f64::from(i) / 40.0).collect();
            let dense = dense_max(&samples, &elevations, 4.0);
            assert!(estimate.value >= dense * (1.0 - 1e-12), "case {case}: {} below {dense}", estimate.value);
        }
        assert!(searched > 60, "elevation was searched in {searched} scenes only");
    }

    #[test]
    fn kernels_agree_with_the_oracle_on_every_tier() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for case in 0..10 {
            let scene = Scene::new(&random_scene(case, &mut rng)).unwrap();
            let directions: Vec<Vector3<f64>> =
                (0..37).map(|_| direction(TAU * rng.random::<f64>(), rng.random_range(-1.5..1.5))).collect();
            let single = |c: &[f64]| c.iter().map(|v| f32::of(*v)).collect::<Vec<_>>();
            let c = Columns { x: &scene.x, y: &scene.y, z: &scene.z, re: &scene.re, im: &scene.im };
            let (x, y, z, re, im) = (single(c.x), single(c.y), single(c.z), single(c.re), single(c.im));
            let narrow = Columns { x: &x, y: &y, z: &z, re: &re, im: &im };
            let list: Vec<[f64; 3]> = directions.iter().map(|u| (*u).into()).collect();
            let list32: Vec<[f32; 3]> = list.iter().map(|u| u.map(|v| v as f32)).collect();
            for tier in Tier::available() {
                let level = tier.level().unwrap();
                let wide = pairs::<f64>(level, c, &list, Sines::Fine);
                let thin = pairs::<f32>(level, narrow, &list32, Sines::Fine);
                let rough = pairs::<f32>(level, narrow, &list32, Sines::Rough);
                for (i, u) in directions.iter().enumerate() {
                    let here = oracle_sum(&scene, u);
                    let opposite = oracle_sum(&scene, &-u);
                    // Phases of up to `radius` turns are rounded to 2^-53 (2^-24) of themselves, three times.
                    let tolerance = scene.sum_abs * (4.0 + 20.0 * scene.radius);
                    for (sum, unit) in [(wide[i], 2f64.powi(-53)), (thin[i], 2f64.powi(-24))] {
                        assert!((sum.here() - here).norm() < tolerance * unit, "{tier:?}");
                        assert!((sum.opposite() - opposite).norm() < tolerance * unit, "{tier:?}");
                    }
                    let tolerance = tolerance * 2f64.powi(-24) + scene.sum_abs * ROUGH;
                    assert!((rough[i].here() - here).norm() < tolerance, "{tier:?}");
                    assert!((rough[i].opposite() - opposite).norm() < tolerance, "{tier:?}");
                }
            }
        }
    }

    #[test]
    fn estimates_agree_across_tiers() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        for case in 0..5 {
            let samples = random_scene(case, &mut rng);
            let reference = search(&samples, &SearchOptions::default()).unwrap();
            for tier in Tier::available() {
                let options = SearchOptions { tier, ..SearchOptions::default() };
                let estimate = search(&samples, &options).unwrap();
                assert!((estimate.value - reference.value).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn the_observed_deviation_is_the_cramer_rao_bound() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let points = track(0, 0.3, 1_000, &mut rng);
        for (variance, elevation_max_rad) in [(0.01, 0.0), (0.5, 0.0), (0.5, 0.35)] {
            let (mut squares, mut predicted, mut elevation) = (0.0, 0.0, 0.0);
            let trials = 400;
            for _ in 0..trials {
                let truth = TAU * rng.random::<f64>();
                let raised = if elevation_max_rad > 0.0 { 0.2 } else { 0.0 };
                let samples = samples(&points, &[(truth, raised, Complex64::ONE)], variance, &mut rng);
                let options = SearchOptions { elevation_max_rad, ..SearchOptions::default() };
                let estimate = search(&samples, &options).unwrap();
                squares += wrap_rad(estimate.azimuth_rad - truth).powi(2);
                predicted += estimate.azimuth_sd_rad;
                elevation += ((estimate.abs_elevation_rad - raised) / estimate.elevation_sd_rad).powi(2);
                assert!((estimate.snr * variance - 1.0).abs() < 0.3);
            }
            let kappa = TAU * 2.0 / WAVELENGTH;
            let bound = 1.0 / (kappa * 0.3 * (1_000.0 / variance).sqrt())
                * if elevation_max_rad > 0.0 { 1.0 / 0.2f64.cos() } else { 1.0 };
            let rms = (squares / f64::from(trials)).sqrt();
            // 400 trials: the standard deviation of an observed one is 3.5 percent of it.
            assert!((rms / bound - 1.0).abs() < 0.12, "observed {rms} bound {bound}");
            assert!((predicted / f64::from(trials) / bound - 1.0).abs() < 0.03);
            if elevation_max_rad > 0.0 {
                assert!(((elevation / f64::from(trials)).sqrt() - 1.0).abs() < 0.12);
            }
        }
    }

    #[test]
    fn a_raised_transmitter_does_not_bias_the_azimuth_of_an_arc() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let points = track(2, 0.5, 300, &mut rng);
        let samples = samples(&points, &[(0.7, 0.25, Complex64::ONE)], 1e-4, &mut rng);
        let free = search(&samples, &SearchOptions::default()).unwrap();
        assert!((free.azimuth_rad - 0.7).abs() < 5.0 * free.azimuth_sd_rad);
        assert!((free.abs_elevation_rad - 0.25).abs() < 5.0 * free.elevation_sd_rad);
        assert_eq!(free.signed_elevation_rad, None);
        let options = SearchOptions { elevation_max_rad: 0.0, ..SearchOptions::default() };
        let level = search(&samples, &options).unwrap();
        assert!((level.azimuth_rad - 0.7).abs() > 5.0 * free.azimuth_sd_rad, "the bias that the elevation removes");
    }

    #[test]
    fn a_helix_tells_the_sign_of_the_elevation() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for elevation in [-0.2, 0.2] {
            let points = track(4, 0.3, 300, &mut rng);
            let samples = samples(&points, &[(2.0, elevation, Complex64::ONE)], 0.1, &mut rng);
            let estimate = search(&samples, &SearchOptions::default()).unwrap();
            assert_eq!(estimate.geometry, Geometry::Spatial);
            assert!((estimate.signed_elevation_rad.unwrap() - elevation).abs() < 5.0 * estimate.elevation_sd_rad);
        }
    }

    #[test]
    fn a_line_reports_both_bearings() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        for case in 0..20 {
            let points = track(1, 0.4, 200, &mut rng);
            let axis = points[199].y.atan2(points[199].x);
            let off = rng.random_range(0.4..2.7);
            let samples = samples(&points, &[(axis + off, 0.0, Complex64::ONE)], 0.1, &mut rng);
            let estimate = search(&samples, &SearchOptions::default()).unwrap();
            assert_eq!(estimate.geometry, Geometry::Line);
            assert!(!estimate.elevation_searched);
            let mirror = estimate.mirror_rad.unwrap();
            let pair = [estimate.azimuth_rad, mirror];
            for expected in [axis + off, axis - off] {
                assert!(
                    pair.iter().any(|a| wrap_rad(a - expected).abs() < 0.02),
                    "case {case}: {pair:?} without {expected}"
                );
            }
            assert!(estimate.peak_ratio.unwrap() < 0.9);
        }
    }

    /// The columns of samples, to be changed and made samples again.
    pub(in crate::bartlett) struct Parts {
        wavelength_m: f64,
        path_gain: u8,
        z: Vec<Complex64>,
        pub(in crate::bartlett) receiver_m: Vec<Vector3<f64>>,
        weight: Vec<f64>,
    }

    impl Parts {
        pub(in crate::bartlett) fn of(samples: &Samples) -> Self {
            Self {
                wavelength_m: samples.wavelength_m(),
                path_gain: samples.path_gain(),
                z: samples.z().to_vec(),
                receiver_m: samples.receiver_m().to_vec(),
                weight: samples.weight().to_vec(),
            }
        }

        pub(in crate::bartlett) fn samples(&self) -> Result<Samples, Error> {
            let mut samples = Samples::new(self.wavelength_m, self.path_gain)?;
            for ((z, p), w) in self.z.iter().zip(&self.receiver_m).zip(&self.weight) {
                samples.push_weighted(0.0, *z, *p, Vector3::zeros(), *w)?;
            }
            Ok(samples)
        }
    }

    #[test]
    fn bad_input_has_its_own_error_each() {
        use crate::signal::samples::SamplesError::{NonFinite, PathGain, Wavelength, Weight};
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let points = track(0, 0.3, 50, &mut rng);
        let good = samples(&points, &[(1.0, 0.0, Complex64::ONE)], 0.1, &mut rng);
        let run = |change: &dyn Fn(&mut Parts)| {
            let mut parts = Parts::of(&good);
            change(&mut parts);
            search(&parts.samples()?, &SearchOptions::default())
        };
        assert!(run(&|_| ()).is_ok());
        assert_eq!(run(&|s| s.z.clear()).unwrap_err(), Error::Empty);
        assert!(matches!(run(&|s| s.z[7].im = f64::NAN), Err(Error::Samples(NonFinite { what: "sample", index: 7 }))));
        assert!(matches!(run(&|s| s.receiver_m[3].z = f64::INFINITY), Err(Error::Samples(NonFinite { index: 3, .. }))));
        assert!(matches!(run(&|s| s.receiver_m[3].z = f64::MAX), Err(Error::NonFinite { .. })));
        assert!(matches!(run(&|s| s.weight[2] = -1.0), Err(Error::Samples(Weight { index: 2, .. }))));
        assert!(matches!(run(&|s| s.z.fill(Complex64::ZERO)), Err(Error::ZeroEnergy { count: 50 })));
        assert!(matches!(run(&|s| s.path_gain = 0), Err(Error::Samples(PathGain))));
        assert!(matches!(run(&|s| s.receiver_m.fill(Vector3::x())), Err(Error::NoMotion { .. })));
        assert!(matches!(run(&|s| s.receiver_m.iter_mut().for_each(|p| *p *= 1e9)), Err(Error::Aperture { .. })));
        for wavelength in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(run(&|s| s.wavelength_m = wavelength), Err(Error::Samples(Wavelength { .. }))));
        }
        let options = SearchOptions { elevation_max_rad: 2.0, ..SearchOptions::default() };
        assert!(matches!(search(&good, &options), Err(Error::ElevationMax { .. })));
        assert!(matches!(profile(&good, &Grid::directions(vec![(0.0, f64::NAN)])), Err(Error::Direction { .. })));
    }

    #[test]
    fn offsets_and_magnitudes_cost_nothing() {
        let mut rng = ChaCha8Rng::seed_from_u64(10);
        let points = track(2, 0.3, 100, &mut rng);
        let samples = samples(&points, &[(1.0, 0.1, Complex64::ONE)], 0.1, &mut rng);
        let reference = search(&samples, &SearchOptions::default()).unwrap();
        for (offset, scale) in [(1e6, 1.0), (0.0, 1e-300), (0.0, 1e300), (-1e6, 1e-30)] {
            let mut moved = Parts::of(&samples);
            moved.receiver_m.iter_mut().for_each(|p| *p += Vector3::new(offset, -offset, 0.0));
            moved.z.iter_mut().for_each(|z| *z *= scale);
            let estimate = search(&moved.samples().unwrap(), &SearchOptions::default()).unwrap();
            // At 1e6 m the positions themselves are rounded to 1e-10 m.
            assert!(wrap_rad(estimate.azimuth_rad - reference.azimuth_rad).abs() < 1e-7);
            assert!((estimate.value - reference.value).abs() < 1e-7);
            assert!((estimate.snr / reference.snr - 1.0).abs() < 1e-5);
        }
    }

    /// Rows of ascending elevation, `rows[half]` the horizon.
    fn found(rows: &[Vec<f64>]) -> Vec<Maximum> {
        let half = rows.len() / 2;
        let mut maxima = Vec::new();
        let mut up = Side::default();
        up.push(&rows[half], 0.0, &mut maxima);
        if half > 0 {
            let mut down = up.met_by(&rows[half - 1]);
            for k in 1..=half {
                down.push(&rows[half - k], -(k as f64), &mut maxima);
                up.push(&rows[half + k], k as f64, &mut maxima);
            }
            down.end(&mut maxima);
        }
        up.end(&mut maxima);
        maxima
    }

    #[test]
    fn the_maxima_are_those_that_no_neighbour_exceeds() {
        let mut state = 9u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64
        };
        for half in [0, 1, 2, 7] {
            let (n, ring) = (2 * half + 1, 11);
            let rows: Vec<Vec<f64>> = (0..n).map(|_| (0..ring).map(|_| random()).collect()).collect();
            let mut expected = Vec::new();
            for (r, own) in rows.iter().enumerate() {
                for (column, value) in own.iter().enumerate() {
                    let near = |row: &Vec<f64>| [ring - 1, 0, 1].map(|d| row[(column + d) % ring]);
                    let around = near(own);
                    let beside = rows[r.saturating_sub(1)..(r + 2).min(n)].iter().flat_map(near);
                    if beside.fold(0.0, f64::max) <= *value {
                        expected.push((r as f64 - half as f64, column, around));
                    }
                }
            }
            let mut got: Vec<_> = found(&rows).iter().map(|m| (m.elevation, m.column, m.around)).collect();
            got.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            assert!(!expected.is_empty());
            assert_eq!(got, expected, "{half}");
        }
    }
}
