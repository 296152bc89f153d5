//! The robot's own service: capture, odometry, peers and the live estimator in one process.
//!
//! | module | what it is |
//! |---|---|
//! | [`config`] | the one file that says everything, checked whole before anything starts |
//! | [`motion`] | poses as they come, and how far two robots have moved relative to each other |
//! | [`estimator`] | records and poses in, bearings out: sans-IO, time as an argument |
//! | [`sources`] | what a configuration names, opened |
//! | [`machine`] | the robot as one value |
//! | [`health`] | what is published beside the bearings |
//! | `sounder` | the robot's part in the sounding exchange |
//! | `threads` | the card and the wheels read on threads of their own |
//! | `network`, `viewers` | peers through zenoh, Foxglove's viewers over a websocket (features `zenoh`, `foxglove`) |
//! | `service` | tokio: waits, hands over, publishes |
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod config;
pub mod estimator;
pub mod health;
pub mod machine;
pub mod motion;
pub mod sources;
pub mod threads;
mod together;

#[cfg(feature = "zenoh")]
pub mod network;
mod outputs;
mod ros;
pub mod service;
mod sounder;
mod viewers;

#[cfg(feature = "foxglove")]
pub mod foxglove;
#[cfg(feature = "ros1")]
pub mod ros1;
