//! What rolling wheels say of a sensor's positions.
//!
//! The middle between two wheels on one axle moves along the robot's heading: wheels roll, they do not slip sideways. A
//! camera's positions drift in every direction, and phases do not show a path that is turned as a whole, nor one that bends
//! slowly. The heading of its gyroscope drifts less. So of each step of its positions only the part along the heading is kept.

use super::pose::{Pose, Trajectory, TrajectoryError};
use crate::maths::wrap_rad;
use crate::motion::pose::MIN_GAP_S;
use nalgebra::Vector3;

/// Where a sensor of poses is on its robot, and which way it looks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mount {
    /// The sensor seen from the middle between the wheels, metres: forward, left, up.
    pub offset_m: Vector3<f64>,
    /// Its heading less the robot's, radians, counter-clockwise.
    pub yaw_rad: f64,
}

impl Mount {
    /// A sensor at `offset_m` (forward, left, up of the middle between the wheels, metres) whose heading is the robot's and
    /// `yaw_rad` more.
    #[must_use]
    pub fn new(offset_m: Vector3<f64>, yaw_rad: f64) -> Self {
        Self { offset_m, yaw_rad }
    }
}

impl Trajectory {
    /// The trajectory of the middle between the wheels of a robot that carries the sensor of this one at `mount`: each step
    /// is the part along the robot's heading (that of its middle) of what the sensor reports; heights stay as reported, and
    /// so does the step over a gap. Not for robots that can move sideways.
    ///
    /// # Errors
    /// [`TrajectoryError::NoHeading`] if a pose has no heading.
    pub fn rolling(&self, mount: &Mount) -> Result<Self, TrajectoryError> {
        let gaps = self.gaps();
        let mut roller = Roller::new(*mount);
        let mut middle = |pose: &Pose| {
            let last_s = roller.before.map(|before| before.reported.t_s);
            roller.moved(pose, gaps.iter().any(|gap| Some(gap.from_s) == last_s))
        };
        let rolled = Self::new(self.poses().iter().map(&mut middle).collect::<Result<_, _>>()?)?;
        Ok(rolled.of_same(self))
    }
}

/// [`Trajectory::rolling`] of poses that come one by one.
#[derive(Clone, Copy, Debug)]
#[doc(hidden)]
pub struct Roller {
    mount: Mount,
    before: Option<Before>,
}

/// The newest pose so far.
#[derive(Clone, Copy, Debug)]
struct Before {
    /// The middle between the wheels, as the sensor has it.
    reported: Pose,
    /// The same as it rolled, metres.
    at_m: Vector3<f64>,
    /// Time from the pose before it, seconds; not over a gap.
    step_s: Option<f64>,
}

impl Roller {
    /// Of a sensor at `mount`.
    #[must_use]
    pub fn new(mount: Mount) -> Self {
        Self { mount, before: None }
    }

    /// The pose of the middle between the wheels when the sensor reports `pose`. A gap is a step of more than
    /// `motion.min_gap_s` and of ten steps before it. A pose that comes late is seen from the newest one, which it does
    /// not move.
    ///
    /// # Errors
    /// [`TrajectoryError::NoHeading`] if the pose has no heading; it then moves nothing.
    pub fn step(&mut self, pose: &Pose) -> Result<Pose, TrajectoryError> {
        let is_gap = self.before.is_some_and(|before| {
            let usual_s = before.step_s.unwrap_or_default();
            pose.t_s - before.reported.t_s > MIN_GAP_S.max(10.0 * usual_s)
        });
        self.moved(pose, is_gap)
    }

    /// Restarts: the next pose is in another frame.
    pub fn reset(&mut self) {
        self.before = None;
    }

    fn moved(&mut self, pose: &Pose, over_gap: bool) -> Result<Pose, TrajectoryError> {
        let heading = pose.heading_rad.ok_or(TrajectoryError::NoHeading)?;
        let turned = Pose { heading_rad: Some(wrap_rad(heading - self.mount.yaw_rad)), ..*pose };
        let reported = turned.mounted(-self.mount.offset_m)?;
        let Some(before) = self.before else {
            self.before = Some(Before { reported, at_m: reported.position_m, step_s: None });
            return Ok(reported);
        };
        let passed_s = reported.t_s - before.reported.t_s;
        if passed_s < 0.0 {
            return Ok(Pose { position_m: before.at_m - roll(&reported, &before.reported), ..reported });
        }
        let step_m =
            if over_gap { reported.position_m - before.reported.position_m } else { roll(&before.reported, &reported) };
        let (at_m, step_s) = (before.at_m + step_m, Some(passed_s).filter(|_| !over_gap).or(before.step_s));
        self.before = Some(Before { reported, at_m, step_s });
        Ok(Pose { position_m: at_m, ..reported })
    }
}

