//! From the peaks of the grid to the local maxima of the joint power (tops).

use super::fix::Source;
use super::prepared::PreparedAperture;
use super::search::{Search, scores};
use super::types::{Elevations, Place, Precision, Scored, Warp};
use crate::bartlett::direction;
use crate::maths::wrap_rad;
use crate::tuning::TUNING;
use std::f64::consts::TAU;

/// What a climb goes up on, and how far.
#[derive(Clone, Copy)]
struct Climb<'a> {
    /// Exponents of the views.
    weights: &'a [f64],
    precision: Precision,
    /// It ends when its steps in azimuth are smaller than this, radians.
    end_rad: f64,
}

impl Search {
    /// Climbs the high peaks to see which is the highest, then that one to its top. Those that meet are one.
    pub(super) fn climb_all(&mut self, peaks: &[Scored]) -> Vec<Source> {
        let mut tops = self.coarse_tops(peaks);
        if let Some(first) = tops.first_mut() {
            *first = self.fine_top(first.place);
        }
        let cell_rad = TAU / self.axes.azimuths as f64;
        let mut sources: Vec<Source> = Vec::new();
        for top in &tops {
            let source = self.source(top);
            let same = |other: &Source| match self.limits.elevations {
                Elevations::Signed => same_direction(other, &source, 2.0 * cell_rad),
                _ => wrap_rad(other.azimuth_rad - source.azimuth_rad).abs() < 2.0 * cell_rad,
            };
            if !sources.iter().any(same) {
                sources.push(source);
            }
        }
        sources
    }

    /// Where climbs from the high peaks end, by evidence, falling.
    fn coarse_tops(&mut self, peaks: &[Scored]) -> Vec<Scored> {
        let weights = self.weights.choosing.clone();
        let total: f64 = weights.iter().sum();
        let high = |peak: &&Scored| ((peak.score - peaks[0].score) / total).exp() >= TUNING.climb.floor;
        let high: Vec<Place> = peaks.iter().take(TUNING.climb.most).take_while(high).map(|peak| peak.place).collect();
        let climb = Climb { weights: &weights, precision: Precision::Rough, end_rad: TUNING.climb.coarse_rad };
        let climbed = self.limits.each(&high, |place| self.climb(&self.apertures, *place, climb));
        self.evaluations += climbed.iter().map(|(_, evaluations)| evaluations).sum::<usize>();
        let places: Vec<Place> = climbed.into_iter().map(|(top, _)| top.place).collect();
        // Rough powers led there; exact ones decide which is the highest.
        let powers = self.powers(&places, Precision::Exact);
        let scores = scores(&powers, &weights);
        let mut tops: Vec<Scored> =
            places.into_iter().zip(scores).map(|(place, score)| Scored { place, score }).collect();
        let evidence = |top: &Scored| top.score + self.averaging_at(&top.place);
        tops.sort_by(|a, b| evidence(b).total_cmp(&evidence(a)));
        tops
    }

    /// The top above `start` by the views that place, with its score by the views that choose.
    fn fine_top(&mut self, start: Place) -> Scored {
        let placing = self.weights.placing.clone();
        let climb = Climb { weights: &placing, precision: Precision::Exact, end_rad: TUNING.climb.fine_rad };
        let place = self.climb_here(start, climb).place;
        let powers = self.powers(&[place], Precision::Exact);
        Scored { place, score: scores(&powers, &self.weights.choosing)[0] }
    }

    /// The highest score to be climbed to from `sources` if the trajectory were changed by `warp`, and how many places that
    /// took: what the change is judged by, without another search.
    pub(super) fn score_near(&self, warp: &Warp, sources: &[Source]) -> (f64, usize) {
        let apertures: Vec<PreparedAperture> = self.apertures.iter().map(|aperture| aperture.warped(warp)).collect();
        let end_rad = TUNING.climb.judging_cells * TAU / self.axes.azimuths as f64;
        let climb = Climb { weights: &self.weights.choosing, precision: Precision::Rough, end_rad };
        let climbs = sources.iter().map(|source| self.climb(&apertures, Place::from(source), climb));
        climbs.fold((f64::MIN, 0), |(best, all), (top, evaluations)| (best.max(top.score), all + evaluations))
    }

    /// The top that a climb on exact powers leads to from `start`, by the views that choose.
    pub(super) fn judged_top(&mut self, start: Place) -> Source {
        let weights = self.weights.choosing.clone();
        let climb = Climb { weights: &weights, precision: Precision::Exact, end_rad: TUNING.climb.coarse_rad };
        let top = self.climb_here(start, climb);
        self.source(&top)
    }

