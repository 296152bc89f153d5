//! What motion capture of the other places says of a robot: where its antenna is, and how it carries its camera.

use super::gather::set_and_place;
use crate::evaluate::{Capture, TrajectorySource, Travel, usual_offset_m};
use csi5300::maths::median;
use csi5300::motion::rolling::Mount;
use nalgebra::{Rotation2, Vector2, Vector3};
use rayon::prelude::*;

/// What one capture shows.
struct Measured {
    place: String,
    /// The antenna seen from the middle between the wheels, metres forward and left.
    from_wheels_m: Option<[f64; 2]>,
    /// The same from the camera.
    from_camera_m: Option<[f64; 2]>,
    travel: Option<Travel>,
}

impl Measured {
    fn of(capture: &Capture) -> Self {
        Self {
            place: set_and_place(&capture.place).1,
            from_wheels_m: capture.measured_offset_m(TrajectorySource::Odometry),
            from_camera_m: capture.measured_offset_m(TrajectorySource::T265),
            travel: capture.measured_travel(),
        }
    }
}

/// The captures with antenna and camera where the captures of the other places show them.
pub(super) fn mounted(captures: &[Capture]) -> Vec<Capture> {
    let measured: Vec<Measured> = captures.par_iter().map(Measured::of).collect();
    let one = |capture: &Capture| {
        let own = set_and_place(&capture.place).1;
        let others: Vec<&Measured> = measured.iter().filter(|other| other.place != own).collect();
        let from_wheels_m = usual_offset_m(others.iter().filter_map(|other| other.from_wheels_m));
        let antenna_offset_m = from_wheels_m.map(|[forward, left]| [forward, left, 0.0]).or(capture.antenna_offset_m);
        let camera = from_wheels_m.and_then(|antenna_m| mount(&others, antenna_m)).or(capture.camera);
        Capture { antenna_offset_m, camera, ..capture.clone() }
    };
    captures.iter().map(one).collect()
}

/// How the camera is mounted where the antenna is `antenna_m` forward and left of the middle between the wheels.
fn mount(others: &[&Measured], antenna_m: [f64; 2]) -> Option<Mount> {
    let mut yaws: Vec<f64> = others.iter().filter_map(|other| other.travel?.yaw_rad(antenna_m)).collect();
    let yaw_rad = median(&mut yaws)?;
    let from_camera_m = usual_offset_m(others.iter().filter_map(|other| other.from_camera_m))?;
    let camera_m = Vector2::from(antenna_m) - Rotation2::new(yaw_rad) * Vector2::from(from_camera_m);
    Some(Mount::new(Vector3::new(camera_m.x, camera_m.y, 0.0), yaw_rad))
}
