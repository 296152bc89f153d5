//! From the tops that were climbed to an estimate: distinct peaks, predicted deviations.

use std::f64::consts::{PI, TAU};

use super::crb::{Fit, Spread, deviations, elevation_deviation};
use super::estimate::{Estimate, Peak};
use super::explain::{ElevationSearch, SearchPlan};
use super::mirror::{Reflections, axis, is_thin};
use super::newton::{Hill, Point, Second, Top};
use super::scene::{Geometry, Scene, Shape};
use crate::maths::wrap_rad;

/// Peaks that are reported; those that the bound rules out as the highest as they were sampled.
pub(super) const REPORTED: usize = 6;
/// Where to climb for the mirror of the highest top: reflected about the axis of the motion, if it is long and narrow.
pub(super) fn mirror_start(shape: &Shape, tops: &[Top]) -> Option<Point> {
    let axis = axis(shape).filter(|_| is_thin(shape, 1))?;
    let best = tops.iter().max_by(|a, b| a.value.total_cmp(&b.value))?;
    Some(Point { azimuth: 2.0 * axis - best.at.azimuth, second: best.at.second })
}

/// What a search found.
pub(super) struct Findings<'a> {
    pub scene: &'a Scene,
    pub shape: Shape,
    pub hill: &'a Hill<'a>,
    /// Falling, at least one.
    pub tops: &'a [Top],
    pub plan: SearchPlan,
    /// Assumed error of the positions, metres.
    pub odometry_sd_m: f64,
    /// Directions in which the profile was evaluated.
    pub evaluations: usize,
}

impl Findings<'_> {
    pub fn estimate(self) -> Estimate {
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
