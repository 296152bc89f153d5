//! Curves of one link for pictures and pages: its profiles, and its phase with the motion removed.

use csi5300::bartlett::{self, Grid};
use csi5300::maths::wrap_rad;
use csi5300::pipeline::Bearing;

/// Azimuths of the plane wave's profile.
const AZIMUTHS: usize = 1_440;

/// A curve over azimuth.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// Its description.
    pub name: String,
    /// Azimuths, degrees, rising, with their values, linear (not dB).
    pub points: Vec<(f64, f64)>,
}

impl Curve {
    /// From azimuths, degrees, in any order, with their values.
    fn new(name: &str, mut points: Vec<(f64, f64)>) -> Self {
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self { name: name.into(), points }
    }
}

/// The probability density over azimuth relative to its maximum, if the bearing kept its course
/// ([`keep_course`](csi5300::pipeline::Options::keep_course)).
#[must_use]
pub fn evidence(bearing: &Bearing) -> Option<Curve> {
    let density = Some(&bearing.density).filter(|density| !density.is_empty())?;
    let highest = density.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let step_rad = std::f64::consts::TAU / density.len() as f64;
    let at = |(k, value): (usize, &f64)| (wrap_rad(k as f64 * step_rad).to_degrees(), value / highest);
    Some(Curve::new("probability density", density.iter().enumerate().map(at).collect()))
}

/// The plane wave's profile over azimuth: the maximum over the |elevations| of its peaks.
///
/// # Errors
/// If the samples allow no profile.
pub fn plane_wave(bearing: &Bearing) -> Result<Curve, bartlett::Error> {
    let azimuths: Vec<f64> = (0..AZIMUTHS).map(|k| Grid::azimuth(AZIMUTHS).at(k).0).collect();
    let own = bearing.plane_wave.peaks.iter().map(|peak| peak.abs_elevation_rad);
    let mut elevations: Vec<f64> =
        own.chain([bearing.plane_wave.abs_elevation_rad]).chain(bearing.plane_wave.signed_elevation_rad).collect();
    elevations.sort_by(f64::total_cmp);
    elevations.dedup_by(|a, b| (*a - *b).abs() < 1e-3);
    let mut values = vec![0.0_f64; AZIMUTHS];
    for elevation in elevations {
        let ring = Grid::directions(azimuths.iter().map(|&azimuth| (azimuth, elevation)).collect());
        let profile = bartlett::profile(&bearing.samples, &ring)?;
        values.iter_mut().zip(profile.values).for_each(|(value, own)| *value = value.max(own));
    }
    let points = azimuths.iter().map(|azimuth| wrap_rad(*azimuth).to_degrees()).zip(values).collect();
    Ok(Curve::new("plane wave at the channel centre", points))
}

/// Residual phases of the samples after removal of the paths to the answer, about their mean: (seconds from the link's first
/// pair, radians); from the first sample if the course was not kept.
#[must_use]
pub fn without_motion(bearing: &Bearing) -> Vec<(f64, f64)> {
    let samples = &bearing.samples;
    let first_s = samples.t_s().first().copied().unwrap_or_default();
    let begun_s = bearing.course.iter().find(|phase| phase.is_used).map_or(0.0, |phase| phase.t_s);
    let times_s = samples.t_s().iter().map(|t_s| begun_s + t_s - first_s);
    times_s.zip(bearing.residuals_rad()).collect()
}
