//! Validated samples in the units of the kernels, and the shape of their motion.

use std::f64::consts::TAU;

use fearless_simd::Level;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::error::Error;
use super::front::{Front, extents, scatter, weighted_scatter};
use crate::signal::samples::Samples;
use csi5300_kernels::simd::Tier;
use csi5300_kernels::sums::Columns;

/// Half extents below this many turns of phase are no motion (3.6 degrees of phase; 0.27 mm for a round trip at 5.5 GHz).
const STATIC_TURNS: f64 = 0.01;
/// An axis with a half extent below this many turns (0.1 rad of phase) counts as absent: a line, a plane.
const FLAT_TURNS: f64 = 0.016;
/// A third axis that is below this many turns and a tenth of the second is a wobble, not a dimension.
const NEARLY_FLAT_TURNS: f64 = 1.0;

/// The shape of a trajectory, to the resolution of phases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Geometry {
    /// No motion: the profile is constant, there is no bearing.
    Static,
    /// Motion along a line: a cone of directions, hence a mirror bearing.
    Line,
    /// Motion in a horizontal plane: the sign of the elevation is lost.
    Planar,
    /// Motion in a plane that is not horizontal: directions mirrored in that plane look alike.
    TiltedPlane,
    /// A plane with a wobble of less than a tenth of its smaller extent: the mirror is only weakly suppressed.
    NearlyPlanar,
    /// Motion in three dimensions.
    Spatial,
}

/// Principal axes and extents of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// The class.
    pub geometry: Geometry,
    /// Half extents along `axes`, metres, in the order of falling variance.
    pub half_extent_m: [f64; 3],
    /// Unit vectors of the principal axes.
    pub axes: [Vector3<f64>; 3],
}

/// Validated samples in the units of the kernels.
///
/// Positions are in turns of phase, `path_gain * (receiver - transmitter) / wavelength`, relative to the middle of
/// their bounding box: that changes the phase of the sum, not its magnitude. Samples are multiplied by their weight
/// and by a power of two that brings the largest into [0.5, 1).
#[derive(Clone, Debug)]
pub(crate) struct Scene {
    level: Level,
    pub x: Vec<f64>,
    pub y: Vec<f64>,
    pub z: Vec<f64>,
    /// Weighted, scaled samples.
    pub re: Vec<f64>,
    pub im: Vec<f64>,
    /// Weights, scaled by a power of two of their own.
    pub weight: Vec<f64>,
    /// The sum over a scaled sample is `2^exponent` times the sum over the caller's.
    pub exponent: i32,
    /// `sum |re + j im|`.
    pub sum_abs: f64,
    /// `sum w |z|^2`, of scaled weights and samples.
    pub energy: f64,
    /// `sum w`, scaled.
    pub weight_sum: f64,
    /// Largest horizontal distance from the middle, turns.
    pub radius: f64,
    /// Largest vertical distance from the middle, turns.
    pub half_height: f64,
    /// Metres per turn.
    pub turn_m: f64,
}

impl Scene {
    /// On the widest tier of this machine.
    pub fn new(samples: &Samples) -> Result<Self, Error> {
        Self::on(Tier::detect(), samples)
    }

    pub fn on(tier: Tier, samples: &Samples) -> Result<Self, Error> {
        if samples.is_empty() {
            return Err(Error::Empty);
        }
        let turn_m = samples.wavelength_m() / f64::from(samples.path_gain());
        let level = tier.level_or_portable();
        let Front { at: [x, y, z], radius, half_height, re, im, weight, exponent, sums } =
            Front::new(level, samples, turn_m)?;
        let [sum_abs, energy, weight_sum] = sums;
        let scene =
            Self { level, x, y, z, re, im, weight, exponent, sum_abs, energy, weight_sum, radius, half_height, turn_m };
        Ok(scene)
    }

    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Principal axes, extents and class of the motion.
    pub fn shape(&self) -> Shape {
        let at = [&self.x[..], &self.y, &self.z];
        let (_, [xx, xy, yy, xz, yz, zz]) = scatter(self.level, at);
        let eigen = SymmetricEigen::new(Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz));
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let axes = order.map(|i| eigen.eigenvectors.column(i).into_owned());
        let ranges = extents(self.level, at, axes.map(Into::into));
        let half = ranges.map(|[low, high]| (high - low) / 2.0);
        Shape { geometry: classify(half, &axes), half_extent_m: half.map(|h| h * self.turn_m), axes }
    }

    /// Weighted scatter of the positions (turns squared): xx, xy, yy, xz, yz, zz.
    pub fn weighted_scatter(&self) -> [f64; 6] {
        weighted_scatter(self.level, [&self.x, &self.y, &self.z], &self.weight, self.weight_sum)
    }

    /// Mean square distance of the positions from their mean along a unit vector, turns squared.
    pub fn depth_squared(&self, n: Vector3<f64>) -> f64 {
        let [xx, xy, yy, xz, yz, zz] = self.weighted_scatter();
        let sum = n.x * n.x * xx + n.y * n.y * yy + n.z * n.z * zz;
        let cross = n.x * n.y * xy + n.x * n.z * xz + n.y * n.z * yz;
        ((sum + 2.0 * cross) / self.weight_sum).max(0.0)
    }

    /// The largest value of a function of the positions (turns), at least 0.
    pub fn farthest(&self, distance: impl Fn(Vector3<f64>) -> f64) -> f64 {
        let at = |t: usize| distance(Vector3::new(self.x[t], self.y[t], self.z[t]));
        (0..self.len()).map(at).fold(0.0, f64::max)
    }

    /// True if the sign of the elevation changes nothing (to 1e-9 rad of phase).
    pub fn is_flat(&self) -> bool {
        TAU * self.half_height < 1e-9
    }

    /// The samples for the kernels; without heights if those are zero.
    pub fn columns(&self) -> Columns<'_, f64> {
        let z: &[f64] = if self.is_flat() { &[] } else { &self.z };
        Columns { x: &self.x, y: &self.y, z, re: &self.re, im: &self.im }
    }

    /// An error if there is no horizontal motion to take an azimuth from.
    pub fn require_motion(&self) -> Result<(), Error> {
        if self.radius < STATIC_TURNS {
            return Err(Error::NoMotion { extent_m: self.radius * self.turn_m, needed_m: STATIC_TURNS * self.turn_m });
        }
        Ok(())
    }
}

/// `x * 2^exponent` without overflow on the way.
pub(crate) fn ldexp(x: f64, exponent: i32) -> f64 {
    let half = exponent / 2;
    x * 2f64.powi(half) * 2f64.powi(exponent - half)
}

/// The class of half extents in turns along principal axes.
fn classify(half: [f64; 3], axes: &[Vector3<f64>; 3]) -> Geometry {
    let level = axes[2].x.hypot(axes[2].y) * half[0] < FLAT_TURNS;
    if half[0] < STATIC_TURNS {
        Geometry::Static
    } else if half[1] < FLAT_TURNS {
        Geometry::Line
    } else if half[2] < FLAT_TURNS {
        if level { Geometry::Planar } else { Geometry::TiltedPlane }
    } else if half[2] < NEARLY_FLAT_TURNS && half[2] < 0.1 * half[1] {
        Geometry::NearlyPlanar
    } else {
        Geometry::Spatial
    }
}
