//! Motion along a line: the profile depends only on the cosine of the angle between direction and line.
//!
//! A one-dimensional NUFFT turns the samples into a table over that cosine: samples are spread onto a row of cells, and the
//! row is transformed. Each direction is interpolated from `W` cells instead of the `W^2` of a plane. All directions of a
//! cone about the line share one value, among them a bearing and its mirror.

use std::sync::Arc;

use fearless_simd::{Level, Simd, SimdBase, SimdFloat};
use num_complex::Complex;
use rustfft::Fft;

use crate::evaluate::{Batch, Buffers, carry, narrow};
use crate::fft::Ffts;
use crate::kernel::Kernel;
use crate::nufft::CARRY;
use crate::setting::{Axis, Setting, locate};
use crate::simd::{Real, Tier, V, on_tier};

/// A planned transform for samples within an extent along a line, and for cosines.
pub struct Cone<T: Real> {
    level: Level,
    setting: Setting,
    /// Positions along the line.
    pub axis: Axis,
    /// Weights of a sample or target: the kernel's width, zero-padded so that vectors of any width fit.
    stride: usize,
    /// Per degree, highest first, the coefficients of `stride` weights.
    polynomials: Vec<f64>,
    /// Corrects the second kernel at a cell, and rotates by half a period so that cosine 0 is in the middle.
    correct: Vec<T>,
    fft: Arc<dyn Fft<T>>,
    /// First cell of each target.
    first: Vec<u32>,
    /// `stride` weights of each target, with the first kernel's correction.
    weights: Vec<T>,
}

/// Extra cells of a row that take the padding of the weights.
const SPARE: usize = 16;

impl<T: Real> Cone<T> {
    /// For samples within `extent` turns of the middle and directions at `cosines` to the line.
    pub fn new(extent: f64, setting: Setting, cosines: impl Iterator<Item = f64>, ffts: &mut Ffts<T>) -> Self {
        let axis = Axis::new(extent, setting);
        let kernel = Kernel::new(setting.width, setting.oversampling);
        let stride = setting.width.next_multiple_of(8);
        let mut polynomials = kernel.polynomials(setting.width + if setting.width < 12 { 4 } else { 5 });
        polynomials.iter_mut().for_each(|row| row.resize(stride, 0.0));
        let polynomials = polynomials.concat();
        let correct = (0..=2 * axis.half).map(|i| {
            let k = i as f64 - axis.half as f64;
            let sign = if (i + axis.half).is_multiple_of(2) { 1.0 } else { -1.0 };
            T::of(sign / kernel.transform(k / axis.n as f64))
        });
        let wide = ffts.tier() == Tier::Avx512 && stride * size_of::<T>() < 64;
        let level = if wide { Tier::Avx2 } else { ffts.tier() }.level_or_portable();
        let (correct, fft) = (correct.collect(), ffts.forward(axis.n));
        let (first, weights) = (Vec::new(), Vec::new());
        let mut cone = Self { level, setting, axis, stride, polynomials, correct, fft, first, weights };
        for u in cosines {
            cone.aim(u, &kernel);
        }
        cone
    }

    /// Plans one target.
    fn aim(&mut self, u: f64, kernel: &Kernel) {
        let w = self.setting.width;
        let (first, s) = self.axis.locate(u, w);
        let first = (first + (self.axis.n / 2) as isize).clamp(0, (self.axis.n - w) as isize);
        self.first.push(first as u32);
        let undo = 1.0 / kernel.transform(u / self.axis.per_turn);
        if self.stride == 8 {
            self.weights.extend(self.at_offset::<8>(s).map(|weight| T::of(weight * undo)));
        } else {
            self.weights.extend(self.at_offset::<16>(s).map(|weight| T::of(weight * undo)));
        }
    }

    /// Kernel weights at an offset.
    #[inline(always)]
    fn at_offset<const STRIDE: usize>(&self, s: f64) -> [f64; STRIDE] {
        let mut weights = [0.0; STRIDE];
        for row in self.polynomials.as_chunks::<STRIDE>().0 {
            for (v, c) in weights.iter_mut().zip(row) {
                *v = *v * s + c;
            }
        }
        weights
    }

