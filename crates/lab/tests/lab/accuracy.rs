//! Accuracy of bearings of simulated captures, relative to the truth and to the Cramer-Rao bound.

use csi5300::maths::wrap_rad;
use csi5300::pipeline::{Accuracy, Options, Transmitter, bearings};
use csi5300::signal::channel::{Channel, Width};
use csi5300_lab::compare::figures::true_path;
use csi5300_lab::curves;
use csi5300_lab::suite::{Run, experiments, run, run_all};
use csi5300_sim::Room;
use csi5300_sim::motion::{Arc, Circle, RobotMotion};
use csi5300_sim::radio::{Gain, Noise};
use csi5300_sim::scene::Scene;
use nalgebra::Vector3;
use std::f64::consts::TAU;

fn options(near_field: bool) -> Options {
    let accuracy = Accuracy { near_field, ..Accuracy::default() };
    Options { accuracy, ..Options::new(Channel::new(108, Width::Ht20).unwrap()) }
}

fn circle(radius_m: f64, duration_s: f64) -> RobotMotion {
    RobotMotion::Circle(Circle { radius_m, duration_s, turns: 1.0, start_s: 0.0 })
}

/// The built-in scene of this name over a full circle of 30 cm, with its transmitter 100 times as far and as loud.
fn far(name: &str) -> Scene {
    let mut scene = Scene::built_in(name).unwrap();
    let place = &mut scene.robot[1].position_m;
    (place[0], place[1]) = (100.0 * place[0], 100.0 * place[1]);
    if let Gain::Fixed(fixed) = &mut scene.radio.gain {
        fixed.lsb_at_1m *= 100.0;
    }
    if let Noise::FloorDbm(dbm) = &mut scene.radio.noise {
        *dbm -= 40.0;
    }
    scene.wall.clear();
    if name == "lab-circle" {
        scene.robot[0].motion = circle(0.3, scene.duration_s - 2.0);
    }
    scene
}

/// Fewer rounds per second than in the built-in scenes, to save time.
fn sound(scene: &mut Scene, rate_hz: f64) {
    scene.sounding.as_mut().unwrap().rate_hz = rate_hz;
}

fn runs(scene: Scene, repetitions: u64, options: &Options) -> Vec<Run> {
    run_all(&[scene], repetitions, options).unwrap()
}

fn errors(runs: &[Run]) -> Vec<f64> {
    runs.iter().map(|run| run.error_deg.unwrap()).collect()
}

