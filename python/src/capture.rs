//! Bearings from logs and trajectories.

use crate::error::{Failure, Kind, Stop, interruptible};
use crate::intake::open;
use crate::link::Link;
use crate::options::{Keywords, columns as columns_of};
use crate::pool::{build, pool};
use crate::records::{Records, selected};
use csi5300::bartlett::Grid;
use csi5300::motion::odometry::csv::{self, Columns, CsvCounts, CsvError};
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::nalgebra::Vector3;
use csi5300::pipeline::{
    Answer, Array, ChainConstant, LinkPlan, LinkReport, LogReport, Options, StretchAnswer, Transmitter,
    bearings as estimate, one_log as estimate_one_log,
};
use csi5300::source::{CsiSource, Next, Origin, Stamps};
use csi5300::time::Instant;
use csi5300_lab::kinds::trajectory_refused;
use csi5300_lab::table::{Arena, NO_TIME, antennas};
use driver_iface::record::{Record, Tail};
use numpy::{IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use std::ffi::CString;
use std::path::PathBuf;
use std::sync::Arc;

/// Records in memory as a source.
struct Replayed {
    arena: Arc<Arena>,
    records: Vec<usize>,
    host_us: Vec<i64>,
    /// The next record, and whether its MPDU was given.
    at: (usize, bool),
}

impl CsiSource for Replayed {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, csi5300::source::Error> {
        let (place, mpdu_given) = self.at;
        let Some(&record) = self.records.get(place) else { return Ok(Next::End(Tail::Clean)) };
        let host_us = self.host_us.get(place).copied().filter(|us| *us != NO_TIME);
        let stamps = Stamps { at: now, host_us, origin: Origin::Live { number: place as u64 } };
        let mut parts = self.arena.records(record);
        let (first, second) = (parts.next(), parts.next());
        let (code, body) = match (first, second) {
            (Some(mpdu), Some(bfee)) => {
                self.at = if mpdu_given { (place + 1, false) } else { (place, true) };
                if mpdu_given { bfee } else { mpdu }
            }
            (only, _) => {
                self.at = (place + 1, false);
                only.unwrap_or_default()
            }
        };
        Ok(Next::Record(stamps, Record { code, body }))
    }

    fn next_at(&self) -> Option<Instant> {
        (self.at.0 < self.records.len()).then_some(Instant::ZERO)
    }
}

/// A source that fails once its records are no longer wanted.
struct Stoppable {
    source: Box<dyn CsiSource + Send>,
    stop: Stop,
}

impl CsiSource for Stoppable {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, csi5300::source::Error> {
        if self.stop.is_asked() {
            let what = "reading a log".to_owned();
            return Err(csi5300::source::Error::Io { what, source: std::io::ErrorKind::Interrupted.into() });
        }
        self.source.receive(now)
    }

    fn next_at(&self) -> Option<Instant> {
        self.source.next_at()
    }
}

/// A log argument from Python: a path, bytes, a file object, or (records, rows, host times) of a log in memory.
fn source(log: &Bound<'_, PyAny>, stop: &Stop) -> PyResult<Box<dyn CsiSource + Send>> {
    let Ok(parts) = log.cast::<PyTuple>() else { return Ok(Box::new(open(log, stop)?)) };
    let (records, rows, host_us): (PyRef<'_, Records>, Option<PyReadonlyArray1<'_, i64>>, PyReadonlyArray1<'_, i64>) =
        parts.extract()?;
    let chosen = selected(&records.arena, rows.as_ref())?;
    let host_us = host_us.as_array().iter().copied().collect();
    Ok(Box::new(Replayed { arena: Arc::clone(&records.arena), records: chosen, host_us, at: (0, false) }))
}

/// A trajectory argument from Python: a file, or an array with a file's columns; an array of 4 or 5 columns is seconds, x, y, z and
/// heading.
fn trajectory(of: &Bound<'_, PyAny>, columns: Option<&Columns>) -> PyResult<Trajectory> {
    let (read, name) = if let Ok(rows) = of.extract::<PyReadonlyArray2<'_, f64>>() {
        (poses(&rows, columns).map_err(|error| Failure::new(Kind::Trajectory, error))?, "the array".to_owned())
    } else {
        let path: PathBuf = of.extract()?;
        let (name, columns) = (path.display().to_string(), columns.cloned());
        // On its own thread, because a file may let its reader wait.
        let file = name.clone();
        let read = interruptible(of.py(), &Stop::default(), move || {
            let kind = |error: &CsvError| match error {
                CsvError::Io { .. } => Kind::TrajectoryFile,
                _ => Kind::Trajectory,
            };
            let refused = |error: CsvError| Failure::new(kind(&error), trajectory_refused(&path, &error)).of(file);
            csv::read(&path, columns.as_ref()).map_err(refused)
        })?;
        (read, name)
    };
    let (trajectory, counts) = read;
    let rounded = trajectory.time_step_s().is_some();
    for words in counts.notes(&trajectory).into_iter().filter(|_| rounded || counts.lost_something(&trajectory)) {
        warn(of.py(), &format!("{name}: {words}"))?;
    }
    Ok(trajectory)
}

fn warn(py: Python<'_>, words: &str) -> PyResult<()> {
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &CString::new(words).unwrap_or_default(), 2)
}

