use super::*;
use crate::{Room, Scene};
use csi5300::motion::odometry::OdometryError;
use proptest::prelude::*;
use std::f64::consts::FRAC_PI_2;

fn waiting() -> Way {
    let start = Pose { position_m: Vector3::new(5.0, 5.0, 0.0), yaw_rad: 1.0 };
    Way::new(start, &FollowedMotion { origin_m: [1.0, 2.0, 0.3], origin_yaw_deg: 90.0 })
}

fn pose(t_s: f64, x: f64) -> pose::Pose {
    pose::Pose { t_s, position_m: Vector3::new(x, 0.0, 0.0), heading_rad: Some(0.1) }
}

#[test]
fn poses_are_reached_a_moment_after_they_came_in_the_rooms_frame() {
    let mut way = waiting();
    assert_eq!(way.at(0.0), (Pose { position_m: Vector3::new(5.0, 5.0, 0.0), yaw_rad: 1.0 }, 0));
    for k in 0..100 {
        let t_s = f64::from(k) * 0.02;
        way.hand_over(t_s, &[pose(1_000.0 + t_s, t_s)]);
    }
    // At 1 s the robot has the pose of 0.9 s; x of a frame turned by 90 degrees is y of the room.
    let (at, frame) = way.at(1.0);
    assert!((at.position_m - Vector3::new(1.0, 2.9, 0.3)).norm() < 1e-9 && frame == 1, "{at:?}");
    assert!((at.yaw_rad - FRAC_PI_2 - 0.1).abs() < 1e-12);
    // Between two poses it is on the way, and after the last one it waits.
    assert!((way.at(1.01).0.position_m.y - 2.91).abs() < 1e-9);
    assert!((way.at(99.0).0.position_m.y - 3.98).abs() < 1e-9);
    assert_eq!(way.counts, FollowedCounts { poses: 100, ..FollowedCounts::default() });
}

#[test]
fn a_restarted_source_moves_the_robot_at_once() {
    let mut way = waiting();
    way.hand_over(0.0, &[pose(0.0, 0.0)]);
    way.hand_over(0.1, &[pose(0.1, 0.1)]);
    way.begin_frame();
    way.hand_over(0.2, &[pose(50.0, 8.0)]);
    assert!(way.at(0.299).0.position_m.y < 2.2 && way.at(0.299).1 == 1);
    assert!((way.at(0.3).0.position_m.y - 10.0).abs() < 1e-9 && way.at(0.3).1 == 2);
    assert_eq!((way.counts.new_frames, way.counts.clock_set), (1, 1));
}

#[test]
fn a_reader_that_was_away_finds_the_newest_pose() {
    let mut way = waiting();
    way.hand_over(0.0, &[pose(0.0, 0.0)]);
    let burst: Vec<_> = (1..=25).map(|k| pose(f64::from(k) * 0.01, f64::from(k))).collect();
    way.hand_over(0.4, &burst);
    assert!((way.at(0.4).0.position_m.y - 2.0).abs() < 1e-9, "it waited until now");
    assert!((way.at(0.4 + AT_ONCE_S).0.position_m.y - 27.0).abs() < 1e-9);
    assert_eq!((way.counts.poses, way.counts.late), (2, 24));
}

#[test]
fn an_hour_of_poses_takes_no_more_room_than_a_minute() {
    let mut way = waiting();
    for k in 0..180_000 {
        let t_s = f64::from(k) * 0.02;
        way.hand_over(t_s, &[pose(t_s, 0.0)]);
    }
    assert!(way.knots.len() < 3_100, "{}", way.knots.len());
    assert_eq!(way.at(0.0).0.position_m, Vector3::new(1.0, 2.0, 0.3), "what is forgotten was somewhere");
    assert_eq!(way.counts.poses, 180_000);
}

