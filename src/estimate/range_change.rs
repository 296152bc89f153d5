//! How the distance to the transmitter changed from exchange to exchange, from the round trip's phase.
//!
//! The phase of a round trip falls by `4 pi / lambda` for each metre that the path grows, so it shows the change of the
//! distance to fractions of a millimetre, modulo half a wavelength. In a fade it may slip by a whole turn, which only
//! the odometry along the bearing shows:
//!
//! 1. **Prediction.** Each exchange's distance to the place that the bearing found. Turned back by it, the direct path stands still
//!    on every subcarrier and paths from elsewhere turn; over an eighth of a wavelength of motion they are averaged out in part.
//! 2. **One phase for each step of the motion**: the part of its subcarriers that is along their common vector over the whole motion.
//!    In a fade little of them is, and the phase has little weight.
//! 3. **What the prediction got wrong** is a random walk along the motion, of phases with a von Mises density about it. Its probability
//!    is computed on a grid over several cycles, forward and backward (a hidden Markov model \[rabiner1989\]), so the odometry bridges a fade and
//!    the deviation says how well, with the wrong cycles in it. Concentration and walk are those under which the phases are likeliest.
//! 4. **Once more** about a better prediction: its scale and its direction by least squares of the walk.
//!
//! Conventions are those of [`crate::signal::samples`]: a longer path lowers the phase.

use super::likelihood::Place;
use super::signal::{Bins, align, remove_slope};
use crate::bartlett::Tier;
use crate::signal::channel::SUBCARRIERS;
use crate::signal::planes::{LANES, Planes};
use crate::signal::samples::Samples;
use nalgebra::{Matrix3, Vector3};
use num_complex::{Complex32, Complex64};
use std::cmp::Ordering;
use std::f64::consts::{FRAC_PI_2, TAU};
use std::fmt;

/// One phase for each of these, wavelengths of motion: a quarter of a turn of the round trip straight ahead, so that
/// reflections make the phases of two neighbours differently wrong.
const STEP_WAVELENGTHS: f64 = 0.125;
/// Fewer phases tell a wave from nothing only by chance.
const LEAST_STEPS: usize = 8;
/// Cells of the grid in half a wavelength, and how many half wavelengths it reaches to either side of the prediction.
const CELLS: usize = 32;
const CYCLES: usize = 3;
/// Walks that are tried: metres by which odometry is wrong after a metre, from motion capture to slipping wheels. The phases
/// choose among them.
const WALKS: [f64; 5] = [0.003, 0.006, 0.012, 0.025, 0.05];
/// Deviation of a prediction's relative scale, and of its direction in radians, before the phases say what they are.
const PREDICTION: f64 = 0.1;
/// Predictions that are tried: the place's, and each time the one that fits what the one before led to.
const PASSES: usize = 3;
/// `ln` of how much likelier than by chance the phases have to be.
const DECISIVE: f64 = 7.0;

/// The change of the distance to the transmitter along a motion, an entry for each exchange that the bearing was made of.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct RangeChange {
    /// Seconds on the trajectory's clock.
    pub t_s: Vec<f64>,
    /// Distance between the antennas less that at the first exchange, metres; of the path that the bearing is of.
    pub range_change_m: Vec<f64>,
    /// Its standard deviation, metres: noise, possible undetected slips, and the direction's deviation. In a fade it
    /// grows with the odometry's error.
    pub deviation_m: Vec<f64>,
    /// Whether the phase is known to its cycle at each exchange: the deviation of its distance is below an eighth of a wavelength.
    pub held: Vec<bool>,
    /// Exchanges, by their place in the lists, at which the phase, merely unwrapped, slips by half a wavelength of distance; that
    /// is removed.
    pub slips: Vec<usize>,
    /// Mean part of the channel that follows the range change, 0..1.
    pub coherence: f64,
}

impl RangeChange {
    /// Share of the exchanges at which the phase is known to its cycle, 0..1.
    #[must_use]
    pub fn held_share(&self) -> f64 {
        self.held.iter().filter(|held| **held).count() as f64 / self.held.len().max(1) as f64
    }
}

/// Why a link has no range change.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum NoRangeChange {
    /// Too little motion, in steps of an eighth of a wavelength.
    Short {
        /// Steps.
        steps: usize,
    },
    /// The direction of the bearing, along which odometry predicts the phases, is known too badly.
    Doubtful {
        /// Half of the width that holds 68 % of its probability, radians, without the heading of the whole path.
        direction_sd_rad: f64,
    },
    /// The phases follow the prediction no better than random ones might.
    Incoherent {
        /// Mean part of the channel that followed, 0..1.
        coherence: f64,
    },
}

