//! Files that commands read and write: logs, trajectories, with `--bag` the topics of a recording; other kinds of files; outputs that are
//! not overwritten.

use super::{InWords, Words, hint, usage};
use csi5300::motion::odometry::csv::{self, Columns, CsvCounts};
use csi5300::motion::pose::Trajectory;
use csi5300::source::replay::Replay;
use csi5300_bag::unbag::{Content, Recording};
use csi5300_lab::kinds::{A_LOG, not_a_log, trajectory_refused};
use csi5300_lab::show::file_safe;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// A log that is read.
pub type Log = Replay<Box<dyn Read + Send>>;

/// Opens a log; `-` is standard input.
///
/// # Errors
/// If it cannot be opened, or is another kind of file, in words.
pub fn open_log(path: &Path) -> Words<Log> {
    if is_endless(path) {
        return Err(format!("{} has no end: a log is a file, a pipe or -", path.display()));
    }
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

/// True for a device of the kernel that gives bytes without end, such as `/dev/zero`: a device of its memory other than `/dev/null`.
fn is_endless(path: &Path) -> bool {
    use std::os::unix::fs::{FileTypeExt, MetadataExt};
    const MEMORY: u64 = 1 << 8;
    let of = |found: std::fs::Metadata| found.file_type().is_char_device().then(|| found.rdev());
    path.metadata().ok().and_then(of).is_some_and(|device| device & !0xff == MEMORY && device != MEMORY + 3)
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

/// Reads a trajectory, whose columns may be named, and reports skipped rows.
///
/// # Errors
/// If it cannot be read, or is another kind of file, in words.
pub fn read_trajectory(path: &Path, columns: Option<&Columns>) -> Words<Trajectory> {
    let (trajectory, counts) = csv::read(path, columns).map_err(|error| trajectory_refused(path, &error))?;
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
fn say_trajectory(path: &Path, trajectory: &Trajectory, counts: &CsvCounts) {
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

/// True for standard input and pipes, whose content is gone after the first reader.
pub fn is_read_once(path: &Path) -> bool {
    path.as_os_str() == "-" || path.metadata().is_ok_and(|meta| !meta.is_file() && !meta.is_dir())
}

/// Ends the program if a log is given twice.
pub fn refuse_twice<'a>(logs: impl Iterator<Item = &'a PathBuf> + Clone) {
    let is_same = |a: &Path, b: &Path| a == b || is_same_file(a, b);
    if let Some((_, twice)) =
        logs.clone().enumerate().find(|(k, log)| logs.clone().take(*k).any(|other| is_same(log, other)))
    {
        usage(&format!("{} is given twice: each robot has its own log", twice.display()));
    }
}

/// Refuses an existing output, unless `--force` was given, which replaces files but not pipes: they would wait for a
/// reader.
pub fn must_not_exist(output: &Path, force: bool) -> Words<()> {
    use std::os::unix::fs::FileTypeExt;
    // Standard output is one of the program's own.
    let is_own = |path: &Path| path.starts_with("/dev") || path.starts_with("/proc");
    match output.metadata() {
        _ if output.as_os_str() == "-" => Err("- is no output: name a file, or /dev/stdout".into()),
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

// The option of commands that read recordings too.
#[derive(clap::Args, Clone, Default)]
pub struct BagArgs {
    /// Recording with odometry and CSI: a folder of `ros2 bag`, or an MCAP, SQLite or ROS 1 file. --rx, --tx and
    /// --trajectory then name topics or files; those with one matching topic may be omitted
    #[arg(long, value_name = "BAG", hide_short_help = true)]
    pub bag: Option<PathBuf>,
}

/// The named inputs: the receiver's log, the transmitters' logs, the receiver's trajectory.
pub struct Named {
    /// The receiver's log.
    pub rx: PathBuf,
    /// The transmitters' logs, at least one.
    pub tx: Vec<PathBuf>,
    /// The receiver's trajectory.
    pub trajectory: PathBuf,
}

/// Files, or files and topics.
#[derive(Default)]
pub struct Inputs {
    /// Columns of trajectory files, if given.
    pub columns: Option<Columns>,
    recorded: Option<(PathBuf, Recording)>,
}

impl Inputs {
    /// Files, with the columns of trajectories, if given.
    pub fn files(columns: Option<Columns>) -> Self {
        Self { columns, recorded: None }
    }

    /// Opens a log, as a file or topic.
    ///
    /// # Errors
    /// Those of [`super::open_log`].
    pub fn open(&self, path: &Path) -> Words<Log> {
        match self.topic(path) {
            Some(bytes) => Ok(Replay::new(Box::new(Cursor::new(bytes.to_vec())), path.display().to_string())),
            None => must_not_be_empty(path).and_then(|()| super::open_log(path)),
        }
    }

    /// Reads a trajectory from a file or topic, and reports skipped rows.
    ///
    /// # Errors
    /// If it cannot be read, in words.
    pub fn trajectory(&self, path: &Path) -> Words<Trajectory> {
        let Some(bytes) = self.topic(path) else { return read_trajectory(path, self.columns.as_ref()) };
        let read = csv::parse_topic(bytes, &path.to_string_lossy());
        let (trajectory, counts) = read.map_err(|error| format!("{}: {error}", path.display()))?;
        say_trajectory(path, &trajectory, &counts);
        Ok(trajectory)
    }

    /// True for a topic of the recording.
    pub fn is_topic(&self, path: &Path) -> bool {
        self.topic(path).is_some()
    }
}

impl BagArgs {
    /// The named files; with a recording, its topics, named or found.
    ///
    /// # Errors
    /// In words: if the recording cannot be read, or an input is missing or ambiguous.
    pub fn resolve(
        &self,
        rx: Option<PathBuf>,
        tx: Vec<PathBuf>,
        trajectory: Option<PathBuf>,
        columns: Option<&Columns>,
    ) -> Words<(Inputs, Named)> {
        let mut inputs = Inputs::files(columns.cloned());
        let Some(bag) = &self.bag else {
            let (Some(rx), Some(trajectory)) = (rx, trajectory) else {
                super::usage("a recorded capture is needed: --rx, --tx and --trajectory, or --bag");
            };
            return Ok((inputs, Named { rx, tx, trajectory }));
        };
        inputs.recorded = Some((bag.clone(), Recording::read(bag).in_words()?));
        inputs.say();
        let named = inputs.choose(rx, tx, trajectory)?;
        Ok((inputs, named))
    }
}

/// The error if addresses or trajectories are given for transmitters that were found, not named.
pub fn order_unknown(found: &[PathBuf]) -> String {
    let found: Vec<String> = found.iter().map(|topic| topic.display().to_string()).collect();
    format!("--tx-mac and --tx-trajectory are in the order of --tx: it names which of {}", found.join(", "))
}

impl Inputs {
    fn topic(&self, path: &Path) -> Option<&[u8]> {
        let (_, recording) = self.recorded.as_ref()?;
        recording.topics.iter().find(|one| Path::new(&one.topic) == path).map(|one| one.bytes.as_slice())
    }

    /// True if parts of the recording are lost.
    pub fn lost(&self) -> bool {
        self.recorded.as_ref().is_some_and(|(_, recording)| is_partial(recording))
    }

    /// The recording.
    pub fn bag(&self) -> Option<&Path> {
        self.recorded.as_ref().map(|(bag, _)| bag.as_path())
    }

    /// Reports damage of the recording on standard error.
    fn say(&self) {
        let Some((bag, recording)) = &self.recorded else { return };
        say_lost(bag, recording);
    }

    fn choose(&self, rx: Option<PathBuf>, tx: Vec<PathBuf>, trajectory: Option<PathBuf>) -> Words<Named> {
        for named in rx.iter().chain(&tx) {
            self.must_be(named, Content::Csi)?;
        }
        trajectory.as_deref().map_or(Ok(()), |named| self.must_be(named, Content::Poses))?;
        let rx = match rx {
            Some(rx) => rx,
            None => self.only(Content::Csi, &tx, "--rx names that of the robot that moved")?,
        };
        let tx = if tx.is_empty() { self.topics(Content::Csi).filter(|topic| *topic != rx).collect() } else { tx };
        if tx.is_empty() {
            return Err(format!(
                "{} has one topic of CSI only, {}: --tx names the log of the other robot",
                self.name(),
                rx.display()
            ));
        }
        let trajectory = match trajectory {
            Some(trajectory) => trajectory,
            None => self.only(Content::Poses, &[], "--trajectory names that of the robot that moved")?,
        };
        Ok(Named { rx, tx, trajectory })
    }

    fn name(&self) -> String {
        self.bag().map(|bag| bag.display().to_string()).unwrap_or_default()
    }

    fn topics(&self, content: Content) -> impl Iterator<Item = PathBuf> {
        let all = self.recorded.iter().flat_map(move |(_, recording)| recording.having(content));
        all.map(|one| PathBuf::from(&one.topic))
    }

    /// The topics as words: `/a, /b`.
    fn list(&self, content: Content) -> String {
        let all: Vec<String> = self.topics(content).map(|topic| topic.display().to_string()).collect();
        if all.is_empty() { "none".into() } else { all.join(", ") }
    }

    /// The only topic of its kind that is not among `taken`.
    fn only(&self, content: Content, taken: &[PathBuf], hint: &str) -> Words<PathBuf> {
        let mut left = self.topics(content).filter(|topic| !taken.contains(topic));
        match (left.next(), left.next()) {
            (Some(topic), None) => Ok(topic),
            (None, _) => Err(format!("{} has no {}: {hint}", self.name(), kind(content))),
            (Some(_), Some(_)) => {
                Err(format!("{} has several topics of {} ({}): {hint}", self.name(), what(content), self.list(content)))
            }
        }
    }

    /// Checks that a name is a topic of the right kind, or a file.
    fn must_be(&self, named: &Path, content: Content) -> Words<()> {
        if named.as_os_str() == "-" || self.topics(content).any(|topic| topic == named) {
            return Ok(());
        }
        if self.is_topic(named) || !named.exists() {
            let (named, bag) = (named.display(), self.name());
            return Err(format!(
                "{named} is neither a file nor a topic of {} in {bag}, which has {}",
                what(content),
                self.list(content)
            ));
        }
        Ok(())
    }
}

/// True if parts of a recording are unreadable.
fn is_partial(recording: &Recording) -> bool {
    recording.damaged_parts + recording.without_topic > 0 || recording.topics.iter().any(|one| one.unreadable > 0)
}

/// Reports missing ends and unreadable parts of a recording on standard error; true if parts are unreadable.
pub fn say_lost(bag: &Path, recording: &Recording) -> bool {
    for file in &recording.cut {
        note!("{}: the end is missing; everything before it was read", file.display());
    }
    if recording.damaged_parts > 0 {
        let parts = super::some(recording.damaged_parts, "part is", "parts are");
        note!("{}: {parts} damaged and skipped (chunks, pages, rows)", bag.display());
    }
    if recording.without_topic > 0 {
        let messages = super::some(recording.without_topic, "message is", "messages are");
        note!("{}: {messages} of unknown topics: their description is damaged", bag.display());
    }
    for one in recording.topics.iter().filter(|one| one.unreadable > 0) {
        let messages = super::some(one.unreadable, "message is", "messages are");
        let needs = if one.content == Content::Poses { " (poses need a stamp)" } else { "" };
        note!("{}: {messages} unreadable and skipped{needs}", one.topic);
    }
    is_partial(recording)
}

fn what(content: Content) -> &'static str {
    if content == Content::Csi { "CSI" } else { "poses" }
}

fn kind(content: Content) -> &'static str {
    if content == Content::Csi {
        "CSI (csi5300_msgs/msg/Csi)"
    } else {
        "poses (nav_msgs/msg/Odometry, geometry_msgs/msg/PoseStamped)"
    }
}

/// Of files in both formats a name for each picture.
pub fn first_of_each(written: &[PathBuf]) -> impl Iterator<Item = &PathBuf> {
    let first = written.first().and_then(|path| path.extension());
    written.iter().filter(move |path| path.extension() == first)
}

/// Names of logs or links, those that give the same file name more than once with their place among all behind them.
pub fn told_apart(stems: Vec<String>) -> Vec<String> {
    let files: Vec<String> = stems.iter().map(|name| file_safe(name)).collect();
    let is_shared = |name: &str| files.iter().filter(|other| **other == file_safe(name)).count() > 1;
    let apart = |(k, name): (usize, &String)| if is_shared(name) { format!("{name}.{}", k + 1) } else { name.clone() };
    stems.iter().enumerate().map(apart).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_one_file_name_are_told_apart() {
        let names = ["a:b", "a_b", "c", "a:b"].map(String::from).to_vec();
        assert_eq!(told_apart(names), ["a:b.1", "a_b.2", "c", "a:b.4"]);
    }

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
        let error = read_trajectory(&folder.join("log.csv"), None).err().unwrap();
        assert!(error.contains("is a log of CSI: a trajectory is"), "{error}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
