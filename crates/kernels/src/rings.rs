//! Expands band-limited rings to a full grid: Fourier interpolation in azimuth, trigonometric matrices in elevation.
//!
//! Along azimuth `f` has modes up to the band limit `M`; rings are evaluated at `d >= 2 M + 2` azimuths and resampled. The same
//! limit holds along a great circle through the zenith. With `E(a) = (f(a) + f(a + pi)) / 2` and
//! `O(a) = (f(a) - f(a + pi)) / 2`, the identity `f(a + pi, pi - e) = f(a, e)` leaves `E` only even cosines and odd sines of
//! the elevation, and `O` only odd cosines and even sines; level motion has no sines. So a quarter of a great circle at
//! `K >= (M + 1) / 2` intervals determines all of it, and a small matrix maps it exactly to any elevations. Rows of the grid
//! that are nodes need no matrix.

use crate::fft::{Ffts, near_size};
use crate::simd::{Real, V, on_tier};
use fearless_simd::{Level, Simd, SimdBase, SimdFloat};
use num_complex::Complex;
use rustfft::Fft;
use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

/// Half rings are padded to a multiple of this many values, so that vectors of any width fit.
const PAD: usize = 16;

/// The elevations at which a ring grid is evaluated, and the rows computed from them.
pub struct Rings<T: Real> {
    level: Level,
    /// Evaluated azimuths per ring, from -pi.
    pub d: usize,
    /// Azimuths of the grid.
    n: usize,
    /// Evaluated elevations (at least 0); with `tall` also their negatives.
    pub nodes: Vec<f64>,
    /// Whether the motion has heights: then rings below the horizon differ from those above.
    pub tall: bool,
    resample: Option<Resample<T>>,
    /// Rows that are nodes, with their node.
    given: Vec<(Row, usize)>,
    /// Rows that are not nodes.
    wanted: Vec<Row>,
    /// Per wanted row and node: weights of even and odd azimuth harmonics with cosines, then (tall) with sines.
    matrix: Vec<T>,
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
pub struct RingWork<T> {
    resample: ResampleWork<T>,
    /// Finished rows: re, re of the opposite azimuth, im, im of the opposite azimuth; above, then (tall) below.
    line: Vec<T>,
    /// Per node: even and odd azimuth harmonics (tall: also of the odd part in elevation), re and im separate.
    split: Vec<T>,
}

/// Elevations to evaluate per side for `rows` different ones and modes up to `order`: few, and including many of the rows.
pub fn nodes_for(elevations: &[f64], order: usize) -> Vec<f64> {
    let least = (order + 2) / 2;
    if least + 1 >= elevations.len() {
        return elevations.to_vec();
    }
    let nodes = |k: usize| (0..=k).map(move |i| FRAC_PI_2 * i as f64 / k as f64);
    let shared = |k: usize| elevations.iter().filter(|e| nodes(k).any(|n| (n - *e).abs() < 1e-12)).count();
    // Each wanted row costs about k, each node about as much as 8 rows.
    let cost = |k: usize| (elevations.len() - shared(k)) * k + 100 * k;
    let best = (least..=least + least / 8 + 1).min_by_key(|k| cost(*k)).unwrap_or(least);
    nodes(best).collect()
}

/// The distinct |elevations| of a list, rising.
pub fn distinct(elevations: &[f64]) -> Vec<f64> {
    rows_of(elevations).into_iter().map(|r| r.elevation).collect()
}

impl<T: Real> Rings<T> {
    /// For `n` azimuths (a multiple of 4) at `elevations`, with modes up to `order` in azimuth and elevation.
    pub fn new(n: usize, elevations: &[f64], order: [usize; 2], tall: bool, level: Level, ffts: &mut Ffts<T>) -> Self {
        let d = azimuths_for(n, order[0]);
        let nodes = nodes_for(&distinct(elevations), order[1]);
        let (mut given, mut wanted) = (Vec::new(), Vec::new());
        for row in rows_of(elevations) {
            match nodes.iter().position(|node| (node - row.elevation).abs() < 1e-12) {
                Some(node) => given.push((row, node)),
                None => wanted.push(row),
            }
        }
        let matrix = if wanted.is_empty() { Vec::new() } else { matrix(&wanted, nodes.len() - 1, tall) };
        let resample = (d < n).then(|| Resample::new(d, n, ffts));
        Self { level, d, n, nodes, tall, resample, given, wanted, matrix }
    }

    /// Number of evaluated rings, including those below the horizon.
    pub fn rings(&self) -> usize {
        self.nodes.len() * if self.tall { 2 } else { 1 }
    }

    /// Number of values of half a ring, padded.
    fn padded(&self) -> usize {
        (self.n / 2).next_multiple_of(PAD)
    }

    /// Fills `out` (the grid, row by row) with `|f|^2 * scale` from the rings: `[node][above, (tall) below][d]`.
    pub fn powers(&self, rings: &[Complex<T>], scale: f64, work: &mut RingWork<T>, out: &mut [f64]) {
        T::powers(self, rings, scale, work, out);
    }

