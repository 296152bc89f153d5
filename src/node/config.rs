//! The configuration of a robot: one TOML file, checked whole before anything starts.

use crate::channel::Channel;
use crate::odometry::drive::Geometry;
use crate::pipeline::Options;
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use serde::de::{Deserialize, Deserializer, Error as _};
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
    pub sounding: Option<Sounding>,
}

/// A robot's part in the sounding exchange, in the native dialect, as `csi5300 sound` and `respond` have it (feature
/// `live`). The peers are those of the file; what is not said to be this robot's own is the same on all robots.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sounding {
    /// Monitor interface.
    pub interface: String,
    /// This robot initiates, in turns with the others that do; otherwise it only answers. Its own.
    #[serde(default = "yes")]
    pub initiate: bool,
    /// Rounds a second: one exchange with every peer each.
    #[serde(default = "hundred", deserialize_with = "positive")]
    pub rate_hz: f64,
    /// Links in a round; as many as there are peers where absent.
    #[serde(default)]
    pub links: Option<u16>,
    /// Modulation of every frame, 0 to 23.
    #[serde(default = "mcs_1")]
    pub mcs: u8,
    /// How late a frame may be sent, microseconds.
    #[serde(default = "guard_us")]
    pub guard_us: u32,
    /// How long after a forward frame its answer may begin, microseconds.
    #[serde(default = "turn_around_us")]
    pub turn_around_us: u32,
    /// Answers carry what the card measured.
    #[serde(default = "yes")]
    pub measurement: bool,
    /// File with a key that all robots share.
    #[serde(default)]
    pub key: Option<PathBuf>,
    /// Ask for SCHED_FIFO. Its own.
    #[serde(default = "yes")]
    pub fifo: bool,
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

