//! The planner: the cheapest method for a scene and a tolerance, and plans kept for the next call.
//!
//! A plan is chosen by the geometry of the motion, the grid, the number of samples and the tolerance; it holds every
//! table that does not depend on the samples, for a bucket of apertures (5 percent wide), and prints what it does and
//! what it leaves out.

use super::scene::{Geometry, Scene, ldexp};
use super::{Error, Grid, Layout, Profile, direction, ring_azimuth};
use crate::signal::samples::Samples;
use csi5300_kernels::evaluate::{Batch, Buffers, Evaluator, Places, Slab};
use csi5300_kernels::fft::Ffts;
use csi5300_kernels::nufft::{Axis, Cone, Nufft, Setting};
use csi5300_kernels::rings::{RingWork, Rings, azimuths_for, distinct, nodes_for};
use csi5300_kernels::simd::{Real, Tier};
use nalgebra::Vector3;
use num_complex::Complex64;
use serde::Serialize;
use std::f64::consts::TAU;
use std::fmt;
use std::sync::Arc;

/// Plans that a planner keeps.
const KEPT: usize = 12;

/// Makes plans and keeps them for the next call.
pub struct Planner {
    tier: Tier,
    single: Bench<f32>,
    double: Bench<f64>,
    plans: Vec<Arc<Plan>>,
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
        Self { tier, single: Bench::new(tier), double: Bench::new(tier), plans: Vec::new(), batch: Batch::default() }
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
                    *out = oracle_sum(scene, &unit(&plan.key.grid, index)).norm_sqr() * scale;
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

    fn plan_scene(&mut self, scene: &Scene, grid: &Grid, options: &ProfileOptions) -> Result<Arc<Plan>, Error> {
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
        if self.plans.len() == KEPT {
            self.plans.remove(0);
        }
        self.plans.push(Arc::clone(&plan));
        Ok(plan)
    }

    fn build(&mut self, scene: &Scene, key: Key) -> Plan {
        let choice = choose(scene, &key, self.tier);
        let (engine, table_bytes, evaluated, detail) = match (choice.method, choice.precision) {
            (Method::Constant, _) => (Engine::Constant, 0, 1, String::from("one value")),
            (Method::Oracle, _) => (Engine::Oracle, 0, key.grid.len(), String::from("no shortcut")),
            (_, Precision::Single) => {
                let (core, detail) = Core::new(&key, &choice, self.tier, &mut self.single.ffts);
                let (bytes, count) = (core.evaluator.bytes(), core.evaluated(&key));
                (Engine::Single(core), bytes, count, detail)
            }
            (_, Precision::Double) => {
                let (core, detail) = Core::new(&key, &choice, self.tier, &mut self.double.ffts);
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
        Plan { key, engine, explanation }
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
    if !still && plan.key.axes.is_none() {
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
        let [x, y, z] = plan.key.in_axes(Vector3::new(scene.x[t], scene.y[t], scene.z[t]));
        batch.x.push(x);
        batch.y.push(y);
        if !flat {
            batch.z.push(z);
        }
        batch.re.push(scene.re[t]);
        batch.im.push(scene.im[t]);
    }
}

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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum Method {
    /// No motion within the tolerance: one value for all directions.
    Constant,
    /// The sum as written, in double, phases exact to the last bit; a tolerance of 0 takes it.
    Oracle,
    /// Antipodal pairs at every direction.
    Direct,
    /// Antipodal pairs on band-limited rings, then Fourier interpolation.
    RingsDirect,
    /// Planar NUFFT onto band-limited rings, then Fourier interpolation.
    RingsNufft,
    /// Planar NUFFT straight to every direction.
    TargetsNufft,
    /// A one-dimensional NUFFT over the cosine to a line of motion.
    Cone,
    /// Slabs of planar NUFFTs, onto rings or straight to the directions.
    Slab,
}

/// Numbers that the bulk of the work is done in; the front end is always double.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum Precision {
    /// `f32`.
    Single,
    /// `f64`.
    Double,
}

/// A plan's method, precision and instructions.
fn words(method: Method) -> &'static str {
    match method {
        Method::Constant => "one value for all directions",
        Method::Oracle => "the sum as written",
        Method::Direct => "direct sums at every direction",
        Method::RingsDirect => "direct sums on rings, interpolated",
        Method::RingsNufft => "a planar NUFFT onto rings, interpolated",
        Method::TargetsNufft => "a planar NUFFT to every direction",
        Method::Cone => "a one-dimensional NUFFT along the line of motion",
        Method::Slab => "slabs of planar NUFFTs",
    }
}

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Single => "single",
            Self::Double => "double",
        })
    }
}

pub(super) fn instructions(tier: Tier) -> &'static str {
    match tier {
        Tier::Portable => "portable code",
        Tier::Sse42 => "SSE4.2",
        Tier::Avx2 => "AVX2",
        Tier::Avx512 => "AVX-512",
        Tier::Native => "this machine's own vectors",
    }
}

