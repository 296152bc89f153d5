//! Finds contradictions in a configuration, or with this machine.
//!
//! One function for each group of rules. A refusal names the place of the wrong key, or of the table that lacks one;
//! the spans of the TOML reader give its line.

use super::{
    CameraMount, Capture, Config, Estimation, Feitcsi, Odometry, Peer, Place, Problem, Records, Room, Ros, name_part,
};
use crate::adapters;
use csi5300::exchange::tdma::{Plan, PlanError, Request};
use csi5300::motion::odometry::ros::Stamp;
use csi5300::pipeline::ArrayError;
use csi5300::source::side_path;
use csi5300_live::sounding::rate_n_flags;
use csi5300_ros2::settings::{self, Distribution, Wrong};
use csi5300_sim::Scene;
use csi5300_sim::motion::RobotMotion;
use csi5300_sim::toml_lines::Step::{Index, Key};
use csi5300_sim::toml_lines::{Step, TomlLines};
use driver_iface::bfee::Antenna;
use nix::unistd::{AccessFlags, access};
use std::collections::BTreeSet;
use std::ops::RangeInclusive;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::os::unix::net::SocketAddr;
use std::path::Path;

/// Largest distance of a part from the middle of a robot, metres.
const ON_ROBOT_M: f64 = 10.0;
/// Allowed bearings of each peer a second: from one in a thousand seconds to more than any processor manages.
const RATES_HZ: RangeInclusive<f64> = 1e-3..=100.0;
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

/// All contradictions, except those that follow from `gone` keys.
pub(super) fn problems(
    config: &Config,
    own_file: Option<&Path>,
    lines: TomlLines<'_>,
    gone: &BTreeSet<String>,
) -> Vec<Problem> {
    let mut check = Check { config, own_file, lines, gone, scene: None, problems: Vec::new() };
    check.own_card();
    check.array();
    check.own_room();
    check.estimator();
    check.macs_of_the_room();
    check.speed();
    check.finite();
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
    /// Refuses the value at `place`.
    fn refuse(&mut self, place: &[Step<'_>], reason: impl Into<String>) {
        self.problems.push(Problem { line: self.lines.line(place), reason: reason.into() });
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

    /// A problem of a robot's poses: the key below theirs, and the reason. `own` are this robot's.
    fn wrong_poses(&self, poses: &Odometry, own: bool) -> Option<(Vec<Step<'static>>, String)> {
        let of_now = self.is_room() || self.is_replay();
        let has_network = self.config.network.is_some();
        let (place, why): (&[Step<'static>], String) = match poses {
            Odometry::Csv(csv) if !csv.file.is_file() => {
                (&[Key("csv"), Key("file")], format!("there is no trajectory {}", csv.file.display()))
            }
            Odometry::Csv(_) if !self.is_replay() => {
                (&[Key("csv")], "`csv` poses need a replayed capture, whose pace they follow".into())
            }
            Odometry::Opencr(_) if of_now => (&[Key("opencr")], OPENCR_NOW.into()),
            Odometry::Ros(_) if of_now => (&[Key("ros")], ROS_NOW.into()),
            Odometry::Ros2(_) if of_now => (&[Key("ros2")], ROS_NOW.into()),
            Odometry::Ros(_) | Odometry::Ros2(_) => {
                let (protocol, key, why) = wrong_topic(poses, !own)?;
                return Some(([protocol].into_iter().chain(key).map(Key).collect(), why));
            }
            Odometry::Room(_) if !self.is_room() => {
                (&[Key("room")], "`room` poses need `capture.room` or `capture.served`".into())
            }
            Odometry::Opencr(_) if !own => {
                (&[Key("opencr")], "a peer's port is not on this machine: use `network`".into())
            }
            Odometry::Network(_) if own => {
                (&[Key("network")], "this robot's own poses do not come over the network".into())
            }
            Odometry::Network(_) if !has_network => {
                (&[Key("network")], "`network` poses need a [network] table".into())
            }
            _ => return None,
        };
        Some((place.to_vec(), why))
    }
}

/// The first of `numbers` that is not finite.
fn not_finite(numbers: &[f64]) -> Option<usize> {
    numbers.iter().position(|number| !number.is_finite())
}

/// A number of a place on a robot that is not finite or too large, and the reason.
fn too_far(place_m: &[f64]) -> Option<(usize, String)> {
    let reason = |m: f64| match m.is_finite() {
        false => Some("every number must be finite".to_owned()),
        true => (m.abs() > ON_ROBOT_M).then(|| format!("{m:e} m is not on a robot: {ON_ROBOT_M} m at most")),
    };
    place_m.iter().enumerate().find_map(|(number, m)| Some((number, reason(*m)?)))
}

/// Why poses leave no place for `antenna_offset_m`: they are of the antenna already.
fn twice(poses: &Odometry, offset_m: [f64; 3]) -> Option<&'static str> {
    match poses {
        _ if offset_m == [0.0; 3] => None,
        Odometry::Ros2(topic) if topic.antenna_frame.is_some() => {
            Some("`antenna_frame` gives the antenna's place: leave `antenna_offset_m` out")
        }
        Odometry::Network(_) => {
            Some("`network` poses are of the peer's antenna: set `antenna_offset_m` in its own configuration, not here")
        }
        _ => None,
    }
}

/// Where below its `static` a place has a number that is none.
fn wrong_place(odometry: &Odometry) -> Option<Vec<Step<'static>>> {
    let Odometry::Static(Place { position_m, heading_deg }) = odometry else { return None };
    match not_finite(position_m) {
        Some(number) => Some(vec![Key("static"), Key("position_m"), Index(number)]),
        None => (!heading_deg.is_finite()).then(|| vec![Key("static"), Key("heading_deg")]),
    }
}

impl Check<'_> {
    /// This robot's MAC and log.
    fn own_card(&mut self) {
        if self.config.mac.is_none() && !self.is_room() && self.knows(&["mac"]) {
            let why = "`mac`, the address of this robot's card, is missing: `ip link` shows it, and `csi5300 info` shows the \
                       senders in a log";
            self.refuse(&[Key("capture")], why);
        }
        if let Capture::Replay(replay) = self.capture()
            && !replay.file.is_file()
        {
            let why = format!("there is no log {}", replay.file.display());
            self.refuse(&[Key("capture"), Key("replay"), Key("file")], why);
        }
        if let Capture::Feitcsi(Feitcsi::Pipe(pipe)) = self.capture()
            && !std::fs::metadata(pipe).is_ok_and(|found| found.file_type().is_fifo())
        {
            let why = format!("{} is no named pipe: `mkfifo` makes one, and FeitCSI writes to it", pipe.display());
            self.refuse(&[Key("capture"), Key("feitcsi"), Key("pipe")], why);
        }
    }

    /// The antennas of bearings without a peer.
    fn array(&mut self) {
        if let Some(Err(error)) = self.config.array.as_ref().map(|array| array.array()) {
            let key = match error {
                ArrayError::Antennas { .. } | ArrayError::Twice { .. } => "antennas",
                ArrayError::Constants { .. } => "chain_constants_deg",
                _ => "baselines_m",
            };
            self.refuse(&[Key("array"), Key(key)], format!("[array]: {error}"));
        }
    }

    /// The scene of a simulated room, and this robot and those that follow something in it.
    fn own_room(&mut self) {
        let config = self.config;
        let Capture::Room(asked) = config.capture.get_ref() else { return };
        let key = |key| [Key("capture"), Key("room"), Key(key)];
        match asked.load_scene() {
            Ok(scene) => self.scene = Some(scene),
            Err(error) => self.refuse(&key("scene"), error.to_string()),
        }
        if let Some(why) = self.absent(&asked.robot) {
            self.refuse(&key("robot"), why);
        }
        let Some(scene) = &self.scene else { return };
        for (robot, why) in wrong_followed(asked, scene) {
            let [capture, room, follow] = key("follow");
            match robot {
                Some(robot) => self.refuse(&[capture, room, follow, Key(robot)], why),
                None => self.refuse(&[capture, room], why),
            }
        }
    }

    /// MACs that are not those of the simulated room.
    fn macs_of_the_room(&mut self) {
        let config = self.config;
        let Capture::Room(asked) = config.capture.get_ref() else { return };
        let peers = config.peer.iter().map(|peer| (peer.get_ref().name.as_str(), peer.get_ref().mac));
        let all = std::iter::once((asked.robot.as_str(), config.mac)).chain(peers);
        let given: Vec<_> = all.enumerate().filter_map(|(k, (name, mac))| Some((k, name, mac?))).collect();
        if given.is_empty() {
            return;
        }
        let Some(room) = self.scene.as_ref().and_then(|scene| csi5300_sim::Room::new(scene).ok()) else { return };
        for (k, name, mac) in given {
            let is = room.number(name).and_then(|number| room.mac(number)).filter(|is| *is != mac);
            let Some(is) = is else { continue };
            let why = format!("`{name}` has the MAC {is} in this room, not {mac}: leave `mac` out");
            match k.checked_sub(1) {
                None => self.refuse(&[Key("mac")], why),
                Some(peer) => self.refuse(&[Key("peer"), Index(peer), Key("mac")], why),
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
            self.refuse(&[Key("peer"), Index(0)], why);
        }
    }

    /// This robot's poses.
    fn own_poses(&mut self) {
        if let Some((place, why)) = self.wrong_poses(&self.config.odometry, true) {
            let place: Vec<_> = std::iter::once(Key("odometry")).chain(place).collect();
            self.refuse(&place, why);
        }
    }

    /// How this robot carries its camera.
    fn camera(&mut self) {
        let Some(CameraMount { forward_m, left_m, yaw_deg }) = self.config.camera_mount else { return };
        let yaw = (!yaw_deg.is_finite()).then(|| ("yaw_deg", "it must be a finite number".to_owned()));
        let place = [("forward_m", forward_m), ("left_m", left_m)];
        let place = place.into_iter().filter_map(|(key, m)| Some((key, too_far(&[m])?.1)));
        for (key, why) in place.chain(yaw) {
            self.refuse(&[Key("camera_mount"), Key(key)], format!("camera_mount: {key}: {why}"));
        }
        let why = match &self.config.odometry {
            Odometry::Csv(_) | Odometry::Ros(_) => return,
            Odometry::Ros2(topic) if topic.antenna_frame.is_none() => return,
            Odometry::Ros2(_) => {
                "`antenna_frame` moves poses to the antenna: leave it out, `antenna_offset_m` is where the antenna is"
            }
            Odometry::Opencr(_) => "`opencr` poses are of the wheels already",
            Odometry::Room(_) => "`room` poses are of the robot, not of a camera on it",
            Odometry::Static(_) | Odometry::Network(_) => "this robot has no poses of a camera",
        };
        let why = format!("camera_mount is for poses of a tracking camera (`csv`, `ros`, `ros2`): {why}");
        self.refuse(&[Key("camera_mount")], why);
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
            self.refuse(&[Key("capture")], why);
        }
    }
}

