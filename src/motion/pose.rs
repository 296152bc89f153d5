//! Poses, trajectories, interpolation, the stretch of a trajectory in which the robot moved, and what rolling wheels say of it.
//!
//! Frame: the trajectory file's own, metres, right-handed; azimuth and heading from +x towards +y.
//!
//! The middle between two wheels on one axle moves along the robot's heading: wheels roll, they do not slip sideways. A
//! camera's positions drift in every direction, and phases do not show a path that is turned as a whole, nor one that bends
//! slowly. The heading of its gyroscope drifts less. So of each step of its positions only the part along the heading is kept
//! ([`Trajectory::of_antenna`]).

use crate::maths::{lower_rank, unwrap_rad, upper_median, wrap_rad};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};

/// A clock was set back where a path in the order of time is longer by this factor than as it was given (up to 1.01
/// in the three shared recordings that have a step back).
const TWO_PLACES: f64 = 1.1;

/// Poses further apart than this, or than ten usual steps, leave a gap, seconds.
const MIN_GAP_S: f64 = 0.25;

/// A robot that moved less across a gap stood still, metres (several times the noise of motion capture at rest).
const STILL_M: f64 = 0.005;

/// A robot slower than this share of its usual speed stands still.
const STILL_SHARE: f64 = 0.15;

/// No robot drives slower, m/s (motion capture at rest seems to move by less).
const STILL_M_PER_S: f64 = 0.004;

/// Half the time over which speed is judged, seconds.
const SPEED_HALF_S: f64 = 0.1;

/// From one pose to the next no robot gets further than this, metres, faster than this, m/s. (Steps of 71 recordings: up to 5 cm.)
const JUMP_M: f64 = 0.5;
const JUMP_M_PER_S: f64 = 30.0;

/// A robot that got less than this share of its way across a gap did not drive for so long: its clock was set on.
const NO_WAY: f64 = 0.2;

/// Where a robot was, and which way it looked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Seconds on the trajectory's clock (Unix time in recorded files).
    pub t_s: f64,
    /// Position, metres.
    pub position_m: Vector3<f64>,
    /// Heading (yaw) about +z, radians, where the source gives one.
    pub heading_rad: Option<f64>,
}

impl Pose {
    /// The pose of something on the robot: moved by `offset_m` (robot frame: x forward, y left, z up), turned with the
    /// heading.
    ///
    /// # Errors
    /// If there is no heading and the offset is not along z, or if it is further than 3 m.
    pub fn mounted(self, offset_m: Vector3<f64>) -> Result<Self, TrajectoryError> {
        if offset_m.norm() > FURTHEST_M {
            return Err(TrajectoryError::OffRobot { offset_m: offset_m.norm() });
        }
        let (sin, cos) = match self.heading_rad {
            Some(heading) => heading.sin_cos(),
            None if offset_m.x != 0.0 || offset_m.y != 0.0 => return Err(TrajectoryError::NoHeading),
            None => (0.0, 1.0),
        };
        let turned = Vector3::new(cos * offset_m.x - sin * offset_m.y, sin * offset_m.x + cos * offset_m.y, offset_m.z);
        Ok(Self { position_m: self.position_m + turned, ..self })
    }
}

/// Nothing on a robot is further from its middle than this, metres: such offsets are centimetres.
const FURTHEST_M: f64 = 3.0;

/// A hole in a trajectory wide enough that nothing should be interpolated across it.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Gap {
    /// Seconds of the last pose before it.
    pub from_s: f64,
    /// Seconds of the first pose after it.
    pub to_s: f64,
    /// How far the robot got meanwhile, metres.
    pub moved_m: f64,
}

/// Poses that a trajectory was given and does not use.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub(crate) struct LeftOut {
    /// Poses at the start that were from before the run.
    pub stale: usize,
    /// Poses at a time that a later one has too, which is elsewhere.
    pub same_time: usize,
    /// How many poses are of other parts than the longest between steps of a clock that was set back, and the largest of these
    /// steps, seconds: with all of them the robot would be in two places at once.
    pub set_back: Option<(usize, f64)>,
    /// Largest step back of the times as they were given, seconds.
    pub back_s: f64,
}

/// The kind of sensor of a trajectory, if certain; it determines the deviation of the heading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub(crate) enum TrajectoryKind {
    /// Neither the file nor its name shows it.
    #[default]
    Unknown,
    /// Cameras of a room.
    MotionCapture,
    /// A tracking camera on the robot.
    Camera,
    /// The same, of which only rolling motion was kept.
    RollingCamera,
    /// The robot's wheels; where the antenna is on the robot is not known.
    Wheels,
    /// The same, where it is known: the path is the antenna's.
    MountedWheels,
}

impl TrajectoryKind {
    /// By the words of headings, of the names of frames or of a file, where they name a sensor. `odom` names none, but in ROS, where
    /// it is the parent of the robot's frame ([`Self::of_frames`]).
    #[must_use]
    pub(super) fn of_words(text: &str) -> Self {
        let text = text.to_lowercase();
        let has =
            |names: &[&str]| text.split(|letter: char| !letter.is_alphanumeric()).any(|word| names.contains(&word));
        match () {
            () if has(&["t265", "camera", "vio", "zed", "realsense"]) => Self::Camera,
            () if has(&["wheel", "wheels", "encoder", "encoders"]) => Self::Wheels,
            () if has(&["mocap", "vicon", "optitrack", "vrpn", "qualisys"]) => Self::MotionCapture,
            () => Self::Unknown,
        }
    }

    /// By the frames of ROS, parent and child: those of `nav_msgs/Odometry` and of `/tf`.
    #[must_use]
    pub(super) fn of_frames(frames: &str) -> Self {
        let is_odometry = |(parent, child): (&str, &str)| parent.ends_with("odom") && !child.is_empty();
        match Self::of_words(frames) {
            Self::Unknown if frames.split_once(" -> ").is_some_and(is_odometry) => Self::Wheels,
            kind => kind,
        }
    }
}

