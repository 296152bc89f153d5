//! Motions of robots: pose as a function of true time. Shapes and walks, tables of poses (recorded trajectories, waypoints),
//! and odometry sources that a robot follows: a simulator's, over ROS, or a recorded one.
//!
//! The room computes past times in any order and repeatedly, so the past of a followed robot never changes: a pose takes
//! effect a moment after it arrives, and without poses the robot waits.

use super::maths::{heading, rad, turned};
use super::random::Stream;
use csi5300::internal::lock;
use csi5300::motion::odometry::{FollowedCounts, NextPose, OdometrySource, SourceCounts, csv};
use csi5300::motion::pose::{self, Trajectory};
use csi5300::time::Instant;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::path::Path;
use std::sync::Mutex;

/// Place and heading of a robot, in the scene's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Metres; x, y in the plane, z up.
    pub position_m: Vector3<f64>,
    /// Heading, radians from +x towards +y.
    pub yaw_rad: f64,
}

impl Pose {
    /// The place of something mounted at `offset_m` in the robot's own frame (x forward, y left, z up).
    #[must_use]
    pub fn mounted(&self, offset_m: Vector3<f64>) -> Vector3<f64> {
        self.position_m + turned(offset_m, self.yaw_rad)
    }

    /// The pose at `part` of the way to another: straight, turning the short way.
    pub(super) fn towards(&self, to: &Self, part: f64) -> Self {
        let turn = to.yaw_rad - self.yaw_rad;
        let turn = turn - TAU * (turn / TAU).round();
        let position_m = self.position_m + (to.position_m - self.position_m) * part;
        Self { position_m, yaw_rad: self.yaw_rad + turn * part }
    }
}

/// A motion of a scene. All except `waypoints`, `recorded` and `followed` start at the robot's position and heading,
/// after `start_s` of rest, and end after `duration_s` of motion; then the robot rests.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RobotMotion {
    /// No motion.
    #[default]
    Static,
    /// Straight ahead.
    Line(Line),
    /// Full circles, to the left.
    Circle(Circle),
    /// Part of a circle.
    Arc(Arc),
    /// Squares, corners to the left, turning on the spot in no time.
    Square(Square),
    /// A circle that rises.
    Helix(Helix),
    /// A circle to the left, then one to the right.
    FigureEight(Circle),
    /// A smooth random walk.
    RandomWalk(RandomWalk),
    /// Straight from point to point.
    Waypoints(Waypoints),
    /// A trajectory file.
    Recorded(RecordedMotion),
    /// Live poses of an odometry source, see [`super::Room::follow`].
    Followed(FollowedMotion),
}

/// See [`RobotMotion::Line`].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// Length, metres.
    pub length_m: f64,
    /// Time for it, seconds.
    pub duration_s: f64,
    /// Rest before it, seconds.
    #[serde(default)]
    pub start_s: f64,
}

/// See [`RobotMotion::Circle`] and [`RobotMotion::FigureEight`].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Circle {
    /// Radius, metres.
    pub radius_m: f64,
    /// Time for all turns, seconds.
    pub duration_s: f64,
    /// Number of turns or figures; negative turns go to the right.
    #[serde(default = "one")]
    pub turns: f64,
    /// Rest before it, seconds.
    #[serde(default)]
    pub start_s: f64,
}

/// See [`RobotMotion::Arc`].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Arc {
    /// Radius, metres.
    pub radius_m: f64,
    /// Angle driven, degrees; negative to the right.
    pub angle_deg: f64,
    /// Time for it, seconds.
    pub duration_s: f64,
    /// Rest before it, seconds.
    #[serde(default)]
    pub start_s: f64,
}

/// See [`RobotMotion::Square`].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Square {
    /// Side, metres.
    pub side_m: f64,
    /// Time for all turns, seconds.
    pub duration_s: f64,
    /// Number of times round.
    #[serde(default = "one")]
    pub turns: f64,
    /// Rest before it, seconds.
    #[serde(default)]
    pub start_s: f64,
}

/// See [`RobotMotion::Helix`].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Helix {
    /// Radius, metres.
    pub radius_m: f64,
    /// Rise in one turn, metres.
    pub rise_m: f64,
    /// Time for all turns, seconds.
    pub duration_s: f64,
    /// Number of turns; negative ones go to the right.
    #[serde(default = "one")]
    pub turns: f64,
    /// Rest before it, seconds.
    #[serde(default)]
    pub start_s: f64,
}

