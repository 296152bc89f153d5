//! Standard deviations of a place: the Cramer-Rao bound of its coordinates from the geometry and the residual phases,
//! which on real captures are no white noise.

use super::aperture::Aperture;
use super::fix::{Deviations, Source};
use super::types::{Free, Place};
use crate::bartlett::direction;
use crate::tuning::TUNING;
use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};
use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// Standard deviation of the scale of a trajectory: antennas are not where markers are, and the scale
/// of motion capture was found up to two per cent off the one that fits the phases best.
const SCALE_SD: f64 = TUNING.deviations.scale_sd;

/// `|rx - place| - range` for a row at `p` from the middle, metres.
fn excess_m(p: &Vector3<f64>, azimuth: f64, elevation: f64, curve: f64) -> f64 {
    let along = direction(azimuth, elevation).dot(p);
    let bend = curve * p.norm_squared() - 2.0 * along;
    bend / ((1.0 + curve * bend).max(0.0).sqrt() + 1.0)
}

/// Spherical waves over the rows of an aperture: azimuth, elevation and 1 / range are its coordinates.
struct Waves<'a> {
    aperture: &'a Aperture,
    /// Rows from the middle, metres.
    points: Vec<Vector3<f64>>,
    /// Radians per metre of way.
    kappa: f64,
    /// Which coordinates are not known.
    free: [bool; 3],
}

/// Steps of the numerical derivatives: radians, radians, 1/m.
const STEPS: [f64; 3] = [1e-5, 1e-4, 1e-5];

impl<'a> Waves<'a> {
    fn new(aperture: &'a Aperture, middle_m: &Vector3<f64>, wavelength_m: f64, free: Free) -> Self {
        let kappa = TAU * f64::from(aperture.path_gain) / wavelength_m;
        let points = aperture.displacement_m.iter().map(|p| p - middle_m).collect();
        Self { aperture, points, kappa, free: free.each() }
    }

    fn phase(&self, p: &Vector3<f64>, c: [f64; 3]) -> f64 {
        self.kappa * excess_m(p, c[0], c[1], c[2])
    }

    /// Each row's phase by the free coordinates.
    fn gradient(&self, p: &Vector3<f64>, c: [f64; 3]) -> Vector3<f64> {
        Vector3::from_fn(|i, _| {
            let (mut low, mut high) = (c, c);
            low[i] -= STEPS[i];
            high[i] += STEPS[i];
            if self.free[i] { (self.phase(p, high) - self.phase(p, low)) / (2.0 * STEPS[i]) } else { 0.0 }
        })
    }

    fn by_scale(&self, p: &Vector3<f64>, c: [f64; 3]) -> f64 {
        let scaled = |by: f64| self.phase(&(p * by), c);
        (scaled(1.0 + STEPS[0]) - scaled(1.0 - STEPS[0])) / (2.0 * STEPS[0])
    }

    fn residual(&self, c: [f64; 3]) -> Vec<f64> {
        residual_phases(self.aperture, self.points.iter().map(|p| self.phase(p, c)))
    }

    /// The step to where the residual phases are least, to first order (Gauss and Newton).
    fn step(&self, c: [f64; 3]) -> Option<Vector3<f64>> {
        let gradients: Vec<Vector3<f64>> = self.points.iter().map(|p| self.gradient(p, c)).collect();
        let mean = gradients.iter().sum::<Vector3<f64>>() / gradients.len() as f64;
        let (mut scatter, mut towards) = (Matrix3::zeros(), Vector3::zeros());
        for (gradient, e) in gradients.iter().zip(self.residual(c)) {
            let gradient = gradient - mean;
            scatter += gradient * gradient.transpose();
            towards -= gradient * e;
        }
        for i in (0..3).filter(|i| !self.free[*i]) {
            scatter[(i, i)] = 1.0;
        }
        Some(scatter.try_inverse()? * towards)
    }
}

/// Residuals that share an error over more rows than this are no white noise (which has 1, give or take 0.35).
const WHITE_ROWS: f64 = TUNING.deviations.white_rows;
/// The same for motion that distinguishes up from down.
const WHITE_ROWS_IN_SPACE: f64 = TUNING.deviations.white_rows_in_space;
/// Steps to the least residual; the first leaves the square of how far off the climb ended.
const POLISHES: usize = TUNING.deviations.polishes;
/// A polished answer further off than this, radians of azimuth (on the horizon), is another one.
const POLISH_RAD: f64 = TUNING.deviations.polish_rad;

