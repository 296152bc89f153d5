//! Trajectory files: rows of numbers, identified by their headings or, without any, by the contents of the columns.
//!
//! A line of headings decides: order, units and the order of quaternions. It may be a comment, and may have titles above it and a
//! line of units below. Without headings these are read; keys in brackets: docs/reference/references.md.
//!
//! | columns | what | from |
//! |---|---|---|
//! | 5 | sec.frac, 0, x, y, z | motion capture, WSR data set (`rx_trajectory_*`) |
//! | 6 | sec.frac, 0, x, y, z, yaw | motion capture, real captures of \[paper\] |
//! | 8 | sec.frac, x, y, z, qx, qy, qz, qw | the TUM RGB-D benchmark's format, as `evo` writes it |
//! | 9 | sec.frac, 0, x, y, z, qx, qy, qz, qw | simulated captures of \[paper\] |
//! | 12 | a 3 x 4 matrix, with a file of times beside it | KITTI: x right, y down, z forward |
//! | 15 | sec, nsec, x, y, z, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz | T265 and wheel odometry (`t265_rx_*`, `odom_rx_*`) |
//! | any | sec, nsec, frame, \[child frame,\] x, y, z, qx, qy, qz, qw, .. | `ros2 topic echo --csv` |
//!
//! Metres, seconds and radians unless a heading says otherwise. What may mean two things is refused, with both readings and the
//! [`Columns`] that choose one. Columns are parted by semicolons, tabs, commas or spaces; all but commas leave decimal commas to
//! the numbers. Rows that cannot be read are counted with their line and skipped.

use crate::motion::pose::{Pose, Trajectory, TrajectoryError, TrajectoryKind, heading_of};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::io::{BufReader, Cursor, Read};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Notes about a file that was read.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct CsvCounts {
    /// Rows read into poses.
    pub rows: u64,
    /// Whether a line names the columns.
    pub headings: bool,
    /// Rows that could not be read.
    pub bad_rows: u64,
    /// Line, from 1, and reason of the first of them.
    pub first_bad: Option<(u64, String)>,
    /// Rows whose time is before that of the row before.
    pub out_of_order: u64,
    /// Number of columns (empty ones at the end not counted).
    pub columns: usize,
    /// The meaning of the columns, as [`Columns`] name them.
    pub taken_for: String,
}

impl CsvCounts {
    /// Skipped or reordered parts of a file, in words, a clause each.
    #[must_use]
    pub fn notes(&self, trajectory: &Trajectory) -> Vec<String> {
        let mut notes = Vec::new();
        if let Some((line, why)) = &self.first_bad {
            notes.push(format!("{} rows skipped, the first in line {line}: {why}", self.bad_rows));
        }
        let left_out = trajectory.left_out();
        match left_out.set_back {
            Some((rows, back_s)) => notes.push(format!(
                "time goes back by {back_s:.3} s while the robot goes on (a clock that was set?): {rows} rows skipped, the longest \
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
                "{} rows skipped at whose time another one is elsewhere: the last of each time is used",
                left_out.same_time
            ));
        }
        if let Some(step_s) = trajectory.time_step_s() {
            notes.push(format!(
                "times are rounded to {step_s} s: the poses of one time are spread over it; the path turns by {:.1} deg within a step",
                trajectory.turn_in_step_rad().to_degrees()
            ));
        }
        if let (count @ 1.., furthest_m) = trajectory.jumps() {
            notes.push(format!(
                "jumps from one pose to the next: {count}, by up to {furthest_m:.2} m (another robot's poses, or a sensor \
                 that began anew?)"
            ));
        }
        if left_out.stale > 0 {
            notes.push(format!("the first {} poses are from before the run and skipped", left_out.stale));
        }
        notes
    }

    /// True if rows with poses were skipped, or are no path of one robot.
    #[must_use]
    pub fn lost_something(&self, trajectory: &Trajectory) -> bool {
        let left_out = trajectory.left_out();
        self.bad_rows > 0 || left_out.same_time > 0 || left_out.set_back.is_some() || trajectory.jumps().0 > 0
    }
}

/// How a reading is chosen, in words.
const CHOOSE: &str = "name them in a line of headings, or by `--columns` (`columns=` in Python)";

/// The names of columns, in words.
const NAMED_AS: &str = "columns are named as t,x,y,yaw (t, ns, x, y, z, qx, qy, qz, qw, yaw, with _ms, _us, _ns, _mm, _cm or _deg; \
                        _ passes one over)";

/// Why a file gave no trajectory, or text names no columns.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CsvError {
    /// The file could not be opened or read.
    #[error("cannot read the trajectory {path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// The columns can be read in two ways.
    #[error("{why}: the columns may be {} or {}; {CHOOSE}", readings[0], readings[1])]
    Ambiguous {
        /// What speaks against the usual reading.
        why: String,
        /// The two readings, as [`Columns`] name them.
        readings: [String; 2],
    },
    /// There is no row, or none that can be read: of no known kind, under headings that name no time or place, of several
    /// frames, or without times.
    #[error("{0}")]
    Refused(String),
    /// The rows make no trajectory.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
}

impl CsvError {
    fn columns(line: u64, found: usize) -> Self {
        Self::Refused(format!(
            "line {line}: {found} columns without headings; a trajectory has 5 (time, 0, x, y, z), 6 (.., yaw), 8 (TUM: time, x, y, z, \
             quaternion), 9 (time, 0, x, y, z, quaternion) or 15 (T265, wheel odometry). For others, {CHOOSE}: t,x,y,yaw"
        ))
    }

    fn headings(line: u64, why: &str) -> Self {
        let choose = "`--columns` (`columns=` in Python) names the columns, as t,x,y,yaw";
        Self::Refused(format!("line {line}: the headings {why}; {choose}"))
    }

    fn no_times(why: &str) -> Self {
        Self::Refused(format!("12 columns are a KITTI pose, which has no time: {why}"))
    }
}

/// What is wrong with one row.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
enum RowError {
    /// Its number of columns is of no known kind.
    #[error("not 5, 6, 8, 9 or 15 columns")]
    Columns,
    /// Its number of columns is not that of the rows before.
    #[error("{found} columns where the others have {others}")]
    OtherColumns {
        /// Columns found.
        found: usize,
        /// Columns of the rows before, or as many as are named.
        others: usize,
    },
    /// A column, from 1, is not a finite number.
    #[error("column {0} is not a finite number")]
    Number(usize),
    /// A column, from 1, that has the nanoseconds of a second has none.
    #[error("column {0} has no nanoseconds, which are whole and 0 to 999999999")]
    Nanoseconds(usize),
    /// A coordinate, in this column from 1, is so far from the origin that nothing is left of a robot's motion.
    #[error("column {0} is further than 1e9 m from the origin")]
    TooFar(usize),
    /// The quaternion is no turn: its length is not 1.
    #[error("the length of the quaternion is not 1")]
    Quaternion,
    /// It is not a row of a CSV file.
    #[error("not a row of a CSV file")]
    Unreadable,
}

/// Coordinates at most, metres: beyond, their last bit is more than 0.1 micrometres, and motions are differences of them.
const FURTHEST_M: f64 = 1e9;
/// Bytes of a trajectory file at most: an hour of a thousand poses a second, twice over.
const LONGEST: u64 = 512 << 20;
/// Poses of a trajectory at most, by the same measure: short rows are a fifth of the poses they become.
const MOST_POSES: usize = 10_000_000;
/// Limit of a row, bytes; the rest is skipped, so that a file without lines takes no memory.
const LONGEST_ROW: usize = 64 << 10;
/// More jumps than this, and than a tenth of the poses, are to and fro between two robots.
const FEW_JUMPS: usize = 10;
/// Lines above the first row that are kept to find headings in.
const HEAD: usize = 32;

// ---------------------------------------------------------------------------------------------------------------------------
// What columns mean.

/// What a column has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum What {
    Time,
    Nanoseconds,
    X,
    Y,
    Z,
    Qx,
    Qy,
    Qz,
    Qw,
    Yaw,
}

/// Each, in the order of its number, as [`Columns`] name it.
const NAMES: [&str; 10] = ["t", "ns", "x", "y", "z", "qx", "qy", "qz", "qw", "yaw"];

impl What {
    fn name(self) -> &'static str {
        NAMES[self as usize]
    }

    fn is_of_quaternion(self) -> bool {
        matches!(self, Self::Qx | Self::Qy | Self::Qz | Self::Qw)
    }
}

/// A column that is used.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Column {
    /// Its place in a row, from 0.
    at: usize,
    what: What,
    /// What its numbers are multiplied by for seconds, metres or radians. `None`: no unit is named. Then metres, radians, and
    /// of times what their size says.
    scale: Option<f64>,
    /// Of two columns that have the same, the one of the higher rank is used.
    rank: u8,
}

/// A unit by its name, in seconds, metres or radians.
fn unit(name: &str) -> Option<f64> {
    Some(match name {
        "s" | "sec" | "secs" | "second" | "seconds" | "m" | "meter" | "meters" | "metre" | "metres" | "rad"
        | "rads" | "radian" | "radians" => 1.0,
        "ms" | "msec" | "millisecond" | "milliseconds" | "mm" | "millimeter" | "millimeters" | "millimetres" => 1e-3,
        "us" | "usec" | "\u{b5}s" | "\u{3bc}s" | "microsecond" | "microseconds" => 1e-6,
        "ns" | "nsec" | "nanosec" | "nanosecond" | "nanoseconds" => 1e-9,
        "cm" | "centimeter" | "centimeters" | "centimetres" => 1e-2,
        "km" => 1e3,
        "deg" | "degs" | "degree" | "degrees" | "\u{b0}" => std::f64::consts::PI / 180.0,
        _ => return None,
    })
}

/// Words of a heading: `Pos.X [m]` is `pos`, `x` and the unit `m`.
fn words_of(heading: &str) -> (Vec<String>, Option<String>) {
    let heading = heading.trim().trim_matches('"').trim();
    let (name, in_brackets) = match heading.find(['[', '(']) {
        Some(at) => heading.split_at(at),
        None => (heading, ""),
    };
    let mut spaced = String::new();
    let mut small = false;
    for letter in name.chars() {
        // posX is pos_x
        if small && letter.is_uppercase() {
            spaced.push('_');
        }
        small = letter.is_lowercase();
        spaced.extend(letter.to_lowercase());
    }
    let words = spaced.split(|letter: char| !letter.is_alphanumeric() && letter != '\u{b0}');
    let words = words.filter(|word| !word.is_empty()).map(str::to_owned).collect();
    let in_brackets = in_brackets.trim_matches(|letter: char| !letter.is_alphanumeric() && letter != '\u{b0}');
    (words, (!in_brackets.is_empty()).then(|| in_brackets.to_lowercase()))
}

