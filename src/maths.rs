//! Mathematics that all other modules use: angles in radians, counters of 32 bits that wrap, and order statistics.
//!
//! Three definitions of a rank between two values are in use, under three names:
//!
//! * [`percentile`] and [`median`] interpolate: for figures that are reported.
//! * [`nearest_rank`] takes the nearer of the two, so that the result is one of the values.
//! * `upper_median`, `upper_median_ord` and `lower_rank` take the upper or the lower one: for thresholds inside
//!   estimators, in linear time or of integers, where half a step between two values is no matter.

use std::cmp::Ordering;
use std::f64::consts::{PI, TAU};

/// Standard deviation of an azimuth about which nothing is known, radians: `pi / sqrt 3`.
pub const UNIFORM_RAD: f64 = 1.813_799_364_234_217_8;

/// An angle brought into (-pi, pi].
#[must_use]
pub fn wrap_rad(angle_rad: f64) -> f64 {
    let wrapped = angle_rad - TAU * (angle_rad / TAU).round();
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}

/// Unwraps phases: each within pi of the one before it; the first stays as it is.
#[must_use]
pub fn unwrap_rad(phases: &[f64]) -> Vec<f64> {
    let mut last = phases.first().copied().unwrap_or(0.0);
    phases
        .iter()
        .map(|&phase| {
            let step = phase - last;
            last += step - TAU * ((step + PI) / TAU).floor();
            last
        })
        .collect()
}

/// The value nearest to `expected` whose low 32 bits are `raw`: exact while the truth is within 2^31 counts of `expected`.
#[must_use]
pub(crate) fn unwrap_near(expected: i64, raw: u32) -> i64 {
    expected.saturating_add(i64::from(raw.wrapping_sub(expected as u32).cast_signed()))
}

/// The value below which `share` (0 to 1) of the sorted values lie, interpolated linearly between neighbours; NaN if there
/// are none.
#[must_use]
pub fn percentile(sorted: &[f64], share: f64) -> f64 {
    let place = share * sorted.len().saturating_sub(1) as f64;
    let at = |index: f64| sorted.get(index as usize).copied().unwrap_or(f64::NAN);
    at(place.floor()) + (at(place.ceil()) - at(place.floor())) * place.fract()
}

/// The median of values in any order (they are sorted), interpolated between the middle two; `None` if there are none.
#[must_use]
pub fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    (!values.is_empty()).then(|| percentile(values, 0.5))
}

/// Of the sorted values the one whose rank is nearest to `share` (0 to 1) of the way from the first to the last; `None` if
/// there are none.
#[must_use]
pub fn nearest_rank(sorted: &[f64], share: f64) -> Option<f64> {
    sorted.get((share * sorted.len().checked_sub(1)? as f64).round() as usize).copied()
}

/// Of the sorted values the last whose rank is at most `share` (0 to 1) of the way from the first to the last; `None` if
/// there are none.
#[must_use]
pub(crate) fn lower_rank(sorted: &[f64], share: f64) -> Option<f64> {
    sorted.get((share * sorted.len().checked_sub(1)? as f64) as usize).copied()
}

/// The median of values in any order (they are reordered), the upper of the middle two; `None` if there are none.
#[must_use]
pub(crate) fn upper_median(values: &mut [f64]) -> Option<f64> {
    upper_median_by(values, f64::total_cmp)
}

/// [`upper_median`] of integers.
#[must_use]
pub(crate) fn upper_median_ord<T: Ord + Copy>(values: &mut [T]) -> Option<T> {
    upper_median_by(values, T::cmp)
}

fn upper_median_by<T: Copy>(values: &mut [T], order: impl FnMut(&T, &T) -> Ordering) -> Option<T> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, order).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unwrapping_follows_the_phase() {
        let course: Vec<f64> = (0..200).map(|k| 0.3 * f64::from(k)).collect();
        let wrapped: Vec<f64> = course.iter().map(|&p| wrap_rad(p)).collect();
        assert!(unwrap_rad(&wrapped).iter().zip(&course).all(|(a, b)| (a - b).abs() < 1e-9));
    }

    #[test]
    fn half_a_turn_is_positive() {
        assert_eq!((wrap_rad(PI), wrap_rad(-PI), wrap_rad(3.0 * PI)), (PI, PI, PI));
        assert_eq!((wrap_rad(0.0), wrap_rad(-1.0)), (0.0, -1.0));
    }

    #[test]
    fn the_nearest_value_is_taken_on_either_side() {
        let wrap = 1_i64 << 32;
        assert_eq!(unwrap_near(wrap - 5, 3), wrap + 3);
        assert_eq!(unwrap_near(wrap + 3, u32::MAX), wrap - 1);
        assert_eq!(unwrap_near(-2, 1), 1);
    }

    #[test]
    fn ranks_between_two_values_go_where_their_names_say() {
        let sorted = [1.0, 2.0, 4.0, 8.0];
        assert_eq!((percentile(&sorted, 0.5), median(&mut [8.0, 2.0, 1.0, 4.0])), (3.0, Some(3.0)));
        assert_eq!((upper_median(&mut [8.0, 2.0, 1.0, 4.0]), upper_median_ord(&mut [3, 1, 2])), (Some(4.0), Some(2)));
        assert_eq!((nearest_rank(&sorted, 0.9), lower_rank(&sorted, 0.9)), (Some(8.0), Some(4.0)));
        assert!(percentile(&[], 0.5).is_nan());
        assert_eq!(
            (median(&mut []), upper_median(&mut []), nearest_rank(&[], 0.5), lower_rank(&[], 0.5)),
            Default::default()
        );
    }
}
