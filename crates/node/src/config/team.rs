//! The graph of this robot and its peers.

use std::collections::BTreeMap;

/// The graph of this robot and its peers ([`crate::team`]).
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Team {
    /// Known places of peers that stand, metres: their frame is the team's. Without any, it is the frame of this robot's odometry.
    pub places: BTreeMap<String, [f64; 2]>,
    /// Name of the places' frame.
    pub frame: String,
}

impl Default for Team {
    fn default() -> Self {
        Self { places: BTreeMap::new(), frame: "map".into() }
    }
}