/// Words beside which x, y, z and yaw are not a pose: speeds, deviations, wishes.
const NO_POSE: &str = "v vel velocity speed twist linear angular w omega a acc accel acceleration gyro \
                       cov covariance b bias std sd sigma var variance err error cmd goal target des desired ref \
                       mag force torque euler marker rate imu wheel";
/// Words for a time.
const TIMES: &str =
    "t time times timestamp stamp datetime date seconds second sec secs unix unixtime epoch zeit sekunden temps tiempo";
/// Words for whose pose a row is: it must be the same in all rows.
const WHOSE: &str = "frame robot vehicle agent name body";
/// Words for a quaternion.
const TURNS: &str = "q quat quaternion orientation rotation rot ori";

fn is_one_of(names: &str, word: &str) -> bool {
    names.split(' ').any(|name| name == word)
}

/// What the column `at` has, by its heading, if it is used.
fn column(at: usize, heading: &str) -> Option<Column> {
    let (mut words, in_brackets) = words_of(heading);
    let is_part = |word: &str| is_one_of("nsec nsecs nanosec nanosecs nanosecond nanoseconds", word);
    let is = |words: &[String], names: &str| words.iter().any(|word| is_one_of(names, word));
    // Beside `stamp.sec` there is `stamp.nanosec`; `stamp_ns` is the whole time.
    let alone = words.len() == 1 || is(&words, "stamp");
    if words.last().is_some_and(|last| (is_part(last) && alone) || words == ["ns"]) {
        return Some(Column { at, what: What::Nanoseconds, scale: Some(1e-9), rank: 0 });
    }
    let scale = match in_brackets {
        // An unknown unit makes the column unknown.
        Some(name) => Some(unit(&name)?),
        None if words.len() > 1 => {
            let scale = words.last().and_then(|last| unit(last));
            words.truncate(words.len() - usize::from(scale.is_some()));
            scale
        }
        None => None,
    };
    let is = |names: &str| is(&words, names);
    let last = words.last()?.as_str();
    let rank = u8::from(words.len() == 1);
    if is_one_of(TIMES, last) && !is("capture frame send sent") {
        let rank = if is("stamp timestamp") { 2 } else { rank };
        return Some(Column { at, what: What::Time, scale, rank });
    }
    // The transforms of one message of TF: its first.
    let later = |word: &String| word.strip_prefix("transforms").is_some_and(|number| !matches!(number, "" | "0"));
    if (is(NO_POSE) && !(last == "w" && is(TURNS))) || words.iter().any(later) {
        return None;
    }
    let axis = if matches!(last, "pos" | "position") { words.first()?.as_str() } else { last };
    let what = match (axis, is(TURNS)) {
        ("x" | "px" | "tx", false) | ("easting" | "east", _) => What::X,
        ("y" | "py" | "ty", false) | ("northing" | "north", _) => What::Y,
        ("z" | "pz" | "tz", false) | ("up", _) => What::Z,
        ("x" | "px" | "tx", true) | ("qx", _) => What::Qx,
        ("y" | "py" | "ty", true) | ("qy", _) => What::Qy,
        ("z" | "pz" | "tz", true) | ("qz", _) => What::Qz,
        ("w", true) | ("qw", _) => What::Qw,
        ("yaw" | "theta" | "heading" | "psi", _) => What::Yaw,
        _ => return None,
    };
    // x and y beside a map's directions are the robot's own frame.
    let rank = if is("easting east northing north up") { 0 } else { rank };
    Some(Column { at, what, scale, rank })
}

/// What is in the columns of a trajectory, one after another: `t,x,y,yaw`.
///
/// Names, parted by commas: `t` (seconds since 1970; `t_ms`, `t_us`, `t_ns`), `ns` (nanoseconds that are added), `x`, `y`, `z`
/// (metres; `x_mm`, `x_cm`), `qx`, `qy`, `qz`, `qw`, `yaw` (radians; `yaw_deg`). `_` passes a column over, a minus before a name
/// turns its sign, and what is behind the last name is not read. `t`, `x` and `y` are needed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Columns {
    used: Vec<Column>,
    /// Columns that name frames: they must not change.
    frames: Vec<usize>,
    /// Columns of each row, if only their number identifies the kind.
    exactly: Option<usize>,
    /// A row is a matrix of KITTI; `used` is empty.
    matrix: bool,
    /// The axes were turned by what the format usually has: y is up, or down.
    turned: bool,
    kind: TrajectoryKind,
}

impl FromStr for Columns {
    type Err = CsvError;

    /// # Errors
    /// [`CsvError::Refused`] for text that names no columns.
    fn from_str(text: &str) -> Result<Self, CsvError> {
        let refused = |why| CsvError::Refused(format!("{why}: {NAMED_AS}"));
        let mut columns = Self::default();
        for (at, name) in text.split(',').map(str::trim).enumerate() {
            if matches!(name, "_" | "") {
                continue;
            }
            let bare = name.strip_prefix('-').unwrap_or(name);
            let (base, has_unit) = bare.split_once('_').map_or((bare, true), |(base, own)| (base, unit(own).is_some()));
            let known = (has_unit && NAMES.contains(&base)).then(|| column(at, bare)).flatten();
            let column = known.ok_or_else(|| refused(format!("`{name}` is not known")))?;
            let scale = column.scale.or((column.what != What::Time).then_some(1.0));
            let scale = scale.map(|scale| if bare == name { scale } else { -scale });
            columns.put(Column { scale, rank: 1, ..column }).map_err(refused)?;
        }
        if !columns.has_quaternion() && columns.used.iter().any(|column| column.what.is_of_quaternion()) {
            return Err(refused("a quaternion has qx, qy, qz and qw".into()));
        }
        columns.whole().map_err(refused)
    }
}

impl Columns {
    /// These columns, of so many, without headings; `_` for those that are not read.
    fn of(names: &str, exactly: usize) -> Self {
        let mut columns: Self = names.parse().unwrap_or_default();
        columns.exactly = Some(exactly);
        // Radians, if nothing speaks against it.
        columns.used.iter_mut().filter(|column| column.what == What::Yaw).for_each(|yaw| yaw.scale = None);
        columns
    }

    fn column(&self, what: What) -> Option<&Column> {
        self.used.iter().find(|column| column.what == what)
    }

    /// Uses this column, too.
    fn put(&mut self, column: Column) -> Result<(), String> {
        match self.used.iter_mut().find(|there| there.what == column.what) {
            Some(there) if there.rank == column.rank => {
                let name = column.what.name();
                return Err(format!("name `{name}` twice, columns {} and {}", there.at + 1, column.at + 1));
            }
            Some(there) if there.rank > column.rank => {}
            Some(there) => *there = column,
            None => self.used.push(column),
        }
        Ok(())
    }

    /// Fails where time, x or y are missing. Four parts of a quaternion are one; nanoseconds alone are the time.
    fn whole(mut self) -> Result<Self, String> {
        if self.column(What::Time).is_none()
            && let Some(column) = self.used.iter_mut().find(|column| column.what == What::Nanoseconds)
        {
            column.what = What::Time;
        }
        let needed = [(What::Time, "time"), (What::X, "x"), (What::Y, "y")];
        let missing: Vec<&str> =
            needed.iter().filter(|(what, _)| self.column(*what).is_none()).map(|(_, name)| *name).collect();
        if !missing.is_empty() {
            return Err(format!("name no {}", missing.join(" and no ")));
        }
        if !self.has_quaternion() {
            self.used.retain(|column| !column.what.is_of_quaternion());
        }
        Ok(self)
    }

    fn has_quaternion(&self) -> bool {
        self.used.iter().filter(|column| column.what.is_of_quaternion()).count() == 4
    }

    /// Columns up to the last that is used.
    fn width(&self) -> usize {
        self.used.iter().map(|column| column.at + 1).max().unwrap_or(0)
    }

    /// The other reading of one whose axes were turned.
    fn with_z_up(mut self) -> Self {
        for column in &mut self.used {
            column.scale = column.scale.map(f64::abs);
            column.what = match column.what {
                What::Y => What::Z,
                What::Z => What::Y,
                What::Qy => What::Qz,
                What::Qz => What::Qy,
                what => what,
            };
        }
        self
    }

    /// As they are written.
    fn words(&self) -> String {
        if self.matrix {
            return "a 3 x 4 matrix of a camera".into();
        }
        let mut names = vec!["_".to_owned(); self.width()];
        for column in &self.used {
            let scale = column.scale.unwrap_or(1.0);
            let units: &[(f64, &str)] = match column.what {
                What::Time => &[(1e-3, "_ms"), (1e-6, "_us"), (1e-9, "_ns")],
                What::X | What::Y | What::Z => &[(1e-3, "_mm"), (1e-2, "_cm"), (1e3, "_km")],
                What::Yaw => &[(std::f64::consts::PI / 180.0, "_deg")],
                _ => &[],
            };
            let unit = units.iter().find(|(own, _)| *own == scale.abs()).map_or("", |(_, name)| name);
            let sign = if scale < 0.0 { "-" } else { "" };
            names[column.at] = format!("{sign}{}{unit}", column.what.name());
        }
        names.join(",")
    }
}

// ---------------------------------------------------------------------------------------------------------------------------
// Headings and what tells a kind without them.

/// Parts a row. Quotes hold a cell together where they come in pairs; empty cells at the end are none.
fn cells(row: &str) -> Vec<&str> {
    cells_by(row, delimiter(row))
}

/// What parts a row: commas may be in its numbers, where something else does.
fn delimiter(row: &str) -> char {
    [';', '\t', ','].into_iter().find(|by| row.contains(*by)).unwrap_or(' ')
}

fn cells_by(row: &str, by: char) -> Vec<&str> {
    let mut cells = if row.contains('"') { quoted(row, by) } else { row.split(by).map(str::trim).collect() };
    cells.retain(|cell| by != ' ' || !cell.is_empty());
    cells.truncate(cells.iter().rposition(|cell| !cell.is_empty()).map_or(0, |last| last + 1));
    cells
}

