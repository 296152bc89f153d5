//! Channel rows along a trajectory, thinned to what the wavelength asks for.

use crate::signal::alignment::CsiRow;
use crate::signal::channel::SUBCARRIERS;
use crate::tuning::TUNING;
use nalgebra::Vector3;
use num_complex::{Complex32, Complex64};

/// The synthetic array: rows of channel samples and where they were taken.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Aperture {
    /// `receiver - transmitter displacement` for each row, metres, trajectory frame.
    pub displacement_m: Vec<Vector3<f64>>,
    /// One value per subcarrier.
    pub rows: Vec<CsiRow>,
    /// The phasor at the channel centre of each row, by a line fitted to the phases of all subcarriers; empty where there
    /// is none. Views that look at no subcarrier look at it.
    pub centre: Vec<Complex32>,
    /// How often the path is in them: 2 for round trips, 1 for one way.
    pub path_gain: u8,
}

impl Aperture {
    /// Gathers `rows` taken at `displacement_m`, averaging runs that lie within a small part of a wavelength.
    /// Surplus entries of the longer list are left out.
    #[must_use]
    pub fn gather(displacement_m: &[Vector3<f64>], rows: &[CsiRow], path_gain: u8, wavelength_m: f64) -> Self {
        let n = displacement_m.len().min(rows.len());
        Self::gather_by(&displacement_m[..n], |k| rows[k], &[], path_gain, wavelength_m)
    }

    /// The same of the rows that `row` gives by their number, with a sample at the channel centre for each, of which the phase
    /// is kept; none if there are fewer of them than rows.
    #[must_use]
    pub fn gather_by(
        displacement_m: &[Vector3<f64>],
        row: impl Fn(usize) -> CsiRow,
        centre: &[Complex64],
        path_gain: u8,
        wavelength_m: f64,
    ) -> Self {
        let reach_m = TUNING.aperture.span_turns * wavelength_m / f64::from(path_gain.max(1));
        let mut aperture = Self { path_gain: path_gain.max(1), ..Self::default() };
        let n = displacement_m.len();
        let runs = runs(displacement_m, reach_m);
        aperture.displacement_m.reserve(runs.len());
        aperture.rows.reserve(runs.len());
        for (from, to) in runs {
            aperture.displacement_m.push(mean_place(&displacement_m[from..to]));
            aperture.rows.push(mean_row((from..to).map(&row)));
            aperture.centre.extend(centre.get(..n).map(|centre| mean_phasor(&centre[from..to])));
        }
        aperture
    }

    /// The same of samples at the channel centre alone, without any row.
    #[must_use]
    pub fn gather_centre(
        displacement_m: &[Vector3<f64>],
        centre: &[Complex64],
        path_gain: u8,
        wavelength_m: f64,
    ) -> Self {
        let reach_m = TUNING.aperture.span_turns * wavelength_m / f64::from(path_gain.max(1));
        let mut aperture = Self { path_gain: path_gain.max(1), ..Self::default() };
        for (from, to) in runs(displacement_m, reach_m) {
            aperture.displacement_m.push(mean_place(&displacement_m[from..to]));
            aperture.centre.extend(centre.get(from..to).map(mean_phasor));
        }
        aperture
    }

    /// Length of the path from row to row, metres.
    #[must_use]
    pub fn path_m(&self) -> f64 {
        self.displacement_m.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
    }
}

fn mean_row(rows: impl ExactSizeIterator<Item = CsiRow>) -> CsiRow {
    let share = (1.0 / rows.len() as f64) as f32;
    let mut mean = [Complex32::default(); SUBCARRIERS];
    for row in rows {
        mean.iter_mut().zip(&row).for_each(|(sum, value)| *sum += value * share);
    }
    mean
}

/// Runs of samples within `reach_m` of their first: where each begins and ends.
pub(crate) fn runs(displacement_m: &[Vector3<f64>], reach_m: f64) -> Vec<(usize, usize)> {
    let (mut runs, mut from) = (Vec::new(), 0);
    for (k, p) in displacement_m.iter().enumerate() {
        if (p - displacement_m[from]).norm() > reach_m {
            runs.push((from, k));
            from = k;
        }
    }
    if !displacement_m.is_empty() {
        runs.push((from, displacement_m.len()));
    }
    runs
}

fn mean_place(positions: &[Vector3<f64>]) -> Vector3<f64> {
    positions.iter().sum::<Vector3<f64>>() / positions.len() as f64
}

/// The mean of the samples' directions.
fn mean_phasor(samples: &[Complex64]) -> Complex32 {
    let unit = |z: &Complex64| Some(z / z.norm()).filter(|unit| unit.is_finite()).unwrap_or_default();
    let mean = samples.iter().map(unit).sum::<Complex64>() / samples.len() as f64;
    Complex32::new(mean.re as f32, mean.im as f32)
}
