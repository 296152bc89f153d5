//! What can be wrong with the input of an estimate.

use crate::signal::samples::SamplesError;

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
