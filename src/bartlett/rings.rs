//! From band-limited rings to a full grid: Fourier interpolation in azimuth, trigonometric matrices in elevation.
//!
//! Along azimuth `f` has modes up to the band limit `M`; rings are evaluated at `d >= 2 M + 2` azimuths and the grid's
//! `n = r d` follow by shifting with FFTs. Along a great circle over the zenith the same limit holds. With
//! `E(a) = (f(a) + f(a + pi)) / 2` and `O(a) = (f(a) - f(a + pi)) / 2`, `f(a + pi, pi - e) = f(a, e)` leaves to `E` only even
//! cosines and odd sines of the elevation and to `O` only odd cosines and even sines; level motion has no sines. So a
//! quarter of a great circle at `K >= (M + 1) / 2` intervals holds it all, and a small matrix takes it to any
//! elevations, exactly.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::sync::Arc;

use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch};
use num_complex::Complex;
use rustfft::Fft;

use super::fft::Ffts;
use super::simd::{Real, V};

/// Which elevations a ring grid is evaluated at, and which rows come of it.
pub(crate) struct Rings<T: Real> {
    level: Level,
    /// Evaluated azimuths per ring, from -pi.
    pub d: usize,
    /// Azimuths of the grid.
    n: usize,
    /// Elevations (at least 0) that are evaluated; with `tall` also their negatives.
    pub nodes: Vec<f64>,
    pub tall: bool,
    /// Rows of the grid for each different |elevation|.
    rows: Vec<Row>,
    /// Per |elevation|, per node: weights of even and odd azimuth harmonics, cosines then (tall) sines; none if the
    /// nodes are the |elevation|s themselves.
    matrix: Option<Vec<T>>,
    forward: Option<Arc<dyn Fft<T>>>,
    inverse: Option<Arc<dyn Fft<T>>>,
    /// `[r - 1][d]` factors that shift by a fraction of a step.
    shifts: Vec<Complex<T>>,
}

/// Rows of the grid at `elevation` and at `-elevation`.
#[derive(Clone, Debug)]
struct Row {
    elevation: f64,
    all: Vec<usize>,
    above: Vec<usize>,
    below: Vec<usize>,
}

/// Buffers, reused.
#[derive(Clone, Default)]
pub(crate) struct RingWork<T> {
    line: Vec<T>,
    spectrum: Vec<Complex<T>>,
    modes: Vec<Complex<T>>,
    scratch: Vec<Complex<T>>,
    /// Per node `[component][re, im][n / 2]`.
    split: Vec<T>,
}

/// The least divisor of `n` that holds `2 order + 2` azimuths and is a multiple of 4; `n` itself if there is none.
pub(crate) fn azimuths_for(n: usize, order: usize) -> usize {
    (1..=n).find(|d| n % d == 0 && d % 4 == 0 && *d >= 2 * order + 2).unwrap_or(n)
}

impl<T: Real> Rings<T> {
    /// For `n` azimuths (a multiple of 4) at `elevations`; `order` limits the modes (none: no interpolation).
    pub fn new(n: usize, elevations: &[f64], order: [usize; 2], tall: bool, level: Level, ffts: &mut Ffts<T>) -> Self {
        let d = azimuths_for(n, order[0]);
        let rows = rows_of(elevations);
        let intervals = (order[1] + 2) / 2;
        let interpolate = intervals + 1 < rows.len();
        let nodes: Vec<f64> = if interpolate {
            (0..=intervals).map(|i| FRAC_PI_2 * i as f64 / intervals as f64).collect()
        } else {
            rows.iter().map(|r| r.elevation).collect()
        };
        let matrix = interpolate.then(|| matrix(&rows, intervals, tall));
        let resample = d < n;
        let shifts = (1..n / d).flat_map(|k| (0..d).map(move |i| shift(i, d, k, n))).collect();
        Self {
            level,
            d,
            n,
            nodes,
            tall,
            rows,
            matrix,
            forward: resample.then(|| ffts.forward(d)),
            inverse: resample.then(|| ffts.inverse(d)),
            shifts,
        }
    }

    /// Number of rings that are evaluated, those below the horizon included.
    pub fn rings(&self) -> usize {
        self.nodes.len() * if self.tall { 2 } else { 1 }
    }

