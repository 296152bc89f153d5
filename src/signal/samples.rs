//! Coherent samples with their positions: what the front end makes and every estimator takes.

use crate::maths::upper_median;
use nalgebra::Vector3;
use num_complex::Complex64;
use std::f64::consts::TAU;

/// Why a set of samples cannot be made, or a sample not be added to it.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SamplesError {
    /// A wavelength that is not a positive number of metres.
    #[error("wavelength {wavelength_m} m, expected a positive number")]
    Wavelength {
        /// The given value.
        wavelength_m: f64,
    },
    /// A path gain of zero: samples that do not hold the path's phase.
    #[error("path gain 0: these samples do not hold the path's phase")]
    PathGain,
    /// A NaN or an infinity.
    #[error("{what} of sample {index} is not finite")]
    NonFinite {
        /// The quantity: `sample`, `position`, `time` or `weight`.
        what: &'static str,
        /// Number of samples before this one.
        index: usize,
    },
    /// A weight below zero.
    #[error("weight of sample {index} is {weight}, expected 0 or more")]
    Weight {
        /// Number of samples before this one.
        index: usize,
        /// Its weight.
        weight: f64,
    },
}

/// Coherent samples along a trajectory: what a front end hands to an estimator.
///
/// Columns of equal length, one entry per sample, every one finite. Positions are metres in the trajectory's frame
/// (x forward, y left, z up where the robot says so; azimuth from +x towards +y). The phase of `z` falls by
/// `2 pi path_gain / wavelength_m` for each metre of `|receiver - transmitter|`.
///
/// Only differences of positions matter to plane-wave models, so a transmitter whose place is unknown but that does
/// not move is all zeros; one that moves carries its displacement.
#[derive(Clone, Debug, PartialEq)]
pub struct Samples {
    wavelength_m: f64,
    path_gain: u8,
    z: Vec<Complex64>,
    receiver_m: Vec<Vector3<f64>>,
    transmitter_m: Vec<Vector3<f64>>,
    t_s: Vec<f64>,
    weight: Vec<f64>,
}

impl Samples {
    /// An empty set of samples at a carrier of `wavelength_m` metres that hold the path `path_gain` times
    /// ([`Samples::path_gain`]).
    ///
    /// # Errors
    /// [`SamplesError::Wavelength`] unless `wavelength_m` is finite and positive, [`SamplesError::PathGain`] for a gain of 0.
    pub fn new(wavelength_m: f64, path_gain: u8) -> Result<Self, SamplesError> {
        if !(wavelength_m.is_finite() && wavelength_m > 0.0) {
            return Err(SamplesError::Wavelength { wavelength_m });
        }
        if path_gain == 0 {
            return Err(SamplesError::PathGain);
        }
        Ok(Self {
            wavelength_m,
            path_gain,
            z: Vec::new(),
            receiver_m: Vec::new(),
            transmitter_m: Vec::new(),
            t_s: Vec::new(),
            weight: Vec::new(),
        })
    }

    /// Adds one sample of weight 1: seconds on the receiver's clock, the complex sample, the positions of receiver and
    /// transmitter in metres.
    ///
    /// # Errors
    /// [`SamplesError::NonFinite`] for a NaN or an infinity in any of them; the set is then unchanged.
    pub fn push(
        &mut self,
        t_s: f64,
        z: Complex64,
        receiver_m: Vector3<f64>,
        transmitter_m: Vector3<f64>,
    ) -> Result<(), SamplesError> {
        self.push_weighted(t_s, z, receiver_m, transmitter_m, 1.0)
    }

