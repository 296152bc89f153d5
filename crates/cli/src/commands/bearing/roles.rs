//! Which of the files that were named is what: logs and trajectories by their content.

use super::super::usage;
use super::Args;
use csi5300::Log;
use csi5300_lab::evaluate::find_all;
use csi5300_lab::kinds::has_record;
use std::path::{Path, PathBuf};

/// Files of a folder that are looked at: one with more is a folder of something else.
const MOST: usize = 64;

/// Gives the files that stand for a capture their roles, as if they had been named by `--rx`, `--tx` and `--trajectory`. Folders whose files are
/// named as captures are, and links of them, are left as they are.
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
    if args.logs.rx.is_some() || !args.logs.tx.is_empty() || args.logs.trajectory.is_some() {
        usage("files are named either by --rx, --tx and --trajectory, or without these");
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
    let trajectory = only(&trajectories, "trajectory", "--trajectory")?;
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

/// Captures bring their files, so that options of single logs say nothing of them.
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
            usage(&format!("{name} is of single logs: name the files of the capture instead of its folder"))
        }
        None => Ok(()),
    }
}

/// The files of a folder in which no capture has its usual names; `None` where one has, or where there is no log.
fn loose_files(folder: &Path) -> Option<Vec<PathBuf>> {
    let (captures, _) = find_all(folder);
    if !captures.is_empty() {
        return None;
    }
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .ok()?
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.is_file())
        .take(MOST)
        .collect();
    files.sort();
    files.iter().any(|file| has_record(file)).then_some(files)
}

/// The one file of a kind.
fn only(files: &[PathBuf], kind: &str, option: &str) -> Result<PathBuf, String> {
    match files {
        [file] => Ok(file.clone()),
        [] => Err(format!("none of these files is a {kind}: add it with its {option}")),
        [first, ..] => {
            let names: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
            Err(format!(
                "{} could all be the receiver's {kind}: name the one, {option} {}",
                names.join(", "),
                first.display()
            ))
        }
    }
}

/// The log of the robot whose trajectory is given: by its name, else the only one that heard several robots, else the only one whose host times
/// lie within the trajectory. Where nothing tells, the person is asked.
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

/// What a log's first frames say of it.
struct Heard {
    senders: usize,
    host_s: Option<(f64, f64)>,
}

fn heard(path: &Path) -> Option<Heard> {
    let mut log = Log::open(path).ok()?;
    while log.next().is_some_and(|frame| frame.is_ok()) {}
    let survey = log.survey();
    // A sender that was heard a few times passed by.
    let most = survey.senders.values().map(|sender| sender.records).max().unwrap_or(0);
    let senders = survey.senders.values().filter(|sender| 10 * sender.records > most).count();
    Some(Heard { senders, host_s: survey.host_us.map(|(a, b)| (a as f64 * 1e-6, b as f64 * 1e-6)) })
}

/// The only one of them.
fn exactly_one<T>(mut all: impl Iterator<Item = T>) -> Option<T> {
    let first = all.next()?;
    all.next().is_none().then_some(first)
}