/// An array has the columns of a file; with 4 or 5, those of [`pose_array`], unless they may be a file's.
fn poses(rows: &PyReadonlyArray2<'_, f64>, columns: Option<&Columns>) -> Result<(Trajectory, CsvCounts), CsvError> {
    let rows = rows.as_array();
    let own: Option<Columns> = match rows.ncols() {
        4 => "t,x,y,z".parse().ok(),
        5 => "t,x,y,z,yaw".parse().ok(),
        _ => None,
    };
    if columns.is_none() && rows.ncols() == 5 {
        let whole = |value: &f64| value.fract() == 0.0 && (0.0..1e9).contains(value);
        let stands = |column: usize| rows.column(column).iter().all(|value| rows.get((0, column)) == Some(value));
        // Who only turns has the same x, y and z throughout; as a file's columns that would be a robot that only rises.
        let only_turns = stands(1) && stands(2) && stands(3) && !stands(4);
        let has_heading = !rows.column(4).iter().all(|heading| heading.is_nan());
        if rows.column(1).iter().all(whole) && has_heading && !only_turns {
            let why = "the second column is whole, as x seldom is and nanoseconds are".to_owned();
            return Err(CsvError::Ambiguous { why, readings: ["t,x,y,z,yaw", "t,ns,x,y,z"].map(str::to_owned) });
        }
    }
    // As text, so that a row has the same meaning as in a file.
    let mut text = String::new();
    for row in rows.rows() {
        let row: Vec<String> = row.iter().map(f64::to_string).collect();
        text += &(row.join(",") + "\n");
    }
    csv::parse(text.as_bytes(), columns.or(own.as_ref()))
}

/// A trajectory's poses as an array (n, 5): seconds, x, y, z (metres), heading (radians, NaN if unknown).
pub fn pose_array<'py>(py: Python<'py>, trajectory: &Trajectory) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let row = |pose: &Pose| {
        let p = pose.position_m;
        [pose.t_s, p.x, p.y, p.z, pose.heading_rad.unwrap_or(f64::NAN)]
    };
    let values: Vec<f64> = trajectory.poses().iter().flat_map(row).collect();
    values.into_pyarray(py).reshape([trajectory.poses().len(), 5])
}

/// Reads a trajectory file.
#[pyfunction]
#[pyo3(signature = (path, columns=None))]
pub fn read_trajectory<'py>(
    py: Python<'py>,
    path: &Bound<'py, PyAny>,
    columns: Option<&str>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    pose_array(py, &trajectory(path, columns_of(columns)?.as_ref())?)
}

/// A link's answer as JSON, the link itself if it has a bearing, and the answers of its stretches as JSON.
type Linked = (String, Option<Link>, Vec<String>);

/// The keywords of bearings, and the options that they give.
fn asked(keywords: &str, logs: &str) -> Result<(Keywords, Options), Failure> {
    let keywords = Keywords::parse(keywords)?;
    if keywords.channel()?.is_none() {
        return Err(Failure::new(Kind::Option, format!("channel: required, because the {logs} not contain it")));
    }
    let options = Options { keep_course: true, ..keywords.options()? };
    Ok((keywords, options))
}