    /// What averaging over elevations and ranges adds to the score of a place: never above 0.
    fn averaging_at(&self, place: &Place) -> f64 {
        let n = self.axes.azimuths;
        let cell = (place.azimuth.rem_euclid(TAU) / TAU * n as f64).round() as usize % n;
        self.averaging.get(cell).copied().unwrap_or(0.0)
    }

    /// [`Self::climb`] on the motion's own apertures, counted.
    fn climb_here(&mut self, start: Place, climb: Climb<'_>) -> Scored {
        let (top, evaluations) = self.climb(&self.apertures, start, climb);
        self.evaluations += evaluations;
        top
    }

    /// Pattern search: the neighbours in all directions; the best of them is next, or the steps are halved. Gives the top and
    /// how many places were looked at.
    fn climb(&self, apertures: &[PreparedAperture], start: Place, climb: Climb<'_>) -> (Scored, usize) {
        let mut evaluations = 0;
        let mut best = Scored { place: start, score: f64::MIN };
        let [_, highest] = self.limits.elevation_span_rad();
        let mut reach = Place {
            azimuth: 0.5 * TAU / self.axes.azimuths as f64,
            elevation: match self.limits.elevations {
                Elevations::Expected => 0.125 * self.limits.elevation_max_rad,
                _ => 0.5 * highest / (self.axes.elevations.len() as f64 / 2.0).max(1.0),
            },
            curve: 0.5 * self.axes.curves.get(1).copied().unwrap_or(0.0),
        };
        // Where rough powers will do, so will sums over samples that are alike there.
        let thin = (climb.precision == Precision::Rough).then(|| self.apertures_about(apertures, &start));
        let apertures = thin.as_deref().unwrap_or(apertures);
        for _ in 0..TUNING.climb.rounds {
            let places = self.neighbours(&best.place, &reach);
            evaluations += places.len();
            let powers = self.powers_of(apertures, &places, climb.precision);
            // The first place is where the climb stands: only a better one moves it.
            let (next, score) = scores(&powers, climb.weights)
                .into_iter()
                .enumerate()
                .fold((0, f64::MIN), |top, (k, score)| if score > top.1 { (k, score) } else { top });
            best = Scored { place: places[next], score };
            if next == 0 {
                reach =
                    Place { azimuth: reach.azimuth * 0.5, elevation: reach.elevation * 0.5, curve: reach.curve * 0.5 };
                if reach.azimuth < climb.end_rad {
                    break;
                }
            }
        }
        (best, evaluations)
    }

    /// `at` itself, then the places a `reach` away along every free coordinate and all diagonals.
    fn neighbours(&self, at: &Place, reach: &Place) -> Vec<Place> {
        let steps = |free: bool| -> &[f64] { if free { &[0.0, -1.0, 1.0] } else { &[0.0] } };
        let elevation_free = self.axes.elevations.len() > 1 && self.limits.height_m.is_none();
        let [lowest, highest] = self.limits.elevation_span_rad();
        let mut places = Vec::with_capacity(27);
        for a in steps(true) {
            for e in steps(elevation_free) {
                for c in steps(self.axes.curves.len() > 1) {
                    places.push(Place {
                        azimuth: at.azimuth + a * reach.azimuth,
                        elevation: (at.elevation + e * reach.elevation).clamp(lowest, highest),
                        curve: (at.curve + c * reach.curve).clamp(0.0, self.curve_max),
                    });
                }
            }
        }
        places
    }

    fn source(&self, top: &Scored) -> Source {
        let place = self.at_height(&top.place);
        let signed = self.limits.elevations == Elevations::Signed || self.limits.height_m.is_some();
        Source {
            azimuth_rad: wrap_rad(place.azimuth),
            abs_elevation_rad: place.elevation.abs(),
            signed_elevation_rad: signed.then_some(place.elevation),
            inverse_range_per_m: place.curve,
            power: self.power(top.score).min(1.0),
            evidence: self.power(top.score + self.averaging_at(&place)).min(1.0),
        }
    }
}

/// True if two sources are nearer to each other than `within_rad`, whatever their ranges.
pub(super) fn same_direction(a: &Source, b: &Source, within_rad: f64) -> bool {
    let towards = |source: &Source| direction(source.azimuth_rad, source.elevation_rad());
    // Of small angles the chord keeps more digits than the cosine.
    (towards(a) - towards(b)).norm() < within_rad
}
