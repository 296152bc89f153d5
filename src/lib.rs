//! Bearings from WiFi.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod backend;
pub mod bartlett;
pub mod csi;
pub mod samples;
pub mod tdma;
pub mod time;
