//! The sender on a robot's host.

use csi5300::time::Instant;

/// A frame's role for the robot that heard it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FrameRole {
    /// A forward frame for this robot, which it answers.
    Forward,
    /// The answer to a forward frame of this robot.
    Backward,
    /// Meant for others.
    Overheard,
    /// Unknown: this robot has no sender.
    Unknown,
}

/// A sender. The room calls it for received frames and timeouts, and takes its frames.
///
/// All times are its host's own monotonic clock. After each [`Station::heard`] and at each [`Station::timeout`] the
/// room asks [`Station::transmit`] until there is no frame.
pub(crate) trait Station: Send + std::fmt::Debug {
    /// A frame (no FCS) whose end was at `now`.
    fn heard(&mut self, now: Instant, frame: &[u8]) -> FrameRole;

    /// Appends a frame to be sent at once to `frame`, which is empty; false if there is none.
    fn transmit(&mut self, now: Instant, frame: &mut Vec<u8>) -> bool;

    /// Its next timeout.
    fn timeout(&self) -> Option<Instant>;
}
