//! Two nodes on loopback and nothing else: poses, a service's parameters, bearings.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use csi5300::motion::odometry::ros::Stamp;
use csi5300::motion::odometry::{NextPose, OdometrySource};
use csi5300::pipeline::Answer;
use csi5300::pipeline::live::{PeerReport, PeerState};
use csi5300::time::Instant;
use csi5300_bag::messages::{Bearing, Header, Odometry, Time};
use csi5300_ros2::settings::{Settings, Topic};
use csi5300_ros2::{Node, Qos};
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::mpsc::channel;

/// The wall clock of all nodes, microseconds.
static WALL_US: AtomicI64 = AtomicI64::new(20_000_000);

/// A node in a domain that nobody else on this machine is likely to use.
fn node(name: &str) -> Node {
    let domain = Some(150 + (std::process::id() % 80) as u16);
    let settings = Settings { domain, multicast: Some(false), ..Settings::default() };
    Node::start(&settings, name, || Some(WALL_US.load(Ordering::Relaxed))).unwrap()
}

fn odometry() -> Odometry {
    let mut told = Odometry { child_frame_id: "base_link".into(), ..Odometry::default() };
    told.header = Header { stamp: Time::from_us(12_500_000), frame_id: "odom".into() };
    (told.pose.pose.position.x, told.pose.pose.orientation.w) = (1.5, 1.0);
    told
}

#[test]
fn a_publisher_that_restarted_begins_a_frame() {
    let listener = node("listener");
    let topic: Topic = serde_json::from_str("{\"topic\":\"/base/odom\"}").unwrap();
    let mut poses = listener.poses(&topic, Stamp::Header);
    let mut until = |wanted: fn(NextPose) -> bool| {
        let base = node("base");
        let publisher = base.link.publish::<Odometry>("/base/odom", Qos::reliable(10));
        while !wanted(poses.receive(Instant::ZERO).unwrap()) {
            publisher.put(&odometry());
            std::thread::yield_now();
        }
    };
    until(|next| matches!(next, NextPose::Pose(_)));
    // A publisher may be silent for a second.
    WALL_US.fetch_add(2_000_000, Ordering::Relaxed);
    until(|next| next == NextPose::NewFrame);
}

#[test]
fn poses_and_bearings_go_from_one_node_to_another() {
    let (robot, listener) = (node("burger"), node("bench"));
    let publisher = robot.link.publish::<Odometry>("/odom", Qos::reliable(10));
    let topic: Topic = serde_json::from_str("{}").unwrap();
    let mut poses = listener.poses(&topic, Stamp::Header);
    let pose = loop {
        publisher.put(&odometry());
        match poses.receive(Instant::ZERO).unwrap() {
            NextPose::Pose(pose) => break pose,
            _ => std::thread::yield_now(),
        }
    };
    assert_eq!((pose.t_s, pose.position_m.x, pose.heading_rad), (12.5, 1.5, Some(0.0)));

    let (give, bearings) = channel();
    let used = move |bearing: Bearing, _| drop(give.send(bearing));
    listener.link.subscribe("/csi5300_burger/tx/bearing", Qos::reliable(10), used, || panic!("unreadable"));
    let mut robot = robot;
    robot.announce(&["tx".into()]);
    let mut answer = Answer::default();
    (answer.link, answer.azimuth_deg) = ("tx".into(), Some(90.0));
    let (words, state) = (String::new(), PeerState::Bearing);
    let report = PeerReport {
        // As a number of seconds it is a quarter of a microsecond less.
        t_s: Some(1_700_000_029.990_405),
        state,
        words,
        moved_m: 1.0,
        needed_m: 0.1,
        age_s: 0.0,
        accurate: true,
        heard_at: None,
        answer,
    };
    let bearing = loop {
        robot.report(0, &report);
        match bearings.try_recv() {
            Ok(bearing) => break bearing,
            Err(_) => std::thread::yield_now(),
        }
    };
    assert_eq!((bearing.peer.as_str(), bearing.state.as_str()), ("tx", "bearing"));
    assert_eq!(bearing.header.stamp, Time::from_us(1_700_000_029_990_405), "that of the record");
    assert!((bearing.azimuth - std::f64::consts::FRAC_PI_2).abs() < 1e-12 && bearing.range.is_nan());
    assert!(robot.trouble().is_empty() && listener.trouble().is_empty());
    assert_eq!(robot.link.counted()["published"]["/odom"]["subscribers"], 1);
}
