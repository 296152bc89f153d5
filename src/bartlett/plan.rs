//! Only what the scene needs: the planner.
//!
//! A plan is chosen by the geometry of the motion, the grid, the number of samples and the tolerance; it holds every
//! table that does not depend on the samples, for a bucket of apertures (5 percent wide), and prints what it does and
//! what it leaves out.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::Vector3;
use num_complex::Complex64;

use super::choose::{Choice, Key, choose, cone_rows, ring_shape};
use super::cone::Cone;
use super::direct;
use super::error::Error;
use super::evaluate::{Batch, Buffers, Evaluator, Places, Slab};
pub use super::explain::{Explanation, Method, Precision, ProfileOptions};
use super::fft::Ffts;
use super::grid::{Grid, Layout, Profile, direction, ring_azimuth};
use super::nufft::{Nufft, Setting};
use super::rings::{RingWork, Rings};
use super::scene::{Scene, ldexp};
use crate::maths::simd::{Real, Tier};
use crate::signal::samples::Samples;

/// Plans that a planner keeps.
const KEPT: usize = 12;

/// Makes plans and keeps them for the next call.
pub struct Planner {
    tier: Tier,
    single: Bench<f32>,
    double: Bench<f64>,
    plans: Vec<Arc<Plan>>,
    built: usize,
    batch: Batch,
}

/// FFTs and buffers of one precision.
struct Bench<T: Real> {
    ffts: Ffts<T>,
    buffers: Buffers<T>,
    rings: RingWork<T>,
}

impl<T: Real> Bench<T> {
    fn new(tier: Tier) -> Self {
        Self { ffts: Ffts::new(tier), buffers: Buffers::default(), rings: RingWork::default() }
    }
}

/// A reusable plan.
pub struct Plan {
    key: Key,
    frame: Frame,
    engine: Engine,
    explanation: Explanation,
}

enum Engine {
    Constant,
    Oracle,
    Single(Core<f32>),
    Double(Core<f64>),
}

/// Evaluation and, for a grid of rings, what makes rows of it.
struct Core<T: Real> {
    evaluator: Evaluator<T>,
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
enum Frame {
    Given,
    Turned([Vector3<f64>; 3]),
}

impl Frame {
    fn of(self, u: Vector3<f64>) -> [f64; 3] {
        match self {
            Self::Given => u.into(),
            Self::Turned(axes) => axes.map(|a| a.dot(&u)),
        }
    }
}

impl Plan {
    /// What this plan does and what it leaves out.
    #[must_use]
    pub fn explain(&self) -> &Explanation {
        &self.explanation
    }
}

impl Default for Planner {
    fn default() -> Self {
        Self::new(Tier::detect())
    }
}

impl Planner {
    /// A planner for a tier; one that this machine lacks runs the portable code.
    #[must_use]
    pub fn new(tier: Tier) -> Self {
        let tier = if tier.level().is_some() { tier } else { Tier::Portable };
        Self {
            tier,
            single: Bench::new(tier),
            double: Bench::new(tier),
            plans: Vec::new(),
            built: 0,
            batch: Batch::default(),
        }
    }

    /// Plans built so far: calls that found one they could use built none.
    #[must_use]
    pub fn built(&self) -> usize {
        self.built
    }

    /// The plan for these samples: one at hand, or a new one.
    ///
    /// # Errors
    /// As [`Planner::profile`].
    pub fn plan(&mut self, samples: &Samples, grid: &Grid, options: &ProfileOptions) -> Result<Arc<Plan>, Error> {
        let scene = Scene::on(self.tier, samples)?;
        self.plan_scene(&scene, grid, options)
    }

    /// The Bartlett profile of `samples` over `grid`.
    ///
    /// A receiver that did not move has a constant profile: that is a profile, though not a bearing.
    ///
    /// # Errors
    /// [`Error`] for input that is empty or without energy, for positions not finite in wavelengths, for directions that are
    /// not finite and a tolerance below 0.
    pub fn profile(&mut self, samples: &Samples, grid: &Grid, options: &ProfileOptions) -> Result<Profile, Error> {
        let mut values = Vec::new();
        let sum_abs = self.profile_into(samples, grid, options, &mut values)?;
        Ok(Profile { grid: grid.clone(), values, sum_abs })
    }

