//! Motion along a line that climbs.
//!
//! All directions at one angle to a line, a cone, explain its samples alike. A level line's cone meets the horizon at right angles: an
//! elevation that nobody knows hardly moves the azimuth. The cone of a line that climbs by `b` does not: with the
//! line's azimuth `a`, the azimuth of elevation `e` follows from
//!
//! `cos b cos e cos(azimuth - a) + sin b sin e = c`, about `tan b / sin(azimuth - a)` times the elevation beside that of the horizon.
//!
//! So its error bar holds what the elevations that are expected leave open. The part that is even in `e` is that of a level line too, for which
//! error bars and probabilities were calibrated; the odd part is added.

use super::bearing::BearingAnswer;
use super::options::Options;
use crate::bartlett::{self, Estimate, Geometry, Grid};
use crate::maths::wrap_rad;
use crate::place::confidence::{UNIFORM_RAD, probability_limits};
use crate::place::near_field::mirror::{decisive, log_odds};
use crate::signal::samples::Samples;
use crate::tuning::TUNING;
use nalgebra::Vector3;
use std::f64::consts::PI;

/// Elevations that are looked at on either side of the horizon.
const ELEVATIONS: u32 = 40;
/// What counts as right, as in the calibrated probability, radians.
const RIGHT_RAD: f64 = 5.0 * PI / 180.0;
/// Angles to the line that are looked at for each turn of phase along it.
const ANGLES_PER_TURN: f64 = 8.0;

/// What a climbing line leaves open of an azimuth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Slope {
    /// Deviation of the azimuth over the elevations that are expected, radians.
    pub azimuth_sd_rad: f64,
    /// Share of these elevations of which the azimuth is within five degrees.
    pub right: f64,
}

impl Slope {
    /// Of the plane wave found at the horizon; `None` of motion that is no line or does not climb, and where the elevation is known.
    ///
    /// # Errors
    /// As [`bartlett::profile`].
    pub fn of(samples: &Samples, found: &Estimate, options: &Options) -> Result<Option<Self>, bartlett::Error> {
        let along = found.shape.axes[0];
        let climbs = along.z.abs() > TUNING.plane_wave.level_rad.sin();
        let limit_rad = options.search.elevation_max_rad;
        let known = limit_rad <= 0.0 || options.accuracy.height_m.is_some();
        if found.geometry != Geometry::Line || !climbs || known || found.elevation_searched {
            return Ok(None);
        }
        let open = Self { azimuth_sd_rad: UNIFORM_RAD, right: 0.0 };
        let is_elsewhere = decisive(log_odds(highest(samples, found)?, found.value));
        Ok(Some(if is_elsewhere { open } else { Self::about(along, found.azimuth_rad, limit_rad) }))
    }

    /// Of the azimuth at the horizon, for the elevations up to a limit.
    fn about(along: Vector3<f64>, azimuth_rad: f64, limit_rad: f64) -> Self {
        let (axis_rad, flat) = (along.y.atan2(along.x), along.xy().norm());
        let off_rad = wrap_rad(azimuth_rad - axis_rad);
        let angle = flat * off_rad.cos();
        let from_axis = |elevation: f64| {
            let cosine = (angle - along.z * elevation.sin()) / (flat * elevation.cos()).max(f64::MIN_POSITIVE);
            cosine.clamp(-1.0, 1.0).acos()
        };
        let odd = |k: u32| {
            let elevation = limit_rad * (f64::from(k) + 0.5) / f64::from(ELEVATIONS);
            0.5 * (from_axis(elevation) - from_axis(-elevation))
        };
        let off: Vec<f64> = (0..ELEVATIONS).map(odd).collect();
        let count = f64::from(ELEVATIONS);
        Self {
            azimuth_sd_rad: (off.iter().map(|off| off * off).sum::<f64>() / count).sqrt(),
            right: off.iter().filter(|off| off.abs() < RIGHT_RAD).count() as f64 / count,
        }
    }

    /// Says in an answer what is left open.
    pub fn tell(&self, answer: &mut BearingAnswer) {
        let [least, most] = probability_limits();
        answer.azimuth_sd_rad = answer.azimuth_sd_rad.hypot(self.azimuth_sd_rad).min(UNIFORM_RAD);
        answer.probability = answer.probability.map(|own| (own * self.right).clamp(least, most));
    }
}

/// The highest power of a plane wave at any angle to the motion's longest axis.
fn highest(samples: &Samples, found: &Estimate) -> Result<f64, bartlett::Error> {
    let along = found.shape.axes[0];
    let across = along.cross(&Vector3::z()).try_normalize(1e-9).unwrap_or(Vector3::x());
    let turns = 2.0 * found.shape.half_extent_m[0] * f64::from(samples.path_gain()) / samples.wavelength_m();
    let count = (2.0 * ANGLES_PER_TURN * turns).ceil().max(16.0);
    let direction = |k: u32| {
        let cosine = (2.0 * f64::from(k) / count - 1.0).clamp(-1.0, 1.0);
        let towards = along * cosine + across * (1.0 - cosine * cosine).sqrt();
        (towards.y.atan2(towards.x), towards.z.clamp(-1.0, 1.0).asin())
    };
    let profile = bartlett::profile(samples, &Grid::directions((0..=count as u32).map(direction).collect()))?;
    Ok(profile.values.into_iter().fold(0.0, f64::max))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn about(rise_deg: f64, azimuth_deg: f64) -> Slope {
        let (up, flat) = rise_deg.to_radians().sin_cos();
        Slope::about(Vector3::new(flat, 0.0, up), azimuth_deg.to_radians(), 20f64.to_radians())
    }

    #[test]
    fn a_level_line_leaves_nothing_open_and_a_steeper_one_more() {
        assert_eq!(about(0.0, 60.0), Slope { azimuth_sd_rad: 0.0, right: 1.0 });
        let open = [10.0, 30.0, 60.0].map(|rise_deg| about(rise_deg, 90.0));
        for (slope, rise_deg) in open.iter().zip([10f64, 30.0, 60.0]) {
            // Of uniform elevations up to 20 degrees the deviation is 20 / sqrt 3.
            let linear = rise_deg.to_radians().tan() * 20f64.to_radians() / 3f64.sqrt();
            assert!((slope.azimuth_sd_rad / linear - 1.0).abs() < 0.2, "{rise_deg}: {slope:?} {linear}");
        }
        assert!(open[0].right > open[1].right && open[1].right > open[2].right, "{open:?}");
        // Either side of the line is as open, whichever way it is driven.
        let back = Slope::about(Vector3::new(-0.8, 0.0, -0.6), -1.2, 0.3);
        let there = Slope::about(Vector3::new(0.8, 0.0, 0.6), 1.2, 0.3);
        assert!((back.azimuth_sd_rad - there.azimuth_sd_rad).abs() < 1e-12, "{back:?} {there:?}");
    }
}
