//! Bearings from WiFi.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod assign;
pub mod backend;
pub mod bartlett;
pub mod cfo;
pub mod csi;
pub mod odometry;
pub mod pairing;
#[cfg(feature = "plot")]
pub mod plot;
pub mod pose;
pub mod samples;
pub mod tdma;
pub mod time;
