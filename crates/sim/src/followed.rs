//! A robot that follows an odometry source: a simulator's, over ROS, or a recorded one.
//!
//! The room computes past times in any order and repeatedly, so the past never changes: a pose takes effect a moment
//! after it arrives, and without poses the robot waits.

use super::maths::{rad, turned};
use super::motion::{FollowedMotion, Pose};
use csi5300::motion::odometry::{FollowedCounts, NextPose, OdometrySource, SourceCounts};
use csi5300::motion::pose;
use csi5300::time::Instant;
use nalgebra::Vector3;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Delay until the robot reaches a pose in the room, seconds; earlier poses are interpolated.
const BEHIND_S: f64 = 0.1;
/// A pose whose time differs by more than this from its arrival resets the clock, seconds.
const APART_S: f64 = 0.5;
/// Time that the robot takes to a late pose, seconds.
const AT_ONCE_S: f64 = 0.001;
/// Poses older than this are forgotten: no record waits so long to be read, seconds.
const KEPT_S: f64 = 60.0;
/// Poses taken from a source at one time.
const BURST: usize = 4_096;

#[derive(Clone, Copy, Debug)]
struct Knot {
    t_s: f64,
    pose: Pose,
    /// Number of the source's frame, 0 before the first pose.
    frame: u32,
}

/// The path of a followed robot: straight from pose to pose.
#[derive(Debug)]
pub struct Way {
    knots: VecDeque<Knot>,
    origin: Pose,
    frame: u32,
    /// The next pose starts a frame.
    begins: bool,
    /// The room's time minus the source's.
    ahead_s: Option<f64>,
    counts: FollowedCounts,
}

impl Way {
    /// A robot that waits at `start`.
    #[must_use]
    pub fn new(start: Pose, motion: &FollowedMotion) -> Self {
        let origin = Pose { position_m: Vector3::from(motion.origin_m), yaw_rad: rad(motion.origin_yaw_deg) };
        Self {
            knots: VecDeque::from([Knot { t_s: f64::NEG_INFINITY, pose: start, frame: 0 }]),
            origin,
            frame: 0,
            begins: true,
            ahead_s: None,
            counts: FollowedCounts::default(),
        }
    }

    /// The pose at a time of the room no later than now, and the number of its frame: 0 before the first pose came.
    #[must_use]
    pub fn at(&self, t_s: f64) -> (Pose, u32) {
        let after = self.knots.partition_point(|knot| knot.t_s <= t_s);
        let Some(from) = self.knots.get(after.saturating_sub(1)) else { return (self.origin, 0) };
        match self.knots.get(after) {
            Some(to) if after > 0 && from.t_s.is_finite() && to.frame == from.frame => {
                (from.pose.towards(&to.pose, (t_s - from.t_s) / (to.t_s - from.t_s)), from.frame)
            }
            _ => (from.pose, from.frame),
        }
    }

    /// Takes the poses that came by `now_s`, in their order, each of the same frame.
    fn hand_over(&mut self, now_s: f64, poses: &[pose::Pose]) {
        let Some(newest) = poses.last() else { return };
        let due_s = now_s + BEHIND_S;
        let wanted_s = due_s - newest.t_s;
        if self.ahead_s.is_none_or(|ahead_s| (ahead_s - wanted_s).abs() > APART_S) {
            self.counts.clock_set += u64::from(self.ahead_s.is_some());
            self.ahead_s = Some(wanted_s);
        }
        let ahead_s = self.ahead_s.unwrap_or(wanted_s);
        for (k, pose) in poses.iter().enumerate() {
            let mut t_s = pose.t_s + ahead_s;
            if t_s <= now_s && k + 1 == poses.len() {
                t_s = now_s + AT_ONCE_S;
            }
            self.push(now_s, t_s, pose);
        }
        while self.knots.get(1).is_some_and(|second| second.t_s < now_s - KEPT_S) {
            self.knots.pop_front();
        }
    }

    fn push(&mut self, now_s: f64, t_s: f64, pose: &pose::Pose) {
        let Some(last) = self.knots.back().copied() else { return };
        if t_s <= now_s || t_s <= last.t_s {
            self.counts.late += 1;
            return;
        }
        if last.t_s < now_s {
            // It waited until now.
            self.knots.push_back(Knot { t_s: now_s, ..last });
        }
        if std::mem::take(&mut self.begins) {
            self.frame += 1;
        }
        let yaw_rad = pose.heading_rad.map_or(last.pose.yaw_rad, |heading_rad| self.origin.yaw_rad + heading_rad);
        let position_m = self.origin.position_m + turned(pose.position_m, self.origin.yaw_rad);
        self.knots.push_back(Knot { t_s, pose: Pose { position_m, yaw_rad }, frame: self.frame });
        self.counts.poses += 1;
    }

    fn begin_frame(&mut self) {
        self.counts.new_frames += 1;
        self.begins = true;
    }
}

/// A path that a source extends and the room reads.
pub type SharedWay = Arc<Mutex<Way>>;

/// Locks a path; it is consistent between poses, so a poisoned lock is usable.
pub fn lock(way: &Mutex<Way>) -> MutexGuard<'_, Way> {
    way.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A source that a robot follows.
pub struct Follower {
    /// The robot.
    pub robot: usize,
    way: SharedWay,
    source: Box<dyn OdometrySource + Send>,
    ended: Option<String>,
    burst: Vec<pose::Pose>,
}

impl Follower {
    /// Robot number `robot` follows this path from now on.
    pub fn new(robot: usize, way: SharedWay, source: Box<dyn OdometrySource + Send>) -> Self {
        Self { robot, way, source, ended: None, burst: Vec::new() }
    }

    /// Takes the poses that arrived by `now`.
    pub fn take(&mut self, now: Instant) {
        let now_s = now.as_s();
        for _ in 0..BURST {
            if self.ended.is_some() {
                break;
            }
            match self.source.receive(now) {
                Ok(NextPose::Pose(pose)) => self.burst.push(pose),
                Ok(NextPose::NewFrame) => {
                    let mut way = lock(&self.way);
                    way.hand_over(now_s, &self.burst);
                    way.begin_frame();
                    drop(way);
                    self.burst.clear();
                }
                Ok(NextPose::Pending) => break,
                Ok(NextPose::End) => self.ended = Some(String::new()),
                Err(error) => self.ended = Some(error.to_string()),
            }
        }
        if !self.burst.is_empty() {
            lock(&self.way).hand_over(now_s, &self.burst);
            self.burst.clear();
        }
    }

    /// The source's error.
    #[must_use]
    pub fn trouble(&self) -> Option<String> {
        self.ended.clone().filter(|why| !why.is_empty()).or_else(|| self.source.trouble())
    }

    /// Counts of the robot and of its source.
    #[must_use]
    pub fn counted(&self) -> SourceCounts {
        SourceCounts::Followed { followed: lock(&self.way).counts, source: self.source.counted().map(Box::new) }
    }
}

#[cfg(test)]
#[path = "followed_tests.rs"]
mod tests;
