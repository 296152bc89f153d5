//! Bearing error against the Cramer-Rao bound; wrong peaks against a dense search.
//!
//! `cargo bench --bench statistics`; `-- --trials N` for other than 300 trials a point.
#![allow(clippy::expect_used)]

mod common;

use std::f64::consts::{PI, TAU};

use common::*;
use csi5300::bartlett::{Grid, Method, Planner, Precision, ProfileOptions, Searcher, Tier};
use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SHAPES: [&str; 4] = ["circle", "line", "arc", "walk"];

fn track(shape: usize, n: usize, rng: &mut ChaCha8Rng) -> Vec<Vector3<f64>> {
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

fn wrap(a: f64) -> f64 {
    (a + PI).rem_euclid(TAU) - PI
}

fn main() {
    banner("Statistics");
    let args: Vec<String> = std::env::args().collect();
    let after = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1)?.parse().ok());
    wrong_peaks(after("--scenes").unwrap_or(10_000));
    bounds(after("--trials").unwrap_or(300));
}

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
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut searcher = Searcher::new(Tier::detect());
    let mut planner = Planner::default();
    for (shape, name) in SHAPES.into_iter().enumerate() {
        for n in [100, 1_000, 10_000] {
            let points = track(shape, n, &mut rng);
            let mut lines = [Vec::new(), Vec::new(), Vec::new()];
            let trials = if n > 1_000 { trials / 3 } else { trials };
            for snr_db in [-12.0, -9.0, -6.0, -3.0, 0.0, 3.0, 10.0, 20.0] {
                let g = 10f64.powf(snr_db / 10.0);
                let mut sums = [0.0; 6];
                let mut outliers = 0;
                for _ in 0..trials {
                    // A line is best seen from its side, and only up to its mirror.
                    let truth = if shape == 1 { rng.random_range(0.8..2.3) } else { rng.random_range(-PI..PI) };
                    // One-way channels of signal-to-noise ratio g in both directions; their product is the sample.
                    let samples = product(&points, truth, g, &mut rng);
                    let estimate = searcher.search(&samples, WAVELENGTH_M, 0.0).expect("a bearing");
                    let mut error = wrap(estimate.azimuth_rad - truth);
                    if shape == 1 {
                        let mirrored = wrap(-estimate.azimuth_rad - truth);
                        error = if mirrored.abs() < error.abs() { mirrored } else { error };
                    }
                    if error.abs() > 0.1 {
                        outliers += 1;
                        continue;
                    }
                    let grid = planner
                        .profile(&samples, WAVELENGTH_M, &Grid::azimuth(360), &ProfileOptions::default())
                        .expect("a profile");
                    let top = grid.max().map_or(0.0, |(i, _)| grid.grid.at(i).0);
                    let mut coarse = wrap(top - truth);
                    if shape == 1 && wrap(-top - truth).abs() < coarse.abs() {
                        coarse = wrap(-top - truth);
                    }
                    let crb = bound(&points, truth, g);
                    let terms = [error * error, crb * crb, coarse * coarse, coarse, estimate.azimuth_sd_rad, 1.0];
                    sums.iter_mut().zip(terms).for_each(|(s, t)| *s += t);
                }
                let count = sums[5].max(1.0);
                let [rmse, crb, coarse] = [0, 1, 2].map(|i| (sums[i] / count).sqrt().to_degrees());
                let rate = outliers as f64 / trials as f64;
                table.row(&[
                    name.into(),
                    n.to_string(),
                    snr_db.to_string(),
                    format!("{rmse:.4}"),
                    format!("{crb:.4}"),
                    format!("{:.3}", rmse / crb),
                    format!("{coarse:.4}"),
                    format!("{:.4}", (sums[3] / count).to_degrees()),
                    format!("{rate:.3}"),
                    format!("{:.4}", (sums[4] / count).to_degrees()),
                ]);
                if outliers == 0 {
                    pooled += rmse * rmse / (crb * crb) * count;
                    pooled_count += count;
                }
                if rate < 0.01 {
                    let x = g;
                    lines[0].push((x, rmse));
                    lines[1].push((x, crb));
                    lines[2].push((x, coarse));
                }
            }
            if shape == 0 && n == 1_000 {
                for (label, points) in ["search", "Cramer-Rao bound", "1-degree grid"].into_iter().zip(lines) {
                    series.push(Series { label: label.into(), points });
                }
            }
        }
    }
    table.save();
    let ratio = (pooled / f64::max(pooled_count, 1.0)).sqrt();
    println!("error over bound, pooled over the {pooled_count} trials of rows without outliers: {ratio:.3}");
    picture(
        "statistics",
        "Circle of 0.3 m, 1,000 packets, above the threshold",
        "one-way signal-to-noise ratio",
        "RMS error, degrees",
        &series,
    );
}

