//! Numerical stability: where single precision breaks, where double breaks, and whether the guarantee held.
//!
//! `cargo bench --bench stability`
#![allow(clippy::expect_used)]

mod common;
#[path = "common/picture.rs"]
mod picture;

use std::f64::consts::TAU;

use common::*;
use csi5300::bartlett::{Error, Grid, direction, search};
use csi5300::internal::{Method, Planner, Precision, ProfileOptions, oracle};
use csi5300::signal::samples::Samples;
use nalgebra::Vector3;
use num_complex::Complex64;
use picture::*;

fn main() {
    banner("Numerical stability");
    let mut table = Table::new(
        "stability",
        &[("case", 46), ("eps", 7), ("method", 20), ("error", 9), ("single", 9), ("double", 9), ("verdict", 26)],
    );
    for (name, make) in cases() {
        for row in judge(make()) {
            table.row(&[vec![name.clone()], row].concat());
        }
    }
    table.save();
    phases();
    breaking();
}

/// Where each precision breaks: its error over the aperture, packets few enough that nothing averages out.
fn breaking() {
    let radii = [0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1_000.0];
    let mut table =
        Table::new("stability_aperture", &[("radius_m", 8), ("single", 9), ("double", 9), ("planned_1e-4", 12)]);
    let mut lines: [Vec<(f64, f64)>; 3] = Default::default();
    for radius in radii {
        let samples = job(20, radius, 0.3 * radius, 5);
        let grid = Grid::azimuth_elevation(72, 19);
        let reference = oracle(&samples, &grid).expect("a profile").values;
        let forced = |precision| ProfileOptions { eps: 1e-4, method: Some(Method::Direct), precision: Some(precision) };
        let ways = [forced(Precision::Single), forced(Precision::Double), ProfileOptions::default()];
        let errors = ways.map(|options| worst(&samples, &grid, &options, &reference));
        table.row(&[vec![radius.to_string()], errors.map(|e| format!("{e:.1e}")).into()].concat());
        lines.iter_mut().zip(errors).for_each(|(line, e)| line.push((radius, 1e6 * e.max(1e-16))));
    }
    table.save();
    let labels = ["direct, single", "direct, double", "the planner's choice at 1e-4"];
    let series: Vec<_> = labels.into_iter().zip(lines).map(|(l, points)| Series { label: l.into(), points }).collect();
    picture(
        "stability",
        "Error of a profile over the aperture, 20 packets",
        "radius, m",
        "largest error, millionths",
        &series,
    );
}

/// Largest difference of `|f| / sum |z|` from the reference.
fn worst(samples: &Samples, grid: &Grid, options: &ProfileOptions, reference: &[f64]) -> f64 {
    let values = Planner::default().profile(samples, grid, options).expect("a profile").values;
    values.iter().zip(reference).map(|(a, b)| (a.sqrt() - b.sqrt()).abs()).fold(0.0, f64::max)
}

/// Error of `|f| / sum |z|` over directions against the oracle, for both tolerances: planned, forced single, forced double.
fn judge(made: Result<Samples, Error>) -> Vec<Vec<String>> {
    let many = made.as_ref().is_ok_and(|samples| samples.len() > 2_000_000);
    let grid = if many { Grid::azimuth_elevation(8, 3) } else { Grid::azimuth_elevation(24, 7) };
    let (samples, reference) = match made.and_then(|samples| oracle(&samples, &grid).map(|exact| (samples, exact))) {
        Ok((samples, exact)) => (samples, exact.values),
        Err(error) => {
            let none = || String::from("-");
            return vec![vec![none(), none(), none(), none(), none(), format!("error: {}", kind(error))]];
        }
    };
    let forced = |precision| ProfileOptions { eps: 1e-4, method: Some(Method::Direct), precision: Some(precision) };
    let [single, double] =
        [Precision::Single, Precision::Double].map(|p| worst(&samples, &grid, &forced(p), &reference));
    let row = |eps: f64| {
        let options = ProfileOptions { eps, ..ProfileOptions::default() };
        let planned = worst(&samples, &grid, &options, &reference);
        let plan = Planner::default().explain(&samples, &grid, &options).expect("a plan");
        let method = format!("{:?} {:?}", plan.method, plan.precision);
        let verdict = if planned <= eps { "held" } else { "BROKEN" };
        let errors = [planned, single, double].map(|e| format!("{e:.1e}"));
        [vec![format!("{eps:.0e}"), method], errors.into(), vec![verdict.into()]].concat()
    };
    [1e-4, 1e-10].map(row).into()
}

fn kind(error: Error) -> String {
    let name = match error {
        Error::Samples(error) => format!("{error:?}"),
        error => format!("{error:?}"),
    };
    name.split([' ', '{']).next().unwrap_or_default().to_string()
}

/// The columns of a scene, to be changed before they are made samples.
struct Columns {
    z: Vec<Complex64>,
    receiver_m: Vec<Vector3<f64>>,
}

/// The circle of every case, changed.
fn changed(change: impl Fn(&mut Columns)) -> Result<Samples, Error> {
    let circle = job(500, 0.3, 0.0, 5);
    let mut columns = Columns { z: circle.z().to_vec(), receiver_m: circle.receiver_m().to_vec() };
    change(&mut columns);
    let mut samples = Samples::new(WAVELENGTH_M, 2)?;
    for ((t_s, z), p) in circle.t_s().iter().zip(columns.z).zip(columns.receiver_m) {
        samples.push(*t_s, z, p, Vector3::zeros())?;
    }
    Ok(samples)
}

