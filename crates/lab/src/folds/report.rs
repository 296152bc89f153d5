//! Tables of errors and calibration by trajectory, length of motion and group of links.

use super::bootstrap::{Interval, intervals};
use super::confidence::{self, ConfidenceColumn, RefusalColumn};
use super::error_bar::{self, ErrorBarColumn};
use super::gather::{FoldRow, Kind, PARTS, SOURCES};
use crate::evaluate::{Errors, TrajectorySource, usual_offset_m};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Which answers a column is of.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Which {
    /// Trajectory.
    pub source: TrajectorySource,
    /// Parts that the motion was cut into: 1, 2, 4.
    pub parts: u32,
    /// Kind of answer.
    pub kind: Kind,
    /// `LOS`, `NLOS` or the name of a set.
    pub group: String,
}

/// Errors of one group of links.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ErrorColumn {
    /// What it is of.
    #[serde(flatten)]
    pub which: Which,
    /// Places.
    pub places: usize,
    /// Links without a bearing.
    pub failed: usize,
    /// Absolute errors against the bearing from the mean pose.
    pub errors: Errors,
    /// 95 % intervals of mean, median, 90th percentile and share over 20 degrees, by resampling places.
    pub intervals: [Interval; 4],
    /// Errors of the best of the answer and the first five candidates.
    pub oracle: Errors,
}

/// Everything that leaving one place out shows.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Report {
    /// Places.
    pub places: usize,
    /// Links: a transmitter of a capture each.
    pub links: usize,
    /// Where the antenna was taken to be on the robot of wheel odometry, metres forward and left: the median over all
    /// places, each of which has that of the others.
    pub antenna_offset_m: Option<[f64; 2]>,
    /// Errors.
    pub errors: Vec<ErrorColumn>,
    /// Probabilities from models fitted to all other places.
    pub confidence: Vec<ConfidenceColumn>,
    /// What refusing by them keeps and costs.
    pub refusals: Vec<RefusalColumn>,
    /// Error bars from models fitted to all other places.
    pub error_bars: Vec<ErrorBarColumn>,
}

/// Leaves out every place of `rows` in turn.
#[must_use]
pub fn report(rows: &[FoldRow]) -> Report {
    let names = |of: fn(&FoldRow) -> &str| rows.iter().map(of).collect::<BTreeSet<&str>>();
    let kinds = [Kind::Full, Kind::Quick];
    let [full, quick] = kinds.map(|kind| confidence::columns(rows, kind));
    Report {
        places: names(|row| &row.place).len(),
        links: names(|row| &row.link).len(),
        antenna_offset_m: usual_offset_m(rows.iter().filter_map(|row| row.antenna_offset_m)),
        errors: kinds.into_iter().flat_map(|kind| errors(rows, kind)).collect(),
        confidence: [full.0, quick.0].concat(),
        refusals: [full.1, quick.1].concat(),
        error_bars: error_bar::columns(rows),
    }
}

fn errors(rows: &[FoldRow], kind: Kind) -> Vec<ErrorColumn> {
    let mut columns = Vec::new();
    for (source, parts) in SOURCES.into_iter().flat_map(|source| PARTS.map(|parts| (source, parts))) {
        let mut groups: BTreeMap<(bool, &str), Vec<&FoldRow>> = BTreeMap::new();
        for row in rows.iter().filter(|row| row.source == source && row.part.of == parts) {
            groups.entry((true, &row.set)).or_default().push(row);
            if let Some(sight) = sight(&row.set) {
                groups.entry((false, sight)).or_default().push(row);
            }
        }
        for ((_, group), own) in groups {
            columns.push(column(Which { source, parts, kind, group: group.to_owned() }, &own));
        }
    }
    columns
}

/// Whether a set is in line of sight, as its name says.
pub(super) fn sight(set: &str) -> Option<&'static str> {
    ["NLOS", "LOS"].into_iter().find(|name| set.contains(name))
}

fn column(which: Which, rows: &[&FoldRow]) -> ErrorColumn {
    let mut places: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    let (mut oracle, mut failed) = (Vec::new(), 0);
    for row in rows {
        let own = places.entry(&row.place).or_default();
        match row.answered(which.kind) {
            Some(answered) => {
                own.push(answered.error_deg.abs());
                oracle.push(answered.oracle_deg);
            }
            None => failed += 1,
        }
    }
    let places: Vec<Vec<f64>> = places.into_values().collect();
    ErrorColumn {
        which,
        places: places.len(),
        failed,
        errors: Errors::of(places.iter().flatten().copied()),
        intervals: intervals(&places),
        oracle: Errors::of(oracle.into_iter()),
    }
}
