//! Trajectory CSV files; the number of columns is the kind. Keys in brackets: docs/references.md.
//!
//! | columns | what | from |
//! |---|---|---|
//! | 5 | sec.frac, 0, x, y, z | motion capture, WSR data set (`rx_trajectory_*`) |
//! | 6 | sec.frac, 0, x, y, z, yaw | motion capture, real captures of \[paper\] |
//! | 8 | sec.frac, x, y, z, qx, qy, qz, qw | the TUM RGB-D benchmark's format, as `evo` writes it |
//! | 9 | sec.frac, 0, x, y, z, qx, qy, qz, qw | simulated captures of \[paper\] |
//! | 15 | sec, nsec, x, y, z, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz | T265 and wheel odometry (`t265_rx_*`, `odom_rx_*`) |
//!
//! Time is the first column, plus the second x 1e-9 s but where there are 8; metres, radians; a trailing comma is usual.
//! Columns are parted by commas or, as the first row is, by semicolons, tabs or spaces; then numbers may have decimal commas. A
//! first line whose first cell is no number names the columns, lines that begin with `#` are comments. Rows that cannot be read
//! are counted with their line and left out.

use crate::motion::heading::heading_of;
use crate::motion::pose::{Pose, Trajectory, TrajectoryError};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::io::Read;
use std::path::Path;

/// What was read beside the poses.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct CsvCounts {
    /// Rows read into poses.
    pub rows: u64,
    /// Whether a first line names the columns.
    pub headings: bool,
    /// Rows that could not be read.
    pub bad_rows: u64,
    /// Line, from 1, and reason of the first of them.
    pub first_bad: Option<(u64, RowError)>,
    /// Rows whose time is before that of the row before.
    pub out_of_order: u64,
    /// Number of columns (a trailing comma not counted).
    pub columns: usize,
}

impl CsvCounts {
    /// What of a file is not used, or was put in order, in words: a sentence without its end each.
    #[must_use]
    pub fn notes(&self, trajectory: &Trajectory) -> Vec<String> {
        let mut notes = Vec::new();
        if let Some((line, why)) = &self.first_bad {
            notes.push(format!("{} rows left out, the first in line {line}: {why}", self.bad_rows));
        }
        let left_out = trajectory.left_out();
        match left_out.set_back {
            Some((rows, back_s)) => notes.push(format!(
                "time goes back by {back_s:.3} s while the robot goes on (a clock that was set?): {rows} rows left out, the longest \
                 part, {:.3} s to {:.3} s, is used",
                trajectory.span_s().0,
                trajectory.span_s().1
            )),
            None if self.out_of_order > 0 => {
                notes.push(format!("{} rows out of order in time, sorted", self.out_of_order));
            }
            None => {}
        }
        if left_out.same_time > 0 {
            notes.push(format!(
                "{} rows left out at whose time another one is elsewhere (times that were rounded?): the last of each time is used",
                left_out.same_time
            ));
        }
        if left_out.stale > 0 {
            notes.push(format!("the first {} poses are from before the run and left out", left_out.stale));
        }
        notes
    }

    /// True if rows were left out that say where the robot was: what is made of the rest is made of less than was given.
    #[must_use]
    pub fn lost_something(&self, trajectory: &Trajectory) -> bool {
        let left_out = trajectory.left_out();
        self.bad_rows > 0 || left_out.same_time > 0 || left_out.set_back.is_some()
    }
}

/// Why a file gave no trajectory.
#[derive(Debug, thiserror::Error)]
pub enum CsvError {
    /// The file could not be opened or read.
    #[error("cannot read the trajectory {path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// The first row is of no known kind.
    #[error(
        "line {line}: {found} columns; a trajectory has 5 (time, 0, x, y, z), 6 (.., yaw), 8 (TUM: time, x, y, z, quaternion), 9 (time, 0, x, y, z, quaternion) or 15 (T265, wheel odometry)"
    )]
    Columns {
        /// Line of the row.
        line: u64,
        /// Columns found.
        found: usize,
    },
    /// No row could be read.
    #[error("no row of numbers{}", first.as_ref().map(|(line, why)| format!("; line {line}: {why}")).unwrap_or_default())]
    Empty {
        /// Line, from 1, and reason of the first bad row, if any.
        first: Option<(u64, RowError)>,
    },
    /// The rows make no trajectory.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
}

