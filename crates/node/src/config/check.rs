//! Finds contradictions in a configuration, or with this machine.
//!
//! One function for each group of rules. A refusal names the place of the wrong key, or of the table that lacks one;
//! the spans of the TOML reader give its line.

use super::{Capture, Config, Odometry, Peer, Problem, Records, Room, Ros};
use crate::adapters;
use csi5300::exchange::tdma::{Plan, PlanError, Request};
use csi5300::motion::odometry::ros::{Stamp, plain};
use csi5300::pipeline::ArrayError;
use csi5300::source::side_path;
use csi5300_live::sounding::rate_n_flags;
use csi5300_ros2::name_part;
use csi5300_ros2::settings::{self, Distribution, Wrong};
use csi5300_sim::Scene;
use csi5300_sim::motion::RobotMotion;
use csi5300_sim::toml_lines::TomlLines;
use driver_iface::bfee::Antenna;
use nix::unistd::{AccessFlags, access};
use std::collections::BTreeSet;
use std::ops::RangeInclusive;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::os::unix::net::SocketAddr;
use std::path::Path;

/// Allowed speeds of a log or a room, relative to its own pace.
const SPEEDS: RangeInclusive<f64> = 1e-3..=1e3;
/// Records that can be let wait for or from the network: no fewer than come while a message is collected, no more than
/// some hundred megabytes.
const BACKLOGS: RangeInclusive<usize> = 256..=1_000_000;
const OPENCR_NOW: &str = "`opencr` poses are live and need a card (`capture.card` or `capture.stock`): with a replayed log use `csv`, in a room `room`";
const ROS_NOW: &str = "`ros` poses are live and need a card (`capture.card` or `capture.stock`): with a replayed log use `csv`; in a room that \
                       follows the topic (`follow`) use `room`";

/// A configuration that is being checked.
struct Check<'a> {
    config: &'a Config,
    /// The file that it was read from, if it was one.
    own_file: Option<&'a Path>,
    lines: TomlLines<'a>,
    /// Top-level keys with parts that were refused already.
    gone: &'a BTreeSet<String>,
    /// The simulated room's scene, if there is one.
    scene: Option<Scene>,
    problems: Vec<Problem>,
}

/// A wrong value below some table: its place there, and the reason.
type WrongBelow = (String, String);

/// All contradictions, except those that follow from `gone` keys.
pub(super) fn problems(
    config: &Config,
    own_file: Option<&Path>,
    lines: TomlLines<'_>,
    gone: &BTreeSet<String>,
) -> Vec<Problem> {
    let mut check = Check { config, own_file, lines, gone, scene: None, problems: Vec::new() };
    check.own_card();
    check.files_to_read();
    check.array();
    check.own_room();
    check.estimator();
    check.macs_of_the_room();
    check.speed();
    check.motion();
    check.own_poses();
    check.camera();
    check.ros();
    check.something_to_do();
    check.peers();
    check.team();
    check.sounding();
    check.output();
    check.files_to_write();
    check.network();
    check.problems
}

impl Check<'_> {
    /// The line of the value at `place`: keys and numbers of items from the root, `peer.0.records.replay.file`.
    fn line(&self, place: &str) -> Option<usize> {
        self.lines.line(place.split('.'))
    }

    /// Refuses the value at `place`.
    fn refuse(&mut self, place: &str, reason: impl Into<String>) {
        self.problems.push(Problem { line: self.line(place), reason: reason.into() });
    }

    /// Refuses the value that a table at the place has for a robot, whose name may be anything.
    fn refuse_name(&mut self, table: &str, name: &str, reason: String) {
        self.problems.push(Problem { line: self.lines.line(table.split('.').chain([name])), reason });
    }

    /// Refuses a key of a table, or the table.
    fn refuse_in(&mut self, table: &str, (key, reason): Wrong) {
        let place = key.map_or_else(|| table.to_owned(), |key| format!("{table}.{key}"));
        self.refuse(&place, reason);
    }

    /// True if all of these were readable, so a missing value is missing in the file.
    fn knows(&self, keys: &[&str]) -> bool {
        !keys.iter().any(|key| self.gone.contains(*key))
    }

    fn capture(&self) -> &Capture {
        self.config.capture.get_ref()
    }

    /// Records of a simulated room.
    fn is_room(&self) -> bool {
        matches!(self.capture(), Capture::Room(_) | Capture::Served(_))
    }

    fn is_replay(&self) -> bool {
        matches!(self.capture(), Capture::Replay(_))
    }

    /// Why a robot cannot be in the room, if the scene does not have it.
    fn absent(&self, name: &str) -> Option<String> {
        let scene = self.scene.as_ref().filter(|scene| scene.robot.iter().all(|robot| robot.name != name))?;
        let names: Vec<&str> = scene.robot.iter().map(|robot| robot.name.as_str()).collect();
        Some(format!("the scene has no robot `{name}`: it has {}", names.join(", ")))
    }

    /// A problem of a robot's poses; `own` are this robot's.
    fn wrong_poses(&self, poses: &Odometry, own: bool) -> Option<WrongBelow> {
        let of_now = self.is_room() || self.is_replay();
        let (key, why) = match poses {
            Odometry::Csv(_) if !self.is_replay() => {
                ("csv", "`csv` poses need a replayed capture, whose pace they follow")
            }
            Odometry::Opencr(_) if of_now => ("opencr", OPENCR_NOW),
            Odometry::Ros(_) if of_now => ("ros", ROS_NOW),
            Odometry::Ros2(_) if of_now => ("ros2", ROS_NOW),
            Odometry::Ros(_) | Odometry::Ros2(_) => return wrong_topic(poses, !own),
            Odometry::Room(_) if !self.is_room() => ("room", "`room` poses need `capture.room` or `capture.served`"),
            Odometry::Opencr(_) if !own => ("opencr", "a peer's port is not on this machine: use `network`"),
            Odometry::Network(_) if own => ("network", "this robot's own poses do not come over the network"),
            Odometry::Network(_) if self.config.network.is_none() => {
                ("network", "`network` poses need a [network] table")
            }
            _ => return None,
        };
        Some((key.into(), why.into()))
    }
}

/// Why poses leave no place for `antenna_offset_m`: they are of the antenna already.
fn offset_twice(poses: &Odometry, offset_m: [f64; 3]) -> Option<WrongBelow> {
    let why = match poses {
        _ if offset_m == [0.0; 3] => return None,
        Odometry::Ros2(topic) if topic.antenna_frame.is_some() => {
            "`antenna_frame` gives the antenna's place: leave `antenna_offset_m` out"
        }
        Odometry::Network(_) => {
            "`network` poses are of the peer's antenna: set `antenna_offset_m` in its own configuration, not here"
        }
        _ => return None,
    };
    Some(("antenna_offset_m".into(), why.into()))
}

