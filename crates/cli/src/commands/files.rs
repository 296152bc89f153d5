//! Files that commands read and write: logs and trajectories, told from other kinds of files; outputs that are not overwritten.

use super::hint;
use csi5300::motion::odometry::csv::{self, CsvCounts, CsvError};
use csi5300::motion::pose::Trajectory;
use csi5300::source::{CsiSource, Next, replay::Replay};
use csi5300::time::Instant;
use std::io::Read;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// A log that is read.
pub type Log = Replay<Box<dyn Read + Send>>;

type Words<T> = std::result::Result<T, String>;

/// What a log is, for who named something else.
const A_LOG: &str = "a log is the .dat that the CSI tool, the WSR toolbox or `csi5300 record` wrote";
/// What a trajectory is.
const A_TRAJECTORY: &str =
    "a trajectory is a CSV of 5, 6, 9 or 15 columns (seconds, nanoseconds, x, y, z ...) or of 8 (TUM)";
/// Bytes in which another kind of file is recognised, and in which a log that begins with damage has its first record.
const BEGINNING: usize = 4_096;
const SEARCHED: u64 = 1 << 20;

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
            "{path}: the checksums beside it know none of its first records: they are of another log, or all of these were \
             changed. Nothing of it is checked"
        );
    }
    Ok(log)
}

/// Refuses what is seen to be another kind of file.
pub fn must_be_log(path: &Path) -> Words<()> {
    match other_kind(path).filter(|_| !has_record(path)) {
        Some(kind) => Err(format!("{} is another kind of file, {kind}: {A_LOG}", path.display())),
        None => Ok(()),
    }
}

/// Reads a trajectory, and says what of it was left out.
///
/// # Errors
/// If it cannot be read, or is another kind of file, in words.
pub fn read_trajectory(path: &Path) -> Words<Trajectory> {
    let name = path.display();
    let (trajectory, counts) = csv::read(path).map_err(|error| match error {
        CsvError::Io { .. } => error.to_string(),
        _ if has_record(path) => format!("{name} is a log of CSI: {A_TRAJECTORY}"),
        _ => match binary_kind(&beginning(path)) {
            Some(kind) => format!("{name} is another kind of file, {kind}: {A_TRAJECTORY}"),
            None => format!("{name}: {error}"),
        },
    })?;
    say_trajectory(path, &trajectory, &counts);
    Ok(trajectory)
}

/// Rows of some trajectory were left out.
static ROWS_LOST: AtomicBool = AtomicBool::new(false);

/// True once rows of a trajectory that was read were left out: what was made of it is done with less than was given.
pub fn rows_were_lost() -> bool {
    ROWS_LOST.load(Ordering::Relaxed)
}

/// Says what of a trajectory was read, and what was left out.
pub fn say_trajectory(path: &Path, trajectory: &Trajectory, counts: &CsvCounts) {
    let name = path.display();
    if counts.lost_something(trajectory) {
        ROWS_LOST.store(true, Ordering::Relaxed);
    }
    detail!("reading {name}: {} poses", trajectory.poses().len());
    for words in counts.notes(trajectory) {
        note!("{name}: {words}");
    }
    for gap in trajectory.gaps() {
        let (length_s, moved_mm) = (gap.to_s - gap.from_s, gap.moved_m * 1e3);
        note!("{name}: no pose for {length_s:.2} s from {:.3} s on (moved {moved_mm:.0} mm meanwhile)", gap.from_s);
    }
}

/// The first bytes of a file; none of what can be read only once.
fn beginning(path: &Path) -> Vec<u8> {
    let mut bytes = Vec::new();
    if path.is_file()
        && let Ok(file) = std::fs::File::open(path)
    {
        let _ = file.take(BEGINNING as u64).read_to_end(&mut bytes);
    }
    bytes
}

/// True if a record is near the beginning of a file.
fn has_record(path: &Path) -> bool {
    let Ok(file) = std::fs::File::open(path) else { return false };
    let mut log = Replay::new(file.take(SEARCHED), String::new());
    loop {
        match log.receive(Instant::ZERO) {
            Ok(Next::Record(..)) => return true,
            Ok(Next::End(_)) | Err(_) => return false,
            Ok(Next::Lost(_) | Next::Pending) => {}
        }
    }
}

