//! Poses of a tracking camera, held to what the robot's wheels can roll.

use csi5300::internal::Roller;
use csi5300::motion::odometry::{NextPose, OdometryError, OdometrySource, SourceCounts};
use csi5300::motion::pose::Mount;
use csi5300::time::Instant;

/// The middle between the wheels of a robot, by the camera that it carries.
pub(super) struct Rolling<S> {
    source: S,
    roller: Roller,
}

impl<S: OdometrySource> Rolling<S> {
    /// Of a camera at `mount` whose poses `source` gives.
    pub fn new(source: S, mount: Mount) -> Self {
        Self { source, roller: Roller::new(mount) }
    }
}

impl<S: OdometrySource> OdometrySource for Rolling<S> {
    fn receive(&mut self, now: Instant) -> Result<NextPose, OdometryError> {
        Ok(match self.source.receive(now)? {
            NextPose::Pose(pose) => NextPose::Pose(self.roller.step(&pose)?),
            NextPose::NewFrame => {
                self.roller.reset();
                NextPose::NewFrame
            }
            other => other,
        })
    }

    fn next_at(&self) -> Option<Instant> {
        self.source.next_at()
    }

    fn trouble(&self) -> Option<String> {
        self.source.trouble()
    }

    fn counted(&self) -> Option<SourceCounts> {
        self.source.counted()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::motion::pose::Pose;
    use nalgebra::Vector3;
    use std::collections::VecDeque;

    struct Listed(VecDeque<NextPose>);

    impl OdometrySource for Listed {
        fn receive(&mut self, _: Instant) -> Result<NextPose, OdometryError> {
            Ok(self.0.pop_front().unwrap_or(NextPose::End))
        }

        fn next_at(&self) -> Option<Instant> {
            None
        }
    }

    #[test]
    fn sideways_slips_are_removed_until_a_new_frame() {
        let pose = |k: u32, x: f64, y: f64| {
            let heading_rad = Some(0.02);
            NextPose::Pose(Pose { t_s: f64::from(k) * 0.02, position_m: Vector3::new(x, y, 0.1), heading_rad })
        };
        let listed = [
            pose(0, 0.0, 0.0),
            pose(1, 0.01, 0.005),
            NextPose::Pending,
            pose(2, 0.02, 0.01),
            NextPose::NewFrame,
            pose(3, 5.0, 7.0),
        ];
        // A camera that looks 0.02 to the left of a robot that drives along x.
        let mount = Mount { offset_m: Vector3::new(0.1, 0.2, 0.0), yaw_rad: 0.02 };
        let mut rolling = Rolling::new(Listed(listed.into()), mount);
        let mut at = || rolling.receive(Instant::ZERO).unwrap();
        let place = |next: NextPose| match next {
            NextPose::Pose(pose) => (pose.position_m + Vector3::new(0.1, 0.2, 0.0), pose.heading_rad),
            other => panic!("{other:?}"),
        };
        let near = |next: NextPose, x: f64, y: f64| {
            let (position_m, heading_rad) = place(next);
            assert!((position_m - Vector3::new(x, y, 0.1)).norm() < 1e-9, "{position_m}");
            assert!(heading_rad.unwrap().abs() < 1e-12);
        };
        near(at(), 0.0, 0.0);
        near(at(), 0.01, 0.0);
        assert_eq!(at(), NextPose::Pending);
        near(at(), 0.02, 0.0);
        assert_eq!(at(), NextPose::NewFrame);
        near(at(), 5.0, 7.0);
        assert_eq!(at(), NextPose::End);
    }
}
