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
//! Time is the first column, plus the second x 1e-9 s but where there are 8; metres, radians; a trailing comma is usual. Columns are parted by
//! commas or, as the first row is, by semicolons, tabs or spaces; then numbers may have decimal commas. A first line whose first
//! cell is no number names the columns, lines that begin with `#` are comments. Rows that cannot be read are counted with their
//! line and left out.

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
mod tests {
    use super::*;

    #[test]
    fn each_kind_is_told_by_its_columns() {
        let five = b"10.5,0,1,2,3,\n10.6,0,1.1,2,3,\n";
        let six = b"10.5,0,1,2,3,0.5,\n10.6,0,1.1,2,3,0.6,\n";
        let nine = b"10.5,0,1,2,3,0,0,0,1\n10.6,0,1.1,2,3,0,0,0.38268343236509,0.923879532511287\n";
        let fifteen = b"10,500000000,1,2,3,0,0,0,1,0,0,0,0,0,0,\n10,600000000,1.1,2,3,0,0,0,1,0,0,0,0,0,0,\n";
        for (bytes, heading) in
            [(&five[..], None), (six, Some(0.6)), (nine, Some(std::f64::consts::FRAC_PI_4)), (fifteen, Some(0.0))]
        {
            let (trajectory, counts) = parse(bytes).unwrap();
            let last = trajectory.poses()[1];
            assert_eq!(counts.rows, 2);
            assert!((last.t_s - 10.6).abs() < 1e-9 && (last.position_m.x - 1.1).abs() < 1e-12);
            match (last.heading_rad, heading) {
                (None, None) => {}
                (Some(a), Some(b)) => assert!((a - b).abs() < 1e-8, "{a} {b}"),
                other => panic!("{other:?}"),
            }
        }
    }

    #[test]
    fn columns_may_be_parted_otherwise_and_then_have_decimal_commas() {
        let rows = "10.5,0,1.25,-2e-3,3\n10.75,0,1.5,2,3\n";
        let expected = parse(rows.as_bytes()).unwrap();
        assert_eq!((expected.1.rows, expected.1.headings), (2, false));
        let decimal_commas = |by: &str| rows.replace(',', by).replace('.', ",");
        let spaces = format!("  {}", rows.replace(',', "   ").replace('\n', "  \n "));
        for text in [rows.replace(',', ";"), rows.replace(',', "\t"), spaces, decimal_commas(";"), decimal_commas("\t")]
        {
            assert_eq!(parse(text.as_bytes()).unwrap(), expected, "{text}");
        }
        for headings in ["\u{feff}t;0;x;y;z\n", "# seconds\n\nZeit;ns;x;y;z\n", "\"t\";\"0\";\"x\";\"y\";\"z\"\r\n"] {
            let (trajectory, counts) = parse(format!("{headings}{}", decimal_commas(";")).as_bytes()).unwrap();
            assert_eq!((&trajectory, counts.headings, counts.bad_rows), (&expected.0, true, 0), "{headings}");
        }
        // A first row of what is no number names nothing, and only the first line does.
        for text in [format!("nan,0,1,2,3\n{rows}"), format!("a,0,x,y,z\nb,0,x,y,z\n{rows}")] {
            let (trajectory, counts) = parse(text.as_bytes()).unwrap();
            assert!(counts.bad_rows == 1 && counts.lost_something(&trajectory), "{counts:?}");
        }
    }

    #[test]
    fn the_format_of_tum_is_told_by_its_columns() {
        let text = b"# timestamp tx ty tz qx qy qz qw\n10.5 1 2 3 0 0 0 1\n10.75 1.5 2 3 0 0 0.38268343236509 0.923879532511287\n";
        let (trajectory, counts) = parse(text).unwrap();
        assert_eq!((counts.columns, counts.rows, counts.bad_rows, counts.headings), (8, 2, 0, false));
        let last = trajectory.poses()[1];
        assert_eq!((last.t_s, last.position_m), (10.75, Vector3::new(1.5, 2.0, 3.0)));
        assert!((last.heading_rad.unwrap() - std::f64::consts::FRAC_PI_4).abs() < 1e-8);
        // Numbers with decimal commas, parted by commas, are as many as those of another kind.
        assert_eq!(parse_line(b"10,5,0,1,25,0,002,3,5"), Err(RowError::Quaternion));
    }

    #[test]
    fn what_of_a_file_is_not_used_is_said() {
        let said = |text: &str| {
            let (trajectory, counts) = parse(text.as_bytes()).unwrap();
            (counts.notes(&trajectory).join("; "), counts.lost_something(&trajectory))
        };
        assert_eq!(said("1,0,0,0,0\n2,0,1,0,0\n"), (String::new(), false));
        assert_eq!(
            said("t,0,x,y,z\n2,0,1,0,0\n1,0,0,0,0\n3,0,2,0,0\n"),
            ("1 rows out of order in time, sorted".into(), false)
        );
        let (words, lost) = said("1,0,0,0,0\n1,0,1,0,0\n2,0,1,0,0\n2,0,1,0,0\n3,0,?,0,0\n");
        assert!(
            lost && words.starts_with("1 rows left out, the first in line 5: column 3 is not")
                && words.contains("; 1 rows left out at whose time"),
            "{words}"
        );
        let row = |k: u32| format!("{},0,{},0,0\n", if k < 60 { k } else { k - 30 }, f64::from(k) * 0.1);
        let (words, lost) = said(&(0..100).map(row).collect::<String>());
        assert!(
            lost && words.starts_with("time goes back by 29.000 s") && words.contains(" 40 rows left out"),
            "{words}"
        );
    }

