//! The kernel: how well spherical waves from many places explain the samples, eight or more places at a time.

use super::aperture::Aperture;
use crate::bartlett::simd::{V, sin_cos_turns};
use crate::channel::SUBCARRIERS;
use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch};
use nalgebra::Vector3;

/// A way to look at an aperture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Half-overlapping Hann windows along the trajectory that are summed in power; 1 is the whole of it, coherent.
    pub windows: usize,
    /// Exponent in the product of all views.
    pub weight: f64,
    /// How many subcarriers are used, about the channel centre. Few of them depend little on the sampling time.
    pub subcarriers: usize,
}

/// A place as the kernel takes it: unit vector from the aperture's middle, and 1 / range in 1/m (0: a plane wave).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cell {
    pub unit: [f32; 3],
    pub inverse_range: f32,
}

/// One window of one view: its samples, weighted, column by column.
struct Window {
    from: usize,
    /// `columns[k]` holds (re, im) of each sample from `from` on.
    columns: Vec<Vec<(f32, f32)>>,
}

/// An aperture ready for the kernel.
pub(crate) struct Layer {
    /// Positions about the middle and their squared norms, in turns.
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    square: Vec<f32>,
    /// Metres per turn.
    turn_m: f32,
    views: Vec<(Vec<Window>, f32)>,
}

impl Layer {
    /// `aperture` about `middle`, seen in `views`.
    pub fn new(aperture: &Aperture, middle: &Vector3<f64>, wavelength_m: f64, views: &[View]) -> Self {
        let turn_m = wavelength_m / f64::from(aperture.path_gain);
        let turns: Vec<Vector3<f64>> = aperture.displacement_m.iter().map(|p| (p - middle) / turn_m).collect();
        Self {
            x: turns.iter().map(|p| p.x as f32).collect(),
            y: turns.iter().map(|p| p.y as f32).collect(),
            z: turns.iter().map(|p| p.z as f32).collect(),
            square: turns.iter().map(|p| p.norm_squared() as f32).collect(),
            turn_m: turn_m as f32,
            views: views.iter().map(|view| windows(aperture, view)).collect(),
        }
    }

    fn len(&self) -> usize {
        self.x.len()
    }
}

/// The windows of a view, and what their powers sum to for a perfect match (Cauchy and Schwarz: for every window the
/// sum of the weights times the weighted energy).
fn windows(aperture: &Aperture, view: &View) -> (Vec<Window>, f32) {
    let n = aperture.rows.len();
    let count = view.windows.clamp(1, n.max(1));
    let wide = view.subcarriers.clamp(1, SUBCARRIERS);
    let lowest = (SUBCARRIERS - wide) / 2;
    let length = if count == 1 { n } else { (2 * n).div_ceil(count + 1).max(1) };
    let mut full = 0f64;
    let window = |i: usize| {
        let from = if count == 1 { 0 } else { i * (n - length) / (count - 1) };
        let weight = |t: usize| match count {
            1 => 1.0,
            _ => (std::f64::consts::PI * (t as f64 + 1.0) / (length as f64 + 1.0)).sin().powi(2),
        };
        let mut columns = vec![Vec::with_capacity(length); wide];
        let (mut weights, mut energy) = (0.0, 0.0);
        for (t, row) in aperture.rows[from..from + length].iter().enumerate() {
            let w = weight(t);
            weights += w;
            for (column, value) in columns.iter_mut().zip(&row[lowest..]) {
                energy += w * f64::from(value.norm_sqr());
                column.push((w as f32 * value.re, w as f32 * value.im));
            }
        }
        full += weights * energy;
        Window { from, columns }
    };
    let list = (0..count).map(window).collect();
    (list, full as f32)
}

/// The power of every view of every layer for each cell, 0..1, view by view: `powers[cell * views + view]`.
pub(crate) fn powers(level: Level, layers: &[Layer], cells: &[Cell]) -> Vec<f32> {
    let views: usize = layers.iter().map(|layer| layer.views.len()).sum();
    let mut powers = vec![0.0; views * cells.len()];
    dispatch!(level, simd => powers_simd(simd, layers, cells, views, &mut powers));
    powers
}

#[inline(always)]
fn powers_simd<S: Simd>(simd: S, layers: &[Layer], cells: &[Cell], views: usize, powers: &mut [f32]) {
    let lanes = V::<S, f32>::LEN;
    let longest = layers.iter().map(Layer::len).max().unwrap_or(0);
    let mut steering = vec![(V::<S, f32>::splat(simd, 0.0), V::<S, f32>::splat(simd, 0.0)); longest];
    for (cells, powers) in cells.chunks(lanes).zip(powers.chunks_mut(lanes * views)) {
        let mut view = 0;
        for layer in layers {
            steer(simd, layer, cells, &mut steering);
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

/// `exp(j 2 pi (|rx - place| - range))` in turns for each sample: what undoes the path. The difference of the two
/// lengths is written without cancellation, and holds for infinite range.
#[inline(always)]
fn steer<S: Simd>(simd: S, layer: &Layer, cells: &[Cell], steering: &mut [Turn<S>]) {
    let splat = |value: f32| V::<S, f32>::splat(simd, value);
    let lane = |f: &dyn Fn(&Cell) -> f32| V::<S, f32>::from_fn(simd, |i| cells.get(i).map_or(0.0, f));
    let (ux, uy, uz) = (lane(&|c| c.unit[0]), lane(&|c| c.unit[1]), lane(&|c| c.unit[2]));
    let curve = lane(&|c| c.inverse_range * layer.turn_m);
    let one = splat(1.0);
    for (t, slot) in steering.iter_mut().enumerate().take(layer.len()) {
        let along = ux.mul_add(splat(layer.x[t]), uy.mul_add(splat(layer.y[t]), uz * splat(layer.z[t])));
        // length^2 / range^2 = 1 + curve * bend; (length - range) = bend / (length / range + 1).
        let bend = curve.mul_add(splat(layer.square[t]), -(along + along));
        let ratio = curve.mul_add(bend, one).max(splat(0.0)).sqrt();
        let (sin, cos) = sin_cos_turns::<S, f32>(simd, bend / (ratio + one));
        *slot = (cos, sin);
    }
}

#[inline(always)]
fn window_power<S: Simd>(simd: S, window: &Window, steering: &[Turn<S>]) -> V<S, f32> {
    let zero = V::<S, f32>::splat(simd, 0.0);
    let mut power = zero;
    for column in &window.columns {
        let (mut re_cos, mut im_sin, mut re_sin, mut im_cos) = (zero, zero, zero, zero);
        for (&(re, im), (cos, sin)) in column.iter().zip(&steering[window.from..]) {
            let (re, im) = (V::<S, f32>::splat(simd, re), V::<S, f32>::splat(simd, im));
            re_cos = cos.mul_add(re, re_cos);
            im_sin = sin.mul_add(im, im_sin);
            re_sin = sin.mul_add(re, re_sin);
            im_cos = cos.mul_add(im, im_cos);
        }
        let (re, im) = (re_cos - im_sin, im_cos + re_sin);
        power = re.mul_add(re, im.mul_add(im, power));
    }
    power
}