/// The parts of a row with quotes.
fn quoted(row: &str, by: char) -> Vec<&str> {
    let paired = row.bytes().filter(|byte| *byte == b'"').count() % 2 == 0;
    let (mut inside, mut begins) = (false, true);
    let parts = row.split(|letter: char| {
        inside = if paired && letter == '"' { begins && !inside } else { inside };
        let ends = letter == by && !inside;
        begins = ends || (begins && letter == ' ');
        ends
    });
    parts.map(|cell| cell.trim().trim_matches('"').trim()).collect()
}

fn number(cell: &str) -> Option<f64> {
    match cell.parse() {
        Ok(number) => Some(number),
        Err(_) => cell.contains(',').then(|| cell.replacen(',', ".", 1).parse().ok()).flatten(),
    }
}

/// Seconds since 1970 of a date and time of day as ISO 8601 writes them: `2023-11-14T22:13:20.5Z`, `2023-11-14
/// 23:13:20.5+01:00`. Without a zone it is UTC; if it was local time, the logs lie outside of the trajectory, which is
/// reported.
fn date_time(cell: &str) -> Option<f64> {
    let (date, of_day) = cell.split_once(['T', ' '])?;
    let mut parts = date.split('-').map(|part| part.parse::<u16>().ok());
    let (year, month, day) = (parts.next()??, parts.next()??, parts.next()??);
    let zone_at = of_day.find(['Z', '+', '-']).unwrap_or(of_day.len());
    let (clock, zone) = of_day.split_at(zone_at);
    let mut parts = clock.split(':').map(|part| part.parse::<f64>().ok());
    let (hour, minute, second) = (parts.next()??, parts.next()??, parts.next().unwrap_or(Some(0.0))?);
    let in_range = (1970..=9999).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day);
    let in_day = (0.0..24.0).contains(&hour) && (0.0..60.0).contains(&minute) && (0.0..61.0).contains(&second);
    if !(in_range && in_day) {
        return None;
    }
    let zone_s = match zone {
        "" | "Z" => 0.0,
        zone => {
            let digits: String = zone[1..].chars().filter(char::is_ascii_digit).collect();
            let hours: f64 = digits.get(..2)?.parse().ok()?;
            let minutes: f64 = digits.get(2..).filter(|rest| !rest.is_empty()).map_or(Ok(0.0), str::parse).ok()?;
            (60.0 * hours + minutes) * if zone.starts_with('-') { -60.0 } else { 60.0 }
        }
    };
    // Days of the Gregorian calendar, of years that begin in March.
    let (years, months) = if month > 2 { (i64::from(year), month - 3) } else { (i64::from(year) - 1, month + 9) };
    let leap_days = years / 4 - years / 100 + years / 400;
    let days = 365 * years + leap_days + (153 * i64::from(months) + 2) / 5 + i64::from(day) - 719_469;
    Some(days as f64 * 86_400.0 + 3_600.0 * hour + 60.0 * minute + second - zone_s)
}

fn is_comment(row: &str) -> bool {
    row.starts_with(['#', '%'])
}

fn is_value(cell: &&str) -> bool {
    number(cell).is_some() || date_time(cell).is_some()
}

/// True for a row whose first cell with anything in it is neither a number nor a date.
fn is_words(cells: &[&str]) -> bool {
    cells.iter().find(|cell| !cell.is_empty()).is_some_and(|cell| !is_value(cell))
}

/// Units in a line of their own, one for each column that has any.
fn units(cells: &[&str]) -> Option<Vec<Option<f64>>> {
    let bare = |cell: &&str| cell.trim_matches(['[', ']', '(', ')', ' ']).to_lowercase();
    let all = cells.iter().map(bare).map(|cell| match cell.as_str() {
        "" | "-" | "1" => Some(None),
        cell => unit(cell).map(Some),
    });
    all.collect::<Option<Vec<_>>>().filter(|all| all.iter().flatten().count() > 1)
}

/// The columns that the lines above the first row name, if one does. `row` is that row, parted by `by`.
fn headed(head: &[(u64, String)], row: &[&str], by: char) -> Result<Option<Columns>, CsvError> {
    if head.iter().any(|(_, line)| line.starts_with("Format Version")) {
        return motive(head).map(Some);
    }
    let mut below = None;
    for (line, text) in head.iter().rev() {
        let bare = text.trim_start_matches(['#', '%', ' ']);
        let own = cells_by(bare, by);
        if let Some(units) = units(&own) {
            below = Some(units);
            continue;
        }
        // A comment may be parted as no row is.
        let mut ways = [cells(bare), cells_by(bare, ' ')].into_iter();
        let (known, columns) = named_by(&own, row, below.as_deref());
        let mut other = || ways.find_map(|names| named_by(&names, row, below.as_deref()).1.ok());
        match columns.or_else(|why| other().ok_or(why)) {
            Ok(columns) => return Ok(Some(Columns { kind: TrajectoryKind::of_words(bare), ..columns })),
            // A title, or a sentence.
            Err(_) if known < 3 && (is_comment(text) || own.len() < 3 || own.len() != row.len()) => {}
            Err(why) => return Err(CsvError::headings(*line, &why)),
        }
    }
    Ok(None)
}

/// How many headings are known, and the columns that they name, or why they name none.
fn named_by(names: &[&str], row: &[&str], units: Option<&[Option<f64>]>) -> (usize, Result<Columns, String>) {
    let mut columns = Columns::default();
    let mut known = 0;
    let (mut put, mut unknown) = (Ok(()), Vec::new());
    for (at, name) in names.iter().enumerate() {
        let is_text = row.get(at).is_some_and(|cell| number(cell).is_none());
        if let Some(mut column) = column(at, name) {
            known += 1;
            if column.what != What::Nanoseconds {
                column.scale = units.and_then(|units| units.get(at).copied().flatten()).or(column.scale);
            }
            put = put.and(columns.put(column));
        } else if is_text && words_of(name).0.iter().any(|word| is_one_of(WHOSE, word)) {
            columns.frames.push(at);
        } else if let Some(column) = name.split_once(['[', '(']).and_then(|(bare, _)| column(at, bare)) {
            unknown.push((column.what, name.trim()));
        }
    }
    // A column of another name may have the same.
    put = match unknown.iter().find(|(what, _)| columns.column(*what).is_none()) {
        Some((_, name)) => put.and(Err(format!("have `{name}`, whose unit is not known"))),
        None => put,
    };
    let whole = put.and_then(|()| columns.whole()).and_then(|columns| match columns.width() {
        width if width > row.len() => Err(format!("name {width} columns, and the first row has {}", row.len())),
        _ => Ok(columns),
    });
    (known, whole)
}

/// The columns of Motive's export: those of the first rigid body. Its axes are x, y up, z towards the one who looks.
fn motive(head: &[(u64, String)]) -> Result<Columns, CsvError> {
    let line =
        |first: &str| head.iter().map(|(line, text)| (*line, cells(text))).find(|(_, cells)| cells.contains(&first));
    let at = head.first().map_or(1, |(line, _)| *line);
    let lacks = |what: &str| CsvError::headings(at, &format!("of Motive have no {what}"));
    let (_, options) = line("Format Version").ok_or_else(|| lacks("format"))?;
    let option = |name: &str| options.iter().position(|cell| *cell == name).and_then(|at| options.get(at + 1).copied());
    let scale = option("Length Units")
        .map_or(Some(1.0), |name| unit(&name.to_lowercase()))
        .ok_or_else(|| lacks("known unit"))?;
    let (_, types) = line("Type").or_else(|| line("Rigid Body")).ok_or_else(|| lacks("types"))?;
    let (_, bodies) = line("Name").ok_or_else(|| lacks("names"))?;
    let (_, parts) = line("Position").ok_or_else(|| lacks("positions"))?;
    let (line, axes) = line("Frame").ok_or_else(|| lacks("axes"))?;
    let headings = |why: String| CsvError::headings(line, &why);
    let is_body = |at: usize| types.get(at).copied() == Some("Rigid Body");
    let mut names: Vec<&str> =
        bodies.iter().enumerate().filter(|(at, _)| is_body(*at)).map(|(_, name)| *name).collect();
    names.dedup();
    let [body] = names[..] else {
        let why = format!("of Motive have {} rigid bodies ({}): export one", names.len(), names.join(", "));
        return Err(headings(why));
    };
    let mut columns = Columns { turned: true, kind: TrajectoryKind::MotionCapture, ..Columns::default() };
    for (at, axis) in axes.iter().enumerate() {
        let own = is_body(at) && bodies.get(at).copied() == Some(body);
        let (what, scale) = match (parts.get(at).copied().unwrap_or_default(), *axis) {
            _ if axis.starts_with("Time") => (What::Time, 1.0),
            ("Position", "X") if own => (What::X, scale),
            ("Position", "Y") if own => (What::Z, scale),
            ("Position", "Z") if own => (What::Y, -scale),
            ("Rotation", "W") if own => (What::Qw, 1.0),
            ("Rotation", "X") if own => (What::Qx, 1.0),
            ("Rotation", "Y") if own => (What::Qz, 1.0),
            ("Rotation", "Z") if own => (What::Qy, -1.0),
            _ => continue,
        };
        columns.put(Column { at, what, scale: Some(scale), rank: 0 }).map_err(headings)?;
    }
    columns.whole().map_err(headings)
}

/// What kind of sensor a file of this name is of: the names of the WSR data set and of \[paper\], or what names a sensor.
fn kind_of_file(path: &Path) -> TrajectoryKind {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    match () {
        () if name.starts_with("odom_rx_trajectory") => TrajectoryKind::Wheels,
        () if name.starts_with("rx_trajectory") || name.starts_with("rx_movement") => TrajectoryKind::MotionCapture,
        () => TrajectoryKind::of_words(&name),
    }
}

