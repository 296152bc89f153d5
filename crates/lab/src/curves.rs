//! Curves of one link for pictures and pages: its profiles, and its phase with the motion removed.

use csi5300::bartlett::{self, Grid};
use csi5300::maths::wrap_rad;
use csi5300::pipeline::Bearing;
use nalgebra::Vector3;
use num_complex::Complex64;

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
    let Some(best) = bearing.answer.candidates.first() else { return Vec::new() };
    let (samples, curve) = (&bearing.samples, best.inverse_range_per_m);
    let elevation_rad = best.signed_elevation_rad.unwrap_or(best.abs_elevation_rad);
    let u = bartlett::direction(bearing.answer.azimuth_rad, elevation_rad);
    let at: Vec<Vector3<f64>> = samples.receiver_m().iter().zip(samples.transmitter_m()).map(|(r, t)| r - t).collect();
    let middle = at.iter().sum::<Vector3<f64>>() / samples.len().max(1) as f64;
    let turned = |(z, p): (&Complex64, &Vector3<f64>)| {
        let offset = p - middle;
        // The path to the answer minus that from the middle of the motion: u.p of a plane wave, curved by the range.
        let nearer_m = match curve > 0.0 {
            true => (u / curve).norm() - (u / curve - offset).norm(),
            false => u.dot(&offset),
        };
        let turns = f64::from(samples.path_gain()) * nearer_m / samples.wavelength_m();
        z * Complex64::cis(-std::f64::consts::TAU * turns)
    };
    let left: Vec<Complex64> = samples.z().iter().zip(&at).map(turned).collect();
    let mean: Complex64 = left.iter().sum();
    let first_s = samples.t_s().first().copied().unwrap_or_default();
    let begun_s = bearing.course.iter().find(|phase| phase.is_used).map_or(0.0, |phase| phase.t_s);
    samples.t_s().iter().zip(&left).map(|(t_s, z)| (begun_s + t_s - first_s, (z * mean.conj()).arg())).collect()
}
