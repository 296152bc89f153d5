//! What is searched, and what is found.

use super::explain::SearchPlan;
use super::scene::{Geometry, Shape};
use csi5300_kernels::simd::Tier;

/// What to search.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
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

impl SearchOptions {
    /// With another largest |elevation|, radians, 0 to pi/2; 0 fixes the horizon.
    #[must_use]
    pub fn with_elevation_max_rad(mut self, elevation_max_rad: f64) -> Self {
        self.elevation_max_rad = elevation_max_rad;
        self
    }

    /// On another SIMD tier.
    #[must_use]
    pub fn with_tier(mut self, tier: Tier) -> Self {
        self.tier = tier;
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

/// A bearing and what can be said about it.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Estimate {
    /// Azimuth of the highest peak, radians in (-pi, pi], from +x towards +y in the trajectory's frame.
    pub azimuth_rad: f64,
    /// |elevation| of the peak, radians; 0 where it was not searched or cannot be observed.
    pub abs_elevation_rad: f64,
    /// The elevation with its sign, where the motion distinguishes the two.
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
