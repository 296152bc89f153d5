//! The configuration of a robot: one TOML file, checked completely before anything starts.
//!
//! | module | what it is |
//! |---|---|
//! | `reading` | the text read with everything in it that is of another kind than it should be |
//! | `check` | what contradicts itself or this machine, one function a group of rules |

mod check;
mod reading;

pub use reading::{ConfigError, Problem};

use crate::refused;
use csi5300::exchange::tdma::{Dialect, Phy, Request};
use csi5300::internal::heading;
use csi5300::motion::odometry::opencr::Geometry;
use csi5300::motion::odometry::ros::{Kind, Stamp};
use csi5300::motion::pose::Mount;
use csi5300::pipeline::live::LiveSettings;
use csi5300::pipeline::{Array, ArrayError, ChainConstant, Effort, Options};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::Error;
use csi5300_live::feitcsi::Command;
use csi5300_ros2::name_part;
use csi5300_ros2::settings::{Settings as Ros2, Topic};
use csi5300_sim::Scene;
use csi5300_sim::toml_lines::TomlLines;
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use driver_iface::radiotap::Bandwidth;
use nalgebra::Vector3;
use reading::{
    Reading, antenna, antennas, channel, exactly, finite, lists, maybe_parsed, model, named, offset, on_robot, parsed,
    positive,
};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::io::{IsTerminal, Read};
use std::num::NonZeroU64;
use std::path::{Path, PathBuf};
use toml::Spanned;

/// Bytes of a configuration that are read: more than any has.
const LONGEST: u64 = 1 << 20;

/// A configuration that was checked. See `packaging/robot.toml` for every key with its meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name of this robot; the host's where absent.
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
    pub array: Option<Antennas>,
    /// Where records come from.
    pub capture: Spanned<Capture>,
    /// Where this robot's poses come from.
    #[serde(default)]
    pub odometry: Odometry,
    /// The antenna's place on the robot: metres forward, left, up. The room's odometry is the robot's too.
    #[serde(default, deserialize_with = "offset")]
    pub antenna_offset_m: [f64; 3],
    /// The mount of the tracking camera, if the poses are its: they are then constrained to rolling motion, and
    /// `antenna_offset_m` starts from the middle between the wheels.
    pub camera_mount: Option<CameraMount>,
    /// How bearings are made.
    #[serde(default)]
    pub estimator: Estimation,
    /// Robots whose bearing is wanted.
    #[serde(default)]
    pub peer: Vec<Spanned<Peer>>,
    /// The log of everything that this robot's card reports.
    pub log: Option<Log>,
    /// What is published where.
    #[serde(default)]
    pub output: Output,
    /// The network of the robots.
    pub network: Option<Network>,
    /// This robot's part in the sounding exchange.
    pub sounding: Option<Sounding>,
    /// The graph of this robot and its peers; none where absent.
    pub team: Option<Team>,
    /// This program as a node of ROS 1.
    pub ros: Option<Ros>,
    /// This program as a node of ROS 2.
    pub ros2: Option<Ros2>,
}

