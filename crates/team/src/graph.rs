//! The graph: robots, keyframes, and the measurements between them.

use crate::solve::Carried;
use nalgebra::{Rotation2, Vector2};
use serde::Serialize;
use std::f64::consts::TAU;

/// An outlier's range is uniform from 0 to this, metres (size of a building).
pub(crate) const SPAN_M: f64 = 30.0;

/// Below this range, metres, the lateral deviation of an azimuth stays what it is at this range: an azimuth is measured over a
/// motion, to an antenna at an unknown place on its robot, so the direction to a close robot changes quickly.
pub(crate) const NEAREST_M: f64 = 0.3;

/// A robot of a [`Team`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct RobotId(pub(crate) usize);

/// A keyframe of a robot; its pose is solved for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct KeyframeId(pub(crate) usize);

impl KeyframeId {
    /// Index into the lists of a [`crate::Solution`].
    #[must_use]
    pub fn index(self) -> usize {
        self.0
    }
}

/// A rejected measurement, or the reason why a team cannot be solved.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TeamError {
    /// A measurement, name or number that is refused, or a team without a keyframe: why.
    #[error("{0}")]
    Refused(String),
    /// A robot without a link to the others.
    #[error("{robot} has no link to the rest of the team, and no prior")]
    Unlinked {
        /// The robot.
        robot: String,
    },
    /// A robot whose pose the measurements do not determine.
    #[error(
        "the measurements do not determine {robot}: they need another robot, a range, a known place or a longer drive"
    )]
    Undetermined {
        /// The robot.
        robot: String,
    },
}

/// Noise of a robot's odometry, as standard deviations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OdometryNoise {
    /// Deviation of the heading after one metre, radians; it grows with the square root of the distance driven.
    pub turn_rad_per_rt_m: f64,
    /// Deviation of a step's end, as a share of the step's length.
    pub slip: f64,
    /// Deviation of the constant heading drift, radians per metre driven: one variable for each robot.
    pub bias_sd_rad_per_m: f64,
    /// Deviation of the constant scale error of lengths: one variable for each robot.
    pub scale_sd: f64,
}

impl Default for OdometryNoise {
    /// Wheel odometry: 1 degree of heading noise after one metre, 1 % slip, 1 degree per metre of bias, 2 % of scale.
    fn default() -> Self {
        let degree = 1f64.to_radians();
        Self { turn_rad_per_rt_m: degree, slip: 0.01, bias_sd_rad_per_m: degree, scale_sd: 0.02 }
    }
}

/// A candidate of a link: an azimuth, a range or both.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Mode {
    /// Azimuth relative to the yaw of the observing keyframe, and its deviation, radians.
    pub azimuth_rad: Option<[f64; 2]>,
    /// Range and its deviation, metres.
    pub range_m: Option<[f64; 2]>,
    /// Its weight among the candidates of the link, above 0; weights need not add up to 1.
    pub share: f64,
}

impl Mode {
    /// A candidate with an azimuth and its deviation, radians.
    #[must_use]
    pub fn azimuth(azimuth_rad: f64, sd_rad: f64, share: f64) -> Self {
        Self { azimuth_rad: Some([azimuth_rad, sd_rad]), range_m: None, share }
    }

    /// A candidate with a range and its deviation, metres.
    #[must_use]
    pub fn range(range_m: f64, sd_m: f64, share: f64) -> Self {
        Self { azimuth_rad: None, range_m: Some([range_m, sd_m]), share }
    }
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct Robot {
    pub name: String,
    /// False for a point: a transmitter that stands still.
    pub has_heading: bool,
    pub noise: OdometryNoise,
}

#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Keyframe {
    pub robot: usize,
    pub t_s: f64,
    /// Pose by the robot's odometry: x, y, yaw.
    pub odometry: [f64; 3],
    /// True once it is marginalised into [`Carried`].
    #[serde(skip)]
    pub is_past: bool,
}

#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Prior {
    pub keyframe: usize,
    pub pose: [f64; 3],
    /// Deviations; `None` for a free component.
    pub sd: [Option<f64>; 3],
}

