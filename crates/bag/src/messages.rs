//! ROS 2 messages as structures: fields in the order of the `.msg` files, with their names. CDR, the text of a definition and
//! the type hash are derived from them.

use crate::cdr::{Cdr, CdrError, CdrReader, CdrWriter};
use csi5300::signal::csi::Csi as Matrix;
use csi5300::source::survey::Identity;
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Bfee};
use nalgebra::{Isometry3, Quaternion as Numbers, Translation3, UnitQuaternion};
use sha2::{Digest, Sha256};
use std::fmt::Write;

/// A type's name and parts in a definition.
pub trait Described {
    /// Its name as a field's type: `float64`, `std_msgs/Header`.
    fn name() -> String;
    /// The messages that it contains, each once, with their fields.
    fn parts(_into: &mut Vec<(String, String)>) {}
}

/// A message, or one half of a service.
pub trait Message: Cdr + Described + Clone + Send + 'static {
    /// `PACKAGE/msg/NAME` or `PACKAGE/srv/NAME`.
    const TYPE: &'static str;

    /// Its hash as nodes of ROS 2 from Iron on announce it: `RIHS01_` and 64 hexadecimal digits.
    #[must_use]
    fn type_hash() -> String {
        let mut parts = Vec::new();
        Self::parts(&mut parts);
        rihs01(&parts)
    }

    /// The full definition for recordings (`ros2msg`): its fields, then those of its parts.
    fn definition() -> String {
        let mut parts = Vec::new();
        Self::parts(&mut parts);
        let line = "=".repeat(80);
        let others = parts.iter().skip(1).map(|(name, text)| format!("{line}\nMSG: {name}\n{text}"));
        parts.first().map(|(_, text)| text.clone()).into_iter().chain(others).collect()
    }
}

macro_rules! basic {
    ($($kind:ty: $name:literal),*) => {$(
        impl Described for $kind {
            fn name() -> String {
                $name.into()
            }
        }
    )*};
}
basic!(bool: "bool", u8: "uint8", i8: "int8", u16: "uint16", i16: "int16", u32: "uint32", i32: "int32", u64: "uint64",
    i64: "int64", f32: "float32", f64: "float64", String: "string");

impl<T: Described> Described for Vec<T> {
    fn name() -> String {
        T::name() + "[]"
    }

    fn parts(into: &mut Vec<(String, String)>) {
        T::parts(into);
    }
}

impl<T: Described, const N: usize> Described for [T; N] {
    fn name() -> String {
        format!("{}[{N}]", T::name())
    }

    fn parts(into: &mut Vec<(String, String)>) {
        T::parts(into);
    }
}