impl fmt::Display for NoRangeChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Short { steps } => write!(
                f,
                "the motion is {steps} steps of an eighth of a wavelength, at least {LEAST_STEPS} are needed: drive further"
            ),
            Self::Doubtful { direction_sd_rad } => write!(
                f,
                "the direction is known to {:.0} degrees, {:.0} are needed: drive a longer or more curved path",
                direction_sd_rad.to_degrees(),
                PREDICTION.to_degrees()
            ),
            Self::Incoherent { coherence } => write!(
                f,
                "the phases follow the odometry no better than random ones (coherence {coherence:.2}): check the trajectory's times, \
                 and the antenna's place on the robot"
            ),
        }
    }
}

/// The range change of `samples`, whose round trips on all subcarriers are `rows`, one for each. `place` is where the bearing
/// found the transmitter from `middle_m`; the deviation of its direction is without the heading of the whole path, which turns
/// the place along with the path.
///
/// # Errors
/// Why the phases say nothing.
pub(crate) fn range_change(
    samples: &Samples,
    mut rows: Vec<Planes>,
    indices: &[i8; SUBCARRIERS],
    (place, direction_sd_rad): (&Place, f64),
    middle_m: Vector3<f64>,
    tier: Tier,
) -> Result<RangeChange, NoRangeChange> {
    let wavelength_m = samples.wavelength_m();
    let points: Vec<Vector3<f64>> = samples.displacements_m().map(|p| p - middle_m).collect();
    let steps = Steps::along(&points, STEP_WAVELENGTHS * wavelength_m);
    if steps.len() < LEAST_STEPS {
        return Err(NoRangeChange::Short { steps: steps.len() });
    }
    if direction_sd_rad.is_nan() || direction_sd_rad > PREDICTION {
        return Err(NoRangeChange::Doubtful { direction_sd_rad });
    }
    remove_slope(&mut rows, indices, tier);
    align(&mut rows, indices, tier);
    let wavenumber = samples.kappa();
    let prediction = Prediction::of(place, &points);
    let mut followed = follow(&rows, &steps, prediction.range_m.clone(), wavenumber);
    for _ in 1..PASSES {
        let next = follow(&rows, &steps, prediction.fitted(&followed, &steps), wavenumber);
        if next.walk.log_evidence.partial_cmp(&followed.walk.log_evidence) != Some(Ordering::Greater) {
            break;
        }
        followed = next;
    }
    let coherence = followed.coherence;
    // Not a number is not decisive either.
    if followed.walk.log_evidence.partial_cmp(&DECISIVE) != Some(Ordering::Greater) {
        return Err(NoRangeChange::Incoherent { coherence });
    }
    let turn_m = prediction.turn_m.iter().map(|turn_m| direction_sd_rad * turn_m).collect();
    Ok(followed.at_exchanges(samples, &steps, wavenumber, turn_m))
}

/// Exchanges by steps of the motion.
struct Steps {
    bins: Bins,
    /// Way driven at each exchange, metres.
    driven_m: Vec<f64>,
    /// Its mean in each step.
    middles_m: Vec<f64>,
}

impl Steps {
    fn along(points_m: &[Vector3<f64>], step_m: f64) -> Self {
        let (bins, driven_m) = Bins::every(step_m, points_m);
        let middles_m = bins.means_of(&driven_m);
        Self { bins, driven_m, middles_m }
    }

    fn len(&self) -> usize {
        self.bins.len()
    }

    /// At each exchange, between the values of the steps about it.
    fn between(&self, values: &[f64]) -> Vec<f64> {
        let one = |(step, driven_m): (&usize, &f64)| {
            let (from, to) = if *driven_m < self.middles_m[*step] {
                (step.saturating_sub(1), *step)
            } else {
                (*step, (step + 1).min(self.len() - 1))
            };
            let way_m = self.middles_m[to] - self.middles_m[from];
            let share = if way_m > 0.0 { (driven_m - self.middles_m[from]) / way_m } else { 0.0 };
            values[from] + share.clamp(0.0, 1.0) * (values[to] - values[from])
        };
        self.bins.of.iter().zip(&self.driven_m).map(one).collect()
    }

    /// One row of unit power for each step, of rows turned back by `range_m`; zeros if there is nothing.
    fn rows(&self, rows: &[Planes], range_m: &[f64], wavenumber: f64) -> Vec<Planes> {
        let mut sums = vec![Planes::ZERO; self.len()];
        for ((step, row), range_m) in self.bins.of.iter().zip(rows).zip(range_m) {
            let turn = Complex64::cis(wavenumber * range_m);
            sums[*step].add(&scaled(row, Complex32::new(turn.re as f32, turn.im as f32)));
        }
        sums.iter_mut().for_each(|sum| *sum = unit(sum));
        sums
    }
}

