//! What the commands on folders of captures share.

use super::args::Estimation;
use super::mounting::Mounting;
use super::usage;
use csi5300::motion::pose::Mount;
use csi5300::pipeline::Options;
use csi5300::signal::channel::{Channel, Width};
use csi5300_lab::evaluate::{Capture, TrajectorySource, find_all};
use std::path::Path;

/// What a capture is, for who named a folder without one.
pub const A_CAPTURE: &str = "a capture is a folder with csi_rx_TS.dat, csi_txK_TS.dat, a trajectory (rx_trajectory_TS_.csv) and, \
                             for the truth and the channel, groundtruth_positions.json";

/// How captures are read.
pub struct Reading {
    /// Which trajectory to use.
    pub trajectory: Which,
    /// Where antenna and camera are on the robot.
    pub mounting: Mounting,
    /// WiFi channel instead of the one in groundtruth_positions.json.
    pub channel: Option<Channel>,
    /// How bearings are made.
    pub estimation: Estimation,
}

/// Line ends in folder names are printed as escapes.
pub fn add_names(captures: &[Capture], unreadable: &[String]) {
    let places = captures.iter().map(|capture| &capture.place);
    csi5300_say::add_names(places.chain(unreadable).map(Into::into));
}

impl Reading {
    /// The trajectory to use.
    pub fn source(&self) -> TrajectorySource {
        match (self.trajectory, self.mounting.camera_mount) {
            (Which::T265, Some(_)) => TrajectorySource::RollingT265,
            (_, Some(_)) => usage("--camera-mount is of the tracking camera: --trajectory t265"),
            (Which::Gt, None) if self.mounting.antenna_offset.is_some() => usage(
                "--antenna-offset is for wheels and cameras (--trajectory odom, t265): motion capture tracks the antenna itself",
            ),
            (Which::Gt, None) => TrajectorySource::GroundTruth,
            (Which::T265, None) => TrajectorySource::T265,
            (Which::Odom, None) => TrajectorySource::Odometry,
        }
    }

    /// The captures in and below `folder`, with a truth or without, and folders that could not be read.
    ///
    /// # Errors
    /// If there is none, or none with a channel, in words.
    pub fn find(&self, folder: &Path) -> Result<(Vec<Capture>, Vec<String>), String> {
        let (captures, unreadable) = find_all(folder);
        add_names(&captures, &unreadable);
        if captures.is_empty() {
            if folder.is_file() {
                return Err(format!(
                    "{} is a file: name the folder of the capture, or all of its files",
                    folder.display()
                ));
            }
            let name = folder.display();
            return Err(if folder.is_dir() {
                format!("no capture in or below {name}: {A_CAPTURE}")
            } else {
                format!("{name}: no such file or folder; {A_CAPTURE}")
            });
        }
        let captures = self.mounted(captures);
        detail!("{} in or below {}", super::some(captures.len() as u64, "capture", "captures"), folder.display());
        if self.channel.is_none() && captures.iter().all(|capture| !capture.has_truth()) {
            usage(
                "--channel is needed, such as --channel 108: no groundtruth_positions.json of these captures names it",
            );
        }
        Ok((captures, unreadable))
    }

    /// The given place of the antenna, metres forward, left, up.
    pub fn antenna_offset_m(&self) -> Option<[f64; 3]> {
        self.mounting.antenna_offset.map(Into::into)
    }

    /// The given mount of the tracking camera.
    pub fn camera(&self) -> Option<Mount> {
        self.mounting.camera_mount
    }

    /// Captures with the given places of antenna and camera.
    pub fn mounted(&self, mut captures: Vec<Capture>) -> Vec<Capture> {
        let (antenna_offset_m, camera) = (self.antenna_offset_m(), self.camera());
        for capture in &mut captures {
            (capture.antenna_offset_m, capture.camera) = (antenna_offset_m, camera);
        }
        captures
    }

    /// The pipeline's options. Their channel is a stand-in where none was given: each capture brings its own.
    pub fn options(&self) -> Result<Options, String> {
        let fallback = Channel::new(108, Width::Ht20).map_err(|error| error.to_string())?;
        self.estimation.options(self.channel.unwrap_or(fallback))
    }
}

/// A trajectory file of a capture.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum Which {
    /// Motion capture
    Gt,
    /// Tracking camera
    T265,
    /// Wheel odometry
    Odom,
}
