//! Chooses the stretch to search of a motion that is too wide for one search.
//!
//! The number of places grows with the fourth power of the aperture's radius (azimuth, elevation, and twice for range):
//! drives wider than some 2.7 m at 5 GHz have too many, odometry hardly stays coherent over them, and wave fronts are
//! too curved for a plane wave.

use crate::estimate::is_searchable;
use crate::estimate::prior::Limits;
use nalgebra::{Matrix2, Vector3};
use std::ops::Range;

/// Compared stretches have the longest possible length; each starts this share of it before the next.
const OVERLAP: usize = 4;
/// Weight of spread along the motion relative to spread across it: a line does not distinguish its sides.
const ALONG: f64 = 1e-3;

/// The most informative stretch of these displacements, metres, in the order of time, within `limits`; `None` if all
/// can be searched together, or no two.
pub(super) fn searchable(
    displacement_m: &[Vector3<f64>],
    wavelength_m: f64,
    path_gain: u8,
    limits: &Limits,
) -> Option<Range<usize>> {
    let fits = |range: Range<usize>| is_searchable(&displacement_m[range], wavelength_m, path_gain, limits);
    let count = displacement_m.len();
    if fits(0..count) {
        return None;
    }
    let longest = |from: usize| {
        // Doubles the length while it fits, then bisects.
        let mut inside = from + 1;
        while inside < count && fits(from..(2 * inside - from).min(count)) {
            inside = (2 * inside - from).min(count);
        }
        let mut outside = (2 * inside - from).min(count + 1);
        while outside - inside > 1 {
            let middle = inside.midpoint(outside);
            if fits(from..middle) { inside = middle } else { outside = middle }
        }
        from..inside
    };
    let (mut from, mut best) = (0, None);
    while from < count {
        let range = longest(from);
        let spread_m2 = spread_m2(&displacement_m[range.clone()]);
        from = if range.end == count { count } else { from + (range.len() / OVERLAP).max(1) };
        if range.len() > 1 && best.as_ref().is_none_or(|(most_m2, _)| spread_m2 > *most_m2) {
            best = Some((spread_m2, range));
        }
    }
    best.map(|(_, range)| range)
}

/// Sum of squared distances from the mean across the motion, and a little of those along it: horizontal, square metres.
fn spread_m2(displacement_m: &[Vector3<f64>]) -> f64 {
    let mean = displacement_m.iter().sum::<Vector3<f64>>() / displacement_m.len().max(1) as f64;
    let scatter: Matrix2<f64> = displacement_m.iter().map(|p| (p - mean).xy()).map(|p| p * p.transpose()).sum();
    let across_and_along = scatter.symmetric_eigenvalues();
    across_and_along.min() + ALONG * across_and_along.max()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const WAVELENGTH_M: f64 = 0.054;

    fn circle(radius_m: f64, from: f64, to: f64, count: usize) -> impl Iterator<Item = Vector3<f64>> {
        let angle = move |k: usize| TAU * (from + (to - from) * k as f64 / count as f64);
        (0..count).map(move |k| Vector3::new(radius_m * angle(k).cos(), radius_m * angle(k).sin(), 0.0))
    }

    #[test]
    fn a_wide_motion_is_cut_to_its_most_informative_stretch() {
        let limits = Limits { near_field: true, ..Limits::default() };
        let small: Vec<_> = circle(0.5, 0.0, 1.0, 400).collect();
        assert_eq!(searchable(&small, WAVELENGTH_M, 2, &limits), None);
        assert_eq!(searchable(&[], WAVELENGTH_M, 2, &limits), None);
        // Ten metres straight on, a turn on the spot, and ten metres on.
        let line = |from_m: f64| (0..1_000).map(move |k| Vector3::new(from_m + 0.01 * f64::from(k), 0.5, 0.0));
        let drive: Vec<_> = line(-10.0).chain(circle(0.5, 0.25, 1.25, 400)).chain(line(0.0)).collect();
        let stretch = searchable(&drive, WAVELENGTH_M, 2, &limits).unwrap();
        assert!(is_searchable(&drive[stretch.clone()], WAVELENGTH_M, 2, &limits));
        assert!(
            stretch.start <= 1_000 && stretch.end >= 1_400 && stretch.len() < 1_500,
            "{stretch:?}: the turn is in it"
        );
        // One that cannot end sooner than it begins.
        let jump = [Vector3::zeros(), Vector3::new(40.0, 0.0, 0.0)];
        assert_eq!(searchable(&jump, WAVELENGTH_M, 2, &limits), None);
    }
}
