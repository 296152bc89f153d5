//! Bearings in simulated rooms: two logs and two antennas of one robot combined; odometry with known errors, corrected by the phases;
//! two robots with AX210s under FeitCSI, paired by the cards' clocks, turn-around by the FTM clock; two antennas among reflections,
//! where the product of their channels stands beside that at the first strong delay.

use csi_formats::{Item, items};
use csi5300::driver_iface::Mac;
use csi5300::driver_iface::bfee::Antenna;
use csi5300::driver_iface::record::{LENGTH_FIELD, code, written};
use csi5300::internal::ArrayFrame;
use csi5300::maths::wrap_rad;
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::num_complex::Complex32;
use csi5300::pipeline::{
    Answer, Array, Bearing, CaptureReport, JoinBy, OneLog, Options, Reason, Sufficient, Transmitter, Unexplained,
    bearings, lost_something, one_log,
};
use csi5300::source::other_card::Translated;
use csi5300::source::replay::Replay;
use csi5300_sim::{Room, Scene, SimulatedRobot, Simulation};
use nalgebra::Vector3;
use std::io::Read;

/// Runs a scene.
fn run_room(scene: &str) -> Simulation {
    Room::new(&Scene::parse(scene).unwrap()).unwrap().run().unwrap()
}

/// Simulates a room with one path; `motion` is that of the first robot.
fn one_path(motion: &str, antenna_b: &str, azimuth_deg: f64, seed: u64) -> Simulation {
    let (sin, cos) = azimuth_deg.to_radians().sin_cos();
    let scene = format!(
        "duration_s = 11.0\nseed = {seed}\nchannel = 108\ncfo = \"physical\"\nsounding.rate_hz = 40\nreflections = 1\n\
         [radio]\nnoise.snr_db = 20\nchain_deg = [-50.0, 0.0]\nsend_jitter_us = 60\nturn_around.spread_us = 8\n\
         [[robot]]\nname = \"rx\"\nantenna_b_m = {antenna_b}\nmotion = {motion}\n\
         [[robot]]\nname = \"tx\"\nposition_m = [{:.6}, {:.6}, 0.0]\ncrystal.offset_ppm = 3.0\n",
        8.0 * cos,
        8.0 * sin
    );
    run_room(&scene)
}

/// Bearings from two logs, from one, and from both combined.
fn three(run: &Simulation, array: &Array) -> [Bearing; 3] {
    let options = Options::new("108".parse().unwrap());
    let [rx, tx] = [0, 1].map(|k| &run.robots[k].log[..]);
    let path = run.robots[0].true_path.as_ref().unwrap();
    let (mut receiver, mut transmitter) = (Replay::new(rx, "rx".into()), Replay::new(tx, "tx".into()));
    let transmitters = vec![Transmitter { log: &mut transmitter, trajectory: None }];
    let two = bearings(&mut receiver, transmitters, path, &options).unwrap().links.remove(0).bearing.unwrap();
    let one = one_log(&mut Replay::new(rx, "rx".into()), path, array, &options).unwrap();
    let one = one.links.into_iter().next().unwrap().bearing.unwrap();
    let both = two.with_one_log(&one);
    [two, one, both]
}

/// How far the bearing is from the transmitter as seen from the middle of the samples, degrees.
fn off_deg(found: &Bearing, run: &Simulation) -> f64 {
    let way = run.robots[1].start_m().unwrap() - found.mean_position_m;
    wrap_rad(found.answer.azimuth_rad - way.y.atan2(way.x)).to_degrees()
}

fn rms(errors: &[[f64; 3]], kind: usize) -> f64 {
    (errors.iter().map(|own| own[kind].powi(2)).sum::<f64>() / errors.len() as f64).sqrt()
}

