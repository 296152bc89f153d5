//! Coarse to fine: a grid as dense as the aperture asks for, then every high peak climbed.

use super::aperture::Aperture;
use super::fix::{Fix, Source};
use super::grid::{Axes, Extent, axes, curve_max};
use super::kernel::powers;
use super::likeliest::polished;
use super::prepared::PreparedAperture;
use super::prior;
use super::types::{Band, Elevations, Free, Limits, Place, Precision, View, Warp};
use super::uncertainty::{deviations, downhill};
use super::waves::Waves;
use crate::maths::wrap_rad;
use crate::signal::channel::SUBCARRIERS;
use fearless_simd::Level;
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Steps along a ridge at most, and the shares of each that are tried.
const RIDGE_STEPS: usize = 20;
const RIDGE_SHARES: [f64; 6] = [2.0, 1.0, 0.5, 0.2, 0.05, 0.01];

/// A motion ready to be searched: its apertures and the grid that they ask for.
#[derive(Clone, Debug)]
pub struct Search {
    pub(super) apertures: Vec<PreparedAperture>,
    pub(super) axes: Axes,
    /// The grid that each aperture asks for by itself.
    pub(super) own_axes: Vec<Axes>,
    /// What deviations are predicted from: the first aperture.
    reference: Aperture,
    pub(super) weights: Weights,
    /// What averaging over elevations and ranges adds to the best score of each azimuth of the grid: never above 0.
    pub(super) averaging: Vec<f64>,
    pub(super) limits: Limits,
    middle_m: Vector3<f64>,
    wavelength_m: f64,
    pub(super) curve_max: f64,
    pub(super) evaluations: usize,
}

/// Exponents of the views in the joint power, in their order.
#[derive(Clone, Debug)]
pub(super) struct Weights {
    /// For the choice between peaks.
    pub choosing: Vec<f64>,
    /// For where the top of a peak is: views of the channel centre alone have none, unless there are no others.
    pub placing: Vec<f64>,
}

impl Weights {
    fn of(views: &[View]) -> Self {
        let none_is_wide = views.iter().all(|view| view.band == Band::Centre);
        let places = |view: &View| none_is_wide || view.band != Band::Centre;
        Self {
            choosing: views.iter().map(|view| view.weight).collect(),
            placing: views.iter().map(|view| if places(view) { view.weight } else { 0.0 }).collect(),
        }
    }
}

/// Searches the place that explains all `layers`: see [`Search::new`] and [`Search::run`].
#[cfg(test)]
pub(super) fn search(
    layers: &[(&Aperture, &[View])],
    middle_m: Vector3<f64>,
    wavelength_m: f64,
    limits: &Limits,
) -> Option<Fix> {
    Search::new(layers, middle_m, wavelength_m, limits)?.run()
}

