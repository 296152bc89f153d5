//! Where a robot is, and how that is known.

pub(crate) mod heading;
pub mod odometry;
pub mod pose;
pub mod rolling;
