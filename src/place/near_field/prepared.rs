//! An aperture as the kernel takes it: positions in turns of phase, samples in few columns, weighted by each window.

use super::aperture::Aperture;
use super::bend::BendPolynomial;
use super::types::{Band, Place, Taper, View, Warp};
use crate::signal::alignment::planes::{LANES, Lanes};
use crate::signal::channel::SUBCARRIERS;
use csi5300_kernels::simd::on_tier;
use fearless_simd::Level;
use nalgebra::{DMatrix, Vector3};
use num_complex::{Complex32, Complex64};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Columns that the kernel sums at once: each needs four sums, and sixteen registers are there.
pub(super) const ABREAST: usize = 3;
/// (re, im) of one packet in [`ABREAST`] columns.
pub(super) type Abreast = [(f32, f32); ABREAST];
/// The columns of a band, and the full energy of each sample.
type Principal = (Vec<Vec<Abreast>>, Vec<f64>);

/// One window of a view: its samples, weighted.
#[derive(Clone, Debug)]
pub(super) struct Window {
    /// Its first packet.
    pub from: usize,
    /// `columns[k]` holds each packet from `from` on.
    pub columns: Vec<Vec<Abreast>>,
}

/// The windows of a view.
#[derive(Clone, Debug)]
pub(super) struct PreparedView {
    pub windows: Vec<Window>,
    /// What their powers sum to for a perfect match (Cauchy and Schwarz: for every window the sum of the weights times
    /// the weighted energy).
    pub full: f32,
}

/// An aperture and its views, ready for the kernel.
#[derive(Clone, Debug)]
pub(super) struct PreparedAperture {
    /// Where the samples were taken as recorded, about the middle, metres; none of samples that are sums or moved.
    pub(super) recorded_m: Vec<Vector3<f64>>,
    /// Positions about the middle and their squared norms, in turns.
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    pub z: Vec<f32>,
    pub square: Vec<f32>,
    /// Metres per turn.
    pub turn_m: f32,
    /// Largest 1 / range that is asked for, 1/m.
    pub(super) curve_max: f64,
    /// For rough powers, where it is good enough.
    pub polynomial: Option<BendPolynomial>,
    /// Shared by apertures whose samples lie elsewhere.
    pub views: Arc<[PreparedView]>,
}

impl PreparedAperture {
    /// `aperture` about `middle` in `views`, for places no nearer than `1 / curve_max`; made ready on `level`.
    pub fn new(
        aperture: &Aperture,
        middle: &Vector3<f64>,
        wavelength_m: f64,
        curve_max: f64,
        views: &[View],
        level: Level,
    ) -> Self {
        let mut prepared = Self {
            recorded_m: aperture.displacement_m.iter().map(|p| p - middle).collect(),
            x: Vec::new(),
            y: Vec::new(),
            z: Vec::new(),
            square: Vec::new(),
            turn_m: (wavelength_m / f64::from(aperture.path_gain)) as f32,
            curve_max,
            polynomial: None,
            views: PreparedView::all(aperture, views, level).into(),
        };
        prepared.warp(&Warp::default());
        prepared
    }

    /// Moves the samples from where they were recorded as `warp` says.
    pub fn warp(&mut self, warp: &Warp) {
        let moved = self.warped(warp);
        *self = Self { recorded_m: std::mem::take(&mut self.recorded_m), ..moved };
    }

    /// The same samples moved from where they were recorded as `warp` says; without where they were recorded.
    pub fn warped(&self, warp: &Warp) -> Self {
        let turn_m = f64::from(self.turn_m);
        let turns: Vec<Vector3<f64>> = warp.applied(&self.recorded_m).into_iter().map(|p| p / turn_m).collect();
        let rim = turns.iter().map(Vector3::norm).fold(0.0, f64::max);
        Self {
            recorded_m: Vec::new(),
            x: turns.iter().map(|p| p.x as f32).collect(),
            y: turns.iter().map(|p| p.y as f32).collect(),
            z: turns.iter().map(|p| p.z as f32).collect(),
            square: turns.iter().map(|p| p.norm_squared() as f32).collect(),
            polynomial: BendPolynomial::new(self.curve_max * turn_m, rim),
            views: Arc::clone(&self.views),
            ..*self
        }
    }

    /// Where the samples are, about the middle, metres.
    pub fn offsets_m(&self) -> Vec<Vector3<f64>> {
        let turn_m = f64::from(self.turn_m);
        let place = |k: usize| Vector3::new(self.x[k], self.y[k], self.z[k]).map(f64::from) * turn_m;
        (0..self.len()).map(place).collect()
    }

    /// The steering of every sample towards `place`: what undoes its path.
    pub fn steering(&self, place: &Place) -> Vec<Complex64> {
        let u = Vector3::from(place.unit()).map(f64::from);
        let curve = f64::from(place.curve as f32 * self.turn_m);
        let turn = |k: usize| {
            let p = Vector3::new(self.x[k], self.y[k], self.z[k]).map(f64::from);
            let bend = curve * p.norm_squared() - 2.0 * u.dot(&p);
            let turns = bend / ((1.0 + curve * bend).max(0.0).sqrt() + 1.0);
            Complex64::cis(std::f64::consts::TAU * turns)
        };
        (0..self.len()).map(turn).collect()
    }

