//! What is published over ROS 1 (feature `ros1`): bearings, poses that point to peers, and CSI.

#[cfg(not(feature = "ros1"))]
#[path = "ros/absent.rs"]
mod publish;
#[cfg(feature = "ros1")]
mod publish;

pub(super) use publish::Ros;
