//! The values that the files of this module hand to each other.

use crate::bartlett::{Tier, direction};
use crate::signal::channel::SUBCARRIERS;
use crate::tuning::TUNING;
use nalgebra::Vector3;
use rayon::prelude::*;
use std::f64::consts::FRAC_PI_2;

/// How a trajectory is cut into windows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Taper {
    /// Half-overlapping Hann windows (\[harris1978\] in docs/references.md).
    #[default]
    Hann,
    /// Blocks side by side.
    Block,
}

/// What of each packet a view uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Band {
    /// The phasor at the channel centre ([`super::Aperture::centre`]).
    Centre,
    /// This many subcarriers about the channel centre. Few of them depend little on the sampling time.
    Subcarriers(usize),
}

/// One normalised power of an aperture: a factor of the joint power.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct View {
    /// Windows along the trajectory that are summed in power; 1 is the whole of it, coherent.
    pub windows: usize,
    /// Their shape.
    pub taper: Taper,
    /// What of each packet is used.
    pub band: Band,
    /// Exponent in the product of all views.
    pub weight: f64,
}

impl View {
    /// A view of weight 1.
    #[must_use]
    pub const fn new(windows: usize, taper: Taper, band: Band) -> Self {
        Self { windows, taper, band, weight: 1.0 }
    }

    /// The same with another exponent.
    #[must_use]
    pub const fn with_weight(self, weight: f64) -> Self {
        Self { weight, ..self }
    }
}

/// Views of the round trip along a path of so many wavelengths: the whole of it, and its phase at the channel centre (which
/// the subcarriers that fade turn less than they turn a sum) in windows of half the motion, or over all of it where half
/// of it is too short to tell directions apart.
pub(crate) fn round_trip_views(path_wavelengths: f64) -> [View; 2] {
    [
        View::new(1, Taper::Hann, Band::Subcarriers(SUBCARRIERS)).with_weight(TUNING.views.round_trip_weight),
        View::new(centre_windows(path_wavelengths), Taper::Hann, Band::Centre).with_weight(TUNING.views.centre_weight),
    ]
}

/// Half-overlapping windows of the phase at the channel centre: `n` of them are `2 / (n + 1)` of the path long each, and as
/// many are taken, up to a most, as leave none too short.
fn centre_windows(path_wavelengths: f64) -> usize {
    let halves = 2.0 * path_wavelengths / TUNING.views.centre_window_wavelengths;
    (halves as usize).saturating_sub(1).clamp(1, TUNING.views.centre_windows)
}

/// Views of the one-way channel: in windows of half the motion, in blocks of an eighth, and, on the subcarriers next to the
/// channel centre (whose sign does not depend on the sampling time), in windows of two sevenths.
pub(crate) fn one_way_views() -> [View; 3] {
    let tuning = TUNING.views;
    let view = |windows: usize, taper: Taper, subcarriers: usize| {
        View::new(windows, taper, Band::Subcarriers(subcarriers)).with_weight(tuning.one_way_weight)
    };
    [
        view(tuning.one_way_windows, Taper::Hann, SUBCARRIERS),
        view(tuning.one_way_blocks, Taper::Block, SUBCARRIERS),
        view(tuning.inner_windows, Taper::Hann, tuning.inner_subcarriers),
    ]
}

/// Which elevations a search covers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Elevations {
    /// |elevation| up to the largest that is expected: level motion, which does not distinguish up from down.
    #[default]
    Expected,
    /// |elevation| up to the zenith: level motion whose samples lie beyond what is expected.
    Beyond,
    /// From the nadir to the zenith: motion that distinguishes up from down. What is expected is more likely beforehand.
    Signed,
}

/// What is known of the scene beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Limits {
    /// Largest |elevation| that is expected, radians. 0 fixes the horizon.
    pub elevation_max_rad: f64,
    /// Which elevations are searched.
    pub elevations: Elevations,
    /// Shortest distance between transmitter and the middle of the motion, metres.
    pub range_min_m: f64,
    /// Where given, the transmitter's height above the receiver's antenna, metres: elevation and range are then one.
    pub height_m: Option<f64>,
    /// The SIMD tier to run on.
    pub tier: Tier,
    /// Whether a search is split over the threads of the current rayon pool.
    pub parallel: bool,
}

impl Limits {
    /// Transmitters of unknown height, on the best SIMD tier of this processor.
    #[must_use]
    pub fn new(elevation_max_rad: f64, range_min_m: f64) -> Self {
        Self {
            elevation_max_rad,
            elevations: Elevations::Expected,
            range_min_m,
            height_m: None,
            tier: Tier::detect(),
            parallel: false,
        }
    }

