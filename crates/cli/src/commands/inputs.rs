//! Where logs and trajectories come from: files, or with `--bag` the topics of a recording, which is read into memory.

use super::Words;
use super::files::{Log, read_trajectory_as, say_trajectory};
use csi5300::motion::odometry::csv::{self, Columns};
use csi5300::motion::pose::Trajectory;
use csi5300::source::replay::Replay;
use csi5300_bag::unbag::{Content, Recording};
use std::io::Cursor;
use std::path::{Path, PathBuf};

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
            None => super::files::must_not_be_empty(path).and_then(|()| super::open_log(path)),
        }
    }

    /// Reads a trajectory from a file or topic, and reports skipped rows.
    ///
    /// # Errors
    /// If it cannot be read, in words.
    pub fn trajectory(&self, path: &Path) -> Words<Trajectory> {
        let Some(bytes) = self.topic(path) else { return read_trajectory_as(path, self.columns.as_ref()) };
        let (trajectory, counts) = csv::parse(bytes).map_err(|error| format!("{}: {error}", path.display()))?;
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
        if let Some(bag) = &self.bag {
            let (inputs, named) = Inputs::of(bag, rx, tx, trajectory)?;
            return Ok((Inputs { columns: columns.cloned(), ..inputs }, named));
        }
        let (Some(rx), Some(trajectory)) = (rx, trajectory) else {
            return Err("--rx and --trajectory are needed".into());
        };
        let inputs = Inputs::files(columns.cloned());
        Ok((inputs, Named { rx, tx, trajectory }))
    }
}

/// The error if addresses or trajectories are given for transmitters that were found, not named.
pub fn order_unknown(found: &[PathBuf]) -> String {
    let found: Vec<String> = found.iter().map(|topic| topic.display().to_string()).collect();
    format!("--tx-mac and --tx-trajectory are in the order of --tx: it names which of {}", found.join(", "))
}

impl Inputs {
    /// Reads a recording, and finds the topics that were not named.
    fn of(bag: &Path, rx: Option<PathBuf>, tx: Vec<PathBuf>, trajectory: Option<PathBuf>) -> Words<(Self, Named)> {
        let recording = Recording::read(bag).map_err(|error| error.to_string())?;
        let inputs = Self { recorded: Some((bag.to_path_buf(), recording)), columns: None };
        inputs.say();
        let named = inputs.choose(rx, tx, trajectory)?;
        Ok((inputs, named))
    }

    fn topic(&self, path: &Path) -> Option<&[u8]> {
        let (_, recording) = self.recorded.as_ref()?;
        recording.topics.iter().find(|one| Path::new(&one.topic) == path).map(|one| one.bytes.as_slice())
    }

    /// True if parts of the recording are lost.
    pub fn lost(&self) -> bool {
        self.recorded.as_ref().is_some_and(|(_, recording)| {
            recording.damaged_parts + recording.without_topic > 0
                || recording.topics.iter().any(|one| one.unreadable > 0)
        })
    }

    /// The recording.
    pub fn bag(&self) -> Option<&Path> {
        self.recorded.as_ref().map(|(bag, _)| bag.as_path())
    }

    /// Reports damage of the recording on standard error.
    fn say(&self) {
        let Some((bag, recording)) = &self.recorded else { return };
        for file in &recording.cut {
            note!("{}: the end is missing; everything before it was read", file.display());
        }
        for words in lost_words(recording.damaged_parts, recording.without_topic) {
            note!("{}: {words}", bag.display());
        }
        for one in recording.topics.iter().filter(|one| one.unreadable > 0) {
            let messages = super::some(one.unreadable, "message is", "messages are");
            note!("{}: {messages} unreadable and skipped", one.topic);
        }
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

/// The unreadable parts of a recording, in words.
pub fn lost_words(damaged_parts: u64, without_topic: u64) -> impl Iterator<Item = String> {
    let parts = super::some(damaged_parts, "part is", "parts are");
    let parts = format!("{parts} damaged and skipped (chunks, pages, rows)");
    let messages = super::some(without_topic, "message is", "messages are");
    let messages = format!("{messages} of unknown topics: their description is damaged");
    [(damaged_parts, parts), (without_topic, messages)]
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(_, words)| words)
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