#[test]
fn with_one_path_the_combined_bearing_is_no_worse_than_either() {
    let array = Array::new(&[Antenna::A, Antenna::B], &[Vector3::new(0.1, 0.0, 0.0)]).unwrap();
    let circle = "{ circle = { radius_m = 0.05, duration_s = 10.0, start_s = 0.5 } }";
    let errors: Vec<[f64; 3]> = (0..10_u32)
        .map(|seed| {
            let azimuth_deg = 36.0 * f64::from(seed) - 170.0;
            let run = one_path(circle, "[-0.1, 0.0, 0.0]", azimuth_deg, seed.into());
            let found = three(&run, &array);
            let off = [0, 1, 2].map(|k| off_deg(&found[k], &run));
            let sd_deg = [0, 1, 2].map(|k| found[k].answer.azimuth_sd_rad.to_degrees());
            println!("{azimuth_deg}: {off:.2?} +- {sd_deg:.2?}");
            assert!(sd_deg[2] < 1.05 * sd_deg[0].min(sd_deg[1]) + 0.02, "{sd_deg:?}");
            off
        })
        .collect();
    let [two, one, both] = [0, 1, 2].map(|kind| rms(&errors, kind));
    println!("two logs {two:.3}, one log {one:.3}, both {both:.3} degrees");
    assert!(both < 1.1 * two.min(one) + 0.02, "{two} {one} {both}");
}

/// Half a metre straight ahead, then a full turn on the spot.
fn straight_then_around() -> std::path::PathBuf {
    let rows = (0..=550).map(|k| {
        let t_s = f64::from(k) * 0.02;
        let (x, yaw) = (0.5 * (t_s / 6.0).min(1.0), std::f64::consts::TAU * ((t_s - 6.0) / 5.0).max(0.0));
        format!("{t_s:.2},{x:.6},0.0,{yaw:.6}\n")
    });
    let file = std::env::temp_dir().join(format!("csi5300-both-{}.csv", std::process::id()));
    std::fs::write(&file, "t,x,y,yaw\n".to_owned() + &rows.collect::<String>()).unwrap();
    file
}

#[test]
fn turning_antennas_remove_the_mirror_of_a_straight_drive() {
    let path = straight_then_around();
    let motion = format!("{{ recorded = {{ file = '{}' }} }}", path.display());
    let array = Array::new(&[Antenna::A, Antenna::B], &[Vector3::new(0.05, 0.0, 0.0)]).unwrap();
    for (seed, azimuth_deg) in [(1, 40.0), (2, -65.0), (3, 120.0), (4, -140.0)] {
        let run = one_path(&motion, "[-0.05, 0.0, 0.0]", azimuth_deg, seed);
        let [two, one, both] = three(&run, &array);
        let shares = [&two, &one, &both].map(|of| of.answer.mirror_share);
        let off = [&two, &one, &both].map(|of| off_deg(of, &run));
        println!(
            "{azimuth_deg}: {off:.2?}, mirror {shares:?} {:?}",
            [&two, &one, &both].map(|of| of.answer.azimuth_sd_rad.to_degrees())
        );
        assert!(shares[0].is_some_and(|share| share > 0.3), "{shares:?}");
        assert!(shares[2].is_none_or(|share| share < 0.01), "{azimuth_deg}: {shares:?}");
        assert!(off[2].abs() < 3.0 * both.answer.azimuth_sd_rad.to_degrees(), "{azimuth_deg}: {off:?}");
    }
    std::fs::remove_file(path).unwrap();
}

/// Lengths for each reported one, and the antenna, metres forward and left.
const SCALE: f64 = 1.03;
const ANTENNA_M: Vector3<f64> = Vector3::new(0.06, 0.12, 0.0);

/// Three robots in a room with four walls; the first drives.
fn four_walls(motion: &str, seed: u64) -> Simulation {
    three_robots(motion, seed, true)
}

fn three_robots(motion: &str, seed: u64, has_walls: bool) -> Simulation {
    let walls: String = [[-5, -5, 5, -5], [5, -5, 5, 5], [5, 5, -5, 5], [-5, 5, -5, -5]]
        .iter()
        .filter(|_| has_walls)
        .map(|[a, b, c, d]| format!("[[wall]]\nfrom_m = [{a}.0, {b}.0]\nto_m = [{c}.0, {d}.0]\nloss_db = 8.0\n"))
        .collect();
    let scene = format!(
        "duration_s = 11.0\nseed = {seed}\nchannel = 108\ncfo = \"physical\"\nsounding.rate_hz = 100\nreflections = 1\n\
         [radio]\nnoise.snr_db = 20\n[[robot]]\nname = \"rx\"\nmotion = {motion}\n\
         [[robot]]\nname = \"tx1\"\nposition_m = [3.5, 0.8, 0.4]\ncrystal.offset_ppm = 1.0\n\
         [[robot]]\nname = \"tx2\"\nposition_m = [-1.2, -3.0, 0.2]\ncrystal.offset_ppm = -1.0\n{walls}"
    );
    run_room(&scene)
}

