//! How much of the estimate a link needs: a plane wave, one spherical wave at the channel centre, or every step.

use super::accurate::Placed;
use super::bearing::BearingAnswer;
use super::direction::Direction;
use super::options::{Effort, Options};
use crate::place::near_field::one_wave::CentreWave;
use crate::place::near_field::{Limits, Search, Unexplained};
use crate::signal::samples::Samples;
use crate::tuning::TUNING;
use serde::Serialize;
use std::fmt;

/// What was found to suffice for a link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Sufficient {
    /// A plane wave, since nothing else was asked for.
    AllAsked,
    /// A plane wave whose error bar is below the accuracy that was asked for.
    ErrorBar {
        /// The error bar, radians.
        error_bar_rad: f64,
        /// What was asked for, radians.
        asked_rad: f64,
    },
    /// A plane wave that leaves nothing but noise, of an aperture so small that no wave front is curved.
    PlaneWave(Risk),
    /// One spherical wave at the channel centre, which leaves nothing but noise.
    OneWave(Risk),
    /// Every step that was asked for, for this reason.
    Everything(Reason),
}

/// What leaving steps out risked.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Risk {
    /// How far they may have moved the azimuth, radians: by a wave as strong as the noise could hide.
    pub risk_rad: f64,
    /// How far they were allowed to, radians.
    pub tolerance_rad: f64,
}

/// Why every step was taken.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Reason {
    /// [`Effort::Everything`].
    Asked,
    /// One wave is not the whole answer.
    Unexplained(Unexplained),
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Asked => f.write_str("every step was asked for"),
            Self::Unexplained(unexplained) => unexplained.fmt(f),
        }
    }
}

impl Sufficient {
    /// True if one wave explains the samples but for noise: then the trajectory is what it is said to be.
    #[must_use]
    pub(crate) fn explains_all(&self) -> bool {
        matches!(self, Self::PlaneWave(_) | Self::OneWave(_))
    }
}

/// The least that suffices, and what it found on the way.
pub(super) struct Least {
    pub sufficient: Sufficient,
    /// The one wave, where it is the answer.
    pub one_wave: Option<(Placed, Search)>,
}

impl Least {
    /// What `samples` need; `limits` are those of a search over places, `quick` the answer of the plane wave.
    pub fn of(
        samples: &Samples,
        direction: &Direction,
        limits: &Limits,
        quick: &BearingAnswer,
        options: &Options,
    ) -> Self {
        let without = |sufficient| Self { sufficient, one_wave: None };
        let asked_rad = match options.accuracy.effort {
            _ if !options.accuracy.near_field => return without(Sufficient::AllAsked),
            Effort::Everything => return without(Sufficient::Everything(Reason::Asked)),
            Effort::Within(asked_rad) => Some(asked_rad),
            Effort::Needed => None,
        };
        // The error bar of a plane wave was fitted to apertures over which wave fronts are hardly curved.
        let [_, widest] = TUNING.quick_probability.aperture_wavelengths;
        let narrow = 2.0 * direction.plane_wave.shape.half_extent_m[0] <= widest * samples.wavelength_m();
        let certain = narrow && quick.mirror_rad.is_none() && quick.edge.is_none();
        if let Some(asked_rad) = asked_rad.filter(|asked| certain && quick.azimuth_sd_rad <= *asked) {
            return without(Sufficient::ErrorBar { error_bar_rad: quick.azimuth_sd_rad, asked_rad });
        }
        match Self::one_wave(samples, direction, limits, quick, options, asked_rad) {
            Ok(least) => least,
            Err(unexplained) => without(Sufficient::Everything(Reason::Unexplained(unexplained))),
        }
    }

    fn one_wave(
        samples: &Samples,
        direction: &Direction,
        limits: &Limits,
        quick: &BearingAnswer,
        options: &Options,
        asked_rad: Option<f64>,
    ) -> Result<Self, Unexplained> {
        let mut wave = CentreWave::new(samples, limits).ok_or(Unexplained::NoPlace)?;
        let one = wave.explain(&direction.plane_wave)?;
        let flat = !one.fix.range_searched;
        let risk_rad = one.risk_rad;
        let placed = Placed::of_one_wave(one.fix);
        let bar_rad = match flat {
            true => quick.azimuth_sd_rad,
            false => BearingAnswer::of_spherical_wave(&placed, &direction.plane_wave, samples, options).azimuth_sd_rad,
        };
        let tolerance_rad = asked_rad.unwrap_or(TUNING.effort.share * bar_rad);
        if risk_rad > tolerance_rad {
            return Err(Unexplained::Noise(risk_rad));
        }
        let risk = Risk { risk_rad, tolerance_rad };
        Ok(match flat {
            true => Self { sufficient: Sufficient::PlaneWave(risk), one_wave: None },
            false => Self { sufficient: Sufficient::OneWave(risk), one_wave: Some((placed, wave.into_search())) },
        })
    }
}
