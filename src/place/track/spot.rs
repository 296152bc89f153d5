//! The likelihood of any place of the plane by one motion.

use super::evidence::{Evidence, EvidenceMode, bell};
use super::grid::prior_ranges;
use crate::maths::wrap_rad;
use crate::place::track::settings::RANGE_MISSED;
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// The likelihood of places, of evidence that is usable.
pub(super) struct Spot {
    position_m: Vector2<f64>,
    directions: Vec<Direction>,
    /// Probability that none of them is right.
    rest: f64,
    fresh: f64,
}

/// One direction.
struct Direction {
    azimuth_rad: f64,
    sd_rad: f64,
    /// Probability that it is the right one.
    share: f64,
    range: Option<Along>,
}

/// A range.
struct Along {
    ln_range: f64,
    /// Deviation of the logarithm.
    sd: f64,
    /// Mean of its bell over the prior.
    mean: f64,
}

impl Spot {
    /// Of evidence that is usable.
    pub fn of(evidence: &Evidence) -> Self {
        let ranges = prior_ranges();
        let total: f64 = evidence.modes().map(|mode| mode.share).sum();
        let known = evidence.believed();
        let along = |(range_m, sd_m): (f64, f64)| {
            let (sd, mean) = bell(range_m, sd_m, &ranges);
            (mean > 0.0).then(|| Along { ln_range: range_m.ln(), sd, mean })
        };
        let direction = |mode: &EvidenceMode| Direction {
            azimuth_rad: mode.azimuth_rad,
            sd_rad: mode.sd_rad,
            share: known * mode.share / total,
            range: mode.range_m.and_then(along),
        };
        let directions = evidence.modes().map(direction).collect();
        Self { position_m: evidence.position_m, directions, rest: 1.0 - known, fresh: evidence.fresh.clamp(0.0, 1.0) }
    }

    /// Probability that one of its directions is right, less known evidence.
    pub fn known(&self) -> f64 {
        self.fresh * (1.0 - self.rest)
    }

    /// The logarithm of the likelihood of a place over that of a uniform guess, of azimuths and ranges that are blurred by a
    /// shift of the place, metres.
    pub fn ln_likelihood(&self, place_m: Vector2<f64>, blur_m: f64) -> f64 {
        let offset_m = place_m - self.position_m;
        let range_m = offset_m.norm().max(1e-3);
        let (azimuth_rad, blur) = (offset_m.y.atan2(offset_m.x), blur_m / range_m);
        let of = |direction: &Direction| {
            let along = direction.range.as_ref().map_or(1.0, |own| own.density(range_m, blur));
            direction.share * direction.density(azimuth_rad, blur) * along
        };
        self.fresh * (self.rest + self.directions.iter().map(of).sum::<f64>()).ln()
    }
}

impl Direction {
    /// The normal density of an azimuth over the uniform one.
    fn density(&self, azimuth_rad: f64, blur: f64) -> f64 {
        let sd_rad = self.sd_rad.hypot(blur);
        let off = wrap_rad(azimuth_rad - self.azimuth_rad) / sd_rad;
        (-0.5 * off * off).exp() * TAU.sqrt() / sd_rad
    }
}

impl Along {
    /// The density of a range over the prior; ranges are wrong more often than their deviations say.
    fn density(&self, range_m: f64, blur: f64) -> f64 {
        let sd = self.sd.hypot(blur);
        let off = (range_m.ln() - self.ln_range) / sd;
        let missed = RANGE_MISSED;
        missed + (1.0 - missed) * (-0.5 * off * off).exp() * self.sd / (sd * self.mean)
    }
}