    /// The columns of the first window of the first view: with one window, those of the whole motion.
    pub fn columns(&self) -> Vec<Vec<Complex64>> {
        let window = self.views.first().and_then(|view| view.windows.first());
        let chunks = window.map(|window| window.columns.as_slice()).unwrap_or_default();
        let column = |chunk: &[Abreast], i: usize| {
            chunk.iter().map(|sample| Complex64::new(f64::from(sample[i].0), f64::from(sample[i].1))).collect()
        };
        chunks.iter().flat_map(|chunk| (0..ABREAST).map(move |i| column(chunk, i))).collect()
    }

    /// The same positions with other columns (a multiple of [`ABREAST`] of them), in one view over the whole motion.
    pub fn with_columns(&self, columns: &[Vec<Complex64>]) -> Self {
        let sample = |own: &[Vec<Complex64>], k: usize| -> Abreast {
            std::array::from_fn(|i| own.get(i).map_or((0.0, 0.0), |c| (c[k].re as f32, c[k].im as f32)))
        };
        let chunk = |own: &[Vec<Complex64>]| (0..self.len()).map(|k| sample(own, k)).collect();
        let window = Window { from: 0, columns: columns.chunks(ABREAST).map(chunk).collect() };
        let energy: f64 = columns.iter().flatten().map(Complex64::norm_sqr).sum();
        Self {
            recorded_m: Vec::new(),
            x: self.x.clone(),
            y: self.y.clone(),
            z: self.z.clone(),
            square: self.square.clone(),
            views: [PreparedView { windows: vec![window], full: (energy * self.len() as f64) as f32 }].into(),
            ..*self
        }
    }

    /// Samples.
    pub fn len(&self) -> usize {
        self.x.len()
    }
}

impl PreparedView {
    /// All `views`: those of one band share its columns.
    fn all(aperture: &Aperture, views: &[View], level: Level) -> Vec<Self> {
        let mut bands: BTreeMap<usize, Principal> = BTreeMap::new();
        let mut prepared = |view: &View| match view.band {
            Band::Centre => Self::of_centre(aperture, view),
            Band::Subcarriers(count) => {
                let count = count.clamp(1, SUBCARRIERS);
                Self::of_subcarriers(bands.entry(count).or_insert_with(|| principal(aperture, count, level)), view)
            }
        };
        views.iter().map(&mut prepared).collect()
    }

    fn of_subcarriers((columns, energies): &Principal, view: &View) -> Self {
        let mut full = 0f64;
        let window = |(from, weights): (usize, Vec<f64>)| {
            let energy: f64 = weights.iter().zip(&energies[from..]).map(|(w, energy)| w * energy).sum();
            full += weights.iter().sum::<f64>() * energy;
            let weighted = |column: &Vec<Abreast>| {
                let part = column[from..].iter().zip(&weights);
                part.map(|(sample, w)| sample.map(|(re, im)| (*w as f32 * re, *w as f32 * im))).collect()
            };
            Window { from, columns: columns.iter().map(weighted).collect() }
        };
        let windows = cuts(energies.len(), view).into_iter().map(window).collect();
        Self { windows, full: full as f32 }
    }

    /// Each column is one window of the phasor at the channel centre, so that few sums serve all windows.
    fn of_centre(aperture: &Aperture, view: &View) -> Self {
        let (n, mut full) = (aperture.centre.len(), 0f64);
        let column = |(from, weights): (usize, Vec<f64>)| {
            let own = &aperture.centre[from..];
            let energy: f64 = weights.iter().zip(own).map(|(w, z)| w * f64::from(z.norm_sqr())).sum();
            full += weights.iter().sum::<f64>() * energy;
            let mut column = vec![(0.0, 0.0); n];
            for (slot, (w, z)) in column[from..].iter_mut().zip(weights.iter().zip(own)) {
                *slot = (*w as f32 * z.re, *w as f32 * z.im);
            }
            column
        };
        let columns: Vec<Vec<(f32, f32)>> = cuts(n, view).into_iter().map(column).collect();
        let abreast = |own: &[Vec<(f32, f32)>]| {
            (0..n).map(|t| std::array::from_fn(|i| own.get(i).map_or((0.0, 0.0), |column| column[t]))).collect()
        };
        let window = Window { from: 0, columns: columns.chunks(ABREAST).map(abreast).collect() };
        Self { windows: vec![window], full: full as f32 }
    }
}

