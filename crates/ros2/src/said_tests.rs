use super::*;
use csi5300::pipeline::Answer;
use nalgebra::{Quaternion as Numbers, UnitQuaternion, Vector3 as Place};

/// A report with these fields.
pub(crate) fn report(state: PeerState, fill: impl FnOnce(&mut Answer)) -> PeerReport {
    let mut answer = Answer::default();
    fill(&mut answer);
    let (words, t_s) = ("words".into(), Some(12.5));
    PeerReport { t_s, state, words, moved_m: 1.0, needed_m: 0.1, age_s: 0.0, accurate: true, heard_at: None, answer }
}

#[test]
fn unknown_values_are_nan() {
    let said = bearing(Header::default(), ("b", "02:00:00:00:00:02"), &report(PeerState::NotYet, |_| ()));
    assert_eq!((said.state.as_str(), said.peer.as_str(), said.pairs), ("not_yet", "b", 0));
    assert!(said.azimuth.is_nan() && said.range.is_nan() && said.confidence.is_nan() && said.moved == 1.0);
    assert_eq!(direction(&Header::default(), &report(PeerState::NotYet, |_| ())), None);
    assert_eq!(place(&Header::default(), &report(PeerState::Bearing, |_| ())), None);
}

#[test]
fn a_direction_points_along_the_bearing() {
    let report = report(PeerState::Bearing, |answer| {
        (answer.origin_m, answer.azimuth_deg) = (Some([1.0, 2.0, 0.2]), Some(120.0));
        answer.elevation_deg = Some(-20.0);
    });
    let said = direction(&Header::default(), &report).unwrap();
    let turned = &said.pose.orientation;
    let along = UnitQuaternion::from_quaternion(Numbers::new(turned.w, turned.x, turned.y, turned.z)) * Place::x();
    let (azimuth, elevation) = (120.0_f64.to_radians(), -(20.0_f64.to_radians()));
    let expected = Place::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
    assert!((along - expected).norm() < 1e-12, "{along}");
    assert_eq!(said.pose.position, [1.0, 2.0, 0.2].into());
}

#[test]
fn a_place_has_its_covariance_and_an_unknown_orientation() {
    let report = report(PeerState::Held, |answer| {
        answer.position_m = Some([4.0, 5.0, 0.5]);
        answer.position_covariance_m2 = Some([[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, 6.0]]);
    });
    let said = place(&Header::default(), &report).unwrap();
    let rows = said.pose.covariance.0;
    assert_eq!(rows[1], [2.0, 4.0, 5.0, 0.0, 0.0, 0.0]);
    assert_eq!(rows[4], [0.0, 0.0, 0.0, 0.0, ANY_TURN, 0.0]);
    let tf = transform(&said, "b");
    assert_eq!((tf.transforms[0].transform.translation.y, tf.transforms[0].child_frame_id.as_str()), (5.0, "b"));
}
