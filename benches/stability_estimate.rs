//! Numerical stability of the whole estimate, from the card's bytes to a bearing with range: error over what may be too small
//! or too large, beside the Cramer-Rao bound.
//!
//! `cargo bench --bench stability_estimate`
#![allow(clippy::expect_used)]

mod common;
#[path = "common/picture.rs"]
mod picture;

use common::*;
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::pipeline::{Accuracy, Bearing, Options, Transmitter, bearings};
use csi5300::signal::channel::{Channel, Width};
use csi5300_lab::compare::figures::true_path;
use csi5300_sim::motion::{Circle, Line, RobotMotion};
use csi5300_sim::radio::{Agc, FixedGain, Gain};
use csi5300_sim::{Room, scene::Scene};
use nalgebra::Vector3;
use picture::*;
use std::f64::consts::TAU;

#[path = "../crates/lab/tests/lab/ends.rs"]
mod ends;
use ends::{Ends, bound_deg};

/// Signal over noise in one direction on one subcarrier, dB.
const SNR_DB: f64 = 25.0;
/// The fastest drive, metres per second.
const SPEED_M_PER_S: f64 = 0.35;
/// The host stamps the end of an answer, so much after the middle between the two frames, seconds.
const LATE_S: f64 = 0.000_236;
/// An error is kept if it is within so many bounds of the truth, or within the floor, degrees: eight bits of the converter,
/// and poses that are interpolated.
const BOUNDS: f64 = 6.0;
const FLOOR_DEG: f64 = 0.02;

/// One run: its place on the axis, the room, how it is estimated, and where the origin of the odometry is.
struct Case {
    at: f64,
    scene: Scene,
    options: Options,
    origin_m: Vector3<f64>,
}

fn main() {
    banner("Numerical stability of the whole estimate");
    let mut table = Table::new(
        "stability_estimate",
        &[
            ("axis", 34),
            ("value", 9),
            ("azimuth_deg", 12),
            ("bound_deg", 10),
            ("elevation_deg", 13),
            ("place", 9),
            ("pairs", 8),
            ("verdict", 40),
        ],
    );
    let mut lines: Vec<Series> = Vec::new();
    for (axis, cases) in axes() {
        let mut points = Vec::new();
        for case in cases {
            let judged = judge(&case);
            if let Some((error_deg, _)) = judged.1 {
                points.push((case.at.abs().max(1e-6), error_deg.abs().max(1e-6)));
            }
            table.row(&[vec![axis.to_string(), format!("{:e}", case.at)], judged.0].concat());
        }
        if ["range (m)", "radius (m)", "origin (m)"].contains(&axis) {
            lines.push(Series { label: axis.into(), points });
        }
    }
    table.save();
    picture("stability_estimate", "Azimuth error of the whole estimate", "metres", "degrees", &lines);
}

fn away(azimuth_deg: f64, elevation_deg: f64, range_m: f64) -> [f64; 3] {
    let ((sin, cos), (up, flat)) = (azimuth_deg.to_radians().sin_cos(), elevation_deg.to_radians().sin_cos());
    [range_m * flat * cos, range_m * flat * sin, range_m * up]
}

/// A circle about which the robot drives no faster than real ones do.
fn ends(radius_m: f64, range_m: f64) -> Ends {
    let duration_s = (TAU * radius_m / SPEED_M_PER_S).max(6.0);
    let receiver = RobotMotion::Circle(Circle { radius_m, duration_s, turns: 1.0, start_s: 0.0 });
    Ends { receiver, transmitter_m: away(37.0, 3.0, range_m), duration_s, snr_db: SNR_DB, seed: 3, ..Ends::default() }
}

fn case(at: f64, ends: &Ends) -> Case {
    let channel = Channel::new(108, Width::Ht20).expect("channel 108");
    Case { at, scene: ends.scene(), options: Options::new(channel), origin_m: Vector3::zeros() }
}

