//! Poses of one robot, and the stretch of two robots' relative motion for an estimate.

use crate::maths::wrap_rad;
use crate::motion::pose::{Pose, Trajectory};
use nalgebra::{Rotation3, Vector3};
use std::collections::VecDeque;

/// Relative motion is measured in steps of this length, so that the noise of odometry at rest does not add up, metres.
const STEP_M: f64 = 0.01;
/// Interval at which relative motion is evaluated, seconds.
const LOOK_S: f64 = 0.02;
/// The speed for extrapolation comes from poses of this last time, seconds.
const SPEED_S: f64 = 0.1;
/// A pose so far after all others is doubtful until the next one, seconds.
const AHEAD_S: f64 = 10.0;
/// Poses kept of one robot at most, whatever their times: half an hour at 50 Hz.
const MAX_POSES: usize = 90_000;

/// Poses of a robot, in the order of time: empty ([`Track::default`]) where they arrive, [`Track::still`] where the robot stands.
#[derive(Clone, Debug, Default)]
pub struct Track {
    poses: VecDeque<Pose>,
    /// A robot that never moves: its one pose holds at any time.
    still: bool,
    /// A pose far after all others: a wrong stamp if the next one is before it, as a first pose far after the second one is.
    doubtful: Option<Pose>,
    refused: u64,
}

impl Track {
    /// The track of a robot that stands at `position_m` for ever.
    #[must_use]
    pub fn still(position_m: Vector3<f64>, heading_rad: f64) -> Self {
        let pose = Pose { t_s: 0.0, position_m, heading_rad: Some(heading_rad) };
        Self { poses: VecDeque::from([pose]), still: true, ..Self::default() }
    }

    /// True for a robot that never moves.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn is_still(&self) -> bool {
        self.still
    }

    /// Takes a pose; late ones are sorted in.
    pub(crate) fn push(&mut self, pose: Pose) {
        let finite = pose.t_s.is_finite() && pose.position_m.iter().all(|x| x.is_finite());
        if !finite || pose.heading_rad.is_some_and(|heading| !heading.is_finite()) || self.still {
            self.refused += 1;
            return;
        }
        match self.doubtful.take() {
            Some(doubtful) if doubtful.t_s < pose.t_s => self.poses.push_back(doubtful),
            doubtful => self.refused += u64::from(doubtful.is_some()),
        }
        if self.poses.back().is_some_and(|last| pose.t_s - last.t_s > AHEAD_S) {
            self.doubtful = Some(pose);
            return;
        }
        if self.poses.len() == 1 && self.poses[0].t_s - pose.t_s > AHEAD_S {
            self.poses.clear();
            self.refused += 1;
        }
        let at = self.poses.iter().rposition(|before| before.t_s <= pose.t_s).map_or(0, |before| before + 1);
        if at > 0 && self.poses.get(at - 1).is_some_and(|before| before.t_s == pose.t_s) {
            self.refused += 1;
            return;
        }
        self.poses.insert(at, pose);
        while self.poses.len() > MAX_POSES {
            self.poses.pop_front();
        }
    }

    /// Drops everything, because later poses are in another frame.
    pub(crate) fn clear(&mut self) {
        if !self.still {
            (self.poses, self.doubtful) = Default::default();
        }
    }

    /// Drops the poses before `t_s`, except the last one, for interpolation.
    pub(crate) fn forget_before(&mut self, t_s: f64) {
        while !self.still && self.poses.get(1).is_some_and(|second| second.t_s < t_s) {
            self.poses.pop_front();
        }
    }

    /// Poses kept.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// True without any pose.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Poses that were not used: with a known time, not finite, or alone far after all others.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// The poses kept, in the order of time.
    #[doc(hidden)] // for the crates of this workspace
    pub fn poses(&self) -> impl Iterator<Item = &Pose> {
        self.poses.iter()
    }

    /// The newest pose.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn last(&self) -> Option<&Pose> {
        self.poses.back()
    }

    /// The trajectory so far, extended by `extend_s` at its last speed; later times have no pose. For a robot that
    /// never moves it holds over `span_s`. `None` before there are two poses.
    pub(crate) fn trajectory(&self, extend_s: f64, span_s: (f64, f64)) -> Option<Trajectory> {
        if self.still {
            let pose = *self.poses.front()?;
            let ends = [span_s.0 - 1.0, span_s.1 + 1.0];
            return Trajectory::new(ends.map(|t_s| Pose { t_s, ..pose }).to_vec()).ok();
        }
        let mut poses: Vec<Pose> = self.poses.iter().copied().collect();
        poses.extend(self.extrapolated(extend_s));
        Trajectory::new(poses).ok()
    }

    fn extrapolated(&self, by_s: f64) -> Option<Pose> {
        let last = self.poses.back().filter(|_| by_s > 0.0)?;
        let before = self.poses.iter().rev().find(|pose| last.t_s - pose.t_s >= SPEED_S)?;
        let share = by_s / (last.t_s - before.t_s);
        let turn = last.heading_rad.zip(before.heading_rad).map(|(to, from)| wrap_rad(to - from) * share);
        Some(Pose {
            t_s: last.t_s + by_s,
            position_m: last.position_m + (last.position_m - before.position_m) * share,
            heading_rad: last.heading_rad.zip(turn).map(|(heading, turn)| wrap_rad(heading + turn)),
        })
    }
}

