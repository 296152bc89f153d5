//! Captures: found below a folder, by the names or the content of their files; their truth; their files read once.

use crate::Failure;
use crate::kinds::has_record;
use csi5300::Log;
use csi5300::internal::heading;
use csi5300::motion::odometry::csv::{self, Columns};
use csi5300::motion::pose::Mount;
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::survey::Survey;
use nalgebra::Vector2;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// The file that makes a folder a capture.
pub const TRUTH_FILE: &str = "groundtruth_positions.json";

/// Which trajectory of a capture is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TrajectorySource {
    /// Motion capture.
    #[default]
    GroundTruth,
    /// Tracking camera.
    T265,
    /// Tracking camera, reduced to the steps that wheels can roll ([`Capture::camera`]).
    RollingT265,
    /// Wheel odometry.
    Odometry,
}

impl TrajectorySource {
    /// Standard deviation of the heading of its trajectories, radians, for error bars and probabilities. For wheels and rolling
    /// motion it applies to trajectories of the antenna ([`Capture::antenna_offset_m`]).
    #[must_use]
    pub fn heading_sd_rad(self) -> f64 {
        match self {
            Self::GroundTruth => heading::MOTION_CAPTURE_RAD,
            Self::T265 => heading::CAMERA_RAD,
            Self::RollingT265 => heading::ROLLING_CAMERA_RAD,
            Self::Odometry => heading::WHEELS_RAD,
        }
    }

    /// Prefix of its file names, before the robot's name.
    fn prefix(self) -> &'static str {
        match self {
            Self::GroundTruth => "",
            Self::T265 | Self::RollingT265 => "t265_",
            Self::Odometry => "odom_",
        }
    }
}

impl std::fmt::Display for TrajectorySource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::GroundTruth => "motion capture",
            Self::T265 => "tracking camera",
            Self::RollingT265 => "rolling camera",
            Self::Odometry => "wheel odometry",
        })
    }
}

/// The receiver's files of a capture whose file names do not show roles.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Loose {
    /// Its log.
    pub log: PathBuf,
    /// Its trajectory.
    pub trajectory: PathBuf,
}

/// One run: the logs and trajectories of one time stamp.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Capture {
    /// Folder below the evaluated one, with forward slashes.
    pub place: String,
    /// Time stamp in the file names.
    pub stamp: String,
    /// The folder.
    pub folder: PathBuf,
    /// The receiver's log and trajectory, if their names are not the usual ones.
    pub loose: Option<Box<Loose>>,
    /// Transmitters: name (`tx2`) and log.
    pub transmitters: Vec<(String, PathBuf)>,
    /// Places of transmitters by name, metres, in the frame of motion capture, or without it of the trajectory that is used; they
    /// replace those of the truth.
    pub told: BTreeMap<String, [f64; 2]>,
    /// The receiver's antenna relative to the point that the tracking camera or the wheels track: metres forward, left, up. If
    /// `None`, those trajectories are taken as the antenna's. Motion capture tracks the antenna itself.
    pub antenna_offset_m: Option<[f64; 3]>,
    /// Position of the tracking camera on the robot. If given, its trajectory rolls about the middle between the wheels, and the
    /// antenna's position is relative to that point. `None` if unknown.
    pub camera: Option<Mount>,
    /// Only this part of the motion, seconds on the trajectory's clock: bearings are compared from the mean pose in it.
    pub within_s: Option<(f64, f64)>,
}

impl Capture {
    /// Name of a link of this capture, or of the capture if `transmitter` is empty.
    #[must_use]
    pub fn link_name(&self, transmitter: &str) -> String {
        let parts = [self.place.as_str(), self.stamp.as_str(), transmitter];
        parts.iter().filter(|part| !part.is_empty()).copied().collect::<Vec<_>>().join("/")
    }

    /// Adds it to `captures`, and returns its index. A run that is there already is not added: named again, whichever path
    /// leads to its folder, it is still one measurement. Other runs of the same name get more of their folders' names, until
    /// all names differ.
    pub fn add_to(self, captures: &mut Vec<Self>) -> usize {
        let is_this = |other: &Self| self.stamp == other.stamp && self.whole_folder() == other.whole_folder();
        if let Some(known) = captures.iter().position(is_this) {
            return known;
        }
        captures.push(self);
        let new = captures.len() - 1;
        loop {
            let name = captures[new].link_name("");
            let same: Vec<usize> = (0..=new).filter(|k| captures[*k].link_name("") == name).collect();
            let longer = |k: &usize| Some((*k, captures[*k].longer_place()?));
            let places: Vec<(usize, String)> = same.iter().filter_map(longer).collect();
            if same.len() < 2 || places.is_empty() {
                return new;
            }
            places.into_iter().for_each(|(k, place)| captures[k].place = place);
        }
    }

