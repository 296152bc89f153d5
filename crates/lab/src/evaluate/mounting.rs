//! Converts trajectories of a robot's sensors to its antenna's.
//!
//! Phases depend on the antenna's path, but a tracking camera and wheels measure their own. Their trajectory is moved to the
//! antenna's position on the robot. Wheels continue from the previous run's heading, so they are rotated to another sensor's.

use super::find::{Capture, TrajectorySource};
use super::shelf::Shelf;
use csi5300::maths::wrap_rad;
use csi5300::motion::pose::{Pose, Trajectory, TrajectoryError};
use nalgebra::{Rotation3, Vector3};

impl Capture {
    /// The antenna's trajectory from the one recorded by `source`.
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

    /// Unless they are reset, wheels continue from the previous run's heading. Their trajectory is rotated to the heading that
    /// motion capture, or else the tracking camera, has at the same time at the start.
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

/// The heading of `to` minus that of `from` at the first common time, radians.
fn heading_between_rad(from: &Trajectory, to: &Trajectory) -> Option<f64> {
    let t_s = from.span_s().0.max(to.span_s().0);
    Some(wrap_rad(to.at(t_s)?.heading_rad? - from.at(t_s)?.heading_rad?))
}

/// A trajectory rotated about its first position.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot on an arc of 0.15 m with its heading along it, starting at `heading_rad`.
    fn wheels(heading_rad: f64) -> Trajectory {
        let pose = |k: usize| {
            let heading = heading_rad - 0.01 * (k.clamp(50, 350) as f64 - 50.0);
            let place = Vector3::new(-heading.sin(), heading.cos(), 0.0) * 0.15;
            Pose { t_s: 0.05 * k as f64, position_m: place, heading_rad: Some(wrap_rad(heading)) }
        };
        Trajectory::new((0..400).map(pose).collect()).unwrap()
    }

    #[test]
    fn unreset_wheels_are_rotated_to_another_sensors_heading() {
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
}
