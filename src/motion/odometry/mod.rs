//! Where poses come from, and the sources that every program has: a recorded trajectory at its own pace, and the antenna of a robot
//! whose odometry is another source.

pub mod csv;
pub(crate) mod dynamixel;

// What the robot's service is made of: public for the crates of this workspace, no part of the library's interface.
#[doc(hidden)]
pub mod opencr;
#[doc(hidden)]
pub mod ros;

use crate::motion::pose::{Pose, Trajectory};
use crate::source::Error;
use crate::time::{Instant, Span};

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
#[doc(hidden)] // for the crates of this workspace
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
#[doc(hidden)] // for the crates of this workspace
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[serde(untagged)]
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
    fn receive(&mut self, now: Instant) -> Result<NextPose, Error>;

    /// When the next pose is due, if the source knows: replay and simulation do, a live port does not.
    fn next_at(&self) -> Option<Instant>;

    /// The source's present problem, in words, if any: unplugged, not answering.
    #[doc(hidden)] // for the crates of this workspace
    fn trouble(&self) -> Option<String> {
        None
    }

    /// The source's own counts, if any.
    #[doc(hidden)] // for the crates of this workspace
    fn counted(&self) -> Option<SourceCounts> {
        None
    }
}

/// Plays a trajectory.
#[derive(Clone, Debug)]
#[doc(hidden)]
pub struct Replayed {
    poses: Vec<Pose>,
    next: usize,
    origin_s: f64,
    start: Instant,
    speed: f64,
}

impl Replayed {
    /// Gives each pose of `trajectory` when it is due: that of time `origin_s` at `start`, the others `speed` times as
    /// fast as they were recorded (infinity: at once).
    #[must_use]
    pub fn new(trajectory: &Trajectory, origin_s: f64, start: Instant, speed: f64) -> Self {
        Self { poses: trajectory.poses().to_vec(), next: 0, origin_s, start, speed }
    }

    fn due(&self) -> Option<Instant> {
        let pose = self.poses.get(self.next)?;
        Some(self.start + Span::from_s(((pose.t_s - self.origin_s) / self.speed).max(0.0)))
    }
}

impl OdometrySource for Replayed {
    fn receive(&mut self, now: Instant) -> Result<NextPose, Error> {
        match self.due().zip(self.poses.get(self.next)) {
            None => Ok(NextPose::End),
            Some((due, _)) if due > now => Ok(NextPose::Pending),
            Some((_, pose)) => {
                self.next += 1;
                Ok(NextPose::Pose(*pose))
            }
        }
    }

    fn next_at(&self) -> Option<Instant> {
        self.due()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn trajectory() -> Trajectory {
        let pose = |k: u32| Pose {
            t_s: 100.0 + f64::from(k) * 0.1,
            position_m: Vector3::new(f64::from(k), 0.0, 0.0),
            heading_rad: Some(std::f64::consts::FRAC_PI_2),
        };
        Trajectory::new((0..5).map(pose).collect()).unwrap()
    }

    #[test]
    fn poses_come_when_they_are_due() {
        let start = Instant::from_us(7);
        let mut source = Replayed::new(&trajectory(), 99.9, start, 2.0);
        assert_eq!(source.receive(start).unwrap(), NextPose::Pending);
        let mut times = Vec::new();
        while let Some(at) = source.next_at() {
            let NextPose::Pose(pose) = source.receive(at).unwrap() else { panic!("not due at {at:?}") };
            times.push((at.as_us(), pose.t_s));
        }
        assert_eq!(times.len(), 5);
        assert_eq!((times[0].0, times[4].0), (50_007, 250_007));
        assert_eq!(source.receive(Instant::from_us(i64::MAX)).unwrap(), NextPose::End);
    }
}