/// Coordinates at most, metres: beyond, their last bit is more than 0.1 micrometres, and motions are differences of them.
const FURTHEST_M: f64 = 1e9;
/// Bytes of a trajectory file at most: an hour of a thousand poses a second, twice over.
const LONGEST: u64 = 512 << 20;
/// Poses of a trajectory at most, by the same measure: short rows are a fifth of the poses they become.
const MOST_POSES: usize = 10_000_000;
/// Bytes of a row at most; what is beyond is left out, so that a file without lines takes no memory.
const LONGEST_ROW: usize = 64 << 10;

/// Bytes in which the first row is looked for, to see what parts its columns.
const BEGINNING: u64 = 16 << 10;

/// Reads a trajectory file, row by row: what is held is the poses.
///
/// # Errors
/// If it cannot be read, is of no known kind, longer than any trajectory, or holds fewer than two poses.
pub fn read(path: &Path) -> Result<(Trajectory, CsvCounts), CsvError> {
    let io = |source| CsvError::Io { path: path.display().to_string(), source };
    if path.is_dir() {
        return Err(io(std::io::Error::other("it is a directory; name the CSV file inside it")));
    }
    let file = std::fs::File::open(path).map_err(io)?;
    let mut rows = Rows::default();
    let mut bytes = file.take(LONGEST + 1);
    let longer = match rows.read(&mut bytes, MOST_POSES)? {
        End::Whole => bytes.limit() == 0,
        End::Failed(source) => return Err(io(source)),
        End::TooMany => true,
    };
    if longer {
        let most = format!("it is longer than {} MiB or {MOST_POSES} poses, which no trajectory is", LONGEST >> 20);
        return Err(io(std::io::Error::other(most)));
    }
    rows.trajectory()
}

/// Parses a trajectory from bytes.
///
/// # Errors
/// If it is of no known kind or holds fewer than two poses.
pub fn parse(bytes: &[u8]) -> Result<(Trajectory, CsvCounts), CsvError> {
    let mut rows = Rows::default();
    rows.read(bytes, usize::MAX)?;
    rows.trajectory()
}

/// A reader of rows. A row ends with its line whatever is in it: quotes have no meaning between numbers, and a stray one would
/// take the lines behind it into its cell.
fn reader(delimiter: u8) -> ::csv::ReaderBuilder {
    let mut reader = ::csv::ReaderBuilder::new();
    let trim = if delimiter == b' ' { ::csv::Trim::None } else { ::csv::Trim::All };
    reader.has_headers(false).flexible(true).quoting(false).trim(trim).delimiter(delimiter).comment(Some(b'#'));
    reader
}

/// What parts the columns of a row: commas may be in its numbers, where something else does.
fn delimiter(row: &[u8]) -> u8 {
    let row = row.trim_ascii();
    b";\t,".iter().copied().find(|byte| row.contains(byte)).unwrap_or(if row.contains(&b' ') { b' ' } else { b',' })
}

/// The first row that is no comment, of what a file begins with.
fn first_row(beginning: &[u8]) -> &[u8] {
    let lines = beginning.split(|byte| matches!(byte, b'\n' | b'\r'));
    lines.map(<[u8]>::trim_ascii).find(|line| !line.is_empty() && !line.starts_with(b"#")).unwrap_or_default()
}

/// Bytes, of each row no more than [`LONGEST_ROW`].
struct ShortRows<R> {
    inner: R,
    /// Bytes of the row so far.
    row: usize,
}

impl<R: Read> Read for ShortRows<R> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        loop {
            let n = self.inner.read(out)?;
            let mut kept = 0;
            for i in 0..n {
                let byte = out[i];
                self.row = if matches!(byte, b'\n' | b'\r') { 0 } else { self.row + 1 };
                if self.row <= LONGEST_ROW {
                    out[kept] = byte;
                    kept += 1;
                }
            }
            if n == 0 || kept > 0 {
                return Ok(kept);
            }
        }
    }
}

