//! Distinguishes logs and trajectories from other kinds of files.

use csi5300::motion::odometry::csv::CsvError;
use csi5300::source::{CsiSource, Next, replay::Replay};
use csi5300::time::Instant;
use std::io::Read;
use std::path::Path;

/// The description of a log, for messages.
pub const A_LOG: &str = "a log is the .dat that the CSI tool, the WSR toolbox or `csi5300 record` wrote";
/// The description of a trajectory.
const A_TRAJECTORY: &str = "a trajectory is a table of times and places, as CSV (docs/reference/formats.md)";
const OTHER_CARD: &str = "a log of another card (`info`, `view`, `bearing --baseline` and `export` as a table read it)";
/// Bytes that identify another kind of file; a log that begins with damage has its first record within them.
const BEGINNING: usize = 4_096;
const SEARCHED: u64 = 1 << 20;

/// The kind of a file that neither begins like a log nor has a record near its beginning.
#[must_use]
pub fn not_a_log(path: &Path) -> Option<&'static str> {
    let bytes = beginning(path);
    let card = crate::cards::is_log(path).then_some(OTHER_CARD);
    card.or_else(|| binary_kind(path, &bytes)).or_else(|| text_kind(&bytes)).filter(|_| !has_record(path))
}

/// Why a file gives no trajectory, in words, with its name and its kind.
#[must_use]
pub fn trajectory_refused(path: &Path, error: &CsvError) -> String {
    let name = path.display();
    match error {
        // Names the file.
        CsvError::Io { .. } => error.to_string(),
        _ if has_record(path) => format!("{name} is a log of CSI: {A_TRAJECTORY}"),
        _ => match binary_kind(path, &beginning(path)) {
            Some(kind) => format!("{name} is another kind of file, {kind}: {A_TRAJECTORY}"),
            None => format!("{name}: {error}"),
        },
    }
}

/// The first bytes of a file; empty for a pipe.
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
pub(crate) fn has_record(path: &Path) -> bool {
    // Standard input can be read only once.
    let Some(mut log) = (path.as_os_str() != "-").then(|| Replay::open(path).ok()).flatten() else { return false };
    while log.bytes() <= SEARCHED {
        match log.receive(Instant::ZERO) {
            Ok(Next::Record(..)) => return true,
            Ok(Next::End(_)) | Err(_) => return false,
            Ok(Next::Lost(_) | Next::Pending) => {}
        }
    }
    false
}

/// Kinds of files with a magic number, and side files.
fn binary_kind(path: &Path, bytes: &[u8]) -> Option<&'static str> {
    const MARKS: [(&[u8], &str); 16] = [
        (
            b"\x89MCAP0\r\n",
            "an MCAP recording (`bearing --bag` reads one of ROS 2, `csi5300 unbag` makes logs and trajectories of it)",
        ),
        (b"SQLite format 3\0", "a SQLite database, as recordings of ROS 2 are (`bearing --bag`, `csi5300 unbag`)"),
        (b"#ROSBAG", "a recording of ROS 1 (`bearing --bag`, `csi5300 unbag`)"),
        (b"PK\x03\x04", "a ZIP archive, as .npz is"),
        (b"PAR1", "a Parquet table"),
        (b"MATLAB ", "a MATLAB file"),
        (b"\x89HDF", "an HDF5 file"),
        (&[0xd4, 0xc3, 0xb2, 0xa1], "a packet capture (pcap)"),
        (&[0xa1, 0xb2, 0xc3, 0xd4], "a packet capture (pcap)"),
        (&[0x0a, 0x0d, 0x0d, 0x0a], "a packet capture (pcapng)"),
        (b"\x89PNG", "a picture"),
        (b"\x7fELF", "a program"),
        (&[0x1f, 0x8b], "compressed by gzip"),
        (&[0x28, 0xb5, 0x2f, 0xfd], "compressed by zstd"),
        (b"BZh", "compressed by bzip2"),
        (b"\xfd7zXZ", "compressed by xz"),
    ];
    let marked = MARKS.iter().find(|(mark, _)| bytes.starts_with(mark)).map(|(_, kind)| *kind);
    marked.or(path.extension().is_some_and(|end| end == "datstp").then_some("host times (read with the log beside it)"))
}

/// Kinds of text. A log is never text: each record starts with the high byte of its length.
fn text_kind(bytes: &[u8]) -> Option<&'static str> {
    let is_text = |byte: &u8| matches!(byte, b'\t' | b'\n' | b'\r' | b' '..=b'~' | 0x80..);
    if bytes.is_empty() || !bytes.iter().all(is_text) {
        return None;
    }
    let text = String::from_utf8(bytes.to_vec()).ok().or_else(|| {
        // A character may be cut at the end.
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
