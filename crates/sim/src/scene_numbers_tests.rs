//! Every number of a scene is checked: invalid ones are refused with their line.

use super::CardFault;
use super::motion::{
    Arc, Circle, FigureEight, FollowedMotion, Helix, Line, RandomWalk, RecordedMotion, RobotMotion, Square, Waypoints,
};
use super::radio::{Agc, AntennaOrder, DelayGroup, FixedGain, Gain, Noise, Radio, Stray, TurnAround};
use super::scene::{
    Card, Cfo, Dialect, Driver, HostClock, Odometry, PaperCfo, Pattern, Reflector, Robot, Scene, Sounding, Wall,
};
use super::{Faults, SceneError, crystal::Crystal};
use std::path::Path;
use toml::Value;

/// Numbers that may be negative, by their last names.
const SIGNED: [&str; 38] = [
    "position_m",
    "yaw_deg",
    "antenna_m",
    "antenna_b_m",
    "antenna_c_m",
    "cos_db",
    "sin_db",
    "cos2_db",
    "sin2_db",
    "offset_ppm",
    "drift_ppm_per_s",
    "warm_up_ppm",
    "wander_ppm",
    "offset_s",
    "drift_ppm",
    "heading_drift_deg_s",
    "delay_ns",
    "chain_deg",
    "filter_db",
    "tx_power_dbm",
    "snr_db",
    "floor_dbm",
    "rssi_db",
    "tail_us",
    "from_m",
    "to_m",
    "bottom_m",
    "corner_m",
    "edge_a_m",
    "edge_b_m",
    "turns",
    "angle_deg",
    "rise_m",
    "points_m",
    "origin_m",
    "origin_yaw_deg",
    "turning_deg_s",
    "df_hz",
];
/// The same, for names that occur in several tables.
const SIGNED_WAYS: [&str; 4] = ["paper.c1", "paper.c2", "far.us", "late.us"];

fn radio(gain: Gain, noise: Noise) -> Radio {
    let group = DelayGroup { share: 0.1, us: 30.0, spread_us: 2.0 };
    Radio {
        noise,
        phase_noise_rad: 0.1,
        delay_ns: 200.0,
        delay_std_ns: 20.0,
        sampling_offset: true,
        filter_db: Some([0.5; 30]),
        gain,
        tx_power_dbm: 14.0,
        chains: 2,
        chain_deg: [40.0, -50.0],
        chain_flips: true,
        chain_noise_rad: 0.2,
        stray_b: Stray { lsb: 1.0, rssi_db: 3.0, rssi_std_db: 0.5 },
        stray_c: Stray { lsb: 2.0, rssi_db: 4.0, rssi_std_db: 0.5 },
        antenna_order: AntennaOrder::ByRssi,
        mcs: 1,
        turn_around: TurnAround {
            median_us: 220.0,
            spread_us: 5.0,
            tail: 0.1,
            tail_us: -90.0,
            tail_spread_us: 4.0,
            far: group,
            late: group,
            tail_run: 2.0,
            min_us: 140.0,
            max_us: 320.0,
        },
        send_jitter_us: 40.0,
        send_delay: group,
        host_latency_us: 90.0,
        host_latency_std_us: 9.0,
    }
}

fn robot(number: usize, motion: RobotMotion) -> Robot {
    Robot {
        name: format!("r{number}"),
        mac: None,
        position_m: [10.0 * (number + 1) as f64, 1.0, 0.5],
        yaw_deg: 10.0,
        antenna_m: [0.1, 0.0, 0.2],
        antenna_b_m: Some([0.2, 0.0, 0.2]),
        antenna_c_m: Some([0.3, 0.0, 0.2]),
        pattern: Pattern { cos_db: 1.0, sin_db: 0.5, cos2_db: 0.3, sin2_db: 0.2 },
        motion,
        crystal: Crystal {
            offset_ppm: 1.0,
            drift_ppm_per_s: 0.1,
            warm_up_ppm: 0.5,
            warm_up_s: 20.0,
            wander_ppm: 0.1,
            wander_period_s: 30.0,
            clock_start_us: 7,
        },
        host_clock: HostClock { offset_s: 2.0, drift_ppm: 3.0 },
        radio: Some(radio(Gain::Fixed(FixedGain { lsb_at_1m: 200.0, agc_db: 20 }), Noise::FloorDbm(-92.0))),
        faults: Faults {
            loss: 0.1,
            duplicate: 0.1,
            retry: 0.1,
            driver_drop: 0.1,
            queue_records: 99,
            stall_every_s: 5.0,
            stall_s: 0.1,
            restart_at_s: vec![8.0],
            restart_s: 0.5,
            killed: true,
            card: vec![CardFault::NoGain],
        },
        odometry: Odometry {
            rate_hz: 50.0,
            noise_m: 0.01,
            noise_deg: 0.1,
            scale: 1.01,
            heading_drift_deg_s: 0.1,
            heading_walk_deg: 0.1,
            drop: 0.1,
            late: 0.1,
            late_s: 0.1,
        },
        ack_len: Some(57),
    }
}

