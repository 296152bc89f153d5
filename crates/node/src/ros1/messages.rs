//! Messages as they are on the wire: fields in their order, little-endian, strings and lists with their length before
//! them (serde does that). Names are the field names of the `.msg` files.

use roslibrust::{MessageDescriptor, RosMessageType};
use serde::{Deserialize, Serialize};

/// Between the texts of a message and of those it is made of, as `gendeps --cat` has it.
macro_rules! definition {
    ($own:expr; $($name:literal: $text:expr),+) => {
        concat!($own, $(
            "\n================================================================================\nMSG: ", $name, "\n", $text
        ),+)
    };
}

macro_rules! header {
    () => {
        "uint32 seq\ntime stamp\nstring frame_id\n"
    };
}

macro_rules! point {
    () => {
        "float64 x\nfloat64 y\nfloat64 z\n"
    };
}

macro_rules! quaternion {
    () => {
        "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    };
}

macro_rules! pose {
    () => {
        "Point position\nQuaternion orientation\n"
    };
}

/// A time: seconds and nanoseconds since the Unix epoch, or of a simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Time {
    /// Seconds.
    pub secs: u32,
    /// Nanoseconds.
    pub nsecs: u32,
}

impl Time {
    /// From microseconds since the Unix epoch; 0 for what a message cannot hold.
    #[must_use]
    pub fn from_us(us: i64) -> Self {
        let nsecs = us.rem_euclid(1_000_000) as u32 * 1_000;
        u32::try_from(us.div_euclid(1_000_000)).map_or_else(|_| Self::default(), |secs| Self { secs, nsecs })
    }

    /// From seconds since the Unix epoch; 0 for what a message cannot hold.
    #[must_use]
    pub fn from_s(t_s: f64) -> Self {
        if !(0.0..4_294_967_295.0).contains(&t_s) {
            return Self::default();
        }
        let nsecs = ((t_s - t_s.floor()) * 1e9).round() as u32;
        Self { secs: t_s as u32 + nsecs / 1_000_000_000, nsecs: nsecs % 1_000_000_000 }
    }
}

/// `std_msgs/Header`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Number of the message.
    pub seq: u32,
    /// Its time.
    pub stamp: Time,
    /// The frame that it is in.
    pub frame_id: String,
}

/// `geometry_msgs/Point` and `geometry_msgs/Vector3`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector {
    /// Metres, or per second, or radians per second.
    pub x: f64,
    /// The same.
    pub y: f64,
    /// The same.
    pub z: f64,
}

/// `geometry_msgs/Quaternion`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// First imaginary part.
    pub x: f64,
    /// Second imaginary part.
    pub y: f64,
    /// Third imaginary part.
    pub z: f64,
    /// Real part.
    pub w: f64,
}

/// `geometry_msgs/Pose`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Metres.
    pub position: Vector,
    /// A rotation.
    pub orientation: Quaternion,
}

/// `geometry_msgs/PoseStamped`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    /// Time and frame.
    pub header: Header,
    /// The pose.
    pub pose: Pose,
}

/// A covariance of six values, row by row; on the wire 36 numbers.
pub type Covariance = [[f64; 6]; 6];

/// `nav_msgs/Odometry`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// Time, and the frame of the pose.
    pub header: Header,
    /// The frame of the twist.
    pub child_frame_id: String,
    /// Where the robot is.
    pub pose: Pose,
    /// How well that is known.
    pub pose_covariance: Covariance,
    /// Speed.
    pub linear: Vector,
    /// Turning.
    pub angular: Vector,
    /// How well they are known.
    pub twist_covariance: Covariance,
}

/// `csi5300_msgs/Bearing`, see its file in `packaging/ros`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Bearing {
    pub header: Header,
    pub peer: String,
    pub mac: String,
    pub state: String,
    pub words: String,
    pub azimuth: f64,
    pub azimuth_sd: f64,
    pub azimuth_body: f64,
    pub mirror: f64,
    pub elevation: f64,
    pub signed_elevation: f64,
    pub range: f64,
    pub range_sd: f64,
    pub coherence: f64,
    pub confidence: f64,
    pub moved: f64,
    pub needed: f64,
    pub age: f64,
    pub pairs: u32,
}

