//! Bearings against truth, over a tree of captures laid out as the WSR data set.
//!
//! A capture is a folder with `groundtruth_positions.json` and, for each time stamp TS in it, `csi_rx_TS.dat`, one
//! `csi_txK_TS.dat` for each transmitter, and the receiver's trajectory as `rx_trajectory_TS_.csv` (motion capture),
//! `t265_rx_trajectory_TS_.csv` or `odom_rx_trajectory_TS_.csv`. Folders may be nested anyhow.

use csi5300::motion::odometry;
use csi5300::motion::pose::{Trajectory, wrap_rad};
use csi5300::pipeline::answer::{Answer, lost_something};
use csi5300::pipeline::link::Bearing;
use csi5300::pipeline::{Options, Transmitter, bearings};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, replay::Replay};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The file that makes a folder a capture.
pub const TRUTH_FILE: &str = "groundtruth_positions.json";

/// Which trajectory of a capture is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Source {
    /// Motion capture.
    #[default]
    GroundTruth,
    /// Tracking camera.
    T265,
    /// Wheel odometry.
    Odometry,
}

impl Source {
    fn prefix(self) -> &'static str {
        match self {
            Self::GroundTruth => "rx_trajectory_",
            Self::T265 => "t265_rx_trajectory_",
            Self::Odometry => "odom_rx_trajectory_",
        }
    }
}

/// One run: the logs and trajectories of one time stamp.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Capture {
    /// Folder below the evaluated one, with forward slashes.
    pub place: String,
    /// Time stamp in the file names.
    pub stamp: String,
    /// The folder.
    pub folder: PathBuf,
    /// Transmitters: name (`tx2`) and log.
    pub transmitters: Vec<(String, PathBuf)>,
}

/// A link's answer beside its truth: a row of `evaluate --json`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Judged {
    /// The answer.
    #[serde(flatten)]
    pub answer: Answer,
    /// Bearing from the first pose of the motion, degrees.
    pub true_from_start_deg: Option<f64>,
    /// Bearing from the mean pose of the pairs used, degrees: what a far-field estimator sees.
    pub true_from_mean_pose_deg: Option<f64>,
    /// Estimate less truth, wrapped, degrees.
    pub error_from_start_deg: Option<f64>,
    /// Estimate less truth, wrapped, degrees.
    pub error_from_mean_pose_deg: Option<f64>,
    /// Horizontal distance from the mean pose to the transmitter, metres.
    pub true_range_m: Option<f64>,
    /// Horizontal range reported less the true one, metres.
    pub range_error_m: Option<f64>,
    /// Where the transmitter is, metres.
    pub true_transmitter_m: Option<[f64; 2]>,
    /// Mean pose of the pairs used, metres, from motion capture.
    pub true_receiver_m: Option<[f64; 2]>,
}

impl Judged {
    /// The set: the first part of the link's name.
    #[must_use]
    pub fn set(&self) -> &str {
        self.answer.link.split('/').next().unwrap_or_default()
    }
}

/// Errors of a set of links, degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
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
            // Not a number, null in JSON: no links are not links without error.
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

/// The value below which `share` of the sorted values lie, interpolated linearly between neighbours; not a number if there
/// are none.
pub(crate) fn percentile(sorted: &[f64], share: f64) -> f64 {
    let place = share * sorted.len().saturating_sub(1) as f64;
    let at = |index: f64| sorted.get(index as usize).copied().unwrap_or(f64::NAN);
    at(place.floor()) + (at(place.ceil()) - at(place.floor())) * place.fract()
}

/// Statistics of one set.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SetSummary {
    /// Links found, failed ones included.
    pub links: usize,
    /// Links without a bearing.
    pub failed: usize,
    /// Against the bearing from the mean pose.
    pub from_mean_pose: Errors,
    /// Against the bearing from the start pose.
    pub from_start: Errors,
}

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
    sets.insert("all".into(), summary(&rows.iter().collect::<Vec<_>>()));
    sets
}

/// Finds the captures below `root`, in the order of their names, and folders that could not be read.
#[must_use]
pub fn find(root: &Path) -> (Vec<Capture>, Vec<String>) {
    let (mut captures, mut unreadable) = (Vec::new(), Vec::new());
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        let entries = match std::fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(error) => {
                unreadable.push(format!("{}: {error}", folder.display()));
                continue;
            }
        };
        let mut names = Vec::new();
        for entry in entries.flatten() {
            // Links are not followed: they may lead in circles.
            match entry.file_type() {
                Ok(kind) if kind.is_dir() => folders.push(entry.path()),
                _ => names.extend(entry.file_name().into_string().ok()),
            }
        }
        if names.iter().any(|name| name == TRUTH_FILE) {
            captures.extend(captures_in(root, &folder, &names));
        }
    }
    captures.sort_by(|a, b| (&a.place, &a.stamp).cmp(&(&b.place, &b.stamp)));
    unreadable.sort();
    (captures, unreadable)
}

