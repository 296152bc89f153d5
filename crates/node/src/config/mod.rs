//! The configuration of a robot: one TOML file, checked whole before anything starts.

mod check;
pub mod ros;
pub mod sounding;

use check::line_of;
use csi5300::motion::odometry::drive::Geometry;
use csi5300::pipeline::Options;
use csi5300::signal::channel::Channel;
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use serde::de::{Deserialize, Deserializer, Error as _};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use toml::Spanned;

/// A configuration that was checked. See `packaging/robot.toml` for every key with its meaning.
#[derive(Clone, Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name of this robot; the host's where absent.
    #[serde(default)]
    pub name: Option<String>,
    /// MAC of this robot's card. In a simulated room the scene says it.
    #[serde(default, deserialize_with = "maybe_parsed")]
    pub mac: Option<Mac>,
    /// WiFi channel. In a simulated room the scene's.
    #[serde(deserialize_with = "parsed")]
    pub channel: Channel,
    /// Antenna used on all robots.
    #[serde(default = "antenna_a", deserialize_with = "antenna")]
    pub antenna: Antenna,
    /// Where records come from.
    pub capture: Spanned<Capture>,
    /// Where this robot's poses come from.
    #[serde(default)]
    pub odometry: Odometry,
    /// The antenna's place on the robot: metres forward, left, up. The room's odometry is the robot's too.
    #[serde(default)]
    pub antenna_offset_m: [f64; 3],
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
    /// This program as a node of ROS 1.
    #[serde(default)]
    pub ros: Option<ros::Ros>,
}

/// Where records come from.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Capture {
    /// The card of this machine, through its driver.
    Card(Card),
    /// A recorded log at its own pace.
    Replay(Replay),
    /// A simulated room.
    Room(Room),
    /// A robot of a simulated room that another program runs (`csi5300 simulate --serve --socket`), in real time.
    Served(Served),
}

/// See [`Capture::Card`].
#[derive(Clone, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Card {
    /// Connector index of the driver, instead of looking for it.
    pub connector_index: Option<u32>,
    /// Believe messages of other programs too: emulators, `replay --connector`.
    pub allow_user_sender: bool,
}

/// See [`Capture::Replay`].
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Replay {
    /// The log.
    pub file: PathBuf,
    /// Times its own pace.
    #[serde(default = "one", deserialize_with = "positive")]
    pub speed: f64,
}

/// See [`Capture::Room`].
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Room {
    /// The scene's file, or the name of a built-in one.
    pub scene: PathBuf,
    /// The robot of the scene that this is.
    pub robot: String,
    /// Times real time.
    #[serde(default = "one", deserialize_with = "positive")]
    pub speed: f64,
    /// Whose poses the robots go by whose motion in the scene is `followed`.
    #[serde(default)]
    pub follow: BTreeMap<String, Odometry>,
}

/// See [`Capture::Served`].
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Served {
    /// The room's socket.
    pub socket: PathBuf,
    /// The robot of the scene that this is.
    pub robot: String,
}

/// Where poses come from.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Odometry {
    /// The controller of a TurtleBot3, over its serial port.
    Opencr(OpenCr),
    /// A trajectory file, at the pace of the replayed log.
    Csv(Csv),
    /// The simulated room's.
    Room(NoKeys),
    /// A topic of ROS 1.
    Ros(ros::Topic),
    /// The robot stands for ever.
    Static(Place),
    /// Other robots' poses come over the network.
    Network(NoKeys),
}

impl Default for Odometry {
    fn default() -> Self {
        Self::Static(Place::default())
    }
}

/// A table without keys: `{}`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoKeys {}

/// See [`Odometry::Opencr`].
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OpenCr {
    /// The serial port.
    pub port: PathBuf,
    /// The robot's model; the controller says it where absent.
    #[serde(default)]
    pub model: Option<Model>,
    /// Readings a second.
    #[serde(default = "hundred", deserialize_with = "positive")]
    pub rate_hz: f64,
}

/// A TurtleBot3.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Model {
    /// Burger.
    Burger,
    /// Waffle and Waffle Pi.
    Waffle,
}

impl Model {
    /// Its wheels.
    #[must_use]
    pub fn geometry(self) -> Geometry {
        match self {
            Self::Burger => Geometry::BURGER,
            Self::Waffle => Geometry::WAFFLE,
        }
    }
}

