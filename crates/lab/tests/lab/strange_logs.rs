//! Logs of different runs, on real captures: refused, and no right pair with them; lines with their mirror.

use csi5300::motion::odometry::csv;
use csi5300::pipeline::{Bearing, CaptureReport, LinkError, Options, Transmitter, bearings};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::replay::Replay;
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
    let steps = options.accuracy.without_layers();
    let (mut rx, mut tx) = (Replay::open(rx).unwrap(), Replay::open(tx).unwrap());
    let (path, _) = csv::read(path).unwrap();
    let logs = vec![Transmitter { log: &mut tx, trajectory: None }];
    let mut report: CaptureReport = bearings(&mut rx, logs, &path, &options.with_accuracy(steps)).unwrap();
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
fn exchanged_logs_are_told_where_the_other_robots_clock_fits() {
    let Some(captures) = crate::common::captures() else { return };
    // Of these the robots' host clocks are further apart than the run is long.
    for (place, date) in [("LOS_Set_A/L1", "2021-06-27_202550"), ("NLOS_Set_A/L2", "2021-06-28_194645")] {
        let file = |name: &str| captures.join("wsr").join(place).join(name.replace("DATE", date));
        let (rx, path) = (file("csi_rx_DATE.dat"), file("rx_trajectory_DATE_.csv"));
        let tx = file("csi_tx3_DATE.dat");
        run(&rx, &tx, &path).unwrap();
        let exchanged = run(&tx, &rx, &path).unwrap_err();
        assert!(matches!(exchanged, LinkError::OutsideTrajectory { other_fits: true, .. }), "{place}: {exchanged}");
        assert!(exchanged.to_string().contains("exchanged"), "{exchanged}");
    }
}
