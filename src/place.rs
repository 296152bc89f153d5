//! Where a peer is, from one stretch of motion after another: a filter over its place.
//!
//! A bearing knows one stretch of motion. Where several directions explain it, the next stretch, driven elsewhere, often
//! decides between them: [`PeerTrack`] holds the probability of every place of the peer on a grid over azimuth and the
//! logarithm of the range about the robot, and each stretch does two things to it:
//!
//! * motion: the grid is moved to where the robot is, blurred by what odometry gets wrong over the way driven and by how
//!   far a peer may have gone without odometry of its own; a little of the prior comes back ([`TrackSettings`]);
//! * evidence ([`Evidence`]): the probability of each place is multiplied by `1 - known + known x sum share x N(azimuth)`,
//!   the likelihood of a bearing that is one of its candidates or, with `1 - known`, none of them; with the range where the
//!   wave front's curvature showed one.
//!
//! What this decides: the mirror image of a line, side lobes and products of paths lie elsewhere for every motion. What it
//! decides only in part: a reflection in a flat wall has an image that stands as still as the transmitter. It loses where
//! the robot goes so far that the wall ends, that the straight path is free, or that ranges tell the two apart.
//!
//! No clocks and no sockets: times and positions are arguments, and the same evidence gives the same answer.
//!
//! [`places`] has no order of time: it takes motions that are all seen in one frame, such as several captures of a room.

use crate::maths::{UNIFORM_RAD, wrap_rad};
use nalgebra::{Matrix2, Rotation2, Vector2};
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

/// Contribution of each motion after the first to the exponent of the combined evidence; the first adds 1 (least Brier
/// score of carried bearings, 30 places, four trajectories, halves to eighths).
pub(crate) const OWN_SHARE: f64 = 0.3;

/// Peers are as likely per area up to here, and per logarithm of the range beyond, metres (half of a room).
pub(crate) const ROOM_M: f64 = 4.0;

/// A range is reported where its predicted deviation is below this share of it.
pub(crate) const RANGE_SHARE: f64 = 0.35;

/// Relative error that no range is better than (one range in six is off by more).
pub(crate) const RANGE_FLOOR: f64 = 0.3;

/// Share of ranges that are wrong whatever their deviation (ranges behind walls and by bent trajectories are wrong by
/// metres).
pub(crate) const RANGE_MISSED: f64 = 0.5;

/// Least wander of a heading, degrees after one metre (motion capture).
const TURN_DEG_PER_RT_M: f64 = 0.2;

/// Error of positions as a share of the way driven (as deviations.scale_sd).
const SLIP: f64 = 0.01;

/// A peer that is silent for longer counts as lost, seconds (longer than a window of a live estimator).
const GONE_S: f64 = 300.0;

/// The power that the evidence of `known` motions together is taken to (each counts as the probability that one of its
/// directions is right): motions are deceived together, and each after the first counts as a share of one that is
/// deceived by itself (`own_share`).
fn temper(known: f64, own_share: f64) -> f64 {
    let known = known.max(1.0);
    (1.0 + (known - 1.0) * own_share.clamp(0.0, 1.0)) / known
}

/// What may happen to places between two stretches of motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackSettings {
    /// Standard deviation of the heading of the whole trajectory, radians, as for single bearings. Common to all stretches,
    /// it decides between no places; error bars and probabilities of answers hold it.
    pub heading_sd_rad: f64,
    /// How the heading wanders: standard deviation after one metre, radians; it grows with the root of the way driven.
    pub turn_rad_per_rt_m: f64,
    /// Error of the position as a share of the way driven.
    pub slip: f64,
    /// How a peer without odometry wanders: standard deviation after one second, metres, in x and in y; it grows with the
    /// root of the time. 0: it stands still, or its odometry is known.
    pub wander_m_per_rt_s: f64,
    /// A peer that is silent for longer counts as lost, and its place is dropped, seconds.
    pub gone_s: f64,
    /// What each stretch after the first adds to the power that all evidence together is taken to when an answer is read from
    /// it; the first adds 1. 1: stretches are deceived independently; 0: all alike.
    pub own_share: f64,
}

impl TrackSettings {
    /// A peer that stands still or has odometry of its own, and odometry whose heading has this standard deviation over one
    /// motion of about a metre, radians ([`crate::pipeline::Options::heading_sd_rad`]).
    #[must_use]
    pub fn new(heading_sd_rad: f64) -> Self {
        let heading_sd_rad = if heading_sd_rad.is_finite() { heading_sd_rad.abs() } else { 0.0 };
        Self {
            heading_sd_rad,
            turn_rad_per_rt_m: heading_sd_rad.max(TURN_DEG_PER_RT_M.to_radians()),
            slip: SLIP,
            wander_m_per_rt_s: 0.0,
            gone_s: GONE_S,
            own_share: OWN_SHARE,
        }
    }

    /// Standard deviations after `driven_m` metres and `passed_s` seconds: of the heading, radians, and of the place of the
    /// peer relative to the robot, metres. Settings that are no numbers, or negative, count as 0.
    fn blur(&self, driven_m: f64, passed_s: f64) -> (f64, f64) {
        let of = |value: f64| if value.is_finite() { value.max(0.0) } else { 0.0 };
        let turn_rad = of(self.turn_rad_per_rt_m) * driven_m.sqrt();
        let moved_m = (of(self.slip) * driven_m).hypot(of(self.wander_m_per_rt_s) * passed_s.sqrt());
        (turn_rad, moved_m)
    }
}

impl Default for TrackSettings {
    fn default() -> Self {
        Self::new(0.0)
    }
}

/// One direction that a stretch may be explained by.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
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
    /// A direction without a range: azimuth and its deviation in radians, share in any common unit.
    #[must_use]
    pub fn new(azimuth_rad: f64, sd_rad: f64, share: f64) -> Self {
        Self { azimuth_rad, sd_rad, share, range_m: None }
    }

    /// The same with the horizontal range and its standard deviation, metres, where they were observed.
    #[must_use]
    pub fn with_range_m(self, range_m: Option<(f64, f64)>) -> Self {
        Self { range_m, ..self }
    }

    fn is_usable(&self) -> bool {
        let range = self.range_m.is_none_or(|(range_m, sd_m)| range_m > 0.0 && range_m.is_finite() && sd_m >= 0.0);
        let positive = self.sd_rad > 0.0 && self.sd_rad.is_finite() && self.share >= 0.0 && self.share.is_finite();
        self.azimuth_rad.is_finite() && positive && range
    }
}