    /// Fills `out` (the grid, row by row) with `|f|^2 * scale` from the rings: `[node][above, (tall) below][d]`.
    pub fn powers(&self, rings: &mut [Complex<T>], scale: f64, work: &mut RingWork<T>, out: &mut [f64]) {
        dispatch!(self.level, simd => self.run(simd, rings, work, #[inline(always)] |rows: &[usize], re: &[T], im: &[T]| {
            let Some((&first, others)) = rows.split_first() else { return };
            let line = &mut out[first * self.n..(first + 1) * self.n];
            for ((out, re), im) in line.iter_mut().zip(re).zip(im) {
                let power: f64 = (*re * *re + *im * *im).into();
                *out = power * scale;
            }
            for row in others {
                out.copy_within(first * self.n..(first + 1) * self.n, row * self.n);
            }
        }));
    }

    /// Fills `out` with `f` itself.
    pub fn values(&self, rings: &mut [Complex<T>], work: &mut RingWork<T>, out: &mut [Complex<T>]) {
        dispatch!(self.level, simd => self.run(simd, rings, work, #[inline(always)] |rows: &[usize], re: &[T], im: &[T]| {
            for row in rows {
                let line = &mut out[row * self.n..(row + 1) * self.n];
                for ((out, re), im) in line.iter_mut().zip(re).zip(im) {
                    *out = Complex::new(*re, *im);
                }
            }
        }));
    }

    /// Resamples the rings and hands each finished row to `emit`: which rows of the grid it is, real and imaginary
    /// parts.
    #[inline(always)]
    fn run<S: Simd>(
        &self,
        simd: S,
        rings: &mut [Complex<T>],
        work: &mut RingWork<T>,
        mut emit: impl FnMut(&[usize], &[T], &[T]),
    ) {
        self.shifted(rings, work);
        self.split(rings, work);
        work.line.resize(4 * self.n, T::of(0.0));
        match (&self.matrix, self.tall) {
            (None, _) => self.rows_as_they_are(work, &mut emit),
            (Some(matrix), false) => {
                for (weights, row) in matrix.chunks_exact(2 * self.nodes.len()).zip(&self.rows) {
                    let (line, _) = work.line.split_at_mut(2 * self.n);
                    self.combine::<S, false>(simd, weights, &work.split, line);
                    let (re, im) = line.split_at(self.n);
                    emit(&row.all, re, im);
                }
            }
            (Some(matrix), true) => {
                for (weights, row) in matrix.chunks_exact(4 * self.nodes.len()).zip(&self.rows) {
                    self.combine::<S, true>(simd, weights, &work.split, &mut work.line);
                    let (above, below) = work.line.split_at(2 * self.n);
                    emit(&row.above, &above[..self.n], &above[self.n..]);
                    emit(&row.below, &below[..self.n], &below[self.n..]);
                }
            }
        }
    }

    /// `work.modes`: per ring the `r - 1` shifted copies of its `d` samples.
    fn shifted(&self, rings: &[Complex<T>], work: &mut RingWork<T>) {
        let (Some(forward), Some(inverse)) = (&self.forward, &self.inverse) else { return };
        let (d, copies) = (self.d, self.n / self.d - 1);
        let zero = Complex::new(T::of(0.0), T::of(0.0));
        work.scratch.resize(forward.get_inplace_scratch_len().max(inverse.get_inplace_scratch_len()), zero);
        work.spectrum.resize(d, zero);
        work.modes.resize(rings.len() * copies, zero);
        for (ring, modes) in rings.chunks_exact(d).zip(work.modes.chunks_exact_mut(d * copies)) {
            work.spectrum.copy_from_slice(ring);
            forward.process_with_scratch(&mut work.spectrum, &mut work.scratch);
            for (copy, shift) in modes.chunks_exact_mut(d).zip(self.shifts.chunks_exact(d)) {
                for ((out, c), s) in copy.iter_mut().zip(&work.spectrum).zip(shift) {
                    *out = c * s;
                }
            }
            inverse.process_with_scratch(modes, &mut work.scratch);
        }
    }

    /// Even and odd azimuth harmonics (and, tall, even and odd parts in elevation) of every ring, real and imaginary
    /// parts apart: `work.split[node][E, O (, E sine, O sine)][re, im][n / 2]`.
    #[inline(always)]
    fn split(&self, rings: &[Complex<T>], work: &mut RingWork<T>) {
        let (d, n, r) = (self.d, self.n, self.n / self.d);
        let (half, hd) = (n / 2, d / 2);
        work.split.resize(rings.len() / d * 2 * n, T::of(0.0));
        let a_half = T::of(0.5);
        for (index, (ring, out)) in rings.chunks_exact(d).zip(work.split.chunks_exact_mut(2 * n)).enumerate() {
            let (even, odd) = out.split_at_mut(n);
            let (even_re, even_im) = even.split_at_mut(half);
            let (odd_re, odd_im) = odd.split_at_mut(half);
            for k in 0..r {
                let line =
                    if k == 0 { ring } else { &work.modes[(index * (r - 1) + k - 1) * d..(index * (r - 1) + k) * d] };
                let (here, opposite) = line.split_at(hd);
                for (j, (a, b)) in here.iter().zip(opposite).enumerate() {
                    let to = j * r + k;
                    even_re[to] = (a.re + b.re) * a_half;
                    even_im[to] = (a.im + b.im) * a_half;
                    odd_re[to] = (a.re - b.re) * a_half;
                    odd_im[to] = (a.im - b.im) * a_half;
                }
            }
        }
        if self.tall && self.matrix.is_some() {
            for pair in work.split.chunks_exact_mut(4 * n) {
                let (above, below) = pair.split_at_mut(2 * n);
                for (a, b) in above.iter_mut().zip(below) {
                    (*a, *b) = ((*a + *b) * a_half, (*a - *b) * a_half);
                }
            }
        }
    }

    /// Rows whose elevations were evaluated.
    fn rows_as_they_are(&self, work: &mut RingWork<T>, emit: &mut impl FnMut(&[usize], &[T], &[T])) {
        let (n, half) = (self.n, self.n / 2);
        let per_node = if self.tall { 2 } else { 1 };
        for (index, part) in work.split.chunks_exact(2 * n).enumerate() {
            let (re, rest) = work.line.split_at_mut(n);
            for i in 0..half {
                re[i] = part[i] + part[n + i];
                re[half + i] = part[i] - part[n + i];
                rest[i] = part[half + i] + part[n + half + i];
                rest[half + i] = part[half + i] - part[n + half + i];
            }
            let row = &self.rows[index / per_node];
            let rows = if !self.tall {
                &row.all
            } else if index % 2 == 0 {
                &row.above
            } else {
                &row.below
            };
            emit(rows, re, &rest[..n]);
        }
    }

    /// One |elevation| from all nodes: `line` gets re and im above, then (tall) below.
    #[inline(always)]
    fn combine<S: Simd, const TALL: bool>(&self, simd: S, weights: &[T], split: &[T], line: &mut [T]) {
        let lanes = V::<S, T>::LEN;
        let (n, half) = (self.n, self.n / 2);
        let per_node = if TALL { 4 * n } else { 2 * n };
        let mut from = 0;
        while from < half {
            // The last vector may overlap the one before it.
            let at = if from + lanes <= half { from } else { half.saturating_sub(lanes) };
            let sums = self.column::<S, TALL>(simd, weights, split, per_node, at);
            let mut put = |offset: usize, v: V<S, T>| {
                if half >= lanes {
                    v.store_slice(&mut line[offset + at..][..lanes]);
                } else {
                    line[offset..offset + half].copy_from_slice(&v.as_slice()[..half]);
                }
            };
            for part in 0..2 {
                let (e, o) = (sums[part], sums[2 + part]);
                if TALL {
                    let (es, os) = (sums[4 + part], sums[6 + part]);
                    let (above, below) = ([e + es, o + os], [e - es, o - os]);
                    put(part * n, above[0] + above[1]);
                    put(part * n + half, above[0] - above[1]);
                    put(2 * n + part * n, below[0] + below[1]);
                    put(2 * n + part * n + half, below[0] - below[1]);
                } else {
                    put(part * n, e + o);
                    put(part * n + half, e - o);
                }
            }
            from += lanes;
        }
    }

    /// Sums over the nodes for one vector of azimuths: E re, E im, O re, O im and (tall) the same of the sines.
    #[inline(always)]
    fn column<S: Simd, const TALL: bool>(
        &self,
        simd: S,
        weights: &[T],
        split: &[T],
        per_node: usize,
        at: usize,
    ) -> [V<S, T>; 8] {
        let (lanes, half) = (V::<S, T>::LEN, self.n / 2);
        let parts = if TALL { 4 } else { 2 };
        let mut sums = [V::<S, T>::splat(simd, T::of(0.0)); 8];
        for (node, w) in split.chunks_exact(per_node).zip(weights.chunks_exact(parts)) {
            for part in 0..parts {
                let w = V::<S, T>::splat(simd, w[part]);
                for c in 0..2 {
                    let offset = (2 * part + c) * half + at;
                    let values = if half >= lanes {
                        V::<S, T>::from_slice(simd, &node[offset..offset + lanes])
                    } else {
                        V::<S, T>::from_fn(simd, |i| node[offset + i.min(half - 1)])
                    };
                    sums[2 * part + c] = w.mul_add(values, sums[2 * part + c]);
                }
            }
        }
        sums
    }
}