/// Poses in the order of time, at least two.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    poses: Vec<Pose>,
    max_gap_s: f64,
    left_out: LeftOut,
    kind: TrajectoryKind,
    /// What times were rounded to, seconds, and by how much the path turns meanwhile, radians.
    rounded: Option<(f64, f64)>,
    /// The attitude of each pose in three dimensions, where the source gives it for all of them.
    attitudes: Option<Vec<UnitQuaternion<f64>>>,
}

/// The attitude of a robot that stands upright, where its heading is known.
fn upright(pose: &Pose) -> Option<UnitQuaternion<f64>> {
    pose.heading_rad.map(|heading_rad| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad))
}

/// Why poses make no trajectory.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// Interpolation needs two poses at different times.
    #[error(
        "{poses} usable poses make no trajectory: at least 2 at different times are needed (times are written with too few digits?)"
    )]
    TooFew {
        /// Usable poses.
        poses: usize,
    },
    /// Times are rounded so much that the direction of the path is lost.
    #[error(
        "times are rounded to {step_s} s, within which the path turns by {turn_deg:.0} degrees: write them with more digits \
         (nanoseconds, or %.6f)"
    )]
    TooCoarse {
        /// What times are rounded to, seconds.
        step_s: f64,
        /// By how much the path turns from one step to the next, degrees.
        turn_deg: f64,
    },
    /// An offset on the robot can only be turned with its heading, and wheels roll along it.
    #[error(
        "an offset on the robot needs its heading, and this trajectory has none (5 columns); use one with yaw or quaternion"
    )]
    NoHeading,
    /// An offset that leads off the robot.
    #[error("an offset of {offset_m:.1} m is off the robot: offsets are metres (4.6 cm are 0.046), 3 at most")]
    OffRobot {
        /// Its length, metres.
        offset_m: f64,
    },
    /// A pose with a position, time or heading that is not a number.
    #[error("pose {index} is not finite")]
    NotFinite {
        /// Its place in the list.
        index: usize,
    },
}

fn is_in_order(poses: &[Pose]) -> bool {
    poses.is_sorted_by(|a, b| a.t_s.total_cmp(&b.t_s).is_le())
}

fn length_m<'a>(poses: impl Iterator<Item = &'a Pose> + Clone) -> f64 {
    poses.clone().zip(poses.skip(1)).map(|(a, b)| (b.position_m - a.position_m).norm()).sum()
}

/// Puts poses in the order of time. If that sends the robot to and fro between two places, its clock was set back: then the
/// longest part between steps back stays. Gives how many poses that leaves out, and the largest step, seconds.
fn in_order(poses: &mut Vec<Pose>) -> Option<(usize, f64)> {
    let by_time = |a: &Pose, b: &Pose| a.t_s.total_cmp(&b.t_s);
    let mut sorted = poses.clone();
    sorted.sort_by(by_time);
    if length_m(sorted.iter()) <= TWO_PLACES * length_m(poses.iter()) {
        *poses = sorted;
        return None;
    }
    let mut steps: Vec<f64> = poses.windows(2).map(|w| w[1].t_s - w[0].t_s).filter(|step| *step > 0.0).collect();
    let usual_s = upper_median(&mut steps).unwrap_or(0.0);
    // Poses that overtook each other are about their place; a clock that was set goes by more.
    let back = |w: &[Pose]| Some(w[0].t_s - w[1].t_s).filter(|back_s| *back_s > 10.0 * usual_s);
    let ends = poses.windows(2).enumerate().filter_map(|(k, w)| back(w).map(|_| k + 1)).chain([poses.len()]);
    let parts = ends.scan(0, |begin, end| Some(std::mem::replace(begin, end)..end));
    let longest = parts.max_by_key(ExactSizeIterator::len).unwrap_or(0..poses.len());
    let most_s = poses.windows(2).filter_map(back).fold(0.0, f64::max);
    let left_out = poses.len() - longest.len();
    poses.truncate(longest.end);
    poses.drain(..longest.start);
    poses.sort_by(by_time);
    (left_out > 0).then_some((left_out, most_s))
}

/// Of rounded times there are this many poses to each at least, on average.
const ROUNDED: f64 = 1.5;
/// A path that turns by more than this within a step of rounded times has no direction, radians.
const COARSE_RAD: f64 = std::f64::consts::FRAC_PI_4;

/// Poses of one time are spread over the step that times were rounded to, where they are a path and not two. Gives that step,
/// seconds, and by how much the path turns meanwhile, radians.
///
/// Times that are cut off are early by up to a step, rounded ones early or late by half of it. Neither is known, so the poses of
/// one time are put about a quarter of the step behind it, which is a quarter off at most.
fn spread(poses: &mut [Pose]) -> Result<Option<(f64, f64)>, TrajectoryError> {
    let groups = || poses.chunk_by(|a, b| a.t_s == b.t_s);
    let count = groups().count();
    let moved = groups().any(|group| group.first() != group.last());
    if !moved || count < 2 || (poses.len() as f64) < ROUNDED * count as f64 {
        return Ok(None);
    }
    let last: Vec<Pose> = groups().filter_map(|group| group.last().copied()).collect();
    // Two paths in one file go to and fro by more than either goes on.
    let median_m = |pairs: &mut dyn Iterator<Item = &[Pose]>| {
        let mut moved: Vec<f64> = pairs.map(|w| (w[1].position_m - w[0].position_m).norm()).collect();
        upper_median(&mut moved).unwrap_or(0.0)
    };
    let to_and_fro_m = median_m(&mut groups().flat_map(|group| group.windows(2)));
    if to_and_fro_m > median_m(&mut last.windows(2)) + STILL_M {
        return Ok(None);
    }
    let mut steps: Vec<f64> = last.windows(2).map(|w| w[1].t_s - w[0].t_s).collect();
    let step_s = upper_median(&mut steps).unwrap_or(0.0);
    if ![poses[0].t_s - step_s, poses[poses.len() - 1].t_s + step_s].iter().all(|t_s| t_s.is_finite()) {
        return Ok(None);
    }
    let mut sizes: Vec<f64> = groups().map(|group| group.len() as f64).collect();
    let usual = upper_median(&mut sizes).unwrap_or(1.0);
    let mut turns: Vec<f64> = last.windows(3).filter_map(turn_rad).collect();
    let turn_rad = upper_median(&mut turns).unwrap_or(0.0);
    if turn_rad > COARSE_RAD {
        return Err(TrajectoryError::TooCoarse { step_s, turn_deg: turn_rad.to_degrees() });
    }
    let times: Vec<f64> = last.iter().map(|pose| pose.t_s).collect();
    for (k, group) in poses.chunk_by_mut(|a, b| a.t_s == b.t_s).enumerate() {
        let n = group.len() as f64;
        let room_s = times.get(k + 1).map_or(step_s, |next| step_s.min(next - times[k]));
        // The first step is begun late and the last one ended early.
        let from = if k == 0 { (usual - n).max(0.0) } else { 0.0 };
        let each_s = room_s / if k == 0 || k + 1 == count { n.max(usual) } else { n };
        for (j, pose) in group.iter_mut().enumerate() {
            pose.t_s += (from + j as f64 + 0.5) * each_s;
            pose.t_s -= 0.25 * step_s;
        }
    }
    Ok(Some((step_s, turn_rad)))
}

