//! Where a peer is, from one stretch of motion after another: a filter over its place.
//!
//! A bearing knows one stretch of motion. Where several directions explain it, the next stretch, driven elsewhere, often
//! decides between them: [`PeerTrack`] holds the probability of every place of the peer on a grid over azimuth and the
//! logarithm of the range about the robot, and each stretch does two things to it:
//!
//! * motion: the grid is moved to where the robot is, blurred by what odometry gets wrong over the way driven; a
//!   little of the prior comes back;
//! * evidence ([`Evidence`]): the probability of each place is multiplied by `1 - known + known x sum share x N(azimuth)`,
//!   the likelihood of a bearing that is one of its candidates or, with `1 - known`, none of them; with the range where the
//!   wave front's curvature showed one.
//!
//! What this decides: the mirror image of a line, side lobes and products of paths lie elsewhere for every motion. What it
//! decides only in part: a reflection in a flat wall has an image that stands as still as the transmitter. It loses where
//! the robot goes so far that the wall ends, that the straight path is free, or that ranges tell the two apart.
//!
//! No clocks and no sockets: times and positions are arguments, and the same evidence gives the same answer.

use crate::maths::{UNIFORM_RAD, wrap_rad};
use nalgebra::{Matrix2, Vector2};
use serde::Serialize;
use std::f64::consts::TAU;

/// Contribution of each motion after the first to the exponent of the combined evidence; the first adds 1 (least Brier
/// score of carried bearings, 30 places, four trajectories, halves to eighths).
const OWN_SHARE: f64 = 0.3;

/// Peers are as likely per area up to here, and per logarithm of the range beyond, metres (half of a room).
const ROOM_M: f64 = 4.0;

/// A range is reported where its predicted deviation is below this share of it.
const RANGE_SHARE: f64 = 0.35;

/// Relative error that no range is better than (one range in six is off by more).
const RANGE_FLOOR: f64 = 0.3;

/// Share of ranges that are wrong whatever their deviation (ranges behind walls and by bent trajectories are wrong by
/// metres).
const RANGE_MISSED: f64 = 0.5;

/// Least wander of a heading, degrees after one metre (motion capture).
const TURN_DEG_PER_RT_M: f64 = 0.2;

/// Error of positions as a share of the way driven.
const SLIP: f64 = 0.01;

/// A peer that is silent for longer counts as lost, seconds (longer than a window of a live estimator).
const GONE_S: f64 = 300.0;

/// Share of the evidence that every motion returns to the prior (a peer that was carried elsewhere is found there after
/// two motions).
const FORGOTTEN: f64 = 0.02;

/// The power that the evidence of `known` motions together is taken to (each counts as the probability that one of its
/// directions is right): motions are deceived together, and each after the first counts as a share of one that is
/// deceived by itself.
fn temper(known: f64) -> f64 {
    let known = known.max(1.0);
    (1.0 + (known - 1.0) * OWN_SHARE) / known
}

/// One direction that a stretch may be explained by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EvidenceMode {
    /// Azimuth, radians, from +x towards +y in the trajectory's frame.
    pub azimuth_rad: f64,
    /// Standard deviation of the azimuth if this is the right one, radians.
    pub sd_rad: f64,
    /// Its share of all modes, in any common unit.
    pub share: f64,
    /// Horizontal range and its standard deviation, metres, where they were observed.
    pub range_m: Option<(f64, f64)>,
}

impl EvidenceMode {
    fn is_usable(&self) -> bool {
        let range = self.range_m.is_none_or(|(range_m, sd_m)| range_m > 0.0 && range_m.is_finite() && sd_m >= 0.0);
        let positive = self.sd_rad > 0.0 && self.sd_rad.is_finite() && self.share >= 0.0 && self.share.is_finite();
        self.azimuth_rad.is_finite() && positive && range
    }
}

/// The evidence of one stretch of motion about a peer's place; [`crate::pipeline::Bearing::evidence`] makes it from a bearing.
#[derive(Clone, Debug, PartialEq)]
pub struct Evidence {
    /// Time of the stretch's last sample, seconds on the trajectory's clock.
    pub t_s: f64,
    /// Where its azimuths and ranges are measured from, metres in the trajectory's frame: the middle of its samples. Of two
    /// robots that both move, the middle of their displacement, receiver less transmitter.
    pub position_m: Vector2<f64>,
    /// Way driven since the evidence before, metres; the straight line between the two positions where that is longer.
    pub driven_m: f64,
    /// The directions that explain the stretch.
    pub modes: Vec<EvidenceMode>,
    /// Probability that one of them is right.
    pub known: f64,
    /// Share of the stretch that no evidence before was made of, 0..1: the likelihood is taken to this power.
    pub fresh: f64,
}