/// A scene with every possible number and robots of all motions. It names all fields, so that a new one does not
/// compile without a line here.
fn full(trajectory: &Path) -> Scene {
    let (start_s, duration_s, radius_m, turns) = (0.1, 5.0, 1.0, 2.0);
    let motions = [
        RobotMotion::Line(Line { length_m: 2.0, duration_s, start_s }),
        RobotMotion::Circle(Circle { radius_m, duration_s, turns, start_s }),
        RobotMotion::Arc(Arc { radius_m, angle_deg: 45.0, duration_s, start_s }),
        RobotMotion::Square(Square { side_m: 1.0, duration_s, turns, start_s }),
        RobotMotion::Helix(Helix { radius_m, rise_m: 0.1, duration_s, turns, start_s }),
        RobotMotion::FigureEight(FigureEight { radius_m, duration_s, turns, start_s }),
        RobotMotion::RandomWalk(RandomWalk { speed_m_s: 0.2, turning_deg_s: 80.0, within_m: 1.5, duration_s, start_s }),
        RobotMotion::Waypoints(Waypoints { points_m: vec![[90.0, 2.0, 0.0]], speed_m_s: 0.3, start_s }),
        RobotMotion::Recorded(RecordedMotion { file: trajectory.into(), start_s, stray_m: 0.01, stray_s: 9.0 }),
        RobotMotion::Followed(FollowedMotion { origin_m: [1.0, 2.0, 3.0], origin_yaw_deg: 4.0 }),
    ];
    Scene {
        name: "full".into(),
        seed: 5,
        duration_s: 10.0,
        channel: 100,
        bandwidth_mhz: 40,
        start_unix_s: 1_600_000_000,
        reflections: 1,
        cfo: Cfo::Paper(PaperCfo { df_hz: 11.0, c1: 9_000.0, c2: 190.0, jitter_ns: 90.0 }),
        card: Card::Intel5300,
        preamble: None,
        driver: Driver::Stock,
        sounding: Some(Sounding {
            rate_hz: 2.0,
            initiators: vec!["r0".into()],
            dialect: Dialect::Native,
            start_s: 0.2,
        }),
        radio: radio(
            Gain::Agc(Agc { target_lsb: 30.0, lsb_std_db: 0.5, rssi_db: 37.0, agc_std_db: 0.5 }),
            Noise::SnrDb(20.0),
        ),
        robot: motions.into_iter().enumerate().map(|(number, motion)| robot(number, motion)).collect(),
        wall: vec![Wall {
            from_m: [0.0, -9.0],
            to_m: [5.0, -9.0],
            bottom_m: 0.1,
            top_m: 2.4,
            thickness_m: 0.2,
            loss_db: 5.0,
            through_db: Some(9.0),
        }],
        reflector: vec![Reflector {
            corner_m: [1.0, -9.0, 2.0],
            edge_a_m: [2.0, 0.1, 0.1],
            edge_b_m: [0.1, 2.0, 0.2],
            loss_db: 5.0,
            through_db: Some(9.0),
        }],
    }
}

/// Calls `visit` with each number of a document and the way to it; indices are left out of the way's last part.
fn numbers(value: &Value, way: &mut Vec<Step>, visit: &mut dyn FnMut(&[Step])) {
    match value {
        Value::Integer(_) | Value::Float(_) => visit(way),
        Value::Array(items) => {
            for (index, item) in items.iter().enumerate() {
                way.push(Step::Index(index));
                numbers(item, way, visit);
                way.pop();
            }
        }
        Value::Table(table) => {
            for (key, item) in table {
                way.push(Step::Key(key.clone()));
                numbers(item, way, visit);
                way.pop();
            }
        }
        _ => {}
    }
}

#[derive(Clone, Debug)]
enum Step {
    Key(String),
    Index(usize),
}

fn at<'v>(value: &'v mut Value, way: &[Step]) -> &'v mut Value {
    way.iter().fold(value, |value, step| match step {
        Step::Key(key) => &mut value[key.as_str()],
        Step::Index(index) => &mut value[*index],
    })
}

fn read(document: &Value) -> Result<Scene, SceneError> {
    Scene::from_toml(&toml::to_string(document).unwrap())
}

#[test]
fn every_number_of_a_scene_that_makes_no_sense_is_refused_with_its_line() {
    let trajectory = std::env::temp_dir().join(format!("csi5300-numbers-{}.csv", std::process::id()));
    std::fs::write(&trajectory, "10.0,0,90,0,1,\n11.0,0,91,2,1,\n").unwrap();
    let text = full(&trajectory).to_toml().unwrap();
    Scene::from_toml(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
    let mut document: Value = toml::from_str(&text).unwrap();
    let mut ways = Vec::new();
    numbers(&document, &mut Vec::new(), &mut |way| ways.push(way.to_vec()));
    assert!(ways.len() > 700, "{} numbers", ways.len());
    // Robots differ in their motions alone.
    let apart = |way: &&Vec<Step>| match &way[..] {
        [Step::Key(robot), Step::Index(index), Step::Key(table), ..] if robot == "robot" => {
            *index == 0 || table == "motion"
        }
        _ => true,
    };
    let mut wrong = Vec::new();
    for way in ways.iter().filter(apart) {
        let keys: Vec<&str> =
            way.iter().filter_map(|step| if let Step::Key(key) = step { Some(key.as_str()) } else { None }).collect();
        let name = keys.join(".");
        let signed = SIGNED.contains(keys.last().unwrap()) || SIGNED_WAYS.iter().any(|signed| name.ends_with(signed));
        let before = at(&mut document, way).clone();
        let whole = before.is_integer();
        let cases = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300].map(Value::Float);
        let negative = if whole { Value::Integer(-1) } else { Value::Float(-1.0) };
        for case in cases.into_iter().chain(std::iter::once(negative).filter(|_| !signed)) {
            // Without end is the highest rate that fits.
            if name == "sounding.rate_hz" && case.as_float() == Some(f64::INFINITY) {
                continue;
            }
            *at(&mut document, way) = case.clone();
            match read(&document) {
                Ok(_) => wrong.push(format!("{name} = {case:?} is taken")),
                Err(error) if error.line().is_none() => wrong.push(format!("{name} = {case:?}: no line: {error}")),
                Err(_) => {}
            }
        }
        *at(&mut document, way) = before;
    }
    std::fs::remove_file(&trajectory).unwrap();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
