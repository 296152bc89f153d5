//! The joint power over azimuth and elevation, and over azimuth and range, and the evidence over azimuth: for pictures.

use super::fix::Source;
use super::prior;
use super::search::{Search, scores};
use super::types::{Place, Precision};
use crate::maths::wrap_rad;
use std::f64::consts::{PI, TAU};

/// What the azimuth of an answer was chosen from: the evidence of every azimuth, `(mean of P^n)^(1/n)` of the joint power
/// `P` over the elevations and ranges that an azimuth may have.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Evidence {
    /// Azimuths, radians in (-pi, pi], rising: even around the circle, closer about the answer, and those of all sources.
    pub azimuths_rad: Vec<f64>,
    /// Evidence of each, 0..1.
    pub values: Vec<f64>,
}

/// Two maps of the joint power, each the highest over the coordinate that it does not show.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Maps {
    /// Cells over azimuth, of equal width over -180 to 180 degrees.
    pub azimuths: usize,
    /// Elevation of each row of `over_elevation`, radians: from the horizon up, or from the nadir where the motion
    /// distinguishes up from down.
    pub elevations_rad: Vec<f64>,
    /// 1 / range of each row of `over_range`, 1/m.
    pub curves_per_m: Vec<f64>,
    /// `over_elevation[row * azimuths + azimuth]`, 0..1.
    pub over_elevation: Vec<f64>,
    /// `over_range[row * azimuths + azimuth]`, 0..1.
    pub over_range: Vec<f64>,
}

/// Azimuths on either side of the answer that are closer than those of the circle, and their distance, radians.
const CLOSE: (i32, f64) = (60, 0.1 * PI / 180.0);

/// Rows of a map.
const ROWS: usize = 24;

impl Search {
    /// The evidence over azimuth: of `azimuths` of them even around the circle, of those of `sources`, and of some close to the
    /// first of these, whose peak may be narrower than a step around the circle. The elevations
    /// and ranges of the sources are looked at beside the grid's, which may miss a narrow peak between two of its own.
    #[must_use]
    pub fn evidence(&mut self, azimuths: usize, sources: &[Source]) -> Evidence {
        let even = (1..=azimuths).map(|k| TAU * k as f64 / azimuths as f64 - PI);
        let (count, step_rad) = CLOSE;
        let steps = (-count..=count).filter(|k| *k != 0);
        let close = sources
            .first()
            .into_iter()
            .flat_map(|first| steps.clone().map(move |k| wrap_rad(first.azimuth_rad + f64::from(k) * step_rad)));
        let own = sources.iter().map(|source| source.azimuth_rad);
        let mut azimuths_rad: Vec<f64> = even.chain(own).chain(close).collect();
        azimuths_rad.sort_by(f64::total_cmp);
        let depth = self.axes.elevations.len() * self.axes.curves.len();
        let column: Vec<Place> =
            self.axes.places().into_iter().take(depth).chain(sources.iter().map(Place::from)).collect();
        let (shares, weight) =
            (prior::shares(&self.axes, self.limits.elevation_max_rad), self.weights.choosing.iter().sum());
        let mut value = |azimuth: &f64| {
            let places: Vec<Place> = column.iter().map(|place| Place { azimuth: *azimuth, ..*place }).collect();
            let powers = self.powers(&places, Precision::Exact);
            let all = scores(&powers, &self.weights.choosing);
            let highest = all.iter().copied().fold(f64::MIN, f64::max);
            let averaging = prior::averaging(all.get(..depth).unwrap_or_default(), &shares, weight);
            self.power(highest + averaging).min(1.0)
        };
        let values = azimuths_rad.iter().map(&mut value).collect();
        Evidence { azimuths_rad, values }
    }

    /// Both maps, with `azimuths` cells around.
    #[must_use]
    pub fn maps(&mut self, azimuths: usize) -> Maps {
        let spread = |values: &[f64]| -> Vec<f64> {
            let (Some(&low), Some(&high)) = (values.first(), values.last()) else { return Vec::new() };
            let rows = if values.len() > 1 { ROWS } else { 1 };
            (0..rows).map(|row| low + (high - low) * row as f64 / (ROWS - 1) as f64).collect()
        };
        let elevations = spread(&self.axes.elevations);
        let curves = spread(&self.axes.curves);
        let mut maps = Maps {
            azimuths,
            over_elevation: vec![0.0; azimuths * elevations.len()],
            over_range: vec![0.0; azimuths * curves.len()],
            elevations_rad: elevations,
            curves_per_m: curves,
        };
        for column in 0..azimuths {
            let azimuth = TAU * (column as f64 + 0.5) / azimuths as f64 - PI;
            let places: Vec<Place> = maps
                .elevations_rad
                .iter()
                .flat_map(|&elevation| maps.curves_per_m.iter().map(move |&curve| Place { azimuth, elevation, curve }))
                .collect();
            for (cell, power) in self.joint_powers(&places).into_iter().enumerate() {
                let (row, curve) = (cell / maps.curves_per_m.len(), cell % maps.curves_per_m.len());
                let by_elevation = &mut maps.over_elevation[row * azimuths + column];
                *by_elevation = by_elevation.max(power);
                let by_range = &mut maps.over_range[curve * azimuths + column];
                *by_range = by_range.max(power);
            }
        }
        maps
    }
}