impl Check<'_> {
    /// This robot's MAC.
    fn own_card(&mut self) {
        if self.config.mac.is_none() && !self.is_room() && self.knows(&["mac"]) {
            let why = "`mac`, the address of this robot's card, is missing: `ip link` shows it, and `csi5300 info` shows the \
                       senders in a log";
            self.refuse("capture", why);
        }
    }

    /// Every file that is read is there.
    fn files_to_read(&mut self) {
        for (place, file) in self.config.clone().inputs() {
            let (name, is_pipe) =
                (file.display(), std::fs::metadata(&file).is_ok_and(|found| found.file_type().is_fifo()));
            match place.as_str() {
                // A scene is refused with the reason, and the room of a socket may begin later.
                "capture.room.scene" | "capture.served.socket" => {}
                "capture.feitcsi.pipe" if !is_pipe => {
                    let why = format!("{name} is no named pipe: `mkfifo` makes one, and FeitCSI writes to it");
                    self.refuse(&place, why);
                }
                "capture.feitcsi.pipe" => {}
                _ if !file.is_file() => self.refuse(&place, format!("there is no file {name}")),
                _ => {}
            }
        }
    }

    /// The antennas of bearings without a peer.
    fn array(&mut self) {
        if let Some(Err(error)) = self.config.array.as_ref().map(|array| array.array()) {
            let key = match error {
                ArrayError::Antennas { .. } | ArrayError::Twice { .. } => "array.antennas",
                ArrayError::Constants { .. } => "array.chain_constants_deg",
                _ => "array.baselines_m",
            };
            self.refuse(key, format!("[array]: {error}"));
        }
    }

    /// The scene of a simulated room, and this robot and those that follow something in it.
    fn own_room(&mut self) {
        let config = self.config;
        let Capture::Room(asked) = config.capture.get_ref() else { return };
        match asked.load_scene() {
            Ok(scene) => self.scene = Some(scene),
            Err(error) => self.refuse("capture.room.scene", error.to_string()),
        }
        if let Some(why) = self.absent(&asked.robot) {
            self.refuse("capture.room.robot", why);
        }
        let wrong = self.scene.as_ref().map(|scene| wrong_followed(asked, scene));
        for (robot, why) in wrong.into_iter().flatten() {
            self.refuse_name("capture.room.follow", &robot, why);
        }
    }

    /// MACs that are not those of the simulated room.
    fn macs_of_the_room(&mut self) {
        let config = self.config;
        let Capture::Room(asked) = config.capture.get_ref() else { return };
        let Some(room) = self.scene.as_ref().and_then(|scene| csi5300_sim::Room::new(scene).ok()) else { return };
        let own = (asked.robot.as_str(), config.mac, "mac".to_owned());
        let peers = config.peer.iter().map(|peer| peer.get_ref()).enumerate();
        let peers = peers.map(|(k, peer)| (peer.name.as_str(), peer.mac, format!("peer.{k}.mac")));
        for (name, mac, place) in std::iter::once(own).chain(peers) {
            let is = room.number(name).and_then(|number| room.mac(number));
            if let (Some(mac), Some(is)) = (mac, is)
                && mac != is
            {
                self.refuse(&place, format!("`{name}` has the MAC {is} in this room, not {mac}: leave `mac` out"));
            }
        }
    }

    /// Without relative motion there is no bearing.
    fn motion(&mut self) {
        let stands = |odometry: &Odometry| matches!(odometry, Odometry::Static(_));
        let peers = &self.config.peer;
        let has_constants = self.config.array.as_ref().is_some_and(|array| !array.chain_constants_deg.is_empty());
        if has_constants && peers.iter().all(|peer| matches!(peer.get_ref().records, Records::Heard(_))) {
            return;
        }
        let all_stand = stands(&self.config.odometry) && peers.iter().all(|peer| stands(&peer.get_ref().poses));
        if !peers.is_empty() && all_stand && self.knows(&["odometry", "peer"]) {
            let why = "no robot here ever moves (`static` poses, also where none are given), and without motion there is no \
                       bearing: give this robot `odometry` or a peer `poses`";
            self.refuse("peer.0", why);
        }
    }

    /// This robot's poses and its antenna's place.
    fn own_poses(&mut self) {
        let config = self.config;
        if let Some((place, why)) = self.wrong_poses(&config.odometry, true) {
            self.refuse(&format!("odometry.{place}"), why);
        }
        if let Some((place, why)) = offset_twice(&config.odometry, config.antenna_offset_m) {
            self.refuse(&place, why);
        }
    }

    /// How this robot carries its camera.
    fn camera(&mut self) {
        let why = match &self.config.odometry {
            _ if self.config.camera_mount.is_none() => return,
            Odometry::Ros2(topic) if topic.antenna_frame.is_some() => {
                "`antenna_frame` moves poses to the antenna: leave it out, `antenna_offset_m` is where the antenna is"
            }
            Odometry::Csv(_) | Odometry::Ros(_) | Odometry::Ros2(_) => {
                if self.knows(&["antenna_offset_m"]) && self.line("antenna_offset_m").is_none() {
                    let why = "camera_mount also needs `antenna_offset_m`, from the middle between the wheels; \
                               [0.0, 0.0, 0.0] is an antenna there";
                    self.refuse("camera_mount", why);
                }
                return;
            }
            Odometry::Opencr(_) => "`opencr` poses are of the wheels already",
            Odometry::Room(_) => "`room` poses are of the robot, not of a camera on it",
            Odometry::Static(_) | Odometry::Network(_) => "this robot has no poses of a camera",
        };
        let why = format!("camera_mount is for poses of a tracking camera (`csv`, `ros`, `ros2`): {why}");
        self.refuse("camera_mount", why);
    }

    /// A program without a purpose.
    fn something_to_do(&mut self) {
        let config = self.config;
        if config.peer.is_empty()
            && config.array.is_none()
            && config.log.is_none()
            && config.network.is_none()
            && config.ros.is_none()
            && config.ros2.is_none()
            && self.knows(&["peer", "array", "log", "network", "ros", "ros2"])
        {
            let why = "no [[peer]], no [array], no [log], no [network] and no [ros] or [ros2]: there is nothing to do";
            self.refuse("capture", why);
        }
    }

    /// How bearings are made.
    fn estimator(&mut self) {
        let asked = &self.config.estimator;
        let ranges = [
            ("elevation_max_deg", asked.elevation_max_deg, 0.0..=90.0, "0 to 90 degrees"),
            ("accurate_every_s", Some(asked.accurate_every_s), 0.0..=3_600.0, "0 to 3600 seconds"),
            (
                "extrapolate_s",
                Some(asked.extrapolate_s),
                0.0..=1.0,
                "0 to 1 second; a robot is somewhere else after a longer time",
            ),
            ("heading_sd_deg", asked.heading_sd_deg, 0.0..=180.0, "0 to 180 degrees"),
            // From one in a thousand seconds to more than any processor manages.
            ("rate_hz", Some(asked.rate_hz), 1e-3..=100.0, "0.001 to 100 bearings of each peer a second"),
        ];
        for (key, value, range, words) in ranges {
            if value.is_some_and(|value| !range.contains(&value)) {
                self.refuse(&format!("estimator.{key}"), format!("{key} in [estimator]: {words}"));
            }
        }
        let least_m = asked.motion_needed_m(self.config.channel.wavelength_m());
        if least_m > asked.window_m {
            let key = if asked.least_motion_m.is_some() { "least_motion_m" } else { "window_m" };
            let why = format!(
                "window_m ({:.3} m) is less than the motion needed, {least_m:.3} m: there would never be a bearing",
                asked.window_m
            );
            self.refuse(&format!("estimator.{key}"), why);
        }
    }

    /// Speeds of replayed and simulated sources.
    fn speed(&mut self) {
        let (place, speed) = match self.capture() {
            Capture::Replay(replay) => ("capture.replay.speed", replay.speed),
            Capture::Room(room) => ("capture.room.speed", room.speed),
            Capture::Card(_) | Capture::Stock(_) | Capture::Feitcsi(_) | Capture::Served(_) => return,
        };
        if !SPEEDS.contains(&speed) {
            let why = format!("speed: {} to {} times its own pace, not {speed:e}", SPEEDS.start(), SPEEDS.end());
            self.refuse(place, why);
        }
    }

    /// Every peer.
    fn peers(&mut self) {
        let config = self.config;
        for (k, peer) in config.peer.iter().map(|peer| peer.get_ref()).enumerate() {
            let poses = self.wrong_poses(&peer.poses, false).map(|(place, why)| (format!("poses.{place}"), why));
            let offset = offset_twice(&peer.poses, peer.antenna_offset_m);
            let wrong = poses.into_iter().chain(offset).chain(self.wrong_records(peer));
            for (place, why) in wrong.chain(self.wrong_identity(k, peer)) {
                self.refuse(&format!("peer.{k}.{place}"), format!("peer `{}`: {why}", peer.name));
            }
        }
    }

    /// A peer's name, MAC and certificate.
    fn wrong_identity(&self, k: usize, peer: &Peer) -> Vec<WrongBelow> {
        let mut wrong = Vec::new();
        let mut refuse = |key: &str, why: &str| wrong.push((key.to_owned(), why.to_owned()));
        let others = || self.config.peer.iter().take(k).map(|other| other.get_ref());
        let same_name = others().any(|other| other.name == peer.name);
        if same_name || others().any(|other| other.mac.is_some() && other.mac == peer.mac) {
            refuse(if same_name { "name" } else { "mac" }, "another peer has its name or MAC");
        }
        let part = name_part(&peer.name);
        let in_ros = self.config.ros.is_some() || self.config.ros2.is_some();
        if part.is_empty() {
            refuse("name", "a peer needs a name");
        } else if let Some(other) = others().find(|other| in_ros && !same_name && name_part(&other.name) == part) {
            refuse("name", &format!("in ROS its topics have the names of those of `{}`", other.name));
        }
        let has_own = match peer.records {
            Records::Room(_) => true,
            Records::Heard(_) => matches!(self.capture(), Capture::Room(_)),
            _ => false,
        };
        if peer.mac.is_none() && !has_own {
            refuse("mac", "`mac` is missing");
        }
        if peer.mac.is_some() && peer.mac == self.config.mac {
            refuse("mac", "its MAC is this robot's own MAC");
        }
        if self.config.name.as_ref() == Some(&peer.name) {
            refuse("name", "its name is this robot's own name");
        }
        if peer.yaw_deg.abs() > 0.0 && matches!(peer.poses, Odometry::Static(_)) {
            refuse("yaw_deg", "`yaw_deg` turns the frame of its poses, and it has none: leave it out");
        }
        let by_network = matches!(peer.records, Records::Network(_)) || matches!(peer.poses, Odometry::Network(_));
        match &peer.certificate {
            Some(name) if name.trim().is_empty() => {
                refuse("certificate", "`certificate` is the common name in its certificate");
            }
            Some(_) if !by_network => {
                refuse("certificate", "`certificate` is for records and poses of the network, and none are");
            }
            _ => {}
        }
        wrong
    }

    /// A peer's records.
    fn wrong_records(&self, peer: &Peer) -> Option<WrongBelow> {
        let is_own = self.capture().robot() == Some(&peer.name);
        let stands = matches!(peer.poses, Odometry::Static(_));
        let sounding = self.config.sounding.as_ref();
        let (place, why) = match &peer.records {
            Records::Replay(_) if !self.is_replay() => {
                ("records.replay", "a replayed log needs `capture.replay`, whose pace it follows")
            }
            Records::Room(_) if !self.is_room() => {
                ("records.room", "`room` records need `capture.room` or `capture.served`")
            }
            Records::Network(_) if self.config.network.is_none() => {
                ("records.network", "`network` records need a [network] table")
            }
            Records::Heard(_) if self.config.array.is_none() && self.knows(&["array"]) => {
                ("records.heard", "`heard` is of antennas of this robot's card: it needs an [array] table")
            }
            Records::Heard(_) if peer.poses != Odometry::default() => {
                ("records.heard", "a sender that is only heard has no poses: leave `poses` out")
            }
            Records::Sounding(_) if !sounding.is_some_and(|own| own.initiate && own.measurement) => {
                let why = "`sounding` records come with the answers to this robot's frames: they need a [sounding] table with \
                           `initiate` and `measurement`";
                ("records.sounding", why)
            }
            Records::Sounding(_) if !stands => {
                let why = "`sounding` records have no time of the peer's host, so it must stand (`poses.static`)";
                ("records.sounding", why)
            }
            Records::Room(_) | Records::Heard(_) if is_own => {
                ("name", "it is this robot itself: the one of the room that `capture` names")
            }
            Records::Heard(_) if peer.mac.is_some() => return None,
            Records::Room(_) | Records::Heard(_) => return Some(("name".into(), self.absent(&peer.name)?)),
            Records::Replay(_) | Records::Network(_) | Records::Sounding(_) => return None,
        };
        Some((place.into(), why.into()))
    }

    /// Known places and ranges of the team's graph.
    fn team(&mut self) {
        let config = self.config;
        let Some(team) = &config.team else { return };
        if config.peer.is_empty() && self.knows(&["peer"]) {
            self.refuse("team", "[team] needs a [[peer]]: the graph is made of bearings");
        }
        let has_poses = |name: &String| {
            let peers = config.peer.iter().map(|peer| peer.get_ref());
            peers.filter(|peer| peer.name == *name).any(|peer| !matches!(peer.poses, Odometry::Static(_)))
        };
        let moves = "a known place is that of a peer that stands: leave it out, or the peer's `poses`";
        let places = team.places.keys().map(|name| ("places", name, has_poses(name).then(|| moves.to_owned())));
        let ranges = team.ranges.iter().map(|(name, ranges)| ("ranges", name, settings::wrong_name(&ranges.topic)));
        for (key, name, wrong) in places.chain(ranges) {
            let is_peer = config.peer.iter().any(|peer| peer.get_ref().name == *name);
            let unknown = (!is_peer && self.knows(&["peer"])).then(|| format!("there is no peer `{name}`"));
            if let Some(why) = unknown.or(wrong) {
                self.refuse_name(&format!("team.{key}"), name, format!("[team]: {key}: {name}: {why}"));
            }
        }
        let own_frame = config.ros2.as_ref().map(|ros| ros.frame.as_str());
        if let Some(why) = settings::wrong_frame(&team.frame) {
            self.refuse("team.frame", format!("[team]: {why}"));
        } else if !team.places.is_empty() && own_frame == Some(team.frame.as_str()) {
            let why = "[team]: frame: the places need a frame other than that of the odometry ([ros2] frame)";
            self.refuse("team.frame", why);
        }
    }

    /// This program as a node of ROS.
    fn ros(&mut self) {
        let config = self.config;
        if let Some(wrong) = config.ros.as_ref().and_then(wrong_ros) {
            self.refuse_in("ros", wrong);
        }
        if let Some(wrong) = settings::wrong_settings(&config.ros2.clone().unwrap_or_default())
            && config.uses_ros2()
        {
            self.refuse_in("ros2", wrong);
        }
        let poses = match &config.odometry {
            Odometry::Ros(topic) => topic.frame.as_deref(),
            Odometry::Ros2(topic) => topic.frame.as_deref(),
            _ => None,
        };
        let tables =
            [("ros", config.ros.as_ref().map(|ros| &ros.frame)), ("ros2", config.ros2.as_ref().map(|ros| &ros.frame))];
        for (table, said) in tables {
            let Some((said, poses)) = said.zip(poses).filter(|(said, poses)| plain(said) != plain(poses)) else {
                continue;
            };
            let why = format!("[{table}]: frame: `{said}` is not the frame of this robot's poses: frame = \"{poses}\"");
            self.refuse(&format!("{table}.frame"), why);
        }
    }

    /// This robot's part in the sounding exchange.
    fn sounding(&mut self) {
        if let Some((key, why)) = self.wrong_sounding().filter(|_| self.knows(&["peer"])) {
            self.refuse_in("sounding", (key, format!("[sounding]: {why}")));
        }
    }

    /// Why this robot cannot take part as asked: the key in `[sounding]`, if it is one, and the reason.
    fn wrong_sounding(&self) -> Option<Wrong> {
        let config = self.config;
        let asked = config.sounding.as_ref()?;
        let (key, why) = match (self.capture(), &asked.interface) {
            (Capture::Card(_) | Capture::Stock(_), None) => (None, "`interface`, a monitor interface, is missing"),
            (Capture::Served(_), Some(_)) => {
                (Some("interface"), "a served room is the air itself: leave `interface` out")
            }
            (Capture::Feitcsi(_) | Capture::Replay(_) | Capture::Room(_), _) => {
                (None, "it is done with a card: it needs `capture.card`, `capture.stock` or `capture.served`")
            }
            _ if config.answering() == 0 => (None, "it needs a [[peer]] to sound"),
            _ if asked.links.is_some_and(|links| links > 0 && usize::from(links) < config.answering()) => {
                (Some("links"), "links: a round needs as many slots as there are peers, or more")
            }
            _ => return wrong_plan(&config.sounding_request()?),
        };
        Some((key, why.into()))
    }

    /// What is published.
    fn output(&mut self) {
        if let Some(why) = self.config.output.foxglove.and_then(|_| adapters::missing("foxglove")) {
            self.refuse("output.foxglove", format!("foxglove in [output] {why}"));
        }
        if self.config.output.foxglove.is_none() && !self.config.output.foxglove_origins.is_empty() {
            self.refuse("output.foxglove_origins", "foxglove_origins needs `foxglove`, the address to serve");
        }
    }

    /// The network of the robots.
    fn network(&mut self) {
        let Some(network) = &self.config.network else { return };
        let wrong = adapters::missing("zenoh").map(|why| format!("[network] {why}"));
        #[cfg(feature = "zenoh")]
        let wrong = wrong.or_else(|| adapters::zenoh::refusal(self.config));
        if let Some(why) = wrong {
            self.refuse("network", why);
        }
        if network.publish_poses && matches!(self.config.odometry, Odometry::Static(_)) && self.knows(&["odometry"]) {
            let why = "publish_poses: this robot has no `odometry` to publish: leave it out, and `poses` where this robot is a peer";
            self.refuse("network.publish_poses", why);
        }
        if network.backlog.is_some_and(|backlog| !BACKLOGS.contains(&backlog)) {
            self.refuse("network.backlog", format!("backlog: {} to {} records", BACKLOGS.start(), BACKLOGS.end()));
        }
        if network.ros2 && !self.config.uses_ros2() && self.knows(&["capture", "odometry", "peer", "ros2"]) {
            self.refuse("network.ros2", "there are no topics to carry: no [ros2] table, and no `ros2` poses");
        }
        let humble = Some(Distribution::Humble);
        if network.ros2 && self.config.ros2.as_ref().map(|ros| ros.distribution) == humble {
            self.refuse("network.ros2", "topics over zenoh are those of Jazzy and later, not of \"humble\"");
        }
    }
}

