//! The robot's service from outside.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../../../tests/common/mod.rs"]
mod common;
#[path = "../../../../tests/common/documented.rs"]
mod documented;

#[cfg(feature = "zenoh")]
mod peers;
mod program;
mod robots;
mod team;