/// See [`RobotMotion::RandomWalk`].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct RandomWalk {
    /// Speed, metres per second.
    pub speed_m_s: f64,
    /// Standard deviation of the turning rate, degrees per second.
    #[serde(default = "ninety")]
    pub turning_deg_s: f64,
    /// The robot turns back beyond this distance from its start, metres.
    #[serde(default = "one")]
    pub within_m: f64,
    /// Time of motion, seconds.
    pub duration_s: f64,
    /// Rest before it, seconds.
    #[serde(default)]
    pub start_s: f64,
}

/// See [`RobotMotion::Waypoints`].
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Waypoints {
    /// Points in the scene's frame, metres, visited in order after the robot's own position.
    pub points_m: Vec<[f64; 3]>,
    /// Speed, metres per second.
    pub speed_m_s: f64,
    /// Rest before it, seconds.
    #[serde(default)]
    pub start_s: f64,
}

/// See [`RobotMotion::Recorded`].
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedMotion {
    /// A trajectory CSV in any of the layouts that [`Recorded`] reads, relative to the scene's file.
    pub file: std::path::PathBuf,
    /// When the file's first row is reached, seconds.
    #[serde(default)]
    pub start_s: f64,
    /// Deviation of the true path from the file, metres (standard deviation of x and of y), as the file comes from a
    /// sensor.
    #[serde(default)]
    pub stray_m: f64,
    /// Approximate period of that deviation, seconds.
    #[serde(default = "ten")]
    pub stray_s: f64,
}

fn ten() -> f64 {
    10.0
}

/// See [`RobotMotion::Followed`]. The robot waits at its own position until the first pose comes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct FollowedMotion {
    /// Where the origin of the poses' frame lies in the room, metres.
    pub origin_m: [f64; 3],
    /// Rotation of the poses' frame in the room, degrees from +x towards +y.
    pub origin_yaw_deg: f64,
}

fn one() -> f64 {
    1.0
}

fn ninety() -> f64 {
    90.0
}

/// A motion made ready: pose at any time in constant or logarithmic time.
#[derive(Clone, Debug)]
pub(super) struct Track {
    start: Pose,
    shape: Shape,
    start_s: f64,
    duration_s: f64,
}

#[derive(Clone, Debug)]
enum Shape {
    Formula(RobotMotion),
    Table(Recorded),
    Followed(SharedWay),
}

impl Track {
    /// Makes a motion ready. Random walks draw from `stream`; `recorded` is the file of a recorded one.
    pub fn new(start: Pose, motion: &RobotMotion, recorded: Option<Recorded>, stream: &mut Stream) -> Self {
        let timed = |table: Recorded, start_s| (table.duration_s(), Shape::Table(table), start_s);
        let (duration_s, shape, start_s) = match motion {
            RobotMotion::RandomWalk(m) => (m.duration_s, Shape::Table(walk(start, m, stream)), m.start_s),
            RobotMotion::Waypoints(m) => timed(legs(start, m), m.start_s),
            RobotMotion::Recorded(m) => match recorded {
                Some(table) => timed(table.strayed(m.stray_m, m.stray_s), m.start_s),
                None => (0.0, Shape::Formula(RobotMotion::Static), 0.0),
            },
            RobotMotion::Followed(m) => {
                (0.0, Shape::Followed(std::sync::Arc::new(Mutex::new(Way::new(start, m)))), 0.0)
            }
            RobotMotion::Static => (0.0, Shape::Formula(RobotMotion::Static), 0.0),
            RobotMotion::Line(Line { start_s, duration_s, .. })
            | RobotMotion::Circle(Circle { start_s, duration_s, .. })
            | RobotMotion::Arc(Arc { start_s, duration_s, .. })
            | RobotMotion::Square(Square { start_s, duration_s, .. })
            | RobotMotion::Helix(Helix { start_s, duration_s, .. })
            | RobotMotion::FigureEight(Circle { start_s, duration_s, .. }) => {
                (*duration_s, Shape::Formula(motion.clone()), *start_s)
            }
        };
        Self { start, shape, start_s, duration_s }
    }

    /// True if the robot never moves.
    pub fn is_still(&self) -> bool {
        matches!(self.shape, Shape::Formula(RobotMotion::Static))
    }

    /// The way of a followed robot.
    pub fn way(&self) -> Option<&SharedWay> {
        match &self.shape {
            Shape::Followed(way) => Some(way),
            _ => None,
        }
    }

