//! Bartlett profiles and the bearings that they hold.
//!
//! # Frame and signs
//! Positions are metres in the trajectory's frame. `u(azimuth, elevation) = (cos el cos az, cos el sin az, sin el)` is
//! the unit vector **from the receiver to the transmitter**, azimuth from +x towards +y, elevation from the xy plane
//! upwards ([`direction`]). A sample is `z ~ exp(-j 2 pi g |tx - rx| / lambda)` with the path gain `g` (2 for a round
//! trip), so with the displacement `p = rx - tx` a plane wave from `u` has `z ~ exp(+j 2 pi g u.p / lambda)`: moving
//! towards the transmitter turns the phase forward. The profile is
//!
//! `F(u) = |f(u)|^2,  f(u) = sum_t w_t z_t exp(-j 2 pi g u.p_t / lambda)`
//!
//! (Bartlett's spectrum \[bartlett1948\] over directions \[stoica-moses2005\]; keys in brackets are those of `docs/reference/references.md`).
//!
//! In polar coordinates of the displacement (length `rho`, azimuth `phi_p`, angle from the zenith `xi`) and of the
//! direction (azimuth `phi`, angle from the zenith `theta`) the exponent is
//! `2 pi g rho / lambda * (sin(theta) sin(xi) cos(phi - phi_p) + cos(xi) cos(theta))`, `4 pi rho / lambda * (...)` for
//! `g = 2`. As printed, the steering vector of \[paper\] lacks the parentheses around the two terms, and
//! theta is called the azimuth where the formula needs the zenith angle (phi being the azimuth).
//!
//! # Modules
//! * **Input**: `scene` centres and scales samples, and knows the shape of the motion.
//! * **Profiles**: `grid` has the directions and the profile. `planner` chooses the cheapest method for a grid, a tolerance and a motion,
//!   keeps its tables for the next call, and has the oracle; sums, FFTs, rings and NUFFTs are those of `csi5300_kernels`.
//! * **Bearings**: `search` samples rings (`sampler`), takes the maxima that the bound does not rule out and climbs them (`newton`);
//!   `mirror` judges which directions the motion cannot tell apart.

mod grid;
mod mirror;
mod newton;
pub(crate) mod planner;
mod sampler;
mod scene;
pub(crate) mod search;

pub use csi5300_kernels::simd::Tier;
pub(crate) use grid::wsr_planar_profile_variance;
pub use grid::{Grid, Profile, direction};
pub use planner::{Explanation, Method, Planner, Precision, ProfileOptions};
pub use scene::{Geometry, Shape};
pub use search::{ElevationSearch, SearchPlan, search};
pub(crate) use search::{Means, Searcher};

use crate::estimate::tuning::sensor;
use crate::signal::samples::{Samples, SamplesError};
use nalgebra::Vector3;

/// The Bartlett profile of `samples` over `grid` with the default guarantee, `|f~ - f| <= 1e-4 sum w |z|`, by a planner
/// of its own. Keep a [`Planner`] to reuse plans.
///
/// # Errors
/// As [`Planner::profile`].
pub fn profile(samples: &Samples, grid: &Grid) -> Result<Profile, Error> {
    Planner::default().profile(samples, grid, &ProfileOptions::default())
}

/// Why there is no profile or no bearing. Every variant is found before any computation.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// There is no sample at all.
    #[error("no samples: check that both logs cover the motion")]
    Empty,
    /// Samples that cannot be made, or added to.
    #[error(transparent)]
    Samples(#[from] SamplesError),
    /// Positions that are not finite as soon as they are subtracted or expressed in wavelengths.
    #[error("{what} of sample {index} is not finite")]
    NonFinite {
        /// The quantity.
        what: &'static str,
        /// Index of the first such sample.
        index: usize,
    },
    /// Every sample is zero, or every weight is.
    #[error("no energy: all {count} samples are zero or weigh nothing")]
    ZeroEnergy {
        /// Number of samples.
        count: usize,
    },
    /// An elevation limit outside 0 to 90 degrees.
    #[error("largest elevation {elevation_max_rad} rad, expected 0 to pi/2")]
    ElevationMax {
        /// The given value.
        elevation_max_rad: f64,
    },
    /// A tolerance that is negative or not a number.
    #[error("tolerance {eps}, expected 0 (exact) or a positive number")]
    Tolerance {
        /// The given value.
        eps: f64,
    },
    /// A direction of a list that is not finite.
    #[error("direction {index} is not finite")]
    Direction {
        /// Index in the list.
        index: usize,
    },
    /// The receiver did not move (or only vertically): there is no bearing.
    #[error(
        "no motion in the plane: no azimuth (the trajectory spans {extent_m:.6} m horizontally, needed are {needed_m:.6} m; up and down shows elevations only)"
    )]
    NoMotion {
        /// Largest horizontal distance from the middle, metres.
        extent_m: f64,
        /// What it takes, metres.
        needed_m: f64,
    },
    /// A trajectory so large that the search would never end (or phases lose their meaning).
    #[error("trajectory of {extent_m:.0} m around its middle, limit {limit_m:.0} m: check the units of the positions")]
    Aperture {
        /// Largest distance from the middle, metres.
        extent_m: f64,
        /// The limit, metres.
        limit_m: f64,
    },
}

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