/// By how much a path turns at the middle one of three poses, if it moves.
fn turn_rad(poses: &[Pose]) -> Option<f64> {
    let (before, after) = (poses[1].position_m - poses[0].position_m, poses[2].position_m - poses[1].position_m);
    (before.norm().min(after.norm()) > STILL_M).then(|| before.angle(&after))
}

/// Poses on either side of where even ones would put a time that are looked at first.
const NEAR: usize = 8;

impl Trajectory {
    /// A trajectory from poses in any order; of several at one time the last stays. Where times go back although the robot does
    /// not, so that it would be in two places at once (a clock that was set), the longest part between two such steps stays.
    ///
    /// # Errors
    /// Fewer than two distinct times, or a value that is not finite.
    pub fn new(mut poses: Vec<Pose>) -> Result<Self, TrajectoryError> {
        for (index, pose) in poses.iter().enumerate() {
            let finite = pose.t_s.is_finite() && pose.position_m.iter().all(|x| x.is_finite());
            if !finite || pose.heading_rad.is_some_and(|h| !h.is_finite()) {
                return Err(TrajectoryError::NotFinite { index });
            }
        }
        let mut left_out = LeftOut::default();
        // Sorting takes half as much memory again; files are in order.
        if !is_in_order(&poses) {
            left_out.back_s = poses.windows(2).map(|w| w[0].t_s - w[1].t_s).fold(0.0, f64::max);
            left_out.set_back = in_order(&mut poses);
        }
        let rounded = spread(&mut poses)?;
        poses.dedup_by(|later, earlier| {
            let same = later.t_s == earlier.t_s;
            if same {
                left_out.same_time += usize::from(later != earlier);
                *earlier = *later;
            }
            same
        });
        if poses.len() < 2 {
            return Err(TrajectoryError::TooFew { poses: poses.len() });
        }
        let mut steps: Vec<f64> = poses.windows(2).map(|w| w[1].t_s - w[0].t_s).collect();
        let usual = upper_median(&mut steps).unwrap_or(0.0);
        let max_gap_s = MIN_GAP_S.max(10.0 * usual);
        let kind = TrajectoryKind::Unknown;
        let mut trajectory = Self { poses, max_gap_s, left_out, kind, rounded, attitudes: None };
        trajectory.drop_stale_head();
        Ok(trajectory)
    }

    /// Logs often begin with a few poses from long before the run (a latched topic), then a gap of seconds. Where the
    /// robot is elsewhere after it, they belong to something else.
    fn drop_stale_head(&mut self) {
        let head = self.poses.len() / 20;
        let gap = (1..=head).rev().find(|&k| self.poses[k].t_s - self.poses[k - 1].t_s > 1.0);
        if let Some(k) = gap
            && (self.poses[k].position_m - self.poses[k - 1].position_m).norm() > STILL_M
            && self.poses.len() - k >= 2
        {
            self.poses.drain(..k);
            self.left_out.stale = k;
        }
    }

    /// The poses, in the order of time.
    #[must_use]
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// What it was given and does not use.
    #[must_use]
    pub(crate) fn left_out(&self) -> LeftOut {
        self.left_out
    }

    /// What kind of sensor it is of.
    #[must_use]
    pub(crate) fn kind(&self) -> TrajectoryKind {
        self.kind
    }

