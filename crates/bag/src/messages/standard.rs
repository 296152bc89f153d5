//! Times, poses, odometry, transforms.

use super::{Described, messages};
use crate::cdr::{Cdr, CdrError, CdrReader, CdrWriter};
use nalgebra::{Isometry3, Quaternion as Numbers, Translation3, UnitQuaternion};

/// A 6 x 6 covariance, row by row: 36 numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Covariance(pub [[f64; 6]; 6]);

impl Cdr for Covariance {
    fn write(&self, to: &mut CdrWriter) {
        self.0.write(to);
    }

    fn read(from: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        Cdr::read(from).map(Self)
    }
}

impl Described for Covariance {
    fn name() -> String {
        "float64[36]".into()
    }
}

/// The last field of a message, which releases up to Humble lack: 0 there.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Variance(pub f32);

impl Cdr for Variance {
    fn write(&self, to: &mut CdrWriter) {
        self.0.write(to);
    }

    fn read(from: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        if from.rest().is_empty() { Ok(Self::default()) } else { Cdr::read(from).map(Self) }
    }
}

impl Described for Variance {
    fn name() -> String {
        "float32".into()
    }
}

messages! {
    /// Seconds and nanoseconds since the Unix epoch, or simulated.
    "builtin_interfaces/msg/Time" Time { sec: i32, nanosec: u32 }
    /// A length of time.
    "builtin_interfaces/msg/Duration" Duration { sec: i32, nanosec: u32 }
    /// Time and frame of a message.
    "std_msgs/msg/Header" Header { stamp: Time, frame_id: String }
    /// Text, here JSON.
    "std_msgs/msg/String" Text { data: String }
    /// A colour, 0 to 1.
    "std_msgs/msg/ColorRGBA" Colour { r: f32, g: f32, b: f32, a: f32 }
    /// A place, metres.
    "geometry_msgs/msg/Point" Point { x: f64, y: f64, z: f64 }
    /// Metres, or per second, or radians per second.
    "geometry_msgs/msg/Vector3" Vector3 { x: f64, y: f64, z: f64 }
    /// A rotation.
    "geometry_msgs/msg/Quaternion" Quaternion { x: f64, y: f64, z: f64, w: f64 }
    /// Position and orientation.
    "geometry_msgs/msg/Pose" Pose { position: Point, orientation: Quaternion }
    /// A pose with time and frame.
    "geometry_msgs/msg/PoseStamped" PoseStamped { header: Header, pose: Pose }
    /// Poses, in order of time.
    "nav_msgs/msg/Path" Path { header: Header, poses: Vec<PoseStamped> }
    /// Distances by direction in a plane, radians from its x axis.
    "sensor_msgs/msg/LaserScan" LaserScan {
        header: Header, angle_min: f32, angle_max: f32, angle_increment: f32, time_increment: f32, scan_time: f32,
        range_min: f32, range_max: f32, ranges: Vec<f32>, intensities: Vec<f32>,
    }
    /// A pose with its covariance: x, y, z, rotations about x, y, z.
    "geometry_msgs/msg/PoseWithCovariance" PoseWithCovariance { pose: Pose, covariance: Covariance }
    /// The same with time and frame.
    "geometry_msgs/msg/PoseWithCovarianceStamped" PoseWithCovarianceStamped { header: Header, pose: PoseWithCovariance }
    /// Velocities.
    "geometry_msgs/msg/Twist" Twist { linear: Vector3, angular: Vector3 }
    /// Velocities with covariance.
    "geometry_msgs/msg/TwistWithCovariance" TwistWithCovariance { twist: Twist, covariance: Covariance }
    /// A transform.
    "geometry_msgs/msg/Transform" Transform { translation: Vector3, rotation: Quaternion }
    /// The transform from the header's frame to the child frame.
    "geometry_msgs/msg/TransformStamped" TransformStamped { header: Header, child_frame_id: String, transform: Transform }
    /// Several transforms, as on `/tf`.
    "tf2_msgs/msg/TFMessage" TfMessage { transforms: Vec<TransformStamped> }
    /// A robot's pose by its own odometry.
    "nav_msgs/msg/Odometry" Odometry {
        header: Header, child_frame_id: String, pose: PoseWithCovariance, twist: TwistWithCovariance,
    }
    /// Measurements of an inertial unit; the orientation is valid unless the first value of its covariance is -1.
    "sensor_msgs/msg/Imu" Imu {
        header: Header, orientation: Quaternion, orientation_covariance: [f64; 9], angular_velocity: Vector3,
        angular_velocity_covariance: [f64; 9], linear_acceleration: Vector3, linear_acceleration_covariance: [f64; 9],
    }
    /// A range in metres, with its variance where known (0: unknown).
    "sensor_msgs/msg/Range" Range {
        header: Header, radiation_type: u8, field_of_view: f32, min_range: f32, max_range: f32, range: f32, variance: Variance,
    }
    /// Simulated time.
    "rosgraph_msgs/msg/Clock" Clock { clock: Time }
}