/// What is along the heading of the way from one pose to another, and its rise, metres.
fn roll(from: &Pose, to: &Pose) -> Vector3<f64> {
    let step = to.position_m - from.position_m;
    let [first, last] = [from, to].map(|pose| pose.heading_rad.unwrap_or_default());
    let (sin, cos) = (first + 0.5 * wrap_rad(last - first)).sin_cos();
    let along = Vector3::new(cos, sin, 0.0);
    along * step.dot(&along) + Vector3::z() * step.z
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOUNT: Mount = Mount { offset_m: Vector3::new(0.05, 0.16, 0.3), yaw_rad: 0.02 };

    /// The middle of a robot that drives an arc of 0.4 m to the right, over the cut of headings; then back a little.
    fn middle() -> Vec<Pose> {
        let pose = |k: usize| {
            let heading = 3.3 - 0.004 * if k < 700 { k as f64 } else { 1_400.0 - k as f64 };
            let position_m = 0.4 * Vector3::new(-heading.sin(), heading.cos(), 0.0);
            Pose { t_s: 0.005 * k as f64, position_m, heading_rad: Some(wrap_rad(heading)) }
        };
        (0..900).map(pose).collect()
    }

    /// What a sensor at `MOUNT` reports of it, after `drift` of its positions.
    fn sensed(drift: impl Fn(&Pose) -> Vector3<f64>) -> Trajectory {
        let sensor = |pose: &Pose| {
            let mut sensed = pose.mounted(MOUNT.offset_m).unwrap();
            sensed.heading_rad = sensed.heading_rad.map(|heading| wrap_rad(heading + MOUNT.yaw_rad));
            sensed.position_m += drift(pose);
            sensed
        };
        Trajectory::new(middle().iter().map(sensor).collect()).unwrap()
    }

    /// The furthest that a trajectory is from the middle's, both from where they begin.
    fn furthest_m(trajectory: &Trajectory) -> f64 {
        let truth = middle();
        let off = |(own, truth_pose): (&Pose, &Pose)| {
            let own = own.position_m - trajectory.poses()[0].position_m;
            (own - (truth_pose.position_m - truth[0].position_m)).norm()
        };
        trajectory.poses().iter().zip(&truth).map(off).fold(0.0, f64::max)
    }

    #[test]
    fn what_slips_sideways_is_taken_out_and_what_rolls_stays() {
        let exact = sensed(|_| Vector3::zeros()).rolling(&MOUNT).unwrap();
        assert!(furthest_m(&exact) < 1e-4, "{}", furthest_m(&exact));
        let heading = exact.poses()[300].heading_rad.unwrap();
        assert!((heading - middle()[300].heading_rad.unwrap()).abs() < 1e-9);
        // Positions turned by 6 degrees about where they began, headings as they are: what a camera's drift looks like.
        let start = sensed(|_| Vector3::zeros()).poses()[0].position_m;
        let turned = sensed(|pose| {
            let from_start = pose.mounted(MOUNT.offset_m).unwrap().position_m - start;
            let (sin, cos) = 0.105f64.sin_cos();
            Vector3::new(cos * from_start.x - sin * from_start.y, sin * from_start.x + cos * from_start.y, 0.0)
                - from_start
        });
        let rolled = turned.rolling(&MOUNT).unwrap();
        assert!(furthest_m(&rolled) < 0.02, "{}", furthest_m(&rolled));
        let as_wheels = turned.with_antenna_offset(Vector3::zeros()).unwrap();
        assert!(furthest_m(&as_wheels) > 0.05, "{}", furthest_m(&as_wheels));
    }

    /// The same with a gap of five seconds after the 450th pose, in which the robot was moved and lifted.
    fn over_a_gap() -> Vec<Pose> {
        let mut poses = middle();
        for pose in &mut poses[450..] {
            pose.t_s += 5.0;
            pose.position_m += Vector3::new(0.3, -0.2, 0.07);
        }
        poses
    }

    #[test]
    fn a_step_over_a_gap_and_the_height_stay_as_reported() {
        let poses = over_a_gap();
        let rolled = Trajectory::new(poses.clone()).unwrap().rolling(&Mount::default()).unwrap();
        let step = rolled.poses()[450].position_m - rolled.poses()[449].position_m;
        assert!((step - (poses[450].position_m - poses[449].position_m)).norm() < 1e-12, "{step}");
        assert_eq!(rolled.poses()[800].position_m.z, 0.07);
    }

    #[test]
    fn poses_that_come_one_by_one_roll_as_those_of_a_file() {
        let poses = over_a_gap();
        let whole = Trajectory::new(poses.clone()).unwrap().rolling(&MOUNT).unwrap();
        let mut roller = Roller::new(MOUNT);
        let own: Vec<Pose> = poses.iter().map(|pose| roller.step(pose).unwrap()).collect();
        assert_eq!(own, whole.poses());
        // A late pose is where it would have been, and what follows is as without it.
        let (mut with, mut without) = (Roller::new(MOUNT), Roller::new(MOUNT));
        for pose in &poses[..50] {
            without.step(pose).unwrap();
        }
        for pose in poses[..50].iter().filter(|pose| pose.t_s != poses[48].t_s) {
            with.step(pose).unwrap();
        }
        let late = with.step(&poses[48]).unwrap();
        assert!((late.position_m - own[48].position_m).norm() < 1e-5, "{late:?}");
        let [a, b] = [&mut with, &mut without].map(|roller| roller.step(&poses[50]).unwrap().position_m);
        assert!((a - b).norm() < 1e-5, "{a} {b}");
        // In another frame it begins where that has it.
        with.reset();
        let begun = Roller::new(MOUNT).step(&poses[700]).unwrap();
        assert_eq!(with.step(&poses[700]), Ok(begun));
        assert_eq!(with.step(&Pose { heading_rad: None, ..poses[701] }), Err(TrajectoryError::NoHeading));
    }

    #[test]
    fn without_a_heading_nothing_says_which_way_wheels_roll() {
        let mut poses = middle();
        poses[3].heading_rad = None;
        let refused = Trajectory::new(poses).unwrap().rolling(&Mount::default());
        assert_eq!(refused, Err(TrajectoryError::NoHeading));
    }
}