    /// The pose at true time `t_s`, seconds since the scene began.
    pub fn at(&self, t_s: f64) -> Pose {
        let moved_s = (t_s - self.start_s).clamp(0.0, self.duration_s);
        let part = if self.duration_s > 0.0 { moved_s / self.duration_s } else { 0.0 };
        let motion = match &self.shape {
            Shape::Table(table) => return table.at(moved_s),
            Shape::Followed(way) => return lock(way).at(t_s).0,
            Shape::Formula(motion) => motion,
        };
        match motion {
            RobotMotion::Line(m) => Pose {
                position_m: self.start.position_m + heading(self.start.yaw_rad) * (m.length_m * part),
                ..self.start
            },
            RobotMotion::Circle(m) => turn(self.start, m.radius_m, TAU * m.turns * part),
            RobotMotion::Arc(m) => turn(self.start, m.radius_m, rad(m.angle_deg) * part),
            RobotMotion::Helix(m) => {
                let mut pose = turn(self.start, m.radius_m, TAU * m.turns * part);
                pose.position_m.z += m.rise_m * m.turns.abs() * part;
                pose
            }
            RobotMotion::Square(m) => round_the_square(self.start, m.side_m, m.turns * part),
            RobotMotion::FigureEight(m) => {
                let figure = m.turns * part;
                let angle = 2.0 * TAU * (figure - figure.floor());
                // The second circle is the first one's mirror: it begins and ends where the first does.
                turn(self.start, m.radius_m, if angle < TAU { angle } else { TAU - angle })
            }
            _ => self.start,
        }
    }
}

/// `start` after driving along a circle by `angle_rad`: positive to the left, negative to the right.
fn turn(start: Pose, radius_m: f64, angle_rad: f64) -> Pose {
    let side = if angle_rad < 0.0 { -1.0 } else { 1.0 };
    let left = turned(Vector3::new(0.0, side * radius_m, 0.0), start.yaw_rad);
    let yaw_rad = start.yaw_rad + angle_rad;
    let from_centre = turned(Vector3::new(0.0, -side * radius_m, 0.0), yaw_rad);
    Pose { position_m: start.position_m + left + from_centre, yaw_rad }
}

/// `start` after driving `turns` times round a square, corners to the left.
fn round_the_square(start: Pose, side_m: f64, turns: f64) -> Pose {
    let sides = 4.0 * turns;
    let (whole, rest) = (sides.floor(), sides - sides.floor());
    let corner = match (whole as i64).rem_euclid(4) {
        0 => [0.0, 0.0],
        1 => [1.0, 0.0],
        2 => [1.0, 1.0],
        _ => [0.0, 1.0],
    };
    let yaw_rad = start.yaw_rad + whole * (TAU / 4.0);
    let corner_m = turned(Vector3::new(corner[0] * side_m, corner[1] * side_m, 0.0), start.yaw_rad);
    Pose { position_m: start.position_m + corner_m + heading(yaw_rad) * (side_m * rest), yaw_rad }
}

/// A random walk in steps of 10 ms: the turning rate is a first-order Gauss-Markov process of 1 s.
fn walk(start: Pose, m: &RandomWalk, stream: &mut Stream) -> Recorded {
    const STEP_S: f64 = 0.01;
    let steps = (m.duration_s / STEP_S).ceil().max(0.0) as usize;
    let keep = libm::exp(-STEP_S);
    let kick = rad(m.turning_deg_s) * (1.0 - keep * keep).sqrt();
    let (mut pose, mut rate) = (start, rad(m.turning_deg_s) * stream.normal());
    let mut rows = vec![(0.0, pose)];
    for step in 1..=steps {
        rate = keep * rate + kick * stream.normal();
        let away = pose.position_m - start.position_m;
        let facing = heading(pose.yaw_rad);
        let outwards = away.dot(&facing) > 0.0;
        let steered = if away.norm() > m.within_m && outwards {
            // Turn on the shorter side, at least at a half turn per second.
            let side = if facing.x * away.y - facing.y * away.x > 0.0 { -1.0 } else { 1.0 };
            side * rate.abs().max(TAU / 2.0)
        } else {
            rate
        };
        pose.yaw_rad += steered * STEP_S;
        pose.position_m += heading(pose.yaw_rad) * (m.speed_m_s * STEP_S);
        rows.push((step as f64 * STEP_S, pose));
    }
    Recorded::from_rows(rows)
}

