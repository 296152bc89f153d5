//! This robot: its card, its room, its poses.

use super::super::{CameraMount, Capture, Feitcsi, Odometry, Records, ros};
use super::{Check, too_far};
use csi5300::pipeline::ArrayError;
use csi5300_sim::Room;
use csi5300_sim::toml_lines::Step::{Index, Key};
use std::os::unix::fs::FileTypeExt;

impl Check<'_> {
    /// This robot's MAC and log.
    pub(super) fn own_card(&mut self) {
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
    pub(super) fn array(&mut self) {
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
    pub(super) fn own_room(&mut self) {
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
        for (robot, why) in ros::wrong_followed(asked, scene) {
            let [capture, room, follow] = key("follow");
            match robot {
                Some(robot) => self.refuse(&[capture, room, follow, Key(robot)], why),
                None => self.refuse(&[capture, room], why),
            }
        }
    }

    /// MACs that are not those of the simulated room.
    pub(super) fn macs_of_the_room(&mut self) {
        let config = self.config;
        let Capture::Room(asked) = config.capture.get_ref() else { return };
        let peers = config.peer.iter().map(|peer| (peer.get_ref().name.as_str(), peer.get_ref().mac));
        let all = std::iter::once((asked.robot.as_str(), config.mac)).chain(peers);
        let given: Vec<_> = all.enumerate().filter_map(|(k, (name, mac))| Some((k, name, mac?))).collect();
        if given.is_empty() {
            return;
        }
        let Some(room) = self.scene.as_ref().and_then(|scene| Room::new(scene).ok()) else { return };
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
    pub(super) fn motion(&mut self) {
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
    pub(super) fn own_poses(&mut self) {
        if let Some((place, why)) = self.wrong_poses(&self.config.odometry, true) {
            let place: Vec<_> = std::iter::once(Key("odometry")).chain(place).collect();
            self.refuse(&place, why);
        }
    }

    /// How this robot carries its camera.
    pub(super) fn camera(&mut self) {
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
    pub(super) fn something_to_do(&mut self) {
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
