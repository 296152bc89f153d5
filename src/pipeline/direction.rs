//! The plane wave of a link, and which elevations are worth a search over places.
//!
//! The largest elevation of the options is what is expected of robots on a floor. Level motion is searched beyond it where
//! the samples leave no doubt; motion that distinguishes up from down is searched from the nadir to the zenith.

use super::options::Options;
use crate::bartlett::{self, Estimate, Grid, Searcher};
use crate::place::near_field::Elevations;
use crate::place::near_field::aperture::runs;
use crate::place::near_field::mirror::{decisive, log_odds};
use crate::signal::samples::Samples;
use crate::tuning::TUNING;
use nalgebra::Vector3;
use num_complex::Complex64;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Azimuths on either side of the answer's that its opposite is looked for at, and their distance in half widths of a beam.
const BESIDE: (i32, f64) = (12, 0.5);
/// Samples within so many turns of each other are summed for a rough look, and what such a sum keeps of a wave's power in
/// the worst case: `sinc(0.25)^2`.
const ROUGH_TURNS: f64 = 0.25;
const KEPT: f64 = 0.81;
/// An elevation above this share of its limit is at the limit.
const EDGE: f64 = 0.995;

/// The best plane wave, and the elevations in which the best spherical wave is to be searched.
#[derive(Clone, Debug)]
pub(super) struct Direction {
    pub plane_wave: Estimate,
    pub elevations: Elevations,
    /// True if level motion's plane wave lies beyond the elevations that are expected: a curved wave front may do so too.
    pub beyond: bool,
    /// True if the plane wave is at the largest elevation that was searched.
    pub at_edge: bool,
}

impl Direction {
    /// # Errors
    /// As [`bartlett::search`].
    pub fn of(samples: &Samples, options: &Options) -> Result<Self, bartlett::Error> {
        let limit_rad = options.search.elevation_max_rad;
        let mut searcher = Searcher::new(options.search.tier).with_parallel(options.parallel);
        let within = searcher.search_with(samples, limit_rad, options.search.odometry_sd_m)?;
        let at_limit = within.elevation_searched && within.abs_elevation_rad > EDGE * limit_rad;
        let reach = Reach::of(samples, &within);
        let clear = reach == Reach::Level && !at_limit && within.value >= TUNING.elevation.clear;
        let asked = limit_rad > 0.0 && (within.elevation_searched || reach != Reach::Level);
        let elevations = Elevations::Expected;
        let expected =
            Self { plane_wave: within, elevations, beyond: false, at_edge: at_limit && limit_rad < FRAC_PI_2 };
        if !asked || clear {
            return Ok(expected);
        }
        let within = &expected.plane_wave;
        // Of level motion a higher plane wave has to leave no doubt; of low motion, so may one that is told from its mirror
        // image, whatever that one explains.
        let other = if reach == Reach::Level { within.value } else { 0.0 };
        if reach != Reach::Tall && within.elevation_searched && hopeless(&mut searcher, samples, other, options)? {
            return Ok(expected);
        }
        let free = searcher.search_with(samples, FRAC_PI_2, options.search.odometry_sd_m)?;
        let signed = reach == Reach::Tall || free.elevation_searched && tells_up(samples, &free)?;
        let elevations = if signed { Elevations::Signed } else { elevations };
        Ok(Self { elevations, ..expected }.or(free))
    }

    /// True if elevations are worth a search: the plane wave shows them, or the motion is tall enough for any wave to.
    pub fn elevation_searched(&self) -> bool {
        self.plane_wave.elevation_searched || self.elevations == Elevations::Signed
    }

    /// `free`, searched up to the zenith, if it lies beyond what is expected and the samples leave no doubt, or if only in it
    /// the elevation can be observed.
    fn or(self, free: Estimate) -> Self {
        let searched_alike = free.elevation_searched == self.plane_wave.elevation_searched;
        if searched_alike && !decisive(log_odds(free.value, self.plane_wave.value)) {
            return self;
        }
        Self { plane_wave: free, beyond: self.elevations != Elevations::Signed, at_edge: false, ..self }
    }
}

/// How far a motion reaches up and down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reach {
    /// Not enough to distinguish up from down, or along a line, where elevation and azimuth have the same effect.
    Level,
    /// Perhaps: heights may be a drift of the odometry's, and only the samples say whether they are.
    Low,
    /// Enough.
    Tall,
}

impl Reach {
    fn of(samples: &Samples, plane_wave: &Estimate) -> Self {
        let heights = || samples.displacements_m().map(|p| p.z);
        let (low_m, high_m) = heights().fold((f64::MAX, f64::MIN), |(low, high), z| (low.min(z), high.max(z)));
        let (half_m, turn_m) = (0.5 * (high_m - low_m), samples.wavelength_m() / f64::from(samples.path_gain()));
        // Where a plane wave explains little its geometry class says little: a line is one by its places here.
        let [longest_m, wide_m, _] = plane_wave.shape.half_extent_m;
        let least_m = TUNING.elevation.level_turns * turn_m;
        match half_m {
            _ if half_m < least_m || wide_m < least_m => Self::Level,
            _ if half_m < TUNING.elevation.tall * longest_m => Self::Low,
            _ => Self::Tall,
        }
    }
}