/// First sample and weights of every window over `n` samples.
fn cuts(n: usize, view: &View) -> Vec<(usize, Vec<f64>)> {
    let count = view.windows.clamp(1, n.max(1));
    if count == 1 || view.taper == Taper::Block {
        let edge = |i: usize| i * n / count;
        return (0..count).map(|i| (edge(i), vec![1.0; edge(i + 1) - edge(i)])).collect();
    }
    let length = (2 * n).div_ceil(count + 1).max(1);
    let weight = |t: usize| (std::f64::consts::PI * (t as f64 + 1.0) / (length as f64 + 1.0)).sin().powi(2);
    let weights: Vec<f64> = (0..length).map(weight).collect();
    (0..count).map(|i| (i * (n - length) / (count - 1), weights.clone())).collect()
}

/// The `count` subcarriers about the channel centre in few columns: summed over subcarriers, power is the same in every
/// orthogonal basis, and in that of their correlation nearly all of it that is more than noise is in the first
/// [`ABREAST`] (of up to six subcarriers) or twice as many columns. What is left out can only lower a power, by its
/// share of the energy at most. Beside them the full energy of each sample.
fn principal(aperture: &Aperture, count: usize, level: Level) -> Principal {
    let lowest = (SUBCARRIERS - count) / 2;
    let rows: Vec<&[Complex32]> = aperture.rows.iter().map(|row| &row[lowest..lowest + count]).collect();
    let energies = rows.iter().map(|row| f64::from(row.iter().map(Complex32::norm_sqr).sum::<f32>())).collect();
    let chunks = if count <= 2 * ABREAST { 1 } else { 2 };
    let bases = strongest(correlation(&rows, count, level), chunks * ABREAST);
    (on_tier!(level, _simd => projected(&rows, &bases, chunks)), energies)
}

/// Places for the columns of all bases: real and imaginary parts apart, side by side.
type Side = [f32; 8];

/// The rows in the basis of each of `bases`, [`ABREAST`] to a chunk.
#[inline(always)]
fn projected(rows: &[&[Complex32]], bases: &[Vec<Complex32>], chunks: usize) -> Vec<Vec<Abreast>> {
    let part = |k: usize, of: fn(&Complex32) -> f32| -> Side {
        std::array::from_fn(|i| bases.get(i).and_then(|basis| basis.get(k)).map_or(0.0, of))
    };
    let by_subcarrier: Vec<[Side; 2]> =
        (0..SUBCARRIERS).map(|k| [part(k, |value| value.re), part(k, |value| value.im)]).collect();
    let mut columns = vec![Vec::with_capacity(rows.len()); chunks];
    for row in rows {
        let (mut re, mut im): (Side, Side) = ([0.0; 8], [0.0; 8]);
        for (value, [basis_re, basis_im]) in row.iter().zip(&by_subcarrier) {
            for i in 0..re.len() {
                re[i] += value.re * basis_re[i] - value.im * basis_im[i];
                im[i] += value.re * basis_im[i] + value.im * basis_re[i];
            }
        }
        for (chunk, column) in columns.iter_mut().enumerate() {
            column.push(std::array::from_fn(|i| (re[chunk * ABREAST + i], im[chunk * ABREAST + i])));
        }
    }
    columns
}

/// `sum conj(row[i]) row[k]` of the `count` columns of `rows`.
fn correlation(rows: &[&[Complex32]], count: usize, level: Level) -> DMatrix<Complex64> {
    let mut sums = [[[0f32; LANES]; 2]; SUBCARRIERS];
    on_tier!(level, _simd => correlate(rows, &mut sums));
    let above = |i: usize, k: usize| Complex64::new(f64::from(sums[i][0][k]), f64::from(sums[i][1][k]));
    DMatrix::from_fn(count, count, |i, k| if i <= k { above(i, k) } else { above(k, i).conj() })
}

/// Adds up `conj(row[i]) row[k]`: real and imaginary parts apart, along k: plain loops, which vectors follow.
#[inline(always)]
fn correlate(rows: &[&[Complex32]], sums: &mut [[Lanes; 2]; SUBCARRIERS]) {
    let (mut re, mut im): (Lanes, Lanes) = ([0.0; LANES], [0.0; LANES]);
    for row in rows {
        for ((re, im), value) in re.iter_mut().zip(&mut im).zip(*row) {
            (*re, *im) = (value.re, value.im);
        }
        for (value, [sum_re, sum_im]) in row.iter().zip(&mut *sums) {
            for k in 0..LANES {
                sum_re[k] += value.re * re[k] + value.im * im[k];
                sum_im[k] += value.re * im[k] - value.im * re[k];
            }
        }
    }
}

/// The `most` strongest eigenvectors of a correlation; zeros where there are fewer.
fn strongest(correlation: DMatrix<Complex64>, most: usize) -> Vec<Vec<Complex32>> {
    let count = correlation.nrows();
    let eigen = correlation.symmetric_eigen();
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let basis = |place: usize| -> Vec<Complex32> {
        let column = order.get(place).map(|&own| eigen.eigenvectors.column(own));
        column.map_or(vec![Complex32::default(); count], |own| {
            own.iter().map(|v| Complex32::new(v.re as f32, v.im as f32)).collect()
        })
    };
    (0..most).map(basis).collect()
}
