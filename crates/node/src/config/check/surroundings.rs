//! ROS, sounding, output and the network.

use super::super::{ros, ros2};
use super::Check;
use crate::adapters;
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
        if let Some((key, why)) = self.config.ros2.as_ref().and_then(csi5300_ros2::settings::wrong_settings) {
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
        if let Some(why) = self.config.output.foxglove.and_then(|_| adapters::missing("foxglove")) {
            self.refuse_in("output", Some("foxglove"), format!("foxglove in [output] {why}"));
        }
    }

    /// The network of the robots.
    pub(super) fn network(&mut self) {
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
        if network.ros2 && !ros2::is_used(self.config) && self.knows(&["capture", "odometry", "peer", "ros2"]) {
            self.refuse_in(
                "network",
                Some("ros2"),
                "there are no topics to carry: no [ros2] table, and no `ros2` poses",
            );
        }
        let humble = Some(ros2::Distribution::Humble);
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
