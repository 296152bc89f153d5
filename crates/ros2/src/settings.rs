//! The configuration of ROS 2: topics of poses, this program as a node, and which nodes it looks for. The last is decided by the
//! settings, then by the environment variables of ROS 2 (`rcl`: `localhost.c`, `discovery_options.c`). Leaving this machine always
//! needs `insecure`.

use crate::names::is_name;
use crate::rtps::MULTICAST;
use csi5300::motion::odometry::ros::Stamp;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::net::{IpAddr, Ipv4Addr, ToSocketAddrs, UdpSocket};
use std::path::PathBuf;

/// Highest domain whose port numbers are valid.
const DOMAINS: u16 = 232;
/// The variable of the domain.
const DOMAIN: &str = "ROS_DOMAIN_ID";
/// Static peers at most: each is queried at 32 ports.
const PEERS: usize = 64;

/// Any address behind this machine's default route: the DDS group.
const OUT: Ipv4Addr = MULTICAST;

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
    pub topic: Option<String>,
    /// Its type.
    #[serde(default, rename = "type")]
    pub kind: Kind,
    /// The time of a pose. Default: the stamp in its header; for a robot that the room follows, the time of receipt.
    pub stamp: Option<Stamp>,
    /// The frame of the poses: others are refused. If absent, a frame other than the first starts a new one. With transforms:
    /// the frame from which they are followed.
    pub frame: Option<String>,
    /// With transforms: the frame to which they are followed, such as `base_link`, or the antenna's own.
    pub child: Option<String>,
    /// The antenna's frame, if `/tf_static` gives its place on the robot (from odometry's `child_frame_id`).
    pub antenna_frame: Option<String>,
    /// Topic of `sensor_msgs/msg/Imu` whose orientation replaces the robot's, from the first pose on.
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
        self.asked_domain(std::env::var(DOMAIN).ok()).unwrap_or(0)
    }

    /// The domain, where `told` is the value of the variable.
    fn asked_domain(&self, told: Option<String>) -> Result<u16, String> {
        let told = told.filter(|told| self.domain.is_none() && !told.trim().is_empty());
        let Some(told) = told else { return Ok(self.domain.unwrap_or(0)) };
        told.trim().parse().map_err(|_| format!("{DOMAIN}={told} is no domain: 0 to {DOMAINS}"))
    }

    /// Which nodes the node looks for: by these settings, then `ROS_LOCALHOST_ONLY`, `ROS_AUTOMATIC_DISCOVERY_RANGE` and
    /// `ROS_STATIC_PEERS`.
    #[must_use]
    pub fn reach(&self) -> Reach {
        Reach::of(self, &Asked::by_environment(), outward)
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

/// The error in the name of a frame.
#[must_use]
pub fn wrong_frame(frame: &str) -> Option<String> {
    let wrong = frame.is_empty() || frame.starts_with('/');
    wrong.then(|| format!("frame `{frame}`: tf2 takes no frame that is empty or begins with `/`"))
}

/// The error in a topic of poses.
#[must_use]
pub fn wrong_topic(topic: &Topic) -> Option<Wrong> {
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
    match ros.asked_domain(std::env::var(DOMAIN).ok()) {
        Err(why) => return Some((None, why)),
        Ok(domain) if domain > DOMAINS => return Some((Some("domain"), format!("domain {domain}: 0 to {DOMAINS}"))),
        Ok(_) => {}
    }
    if let Some(why) = wrong_frame(&ros.frame) {
        return Some((Some("frame"), why));
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

/// The range of automatic discovery.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Range {
    /// No discovery, not even on this machine.
    Off,
    /// This machine and static peers.
    Localhost,
    /// The network and static peers.
    Subnet,
}

/// What the variables ask for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Asked {
    /// The range that a variable sets, and that variable.
    range: Option<(Range, &'static str)>,
    peers: Vec<Ipv4Addr>,
    /// Values that could not be understood.
    notes: Vec<String>,
}

impl Asked {
    pub fn by_environment() -> Self {
        Self::by(|name| std::env::var(name).ok(), resolve)
    }

    fn by(variable: impl Fn(&str) -> Option<String>, resolve: impl Fn(&str) -> Option<Ipv4Addr>) -> Self {
        const ONLY: &str = "ROS_LOCALHOST_ONLY";
        const RANGE: &str = "ROS_AUTOMATIC_DISCOVERY_RANGE";
        const STATIC: &str = "ROS_STATIC_PEERS";
        // The older variable takes precedence over both others.
        if variable(ONLY).is_some_and(|value| value == "1") {
            return Self { range: Some((Range::Localhost, ONLY)), ..Self::default() };
        }
        let mut asked = Self::default();
        let range = match variable(RANGE).unwrap_or_default().as_str() {
            // "System default" means this node's own default.
            "" | "SYSTEM_DEFAULT" => None,
            "OFF" => Some(Range::Off),
            "LOCALHOST" => Some(Range::Localhost),
            "SUBNET" => Some(Range::Subnet),
            other => {
                asked
                    .notes
                    .push(format!("{RANGE}={other} is not SUBNET, LOCALHOST, OFF or SYSTEM_DEFAULT: using LOCALHOST"));
                Some(Range::Localhost)
            }
        };
        asked.range = range.map(|range| (range, RANGE));
        for name in variable(STATIC).unwrap_or_default().split(';').filter(|name| !name.is_empty()) {
            match resolve(name) {
                Some(_) if asked.peers.len() >= PEERS => {
                    asked.notes.push(format!("{STATIC}: {name} ignored, too many peers"))
                }
                Some(ip) => asked.peers.push(ip),
                None => asked.notes.push(format!("{STATIC}: {name} has no IPv4 address")),
            }
        }
        asked
    }
}

/// Which nodes a node looks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reach {
    /// The address whose network is used.
    pub interface: Ipv4Addr,
    /// Whether the domain's multicast group is used.
    pub multicast: bool,
    /// Machines that are queried.
    pub peers: Vec<Ipv4Addr>,
    /// No discovery: the node meets nobody.
    pub is_off: bool,
    /// The same as text, with the setting or variable that decided it.
    pub words: String,
    /// Why it does not use the requested address, which it takes once this machine has it.
    pub waits: Option<String>,
}

impl Reach {
    /// `out` returns this machine's address towards another one.
    pub(crate) fn of(own: &Settings, asked: &Asked, out: impl Fn(Ipv4Addr) -> Option<Ipv4Addr>) -> Self {
        let mut notes = asked.notes.clone();
        let by_file = own.interface.is_some() || own.multicast.is_some();
        let (range, by) = match asked.range {
            _ if by_file => (None, "[ros2]"),
            Some((range, variable)) => (Some(range), variable),
            None => (None, "as usual"),
        };
        let is_off = range == Some(Range::Off);
        let mut peers = own.peers.clone().unwrap_or_else(|| asked.peers.clone());
        let far = peers.iter().find(|peer| !peer.is_loopback()).copied();
        let wish = match range {
            Some(Range::Subnet) => Some((OUT, by)),
            _ => far.map(|peer| (peer, if own.peers.is_some() { "`peers`" } else { "ROS_STATIC_PEERS" })),
        };
        let mut interface = own.interface.unwrap_or(Ipv4Addr::LOCALHOST);
        let mut waits = None;
        // Towards its own address, a machine is reached from that address.
        if !interface.is_loopback() && out(interface) != Some(interface) {
            waits = Some(format!("this machine has no address {interface} at present: using this machine only"));
            interface = Ipv4Addr::LOCALHOST;
        }
        if let Some((to, by)) = wish.filter(|_| own.interface.is_none() && !is_off) {
            match out(to) {
                Some(found) if own.insecure => interface = found,
                Some(_) => notes
                    .push(format!("{by} asks for the network, which needs `insecure = true`: using this machine only")),
                None => {
                    waits = Some(format!(
                        "{by} asks for the network, but there is no route to {to}: using this machine only"
                    ));
                }
            }
        }
        notes.extend(waits.clone());
        if is_off {
            peers.clear();
        } else if own.peers.is_none() && interface.is_loopback() {
            peers.retain(Ipv4Addr::is_loopback);
        }
        let multicast = own.multicast.unwrap_or(range != Some(Range::Localhost) || interface.is_loopback()) && !is_off;
        let mut words = match (is_off, interface.is_loopback()) {
            (true, _) => "meets nobody".to_owned(),
            (_, true) => format!("meets nodes of this machine ({interface})"),
            (_, false) if multicast => format!("meets nodes of the network of {interface}"),
            (_, false) => format!("meets nodes of this machine and of its peers, from {interface}"),
        };
        if !peers.is_empty() {
            let by = if own.peers.is_some() { "[ros2]" } else { "ROS_STATIC_PEERS" };
            let peers: Vec<String> = peers.iter().map(ToString::to_string).collect();
            let _ = write!(words, "; asks {} ({by})", peers.join(", "));
        }
        let _ = write!(words, "; range: {by}");
        notes.iter().for_each(|note| words += &format!("; {note}"));
        Self { interface, multicast, peers, is_off, words, waits }
    }
}

/// The first IPv4 address of a name.
fn resolve(name: &str) -> Option<Ipv4Addr> {
    let all = (name, 0).to_socket_addrs().ok()?;
    all.map(|address| address.ip()).find_map(|ip| if let IpAddr::V4(ip) = ip { Some(ip) } else { None })
}

/// This machine's address towards `to`; nothing is sent.
pub(crate) fn outward(to: Ipv4Addr) -> Option<Ipv4Addr> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).ok()?;
    socket.connect((to, 7400)).ok()?;
    match socket.local_addr().ok()?.ip() {
        IpAddr::V4(own) if !own.is_unspecified() => Some(own),
        _ => None,
    }
}

