//! Motion in space and motion of both ends, in free space: a part of what `research`'s `geometries` runs.

use crate::ends::{Ends, Seen};
use csi5300::maths::wrap_rad;
use csi5300::pipeline::{Accuracy, Bearing, Effort, Options, WaveModel};
use csi5300_lab::evaluate::{TrajectorySource, find};
use csi5300_sim::motion::{Arc, Circle, Helix, Line, RobotMotion, Waypoints};
use csi5300_sim::{Room, write_dataset};
use std::f64::consts::TAU;
use std::path::Path;

fn options() -> Options {
    Options::new("108".parse().unwrap())
}

fn see(ends: &Ends) -> Seen {
    ends.see(&options()).unwrap_or_else(|error| panic!("{error}: {ends:?}"))
}

/// The bearing of a recording, and how it is judged.
fn judged(ends: &Ends, options: &Options) -> (Bearing, Seen) {
    let recording = ends.record().unwrap();
    let bearing = recording.bearing(options).unwrap();
    let seen = recording.judge(&bearing);
    (bearing, seen)
}

/// Along straight parts, metres and metres per second.
fn drive(points_m: &[[f64; 3]], speed_m_s: f64) -> RobotMotion {
    RobotMotion::Waypoints(Waypoints { points_m: points_m.to_vec(), speed_m_s, start_s: 0.0 })
}

fn line(length_m: f64) -> RobotMotion {
    RobotMotion::Line(Line { length_m, duration_s: 6.0, start_s: 0.0 })
}

fn helix(radius_m: f64, rise_m: f64, turns: f64) -> RobotMotion {
    RobotMotion::Helix(Helix { radius_m, rise_m, duration_s: 6.0, turns, start_s: 0.0 })
}

fn circle(radius_m: f64, turns: f64) -> RobotMotion {
    RobotMotion::Circle(Circle { radius_m, duration_s: 6.0, turns, start_s: 0.0 })
}

/// Metres from the origin.
fn away(azimuth_deg: f64, elevation_deg: f64, range_m: f64) -> [f64; 3] {
    let ((sin, cos), (up, flat)) = (azimuth_deg.to_radians().sin_cos(), elevation_deg.to_radians().sin_cos());
    [range_m * flat * cos, range_m * flat * sin, range_m * up]
}

fn in_space(receiver: RobotMotion, transmitter_m: [f64; 3], seed: u64) -> Ends {
    Ends { receiver, transmitter_m, duration_s: 6.0, snr_db: 15.0, seed, ..Ends::default() }
}

#[test]
fn a_helix_shows_azimuth_and_signed_elevation_at_the_bound() {
    let (mut squares, mut count) = ([0.0; 2], 0.0);
    for (k, elevation_deg) in [-75.0, -60.0, -30.0, -15.0, 0.0, 15.0, 45.0, 75.0].into_iter().enumerate() {
        for azimuth_deg in [-130.0, 20.0] {
            let place_m = away(azimuth_deg + 11.0 * k as f64, elevation_deg, 20.0);
            let seen = see(&in_space(helix(0.3, 0.3, 1.0), place_m, k as u64));
            let elevation_error_deg = seen.elevation_error_deg.unwrap();
            println!(
                "{elevation_deg}: {:.4} {elevation_error_deg:.4}, bound {:.4?}",
                seen.azimuth_error_deg, seen.bound_deg
            );
            assert!(seen.signed, "{elevation_deg}: {seen:?}");
            assert!(seen.azimuth_error_deg.abs() < 0.3 && elevation_error_deg.abs() < 0.5, "{elevation_deg}: {seen:?}");
            squares[0] += (seen.azimuth_error_deg / seen.bound_deg[0]).powi(2);
            squares[1] += (elevation_error_deg / seen.bound_deg[1]).powi(2);
            count += 1.0;
        }
    }
    let over = squares.map(|sum| (sum / count).sqrt());
    // 16 errors determine a deviation to 18 %.
    assert!(over.iter().all(|over| *over < 1.55), "{over:?} times the bound");
}

