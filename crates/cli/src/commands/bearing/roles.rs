//! Which of the files that were named is what: logs and trajectories by their content.

use super::super::files::{is_same_file, must_not_be_empty};
use super::super::usage;
use super::Args;
use csi5300::motion::odometry::csv;
use csi5300_lab::evaluate::captures::{Sorted, loose_files, receiver, the_trajectory};
use csi5300_lab::evaluate::{TRUTH_FILE, channel_number_in};
use csi5300_lab::kinds::trajectory_refused;
use std::path::{Path, PathBuf};

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
        named => {
            let missing = named.iter().find(|path| !path.exists() && path.extension().is_some());
            return match missing.filter(|_| named.iter().any(|path| path.is_file())) {
                Some(path) => Err(format!("{}: no such file", path.display())),
                None => refuse_named(args),
            };
        }
    };
    let is_named_one_by_one = args.captures.iter().all(|path| path.is_file());
    if !is_named_one_by_one && (args.logs.rx.is_some() || !args.logs.tx.is_empty()) {
        usage("name the logs one by one, or their folder without --rx and --tx");
    }
    // A shell expands `--tx csi_tx*.dat` to one name behind the option and others that stand alone.
    let files: Vec<PathBuf> = args.logs.tx.drain(..).chain(files).collect();
    if let Some((_, twice)) =
        files.iter().enumerate().find(|(k, file)| files[..*k].iter().any(|other| is_same_file(other, file)))
    {
        return Err(format!("{} is given twice: each robot has its own log", twice.display()));
    }
    let Sorted { logs, trajectories, others } = Sorted::new(files, args.logs.columns.as_ref());
    if let (Some(file), true) = (others.first(), is_named_one_by_one) {
        must_not_be_empty(file)?;
        let why = csv::read_as(file, args.logs.columns.as_ref()).err();
        let why = why.map_or_else(|| file.display().to_string(), |error| trajectory_refused(file, &error));
        return Err(format!("neither a log of CSI nor a trajectory: {why}"));
    }
    let trajectory = args.logs.trajectory.take().map_or_else(|| the_trajectory(&trajectories), Ok)?;
    let rx = match args.logs.rx.take() {
        Some(rx) => rx,
        None => receiver(&logs, &trajectory, args.logs.baseline.is_empty())?,
    };
    args.logs.tx = logs.iter().filter(|log| **log != rx).cloned().collect();
    note!("{} is the receiver's log, {} its trajectory", rx.display(), trajectory.display());
    if args.channel.is_none() {
        let folder = rx.parent().unwrap_or(Path::new(""));
        let Some(number) = channel_number_in(folder).map_err(|error| error.to_string())? else {
            usage(
                "--channel is needed, such as --channel 108: no groundtruth_positions.json beside these logs names it",
            );
        };
        args.channel = Some(number.to_string().parse().map_err(|error| format!("channel {number}: {error}"))?);
        note!("channel {number}, by {}", folder.join(TRUTH_FILE).display());
    }
    (args.logs.rx, args.logs.trajectory) = (Some(rx), Some(trajectory));
    args.captures.clear();
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