    fn whole_folder(&self) -> PathBuf {
        self.folder.canonicalize().unwrap_or_else(|_| self.folder.clone())
    }

    /// Its place with one more folder above; none if there is no more.
    fn longer_place(&self) -> Option<String> {
        let folder = self.whole_folder();
        let names: Vec<_> = folder.iter().skip(1).map(|name| name.to_string_lossy()).collect();
        let parts = self.place.split('/').filter(|part| !part.is_empty()).count();
        Some(names.get(names.len().checked_sub(parts + 1)?..)?.join("/"))
    }

    /// Standard deviation of the heading of its trajectory by `source`, radians. For wheels with an unknown antenna position, the
    /// bearing rotates by as much as the antenna's path differs from theirs.
    #[must_use]
    pub fn heading_sd_rad(&self, source: TrajectorySource) -> f64 {
        match source {
            TrajectorySource::Odometry if self.antenna_offset_m.is_none() => heading::UNMOUNTED_RAD,
            _ => source.heading_sd_rad(),
        }
    }

    /// True if a file beside its logs gives the transmitters' places.
    #[must_use]
    pub fn has_truth(&self) -> bool {
        self.folder.join(TRUTH_FILE).is_file()
    }

    /// The trajectory file of `robot`: `rx`, or a transmitter's name. Motion capture may have the file name used by \[paper\]
    /// (docs/reference/references.md).
    pub(super) fn trajectory_of(&self, source: TrajectorySource, robot: &str) -> PathBuf {
        if let (Some(loose), "rx") = (&self.loose, robot) {
            return loose.trajectory.clone();
        }
        let usual = self.folder.join(format!("{}{robot}_trajectory_{}_.csv", source.prefix(), self.stamp));
        let paper = self.folder.join(format!("{robot}_movement_{}.csv", self.stamp));
        let is_paper = source == TrajectorySource::GroundTruth && !usual.is_file() && paper.is_file();
        if is_paper { paper } else { usual }
    }

    /// True if there are logs of a receiver and a transmitter, and a trajectory: enough for a bearing.
    fn is_whole(&self) -> bool {
        let sources = [TrajectorySource::GroundTruth, TrajectorySource::T265, TrajectorySource::Odometry];
        let has_trajectory = || sources.iter().any(|source| self.trajectory_of(*source, "rx").is_file());
        !self.transmitters.is_empty() && self.receiver_log().is_file() && has_trajectory()
    }

    /// The receiver's log.
    #[must_use]
    pub fn receiver_log(&self) -> PathBuf {
        if let Some(loose) = &self.loose {
            return loose.log.clone();
        }
        self.folder.join(format!("csi_rx_{}.dat", self.stamp))
    }
}

/// Finds the captures with a truth below `root`, in order of name, and the unreadable folders.
#[must_use]
pub fn find(root: &Path) -> (Vec<Capture>, Vec<String>) {
    let (captures, unreadable) = find_all(root);
    (captures.into_iter().filter(Capture::has_truth).collect(), unreadable)
}

/// The same, including captures without a truth: logs of a receiver and its transmitters, with a trajectory. Without usual
/// names, the files of `root` itself are one capture if their content shows the receiver's log and trajectory.
#[must_use]
pub fn find_all(root: &Path) -> (Vec<Capture>, Vec<String>) {
    let (mut captures, unreadable) = named(root);
    if captures.is_empty() {
        captures.extend(loose(root));
    }
    (captures, unreadable)
}

fn loose(root: &Path) -> Option<Capture> {
    let Sorted { logs, trajectories, .. } = Sorted::new(files_with_logs(root)?, None);
    let trajectory = the_trajectory(&trajectories).ok()?;
    let receiver = receiver(&logs, &trajectory, true).ok()?;
    let name = |log: &PathBuf| log.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let transmitters = logs.iter().filter(|log| **log != receiver).map(|log| (name(log), log.clone())).collect();
    let loose = Some(Box::new(Loose { log: receiver, trajectory }));
    Some(Capture { folder: root.into(), loose, transmitters, ..Capture::default() })
}

