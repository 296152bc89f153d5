//! The pipeline from outside: a golden answer, what no answer may depend on, and what is refused, with why: logs and trajectories that
//! do not belong together.

use crate::common::{Link, PARTNER_AHEAD_S, START_S, TRANSMITTER, link, louder_link, root};
use csi5300::exchange::assign::Unmatched;
use csi5300::exchange::pairing::LinkSide;
use csi5300::maths::wrap_rad;
use csi5300::motion::odometry::csv;
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::pipeline::{
    Accuracy, Answer, Bearing, CaptureReport, Effort, JoinBy, LinkError, Options, Transmitter, bearings,
};
use csi5300::source::replay::Replay;
use nalgebra::{Rotation3, Vector3};
use proptest::prelude::*;
use serde_json::Value;
use std::io::Cursor;

/// Floats of the golden answer agree to this share of themselves; SIMD tiers sum in different orders.
const TOLERANCE: f64 = 1e-4;

fn options() -> Options {
    Options::new("108".parse().unwrap())
}

/// Records as a log in memory.
fn log(records: &[Vec<u8>]) -> Replay<Cursor<Vec<u8>>> {
    Replay::new(Cursor::new(records.concat()), String::new())
}

fn trajectory(link: &Link) -> Trajectory {
    csv::parse(link.trajectory.as_bytes(), None).unwrap().0
}

fn run(rx: &[Vec<u8>], tx: &[Vec<u8>], trajectory: &Trajectory, options: &Options) -> CaptureReport {
    let (mut rx, mut tx) = (log(rx), log(tx));
    let transmitters = vec![Transmitter { log: &mut tx, trajectory: None }];
    bearings(&mut rx, transmitters, trajectory, options).unwrap()
}

fn bearing(link: &Link, trajectory: &Trajectory) -> Bearing {
    let mut report = run(&link.rx, &link.tx, trajectory, &options());
    report.links.remove(0).bearing.unwrap()
}

/// Where two values differ, as a path into them.
fn difference(at: &str, golden: &Value, found: &Value) -> Option<String> {
    match (golden, found) {
        (Value::Object(a), Value::Object(b)) => {
            let keys = a.keys().chain(b.keys().filter(|key| !a.contains_key(*key)));
            keys.into_iter().find_map(|key| {
                let of = |object: &serde_json::Map<String, Value>| object.get(key).cloned().unwrap_or(Value::Null);
                difference(&format!("{at}/{key}"), &of(a), &of(b))
            })
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            a.iter().zip(b).enumerate().find_map(|(k, (a, b))| difference(&format!("{at}/{k}"), a, b))
        }
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
            ((a - b).abs() > TOLERANCE * a.abs() + 1e-9).then(|| format!("{at}: {a} and {b}"))
        }
        _ => (golden != found).then(|| format!("{at}: {golden} and {found}")),
    }
}

/// What the fixture gives along its trajectory, changed by `change`.
fn fixture(change: impl Fn(&Pose) -> Pose, options: &Options) -> CaptureReport {
    let file = |name: &str| root().join("tests/fixtures/small-circle").join(name);
    let mut rx = Replay::open(&file("csi_rx_2023-11-14_221320.dat")).unwrap();
    let mut tx = Replay::open(&file("csi_tx1_2023-11-14_221320.dat")).unwrap();
    let (read, _) = csv::read(&file("rx_trajectory_2023-11-14_221320_.csv"), None).unwrap();
    let path = Trajectory::new(read.poses().iter().map(change).collect()).unwrap();
    bearings(&mut rx, vec![Transmitter { log: &mut tx, trajectory: None }], &path, options).unwrap()
}

/// `CSI5300_REGENERATE=1 cargo test --test library golden` writes the golden answer anew.
#[test]
fn the_fixture_gives_the_golden_answer() {
    let report = fixture(Pose::clone, &options());
    let found = serde_json::to_value(Answer::new("tx1".into(), &report.links[0])).unwrap();
    let golden = root().join("tests/fixtures/small-circle.answer.json");
    if std::env::var_os("CSI5300_REGENERATE").is_some() {
        std::fs::write(&golden, serde_json::to_string_pretty(&found).unwrap() + "\n").unwrap();
    }
    let golden = serde_json::from_str(&std::fs::read_to_string(golden).unwrap()).unwrap();
    assert_eq!(difference("", &golden, &found), None);
}

