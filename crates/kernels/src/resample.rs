//! Resamples band-limited rings to more azimuths with two FFTs.

use std::sync::Arc;

use num_complex::Complex;
use rustfft::Fft;

use crate::fft::{Ffts, near_size};
use crate::simd::Real;

/// Resamples `d` values around a circle to `n`.
pub struct Resample<T: Real> {
    d: usize,
    n: usize,
    forward: Arc<dyn Fft<T>>,
    inverse: Arc<dyn Fft<T>>,
}

/// Buffers, reused.
#[derive(Clone, Default)]
pub struct ResampleWork<T> {
    spectra: Vec<Complex<T>>,
    scratch: Vec<Complex<T>>,
    /// `[ring][n]`.
    pub dense: Vec<Complex<T>>,
}

/// Number of azimuths to evaluate for a grid of `n` (a multiple of 4) and modes up to `order`: a multiple of 4 with a fast
/// FFT, or `n` if that would save little.
pub fn azimuths_for(n: usize, order: usize) -> usize {
    let d = near_size(2 * order.min(n) + 2, 4);
    if 20 * d > 17 * n { n } else { d }
}

impl<T: Real> Resample<T> {
    /// From `d` azimuths to `n` on every ring.
    pub fn new(d: usize, n: usize, ffts: &mut Ffts<T>) -> Self {
        Self { d, n, forward: ffts.forward(d), inverse: ffts.inverse(n) }
    }

    /// Fills `work.dense`.
    pub fn run(&self, rings: &[Complex<T>], work: &mut ResampleWork<T>) {
        let (d, n) = (self.d, self.n);
        let zero = Complex::new(T::of(0.0), T::of(0.0));
        let count = rings.len() / d;
        work.scratch.resize(self.forward.get_inplace_scratch_len().max(self.inverse.get_inplace_scratch_len()), zero);
        work.spectra.clear();
        work.spectra.extend_from_slice(rings);
        self.forward.process_with_scratch(&mut work.spectra, &mut work.scratch);
        work.dense.clear();
        work.dense.resize(count * n, zero);
        let scale = T::of(1.0 / d as f64);
        for (spectrum, dense) in work.spectra.chunks_exact(d).zip(work.dense.chunks_exact_mut(n)) {
            let (positive, negative) = spectrum.split_at(d.div_ceil(2));
            for (to, mode) in dense.iter_mut().zip(positive) {
                *to = mode * scale;
            }
            for (to, mode) in dense[n - negative.len()..].iter_mut().zip(negative) {
                *to = mode * scale;
            }
        }
        self.inverse.process_with_scratch(&mut work.dense, &mut work.scratch);
    }
}
