//! Order statistics. Three definitions of a rank between two values are in use, under three names:
//!
//! * [`percentile`] and [`median`] interpolate: for figures that are reported.
//! * [`nearest_rank`] takes the nearer of the two, so that the result is one of the values.
//! * [`upper_median`], [`upper_median_ord`] and [`lower_rank`] take the upper or the lower one: for thresholds inside
//!   estimators, in linear time or of integers, where half a step between two values is no matter.

use std::cmp::Ordering;

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
pub fn lower_rank(sorted: &[f64], share: f64) -> Option<f64> {
    sorted.get((share * sorted.len().checked_sub(1)? as f64) as usize).copied()
}

/// The median of values in any order (they are reordered), the upper of the middle two; `None` if there are none.
#[must_use]
pub fn upper_median(values: &mut [f64]) -> Option<f64> {
    upper_median_by(values, f64::total_cmp)
}

/// [`upper_median`] of integers.
#[must_use]
pub fn upper_median_ord<T: Ord + Copy>(values: &mut [T]) -> Option<T> {
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
