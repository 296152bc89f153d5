//! Coarse to fine: a grid as dense as the aperture asks for, then every high peak climbed.

use super::aperture::Aperture;
use super::field::{Cell, Layer, Look, View, powers};
use super::fix::{Fix, Source};
use super::focus::Warp;
use super::grid::{Axes, axes};
use super::prior;
use super::uncertainty::{deviations, polished};
use crate::bartlett::{Tier, direction};
use crate::maths::wrap_rad;
use fearless_simd::Level;
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// What is known of the scene beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest |elevation|, radians. 0 fixes the horizon.
    pub elevation_max_rad: f64,
    /// Shortest distance between transmitter and the middle of the motion, metres.
    pub range_min_m: f64,
    /// Where given, the transmitter's height above the receiver's antenna, metres: elevation and range are then one.
    pub height_m: Option<f64>,
    /// The SIMD tier to run on.
    pub tier: Tier,
}

/// Peaks that are climbed at most.
const CLIMBED: usize = 6;
/// Peaks below this share of the highest (in evidence, before climbing) are left alone.
const FLOOR: f64 = 0.3;
/// Rounds of a climb at most.
const ROUNDS: usize = 40;
/// The climb of the answer ends when its steps in azimuth are smaller than this, radians: a thousandth of a degree.
const FINE_RAD: f64 = 2e-5;
/// The climbs of all others end with a tenth of a degree.
const ROUGH_RAD: f64 = 2e-3;

/// A motion ready to be searched: its layers and the grid that they ask for.
#[derive(Clone, Debug)]
pub struct Search {
    pub(super) layers: Vec<Layer>,
    pub(super) axes: Axes,
    /// The grid that each layer asks for by itself.
    own_axes: Vec<Axes>,
    reference: Aperture,
    weights: Vec<f64>,
    /// Weights of the last climb, which places the answer: views of the channel centre alone choose, but do not place.
    placing: Vec<f64>,
    /// What averaging over elevations and ranges adds to the best `sum weight ln power` of each azimuth of the grid: never
    /// above 0.
    averaging: Vec<f64>,
    limits: Limits,
    middle_m: Vector3<f64>,
    wavelength_m: f64,
    curve_max: f64,
    evaluations: usize,
}

/// A place in the coordinates of the search.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub azimuth: f64,
    pub elevation: f64,
    pub curve: f64,
}

impl From<&Source> for Place {
    fn from(source: &Source) -> Self {
        let (azimuth, elevation) = (source.azimuth_rad, source.abs_elevation_rad);
        Self { azimuth, elevation, curve: source.inverse_range_per_m }
    }
}

/// Searches the place that explains all `layers`: see [`Search::new`] and [`Search::run`].
#[must_use]
pub fn search(
    layers: &[(&Aperture, &[View])],
    middle_m: Vector3<f64>,
    wavelength_m: f64,
    limits: &Limits,
) -> Option<Fix> {
    Search::new(layers, middle_m, wavelength_m, limits)?.run()
}

impl Search {
    /// Readies `layers` (apertures of one motion, each in its views; the first is the one that deviations are predicted
    /// from), as seen from `middle_m` (usually the mean displacement of all samples).
    ///
    /// `None` where there is nothing to search: no samples, or an aperture so large that the grid would not end.
    #[must_use]
    pub fn new(
        layers: &[(&Aperture, &[View])],
        middle_m: Vector3<f64>,
        wavelength_m: f64,
        limits: &Limits,
    ) -> Option<Self> {
        let reference = layers.first()?.0.clone();
        if layers.iter().any(|(aperture, _)| aperture.rows.is_empty()) {
            return None;
        }
        let rim =
            |aperture: &Aperture| aperture.displacement_m.iter().map(|p| (p - middle_m).norm()).fold(0.0, f64::max);
        let radius_m = layers.iter().map(|(aperture, _)| rim(aperture)).fold(0.0, f64::max);
        let gain = layers.iter().map(|(aperture, _)| aperture.path_gain).max()?;
        let curve_max = 1.0 / limits.range_min_m.max(1.2 * radius_m).max(1e-3);
        let views = || layers.iter().flat_map(|(_, views)| views.iter());
        let none_is_wide = !views().any(|view| view.subcarriers > 0);
        let places = |view: &View| view.subcarriers > 0 || none_is_wide;
        let axes_of = |gain: u8| axes(radius_m, TAU * f64::from(gain) * radius_m / wavelength_m, curve_max, limits);
        Some(Self {
            axes: axes_of(gain)?,
            own_axes: layers.iter().map(|(aperture, _)| axes_of(aperture.path_gain)).collect::<Option<_>>()?,
            layers: layers.iter().map(|(a, views)| Layer::new(a, &middle_m, wavelength_m, curve_max, views)).collect(),
            weights: views().map(|view| view.weight).collect(),
            placing: views().map(|view| if places(view) { view.weight } else { 0.0 }).collect(),
            averaging: Vec::new(),
            reference,
            limits: *limits,
            middle_m,
            wavelength_m,
            curve_max,
            evaluations: 0,
        })
    }