/// The columns of a row without headings, by their number and content.
fn headless(row: &[&str]) -> Option<Columns> {
    let is_number = |at: usize| row.get(at).is_some_and(|cell| number(cell).is_some());
    let quaternion = "x,y,z,qx,qy,qz,qw";
    if row.len() >= 10 && is_number(0) && is_number(1) && !is_number(2) {
        // A header of ROS 2: its stamp, its frame, perhaps another one's.
        let (names, frames) = if is_number(3) { ("t,ns,_", vec![2]) } else { ("t,ns,_,_", vec![2, 3]) };
        let columns = Columns::of(&format!("{names},{quaternion}"), row.len());
        // Messages of TF have as many transforms as there were.
        return Some(Columns { exactly: None, frames, ..columns });
    }
    Some(match row.len() {
        5 => Columns::of("t,ns,x,y,z", 5),
        6 => Columns::of("t,ns,x,y,z,yaw", 6),
        8 => Columns::of(&format!("t,{quaternion}"), 8),
        12 if matrix(row).is_ok() => Columns { matrix: true, turned: true, exactly: Some(12), ..Columns::default() },
        count @ (9 | 15) => Columns::of(&format!("t,ns,{quaternion}"), count),
        _ => return None,
    })
}

// ---------------------------------------------------------------------------------------------------------------------------
// Rows to poses.

impl Column {
    /// Its number in a row, in seconds, metres or radians.
    fn value(&self, row: &[&str]) -> Result<f64, RowError> {
        let number_of_column = self.at + 1;
        let cell = row.get(self.at).copied().unwrap_or_default();
        let dated = || (self.what == What::Time).then(|| date_time(cell)).flatten();
        // NaN is a heading that is not known.
        let is_unknown = |value: &f64| self.what == What::Yaw && value.is_nan();
        let read = number(cell).or_else(dated).filter(|value| value.is_finite() || is_unknown(value));
        let read = read.ok_or(RowError::Number(number_of_column))?;
        let scale = self.scale.unwrap_or_else(|| match read.abs() {
            // Since 1970, of seconds, milliseconds, microseconds and nanoseconds no two are of one size.
            1e17.. if self.what == What::Time => 1e-9,
            1e14.. if self.what == What::Time => 1e-6,
            1e11.. if self.what == What::Time => 1e-3,
            _ => 1.0,
        });
        let value = read * scale;
        match self.what {
            What::Nanoseconds if read.fract() != 0.0 || !(0.0..1e9).contains(&read) => {
                Err(RowError::Nanoseconds(number_of_column))
            }
            What::X | What::Y | What::Z if value.abs() > FURTHEST_M => Err(RowError::TooFar(number_of_column)),
            _ => Ok(value),
        }
    }
}

impl Columns {
    /// The frames that a row names; empty where there are none.
    fn frames_of(&self, row: &[&str]) -> String {
        let names: Vec<&str> = self.frames.iter().map(|at| row.get(*at).copied().unwrap_or_default()).collect();
        names.join(" -> ")
    }

    /// The pose of a row, and its quaternion (x, y, z, w), if it has one.
    fn pose(&self, row: &[&str]) -> Result<(Pose, Option<[f64; 4]>), RowError> {
        let (found, others) = (row.len(), self.exactly.unwrap_or_else(|| self.width()));
        if found < others || (found > others && self.exactly.is_some()) {
            return Err(RowError::OtherColumns { found, others });
        }
        if self.matrix {
            return matrix(row).map(|pose| (pose, None));
        }
        let mut values = [None; NAMES.len()];
        for column in &self.used {
            values[column.what as usize] = Some(column.value(row)?);
        }
        let [time, nanoseconds, x, y, z, qx, qy, qz, qw] = std::array::from_fn(|what| values[what].unwrap_or(0.0));
        // A time with a fraction has its nanoseconds already.
        if let Some(part) = self.column(What::Nanoseconds).filter(|_| nanoseconds != 0.0 && time.fract() != 0.0) {
            return Err(RowError::Nanoseconds(part.at + 1));
        }
        // ROS's null quaternion is an orientation that was not set.
        let quaternion = values[What::Qw as usize].map(|_| [qx, qy, qz, qw]).filter(|parts| *parts != [0.0; 4]);
        let mut heading_rad = values[What::Yaw as usize].filter(|heading| heading.is_finite());
        if quaternion.is_some() {
            let q = Quaternion::new(qw, qx, qy, qz);
            if !(0.9..1.1).contains(&q.norm()) {
                return Err(RowError::Quaternion);
            }
            heading_rad = Some(heading_of(&UnitQuaternion::from_quaternion(q)));
        }
        Ok((Pose { t_s: time + nanoseconds, position_m: Vector3::new(x, y, z), heading_rad }, quaternion))
    }
}

/// A pose of KITTI: a camera's, whose x is right, y down, z forward, in the axes of its first one. Its time is not known.
fn matrix(row: &[&str]) -> Result<Pose, RowError> {
    let mut m = [0.0; 12];
    for (column, (cell, value)) in row.iter().zip(&mut m).enumerate() {
        *value = number(cell).filter(|value| value.is_finite()).ok_or(RowError::Number(column + 1))?;
    }
    for column in [3, 7, 11] {
        if m[column].abs() > FURTHEST_M {
            return Err(RowError::TooFar(column + 1));
        }
    }
    let forward = Vector3::new(m[2], m[6], m[10]);
    if !(0.9..1.1).contains(&forward.norm()) {
        return Err(RowError::Quaternion);
    }
    let position_m = Vector3::new(m[11], -m[3], -m[7]);
    Ok(Pose { t_s: 0.0, position_m, heading_rad: Some((-forward.x).atan2(forward.z)) })
}

/// Square of the sine of half the tilt from which on an attitude is more than a heading: a tenth of a degree.
const TILTED: f64 = 7.6e-7;

/// The poses of the rows read so far.
#[derive(Default)]
struct Rows {
    poses: Vec<Pose>,
    /// The attitude of each pose that is not upright, with its time.
    attitudes: Vec<(f64, UnitQuaternion<f64>)>,
    counts: CsvCounts,
    columns: Option<Columns>,
    /// Lines above the first row.
    head: Vec<(u64, String)>,
    /// The frames of the first row.
    frames: Option<String>,
    /// Rows whose nanoseconds are none, and the line of the first.
    no_nanoseconds: (u64, Option<u64>),
    /// How much of the robot's z axis looks up, summed over all rows: as the quaternions are read, and with w as the first.
    up: [f64; 2],
}

impl Rows {
    fn named(columns: Option<&Columns>) -> Self {
        Self { columns: columns.cloned(), ..Self::default() }
    }

    /// Reads to the end, or to `most` poses. Lines are ended by LF, CR or both; of each no more than [`LONGEST_ROW`] is kept.
    fn read(&mut self, bytes: impl Read, most: usize, path: &Path) -> Result<(), CsvError> {
        let io = |source| CsvError::Io { path: path.display().to_string(), source };
        let (mut row, mut line, mut after_cr) = (Vec::new(), 1, false);
        for byte in BufReader::new(utf8(bytes).map_err(io)?).bytes() {
            let byte = byte.map_err(io)?;
            match byte {
                // The other half of an end of a line.
                b'\n' if after_cr => {}
                b'\n' | b'\r' => {
                    self.row(&row, line)?;
                    row.clear();
                    line += 1;
                    if self.poses.len() > most {
                        return Err(io(too_long()));
                    }
                }
                _ if row.len() < LONGEST_ROW => row.push(byte),
                _ => {}
            }
            after_cr = byte == b'\r';
        }
        self.row(&row, line)
    }

    /// Takes a row, or counts it as bad. Fails where the first one is of no known kind.
    fn row(&mut self, bytes: &[u8], line: u64) -> Result<(), CsvError> {
        let text = String::from_utf8_lossy(bytes);
        let text = text.trim_matches(['\u{feff}', ' ']);
        let cells = cells(text);
        if cells.is_empty() {
            return Ok(());
        }
        let begun = self.counts.rows + self.counts.bad_rows > 0;
        if is_comment(text) || (!begun && is_words(&cells) && !self.has_name_first(&cells, text)) {
            if !begun && self.head.len() < HEAD {
                self.head.push((line, text.to_owned()));
            }
            return Ok(());
        }
        // The headings of another file that was put behind.
        if begun && self.head.iter().any(|(_, head)| head == text) {
            return Ok(());
        }
        if self.columns.is_none() && cells.len() > 1 {
            let headed = headed(&self.head, &cells, delimiter(text))?;
            self.counts.headings = headed.is_some();
            let columns = headed.or_else(|| headless(&cells));
            self.columns = Some(columns.ok_or_else(|| CsvError::columns(line, cells.len()))?);
        }
        let read = match &self.columns {
            Some(columns) => columns.pose(&cells).map(|read| (read, columns.frames_of(&cells))),
            None => Err(RowError::Unreadable),
        };
        match read {
            Ok(((pose, quaternion), frames)) => {
                // Poses of several frames (as of TF) make no path.
                let first = self.frames.get_or_insert_with(|| frames.clone());
                if *first != frames {
                    return Err(CsvError::Refused(format!(
                        "line {line}: poses of `{frames}` among those of `{first}`: write each into a file of its own"
                    )));
                }
                self.take(pose, quaternion, cells.len());
            }
            Err(why) => {
                if matches!(why, RowError::Nanoseconds(_)) {
                    self.no_nanoseconds.0 += 1;
                    self.no_nanoseconds.1.get_or_insert(line);
                }
                self.counts.bad_rows += 1;
                self.counts.first_bad.get_or_insert_with(|| (line, why.to_string()));
            }
        }
        Ok(())
    }

    /// True for a row of mostly numbers behind a name, below headings that name its columns.
    fn has_name_first(&self, cells: &[&str], text: &str) -> bool {
        let numbers = cells.iter().filter(|cell| is_value(cell)).count();
        2 * numbers > cells.len() && matches!(headed(&self.head, cells, delimiter(text)), Ok(Some(_)))
    }

    fn take(&mut self, pose: Pose, quaternion: Option<[f64; 4]>, columns: usize) {
        self.counts.columns = columns;
        self.counts.rows += 1;
        self.counts.out_of_order += u64::from(self.poses.last().is_some_and(|last| last.t_s > pose.t_s));
        if let Some([a, b, c, w]) = quaternion {
            if a * a + b * b > TILTED {
                self.attitudes.push((pose.t_s, UnitQuaternion::from_quaternion(Quaternion::new(w, a, b, c))));
            }
            self.up[0] += 1.0 - 2.0 * (a * a + b * b);
            self.up[1] += 1.0 - 2.0 * (b * b + c * c);
        }
        if self.poses.len() == self.poses.capacity() {
            self.poses.reserve_exact(1024.max(self.poses.len() / 4));
        }
        self.poses.push(pose);
    }