impl Evidence {
    fn is_usable(&self) -> bool {
        let numbers = [self.t_s, self.position_m.x, self.position_m.y, self.driven_m, self.known, self.fresh];
        numbers.iter().all(|number| number.is_finite()) && self.modes().map(|mode| mode.share).sum::<f64>() > 0.0
    }

    /// The modes that can be used.
    fn modes(&self) -> impl Iterator<Item = &EvidenceMode> {
        self.modes.iter().filter(|mode| mode.is_usable())
    }

    /// The probability that one of the modes is right.
    fn believed(&self) -> f64 {
        self.known.clamp(0.0, 0.99)
    }

    /// The likelihood of each place over that of a uniform guess: the sum of the modes' products, and the rest that is the same
    /// everywhere. There are `azimuths` cells around; `ranges` are the logarithms of the
    /// ranges, with the prior's share of each.
    fn factors(&self, azimuths: usize, ranges: &[(f64, f64)]) -> (Vec<Factor>, f64) {
        let total: f64 = self.modes().map(|mode| mode.share).sum();
        let known = self.believed();
        let factor = |mode: &EvidenceMode| {
            let weight = known * mode.share / total;
            let mut around = wrapped_normal(mode.azimuth_rad, mode.sd_rad, azimuths);
            around.iter_mut().for_each(|value| *value *= weight);
            Factor { around, along: along(mode, ranges) }
        };
        (self.modes().map(factor).collect(), 1.0 - known)
    }
}

/// What one mode adds to the likelihood of a place: the product of a factor of its azimuth and one of its range.
struct Factor {
    /// At the centre of each cell around, from azimuth 0 on.
    pub around: Vec<f64>,
    /// At each range.
    pub along: Vec<f64>,
}

/// A normal density around the circle over the uniform one, at the centres of `cells` cells from azimuth 0 on; its mean is 1.
fn wrapped_normal(azimuth_rad: f64, sd_rad: f64, cells: usize) -> Vec<f64> {
    let step_rad = TAU / cells as f64;
    // A peak narrower than the cells would fall between their centres.
    let sd_rad = sd_rad.max(0.6 * step_rad);
    let at = |cell: usize| {
        let off = wrap_rad(cell as f64 * step_rad - azimuth_rad) / sd_rad;
        (-0.5 * off * off).exp()
    };
    let mut values: Vec<f64> = (0..cells).map(at).collect();
    let mean = values.iter().sum::<f64>() / cells as f64;
    values.iter_mut().for_each(|value| *value /= mean);
    values
}

/// The density of a mode's range over the prior, at each range (its logarithm and the prior's share); all 1 where none was
/// observed. Ranges are wrong more often than their deviations say: a share of the prior stays in them.
fn along(mode: &EvidenceMode, ranges: &[(f64, f64)]) -> Vec<f64> {
    let Some((range_m, sd_m)) = mode.range_m else { return vec![1.0; ranges.len()] };
    let sd = (sd_m / range_m).hypot(RANGE_FLOOR);
    let at = |ln_range: f64| (-0.5 * ((ln_range - range_m.ln()) / sd).powi(2)).exp();
    let mean: f64 = ranges.iter().map(|(ln_range, share)| share * at(*ln_range)).sum();
    let missed = RANGE_MISSED;
    let of = |ln_range: f64| if mean > 0.0 { missed + (1.0 - missed) * at(ln_range) / mean } else { 1.0 };
    ranges.iter().map(|(ln_range, _)| of(*ln_range)).collect()
}

/// What became of the evidence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct TrackCounts {
    /// Stretches that were used.
    pub used: u64,
    /// Stretches that were refused: with a number that is not finite, without a usable direction, or out of the order of time.
    pub refused: u64,
    /// How often the evidence was dropped because another frame began.
    pub reset: u64,
    /// The same because nothing was heard of the peer for long.
    pub gone: u64,
}