    /// The same with other elevations searched.
    #[must_use]
    pub fn with_elevations(self, elevations: Elevations) -> Self {
        Self { elevations, ..self }
    }

    /// `work` of each item, in their order: on all threads of the current pool, if the search may have them.
    pub(super) fn each<T: Sync, U: Send>(&self, items: &[T], work: impl Fn(&T) -> U + Send + Sync) -> Vec<U> {
        match self.parallel {
            true => items.par_iter().map(work).collect(),
            false => items.iter().map(work).collect(),
        }
    }

    /// Lowest and highest elevation that are searched, radians.
    #[must_use]
    pub(super) fn elevation_span_rad(&self) -> [f64; 2] {
        match self.elevations {
            _ if self.elevation_max_rad <= 0.0 => [0.0; 2],
            Elevations::Expected => [0.0, self.elevation_max_rad],
            Elevations::Beyond => [0.0, FRAC_PI_2],
            Elevations::Signed => [-FRAC_PI_2, FRAC_PI_2],
        }
    }

    /// The same with the transmitter's height above the receiver's antenna, metres, where it is known.
    #[must_use]
    pub fn with_height_m(self, height_m: Option<f64>) -> Self {
        Self { height_m, ..self }
    }

    /// The same on another SIMD tier.
    #[must_use]
    pub fn with_tier(self, tier: Tier) -> Self {
        Self { tier, ..self }
    }
}

/// A point of the search, seen from the middle of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// Azimuth, radians.
    pub azimuth: f64,
    /// Elevation, radians; at least 0 where only its magnitude is searched.
    pub elevation: f64,
    /// 1 / range, 1/m; 0 is a plane wave.
    pub curve: f64,
}

impl Place {
    /// Unit vector towards the place, in the kernel's precision.
    pub fn unit(&self) -> [f32; 3] {
        let u = direction(self.azimuth, self.elevation);
        [u.x as f32, u.y as f32, u.z as f32]
    }
}

/// A place and its score, `sum weight ln power` over the views.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scored {
    pub place: Place,
    pub score: f64,
}

/// Which coordinates beside the azimuth are searched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Free {
    pub elevation: bool,
    pub range: bool,
}

impl Free {
    /// In the order azimuth, elevation, 1 / range.
    pub fn each(self) -> [bool; 3] {
        [true, self.elevation, self.range]
    }
}

/// How exactly powers are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Precision {
    /// Single precision.
    Exact,
    /// Phases within `grid.rough_turns`, for half the work: to find which places are worth an exact power.
    Rough,
}

/// A change of a trajectory: what drifting odometry is mended by.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Warp {
    /// Metres driven per metre reported.
    pub scale: f64,
    /// Turn of the heading that was not reported, radians per metre driven, counter-clockwise.
    pub turn_rad_per_m: f64,
}

impl Default for Warp {
    fn default() -> Self {
        Self { scale: 1.0, turn_rad_per_m: 0.0 }
    }
}

impl Warp {
    /// Points of a path after the change: in its middle the heading is right, and the mean stays where it was.
    #[must_use]
    pub(crate) fn applied(&self, path_m: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        if *self == Self::default() || path_m.is_empty() {
            return path_m.to_vec();
        }
        let step = |pair: &[Vector3<f64>]| pair[1] - pair[0];
        let half_m = path_m.windows(2).map(|pair| step(pair).norm()).sum::<f64>() / 2.0;
        let (mut at, mut driven_m) = (path_m[0], 0.0);
        let mut warped = vec![at];
        for pair in path_m.windows(2) {
            let step = step(pair);
            let angle = self.turn_rad_per_m * (driven_m + 0.5 * step.norm() - half_m);
            let (sin, cos) = angle.sin_cos();
            at += Vector3::new(cos * step.x - sin * step.y, sin * step.x + cos * step.y, step.z) * self.scale;
            driven_m += step.norm();
            warped.push(at);
        }
        let mean = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / points.len() as f64;
        let shift = mean(path_m) - mean(&warped);
        warped.iter().map(|p| p + shift).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_motion_is_one_window_and_no_window_is_shorter_than_the_least() {
        let least = TUNING.views.centre_window_wavelengths;
        assert_eq!([0.0, 1.0, 1.49, 1.51, 2.1, 9.0].map(|times| centre_windows(times * least)), [1, 1, 1, 2, 3, 3]);
        for tenths in 15..60 {
            let path = f64::from(tenths) / 10.0 * least;
            assert!(2.0 * path / (centre_windows(path) as f64 + 1.0) >= least * (1.0 - 1e-9), "{path}");
        }
        assert_eq!(centre_windows(f64::NAN), 1);
        assert!(round_trip_views(9.0 * least).iter().all(|view| view.weight > 0.0));
    }
}
