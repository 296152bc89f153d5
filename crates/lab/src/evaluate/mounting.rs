//! From what a robot's odometry is of to its antenna.
//!
//! Phases show where the antenna went. A tracking camera and wheels say where they themselves went, and motion capture of the
//! antenna says where that is on the robot: with `o` the positions of the odometry, `h` its headings and `a` those of motion
//! capture at the same times, all less their means over the motion, `a = o + R(h) l` has the least squares
//! `l = sum conj(e) (a - o) / sum |e|^2`, `e = exp(j h)` less its mean, of complex coordinates. The robots of the WSR data
//! set (\[wsr\] in docs/references.md) have the antenna 16 cm beside the middle between their wheels: when they drive an
//! arc, its path is twice as wide as theirs.
//!
//! The antenna's steps in a camera's frame say how the camera looks on the robot as well ([`Travel`]): the middle between
//! the wheels is that far behind and beside the antenna, and does not move sideways.

use super::find::{Capture, TrajectorySource};
use super::shelf::Shelf;
use csi5300::maths::{median, wrap_rad};
use csi5300::motion::pose::{Pose, Trajectory, TrajectoryError};
use nalgebra::{Rotation3, Vector3};
use num_complex::Complex64;

/// Mean of `|e|^2` at least: headings that differ by less than 0.1 rad hardly tell where the antenna is.
const LEAST_TURN: f64 = 0.01;

impl Capture {
    /// Where the receiver's antenna is on its robot as this capture says, metres forward and left of what the trajectory by
    /// `source` is of. None where either trajectory is missing, has no heading, hardly turns, or was not recorded at the
    /// same time.
    #[must_use]
    pub(crate) fn measured_offset_m(&self, source: TrajectorySource) -> Option<[f64; 2]> {
        let shelf = Shelf::default();
        let read = |source| shelf.trajectory(&self.trajectory_of(source, "rx")).ok().map(|(trajectory, _)| trajectory);
        let antenna = read(TrajectorySource::GroundTruth)?;
        offset_m(&self.turned(&shelf, source, read(source)?).ok()?, &antenna)
    }

    /// How the antenna travels in the frame of the tracking camera, by motion capture. None as of [`Self::measured_offset_m`].
    #[must_use]
    pub(crate) fn measured_travel(&self) -> Option<Travel> {
        let shelf = Shelf::default();
        let read = |source| shelf.trajectory(&self.trajectory_of(source, "rx")).ok().map(|(trajectory, _)| trajectory);
        Travel::of(&read(TrajectorySource::T265)?, &read(TrajectorySource::GroundTruth)?)
    }

    /// The antenna's trajectory, of the one that was recorded by `source`.
    pub(super) fn of_antenna(
        &self,
        shelf: &Shelf,
        source: TrajectorySource,
        recorded: Trajectory,
    ) -> Result<Trajectory, TrajectoryError> {
        if source == TrajectorySource::GroundTruth {
            return Ok(recorded);
        }
        let rolls = source == TrajectorySource::RollingT265;
        let recorded = if rolls { recorded.rolling(&self.camera.unwrap_or_default())? } else { recorded };
        let turned = self.turned(shelf, source, recorded)?;
        self.antenna_offset_m.map_or(Ok(turned.clone()), |offset| turned.with_antenna_offset(offset.into()))
    }

    /// Wheels count on from the heading of the run before unless they are set to zero. Their trajectory is turned to the
    /// heading that motion capture, or else the tracking camera, has at the same time at the start.
    fn turned(
        &self,
        shelf: &Shelf,
        source: TrajectorySource,
        recorded: Trajectory,
    ) -> Result<Trajectory, TrajectoryError> {
        if source != TrajectorySource::Odometry {
            return Ok(recorded);
        }
        let mut others = [TrajectorySource::GroundTruth, TrajectorySource::T265].into_iter();
        let turn_rad = others.find_map(|other| {
            let other = shelf.trajectory(&self.trajectory_of(other, "rx")).ok()?.0;
            heading_between_rad(&recorded, &other)
        });
        turn_rad.map_or(Ok(recorded.clone()), |turn_rad| turned_by(&recorded, turn_rad))
    }
}