/// The bearings of a capture: one link per transmitter.
#[pyfunction]
#[pyo3(signature = (rx, tx, names, path, tx_paths, keywords))]
pub fn bearings(
    py: Python<'_>,
    rx: &Bound<'_, PyAny>,
    tx: Vec<Bound<'_, PyAny>>,
    names: Vec<String>,
    path: &Bound<'_, PyAny>,
    tx_paths: Vec<Option<Bound<'_, PyAny>>>,
    keywords: &str,
) -> PyResult<Vec<Linked>> {
    let (keywords, options) = asked(keywords, "logs do")?;
    let options = Options { parallel: tx.len() > 1, ..options };
    let stop = Stop::default();
    let stoppable = |log| PyResult::Ok(Stoppable { source: source(log, &stop)?, stop: stop.clone() });
    let mut receiver = stoppable(rx)?;
    let mut logs = tx.iter().map(stoppable).collect::<PyResult<Vec<_>>>()?;
    let columns = keywords.columns()?;
    let own = keywords.of_antenna(trajectory(path, columns.as_ref())?)?;
    let moved = tx_paths.iter().map(|path| path.as_ref().map(|path| trajectory(path, columns.as_ref())).transpose());
    let moved = moved.collect::<PyResult<Vec<_>>>()?;
    let pool = if keywords.threads == 0 { pool()? } else { Arc::new(build(keywords.threads)?) };
    let every_s = keywords.every;
    let (report, stretches, options, contradiction) = interruptible(py, &stop, move || {
        pool.install(move || {
            let trajectory = |k: usize| moved.get(k).and_then(Option::as_ref);
            let transmitters = logs.iter_mut().enumerate();
            let transmitters = transmitters.map(|(k, log)| Transmitter { log, trajectory: trajectory(k) });
            let report = estimate(&mut receiver, transmitters.collect(), &own, &options);
            let report = report.map_err(|error| match error {
                csi5300::source::Error::MoreMacs { .. } => Failure::new(Kind::Option, format!("tx_mac: {error}")),
                _ => Failure::new(Kind::Capture, error),
            })?;
            let paths: Vec<_> = (0..report.links.len()).map(trajectory).collect();
            let cut = every_s.map(|every_s| report.in_stretches(&own, &paths, every_s, &options));
            let contradiction =
                report.contradiction(std::iter::once(&own).chain(paths.into_iter().flatten()), &options);
            Ok((report, cut.unwrap_or_default(), options, contradiction))
        })
    })?;
    contradiction.map_or(Ok(()), |words| warn(py, &format!("rx: {words}")))?;
    let mut stretches = stretches.into_iter();
    let links = names.into_iter().zip(report.links).zip(&report.transmitters);
    let answer = |((name, link), log): ((String, LinkReport), &LogReport)| {
        let empty = nothing(&report.receiver, log);
        linked(name, link, stretches.next().unwrap_or_default(), (&keywords, &options), empty)
    };
    links.map(answer).collect()
}

/// The bearing of every sender in one log, from the antennas of a robot that turns: their letters, and for each but the first the
/// first one's position relative to it, metres, then the constant of the chains and its deviation, degrees, if known.
#[pyfunction]
#[pyo3(signature = (rx, name, path, letters, baselines, keywords))]
pub fn one_log(
    py: Python<'_>,
    rx: &Bound<'_, PyAny>,
    name: &str,
    path: &Bound<'_, PyAny>,
    letters: &str,
    baselines: Vec<Vec<f64>>,
    keywords: &str,
) -> PyResult<Vec<Linked>> {
    let (keywords, options) = asked(keywords, "log does")?;
    let array = array(letters, &baselines)?;
    let array = if keywords.antenna_offset.is_some() { array.on_trajectory() } else { array };
    let stop = Stop::default();
    let mut log = Stoppable { source: source(rx, &stop)?, stop: stop.clone() };
    let own = keywords.of_antenna(trajectory(path, keywords.columns()?.as_ref())?)?;
    let (report, options, contradiction) = interruptible(py, &stop, move || {
        let report = estimate_one_log(&mut log, &own, &array, &options);
        let report = report.map_err(|error| Failure::new(Kind::Capture, error))?;
        let contradiction = report.contradiction([&own], &options);
        Ok((report, options, contradiction))
    })?;
    contradiction.map_or(Ok(()), |words| warn(py, &format!("rx: {words}")))?;
    if report.links.is_empty() {
        let why = format!("{name}: no record has the CSI of all named antennas ({letters})");
        return Err(Failure::new(Kind::Capture, why).into());
    }
    let several = report.links.len() > 1;
    let answer = |link: LinkReport| {
        let sender = link.mac.map_or_else(|| "unknown".to_owned(), |mac| mac.to_string());
        let name = if several { format!("{name}/{sender}") } else { name.to_owned() };
        linked(name, link, Vec::new(), (&keywords, &options), None)
    };
    report.links.into_iter().map(answer).collect()
}