/// The captures with the usual names.
pub(super) fn named(root: &Path) -> (Vec<Capture>, Vec<String>) {
    let (mut captures, mut unreadable) = (Vec::new(), Vec::new());
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        let entries = match std::fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(error) => {
                unreadable.push(format!("{}: {error}", folder.display()));
                continue;
            }
        };
        let mut names = Vec::new();
        for entry in entries.flatten() {
            // Symbolic links are not followed: they may form loops.
            match entry.file_type() {
                Ok(kind) if kind.is_dir() => folders.push(entry.path()),
                _ => names.extend(entry.file_name().into_string().ok()),
            }
        }
        let has_truth = names.iter().any(|name| name == TRUTH_FILE);
        captures.extend(captures_in(root, &folder, &names).into_iter().filter(|own| has_truth || own.is_whole()));
    }
    captures.sort_by(|a, b| (&a.place, &a.stamp).cmp(&(&b.place, &b.stamp)));
    unreadable.sort();
    (captures, unreadable)
}

fn captures_in(root: &Path, folder: &Path, names: &[String]) -> Vec<Capture> {
    let below = folder.strip_prefix(root).unwrap_or(folder);
    let place: Vec<_> = below.components().map(|part| part.as_os_str().to_string_lossy().into_owned()).collect();
    // A stamp with only a transmitter's log is reported as an unusable capture.
    let stamp_of = |name: &'_ String| -> Option<String> {
        let name = name.strip_suffix(".dat")?;
        let of_tx = || name.strip_prefix("csi_tx")?.trim_start_matches(|c: char| c.is_ascii_digit()).strip_prefix('_');
        name.strip_prefix("csi_rx_").or_else(of_tx).map(str::to_owned)
    };
    let stamps: BTreeSet<String> = names.iter().filter_map(stamp_of).collect();
    let capture = |stamp: &str| {
        let transmitter = |name: &String| {
            let k = name.strip_prefix("csi_tx")?.strip_suffix(".dat")?.strip_suffix(stamp)?.strip_suffix('_')?;
            k.bytes().all(|b| b.is_ascii_digit()).then(|| (format!("tx{k}"), folder.join(name)))
        };
        let mut transmitters: Vec<_> = names.iter().filter_map(transmitter).collect();
        transmitters.sort();
        Capture {
            place: place.join("/"),
            stamp: stamp.into(),
            folder: folder.into(),
            transmitters,
            ..Capture::default()
        }
    };
    stamps.iter().map(|stamp| capture(stamp)).collect()
}

/// A folder with more files is not a capture.
const MOST: usize = 64;

/// The files of a folder that is one capture by content; `None` if a capture in or below it has the usual names, or if it has
/// no log.
#[must_use]
pub fn loose_files(folder: &Path) -> Option<Vec<PathBuf>> {
    named(folder).0.is_empty().then(|| files_with_logs(folder)).flatten()
}

/// The files of a folder; `None` if none is a log, or if there are too many.
fn files_with_logs(folder: &Path) -> Option<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> = entries.filter(|path| path.is_file()).take(MOST + 1).collect();
    if files.len() > MOST {
        return None;
    }
    files.sort();
    files.iter().any(|file| has_record(file)).then_some(files)
}

/// Logs, trajectories, and other files.
#[derive(Clone, Debug, Default)]
pub struct Sorted {
    /// Logs of CSI.
    pub logs: Vec<PathBuf>,
    /// Trajectories.
    pub trajectories: Vec<PathBuf>,
    /// Other files.
    pub others: Vec<PathBuf>,
}

impl Sorted {
    /// Sorts files by their content; `columns` are those of the trajectories, if known.
    #[must_use]
    pub fn new(files: Vec<PathBuf>, columns: Option<&Columns>) -> Self {
        let mut sorted = Self::default();
        for file in files {
            if has_record(&file) {
                sorted.logs.push(file);
            } else if csv::read(&file, columns).is_ok() {
                sorted.trajectories.push(file);
            } else {
                sorted.others.push(file);
            }
        }
        sorted
    }
}