/// Straight legs through the points at constant speed, facing along each leg.
fn legs(start: Pose, m: &Waypoints) -> Recorded {
    let mut rows = vec![(0.0, start)];
    let (mut t_s, mut here) = (0.0, start);
    for &[x, y, z] in &m.points_m {
        let to = Vector3::new(x, y, z);
        let leg = to - here.position_m;
        let yaw_rad = if leg.xy().norm() > 0.0 { libm::atan2(leg.y, leg.x) } else { here.yaw_rad };
        rows.push((t_s, Pose { yaw_rad, ..here }));
        t_s += leg.norm() / m.speed_m_s;
        here = Pose { position_m: to, yaw_rad };
        rows.push((t_s, here));
    }
    Recorded::from_rows(rows)
}

/// Poses over time, interpolated linearly; at rest before the first row and after the last.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// Seconds since the first row, never falling.
    t_s: Vec<f64>,
    poses: Vec<Pose>,
}

impl Recorded {
    /// A trajectory from rows of (seconds, pose), which are put into the order of time.
    pub(crate) fn from_rows(mut rows: Vec<(f64, Pose)>) -> Self {
        rows.sort_by(|a, b| a.0.total_cmp(&b.0));
        let first = rows.first().map_or(0.0, |row| row.0);
        let (t_s, poses) = rows.into_iter().map(|(t, pose)| (t - first, pose)).unzip();
        Self { t_s, poses }
    }

    /// Reads a trajectory file, see [`csi5300::motion::odometry::csv`]. Without headings the robot faces its direction
    /// of motion.
    ///
    /// # Errors
    /// Rows that cannot be read are an error here, since a scene must be exact.
    pub(crate) fn load(file: &Path) -> Result<Self, String> {
        let name = file.display();
        let (trajectory, counts) = csv::read(file, None).map_err(|source| format!("trajectory {name}: {source}"))?;
        if let Some((line, reason)) = counts.first_bad {
            return Err(format!("trajectory {name}, line {line}: {reason}"));
        }
        Ok(Self::from_trajectory(&trajectory))
    }

    /// A recorded trajectory as a motion.
    #[must_use]
    pub fn from_trajectory(trajectory: &Trajectory) -> Self {
        let poses = trajectory.poses();
        let row = |p: &csi5300::motion::pose::Pose| {
            (p.t_s, Pose { position_m: p.position_m, yaw_rad: p.heading_rad.unwrap_or(0.0) })
        };
        let mut recorded = Self::from_rows(poses.iter().map(row).collect());
        if poses.iter().any(|p| p.heading_rad.is_none()) {
            recorded.face_forward();
        }
        recorded
    }

    /// From the first row to the last, seconds.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.t_s.last().copied().unwrap_or(0.0)
    }

    /// The pose `t_s` seconds after the first row.
    #[must_use]
    pub fn at(&self, t_s: f64) -> Pose {
        let after = self.t_s.partition_point(|&t| t <= t_s);
        let last = self.poses.len().saturating_sub(1);
        let pose = |i: usize| self.poses.get(i).copied().unwrap_or(Pose { position_m: Vector3::zeros(), yaw_rad: 0.0 });
        let (Some(&from), Some(&to)) = (self.t_s.get(after.wrapping_sub(1)), self.t_s.get(after)) else {
            return pose(if after == 0 { 0 } else { last });
        };
        let (a, b) = (pose(after - 1), pose(after));
        let part = if to > from { (t_s - from) / (to - from) } else { 0.0 };
        a.towards(&b, part)
    }

    /// The same with every place off by slow swings: of standard deviation `stray_m` in x and in y, each of sines with
    /// periods about `stray_s`. They do not depend on the seed, because a recorded path is fixed.
    pub(super) fn strayed(mut self, stray_m: f64, stray_s: f64) -> Self {
        /// Periods of the sines, in no simple ratio, so that the deviation is reached within a few periods.
        const PERIODS: [f64; 8] = [0.62, 0.73, 0.86, 1.01, 1.19, 1.41, 1.67, 1.98];
        /// Phases follow each other by the golden section of a turn, which spreads any number of them evenly.
        const GOLDEN: f64 = 0.618_033_988_749_895;
        if stray_m == 0.0 {
            return self;
        }
        let size_m = stray_m * (2.0 / PERIODS.len() as f64).sqrt();
        for (t_s, pose) in self.t_s.iter().zip(&mut self.poses) {
            for (k, period) in PERIODS.iter().enumerate() {
                let turns = t_s / (stray_s * period) + k as f64 * GOLDEN;
                // A quarter of a turn apart, for equal deviations in all directions.
                let quarter = if k.is_multiple_of(2) { 0.25 } else { -0.25 };
                pose.position_m.x += size_m * libm::sin(TAU * turns);
                pose.position_m.y += size_m * libm::sin(TAU * (turns + quarter));
            }
        }
        self
    }

    /// Headings along the way driven, for files that have none.
    fn face_forward(&mut self) {
        let places: Vec<Vector3<f64>> = self.poses.iter().map(|p| p.position_m).collect();
        let mut yaw_rad = 0.0;
        for (pose, next) in self.poses.iter_mut().zip(places.iter().skip(1).chain(places.last())) {
            let step = next - pose.position_m;
            if step.xy().norm() > 1e-4 {
                yaw_rad = libm::atan2(step.y, step.x);
            }
            pose.yaw_rad = yaw_rad;
        }
    }
}

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
pub(crate) struct Way {
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
pub(crate) type SharedWay = std::sync::Arc<Mutex<Way>>;

/// A source that a robot follows.
pub(crate) struct Follower {
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
    pub fn trouble(&self) -> Option<String> {
        self.ended.clone().filter(|why| !why.is_empty()).or_else(|| self.source.trouble())
    }

