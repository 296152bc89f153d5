//! What a plan is made for: grid, tolerance, and the motion in buckets, so that like motions share a plan.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::explain::ProfileOptions;
use super::grid::{Grid, Layout};
use super::scene::Scene;
use csi5300_kernels::rings::{azimuths_for, distinct, nodes_for};

/// Ratio of one bucket of extents, and of numbers of samples, to the next: tables are at most 5 percent too large.
const EXTENT_STEP: f64 = 1.05;
/// Ratio of one bucket of radii to the next: band limits are at most 2 percent too high.
const RADIUS_STEP: f64 = 1.02;

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