/// A name, and what makes the scene (ten million packets are better made one after the other).
type Case = (String, Box<dyn Fn() -> Result<Samples, Error>>);

fn cases() -> Vec<Case> {
    let mut cases: Vec<Case> = Vec::new();
    let mut add = |name: String, make: Box<dyn Fn() -> Result<Samples, Error>>| cases.push((name, make));
    for offset in [0.0, 1e3, 1e6, 1e9] {
        let shift = Vector3::new(offset, -offset, 0.5 * offset);
        let make = move || changed(|s| s.receiver_m.iter_mut().for_each(|p| *p += shift));
        add(format!("coordinates offset by {offset:.0e} m"), Box::new(make));
    }
    for radius in [1.0, 10.0, 100.0, 1_000.0] {
        add(format!("aperture of {radius} m"), Box::new(move || Ok(job(500, radius, 0.0, 5))));
        add(format!("helix of {radius} m"), Box::new(move || Ok(job(500, radius, radius, 5))));
    }
    for scale in [1e-30, 1e-18, 1e18, 1e30, 1e-60, 1e60, 1e-300, 1e300, 5e-324] {
        let times = move |z: &mut Complex64| *z = Complex64::new(z.re * scale, z.im * scale);
        let make = move || changed(|s| s.z.iter_mut().for_each(times));
        add(format!("samples times {scale:.0e}"), Box::new(make));
    }
    for (name, change) in shapes() {
        add(name.into(), Box::new(move || changed(change)));
    }
    for n in [1, 1_000_000, 10_000_000] {
        add(format!("{n} packets"), Box::new(move || Ok(job(n, 0.3, 0.0, 5))));
    }
    cases
}

/// A name, and what is done to a circle.
type Shaped = (&'static str, fn(&mut Columns));

/// Ill-conditioned motion, and input that has no answer.
fn shapes() -> [Shaped; 11] {
    fn moved(s: &mut Columns, to: impl Fn(usize, &mut Vector3<f64>)) {
        s.receiver_m.iter_mut().enumerate().for_each(|(t, p)| to(t, p));
    }
    [
        ("samples of 1e-30 and 1e30 mixed", |s| {
            s.z.iter_mut().enumerate().for_each(|(t, z)| *z *= if t % 2 == 0 { 1e-30 } else { 1e30 });
        }),
        ("a line", |s| moved(s, |_, p| p.y = 0.0)),
        ("nearly a line (1 um wide)", |s| moved(s, |_, p| p.y *= 3e-6)),
        ("nearly a plane (1 um high)", |s| moved(s, |t, p| p.z = 1e-6 * (t as f64).sin())),
        ("a plane with 2 mm of wobble", |s| moved(s, |t, p| p.z = 2e-3 * (t as f64).sin())),
        ("nearly static (1 um)", |s| moved(s, |_, p| *p *= 3e-6)),
        ("static", |s| s.receiver_m.fill(Vector3::x())),
        ("half of the time static", |s| s.receiver_m[..250].fill(Vector3::x() * 0.3)),
        ("all samples zero", |s| s.z.fill(Complex64::ZERO)),
        ("a NaN sample", |s| s.z[77].re = f64::NAN),
        ("an infinite position", |s| s.receiver_m[77].y = f64::INFINITY),
    ]
}

/// The clock offset of \[paper\] (docs/reference/references.md), 10 t + 1e4 sin(200 t) cycles, in both directions at one instant and 50 ns apart; and the
/// bearing that is left of it.
fn phases() {
    let mut table = Table::new("stability_cfo", &[("case", 46), ("coherence", 10), ("error_deg", 10), ("sd_deg", 8)]);
    for apart_s in [0.0, 5e-8, 1e-6] {
        let n = 1_000;
        let mut samples = Samples::new(WAVELENGTH_M, 2).expect("a wavelength");
        let (sin, cos) = 0.7f64.sin_cos();
        let cycles = |t: f64| 10.0 * t + 1e4 * (200.0 * t).sin();
        for i in 0..n {
            let t = i as f64 * 0.01;
            let a = TAU * i as f64 / n as f64;
            let p = Vector3::new(0.3 * a.cos(), 0.3 * a.sin(), 0.0);
            let path = (cos * p.x + sin * p.y) / WAVELENGTH_M;
            let turn = |cycles: f64| Complex64::from_polar(1.0, TAU * (cycles - cycles.round()));
            let (forward, backward) = (turn(path + cycles(t)), turn(path - cycles(t + apart_s)));
            samples.push(t, forward * backward, p, Vector3::zeros()).expect("finite samples");
        }
        let estimate = search(&samples, &csi5300::bartlett::SearchOptions::default()).expect("a bearing");
        table.row(&[
            format!("CFO 10 t + 1e4 sin(200 t) cycles, {apart_s:.0e} s apart"),
            format!("{:.9}", estimate.coherence),
            format!("{:.1e}", (estimate.azimuth_rad - 0.7).to_degrees()),
            format!("{:.1e}", estimate.azimuth_sd_rad.to_degrees()),
        ]);
    }
    table.save();
    let exact = direction(0.7, 0.0);
    assert!((exact.norm() - 1.0).abs() < 1e-15);
}
