//! The library from outside: the scheduler on a virtual air, bodies of the fuzz targets.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod ax210;
mod both;
mod by_clock;
#[path = "../common/mod.rs"]
mod common;
mod fuzz_corpus;
mod fuzz_csv;
mod fuzz_sounding;
mod inputs;
mod odometry;
mod one_log;
mod pipeline;
mod soak;
mod taps;
mod tdma;
mod users_logs;
