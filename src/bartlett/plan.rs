//! A plan: every table that does not depend on the samples, for a bucket of apertures (5 percent wide).

use nalgebra::Vector3;
#[cfg(test)]
use num_complex::Complex64;

use super::choose::Choice;
use super::explain::{Explanation, Method};
use super::grid::{Grid, Layout, direction, ring_azimuth};
use super::key::{Key, cone_rows, ring_shape};
use csi5300_kernels::cone::Cone;
use csi5300_kernels::evaluate::{Batch, Buffers, Evaluator, Places, Slab};
use csi5300_kernels::fft::Ffts;
use csi5300_kernels::nufft::Nufft;
use csi5300_kernels::rings::{RingWork, Rings};
use csi5300_kernels::setting::Setting;
use csi5300_kernels::simd::{Real, Tier};

/// A reusable plan.
pub struct Plan {
    pub(super) key: Key,
    pub(super) frame: Frame,
    pub(super) engine: Engine,
    pub(super) explanation: Explanation,
}

/// How the values are computed.
pub(super) enum Engine {
    Constant,
    Oracle,
    Single(Core<f32>),
    Double(Core<f64>),
}

/// Evaluation and, for a grid of rings, what makes rows of it.
pub(super) struct Core<T: Real> {
    pub evaluator: Evaluator<T>,
    assembly: Assembly<T>,
}

/// From values to the grid.
enum Assembly<T: Real> {
    /// One value per direction.
    Plain,
    /// Interpolation from band-limited rings.
    Rings(Box<Rings<T>>),
    /// Rows of the grid that are one of the computed rows each.
    Rows(Vec<usize>),
}

/// The axes that positions and directions are expressed in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Frame {
    Given,
    Turned([Vector3<f64>; 3]),
}

impl Frame {
    pub fn of(self, u: Vector3<f64>) -> [f64; 3] {
        match self {
            Self::Given => u.into(),
            Self::Turned(axes) => axes.map(|a| a.dot(&u)),
        }
    }
}

impl Plan {}

/// FFTs and buffers of one precision.
pub(super) struct Bench<T: Real> {
    pub ffts: Ffts<T>,
    buffers: Buffers<T>,
    rings: RingWork<T>,
}

impl<T: Real> Bench<T> {
    pub fn new(tier: Tier) -> Self {
        Self { ffts: Ffts::new(tier), buffers: Buffers::default(), rings: RingWork::default() }
    }
}

/// The unit vector of a direction of the grid.
pub(super) fn unit(grid: &Grid, index: usize) -> Vector3<f64> {
    let (azimuth, elevation) = grid.at(index);
    direction(azimuth, elevation)
}

impl<T: Real> Core<T> {
    pub fn new(key: &Key, frame: Frame, choice: &Choice, tier: Tier, ffts: &mut Ffts<T>) -> (Self, String) {
        if let (Method::Cone, Some(setting)) = (choice.method, choice.setting) {
            return Self::cone(key, frame, setting, ffts);
        }
        let level = tier.level_or_portable();
        let tall = key.extent[2] > 0.0;
        let use_rings = matches!(choice.method, Method::RingsDirect | Method::RingsNufft)
            || (choice.method == Method::Slab && ring_shape(key, choice.order).is_some());
        let (assembly, places) = match &*key.grid.layout {
            Layout::Rings { azimuths, elevations_rad } if use_rings => {
                let rings = Rings::new(*azimuths, elevations_rad, choice.order, tall, level, ffts);
                let places = Places::Rings { d: rings.d, nodes: rings.nodes.clone(), tall };
                (Assembly::Rings(Box::new(rings)), places)
            }
            _ => (Assembly::Plain, Places::List((0..key.grid.len()).map(|i| frame.of(unit(&key.grid, i))).collect())),
        };
        let mut detail = format!("band limits {} and {}", choice.order[0], choice.order[1]);
        let evaluator = match choice.setting {
            None => Evaluator::direct(level, places),
            Some(setting) => {
                let nufft = Nufft::new([key.extent[0], key.extent[1]], setting, ffts);
                detail += &format!(
                    ", kernel {} at {}, FFT {} x {}",
                    setting.width, setting.oversampling, nufft.x.n, nufft.y.n
                );
                if choice.method == Method::Slab {
                    let planes = Slab::<T>::planes(key.extent[2], choice.steepest, setting);
                    detail += &format!(", {planes} planes");
                    Evaluator::Slab(Slab::new(nufft, key.extent[2], choice.steepest, setting, places))
                } else {
                    Evaluator::planar(nufft, places)
                }
            }
        };
        (Self { evaluator, assembly }, detail)
    }

