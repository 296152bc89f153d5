//! How finely an aperture has to be searched.

use super::types::{Limits, Place};
use crate::tuning::TUNING;
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// The coordinates of the grid.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Axes {
    pub azimuths: usize,
    pub elevations: Vec<f64>,
    pub curves: Vec<f64>,
}

impl Axes {
    /// How many places there are.
    pub fn cells(&self) -> usize {
        self.azimuths * self.elevations.len() * self.curves.len()
    }

    /// Every place: azimuth by azimuth, in each elevation by elevation, in each range by range.
    pub fn places(&self) -> Vec<Place> {
        let azimuth = |i: usize| TAU * i as f64 / self.azimuths as f64;
        let mut places = Vec::with_capacity(self.cells());
        for i in 0..self.azimuths {
            for &elevation in &self.elevations {
                places.extend(self.curves.iter().map(|&curve| Place { azimuth: azimuth(i), elevation, curve }));
            }
        }
        places
    }

    /// Values at these places brought to those of `fine`, linearly along each axis: both have the same ends, and even
    /// steps in azimuth, in the largest change of a phase with elevation, and in 1 / range.
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

/// The size of an aperture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extent {
    /// Largest distance of a sample from the middle, metres.
    pub radius_m: f64,
    /// Largest vertical distance over the largest distance.
    pub height_share: f64,
}

/// Largest 1 / range that is searched about a motion of this radius, 1/m: no nearer than its rim.
pub(super) fn curve_max(radius_m: f64, limits: &Limits) -> f64 {
    1.0 / limits.range_min_m.max(1.2 * radius_m).max(1e-3)
}

/// Whether round trips from these displacements, metres, can be searched as one aperture: the grid over places ends.
pub(crate) fn is_searchable(displacement_m: &[Vector3<f64>], wavelength_m: f64, limits: &Limits) -> bool {
    let middle_m = displacement_m.iter().sum::<Vector3<f64>>() / displacement_m.len().max(1) as f64;
    let radius_m = displacement_m.iter().map(|p| (p - middle_m).norm()).fold(0.0, f64::max);
    let highest_m = displacement_m.iter().map(|p| (p.z - middle_m.z).abs()).fold(0.0, f64::max);
    let extent = Extent { radius_m, height_share: if radius_m > 0.0 { highest_m / radius_m } else { 0.0 } };
    axes(extent, 2.0 * TAU * radius_m / wavelength_m, curve_max(radius_m, limits), limits).is_some()
}

/// How finely this aperture has to be searched: `order` is the phase at its rim, radians.
pub(super) fn axes(extent: Extent, order: f64, curve_max: f64, limits: &Limits) -> Option<Axes> {
    let Extent { radius_m, height_share } = extent;
    let azimuths = (TAU * order / (2.0 * TUNING.grid.rim_rad)).ceil().max(16.0);
    let steps = |change: f64| (change / (2.0 * TUNING.grid.rim_rad)).ceil().max(1.0);
    let [lowest, highest] = limits.elevation_span_rad();
    let tilt = if lowest < 0.0 { height_share } else { 0.0 };
    let lift = change(highest, tilt);
    let rings = if highest > 0.0 { steps(order * lift) } else { 0.0 };
    // The quadratic term is order * radius / 2 * curve at the rim, half of that about its mean.
    let bend = order * radius_m / 2.0 * curve_max;
    let ranges = if bend < TUNING.grid.plane_rad { 0.0 } else { steps(bend) };
    let cells = azimuths * (rings + 1.0) * (ranges + 1.0);
    if cells.is_nan() || cells > TUNING.grid.max_cells as f64 {
        return None;
    }
    let (rings, ranges) = (rings as usize, ranges as usize);
    Some(Axes {
        azimuths: azimuths as usize,
        elevations: elevations(rings, lift, tilt, lowest < 0.0),
        curves: (0..=ranges).map(|i| curve_max * i as f64 / ranges.max(1) as f64).collect(),
    })
}

/// Largest change of a phase from the horizon to `elevation`, in units of the phase at the rim; `tilt` is the height of
/// the motion over its radius.
fn change(elevation: f64, tilt: f64) -> f64 {
    let (sin, cos) = elevation.sin_cos();
    1.0 - cos + tilt * sin
}

/// `rings` even steps of [`change`] from the horizon to `lift`, and as many below it where `signed`.
fn elevations(rings: usize, lift: f64, tilt: f64, signed: bool) -> Vec<f64> {
    // 1 - cos e + t sin e = c: with w = hypot(1, t), e = asin((c - 1) / w) + atan2(1, t).
    let (width, phase) = (1f64.hypot(tilt), 1f64.atan2(tilt));
    let up = |i: usize| match lift * i as f64 / rings.max(1) as f64 {
        0.0 => 0.0,
        change if tilt == 0.0 => (1.0 - change).acos(),
        change => ((change - 1.0) / width).clamp(-1.0, 1.0).asin() + phase,
    };
    let below = (1..=rings).rev().filter(|_| signed).map(|i| -up(i));
    below.chain((0..=rings).map(up)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_are_even_in_phase_from_nadir_to_zenith() {
        for tilt in [0.05, 0.4, 1.0] {
            let rings = elevations(9, change(std::f64::consts::FRAC_PI_2, tilt), tilt, true);
            assert_eq!((rings.len(), rings[9]), (19, 0.0));
            assert!((rings[18] - std::f64::consts::FRAC_PI_2).abs() < 1e-7 && (rings[0] + rings[18]).abs() < 1e-12);
            let steps: Vec<f64> = rings[9..].windows(2).map(|w| change(w[1], tilt) - change(w[0], tilt)).collect();
            assert!(steps.iter().all(|step| (step - steps[0]).abs() < 1e-9), "{steps:?}");
        }
        assert_eq!(elevations(2, change(0.3, 0.0), 0.0, false).len(), 3);
    }

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
