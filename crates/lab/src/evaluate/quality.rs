//! Figures of a set of judged links besides their bearing errors: ranges and refusals.

use super::Judged;
use super::sure::{Kept, Sure, surest};
use csi5300::maths::median;
use csi5300::pipeline::Answer;
use serde::Serialize;

/// The risk-coverage curve: errors when 100, 90, .. 50 % are kept.
#[must_use]
pub fn risk_coverage(rows: &[Judged]) -> Vec<Kept> {
    surest(&sure(rows), (5..=10).rev().map(|tenths| f64::from(tenths) / 10.0))
}

/// The same in steps of 2 %, down to a tenth: for pictures.
#[must_use]
pub fn refusals(rows: &[Judged]) -> Vec<Kept> {
    surest(&sure(rows), (5..=50).rev().map(|fiftieths| f64::from(fiftieths) / 50.0))
}

/// Every link that has a probability and an error.
#[must_use]
pub fn sure(rows: &[Judged]) -> Vec<Sure> {
    rows.iter().filter_map(|row| Some(Sure::new(row.answer.confidence?, row.error_from_mean_pose_deg?))).collect()
}

/// Median of `|error| / deviation`, divided by that of a normal distribution: 1 if deviations are right, whatever a few false
/// answers do. `None` without links that have both.
fn scale(pairs: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let mut ratios: Vec<f64> = pairs.filter(|(_, sd)| *sd > 0.0).map(|(error, sd)| (error / sd).abs()).collect();
    median(&mut ratios).map(|ratio| ratio / 0.674_5)
}

/// The azimuths' errors relative to their error bars: 1 if the bars are right, less if they are too long.
#[must_use]
pub fn over_bound(rows: &[&Judged]) -> Option<f64> {
    scale(rows.iter().filter_map(|row| row.error_from_mean_pose_deg.zip(row.answer.azimuth_sd_deg)))
}

/// Errors of reported ranges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Ranges {
    /// Links with a bearing and a true range.
    pub links: usize,
    /// Number of those that reported a range.
    pub reported: usize,
    /// Median of the absolute errors, metres.
    pub median_m: Option<f64>,
    /// Errors relative to the predicted deviations: 1 if the deviations are right.
    pub over_bound: Option<f64>,
    /// Numbers of reported places with a known truth, and of those within their 68 % and their 95 % ellipses.
    pub places: [usize; 3],
}

/// A plane normal distribution has 68.3 and 95.4 % within these deviations: `sqrt(-2 ln(1 - share))`.
const ELLIPSES: [f64; 2] = [1.515_8, 2.481_6];

/// Accuracy of the ranges.
#[must_use]
pub fn ranges(rows: &[&Judged]) -> Ranges {
    let known = rows.iter().filter(|row| row.true_range_m.is_some() && row.answer.azimuth_deg.is_some());
    let mut errors: Vec<f64> = rows.iter().filter_map(|row| row.range_error_m).map(f64::abs).collect();
    let reported = errors.len();
    // Errors are horizontal, and so are their deviations.
    let sd_m = |answer: &Answer| answer.range_sd_m.map(|sd| sd * horizontal(answer));
    let over_bound = scale(rows.iter().filter_map(|row| row.range_error_m.zip(sd_m(&row.answer))));
    let within = |most: f64| rows.iter().filter(|row| row.position_error_sd.is_some_and(|off| off <= most)).count();
    let places = [within(f64::INFINITY), within(ELLIPSES[0]), within(ELLIPSES[1])];
    Ranges { links: known.count(), reported, median_m: median(&mut errors), over_bound, places }
}

/// The horizontal share of an answer's range: the truth has no heights.
#[must_use]
pub fn horizontal(answer: &Answer) -> f64 {
    answer.abs_elevation_deg.unwrap_or(0.0).to_radians().cos()
}

#[cfg(test)]
mod tests {
    use super::super::judge::row;
    use super::*;

    #[test]
    fn refusing_the_unsure_lowers_the_error() {
        let rows: Vec<Judged> = (0..10).map(|k| row("a/x", 0.0, f64::from(k), 1.0 - f64::from(k) * 0.1)).collect();
        let curve = risk_coverage(&rows);
        assert_eq!(curve.len(), 6);
        assert_eq!((curve[0].errors.links, curve[5].errors.links), (10, 5));
        assert!((curve[5].errors.mean_deg - 2.0).abs() < 1e-12 && (curve[0].errors.mean_deg - 4.5).abs() < 1e-12);
        assert!(risk_coverage(&[]).is_empty());
    }

    #[test]
    fn correct_deviations_have_a_scale_of_one() {
        let with_sd = |k: i32| {
            let mut row = row("a/x", 0.0, f64::from(k), 0.5);
            row.answer.azimuth_sd_deg = Some(10.0);
            row
        };
        // Half of all normal errors are within 0.6745 deviations.
        let rows: Vec<Judged> = (-13..=13).map(with_sd).collect();
        let rows: Vec<&Judged> = rows.iter().collect();
        assert!((over_bound(&rows).unwrap() - 0.7 / 0.674_5).abs() < 1e-9, "{:?}", over_bound(&rows));
        assert_eq!(over_bound(&[]), None);
        assert_eq!(ranges(&rows), Ranges { links: 0, reported: 0, median_m: None, over_bound: None, places: [0; 3] });
        // At an elevation of 60 degrees, half a slant deviation is a whole horizontal one.
        let slant = |elevation_deg: f64| {
            let mut row = row("a/x", 0.0, 0.0, 0.5);
            row.answer.abs_elevation_deg = Some(elevation_deg);
            (row.answer.range_sd_m, row.range_error_m, row.true_range_m) = (Some(0.2), Some(0.1), Some(3.0));
            ranges(&[&row])
        };
        assert!((slant(60.0).over_bound.unwrap() - 1.0 / 0.674_5).abs() < 1e-9, "{:?}", slant(60.0));
        assert!((slant(0.0).over_bound.unwrap() - 0.5 / 0.674_5).abs() < 1e-9, "{:?}", slant(0.0));
    }
}