    /// Searches the whole grid, and climbs.
    #[must_use]
    pub fn run(&mut self) -> Option<Fix> {
        let (peaks, view_azimuths_rad) = self.scan();
        let mut sources = self.climb_all(&peaks);
        let free = [true, self.axes.elevations.len() > 1, self.axes.curves.len() > 1];
        let first = sources.first_mut()?;
        let is_likeliest = self.polish(first, free);
        let best = *first;
        let azimuth_rad = if is_likeliest { best.azimuth_rad } else { self.weighed_rad(&best, free) };
        let view_powers = self.powers(&[Place::from(&best)], Look::Exact).into_iter().map(f64::from).collect();
        let [_, elevation_searched, range_searched] = free;
        let prior = [self.limits.elevation_max_rad / 12f64.sqrt(), self.curve_max / 12f64.sqrt()];
        Some(Fix {
            deviations: deviations(&self.reference, &self.middle_m, self.wavelength_m, &best, free, prior),
            sources,
            azimuth_rad,
            middle_m: self.middle_m,
            view_azimuths_rad,
            view_powers,
            range_searched,
            elevation_searched,
            range_min_m: 1.0 / self.curve_max,
            elevation_max_rad: self.limits.elevation_max_rad,
            evaluations: self.evaluations,
        })
    }

    /// Moves the answer to the most likely place, where noise is all that it leaves; false where more is left, or where a
    /// known height leaves no choice.
    fn polish(&self, answer: &mut Source, free: [bool; 3]) -> bool {
        // A known height ties elevation to range: there is nothing to be had for either alone.
        if self.limits.height_m.is_some() && free[2] {
            return false;
        }
        let Some([azimuth, elevation, curve]) =
            polished(&self.reference, &self.middle_m, self.wavelength_m, answer, free)
        else {
            return false;
        };
        if (0.0..=self.limits.elevation_max_rad).contains(&elevation) && (0.0..=self.curve_max).contains(&curve) {
            answer.azimuth_rad = wrap_rad(azimuth);
            (answer.abs_elevation_rad, answer.inverse_range_per_m) = (elevation, curve);
        }
        true
    }

    /// The azimuth that is right on average over the elevations and ranges that an answer may have.
    fn weighed_rad(&mut self, answer: &Source, free: [bool; 3]) -> f64 {
        let cell_rad = TAU / self.axes.azimuths as f64;
        let around = prior::around(free);
        let place = |&(azimuth, elevation, curve): &(f64, Option<f64>, Option<f64>)| Place {
            azimuth: answer.azimuth_rad + azimuth * cell_rad,
            elevation: elevation.map_or(answer.abs_elevation_rad, |share| share * self.limits.elevation_max_rad),
            curve: curve.map_or(answer.inverse_range_per_m, |share| share * self.curve_max),
        };
        let places: Vec<Place> = around.iter().map(place).collect();
        let powers = self.powers(&places, Look::Exact);
        let scores = scores(&powers, &self.placing);
        let cells = prior::mean(&around, &scores, self.placing.iter().sum(), answer.power);
        wrap_rad(answer.azimuth_rad + cells * cell_rad)
    }

    /// Moves the samples as `warp` says, about the middle.
    pub(super) fn bend(&mut self, warp: &Warp) {
        self.layers.iter_mut().for_each(|layer| layer.bend(warp));
        let offsets = self.layers.first().map(Layer::offsets_m).unwrap_or_default();
        self.reference.displacement_m = offsets.into_iter().map(|p| p + self.middle_m).collect();
    }

    /// The highest score to be climbed to from `sources`: what a change of the trajectory is judged by, without another
    /// search.
    pub(super) fn score_near(&mut self, sources: &[Source]) -> f64 {
        let rough_rad = 0.05 * TAU / self.axes.azimuths as f64;
        sources.iter().map(|source| self.climb(Place::from(source), rough_rad, Look::Rough).1).fold(f64::MIN, f64::max)
    }

