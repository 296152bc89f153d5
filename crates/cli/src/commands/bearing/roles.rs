//! Which of the files that were named is what: logs and trajectories by their content.

use super::super::usage;
use super::Args;
use csi5300::Log;
use csi5300_lab::evaluate::find_all;
use csi5300_lab::kinds::has_record;
use std::path::{Path, PathBuf};

/// A folder with more files is no capture.
const MOST: usize = 64;

/// Gives each file its role, as if `--rx`, `--tx` and `--trajectory` had named it. It leaves folders of captures with the usual file names, and links
/// of them, alone.
pub fn take(args: &mut Args) -> Result<(), String> {
    let files = match args.captures.as_slice() {
        [] => return Ok(()),
        [folder] if folder.is_dir() => match loose_files(folder) {
            Some(files) => files,
            None => return refuse_named(args),
        },
        named if named.iter().all(|path| path.is_file()) => named.to_vec(),
        _ => return refuse_named(args),
    };
    if args.logs.rx.is_some() || !args.logs.tx.is_empty() {
        usage("name the logs either with --rx and --tx, or without both");
    }
    let is_named_one_by_one = args.captures.iter().all(|path| path.is_file());
    let (mut logs, mut trajectories) = (Vec::new(), Vec::new());
    for file in files {
        if has_record(&file) {
            logs.push(file);
        } else if csi5300::motion::odometry::csv::read_as(&file, args.logs.columns.as_ref()).is_ok() {
            trajectories.push(file);
        } else if is_named_one_by_one {
            return Err(format!("{} is neither a log of CSI nor a trajectory", file.display()));
        }
    }
    let trajectory = args.logs.trajectory.take().map_or_else(|| the_trajectory(&trajectories), Ok)?;
    let rx = receiver(&logs, &trajectory, args.logs.baseline.is_empty())?;
    args.logs.tx = logs.iter().filter(|log| **log != rx).cloned().collect();
    note!("{} is the receiver's log, {} its trajectory", rx.display(), trajectory.display());
    (args.logs.rx, args.logs.trajectory) = (Some(rx), Some(trajectory));
    args.captures.clear();
    if args.channel.is_none() {
        usage("--channel is needed: no groundtruth_positions.json names the WiFi channel of these logs");
    }
    Ok(())
}

/// Refuses options of single logs for a capture, which brings its own files.
fn refuse_named(args: &Args) -> Result<(), String> {
    let logs = &args.logs;
    let given = [
        ("--rx", logs.rx.is_some()),
        ("--tx", !logs.tx.is_empty()),
        ("--tx-trajectory", !logs.tx_trajectory.is_empty()),
        ("--tx-mac", !logs.tx_mac.is_empty()),
        ("--rx-mac", logs.rx_mac.is_some()),
        ("--key", logs.key.is_some()),
        ("--columns", logs.columns.is_some()),
        ("--baseline", !logs.baseline.is_empty()),
        ("--profile", args.profile.is_some()),
    ];
    match given.iter().find(|(_, given)| *given) {
        Some((name, _)) => {
            usage(&format!("{name} applies to single logs: name the files of the capture instead of its folder"))
        }
        None => Ok(()),
    }
}

/// The files of a folder in which no capture has its usual names; `None` where one has, or if there is no log.
fn loose_files(folder: &Path) -> Option<Vec<PathBuf>> {
    let (captures, _) = find_all(folder);
    if !captures.is_empty() {
        return None;
    }
    let entries = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> = entries.filter(|path| path.is_file()).take(MOST + 1).collect();
    if files.len() > MOST {
        return None;
    }
    files.sort();
    files.iter().any(|file| has_record(file)).then_some(files)
}

/// The only trajectory.
fn the_trajectory(files: &[PathBuf]) -> Result<PathBuf, String> {
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

/// The log of the robot whose trajectory is given: by its name, else the only one that heard several robots, else the only one whose host times
/// lie within the trajectory. Otherwise an error asks the person and gives the commands.
fn receiver(logs: &[PathBuf], trajectory: &Path, needs_two: bool) -> Result<PathBuf, String> {
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

/// What a log says of its robot.
struct Heard {
    senders: usize,
    host_s: Option<(f64, f64)>,
}

fn heard(path: &Path) -> Option<Heard> {
    let mut log = Log::open(path).ok()?;
    while log.next().is_some_and(|frame| frame.is_ok()) {}
    let survey = log.survey();
    // A sender with few records passed by and is no robot of the capture.
    let most = survey.senders.values().map(|sender| sender.records).max().unwrap_or(0);
    let senders = survey.senders.values().filter(|sender| 10 * sender.records > most).count();
    Some(Heard { senders, host_s: survey.host_us.map(|(a, b)| (a as f64 * 1e-6, b as f64 * 1e-6)) })
}

/// The only one of them.
fn exactly_one<T>(mut all: impl Iterator<Item = T>) -> Option<T> {
    let first = all.next()?;
    all.next().is_none().then_some(first)
}