/// The problem of a name of a node or topic: it must start at the root, with parts of letters, digits and `_`. ROS 1 lets a part
/// begin with a digit.
fn wrong_ros_name(name: &str) -> Option<String> {
    let part = |part: &str| !part.is_empty() && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    let good = name.strip_prefix('/').is_some_and(|parts| parts.split('/').all(part));
    (!good).then(|| format!("`{name}` is not a valid ROS name: use one like /tb3_0/odom"))
}

/// The problem of poses from a topic: of this robot, of a peer, or of a robot that the room follows.
fn wrong_topic(odometry: &Odometry, of_peer: bool) -> Option<WrongBelow> {
    let (protocol, stamp, wrong) = match odometry {
        Odometry::Ros(topic) => ("ros", topic.stamp, wrong_ros_name(&topic.topic).map(|why| (Some("topic"), why))),
        Odometry::Ros2(topic) => ("ros2", topic.stamp, settings::wrong_topic(topic)),
        _ => return None,
    };
    // The exchanges give a peer's clock offset, which is applied to its poses.
    let late = (of_peer && stamp == Some(Stamp::Receipt))
        .then(|| (Some("stamp"), "a peer's poses have the times of its own clock: `stamp = \"header\"`".to_owned()));
    let (key, why) = late.or(wrong)?;
    Some((key.map_or_else(|| protocol.to_owned(), |key| format!("{protocol}.{key}")), why))
}

