//! Headings from orientations.

use nalgebra::{UnitQuaternion, Vector3};

/// The yaw of a quaternion: the heading of its x axis, radians.
#[must_use]
pub fn heading_of(rotation: &UnitQuaternion<f64>) -> f64 {
    let x = rotation * Vector3::x();
    x.y.atan2(x.x)
}
