//! Standard deviations of a place: the Cramer-Rao bound of its coordinates from the geometry and the residual phases,
//! which on real captures are no white noise.

use super::fix::{Deviations, Source};
use super::types::Place;
use super::waves::Waves;
use crate::tuning::{DeviationTuning, TUNING};
use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};
use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// The step from `at` towards the least residual phase, to first order: azimuth, elevation, 1 / range.
pub(super) fn downhill<const K: usize>(waves: &Waves<'_, K>, at: &Place) -> Option<Vector3<f64>> {
    let step = waves.step([at.azimuth, at.elevation, at.curve])?;
    step.iter().all(|v| v.is_finite()).then_some(step)
}

/// Deviations about `at`. The residual phase of each row (all subcarriers, matched) has a variance and, multipath being
/// what it is, a correlation along the motion: the information of the geometry is divided by both.
/// Coordinates that are not `free` are known; the others have a prior, the deviation of a uniform guess within their
/// limits (elevation, 1/range).
pub(super) fn deviations<const K: usize>(waves: &Waves<'_, K>, at: &Source, prior: [f64; 2]) -> Deviations {
    let c = [at.azimuth_rad, at.elevation_rad(), at.inverse_range_per_m];
    let residual = waves.residual(c);
    let n = residual.len() as f64;
    let phase_variance = residual.iter().map(|e| e * e).sum::<f64>() / (n - 4.0).max(1.0);
    let correlated_rows = correlation_rows(&residual);
    let row_variance = (phase_variance * correlated_rows).max(1e-12);
    let priors = [PI / 3f64.sqrt(), prior[0], prior[1]];
    let gradients = waves.gradients(c);
    let covariance = covariance(&gradients, row_variance, priors, waves.free);
    let mut covariance =
        covariance.unwrap_or_else(|| Matrix3::from_diagonal(&priors.map(|prior| prior.powi(2)).into()));
    let first_order = covariance[(0, 0)].max(0.0).sqrt();
    let azimuth_rad = first_order.min(turn_rad(waves, c, row_variance, priors));
    if azimuth_rad < first_order {
        let shrink = Matrix3::from_diagonal(&Vector3::new(azimuth_rad / first_order, 1.0, 1.0));
        covariance = shrink * covariance * shrink;
    }
    Deviations {
        azimuth_rad,
        elevation_rad: covariance[(1, 1)].max(0.0).sqrt(),
        inverse_range_per_m: covariance[(2, 2)].max(0.0).sqrt(),
        covariance,
        phase_variance,
        correlated_rows,
    }
}

/// The covariance of azimuth, elevation and 1 / range where the phases go by them (and the trajectory's scale) as `gradients`
/// say, each with a variance of `row_variance`.
fn covariance(
    gradients: &[Vector4<f64>],
    row_variance: f64,
    priors: [f64; 3],
    free: [bool; 3],
) -> Option<Matrix3<f64>> {
    let mean = gradients.iter().sum::<Vector4<f64>>() / gradients.len() as f64;
    let scatter: Matrix4<f64> = gradients.iter().map(|g| (g - mean) * (g - mean).transpose()).sum();
    let whole = scatter / row_variance;
    // The scale of the trajectory is known to its prior only; what it may explain is no information about the place.
    let shared = whole.fixed_view::<3, 1>(0, 3).into_owned();
    let scale = whole[(3, 3)] + TUNING.deviations.scale_sd.powi(-2);
    let mut information = whole.fixed_view::<3, 3>(0, 0).into_owned() - shared * shared.transpose() / scale;
    for i in 0..3 {
        // What is known gets no variance: as good as infinite information.
        information[(i, i)] += if free[i] && priors[i] > 0.0 { priors[i].powi(-2) } else { 1e18 };
    }
    information.try_inverse()
}

/// By how much the azimuth may turn before the phases show it by their curvature, radians: about the direction of a straight
/// motion they do not change with the azimuth to first order. A turn of `e` changes them by their second derivative times
/// `e^2 / 2`, which is as well known as an azimuth by whose derivative they go is. That is of a plane wave: what the curvature
/// of the front adds tells a turn from another scale only where the range is known better than it is there.
fn turn_rad<const K: usize>(waves: &Waves<'_, K>, c: [f64; 3], row_variance: f64, priors: [f64; 3]) -> f64 {
    const STEP_RAD: f64 = 1e-3;
    let at = |by: f64| waves.gradients([c[0] + by, c[1], 0.0]);
    let gradients = at(0.0);
    let (before, after) = (at(-STEP_RAD), at(STEP_RAD));
    let bent = gradients.iter().zip(before.iter().zip(&after)).map(|(own, (before, after))| {
        let second = (after[0] - before[0]) / (2.0 * STEP_RAD);
        Vector4::new(second, own[1], own[2], own[3])
    });
    let covariance = covariance(&bent.collect::<Vec<_>>(), row_variance, priors, waves.free);
    covariance.map_or(f64::INFINITY, |covariance| (2.0 * covariance[(0, 0)].max(0.0).sqrt()).sqrt())
}

/// The deviation of the azimuth at `c` that noise of the variance of the residual phases leaves, radians: with the
/// trajectory as reported, and without anything known of the coordinates that are free.
pub(super) fn noise_rad<const K: usize>(waves: &Waves<'_, K>, c: [f64; 3]) -> f64 {
    let residual = waves.residual(c);
    let n = residual.len() as f64;
    let variance = residual.iter().map(|e| e * e).sum::<f64>() / (n - TUNING.deviations.fitted).max(1.0);
    let gradients = waves.gradients(c);
    let mean = gradients.iter().sum::<Vector4<f64>>() / n;
    let scatter: Matrix4<f64> = gradients.iter().map(|g| (g - mean) * (g - mean).transpose()).sum();
    let mut own = scatter.fixed_view::<3, 3>(0, 0).into_owned();
    for i in (0..3).filter(|i| !waves.free[*i]) {
        own[(i, i)] = 1.0;
    }
    let covariance = own.try_inverse().unwrap_or_else(|| Matrix3::repeat(f64::INFINITY));
    (variance * covariance[(0, 0)].max(0.0)).sqrt()
}

/// How many rows share an error: the residual's power density where a place shows (the first turns along the motion)
/// over its mean density. Reflections and bent trajectories leave slow errors, which white noise of the same variance
/// would not.
pub(super) fn correlation_rows(residual: &[f64]) -> f64 {
    let n = residual.len();
    let energy: f64 = residual.iter().map(|e| e * e).sum();
    let DeviationTuning { slow_turns, fitted, .. } = TUNING.deviations;
    if n < 4 * slow_turns || energy <= 0.0 {
        return 1.0;
    }
    let component = |turns: usize| {
        let step = Complex64::cis(TAU * turns as f64 / n as f64);
        let (mut sum, mut turn) = (Complex64::ZERO, Complex64::ONE);
        for e in residual {
            sum += turn * e;
            turn *= step;
        }
        sum.norm_sqr()
    };
    let slow: f64 = (1..=slow_turns).map(component).sum();
    // Each parameter that was fitted to the residual takes one of the `2 slow_turns` slow components away.
    let count = slow_turns as f64;
    let left = 1.0 - fitted / (2.0 * count);
    (slow / (count * left * energy)).max(0.5)
}