/// The evidence of one stretch of motion about a peer's place; [`crate::pipeline::Bearing::evidence`] makes it from a bearing.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
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
    /// Evidence of directions `modes`, seen at `t_s` seconds from `position_m` metres, of which one is right with the
    /// probability `known`.
    #[must_use]
    pub fn new(t_s: f64, position_m: Vector2<f64>, modes: Vec<EvidenceMode>, known: f64) -> Self {
        Self { t_s, position_m, driven_m: 0.0, modes, known, fresh: 1.0 }
    }

    /// The same with the way driven since the evidence before, metres.
    #[must_use]
    pub fn with_driven_m(self, driven_m: f64) -> Self {
        Self { driven_m, ..self }
    }

    /// The same of a stretch of which only this share is new, 0..1.
    #[must_use]
    pub fn with_fresh(self, fresh: f64) -> Self {
        Self { fresh, ..self }
    }

    /// Refuses what cannot be used.
    fn check(&self) -> Result<(), TrackError> {
        let numbers = [
            ("time", self.t_s),
            ("position", self.position_m.x + self.position_m.y),
            ("way driven", self.driven_m),
            ("probability of the directions", self.known),
            ("share of the stretch that is new", self.fresh),
        ];
        if let Some((what, value)) = numbers.into_iter().find(|(_, value)| !value.is_finite()) {
            return Err(TrackError::NotFinite { what, value });
        }
        let total: f64 = self.modes().map(|mode| mode.share).sum();
        if total > 0.0 { Ok(()) } else { Err(TrackError::NoDirection { modes: self.modes.len() }) }
    }

    /// The modes that can be used.
    fn modes(&self) -> impl Iterator<Item = &EvidenceMode> {
        self.modes.iter().filter(|mode| mode.is_usable())
    }

    /// The probability that one of the modes is right.
    fn believed(&self) -> f64 {
        self.known.clamp(0.0, 0.99)
    }

    /// The same where the heading of all of the trajectory has this deviation, radians, and no other motion shares it.
    #[must_use]
    pub fn with_heading_sd_rad(mut self, heading_sd_rad: f64) -> Self {
        self.modes.iter_mut().for_each(|mode| mode.sd_rad = mode.sd_rad.hypot(heading_sd_rad));
        self
    }

    /// The same in another frame, in which the origin of this one is at `origin_m` and its x axis is turned by `yaw_rad`.
    #[must_use]
    pub fn in_frame(mut self, origin_m: Vector2<f64>, yaw_rad: f64) -> Self {
        self.position_m = origin_m + Rotation2::new(yaw_rad) * self.position_m;
        self.modes.iter_mut().for_each(|mode| mode.azimuth_rad = wrap_rad(mode.azimuth_rad + yaw_rad));
        self
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
    let (sd, mean) = bell(range_m, sd_m, ranges);
    let at = |ln_range: f64| (-0.5 * ((ln_range - range_m.ln()) / sd).powi(2)).exp();
    let missed = RANGE_MISSED;
    let of = |ln_range: f64| if mean > 0.0 { missed + (1.0 - missed) * at(ln_range) / mean } else { 1.0 };
    ranges.iter().map(|(ln_range, _)| of(*ln_range)).collect()
}

/// The deviation of a range's logarithm, and the mean of its bell over the prior of ranges.
fn bell(range_m: f64, sd_m: f64, ranges: &[(f64, f64)]) -> (f64, f64) {
    let sd = (sd_m / range_m).hypot(RANGE_FLOOR);
    let at = |ln_range: f64| (-0.5 * ((ln_range - range_m.ln()) / sd).powi(2)).exp();
    (sd, ranges.iter().map(|(ln_range, share)| share * at(*ln_range)).sum())
}

/// Share of the evidence that every motion returns to the prior (a peer that was carried elsewhere is found there after
/// two motions).
const FORGOTTEN: f64 = 0.02;

/// Why evidence was not used; the track is as it was.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TrackError {
    /// A NaN or an infinity.
    #[error("the {what} of the evidence is {value}: a finite number is needed")]
    NotFinite {
        /// The quantity.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// No direction that can be used: an azimuth, a positive deviation and a share, all finite.
    #[error("none of {modes} directions is usable: each needs a finite azimuth, a positive deviation and a share")]
    NoDirection {
        /// Directions that were given.
        modes: usize,
    },
    /// It is of a time before the evidence before.
    #[error("evidence of {t_s} s after evidence of {last_s} s: hand stretches over in the order of time")]
    OutOfOrder {
        /// Its time, seconds.
        t_s: f64,
        /// That of the evidence before, seconds.
        last_s: f64,
    },
}

/// What became of the evidence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct TrackCounts {
    /// Stretches that were used.
    pub used: u64,
    /// Stretches that were refused (`TrackError`).
    pub refused: u64,
    /// How often the evidence was dropped because another frame began.
    pub reset: u64,
    /// The same because nothing was heard of the peer for long.
    pub gone: u64,
}

/// The probability of every place of one peer, carried from one stretch of motion to the next.
#[derive(Clone, Debug, Default)]
pub struct PeerTrack {
    settings: TrackSettings,
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
    #[must_use]
    pub fn new(settings: TrackSettings) -> Self {
        Self { settings, known: None, counts: TrackCounts::default() }
    }

    /// The settings of odometry whose heading has this deviation over one motion, radians.
    pub(crate) fn set_heading_sd(&mut self, heading_sd_rad: f64) {
        self.settings = TrackSettings::new(heading_sd_rad);
    }

    /// Adds the evidence of one stretch of motion. Stretches come in the order of time and do not overlap, except for what
    /// [`Evidence::fresh`] says.
    ///
    /// # Errors
    /// `TrackError` where it cannot be used; it is counted, and the track is as it was.
    pub fn update(&mut self, evidence: &Evidence) -> Result<(), TrackError> {
        let next = self.with(evidence);
        match next {
            Ok((known, gone)) => {
                self.counts.used += 1;
                self.counts.gone += u64::from(gone);
                self.known = Some(known);
                Ok(())
            }
            Err(error) => {
                self.counts.refused += 1;
                Err(error)
            }
        }
    }

    /// What the track and `evidence` together say, seen from the evidence's position, without taking it.
    ///
    /// # Errors
    /// As [`Self::update`]; nothing is counted.
    pub fn answer_with(&self, evidence: &Evidence) -> Result<TrackAnswer, TrackError> {
        self.with(evidence).map(|(known, _)| known.answer(&self.settings))
    }

    /// What is known, seen from `position_m`, metres in the trajectory's frame; `None` before any evidence, or where the
    /// position is not finite. What odometry got wrong since the last evidence is not in it.
    #[must_use]
    pub fn answer(&self, position_m: Vector2<f64>) -> Option<TrackAnswer> {
        let known = self.known.as_ref().filter(|_| position_m.iter().all(|x| x.is_finite()))?;
        let moved = Known { grid: known.grid.moved_to(position_m), ..*known };
        Some(moved.answer(&self.settings))
    }