fn captures_in(root: &Path, folder: &Path, names: &[String]) -> Vec<Capture> {
    let below = folder.strip_prefix(root).unwrap_or(folder);
    let place: Vec<_> = below.components().map(|part| part.as_os_str().to_string_lossy().into_owned()).collect();
    // A stamp with a transmitter's log only is a capture too, one that cannot be used and is said to be so.
    let stamp_of = |name: &'_ String| -> Option<String> {
        let name = name.strip_suffix(".dat")?;
        let of_tx = || name.strip_prefix("csi_tx")?.trim_start_matches(|c: char| c.is_ascii_digit()).strip_prefix('_');
        name.strip_prefix("csi_rx_").or_else(of_tx).map(str::to_owned)
    };
    let stamps: BTreeSet<String> = names.iter().filter_map(stamp_of).collect();
    let capture = |stamp: &str| {
        let transmitter = |name: &String| {
            let k = name.strip_prefix("csi_tx")?.strip_suffix(".dat")?.strip_suffix(stamp)?.strip_suffix('_')?;
            (!k.is_empty() && k.bytes().all(|b| b.is_ascii_digit())).then(|| (format!("tx{k}"), folder.join(name)))
        };
        let mut transmitters: Vec<_> = names.iter().filter_map(transmitter).collect();
        transmitters.sort();
        Capture { place: place.join("/"), stamp: stamp.into(), folder: folder.into(), transmitters }
    };
    stamps.iter().map(|stamp| capture(stamp)).collect()
}

#[derive(Deserialize)]
struct TruthFile {
    channel: Option<Value<u32>>,
    true_tx_positions: Option<Value<BTreeMap<String, TruePose>>>,
}

#[derive(Deserialize)]
struct Value<T> {
    value: T,
}

#[derive(Deserialize)]
struct TruePose {
    position: Xyz,
}

#[derive(Clone, Copy, Deserialize)]
struct Xyz {
    x: f64,
    y: f64,
}

/// What the evaluation of a capture gave.
pub struct Evaluated {
    /// One row for each transmitter (one in all if the capture could not be read).
    pub rows: Vec<Judged>,
    /// True if records were lost before a log's tail or a link failed.
    pub lost: bool,
    /// What was lost or left out, a line each, with the file's name.
    pub notes: Vec<String>,
}

/// What a log lost before its tail, in a line; nothing if nothing was.
fn loss_note(path: &Path, survey: &Survey) -> Option<String> {
    let first = survey.losses.first().map(|loss| format!("; the first at offset {}: {}", loss.offset, loss.reason));
    let (damages, bytes, bad) = (survey.damages, survey.damaged_bytes, survey.bad_bfee);
    survey.lost_something().then(|| {
        let first = first.unwrap_or_default();
        format!("{}: {damages} damaged stretches ({bytes} bytes), {bad} impossible records{first}", path.display())
    })
}

impl Capture {
    /// Name of a link of this capture, or of the capture where `transmitter` is empty.
    #[must_use]
    pub fn link_name(&self, transmitter: &str) -> String {
        let parts = [self.place.as_str(), self.stamp.as_str(), transmitter];
        parts.iter().filter(|part| !part.is_empty()).copied().collect::<Vec<_>>().join("/")
    }

    /// Estimates every link and compares it with the truth. What cannot be read becomes a row with its error.
    #[must_use]
    pub fn evaluate(&self, source: Source, channel: Option<Channel>, options: &Options) -> Evaluated {
        self.evaluate_and(source, channel, options, &mut |_, _, _| {})
    }

    /// The same, showing each link's bearing to `look` with the link's name and the options that it was made by: for
    /// pictures.
    #[must_use]
    pub fn evaluate_and(
        &self,
        source: Source,
        channel: Option<Channel>,
        options: &Options,
        look: &mut dyn FnMut(&str, &Bearing, &Options),
    ) -> Evaluated {
        self.try_evaluate(source, channel, options, look).unwrap_or_else(|error| {
            let row = |name: &str| Judged {
                answer: Answer::failed(self.link_name(name), error.clone()),
                ..Judged::default()
            };
            let rows = match self.transmitters.as_slice() {
                [] => vec![row("")],
                some => some.iter().map(|(name, _)| row(name)).collect(),
            };
            Evaluated { rows, lost: true, notes: Vec::new() }
        })
    }

    fn trajectory(&self, source: Source, notes: &mut Vec<String>) -> Result<Trajectory, String> {
        let path = self.folder.join(format!("{}{}_.csv", source.prefix(), self.stamp));
        let read = odometry::csv::read(&path).map_err(|error| match error {
            odometry::csv::CsvError::Io { .. } => error.to_string(),
            _ => format!("{}: {error}", path.display()),
        });
        let (trajectory, counts) = read?;
        if let Some((line, why)) = counts.first_bad {
            let rows = counts.bad_rows;
            notes.push(format!("{}: {rows} rows left out, the first in line {line}: {why}", path.display()));
        }
        Ok(trajectory)
    }

