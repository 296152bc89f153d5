//! Bearing error against the Cramer-Rao bound; wrong peaks against a dense search.
//!
//! `cargo bench --bench statistics`; `-- --trials N` for other than 300 trials a point, `--scenes N` for other than 10,000 random
//! scenes.
#![allow(clippy::expect_used)]

mod common;
#[path = "common/picture.rs"]
mod picture;

use std::f64::consts::{PI, TAU};

use common::*;
use csi5300::bartlett::{Grid, Tier};
use csi5300::internal::{Method, Planner, Precision, ProfileOptions, Searcher};
use csi5300::maths::wrap_rad;
use csi5300_sim::random::Stream;
use nalgebra::Vector3;
use picture::*;

const SHAPES: [&str; 4] = ["circle", "line", "arc", "walk"];

fn track(shape: usize, n: usize, rng: &mut Stream) -> Vec<Vector3<f64>> {
    let mut at = Vector3::zeros();
    let points = (0..n).map(|t| {
        let s = t as f64 / (n - 1) as f64;
        match shape {
            0 => Vector3::new((TAU * s).cos(), (TAU * s).sin(), 0.0) * 0.3,
            1 => Vector3::new(0.6 * s - 0.3, 0.0, 0.0),
            2 => Vector3::new((2.0 * s).cos(), (2.0 * s).sin(), 0.0) * 0.5,
            _ => {
                let step = noise(rng) * (0.3 / (n as f64).sqrt());
                at += Vector3::new(step.re, step.im, 0.0);
                at
            }
        }
    });
    points.collect()
}

fn main() {
    banner("Statistics");
    let args: Vec<String> = std::env::args().collect();
    let after = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1)?.parse().ok());
    wrong_peaks(after("--scenes").unwrap_or(10_000));
    bounds(after("--trials").unwrap_or(300));
}

const SNR_DB: [f64; 8] = [-12.0, -9.0, -6.0, -3.0, 0.0, 3.0, 10.0, 20.0];

/// Trials at many signal-to-noise ratios: a trial is an outlier if it is off by more than a beam width.
fn bounds(trials: usize) {
    let mut table = Table::new(
        "statistics",
        &[
            ("track", 7),
            ("packets", 7),
            ("snr_db", 6),
            ("rmse_deg", 10),
            ("crb_deg", 10),
            ("ratio", 6),
            ("grid_1deg_rmse", 14),
            ("grid_bias_deg", 13),
            ("outliers", 8),
            ("predicted_deg", 13),
        ],
    );
    let mut series: Vec<Series> = Vec::new();
    let (mut pooled, mut pooled_count) = (0.0, 0.0);
    let mut judge = Judge::new();
    for (shape, name) in SHAPES.into_iter().enumerate() {
        for n in [100, 1_000, 10_000] {
            let points = track(shape, n, &mut judge.rng);
            let trials = if n > 1_000 { trials / 3 } else { trials };
            let tallies = SNR_DB.map(|snr_db| judge.tally(&points, shape, 10f64.powf(snr_db / 10.0), trials));
            for (snr_db, tally) in SNR_DB.into_iter().zip(&tallies) {
                table.row(&[vec![name.into(), n.to_string(), snr_db.to_string()], tally.cells()].concat());
                if tally.outliers == 0 {
                    pooled += tally.rmse().powi(2) / tally.crb().powi(2) * tally.count();
                    pooled_count += tally.count();
                }
            }
            if shape == 0 && n == 1_000 {
                series = lines(&tallies);
            }
        }
    }
    table.save();
    let ratio = (pooled / f64::max(pooled_count, 1.0)).sqrt();
    println!("error over bound, pooled over the {pooled_count} trials of rows without outliers: {ratio:.3}");
    let title = "Circle of 0.3 m, 1,000 packets, above the threshold";
    picture("statistics", title, "one-way signal-to-noise ratio", "RMS error, degrees", &series);
}