/// True if no plane wave up to the zenith can be so much better than one that explains `other` of the power as to leave no
/// doubt: by sums over runs of samples, which keep [`KEPT`] of a wave's power at least, and cost a fraction of what the samples do.
fn hopeless(
    searcher: &mut Searcher,
    samples: &Samples,
    other: f64,
    options: &Options,
) -> Result<bool, bartlett::Error> {
    let reach_m = ROUGH_TURNS * samples.wavelength_m() / f64::from(samples.path_gain());
    let mut rough = Samples::new(samples.wavelength_m(), samples.path_gain())?;
    let displacement_m: Vec<Vector3<f64>> = samples.displacements_m().collect();
    let mut sizes = 0.0;
    for (from, to) in runs(&displacement_m, reach_m) {
        let sum: Complex64 = samples.z()[from..to].iter().sum();
        let middle_m = displacement_m[from..to].iter().sum::<Vector3<f64>>() / (to - from) as f64;
        sizes += sum.norm();
        rough.push(samples.t_s()[from], sum, middle_m, Vector3::zeros())?;
    }
    let whole: f64 = samples.z().iter().map(|z| z.norm()).sum();
    let found = searcher.search_with(&rough, FRAC_PI_2, options.search.odometry_sd_m)?;
    let most = (found.value * (sizes / whole).powi(2) / KEPT).min(1.0);
    Ok(!decisive(log_odds(most, other)))
}

/// True if the samples leave no doubt whether the plane wave comes from above or from below.
fn tells_up(samples: &Samples, plane_wave: &Estimate) -> Result<bool, bartlett::Error> {
    // On a circle of `r` turns a beam is 1.126 / (2 pi r) wide from its top to half of its height.
    let turn_m = samples.wavelength_m() / f64::from(samples.path_gain());
    let half_width_rad = 1.126 * turn_m / (TAU * plane_wave.shape.half_extent_m[0]);
    let azimuth = |k: i32| plane_wave.azimuth_rad + f64::from(k) * BESIDE.1 * half_width_rad;
    let ring = |elevation_rad: f64| (-BESIDE.0..=BESIDE.0).map(move |k| (azimuth(k), elevation_rad));
    let highest = |elevation_rad: f64| -> Result<f64, bartlett::Error> {
        let profile = bartlett::profile(samples, &Grid::directions(ring(elevation_rad).collect()))?;
        Ok(profile.values.into_iter().fold(0.0, f64::max))
    };
    let (above, below) = (highest(plane_wave.abs_elevation_rad)?, highest(-plane_wave.abs_elevation_rad)?);
    Ok(decisive(log_odds(above.max(below), above.min(below))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::channel::Channel;

    /// A circle of 0.4 m whose height drifts by some millimetres, and a wave from `elevation_rad` with phases that are off by
    /// up to `off_rad`.
    fn drifting(options: &Options, elevation_rad: f64, off_rad: f64, seed: u64) -> Samples {
        let mut state = seed;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1u32 << 24) - 0.5
        };
        let wavelength_m = options.channel.wavelength_m();
        let mut samples = Samples::new(wavelength_m, 2).unwrap();
        let towards = bartlett::direction(0.3 * seed as f64, elevation_rad);
        for k in 0..700 {
            let (sin, cos) = (TAU * f64::from(k) / 700.0).sin_cos();
            let at = Vector3::new(0.4 * cos, 0.4 * sin, 0.012 * sin);
            let phase = 2.0 * TAU * towards.dot(&at) / wavelength_m + 2.0 * off_rad * random();
            samples.push(0.01 * f64::from(k), Complex64::cis(phase), at, Vector3::zeros()).unwrap();
        }
        samples
    }

    #[test]
    fn the_rough_look_never_hides_what_would_leave_no_doubt() {
        let options = Options::new("108".parse::<Channel>().unwrap());
        let mut looks = [0, 0];
        for seed in 0..24 {
            let (elevation_rad, off_rad) = (0.05 * seed as f64, 0.9 + 0.1 * (seed % 16) as f64);
            let samples = drifting(&options, elevation_rad, off_rad, seed);
            let within = bartlett::search(&samples, &options.search).unwrap();
            let free = bartlett::search(&samples, &options.search.with_elevation_max_rad(FRAC_PI_2)).unwrap();
            assert!(Reach::of(&samples, &within) == Reach::Low && free.elevation_searched);
            for other in [0.0, within.value] {
                let mut searcher = Searcher::new(options.search.tier);
                let is_hopeless = hopeless(&mut searcher, &samples, other, &options).unwrap();
                looks[usize::from(is_hopeless)] += 1;
                assert!(!is_hopeless || !decisive(log_odds(free.value, other)), "{seed} {other} {}", free.value);
            }
        }
        assert!(looks[0] > 5 && looks[1] > 5, "{looks:?}");
    }
}