    /// [`Planner::profile`] into a vector that is reused; returns `sum w |z|`.
    ///
    /// # Errors
    /// As [`Planner::profile`].
    pub fn profile_into(
        &mut self,
        samples: &Samples,
        grid: &Grid,
        options: &ProfileOptions,
        out: &mut Vec<f64>,
    ) -> Result<f64, Error> {
        let scene = Scene::on(self.tier, samples)?;
        let plan = self.plan_scene(&scene, grid, options)?;
        out.resize(grid.len(), 0.0);
        self.run(&plan, &scene, out);
        Ok(ldexp(scene.sum_abs, -scene.exponent))
    }

    /// Powers relative to `(sum w |z|)^2`.
    fn run(&mut self, plan: &Plan, scene: &Scene, out: &mut [f64]) {
        let scale = 1.0 / (scene.sum_abs * scene.sum_abs);
        match &plan.engine {
            Engine::Constant => out.fill(constant(scene).norm_sqr() * scale),
            Engine::Oracle => {
                for (index, out) in out.iter_mut().enumerate() {
                    *out = direct::sum(scene, &unit(&plan.key.grid, index)).norm_sqr() * scale;
                }
            }
            Engine::Single(core) => {
                load(scene, plan, &mut self.batch);
                core.powers(&self.batch, &mut self.single, scale, out);
            }
            Engine::Double(core) => {
                load(scene, plan, &mut self.batch);
                core.powers(&self.batch, &mut self.double, scale, out);
            }
        }
    }

    /// The sums themselves, of the scaled samples: what the guarantee is about.
    #[cfg(test)]
    pub(crate) fn sums(&mut self, plan: &Plan, scene: &Scene) -> Vec<Complex64> {
        let mut out = vec![Complex64::ZERO; plan.key.grid.len()];
        match &plan.engine {
            Engine::Constant => out.fill(constant(scene)),
            Engine::Oracle => {
                for (index, out) in out.iter_mut().enumerate() {
                    *out = direct::sum(scene, &unit(&plan.key.grid, index));
                }
            }
            Engine::Single(core) => {
                load(scene, plan, &mut self.batch);
                core.values(&self.batch, &mut self.single, &mut out);
            }
            Engine::Double(core) => {
                load(scene, plan, &mut self.batch);
                core.values(&self.batch, &mut self.double, &mut out);
            }
        }
        out
    }

    pub(crate) fn plan_scene(
        &mut self,
        scene: &Scene,
        grid: &Grid,
        options: &ProfileOptions,
    ) -> Result<Arc<Plan>, Error> {
        grid.check()?;
        if options.eps.is_nan() || options.eps < 0.0 {
            return Err(Error::Tolerance { eps: options.eps });
        }
        let key = Key::new(scene, grid, options);
        if let Some(position) = self.plans.iter().position(|p| p.key == key) {
            // The most recently used one moves to the back.
            self.plans[position..].rotate_left(1);
            if let Some(plan) = self.plans.last() {
                return Ok(Arc::clone(plan));
            }
        }
        let plan = Arc::new(self.build(scene, key));
        self.built += 1;
        if self.plans.len() == KEPT {
            self.plans.remove(0);
        }
        self.plans.push(Arc::clone(&plan));
        Ok(plan)
    }

