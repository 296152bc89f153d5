//! Non-uniform Fourier transforms: a two-dimensional one from samples anywhere to directions anywhere ("type 3"), for motion in a
//! plane \[dutt-rokhlin1993\] \[finufft2019\] ([`Nufft`]), and a one-dimensional one for motion along a line ([`Cone`]).
//!
//! Samples are spread onto a grid of positions, which is transformed to a grid of direction cosines, from which the wanted
//! directions are interpolated. Each of the two kernels is corrected where it acts: the first divides the results, the second
//! the grid of positions. Work: `W^2` per sample and per direction plus one pruned FFT, whatever their number.
//!
//! The kernel is Kaiser and Bessel's \[beatty2005\]: values, Fourier transform, piecewise polynomials \[finufft2019\], and error
//! ([`Kernel`]); [`Setting`] is its width and oversampling for a tolerance, [`Axis`] the grid of one dimension.
//!
//! Along a line the profile depends only on the cosine of the angle between direction and line, so samples are spread onto a row of
//! cells, and the row is transformed to a table over that cosine. Each direction is interpolated from `W` cells instead of the
//! `W^2` of a plane. All directions of a cone about the line share one value, among them a bearing and its mirror.

use crate::evaluate::{Batch, Buffers, carry, narrow};
use crate::fft::Ffts;
use crate::simd::{Real, Tier, V, on_tier};
use fearless_simd::{Level, Simd, SimdBase, SimdFloat};
use num_complex::Complex;
use rustfft::Fft;
use std::f64::consts::PI;
use std::sync::Arc;

/// Samples after which single-precision cells are added to double: keeps the relative error of a cell below 1e-6, however
/// long the robot stands still.
pub const CARRY: usize = 4_096;

/// A planned transform for samples within a box.
pub struct Nufft<T: Real> {
    /// Window and oversampling.
    pub setting: Setting,
    /// First axis.
    pub x: Axis,
    /// Second axis.
    pub y: Axis,
    level: Level,
    kernel: Kernel,
    /// `[degree + 1][width]`, in double, for the directions.
    exact: Vec<f64>,
    /// `[degree + 1][2 width]`, each weight twice, for the samples.
    twice: Vec<T>,
    correct_x: Vec<T>,
    correct_y: Vec<T>,
    fft_x: Arc<dyn Fft<T>>,
    fft_y: Arc<dyn Fft<T>>,
    /// Columns of the first transform that directions can touch.
    first: usize,
    columns: usize,
}

/// Buffers of a transform, reused from call to call.
#[derive(Clone, Default)]
pub struct Work<T> {
    rows: Vec<Complex<T>>,
    pub(crate) plane: Vec<Complex<T>>,
    scratch: Vec<Complex<T>>,
}

/// Directions prepared for interpolation.
#[derive(Clone, Default)]
pub struct Targets<T> {
    /// First row and column of each; for a quadruple: (row, mirrored row, column, mirrored column).
    cells: Vec<[u32; 4]>,
    /// Per entry `width` row weights (with the first kernel's correction), `2 width` doubled column weights and, for quadruples,
    /// the reversed ones.
    weights: Vec<T>,
    quads: bool,
}

impl<T> Targets<T> {
    /// Memory, bytes.
    pub fn bytes(&self) -> usize {
        self.cells.len() * 16 + self.weights.len() * size_of::<T>()
    }
}

impl<T: Real> Nufft<T> {
    /// Plans for samples within `extent` turns of the middle in x and y.
    pub fn new(extent: [f64; 2], setting: Setting, ffts: &mut Ffts<T>) -> Self {
        let [x, y] = extent.map(|e| Axis::new(e, setting));
        let kernel = Kernel::new(setting.width, setting.oversampling);
        let degree = setting.width + if setting.width < 12 { 4 } else { 5 };
        let exact = kernel.polynomials(degree).concat();
        let twice = exact.iter().flat_map(|w| [T::of(*w); 2]).collect();
        // Corrects the second kernel at a cell, and rotates by half a period so that direction 0 is in the middle.
        let correct = |axis: &Axis| {
            (0..axis.support())
                .map(|i| {
                    let k = i as f64 - axis.half as f64;
                    let sign = if (i + axis.half).is_multiple_of(2) { 1.0 } else { -1.0 };
                    T::of(sign / kernel.transform(k / axis.n as f64))
                })
                .collect()
        };
        let reach = (x.n as f64 / (2.0 * setting.oversampling)).ceil() as usize + setting.width / 2 + 1;
        let first = (x.n / 2).saturating_sub(reach);
        let columns = (x.n / 2 + reach + 1).min(x.n) - first;
        let tier = ffts.tier();
        // A kernel row of `2 width` numbers must hold a whole vector.
        let wide = tier == Tier::Avx512 && 2 * setting.width * size_of::<T>() < 64;
        let level = if wide { Tier::Avx2 } else { tier }.level_or_portable();
        Self {
            setting,
            level,
            kernel,
            exact,
            twice,
            correct_x: correct(&x),
            correct_y: correct(&y),
            fft_x: ffts.forward(x.n),
            fft_y: ffts.forward(y.n),
            first,
            columns,
            x,
            y,
        }
    }

