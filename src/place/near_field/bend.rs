//! The curvature of a wave front (its phase less that of a plane wave) by a polynomial: half the work of the exact one.

use crate::tuning::TUNING;
use csi5300_kernels::kernel::fit_polynomial;

/// Degree of the polynomial.
pub(super) const DEGREE: usize = 6;

/// `1 / (sqrt(1 + x) + 1)` by a polynomial in `scale (x - middle)`: what divides the bend of a wave front. Root and
/// division would take most of the kernel's time, and a search computes thousands of powers before it needs one exactly.
#[derive(Clone, Copy, Debug)]
pub(super) struct BendPolynomial {
    pub middle: f32,
    pub scale: f32,
    /// Highest power first.
    pub coefficients: [f32; DEGREE + 1],
}

impl BendPolynomial {
    /// For curvatures up to `curve` (1/turns) over samples up to `rim` turns away; `None` where the polynomial is not
    /// good enough: places hardly outside the motion.
    pub fn new(curve: f64, rim: f64) -> Option<Self> {
        let q = curve * rim;
        // x = q' (q' + 2 cos) for q' up to q, which falls down to q' = 1.
        let (low, high) = (q * (q - 2.0), q * (q + 2.0));
        let (middle, width) = (0.5 * (low + high), (high - low).max(1e-3));
        let exact = |s: f64| 1.0 / ((1.0 + middle + width * s).max(0.0).sqrt() + 1.0);
        let fit = fit_polynomial(DEGREE, exact);
        let value = |s: f64| fit.iter().fold(0.0, |sum, c| sum * s + c);
        let off = (0..=64).map(|k| f64::from(k) / 64.0 - 0.5).map(|s| (value(s) - exact(s)).abs()).fold(0.0, f64::max);
        let good = q < 1.0 && off * rim * (q + 2.0) < TUNING.grid.rough_turns;
        let coefficients = std::array::from_fn(|k| fit[k] as f32);
        good.then_some(Self { middle: middle as f32, scale: (1.0 / width) as f32, coefficients })
    }
}