#[test]
fn a_tilted_circle_has_the_direction_beside_its_reflection() {
    for tilt_deg in [5.0, 10.0, 30.0] {
        let (up, flat) = f64::to_radians(tilt_deg).sin_cos();
        let point = |k: i32| {
            let (sin, cos) = (TAU * f64::from(k) / 60.0).sin_cos();
            [0.3 * (cos - 1.0) * flat, 0.3 * sin, 0.3 * (cos - 1.0) * up]
        };
        let motion = drive(&(1..=60).map(point).collect::<Vec<_>>(), 0.05 * TAU);
        for (elevation_deg, azimuth_deg) in
            [-35.0, 0.0, 10.0].into_iter().flat_map(|e| [0, 45, 90, 150, 240, 315].map(move |k| (e, f64::from(k))))
        {
            let seen = see(&in_space(motion.clone(), away(azimuth_deg, elevation_deg, 8.0), 1));
            let is_candidate = seen.nearest_candidate_deg < 0.5;
            let is_within = seen.azimuth_error_deg.abs() < 2.5 * seen.azimuth_sd_deg;
            assert!(is_within || is_candidate, "{tilt_deg} {elevation_deg} {azimuth_deg}: {seen:?}");
            // Beyond 20 degrees the prior expects no transmitter.
            let is_expected = elevation_deg > -20.0 && !is_candidate;
            let has_place = seen.position_level.is_none_or(|level| level < 13.8 || !is_expected);
            assert!(has_place, "{tilt_deg} {elevation_deg} {azimuth_deg}: {seen:?}");
        }
    }
}

#[test]
fn a_near_place_is_found_above_and_below() {
    let arc = RobotMotion::Arc(Arc { radius_m: 0.4, angle_deg: 200.0, duration_s: 6.0, start_s: 0.0 });
    let cases = [
        (helix(0.3, 0.3, 1.0), -60.0, 0.7),
        (helix(0.3, 0.3, 1.0), 30.0, 1.2),
        (helix(0.3, 0.3, 1.0), -10.0, 2.5),
        (helix(0.3, 0.3, 1.0), 60.0, 3.0),
        (helix(0.3, 0.3, 1.0), -30.0, 0.6),
        (helix(0.3, 0.3, 1.0), 10.0, 0.6),
        (helix(0.3, 0.3, 1.0), 30.0, 0.5),
        (helix(0.3, 0.3, 1.0), -10.0, 0.5),
        (circle(0.3, 1.0), 5.0, 0.6),
        (arc, 10.0, 0.8),
    ];
    for (k, (motion, elevation_deg, range_m)) in cases.into_iter().enumerate() {
        let place_m = away(50.0 * k as f64, elevation_deg, range_m);
        let place_m = [place_m[0], place_m[1] + 0.3, place_m[2] + 0.15];
        let exact = see(&in_space(motion.clone(), place_m, k as u64));
        let (off_m, off_deg) = (exact.position_error_m.unwrap().xy().norm(), exact.azimuth_error_deg.abs());
        assert!(off_m < 0.1 && off_deg < 0.3 && exact.elevation_error_deg.unwrap().abs() < 0.5, "{k}: {exact:?}");
        // Odometry hides that one wave is all there is.
        let inexact = Ends { odometry_noise_m: 0.001, odometry_scale: 0.01, ..in_space(motion, place_m, k as u64) };
        let inexact = see(&inexact);
        let off_deg = inexact.azimuth_error_deg.abs();
        assert!(off_deg < 4.0 * inexact.azimuth_sd_deg && off_deg < 2.0, "{k}: {inexact:?}");
    }
}

#[test]
fn a_transmitter_that_the_robot_drives_around_is_found() {
    for (k, (radius_m, aside)) in [(1.0, 0.2), (1.0, 0.5), (0.5, 0.3), (0.3, 0.8)].into_iter().enumerate() {
        let place_m = [aside * radius_m, radius_m, 0.1];
        let seen = see(&Ends { duration_s: 6.0, ..in_space(circle(radius_m, 1.0), place_m, k as u64) });
        let off_m = seen.position_error_m.unwrap().xy().norm();
        assert!(seen.azimuth_error_deg.abs() < 0.3 && off_m < 0.02, "{k}: {seen:?}");
    }
    // From the middle of the circle no azimuth shows: the error bar says so.
    let seen = see(&in_space(circle(0.5, 1.0), [0.0, 0.5, 0.1], 3));
    assert!(seen.azimuth_sd_deg > 40.0 && seen.confidence < 0.1, "{seen:?}");
}