/// The steps, cost and skipped parts of a plan, as a value that prints.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Explanation {
    /// The method.
    #[doc(hidden)]
    pub method: Method,
    /// The precision of the bulk of the work.
    #[doc(hidden)]
    pub precision: Precision,
    /// The SIMD tier.
    pub tier: Tier,
    /// The tolerance that it meets.
    pub eps: f64,
    /// Requested directions.
    pub directions: usize,
    /// Directions evaluated from the samples; the others follow by interpolation or symmetry.
    pub evaluated: usize,
    /// The planner's estimate of a run, microseconds (a model, not a measurement).
    pub estimate_us: f64,
    /// Bytes of tables.
    pub table_bytes: usize,
    /// The directions not computed, and why.
    pub skipped: Vec<String>,
    /// Sizes inside: kernel width, FFT lengths, band limits.
    pub detail: String,
}

impl fmt::Display for Explanation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} in {} precision with {}, eps {:.1e}, about {:.0} us, {} kB of tables",
            words(self.method),
            self.precision,
            instructions(self.tier),
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

/// A method with its cost and its skipped parts.
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

/// What the planner chooses from where there is motion and a tolerance.
const METHODS: [Method; 6] =
    [Method::Direct, Method::RingsDirect, Method::RingsNufft, Method::TargetsNufft, Method::Slab, Method::Cone];

