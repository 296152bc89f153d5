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
//! | `sounder` | the robot's part in the sounding exchange (feature `live`) |
//! | `threads` | the card and the wheels read on threads of their own (feature `live`) |
//! | `network`, `viewers` | peers through zenoh, Foxglove's viewers over a websocket (features `zenoh`, `foxglove`) |
//! | `service` | tokio: waits, hands over, publishes (feature `node`) |

pub mod config;
pub mod estimator;
pub mod health;
pub mod machine;
pub mod motion;
pub mod sources;
#[cfg(feature = "live")]
pub mod threads;
mod together;

#[cfg(feature = "zenoh")]
pub mod network;
#[cfg(feature = "node")]
mod outputs;
#[cfg(feature = "node")]
mod ros;
#[cfg(feature = "node")]
pub mod service;
#[cfg(feature = "live")]
mod sounder;
#[cfg(feature = "node")]
mod viewers;
