//! How the path of a sensor compares with motion capture's of the same motion.

use super::find::{Capture, TrajectorySource};
use super::part::Part;
use super::shelf::Shelf;
use csi5300::motion::pose::Trajectory;
use num_complex::Complex64;

/// A path against motion capture's at the same times, after the best rotation and scale (least squares, horizontal).
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct PathError {
    /// By how much the path is turned, radians, counter-clockwise: so much too large are all bearings from it.
    pub rotation_rad: f64,
    /// Metres of the path for each that was driven.
    pub scale: f64,
    /// Root mean square of what is left, metres.
    pub shape_m: f64,
}

impl PathError {
    /// `path` against `truth` over the motion of the latter; none where they have fewer than two times in common, or nothing
    /// moved.
    fn of(path: &Trajectory, truth: &Trajectory) -> Option<Self> {
        let (from_s, to_s) = truth.motion().window_s?;
        let inside = path.poses().iter().filter(|pose| (from_s..=to_s).contains(&pose.t_s));
        let both: Vec<[Complex64; 2]> = inside
            .filter_map(|pose| Some([pose.position_m, truth.at(pose.t_s)?.position_m]))
            .map(|pair| pair.map(|place_m| Complex64::new(place_m.x, place_m.y)))
            .collect();
        let count = both.len() as f64;
        let middle = both.iter().fold([Complex64::ZERO; 2], |sum, pair| [sum[0] + pair[0], sum[1] + pair[1]]);
        let from_middle = || both.iter().map(|pair| [pair[0] - middle[0] / count, pair[1] - middle[1] / count]);
        let along: Complex64 = from_middle().map(|[own, truth]| truth.conj() * own).sum();
        let driven: f64 = from_middle().map(|[_, truth]| truth.norm_sqr()).sum();
        if both.len() < 2 || driven <= 0.0 || along.norm() <= 0.0 {
            return None;
        }
        let turn = along / driven;
        let left: f64 = from_middle().map(|[own, truth]| (own / turn - truth).norm_sqr()).sum();
        Some(Self { rotation_rad: turn.arg(), scale: turn.norm(), shape_m: (left / count).sqrt() })
    }
}

impl Capture {
    /// The path of the antenna by `source` against motion capture's, over a part of the motion; none where either is missing.
    #[must_use]
    pub(crate) fn path_error(&self, source: TrajectorySource, part: Part) -> Option<PathError> {
        let shelf = Shelf::default();
        let read = |source| self.trajectory(&shelf, source, &mut Vec::new()).ok();
        let truth = read(TrajectorySource::GroundTruth)?;
        PathError::of(&part.cut(&read(source)?).ok()?, &truth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::motion::pose::Pose;
    use nalgebra::Vector3;

    fn arc(scale: f64, turn_rad: f64, bend_m: f64) -> Trajectory {
        let pose = |k: usize| {
            let (sin, cos) = (0.01 * k as f64 + turn_rad).sin_cos();
            let off_m = if k.is_multiple_of(2) { bend_m } else { -bend_m };
            let position_m = Vector3::new(scale * 0.3 * cos + off_m, scale * 0.3 * sin, 0.0);
            Pose { t_s: 0.05 * k as f64, position_m, heading_rad: None }
        };
        Trajectory::new((0..300).map(pose).collect()).unwrap()
    }

    #[test]
    fn rotation_scale_and_shape_are_told_apart() {
        let truth = arc(1.0, 0.0, 0.0);
        let own = PathError::of(&arc(0.9, 0.2, 0.004), &truth).unwrap();
        assert!((own.rotation_rad - 0.2).abs() < 2e-3 && (own.scale - 0.9).abs() < 2e-3, "{own:?}");
        assert!((own.shape_m - 0.004 / 0.9).abs() < 1e-4, "{own:?}");
        let exact = PathError::of(&truth, &truth).unwrap();
        assert!(exact.rotation_rad.abs() < 1e-12 && exact.shape_m < 1e-12, "{exact:?}");
    }

    #[test]
    fn a_path_of_another_time_or_of_a_robot_at_rest_has_no_error() {
        let truth = arc(1.0, 0.0, 0.0);
        let late = truth.poses().iter().map(|pose| Pose { t_s: pose.t_s + 100.0, ..*pose });
        assert_eq!(PathError::of(&Trajectory::new(late.collect()).unwrap(), &truth), None);
        let still = truth.poses().iter().map(|pose| Pose { position_m: Vector3::zeros(), ..*pose });
        let still = Trajectory::new(still.collect()).unwrap();
        assert_eq!(PathError::of(&truth, &still), None);
        assert_eq!(PathError::of(&still, &truth), None);
    }
}
