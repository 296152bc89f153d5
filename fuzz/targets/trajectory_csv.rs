//! Any bytes as a trajectory file: refused with a reason, or poses that are finite, in order and can be interpolated.

use csi5300::motion::odometry::csv::parse;

/// Runs the target.
pub fn run(bytes: &[u8]) {
    let Ok((trajectory, counts)) = parse(bytes, None) else { return };
    let poses = trajectory.poses();
    assert!(poses.len() >= 2 && poses.len() as u64 <= counts.rows);
    assert!(poses.windows(2).all(|pair| pair[0].t_s < pair[1].t_s));
    let (start, end) = trajectory.span_s();
    let middle = start + 0.5 * (end - start);
    for at in [start, middle, end] {
        if let Some(pose) = trajectory.at(at) {
            assert!(pose.position_m.iter().all(|x| x.is_finite()) || poses.iter().any(|p| p.position_m.norm() > 1e150));
        }
    }
    assert!(trajectory.at(f64::NAN).is_none() && trajectory.at(f64::INFINITY).is_none());
    let _ = (trajectory.motion(), trajectory.gaps());
}