    /// A name for the frame of these poses by which readers of recordings recognise the sensor.
    #[must_use]
    pub fn frame(&self) -> &'static str {
        match self.kind {
            TrajectoryKind::Unknown => "odom",
            TrajectoryKind::MotionCapture => "mocap",
            TrajectoryKind::Camera | TrajectoryKind::RollingCamera => "camera_odom",
            TrajectoryKind::Wheels | TrajectoryKind::MountedWheels => "wheel_odom",
        }
    }

    /// As of a sensor of this kind.
    #[must_use]
    pub(crate) fn with_kind(mut self, kind: TrajectoryKind) -> Self {
        self.kind = kind;
        self
    }

    /// With the attitudes of the poses that are not upright, by their times, seconds; the others have their heading's. They are
    /// skipped where times were rounded, or a clock was set back.
    pub(super) fn with_attitudes(mut self, mut tilted: Vec<(f64, UnitQuaternion<f64>)>) -> Self {
        if tilted.is_empty() || self.rounded.is_some() || self.left_out.set_back.is_some() {
            return self;
        }
        tilted.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Of several at one time the last stays, as of poses.
        let of = |pose: &Pose| {
            let after = tilted.partition_point(|(t_s, _)| *t_s <= pose.t_s);
            let own = after.checked_sub(1).and_then(|k| tilted.get(k)).filter(|(t_s, _)| *t_s == pose.t_s);
            own.map_or_else(|| upright(pose), |(_, attitude)| Some(*attitude))
        };
        self.attitudes = self.poses.iter().map(of).collect();
        self
    }

    /// The path of an arm's end about its foot: `arm_m` (robot frame: x forward, y left, z up) turned by the attitude at each
    /// pose, wherever the robot is. In three dimensions where the source gives attitudes, else about +z by the heading.
    ///
    /// # Errors
    /// [`TrajectoryError::NoHeading`] where a pose has neither.
    pub(crate) fn of_arm(&self, arm_m: Vector3<f64>) -> Result<Self, TrajectoryError> {
        let turned = |(k, pose): (usize, &Pose)| {
            let known = self.attitudes.as_ref().and_then(|all| all.get(k).copied());
            let attitude = known.or_else(|| upright(pose)).ok_or(TrajectoryError::NoHeading)?;
            Ok(Pose { position_m: attitude * arm_m, ..*pose })
        };
        let poses = self.poses.iter().enumerate().map(turned).collect::<Result<Vec<_>, TrajectoryError>>()?;
        Ok(Self { poses, attitudes: None, ..self.clone() })
    }

    /// With the sensor and the times of another one.
    fn of_same(mut self, other: &Self) -> Self {
        (self.kind, self.rounded) = (other.kind, other.rounded);
        self
    }

    /// What the times that it was given are rounded to, seconds, where several poses had one time.
    #[doc(hidden)] // for the crates of this workspace
    #[must_use]
    pub fn time_step_s(&self) -> Option<f64> {
        self.rounded.map(|(step_s, _)| step_s)
    }

    /// By how much its path turns, in the median, within [`Self::time_step_s`], radians; 0 where times are not rounded.
    #[must_use]
    pub(crate) fn turn_in_step_rad(&self) -> f64 {
        self.rounded.map_or(0.0, |(_, turn_rad)| turn_rad)
    }

    /// Standard deviation of every azimuth that rounded times leave, radians: poses may be early or late by half a step, all by
    /// the same, and the path turns meanwhile. It adds to that of the heading.
    #[must_use]
    pub(crate) fn rounding_sd_rad(&self) -> f64 {
        self.turn_in_step_rad() / 12f64.sqrt()
    }

    /// First and last time, seconds.
    #[must_use]
    pub fn span_s(&self) -> (f64, f64) {
        (self.poses[0].t_s, self.poses[self.poses.len() - 1].t_s)
    }

    /// Its poses from `from_s` to `to_s`, both included, seconds: of the same sensor, with the same gaps and times.
    ///
    /// # Errors
    /// [`TrajectoryError::TooFew`] if fewer than two poses are left.
    pub fn within(&self, from_s: f64, to_s: f64) -> Result<Self, TrajectoryError> {
        let from = self.poses.partition_point(|pose| pose.t_s < from_s);
        let to = self.poses.partition_point(|pose| pose.t_s <= to_s).max(from);
        if to - from < 2 {
            return Err(TrajectoryError::TooFew { poses: to - from });
        }
        let attitudes = self.attitudes.as_ref().map(|all| all[from..to].to_vec());
        let left_out = LeftOut::default();
        Ok(Self { poses: self.poses[from..to].to_vec(), attitudes, left_out, ..*self })
    }

    /// The gaps that nothing is interpolated across unless the robot stood still.
    #[must_use]
    pub fn gaps(&self) -> Vec<Gap> {
        let wide = self.poses.windows(2).filter(|w| w[1].t_s - w[0].t_s > self.max_gap_s);
        wide.map(|w| Gap { from_s: w[0].t_s, to_s: w[1].t_s, moved_m: (w[1].position_m - w[0].position_m).norm() })
            .collect()
    }

    /// Steps from one pose to the next that no robot makes: how many, and the furthest, metres.
    #[must_use]
    pub(crate) fn jumps(&self) -> (usize, f64) {
        let step = |w: &[Pose]| ((w[1].position_m - w[0].position_m).norm(), w[1].t_s - w[0].t_s);
        let is_jump = |(moved_m, took_s): &(f64, f64)| *moved_m > JUMP_M.max(JUMP_M_PER_S * took_s);
        let jumps = self.poses.windows(2).map(step).filter(is_jump);
        jumps.fold((0, 0.0), |(count, furthest_m), (moved_m, _)| (count + 1, moved_m.max(furthest_m)))
    }

    /// Largest step back of the times as they were given, seconds.
    pub(crate) fn back_s(&self) -> f64 {
        self.left_out.back_s
    }

    /// Gaps before and after which the robot drives at its usual speed, and in which it gets nowhere: its clock was set on.
    pub(crate) fn set_on(&self) -> Vec<Gap> {
        let mut gaps = self.gaps();
        if gaps.is_empty() {
            return gaps;
        }
        let usual_m_per_s = self.motion().floor_m_per_s / STILL_SHARE;
        let speed = |from: &Pose, to: &Pose| (to.position_m - from.position_m).norm() / (to.t_s - from.t_s);
        let drives_on = |gap: &Gap| {
            let next = self.poses.partition_point(|pose| pose.t_s <= gap.from_s);
            let begin = self.poses.partition_point(|pose| pose.t_s < gap.from_s - 2.0 * SPEED_HALF_S);
            let end = self.poses.partition_point(|pose| pose.t_s <= gap.to_s + 2.0 * SPEED_HALF_S).max(next + 2);
            let before = begin.min(next.checked_sub(2)?);
            let before_m_per_s = speed(self.poses.get(before)?, self.poses.get(next - 1)?);
            let slower = before_m_per_s.min(speed(self.poses.get(next)?, self.poses.get(end - 1)?));
            Some(2.0 * slower > usual_m_per_s && gap.moved_m < NO_WAY * slower * (gap.to_s - gap.from_s))
        };
        gaps.retain(|gap| drives_on(gap).unwrap_or(false));
        gaps
    }

    /// The pose at `t_s`, linear in position and along the shorter arc in heading. `None` outside the trajectory and
    /// in a gap during which the robot moved.
    #[must_use]
    pub fn at(&self, t_s: f64) -> Option<Pose> {
        let (a, b, share) = self.between(t_s)?;
        let heading_rad = match (a.heading_rad, b.heading_rad) {
            (Some(from), Some(to)) => Some(wrap_rad(from + share * wrap_rad(to - from))),
            _ => None,
        };
        Some(Pose { t_s, position_m: a.position_m + (b.position_m - a.position_m) * share, heading_rad })
    }

    /// The position at `t_s`, where [`Trajectory::at`] has a pose.
    fn position_m(&self, t_s: f64) -> Option<Vector3<f64>> {
        let (a, b, share) = self.between(t_s)?;
        Some(a.position_m + (b.position_m - a.position_m) * share)
    }

    /// The poses about `t_s`, and how far it is from the first to the second as a share of the way.
    fn between(&self, t_s: f64) -> Option<(&Pose, &Pose, f64)> {
        let after = self.after(t_s);
        if after == 0 || after == self.poses.len() {
            let last = self.poses.last().filter(|last| last.t_s == t_s)?;
            return Some((last, last, 0.0));
        }
        let (a, b) = (&self.poses[after - 1], &self.poses[after]);
        if b.t_s - a.t_s > self.max_gap_s && (b.position_m - a.position_m).norm() > STILL_M {
            return None;
        }
        Some((a, b, (t_s - a.t_s) / (b.t_s - a.t_s)))
    }

    /// How many poses are not after `t_s`. They come nearly evenly, so it is near the place that even ones would have.
    fn after(&self, t_s: f64) -> usize {
        let n = self.poses.len();
        let (start, end) = self.span_s();
        let even = ((t_s - start) / (end - start) * (n - 1) as f64) as usize;
        let (from, to) = (even.saturating_sub(NEAR).min(n - 1), even.saturating_add(NEAR).min(n - 1));
        if self.poses[from].t_s <= t_s && t_s < self.poses[to].t_s {
            return from + self.poses[from..to].partition_point(|pose| pose.t_s <= t_s);
        }
        self.poses.partition_point(|pose| pose.t_s <= t_s)
    }

    /// The antenna's trajectory: each position moved by `offset_m` (robot frame: x forward, y left, z up), turned with
    /// the heading.
    ///
    /// # Errors
    /// If a pose has no heading and the offset is not along z.
    pub fn with_antenna_offset(&self, offset_m: Vector3<f64>) -> Result<Self, TrajectoryError> {
        let mut moved = self.clone();
        for pose in &mut moved.poses {
            *pose = pose.mounted(offset_m)?;
        }
        if moved.kind == TrajectoryKind::Wheels {
            moved.kind = TrajectoryKind::MountedWheels;
        }
        Ok(moved)
    }

    /// The antenna's trajectory if lengths are `1 + scale` times the reported ones, angles `1 + turn` times, and the antenna is at
    /// `offset_m` (robot frame: x forward, y left, z up). It begins as reported.
    ///
    /// # Errors
    /// [`TrajectoryError::NoHeading`] if a pose has no heading.
    pub(crate) fn with_errors(&self, scale: f64, turn: f64, offset_m: Vector3<f64>) -> Result<Self, TrajectoryError> {
        let headings: Option<Vec<f64>> = self.poses.iter().map(|pose| pose.heading_rad).collect();
        let headings = unwrap_rad(&headings.ok_or(TrajectoryError::NoHeading)?);
        let (mut moved, mut at_m) = (self.clone(), self.poses[0].position_m);
        for (k, pose) in moved.poses.iter_mut().enumerate() {
            if let Some(before) = k.checked_sub(1) {
                let middle = 0.5 * (headings[before] + headings[k]);
                let turned = Rotation3::from_axis_angle(&Vector3::z_axis(), turn * (middle - headings[0]));
                let step_m = turned * (self.poses[k].position_m - self.poses[before].position_m);
                at_m += Vector3::new((1.0 + scale) * step_m.x, (1.0 + scale) * step_m.y, step_m.z);
            }
            let heading_rad = Some(wrap_rad(headings[k] + turn * (headings[k] - headings[0])));
            *pose = Pose { position_m: at_m, heading_rad, ..*pose }.mounted(offset_m)?;
        }
        Ok(moved)
    }

    /// When the robot moved: relative to its own usual speed, so that slow and fast robots need no threshold.
    #[must_use]
    pub fn motion(&self) -> Motion {
        let speeds: Vec<f64> = self.poses.iter().map(|pose| self.speed_m_per_s(pose.t_s)).collect();
        let mut sorted = speeds.clone();
        sorted.sort_by(f64::total_cmp);
        let usual = lower_rank(&sorted, 0.9).unwrap_or(0.0);
        let floor = (STILL_SHARE * usual).max(STILL_M_PER_S);
        let moving = |k: &usize| speeds[*k] > floor;
        let first = (0..speeds.len()).find(moving);
        let last = (0..speeds.len()).rev().find(moving);
        match (first, last) {
            (Some(first), Some(last)) if first < last => {
                Motion { window_s: Some((self.poses[first].t_s, self.poses[last].t_s)), floor_m_per_s: floor }
            }
            _ => Motion { window_s: None, floor_m_per_s: floor },
        }
    }

    /// Speed about `t_s` over a fifth of a second, m/s; 0 where the trajectory has no poses.
    #[must_use]
    fn speed_m_per_s(&self, t_s: f64) -> f64 {
        let (start, end) = self.span_s();
        let (from, to) = ((t_s - SPEED_HALF_S).max(start), (t_s + SPEED_HALF_S).min(end));
        match (self.position_m(from), self.position_m(to)) {
            (Some(a), Some(b)) if to > from => (b - a).norm() / (to - from),
            _ => 0.0,
        }
    }

    /// True if the robot moved at `t_s`; `motion` is [`Self::motion`].
    pub(crate) fn moves(&self, motion: &Motion, t_s: f64) -> bool {
        let inside = motion.window_s.is_some_and(|(from, to)| (from..=to).contains(&t_s));
        inside && self.speed_m_per_s(t_s) > motion.floor_m_per_s
    }
}

