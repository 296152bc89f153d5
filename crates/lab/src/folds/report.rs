//! Tables of errors and calibration by trajectory, length of motion and group of links.

use super::bootstrap::{Interval, intervals};
use super::confidence::{self, ConfidenceColumn, RefusalColumn};
use super::error_bar::{self, ErrorBarColumn};
use super::gather::{FoldRow, Kind, PARTS, SOURCES};
use super::paths::{self, PathColumn};
use crate::evaluate::{Errors, TrajectorySource, usual_offset_m};
use csi5300::maths::{median, wrap_rad};
use csi5300::motion::rolling::Mount;
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
    /// Errors of the answers less the rotation of the whole path that motion capture shows: what a sensor would have whose
    /// heading is right. None of motion capture.
    pub unturned: Option<Errors>,
}

/// How a robot carries its tracking camera, seen from the middle between the wheels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CameraMount {
    /// Metres forward.
    pub forward_m: f64,
    /// Metres left.
    pub left_m: f64,
    /// Its heading less the robot's, degrees, counter-clockwise.
    pub yaw_deg: f64,
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
    /// How the robot was taken to carry its camera where that rolls, likewise.
    pub camera: Option<CameraMount>,
    /// Paths against motion capture's.
    pub paths: Vec<PathColumn>,
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
        camera: camera(rows),
        paths: paths::columns(rows),
        errors: kinds.into_iter().flat_map(|kind| errors(rows, kind)).collect(),
        confidence: [full.0, quick.0].concat(),
        refusals: [full.1, quick.1].concat(),
        error_bars: error_bar::columns(rows),
    }
}

/// The median mount over all rows that have one.
fn camera(rows: &[FoldRow]) -> Option<CameraMount> {
    let of = |value: fn(&Mount) -> f64| {
        median(&mut rows.iter().filter_map(|row| row.camera.as_ref()).map(value).collect::<Vec<_>>())
    };
    let (forward_m, left_m) = (of(|mount| mount.offset_m.x)?, of(|mount| mount.offset_m.y)?);
    Some(CameraMount { forward_m, left_m, yaw_deg: of(|mount| mount.yaw_rad)?.to_degrees() })
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
    let (mut oracle, mut unturned, mut failed) = (Vec::new(), Vec::new(), 0);
    for row in rows {
        let own = places.entry(&row.place).or_default();
        match row.answered(which.kind) {
            Some(answered) => {
                own.push(answered.error_deg.abs());
                oracle.push(answered.oracle_deg);
                unturned.extend(
                    row.path
                        .map(|path| wrap_rad(answered.error_deg.to_radians() - path.rotation_rad).to_degrees().abs()),
                );
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
        unturned: (!unturned.is_empty()).then(|| Errors::of(unturned.into_iter())),
    }
}