fn scaled(row: &Planes, by: Complex32) -> Planes {
    row.times(&Planes { re: [by.re; LANES], im: [by.im; LANES] })
}

/// A row of unit power, or zeros.
fn unit(row: &Planes) -> Planes {
    let power: f32 = row.sizes().iter().map(|size| size * size).sum();
    let by = 1.0 / power.sqrt();
    if by.is_finite() { scaled(row, Complex32::new(by, 0.0)) } else { Planes::ZERO }
}

/// The distance by odometry.
struct Prediction {
    /// Distance to the place, less that from the middle, at each exchange, metres.
    range_m: Vec<f64>,
    /// How it changes with the place's azimuth, metres per radian.
    turn_m: Vec<f64>,
}

impl Prediction {
    fn of(place: &Place, points_m: &[Vector3<f64>]) -> Self {
        let (towards, way_m) = (place.towards(), place.ways_m());
        let (sin, cos) = place.azimuth.sin_cos();
        let aside = Vector3::new(-sin, cos, 0.0) * place.elevation.cos();
        let one = |p: &Vector3<f64>| (way_m(p), -aside.dot(p) / (towards - p * place.curve).norm());
        let (range_m, turn_m) = points_m.iter().map(one).unzip();
        Self { range_m, turn_m }
    }

    /// With the scale and the direction that fit what was followed, by least squares with a prior.
    fn fitted(&self, followed: &Followed, steps: &Steps) -> Vec<f64> {
        let about = |values: &[f64]| {
            let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
            values.iter().map(|value| value - mean).collect::<Vec<f64>>()
        };
        let (range_m, turn_m) = (about(&self.range_m), about(&self.turn_m));
        let columns = [steps.bins.means_of(&range_m), steps.bins.means_of(&turn_m)];
        let walk = &followed.walk;
        let moved: Vec<f64> = followed.range_m.iter().zip(&self.range_m).map(|(own, first)| own - first).collect();
        let moved = steps.bins.means_of(&moved);
        let open = PREDICTION.powi(-2);
        let mut normal = Matrix3::from_diagonal(&Vector3::new(open, open, 0.0));
        let mut right = Vector3::zeros();
        for (k, (mean_m, sd_m)) in walk.mean_m.iter().zip(&walk.sd_m).enumerate() {
            let row = Vector3::new(columns[0][k], columns[1][k], 1.0);
            let weight = sd_m.max(LEAST_SD_M).powi(-2);
            normal += row * row.transpose() * weight;
            right += row * (weight * (moved[k] + mean_m));
        }
        let fit = normal.try_inverse().map_or(Vector3::zeros(), |inverse| inverse * right);
        let each = self.range_m.iter().zip(range_m.iter().zip(&turn_m));
        each.map(|(own, (range, turn))| own + fit.x * range + fit.y * turn + fit.z).collect()
    }
}

/// No phase is better, metres: what a cell of the grid resolves.
const LEAST_SD_M: f64 = 1e-4;

/// The phases about a prediction.
struct Followed {
    /// The prediction at each exchange, metres.
    range_m: Vec<f64>,
    /// One phase for each step, with its weight as magnitude.
    phasors: Vec<Complex64>,
    walk: Walk,
    coherence: f64,
}

/// Follows the phases about a prediction: the subcarriers' common vector and the walk in turn, twice.
fn follow(rows: &[Planes], steps: &Steps, range_m: Vec<f64>, wavenumber: f64) -> Followed {
    let rows = steps.rows(rows, &range_m, wavenumber);
    let ways_m: Vec<f64> = steps.middles_m.windows(2).map(|pair| pair[1] - pair[0]).collect();
    // Before anything is known, phases that follow by half are neither believed nor left aside.
    let (mut mean_m, mut least) = (vec![0.0; rows.len()], 0.5);
    let mut turn = || {
        let phasors = phasors(&rows, &mean_m, wavenumber);
        let along = phasors.iter().zip(&mean_m).map(|(y, m)| (y * Complex64::cis(wavenumber * m)).re);
        let coherence = along.sum::<f64>() / rows.len() as f64;
        let kappa = concentration(coherence.max(least));
        let grid = Grid { wavenumber, kappa };
        let walks = WALKS.iter().map(|&walk| grid.walk(&phasors, &ways_m, walk));
        let walk = walks.max_by(|a, b| a.log_evidence.total_cmp(&b.log_evidence)).unwrap_or_default();
        (mean_m, least) = (walk.mean_m.clone(), LEAST_COHERENCE);
        (phasors, walk, coherence)
    };
    turn();
    let (phasors, walk, coherence) = turn();
    Followed { range_m, phasors, walk, coherence }
}