/// A partner's trajectory on the receiver's clock and in the directions of its frame.
#[must_use]
pub fn aligned(partner: &Trajectory, ahead_s: f64, yaw_rad: f64) -> Option<Trajectory> {
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw_rad);
    let pose = |pose: &Pose| Pose {
        t_s: pose.t_s - ahead_s,
        position_m: turn * pose.position_m,
        heading_rad: pose.heading_rad.map(|heading| wrap_rad(heading + yaw_rad)),
    };
    Trajectory::new(partner.poses().iter().map(pose).collect()).ok()
}

/// The last stretch of relative motion of two robots.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Window {
    /// When it begins, seconds; everything before the first motion belongs to it if nothing was skipped.
    pub from_s: f64,
    /// Its end: the last time at which both poses are known, seconds.
    pub to_s: f64,
    /// Length of the relative path within it, metres.
    pub path_m: f64,
    /// The diagonal of the box that holds it, metres.
    pub extent_m: f64,
    /// Motion since the first kept pose, metres; differences give the motion since the last call.
    pub whole_m: f64,
    /// Earlier motion was skipped.
    pub cut: bool,
}

/// The last `length_m` metres, of the last `age_s` seconds, in which `receiver` and `transmitter` moved relative to each
/// other.
#[must_use]
pub fn window(receiver: &Trajectory, transmitter: Option<&Trajectory>, length_m: f64, age_s: f64) -> Option<Window> {
    let (mut start_s, mut to_s) = receiver.span_s();
    if let Some((from, to)) = transmitter.map(Trajectory::span_s) {
        (start_s, to_s) = (start_s.max(from), to_s.min(to));
    }
    let relative = |t_s: f64| {
        let partner = match transmitter {
            Some(trajectory) => trajectory.at(t_s)?.position_m,
            None => Vector3::zeros(),
        };
        Some(receiver.at(t_s)?.position_m - partner)
    };
    let oldest_s = start_s.max(to_s - age_s);
    let looks = ((to_s - oldest_s) / LOOK_S).floor().max(0.0) as usize;
    // From the end backwards, so that the newest motion is in it.
    let mut anchors: Vec<(f64, Vector3<f64>)> = Vec::new();
    let (mut path_m, mut whole_m, mut cut_at) = (0.0, 0.0, None);
    for look in 0..=looks {
        let t_s = to_s - look as f64 * LOOK_S;
        let Some(at) = relative(t_s) else { continue };
        let Some((_, anchor)) = anchors.last() else {
            anchors.push((t_s, at));
            continue;
        };
        let step_m = (at - anchor).norm();
        if step_m < STEP_M {
            continue;
        }
        anchors.push((t_s, at));
        whole_m += step_m;
        if cut_at.is_none() {
            path_m += step_m;
            if path_m >= length_m {
                cut_at = Some((t_s, anchors.len()));
            }
        }
    }
    let (from_s, kept) = cut_at.unwrap_or((oldest_s, anchors.len()));
    let places = || anchors.iter().take(kept).map(|(_, at)| *at);
    let (low, high) =
        places().fold((places().next()?, places().next()?), |(low, high), at| (low.inf(&at), high.sup(&at)));
    Some(Window {
        from_s,
        to_s,
        path_m,
        extent_m: (high - low).norm(),
        whole_m,
        cut: cut_at.is_some() || oldest_s > start_s,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(t_s: f64, x: f64) -> Pose {
        Pose { t_s, position_m: Vector3::new(x, 0.0, 0.0), heading_rad: Some(0.0) }
    }

    /// At rest for two seconds, then 0.1 m/s, with half a millimetre of noise throughout.
    fn driven(until_s: f64) -> Track {
        let mut track = Track::default();
        for k in 0..(until_s * 100.0) as u32 {
            let t_s = f64::from(k) * 0.01;
            let noise = 5e-4 * f64::from(k * 7_919 % 100) / 100.0;
            track.push(pose(t_s, 0.1 * (t_s - 2.0).max(0.0) + noise));
        }
        track
    }

    #[test]
    fn late_poses_find_their_place_and_repeated_ones_are_counted() {
        let mut track = Track::default();
        for t_s in [1.0, 3.0, 2.0, 2.0, f64::NAN, 0.5] {
            track.push(pose(t_s, t_s));
        }
        assert_eq!((track.len(), track.refused), (4, 2));
        let trajectory = track.trajectory(0.0, (0.0, 0.0)).unwrap();
        assert_eq!(trajectory.poses().iter().map(|p| p.t_s).collect::<Vec<_>>(), [0.5, 1.0, 2.0, 3.0]);
        track.forget_before(2.5);
        assert_eq!(track.len(), 2);
    }

    #[test]
    fn one_pose_far_ahead_is_a_wrong_stamp_and_two_are_a_pause() {
        let mut track = driven(4.0);
        let before = (track.len(), track.refused);
        track.push(pose(3_600.0, 9.0));
        track.push(pose(4.0, 0.2));
        assert_eq!((track.len(), track.refused), (before.0 + 1, before.1 + 1));
        [60.0, 60.01].into_iter().for_each(|t_s| track.push(pose(t_s, 0.2)));
        assert_eq!((track.len(), track.refused), (before.0 + 3, before.1 + 1));
        assert_eq!(track.last().unwrap().t_s, 60.01);
        // The first pose may be the wrong one.
        let mut track = Track::default();
        [3_600.0, 4.0, 4.1].into_iter().for_each(|t_s| track.push(pose(t_s, t_s)));
        assert_eq!((track.len(), track.refused, track.last().unwrap().t_s), (2, 1, 4.1));
    }

    #[test]
    fn poses_are_carried_on_only_as_far_as_asked() {
        let track = driven(4.0);
        let last_s = track.last().unwrap().t_s;
        assert!(track.trajectory(0.0, (0.0, 0.0)).unwrap().at(last_s + 0.01).is_none());
        let longer = track.trajectory(0.05, (0.0, 0.0)).unwrap();
        let ahead = longer.at(last_s + 0.04).unwrap().position_m.x - track.last().unwrap().position_m.x;
        assert!((ahead - 0.004).abs() < 5e-4, "{ahead}");
        assert!(longer.at(last_s + 0.06).is_none());
    }

    #[test]
    fn standing_still_is_no_motion_whatever_the_noise() {
        let still = driven(2.0).trajectory(0.0, (0.0, 0.0)).unwrap();
        let found = window(&still, None, 1.0, 100.0).unwrap();
        assert_eq!((found.path_m, found.cut), (0.0, false));
        assert!(found.extent_m < STEP_M);
    }

    #[test]
    fn the_window_holds_the_last_metres_of_relative_motion() {
        let trajectory = driven(22.0).trajectory(0.0, (0.0, 0.0)).unwrap();
        let found = window(&trajectory, None, 0.5, 100.0).unwrap();
        assert!((found.from_s - 17.0).abs() < 0.2 && found.cut, "{found:?}");
        assert!((found.whole_m - 2.0).abs() < 0.05 && (found.extent_m - 0.5).abs() < 0.03, "{found:?}");
        let recent = window(&trajectory, None, 50.0, 3.0).unwrap();
        assert!((recent.path_m - 0.3).abs() < 0.02 && recent.cut, "{recent:?}");
        // A partner that drives along leaves no relative motion; one that drives the other way doubles it.
        let along = aligned(&trajectory, 0.0, 0.0).unwrap();
        assert_eq!(window(&trajectory, Some(&along), 0.5, 100.0).unwrap().path_m, 0.0);
        let against = aligned(&trajectory, 0.0, std::f64::consts::PI).unwrap();
        let both = window(&trajectory, Some(&against), 50.0, 100.0).unwrap();
        assert!((both.path_m - 4.0).abs() < 0.1, "{both:?}");
    }
}