/// Round-trip samples: the product of two noisy one-way channels.
fn product(points: &[Vector3<f64>], truth: f64, g: f64, rng: &mut ChaCha8Rng) -> csi5300::samples::Samples {
    let mut samples = csi5300::samples::Samples::new(2);
    let k = TAU / WAVELENGTH_M;
    let sd = (1.0 / g).sqrt();
    for (t, p) in points.iter().enumerate() {
        let h = num_complex::Complex64::from_polar(1.0, k * (truth.cos() * p.x + truth.sin() * p.y));
        let z = (h + noise(rng) * sd) * (h + noise(rng) * sd);
        samples.push(t as f64 * 0.01, z, *p, Vector3::zeros());
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
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut searcher = Searcher::new(Tier::detect());
    let mut planner = Planner::default();
    let (mut wrong, mut grid_wrong, mut evaluations) = (0, 0, 0);
    for case in 0..scenes {
        let scale = 0.05 * 30f64.powf(rng.random::<f64>()) / 0.3;
        let n = rng.random_range(30..150);
        let points: Vec<_> = track(case % 4, n, &mut rng).into_iter().map(|p| p * scale).collect();
        let paths: Vec<_> = (0..rng.random_range(1..=3))
            .map(|_| (rng.random_range(-PI..PI), rng.random_range(-0.3..0.3), rng.random_range(0.7..1.0)))
            .collect();
        let variance = 10f64.powf(rng.random_range(-2.0..0.5));
        let samples = samples(&points, &paths, variance, &mut rng);
        let estimate = searcher.search(&samples, WAVELENGTH_M, 0.0).expect("a bearing");
        evaluations += estimate.evaluations;
        let extent = points.iter().flat_map(|p| [p.x.abs(), p.y.abs()]).fold(0.0, f64::max) * 1.5;
        let count = (4 * (20.0 * 232.2 * extent) as usize + 400).next_multiple_of(4);
        let options = ProfileOptions { eps: 1e-10, method: Some(Method::Direct), precision: Some(Precision::Double) };
        let dense = planner.profile(&samples, WAVELENGTH_M, &Grid::azimuth(count), &options).expect("a profile");
        let (_, top) = dense.max().expect("a direction");
        wrong += usize::from(estimate.value < top * (1.0 - 1e-9));
        let coarse = planner.profile(&samples, WAVELENGTH_M, &Grid::azimuth(360), &options).expect("a profile");
        let (i, _) = coarse.max().expect("a direction");
        grid_wrong +=
            usize::from(wrap(coarse.grid.at(i).0 - estimate.azimuth_rad).abs() > 2f64.to_radians() && case % 4 != 1);
    }
    println!(
        "\n{scenes} random scenes: {wrong} wrong peaks; a 1-degree grid is on another peak in {grid_wrong} (lines"
    );
    println!("left out); {} directions evaluated on average", evaluations / scenes);
    std::fs::write(out("wrong_peaks.csv"), format!("scenes,wrong,grid_wrong\n{scenes},{wrong},{grid_wrong}\n"))
        .expect("the result can be written");
}