#[test]
fn the_elevation_limit_is_a_prior_not_a_hard_bound() {
    // Level motion, elevations far above those expected of robots on a floor: the samples leave no doubt.
    let seen = see(&in_space(circle(0.3, 1.0), away(70.0, 45.0, 15.0), 3));
    assert!(!seen.signed, "{seen:?}");
    assert!(seen.azimuth_error_deg.abs() < 0.3 && seen.elevation_error_deg.unwrap().abs() < 0.5, "{seen:?}");
}

#[test]
fn with_both_robots_moving_bearing_and_position_are_right() {
    let arc = RobotMotion::Arc(Arc { radius_m: 0.4, angle_deg: 240.0, duration_s: 6.0, start_s: 0.0 });
    let pairs = [(circle(0.3, 1.0), line(0.8)), (circle(0.3, 1.0), circle(0.25, -2.0)), (arc, line(0.5))];
    for (k, (receiver, transmitter)) in pairs.into_iter().enumerate() {
        for turn in 0..3 {
            let place_m = away(100.0 * f64::from(turn) + 13.0, 4.0, 2.6 + 0.3 * k as f64);
            let seen = see(&Ends { transmitter: transmitter.clone(), ..in_space(receiver.clone(), place_m, k as u64) });
            let error_m = seen.position_error_m.unwrap().xy().norm();
            assert!(seen.azimuth_error_deg.abs() < 0.2 && error_m < 0.15, "{k}: {seen:?}");
        }
    }
}

#[test]
fn evaluate_reads_the_trajectory_of_a_transmitter_that_moved() {
    let mut scene = in_space(circle(0.3, 1.0), [3.0, 2.0, 0.2], 9).scene();
    scene.robot[1].motion = line(1.0);
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("moving-transmitter");
    let _ = std::fs::remove_dir_all(&folder);
    write_dataset(&mut Room::new(&scene).unwrap(), &folder, &mut |_| {}).unwrap();
    let captures = find(&folder).0;
    let row = &captures[0].evaluate(TrajectorySource::GroundTruth, None, &options()).rows[0];
    // The line goes from y = 2 to y = 3, and so does the mean of the bearing's positions.
    let [x, y] = row.true_transmitter_m.unwrap();
    assert!((x - 3.0).abs() < 1e-3 && (y - 2.5).abs() < 0.01, "{x} {y}");
    assert!(row.error_from_mean_pose_deg.unwrap().abs() < 0.3, "{row:?}");
    assert!(row.position_error_m.unwrap() < 0.15, "{row:?}");
    let last_m = row.answer.position_m.unwrap();
    assert!((last_m[0] - 3.0).abs() < 0.15 && (last_m[1] - 3.0).abs() < 0.15, "{last_m:?}");
}

/// Drives too wide for one search: a large circle, and a long path with a turn, past a transmitter and far from one.
#[test]
fn a_drive_that_is_too_wide_for_one_search_is_searched_in_its_best_stretch() {
    let around = RobotMotion::Circle(Circle { radius_m: 3.0, duration_s: 50.0, turns: 1.0, start_s: 0.0 });
    let corner = drive(&[[4.0, 0.0, 0.0], [4.0, 4.0, 0.0]], 0.2);
    for (motion, place_m) in
        [(around.clone(), [8.0, 6.0, 0.3]), (around, [-200.0, 90.0, 2.0]), (corner, [9.0, -5.0, 0.5])]
    {
        let (bearing, seen) = judged(&Ends { duration_s: 50.0, ..in_space(motion, place_m, 5) }, &options());
        let pairs = &bearing.pairs;
        // The path with a turn can be searched whole.
        let whole = place_m[0] == 9.0;
        assert!((whole || pairs.too_wide > 500) && pairs.in_motion > 200, "{pairs:?}");
        assert_eq!(
            pairs.formed,
            pairs.in_motion + pairs.too_wide + pairs.standing + pairs.no_pose + pairs.cut + pairs.thinned
        );
        assert!(seen.azimuth_error_deg.abs() < 0.3, "{place_m:?}: {seen:?}");
        let position = seen.position_error_m.map(|error| error.xy().norm());
        assert!(place_m[0] < 0.0 || position.is_some_and(|off_m| off_m < 0.2), "{place_m:?}: {seen:?}");
    }
}