fn at_clock_offset(run: &Simulation, offset_s: f64, join: JoinBy) -> CaptureReport {
    at_offset(run, "108", offset_s, join)
}

fn at_offset(run: &Simulation, channel: &str, offset_s: f64, join: JoinBy) -> CaptureReport {
    let options = Options { clock_offset_s: offset_s, join, ..Options::new(channel.parse().unwrap()) };
    let [mut rx, mut one, mut two] = [0, 1, 2].map(|k| run.robots[k].replay());
    let transmitters = [&mut one, &mut two].map(|log| Transmitter { log, trajectory: None }).into();
    bearings(&mut rx, transmitters, run.robots[0].true_path.as_ref().unwrap(), &options).unwrap()
}

/// At other times these motions are not turned alone, so the place by wrong times leads to no right one.
#[test]
fn motions_that_turn_both_ways_tell_clocks_that_differ() {
    let eight = "{ figure_eight = { radius_m = 0.4, duration_s = 12.0, start_s = 1.5 } }";
    let square = "{ square = { side_m = 0.6, duration_s = 12.0, start_s = 1.5 } }";
    for (motion, seed) in [(eight, 3), (eight, 4), (square, 3)] {
        let run = three_robots(motion, seed, true);
        assert_eq!(at_clock_offset(&run, 0.0, JoinBy::Time).clock_doubt(), None, "{motion}");
        for offset_s in [0.3, -0.6, 2.0] {
            let doubt = at_clock_offset(&run, offset_s, JoinBy::Time).clock_doubt();
            println!("{motion}, {offset_s} s: {doubt:?}");
            assert!(doubt.is_some_and(|found| found.offset_s.abs() < 0.1), "{motion}, {offset_s} s: {doubt:?}");
        }
    }
}

#[test]
fn clocks_that_differ_are_told_with_their_offset() {
    let circle = "{ circle = { radius_m = 0.3, duration_s = 6.0, start_s = 2.5 } }";
    for has_walls in [true, false] {
        let run = three_robots(circle, 5, has_walls);
        let at = |offset_s: f64, join: JoinBy| at_clock_offset(&run, offset_s, join);
        let right = at(0.0, JoinBy::Time);
        assert!(right.clock_doubt().is_none() && !lost_something(&right), "{has_walls}: {:?}", right.clock_doubt());
        for offset_s in [0.3, -0.3, 1.5, -1.5, 4.0] {
            let report = at(offset_s, JoinBy::Time);
            let doubt = report.clock_doubt().unwrap_or_else(|| panic!("{has_walls}, {offset_s} s"));
            println!("{has_walls}, {offset_s} s: {doubt:?}");
            assert!(doubt.offset_s.abs() < 0.1 && doubt.sd_s < 0.1, "{has_walls}, {offset_s} s: {doubt:?}");
            assert!(lost_something(&report));
            for (link, right) in report.links.iter().zip(&right.links) {
                let [found, right] = [link, right].map(|link| link.bearing.as_ref().unwrap());
                let off_rad = wrap_rad(found.answer.azimuth_rad - right.answer.azimuth_rad).abs();
                let sd_rad = found.answer.azimuth_sd_rad;
                assert!((0.1..1.1 * sd_rad).contains(&off_rad), "{offset_s} s: {off_rad} +- {sd_rad}");
                assert!(found.answer.probability < 0.2, "{:?}", found.answer);
                assert!(found.answer.candidates[0].share < 0.2 && !found.answer.has_place());
            }
        }
        // Poses of the n-th row have no clock.
        assert!(
            at(0.3, JoinBy::Row)
                .links
                .iter()
                .all(|link| { link.bearing.as_ref().map_or(true, |bearing| bearing.clock_offset.is_none()) })
        );
    }
}

