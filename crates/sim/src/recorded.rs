//! A table of poses as a motion: recorded trajectories, walks and waypoints.

use super::motion::Pose;
use csi5300::motion::odometry::csv;
use csi5300::motion::pose::Trajectory;
use nalgebra::Vector3;
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

/// Poses over time, interpolated linearly; at rest before the first row and after the last.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// Seconds since the first row, never falling.
    t_s: Vec<f64>,
    poses: Vec<Pose>,
}

/// Why a trajectory file is no motion.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordedError {
    /// It cannot be read.
    #[error("trajectory {}: {source}", file.display())]
    Csv {
        /// The file.
        file: PathBuf,
        /// Why.
        source: csv::CsvError,
    },
    /// A row is none.
    #[error("trajectory {}, line {line}: {reason}", file.display())]
    Row {
        /// The file.
        file: PathBuf,
        /// Its line.
        line: u64,
        /// What is wrong with it.
        reason: String,
    },
}

impl Recorded {
    /// A trajectory from rows of (seconds, pose), which are put into the order of time.
    #[must_use]
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
    pub fn load(file: &Path) -> Result<Self, RecordedError> {
        let (trajectory, counts) =
            csv::read(file).map_err(|source| RecordedError::Csv { file: file.to_owned(), source })?;
        if let Some((line, reason)) = counts.first_bad {
            return Err(RecordedError::Row { file: file.to_owned(), line, reason: reason.to_string() });
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
    #[must_use]
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trajectories_without_headings_face_where_they_go() {
        let (five, _) = csv::parse("10.0,0,0,0,1,\n11.0,0,0,2,1,\n12.0,0,0,4,1,\n".as_bytes()).unwrap();
        let five = Recorded::from_trajectory(&five);
        assert_eq!(five.duration_s(), 2.0);
        assert_eq!(five.at(0.5).position_m, Vector3::new(0.0, 1.0, 1.0));
        assert!((five.at(0.5).yaw_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
        let (six, _) = csv::parse("10.0,0,1,2,3,0.5,\n11.0,0,1,2,3,0.5,\n".as_bytes()).unwrap();
        let six = Recorded::from_trajectory(&six);
        assert_eq!(six.at(99.0), Pose { position_m: Vector3::new(1.0, 2.0, 3.0), yaw_rad: 0.5 });
        assert!(Recorded::load(Path::new("no such file.csv")).unwrap_err().to_string().contains("no such file.csv"));
    }

    #[test]
    fn headings_turn_the_short_way() {
        let at = |yaw_rad| Pose { position_m: Vector3::zeros(), yaw_rad };
        let table = Recorded::from_rows(vec![(0.0, at(3.0)), (1.0, at(-3.0))]);
        assert!((table.at(0.5).yaw_rad - std::f64::consts::PI).abs() < 1e-12);
    }
}