/// Refused values of `[estimator]`: the key, and the reason.
fn wrong_estimation(asked: &Estimation, least_m: f64) -> Vec<(&'static str, String)> {
    let mut wrong = Vec::new();
    if !(0.0..=90.0).contains(&asked.elevation_max_deg.unwrap_or(20.0)) {
        wrong.push(("elevation_max_deg", "elevation_max_deg: 0 to 90 degrees".into()));
    }
    if !(0.0..=3_600.0).contains(&asked.accurate_every_s) {
        wrong.push(("accurate_every_s", "accurate_every_s: 0 to 3600 seconds".into()));
    }
    if !(0.0..=1.0).contains(&asked.extrapolate_s) {
        let why = "extrapolate_s: 0 to 1 second; a robot is somewhere else after a longer time";
        wrong.push(("extrapolate_s", why.into()));
    }
    if asked.heading_sd_deg.is_some_and(|sd_deg| !(0.0..=180.0).contains(&sd_deg)) {
        wrong.push(("heading_sd_deg", "heading_sd_deg: 0 to 180 degrees".into()));
    }
    if least_m > asked.window_m {
        let key = if asked.least_motion_m.is_some() { "least_motion_m" } else { "window_m" };
        let why = format!(
            "window_m ({:.3} m) is less than the motion needed, {least_m:.3} m: there would never be a bearing",
            asked.window_m
        );
        wrong.push((key, why));
    }
    if !RATES_HZ.contains(&asked.rate_hz) {
        let (least, most) = (RATES_HZ.start(), RATES_HZ.end());
        wrong.push(("rate_hz", format!("rate_hz in [estimator]: {least} to {most} bearings of each peer a second")));
    }
    wrong
}