impl Time {
    /// From microseconds; 0 where a message cannot represent it.
    pub fn from_us(us: i64) -> Self {
        let nanosec = us.rem_euclid(1_000_000) as u32 * 1_000;
        i32::try_from(us.div_euclid(1_000_000)).map_or_else(|_| Self::default(), |sec| Self { sec, nanosec })
    }

    /// Microseconds.
    pub fn us(&self) -> i64 {
        i64::from(self.sec) * 1_000_000 + i64::from(self.nanosec) / 1_000
    }
}

impl Range {
    /// The range, metres, and its deviation (0: unknown); `None` if it is not finite or outside of its own limits.
    #[must_use]
    pub fn metres(&self) -> Option<[f64; 2]> {
        let is_within = self.max_range <= self.min_range || (self.min_range..=self.max_range).contains(&self.range);
        let is_usable = self.range.is_finite() && self.range > 0.0 && is_within;
        let variance = if self.variance.0.is_finite() { self.variance.0.max(0.0) } else { 0.0 };
        is_usable.then(|| [f64::from(self.range), f64::from(variance).sqrt()])
    }
}

impl From<[f64; 3]> for Point {
    fn from([x, y, z]: [f64; 3]) -> Self {
        Self { x, y, z }
    }
}

/// Rotation and translation, if all numbers are finite and the quaternion is not zero.
fn isometry(at: [f64; 3], turned: [f64; 4]) -> Option<Isometry3<f64>> {
    let [x, y, z, w] = turned;
    let rotation = Numbers::new(w, x, y, z);
    let norm = rotation.norm();
    let good = at.iter().all(|x| x.is_finite()) && norm.is_finite() && norm > 1e-6;
    good.then(|| Isometry3::from_parts(Translation3::from(at), UnitQuaternion::from_quaternion(rotation)))
}

fn numbers(turned: &Quaternion) -> [f64; 4] {
    [turned.x, turned.y, turned.z, turned.w]
}

impl Transform {
    /// As an isometry; `None` if it is invalid.
    #[must_use]
    pub fn isometry(&self) -> Option<Isometry3<f64>> {
        let at = &self.translation;
        isometry([at.x, at.y, at.z], numbers(&self.rotation))
    }
}

impl Pose {
    /// As an isometry; `None` if it is invalid.
    #[must_use]
    pub fn isometry(&self) -> Option<Isometry3<f64>> {
        let at = &self.position;
        isometry([at.x, at.y, at.z], numbers(&self.orientation))
    }
}

impl Quaternion {
    /// As a unit quaternion; `None` if it is invalid.
    #[must_use]
    pub fn rotation(&self) -> Option<UnitQuaternion<f64>> {
        isometry([0.0; 3], numbers(self)).map(|turned| turned.rotation)
    }
}