    /// The same seen from where the last evidence was.
    #[must_use]
    pub fn last_answer(&self) -> Option<TrackAnswer> {
        self.known.as_ref().map(|known| known.answer(&self.settings))
    }

    /// Drops all evidence: another frame begins.
    pub fn reset(&mut self) {
        self.counts.reset += u64::from(self.known.take().is_some());
    }

    /// Time of the last evidence, seconds; `None` where nothing is known.
    #[must_use]
    pub fn last_s(&self) -> Option<f64> {
        self.known.as_ref().map(|known| known.t_s)
    }

    /// What became of the evidence.
    #[must_use]
    pub fn counts(&self) -> TrackCounts {
        self.counts
    }

    /// The state after `evidence`, and whether the peer was lost before.
    fn with(&self, evidence: &Evidence) -> Result<(Known, bool), TrackError> {
        evidence.check()?;
        let before = self.known.as_ref();
        if let Some(last_s) = before.map(|known| known.t_s).filter(|last_s| evidence.t_s < *last_s) {
            return Err(TrackError::OutOfOrder { t_s: evidence.t_s, last_s });
        }
        let present = before.filter(|known| evidence.t_s - known.t_s <= self.settings.gone_s);
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
        Ok((known, before.is_some() && present.is_none()))
    }

    /// The places before the evidence, about its position.
    fn predicted(&self, known: &Known, evidence: &Evidence) -> PlaceGrid {
        let straight_m = (evidence.position_m - known.grid.middle_m).norm();
        let (turn_rad, shift_m) =
            self.settings.blur(evidence.driven_m.max(straight_m), (evidence.t_s - known.t_s).max(0.0));
        let mut grid = known.grid.moved_to(evidence.position_m);
        grid.blur(turn_rad, shift_m);
        grid.forget(FORGOTTEN);
        grid
    }
}

impl Known {
    fn answer(&self, settings: &TrackSettings) -> TrackAnswer {
        let exponent = temper(self.known, settings.own_share);
        TrackAnswer::of(&self.grid, exponent, settings.heading_sd_rad, self.stretches)
    }
}

/// A direction is right within five degrees, as the probabilities of single bearings count it.
const WITHIN_RAD: f64 = 0.087_266_462_599_716_48;
/// Directions that an answer has at most, and the least share of one; places have the same.
const MODES: usize = 5;
const LEAST_SHARE: f64 = 0.02;
/// Share of errors within an error bar.
const BAR: f64 = 0.68;

/// A direction in which the peer may be.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct TrackMode {
    /// Azimuth, radians in (-pi, pi], from +x towards +y in the trajectory's frame.
    pub azimuth_rad: f64,
    /// Probability that the peer is within five degrees of it.
    pub share: f64,
}

/// Where a peer is, from all evidence so far.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct TrackAnswer {
    /// Azimuth of the peer, radians in (-pi, pi], from +x towards +y in the trajectory's frame.
    pub azimuth_rad: f64,
    /// Error bar of the azimuth, radians: with the probability 0.68 the peer is within it; at most that of a uniform guess.
    pub azimuth_sd_rad: f64,
    /// Probability that the azimuth is within five degrees of the truth.
    pub probability: f64,
    /// The directions in which the peer may be, the likeliest first; the first is the answer's.
    pub modes: Vec<TrackMode>,
    /// The peer's place in the trajectory's frame and its covariance, metres, where evidence fixes its range.
    pub place_m: Option<(Vector2<f64>, Matrix2<f64>)>,
    /// Stretches of motion that it is made of.
    pub stretches: u32,
}

impl TrackAnswer {
    /// Read from a grid about the place that is asked from, its evidence taken to the power `exponent`; the heading of the whole
    /// trajectory has this deviation, radians. A range is that of all evidence, its variance divided by that power.
    fn of(grid: &PlaceGrid, exponent: f64, heading_sd_rad: f64, stretches: u32) -> Self {
        let mut around = grid.tempered(exponent).around();
        blur_around(&mut around, heading_sd_rad * AZIMUTHS as f64 / TAU);
        let modes = modes(&around);
        let best = modes.first().copied().unwrap_or(TrackMode { azimuth_rad: 0.0, share: 0.0 });
        Self {
            azimuth_rad: best.azimuth_rad,
            azimuth_sd_rad: error_bar_rad(&around, best.azimuth_rad).min(UNIFORM_RAD),
            probability: best.share,
            place_m: place_m(grid, best.azimuth_rad)
                .map(|(place_m, covariance_m2)| (place_m, covariance_m2 / exponent)),
            modes,
            stretches,
        }
    }
}

/// The directions with the most probability within five degrees, none within ten degrees of a better one.
fn modes(around: &[f64]) -> Vec<TrackMode> {
    let half = (WITHIN_RAD / TAU * AZIMUTHS as f64).round() as usize;
    let mut shares = windows(around, half);
    let mut modes: Vec<TrackMode> = Vec::new();
    while modes.len() < MODES {
        let highest = shares.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((cell, share)) = highest.filter(|(_, share)| modes.is_empty() || *share >= LEAST_SHARE) else { break };
        modes.push(TrackMode { azimuth_rad: centre_rad(around, cell, half), share: share.min(1.0) });
        for step in 0..=4 * half {
            shares[(cell + AZIMUTHS + step - 2 * half) % AZIMUTHS] = f64::MIN;
        }
    }
    modes
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
fn error_bar_rad(around: &[f64], azimuth_rad: f64) -> f64 {
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

/// Side of the first cells and of the last, metres.
const FIRST_M: f64 = 1.0;
const LAST_M: f64 = 0.05;
/// Farthest place from the middle of all motions, beside how far they are from it, metres.
const PLANE_M: f64 = 40.0;
/// Probability that the cells that are cut hold together.
const KEPT: f64 = 0.999;
/// Cells at most.
const MOST_CELLS: usize = 60_000;
/// Places of an answer at most.
const MOST_PLACES: usize = 5;
/// Squared distance, in standard deviations, within which 68 % of a plane's normal distribution is.
const ELLIPSE: f64 = 2.278_868_566_376_729_5;
/// A place ends where its probability is this share of the highest: three standard deviations.
const ENDS: f64 = 0.011_108_996_538_242_306;

/// A place where the peer may be.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct PeerPlace {
    /// Its middle, metres in the frame of the evidence.
    pub position_m: Vector2<f64>,
    /// Its covariance, metres squared: that of the normal distribution of whose probability as much as of this place's,
    /// 68 %, is within 1.51 standard deviations.
    pub covariance_m2: Matrix2<f64>,
    /// Probability that the peer is there.
    pub share: f64,
}

/// What several motions say together.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PeerPlaces {
    /// The places where the peer may be, the likeliest first; one at least.
    pub places: Vec<PeerPlace>,
    /// Motions that were used.
    pub used: usize,
    /// Refused motions: a number that is not finite, or no usable direction.
    pub refused: usize,
}

