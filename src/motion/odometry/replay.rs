//! Poses from a recorded trajectory at its own pace, poses that never change, and antennas on robots.

use super::{NextPose, OdometryError, OdometrySource};
use crate::motion::pose::{Pose, Trajectory};
use crate::time::{Instant, Span};
use nalgebra::Vector3;

/// Plays a trajectory.
#[derive(Clone, Debug)]
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
    fn receive(&mut self, now: Instant) -> Result<NextPose, OdometryError> {
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

/// The antenna of a robot: each pose moved by the antenna's place on the robot, turned with the heading.
#[derive(Clone, Debug)]
pub struct Mounted<S> {
    source: S,
    offset_m: Vector3<f64>,
}

impl<S: OdometrySource> Mounted<S> {
    /// An antenna `offset_m` (x forward, y left, z up, metres) from where `source` says that the robot is.
    pub fn new(source: S, offset_m: Vector3<f64>) -> Self {
        Self { source, offset_m }
    }

    /// The robot's own odometry.
    pub fn source(&self) -> &S {
        &self.source
    }
}

impl<S: OdometrySource> OdometrySource for Mounted<S> {
    fn receive(&mut self, now: Instant) -> Result<NextPose, OdometryError> {
        Ok(match self.source.receive(now)? {
            NextPose::Pose(pose) => NextPose::Pose(pose.mounted(self.offset_m)?),
            other => other,
        })
    }

    fn next_at(&self) -> Option<Instant> {
        self.source.next_at()
    }

    fn trouble(&self) -> Option<String> {
        self.source.trouble()
    }

    fn counted(&self) -> Option<super::SourceCounts> {
        self.source.counted()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn the_antenna_turns_with_the_robot() {
        let offset_m = Vector3::new(0.1, 0.0, 0.2);
        let mut source = Mounted::new(Replayed::new(&trajectory(), 100.0, Instant::ZERO, 1.0), offset_m);
        let NextPose::Pose(pose) = source.receive(Instant::ZERO).unwrap() else { panic!("a pose is due") };
        assert!((pose.position_m - Vector3::new(0.0, 0.1, 0.2)).norm() < 1e-12);
    }
}