    /// Counts of the robot and of its source.
    pub fn counted(&self) -> SourceCounts {
        SourceCounts::Followed { followed: lock(&self.way).counts, source: self.source.counted().map(Box::new) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Purpose;
    use crate::{Room, Scene};
    use csi5300::source::Error;
    use proptest::prelude::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn trajectories_without_headings_face_where_they_go() {
        let (five, _) = csv::parse("10.0,0,0,0,1,\n11.0,0,0,2,1,\n12.0,0,0,4,1,\n".as_bytes(), None).unwrap();
        let five = Recorded::from_trajectory(&five);
        assert_eq!(five.duration_s(), 2.0);
        assert_eq!(five.at(0.5).position_m, Vector3::new(0.0, 1.0, 1.0));
        assert!((five.at(0.5).yaw_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
        let (six, _) = csv::parse("10.0,0,1,2,3,0.5,\n11.0,0,1,2,3,0.5,\n".as_bytes(), None).unwrap();
        let six = Recorded::from_trajectory(&six);
        assert_eq!(six.at(99.0), Pose { position_m: Vector3::new(1.0, 2.0, 3.0), yaw_rad: 0.5 });
        assert!(Recorded::load(Path::new("no such file.csv")).unwrap_err().contains("no such file.csv"));
    }

    #[test]
    fn headings_turn_the_short_way() {
        let at = |yaw_rad| Pose { position_m: Vector3::zeros(), yaw_rad };
        let table = Recorded::from_rows(vec![(0.0, at(3.0)), (1.0, at(-3.0))]);
        assert!((table.at(0.5).yaw_rad - std::f64::consts::PI).abs() < 1e-12);
    }

    fn track(motion: &RobotMotion) -> Track {
        let start = Pose { position_m: Vector3::new(1.0, -2.0, 0.3), yaw_rad: 0.4 };
        Track::new(start, motion, None, &mut Stream::new(5, 0, Purpose::Walk))
    }

    fn all() -> Vec<RobotMotion> {
        vec![
            RobotMotion::Static,
            RobotMotion::Line(Line { length_m: 1.885, duration_s: 10.0, start_s: 1.0 }),
            RobotMotion::Circle(Circle { radius_m: 0.3, duration_s: 10.0, turns: 1.0, start_s: 1.0 }),
            RobotMotion::Arc(Arc { radius_m: 0.4, angle_deg: -120.0, duration_s: 7.0, start_s: 1.0 }),
            RobotMotion::Square(Square { side_m: 0.5, duration_s: 8.0, turns: 1.0, start_s: 1.0 }),
            RobotMotion::Helix(Helix { radius_m: 0.2, rise_m: 0.1, duration_s: 9.0, turns: 3.0, start_s: 1.0 }),
            RobotMotion::FigureEight(Circle { radius_m: 0.2, duration_s: 8.0, turns: 1.0, start_s: 1.0 }),
            RobotMotion::RandomWalk(RandomWalk {
                speed_m_s: 0.2,
                turning_deg_s: 60.0,
                within_m: 0.5,
                duration_s: 10.0,
                start_s: 1.0,
            }),
            RobotMotion::Waypoints(Waypoints {
                points_m: vec![[2.0, -2.0, 0.3], [2.0, -1.0, 0.3]],
                speed_m_s: 0.2,
                start_s: 1.0,
            }),
        ]
    }

    #[test]
    fn every_motion_rests_starts_at_the_start_and_then_stays() {
        for motion in all() {
            let t = track(&motion);
            assert_eq!(t.at(0.0).position_m, t.at(1.0).position_m, "{motion:?} rests first");
            assert!((t.at(0.0).position_m - Vector3::new(1.0, -2.0, 0.3)).norm() < 1e-12, "{motion:?}");
            assert_eq!(t.at(100.0), t.at(1000.0), "{motion:?} rests afterwards");
            assert_eq!(t.is_still(), motion == RobotMotion::Static);
        }
    }

    #[test]
    fn closed_figures_close_and_go_where_they_say() {
        let t = track(&RobotMotion::Circle(Circle { radius_m: 0.3, duration_s: 10.0, turns: 1.0, start_s: 0.0 }));
        let half = t.at(5.0);
        // To the left of the heading, one diameter away, facing back.
        let across = turned(Vector3::new(0.0, 0.6, 0.0), 0.4);
        assert!((half.position_m - t.at(0.0).position_m - across).norm() < 1e-12);
        assert!((half.yaw_rad - 0.4 - std::f64::consts::PI).abs() < 1e-12);

        let t = track(&RobotMotion::FigureEight(Circle { radius_m: 0.2, duration_s: 8.0, turns: 1.0, start_s: 0.0 }));
        let (left, right) = (t.at(2.0).position_m, t.at(6.0).position_m);
        assert!((left - right).norm() > 0.79 && (t.at(4.0).position_m - t.at(0.0).position_m).norm() < 1e-12);

        for turns in [1.0, 2.0] {
            let t = track(&RobotMotion::Square(Square { side_m: 0.5, duration_s: 8.0, turns, start_s: 0.0 }));
            assert!((t.at(8.0).position_m - t.at(0.0).position_m).norm() < 1e-12);
            let diagonal = t.at(4.0 / turns).position_m - t.at(0.0).position_m;
            assert!((diagonal.norm() - 0.5 * 2f64.sqrt()).abs() < 1e-12, "{diagonal}");
        }

        let t =
            track(&RobotMotion::Helix(Helix { radius_m: 0.2, rise_m: 0.1, duration_s: 9.0, turns: 3.0, start_s: 0.0 }));
        assert!((t.at(9.0).position_m.z - 0.3 - 0.3).abs() < 1e-12);
    }

    #[test]
    fn a_right_hand_arc_goes_right() {
        let arc = RobotMotion::Arc(Arc { radius_m: 1.0, angle_deg: -90.0, duration_s: 1.0, start_s: 0.0 });
        let start = Pose { position_m: Vector3::zeros(), yaw_rad: 0.0 };
        let t = Track::new(start, &arc, None, &mut Stream::new(0, 0, Purpose::Walk));
        assert!((t.at(1.0).position_m - Vector3::new(1.0, -1.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn walks_keep_within_their_bounds_and_differ_by_seed() {
        let walk = RandomWalk { speed_m_s: 0.3, turning_deg_s: 90.0, within_m: 0.5, duration_s: 120.0, start_s: 0.0 };
        let start = Pose { position_m: Vector3::zeros(), yaw_rad: 0.0 };
        let of =
            |seed| Track::new(start, &RobotMotion::RandomWalk(walk), None, &mut Stream::new(seed, 0, Purpose::Walk));
        let (a, b) = (of(1), of(2));
        let mut furthest: f64 = 0.0;
        for i in 0..12_000 {
            furthest = furthest.max(a.at(f64::from(i) * 0.01).position_m.norm());
        }
        assert!(furthest > 0.2 && furthest < 0.5 + 0.3, "{furthest}");
        assert_ne!(a.at(60.0), b.at(60.0));
    }

    #[test]
    fn a_recorded_motion_strays_slowly_and_by_as_much_as_stated() {
        let rows =
            (0..=6_000).map(|k| (f64::from(k) * 0.01, Pose { position_m: Vector3::zeros(), yaw_rad: 0.5 })).collect();
        let table = Recorded::from_rows(rows);
        assert_eq!(table.clone().strayed(0.0, 6.0), table);
        let strayed = table.strayed(0.01, 6.0);
        let places: Vec<Vector3<f64>> = (0..6_000).map(|k| strayed.at(f64::from(k) * 0.01).position_m).collect();
        for axis in 0..2 {
            let rms = (places.iter().map(|p| p[axis].powi(2)).sum::<f64>() / 6_000.0).sqrt();
            assert!((0.0085..0.0115).contains(&rms), "{rms}");
        }
        let both = places.iter().map(|p| p.x * p.y).sum::<f64>() / 6_000.0;
        assert!(both.abs() < 3e-5, "x and y stray each for itself: {both}");
        let fastest = places.windows(2).map(|w| (w[1] - w[0]).norm() / 0.01).fold(0.0, f64::max);
        assert!(fastest < 0.09 && places.iter().all(|p| p.z == 0.0), "{fastest} m/s");
    }

    proptest! {
        /// No motion jumps: between two instants a robot goes no further than its top speed allows.
        #[test]
        fn motions_are_continuous(t in 0.0..14.0f64, dt in 0.0..0.05f64) {
            for motion in all() {
                let track = track(&motion);
                let step = (track.at(t + dt).position_m - track.at(t).position_m).norm();
                // The fastest of them is the helix: three turns of 0.2 m in 9 s, 0.43 m/s.
                prop_assert!(step <= 0.5 * dt + 1e-12, "{:?} moved {} m in {} s", motion, step, dt);
            }
        }
    }

    fn waiting() -> Way {
        let start = Pose { position_m: Vector3::new(5.0, 5.0, 0.0), yaw_rad: 1.0 };
        Way::new(start, &FollowedMotion { origin_m: [1.0, 2.0, 0.3], origin_yaw_deg: 90.0 })
    }

    fn pose(t_s: f64, x: f64) -> pose::Pose {
        pose::Pose { t_s, position_m: Vector3::new(x, 0.0, 0.0), heading_rad: Some(0.1) }
    }

    #[test]
    fn poses_are_reached_a_moment_after_they_came_in_the_rooms_frame() {
        let mut way = waiting();
        assert_eq!(way.at(0.0), (Pose { position_m: Vector3::new(5.0, 5.0, 0.0), yaw_rad: 1.0 }, 0));
        for k in 0..100 {
            let t_s = f64::from(k) * 0.02;
            way.hand_over(t_s, &[pose(1_000.0 + t_s, t_s)]);
        }
        // At 1 s the robot has the pose of 0.9 s; x of a frame turned by 90 degrees is y of the room.
        let (at, frame) = way.at(1.0);
        assert!((at.position_m - Vector3::new(1.0, 2.9, 0.3)).norm() < 1e-9 && frame == 1, "{at:?}");
        assert!((at.yaw_rad - FRAC_PI_2 - 0.1).abs() < 1e-12);
        // Between two poses it is on the way, and after the last one it waits.
        assert!((way.at(1.01).0.position_m.y - 2.91).abs() < 1e-9);
        assert!((way.at(99.0).0.position_m.y - 3.98).abs() < 1e-9);
        assert_eq!(way.counts, FollowedCounts { poses: 100, ..FollowedCounts::default() });
    }

    #[test]
    fn a_restarted_source_moves_the_robot_at_once() {
        let mut way = waiting();
        way.hand_over(0.0, &[pose(0.0, 0.0)]);
        way.hand_over(0.1, &[pose(0.1, 0.1)]);
        way.begin_frame();
        way.hand_over(0.2, &[pose(50.0, 8.0)]);
        assert!(way.at(0.299).0.position_m.y < 2.2 && way.at(0.299).1 == 1);
        assert!((way.at(0.3).0.position_m.y - 10.0).abs() < 1e-9 && way.at(0.3).1 == 2);
        assert_eq!((way.counts.new_frames, way.counts.clock_set), (1, 1));
    }

    #[test]
    fn a_reader_that_was_away_finds_the_newest_pose() {
        let mut way = waiting();
        way.hand_over(0.0, &[pose(0.0, 0.0)]);
        let burst: Vec<_> = (1..=25).map(|k| pose(f64::from(k) * 0.01, f64::from(k))).collect();
        way.hand_over(0.4, &burst);
        assert!((way.at(0.4).0.position_m.y - 2.0).abs() < 1e-9, "it waited until now");
        assert!((way.at(0.4 + AT_ONCE_S).0.position_m.y - 27.0).abs() < 1e-9);
        assert_eq!((way.counts.poses, way.counts.late), (2, 24));
    }

    #[test]
    fn an_hour_of_poses_takes_no_more_room_than_a_minute() {
        let mut way = waiting();
        for k in 0..180_000 {
            let t_s = f64::from(k) * 0.02;
            way.hand_over(t_s, &[pose(t_s, 0.0)]);
        }
        assert!(way.knots.len() < 3_100, "{}", way.knots.len());
        assert_eq!(way.at(0.0).0.position_m, Vector3::new(1.0, 2.0, 0.3), "what is forgotten was somewhere");
        assert_eq!(way.counts.poses, 180_000);
    }

    proptest! {
        /// Whatever arrives, the past stays the same.
        #[test]
        fn the_past_never_changes(
            steps in proptest::collection::vec((0.0..0.5_f64, -0.3..0.3_f64, -9.0..9.0_f64, 0_u8..20), 1..60)
        ) {
            let mut way = waiting();
            let (mut now_s, mut said) = (0.0, Vec::new());
            for (later_s, off_s, x, what) in steps {
                now_s += later_s;
                said.push((now_s, way.at(now_s)));
                if what == 0 {
                    way.begin_frame();
                } else {
                    way.hand_over(now_s, &[pose(now_s + off_s, x), pose(now_s + off_s + 0.01, x + 0.1)]);
                }
                for (t_s, before) in &said {
                    let (then, frame) = way.at(*t_s);
                    prop_assert!(frame == before.1 && (then.position_m - before.0.position_m).norm() < 1e-9);
                }
            }
        }
    }

    /// Poses at 20 Hz, of another frame from the 40th on; fails after the 80th.
    struct Scripted(u32);

    impl OdometrySource for Scripted {
        fn receive(&mut self, now: Instant) -> Result<NextPose, Error> {
            let due = Instant::from_us(i64::from(self.0) * 50_000 + 20_000);
            if due > now {
                return Ok(NextPose::Pending);
            }
            self.0 += 1;
            match self.0 {
                40 => Ok(NextPose::NewFrame),
                80.. => Err(Error::Backend("unplugged".into())),
                k => Ok(NextPose::Pose(pose(7e8 + due.as_s(), if k > 40 { 20.0 } else { due.as_s() }))),
            }
        }

        fn next_at(&self) -> Option<Instant> {
            None
        }

        fn counted(&self) -> Option<SourceCounts> {
            let (controller, unplugged) = (Default::default(), u64::from(self.0));
            Some(SourceCounts::Controller { controller, unplugged })
        }
    }

    #[test]
    fn a_rooms_odometry_gives_the_place_of_the_followed_robot() {
        let text = "duration_s = 10\n[[robot]]\nname = \"a\"\nposition_m = [3.0, 0.0, 0.0]\nmotion.followed = {}\n\
                    odometry = { rate_hz = 10 }\n[[robot]]\nname = \"b\"\n";
        let mut room = Room::new(&Scene::from_toml(text).unwrap()).unwrap();
        let wrong = room.follow(1, Box::new(Scripted(0))).unwrap_err().to_string();
        assert!(wrong.contains("`b`") && wrong.contains("followed"), "{wrong}");
        room.follow(0, Box::new(Scripted(0))).unwrap();
        assert!(room.follow(0, Box::new(Scripted(0))).is_err(), "one source is enough");
        let mut odometry = room.odometry(0).unwrap();
        let (mut poses, mut frames) = (Vec::new(), 0);
        for ms in 0..6_000 {
            let now = Instant::from_us(ms * 1_000);
            room.air().advance(now.as_us() * 1_000);
            match odometry.receive(now).unwrap() {
                NextPose::Pose(pose) => poses.push((ms, pose.position_m.x)),
                NextPose::NewFrame => frames += 1,
                NextPose::Pending => {}
                NextPose::End => panic!("the scene goes on"),
            }
        }
        // No pose before the first one arrives; then a tenth of a second behind; then in another frame.
        assert_eq!((poses[0].0, frames), (200, 1));
        let way = |ms: i64| (ms as f64 * 1e-3 - 0.1).min(1.92);
        assert!(poses.iter().all(|(ms, x)| *x == 20.0 || (x - way(*ms)).abs() < 1e-6), "{poses:?}");
        assert!(poses.iter().any(|(_, x)| *x == 20.0));
        assert_eq!(odometry.trouble().as_deref(), Some("unplugged"));
        let Some(SourceCounts::Followed { followed, source }) = odometry.counted() else { panic!("a followed robot") };
        let (controller, unplugged) = (Default::default(), 80);
        assert_eq!((*source.unwrap(), followed.poses), (SourceCounts::Controller { controller, unplugged }, 78));
    }

    #[test]
    fn a_scene_says_where_the_poses_frame_lies() {
        let scene = |more: &str| {
            Scene::from_toml(&format!("duration_s = 1\n[[robot]]\nname = \"a\"\nmotion.followed = {{ {more} }}\n"))
        };
        assert!(scene("origin_m = [1, 2, 3], origin_yaw_deg = 30").is_ok());
        let refused = scene("origin_yaw_deg = nan").unwrap_err();
        assert_eq!(refused.line(), Some(4));
    }
}
