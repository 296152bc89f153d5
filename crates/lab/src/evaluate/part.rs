//! Parts of a motion: the results of a shorter drive.

use csi5300::motion::pose::{Trajectory, TrajectoryError};

/// One or more consecutive parts of a motion that is cut into equally long ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub struct Part {
    /// Index of the first part.
    pub index: u32,
    /// Number of parts into which the motion is cut.
    pub of: u32,
    /// Number of parts from there on.
    pub count: u32,
}

impl Part {
    /// The whole motion.
    pub const WHOLE: Self = Self { index: 0, of: 1, count: 1 };

    /// All `of` parts of a motion, in order of time.
    pub fn each(of: u32) -> impl Iterator<Item = Self> {
        (0..of).map(move |index| Self { index, of, count: 1 })
    }

    /// The motion from its start to the end of this part.
    #[must_use]
    pub fn and_before(self) -> Self {
        Self { index: 0, count: self.index + self.count, ..self }
    }

    /// The poses of this part. The motion lies between the first and the last pose that moves; a trajectory without motion stays
    /// whole.
    ///
    /// # Errors
    /// If fewer than two poses are in the part.
    pub fn cut(self, trajectory: &Trajectory) -> Result<Trajectory, TrajectoryError> {
        let Some((start_s, end_s)) = trajectory.motion().window_s.filter(|_| self.of > 1) else {
            return Ok(trajectory.clone());
        };
        let edge_s = |k: u32| start_s + (end_s - start_s) * f64::from(k) / f64::from(self.of);
        let (from_s, to_s) = (edge_s(self.index), edge_s(self.index + self.count));
        let inside = trajectory.poses().iter().filter(|pose| (from_s..=to_s).contains(&pose.t_s));
        Trajectory::new(inside.copied().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::motion::pose::Pose;
    use nalgebra::Vector3;

    #[test]
    fn parts_follow_each_other_and_make_up_the_motion() {
        let at = |k: usize| Vector3::new(0.01 * (k.clamp(100, 300) as f64 - 100.0), 0.0, 0.0);
        let pose = |k: usize| Pose { t_s: 0.02 * k as f64, position_m: at(k), heading_rad: None };
        let whole = Trajectory::new((0..400).map(pose).collect()).unwrap();
        assert_eq!(Part::WHOLE.cut(&whole).unwrap(), whole);
        let (start_s, end_s) = whole.motion().window_s.unwrap();
        let spans: Vec<(f64, f64)> = Part::each(4).map(|part| part.cut(&whole).unwrap().span_s()).collect();
        assert!((spans[0].0 - start_s).abs() < 0.03 && (spans[3].1 - end_s).abs() < 0.03, "{spans:?}");
        for (k, span) in spans.iter().enumerate() {
            assert!((span.1 - span.0 - (end_s - start_s) / 4.0).abs() < 0.05, "{k}: {spans:?}");
        }
        assert!(spans.windows(2).all(|two| two[1].0 - two[0].1 < 0.03), "{spans:?}");
        let so_far = Part::each(4).nth(2).unwrap().and_before().cut(&whole).unwrap().span_s();
        assert_eq!(so_far, (spans[0].0, spans[2].1));
    }
}