    /// [`Samples::push`] with a weight of at least 0.
    ///
    /// # Errors
    /// As [`Samples::push`], and [`SamplesError::Weight`] for a weight below 0; the set is then unchanged.
    #[doc(hidden)] // for the crates of this workspace
    pub fn push_weighted(
        &mut self,
        t_s: f64,
        z: Complex64,
        receiver_m: Vector3<f64>,
        transmitter_m: Vector3<f64>,
        weight: f64,
    ) -> Result<(), SamplesError> {
        let index = self.len();
        let finite = |p: &Vector3<f64>| p.iter().all(|v| v.is_finite());
        let checks = [
            ("sample", z.is_finite()),
            ("position", finite(&receiver_m) && finite(&transmitter_m)),
            ("time", t_s.is_finite()),
            ("weight", weight.is_finite()),
        ];
        if let Some((what, _)) = checks.into_iter().find(|(_, fine)| !fine) {
            return Err(SamplesError::NonFinite { what, index });
        }
        if weight < 0.0 {
            return Err(SamplesError::Weight { index, weight });
        }
        self.z.push(z);
        self.receiver_m.push(receiver_m);
        self.transmitter_m.push(transmitter_m);
        self.t_s.push(t_s);
        self.weight.push(weight);
        Ok(())
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

    /// Wavelength of the carrier, metres.
    #[must_use]
    pub fn wavelength_m(&self) -> f64 {
        self.wavelength_m
    }

    /// By how much a phase turns with each metre of way, radians: `2 pi path_gain / wavelength`.
    pub(crate) fn kappa(&self) -> f64 {
        TAU * f64::from(self.path_gain) / self.wavelength_m
    }

    /// How often each sample holds the path: 2 after the round-trip product of a forward and a backward frame, 1 for a one-way channel.
    #[must_use]
    pub fn path_gain(&self) -> u8 {
        self.path_gain
    }

    /// The complex samples.
    #[must_use]
    pub fn z(&self) -> &[Complex64] {
        &self.z
    }

    /// Receiver antenna position at each sample, metres.
    #[must_use]
    pub fn receiver_m(&self) -> &[Vector3<f64>] {
        &self.receiver_m
    }

    /// Transmitter antenna displacement at each sample, metres; zeros when it stands still.
    #[must_use]
    pub fn transmitter_m(&self) -> &[Vector3<f64>] {
        &self.transmitter_m
    }

    /// `receiver - transmitter` at each sample, metres.
    pub(crate) fn displacements_m(&self) -> impl ExactSizeIterator<Item = Vector3<f64>> + '_ {
        self.receiver_m.iter().zip(&self.transmitter_m).map(|(receiver, transmitter)| receiver - transmitter)
    }

    /// Median distance from one sample's place to the next's, metres; 0 of fewer than two.
    #[must_use]
    pub(crate) fn spacing_m(&self) -> f64 {
        let places: Vec<Vector3<f64>> = self.displacements_m().collect();
        let mut steps: Vec<f64> = places.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
        upper_median(&mut steps).unwrap_or(0.0)
    }

    /// Time of each sample, seconds on the receiver's clock.
    #[must_use]
    pub fn t_s(&self) -> &[f64] {
        &self.t_s
    }

    /// Weight of each sample, at least 0; 1 for an ordinary one.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn weight(&self) -> &[f64] {
        &self.weight
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_of_samples_cannot_be_made_inconsistent() {
        for wavelength_m in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(Samples::new(wavelength_m, 2), Err(SamplesError::Wavelength { .. })));
        }
        assert_eq!(Samples::new(0.054, 0), Err(SamplesError::PathGain));
        let mut samples = Samples::new(0.054, 2).unwrap();
        let (z, p) = (Complex64::ONE, Vector3::zeros());
        samples.push(0.0, z, p, p).unwrap();
        let nan = Complex64::new(1.0, f64::NAN);
        let far = Vector3::new(0.0, 0.0, f64::INFINITY);
        let refused = |what| Err(SamplesError::NonFinite { what, index: 1 });
        assert_eq!(samples.push(0.0, nan, p, p), refused("sample"));
        assert_eq!(samples.push(0.0, z, far, p), refused("position"));
        assert_eq!(samples.push(0.0, z, p, far), refused("position"));
        assert_eq!(samples.push(f64::NAN, z, p, p), refused("time"));
        assert_eq!(samples.push_weighted(0.0, z, p, p, f64::NAN), refused("weight"));
        let negative = samples.push_weighted(0.0, z, p, p, -1.0);
        assert_eq!(negative, Err(SamplesError::Weight { index: 1, weight: -1.0 }));
        assert_eq!((samples.len(), samples.t_s().len(), samples.weight()), (1, 1, &[1.0][..]));
    }
}
