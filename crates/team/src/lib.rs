//! Poses of a team of robots: nonlinear least squares over odometry, bearings, ranges and range changes.
//!
//! * [`Team`] is the graph: robots, keyframes, and the measurements between them.
//! * [`Team::solve`] finds all poses. [`Solution`] holds them with their covariances and each link's chosen candidate.
//! * [`ranges`] reads ranges from another sensor. [`factors`] writes the graph for g2o and GTSAM.
//! * [`answers`] makes links of the estimator's bearings.
//!
//! Lengths are in metres; angles in radians, from +x towards +y. The pose of a keyframe is (x, y, yaw) in the team's
//! frame: the frame of the priors or, without priors, of the first robot's odometry.
//!
//! A link is a *max-mixture* \[olson2012\] of its candidates and a null hypothesis (outlier) with a uniform density.
//! Each iteration takes the likeliest component. An outlier exerts no pull.
//!
//! The solver is Levenberg-Marquardt with a Cholesky factor in envelope form. The Rust library `factrs` 0.3 has neither
//! mixtures nor marginal covariances, and depends on `faer`. Keyframes in time order make the normal matrix banded, so
//! the envelope needs no search for an ordering.

pub mod answers;
pub mod factors;
mod graph;
pub mod ranges;
mod solve;
mod start;

pub use graph::{KeyframeId, Mode, OdometryNoise, RobotId, Team, TeamError};
pub use solve::{Other, Solution};

/// An angle in (-pi, pi].
pub(crate) fn wrap(angle_rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    if angle_rad > -PI && angle_rad <= PI {
        return angle_rad;
    }
    let turned = angle_rad.rem_euclid(TAU);
    if turned > PI { turned - TAU } else { turned }
}
