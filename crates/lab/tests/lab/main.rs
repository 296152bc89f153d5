//! Compares real and simulated captures with their truth.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../../../tests/common/mod.rs"]
mod common;

mod accuracy;
mod captures;
mod ends;
mod faults;
mod geometries;
