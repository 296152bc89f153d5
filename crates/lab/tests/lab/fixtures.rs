//! The simulator reproduces the committed fixtures byte by byte, and they give their scene's bearing.

use csi5300::pipeline::Options;
use csi5300::signal::channel::{Channel, Width};
use csi5300_lab::evaluate::{TrajectorySource, find};
use csi5300_sim::{Room, Scene, write_dataset};
use std::path::{Path, PathBuf};

fn fixtures() -> PathBuf {
    crate::common::root().join("tests/fixtures")
}

#[test]
fn the_simulator_reproduces_the_fixtures() {
    let made = Path::new(env!("CARGO_TARGET_TMPDIR")).join("small-circle");
    let _ = std::fs::remove_dir_all(&made);
    let scene = Scene::load(&fixtures().join("small-circle.toml")).unwrap();
    write_dataset(&mut Room::new(&scene).unwrap(), &made, &mut |_| {}).unwrap();
    let mut compared = 0;
    for entry in std::fs::read_dir(fixtures().join("small-circle")).unwrap() {
        let path = entry.unwrap().path();
        let again = std::fs::read(made.join(path.file_name().unwrap())).unwrap();
        assert!(std::fs::read(&path).unwrap() == again, "{} differs", path.display());
        compared += 1;
    }
    assert_eq!(compared, 5);
}

#[test]
fn the_small_circle_gives_its_scenes_bearing() {
    let (captures, unreadable) = find(&fixtures());
    assert!(captures.len() == 1 && unreadable.is_empty(), "{captures:?}");
    let options = Options::new(Channel::new(108, Width::Ht20).unwrap());
    let evaluated = captures[0].evaluate(TrajectorySource::GroundTruth, None, &options);
    let row = &evaluated.rows[0];
    assert!(!evaluated.lost, "a cut tail is no loss");
    assert!(row.error_from_mean_pose_deg.unwrap().abs() < 0.1, "{row:?}");
    assert!(row.answer.compensated && row.answer.coherence.unwrap() > 0.97, "{row:?}");
    // The two crystals are 2 ppm apart.
    assert!((row.answer.cfo_hz.unwrap().abs() - 2e-6 * 5.54e9).abs() < 500.0, "{row:?}");
    assert_eq!(row.answer.receiver_records.handed, 281);
}