/// The body azimuth is what one steers by: the way from where the robot stands at the end, not from the middle of its motion.
#[test]
fn a_body_azimuth_is_seen_from_the_end_of_the_motion_where_there_is_a_place() {
    let heading_rad = 0.7;
    let report = fixture(|pose| Pose { heading_rad: Some(heading_rad), ..*pose }, &options());
    let found = report.links[0].bearing.as_ref().unwrap();
    let answer = Answer::new("tx1".into(), &report.links[0]);
    assert_eq!(answer.origin_m.map(Vector3::from), Some(found.mean_position_m));
    let end_m = *found.samples.receiver_m().last().unwrap();
    let from_the_end = |to_m: Vector3<f64>| (to_m.y - end_m.y).atan2(to_m.x - end_m.x);
    let body_rad = answer.azimuth_body_deg.unwrap().to_radians();
    let place_m = Vector3::from(answer.position_m.unwrap());
    assert!(wrap_rad(body_rad + heading_rad - from_the_end(place_m)).abs() < 1e-12, "{answer:?}");
    // groundtruth_positions.json
    let truth_rad = from_the_end(Vector3::new(-3.0, 5.196152, 0.0));
    let off = |azimuth_rad: f64| wrap_rad(azimuth_rad - truth_rad).abs().to_degrees();
    let (turned, steered) = (off(found.answer.azimuth_rad), off(body_rad + heading_rad));
    let sd_deg = answer.azimuth_body_sd_deg.unwrap();
    println!("from the mean pose {turned:.2} deg off, from the end {steered:.2} +- {sd_deg:.2}");
    assert!(steered < turned && steered < 2.0 * sd_deg && sd_deg > answer.azimuth_sd_deg.unwrap());
}

#[test]
fn the_fixture_gives_its_range_change_to_a_millimetre() {
    let report = fixture(Pose::clone, &Options { range_change: true, ..options() });
    let bearing = report.links[0].bearing.as_ref().unwrap();
    let found = bearing.range_change.as_ref().unwrap().as_ref().unwrap();
    let places = bearing.samples.receiver_m();
    // The scene's transmitter.
    let distance_m = |k: usize| (places[k].x + 3.0).hypot(places[k].y - 5.196_152);
    let errors_m = (0..places.len()).map(|k| (found.range_change_m[k] - (distance_m(k) - distance_m(0))).abs());
    let worst_m = errors_m.fold(0.0, f64::max);
    assert!(worst_m < 0.001 && found.held_share() == 1.0 && found.slips.is_empty(), "{worst_m} {found:?}");
    let answer = serde_json::to_value(Answer::new("tx1".into(), &report.links[0])).unwrap();
    assert_eq!(answer["range_change"]["end_m"].as_f64(), found.range_change_m.last().copied());
}

#[test]
fn an_answer_is_the_same_however_loud_both_cards_are() {
    let (quiet, loud) = (louder_link(300, 0.7, 1), louder_link(300, 0.7, 3));
    assert_ne!(quiet.rx, loud.rx);
    let path = trajectory(&quiet);
    let (quiet, loud) = (bearing(&quiet, &path).answer, bearing(&loud, &path).answer);
    assert!((quiet.azimuth_rad - loud.azimuth_rad).abs() < 1e-6, "{quiet:?} {loud:?}");
    assert!((quiet.probability - loud.probability).abs() < 1e-4);
}

#[test]
fn threads_change_no_number() {
    let made = link(400, 2.0);
    let path = trajectory(&made);
    let every_step = Options { accuracy: Accuracy { effort: Effort::Everything, ..options().accuracy }, ..options() };
    let answer = |options: &Options| {
        let report = run(&made.rx, &made.tx, &path, options);
        serde_json::to_value(Answer::new("tx".into(), &report.links[0])).unwrap()
    };
    let alone = answer(&every_step);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    assert_eq!(pool.install(|| answer(&Options { parallel: true, ..every_step.clone() })), alone);
    assert!(alone["azimuth_deg"].is_number() && alone["candidates"][0].is_object(), "{alone}");
}