/// How reading ended.
enum End {
    /// With the input.
    Whole,
    /// By an answer of the operating system.
    Failed(std::io::Error),
    /// With more poses than a trajectory has.
    TooMany,
}

/// The poses of the rows read so far.
#[derive(Default)]
struct Rows {
    poses: Vec<Pose>,
    counts: CsvCounts,
    /// What parts its columns.
    delimiter: u8,
}

impl Rows {
    /// Reads to the end, or to `most` poses.
    fn read(&mut self, bytes: impl Read, most: usize) -> Result<End, CsvError> {
        let mut bytes = ShortRows { inner: bytes, row: 0 };
        let mut beginning = Vec::new();
        if let Err(source) = (&mut bytes).take(BEGINNING).read_to_end(&mut beginning) {
            return Ok(End::Failed(source));
        }
        self.delimiter = delimiter(first_row(&beginning));
        let mut reader = reader(self.delimiter).from_reader(beginning.chain(bytes));
        let mut record = ::csv::ByteRecord::new();
        let mut fallback_line = 0;
        loop {
            fallback_line += 1;
            match reader.read_byte_record(&mut record) {
                Ok(true) => {}
                Ok(false) => return Ok(End::Whole),
                Err(error) => match error.into_kind() {
                    ::csv::ErrorKind::Io(source) => return Ok(End::Failed(source)),
                    _ => {
                        self.bad(fallback_line, RowError::Unreadable);
                        continue;
                    }
                },
            }
            if self.poses.len() == most {
                return Ok(End::TooMany);
            }
            self.row(&record, record.position().map_or(fallback_line, ::csv::Position::line))?;
        }
    }

    /// Takes a row, or counts it as bad. Fails at a first one of no known kind.
    fn row(&mut self, record: &::csv::ByteRecord, line: u64) -> Result<(), CsvError> {
        let cells = Cells { record, delimiter: self.delimiter };
        let columns = cells.count();
        if columns == 0 {
            return Ok(());
        }
        match cells.pose() {
            Ok(_) if self.counts.rows > 0 && columns != self.counts.columns => {
                self.bad(line, RowError::OtherColumns { found: columns, others: self.counts.columns });
            }
            Ok(pose) => {
                self.counts.columns = columns;
                self.counts.rows += 1;
                self.counts.out_of_order += u64::from(self.poses.last().is_some_and(|last| last.t_s > pose.t_s));
                if self.poses.len() == self.poses.capacity() {
                    self.poses.reserve_exact(1024.max(self.poses.len() / 4));
                }
                self.poses.push(pose);
            }
            Err(RowError::Columns) if self.counts.rows == 0 && columns > 1 => {
                return Err(CsvError::Columns { line, found: columns });
            }
            Err(_) if self.counts == CsvCounts::default() && cells.are_headings() => self.counts.headings = true,
            Err(error) => self.bad(line, error),
        }
        Ok(())
    }

    fn bad(&mut self, line: u64, why: RowError) {
        self.counts.bad_rows += 1;
        self.counts.first_bad.get_or_insert((line, why));
    }

    /// The poses in the order of time.
    fn trajectory(self) -> Result<(Trajectory, CsvCounts), CsvError> {
        if self.poses.is_empty() {
            return Err(CsvError::Empty { first: self.counts.first_bad });
        }
        Ok((Trajectory::new(self.poses)?, self.counts))
    }
}

/// Parses a single row.
///
/// # Errors
/// What is wrong with it.
#[doc(hidden)]
pub fn parse_line(line: &[u8]) -> Result<Pose, RowError> {
    let (mut record, delimiter) = (::csv::ByteRecord::new(), delimiter(line));
    reader(delimiter).from_reader(line).read_byte_record(&mut record).map_err(|_| RowError::Unreadable)?;
    Cells { record: &record, delimiter }.pose()
}

