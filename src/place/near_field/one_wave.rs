//! Whether one wave explains the samples at the channel centre but for noise. Where it does, it is the most likely answer,
//! and neither other subcarriers nor windows nor other paths can move it by more than what hides in the noise.
//!
//! From the plane wave's direction a climb over azimuth, elevation and range, then least squares of the residual phases.
//! What is left is compared with noise in three ways: its slow components (a place, a bent trajectory), neighbouring rows
//! (anything smooth), and its highest Bartlett peak (another path). A wave of amplitude `b` leaves phases `b sin(psi)`, half
//! of which are a wave of its direction: one that stays below a peak of `p` times what noise has on average is no stronger
//! than `2 sqrt(p / n)` times the noise of `n` rows, and moves the azimuth by at most `sqrt(2 p)` times the deviation that
//! the noise leaves.

use super::aperture::Aperture;
use super::fix::{Fix, Source};
use super::likeliest::{Settled, settled};
use super::mirror::{decisive, log_odds};
use super::search::Search;
use super::types::{Band, Elevations, Free, Limits, Place, Precision, Taper, View};
use super::uncertainty::{correlation_rows, deviations, noise_rad};
use super::waves::Waves;
use crate::bartlett::{Estimate, Searcher};
use crate::maths::wrap_rad;
use crate::signal::samples::Samples;
use crate::tuning::TUNING;
use nalgebra::Vector3;
use num_complex::Complex64;
use std::f64::consts::{FRAC_PI_2, TAU};
use std::fmt;

/// The one view: the phase at the channel centre over the whole motion.
const WHOLE: [View; 1] = [View::new(1, Taper::Hann, Band::Centre)];
/// Azimuths on either side of the plane wave's, and their distance in cells of the grid.
const BESIDE: (i32, f64) = (8, 0.25);

/// Why one wave is not the whole answer.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Unexplained {
    /// Too few rows along the motion to tell noise from anything else.
    FewRows(usize),
    /// No climb from the plane wave's direction leads to a place within the limits of the search.
    NoPlace,
    /// What is left varies slowly along the motion: so many rows share an error, where noise has one.
    SlowErrors(f64),
    /// What is left goes on from row to row: their correlation over what noise leaves of it.
    Neighbours(f64),
    /// What is left is another wave: its highest peak over what noise alone would make of it.
    AnotherWave(f64),
    /// Another direction, or a mirror image, explains the samples about as well.
    Ambiguous,
    /// The noise could hide a wave that moves the azimuth by so much, radians.
    Noise(f64),
}

impl fmt::Display for Unexplained {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::FewRows(rows) => {
                write!(f, "{rows} rows along the motion are too few to tell noise from anything else")
            }
            Self::NoPlace => f.write_str("no place within the limits of the search explains the samples but for noise"),
            Self::SlowErrors(rows) => write!(f, "{rows:.1} rows along the motion share an error, where noise has one"),
            Self::Neighbours(times) => write!(f, "neighbouring rows share {times:.1} times what noise leaves in them"),
            Self::AnotherWave(times) => {
                write!(f, "another wave is there, {times:.1} times what noise may be taken for")
            }
            Self::Ambiguous => f.write_str("another direction explains the samples about as well"),
            Self::Noise(rad) => {
                write!(f, "the noise could hide a wave that moves the azimuth by {:.2} degrees", rad.to_degrees())
            }
        }
    }
}

/// One wave that leaves nothing but noise.
#[derive(Clone, Debug)]
pub(crate) struct OneWave {
    /// The answer.
    pub fix: Fix,
    /// How far a wave that the noise hides may have moved the azimuth, radians.
    pub risk_rad: f64,
}

/// A motion's samples at the channel centre, ready for one wave.
pub(crate) struct CentreWave {
    aperture: Aperture,
    search: Search,
    middle_m: Vector3<f64>,
    wavelength_m: f64,
}

impl CentreWave {
    /// The samples in rows, about the mean of their displacements; `None` where there is nothing to search.
    pub fn new(samples: &Samples, limits: &Limits) -> Option<Self> {
        let wavelength_m = samples.wavelength_m();
        let displacement_m: Vec<Vector3<f64>> = samples.displacements_m().collect();
        let middle_m = displacement_m.iter().sum::<Vector3<f64>>() / displacement_m.len().max(1) as f64;
        let aperture = Aperture::gather_centre(&displacement_m, samples.z(), samples.path_gain(), wavelength_m);
        let search = Search::new(&[(&aperture, &WHOLE)], middle_m, wavelength_m, limits)?;
        Some(Self { aperture, search, middle_m, wavelength_m })
    }

