//! The antenna pattern of a robot: received power over the azimuth to the transmitter in the robot's frame.

use csi5300::motion::pose::Trajectory;
use csi5300_sim::Recorded;
use csi5300_sim::scene::Pattern;
use nalgebra::{SMatrix, SVector, Vector3};

/// Fewer records than this show no pattern.
const FEWEST: usize = 100;
/// Largest length of the mean heading vector: headings must point in all directions.
const LOPSIDED: f64 = 0.5;

/// The pattern of a robot's antennas, estimated from the power of its records (host time, dB) along its trajectory: the first
/// two harmonics of the azimuth to `place` in the robot's frame, by least squares. `None` if the robot did not turn round.
pub(super) fn pattern(powers: &[(f64, f64)], trajectory: &Trajectory, place: [f64; 3]) -> Pattern {
    let (from_s, to_s) = trajectory.span_s();
    let path = Recorded::from_trajectory(trajectory);
    let mut normal = SMatrix::<f64, 5, 5>::zeros();
    let mut right = SVector::<f64, 5>::zeros();
    let (mut count, mut mean) = (0, [0.0; 2]);
    for &(t_s, power_db) in powers.iter().filter(|(t_s, _)| (from_s..=to_s).contains(t_s)) {
        let pose = path.at(t_s - from_s);
        let way = Vector3::from(place) - pose.position_m;
        let (sin, cos) = (way.y.atan2(way.x) - pose.yaw_rad).sin_cos();
        let row = SVector::from([1.0, cos, sin, 2.0 * cos * cos - 1.0, 2.0 * sin * cos]);
        normal += row * row.transpose();
        right += row * power_db;
        count += 1;
        mean = [mean[0] + cos, mean[1] + sin];
    }
    let lopsided = mean[0].hypot(mean[1]) > LOPSIDED * f64::from(count);
    let found = normal.cholesky().map(|normal| normal.solve(&right));
    match found.filter(|_| count as usize >= FEWEST && !lopsided) {
        Some(found) => Pattern { cos_db: found[1], sin_db: found[2], cos2_db: found[3], sin2_db: found[4] },
        None => Pattern::default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::motion::pose::Pose;
    use std::f64::consts::TAU;

    /// Half a minute on a circle of 30 cm, `turns` times round.
    fn driven(turns: f64) -> Trajectory {
        let pose = |k: i32| {
            let (t_s, angle) = (f64::from(k) * 0.01, TAU * turns * f64::from(k) / 3_000.0);
            let position_m = Vector3::new(0.3 * angle.sin(), -0.3 * angle.cos(), 0.0);
            Pose { t_s, position_m, heading_rad: Some(angle) }
        };
        Trajectory::new((0..=3_000).map(pose).collect()).unwrap()
    }

    #[test]
    fn a_robot_that_turns_shows_its_pattern_and_one_that_does_not_shows_none() {
        let truth = Pattern { cos_db: 0.5, sin_db: -2.0, cos2_db: 1.0, sin2_db: 0.25 };
        let (place, trajectory) = ([-30.0, 20.0, 1.0], driven(3.0));
        let path = Recorded::from_trajectory(&trajectory);
        let powers = |path: &Recorded| -> Vec<(f64, f64)> {
            let power = |k: u32| {
                let t_s = f64::from(k) * 0.01;
                let pose = path.at(t_s);
                let way = Vector3::from(place) - pose.position_m;
                let a = way.y.atan2(way.x) - pose.yaw_rad;
                let fading = if k.is_multiple_of(2) { 1.0 } else { -1.0 };
                (t_s, -40.0 + truth.gain_db(a.cos(), a.sin()) + fading)
            };
            (0..3_000).map(power).collect()
        };
        let found = pattern(&powers(&path), &trajectory, place);
        for (found, truth) in [
            (found.cos_db, truth.cos_db),
            (found.sin_db, truth.sin_db),
            (found.cos2_db, truth.cos2_db),
            (found.sin2_db, truth.sin2_db),
        ] {
            assert!((found - truth).abs() < 0.05, "{found} of {truth}");
        }
        let still = driven(0.05);
        let lopsided = pattern(&powers(&Recorded::from_trajectory(&still)), &still, place);
        assert_eq!(lopsided, Pattern::default());
        assert_eq!(pattern(&powers(&path)[..50], &trajectory, place), Pattern::default());
    }
}
