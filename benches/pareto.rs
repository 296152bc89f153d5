//! Run time against error, for every path, precision and tier, beside FINUFFT (at the better of its two oversamplings), a double
//! loop that gcc vectorised, NumPy and the naive double loop. `planned anew`: a new planner in each call, as for a single profile.
//!
//! `cargo bench --bench pareto` (1,000 packets at 0.3 m, under three minutes on a quiet machine); `-- --full` for all numbers of
//! packets and apertures; `-- planar`, `azimuth`, `helix` or `bearing` for one job. Calls of all contenders are interleaved, round by
//! round, and the quickest of each counts, so that other work on the machine meets all alike. FINUFFT and NumPy run in the
//! same run if `scripts/bench_venv.sh` has made their virtual environment.
#![allow(clippy::expect_used)]

mod common;
#[path = "common/picture.rs"]
mod picture;

use std::process::Command;

use common::*;
use csi5300::bartlett::{Grid, Tier};
use csi5300::internal::{Method, Planner, Precision, ProfileOptions, Searcher};
use csi5300::signal::samples::Samples;
use picture::*;

struct Job {
    name: &'static str,
    grid: Grid,
    height: f64,
}

fn jobs() -> [Job; 4] {
    [
        Job { name: "planar", grid: Grid::azimuth_elevation(360, 181), height: 0.0 },
        Job { name: "azimuth", grid: Grid::azimuth(360), height: 0.0 },
        Job { name: "bearing", grid: Grid::azimuth(360), height: 0.0 },
        Job { name: "helix", grid: Grid::azimuth_elevation(360, 181), height: 1.0 },
    ]
}

/// The direct sums in double, which agree with the oracle (checked here on 200 directions, printed).
fn reference(samples: &Samples, grid: &Grid) -> Vec<f64> {
    let options = ProfileOptions { eps: 1e-13, method: Some(Method::Direct), precision: Some(Precision::Double) };
    let values = Planner::default().profile(samples, grid, &options).expect("a profile").values;
    let picked: Vec<usize> = (0..200).map(|i| i * (values.len() - 1) / 199).collect();
    let list = Grid::directions(picked.iter().map(|i| grid.at(*i)).collect());
    let exact = csi5300::internal::oracle(samples, &list).expect("a profile").values;
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
    let args: Vec<String> = std::env::args().collect();
    let mut table = Table::new(
        "pareto",
        &[
            ("job", 8),
            ("packets", 7),
            ("radius_m", 8),
            ("who", 30),
            ("eps", 8),
            ("ms", 10),
            ("error", 9),
            ("naive_ms", 10),
            ("ratio", 8),
            ("vector_ms", 10),
            ("ratio", 8),
        ],
    );
    let named = |job: &Job| args.iter().any(|a| a == job.name);
    let any = jobs().iter().any(named);
    let mut series: Vec<Series> = Vec::new();
    for job in jobs().into_iter().filter(|job| !any || named(job)) {
        for (n, radius) in sizes(&args) {
            let (naive, rows) = measure(&job, n, radius);
            // The vectorised loop of the same precision, where gcc was there to make it.
            let vectorised = |precision: &str| {
                let name = format!("double loop vectorised {precision}");
                rows.iter().find(|row| row.0 == name).map_or(f64::NAN, |row| row.2)
            };
            for (who, eps, ms, error) in &rows {
                let vector = vectorised(if who.contains("f32") || who.contains("32-bit") { "f32" } else { "f64" });
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
                    format!("{vector:.1}"),
                    format!("{:.1}", vector / ms),
                ]);
                if job.name == "planar" && (n, radius) == (1_000, 0.3) {
                    draw(&mut series, who, *ms, *error);
                }
            }
        }
        table.save();
        if job.name == "planar" {
            let title = "360 x 181 directions, 1,000 packets, 0.3 m";
            picture("pareto", title, "milliseconds, one thread", "largest error of F / max F, millionths", &series);
        }
    }
}

/// Adds a point to the picture, which has only what a user would choose.
fn draw(series: &mut Vec<Series>, who: &str, ms: f64, error: f64) {
    if who.ends_with("forced") || who.contains("planned anew") {
        return;
    }
    let label = who.rsplit_once(':').map_or(who, |(l, _)| l).to_string();
    let at = series.iter().position(|s| s.label == label).unwrap_or_else(|| {
        series.push(Series { label, points: Vec::new() });
        series.len() - 1
    });
    // In millionths: the picture ends at 1e-10.
    series[at].points.push((ms, 1e6 * error.max(1e-16)));
}