fn nearest(mut case: Case, range_min_m: f64) -> Case {
    let accuracy = Accuracy { range_min_m: Some(range_min_m), ..case.options.accuracy };
    case.options = Options { accuracy, ..case.options };
    case
}

/// What may be too small or too large.
fn axes() -> Vec<(&'static str, Vec<Case>)> {
    let ranges = [0.3, 0.5, 1.0, 3.0, 10.0, 100.0, 1e3, 1e4, 1e5];
    let radii = [0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 400.0];
    let origins = [0.0, 1e3, 1e4, 1e5, 1e6, 1e7];
    let moving = |range_m: f64| {
        let line = RobotMotion::Line(Line { length_m: 0.8, duration_s: 6.0, start_s: 0.0 });
        Ends { transmitter: line, ..ends(0.3, range_m) }
    };
    let origin = |at: f64, ends: &Ends| Case { origin_m: Vector3::new(at, -at, 0.5 * at), ..case(at, ends) };
    let on_channel = |number: u16| {
        let mut made = case(f64::from(number), &ends(0.3, 5.0));
        made.scene.channel = number;
        made.options = Options::new(Channel::new(number.into(), Width::Ht20).expect("a channel of the scene"));
        made
    };
    let with_gain = |at: f64, gain: Gain| {
        let mut made = case(at, &ends(0.3, 5.0));
        made.scene.radio.gain = gain;
        made
    };
    // The card's clock wraps within the run, so long after its start.
    let wrapping = |after_s: f64| {
        let mut made = case(after_s, &ends(0.3, 5.0));
        made.scene.robot.iter_mut().for_each(|robot| robot.crystal.clock_start_us = (1 << 32) - (after_s * 1e6) as u64);
        made
    };
    let as_long = |rounds: f64| {
        let mut made = case(rounds, &ends(0.3, 5.0));
        made.scene.duration_s = rounds / 50.0;
        made.scene.robot[0].motion = RobotMotion::Circle(Circle {
            radius_m: 0.3,
            duration_s: rounds / 50.0,
            turns: (rounds / 300.0).ceil(),
            start_s: 0.0,
        });
        made
    };
    vec![
        ("range (m)", ranges.map(|r| nearest(case(r, &ends(0.1, r)), 0.2)).into()),
        ("range of two moving ends (m)", ranges[2..].iter().map(|r| nearest(case(*r, &moving(*r)), 0.5)).collect()),
        ("radius (m)", radii.map(|r| case(r, &ends(r, 20.0 * r.max(0.1)))).into()),
        ("origin (m)", origins.map(|at| origin(at, &ends(0.3, 5.0))).into()),
        ("origin of two moving ends (m)", origins.map(|at| origin(at, &moving(5.0))).into()),
        ("channel", [1, 6, 13, 36, 64, 108, 140, 165].map(on_channel).into()),
        (
            "steps of the converter (rms)",
            [1.0, 2.0, 4.0, 31.0, 90.0, 127.0]
                .map(|lsb| with_gain(lsb, Gain::Agc(Agc { target_lsb: lsb, ..Agc::default() })))
                .into(),
        ),
        (
            "fixed gain (steps at 1 m)",
            [2.0, 16.0, 256.0, 2_000.0, 20_000.0]
                .map(|lsb_at_1m| with_gain(lsb_at_1m, Gain::Fixed(FixedGain { lsb_at_1m, agc_db: 40 })))
                .into(),
        ),
        ("seconds to the clock's wrap", [0.5, 1.0, 3.0, 5.9].map(wrapping).into()),
        ("rounds", [300.0, 3_000.0, 30_000.0, 300_000.0].map(as_long).into()),
    ]
}