impl Config {
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
        let mut options = Options { antenna: self.antenna, ..Options::new(self.channel) };
        options.heading_sd_rad = Some(self.heading_sd_deg().to_radians());
        let elevation_max_rad = self.estimator.elevation_max_deg.map(f64::to_radians);
        options.accuracy.elevation_max_rad = elevation_max_rad;
        if !self.estimator.accurate {
            options.accuracy.effort = Effort::Within(3f64.to_radians());
        }
        options
    }

    /// Standard deviation of the heading of this robot's poses, degrees, which error bars and confidence hold. Default
    /// for `estimator.heading_sd_deg`: measured values for a camera constrained to rolling motion and for wheels or odometry of ROS
    /// with a known antenna place, 0 for everything else.
    pub(crate) fn heading_sd_deg(&self) -> f64 {
        let usual_rad = match self.odometry {
            _ if self.camera_mount.is_some() => heading::ROLLING_CAMERA_RAD,
            Odometry::Opencr(_)
            | Odometry::Ros(RosTopic { kind: Kind::Odometry, .. })
            | Odometry::Ros2(Topic { kind: csi5300_ros2::settings::Kind::Odometry, .. }) => heading::WHEELS_RAD,
            _ => 0.0,
        };
        self.estimator.heading_sd_deg.unwrap_or(usual_rad.to_degrees())
    }

    /// How the estimator is set.
    #[must_use]
    pub fn estimator_settings(&self) -> LiveSettings {
        let asked = &self.estimator;
        let wavelength_m = self.channel.wavelength_m();
        let mut settings = LiveSettings::new(wavelength_m);
        (settings.window_m, settings.window_s) = (asked.window_m, asked.window_s);
        settings.least_m = asked.motion_needed_m(wavelength_m);
        settings.rate_hz = asked.rate_hz;
        settings.extrapolate_s = asked.extrapolate_s;
        settings.accurate_every_s = asked.accurate_every_s;
        settings
    }

    /// The number of peers that answer.
    pub(crate) fn answering(&self) -> usize {
        self.peer.iter().filter(|peer| !matches!(peer.get_ref().records, Records::Heard(_))).count()
    }

    /// The request of the sounding exchange, if this robot takes part.
    pub(crate) fn sounding_request(&self) -> Option<Request> {
        let asked = self.sounding.as_ref()?;
        let is_20_mhz = self.channel.width() == Width::Ht20;
        let bandwidth = if is_20_mhz { Bandwidth::Ht20 } else { Bandwidth::Ht40 };
        let links = asked.links.unwrap_or(u16::try_from(self.answering()).unwrap_or(u16::MAX));
        let dialect = Dialect::Native { measurement: asked.measurement, authenticated: asked.key.is_some() };
        Some(Request {
            phy: Phy { mcs: asked.mcs, bandwidth },
            dialect,
            guard_us: asked.guard_us,
            turn_around_us: asked.turn_around_us,
            ..Request::new(links, asked.rate_hz)
        })
    }

    /// The sources of poses: this robot's, its peers', and those that robots of the room follow.
    fn all_poses(&self) -> impl Iterator<Item = &Odometry> {
        let followed = match self.capture.get_ref() {
            Capture::Room(room) => Some(room.follow.values()),
            _ => None,
        };
        let peers = self.peer.iter().map(|peer| &peer.get_ref().poses);
        std::iter::once(&self.odometry).chain(peers).chain(followed.into_iter().flatten())
    }

    /// True if anything is read from or published over ROS 1.
    pub(crate) fn uses_ros(&self) -> bool {
        self.ros.is_some() || self.all_poses().any(|poses| matches!(poses, Odometry::Ros(_)))
    }

    /// True if anything is read from or published over ROS 2.
    pub(crate) fn uses_ros2(&self) -> bool {
        let has_ranges = self.team.as_ref().is_some_and(|team| !team.ranges.is_empty());
        self.ros2.is_some() || has_ranges || self.all_poses().any(|poses| matches!(poses, Odometry::Ros2(_)))
    }

    /// Whom the node looks for in ROS 2, and who said so, in words; none without ROS 2.
    #[must_use]
    pub fn ros2_reach(&self) -> Option<String> {
        let asked = self.ros2.clone().unwrap_or_default();
        let zenoh = self.network.as_ref().is_some_and(|network| network.ros2);
        let also = if zenoh { "; over [network] too (rmw_zenoh)" } else { "" };
        self.uses_ros2().then(|| format!("ROS 2, domain {}: {}{also}", asked.domain(), asked.reach().words))
    }

    /// Every file that is read, and its place here: keys and numbers of items from the root.
    fn inputs(&mut self) -> Vec<(String, &mut PathBuf)> {
        let mut files: Vec<(String, &mut PathBuf)> = Vec::new();
        match self.capture.get_mut() {
            Capture::Replay(replay) => files.push(("capture.replay.file".into(), &mut replay.file)),
            Capture::Room(room) => {
                // Others are built in.
                if room.scene.extension().is_some() {
                    files.push(("capture.room.scene".into(), &mut room.scene));
                }
                let followed = room.follow.iter_mut();
                files.extend(followed.filter_map(|(name, of)| of.file(&format!("capture.room.follow.{name}"))));
            }
            Capture::Served(served) => files.push(("capture.served.socket".into(), &mut served.socket)),
            Capture::Feitcsi(Feitcsi::Pipe(pipe)) => files.push(("capture.feitcsi.pipe".into(), pipe)),
            Capture::Card(_) | Capture::Stock(_) | Capture::Feitcsi(Feitcsi::Udp(_)) => {}
        }
        files.extend(self.odometry.file("odometry"));
        for (k, peer) in self.peer.iter_mut().map(Spanned::get_mut).enumerate() {
            if let Records::Replay(replay) = &mut peer.records {
                files.push((format!("peer.{k}.records.replay.file"), &mut replay.file));
            }
            files.extend(peer.poses.file(&format!("peer.{k}.poses")));
        }
        let key = self.sounding.as_mut().and_then(|sounding| sounding.key.as_mut());
        files.extend(key.map(|key| ("sounding.key".into(), key)));
        let zenoh = self.network.as_mut().and_then(|network| network.zenoh.as_mut());
        files.extend(zenoh.map(|file| ("network.zenoh".into(), file)));
        files
    }

    /// Makes every path relative to `folder`.
    fn resolve(&mut self, folder: &Path) {
        let inside = |file: &mut PathBuf| *file = folder.join(&*file);
        self.inputs().into_iter().for_each(|(_, file)| inside(file));
        // A file, not standard output or none.
        if !["", "-"].contains(&self.output.bearings.as_str()) {
            self.output.bearings = folder.join(&self.output.bearings).to_string_lossy().into_owned();
        }
        let log = self.log.as_mut().map(|log| &mut log.file);
        let bag = self.ros2.as_mut().and_then(|ros| ros.bag.as_mut());
        [log, bag, self.output.status_socket.as_mut()].into_iter().flatten().for_each(inside);
    }
}

