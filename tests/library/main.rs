//! The library from outside.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod air;
#[path = "../common/mod.rs"]
mod common;
mod fuzz;
mod one_log;
mod pipeline;
mod real_logs;
mod rooms;
mod soak;
mod tdma;