    pub(super) fn level(&self) -> Level {
        self.limits.tier.level_or_portable()
    }

    pub(super) fn cell(&self, place: &Place) -> Cell {
        // A known height ties elevation to range: sin(el) = height / range.
        let elevation = match self.limits.height_m {
            Some(height) => (height * place.curve).clamp(-1.0, 1.0).asin(),
            None => place.elevation,
        };
        let u = direction(place.azimuth, elevation);
        Cell { unit: [u.x as f32, u.y as f32, u.z as f32], inverse_range: place.curve as f32 }
    }

    fn powers(&mut self, places: &[Place], look: Look) -> Vec<f32> {
        let cells: Vec<Cell> = places.iter().map(|place| self.cell(place)).collect();
        self.evaluations += cells.len();
        powers(self.level(), &self.layers, &cells, look)
    }

    /// `sum weight ln power` of each place.
    fn scores(&self, powers: &[f32]) -> Vec<f64> {
        scores(powers, &self.weights)
    }

    /// The joint power of each place, 0..1.
    pub(super) fn joint_powers(&mut self, places: &[Place]) -> Vec<f64> {
        let powers = self.powers(places, Look::Exact);
        self.scores(&powers).into_iter().map(|score| self.power(score)).collect()
    }

    fn power(&self, score: f64) -> f64 {
        (score / self.weights.iter().sum::<f64>()).exp()
    }