/// Defines messages: `"PACKAGE/msg/NAME" Name { field: type, ... }`.
macro_rules! messages {
    ($($(#[$doc:meta])* $kind:literal $name:ident { $($field:ident: $type:ty),* $(,)? })*) => {$(
        $(#[$doc])*
        #[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
        #[allow(missing_docs, reason = "its fields are those of the message")]
        pub struct $name {
            $(pub $field: $type,)*
        }

        impl Cdr for $name {
            fn write(&self, to: &mut CdrWriter) {
                $(self.$field.write(to);)*
            }

            fn read(from: &mut CdrReader<'_>) -> Result<Self, CdrError> {
                $(let $field = <$type as Cdr>::read(from)?;)*
                Ok(Self { $($field),* })
            }
        }

        impl Described for $name {
            fn name() -> String {
                $kind.replace("/msg/", "/")
            }

            fn parts(into: &mut Vec<(String, String)>) {
                let name = <Self as Described>::name();
                if into.iter().all(|(known, _)| *known != name) {
                    let fields = [$((<$type as Described>::name(), stringify!($field))),*];
                    let line = |(kind, field): &(String, &str)| format!("{kind} {}\n", field.trim_start_matches("r#"));
                    into.push((name, fields.iter().map(line).collect()));
                    $(<$type as Described>::parts(into);)*
                }
            }
        }

        impl Message for $name {
            const TYPE: &'static str = $kind;
        }
    )*};
}

/// Defines values with a type name of their own, which CDR writes as the value inside.
macro_rules! renamed {
    ($($(#[$doc:meta])* $written:literal $name:ident($inner:ty))*) => {$(
        $(#[$doc])*
        #[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
        pub struct $name(pub $inner);

        impl Cdr for $name {
            fn write(&self, to: &mut CdrWriter) {
                self.0.write(to);
            }

            fn read(from: &mut CdrReader<'_>) -> Result<Self, CdrError> {
                Cdr::read(from).map(Self)
            }
        }

        impl Described for $name {
            fn name() -> String {
                $written.into()
            }
        }
    )*};
}
renamed! {
    /// A 6 x 6 covariance, row by row: 36 numbers.
    "float64[36]" Covariance([[f64; 6]; 6])
    /// `byte` of a `.msg` file, distinct from its `uint8`.
    "byte" Byte(u8)
    /// A name of at most 256 bytes, as the definition has it.
    "string<=256" Name(String)
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
    /// The rotation of the x axis to a direction, radians: about z by the azimuth, then up by the elevation.
    #[must_use]
    pub fn along(azimuth_rad: f64, elevation_rad: f64) -> Self {
        // About the rotated y axis; upwards is negative.
        let ((z, w), (up, level)) = ((0.5 * azimuth_rad).sin_cos(), (-0.5 * elevation_rad).sin_cos());
        Self { x: -z * up, y: w * up, z: z * level, w: w * level }
    }

    /// As a unit quaternion; `None` if it is invalid.
    #[must_use]
    pub fn rotation(&self) -> Option<UnitQuaternion<f64>> {
        isometry([0.0; 3], numbers(self)).map(|turned| turned.rotation)
    }
}

messages! {
    /// A texture coordinate.
    "visualization_msgs/msg/UVCoordinate" Texture { u: f32, v: f32 }
    /// A compressed image.
    "sensor_msgs/msg/CompressedImage" Picture { header: Header, format: String, data: Vec<u8> }
    /// A mesh.
    "visualization_msgs/msg/MeshFile" Mesh { filename: String, data: Vec<u8> }
    /// A shape to draw; see the constants below.
    "visualization_msgs/msg/Marker" Marker {
        header: Header, ns: String, id: i32, r#type: i32, action: i32, pose: Pose, scale: Vector3, color: Colour,
        lifetime: Duration, frame_locked: bool, points: Vec<Point>, colors: Vec<Colour>, texture_resource: String,
        texture: Picture, uv_coordinates: Vec<Texture>, text: String, mesh_resource: String, mesh_file: Mesh,
        mesh_use_embedded_materials: bool,
    }
    /// Several markers.
    "visualization_msgs/msg/MarkerArray" MarkerArray { markers: Vec<Marker> }
    /// A name and its value.
    "diagnostic_msgs/msg/KeyValue" KeyValue { key: String, value: String }
    /// The state of a part: 0 OK, 1 warning, 2 error, 3 stale.
    "diagnostic_msgs/msg/DiagnosticStatus" DiagnosticStatus {
        level: Byte, name: String, message: String, hardware_id: String, values: Vec<KeyValue>,
    }
    /// The states of several parts.
    "diagnostic_msgs/msg/DiagnosticArray" DiagnosticArray { header: Header, status: Vec<DiagnosticStatus> }
}

impl Marker {
    /// `type`: an arrow along `points`.
    pub const ARROW: i32 = 0;
    /// `type`: a sphere, or an ellipsoid by its `scale`.
    pub const SPHERE: i32 = 2;
    /// `type`: a cylinder, upright and round or elliptic by its `scale`.
    pub const CYLINDER: i32 = 3;
    /// `type`: a line strip through `points`.
    pub const LINE_STRIP: i32 = 4;
    /// `type`: text that faces the viewer.
    pub const TEXT: i32 = 9;
    /// `type`: triangles, three of `points` each.
    pub const TRIANGLES: i32 = 11;
    /// `action`: delete.
    pub const DELETE: i32 = 2;
}

messages! {
    /// The report of one peer.
    "csi5300_msgs/msg/Bearing" Bearing {
        header: Header, peer: String, mac: String, state: String, words: String, azimuth: f64, azimuth_sd: f64,
        azimuth_body: f64, mirror: f64, elevation: f64, signed_elevation: f64, range: f64, range_sd: f64, coherence: f64,
        confidence: f64, moved: f64, needed: f64, age: f64, pairs: u32,
    }
    /// One record of the card.
    "csi5300_msgs/msg/Csi" Csi {
        header: Header, mac: String, frame_count: u32, timestamp_low: u32, bfee_count: u16, n_rx: u8, n_tx: u8,
        rssi: [u8; 3], noise: i8, agc: u8, rate_n_flags: u16, antennas: Vec<u8>, re: Vec<i8>, im: Vec<i8>,
    }
    /// One record for display: |CSI| of one antenna by subcarrier, unscaled, and its phase, radians. In recordings only.
    "csi5300_msgs/msg/CsiRow" CsiRow {
        header: Header, sender: String, number: u32, card_us: u32, magnitude: Vec<f32>, phase: Vec<f32>,
    }
    /// Counts of a log's records and losses. In recordings only.
    "csi5300_msgs/msg/Counters" Counters {
        header: Header, records: u64, damages: u64, damaged_bytes: u64, impossible_records: u64, overruns: u64,
        bfee_missing: u64,
    }
}

impl Csi {
    /// From a record of the card and what is known of its sender.
    #[must_use]
    pub fn of(stamp: Time, bfee: &Bfee<'_>, identity: Identity) -> Self {
        let known = Matrix::from_bfee(bfee).ok();
        let matrix = known.unwrap_or_else(|| Matrix::raw(bfee));
        let antenna = |row: usize| known.and_then(|known| known.antenna(row));
        let number = |antenna: Antenna| Antenna::ALL.iter().position(|other| *other == antenna).unwrap_or(0) as u8;
        Self {
            header: Header { stamp, frame_id: String::new() },
            mac: if identity.mac == Mac::ZERO { String::new() } else { identity.mac.to_string() },
            frame_count: identity.frame_count.unwrap_or(0),
            timestamp_low: bfee.timestamp_low(),
            bfee_count: bfee.bfee_count(),
            n_rx: matrix.n_rx() as u8,
            n_tx: matrix.n_tx() as u8,
            rssi: bfee.rssi(),
            noise: bfee.noise_dbm(),
            agc: bfee.agc(),
            rate_n_flags: bfee.rate_n_flags(),
            antennas: (0..matrix.n_rx()).filter_map(antenna).map(number).collect(),
            // The card's 8 bits.
            re: matrix.as_slice().iter().map(|h| h.re as i8).collect(),
            im: matrix.as_slice().iter().map(|h| h.im as i8).collect(),
        }
    }
}

messages! {
    /// The request; ROS gives an empty message this field.
    "std_srvs/srv/Trigger_Request" TriggerRequest { structure_needs_at_least_one_member: u8 }
    /// Success, and a text.
    "std_srvs/srv/Trigger_Response" TriggerResponse { success: bool, message: String }
    /// The request; ROS gives an empty message this field.
    "diagnostic_msgs/srv/SelfTest_Request" SelfTestRequest { structure_needs_at_least_one_member: u8 }
    /// What was tested, whether all tests passed (1) or not (0), and each test.
    "diagnostic_msgs/srv/SelfTest_Response" SelfTestResponse { id: String, passed: Byte, status: Vec<DiagnosticStatus> }
    /// A parameter's value: the one of the type that `type` names (1 bool, 2 integer, 3 double, 4 string).
    "rcl_interfaces/msg/ParameterValue" ParameterValue {
        r#type: u8, bool_value: bool, integer_value: i64, double_value: f64, string_value: String,
        byte_array_value: Vec<Byte>, bool_array_value: Vec<bool>, integer_array_value: Vec<i64>,
        double_array_value: Vec<f64>, string_array_value: Vec<String>,
    }
    /// Which parameters.
    "rcl_interfaces/srv/GetParameters_Request" GetParametersRequest { names: Vec<String> }
    /// Their values.
    "rcl_interfaces/srv/GetParameters_Response" GetParametersResponse { values: Vec<ParameterValue> }
    /// Parameters with these prefixes, to this depth.
    "rcl_interfaces/srv/ListParameters_Request" ListParametersRequest { prefixes: Vec<String>, depth: u64 }
    /// Their names.
    "rcl_interfaces/msg/ListParametersResult" ListParametersResult { names: Vec<String>, prefixes: Vec<String> }
    /// The answer.
    "rcl_interfaces/srv/ListParameters_Response" ListParametersResponse { result: ListParametersResult }
}

messages! {
    /// An endpoint's identifier, from Iron on.
    "rmw_dds_common/msg/Gid" Gid { data: [u8; 16] }
    /// A node and its endpoints.
    "rmw_dds_common/msg/NodeEntitiesInfo" NodeEntitiesInfo {
        node_namespace: Name, node_name: Name, reader_gid_seq: Vec<Gid>, writer_gid_seq: Vec<Gid>,
    }
    /// A participant and its nodes.
    "rmw_dds_common/msg/ParticipantEntitiesInfo" ParticipantEntitiesInfo {
        gid: Gid, node_entities_info_seq: Vec<NodeEntitiesInfo>,
    }
}

/// Numbers of basic types (`type_description_interfaces/msg/FieldType`); ROS 2 maps `char` to `uint8`.
const BASIC: [(&str, u32); 15] = [
    ("int8", 2),
    ("uint8", 3),
    ("int16", 4),
    ("uint16", 5),
    ("int32", 6),
    ("uint32", 7),
    ("int64", 8),
    ("uint64", 9),
    ("float32", 10),
    ("float64", 11),
    ("char", 3),
    ("bool", 15),
    ("byte", 16),
    ("string", 17),
    ("string<", 21),
];
/// The number of a nested message.
const NESTED: u32 = 1;
/// Added to the type's number for an array of fixed length, and for an unbounded list.
const ARRAY: u32 = 48;
/// See [`ARRAY`].
const LIST: u32 = 144;

/// `std_msgs/Header` as `std_msgs/msg/Header`; halves of services already have the full name.
fn whole(name: &str) -> String {
    if name.matches('/').count() == 1 { name.replace('/', "/msg/") } else { name.to_owned() }
}

/// The type of a field: `float64[36]`, `string<=256`, `std_msgs/Header`.
fn field_type(written: &str) -> String {
    let (value, length) = written.strip_suffix(']').and_then(|rest| rest.split_once('[')).unwrap_or((written, "-"));
    let (more, capacity) = match length {
        "-" => (0, "0"),
        "" => (LIST, "0"),
        length => (ARRAY, length),
    };
    let (value, longest) = value.split_once('=').unwrap_or((value, "0"));
    let basic = BASIC.iter().find(|(name, _)| *name == value).map(|(_, number)| *number);
    let nested = if basic.is_some() { String::new() } else { whole(value) };
    let number = basic.unwrap_or(NESTED) + more;
    format!(
        "{{\"type_id\": {number}, \"capacity\": {capacity}, \"string_capacity\": {longest}, \"nested_type_name\": \"{nested}\"}}"
    )
}

/// One type, from its name and the lines of its definition.
fn description((name, text): &(String, String)) -> String {
    let fields = text.lines().filter_map(|line| line.split_once(' '));
    let field = |(kind, name): (&str, &str)| format!("{{\"name\": \"{name}\", \"type\": {}}}", field_type(kind));
    let fields: Vec<String> = fields.map(field).collect();
    format!("{{\"type_name\": \"{}\", \"fields\": [{}]}}", whole(name), fields.join(", "))
}

/// The hash of the first of these types; the others are its parts.
fn rihs01(parts: &[(String, String)]) -> String {
    let Some((first, others)) = parts.split_first() else { return String::new() };
    let mut others: Vec<_> = others.iter().map(|part| (whole(&part.0), description(part))).collect();
    others.sort();
    let others: Vec<String> = others.into_iter().map(|(_, text)| text).collect();
    let json = format!(
        "{{\"type_description\": {}, \"referenced_type_descriptions\": [{}]}}",
        description(first),
        others.join(", ")
    );
    Sha256::digest(json.as_bytes()).iter().fold("RIHS01_".to_owned(), |mut hash, byte| {
        let _ = write!(hash, "{byte:02x}");
        hash
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As ROS 2 Jazzy's own packages have them (`share/PACKAGE/msg/NAME.json`); nodes of Kilted and Lyrical announce the same.
    #[test]
    fn type_hashes_equal_those_of_ros_2_nodes() {
        for (own, published) in [
            (Header::type_hash(), "f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01"),
            (Text::type_hash(), "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
            (Odometry::type_hash(), "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"),
            (PoseStamped::type_hash(), "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"),
            (
                PoseWithCovarianceStamped::type_hash(),
                "26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
            ),
            (TfMessage::type_hash(), "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"),
            (Imu::type_hash(), "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"),
            (Clock::type_hash(), "692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564"),
            (Path::type_hash(), "1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b"),
            (LaserScan::type_hash(), "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"),
            (MarkerArray::type_hash(), "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf"),
            (DiagnosticArray::type_hash(), "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"),
            (ParticipantEntitiesInfo::type_hash(), "91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"),
            (ParameterValue::type_hash(), "115fc089a387e23c7ecd3525c9189c379109119d6ab82e8dfbde0fdf6a7f9b68"),
            (ListParametersRequest::type_hash(), "a1b0b5d6b967a5b8ac5bc8563c3ea678f349e312a6a4967227c5a96bc5ce38df"),
            (TriggerRequest::type_hash(), "d010825374ce8918e72bfd826c82603e60f45419e932ea976f807b74a863a199"),
            (TriggerResponse::type_hash(), "2d946c21e2fc3f1e9ca6986a8191d85fcc70097a8bb7771a053564bc47009cdf"),
        ] {
            assert_eq!(own, format!("RIHS01_{published}"));
        }
    }

    /// The fields of a `.msg` file.
    fn fields(text: &str) -> String {
        let plain =
            |line: &str| line.split('#').next().unwrap_or_default().split_whitespace().collect::<Vec<_>>().join(" ");
        text.lines().map(plain).filter(|line| !line.is_empty()).map(|line| line + "\n").collect()
    }

    #[test]
    fn sent_messages_match_the_shipped_files() {
        let own = |parts: fn(&mut Vec<(String, String)>)| {
            let mut all = Vec::new();
            parts(&mut all);
            all.remove(0)
        };
        let bearing = include_str!("../../../packaging/ros2/csi5300_msgs/msg/Bearing.msg");
        assert_eq!(own(Bearing::parts), ("csi5300_msgs/Bearing".into(), fields(bearing)));
        let csi = include_str!("../../../packaging/ros2/csi5300_msgs/msg/Csi.msg");
        assert_eq!(own(Csi::parts), ("csi5300_msgs/Csi".into(), fields(csi)));
    }

    #[test]
    fn a_definition_has_every_part_once() {
        let text = Odometry::definition();
        let begin = "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n\
                     geometry_msgs/TwistWithCovariance twist\n====";
        assert!(text.starts_with(begin), "{text}");
        let names: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("MSG: ")).collect();
        let all = [
            "std_msgs/Header",
            "builtin_interfaces/Time",
            "geometry_msgs/PoseWithCovariance",
            "geometry_msgs/Pose",
            "geometry_msgs/Point",
            "geometry_msgs/Quaternion",
            "geometry_msgs/TwistWithCovariance",
            "geometry_msgs/Twist",
            "geometry_msgs/Vector3",
        ];
        assert_eq!(names, all);
        assert!(text.contains("float64[36] covariance\n"));
    }

    #[test]
    fn odometry_round_trips_and_cut_odometry_is_refused() {
        let mut odometry = Odometry { child_frame_id: "base_link".into(), ..Odometry::default() };
        odometry.header.frame_id = "odom".into();
        odometry.pose.pose.position.x = 1.5;
        odometry.pose.covariance.0[5][5] = 0.25;
        odometry.twist.twist.angular.z = -2.0;
        let payload = odometry.payload();
        assert_eq!(Odometry::of_payload(&payload), Ok(odometry));
        for cut in 0..payload.len() {
            assert!(Odometry::of_payload(&payload[..cut]).is_err());
        }
    }

    #[test]
    fn a_range_of_humble_has_no_variance_and_one_outside_of_its_limits_is_unusable() {
        let mut range =
            Range { min_range: 0.2, max_range: 50.0, range: 4.0, variance: Variance(0.01), ..Range::default() };
        range.header.frame_id = "uwb".into();
        let payload = range.payload();
        assert_eq!(Range::of_payload(&payload), Ok(range.clone()));
        let [range_m, sd_m] = range.metres().unwrap();
        assert!(range_m == 4.0 && (sd_m - 0.1).abs() < 1e-6);
        let humble = Range::of_payload(&payload[..payload.len() - 4]).unwrap();
        assert_eq!(humble.metres(), Some([4.0, 0.0]));
        assert!(Range::of_payload(&payload[..payload.len() - 2]).is_err());
        for wrong in [f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 0.1, 50.5, -1.0] {
            assert_eq!(Range { range: wrong, ..range.clone() }.metres(), None, "{wrong}");
        }
        // Without limits, any range counts.
        assert_eq!(Range { range: 70.0, ..Range::default() }.metres(), Some([70.0, 0.0]));
    }

    #[test]
    fn times_are_whole() {
        assert_eq!(Time::from_us(-1), Time { sec: -1, nanosec: 999_999_000 });
        assert_eq!(Time::from_us(12_250_000), Time { sec: 12, nanosec: 250_000_000 });
        assert_eq!(Time::from_us(12_250_000).us(), 12_250_000);
        assert_eq!(Time::from_us(i64::MAX), Time::default());
    }
}
