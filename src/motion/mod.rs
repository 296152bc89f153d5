//! Where a robot is, and how that is known.

pub mod odometry;
pub mod pose;
