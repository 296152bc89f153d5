//! Leaving steps out never moves an answer by more than a tenth of its error bar: on simulated scenes of every kind, and
//! on real captures.

use csi5300::pipeline::{Accuracy, Effort, Options, Sufficient};
use csi5300_lab::ends::Ends;
use csi5300_lab::evaluate::{Capture, TrajectorySource, find};
use csi5300_lab::skipping::{SkipScene, scenes};
use csi5300_sim::motion::{Arc, Circle, RobotMotion};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

fn options() -> Options {
    Options::new("108".parse().unwrap())
}

#[test]
fn what_is_left_out_moves_no_answer_by_a_tenth_of_its_error_bar() {
    let all = scenes();
    assert!((180..=260).contains(&all.len()), "{}", all.len());
    // Every fourth: all kinds, at several ranges and signal-to-noise ratios.
    let chosen: Vec<_> = all.iter().step_by(4).collect();
    let kinds = |scenes: &[&SkipScene]| scenes.iter().map(|scene| scene.kind).collect::<BTreeSet<_>>();
    assert!(chosen.len() >= 50 && kinds(&chosen) == kinds(&all.iter().collect::<Vec<_>>()));
    let compared: Vec<_> = chosen.par_iter().map(|scene| (*scene, scene.compare(&options()).unwrap())).collect();
    let mut left_out: BTreeMap<&str, [usize; 2]> = BTreeMap::new();
    for (scene, compared) in &compared {
        let count = left_out.entry(scene.kind).or_default();
        count[0] += 1;
        count[1] += usize::from(compared.skipped());
        let (everything, needed) = (&compared.everything.bearing.answer, &compared.needed.bearing);
        assert!(
            compared.moved() <= 0.1,
            "{:?}: {:.3} error bars: {:.3} +- {:.3} degrees with every step, {:.3} +- {:.3} after {:?}",
            scene,
            compared.moved(),
            everything.azimuth_rad.to_degrees(),
            everything.azimuth_sd_rad.to_degrees(),
            needed.answer.azimuth_rad.to_degrees(),
            needed.answer.azimuth_sd_rad.to_degrees(),
            needed.sufficient,
        );
    }
    println!("{left_out:?}");
    let [circles, rooms] = ["circle", "many paths"].map(|kind| left_out[kind]);
    assert!(circles[1] * 3 >= circles[0], "steps are left out of {circles:?} clean circles");
    assert!(rooms[1] == 0, "steps are left out of {rooms:?} rooms with reflections");
}

/// Azimuth, elevation and range of a short arc near the transmitter follow each other along a flat ridge.
#[test]
fn near_a_short_arc_every_step_is_as_right_as_one_wave() {
    let receiver = RobotMotion::Arc(Arc { radius_m: 0.4, angle_deg: 60.0, duration_s: 6.0, start_s: 0.0 });
    let scenes: Vec<SkipScene> = (0..24)
        .map(|k| {
            let (sin, cos) = (f64::from(k) * 2.4).sin_cos();
            let transmitter_m = [2.2 * cos, 2.2 * sin, 0.05 * f64::from(k % 5)];
            let (receiver, seed) = (receiver.clone(), 100 + k as u64);
            let ends = Ends { receiver, transmitter_m, duration_s: 6.0, snr_db: 20.0, seed, ..Ends::default() };
            SkipScene { kind: "arc", ends }
        })
        .collect();
    let moved: Vec<(bool, f64)> = scenes
        .par_iter()
        .map(|scene| scene.compare(&options()).unwrap())
        .map(|compared| (compared.skipped(), compared.moved()))
        .collect();
    assert!(moved.iter().filter(|(skipped, _)| *skipped).count() >= 8, "{moved:?}");
    assert!(moved.iter().all(|(_, moved)| *moved <= 0.1), "{moved:?}");
}

#[test]
fn far_away_a_small_circle_needs_nothing_beyond_a_plane_wave() {
    let receiver = RobotMotion::Circle(Circle { radius_m: 0.03, duration_s: 6.0, turns: 1.0, start_s: 0.0 });
    // The noise leaves elevations open beyond those that are expected.
    let bearings = (1..=8).map(|seed| {
        let (receiver, transmitter_m) = (receiver.clone(), [390.0, 0.0, 0.0]);
        let ends = Ends { receiver, transmitter_m, duration_s: 6.0, snr_db: 25.0, seed, ..Ends::default() };
        ends.record().unwrap().bearing(&options()).unwrap()
    });
    let bearings: Vec<_> = bearings.map(|bearing| (bearing.sufficient, bearing.placed.is_none())).collect();
    let is_plane = |(sufficient, flat): &(Sufficient, bool)| matches!(sufficient, Sufficient::PlaneWave(_)) && *flat;
    assert!(bearings.iter().all(is_plane), "{bearings:?}");
}

#[test]
fn real_captures_keep_their_answers() {
    let Some(captures) = crate::common::captures() else { return };
    let mut captures = find(&captures.join("wsr")).0;
    captures.retain(|capture| crate::common::is_known(&capture.stamp));
    let run = |capture: &Capture, effort: Effort| {
        let options = options().with_accuracy(Accuracy::default().with_effort(effort).with_paths(false));
        capture.evaluate(TrajectorySource::GroundTruth, None, &options).rows
    };
    let pairs: Vec<_> = captures
        .par_iter()
        .flat_map_iter(|capture| run(capture, Effort::Everything).into_iter().zip(run(capture, Effort::Needed)))
        .collect();
    assert_eq!(pairs.len(), 38);
    for (everything, needed) in pairs {
        let (a, b) = (everything.answer, needed.answer);
        let apart = (a.azimuth_deg.unwrap() - b.azimuth_deg.unwrap()).abs();
        let bar = a.azimuth_sd_deg.unwrap().min(b.azimuth_sd_deg.unwrap());
        assert!(apart <= 0.1 * bar, "{}: {apart} degrees, error bar {bar}", a.link);
    }
}