/// The probability of every place of one peer, carried from one stretch of motion to the next.
#[derive(Clone, Debug, Default)]
pub(crate) struct PeerTrack {
    /// Standard deviation of the heading of the whole trajectory, radians, as for single bearings. Common to all stretches, it
    /// decides between no places; spreads and probabilities of answers hold it.
    pub heading_sd_rad: f64,
    known: Option<Known>,
    counts: TrackCounts,
}

#[derive(Clone, Debug)]
struct Known {
    grid: PlaceGrid,
    t_s: f64,
    stretches: u32,
    /// Stretches that know a direction: their probabilities, summed and forgotten as places are.
    known: f64,
}

impl PeerTrack {
    /// A track of a peer about which nothing is known.
    pub fn new(heading_sd_rad: f64) -> Self {
        Self { heading_sd_rad, ..Self::default() }
    }

    /// Adds the evidence of one stretch of motion, and gives what all evidence so far says, seen from its position. Stretches
    /// come in the order of time and do not overlap, except for what [`Evidence::fresh`] says. `None` for evidence that cannot be
    /// used: it is counted, and the track is as it was.
    pub fn update(&mut self, evidence: &Evidence) -> Option<CarriedAnswer> {
        let Some((known, is_back)) = self.with(evidence) else {
            self.counts.refused += 1;
            return None;
        };
        self.counts.used += 1;
        self.counts.gone += u64::from(is_back);
        Some(self.known.insert(known).answer(self.heading_sd_rad))
    }

    /// What the track and `evidence` together say, seen from the evidence's position, without taking it.
    pub fn answer_with(&self, evidence: &Evidence) -> Option<CarriedAnswer> {
        self.with(evidence).map(|(known, _)| known.answer(self.heading_sd_rad))
    }

    /// Drops all evidence: another frame begins.
    pub fn reset(&mut self) {
        self.counts.reset += u64::from(self.known.take().is_some());
    }

    /// What became of the evidence.
    pub fn counts(&self) -> TrackCounts {
        self.counts
    }

    /// The state after `evidence`, and whether the peer was lost before.
    fn with(&self, evidence: &Evidence) -> Option<(Known, bool)> {
        let before = self.known.as_ref();
        if !evidence.is_usable() || before.is_some_and(|known| evidence.t_s < known.t_s) {
            return None;
        }
        let present = before.filter(|known| evidence.t_s - known.t_s <= GONE_S);
        let (mut grid, stretches, before_known) = match present {
            None => (PlaceGrid::prior(evidence.position_m), 0, 0.0),
            Some(known) => (self.predicted(known, evidence), known.stretches, known.known),
        };
        let mut known = before_known * (1.0 - FORGOTTEN) + evidence.fresh.clamp(0.0, 1.0) * evidence.believed();
        if !grid.multiply(evidence) {
            // No place is left of what was known: the evidence stands by itself.
            grid = PlaceGrid::prior(evidence.position_m);
            grid.multiply(evidence);
            known = evidence.believed();
        }
        let known = Known { grid, t_s: evidence.t_s, stretches: stretches.saturating_add(1), known };
        Some((known, before.is_some() && present.is_none()))
    }

    /// The places before the evidence, about its position.
    fn predicted(&self, known: &Known, evidence: &Evidence) -> PlaceGrid {
        let straight_m = (evidence.position_m - known.grid.middle_m).norm();
        let driven_m = evidence.driven_m.max(straight_m);
        let turn_rad_per_rt_m = self.heading_sd_rad.max(TURN_DEG_PER_RT_M.to_radians());
        let mut grid = known.grid.moved_to(evidence.position_m);
        grid.blur(turn_rad_per_rt_m * driven_m.sqrt(), SLIP * driven_m);
        grid.forget(FORGOTTEN);
        grid
    }
}

impl Known {
    /// The heading of the whole trajectory has this deviation, radians. A range is that of all evidence, its variance divided by
    /// the power that the evidence is taken to.
    fn answer(&self, heading_sd_rad: f64) -> CarriedAnswer {
        let exponent = temper(self.known);
        let mut around = self.grid.tempered(exponent).around();
        blur_around(&mut around, heading_sd_rad * AZIMUTHS as f64 / TAU);
        let candidates = candidates(&around);
        let azimuth_deg = candidates.first().map_or(0.0, |best| best.azimuth_deg);
        let azimuth_rad = azimuth_deg.to_radians();
        let (place_m, covariance_m2) = place_m(&self.grid, azimuth_rad).unzip();
        CarriedAnswer {
            azimuth_deg,
            spread_deg: spread_rad(&around, azimuth_rad).min(UNIFORM_RAD).to_degrees(),
            candidates,
            place_m: place_m.map(Into::into),
            place_covariance_m2: covariance_m2.map(|covariance_m2| (covariance_m2 / exponent).into()),
            stretches: self.stretches,
        }
    }
}

