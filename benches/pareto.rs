//! Run time against error, for every path, precision and tier, beside FINUFFT, NumPy and the naive double loop.
//!
//! `cargo bench --bench pareto` (ten minutes); `-- --full` for all sizes and apertures, `-- planar`, `azimuth` or `helix` for
//! one job, `-- quick` for 1,000 packets at 0.3 m. FINUFFT and NumPy run in the same
//! run if `scripts/bench_venv.sh` has made their virtual environment.
#![allow(clippy::expect_used)]

mod common;

use std::process::Command;

use common::*;
use csi5300::bartlett::{Grid, Method, Planner, Precision, ProfileOptions, Searcher, Tier};
use csi5300::samples::Samples;

struct Job {
    name: &'static str,
    grid: Grid,
    height: f64,
}

fn jobs() -> [Job; 3] {
    [
        Job { name: "planar", grid: Grid::azimuth_elevation(360, 181), height: 0.0 },
        Job { name: "azimuth", grid: Grid::azimuth(360), height: 0.0 },
        Job { name: "helix", grid: Grid::azimuth_elevation(360, 181), height: 1.0 },
    ]
}

/// The direct sums in double, which agree with the oracle (checked here on 200 directions, printed).
fn reference(samples: &Samples, grid: &Grid) -> Vec<f64> {
    let options = ProfileOptions { eps: 1e-13, method: Some(Method::Direct), precision: Some(Precision::Double) };
    let values = Planner::default().profile(samples, WAVELENGTH_M, grid, &options).expect("a profile").values;
    let picked: Vec<usize> = (0..200).map(|i| i * (grid.len() - 1) / 199).collect();
    let list = Grid::directions(picked.iter().map(|i| grid.at(*i)).collect());
    let exact = csi5300::bartlett::oracle(samples, WAVELENGTH_M, &list).expect("a profile").values;
    let top = values.iter().copied().fold(0.0, f64::max);
    let worst = picked.iter().zip(&exact).map(|(i, e)| (values[*i] - e).abs() / top).fold(0.0, f64::max);
    assert!(worst < 1e-12, "reference off by {worst}");
    values
}

fn error(values: &[f64], reference: &[f64]) -> f64 {
    let top = reference.iter().copied().fold(0.0, f64::max);
    values.iter().zip(reference).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / top
}

fn main() {
    banner("Run time against error");
    let full = std::env::args().any(|a| a == "--full");
    let mut table = Table::new(
        "pareto",
        &[
            ("job", 8),
            ("packets", 7),
            ("radius_m", 8),
            ("who", 26),
            ("eps", 8),
            ("ms", 10),
            ("error", 9),
            ("naive_ms", 10),
            ("ratio", 8),
        ],
    );
    let mut series: Vec<Series> = Vec::new();
    let named: Vec<String> = std::env::args().filter(|a| jobs().iter().any(|j| j.name == a)).collect();
    let quick = std::env::args().any(|a| a == "quick");
    for job in jobs().into_iter().filter(|j| named.is_empty() || named.iter().any(|n| n == j.name)) {
        for (n, radius) in sizes(full).into_iter().filter(|size| !quick || *size == (1_000, 0.3)) {
            let samples = common::job(n, radius, job.height * radius, 7);
            let before = naive_ms(&samples, &job.grid, 30);
            let reference = reference(&samples, &job.grid);
            let mut rows = ours(&job, &samples, &reference);
            if job.name == "azimuth" {
                rows.extend(bearing(&samples));
            }
            rows.extend(peers(&job, &samples, &reference, n, radius));
            // Noise of a shared machine: the naive loop before and after, the quicker one counts.
            let naive = before.min(naive_ms(&samples, &job.grid, 30));
            rows.push((String::from("naive double loop"), 0.0, naive, 1e-15));
            for (who, eps, ms, error) in rows {
                table.row(&[
                    job.name.into(),
                    n.to_string(),
                    radius.to_string(),
                    who.clone(),
                    format!("{eps:.0e}"),
                    format!("{ms:.4}"),
                    format!("{error:.1e}"),
                    format!("{naive:.1}"),
                    format!("{:.1}", naive / ms),
                ]);
                if job.name == "planar" && n == 1_000 && radius == 0.3 {
                    let label = who.rsplit_once(':').map_or(who.as_str(), |(l, _)| l).to_string();
                    let at = series.iter().position(|s| s.label == label).unwrap_or_else(|| {
                        series.push(Series { label, points: Vec::new() });
                        series.len() - 1
                    });
                    series[at].points.push((ms, error.max(1e-16)));
                }
            }
        }
        table.save();
        if job.name == "planar" {
            picture(
                "pareto",
                "360 x 181 directions, 1,000 packets, 0.3 m",
                "milliseconds, one thread",
                "largest error of F / max F",
                &series,
            );
        }
    }
}