/// Sources of records.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Capture {
    /// The card of this machine, through its driver.
    Card(Card),
    /// The card of this machine under the kernel's own driver, by an eBPF program (feature `stock`).
    Stock(Stock),
    /// An AX200 or AX210 of this machine, by FeitCSI.
    Feitcsi(Feitcsi),
    /// A recorded log at its own pace.
    Replay(Replay),
    /// A simulated room.
    Room(Room),
    /// A robot of a simulated room that another program runs (`csi5300 simulate --serve --socket`), in real time.
    Served(Served),
}

/// See [`Capture::Card`].
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Card {
    /// Connector index of the driver, instead of looking for it.
    pub connector_index: Option<u32>,
    /// Accept messages of other programs too: emulators, `replay --connector`.
    pub allow_user_sender: bool,
}

/// See [`Capture::Stock`].
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Stock {
    /// The frames themselves too (0xC1): for the log. With a key they are read in any case.
    pub frames: bool,
}

/// See [`Capture::Feitcsi`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Feitcsi {
    /// The address of its UDP socket, and its options: `127.0.0.1:8008 --frequency 5180`.
    Udp(#[serde(deserialize_with = "parsed")] Command),
    /// The named pipe that its standard output goes to.
    Pipe(PathBuf),
}

/// See [`Capture::Replay`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Replay {
    /// The log.
    pub file: PathBuf,
    /// Times its own pace.
    #[serde(default = "one", deserialize_with = "positive")]
    pub speed: f64,
}

/// See [`Capture::Room`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Room {
    /// The scene's file, or the name of a built-in one.
    pub scene: PathBuf,
    /// The robot of the scene that this is.
    pub robot: String,
    /// Times real time.
    #[serde(default = "one", deserialize_with = "positive")]
    pub speed: f64,
    /// The sources of poses for robots whose motion in the scene is `followed`.
    #[serde(default)]
    pub follow: BTreeMap<String, Odometry>,
}

/// See [`Capture::Served`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Served {
    /// The room's socket.
    pub socket: PathBuf,
    /// The robot of the scene that this is.
    pub robot: String,
}

impl Capture {
    /// The name that this robot has in its simulated room, if it is in one.
    #[must_use]
    pub fn robot(&self) -> Option<&str> {
        match self {
            Self::Room(room) => Some(&room.robot),
            Self::Served(served) => Some(&served.robot),
            Self::Card(_) | Self::Stock(_) | Self::Feitcsi(_) | Self::Replay(_) => None,
        }
    }
}

impl Room {
    /// The scene: a built-in one by its name, or that of the file.
    ///
    /// # Errors
    /// If there is no such scene, or it is refused.
    pub(crate) fn load_scene(&self) -> Result<Scene, Error> {
        let name = &self.scene;
        Scene::find(name).map_err(|error| refused(error.of_file(name).to_string()))
    }
}

/// Sources of poses.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Odometry {
    /// The controller of a TurtleBot3, over its serial port.
    Opencr(OpenCr),
    /// A trajectory file, at the pace of the replayed log.
    Csv(Csv),
    /// The simulated room's.
    Room(NoKeys),
    /// A topic of ROS 1.
    Ros(RosTopic),
    /// A topic of ROS 2.
    Ros2(Topic),
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

impl Odometry {
    /// Its trajectory, if it is one, with its place.
    fn file(&mut self, place: &str) -> Option<(String, &mut PathBuf)> {
        if let Self::Csv(csv) = self { Some((format!("{place}.csv.file"), &mut csv.file)) } else { None }
    }
}

/// A table without keys: `{}`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoKeys {}

/// See [`Odometry::Opencr`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OpenCr {
    /// The serial port.
    pub port: PathBuf,
    /// The wheels of the robot's model, `burger` or `waffle`; by default the controller says which.
    #[serde(default, deserialize_with = "model")]
    pub model: Option<Geometry>,
    /// Readings a second.
    #[serde(default = "hundred", deserialize_with = "positive")]
    pub rate_hz: f64,
}

/// See [`Odometry::Csv`]. In a configuration `"FILE"` or `{ file = "FILE" }`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(from = "CsvForm")]
pub struct Csv {
    /// The trajectory.
    pub file: PathBuf,
}

/// Both forms of a [`Csv`].
#[derive(Deserialize)]
#[serde(untagged, deny_unknown_fields, expecting = "a file, \"FILE\" or { file = \"FILE\" }")]
enum CsvForm {
    Name(PathBuf),
    Table { file: PathBuf },
}

impl From<CsvForm> for Csv {
    fn from(form: CsvForm) -> Self {
        let (CsvForm::Name(file) | CsvForm::Table { file }) = form;
        Self { file }
    }
}

/// See [`Odometry::Static`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Place {
    /// Metres.
    #[serde(deserialize_with = "exactly")]
    pub position_m: [f64; 3],
    /// Degrees from +x towards +y.
    #[serde(deserialize_with = "finite")]
    pub heading_deg: f64,
}

