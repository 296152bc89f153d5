//! The filter: evidence in, answers out.

use super::evidence::Evidence;
use super::grid::PlaceGrid;
use super::posterior::TrackAnswer;
use super::settings::{TrackSettings, temper};
use nalgebra::Vector2;

/// Share of the evidence that every motion returns to the prior (a peer that was carried elsewhere is found there after
/// two motions).
const FORGOTTEN: f64 = 0.02;

/// Why evidence was not used; the track is as it was.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TrackError {
    /// A NaN or an infinity.
    #[error("the {what} of the evidence is {value}: a finite number is needed")]
    NotFinite {
        /// The quantity.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// No direction that can be used: an azimuth, a positive deviation and a share, all finite.
    #[error("none of {modes} directions is usable: each needs a finite azimuth, a positive deviation and a share")]
    NoDirection {
        /// Directions that were given.
        modes: usize,
    },
    /// It is of a time before the evidence before.
    #[error("evidence of {t_s} s after evidence of {last_s} s: hand stretches over in the order of time")]
    OutOfOrder {
        /// Its time, seconds.
        t_s: f64,
        /// That of the evidence before, seconds.
        last_s: f64,
    },
}

/// What became of the evidence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct TrackCounts {
    /// Stretches that were used.
    pub used: u64,
    /// Stretches that were refused (`TrackError`).
    pub refused: u64,
    /// How often the evidence was dropped because another frame began.
    pub reset: u64,
    /// The same because nothing was heard of the peer for long.
    pub gone: u64,
}

/// The probability of every place of one peer, carried from one stretch of motion to the next.
#[derive(Clone, Debug, Default)]
pub struct PeerTrack {
    settings: TrackSettings,
    known: Option<Known>,
    counts: TrackCounts,
}

#[derive(Clone, Debug)]
struct Known {
    grid: PlaceGrid,
    t_s: f64,
    stretches: u32,
    /// Stretches that know a direction: their probabilities, summed and forgotten as places are.
    known: f64,
}

impl PeerTrack {
    /// A track of a peer about which nothing is known.
    #[must_use]
    pub fn new(settings: TrackSettings) -> Self {
        Self { settings, known: None, counts: TrackCounts::default() }
    }

    /// Adds the evidence of one stretch of motion. Stretches come in the order of time and do not overlap, except for what
    /// [`Evidence::fresh`] says.
    ///
    /// # Errors
    /// `TrackError` where it cannot be used; it is counted, and the track is as it was.
    pub fn update(&mut self, evidence: &Evidence) -> Result<(), TrackError> {
        let next = self.with(evidence);
        match next {
            Ok((known, gone)) => {
                self.counts.used += 1;
                self.counts.gone += u64::from(gone);
                self.known = Some(known);
                Ok(())
            }
            Err(error) => {
                self.counts.refused += 1;
                Err(error)
            }
        }
    }

    /// What the track and `evidence` together say, seen from the evidence's position, without taking it.
    ///
    /// # Errors
    /// As [`Self::update`]; nothing is counted.
    pub fn answer_with(&self, evidence: &Evidence) -> Result<TrackAnswer, TrackError> {
        self.with(evidence).map(|(known, _)| known.answer(&self.settings))
    }

    /// What is known, seen from `position_m`, metres in the trajectory's frame; `None` before any evidence, or where the
    /// position is not finite. What odometry got wrong since the last evidence is not in it.
    #[must_use]
    pub fn answer(&self, position_m: Vector2<f64>) -> Option<TrackAnswer> {
        let known = self.known.as_ref().filter(|_| position_m.iter().all(|x| x.is_finite()))?;
        let moved = Known { grid: known.grid.moved_to(position_m), ..*known };
        Some(moved.answer(&self.settings))
    }

    /// The same seen from where the last evidence was.
    #[must_use]
    pub fn last_answer(&self) -> Option<TrackAnswer> {
        self.known.as_ref().map(|known| known.answer(&self.settings))
    }

    /// Drops all evidence: another frame begins.
    pub fn reset(&mut self) {
        self.counts.reset += u64::from(self.known.take().is_some());
    }

    /// Time of the last evidence, seconds; `None` where nothing is known.
    #[must_use]
    pub fn last_s(&self) -> Option<f64> {
        self.known.as_ref().map(|known| known.t_s)
    }

    /// What became of the evidence.
    #[must_use]
    pub fn counts(&self) -> TrackCounts {
        self.counts
    }

    /// The state after `evidence`, and whether the peer was lost before.
    fn with(&self, evidence: &Evidence) -> Result<(Known, bool), TrackError> {
        evidence.check()?;
        let before = self.known.as_ref();
        if let Some(last_s) = before.map(|known| known.t_s).filter(|last_s| evidence.t_s < *last_s) {
            return Err(TrackError::OutOfOrder { t_s: evidence.t_s, last_s });
        }
        let present = before.filter(|known| evidence.t_s - known.t_s <= self.settings.gone_s);
        let (mut grid, stretches, before_known) = match present {
            None => (PlaceGrid::prior(evidence.position_m), 0, 0.0),
            Some(known) => (self.predicted(known, evidence), known.stretches, known.known),
        };
        let mut known = before_known * (1.0 - FORGOTTEN) + evidence.fresh.clamp(0.0, 1.0) * evidence.believed();
        if !grid.multiply(evidence) {
            // No place is left of what was known: the evidence stands by itself.
            grid = PlaceGrid::prior(evidence.position_m);
            grid.multiply(evidence);
            known = evidence.believed();
        }
        let known = Known { grid, t_s: evidence.t_s, stretches: stretches.saturating_add(1), known };
        Ok((known, before.is_some() && present.is_none()))
    }

    /// The places before the evidence, about its position.
    fn predicted(&self, known: &Known, evidence: &Evidence) -> PlaceGrid {
        let straight_m = (evidence.position_m - known.grid.middle_m).norm();
        let (turn_rad, shift_m) =
            self.settings.blur(evidence.driven_m.max(straight_m), (evidence.t_s - known.t_s).max(0.0));
        let mut grid = known.grid.moved_to(evidence.position_m);
        grid.blur(turn_rad, shift_m);
        grid.forget(FORGOTTEN);
        grid
    }
}

impl Known {
    fn answer(&self, settings: &TrackSettings) -> TrackAnswer {
        let exponent = temper(self.known, settings.own_share);
        TrackAnswer::of(&self.grid, exponent, settings.heading_sd_rad, self.stretches)
    }
}
