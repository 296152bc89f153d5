//! Where poses come from.

pub mod csv;
pub(crate) mod dynamixel;
mod error;

// What the robot's service is made of: public for the crates of this workspace, no part of the library's interface.
#[doc(hidden)]
pub mod clock;
#[doc(hidden)]
pub mod drive;
#[doc(hidden)]
pub mod opencr;
#[doc(hidden)]
pub mod replay;
#[doc(hidden)]
pub mod ros;

pub use error::OdometryError;

use crate::motion::pose::Pose;
use crate::time::Instant;

/// What [`OdometrySource::receive`] gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NextPose {
    /// A pose of the robot (not of its antenna). Its time is the host's wall clock at the measurement, seconds since
    /// the Unix epoch; a late pose may come after a newer one.
    Pose(Pose),
    /// The poses from here on are in another frame: the sensor restarted.
    NewFrame,
    /// Nothing yet: wait for [`OdometrySource::next_at`], or for the file descriptor.
    Pending,
    /// The source is exhausted.
    End,
}

/// Counts of a robot of a simulated room that follows a source of poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct FollowedCounts {
    /// Poses that it follows.
    pub poses: u64,
    /// Poses skipped because a newer one had come, or because they were out of order.
    pub late: u64,
    /// Times that the source restarted.
    pub new_frames: u64,
    /// Times that the source's clock was set, or ran differently.
    pub clock_set: u64,
}

/// A source's own counts; in JSON only the fields of the variant.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[serde(untagged)]
#[non_exhaustive]
pub enum SourceCounts {
    /// A topic of ROS.
    Topic(ros::TopicCounts),
    /// A TurtleBot3's controller on a serial port.
    Controller {
        /// Its line and its wheels.
        controller: opencr::ControllerCounts,
        /// Times that the port went away.
        unplugged: u64,
    },
    /// A robot of a simulated room that follows another source.
    Followed {
        /// The following.
        followed: FollowedCounts,
        /// The source that it follows.
        source: Option<Box<SourceCounts>>,
    },
}

/// A source of poses: a serial port, ROS, a recorded file, a simulated robot. It never blocks.
pub trait OdometrySource {
    /// The next pose, or nothing yet. `now` is the driver's time and never runs backwards.
    ///
    /// # Errors
    /// Only for what cannot be gone on from.
    fn receive(&mut self, now: Instant) -> Result<NextPose, OdometryError>;

    /// When the next pose is due, if the source knows: replay and simulation do, a live port does not.
    fn next_at(&self) -> Option<Instant>;

    /// The source's present problem, in words, if any: unplugged, not answering.
    fn trouble(&self) -> Option<String> {
        None
    }

    /// The source's own counts, if any.
    fn counted(&self) -> Option<SourceCounts> {
        None
    }
}

impl<S: OdometrySource + ?Sized> OdometrySource for Box<S> {
    fn receive(&mut self, now: Instant) -> Result<NextPose, OdometryError> {
        (**self).receive(now)
    }

    fn next_at(&self) -> Option<Instant> {
        (**self).next_at()
    }

    fn trouble(&self) -> Option<String> {
        (**self).trouble()
    }

    fn counted(&self) -> Option<SourceCounts> {
        (**self).counted()
    }
}
