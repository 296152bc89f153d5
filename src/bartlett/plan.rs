//! Only what the scene needs: the planner.
//!
//! A plan is chosen by the geometry of the motion, the grid, the number of samples and the tolerance; it holds every
//! table that does not depend on the samples, for a bucket of apertures (5 percent wide), and prints what it does and
//! what it leaves out.

use std::f64::consts::TAU;
use std::fmt;
use std::sync::Arc;

use nalgebra::Vector3;
use num_complex::Complex64;

use super::bessel::tail_order;
use super::direct;
use super::error::Error;
use super::evaluate::{Batch, Buffers, Evaluator, Places, Slab};
use super::fft::Ffts;
use super::grid::{Grid, Layout, Profile, direction};
use super::nufft::{Axis, Nufft, Setting};
use super::rings::{RingWork, Rings, azimuths_for, distinct, nodes_for};
use super::scene::{Geometry, Scene, ldexp};
use super::simd::{Real, Tier};
use crate::samples::Samples;

/// Plans that a planner keeps.
const KEPT: usize = 12;

/// How exact, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProfileOptions {
    /// The guarantee: every `|f~(u) - f(u)| <= eps * sum w |z|`. Default 1e-4; 0 asks for the oracle.
    pub eps: f64,
    /// Force a method instead of the cheapest. One that cannot serve the scene is replaced by the cheapest that can.
    pub method: Option<Method>,
    /// Force single or double precision instead of the narrowest that meets `eps`.
    pub precision: Option<Precision>,
}

impl Default for ProfileOptions {
    fn default() -> Self {
        Self { eps: 1e-4, method: None, precision: None }
    }
}

/// The ways to a profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Method {
    /// No motion within the tolerance: one value for all directions.
    Constant,
    /// The sum as written ([`super::oracle`]).
    Oracle,
    /// Antipodal pairs at every direction.
    Direct,
    /// Antipodal pairs on band-limited rings, then Fourier interpolation.
    RingsDirect,
    /// Planar NUFFT onto band-limited rings, then Fourier interpolation.
    RingsNufft,
    /// Planar NUFFT straight to every direction.
    TargetsNufft,
    /// Slabs of planar NUFFTs, onto rings or straight to the directions.
    Slab,
}

/// Numbers that the bulk of the work is done in; the front end is always double.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Precision {
    /// `f32`.
    Single,
    /// `f64`.
    Double,
}

/// What a plan does, what it costs and what it left out, as a value that prints.
#[derive(Clone, Debug, PartialEq)]
pub struct Explanation {
    /// The method.
    pub method: Method,
    /// The precision of the bulk of the work.
    pub precision: Precision,
    /// The SIMD tier.
    pub tier: Tier,
    /// The tolerance that it meets.
    pub eps: f64,
    /// Directions asked for.
    pub directions: usize,
    /// Directions evaluated from the samples; the others follow by interpolation or symmetry.
    pub evaluated: usize,
    /// The planner's estimate of a run, microseconds (a model, not a measurement).
    pub estimate_us: f64,
    /// Bytes of tables.
    pub table_bytes: usize,
    /// What was not computed, and why.
    pub skipped: Vec<String>,
    /// Sizes inside: kernel width, FFT lengths, band limits.
    pub detail: String,
}

impl fmt::Display for Explanation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:?} in {:?} precision on {:?}, eps {:.1e}, about {:.0} us, {} kB of tables",
            self.method,
            self.precision,
            self.tier,
            self.eps,
            self.estimate_us,
            self.table_bytes / 1024
        )?;
        writeln!(f, "  {} of {} directions evaluated; {}", self.evaluated, self.directions, self.detail)?;
        for skipped in &self.skipped {
            writeln!(f, "  skipped: {skipped}")?;
        }
        Ok(())
    }
}

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
    rings: Option<Rings<T>>,
}

/// What a plan is made for.
#[derive(Clone, Debug, PartialEq)]
struct Key {
    grid: Grid,
    options: ProfileOptions,
    /// Half extents of the box, turns, rounded up; zero for an axis that phases do not see.
    extent: [f64; 3],
    /// Largest distance from the middle, in the plane of the first two axes and at all, radians of phase, rounded up.
    radius: [f64; 2],
    /// Number of samples, rounded up.
    count: usize,
    /// Axes of the motion if they are not the frame's.
    axes: Option<[Vector3<f64>; 3]>,
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
    pub fn plan(
        &mut self,
        samples: &Samples,
        wavelength_m: f64,
        grid: &Grid,
        options: &ProfileOptions,
    ) -> Result<Arc<Plan>, Error> {
        let scene = Scene::new(samples, wavelength_m)?;
        self.plan_scene(&scene, grid, options)
    }

