//! Captures against their truth.

use crate::error::{Failure, Kind, interruptible};
use crate::options::Keywords;
use crate::pool::{build, pool};
use csi5300_lab::evaluate::{Capture, TrajectorySource, find};
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::Arc;

/// The captures below a folder: place, stamp, folder, and names and logs of the transmitters; and folders that could not be
/// read.
type Found = (Vec<(String, String, PathBuf, Vec<(String, PathBuf)>)>, Vec<String>);

/// Finds captures, in the order of their names.
#[pyfunction]
pub fn find_captures(py: Python<'_>, root: PathBuf) -> PyResult<Found> {
    interruptible(py, move || {
        let (captures, unreadable) = find(&root);
        let parts = |c: Capture| (c.place, c.stamp, c.folder, c.transmitters);
        Ok((captures.into_iter().map(parts).collect(), unreadable))
    })
}

/// Evaluates one capture: JSON with `rows`, `notes` and `lost`.
#[pyfunction]
#[pyo3(signature = (place, stamp, folder, transmitters, trajectory, keywords))]
pub fn evaluate_capture(
    py: Python<'_>,
    place: String,
    stamp: String,
    folder: PathBuf,
    transmitters: Vec<(String, PathBuf)>,
    trajectory: &str,
    keywords: &str,
) -> PyResult<String> {
    let source = match trajectory {
        "gt" => TrajectorySource::GroundTruth,
        "t265" => TrajectorySource::T265,
        "odom" => TrajectorySource::Odometry,
        other => {
            return Err(Failure::new(Kind::Option, format!("trajectory: {other:?} is not gt, t265 or odom")).into());
        }
    };
    let keywords = Keywords::parse(keywords)?;
    let (options, channel) = (keywords.options()?, keywords.channel()?);
    let capture = Capture { place, stamp, folder, transmitters };
    let pool = if keywords.threads == 0 { pool()? } else { Arc::new(build(keywords.threads)?) };
    interruptible(py, move || {
        let evaluated = pool.install(|| capture.evaluate(source, channel, &options));
        let json = serde_json::json!({ "rows": evaluated.rows, "notes": evaluated.notes, "lost": evaluated.lost });
        serde_json::to_string(&json).map_err(|error| Failure::new(Kind::Internal, error))
    })
}