    /// Number of cells of the grid of positions.
    pub fn cells(&self) -> usize {
        self.x.support() * self.y.support()
    }

    /// Number of cells of the transformed plane.
    pub fn plane(&self) -> usize {
        self.columns * self.y.n
    }

    /// Adds samples (positions in turns about the middle) to a grid of [`Nufft::cells`] cells.
    ///
    /// Several columns of values at the same positions, one after the other in `re` and `im`, go to as many grids, one after the
    /// other in `cells`; they share the kernel's weights.
    pub fn spread(&self, at: [&[f64]; 2], re: &[T], im: &[T], cells: &mut [Complex<T>]) {
        let width = self.setting.width;
        // Narrow kernels exist only in single precision, wide ones only in double.
        if const { size_of::<T>() == 4 } {
            if width == 4 {
                on_tier!(self.level, simd => self.spread_simd::<_, 4>(simd, at, re, im, cells));
            } else {
                on_tier!(self.level, simd => self.spread_simd::<_, 8>(simd, at, re, im, cells));
            }
        } else if width == 8 {
            on_tier!(self.level, simd => self.spread_simd::<_, 8>(simd, at, re, im, cells));
        } else if width == 12 {
            on_tier!(self.level, simd => self.spread_simd::<_, 12>(simd, at, re, im, cells));
        } else {
            on_tier!(self.level, simd => self.spread_simd::<_, 16>(simd, at, re, im, cells));
        }
    }

    #[inline(always)]
    fn spread_simd<S: Simd, const W: usize>(
        &self,
        simd: S,
        at: [&[f64]; 2],
        re: &[T],
        im: &[T],
        cells: &mut [Complex<T>],
    ) {
        let lanes = V::<S, T>::LEN;
        let stride = self.x.support();
        let cells: &mut [T] = bytemuck::cast_slice_mut(cells);
        let zero = [[T::of(0.0); W]; 2];
        let (mut wx, mut wy, mut product) = (zero, zero, zero);
        let count = at[0].len();
        for t in 0..count {
            let (first_x, sx) = locate(at[0][t] * self.x.per_turn, W);
            let (first_y, sy) = locate(at[1][t] * self.y.per_turn, W);
            self.weights::<S, W>(simd, sx, &mut wx);
            self.weights::<S, W>(simd, sy, &mut wy);
            let column = (first_x + self.x.half as isize) as usize;
            let row = (first_y + self.y.half as isize) as usize;
            let (wx, wy) = (wx.as_flattened(), wy.as_flattened());
            let columns = re.chunks_exact(count).zip(im.chunks_exact(count));
            for ((re, im), cells) in columns.zip(cells.chunks_exact_mut(2 * self.cells())) {
                let z = V::<S, T>::from_fn(simd, |i| if i % 2 == 0 { re[t] } else { im[t] });
                for (to, w) in product.as_flattened_mut().chunks_exact_mut(lanes).zip(wx.chunks_exact(lanes)) {
                    (V::<S, T>::from_slice(simd, w) * z).store_slice(to);
                }
                for j in 0..W {
                    let from = 2 * ((row + j) * stride + column);
                    let weight = V::<S, T>::splat(simd, wy[2 * j]);
                    let line = cells[from..from + 2 * W].chunks_exact_mut(lanes);
                    for (cell, w) in line.zip(product.as_flattened().chunks_exact(lanes)) {
                        let sum = weight.mul_add(V::<S, T>::from_slice(simd, w), V::<S, T>::from_slice(simd, cell));
                        sum.store_slice(cell);
                    }
                }
            }
        }
    }

