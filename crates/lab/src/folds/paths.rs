//! How the paths of each sensor compare with motion capture's.

use super::gather::{FoldRow, PARTS, SOURCES};
use crate::evaluate::{PathError, TrajectorySource};
use csi5300::maths::median;
use serde::Serialize;
use std::collections::BTreeMap;

/// Paths of one sensor over motions or parts of them.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct PathColumn {
    /// Trajectory.
    pub source: TrajectorySource,
    /// Parts that the motion was cut into.
    pub parts: u32,
    /// Paths.
    pub paths: usize,
    /// By how much they are turned, degrees: mean, standard deviation, and the largest either way.
    pub rotation_deg: [f64; 3],
    /// Metres of path for each driven: median and standard deviation.
    pub scale: [f64; 2],
    /// Root mean square after the best rotation and scale, metres: median and largest.
    pub shape_m: [f64; 2],
}

/// The columns of all sensors but motion capture.
pub(super) fn columns(rows: &[FoldRow]) -> Vec<PathColumn> {
    let each = SOURCES.into_iter().flat_map(|source| PARTS.map(move |parts| (source, parts)));
    let column = |(source, parts)| {
        let own = rows.iter().filter(|row| row.source == source && row.part.of == parts);
        // The links of a capture share its path.
        let paths: BTreeMap<(&str, u32), PathError> =
            own.filter_map(|row| Some(((row.link.rsplit_once('/')?.0, row.part.index), row.path?))).collect();
        (!paths.is_empty()).then(|| column(source, parts, &paths.into_values().collect::<Vec<_>>()))
    };
    each.filter_map(column).collect()
}

fn column(source: TrajectorySource, parts: u32, paths: &[PathError]) -> PathColumn {
    let of = |value: fn(&PathError) -> f64| paths.iter().map(value).collect::<Vec<f64>>();
    let middle = |mut values: Vec<f64>| median(&mut values).unwrap_or(f64::NAN);
    let largest = |values: Vec<f64>| values.into_iter().fold(0.0, |most, value: f64| value.abs().max(most));
    let (rotation_deg, scale) = (of(|own| own.rotation_rad.to_degrees()), of(|own| own.scale));
    let (mean_deg, rotation_sd_deg) = mean_and_deviation(&rotation_deg);
    PathColumn {
        source,
        parts,
        paths: paths.len(),
        rotation_deg: [mean_deg, rotation_sd_deg, largest(rotation_deg)],
        scale: [middle(scale.clone()), mean_and_deviation(&scale).1],
        shape_m: [middle(of(|own| own.shape_m)), largest(of(|own| own.shape_m))],
    }
}

fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    (mean, (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt())
}