    /// Fails if the rows contradict the assumed columns.
    fn check(&self, columns: &Columns) -> Result<(), CsvError> {
        let ambiguous = |why: String, readings: [String; 2]| Err(CsvError::Ambiguous { why, readings });
        let own = columns.words();
        let rows = self.counts.rows;
        if let (wrong, Some(line)) = self.no_nanoseconds
            && wrong * 10 > rows
            && let Some(exactly) = columns.exactly
        {
            let readings = match exactly {
                5 => ["t,x,y,z,yaw", "t,x,y,yaw"],
                6 => ["t,x,y,yaw", "t,x,y,z,_,yaw"],
                _ => ["t,x,y,z,qx,qy,qz,qw", "t,x,y,z,qw,qx,qy,qz"],
            };
            return ambiguous(format!("line {line}: {}", RowError::Nanoseconds(2)), readings.map(str::to_owned));
        }
        // A robot's z axis looks up.
        if columns.exactly.is_some() && self.up[0] < 0.5 * rows as f64 && self.up[1] > 0.9 * rows as f64 {
            let other = own.replace("qx,qy,qz,qw", "qw,qx,qy,qz");
            let why = "by its quaternions the robot lies on its side, unless w is their first";
            return ambiguous(why.into(), [own, other]);
        }
        let yaws = self.poses.iter().filter_map(|pose| pose.heading_rad);
        let yaw_rad = yaws.map(f64::abs).fold(0.0, f64::max);
        let unnamed = columns.column(What::Yaw).is_some_and(|yaw| yaw.scale.is_none());
        if unnamed && yaw_rad > 6.5 && !turns_with_its_yaw(&self.poses) {
            let why = format!("yaw goes to {yaw_rad}, which may be degrees or radians of several turns");
            let other = own.replace("yaw", "yaw_deg");
            return ambiguous(why, [own, other]);
        }
        if columns.turned {
            let [x, y, z] = [0, 1, 2].map(|axis| {
                let along = self.poses.iter().map(|pose| pose.position_m[axis]);
                along.clone().fold(f64::NEG_INFINITY, f64::max) - along.fold(f64::INFINITY, f64::min)
            });
            if z > 0.05 && z > 10.0 * x.min(y) {
                let why = "the axis that is up in this format has most of the motion";
                return ambiguous(why.into(), [own, columns.clone().with_z_up().words()]);
            }
        }
        Ok(())
    }

    /// The poses in the order of time.
    fn trajectory(mut self, times: Option<Vec<f64>>) -> Result<(Trajectory, CsvCounts), CsvError> {
        if let Some(columns) = &self.columns {
            self.check(columns)?;
            self.counts.taken_for = columns.words();
        }
        if self.poses.is_empty() {
            let unreadable = || self.head.first().map(|(line, _)| (*line, RowError::Unreadable.to_string()));
            let first = self.counts.first_bad.or_else(unreadable);
            let first = first.map_or_else(String::new, |(line, why)| format!("; line {line}: {why}"));
            return Err(CsvError::Refused(format!("no row of numbers{first}")));
        }
        let columns = self.columns.unwrap_or_default();
        if columns.matrix {
            timed(&mut self.poses, times)?;
        }
        let mut kind = columns.kind;
        if kind == TrajectoryKind::Unknown {
            kind = TrajectoryKind::of_frames(self.frames.as_deref().unwrap_or_default());
        }
        if kind == TrajectoryKind::Unknown && columns.exactly == Some(15) {
            // The only two that write 15 columns: wheels know no height, a camera's is never the same twice.
            let level = self.poses.iter().all(|pose| pose.position_m.z == self.poses[0].position_m.z);
            kind = if level { TrajectoryKind::Wheels } else { TrajectoryKind::Camera };
        }
        let trajectory = Trajectory::new(self.poses)?.with_kind(kind).with_attitudes(self.attitudes);
        match trajectory.jumps() {
            (count, furthest_m) if count > (trajectory.poses().len() / 10).max(FEW_JUMPS) => {
                Err(CsvError::Refused(format!(
                    "the robot jumps to and fro, {count} times, by up to {furthest_m:.2} m: poses of two robots? Write each robot's into a \
                 file of its own"
                )))
            }
            _ => Ok((trajectory, self.counts)),
        }
    }
}

fn too_long() -> std::io::Error {
    let (mib, poses) = (LONGEST >> 20, MOST_POSES);
    std::io::Error::other(format!("it is longer than {mib} MiB or {poses} poses, which no trajectory is"))
}

/// Gives each pose its time.
fn timed(poses: &mut [Pose], times: Option<Vec<f64>>) -> Result<(), CsvError> {
    let name = "a file of its times beside it (times.txt, or the poses' name and _times.txt: seconds, one a line)";
    let times = times.ok_or_else(|| CsvError::no_times(&format!("{name} is needed")))?;
    if times.len() != poses.len() {
        let why = format!("{} poses and {} times in the file beside it", poses.len(), times.len());
        return Err(CsvError::no_times(&why));
    }
    poses.iter_mut().zip(times).for_each(|(pose, t_s)| pose.t_s = t_s);
    Ok(())
}

/// The times beside a file of KITTI's poses, if there is such a file.
fn times_beside(path: &Path) -> Result<Option<Vec<f64>>, CsvError> {
    let (Some(stem), Some(folder)) = (path.file_stem(), path.parent()) else { return Ok(None) };
    let stem = stem.to_string_lossy();
    let names: [PathBuf; 3] = [
        folder.join(format!("{stem}_times.txt")),
        folder.join("times.txt"),
        folder.join("../sequences").join(&*stem).join("times.txt"),
    ];
    let Some(file) = names.iter().find(|name| name.is_file()) else { return Ok(None) };
    let name = file.display().to_string();
    let mut text = String::new();
    let read = std::fs::File::open(file).and_then(|file| file.take(LONGEST).read_to_string(&mut text));
    read.map_err(|source| CsvError::Io { path: name.clone(), source })?;
    let lines = text.lines().map(str::trim).zip(1..).filter(|(line, _)| !line.is_empty() && !is_comment(line));
    let time = |(line, at): (&str, u64)| {
        let bad = || CsvError::no_times(&format!("line {at} of {name} is no number of seconds"));
        number(line).filter(|t| t.is_finite()).ok_or_else(bad)
    };
    lines.map(time).collect::<Result<_, _>>().map(Some)
}

/// Reads a trajectory file row by row; only the poses stay in memory. Where columns are named, its headings are ignored.
///
/// # Errors
/// If it cannot be read, is of no known kind or of two, longer than any trajectory, or holds fewer than two poses.
pub fn read(path: &Path, columns: Option<&Columns>) -> Result<(Trajectory, CsvCounts), CsvError> {
    let io = |source| CsvError::Io { path: path.display().to_string(), source };
    if path.is_dir() {
        return Err(io(std::io::Error::other("it is a directory; name the CSV file inside it")));
    }
    let file = std::fs::File::open(path).map_err(io)?;
    let mut rows = Rows::named(columns);
    let mut bytes = file.take(LONGEST + 1);
    rows.read(&mut bytes, MOST_POSES, path)?;
    if bytes.limit() == 0 {
        return Err(io(too_long()));
    }
    let is_matrix = rows.columns.as_ref().is_some_and(|columns| columns.matrix);
    let times = if is_matrix { times_beside(path)? } else { None };
    rows.trajectory(times).map(|read| of_name(read, path))
}

/// Parses the poses of a topic, whose name may show the sensor as a file's does.
///
/// # Errors
/// As [`parse`].
#[doc(hidden)]
pub fn parse_topic(bytes: &[u8], topic: &str) -> Result<(Trajectory, CsvCounts), CsvError> {
    parse(bytes, None).map(|read| of_name(read, Path::new(&topic.replace('/', "_"))))
}

/// With the sensor that the name shows, if it shows one.
fn of_name((trajectory, counts): (Trajectory, CsvCounts), name: &Path) -> (Trajectory, CsvCounts) {
    let kind = match kind_of_file(name) {
        TrajectoryKind::Unknown => trajectory.kind(),
        kind => kind,
    };
    (trajectory.with_kind(kind), counts)
}

/// Parses a trajectory from bytes. Where columns are named, its headings are ignored.
///
/// # Errors
/// If it is of no known kind or of two, or holds fewer than two poses.
pub fn parse(bytes: &[u8], columns: Option<&Columns>) -> Result<(Trajectory, CsvCounts), CsvError> {
    let mut rows = Rows::named(columns);
    rows.read(bytes, usize::MAX, Path::new(""))?;
    rows.trajectory(None)
}

/// Parses a single row without headings.
///
/// # Errors
/// What is wrong with it.
#[doc(hidden)]
pub fn parse_line(line: &[u8]) -> Result<Pose, String> {
    let text = std::str::from_utf8(line).map_err(|_| RowError::Unreadable.to_string())?;
    let cells = cells(text.trim());
    let columns = headless(&cells).filter(|columns| !columns.matrix).ok_or(RowError::Columns);
    columns.and_then(|columns| columns.pose(&cells)).map(|(pose, _)| pose).map_err(|why| why.to_string())
}

/// A pose as a row: 6 columns, 5 if it has no heading, and the trailing comma.
#[must_use]
#[doc(hidden)]
pub fn line(pose: &Pose) -> String {
    let p = pose.position_m;
    let heading = pose.heading_rad.map_or(String::new(), |heading| format!("{:.6},", crate::maths::wrap_rad(heading)));
    format!("{:.6},0,{:.6},{:.6},{:.6},{heading}\n", pose.t_s, p.x, p.y, p.z)
}

/// True where the path turns as its yaw does in radians: degrees are 57 times as many. Pieces of 0.1 m say where it leads.
fn turns_with_its_yaw(poses: &[Pose]) -> bool {
    let (mut path_rad, mut yaw_rad) = (0.0, 0.0);
    let (mut from, mut before): (Option<&Pose>, Option<(f64, f64)>) = (None, None);
    for pose in poses {
        let start = *from.get_or_insert(pose);
        let moved_m = pose.position_m - start.position_m;
        let (Some(yaw), true) = (pose.heading_rad, moved_m.xy().norm() >= 0.1) else { continue };
        let direction = moved_m.y.atan2(moved_m.x);
        if let Some((last_direction, last_yaw)) = before {
            path_rad += crate::maths::wrap_rad(direction - last_direction).abs();
            yaw_rad += (yaw - last_yaw).abs();
        }
        (from, before) = (Some(pose), Some((direction, yaw)));
    }
    path_rad > 1.0 && yaw_rad < 8.0 * path_rad
}

