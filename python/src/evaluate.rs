//! Evaluates captures against their truth.

use crate::error::{Cancel, Failure, Kind, Stop, interruptible, stopped};
use crate::options::Keywords;
use crate::pool::{build, pool};
use csi5300::motion::pose::Mount;
use csi5300::pipeline::Options;
use csi5300::signal::channel::Channel;
use csi5300_lab::evaluate::{Capture, Loose, TrajectorySource, find};
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::Arc;

/// The receiver's log and trajectory, if their names are not the usual ones.
type LooseFiles = Option<(PathBuf, PathBuf)>;

/// A capture: place, stamp, folder, names and logs of the transmitters, and [`LooseFiles`].
type Parts = (String, String, PathBuf, Vec<(String, PathBuf)>, LooseFiles);

/// The captures below a folder, and the unreadable folders.
type Found = (Vec<Parts>, Vec<String>);

/// Finds captures, in order of name.
#[pyfunction]
pub fn find_captures(py: Python<'_>, root: PathBuf) -> PyResult<Found> {
    interruptible(py, &Stop::default(), move || {
        let (captures, unreadable) = find(&root);
        let loose = |own: Box<Loose>| (own.log, own.trajectory);
        let parts = |c: Capture| (c.place, c.stamp, c.folder, c.transmitters, c.loose.map(loose));
        Ok((captures.into_iter().map(parts).collect(), unreadable))
    })
}

/// One set of evaluation options.
struct Run {
    source: TrajectorySource,
    options: Options,
    channel: Option<Channel>,
    antenna_offset_m: Option<[f64; 3]>,
    camera: Option<Mount>,
    threads: usize,
}

impl Run {
    fn new(trajectory: &str, keywords: &str) -> Result<Self, Failure> {
        let wrong = |why: String| Err(Failure::new(Kind::Option, why));
        let keywords = Keywords::parse(keywords)?;
        keywords.of_captures()?;
        let camera = keywords.camera();
        let source = match (trajectory, camera) {
            ("gt", None) => TrajectorySource::GroundTruth,
            ("t265", None) => TrajectorySource::T265,
            ("t265", Some(_)) => TrajectorySource::RollingT265,
            ("odom", None) => TrajectorySource::Odometry,
            ("gt" | "odom", Some(_)) => {
                return wrong("camera_mount: only for the tracking camera, trajectory=\"t265\"".into());
            }
            (other, _) => return wrong(format!("trajectory: {other:?} is not gt, t265 or odom")),
        };
        let (channel, antenna_offset_m, threads) = (keywords.channel()?, keywords.antenna_offset, keywords.threads);
        Ok(Self { source, options: keywords.options()?, channel, antenna_offset_m, camera, threads })
    }

    /// JSON with `rows`, `notes` and `lost`.
    fn evaluate(&self, capture: &Capture) -> Result<String, Failure> {
        let mounted = Capture { antenna_offset_m: self.antenna_offset_m, camera: self.camera, ..capture.clone() };
        let evaluate = || mounted.evaluate(self.source, self.channel, &self.options);
        let pool = if self.threads == 0 { pool()? } else { Arc::new(build(self.threads)?) };
        let evaluated = pool.install(evaluate);
        let json = serde_json::json!({ "rows": evaluated.rows, "notes": evaluated.notes, "lost": evaluated.lost });
        serde_json::to_string(&json).map_err(|error| Failure::new(Kind::Internal, error))
    }
}

/// Evaluates one capture with each set of options; returns JSON with `rows`, `notes` and `lost` for each.
/// `cancel` ends it early.
#[pyfunction]
#[pyo3(signature = (place, stamp, folder, transmitters, loose, runs, cancel=None))]
#[allow(clippy::too_many_arguments)]
pub fn evaluate_capture(
    py: Python<'_>,
    place: String,
    stamp: String,
    folder: PathBuf,
    transmitters: Vec<(String, PathBuf)>,
    loose: LooseFiles,
    runs: Vec<(String, String)>,
    cancel: Option<PyRef<'_, Cancel>>,
) -> PyResult<Vec<String>> {
    let runs = runs.iter().map(|(trajectory, keywords)| Run::new(trajectory, keywords));
    let runs = runs.collect::<Result<Vec<_>, _>>()?;
    let loose = loose.map(|(log, trajectory)| Box::new(Loose { log, trajectory }));
    let capture = Capture { place, stamp, folder, transmitters, loose, ..Capture::default() };
    let stop = cancel.map(|cancel| cancel.0.clone()).unwrap_or_default();
    let asked = stop.clone();
    interruptible(py, &stop, move || {
        let evaluate = |run: &Run| if asked.is_asked() { Err(stopped()) } else { run.evaluate(&capture) };
        runs.iter().map(evaluate).collect()
    })
}
