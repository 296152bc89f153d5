//! What runs on a robot's host and decides what it sends.

use csi5300::time::Instant;

/// What a frame was to the robot that heard it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FrameRole {
    /// A forward frame for this robot, which it answers.
    Forward,
    /// The answer to a forward frame of this robot.
    Backward,
    /// Meant for others.
    Overheard,
    /// Nobody on this robot says.
    Unknown,
}

/// A sender. The room tells it what it hears and when its time has come, and asks what it sends.
///
/// All times are its host's own monotonic clock. After each [`Station::heard`] and at each [`Station::timeout`] the
/// room asks [`Station::transmit`] until there is no frame.
pub(crate) trait Station: Send + std::fmt::Debug {
    /// A frame (no FCS) whose end was at `now`.
    fn heard(&mut self, now: Instant, frame: &[u8]) -> FrameRole;

    /// Appends a frame to be sent at once to `frame`, which is empty; false if there is none.
    fn transmit(&mut self, now: Instant, frame: &mut Vec<u8>) -> bool;

    /// When it wants to be asked next.
    fn timeout(&self) -> Option<Instant>;
}
