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
//! * **Input**: `front` centres and scales samples, `scene` holds them and the shape of the motion.
//! * **Sums**: `direct` is the oracle; its vector form for antipodal pairs of directions is `sums` of `csi5300_kernels`.
//! * **Profiles**: `planner` keeps plans; for a `key` (grid, tolerance, motion) `choose` takes the method of the least `cost` and
//!   `plan` holds its tables (band limits from `bessel`): those of `rings`, `nufft` or, for lines, `cone` of `csi5300_kernels`,
//!   whose `evaluate` runs them. `grid` has the directions and the profile, `explain` what was chosen.
//! * **Bearings**: `search` samples rings (`sampler`), takes the `maxima` that the bound does not rule out, climbs
//!   them (`newton`) and makes an `estimate` of them (`report`, with deviations from `crb`); `mirror` judges which directions the
//!   motion cannot tell apart.

mod bessel;
mod choose;
mod cost;
mod crb;
pub(crate) mod direct;
mod error;
mod estimate;
mod explain;
mod front;
mod grid;
mod key;
mod maxima;
mod mirror;
mod newton;
mod plan;
mod planner;
mod report;
mod sampler;
mod scene;
pub(crate) mod search;
#[cfg(test)]
mod tests;

pub use csi5300_kernels::simd::Tier;
pub use error::Error;
pub use estimate::{Estimate, Peak, SearchOptions};
pub use explain::{ElevationSearch, Explanation, Method, Precision, ProfileOptions, SearchPlan};
pub(crate) use grid::wsr_planar_profile_variance;
pub use grid::{Grid, Profile, direction};
pub use planner::Planner;
pub use scene::{Geometry, Shape};
pub(crate) use search::Searcher;
pub use search::search;

use crate::signal::samples::Samples;

/// The Bartlett profile of `samples` over `grid` with the default guarantee, `|f~ - f| <= 1e-4 sum w |z|`, by a planner
/// of its own. Keep a [`Planner`] to reuse plans.
///
/// # Errors
/// As [`Planner::profile`].
pub fn profile(samples: &Samples, grid: &Grid) -> Result<Profile, Error> {
    Planner::default().profile(samples, grid, &ProfileOptions::default())
}
