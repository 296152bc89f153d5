//! The planner's choice: what a method would cost here, and what it leaves out.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::bessel::tail_order;
use super::evaluate::Slab;
use super::explain::{Method, Precision, ProfileOptions};
use super::grid::{Grid, Layout};
use super::nufft::{Axis, Setting};
use super::rings::{azimuths_for, distinct, nodes_for};
use super::scene::{Geometry, Scene};
use crate::maths::simd::Tier;

/// What a plan is made for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Key {
    pub grid: Grid,
    pub options: ProfileOptions,
    /// Half extents of the box, turns, rounded up; zero for an axis that phases do not see.
    pub extent: [f64; 3],
    /// Largest distance from the middle, in the plane of the first two axes and at all, radians of phase, rounded up.
    pub radius: [f64; 2],
    /// Number of samples, rounded up.
    pub count: usize,
    /// Axes of the motion if they are not the frame's.
    pub axes: Option<[Vector3<f64>; 3]>,
    /// True for motion along the first of the axes and nothing else.
    pub line: bool,
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
    pub fn new(scene: &Scene, grid: &Grid, options: &ProfileOptions) -> Self {
        let steepest = grid.steepest;
        // What phases of eps / 8 do not see is not there.
        let slack = options.eps / (8.0 * TAU);
        let half = |c: &[f64]| c.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        let mut extent = [half(&scene.x), half(&scene.y), scene.half_height];
        let mut axes = None;
        let line = line(scene, slack);
        if let Some((along, half)) = line {
            (axes, extent) = (Some(along), [half, 0.0, 0.0]);
        } else if extent[2] * steepest > slack {
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
        let extent = extent.map(|e| bucket(e, 1.05));
        Self { grid: grid.clone(), options: *options, extent, radius, count, axes, line: line.is_some() }
    }
}

/// A method with what it costs and what it leaves out.
pub(crate) struct Choice {
    pub method: Method,
    pub precision: Precision,
    pub setting: Option<Setting>,
    /// Band limits in azimuth and elevation.
    pub order: [usize; 2],
    pub steepest: f64,
    pub cost_ns: f64,
    pub skipped: Vec<String>,
}

/// Nanoseconds per unit of work: (antipodal pair, kernel cell, FFT point and doubling, assembled value) in single
/// precision; double takes twice that. Measured on a Xeon and an EPYC with AVX-512; the portable code as SSE4.2 without
/// rounding instructions. Only their ratios matter.
pub(crate) fn unit_costs(tier: Tier, precision: Precision) -> [f64; 4] {
    let single = match tier {
        Tier::Avx512 => [0.27, 0.07, 0.25, 0.5],
        Tier::Avx2 => [0.5, 0.09, 0.25, 0.6],
        Tier::Sse42 | Tier::Native => [1.45, 0.14, 0.39, 0.95],
        Tier::Portable => [3.0, 0.3, 1.0, 1.6],
    };
    let factor = if precision == Precision::Single { 1.0 } else { 2.0 };
    single.map(|c| c * factor)
}

/// The least tolerance that single precision is trusted with, for a radius in radians of phase.
///
/// Direct sums round phases to 2^-24 of themselves three times: measured on single packets, 0.4 of this floor. The NUFFT
/// rounds weights and FFTs, whatever the radius: measured, 3e-7 at 0.03 m, with room for kernels and many packets.
pub(crate) fn single_floor(method: Method, radius: f64) -> f64 {
    match method {
        Method::Direct | Method::RingsDirect => 1e-6 + 2e-7 * radius,
        _ => 1e-5,
    }
}

/// What the planner chooses from where there is motion and a tolerance.
const METHODS: [Method; 6] =
    [Method::Direct, Method::RingsDirect, Method::RingsNufft, Method::TargetsNufft, Method::Slab, Method::Cone];

pub(crate) fn choose(scene: &Scene, key: &Key, tier: Tier) -> Choice {
    let eps = key.options.eps;
    let mut best = Choice {
        method: Method::Oracle,
        precision: Precision::Double,
        setting: None,
        order: [usize::MAX; 2],
        steepest: key.grid.steepest,
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

/// What a method would cost here; none if it cannot serve.
fn price(key: &Key, method: Method, order: [usize; 2], tier: Tier) -> Option<(Precision, Option<Setting>, f64)> {
    let eps = key.options.eps;
    let [_, radius] = key.radius;
    let tall = key.extent[2] > 0.0;
    let planar_nufft = matches!(method, Method::RingsNufft | Method::TargetsNufft);
    if planar_nufft && tall || method == Method::Slab && !tall || method == Method::Cone && !key.line {
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
    if planar_nufft || matches!(method, Method::Slab | Method::Cone) {
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
        (Method::Cone, Some(s)) => {
            let width = s.width.next_multiple_of(8) as f64;
            let n = n * 3.0 + cone_rows(key).map_or(all, |(rows, _)| (rows.len() * key.grid.shape().1) as f64);
            n * width * cell * 2.0 + Axis::new(key.extent[0], s).n as f64 * 4.0 * fft + all * assembled
        }
        (Method::Slab, Some(s)) => {
            let planes = Slab::<f64>::planes(key.extent[2], key.grid.steepest, s) as f64;
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
pub(crate) fn ring_shape(key: &Key, order: [usize; 2]) -> Option<(usize, usize)> {
    let Layout::Rings { azimuths, elevations_rad } = &*key.grid.layout else { return None };
    if azimuths % 4 != 0 || key.axes.is_some() {
        return None;
    }
    Some((azimuths_for(*azimuths, order[0]), nodes_for(&distinct(elevations_rad), order[1]).len()))
}

/// For a level line and a grid of rings: the rows that are computed, and for each row of the grid which of those it is.
pub(crate) fn cone_rows(key: &Key) -> Option<(Vec<f64>, Vec<usize>)> {
    let Layout::Rings { elevations_rad, .. } = &*key.grid.layout else { return None };
    if !(key.line && key.axes.is_some_and(|[along, ..]| along.z == 0.0)) {
        return None;
    }
    let rows = distinct(elevations_rad);
    let nearest = |e: &f64| rows.iter().position(|row| (row - e.abs()).abs() < 1e-14).unwrap_or(0);
    let of = elevations_rad.iter().map(nearest).collect();
    Some((rows, of))
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
        list.push(String::from(
            "both axes across the line: one cosine, so that a direction and its mirror are the same",
        ));
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
