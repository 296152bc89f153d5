//! Bartlett profiles and the bearings that they hold.
//!
//! # Frame and signs
//! Positions are metres in the trajectory's frame. `u(azimuth, elevation) = (cos el cos az, cos el sin az, sin el)` is
//! the unit vector **from the receiver to the transmitter**, azimuth from +x towards +y, elevation from the xy plane
//! upwards ([`direction`]). A sample is `z ~ exp(-j 2 pi g |tx - rx| / lambda)` with the path gain `g` (2 for a round
//! trip), so with the displacement `p = rx - tx` a plane wave from `u` has `z ~ exp(+j 2 pi g u.p / lambda)`: moving
//! towards the transmitter turns the phase forward. The profile is
//!
//! `F(u) = |f(u)|^2,  f(u) = sum_t w_t z_t exp(-j 2 pi g u.p_t / lambda)`.
//!
//! In polar coordinates of the displacement (length `rho`, azimuth `phi_p`, angle from the zenith `xi`) and of the
//! direction (azimuth `phi`, angle from the zenith `theta`) the exponent is
//! `2 pi g rho / lambda * (sin(theta) sin(xi) cos(phi - phi_p) + cos(xi) cos(theta))`, `g = 2` giving the familiar
//! `4 pi`. As printed, the paper's equation of the steering vector lacks the parentheses around the two terms, and it
//! names theta the azimuth where the formula needs the zenith angle (its phi being the azimuth).
//!
//! # Rooms
//! `front` validates and centres, `scene` holds what it makes, `direct` is the oracle, `sums` its fast form, `peak` the guaranteed search with
//! `newton`, `crb` the predicted deviation, `grid` the directions and profiles.

mod bessel;
mod choose;
mod cone;
mod crb;
mod direct;
mod error;
mod evaluate;
mod explain;
mod fft;
mod front;
mod grid;
pub(crate) mod kernel;
mod newton;
mod nufft;
mod peak;
mod plan;
mod resample;
mod rings;
mod scene;
mod sums;
#[cfg(test)]
mod tests;

pub use crate::maths::Tier;
pub use error::Error;
pub use explain::{ElevationSearch, SearchPlan};
pub use grid::{Grid, Profile, direction, wsr_planar_profile_variance, wsr_profile_variance};
pub use peak::{Estimate, Peak, SearchOptions, Searcher, search};
pub use plan::{Explanation, Method, Plan, Planner, Precision, ProfileOptions};
pub use scene::{Geometry, Shape};

use crate::signal::samples::Samples;

/// The Bartlett profile of `samples` over `grid` with the default guarantee, `|f~ - f| <= 1e-4 sum w |z|`, by a planner
/// of its own. Keep a [`Planner`] to reuse plans.
///
/// # Errors
/// As [`Planner::profile`].
pub fn profile(samples: &Samples, grid: &Grid) -> Result<Profile, Error> {
    Planner::default().profile(samples, grid, &ProfileOptions::default())
}

/// The profile by the oracle: the sum as written, phases exact to the last bit. Slow; every other path is held to it.
///
/// # Errors
/// As [`profile`].
pub fn oracle(samples: &Samples, grid: &Grid) -> Result<Profile, Error> {
    let scene = scene::Scene::new(samples)?;
    grid.check()?;
    let full = scene.sum_abs * scene.sum_abs;
    let value = |(azimuth, elevation)| (direct::sum(&scene, &direction(azimuth, elevation)).norm_sqr() / full).min(1.0);
    let values = (0..grid.len()).map(|i| value(grid.at(i))).collect();
    Ok(Profile { grid: grid.clone(), values, sum_abs: scene::ldexp(scene.sum_abs, -scene.exponent) })
}
