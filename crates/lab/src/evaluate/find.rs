//! Finds captures below a folder: their logs and trajectories.

use super::roles::{self, Sorted};
use csi5300::internal::heading;
use csi5300::motion::pose::Mount;
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

/// The receiver's files of a capture whose file names do not show roles.
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
    /// The receiver's log and trajectory, if their names are not the usual ones.
    pub loose: Option<Box<Loose>>,
    /// Transmitters: name (`tx2`) and log.
    pub transmitters: Vec<(String, PathBuf)>,
    /// The receiver's antenna relative to the point that the tracking camera or the wheels track: metres forward, left, up. If
    /// `None`, those trajectories are taken as the antenna's. Motion capture tracks the antenna itself.
    pub antenna_offset_m: Option<[f64; 3]>,
    /// Position of the tracking camera on the robot. If given, its trajectory rolls about the middle between the wheels, and the
    /// antenna's position is relative to that point. `None` if unknown.
    pub camera: Option<Mount>,
}

impl Capture {
    /// Name of a link of this capture, or of the capture if `transmitter` is empty.
    #[must_use]
    pub fn link_name(&self, transmitter: &str) -> String {
        let parts = [self.place.as_str(), self.stamp.as_str(), transmitter];
        parts.iter().filter(|part| !part.is_empty()).copied().collect::<Vec<_>>().join("/")
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
            loose: None,
            transmitters,
            antenna_offset_m: None,
            camera: None,
        }
    };
    stamps.iter().map(|stamp| capture(stamp)).collect()
}