/// Over a wide drive wave fronts are curved, so a plane wave is never the answer, however coarse the requested accuracy.
#[test]
fn a_coarse_accuracy_takes_no_plane_wave_of_a_wide_drive() {
    let around = |radius_m: f64| RobotMotion::Circle(Circle { radius_m, duration_s: 50.0, turns: 1.0, start_s: 0.0 });
    let coarse = Accuracy { effort: Effort::Within(0.7), ..options().accuracy };
    for (radius_m, place_m) in [(2.0, [5.0, 4.0, 0.3]), (3.5, [9.0, 4.0, 0.3])] {
        let ends = Ends { duration_s: 50.0, ..in_space(around(radius_m), place_m, 6) };
        let (bearing, seen) = judged(&ends, &Options { accuracy: coarse, ..options() });
        assert!(bearing.answer.model == WaveModel::SphericalWave, "{radius_m}: {:?}", bearing.sufficient);
        // The search of the wider drive's nearly straight stretch may end beside its narrow peak: the error bar shows it.
        assert!(seen.azimuth_error_deg.abs() < seen.azimuth_sd_deg.max(0.5), "{radius_m}: {seen:?}");
    }
}

/// The only turn of a long path is in the searched stretch, wherever it is.
#[test]
fn the_only_turn_of_a_long_drive_is_found() {
    for before_m in [3.0, 5.3, 7.9, 10.4] {
        let corner = drive(&[[before_m, 0.0, 0.0], [before_m, 0.25, 0.0], [before_m + 14.0, 0.25, 0.0]], 0.3);
        let ends = Ends { duration_s: 90.0, ..in_space(corner, [before_m + 3.0, -7.0, 0.4], 8) };
        let (bearing, seen) = judged(&ends, &options());
        assert!(bearing.answer.mirror_rad.is_none(), "{before_m}: {seen:?}");
        assert!(seen.azimuth_error_deg.abs() < 0.5, "{before_m}: {seen:?}");
    }
}

/// A climbing line does not separate a transmitter's azimuth from its elevation: errors are within error bars.
#[test]
fn a_climbing_lines_error_bar_covers_unknown_elevations() {
    let (mut within, mut count, mut widest) = (0, 0, 0f64);
    for (k, rise_deg) in [20f64, 35.0, 50.0].into_iter().enumerate() {
        let (up, flat) = rise_deg.to_radians().sin_cos();
        let climb = drive(&[[flat, 0.0, up]], 0.2);
        for elevation_deg in [-16.0, -8.0, 0.0, 8.0, 16.0] {
            let azimuth_deg = 60.0 + 13.0 * k as f64 + elevation_deg;
            let ends = in_space(climb.clone(), away(azimuth_deg, elevation_deg, 9.0), 20 + k as u64);
            let (bearing, seen) = judged(&ends, &options());
            let answer = &bearing.answer;
            let mirror_off = answer.mirror_rad.map(|mirror| wrap_rad(mirror - answer.azimuth_rad).to_degrees());
            let direct = seen.azimuth_error_deg;
            let folded = mirror_off.map_or(direct, |off| wrap_rad((direct + off).to_radians()).to_degrees());
            let error_deg = direct.abs().min(folded.abs());
            println!("{rise_deg} {elevation_deg}: {error_deg:.2} of {:.2}, {:?}", seen.azimuth_sd_deg, seen.confidence);
            assert!(error_deg < 2.5 * seen.azimuth_sd_deg, "{rise_deg} {elevation_deg}: {error_deg} {seen:?}");
            within += usize::from(error_deg < seen.azimuth_sd_deg);
            count += 1;
            widest = widest.max(seen.azimuth_sd_deg);
        }
    }
    assert!(2 * within >= count && widest < 40.0, "{within} of {count}, {widest}");
}

