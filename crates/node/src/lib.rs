//! The robot's own service: capture, odometry, peers and the live estimator in one process.
//!
//! | module | what it is |
//! |---|---|
//! | [`config`] | the configuration file, checked whole before anything starts |
//! | [`csi5300::pipeline::live`] | the library's estimator: records and poses in, bearings out, time as an argument |
//! | [`sources`] | what a configuration names, opened: one module a kind of source |
//! | `together` | where to begin in two replayed logs, so that they play together |
//! | `threads` | the card and the wheels read on threads of their own |
//! | [`machine`] | the robot as one value: sources, log, estimator, taps |
//! | `sounder` | the robot's part in the sounding exchange |
//! | `joined`, `network`, `owners` | peers through zenoh (feature `zenoh`) |
//! | `viewers`, `foxglove` | Foxglove's viewers over a websocket, and recordings for them (feature `foxglove`) |
//! | `ros`, `ros1` | bearings, poses and CSI on topics of ROS 1, and poses from topics (feature `ros1`) |
//! | `ros2` | the same of ROS 2, markers, diagnostics and recordings (feature `ros2`) |
//! | [`health`] | what is published beside the bearings |
//! | `outputs` | bearings as lines, the status socket, the status line |
//! | [`service`] | tokio: waits, hands over, publishes |
//!
//! Where a feature is absent, the module that uses it has a twin without it (`absent.rs`): callers have no `cfg`.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod config;
mod descriptors;
#[cfg_attr(not(feature = "foxglove"), allow(dead_code))]
mod door;
mod error;
#[cfg_attr(not(feature = "zenoh"), allow(dead_code))]
mod exposure;
pub mod health;
pub mod machine;
pub mod sources;
pub mod threads;
mod together;

pub use error::NodeError;

mod joined;
#[cfg(feature = "zenoh")]
pub mod network;
mod outputs;
#[cfg(feature = "zenoh")]
pub mod owners;
mod ros;
pub mod service;
mod sounder;
mod viewers;

#[cfg(feature = "foxglove")]
pub mod foxglove;
#[cfg(feature = "ros1")]
pub mod ros1;
#[cfg(feature = "ros2")]
pub mod ros2;