impl Search {
    /// Readies `layers` (apertures of one motion, each with its views; the first is the one that deviations are predicted
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
        if layers.iter().any(|(aperture, _)| aperture.displacement_m.is_empty()) {
            return None;
        }
        let rim =
            |aperture: &Aperture| aperture.displacement_m.iter().map(|p| (p - middle_m).norm()).fold(0.0, f64::max);
        let radius_m = layers.iter().map(|(aperture, _)| rim(aperture)).fold(0.0, f64::max);
        let gain = layers.iter().map(|(aperture, _)| aperture.path_gain).max()?;
        let curve_max = curve_max(radius_m, limits);
        let views: Vec<View> = layers.iter().flat_map(|(_, views)| views.iter().copied()).collect();
        let extent = Extent { radius_m, height_share: height_share(layers, &middle_m, radius_m) };
        let axes_of = |gain: u8| axes(extent, TAU * f64::from(gain) * radius_m / wavelength_m, curve_max, limits);
        let level = limits.tier.level_or_portable();
        let prepared = |(aperture, views): &(&Aperture, &[View])| {
            PreparedAperture::new(aperture, &middle_m, wavelength_m, curve_max, views, level)
        };
        Some(Self {
            axes: axes_of(gain)?,
            own_axes: layers.iter().map(|(aperture, _)| axes_of(aperture.path_gain)).collect::<Option<_>>()?,
            apertures: limits.each(layers, prepared),
            weights: Weights::of(&views),
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
        self.compare_with_mirror(&mut sources);
        let free = Free { elevation: self.axes.elevations.len() > 1, range: self.axes.curves.len() > 1 };
        let first = sources.first_mut()?;
        self.follow_ridge(first, free);
        let is_likeliest = self.polish(first, free);
        let best = *first;
        // In space range and elevation are known too well for others to be averaged over.
        let is_known = is_likeliest || self.limits.elevations == Elevations::Signed;
        let azimuth_rad = if is_known { best.azimuth_rad } else { self.weighed_rad(&best, free) };
        let view_powers = self.powers(&[Place::from(&best)], Precision::Exact).into_iter().map(f64::from).collect();
        let [lowest_rad, highest_rad] = self.limits.elevation_span_rad();
        let prior = [(highest_rad - lowest_rad) / 12f64.sqrt(), self.curve_max / 12f64.sqrt()];
        Some(Fix {
            deviations: deviations(&self.waves(free), &best, prior),
            sources,
            azimuth_rad,
            middle_m: self.middle_m,
            view_azimuths_rad,
            view_powers,
            range_searched: free.range,
            elevation_searched: free.elevation,
            range_min_m: 1.0 / self.curve_max,
            elevation_max_rad: highest_rad,
            evaluations: self.evaluations,
        })
    }

    /// Where elevations are not limited, azimuth, elevation and range may follow each other along a ridge too narrow to be
    /// climbed by steps along the axes: goes on by the residual phases' own direction as long as the joint power rises.
    fn follow_ridge(&mut self, answer: &mut Source, free: Free) {
        if self.limits.elevations == Elevations::Expected || self.limits.height_m.is_some() {
            return;
        }
        let weights = self.weights.choosing.clone();
        let [lowest, highest] = self.limits.elevation_span_rad();
        let mut at = Place::from(&*answer);
        let mut best = answer.power;
        for _ in 0..RIDGE_STEPS {
            let Some(step) = downhill(&self.waves(free), &at) else { break };
            let place = |share: &f64| Place {
                azimuth: at.azimuth + share * step[0],
                elevation: (at.elevation + share * step[1]).clamp(lowest, highest),
                curve: (at.curve + share * step[2]).clamp(0.0, self.curve_max),
            };
            let places: Vec<Place> = RIDGE_SHARES.iter().map(place).collect();
            let powers = scores(&self.powers(&places, Precision::Exact), &weights);
            let top = powers.into_iter().map(|score| self.power(score)).enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
            let Some((index, power)) = top.filter(|(_, power)| *power > best) else { break };
            (at, best) = (places[index], power);
        }
        if best > answer.power {
            (answer.azimuth_rad, answer.inverse_range_per_m) = (wrap_rad(at.azimuth), at.curve);
            (answer.abs_elevation_rad, answer.power) = (at.elevation.abs(), best.min(1.0));
            answer.signed_elevation_rad = answer.signed_elevation_rad.map(|_| at.elevation);
        }
    }

    /// Moves the answer to the most likely place, where noise is all that it leaves; false where more is left, or where a
    /// known height leaves no choice.
    fn polish(&self, answer: &mut Source, free: Free) -> bool {
        // A known height makes elevation a function of range: neither can be refined alone.
        if self.limits.height_m.is_some() && free.range {
            return false;
        }
        let at = [answer.azimuth_rad, answer.elevation_rad(), answer.inverse_range_per_m];
        let signed = answer.signed_elevation_rad.is_some();
        let cell_rad = TAU / self.axes.azimuths as f64;
        let place = polished(|free| self.waves(free), at, free, signed, cell_rad);
        let Some([azimuth, elevation, curve]) = place else { return false };
        let [lowest, highest] = self.limits.elevation_span_rad();
        if (lowest..=highest).contains(&elevation) && (0.0..=self.curve_max).contains(&curve) {
            answer.azimuth_rad = wrap_rad(azimuth);
            (answer.abs_elevation_rad, answer.inverse_range_per_m) = (elevation.abs(), curve);
            answer.signed_elevation_rad = answer.signed_elevation_rad.map(|_| elevation);
        }
        true
    }

    /// Waves over the rows that deviations are predicted from.
    fn waves(&self, free: Free) -> Waves<'_, SUBCARRIERS> {
        Waves::of_subcarriers(&self.reference, &self.middle_m, self.wavelength_m, free)
    }