/// Along the motion phases depend only on the square of a change in azimuth. Error bar and probability agree on that, a mirror
/// close by does not lower the probability, and the two stay separate directions in later steps.
#[test]
fn motion_towards_the_transmitter_has_a_confidence_that_matches_its_error_bar() {
    for (k, azimuth_deg) in [0.0, 0.3, 3.0, 11.0, -169.0, 180.0].into_iter().enumerate() {
        let (bearing, seen) = judged(&in_space(line(1.0), away(azimuth_deg, 0.0, 6.0), 40 + k as u64), &options());
        let answer = &bearing.answer;
        let folded_deg = answer.azimuth_rad.to_degrees().abs() - azimuth_deg.abs();
        assert!(folded_deg.abs() < 1.5 * seen.azimuth_sd_deg, "{azimuth_deg}: {folded_deg} {seen:?}");
        assert!((0.5..12.0).contains(&seen.azimuth_sd_deg), "{azimuth_deg}: {seen:?}");
        // The probability that a normal error with this bar is within five degrees; half of it if the mirror is elsewhere.
        let times = 5.0 / seen.azimuth_sd_deg;
        let by_bar = 2.0 / (1.0 + (-1.702 * times).exp()) - 1.0;
        let apart = answer.mirror_rad.map_or(0.0, |mirror| wrap_rad(answer.azimuth_rad - mirror).abs());
        let [least, most] = [if apart > 0.087 { 0.5 } else { 1.0 }, if apart > 0.175 { 0.5 } else { 1.0 }];
        let allowed = 0.65 * least * by_bar.min(0.98)..=most * by_bar + 0.02;
        assert!(allowed.contains(&seen.confidence), "{azimuth_deg}: {allowed:?} {seen:?}");
        let evidence = bearing.evidence();
        if most < 1.0 {
            assert!(evidence.modes.iter().all(|mode| mode.sd_rad < 0.3 * apart), "{azimuth_deg}: {evidence:?}");
        }
    }
}

/// A level line shows no elevation: none is claimed, and the bar holds what an unknown one leaves of the azimuth.
#[test]
fn a_level_lines_error_bar_covers_unknown_elevations() {
    let mut within = 0;
    for (k, elevation_deg) in [0.0, 4.0, 8.0, -12.0, 16.0, -19.0].into_iter().enumerate() {
        for (azimuth_deg, noise_m) in [(35.0, 0.0), (70.0, 0.001), (95.0, 0.003), (-140.0, 0.0)] {
            let place_m = away(azimuth_deg + 0.5, elevation_deg, 5.0);
            let ends = Ends {
                odometry_noise_m: noise_m,
                ..in_space(line(1.2), [place_m[0] + 0.6, place_m[1], place_m[2]], k as u64)
            };
            let (bearing, seen) = judged(&ends, &options());
            let answer = &bearing.answer;
            assert_eq!(answer.elevation_sd_rad, None, "{azimuth_deg} {elevation_deg}: {seen:?}");
            // Noise of odometry is no depth that would tell the sides.
            assert!((0.45..=0.5).contains(&answer.mirror_share.unwrap()), "{azimuth_deg} {elevation_deg}: {answer:?}");
            let off =
                |azimuth: f64| (seen.azimuth_error_deg + wrap_rad(azimuth - answer.azimuth_rad).to_degrees()).abs();
            let error_deg = off(answer.azimuth_rad).min(off(answer.mirror_rad.unwrap()));
            assert!(error_deg < 3.0 * seen.azimuth_sd_deg, "{azimuth_deg} {elevation_deg}: {error_deg} {seen:?}");
            within += usize::from(error_deg < seen.azimuth_sd_deg);
        }
    }
    assert!(within >= 16, "{within} of 24");
}