impl Check<'_> {
    /// How bearings are made.
    fn estimator(&mut self) {
        let asked = &self.config.estimator;
        let least_m = asked.motion_needed_m(self.config.channel.wavelength_m());
        for (key, why) in wrong_estimation(asked, least_m) {
            self.refuse(&[Key("estimator"), Key(key)], why);
        }
    }

    /// Speeds of replayed and simulated sources.
    fn speed(&mut self) {
        let (kind, speed) = match self.capture() {
            Capture::Replay(replay) => ("replay", replay.speed),
            Capture::Room(room) => ("room", room.speed),
            Capture::Card(_) | Capture::Stock(_) | Capture::Feitcsi(_) | Capture::Served(_) => return,
        };
        if !SPEEDS.contains(&speed) {
            let why = format!("speed: {} to {} times its own pace, not {speed:e}", SPEEDS.start(), SPEEDS.end());
            self.refuse(&[Key("capture"), Key(kind), Key("speed")], why);
        }
    }

    /// Places and angles of this robot and its peers.
    fn finite(&mut self) {
        let config = self.config;
        if let Some(why) = twice(&config.odometry, config.antenna_offset_m) {
            self.refuse(&[Key("antenna_offset_m")], why);
        }
        if let Some((number, why)) = too_far(&config.antenna_offset_m) {
            self.refuse(&[Key("antenna_offset_m"), Index(number)], format!("antenna_offset_m: {why}"));
        } else if let Some(place) = wrong_place(&config.odometry) {
            let place: Vec<_> = std::iter::once(Key("odometry")).chain(place).collect();
            self.refuse(&place, "odometry: every number must be finite");
        }
        for (k, peer) in config.peer.iter().map(|peer| peer.get_ref()).enumerate() {
            if let Some(why) = twice(&peer.poses, peer.antenna_offset_m) {
                let why = format!("peer `{}`: {why}", peer.name);
                self.refuse(&[Key("peer"), Index(k), Key("antenna_offset_m")], why);
            }
            if let Some((number, why)) = too_far(&peer.antenna_offset_m) {
                let why = format!("peer `{}`: antenna_offset_m: {why}", peer.name);
                self.refuse(&[Key("peer"), Index(k), Key("antenna_offset_m"), Index(number)], why);
                continue;
            }
            let yaw = (!peer.yaw_deg.is_finite()).then(|| vec![Key("yaw_deg")]);
            let poses = || wrong_place(&peer.poses).map(|place| [vec![Key("poses")], place].concat());
            if let Some(key) = yaw.or_else(poses) {
                let why = format!("peer `{}`: yaw_deg and poses must be finite numbers", peer.name);
                self.refuse(&[vec![Key("peer"), Index(k)], key].concat(), why);
            }
        }
    }
}

impl Check<'_> {
    /// Every peer.
    fn peers(&mut self) {
        let config = self.config;
        for (k, peer) in config.peer.iter().map(|peer| peer.get_ref()).enumerate() {
            let wrong = self.wrong_identity(k, peer).into_iter();
            for (key, why) in wrong.chain(self.wrong_records(peer)).chain(self.wrong_peer_poses(peer)) {
                self.refuse(&[vec![Key("peer"), Index(k)], key].concat(), why);
            }
        }
    }

    /// Known places and ranges of the team's graph.
    fn team(&mut self) {
        let config = self.config;
        let Some(team) = &config.team else { return };
        if config.peer.is_empty() && self.knows(&["peer"]) {
            self.refuse(&[Key("team")], "[team] needs a [[peer]]: the graph is made of bearings");
        }
        let is_peer = |name: &str| config.peer.iter().any(|peer| peer.get_ref().name == name);
        for (name, place_m) in &team.places {
            let key = [Key("team"), Key("places"), Key(name)];
            if !is_peer(name) && self.knows(&["peer"]) {
                self.refuse(&key, format!("[team]: places: there is no peer `{name}`"));
            } else if !place_m.iter().all(|m| m.is_finite()) {
                self.refuse(&key, format!("[team]: places: {name}: every number must be finite"));
            }
        }
        for (name, ranges) in &team.ranges {
            let key = [Key("team"), Key("ranges"), Key(name)];
            if !is_peer(name) && self.knows(&["peer"]) {
                self.refuse(&key, format!("[team]: ranges: there is no peer `{name}`"));
            } else if let Some(why) = settings::wrong_name(&ranges.topic) {
                self.refuse(&key, format!("[team]: ranges: {name}: {why}"));
            }
        }
        let own_frame = config.ros2.as_ref().map(|ros| ros.frame.as_str());
        if team.frame.is_empty() || (!team.places.is_empty() && own_frame == Some(team.frame.as_str())) {
            let why = "[team]: frame: the places need a frame other than that of the odometry ([ros2] frame)";
            self.refuse(&[Key("team"), Key("frame")], why);
        }
    }

    /// Its name and MAC.
    fn wrong_identity(&self, k: usize, peer: &Peer) -> Vec<(Vec<Step<'static>>, String)> {
        let (name, mut wrong) = (&peer.name, Vec::new());
        let others = || self.config.peer.iter().take(k).map(|other| other.get_ref());
        let same_name = others().any(|other| other.name == *name);
        if same_name || others().any(|other| other.mac.is_some() && other.mac == peer.mac) {
            let key = if same_name { "name" } else { "mac" };
            wrong.push((vec![Key(key)], format!("peer `{name}`: another peer has its name or MAC")));
        }
        let in_room = || matches!(self.capture(), Capture::Room(_)) && matches!(peer.records, Records::Heard(_));
        if peer.mac.is_none() && !matches!(peer.records, Records::Room(_)) && !in_room() {
            wrong.push((Vec::new(), format!("peer `{name}`: `mac` is missing")));
        }
        let part = name_part(name);
        let in_ros = self.config.ros.is_some() || self.config.ros2.is_some();
        if part.is_empty() {
            wrong.push((vec![Key("name")], "a peer needs a name".into()));
        } else if let Some(other) = others().find(|other| in_ros && !same_name && name_part(&other.name) == part) {
            let why = format!("peer `{name}`: in ROS its topics have the names of those of `{}`", other.name);
            wrong.push((vec![Key("name")], why));
        }
        if peer.mac.is_some() && peer.mac == self.config.mac {
            wrong.push((vec![Key("mac")], format!("peer `{name}` has this robot's own MAC")));
        }
        if let Some(why) = wrong_certificate(peer) {
            wrong.push((vec![Key("certificate")], format!("peer `{name}`: {why}")));
        }
        wrong
    }

    fn wrong_records(&self, peer: &Peer) -> Option<(Vec<Step<'static>>, String)> {
        let is_own = self.capture().robot() == Some(&peer.name);
        let stands = matches!(peer.poses, Odometry::Static(_));
        let (key, why) = match &peer.records {
            Records::Replay(replay) if !replay.file.is_file() => {
                let why = format!("peer `{}`: there is no log {}", peer.name, replay.file.display());
                return Some((vec![Key("records"), Key("replay"), Key("file")], why));
            }
            Records::Replay(_) if !self.is_replay() => {
                ("replay", "a replayed log needs `capture.replay`, whose pace it follows")
            }
            Records::Room(_) if !self.is_room() => ("room", "`room` records need `capture.room` or `capture.served`"),
            Records::Network(_) if self.config.network.is_none() => {
                ("network", "`network` records need a [network] table")
            }
            Records::Heard(_) if self.config.array.is_none() && self.knows(&["array"]) => {
                ("heard", "`heard` is of antennas of this robot's card: it needs an [array] table")
            }
            Records::Heard(_) if !stands => ("heard", "a sender that is only heard has no poses: leave `poses` out"),
            Records::Sounding(_)
                if !self.config.sounding.as_ref().is_some_and(|own| own.initiate && own.measurement) =>
            {
                let why = "`sounding` records come with the answers to this robot's frames: they need a [sounding] table with \
                           `initiate` and `measurement`";
                ("sounding", why)
            }
            Records::Sounding(_) if !stands => {
                ("sounding", "`sounding` records have no time of the peer's host, so it must stand (`poses.static`)")
            }
            Records::Heard(_) if peer.mac.is_some() && !is_own => return None,
            Records::Room(_) | Records::Heard(_) if is_own => {
                let why = "is this robot itself: the one of the room that `capture` names";
                return Some((vec![Key("name")], format!("peer `{}` {why}", peer.name)));
            }
            Records::Room(_) | Records::Heard(_) => return Some((vec![Key("name")], self.absent(&peer.name)?)),
            Records::Replay(_) | Records::Network(_) | Records::Sounding(_) => return None,
        };
        Some((vec![Key("records"), Key(key)], format!("peer `{}`: {why}", peer.name)))
    }

    fn wrong_peer_poses(&self, peer: &Peer) -> Option<(Vec<Step<'static>>, String)> {
        let (key, why) = self.wrong_poses(&peer.poses, false)?;
        Some(([vec![Key("poses")], key].concat(), format!("peer `{}`: {why}", peer.name)))
    }
}