/// Antennas and baselines, with the constants of their chains.
fn array(letters: &str, baselines: &[Vec<f64>]) -> Result<Array, Failure> {
    let wrong = |why: String| Failure::new(Kind::Option, why);
    // In the caller's order, which the baselines follow.
    let one = |letter: char| antennas(letter.encode_utf8(&mut [0; 4])).and_then(|antennas| antennas.first().copied());
    let named: Option<Vec<_>> = letters.chars().filter(|letter| !matches!(letter, ',' | ' ')).map(one).collect();
    let antennas = named.ok_or_else(|| wrong(format!("antennas: {letters:?} are not of A, B and C")))?;
    let (mut metres, mut constants) = (Vec::new(), Vec::new());
    for baseline in baselines {
        let (place, angles) =
            baseline.split_first_chunk::<3>().filter(|(_, angles)| angles.len() <= 2).ok_or_else(|| {
                wrong(
                    "baseline: three numbers, metres; optionally then the chains' constant and its deviation, degrees"
                        .to_owned(),
                )
            })?;
        metres.push(Vector3::from(*place));
        let sd_rad = angles.get(1).copied().unwrap_or(0.0).to_radians();
        constants.extend(angles.first().map(|deg| ChainConstant { rad: deg.to_radians(), sd_rad }));
    }
    let array = Array::new(&antennas, &metres).and_then(|array| array.with_constants(&constants));
    array.map_err(|error| wrong(format!("antennas, baseline: {error}")))
}

/// Explains the failure if a log has no records at all.
fn nothing(receiver: &LogReport, transmitter: &LogReport) -> Option<String> {
    let (whose, survey) = match (receiver.survey.bfees(), transmitter.survey.bfees()) {
        (0, _) => ("the receiver's log", &receiver.survey),
        (_, 0) => ("the transmitter's log", &transmitter.survey),
        _ => return None,
    };
    let lost = survey.damaged_bytes;
    Some(format!("{whose} holds no record with CSI ({lost} damaged bytes): is it a log of this card?"))
}

/// The Python form of a link.
fn linked(
    name: String,
    link: LinkReport,
    stretches: Vec<StretchAnswer>,
    (keywords, options): (&Keywords, &Options),
    empty: Option<String>,
) -> PyResult<Linked> {
    let internal = |error| Failure::new(Kind::Internal, error);
    let mut answer = Answer::new(name, &link);
    answer.carried = stretches.iter().rev().find_map(|stretch| stretch.answer.carried.clone());
    let own = stretches.into_iter().map(|mut stretch| {
        stretch.answer.link.clone_from(&answer.link);
        stretch.answer.mac.clone_from(&answer.mac);
        serde_json::to_string(&stretch).map_err(internal)
    });
    let own = own.collect::<Result<_, _>>()?;
    if let (true, Ok(bearing)) = (keywords.explain, &link.bearing) {
        let plan = LinkPlan::of(bearing, options, &Grid::azimuth(360));
        answer.plan = Some(plan.map_err(|error| Failure::new(Kind::Option, error))?);
    }
    if let Some(least) = keywords.min_confidence {
        answer.refuse_below(least);
    }
    answer.error = answer.error.map(|error| empty.unwrap_or(error));
    let json = serde_json::to_string(&answer).map_err(internal)?;
    let bearing = link.bearing.ok().filter(|_| answer.azimuth_deg.is_some());
    Ok((json, bearing.map(Link::new), own))
}
