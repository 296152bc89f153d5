//! The profile sampled on rings of constant elevation, so densely that no maximum falls between the samples unnoticed.
//!
//! Around a ring `f` is band limited: it is summed at `2 M + 2` azimuths or a few more and interpolated. Antipodes share
//! their sums: `f(-u)` has the same terms conjugated in their phases.

use std::f64::consts::TAU;

use num_complex::Complex;

use super::scene::Scene;
use csi5300_kernels::fft::Ffts;
use csi5300_kernels::resample::{Resample, ResampleWork};
use csi5300_kernels::simd::{Real, Tier};
use csi5300_kernels::sums::{Columns, PairSum, Sines, pairs};

/// Largest change of any phase between neighbouring rings of elevation, radians: no more than 0.4 to the nearest.
pub(super) const RING_STEP: f64 = 0.8;

/// Above this many samples noise alone would be sampled as badly as rough sines are.
const ROUGH_SAMPLES: usize = 4_096;

/// FFTs and buffers of one precision.
pub(super) struct Sampler<T: Real> {
    ffts: Ffts<T>,
    columns: [Vec<T>; 5],
    /// Cosines and sines of the azimuths of a ring.
    circle: Vec<[f64; 2]>,
    directions: Vec<[T; 3]>,
    rows: Vec<Complex<T>>,
    work: ResampleWork<T>,
}

/// A sampled profile: rows of rising elevation, `ring` azimuths each from 0.
pub(super) struct Sampled {
    pub elevations: Vec<f64>,
    pub values: Vec<f64>,
}

/// Elevations from 0 to `limit` whose phases differ by at most [`RING_STEP`] from one to the next.
pub(super) fn elevation_rings(scene: &Scene, limit: f64) -> Vec<f64> {
    let change = |e: f64| TAU * (scene.radius * (1.0 - e.cos()) + scene.half_height * e.sin());
    let steps = (change(limit) / RING_STEP).ceil().max(1.0);
    let elevation = |target: f64| {
        let (mut low, mut high) = (0.0, limit);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if change(middle) < target { low = middle } else { high = middle }
        }
        high
    };
    (0..=steps as usize).map(|i| if i == 0 { 0.0 } else { elevation(change(limit) * i as f64 / steps) }).collect()
}

impl Scene {
    /// The sines that a search of these samples needs: errors count against the highest peak of noise.
    pub(super) fn sines(&self) -> Sines {
        if self.len() <= ROUGH_SAMPLES { Sines::Rough } else { Sines::Fine }
    }
}

/// How a ring is sampled.
#[derive(Clone, Copy)]
pub(super) struct Ring {
    /// Azimuths that are summed.
    pub evaluated: usize,
    /// Azimuths that are interpolated from them.
    pub dense: usize,
    /// Level motion: the antipode of a direction is on its ring.
    pub flat: bool,
}

impl<T: Real> Sampler<T> {
    pub fn new(tier: Tier) -> Self {
        let (columns, work) = (Default::default(), ResampleWork::default());
        Self { ffts: Ffts::new(tier), columns, circle: Vec::new(), directions: Vec::new(), rows: Vec::new(), work }
    }

    /// `F` on rings at the given elevations (from 0 upwards) and, unless the motion is level, at their negatives.
    pub fn sample(&mut self, tier: Tier, scene: &Scene, elevations: &[f64], ring: Ring) -> Sampled {
        if self.circle.len() != ring.evaluated {
            let angle = |j: usize| TAU * j as f64 / ring.evaluated as f64;
            self.circle = (0..ring.evaluated).map(|j| [angle(j).cos(), angle(j).sin()]).collect();
        }
        self.directions.clear();
        for &elevation in elevations {
            let (sin_el, cos_el) = elevation.sin_cos();
            let turned = |[cos, sin]: &[f64; 2]| [cos_el * cos, cos_el * sin, sin_el].map(T::of);
            self.directions.extend(self.circle[..ring.columns(elevation)].iter().map(turned));
        }
        let c = scene.columns();
        for (column, from) in self.columns.iter_mut().zip([c.x, c.y, c.z, c.re, c.im]) {
            column.clear();
            column.extend(from.iter().map(|v| T::of(*v)));
        }
        let [x, y, z, re, im] = &self.columns;
        let columns = Columns { x, y, z, re, im };
        let sums = pairs::<T>(tier.level_or_portable(), columns, &self.directions, scene.sines());
        let elevations = self.arrange(elevations, &sums, ring);
        Resample::new(ring.evaluated, ring.dense, &mut self.ffts).run(&self.rows, &mut self.work);
        let values = self.work.dense.iter().map(|f| f.norm_sqr().into()).collect();
        Sampled { elevations, values }
    }

    /// Rows of rising elevation from the sums of antipodal pairs: the antipode of (a, e) is (a + pi, -e).
    fn arrange(&mut self, elevations: &[f64], sums: &[PairSum], ring: Ring) -> Vec<f64> {
        let half = ring.evaluated / 2;
        let narrow = |c: num_complex::Complex64| Complex::new(T::of(c.re), T::of(c.im));
        self.rows.clear();
        // Below the horizon first, from the lowest ring up.
        let mut below = Vec::new();
        let mut end = sums.len();
        for &elevation in elevations.iter().rev() {
            let row = &sums[end - ring.columns(elevation)..end];
            end -= row.len();
            if row.len() == ring.evaluated {
                let (first, second) = row.split_at(half);
                self.rows.extend(second.iter().chain(first).map(|s| narrow(s.opposite())));
                below.push(-elevation);
            }
        }
        let mut rest = sums;
        for &elevation in elevations {
            let (row, tail) = rest.split_at(ring.columns(elevation));
            rest = tail;
            self.rows.extend(row.iter().map(|s| narrow(s.here())));
            if row.len() == half {
                self.rows.extend(row.iter().map(|s| narrow(s.opposite())));
            }
        }
        below.extend_from_slice(elevations);
        below
    }
}

impl Ring {
    /// Directions to be summed at an elevation: half a ring where the antipodes complete it.
    fn columns(&self, elevation: f64) -> usize {
        if self.flat || elevation == 0.0 { self.evaluated / 2 } else { self.evaluated }
    }
}
