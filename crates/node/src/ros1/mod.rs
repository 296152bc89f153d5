//! ROS 1: this program as a node of a master, through roslibrust.
//!
//! | module | what it is |
//! |---|---|
//! | [`messages`] | the messages that are read and written, without generated code |
//! | [`link`] | the node: a thread of its own that subscribes, publishes, and begins again with a master that began again |
//!
//! What a message of a pose means is said in [`csi5300::motion::odometry::ros`].

pub mod link;
pub mod messages;

pub use link::{Outbox, RosLink};
