//! Logs of different runs, on real captures: they are refused, and no matching pair is. Lines have their mirror.

use csi5300::motion::odometry::csv;
use csi5300::pipeline::{Bearing, CaptureReport, LinkError, Options, Transmitter, bearings};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::replay::Replay;
use csi5300_sim::{Room, Scene, Simulation};
use std::path::{Path, PathBuf};

const RUNS: [(&str, &str); 6] = [
    ("line", "real_10cm_2"),
    ("line", "real_20cm_1"),
    ("line", "real_30cm_3"),
    ("circle", "real_10cm_1"),
    ("circle", "real_20cm_2"),
    ("circle", "real_30cm_2"),
];

fn run(rx: &Path, tx: &Path, path: &Path) -> Result<Bearing, LinkError> {
    let options = Options::new(Channel::new(108, Width::Ht20).unwrap());
    let (mut rx, mut tx) = (Replay::open(rx).unwrap(), Replay::open(tx).unwrap());
    let (path, _) = csv::read(path).unwrap();
    let logs = vec![Transmitter { log: &mut tx, trajectory: None }];
    let mut report: CaptureReport = bearings(&mut rx, logs, &path, &options).unwrap();
    report.links.remove(0).bearing
}

#[test]
fn logs_of_two_runs_of_two_robots_are_refused() {
    let Some(captures) = crate::common::captures() else { return };
    let file = |(kind, name): (&str, &str), what: &str, ending: &str| {
        captures.join("paper").join(kind).join(format!("{what}_{name}.{ending}"))
    };
    for own in RUNS {
        for other in RUNS {
            let (rx, tx) = (file(own, "csi_rx", "dat"), file(other, "csi_tx", "dat"));
            let bearing = run(&rx, &tx, &file(own, "rx_movement", "csv"));
            if own != other {
                assert!(matches!(bearing, Err(LinkError::OfTwoRuns { .. })), "{own:?} {other:?}: {bearing:?}");
                continue;
            }
            let plane_wave = bearing.unwrap().plane_wave;
            assert_eq!(plane_wave.mirror_rad.is_some(), own.0 == "line", "{own:?}: {plane_wave:?}");
        }
    }
}

#[test]
fn logs_of_two_runs_of_four_robots_are_refused() {
    let Some(captures) = crate::common::captures() else { return };
    let mut runs: Vec<(PathBuf, Vec<PathBuf>, PathBuf)> = Vec::new();
    for (set, places) in [("LOS_Set_A", 6), ("NLOS_Set_A", 6), ("NLOS_Set_C", 2)] {
        for place in 1..=places {
            let folder = captures.join("wsr").join(set).join(format!("L{place}"));
            let mut files: Vec<PathBuf> = folder.read_dir().unwrap().map(|entry| entry.unwrap().path()).collect();
            files.sort();
            let starts = |path: &&PathBuf, with: &str| path.file_name().unwrap().to_string_lossy().starts_with(with);
            let of = |with: &str| files.iter().filter(|path| starts(path, with)).cloned().collect::<Vec<_>>();
            runs.push((of("csi_rx").remove(0), of("csi_tx"), of("rx_trajectory").remove(0)));
        }
    }
    let mut refused = 0;
    // The next capture, and one of another place.
    for apart in [1, 5] {
        for (own, other) in runs.iter().zip(runs.iter().cycle().skip(apart)) {
            for tx in &other.1 {
                let bearing = run(&own.0, tx, &own.2);
                assert!(bearing.is_err(), "{} {}", own.0.display(), tx.display());
                refused += 1;
            }
        }
    }
    assert_eq!(refused, 76);
}