#[test]
fn a_log_is_paired_whole_though_it_is_handed_out_piece_by_piece() {
    // A piece is 32,768 frames. The transmitter's log goes on for longer.
    let made = link(33_100, 2.0);
    let report = run(&made.rx[..33_000], &made.tx, &trajectory(&made), &options());
    let link = report.links[0].link.as_ref().unwrap();
    let [receiver, transmitter] = [LinkSide::Receiver, LinkSide::Transmitter].map(|side| link.counts(side));
    assert_eq!([link.pairs() as u64, receiver.paired, receiver.handed], [33_000; 3]);
    assert_eq!([transmitter.handed, transmitter.paired, transmitter.unpaired], [33_100, 33_000, 100]);
}

#[test]
fn a_mirror_has_half_of_the_probability() {
    let made = link(400, 2.0);
    let answer = |path: &Trajectory| run(&made.rx, &made.tx, path, &options()).links.remove(0).bearing.unwrap().answer;
    let circle = answer(&trajectory(&made));
    assert!(circle.mirror_rad.is_none() && circle.probability > 0.9, "{circle:?}");
    let mut poses = trajectory(&made).poses().to_vec();
    poses.iter_mut().for_each(|pose| pose.position_m.y = 0.0);
    let line = answer(&Trajectory::new(poses).unwrap());
    let share = line.mirror_share.unwrap_or(0.0);
    assert!(line.mirror_rad.is_some() && (0.45..=0.5).contains(&share) && line.probability < 0.51, "{line:?}");
}

#[test]
fn who_exchanges_the_two_logs_finds_the_negated_carrier_frequency_offset() {
    let made = link(400, 2.0);
    let path = trajectory(&made);
    let offset_hz = |rx: &[Vec<u8>], tx: &[Vec<u8>], options: &Options| {
        let report = run(rx, tx, &path, options);
        report.links[0].link.as_ref().unwrap().phases(options).0.unwrap().df_hz
    };
    let own = offset_hz(&made.rx, &made.tx, &options());
    // The other robot's records are stamped by its own clock.
    let other = offset_hz(&made.tx, &made.rx, &Options { clock_offset_s: -PARTNER_AHEAD_S, ..options() });
    assert!(own.abs() > 1_000.0 && (own + other).abs() < 1.0, "{own} {other}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 6, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn a_turned_trajectory_turns_the_bearing_wherever_it_begins(
        azimuth_rad in -3.1..3.1f64, turn_rad in -3.1..3.1f64, origin_m in -1e6..1e6f64
    ) {
        let made = link(300, azimuth_rad);
        let path = trajectory(&made);
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), turn_rad);
        let turned = |pose: &Pose| Pose {
            position_m: turn * pose.position_m + Vector3::new(origin_m, -origin_m, 0.0),
            heading_rad: pose.heading_rad.map(|heading| wrap_rad(heading + turn_rad)),
            ..*pose
        };
        let turned = Trajectory::new(path.poses().iter().map(turned).collect()).unwrap();
        let (own, turned) = (bearing(&made, &path), bearing(&made, &turned));
        let off = |own: f64, turned: f64| wrap_rad(turned - own - turn_rad).abs();
        prop_assert!(off(own.plane_wave.azimuth_rad, turned.plane_wave.azimuth_rad) < 1e-5);
        prop_assert!(off(own.answer.azimuth_rad, turned.answer.azimuth_rad) < 1e-3, "{:?} {:?}", own.answer, turned.answer);
    }
}

fn only_bearing(rx: &[Vec<u8>], tx: &[Vec<u8>], path: &Trajectory, options: &Options) -> Result<Bearing, LinkError> {
    run(rx, tx, path, options).links.remove(0).bearing
}