/// Between the steps of the comparison, too: while these robots drive for a step, the phases turn once or twice.
#[test]
fn clocks_that_differ_by_any_time_are_told() {
    let slow = "{ circle = { radius_m = 0.3, duration_s = 6.0, start_s = 2.5 } }";
    let fast = "{ circle = { radius_m = 0.5, duration_s = 5.0, start_s = 2.5 } }";
    for (motion, has_walls) in [(slow, true), (slow, false), (fast, true), (fast, false)] {
        let run = three_robots(motion, 1, has_walls);
        for offset_s in [-0.75, -0.33, -0.25, 0.17, 0.25, 0.5, 1.04] {
            let doubt = at_clock_offset(&run, offset_s, JoinBy::Time).clock_doubt();
            assert!(
                doubt.is_some_and(|found| found.offset_s.abs() < 0.1),
                "{motion} {has_walls} {offset_s}: {doubt:?}"
            );
        }
    }
}

/// The circle alone is the same at all times; the robot's rest after it is not.
#[test]
fn one_wave_explains_the_pairs_at_rest_too() {
    let run = run_room(
        "duration_s = 14.0\nseed = 4\nchannel = 11\ncfo = \"physical\"\nsounding.rate_hz = 30\n[radio]\nnoise.snr_db = 11\n\
         [[robot]]\nname = \"rx\"\nmotion.circle = { radius_m = 0.55, duration_s = 8.4, start_s = 0.0 }\n\
         [[robot]]\nname = \"tx1\"\nposition_m = [1.4, 3.2, 0.3]\n[[robot]]\nname = \"tx2\"\nposition_m = [-1.9, 2.4, 0.3]\n",
    );
    let at = |offset_s: f64| {
        let report = at_offset(&run, "11", offset_s, JoinBy::Time);
        let sufficient = report.links[0].bearing.as_ref().map(|bearing| bearing.sufficient);
        (sufficient.ok(), report.clock_doubt().map(|found| found.offset_s))
    };
    assert!(matches!(at(0.0), (Some(Sufficient::OneWave(_)), None)), "{:?}", at(0.0));
    for offset_s in [0.45, 0.74] {
        let (sufficient, doubt) = at(offset_s);
        let rests = matches!(sufficient, Some(Sufficient::Posterior(Reason::Unexplained(Unexplained::AtRest(_)))));
        assert!(rests && doubt.is_some_and(|found| found.abs() < 0.1), "{offset_s}: {sufficient:?} {doubt:?}");
    }
}

/// What wheels report whose lengths are too short, of a point that the antenna is seen from.
fn wheels(run: &Simulation) -> Trajectory {
    let middle = run.robots[0].true_path.as_ref().unwrap().with_antenna_offset(-ANTENNA_M).unwrap();
    let shorter = |pose: &Pose| Pose { position_m: pose.position_m / SCALE, ..*pose };
    Trajectory::new(middle.poses().iter().map(shorter).collect()).unwrap()
}

fn answers(run: &Simulation, path: &Trajectory, fit: bool) -> Vec<(Answer, Bearing)> {
    estimated(run, path, &Options { fit_odometry: fit, ..Options::new("108".parse().unwrap()) })
}

fn estimated(run: &Simulation, path: &Trajectory, options: &Options) -> Vec<(Answer, Bearing)> {
    let mut logs: Vec<_> = run.robots.iter().map(|robot| robot.replay()).collect();
    let (receiver, others) = logs.split_first_mut().unwrap();
    let transmitters = others.iter_mut().map(|log| Transmitter { log, trajectory: None }).collect();
    let report = bearings(receiver, transmitters, path, options).unwrap();
    report.links.into_iter().map(|link| (Answer::new("tx".into(), &link), link.bearing.unwrap())).collect()
}

/// Largest error of a bearing, degrees.
fn worst_deg(run: &Simulation, found: &[(Answer, Bearing)]) -> f64 {
    let errors = run.robots[1..].iter().zip(found).map(|(robot, (_, bearing))| {
        let times = bearing.samples.t_s().iter();
        let places: Vec<_> = times.filter_map(|t_s| run.robots[0].true_path.as_ref().unwrap().at(*t_s)).collect();
        let mean = places.iter().map(|pose| pose.position_m).sum::<Vector3<f64>>() / places.len() as f64;
        let way = robot.start_m().unwrap() - mean;
        wrap_rad(bearing.answer.azimuth_rad - way.y.atan2(way.x)).to_degrees().abs()
    });
    errors.fold(0.0, f64::max)
}