/// Coherences that a concentration is computed of.
const LEAST_COHERENCE: f64 = 0.05;
const MOST_COHERENCE: f64 = 0.99;

/// The part of each row along the common vector of all, which are turned back by `mean_m` before.
fn phasors(rows: &[Planes], mean_m: &[f64], wavenumber: f64) -> Vec<Complex64> {
    let mut common = Planes::ZERO;
    for (row, mean_m) in rows.iter().zip(mean_m) {
        let turn = Complex64::cis(wavenumber * mean_m);
        common.add(&scaled(row, Complex32::new(turn.re as f32, turn.im as f32)));
    }
    let common = unit(&common);
    let along = |row: &Planes| {
        let sum = row.against(&common).sum();
        Complex64::new(f64::from(sum.re), f64::from(sum.im))
    };
    rows.iter().map(along).collect()
}

/// The concentration of a von Mises density with this mean resultant length, to a percent \[mardia-jupp\].
fn concentration(coherence: f64) -> f64 {
    let r = coherence.min(MOST_COHERENCE);
    r * (2.0 - r * r) / (1.0 - r * r)
}

/// `ln I_0(x)`, Abramowitz and Stegun 9.8.1 and 9.8.2.
fn ln_bessel_i0(x: f64) -> f64 {
    if x < 3.75 {
        let t = (x / 3.75).powi(2);
        let series = [3.515_622_9, 3.089_942_4, 1.206_749_2, 0.265_973_2, 0.036_076_8, 0.004_581_3];
        return (1.0 + t * series.iter().rev().fold(0.0, |sum, c| sum * t + c)).ln();
    }
    let t = 3.75 / x;
    let series = [
        0.398_942_28,
        0.013_285_92,
        0.002_253_19,
        -0.001_575_65,
        0.009_162_81,
        -0.020_577_06,
        0.026_355_37,
        -0.016_476_33,
        0.003_923_77,
    ];
    x - 0.5 * x.ln() + series.iter().rev().fold(0.0, |sum, c| sum * t + c).ln()
}

/// What the prediction got wrong, at each step.
#[derive(Clone, Debug, Default)]
struct Walk {
    /// Its mean over the posterior, metres.
    mean_m: Vec<f64>,
    /// Its deviation, metres.
    sd_m: Vec<f64>,
    /// `ln` of the phases' likelihood over that of random ones.
    log_evidence: f64,
}

/// The errors that a prediction may have, metres: cells about 0.
#[derive(Clone, Copy)]
struct Grid {
    /// Radians of phase for each metre.
    wavenumber: f64,
    /// Concentration of a phase of weight 1.
    kappa: f64,
}

impl Grid {
    /// Cells on either side of 0.
    const SIDE: usize = CELLS * CYCLES;

    fn cell_m(&self) -> f64 {
        TAU / self.wavenumber / CELLS as f64
    }

    fn offset_m(&self, cell: usize) -> f64 {
        (cell as f64 - Self::SIDE as f64) * self.cell_m()
    }

    /// Likelihood of a phase in each cell over its greatest, and `ln` of that over the density of random phases.
    fn likelihood(&self, phasor: Complex64) -> (Vec<f64>, f64) {
        let weight = self.kappa * phasor.norm();
        // The same in every cycle.
        let of = |cell: usize| {
            let turned = phasor * Complex64::cis(self.wavenumber * self.offset_m(cell));
            (self.kappa * turned.re - weight).exp()
        };
        let cycle: Vec<f64> = (0..CELLS).map(of).collect();
        (cycle.iter().cycle().take(2 * Self::SIDE + 1).copied().collect(), weight - ln_bessel_i0(weight))
    }

    /// Shares that go to the cells on either side while the walk goes on by `sd_m`, from the middle on.
    fn spread(&self, sd_m: f64) -> Vec<f64> {
        let sd = sd_m / self.cell_m();
        // Below a cell a sampled density has another deviation than its own; three cells have any.
        if sd < 0.8 {
            return vec![1.0 - sd * sd, 0.5 * sd * sd];
        }
        let half: Vec<f64> = (0..=(4.0 * sd).ceil() as usize).map(|k| (-0.5 * (k as f64 / sd).powi(2)).exp()).collect();
        let sum = 2.0 * half.iter().sum::<f64>() - half[0];
        half.iter().map(|share| share / sum).collect()
    }