#[test]
fn with_the_papers_noise_a_circles_error_is_below_a_quarter_degree() {
    let found = errors(&runs(far("paper-circle"), 10, &options(true)));
    println!("far: {found:.4?}");
    assert!(found.iter().all(|error| error.abs() <= 0.25), "{found:?}");
    // At this noise a plane wave, which uses only the channel centre, loses to phase slips.
    let plane = errors(&runs(far("paper-circle"), 10, &options(false)));
    println!("far, plane wave: {plane:.4?}");
    assert!(plane.iter().all(|error| error.abs() <= 0.3), "{plane:?}");
    // At 4 m the wave front is curved: a plane wave has a bias, and sometimes takes the wrong one of the peaks into which the
    // curvature splits its own. The spherical wave has neither problem.
    let close = || Scene::built_in("paper-circle").unwrap();
    let (plane, spherical) = (errors(&runs(close(), 5, &options(false))), errors(&runs(close(), 5, &options(true))));
    println!("close, plane wave: {plane:.4?}; spherical wave: {spherical:.4?}");
    let rms = (spherical.iter().map(|error| error * error).sum::<f64>() / spherical.len() as f64).sqrt();
    assert!(rms <= 0.1, "{spherical:?}");
    let mut sizes: Vec<f64> = plane.iter().map(|error| error.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    assert!(sizes[2] <= 0.2, "{plane:?}");
}

/// A plane wave's profile has a null at the truth of this circle, between two of three peaks; the answer was never chosen from
/// it.
#[test]
fn the_drawn_curve_peaks_at_the_answer() {
    for name in ["paper-circle", "paper-line"] {
        let mut room = Room::new(&Scene::built_in(name).unwrap()).unwrap();
        let path = true_path(&room, 0).unwrap();
        let (mut rx, mut tx) = room.card(0).zip(room.card(1)).unwrap();
        let transmitters = vec![Transmitter { log: &mut tx, trajectory: None }];
        let report = bearings(&mut rx, transmitters, &path, &Options { keep_course: true, ..options(true) }).unwrap();
        let bearing = report.links[0].bearing.as_ref().unwrap();
        let curve = curves::evidence(bearing).unwrap();
        let highest = curve.points.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        let off = |azimuth_rad: f64| wrap_rad(highest.0.to_radians() - azimuth_rad).to_degrees().abs();
        let answer = &bearing.answer;
        let nearer = off(answer.azimuth_rad).min(answer.mirror_rad.map_or(f64::MAX, off));
        assert!(nearer < 1.0, "{name}: highest at {}, answer {}", highest.0, answer.azimuth_rad.to_degrees());
        assert!(curve.points.iter().all(|point| (0.0..=1.0).contains(&point.1)));
        let error_deg = errors(&runs(Scene::built_in(name).unwrap(), 1, &options(true)))[0];
        assert!(error_deg.abs() < 0.5, "{name}: {error_deg}");
    }
}

/// Compensation removes the effects of real captures' cards and turn-around.
#[test]
fn compensation_changes_the_phase_of_every_experiment() {
    for experiment in experiments().iter().filter(|experiment| experiment.duration_s <= 10.0) {
        let run = run(experiment, 1, &options(false)).unwrap();
        assert!(
            run.residual_compensated_rad < run.residual_rad - 0.02,
            "{}: {} -> {} rad",
            run.experiment,
            run.residual_rad,
            run.residual_compensated_rad
        );
    }
}

#[test]
fn with_all_radio_effects_the_error_is_below_half_a_degree() {
    for near_field in [false, true] {
        // A third of the built-in scene's rounds: if fewer pairs suffice, more do.
        let mut scene = far("lab-circle");
        sound(&mut scene, 33.0);
        let errors = errors(&runs(scene, 4, &options(near_field)));
        println!("all effects, far: {errors:.4?}");
        assert!(errors.iter().all(|error| error.abs() <= 0.5), "{errors:?}");
    }
}

/// The wavelength of channel 108, metres.
const WAVELENGTH_M: f64 = 299_792_458.0 / 5.54e9;

/// Deviation of a round trip's phase: two directions, thirty subcarriers each.
fn phase_rad(snr_db: f64) -> f64 {
    (2.0 / (2.0 * 30.0 * 10f64.powf(0.1 * snr_db))).sqrt()
}

/// Mean and standard deviation.
fn spread(errors: &[f64]) -> (f64, f64) {
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    (mean, (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / (errors.len() - 1) as f64).sqrt())
}

/// The Cramer-Rao bound of the azimuth, degrees, over a full circle, for `n` round trips of phase deviation `phase_rad` with
/// common phase unknown and elevation known.
fn bound_deg(n: f64, radius_m: f64, phase_rad: f64) -> f64 {
    let per_metre = 2.0 * TAU / WAVELENGTH_M;
    // Perpendicular to the bearing, a circle's places have the variance radius^2 / 2.
    (phase_rad / (per_metre * radius_m * (0.5 * n).sqrt())).to_degrees()
}

#[test]
fn errors_follow_the_cramer_rao_bound() {
    const SEEDS: u64 = 400;
    let options = options(false);
    let options =
        Options { accuracy: Accuracy { elevation_max_rad: Some(0.0), ..options.accuracy }, ..options.clone() };
    for snr_db in [12.0, 20.0] {
        let mut scene = far("paper-circle");
        (scene.duration_s, scene.robot[0].motion) = (4.0, circle(0.3, 4.0));
        sound(&mut scene, 50.0);
        scene.cfo = csi5300_sim::scene::Cfo::Off;
        scene.radio.noise = Noise::SnrDb(snr_db);
        scene.radio.host_latency_us = 0.0;
        let runs = runs(scene, SEEDS, &options);
        let errors = errors(&runs);
        let (mean, sd) = spread(&errors);
        let pairs = runs.iter().map(|run| run.pairs as f64).sum::<f64>() / SEEDS as f64;
        let bound = bound_deg(pairs, 0.3, phase_rad(snr_db));
        let predicted = runs.iter().map(|run| run.sd_deg.unwrap()).sum::<f64>() / SEEDS as f64;
        println!("{snr_db} dB: sd {sd:.5}, bound {bound:.5}, predicted {predicted:.5}, mean {mean:.5} deg");
        // The deviation of 400 errors is itself known to 3.5 %.
        assert!((sd / bound - 1.0).abs() < 0.1, "{snr_db} dB: {sd} of a bound of {bound}");
        // The host stamps the end of the answer; the phase is that of the middle of the exchange, a quarter of a millisecond earlier.
        // In that time the robot drives 0.02 degrees of this circle.
        assert!((mean - 0.02).abs() < 0.005, "{snr_db} dB: bias {mean}");
    }
}

#[test]
fn near_errors_follow_the_bound_with_range_and_height_unknown() {
    const SEEDS: u64 = 40;
    let mut squares = 0.0;
    let cases = [
        (0.3, 360.0, [-3.0, 1.2, 0.9], 10.0),
        (0.35, 200.0, [2.5, -2.0, 0.8], 20.0),
        (0.5, 220.0, [5.5, 1.0, 1.3], 15.0),
    ];
    for (radius_m, angle_deg, place_m, snr_db) in cases {
        let mut scene = Scene::built_in("paper-circle").unwrap();
        scene.duration_s = 5.0;
        scene.robot[0].motion = RobotMotion::Arc(Arc { radius_m, angle_deg, duration_s: 5.0, start_s: 0.0 });
        scene.robot[1].position_m = place_m;
        scene.cfo = csi5300_sim::scene::Cfo::Off;
        scene.radio.noise = Noise::SnrDb(snr_db);
        scene.radio.host_latency_us = 0.0;
        let runs = runs(scene, SEEDS, &options(true));
        let errors = errors(&runs);
        let (mean, sd) = spread(&errors);
        let pairs = runs[0].pairs as i32;
        let at = |k: i32| {
            let (sin, cos) = (angle_deg.to_radians() * f64::from(k) / f64::from(pairs)).sin_cos();
            Vector3::new(radius_m * sin, radius_m - radius_m * cos, 0.0)
        };
        let points: Vec<Vector3<f64>> = (0..pairs).map(at).collect();
        let middle = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
        let points: Vec<Vector3<f64>> = points.iter().map(|p| p - middle).collect();
        let [bound, _] =
            crate::ends::bound_deg(&points, &(Vector3::from(place_m) - middle), WAVELENGTH_M, phase_rad(snr_db));
        println!("{angle_deg} degrees, {snr_db} dB: sd {sd:.5}, bound {bound:.5}, mean {mean:.5} deg");
        squares += (sd / bound).powi(2) / cases.len() as f64;
        // The robot's movement in the quarter of a millisecond that the host stamps late.
        assert!((0.0..0.03).contains(&mean), "{mean}");
    }
    // The deviation of 120 errors is itself known to 6 %.
    assert!((squares.sqrt() - 1.0).abs() < 0.1, "{} times the bound", squares.sqrt());
}
