//! The type hash, with which nodes of ROS 2 from Iron on compare definitions: RIHS01 (REP-2016), the SHA-256 of the type's
//! description as JSON (`calculate_type_hash` of `rosidl_generator_type_description`).

use sha2::{Digest, Sha256};
use std::fmt::Write;

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
pub(super) fn rihs01(parts: &[(String, String)]) -> String {
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
    use super::super::Message;
    use super::super::graph::ParticipantEntitiesInfo;
    use super::super::services::{ListParametersRequest, ParameterValue, TriggerRequest, TriggerResponse};
    use super::super::shown::{DiagnosticArray, MarkerArray};
    use super::super::standard::{
        Clock, Header, Imu, LaserScan, Odometry, Path, PoseStamped, PoseWithCovarianceStamped, Text, TfMessage,
    };

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
}
