//! Coarse to fine: a grid as dense as the aperture asks for, then every high peak climbed.

use super::aperture::Aperture;
use super::field::{Cell, Layer, View, powers};
use super::uncertainty::{Deviations, deviations};
use crate::bartlett::{Tier, direction};
use crate::pose::wrap_rad;
use nalgebra::{Matrix3, Vector3};
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

/// A place from which the samples can be explained: a local maximum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Source {
    /// Azimuth from the middle of the motion, radians in (-pi, pi].
    pub azimuth_rad: f64,
    /// |elevation|, radians: planar motion cannot tell up from down.
    pub abs_elevation_rad: f64,
    /// 1 / range, 1/m; 0 is a plane wave.
    pub inverse_range_per_m: f64,
    /// Geometric mean of the views' normalised powers, 0..1.
    pub power: f64,
}

/// What [`search`] found.
#[derive(Clone, Debug, PartialEq)]
pub struct Fix {
    /// All sources found, falling in power; the first is the answer.
    pub sources: Vec<Source>,
    /// Where azimuth, elevation and range are measured from, metres.
    pub middle_m: Vector3<f64>,
    /// Azimuth of the highest peak of each view by itself, radians, in the order of the views.
    pub view_azimuths_rad: Vec<f64>,
    /// Power of the answer in each view, 0..1.
    pub view_powers: Vec<f64>,
    /// Predicted standard deviations.
    pub deviations: Deviations,
    /// True if range was searched: the aperture is large enough for the curvature to matter.
    pub range_searched: bool,
    /// True if elevation was searched.
    pub elevation_searched: bool,
    /// The shortest range that was searched, metres: an answer there is not one.
    pub range_min_m: f64,
    /// Places in which the field was evaluated.
    pub evaluations: usize,
}

impl Fix {
    /// The answer.
    #[must_use]
    pub fn best(&self) -> Source {
        self.sources[0]
    }

    /// How far the view furthest off would have put the azimuth, radians.
    #[must_use]
    pub fn view_spread_rad(&self) -> f64 {
        let azimuth = self.best().azimuth_rad;
        self.view_azimuths_rad.iter().map(|a| wrap_rad(a - azimuth).abs()).fold(0.0, f64::max)
    }

    /// Range to the answer and its standard deviation, metres, where the curvature fixes it to better than `share` of
    /// itself.
    #[must_use]
    pub fn range_m(&self, share: f64) -> Option<(f64, f64)> {
        let c = self.best().inverse_range_per_m;
        let relative = self.deviations.inverse_range_per_m / c;
        let inside = c > 0.0 && c * self.range_min_m < 0.98;
        (self.range_searched && inside && relative < share).then(|| (1.0 / c, relative / c))
    }

    /// Position of the answer in the frame of the displacements, and its covariance, metres; the sign of its height
    /// above the motion is taken as upwards.
    #[must_use]
    pub fn position(&self) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let best = self.best();
        let c = best.inverse_range_per_m;
        if !self.range_searched || c <= 0.0 {
            return None;
        }
        let (a, e, r) = (best.azimuth_rad, best.abs_elevation_rad, 1.0 / c);
        let u = direction(a, e);
        let by_azimuth = Vector3::new(-a.sin(), a.cos(), 0.0) * (r * e.cos());
        let by_elevation = Vector3::new(-a.cos() * e.sin(), -a.sin() * e.sin(), e.cos()) * r;
        let jacobian = Matrix3::from_columns(&[by_azimuth, by_elevation, u * (-r * r)]);
        Some((self.middle_m + u * r, jacobian * self.deviations.covariance * jacobian.transpose()))
    }
}

/// Phases at the rim of the aperture change by at most twice this from one cell to the next, radians: an edge of 1.2
/// costs a parabola-like beam a tenth of its height.
const RIM_RAD: f64 = 1.2;
/// Less curvature than this over the whole aperture, radians, is a plane wave.
const PLANE_RAD: f64 = 0.3;
/// Cells at most: beyond that (apertures of many metres) there is no search.
const MAX_CELLS: usize = 400_000;
/// Peaks that are climbed at most.
const CLIMBED: usize = 6;
/// Peaks below this share of the highest (in power, before climbing) are left alone.
const FLOOR: f64 = 0.3;
/// Rounds of a climb at most.
const ROUNDS: usize = 40;
/// The climb of the answer ends when its steps in azimuth are smaller than this, radians: a thousandth of a degree.
const FINE_RAD: f64 = 2e-5;
/// The climbs of all others end with a tenth of a degree.
const ROUGH_RAD: f64 = 2e-3;