/// `csi5300_msgs/Csi`, see its file in `packaging/ros`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Csi {
    pub header: Header,
    pub mac: String,
    pub frame_count: u32,
    pub timestamp_low: u32,
    pub bfee_count: u16,
    pub n_rx: u8,
    pub n_tx: u8,
    pub rssi: [u8; 3],
    pub noise: i8,
    pub agc: u8,
    pub rate_n_flags: u16,
    pub antennas: Vec<u8>,
    pub re: Vec<i8>,
    pub im: Vec<i8>,
}

/// A message of ROS 1: its name, the sum of its text, and the text.
const fn described<T: RosMessageType>(
    name: &'static str,
    md5sum: &'static str,
    definition: &'static str,
) -> MessageDescriptor {
    MessageDescriptor::new::<T>(name, md5sum, definition, "", &[0; 32])
}

impl RosMessageType for PoseStamped {
    const DESCRIPTION: MessageDescriptor = described::<Self>(
        "geometry_msgs/PoseStamped",
        "d3812c3cbc69362b77dc0b19b345f8f5",
        definition!(
            "std_msgs/Header header\ngeometry_msgs/Pose pose\n";
            "std_msgs/Header": header!(), "geometry_msgs/Pose": pose!(), "geometry_msgs/Point": point!(),
            "geometry_msgs/Quaternion": quaternion!()
        ),
    );
}

impl RosMessageType for Odometry {
    const DESCRIPTION: MessageDescriptor = described::<Self>(
        "nav_msgs/Odometry",
        "cd5e73d190d741a2f92e81eda573aca7",
        definition!(
            "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n\
             geometry_msgs/TwistWithCovariance twist\n";
            "std_msgs/Header": header!(), "geometry_msgs/PoseWithCovariance": "Pose pose\nfloat64[36] covariance\n",
            "geometry_msgs/Pose": pose!(), "geometry_msgs/Point": point!(), "geometry_msgs/Quaternion": quaternion!(),
            "geometry_msgs/TwistWithCovariance": "Twist twist\nfloat64[36] covariance\n",
            "geometry_msgs/Twist": "Vector3 linear\nVector3 angular\n", "geometry_msgs/Vector3": point!()
        ),
    );
}

impl RosMessageType for Bearing {
    const DESCRIPTION: MessageDescriptor = described::<Self>(
        "csi5300_msgs/Bearing",
        "45d77aede8091d290858ee3bc10929d8",
        definition!(
            include_str!("../../../../packaging/ros/csi5300_msgs/msg/Bearing.msg");
            "std_msgs/Header": header!()
        ),
    );
}

impl RosMessageType for Csi {
    const DESCRIPTION: MessageDescriptor = described::<Self>(
        "csi5300_msgs/Csi",
        "06ae38ed8668d9e96d9bd0fc2a748063",
        definition!(
            include_str!("../../../../packaging/ros/csi5300_msgs/msg/Csi.msg");
            "std_msgs/Header": header!()
        ),
    );
}

impl Odometry {
    /// The part that is used.
    #[must_use]
    pub fn pose(&self) -> csi5300::motion::odometry::ros::Message<'_> {
        used(&self.header, &self.pose)
    }
}

impl PoseStamped {
    /// The part that is used.
    #[must_use]
    pub fn pose(&self) -> csi5300::motion::odometry::ros::Message<'_> {
        used(&self.header, &self.pose)
    }
}

fn used<'a>(header: &'a Header, pose: &Pose) -> csi5300::motion::odometry::ros::Message<'a> {
    let (at, turned) = (pose.position, pose.orientation);
    csi5300::motion::odometry::ros::Message {
        stamp: (header.stamp.secs, header.stamp.nsecs),
        frame: &header.frame_id,
        position_m: [at.x, at.y, at.z],
        orientation: [turned.x, turned.y, turned.z, turned.w],
    }
}

#[cfg(test)]
mod tests;
