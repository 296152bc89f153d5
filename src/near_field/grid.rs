//! How finely an aperture has to be searched.

use super::search::Limits;
use std::f64::consts::TAU;

/// Phases at the rim of the aperture change by at most twice this from one cell to the next, radians: an edge of 1.2
/// costs a parabola-like beam a tenth of its height.
const RIM_RAD: f64 = 1.2;
/// Less curvature than this over the whole aperture, radians, is a plane wave.
const PLANE_RAD: f64 = 0.3;
/// Cells at most: beyond that (apertures of many metres) there is no search.
const MAX_CELLS: usize = 400_000;

/// The coordinates of the grid.
#[derive(Clone, Debug)]
pub(super) struct Axes {
    pub azimuths: usize,
    pub elevations: Vec<f64>,
    pub curves: Vec<f64>,
}

/// How finely this aperture has to be searched: `order` is the phase at its rim, radians.
pub(super) fn axes(radius_m: f64, order: f64, curve_max: f64, limits: &Limits) -> Option<Axes> {
    let azimuths = (TAU * order / (2.0 * RIM_RAD)).ceil().max(16.0);
    let steps = |change: f64| (change / (2.0 * RIM_RAD)).ceil().max(1.0);
    let lift = 1.0 - limits.elevation_max_rad.cos();
    let rings = if limits.elevation_max_rad > 0.0 { steps(order * lift) } else { 0.0 };
    // The quadratic term is order * radius / 2 * curve at the rim, half of that about its mean.
    let bend = order * radius_m / 2.0 * curve_max;
    let ranges = if bend < PLANE_RAD { 0.0 } else { steps(bend) };
    let cells = azimuths * (rings + 1.0) * (ranges + 1.0);
    if cells.is_nan() || cells > MAX_CELLS as f64 {
        return None;
    }
    let (rings, ranges) = (rings as usize, ranges as usize);
    Some(Axes {
        azimuths: azimuths as usize,
        elevations: (0..=rings).map(|i| (1.0 - lift * i as f64 / rings.max(1) as f64).acos()).collect(),
        curves: (0..=ranges).map(|i| curve_max * i as f64 / ranges.max(1) as f64).collect(),
    })
}
