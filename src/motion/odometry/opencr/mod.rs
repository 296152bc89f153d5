//! The controller of a TurtleBot3 (OpenCR with the ROS 2 firmware), sans-IO: requests to it, and poses from its answers.
//!
//! Requests one range of its control table with clock, IMU orientation and wheel ticks, so that the three belong
//! together. It never writes to the controller. The table: `turtlebot3_node`'s `control_table.hpp` and the firmware's
//! `turtlebot3.cpp`; its values are refreshed every 20 ms, so faster requests give repetitions, which are skipped and
//! counted.
//!
//! | module | what it is |
//! |---|---|
//! | `table` | the control table: what is read, and where it stands |
//! | `dialogue` | requests, answers and silence on the line |
//! | `poses` | the controller's clock, ticks and heading made into poses |

mod dialogue;
mod poses;
mod table;

use super::drive::{Geometry, WheelCounts};
use super::dynamixel::PacketCounts;
use crate::motion::pose::Pose;
use crate::time::Instant;
use dialogue::{Answer, Dialogue};
use poses::Poses;

/// Counts of a controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct ControllerCounts {
    /// Requests sent.
    pub requests: u64,
    /// Requests that were not answered in time.
    pub unanswered: u64,
    /// Answers with an error, of another device, or of another length.
    pub refused: u64,
    /// Answers whose values had not been refreshed since the last.
    pub repeated: u64,
    /// Times that the controller restarted: what was driven meanwhile is not known.
    pub restarts: u64,
    /// Times that one of the two clocks was set.
    pub clock_steps: u64,
    /// The line.
    pub packets: PacketCounts,
    /// The wheels.
    pub drive: WheelCounts,
}

/// One thing that comes of the answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Found {
    /// A pose: seconds since the Unix epoch on the host's clock; the frame begins where the robot stood first.
    Pose(Pose),
    /// The poses from here on are in a frame of their own.
    NewFrame,
}

/// The dialogue with one controller. Call [`poll_transmit`](Self::poll_transmit) and write its bytes;
/// [`handle_bytes`](Self::handle_bytes) with the bytes read; [`poll_found`](Self::poll_found) until `None`; wait until
/// [`poll_timeout`](Self::poll_timeout) or until there are bytes.
#[derive(Debug)]
pub struct OpenCr {
    dialogue: Dialogue,
    poses: Poses,
}

impl OpenCr {
    /// A dialogue that asks `rate_hz` times a second, from `now` on. Without a `geometry` the controller says which model
    /// it is.
    #[must_use]
    pub fn new(rate_hz: f64, geometry: Option<Geometry>, now: Instant) -> Self {
        Self { dialogue: Dialogue::new(rate_hz, now), poses: Poses::new(geometry) }
    }

    /// The counts.
    #[must_use]
    pub fn counts(&self) -> ControllerCounts {
        let ((line, packets), (clock_steps, drive)) = (self.dialogue.counts(), self.poses.counts());
        ControllerCounts {
            requests: line.requests,
            unanswered: line.unanswered,
            refused: line.refused,
            repeated: self.poses.repeated,
            restarts: self.poses.restarts,
            clock_steps,
            packets,
            drive,
        }
    }

    /// What is wrong, in words, if anything is.
    #[must_use]
    pub fn trouble(&self) -> Option<String> {
        self.dialogue.trouble()
    }

    /// The port was reopened: nothing that was asked before will be answered.
    pub fn reopened(&mut self, now: Instant) {
        self.dialogue.reopened(now);
    }

    /// When it wants to be asked next.
    #[must_use]
    pub fn poll_timeout(&self) -> Instant {
        self.dialogue.poll_timeout()
    }

    /// True while an answer is awaited.
    #[must_use]
    pub fn is_waiting(&self) -> bool {
        self.dialogue.is_waiting()
    }

    /// The request to write now, if one is due. `wall_us` is the host's wall clock, microseconds since the Unix epoch.
    pub fn poll_transmit(&mut self, now: Instant, wall_us: i64) -> Option<&[u8]> {
        self.dialogue.poll_transmit(now, wall_us)
    }

    /// Takes what was read from the port at `now`.
    pub fn handle_bytes(&mut self, now: Instant, wall_us: i64, bytes: &[u8]) {
        self.dialogue.push(bytes);
        while let Some(answer) = self.dialogue.poll_answer(now) {
            match answer {
                Answer::Identity(identity) => self.poses.handle_identity(identity),
                Answer::Sensors(table, asked) => self.poses.handle_sensors(&table, asked, now, wall_us),
            }
        }
    }

    /// The next pose, or what else is to be known.
    pub fn poll_found(&mut self) -> Option<Found> {
        self.poses.poll_found()
    }
}

#[cfg(test)]
mod emulated;
#[cfg(test)]
mod tests;
