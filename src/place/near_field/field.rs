//! The kernel: how well spherical waves from many places explain the samples, eight or more places at a time.

use super::aperture::Aperture;
use super::focus::Warp;
use crate::bartlett::kernel::fit_polynomial;
use crate::maths::simd::{V, on_tier, rough_sin_cos_turns, sin_cos_turns};
use crate::signal::alignment::Row;
use crate::signal::channel::SUBCARRIERS;
use fearless_simd::{Level, Simd, SimdBase, SimdFloat};
use nalgebra::{DMatrix, Vector3};
use num_complex::{Complex32, Complex64};

/// How a trajectory is cut into windows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Taper {
    /// Half-overlapping Hann windows.
    #[default]
    Hann,
    /// Blocks side by side.
    Block,
}

/// A way to look at an aperture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Windows along the trajectory that are summed in power; 1 is the whole of it, coherent.
    pub windows: usize,
    /// Their shape.
    pub taper: Taper,
    /// Exponent in the product of all views.
    pub weight: f64,
    /// How many subcarriers are used, about the channel centre. Few of them depend little on the sampling time; none is
    /// the phasor at the channel centre ([`Aperture::centre`]).
    pub subcarriers: usize,
}

/// A place as the kernel takes it: unit vector from the aperture's middle, and 1 / range in 1/m (0: a plane wave).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cell {
    pub unit: [f32; 3],
    pub inverse_range: f32,
}

/// Columns that the kernel takes at once: each needs four sums, and sixteen registers are there.
const ABREAST: usize = 3;
/// (re, im) of a sample on [`ABREAST`] columns.
type Sample = [(f32, f32); ABREAST];

/// One window of one view: its samples, weighted, some columns at a time.
#[derive(Clone, Debug)]
struct Window {
    from: usize,
    /// `columns[k]` holds each sample from `from` on.
    columns: Vec<Vec<Sample>>,
}

/// An aperture ready for the kernel.
#[derive(Clone, Debug)]
pub(crate) struct Layer {
    /// Where the samples were taken as recorded, about the middle, metres.
    recorded_m: Vec<Vector3<f64>>,
    /// Positions about the middle and their squared norms, in turns.
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    square: Vec<f32>,
    /// Metres per turn.
    turn_m: f32,
    /// Largest 1 / range that is asked for, 1/m.
    curve_max: f64,
    /// How far away waves are bent, for a rough look.
    rough: Option<Rough>,
    views: Vec<(Vec<Window>, f32)>,
}

impl Layer {
    /// `aperture` about `middle`, seen in `views`, for places no nearer than `1 / curve_max`.
    pub fn new(aperture: &Aperture, middle: &Vector3<f64>, wavelength_m: f64, curve_max: f64, views: &[View]) -> Self {
        let mut layer = Self {
            recorded_m: aperture.displacement_m.iter().map(|p| p - middle).collect(),
            x: Vec::new(),
            y: Vec::new(),
            z: Vec::new(),
            square: Vec::new(),
            turn_m: (wavelength_m / f64::from(aperture.path_gain)) as f32,
            curve_max,
            rough: None,
            views: views.iter().map(|view| windows(aperture, view)).collect(),
        };
        layer.bend(&Warp::default());
        layer
    }

    /// Moves the samples from where they were recorded as `warp` says.
    pub fn bend(&mut self, warp: &Warp) {
        let turn_m = f64::from(self.turn_m);
        let turns: Vec<Vector3<f64>> = warp.applied(&self.recorded_m).into_iter().map(|p| p / turn_m).collect();
        self.x = turns.iter().map(|p| p.x as f32).collect();
        self.y = turns.iter().map(|p| p.y as f32).collect();
        self.z = turns.iter().map(|p| p.z as f32).collect();
        self.square = turns.iter().map(|p| p.norm_squared() as f32).collect();
        let rim = turns.iter().map(Vector3::norm).fold(0.0, f64::max);
        self.rough = Rough::new(self.curve_max * turn_m, rim);
    }

    /// Where the samples are, about the middle, metres.
    pub fn offsets_m(&self) -> Vec<Vector3<f64>> {
        let turn_m = f64::from(self.turn_m);
        let place = |k: usize| Vector3::new(self.x[k], self.y[k], self.z[k]).map(f64::from) * turn_m;
        (0..self.len()).map(place).collect()
    }

