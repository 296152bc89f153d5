//! A scene that is written and parsed again is the same scene.

use super::*;
use crate::motion::{Arc, Circle, FollowedMotion, RecordedMotion, Waypoints};
use crate::radio::{Agc, AntennaOrder, FixedGain, Gain, Noise};
use proptest::prelude::*;

/// Numbers of any size, whole ones and infinite ones among them.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![any::<f64>().prop_filter("equal to itself", |v| !v.is_nan()), (-9i32..9).prop_map(f64::from)]
}

fn place() -> impl Strategy<Value = [f64; 3]> {
    [number(), number(), number()]
}

fn name() -> impl Strategy<Value = String> {
    prop_oneof!["[a-z_-]{0,8}", any::<String>()]
}

fn motion() -> impl Strategy<Value = RobotMotion> {
    let circle = (number(), number(), number(), number()).prop_map(|(radius_m, duration_s, turns, start_s)| {
        RobotMotion::Circle(Circle { radius_m, duration_s, turns, start_s })
    });
    let arc = (number(), number(), number(), number()).prop_map(|(radius_m, angle_deg, duration_s, start_s)| {
        RobotMotion::Arc(Arc { radius_m, angle_deg, duration_s, start_s })
    });
    let waypoints = (prop::collection::vec(place(), 0..4), number(), number())
        .prop_map(|(points_m, speed_m_s, start_s)| RobotMotion::Waypoints(Waypoints { points_m, speed_m_s, start_s }));
    let recorded = (name(), number(), number(), number()).prop_map(|(file, start_s, stray_m, stray_s)| {
        RobotMotion::Recorded(RecordedMotion { file: file.into(), start_s, stray_m, stray_s })
    });
    let followed = (place(), number())
        .prop_map(|(origin_m, origin_yaw_deg)| RobotMotion::Followed(FollowedMotion { origin_m, origin_yaw_deg }));
    prop_oneof![Just(RobotMotion::Static), circle, arc, waypoints, recorded, followed]
}

fn radio() -> impl Strategy<Value = Radio> {
    let noise = prop_oneof![Just(Noise::Off), number().prop_map(Noise::SnrDb), number().prop_map(Noise::FloorDbm)];
    let gain = prop_oneof![
        (number(), any::<u8>()).prop_map(|(lsb_at_1m, agc_db)| Gain::Fixed(FixedGain { lsb_at_1m, agc_db })),
        number().prop_map(|target_lsb| Gain::Agc(Agc { target_lsb, ..Agc::default() })),
    ];
    let filter = prop::option::of(number().prop_map(|db| [db; 30]));
    (noise, gain, filter, number(), any::<bool>(), 0u8..8).prop_map(|(noise, gain, filter_db, us, flag, mcs)| {
        let antenna_order = if flag { AntennaOrder::ByRssi } else { AntennaOrder::Fixed };
        let mut radio = Radio { noise, gain, filter_db, antenna_order, mcs, sampling_offset: flag, ..Radio::default() };
        (radio.send_jitter_us, radio.turn_around.median_us, radio.turn_around.far.us) = (us, us, us);
        radio
    })
}

fn robot() -> impl Strategy<Value = Robot> {
    let places = (place(), place(), prop::option::of(place()));
    let parts = (motion(), prop::option::of(radio()), prop::option::of(name()), number(), any::<u32>());
    (name(), places, parts).prop_map(|(name, (position_m, antenna_m, antenna_b_m), parts)| {
        let (motion, radio, mac, value, whole) = parts;
        let mut robot = Robot { name, mac, position_m, antenna_m, antenna_b_m, motion, radio, ..Robot::default() };
        (robot.pattern.sin_db, robot.host_clock.offset_s, robot.odometry.late_s) = (value, value, value);
        (robot.faults.restart_at_s, robot.faults.queue_records) = (vec![value; 2], whole as usize);
        (robot.crystal.offset_ppm, robot.ack_len) = (value, (whole % 2 == 0).then_some(whole as usize));
        robot
    })
}

fn scene() -> impl Strategy<Value = Scene> {
    let cfo = prop_oneof![
        Just(Cfo::Off),
        Just(Cfo::Physical),
        number().prop_map(|df_hz| Cfo::Paper(PaperCfo { df_hz, ..PaperCfo::default() }))
    ];
    let sounding =
        prop::option::of((number(), prop::collection::vec(name(), 0..3)).prop_map(|(rate_hz, initiators)| Sounding {
            rate_hz,
            initiators,
            dialect: Dialect::Native,
            ..Sounding::default()
        }));
    let head = (name(), any::<u64>(), number(), any::<u16>(), any::<i64>(), any::<bool>());
    let walls = prop::collection::vec((number(), prop::option::of(number())), 0..3);
    (head, cfo, sounding, radio(), prop::collection::vec(robot(), 0..3), walls).prop_map(
        |((name, seed, duration_s, channel, start_unix_s, stock), cfo, sounding, radio, robot, walls)| {
            let driver = if stock { Driver::Stock } else { Driver::Wsr };
            let wall = |&(v, through_db): &(f64, Option<f64>)| Wall {
                from_m: [v, 0.0],
                to_m: [0.0, v],
                bottom_m: v,
                top_m: v,
                thickness_m: v,
                loss_db: v,
                through_db,
            };
            let reflector = |&(v, through_db): &(f64, Option<f64>)| Reflector {
                corner_m: [v; 3],
                edge_a_m: [v; 3],
                edge_b_m: [v; 3],
                loss_db: v,
                through_db,
            };
            let reflector = walls.iter().map(reflector).collect();
            let wall = walls.iter().map(wall).collect();
            let head = Scene { name, seed, duration_s, channel, start_unix_s, cfo, driver, ..Scene::default() };
            Scene { sounding, radio, robot, wall, reflector, ..head }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn a_written_scene_is_read_as_itself(scene in scene()) {
        let text = scene.to_toml().unwrap();
        let again = Scene::parse(&text).map_err(|error| TestCaseError::fail(format!("{error}\n{text}")))?;
        prop_assert_eq!(again, scene, "{}", text);
    }
}

#[test]
fn built_in_scenes_are_written_too() {
    for (name, _) in crate::BUILT_IN {
        let scene = Scene::built_in(name).unwrap();
        assert_eq!(Scene::from_toml(&scene.to_toml().unwrap()).unwrap(), scene);
    }
}