    /// Kernel weights at offset `s`, each twice.
    #[inline(always)]
    fn weights<S: Simd, const W: usize>(&self, simd: S, s: f64, out: &mut [[T; W]; 2]) {
        let lanes = V::<S, T>::LEN;
        let s = V::<S, T>::splat(simd, T::of(s));
        let out = out.as_flattened_mut();
        for (k, chunk) in out.chunks_exact_mut(lanes).enumerate() {
            let mut value = V::<S, T>::from_slice(simd, &self.twice[k * lanes..(k + 1) * lanes]);
            for power in self.twice.chunks_exact(2 * W).skip(1) {
                value = value.mul_add(s, V::<S, T>::from_slice(simd, &power[k * lanes..(k + 1) * lanes]));
            }
            value.store_slice(chunk);
        }
    }

    /// Transforms a spread grid into `work.plane`: `[column][ny]`, direction cosines rising, 0 in the middle.
    pub fn transform(&self, cells: &[Complex<T>], work: &mut Work<T>) {
        let (nx, ny, support) = (self.x.n, self.y.n, self.x.support());
        let zero = Complex::new(T::of(0.0), T::of(0.0));
        work.rows.clear();
        work.rows.resize(self.y.support() * nx, zero);
        for ((row, cells), &cy) in work.rows.chunks_exact_mut(nx).zip(cells.chunks_exact(support)).zip(&self.correct_y)
        {
            let corrected = cells.iter().zip(&self.correct_x).map(|(c, &cx)| c * (cx * cy));
            // Cell k of -half..=half belongs at k modulo n.
            for (i, value) in corrected.enumerate() {
                let to = if i < self.x.half { nx + i - self.x.half } else { i - self.x.half };
                row[to] = value;
            }
        }
        let need = self.fft_x.get_inplace_scratch_len().max(self.fft_y.get_inplace_scratch_len());
        work.scratch.resize(need, zero);
        self.fft_x.process_with_scratch(&mut work.rows, &mut work.scratch);
        work.plane.clear();
        work.plane.resize(self.plane(), zero);
        self.transpose(&work.rows, &mut work.plane);
        self.fft_y.process_with_scratch(&mut work.plane, &mut work.scratch);
        debug_assert_eq!(work.plane.len(), self.columns * ny);
    }

    /// Copies rows of the first transform to columns of the second, eight at a time.
    fn transpose(&self, rows: &[Complex<T>], plane: &mut [Complex<T>]) {
        let (nx, ny, half) = (self.x.n, self.y.n, self.y.half);
        let support = self.y.support();
        for block in (0..support).step_by(8) {
            let end = (block + 8).min(support);
            for (column, line) in plane.chunks_exact_mut(ny).enumerate() {
                for i in block..end {
                    let to = if i < half { ny + i - half } else { i - half };
                    line[to] = rows[i * nx + self.first + column];
                }
            }
        }
    }

    /// The kernel's weight of the `j`-th cell from the first, at offset `s`.
    pub fn weight(&self, j: usize, s: f64) -> f64 {
        self.exact.chunks_exact(self.setting.width).fold(0.0, |v, row| v * s + row[j])
    }

    /// Kernel weights at offset `s`, in double.
    fn exact_weights(&self, s: f64, out: &mut [f64; 16]) {
        let w = self.setting.width;
        out.fill(0.0);
        for row in self.exact.chunks_exact(w) {
            for (v, c) in out.iter_mut().zip(row) {
                *v = *v * s + c;
            }
        }
    }