    /// The steering of every sample towards `cell`: what undoes its path.
    pub fn steering(&self, cell: &Cell) -> Vec<Complex64> {
        let u = Vector3::from(cell.unit).map(f64::from);
        let curve = f64::from(cell.inverse_range * self.turn_m);
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
        let window = self.views.first().and_then(|(windows, _)| windows.first());
        let chunks = window.map(|window| window.columns.as_slice()).unwrap_or_default();
        let column = |chunk: &[Sample], i: usize| {
            chunk.iter().map(|sample| Complex64::new(f64::from(sample[i].0), f64::from(sample[i].1))).collect()
        };
        chunks.iter().flat_map(|chunk| (0..ABREAST).map(move |i| column(chunk, i))).collect()
    }

    /// The same samples with other columns (a multiple of [`ABREAST`] of them), seen as a whole.
    pub fn with_columns(&self, columns: &[Vec<Complex64>]) -> Self {
        let sample = |own: &[Vec<Complex64>], k: usize| -> Sample {
            std::array::from_fn(|i| own.get(i).map_or((0.0, 0.0), |c| (c[k].re as f32, c[k].im as f32)))
        };
        let chunk = |own: &[Vec<Complex64>]| (0..self.len()).map(|k| sample(own, k)).collect();
        let window = Window { from: 0, columns: columns.chunks(ABREAST).map(chunk).collect() };
        let energy: f64 = columns.iter().flatten().map(Complex64::norm_sqr).sum();
        Self {
            recorded_m: self.recorded_m.clone(),
            x: self.x.clone(),
            y: self.y.clone(),
            z: self.z.clone(),
            square: self.square.clone(),
            turn_m: self.turn_m,
            curve_max: self.curve_max,
            rough: self.rough,
            views: vec![(vec![window], (energy * self.len() as f64) as f32)],
        }
    }

    fn len(&self) -> usize {
        self.recorded_m.len()
    }

    /// In how many ways it is looked at.
    pub fn views(&self) -> usize {
        self.views.len()
    }
}

/// Degree of [`Rough`]'s polynomial.
const DEGREE: usize = 6;
/// Largest error of a phase in a rough look, turns: it costs 1.5 % of a power's root.
const ROUGH_TURNS: f64 = 0.02;

/// `1 / (sqrt(1 + x) + 1)` by a polynomial in `scale (x - middle)`: what divides the bend of a wave front. Root and
/// division would take most of a look's time, and a search looks at thousands of places before it needs one exactly.
#[derive(Clone, Copy, Debug)]
struct Rough {
    middle: f32,
    scale: f32,
    coefficients: [f32; DEGREE + 1],
}

impl Rough {
    /// For curvatures up to `curve` (1/turns) over samples up to `rim` turns away; `None` where the polynomial is not
    /// good enough: places hardly outside the motion.
    fn new(curve: f64, rim: f64) -> Option<Self> {
        let q = curve * rim;
        // x = q' (q' + 2 cos) for q' up to q, which falls down to q' = 1.
        let (low, high) = (q * (q - 2.0), q * (q + 2.0));
        let (middle, width) = (0.5 * (low + high), (high - low).max(1e-3));
        let exact = |s: f64| 1.0 / ((1.0 + middle + width * s).max(0.0).sqrt() + 1.0);
        let fit = fit_polynomial(DEGREE, exact);
        let value = |s: f64| fit.iter().fold(0.0, |sum, c| sum * s + c);
        let off = (0..=64).map(|k| f64::from(k) / 64.0 - 0.5).map(|s| (value(s) - exact(s)).abs()).fold(0.0, f64::max);
        let good = q < 1.0 && off * rim * (q + 2.0) < ROUGH_TURNS;
        let coefficients = std::array::from_fn(|k| fit[k] as f32);
        good.then_some(Self { middle: middle as f32, scale: (1.0 / width) as f32, coefficients })
    }
}

/// How exactly a place is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Look {
    /// Single precision.
    Exact,
    /// Phases within [`ROUGH_TURNS`], for half the work: to find what is worth another look.
    Rough,
}

/// The windows of a view, and what their powers sum to for a perfect match (Cauchy and Schwarz: for every window the
/// sum of the weights times the weighted energy).
fn windows(aperture: &Aperture, view: &View) -> (Vec<Window>, f32) {
    if view.subcarriers == 0 {
        return windows_of_centre(aperture, view);
    }
    let wide = view.subcarriers.clamp(1, SUBCARRIERS);
    let (columns, energies) = principal(aperture, wide);
    let mut full = 0f64;
    let window = |(from, weights): (usize, Vec<f64>)| {
        let energy: f64 = weights.iter().zip(&energies[from..]).map(|(w, energy)| w * energy).sum();
        full += weights.iter().sum::<f64>() * energy;
        let weighted = |column: &Vec<Sample>| {
            let part = column[from..].iter().zip(&weights);
            part.map(|(sample, w)| sample.map(|(re, im)| (*w as f32 * re, *w as f32 * im))).collect()
        };
        Window { from, columns: columns.iter().map(weighted).collect() }
    };
    let list = cuts(aperture.rows.len(), view).into_iter().map(window).collect();
    (list, full as f32)
}