    fn build(&mut self, scene: &Scene, key: Key) -> Plan {
        let choice = choose(scene, &key, self.tier);
        let frame = key.axes.map_or(Frame::Given, Frame::Turned);
        let (engine, table_bytes, evaluated, detail) = match (choice.method, choice.precision) {
            (Method::Constant, _) => (Engine::Constant, 0, 1, String::from("one value")),
            (Method::Oracle, _) => (Engine::Oracle, 0, key.grid.len(), String::from("no shortcut")),
            (_, Precision::Single) => {
                let (core, detail) = Core::new(&key, frame, &choice, self.tier, &mut self.single.ffts);
                let (bytes, count) = (core.evaluator.bytes(), core.evaluated(&key));
                (Engine::Single(core), bytes, count, detail)
            }
            (_, Precision::Double) => {
                let (core, detail) = Core::new(&key, frame, &choice, self.tier, &mut self.double.ffts);
                let (bytes, count) = (core.evaluator.bytes(), core.evaluated(&key));
                (Engine::Double(core), bytes, count, detail)
            }
        };
        let explanation = Explanation {
            method: choice.method,
            precision: choice.precision,
            tier: self.tier,
            eps: key.options.eps,
            directions: key.grid.len(),
            evaluated,
            estimate_us: choice.cost_ns / 1e3,
            table_bytes,
            skipped: choice.skipped,
            detail,
        };
        Plan { key, frame, engine, explanation }
    }
}

fn unit(grid: &Grid, index: usize) -> Vector3<f64> {
    let (azimuth, elevation) = grid.at(index);
    direction(azimuth, elevation)
}

/// `f` where all positions are one.
fn constant(scene: &Scene) -> Complex64 {
    Complex64::new(scene.re.iter().sum(), scene.im.iter().sum())
}

/// Samples in the axes of the plan, near-static runs merged within the tolerance.
fn load(scene: &Scene, plan: &Plan, batch: &mut Batch) {
    // A run's positions within `slack` turns of its first cost at most eps / 16 of their magnitudes.
    let slack = plan.key.options.eps / (16.0 * TAU);
    let flat = plan.key.extent[2] == 0.0;
    let near = |c: &[f64], t: usize, from: usize| (c[t] - c[from]).abs();
    let distance = |t: usize, from: usize| near(&scene.x, t, from) + near(&scene.y, t, from) + near(&scene.z, t, from);
    for column in [&mut batch.x, &mut batch.y, &mut batch.z, &mut batch.re, &mut batch.im] {
        column.clear();
    }
    let still = (1..scene.len()).fold(false, |any, t| any | (distance(t, t - 1) <= slack));
    if !still && plan.frame == Frame::Given {
        batch.x.extend_from_slice(&scene.x);
        batch.y.extend_from_slice(&scene.y);
        batch.z.extend_from_slice(if flat { &[] } else { &scene.z });
        batch.re.extend_from_slice(&scene.re);
        batch.im.extend_from_slice(&scene.im);
        return;
    }
    let mut anchor = None;
    for t in 0..scene.len() {
        if let (Some(from), Some(re), Some(im)) = (anchor, batch.re.last_mut(), batch.im.last_mut())
            && distance(t, from) <= slack
        {
            *re += scene.re[t];
            *im += scene.im[t];
            continue;
        }
        anchor = Some(t);
        let [x, y, z] = plan.frame.of(Vector3::new(scene.x[t], scene.y[t], scene.z[t]));
        batch.x.push(x);
        batch.y.push(y);
        if !flat {
            batch.z.push(z);
        }
        batch.re.push(scene.re[t]);
        batch.im.push(scene.im[t]);
    }
}

impl<T: Real> Core<T> {
    fn new(key: &Key, frame: Frame, choice: &Choice, tier: Tier, ffts: &mut Ffts<T>) -> (Self, String) {
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

    fn evaluated(&self, key: &Key) -> usize {
        match (&self.assembly, &self.evaluator) {
            (Assembly::Rings(rings), _) => rings.rings() * rings.d,
            (_, Evaluator::Cone(cone)) => cone.len(),
            _ => key.grid.len(),
        }
    }

    fn powers(&self, batch: &Batch, bench: &mut Bench<T>, scale: f64, out: &mut [f64]) {
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
    fn values(&self, batch: &Batch, bench: &mut Bench<T>, out: &mut [Complex64]) {
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
