//! The robot's service from outside.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../../../tests/common/mod.rs"]
mod common;

#[cfg(feature = "ros2")]
mod fuzz_corpus;
mod robots;
