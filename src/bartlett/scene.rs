//! The front end, always in double: validation, centring, positions in turns, scaling, shape of the motion.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::error::Error;
use super::sums::Columns;
use crate::samples::Samples;

/// Half extents below this many turns of phase are no motion (3.6 degrees of phase; 0.27 mm for a round trip at 5.5 GHz).
const STATIC_TURNS: f64 = 0.01;
/// An axis with a half extent below this many turns (0.1 rad of phase) counts as absent: a line, a plane.
const FLAT_TURNS: f64 = 0.016;
/// A third axis that is below this many turns and a tenth of the second is a wobble, not a dimension.
const NEARLY_FLAT_TURNS: f64 = 1.0;

/// The shape of a trajectory, as far as phases can tell.
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
    pub fn new(samples: &Samples, wavelength_m: f64) -> Result<Self, Error> {
        check_lengths(samples)?;
        if !(wavelength_m.is_finite() && wavelength_m > 0.0) {
            return Err(Error::Wavelength { wavelength_m });
        }
        if samples.path_gain == 0 {
            return Err(Error::PathGain);
        }
        let turn_m = wavelength_m / f64::from(samples.path_gain);
        let ([x, y, z], radius, half_height) = centred_turns(samples, turn_m)?;
        let (z_exponent, w_exponent) = exponents(samples)?;
        let halves = |exponent: i32| [exponent / 2, exponent - exponent / 2].map(|half| 2f64.powi(half));
        let ([za, zb], [wa, wb]) = (halves(z_exponent), halves(w_exponent));
        let mut scene = Self {
            x,
            y,
            z,
            re: samples.z.iter().zip(&samples.weight).map(|(z, w)| z.re * za * zb * (w * wa * wb)).collect(),
            im: samples.z.iter().zip(&samples.weight).map(|(z, w)| z.im * za * zb * (w * wa * wb)).collect(),
            weight: samples.weight.iter().map(|w| w * wa * wb).collect(),
            exponent: z_exponent + w_exponent,
            sum_abs: 0.0,
            energy: 0.0,
            weight_sum: 0.0,
            radius,
            half_height,
            turn_m,
        };
        scene.sum();
        Ok(scene)
    }

    /// `sum_abs`, `energy` and `weight_sum`, in four chains each so that additions need not wait for one another.
    fn sum(&mut self) {
        let mut sums = [[0.0; 4]; 3];
        let values = self.re.iter().zip(&self.im).zip(&self.weight);
        for (t, ((re, im), w)) in values.enumerate() {
            let power = re * re + im * im;
            // Of samples that carry their weight: |w z|, and w |z|^2 = |w z|^2 / w.
            let energy = if *w > 0.0 { power / w } else { 0.0 };
            for (sum, term) in sums.iter_mut().zip([power.sqrt(), energy, *w]) {
                sum[t % 4] += term;
            }
        }
        [self.sum_abs, self.energy, self.weight_sum] = sums.map(|s| s.iter().sum());
    }

    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Principal axes, extents and class of the motion.
    pub fn shape(&self) -> Shape {
        let n = self.len() as f64;
        let mean = [&self.x, &self.y, &self.z].map(|c| c.iter().sum::<f64>() / n);
        let mut sums = [0.0; 6];
        for ((x, y), z) in self.x.iter().zip(&self.y).zip(&self.z) {
            let [x, y, z] = [x - mean[0], y - mean[1], z - mean[2]];
            for (sum, term) in sums.iter_mut().zip([x * x, x * y, y * y, x * z, y * z, z * z]) {
                *sum += term;
            }
        }
        let [xx, xy, yy, xz, yz, zz] = sums;
        let scatter = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let eigen = SymmetricEigen::new(scatter);
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let axes = order.map(|i| eigen.eigenvectors.column(i).into_owned());
        let mut ranges = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
        for ((x, y), z) in self.x.iter().zip(&self.y).zip(&self.z) {
            for ([low, high], a) in ranges.iter_mut().zip(&axes) {
                let d = a.x * x + a.y * y + a.z * z;
                (*low, *high) = (low.min(d), high.max(d));
            }
        }
        let half = ranges.map(|[low, high]| (high - low) / 2.0);
        Shape { geometry: classify(half, &axes), half_extent_m: half.map(|h| h * self.turn_m), axes }
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

fn check_lengths(samples: &Samples) -> Result<(), Error> {
    let z = samples.z.len();
    if z == 0 {
        return Err(Error::Empty);
    }
    for (what, length) in [
        ("receiver_m", samples.receiver_m.len()),
        ("transmitter_m", samples.transmitter_m.len()),
        ("weight", samples.weight.len()),
        ("t_s", samples.t_s.len()),
    ] {
        if length != z {
            return Err(Error::Lengths { z, what, length });
        }
    }
    Ok(())
}

/// Displacements in turns about the middle of their bounding box, by axis; their horizontal radius and half height.
fn centred_turns(samples: &Samples, turn_m: f64) -> Result<([Vec<f64>; 3], f64, f64), Error> {
    let mut columns: [Vec<f64>; 3] = std::array::from_fn(|axis| {
        let pairs = samples.receiver_m.iter().zip(&samples.transmitter_m);
        pairs.map(|(r, t)| r[axis] - t[axis]).collect()
    });
    // A NaN or an infinity anywhere makes this sum one; only then it is worth looking for it.
    let bad = |columns: &[Vec<f64>; 3], limit: f64| {
        let wrong = |v: &f64| v.is_nan() || v.abs() > limit;
        let any = columns.iter().any(|c| c.iter().fold(false, |any, v| any | wrong(v)));
        any.then(|| (0..samples.len()).position(|t| columns.iter().any(|c| wrong(&c[t])))).flatten()
    };
    if let Some(index) = bad(&columns, f64::MAX) {
        return Err(Error::NonFinite { what: "position", index });
    }
    for column in &mut columns {
        let (low, high) = column.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        let middle = low / 2.0 + high / 2.0;
        // A product is quicker than a quotient; a wavelength whose inverse overflows fails the next check.
        let per_metre = 1.0 / turn_m;
        column.iter_mut().for_each(|v| *v = (*v - middle) * per_metre);
    }
    if let Some(index) = bad(&columns, 1e150) {
        return Err(Error::NonFinite { what: "position in wavelengths", index });
    }
    let [x, y, z] = &columns;
    let radius = x.iter().zip(y).fold(0f64, |m, (x, y)| m.max(x * x + y * y)).sqrt();
    let half_height = z.iter().fold(0f64, |m, z| m.max(z.abs()));
    Ok((columns, radius, half_height))
}

/// Powers of two that bring the largest sample and the largest weight into [0.5, 1).
fn exponents(samples: &Samples) -> Result<(i32, i32), Error> {
    let (mut z_max, mut w_max) = (0f64, 0f64);
    for (index, (z, &w)) in samples.z.iter().zip(&samples.weight).enumerate() {
        if !(z.re.is_finite() && z.im.is_finite()) {
            return Err(Error::NonFinite { what: "sample", index });
        }
        if !w.is_finite() {
            return Err(Error::NonFinite { what: "weight", index });
        }
        if w < 0.0 {
            return Err(Error::Weight { index, weight: w });
        }
        if w > 0.0 {
            z_max = z_max.max(z.re.abs()).max(z.im.abs());
            w_max = w_max.max(w);
        }
    }
    if z_max == 0.0 || w_max == 0.0 {
        return Err(Error::ZeroEnergy { count: samples.len() });
    }
    Ok((-exponent_above(z_max), -exponent_above(w_max)))
}

/// The least `e` with `x < 2^e`, for positive finite `x`.
pub(crate) fn exponent_above(x: f64) -> i32 {
    let (x, shift) = if x < f64::MIN_POSITIVE { (x * 2f64.powi(64), 64) } else { (x, 0) };
    let biased = ((x.to_bits() >> 52) & 0x7ff) as i32;
    biased - 1022 - shift
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
