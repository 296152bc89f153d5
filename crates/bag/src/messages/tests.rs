use super::own::{Bearing, Csi};
use super::standard::{Odometry, Range, Time, Variance};
use super::{Cdr, Described, Message};

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
    let bearing = include_str!("../../../../packaging/ros2/csi5300_msgs/msg/Bearing.msg");
    assert_eq!(own(Bearing::parts), ("csi5300_msgs/Bearing".into(), fields(bearing)));
    let csi = include_str!("../../../../packaging/ros2/csi5300_msgs/msg/Csi.msg");
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
    let mut range = Range { min_range: 0.2, max_range: 50.0, range: 4.0, variance: Variance(0.01), ..Range::default() };
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