/// How an antenna travels in the frame of a sensor beside it: sums over the steps of a motion, in the horizontal plane, x
/// forward and y left of the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Travel {
    /// Of the steps, metres.
    steps_m: Complex64,
    /// Of the changes of a unit vector ahead.
    turns: Complex64,
}

impl Travel {
    fn of(sensor: &Trajectory, antenna: &Trajectory) -> Option<Self> {
        let (from_s, to_s) = antenna.motion().window_s?;
        let inside = sensor.poses().iter().filter(|pose| (from_s..=to_s).contains(&pose.t_s));
        let seen: Vec<(f64, Complex64)> =
            inside.filter_map(|pose| Some((pose.heading_rad?, complex(&antenna.at(pose.t_s)?)))).collect();
        let mut travel = Self { steps_m: Complex64::ZERO, turns: Complex64::ZERO };
        for pair in seen.windows(2) {
            let [(first, from), (last, to)] = *pair else { continue };
            let back = Complex64::from_polar(1.0, -(first + 0.5 * wrap_rad(last - first)));
            travel.steps_m += (to - from) * back;
            travel.turns += (Complex64::from_polar(1.0, last) - Complex64::from_polar(1.0, first)) * back;
        }
        (travel.steps_m.norm() > 0.0).then_some(travel)
    }

    /// The sensor's heading less the robot's, radians, if the antenna is `offset_m` forward and left of the middle between
    /// the wheels: that at which this middle has no step sideways. None where no heading does that.
    pub fn yaw_rad(&self, offset_m: [f64; 2]) -> Option<f64> {
        let sideways_m = (self.turns * Complex64::new(offset_m[0], offset_m[1])).im;
        let share = sideways_m / self.steps_m.norm();
        (share.abs() <= 1.0).then(|| wrap_rad(share.asin() - self.steps_m.arg()))
    }
}

/// The offset that captures agree on, metres forward and left: the median of each. None of none.
pub(crate) fn usual_offset_m(offsets_m: impl Iterator<Item = [f64; 2]>) -> Option<[f64; 2]> {
    let (mut forward, mut left): (Vec<f64>, Vec<f64>) = offsets_m.map(|[x, y]| (x, y)).unzip();
    Some([median(&mut forward)?, median(&mut left)?])
}

/// The heading of `to` less that of `from` at the first time that both have one, radians.
fn heading_between_rad(from: &Trajectory, to: &Trajectory) -> Option<f64> {
    let t_s = from.span_s().0.max(to.span_s().0);
    Some(wrap_rad(to.at(t_s)?.heading_rad? - from.at(t_s)?.heading_rad?))
}

/// A trajectory turned about its first position.
fn turned_by(trajectory: &Trajectory, turn_rad: f64) -> Result<Trajectory, TrajectoryError> {
    let first = trajectory.poses().first().map_or(Vector3::zeros(), |pose| pose.position_m);
    let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), turn_rad);
    let turned = |pose: &Pose| Pose {
        t_s: pose.t_s,
        position_m: first + rotation * (pose.position_m - first),
        heading_rad: pose.heading_rad.map(|heading| wrap_rad(heading + turn_rad)),
    };
    Trajectory::new(trajectory.poses().iter().map(turned).collect())
}

/// See the module.
fn offset_m(odometry: &Trajectory, antenna: &Trajectory) -> Option<[f64; 2]> {
    let (from_s, to_s) = antenna.motion().window_s?;
    let inside = odometry.poses().iter().filter(|pose| (from_s..=to_s).contains(&pose.t_s));
    let both: Vec<(Complex64, Complex64)> = inside
        .filter_map(|pose| {
            let beside = complex(&antenna.at(pose.t_s)?) - complex(pose);
            Some((Complex64::from_polar(1.0, pose.heading_rad?), beside))
        })
        .collect();
    let count = both.len() as f64;
    let (heading, beside) =
        both.iter().fold((Complex64::ZERO, Complex64::ZERO), |sum, own| (sum.0 + own.0, sum.1 + own.1));
    let (heading, beside) = (heading / count, beside / count);
    let turn: f64 = both.iter().map(|own| (own.0 - heading).norm_sqr()).sum();
    let along: Complex64 = both.iter().map(|own| (own.0 - heading).conj() * (own.1 - beside)).sum();
    (turn > LEAST_TURN * count).then(|| [along.re / turn, along.im / turn])
}