/// Numbers of packets and radii: all with `--full`, or as many packets as `--packets` says at 0.3 m.
fn sizes(args: &[String]) -> Vec<(usize, f64)> {
    if !args.iter().any(|a| a == "--full") {
        let asked = args.iter().position(|a| a == "--packets").and_then(|at| args.get(at + 1)?.parse().ok());
        return vec![(asked.unwrap_or(1_000), 0.3)];
    }
    let (packets, radii) = ([300, 1_000, 3_000, 30_000], [0.1, 0.3, 1.0, 2.0]);
    packets.into_iter().flat_map(|n| radii.map(|r| (n, r))).collect()
}

/// Who, tolerance asked for, milliseconds, error.
type Timing = (String, f64, f64, f64);

/// One size of a job: the naive loop's milliseconds, and everybody's rows.
fn measure(job: &Job, n: usize, radius: f64) -> (f64, Vec<Timing>) {
    let samples = common::job(n, radius, job.height * radius, 7);
    let reference = reference(&samples, &job.grid);
    let mut contenders = if job.name == "bearing" { bearings(&samples) } else { planned(job, &samples) };
    if job.name != "bearing" {
        contenders.extend(forced(job, &samples));
    }
    let naive = race(&mut contenders, &samples, &job.grid);
    let error_of = |c: &Contender<'_>| if job.name == "bearing" { c.out[0] } else { error(&c.out, &reference) };
    let mut rows: Vec<Timing> = contenders.iter().map(|c| (c.who.clone(), c.eps, c.ms, error_of(c))).collect();
    if job.name != "bearing" {
        rows.extend(others(job, &samples, &reference, n, radius));
    }
    rows.push((String::from("naive double loop"), 0.0, naive, 1e-15));
    (naive, rows)
}

/// Fills a profile.
type Call<'a> = Box<dyn FnMut(&mut Vec<f64>) + 'a>;

/// Somebody to be timed.
struct Contender<'a> {
    who: String,
    eps: f64,
    call: Call<'a>,
    out: Vec<f64>,
    ms: f64,
    spent_ms: f64,
}

impl<'a> Contender<'a> {
    fn new(who: String, eps: f64, call: impl FnMut(&mut Vec<f64>) + 'a) -> Self {
        Self { who, eps, call: Box::new(call), out: Vec::new(), ms: f64::INFINITY, spent_ms: 0.0 }
    }
}