    fn target(&self, u: [f64; 2], quads: bool, targets: &mut Targets<T>) {
        let w = self.setting.width;
        let (row, sa) = self.x.locate(u[0], w);
        let (column, sb) = self.y.locate(u[1], w);
        let place = |first: isize, axis: &Axis, skip: usize| {
            (first + (axis.n / 2) as isize - skip as isize).clamp(0, (axis.n - w) as isize) as u32
        };
        let mirror = |first: isize| 1 - first - w as isize;
        targets.cells.push([
            place(row, &self.x, self.first),
            place(mirror(row), &self.x, self.first),
            place(column, &self.y, 0),
            place(mirror(column), &self.y, 0),
        ]);
        let undo =
            1.0 / (self.kernel.transform(u[0] / self.x.per_turn) * self.kernel.transform(u[1] / self.y.per_turn));
        let mut weights = [0.0; 16];
        self.exact_weights(sa, &mut weights);
        targets.weights.extend(weights[..w].iter().map(|a| T::of(a * undo)));
        self.exact_weights(sb, &mut weights);
        targets.weights.extend(weights[..w].iter().flat_map(|b| [T::of(*b); 2]));
        if quads {
            targets.weights.extend(weights[..w].iter().rev().flat_map(|b| [T::of(*b); 2]));
        }
    }

    /// Plans directions (their cosines along x and y).
    pub fn targets(&self, directions: impl Iterator<Item = [f64; 2]>) -> Targets<T> {
        let mut targets = Targets::default();
        for u in directions {
            self.target(u, false, &mut targets);
        }
        targets
    }

    /// Plans quadruples `(+-x, +-y)` of directions, each given by one of the four.
    pub fn quads(&self, directions: impl Iterator<Item = [f64; 2]>) -> Targets<T> {
        let mut targets = Targets { quads: true, ..Targets::default() };
        for u in directions {
            self.target(u, true, &mut targets);
        }
        targets
    }

    /// Values at planned directions; quadruples in the order `(x, y)`, `(-x, y)`, `(x, -y)`, `(-x, -y)`.
    pub fn interpolate(&self, plane: &[Complex<T>], targets: &Targets<T>, out: &mut Vec<Complex<T>>) {
        let count = targets.cells.len() * if targets.quads { 4 } else { 1 };
        out.resize(count, Complex::new(T::of(0.0), T::of(0.0)));
        let width = self.setting.width;
        // Narrow kernels exist only in single precision, wide ones only in double.
        if const { size_of::<T>() == 4 } {
            if width == 4 {
                on_tier!(self.level, simd => self.interpolate_simd::<_, 4>(simd, plane, targets, out));
            } else {
                on_tier!(self.level, simd => self.interpolate_simd::<_, 8>(simd, plane, targets, out));
            }
        } else if width == 8 {
            on_tier!(self.level, simd => self.interpolate_simd::<_, 8>(simd, plane, targets, out));
        } else if width == 12 {
            on_tier!(self.level, simd => self.interpolate_simd::<_, 12>(simd, plane, targets, out));
        } else {
            on_tier!(self.level, simd => self.interpolate_simd::<_, 16>(simd, plane, targets, out));
        }
    }

    #[inline(always)]
    fn interpolate_simd<S: Simd, const W: usize>(
        &self,
        simd: S,
        plane: &[Complex<T>],
        targets: &Targets<T>,
        out: &mut [Complex<T>],
    ) {
        let plane: &[T] = bytemuck::cast_slice(plane);
        let stride = 2 * self.y.n;
        let at = |row: u32, column: u32| &plane[row as usize * stride + 2 * column as usize..];
        if !targets.quads {
            for ((cells, w), out) in targets.cells.iter().zip(targets.weights.chunks_exact(3 * W)).zip(out) {
                let (a, b) = w.split_at(W);
                *out = gather::<S, T, W, false>(simd, at(cells[0], cells[2]), stride, a, b);
            }
            return;
        }
        let entries = targets.cells.iter().zip(targets.weights.chunks_exact(5 * W));
        for ((&[row, mirrored_row, column, mirrored_column], w), out) in entries.zip(out.chunks_exact_mut(4)) {
            let (a, rest) = w.split_at(W);
            let (b, reversed) = rest.split_at(2 * W);
            out[0] = gather::<S, T, W, false>(simd, at(row, column), stride, a, b);
            out[1] = gather::<S, T, W, true>(simd, at(mirrored_row, column), stride, a, b);
            out[2] = gather::<S, T, W, false>(simd, at(row, mirrored_column), stride, a, reversed);
            out[3] = gather::<S, T, W, true>(simd, at(mirrored_row, mirrored_column), stride, a, reversed);
        }
    }
}

/// Vectors that one pass over the rows accumulates.
const CHUNK: usize = 4;