/// The stretch of a trajectory in which its robot moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// From the first to the last pose in motion, seconds; `None` if it never moved.
    pub window_s: Option<(f64, f64)>,
    /// Speed below which the robot counts as standing, m/s.
    pub floor_m_per_s: f64,
}

/// Where a sensor of poses is on its robot, and which way it looks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mount {
    /// The sensor seen from the middle between the wheels, metres: forward, left, up.
    pub offset_m: Vector3<f64>,
    /// Its heading less the robot's, radians, counter-clockwise.
    pub yaw_rad: f64,
}

impl Trajectory {
    /// The antenna's trajectory from the recorded one. If a tracking camera recorded it, `camera` is where that is on the robot:
    /// the trajectory is then that of the middle between the wheels. `offset_m` is the antenna's place relative to the
    /// tracked point, or to that middle ([`Self::with_antenna_offset`]).
    ///
    /// Each step of the middle is the part along the robot's heading (that of its middle) of what the camera reports; heights
    /// stay as reported, and so does the step over a gap. Not for robots that can move sideways.
    ///
    /// # Errors
    /// If a pose lacks the heading that is needed, or the offset is beyond any robot.
    pub fn of_antenna(self, camera: Option<Mount>, offset_m: Option<Vector3<f64>>) -> Result<Self, TrajectoryError> {
        let own = match camera {
            Some(mount) => self.rolling(mount)?,
            None => self,
        };
        match offset_m {
            Some(offset_m) => own.with_antenna_offset(offset_m),
            None => Ok(own),
        }
    }