/// The mount of a tracking camera on a robot with wheels.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraMount {
    /// The camera seen from the middle between the wheels, metres forward.
    #[serde(deserialize_with = "on_robot")]
    pub forward_m: f64,
    /// The same, metres to the left.
    #[serde(deserialize_with = "on_robot")]
    pub left_m: f64,
    /// Its heading less the robot's, degrees, counter-clockwise.
    #[serde(default, deserialize_with = "finite")]
    pub yaw_deg: f64,
}

impl CameraMount {
    /// The same for [`csi5300::motion::pose`].
    #[must_use]
    pub fn mount(&self) -> Mount {
        Mount { offset_m: Vector3::new(self.forward_m, self.left_m, 0.0), yaw_rad: self.yaw_deg.to_radians() }
    }
}

/// A robot whose bearing is wanted.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Peer {
    /// Its name.
    pub name: String,
    /// Its MAC; in a simulated room the scene's.
    #[serde(default, deserialize_with = "maybe_parsed")]
    pub mac: Option<Mac>,
    /// The common name of its certificate: only its holder may publish as it in the robots' network.
    pub certificate: Option<String>,
    /// The source of its card's records.
    pub records: Records,
    /// The source of its poses.
    #[serde(default)]
    pub poses: Odometry,
    /// Its antenna's place on it: metres forward, left, up.
    #[serde(default, deserialize_with = "offset")]
    pub antenna_offset_m: [f64; 3],
    /// How far its frame is turned against this robot's, degrees.
    #[serde(default, deserialize_with = "finite")]
    pub yaw_deg: f64,
}

/// Sources of a peer's records.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Records {
    /// A recorded log, at the pace of this robot's.
    Replay(Csv),
    /// The robot of this peer's name in the simulated room.
    Room(NoKeys),
    /// The network of the robots.
    Network(NoKeys),
    /// None: its bearing comes from what this robot hears of it, with the antennas of `[array]`. It need not answer, nor be
    /// a robot.
    Heard(NoKeys),
    /// Its answers to this robot's frames, which carry its card's measurements. No network is needed, but the peer must
    /// stand, because answers lack the time of its host.
    Sounding(NoKeys),
}

/// Two or three antennas, and where they are on the robot. See [`Array`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Antennas {
    /// The antennas, `["A", "B"]`; of cards other than the 5300 they are receive chains 0, 1 and 2.
    #[serde(deserialize_with = "antennas")]
    pub antennas: Vec<Antenna>,
    /// The place of the first one as seen from each other one: metres forward, left, up.
    #[serde(deserialize_with = "lists")]
    pub baselines_m: Vec<[f64; 3]>,
    /// Of each baseline what a turn gave: the constant between the chains and its deviation, degrees. With it a robot that stands
    /// has a bearing.
    #[serde(default, deserialize_with = "lists")]
    pub chain_constants_deg: Vec<[f64; 2]>,
}

impl Antennas {
    /// The array.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(crate) fn array(&self) -> Result<Array, ArrayError> {
        let baselines_m: Vec<Vector3<f64>> = self.baselines_m.iter().map(|m| Vector3::from(*m)).collect();
        let constant = |[deg, sd_deg]: &[f64; 2]| ChainConstant { rad: deg.to_radians(), sd_rad: sd_deg.to_radians() };
        let constants: Vec<ChainConstant> = self.chain_constants_deg.iter().map(constant).collect();
        Array::new(&self.antennas, &baselines_m)?.with_constants(&constants)
    }
}

/// How bearings are made.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Estimation {
    /// Relative motion in the window, metres.
    #[serde(deserialize_with = "positive")]
    pub window_m: f64,
    /// The window reaches back no further, seconds.
    #[serde(deserialize_with = "positive")]
    pub window_s: f64,
    /// Relative motion needed for a bearing, metres; two wavelengths where absent.
    #[serde(deserialize_with = "positive")]
    pub least_motion_m: Option<f64>,
    /// Bearings of each peer a second.
    #[serde(deserialize_with = "positive")]
    pub rate_hz: f64,
    /// Poses are extrapolated by at most this, seconds.
    pub extrapolate_s: f64,
    /// Largest |elevation| of a peer, degrees; where absent 20 for level motion.
    pub elevation_max_deg: Option<f64>,
    /// Standard deviation of the heading of this robot's poses, degrees; where absent that of its kind of odometry
    /// (`Config::heading_sd_deg`).
    pub heading_sd_deg: Option<f64>,
    /// The posterior on a fine grid; if false, on the coarse grid only.
    pub accurate: bool,
    /// The complete estimate runs at this interval for each peer, seconds, and when nothing moves any more; 0: for
    /// every bearing.
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
            elevation_max_deg: None,
            heading_sd_deg: None,
            accurate: true,
            accurate_every_s: 5.0,
        }
    }
}

impl Estimation {
    /// Relative motion needed for a bearing, metres, at this wavelength.
    pub(crate) fn motion_needed_m(&self, wavelength_m: f64) -> f64 {
        self.least_motion_m.unwrap_or_else(|| LiveSettings::new(wavelength_m).least_m)
    }
}