    /// Forward and backward over the steps, `ways_m` apart, with an error of `walk` after a metre.
    fn walk(&self, phasors: &[Complex64], ways_m: &[f64], walk: f64) -> Walk {
        let count = 2 * Self::SIDE + 1;
        let likelihoods: Vec<(Vec<f64>, f64)> = phasors.iter().map(|phasor| self.likelihood(*phasor)).collect();
        let spreads: Vec<Vec<f64>> = ways_m.iter().map(|way_m| self.spread(walk * way_m.max(0.0).sqrt())).collect();
        // One cycle in the middle: the phase's constant is not known, so the others are the same again.
        let mut state: Vec<f64> =
            (0..count).map(|cell| if cell.abs_diff(Self::SIDE) <= CELLS / 2 { 1.0 } else { 0.0 }).collect();
        normalise(&mut state);
        let (mut forward, mut log_evidence) = (Vec::with_capacity(phasors.len()), 0.0);
        for (step, (likelihood, log)) in likelihoods.iter().enumerate() {
            if let Some(spread) = step.checked_sub(1).and_then(|before| spreads.get(before)) {
                state = convolved(&state, spread);
            }
            state.iter_mut().zip(likelihood).for_each(|(share, likelihood)| *share *= likelihood);
            log_evidence += normalise(&mut state).ln() + log;
            forward.push(state.clone());
        }
        let mut backward = vec![1.0; count];
        let mut found = Walk { mean_m: vec![0.0; phasors.len()], sd_m: vec![0.0; phasors.len()], log_evidence };
        for step in (0..phasors.len()).rev() {
            let shares = forward[step].iter().zip(&backward).map(|(forward, backward)| forward * backward);
            (found.mean_m[step], found.sd_m[step]) = self.moments(shares);
            if let Some(spread) = step.checked_sub(1).and_then(|before| spreads.get(before)) {
                backward.iter_mut().zip(&likelihoods[step].0).for_each(|(share, likelihood)| *share *= likelihood);
                backward = convolved(&backward, spread);
                normalise(&mut backward);
            }
        }
        found
    }

    /// Mean and deviation, metres.
    fn moments(&self, shares: impl Iterator<Item = f64>) -> (f64, f64) {
        let (mut sum, mut first, mut second) = (0.0, 0.0, 0.0);
        for (cell, share) in shares.enumerate() {
            let offset_m = self.offset_m(cell);
            sum += share;
            first += share * offset_m;
            second += share * offset_m * offset_m;
        }
        let mean_m = first / sum;
        (mean_m, (second / sum - mean_m * mean_m).max(0.0).sqrt())
    }
}

/// Makes the sum 1 and returns what it was.
fn normalise(shares: &mut [f64]) -> f64 {
    let sum: f64 = shares.iter().sum();
    shares.iter_mut().for_each(|share| *share /= sum);
    sum
}

/// Spread to either side; what leaves the grid is lost.
fn convolved(shares: &[f64], spread: &[f64]) -> Vec<f64> {
    let (count, mut out) = (shares.len(), vec![0.0; shares.len()]);
    for (k, by) in spread.iter().enumerate().take(count) {
        out[k..].iter_mut().zip(shares).for_each(|(out, share)| *out += by * share);
        if k > 0 {
            out.iter_mut().zip(&shares[k..]).for_each(|(out, share)| *out += by * share);
        }
    }
    out
}

impl Followed {
    /// The range change at each exchange. `aside_m` is how far a deviation of the direction moves each distance: paths that pass
    /// for the direct one turn its wave front, and no phase shows that.
    fn at_exchanges(self, samples: &Samples, steps: &Steps, wavenumber: f64, aside_m: Vec<f64>) -> RangeChange {
        let (error_m, sd_m) = (steps.between(&self.walk.mean_m), steps.between(&self.walk.sd_m));
        let range_m: Vec<f64> = self.range_m.iter().zip(&error_m).map(|(range, error)| range + error).collect();
        let first = |values: &[f64]| values.first().copied().unwrap_or_default();
        let (first_m, first_sd_m, first_aside_m) = (first(&range_m), first(&sd_m), first(&aside_m));
        // A quarter of a cycle.
        let known_m = FRAC_PI_2 / wavenumber;
        let mut deviation_m: Vec<f64> = sd_m
            .iter()
            .zip(&aside_m)
            .map(|(sd_m, aside_m)| sd_m.hypot(first_sd_m).hypot(aside_m - first_aside_m))
            .collect();
        deviation_m.iter_mut().take(1).for_each(|own| *own = 0.0);
        RangeChange {
            t_s: samples.t_s().to_vec(),
            range_change_m: range_m.iter().map(|range_m| range_m - first_m).collect(),
            deviation_m,
            held: sd_m.iter().map(|sd_m| *sd_m < known_m).collect(),
            slips: self.slips(steps, wavenumber),
            coherence: self.coherence,
        }
    }