    /// The trajectory of the middle between the wheels of a robot that carries the sensor of this one at `mount`: the first step of
    /// [`Self::of_antenna`].
    ///
    /// # Errors
    /// [`TrajectoryError::NoHeading`] if a pose has no heading.
    #[doc(hidden)]
    pub fn rolling(&self, mount: Mount) -> Result<Self, TrajectoryError> {
        let gaps = self.gaps();
        let mut roller = Roller::new(mount);
        let mut middle = |pose: &Pose| {
            let last_s = roller.before.map(|before| before.reported.t_s);
            roller.moved(pose, gaps.iter().any(|gap| Some(gap.from_s) == last_s))
        };
        let rolled = Self::new(self.poses().iter().map(&mut middle).collect::<Result<_, _>>()?)?;
        Ok(rolled.of_same(self).with_kind(TrajectoryKind::RollingCamera))
    }
}

/// The middle between the wheels of [`Trajectory::of_antenna`], of poses that come one by one.
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

/// The yaw of a quaternion: the heading of its x axis, radians.
#[must_use]
#[doc(hidden)]
pub fn heading_of(rotation: &UnitQuaternion<f64>) -> f64 {
    let x = rotation * Vector3::x();
    x.y.atan2(x.x)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(n: usize, f: impl Fn(f64) -> f64) -> Trajectory {
        let pose = |k: usize| {
            let t_s = k as f64 * 0.01;
            Pose { t_s, position_m: Vector3::new(f(t_s), 0.0, 0.0), heading_rad: Some(0.1) }
        };
        Trajectory::new((0..n).map(pose).collect()).unwrap()
    }

    #[test]
    fn interpolates_between_poses_and_refuses_outside() {
        let trajectory = line(100, |t| 2.0 * t);
        let pose = trajectory.at(0.123).unwrap();
        assert!((pose.position_m.x - 0.246).abs() < 1e-12);
        assert!(trajectory.at(-0.01).is_none() && trajectory.at(1.0).is_none());
        assert!(trajectory.at(0.99).is_some(), "the last pose itself is inside");
    }

    #[test]
    fn uneven_poses_are_found_as_a_search_finds_them() {
        for bend in [1.0, 1.3, 6.0] {
            let mut poses = line(500, |t| t).poses().to_vec();
            poses.iter_mut().for_each(|pose| pose.t_s = pose.t_s.powf(bend));
            let trajectory = Trajectory::new(poses).unwrap();
            let (start, end) = trajectory.span_s();
            for k in -10..=1_010 {
                let t_s = start + (end - start) * f64::from(k) / 1_000.0;
                let found = trajectory.poses.partition_point(|pose| pose.t_s <= t_s);
                assert_eq!(trajectory.after(t_s), found, "{bend}: {t_s}");
            }
            assert!([f64::NAN, f64::INFINITY, f64::NEG_INFINITY].iter().all(|t_s| trajectory.at(*t_s).is_none()));
        }
    }

    #[test]
    fn motion_window_follows_the_robot_whatever_its_speed() {
        for speed in [0.02, 0.2, 2.0] {
            let trajectory = line(1_000, |t| speed * (t - 3.0).clamp(0.0, 5.0));
            let (from, to) = trajectory.motion().window_s.unwrap();
            assert!((from - 3.0).abs() < 0.15 && (to - 8.0).abs() < 0.15, "{speed}: {from} {to}");
        }
        assert_eq!(line(100, |t| 1e-4 * (37.0 * t).sin()).motion().window_s, None);
    }

    #[test]
    fn an_arm_turns_with_the_attitude_wherever_the_robot_is() {
        let arm_m = Vector3::new(0.1, 0.0, 0.02);
        let by_heading = line(10, |t| 5.0 * t).of_arm(arm_m).unwrap();
        let expected = Vector3::new(0.1 * 0.1_f64.cos(), 0.1 * 0.1_f64.sin(), 0.02);
        assert!(by_heading.poses().iter().all(|pose| (pose.position_m - expected).norm() < 1e-12));
        // On its side: what points forward points up.
        let up = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -std::f64::consts::FRAC_PI_2);
        let plain = line(10, |t| t);
        let attitudes = plain.poses().iter().map(|pose| (pose.t_s, up)).collect::<Vec<_>>();
        let lying = plain.clone().with_attitudes(attitudes.clone()).of_arm(arm_m).unwrap();
        assert!((lying.poses()[3].position_m - Vector3::new(-0.02, 0.0, 0.1)).norm() < 1e-12);
        // A pose without one is upright.
        let partly = plain.with_attitudes(attitudes[1..].to_vec()).of_arm(arm_m).unwrap();
        assert!((partly.poses()[0].position_m - expected).norm() < 1e-12);
        assert!((partly.poses()[3].position_m - Vector3::new(-0.02, 0.0, 0.1)).norm() < 1e-12);
        let mut poses = by_heading.poses().to_vec();
        poses[2].heading_rad = None;
        assert_eq!(Trajectory::new(poses).unwrap().of_arm(arm_m), Err(TrajectoryError::NoHeading));
    }

    #[test]
    fn a_gap_is_crossed_only_by_a_robot_that_stood_still() {
        let with_gap = |jump: f64| {
            let mut poses: Vec<_> = line(200, |t| t).poses().to_vec();
            for pose in &mut poses[100..] {
                pose.t_s += 10.0;
                pose.position_m.x += jump - 0.01;
            }
            Trajectory::new(poses).unwrap()
        };
        assert!(with_gap(0.0).at(5.0).is_some());
        assert!(with_gap(0.5).at(5.0).is_none());
        assert_eq!(with_gap(0.5).gaps().len(), 1);
    }

    #[test]
    fn stale_poses_from_before_the_run_are_dropped() {
        let mut poses: Vec<_> = line(200, |t| t).poses().to_vec();
        for pose in &mut poses[..3] {
            pose.t_s -= 12.0;
            pose.position_m.y = 4.0;
        }
        let trajectory = Trajectory::new(poses).unwrap();
        assert_eq!(trajectory.left_out(), LeftOut { stale: 3, ..LeftOut::default() });
        assert!(trajectory.span_s().0 > 0.0);
    }

    /// Ten seconds along x at 1 m/s, a pose each 10 ms.
    fn drive() -> Vec<Pose> {
        line(1_000, |t| t).poses().to_vec()
    }

    #[test]
    fn poses_that_overtook_each_other_are_put_in_order() {
        let in_order = |poses: Vec<Pose>| Trajectory::new(poses).unwrap().poses().to_vec();
        let mut poses = drive();
        (10..900).step_by(7).for_each(|k| poses.swap(k, k + 3));
        assert_eq!(in_order(poses), drive());
        // In whatever order all of them are.
        let mut shuffled = drive();
        (1..1_000).for_each(|k| shuffled.swap(k, k * 7_919 % (k + 1)));
        assert!(!is_in_order(&shuffled));
        assert_eq!(in_order(shuffled), drive());
        let backwards = drive().into_iter().rev().collect();
        assert_eq!(in_order(backwards), drive());
    }

    #[test]
    fn of_a_clock_that_was_set_back_the_longer_part_is_used() {
        for (at, expected) in [(400, 400..1_000), (700, 0..700)] {
            let mut poses = drive();
            poses[at..].iter_mut().for_each(|pose| pose.t_s -= 1.5);
            // Some overtook each other, too.
            poses.swap(at + 100, at + 101);
            let trajectory = Trajectory::new(poses).unwrap();
            let left_out = 1_000 - expected.len();
            let (count, back_s) = trajectory.left_out().set_back.unwrap();
            assert!(count == left_out && (back_s - 1.49).abs() < 1e-6, "{count} {back_s}");
            let xs: Vec<f64> = trajectory.poses().iter().map(|pose| pose.position_m.x).collect();
            assert_eq!(xs, drive()[expected].iter().map(|pose| pose.position_m.x).collect::<Vec<_>>());
        }
        // A clock that was set back while the robot stood does no harm.
        let mut still = drive();
        still[300..700].iter_mut().for_each(|pose| pose.position_m.x = 0.3);
        still.iter_mut().skip(700).for_each(|pose| pose.position_m.x -= 0.4);
        still[500..].iter_mut().for_each(|pose| pose.t_s -= 1.0);
        assert_eq!(Trajectory::new(still).unwrap().left_out().set_back, None);
    }

    #[test]
    fn poses_of_one_time_are_counted_where_they_differ() {
        let twice: Vec<Pose> = drive().into_iter().flat_map(|pose| [pose, pose]).collect();
        let trajectory = Trajectory::new(twice).unwrap();
        assert_eq!((trajectory.poses().len(), trajectory.left_out()), (1_000, LeftOut::default()));
        // Two robots in one file: at each time there are two places.
        let other = |pose: Pose| Pose { position_m: pose.position_m + Vector3::y(), ..pose };
        let two = drive().into_iter().flat_map(|pose| [pose, other(pose)]).collect();
        let trajectory = Trajectory::new(two).unwrap();
        assert_eq!((trajectory.poses().len(), trajectory.left_out().same_time), (1_000, 1_000));
        assert_eq!(trajectory.time_step_s(), None);
    }

    /// Twenty seconds on a circle that is turned through at `turn_per_s`, a pose each 10 ms, its times made by `times`.
    fn circle(turn_per_s: f64, times: impl Fn(f64) -> f64) -> Result<Trajectory, TrajectoryError> {
        let pose = |k: i32| {
            let t_s = 0.37 + f64::from(k) * 0.01;
            let (sin, cos) = (turn_per_s * t_s).sin_cos();
            Pose { t_s: times(t_s), position_m: Vector3::new(cos, sin, 0.0), heading_rad: None }
        };
        Trajectory::new((0..2_000).map(pose).collect())
    }

    #[test]
    fn poses_of_rounded_times_are_spread_over_the_step_and_the_doubt_is_known() {
        let turn_per_s = 0.25;
        let exact = circle(turn_per_s, |t_s| t_s).unwrap();
        assert_eq!((exact.time_step_s(), exact.rounding_sd_rad()), (None, 0.0));
        let half = |way: fn(f64) -> f64| move |t_s: f64| way(2.0 * t_s) / 2.0;
        for (step_s, read) in [
            (1.0, circle(turn_per_s, f64::floor)),
            (1.0, circle(turn_per_s, f64::round)),
            (0.5, circle(turn_per_s, half(f64::floor))),
            (0.5, circle(turn_per_s, half(f64::round))),
        ] {
            let read = read.unwrap();
            assert!((read.time_step_s().unwrap() - step_s).abs() < 1e-9);
            assert!((read.turn_in_step_rad() - turn_per_s * step_s).abs() < 0.01, "{}", read.turn_in_step_rad());
            assert_eq!((read.poses().len(), read.left_out().same_time), (2_000, 0));
            // A quarter of the step, and the hundredth of a second at which poses come.
            for (pose, truth) in read.poses().iter().zip(exact.poses()) {
                let off_s = (pose.t_s - truth.t_s).abs();
                assert!(off_s <= 0.25 * step_s + 0.0101, "{step_s}: {} for {}", pose.t_s, truth.t_s);
            }
            let antenna = read.with_antenna_offset(Vector3::z()).unwrap();
            let wheels = read.clone().with_kind(TrajectoryKind::Wheels).with_antenna_offset(Vector3::z()).unwrap();
            assert_eq!((antenna.kind(), wheels.kind()), (TrajectoryKind::Unknown, TrajectoryKind::MountedWheels));
            assert_eq!(antenna.rounding_sd_rad(), read.rounding_sd_rad());
            // A part is of the same sensor and times.
            let (start_s, end_s) = read.span_s();
            let part = read.clone().with_kind(TrajectoryKind::Camera).within(start_s, 0.5 * (start_s + end_s)).unwrap();
            assert_eq!((part.kind(), part.rounding_sd_rad()), (TrajectoryKind::Camera, read.rounding_sd_rad()));
            assert!(part.poses().len().abs_diff(read.poses().len() / 2) <= 1 && part.span_s().0 == start_s);
            assert_eq!(read.within(end_s, start_s), Err(TrajectoryError::TooFew { poses: 0 }));
        }
        let coarse = circle(2.0, f64::floor);
        assert!(matches!(coarse, Err(TrajectoryError::TooCoarse { step_s: 1.0, turn_deg }) if turn_deg > 90.0));
    }

    #[test]
    fn heading_interpolates_across_the_cut_and_turns_the_antenna() {
        let pose = |t_s, heading| Pose { t_s, position_m: Vector3::zeros(), heading_rad: Some(heading) };
        let trajectory = Trajectory::new(vec![pose(0.0, 3.1), pose(0.1, -3.1)]).unwrap();
        let heading = trajectory.at(0.05).unwrap().heading_rad.unwrap();
        assert!((heading.abs() - std::f64::consts::PI).abs() < 1e-9);
        let moved = trajectory.with_antenna_offset(Vector3::new(0.1, 0.0, 0.2)).unwrap();
        let antenna = moved.poses()[0].position_m;
        assert!((antenna.x - 0.1 * 3.1f64.cos()).abs() < 1e-12 && antenna.z == 0.2);
        let bare = Trajectory::new(vec![
            Pose { heading_rad: None, ..pose(0.0, 0.0) },
            Pose { heading_rad: None, ..pose(1.0, 0.0) },
        ]);
        assert_eq!(bare.unwrap().with_antenna_offset(Vector3::x()), Err(TrajectoryError::NoHeading));
        let centimetres = trajectory.with_antenna_offset(Vector3::new(4.6, 15.9, 0.0));
        assert!(centimetres.unwrap_err().to_string().starts_with("an offset of 16.6 m is off the robot"));
    }

    #[test]
    fn nonsense_is_refused() {
        let pose = |t_s| Pose { t_s, position_m: Vector3::zeros(), heading_rad: None };
        assert_eq!(Trajectory::new(vec![pose(0.0)]), Err(TrajectoryError::TooFew { poses: 1 }));
        assert_eq!(Trajectory::new(vec![pose(0.0), pose(0.0)]), Err(TrajectoryError::TooFew { poses: 1 }));
        assert_eq!(Trajectory::new(vec![pose(0.0), pose(f64::NAN)]), Err(TrajectoryError::NotFinite { index: 1 }));
    }

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
        let exact = sensed(|_| Vector3::zeros()).rolling(MOUNT).unwrap();
        assert!(furthest_m(&exact) < 1e-4, "{}", furthest_m(&exact));
        // Also where nothing named the sensor: only a camera has a mount.
        assert_eq!(exact.kind(), TrajectoryKind::RollingCamera);
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
        let rolled = turned.rolling(MOUNT).unwrap();
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
        let rolled = Trajectory::new(poses.clone()).unwrap().rolling(Mount::default()).unwrap();
        let step = rolled.poses()[450].position_m - rolled.poses()[449].position_m;
        assert!((step - (poses[450].position_m - poses[449].position_m)).norm() < 1e-12, "{step}");
        assert_eq!(rolled.poses()[800].position_m.z, 0.07);
    }

    #[test]
    fn poses_that_come_one_by_one_roll_as_those_of_a_file() {
        let poses = over_a_gap();
        let whole = Trajectory::new(poses.clone()).unwrap().rolling(MOUNT).unwrap();
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
        let refused = Trajectory::new(poses).unwrap().rolling(Mount::default());
        assert_eq!(refused, Err(TrajectoryError::NoHeading));
    }
}