fn choose(scene: &Scene, key: &Key, tier: Tier) -> Choice {
    let eps = key.options.eps;
    let mut best = Choice {
        method: Method::Oracle,
        precision: Precision::Double,
        setting: None,
        order: [usize::MAX; 2],
        steepest: key.grid.steepest,
        cost_ns: ORACLE_TERM_NS * key.grid.len() as f64 * key.count as f64,
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
    for method in METHODS {
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
    if key.axes.is_some() && !key.line {
        list.push(String::from("the axis across a tilted plane"));
    }
    if key.line {
        list.push(String::from("both axes across the line: one cosine, so a direction and its mirror are the same"));
    } else if geometry == Geometry::Line {
        list.push(String::from("little: along the line it wobbles by more than the tolerance lets pass"));
    }
    if choice.method == Method::Cone && cone_rows(key).is_some_and(|(rows, of)| rows.len() < of.len()) {
        list.push(String::from("the lower hemisphere: the line is level"));
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

/// The oracle: one term, a sine and a cosine to the last bit with the phase reduced exactly, nanoseconds.
const ORACLE_TERM_NS: f64 = 60.0;
/// A complex cell of a kernel's square in units of a real one.
const COMPLEX: f64 = 2.0;
/// Spreading a sample onto a kernel's square in units of interpolating from one: it reads and writes.
const SPREAD: f64 = 1.5;
/// The same for a kernel in one dimension, where weights are a larger share.
const SPREAD_LINE: f64 = 3.0;
/// A term of the interpolation over elevations (a node for a pair of mirrored values), in units of an assembled value.
const ELEVATION_TERM: f64 = 0.06;
/// The interpolation over azimuths by FFT, in units of an assembled value each.
const AZIMUTH_FFT: f64 = 0.3;
/// What a transform of a plane takes however small it is, nanoseconds.
const PLANE_NS: f64 = 3_000.0;
/// Half the doublings of a transform in one dimension: those of 256 points, whatever its size.
const LINE_DOUBLINGS: f64 = 4.0;
/// The least tolerance that a kernel can be had for, in single precision and in double.
const NARROWEST: [f64; 2] = [7.5e-7, 6e-14];

/// Nanoseconds per unit of work.
///
/// Only ratios matter: the planner takes the cheapest method, and its explanation prints the estimate. Constants are measured (`cargo bench
/// --bench pareto` prints the time of every method beside each other, forced ones included); a wrong one costs time, never accuracy.
#[derive(Clone, Copy)]
struct UnitCosts {
    /// An antipodal pair of terms: one sine and cosine, two complex products.
    pair: f64,
    /// A real cell of a kernel's square.
    cell: f64,
    /// A point of an FFT for each two doublings of its size.
    fft: f64,
    /// A value of the profile put into its place and squared.
    assembled: f64,
}

impl UnitCosts {
    /// Measured in single precision on a Xeon and an EPYC with AVX-512; double takes twice that. The portable code is that
    /// of SSE4.2 without its rounding instructions.
    fn of(tier: Tier, precision: Precision) -> Self {
        let [pair, cell, fft, assembled] = match tier {
            Tier::Avx512 => [0.27, 0.07, 0.25, 0.5],
            Tier::Avx2 => [0.5, 0.09, 0.25, 0.6],
            Tier::Sse42 | Tier::Native => [1.45, 0.14, 0.39, 0.95],
            Tier::Portable => [3.0, 0.3, 1.0, 1.6],
        };
        let factor = if precision == Precision::Single { 1.0 } else { 2.0 };
        Self { pair: pair * factor, cell: cell * factor, fft: fft * factor, assembled: assembled * factor }
    }
}

/// An antipodal pair of terms of a direct sum, nanoseconds.
pub(super) fn pair_ns(tier: Tier, precision: Precision) -> f64 {
    UnitCosts::of(tier, precision).pair
}

/// The least tolerance that single precision is trusted with, for a radius in radians of phase.
///
/// Direct sums round phases to 2^-24 of themselves three times: measured on single packets, 0.4 of this floor. The NUFFT
/// rounds weights and FFTs, whatever the radius: measured, 3e-7 at 0.03 m, with room for kernels and many packets.
fn single_floor(method: Method, radius: f64) -> f64 {
    match method {
        Method::Direct | Method::RingsDirect => 1e-6 + 2e-7 * radius,
        _ => 1e-5,
    }
}

/// What a method would cost here, nanoseconds, with its precision and its kernel; none if it cannot serve.
fn price(key: &Key, method: Method, order: [usize; 2], tier: Tier) -> Option<(Precision, Option<Setting>, f64)> {
    let tall = key.extent[2] > 0.0;
    let rings = ring_shape(key, order);
    let serves = match method {
        Method::RingsDirect => rings.is_some(),
        Method::RingsNufft => rings.is_some() && !tall,
        Method::TargetsNufft => !tall,
        Method::Slab => tall,
        Method::Cone => key.line,
        _ => true,
    };
    if !serves {
        return None;
    }
    let precision = match key.options.precision {
        Some(precision) => precision,
        None if key.options.eps >= single_floor(method, key.radius[1]) => Precision::Single,
        None => Precision::Double,
    };
    let setting = match method {
        Method::Direct | Method::RingsDirect => None,
        _ => Some(kernel(key, method, precision)?),
    };
    let cost = Work { key, rings, unit: UnitCosts::of(tier, precision) }.cost_ns(method, setting)?;
    Some((precision, setting, cost))
}

/// The kernel of a method; none if it cannot be accurate enough.
fn kernel(key: &Key, method: Method, precision: Precision) -> Option<Setting> {
    let eps = key.options.eps;
    // A third dimension has a kernel of its own.
    let share = if method == Method::Slab { eps / 6.0 } else { eps / 4.0 };
    let single = precision == Precision::Single;
    let narrow = if single { NARROWEST[0] } else { NARROWEST[1] };
    let found = Setting::for_eps(share.max(narrow), single)?;
    (share >= narrow || key.options.precision.is_some()).then_some(found)
}

/// The work that a plan for a key has.
struct Work<'a> {
    key: &'a Key,
    /// Azimuths and elevations that are evaluated for a grid of rings.
    rings: Option<(usize, usize)>,
    unit: UnitCosts,
}

impl Work<'_> {
    fn cost_ns(&self, method: Method, setting: Option<Setting>) -> Option<f64> {
        let UnitCosts { pair, cell, assembled, .. } = self.unit;
        let (n, all) = (self.key.count as f64, self.key.grid.len() as f64);
        let ring_points = self.ring_points();
        let square = setting.map_or(0.0, |s| (s.width * s.width) as f64);
        Some(match (method, setting) {
            (Method::Direct, _) => all * n * pair + all * assembled,
            (Method::RingsDirect, _) => ring_points / 2.0 * n * pair + self.assembly(),
            (Method::RingsNufft, Some(s)) => {
                (n * SPREAD + ring_points) * square * cell * COMPLEX + self.plane(s) + self.assembly()
            }
            (Method::TargetsNufft, Some(s)) => {
                (n * SPREAD + all) * square * cell * COMPLEX + self.plane(s) + all * assembled
            }
            (Method::Cone, Some(s)) => self.cone(s),
            (Method::Slab, Some(s)) => {
                let planes = Slab::<f64>::planes(self.key.extent[2], self.key.grid.steepest, s) as f64;
                let points = if self.rings.is_some() { ring_points / 2.0 } else { all };
                let spread = n * s.width as f64 * SPREAD * square * cell * COMPLEX;
                spread + planes * (points * square * cell * COMPLEX + self.plane(s)) + self.assembly()
            }
            _ => return None,
        })
    }

    /// Directions that are evaluated for a grid of rings.
    fn ring_points(&self) -> f64 {
        let sides = if self.key.extent[2] > 0.0 { 2 } else { 1 };
        self.rings.map_or(0.0, |(d, nodes)| (d * nodes * sides) as f64)
    }

    /// From the rings that were evaluated to the grid.
    fn assembly(&self) -> f64 {
        let all = self.key.grid.len();
        self.rings.map_or(0.0, |(d, nodes)| {
            let azimuths = if d * nodes < all { all as f64 * AZIMUTH_FFT } else { 0.0 };
            let work = all as f64 / 2.0 * nodes as f64 * ELEVATION_TERM + azimuths;
            (work + all as f64) * self.unit.assembled
        })
    }

    /// The transform of a plane.
    fn plane(&self, s: Setting) -> f64 {
        let [x, y] = [Axis::new(self.key.extent[0], s), Axis::new(self.key.extent[1], s)];
        let points = ((2 * y.half + 1) * x.n) as f64 + x.n as f64 / s.oversampling * y.n as f64;
        points * (points.log2() / 2.0).max(1.0) * self.unit.fft + PLANE_NS
    }

    /// Motion along a line: a transform in one dimension.
    fn cone(&self, s: Setting) -> f64 {
        let UnitCosts { cell, fft, assembled, .. } = self.unit;
        let all = self.key.grid.len() as f64;
        // Whole vectors of the kernel are computed.
        let width = s.width.next_multiple_of(8) as f64;
        let rows = cone_rows(self.key);
        let n = self.key.count as f64 * SPREAD_LINE
            + rows.map_or(all, |(rows, _)| (rows.len() * self.key.grid.shape().1) as f64);
        n * width * cell * COMPLEX + Axis::new(self.key.extent[0], s).n as f64 * LINE_DOUBLINGS * fft + all * assembled
    }
}

/// A reusable plan.
struct Plan {
    key: Key,
    engine: Engine,
    explanation: Explanation,
}

/// How the values are computed.
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

/// The unit vector of a direction of the grid.
fn unit(grid: &Grid, index: usize) -> Vector3<f64> {
    let (azimuth, elevation) = grid.at(index);
    direction(azimuth, elevation)
}

impl<T: Real> Core<T> {
    fn new(key: &Key, choice: &Choice, tier: Tier, ffts: &mut Ffts<T>) -> (Self, String) {
        if let (Method::Cone, Some(setting)) = (choice.method, choice.setting) {
            return Self::cone(key, setting, ffts);
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
            _ => {
                (Assembly::Plain, Places::List((0..key.grid.len()).map(|i| key.in_axes(unit(&key.grid, i))).collect()))
            }
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

    /// For motion along the first of the axes.
    fn cone(key: &Key, setting: Setting, ffts: &mut Ffts<T>) -> (Self, String) {
        let cosine = |u: Vector3<f64>| key.in_axes(u)[0];
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
    fn evaluated(&self, key: &Key) -> usize {
        match (&self.assembly, &self.evaluator) {
            (Assembly::Rings(rings), _) => rings.rings() * rings.d,
            (_, Evaluator::Cone(cone)) => cone.len(),
            _ => key.grid.len(),
        }
    }

    /// Powers times `scale`, by direction of the grid.
    fn powers(&self, batch: &Batch, bench: &mut Bench<T>, scale: f64, out: &mut [f64]) {
        self.evaluator.run(batch, &mut bench.buffers);
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
}

/// Ratio of one bucket of extents, and of numbers of samples, to the next: tables are at most 5 percent too large.
const EXTENT_STEP: f64 = 1.05;
/// Ratio of one bucket of radii to the next: band limits are at most 2 percent too high.
const RADIUS_STEP: f64 = 1.02;

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
    /// True for motion along the first of the axes and nothing else.
    line: bool,
}

/// The axes of a motion along a line from which no sample is further than `slack` turns, and its half extent.
fn line(scene: &Scene, slack: f64) -> Option<([Vector3<f64>; 3], f64)> {
    let at = |t: usize| Vector3::new(scene.x[t], scene.y[t], scene.z[t]);
    // Three samples tell most motions that are none.
    let last = scene.len() - 1;
    let (chord, middle) = (at(last) - at(0), at(last / 3) - at(0));
    if chord.cross(&middle).norm() > 4.0 * slack * chord.norm().max(middle.norm()) {
        return None;
    }
    let mut axes = scene.shape().axes;
    if scene.half_height == 0.0 {
        // Level to the last bit.
        axes[0] = Vector3::new(axes[0].x, axes[0].y, 0.0).normalize();
    }
    let axis = axes[0];
    let away = scene.farthest(|p| (p - axis * axis.dot(&p)).norm());
    (away <= slack).then(|| (axes, scene.farthest(|p| axis.dot(&p).abs())))
}

/// Rounds up to a power of `step`; nothing stays nothing.
fn bucket(extent: f64, step: f64) -> f64 {
    if extent <= 0.0 { 0.0 } else { step.powf((extent.ln() / step.ln()).ceil()) * (1.0 + 1e-12) }
}

impl Key {
    fn new(scene: &Scene, grid: &Grid, options: &ProfileOptions) -> Self {
        // What phases of eps / 8 do not see is not there.
        let slack = options.eps / (8.0 * TAU);
        let line = line(scene, slack);
        let (axes, mut extent) = frame(scene, line, grid.steepest, slack);
        let level = axes.map_or(scene.radius, |[a, b, _]| scene.farthest(|p| a.dot(&p).hypot(b.dot(&p))));
        let mut radius = [level, level.hypot(extent[2])];
        if radius[1] <= slack {
            (extent, radius) = ([0.0; 3], [0.0; 2]);
        }
        let count = bucket(scene.len() as f64, EXTENT_STEP).ceil() as usize;
        let radius = radius.map(|r| bucket(TAU * r, RADIUS_STEP));
        let extent = extent.map(|e| bucket(e, EXTENT_STEP));
        Self { grid: grid.clone(), options: *options, extent, radius, count, axes, line: line.is_some() }
    }

    /// A place or a direction in the axes of the motion.
    fn in_axes(&self, u: Vector3<f64>) -> [f64; 3] {
        self.axes.map_or(u.into(), |axes| axes.map(|a| a.dot(&u)))
    }
}

/// The axes of the motion, if they are not to be the frame's, and its half extents along them, turns: zero for an axis in
/// which it is within `slack` turns.
fn frame(
    scene: &Scene,
    line: Option<([Vector3<f64>; 3], f64)>,
    steepest: f64,
    slack: f64,
) -> (Option<[Vector3<f64>; 3]>, [f64; 3]) {
    if let Some((along, half)) = line {
        return (Some(along), [half, 0.0, 0.0]);
    }
    let half = |c: &[f64]| c.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    let mut extent = [half(&scene.x), half(&scene.y), scene.half_height];
    if extent[2] * steepest <= slack {
        extent[2] = 0.0;
        return (None, extent);
    }
    let shape = scene.shape();
    let [_, wide, high] = shape.half_extent_m.map(|e| e / scene.turn_m);
    // Principal extents are about the middle of each axis, samples about that of the box: twice covers both.
    if 2.0 * high.min(wide) > slack {
        return (None, extent);
    }
    extent = shape.axes.map(|a| scene.farthest(|p| a.dot(&p).abs()));
    extent[2] = 0.0;
    (Some(shape.axes), extent)
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

/// For a level line and a grid of rings: the rows that are computed, and for each row of the grid which of those it is.
fn cone_rows(key: &Key) -> Option<(Vec<f64>, Vec<usize>)> {
    let Layout::Rings { elevations_rad, .. } = &*key.grid.layout else { return None };
    if !(key.line && key.axes.is_some_and(|[along, ..]| along.z == 0.0)) {
        return None;
    }
    let rows = distinct(elevations_rad);
    let nearest = |e: &f64| rows.iter().position(|row| (row - e.abs()).abs() < 1e-14).unwrap_or(0);
    let of = elevations_rad.iter().map(nearest).collect();
    Some((rows, of))
}

/// The least `M` with `2 sum_{m > M} |J_m(x)| <= eps`, for `x >= 0`.
///
/// By Jacobi and Anger \[jacobi-anger\] `exp(j x cos a) = sum_m j^m J_m(x) exp(j m a)`: a sample at `x` radians from the middle of a
/// circle of directions needs the modes up to `M` and leaves out at most `eps`. Since `J_m` for `m > x` rises with `x`,
/// the largest radius of a trajectory bounds all of it.
pub(super) fn tail_order(x: f64, eps: f64) -> usize {
    let eps = eps.clamp(1e-17, 1.0);
    // Far enough that everything beyond is below 1e-18: |J_m(x)| falls faster than any power beyond m = x, over a
    // transition of width x^(1/3).
    let top = (x + 16.0 * x.cbrt() + 40.0).ceil() as usize;
    let values = bessel_j(x, top);
    let mut tail = 0.0;
    for m in (1..=top).rev() {
        tail += 2.0 * values[m].abs();
        if tail > eps {
            return m;
        }
    }
    0
}

/// `J_0(x) .. J_top(x)` by Miller's backward recurrence \[miller-recurrence\], normalised by `J_0 + 2 sum J_2k = 1`.
fn bessel_j(x: f64, top: usize) -> Vec<f64> {
    let mut values = vec![0.0; top + 1];
    if x == 0.0 {
        values[0] = 1.0;
        return values;
    }
    // Deep enough in the decay that the arbitrary starting value has died out.
    let start = (top + 20).max((x + 16.0 * x.cbrt() + 60.0) as usize).next_multiple_of(2);
    let (mut above, mut here, mut norm) = (0.0f64, 1e-300f64, 0.0f64);
    for m in (1..=start).rev() {
        let below = 2.0 * m as f64 / x * here - above;
        (above, here) = (here, below);
        if here.abs() > 1e250 {
            above *= 1e-250;
            here *= 1e-250;
            norm *= 1e-250;
            values.iter_mut().for_each(|v| *v *= 1e-250);
        }
        if m - 1 <= top {
            values[m - 1] = here;
        }
        if (m - 1) % 2 == 0 {
            norm += if m == 1 { here } else { 2.0 * here };
        }
    }
    values.iter_mut().for_each(|v| *v /= norm);
    values
}

/// `a * b` as a rounded product and its rounding error \[dekker1971\].
fn two_product(a: f64, b: f64) -> (f64, f64) {
    let p = a * b;
    (p, a.mul_add(b, -p))
}

/// The phase `q . u` in turns, reduced to about one turn around 0 before anything is lost.
fn turns(q: [f64; 3], u: &Vector3<f64>) -> f64 {
    let (mut whole, mut rest) = (0.0, 0.0);
    for (a, b) in q.into_iter().zip([u.x, u.y, u.z]) {
        let (product, error) = two_product(a, b);
        whole += product - product.round();
        rest += error - error.round();
    }
    whole + rest
}

/// A sum with Neumaier's compensation \[neumaier1974\].
#[derive(Clone, Copy, Default)]
struct Compensated {
    sum: f64,
    lost: f64,
}

impl Compensated {
    fn add(&mut self, term: f64) {
        let total = self.sum + term;
        self.lost += if self.sum.abs() >= term.abs() { (self.sum - total) + term } else { (term - total) + self.sum };
        self.sum = total;
    }

    fn value(self) -> f64 {
        self.sum + self.lost
    }
}

/// `f(u) = sum_t z_t exp(-j 2 pi q_t . u)` over the scaled samples of `scene`.
pub(super) fn oracle_sum(scene: &Scene, u: &Vector3<f64>) -> Complex64 {
    let (mut re, mut im) = (Compensated::default(), Compensated::default());
    for t in 0..scene.len() {
        let (sin, cos) = (TAU * turns([scene.x[t], scene.y[t], scene.z[t]], u)).sin_cos();
        re.add(scene.re[t] * cos + scene.im[t] * sin);
        im.add(scene.im[t] * cos - scene.re[t] * sin);
    }
    Complex64::new(re.value(), im.value())
}

/// The profile by the oracle: the sum as written, phases exact to the last bit. Slow; every other path is tested against it, and a
/// tolerance of 0 selects it.
///
/// # Errors
/// As [`super::profile`].
pub fn oracle(samples: &Samples, grid: &Grid) -> Result<Profile, Error> {
    let scene = Scene::new(samples)?;
    grid.check()?;
    let full = scene.sum_abs * scene.sum_abs;
    let value = |(azimuth, elevation)| (oracle_sum(&scene, &direction(azimuth, elevation)).norm_sqr() / full).min(1.0);
    let values = (0..grid.len()).map(|i| value(grid.at(i))).collect();
    Ok(Profile { grid: grid.clone(), values, sum_abs: ldexp(scene.sum_abs, -scene.exponent) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bartlett::search::tests::{random_scene, samples, track};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    impl Planner {
        /// The sums themselves, of the scaled samples: what the guarantee is about.
        fn sums(&mut self, plan: &Plan, scene: &Scene) -> Vec<Complex64> {
            let mut out = vec![Complex64::ZERO; plan.key.grid.len()];
            match &plan.engine {
                Engine::Constant => out.fill(constant(scene)),
                Engine::Oracle => {
                    for (index, out) in out.iter_mut().enumerate() {
                        *out = oracle_sum(scene, &unit(&plan.key.grid, index));
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
    }

    impl<T: Real> Core<T> {
        /// The sums, by direction of the grid.
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

    #[test]
    fn values_agree_with_tables() {
        // Abramowitz and Stegun, table 9.1 and 9.4.
        let j = bessel_j(1.0, 10);
        assert!((j[0] - 0.765_197_686_557_966_6).abs() < 1e-15);
        assert!((j[1] - 0.440_050_585_744_933_5).abs() < 1e-15);
        assert!((j[10] - 2.630_615_123_687_453e-10).abs() < 1e-22);
        let j = bessel_j(100.0, 120);
        assert!((j[0] - 0.019_985_850_304_223_12).abs() < 1e-14, "{}", j[0]);
        assert!((j[100] - 0.096_366_673_295_861_54).abs() < 1e-14);
    }

    #[test]
    fn the_tail_is_the_least_order_that_meets_eps() {
        for x in [0.5, 7.0, 69.7, 1_200.0] {
            for eps in [1e-3, 1e-6, 1e-12] {
                let m = tail_order(x, eps);
                let j = bessel_j(x, m + 200);
                let tail = |from: usize| 2.0 * j[from..].iter().map(|v| v.abs()).sum::<f64>();
                assert!(tail(m + 1) <= eps, "x {x} eps {eps}");
                assert!(tail(m) > eps, "x {x} eps {eps} could be lower");
            }
        }
        assert_eq!(tail_order(0.0, 1e-6), 0);
    }

    /// Directions of a grid to be checked, with the exact sums there.
    struct Exact {
        scene: Scene,
        grid: Grid,
        sums: Vec<(usize, Complex64)>,
    }

    impl Exact {
        fn new(samples: &Samples, grid: Grid, count: usize, rng: &mut ChaCha8Rng) -> Self {
            let scene = Scene::new(samples).unwrap();
            let indices =
                (0..count).map(|i| if i < 3 { i * (grid.len() - 1) / 2 } else { rng.random_range(0..grid.len()) });
            let exact = |index| {
                let (azimuth, elevation) = grid.at(index);
                (index, oracle_sum(&scene, &direction(azimuth, elevation)))
            };
            let sums = indices.map(exact).collect();
            Self { scene, grid, sums }
        }

        /// The largest error of the plan for these options, relative to `sum w |z|`.
        fn error(&self, planner: &mut Planner, options: &ProfileOptions) -> (f64, Explanation) {
            let plan = planner.plan_scene(&self.scene, &self.grid, options).unwrap();
            let values = planner.sums(&plan, &self.scene);
            let tilted = plan.explanation.skipped.iter().any(|s| s.contains("tilted plane"));
            let off = |(index, exact): &(usize, Complex64)| {
                // In the axes of a tilted plane the middle lies in that plane: another phase for each direction, no other change.
                let value = values[*index];
                if tilted { (value.norm() - exact.norm()).abs() } else { (value - exact).norm() }
            };
            (self.sums.iter().map(off).fold(0.0, f64::max) / self.scene.sum_abs, plan.explanation.clone())
        }
    }

    #[test]
    fn every_method_keeps_its_promise() {
        let mut rng = ChaCha8Rng::seed_from_u64(20);
        for case in 0..12 {
            let samples = random_scene(case, &mut rng);
            let list = (0..50).map(|_| (rng.random_range(-4.0..4.0), rng.random_range(-1.6..1.6))).collect();
            let rings = [Grid::azimuth(360), Grid::azimuth_elevation(72, 37), Grid::azimuth_elevation(360, 19)];
            let grids = rings.into_iter().chain([Grid::directions(list)]);
            let exact: Vec<Exact> = grids.map(|grid| Exact::new(&samples, grid, 60, &mut rng)).collect();
            for tier in Tier::available() {
                let mut planner = Planner::new(tier);
                for exact in &exact {
                    for eps in [1e-3, 1e-4, 1e-6, 1e-9, 1e-12] {
                        let method = Some(METHODS[rng.random_range(0..METHODS.len() - 1)]);
                        let options = ProfileOptions { eps, method, precision: None };
                        let (worst, explanation) = exact.error(&mut planner, &options);
                        assert!(worst <= eps, "{worst:.2e} case {case}, {explanation}");
                    }
                }
            }
        }
    }

    /// A scene of `n` packets within `radius` metres, turned out of the plane in every third case, on the axis of a line in some.
    fn wide_scene(case: usize, n: usize, radius: f64, rng: &mut ChaCha8Rng) -> Samples {
        let mut points = track(case % 5, radius, n, rng);
        if case.is_multiple_of(3) {
            let turn = nalgebra::Rotation3::new(Vector3::new(rng.random(), rng.random(), rng.random()));
            points.iter_mut().for_each(|p| *p = turn * *p);
        }
        if case % 10 == 1 {
            points.iter_mut().for_each(|p| *p = Vector3::new(p.x, 0.0, 0.0));
        }
        samples(&points, &[(rng.random_range(-3.0..3.0), 0.2, Complex64::ONE)], 0.3, rng)
    }

    #[test]
    fn the_promise_holds_from_one_packet_to_many_and_from_no_motion_to_five_metres_on_every_tier() {
        let mut rng = ChaCha8Rng::seed_from_u64(21);
        let mut used = std::collections::BTreeSet::new();
        for case in 0..56 {
            // Many packets take most of the time, and their cases are alike: twice each.
            let n = [1, 2, 3, 17, 300, 3_000, 30_000, 100_000][case % if case < 16 { 8 } else { 6 }];
            let radius = if case % 11 == 0 { 0.0 } else { 5.0 * 1e-4f64.powf(rng.random::<f64>()) };
            let samples = wide_scene(case, n, radius, &mut rng);
            let grid = if case % 2 == 0 { Grid::azimuth_elevation(48, 13) } else { Grid::azimuth(360) };
            let exact = Exact::new(&samples, grid, if n > 3_000 { 12 } else { 60 }, &mut rng);
            for tier in Tier::available() {
                let mut planner = Planner::new(tier);
                for eps in [1e-2, 1e-4, 1e-5, 1e-8, 1e-11] {
                    let (worst, explanation) =
                        exact.error(&mut planner, &ProfileOptions { eps, ..ProfileOptions::default() });
                    used.insert(format!("{:?}", explanation.method));
                    assert!(worst <= eps, "{worst:.2e} case {case}, {n} packets, {radius} m, {explanation}");
                }
            }
        }
        assert!(used.len() >= 6, "only {used:?} were chosen");
    }

    /// Every path, not only the cheapest, from one packet to 100,000 and up to five metres.
    #[test]
    fn every_path_keeps_the_promise_at_every_size_on_every_tier() {
        let mut rng = ChaCha8Rng::seed_from_u64(26);
        let mut used = std::collections::BTreeMap::<String, usize>::new();
        for (case, n) in [1, 3, 30, 1_000, 10_000, 100_000].into_iter().cycle().take(10).enumerate() {
            // Slabs of metres take seconds in a test build; apertures of few metres have the same code.
            let radius = if n > 1_000 { 1.0 } else { 5.0 } * 1e-3f64.powf(rng.random::<f64>());
            let samples = wide_scene(case, n, radius, &mut rng);
            let exact = Exact::new(&samples, Grid::azimuth_elevation(24, 7), if n > 1_000 { 6 } else { 40 }, &mut rng);
            for tier in Tier::available() {
                let mut planner = Planner::new(tier);
                for method in METHODS {
                    for eps in [1e-4, 1e-10] {
                        let options = ProfileOptions { eps, method: Some(method), precision: None };
                        let (worst, explanation) = exact.error(&mut planner, &options);
                        *used.entry(format!("{:?}", explanation.method)).or_default() += 1;
                        assert!(worst <= eps, "{worst:.2e} case {case}, {n} packets, {radius} m, {explanation}");
                    }
                }
            }
        }
        assert!(METHODS.iter().all(|m| used.contains_key(&format!("{m:?}"))), "{used:?}");
    }

    /// The floors that single precision is trusted with are what was measured, for direct sums with less than a factor of ten to spare: they
    /// hold for few packets, where rounding errors cannot average out.
    #[test]
    fn floors_of_single_precision_are_measured() {
        let mut rng = ChaCha8Rng::seed_from_u64(27);
        for radius in [0.03, 0.3, 1.0, 5.0, 20.0] {
            for method in [Method::Direct, Method::RingsDirect, Method::RingsNufft] {
                let (mut worst, mut floor, mut planner) = (0f64, 0f64, Planner::default());
                for case in 0..20 {
                    let points = track(2, radius, if method == Method::Direct { 1 } else { 4 } + case % 3, &mut rng);
                    let samples = samples(&points, &[(1.0, 0.0, Complex64::ONE)], 0.01, &mut rng);
                    let exact = Exact::new(&samples, Grid::azimuth(360), 60, &mut rng);
                    let eps = 4e-6;
                    let options = ProfileOptions { eps, method: Some(method), precision: Some(Precision::Single) };
                    let (error, explanation) = exact.error(&mut planner, &options);
                    if explanation.method == method {
                        worst = worst.max(error);
                        floor = single_floor(method, TAU * exact.scene.radius);
                    }
                }
                assert!(worst <= floor, "{method:?} {radius} m: {worst:.1e} above the floor {floor:.1e}");
                assert!(
                    method != Method::Direct || worst > 0.1 * floor,
                    "{method:?} {radius} m: {worst:.1e}, the floor of {floor:.1e} is no measurement"
                );
            }
        }
    }

    #[test]
    fn a_line_takes_one_dimension_and_gives_both_mirrors() {
        let mut rng = ChaCha8Rng::seed_from_u64(28);
        for (n, along) in
            [(200, Vector3::x()), (6_000, Vector3::new(0.6, 0.8, 0.0)), (200, Vector3::new(0.48, 0.6, 0.64))]
        {
            let points: Vec<_> = (0..n).map(|t| along * (0.5 * (f64::from(t) / f64::from(n) - 0.5))).collect();
            let samples = samples(&points, &[(1.0, 0.2, Complex64::ONE)], 0.1, &mut rng);
            let grid = Grid::azimuth_elevation(72, 37);
            for eps in [1e-3, 1e-5, 1e-9, 1e-12] {
                let mut planner = Planner::default();
                let options = ProfileOptions { eps, method: Some(Method::Cone), precision: None };
                let exact = Exact::new(&samples, grid.clone(), 100, &mut rng);
                let (worst, explanation) = exact.error(&mut planner, &options);
                assert_eq!(explanation.method, Method::Cone);
                assert!(worst <= eps, "{worst:.2e}, {explanation}");
                assert!(explanation.to_string().contains("across the line"));
                // Level lines need no lower hemisphere.
                assert_eq!(explanation.evaluated < grid.len(), along.z == 0.0, "{explanation}");
                if along == Vector3::x() {
                    let values = planner.profile(&samples, &grid, &options).unwrap().values;
                    let row = &values[20 * 72..21 * 72];
                    assert!((1..36).all(|j| (row[j] - row[72 - j]).abs() <= 2.0 * eps), "azimuth a and -a");
                }
            }
        }
    }

    #[test]
    fn plans_are_reused_and_the_oracle_is_exact() {
        let mut rng = ChaCha8Rng::seed_from_u64(22);
        let mut planner = Planner::default();
        let grid = Grid::azimuth_elevation(72, 37);
        for turn in 0..5 {
            let points: Vec<_> = track(0, 0.3 - 1e-4 * f64::from(turn), 500, &mut rng);
            let samples = samples(&points, &[(1.0, 0.0, Complex64::ONE)], 0.1, &mut rng);
            planner.profile(&samples, &grid, &ProfileOptions::default()).unwrap();
        }
        assert!(planner.plans.len() <= 2, "{} plans for one aperture", planner.plans.len());
        let points = track(4, 0.3, 50, &mut rng);
        let samples = samples(&points, &[(1.0, 0.0, Complex64::ONE)], 0.1, &mut rng);
        let options = ProfileOptions { eps: 0.0, ..ProfileOptions::default() };
        let exact = planner.profile(&samples, &grid, &options).unwrap();
        let reference = oracle(&samples, &grid).unwrap();
        assert!(exact.values.iter().zip(&reference.values).all(|(a, b)| (a - b).abs() < 1e-15));
        let bad = ProfileOptions { eps: -1.0, ..options };
        assert!(matches!(planner.profile(&samples, &grid, &bad), Err(Error::Tolerance { .. })));
    }

    #[test]
    fn explanations_say_what_was_left_out() {
        let mut rng = ChaCha8Rng::seed_from_u64(23);
        let mut planner = Planner::default();
        let mut explain = |shape: usize, radius: f64, grid: &Grid| {
            let points = track(shape, radius, 1_000, &mut rng);
            let samples = samples(&points, &[(1.0, 0.0, Complex64::ONE)], 0.1, &mut rng);
            planner.explain(&samples, grid, &ProfileOptions::default()).unwrap()
        };
        let full = Grid::azimuth_elevation(360, 181);
        let planar = explain(0, 0.3, &full);
        assert_eq!(planar.method, Method::RingsNufft);
        assert!(planar.to_string().contains("the lower hemisphere"));
        assert!(planar.evaluated * 6 < planar.directions);
        assert!(explain(0, 0.3, &Grid::azimuth(360)).to_string().contains("every elevation"));
        assert!(explain(1, 0.3, &full).to_string().contains("across the line"));
        assert_eq!(explain(0, 1e-9, &full).method, Method::Constant);
        assert!(!explain(4, 0.3, &full).to_string().contains("hemisphere"));
    }
}