/// Odometry between two successive keyframes of a robot.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Step {
    pub from: usize,
    pub to: usize,
    /// Motion in the frame of the first keyframe: forward and left in metres, turn in radians.
    pub motion: [f64; 3],
    pub driven_m: f64,
    /// Deviations of the end position, metres, and of the turn, radians.
    pub sd: [f64; 2],
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct Link {
    pub from: usize,
    pub to: usize,
    pub modes: Vec<Mode>,
    /// By candidate: the part of its cost that depends on neither poses nor outlier share.
    #[serde(skip)]
    pub constants: Vec<f64>,
    pub null_share: f64,
}

#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Change {
    /// The two keyframes of the first range.
    pub first: [usize; 2],
    /// The two keyframes of the second range.
    pub second: [usize; 2],
    pub change_m: f64,
    pub sd_m: f64,
}

/// Robots, their keyframes, and the measurements between them.
///
/// Call order: add robots, then each robot's keyframes in time order, then measurements between keyframes; then call
/// [`Team::solve`]. After more additions, [`Team::solve_from`] continues from the last solution.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Team {
    pub(crate) robots: Vec<Robot>,
    pub(crate) keyframes: Vec<Keyframe>,
    pub(crate) priors: Vec<Prior>,
    pub(crate) steps: Vec<Step>,
    pub(crate) links: Vec<Link>,
    pub(crate) changes: Vec<Change>,
    #[serde(skip)]
    pub(crate) carried: Option<Carried>,
}

type Checked<T = ()> = Result<T, TeamError>;

fn refused(why: impl Into<String>) -> TeamError {
    TeamError::Refused(why.into())
}

/// The team has no keyframe.
pub(crate) fn empty() -> TeamError {
    refused("the team has no keyframe")
}

fn finite(what: &str, value: f64) -> Checked {
    if value.is_finite() { Ok(()) } else { Err(refused(format!("{what} is {value}: it must be finite"))) }
}

fn positive(what: &str, value: f64) -> Checked {
    finite(what, value)?;
    if value > 0.0 { Ok(()) } else { Err(refused(format!("{what} is {value}: it must be above 0"))) }
}

fn no_link(robot: &str) -> TeamError {
    refused(format!(
        "{robot} cannot measure this: a link needs two robots, and a bearing needs the heading of the first"
    ))
}

impl Team {
    /// Adds a robot. A robot without a heading is a transmitter that stands still and measures no bearings.
    ///
    /// # Errors
    /// If the name is taken, or a deviation is not above 0.
    pub fn robot(&mut self, name: &str, has_heading: bool, noise: OdometryNoise) -> Checked<RobotId> {
        positive("the deviation of a turn", noise.turn_rad_per_rt_m)?;
        positive("slip", noise.slip)?;
        positive("the deviation of the heading's bias", noise.bias_sd_rad_per_m)?;
        positive("the deviation of the scale", noise.scale_sd)?;
        if self.robots.iter().any(|own| own.name == name) {
            return Err(refused(format!("two robots have the name {name}")));
        }
        self.robots.push(Robot { name: name.into(), has_heading, noise });
        Ok(RobotId(self.robots.len() - 1))
    }

    /// The robot of this name.
    ///
    /// # Errors
    /// If the team has no such robot.
    pub fn named(&self, name: &str) -> Checked<RobotId> {
        let found = self.robots.iter().position(|own| own.name == name);
        found.map(RobotId).ok_or_else(|| refused(format!("the team has no robot {name}")))
    }