/// The factor of mode `i` (of `d`) that shifts by `k / n` of a circle, with the inverse transform's `1 / d`.
fn shift<T: Real>(i: usize, d: usize, k: usize, n: usize) -> Complex<T> {
    let mode = if 2 * i < d { i as f64 } else { i as f64 - d as f64 };
    let (sin, cos) = (TAU * mode * k as f64 / n as f64).sin_cos();
    Complex::new(T::of(cos / d as f64), T::of(sin / d as f64))
}

/// Groups the rows of a grid by |elevation|.
fn rows_of(elevations: &[f64]) -> Vec<Row> {
    let mut rows: Vec<Row> = Vec::new();
    for (index, &e) in elevations.iter().enumerate() {
        let found = rows.iter().position(|r| (r.elevation - e.abs()).abs() < 1e-14);
        let row = found.unwrap_or_else(|| {
            rows.push(Row { elevation: e.abs(), all: vec![], above: vec![], below: vec![] });
            rows.len() - 1
        });
        rows[row].all.push(index);
        if e < 0.0 { rows[row].below.push(index) } else { rows[row].above.push(index) }
    }
    rows
}

/// Weights that take values at `intervals + 1` nodes of the quarter circle to the rows.
///
/// Each of the four families is orthogonal on the nodes (a discrete cosine or sine transform), so the weight of a node
/// is the sum over the family of its values at the row and at the node, over its norm.
fn matrix<T: Real>(rows: &[Row], intervals: usize, tall: bool) -> Vec<T> {
    let k = intervals;
    let node = |i: usize| FRAC_PI_2 * i as f64 / k as f64;
    let families = if tall { 4 } else { 2 };
    // The order of the split: even azimuth harmonics with cosines, odd with cosines, even with sines, odd with sines.
    let orders: [Vec<usize>; 4] = [
        (0..=k).map(|m| 2 * m).collect(),
        (0..k).map(|m| 2 * m + 1).collect(),
        (0..k).map(|m| 2 * m + 1).collect(),
        (1..k).map(|m| 2 * m).collect(),
    ];
    let basis = |family: usize, order: usize, e: f64| {
        let angle = order as f64 * e;
        if family < 2 { angle.cos() } else { angle.sin() }
    };
    let mut weights = vec![0.0; rows.len() * (k + 1) * families];
    for family in 0..families {
        for &order in &orders[family] {
            let at_nodes: Vec<f64> =
                (0..=k).map(|i| basis(family, order, node(i)) * if i == 0 || i == k { 0.5 } else { 1.0 }).collect();
            let norm: f64 = (0..=k).map(|i| at_nodes[i] * basis(family, order, node(i))).sum();
            for (r, row) in rows.iter().enumerate() {
                let here = basis(family, order, row.elevation) / norm;
                for i in 0..=k {
                    weights[(r * (k + 1) + i) * families + family] += here * at_nodes[i];
                }
            }
        }
    }
    weights.into_iter().map(T::of).collect()
}