/// The same of the phasor at the channel centre: each column is one window of it, so that few sums serve all windows.
fn windows_of_centre(aperture: &Aperture, view: &View) -> (Vec<Window>, f32) {
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
    (vec![Window { from: 0, columns: columns.chunks(ABREAST).map(abreast).collect() }], full as f32)
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

/// The `wide` subcarriers about the channel centre in few columns: summed over subcarriers, power is the same in every
/// orthogonal basis, and in that of their correlation nearly all of it that is more than noise is in the first
/// [`ABREAST`] (of up to six subcarriers) or twice as many columns. What is left out can only lower a power, by its
/// share of the energy at most. Beside them the full energy of each sample.
fn principal(aperture: &Aperture, wide: usize) -> (Vec<Vec<Sample>>, Vec<f64>) {
    let lowest = (SUBCARRIERS - wide) / 2;
    let band = |row: &Row| -> Vec<Complex32> { row[lowest..lowest + wide].to_vec() };
    let rows: Vec<Vec<Complex32>> = aperture.rows.iter().map(band).collect();
    let energies = rows.iter().map(|row| f64::from(row.iter().map(Complex32::norm_sqr).sum::<f32>())).collect();
    let mut correlation = DMatrix::<Complex64>::zeros(wide, wide);
    for i in 0..wide {
        for k in i..wide {
            let sum: Complex32 = rows.iter().map(|row| row[i].conj() * row[k]).sum();
            correlation[(i, k)] = Complex64::new(f64::from(sum.re), f64::from(sum.im));
            correlation[(k, i)] = correlation[(i, k)].conj();
        }
    }
    let eigen = correlation.symmetric_eigen();
    let mut order: Vec<usize> = (0..wide).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let chunks = if wide <= 2 * ABREAST { 1 } else { 2 };
    let basis = |place: usize| -> Vec<Complex32> {
        let column = order.get(place).map(|&own| eigen.eigenvectors.column(own));
        column.map_or(vec![Complex32::default(); wide], |own| {
            own.iter().map(|v| Complex32::new(v.re as f32, v.im as f32)).collect()
        })
    };
    let chunk = |number: usize| {
        let bases: [Vec<Complex32>; ABREAST] = std::array::from_fn(|i| basis(ABREAST * number + i));
        let sample = |row: &Vec<Complex32>| -> Sample {
            std::array::from_fn(|i| {
                let value: Complex32 = row.iter().zip(&bases[i]).map(|(a, b)| a * b).sum();
                (value.re, value.im)
            })
        };
        rows.iter().map(sample).collect()
    };
    ((0..chunks).map(chunk).collect(), energies)
}

/// The power of every view of every layer for each cell, 0..1, view by view: `powers[cell * views + view]`.
pub(crate) fn powers(level: Level, layers: &[Layer], cells: &[Cell], look: Look) -> Vec<f32> {
    let views: usize = layers.iter().map(Layer::views).sum();
    let mut powers = vec![0.0; views * cells.len()];
    on_tier!(level, simd => powers_simd(simd, layers, cells, views, look, &mut powers));
    powers
}

#[inline(always)]
fn powers_simd<S: Simd>(simd: S, layers: &[Layer], cells: &[Cell], views: usize, look: Look, powers: &mut [f32]) {
    let lanes = V::<S, f32>::LEN;
    let longest = layers.iter().map(Layer::len).max().unwrap_or(0);
    let mut steering = vec![(V::<S, f32>::splat(simd, 0.0), V::<S, f32>::splat(simd, 0.0)); longest];
    for (cells, powers) in cells.chunks(lanes).zip(powers.chunks_mut(lanes * views)) {
        let mut view = 0;
        for layer in layers {
            match layer.rough.filter(|_| look == Look::Rough) {
                Some(rough) => steer_roughly(simd, layer, cells, &rough, &mut steering),
                None => steer(simd, layer, cells, &mut steering),
            }
            for (windows, full) in &layer.views {
                let mut sum = V::<S, f32>::splat(simd, 0.0);
                for window in windows {
                    sum += window_power(simd, window, &steering);
                }
                for i in 0..cells.len() {
                    powers[i * views + view] = if *full > 0.0 { (sum[i] / full).min(1.0) } else { 0.0 };
                }
                view += 1;
            }
        }
    }
}

/// Cosine and sine of the steering phase, a lane for each cell.
type Turn<S> = (V<S, f32>, V<S, f32>);

/// What the cells of a vector have in common with no sample: twice their direction, and 1 / range in 1/turns.
struct Lanes<S: Simd> {
    twice: [V<S, f32>; 3],
    curve: V<S, f32>,
}

impl<S: Simd> Lanes<S> {
    #[inline(always)]
    fn new(simd: S, layer: &Layer, cells: &[Cell]) -> Self {
        let lane = |f: &dyn Fn(&Cell) -> f32| V::<S, f32>::from_fn(simd, |i| cells.get(i).map_or(0.0, f));
        let twice = [0, 1, 2].map(|axis| lane(&|c| 2.0 * c.unit[axis]));
        Self { twice, curve: lane(&|c| c.inverse_range * layer.turn_m) }
    }

    /// `length^2 / range^2 = 1 + curve * bend`; `length - range = bend / (length / range + 1)`.
    #[inline(always)]
    fn bend(&self, simd: S, layer: &Layer, t: usize) -> V<S, f32> {
        let splat = |value: f32| V::<S, f32>::splat(simd, value);
        let [x, y, z] = self.twice;
        let along = x.mul_add(splat(layer.x[t]), y.mul_add(splat(layer.y[t]), z * splat(layer.z[t])));
        self.curve.mul_add(splat(layer.square[t]), -along)
    }
}

/// `exp(j 2 pi (|rx - place| - range))` in turns for each sample: what undoes the path. The difference of the two
/// lengths is written without cancellation, and holds for infinite range.
#[inline(always)]
fn steer<S: Simd>(simd: S, layer: &Layer, cells: &[Cell], steering: &mut [Turn<S>]) {
    let lanes = Lanes::<S>::new(simd, layer, cells);
    let (zero, one) = (V::<S, f32>::splat(simd, 0.0), V::<S, f32>::splat(simd, 1.0));
    for (t, slot) in steering.iter_mut().enumerate().take(layer.len()) {
        let bend = lanes.bend(simd, layer, t);
        let ratio = lanes.curve.mul_add(bend, one).max(zero).sqrt();
        let (sin, cos) = sin_cos_turns::<S, f32>(simd, bend / (ratio + one));
        *slot = (cos, sin);
    }
}

/// As [`steer`], by the polynomial and with a rough sine.
#[inline(always)]
fn steer_roughly<S: Simd>(simd: S, layer: &Layer, cells: &[Cell], rough: &Rough, steering: &mut [Turn<S>]) {
    let lanes = Lanes::<S>::new(simd, layer, cells);
    let coefficients = rough.coefficients.map(|c| V::<S, f32>::splat(simd, c));
    let scaled = lanes.curve * V::<S, f32>::splat(simd, rough.scale);
    let offset = V::<S, f32>::splat(simd, -rough.middle * rough.scale);
    for (t, slot) in steering.iter_mut().enumerate().take(layer.len()) {
        let bend = lanes.bend(simd, layer, t);
        let s = scaled.mul_add(bend, offset);
        let mut part = coefficients[0];
        for c in &coefficients[1..] {
            part = part.mul_add(s, *c);
        }
        let (sin, cos) = rough_sin_cos_turns::<S, f32>(simd, bend * part);
        *slot = (cos, sin);
    }
}

#[inline(always)]
fn window_power<S: Simd>(simd: S, window: &Window, steering: &[Turn<S>]) -> V<S, f32> {
    let zero = V::<S, f32>::splat(simd, 0.0);
    let mut power = zero;
    for samples in &window.columns {
        let mut sums = [[zero; 4]; ABREAST];
        for (sample, (cos, sin)) in samples.iter().zip(&steering[window.from..]) {
            for (sum, &(re, im)) in sums.iter_mut().zip(sample) {
                let (re, im) = (V::<S, f32>::splat(simd, re), V::<S, f32>::splat(simd, im));
                sum[0] = cos.mul_add(re, sum[0]);
                sum[1] = sin.mul_add(im, sum[1]);
                sum[2] = sin.mul_add(re, sum[2]);
                sum[3] = cos.mul_add(im, sum[3]);
            }
        }
        for [re_cos, im_sin, re_sin, im_cos] in sums {
            let (re, im) = (re_cos - im_sin, im_cos + re_sin);
            power = re.mul_add(re, im.mul_add(im, power));
        }
    }
    power
}