proptest! {
    /// Whatever arrives, the past stays the same.
    #[test]
    fn the_past_never_changes(
        steps in proptest::collection::vec((0.0..0.5_f64, -0.3..0.3_f64, -9.0..9.0_f64, 0_u8..20), 1..60)
    ) {
        let mut way = waiting();
        let (mut now_s, mut said) = (0.0, Vec::new());
        for (later_s, off_s, x, what) in steps {
            now_s += later_s;
            said.push((now_s, way.at(now_s)));
            if what == 0 {
                way.begin_frame();
            } else {
                way.hand_over(now_s, &[pose(now_s + off_s, x), pose(now_s + off_s + 0.01, x + 0.1)]);
            }
            for (t_s, before) in &said {
                let (then, frame) = way.at(*t_s);
                prop_assert!(frame == before.1 && (then.position_m - before.0.position_m).norm() < 1e-9);
            }
        }
    }
}

/// Poses at 20 Hz, of another frame from the 40th on; fails after the 80th.
struct Scripted(u32);

impl OdometrySource for Scripted {
    fn receive(&mut self, now: Instant) -> Result<NextPose, OdometryError> {
        let due = Instant::from_us(i64::from(self.0) * 50_000 + 20_000);
        if due > now {
            return Ok(NextPose::Pending);
        }
        self.0 += 1;
        match self.0 {
            40 => Ok(NextPose::NewFrame),
            80.. => Err(OdometryError::Other("unplugged".into())),
            k => Ok(NextPose::Pose(pose(7e8 + due.as_s(), if k > 40 { 20.0 } else { due.as_s() }))),
        }
    }

    fn next_at(&self) -> Option<Instant> {
        None
    }

    fn counted(&self) -> Option<SourceCounts> {
        let (controller, unplugged) = (Default::default(), u64::from(self.0));
        Some(SourceCounts::Controller { controller, unplugged })
    }
}

#[test]
fn a_rooms_odometry_gives_the_place_of_the_followed_robot() {
    let text = "duration_s = 10\n[[robot]]\nname = \"a\"\nposition_m = [3.0, 0.0, 0.0]\nmotion.followed = {}\n\
                odometry = { rate_hz = 10 }\n[[robot]]\nname = \"b\"\n";
    let mut room = Room::new(&Scene::from_toml(text).unwrap()).unwrap();
    let wrong = room.follow(1, Box::new(Scripted(0))).unwrap_err().to_string();
    assert!(wrong.contains("`b`") && wrong.contains("followed"), "{wrong}");
    room.follow(0, Box::new(Scripted(0))).unwrap();
    assert!(room.follow(0, Box::new(Scripted(0))).is_err(), "one source is enough");
    let mut odometry = room.odometry(0).unwrap();
    let (mut poses, mut frames) = (Vec::new(), 0);
    for ms in 0..6_000 {
        let now = Instant::from_us(ms * 1_000);
        room.air().advance(now.as_us() * 1_000);
        match odometry.receive(now).unwrap() {
            NextPose::Pose(pose) => poses.push((ms, pose.position_m.x)),
            NextPose::NewFrame => frames += 1,
            NextPose::Pending => {}
            NextPose::End => panic!("the scene goes on"),
        }
    }
    // No pose before the first one arrives; then a tenth of a second behind; then in another frame.
    assert_eq!((poses[0].0, frames), (200, 1));
    let way = |ms: i64| (ms as f64 * 1e-3 - 0.1).min(1.92);
    assert!(poses.iter().all(|(ms, x)| *x == 20.0 || (x - way(*ms)).abs() < 1e-6), "{poses:?}");
    assert!(poses.iter().any(|(_, x)| *x == 20.0));
    assert_eq!(odometry.trouble().as_deref(), Some("unplugged"));
    let Some(SourceCounts::Followed { followed, source }) = odometry.counted() else { panic!("a followed robot") };
    let (controller, unplugged) = (Default::default(), 80);
    assert_eq!((*source.unwrap(), followed.poses), (SourceCounts::Controller { controller, unplugged }, 78));
}

#[test]
fn a_scene_says_where_the_poses_frame_lies() {
    let scene = |more: &str| {
        Scene::from_toml(&format!("duration_s = 1\n[[robot]]\nname = \"a\"\nmotion.followed = {{ {more} }}\n"))
    };
    assert!(scene("origin_m = [1, 2, 3], origin_yaw_deg = 30").is_ok());
    let refused = scene("origin_yaw_deg = nan").unwrap_err();
    assert_eq!(refused.line(), Some(4));
}