#[test]
fn exchanged_logs_are_detected_by_the_other_robots_clock() {
    let Some(captures) = crate::common::captures() else { return };
    // In these the robots' host clocks differ by more than the run's length.
    for (place, date) in [("LOS_Set_A/L1", "2021-06-27_202550"), ("NLOS_Set_A/L2", "2021-06-28_194645")] {
        let file = |name: &str| captures.join("wsr").join(place).join(name.replace("DATE", date));
        let (rx, path) = (file("csi_rx_DATE.dat"), file("rx_trajectory_DATE_.csv"));
        let tx = file("csi_tx3_DATE.dat");
        run(&rx, &tx, &path).unwrap();
        let exchanged = run(&tx, &rx, &path).unwrap_err();
        assert!(matches!(exchanged, LinkError::OutsideTrajectory { other_fits: true, .. }), "{place}: {exchanged}");
        assert!(exchanged.to_string().contains("exchanged"), "{exchanged}");
    }
    // Where they differ by seconds, some pairs have no pose, but have one by the other log's times.
    for (kind, name) in RUNS {
        let file = |what: &str, ending: &str| captures.join("paper").join(kind).join(format!("{what}_{name}.{ending}"));
        let (rx, tx, path) = (file("csi_rx", "dat"), file("csi_tx", "dat"), file("rx_movement", "csv"));
        let found = [run(&rx, &tx, &path), run(&tx, &rx, &path)].map(Result::unwrap);
        // The answer is as likely from the wrong robot's times.
        assert!(
            found[1].answer.probability < 0.5 && !found[1].answer.has_place(),
            "{name}: {}",
            found[1].answer.probability
        );
        let [right, exchanged] = found.map(|bearing| bearing.pairs);
        assert!(!right.may_be_exchanged() && exchanged.may_be_exchanged(), "{name}");
        assert_eq!(right.no_pose_by_transmitter, Some(exchanged.no_pose), "{name}");
        assert_eq!(Some(right.no_pose), exchanged.no_pose_by_transmitter, "{name}");
        assert!(exchanged.no_pose - right.no_pose > right.formed / 20, "{name}: {right:?} {exchanged:?}");
    }
}

/// Only the direct path, so that the shape of the channel does not show whose logs these are, and answers that jitter by more
/// than the pauses between frames.
fn of_direct_path(place_m: [f64; 2], offset_ppm: f64, turn_around: &str, turns: u32) -> (Simulation, Options) {
    let scene = format!(
        "duration_s = 12.0\ncfo = \"physical\"\nsounding.rate_hz = 50\n\
         [radio]\nmcs = 1\nnoise.snr_db = 20.0\nsend_jitter_us = 200.0\nturn_around = {{ {turn_around} }}\n\
         [[robot]]\nname = \"rx\"\ncrystal.offset_ppm = 0.0015\n\
         motion.circle = {{ radius_m = 0.3, duration_s = 12.0, turns = {turns} }}\n\
         [[robot]]\nname = \"tx\"\nposition_m = [{}, {}, 0.0]\ncrystal.offset_ppm = {offset_ppm}\n",
        place_m[0], place_m[1]
    );
    let run = Room::new(&Scene::parse(&scene).unwrap()).unwrap().run().unwrap();
    let options = Options::new(Channel::new(108, Width::Ht20).unwrap());
    (run, options)
}

#[test]
fn phases_that_follow_the_motion_show_one_run_despite_the_clocks() {
    let bearing = |own: &Simulation, other: &Simulation, options: &Options| {
        let (mut rx, mut tx) = (own.robots[0].replay(), other.robots[1].replay());
        let logs = vec![Transmitter { log: &mut tx, trajectory: None }];
        let path = own.robots[0].true_path.as_ref().unwrap();
        bearings(&mut rx, logs, path, options).unwrap().links.remove(0).bearing
    };
    // A busy host answers late by milliseconds, or by so much that the clocks show nothing; the crystals agree, so the phases are
    // steady before compensation and random after.
    let milliseconds = "median_us = 3000.0, spread_us = 1500.0, min_us = 300.0, max_us = 8000.0";
    let less = "median_us = 3000.0, spread_us = 650.0, min_us = 300.0, max_us = 8000.0";
    for turn_around in [milliseconds, less] {
        let (own, options) = of_direct_path([-386.0, 93.0], -0.001, turn_around, 3);
        let (other, _) = of_direct_path([90.0, 280.0], 0.004, turn_around, 5);
        let right = bearing(&own, &own, &options).unwrap();
        let off_deg = right.answer.azimuth_rad.to_degrees() - 93f64.atan2(-386.0).to_degrees();
        assert!(off_deg.abs() < 0.5, "{turn_around}: {off_deg}");
        let wrong = bearing(&own, &other, &options);
        // Crystals that agree leave steady phases in any two logs: if that is all there is, the answer has no direction.
        match &wrong {
            Err(LinkError::OfTwoRuns { .. } | LinkError::NotOfOneRun { .. }) => (),
            Ok(bearing) => assert!(bearing.answer.azimuth_sd_rad > 1.0, "{turn_around}: {bearing:?}"),
            Err(error) => panic!("{turn_around}: {error}"),
        }
    }
}