    #[test]
    fn bad_rows_are_counted_and_the_rest_is_used() {
        let text = b"1,0,0,0,0,\nnonsense\n2,0,1,0,0,\n3,0,nan,0,0,\n2.5,0,1,0,0,\n";
        let (trajectory, counts) = parse(text).unwrap();
        assert_eq!((trajectory.poses().len(), counts.bad_rows, counts.out_of_order), (3, 2, 0));
        assert_eq!(counts.first_bad.unwrap().0, 2);
    }

    #[test]
    fn a_stray_quote_costs_its_row_and_quoted_numbers_are_numbers() {
        let mut text = String::new();
        (0..100).for_each(|k| text += &format!("{k},0,\"{k}\",0,{}0,\n", if k == 10 { "\"1" } else { "" }));
        let (trajectory, counts) = parse(text.as_bytes()).unwrap();
        assert_eq!(
            (trajectory.poses().len(), counts.rows, counts.bad_rows),
            (100, 100, 0),
            "a quote at an end is none"
        );
        let text = text.replace("\"10\"", "1\"0");
        let (trajectory, counts) = parse(text.as_bytes()).unwrap();
        assert_eq!((trajectory.poses().len(), counts.bad_rows), (99, 1));
        assert_eq!(counts.first_bad, Some((11, RowError::Number(3))));
    }

    #[test]
    fn coordinates_of_which_no_metre_is_left_are_none() {
        for (far, expected) in [(1e9, Ok(())), (-1.000_001e9, Err(())), (1e308, Err(()))] {
            for column in 2..5 {
                let mut cells = ["1", "0", "0", "0", "0"].map(str::to_owned);
                cells[column] = far.to_string();
                let parsed = parse_line(cells.join(",").as_bytes());
                let expected = expected.map_err(|()| RowError::TooFar(column + 1));
                assert_eq!(parsed.map(|_| ()), expected, "{far} in {column}");
            }
        }
    }

    #[test]
    fn rows_that_are_written_are_read_again() {
        for heading_rad in [None, Some(-0.5)] {
            let pose = Pose { t_s: 1_700_000_000.25, position_m: Vector3::new(1.0, -2.5, 0.125), heading_rad };
            assert_eq!(parse_line(line(&pose).as_bytes()), Ok(pose));
        }
        assert!(parse_line(b"").is_err() && parse_line(b"1,2,3").is_err() && parse_line(b"1,0,a,0,0").is_err());
    }

    #[test]
    fn what_reading_holds_is_the_poses_and_not_the_file() {
        const ROWS: usize = 20_000;
        let path = std::env::temp_dir().join(format!("csi5300-rows-{}.csv", std::process::id()));
        let row = |k: usize| format!("{k},0,{k}.125,2.25,3.5,0,0,0,1,{}0\n", "0.000000000000000000000,".repeat(5));
        std::fs::write(&path, (0..ROWS).map(row).collect::<String>()).unwrap();
        let length = std::fs::metadata(&path).unwrap().len();
        let mut read = None;
        let held = allocation_counter::measure(|| read = Some(super::read(&path))).bytes_max;
        std::fs::remove_file(&path).unwrap();
        let poses = (ROWS * size_of::<Pose>()) as u64;
        assert_eq!(read.unwrap().unwrap().1.rows, ROWS as u64);
        // Poses that move into a place a quarter larger are there twice for that moment.
        assert!(held < 9 * poses / 4 && held < length, "{held} bytes for {poses} of poses, {length} of the file");
    }

    #[test]
    fn there_is_a_most_of_poses() {
        let rows = |most| {
            let mut rows = Rows::default();
            let end = rows.read(&b"1,0,0,0,0\n2,0,0,0,0\n3,0,0,0,0\n"[..], most).unwrap();
            (matches!(end, End::TooMany), rows.poses.len())
        };
        assert_eq!([rows(2), rows(3)], [(true, 2), (false, 3)]);
    }

    #[test]
    fn a_row_without_an_end_takes_no_memory_and_costs_itself() {
        let (before, after) = (&b"1,0,0,0,0\n"[..], &b"\n2,0,0,0,0\n"[..]);
        let zeros = std::io::repeat(0).take(64 << 20);
        let mut rows = Rows::default();
        let held = allocation_counter::measure(|| {
            assert!(matches!(rows.read(before.chain(zeros).chain(after), 9), Ok(End::Whole)));
        });
        assert!(held.bytes_max < 1 << 20, "{} bytes", held.bytes_max);
        assert_eq!((rows.poses.len(), rows.counts.bad_rows, rows.counts.first_bad.unwrap().0), (2, 1, 2));
    }

    #[test]
    fn wrong_files_say_what_is_wrong() {
        assert!(matches!(parse(b""), Err(CsvError::Empty { first: None })));
        assert!(matches!(parse(b"a,b,c\n"), Err(CsvError::Columns { line: 1, found: 3 })));
        assert!(matches!(parse(&[0xBB, 0, 0xFF, b'\n', 7]), Err(CsvError::Empty { first: Some(_) })));
        assert!(matches!(parse(b"1,0,0,0,0\n"), Err(CsvError::Trajectory(TrajectoryError::TooFew { poses: 1 }))));
    }
}
