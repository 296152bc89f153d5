//! The search and its results.

use super::explain::SearchPlan;
use super::scene::{Geometry, Shape};
use crate::estimate::tuning::sensor;
use csi5300_kernels::simd::Tier;
use nalgebra::Vector3;

/// What to search.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct SearchOptions {
    /// Largest |elevation| of the search, radians, 0 to pi/2. Default 20 degrees. 0 fixes the horizon.
    pub elevation_max_rad: f64,
    /// Assumed standard deviation of the positions, metres: with the noise it decides whether the motion's depth
    /// distinguishes a direction from its reflection. Default 3 mm.
    pub odometry_sd_m: f64,
    /// The SIMD tier to run on. Default: the widest of this machine.
    pub tier: Tier,
}

impl Default for SearchOptions {
    fn default() -> Self {
        Self { elevation_max_rad: 20f64.to_radians(), odometry_sd_m: sensor::POSITION_M, tier: Tier::detect() }
    }
}

impl SearchOptions {
    /// With another largest |elevation|, radians, 0 to pi/2; 0 fixes the horizon.
    #[must_use]
    pub fn with_elevation_max_rad(mut self, elevation_max_rad: f64) -> Self {
        self.elevation_max_rad = elevation_max_rad;
        self
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

/// A bearing with its uncertainty.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Estimate {
    /// Azimuth of the highest peak, radians in (-pi, pi], from +x towards +y in the trajectory's frame.
    pub azimuth_rad: f64,
    /// |elevation| of the peak, radians; 0 where it was not searched or cannot be observed.
    pub abs_elevation_rad: f64,
    /// The elevation with its sign, where the motion distinguishes the two; in a tilted plane the sign that goes with this
    /// azimuth, the [mirror](Self::mirror_rad) having its own.
    pub signed_elevation_rad: Option<f64>,
    /// Predicted standard deviation of the azimuth (Cramer-Rao), radians; with the elevation as a nuisance where that
    /// was searched. At most that of a uniform guess, pi / sqrt 3.
    pub azimuth_sd_rad: f64,
    /// Predicted standard deviation of |elevation|, radians; pi/2 where it was not searched or cannot be observed.
    pub elevation_sd_rad: f64,
    /// True if the elevation was searched: it was asked for, and this motion can observe it.
    pub elevation_searched: bool,
    /// Azimuth of the mirror, radians: the bearing reflected in the line or in the tilted plane of the motion, where noise and
    /// the odometry's error explain the difference between the two. Neither is preferred for a reason. None where the
    /// reflection differs by the sign of the elevation alone (a horizontal plane).
    pub mirror_rad: Option<f64>,
    /// Elevation of the mirror, radians, with its sign; none where the elevation was not searched.
    pub mirror_elevation_rad: Option<f64>,
    /// Share of the evidence that the mirror has of the two, 0.01 to 0.5.
    pub mirror_share: Option<f64>,
    /// Unit normal of the plane that the mirror is reflected in.
    pub(crate) mirror_normal: Option<Vector3<f64>>,
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
    /// Computed and skipped parts of the search.
    pub plan: SearchPlan,
}