/// The coordinates of least residual phase next to `at`, over all rows as one: the most likely ones if noise is all that a
/// single spherical wave leaves, which is when they are given. Where reflections leave more, no estimate of one place is
/// the most likely one, and what all views agreed on stays.
pub(super) fn polished(
    aperture: &Aperture,
    middle_m: &Vector3<f64>,
    wavelength_m: f64,
    at: &Source,
    free: Free,
) -> Option<Place> {
    let waves = Waves::new(aperture, middle_m, wavelength_m, free);
    let start = [at.azimuth_rad, at.elevation_rad(), at.inverse_range_per_m];
    let mut c = start;
    for _ in 0..POLISHES {
        let step = waves.step(c)?;
        c = std::array::from_fn(|i| c[i] + step[i]);
    }
    let narrow = if at.signed_elevation_rad.is_some() { start[1].cos() } else { 1.0 };
    let near = (c[0] - start[0]).abs() * narrow < POLISH_RAD && c.iter().all(|v| v.is_finite());
    let [azimuth, elevation, curve] = c;
    let white = if at.signed_elevation_rad.is_some() { WHITE_ROWS_IN_SPACE } else { WHITE_ROWS };
    (near && correlation_rows(&waves.residual(c)) <= white).then_some(Place { azimuth, elevation, curve })
}

/// The step from `at` towards the least residual phase, to first order: azimuth, elevation, 1 / range.
pub(super) fn downhill(
    aperture: &Aperture,
    middle_m: &Vector3<f64>,
    wavelength_m: f64,
    at: &Place,
    free: Free,
) -> Option<Vector3<f64>> {
    let step = Waves::new(aperture, middle_m, wavelength_m, free).step([at.azimuth, at.elevation, at.curve])?;
    step.iter().all(|v| v.is_finite()).then_some(step)
}

/// Deviations about `at`. The residual phase of each row (all subcarriers, matched) has a variance and, multipath being
/// what it is, a correlation along the motion: the information of the geometry is divided by both.
/// Coordinates that are not `free` are known; the others have a prior, the deviation of a uniform guess within their
/// limits (elevation, 1/range).
pub(super) fn deviations(
    aperture: &Aperture,
    middle_m: &Vector3<f64>,
    wavelength_m: f64,
    at: &Source,
    free: Free,
    prior: [f64; 2],
) -> Deviations {
    let waves = Waves::new(aperture, middle_m, wavelength_m, free);
    let c = [at.azimuth_rad, at.elevation_rad(), at.inverse_range_per_m];
    let residual = waves.residual(c);
    let n = residual.len() as f64;
    let phase_variance = residual.iter().map(|e| e * e).sum::<f64>() / (n - 4.0).max(1.0);
    let correlated_rows = correlation_rows(&residual);
    let gradients: Vec<Vector4<f64>> =
        waves.points.iter().map(|p| waves.gradient(p, c).push(waves.by_scale(p, c))).collect();
    let mean = gradients.iter().sum::<Vector4<f64>>() / n;
    let scatter: Matrix4<f64> = gradients.iter().map(|g| (g - mean) * (g - mean).transpose()).sum();
    let whole = scatter / (phase_variance * correlated_rows).max(1e-12);
    // The scale of the trajectory is known to its prior only; what it may explain is no information about the place.
    let shared = whole.fixed_view::<3, 1>(0, 3).into_owned();
    let scale = whole[(3, 3)] + SCALE_SD.powi(-2);
    let mut information = whole.fixed_view::<3, 3>(0, 0).into_owned() - shared * shared.transpose() / scale;
    let priors = [PI / 3f64.sqrt(), prior[0], prior[1]];
    for i in 0..3 {
        // What is known gets no variance: as good as infinite information.
        information[(i, i)] += if waves.free[i] && priors[i] > 0.0 { priors[i].powi(-2) } else { 1e18 };
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

/// Turns along the motion up to which an error is slow: a place shows in the first few of them.
const SLOW: usize = TUNING.deviations.slow_turns;
/// Parameters that were fitted to the residual, each taking one of the `2 SLOW` slow components away.
const FITTED: f64 = TUNING.deviations.fitted;

/// How many rows share an error: the residual's power density where a place shows (the first turns along the motion)
/// over its mean density. Reflections and bent trajectories leave slow errors, which white noise of the same variance
/// would not.
fn correlation_rows(residual: &[f64]) -> f64 {
    let n = residual.len();
    let energy: f64 = residual.iter().map(|e| e * e).sum();
    if n < 4 * SLOW || energy <= 0.0 {
        return 1.0;
    }
    let component = |turns: usize| {
        let wave = |(k, e): (usize, &f64)| Complex64::cis(TAU * (turns * k) as f64 / n as f64) * e;
        residual.iter().enumerate().map(wave).sum::<Complex64>().norm_sqr()
    };
    let slow: f64 = (1..=SLOW).map(component).sum();
    let (count, left) = (SLOW as f64, 1.0 - FITTED / (2.0 * SLOW as f64));
    (slow / (count * left * energy)).max(0.5)
}
