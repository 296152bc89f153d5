//! No node of ROS 2: a configuration that asks for one was refused.

use super::Poses;
use crate::NodeError;
use crate::config::Config;
use crate::config::ros2::Topic;
use csi5300::motion::odometry::ros::Stamp;
use csi5300::source::Error;

pub(crate) struct Ros2Node;

impl Ros2Node {
    pub(super) fn start(_: &Config, _: fn() -> Option<i64>) -> Result<Self, Error> {
        Ok(Self)
    }

    pub(super) fn poses(&self, _: &Topic, _: Stamp) -> Result<Poses, Error> {
        Err(NodeError::WithoutRos2.into())
    }
}
