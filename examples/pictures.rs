//! One of each picture from made-up numbers. Prints how long the largest took; the pictures are in the folder `pictures`.
//!
//! `cargo run -p csi5300-lab --example pictures -- [DIR]`

use csi5300_lab::Failure;
use csi5300_lab::curves::Curve;
use csi5300_lab::show::*;
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

/// Repeatable numbers in -1 to 1, enough for a picture.
fn noise(i: usize) -> f64 {
    2.0 * ((i as f64 * 12.9898).sin() * 43758.5453).rem_euclid(1.0) - 1.0
}

fn track(label: &str, n: usize, noisy: f64) -> PhaseTrack {
    let t_s = |i: usize| i as f64 * 0.01;
    let before = (0..n).map(|i| (t_s(i), 40.0 * noise(i + 7))).collect();
    let after = (0..n).map(|i| (t_s(i), 6.0 * (0.4 * t_s(i)).sin() + noisy * noise(i))).collect();
    PhaseTrack { label: label.into(), before, after, ..PhaseTrack::default() }
}

fn lobe(azimuth_deg: f64, at: f64, width: f64) -> f64 {
    (-(((azimuth_deg - at + 180.0).rem_euclid(360.0) - 180.0) / width).powi(2)).exp()
}

/// Phases of one link, and of two beside each other.
fn phases(out: &Path) -> Result<(), Failure> {
    let (recorded, simulated) = (track("recorded", 3000, 0.4), track("simulated", 3000, 0.2));
    let start = std::time::Instant::now();
    let phase = PhasePlot { title: "Phase of one link".into(), capture: recorded, ..PhasePlot::default() };
    phase.write(&out.join("phase"))?;
    println!("phase plot of 3000 points: {:.2} s", start.elapsed().as_secs_f64());
    PhasePlot { title: "Recorded and simulated".into(), other: Some(simulated), ..phase }.write(&out.join("phases"))?;
    Ok(())
}

/// A turn that is not quite whole, metres.
fn turn() -> Vec<[f64; 2]> {
    (0..200).map(|i| i as f64 / 200.0 * TAU * 0.8).map(|a| [0.5 * a.cos(), 0.35 * a.sin()]).collect()
}

/// Where a signal comes from.
fn profile(out: &Path) -> Result<(), Failure> {
    let series = |name: &str, k: f64| {
        let value = |a: f64| 0.95 * lobe(a, 35.0 + k, 9.0) + 0.4 * lobe(a, 140.0, 14.0) + 0.05;
        Curve { name: name.into(), points: (-180..180).map(f64::from).map(|a| (a, value(a))).collect() }
    };
    let profile = ProfilePlot {
        title: "Where the signal comes from".into(),
        chosen_from: series("run 3", 0.0),
        others: vec![series("run 1", 4.0), series("run 2", -5.0)],
        candidates_deg: vec![35.0, 140.0],
        answer_deg: Some(35.0),
        answer_sd_deg: Some(1.5),
        truth_deg: Some(33.0),
        mirror_deg: Some(-35.0),
    };
    profile.write(&out.join("profile"))?;
    Ok(())
}

/// A distribution of errors, and a curve.
fn curves(out: &Path) -> Result<(), Failure> {
    let share = |k: u32| (0.1 * f64::from(k), f64::from(k) / 100.0);
    let series = |name: &str, look, points| vec![Series { name: name.into(), points, look, colour: 0 }];
    let (x_label, y_label) = ("error (degrees)".into(), "cumulative share".into());
    let steps = series("one antenna", Look::Steps, (1..=100).map(share).collect());
    Chart { title: "Bearing error".into(), x_label, y_label, series: steps, log_x: true, ..Chart::default() }
        .write(&out.join("errors"))?;
    let falling = (0..6).map(|k| (100.0 - 10.0 * f64::from(k), 8.0 / (1.0 + f64::from(k)))).collect();
    let (x_label, y_label) = ("links kept (%)".into(), "error (degrees)".into());
    let series = series("mean", Look::Joined, falling);
    Chart { title: "Error of the links that are kept".into(), x_label, y_label, series, ..Chart::default() }
        .write(&out.join("refusals"))?;
    Ok(())
}

/// All robots of a place.
fn robots(out: &Path) -> Result<(), Failure> {
    let truth = vec![("robot A".into(), [3.0, 2.0]), ("robot B".into(), [-2.0, 2.5]), ("robot C".into(), [2.0, -2.0])];
    let ray = |azimuth_rad, label: &str, class| Ray {
        origin_m: [0.0; 2],
        azimuth_rad,
        sd_rad: None,
        label: label.into(),
        class,
    };
    let rays = vec![
        ray(0.55, "A", RayClass::Measured),
        ray(2.2, "B", RayClass::Measured),
        ray(-0.8, "C", RayClass::Measured),
        ray(2.245, "", RayClass::Truth),
        ray(-0.55, "A", RayClass::Mirror),
    ];
    MapPlot { title: "Robots and bearings".into(), truth, rays, used_m: turn(), path_m: turn(), ..MapPlot::default() }
        .write(&out.join("robots"))?;
    Ok(())
}

fn main() -> Result<(), Failure> {
    let out = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "pictures".into()));
    phases(&out)?;
    profile(&out)?;
    curves(&out)?;
    robots(&out)
}