/// See [`Odometry::Csv`].
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Csv {
    /// The trajectory.
    pub file: PathBuf,
}

/// See [`Odometry::Static`].
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Place {
    /// Metres.
    pub position_m: [f64; 3],
    /// Degrees from +x towards +y.
    pub heading_deg: f64,
}

/// How bearings are made.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Estimation {
    /// Relative motion in the window, metres.
    #[serde(deserialize_with = "positive")]
    pub window_m: f64,
    /// The window reaches back no further, seconds.
    #[serde(deserialize_with = "positive")]
    pub window_s: f64,
    /// Relative motion needed for a bearing, metres; two wavelengths where absent.
    #[serde(deserialize_with = "maybe_positive")]
    pub least_motion_m: Option<f64>,
    /// Bearings of each peer a second.
    #[serde(deserialize_with = "positive")]
    pub rate_hz: f64,
    /// Poses are carried on beyond the last one by at most this, seconds.
    pub extrapolate_s: f64,
    /// Largest |elevation| searched, degrees.
    pub elevation_max_deg: f64,
    /// Spherical waves, all subcarriers and the one-way channel: better, and ten to a hundred times the work.
    pub accurate: bool,
    /// That work is done once in so many seconds for each peer, and when nothing moves any more; 0: for every bearing.
    pub accurate_every_s: f64,
}

impl Default for Estimation {
    fn default() -> Self {
        Self {
            window_m: 3.0,
            window_s: 180.0,
            least_motion_m: None,
            rate_hz: 2.0,
            extrapolate_s: 0.05,
            elevation_max_deg: 20.0,
            accurate: true,
            accurate_every_s: 5.0,
        }
    }
}

/// A robot whose bearing is wanted.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Peer {
    /// Its name.
    pub name: String,
    /// Its MAC; in a simulated room the scene says it.
    #[serde(default, deserialize_with = "maybe_parsed")]
    pub mac: Option<Mac>,
    /// Where the records of its card come from.
    pub records: Records,
    /// Where its poses come from.
    #[serde(default)]
    pub poses: Odometry,
    /// Its antenna's place on it: metres forward, left, up.
    #[serde(default)]
    pub antenna_offset_m: [f64; 3],
    /// How far its frame is turned against this robot's, degrees.
    #[serde(default)]
    pub yaw_deg: f64,
}

/// Where the records of a peer's card come from.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Records {
    /// A recorded log, at the pace of this robot's.
    Replay(Csv),
    /// The robot of this peer's name in the simulated room.
    Room(NoKeys),
    /// The network of the robots.
    Network(NoKeys),
}

/// The log of everything that this robot's card reports.
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Log {
    /// The file, `.dat`; later starts get a number behind its name.
    pub file: PathBuf,
    /// Go on in a new file before this size, MiB.
    #[serde(default)]
    pub rotate_mib: Option<u64>,
}

/// What is published where.
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Output {
    /// Bearings as JSON lines: a file, or `-` for standard output; empty for nowhere.
    pub bearings: String,
    /// A Unix socket on which the state is told, for `csi5300 watch`.
    pub status_socket: Option<PathBuf>,
    /// One line of state on standard error: on a terminal (`auto`), `always` or `never`.
    pub status_line: StatusLine,
    /// Where Foxglove's viewers connect: `127.0.0.1:8765` is what they ask for (feature `foxglove`).
    pub foxglove: Option<std::net::SocketAddr>,
}

impl Default for Output {
    fn default() -> Self {
        Self { bearings: "-".into(), status_socket: None, status_line: StatusLine::Auto, foxglove: None }
    }
}

/// See [`Output::status_line`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StatusLine {
    /// On a terminal.
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

/// The network of the robots (feature `zenoh`).
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Network {
    /// First part of all keys, so that several groups share a network.
    pub group: String,
    /// Zenoh's own configuration file, for TLS, users, routers; its defaults (peer to peer, discovery) where absent.
    pub zenoh: Option<PathBuf>,
    /// Endpoints to connect to, such as `tcp/192.168.1.10:7447`, beside those that are discovered.
    pub connect: Vec<String>,
    /// Endpoints to listen on.
    pub listen: Vec<String>,
    /// Publish this robot's records.
    pub publish_records: bool,
    /// Publish this robot's poses.
    pub publish_poses: bool,
    /// Records of a peer that wait at most; further ones are lost and counted.
    pub backlog: Option<usize>,
}