/// A pose for each of `frames` frames of a fixture's circle, `late_s` late.
fn a_row_a_frame(frames: usize, late_s: f64) -> Trajectory {
    let pose = |k: usize| {
        let t_s = k as f64 * 0.01;
        let (sin, cos) = (2.0 * t_s).sin_cos();
        Pose { t_s: START_S + t_s + late_s, position_m: Vector3::new(0.3 * cos, 0.3 * sin, 0.0), heading_rad: None }
    };
    Trajectory::new((0..frames).map(pose).collect()).unwrap()
}

fn made() -> Link {
    link(400, 2.0)
}

#[test]
fn a_number_out_of_its_range_is_an_error_of_the_link() {
    let link = made();
    let accuracy = |accuracy| Options { fit_odometry: true, accuracy, ..options() };
    let usual = Accuracy::default();
    let mut spread = options();
    spread.odometry_sd_m = -1.0;
    for (asked, name) in [
        (accuracy(Accuracy { range_min_m: Some(0.0), ..usual }), "range_min_m"),
        (accuracy(Accuracy { range_min_m: Some(-0.1), ..usual }), "range_min_m"),
        (accuracy(Accuracy { range_min_m: Some(f64::NAN), ..usual }), "range_min_m"),
        (accuracy(Accuracy { elevation_max_rad: Some(f64::NAN), ..usual }), "elevation_max_rad"),
        (accuracy(Accuracy { height_m: Some(f64::INFINITY), ..usual }), "height_m"),
        (Options { heading_sd_rad: Some(f64::INFINITY), ..options() }, "heading_sd_rad"),
        (spread, "odometry_sd_m"),
    ] {
        let error = only_bearing(&link.rx, &link.tx, &trajectory(&link), &asked).unwrap_err();
        assert!(matches!(error, LinkError::OutOfRange { option, .. } if option == name), "{name}: {error}");
    }
    let nearest = accuracy(Accuracy { range_min_m: Some(0.01), ..usual });
    assert!(only_bearing(&link.rx, &link.tx, &trajectory(&link), &nearest).is_ok());
}

#[test]
fn one_log_for_both_sides_is_refused() {
    let (made, path) = (made(), a_row_a_frame(400, 0.0));
    for log in [&made.rx, &made.tx] {
        let refused = only_bearing(log, log, &path, &options()).unwrap_err();
        assert!(matches!(refused, LinkError::Unmatched(Unmatched::SameSender { .. })), "{refused:?}");
    }
    // Named, so that nothing is matched: the frames themselves are the same.
    let named = Options { rx_mac: Some(TRANSMITTER), tx_macs: vec![TRANSMITTER], ..options() };
    assert!(only_bearing(&made.rx, &made.rx, &path, &named).is_err());
    assert!(only_bearing(&made.rx, &made.tx, &path, &options()).is_ok());
}

#[test]
fn more_macs_than_logs_are_refused() {
    let made = made();
    let (mut rx, mut tx) = (log(&made.rx), log(&made.tx));
    let (transmitters, path) = (vec![Transmitter { log: &mut tx, trajectory: None }], trajectory(&made));
    let named = Options { rx_mac: None, tx_macs: vec![TRANSMITTER; 2], ..options() };
    let refused = bearings(&mut rx, transmitters, &path, &named).unwrap_err();
    assert!(matches!(refused, csi5300::source::Error::MoreMacs { macs: 2, logs: 1 }), "{refused}");
}

#[test]
fn a_row_for_each_frame_at_other_times_is_refused_and_joined_row_by_row() {
    let made = made();
    let late = a_row_a_frame(400, 0.5);
    let refused = only_bearing(&made.rx, &made.tx, &late, &options()).unwrap_err();
    assert_eq!(refused, LinkError::RowsNotTimes { rows: 400, outside: 50, pairs: 400 });
    assert!(only_bearing(&made.rx, &made.tx, &late, &Options { join: JoinBy::Row, ..options() }).is_ok());
    assert!(only_bearing(&made.rx, &made.tx, &late, &Options { clock_offset_s: 0.5, ..options() }).is_ok());
    // Fewer rows than frames: a trajectory that begins late is no row for each frame.
    let short = Trajectory::new(late.poses()[..300].to_vec()).unwrap();
    assert!(only_bearing(&made.rx, &made.tx, &short, &options()).is_ok());
}
