//! Messages of ROS and recordings of them, without a node.
//!
//! | module | what it is |
//! |---|---|
//! | [`cdr`] | values in the payload of a message |
//! | [`messages`] | the messages themselves |
//! | [`mcap`] | MCAP recordings as `ros2 bag` writes them: writer and reader |
//! | [`unbag`] | logs and trajectories from all kinds of recordings: MCAP, SQLite, bags of ROS 1 |
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod cdr;
pub mod mcap;
pub mod messages;
pub mod unbag;