/// Where a peer that stands still is, from motions whose positions and azimuths are in one frame, in any order.
///
/// The logarithms of what each motion says of a place are summed over the motions, and the sum is weighed by `temper`: motions are
/// deceived together. The grid begins coarse and wide; cells that hold nearly all of the probability are cut in four until they
/// are small. A cell's likelihood is that of directions and ranges blurred by the cell, so that no peak falls between the
/// centres of coarse cells.
///
/// # Errors
/// [`TrackError`] of the first motion where none can be used, or [`TrackError::NoDirection`] without any.
pub fn places(evidence: &[Evidence]) -> Result<PeerPlaces, TrackError> {
    let usable: Vec<&Evidence> = evidence.iter().filter(|own| own.check().is_ok()).collect();
    if usable.is_empty() {
        return Err(evidence.iter().find_map(|own| own.check().err()).unwrap_or(TrackError::NoDirection { modes: 0 }));
    }
    let sum_m = usable.iter().fold(Vector2::zeros(), |sum, own| sum + own.position_m);
    let middle_m = sum_m / usable.len() as f64;
    let plane = Plane { spots: usable.iter().map(|own| Spot::of(own)).collect(), middle_m };
    let (cells, side_m) = plane.refined(&usable);
    Ok(PeerPlaces {
        places: clusters(cells, middle_m, side_m),
        used: usable.len(),
        refused: evidence.len() - usable.len(),
    })
}

/// A cell of the grid: how many sides its centre is from the middle along x and y, in halves.
type Cell = (i32, i32);

/// The evidence, and where the grid has its middle.
struct Plane {
    spots: Vec<Spot>,
    middle_m: Vector2<f64>,
}

impl Plane {
    /// The cells of the last grid with their probabilities, and their side, metres.
    fn refined(&self, evidence: &[&Evidence]) -> (BTreeMap<Cell, f64>, f64) {
        let spread_m = evidence.iter().map(|own| (own.position_m - self.middle_m).norm()).fold(0.0, f64::max);
        let mut side_m = FIRST_M.max((PLANE_M + spread_m) / 120.0);
        let half = ((PLANE_M + spread_m) / side_m).ceil() as i32;
        let along = || (-half..half).map(|k| 2 * k + 1);
        let mut cells = self.weighed(along().flat_map(|x| along().map(move |y| (x, y))), side_m);
        // A cell's number stays far below what an integer holds, however far apart motions are.
        for _ in 0..20 {
            let kept = likeliest(&cells);
            if side_m <= LAST_M || 4 * kept.len() > MOST_CELLS {
                break;
            }
            side_m *= 0.5;
            let quarters = kept.into_iter().flat_map(|(x, y)| {
                [(2 * x - 1, 2 * y - 1), (2 * x - 1, 2 * y + 1), (2 * x + 1, 2 * y - 1), (2 * x + 1, 2 * y + 1)]
            });
            cells = self.weighed(quarters, side_m);
        }
        (cells, side_m)
    }

    /// The probability of each cell; their sum is 1.
    fn weighed(&self, cells: impl Iterator<Item = Cell>, side_m: f64) -> BTreeMap<Cell, f64> {
        let exponent = temper(self.spots.iter().map(Spot::known).sum(), OWN_SHARE);
        let room = ROOM_M * ROOM_M;
        let ln = |cell: Cell| {
            let offset_m = offset_m(cell, side_m);
            let prior = -(room + offset_m.norm_squared()).ln();
            let said = |spot: &Spot| spot.ln_likelihood(self.middle_m + offset_m, 0.5 * side_m);
            prior + exponent * self.spots.iter().map(said).sum::<f64>()
        };
        let found: Vec<(Cell, f64)> = cells.map(|cell| (cell, ln(cell))).collect();
        let most = found.iter().map(|(_, ln)| *ln).fold(f64::MIN, f64::max);
        let total: f64 = found.iter().map(|(_, ln)| (ln - most).exp()).sum();
        found.into_iter().map(|(cell, ln)| (cell, (ln - most).exp() / total)).collect()
    }
}

/// From the grid's middle to a cell's centre, metres.
fn offset_m((x, y): Cell, side_m: f64) -> Vector2<f64> {
    Vector2::new(f64::from(x), f64::from(y)) * (0.5 * side_m)
}

/// The fewest cells that hold [`KEPT`] of the probability.
fn likeliest(cells: &BTreeMap<Cell, f64>) -> Vec<Cell> {
    let mut falling: Vec<(Cell, f64)> = cells.iter().map(|(cell, p)| (*cell, *p)).collect();
    falling.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut sum = 0.0;
    let needed = falling.iter().take_while(|(_, p)| {
        let goes_on = sum < KEPT;
        sum += p;
        goes_on
    });
    needed.map(|(cell, _)| *cell).collect()
}

/// The probability of a cell before any evidence, in a plane as wide as [`PLANE_M`].
fn prior(cell: Cell, side_m: f64) -> f64 {
    let room = ROOM_M * ROOM_M;
    let whole = PI * (1.0 + PLANE_M * PLANE_M / room).ln();
    side_m * side_m / (whole * (room + offset_m(cell, side_m).norm_squared()))
}

/// The connected places about the likeliest cells, each with its mean and covariance. Cells no likelier than before any
/// evidence are no place: they remain if no direction is right.
fn clusters(mut cells: BTreeMap<Cell, f64>, middle_m: Vector2<f64>, side_m: f64) -> Vec<PeerPlace> {
    let mut places: Vec<PeerPlace> = Vec::new();
    let mut falling: Vec<(Cell, f64)> = cells.iter().map(|(cell, p)| (*cell, *p)).collect();
    falling.sort_by(|a, b| b.1.total_cmp(&a.1));
    for (highest, p) in falling {
        if !cells.contains_key(&highest) || p <= prior(highest, side_m) {
            continue;
        }
        let place = place(&connected(&mut cells, highest, ENDS * p), middle_m, side_m);
        if places.is_empty() || place.share >= LEAST_SHARE {
            places.push(place);
        }
        // No place that begins so low holds enough.
        if p * (cells.len() as f64) < LEAST_SHARE {
            break;
        }
    }
    if places.is_empty() {
        places.push(place(&cells.into_iter().collect::<Vec<_>>(), middle_m, side_m));
    }
    places.sort_by(|a, b| b.share.total_cmp(&a.share));
    places.truncate(MOST_PLACES);
    places
}