    /// The Bartlett profile of `samples` over `grid`.
    ///
    /// A receiver that did not move has a constant profile: that is a profile, though not a bearing.
    ///
    /// # Errors
    /// [`Error`] for input that is empty, of unequal lengths, not finite or without energy, for directions that are
    /// not finite and a tolerance below 0.
    pub fn profile(
        &mut self,
        samples: &Samples,
        wavelength_m: f64,
        grid: &Grid,
        options: &ProfileOptions,
    ) -> Result<Profile, Error> {
        let mut values = Vec::new();
        let sum_abs = self.profile_into(samples, wavelength_m, grid, options, &mut values)?;
        Ok(Profile { grid: grid.clone(), values, sum_abs })
    }

    /// [`Planner::profile`] into a vector that is reused; returns `sum w |z|`.
    ///
    /// # Errors
    /// As [`Planner::profile`].
    pub fn profile_into(
        &mut self,
        samples: &Samples,
        wavelength_m: f64,
        grid: &Grid,
        options: &ProfileOptions,
        out: &mut Vec<f64>,
    ) -> Result<f64, Error> {
        let scene = Scene::new(samples, wavelength_m)?;
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
        if let (Some(from), Some(re), Some(im)) = (anchor, batch.re.last_mut(), batch.im.last_mut()) {
            if distance(t, from) <= slack {
                *re += scene.re[t];
                *im += scene.im[t];
                continue;
            }
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

/// Rounds up to a power of `step`; nothing stays nothing.
fn bucket(extent: f64, step: f64) -> f64 {
    if extent <= 0.0 { 0.0 } else { step.powf((extent.ln() / step.ln()).ceil()) * (1.0 + 1e-12) }
}

impl Key {
    fn new(scene: &Scene, grid: &Grid, options: &ProfileOptions) -> Self {
        let steepest = grid.steepest();
        // What phases of eps / 8 do not see is not there.
        let slack = options.eps / (8.0 * TAU);
        let half = |c: &[f64]| c.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        let mut extent = [half(&scene.x), half(&scene.y), scene.half_height];
        let mut axes = None;
        if extent[2] * steepest > slack {
            let shape = scene.shape();
            let [_, wide, high] = shape.half_extent_m.map(|e| e / scene.turn_m);
            // Principal extents are about the middle of each axis, samples about that of the box: twice covers both.
            if 2.0 * high.min(wide) <= slack {
                axes = Some(shape.axes);
                extent = shape.axes.map(|a| scene.farthest(|p| a.dot(&p).abs()));
                extent[2] = 0.0;
            }
        } else {
            extent[2] = 0.0;
        }
        let level = axes.map_or(scene.radius, |[a, b, _]| scene.farthest(|p| a.dot(&p).hypot(b.dot(&p))));
        let mut radius = [level, level.hypot(extent[2])];
        if radius[1] <= slack {
            (extent, radius) = ([0.0; 3], [0.0; 2]);
        }
        let count = bucket(scene.len() as f64, 1.05).ceil() as usize;
        let radius = radius.map(|r| bucket(TAU * r, 1.02));
        Self { grid: grid.clone(), options: *options, extent: extent.map(|e| bucket(e, 1.05)), radius, count, axes }
    }
}

/// A method with what it costs and what it leaves out.
struct Choice {
    method: Method,
    precision: Precision,
    setting: Option<Setting>,
    /// Band limits in azimuth and elevation.
    order: [usize; 2],
    steepest: f64,
    cost_ns: f64,
    skipped: Vec<String>,
}

/// Nanoseconds per unit of work: (antipodal pair, kernel cell, FFT point and doubling, assembled value) in single
/// precision; double takes twice that. Measured on a Xeon with AVX-512; the portable code as SSE4.2 without rounding
/// instructions. Only their ratios matter.
fn unit_costs(tier: Tier, precision: Precision) -> [f64; 4] {
    let single = match tier {
        Tier::Avx512 => [0.35, 0.07, 0.25, 0.5],
        Tier::Avx2 => [0.6, 0.09, 0.25, 0.6],
        Tier::Sse42 | Tier::Native => [2.0, 0.2, 0.5, 1.2],
        Tier::Portable => [3.0, 0.3, 1.0, 1.6],
    };
    let factor = if precision == Precision::Single { 1.0 } else { 2.0 };
    single.map(|c| c * factor)
}

/// The least tolerance that single precision is trusted with, for a radius in radians of phase.
///
/// Direct sums round phases to 2^-24 of themselves three times; the NUFFT rounds weights and FFTs, whatever the radius.
fn single_floor(method: Method, radius: f64) -> f64 {
    match method {
        Method::Direct | Method::RingsDirect => 1e-6 + 2e-7 * radius,
        _ => 1e-5,
    }
}

fn choose(scene: &Scene, key: &Key, tier: Tier) -> Choice {
    let eps = key.options.eps;
    let mut best = Choice {
        method: Method::Oracle,
        precision: Precision::Double,
        setting: None,
        order: [usize::MAX; 2],
        steepest: key.grid.steepest(),
        cost_ns: 60.0 * key.grid.len() as f64 * key.count as f64,
        skipped: Vec::new(),
    };
    if eps > 0.0 && key.extent == [0.0; 3] {
        best.method = Method::Constant;
        best.cost_ns = key.count as f64;
        best.skipped.push(String::from("every direction but one: no motion within the tolerance, hence no bearing"));
        return best;
    }
    if eps == 0.0 || key.options.method == Some(Method::Oracle) {
        return best;
    }
    let forced = key.options.method;
    let [level_radius, radius] = key.radius;
    // Modes beyond the limit are lost and, folded back, added once more: an eighth of eps in either angle is a quarter.
    best.order = [tail_order(level_radius, eps / 8.0), tail_order(radius, eps / 8.0)];
    let mut found = false;
    for method in [Method::Direct, Method::RingsDirect, Method::RingsNufft, Method::TargetsNufft, Method::Slab] {
        let Some((precision, setting, cost)) = price(key, method, best.order, tier) else { continue };
        let wanted = forced == Some(method);
        if !found || wanted || (cost < best.cost_ns && forced != Some(best.method)) {
            (best.method, best.precision, best.setting, best.cost_ns) = (method, precision, setting, cost);
            found = true;
        }
    }
    best.skipped = skipped(scene, key, &best);
    best
}

/// What a method would cost here; none if it cannot serve.
fn price(key: &Key, method: Method, order: [usize; 2], tier: Tier) -> Option<(Precision, Option<Setting>, f64)> {
    let eps = key.options.eps;
    let [_, radius] = key.radius;
    let tall = key.extent[2] > 0.0;
    let planar_nufft = matches!(method, Method::RingsNufft | Method::TargetsNufft);
    if planar_nufft && tall || method == Method::Slab && !tall {
        return None;
    }
    let rings = ring_shape(key, order);
    if matches!(method, Method::RingsDirect | Method::RingsNufft) && rings.is_none() {
        return None;
    }
    let precision = match key.options.precision {
        Some(precision) => precision,
        None if eps >= single_floor(method, radius) => Precision::Single,
        None => Precision::Double,
    };
    let mut setting = None;
    if planar_nufft || method == Method::Slab {
        // A third dimension has a kernel of its own.
        let share = if method == Method::Slab { eps / 6.0 } else { eps / 4.0 };
        let narrow = if precision == Precision::Single { 7.5e-7 } else { 6e-14 };
        let found = Setting::for_eps(share.max(narrow), precision == Precision::Single)?;
        if share < narrow && key.options.precision.is_none() {
            return None;
        }
        setting = Some(found);
    }
    let [pair, cell, fft, assembled] = unit_costs(tier, precision);
    let n = key.count as f64;
    let all = key.grid.len() as f64;
    let ring_points = rings.map_or(0.0, |(d, nodes)| (d * nodes * if tall { 2 } else { 1 }) as f64);
    let assembly = rings.map_or(0.0, |(d, nodes)| {
        let work = all / 2.0 * nodes as f64 * 0.06 + if d * nodes < key.grid.len() { all * 0.3 } else { 0.0 };
        (work + all) * assembled
    });
    let plane = |s: Setting| {
        let [x, y] = [Axis::new(key.extent[0], s), Axis::new(key.extent[1], s)];
        let points = ((2 * y.half + 1) * x.n) as f64 + x.n as f64 / s.oversampling * y.n as f64;
        points * (points.log2() / 2.0).max(1.0) * fft + 3_000.0
    };
    let square = setting.map_or(0.0, |s| (s.width * s.width) as f64);
    let cost = match (method, setting) {
        (Method::Direct, _) => all * n * pair + all * assembled,
        (Method::RingsDirect, _) => ring_points / 2.0 * n * pair + assembly,
        (Method::RingsNufft, Some(s)) => (n * 1.5 + ring_points) * square * cell * 2.0 + plane(s) + assembly,
        (Method::TargetsNufft, Some(s)) => (n * 1.5 + all) * square * cell * 2.0 + plane(s) + all * assembled,
        (Method::Slab, Some(s)) => {
            let planes = Slab::<f64>::planes(key.extent[2], key.grid.steepest(), s) as f64;
            let points = if rings.is_some() { ring_points / 2.0 } else { all };
            let spread = n * s.width as f64 * 1.5 * square * cell * 2.0;
            spread + planes * (points * square * cell * 2.0 + plane(s)) + assembly
        }
        _ => return None,
    };
    Some((precision, setting, cost))
}

/// Azimuths and elevations that are evaluated for a grid of rings; none for a list, or for rings that cannot be had
/// in quarters.
fn ring_shape(key: &Key, order: [usize; 2]) -> Option<(usize, usize)> {
    let Layout::Rings { azimuths, elevations_rad } = &*key.grid.layout else { return None };
    if azimuths % 4 != 0 || key.axes.is_some() {
        return None;
    }
    Some((azimuths_for(*azimuths, order[0]), nodes_for(&distinct(elevations_rad), order[1]).len()))
}

/// What the chosen plan leaves out, in words.
fn skipped(scene: &Scene, key: &Key, choice: &Choice) -> Vec<String> {
    let mut list = Vec::new();
    let geometry = scene.shape().geometry;
    if key.extent[2] == 0.0
        && choice.steepest > 0.0
        && matches!(choice.method, Method::RingsDirect | Method::RingsNufft)
    {
        list.push(String::from("the lower hemisphere: level motion sees the elevation's cosine only"));
    }
    if choice.steepest == 0.0 {
        list.push(String::from("every elevation: only azimuths on the horizon were asked for"));
    }
    if key.axes.is_some() {
        list.push(String::from("the axis across a tilted plane"));
    }
    if geometry == Geometry::Line {
        list.push(String::from("the axis across the line: one cone, its mirror is the same"));
    }
    if let Some((d, nodes)) = ring_shape(key, choice.order) {
        let rings = key.grid.shape();
        if d < rings.1 && matches!(choice.method, Method::RingsDirect | Method::RingsNufft | Method::Slab) {
            list.push(format!("{} of {} azimuths per ring: band limit {}", rings.1 - d, rings.1, choice.order[0]));
        }
        if 2 * nodes < rings.0 {
            list.push(format!("all but {nodes} elevations a side: band limit {}", choice.order[1]));
        }
    }
    list
}

impl<T: Real> Core<T> {
    fn new(key: &Key, frame: Frame, choice: &Choice, tier: Tier, ffts: &mut Ffts<T>) -> (Self, String) {
        let level = tier.level_or_portable();
        let tall = key.extent[2] > 0.0;
        let use_rings = matches!(choice.method, Method::RingsDirect | Method::RingsNufft)
            || (choice.method == Method::Slab && ring_shape(key, choice.order).is_some());
        let (rings, places) = match &*key.grid.layout {
            Layout::Rings { azimuths, elevations_rad } if use_rings => {
                let rings = Rings::new(*azimuths, elevations_rad, choice.order, tall, level, ffts);
                let places = Places::Rings { d: rings.d, nodes: rings.nodes.clone(), tall };
                (Some(rings), places)
            }
            _ => (None, Places::List((0..key.grid.len()).map(|i| frame.of(unit(&key.grid, i))).collect())),
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
        (Self { evaluator, rings }, detail)
    }

    fn evaluated(&self, key: &Key) -> usize {
        self.rings.as_ref().map_or(key.grid.len(), |r| r.rings() * r.d)
    }

    fn powers(&self, batch: &Batch, bench: &mut Bench<T>, scale: f64, out: &mut [f64]) {
        self.evaluator.run(batch, &mut bench.buffers);
        self.assemble(bench, scale, out);
    }

    fn assemble(&self, bench: &mut Bench<T>, scale: f64, out: &mut [f64]) {
        let Bench { buffers, rings: work, .. } = bench;
        match &self.rings {
            Some(rings) => rings.powers(&mut buffers.values, scale, work, out),
            None => {
                for (out, f) in out.iter_mut().zip(&buffers.values) {
                    let (re, im): (f64, f64) = (f.re.into(), f.im.into());
                    *out = (re * re + im * im) * scale;
                }
            }
        }
    }

    #[cfg(test)]
    fn values(&self, batch: &Batch, bench: &mut Bench<T>, out: &mut [Complex64]) {
        self.evaluator.run(batch, &mut bench.buffers);
        let Bench { buffers, rings: work, .. } = bench;
        let mut full = buffers.values.clone();
        if let Some(rings) = &self.rings {
            full.resize(out.len(), num_complex::Complex::new(T::of(0.0), T::of(0.0)));
            rings.values(&mut buffers.values, work, &mut full);
        }
        for (out, f) in out.iter_mut().zip(full) {
            *out = Complex64::new(f.re.into(), f.im.into());
        }
    }
}