/// One interpolated value: `W` rows (their weights reversed for a mirrored one) of `W` complex columns.
#[inline(always)]
fn gather<S: Simd, T: Real, const W: usize, const REVERSED: bool>(
    simd: S,
    plane: &[T],
    stride: usize,
    a: &[T],
    b: &[T],
) -> Complex<T> {
    let lanes = V::<S, T>::LEN;
    let vectors = 2 * W / lanes;
    let zero = V::<S, T>::splat(simd, T::of(0.0));
    let mut total = zero;
    let mut from = 0;
    while from < vectors {
        let here = CHUNK.min(vectors - from);
        let mut acc = [zero; CHUNK];
        for j in 0..W {
            let weight = V::<S, T>::splat(simd, a[if REVERSED { W - 1 - j } else { j }]);
            let row = &plane[j * stride + from * lanes..][..here * lanes];
            for (sum, cells) in acc.iter_mut().zip(row.chunks_exact(lanes)) {
                *sum = weight.mul_add(V::<S, T>::from_slice(simd, cells), *sum);
            }
        }
        for (sum, w) in acc.iter().zip(b[from * lanes..][..here * lanes].chunks_exact(lanes)) {
            total = sum.mul_add(V::<S, T>::from_slice(simd, w), total);
        }
        from += CHUNK;
    }
    let (mut re, mut im) = (T::of(0.0), T::of(0.0));
    for pair in total.as_slice().chunks_exact(2) {
        re += pair[0];
        im += pair[1];
    }
    Complex::new(re, im)
}

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

/// Kernel width and oversampling, and the error they cause, relative to `sum |z|`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Cells that the window covers.
    pub width: usize,
    /// Cells per band limit.
    pub oversampling: f64,
    /// Error of both kernels in both dimensions, measured ([`Kernel::loss`]).
    pub loss: f64,
}

const fn setting(width: usize, oversampling: f64, loss: f64) -> Setting {
    Setting { width, oversampling, loss }
}

/// In order of cost.
const SETTINGS: [Setting; 10] = [
    setting(4, 2.0, 4.4e-3),
    setting(8, 1.5, 1.5e-5),
    setting(8, 1.75, 2.8e-6),
    setting(8, 2.0, 7.5e-7),
    setting(12, 1.5, 1.3e-8),
    setting(12, 1.75, 8e-10),
    setting(12, 2.0, 1.4e-10),
    setting(16, 1.5, 9.2e-12),
    setting(16, 1.75, 2.6e-13),
    setting(16, 2.0, 6e-14),
];

impl Setting {
    /// The cheapest setting with an error of at most `eps`, or `None`. Widths 4 and 8 exist in single precision, 8 to 16 in
    /// double.
    pub fn for_eps(eps: f64, single: bool) -> Option<Self> {
        let there = |width: usize| if single { width <= 8 } else { width >= 8 };
        SETTINGS.into_iter().find(|s| s.loss <= eps && there(s.width))
    }
}

/// One dimension of the transform.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Grid cells per turn of position.
    pub per_turn: f64,
    /// Cells on either side of the middle that samples reach.
    pub half: usize,
    /// FFT length.
    pub n: usize,
}

impl Axis {
    /// For positions within `extent` turns of the middle.
    pub fn new(extent: f64, setting: Setting) -> Self {
        let sigma = setting.oversampling;
        let per_turn = 2.0 * sigma;
        let half = (extent * per_turn + 0.5 * setting.width as f64).ceil() as usize;
        // The second kernel's band, and room beyond the largest direction cosine.
        let band = (2.0 * sigma * half as f64).ceil() as usize;
        let room = ((setting.width + 3) as f64 / (1.0 - 1.0 / sigma)).ceil() as usize;
        Self { per_turn, half, n: crate::fft::good_size(band.max(room)) }
    }

    /// Number of cells that samples reach.
    pub fn support(&self) -> usize {
        2 * self.half + 1
    }

    /// First cell that a direction cosine `u` touches, and the offset for the polynomials.
    pub fn locate(&self, u: f64, width: usize) -> (isize, f64) {
        locate(u * self.n as f64 / self.per_turn, width)
    }
}

/// First cell that position `x` (cells) touches, and the offset for the polynomials.
pub fn locate(x: f64, width: usize) -> (isize, f64) {
    let middle = (width as f64 - 1.0) / 2.0;
    let first = (x - middle).round_ties_even();
    (first as isize, x - first - middle)
}

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
