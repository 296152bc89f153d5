//! Probabilities of places about a robot: azimuth times logarithm of the range.

use super::evidence::{Evidence, Factor};
use crate::place::track::settings::ROOM_M;
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// Cells around, and along the range.
pub(super) const AZIMUTHS: usize = 720;
const RANGES: usize = 64;
/// The nearest and the farthest range, metres; beyond it places are practically infinitely far.
const NEAREST_M: f64 = 0.5;
const FARTHEST_M: f64 = 60.0;
/// Points along the range that a moved cell is averaged over.
const WITHIN: usize = 2;
/// A narrower blur than this share of a cell is ignored.
const LEAST_BLUR: f64 = 0.05;

/// Probability of each place, in cells about a middle. Their sum is 1.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PlaceGrid {
    /// Where azimuths and ranges are measured from, metres.
    pub middle_m: Vector2<f64>,
    /// Range by range, azimuths fastest, from azimuth 0 on.
    cells: Vec<f64>,
}

impl PlaceGrid {
    /// The prior: every azimuth alike, and per area alike within `track.room_m`, per logarithm of the range beyond.
    pub fn prior(middle_m: Vector2<f64>) -> Self {
        let shares = range_shares();
        let cells = shares.iter().flat_map(|share| std::iter::repeat_n(share / AZIMUTHS as f64, AZIMUTHS)).collect();
        Self { middle_m, cells }
    }

    /// The probability of each azimuth, from 0 on; their sum is 1.
    pub fn around(&self) -> Vec<f64> {
        let mut sums = vec![0.0; AZIMUTHS];
        for row in self.cells.chunks_exact(AZIMUTHS) {
            sums.iter_mut().zip(row).for_each(|(sum, cell)| *sum += cell);
        }
        sums
    }

    /// Logarithm of each range and its probability within azimuths for which `inside` holds, by their cells.
    pub fn along(&self, inside: impl Fn(usize) -> bool) -> Vec<(f64, f64)> {
        let rows = self.cells.chunks_exact(AZIMUTHS).enumerate();
        let sum = |row: &[f64]| row.iter().enumerate().filter(|(cell, _)| inside(*cell)).map(|(_, p)| p).sum();
        rows.map(|(k, row)| (ln_range(k as f64), sum(row))).collect()
    }

    /// Multiplies every place by the likelihood of `evidence`. `false`, and nothing is changed, where no place is left.
    pub fn multiply(&mut self, evidence: &Evidence) -> bool {
        let ranges = prior_ranges();
        let (factors, rest) = evidence.factors(AZIMUTHS, &ranges);
        let fresh = evidence.fresh.clamp(0.0, 1.0);
        let mut cells = self.cells.clone();
        for (k, row) in cells.chunks_exact_mut(AZIMUTHS).enumerate() {
            let mut likelihood = vec![rest; AZIMUTHS];
            for Factor { around, along } in &factors {
                let weight = along.get(k).copied().unwrap_or(1.0);
                likelihood.iter_mut().zip(around).for_each(|(sum, value)| *sum += weight * value);
            }
            row.iter_mut().zip(&likelihood).for_each(|(cell, value)| *cell *= value.powf(fresh));
        }
        let sound = normalise(&mut cells);
        if sound {
            self.cells = cells;
        }
        sound
    }

    /// The probabilities after all evidence so far was taken to this power.
    pub fn tempered(&self, exponent: f64) -> Self {
        let prior = Self::prior(self.middle_m).cells;
        let tempered = |prior: &f64, cell: &f64| prior * (cell / prior).powf(exponent);
        let mut cells: Vec<f64> = prior.iter().zip(&self.cells).map(|(prior, cell)| tempered(prior, cell)).collect();
        match normalise(&mut cells) {
            true => Self { middle_m: self.middle_m, cells },
            false => self.clone(),
        }
    }

    /// The same probabilities about another middle.
    pub fn moved_to(&self, middle_m: Vector2<f64>) -> Self {
        let by_m = middle_m - self.middle_m;
        if by_m.norm() < 1e-6 {
            return self.clone();
        }
        let directions: Vec<(f64, f64)> = (0..AZIMUTHS).map(|k| azimuth_rad(k).sin_cos()).collect();
        let mut cells = Vec::with_capacity(self.cells.len());
        for k in 0..RANGES {
            let inner = |i: usize| ln_range(k as f64 + (i as f64 + 0.5) / WITHIN as f64 - 0.5).exp();
            let points: [f64; WITHIN] = std::array::from_fn(inner);
            cells.extend(directions.iter().map(|&(sin, cos)| {
                let at = |range_m: f64| {
                    let offset_m = by_m + Vector2::new(cos, sin) * range_m;
                    self.density(offset_m) * range_m * range_m
                };
                points.into_iter().map(at).sum::<f64>()
            }));
        }
        match normalise(&mut cells) {
            true => Self { middle_m, cells },
            false => Self::prior(middle_m),
        }
    }

    /// Probability per area at an offset from the middle, times the area of a cell at one metre: linear between centres.
    fn density(&self, offset_m: Vector2<f64>) -> f64 {
        let range_m = offset_m.norm().max(NEAREST_M);
        let across = (offset_m.y.atan2(offset_m.x) / TAU).rem_euclid(1.0) * AZIMUTHS as f64;
        let along = ((range_m / NEAREST_M).ln() / step()).clamp(0.0, (RANGES - 1) as f64);
        let (column, row) = (across as usize % AZIMUTHS, (along as usize).min(RANGES - 2));
        let (to_right, to_far) = (across - across.floor(), along - row as f64);
        let next = (column + 1) % AZIMUTHS;
        let cell = |row: usize, column: usize| self.cells.get(row * AZIMUTHS + column).copied().unwrap_or(0.0);
        let mix = |row: usize| cell(row, column) * (1.0 - to_right) + cell(row, next) * to_right;
        (mix(row) * (1.0 - to_far) + mix(row + 1) * to_far) / (range_m * range_m)
    }