struct Axes {
    azimuths: usize,
    elevations: Vec<f64>,
    curves: Vec<f64>,
}

struct Field {
    layers: Vec<Layer>,
    weights: Vec<f64>,
    limits: Limits,
    curve_max: f64,
    evaluations: usize,
}

/// A place in the coordinates of the search.
#[derive(Clone, Copy, Debug)]
struct Place {
    azimuth: f64,
    elevation: f64,
    curve: f64,
}

/// Searches the place that explains all `layers` (apertures of one motion, each in its views), as seen from `middle_m`
/// (usually the mean displacement of all samples).
///
/// `None` where there is nothing to search: no samples, or an aperture so large that the grid would not end.
#[must_use]
pub fn search(
    layers: &[(&Aperture, &[View])],
    middle_m: Vector3<f64>,
    wavelength_m: f64,
    limits: &Limits,
) -> Option<Fix> {
    let reference = layers.first()?.0;
    if layers.iter().any(|(aperture, _)| aperture.rows.is_empty()) {
        return None;
    }
    let rim = |aperture: &Aperture| aperture.displacement_m.iter().map(|p| (p - middle_m).norm()).fold(0.0, f64::max);
    let radius_m = layers.iter().map(|(aperture, _)| rim(aperture)).fold(0.0, f64::max);
    let gain = layers.iter().map(|(aperture, _)| aperture.path_gain).max()?;
    let curve_max = 1.0 / limits.range_min_m.max(1.2 * radius_m).max(1e-3);
    let axes = axes(radius_m, TAU * f64::from(gain) * radius_m / wavelength_m, curve_max, limits)?;
    let mut field = Field {
        layers: layers.iter().map(|(a, views)| Layer::new(a, &middle_m, wavelength_m, views)).collect(),
        weights: layers.iter().flat_map(|(_, views)| views.iter().map(|view| view.weight)).collect(),
        limits: *limits,
        curve_max,
        evaluations: 0,
    };
    let (peaks, view_azimuths_rad) = field.scan(&axes);
    let mut sources = field.climb_all(&peaks, &axes);
    sources.sort_by(|a, b| b.power.total_cmp(&a.power));
    let best = *sources.first()?;
    let place = Place { azimuth: best.azimuth_rad, elevation: best.abs_elevation_rad, curve: best.inverse_range_per_m };
    let view_powers = field.powers(&[place]).into_iter().map(f64::from).collect();
    let (range_searched, elevation_searched) = (axes.curves.len() > 1, axes.elevations.len() > 1);
    let free = [true, elevation_searched, range_searched];
    let prior = [limits.elevation_max_rad / 12f64.sqrt(), curve_max / 12f64.sqrt()];
    Some(Fix {
        deviations: deviations(reference, &middle_m, wavelength_m, &best, free, prior),
        sources,
        middle_m,
        view_azimuths_rad,
        view_powers,
        range_searched,
        elevation_searched,
        range_min_m: 1.0 / curve_max,
        evaluations: field.evaluations,
    })
}

/// How finely this aperture has to be searched: `order` is the phase at its rim, radians.
fn axes(radius_m: f64, order: f64, curve_max: f64, limits: &Limits) -> Option<Axes> {
    let azimuths = (TAU * order / (2.0 * RIM_RAD)).ceil().max(16.0);
    let steps = |change: f64| (change / (2.0 * RIM_RAD)).ceil().max(1.0);
    let lift = 1.0 - limits.elevation_max_rad.cos();
    let rings = if limits.elevation_max_rad > 0.0 { steps(order * lift) } else { 0.0 };
    // The quadratic term is order * radius / 2 * curve at the rim, half of that about its mean.
    let bend = order * radius_m / 2.0 * curve_max;
    let ranges = if bend < PLANE_RAD { 0.0 } else { steps(bend) };
    let cells = azimuths * (rings + 1.0) * (ranges + 1.0);
    if cells.is_nan() || cells > MAX_CELLS as f64 {
        return None;
    }
    let (rings, ranges) = (rings as usize, ranges as usize);
    Some(Axes {
        azimuths: azimuths as usize,
        elevations: (0..=rings).map(|i| (1.0 - lift * i as f64 / rings.max(1) as f64).acos()).collect(),
        curves: (0..=ranges).map(|i| curve_max * i as f64 / ranges.max(1) as f64).collect(),
    })
}

