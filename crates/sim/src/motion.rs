//! Motions of robots: pose as a function of true time.

use super::followed::{SharedWay, Way, lock};
use super::maths::{heading, rad, turned};
use super::random::Stream;
use super::recorded::Recorded;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

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
    #[must_use]
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
    FigureEight(FigureEight),
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

/// See [`RobotMotion::Circle`].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Circle {
    /// Radius, metres.
    pub radius_m: f64,
    /// Time for all turns, seconds.
    pub duration_s: f64,
    /// Number of turns; negative ones go to the right.
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

/// See [`RobotMotion::FigureEight`].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FigureEight {
    /// Radius of either circle, metres.
    pub radius_m: f64,
    /// Time for all figures, seconds.
    pub duration_s: f64,
    /// Number of figures.
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
    Still,
    Straight { length_m: f64 },
    Turning { radius_m: f64, angle_rad: f64, rise_m: f64 },
    Square { side_m: f64, turns: f64 },
    Eight { radius_m: f64, turns: f64 },
    Table(Recorded),
    Followed(SharedWay),
}

impl Track {
    /// Makes a motion ready. Random walks draw from `stream`; `recorded` is the file of a recorded one.
    #[must_use]
    pub fn new(start: Pose, motion: &RobotMotion, recorded: Option<Recorded>, stream: &mut Stream) -> Self {
        let (shape, start_s, duration_s) = match motion {
            RobotMotion::Static => (Shape::Still, 0.0, 0.0),
            RobotMotion::Line(m) => (Shape::Straight { length_m: m.length_m }, m.start_s, m.duration_s),
            RobotMotion::Circle(m) => (Shape::turning(m.radius_m, TAU * m.turns, 0.0), m.start_s, m.duration_s),
            RobotMotion::Arc(m) => (Shape::turning(m.radius_m, rad(m.angle_deg), 0.0), m.start_s, m.duration_s),
            RobotMotion::Helix(m) => {
                (Shape::turning(m.radius_m, TAU * m.turns, m.rise_m * m.turns.abs()), m.start_s, m.duration_s)
            }
            RobotMotion::Square(m) => (Shape::Square { side_m: m.side_m, turns: m.turns }, m.start_s, m.duration_s),
            RobotMotion::FigureEight(m) => {
                (Shape::Eight { radius_m: m.radius_m, turns: m.turns }, m.start_s, m.duration_s)
            }
            RobotMotion::RandomWalk(m) => (Shape::Table(walk(start, m, stream)), m.start_s, m.duration_s),
            RobotMotion::Waypoints(m) => {
                let table = legs(start, m);
                let duration_s = table.duration_s();
                (Shape::Table(table), m.start_s, duration_s)
            }
            RobotMotion::Recorded(m) => recorded.map_or((Shape::Still, 0.0, 0.0), |table| {
                let table = table.strayed(m.stray_m, m.stray_s);
                let duration_s = table.duration_s();
                (Shape::Table(table), m.start_s, duration_s)
            }),
            RobotMotion::Followed(m) => {
                (Shape::Followed(std::sync::Arc::new(std::sync::Mutex::new(Way::new(start, m)))), 0.0, 0.0)
            }
        };
        Self { start, shape, start_s, duration_s }
    }

    /// True if the robot never moves.
    #[must_use]
    pub fn is_still(&self) -> bool {
        matches!(self.shape, Shape::Still)
    }

    /// The way of a followed robot.
    #[must_use]
    pub fn way(&self) -> Option<&SharedWay> {
        match &self.shape {
            Shape::Followed(way) => Some(way),
            _ => None,
        }
    }

    /// The pose at true time `t_s`, seconds since the scene began.
    #[must_use]
    pub fn at(&self, t_s: f64) -> Pose {
        let moved_s = (t_s - self.start_s).clamp(0.0, self.duration_s);
        let part = if self.duration_s > 0.0 { moved_s / self.duration_s } else { 0.0 };
        match &self.shape {
            Shape::Still => self.start,
            Shape::Straight { length_m } => Pose {
                position_m: self.start.position_m + heading(self.start.yaw_rad) * (length_m * part),
                ..self.start
            },
            Shape::Turning { radius_m, angle_rad, rise_m } => {
                let mut pose = turn(self.start, *radius_m, angle_rad * part);
                pose.position_m.z += rise_m * part;
                pose
            }
            Shape::Square { side_m, turns } => round_the_square(self.start, *side_m, turns * part),
            Shape::Eight { radius_m, turns } => {
                let figure = turns * part;
                let angle = 2.0 * TAU * (figure - figure.floor());
                // The second circle is the first one's mirror: it begins and ends where the first does.
                let signed = if angle < TAU { angle } else { TAU - angle };
                turn(self.start, *radius_m, signed)
            }
            Shape::Table(table) => table.at(moved_s),
            Shape::Followed(way) => lock(way).at(t_s).0,
        }
    }
}

impl Shape {
    fn turning(radius_m: f64, angle_rad: f64, rise_m: f64) -> Self {
        Self::Turning { radius_m, angle_rad, rise_m }
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

#[cfg(test)]
#[path = "motion_tests.rs"]
mod tests;
