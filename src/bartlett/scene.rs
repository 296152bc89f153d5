//! The front end of every estimate, in double: validated samples, centred, in the units of the kernels, and the shape of their motion.

use super::Error;
use crate::signal::samples::Samples;
use csi5300_kernels::simd::{Tier, V, on_tier};
use csi5300_kernels::sums::Columns;
use fearless_simd::{Level, Simd, SimdBase, SimdFloat};
use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use std::f64::consts::TAU;

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
        let ([x, y, z], radius, half_height) = centred_turns(level, samples, turn_m)?;
        let mut re: Vec<f64> = samples.z().iter().map(|z| z.re).collect();
        let mut im: Vec<f64> = samples.z().iter().map(|z| z.im).collect();
        let mut weight = samples.weight().to_vec();
        let (z_exponent, w_exponent) = exponents(level, &re, &im, &weight)?;
        let exponent = z_exponent + w_exponent;
        let halves = |exponent: i32| [exponent / 2, exponent - exponent / 2].map(|half| 2f64.powi(half));
        let factors = [halves(z_exponent), halves(w_exponent)];
        let [sum_abs, energy, weight_sum] =
            on_tier!(level, simd => scale(simd, factors, &mut re, &mut im, &mut weight));
        Ok(Self { level, x, y, z, re, im, weight, exponent, sum_abs, energy, weight_sum, radius, half_height, turn_m })
    }

    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Principal axes, extents and class of the motion.
    pub fn shape(&self) -> Shape {
        let at = [&self.x[..], &self.y, &self.z];
        let [xx, xy, yy, xz, yz, zz] = on_tier!(self.level, simd => scatter(simd, at));
        let eigen = SymmetricEigen::new(Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz));
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let axes = order.map(|i| eigen.eigenvectors.column(i).into_owned());
        let ranges = on_tier!(self.level, simd => extents(simd, at, axes.map(Into::into)));
        let half = ranges.map(|[low, high]| (high - low) / 2.0);
        Shape { geometry: classify(half, &axes), half_extent_m: half.map(|h| h * self.turn_m), axes }
    }

    /// Weighted scatter of the positions (turns squared): xx, xy, yy, xz, yz, zz.
    pub fn weighted_scatter(&self) -> [f64; 6] {
        let at = [&self.x[..], &self.y, &self.z];
        on_tier!(self.level, simd => weighted_scatter(simd, at, &self.weight, self.weight_sum))
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

/// Folds columns of one length, a vector of elements at a time; what the last vector lacks is `pad`.
#[inline(always)]
fn fold<S: Simd, const C: usize, const K: usize>(
    simd: S,
    columns: [&[f64]; C],
    pad: [f64; C],
    start: [f64; K],
    step: impl Fn([V<S, f64>; K], [V<S, f64>; C]) -> [V<S, f64>; K],
) -> [V<S, f64>; K] {
    let lanes = V::<S, f64>::LEN;
    let n = columns[0].len();
    let whole = n / lanes * lanes;
    let mut acc = start.map(|v| V::<S, f64>::splat(simd, v));
    for from in (0..whole).step_by(lanes) {
        acc = step(acc, columns.map(|c| V::<S, f64>::from_slice(simd, &c[from..from + lanes])));
    }
    if whole < n {
        let last = |c: usize| V::<S, f64>::from_fn(simd, |i| columns[c].get(whole + i).copied().unwrap_or(pad[c]));
        acc = step(acc, std::array::from_fn(last));
    }
    acc
}

fn low(v: &[f64]) -> f64 {
    v.iter().copied().fold(f64::INFINITY, f64::min)
}

fn high(v: &[f64]) -> f64 {
    v.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

/// Smallest and largest value of a column; none if one of them is not finite.
fn range(level: Level, column: &[f64]) -> Option<[f64; 2]> {
    on_tier!(level, simd => range_simd(simd, column))
}

#[inline(always)]
fn range_simd<S: Simd>(simd: S, column: &[f64]) -> Option<[f64; 2]> {
    let zero = V::<S, f64>::splat(simd, 0.0);
    let first = column.first().copied()?;
    let [lows, highs, poison] = fold(
        simd,
        [column],
        [first],
        [first, first, 0.0],
        #[inline(always)]
        |[l, h, p], [v]| [l.min(v), h.max(v), v.mul_add(zero, p)],
    );
    // Anything but a finite number times zero is a NaN, and stays one.
    let fine = poison.as_slice().iter().all(|p| *p == 0.0);
    fine.then(|| [low(lows.as_slice()), high(highs.as_slice())])
}

/// Displacements in turns about the middle of their bounding box, by axis; their horizontal radius and half height.
fn centred_turns(level: Level, samples: &Samples, turn_m: f64) -> Result<([Vec<f64>; 3], f64, f64), Error> {
    let mut columns: [Vec<f64>; 3] = std::array::from_fn(|axis| {
        let pairs = samples.receiver_m().iter().zip(samples.transmitter_m());
        pairs.map(|(r, t)| r[axis] - t[axis]).collect()
    });
    let not_finite = |columns: &[Vec<f64>; 3], what, limit: f64| {
        let wrong = |t: &usize| columns.iter().any(|c| c[*t].is_nan() || c[*t].abs() > limit);
        Error::NonFinite { what, index: (0..samples.len()).find(wrong).unwrap_or(0) }
    };
    // A product is quicker than a quotient; a wavelength whose inverse overflows fails below.
    let per_metre = 1.0 / turn_m;
    let mut far = [0.0; 3];
    for axis in 0..3 {
        let Some([low, high]) = range(level, &columns[axis]) else {
            return Err(not_finite(&columns, "position", f64::MAX));
        };
        let middle = low / 2.0 + high / 2.0;
        on_tier!(level, simd => shift(simd, &mut columns[axis], middle, per_metre));
        far[axis] = ((high - middle) * per_metre).max(-(low - middle) * per_metre);
    }
    // Negated, so that a NaN is caught too.
    if !far.iter().all(|f| *f <= 1e150) {
        return Err(not_finite(&columns, "position in wavelengths", 1e150));
    }
    let squares = on_tier!(level, simd => farthest(simd, &columns[0], &columns[1]));
    Ok((columns, squares.sqrt(), far[2]))
}

#[inline(always)]
fn shift<S: Simd>(simd: S, column: &mut [f64], middle: f64, factor: f64) {
    let _ = simd;
    column.iter_mut().for_each(|v| *v = (*v - middle) * factor);
}

/// The largest `x^2 + y^2`.
#[inline(always)]
fn farthest<S: Simd>(simd: S, x: &[f64], y: &[f64]) -> f64 {
    let [most] = fold(
        simd,
        [x, y],
        [0.0; 2],
        [0.0],
        #[inline(always)]
        |[m], [x, y]| [m.max(x.mul_add(x, y * y))],
    );
    high(most.as_slice())
}

/// Powers of two that bring the largest sample and the largest weight into [0.5, 1).
fn exponents(level: Level, re: &[f64], im: &[f64], weight: &[f64]) -> Result<(i32, i32), Error> {
    // Samples are finite ([`Samples::push`]): without a range there is none.
    let [re_low, re_high] = range(level, re).ok_or(Error::Empty)?;
    let [im_low, im_high] = range(level, im).ok_or(Error::Empty)?;
    let [w_low, w_max] = range(level, weight).ok_or(Error::Empty)?;
    let mut z_max = re_high.max(-re_low).max(im_high).max(-im_low);
    if w_low == 0.0 {
        // Samples that weigh nothing have no say.
        let of = |((re, im), w): ((&f64, &f64), &f64)| if *w > 0.0 { re.abs().max(im.abs()) } else { 0.0 };
        z_max = re.iter().zip(im).zip(weight).map(of).fold(0.0, f64::max);
    }
    if z_max == 0.0 || w_max == 0.0 {
        return Err(Error::ZeroEnergy { count: re.len() });
    }
    Ok((-exponent_above(z_max), -exponent_above(w_max)))
}

/// Applies the powers of two, each in two factors, and the weights; returns `sum |w z|`, `sum w |z|^2` and `sum w`.
#[inline(always)]
fn scale<S: Simd>(
    simd: S,
    [[za, zb], [wa, wb]]: [[f64; 2]; 2],
    re: &mut [f64],
    im: &mut [f64],
    weight: &mut [f64],
) -> [f64; 3] {
    for ((re, im), w) in re.iter_mut().zip(im.iter_mut()).zip(weight.iter_mut()) {
        *w = *w * wa * wb;
        *re = *re * za * zb * *w;
        *im = *im * za * zb * *w;
    }
    // Of samples that carry their weight: |w z|, and w |z|^2 = |w z|^2 / w (nothing over something where w is nothing).
    let least = V::<S, f64>::splat(simd, f64::MIN_POSITIVE);
    let terms = fold(
        simd,
        [re, im, weight],
        [0.0; 3],
        [0.0; 3],
        #[inline(always)]
        |[a, e, s], [re, im, w]| {
            let power = re.mul_add(re, im * im);
            [a + power.sqrt(), e + power / w.max(least), s + w]
        },
    );
    terms.map(|t| t.as_slice().iter().sum())
}

/// Scatter of positions about their mean: xx, xy, yy, xz, yz, zz.
#[inline(always)]
fn scatter<S: Simd>(simd: S, at: [&[f64]; 3]) -> [f64; 6] {
    let sums = fold(
        simd,
        at,
        [0.0; 3],
        [0.0; 3],
        #[inline(always)]
        |[a, b, c], [x, y, z]| [a + x, b + y, c + z],
    );
    let mean: [f64; 3] = sums.map(|s| s.as_slice().iter().sum::<f64>() / at[0].len() as f64);
    let m = mean.map(|m| V::<S, f64>::splat(simd, m));
    let products = fold(
        simd,
        at,
        mean,
        [0.0; 6],
        #[inline(always)]
        |[xx, xy, yy, xz, yz, zz], [x, y, z]| {
            let [x, y, z] = [x - m[0], y - m[1], z - m[2]];
            [x.mul_add(x, xx), x.mul_add(y, xy), y.mul_add(y, yy), x.mul_add(z, xz), y.mul_add(z, yz), z.mul_add(z, zz)]
        },
    );
    products.map(|p| p.as_slice().iter().sum())
}

/// Weighted scatter of positions about their weighted mean: xx, xy, yy, xz, yz, zz.
#[inline(always)]
fn weighted_scatter<S: Simd>(simd: S, [x, y, z]: [&[f64]; 3], weight: &[f64], weight_sum: f64) -> [f64; 6] {
    let columns = [x, y, z, weight];
    let sums = fold(
        simd,
        columns,
        [0.0; 4],
        [0.0; 3],
        #[inline(always)]
        |[a, b, c], [x, y, z, w]| [w.mul_add(x, a), w.mul_add(y, b), w.mul_add(z, c)],
    );
    let m = sums.map(|s| V::<S, f64>::splat(simd, s.as_slice().iter().sum::<f64>() / weight_sum));
    let products = fold(
        simd,
        columns,
        [0.0; 4],
        [0.0; 6],
        #[inline(always)]
        |[xx, xy, yy, xz, yz, zz], [x, y, z, w]| {
            let [x, y, z] = [x - m[0], y - m[1], z - m[2]];
            let [wx, wy, wz] = [w * x, w * y, w * z];
            [
                wx.mul_add(x, xx),
                wx.mul_add(y, xy),
                wy.mul_add(y, yy),
                wx.mul_add(z, xz),
                wy.mul_add(z, yz),
                wz.mul_add(z, zz),
            ]
        },
    );
    products.map(|p| p.as_slice().iter().sum())
}

/// Smallest and largest coordinate along each of three directions.
#[inline(always)]
fn extents<S: Simd>(simd: S, at: [&[f64]; 3], directions: [[f64; 3]; 3]) -> [[f64; 2]; 3] {
    let first = at.map(|c| c.first().copied().unwrap_or(0.0));
    directions.map(|d| {
        let [a, b, c] = d.map(|v| V::<S, f64>::splat(simd, v));
        let along = |[x, y, z]: [V<S, f64>; 3]| a.mul_add(x, b.mul_add(y, c * z));
        let start = [f64::INFINITY, f64::NEG_INFINITY];
        let [lows, highs] = fold(
            simd,
            at,
            first,
            start,
            #[inline(always)]
            |[l, h], at| {
                let v = along(at);
                [l.min(v), h.max(v)]
            },
        );
        [low(lows.as_slice()), high(highs.as_slice())]
    })
}

/// The least `e` with `x < 2^e`, for positive finite `x`.
fn exponent_above(x: f64) -> i32 {
    let (x, shift) = if x < f64::MIN_POSITIVE { (x * 2f64.powi(64), 64) } else { (x, 0) };
    let biased = ((x.to_bits() >> 52) & 0x7ff) as i32;
    biased - 1022 - shift
}
