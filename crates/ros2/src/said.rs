//! A report as messages.

use csi5300::pipeline::live::{PeerReport, PeerState};
use csi5300_bag::messages::own::Bearing;
use csi5300_bag::messages::standard::{
    Covariance, Header, Pose as PoseMessage, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion,
    TfMessage, Transform, TransformStamped, Vector3,
};
use std::f64::consts::PI;

/// Variance of an unknown rotation, squared radians.
const ANY_TURN: f64 = PI * PI;

/// True for a report with a bearing, new or repeated.
pub(crate) fn has_bearing(report: &PeerReport) -> bool {
    matches!(report.state, PeerState::Bearing | PeerState::Held)
}

/// The report's state, as in the JSON lines.
fn state_name(state: PeerState) -> String {
    let name = serde_json::to_value(state).ok().and_then(|state| state.as_str().map(str::to_owned));
    name.unwrap_or_default()
}

/// The rotation (x, y, z, w) from the x axis to a direction, radians: about z by the azimuth, then up by the elevation.
fn looking_along(azimuth_rad: f64, elevation_rad: f64) -> [f64; 4] {
    // About the rotated y axis; upwards is negative.
    let ((sin, cos), (up, level)) = ((0.5 * azimuth_rad).sin_cos(), (-0.5 * elevation_rad).sin_cos());
    [-sin * up, cos * up, sin * level, cos * level]
}

/// The whole report; angles in radians, NaN for unknown values.
pub fn bearing(header: Header, (peer, mac): (&str, &str), report: &PeerReport) -> Bearing {
    let answer = &report.answer;
    let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let angle = |degrees: Option<f64>| number(degrees).to_radians();
    Bearing {
        header,
        peer: peer.to_owned(),
        mac: mac.to_owned(),
        state: state_name(report.state),
        words: report.words.clone(),
        azimuth: angle(answer.azimuth_deg),
        azimuth_sd: angle(answer.azimuth_sd_deg),
        azimuth_body: angle(answer.azimuth_body_deg),
        mirror: angle(answer.mirror_deg),
        elevation: angle(answer.abs_elevation_deg),
        signed_elevation: angle(answer.elevation_deg),
        range: number(answer.range_m),
        range_sd: number(answer.range_sd_m),
        coherence: number(answer.coherence),
        confidence: number(answer.confidence),
        moved: report.moved_m,
        needed: report.needed_m,
        age: report.age_s,
        pairs: u32::try_from(answer.pairs_in_motion).unwrap_or(u32::MAX),
    }
}

/// A pose at the point that the bearing refers to, the middle of the motion, along the bearing. It is pitched where the sign
/// of the elevation is known.
pub fn direction(header: &Header, report: &PeerReport) -> Option<PoseStamped> {
    let (origin_m, azimuth_deg) =
        report.answer.origin_m.zip(report.answer.azimuth_deg).filter(|_| has_bearing(report))?;
    let elevation_deg = report.answer.elevation_deg.unwrap_or(0.0);
    let [x, y, z, w] = looking_along(azimuth_deg.to_radians(), elevation_deg.to_radians());
    let orientation = Quaternion { x, y, z, w };
    let pose = PoseMessage { position: origin_m.into(), orientation };
    Some(PoseStamped { header: header.clone(), pose })
}

/// The peer's place, where the range is known; the orientation is unknown.
pub fn place(header: &Header, report: &PeerReport) -> Option<PoseWithCovarianceStamped> {
    let position_m = report.answer.position_m.filter(|_| has_bearing(report))?;
    let mut covariance = Covariance::default();
    let known = report.answer.position_covariance_m2.unwrap_or_default();
    for (to, from) in covariance.0.iter_mut().zip(known) {
        to.iter_mut().zip(from).for_each(|(to, from)| *to = from);
    }
    for (k, row) in covariance.0.iter_mut().enumerate().skip(3) {
        row.iter_mut().skip(k).take(1).for_each(|turn| *turn = ANY_TURN);
    }
    let orientation = Quaternion { w: 1.0, ..Quaternion::default() };
    let pose = PoseMessage { position: position_m.into(), orientation };
    Some(PoseWithCovarianceStamped { header: header.clone(), pose: PoseWithCovariance { pose, covariance } })
}

/// A peer's place as a transform to a frame of the peer's name.
pub fn transform(place: &PoseWithCovarianceStamped, child: &str) -> TfMessage {
    let at = &place.pose.pose.position;
    let translation = Vector3 { x: at.x, y: at.y, z: at.z };
    let transform = Transform { translation, rotation: place.pose.pose.orientation.clone() };
    let child_frame_id = child.to_owned();
    TfMessage { transforms: vec![TransformStamped { header: place.header.clone(), child_frame_id, transform }] }
}

#[cfg(test)]
#[path = "said_tests.rs"]
pub(crate) mod tests;