    /// The posterior mean of the azimuth over the elevations and ranges that an answer may have.
    fn weighed_rad(&mut self, answer: &Source, free: Free) -> f64 {
        let cell_rad = TAU / self.axes.azimuths as f64;
        // Elevations are averaged over where level motion hardly shows them.
        let elevation = free.elevation && self.limits.elevations == Elevations::Expected;
        let offsets = prior::offsets(Free { elevation, ..free });
        let place = |offset: &prior::Offset| Place {
            azimuth: answer.azimuth_rad + offset.azimuth_cells * cell_rad,
            elevation: offset
                .elevation_share
                .map_or(answer.elevation_rad(), |share| share * self.limits.elevation_max_rad),
            curve: offset.curve_share.map_or(answer.inverse_range_per_m, |share| share * self.curve_max),
        };
        let places: Vec<Place> = offsets.iter().map(place).collect();
        let powers = self.powers(&places, Precision::Exact);
        let placing = &self.weights.placing;
        let cells = prior::mean_cells(&offsets, &scores(&powers, placing), placing.iter().sum(), answer.power);
        wrap_rad(answer.azimuth_rad + cells * cell_rad)
    }

    /// Moves the samples as `warp` says, about the middle.
    pub(super) fn warp(&mut self, warp: &Warp) {
        self.apertures.iter_mut().for_each(|aperture| aperture.warp(warp));
        self.reference.displacement_m = self.offsets_m().into_iter().map(|p| p + self.middle_m).collect();
    }

    /// Where the samples of the first aperture are, about the middle, metres.
    pub(super) fn offsets_m(&self) -> Vec<Vector3<f64>> {
        self.apertures.first().map(PreparedAperture::offsets_m).unwrap_or_default()
    }

    pub(super) fn level(&self) -> Level {
        self.limits.tier.level_or_portable()
    }

    /// `place` with the elevation that a known height gives it: `sin(elevation) = height / range`.
    pub(super) fn at_height(&self, place: &Place) -> Place {
        let elevation = match self.limits.height_m {
            Some(height) => (height * place.curve).clamp(-1.0, 1.0).asin(),
            None => place.elevation,
        };
        Place { elevation, ..*place }
    }

    /// The power of every view for each place: `powers[place * views + view]`.
    pub(super) fn powers(&mut self, places: &[Place], precision: Precision) -> Vec<f32> {
        self.evaluations += places.len();
        self.powers_of(&self.apertures, places, precision)
    }

    /// The same of any apertures, not counted.
    pub(super) fn powers_of(&self, apertures: &[PreparedAperture], places: &[Place], precision: Precision) -> Vec<f32> {
        let places: Vec<Place> = places.iter().map(|place| self.at_height(place)).collect();
        powers(self.level(), apertures, &places, precision)
    }

    /// The joint power of each place, 0..1.
    pub(super) fn joint_powers(&mut self, places: &[Place]) -> Vec<f64> {
        let powers = self.powers(places, Precision::Exact);
        scores(&powers, &self.weights.choosing).into_iter().map(|score| self.power(score)).collect()
    }

    /// The joint power of a score by the weights for choosing.
    pub(super) fn power(&self, score: f64) -> f64 {
        (score / self.weights.choosing.iter().sum::<f64>()).exp()
    }
}

impl From<&Source> for Place {
    fn from(source: &Source) -> Self {
        let (azimuth, elevation) = (source.azimuth_rad, source.elevation_rad());
        Self { azimuth, elevation, curve: source.inverse_range_per_m }
    }
}

/// Largest height of a sample above or below the middle over `radius_m`.
fn height_share(layers: &[(&Aperture, &[View])], middle_m: &Vector3<f64>, radius_m: f64) -> f64 {
    let heights = layers.iter().flat_map(|(aperture, _)| &aperture.displacement_m).map(|p| (p.z - middle_m.z).abs());
    let highest = heights.fold(0.0, f64::max);
    if radius_m > 0.0 { highest / radius_m } else { 0.0 }
}

/// `sum weight ln power` over the views of each place.
pub(super) fn scores(powers: &[f32], weights: &[f64]) -> Vec<f64> {
    let score = |own: &[f32]| own.iter().zip(weights).map(|(p, w)| w * f64::from(p.max(1e-12)).ln()).sum::<f64>();
    powers.chunks(weights.len()).map(score).collect()
}
