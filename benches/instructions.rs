//! The jobs whose instructions `tests/checks/instructions.sh` counts: `instructions JOB TIMES`.
//!
//! * `direct`: direct sums of 1,000 packets in 360 x 10 directions
//! * `profile`: the profile of the same packets in 360 x 181 directions, as the planner makes it
//! * `link`: a simulated link from its two logs to the posterior over windows and channels
#![allow(clippy::expect_used)]

mod common;

use common::job;
use csi5300::bartlett::Grid;
use csi5300::internal::{Method, Planner, ProfileOptions};
use csi5300::motion::odometry::csv;
use csi5300::pipeline::{Accuracy, Effort, Options, Transmitter, bearings};
use csi5300::source::replay::Replay;
use std::io::Cursor;
use std::path::Path;

fn main() {
    let args: Vec<String> = std::env::args().skip(1).filter(|arg| arg != "--bench").collect();
    let [name, times] = &args[..] else { return println!("usage: instructions direct|profile|link TIMES") };
    let times: usize = times.parse().expect("a number");
    match name.as_str() {
        "direct" => profile(10, Some(Method::Direct), times),
        "profile" => profile(181, None, times),
        "link" => link(times),
        other => panic!("there is no job {other}"),
    }
}

fn profile(elevations: usize, method: Option<Method>, times: usize) {
    let (samples, grid) = (job(1000, 0.3, 0.0, 1), Grid::azimuth_elevation(360, elevations));
    let (mut planner, mut values) = (Planner::default(), Vec::new());
    let options = ProfileOptions { method, ..ProfileOptions::default() };
    for _ in 0..times {
        planner.profile_into(&samples, &grid, &options, &mut values).expect("a profile");
    }
}

fn link(times: usize) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/small-circle");
    let read = |name: &str| std::fs::read(folder.join(name)).expect("a fixture");
    let (rx, tx) = (read("csi_rx_2023-11-14_221320.dat"), read("csi_tx1_2023-11-14_221320.dat"));
    let (path, _) = csv::read(&folder.join("rx_trajectory_2023-11-14_221320_.csv"), None).expect("a fixture");
    let options = Options::new("108".parse().expect("a channel"));
    let accuracy = Accuracy { effort: Effort::Everything, ..options.accuracy };
    let options = Options { accuracy, ..options.clone() };
    for _ in 0..times {
        let mut rx = Replay::new(Cursor::new(rx.clone()), String::new());
        let mut tx = Replay::new(Cursor::new(tx.clone()), String::new());
        let transmitters = vec![Transmitter { log: &mut tx, trajectory: None }];
        bearings(&mut rx, transmitters, &path, &options).expect("a bearing");
    }
}