    /// Number of targets.
    #[must_use]
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.first.len()
    }

    /// Memory of the plan, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.first[..]) + size_of_val(&self.weights[..])
    }

    /// Computes `buffers.values`, one per target.
    pub fn run(&self, batch: &Batch, buffers: &mut Buffers<T>) {
        if self.stride == 8 {
            on_tier!(self.level, simd => self.run_simd::<_, 8>(simd, batch, buffers));
        } else {
            on_tier!(self.level, simd => self.run_simd::<_, 16>(simd, batch, buffers));
        }
    }

    #[inline(always)]
    fn run_simd<S: Simd, const STRIDE: usize>(&self, simd: S, batch: &Batch, buffers: &mut Buffers<T>) {
        let zero = Complex::new(T::of(0.0), T::of(0.0));
        let cells = &mut buffers.cells;
        cells.clear();
        cells.resize(self.correct.len() + SPARE, zero);
        let mut carried = Vec::new();
        let n = batch.re.len();
        for from in (0..n).step_by(CARRY) {
            self.spread::<STRIDE>(batch, from..(from + CARRY).min(n), cells);
            if n > CARRY {
                carried.resize(cells.len(), Complex::new(0.0, 0.0));
                carry(cells, &mut carried);
            }
        }
        if n > CARRY {
            narrow(&carried, cells);
        }
        self.transform(&buffers.cells, &mut buffers.work.plane);
        let [re, im, ..] = &mut buffers.column;
        re.clear();
        im.clear();
        re.extend(buffers.work.plane.iter().map(|c| c.re));
        im.extend(buffers.work.plane.iter().map(|c| c.im));
        re.resize(self.axis.n + SPARE, T::of(0.0));
        im.resize(self.axis.n + SPARE, T::of(0.0));
        buffers.values.resize(self.len(), zero);
        self.interpolate::<S, STRIDE>(simd, re, im, &mut buffers.values);
    }

    /// From cells to a table over the cosine, 0 in the middle.
    fn transform(&self, cells: &[Complex<T>], table: &mut Vec<Complex<T>>) {
        let n = self.axis.n;
        table.clear();
        table.resize(n, Complex::new(T::of(0.0), T::of(0.0)));
        for (i, (cell, factor)) in cells.iter().zip(&self.correct).enumerate() {
            table[(n + i - self.axis.half) % n] = cell * factor;
        }
        self.fft.process(table);
    }

    /// Adds samples to the cells.
    #[inline(always)]
    fn spread<const STRIDE: usize>(&self, batch: &Batch, range: std::ops::Range<usize>, cells: &mut [Complex<T>]) {
        for t in range {
            let (first, s) = locate(batch.x[t] * self.axis.per_turn, self.setting.width);
            let from = (first + self.axis.half as isize) as usize;
            let weights = self.at_offset::<STRIDE>(s);
            let (re, im) = (batch.re[t], batch.im[t]);
            for (cell, weight) in cells[from..from + STRIDE].iter_mut().zip(weights) {
                cell.re += T::of(weight * re);
                cell.im += T::of(weight * im);
            }
        }
    }

    #[inline(always)]
    fn interpolate<S: Simd, const STRIDE: usize>(&self, simd: S, re: &[T], im: &[T], values: &mut [Complex<T>]) {
        let lanes = V::<S, T>::LEN;
        let zero = V::<S, T>::splat(simd, T::of(0.0));
        for ((value, &first), weights) in values.iter_mut().zip(&self.first).zip(self.weights.chunks_exact(STRIDE)) {
            let (re, im) = (&re[first as usize..][..STRIDE], &im[first as usize..][..STRIDE]);
            let (mut a, mut b) = (zero, zero);
            for k in (0..STRIDE).step_by(lanes) {
                let weight = V::<S, T>::from_slice(simd, &weights[k..k + lanes]);
                a = weight.mul_add(V::<S, T>::from_slice(simd, &re[k..k + lanes]), a);
                b = weight.mul_add(V::<S, T>::from_slice(simd, &im[k..k + lanes]), b);
            }
            *value = Complex::new(sum(a.as_slice()), sum(b.as_slice()));
        }
    }
}

/// The sum of a vector's values, by halves.
#[inline(always)]
fn sum<T: Real>(values: &[T]) -> T {
    let mut halves = [T::of(0.0); 16];
    let mut width = values.len();
    halves[..width].copy_from_slice(values);
    while width > 1 {
        width /= 2;
        for i in 0..width {
            halves[i] += halves[width + i];
        }
    }
    halves[0]
}