    /// Blurs by a turn of the heading, radians, and by a shift of the place in x and in y, metres: standard deviations.
    pub fn blur(&mut self, turn_rad: f64, shift_m: f64) {
        for (k, row) in self.cells.chunks_exact_mut(AZIMUTHS).enumerate() {
            let sd_rad = turn_rad.hypot(shift_m / ln_range(k as f64).exp()).min(TAU);
            blur_around(row, sd_rad * AZIMUTHS as f64 / TAU);
        }
        self.blur_along(shift_m);
        if !normalise(&mut self.cells) {
            *self = Self::prior(self.middle_m);
        }
    }

    /// Along the range each row is handed on to its neighbours.
    fn blur_along(&mut self, shift_m: f64) {
        let sd = |row: usize| (shift_m / ln_range(row as f64).exp() / step()).min(RANGES as f64);
        if sd(0) < LEAST_BLUR {
            return;
        }
        let mut cells = vec![0.0; self.cells.len()];
        for (from, row) in self.cells.chunks_exact(AZIMUTHS).enumerate() {
            let kernel = kernel(sd(from));
            let half = kernel.len() as isize - 1;
            for (by, weight) in (-half..=half).map(|by| (by, kernel[by.unsigned_abs()])) {
                let to = (from as isize + by).clamp(0, RANGES as isize - 1) as usize;
                let target = &mut cells[to * AZIMUTHS..(to + 1) * AZIMUTHS];
                target.iter_mut().zip(row).for_each(|(sum, cell)| *sum += weight * cell);
            }
        }
        self.cells = cells;
    }

    /// Gives `share` of the probability back to the prior.
    pub fn forget(&mut self, share: f64) {
        let prior = Self::prior(self.middle_m);
        self.cells.iter_mut().zip(prior.cells).for_each(|(cell, prior)| *cell += share * (prior - *cell));
    }
}

/// Azimuth of a cell's centre, radians.
pub(super) fn azimuth_rad(cell: usize) -> f64 {
    TAU * cell as f64 / AZIMUTHS as f64
}

/// `ln` of the range of a row's centre; rows between two centres lie between them.
fn ln_range(row: f64) -> f64 {
    NEAREST_M.ln() + row * step()
}

fn step() -> f64 {
    (FARTHEST_M / NEAREST_M).ln() / (RANGES - 1) as f64
}

/// The prior's share of each range.
fn range_shares() -> Vec<f64> {
    let room = ROOM_M * ROOM_M;
    let share = |row: usize| {
        let square = (2.0 * ln_range(row as f64)).exp();
        square / (room + square)
    };
    let mut shares: Vec<f64> = (0..RANGES).map(share).collect();
    normalise(&mut shares);
    shares
}

/// The logarithm of each range with its share of the prior.
pub(super) fn prior_ranges() -> Vec<(f64, f64)> {
    (0..RANGES).map(|k| ln_range(k as f64)).zip(range_shares()).collect()
}

/// Divides by the sum; `false`, with nothing changed, where that is no positive number.
pub(super) fn normalise(values: &mut [f64]) -> bool {
    let sum: f64 = values.iter().sum();
    let sound = sum.is_finite() && sum > 0.0;
    if sound {
        values.iter_mut().for_each(|value| *value /= sum);
    }
    sound
}

/// Convolves the values around a circle with a normal of this standard deviation, cells.
pub(super) fn blur_around(values: &mut [f64], sd_cells: f64) {
    let kernel = kernel(sd_cells.min(values.len() as f64));
    if kernel.len() <= 1 || values.is_empty() {
        return;
    }
    let count = values.len();
    let half = (kernel.len() - 1).min(count);
    let before = values.to_vec();
    let wrapped: Vec<f64> = before.iter().copied().cycle().skip(count - half % count).take(count + 2 * half).collect();
    for (k, value) in values.iter_mut().enumerate() {
        let own = wrapped.iter().skip(k).take(2 * half + 1).enumerate();
        *value = own.map(|(i, cell)| kernel[i.abs_diff(half)] * cell).sum();
    }
    // What the kernel's cut ends would have carried.
    let (sum, meant): (f64, f64) = (values.iter().sum(), before.iter().sum());
    if sum > 0.0 {
        values.iter_mut().for_each(|value| *value *= meant / sum);
    }
}

/// Half of a normal kernel of this standard deviation, cells, from its middle on; the whole has a sum of 1.
fn kernel(sd: f64) -> Vec<f64> {
    if sd.is_nan() || sd < LEAST_BLUR {
        return vec![1.0];
    }
    // Each weight is the normal's share of its cell, so that narrow kernels have their variance too.
    let half = (4.0 * sd).ceil() as usize + 1;
    let point = |k: usize| {
        let within = (0..5).map(|i| (k as f64 + (f64::from(i) - 2.0) / 5.0) / sd);
        within.map(|x| (-0.5 * x * x).exp()).sum::<f64>()
    };
    let mut kernel: Vec<f64> = (0..=half).map(point).collect();
    let sum = 2.0 * kernel.iter().sum::<f64>() - kernel[0];
    kernel.iter_mut().for_each(|weight| *weight /= sum);
    kernel
}
