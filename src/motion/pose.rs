//! Poses, trajectories, interpolation, and the stretch of a trajectory in which the robot moved.
//!
//! Frame: the trajectory file's own, metres, right-handed; azimuth and heading from +x towards +y.

use crate::maths::{lower_rank, upper_median, wrap_rad};
use crate::tuning::TUNING;
use nalgebra::Vector3;

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
    /// If there is no heading and the offset is not along z.
    pub fn mounted(self, offset_m: Vector3<f64>) -> Result<Self, TrajectoryError> {
        let (sin, cos) = match self.heading_rad {
            Some(heading) => heading.sin_cos(),
            None if offset_m.x != 0.0 || offset_m.y != 0.0 => return Err(TrajectoryError::NoHeading),
            None => (0.0, 1.0),
        };
        let turned = Vector3::new(cos * offset_m.x - sin * offset_m.y, sin * offset_m.x + cos * offset_m.y, offset_m.z);
        Ok(Self { position_m: self.position_m + turned, ..self })
    }
}

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

/// Poses in the order of time, at least two.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    poses: Vec<Pose>,
    max_gap_s: f64,
    stale_head: usize,
}

/// Why poses make no trajectory.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// Interpolation needs two poses at different times.
    #[error("{poses} usable poses make no trajectory: at least 2 at different times are needed")]
    TooFew {
        /// Usable poses.
        poses: usize,
    },
    /// An offset on the robot can only be turned with its heading, and wheels roll along it.
    #[error(
        "an offset on the robot needs its heading, and this trajectory has none (5 columns); use one with yaw or quaternion"
    )]
    NoHeading,
    /// A pose with a position, time or heading that is not a number.
    #[error("pose {index} is not finite")]
    NotFinite {
        /// Its place in the list.
        index: usize,
    },
}

/// Poses on either side of where even ones would put a time that are looked at first.
const NEAR: usize = 8;

impl Trajectory {
    /// A trajectory from poses in any order; of several at one time the last stays.
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
        // Sorting takes half as much memory again; files are in order.
        if !poses.is_sorted_by(|a, b| a.t_s.total_cmp(&b.t_s).is_le()) {
            poses.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        }
        poses.dedup_by(|later, earlier| {
            let same = later.t_s == earlier.t_s;
            if same {
                *earlier = *later;
            }
            same
        });
        if poses.len() < 2 {
            return Err(TrajectoryError::TooFew { poses: poses.len() });
        }
        let mut steps: Vec<f64> = poses.windows(2).map(|w| w[1].t_s - w[0].t_s).collect();
        let usual = upper_median(&mut steps).unwrap_or(0.0);
        let mut trajectory = Self { poses, max_gap_s: TUNING.motion.min_gap_s.max(10.0 * usual), stale_head: 0 };
        trajectory.drop_stale_head();
        Ok(trajectory)
    }

    /// Logs often begin with a few poses from long before the run (a latched topic), then a gap of seconds. Where the
    /// robot is elsewhere after it, they belong to something else.
    fn drop_stale_head(&mut self) {
        let head = self.poses.len() / 20;
        let gap = (1..=head).rev().find(|&k| self.poses[k].t_s - self.poses[k - 1].t_s > 1.0);
        if let Some(k) = gap
            && (self.poses[k].position_m - self.poses[k - 1].position_m).norm() > TUNING.motion.still_m
            && self.poses.len() - k >= 2
        {
            self.poses.drain(..k);
            self.stale_head = k;
        }
    }

    /// The poses, in the order of time.
    #[must_use]
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// Poses dropped at the start because they were from before the run.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn stale_head(&self) -> usize {
        self.stale_head
    }

    /// First and last time, seconds.
    #[must_use]
    pub fn span_s(&self) -> (f64, f64) {
        (self.poses[0].t_s, self.poses[self.poses.len() - 1].t_s)
    }

    /// The gaps that nothing is interpolated across unless the robot stood still.
    #[must_use]
    pub fn gaps(&self) -> Vec<Gap> {
        let wide = self.poses.windows(2).filter(|w| w[1].t_s - w[0].t_s > self.max_gap_s);
        wide.map(|w| Gap { from_s: w[0].t_s, to_s: w[1].t_s, moved_m: (w[1].position_m - w[0].position_m).norm() })
            .collect()
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
        if b.t_s - a.t_s > self.max_gap_s && (b.position_m - a.position_m).norm() > TUNING.motion.still_m {
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
        Ok(moved)
    }

    /// When the robot moved: relative to its own usual speed, so that slow and fast robots need no threshold.
    #[must_use]
    pub fn motion(&self) -> Motion {
        let speeds: Vec<f64> = self.poses.iter().map(|pose| self.speed_m_per_s(pose.t_s)).collect();
        let mut sorted = speeds.clone();
        sorted.sort_by(f64::total_cmp);
        let usual = lower_rank(&sorted, 0.9).unwrap_or(0.0);
        let floor = (TUNING.motion.still_share * usual).max(TUNING.motion.still_m_per_s);
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
    pub(crate) fn speed_m_per_s(&self, t_s: f64) -> f64 {
        let (start, end) = self.span_s();
        let (from, to) = ((t_s - TUNING.motion.speed_half_s).max(start), (t_s + TUNING.motion.speed_half_s).min(end));
        match (self.position_m(from), self.position_m(to)) {
            (Some(a), Some(b)) if to > from => (b - a).norm() / (to - from),
            _ => 0.0,
        }
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
        assert_eq!(trajectory.stale_head(), 3);
        assert!(trajectory.span_s().0 > 0.0);
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
    }

    #[test]
    fn nonsense_is_refused() {
        let pose = |t_s| Pose { t_s, position_m: Vector3::zeros(), heading_rad: None };
        assert_eq!(Trajectory::new(vec![pose(0.0)]), Err(TrajectoryError::TooFew { poses: 1 }));
        assert_eq!(Trajectory::new(vec![pose(0.0), pose(0.0)]), Err(TrajectoryError::TooFew { poses: 1 }));
        assert_eq!(Trajectory::new(vec![pose(0.0), pose(f64::NAN)]), Err(TrajectoryError::NotFinite { index: 1 }));
    }
}
