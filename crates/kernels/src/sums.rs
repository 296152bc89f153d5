//! Direct sums over all samples: antipodal pairs of directions, and the moments for Newton's method.

use fearless_simd::{Level, Simd, SimdBase, SimdFloat};
use num_complex::Complex64;

use crate::simd::{Real, V, on_tier, rough_sin_cos_turns, sin_cos_turns};

/// Samples per block: single-precision sums are added to double after each, so that their error does not grow with the number
/// of samples (measured: 4e-9 at 1e7 samples with a flush each 4,096).
const BLOCK: usize = 512;
/// Direction vectors per pass over a block.
const WIDE: usize = 2;

/// Samples (positions in turns, weighted values) in one precision.
#[derive(Clone, Copy)]
pub struct Columns<'a, T> {
    /// Along the first axis from the middle, turns.
    pub x: &'a [T],
    /// Along the second axis, turns.
    pub y: &'a [T],
    /// Along the third axis, turns; empty if every height is zero.
    pub z: &'a [T],
    /// Real parts.
    pub re: &'a [T],
    /// Imaginary parts.
    pub im: &'a [T],
}

/// The four partial sums of a direction `u` and its antipode `-u`.
#[derive(Clone, Copy, Debug, Default)]
pub struct PairSum {
    re_cos: f64,
    im_sin: f64,
    im_cos: f64,
    re_sin: f64,
}

impl PairSum {
    /// `f(u)`.
    pub fn here(self) -> Complex64 {
        Complex64::new(self.re_cos + self.im_sin, self.im_cos - self.re_sin)
    }

    /// `f(-u)`.
    pub fn opposite(self) -> Complex64 {
        Complex64::new(self.re_cos - self.im_sin, self.im_cos + self.re_sin)
    }
}

/// Accuracy of the sines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sines {
    /// To the last place.
    Fine,
    /// To [`crate::simd::ROUGH`] in single precision: for a search, whose result does not use these sums.
    Rough,
}

/// `f(u)` and `f(-u)` for each direction; one sine and cosine for both.
#[must_use]
pub fn pairs<T: Real>(level: Level, samples: Columns<'_, T>, directions: &[[T; 3]], sines: Sines) -> Vec<PairSum> {
    T::pairs(level, samples, directions, sines)
}

pub(crate) fn pairs_of<T: Real>(
    level: Level,
    samples: Columns<'_, T>,
    directions: &[[T; 3]],
    sines: Sines,
) -> Vec<PairSum> {
    let mut sums = vec![PairSum::default(); directions.len()];
    let rough = sines == Sines::Rough && const { size_of::<T>() == 4 };
    match (samples.z.is_empty(), rough) {
        (true, false) => on_tier!(level, simd => all::<_, T, false, false>(simd, samples, directions, &mut sums)),
        (false, false) => on_tier!(level, simd => all::<_, T, true, false>(simd, samples, directions, &mut sums)),
        (true, true) => on_tier!(level, simd => all::<_, T, false, true>(simd, samples, directions, &mut sums)),
        (false, true) => on_tier!(level, simd => all::<_, T, true, true>(simd, samples, directions, &mut sums)),
    }
    sums
}

/// Every direction, `WIDE` vectors at a time and the rest one by one.
#[inline(always)]
fn all<S: Simd, T: Real, const TALL: bool, const ROUGH: bool>(
    simd: S,
    samples: Columns<'_, T>,
    directions: &[[T; 3]],
    sums: &mut [PairSum],
) {
    let chunk = WIDE * V::<S, T>::LEN;
    let whole = directions.len() / chunk * chunk;
    for from in (0..whole).step_by(chunk) {
        some::<S, T, TALL, ROUGH, WIDE>(simd, samples, &directions[from..][..chunk], &mut sums[from..][..chunk]);
    }
    let (rest, sums) = (&directions[whole..], &mut sums[whole..]);
    if rest.len() > V::<S, T>::LEN {
        some::<S, T, TALL, ROUGH, WIDE>(simd, samples, rest, sums);
    } else if !rest.is_empty() {
        some::<S, T, TALL, ROUGH, 1>(simd, samples, rest, sums);
    }
}

