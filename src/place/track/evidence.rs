//! The evidence of one stretch of motion about a peer's place.

use super::peer_track::TrackError;
use crate::maths::wrap_rad;
use crate::place::track::settings::{RANGE_FLOOR, RANGE_MISSED};
use nalgebra::{Rotation2, Vector2};
use std::f64::consts::TAU;

/// One direction that a stretch may be explained by.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct EvidenceMode {
    /// Azimuth, radians, from +x towards +y in the trajectory's frame.
    pub azimuth_rad: f64,
    /// Standard deviation of the azimuth if this is the right one, radians.
    pub sd_rad: f64,
    /// Its share of all modes, in any common unit.
    pub share: f64,
    /// Horizontal range and its standard deviation, metres, where they were observed.
    pub range_m: Option<(f64, f64)>,
}

impl EvidenceMode {
    /// A direction without a range: azimuth and its deviation in radians, share in any common unit.
    #[must_use]
    pub fn new(azimuth_rad: f64, sd_rad: f64, share: f64) -> Self {
        Self { azimuth_rad, sd_rad, share, range_m: None }
    }

    /// The same with the horizontal range and its standard deviation, metres, where they were observed.
    #[must_use]
    pub fn with_range_m(self, range_m: Option<(f64, f64)>) -> Self {
        Self { range_m, ..self }
    }

    fn is_usable(&self) -> bool {
        let range = self.range_m.is_none_or(|(range_m, sd_m)| range_m > 0.0 && range_m.is_finite() && sd_m >= 0.0);
        let positive = self.sd_rad > 0.0 && self.sd_rad.is_finite() && self.share >= 0.0 && self.share.is_finite();
        self.azimuth_rad.is_finite() && positive && range
    }
}

/// The evidence of one stretch of motion about a peer's place; [`crate::pipeline::Bearing::evidence`] makes it from a bearing.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Evidence {
    /// Time of the stretch's last sample, seconds on the trajectory's clock.
    pub t_s: f64,
    /// Where its azimuths and ranges are measured from, metres in the trajectory's frame: the middle of its samples. Of two
    /// robots that both move, the middle of their displacement, receiver less transmitter.
    pub position_m: Vector2<f64>,
    /// Way driven since the evidence before, metres; the straight line between the two positions where that is longer.
    pub driven_m: f64,
    /// The directions that explain the stretch.
    pub modes: Vec<EvidenceMode>,
    /// Probability that one of them is right.
    pub known: f64,
    /// Share of the stretch that no evidence before was made of, 0..1: the likelihood is taken to this power.
    pub fresh: f64,
}

impl Evidence {
    /// Evidence of directions `modes`, seen at `t_s` seconds from `position_m` metres, of which one is right with the
    /// probability `known`.
    #[must_use]
    pub fn new(t_s: f64, position_m: Vector2<f64>, modes: Vec<EvidenceMode>, known: f64) -> Self {
        Self { t_s, position_m, driven_m: 0.0, modes, known, fresh: 1.0 }
    }

    /// The same with the way driven since the evidence before, metres.
    #[must_use]
    pub fn with_driven_m(self, driven_m: f64) -> Self {
        Self { driven_m, ..self }
    }

    /// The same of a stretch of which only this share is new, 0..1.
    #[must_use]
    pub fn with_fresh(self, fresh: f64) -> Self {
        Self { fresh, ..self }
    }

    /// Refuses what cannot be used.
    pub(super) fn check(&self) -> Result<(), TrackError> {
        let numbers = [
            ("time", self.t_s),
            ("position", self.position_m.x + self.position_m.y),
            ("way driven", self.driven_m),
            ("probability of the directions", self.known),
            ("share of the stretch that is new", self.fresh),
        ];
        if let Some((what, value)) = numbers.into_iter().find(|(_, value)| !value.is_finite()) {
            return Err(TrackError::NotFinite { what, value });
        }
        let total: f64 = self.modes().map(|mode| mode.share).sum();
        if total > 0.0 { Ok(()) } else { Err(TrackError::NoDirection { modes: self.modes.len() }) }
    }

    /// The modes that can be used.
    pub(super) fn modes(&self) -> impl Iterator<Item = &EvidenceMode> {
        self.modes.iter().filter(|mode| mode.is_usable())
    }

