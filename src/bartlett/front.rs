//! The front end of every estimate, in double: validation, centring, positions in turns, scaling by powers of two.

use fearless_simd::{Level, Simd, SimdBase, SimdFloat};

use super::error::Error;
use crate::signal::samples::Samples;
use csi5300_kernels::simd::{V, on_tier};

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
pub(crate) fn range(level: Level, column: &[f64]) -> Option<[f64; 2]> {
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

/// Columns of a batch of samples, and what was found on the way.
pub(crate) struct Front {
    /// Displacements in turns about the middle of their bounding box.
    pub at: [Vec<f64>; 3],
    /// Largest distance from the middle in x and y, turns.
    pub radius: f64,
    /// Largest vertical distance from the middle, turns.
    pub half_height: f64,
    /// Weighted, scaled samples, and their weights, scaled by a power of their own.
    pub re: Vec<f64>,
    pub im: Vec<f64>,
    pub weight: Vec<f64>,
    /// Power of two that samples and weights were multiplied by together.
    pub exponent: i32,
    /// `sum |re + j im|`, `sum w |z|^2`, `sum w`.
    pub sums: [f64; 3],
}

impl Front {
    pub fn new(level: Level, samples: &Samples, turn_m: f64) -> Result<Self, Error> {
        let (at, radius, half_height) = centred_turns(level, samples, turn_m)?;
        let mut re: Vec<f64> = samples.z().iter().map(|z| z.re).collect();
        let mut im: Vec<f64> = samples.z().iter().map(|z| z.im).collect();
        let mut weight = samples.weight().to_vec();
        let (z_exponent, w_exponent) = exponents(level, &re, &im, &weight)?;
        let halves = |exponent: i32| [exponent / 2, exponent - exponent / 2].map(|half| 2f64.powi(half));
        let factors = [halves(z_exponent), halves(w_exponent)];
        let sums = on_tier!(level, simd => scale(simd, factors, &mut re, &mut im, &mut weight));
        Ok(Self { at, radius, half_height, re, im, weight, exponent: z_exponent + w_exponent, sums })
    }
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

/// Sum, and then scatter about the mean (xx, xy, yy, xz, yz, zz) of positions.
pub(crate) fn scatter(level: Level, at: [&[f64]; 3]) -> ([f64; 3], [f64; 6]) {
    on_tier!(level, simd => scatter_simd(simd, at))
}

#[inline(always)]
fn scatter_simd<S: Simd>(simd: S, at: [&[f64]; 3]) -> ([f64; 3], [f64; 6]) {
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
    (mean, products.map(|p| p.as_slice().iter().sum()))
}

/// Weighted scatter of positions about their weighted mean: xx, xy, yy, xz, yz, zz.
pub(crate) fn weighted_scatter(level: Level, at: [&[f64]; 3], weight: &[f64], weight_sum: f64) -> [f64; 6] {
    on_tier!(level, simd => weighted_scatter_simd(simd, at, weight, weight_sum))
}

#[inline(always)]
fn weighted_scatter_simd<S: Simd>(simd: S, [x, y, z]: [&[f64]; 3], weight: &[f64], weight_sum: f64) -> [f64; 6] {
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
pub(crate) fn extents(level: Level, at: [&[f64]; 3], directions: [[f64; 3]; 3]) -> [[f64; 2]; 3] {
    on_tier!(level, simd => extents_simd(simd, at, directions))
}

#[inline(always)]
fn extents_simd<S: Simd>(simd: S, at: [&[f64]; 3], directions: [[f64; 3]; 3]) -> [[f64; 2]; 3] {
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
pub(crate) fn exponent_above(x: f64) -> i32 {
    let (x, shift) = if x < f64::MIN_POSITIVE { (x * 2f64.powi(64), 64) } else { (x, 0) };
    let biased = ((x.to_bits() >> 52) & 0x7ff) as i32;
    biased - 1022 - shift
}