#[test]
fn a_drive_with_curves_to_both_sides_shows_scale_and_offset() {
    for seed in 1..=2 {
        let simulation = four_walls("{ figure_eight = { radius_m = 0.25, duration_s = 10.0, start_s = 0.5 } }", seed);
        let path = wheels(&simulation);
        let (before, after) = (answers(&simulation, &path, false), answers(&simulation, &path, true));
        assert!(before.iter().all(|(answer, bearing)| bearing.odometry_fit.is_none() && answer.odometry_fit.is_none()));
        let fit = after[0].1.odometry_fit.clone().unwrap();
        println!("{fit:?}\n{fit}");
        assert!(fit.refused.is_none() && fit.links == 2 && after[1].0.odometry_fit.as_ref() == Some(&fit), "{fit:?}");
        for (own, truth) in
            [(fit.scale, SCALE - 1.0), (fit.turn, 0.0), (fit.forward_m, ANTENNA_M.x), (fit.left_m, ANTENNA_M.y)]
        {
            assert!((own.value - truth).abs() < 3.0 * own.sd, "{own:?}, {truth}");
        }
        // Elevations hide the scale.
        assert!(fit.turn.known && fit.forward_m.known && fit.left_m.known, "{fit:?}");
        assert!(fit.forward_m.sd < 0.015 && fit.left_m.sd < 0.015, "{fit:?}");
        let [bad, good] = [&before, &after].map(|found| worst_deg(&simulation, found));
        println!("{bad} {good}");
        assert!(good < 2.0 && bad > 2.0 * good, "{bad} {good}");
    }
}

/// What odometry reports whose heading drifts evenly, by `mean_rad` in the mean.
fn drifting(path: &Trajectory, mean_rad: f64) -> Trajectory {
    let poses = path.poses();
    let steps: Vec<_> = poses.windows(2).map(|pair| pair[1].position_m - pair[0].position_m).collect();
    let whole_m: f64 = steps.iter().map(|step| step.norm()).sum();
    let (mut driven_m, mut position_m) = (0.0, poses[0].position_m);
    let mut bent = vec![poses[0]];
    for (step, pose) in steps.iter().zip(&poses[1..]) {
        driven_m += step.norm();
        let turned = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), 2.0 * mean_rad * driven_m / whole_m);
        position_m += turned * step;
        bent.push(Pose { position_m, ..*pose });
    }
    Trajectory::new(bent).unwrap()
}

/// Evenly spread over the normal density: 8 % to 92 %.
const QUANTILES: [f64; 6] = [-1.38, -0.67, -0.21, 0.21, 0.67, 1.38];

#[test]
fn ranges_by_a_heading_that_drifts_are_as_uncertain_as_the_path_is_bent() {
    let sd_rad = 1.5f64.to_radians();
    for walls in [false, true] {
        let mut off = Vec::new();
        for (k, mean_rad) in QUANTILES.iter().map(|q| q * sd_rad).enumerate() {
            let run = three_robots(
                "{ arc = { radius_m = 0.6, angle_deg = 150.0, duration_s = 10.0, start_s = 0.5 } }",
                k as u64,
                walls,
            );
            let path = drifting(run.robots[0].true_path.as_ref().unwrap(), mean_rad);
            let options = Options { heading_sd_rad: Some(sd_rad), ..Options::new("108".parse().unwrap()) };
            let found = estimated(&run, &path, &options);
            for (robot, (_, bearing)) in run.robots[1..].iter().zip(&found) {
                let Some(range) = &bearing.answer.range else { continue };
                let way = robot.start_m().unwrap() - bearing.mean_position_m;
                off.push((range.range_m - way.norm()) / range.sd_m);
            }
        }
        let within = |sds: f64| off.iter().filter(|own| own.abs() < sds).count();
        println!("walls {walls}: {off:.2?}");
        assert!(off.len() >= 8, "{off:?}");
        assert!(2 * within(1.0) >= off.len() && within(3.0) == off.len(), "too narrow: {off:?}");
        assert!(within(0.3) < off.len(), "too wide: {off:?}");
    }
}

