//! The graph of this robot and its peers.

use super::values::{named, positive};
use std::collections::BTreeMap;

/// The graph of this robot and its peers ([`crate::team`]).
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Team {
    /// Known places of peers that stand, metres: their frame is the team's. Without any, it is the frame of this robot's odometry.
    #[serde(deserialize_with = "named")]
    pub places: BTreeMap<String, [f64; 2]>,
    /// Name of the places' frame.
    pub frame: String,
    /// Ranges from this robot to peers, by another sensor such as UWB.
    pub ranges: BTreeMap<String, RangeTopic>,
}

impl Default for Team {
    fn default() -> Self {
        Self { places: BTreeMap::new(), frame: "map".into(), ranges: BTreeMap::new() }
    }
}

/// A topic of ROS 2 with the ranges to one peer: `sensor_msgs/msg/Range`.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangeTopic {
    /// Its name: `/uwb/burger_2` from the root, `uwb/burger_2` in the node's namespace.
    pub topic: String,
    /// Standard deviation of messages without a variance, metres.
    #[serde(default = "tenth", deserialize_with = "positive")]
    pub sd_m: f64,
}

fn tenth() -> f64 {
    0.1
}