/// Up to `N` vectors of directions.
#[inline(always)]
fn some<S: Simd, T: Real, const TALL: bool, const ROUGH: bool, const N: usize>(
    simd: S,
    samples: Columns<'_, T>,
    directions: &[[T; 3]],
    sums: &mut [PairSum],
) {
    let lanes = V::<S, T>::LEN;
    let lane = |k: usize, axis: usize| {
        V::<S, T>::from_fn(simd, |i| directions.get(k * lanes + i).map_or(T::of(0.0), |u| u[axis]))
    };
    let u: [[V<S, T>; 3]; N] = std::array::from_fn(|k| std::array::from_fn(|axis| lane(k, axis)));
    // A vector has at most 16 lanes.
    let mut totals = [[[0f64; 16]; 4]; N];
    for from in (0..samples.x.len()).step_by(BLOCK) {
        let to = (from + BLOCK).min(samples.x.len());
        let acc = block::<S, T, TALL, ROUGH, N>(simd, samples, from..to, &u);
        for (total, acc) in totals.iter_mut().flatten().zip(acc.iter().flatten()) {
            for (total, value) in total[..lanes].iter_mut().zip(acc.as_slice()) {
                *total += (*value).into();
            }
        }
    }
    for (i, sum) in sums.iter_mut().enumerate() {
        let [re_cos, im_sin, im_cos, re_sin] = &totals[i / lanes];
        let lane = i % lanes;
        *sum = PairSum { re_cos: re_cos[lane], im_sin: im_sin[lane], im_cos: im_cos[lane], re_sin: re_sin[lane] };
    }
}

#[inline(always)]
fn block<S: Simd, T: Real, const TALL: bool, const ROUGH: bool, const N: usize>(
    simd: S,
    samples: Columns<'_, T>,
    range: std::ops::Range<usize>,
    u: &[[V<S, T>; 3]; N],
) -> [[V<S, T>; 4]; N] {
    let splat = |value: T| V::<S, T>::splat(simd, value);
    let mut acc = [[splat(T::of(0.0)); 4]; N];
    let n = range.len();
    let (x, y) = (&samples.x[range.clone()], &samples.y[range.clone()]);
    let (re, im) = (&samples.re[range.clone()], &samples.im[range.clone()]);
    let z = if TALL { &samples.z[range] } else { x };
    for t in 0..n {
        let (px, py, zr, zi) = (splat(x[t]), splat(y[t]), splat(re[t]), splat(im[t]));
        for k in 0..N {
            let mut turns = u[k][0].mul_add(px, u[k][1] * py);
            if TALL {
                turns = u[k][2].mul_add(splat(z[t]), turns);
            }
            let (sin, cos) =
                if ROUGH { rough_sin_cos_turns::<S, T>(simd, turns) } else { sin_cos_turns::<S, T>(simd, turns) };
            acc[k][0] = cos.mul_add(zr, acc[k][0]);
            acc[k][1] = sin.mul_add(zi, acc[k][1]);
            acc[k][2] = cos.mul_add(zi, acc[k][2]);
            acc[k][3] = sin.mul_add(zr, acc[k][3]);
        }
    }
    acc
}

/// Moments of `w_t = z_t exp(-j 2 pi q_t . u)` about a direction of azimuth `a`.
///
/// `h` is the position along the horizontal direction `(cos a, sin a)`, `v` along `(-sin a, cos a)`, `z` upwards,
/// in turns.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    /// `sum w`.
    pub one: Complex64,
    /// `sum h w`.
    pub h: Complex64,
    /// `sum v w`.
    pub v: Complex64,
    /// `sum h h w`.
    pub hh: Complex64,
    /// `sum h v w`.
    pub hv: Complex64,
    /// `sum v v w`.
    pub vv: Complex64,
    /// `sum z w`.
    pub z: Complex64,
    /// `sum h z w`.
    pub hz: Complex64,
    /// `sum v z w`.
    pub vz: Complex64,
    /// `sum z z w`.
    pub zz: Complex64,
}

