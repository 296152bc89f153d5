//! Odometry as a sensor: true motion with a rate, noise, scale and heading errors, gaps and late poses.

use super::air::Air;
use super::maths::{rad, turned};
use super::motion;
use super::port::{host_us, lock};
use super::random::{Purpose, Stream};
use super::scene::Odometry;
use super::world::World;
use csi5300::motion::odometry::{NextPose, OdometryError, OdometrySource, SourceCounts};
use csi5300::motion::pose::Pose;
use csi5300::time::Instant;
use nalgebra::Vector3;
use std::sync::{Arc, Mutex};

/// A robot's odometry in the scene's frame: at the start the sensor has no error.
#[derive(Debug)]
pub struct Odometer {
    air: Arc<Mutex<Air>>,
    world: Arc<World>,
    robot: usize,
    sensor: Odometry,
    stream: Stream,
    /// Number of the next measurement.
    next: i64,
    /// Late poses with their arrival times.
    late: Vec<(i64, Pose)>,
    before: motion::Pose,
    believed_m: Vector3<f64>,
    heading_error_rad: f64,
    /// Of a followed robot: the frame of the last pose.
    frame: u32,
}

impl Odometer {
    pub(super) fn new(air: Arc<Mutex<Air>>, robot: usize) -> Self {
        let world = Arc::clone(lock(&air).world());
        let scene = world.scene();
        let before = world.pose(robot, 0.0);
        Self {
            sensor: scene.robot[robot].odometry,
            stream: Stream::new(scene.seed, robot, Purpose::Odometry),
            robot,
            next: 0,
            late: Vec::new(),
            before,
            believed_m: before.position_m,
            heading_error_rad: 0.0,
            frame: 0,
            air,
            world,
        }
    }

    /// True time of measurement number `n`; `None` after the end of the scene.
    fn measured_ns(&self, n: i64) -> Option<i64> {
        let t_s = n as f64 / self.sensor.rate_hz;
        (t_s <= self.world.scene().duration_s).then_some((t_s * 1e9).round() as i64)
    }

    fn due_ns(&self) -> Option<i64> {
        let late = self.late.iter().map(|late| late.0).min();
        [late, self.measured_ns(self.next)].into_iter().flatten().min()
    }

    /// True if a followed robot's poses are in another frame from `due_ns` on: dead reckoning restarts.
    fn begins_frame(&mut self, due_ns: i64) -> bool {
        let t_s = due_ns as f64 * 1e-9;
        let Some(frame) = self.world.frame(self.robot, t_s).filter(|frame| *frame != self.frame) else { return false };
        let first = std::mem::replace(&mut self.frame, frame) == 0;
        self.before = self.world.pose(self.robot, t_s);
        (self.believed_m, self.heading_error_rad) = (self.before.position_m, 0.0);
        self.late.clear();
        !first
    }

    /// The pose that is due at `due_ns`, if it is not dropped or late.
    fn take(&mut self, due_ns: i64) -> Option<Pose> {
        if let Some(at) = self.late.iter().position(|late| late.0 == due_ns) {
            return Some(self.late.swap_remove(at).1);
        }
        if self.world.frame(self.robot, due_ns as f64 * 1e-9) == Some(0) {
            // Its place is not known yet.
            self.next += 1;
            return None;
        }
        let pose = self.measure(due_ns);
        self.next += 1;
        let mut air = lock(&self.air);
        let injected = &mut air.node(self.robot).injected;
        if self.stream.happens(self.sensor.drop) {
            injected.poses_dropped += 1;
            None
        } else if self.stream.happens(self.sensor.late) {
            injected.poses_late += 1;
            self.late.push((due_ns + (self.sensor.late_s * 1e9).round() as i64, pose));
            None
        } else {
            Some(pose)
        }
    }

    /// One step of dead reckoning: the true step, scaled, and turned by the heading error.
    fn measure(&mut self, t_ns: i64) -> Pose {
        let sensor = self.sensor;
        let truth = self.world.pose(self.robot, t_ns as f64 * 1e-9);
        if sensor.scale == 1.0 && sensor.heading_drift_deg_s == 0.0 && sensor.heading_walk_deg == 0.0 {
            self.believed_m = truth.position_m;
        } else {
            let step_s = if self.next == 0 { 0.0 } else { 1.0 / sensor.rate_hz };
            let driven = (truth.position_m - self.before.position_m) * sensor.scale;
            self.believed_m += turned(driven, self.heading_error_rad);
            self.heading_error_rad += rad(sensor.heading_drift_deg_s) * step_s;
            self.heading_error_rad += self.stream.spread(rad(sensor.heading_walk_deg) * step_s.sqrt());
        }
        self.before = truth;
        let mut noise = || self.stream.spread(sensor.noise_m);
        let position_m = self.believed_m + Vector3::new(noise(), noise(), noise());
        let yaw_rad = truth.yaw_rad + self.heading_error_rad + self.stream.spread(rad(sensor.noise_deg));
        let t_s = host_us(&lock(&self.air), self.robot, t_ns) as f64 * 1e-6;
        Pose { t_s, position_m, heading_rad: Some(yaw_rad) }
    }
}

impl OdometrySource for Odometer {
    fn receive(&mut self, now: Instant) -> Result<NextPose, OdometryError> {
        let now_ns = now.as_us().saturating_mul(1_000);
        while let Some(due_ns) = self.due_ns() {
            if due_ns > now_ns {
                return Ok(NextPose::Pending);
            }
            if self.begins_frame(due_ns) {
                return Ok(NextPose::NewFrame);
            }
            if let Some(pose) = self.take(due_ns) {
                lock(&self.air).node(self.robot).injected.poses += 1;
                return Ok(NextPose::Pose(pose));
            }
        }
        Ok(NextPose::End)
    }

    fn next_at(&self) -> Option<Instant> {
        self.due_ns().map(|ns| Instant::from_us(ns.saturating_add(999).div_euclid(1_000)))
    }

    fn trouble(&self) -> Option<String> {
        lock(&self.air).follower(self.robot)?.trouble()
    }

    fn counted(&self) -> Option<SourceCounts> {
        Some(lock(&self.air).follower(self.robot)?.counted())
    }
}
