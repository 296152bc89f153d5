//! Error statistics of sets of links.

use super::Judged;
use csi5300::maths::percentile;
use serde::Serialize;
use std::collections::BTreeMap;

/// Errors of a set of links, degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Errors {
    /// Links with an error.
    pub links: usize,
    /// Mean of the absolute errors.
    pub mean_deg: f64,
    /// Their median.
    pub median_deg: f64,
    /// Their 90th percentile.
    pub p90_deg: f64,
    /// Share over 20 degrees, 0..1.
    pub over_20: f64,
}

impl Errors {
    /// Statistics of absolute errors; percentiles are interpolated linearly.
    #[must_use]
    pub fn of(errors_deg: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = errors_deg.map(f64::abs).filter(|e| e.is_finite()).collect();
        if sorted.is_empty() {
            // NaN, null in JSON: a set without links does not have error 0.
            let none = f64::NAN;
            return Self { links: 0, mean_deg: none, median_deg: none, p90_deg: none, over_20: none };
        }
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len() as f64;
        let over = sorted.iter().filter(|e| **e > 20.0).count() as f64;
        Self {
            links: sorted.len(),
            mean_deg: sorted.iter().sum::<f64>() / n,
            median_deg: percentile(&sorted, 0.5),
            p90_deg: percentile(&sorted, 0.9),
            over_20: over / n,
        }
    }
}

/// Statistics of one set.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SetSummary {
    /// Number of links, including failed ones.
    pub links: usize,
    /// Links without a bearing.
    pub failed: usize,
    /// Against the bearing from the mean pose.
    pub from_mean_pose: Errors,
    /// Against the bearing from the start pose.
    pub from_start: Errors,
}

/// The name for all sets together.
pub const ALL_SETS: &str = "all";

/// Statistics by set (the first folder below the evaluated one) and of all.
#[must_use]
pub fn summarise(rows: &[Judged]) -> BTreeMap<String, SetSummary> {
    let set_of = |row: &Judged| row.set().to_owned();
    let mut names: Vec<String> = rows.iter().map(set_of).collect();
    names.sort();
    names.dedup();
    let summary = |rows: &[&Judged]| SetSummary {
        links: rows.len(),
        failed: rows.iter().filter(|row| row.answer.azimuth_deg.is_none()).count(),
        from_mean_pose: Errors::of(rows.iter().filter_map(|row| row.error_from_mean_pose_deg)),
        from_start: Errors::of(rows.iter().filter_map(|row| row.error_from_start_deg)),
    };
    let of_set = |name: String| {
        let own: Vec<&Judged> = rows.iter().filter(|row| set_of(row) == name).collect();
        let own = summary(&own);
        (name, own)
    };
    let mut sets: BTreeMap<String, SetSummary> = names.into_iter().map(of_set).collect();
    sets.insert(ALL_SETS.into(), summary(&rows.iter().collect::<Vec<_>>()));
    sets
}