impl Field {
    fn cell(&self, place: &Place) -> Cell {
        // A known height ties elevation to range: sin(el) = height / range.
        let elevation = match self.limits.height_m {
            Some(height) => (height * place.curve).clamp(-1.0, 1.0).asin(),
            None => place.elevation,
        };
        let u = direction(place.azimuth, elevation);
        Cell { unit: [u.x as f32, u.y as f32, u.z as f32], inverse_range: place.curve as f32 }
    }

    fn powers(&mut self, places: &[Place]) -> Vec<f32> {
        let cells: Vec<Cell> = places.iter().map(|place| self.cell(place)).collect();
        self.evaluations += cells.len();
        powers(self.limits.tier.level_or_portable(), &self.layers, &cells)
    }

    /// `sum weight ln power` of each place.
    fn scores(&self, powers: &[f32]) -> Vec<f64> {
        let score =
            |own: &[f32]| own.iter().zip(&self.weights).map(|(p, w)| w * f64::from(p.max(1e-12)).ln()).sum::<f64>();
        powers.chunks(self.weights.len()).map(score).collect()
    }

    fn power(&self, score: f64) -> f64 {
        (score / self.weights.iter().sum::<f64>()).exp()
    }

    /// The grid: peaks over azimuth (best elevation and range of each), falling, and every view's own best azimuth.
    fn scan(&mut self, axes: &Axes) -> (Vec<(Place, f64)>, Vec<f64>) {
        let at = |i: usize| TAU * i as f64 / axes.azimuths as f64;
        let depth = axes.elevations.len() * axes.curves.len();
        let mut places = Vec::with_capacity(axes.azimuths * depth);
        for i in 0..axes.azimuths {
            for &elevation in &axes.elevations {
                places.extend(axes.curves.iter().map(|&curve| Place { azimuth: at(i), elevation, curve }));
            }
        }
        let powers = self.powers(&places);
        let views = self.weights.len();
        let best_of = |view: usize| {
            let own = powers.iter().skip(view).step_by(views).enumerate();
            own.max_by(|a, b| a.1.total_cmp(b.1)).map_or(0.0, |(index, _)| wrap_rad(places[index].azimuth))
        };
        let view_azimuths = (0..views).map(best_of).collect();
        let scores = self.scores(&powers);
        let ridge: Vec<(Place, f64)> = scores
            .chunks(depth)
            .enumerate()
            .map(|(i, own)| {
                let (k, score) = own.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).unwrap_or((0, &f64::MIN));
                (places[i * depth + k], *score)
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
    fn climb_all(&mut self, peaks: &[(Place, f64)], axes: &Axes) -> Vec<Source> {
        let total: f64 = self.weights.iter().sum();
        let step = TAU / axes.azimuths as f64;
        let high = |peak: &&(Place, f64)| ((peak.1 - peaks[0].1) / total).exp() >= FLOOR;
        let high: Vec<Place> = peaks.iter().take(CLIMBED).take_while(high).map(|peak| peak.0).collect();
        let mut tops: Vec<(Place, f64)> = high.into_iter().map(|place| self.climb(place, axes, ROUGH_RAD)).collect();
        tops.sort_by(|a, b| b.1.total_cmp(&a.1));
        if let Some(first) = tops.first_mut() {
            *first = self.climb(first.0, axes, FINE_RAD);
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

    /// Pattern search: the neighbours in all directions; the best of them is next, or the steps are halved.
    fn climb(&mut self, start: Place, axes: &Axes, fine_rad: f64) -> (Place, f64) {
        let spread = |free: bool| -> &[f64] { if free { &[0.0, -1.0, 1.0] } else { &[0.0] } };
        let (mut best, mut best_score) = (start, f64::MIN);
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
            let powers = self.powers(&places);
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
        }
    }
}