/// The cells of a run, and its error with the bound, degrees.
fn judge(case: &Case) -> (Vec<String>, Option<(f64, f64)>) {
    match estimate(case) {
        Ok(bearing) => judged(case, &bearing),
        Err(why) => {
            let none = || String::from("-");
            // Cells end at commas.
            (vec![none(), none(), none(), none(), none(), format!("refused: {}", why.replace(',', ";"))], None)
        }
    }
}

fn estimate(case: &Case) -> Result<Bearing, String> {
    let room = Room::new(&case.scene).map_err(|error| error.to_string())?;
    let [receiver, transmitter] = [0, 1].map(|robot| true_path(&room, robot).expect("a path"));
    let first = transmitter.poses()[0].position_m;
    let shifted = |path: &Trajectory, by: Vector3<f64>| {
        let pose = |pose: &Pose| Pose { position_m: pose.position_m + by, ..*pose };
        Trajectory::new(path.poses().iter().map(pose).collect()).expect("poses in order")
    };
    let receiver = shifted(&receiver, case.origin_m);
    // A transmitter's path is known up to where it began: here with an origin of its own.
    let moved = shifted(&transmitter, case.origin_m * -0.5 - first);
    let moves = case.scene.robot[1].motion != RobotMotion::Static;
    let simulation = room.run().map_err(|error| error.to_string())?;
    let [mut rx, mut tx] = [0, 1].map(|robot: usize| simulation.robots[robot].replay());
    let transmitters = vec![Transmitter { log: &mut tx, trajectory: moves.then_some(&moved) }];
    let options = Options { clock_offset_s: -LATE_S, ..case.options.clone() };
    let mut report = bearings(&mut rx, transmitters, &receiver, &options).map_err(|error| error.to_string())?;
    report.links.remove(0).bearing.map_err(|error| error.to_string())
}

fn judged(case: &Case, bearing: &Bearing) -> (Vec<String>, Option<(f64, f64)>) {
    let room = Room::new(&case.scene).expect("it ran");
    let [receiver, transmitter] = [0, 1].map(|robot| true_path(&room, robot).expect("a path"));
    let at = |path: &Trajectory, t_s: f64| path.at(t_s).map(|pose| pose.position_m).unwrap_or_default();
    let ways: Vec<Vector3<f64>> =
        bearing.samples.t_s().iter().map(|t| at(&transmitter, *t) - at(&receiver, *t)).collect();
    let away = ways.iter().sum::<Vector3<f64>>() / ways.len() as f64;
    let points: Vec<Vector3<f64>> = ways.iter().map(|way| away - way).collect();
    let phase_rad = (2.0 / (2.0 * 30.0 * 10f64.powf(0.1 * SNR_DB))).sqrt();
    let [bound, _] = bound_deg(&points, &away, case.options.channel.wavelength_m(), phase_rad);
    let (answer, truth) = (&bearing.answer, (away.y.atan2(away.x), away.z.atan2(away.xy().norm())));
    let error_deg = csi5300::maths::wrap_rad(answer.azimuth_rad - truth.0).to_degrees();
    let elevation_deg = (answer.abs_elevation_rad - truth.1.abs()).to_degrees();
    let place = answer.range.map_or("-".into(), |range| {
        let off_m = range.position_m - at(&transmitter, range.position_t_s) - case.origin_m;
        format!("{:.1e}", off_m.xy().norm() / away.norm())
    });
    let held = error_deg.abs() <= (BOUNDS * bound).max(FLOOR_DEG);
    let within = error_deg.abs().to_radians() <= 3.0 * answer.azimuth_sd_rad;
    let verdict = match (held, within) {
        (true, _) => "held",
        (false, true) => "beyond the bound; within its error bar",
        (false, false) => "BROKEN",
    };
    let cells = vec![
        format!("{error_deg:.1e}"),
        format!("{bound:.1e}"),
        format!("{elevation_deg:.1e}"),
        place,
        bearing.pairs.formed.to_string(),
        verdict.into(),
    ];
    (cells, Some((error_deg, bound)))
}
