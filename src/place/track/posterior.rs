//! Directions, error bars and a place from the probabilities of places.

use super::grid::{AZIMUTHS, PlaceGrid, azimuth_rad, blur_around};
use crate::maths::UNIFORM_RAD;
use crate::maths::wrap_rad;
use crate::place::track::settings::RANGE_SHARE;
use nalgebra::{Matrix2, Vector2};
use std::f64::consts::TAU;

/// A direction is right within five degrees, as the probabilities of single bearings count it.
const WITHIN_RAD: f64 = 0.087_266_462_599_716_48;
/// Directions that an answer has at most, and the least share of one.
const MODES: usize = 5;
const LEAST_SHARE: f64 = 0.02;
/// Share of errors within an error bar.
const BAR: f64 = 0.68;

/// A direction in which the peer may be.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct TrackMode {
    /// Azimuth, radians in (-pi, pi], from +x towards +y in the trajectory's frame.
    pub azimuth_rad: f64,
    /// Probability that the peer is within five degrees of it.
    pub share: f64,
}

/// Where a peer is, from all evidence so far.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct TrackAnswer {
    /// Azimuth of the peer, radians in (-pi, pi], from +x towards +y in the trajectory's frame.
    pub azimuth_rad: f64,
    /// Error bar of the azimuth, radians: with the probability 0.68 the peer is within it; at most that of a uniform guess.
    pub azimuth_sd_rad: f64,
    /// Probability that the azimuth is within five degrees of the truth.
    pub probability: f64,
    /// The directions in which the peer may be, the likeliest first; the first is the answer's.
    pub modes: Vec<TrackMode>,
    /// The peer's place in the trajectory's frame and its covariance, metres, where evidence fixes its range.
    pub place_m: Option<(Vector2<f64>, Matrix2<f64>)>,
    /// Stretches of motion that it is made of.
    pub stretches: u32,
}

impl TrackAnswer {
    /// Read from a grid about the place that is asked from, its evidence taken to the power `exponent`; the heading of the whole
    /// trajectory has this deviation, radians. A range is that of all evidence, its variance divided by that power.
    pub(super) fn of(grid: &PlaceGrid, exponent: f64, heading_sd_rad: f64, stretches: u32) -> Self {
        let mut around = grid.tempered(exponent).around();
        blur_around(&mut around, heading_sd_rad * AZIMUTHS as f64 / TAU);
        let modes = modes(&around);
        let best = modes.first().copied().unwrap_or(TrackMode { azimuth_rad: 0.0, share: 0.0 });
        Self {
            azimuth_rad: best.azimuth_rad,
            azimuth_sd_rad: error_bar_rad(&around, best.azimuth_rad).min(UNIFORM_RAD),
            probability: best.share,
            place_m: place_m(grid, best.azimuth_rad)
                .map(|(place_m, covariance_m2)| (place_m, covariance_m2 / exponent)),
            modes,
            stretches,
        }
    }
}

/// The directions with the most probability within five degrees, none within ten degrees of a better one.
fn modes(around: &[f64]) -> Vec<TrackMode> {
    let half = (WITHIN_RAD / TAU * AZIMUTHS as f64).round() as usize;
    let mut shares = windows(around, half);
    let mut modes: Vec<TrackMode> = Vec::new();
    while modes.len() < MODES {
        let highest = shares.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((cell, share)) = highest.filter(|(_, share)| modes.is_empty() || *share >= LEAST_SHARE) else { break };
        modes.push(TrackMode { azimuth_rad: centre_rad(around, cell, half), share: share.min(1.0) });
        for step in 0..=4 * half {
            shares[(cell + AZIMUTHS + step - 2 * half) % AZIMUTHS] = f64::MIN;
        }
    }
    modes
}

/// The sum of each value and of `half` on either side of it, around the circle.
fn windows(values: &[f64], half: usize) -> Vec<f64> {
    let count = values.len();
    let sum = |k: usize| (0..=2 * half).map(|i| values[(k + count + i - half) % count]).sum();
    (0..count).map(sum).collect()
}

/// The mean azimuth about a cell, radians.
fn centre_rad(around: &[f64], cell: usize, half: usize) -> f64 {
    let count = around.len();
    let near = (0..=2 * half).map(|i| (i as f64 - half as f64, around[(cell + count + i - half) % count]));
    let (moment, total) = near.fold((0.0, 0.0), |(moment, total), (off, p)| (moment + off * p, total + p));
    let off = if total > 0.0 { moment / total } else { 0.0 };
    wrap_rad(azimuth_rad(cell) + off * TAU / AZIMUTHS as f64)
}

/// The half width about `azimuth_rad` that holds [`BAR`] of the probability, radians.
fn error_bar_rad(around: &[f64], azimuth_rad: f64) -> f64 {
    let step_rad = TAU / AZIMUTHS as f64;
    let mut off: Vec<(f64, f64)> = around
        .iter()
        .enumerate()
        .map(|(cell, p)| (wrap_rad(self::azimuth_rad(cell) - azimuth_rad).abs(), *p))
        .collect();
    off.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut sum = 0.0;
    let reached = off.iter().find(|(_, p)| {
        sum += p;
        sum >= BAR
    });
    reached.map_or(UNIFORM_RAD, |(off, _)| off.max(0.5 * step_rad))
}

/// Place and covariance about an azimuth, where the range there is known well enough.
fn place_m(grid: &PlaceGrid, azimuth_rad: f64) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let off = |cell: usize| wrap_rad(self::azimuth_rad(cell) - azimuth_rad);
    let along = grid.along(|cell| off(cell).abs() <= 2.0 * WITHIN_RAD);
    let total: f64 = along.iter().map(|(_, p)| p).sum();
    if total <= 0.0 {
        return None;
    }
    let mean = along.iter().map(|(ln, p)| ln * p).sum::<f64>() / total;
    let variance = along.iter().map(|(ln, p)| (ln - mean).powi(2) * p).sum::<f64>() / total;
    if variance.sqrt() > RANGE_SHARE {
        return None;
    }
    let near = || grid.around().into_iter().enumerate().filter(|(cell, _)| off(*cell).abs() <= 2.0 * WITHIN_RAD);
    let spread = near().map(|(cell, p)| off(cell).powi(2) * p).sum::<f64>() / near().map(|(_, p)| p).sum::<f64>();
    let range_m = mean.exp();
    let (sin, cos) = azimuth_rad.sin_cos();
    let (radial, across) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
    let covariance =
        (radial * radial.transpose() * variance + across * across.transpose() * spread) * (range_m * range_m);
    Some((grid.middle_m + radial * range_m, covariance))
}