    /// The first exchange of each step at which the phase, unwrapped from step to step, leaves the walk by a turn.
    fn slips(&self, steps: &Steps, wavenumber: f64) -> Vec<usize> {
        let (mut unwrapped, mut before, mut turns, mut slips) = (0.0, None::<Complex64>, None, Vec::new());
        for (step, (phasor, mean_m)) in self.phasors.iter().zip(&self.walk.mean_m).enumerate() {
            unwrapped += before.map_or(phasor.arg(), |before| (phasor * before.conj()).arg());
            before = Some(*phasor);
            let own = ((unwrapped + wavenumber * mean_m) / TAU).round();
            if turns.is_some_and(|turns| turns != own) {
                slips.extend(steps.bins.of.iter().position(|of| *of == step));
            }
            turns = Some(own);
        }
        slips
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::channel::INDICES_20_MHZ;

    const WAVELENGTH_M: f64 = 0.054_114_162;
    const WAVENUMBER: f64 = 2.0 * TAU / WAVELENGTH_M;

    /// A robot on an arc of a metre about the origin, a transmitter 4 m away, and another path's source.
    struct Drive {
        samples: Samples,
        rows: Vec<Planes>,
        truth_m: Vec<f64>,
        place: Place,
        middle_m: Vector3<f64>,
    }

    fn random(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        }
    }

    /// `count` exchanges, whose paths have the amplitudes `paths(k)`: the direct one and one from the side; `noise` is the deviation
    /// of each subcarrier's real and imaginary part. The trajectory is `scale` times the true path.
    fn drive(count: usize, paths: impl Fn(usize) -> [f64; 2], noise: f64, scale: f64, seed: u64) -> Drive {
        let mut random = random(seed);
        let mut normal = move || (-2.0 * random().max(1e-12).ln()).sqrt() * (TAU * random()).cos();
        let sources = [Vector3::new(4.0, 0.5, 0.0), Vector3::new(-1.0, 5.0, 0.0)];
        let point = |k: usize| {
            let (sin, cos) = (2.5 * k as f64 / count.max(2) as f64).sin_cos();
            Vector3::new(0.4 * sin, 0.4 * cos - 0.4, 0.0)
        };
        let mut samples = Samples::new(WAVELENGTH_M, 2).unwrap();
        let mut rows = Vec::new();
        for k in 0..count {
            let ranges = sources.map(|source| (source - point(k)).norm());
            let mut row = Planes::ZERO;
            for (lane, index) in INDICES_20_MHZ.into_iter().enumerate() {
                // The second path is 20 m longer, so that subcarriers fade apart.
                let waves = paths(k).into_iter().zip(ranges).zip([0.0, 0.131]);
                let wave = |((amplitude, range_m), slope): ((f64, f64), f64)| {
                    Complex64::from_polar(amplitude, -WAVENUMBER * range_m - slope * f64::from(index))
                };
                let sum: Complex64 = waves.map(wave).sum();
                row.re[lane] = (sum.re + noise * normal()) as f32;
                row.im[lane] = (sum.im + noise * normal()) as f32;
            }
            rows.push(row);
            samples.push(0.01 * k as f64, Complex64::ONE, scale * point(k), Vector3::zeros()).unwrap();
        }
        let middle_m = scale * (0..count).map(point).sum::<Vector3<f64>>() / count.max(1) as f64;
        let way = sources[0] - middle_m;
        let place = Place { azimuth: way.y.atan2(way.x), elevation: 0.0, curve: 1.0 / way.norm() };
        let truth_m = (0..count).map(|k| (sources[0] - point(k)).norm() - (sources[0] - point(0)).norm()).collect();
        Drive { samples, rows, truth_m, place, middle_m }
    }

    impl Drive {
        fn range_change(&self) -> Result<RangeChange, NoRangeChange> {
            let (rows, place) = (self.rows.clone(), (&self.place, 0.0));
            range_change(&self.samples, rows, &INDICES_20_MHZ, place, self.middle_m, Tier::detect())
        }

        fn worst_m(&self, found: &RangeChange) -> f64 {
            let each = found.range_change_m.iter().zip(&self.truth_m);
            each.map(|(own, truth)| (own - truth).abs()).fold(0.0, f64::max)
        }
    }

    /// Noise of 20 dB below a path of amplitude 1, in each part.
    const NOISE: f64 = 0.070_7;

    #[test]
    fn free_space_is_right_to_less_than_a_millimetre() {
        for seed in 1..=5 {
            let drive = drive(400, |_| [1.0, 0.0], NOISE, 1.0, seed);
            let found = drive.range_change().unwrap();
            assert!(drive.worst_m(&found) < 0.000_5, "{}", drive.worst_m(&found));
            assert_eq!((found.slips.len(), found.held_share(), found.deviation_m[0]), (0, 1.0, 0.0));
            assert!(found.deviation_m.iter().all(|sd_m| *sd_m < 0.001), "{:?}", found.deviation_m);
            assert!(found.coherence > 0.9, "{}", found.coherence);
        }
    }