    /// Adds a keyframe: its time, seconds; its pose by the robot's odometry (x, y, yaw); and the distance driven since the
    /// last keyframe, metres, raised to the straight-line distance if it is less.
    ///
    /// # Errors
    /// If a number is not finite, the time is not later than that of the robot's last keyframe, or the robot has no heading and
    /// already has a keyframe.
    pub fn keyframe(&mut self, robot: RobotId, t_s: f64, odometry: [f64; 3], driven_m: f64) -> Checked<KeyframeId> {
        let own = self.robots.get(robot.0);
        let own = own.ok_or_else(|| refused(format!("the team has no robot {}", robot.0)))?;
        finite("the time of a keyframe", t_s)?;
        odometry.into_iter().try_for_each(|value| finite("odometry", value))?;
        finite("the distance driven", driven_m)?;
        let id = self.keyframes.len();
        if let Some(last) = self.keyframes.iter().rposition(|keyframe| keyframe.robot == robot.0) {
            let before = self.keyframes[last];
            if !own.has_heading {
                let robot = &own.name;
                let why = format!("{robot} has no heading, so it stands still: it can have only one keyframe");
                return Err(refused(why));
            }
            if t_s <= before.t_s {
                let (robot, last_s) = (&own.name, before.t_s);
                let why = format!("{robot}: the keyframe at {t_s} s is not later than the last one, at {last_s} s");
                return Err(refused(why));
            }
            self.steps.push(step(last, id, before.odometry, odometry, driven_m, &own.noise));
        }
        self.keyframes.push(Keyframe { robot: robot.0, t_s, odometry, is_past: false });
        Ok(KeyframeId(id))
    }

    /// Adds a prior: x, y, yaw and their deviations. An infinite deviation leaves its component free.
    ///
    /// # Errors
    /// If a number is not finite or a deviation is not above 0.
    pub fn prior(&mut self, keyframe: KeyframeId, pose: [f64; 3], sd: [f64; 3]) -> Checked {
        self.check(keyframe)?;
        let known = |k: usize| -> Checked<Option<f64>> {
            if sd[k] == f64::INFINITY {
                return Ok(None);
            }
            finite("a prior", pose[k])?;
            positive("the deviation of a prior", sd[k])?;
            Ok(Some(sd[k]))
        };
        let sd = [known(0)?, known(1)?, known(2)?];
        self.priors.push(Prior { keyframe: keyframe.0, pose, sd });
        Ok(())
    }

    /// Adds a link: the candidates of the measurement from `from` to `to`, and the expected outlier share of such links.
    /// Returns its index in [`crate::Solution::chosen`].
    ///
    /// # Errors
    /// If a number is not finite, a deviation or range is not above 0, a share is not between 0 and 1, or the link has no
    /// candidate.
    pub fn link(&mut self, from: KeyframeId, to: KeyframeId, modes: &[Mode], null_share: f64) -> Checked<usize> {
        let (seeing, seen) = (self.check(from)?, self.check(to)?);
        let own = &self.robots[seeing];
        let is_bearing = modes.iter().any(|mode| mode.azimuth_rad.is_some());
        if seeing == seen || (is_bearing && !own.has_heading) {
            return Err(no_link(&own.name));
        }
        for mode in modes {
            if let Some([azimuth_rad, sd_rad]) = mode.azimuth_rad {
                finite("an azimuth", azimuth_rad)?;
                positive("the deviation of an azimuth", sd_rad)?;
            }
            if let Some([range_m, sd_m]) = mode.range_m {
                positive("a range", range_m)?;
                positive("the deviation of a range", sd_m)?;
            }
            positive("the share of a candidate", mode.share)?;
        }
        let is_empty = |mode: &Mode| mode.azimuth_rad.is_none() && mode.range_m.is_none();
        if modes.is_empty() || modes.iter().any(is_empty) {
            let (from, to) = (&own.name, &self.robots[seen].name);
            return Err(refused(format!(
                "the link from {from} to {to} has no candidate, or an empty one: give an azimuth, a range or both"
            )));
        }
        if !(null_share > 0.0 && null_share < 1.0) {
            return Err(refused(format!("the outlier share is {null_share}: it must be between 0 and 1")));
        }
        self.links.push(Link::new(from.0, to.0, modes, null_share));
        Ok(self.links.len() - 1)
    }

    /// Adds a range change: the distance between the keyframes `second` minus that between the keyframes `first`, and its
    /// deviation, metres.
    ///
    /// # Errors
    /// If a number is not finite, or the deviation is not above 0.
    pub fn range_change(
        &mut self,
        first: [KeyframeId; 2],
        second: [KeyframeId; 2],
        change_m: f64,
        sd_m: f64,
    ) -> Checked {
        for [a, b] in [first, second] {
            let (one, other) = (self.check(a)?, self.check(b)?);
            if one == other {
                return Err(no_link(&self.robots[one].name));
            }
        }
        finite("a range change", change_m)?;
        positive("the deviation of a range change", sd_m)?;
        let (first, second) = (first.map(|id| id.0), second.map(|id| id.0));
        self.changes.push(Change { first, second, change_m, sd_m });
        Ok(())
    }

