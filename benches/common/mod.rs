//! What the benchmarks share: scenes, the naive loop, timing, tables, CSV and pictures.
#![allow(dead_code)]

use std::f64::consts::{FRAC_1_SQRT_2, TAU};
use std::fmt::Write as _;
use std::path::PathBuf;

use csi5300::bartlett::{Grid, direction};
use csi5300::signal::samples::Samples;
use csi5300_sim::random::Stream;
use nalgebra::Vector3;
use num_complex::Complex64;

/// `4 pi / lambda = 232.2 rad/m`: channel 108 (5.54 GHz), round trip.
pub const WAVELENGTH_M: f64 = 2.0 * TAU / 232.2;

/// Circularly symmetric noise of unit variance.
pub fn noise(rng: &mut Stream) -> Complex64 {
    Complex64::new(rng.normal(), rng.normal()) * FRAC_1_SQRT_2
}

/// Plane waves (azimuth, elevation, amplitude) over `points` in noise of the given variance; path gain 2.
pub fn samples(points: &[Vector3<f64>], paths: &[(f64, f64, f64)], variance: f64, rng: &mut Stream) -> Samples {
    let mut samples = Samples::new(WAVELENGTH_M, 2).expect("a wavelength");
    for (t, p) in points.iter().enumerate() {
        let wave = |&(a, e, g): &(f64, f64, f64)| {
            Complex64::from_polar(g, TAU * 2.0 / WAVELENGTH_M * direction(a, e).dot(p) + 5.0 * a)
        };
        let z = paths.iter().map(wave).sum::<Complex64>() + noise(rng) * variance.sqrt();
        samples.push(t as f64 * 0.01, z, *p, Vector3::zeros()).expect("finite samples");
    }
    samples
}

/// The job of the reference: two paths, 3 dB noise, a circle of `radius` that climbs by `height`.
pub fn job(n: usize, radius: f64, height: f64, seed: u64) -> Samples {
    let mut rng = Stream::of_seed(seed);
    let points: Vec<_> = (0..n)
        .map(|t| {
            let s = t as f64 / n as f64;
            // A little off the exact circle: positions as odometry gives them.
            let r = radius * (1.0 + 1e-3 * rng.between(-1.0, 1.0));
            Vector3::new(r * (TAU * s).cos(), r * (TAU * s).sin(), height * s)
        })
        .collect();
    samples(&points, &[(0.7, 0.15, 1.0), (2.2, 0.3, 0.6)], 0.5, &mut rng)
}

/// The naive double loop: one libm sine and cosine per direction and packet, over `count` directions from `from`.
pub fn naive(samples: &Samples, grid: &Grid, from: usize, count: usize) -> f64 {
    let k = TAU * f64::from(samples.path_gain()) / samples.wavelength_m();
    let mut sum = 0.0;
    for index in from..from + count {
        let (azimuth, elevation) = grid.at(index);
        let u = direction(azimuth, elevation);
        let mut f = Complex64::ZERO;
        for (z, p) in samples.z().iter().zip(samples.receiver_m()) {
            let (sin, cos) = (k * (u.x * p.x + u.y * p.y + u.z * p.z)).sin_cos();
            f += z * Complex64::new(cos, -sin);
        }
        sum += f.norm_sqr();
    }
    sum
}

/// Milliseconds of the naive loop for a whole grid: a short piece of it (a fifth of a million terms, a few milliseconds,
/// so that a shared machine has quiet moments for it), the quickest of `rounds`, scaled up.
pub fn naive_ms(samples: &Samples, grid: &Grid, rounds: usize) -> f64 {
    let (rows, columns) = grid.shape();
    let all = rows * columns;
    let count = (200_000 / samples.len()).clamp(1, all);
    let from = (all - count) / 2;
    let times = (0..rounds).map(|_| time(|| std::hint::black_box(naive(samples, grid, from, count))));
    times.fold(f64::INFINITY, f64::min) * all as f64 / count as f64
}

/// Milliseconds of one call, on the thread's own clock: what other work on the machine takes does not count.
pub fn time<R>(call: impl FnOnce() -> R) -> f64 {
    let start = clock();
    std::hint::black_box(call());
    (clock() - start) * 1e3
}

/// Seconds of this thread's processor time.
fn clock() -> f64 {
    use nix::time::{ClockId, clock_gettime};
    let now = clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).expect("Linux has this clock");
    now.tv_sec() as f64 + now.tv_nsec() as f64 * 1e-9
}

/// The quickest of many calls, milliseconds: at least 5 and then until `budget_ms` is spent.
pub fn quickest(budget_ms: f64, mut call: impl FnMut()) -> f64 {
    let (mut best, mut spent, mut rounds) = (f64::INFINITY, 0.0, 0);
    while rounds < 5 || (spent < budget_ms && rounds < 2_000) {
        let took = time(&mut call);
        best = best.min(took);
        spent += took;
        rounds += 1;
        if spent > 8.0 * budget_ms && rounds >= 2 {
            break;
        }
    }
    best
}

/// Where results go: `target/bench`, or the folder named by `CSI5300_BENCH_OUT`.
pub fn out(name: &str) -> PathBuf {
    let folder = std::env::var_os("CSI5300_BENCH_OUT")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../target/bench"), PathBuf::from);
    std::fs::create_dir_all(&folder).expect("a folder for the results");
    folder.join(name)
}

/// A table that is printed as it grows and written as CSV at the end.
pub struct Table {
    name: &'static str,
    csv: String,
    widths: Vec<usize>,
}

impl Table {
    pub fn new(name: &'static str, columns: &[(&str, usize)]) -> Self {
        println!("\n## {name}");
        let mut table = Self { name, csv: String::new(), widths: columns.iter().map(|c| c.1).collect() };
        table.row(&columns.iter().map(|c| c.0.to_string()).collect::<Vec<_>>());
        table
    }

    pub fn row(&mut self, cells: &[String]) {
        let line: Vec<_> = cells.iter().zip(&self.widths).map(|(c, w)| format!("{c:>w$}")).collect();
        println!("{}", line.join("  "));
        writeln!(self.csv, "{}", cells.join(",")).expect("a string takes it");
    }

    pub fn save(&self) {
        let path = out(&format!("{}.csv", self.name));
        std::fs::write(&path, &self.csv).expect("the results can be written");
        println!("written: {}", path.display());
    }
}

/// The machine and the build, for the head of a report.
pub fn banner(what: &str) {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpu.lines().find_map(|l| l.strip_prefix("model name")).unwrap_or(": unknown");
    println!("# {what}");
    println!("machine{model}, tiers {:?}", csi5300::bartlett::Tier::available());
    let args: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    println!("arguments {args:?}, load average at the start {}", load.split(' ').next().unwrap_or("unknown"));
    println!("one thread, its processor time; the quickest of many calls counts; release build");
}
