//! Combines two posteriors of one direction: the azimuth has a uniform prior, so the log-likelihoods add.
//!
//! The heading error of their common path turns both alike, so it blurs their product once.

use super::Found;
use super::posterior::{Atom, Blur, Mode, mass_within, settle};
use crate::maths::wrap_rad;
use std::f64::consts::TAU;

/// Number of azimuths on the circle, and the number into which each is split where the product is not negligible.
const COARSE: usize = 720;
const SPLIT: usize = 20;
/// Log-likelihoods this far below the highest are negligible.
const NEGLIGIBLE: f64 = 12.0;
/// Directions with less than this share are dropped.
const LEAST_SHARE: f64 = 1e-3;
/// Least inverse distance assumed for a transmitter, 1/m.
const UNKNOWN_CURVE: f64 = 0.25;
/// A mode this near to a mirror of either side is a mirror, radians.
const NEAR_RAD: f64 = 0.26;

/// One posterior, with its blur but without the common heading error.
struct Side<'a> {
    found: &'a Found,
    blur: Blur,
}

impl<'a> Side<'a> {
    fn new(found: &'a Found, shared_rad: f64, parallax_rad: f64) -> Self {
        let own = (found.blur.heading_rad.powi(2) - shared_rad.powi(2)).max(0.0).sqrt().hypot(parallax_rad);
        Self { found, blur: Blur { heading_rad: own, ..found.blur } }
    }

    /// Probability density of a cell.
    fn density(&self, azimuth: f64, width: f64) -> f64 {
        mass_within(&self.found.modes, &self.blur, &[azimuth], 0.5 * width) / width
    }
}

/// Possible difference between the directions from two places, radians, by the nearest range within one deviation of `found`.
fn parallax_rad(found: &Found, apart_m: f64) -> f64 {
    let nearest = |mode: &Mode| mode.place.curve + mode.covariance[(2, 2)].max(0.0).sqrt();
    apart_m * found.modes.first().map_or(0.0, nearest).max(UNKNOWN_CURVE)
}

/// The combined direction. Elevations, ranges and places are those of `first`. `shared_rad` is the deviation of the common
/// path's heading; `apart_m` is the distance between the middles of the two motions, metres.
pub(crate) fn both(first: &Found, second: &Found, shared_rad: f64, apart_m: f64) -> Found {
    let sides = [Side::new(first, shared_rad, 0.0), Side::new(second, shared_rad, parallax_rad(first, apart_m))];
    let cell = |azimuth: f64, width: f64| -> (f64, Atom) {
        let log: f64 = sides.iter().map(|side| side.density(azimuth, width).ln()).sum();
        (log, Atom { azimuth: wrap_rad(azimuth), width, mass: 0.0 })
    };
    let width = TAU / COARSE as f64;
    let middle = |k: usize| (k as f64 + 0.5) * width;
    let coarse: Vec<f64> = (0..COARSE).map(|k| cell(middle(k), width).0).collect();
    let highest = coarse.iter().copied().fold(f64::MIN, f64::max);
    let cells = |k: usize| -> Vec<(f64, Atom)> {
        let split = if coarse[k] > highest - NEGLIGIBLE { SPLIT } else { 1 };
        let own = width / split as f64;
        (0..split).map(|j| cell(middle(k) - 0.5 * width + (j as f64 + 0.5) * own, own)).collect()
    };
    let fine: Vec<Vec<(f64, Atom)>> = (0..COARSE).map(cells).collect();
    let highest = fine.iter().flatten().map(|(log, _)| *log).fold(f64::MIN, f64::max);
    let mut modes: Vec<Mode> = segments(&coarse).into_iter().map(|own| mode(&own, &fine, highest, first)).collect();
    let total: f64 = modes.iter().map(|mode| mode.mass).sum();
    modes.retain(|mode| mode.mass >= LEAST_SHARE * total);
    settle(&mut modes);
    let mirrors =
        [first, second].map(|side| side.mirror.and_then(|k| side.modes.get(k)).map(|mode| mode.place.azimuth));
    let is_mirror = |mode: &Mode| mirrors.iter().flatten().any(|at| wrap_rad(mode.place.azimuth - at).abs() < NEAR_RAD);
    let mirror = modes.iter().skip(1).position(is_mirror).map(|k| k + 1);
    let bound_rad = (first.bound_rad.powi(-2) + second.bound_rad.powi(-2)).powf(-0.5);
    Found { modes, mirror, bound_rad, blur: Blur { heading_rad: shared_rad, model_rad: 0.0 }, ..first.clone() }
}

/// The cells around each local maximum, up to the adjacent minima.
fn segments(logs: &[f64]) -> Vec<Vec<usize>> {
    let count = logs.len();
    let lowest = (0..count).min_by(|a, b| logs[*a].total_cmp(&logs[*b])).unwrap_or(0);
    let mut all: Vec<Vec<usize>> = vec![Vec::new()];
    let mut falls = false;
    for step in 0..count {
        let (before, k) = ((lowest + step + count - 1) % count, (lowest + step) % count);
        let rises = logs[k] > logs[before];
        if rises && falls {
            all.push(Vec::new());
        }
        falls = if logs[k] == logs[before] { falls } else { !rises && step > 0 };
        all.iter_mut().last().into_iter().for_each(|own| own.push(k));
    }
    all
}

fn mode(own: &[usize], fine: &[Vec<(f64, Atom)>], highest: f64, first: &Found) -> Mode {
    let of = |(log, atom): &(f64, Atom)| Atom { mass: (log - highest).exp() * atom.width, ..*atom };
    let cells = || own.iter().flat_map(|k| &fine[*k]);
    let atoms: Vec<Atom> = cells().map(of).collect();
    let mass: f64 = atoms.iter().map(|atom| atom.mass).sum();
    let best = cells().max_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, atom)| atom.azimuth);
    // The mean about the best cell is not rounded to the grid.
    let near = || atoms.iter().filter(|atom| atom.mass > 0.0).map(|atom| (wrap_rad(atom.azimuth - best), atom));
    let mean = near().map(|(off, atom)| off * atom.mass).sum::<f64>() / mass.max(f64::MIN_POSITIVE);
    let square = near().map(|(off, atom)| ((off - mean).powi(2) + atom.width.powi(2) / 12.0) * atom.mass).sum::<f64>();
    let azimuth = wrap_rad(best + mean);
    // Elevation and range are those of the nearest mode of `first`.
    let off = |mode: &&Mode| wrap_rad(mode.place.azimuth - azimuth).abs();
    let nearest = first.modes.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
    let (mut place, mut covariance) = nearest.map_or_else(Default::default, |mode| (Some(mode.place), mode.covariance));
    if let Some(place) = &mut place {
        place.azimuth = azimuth;
    }
    covariance[(0, 0)] = square / mass.max(f64::MIN_POSITIVE);
    let nowhere = super::likelihood::Place { azimuth, elevation: 0.0, curve: 0.0 };
    Mode { place: place.unwrap_or(nowhere), covariance, mass, atoms }
}