/// What is wrong with a source that a robot of the room follows.
fn wrong_source(room: &Room, odometry: &Odometry) -> Option<String> {
    let stamp = match odometry {
        Odometry::Csv(_) => return None,
        Odometry::Ros(topic) => topic.stamp,
        Odometry::Ros2(topic) => topic.stamp,
        _ => return Some("a robot follows `ros2`, `ros` or `csv`".into()),
    };
    if room.speed != 1.0 {
        return Some("topics are live: use `speed = 1`".into());
    }
    if stamp == Some(Stamp::Header) {
        return Some("the room uses the times of arrival: `stamp = \"receipt\"`, or none".into());
    }
    wrong_topic(odometry, false).map(|(_, why)| why)
}

/// What is wrong with the sources that robots of the room follow, by the robot's name, and with robots that have none.
fn wrong_followed(room: &Room, scene: &Scene) -> Vec<(String, String)> {
    let is_followed = |motion: &RobotMotion| matches!(motion, RobotMotion::Followed(_));
    let mut wrong = Vec::new();
    for (name, odometry) in &room.follow {
        let why = match scene.robot.iter().find(|robot| robot.name == *name) {
            None => Some(format!("the scene has no robot `{name}`")),
            Some(robot) if !is_followed(&robot.motion) => {
                Some(format!("robot `{name}` moves as the scene says: give it `motion.followed = {{}}`"))
            }
            Some(_) => wrong_source(room, odometry),
        };
        wrong.extend(why.map(|why| (name.clone(), format!("follow `{name}`: {why}"))));
    }
    for robot in scene.robot.iter().filter(|robot| is_followed(&robot.motion)) {
        let name = &robot.name;
        if !room.follow.contains_key(name) {
            let why =
                format!("robot `{name}` of the scene follows nothing: `follow.{name}.ros.topic = \"/{name}/odom\"`");
            wrong.push((name.clone(), why));
        }
    }
    wrong
}

/// What is wrong with the `[ros]` table: the key, if it is one, and why.
fn wrong_ros(ros: &Ros) -> Option<Wrong> {
    let master = ros.master.as_ref().filter(|master| !master.starts_with("http://"));
    if let Some(master) = master {
        return Some((Some("master"), format!("master `{master}`: one looks like http://192.168.1.10:11311")));
    }
    ros.node.as_deref().and_then(wrong_ros_name).map(|why| (Some("node"), why))
}

/// Why there is no plan for a request: the key that is wrong, if it is one, and the reason.
fn wrong_plan(request: &Request) -> Option<Wrong> {
    if rate_n_flags(request.phy, Antenna::A).is_none() {
        let mcs = request.phy.mcs;
        let why = format!("mcs {mcs} has more streams than the card has antennas: 23 is the highest");
        return Some((Some("mcs"), why));
    }
    let error = Plan::new(request).err()?;
    let key = match error {
        PlanError::Rate { .. } | PlanError::NotARate(_) => Some("rate_hz"),
        PlanError::Links(_) => Some("links"),
        PlanError::Mcs(_) => Some("mcs"),
        _ => None,
    };
    Some((key, error.to_string()))
}

/// Folders that the service makes when it starts, for its own user (`packaging/csi5300-node.service`).
const OF_SERVICE: [&str; 2] = ["/var/lib/csi5300", "/run/csi5300"];

/// Bytes of a socket's name at most: `sun_path` in `<linux/un.h>`, with a zero at its end.
const NAME_OF_SOCKET: usize = 107;

/// How an output's name is used.
#[derive(Clone, Copy)]
enum Kind {
    /// A new file beside existing ones.
    Log,
    /// A file to append to, made if absent.
    Lines,
    /// A new socket.
    Socket,
    /// A new folder beside existing ones, with its parents.
    Folder,
}

impl Check<'_> {
    /// The log, the file of bearings, the status socket, the recording of ROS 2.
    fn files_to_write(&mut self) {
        let config = self.config;
        let (output, bag) = (&config.output, config.ros2.as_ref().and_then(|ros| ros.bag.as_deref()));
        let bearings = Some(Path::new(&output.bearings)).filter(|_| !["", "-"].contains(&output.bearings.as_str()));
        let files = [
            ("log.file", Kind::Log, config.log.as_ref().map(|log| log.file.as_path())),
            ("output.bearings", Kind::Lines, bearings),
            ("output.status_socket", Kind::Socket, output.status_socket.as_deref()),
            ("ros2.bag", Kind::Folder, bag),
        ];
        let mut read = config.clone();
        let inputs = read.inputs();
        let mut before: Vec<(&str, &Path)> = Vec::new();
        for (place, kind, file) in files {
            let Some(file) = file else { continue };
            let read = inputs.iter().find(|(_, input)| is_one(input, file)).map(|(input, _)| {
                format!(
                    "{} is an input ({}): name another output",
                    file.display(),
                    self.line(input).map_or_else(|| input.clone(), |line| format!("line {line}"))
                )
            });
            let twice = before.iter().find(|(_, other)| is_one(other, file)).map(|(name, _)| {
                format!("{} is also the output of `{name}`: they would overwrite each other", file.display())
            });
            let itself = self.own_file.is_some_and(|own| is_one(own, file));
            let itself = itself.then(|| format!("{} is this configuration", file.display()));
            if let Some(why) = unwritable(file, kind).or(read).or(twice).or(itself) {
                self.refuse(place, why);
            }
            before.push((place, file));
        }
    }
}

/// True for two names of one file, also of a future one; the side file of a log counts too.
fn is_one(a: &Path, b: &Path) -> bool {
    let place = |file: &Path| {
        let there = folder_of(file).canonicalize().unwrap_or_else(|_| folder_of(file).to_owned());
        file.canonicalize().unwrap_or_else(|_| there.join(file.file_name().unwrap_or_default()))
    };
    // Hard links are compared by inode; devices may be shared.
    let number = |file: &Path| {
        let found = file.metadata().ok().filter(|found| !found.file_type().is_char_device())?;
        Some((found.dev(), found.ino()))
    };
    let is_same = |a: &Path, b: &Path| place(a) == place(b) || (number(a).is_some() && number(a) == number(b));
    // A log that is read by a link may have its side file beside the link, or beside the log.
    let sides = [side_path(a), side_path(&place(a))];
    is_same(a, b) || sides.iter().any(|side| is_same(side, b))
}