/// Takes the cells out that are connected to one through cells of at least this probability.
fn connected(cells: &mut BTreeMap<Cell, f64>, from: Cell, least: f64) -> Vec<(Cell, f64)> {
    let (mut taken, mut open) = (Vec::new(), vec![from]);
    while let Some(cell) = open.pop() {
        let Some(p) = cells.get(&cell).copied().filter(|p| *p >= least) else { continue };
        cells.remove(&cell);
        taken.push((cell, p));
        let (x, y) = cell;
        let about = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (x + 2 * dx, y + 2 * dy)));
        open.extend(about.filter(|other| cells.contains_key(other)));
    }
    taken
}

fn place(cells: &[(Cell, f64)], middle_m: Vector2<f64>, side_m: f64) -> PeerPlace {
    let share: f64 = cells.iter().map(|(_, p)| p).sum();
    let mean = cells.iter().map(|(cell, p)| offset_m(*cell, side_m) * *p).sum::<Vector2<f64>>() / share;
    let square = |(cell, p): &(Cell, f64)| {
        let off = offset_m(*cell, side_m) - mean;
        off * off.transpose() * *p
    };
    let within = Matrix2::identity() * (side_m * side_m / 12.0);
    let spread_m2 = cells.iter().map(square).sum::<Matrix2<f64>>() / share + within;
    let covariance_m2 = spread_m2 * (held(cells, mean, &spread_m2, side_m) / ELLIPSE);
    PeerPlace { position_m: middle_m + mean, covariance_m2, share: share.min(1.0) }
}

/// The square of the distance from the mean, in deviations, within which 68 % of a place is.
fn held(cells: &[(Cell, f64)], mean_m: Vector2<f64>, spread_m2: &Matrix2<f64>, side_m: f64) -> f64 {
    let Some(inverse) = spread_m2.try_inverse() else { return ELLIPSE };
    let away = |(cell, p): &(Cell, f64)| {
        let off_m = offset_m(*cell, side_m) - mean_m;
        (off_m.dot(&(inverse * off_m)), *p)
    };
    let mut rising: Vec<(f64, f64)> = cells.iter().map(away).collect();
    rising.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (total, mut sum) = (rising.iter().map(|(_, p)| p).sum::<f64>(), 0.0);
    let reached = rising.iter().find(|(_, p)| {
        sum += p;
        sum >= 0.68 * total
    });
    // A place of a few cells is known to a cell, not better.
    reached.map_or(ELLIPSE, |(square, _)| square.max(0.25 * ELLIPSE))
}

/// The likelihood of places, of evidence that is usable.
struct Spot {
    position_m: Vector2<f64>,
    directions: Vec<Direction>,
    /// Probability that none of them is right.
    rest: f64,
    fresh: f64,
}

/// One direction.
struct Direction {
    azimuth_rad: f64,
    sd_rad: f64,
    /// Probability that it is the right one.
    share: f64,
    range: Option<Along>,
}

/// A range.
struct Along {
    ln_range: f64,
    /// Deviation of the logarithm.
    sd: f64,
    /// Mean of its bell over the prior.
    mean: f64,
}

impl Spot {
    /// Of evidence that is usable.
    pub fn of(evidence: &Evidence) -> Self {
        let ranges = prior_ranges();
        let total: f64 = evidence.modes().map(|mode| mode.share).sum();
        let known = evidence.believed();
        let along = |(range_m, sd_m): (f64, f64)| {
            let (sd, mean) = bell(range_m, sd_m, &ranges);
            (mean > 0.0).then(|| Along { ln_range: range_m.ln(), sd, mean })
        };
        let direction = |mode: &EvidenceMode| Direction {
            azimuth_rad: mode.azimuth_rad,
            sd_rad: mode.sd_rad,
            share: known * mode.share / total,
            range: mode.range_m.and_then(along),
        };
        let directions = evidence.modes().map(direction).collect();
        Self { position_m: evidence.position_m, directions, rest: 1.0 - known, fresh: evidence.fresh.clamp(0.0, 1.0) }
    }

    /// Probability that one of its directions is right, less known evidence.
    pub fn known(&self) -> f64 {
        self.fresh * (1.0 - self.rest)
    }

    /// The logarithm of the likelihood of a place over that of a uniform guess, of azimuths and ranges that are blurred by a
    /// shift of the place, metres.
    pub fn ln_likelihood(&self, place_m: Vector2<f64>, blur_m: f64) -> f64 {
        let offset_m = place_m - self.position_m;
        let range_m = offset_m.norm().max(1e-3);
        let (azimuth_rad, blur) = (offset_m.y.atan2(offset_m.x), blur_m / range_m);
        let of = |direction: &Direction| {
            let along = direction.range.as_ref().map_or(1.0, |own| own.density(range_m, blur));
            direction.share * direction.density(azimuth_rad, blur) * along
        };
        self.fresh * (self.rest + self.directions.iter().map(of).sum::<f64>()).ln()
    }
}

impl Direction {
    /// The normal density of an azimuth over the uniform one.
    fn density(&self, azimuth_rad: f64, blur: f64) -> f64 {
        let sd_rad = self.sd_rad.hypot(blur);
        let off = wrap_rad(azimuth_rad - self.azimuth_rad) / sd_rad;
        (-0.5 * off * off).exp() * TAU.sqrt() / sd_rad
    }
}

