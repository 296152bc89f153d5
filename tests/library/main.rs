//! The library from outside.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod air;
mod by_clock;
#[path = "../common/mod.rs"]
mod common;
mod fuzz;
mod one_log;
mod pipeline;
mod rooms;
mod soak;
mod tdma;
mod users_logs;
