//! SIMD tiers, the two precisions, and the sine and cosine of an angle in turns.

use crate::evaluate::{Batch, Buffers, Evaluator};
use crate::fft::Planner;
use crate::rings::{RingWork, Rings};
use crate::sums::{Columns, PairSum, Sines};
use fearless_simd::{Level, Select, Simd, SimdBase, SimdFloat, SimdFloatElement};
use num_complex::Complex;

pub use fearless_simd;

/// An instruction set for which the kernels are compiled; chosen at run time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
pub enum Tier {
    /// Portable code without explicit SIMD instructions.
    Portable,
    /// x86-64-v2: 128 bits, no fused multiply-add (UP Squared, Apollo Lake).
    Sse42,
    /// x86-64-v3: 256 bits with fused multiply-add.
    Avx2,
    /// 512 bits (Ice Lake and later).
    Avx512,
    /// The best that this machine offers if it is none of the above (NEON on 64-bit ARM).
    Native,
}

impl Tier {
    /// The widest tier of this machine.
    #[must_use]
    pub fn detect() -> Self {
        Self::available().last().copied().unwrap_or(Self::Portable)
    }

    /// Every tier that this machine supports, narrowest first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        [Self::Portable, Self::Sse42, Self::Avx2, Self::Avx512, Self::Native]
            .into_iter()
            .filter(|tier| tier.level().is_some())
            .collect()
    }

    /// The dispatch level, or `None` if this machine lacks the instructions.
    pub fn level(self) -> Option<Level> {
        let level = Level::new();
        match self {
            Self::Portable => Some(Level::fallback()),
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Self::Sse42 => level.as_sse4_2().map(Level::Sse4_2),
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Self::Avx2 => level.as_avx2().map(Level::Avx2),
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Self::Avx512 => level.as_avx512().map(Level::Avx512),
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Self::Native => None,
            #[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
            Self::Native => Some(level),
            #[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
            _ => None,
        }
    }

    /// The dispatch level; the portable one if this machine lacks the instructions.
    pub fn level_or_portable(self) -> Level {
        self.level().unwrap_or_else(Level::fallback)
    }
}