/// A wave front that bends as from beside the robot, or as one from afar: the prior says which to expect.
#[test]
fn a_distant_place_is_not_taken_for_a_near_one() {
    let bend = RobotMotion::Arc(Arc { radius_m: 1.1, angle_deg: 12.4, duration_s: 2.0, start_s: 0.0 });
    for seed in 0..12 {
        let ends = Ends { snr_db: 10.8, duration_s: 3.0, ..in_space(bend.clone(), [-6.6, -0.3, 1.4], seed) };
        let seen = see(&ends);
        assert!(seen.position_level.is_none_or(|level| level < 12.0), "{seed}: {seen:?}");
    }
}

/// Odometry hides that one wave is all there is; it comes from higher than expected.
#[test]
fn a_high_place_is_found_with_inexact_odometry() {
    let spiral = helix(0.55, 0.06, 1.5);
    for (seed, elevation_deg) in [-60.0, -37.0, 30.0, 50.0].into_iter().enumerate() {
        let ends = in_space(spiral.clone(), away(40.0 + 80.0 * seed as f64, elevation_deg, 15.0), seed as u64);
        let seen = see(&Ends { odometry_noise_m: 0.003, odometry_scale: 0.002, ..ends });
        let elevation_off = seen.elevation_error_deg.unwrap().abs();
        assert!(seen.azimuth_error_deg.abs() < 2.0 && elevation_off < 3.0, "{elevation_deg}: {seen:?}");
    }
}

/// Between a near place and a distant, high one lies a long valley of places that explain nearly as much.
#[test]
fn a_near_place_beside_an_arc_is_found() {
    for (seed, angle_deg) in [45.0, 60.0, 87.0, 110.0].into_iter().enumerate() {
        let arc = RobotMotion::Arc(Arc { radius_m: 0.77, angle_deg, duration_s: 6.0, start_s: 0.0 });
        let seen = see(&in_space(arc, [-0.49, 1.0, 0.03], seed as u64));
        assert!(seen.azimuth_error_deg.abs() < 3.0 * seen.azimuth_sd_deg, "{angle_deg}: {seen:?}");
        assert!(seen.azimuth_error_deg.abs() < 3.0, "{angle_deg}: {seen:?}");
    }
}

/// A straight drive hides the side: the range is known, the place is not.
#[test]
fn a_mirror_leaves_a_range_and_no_place() {
    let (straight, corner) = (drive(&[[1.2, 0.0, 0.0]], 0.2), drive(&[[0.6, 0.0, 0.0], [0.6, 0.6, 0.0]], 0.2));
    for (motion, has_place) in [(straight, false), (corner, true)] {
        let (bearing, seen) = judged(&in_space(motion, [1.5, 2.5, 0.0], 4), &options());
        let answer = &bearing.answer;
        assert!(answer.range.is_some_and(|range| (range.range_m - 2.66).abs() < 4.0 * range.sd_m), "{answer:?}");
        assert_eq!((answer.has_place(), seen.position_error_m.is_some()), (has_place, has_place), "{answer:?}");
        assert_eq!(answer.mirror_rad.is_some(), !has_place, "{answer:?}");
    }
}

/// A level line shows no elevation to the posterior over windows either: the error bar contains what that leaves of the azimuth.
#[test]
fn windows_along_a_line_claim_no_elevation() {
    let line = Ends {
        receiver: RobotMotion::Line(Line { length_m: 1.8, duration_s: 12.0, start_s: 0.0 }),
        transmitter_m: [-3.9, 1.9, 0.0],
        duration_s: 13.0,
        snr_db: 20.0,
        odometry_noise_m: 0.0003,
        ..Ends::default()
    };
    let mut options = options();
    options.accuracy.effort = Effort::Everything;
    for seed in 0..4 {
        let (bearing, seen) = judged(&Ends { seed, ..line.clone() }, &options);
        assert!(bearing.answer.elevation_sd_rad.is_none(), "{seed}: {:?}", bearing.answer);
        assert!(seen.folded_error_deg < seen.azimuth_sd_deg && seen.azimuth_sd_deg > 3.0, "{seed}: {seen:?}");
    }
}