    pub(crate) fn powers_of(&self, rings: &[Complex<T>], scale: f64, work: &mut RingWork<T>, out: &mut [f64]) {
        let (n, half) = (self.n, self.n / 2);
        self.resample(rings, work);
        on_tier!(self.level, simd => self.run(simd, rings, work, #[inline(always)] |rows: &[usize], line: &[T]| {
            let Some((&first, others)) = rows.split_first() else { return };
            let (re, im) = line.split_at(line.len() / 2);
            let pad = re.len() / 2;
            let (here, opposite) = out[first * n..(first + 1) * n].split_at_mut(half);
            for (side, out) in [here, opposite].into_iter().enumerate() {
                let (re, im) = (&re[side * pad..][..half], &im[side * pad..][..half]);
                for ((out, re), im) in out.iter_mut().zip(re).zip(im) {
                    let power: f64 = (*re * *re + *im * *im).into();
                    *out = power * scale;
                }
            }
            for row in others {
                out.copy_within(first * n..(first + 1) * n, row * n);
            }
        }));
    }

    /// Fills `out` with `f` itself.
    pub fn values(&self, rings: &[Complex<T>], work: &mut RingWork<T>, out: &mut [Complex<T>]) {
        T::values(self, rings, work, out);
    }

    pub(crate) fn values_of(&self, rings: &[Complex<T>], work: &mut RingWork<T>, out: &mut [Complex<T>]) {
        let (n, half) = (self.n, self.n / 2);
        self.resample(rings, work);
        on_tier!(self.level, simd => self.run(simd, rings, work, #[inline(always)] |rows: &[usize], line: &[T]| {
            let pad = line.len() / 4;
            for row in rows {
                for j in 0..n {
                    let at = if j < half { j } else { pad + j - half };
                    out[row * n + j] = Complex::new(line[at], line[2 * pad + at]);
                }
            }
        }));
    }

    fn resample(&self, rings: &[Complex<T>], work: &mut RingWork<T>) {
        if let Some(resample) = &self.resample {
            resample.run(rings, &mut work.resample);
        }
    }

    /// Passes each finished row to `emit`: its rows in the grid, and its values.
    #[inline(always)]
    fn run<S: Simd>(
        &self,
        simd: S,
        rings: &[Complex<T>],
        work: &mut RingWork<T>,
        mut emit: impl FnMut(&[usize], &[T]),
    ) {
        let RingWork { resample, line, split } = work;
        let dense = if self.resample.is_some() { &resample.dense[..] } else { rings };
        let pad = self.padded();
        let per_node = self.rings() / self.nodes.len() * 4 * pad;
        split.resize(self.nodes.len() * per_node + 64, T::of(0.0));
        // A vector that straddles two cache lines costs two loads.
        let start = split.as_ptr().align_offset(64).min(64);
        let split = &mut split[start..][..self.nodes.len() * per_node];
        self.split(dense, split);
        line.resize(BLOCK_ROWS * 8 * pad, T::of(0.0));
        for (row, node) in &self.given {
            let part = &split[node * per_node..(node + 1) * per_node];
            if self.tall {
                self.finish::<S, true>(simd, part, line);
                emit(&row.above, &line[..4 * pad]);
                emit(&row.below, &line[4 * pad..8 * pad]);
            } else {
                self.finish::<S, false>(simd, part, line);
                emit(&row.all, &line[..4 * pad]);
            }
        }
        let weights = self.matrix.chunks(BLOCK_ROWS * self.nodes.len() * if self.tall { 4 } else { 2 });
        for (rows, weights) in self.wanted.chunks(BLOCK_ROWS).zip(weights) {
            if self.tall {
                for (row, weights) in rows.iter().zip(weights.chunks_exact(4 * self.nodes.len())) {
                    self.combine::<S, 1, 4>(simd, weights, split, line);
                    let (parts, line) = line.split_at_mut(8 * pad);
                    self.finish::<S, true>(simd, parts, line);
                    emit(&row.above, &line[..4 * pad]);
                    emit(&row.below, &line[4 * pad..8 * pad]);
                }
            } else if rows.len() == BLOCK_ROWS {
                self.combine::<S, BLOCK_ROWS, 2>(simd, weights, split, line);
                self.emit_flat(simd, rows, line, &mut emit);
            } else {
                for (row, weights) in rows.iter().zip(weights.chunks_exact(2 * self.nodes.len())) {
                    self.combine::<S, 1, 2>(simd, weights, split, line);
                    self.emit_flat(simd, std::slice::from_ref(row), line, &mut emit);
                }
            }
        }
    }

    /// Finishes rows whose parts lie one after the other in `line`.
    #[inline(always)]
    fn emit_flat<S: Simd>(&self, simd: S, rows: &[Row], line: &mut [T], emit: &mut impl FnMut(&[usize], &[T])) {
        let pad = self.padded();
        let (parts, line) = line.split_at_mut(BLOCK_ROWS * 4 * pad);
        for (row, parts) in rows.iter().zip(parts.chunks_exact(4 * pad)) {
            self.finish::<S, false>(simd, parts, line);
            emit(&row.all, &line[..4 * pad]);
        }
    }

    /// Even and odd azimuth harmonics (tall: also even and odd parts in elevation) of every ring.
    #[inline(always)]
    fn split(&self, dense: &[Complex<T>], split: &mut [T]) {
        let (half, pad) = (self.n / 2, self.padded());
        let a_half = T::of(0.5);
        for (ring, out) in dense.chunks_exact(self.n).zip(split.chunks_exact_mut(4 * pad)) {
            let (here, opposite) = ring.split_at(half);
            let (even, odd) = out.split_at_mut(2 * pad);
            let (even_re, even_im) = even.split_at_mut(pad);
            let (odd_re, odd_im) = odd.split_at_mut(pad);
            let even = even_re[..half].iter_mut().zip(&mut even_im[..half]);
            let odd = odd_re[..half].iter_mut().zip(&mut odd_im[..half]);
            for (((even, odd), a), b) in even.zip(odd).zip(here).zip(opposite) {
                *even.0 = (a.re + b.re) * a_half;
                *even.1 = (a.im + b.im) * a_half;
                *odd.0 = (a.re - b.re) * a_half;
                *odd.1 = (a.im - b.im) * a_half;
            }
        }
        if self.tall {
            for pair in split.chunks_exact_mut(8 * pad) {
                let (above, below) = pair.split_at_mut(4 * pad);
                for (a, b) in above.iter_mut().zip(below) {
                    (*a, *b) = ((*a + *b) * a_half, (*a - *b) * a_half);
                }
            }
        }
    }

    /// Values from their parts: `f(a) = E + O`, `f(a + pi) = E - O`, above and (tall) below the horizon.
    #[inline(always)]
    fn finish<S: Simd, const TALL: bool>(&self, simd: S, parts: &[T], line: &mut [T]) {
        let (lanes, pad) = (V::<S, T>::LEN, self.padded());
        let load = |part: usize, at: usize| V::<S, T>::from_slice(simd, &parts[part * pad + at..][..lanes]);
        for c in 0..2 {
            for at in (0..pad).step_by(lanes) {
                let mut put = |side: usize, even: V<S, T>, odd: V<S, T>| {
                    (even + odd).store_slice(&mut line[(side + 2 * c) * pad + at..][..lanes]);
                    (even - odd).store_slice(&mut line[(side + 2 * c + 1) * pad + at..][..lanes]);
                };
                let (e, o) = (load(c, at), load(2 + c, at));
                if TALL {
                    let (es, os) = (load(4 + c, at), load(6 + c, at));
                    put(0, e + es, o + os);
                    put(4, e - es, o - os);
                } else {
                    put(0, e, o);
                }
            }
        }
    }

    /// The parts of `ROWS` rows from the parts of all nodes: a matrix product, `FAMILIES` times.
    #[inline(always)]
    fn combine<S: Simd, const ROWS: usize, const FAMILIES: usize>(
        &self,
        simd: S,
        weights: &[T],
        split: &[T],
        line: &mut [T],
    ) {
        let (lanes, pad, count) = (V::<S, T>::LEN, self.padded(), self.nodes.len());
        let per_node = 2 * FAMILIES * pad;
        for family in 0..FAMILIES {
            for at in (0..pad).step_by(lanes) {
                let mut sums = [[V::<S, T>::splat(simd, T::of(0.0)); 2]; ROWS];
                for (i, node) in split.chunks_exact(per_node).enumerate() {
                    let re = V::<S, T>::from_slice(simd, &node[2 * family * pad + at..][..lanes]);
                    let im = V::<S, T>::from_slice(simd, &node[(2 * family + 1) * pad + at..][..lanes]);
                    for (r, sum) in sums.iter_mut().enumerate() {
                        let w = V::<S, T>::splat(simd, weights[(r * count + i) * FAMILIES + family]);
                        sum[0] = w.mul_add(re, sum[0]);
                        sum[1] = w.mul_add(im, sum[1]);
                    }
                }
                for (r, sum) in sums.iter().enumerate() {
                    let from = r * per_node + 2 * family * pad + at;
                    sum[0].store_slice(&mut line[from..][..lanes]);
                    sum[1].store_slice(&mut line[from + pad..][..lanes]);
                }
            }
        }
    }
}

/// Rows per pass over the nodes.
const BLOCK_ROWS: usize = 5;

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

/// Weights that map values at `k + 1` nodes of the quarter circle to the rows.
///
/// Each of the four families is orthogonal on the nodes (a discrete cosine or sine transform). So the weight of a node is the
/// sum over the family of its values at the row times those at the node, divided by its norm.
fn matrix<T: Real>(rows: &[Row], k: usize, tall: bool) -> Vec<T> {
    let node = |i: usize| FRAC_PI_2 * i as f64 / k as f64;
    let families = if tall { 4 } else { 2 };
    // Order: even azimuth harmonics with cosines, odd with cosines, even with sines, odd with sines.
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
