//! Cost as the work grows: packets, aperture, directions, links.
//!
//! `cargo bench --bench growth`
#![allow(clippy::expect_used)]

mod common;
#[path = "common/picture.rs"]
mod picture;

use common::*;
use csi5300::bartlett::{Grid, SearchOptions, Tier};
use csi5300::internal::{Planner, ProfileOptions, Searcher};
use picture::*;

fn main() {
    banner("Cost as the work grows");
    let mut table = Table::new("growth", &[("what", 12), ("size", 10), ("ms", 10), ("method", 14), ("plan_ms", 10)]);
    let mut series = Vec::new();
    let plain = Grid::azimuth_elevation(360, 181);
    let mut sweep = |what: &str, label: &str, points: Vec<(f64, csi5300::signal::samples::Samples, Grid)>| {
        let mut line = Vec::new();
        for (size, samples, grid) in points {
            let mut planner = Planner::default();
            let options = ProfileOptions::default();
            let plan_ms = time(|| planner.explain(&samples, &grid, &options).expect("a plan"));
            let plan = planner.explain(&samples, &grid, &options).expect("a plan");
            let mut out = Vec::new();
            let ms = quickest(100.0, || {
                planner.profile_into(&samples, &grid, &options, &mut out).expect("a profile");
            });
            table.row(&[
                what.into(),
                size.to_string(),
                format!("{ms:.4}"),
                format!("{:?}", plan.method),
                format!("{plan_ms:.2}"),
            ]);
            line.push((size, ms));
        }
        series.push(Series { label: label.into(), points: line });
    };
    let packets = [10, 100, 300, 1_000, 3_000, 10_000, 30_000, 100_000, 1_000_000];
    sweep("packets", "packets", packets.map(|n| (n as f64, job(n, 0.3, 0.0, 1), plain.clone())).into());
    let radii = [0.03, 0.1, 0.3, 1.0, 2.0, 5.0];
    sweep("aperture_mm", "radius, mm", radii.map(|r| (r * 1e3, job(1_000, r, 0.0, 1), plain.clone())).into());
    let grids = [36, 72, 180, 360, 720, 1_440];
    let directions =
        |n: usize| ((n * (n / 2 + 1)) as f64, job(1_000, 0.3, 0.0, 1), Grid::azimuth_elevation(n, n / 2 + 1));
    sweep("directions", "directions", grids.map(directions).into());
    let tall = [300, 1_000, 3_000, 30_000];
    sweep("helix", "packets, helix", tall.map(|n| (n as f64, job(n, 0.3, 0.3, 1), plain.clone())).into());

    links(&mut table, &mut series);
    table.save();
    picture("growth", "Cost as the work grows", "size", "milliseconds, one thread", &series);
}

/// A team of n robots: every robot takes the bearing to each of the others, 900 packets each, elevation included.
fn links(table: &mut Table, series: &mut Vec<Series>) {
    let limit = SearchOptions::default().elevation_max_rad;
    let mut line = Vec::new();
    for robots in [2, 4, 8, 16, 32, 64] {
        let all: Vec<_> = (0..robots - 1).map(|i| job(900, 0.4, 0.0, i)).collect();
        let mut searcher = Searcher::new(Tier::detect());
        let ms = quickest(100.0, || {
            for samples in &all {
                searcher.search(samples, limit).expect("a bearing");
            }
        });
        table.row(&["robots".into(), robots.to_string(), format!("{ms:.4}"), "bearings".into(), String::new()]);
        line.push((f64::from(robots as u32), ms));
    }
    series.push(Series { label: "robots: bearings of one to all others".into(), points: line });
}