/// A robot's part in the sounding exchange, in the native dialect, as `csi5300 sound` has it (feature `live`). The
/// peers are those of the file; fields not marked as this robot's own must be equal on all robots.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Sounding {
    /// Monitor interface; none in a served room, whose air it is.
    pub interface: Option<String>,
    /// This robot initiates, in turns with the others that do; otherwise it only answers. Its own.
    pub initiate: bool,
    /// Rounds a second: one exchange with every peer each.
    #[serde(deserialize_with = "positive")]
    pub rate_hz: f64,
    /// Links in a round; as many as there are peers where absent.
    pub links: Option<u16>,
    /// Modulation of every frame, 0 to 23.
    pub mcs: u8,
    /// How late a frame may be sent, microseconds.
    pub guard_us: u32,
    /// How long after a forward frame its answer may begin, microseconds.
    pub turn_around_us: u32,
    /// Answers carry what the card measured.
    pub measurement: bool,
    /// File with a key that all robots share.
    pub key: Option<PathBuf>,
    /// Ask for SCHED_FIFO. Its own.
    pub fifo: bool,
}

impl Default for Sounding {
    fn default() -> Self {
        let Request { guard_us, turn_around_us, .. } = Request::default();
        Self {
            interface: None,
            initiate: true,
            rate_hz: 100.0,
            links: None,
            mcs: 1,
            guard_us,
            turn_around_us,
            measurement: true,
            key: None,
            fifo: true,
        }
    }
}

/// See [`Odometry::Ros`].
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RosTopic {
    /// Its name, from the root: `/tb3_0/odom`.
    pub topic: String,
    /// Its message type.
    #[serde(default, rename = "type")]
    pub kind: Kind,
    /// The time of a pose: the stamp in its header; for a robot that the room follows, its receipt.
    pub stamp: Option<Stamp>,
    /// Poses of other frames are refused; without it another frame than that of the first pose is a new frame.
    pub frame: Option<String>,
}

/// This program as a node of ROS 1, through rospy.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Ros {
    /// The master, `http://HOST:11311`; `$ROS_MASTER_URI` where absent, then that of this machine.
    pub master: Option<String>,
    /// Name of the node, from which its topics' names begin; `/csi5300_` and the robot's name where absent.
    pub node: Option<String>,
    /// `frame_id` of outputs: the frame of this robot's poses.
    pub frame: String,
    /// Publish bearings.
    pub publish_bearings: bool,
    /// Publish the CSI that this robot's card measures.
    pub publish_csi: bool,
}

impl Default for Ros {
    fn default() -> Self {
        Self { master: None, node: None, frame: "odom".into(), publish_bearings: true, publish_csi: false }
    }
}

impl Ros {
    /// The master to use.
    pub(crate) fn master(&self) -> String {
        let told = || std::env::var("ROS_MASTER_URI").ok().filter(|uri| !uri.is_empty());
        let master = self.master.clone().or_else(told);
        master.unwrap_or_else(|| "http://localhost:11311".into()).trim_end_matches('/').to_owned()
    }

    /// The name of the node: the configured one, or that of the robot or of the room's robot, or the MAC.
    pub(crate) fn node(&self, config: &Config) -> String {
        self.node.clone().unwrap_or_else(|| format!("/{}", name_part(&format!("csi5300_{}", config.robot()))))
    }
}

/// The graph of this robot and its peers ([`crate::team`]).
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Team {
    /// Known places of peers that stand, metres: their frame is the team's. Without any, it is the frame of this robot's odometry.
    #[serde(deserialize_with = "named")]
    pub places: BTreeMap<String, [f64; 2]>,
    /// Name of the places' frame.
    pub frame: String,
    /// Ranges from this robot to peers, by another sensor such as UWB.
    pub ranges: BTreeMap<String, RangeTopic>,
}

impl Default for Team {
    fn default() -> Self {
        Self { places: BTreeMap::new(), frame: "map".into(), ranges: BTreeMap::new() }
    }
}

/// A topic of ROS 2 with the ranges to one peer: `sensor_msgs/msg/Range`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangeTopic {
    /// Its name: `/uwb/burger_2` from the root, `uwb/burger_2` in the node's namespace.
    pub topic: String,
    /// Standard deviation of messages without a variance, metres.
    #[serde(default = "tenth", deserialize_with = "positive")]
    pub sd_m: f64,
}

/// The log of everything that this robot's card reports.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Log {
    /// The file, `.dat`; later starts append a number to its name.
    pub file: PathBuf,
    /// Continue in a new file before this size, MiB.
    pub rotate_mib: Option<NonZeroU64>,
    /// With a checksum of each record in the side file.
    #[serde(default)]
    pub checksums: bool,
}

