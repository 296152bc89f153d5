//! Places of antenna and camera on the receiver's robot.

use super::args::triple;
use csi5300::motion::pose::Mount;
use csi5300::motion::pose::Trajectory;
use nalgebra::Vector3;

// Places of antenna and camera on the robot.
#[derive(clap::Args, Clone, Default)]
pub struct Mounting {
    /// Position of the antenna relative to the tracked point: metres forward, left, up
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_negative_numbers = true, allow_hyphen_values = true)]
    pub antenna_offset: Option<Vector3<f64>>,
    /// Position of the tracking camera: metres forward and left of the middle between the wheels, and its heading minus the
    /// robot's, degrees. --antenna-offset is then relative to that middle, and only rolling motion is kept
    #[arg(
        long,
        value_name = "X,Y,YAW",
        value_parser = mount,
        requires = "antenna_offset",
        hide_short_help = true,
        allow_negative_numbers = true,
        allow_hyphen_values = true
    )]
    pub camera_mount: Option<Mount>,
}

impl Mounting {
    /// The antenna's trajectory, from the recorded one.
    ///
    /// # Errors
    /// If that has no heading, in words.
    pub fn of_antenna(&self, recorded: Trajectory) -> Result<Trajectory, String> {
        let rolled = self.camera_mount.map(|mount| recorded.rolling(&mount)).transpose();
        let moved = rolled.and_then(|rolled| {
            let own = rolled.unwrap_or(recorded);
            self.antenna_offset.map_or(Ok(own.clone()), |offset| own.with_antenna_offset(offset))
        });
        moved.map_err(|error| error.to_string())
    }
}

/// Metres forward and left, and degrees.
fn mount(text: &str) -> Result<Mount, String> {
    let place =
        triple(text).map_err(|_| "three finite numbers separated by commas: metres, metres, degrees".to_owned())?;
    Ok(Mount { offset_m: Vector3::new(place.x, place.y, 0.0), yaw_rad: place.z.to_radians() })
}
