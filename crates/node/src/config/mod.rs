//! The configuration of a robot: one TOML file, checked completely before anything starts.
//!
//! | module | what it is |
//! |---|---|
//! | `capture` | where this robot's records come from |
//! | `robots` | this robot's odometry and its peers |
//! | `array` | two or three antennas of this robot's card |
//! | `estimation` | how bearings are made |
//! | [`sounding`] | this robot's part in the sounding exchange |
//! | [`ros`] | ROS 1: topics of poses, and this program as a node |
//! | [`ros2`] | the same of ROS 2 |
//! | `team` | known places and ranges for the graph of the team |
//! | `outputs` | what is recorded and published, and the network |
//! | `check` | what contradicts itself or this machine, one function a group of rules |
//! | `reading` | the text read with everything in it that is of another kind than it should be |
//! | `problem` | a refusal: the line, and why |

mod array;
mod capture;
mod check;
mod estimation;
mod outputs;
mod problem;
mod reading;
mod robots;
pub mod ros;
pub mod ros2;
pub mod sounding;
mod team;
mod values;

pub use array::Antennas;
pub use capture::{Capture, Card, Feitcsi, Replay, Room, Served, Stock};
pub use estimation::Estimation;
pub use outputs::{Log, Network, Output, StatusLine};
pub use problem::{ConfigError, Problem};
pub use robots::{CameraMount, Csv, Model, NoKeys, Odometry, OpenCr, Peer, Place, Records};
pub use team::{RangeTopic, Team};

use csi5300::pipeline::{Effort, Options};
use csi5300::signal::channel::Channel;
use csi5300_sim::toml_lines::TomlLines;
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use reading::Reading;
use std::io::Read;
use std::path::Path;
use toml::Spanned;
use values::{antenna, antenna_a, channel, exactly, maybe_parsed};

/// Bytes of a configuration that are read: more than any has.
const LONGEST: u64 = 1 << 20;

/// A configuration that was checked. See `packaging/robot.toml` for every key with its meaning.
#[derive(Clone, Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name of this robot; the host's where absent.
    #[serde(default)]
    pub name: Option<String>,
    /// MAC of this robot's card. In a simulated room the scene's.
    #[serde(default, deserialize_with = "maybe_parsed")]
    pub mac: Option<Mac>,
    /// WiFi channel. In a simulated room the scene's.
    #[serde(deserialize_with = "channel")]
    pub channel: Channel,
    /// Antenna used on all robots.
    #[serde(default = "antenna_a", deserialize_with = "antenna")]
    pub antenna: Antenna,
    /// Two or three antennas of this robot's card, which need no peer that answers.
    #[serde(default)]
    pub array: Option<Antennas>,
    /// Where records come from.
    pub capture: Spanned<Capture>,
    /// Where this robot's poses come from.
    #[serde(default)]
    pub odometry: Odometry,
    /// The antenna's place on the robot: metres forward, left, up. The room's odometry is the robot's too.
    #[serde(default, deserialize_with = "exactly")]
    pub antenna_offset_m: [f64; 3],
    /// The mount of the tracking camera, if the poses are its: they are then constrained to rolling motion, and
    /// `antenna_offset_m` starts from the middle between the wheels.
    #[serde(default)]
    pub camera_mount: Option<CameraMount>,
    /// How bearings are made.
    #[serde(default)]
    pub estimator: Estimation,
    /// Robots whose bearing is wanted.
    #[serde(default)]
    pub peer: Vec<Spanned<Peer>>,
    /// The log of everything that this robot's card reports.
    #[serde(default)]
    pub log: Option<Log>,
    /// What is published where.
    #[serde(default)]
    pub output: Output,
    /// The network of the robots.
    #[serde(default)]
    pub network: Option<Network>,
    /// This robot's part in the sounding exchange.
    #[serde(default)]
    pub sounding: Option<sounding::Sounding>,
    /// The graph of this robot and its peers; none where absent.
    #[serde(default)]
    pub team: Option<Team>,
    /// This program as a node of ROS 1.
    #[serde(default)]
    pub ros: Option<ros::Ros>,
    /// This program as a node of ROS 2.
    #[serde(default)]
    pub ros2: Option<ros2::Ros2>,
}

impl Config {
    /// Reads and checks a file; paths in it are relative to its folder.
    ///
    /// # Errors
    /// [`ConfigError`] with every problem found.
    pub fn load(file: &Path) -> Result<Self, ConfigError> {
        let unread = |error| {
            let reason = format!("cannot be read: {error}");
            ConfigError(vec![Problem { line: None, reason }])
        };
        Self::of_file(&Self::text_of(file).map_err(unread)?, file)
    }