/// The only trajectory.
///
/// # Errors
/// If there is none or more than one; the text names the options that settle it.
pub fn the_trajectory(files: &[PathBuf]) -> Result<PathBuf, String> {
    match files {
        [file] => Ok(file.clone()),
        [] => Err("none of these files is a trajectory: add the receiver's with --trajectory T.csv".into()),
        [first, ..] => {
            let names: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
            let first = first.display();
            Err(format!(
                "each of {} could be the receiver's trajectory: add --trajectory {first}, or another one",
                names.join(", ")
            ))
        }
    }
}

/// The log of the robot whose trajectory is given: the one named so, else the only one that heard several robots, else the only
/// one whose host times lie within the trajectory.
///
/// # Errors
/// If the roles are ambiguous; the text names the commands that settle it.
pub fn receiver(logs: &[PathBuf], trajectory: &Path, needs_two: bool) -> Result<PathBuf, String> {
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
    let surveys: Vec<(&PathBuf, Survey)> = logs.iter().filter_map(|log| Some((log, survey(log)?))).collect();
    if let Some((log, _)) = exactly_one(surveys.iter().filter(|(_, survey)| robots(survey) > 1)) {
        return Ok((*log).clone());
    }
    if let Ok((poses, _)) = csv::read(trajectory, None)
        && let Some((from, to)) = poses.poses().first().zip(poses.poses().last())
    {
        let overlaps = |(a, b): (i64, i64)| (a as f64 * 1e-6) < to.t_s && b as f64 * 1e-6 > from.t_s;
        if let Some((log, _)) = exactly_one(surveys.iter().filter(|(_, survey)| survey.host_us.is_some_and(overlaps))) {
            return Ok((*log).clone());
        }
    }
    let (a, b) = (logs[0].display(), logs[1].display());
    let t = trajectory.display();
    Err(format!(
        "which log is of the robot that drove {t}? Name it: --rx {a} --tx {b} --trajectory {t}, or --rx {b} --tx {a} --trajectory {t}"
    ))
}

fn survey(path: &Path) -> Option<Survey> {
    let mut log = Log::open(path).ok()?;
    while log.next().is_some_and(|frame| frame.is_ok()) {}
    Some(log.survey().clone())
}

/// Senders of a log. One with few records passed by and is not a robot of the capture.
fn robots(survey: &Survey) -> usize {
    let most = survey.senders.values().map(|sender| sender.records).max().unwrap_or(0);
    survey.senders.values().filter(|sender| 10 * sender.records > most).count()
}

/// The only item, if there is one.
fn exactly_one<T>(mut all: impl Iterator<Item = T>) -> Option<T> {
    let first = all.next()?;
    all.next().is_none().then_some(first)
}

/// Largest truth file, bytes: a line for each of ten thousand transmitters.
const LONGEST: u64 = 1 << 20;
/// Largest distance of a transmitter from the origin, metres.
const FURTHEST_M: f64 = 1e6;

#[derive(Default, Deserialize)]
pub(super) struct Truth {
    channel: Option<Value<Named>>,
    true_tx_positions: Option<Value<BTreeMap<String, TruePose>>>,
}

#[derive(Deserialize)]
struct Value<T> {
    value: T,
}

/// A channel by its number, above 20 MHz its centre's, or as `--channel` takes it.
#[derive(Deserialize)]
#[serde(untagged, expecting = "expected a channel: 108, \"36+\" or \"5290MHz\"")]
enum Named {
    Number(u32),
    Words(String),
}

#[derive(Deserialize)]
struct TruePose {
    position: Xy,
}

#[derive(Clone, Copy, Deserialize)]
struct Xy {
    x: f64,
    y: f64,
}

/// A file with what is wrong with it.
fn invalid(path: &Path, why: &dyn std::fmt::Display) -> Failure {
    format!("{}: {why}", path.display()).into()
}

/// The whole file; one longer than [`LONGEST`] is not read to its end.
fn read(path: &Path) -> Result<Vec<u8>, Failure> {
    let io = |source: std::io::Error| invalid(path, &source);
    let file = File::open(path).map_err(io)?;
    let (size, mut text) = (file.metadata().map_err(io)?.len(), Vec::new());
    let got = file.take(LONGEST + 1).read_to_end(&mut text).map_err(io)? as u64;
    // A pipe has no size.
    match got > LONGEST {
        true => Err(invalid(path, &format_args!("{} bytes; a truth file has at most {LONGEST}", size.max(got)))),
        false => Ok(text),
    }
}

