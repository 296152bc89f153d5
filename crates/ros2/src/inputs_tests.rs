use super::*;
use csi5300::motion::odometry::{NextPose, OdometrySource};
use csi5300::time::Instant;
use csi5300_bag::messages::standard::{Quaternion, Time, Transform, TransformStamped, Vector3 as Numbers};

fn shared(stamp: Stamp) -> Shared {
    let inbox = Inbox::new("/odom", Wanted { stamp, frame: None });
    Shared { inbox, clock: SimClock::real(), state: Mutex::default() }
}

fn turned(rad: f64) -> Quaternion {
    Quaternion { x: 0.0, y: 0.0, z: (rad / 2.0).sin(), w: (rad / 2.0).cos() }
}

fn odometry(t_s: f64, x: f64, heading: f64) -> Odometry {
    let mut told = Odometry { child_frame_id: "base_link".into(), ..Odometry::default() };
    told.header = Header { stamp: Time::from_us((t_s * 1e6) as i64), frame_id: "odom".into() };
    told.pose.pose.position.x = x;
    told.pose.pose.orientation = turned(heading);
    told
}

fn poses(shared: &Shared) -> Vec<csi5300::motion::pose::Pose> {
    let mut source = shared.inbox.source();
    let mut all = Vec::new();
    while let Ok(NextPose::Pose(pose)) = source.receive(Instant::ZERO) {
        all.push(pose);
    }
    all
}

fn transform(parent: &str, child: &str, t_s: f64, x: f64) -> TransformStamped {
    let translation = Numbers { x, ..Numbers::default() };
    let header = Header { stamp: Time::from_us((t_s * 1e6) as i64), frame_id: parent.into() };
    TransformStamped {
        header,
        child_frame_id: child.into(),
        transform: Transform { translation, rotation: turned(0.0) },
    }
}

#[test]
fn the_antennas_offset_from_tf_static_rotates_with_the_robot() {
    let shared = shared(Stamp::Header);
    shared.odometry(&odometry(10.0, 1.0, 0.0), Some("antenna"), 10_000_000);
    assert_eq!(poses(&shared), []);
    assert!(shared.lock().waits.as_ref().is_some_and(|why| why.contains("from base_link to antenna")));
    let fixed = TfMessage { transforms: vec![transform("base_link", "antenna", 0.0, 0.5)] };
    shared.transforms(&fixed, true, None, 0);
    shared.odometry(&odometry(10.0, 1.0, std::f64::consts::FRAC_PI_2), Some("antenna"), 10_000_000);
    let pose = poses(&shared)[0];
    assert!((pose.position_m - Vector3::new(1.0, 0.5, 0.0)).norm() < 1e-9, "{pose:?}");
    assert_eq!((pose.t_s, shared.lock().waits.clone()), (10.0, None));
}

#[test]
fn each_transform_of_the_lowest_moving_frame_gives_a_pose() {
    let shared = shared(Stamp::Header);
    let way = Some(("map", "antenna"));
    let tell =
        |told: Vec<TransformStamped>, fixed| shared.transforms(&TfMessage { transforms: told }, fixed, way, 5_000_000);
    tell(vec![transform("base_link", "antenna", 0.0, 0.1)], true);
    tell(vec![transform("odom", "base_link", 4.0, 1.0)], false);
    assert!(shared.lock().waits.as_ref().is_some_and(|why| why.contains("from map to antenna")));
    // Stamped ahead, as AMCL does.
    tell(vec![transform("map", "odom", 6.0, 10.0)], false);
    assert_eq!(poses(&shared), []);
    tell(vec![transform("odom", "base_link", 5.0, 2.0), transform("other", "frame", 5.5, 0.0)], false);
    let all = poses(&shared);
    assert_eq!((all.len(), all[0].t_s), (1, 5.0));
    assert!((all[0].position_m.x - 12.1).abs() < 1e-9);
}

#[test]
fn an_inertial_units_heading_starts_from_odometrys() {
    let shared = shared(Stamp::Header);
    let imu = |rad, at| {
        let imu = Imu { orientation: turned(rad), ..Imu::default() };
        shared.lock().turns.handle(&imu, at);
    };
    imu(2.0, 10_000_000);
    shared.odometry(&odometry(10.0, 0.0, 0.5), None, 10_000_000);
    imu(2.3, 10_100_000);
    shared.odometry(&odometry(10.1, 0.0, 0.6), None, 10_100_000);
    // The unit has gone silent: odometry's own heading.
    shared.odometry(&odometry(10.9, 0.0, 0.7), None, 10_900_000);
    let headings: Vec<f64> = poses(&shared).iter().filter_map(|pose| pose.heading_rad).collect();
    for (heading, expected) in headings.iter().zip([0.5, 0.8, 0.7]) {
        assert!((heading - expected).abs() < 1e-6, "{headings:?}");
    }
    let unknown = Imu { orientation: turned(9.0), orientation_covariance: [-1.0; 9], ..Imu::default() };
    shared.lock().turns.handle(&unknown, 11_000_000);
    assert_eq!(shared.lock().turns.newest.map(|(_, at)| at), Some(10_100_000));
}

#[test]
fn simulated_times_become_host_times() {
    let ahead = Arc::new(AtomicI64::new(UNKNOWN));
    let clock = SimClock(Some(Arc::clone(&ahead)));
    let shared = Shared { clock: clock.clone(), ..shared(Stamp::Header) };
    shared.odometry(&odometry(3.0, 0.0, 0.0), None, 1_000_000_000);
    assert!(poses(&shared).is_empty() && clock.is_unknown() && clock.to_stamp(7) == 0);
    assert!(shared.lock().waits.as_ref().is_some_and(|why| why.contains("/clock")));
    ahead.store(990_000_000, Ordering::Relaxed);
    shared.odometry(&odometry(3.0, 0.0, 0.0), None, 993_000_000);
    assert_eq!(poses(&shared)[0].t_s, 993.0);
    assert_eq!(clock.to_stamp(993_000_000), 3_000_000);
}
