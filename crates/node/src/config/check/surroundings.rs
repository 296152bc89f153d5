//! ROS, sounding, output and the network.

use super::super::{ros, ros2};
use super::Check;
#[cfg(feature = "zenoh")]
use crate::owners::Owner;
use csi5300_sim::toml_lines::Step::Key;

/// Records that can be let wait for or from the network: no fewer than come while a message is collected, no more than
/// some hundred megabytes.
const BACKLOGS: std::ops::RangeInclusive<usize> = 256..=1_000_000;

impl Check<'_> {
    /// This program as a node of ROS.
    pub(super) fn ros(&mut self) {
        if let Some((key, why)) = self.config.ros.as_ref().and_then(ros::wrong_ros) {
            self.refuse_in("ros", key, why);
        }
        if let Some((key, why)) = self.config.ros2.as_ref().and_then(ros2::wrong_ros2) {
            self.refuse_in("ros2", key, why);
        }
    }

    /// This robot's part in the sounding exchange.
    pub(super) fn sounding(&mut self) {
        if let Some((key, why)) = self.config.wrong_sounding().filter(|_| self.knows(&["peer"])) {
            self.refuse_in("sounding", key, why);
        }
    }

    /// What is published.
    pub(super) fn output(&mut self) {
        if self.config.output.foxglove.is_some() && !cfg!(feature = "foxglove") {
            let why = "foxglove in [output] needs a program built with `--features foxglove`";
            self.refuse_in("output", Some("foxglove"), why);
        }
    }

    /// The network of the robots.
    pub(super) fn network(&mut self) {
        let Some(network) = &self.config.network else { return };
        if !cfg!(feature = "zenoh") {
            self.refuse_in("network", None, "[network] needs a program built with `--features zenoh`");
        }
        if network.backlog.is_some_and(|backlog| !BACKLOGS.contains(&backlog)) {
            let why = format!("backlog: {} to {} records", BACKLOGS.start(), BACKLOGS.end());
            self.refuse_in("network", Some("backlog"), why);
        }
        if network.zenoh.as_ref().is_some_and(|file| !file.is_file()) {
            self.refuse_in("network", Some("zenoh"), "there is no such file of zenoh's");
        }
    }

    /// A network that lets anybody in.
    #[cfg(feature = "zenoh")]
    pub(super) fn open_network(&mut self) {
        let network =
            self.config.network.as_ref().filter(|network| network.zenoh.as_ref().is_none_or(|file| file.is_file()));
        let peers = self.config.peer.iter().map(|peer| peer.get_ref());
        let owner = |peer: &super::super::Peer| Some(Owner { mac: peer.mac?, certificate: peer.certificate.clone() });
        let owners: Vec<Owner> = peers.filter_map(owner).collect();
        if let Some(why) = network.and_then(|network| crate::network::refusal(network, &owners)) {
            self.refuse_in("network", None, why);
        }
    }

    /// Without the feature there is no network.
    #[cfg(not(feature = "zenoh"))]
    #[allow(clippy::unused_self, reason = "the twin of the one above")]
    pub(super) fn open_network(&mut self) {}

    /// Refuses a key of a table, or the table.
    fn refuse_in(&mut self, table: &str, key: Option<&str>, reason: impl Into<String>) {
        let place: Vec<_> = std::iter::once(table).chain(key).map(Key).collect();
        self.refuse(&place, reason);
    }
}