/// Runs `$op` compiled for the tier of `$level`: `fearless_simd::dispatch!` without the tiers that [`Tier`] lacks.
#[macro_export]
macro_rules! on_tier {
    ($level:expr, $simd:ident => $op:expr) => {{
        #[cfg(target_arch = "x86_64")]
        {
            use $crate::simd::fearless_simd::{Level, Simd};
            match $level {
                Level::Avx512($simd) => $simd.vectorize(#[inline(always)] || $op),
                Level::Avx2($simd) => $simd.vectorize(#[inline(always)] || $op),
                Level::Sse4_2($simd) => $simd.vectorize(#[inline(always)] || $op),
                _ => {
                    let $simd = $crate::simd::fearless_simd::Fallback::new();
                    $simd.vectorize(#[inline(always)] || $op)
                }
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            $crate::simd::fearless_simd::dispatch!($level, $simd => $op)
        }
    }};
}
pub use crate::on_tier;

/// Coefficients of `atan(r) / (2 pi r)` in `r^2`, for `0 <= r <= 1` (Chebyshev fit in `r^2`; error 2e-9 of a turn).
const ATAN: [f32; 9] = [
    0.159_154_94,
    -0.053_051_177,
    0.031_818_05,
    -0.022_596_497,
    0.016_899_662,
    -0.011_867_953,
    0.006_706_411,
    -0.002_503_706,
    0.000_440_267_7,
];

/// The two precisions of the kernels, and the entries to code that is generic over them, compiled here for both.
pub trait Real: SimdFloatElement + Into<f64> + rustfft::FftNum + bytemuck::Pod {
    /// Rounds from double.
    fn of(x: f64) -> Self;
    /// Coefficients of `sqrt 2 sin(pi r) / r` in `r^2`, for `|r| <= 1/2`.
    const SIN: &'static [Self];
    /// Coefficients of `sqrt 2 cos(pi r)` in `r^2`, for `|r| <= 1/2`.
    const COS: &'static [Self];
    /// [`Real::SIN`] at the precision [`ROUGH`]; in double, the same coefficients.
    const ROUGH_SIN: &'static [Self] = Self::SIN;
    /// [`Real::COS`] at the precision [`ROUGH`].
    const ROUGH_COS: &'static [Self] = Self::COS;

    /// The FFTs of a tier: [`crate::fft::Ffts::new`].
    fn planner(tier: Tier) -> Planner<Self>;
    /// [`crate::sums::pairs`].
    fn pairs(level: Level, samples: Columns<'_, Self>, directions: &[[Self; 3]], sines: Sines) -> Vec<PairSum>;
    /// [`Evaluator::run`].
    fn run(evaluator: &Evaluator<Self>, batch: &Batch, buffers: &mut Buffers<Self>);
    /// [`Rings::powers`].
    fn powers(rings: &Rings<Self>, values: &[Complex<Self>], scale: f64, work: &mut RingWork<Self>, out: &mut [f64]);
    /// [`Rings::values`].
    fn values(rings: &Rings<Self>, values: &[Complex<Self>], work: &mut RingWork<Self>, out: &mut [Complex<Self>]);
}

/// The methods of [`Real`], for one precision.
macro_rules! entries {
    () => {
        #[inline(never)]
        fn planner(tier: Tier) -> Planner<Self> {
            Planner(crate::fft::plans_of(tier))
        }

        fn pairs(level: Level, samples: Columns<'_, Self>, directions: &[[Self; 3]], sines: Sines) -> Vec<PairSum> {
            crate::sums::pairs_of(level, samples, directions, sines)
        }

        fn run(evaluator: &Evaluator<Self>, batch: &Batch, buffers: &mut Buffers<Self>) {
            evaluator.run_of(batch, buffers);
        }

        fn powers(
            rings: &Rings<Self>,
            values: &[Complex<Self>],
            scale: f64,
            work: &mut RingWork<Self>,
            out: &mut [f64],
        ) {
            rings.powers_of(values, scale, work, out);
        }

        fn values(rings: &Rings<Self>, values: &[Complex<Self>], work: &mut RingWork<Self>, out: &mut [Complex<Self>]) {
            rings.values_of(values, work, out);
        }
    };
}

/// Largest error of [`rough_sin_cos_turns`] in single precision (measured: 1.29e-3).
pub const ROUGH: f64 = 1.3e-3;

// Near-minimax coefficients (Chebyshev fit in r^2 over [0, 1/4], 40 digits); errors 2e-8 and 7e-8 in single (rough:
// 3.9e-4 and 8.5e-4), 9e-19 and 5.6e-18 in double.
#[allow(clippy::excessive_precision, clippy::approx_constant)]
impl Real for f32 {
    fn of(x: f64) -> Self {
        x as Self
    }
    const SIN: &'static [Self] = &[4.44288291905, -7.30824567684, 3.60635402513, -0.846110413875, 0.109822044339];
    const COS: &'static [Self] = &[1.41421349594, -6.97885090878, 5.73945958198, -1.88355282147, 0.310677862835];
    const ROUGH_SIN: &'static [Self] = &[4.44248986911, -7.27989367869, 3.30064540401];
    const ROUGH_COS: &'static [Self] = &[1.41335061281, -6.91657587107, 5.06589404007];
    entries!();
}

#[allow(clippy::excessive_precision, clippy::approx_constant)]
impl Real for f64 {
    fn of(x: f64) -> Self {
        x
    }
    const SIN: &'static [Self] = &[
        4.442882938158366246,
        -7.308249499995438109,
        3.606476571470640724,
        -0.8474880248119808207,
        0.1161718268848440421,
        -0.01042336278199613374,
        0.0006594475241877521707,
        -0.0000309762226263355259,
        1.088637101642130212e-6,
    ];
    const COS: &'static [Self] = &[
        1.414213562373095043,
        -6.978864199638875939,
        5.739885734946353916,
        -1.888346717030253862,
        0.3328077687709918717,
        -0.0364964520545219895,
        0.002728804649905714023,
        -0.0001478794379711949596,
        5.868370187285554516e-6,
    ];
    entries!();
}

/// A native-width vector of `T`.
pub type V<S, T> = <T as SimdFloatElement>::Native<S>;

#[inline(always)]
fn polynomial<S: Simd, T: Real>(simd: S, t: V<S, T>, coefficients: &[T]) -> V<S, T> {
    let mut value = V::<S, T>::splat(simd, coefficients[coefficients.len() - 1]);
    for &c in coefficients[..coefficients.len() - 1].iter().rev() {
        value = value.mul_add(t, V::<S, T>::splat(simd, c));
    }
    value
}

/// Sine and cosine of `2 pi turns`; absolute error a few units in the last place of 1.
///
/// Reduces to half a turn around 0 and halves: `sin 2a = 2 sin a cos a`, `cos 2a = 1 - 2 sin^2 a`, with the square root of the
/// 2 in either factor. No branches, no integer operations, the same code in both precisions and at every width.
#[inline(always)]
pub fn sin_cos_turns<S: Simd, T: Real>(simd: S, turns: V<S, T>) -> (V<S, T>, V<S, T>) {
    sin_cos_by::<S, T>(simd, turns, T::SIN, T::COS)
}

/// As [`sin_cos_turns`], with absolute error at most [`ROUGH`] in single precision and four operations fewer.
#[inline(always)]
pub fn rough_sin_cos_turns<S: Simd, T: Real>(simd: S, turns: V<S, T>) -> (V<S, T>, V<S, T>) {
    sin_cos_by::<S, T>(simd, turns, T::ROUGH_SIN, T::ROUGH_COS)
}

#[inline(always)]
fn sin_cos_by<S: Simd, T: Real>(simd: S, turns: V<S, T>, sin: &[T], cos: &[T]) -> (V<S, T>, V<S, T>) {
    let r = turns - turns.round_ties_even();
    let t = r * r;
    let sin = polynomial::<S, T>(simd, t, sin) * r;
    let cos = polynomial::<S, T>(simd, t, cos);
    (sin * cos, (-sin).mul_add(sin, V::<S, T>::splat(simd, T::of(1.0))))
}

/// The angle of `re + j im` in turns, -1/2 to 1/2, absolute error at most 1e-7. For zeros, the signs of both decide, as in
/// `atan2`.
#[inline(always)]
pub fn turns_of<S: Simd>(simd: S, re: V<S, f32>, im: V<S, f32>) -> V<S, f32> {
    let splat = |value: f32| V::<S, f32>::splat(simd, value);
    let (x, y) = (re.abs(), im.abs());
    let r = x.min(y) / x.max(y).max(splat(f32::MIN_POSITIVE));
    let octant = polynomial::<S, f32>(simd, r * r, &ATAN) * r;
    // Above the diagonal the angle is measured from the other axis; left of the imaginary axis, from the opposite side.
    let quadrant = y.simd_gt(x).select(splat(0.25) - octant, octant);
    let half = splat(1.0).copysign(re).simd_lt(splat(0.0)).select(splat(0.5) - quadrant, quadrant);
    half.copysign(im)
}
