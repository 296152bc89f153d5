//! Where poses come from.

pub mod clock;
pub mod csv;
pub mod drive;
pub mod dynamixel;
pub mod opencr;
pub mod replay;
pub mod ros;
#[cfg(feature = "node")]
pub mod serial;

use crate::backend::Error;
use crate::pose::Pose;
use crate::time::Instant;

/// What [`OdometrySource::receive`] gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NextPose {
    /// A pose of the robot (not of its antenna). Its time is the host's wall clock at the measurement, seconds since
    /// the Unix epoch; a late pose may come after a newer one.
    Pose(Pose),
    /// The poses from here on are in another frame: the sensor began anew.
    NewFrame,
    /// Nothing yet: wait for [`OdometrySource::next_at`], or for the file descriptor.
    Pending,
    /// The source is exhausted.
    End,
}

/// A source of poses: a serial port, ROS, a recorded file, a simulated robot. It never blocks.
pub trait OdometrySource {
    /// The next pose, or nothing yet. `now` is the driver's time and never runs backwards.
    ///
    /// # Errors
    /// Only for what cannot be gone on from.
    fn receive(&mut self, now: Instant) -> Result<NextPose, Error>;

    /// When the next pose is due, if the source knows: replay and simulation do, a live port does not.
    fn next_at(&self) -> Option<Instant>;

    /// What is wrong with the source at the moment, in words, if anything is: unplugged, not answering.
    fn trouble(&self) -> Option<String> {
        None
    }

    /// What the source counted of its own, if it counts.
    fn counted(&self) -> Option<serde_json::Value> {
        None
    }
}

impl<S: OdometrySource + ?Sized> OdometrySource for Box<S> {
    fn receive(&mut self, now: Instant) -> Result<NextPose, Error> {
        (**self).receive(now)
    }

    fn next_at(&self) -> Option<Instant> {
        (**self).next_at()
    }

    fn trouble(&self) -> Option<String> {
        (**self).trouble()
    }

    fn counted(&self) -> Option<serde_json::Value> {
        (**self).counted()
    }
}
