//! Where the robots of a team are: one nonlinear least squares over odometry, bearings, ranges and range changes.
//!
//! * [`Team`] is the graph: robots, their keyframes, and what was measured between them.
//! * [`Team::solve`] finds all poses; [`Solution`] has their covariances and what became of each measurement.
//! * [`ranges`] reads ranges that another sensor measured; [`factors`] writes the graph for g2o and GTSAM.
//!
//! Lengths are metres and angles radians, from +x towards +y. The pose of a keyframe is (x, y, yaw) in the frame of the
//! team: that of the priors, or of the first robot's odometry where there are none.
//!
//! A link is a *max-mixture* \[olson2012\] of its candidates and of an outlier that any direction and any range fit alike.
//! Each iteration takes the likeliest of them; a link that fits nothing is its outlier and pulls at nothing.
//!
//! The solver is Levenberg and Marquardt's on a Cholesky factor in envelope form. `factrs` 0.3, the library of this kind in Rust,
//! has neither mixtures nor marginal covariances, and brings `faer` with it. Keyframes in the order of time make the normal
//! matrix a band, for which an envelope needs no search for an ordering.

mod envelope;
pub mod factors;
mod graph;
pub mod ranges;
mod solve;
mod start;

pub use graph::{KeyframeId, Mode, OdometryNoise, RobotId, Team, TeamError};
pub use solve::{Other, Solution};

/// An angle in (-pi, pi].
pub(crate) fn wrap(angle_rad: f64) -> f64 {
    let turned = angle_rad.rem_euclid(std::f64::consts::TAU);
    if turned > std::f64::consts::PI { turned - std::f64::consts::TAU } else { turned }
}
