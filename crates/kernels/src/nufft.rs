//! A two-dimensional NUFFT from samples anywhere to directions anywhere ("type 3"), for motion in a plane \[dutt-rokhlin1993\]
//! \[finufft2019\].
//!
//! Samples are spread onto a grid of positions, which is transformed to a grid of direction cosines, from which the wanted
//! directions are interpolated. Each of the two kernels is corrected where it acts: the first divides the results, the second
//! the grid of positions. Work: `W^2` per sample and per direction plus one pruned FFT, whatever their number.

use std::sync::Arc;

use fearless_simd::{Level, Simd, SimdBase, SimdFloat};
use num_complex::Complex;
use rustfft::Fft;

use crate::fft::Ffts;
use crate::kernel::Kernel;
use crate::setting::{Axis, Setting, locate};
use crate::simd::{Real, Tier, V, on_tier};

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