fn wrong_certificate(peer: &Peer) -> Option<&'static str> {
    let by_network = matches!(peer.records, Records::Network(_)) || matches!(peer.poses, Odometry::Network(_));
    match &peer.certificate {
        Some(name) if name.trim().is_empty() => Some("`certificate` is the common name in its certificate"),
        Some(_) if !by_network => Some("`certificate` is for records and poses of the network, and none are"),
        _ => None,
    }
}

impl Check<'_> {
    /// This program as a node of ROS.
    fn ros(&mut self) {
        if let Some((key, why)) = self.config.ros.as_ref().and_then(wrong_ros) {
            self.refuse_in("ros", key, why);
        }
        if let Some((key, why)) = self.config.ros2.as_ref().and_then(settings::wrong_settings) {
            self.refuse_in("ros2", key, why);
        }
    }

    /// This robot's part in the sounding exchange.
    fn sounding(&mut self) {
        if let Some((key, why)) = self.wrong_sounding().filter(|_| self.knows(&["peer"])) {
            self.refuse_in("sounding", key, why);
        }
    }

    /// Why this robot cannot take part as asked: the key in `[sounding]`, if it is one, and the reason.
    fn wrong_sounding(&self) -> Option<Wrong> {
        let config = self.config;
        let asked = config.sounding.as_ref()?;
        let table = |why: &str| Some((None, why.to_owned()));
        match (self.capture(), &asked.interface) {
            (Capture::Card(_) | Capture::Stock(_), Some(_)) | (Capture::Served(_), None) => {}
            (Capture::Card(_) | Capture::Stock(_), None) => {
                return table("[sounding]: `interface`, a monitor interface, is missing");
            }
            (Capture::Served(_), Some(_)) => {
                let why = "[sounding]: a served room is the air itself: leave `interface` out";
                return Some((Some("interface"), why.into()));
            }
            (Capture::Feitcsi(_) | Capture::Replay(_) | Capture::Room(_), _) => {
                return table(
                    "[sounding] is done with a card: it needs `capture.card`, `capture.stock` or `capture.served`",
                );
            }
        }
        if config.peer.iter().all(|peer| matches!(peer.get_ref().records, Records::Heard(_))) {
            return table("[sounding] needs a [[peer]] to sound");
        }
        if let Some(key) = asked.key.as_ref().filter(|key| !key.is_file()) {
            return Some((Some("key"), format!("there is no key {}", key.display())));
        }
        wrong_plan(&config.sounding_request()?).map(|(key, why)| (key, format!("[sounding]: {why}")))
    }

    /// What is published.
    fn output(&mut self) {
        if let Some(why) = self.config.output.foxglove.and_then(|_| adapters::missing("foxglove")) {
            self.refuse_in("output", Some("foxglove"), format!("foxglove in [output] {why}"));
        }
        if self.config.output.foxglove.is_none() && !self.config.output.foxglove_origins.is_empty() {
            self.refuse_in(
                "output",
                Some("foxglove_origins"),
                "foxglove_origins needs `foxglove`, the address to serve",
            );
        }
    }

    /// The network of the robots.
    fn network(&mut self) {
        let Some(network) = &self.config.network else { return };
        let missing = adapters::missing("zenoh").map(|why| format!("[network] {why}"));
        if let Some(why) = missing.or_else(|| adapters::refusal(self.config)) {
            self.refuse_in("network", None, why);
        }
        if network.backlog.is_some_and(|backlog| !BACKLOGS.contains(&backlog)) {
            let why = format!("backlog: {} to {} records", BACKLOGS.start(), BACKLOGS.end());
            self.refuse_in("network", Some("backlog"), why);
        }
        if network.zenoh.as_ref().is_some_and(|file| !file.is_file()) {
            self.refuse_in("network", Some("zenoh"), "there is no such file of zenoh's");
        }
        if network.ros2 && !self.config.uses_ros2() && self.knows(&["capture", "odometry", "peer", "ros2"]) {
            self.refuse_in(
                "network",
                Some("ros2"),
                "there are no topics to carry: no [ros2] table, and no `ros2` poses",
            );
        }
        let humble = Some(Distribution::Humble);
        if network.ros2 && self.config.ros2.as_ref().map(|ros| ros.distribution) == humble {
            self.refuse_in(
                "network",
                Some("ros2"),
                "topics over zenoh are those of Jazzy and later, not of \"humble\"",
            );
        }
    }

    /// Refuses a key of a table, or the table.
    fn refuse_in(&mut self, table: &str, key: Option<&str>, reason: impl Into<String>) {
        let place: Vec<_> = std::iter::once(table).chain(key).map(Key).collect();
        self.refuse(&place, reason);
    }
}