    /// The text of a file or pipe, up to the limit of a configuration.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn text_of(file: &Path) -> std::io::Result<String> {
        let mut text = String::new();
        std::fs::File::open(file)?.take(LONGEST).read_to_string(&mut text)?;
        Ok(text)
    }

    /// Checks the text of a file; paths in it are relative to its folder.
    ///
    /// # Errors
    /// [`ConfigError`] with every problem found.
    pub fn of_file(text: &str, file: &Path) -> Result<Self, ConfigError> {
        Self::read_from(text, file.parent().unwrap_or(Path::new("")), Some(file))
    }

    /// Reads and checks a text; paths in it are relative to `folder`.
    ///
    /// # Errors
    /// [`ConfigError`] with every problem found.
    pub fn read(text: &str, folder: &Path) -> Result<Self, ConfigError> {
        Self::read_from(text, folder, None)
    }

    fn read_from(text: &str, folder: &Path, own_file: Option<&Path>) -> Result<Self, ConfigError> {
        let Reading { config, table, mut problems, gone, stand_ins } = Reading::of(text);
        let Some(mut config) = config else { return Err(ConfigError(problems)) };
        config.resolve(folder);
        // Without a capture nearly every rule would judge the stand-in.
        if !stand_ins.contains("capture") {
            let lines = TomlLines::of_table(text, table);
            let read: Vec<Option<usize>> = problems.iter().map(|problem| problem.line).collect();
            let further = check::problems(&config, own_file, lines, &gone);
            let is_new = |problem: &Problem| problem.line.is_none() || !read.contains(&problem.line);
            problems.extend(further.into_iter().filter(is_new));
        }
        problems.sort_by_key(|problem| problem.line);
        if problems.is_empty() { Ok(config) } else { Err(ConfigError(problems)) }
    }

    /// The robot's name: the configured one, that of the room's robot, or the MAC.
    #[must_use]
    pub fn robot(&self) -> String {
        let in_room = self.capture.get_ref().robot().map(str::to_owned);
        self.name.clone().or(in_room).or_else(|| Some(self.mac?.to_string())).unwrap_or_default()
    }

    /// The options of the pipeline.
    #[must_use]
    pub fn options(&self) -> Options {
        let mut options = Options::new(self.channel).with_antenna(self.antenna);
        options = options.with_heading_sd_rad(Some(self.heading_sd_deg().to_radians()));
        let elevation_max_rad = self.estimator.elevation_max_deg.map(f64::to_radians);
        options.accuracy = options.accuracy.with_elevation_max_rad(elevation_max_rad);
        if !self.estimator.accurate {
            options.accuracy = options.accuracy.with_effort(Effort::Within(3f64.to_radians()));
        }
        options
    }

    fn resolve(&mut self, folder: &Path) {
        let own = |odometry: &mut Odometry| match odometry {
            Odometry::Csv(csv) => csv.file = folder.join(&csv.file),
            Odometry::Opencr(_)
            | Odometry::Room(_)
            | Odometry::Ros(_)
            | Odometry::Ros2(_)
            | Odometry::Static(_)
            | Odometry::Network(_) => {}
        };
        match self.capture.get_mut() {
            Capture::Replay(replay) => replay.file = folder.join(&replay.file),
            Capture::Room(room) => {
                if room.scene.extension().is_some() {
                    room.scene = folder.join(&room.scene);
                }
                room.follow.values_mut().for_each(own);
            }
            Capture::Served(served) => served.socket = folder.join(&served.socket),
            Capture::Feitcsi(Feitcsi::Pipe(pipe)) => *pipe = folder.join(&*pipe),
            Capture::Card(_) | Capture::Stock(_) | Capture::Feitcsi(Feitcsi::Udp(_)) => {}
        }
        own(&mut self.odometry);
        for peer in &mut self.peer {
            own(&mut peer.get_mut().poses);
            if let Records::Replay(replay) = &mut peer.get_mut().records {
                replay.file = folder.join(&replay.file);
            }
        }
        if let Some(log) = &mut self.log {
            log.file = folder.join(&log.file);
        }
        let bag = self.ros2.iter_mut().filter_map(|ros| ros.bag.as_mut());
        bag.for_each(|bag| *bag = folder.join(&*bag));
        let key = self.sounding.iter_mut().filter_map(|sounding| sounding.key.as_mut());
        key.for_each(|key| *key = folder.join(&*key));
        // A file, not standard output or none.
        if !["", "-"].contains(&self.output.bearings.as_str()) {
            self.output.bearings = folder.join(&self.output.bearings).to_string_lossy().into_owned();
        }
        let socket = self.output.status_socket.iter_mut();
        let zenoh = self.network.iter_mut().filter_map(|network| network.zenoh.as_mut());
        socket.chain(zenoh).for_each(|file| *file = folder.join(&*file));
    }
}

#[cfg(test)]
mod tests;