fn complex(pose: &Pose) -> Complex64 {
    Complex64::new(pose.position_m.x, pose.position_m.y)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot on an arc of 0.15 m with its heading along it, from `heading_rad` on.
    fn wheels(heading_rad: f64) -> Trajectory {
        let pose = |k: usize| {
            let heading = heading_rad - 0.01 * (k.clamp(50, 350) as f64 - 50.0);
            let place = Vector3::new(-heading.sin(), heading.cos(), 0.0) * 0.15;
            Pose { t_s: 0.05 * k as f64, position_m: place, heading_rad: Some(wrap_rad(heading)) }
        };
        Trajectory::new((0..400).map(pose).collect()).unwrap()
    }

    #[test]
    fn the_antenna_is_where_motion_capture_saw_it() {
        let wheels = wheels(0.0);
        let antenna = wheels.with_antenna_offset(Vector3::new(0.04, 0.16, 0.3)).unwrap();
        let [forward, left] = offset_m(&wheels, &antenna).unwrap();
        assert!((forward - 0.04).abs() < 1e-3 && (left - 0.16).abs() < 1e-3, "{forward} {left}");
        // A straight line shows no offset, and neither do other times.
        let straight = |pose: &Pose| Pose { position_m: Vector3::x() * pose.t_s, heading_rad: Some(0.0), ..*pose };
        let line = Trajectory::new(wheels.poses().iter().map(straight).collect()).unwrap();
        assert_eq!(offset_m(&line, &line), None);
        assert_eq!(offset_m(&later(&wheels), &antenna), None);
    }

    #[test]
    fn the_heading_at_which_wheels_do_not_slip_is_the_cameras() {
        for yaw_rad in [0.0, 0.05, -0.3] {
            let wheels = wheels(0.4);
            let antenna = wheels.with_antenna_offset(Vector3::new(0.04, 0.16, 0.3)).unwrap();
            let looks = |pose: &Pose| Pose { heading_rad: pose.heading_rad.map(|h| wrap_rad(h + yaw_rad)), ..*pose };
            let camera = Trajectory::new(wheels.poses().iter().map(looks).collect()).unwrap();
            let travel = Travel::of(&camera, &antenna).unwrap();
            let found = travel.yaw_rad([0.04, 0.16]).unwrap();
            assert!((found - yaw_rad).abs() < 2e-3, "{yaw_rad}: {found}");
            // With the antenna taken to be elsewhere along the robot, another heading is found.
            assert!((travel.yaw_rad([-0.1, 0.16]).unwrap() - yaw_rad).abs() > 0.1);
            assert_eq!(travel.yaw_rad([9.0, 0.0]), None);
        }
        assert_eq!(Travel::of(&wheels(0.0), &later(&wheels(0.0))), None);
    }

    /// The same a minute and a half later.
    fn later(trajectory: &Trajectory) -> Trajectory {
        let moved = |pose: &Pose| Pose { t_s: pose.t_s + 100.0, ..*pose };
        Trajectory::new(trajectory.poses().iter().map(moved).collect()).unwrap()
    }

    #[test]
    fn what_was_not_set_to_zero_is_turned_to_where_another_looks() {
        let (zeroed, going_on) = (wheels(0.0), wheels(-0.25));
        let turn_rad = heading_between_rad(&going_on, &zeroed).unwrap();
        assert!((turn_rad - 0.25).abs() < 1e-9, "{turn_rad}");
        let turned = turned_by(&going_on, turn_rad).unwrap();
        let moved = |trajectory: &Trajectory, k: usize| {
            let poses = trajectory.poses();
            poses[k].position_m - poses[0].position_m
        };
        for k in 0..400 {
            assert!((moved(&turned, k) - moved(&zeroed, k)).norm() < 1e-9, "{k}");
        }
        assert_eq!(heading_between_rad(&turned, &wheels(1.0)).map(|rad| (rad * 1e6).round()), Some(1e6));
    }

    #[test]
    fn one_capture_that_is_wrong_moves_nothing() {
        let offsets = [[0.04, 0.16], [0.05, 0.16], [9.0, -9.0], [0.03, 0.15], [0.04, 0.17]];
        assert_eq!(usual_offset_m(offsets.into_iter()), Some([0.04, 0.16]));
        assert_eq!(usual_offset_m(std::iter::empty()), None);
    }
}
