//! Compares real and simulated captures with their truth.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../../../tests/common/mod.rs"]
mod common;

mod accuracy;
mod faults;
mod fixtures;
mod geometries;
mod real_bearings;
mod shelf;
mod strange_logs;