/// The problem of a name of a node or topic: it must start at the root, with parts of letters, digits and `_`.
fn wrong_ros_name(name: &str) -> Option<String> {
    let part = |part: &str| {
        part.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    let good = name.strip_prefix('/').is_some_and(|parts| parts.split('/').all(part));
    (!good).then(|| format!("`{name}` is not a valid ROS name: use one like /tb3_0/odom"))
}

/// The problem of poses from a topic, of this robot, of a peer, or of a robot that the room follows: the key of its protocol, the
/// key below that, if any, and the reason.
fn wrong_topic(odometry: &Odometry, peers: bool) -> Option<(&'static str, Option<&'static str>, String)> {
    let (protocol, stamp, wrong) = match odometry {
        Odometry::Ros(topic) => ("ros", topic.stamp, wrong_ros_name(&topic.topic).map(|why| (Some("topic"), why))),
        Odometry::Ros2(topic) => ("ros2", topic.stamp, settings::wrong_topic(topic)),
        _ => return None,
    };
    if peers && stamp == Some(Stamp::Receipt) {
        // The exchanges give a peer's clock offset, which is applied to its poses.
        return Some((
            protocol,
            Some("stamp"),
            "a peer's poses have the times of its own clock: `stamp = \"header\"`".into(),
        ));
    }
    let (key, why) = wrong?;
    Some((protocol, key, why))
}

/// What is wrong with a source that a robot of the room follows.
fn wrong_source(room: &Room, odometry: &Odometry) -> Option<String> {
    let stamp = match odometry {
        Odometry::Csv(csv) => {
            return (!csv.file.is_file()).then(|| format!("there is no trajectory {}", csv.file.display()));
        }
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
    wrong_topic(odometry, false).map(|(.., why)| why)
}

/// What is wrong with the sources that robots of the room follow, by the robot's name, and with robots that have none.
fn wrong_followed<'r>(room: &'r Room, scene: &Scene) -> Vec<(Option<&'r str>, String)> {
    let follows = |name: &str| {
        let robot = scene.robot.iter().find(|robot| robot.name == name)?;
        Some(matches!(robot.motion, RobotMotion::Followed(_)))
    };
    let mut wrong = Vec::new();
    for (name, odometry) in &room.follow {
        let why = match follows(name) {
            None => Some(format!("the scene has no robot `{name}`")),
            Some(false) => Some(format!("robot `{name}` moves as the scene says: give it `motion.followed = {{}}`")),
            Some(true) => wrong_source(room, odometry),
        };
        wrong.extend(why.map(|why| (Some(name.as_str()), format!("follow `{name}`: {why}"))));
    }
    let alone = scene.robot.iter().filter(|robot| follows(&robot.name) == Some(true));
    for robot in alone.filter(|robot| !room.follow.contains_key(&robot.name)) {
        let name = &robot.name;
        let why = format!("robot `{name}` of the scene follows nothing: `follow.{name}.ros.topic = \"/{name}/odom\"`");
        wrong.push((None, why));
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
            (["log", "file"], Kind::Log, config.log.as_ref().map(|log| log.file.as_path())),
            (["output", "bearings"], Kind::Lines, bearings),
            (["output", "status_socket"], Kind::Socket, output.status_socket.as_deref()),
            (["ros2", "bag"], Kind::Folder, bag),
        ];
        let mut read = config.clone();
        let inputs = read.inputs();
        let mut before: Vec<(&str, &Path)> = Vec::new();
        for (place, kind, file) in files {
            let Some(file) = file else { continue };
            let read = inputs
                .iter()
                .find(|(_, input)| is_one(input, file))
                .map(|(key, _)| format!("{} is an input ({key}): name another output", file.display()));
            let twice = before.iter().find(|(_, other)| is_one(other, file)).map(|(name, _)| {
                format!("{} is also the output of `{name}`: they would overwrite each other", file.display())
            });
            let itself = self.own_file.is_some_and(|own| is_one(own, file));
            let itself = itself.then(|| format!("{} is this configuration", file.display()));
            if let Some(why) = unwritable(file, kind).or(read).or(twice).or(itself) {
                self.refuse(&place.map(Key), why);
            }
            before.push((place[1], file));
        }
        if config.log.as_ref().is_some_and(|log| log.rotate_mib == Some(0)) {
            self.refuse(&[Key("log"), Key("rotate_mib")], "rotate_mib is 0: every record would have a file of its own");
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
    const ROOM: &str = "name = \"here\"\nchannel = \"108\"\n\n# A comment that names mac, odometry and rate_hz.\n\
                        capture.room = { scene = \"lab-circle\", robot = \"rx\" }\nodometry.room = {}\n";
    /// A valid card, except for missing features.
    const CARD: &str = "name = \"here\"\nchannel = \"108\"\nmac = \"02:00:00:00:00:01\"\ncapture.card = {}\n\
                        odometry.opencr.port = \"/dev/null\"\n[log]\nfile = \"x.dat\"\n";
    const PEER: &str = "[[peer]]\nname = \"tx\"\nyaw_deg = 0.0\nrecords.room = {}\n";

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

    /// Configurations, one a line: a key in the line that is refused, a word of the reason (`-` and `-` for a good one), the valid
    /// text to begin with, and its changes: `+ MORE` after it, or `FROM => TO`.
    const CASES: &str = r#"
-- The team.
- | - | room | + [team]\nplaces = { tx = [1.0, 2.0] }\nframe = "hall"
- | - | room | + [team]\nranges.tx = { topic = "/uwb/tx" }
places | no peer `ty` | room | + [team]\nframe = "hall"\nplaces.ty = [1.0, 2.0]
places | finite | room | + [team]\nplaces.tx = [1.0, inf]
places | 3 numbers where 2 are expected | room | + [team]\nplaces.tx = [1.0, 2.0, 3.0]
antenna_offset_m | 4 numbers where 3 | room | odometry.room => antenna_offset_m = [0, 0, 0, 7]\nodometry.room
place =  | unknown field | room | + [team]\nplaces = {}\nplace = {}
ranges | no peer `ty` | room | + [team]\nframe = "map"\nranges.ty = { topic = "/uwb/ty" }
ranges | not a valid ROS 2 name | room | + [team]\nframe = "map"\nranges.tx = { topic = "/uwb tx" }
ranges | above 0 | room | + [team]\nframe = "map"\nranges.tx = { topic = "/uwb", sd_m = 0.0 }
frame | other than | room | + [team]\nframe = "map"\nplaces.tx = [1.0, 2.0]\n[ros2]\nframe = "map"
[team] | needs a [[peer]] | card | + [team]
-- This robot.
- | - | room
- | - | card
- | - | card | capture.card = {} => capture.stock.frames = true
frame | unknown field | card | capture.card = {} => capture.stock.frame = true
capture.card | `mac` | card | mac = "02:00:00:00:00:01"\n =>
no.dat | there is no log | card | capture.card = {}\n => | + [capture.replay]\nspeed = 2\nfile = "no.dat"
no.toml | no.toml | room | INLINE\n => | + [capture.room]\nspeed = 2.0\nscene = "no.toml"\nrobot = "rx"
nobody | no robot `nobody`: it has rx, tx | room | INLINE\n => | + [capture.room]\nscene = "lab-circle"\nrobot = "nobody"
mac = | `rx` has the MAC | room | channel => mac = "02:00:00:00:00:99"\nchannel
mac = | `tx` has the MAC | room | + mac = "02:00:00:00:00:99"
[[peer]] | no robot here ever moves | room | odometry.room = {}\n =>
capture.card | there is nothing to do | card | [log]\nfile = "x.dat"\n =>
-- Numbers.
elevation_max_deg = |  | room | + [estimator]\naccurate = true\nelevation_max_deg = 91.0
heading_sd_deg = |  | room | + [estimator]\naccurate = true\nheading_sd_deg = -1.0
accurate_every_s = |  | room | + [estimator]\naccurate = true\naccurate_every_s = -1.0
extrapolate_s = |  | room | + [estimator]\naccurate = true\nextrapolate_s = 2.0
window_m = | window_m (0.050 m) | room | + [estimator]\naccurate = true\nwindow_m = 0.05
least_motion_m = |  | room | + [estimator]\naccurate = true\nleast_motion_m = 9.0
rate_hz = | rate_hz in [estimator] | room | + [estimator]\naccurate = true\nrate_hz = 101.0
rate_hz = | rate_hz in [estimator] | room | + [estimator]\naccurate = true\nrate_hz = 1e-9
inf | antenna_offset_m | room | odometry.room => antenna_offset_m = [0.0,\n  inf, 0.0]\nodometry.room
nan | odometry: every number | room | odometry.room = {} => [odometry.static]\nposition_m = [0.0, 0.0, 0.0]\nheading_deg = nan
nan | peer `tx` | room | yaw_deg = 0.0 => yaw_deg = nan
nan | peer `tx` | room | + antenna_offset_m = [0, nan, 0]
inf | peer | room | + [peer.poses.static]\nheading_deg = 1.0\nposition_m = [0, 0, inf]
1e300 | not on a robot | room | odometry.room => antenna_offset_m = [1e300, 0.0, 0.0]\nodometry.room
-10.5 | peer `tx`: antenna_offset_m: -1.05e1 m | room | + antenna_offset_m = [0, 0,\n-10.5]
- | - | room | + antenna_offset_m = [0, 0, -10]
- | - | card | WHEELS => odometry.ros2.antenna_frame = "wifi"
antenna_offset_m | leave `antenna_offset_m` out | card | WHEELS => antenna_offset_m = [0, 0, 0.2]\nodometry.ros2.antenna_frame = "wifi"
antenna_offset_m | peer `b`: `antenna_frame` | linked | + antenna_offset_m = [0, 0, 0.2]\nposes.ros2.antenna_frame = "wifi"
antenna_offset_m | in its own configuration | linked | + antenna_offset_m = [0, 0, 0.2]\nposes.network = {}
-- A camera's mount needs poses of a camera.
- | - | card | WHEELS => MOUNT\nodometry.ros2 = { topic = "/odom" }
camera_mount | `antenna_frame` moves poses | card | WHEELS => MOUNT\nodometry.ros2 = { topic = "/odom", antenna_frame = "wifi" }
camera_mount | of the wheels already | card | WHEELS => MOUNT\nWHEELS
camera_mount | no poses of a camera | card | WHEELS => MOUNT\nodometry.static = {}
camera_mount | of the robot, not of a camera | room | odometry.room => MOUNT\nodometry.room
inf | left_m: every number must be finite | card | WHEELS => camera_mount = { forward_m = 0.0, left_m = inf }\nodometry.csv.file = "no.csv"
1e300 | forward_m: 1e300 m is not on | card | WHEELS => camera_mount = { forward_m = 1e300, left_m = 0 }\nodometry.static = {}
-- Poses.
no.csv | no trajectory | card | WHEELS => odometry.csv.file = "no.csv"
odometry.csv | replayed capture | card | WHEELS => odometry.csv.file = "lib.rs"
odometry.room | `room` poses | card | WHEELS => odometry.room = {}
odometry.network | own poses | card | WHEELS => odometry.network = {}
opencr | `opencr` poses are live | room | odometry.room = {} => WHEELS
odometry.ros | `ros` poses are live | room | odometry.room = {} => odometry.ros.topic = "/odom"
odometry.ros2 | are live | room | odometry.room = {} => odometry.ros2 = {}
poses.network | peer `b`: `network` poses | linked | + poses.network = {}
poses.opencr | peer `b`: a peer's port | linked | + poses.opencr.port = "x"
poses.ros | peer `b`: a peer's poses have the times of its own clock | linked | + poses.ros = { topic = "/b/odom", stamp = "receipt" }
topic |  | card | WHEELS => odometry.ros = {\n  topic = "odom" }
odometry.ros | `/odom/` is not a valid ROS name | card | WHEELS => odometry.ros = { topic = "/odom/" }
odometry.ros |  | card | WHEELS => odometry.ros = { topic = "/odom", type = "imu" }
odometry.ros |  | card | WHEELS => odometry.ros = { topic = "/odom", stamp = "now" }
-- Peers.
# again | has its name | linked | + [[peer]]\nmac = "02:00:00:00:00:03"\nrecords.network = {}\nname = "b" # again
# again | another peer has its name or MAC | linked | + [[peer]]\nname = "c"\nrecords.network = {}\nmac = "02:00:00:00:00:02" # again
# none | needs a name | linked | "b" => "" # none
# c | peer `c`: `mac` is missing | linked | + [[peer]] # c\nname = "c"\nrecords.network = {}
# own | this robot's own MAC | linked | + [[peer]]\nname = "c"\nrecords.network = {}\nmac = "02:00:00:00:00:01" # own
no.dat | there is no log | linked | + SECOND\nrecords.replay.file = "no.dat"
lib.rs | a replayed log needs | linked | + SECOND\nrecords.replay.file = "lib.rs"
records.room | `room` records need | linked | + SECOND\nrecords.room = {}
# c | `network` records need a [network] | linked | + SECOND\nrecords.network = {} # c
certificate | `certificate` is the common name | linked | + SECOND\ncertificate = " "\nrecords.network = {}
certificate | records and poses of the network | linked | + SECOND\ncertificate = "c"\nrecords.replay.file = "no.dat"
"ty" | no robot `ty` | room | + [[peer]]\nrecords.room = {}\nname = "ty"
# itself | peer `rx` is this robot itself | alone | + ITSELF
# itself | peer `rx` is this robot itself | card | capture.card = {} => capture.served = { socket = "s", robot = "rx" } | mac = => # | + ITSELF
-- Antennas that need no peer: a sender by its name in the room, or by its MAC.
- | - | alone | + ARRAY
- | - | alone | + ARRAY | + HEARD
- | - | alone | odometry.room => odometry.static | + ARRAY | + chain_constants_deg = [[52.7, 0.3]] | + HEARD
[[peer]] | no robot here ever moves | alone | odometry.room => odometry.static | + ARRAY | + HEARD
antennas = | named twice | alone | + ARRAY | "B" => "A"
antennas = | A, B or C | alone | + ARRAY | "B" => "D"
antennas = | 2 or 3 | alone | + ARRAY | , "B" =>
baselines_m | 0 baselines for 2 antennas | alone | + ARRAY | [[0.1, 0.0, 0.0]] => []
baselines_m | metres are expected | alone | + ARRAY | 0.1, => 100.0,
chain_constants_deg | a deviation of 0 or more | alone | + ARRAY | + chain_constants_deg = [[1.0, -2.0]]
records.heard | needs an [array] | alone | + HEARD
records.heard | leave `poses` out | alone | + ARRAY | + HEARD | + poses.room = {}
"ty" | no robot `ty` | alone | + ARRAY | + HEARD | "tx" => "ty"
-- FeitCSI.
- | - | card | capture.card = {} => capture.feitcsi.udp = "127.0.0.1:8008"
udp | address | card | capture.card = {} => capture.feitcsi.udp = "8008"
pipe | no named pipe | card | capture.card = {} => capture.feitcsi.pipe = "lib.rs"
-- A node of ROS 1, and the sounding exchange.
master | one looks like | card | + [ros]\nframe = "odom"\nmaster = "10.0.0.1:11311/"
foxglove_origins | needs `foxglove` | card | + [output]\nbearings = "-"\nfoxglove_origins = ["https://lab"]
node | not a valid ROS name | card | + [ros]\nframe = "odom"\nnode = "a b"
- | - | linked | ANSWERS | + MONITOR
[sounding] | a monitor interface, is missing | linked | + [sounding]\nfifo = false
[sounding] | needs a [[peer]] | card | + MONITOR
[sounding] | is done with a card | room | + MONITOR
records.sounding | `initiate` | linked | ANSWERS | + MONITOR | + initiate = false
records.sounding | it must stand | linked | ANSWERS\nposes.room = {} | + MONITOR
interface | leave `interface` out | linked | capture.card = {} => capture.served = { socket = "s", robot = "a" } | + MONITOR
key = | there is no key | linked | + MONITOR | + key = "no.key"
rate_hz = | rounds | linked | + MONITOR | + rate_hz = 1e5
mcs = | 23 | linked | + MONITOR | + mcs = 24
links = | links | linked | + MONITOR | + links = 0
-- A node of ROS 2.
b-1 | the names of those of `b_1` | linked | + SECOND\nrecords.network = {} | "b" => "b_1" | "c" => "b-1" | + ROS2
- | - | card | + ROS2\ninterface = "127.0.0.2"\nnamespace = "/lab"\nnode = "n"
- | - | card | + ROS2\ninterface = "192.168.1.5"\ninsecure = true\npeers = ["10.0.0.1"]
interface | `insecure = true` | card | + ROS2\ninterface = "192.168.1.5"
interface | one address | card | + ROS2\ninterface = "0.0.0.0"\ninsecure = true
peers | cannot be reached from 127.0.0.1 | card | + ROS2\npeers = ["10.0.0.1"]
domain | 0 to 232 | card | + ROS2\ndomain = 233
namespace | not a valid ROS 2 namespace | card | + ROS2\nnamespace = "lab"
node | not a valid ROS 2 node name | card | + ROS2\nnode = "/a/b"
remap | not a valid ROS 2 name | card | + ROS2\nremap = { "a b" = "/c" }
type | from `frame` to `child` | card | WHEELS => [odometry.ros2]\ntype = "tf"\nframe = "odom"
child | is for transforms | card | WHEELS => [odometry.ros2]\nchild = "base_link"
antenna_frame | is for odometry | card | WHEELS => [odometry.ros2]\ntype = "pose"\nantenna_frame = "wifi"
imu | not a valid ROS 2 name | card | WHEELS => [odometry.ros2]\nimu = "1mu"
-- The network.
backlog | 256 to 1000000 | card | + [network]\ngroup = "g"\nbacklog = 1
no.json5 | no such file | card | + [network]\ngroup = "g"\nzenoh = "no.json5"
"#;

    /// Names that stand for longer texts in changes.
    const LONGER: [(&str, &str); 10] = [
        ("WHEELS", "odometry.opencr.port = \"/dev/null\""),
        ("INLINE", "capture.room = { scene = \"lab-circle\", robot = \"rx\" }"),
        ("MOUNT", "camera_mount = { forward_m = 0.04, left_m = 0.17, yaw_deg = -1.5 }"),
        ("SECOND", "[[peer]]\nname = \"c\"\nmac = \"02:00:00:00:00:03\""),
        ("ITSELF", "[[peer]]\nrecords.room = {}\nname = \"rx\" # itself"),
        ("ARRAY", "[array]\nantennas = [\"A\", \"B\"]\nbaselines_m = [[0.1, 0.0, 0.0]]"),
        ("HEARD", "[[peer]]\nname = \"tx\"\nrecords.heard = {}"),
        ("ANSWERS", "records.network = {} => records.sounding = {}"),
        ("MONITOR", "[sounding]\ninterface = \"mon0\""),
        ("ROS2", "[ros2]\nframe = \"odom\""),
    ];

    #[test]
    fn what_contradicts_itself_or_this_machine_is_refused_at_its_line() {
        let linked = "[[peer]]\nname = \"b\"\nmac = \"02:00:00:00:00:02\"\nrecords.network = {}\n";
        let bases = [("alone", [ROOM, ""]), ("room", [ROOM, PEER]), ("card", [CARD, ""]), ("linked", [CARD, linked])];
        let cases = CASES.lines().filter(|case| !case.is_empty() && !case.starts_with("--"));
        assert_eq!(cases.clone().count(), 125);
        for case in cases {
            let columns: Vec<&str> = case.split(" | ").collect();
            let [key, why, base, changes @ ..] = &columns[..] else { panic!("{case}") };
            let mut text = bases.iter().find(|(name, _)| name == base).unwrap().1.concat();
            for change in changes {
                let whole =
                    LONGER.iter().fold(change.replace("\\n", "\n"), |all, (name, long)| all.replace(name, long));
                match (whole.strip_prefix("+ "), whole.split_once(" =>")) {
                    (Some(more), _) => text += &format!("{more}\n"),
                    (None, Some((from, to))) if text.contains(from) => {
                        text = text.replace(from, to.strip_prefix(' ').unwrap_or(to));
                    }
                    _ => panic!("{case}: {text}"),
                }
            }
            if *key == "-" { good(&text) } else { refused(&text, key, why) }
        }
    }

    #[test]
    fn a_pace_is_one_that_can_be_kept() {
        let paced = |speed: &str| {
            let table = format!("[capture.room]\nscene = \"lab-circle\"\nspeed = {speed}\nrobot = \"rx\"\n");
            format!("{ROOM}{table}{PEER}").replace("capture.room = { scene = \"lab-circle\", robot = \"rx\" }\n", "")
        };
        let replay = |speed: &str| {
            CARD.replace("capture.card = {}\n", "")
                .replace("odometry.opencr.port = \"/dev/null\"", "odometry.static = {}")
                + &format!("[capture.replay]\nfile = \"lib.rs\"\nspeed = {speed}\n")
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
            let output = "[output]\nbearings = \"-\"\nfoxglove = \"127.0.0.1:1\"\n";
            refused(&format!("{CARD}{output}"), "foxglove", "foxglove in [output]");
        }
        if crate::adapters::missing("zenoh").is_some() {
            refused(&format!("{CARD}[network]\ngroup = \"g\"\n"), "[network]", "--features zenoh");
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
        refused(&with("a.dat", "./a.dat", "c"), "bearings", "is also the output of `file`");
        refused(&with("a.dat", "a.datstp", "c"), "bearings", "is also the output of `file`");
        refused(&with("a.dat", "b", "a.dat"), "status_socket", "is also the output of `file`");
        refused(&with("a.dat", "b", "b"), "status_socket", "is also the output of `bearings`");
        refused(&CARD.replace("x.dat", "/dev/full"), "/dev/full", "no regular file");
        refused(&format!("{CARD}rotate_mib = 0\n"), "rotate_mib", "a file of its own");
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
        for (capture, bearings, key) in [
            ("rx.dat", "rx.dat", "`capture.replay`"),
            ("rx.dat", "sub/../rx.dat", "`capture.replay`"),
            ("rx.dat", "./rx.dat", "`capture.replay`"),
            ("rx.dat", "sub/link.dat", "`capture.replay`"),
            ("sub/link.dat", "rx.dat", "`capture.replay`"),
            ("rx.dat", "sub/hard.dat", "`capture.replay`"),
            ("rx.dat", "rx.datstp", "`capture.replay`"),
            ("sub/link.dat", "rx.datstp", "`capture.replay`"),
            ("rx.dat", "tx.dat", "`records.replay` of peer `tx`"),
            ("rx.dat", "way.csv", "`odometry`"),
            ("rx.dat", "hard.csv", "`odometry`"),
        ] {
            let why = said(&config(capture, &format!("bearings = '{bearings}'")));
            let wanted = format!("is an input ({key}): name another output");
            assert!(why.starts_with("line 7: ") && why.contains(&wanted), "{capture}, {bearings}: {why}");
        }
        let output = |more: &str| said(&config("rx.dat", more));
        assert_eq!(output("bearings = 'out.json'\n[log]\nfile = 'own.dat'"), "");
        assert!(output("bearings = ''\n[log]\nfile = 'rx.dat'").starts_with("line 9: "));
        assert!(output("bearings = ''\nstatus_socket = 'way.csv'").starts_with("line 8: "));
        let keyed = format!("{CARD}[output]\nbearings = 'key'\n[sounding]\ninterface = 'mon0'\nkey = 'key'\n{PEER}")
            .replace("records.room = {}", "mac = '02:00:00:00:00:02'\nrecords.sounding = {}");
        let why = said(&keyed);
        assert!(why.contains("is an input (`sounding.key`)"), "{why}");
        assert_eq!(std::fs::read(folder.join("rx.dat")).unwrap(), b"rx.dat");
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn names_that_no_file_or_socket_can_have_are_refused_before_the_start() {
        let output = |more: &str| format!("{CARD}[output]\nbearings = \"\"\n{more}\n");
        let said =
            |text: &str| Config::read(text, Path::new("")).err().map(|error| error.to_string()).unwrap_or_default();
        let empty = "an empty name is no file";
        assert!(said(&output("status_socket = \"\"")).starts_with(&format!("line 10: {empty}")));
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
        refused(&network("[ros2]\ndistribution = \"humble\"\n"), "ros2 = true", "Jazzy");
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
            format!("zenoh = '{}'\nlisten = [\"tls/127.0.0.1:7447\"]\n", file.display())
        };
        let peer = "[[peer]]\nname = \"b\"\nmac = \"02:00:00:00:00:02\"\nrecords.network = {}\ncertificate = \"b\"\n";
        let network = |file: &str| format!("{CARD}[network]\n{file}{peer}");
        refused(&network(""), "[network]", "needs a network where both ends show one");
        good(&network(&zenoh("asks.json5", "")));
        let ruled = zenoh("rules.json5", "access_control: { enabled: true, default_permission: 'allow' }");
        refused(&network(&ruled), "[network]", "has an `access_control` of its own");
        good(&network(&ruled).replace("certificate = \"b\"\n", ""));
        std::fs::remove_dir_all(folder).unwrap();
    }
}