#[test]
fn elevations_by_a_path_of_the_wrong_scale_are_no_surer_than_it_is() {
    let scene = |wall: &str| {
        format!(
            "duration_s = 11.0\nchannel = 108\ncfo = \"physical\"\nsounding.rate_hz = 100\nreflections = 1\n\
             [radio]\nnoise.snr_db = 20\n[[robot]]\nname = \"rx\"\n\
             motion = {{ arc = {{ radius_m = 0.6, angle_deg = 150.0, duration_s = 10.0, start_s = 0.5 }} }}\n\
             [[robot]]\nname = \"tx\"\nposition_m = [3.0, 1.0, 1.0]\n{wall}"
        )
    };
    let wall = "[[wall]]\nfrom_m = [-4.0, 4.0]\nto_m = [4.0, 4.0]\nloss_db = 14.0\n";
    for (wall, heading_deg, scale_sd) in [("", 1.5f64, 0.025), (wall, 0.3, 0.01)] {
        let run = run_room(&scene(wall));
        let mut given = 0;
        for scale in [-1.0, -0.4, 0.0, 0.4, 1.0].map(|sds| 1.0 + sds * scale_sd) {
            let scaled = |pose: &Pose| Pose { position_m: pose.position_m * scale, ..*pose };
            let path = run.robots[0].true_path.as_ref().unwrap().poses().iter().map(scaled).collect();
            let options =
                Options { heading_sd_rad: Some(heading_deg.to_radians()), ..Options::new("108".parse().unwrap()) };
            let (answer, bearing) = estimated(&run, &Trajectory::new(path).unwrap(), &options).remove(0);
            let way = run.robots[1].start_m().unwrap() - bearing.mean_position_m;
            let truth_deg = way.z.atan2(way.xy().norm()).to_degrees();
            let Some((elevation_deg, sd_deg)) = answer.abs_elevation_deg.zip(answer.elevation_sd_deg) else { continue };
            println!("{scale}: {elevation_deg:.1} +- {sd_deg:.1}, truth {truth_deg:.1}; {:?}", bearing.sufficient);
            given += 1;
            assert!((elevation_deg - truth_deg).abs() < 3.5 * sd_deg);
        }
        assert!(given >= 2, "{given}");
    }
}

#[test]
fn a_straight_drive_that_a_drifting_heading_bends_has_a_mirror() {
    for (sd_deg, line_m) in [(3.9, 1.0), (1.5, 2.0)] {
        let (mut shares, mut on_the_other_side) = (Vec::new(), 0.0);
        for (k, quantile) in QUANTILES.iter().enumerate() {
            let motion = format!("{{ line = {{ length_m = {line_m:?}, duration_s = 10.0, start_s = 0.5 }} }}");
            let run = three_robots(&motion, k as u64, false);
            let sd_rad = f64::to_radians(sd_deg);
            let path = drifting(run.robots[0].true_path.as_ref().unwrap(), quantile * sd_rad);
            let options = Options { heading_sd_rad: Some(sd_rad), ..Options::new("108".parse().unwrap()) };
            for (robot, (answer, bearing)) in run.robots[1..].iter().zip(&estimated(&run, &path, &options)) {
                shares.push(answer.mirror_share.unwrap_or(0.0));
                let side = robot.start_m().unwrap().y.signum();
                on_the_other_side += f64::from(u8::from(bearing.answer.azimuth_rad.sin().signum() != side));
            }
        }
        let said: f64 = shares.iter().sum();
        println!("{on_the_other_side} of {} on the other side, {said:.1} expected", shares.len());
        assert!(shares.iter().all(|share| *share > 0.2), "{shares:?}");
        assert!((on_the_other_side - said).abs() < 2.0 * (0.25 * shares.len() as f64).sqrt());
    }
}

#[test]
fn right_odometry_stays_as_it_is() {
    let simulation = four_walls("{ figure_eight = { radius_m = 0.25, duration_s = 10.0, start_s = 0.5 } }", 3);
    let path = simulation.robots[0].true_path.clone().unwrap();
    let (before, after) = (answers(&simulation, &path, false), answers(&simulation, &path, true));
    let fit = after[0].1.odometry_fit.clone().unwrap();
    assert!(fit.refused.is_some_and(|why| why.contains("hardly prefer")));
    for ((_, before), (_, after)) in before.iter().zip(&after) {
        assert_eq!(before.answer, after.answer);
    }
}

