//! What can be wrong with the input of an estimate.

/// Why there is no profile or no bearing. Every variant is found before anything is computed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// There is no sample at all.
    #[error("no samples: check that both logs cover the motion")]
    Empty,
    /// The columns of [`crate::signal::samples::Samples`] differ in length.
    #[error("columns of unequal length: {z} samples, {what} has {length}")]
    Lengths {
        /// Number of complex samples.
        z: usize,
        /// The column that differs.
        what: &'static str,
        /// Its length.
        length: usize,
    },
    /// A NaN or an infinity, in the input or as soon as it is expressed in wavelengths.
    #[error("{what} of sample {index} is not finite")]
    NonFinite {
        /// The quantity.
        what: &'static str,
        /// Index of the first such sample.
        index: usize,
    },
    /// A weight below zero.
    #[error("weight of sample {index} is {weight}, expected 0 or more")]
    Weight {
        /// Index of the first such sample.
        index: usize,
        /// Its weight.
        weight: f64,
    },
    /// Every sample is zero, or every weight is.
    #[error("no energy: all {count} samples are zero or weigh nothing")]
    ZeroEnergy {
        /// Number of samples.
        count: usize,
    },
    /// A wavelength that is not a positive number of metres.
    #[error("wavelength {wavelength_m} m, expected a positive number")]
    Wavelength {
        /// What was given.
        wavelength_m: f64,
    },
    /// A path gain of zero: samples that do not hold the path's phase.
    #[error("path gain 0: these samples do not hold the path's phase")]
    PathGain,
    /// An elevation limit outside 0 to 90 degrees.
    #[error("largest elevation {elevation_max_rad} rad, expected 0 to pi/2")]
    ElevationMax {
        /// What was given.
        elevation_max_rad: f64,
    },
    /// A tolerance that is negative or not a number.
    #[error("tolerance {eps}, expected 0 (exact) or a positive number")]
    Tolerance {
        /// What was given.
        eps: f64,
    },
    /// A direction of a list that is not finite.
    #[error("direction {index} is not finite")]
    Direction {
        /// Index in the list.
        index: usize,
    },
    /// The receiver did not move (or only vertically): there is no bearing.
    #[error("no motion: no bearing (the trajectory spans {extent_m:.6} m horizontally, needed are {needed_m:.6} m)")]
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
