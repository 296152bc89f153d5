//! ROS 2 in a configuration.

use super::{Capture, Config, Odometry};
pub use csi5300_ros2::settings::{Distribution, Settings as Ros2, Topic};
use toml::Spanned;

/// The topics of poses that a configuration names.
fn topics(config: &Config) -> impl Iterator<Item = &Topic> {
    let followed = match config.capture.get_ref() {
        Capture::Room(room) => Some(room.follow.values()),
        Capture::Card(_) | Capture::Stock(_) | Capture::Feitcsi(_) | Capture::Replay(_) | Capture::Served(_) => None,
    };
    let peers = config.peer.iter().map(Spanned::get_ref).map(|peer| &peer.poses);
    let all = std::iter::once(&config.odometry).chain(peers).chain(followed.into_iter().flatten());
    all.filter_map(|odometry| match odometry {
        Odometry::Ros2(topic) => Some(topic),
        _ => None,
    })
}

/// True if anything is read from or published over ROS 2.
#[must_use]
pub fn is_used(config: &Config) -> bool {
    let has_ranges = config.team.as_ref().is_some_and(|team| !team.ranges.is_empty());
    config.ros2.is_some() || has_ranges || topics(config).next().is_some()
}

impl Config {
    /// Whom the node looks for in ROS 2, and who said so, in words; none without ROS 2.
    #[must_use]
    pub fn ros2_reach(&self) -> Option<String> {
        let asked = self.ros2.clone().unwrap_or_default();
        let zenoh = self.network.as_ref().is_some_and(|network| network.ros2);
        let also = if zenoh { "; over [network] too (rmw_zenoh)" } else { "" };
        is_used(self).then(|| format!("ROS 2, domain {}: {}{also}", asked.domain(), asked.reach().words))
    }
}