/// The combined evidence of all stretches of motion about a peer, in degrees: a part of a JSON line.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CarriedAnswer {
    /// Bearing to the peer from the middle of the last stretch, in the trajectory's frame, from +x towards +y, (-180, 180].
    pub azimuth_deg: f64,
    /// Half of the width about the azimuth that holds 0.68 of the evidence. It is not calibrated, so it is no error
    /// bar.
    pub spread_deg: f64,
    /// The directions in which the peer may be, the likeliest first.
    pub candidates: Vec<CarriedCandidate>,
    /// Where the peer is in the trajectory's frame, metres, where its range is known well enough. If the peer moves
    /// too, less its displacement since its odometry began.
    pub place_m: Option<[f64; 2]>,
    /// Its covariance, metres squared, row by row.
    pub place_covariance_m2: Option<[[f64; 2]; 2]>,
    /// Stretches of motion that it is made of.
    pub stretches: u32,
}

/// One direction of a [`CarriedAnswer`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CarriedCandidate {
    /// Bearing, degrees.
    pub azimuth_deg: f64,
    /// Probability of being within five degrees of it, 0..1: too low in line of sight, too high behind walls.
    pub share: f64,
}

/// A direction is right within five degrees, as the probabilities of single bearings count it.
const WITHIN_RAD: f64 = 0.087_266_462_599_716_48;
/// Directions that an answer has at most, and the least share of one.
const MODES: usize = 5;
const LEAST_SHARE: f64 = 0.02;
/// Share of the evidence within the spread.
const BAR: f64 = 0.68;

/// The directions with the most probability within five degrees, none within ten degrees of a better one.
fn candidates(around: &[f64]) -> Vec<CarriedCandidate> {
    let half = (WITHIN_RAD / TAU * AZIMUTHS as f64).round() as usize;
    let mut shares = windows(around, half);
    let mut found: Vec<CarriedCandidate> = Vec::new();
    while found.len() < MODES {
        let highest = shares.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((cell, share)) = highest.filter(|(_, share)| found.is_empty() || *share >= LEAST_SHARE) else { break };
        let azimuth_deg = centre_rad(around, cell, half).to_degrees();
        found.push(CarriedCandidate { azimuth_deg, share: share.min(1.0) });
        for step in 0..=4 * half {
            shares[(cell + AZIMUTHS + step - 2 * half) % AZIMUTHS] = f64::MIN;
        }
    }
    found
}

/// The sum of each value and of `half` on either side of it, around the circle.
fn windows(values: &[f64], half: usize) -> Vec<f64> {
    let count = values.len();
    let sum = |k: usize| (0..=2 * half).map(|i| values[(k + count + i - half) % count]).sum();
    (0..count).map(sum).collect()
}

/// The mean azimuth about a cell, radians.
fn centre_rad(around: &[f64], cell: usize, half: usize) -> f64 {
    let count = around.len();
    let near = (0..=2 * half).map(|i| (i as f64 - half as f64, around[(cell + count + i - half) % count]));
    let (moment, total) = near.fold((0.0, 0.0), |(moment, total), (off, p)| (moment + off * p, total + p));
    let off = if total > 0.0 { moment / total } else { 0.0 };
    wrap_rad(azimuth_rad(cell) + off * TAU / AZIMUTHS as f64)
}

/// The half width about `azimuth_rad` that holds [`BAR`] of the probability, radians.
fn spread_rad(around: &[f64], azimuth_rad: f64) -> f64 {
    let step_rad = TAU / AZIMUTHS as f64;
    let mut off: Vec<(f64, f64)> = around
        .iter()
        .enumerate()
        .map(|(cell, p)| (wrap_rad(self::azimuth_rad(cell) - azimuth_rad).abs(), *p))
        .collect();
    off.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut sum = 0.0;
    let reached = off.iter().find(|(_, p)| {
        sum += p;
        sum >= BAR
    });
    reached.map_or(UNIFORM_RAD, |(off, _)| off.max(0.5 * step_rad))
}