/// Why an output cannot be written, as far as that shows without writing.
fn unwritable(file: &Path, kind: Kind) -> Option<String> {
    if OF_SERVICE.iter().any(|own| file.parent().is_some_and(|folder| folder.starts_with(own))) {
        return None;
    }
    let there = std::fs::metadata(file).ok().map(|found| found.file_type());
    let why = match (kind, there) {
        _ if file.as_os_str().is_empty() => return Some("an empty name is no file: leave the key out for none".into()),
        (Kind::Socket, _) if SocketAddr::from_pathname(file).is_err() => {
            format!("it has {} bytes, and the name of a socket at most {NAME_OF_SOCKET}", file.as_os_str().len())
        }
        (Kind::Log | Kind::Lines, Some(there)) if there.is_dir() => "it is a folder".to_owned(),
        (Kind::Log, Some(there)) if !there.is_file() => "it is no regular file".to_owned(),
        (Kind::Lines, Some(there)) if there.is_socket() => "it is a socket".to_owned(),
        (Kind::Lines, Some(_)) => access(file, AccessFlags::W_OK).err()?.desc().to_owned(),
        (Kind::Socket, Some(there)) if !there.is_socket() => "it is there and no socket".to_owned(),
        (Kind::Folder, _) => {
            let above = folder_of(file).ancestors().find(|folder| folder.exists()).map_or(Path::new("."), here);
            unusable(above)?
        }
        (Kind::Log | Kind::Lines | Kind::Socket, _) => unusable(folder_of(file))?,
    };
    Some(format!("cannot write {}: {why}", file.display()))
}

/// The folder that a file is in.
fn folder_of(file: &Path) -> &Path {
    file.parent().map_or(Path::new("."), here)
}

/// The folder does not exist.
fn here(folder: &Path) -> &Path {
    if folder == Path::new("") { Path::new(".") } else { folder }
}