    /// The one wave next to `plane_wave`, if it leaves nothing but noise.
    ///
    /// # Errors
    /// What else there is.
    pub fn explain(&mut self, plane_wave: &Estimate) -> Result<OneWave, Unexplained> {
        let rows = self.aperture.centre.len();
        // Fewer have no slow components apart from the others.
        if rows < 4 * TUNING.deviations.slow_turns {
            return Err(Unexplained::FewRows(rows));
        }
        let source = self.climb_from(plane_wave);
        let (source, free) = self.likeliest(source)?;
        self.unambiguous(&source, plane_wave)?;
        let waves = Waves::at_centre(&self.aperture, &self.middle_m, self.wavelength_m, free);
        let place = [source.azimuth_rad, source.elevation_rad(), source.inverse_range_per_m];
        let left = Left::of(&waves, place);
        let peak = self.peak(&waves, place, &left, plane_wave)?;
        let risk_rad = (2.0 * peak).sqrt() * noise_rad(&waves, place);
        Ok(OneWave { fix: self.fix(source, free), risk_rad })
    }

    /// The search behind it, for pictures.
    pub fn into_search(self) -> Search {
        self.search
    }

    /// Which coordinates the search leaves open.
    fn free(&self) -> Free {
        Free { elevation: self.search.axes.elevations.len() > 1, range: self.search.axes.curves.len() > 1 }
    }