/// Everything that is wrong with a configuration.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
pub struct ConfigError(pub Vec<Problem>);

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Line, from 1, where there is one.
    pub line: Option<usize>,
    /// What is wrong, and what would be right.
    pub reason: String,
}

impl Display for Problem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.line {
            Some(line) => write!(f, "line {line}: {}", self.reason),
            None => f.write_str(&self.reason),
        }
    }
}

impl Config {
    /// Reads and checks a file; paths in it are relative to its folder.
    ///
    /// # Errors
    /// [`ConfigError`] with every problem found.
    pub fn load(file: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(file).map_err(|error| {
            let reason = format!("cannot read {}: {error}", file.display());
            ConfigError(vec![Problem { line: None, reason }])
        })?;
        Self::read(&text, file.parent().unwrap_or(Path::new("")))
    }

    /// Reads and checks a text; paths in it are relative to `folder`.
    ///
    /// # Errors
    /// [`ConfigError`] with every problem found.
    pub fn read(text: &str, folder: &Path) -> Result<Self, ConfigError> {
        let mut config: Self = toml::from_str(text).map_err(|error| {
            let line = error.span().map(|span| line_of(text, span.start));
            ConfigError(vec![Problem { line, reason: error.message().to_owned() }])
        })?;
        config.resolve(folder);
        let problems = config.problems(text);
        if problems.is_empty() { Ok(config) } else { Err(ConfigError(problems)) }
    }

    /// What the pipeline is told.
    #[must_use]
    pub fn options(&self) -> Options {
        let mut options = Options::new(self.channel).with_antenna(self.antenna);
        options.search.elevation_max_rad = self.estimator.elevation_max_deg.to_radians();
        if !self.estimator.accurate {
            options.accuracy = options.accuracy.without_layers();
        }
        options
    }

    fn resolve(&mut self, folder: &Path) {
        let own = |odometry: &mut Odometry| match odometry {
            Odometry::Csv(csv) => csv.file = folder.join(&csv.file),
            Odometry::Opencr(_) | Odometry::Room(_) | Odometry::Ros(_) | Odometry::Static(_) | Odometry::Network(_) => {
            }
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
            Capture::Card(_) => {}
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
        let key = self.sounding.iter_mut().filter_map(|sounding| sounding.key.as_mut());
        key.for_each(|key| *key = folder.join(&*key));
        // Neither nowhere nor standard output.
        if !["", "-"].contains(&self.output.bearings.as_str()) {
            self.output.bearings = folder.join(&self.output.bearings).to_string_lossy().into_owned();
        }
        let socket = self.output.status_socket.iter_mut();
        let zenoh = self.network.iter_mut().filter_map(|network| network.zenoh.as_mut());
        socket.chain(zenoh).for_each(|file| *file = folder.join(&*file));
    }
}

fn parsed<'de, D: Deserializer<'de>, T: FromStr<Err: Display>>(input: D) -> Result<T, D::Error> {
    String::deserialize(input)?.parse().map_err(D::Error::custom)
}

fn maybe_parsed<'de, D: Deserializer<'de>, T: FromStr<Err: Display>>(input: D) -> Result<Option<T>, D::Error> {
    parsed(input).map(Some)
}

fn antenna<'de, D: Deserializer<'de>>(input: D) -> Result<Antenna, D::Error> {
    match String::deserialize(input)?.as_str() {
        "A" => Ok(Antenna::A),
        "B" => Ok(Antenna::B),
        "C" => Ok(Antenna::C),
        other => Err(D::Error::custom(format!("antenna `{other}`: A, B or C"))),
    }
}

fn positive<'de, D: Deserializer<'de>>(input: D) -> Result<f64, D::Error> {
    let value = f64::deserialize(input)?;
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(D::Error::custom(format!("{value}: a number above 0")))
    }
}

fn maybe_positive<'de, D: Deserializer<'de>>(input: D) -> Result<Option<f64>, D::Error> {
    positive(input).map(Some)
}

fn antenna_a() -> Antenna {
    Antenna::A
}

fn one() -> f64 {
    1.0
}

fn hundred() -> f64 {
    100.0
}

#[cfg(test)]
mod tests;
