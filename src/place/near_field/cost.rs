//! What the steps of a link take, predicted from its sizes: for plans that print, whether a step is taken or not.

use super::aperture::Aperture;
use super::search::Search;
use super::types::{Band, Limits, Taper, View};
use crate::bartlett::{Precision, pair_ns};
use crate::signal::samples::Samples;
use nalgebra::Vector3;

/// Microseconds of one core that each step takes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Cost {
    pub one_wave_us: f64,
    pub align_us: f64,
    pub one_way_us: f64,
    /// The search over places in all views, with windows.
    pub search_us: f64,
    pub focus_us: f64,
    pub paths_us: f64,
}

/// A row steered to a place, and each of its columns, in units of a pair of the plane wave's sums.
const STEERED: f64 = 0.7;
const COLUMN: f64 = 0.3;
/// Columns of the round trip's views, of the one-way channel's (which overlap), and of its whole band alone.
const COLUMNS: [f64; 3] = [9.0, 24.0, 6.0];
/// Places that are looked at beside the grid: climbs, the weighing, the polish.
const CLIMBS: f64 = 2_500.0;
/// The same of the one wave, and of autofocus for each link.
const ONE_WAVE_PLACES: f64 = 700.0;
const FOCUS_PLACES: f64 = 3_000.0;
/// Waves that paths look for on average.
const WAVES: f64 = 4.0;
/// Alignment and square root of a packet, in units of a pair.
const ALIGNED: f64 = 1_500.0;
const ROOTED: f64 = 500.0;

impl Cost {
    /// What a link of `pairs` pairs takes of which `samples` were in motion.
    pub fn of(samples: &Samples, limits: &Limits, pairs: usize) -> Self {
        let displacement_m: Vec<Vector3<f64>> = samples.displacements_m().collect();
        let middle_m = displacement_m.iter().sum::<Vector3<f64>>() / displacement_m.len().max(1) as f64;
        let size = |gain: u8| {
            let aperture = Aperture::gather_centre(&displacement_m, samples.z(), gain, samples.wavelength_m());
            let search = Search::new(
                &[(&aperture, &[View::new(1, Taper::Hann, Band::Centre)])],
                middle_m,
                samples.wavelength_m(),
                limits,
            );
            (aperture.centre.len() as f64, search.map_or(0.0, |search| search.axes.cells() as f64))
        };
        let round_trip = size(samples.path_gain());
        let one_way = size(1);
        let us = pair_ns(limits.tier, Precision::Single) * 1e-3;
        let look = |rows: f64, columns: f64| rows * (STEERED + COLUMN * columns) * us;
        let [round_columns, once_columns, band] = COLUMNS;
        let everywhere = look(round_trip.0, round_columns) + look(one_way.0, once_columns);
        Self {
            one_wave_us: ONE_WAVE_PLACES * look(round_trip.0, 1.0),
            align_us: pairs as f64 * ALIGNED * us,
            one_way_us: pairs as f64 * ROOTED * us,
            search_us: round_trip.1 * look(round_trip.0, round_columns)
                + one_way.1 * look(one_way.0, once_columns)
                + CLIMBS * everywhere,
            focus_us: FOCUS_PLACES * everywhere,
            paths_us: WAVES * round_trip.1 * look(round_trip.0, band),
        }
    }
}
