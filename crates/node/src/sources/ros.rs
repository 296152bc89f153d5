//! This program as a node of ROS 1, and poses from topics.

use super::Poses;
use crate::NodeError;
use crate::config::Config;
use crate::config::ros::{Topic, is_used};
use crate::ros1::RosLink;
use csi5300::motion::odometry::ros::{Stamp, Wanted};
use csi5300::source::Error;

/// The node, if anything of the configuration needs it.
pub(crate) struct RosNode(pub(crate) Option<RosLink>);

impl RosNode {
    pub(super) fn start(config: &Config, wall_us: fn() -> Option<i64>) -> Result<Self, Error> {
        if !is_used(config) {
            return Ok(Self(None));
        }
        let ros = config.ros.clone().unwrap_or_default();
        RosLink::start(ros.master(), ros.node(config), wall_us).map(|link| Self(Some(link)))
    }

    /// Poses of a topic, with the time that is usual unless the configuration says which.
    pub(super) fn poses(&self, topic: &Topic, usual: Stamp) -> Result<Poses, Error> {
        let link = self.0.as_ref().ok_or(NodeError::NoRosNode)?;
        let wanted = Wanted { stamp: topic.stamp.unwrap_or(usual), frame: topic.frame.clone() };
        Ok(Box::new(link.poses(&topic.topic, topic.kind, wanted)))
    }
}
