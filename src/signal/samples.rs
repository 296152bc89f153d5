//! The one value between the front end and every estimator.

use nalgebra::Vector3;
use num_complex::Complex64;

/// A narrow-band channel sample and how often it holds the path.
///
/// `h ~ exp(-j 2 pi path_gain d / lambda)` for a path of length `d`: 2 after the round-trip product of a forward and
/// a backward frame, 1 for a one-way channel. Estimators multiply phases by it, so 2 pi and 4 pi cannot be confused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coherent {
    /// The sample, in arbitrary but common units.
    pub h: Complex64,
    /// How many times the path's phase is in `h` (1 or 2).
    pub path_gain: u8,
}

/// Coherent samples along a trajectory: what a front end hands to an estimator.
///
/// All vectors have one entry per sample. Positions are metres in the trajectory's frame (x forward, y left, z up
/// where the robot says so; azimuth from +x towards +y). The phase of `z` falls by `2 pi path_gain / lambda` for
/// each metre of `|receiver - transmitter|`.
///
/// Only differences of positions matter to plane-wave models, so a transmitter whose place is unknown but that does
/// not move is all zeros; one that moves carries its displacement.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples {
    /// Complex samples.
    pub z: Vec<Complex64>,
    /// Receiver antenna position at each sample, metres.
    pub receiver_m: Vec<Vector3<f64>>,
    /// Transmitter antenna displacement at each sample, metres; zeros when it stands still.
    pub transmitter_m: Vec<Vector3<f64>>,
    /// Seconds on the receiver's clock.
    pub t_s: Vec<f64>,
    /// Weight of each sample, at least 0; 1 for an ordinary one.
    pub weight: Vec<f64>,
    /// [`Coherent::path_gain`] of every sample.
    pub path_gain: u8,
}

impl Samples {
    /// An empty set whose samples hold the path `path_gain` times.
    #[must_use]
    pub fn new(path_gain: u8) -> Self {
        Self { path_gain, ..Self::default() }
    }

    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.z.len()
    }

    /// True if there is no sample.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.z.is_empty()
    }

    /// Adds one sample with weight 1.
    pub fn push(&mut self, t_s: f64, z: Complex64, receiver_m: Vector3<f64>, transmitter_m: Vector3<f64>) {
        self.z.push(z);
        self.receiver_m.push(receiver_m);
        self.transmitter_m.push(transmitter_m);
        self.t_s.push(t_s);
        self.weight.push(1.0);
    }
}
