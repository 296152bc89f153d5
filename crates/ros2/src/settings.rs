//! What a configuration says of ROS 2: topics of poses, and this program as a node.

use crate::names::is_name;
use crate::reach::{Asked, Reach};
use csi5300::motion::odometry::ros::Stamp;
use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::path::PathBuf;

/// Highest domain whose ports are ports.
const DOMAINS: u16 = 232;
/// Static peers at most: each is asked at 32 ports.
pub(crate) const PEERS: usize = 64;

/// What is published on a topic of poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// `nav_msgs/msg/Odometry`.
    #[default]
    Odometry,
    /// `geometry_msgs/msg/PoseStamped`.
    Pose,
    /// `tf2_msgs/msg/TFMessage`, from `frame` to `child`.
    Tf,
}

/// Where poses come from.
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Topic {
    /// Its name: `/tb3_0/odom` from the root, `odom` in the node's namespace; `/odom`, or `/tf` for transforms, where absent.
    #[serde(default)]
    pub topic: Option<String>,
    /// What is published on it.
    #[serde(default, rename = "type")]
    pub kind: Kind,
    /// What is taken for the time of a pose: the stamp in its header, for a robot that the room follows its receipt.
    #[serde(default)]
    pub stamp: Option<Stamp>,
    /// The frame of the poses: others are refused, and without it another frame than that of the first is a new frame. With
    /// transforms: the frame that they are followed from.
    #[serde(default)]
    pub frame: Option<String>,
    /// With transforms: the frame that they are followed to, such as `base_link`, or the antenna's own.
    #[serde(default)]
    pub child: Option<String>,
    /// The antenna's frame, where `/tf_static` has its place on the robot (from odometry's `child_frame_id`).
    #[serde(default)]
    pub antenna_frame: Option<String>,
    /// `sensor_msgs/msg/Imu` whose turns are taken for the robot's, from the first pose on.
    #[serde(default)]
    pub imu: Option<String>,
}

impl Topic {
    /// The topic that is meant.
    #[must_use]
    pub fn name(&self) -> &str {
        self.topic.as_deref().unwrap_or(if self.kind == Kind::Tf { "/tf" } else { "/odom" })
    }
}

/// The release whose nodes list this one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distribution {
    /// Humble.
    Humble,
    /// Jazzy, and all from Iron on.
    #[default]
    Jazzy,
}

/// This program as a node of ROS 2.
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The domain; `$ROS_DOMAIN_ID` where absent, then 0.
    pub domain: Option<u16>,
    /// Name of the node; `csi5300_` and the robot's name where absent.
    pub node: Option<String>,
    /// Its namespace, `/lab`.
    pub namespace: String,
    /// The address of this machine whose network is used. DDS asks nobody who they are: other than loopback needs `insecure`.
    /// Where absent, ROS's variables say ([`Settings::reach`]), then loopback.
    pub interface: Option<Ipv4Addr>,
    /// Anybody who reaches the interface may publish poses to this robot, and read along.
    pub insecure: bool,
    /// Announce to the domain's group, and listen to it: unless this or ROS's variables say otherwise.
    pub multicast: Option<bool>,
    /// Machines that are asked, where multicast does not reach; those of `$ROS_STATIC_PEERS` where absent.
    pub peers: Option<Vec<Ipv4Addr>>,
    /// The release whose `ros2 node list` shows this node.
    pub distribution: Distribution,
    /// Names that are replaced by others.
    pub remap: BTreeMap<String, String>,
    /// Times of messages are those of `/clock`.
    pub use_sim_time: bool,
    /// `frame_id` of what is published: the frame of this robot's poses.
    pub frame: String,
    /// Publish bearings and poses of peers.
    pub publish_bearings: bool,
    /// Publish markers of bearings.
    pub publish_markers: bool,
    /// Publish diagnostics.
    pub publish_diagnostics: bool,
    /// Publish the CSI that this robot's card measures.
    pub publish_csi: bool,
    /// Publish transforms to peers whose range is known.
    pub publish_tf: bool,
    /// Record what is read and published, from the start.
    pub bag: Option<PathBuf>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            domain: None,
            node: None,
            namespace: "/".into(),
            interface: None,
            insecure: false,
            multicast: None,
            peers: None,
            distribution: Distribution::default(),
            remap: BTreeMap::new(),
            use_sim_time: false,
            frame: "odom".into(),
            publish_bearings: true,
            publish_markers: true,
            publish_diagnostics: true,
            publish_csi: false,
            publish_tf: false,
            bag: None,
        }
    }
}