/// Place and covariance about an azimuth, where the range there is known well enough.
fn place_m(grid: &PlaceGrid, azimuth_rad: f64) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let off = |cell: usize| wrap_rad(self::azimuth_rad(cell) - azimuth_rad);
    let along = grid.along(|cell| off(cell).abs() <= 2.0 * WITHIN_RAD);
    let total: f64 = along.iter().map(|(_, p)| p).sum();
    if total <= 0.0 {
        return None;
    }
    let mean = along.iter().map(|(ln, p)| ln * p).sum::<f64>() / total;
    let variance = along.iter().map(|(ln, p)| (ln - mean).powi(2) * p).sum::<f64>() / total;
    if variance.sqrt() > RANGE_SHARE {
        return None;
    }
    let near = || grid.around().into_iter().enumerate().filter(|(cell, _)| off(*cell).abs() <= 2.0 * WITHIN_RAD);
    let spread = near().map(|(cell, p)| off(cell).powi(2) * p).sum::<f64>() / near().map(|(_, p)| p).sum::<f64>();
    let range_m = mean.exp();
    let (sin, cos) = azimuth_rad.sin_cos();
    let (radial, across) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
    let covariance =
        (radial * radial.transpose() * variance + across * across.transpose() * spread) * (range_m * range_m);
    Some((grid.middle_m + radial * range_m, covariance))
}

/// Cells around, and along the range.
const AZIMUTHS: usize = 720;
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
struct PlaceGrid {
    /// Where azimuths and ranges are measured from, metres.
    pub middle_m: Vector2<f64>,
    /// Range by range, azimuths fastest, from azimuth 0 on.
    cells: Vec<f64>,
}

