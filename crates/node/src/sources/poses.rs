//! Poses from a file, and of robots that stand.

use super::Poses;
use crate::config::{Csv, Place};
use csi5300::motion::odometry::Replayed;
use csi5300::motion::odometry::csv;
use csi5300::motion::pose::Pose;
use csi5300::pipeline::live::Track;
use csi5300::source::Error;
use csi5300::time::Instant;
use nalgebra::Vector3;

/// A trajectory at its own pace from `origin_s` on, or from its first pose.
pub(super) fn trajectory(file: &Csv, origin_s: Option<f64>, start: Instant) -> Result<Poses, Error> {
    let (trajectory, _) = csv::read(&file.file).map_err(|error| Error::Backend(Box::new(error)))?;
    Ok(Box::new(Replayed::new(&trajectory, origin_s.unwrap_or(trajectory.span_s().0), start, 1.0)))
}

/// The place of the antenna of a robot that stands.
pub(super) fn still(place: &Place, offset_m: [f64; 3]) -> Track {
    let heading_rad = place.heading_deg.to_radians();
    let pose = Pose { t_s: 0.0, position_m: Vector3::from(place.position_m), heading_rad: Some(heading_rad) };
    let antenna = pose.mounted(Vector3::from(offset_m)).map_or(pose.position_m, |pose| pose.position_m);
    Track::still(antenna, heading_rad)
}