    /// The probability that one of the modes is right.
    pub(super) fn believed(&self) -> f64 {
        self.known.clamp(0.0, 0.99)
    }

    /// The same where the heading of all of the trajectory has this deviation, radians, and no other motion shares it.
    #[must_use]
    pub fn with_heading_sd_rad(mut self, heading_sd_rad: f64) -> Self {
        self.modes.iter_mut().for_each(|mode| mode.sd_rad = mode.sd_rad.hypot(heading_sd_rad));
        self
    }

    /// The same in another frame, in which the origin of this one is at `origin_m` and its x axis is turned by `yaw_rad`.
    #[must_use]
    pub fn in_frame(mut self, origin_m: Vector2<f64>, yaw_rad: f64) -> Self {
        self.position_m = origin_m + Rotation2::new(yaw_rad) * self.position_m;
        self.modes.iter_mut().for_each(|mode| mode.azimuth_rad = wrap_rad(mode.azimuth_rad + yaw_rad));
        self
    }

    /// The likelihood of each place over that of a uniform guess: the sum of the modes' products, and the rest that is the same
    /// everywhere. There are `azimuths` cells around; `ranges` are the logarithms of the
    /// ranges, with the prior's share of each.
    pub(super) fn factors(&self, azimuths: usize, ranges: &[(f64, f64)]) -> (Vec<Factor>, f64) {
        let total: f64 = self.modes().map(|mode| mode.share).sum();
        let known = self.believed();
        let factor = |mode: &EvidenceMode| {
            let weight = known * mode.share / total;
            let mut around = wrapped_normal(mode.azimuth_rad, mode.sd_rad, azimuths);
            around.iter_mut().for_each(|value| *value *= weight);
            Factor { around, along: along(mode, ranges) }
        };
        (self.modes().map(factor).collect(), 1.0 - known)
    }
}

/// What one mode adds to the likelihood of a place: the product of a factor of its azimuth and one of its range.
pub(super) struct Factor {
    /// At the centre of each cell around, from azimuth 0 on.
    pub around: Vec<f64>,
    /// At each range.
    pub along: Vec<f64>,
}

/// A normal density around the circle over the uniform one, at the centres of `cells` cells from azimuth 0 on; its mean is 1.
fn wrapped_normal(azimuth_rad: f64, sd_rad: f64, cells: usize) -> Vec<f64> {
    let step_rad = TAU / cells as f64;
    // A peak narrower than the cells would fall between their centres.
    let sd_rad = sd_rad.max(0.6 * step_rad);
    let at = |cell: usize| {
        let off = wrap_rad(cell as f64 * step_rad - azimuth_rad) / sd_rad;
        (-0.5 * off * off).exp()
    };
    let mut values: Vec<f64> = (0..cells).map(at).collect();
    let mean = values.iter().sum::<f64>() / cells as f64;
    values.iter_mut().for_each(|value| *value /= mean);
    values
}

/// The density of a mode's range over the prior, at each range (its logarithm and the prior's share); all 1 where none was
/// observed. Ranges are wrong more often than their deviations say: a share of the prior stays in them.
fn along(mode: &EvidenceMode, ranges: &[(f64, f64)]) -> Vec<f64> {
    let Some((range_m, sd_m)) = mode.range_m else { return vec![1.0; ranges.len()] };
    let (sd, mean) = bell(range_m, sd_m, ranges);
    let at = |ln_range: f64| (-0.5 * ((ln_range - range_m.ln()) / sd).powi(2)).exp();
    let missed = RANGE_MISSED;
    let of = |ln_range: f64| if mean > 0.0 { missed + (1.0 - missed) * at(ln_range) / mean } else { 1.0 };
    ranges.iter().map(|(ln_range, _)| of(*ln_range)).collect()
}

/// The deviation of a range's logarithm, and the mean of its bell over the prior of ranges.
pub(super) fn bell(range_m: f64, sd_m: f64, ranges: &[(f64, f64)]) -> (f64, f64) {
    let sd = (sd_m / range_m).hypot(RANGE_FLOOR);
    let at = |ln_range: f64| (-0.5 * ((ln_range - range_m.ln()) / sd).powi(2)).exp();
    (sd, ranges.iter().map(|(ln_range, share)| share * at(*ln_range)).sum())
}