    /// For motion along the first axis of the frame.
    fn cone(key: &Key, frame: Frame, setting: Setting, ffts: &mut Ffts<T>) -> (Self, String) {
        let cosine = |u: Vector3<f64>| frame.of(u)[0];
        let all = (0..key.grid.len()).map(|i| cosine(unit(&key.grid, i)));
        let extent = key.extent[0];
        let (cone, assembly) = match cone_rows(key) {
            Some((rows, of)) => {
                let columns = key.grid.shape().1;
                let ring = |e: f64| (0..columns).map(move |j| cosine(direction(ring_azimuth(j, columns), e)));
                (Cone::new(extent, setting, rows.into_iter().flat_map(ring), ffts), Assembly::Rows(of))
            }
            None => (Cone::new(extent, setting, all, ffts), Assembly::Plain),
        };
        let detail = format!("kernel {} at {}, FFT {}", setting.width, setting.oversampling, cone.axis.n);
        (Self { evaluator: Evaluator::Cone(cone), assembly }, detail)
    }

    /// Directions in which the profile is evaluated.
    pub fn evaluated(&self, key: &Key) -> usize {
        match (&self.assembly, &self.evaluator) {
            (Assembly::Rings(rings), _) => rings.rings() * rings.d,
            (_, Evaluator::Cone(cone)) => cone.len(),
            _ => key.grid.len(),
        }
    }

    /// Powers times `scale`, by direction of the grid.
    pub fn powers(&self, batch: &Batch, bench: &mut Bench<T>, scale: f64, out: &mut [f64]) {
        self.evaluator.run(batch, &mut bench.buffers);
        self.assemble(bench, scale, out);
    }

    fn assemble(&self, bench: &mut Bench<T>, scale: f64, out: &mut [f64]) {
        let Bench { buffers, rings: work, .. } = bench;
        let powers = |out: &mut [f64], values: &[num_complex::Complex<T>]| {
            for (out, f) in out.iter_mut().zip(values) {
                let power: f64 = (f.re * f.re + f.im * f.im).into();
                *out = power * scale;
            }
        };
        match &self.assembly {
            Assembly::Rings(rings) => rings.powers(&buffers.values, scale, work, out),
            Assembly::Plain => powers(out, &buffers.values),
            Assembly::Rows(of) => {
                let columns = out.len() / of.len().max(1);
                for (row, out) in of.iter().zip(out.chunks_exact_mut(columns)) {
                    powers(out, &buffers.values[row * columns..][..columns]);
                }
            }
        }
    }

    #[cfg(test)]
    /// The sums, by direction of the grid.
    pub fn values(&self, batch: &Batch, bench: &mut Bench<T>, out: &mut [Complex64]) {
        self.evaluator.run(batch, &mut bench.buffers);
        let Bench { buffers, rings: work, .. } = bench;
        let mut full = buffers.values.clone();
        match &self.assembly {
            Assembly::Rings(rings) => {
                full.resize(out.len(), num_complex::Complex::new(T::of(0.0), T::of(0.0)));
                rings.values(&buffers.values, work, &mut full);
            }
            Assembly::Rows(of) => {
                let columns = out.len() / of.len();
                full = of.iter().flat_map(|row| &buffers.values[row * columns..][..columns]).copied().collect();
            }
            Assembly::Plain => {}
        }
        for (out, f) in out.iter_mut().zip(full) {
            *out = Complex64::new(f.re.into(), f.im.into());
        }
    }
}