fn sizes(full: bool) -> Vec<(usize, f64)> {
    let (packets, radii) = ([300, 1_000, 3_000, 30_000], [0.1, 0.3, 1.0, 2.0]);
    let all = packets.into_iter().flat_map(|n| radii.map(|r| (n, r)));
    all.filter(|(n, r)| full || *n == 1_000 || *r == 0.3).collect()
}

type Row = (String, f64, f64, f64);

/// Every tier at every tolerance, by the method that the planner chooses.
fn ours(job: &Job, samples: &Samples, reference: &[f64]) -> Vec<Row> {
    let mut rows = Vec::new();
    for tier in Tier::available().into_iter().filter(|t| *t != Tier::Portable) {
        let mut planner = Planner::new(tier);
        for eps in [1e-3, 1e-4, 1e-5, 1e-6, 1e-8, 1e-10, 1e-12] {
            let options = ProfileOptions { eps, ..ProfileOptions::default() };
            let plan = planner.plan(samples, WAVELENGTH_M, &job.grid, &options).expect("a plan");
            let mut out = Vec::new();
            let ms = quickest(150.0, || {
                planner.profile_into(samples, WAVELENGTH_M, &job.grid, &options, &mut out).expect("a profile");
            });
            let e = plan.explain();
            let precision = if e.precision == Precision::Single { "f32" } else { "f64" };
            rows.push((format!("{tier:?} {precision}:{:?}", e.method), eps, ms, error(&out, reference)));
        }
    }
    rows
}

/// The guaranteed search, azimuth alone.
fn bearing(samples: &Samples) -> Vec<Row> {
    let tiers = Tier::available().into_iter().filter(|t| *t != Tier::Portable);
    tiers
        .map(|tier| {
            let mut searcher = Searcher::new(tier);
            let ms = quickest(150.0, || {
                searcher.search(samples, WAVELENGTH_M, 0.0).expect("a bearing");
            });
            (format!("{tier:?} bearing only"), 1e-4, ms, 0.0)
        })
        .collect()
}

/// FINUFFT and NumPy on the same samples, in a process of their own.
fn peers(job: &Job, samples: &Samples, reference: &[f64], n: usize, radius: f64) -> Vec<Row> {
    let root = std::path::PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let python = root.join("target/venv/bin/python");
    if !python.exists() {
        println!("FINUFFT and NumPy skipped: run scripts/bench_venv.sh first");
        return Vec::new();
    }
    let k = std::f64::consts::TAU * 2.0 / WAVELENGTH_M;
    let columns = samples.z.iter().zip(&samples.receiver_m).flat_map(|(z, p)| [k * p.x, k * p.y, k * p.z, z.re, z.im]);
    let bytes = |v: Vec<f64>| v.into_iter().flat_map(f64::to_le_bytes).collect::<Vec<u8>>();
    let scale = {
        let sum: f64 = samples.z.iter().map(|z| z.norm()).sum();
        sum * sum
    };
    std::fs::write(out("samples.bin"), bytes(columns.collect())).expect("a file for the peers");
    std::fs::write(out("reference.bin"), bytes(reference.iter().map(|v| v * scale).collect())).expect("a file");
    let run = Command::new(python)
        .arg(root.join("scripts/bench_peers.py"))
        .args([job.name, &n.to_string(), &radius.to_string()])
        .arg(out("samples.bin"))
        .arg(out("reference.bin"))
        .output()
        .expect("Python starts");
    if !run.status.success() {
        println!("FINUFFT and NumPy failed: {}", String::from_utf8_lossy(&run.stderr));
        return Vec::new();
    }
    let text = String::from_utf8_lossy(&run.stdout).into_owned();
    text.lines()
        .filter_map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            let [who, eps, ms, error] = cells[..] else { return None };
            Some((who.to_string(), eps.parse().ok()?, ms.parse().ok()?, error.parse().ok()?))
        })
        .collect()
}