/// A pose as a row: 6 columns, 5 where it has no heading, and the trailing comma.
#[must_use]
#[doc(hidden)]
pub fn line(pose: &Pose) -> String {
    let p = pose.position_m;
    let heading = pose.heading_rad.map_or(String::new(), |heading| format!("{heading:.6},"));
    format!("{:.6},0,{:.6},{:.6},{:.6},{heading}\n", pose.t_s, p.x, p.y, p.z)
}

/// What is wrong with one row.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RowError {
    /// Its number of columns is of no known kind.
    #[error("not 5, 6, 8, 9 or 15 columns")]
    Columns,
    /// Its number of columns is not that of the rows before.
    #[error("{found} columns where the others have {others}")]
    OtherColumns {
        /// Columns found.
        found: usize,
        /// Columns of the rows before.
        others: usize,
    },
    /// A column, from 1, is not a finite number.
    #[error("column {0} is not a finite number")]
    Number(usize),
    /// A coordinate, in this column from 1, is so far from the origin that nothing is left of a robot's motion.
    #[error("column {0} is further than 1e9 m from the origin")]
    TooFar(usize),
    /// The quaternion is no turn: its length is not 1.
    #[error("the length of the quaternion is not 1")]
    Quaternion,
    /// It is no row of a CSV file.
    #[error("no row of a CSV file")]
    Unreadable,
}

/// In its words.
impl serde::Serialize for RowError {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// The cells of a row.
struct Cells<'a> {
    record: &'a ::csv::ByteRecord,
    delimiter: u8,
}

impl<'a> Cells<'a> {
    /// Its cells; between spaces, and behind a trailing delimiter, there are none.
    fn all(&self) -> impl Iterator<Item = &'a [u8]> {
        let by_spaces = self.delimiter == b' ';
        let ends = self.record.iter().next_back().is_some_and(<[u8]>::is_empty);
        let last = self.record.len() - usize::from(ends && !by_spaces);
        self.record.iter().take(last).filter(move |cell| !by_spaces || !cell.is_empty())
    }

    fn count(&self) -> usize {
        self.all().count()
    }

    fn number(&self, cell: &[u8]) -> Option<f64> {
        let text = std::str::from_utf8(cell).ok()?.trim_matches('"');
        if self.delimiter != b',' && text.contains(',') {
            return text.replacen(',', ".", 1).parse().ok();
        }
        text.parse().ok()
    }

    /// True if the first of them is something, and no number.
    fn are_headings(&self) -> bool {
        self.all().next().is_some_and(|cell| !cell.is_empty() && self.number(cell).is_none())
    }

    fn pose(&self) -> Result<Pose, RowError> {
        // Where in a row are the position and the quaternion, and whether the second column has nanoseconds.
        let (at, quaternion, nanoseconds) = match self.count() {
            5 | 6 => (2, None, true),
            8 => (1, Some(4), false),
            9 | 15 => (2, Some(5), true),
            _ => return Err(RowError::Columns),
        };
        // What is behind the quaternion (speeds) is not used.
        let mut values = [0.0; 9];
        let count = self.count();
        for (column, (cell, value)) in self.all().zip(&mut values).enumerate() {
            *value = self.number(cell).filter(|value| value.is_finite()).ok_or(RowError::Number(column + 1))?;
        }
        let heading_rad = match quaternion {
            None => (count == 6).then_some(values[5]),
            Some(q) => {
                let q = Quaternion::new(values[q + 3], values[q], values[q + 1], values[q + 2]);
                if !(0.9..1.1).contains(&q.norm()) {
                    return Err(RowError::Quaternion);
                }
                Some(heading_of(&UnitQuaternion::from_quaternion(q)))
            }
        };
        let position_m = Vector3::new(values[at], values[at + 1], values[at + 2]);
        if let Some(far) = position_m.iter().position(|value| value.abs() > FURTHEST_M) {
            return Err(RowError::TooFar(at + far + 1));
        }
        let t_s = values[0] + if nanoseconds { values[1] * 1e-9 } else { 0.0 };
        Ok(Pose { t_s, position_m, heading_rad })
    }
}

#[cfg(test)]
mod tests;
