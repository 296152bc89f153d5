//! SIMD tiers, the two precisions, and the sine and cosine of an angle in turns.

use fearless_simd::{Level, Simd, SimdBase, SimdFloat, SimdFloatElement};

/// An instruction set that the kernels are compiled for; chosen at run time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Tier {
    /// No SIMD instructions asked for: the portable code.
    Portable,
    /// x86-64-v2: 128 bits, no fused multiply-add (UP Squared, Apollo Lake).
    Sse42,
    /// x86-64-v3: 256 bits with fused multiply-add.
    Avx2,
    /// 512 bits (Ice Lake and later).
    Avx512,
    /// Whatever this machine offers that is none of the above (NEON on 64-bit ARM).
    Native,
}

impl Tier {
    /// The widest tier of this machine.
    #[must_use]
    pub fn detect() -> Self {
        Self::available().last().copied().unwrap_or(Self::Portable)
    }

    /// Every tier that this machine can run, narrowest first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        [Self::Portable, Self::Sse42, Self::Avx2, Self::Avx512, Self::Native]
            .into_iter()
            .filter(|tier| tier.level().is_some())
            .collect()
    }

    /// The dispatch level, or none where this machine lacks the instructions.
    pub(crate) fn level(self) -> Option<Level> {
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

    /// The dispatch level, the portable one where this machine lacks the instructions.
    pub(crate) fn level_or_portable(self) -> Level {
        self.level().unwrap_or_else(Level::fallback)
    }
}

/// Runs `$op` compiled for the tier of `$level`; `fearless_simd::dispatch!` without the tiers that [`Tier`] lacks.
macro_rules! on_tier {
    ($level:expr, $simd:ident => $op:expr) => {{
        #[cfg(target_arch = "x86_64")]
        {
            use fearless_simd::{Level, Simd};
            match $level {
                Level::Avx512($simd) => $simd.vectorize(#[inline(always)] || $op),
                Level::Avx2($simd) => $simd.vectorize(#[inline(always)] || $op),
                Level::Sse4_2($simd) => $simd.vectorize(#[inline(always)] || $op),
                _ => {
                    let $simd = fearless_simd::Fallback::new();
                    $simd.vectorize(#[inline(always)] || $op)
                }
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            fearless_simd::dispatch!($level, $simd => $op)
        }
    }};
}
pub(crate) use on_tier;

/// The two precisions of the kernels.
pub(crate) trait Real: SimdFloatElement + Into<f64> + rustfft::FftNum + bytemuck::Pod {
    /// Rounds from double.
    fn of(x: f64) -> Self;
    /// Coefficients of `sin(pi r) / r` in `r^2`, for `|r| <= 1/2`.
    const SIN: &'static [Self];
    /// Coefficients of `cos(pi r)` in `r^2`, for `|r| <= 1/2`.
    const COS: &'static [Self];
}

// Near-minimax coefficients (Chebyshev fit in r^2 over [0, 1/4], 40 digits); errors 1.4e-8 and 4.7e-8 in single,
// 6.5e-19 and 3.9e-18 in double.
impl Real for f32 {
    fn of(x: f64) -> Self {
        x as Self
    }
    #[allow(clippy::approx_constant)]
    const SIN: &'static [Self] = &[3.141_592_6, -5.167_71, 2.550_077_4, -0.598_290_4, 0.077_655_91];
    const COS: &'static [Self] = &[0.999_999_94, -4.934_792_6, 4.058_410_8, -1.331_873, 0.219_682_42];
}

impl Real for f64 {
    fn of(x: f64) -> Self {
        x
    }
    #[allow(clippy::excessive_precision, clippy::approx_constant)]
    const SIN: &'static [Self] = &[
        3.141592653589793238,
        -5.167712780049969608,
        2.550164039877300474,
        -0.5992645293189446813,
        0.08214588657310289502,
        -0.007370430505916943405,
        0.0004662998161898393801,
        -0.00002190349707462601719,
        7.697826768224190645e-7,
    ];
    #[allow(clippy::excessive_precision)]
    const COS: &'static [Self] = &[
        1.0,
        -4.934802200544676767,
        4.058712126416496999,
        -1.335262768843447093,
        0.2353306301295328539,
        -0.02580688873700220327,
        0.001929556272481713148,
        -0.0001045665533874873817,
        4.149564353942585512e-6,
    ];
}

/// A native-width vector of `T`.
pub(crate) type V<S, T> = <T as SimdFloatElement>::Native<S>;

#[inline(always)]
fn polynomial<S: Simd, T: Real>(simd: S, t: V<S, T>, coefficients: &[T]) -> V<S, T> {
    let mut value = V::<S, T>::splat(simd, coefficients[coefficients.len() - 1]);
    for &c in coefficients[..coefficients.len() - 1].iter().rev() {
        value = value.mul_add(t, V::<S, T>::splat(simd, c));
    }
    value
}

/// Sine and cosine of `2 pi turns`, absolute error a few units of the last place of 1.
///
/// Reduced to half a turn around 0 and halved: `sin 2a = 2 sin a cos a`, `cos 2a = 1 - 2 sin^2 a`. No branches, no
/// integer operations, the same code in both precisions and at every width.
#[inline(always)]
pub(crate) fn sin_cos_turns<S: Simd, T: Real>(simd: S, turns: V<S, T>) -> (V<S, T>, V<S, T>) {
    let r = turns - turns.round_ties_even();
    let t = r * r;
    let sin = polynomial::<S, T>(simd, t, T::SIN) * r;
    let cos = polynomial::<S, T>(simd, t, T::COS);
    let twice = sin + sin;
    (twice * cos, (-twice).mul_add(sin, V::<S, T>::splat(simd, T::of(1.0))))
}