/// The channel in the truth file of a folder, if it has one that names a channel.
///
/// # Errors
/// If the file cannot be read, or if there is no such channel.
pub fn channel_in(folder: &Path) -> Result<Option<Channel>, Failure> {
    if folder.join(TRUTH_FILE).is_file() { Truth::read(folder)?.channel(folder) } else { Ok(None) }
}

impl Truth {
    /// Reads the truth file of the capture in `folder`.
    pub(super) fn read(folder: &Path) -> Result<Self, Failure> {
        let path = folder.join(TRUTH_FILE);
        let text = read(&path)?;
        // The mark that editors on Windows put before UTF-8.
        let json = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&text);
        let truth: Self = serde_json::from_slice(json).map_err(|source| invalid(&path, &source))?;
        match truth.far() {
            Some(transmitter) => {
                Err(invalid(&path, &format_args!("{transmitter} is further than 1e6 m from the origin")))
            }
            None => Ok(truth),
        }
    }

    /// A transmitter beyond the reach of any card.
    fn far(&self) -> Option<&str> {
        let all = self.true_tx_positions.iter().flat_map(|places| &places.value);
        let is_far = |at: &Xy| !(at.x.abs() <= FURTHEST_M && at.y.abs() <= FURTHEST_M);
        all.into_iter().find(|(_, pose)| is_far(&pose.position)).map(|(name, _)| name.as_str())
    }

    /// The channel, if the file, that of `folder`, names one.
    pub(super) fn channel(&self, folder: &Path) -> Result<Option<Channel>, Failure> {
        let channel = self.channel.as_ref().map(|channel| match &channel.value {
            Named::Number(number) => Channel::new(*number, Width::Ht20),
            Named::Words(words) => words.parse(),
        });
        channel.transpose().map_err(|error| invalid(&folder.join(TRUTH_FILE), &error))
    }

    /// The place of a transmitter (`tx2`), metres.
    pub(super) fn place(&self, transmitter: &str) -> Option<Vector2<f64>> {
        let pose = self.true_tx_positions.as_ref()?.value.get(transmitter)?;
        Some(Vector2::new(pose.position.x, pose.position.y))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_invalid_truth_file_is_refused() {
        let folder = &crate::temporary::Temporary::folder("truth").0;
        let read = |text: &str| {
            std::fs::write(folder.join(TRUTH_FILE), text).unwrap();
            Truth::read(folder).map(|truth| truth.place("tx1")).map_err(|error| error.to_string())
        };
        let at = |x: &str| {
            read(&r#"{"true_tx_positions": {"value": {"tx1": {"position": {"x": X, "y": 2}}}}}"#.replace('X', x))
        };
        assert_eq!(at("1e6").unwrap(), Some(Vector2::new(1e6, 2.0)));
        assert!(at("-1.1e6").unwrap_err().contains("tx1 is further"));
        assert!(at("1e308").is_err() && at("1e999").is_err());
        // Its first MiB is a valid truth file by itself.
        let long = |bytes: u64| format!("{{}}{}", " ".repeat(bytes as usize - 2));
        let error = read(&long(LONGEST + 1)).unwrap_err();
        assert!(error.contains("1048577 bytes; a truth file has at most 1048576"), "{error}");
        assert!(read(&long(LONGEST)).is_ok() && read("{}").is_ok() && read("\u{feff}{}").is_ok());
    }

    #[test]
    fn a_truth_file_names_channels_by_number_or_as_the_command_does() {
        let folder = &crate::temporary::Temporary::folder("channel").0;
        let named = |value: &str| {
            std::fs::write(folder.join(TRUTH_FILE), format!(r#"{{"channel": {{"value": {value}}}}}"#)).unwrap();
            channel_in(folder).map(|channel| channel.unwrap().centre_hz() / 1e6).map_err(|error| error.to_string())
        };
        // 110 is the centre of 108+, as of simulated rooms of 40 MHz.
        assert_eq!((named("110"), named(r#""108+""#), named(r#""5550MHz""#)), (Ok(5550.0), Ok(5550.0), Ok(5550.0)));
        assert!(named("5540").unwrap_err().contains("groundtruth_positions.json: `5540` is no channel"));
        assert!(named("[36]").unwrap_err().contains(r#"expected a channel: 108, "36+" or"#));
    }
}