/// What a file is that begins as no log does.
fn other_kind(path: &Path) -> Option<&'static str> {
    let bytes = beginning(path);
    binary_kind(&bytes).or_else(|| text_kind(&bytes))
}

/// Kinds of files that begin with a mark of their own.
fn binary_kind(bytes: &[u8]) -> Option<&'static str> {
    const MARKS: [(&[u8], &str); 12] = [
        (
            b"\x89MCAP0\r\n",
            "an MCAP recording (`bearing --bag` reads one of ROS 2, `csi5300 unbag` makes logs and trajectories of it)",
        ),
        (b"SQLite format 3\0", "a SQLite database, as recordings of ROS 2 are (`bearing --bag`, `csi5300 unbag`)"),
        (b"#ROSBAG", "a recording of ROS 1 (`bearing --bag`, `csi5300 unbag`)"),
        (b"PK\x03\x04", "a ZIP archive, as .npz is"),
        (b"PAR1", "a Parquet table"),
        (b"MATLAB 5.0", "a MATLAB file"),
        (&[0xd4, 0xc3, 0xb2, 0xa1], "a packet capture (pcap)"),
        (&[0xa1, 0xb2, 0xc3, 0xd4], "a packet capture (pcap)"),
        (&[0x0a, 0x0d, 0x0d, 0x0a], "a packet capture (pcapng)"),
        (b"\x89PNG", "a picture"),
        (b"\x7fELF", "a program"),
        (&[0x1f, 0x8b], "compressed by gzip"),
    ];
    MARKS.iter().find(|(mark, _)| bytes.starts_with(mark)).map(|(_, kind)| *kind)
}

/// Kinds of text. A log is never text: the first byte of each record is the high one of its length.
fn text_kind(bytes: &[u8]) -> Option<&'static str> {
    let is_text = |byte: &u8| matches!(byte, b'\t' | b'\n' | b'\r' | b' '..=b'~' | 0x80..);
    if bytes.is_empty() || !bytes.iter().all(is_text) {
        return None;
    }
    let text = String::from_utf8(bytes.to_vec()).ok().or_else(|| {
        // A letter may be cut at the end.
        let whole = bytes.len().saturating_sub(3);
        bytes.get(..whole).and_then(|bytes| String::from_utf8(bytes.to_vec()).ok())
    })?;
    let cells = |line: &str| line.split(',').filter(|cell| cell.trim().parse::<f64>().is_ok()).count();
    Some(match text.trim_start().chars().next() {
        Some('{' | '[') => "JSON or TOML",
        _ if text.lines().take(5).any(|line| cells(line) >= 3) => "a table of numbers such as a trajectory",
        _ => "text",
    })
}

/// True if both names lead to one file, by whatever links; `-` is what standard input was opened from.
pub fn is_same_file(input: &Path, output: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let input = if input.as_os_str() == "-" { Path::new("/dev/stdin") } else { input };
    match (input.metadata(), output.metadata()) {
        (Ok(a), Ok(b)) => (a.dev(), a.ino()) == (b.dev(), b.ino()),
        _ => false,
    }
}

/// Refuses an output that is there already, unless `--force` was given.
pub fn must_not_exist(output: &Path, force: bool) -> Words<()> {
    // Devices and pipes hold nothing that could be lost.
    match output.metadata() {
        Ok(found) if !force && found.is_file() => {
            Err(format!("{} is there already: --force overwrites it", output.display()))
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
        // Text that is longer than what is looked at first, then a log: what can be read of it is.
        let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/small-circle");
        let is_log = |path: &Path| path.extension().is_some_and(|extension| extension == "dat");
        let logs = std::fs::read_dir(fixtures).unwrap().map(|entry| entry.unwrap().path());
        let log = std::fs::read(logs.filter(|path| is_log(path)).min().unwrap()).unwrap();
        let damaged = folder.join("damaged.dat");
        std::fs::write(&damaged, [&b"words, ".repeat(BEGINNING)[..], &log].concat()).unwrap();
        assert!(other_kind(&damaged).is_some() && open_log(&damaged).is_ok());
        std::fs::write(folder.join("log.csv"), &log).unwrap();
        let error = read_trajectory(&folder.join("log.csv")).err().unwrap();
        assert!(error.contains("is a log of CSI: a trajectory is"), "{error}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