    /// The robot of a keyframe that has not been marginalised.
    fn check(&self, id: KeyframeId) -> Checked<usize> {
        let own = self.keyframes.get(id.0).filter(|own| !own.is_past);
        own.map(|own| own.robot).ok_or_else(|| refused(format!("the team has no keyframe {}", id.0)))
    }

    /// Variables of a keyframe's pose: x, y and, with a heading, yaw.
    pub(crate) fn pose_size(&self, keyframe: usize) -> usize {
        if self.robots[self.keyframes[keyframe].robot].has_heading { 3 } else { 2 }
    }

    /// True for a robot with steps: it has a bias and a scale.
    pub(crate) fn is_moving(&self, robot: usize) -> bool {
        self.steps.iter().any(|step| self.keyframes[step.to].robot == robot)
            || self.carried.as_ref().is_some_and(|carried| carried.has_calibration(robot))
    }
}

/// The step between two poses of one robot's odometry.
fn step(from: usize, to: usize, a: [f64; 3], b: [f64; 3], driven_m: f64, noise: &OdometryNoise) -> Step {
    let moved = Rotation2::new(-a[2]) * Vector2::new(b[0] - a[0], b[1] - a[1]);
    let driven_m = driven_m.max(moved.norm());
    // At least 1 mm and 0.01 degrees, because a step of length 0 needs a deviation above 0.
    let sd = [(noise.slip * driven_m).hypot(1e-3), (noise.turn_rad_per_rt_m * driven_m.sqrt()).hypot(2e-4)];
    Step { from, to, motion: [moved.x, moved.y, crate::wrap(b[2] - a[2])], driven_m, sd }
}

impl Link {
    fn new(from: usize, to: usize, modes: &[Mode], null_share: f64) -> Self {
        let total: f64 = modes.iter().map(|mode| mode.share).sum();
        let part = |of: Option<[f64; 2]>, uniform: f64| of.map_or(0.0, |[_, sd]| (sd * TAU.sqrt() / uniform).ln());
        let constant = |own: &Mode| part(own.azimuth_rad, TAU) + part(own.range_m, SPAN_M) - (own.share / total).ln();
        Self { from, to, constants: modes.iter().map(constant).collect(), modes: modes.to_vec(), null_share }
    }

    /// The likeliest candidate if its ends have these poses, `None` for the null hypothesis; and its cost: the negative
    /// logarithm of its density over the outlier density. `temper` multiplies all deviations.
    pub fn best(&self, from: [f64; 3], to: [f64; 3], null_share: f64, temper: f64) -> (Option<usize>, f64) {
        let (x, y) = (to[0] - from[0], to[1] - from[1]);
        let (azimuth_rad, range_m) = (crate::wrap(y.atan2(x) - from[2]), x.hypot(y));
        let mut best = (None, -null_share.ln());
        let (by, near, right) = (1.0 / temper, nearness(range_m), -(1.0 - null_share).ln());
        // Below `NEAREST_M` the deviation is larger, so the density is lower. Otherwise a robot placed on another one would fit
        // every azimuth.
        let wider = if near < 1.0 { -near.ln() } else { 0.0 };
        for (k, (mode, constant)) in self.modes.iter().zip(&self.constants).enumerate() {
            let mut cost = right + constant;
            if let Some([azimuth, sd]) = mode.azimuth_rad {
                cost += wider + 0.5 * (crate::wrap(azimuth_rad - azimuth) * near * by / sd).powi(2);
            }
            if let Some([range, sd]) = mode.range_m {
                cost += 0.5 * ((range_m - range) * by / sd).powi(2);
            }
            if cost < best.1 {
                best = (Some(k), cost);
            }
        }
        best
    }
}

/// The range as a share of [`NEAREST_M`], at most 1: the deviation of an azimuth is divided by it.
pub(crate) fn nearness(range_m: f64) -> f64 {
    (range_m / NEAREST_M).clamp(1e-6, 1.0)
}
