//! The robot's own service: capture, odometry, peers and the live estimator in one process.
//!
//! | module | what it is |
//! |---|---|
//! | [`config`] | the configuration file, checked whole before anything starts |
//! | [`csi5300::pipeline::live`] | the library's estimator: records and poses in, bearings out, time as an argument |
//! | [`sources`] | what a configuration names, opened |
//! | `threads` | the card and the wheels read on threads of their own |
//! | [`machine`] | the robot as one value: sources, log, estimator, taps |
//! | [`diagnostics`] | the acceptance claims of the last seconds; the state as ROS shows it |
//! | `sounder` | the robot's part in the sounding exchange |
//! | [`adapters`] | what a node speaks, behind one trait: ROS 1 and 2, zenoh, Foxglove, lines of JSON, the status socket |
//! | `health` | what is published beside the bearings |
//! | [`team`] | this robot and its peers as one graph; ranges of another sensor for it |
//! | [`service`] | tokio: waits, hands over, publishes |
//!
//! A feature gates only the module of its adapter and its line in the list of adapters.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod adapters;
pub mod config;
pub mod diagnostics;
mod health;
pub mod machine;
pub mod service;
mod sounder;
pub mod sources;
pub mod team;
mod threads;

use csi5300::internal::{lock, refused};
