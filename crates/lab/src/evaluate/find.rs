//! Captures below a folder: their logs, and which of their trajectories is read.

use super::roles::{self, Sorted};
use csi5300::internal::heading;
use csi5300::motion::rolling::Mount;
use std::collections::BTreeSet;
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
    /// Tracking camera, of whose steps only those that wheels can roll are kept ([`Capture::camera`]).
    RollingT265,
    /// Wheel odometry.
    Odometry,
}

impl TrajectorySource {
    /// Standard deviation of the heading of its trajectories, radians: what error bars and probabilities have to know of
    /// the sensor. Of wheels and of what rolls it is that of trajectories of the antenna ([`Capture::antenna_offset_m`]).
    #[must_use]
    pub fn heading_sd_rad(self) -> f64 {
        match self {
            Self::GroundTruth => heading::MOTION_CAPTURE_RAD,
            Self::T265 => heading::CAMERA_RAD,
            Self::RollingT265 => heading::ROLLING_CAMERA_RAD,
            Self::Odometry => heading::WHEELS_RAD,
        }
    }

    /// How the names of its files begin, before the robot's.
    pub(super) fn prefix(self) -> &'static str {
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

/// The receiver's files of a capture whose names say nothing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Loose {
    /// Its log.
    pub log: PathBuf,
    /// Its trajectory.
    pub trajectory: PathBuf,
}

/// One run: the logs and trajectories of one time stamp.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// Folder below the evaluated one, with forward slashes.
    pub place: String,
    /// Time stamp in the file names.
    pub stamp: String,
    /// The folder.
    pub folder: PathBuf,
    /// The receiver's log and trajectory, where their names are others than the usual ones.
    pub loose: Option<Box<Loose>>,
    /// Transmitters: name (`tx2`) and log.
    pub transmitters: Vec<(String, PathBuf)>,
    /// Where the receiver's antenna is on its robot, seen from what the tracking camera's or the wheels' trajectory is of:
    /// metres forward, left, up; none where it is not known, and those trajectories are taken as the antenna's. Motion
    /// capture is of the antenna itself.
    pub antenna_offset_m: Option<[f64; 3]>,
    /// Where the tracking camera is on the robot. Its trajectory rolls about the middle between the wheels then, which is where
    /// the antenna is seen from; none where it is not known.
    pub camera: Option<Mount>,
}

impl Capture {
    /// Name of a link of this capture, or of the capture where `transmitter` is empty.
    #[must_use]
    pub fn link_name(&self, transmitter: &str) -> String {
        let parts = [self.place.as_str(), self.stamp.as_str(), transmitter];
        parts.iter().filter(|part| !part.is_empty()).copied().collect::<Vec<_>>().join("/")
    }

    /// Standard deviation of the heading of its trajectory by `source`, radians. Wheels whose antenna may be anywhere on the
    /// robot turn the bearing by as much as the antenna's path differs from theirs.
    #[must_use]
    pub fn heading_sd_rad(&self, source: TrajectorySource) -> f64 {
        match source {
            TrajectorySource::Odometry if self.antenna_offset_m.is_none() => heading::UNMOUNTED_RAD,
            _ => source.heading_sd_rad(),
        }
    }

    /// True if a file beside its logs says where the transmitters are.
    #[must_use]
    pub fn has_truth(&self) -> bool {
        self.folder.join(TRUTH_FILE).is_file()
    }

    /// The file with the trajectory of `robot`: `rx`, or a transmitter's name. Motion capture may have the name that
    /// \[paper\] (docs/reference/references.md) gives it.
    pub(super) fn trajectory_of(&self, source: TrajectorySource, robot: &str) -> PathBuf {
        if let (Some(loose), "rx") = (&self.loose, robot) {
            return loose.trajectory.clone();
        }
        let usual = self.folder.join(format!("{}{robot}_trajectory_{}_.csv", source.prefix(), self.stamp));
        let paper = self.folder.join(format!("{robot}_movement_{}.csv", self.stamp));
        let is_paper = source == TrajectorySource::GroundTruth && !usual.is_file() && paper.is_file();
        if is_paper { paper } else { usual }
    }

    /// True for logs of a receiver and a transmitter with a trajectory: enough for a bearing.
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

/// Finds the captures with a truth below `root`, in the order of their names, and folders that could not be read.
#[must_use]
pub fn find(root: &Path) -> (Vec<Capture>, Vec<String>) {
    let (captures, unreadable) = find_all(root);
    (captures.into_iter().filter(Capture::has_truth).collect(), unreadable)
}

/// The same with captures without a truth: logs of a receiver and its transmitters with a trajectory. Without usual
/// names, the files of `root` itself are one capture if their content identifies the receiver's log and trajectory.
#[must_use]
pub fn find_all(root: &Path) -> (Vec<Capture>, Vec<String>) {
    let (mut captures, unreadable) = named(root);
    if captures.is_empty() {
        captures.extend(loose(root));
    }
    (captures, unreadable)
}

fn loose(root: &Path) -> Option<Capture> {
    let Sorted { logs, trajectories, .. } = Sorted::new(roles::files_with_logs(root)?, None);
    let trajectory = roles::the_trajectory(&trajectories).ok()?;
    let receiver = roles::receiver(&logs, &trajectory, true).ok()?;
    let name = |log: &PathBuf| log.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let transmitters = logs.iter().filter(|log| **log != receiver).map(|log| (name(log), log.clone())).collect();
    Some(Capture {
        place: String::new(),
        stamp: String::new(),
        folder: root.into(),
        loose: Some(Box::new(Loose { log: receiver, trajectory })),
        transmitters,
        antenna_offset_m: None,
        camera: None,
    })
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
            // Links are not followed: they may lead in circles.
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
    // A stamp with a transmitter's log only is an unusable capture, and reported as such.
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
            loose: None,
            transmitters,
            antenna_offset_m: None,
            camera: None,
        }
    };
    stamps.iter().map(|stamp| capture(stamp)).collect()
}
