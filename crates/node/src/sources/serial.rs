//! The controller of a TurtleBot3 on a serial port.

use super::Poses;
use crate::config::{Model, OpenCr};
use crate::threads::PoseThread;
use csi5300::source::Error;
use csi5300::time::Instant;
use csi5300_live::serial::Serial;

/// Reads its odometry, on a thread of its own.
pub(super) fn poses(port: &OpenCr, start: Instant, wall_us: fn() -> Option<i64>) -> Result<Poses, Error> {
    let geometry = port.model.map(Model::geometry);
    let serial = Serial::open(port.port.clone(), port.rate_hz, geometry, start, wall_us)?;
    Ok(Box::new(PoseThread::start(serial)?))
}
