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

use std::f64::consts::{PI, TAU};

use super::bessel::tail_order;
use super::cost::pair_ns;
use super::crb::{Fit, Spread, deviations, independence};
use super::error::Error;
use super::estimate::{Estimate, SearchOptions};
use super::explain::{ElevationSearch, Precision, SearchPlan};
use super::mirror::odometry_tells;
use super::newton::{Hill, Point, Second, Top};
use super::report::{Findings, REPORTED, mirror_start};
use super::sampler::{RING_STEP, Rings, Sampled, Sampler, elevation_rings};
use super::scene::{Scene, Shape};
use crate::estimate::tuning::sensor;
use crate::signal::samples::Samples;
use csi5300_kernels::fft::good_size;
use csi5300_kernels::simd::{ROUGH, Tier};
use csi5300_kernels::sums::Sines;
use nalgebra::Vector3;

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
    Searcher::new(options.tier).search_with(samples, options.elevation_max_rad, options.odometry_sd_m)
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
        self.search_with(samples, elevation_max_rad, sensor::POSITION_M)
    }

    /// As [`Searcher::search`], with the assumed error of the positions.
    ///
    /// # Errors
    /// As [`search`].
    pub(crate) fn search_with(
        &mut self,
        samples: &Samples,
        elevation_max_rad: f64,
        odometry_sd_m: f64,
    ) -> Result<Estimate, Error> {
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
        let ring = good_size(SAMPLES_PER_ORDER * order + 16);
        let shape = scene.shape();
        let search = Search { scene: &scene, shape, tools: self, order, ring, evaluations: 0, exact: 0 };
        Ok(search.run(elevation_max_rad, odometry_sd_m))
    }
}

/// One search under way.
struct Search<'a> {
    scene: &'a Scene,
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
        let (tier, samples) = (self.tools.tier, self.scene.len());
        let pair = pair_ns(tier, precision);
        // An exact look, with its derivatives in double, takes about as long as four pairs.
        let pairs = (self.evaluations - self.exact) as f64 / 2.0 + 4.0 * self.exact as f64;
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
        let sampled = if self.in_double() {
            self.tools.double.sample(self.tools.tier, self.scene, elevations, &rings)
        } else {
            self.tools.single.sample(self.tools.tier, self.scene, elevations, &rings)
        };
        self.evaluations += sampled.summed;
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