impl PlaceGrid {
    /// The prior: every azimuth alike, and per area alike within [`ROOM_M`], per logarithm of the range beyond.
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
fn azimuth_rad(cell: usize) -> f64 {
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
fn prior_ranges() -> Vec<(f64, f64)> {
    (0..RANGES).map(|k| ln_range(k as f64)).zip(range_shares()).collect()
}

/// Divides by the sum; `false`, with nothing changed, where that is no positive number.
fn normalise(values: &mut [f64]) -> bool {
    let sum: f64 = values.iter().sum();
    let sound = sum.is_finite() && sum > 0.0;
    if sound {
        values.iter_mut().for_each(|value| *value /= sum);
    }
    sound
}

/// Convolves the values around a circle with a normal of this standard deviation, cells.
fn blur_around(values: &mut [f64], sd_cells: f64) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    const DEGREE: f64 = PI / 180.0;

    /// Azimuth from `from` to `to`, radians.
    fn azimuth(from: Vector2<f64>, to: Vector2<f64>) -> f64 {
        (to - from).y.atan2((to - from).x)
    }

    fn mode(azimuth_rad: f64, share: f64) -> EvidenceMode {
        EvidenceMode { azimuth_rad, sd_rad: DEGREE, share, range_m: None }
    }

    fn evidence(t_s: f64, position_m: Vector2<f64>, modes: Vec<EvidenceMode>) -> Evidence {
        Evidence { t_s, position_m, driven_m: 0.0, modes, known: 0.95, fresh: 1.0 }
    }

    /// What a stretch says that sees these places alike.
    fn seen(t_s: f64, from: Vector2<f64>, places: &[Vector2<f64>]) -> Evidence {
        evidence(t_s, from, places.iter().map(|place| mode(azimuth(from, *place), 1.0)).collect())
    }

    /// What a stretch along the direction `axis_rad` says: the place and its mirror image in that line are alike.
    fn mirrored(t_s: f64, from: Vector2<f64>, axis_rad: f64, place: Vector2<f64>) -> Evidence {
        let own = azimuth(from, place);
        evidence(t_s, from, [own, wrap_rad(2.0 * axis_rad - own)].map(|azimuth| mode(azimuth, 0.5)).to_vec())
    }

    fn off_deg(answer: &CarriedAnswer, truth_rad: f64) -> f64 {
        wrap_rad(answer.azimuth_deg.to_radians() - truth_rad).abs() / DEGREE
    }

    #[test]
    fn two_lines_in_different_directions_settle_which_side_the_peer_is_on() {
        let peer = Vector2::new(3.0, 2.0);
        for side in [1.0, -1.0] {
            let peer = Vector2::new(peer.x, side * peer.y);
            let mut track = PeerTrack::default();
            let first = track.update(&mirrored(0.0, Vector2::new(0.5, 0.0), 0.0, peer)).unwrap();
            assert!(first.candidates[0].share < 0.52 && first.candidates.len() == 2, "{first:?}");
            assert!((first.candidates[0].share - first.candidates[1].share).abs() < 1e-6, "{first:?}");
            let from = Vector2::new(1.0, 0.5);
            let second = track.update(&mirrored(5.0, from, FRAC_PI_2, peer)).unwrap();
            let (best, others) = second.candidates.split_first().unwrap();
            assert!(off_deg(&second, azimuth(from, peer)) < 1.0 && best.share > 0.55, "{second:?}");
            assert!(others.iter().all(|other| 4.0 * other.share < best.share), "{second:?}");
            assert!(second.spread_deg < 0.6 * first.spread_deg && second.stretches == 2, "{second:?}");
        }
    }

    #[test]
    fn a_candidate_that_moves_with_the_robot_loses_to_one_that_stays() {
        let peer = Vector2::new(4.0, 1.0);
        let (mut track, mut sure) = (PeerTrack::default(), 0.0);
        for k in 0..3 {
            let from = Vector2::new(0.0, 1.2 * f64::from(k));
            // It turns ahead where a place would fall behind, and is the stronger of the two.
            let gliding = mode(PI - 10.0 * DEGREE * f64::from(k), 2.0);
            let still = mode(azimuth(from, peer), 1.0);
            let answer = track.update(&evidence(f64::from(k), from, vec![gliding, still])).unwrap();
            sure = answer.candidates[0].share;
            let truth = if k == 0 { PI } else { azimuth(from, peer) };
            assert!(off_deg(&answer, truth) < 2.0, "{k}: {answer:?}");
        }
        assert!(sure > 0.5, "{sure}");
    }

    #[test]
    fn stretches_that_are_deceived_together_are_not_as_sure_as_independent_ones() {
        let places = [Vector2::new(4.0, 1.0), Vector2::new(-3.0, 2.0)];
        let mut track = PeerTrack::default();
        let mut sure = 0.0;
        for k in 0..4 {
            let mut own = seen(f64::from(k), Vector2::new(0.0, 0.2 * f64::from(k)), &places);
            own.modes[1].share = 0.5;
            let answer = track.update(&own).unwrap();
            assert!(off_deg(&answer, azimuth(own.position_m, places[0])) < 2.0, "{answer:?}");
            sure = answer.candidates[0].share;
        }
        // Alone the first place has twice the share of the second: so it has of all four if they are one. Four independent ones
        // would have sixteen times.
        assert!((0.7..0.85).contains(&sure), "{sure}");
    }

    #[test]
    fn crossing_bearings_give_a_place() {
        let peer = Vector2::new(-2.0, 3.0);
        let mut track = PeerTrack::default();
        let from = |(k, x): (usize, f64)| track.update(&seen(k as f64, Vector2::new(x, 0.0), &[peer])).unwrap();
        let answer = [-3.0, -1.0, 1.0, 2.0].into_iter().enumerate().map(from).last().unwrap();
        let (place, covariance) = (answer.place_m.unwrap(), answer.place_covariance_m2.unwrap());
        assert!((Vector2::from(place) - peer).norm() < 0.3, "{place:?}");
        assert!(Matrix2::from(covariance).determinant() > 0.0, "{covariance:?}");
    }

    #[test]
    fn a_range_tells_two_places_in_one_direction_apart() {
        let (near, far) = (Vector2::new(2.0, 0.0), Vector2::new(12.0, 0.0));
        let from = Vector2::new(1.0, 1.0);
        let odds = [None, Some((2.0, 0.2)), Some((12.0, 1.0))].map(|range_m| {
            let mut track = PeerTrack::default();
            let ranged = EvidenceMode { range_m, ..mode(0.0, 1.0) };
            track.update(&evidence(0.0, Vector2::zeros(), vec![ranged])).unwrap();
            let modes = [near, far].map(|place| mode(azimuth(from, place), 0.5));
            let answer = track.update(&evidence(1.0, from, modes.to_vec())).unwrap();
            let share = |place| {
                let off = |own: &CarriedCandidate| wrap_rad(own.azimuth_deg.to_radians() - azimuth(from, place)).abs();
                let about = answer.candidates.iter().filter(|own| off(own) < 5.0 * DEGREE);
                about.map(|own| own.share).sum::<f64>().max(0.01)
            };
            share(near) / share(far)
        });
        assert!(odds[1] > 2.0 * odds[0] && odds[0] > 1.5 * odds[2], "{odds:?}");
    }

    #[test]
    fn odometry_that_drifts_makes_what_was_known_less_sure() {
        let peer = Vector2::new(3.0, 0.0);
        let spreads = [0.1, 4.0, 100.0].map(|driven_m: f64| {
            let mut track = PeerTrack::new(2.0 * DEGREE);
            track.update(&seen(0.0, Vector2::zeros(), &[peer])).unwrap();
            // Sees next to nothing.
            let blind = evidence(9.0, Vector2::new(0.0, 0.1), vec![mode(PI, 1.0)]);
            track.update(&Evidence { driven_m, known: 0.01, ..blind }).unwrap().spread_deg
        });
        assert!(1.2 * spreads[0] < spreads[1] && 2.0 * spreads[1] < spreads[2], "{spreads:?}");
    }

    #[test]
    fn a_peer_that_was_carried_elsewhere_is_found_there() {
        let (before, after) = (Vector2::new(3.0, 0.0), Vector2::new(0.0, -3.0));
        let mut track = PeerTrack::default();
        let at = |k: u32| Vector2::new(0.0, 0.3 * f64::from(k));
        (0..20).for_each(|k| drop(track.update(&seen(f64::from(k), at(k), &[before])).unwrap()));
        let needed = (20..30).find(|k| {
            let answer = track.update(&seen(f64::from(*k), at(*k), &[after])).unwrap();
            off_deg(&answer, azimuth(at(*k), after)) < 5.0
        });
        assert!(needed.is_some_and(|k| k <= 23), "{needed:?}");
    }

    #[test]
    fn a_new_frame_and_a_long_silence_begin_anew_and_are_counted() {
        let mut track = PeerTrack::default();
        track.reset();
        assert_eq!(track.counts(), TrackCounts::default());
        let peer = Vector2::new(3.0, 0.0);
        track.update(&seen(0.0, Vector2::zeros(), &[peer])).unwrap();
        track.reset();
        // After a new frame an earlier time is none.
        track.update(&seen(-5.0, Vector2::zeros(), &[peer])).unwrap();
        let answer = track.update(&seen(GONE_S, Vector2::zeros(), &[-peer])).unwrap();
        assert!(answer.stretches == 1 && off_deg(&answer, PI) < 1.0, "{answer:?}");
        let counts = track.counts();
        assert_eq!((counts.used, counts.refused, counts.reset, counts.gone), (3, 0, 1, 1));
    }

    #[test]
    fn what_cannot_be_used_is_refused_and_changes_nothing() {
        let mut track = PeerTrack::default();
        let good = seen(10.0, Vector2::zeros(), &[Vector2::new(3.0, 0.0)]);
        let before = track.update(&good);
        let nothing = Evidence { fresh: 0.0, ..good.clone() };
        let state = track.answer_with(&nothing);
        let mode = mode(0.1, 1.0);
        let with = |modes: Vec<EvidenceMode>| Evidence { modes, ..good.clone() };
        let range = |range_m: f64| EvidenceMode { range_m: Some((range_m, 1.0)), ..mode };
        let bad = [
            with(vec![]),
            with(vec![EvidenceMode { azimuth_rad: f64::NAN, ..mode }]),
            with(vec![EvidenceMode { sd_rad: 0.0, ..mode }, EvidenceMode { sd_rad: f64::INFINITY, ..mode }]),
            with(vec![EvidenceMode { share: 0.0, ..mode }, EvidenceMode { share: -1.0, ..mode }]),
            with(vec![range(0.0), range(f64::NAN)]),
            Evidence { t_s: f64::NAN, ..good.clone() },
            Evidence { position_m: Vector2::new(0.0, f64::INFINITY), ..good.clone() },
            Evidence { driven_m: f64::NAN, ..good.clone() },
            Evidence { known: f64::NAN, ..good.clone() },
            Evidence { fresh: f64::NAN, ..good.clone() },
            // Before the last one.
            Evidence { t_s: 9.0, ..good.clone() },
        ];
        for evidence in bad {
            assert_eq!(track.update(&evidence), None, "{evidence:?}");
        }
        assert!(before.is_some() && track.answer_with(&nothing) == state);
        assert_eq!((track.counts().refused, track.counts().used), (11, 1));
        // A direction that cannot be used takes nothing from one that can.
        assert!(track.update(&with(vec![mode, EvidenceMode { share: f64::NAN, ..mode }])).is_some());
    }

    #[test]
    fn numbers_at_the_ends_of_what_there_is_leave_answers_finite() {
        let mut track = PeerTrack::new(1e300);
        for (k, value) in [0.0_f64, 1e-300, 1e-9, 1.0, 1e9, 1e300].into_iter().enumerate() {
            let range_m = Some((value.max(1e-300), value));
            let mode = EvidenceMode { azimuth_rad: value, sd_rad: value.max(1e-300), share: 1.0, range_m };
            let own = evidence(k as f64, Vector2::new(value, -value), vec![mode]);
            let answer = track.update(&Evidence { driven_m: value, known: value, fresh: value, ..own }).unwrap();
            let numbers = [answer.azimuth_deg, answer.spread_deg, answer.candidates[0].share];
            assert!(numbers.iter().all(|number| number.is_finite()), "{value}: {answer:?}");
        }
    }

    #[test]
    fn the_same_evidence_gives_the_same_answer_whichever_way_azimuths_are_wrapped() {
        let run = |turns: f64| {
            let (mut track, mut answer) = (PeerTrack::default(), None);
            for k in 0..4 {
                let from = Vector2::new(0.4 * f64::from(k), 0.0);
                let mut evidence = seen(f64::from(k), from, &[Vector2::new(-4.0, 0.05), Vector2::new(-3.0, -4.0)]);
                evidence.modes.iter_mut().for_each(|mode| mode.azimuth_rad += turns * 2.0 * PI);
                answer = track.update(&evidence);
            }
            answer.unwrap()
        };
        assert_eq!(run(0.0), run(0.0));
        // The first place is straight behind, on the cut of the azimuth.
        let (own, turned) = (run(0.0), run(3.0));
        assert!(off_deg(&own, turned.azimuth_deg.to_radians()) < 1e-7, "{own:?} {turned:?}");
        assert!((own.candidates[0].share - turned.candidates[0].share).abs() < 1e-9);
    }

    #[test]
    fn evidence_that_is_not_new_changes_nothing_and_an_answer_with_it_takes_nothing() {
        let mut track = PeerTrack::default();
        track.update(&seen(0.0, Vector2::zeros(), &[Vector2::new(3.0, 0.0)])).unwrap();
        let elsewhere = seen(1.0, Vector2::zeros(), &[Vector2::new(0.0, 3.0)]);
        let nothing = Evidence { fresh: 0.0, ..elsewhere.clone() };
        let beside = track.answer_with(&nothing).unwrap();
        assert!(off_deg(&beside, 0.0) < 0.1, "{beside:?}");
        assert!(track.answer_with(&elsewhere).unwrap().candidates[0].share < beside.candidates[0].share - 0.1);
        assert_eq!((track.answer_with(&nothing), track.counts().used), (Some(beside), 1));
    }

    #[test]
    fn a_grid_that_is_moved_there_and_back_keeps_its_places() {
        let peer = Vector2::new(2.0, 2.5);
        let mut grid = PlaceGrid::prior(Vector2::zeros());
        for x in [0.0, 1.5, -1.5, 0.0] {
            let from = Vector2::new(x, 0.0);
            grid = grid.moved_to(from);
            assert!(grid.multiply(&seen(0.0, from, &[peer])));
        }
        let sum = |grid: &PlaceGrid| grid.around().iter().sum::<f64>();
        let there = grid.moved_to(Vector2::new(0.7, -1.0)).moved_to(Vector2::zeros());
        assert!((sum(&there) - 1.0).abs() < 1e-9 && (sum(&grid) - 1.0).abs() < 1e-9);
        let middle = |grid: &PlaceGrid| {
            let around = grid.around();
            let (sin, cos) = around.iter().enumerate().fold((0.0, 0.0), |(sin, cos), (cell, p)| {
                let azimuth = azimuth_rad(cell);
                (sin + p * azimuth.sin(), cos + p * azimuth.cos())
            });
            sin.atan2(cos)
        };
        assert!((middle(&there) - middle(&grid)).abs() < 0.5 * DEGREE, "{} {}", middle(&there), middle(&grid));
        assert!(!normalise(&mut [0.0, 0.0]) && !normalise(&mut [f64::NAN]));
    }
}
