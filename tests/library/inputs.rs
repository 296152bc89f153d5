//! What is refused, with why: logs and trajectories that do not belong together.

use crate::common::link::{Link, START_S, TRANSMITTER, link};
use csi5300::exchange::assign::Unmatched;
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::pipeline::{Bearing, JoinBy, LinkError, Options, Transmitter, bearings};
use csi5300::source::replay::Replay;
use nalgebra::Vector3;
use std::io::Cursor;

fn options() -> Options {
    Options::new("108".parse().unwrap())
}

fn run(rx: &[Vec<u8>], tx: &[Vec<u8>], path: &Trajectory, options: &Options) -> Result<Bearing, LinkError> {
    let log = |records: &[Vec<u8>]| Replay::new(Cursor::new(records.concat()), String::new());
    let (mut rx, mut tx) = (log(rx), log(tx));
    let transmitters = vec![Transmitter { log: &mut tx, trajectory: None }];
    bearings(&mut rx, transmitters, path, options).unwrap().links.remove(0).bearing
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
fn one_log_for_both_sides_is_refused() {
    let (made, path) = (made(), a_row_a_frame(400, 0.0));
    for log in [&made.rx, &made.tx] {
        let refused = run(log, log, &path, &options()).unwrap_err();
        assert!(matches!(refused, LinkError::Unmatched(Unmatched::SameSender { .. })), "{refused:?}");
    }
    // Named, so that nothing is matched: the frames themselves are the same.
    let named = options().with_macs(Some(TRANSMITTER), vec![TRANSMITTER]);
    assert!(run(&made.rx, &made.rx, &path, &named).is_err());
    assert!(run(&made.rx, &made.tx, &path, &options()).is_ok());
}

#[test]
fn a_row_for_each_frame_at_other_times_is_refused_and_joined_row_by_row() {
    let made = made();
    let late = a_row_a_frame(400, 0.5);
    let refused = run(&made.rx, &made.tx, &late, &options()).unwrap_err();
    assert_eq!(refused, LinkError::RowsNotTimes { rows: 400, outside: 50, pairs: 400 });
    assert!(run(&made.rx, &made.tx, &late, &options().with_join(JoinBy::Row)).is_ok());
    assert!(run(&made.rx, &made.tx, &late, &options().with_clock_offset_s(0.5)).is_ok());
    // Fewer rows than frames: a trajectory that begins late is no row for each frame.
    let short = Trajectory::new(late.poses()[..300].to_vec()).unwrap();
    assert!(run(&made.rx, &made.tx, &short, &options()).is_ok());
}
