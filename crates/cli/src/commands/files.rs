//! Files that commands read and write: logs, trajectories, other kinds of files; outputs that are not overwritten.

use super::Words;
use super::hint;
use csi5300::motion::odometry::csv::{self, Columns, CsvCounts};
use csi5300::motion::pose::Trajectory;
use csi5300::source::replay::Replay;
use csi5300_lab::kinds::{A_LOG, not_a_log, trajectory_refused};
use std::io::Read;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// A log that is read.
pub type Log = Replay<Box<dyn Read + Send>>;

/// Opens a log; `-` is standard input.
///
/// # Errors
/// If it cannot be opened, or is another kind of file, in words.
pub fn open_log(path: &Path) -> Words<Log> {
    let log = Replay::open(path).map_err(|error| hint::log_refused(&error))?;
    must_be_log(path)?;
    detail!("reading {}", path.display());
    if log.checks().is_some_and(|checks| checks.out_of_step) {
        let path = path.display();
        note!(
            "{path}: the checksums beside it know none of its first records: they are of another log, or all were changed. No record is checked"
        );
    }
    Ok(log)
}

/// Refuses an empty file.
pub fn must_not_be_empty(path: &Path) -> Words<()> {
    match path.metadata() {
        Ok(found) if found.is_file() && found.len() == 0 => {
            Err(format!("{} is empty; for a log, `csi5300 doctor` finds the reason", path.display()))
        }
        _ => Ok(()),
    }
}

/// Refuses a recognised file of another kind.
pub fn must_be_log(path: &Path) -> Words<()> {
    match not_a_log(path) {
        Some(kind) => Err(format!("{} is another kind of file, {kind}: {A_LOG}", path.display())),
        None => Ok(()),
    }
}

/// Reads a trajectory, and reports skipped rows.
///
/// # Errors
/// If it cannot be read, or is another kind of file, in words.
pub fn read_trajectory(path: &Path) -> Words<Trajectory> {
    read_trajectory_as(path, None)
}

/// Reads a trajectory whose columns are named.
///
/// # Errors
/// As [`read_trajectory`].
pub fn read_trajectory_as(path: &Path, columns: Option<&Columns>) -> Words<Trajectory> {
    let (trajectory, counts) = csv::read_as(path, columns).map_err(|error| trajectory_refused(path, &error))?;
    say_trajectory(path, &trajectory, &counts);
    Ok(trajectory)
}

/// Rows of some trajectory were skipped.
static ROWS_LOST: AtomicBool = AtomicBool::new(false);

/// True once rows of any trajectory were skipped: results then use less than was given.
pub fn rows_were_lost() -> bool {
    ROWS_LOST.load(Ordering::Relaxed)
}

/// Reports how a trajectory was read, and which rows were skipped.
pub fn say_trajectory(path: &Path, trajectory: &Trajectory, counts: &CsvCounts) {
    let name = path.display();
    if counts.lost_something(trajectory) {
        ROWS_LOST.store(true, Ordering::Relaxed);
    }
    detail!("reading {name}: {} poses, columns {}", trajectory.poses().len(), counts.taken_for);
    for words in counts.notes(trajectory) {
        note!("{name}: {words}");
    }
    for gap in trajectory.gaps() {
        let (length_s, moved_mm) = (gap.to_s - gap.from_s, gap.moved_m * 1e3);
        note!("{name}: no pose for {length_s:.2} s from {:.3} s on (moved {moved_mm:.0} mm meanwhile)", gap.from_s);
    }
}

/// True if both names lead to one file, by any links; `-` is the file behind standard input.
pub fn is_same_file(input: &Path, output: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let input = if input.as_os_str() == "-" { Path::new("/dev/stdin") } else { input };
    match (input.metadata(), output.metadata()) {
        (Ok(a), Ok(b)) => (a.dev(), a.ino()) == (b.dev(), b.ino()),
        _ => false,
    }
}

/// Refuses an existing output, unless `--force` was given, which replaces files but not pipes: they would wait for a
/// reader.
pub fn must_not_exist(output: &Path, force: bool) -> Words<()> {
    use std::os::unix::fs::FileTypeExt;
    // Standard output is one of the program's own.
    let is_own = |path: &Path| path.starts_with("/dev") || path.starts_with("/proc");
    match output.metadata() {
        Ok(found) if force && found.file_type().is_fifo() && !is_own(output) => {
            Err(format!("{} is a pipe, which --force does not replace", output.display()))
        }
        // Devices and pipes hold nothing that could be lost.
        Ok(found) if !force && found.is_file() => {
            Err(format!("{} already exists: --force overwrites it", output.display()))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_kinds_of_files_are_named_and_a_log_behind_damage_is_a_log() {
        let folder = std::env::temp_dir().join(format!("csi5300-kinds-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let table = b"1.5,0,0.1,0.2,0.3,\n1.6,0,0.1,0.2,0.3,\n";
        let pcap = [&[0xd4, 0xc3, 0xb2, 0xa1][..], &[0; 20]].concat();
        for (bytes, words) in [
            (&table[..], "a table of numbers such as a trajectory: a log is"),
            (b"It was a dark and stormy night.\n", "text: a log is"),
            (b"{\"a\": 1}", "JSON or TOML: a log is"),
            (b"\x89MCAP0\r\n\x01", "`csi5300 unbag`"),
            (&pcap[..], "(pcap): a log is"),
        ] {
            let path = folder.join("file.dat");
            std::fs::write(&path, bytes).unwrap();
            let error = open_log(&path).err().unwrap();
            assert!(error.contains("is another kind of file") && error.contains(words), "{error}");
        }
        // Text longer than the searched beginning, then a log: its readable part is read.
        let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/small-circle");
        let is_log = |path: &Path| path.extension().is_some_and(|extension| extension == "dat");
        let logs = std::fs::read_dir(fixtures).unwrap().map(|entry| entry.unwrap().path());
        let log = std::fs::read(logs.filter(|path| is_log(path)).min().unwrap()).unwrap();
        let damaged = folder.join("damaged.dat");
        std::fs::write(&damaged, [&b"words, ".repeat(4_096)[..], &log].concat()).unwrap();
        assert!(open_log(&damaged).is_ok());
        std::fs::write(folder.join("log.csv"), &log).unwrap();
        let error = read_trajectory(&folder.join("log.csv")).err().unwrap();
        assert!(error.contains("is a log of CSI: a trajectory is"), "{error}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
