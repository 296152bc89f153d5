//! Numerical stability: where single precision breaks, where double breaks, and whether the guarantee held.
//!
//! `cargo bench --bench stability`
#![allow(clippy::expect_used)]

mod common;

use std::f64::consts::TAU;

use common::*;
use csi5300::bartlett::{Error, Grid, Method, Planner, Precision, ProfileOptions, direction, oracle, search};
use csi5300::samples::Samples;
use nalgebra::Vector3;
use num_complex::Complex64;

fn main() {
    banner("Numerical stability");
    let mut table = Table::new(
        "stability",
        &[("case", 46), ("eps", 7), ("method", 20), ("error", 9), ("single", 9), ("double", 9), ("verdict", 26)],
    );
    for (name, samples) in cases() {
        for eps in [1e-4, 1e-10] {
            let row = judge(&samples, eps);
            table.row(&[vec![name.clone(), format!("{eps:.0e}")], row].concat());
        }
    }
    table.save();
    phases();
}

/// Error of F / (sum |z|)^2 over directions against the oracle: planned, forced single, forced double.
fn judge(samples: &Samples, eps: f64) -> Vec<String> {
    let grid = Grid::azimuth_elevation(24, 7);
    let mut planner = Planner::default();
    let options = ProfileOptions { eps, ..ProfileOptions::default() };
    let reference = match oracle(samples, WAVELENGTH_M, &grid) {
        Ok(reference) => reference.values,
        Err(error) => return vec!["-".into(), "-".into(), "-".into(), "-".into(), format!("error: {}", kind(error))],
    };
    let mut error = |options: &ProfileOptions| {
        let values = planner.profile(samples, WAVELENGTH_M, &grid, options).expect("a profile").values;
        let plan = planner.plan(samples, WAVELENGTH_M, &grid, options).expect("a plan");
        let worst = values.iter().zip(&reference).map(|(a, b)| (a.sqrt() - b.sqrt()).abs()).fold(0.0, f64::max);
        (worst, format!("{:?} {:?}", plan.explain().method, plan.explain().precision))
    };
    let (planned, method) = error(&options);
    let forced = |precision| ProfileOptions { eps: 1e-4, method: Some(Method::Direct), precision: Some(precision) };
    let (single, _) = error(&forced(Precision::Single));
    let (double, _) = error(&forced(Precision::Double));
    let verdict = if planned <= eps { "held" } else { "BROKEN" };
    vec![method, format!("{planned:.1e}"), format!("{single:.1e}"), format!("{double:.1e}"), verdict.into()]
}

fn kind(error: Error) -> String {
    format!("{error:?}").split([' ', '{']).next().unwrap_or_default().to_string()
}

fn changed(change: impl Fn(&mut Samples)) -> Samples {
    let mut samples = job(500, 0.3, 0.0, 5);
    change(&mut samples);
    samples
}

fn cases() -> Vec<(String, Samples)> {
    let mut cases = Vec::new();
    for offset in [0.0, 1e3, 1e6, 1e9] {
        let shift = Vector3::new(offset, -offset, 0.5 * offset);
        let moved = changed(|s| s.receiver_m.iter_mut().for_each(|p| *p += shift));
        cases.push((format!("coordinates offset by {offset:.0e} m"), moved));
    }
    for radius in [1.0, 10.0, 100.0, 1_000.0] {
        cases.push((format!("aperture of {radius} m"), job(500, radius, 0.0, 5)));
        cases.push((format!("helix of {radius} m"), job(500, radius, radius, 5)));
    }
    for scale in [1e-30, 1e-18, 1e18, 1e30, 1e-60, 1e60, 1e-300, 1e300, 5e-324] {
        let name = format!("samples times {scale:.0e}");
        cases.push((name, changed(|s| s.z.iter_mut().for_each(|z| *z = Complex64::new(z.re * scale, z.im * scale)))));
    }
    let mixed = changed(|s| s.z.iter_mut().enumerate().for_each(|(t, z)| *z *= if t % 2 == 0 { 1e-30 } else { 1e30 }));
    cases.push(("samples of 1e-30 and 1e30 mixed".into(), mixed));
    cases.push(("nearly a line (1 um wide)".into(), changed(|s| s.receiver_m.iter_mut().for_each(|p| p.y *= 3e-6))));
    cases.push(("nearly a plane (1 um high)".into(), {
        changed(|s| s.receiver_m.iter_mut().enumerate().for_each(|(t, p)| p.z = 1e-6 * (t as f64).sin()))
    }));
    cases.push(("a plane with 2 mm of wobble".into(), {
        changed(|s| s.receiver_m.iter_mut().enumerate().for_each(|(t, p)| p.z = 2e-3 * (t as f64).sin()))
    }));
    cases.push(("nearly static (1 um)".into(), changed(|s| s.receiver_m.iter_mut().for_each(|p| *p *= 3e-6))));
    cases.push(("static".into(), changed(|s| s.receiver_m.fill(Vector3::x()))));
    cases.push(("one packet".into(), job(1, 0.3, 0.0, 5)));
    cases.push(("all samples zero".into(), changed(|s| s.z.fill(Complex64::ZERO))));
    cases.push(("a NaN sample".into(), changed(|s| s.z[77].re = f64::NAN)));
    cases.push(("an infinite position".into(), changed(|s| s.receiver_m[77].y = f64::INFINITY)));
    cases.push(("1e6 packets".into(), job(1_000_000, 0.3, 0.0, 5)));
    cases
}

/// The paper's clock offset, 10 t + 1e4 sin(200 t) cycles, in both directions at one instant and 50 ns apart; and the
/// bearing that is left of it.
fn phases() {
    let mut table = Table::new("stability_cfo", &[("case", 46), ("coherence", 10), ("error_deg", 10), ("sd_deg", 8)]);
    for apart_s in [0.0, 5e-8, 1e-6] {
        let n = 1_000;
        let mut samples = Samples::new(2);
        let (sin, cos) = 0.7f64.sin_cos();
        let cycles = |t: f64| 10.0 * t + 1e4 * (200.0 * t).sin();
        for i in 0..n {
            let t = i as f64 * 0.01;
            let a = TAU * i as f64 / n as f64;
            let p = Vector3::new(0.3 * a.cos(), 0.3 * a.sin(), 0.0);
            let path = (cos * p.x + sin * p.y) / WAVELENGTH_M;
            let turn = |cycles: f64| Complex64::from_polar(1.0, TAU * (cycles - cycles.round()));
            let (forward, backward) = (turn(path + cycles(t)), turn(path - cycles(t + apart_s)));
            samples.push(t, forward * backward, p, Vector3::zeros());
        }
        let estimate = search(&samples, WAVELENGTH_M, &csi5300::bartlett::SearchOptions::default()).expect("a bearing");
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
