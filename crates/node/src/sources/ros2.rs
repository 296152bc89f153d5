//! This program as a node of ROS 2, and poses from topics.

use super::Poses;
use crate::NodeError;
use crate::config::Config;
use crate::config::ros2::{Topic, is_used};
use crate::ros2::Node;
use csi5300::motion::odometry::ros::Stamp;
use csi5300::source::Error;

/// The node, if anything of the configuration needs it.
pub(crate) struct Ros2Node(pub(crate) Option<Node>);

impl Ros2Node {
    pub(super) fn start(config: &Config, wall_us: fn() -> Option<i64>) -> Result<Self, Error> {
        if !is_used(config) {
            return Ok(Self(None));
        }
        Node::start(config, wall_us).map(|node| Self(Some(node)))
    }

    /// Poses of a topic, with the time that is usual unless the configuration says which.
    pub(super) fn poses(&self, topic: &Topic, usual: Stamp) -> Result<Poses, Error> {
        let node = self.0.as_ref().ok_or(NodeError::NoRosNode)?;
        Ok(Box::new(node.poses(topic, usual)))
    }
}