/// What is published where.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Output {
    /// Bearings as JSON lines: a file, or `-` for standard output; empty for nowhere. On a terminal, the line of state replaces those of `-`.
    pub bearings: String,
    /// A Unix socket on which the state is published, for `csi5300 watch`.
    pub status_socket: Option<PathBuf>,
    /// One line of state on standard error: on a terminal (`auto`), `always` or `never`.
    pub status_line: StatusLine,
    /// The address for Foxglove's viewers; their default is `127.0.0.1:8765` (feature `foxglove`).
    pub foxglove: Option<std::net::SocketAddr>,
    /// Further web pages that may connect, beside Foxglove's and those of this machine: `https://lichtblick.lab`.
    pub foxglove_origins: Vec<String>,
}

impl Default for Output {
    fn default() -> Self {
        Self {
            bearings: "-".into(),
            status_socket: None,
            status_line: StatusLine::Auto,
            foxglove: None,
            foxglove_origins: Vec::new(),
        }
    }
}

impl Output {
    /// True if the line of state is shown.
    pub(crate) fn shows_line(&self) -> bool {
        match self.status_line {
            StatusLine::Auto => std::io::stderr().is_terminal(),
            StatusLine::Always => true,
            StatusLine::Never => false,
        }
    }
}

/// See [`Output::status_line`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
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
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Network {
    /// First part of all keys, so that several groups share a network; `robots` where empty.
    pub group: String,
    /// Zenoh's own configuration file, for TLS, users, routers; its defaults (peer to peer, discovery) where absent.
    pub zenoh: Option<PathBuf>,
    /// Endpoints to connect to, such as `tcp/192.168.1.10:7447`, beside those that are discovered.
    pub connect: Vec<String>,
    /// Endpoints to listen on. Without any, and without passwords or certificates: a local port.
    pub listen: Vec<String>,
    /// Anybody who reaches this network may join, publish as any robot, and read everything.
    pub insecure: bool,
    /// Publish this robot's records.
    pub publish_records: bool,
    /// Publish this robot's poses.
    pub publish_poses: bool,
    /// Carry the topics of ROS 2 too, for nodes with `rmw_zenoh_cpp`.
    pub ros2: bool,
    /// Limit of a peer's waiting records; further ones are lost and counted.
    pub backlog: Option<usize>,
}

impl Network {
    /// The first part of all keys, or its default.
    #[must_use]
    pub fn group(&self) -> &str {
        if self.group.is_empty() { "robots" } else { &self.group }
    }
}

fn antenna_a() -> Antenna {
    Antenna::A
}

fn one() -> f64 {
    1.0
}