    /// The top above the best of a few places about the plane wave.
    fn climb_from(&mut self, plane_wave: &Estimate) -> Source {
        let cell_rad = TAU / self.search.axes.azimuths as f64;
        let elevation_rad = plane_wave.signed_elevation_rad.unwrap_or(plane_wave.abs_elevation_rad);
        let elevations: Vec<f64> = match self.search.limits.elevations {
            Elevations::Expected => self.search.axes.elevations.clone(),
            // A motion that shows no sign to a plane wave may show it to a curved one.
            Elevations::Signed => vec![elevation_rad, -elevation_rad],
            Elevations::Beyond => vec![elevation_rad],
        };
        let mut places = Vec::new();
        for k in -BESIDE.0..=BESIDE.0 {
            let azimuth = plane_wave.azimuth_rad + f64::from(k) * BESIDE.1 * cell_rad;
            for &elevation in &elevations {
                places.extend(self.search.axes.curves.iter().map(|&curve| Place { azimuth, elevation, curve }));
            }
        }
        let powers = self.search.powers(&places, Precision::Rough);
        let best = powers.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(k, _)| k);
        self.search.judged_top(places[best])
    }

    /// The place of least residual phase next to `source`, with what is free there.
    fn likeliest(&mut self, mut source: Source) -> Result<(Source, Free), Unexplained> {
        let signed = source.signed_elevation_rad.is_some();
        let [lowest, highest] = self.search.limits.elevation_span_rad();
        let waves = |free| Waves::at_centre(&self.aperture, &self.middle_m, self.wavelength_m, free);
        let at = [source.azimuth_rad, source.elevation_rad(), source.inverse_range_per_m];
        let reach_rad = TUNING.deviations.polish_cells * TAU / self.search.axes.azimuths as f64;
        let mut found = settled(waves, at, self.free(), signed, reach_rad).ok_or(Unexplained::NoPlace)?;
        if found.free.elevation && !found.free.range && !signed && found.place[1] > highest {
            // Higher than is expected: the highest that is stands for it, if that leaves nothing but noise too.
            let at = [found.place[0], highest, found.place[2]];
            let free = Free { elevation: false, ..found.free };
            found = settled(waves, at, free, signed, reach_rad).ok_or(Unexplained::NoPlace)?;
        }
        let Settled { place, free } = found;
        Left::of(&waves(free), place).is_noise()?;
        if !(lowest..=highest).contains(&place[1]) || place[2] > self.search.curve_max {
            return Err(Unexplained::NoPlace);
        }
        (source.azimuth_rad, source.abs_elevation_rad) = (wrap_rad(place[0]), place[1].abs());
        source.signed_elevation_rad = signed.then_some(place[1]);
        source.inverse_range_per_m = place[2];
        let power = self.search.powers(&[Place::from(&source)], Precision::Exact)[0];
        (source.power, source.evidence) = (f64::from(power), f64::from(power));
        Ok((source, free))
    }

    /// Refuses an answer beside which another direction of the plane wave's, or a mirror image of motion in space, leaves a
    /// doubt. The mirror of a line is as likely for every estimate, and no reason to go on.
    fn unambiguous(&mut self, source: &Source, plane_wave: &Estimate) -> Result<(), Unexplained> {
        let apart_rad = 2.0 * TAU / self.search.axes.azimuths as f64;
        let near = |azimuth_rad: f64, other_rad: f64| wrap_rad(azimuth_rad - other_rad).abs() < apart_rad;
        let on_a_line = plane_wave.mirror_normal.is_some_and(|normal| normal.z == 0.0);
        let mirror = plane_wave.mirror_rad.filter(|_| on_a_line);
        let own =
            |azimuth_rad: f64| near(azimuth_rad, source.azimuth_rad) || mirror.is_some_and(|m| near(azimuth_rad, m));
        let others = plane_wave.peaks.iter().filter(|peak| !own(peak.azimuth_rad));
        let doubtful = others.map(|peak| peak.value).any(|value| !decisive(log_odds(source.power, value)));
        let mut sources = vec![*source];
        self.search.compare_with_mirror(&mut sources);
        let mirrored =
            sources.len() > 1 || sources.first().is_some_and(|s| s.signed_elevation_rad != source.signed_elevation_rad);
        match doubtful || mirrored || plane_wave.mirror_rad.is_some() && !on_a_line {
            true => Err(Unexplained::Ambiguous),
            false => Ok(()),
        }
    }

    /// The highest Bartlett peak of what is left, in units of what noise has on average.
    fn peak(
        &self,
        waves: &Waves<'_, 1>,
        place: [f64; 3],
        left: &Left,
        plane_wave: &Estimate,
    ) -> Result<f64, Unexplained> {
        let mut rest = Samples::new(self.wavelength_m, self.aperture.path_gain).map_err(|_| Unexplained::NoPlace)?;
        let way = waves.points().iter().zip(waves.steering(place)).zip(&left.0);
        for (k, ((p, back), e)) in way.enumerate() {
            // As it was before the wave was taken out of it.
            let value = Complex64::new(0.0, *e) * back.conj();
            rest.push(k as f64, value, *p, Vector3::zeros()).map_err(|_| Unexplained::NoPlace)?;
        }
        let highest_rad = if plane_wave.elevation_searched { self.search.limits.elevation_span_rad()[1] } else { 0.0 };
        // Nothing is left at all, or nothing that could be searched.
        let Ok(found) = Searcher::new(self.search.limits.tier).search(&rest, highest_rad.clamp(0.0, FRAC_PI_2)) else {
            return Ok(1.0);
        };
        let sizes: f64 = left.0.iter().map(|e| e * e).sum();
        let sum: f64 = left.0.iter().map(|e| e.abs()).sum();
        let peak = found.value * sum * sum / sizes;
        let cells = (2 * found.plan.band_limit + 1) * found.plan.rings.max(1);
        let most = (cells as f64 / TUNING.effort.false_alarms).ln();
        if peak > most { Err(Unexplained::AnotherWave(peak / most)) } else { Ok(peak) }
    }

    fn fix(&mut self, source: Source, free: Free) -> Fix {
        let [lowest_rad, highest_rad] = self.search.limits.elevation_span_rad();
        let prior = [(highest_rad - lowest_rad) / 12f64.sqrt(), self.search.curve_max / 12f64.sqrt()];
        let searched = self.free();
        let waves = Waves::at_centre(&self.aperture, &self.middle_m, self.wavelength_m, free);
        Fix {
            deviations: deviations(&waves, &source, prior),
            azimuth_rad: source.azimuth_rad,
            middle_m: self.middle_m,
            view_azimuths_rad: vec![source.azimuth_rad],
            view_powers: vec![source.power],
            range_searched: searched.range,
            elevation_searched: searched.elevation,
            range_min_m: 1.0 / self.search.curve_max,
            elevation_max_rad: highest_rad,
            evaluations: self.search.evaluations,
            sources: vec![source],
        }
    }
}

/// What one wave leaves of the samples: residual phases, radians. Their sizes say nothing, being those of sums over runs.
struct Left(Vec<f64>);

impl Left {
    fn of(waves: &Waves<'_, 1>, place: [f64; 3]) -> Self {
        let mut phases = waves.residual(place);
        let mean = phases.iter().sum::<f64>() / phases.len().max(1) as f64;
        phases.iter_mut().for_each(|e| *e -= mean);
        Self(phases)
    }

    /// # Errors
    /// If it varies slowly along the motion, or goes on from row to row.
    fn is_noise(&self) -> Result<(), Unexplained> {
        let rows = correlation_rows(&self.0);
        if rows > TUNING.deviations.white_rows {
            return Err(Unexplained::SlowErrors(rows));
        }
        let energy: f64 = self.0.iter().map(|e| e * e).sum();
        let along: f64 = self.0.windows(2).map(|pair| pair[0] * pair[1]).sum();
        let shared = along.abs() / energy.max(f64::MIN_POSITIVE) * (self.0.len() as f64).sqrt();
        if shared > TUNING.effort.neighbours { Err(Unexplained::Neighbours(shared)) } else { Ok(()) }
    }
}