/// Bearings of each peer a second that can be asked for: one in a thousand seconds to what no processor keeps up with.
const RATES_HZ: std::ops::RangeInclusive<f64> = 1e-3..=100.0;
/// Records that can be let wait for or from the network: no more than some hundred megabytes.
const BACKLOGS: std::ops::RangeInclusive<usize> = 16..=1_000_000;

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
        let mut options = Options { antenna: self.antenna, ..Options::new(self.channel) };
        options.search.elevation_max_rad = self.estimator.elevation_max_deg.to_radians();
        if !self.estimator.accurate {
            options.accuracy = options.accuracy.without_layers();
        }
        options
    }

    fn resolve(&mut self, folder: &Path) {
        let own = |odometry: &mut Odometry| match odometry {
            Odometry::Csv(csv) => csv.file = folder.join(&csv.file),
            Odometry::Opencr(_) | Odometry::Room(_) | Odometry::Static(_) | Odometry::Network(_) => {}
        };
        match self.capture.get_mut() {
            Capture::Replay(replay) => replay.file = folder.join(&replay.file),
            Capture::Room(room) if room.scene.extension().is_some() => room.scene = folder.join(&room.scene),
            Capture::Room(_) | Capture::Card(_) => {}
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

    #[cfg(feature = "live")]
    fn sounding_problem(&self) -> Option<String> {
        let asked = self.sounding.as_ref()?;
        if !matches!(self.capture.get_ref(), Capture::Card(_)) {
            return Some("[sounding] is done with a card: it needs `capture.card`".into());
        }
        if self.peer.is_empty() {
            return Some("[sounding] needs a [[peer]] to sound".into());
        }
        if let Some(key) = asked.key.as_ref().filter(|key| !key.is_file()) {
            return Some(format!("there is no key {}", key.display()));
        }
        let is_40_mhz = self.channel.width() != crate::channel::Width::Ht20;
        super::sounder::problem(asked, self.peer.len(), is_40_mhz).map(|why| format!("[sounding]: {why}"))
    }

    #[cfg(not(feature = "live"))]
    fn sounding_problem(&self) -> Option<String> {
        self.sounding.as_ref().map(|_| "[sounding] needs a program built with the feature `live`".into())
    }

    /// MACs that are not those of the simulated room: where, and why.
    fn foreign_macs(&self, own_at: usize) -> Vec<(usize, String)> {
        let Capture::Room(asked) = self.capture.get_ref() else { return Vec::new() };
        let peers = self.peer.iter().map(|peer| (peer.span().start, peer.get_ref().name.as_str(), peer.get_ref().mac));
        let all = std::iter::once((own_at, asked.robot.as_str(), self.mac)).chain(peers);
        let given: Vec<_> = all.filter_map(|(at, name, mac)| Some((at, name, mac?))).collect();
        if given.is_empty() {
            return Vec::new();
        }
        let made = super::sources::scene(&asked.scene).ok();
        let Some(room) = made.and_then(|scene| crate::backend::sim::Room::new(&scene).ok()) else { return Vec::new() };
        let wrong = |(at, name, mac)| {
            let is = room.number(name).and_then(|number| room.mac(number)).filter(|is| *is != mac)?;
            Some((at, format!("`{name}` has the MAC {is} in this room, not {mac}: leave `mac` out")))
        };
        given.into_iter().filter_map(wrong).collect()
    }

    /// What contradicts itself or this machine.
    fn problems(&self, text: &str) -> Vec<Problem> {
        let mut problems = Vec::new();
        let mut say = |at: usize, reason: String| problems.push(Problem { line: Some(line_of(text, at)), reason });
        let capture_at = self.capture.span().start;
        let is_room = matches!(self.capture.get_ref(), Capture::Room(_));
        let is_replay = matches!(self.capture.get_ref(), Capture::Replay(_));
        if self.mac.is_none() && !is_room {
            let why = "`mac`, the address of this robot's card, is missing: `ip link` shows it, and `csi5300 info` shows the \
                       senders in a log";
            say(capture_at, why.into());
        }
        if let Capture::Replay(replay) = self.capture.get_ref()
            && !replay.file.is_file()
        {
            say(capture_at, format!("there is no log {}", replay.file.display()));
        }
        let mut room = None;
        if let Capture::Room(asked) = self.capture.get_ref() {
            match super::sources::scene(&asked.scene) {
                Ok(scene) => room = Some(scene),
                Err(error) => say(capture_at, error.to_string()),
            }
        }
        let absent = |name: &str| {
            let scene = room.as_ref().filter(|scene| scene.robot.iter().all(|robot| robot.name != name))?;
            let names: Vec<&str> = scene.robot.iter().map(|robot| robot.name.as_str()).collect();
            Some(format!("the scene has no robot `{name}`: it has {}", names.join(", ")))
        };
        if let Capture::Room(asked) = self.capture.get_ref()
            && let Some(why) = absent(&asked.robot)
        {
            say(capture_at, why);
        }
        let estimator = &self.estimator;
        if !(0.0..=90.0).contains(&estimator.elevation_max_deg) {
            say(place(text, "elevation_max_deg"), "elevation_max_deg: 0 to 90 degrees".into());
        }
        if !(0.0..=3_600.0).contains(&estimator.accurate_every_s) {
            say(place(text, "accurate_every_s"), "accurate_every_s: 0 to 3600 seconds".into());
        }
        if !(0.0..=1.0).contains(&estimator.extrapolate_s) {
            let why = "extrapolate_s: 0 to 1 second; a robot is somewhere else after a longer time";
            say(place(text, "extrapolate_s"), why.into());
        }
        self.foreign_macs(place(text, "mac")).into_iter().for_each(|(at, why)| say(at, why));
        let usual_m = super::estimator::Settings::new(self.channel.wavelength_m()).least_m;
        let least_m = estimator.least_motion_m.unwrap_or(usual_m);
        if least_m > estimator.window_m {
            let key = if estimator.least_motion_m.is_some() { "least_motion_m" } else { "window_m" };
            let why = format!(
                "window_m ({:.3} m) is less than the motion needed, {least_m:.3} m: there would never be a bearing",
                estimator.window_m
            );
            say(place(text, key), why);
        }
        if !RATES_HZ.contains(&estimator.rate_hz) {
            let why = format!(
                "rate_hz in [estimator]: {} to {} bearings of each peer a second",
                RATES_HZ.start(),
                RATES_HZ.end()
            );
            say(place(text, "rate_hz"), why);
        }
        let finite = |numbers: &[f64]| numbers.iter().all(|number| number.is_finite());
        let place_of = |odometry: &Odometry| match odometry {
            Odometry::Static(place) => finite(&place.position_m) && place.heading_deg.is_finite(),
            _ => true,
        };
        if !finite(&self.antenna_offset_m) || !place_of(&self.odometry) {
            let key = if finite(&self.antenna_offset_m) { "odometry" } else { "antenna_offset_m" };
            say(place(text, key), format!("{key}: every number must be finite"));
        }
        for peer in &self.peer {
            let (at, peer) = (peer.span().start, peer.get_ref());
            if !finite(&peer.antenna_offset_m) || !peer.yaw_deg.is_finite() || !place_of(&peer.poses) {
                say(at, format!("peer `{}`: antenna_offset_m, yaw_deg and poses must be finite numbers", peer.name));
            }
        }
        let stands = |odometry: &Odometry| matches!(odometry, Odometry::Static(_));
        if stands(&self.odometry) && !self.peer.is_empty() && self.peer.iter().all(|peer| stands(&peer.get_ref().poses))
        {
            let why = "no robot here ever moves (`static` poses, also where none are given), and without motion there is no \
                       bearing: give this robot `odometry` or a peer `poses`";
            let at = self.peer.first().map_or(capture_at, |peer| peer.span().start);
            say(at, why.into());
        }
        let odometry = |poses: &Odometry, at: usize, own: bool| match poses {
            Odometry::Csv(csv) if !csv.file.is_file() => {
                Some((at, format!("there is no trajectory {}", csv.file.display())))
            }
            Odometry::Csv(_) if !is_replay => {
                Some((at, "`csv` poses need a replayed capture, whose pace they follow".into()))
            }
            Odometry::Opencr(_) if is_room || is_replay => Some((
                at,
                "`opencr` poses are of now and need `capture.card`: with a replayed log use `csv`, in a room `room`"
                    .into(),
            )),
            Odometry::Room(_) if !is_room => Some((at, "`room` poses need `capture.room`".into())),
            Odometry::Opencr(_) if !own => Some((at, "a peer's port is not on this machine: use `network`".into())),
            Odometry::Network(_) if own => Some((at, "this robot's own poses do not come over the network".into())),
            Odometry::Network(_) if self.network.is_none() => {
                Some((at, "`network` poses need a [network] table".into()))
            }
            _ => None,
        };
        if let Some((at, why)) = odometry(&self.odometry, place(text, "odometry"), true) {
            say(at, why);
        }
        if self.peer.is_empty() && self.log.is_none() && self.network.is_none() {
            say(capture_at, "no [[peer]], no [log] and no [network]: there is nothing to do".into());
        }
        for (k, peer) in self.peer.iter().enumerate() {
            let (at, peer) = (peer.span().start, peer.get_ref());
            let others = || self.peer.iter().take(k).map(Spanned::get_ref);
            if others().any(|other| other.name == peer.name || (other.mac.is_some() && other.mac == peer.mac)) {
                say(at, format!("peer `{}`: another peer has its name or MAC", peer.name));
            }
            if peer.mac.is_none() && !matches!(peer.records, Records::Room(_)) {
                say(at, format!("peer `{}`: `mac` is missing", peer.name));
            }
            if peer.mac.is_some() && peer.mac == self.mac {
                say(at, format!("peer `{}` has this robot's own MAC", peer.name));
            }
            match &peer.records {
                Records::Replay(replay) if !replay.file.is_file() => {
                    say(at, format!("peer `{}`: there is no log {}", peer.name, replay.file.display()));
                }
                Records::Replay(_) if !is_replay => {
                    say(
                        at,
                        format!("peer `{}`: a replayed log needs `capture.replay`, whose pace it follows", peer.name),
                    );
                }
                Records::Room(_) if !is_room => {
                    say(at, format!("peer `{}`: `room` records need `capture.room`", peer.name))
                }
                Records::Network(_) if self.network.is_none() => {
                    say(at, format!("peer `{}`: `network` records need a [network] table", peer.name));
                }
                Records::Room(_) => absent(&peer.name).into_iter().for_each(|why| say(at, why)),
                _ => {}
            }
            if let Some((at, why)) = odometry(&peer.poses, at, false) {
                say(at, format!("peer `{}`: {why}", peer.name));
            }
        }
        self.sounding_problem().into_iter().for_each(|why| say(place(text, "sounding"), why));
        if self.output.foxglove.is_some() && !cfg!(feature = "foxglove") {
            let why = "foxglove in [output] needs a program built with `--features foxglove`";
            say(place(text, "foxglove"), why.into());
        }
        if let Some(network) = &self.network {
            if !cfg!(feature = "zenoh") {
                say(place(text, "network"), "[network] needs a program built with `--features zenoh`".into());
            }
            if network.backlog.is_some_and(|backlog| !BACKLOGS.contains(&backlog)) {
                let why = format!("backlog: {} to {} records", BACKLOGS.start(), BACKLOGS.end());
                say(place(text, "backlog"), why);
            }
            if network.zenoh.as_ref().is_some_and(|file| !file.is_file()) {
                say(place(text, "zenoh"), "there is no such file of zenoh's".into());
            }
        }
        problems
    }
}

/// Line of a place, from 1.
fn line_of(text: &str, at: usize) -> usize {
    text.bytes().take(at).filter(|byte| *byte == b'\n').count() + 1
}

/// Where a key first stands at the beginning of a line.
fn place(text: &str, key: &str) -> usize {
    let mut at = 0;
    for line in text.split_inclusive('\n') {
        let begins = line.trim_start_matches([' ', '\t', '[']);
        if begins.starts_with(key) || begins.contains(&format!(".{key}")) {
            return at;
        }
        at += line.len();
    }
    0
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

fn yes() -> bool {
    true
}

fn mcs_1() -> u8 {
    1
}

fn guard_us() -> u32 {
    crate::tdma::GUARD_US
}

fn turn_around_us() -> u32 {
    crate::tdma::TURN_AROUND_US
}

fn one() -> f64 {
    1.0
}

fn hundred() -> f64 {
    100.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOM: &str = "channel = \"108\"\ncapture.room = { scene = \"lab-circle\", robot = \"rx\" }\nodometry.room = {}\n\
                        [[peer]]\nname = \"tx\"\nrecords.room = {}\n";

    fn refused(text: &str) -> String {
        Config::read(text, Path::new("")).unwrap_err().to_string()
    }

    #[test]
    fn a_simulated_room_is_a_few_lines() {
        let config = Config::read(ROOM, Path::new("/nowhere")).unwrap();
        assert_eq!(
            config.capture.get_ref(),
            &Capture::Room(Room { scene: "lab-circle".into(), robot: "rx".into(), speed: 1.0 })
        );
        assert_eq!(config.estimator, Estimation::default());
        assert_eq!(config.peer[0].get_ref().poses, Odometry::Static(Place::default()));
    }

    #[test]
    fn all_paths_are_relative_to_the_file() {
        let more = "[log]\nfile = \"l.dat\"\n[output]\nbearings = \"b\"\nstatus_socket = \"s\"\n";
        let config = Config::read(&format!("{ROOM}{more}"), Path::new("/f")).unwrap();
        assert_eq!(config.log.unwrap().file, Path::new("/f/l.dat"));
        assert_eq!((config.output.bearings.as_str(), config.output.status_socket), ("/f/b", Some("/f/s".into())));
        for told in ["-", ""] {
            let text = format!("{ROOM}[output]\nbearings = \"{told}\"\n");
            assert_eq!(Config::read(&text, Path::new("/f")).unwrap().output.bearings, told);
        }
        let zenoh = refused(&format!("{ROOM}[network]\nzenoh = \"nowhere.json5\"\n"));
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let there = Config::read(&format!("{ROOM}[network]\nzenoh = \"Cargo.toml\"\n"), here);
        let words = there.map_or_else(|error| error.to_string(), |_| String::new());
        assert!(!words.contains("no such file") && zenoh.contains("zenoh"), "{words}");
    }

    #[test]
    fn every_problem_has_its_line() {
        assert_eq!(refused(&ROOM.replace("108", "999")).split(':').next(), Some("line 1"));
        let unknown = refused(&format!("{ROOM}colour = 3\n"));
        assert!(unknown.starts_with("line 7") && unknown.contains("colour"), "{unknown}");
        let negative = refused(&format!("{ROOM}[estimator]\nwindow_m = -3.0\n"));
        assert!(negative.starts_with("line 8") && negative.contains("above 0"), "{negative}");
        let typo = refused(&ROOM.replace("records.room", "records.rom"));
        assert!(typo.starts_with("line 6"), "{typo}");
        let two =
            refused(&ROOM.replace("capture.room = { scene = \"lab-circle\", robot = \"rx\" }", "capture.card = {}"));
        let lines: Vec<&str> = two.lines().collect();
        assert!(lines.len() == 3 && lines[0].starts_with("line 2: `mac`"), "{two}");
        assert!(lines[1].starts_with("line 3:") && lines[2].starts_with("line 4: peer `tx`"), "{two}");
        let twice = refused(&format!("{ROOM}[[peer]]\nname = \"tx\"\nrecords.room = {{}}\n"));
        assert!(twice.starts_with("line 7: peer `tx`: another peer"), "{twice}");
        let nobody = refused(&ROOM.replace("name = \"tx\"", "name = \"ty\""));
        assert!(nobody.starts_with("line 4: the scene has no robot `ty`: it has rx, tx"), "{nobody}");
        let nowhere = refused(&ROOM.replace("lab-circle", "lab.toml"));
        assert!(nowhere.starts_with("line 2:") && nowhere.contains("lab.toml"), "{nowhere}");
        let room = |more: &str| refused(&format!("{ROOM}{more}"));
        let short = room("[estimator]\nwindow_m = 0.05\n");
        assert!(short.starts_with("line 8: window_m (0.050 m)"), "{short}");
        for rate in ["1e9", "1e-9"] {
            let absurd = room(&format!("[estimator]\nrate_hz = {rate}\n"));
            assert!(absurd.starts_with("line 8: rate_hz"), "{absurd}");
        }
        let still = refused(&ROOM.replace("odometry.room = {}", ""));
        assert!(still.starts_with("line 4: no robot here ever moves"), "{still}");
        let live = refused(&ROOM.replace("odometry.room = {}", "odometry.opencr.port = \"/dev/null\""));
        assert!(live.starts_with("line 3: `opencr` poses"), "{live}");
        for (wrong, line) in
            [("yaw_deg = nan", "line 4: peer `tx`"), ("antenna_offset_m = [inf, 0, 0]", "line 4: peer `tx`")]
        {
            let endless = room(&format!("{wrong}\n"));
            assert!(endless.starts_with(line) && endless.contains("finite"), "{endless}");
        }
        let other = room("mac = \"02:00:00:00:00:99\"\n");
        assert!(other.starts_with("line 4: `tx` has the MAC"), "{other}");
        let own = refused(&format!("mac = \"02:00:00:00:00:99\"\n{ROOM}"));
        assert!(own.starts_with("line 1: `rx` has the MAC"), "{own}");
        let full = room("[network]\nbacklog = 0\n");
        assert!(full.contains("line 8: backlog"), "{full}");
        let air = room("[sounding]\ninterface = \"mon0\"\n");
        assert!(air.starts_with("line 7: [sounding] is done with a card"), "{air}");
        let card = "mac = \"02:00:00:00:00:01\"\nchannel = \"108\"\ncapture.card = {}\nodometry.opencr.port = \"/dev/null\"\n\
                    [network]\n[[peer]]\nname = \"b\"\nmac = \"02:00:00:00:00:02\"\nrecords.network = {}\n\
                    [sounding]\ninterface = \"mon0\"\n";
        let fast = refused(&format!("{card}rate_hz = 1e5\n"));
        let said = if cfg!(feature = "live") { "rounds" } else { "feature `live`" };
        assert!(fast.contains("line 10: [sounding]") && fast.contains(said), "{fast}");
        let far = refused(&format!("{ROOM}[estimator]\nextrapolate_s = 30\n"));
        assert!(far.starts_with("line 8"), "{far}");
    }
}