    /// The grid: peaks of the evidence over azimuth (with the best elevation and range of each), falling, and every view's
    /// own best azimuth.
    fn scan(&mut self) -> (Vec<(Place, f64)>, Vec<f64>) {
        let places = self.axes.places();
        let depth = places.len() / self.axes.azimuths;
        let (mut scores, mut view_azimuths) = (vec![0.0; places.len()], Vec::new());
        let mut weights = self.weights.iter();
        for (layer, own) in self.layers.iter().zip(&self.own_axes) {
            // Each layer on the grid that it asks for: one-way waves are twice as long, and need an eighth of the places.
            let own_places = own.places();
            let cells: Vec<Cell> = own_places.iter().map(|place| self.cell(place)).collect();
            let powers = powers(self.level(), std::slice::from_ref(layer), &cells, Look::Rough);
            self.evaluations += cells.len();
            let views = layer.views();
            for (view, weight) in (0..views).zip(&mut weights) {
                let powers: Vec<f32> = powers.iter().skip(view).step_by(views).copied().collect();
                let best = powers.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
                view_azimuths.push(best.map_or(0.0, |(index, _)| wrap_rad(own_places[index].azimuth)));
                let powers = if *own == self.axes { powers } else { own.spread(&powers, &self.axes) };
                scores.iter_mut().zip(powers).for_each(|(s, p)| *s += weight * f64::from(p.max(1e-12).ln()));
            }
        }
        let (shares, weight) = (prior::shares(&self.axes), self.weights.iter().sum());
        self.averaging = scores.chunks(depth).map(|own| prior::averaging(own, &shares, weight)).collect();
        let ridge: Vec<(Place, f64)> = scores
            .chunks(depth)
            .zip(&self.averaging)
            .enumerate()
            .map(|(i, (own, averaging))| {
                let (k, score) = own.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).unwrap_or((0, &f64::MIN));
                (places[i * depth + k], score + averaging)
            })
            .collect();
        let n = ridge.len();
        let is_peak = |i: &usize| ridge[*i].1 >= ridge[(i + 1) % n].1 && ridge[*i].1 > ridge[(i + n - 1) % n].1;
        let mut peaks: Vec<(Place, f64)> = (0..n).filter(is_peak).map(|i| ridge[i]).collect();
        peaks.sort_by(|a, b| b.1.total_cmp(&a.1));
        if peaks.is_empty() {
            peaks.extend(ridge.first());
        }
        (peaks, view_azimuths)
    }

    /// Climbs the high peaks to see which is the highest, then that one to its top.
    fn climb_all(&mut self, peaks: &[(Place, f64)]) -> Vec<Source> {
        let total: f64 = self.weights.iter().sum();
        let step = TAU / self.axes.azimuths as f64;
        let high = |peak: &&(Place, f64)| ((peak.1 - peaks[0].1) / total).exp() >= FLOOR;
        let high: Vec<Place> = peaks.iter().take(CLIMBED).take_while(high).map(|peak| peak.0).collect();
        let mut tops: Vec<(Place, f64)> =
            high.into_iter().map(|place| self.climb(place, ROUGH_RAD, Look::Rough)).collect();
        // Rough looks led there; which is the highest is told exactly.
        let places: Vec<Place> = tops.iter().map(|top| top.0).collect();
        let powers = self.powers(&places, Look::Exact);
        tops.iter_mut().zip(self.scores(&powers)).for_each(|(top, score)| top.1 = score);
        tops.sort_by(|a, b| (b.1 + self.averaging_at(&b.0)).total_cmp(&(a.1 + self.averaging_at(&a.0))));
        if let Some(first) = tops.first_mut() {
            let weights = std::mem::replace(&mut self.weights, self.placing.clone());
            first.0 = self.climb(first.0, FINE_RAD, Look::Exact).0;
            self.weights = weights;
            let powers = self.powers(&[first.0], Look::Exact);
            first.1 = self.scores(&powers)[0];
        }
        let mut sources: Vec<Source> = Vec::new();
        for (place, score) in tops {
            let source = self.source(&place, score);
            let same = |other: &Source| wrap_rad(other.azimuth_rad - source.azimuth_rad).abs() < 2.0 * step;
            if !sources.iter().any(same) {
                sources.push(source);
            }
        }
        sources
    }

    /// What averaging over elevations and ranges adds to the score of a place: never above 0.
    fn averaging_at(&self, place: &Place) -> f64 {
        let n = self.axes.azimuths;
        let cell = (place.azimuth.rem_euclid(TAU) / TAU * n as f64).round() as usize % n;
        self.averaging.get(cell).copied().unwrap_or(0.0)
    }

    /// Pattern search: the neighbours in all directions; the best of them is next, or the steps are halved.
    fn climb(&mut self, start: Place, fine_rad: f64, look: Look) -> (Place, f64) {
        let spread = |free: bool| -> &[f64] { if free { &[0.0, -1.0, 1.0] } else { &[0.0] } };
        let (mut best, mut best_score) = (start, f64::MIN);
        let axes = self.axes.clone();
        let elevation_free = axes.elevations.len() > 1 && self.limits.height_m.is_none();
        let mut reach = [
            0.5 * TAU / axes.azimuths as f64,
            0.125 * self.limits.elevation_max_rad,
            0.5 * axes.curves.get(1).copied().unwrap_or(0.0),
        ];
        for _ in 0..ROUNDS {
            let mut places = Vec::with_capacity(27);
            for a in spread(true) {
                for e in spread(elevation_free) {
                    for c in spread(axes.curves.len() > 1) {
                        places.push(Place {
                            azimuth: best.azimuth + a * reach[0],
                            elevation: (best.elevation + e * reach[1]).clamp(0.0, self.limits.elevation_max_rad),
                            curve: (best.curve + c * reach[2]).clamp(0.0, self.curve_max),
                        });
                    }
                }
            }
            let powers = self.powers(&places, look);
            let scores = self.scores(&powers);
            // The first place is where the climb stands: only a better one moves it.
            let next =
                scores.iter().enumerate().fold((0, f64::MIN), |top, (k, s)| if *s > top.1 { (k, *s) } else { top });
            (best, best_score) = (places[next.0], next.1);
            if next.0 == 0 {
                reach = reach.map(|r| r * 0.5);
                if reach[0] < fine_rad {
                    break;
                }
            }
        }
        (best, best_score)
    }

    fn source(&self, place: &Place, score: f64) -> Source {
        let elevation = match self.limits.height_m {
            Some(height) => (height * place.curve).clamp(-1.0, 1.0).asin().abs(),
            None => place.elevation,
        };
        Source {
            azimuth_rad: wrap_rad(place.azimuth),
            abs_elevation_rad: elevation,
            inverse_range_per_m: place.curve,
            power: self.power(score).min(1.0),
            evidence: self.power(score + self.averaging_at(place)).min(1.0),
        }
    }
}

/// `sum weight ln power` of each place.
fn scores(powers: &[f32], weights: &[f64]) -> Vec<f64> {
    let score = |own: &[f32]| own.iter().zip(weights).map(|(p, w)| w * f64::from(p.max(1e-12)).ln()).sum::<f64>();
    powers.chunks(weights.len()).map(score).collect()
}
