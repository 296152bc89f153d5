//! Which nodes a node looks for: from its settings, then from the environment variables of ROS 2 (`rcl`: `localhost.c`,
//! `discovery_options.c`). Leaving this machine always needs `insecure`.

use crate::settings::{PEERS, Settings};
use std::fmt::Write;
use std::net::{IpAddr, Ipv4Addr, ToSocketAddrs, UdpSocket};

/// Any address behind this machine's default route: the DDS group.
const OUT: Ipv4Addr = crate::rtps::MULTICAST;

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
