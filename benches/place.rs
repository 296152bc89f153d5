//! One link from its two logs to the answer, on every tier: by one wave, which is all that this clean scene needs, and by the posterior
//! over windows and channels. Ratios are against one wave on the portable tier in the same run.
//!
//! `cargo bench --bench place`
#![allow(clippy::expect_used)]

mod common;

use common::{Table, banner, quickest};
use csi5300::bartlett::Tier;
use csi5300::motion::odometry::csv;
use csi5300::pipeline::{Accuracy, Effort, Options, Transmitter, bearings};
use csi5300::source::replay::Replay;
use std::io::Cursor;
use std::path::Path;

fn main() {
    banner("One link, all steps");
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/small-circle");
    let read = |name: &str| std::fs::read(folder.join(name)).expect("a fixture");
    let (rx, tx) = (read("csi_rx_2023-11-14_221320.dat"), read("csi_tx1_2023-11-14_221320.dat"));
    let (path, _) = csv::read(&folder.join("rx_trajectory_2023-11-14_221320_.csv")).expect("a fixture");
    let channel = "108".parse().expect("a channel");
    let time_us = |tier: Tier, effort: Effort| {
        let options = Options { tier, ..Options::new(channel) };
        let options = Options { accuracy: Accuracy { effort, ..options.accuracy }, ..options.clone() };
        1e3 * quickest(300.0, || {
            let mut rx = Replay::new(Cursor::new(rx.clone()), String::new());
            let mut tx = Replay::new(Cursor::new(tx.clone()), String::new());
            let transmitters = vec![Transmitter { log: &mut tx, trajectory: None }];
            drop(bearings(&mut rx, transmitters, &path, &options).expect("a bearing"));
        })
    };
    let base_us = time_us(Tier::Portable, Effort::Needed);
    let mut table =
        Table::new("place", &[("tier", 10), ("one wave, us", 14), ("ratio", 8), ("posterior, us", 14), ("ratio", 8)]);
    for tier in Tier::available() {
        let (one_us, all_us) = (time_us(tier, Effort::Needed), time_us(tier, Effort::Everything));
        let ratio = |us: f64| format!("{:.2}", base_us / us);
        table.row(&[format!("{tier:?}"), format!("{one_us:.0}"), ratio(one_us), format!("{all_us:.0}"), ratio(all_us)]);
    }
    table.save();
}