/// A direction as the moments need it: `u = (s cos a, s sin a, height)`.
#[derive(Clone, Copy)]
pub struct Aim {
    /// `cos a` of the azimuth.
    pub cos: f64,
    /// `sin a` of the azimuth.
    pub sin: f64,
    /// Cosine of the elevation.
    pub s: f64,
    /// Sine of the elevation.
    pub height: f64,
}

/// Which derivatives are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// By azimuth alone: the moments one, h, v and vv.
    Azimuth,
    /// By azimuth and the second coordinate: all moments up to second order.
    Both,
}

/// The moments of the samples, in double.
pub fn moments(level: Level, samples: Columns<'_, f64>, aim: Aim, wanted: Wanted) -> Moments {
    let mut sums = [0.0; 20];
    match (samples.z.is_empty(), wanted) {
        (true, Wanted::Both) => on_tier!(level, simd => moments_simd::<_, false, true>(simd, samples, aim, &mut sums)),
        (false, Wanted::Both) => on_tier!(level, simd => moments_simd::<_, true, true>(simd, samples, aim, &mut sums)),
        (true, Wanted::Azimuth) => {
            on_tier!(level, simd => moments_simd::<_, false, false>(simd, samples, aim, &mut sums))
        }
        (false, Wanted::Azimuth) => {
            on_tier!(level, simd => moments_simd::<_, true, false>(simd, samples, aim, &mut sums))
        }
    }
    let c = |i: usize| Complex64::new(sums[2 * i], sums[2 * i + 1]);
    Moments { one: c(0), h: c(1), v: c(2), hh: c(3), hv: c(4), vv: c(5), z: c(6), hz: c(7), vz: c(8), zz: c(9) }
}

#[inline(always)]
fn moments_simd<S: Simd, const TALL: bool, const BOTH: bool>(
    simd: S,
    samples: Columns<'_, f64>,
    aim: Aim,
    sums: &mut [f64; 20],
) {
    let lanes = V::<S, f64>::LEN;
    let splat = |value: f64| V::<S, f64>::splat(simd, value);
    let (ca, sa, s, height) = (splat(aim.cos), splat(aim.sin), splat(aim.s), splat(aim.height));
    let mut acc = [splat(0.0); 20];
    let n = samples.x.len();
    let load = |column: &[f64], from: usize| {
        if from + lanes <= n {
            V::<S, f64>::from_slice(simd, &column[from..from + lanes])
        } else {
            V::<S, f64>::from_fn(simd, |i| column.get(from + i).copied().unwrap_or(0.0))
        }
    };
    for from in (0..n).step_by(lanes) {
        let (x, y) = (load(samples.x, from), load(samples.y, from));
        let (re, im) = (load(samples.re, from), load(samples.im, from));
        let h = ca.mul_add(x, sa * y);
        let v = ca.mul_add(y, -(sa * x));
        let mut turns = s * h;
        let z = if TALL { load(samples.z, from) } else { h };
        if TALL {
            turns = height.mul_add(z, turns);
        }
        let (sin, cos) = sin_cos_turns::<S, f64>(simd, turns);
        let w = [cos.mul_add(re, sin * im), cos.mul_add(im, -(sin * re))];
        for (part, w) in w.into_iter().enumerate() {
            let wv = w * v;
            acc[part] += w;
            acc[4 + part] += wv;
            acc[10 + part] = wv.mul_add(v, acc[10 + part]);
            if !BOTH {
                acc[2 + part] = w.mul_add(h, acc[2 + part]);
                continue;
            }
            let wh = w * h;
            acc[2 + part] += wh;
            acc[6 + part] = wh.mul_add(h, acc[6 + part]);
            acc[8 + part] = wh.mul_add(v, acc[8 + part]);
            if TALL {
                acc[12 + part] = w.mul_add(z, acc[12 + part]);
                acc[14 + part] = wh.mul_add(z, acc[14 + part]);
                acc[16 + part] = wv.mul_add(z, acc[16 + part]);
                acc[18 + part] = (w * z).mul_add(z, acc[18 + part]);
            }
        }
    }
    for (sum, v) in sums.iter_mut().zip(acc) {
        *sum = v.as_slice().iter().sum();
    }
}
