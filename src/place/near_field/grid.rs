//! How finely an aperture has to be searched.

use super::types::{Limits, Place};
use crate::tuning::TUNING;
use std::f64::consts::TAU;

/// Phases at the rim of the aperture change by at most twice this from one cell to the next, radians: an edge of 1.2
/// costs a parabola-like beam a tenth of its height.
const RIM_RAD: f64 = TUNING.grid.rim_rad;
/// Less curvature than this over the whole aperture, radians, is a plane wave.
const PLANE_RAD: f64 = TUNING.grid.plane_rad;
/// Cells at most: beyond that (apertures of many metres) there is no search.
const MAX_CELLS: usize = TUNING.grid.max_cells;

/// The coordinates of the grid.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Axes {
    pub azimuths: usize,
    pub elevations: Vec<f64>,
    pub curves: Vec<f64>,
}

impl Axes {
    /// Every place: azimuth by azimuth, in each elevation by elevation, in each range by range.
    pub fn places(&self) -> Vec<Place> {
        let azimuth = |i: usize| TAU * i as f64 / self.azimuths as f64;
        let mut places = Vec::with_capacity(self.azimuths * self.elevations.len() * self.curves.len());
        for i in 0..self.azimuths {
            for &elevation in &self.elevations {
                places.extend(self.curves.iter().map(|&curve| Place { azimuth: azimuth(i), elevation, curve }));
            }
        }
        places
    }

    /// Values at these places brought to those of `fine`, linearly along each axis: both have the same ends, and even
    /// steps in azimuth, cosine of elevation and 1 / range.
    pub fn spread(&self, values: &[f32], fine: &Self) -> Vec<f32> {
        let line = |from: usize, to: usize| -> Vec<(usize, usize, f32)> {
            let at = |i: usize| (from - 1) as f32 * i as f32 / to.max(2).saturating_sub(1) as f32;
            (0..to).map(|i| (at(i) as usize, (at(i) as usize + 1).min(from - 1), at(i).fract())).collect()
        };
        let around = |i: usize| {
            let at = self.azimuths as f32 * i as f32 / fine.azimuths as f32;
            (at as usize % self.azimuths, (at as usize + 1) % self.azimuths, at.fract())
        };
        let (rings, ranges) = (self.elevations.len(), self.curves.len());
        let (up, away) = (line(rings, fine.elevations.len()), line(ranges, fine.curves.len()));
        let between = |(a, b): (f32, f32), share: f32| a + share * (b - a);
        let mut out = Vec::with_capacity(fine.azimuths * up.len() * away.len());
        // One azimuth at a time: first between azimuths, then within.
        let mut sheet = vec![0.0; rings * ranges];
        for i in 0..fine.azimuths {
            let (left, right, share) = around(i);
            let own = |azimuth: usize| values[azimuth * rings * ranges..].iter();
            sheet.iter_mut().zip(own(left).zip(own(right))).for_each(|(s, (a, b))| *s = between((*a, *b), share));
            for &(low, high, rise) in &up {
                for &(near, far, depth) in &away {
                    let row = |ring: usize| between((sheet[ring * ranges + near], sheet[ring * ranges + far]), depth);
                    out.push(between((row(low), row(high)), rise));
                }
            }
        }
        out
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_linear_comes_over_as_it_was() {
        let axes = |azimuths: usize, rings: usize, ranges: usize| Axes {
            azimuths,
            elevations: (0..rings).map(|i| (1.0 - 0.06 * i as f64 / (rings.max(2) - 1) as f64).acos()).collect(),
            curves: (0..ranges).map(|i| 0.5 * i as f64 / (ranges.max(2) - 1) as f64).collect(),
        };
        for (own, fine) in
            [(axes(20, 3, 4), axes(48, 4, 7)), (axes(16, 1, 1), axes(32, 1, 1)), (axes(16, 2, 1), axes(16, 5, 1))]
        {
            let value = |p: &Place| (3.0 * p.elevation.cos() - 2.0 * p.curve) as f32;
            let values: Vec<f32> = own.places().iter().map(value).collect();
            let spread = own.spread(&values, &fine);
            let expected = fine.places();
            assert_eq!(spread.len(), expected.len());
            assert!(spread.iter().zip(&expected).all(|(got, place)| (got - value(place)).abs() < 1e-5));
        }
        // Around: between the last azimuth and the first.
        let (own, fine) = (axes(4, 1, 1), axes(8, 1, 1));
        assert_eq!(own.spread(&[0.0, 1.0, 2.0, 4.0], &fine), [0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 2.0]);
    }
}