/// True for one of this machine's addresses.
pub(crate) fn is_own(ip: Ipv4Addr) -> bool {
    UdpSocket::bind((ip, 0)).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const OWN: Ipv4Addr = Ipv4Addr::new(192, 168, 1, 5);

    fn reach(own: &Settings, variables: &[(&str, &str)]) -> Reach {
        let variable = |name: &str| Some(variables.iter().find(|(known, _)| *known == name)?.1.to_owned());
        let resolve =
            |name: &str| if name == "bench" { Some(Ipv4Addr::new(192, 168, 1, 7)) } else { name.parse().ok() };
        Reach::of(own, &Asked::by(variable, resolve), |_| Some(OWN))
    }

    const RANGE: &str = "ROS_AUTOMATIC_DISCOVERY_RANGE";
    const STATIC: &str = "ROS_STATIC_PEERS";

    #[test]
    fn environment_variables_are_read_as_in_ros() {
        let open = Settings { insecure: true, ..Settings::default() };
        let here = (Ipv4Addr::LOCALHOST, true, false);
        for (variables, expected, words) in [
            (&[][..], here, "this machine (127.0.0.1); range: as usual"),
            (&[(RANGE, "SYSTEM_DEFAULT")], here, "as usual"),
            (&[(RANGE, "SUBNET")], (OWN, true, false), "the network of 192.168.1.5; range: ROS_AUTOMATIC"),
            (&[(RANGE, "LOCALHOST")], here, "range: ROS_AUTOMATIC"),
            (&[(RANGE, "OFF"), (STATIC, "10.0.0.2")], (Ipv4Addr::LOCALHOST, false, true), "meets nobody"),
            (&[(RANGE, "subnet")], here, "subnet is not SUBNET"),
            (
                &[(RANGE, "SUBNET"), ("ROS_LOCALHOST_ONLY", "1"), (STATIC, "10.0.0.2")],
                here,
                "range: ROS_LOCALHOST_ONLY",
            ),
            (&[(RANGE, "SUBNET"), ("ROS_LOCALHOST_ONLY", "0")], (OWN, true, false), "range: ROS_AUTOMATIC"),
        ] {
            let found = reach(&open, variables);
            assert_eq!((found.interface, found.multicast, found.is_off), expected, "{variables:?}");
            assert!(found.words.contains(words) && found.peers.is_empty(), "{}", found.words);
        }
    }

    #[test]
    fn static_peers_may_be_names_or_addresses_and_need_the_network() {
        let open = Settings { insecure: true, ..Settings::default() };
        let found = reach(&open, &[(RANGE, "LOCALHOST"), (STATIC, "10.0.0.2;;bench;nobody")]);
        assert_eq!((found.interface, found.multicast), (OWN, false));
        assert_eq!(found.peers, [Ipv4Addr::new(10, 0, 0, 2), Ipv4Addr::new(192, 168, 1, 7)]);
        assert!(found.words.contains("asks 10.0.0.2, 192.168.1.7 (ROS_STATIC_PEERS)"), "{}", found.words);
        assert!(found.words.contains("nobody has no IPv4 address"), "{}", found.words);
        // DDS has no authentication here, so no variable may expose the robot to the network.
        for variables in [[(STATIC, "10.0.0.2")], [(RANGE, "SUBNET")]] {
            let found = reach(&Settings::default(), &variables);
            assert_eq!((found.interface, found.peers.len()), (Ipv4Addr::LOCALHOST, 0));
            assert!(found.words.contains("needs `insecure = true`"), "{}", found.words);
        }
        let many = vec!["10.0.0.2"; PEERS + 1].join(";");
        assert!(reach(&open, &[(STATIC, &many)]).words.contains("too many peers"));
    }

    #[test]
    fn a_later_or_changed_address_is_used() {
        let (file, other) = (Settings { interface: Some(OWN), ..Settings::default() }, Ipv4Addr::new(192, 168, 1, 6));
        let open = |own: Settings| Settings { insecure: true, ..own };
        let subnet = Asked { range: Some((Range::Subnet, RANGE)), ..Asked::default() };
        for (own, asked, route, expected, says) in [
            (file.clone(), Asked::default(), None, Ipv4Addr::LOCALHOST, Some("no address 192.168.1.5 at present")),
            (
                file.clone(),
                Asked::default(),
                Some(other),
                Ipv4Addr::LOCALHOST,
                Some("no address 192.168.1.5 at present"),
            ),
            (file, Asked::default(), Some(OWN), OWN, None),
            (Settings::default(), subnet.clone(), None, Ipv4Addr::LOCALHOST, Some("no route to 239.255.0.1")),
            (Settings::default(), subnet.clone(), Some(OWN), OWN, None),
            (Settings::default(), subnet, Some(other), other, None),
        ] {
            let found = Reach::of(&open(own), &asked, |_| route);
            assert_eq!(found.interface, expected, "{}", found.words);
            assert_eq!(found.waits.is_some(), says.is_some());
            assert!(
                found.words.contains(says.unwrap_or_default())
                    && found.waits.unwrap_or_default().contains(says.unwrap_or_default())
            );
        }
    }

    #[test]
    fn a_domain_that_is_no_number_is_refused() {
        let of = |domain, told: &str| Settings { domain, ..Settings::default() }.asked_domain(Some(told.to_owned()));
        assert_eq!([of(None, ""), of(None, " 7 "), of(Some(3), "abc")], [Ok(0), Ok(7), Ok(3)]);
        for told in ["abc", "-1", "70000"] {
            assert_eq!(of(None, told), Err(format!("ROS_DOMAIN_ID={told} is no domain: 0 to 232")));
        }
    }

    #[test]
    fn settings_override_the_variables() {
        let variables = [(RANGE, "OFF"), (STATIC, "10.0.0.2")];
        let file = Settings { insecure: true, interface: Some(OWN), peers: Some(Vec::new()), ..Settings::default() };
        let found = reach(&file, &variables);
        assert_eq!((found.interface, found.multicast, found.is_off, found.peers.len()), (OWN, true, false, 0));
        assert!(found.words.contains("range: [ros2]"), "{}", found.words);
        let peers = reach(&Settings { peers: None, ..file }, &variables).peers;
        assert_eq!(peers, [Ipv4Addr::new(10, 0, 0, 2)], "what the file does not say");
    }
}