    fn try_evaluate(
        &self,
        source: Source,
        channel: Option<Channel>,
        options: &Options,
        look: &mut dyn FnMut(&str, &Bearing, &Options),
    ) -> Result<Evaluated, String> {
        let truth = self.truth()?;
        let channel = match (channel, &truth.channel) {
            (Some(channel), _) => channel,
            (None, Some(named)) => Channel::new(named.value, Width::Ht20).map_err(|e| format!("{TRUTH_FILE}: {e}"))?,
            (None, None) => return Err(format!("{TRUTH_FILE} names no channel: give --channel")),
        };
        if self.transmitters.is_empty() {
            return Err(format!("no csi_txK_{}.dat beside csi_rx_{}.dat", self.stamp, self.stamp));
        }
        let mut notes = Vec::new();
        let trajectory = self.trajectory(source, &mut notes)?;
        let reference = match source {
            Source::GroundTruth => Some(trajectory.clone()),
            _ => self.trajectory(Source::GroundTruth, &mut notes).ok(),
        };
        let options = Options { channel, ..options.clone() };
        let open = |path: &Path| Replay::open(path).map_err(|error| error.to_string());
        let rx_path = self.folder.join(format!("csi_rx_{}.dat", self.stamp));
        let mut receiver = open(&rx_path)?;
        // A transmitter's log that cannot be opened costs its own link; the others go on.
        let nothing = || Replay::new(Box::new(std::io::empty()) as Box<dyn std::io::Read + Send>, String::new());
        let opened = self.transmitters.iter().map(|(_, path)| match open(path) {
            Ok(log) => (log, None),
            Err(error) => (nothing(), Some(error)),
        });
        let (mut logs, failed): (Vec<_>, Vec<Option<String>>) = opened.unzip();
        let transmitters =
            logs.iter_mut().map(|log| Transmitter { log: log as &mut dyn CsiSource, trajectory: None }).collect();
        let report = bearings(&mut receiver, transmitters, &trajectory, &options).map_err(|error| error.to_string())?;
        let judge = |((name, _), link): (&(String, PathBuf), &csi5300::pipeline::LinkReport)| {
            let answer = Answer::new(self.link_name(name), link);
            let position = truth.true_tx_positions.as_ref().and_then(|positions| positions.value.get(name));
            let times = link.bearing.as_ref().map(|bearing| bearing.samples.t_s.as_slice()).unwrap_or_default();
            judge(answer, position.map(|pose| pose.position), reference.as_ref(), times)
        };
        for ((name, _), link) in self.transmitters.iter().zip(&report.links) {
            if let Ok(bearing) = &link.bearing {
                look(&self.link_name(name), bearing, &options);
            }
        }
        let mut rows: Vec<Judged> = self.transmitters.iter().zip(&report.links).map(judge).collect();
        for (row, error) in rows.iter_mut().zip(failed) {
            if let Some(error) = error {
                row.answer = Answer::failed(row.answer.link.clone(), error);
            }
        }
        let paths = std::iter::once(&rx_path).chain(self.transmitters.iter().map(|(_, path)| path));
        let surveys = std::iter::once(&report.receiver).chain(&report.transmitters).map(|log| &log.survey);
        notes.extend(paths.zip(surveys).filter_map(|(path, survey)| loss_note(path, survey)));
        Ok(Evaluated { rows, lost: lost_something(&report), notes })
    }

    fn truth(&self) -> Result<TruthFile, String> {
        let path = self.folder.join(TRUTH_FILE);
        let text = std::fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        serde_json::from_str(&text).map_err(|error| format!("{}: {error}", path.display()))
    }
}

fn judge(answer: Answer, position: Option<Xyz>, reference: Option<&Trajectory>, times_s: &[f64]) -> Judged {
    let bearing_from = |from: Vector3<f64>| position.map(|p| (p.y - from.y).atan2(p.x - from.x).to_degrees());
    let start = reference.and_then(|reference| {
        let at_s = reference.motion().window_s.map_or(reference.span_s().0, |(from, _)| from);
        reference.at(at_s)
    });
    let seen: Vec<_> = reference.map(|r| times_s.iter().filter_map(|&t| r.at(t)).collect()).unwrap_or_default();
    let sum = seen.iter().fold(Vector3::zeros(), |sum, pose| sum + pose.position_m);
    let mean = (!seen.is_empty()).then(|| sum / seen.len() as f64);
    let true_from_start_deg = start.and_then(|pose| bearing_from(pose.position_m));
    let true_from_mean_pose_deg = mean.and_then(bearing_from);
    let error = |truth: Option<f64>| {
        let (azimuth, truth) = answer.azimuth_deg.zip(truth)?;
        Some(wrap_rad((azimuth - truth).to_radians()).to_degrees())
    };
    let true_range_m = position.zip(mean).map(|(p, from)| (p.x - from.x).hypot(p.y - from.y));
    let level = answer.abs_elevation_deg.unwrap_or(0.0).to_radians().cos();
    Judged {
        true_range_m,
        range_error_m: answer.range_m.zip(true_range_m).map(|(range, truth)| range * level - truth),
        true_transmitter_m: position.map(|p| [p.x, p.y]),
        true_receiver_m: mean.map(|mean| [mean.x, mean.y]),
        error_from_start_deg: error(true_from_start_deg),
        error_from_mean_pose_deg: error(true_from_mean_pose_deg),
        true_from_start_deg,
        true_from_mean_pose_deg,
        answer,
    }
}