    #[test]
    fn a_path_with_a_wrong_scale_is_corrected() {
        let drive = drive(400, |_| [1.0, 0.0], NOISE, 1.05, 3);
        let predicted = Prediction::of(
            &drive.place,
            &drive.samples.displacements_m().map(|p| p - drive.middle_m).collect::<Vec<_>>(),
        );
        let off = |k: usize| predicted.range_m[k] - predicted.range_m[0] - drive.truth_m[k];
        assert!((0..400).map(|k| off(k).abs()).fold(0.0, f64::max) > 0.01);
        let found = drive.range_change().unwrap();
        assert!(drive.worst_m(&found) < 0.001, "{}", drive.worst_m(&found));
    }

    #[test]
    fn a_slip_in_a_fade_is_found_and_bridged() {
        // Over 6 cm of the way the direct path is gone and one from the side leads: the phase goes another way there.
        let fade = |k: usize| if (170..195).contains(&k) { [0.02, 0.6] } else { [1.0, 0.2] };
        let drive = drive(400, fade, NOISE, 1.0, 2);
        let found = drive.range_change().unwrap();
        assert!(
            !found.slips.is_empty() && found.slips.iter().all(|slip| (160..205).contains(slip)),
            "{:?}",
            found.slips
        );
        let end_m = found.range_change_m[399] - drive.truth_m[399];
        assert!(end_m.abs() < 0.002, "{end_m}");
        assert!(found.deviation_m[182] > 1.1 * found.deviation_m[100], "{:?}", &found.deviation_m[160..205]);
    }

    #[test]
    fn noise_has_no_range_change() {
        for seed in 1..=20 {
            let drive = drive(400, |_| [0.0, 0.0], 1.0, 1.0, seed);
            assert!(matches!(drive.range_change(), Err(NoRangeChange::Incoherent { .. })), "{seed}");
        }
    }

    #[test]
    fn too_little_is_refused_with_why() {
        for count in [0, 1, 2] {
            let drive = drive(count, |_| [1.0, 0.0], NOISE, 1.0, 1);
            assert!(matches!(drive.range_change(), Err(NoRangeChange::Short { .. })), "{count}");
        }
        let mut drive = drive(100, |_| [1.0, 0.0], NOISE, 1.0, 1);
        let with = |direction_sd_rad| {
            let place = (&drive.place, direction_sd_rad);
            range_change(&drive.samples, drive.rows.clone(), &INDICES_20_MHZ, place, drive.middle_m, Tier::detect())
        };
        for direction_sd_rad in [0.2, f64::NAN] {
            let why = with(direction_sd_rad).unwrap_err();
            assert!(matches!(why, NoRangeChange::Doubtful { .. }) && why.to_string().contains("drive"), "{why}");
        }
        // A direction that may be off adds what that moves the distance.
        let (sure, doubtful) = (with(0.0).unwrap(), with(0.02).unwrap());
        assert_eq!(sure.range_change_m, doubtful.range_change_m);
        assert!(doubtful.deviation_m[99] > 0.005 && sure.deviation_m[99] < 0.002, "{doubtful:?}");
        drive.rows.iter_mut().for_each(|row| *row = Planes { re: [f32::NAN; LANES], im: [f32::INFINITY; LANES] });
        assert!(matches!(drive.range_change(), Err(NoRangeChange::Incoherent { .. })));
        // Rows that are missing are no rows.
        drive.rows.clear();
        assert!(matches!(drive.range_change(), Err(NoRangeChange::Incoherent { .. })));
    }