fn tenth() -> f64 {
    0.1
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

    /// Lines of all refusals of a text.
    fn refused_lines(text: &str) -> Vec<String> {
        refused(text).lines().map(str::to_owned).collect()
    }

    #[test]
    fn a_simulated_room_is_a_few_lines() {
        let config = Config::read(ROOM, Path::new("/nowhere")).unwrap();
        assert_eq!(
            config.capture.get_ref(),
            &Capture::Room(Room {
                scene: "lab-circle".into(),
                robot: "rx".into(),
                speed: 1.0,
                follow: BTreeMap::new()
            })
        );
        assert_eq!(config.estimator, Estimation::default());
        assert_eq!(config.peer[0].get_ref().poses, Odometry::Static(Place::default()));
    }

    #[test]
    fn a_channel_is_text_or_a_number() {
        let of = |text: &str| {
            Config::read(&ROOM.replace("\"108\"", text), Path::new("")).map(|config| config.channel.to_string())
        };
        assert_eq!(of("36").unwrap(), "36");
        assert_eq!(of("\"36+\"").unwrap(), "36+");
        assert!(refused(&ROOM.replace("\"108\"", "109")).contains("`109` is no channel"));
    }

    #[test]
    fn a_served_room_is_configured_in_a_few_lines() {
        let served = ROOM.replace("capture.room = { scene = \"lab-circle\"", "capture.served = { socket = \"s\"");
        let config = Config::read(&served, Path::new("/f")).unwrap();
        let expected = Served { socket: "/f/s".into(), robot: "rx".into() };
        assert_eq!(config.capture.get_ref(), &Capture::Served(expected));
    }

    #[test]
    fn all_paths_are_relative_to_the_file() {
        let more = "[log]\nfile = \"l.dat\"\n[output]\nbearings = \"b\"\nstatus_socket = \"s\"\n";
        let folder = std::env::temp_dir().join(format!("csi5300-config-paths-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let there = |name: &str| folder.join(name);
        let config = Config::read(&format!("{ROOM}{more}"), &folder).unwrap();
        assert_eq!(config.log.unwrap().file, there("l.dat"));
        assert_eq!((Path::new(&config.output.bearings), config.output.status_socket), (&*there("b"), Some(there("s"))));
        std::fs::remove_dir_all(&folder).unwrap();
        for told in ["-", ""] {
            let text = format!("{ROOM}[output]\nbearings = \"{told}\"\n");
            assert_eq!(Config::read(&text, Path::new("/f")).unwrap().output.bearings, told);
        }
        let zenoh = refused(&format!("{ROOM}[network]\nzenoh = \"nowhere.json5\"\n"));
        let here = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
        let there = Config::read(&format!("{ROOM}[network]\nzenoh = \"Cargo.toml\"\n"), here);
        let words = there.map_or_else(|error| error.to_string(), |_| String::new());
        assert!(!words.contains("there is no file") && zenoh.contains("there is no file"), "{words}");
    }

    #[test]
    fn every_problem_has_its_line() {
        assert_eq!(refused(&ROOM.replace("108", "999")).split(':').next(), Some("line 1"));
        let negative = refused(&format!("{ROOM}[estimator]\nwindow_m = -3.0\n"));
        assert!(negative.starts_with("line 8") && negative.contains("above 0"), "{negative}");
        let card = ROOM.replace("capture.room = { scene = \"lab-circle\", robot = \"rx\" }", "capture.card = {}");
        let lines = refused_lines(&card);
        assert!(lines.len() == 3 && lines[0].starts_with("line 2: `mac`"), "{lines:?}");
        assert!(lines[1].starts_with("line 3:") && lines[2].starts_with("line 6: peer `tx`"), "{lines:?}");
        // Beside what nobody knows in a capture, the rest of the file is checked as well.
        let both =
            ROOM.replace("robot = \"rx\"", "robot = \"rx\", colour = 3").replace("name = \"tx\"", "name = \"ty\"");
        let both = refused(&both);
        assert!(both.contains("colour") && both.contains("the scene has no robot `ty`"), "{both}");
    }

    #[test]
    fn robots_of_a_room_follow_what_there_is() {
        let folder = std::env::temp_dir().join(format!("csi5300-config-follow-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let scene = "duration_s = 9\n[[robot]]\nname = \"a\"\nmotion.followed = {}\n[[robot]]\nname = \"b\"\nposition_m = [4, 0, 0]\n";
        std::fs::write(folder.join("scene.toml"), scene).unwrap();
        let read = |follow: &str| {
            let room = format!("capture.room = {{ scene = \"scene.toml\", robot = \"a\"{follow} }}");
            let text =
                ROOM.replace("capture.room = { scene = \"lab-circle\", robot = \"rx\" }", &room).replace("tx", "b");
            Config::read(&text, &folder).map_err(|error| error.to_string())
        };
        let alone = read("").unwrap_err();
        assert!(alone.starts_with("line 2: robot `a` of the scene follows nothing"), "{alone}");
        std::fs::write(folder.join("way.csv"), "0,0,0,0,0\n").unwrap();
        let config = read(", follow.a.csv.file = \"way.csv\"").unwrap();
        assert!(!config.uses_ros());
        assert!(read(", follow = { a.ros.topic = \"/a/odom\" }").unwrap().uses_ros());
        for (follow, why) in [
            (", follow = { a.csv.file = \"no.csv\" }", "there is no file"),
            (", follow = { a.csv.file = \"way.csv\", c.csv.file = \"way.csv\" }", "no robot `c`"),
            (", follow = { a.csv.file = \"way.csv\", b.csv.file = \"way.csv\" }", "`b` moves as the scene says"),
            (", follow = { a.room = {} }", "`ros` or `csv`"),
            (", follow = { a.ros.topic = \"odom\" }", "not a valid ROS name"),
            (", speed = 2.0, follow = { a.ros.topic = \"/odom\" }", "are live"),
            (", follow = { a.ros = { topic = \"/odom\", stamp = \"header\" } }", "times of arrival"),
        ] {
            let refused = read(follow).unwrap_err();
            assert!(refused.starts_with("line 2: ") && refused.contains(why), "{refused}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_node_of_ros_has_a_master_and_a_name() {
        let card = "mac = \"00:21:6a:00:00:01\"\nchannel = \"108\"\ncapture.card = {}\nodometry.ros.topic = \"/odom\"\n\
                    [ros]\nmaster = \"http://10.0.0.1:11311/\"\n[log]\nfile = \"x.dat\"\n";
        let config = Config::read(card, &std::env::temp_dir()).unwrap();
        assert!(config.uses_ros());
        let ros = config.ros.clone().unwrap();
        assert_eq!((&*ros.master(), &*ros.node(&config)), ("http://10.0.0.1:11311", "/csi5300_00_21_6a_00_00_01"));
    }

    #[test]
    fn the_example_for_simulators_is_good() {
        let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join("examples/ros/robot.toml");
        Config::of_file(&Config::text_of(&file).unwrap(), &file).unwrap();
    }

    #[test]
    fn error_bars_hold_the_heading_of_the_odometry() {
        let config = |text: &str| Config::read(text, Path::new("")).unwrap();
        assert_eq!(config(ROOM).options().heading_sd_rad, Some(0.0));
        let own = config(&format!("{ROOM}[estimator]\nheading_sd_deg = 3.0\n")).options().heading_sd_rad;
        assert!((own.unwrap() - 3f64.to_radians()).abs() < 1e-12, "{own:?}");
        let of = |change: &dyn Fn(&mut Config)| {
            let mut changed = config(ROOM);
            change(&mut changed);
            changed.heading_sd_deg()
        };
        let wheels = of(&|config| {
            config.odometry = Odometry::Opencr(OpenCr { port: "/dev/null".into(), model: None, rate_hz: 100.0 });
        });
        let camera = of(&|config| {
            config.camera_mount = Some(CameraMount { forward_m: 0.0, left_m: 0.0, yaw_deg: 0.0 });
        });
        assert!(0.0 < wheels && wheels < camera && camera < 5.0, "{wheels} {camera}");
        // A topic of odometry is of wheels as far as anybody knows, one of poses of a camera on the wall.
        let [odometry, pose] = [Kind::Odometry, Kind::Pose].map(|kind| {
            of(&|config| {
                let topic = "/odom".into();
                config.odometry = Odometry::Ros(RosTopic { topic, kind, stamp: None, frame: None });
            })
        });
        assert_eq!((odometry, pose), (wheels, 0.0));
    }

    #[test]
    fn one_wrong_value_does_not_hide_the_others() {
        let text = "channel = 108.5\nantenna = \"D\"\nmac = \"02:00:00:00:00:01\"\ncapture.card = {}\n[estimator]\nwindow = 3\n\
                    window_m = \"three\"\n[log]\nfile = \"no/folder/x.dat\"\n[output]\nbearings = \"no/folder/b.jsonl\"\n\
                    status_socket = \"no/folder/s\"\n";
        let all = refused_lines(text);
        let found: Vec<(&str, bool)> = [
            (0, "line 1: ", "a channel: \"108\""),
            (1, "line 2: ", "antenna `D`: A, B or C"),
            (2, "line 6: ", "unknown field `window`"),
            (3, "line 7: ", "\"three\""),
            (4, "line 9: ", "there is no folder no/folder"),
            (5, "line 11: ", "there is no folder no/folder"),
            (6, "line 12: ", "there is no folder no/folder"),
        ]
        .map(|(k, line, why)| (line, all.get(k).is_some_and(|said| said.starts_with(line) && said.contains(why))))
        .to_vec();
        assert!(all.len() == 7 && found.iter().all(|found| found.1), "{found:?}\n{all:#?}");
    }

    #[test]
    fn a_misspelt_key_is_suggested_and_a_bare_file_name_works() {
        let all = refused_lines(&ROOM.replace("odometry.room", "odometry.rooom"));
        assert!(all[0].ends_with("; did you mean `room`?"), "{all:#?}");
        let all = refused_lines(&format!("{ROOM}[estimator]\nleast_moton_m = 0.2\nfoo = 1\n"));
        assert!(all[0].ends_with("; did you mean `least_motion_m`?") && !all[1].contains("did you mean"), "{all:#?}");
        let csv = |text: &str| {
            toml::from_str::<std::collections::BTreeMap<String, Csv>>(text).map(|map| map["csv"].file.clone())
        };
        assert_eq!(csv("csv = \"x.csv\"").unwrap(), csv("csv = { file = \"x.csv\" }").unwrap());
        assert!(csv("csv = { fil = \"x.csv\" }").is_err() && csv("csv = 3").is_err());
    }

    #[test]
    fn a_wrong_key_is_not_also_reported_as_missing() {
        let peers = "[[peer]]\nname = 3\nrecords.rom = {}\n[[peer]]\nname = \"tx\"\nrecords.room = {}\nfoo = 1\n";
        let all = refused_lines(&ROOM.replace("[[peer]]\nname = \"tx\"\nrecords.room = {}\n", peers));
        assert_eq!(all.len(), 3, "{all:#?}");
        assert!(all[0].starts_with("line 5: ") && all[1].starts_with("line 6: unknown variant `rom`"), "{all:#?}");
        assert!(all[2].starts_with("line 10: unknown field `foo`"), "{all:#?}");
        let nothing = refused_lines("antenna = \"A\"\n[output]\nbearing = \"x\"\n");
        assert!(nothing.len() == 3 && nothing[0].contains("missing field `channel`"), "{nothing:#?}");
        assert!(nothing[1].contains("missing field `capture`") && nothing[2].starts_with("line 3: "), "{nothing:#?}");
        // Text that is no TOML is refused as such, each place of it.
        let broken = refused_lines("[a\ny = 3\nz = [1,,2]\n");
        assert!(
            broken.len() == 2 && broken[0].starts_with("line 1: ") && broken[1].starts_with("line 3: "),
            "{broken:#?}"
        );
    }

    #[test]
    fn another_kind_of_file_is_one_problem_and_syntax_errors_are_few() {
        let other = refused("root:x:0:0:root\nbin:x:1:1:bin\nsys:x:2:2:sys\n");
        assert!(other.lines().count() == 1 && other.contains("no configuration in TOML"), "{other}");
        let broken: String = (0..20).map(|k| format!("a b {k}\n")).collect();
        let many = refused(&format!("{ROOM}{broken}"));
        assert!(many.lines().count() <= FEW_LINES && many.contains("further syntax errors"), "{many}");
    }

    /// Most lines that syntax errors take.
    const FEW_LINES: usize = 5;
}
