//! The planner: the cheapest method for a scene and a tolerance, and plans kept for the next call.
//!
//! A plan is chosen by the geometry of the motion, the grid, the number of samples and the tolerance; it holds every
//! table that does not depend on the samples, for a bucket of apertures (5 percent wide), and prints what it does and
//! what it leaves out.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::Vector3;
use num_complex::Complex64;

use super::choose::choose;
use super::direct;
use super::error::Error;
use super::explain::{Explanation, Method, Precision, ProfileOptions};
use super::grid::{Grid, Profile};
use super::key::Key;
use super::plan::{Bench, Core, Engine, Frame, Plan, unit};
use super::scene::{Scene, ldexp};
use crate::signal::samples::Samples;
use csi5300_kernels::evaluate::Batch;
use csi5300_kernels::simd::Tier;

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
    #[cfg(test)]
    pub(crate) fn built(&self) -> usize {
        self.built
    }

    /// What [`Planner::profile`] would compute of these samples, and what not. Its plan is kept for the next call.
    ///
    /// # Errors
    /// As [`Planner::profile`].
    pub fn explain(&mut self, samples: &Samples, grid: &Grid, options: &ProfileOptions) -> Result<Explanation, Error> {
        let scene = Scene::on(self.tier, samples)?;
        Ok(self.plan_scene(&scene, grid, options)?.explanation.clone())
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