/// Why nothing can be made in a folder.
fn unusable(folder: &Path) -> Option<String> {
    Some(match folder {
        _ if !folder.exists() => format!("there is no folder {}", folder.display()),
        _ if !folder.is_dir() => format!("{} is no folder", folder.display()),
        _ => format!("{}: {}", folder.display(), access(folder, AccessFlags::W_OK | AccessFlags::X_OK).err()?.desc()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A valid room; peers come last.
    const ROOM: &str = "name = 'here'\nchannel = '108'\n\n# A comment that names mac, odometry and rate_hz.\n\
                        capture.room = { scene = 'lab-circle', robot = 'rx' }\nodometry.room = {}\n";
    /// A valid card, except for missing features.
    const CARD: &str = "name = 'here'\nchannel = '108'\nmac = '02:00:00:00:00:01'\ncapture.card = {}\n\
                        odometry.opencr.port = '/dev/null'\n[log]\nfile = 'x.dat'\n";
    const PEER: &str = "[[peer]]\nname = 'tx'\nyaw_deg = 0.0\nrecords.room = {}\n";
    /// A peer whose records come over the network.
    const LINKED: &str = "[[peer]]\nname = 'b'\nmac = '02:00:00:00:00:02'\nrecords.network = {}\n";
    /// The line of the room's capture, and of the card's poses.
    const IN_ROOM: &str = "capture.room = { scene = 'lab-circle', robot = 'rx' }\n";
    const WHEELS: &str = "odometry.opencr.port = '/dev/null'";
    const MOUNT: &str = "camera_mount = { forward_m = 0.04, left_m = 0.17, yaw_deg = -1.5 }";
    const ITSELF: &str = "[[peer]]\nrecords.room = {}\nname = 'rx' # itself\n";
    const ARRAY: &str = "[array]\nantennas = ['A', 'B']\nbaselines_m = [[0.1, 0.0, 0.0]]\n";
    const HEARD: &str = "[[peer]]\nname = 'tx'\nrecords.heard = {}\n";
    const MONITOR: &str = "[sounding]\ninterface = 'mon0'\n";

    /// A room with a peer, and more lines.
    fn room(more: &str) -> String {
        [ROOM, PEER, more].concat()
    }

    fn card(more: &str) -> String {
        [CARD, more].concat()
    }

    /// A card with a peer, and more lines.
    fn linked(more: &str) -> String {
        [CARD, LINKED, more].concat()
    }

    /// A text with other words in place of some that it has.
    #[track_caller]
    fn swap(text: &str, old: &str, new: &str) -> String {
        assert!(text.contains(old), "no {old} in {text}");
        text.replace(old, new)
    }

    /// The card with other poses.
    fn posed(poses: &str) -> String {
        swap(CARD, WHEELS, poses)
    }

    /// The card's configuration with another capture.
    fn capture(capture: &str) -> String {
        swap(CARD, "capture.card = {}", capture)
    }

    /// Each text is refused for the reason, in the line with the key.
    #[track_caller]
    fn all_refused<const N: usize>(cases: [(&str, &str, String); N]) {
        for (key, why, text) in cases {
            refused(&text, key, why);
        }
    }

    /// Refusals of a text, each `line N: why`.
    fn refusals(text: &str) -> Vec<String> {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/src"));
        let refused = Config::read(text, folder).err().map(|error| error.to_string());
        refused.unwrap_or_default().lines().map(str::to_owned).collect()
    }

    /// One of the refusals is `wanted`, from its beginning; its line is that of `key` in the text.
    #[track_caller]
    fn refused(text: &str, key: &str, why: &str) {
        let line = text.lines().position(|line| line.contains(key)).unwrap() + 1;
        let all = refusals(text);
        let is_it = |refusal: &&String| refusal.starts_with(&format!("line {line}: ")) && refusal.contains(why);
        assert!(all.iter().any(|refusal| is_it(&refusal)), "line {line} ({key}), {why}: {all:?}\n{text}");
    }

    #[track_caller]
    fn good(text: &str) {
        assert_eq!(refusals(text), Vec::<String>::new(), "{text}");
    }

    #[test]
    fn a_team_is_of_known_peers() {
        good(&room("[team]\nplaces = { tx = [1.0, 2.0] }\nframe = 'hall'\n"));
        good(&room("[team]\nranges.tx = { topic = '/uwb/tx' }\n"));
        all_refused([
            ("places", "no peer `ty`", room("[team]\nframe = 'hall'\nplaces.ty = [1.0, 2.0]\n")),
            ("places", "leave it out", room("poses.room = {}\n[team]\nplaces.tx = [1.0, 2.0]\n")),
            ("places", "finite", room("[team]\nplaces.tx = [1.0, inf]\n")),
            ("places", "3 numbers where 2 are expected", room("[team]\nplaces.tx = [1.0, 2.0, 3.0]\n")),
            (
                "antenna_offset_m",
                "4 numbers where 3",
                swap(&room(""), "odometry.room", "antenna_offset_m = [0, 0, 0, 7]\nodometry.room"),
            ),
            ("place = ", "unknown field", room("[team]\nplaces = {}\nplace = {}\n")),
            ("ranges", "no peer `ty`", room("[team]\nframe = 'map'\nranges.ty = { topic = '/uwb/ty' }\n")),
            ("ranges", "not a valid ROS 2 name", room("[team]\nframe = 'map'\nranges.tx = { topic = '/uwb tx' }\n")),
            ("ranges", "above 0", room("[team]\nframe = 'map'\nranges.tx = { topic = '/uwb', sd_m = 0.0 }\n")),
            ("frame", "other than", room("[team]\nframe = 'map'\nplaces.tx = [1.0, 2.0]\n[ros2]\nframe = 'map'\n")),
            ("[team]", "needs a [[peer]]", card("[team]\n")),
        ]);
    }

    #[test]
    fn a_robot_has_a_card_or_a_place_in_a_room() {
        good(&room(""));
        good(CARD);
        good(&capture("capture.stock.frames = true"));
        all_refused([
            ("frame", "unknown field", capture("capture.stock.frame = true")),
            ("capture.card", "`mac`", swap(CARD, "mac = '02:00:00:00:00:01'\n", "")),
            (
                "no.dat",
                "there is no file",
                swap(&card("[capture.replay]\nspeed = 2\nfile = 'no.dat'\n"), "capture.card = {}\n", ""),
            ),
            (
                "no.toml",
                "no.toml",
                swap(&room("[capture.room]\nspeed = 2.0\nscene = 'no.toml'\nrobot = 'rx'\n"), IN_ROOM, ""),
            ),
            (
                "nobody",
                "no robot `nobody`: it has rx, tx",
                swap(&room("[capture.room]\nscene = 'lab-circle'\nrobot = 'nobody'\n"), IN_ROOM, ""),
            ),
            ("mac =", "`rx` has the MAC", swap(&room(""), "channel", "mac = '02:00:00:00:00:99'\nchannel")),
            ("mac =", "`tx` has the MAC", room("mac = '02:00:00:00:00:99'\n")),
            ("[[peer]]", "no robot here ever moves", swap(&room(""), "odometry.room = {}\n", "")),
            ("capture.card", "there is nothing to do", swap(CARD, "[log]\nfile = 'x.dat'\n", "")),
        ]);
    }

    #[test]
    fn numbers_are_in_their_ranges() {
        let estimator = |line: &str| room(&format!("[estimator]\naccurate = true\n{line}\n"));
        good(&room("antenna_offset_m = [0, 0, -10]\n"));
        all_refused([
            ("elevation_max_deg =", "", estimator("elevation_max_deg = 91.0")),
            ("heading_sd_deg =", "", estimator("heading_sd_deg = -1.0")),
            ("accurate_every_s =", "", estimator("accurate_every_s = -1.0")),
            ("extrapolate_s =", "", estimator("extrapolate_s = 2.0")),
            ("window_m =", "window_m (0.050 m)", estimator("window_m = 0.05")),
            ("least_motion_m =", "", estimator("least_motion_m = 9.0")),
            ("rate_hz =", "rate_hz in [estimator]", estimator("rate_hz = 101.0")),
            ("rate_hz =", "rate_hz in [estimator]", estimator("rate_hz = 1e-9")),
            (
                "antenna_offset_m",
                "inf: metres from the middle of the robot",
                swap(&room(""), "odometry.room", "antenna_offset_m = [0.0,\n  inf, 0.0]\nodometry.room"),
            ),
            (
                "nan",
                "must be finite",
                swap(
                    &room(""),
                    "odometry.room = {}",
                    "[odometry.static]\nposition_m = [0.0, 0.0, 0.0]\nheading_deg = nan",
                ),
            ),
            ("nan", "must be finite", swap(&room(""), "yaw_deg = 0.0", "yaw_deg = nan")),
            ("yaw_deg", "leave it out", swap(&room(""), "yaw_deg = 0.0", "yaw_deg = 3.0")),
            ("nan", "metres from", room("antenna_offset_m = [0, nan, 0]\n")),
            ("inf", "must be finite", room("[peer.poses.static]\nheading_deg = 1.0\nposition_m = [0, 0, inf]\n")),
            (
                "1e300",
                "10 at most",
                swap(&room(""), "odometry.room", "antenna_offset_m = [1e300, 0.0, 0.0]\nodometry.room"),
            ),
            ("antenna_offset_m", "-10.5: metres from", room("antenna_offset_m = [0, 0,\n-10.5]\n")),
        ]);
    }

    #[test]
    fn a_mount_needs_poses_of_a_camera() {
        let mounted = |poses: &str| posed(&format!("{MOUNT}\n{poses}"));
        // An antenna that nobody placed is not taken for one in the middle between the wheels.
        let topic = "odometry.ros2 = { topic = '/odom' }";
        good(&mounted(&format!("antenna_offset_m = [0, 0, 0]\n{topic}")));
        refused(&mounted(topic), "camera_mount", "also needs `antenna_offset_m`");
        all_refused([
            (
                "camera_mount",
                "`antenna_frame` moves poses",
                mounted("odometry.ros2 = { topic = '/odom', antenna_frame = 'wifi' }"),
            ),
            ("camera_mount", "of the wheels already", mounted(WHEELS)),
            ("camera_mount", "no poses of a camera", mounted("odometry.static = {}")),
            (
                "camera_mount",
                "of the robot, not of a camera",
                swap(&room(""), "odometry.room", &format!("{MOUNT}\nodometry.room")),
            ),
            (
                "inf",
                "inf: metres from",
                posed("camera_mount = { forward_m = 0.0, left_m = inf }\nodometry.csv.file = 'no.csv'"),
            ),
            (
                "1e300",
                "1e300: metres from",
                posed("camera_mount = { forward_m = 1e300, left_m = 0 }\nodometry.static = {}"),
            ),
        ]);
    }

    #[test]
    fn poses_of_an_antenna_need_no_offset() {
        let offset = "antenna_offset_m = [0, 0, 0.2]\n";
        let frame = "ros2.antenna_frame = 'wifi'\n";
        good(&posed(&format!("odometry.{frame}")));
        good(&posed("odometry.ros.topic = '/robot/1/odom'"));
        all_refused([
            ("antenna_offset_m", "leave `antenna_offset_m` out", posed(&format!("{offset}odometry.{frame}"))),
            ("antenna_offset_m", "peer `b`: `antenna_frame`", linked(&format!("{offset}poses.{frame}"))),
            ("antenna_offset_m", "in its own configuration", linked(&format!("{offset}poses.network = {{}}\n"))),
        ]);
    }

    #[test]
    fn poses_fit_the_capture() {
        let room_posed = |poses: &str| swap(&room(""), "odometry.room = {}", poses);
        all_refused([
            ("no.csv", "there is no file", posed("odometry.csv.file = 'no.csv'")),
            ("odometry.csv", "replayed capture", posed("odometry.csv.file = 'lib.rs'")),
            ("odometry.room", "`room` poses", posed("odometry.room = {}")),
            ("odometry.network", "own poses", posed("odometry.network = {}")),
            ("opencr", "`opencr` poses are live", room_posed(WHEELS)),
            ("odometry.ros", "`ros` poses are live", room_posed("odometry.ros.topic = '/odom'")),
            ("odometry.ros2", "are live", room_posed("odometry.ros2 = {}")),
            ("poses.network", "peer `b`: `network` poses", linked("poses.network = {}\n")),
            ("poses.opencr", "peer `b`: a peer's port", linked("poses.opencr.port = 'x'\n")),
            (
                "poses.ros",
                "peer `b`: a peer's poses have the times of its own clock",
                linked("poses.ros = { topic = '/b/odom', stamp = 'receipt' }\n"),
            ),
            ("topic", "", posed("odometry.ros = {\n  topic = 'odom' }")),
            (
                "[ros2]",
                "[ros2]: frame: `odom` is not the frame of this robot's poses: frame = \"map\"",
                posed("odometry.ros2 = { type = 'tf', frame = 'map', child = 'base_link' }\n[ros2]"),
            ),
            ("odometry.ros", "`/odom/` is not a valid ROS name", posed("odometry.ros = { topic = '/odom/' }")),
            ("odometry.ros", "", posed("odometry.ros = { topic = '/odom', type = 'imu' }")),
            ("odometry.ros", "", posed("odometry.ros = { topic = '/odom', stamp = 'now' }")),
        ]);
    }

    #[test]
    fn a_peer_has_its_own_name_and_fitting_records() {
        let second = |lines: &str| linked(&format!("[[peer]]\nname = 'c'\nmac = '02:00:00:00:00:03'\n{lines}"));
        all_refused([
            ("# none", "needs a name", swap(&linked(""), "'b'", "'' # none")),
            (
                "'1b'",
                "the names of those of `_1b`",
                swap(
                    &linked("[[peer]]\nname = '1b'\nmac = '02:00:00:00:00:03'\nrecords.network = {}\n[ros2]\n"),
                    "'b'",
                    "'_1b'",
                ),
            ),
            (
                "b-1",
                "the names of those of `b_1`",
                swap(
                    &linked(
                        "[[peer]]\nname = 'b-1'\nmac = '02:00:00:00:00:03'\nrecords.network = {}\n[ros2]\nframe = 'odom'\n",
                    ),
                    "'b'",
                    "'b_1'",
                ),
            ),
            (
                "# again",
                "has its name",
                linked("[[peer]]\nmac = '02:00:00:00:00:03'\nrecords.network = {}\nname = 'b' # again\n"),
            ),
            (
                "# again",
                "another peer has its name or MAC",
                linked("[[peer]]\nname = 'c'\nrecords.network = {}\nmac = '02:00:00:00:00:02' # again\n"),
            ),
            ("# c", "peer `c`: `mac` is missing", linked("[[peer]] # c\nname = 'c'\nrecords.network = {}\n")),
            (
                "# own",
                "this robot's own MAC",
                linked("[[peer]]\nname = 'c'\nrecords.network = {}\nmac = '02:00:00:00:00:01' # own\n"),
            ),
            ("# again", "this robot's own name", swap(&linked(""), "'b'", "'here' # again")),
            ("no.dat", "there is no file", second("records.replay.file = 'no.dat'\n")),
            ("lib.rs", "a replayed log needs", second("records.replay.file = 'lib.rs'\n")),
            ("records.room", "`room` records need", second("records.room = {}\n")),
            ("# c", "`network` records need a [network]", second("records.network = {} # c\n")),
            ("certificate", "`certificate` is the common name", second("certificate = ' '\nrecords.network = {}\n")),
            (
                "certificate",
                "records and poses of the network",
                second("certificate = 'c'\nrecords.replay.file = 'no.dat'\n"),
            ),
            ("'ty'", "no robot `ty`", room("[[peer]]\nrecords.room = {}\nname = 'ty'\n")),
            ("# itself", "peer `rx`: it is this robot itself", [ROOM, ITSELF].concat()),
            (
                "# itself",
                "peer `rx`: it is this robot itself",
                swap(
                    &swap(
                        &[CARD, ITSELF].concat(),
                        "capture.card = {}",
                        "capture.served = { socket = 's', robot = 'rx' }",
                    ),
                    "mac =",
                    "#",
                ),
            ),
        ]);
    }

    #[test]
    fn antennas_need_no_peer() {
        good(&[ROOM, ARRAY].concat());
        good(&[ROOM, ARRAY, HEARD].concat());
        good(&swap(
            &[ROOM, ARRAY, "chain_constants_deg = [[52.7, 0.3]]\n", HEARD].concat(),
            "odometry.room",
            "odometry.static",
        ));
        all_refused([
            (
                "[[peer]]",
                "no robot here ever moves",
                swap(&[ROOM, ARRAY, HEARD].concat(), "odometry.room", "odometry.static"),
            ),
            ("antennas =", "named twice", swap(&[ROOM, ARRAY].concat(), "'B'", "'A'")),
            ("antennas =", "A, B or C", swap(&[ROOM, ARRAY].concat(), "'B'", "'D'")),
            ("antennas =", "2 or 3", swap(&[ROOM, ARRAY].concat(), ", 'B'", "")),
            ("baselines_m", "0 baselines for 2 antennas", swap(&[ROOM, ARRAY].concat(), "[[0.1, 0.0, 0.0]]", "[]")),
            ("baselines_m", "metres are expected", swap(&[ROOM, ARRAY].concat(), "0.1,", "100.0,")),
            (
                "chain_constants_deg",
                "a deviation of 0 or more",
                [ROOM, ARRAY, "chain_constants_deg = [[1.0, -2.0]]\n"].concat(),
            ),
            ("records.heard", "needs an [array]", [ROOM, HEARD].concat()),
            ("records.heard", "leave `poses` out", [ROOM, ARRAY, HEARD, "poses.room = {}\n"].concat()),
            ("records.heard", "leave `poses` out", [ROOM, ARRAY, HEARD, "poses.static.heading_deg = 3\n"].concat()),
            ("'ty'", "no robot `ty`", swap(&[ROOM, ARRAY, HEARD].concat(), "'tx'", "'ty'")),
        ]);
    }

    #[test]
    fn feitcsi_has_an_address_or_a_pipe() {
        good(&capture("capture.feitcsi.udp = '127.0.0.1:8008'"));
        all_refused([
            ("udp", "address", capture("capture.feitcsi.udp = '8008'")),
            ("pipe", "no named pipe", capture("capture.feitcsi.pipe = 'lib.rs'")),
        ]);
    }

    #[test]
    fn ros_1_and_the_sounding_exchange() {
        let sounding = |more: &str| linked(&[MONITOR, more].concat());
        good(&swap(&sounding(""), "records.network = {}", "records.sounding = {}"));
        all_refused([
            ("master", "one looks like", card("[ros]\nframe = 'odom'\nmaster = '10.0.0.1:11311/'\n")),
            ("node", "not a valid ROS name", card("[ros]\nframe = 'odom'\nnode = 'a b'\n")),
            (
                "foxglove_origins",
                "needs `foxglove`",
                card("[output]\nbearings = '-'\nfoxglove_origins = ['https://lab']\n"),
            ),
            ("[sounding]", "a monitor interface, is missing", linked("[sounding]\nfifo = false\n")),
            ("[sounding]", "needs a [[peer]]", card(MONITOR)),
            ("[sounding]", "is done with a card", room(MONITOR)),
            (
                "records.sounding",
                "`initiate`",
                swap(&sounding("initiate = false\n"), "records.network = {}", "records.sounding = {}"),
            ),
            (
                "records.sounding",
                "it must stand",
                swap(&sounding(""), "records.network = {}", "records.sounding = {}\nposes.room = {}"),
            ),
            (
                "interface",
                "leave `interface` out",
                swap(&sounding(""), "capture.card = {}", "capture.served = { socket = 's', robot = 'a' }"),
            ),
            ("key =", "there is no file", sounding("key = 'no.key'\n")),
            ("rate_hz =", "rounds", sounding("rate_hz = 1e5\n")),
            ("mcs =", "23", sounding("mcs = 24\n")),
            ("links =", "links", sounding("links = 0\n")),
            (
                "links =",
                "as many slots as there are peers",
                sounding("links = 1\n[[peer]]\nname = 'c'\nmac = '02:00:00:00:00:03'\nrecords.network = {}\n"),
            ),
        ]);
    }

    #[test]
    fn settings_of_ros_2() {
        let ros2 = |more: &str| card(&format!("[ros2]\nframe = 'odom'\n{more}"));
        good(&ros2("interface = '127.0.0.2'\nnamespace = '/lab'\nnode = 'n'\n"));
        good(&ros2("interface = '192.168.1.5'\ninsecure = true\npeers = ['10.0.0.1']\n"));
        all_refused([
            ("interface", "`insecure = true`", ros2("interface = '192.168.1.5'\n")),
            ("interface", "one address", ros2("interface = '0.0.0.0'\ninsecure = true\n")),
            ("peers", "cannot be reached from 127.0.0.1", ros2("peers = ['10.0.0.1']\n")),
            ("domain", "0 to 232", ros2("domain = 233\n")),
            ("frame", "tf2 takes no frame", swap(&ros2(""), "frame = 'odom'", "frame = '/odom'")),
            ("frame", "tf2 takes no frame", swap(&ros2(""), "frame = 'odom'", "frame = ''")),
            ("namespace", "not a valid ROS 2 namespace", ros2("namespace = 'lab'\n")),
            ("node", "not a valid ROS 2 node name", ros2("node = '/a/b'\n")),
            ("remap", "not a valid ROS 2 name", ros2("remap = { 'a b' = '/c' }\n")),
            ("type", "from `frame` to `child`", posed("[odometry.ros2]\ntype = 'tf'\nframe = 'odom'")),
            ("child", "is for transforms", posed("[odometry.ros2]\nchild = 'base_link'")),
            ("antenna_frame", "is for odometry", posed("[odometry.ros2]\ntype = 'pose'\nantenna_frame = 'wifi'")),
            ("imu", "not a valid ROS 2 name", posed("[odometry.ros2]\nimu = '1mu'")),
        ]);
    }

    #[test]
    fn settings_of_the_network() {
        all_refused([
            ("backlog", "256 to 1000000", card("[network]\ngroup = 'g'\nbacklog = 1\n")),
            (
                "publish_poses",
                "no `odometry` to publish",
                swap(&card("[network]\ngroup = 'g'\npublish_poses = true\n"), WHEELS, "odometry.static = {}"),
            ),
            ("no.json5", "there is no file", card("[network]\ngroup = 'g'\nzenoh = 'no.json5'\n")),
        ]);
    }

    #[test]
    fn a_pace_is_one_that_can_be_kept() {
        let paced = |speed: &str| {
            let table = format!("[capture.room]\nscene = 'lab-circle'\nspeed = {speed}\nrobot = 'rx'\n");
            format!("{ROOM}{table}{PEER}").replace("capture.room = { scene = 'lab-circle', robot = 'rx' }\n", "")
        };
        let replay = |speed: &str| {
            CARD.replace("capture.card = {}\n", "")
                .replace("odometry.opencr.port = '/dev/null'", "odometry.static = {}")
                + &format!("[capture.replay]\nfile = 'lib.rs'\nspeed = {speed}\n")
        };
        for speed in ["1e-3", "1", "1e3"] {
            good(&paced(speed));
            good(&replay(speed));
        }
        for speed in ["1e300", "1.1e3", "9e-4"] {
            refused(&paced(speed), "speed", "0.001 to 1000 times");
            refused(&replay(speed), "speed", "0.001 to 1000 times");
        }
    }

    #[test]
    fn a_feature_that_this_program_lacks_is_named() {
        if let Some(why) = crate::adapters::missing("foxglove") {
            assert!(why.contains("--features foxglove"));
            let output = "[output]\nbearings = '-'\nfoxglove = '127.0.0.1:1'\n";
            refused(&format!("{CARD}{output}"), "foxglove", "foxglove in [output]");
        }
        if crate::adapters::missing("zenoh").is_some() {
            refused(&format!("{CARD}[network]\ngroup = 'g'\n"), "[network]", "--features zenoh");
        }
    }

    #[test]
    fn outputs_are_in_separate_files() {
        let folder = std::env::temp_dir().join(format!("csi5300-written-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let name = |file: &str| folder.join(file).display().to_string();
        let with = |log: &str, bearings: &str, socket: &str| {
            CARD.replace("x.dat", &name(log))
                + &format!("[output]\nbearings = '{}'\nstatus_socket = '{}'\n", name(bearings), name(socket))
        };
        good(&with("a.dat", "b", "c"));
        refused(&with("a.dat", "./a.dat", "c"), "bearings", "is also the output of `log.file`");
        refused(&with("a.dat", "a.datstp", "c"), "bearings", "is also the output of `log.file`");
        refused(&with("a.dat", "b", "a.dat"), "status_socket", "is also the output of `log.file`");
        refused(&with("a.dat", "b", "b"), "status_socket", "is also the output of `output.bearings`");
        refused(&CARD.replace("x.dat", "/dev/full"), "/dev/full", "no regular file");
        refused(&format!("{CARD}rotate_mib = 0\n"), "rotate_mib", "nonzero");
        // What already exists: a log and a recording get other names, lines are added, a socket is one.
        std::fs::create_dir_all(folder.join("run")).unwrap();
        std::fs::write(folder.join("old"), "").unwrap();
        let ros = |bag: &str| format!("{CARD}[ros2]\nbag = '{}'\n", name(bag));
        let bags = [ros("run"), ros("no/such/run")];
        for text in [with("old", "/dev/null", "c"), with("a.dat", "old", "c")].into_iter().chain(bags) {
            good(&text.replace(&name("/dev/null"), "/dev/null"));
        }
        refused(&ros("old/run"), "bag", "old is no folder");
        refused(&with("run", "b", "c"), "file", "it is a folder");
        refused(&with("a.dat", "run", "c"), "bearings", "it is a folder");
        refused(&with("a.dat", "b", "old"), "status_socket", "there and no socket");
        let _socket = std::os::unix::net::UnixListener::bind(folder.join("socket")).unwrap();
        refused(&with("a.dat", "socket", "c"), "bearings", "it is a socket");
        good(&with("a.dat", "b", "socket"));
        // Its own file, by another name.
        let own = folder.join("robot.toml");
        std::fs::write(&own, with("a.dat", "robot.toml", "c")).unwrap();
        std::os::unix::fs::symlink(&own, folder.join("link.toml")).unwrap();
        let link = folder.join("link.toml");
        let said = Config::of_file(&Config::text_of(&link).unwrap(), &link).unwrap_err().to_string();
        assert!(said.contains("is this configuration"), "{said}");
        std::fs::remove_dir_all(folder).unwrap();
    }

    /// Whatever name it is given: the recording would be what is written, or have lines of JSON in it.
    #[test]
    fn inputs_are_not_written() {
        let folder = std::env::temp_dir().join(format!("csi5300-read-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("sub")).unwrap();
        for file in ["rx.dat", "rx.datstp", "tx.dat", "way.csv", "key"] {
            std::fs::write(folder.join(file), file).unwrap();
        }
        std::os::unix::fs::symlink("../rx.dat", folder.join("sub/link.dat")).unwrap();
        std::fs::hard_link(folder.join("rx.dat"), folder.join("sub/hard.dat")).unwrap();
        std::fs::hard_link(folder.join("way.csv"), folder.join("hard.csv")).unwrap();
        let config = |capture: &str, output: &str| {
            format!(
                "name = 'here'\nchannel = '108'\nmac = '02:00:00:00:00:01'\ncapture.replay.file = '{capture}'\n\
                 odometry.csv.file = 'way.csv'\n[output]\n{output}\n[[peer]]\nname = 'tx'\n\
                 mac = '02:00:00:00:00:02'\nrecords.replay.file = 'tx.dat'\n"
            )
        };
        let said = |text: &str| Config::read(text, &folder).err().map(|error| error.to_string()).unwrap_or_default();
        for (capture, bearings, line) in [
            ("rx.dat", "rx.dat", 4),
            ("rx.dat", "sub/../rx.dat", 4),
            ("rx.dat", "./rx.dat", 4),
            ("rx.dat", "sub/link.dat", 4),
            ("sub/link.dat", "rx.dat", 4),
            ("rx.dat", "sub/hard.dat", 4),
            ("rx.dat", "rx.datstp", 4),
            ("sub/link.dat", "rx.datstp", 4),
            ("rx.dat", "tx.dat", 11),
            ("rx.dat", "way.csv", 5),
            ("rx.dat", "hard.csv", 5),
        ] {
            let why = said(&config(capture, &format!("bearings = '{bearings}'")));
            let wanted = format!("is an input (line {line}): name another output");
            assert!(why.starts_with("line 7: ") && why.contains(&wanted), "{capture}, {bearings}: {why}");
        }
        let output = |more: &str| said(&config("rx.dat", more));
        assert_eq!(output("bearings = 'out.json'\n[log]\nfile = 'own.dat'"), "");
        assert!(output("bearings = ''\n[log]\nfile = 'rx.dat'").starts_with("line 9: "));
        assert!(output("bearings = ''\nstatus_socket = 'way.csv'").starts_with("line 8: "));
        let keyed = format!("{CARD}[output]\nbearings = 'key'\n[sounding]\ninterface = 'mon0'\nkey = 'key'\n{PEER}")
            .replace("records.room = {}", "mac = '02:00:00:00:00:02'\nrecords.sounding = {}");
        let why = said(&keyed);
        assert!(why.contains("is an input (line 12)"), "{why}");
        assert_eq!(std::fs::read(folder.join("rx.dat")).unwrap(), b"rx.dat");
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn names_that_no_file_or_socket_can_have_are_refused_before_the_start() {
        let output = |more: &str| format!("{CARD}[output]\nbearings = ''\n{more}\n");
        let said =
            |text: &str| Config::read(text, Path::new("")).err().map(|error| error.to_string()).unwrap_or_default();
        let empty = "an empty name is no file";
        assert!(said(&output("status_socket = ''")).starts_with(&format!("line 10: {empty}")));
        assert!(said(&CARD.replace("x.dat", "")).starts_with(&format!("line 7: {empty}")));
        let socket = |bytes: usize| output(&format!("status_socket = '/tmp/{}'", "s".repeat(bytes - "/tmp/".len())));
        assert_eq!(said(&socket(107)), "");
        let why = said(&socket(108));
        assert!(
            why.starts_with("line 10: ") && why.contains("it has 108 bytes") && why.contains("at most 107"),
            "{why}"
        );
    }

    #[cfg(feature = "zenoh")]
    #[test]
    fn topics_of_ros_2_over_the_network() {
        let network = |ros2: &str| format!("{CARD}[network]\nros2 = true\n{ros2}");
        good(&network("[ros2]\n"));
        refused(&network(""), "ros2 = true", "no topics to carry");
        refused(&network("[ros2]\ndistribution = 'humble'\n"), "ros2 = true", "Jazzy");
    }

    #[cfg(feature = "zenoh")]
    #[test]
    fn certificates_of_peers() {
        let folder = std::env::temp_dir().join(format!("csi5300-owners-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let zenoh = |name: &str, more: &str| {
            let file = folder.join(name);
            std::fs::write(&file, format!("{{ transport: {{ link: {{ tls: {{ enable_mtls: true }} }} }}, {more} }}"))
                .unwrap();
            format!("zenoh = '{}'\nlisten = ['tls/127.0.0.1:7447']\n", file.display())
        };
        let peer = "[[peer]]\nname = 'b'\nmac = '02:00:00:00:00:02'\nrecords.network = {}\ncertificate = 'b'\n";
        let network = |file: &str| format!("{CARD}[network]\n{file}{peer}");
        refused(&network(""), "[network]", "needs a network where both ends show one");
        good(&network(&zenoh("asks.json5", "")));
        let ruled = zenoh("rules.json5", "access_control: { enabled: true, default_permission: 'allow' }");
        refused(&network(&ruled), "[network]", "has an `access_control` of its own");
        good(&network(&ruled).replace("certificate = 'b'\n", ""));
        std::fs::remove_dir_all(folder).unwrap();
    }
}
