//! Bearings from WiFi.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod answer;
pub mod assign;
pub mod backend;
pub mod bartlett;
pub mod cfo;
pub mod channel;
pub mod csi;
pub mod doctor;
pub mod evaluate;
pub mod odometry;
pub mod pairing;
pub mod pipeline;
pub mod pose;
pub mod samples;
pub mod status;
pub mod survey;
pub mod tdma;
pub mod time;
#[cfg(feature = "live")]
pub mod wait;