/// Times all in turn, ten milliseconds or one call each, over and over; returns the naive loop's milliseconds.
fn race(contenders: &mut [Contender<'_>], samples: &Samples, grid: &Grid) -> f64 {
    let mut naive = f64::INFINITY;
    for _ in 0..16 {
        naive = naive.min(naive_ms(samples, grid, 3));
        for c in contenders.iter_mut().filter(|c| c.spent_ms < 800.0) {
            let mut turn = 0.0;
            while turn < 10.0 {
                let took = time(|| (c.call)(&mut c.out));
                c.ms = c.ms.min(took);
                turn += took;
            }
            c.spent_ms += turn;
        }
    }
    naive
}

fn tiers() -> impl Iterator<Item = Tier> {
    Tier::available().into_iter().filter(|t| *t != Tier::Portable)
}

/// A profile by a planner of its own.
fn profiler<'a>(job: &'a Job, samples: &'a Samples, tier: Tier, options: ProfileOptions, note: &str) -> Contender<'a> {
    let mut planner = Planner::new(tier);
    let e = planner.explain(samples, &job.grid, &options).expect("a plan");
    let precision = if e.precision == Precision::Single { "f32" } else { "f64" };
    let who = format!("{tier:?} {precision}:{:?}{note}", e.method);
    Contender::new(who, options.eps, move |out| {
        planner.profile_into(samples, &job.grid, &options, out).expect("a profile");
    })
}

/// Every tier at every tolerance, by the method that the planner chooses.
fn planned<'a>(job: &'a Job, samples: &'a Samples) -> Vec<Contender<'a>> {
    let tolerances = [1e-3, 1e-4, 1e-5, 1e-6, 1e-8, 1e-10, 1e-12];
    let all = tiers().flat_map(|tier| tolerances.map(|eps| (tier, eps)));
    let mut all: Vec<_> = all
        .map(|(tier, eps)| profiler(job, samples, tier, ProfileOptions { eps, ..ProfileOptions::default() }, ""))
        .collect();
    all.extend(tiers().flat_map(|tier| [1e-4, 1e-6, 1e-12].map(|eps| planned_anew(job, samples, tier, eps))));
    all
}

/// One profile and no more: the planner is made within the time.
fn planned_anew<'a>(job: &'a Job, samples: &'a Samples, tier: Tier, eps: f64) -> Contender<'a> {
    let options = ProfileOptions { eps, ..ProfileOptions::default() };
    let precision = if eps < 1e-5 { "f64" } else { "f32" };
    Contender::new(format!("{tier:?} {precision} planned anew:"), eps, move |out| {
        Planner::new(tier).profile_into(samples, &job.grid, &options, out).expect("a profile");
    })
}

/// Every method that can serve the job, in both precisions, on every tier.
fn forced<'a>(job: &'a Job, samples: &'a Samples) -> Vec<Contender<'a>> {
    let methods: &[Method] = if job.height == 0.0 {
        &[Method::Direct, Method::RingsDirect, Method::RingsNufft, Method::TargetsNufft]
    } else {
        &[Method::Direct, Method::RingsDirect, Method::Slab]
    };
    let mut all = Vec::new();
    for tier in tiers() {
        for &method in methods {
            for (precision, eps) in [(Precision::Single, 1e-4), (Precision::Double, 1e-12)] {
                let options = ProfileOptions { eps, method: Some(method), precision: Some(precision) };
                all.push(profiler(job, samples, tier, options, " forced"));
            }
        }
    }
    all
}

/// The guaranteed search, azimuth alone; the error is how far its peak is below that of a grid of 0.01 degrees.
fn bearings(samples: &Samples) -> Vec<Contender<'_>> {
    let options = ProfileOptions { eps: 1e-12, method: Some(Method::Direct), precision: Some(Precision::Double) };
    let dense = Planner::default().profile(samples, &Grid::azimuth(36_000), &options).expect("a profile");
    let top = dense.max().map_or(0.0, |(_, top)| top);
    let search = |tier: Tier| {
        let mut searcher = Searcher::new(tier);
        Contender::new(format!("{tier:?} bearing only"), 1e-4, move |out: &mut Vec<f64>| {
            let found = searcher.search(samples, 0.0).expect("a bearing");
            *out = vec![(1.0 - found.value / top).max(0.0)];
        })
    };
    let profiles = tiers().flat_map(|tier| {
        [("azimuth", Grid::azimuth(360)), ("planar", Grid::azimuth_elevation(360, 181))].map(|(name, grid)| {
            let mut planner = Planner::new(tier);
            let mut values = Vec::new();
            Contender::new(format!("{tier:?} {name} profile beside it"), 1e-4, move |out: &mut Vec<f64>| {
                let options = ProfileOptions::default();
                planner.profile_into(samples, &grid, &options, &mut values).expect("a profile");
                *out = vec![0.0];
            })
        })
    });
    tiers().map(search).chain(profiles).collect()
}

/// FINUFFT and NumPy on the same samples, in a process of their own.
fn others(job: &Job, samples: &Samples, reference: &[f64], n: usize, radius: f64) -> Vec<Timing> {
    let root = std::path::PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let python = root.join("target/venv/bin/python");
    if !python.exists() {
        println!("FINUFFT and NumPy skipped: run scripts/bench_venv.sh first");
        return Vec::new();
    }
    let k = std::f64::consts::TAU * 2.0 / WAVELENGTH_M;
    let columns =
        samples.z().iter().zip(samples.receiver_m()).flat_map(|(z, p)| [k * p.x, k * p.y, k * p.z, z.re, z.im]);
    let bytes = |v: Vec<f64>| v.into_iter().flat_map(f64::to_le_bytes).collect::<Vec<u8>>();
    let scale = {
        let sum: f64 = samples.z().iter().map(|z| z.norm()).sum();
        sum * sum
    };
    std::fs::write(out("samples.bin"), bytes(columns.collect())).expect("a file for the others");
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
