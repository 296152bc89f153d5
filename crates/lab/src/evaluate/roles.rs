//! Finds the roles of a folder's or command line's files by their content: which log is the receiver's.

use super::find;
use crate::kinds::has_record;
use csi5300::Log;
use csi5300::motion::odometry::csv::Columns;
use std::path::{Path, PathBuf};

/// A folder with more files is not a capture.
const MOST: usize = 64;

/// The files of a folder that is one capture by content; `None` if a capture in or below it has the usual names, or if it has
/// no log.
#[must_use]
pub fn loose_files(folder: &Path) -> Option<Vec<PathBuf>> {
    find::named(folder).0.is_empty().then(|| files_with_logs(folder)).flatten()
}

/// The files of a folder; `None` if none is a log, or if there are too many.
pub(super) fn files_with_logs(folder: &Path) -> Option<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> = entries.filter(|path| path.is_file()).take(MOST + 1).collect();
    if files.len() > MOST {
        return None;
    }
    files.sort();
    files.iter().any(|file| has_record(file)).then_some(files)
}

/// Logs, trajectories, and other files.
#[derive(Clone, Debug, Default)]
pub struct Sorted {
    /// Logs of CSI.
    pub logs: Vec<PathBuf>,
    /// Trajectories.
    pub trajectories: Vec<PathBuf>,
    /// Other files.
    pub others: Vec<PathBuf>,
}

impl Sorted {
    /// Sorts files by their content; `columns` are those of the trajectories, if known.
    #[must_use]
    pub fn new(files: Vec<PathBuf>, columns: Option<&Columns>) -> Self {
        let mut sorted = Self::default();
        for file in files {
            if has_record(&file) {
                sorted.logs.push(file);
            } else if csi5300::motion::odometry::csv::read_as(&file, columns).is_ok() {
                sorted.trajectories.push(file);
            } else {
                sorted.others.push(file);
            }
        }
        sorted
    }
}

/// The only trajectory.
///
/// # Errors
/// If there is none or more than one; the text names the options that settle it.
pub fn the_trajectory(files: &[PathBuf]) -> Result<PathBuf, String> {
    match files {
        [file] => Ok(file.clone()),
        [] => Err("none of these files is a trajectory: add the receiver's with --trajectory T.csv".into()),
        [first, ..] => {
            let names: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
            let first = first.display();
            Err(format!(
                "each of {} could be the receiver's trajectory: add --trajectory {first}, or another one",
                names.join(", ")
            ))
        }
    }
}

/// The log of the robot whose trajectory is given: the one named so, else the only one that heard several robots, else the only
/// one whose host times lie within the trajectory.
///
/// # Errors
/// If the roles are ambiguous; the text names the commands that settle it.
pub fn receiver(logs: &[PathBuf], trajectory: &Path, needs_two: bool) -> Result<PathBuf, String> {
    match logs {
        [] => return Err("none of these files is a log of CSI: a bearing needs the logs of two robots".into()),
        [one] if needs_two => {
            return Err(format!(
                "{} is the only log: a bearing needs the other robot's too, or --antennas and --baseline of a robot that turns",
                one.display()
            ));
        }
        [one] => return Ok(one.clone()),
        _ => {}
    }
    let is_called_rx = |log: &&PathBuf| {
        let name = log.file_name().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default();
        name.split(|letter: char| !letter.is_ascii_alphabetic()).any(|word| word == "rx")
    };
    if let Some(one) = exactly_one(logs.iter().filter(is_called_rx)) {
        return Ok(one.clone());
    }
    let surveys: Vec<(&PathBuf, Heard)> = logs.iter().filter_map(|log| Some((log, heard(log)?))).collect();
    let several = surveys.iter().filter(|(_, heard)| heard.senders > 1);
    if let Some((log, _)) = exactly_one(several) {
        return Ok((*log).clone());
    }
    if let Ok((poses, _)) = csi5300::motion::odometry::csv::read_as(trajectory, None)
        && let Some((from, to)) = poses.poses().first().zip(poses.poses().last())
    {
        let within = surveys.iter().filter(|(_, heard)| heard.host_s.is_some_and(|(a, b)| a < to.t_s && b > from.t_s));
        if let Some((log, _)) = exactly_one(within) {
            return Ok((*log).clone());
        }
    }
    let (a, b) = (logs[0].display(), logs[1].display());
    let t = trajectory.display();
    Err(format!(
        "which log is of the robot that drove {t}? Name it: --rx {a} --tx {b} --trajectory {t}, or --rx {b} --tx {a} --trajectory {t}"
    ))
}

/// What a log shows of its robot.
struct Heard {
    senders: usize,
    host_s: Option<(f64, f64)>,
}

fn heard(path: &Path) -> Option<Heard> {
    let mut log = Log::open(path).ok()?;
    while log.next().is_some_and(|frame| frame.is_ok()) {}
    let survey = log.survey();
    // A sender with few records passed by and is not a robot of the capture.
    let most = survey.senders.values().map(|sender| sender.records).max().unwrap_or(0);
    let senders = survey.senders.values().filter(|sender| 10 * sender.records > most).count();
    Some(Heard { senders, host_s: survey.host_us.map(|(a, b)| (a as f64 * 1e-6, b as f64 * 1e-6)) })
}

/// The only item, if there is one.
fn exactly_one<T>(mut all: impl Iterator<Item = T>) -> Option<T> {
    let first = all.next()?;
    all.next().is_none().then_some(first)
}