impl Along {
    /// The density of a range over the prior; ranges are wrong more often than their deviations say.
    fn density(&self, range_m: f64, blur: f64) -> f64 {
        let sd = self.sd.hypot(blur);
        let off = (range_m.ln() - self.ln_range) / sd;
        let missed = RANGE_MISSED;
        missed + (1.0 - missed) * (-0.5 * off * off).exp() * self.sd / (sd * self.mean)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    const SD_RAD: f64 = 0.04;

    /// The fractional parts of multiples of irrational numbers: even draws without a generator.
    struct Even(u32);

    impl Even {
        fn between(&mut self, low: f64, high: f64) -> f64 {
            self.0 += 1;
            let turned = f64::from(self.0) * 0.618_033_988_749_895 + f64::from(self.0 / 7) * 0.414_213_562_373_095;
            low + (high - low) * turned.fract()
        }

        fn normal(&mut self) -> f64 {
            let (a, b) = (self.between(1e-9, 1.0), self.between(0.0, TAU));
            (-2.0 * a.ln()).sqrt() * b.cos()
        }
    }

    fn motion(from_m: Vector2<f64>, at_m: Vector2<f64>, error_rad: f64, mirror_rad: Option<f64>) -> Evidence {
        let to = at_m - from_m;
        let mut modes = vec![EvidenceMode::new(to.y.atan2(to.x) + error_rad, SD_RAD, 0.5)];
        modes.extend(mirror_rad.map(|azimuth_rad| EvidenceMode::new(azimuth_rad, SD_RAD, 0.5)));
        Evidence::new(0.0, from_m, modes, 0.95)
    }

    #[test]
    fn a_peer_is_in_its_ellipse_as_often_as_that_says() {
        let mut even = Even(0);
        let (mut within, mut shares, mut longer_m, rooms) = (0.0, 0.0, Vec::new(), 60.0);
        for _ in 0..60 {
            let turned = even.between(0.0, TAU);
            let at_m = Vector2::new(turned.cos(), turned.sin()) * even.between(3.0, 6.0);
            let motions: Vec<Evidence> = (0..3)
                .map(|k| {
                    let angle = TAU * f64::from(k) / 3.0 + even.between(-0.5, 0.5);
                    let from_m = Vector2::new(angle.cos(), angle.sin()) * even.between(1.0, 2.0);
                    let mirror_rad = even.between(-PI, PI);
                    motion(from_m, at_m, SD_RAD * even.normal(), (k < 2).then_some(mirror_rad))
                })
                .collect();
            let found = places(&motions).unwrap();
            let best = found.places[0];
            let off = best.position_m - at_m;
            within += f64::from(u8::from(off.dot(&(best.covariance_m2.try_inverse().unwrap() * off)) < 2.28)) / rooms;
            shares += best.share / rooms;
            longer_m.push((ELLIPSE * best.covariance_m2.symmetric_eigenvalues().max()).sqrt());
            assert_eq!((found.used, found.refused), (3, 0));
        }
        // Motions are taken as deceived together, in part; these are not, so the ellipse holds more than 68 %.
        assert!(
            within >= 0.68 && shares > 0.6 && longer_m.iter().sum::<f64>() < 2.5 * rooms,
            "{within} {shares} {longer_m:?}"
        );
    }

    #[test]
    fn turning_and_shifting_the_frame_turns_and_shifts_the_place() {
        let at_m = Vector2::new(4.0, -2.0);
        let seen = [[0.0, 0.0], [1.0, 2.0], [-1.0, 1.0]].map(|from| motion(from.into(), at_m, 0.0, None));
        let (origin_m, yaw_rad) = (Vector2::new(-3.0, 7.0), 2.5);
        let moved = seen.clone().map(|own| own.in_frame(origin_m, yaw_rad));
        let [here, there] = [places(&seen).unwrap(), places(&moved).unwrap()].map(|found| found.places[0]);
        let expected = origin_m + nalgebra::Rotation2::new(yaw_rad) * here.position_m;
        assert!(
            (there.position_m - expected).norm() < 0.12 && (here.position_m - at_m).norm() < 0.5,
            "{here:?} {there:?}"
        );
        let wide = places(&seen.map(|own| own.with_heading_sd_rad(0.1))).unwrap().places[0];
        assert!(wide.covariance_m2.trace() > 1.5 * here.covariance_m2.trace(), "{wide:?}");
    }

    #[test]
    fn one_direction_is_a_long_place_and_a_range_shortens_it() {
        let mut own = motion(Vector2::zeros(), Vector2::new(5.0, 0.0), 0.0, None);
        let long = places(std::slice::from_ref(&own)).unwrap().places[0];
        own.modes[0] = own.modes[0].with_range_m(Some((5.0, 0.3)));
        let short = places(&[own]).unwrap().places[0];
        let along = |place: &PeerPlace| place.covariance_m2[(0, 0)].sqrt();
        assert!(along(&long) > 4.0 && along(&short) < 0.8 * along(&long), "{long:?} {short:?}");
        assert!(long.covariance_m2[(1, 1)] < long.covariance_m2[(0, 0)] / 20.0, "{long:?}");
    }

    #[test]
    fn without_usable_evidence_the_reason_is_given() {
        assert_eq!(places(&[]), Err(TrackError::NoDirection { modes: 0 }));
        let broken = Evidence::new(f64::NAN, Vector2::zeros(), Vec::new(), 0.9);
        assert!(matches!(places(&[broken]), Err(TrackError::NotFinite { what: "time", .. })));
    }

    const DEGREE: f64 = PI / 180.0;

    fn settings() -> TrackSettings {
        TrackSettings::new(0.0)
    }

    /// Azimuth from `from` to `to`, radians.
    fn azimuth(from: Vector2<f64>, to: Vector2<f64>) -> f64 {
        (to - from).y.atan2((to - from).x)
    }

    /// What a stretch says that sees these places alike.
    fn seen(t_s: f64, from: Vector2<f64>, places: &[Vector2<f64>]) -> Evidence {
        let mode = |place: &Vector2<f64>| EvidenceMode::new(azimuth(from, *place), DEGREE, 1.0);
        Evidence::new(t_s, from, places.iter().map(mode).collect(), 0.95)
    }

    /// What a stretch along the direction `axis_rad` says: the place and its mirror image in that line are alike.
    fn mirrored(t_s: f64, from: Vector2<f64>, axis_rad: f64, place: Vector2<f64>) -> Evidence {
        let own = azimuth(from, place);
        let modes = [own, wrap_rad(2.0 * axis_rad - own)].map(|azimuth| EvidenceMode::new(azimuth, DEGREE, 0.5));
        Evidence::new(t_s, from, modes.to_vec(), 0.95)
    }

    fn off_deg(answer: &TrackAnswer, truth_rad: f64) -> f64 {
        wrap_rad(answer.azimuth_rad - truth_rad).abs() / DEGREE
    }

    #[test]
    fn two_lines_in_different_directions_settle_which_side_the_peer_is_on() {
        let peer = Vector2::new(3.0, 2.0);
        for side in [1.0, -1.0] {
            let peer = Vector2::new(peer.x, side * peer.y);
            let mut track = PeerTrack::new(settings());
            track.update(&mirrored(0.0, Vector2::new(0.5, 0.0), 0.0, peer)).unwrap();
            let first = track.last_answer().unwrap();
            assert!(first.probability < 0.52 && first.modes.len() == 2, "{first:?}");
            assert!((first.modes[0].share - first.modes[1].share).abs() < 1e-6, "{first:?}");
            let from = Vector2::new(1.0, 0.5);
            track.update(&mirrored(5.0, from, FRAC_PI_2, peer)).unwrap();
            let second = track.last_answer().unwrap();
            assert!(off_deg(&second, azimuth(from, peer)) < 1.0 && second.probability > 0.55, "{second:?}");
            assert!(second.modes.iter().skip(1).all(|mode| 4.0 * mode.share < second.probability), "{second:?}");
            assert!(second.azimuth_sd_rad < 0.6 * first.azimuth_sd_rad && second.stretches == 2, "{second:?}");
        }
    }

    #[test]
    fn a_candidate_that_moves_with_the_robot_loses_to_one_that_stays() {
        let peer = Vector2::new(4.0, 1.0);
        let mut track = PeerTrack::new(settings());
        for k in 0..3 {
            let from = Vector2::new(0.0, 1.2 * f64::from(k));
            // It turns ahead where a place would fall behind, and is the stronger of the two.
            let gliding = EvidenceMode::new(PI - 10.0 * DEGREE * f64::from(k), DEGREE, 2.0);
            let still = EvidenceMode::new(azimuth(from, peer), DEGREE, 1.0);
            track.update(&Evidence::new(f64::from(k), from, vec![gliding, still], 0.95)).unwrap();
            let answer = track.last_answer().unwrap();
            let truth = if k == 0 { PI } else { azimuth(from, peer) };
            assert!(off_deg(&answer, truth) < 2.0, "{k}: {answer:?}");
        }
        assert!(track.last_answer().unwrap().probability > 0.5);
    }

    #[test]
    fn stretches_that_are_deceived_together_are_not_as_sure_as_independent_ones() {
        let places = [Vector2::new(4.0, 1.0), Vector2::new(-3.0, 2.0)];
        let sure = [1.0, 0.3, 0.0].map(|own_share| {
            let mut track = PeerTrack::new(TrackSettings { own_share, ..settings() });
            for k in 0..4 {
                let mut evidence = seen(f64::from(k), Vector2::new(0.0, 0.2 * f64::from(k)), &places);
                evidence.modes[1].share = 0.5;
                track.update(&evidence).unwrap();
            }
            let answer = track.last_answer().unwrap();
            assert!(off_deg(&answer, azimuth(Vector2::new(0.0, 0.6), places[0])) < 2.0, "{answer:?}");
            answer.probability
        });
        // Alone the first place has twice the share of the second: so it has of all four if they are one. Four independent ones
        // would have sixteen times.
        assert!(sure[0] > 0.85 && sure[0] > sure[1] + 0.05 && sure[1] > sure[2] + 0.05 && sure[2] < 0.75, "{sure:?}");
    }

    #[test]
    fn crossing_bearings_give_a_place_and_bearings_from_anywhere() {
        let peer = Vector2::new(-2.0, 3.0);
        let mut track = PeerTrack::new(settings());
        for (k, x) in [-3.0, -1.0, 1.0, 2.0].into_iter().enumerate() {
            track.update(&seen(k as f64, Vector2::new(x, 0.0), &[peer])).unwrap();
        }
        let (place, covariance) = track.last_answer().unwrap().place_m.unwrap();
        assert!((place - peer).norm() < 0.3 && covariance.determinant() > 0.0, "{place} {covariance}");
        for from in [Vector2::new(0.0, 6.0), Vector2::new(-6.0, 3.0), Vector2::new(1.0, 1.0)] {
            let answer = track.answer(from).unwrap();
            assert!(off_deg(&answer, azimuth(from, peer)) < 3.0 && answer.probability > 0.35, "{from} {answer:?}");
        }
        assert!(track.answer(Vector2::new(f64::NAN, 0.0)).is_none());
    }

    #[test]
    fn a_range_tells_two_places_in_one_direction_apart() {
        let (near, far) = (Vector2::new(2.0, 0.0), Vector2::new(12.0, 0.0));
        let from = Vector2::new(1.0, 1.0);
        let odds = [None, Some((2.0, 0.2)), Some((12.0, 1.0))].map(|range_m| {
            let mut track = PeerTrack::new(settings());
            let mode = EvidenceMode::new(0.0, DEGREE, 1.0).with_range_m(range_m);
            track.update(&Evidence::new(0.0, Vector2::zeros(), vec![mode], 0.95)).unwrap();
            let modes = [near, far].map(|place| EvidenceMode::new(azimuth(from, place), DEGREE, 0.5));
            track.update(&Evidence::new(1.0, from, modes.to_vec(), 0.95)).unwrap();
            let answer = track.last_answer().unwrap();
            let share = |place| {
                let about = |mode: &&TrackMode| wrap_rad(mode.azimuth_rad - azimuth(from, place)).abs() < 5.0 * DEGREE;
                answer.modes.iter().filter(about).map(|mode| mode.share).sum::<f64>().max(0.01)
            };
            share(near) / share(far)
        });
        assert!(odds[1] > 2.0 * odds[0] && odds[0] > 1.5 * odds[2], "{odds:?}");
    }

    #[test]
    fn odometry_that_drifts_makes_what_was_known_less_sure() {
        let peer = Vector2::new(3.0, 0.0);
        let shares = [0.0, 2.0, 20.0].map(|turn_deg: f64| {
            let drifting = TrackSettings { turn_rad_per_rt_m: turn_deg * DEGREE, ..settings() };
            let mut track = PeerTrack::new(drifting);
            track.update(&seen(0.0, Vector2::zeros(), &[peer])).unwrap();
            // Sees next to nothing, after a metre.
            let blind = Evidence::new(9.0, Vector2::new(0.0, 1.0), vec![EvidenceMode::new(0.0, PI, 1.0)], 0.01);
            track.update(&blind.with_driven_m(1.0)).unwrap();
            track.last_answer().unwrap().azimuth_sd_rad
        });
        assert!(shares[0] < shares[1] && 2.0 * shares[1] < shares[2], "{shares:?}");
        let wandering = |wander| {
            let mut track = PeerTrack::new(TrackSettings { wander_m_per_rt_s: wander, ..settings() });
            track.update(&seen(0.0, Vector2::zeros(), &[peer])).unwrap();
            track.update(&seen(100.0, Vector2::new(0.0, 0.1), &[Vector2::new(0.0, 3.0)])).unwrap();
            off_deg(&track.last_answer().unwrap(), FRAC_PI_2)
        };
        // A peer that may have gone anywhere is where it is seen last.
        assert!(wandering(0.5) < 3.0, "{}", wandering(0.5));
    }

    #[test]
    fn a_peer_that_was_carried_elsewhere_is_found_there() {
        let (before, after) = (Vector2::new(3.0, 0.0), Vector2::new(0.0, -3.0));
        let mut track = PeerTrack::new(settings());
        let at = |k: u32| Vector2::new(0.0, 0.3 * f64::from(k));
        (0..20).for_each(|k| track.update(&seen(f64::from(k), at(k), &[before])).unwrap());
        let needed = (20..30).find(|k| {
            track.update(&seen(f64::from(*k), at(*k), &[after])).unwrap();
            off_deg(&track.last_answer().unwrap(), azimuth(at(*k), after)) < 5.0
        });
        assert!(needed.is_some_and(|k| k <= 23), "{needed:?}");
    }

    #[test]
    fn a_new_frame_and_a_long_silence_begin_anew_and_are_counted() {
        let mut track = PeerTrack::new(TrackSettings { gone_s: 60.0, ..settings() });
        track.reset();
        assert_eq!(track.counts(), TrackCounts::default());
        let peer = Vector2::new(3.0, 0.0);
        track.update(&seen(0.0, Vector2::zeros(), &[peer])).unwrap();
        track.reset();
        assert!(track.last_answer().is_none() && track.answer(Vector2::zeros()).is_none() && track.last_s().is_none());
        // After a new frame an earlier time is none.
        track.update(&seen(-5.0, Vector2::zeros(), &[peer])).unwrap();
        track.update(&seen(100.0, Vector2::zeros(), &[-peer])).unwrap();
        let answer = track.last_answer().unwrap();
        assert!(answer.stretches == 1 && off_deg(&answer, PI) < 1.0, "{answer:?}");
        let counts = track.counts();
        assert_eq!((counts.used, counts.refused, counts.reset, counts.gone), (3, 0, 1, 1));
    }

    #[test]
    fn what_cannot_be_used_is_refused_and_changes_nothing() {
        let mut track = PeerTrack::new(settings());
        let good = seen(10.0, Vector2::zeros(), &[Vector2::new(3.0, 0.0)]);
        track.update(&good).unwrap();
        let before = track.last_answer();
        let mode = EvidenceMode::new(0.1, DEGREE, 1.0);
        let with = |modes: Vec<EvidenceMode>| Evidence { modes, ..good.clone() };
        let nothing = [
            vec![],
            vec![EvidenceMode { azimuth_rad: f64::NAN, ..mode }],
            vec![EvidenceMode { sd_rad: 0.0, ..mode }, EvidenceMode { sd_rad: f64::INFINITY, ..mode }],
            vec![EvidenceMode { share: 0.0, ..mode }, EvidenceMode { share: -1.0, ..mode }],
            vec![mode.with_range_m(Some((0.0, 1.0))), mode.with_range_m(Some((f64::NAN, 1.0)))],
        ];
        for modes in nothing {
            let count = modes.len();
            assert_eq!(track.update(&with(modes)), Err(TrackError::NoDirection { modes: count }));
        }
        let bad = [
            Evidence { t_s: f64::NAN, ..good.clone() },
            Evidence { position_m: Vector2::new(0.0, f64::INFINITY), ..good.clone() },
            Evidence { driven_m: f64::NAN, ..good.clone() },
            Evidence { known: f64::NAN, ..good.clone() },
            Evidence { fresh: f64::NAN, ..good.clone() },
        ];
        for evidence in bad {
            assert!(matches!(track.update(&evidence), Err(TrackError::NotFinite { .. })), "{evidence:?}");
        }
        let early = Evidence { t_s: 9.0, ..good.clone() };
        assert_eq!(track.update(&early), Err(TrackError::OutOfOrder { t_s: 9.0, last_s: 10.0 }));
        assert_eq!((track.counts().refused, track.counts().used), (11, 1));
        assert_eq!(track.last_answer(), before);
        // A direction that cannot be used takes nothing from one that can.
        track.update(&with(vec![mode, EvidenceMode { share: f64::NAN, ..mode }])).unwrap();
    }

    #[test]
    fn numbers_at_the_ends_of_what_there_is_leave_answers_finite() {
        let extremes = [0.0, 1e-300, 1e-9, 1.0, 1e9, 1e300];
        let mut track = PeerTrack::new(TrackSettings { turn_rad_per_rt_m: 1e300, slip: 1e300, ..settings() });
        for (k, value) in extremes.into_iter().enumerate() {
            let mode = EvidenceMode::new(value, value.max(1e-300), 1.0).with_range_m(Some((value.max(1e-300), value)));
            let evidence = Evidence::new(k as f64, Vector2::new(value, -value), vec![mode], value).with_driven_m(value);
            track.update(&evidence.with_fresh(value)).unwrap();
            let answer = track.last_answer().unwrap();
            let numbers = [answer.azimuth_rad, answer.azimuth_sd_rad, answer.probability];
            assert!(numbers.iter().all(|number| number.is_finite()), "{value}: {answer:?}");
        }
    }

    #[test]
    fn the_same_evidence_gives_the_same_answer_whichever_way_azimuths_are_wrapped() {
        let run = |turns: f64| {
            let mut track = PeerTrack::new(settings());
            for k in 0..4 {
                let from = Vector2::new(0.4 * f64::from(k), 0.0);
                let mut evidence = seen(f64::from(k), from, &[Vector2::new(-4.0, 0.05), Vector2::new(-3.0, -4.0)]);
                evidence.modes.iter_mut().for_each(|mode| mode.azimuth_rad += turns * 2.0 * PI);
                track.update(&evidence).unwrap();
            }
            track.last_answer().unwrap()
        };
        assert_eq!(run(0.0), run(0.0));
        // The first place is straight behind, on the cut of the azimuth.
        let (own, turned) = (run(0.0), run(3.0));
        assert!(wrap_rad(own.azimuth_rad - turned.azimuth_rad).abs() < 1e-9, "{own:?} {turned:?}");
        assert!((own.probability - turned.probability).abs() < 1e-9);
    }

    #[test]
    fn evidence_that_is_not_new_changes_nothing_and_an_answer_with_it_takes_nothing() {
        let mut track = PeerTrack::new(settings());
        let evidence = seen(0.0, Vector2::zeros(), &[Vector2::new(3.0, 0.0)]);
        track.update(&evidence).unwrap();
        let before = track.last_answer();
        let elsewhere = seen(1.0, Vector2::zeros(), &[Vector2::new(0.0, 3.0)]);
        let beside = track.answer_with(&elsewhere.clone().with_fresh(0.0)).unwrap();
        assert!(off_deg(&beside, 0.0) < 0.1, "{beside:?}");
        assert!(off_deg(&track.answer_with(&elsewhere).unwrap(), 0.0) > 1.0 || beside.probability > 0.5);
        assert_eq!((track.last_answer(), track.counts().used), (before, 1));
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
