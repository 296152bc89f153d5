//! How far a place is known: the Cramer-Rao bound of its coordinates from the geometry and from the phases that are
//! left, which on real captures are no white noise.

use super::aperture::Aperture;
use super::fix::Source;
use crate::bartlett::direction;
use nalgebra::{Matrix3, Vector3};
use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// Standard deviations of a place's coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviations {
    /// Azimuth, radians.
    pub azimuth_rad: f64,
    /// |elevation|, radians.
    pub elevation_rad: f64,
    /// 1 / range, 1/m.
    pub inverse_range_per_m: f64,
    /// Covariance of (azimuth, elevation, 1 / range).
    pub covariance: Matrix3<f64>,
    /// Variance of the residual phase of one row, radians squared.
    pub phase_variance: f64,
    /// Rows that share one independent error: 1 for white noise.
    pub correlated_rows: f64,
}

/// `|rx - place| - range` for a row at `p` from the middle, metres.
fn excess_m(p: &Vector3<f64>, azimuth: f64, elevation: f64, curve: f64) -> f64 {
    let along = direction(azimuth, elevation).dot(p);
    let bend = curve * p.norm_squared() - 2.0 * along;
    bend / ((1.0 + curve * bend).max(0.0).sqrt() + 1.0)
}

/// Deviations about `at`. The residual phase of each row (all subcarriers, matched) has a variance and, multipath being
/// what it is, a correlation along the motion: the information of the geometry is divided by both.
/// Coordinates that are not `free` are known; the others have a prior, the deviation of a uniform guess within their
/// limits (elevation, 1/range).
pub(crate) fn deviations(
    aperture: &Aperture,
    middle_m: &Vector3<f64>,
    wavelength_m: f64,
    at: &Source,
    free: [bool; 3],
    prior: [f64; 2],
) -> Deviations {
    let kappa = TAU * f64::from(aperture.path_gain) / wavelength_m;
    let points: Vec<Vector3<f64>> = aperture.displacement_m.iter().map(|p| p - middle_m).collect();
    let coordinates = [at.azimuth_rad, at.abs_elevation_rad, at.inverse_range_per_m];
    let phase = |p: &Vector3<f64>, c: [f64; 3]| kappa * excess_m(p, c[0], c[1], c[2]);
    let residual = residual_phases(aperture, points.iter().map(|p| phase(p, coordinates)));
    let n = points.len() as f64;
    let phase_variance = residual.iter().map(|e| e * e).sum::<f64>() / (n - 4.0).max(1.0);
    let correlated_rows = correlation_rows(&residual);
    let steps = [1e-5, 1e-4, 1e-5];
    let gradient = |p: &Vector3<f64>| {
        Vector3::from_fn(|i, _| {
            let (mut low, mut high) = (coordinates, coordinates);
            low[i] -= steps[i];
            high[i] += steps[i];
            if free[i] { (phase(p, high) - phase(p, low)) / (2.0 * steps[i]) } else { 0.0 }
        })
    };
    let gradients: Vec<Vector3<f64>> = points.iter().map(gradient).collect();
    let mean = gradients.iter().sum::<Vector3<f64>>() / n;
    let scatter: Matrix3<f64> = gradients.iter().map(|g| (g - mean) * (g - mean).transpose()).sum();
    let mut information = scatter / (phase_variance * correlated_rows).max(1e-12);
    let priors = [PI / 3f64.sqrt(), prior[0], prior[1]];
    for i in 0..3 {
        // What is known gets no variance: as good as infinite information.
        information[(i, i)] += if free[i] && priors[i] > 0.0 { priors[i].powi(-2) } else { 1e18 };
    }
    let covariance = information.try_inverse().unwrap_or_else(|| Matrix3::from_diagonal(&priors.map(|p| p * p).into()));
    Deviations {
        azimuth_rad: covariance[(0, 0)].max(0.0).sqrt(),
        elevation_rad: covariance[(1, 1)].max(0.0).sqrt(),
        inverse_range_per_m: covariance[(2, 2)].max(0.0).sqrt(),
        covariance,
        phase_variance,
        correlated_rows,
    }
}

/// What the place leaves of each row's phase: rows are turned back, matched over the subcarriers with their mean, and
/// the quadrature part against the mean is taken (the part that a wrong place would explain).
fn residual_phases(aperture: &Aperture, phases: impl Iterator<Item = f64>) -> Vec<f64> {
    let turned: Vec<Vec<Complex64>> = aperture
        .rows
        .iter()
        .zip(phases)
        .map(|(row, phase)| {
            let back = Complex64::cis(phase);
            row.iter().map(|v| Complex64::new(f64::from(v.re), f64::from(v.im)) * back).collect()
        })
        .collect();
    let columns = turned.first().map_or(0, Vec::len);
    let mut mean = vec![Complex64::default(); columns];
    for row in &turned {
        mean.iter_mut().zip(row).for_each(|(m, v)| *m += v);
    }
    let matched: Vec<Complex64> =
        turned.iter().map(|row| row.iter().zip(&mean).map(|(v, m)| v * m.conj()).sum()).collect();
    let level = matched.iter().map(|m| m.re).sum::<f64>() / matched.len().max(1) as f64;
    matched.iter().map(|m| if level > 0.0 { m.im / level } else { 0.0 }).collect()
}

/// The integrated autocorrelation, up to where it first falls below zero: how many rows share an error.
fn correlation_rows(residual: &[f64]) -> f64 {
    let energy: f64 = residual.iter().map(|e| e * e).sum();
    let mut rows = 1.0;
    for lag in 1..residual.len() / 4 {
        let r = residual.iter().zip(&residual[lag..]).map(|(a, b)| a * b).sum::<f64>() / energy.max(f64::MIN_POSITIVE);
        if r <= 2.0 / (residual.len() as f64).sqrt() {
            break;
        }
        rows += 2.0 * r;
    }
    rows
}