    /// The same posterior by whole matrices: every transition from each cell to each, and all products of a step written out.
    fn slow(grid: &Grid, phasors: &[Complex64], ways_m: &[f64], walk: f64) -> Walk {
        let count = 2 * Grid::SIDE + 1;
        let likelihood = |phasor: Complex64, cell: usize| {
            let weight = grid.kappa * phasor.norm();
            let angle = phasor.arg() + grid.wavenumber * grid.offset_m(cell);
            // Over the density of random phases, which has the same factor 1 / (2 pi).
            (weight * angle.cos()).exp() / ln_bessel_i0(weight).exp()
        };
        let transition = |way_m: f64| {
            let spread = grid.spread(walk * way_m.sqrt());
            nalgebra::DMatrix::from_fn(count, count, |i, j| spread.get(i.abs_diff(j)).copied().unwrap_or(0.0))
        };
        let at = |phasor: &Complex64| nalgebra::DVector::from_fn(count, |cell, _| likelihood(*phasor, cell));
        let start = nalgebra::DVector::from_fn(count, |cell, _| {
            f64::from(u8::from(cell.abs_diff(Grid::SIDE) <= CELLS / 2)) / (CELLS as f64 + 1.0)
        });
        let mut forward = vec![start.component_mul(&at(&phasors[0]))];
        for (k, way_m) in ways_m.iter().enumerate() {
            let next = (transition(*way_m) * &forward[k]).component_mul(&at(&phasors[k + 1]));
            forward.push(next);
        }
        let mut backward = vec![nalgebra::DVector::from_element(count, 1.0)];
        for (k, way_m) in ways_m.iter().enumerate().rev() {
            let next = transition(*way_m) * backward[0].component_mul(&at(&phasors[k + 1]));
            backward.insert(0, next);
        }
        let evidence = forward.last().unwrap().sum();
        let mean = |k: usize, of: &dyn Fn(f64) -> f64| {
            let shares = forward[k].component_mul(&backward[k]) / evidence;
            (0..count).map(|cell| shares[cell] * of(grid.offset_m(cell))).sum::<f64>()
        };
        let mean_m: Vec<f64> = (0..phasors.len()).map(|k| mean(k, &|x| x)).collect();
        let sd_m = (0..phasors.len()).map(|k| mean(k, &|x| (x - mean_m[k]).powi(2)).sqrt()).collect();
        Walk { sd_m, mean_m, log_evidence: evidence.ln() }
    }

    #[test]
    fn the_walk_agrees_with_whole_matrices() {
        let mut random = random(9);
        let phasors: Vec<Complex64> =
            (0..12).map(|k| Complex64::from_polar(random(), 0.4 * f64::from(k) + 2.0 * (random() - 0.5))).collect();
        let ways_m: Vec<f64> = (0..11).map(|_| 0.02 * random()).collect();
        for (kappa, walk) in [(0.5, 0.05), (3.0, 0.012), (20.0, 0.003)] {
            let grid = Grid { wavenumber: WAVENUMBER, kappa };
            let (fast, slow) = (grid.walk(&phasors, &ways_m, walk), slow(&grid, &phasors, &ways_m, walk));
            assert!(
                (fast.log_evidence - slow.log_evidence).abs() < 1e-6,
                "{} {}",
                fast.log_evidence,
                slow.log_evidence
            );
            for k in 0..12 {
                assert!((fast.mean_m[k] - slow.mean_m[k]).abs() < 1e-9 && (fast.sd_m[k] - slow.sd_m[k]).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn bessel_and_concentration_agree_with_tables() {
        // Abramowitz and Stegun, table 9.8 (e^-x I_0 at 5 and 10, I_0 at 1), and I_1 / I_0 of what the concentration gives.
        assert!((ln_bessel_i0(1.0) - 1.266_065_878_f64.ln()).abs() < 1e-6);
        assert!((ln_bessel_i0(5.0) - (5.0 + 0.183_540_812_6_f64.ln())).abs() < 1e-6);
        assert!((ln_bessel_i0(10.0) - (10.0 + 0.127_833_337_2_f64.ln())).abs() < 1e-6);
        for coherence in [0.1, 0.3, 0.5, 0.7, 0.9, 0.98] {
            let kappa = concentration(coherence);
            let slope = (ln_bessel_i0(kappa + 1e-3) - ln_bessel_i0(kappa - 1e-3)) / 2e-3;
            assert!((slope - coherence).abs() < 0.02, "{coherence} {slope}");
        }
    }

    #[test]
    fn a_far_place_is_a_plane_wave() {
        let points = [Vector3::new(0.3, -0.2, 0.1), Vector3::new(-0.1, 0.4, 0.0)];
        let at = |curve| Prediction::of(&Place { azimuth: 0.7, elevation: 0.2, curve }, &points);
        let (plane, near) = (at(0.0), at(0.25));
        let source = 4.0 * crate::bartlett::direction(0.7, 0.2);
        for (k, point) in points.iter().enumerate() {
            assert!((plane.range_m[k] + crate::bartlett::direction(0.7, 0.2).dot(point)).abs() < 1e-12);
            assert!((near.range_m[k] - ((source - point).norm() - 4.0)).abs() < 1e-12);
            let turned = Prediction::of(&Place { azimuth: 0.7 + 1e-6, elevation: 0.2, curve: 0.25 }, &points);
            assert!(((turned.range_m[k] - near.range_m[k]) / 1e-6 - near.turn_m[k]).abs() < 1e-5);
        }
    }
}
