//! The Kaiser-Bessel kernel of the NUFFT \[beatty2005\]: values, Fourier transform, piecewise polynomials \[finufft2019\],
//! and error.

use std::f64::consts::PI;

/// A Kaiser-Bessel kernel of `width` grid cells.
///
/// `phi(x) = I0(beta sqrt(1 - (2 x / w)^2)) / I0(beta)` for `|x| <= w / 2`, x in cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kernel {
    /// Width in cells.
    pub width: usize,
    /// Oversampling for which `beta` is chosen.
    pub oversampling: f64,
    beta: f64,
    /// `exp(-beta) I0(beta)`.
    norm: f64,
}

impl Kernel {
    /// The kernel for a grid `oversampling` times as fine as the band requires (\[beatty2005\], equation 5).
    pub fn new(width: usize, oversampling: f64) -> Self {
        let ratio = width as f64 / oversampling * (oversampling - 0.5);
        let beta = PI * (ratio * ratio - 0.8).sqrt();
        Self { width, oversampling, beta, norm: i0_scaled(beta) }
    }

    /// Value at `x` cells from the middle.
    pub fn value(&self, x: f64) -> f64 {
        let t = 2.0 * x / self.width as f64;
        let inside = 1.0 - t * t;
        if inside < 0.0 {
            return 0.0;
        }
        let r = inside.sqrt();
        (self.beta * (r - 1.0)).exp() * i0_scaled(self.beta * r) / self.norm
    }

    /// Fourier transform `integral phi(x) exp(-j 2 pi xi x) dx` at `xi` cycles per cell.
    pub fn transform(&self, xi: f64) -> f64 {
        let w = self.width as f64;
        let square = self.beta * self.beta - (PI * w * xi).powi(2);
        // Divided by exp(beta), like the value's normalisation below.
        let shape = if square > 0.0 {
            let root = square.sqrt();
            ((root - self.beta).exp() - (-root - self.beta).exp()) / (2.0 * root)
        } else {
            let root = (-square).sqrt();
            let sinc = if root < 1e-8 { 1.0 } else { root.sin() / root };
            sinc * (-self.beta).exp()
        };
        w * shape / self.norm
    }

    /// Polynomial coefficients for each of the `width` cells that a point touches, highest degree first:
    /// `weight[j](s) = phi(s + (w - 1) / 2 - j)`, `s` in [-1/2, 1/2].
    pub fn polynomials(&self, degree: usize) -> Vec<Vec<f64>> {
        let mut powers = vec![vec![0.0; self.width]; degree + 1];
        for j in 0..self.width {
            let own = fit_polynomial(degree, |s| self.value(s + (self.width as f64 - 1.0) / 2.0 - j as f64));
            powers.iter_mut().zip(own).for_each(|(power, coefficient)| power[j] = coefficient);
        }
        powers
    }

    /// Largest error of spreading with this kernel, relative to the magnitude of a sample, for frequencies up to
    /// `1 / (2 oversampling)` cycles per cell: measured over offsets and frequencies, not estimated.
    pub fn loss(&self) -> f64 {
        let mut worst = 0f64;
        for step in 0..=16 {
            let xi = 0.5 / self.oversampling * (1.0 - f64::from(step) / 32.0);
            let transform = self.transform(xi);
            for offset in 0..16 {
                let s = (f64::from(offset) + 0.5) / 16.0 - 0.5;
                let (mut re, mut im) = (0.0, 0.0);
                for j in 0..self.width {
                    let x = s + (self.width as f64 - 1.0) / 2.0 - j as f64;
                    let (sin, cos) = (2.0 * PI * xi * x).sin_cos();
                    re += self.value(x) * cos;
                    im -= self.value(x) * sin;
                }
                worst = worst.max((re / transform - 1.0).hypot(im / transform));
            }
        }
        worst
    }
}

/// The polynomial through `f` at the Chebyshev nodes of [-1/2, 1/2]: coefficients, highest degree first, from the Chebyshev
/// polynomials expanded into powers.
pub fn fit_polynomial(degree: usize, f: impl Fn(f64) -> f64) -> Vec<f64> {
    let n = degree + 1;
    let angle = |k: usize| (k as f64 + 0.5) * PI / n as f64;
    let values: Vec<f64> = (0..n).map(|k| f(0.5 * angle(k).cos())).collect();
    let mut powers = vec![0.0; n];
    let (mut below, mut here) = (vec![0.0; n], vec![0.0; n]);
    here[0] = 1.0;
    for order in 0..n {
        let scale = if order == 0 { 1.0 } else { 2.0 } / n as f64;
        let coefficient: f64 = (0..n).map(|k| scale * values[k] * (order as f64 * angle(k)).cos()).sum();
        for (power, t) in here.iter().enumerate() {
            powers[degree - power] += coefficient * t;
        }
        // T_{m+1}(x) = 2 x T_m - T_{m-1} with x = 2 s; T_1 = x.
        let factor = if order == 0 { 2.0 } else { 4.0 };
        let mut above: Vec<f64> = below.iter().map(|b| if order == 0 { 0.0 } else { -b }).collect();
        for power in 1..n {
            above[power] += factor * here[power - 1];
        }
        (below, here) = (here, above);
    }
    powers
}

/// `exp(-x) I0(x)` by the trapezoidal rule on `I0(x) = 1/pi integral_0^pi exp(x cos t) dt`, which converges faster than any
/// power for a periodic integrand.
fn i0_scaled(x: f64) -> f64 {
    let n = 48 + (4.0 * x.sqrt()) as usize;
    (0..n).map(|k| (x * (((k as f64 + 0.5) * PI / n as f64).cos() - 1.0)).exp()).sum::<f64>() / n as f64
}
