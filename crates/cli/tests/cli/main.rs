//! The program as its users meet it.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../../../tests/common/mod.rs"]
mod common;
#[cfg(feature = "live")]
#[path = "../../../../tests/common/private.rs"]
mod private;

// Tests start in the order of their names; those that wait the longest are the first.
#[cfg(feature = "live")]
mod air;
#[cfg(feature = "node")]
mod answers;
#[cfg(feature = "node")]
mod attacks;
#[cfg(feature = "ros2")]
mod bags;
mod commands;
mod compare;
#[cfg(feature = "plot")]
mod drawing;
#[cfg(all(feature = "live", feature = "plot"))]
mod full;
mod looking;
#[cfg(feature = "live")]
mod monitor;
#[cfg(feature = "node")]
mod node;
#[cfg(unix)]
mod outputs;
#[cfg(feature = "zenoh")]
mod peers;
#[cfg(feature = "live")]
mod recording;
mod recovering;
#[cfg(feature = "live")]
mod served;
#[cfg(feature = "node")]
mod signalled;
mod words;