/// A robot on a circle of 25 cm, another one `offset_ppm` faster, 20 dB of noise.
fn ax210s((azimuth_deg, range_m): (f64, f64), preamble: &str, offset_ppm: f64, seed: u64) -> Simulation {
    let (sin, cos) = azimuth_deg.to_radians().sin_cos();
    let scene = format!(
        "duration_s = 15.0\nseed = {seed}\nchannel = 108\ncard = \"ax210\"\npreamble = \"{preamble}\"\ncfo = \"physical\"\n\
         sounding.rate_hz = 60\n\
         [radio]\nnoise.snr_db = 20\nsend_jitter_us = 60\ndelay_ns = 100\ndelay_std_ns = 20\nturn_around.spread_us = 8\n\
         [[robot]]\nname = \"rx\"\nmotion.circle = {{ radius_m = 0.25, duration_s = 15.0 }}\n\
         crystal.clock_start_us = 4294960000\n\
         [[robot]]\nname = \"tx\"\nposition_m = [{:.6}, {:.6}, 0.0]\ncrystal.offset_ppm = {offset_ppm:?}\n",
        range_m * cos,
        range_m * sin
    );
    run_room(&scene)
}

/// Its log as one of a 5300, with the FTM clock or with whole microseconds alone.
fn log(robot: &SimulatedRobot, finely: bool) -> Vec<u8> {
    let mut all = Vec::new();
    Translated::new(&robot.log[..]).read_to_end(&mut all).unwrap();
    let kept = |record: &&[u8]| finely || record[LENGTH_FIELD] != code::CARD_CLOCK;
    written(&all).filter(kept).flatten().copied().collect()
}

fn bearing(run: &Simulation, finely: bool) -> Bearing {
    let [rx, tx] = [0, 1].map(|k| log(&run.robots[k], finely));
    let (mut rx, mut tx) = (Replay::new(&rx[..], "rx".into()), Replay::new(&tx[..], "tx".into()));
    let transmitters = vec![Transmitter { log: &mut tx, trajectory: None }];
    let path = run.robots[0].true_path.as_ref().unwrap();
    let mut report = bearings(&mut rx, transmitters, path, &Options::new("108".parse().unwrap())).unwrap();
    assert_eq!((report.receiver.survey.damages, report.receiver.survey.wsr_2021), (0, run.robots[0].records));
    report.links.pop().unwrap().bearing.unwrap()
}

/// Crystals 18 ppm apart, 100 kHz: a microsecond of the turn-around is a tenth of a turn.
#[test]
fn the_ftm_clock_takes_the_turn_around_out_where_microseconds_leave_a_part() {
    let (mut errors, mut coherence) = ([0.0, 0.0], [0.0, 0.0]);
    let runs = 6;
    for seed in 0..runs {
        // So far away that the wave is plane.
        let preamble = ["he", "ht", "vht"][seed as usize % 3];
        let run = ax210s((20.0 + 70.0 * seed as f64, 500.0), preamble, 18.0, seed);
        for (k, finely) in [true, false].into_iter().enumerate() {
            let found = bearing(&run, finely);
            assert!(found.pairs.formed as f64 >= 0.99 * run.robots[0].records as f64, "{preamble}: {:?}", found.pairs);
            errors[k] += off_deg(&found, &run).powi(2) / runs as f64;
            coherence[k] += found.plane_wave.coherence / runs as f64;
        }
    }
    // Phases that are left of `1 - coherence`, for small ones.
    let left_rad = coherence.map(|coherence| (2.0 * (1.0 - coherence)).sqrt());
    let errors_deg = errors.map(f64::sqrt);
    println!("FTM, 1 us: phase {left_rad:.3?} rad, bearing {errors_deg:.4?} degrees");
    assert!(left_rad[0] < 0.3 * left_rad[1] && errors_deg[0] < 0.7 * errors_deg[1], "{left_rad:?} {errors_deg:?}");
}

