use super::*;
use roslibrust_serde_rosmsg::{from_slice, to_vec};

#[test]
fn the_sums_are_those_of_the_texts() {
    fn same<T: RosMessageType>() {
        let told = T::DESCRIPTION;
        let sum = roslibrust::md5sum::from_message_definition(told.ros_type_name, told.definition).unwrap();
        assert_eq!(sum, told.md5sum, "{}", told.ros_type_name);
    }
    // The first two are those of ROS itself (`rosmsg md5`).
    same::<PoseStamped>();
    same::<Odometry>();
    same::<Bearing>();
    same::<Csi>();
}

fn bytes(hex: &str) -> Vec<u8> {
    let digits: Vec<u8> = hex.bytes().filter(u8::is_ascii_hexdigit).collect();
    digits.chunks(2).map(|two| u8::from_str_radix(std::str::from_utf8(two).unwrap(), 16).unwrap()).collect()
}

/// The same message in both directions. On the wire its length stands before it, which the library takes off.
fn same<T: RosMessageType + PartialEq>(message: &T, body: &[u8]) {
    let sent = to_vec(message).unwrap();
    let (length, sent) = sent.split_at(4);
    assert_eq!((length, sent), (&u32::try_from(body.len()).unwrap().to_le_bytes()[..], body));
    let framed: Vec<u8> = length.iter().chain(body).copied().collect();
    assert_eq!(&from_slice::<T>(&framed).unwrap(), message);
}

/// Sequence 7, 1,700,000,000.25 s, "odom".
const HEADER: &str = "07000000 00f15365 80b2e60e 04000000 6f646f6d";
/// (1.5, -2.25, 0.125), (0, 0, 0.6, 0.8).
const POSE: &str = "000000000000f83f 00000000000002c0 000000000000c03f \
                    0000000000000000 0000000000000000 333333333333e33f 9a9999999999e93f";

fn header() -> Header {
    Header { seq: 7, stamp: Time::from_s(1_700_000_000.25), frame_id: "odom".into() }
}

fn pose() -> Pose {
    let orientation = Quaternion { z: 0.6, w: 0.8, ..Quaternion::default() };
    Pose { position: Vector { x: 1.5, y: -2.25, z: 0.125 }, orientation }
}

// All bytes here were written by genpy (Debian 12).

#[test]
fn a_pose_is_what_ros_writes() {
    let message = PoseStamped { header: header(), pose: pose() };
    same(&message, &bytes(&format!("{HEADER}{POSE}")));
    let used = message.pose();
    assert_eq!(
        (used.stamp, used.frame, used.orientation),
        ((1_700_000_000, 250_000_000), "odom", [0.0, 0.0, 0.6, 0.8])
    );
}

#[test]
fn odometry_is_what_ros_writes() {
    let covariance = |sign: f64| std::array::from_fn(|row| std::array::from_fn(|k| sign * (6 * row + k) as f64));
    let message = Odometry {
        header: header(),
        child_frame_id: "tb3_0/base_footprint".into(),
        pose: pose(),
        pose_covariance: covariance(1.0),
        linear: Vector { x: 0.2, ..Vector::default() },
        angular: Vector { z: -0.5, ..Vector::default() },
        twist_covariance: covariance(-1.0),
    };
    let mut golden = bytes(&format!("{HEADER} 14000000 7462335f302f626173655f666f6f747072696e74 {POSE}"));
    let mut numbers = |numbers: &[f64]| numbers.iter().for_each(|x| golden.extend(x.to_le_bytes()));
    numbers(&std::array::from_fn::<f64, 36, _>(|k| k as f64));
    numbers(&[0.2, 0.0, 0.0, 0.0, 0.0, -0.5]);
    // Of the first, 0 times -1, the sign is kept.
    numbers(&std::array::from_fn::<f64, 36, _>(|k| -(k as f64)));
    assert_eq!(golden.len(), 724);
    same(&message, &golden);
    assert_eq!(message.pose().position_m, [1.5, -2.25, 0.125]);
}

#[test]
fn our_own_messages_are_what_rospy_reads() {
    let bearing = Bearing {
        header: header(),
        peer: "b".into(),
        mac: "02:00:00:00:00:01".into(),
        state: "held".into(),
        words: "w".into(),
        azimuth: 1.0,
        azimuth_sd: 2.0,
        azimuth_body: 3.0,
        mirror: 4.0,
        elevation: 5.0,
        signed_elevation: -5.0,
        range: 6.0,
        range_sd: 7.0,
        coherence: 8.0,
        confidence: 9.0,
        moved: 10.0,
        needed: 11.0,
        age: 12.0,
        pairs: 9,
    };
    let golden = "01000000 62 11000000 30323a30303a30303a30303a30303a3031 04000000 68656c64 01000000 77 000000000000f03f \
                  0000000000000040 0000000000000840 0000000000001040 0000000000001440 00000000000014c0 0000000000001840 0000000000001c40 \
                  0000000000002040 0000000000002240 0000000000002440 0000000000002640 0000000000002840 09000000";
    same(&bearing, &bytes(&format!("{HEADER}{golden}")));
    let csi = Csi {
        header: Header { seq: 1, stamp: Time { secs: 3, nsecs: 4 }, frame_id: String::new() },
        mac: "m".into(),
        frame_count: 5,
        timestamp_low: 6,
        bfee_count: 7,
        n_rx: 2,
        n_tx: 1,
        rssi: [30, 31, 0],
        noise: -127,
        agc: 40,
        rate_n_flags: 0x4101,
        antennas: vec![0, 1],
        re: vec![-128, 127],
        im: vec![1, -2],
    };
    let golden = "01000000 03000000 04000000 00000000 01000000 6d 05000000 06000000 0700 02 01 1e1f00 81 28 0141 \
                  02000000 0001 02000000 807f 02000000 01fe";
    same(&csi, &bytes(golden));
}

#[test]
fn times_that_a_message_cannot_hold_are_none() {
    assert_eq!(Time::from_s(2.5), Time { secs: 2, nsecs: 500_000_000 });
    assert_eq!(Time::from_s(0.999_999_999_9), Time { secs: 1, nsecs: 0 });
    for none in [-1.0, f64::NAN, f64::INFINITY, 4_294_967_296.0] {
        assert_eq!(Time::from_s(none), Time::default());
    }
    assert_eq!(Time::from_us(1_700_000_000_250_001), Time { secs: 1_700_000_000, nsecs: 250_001_000 });
    assert_eq!([Time::from_us(-1), Time::from_us(i64::MAX)], [Time::default(); 2]);
}

#[test]
fn cut_messages_are_refused() {
    let message = to_vec(&PoseStamped { header: header(), pose: pose() }).unwrap();
    for length in 0..message.len() {
        assert!(from_slice::<PoseStamped>(&message[..length]).is_err(), "{length}");
    }
}