impl Settings {
    /// The domain that is meant.
    #[must_use]
    pub fn domain(&self) -> u16 {
        let told = || std::env::var("ROS_DOMAIN_ID").ok()?.trim().parse().ok();
        self.domain.or_else(told).unwrap_or(0)
    }

    /// Whom the node looks for: as these settings say, then `ROS_LOCALHOST_ONLY`, `ROS_AUTOMATIC_DISCOVERY_RANGE` and
    /// `ROS_STATIC_PEERS`.
    #[must_use]
    pub fn reach(&self) -> Reach {
        Reach::of(self, &Asked::by_environment(), crate::reach::outward)
    }
}

/// A key below the table, if it is one, and what is wrong with it.
pub type Wrong = (Option<&'static str>, String);

fn wrong_name(name: &str) -> Option<String> {
    let wrong = !is_name(name);
    wrong.then(|| format!("`{name}` is no name in ROS 2: one looks like /tb3_0/odom, odom or ~/odom"))
}

/// What is wrong with poses from a topic, of this robot, of a peer, or of a robot that the room follows.
#[must_use]
pub fn wrong_topic(topic: &Topic, peers: bool) -> Option<Wrong> {
    if peers && topic.stamp == Some(Stamp::Receipt) {
        // How far a peer's clock is ahead is taken from the exchanges, and applied to its poses.
        return Some((Some("stamp"), "a peer's poses have the times of its own clock: `stamp = \"header\"`".into()));
    }
    if topic.kind == Kind::Tf && (topic.frame.is_none() || topic.child.is_none()) {
        let why = "transforms are followed from `frame` to `child`: frame = \"odom\", child = \"base_link\"";
        return Some((Some("type"), why.into()));
    }
    if topic.kind != Kind::Tf && topic.child.is_some() {
        return Some((Some("child"), "`child` is for transforms: `type = \"tf\"`".into()));
    }
    if topic.kind != Kind::Odometry && topic.antenna_frame.is_some() {
        let why =
            "`antenna_frame` is for odometry, whose messages name the robot's frame; with transforms it is `child`";
        return Some((Some("antenna_frame"), why.into()));
    }
    let names = [("topic", topic.topic.as_deref()), ("imu", topic.imu.as_deref())];
    names.into_iter().find_map(|(key, name)| Some((Some(key), wrong_name(name?)?)))
}

/// What is wrong with the `[ros2]` table.
#[must_use]
pub fn wrong_settings(ros: &Settings) -> Option<Wrong> {
    if ros.domain() > DOMAINS {
        return Some((Some("domain"), format!("domain {}: 0 to {DOMAINS}", ros.domain())));
    }
    let interface = ros.interface.unwrap_or(Ipv4Addr::LOCALHOST);
    if interface.is_unspecified() || interface.is_multicast() || interface.is_broadcast() {
        let why = format!("interface {interface}: one address of this machine, such as 127.0.0.1");
        return Some((Some("interface"), why));
    }
    if !ros.insecure && !interface.is_loopback() {
        let why = format!(
            "anybody who reaches {interface} could publish poses to this robot, as DDS asks nobody who they are: use \
             127.0.0.1, or say `insecure = true`"
        );
        return Some((Some("interface"), why));
    }
    let interface = ros.interface.unwrap_or_else(|| ros.reach().interface);
    let peers = ros.peers.as_deref().unwrap_or_default();
    if let Some(peer) = peers.iter().find(|peer| interface.is_loopback() && !peer.is_loopback()) {
        return Some((Some("peers"), format!("peer {peer} cannot be reached from {interface}")));
    }
    if peers.len() > PEERS {
        return Some((Some("peers"), format!("{} peers: at most {PEERS}", peers.len())));
    }
    let space = Some(ros.namespace.as_str()).filter(|space| *space != "/");
    if let Some(space) = space.filter(|space| !space.starts_with('/') || wrong_name(space).is_some()) {
        return Some((Some("namespace"), format!("`{space}` is no namespace in ROS 2: one looks like /lab")));
    }
    if let Some(node) = ros.node.as_deref().filter(|node| node.contains(['/', '~']) || wrong_name(node).is_some()) {
        return Some((Some("node"), format!("`{node}` is no name of a node in ROS 2: one looks like csi5300_burger")));
    }
    let names = ros.remap.iter().flat_map(|(from, to)| [from, to]);
    names.into_iter().find_map(|name| Some((Some("remap"), wrong_name(name)?)))
}
