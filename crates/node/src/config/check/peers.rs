//! The peers: who they are, and where their records and poses come from.

use super::super::{Capture, Odometry, Peer, Records};
use super::Check;
use csi5300_ros2::settings::wrong_name;
use csi5300_sim::toml_lines::Step;
use csi5300_sim::toml_lines::Step::{Index, Key};

impl Check<'_> {
    /// Every peer.
    pub(super) fn peers(&mut self) {
        let config = self.config;
        for (k, peer) in config.peer.iter().map(|peer| peer.get_ref()).enumerate() {
            let wrong = [self.wrong_identity(k, peer), self.wrong_records(peer), self.wrong_peer_poses(peer)].concat();
            for (key, why) in wrong {
                self.refuse(&[vec![Key("peer"), Index(k)], key].concat(), why);
            }
        }
    }

    /// Known places and ranges of the team's graph.
    pub(super) fn team(&mut self) {
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
            } else if let Some(why) = wrong_name(&ranges.topic) {
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
        if peer.mac.is_some() && peer.mac == self.config.mac {
            wrong.push((vec![Key("mac")], format!("peer `{name}` has this robot's own MAC")));
        }
        if let Some(why) = wrong_certificate(peer) {
            wrong.push((vec![Key("certificate")], format!("peer `{name}`: {why}")));
        }
        wrong
    }

    fn wrong_records(&self, peer: &Peer) -> Vec<(Vec<Step<'static>>, String)> {
        let name = &peer.name;
        let (key, why) = match &peer.records {
            Records::Replay(replay) if !replay.file.is_file() => {
                let why = format!("peer `{name}`: there is no log {}", replay.file.display());
                return vec![(vec![Key("records"), Key("replay"), Key("file")], why)];
            }
            Records::Replay(_) if !self.is_replay() => {
                ("replay", format!("peer `{name}`: a replayed log needs `capture.replay`, whose pace it follows"))
            }
            Records::Room(_) if !self.is_room() => {
                ("room", format!("peer `{name}`: `room` records need `capture.room` or `capture.served`"))
            }
            Records::Network(_) if self.config.network.is_none() => {
                ("network", format!("peer `{name}`: `network` records need a [network] table"))
            }
            Records::Heard(_) if self.config.array.is_none() && self.knows(&["array"]) => {
                let why = "`heard` is of antennas of this robot's card: it needs an [array] table";
                ("heard", format!("peer `{name}`: {why}"))
            }
            Records::Heard(_) if !matches!(peer.poses, Odometry::Static(_)) => {
                let why = "a sender that is only heard has no poses: leave `poses` out";
                ("heard", format!("peer `{name}`: {why}"))
            }
            Records::Heard(_) if peer.mac.is_none() && self.capture().robot() != Some(name) => {
                return self.absent(name).map(|why| (vec![Key("name")], why)).into_iter().collect();
            }
            Records::Sounding(_)
                if !self.config.sounding.as_ref().is_some_and(|own| own.initiate && own.measurement) =>
            {
                let why = "`sounding` records come with the answers to this robot's frames: they need a [sounding] table with \
                           `initiate` and `measurement`";
                ("sounding", format!("peer `{name}`: {why}"))
            }
            Records::Sounding(_) if !matches!(peer.poses, Odometry::Static(_)) => {
                let why = "`sounding` records have no time of the peer's host, so it must stand (`poses.static`)";
                ("sounding", format!("peer `{name}`: {why}"))
            }
            Records::Room(_) | Records::Heard(_) if self.capture().robot() == Some(name) => {
                let why = format!("peer `{name}` is this robot itself: the one of the room that `capture` names");
                return vec![(vec![Key("name")], why)];
            }
            Records::Room(_) => return self.absent(name).map(|why| (vec![Key("name")], why)).into_iter().collect(),
            Records::Replay(_) | Records::Network(_) | Records::Heard(_) | Records::Sounding(_) => return Vec::new(),
        };
        vec![(vec![Key("records"), Key(key)], why)]
    }

    fn wrong_peer_poses(&self, peer: &Peer) -> Vec<(Vec<Step<'static>>, String)> {
        let wrong = self.wrong_poses(&peer.poses, false);
        let within =
            |(key, why): (Vec<_>, String)| ([vec![Key("poses")], key].concat(), format!("peer `{}`: {why}", peer.name));
        wrong.map(within).into_iter().collect()
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
