//! ROS 1 in a configuration: topics of poses, and this program as a node of a master.

use super::{Capture, Config, Odometry, Room};
use csi5300::motion::odometry::ros::{Kind, Stamp};
use csi5300_sim::Scene;
use csi5300_sim::motion::RobotMotion;
use toml::Spanned;

/// See [`Odometry::Ros`].
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Topic {
    /// Its name, from the root: `/tb3_0/odom`.
    pub topic: String,
    /// Its message type.
    #[serde(default, rename = "type")]
    pub kind: Kind,
    /// The time of a pose: the stamp in its header; for a robot that the room follows, its receipt.
    #[serde(default)]
    pub stamp: Option<Stamp>,
    /// Poses of other frames are refused; without it another frame than that of the first pose is a new frame.
    #[serde(default)]
    pub frame: Option<String>,
}

/// This program as a node of ROS 1, through rospy.
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize)]
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
    #[must_use]
    pub fn master(&self) -> String {
        let told = || std::env::var("ROS_MASTER_URI").ok().filter(|uri| !uri.is_empty());
        let master = self.master.clone().or_else(told);
        master.unwrap_or_else(|| "http://localhost:11311".into()).trim_end_matches('/').to_owned()
    }

    /// The name of the node: the configured one, or that of the robot or of the room's robot, or the MAC.
    #[must_use]
    pub fn node(&self, config: &Config) -> String {
        self.node.clone().unwrap_or_else(|| format!("/csi5300_{}", name_part(&config.robot())))
    }
}

/// A name as a part of a name in ROS, which has letters, digits and `_` only.
#[must_use]
pub fn name_part(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    name.chars().map(plain).collect()
}

/// The problem of a name of a node or topic: it must start at the root, with parts of letters, digits and `_`.
fn wrong_name(name: &str) -> Option<String> {
    let part = |part: &str| {
        part.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    let good = name.strip_prefix('/').is_some_and(|parts| parts.split('/').all(part));
    (!good).then(|| format!("`{name}` is not a valid ROS name: use one like /tb3_0/odom"))
}

/// The problem of poses from a topic, of this robot, of a peer, or of a robot that the room follows: the key below
/// `ros`, if any, and the reason.
pub(super) fn wrong_topic(topic: &Topic, peers: bool) -> Option<(Option<&'static str>, String)> {
    if peers && topic.stamp == Some(Stamp::Receipt) {
        // The exchanges give a peer's clock offset, which is applied to its poses.
        Some((Some("stamp"), "a peer's poses have the times of its own clock: `stamp = \"header\"`".into()))
    } else {
        wrong_name(&topic.topic).map(|why| (Some("topic"), why))
    }
}

/// What is wrong with a source that a robot of the room follows.
fn wrong_source(room: &Room, odometry: &Odometry) -> Option<String> {
    match odometry {
        Odometry::Csv(csv) if !csv.file.is_file() => Some(format!("there is no trajectory {}", csv.file.display())),
        Odometry::Csv(_) => None,
        Odometry::Ros(_) if room.speed != 1.0 => Some("topics are live: use `speed = 1`".into()),
        Odometry::Ros(topic) if topic.stamp == Some(Stamp::Header) => {
            Some("the room uses the times of arrival: `stamp = \"receipt\"`, or none".into())
        }
        Odometry::Ros(topic) => wrong_topic(topic, false).map(|(_, why)| why),
        Odometry::Ros2(_) if room.speed != 1.0 => Some("topics are live: use `speed = 1`".into()),
        Odometry::Ros2(topic) if topic.stamp == Some(Stamp::Header) => {
            Some("the room uses the times of arrival: `stamp = \"receipt\"`, or none".into())
        }
        Odometry::Ros2(topic) => csi5300_ros2::settings::wrong_topic(topic, false).map(|(_, why)| why),
        _ => Some("a robot follows `ros2`, `ros` or `csv`".into()),
    }
}

/// What is wrong with the sources that robots of the room follow, by the robot's name, and with robots that have none.
pub(super) fn wrong_followed<'r>(room: &'r Room, scene: &Scene) -> Vec<(Option<&'r str>, String)> {
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
pub(super) fn wrong_ros(ros: &Ros) -> Option<(Option<&'static str>, String)> {
    let master = ros.master.as_ref().filter(|master| !master.starts_with("http://"));
    if let Some(master) = master {
        return Some((Some("master"), format!("master `{master}`: one looks like http://192.168.1.10:11311")));
    }
    ros.node.as_deref().and_then(wrong_name).map(|why| (Some("node"), why))
}

/// True if anything is read from or published over ROS.
#[must_use]
pub fn is_used(config: &Config) -> bool {
    let is_ros = |odometry: &Odometry| matches!(odometry, Odometry::Ros(_));
    let follows = match config.capture.get_ref() {
        Capture::Room(room) => room.follow.values().any(is_ros),
        Capture::Card(_) | Capture::Stock(_) | Capture::Feitcsi(_) | Capture::Replay(_) | Capture::Served(_) => false,
    };
    let mut peers = config.peer.iter().map(Spanned::get_ref);
    config.ros.is_some() || follows || is_ros(&config.odometry) || peers.any(|peer| is_ros(&peer.poses))
}
