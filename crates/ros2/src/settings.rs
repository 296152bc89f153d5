//! The configuration of ROS 2: topics of poses, and this program as a node.

use crate::names::is_name;
use crate::reach::{Asked, Reach};
use csi5300::motion::odometry::ros::Stamp;
use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::path::PathBuf;

/// Highest domain whose port numbers are valid.
const DOMAINS: u16 = 232;
/// Static peers at most: each is queried at 32 ports.
pub(crate) const PEERS: usize = 64;

/// The type of a topic of poses.
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
    /// Its name: `/tb3_0/odom` from the root, `odom` in the node's namespace. Default `/odom`, or `/tf` for transforms.
    #[serde(default)]
    pub topic: Option<String>,
    /// Its type.
    #[serde(default, rename = "type")]
    pub kind: Kind,
    /// The time of a pose. Default: the stamp in its header; for a robot that the room follows, the time of receipt.
    #[serde(default)]
    pub stamp: Option<Stamp>,
    /// The frame of the poses: others are refused. If absent, a frame other than the first starts a new one. With transforms:
    /// the frame from which they are followed.
    #[serde(default)]
    pub frame: Option<String>,
    /// With transforms: the frame to which they are followed, such as `base_link`, or the antenna's own.
    #[serde(default)]
    pub child: Option<String>,
    /// The antenna's frame, if `/tf_static` gives its place on the robot (from odometry's `child_frame_id`).
    #[serde(default)]
    pub antenna_frame: Option<String>,
    /// Topic of `sensor_msgs/msg/Imu` whose orientation replaces the robot's, from the first pose on.
    #[serde(default)]
    pub imu: Option<String>,
}

impl Topic {
    /// The topic, or its default.
    #[must_use]
    pub fn name(&self) -> &str {
        self.topic.as_deref().unwrap_or(if self.kind == Kind::Tf { "/tf" } else { "/odom" })
    }
}

/// The release whose `ros2 node list` shows this node.
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
    /// The domain; default `$ROS_DOMAIN_ID`, then 0.
    pub domain: Option<u16>,
    /// Name of the node; default `csi5300_` and the robot's name.
    pub node: Option<String>,
    /// Its namespace, such as `/lab`.
    pub namespace: String,
    /// The address of this machine whose network is used. DDS does not authenticate: any address but loopback needs `insecure`.
    /// Default: ROS's variables ([`Settings::reach`]), then loopback.
    pub interface: Option<Ipv4Addr>,
    /// Accept that anybody who reaches the interface can publish poses to this robot and read its topics.
    pub insecure: bool,
    /// Announce to the domain's multicast group and listen to it. Default: as ROS's variables and the interface decide.
    pub multicast: Option<bool>,
    /// Machines that are queried where multicast does not reach; default `$ROS_STATIC_PEERS`.
    pub peers: Option<Vec<Ipv4Addr>>,
    /// The release whose `ros2 node list` shows this node.
    pub distribution: Distribution,
    /// Names that are replaced by others (remapping).
    pub remap: BTreeMap<String, String>,
    /// Messages have the time of `/clock`.
    pub use_sim_time: bool,
    /// `frame_id` of published messages: the frame of this robot's poses.
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
    /// Record what is read and published, from the start on.
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
    /// The domain, or its default.
    #[must_use]
    pub fn domain(&self) -> u16 {
        let told = || std::env::var("ROS_DOMAIN_ID").ok()?.trim().parse().ok();
        self.domain.or_else(told).unwrap_or(0)
    }

    /// Which nodes the node looks for: by these settings, then `ROS_LOCALHOST_ONLY`, `ROS_AUTOMATIC_DISCOVERY_RANGE` and
    /// `ROS_STATIC_PEERS`.
    #[must_use]
    pub fn reach(&self) -> Reach {
        Reach::of(self, &Asked::by_environment(), crate::reach::outward)
    }
}

/// A key of the table, if the error belongs to one, and the error.
pub type Wrong = (Option<&'static str>, String);

/// The error in the name of a topic.
#[must_use]
pub fn wrong_name(name: &str) -> Option<String> {
    let wrong = !is_name(name);
    wrong.then(|| format!("`{name}` is not a valid ROS 2 name: use one like /tb3_0/odom, odom or ~/odom"))
}

/// The error in a topic of poses of this robot, of a peer, or of a robot that the room follows.
#[must_use]
pub fn wrong_topic(topic: &Topic, peers: bool) -> Option<Wrong> {
    if peers && topic.stamp == Some(Stamp::Receipt) {
        // The offset of a peer's clock is estimated from the exchanges and applied to its poses.
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

/// The error in the `[ros2]` table.
#[must_use]
pub fn wrong_settings(ros: &Settings) -> Option<Wrong> {
    if ros.domain() > DOMAINS {
        return Some((Some("domain"), format!("domain {}: 0 to {DOMAINS}", ros.domain())));
    }
    let interface = ros.interface.unwrap_or(Ipv4Addr::LOCALHOST);
    if interface.is_unspecified() || interface.is_multicast() || interface.is_broadcast() {
        let why = format!("interface {interface}: use one address of this machine, such as 127.0.0.1");
        return Some((Some("interface"), why));
    }
    if !ros.insecure && !interface.is_loopback() {
        let why = format!(
            "anybody who reaches {interface} could publish poses to this robot, because DDS does not authenticate: use \
             127.0.0.1, or set `insecure = true`"
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
        return Some((Some("namespace"), format!("`{space}` is not a valid ROS 2 namespace: use one like /lab")));
    }
    if let Some(node) = ros.node.as_deref().filter(|node| node.contains(['/', '~']) || wrong_name(node).is_some()) {
        return Some((Some("node"), format!("`{node}` is not a valid ROS 2 node name: use one like csi5300_burger")));
    }
    let names = ros.remap.iter().flat_map(|(from, to)| [from, to]);
    names.into_iter().find_map(|name| Some((Some("remap"), wrong_name(name)?)))
}