// ---------------------------------------------------------------------------------------------------------------------------
// Bytes to text.

/// Text as UTF-8; UTF-16 is recognised by its mark, or by the zero of its first letter.
fn utf8<'a>(mut bytes: impl Read + 'a) -> std::io::Result<Box<dyn Read + 'a>> {
    let mut start = Vec::new();
    bytes.by_ref().take(2).read_to_end(&mut start)?;
    let unit: fn([u8; 2]) -> u16 = match start[..] {
        [0xff, 0xfe] | [1..=0xff, 0] => u16::from_le_bytes,
        [0xfe, 0xff] | [0, 1..=0xff] => u16::from_be_bytes,
        _ => return Ok(Box::new(Cursor::new(start).chain(bytes))),
    };
    Ok(Box::new(Utf16 { bytes: Cursor::new(start).chain(bytes), unit }))
}

/// UTF-16, given as UTF-8.
struct Utf16<R> {
    bytes: R,
    unit: fn([u8; 2]) -> u16,
}

impl<R: Read> Read for Utf16<R> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        // Three bytes of UTF-8 at most for two of UTF-16; letters beyond are no part of numbers or headings.
        let mut wide = Vec::new();
        self.bytes.by_ref().take(out.len() as u64 / 3 * 2).read_to_end(&mut wide)?;
        let units = wide.chunks_exact(2).map(|pair| (self.unit)([pair[0], pair[1]]));
        let text: String =
            char::decode_utf16(units).map(|letter| letter.unwrap_or(char::REPLACEMENT_CHARACTER)).collect();
        out[..text.len()].copy_from_slice(text.as_bytes());
        Ok(text.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_may_be_parted_otherwise_and_then_have_decimal_commas() {
        let rows = "10.5,0,1.25,-2e-3,3\n10.75,0,1.5,2,3\n";
        let expected = parse(rows.as_bytes(), None).unwrap();
        assert_eq!((expected.1.rows, expected.1.headings), (2, false));
        let decimal_commas = |by: &str| rows.replace(',', by).replace('.', ",");
        let spaces = format!("  {}", rows.replace(',', "   ").replace('\n', "  \n "));
        for text in [rows.replace(',', ";"), rows.replace(',', "\t"), spaces, decimal_commas(";"), decimal_commas("\t")]
        {
            assert_eq!(parse(text.as_bytes(), None).unwrap(), expected, "{text}");
        }
        for headings in ["\u{feff}t;0;x;y;z\n", "# seconds\n\nZeit;ns;x;y;z\n", "\"t\";\"0\";\"x\";\"y\";\"z\"\r\n"] {
            let (trajectory, counts) = parse(format!("{headings}{}", decimal_commas(";")).as_bytes(), None).unwrap();
            assert_eq!((&trajectory, counts.headings, counts.bad_rows), (&expected.0, true, 0), "{headings}");
        }
        // A first row without numbers or names is no heading.
        let (trajectory, counts) = parse(format!("nan,0,1,2,3\n{rows}").as_bytes(), None).unwrap();
        assert!(counts.bad_rows == 1 && counts.lost_something(&trajectory), "{counts:?}");
    }

    /// They are as many as those of another kind.
    #[test]
    fn numbers_with_decimal_commas_parted_by_commas_are_no_row() {
        assert_eq!(parse_line(b"10,5,0,1,25,0,002,3,5"), Err(RowError::Quaternion.to_string()));
    }

    #[test]
    fn a_heading_may_be_unknown_in_some_rows() {
        for text in [
            "t,x,y,yaw\n1,0,0,nan\n2,1,0,0.5\n",
            "t,x,y,z,qx,qy,qz,qw\n1,0,0,0,0,0,0,0\n2,1,0,0,0,0,0.247404,0.968912\n",
        ] {
            let (trajectory, counts) = parse(text.as_bytes(), None).unwrap();
            let headings: Vec<_> =
                trajectory.poses().iter().map(|pose| pose.heading_rad.map(|rad| (1e3 * rad).round())).collect();
            assert_eq!((headings, counts.bad_rows), (vec![None, Some(500.0)], 0), "{text}");
        }
    }

    #[test]
    fn what_of_a_file_is_not_used_is_said() {
        let said = |text: &str| {
            let (trajectory, counts) = parse(text.as_bytes(), None).unwrap();
            (counts.notes(&trajectory).join("; "), counts.lost_something(&trajectory))
        };
        assert_eq!(said("1,0,0,0,0\n2,0,1,0,0\n"), (String::new(), false));
        assert_eq!(
            said("t,0,x,y,z\n2,0,1,0,0\n1,0,0,0,0\n3,0,2,0,0\n"),
            ("1 rows out of order in time, sorted".into(), false)
        );
        let (words, lost) = said("1,0,0,0,0\n1,0,1,0,0\n2,0,1,0,0\n3,0,1,0,0\n4,0,?,0,0\n");
        assert!(
            lost && words.starts_with("1 rows skipped, the first in line 5: column 3 is not")
                && words.contains("; 1 rows skipped at whose time"),
            "{words}"
        );
        let row = |k: u32| format!("{},0,{},0,0\n", if k < 60 { k } else { k - 30 }, f64::from(k) * 0.1);
        let (words, lost) = said(&(0..100).map(row).collect::<String>());
        assert!(
            lost && words.starts_with("time goes back by 29.000 s") && words.contains(" 40 rows skipped"),
            "{words}"
        );
    }

    #[test]
    fn a_path_that_jumps_is_doubtful_and_one_to_and_fro_is_two() {
        let row = |(k, x_m): (u32, f64)| format!("{},0,{x_m},0,0\n", f64::from(k) * 0.01);
        let path = |x_m: &dyn Fn(u32) -> f64| (0..200).map(|k| row((k, x_m(k)))).collect::<String>();
        let drives = |k: u32| f64::from(k) * 0.02;
        let said = |text: &str| {
            parse(text.as_bytes(), None)
                .map(|(path, counts)| (counts.notes(&path).join("; "), counts.lost_something(&path)))
        };
        assert_eq!(said(&path(&drives)).unwrap(), (String::new(), false));
        let (words, lost) = said(&path(&|k| drives(k) + if k < 100 { 0.0 } else { 0.6 })).unwrap();
        assert!(lost && words.starts_with("jumps from one pose to the next: 1, by up to 0.62 m"), "{words}");
        // Other times for every second row: none of them is another's.
        let error = said(&path(&|k| drives(k) + if k % 2 == 0 { 0.0 } else { 3.0 })).unwrap_err().to_string();
        assert!(error.contains("to and fro, 199 times, by up to 3.02 m: poses of two robots?"), "{error}");
    }

    #[test]
    fn a_stray_quote_costs_its_row_and_quoted_numbers_are_numbers() {
        let mut text = String::new();
        (0..100).for_each(|k| text += &format!("{k},0,\"{k}\",0,{}0,\n", if k == 10 { "\"1" } else { "" }));
        let (trajectory, counts) = parse(text.as_bytes(), None).unwrap();
        assert_eq!(
            (trajectory.poses().len(), counts.rows, counts.bad_rows),
            (100, 100, 0),
            "a quote at an end is none"
        );
        let text = text.replace("\"10\"", "1\"0");
        let (trajectory, counts) = parse(text.as_bytes(), None).unwrap();
        assert_eq!((trajectory.poses().len(), counts.bad_rows), (99, 1));
        assert_eq!(counts.first_bad, Some((11, RowError::Number(3).to_string())));
    }

    #[test]
    fn coordinates_of_which_no_metre_is_left_are_none() {
        for (far, expected) in [(1e9, Ok(())), (-1.000_001e9, Err(())), (1e308, Err(()))] {
            for column in 2..5 {
                let mut cells = ["1", "0", "0", "0", "0"].map(str::to_owned);
                cells[column] = far.to_string();
                let parsed = parse_line(cells.join(",").as_bytes());
                let expected = expected.map_err(|()| RowError::TooFar(column + 1).to_string());
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
        let held = allocation_counter::measure(|| read = Some(super::read(&path, None))).bytes_max;
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
            let end = rows.read(&b"1,0,0,0,0\n2,0,0,0,0\n3,0,0,0,0\n4,0,0,0,0\n"[..], most, Path::new("run.csv"));
            (end.is_err_and(|error| error.to_string().contains("run.csv: it is longer")), rows.poses.len())
        };
        assert_eq!([rows(2), rows(4)], [(true, 3), (false, 4)]);
    }

    #[test]
    fn a_row_without_an_end_takes_no_memory_and_costs_itself() {
        let (before, after) = (&b"1,0,0,0,0\n"[..], &b"\n2,0,0,0,0\n"[..]);
        let zeros = std::io::repeat(0).take(64 << 20);
        let mut rows = Rows::default();
        let held = allocation_counter::measure(|| {
            assert!(matches!(rows.read(before.chain(zeros).chain(after), 9, Path::new("")), Ok(())));
        });
        assert!(held.bytes_max < 1 << 20, "{} bytes", held.bytes_max);
        assert_eq!((rows.poses.len(), rows.counts.bad_rows, rows.counts.first_bad.unwrap().0), (2, 1, 2));
    }

    #[test]
    fn wrong_files_say_what_is_wrong() {
        let refused = |bytes: &[u8]| parse(bytes, None).unwrap_err().to_string();
        assert_eq!(refused(b""), "no row of numbers");
        assert!(refused(b"a,b,c\n").starts_with("no row of numbers; line 1: "));
        assert!(refused(b"1,2,3\n").starts_with("line 1: 3 columns without headings"));
        assert!(refused(&[0xBB, 0, 0xFF, b'\n', 7]).starts_with("no row of numbers; line "));
        assert!(matches!(parse(b"1,0,0,0,0\n", None), Err(CsvError::Trajectory(TrajectoryError::TooFew { poses: 1 }))));
    }

    /// Half a second on a circle, from 1,700,000,000 s on, a pose each 10 ms: time, x, y, z, heading.
    fn arc() -> Vec<[f64; 5]> {
        let pose = |k: u32| {
            let turn = f64::from(k) * 0.02;
            [1_700_000_000.0 + f64::from(k) * 0.01, turn.sin() + 0.1, 1.1 - turn.cos(), 0.25, turn]
        };
        (0..50).map(pose).collect()
    }

    /// A file of [`arc`] below `head`: `row` of each pose, in which names in braces stand for its numbers.
    fn written(head: &str, row: &str) -> String {
        let row = |[t, x, y, z, yaw]: [f64; 5]| {
            let (s, c) = (0.5 * yaw).sin_cos();
            let run_s = t - 1_700_000_000.0;
            let (sec, nsec) = (t.floor(), ((t - t.floor()) * 100.0).round() as u64 * 10_000_000);
            let lengths = [("", 1.0), ("_cm", 1e2), ("_mm", 1e3)].into_iter().flat_map(|(unit, by)| {
                [("x", x), ("y", y), ("z", z), ("-y", -y), ("-z", -z)]
                    .map(|(name, metres)| (format!("{name}{unit}"), (metres * by).to_string()))
            });
            let (sin, cos) = yaw.sin_cos();
            let angles = [("yaw", yaw), ("deg", yaw.to_degrees()), ("s", s), ("c", c), ("sin", sin), ("cos", cos)];
            let numbers = [("-sin", -sin), ("sec", sec), ("ms", t * 1e3)].into_iter().chain(angles);
            let times = [
                ("t", format!("{t:.6}")),
                ("run", format!("{run_s:.6}")),
                ("exponent", format!("{run_s:e}")),
                ("nsec", nsec.to_string()),
                ("ns", format!("{sec}{nsec:09}")),
            ];
            let numbers = numbers.map(|(name, number)| (name, number.to_string())).chain(times);
            let all = numbers.map(|(name, number)| (name.to_owned(), number)).chain(lengths);
            all.fold(row.to_owned(), |row, (name, number)| row.replace(&format!("{{{name}}}"), &number)) + "\n"
        };
        head.to_owned() + &arc().into_iter().map(row).collect::<String>()
    }

    /// What a file of [`arc`] must give: its poses, with the heading if `heading`; times may be of a run that begins at 0.
    fn must_be_arc(
        name: &str,
        read: Result<(Trajectory, CsvCounts), CsvError>,
        heading: bool,
        from_s: f64,
    ) -> CsvCounts {
        let (trajectory, counts) = read.unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!((trajectory.poses().len(), counts.bad_rows), (50, 0), "{name}: {counts:?}");
        for (pose, [t, x, y, z, yaw]) in trajectory.poses().iter().zip(arc()) {
            let t = t - 1_700_000_000.0 + from_s;
            let off_m = (pose.position_m - Vector3::new(x, y, z)).norm();
            assert!((pose.t_s - t).abs() < 1e-6 && off_m < 1e-6, "{name}: {pose:?} for {t} {x} {y} {z}");
            match pose.heading_rad {
                Some(own) if heading => assert!((own - yaw).abs() < 1e-6, "{name}: {own} for {yaw}"),
                None if !heading => {}
                other => panic!("{name}: {other:?}"),
            }
        }
        counts
    }

    const FIVE: &str = "{t},0,{x},{y},{z}";
    const W_FIRST: &str = "{t} {x} {y} {z} {c} 0 0 {s}";

    #[test]
    fn files_of_all_kinds_give_the_same_path() {
        let stamped = "{sec},{nsec},map,{x},{y},{z},0.0,0.0,{s},{c}";
        let one = "{sec},{nsec},odom,base_link,{x},{y},{z},0.0,0.0,{s},{c}";
        let odometry = format!("{one},{}0.1", "0.0,".repeat(77));
        let with_covariance = format!("{stamped}{}", ",0.0".repeat(36));
        let echoed = "9,7,{ns},map,{x},{y},{z},0.0,0.0,{s},{c}";
        let pose = "pose.position.x,field.pose.position.y,field.pose.position.z,field.pose.orientation.x,field.pose.orientation.y,\
                field.pose.orientation.z,field.pose.orientation.w";
        let stamp = "%time,field.header.seq,field.header.stamp,field.header.frame_id";
        let transform = "field.transforms0.transform.translation.x,field.transforms0.transform.translation.y,\
                     field.transforms0.transform.translation.z,field.transforms0.transform.rotation.x,\
                     field.transforms0.transform.rotation.y,field.transforms0.transform.rotation.z,\
                     field.transforms0.transform.rotation.w";
        let ros = |names: &str| format!("{stamp},{names}\n");
        let ros_odometry = ros(&format!("field.pose.{}", pose.replace("field.", "field.pose.")));
        let euroc = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],v_RS_R_x [m s^-1],\
             v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],b_w_RS_S_z [rad s^-1],\
             b_a_RS_S_x [m s^-2],b_a_RS_S_y [m s^-2],b_a_RS_S_z [m s^-2]\n";
        let kinds: [(&str, &str, &str); 21] = [
            ("five columns", "", FIVE),
            ("six columns", "", "{t},0,{x},{y},{z},{yaw},"),
            ("nine columns", "", "{t},0,{x},{y},{z},0,0,{s},{c}"),
            ("fifteen columns", "", "{sec},{nsec},{x},{y},{z},0,0,{s},{c},0,0,0,0,0,0,"),
            ("headings", "timestamp,x,y,z,yaw\n", "{t},{x},{y},{z},{yaw}"),
            ("speeds", "t,x,y,yaw,v,w,z\n", "{t},{x},{y},{yaw},0.2,0.1,{z}"),
            ("degrees", "seconds,nanoseconds,x,y,z,yaw_deg\n", "{t},0,{x},{y},{z},{deg}"),
            ("a line of units", "time,ns,x,y,z\n[s],[ns],[m],[m],[m]\n", FIVE),
            ("a title", "Robot 1 trajectory\ntime,ns,x,y,z\n", FIVE),
            ("TUM", "# timestamp tx ty tz qx qy qz qw\n", "{t} {x} {y} {z} 0 0 {s} {c}"),
            ("SVIn", "# timestamp tx ty tz qw qx qy qz\n", W_FIRST),
            ("EuRoC", euroc, "{ns},{x},{y},{z},{c},0,0,{s},0.1,0.2,0.3,0,0,0,0,0,0"),
            ("rostopic, pose", &ros(&format!("field.{pose}")), echoed),
            ("rostopic, odometry", &ros_odometry, echoed),
            ("rostopic, TF", &ros(transform).replace("field.header", "field.transforms0.header"), echoed),
            ("rostopic, transform", &ros(&transform.replace("transforms0.", "")), echoed),
            ("ros2, odometry", "", &odometry),
            ("ros2, pose", "", stamped),
            ("ros2, pose with covariance", "", &with_covariance),
            ("pandas", ",stamp.sec,stamp.nanosec,x,y,z,theta\n", "3,{sec},{nsec},{x},{y},{z},{yaw}"),
            ("nanoseconds", "t_ns\tpx\tpy\tpz\theading\n", "{ns}\t{x}\t{y}\t{z}\t{yaw}"),
        ];
        let mut files: Vec<(&str, bool, String)> =
            kinds.map(|(name, head, row)| (name, row != FIVE, written(head, row))).into();
        let own =
            written("Time [ms];Pos X (mm);Pos Y (mm);Pos Z (mm);Yaw (\u{b0})\n", "{ms};{x_mm};{y_mm};{z_mm};{deg}");
        files.push(("units of their own", true, own.replace('.', ",")));
        let cm = written("time,ns,x,y,z\ns,ns,cm,cm,cm\n", "{t},0,{x_cm},{y_cm},{z_cm}");
        files.push(("a line of other units", false, cm));
        files.push(("a tail", false, written("", FIVE) + "   \n,,,,\n;;;\n"));
        // Some messages have another transform, too.
        let tf = written("", &format!("{one},{one}"));
        let tf = tf.lines().enumerate().map(|(k, row)| if k > 25 { &row[..row.len() / 2] } else { row });
        files.push(("ros2, TF", true, tf.map(|row| format!("{row}\n")).collect()));
        for (name, heading, text) in &files {
            must_be_arc(name, parse(text.as_bytes(), None), *heading, 1_700_000_000.0);
            // As Windows writes it, twice one behind the other, and as 16 bits a letter.
            let mut wide: Vec<u8> = vec![0xff, 0xfe];
            wide.extend(text.replace('\n', "\r\n").encode_utf16().flat_map(u16::to_le_bytes));
            must_be_arc(name, parse(&wide, None), *heading, 1_700_000_000.0);
            let bare: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
            must_be_arc(name, parse(&bare, None), *heading, 1_700_000_000.0);
        }
    }

    #[test]
    fn times_of_day_names_of_robots_and_of_maps_are_read() {
        for (name, hour, zone) in [("UTC", 22, "Z"), ("no zone", 22, ""), ("east", 23, "+01:00"), ("west", 17, "-0500")]
        {
            let date = |[t, x, y, z, _]: [f64; 5]| {
                let s = t - 1_700_000_000.0 + 20.0;
                format!("2023-11-14T{hour}:13:{s:09.6}{zone},{x},{y},{z}\n")
            };
            let rows = "time,x,y,z\n".to_owned() + &arc().into_iter().map(date).collect::<String>();
            must_be_arc(name, parse(rows.as_bytes(), None), false, 1_700_000_000.0);
            let rows = rows.replace('T', " ");
            must_be_arc(name, parse(rows.as_bytes(), None), false, 1_700_000_000.0);
        }
        let robots = |name: &str| written("robot,t,east,north,up\n", &format!("{name},{{t}},{{x}},{{y}},{{z}}"));
        must_be_arc("robot", parse(robots("rx").as_bytes(), None), false, 1_700_000_000.0);
        let two = robots("rx") + &robots("tx");
        assert!(
            matches!(parse(two.as_bytes(), None), Err(CsvError::Refused(why)) if why.contains("among those of")),
            "two robots"
        );
        for head in ["t,x [in],y,z,yaw", "t,x,y,z [in],yaw", "t,x,y,z,yaw [gon]"] {
            let error =
                parse(written(&format!("{head}\n"), "{t},{x},{y},{z},{yaw}").as_bytes(), None).unwrap_err().to_string();
            let heading = head.split(',').find(|heading| heading.contains('[')).unwrap();
            assert!(error.contains(&format!("have `{heading}`, whose unit is not known")), "{error}");
        }
        // What another column has, too, is not missed.
        let twice = written("t,x,y,z,up [in]\n", "{t},{x},{y},{z},7");
        must_be_arc("twice", parse(twice.as_bytes(), None), false, 1_700_000_000.0);
    }

    #[test]
    fn dates_are_seconds_since_1970() {
        // By GNU date.
        for (text, s) in [
            ("1970-01-01T00:00:00Z", 0.0),
            ("2000-02-29 12:00:00.25", 951_825_600.25),
            ("2023-11-14T22:13:20Z", 1_700_000_000.0),
            ("2024-12-31T23:59", 1_735_689_540.0),
        ] {
            assert_eq!(date_time(text), Some(s), "{text}");
        }
        for text in
            ["", "12", "2023-11-14", "2023-13-14T00:00:00", "2023-11-14T24:00:00", "a-b-cT1:2:3", "2023-11-14T1:2:3+x"]
        {
            assert_eq!(date_time(text), None, "{text}");
        }
    }

    #[test]
    fn motive_and_kitti_have_axes_of_their_own() {
        let body = ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error";
        let names = |count: usize, name: &str| format!(",{}", [name].repeat(count).join(","));
        let head = format!(
            "Format Version,1.23,Take Name,Take 1,Capture Frame Rate,120.000000,Length Units,Millimeters\n\n,Type{}\n,Name{}\n\
         ,ID{}\n{body}\nFrame,Time (Seconds),X,Y,Z,W,X,Y,Z,\n",
            names(8, "Rigid Body"),
            names(8, "Robot"),
            names(8, "1")
        );
        // x, up, towards the one who looks
        let text = written(&head, "7,{run},0,{s},0,{c},{x_mm},{z_mm},{-y_mm},0.1");
        let motive = parse(text.as_bytes(), None);
        assert_eq!(motive.as_ref().unwrap().0.kind(), TrajectoryKind::MotionCapture);
        must_be_arc("Motive", motive, true, 0.0);
        // Two bodies are refused, and so is what was exported with z up.
        let two = text.replacen(",Robot,Robot", ",Robot,Other", 1);
        let error = parse(two.as_bytes(), None).unwrap_err().to_string();
        assert!(error.contains("rigid bodies (Robot, Other, Robot): export one"), "{error}");
        let z_up = written(&head, "7,{run},0,{s},0,{c},{x_mm},{y_mm},{z_mm},0.1");
        let Err(CsvError::Ambiguous { readings, .. }) = parse(z_up.as_bytes(), None) else { panic!() };
        assert_eq!(readings, ["_,t,qx,qz,-qy,qw,x_mm,z_mm,-y_mm", "_,t,qx,qy,qz,qw,x_mm,y_mm,z_mm"]);
        // KITTI: x right, y down, z forward, and the times in a file beside.
        let folder = std::env::temp_dir().join(format!("csi5300-kitti-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let kitti = written("", "{cos} 0 {-sin} {-y} 0 1 0 {-z} {sin} 0 {cos} {x}");
        std::fs::write(folder.join("00.txt"), &kitti).unwrap();
        let error = read(&folder.join("00.txt"), None).unwrap_err().to_string();
        assert!(error.contains("KITTI") && error.contains("times.txt"), "{error}");
        std::fs::write(folder.join("times.txt"), written("# s\n", "{exponent}")).unwrap();
        must_be_arc("KITTI", read(&folder.join("00.txt"), None), true, 0.0);
        std::fs::write(folder.join("00_times.txt"), "1\n2\n").unwrap();
        let error = read(&folder.join("00.txt"), None).unwrap_err().to_string();
        assert!(error.contains("50 poses and 2 times"), "{error}");
        std::fs::write(folder.join("00_times.txt"), "1\n\ntwo\n").unwrap();
        let error = read(&folder.join("00.txt"), None).unwrap_err().to_string();
        assert!(error.contains("line 3 of ") && error.contains("00_times.txt is no number"), "{error}");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn radians_of_several_turns_are_known_by_the_path_and_degrees_are_not_taken_for_them() {
        // Two circles of 0.3 m, driven forward and counted on.
        let way = |degrees: bool| {
            let row = |k: i32| {
                let angle = f64::from(k) * 0.01;
                let yaw = angle + std::f64::consts::FRAC_PI_2;
                let yaw = if degrees { yaw.to_degrees() } else { yaw };
                format!("{:.6},0,{:.4},{:.4},0,{yaw:.4}\n", 100.0 + angle, 0.3 * angle.cos(), 0.3 * angle.sin())
            };
            (0..1257).map(row).collect::<String>()
        };
        let (trajectory, _) = parse(way(false).as_bytes(), None).unwrap();
        let last = trajectory.poses().last().unwrap();
        assert!((last.heading_rad.unwrap() - 12.56 - std::f64::consts::FRAC_PI_2).abs() < 1e-3, "{last:?}");
        assert!(matches!(parse(way(true).as_bytes(), None), Err(CsvError::Ambiguous { .. })));
    }

    #[test]
    fn what_may_mean_two_things_is_refused_and_named_columns_decide() {
        for (name, head, row, columns) in [
            ("yaw last", "", "{t},{x},{y},{z},{yaw}", "t,x,y,z,yaw"),
            ("speeds", "", "{t},{x},{y},{yaw},{z},0.1", "t,x,y,yaw,z"),
            ("w first", "", W_FIRST, "t,x,y,z,qw,qx,qy,qz"),
            ("degrees", "", "{t},0,{x},{y},{z},{deg}", "t,_,x,y,z,yaw_deg"),
            ("degrees, headed", "t,x,y,z,yaw\n", "{t},{x},{y},{z},{deg}", "t,x,y,z,yaw_deg"),
            ("four", "", "{t},{x},{y},{z}", "t,x,y,z"),
        ] {
            let text = written(head, row);
            let error = parse(text.as_bytes(), None).expect_err(name);
            assert!(matches!(error, CsvError::Ambiguous { .. } | CsvError::Refused(_)), "{name}: {error}");
            assert!(error.to_string().contains("--columns"), "{name}: {error}");
            if let CsvError::Ambiguous { readings, .. } = &error {
                assert!(readings.iter().all(|reading| reading.parse::<Columns>().is_ok()), "{readings:?}");
                assert!(
                    readings.iter().any(|reading| columns.starts_with(reading)) || columns == "t,_,x,y,z,yaw_deg",
                    "{readings:?}"
                );
            }
            let columns: Columns = columns.parse().unwrap();
            must_be_arc(name, parse(text.as_bytes(), Some(&columns)), name != "four", 1_700_000_000.0);
        }
        for (text, why) in [
            ("when,east,north,x,y\n1.5,1,2,3,4\n2.5,1,2,3,5\n", "the headings name no time"),
            ("a,b,c,d,e\n1.5,0,2,3,4\n2.5,0,2,3,5\n", "the headings name no time and no x and no y"),
            ("t,x,y,tx_x,x\n1.5,1,2,3,4\n2.5,1,2,3,5\n", "name `x` twice, columns 2 and 5"),
            ("# time x y z kurs\n1.5,0,2,3,4\n2.5,0,2,3,5\n", ""),
        ] {
            match parse(text.as_bytes(), None) {
                Ok((trajectory, _)) => {
                    assert!(why.is_empty() && trajectory.poses()[0].position_m == Vector3::new(0.0, 2.0, 3.0))
                }
                Err(error) => assert!(!why.is_empty() && error.to_string().contains(why), "{error}"),
            }
        }
        let frames = "1,0,odom,base,0,0,0,0,0,0,1\n1,5,odom,base,0,0,0,0,0,0,1\n2,0,base,laser,9,0,0,0,0,0,1\n";
        let error = parse(frames.as_bytes(), None).unwrap_err();
        assert!(
            error.to_string().starts_with("line 3: poses of `base -> laser` among those of `odom -> base`"),
            "{error}"
        );
    }

    #[test]
    fn columns_are_named_in_one_way() {
        for text in ["t,x,y", "t,ns,x,y,z,yaw", "_,t_ns,x_mm,y_mm,_,yaw_deg", "t,qx,qz,-qy,qw,x,z,-y", "t_ms,x_cm,y_cm"]
        {
            assert_eq!(text.parse::<Columns>().unwrap().words(), text);
        }
        for (text, why) in [
            ("", "name no time"),
            ("t,x", "name no y"),
            ("t,x,y,x", "name `x` twice"),
            ("t,x,y,z,roll", "`roll` is not known"),
            ("t,x,y,qx,qy", "a quaternion has"),
            ("t,x_y,y", "`x_y` is not known"),
            ("seconds,x,y", "`seconds` is not known"),
        ] {
            let error = text.parse::<Columns>().unwrap_err().to_string();
            assert!(error.contains(why), "{text}: {error}");
        }
    }

    #[test]
    fn a_file_says_what_sensor_it_is_of_where_that_is_certain() {
        use TrajectoryKind::{Camera, MotionCapture, Unknown, Wheels};
        let fifteen = |z: f64| format!("1,0,0,0,{z},0,0,0,1,0,0,0,0,0,0\n2,0,1,0,0.5,0,0,0,1,0,0,0,0,0,0\n");
        let ros = |frames: &str| format!("1,0,{frames},0,0,0,0,0,0,1\n2,0,{frames},1,0,0,0,0,0,1\n");
        for (text, kind) in [
            (fifteen(0.5), Wheels),
            (fifteen(0.25), Camera),
            (ros("odom,base_link"), Wheels),
            (ros("odom,"), Unknown),
            (ros("camera_odom_frame,camera_pose_frame"), Camera),
            (ros("wheel_odom"), Wheels),
            (ros("mocap"), MotionCapture),
            ("1,0,0,0,0\n2,0,0,0,0\n".into(), Unknown),
        ] {
            assert_eq!(parse(text.as_bytes(), None).unwrap().0.kind(), kind, "{text}");
        }
        for (name, kind) in [
            ("odom_rx_trajectory_1_.csv", Wheels),
            ("t265_rx_trajectory_1_.csv", Camera),
            ("rx_trajectory_1_.csv", MotionCapture),
            ("rx_movement_1.csv", MotionCapture),
            ("behaviour.csv", Unknown),
            ("run.csv", Unknown),
        ] {
            assert_eq!(kind_of_file(Path::new(name)), kind, "{name}");
        }
    }
}