const BASELINE_M: f64 = 0.05;
/// SplitMix64, from `low` to `high`.
fn random(state: &mut u64, low: f64, high: f64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (*state ^ (*state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    low + (high - low) * ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// A room of four walls, in which a robot with two antennas turns in place before another one.
fn room(seed: u64, bandwidth_mhz: u16) -> Simulation {
    let mut state = seed;
    let mut between = |low, high| random(&mut state, low, high);
    let (x, y) = (between(5.0, 9.0), between(4.0, 7.0));
    let ([from_x, from_y], azimuth, range) =
        ([between(-0.8, 0.8), between(-0.8, 0.8)], between(-3.1, 3.1), between(0.5, 0.9));
    let (to_x, to_y) =
        (from_x + range * (0.5 * x - 1.0) * azimuth.cos(), from_y + range * (0.5 * y - 1.0) * azimuth.sin());
    let walls = [[[-x, -y], [x, -y]], [[x, -y], [x, y]], [[x, y], [-x, y]], [[-x, y], [-x, -y]]];
    let walls: String = walls
        .iter()
        .map(|[a, b]| {
            let half = |p: &[f64; 2]| format!("[{:.3}, {:.3}]", 0.5 * p[0], 0.5 * p[1]);
            format!("[[wall]]\nfrom_m = {}\nto_m = {}\nloss_db = {:.1}\n", half(a), half(b), between(4.0, 10.0))
        })
        .collect();
    let scene = format!(
        "duration_s = 4.0\nseed = {seed}\nreflections = 2\ncard = \"ax210\"\nbandwidth_mhz = {bandwidth_mhz}\nchannel = 108\n\
         sounding.rate_hz = 20\n[radio]\nnoise.snr_db = 20\ndelay_ns = 100\ndelay_std_ns = 10\nchain_deg = [70.0, 0.0]\n\
         [[robot]]\nname = \"rx\"\nposition_m = [{from_x:.3}, {from_y:.3}, 0.4]\nantenna_b_m = [{BASELINE_M}, 0.0, 0.0]\n\
         motion.circle = {{ radius_m = 0.0, duration_s = 4.0 }}\n\
         [[robot]]\nname = \"tx\"\nposition_m = [{to_x:.3}, {to_y:.3}, 0.4]\n{walls}"
    );
    run_room(&scene)
}

/// Error of the bearing, degrees: of the whole product, and of what the library takes.
fn errors_deg(run: &Simulation) -> [f64; 2] {
    let robot = &run.robots[0];
    let array = Array::new(&[Antenna::A, Antenna::B], &[Vector3::new(-BASELINE_M, 0.0, 0.0)]).unwrap();
    let mut options = Options::new("108".parse().unwrap());
    options.accuracy.elevation_max_rad = Some(0.0);
    let mut both = [true, false].map(|_| OneLog::new(array.clone(), options.clone()));
    for item in items(&robot.log).unwrap() {
        let Item::Frame(frame) = item else { panic!("{item:?}") };
        let csi = |antenna: Antenna, _| {
            let column = frame.column(antenna.index(), 0)?;
            let measured = column.iter().zip(&frame.measured).filter(|(_, measured)| **measured);
            Some(measured.map(|([re, im], _)| Complex32::new(*re, *im)).collect())
        };
        let [whole, first] = &mut both;
        whole.hear(ArrayFrame::new(&array, Mac(frame.sender.unwrap()), frame.host_us, 1, csi).unwrap());
        assert!(first.note_frame(&frame));
    }
    let path = robot.true_path.as_ref().unwrap();
    let way = run.robots[1].start_m().unwrap() - path.poses()[0].position_m;
    both.map(|one| {
        let answer = one.bearings(path).links.pop().unwrap().bearing.unwrap().answer;
        wrap_rad(answer.azimuth_rad - way.y.atan2(way.x)).to_degrees()
    })
}

/// Rooms as large as offices are: at 160 MHz one delay is 1.9 m long. At 20 and 40 MHz it holds most of the room, and is not used.
#[test]
fn in_wide_frames_the_first_delay_is_nearer_than_the_product() {
    for (bandwidth_mhz, rooms) in [(40, 2), (160, 48)] {
        let errors: Vec<[f64; 2]> = (0..rooms).map(|seed| errors_deg(&room(100 + seed, bandwidth_mhz))).collect();
        let at = |k: usize, share: usize| {
            let mut sizes: Vec<f64> = errors.iter().map(|both| both[k].abs()).collect();
            sizes.sort_by(f64::total_cmp);
            sizes[sizes.len() * share / 100]
        };
        let better = errors.iter().filter(|[whole, first]| first.abs() < whole.abs()).count();
        let [whole, first] = [0, 1].map(|k| [50, 90].map(|share| at(k, share)));
        println!(
            "{bandwidth_mhz} MHz: product {whole:.2?}, first delay {first:.2?} degrees; better in {better} of {rooms}"
        );
        match bandwidth_mhz {
            40 => assert!(errors.iter().all(|[whole, first]| whole == first)),
            _ => assert!(first[0] < 0.8 * whole[0] && 2 * better > errors.len(), "{whole:?} {first:?} {better}"),
        }
    }
}
