//! A report as messages.

use super::super::messages::own::Bearing;
use super::super::messages::standard::{
    Covariance, Header, Pose as PoseMessage, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion,
    TfMessage, Transform, TransformStamped, Vector3,
};
use crate::ros::said::{bearing_message, has_bearing, looking_along};
use csi5300::motion::pose::Pose;
use csi5300::pipeline::live::PeerReport;
use std::f64::consts::PI;

/// Variance of a turn about which nothing is known, squared radians.
const ANY_TURN: f64 = PI * PI;

/// All that is said; angles in radians, NaN for what is not known.
pub(super) fn bearing(header: Header, (peer, mac): (&str, &str), report: &PeerReport) -> Bearing {
    bearing_message!(Bearing, header, peer, mac, report)
}

/// A pose that stands where the antenna is and looks along the bearing: up or down too where the sign of the elevation is
/// known.
pub(super) fn direction(header: &Header, report: &PeerReport, own: Option<&Pose>) -> Option<PoseStamped> {
    let (own, azimuth_deg) = own.zip(report.answer.azimuth_deg).filter(|_| has_bearing(report))?;
    let elevation_deg = report.answer.elevation_deg.unwrap_or(0.0);
    let [x, y, z, w] = looking_along(azimuth_deg.to_radians(), elevation_deg.to_radians());
    let orientation = Quaternion { x, y, z, w };
    let position = <[f64; 3]>::from(own.position_m).into();
    Some(PoseStamped { header: header.clone(), pose: PoseMessage { position, orientation } })
}

/// Where the peer is, where there is a range; nothing is known of how it is turned.
pub(super) fn place(header: &Header, report: &PeerReport) -> Option<PoseWithCovarianceStamped> {
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

/// A peer's place as a transform to a frame of its name.
pub(super) fn transform(place: &PoseWithCovarianceStamped, child: &str) -> TfMessage {
    let at = &place.pose.pose.position;
    let translation = Vector3 { x: at.x, y: at.y, z: at.z };
    let transform = Transform { translation, rotation: place.pose.pose.orientation.clone() };
    let child_frame_id = child.to_owned();
    TfMessage { transforms: vec![TransformStamped { header: place.header.clone(), child_frame_id, transform }] }
}

#[cfg(test)]
#[path = "said_tests.rs"]
pub(super) mod tests;