/// What a line of the picture shows.
type Figure = (&'static str, fn(&Tally) -> f64);

/// Error, bound and the 1-degree grid's error over the ratio, where outliers are rare.
fn lines(tallies: &[Tally]) -> Vec<Series> {
    let figures: [Figure; 3] =
        [("search", Tally::rmse), ("Cramer-Rao bound", Tally::crb), ("1-degree grid", Tally::grid_rmse)];
    let above = || SNR_DB.into_iter().zip(tallies).filter(|(_, tally)| tally.rate() < 0.01);
    let line = |(label, figure): Figure| Series {
        label: label.into(),
        points: above().map(|(snr_db, tally)| (10f64.powf(snr_db / 10.0), figure(tally))).collect(),
    };
    figures.map(line).into()
}

/// What trials at one ratio gave: sums of squares, radians.
#[derive(Default)]
struct Tally {
    error: f64,
    crb: f64,
    grid: f64,
    grid_bias: f64,
    predicted: f64,
    used: usize,
    outliers: usize,
}

impl Tally {
    fn count(&self) -> f64 {
        self.used.max(1) as f64
    }
    fn rmse(&self) -> f64 {
        (self.error / self.count()).sqrt().to_degrees()
    }
    fn crb(&self) -> f64 {
        (self.crb / self.count()).sqrt().to_degrees()
    }
    fn grid_rmse(&self) -> f64 {
        (self.grid / self.count()).sqrt().to_degrees()
    }
    fn rate(&self) -> f64 {
        self.outliers as f64 / (self.used + self.outliers).max(1) as f64
    }
    fn cells(&self) -> Vec<String> {
        vec![
            format!("{:.4}", self.rmse()),
            format!("{:.4}", self.crb()),
            format!("{:.3}", self.rmse() / self.crb()),
            format!("{:.4}", self.grid_rmse()),
            format!("{:.4}", (self.grid_bias / self.count()).to_degrees()),
            format!("{:.3}", self.rate()),
            format!("{:.4}", (self.predicted / self.count()).to_degrees()),
        ]
    }
}

/// Makes scenes and measures both estimators on them.
struct Judge {
    rng: Stream,
    searcher: Searcher,
    planner: Planner,
}

impl Judge {
    fn new() -> Self {
        let (searcher, planner) = (Searcher::new(Tier::detect()), Planner::default());
        Self { rng: Stream::of_seed(3), searcher, planner }
    }

    /// Trials of one track at the one-way ratio `g`.
    fn tally(&mut self, points: &[Vector3<f64>], shape: usize, g: f64, trials: usize) -> Tally {
        let mut tally = Tally::default();
        for _ in 0..trials {
            // A line is best seen from its side, and only up to its mirror.
            let line = shape == 1;
            let truth = if line { self.rng.between(0.8, 2.3) } else { self.rng.between(-PI, PI) };
            let off = |azimuth: f64| {
                let (here, mirrored) = (wrap_rad(azimuth - truth), wrap_rad(-azimuth - truth));
                if line && mirrored.abs() < here.abs() { mirrored } else { here }
            };
            // One-way channels of signal-to-noise ratio g in both directions; their product is the sample.
            let samples = product(points, truth, g, &mut self.rng);
            let estimate = self.searcher.search(&samples, 0.0).expect("a bearing");
            let error = off(estimate.azimuth_rad);
            if error.abs() > 0.1 {
                tally.outliers += 1;
                continue;
            }
            let options = ProfileOptions::default();
            let grid = self.planner.profile(&samples, &Grid::azimuth(360), &options).expect("a profile");
            let coarse = off(grid.max().map_or(0.0, |(i, _)| grid.grid.at(i).0));
            tally.used += 1;
            tally.error += error * error;
            tally.crb += bound(points, truth, g).powi(2);
            tally.grid += coarse * coarse;
            tally.grid_bias += coarse;
            tally.predicted += estimate.azimuth_sd_rad;
        }
        tally
    }
}

/// Round-trip samples: the product of two noisy one-way channels.
fn product(points: &[Vector3<f64>], truth: f64, g: f64, rng: &mut Stream) -> csi5300::signal::samples::Samples {
    let mut samples = csi5300::signal::samples::Samples::new(WAVELENGTH_M, 2).expect("a wavelength");
    let k = TAU / WAVELENGTH_M;
    let sd = (1.0 / g).sqrt();
    for (t, p) in points.iter().enumerate() {
        let h = num_complex::Complex64::from_polar(1.0, k * (truth.cos() * p.x + truth.sin() * p.y));
        let z = (h + noise(rng) * sd) * (h + noise(rng) * sd);
        samples.push(t as f64 * 0.01, z, *p, Vector3::zeros()).expect("finite samples");
    }
    samples
}

/// The Cramer-Rao bound for samples of ratio `g / (2 + 1 / g)`.
fn bound(points: &[Vector3<f64>], truth: f64, g: f64) -> f64 {
    let across = |p: &Vector3<f64>| truth.cos() * p.y - truth.sin() * p.x;
    let mean = points.iter().map(across).sum::<f64>() / points.len() as f64;
    let spread: f64 = points.iter().map(|p| (across(p) - mean).powi(2)).sum();
    let kappa = 2.0 * TAU / WAVELENGTH_M;
    1.0 / (2.0 * g / (2.0 + 1.0 / g) * kappa * kappa * spread).sqrt()
}

/// Random scenes, one to three similar paths, radii 0.05 to 1.5 m: the search against a dense one.
fn wrong_peaks(scenes: usize) {
    let mut rng = Stream::of_seed(9);
    let mut searcher = Searcher::new(Tier::detect());
    let mut planner = Planner::default();
    let (mut wrong, mut grid_wrong, mut evaluations) = (0, 0, 0);
    for case in 0..scenes {
        let scale = 0.05 * 30f64.powf(rng.uniform()) / 0.3;
        let n = 30 + rng.below(120) as usize;
        let points: Vec<_> = track(case % 4, n, &mut rng).into_iter().map(|p| p * scale).collect();
        let paths: Vec<_> =
            (0..=rng.below(3)).map(|_| (rng.between(-PI, PI), rng.between(-0.3, 0.3), rng.between(0.7, 1.0))).collect();
        let variance = 10f64.powf(rng.between(-2.0, 0.5));
        let samples = samples(&points, &paths, variance, &mut rng);
        let estimate = searcher.search(&samples, 0.0).expect("a bearing");
        evaluations += estimate.evaluations;
        let extent = points.iter().flat_map(|p| [p.x.abs(), p.y.abs()]).fold(0.0, f64::max) * 1.5;
        let count = (4 * (20.0 * 232.2 * extent) as usize + 400).next_multiple_of(4);
        let options = ProfileOptions { eps: 1e-10, method: Some(Method::Direct), precision: Some(Precision::Double) };
        let dense = planner.profile(&samples, &Grid::azimuth(count), &options).expect("a profile");
        let (_, top) = dense.max().expect("a direction");
        wrong += usize::from(estimate.value < top * (1.0 - 1e-9));
        let coarse = planner.profile(&samples, &Grid::azimuth(360), &options).expect("a profile");
        let (i, _) = coarse.max().expect("a direction");
        grid_wrong += usize::from(
            wrap_rad(coarse.grid.at(i).0 - estimate.azimuth_rad).abs() > 2f64.to_radians() && case % 4 != 1,
        );
    }
    println!(
        "\n{scenes} random scenes: {wrong} wrong peaks; a 1-degree grid is on another peak in {grid_wrong} (lines"
    );
    println!("left out); {} directions evaluated on average", evaluations / scenes);
    std::fs::write(out("wrong_peaks.csv"), format!("scenes,wrong,grid_wrong\n{scenes},{wrong},{grid_wrong}\n"))
        .expect("the result can be written");
}
