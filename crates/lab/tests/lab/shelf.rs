//! A capture whose files were read once gives the same evaluation as from its files, any number of times.

use csi5300::pipeline::Options;
use csi5300::signal::channel::{Channel, Width};
use csi5300_lab::evaluate::{Capture, Evaluated, Shelf, TrajectorySource, find};
use std::path::{Path, PathBuf};

const STAMP: &str = "2023-11-14_221320";

/// The small circle, with damage in the transmitter's log and a bad row in the trajectory, in a folder of its own.
fn damaged(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    for entry in std::fs::read_dir(crate::common::root().join("tests/fixtures/small-circle")).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, folder.join(path.file_name().unwrap())).unwrap();
    }
    let log = folder.join(format!("csi_tx1_{STAMP}.dat"));
    let mut bytes = std::fs::read(&log).unwrap();
    bytes[10_000..10_300].fill(0xff);
    std::fs::write(&log, bytes).unwrap();
    let path = folder.join(format!("rx_trajectory_{STAMP}_.csv"));
    let rows = std::fs::read_to_string(&path).unwrap().replacen('\n', "\nno,numbers,in,this,row,\n", 1);
    std::fs::write(&path, rows).unwrap();
    folder
}

fn options(to_s: f64) -> Options {
    Options::new(Channel::new(108, Width::Ht20).unwrap()).with_cut(None, Some(to_s))
}

fn words(evaluated: &Evaluated) -> (String, Vec<String>, bool) {
    (serde_json::to_string(&evaluated.rows).unwrap(), evaluated.notes.clone(), evaluated.lost)
}

fn only(folder: &Path) -> Capture {
    let (captures, _) = find(folder);
    captures.into_iter().next().unwrap()
}

#[test]
fn files_are_read_once() {
    let folder = damaged("shelf");
    let capture = only(&folder);
    let evaluate = |to_s| words(&capture.evaluate(TrajectorySource::GroundTruth, None, &options(to_s)));
    let from_files = [evaluate(1.5), evaluate(2.0)];
    assert_ne!(from_files[0].0, from_files[1].0);
    assert!(from_files[0].2 && from_files[0].1.len() == 2, "{from_files:?}");
    let shelf = capture.shelf(&|| true).unwrap();
    // Nothing but the truth is read again.
    std::fs::remove_file(folder.join(format!("csi_rx_{STAMP}.dat"))).unwrap();
    std::fs::write(folder.join(format!("csi_tx1_{STAMP}.dat")), b"").unwrap();
    std::fs::write(folder.join(format!("rx_trajectory_{STAMP}_.csv")), b"").unwrap();
    let again = |to_s| words(&capture.evaluate_from(&shelf, TrajectorySource::GroundTruth, None, &options(to_s)));
    assert_eq!([again(1.5), again(2.0)], from_files);
    assert_eq!(again(1.5), from_files[0], "a third time");
}

#[test]
fn missing_files_are_reported_with_the_reason() {
    let folder = damaged("shelf-without");
    std::fs::remove_file(folder.join(format!("csi_rx_{STAMP}.dat"))).unwrap();
    let capture = only(&folder);
    let shelf = capture.shelf(&|| true).unwrap();
    let (from, own) = (
        words(&capture.evaluate_from(&shelf, TrajectorySource::GroundTruth, None, &options(2.0))),
        words(&capture.evaluate_from(&Shelf::default(), TrajectorySource::GroundTruth, None, &options(2.0))),
    );
    assert!(from.0.contains("csi_rx_") && from.2, "{from:?}");
    assert_eq!(from, own);
    assert!(capture.shelf(&|| false).is_none(), "who wants no files waits for none");
}
