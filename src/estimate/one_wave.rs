//! One spherical wave by least squares, where it leaves nothing but noise.
//!
//! Then every sample is independent, and the most likely place is efficient: no window, other subcarrier or other path can
//! add to it more than the noise hides. Whether the residual phases are noise is tested with a false alarm in
//! [`FALSE_ALARM`] each: by their cumulative periodogram along the motion (a bent trajectory, anything that continues from sample
//! to sample), by their highest Bartlett peak (another path), and by pairs where the robot rests (a wrong clock). A path of amplitude `b` leaves phases `b sin(psi)`, half of
//! which are a wave of its direction: one that stays below a peak of `p` times what noise has on average moves the azimuth by
//! at most `sqrt(2 p)` times the deviation that the noise leaves.

use super::likelihood::{Place, Ways};
use super::posterior::{Atom, Mode, Steps, settle};
use super::prior::{Cell, Prior};
use super::start;
use crate::bartlett::{Estimate, Searcher, Tier};
use crate::maths::wrap_rad;
use crate::signal::samples::Samples;
use csi5300_kernels::fft::Ffts;
use nalgebra::{Matrix3, Matrix4, SMatrix, SVector, Vector3, Vector4};
use num_complex::Complex64;
use std::f64::consts::{FRAC_PI_2, TAU};
use std::fmt;
use std::ops::{AddAssign, Div, SubAssign};

/// Probability of a false alarm of a test: then the posterior over windows is computed needlessly.
pub(crate) const FALSE_ALARM: f64 = 0.001;
/// The same in deviations of a normal density.
const FALSE_ALARM_SD: f64 = 3.09;
/// Fewer samples tell no noise from anything else.
const LEAST_SAMPLES: usize = 32;
/// Phases of a wave with less of the power wrap too often for least squares.
const LEAST_SHARE: f64 = 0.25;
/// Steps of least squares at most.
const STEPS: usize = 12;
/// Azimuths of the posterior on either side of the most likely one, and how far the first of them goes in deviations.
const SIDE: usize = 12;
const REACH: f64 = 4.0;
/// Steps between these azimuths at most, radians: then they are the whole circle.
const WIDEST: f64 = TAU / (2 * SIDE + 1) as f64;
/// Steps over the elevations that a motion does not distinguish.
const ELEVATIONS: usize = 12;
/// `ln` of how many times less likely another direction has to be.
const DECISIVE: f64 = 12.0;
/// A range that is this far less likely, in logarithms, is out of the question.
const DOUBT: f64 = 3.0;

/// Why one wave is not the whole answer.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Unexplained {
    /// Too few samples to tell noise from anything else.
    FewSamples(usize),
    /// The best single wave explains only this share of the power.
    Faint(f64),
    /// Least squares lead to no place within the limits of the prior.
    NoPlace,
    /// What is left goes on along the motion: its cumulative periodogram is this many times as far from that of noise as
    /// noise may be.
    NotWhite(f64),
    /// Pairs beside the motion, where the robot rests by the trajectory, do not fit: the ratio of their mean square residual to that of
    /// the samples, over the limit that noise stays below.
    AtRest(f64),
    /// What is left is another wave: its highest peak over what noise alone would make of it.
    AnotherWave(f64),
    /// Another direction explains the samples about as well.
    Ambiguous,
}

impl fmt::Display for Unexplained {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::FewSamples(samples) => {
                write!(f, "{samples} samples are too few to tell noise from anything else")
            }
            Self::Faint(share) => write!(f, "one wave explains only {:.0} % of the power", 100.0 * share),
            Self::NoPlace => f.write_str("no place within the limits explains the samples"),
            Self::NotWhite(times) => {
                write!(f, "the residual phases are not noise: {times:.1} times the limit of the whiteness test")
            }
            Self::AtRest(times) => {
                write!(f, "pairs where the robot should rest do not fit: {times:.1} times the limit of noise")
            }
            Self::AnotherWave(times) => {
                write!(f, "another wave is there, {times:.1} times as strong as noise may seem")
            }
            Self::Ambiguous => f.write_str("another direction explains the samples about as well"),
        }
    }
}

/// One wave that leaves nothing but noise.
#[derive(Clone, Debug)]
pub(crate) struct OneWave {
    /// Its posterior, and that of its mirror image where the motion hides one.
    pub modes: Vec<Mode>,
    /// Deviation that noise leaves of its azimuth, radians: the Cramer-Rao bound for the measured noise.
    pub bound_rad: f64,
    /// How far a wave that the noise hides may have moved the azimuth, radians.
    pub risk_rad: f64,
    /// `ln` of its likelihood, the noise's variance at its most likely value.
    pub log_likelihood: f64,
}

/// Which coordinates are open: elevation, 1 / range, scale of the path. The azimuth always is.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Open([bool; 3]);

/// A place and the scale of the path.
#[derive(Clone, Copy, Debug, PartialEq)]
struct At {
    place: Place,
    scale: f64,
}

/// A place with the residual of each phase, radians.
#[derive(Clone, Debug)]
struct Fit {
    at: At,
    left: Vec<f64>,
}

/// The samples of a motion, for one wave.
struct Wave<'a> {
    samples: &'a Samples,
    ways: Ways<'a>,
    /// Radians for each metre of way.
    kappa: f64,
    prior: &'a Prior,
    open: Open,
    /// Standard deviation of the path's scale.
    scale_sd: f64,
    /// Whether residual phases are unwrapped along the motion.
    unwraps: bool,
}

/// A wave that leaves nothing but noise, as it was found.
pub(crate) struct Alone<'a> {
    wave: Wave<'a>,
    fit: Fit,
    /// The highest Bartlett peak of what it leaves, in units of the mean noise.
    peak: f64,
}

/// The samples to look at.
#[derive(Clone, Copy)]
pub(crate) struct Heard<'a> {
    pub samples: &'a Samples,
    pub ways: Ways<'a>,
    /// Probability of a false alarm of each test.
    pub false_alarm: f64,
    /// Standard deviation of the path's scale.
    pub scale_sd: f64,
    /// Pairs where the robot rests, if they are to be explained, too.
    pub at_rest: Option<&'a AtRest<'a>>,
}

/// Pairs of one rest: round trips with displacements about the middle, metres.
pub(crate) type Rest = Vec<(Complex64, Vector3<f64>)>;
/// Gives the rests.
pub(crate) type AtRest<'a> = dyn Fn() -> Vec<Rest> + 'a;

/// Looks for one wave next to `start`, or next to `plane_wave` if there is none.
///
/// # Errors
/// What else there is.
pub(crate) fn explain(
    heard: Heard<'_>,
    start: (&Estimate, Option<Place>),
    prior: &Prior,
    steps: &Steps,
    tier: Tier,
) -> Result<OneWave, Unexplained> {
    let Alone { mut wave, fit, peak } = alone(heard, start, prior, steps, tier)?;
    if let Some(at_rest) = heard.at_rest {
        wave.explains_rests(&at_rest(), &fit)?;
    }
    let Fit { at, left } = fit;
    let free = left.len() as f64 - 5.0;
    let variance = (left.iter().map(|e| e * e).sum::<f64>() / free).max(1e-16);
    let bound_rad = wave.covariance(&at, variance, false)[(0, 0)].max(0.0).sqrt();
    // The trajectory is taken as it is for the place, which is efficient where it is exact; what its scale leaves open is in the
    // posterior.
    wave.open.0[2] = true;
    let covariance = wave.covariance(&at, variance, true);
    let hides_elevation = prior.elevation_is_open() && !wave.open.0[0];
    // Straight above, no azimuth shows.
    let above = At { place: Place { elevation: FRAC_PI_2, ..at.place }, ..at };
    let is_above = hides_elevation
        && prior.contains(&above.place)
        && wave.cost(&above, variance) < wave.cost(&at, variance) + 2.0 * DOUBT;
    let at = if is_above { above } else { at };
    let mode = wave.mode(&at, covariance, variance);
    let modes = vec![if hides_elevation { wave.over_elevations(mode, at, variance) } else { mode }];
    let log_likelihood = -0.5 * left.len() as f64 * variance.ln();
    Ok(OneWave { modes, bound_rad, risk_rad: (2.0 * peak).sqrt() * bound_rad, log_likelihood })
}

/// The wave that [`explain`] finds, without its posterior.
///
/// # Errors
/// What else there is.
pub(crate) fn alone<'a>(
    Heard { samples, ways, false_alarm, scale_sd, at_rest: _ }: Heard<'a>,
    (plane_wave, from): (&Estimate, Option<Place>),
    prior: &'a Prior,
    steps: &Steps,
    tier: Tier,
) -> Result<Alone<'a>, Unexplained> {
    if samples.len() < LEAST_SAMPLES {
        return Err(Unexplained::FewSamples(samples.len()));
    }
    let kappa = samples.kappa();
    let shows_elevation = plane_wave.elevation_searched || prior.is_signed();
    let open = Open([prior.elevation_is_open() && shows_elevation, prior.curve_max > 0.0, false]);
    let wave = Wave { samples, ways, kappa, prior, open, scale_sd, unwraps: false };
    let start_prior = if shows_elevation { *prior } else { prior.level() };
    let place = from
        .map(|place| prior.at_height(place))
        .unwrap_or_else(|| start::beside(samples, ways.points, plane_wave, &start_prior, steps, tier));
    let share = ways.explained(samples, &place);
    if share < LEAST_SHARE {
        return Err(Unexplained::Faint(share));
    }
    let fit = wave.settled(At { place, scale: 0.0 }).ok_or(Unexplained::NoPlace)?;
    whiteness(&fit.left, false_alarm, tier)?;
    unambiguous(&wave, &fit.at, plane_wave, steps)?;
    let peak = highest_peak(&wave, &fit, plane_wave, false_alarm, tier)?;
    Ok(Alone { wave, fit, peak })
}

/// The place next to `from` whose phases differ least from those of the samples, unwrapped along the motion: it may be whole turns
/// away from `from`.
pub(crate) fn unwrapped(
    samples: &Samples,
    points: &[Vector3<f64>],
    from: Place,
    prior: &Prior,
    scale_sd: f64,
) -> Place {
    let open = Open([prior.elevation_is_open(), prior.curve_max > 0.0, false]);
    let ways = Ways::to(points);
    let wave = Wave { samples, ways, kappa: samples.kappa(), prior, open, scale_sd, unwraps: true };
    wave.settled(At { place: from, scale: 0.0 }).map_or(from, |fit| fit.at.place)
}

/// Azimuth, elevation (or its cosine), 1 / range and scale: what a phase goes by.
type Gradient = Vector4<f64>;

impl Wave<'_> {
    /// The phase of each sample's way, radians, less that of the middle.
    fn phases(&self, at: &At) -> impl Iterator<Item = f64> + '_ {
        let kappa = self.kappa * (1.0 + at.scale);
        self.ways.each(at.place.ways_m()).map(move |way_m| kappa * way_m)
    }

    /// How the phases go by each coordinate; 0 for those that are not open. Of level motion by the elevation's cosine.
    fn gradients(&self, at: &At) -> Vec<Gradient> {
        let ((sin_a, cos_a), (sin_e, cos_e)) = (at.place.azimuth.sin_cos(), at.place.elevation.sin_cos());
        let (towards, curve) = (at.place.towards(), at.place.curve);
        let by_azimuth = Vector3::new(-sin_a * cos_e, cos_a * cos_e, 0.0);
        let by_elevation = match self.prior.is_signed() {
            true => Vector3::new(-cos_a * sin_e, -sin_a * sin_e, cos_e),
            false => Vector3::new(cos_a, sin_a, 0.0),
        };
        let open = |k: usize| f64::from(u8::from(self.open.0[k]));
        let gradient = |p: &Vector3<f64>| {
            let square = p.norm_squared();
            let bend = curve * square - 2.0 * towards.dot(p);
            let ratio = (1.0 + curve * bend).max(0.0).sqrt().max(1e-9);
            // The way is (ratio - 1) / curve, so it changes by half of the bend's change over the ratio.
            let by_curve = (square - bend * (bend + curve * square) / (2.0 * ratio * (ratio + 1.0))) / (ratio + 1.0);
            Gradient::new(
                -by_azimuth.dot(p) / ratio,
                -by_elevation.dot(p) / ratio * open(0),
                by_curve * open(1),
                bend / (ratio + 1.0) * open(2),
            ) * self.kappa
        };
        self.ways.each(gradient).collect()
    }

    /// What the wave leaves of each phase, radians, against their mean phasor.
    fn residual(&self, at: &At) -> Vec<f64> {
        let turned: Vec<Complex64> =
            self.samples.z().iter().zip(self.phases(at)).map(|(z, phase)| z * Complex64::cis(phase)).collect();
        let mut left = Vec::with_capacity(turned.len());
        for part in self.ways.parts() {
            let mean: Complex64 = turned[part.clone()].iter().sum();
            left.extend(turned[part].iter().map(|z| (z * mean.conj()).arg()));
        }
        if self.unwraps {
            for k in 1..left.len() {
                left[k] = left[k - 1] + wrap_rad(left[k] - left[k - 1]);
            }
        }
        self.about_means(&mut left);
        left
    }

    /// Whether the wave leaves no more than noise where the robot rests, either: by a wrong clock it moves there. The constant of each
    /// rest is open.
    fn explains_rests(&self, rests: &[Rest], Fit { at, left }: &Fit) -> Result<(), Unexplained> {
        let way_m = at.place.ways_m();
        let flat = |p: &Vector3<f64>| if self.prior.is_signed() { *p } else { Vector3::new(p.x, p.y, 0.0) };
        let turned = |(z, p): &(Complex64, Vector3<f64>)| z * Complex64::cis(self.kappa * way_m(&flat(p)));
        let square = |rest: &Rest| {
            let turned: Vec<Complex64> = rest.iter().map(turned).collect();
            let mean: Complex64 = turned.iter().map(|z| z / z.norm()).sum();
            turned.iter().map(|z| (z * mean.conj()).arg().powi(2)).sum::<f64>()
        };
        let free = rests.iter().map(|rest| rest.len() - 1).sum::<usize>().max(1) as f64;
        let own = (left.iter().map(|e| e * e).sum::<f64>() / left.len() as f64).max(1e-16);
        let ratio = rests.iter().map(square).sum::<f64>() / free / own;
        // The ratio of two mean squares of noise (Wilson and Hilferty 1931).
        let spread = 2.0 / 9.0 * (1.0 / free + 1.0 / left.len() as f64);
        let limit = (1.0 - spread + FALSE_ALARM_SD * spread.sqrt()).powi(3);
        if ratio > limit { Err(Unexplained::AtRest(ratio / limit)) } else { Ok(()) }
    }

    /// Takes the mean of each part out of it.
    fn about_means<T: Copy + Default + AddAssign + SubAssign + Div<f64, Output = T>>(&self, values: &mut [T]) {
        for part in self.ways.parts() {
            let (own, mut mean) = (&mut values[part], T::default());
            own.iter().for_each(|value| mean += *value);
            let mean = mean / own.len().max(1) as f64;
            own.iter_mut().for_each(|value| *value -= mean);
        }
    }

    fn cost(&self, at: &At, variance: f64) -> f64 {
        self.cost_of(at, &self.residual(at), variance)
    }

    /// What the residual phases and the prior of the scale cost, in deviations squared.
    fn cost_of(&self, at: &At, left: &[f64], variance: f64) -> f64 {
        let square: f64 = left.iter().map(|e| e * e).sum();
        square / variance + (at.scale / self.scale_sd).powi(2)
    }

    /// Least squares of the residual phases from `at`, within the limits: a coordinate that would leave them stays there.
    fn settled(&self, at: At) -> Option<Fit> {
        let mut fit = self.fit(at);
        let mut held = [false; 3];
        for _ in 0..STEPS {
            let (next, hits) = self.step(&fit, &held, true)?;
            let moved = wrap_rad(next.at.place.azimuth - fit.at.place.azimuth).abs();
            (fit, held) = (next, hits);
            if moved < 1e-7 {
                break;
            }
        }
        let place = &fit.at.place;
        let is_finite = place.azimuth.is_finite() && place.elevation.is_finite() && place.curve.is_finite();
        (is_finite && self.prior.contains(place)).then_some(fit)
    }

    fn fit(&self, at: At) -> Fit {
        Fit { at, left: self.residual(&at) }
    }

    /// One step of Gauss and Newton. `held` coordinates stay; those that leave their limits are held next time.
    fn step(&self, from: &Fit, held: &[bool; 3], azimuth_is_open: bool) -> Option<(Fit, [bool; 3])> {
        let Fit { at, left } = from;
        let variance = (left.iter().map(|e| e * e).sum::<f64>() / left.len() as f64).max(1e-16);
        let mut gradients = self.gradients(at);
        self.about_means(&mut gradients);
        let mut information = information(&gradients, variance);
        // A phase that was turned back too little is made up for by a longer way.
        let mut slope: Vector4<f64> = gradients.iter().zip(left).map(|(g, e)| -g * *e / variance).sum();
        information[(3, 3)] += self.scale_sd.powi(-2);
        slope[3] -= at.scale * self.scale_sd.powi(-2);
        let fixed =
            [!azimuth_is_open, held[0] || !self.open.0[0], held[1] || !self.open.0[1], held[2] || !self.open.0[2]];
        for k in (0..4).filter(|k| fixed[*k]) {
            information.row_mut(k).fill(0.0);
            information.column_mut(k).fill(0.0);
            information[(k, k)] = 1.0;
            slope[k] = 0.0;
        }
        // Less far, and more along the steepest descent, where all of the step would leave more (Levenberg and Marquardt).
        let now = self.cost_of(at, left, variance);
        for damping in [1e-12, 1e-6, 1e-4, 1e-2, 0.3, 10.0] {
            let (next, hits) = self.moved(at, &solve(information, slope, damping)?, held);
            let next = self.fit(next);
            if self.cost_of(&next.at, &next.left, variance) <= now {
                return Some((next, hits));
            }
        }
        Some((from.clone(), *held))
    }

    /// `at` after a step, clamped to the limits, and which coordinates are at them.
    fn moved(&self, at: &At, step: &Vector4<f64>, held: &[bool; 3]) -> (At, [bool; 3]) {
        let [low, high] = self.prior.elevation_rad;
        let (elevation, at_elevation) = match self.prior.is_signed() {
            true => {
                let next = at.place.elevation + step[1];
                (next.clamp(low, high), next < low || next > high)
            }
            false => {
                let next = at.place.elevation.cos() + step[1];
                let (least, most) = (high.cos(), low.cos());
                (next.clamp(least, most).min(1.0).acos(), next < least || next > most)
            }
        };
        let curve = at.place.curve + step[2];
        let next = Place {
            azimuth: at.place.azimuth + step[0],
            elevation: if self.open.0[0] { elevation } else { at.place.elevation },
            curve: curve.clamp(0.0, self.prior.curve_max),
        };
        let at_curve = curve < 0.0 || curve > self.prior.curve_max;
        let next = if self.prior.elevation_is_open() { next } else { self.prior.at_height(next) };
        let hits = [held[0] || at_elevation && self.open.0[0], held[1] || at_curve, held[2]];
        (At { place: next, scale: at.scale + step[3] }, hits)
    }

    /// Fisher information of the open coordinates from phases of this variance, without any prior.
    fn information(&self, at: &At, variance: f64) -> Matrix4<f64> {
        let mut gradients = self.gradients(at);
        self.about_means(&mut gradients);
        information(&gradients, variance)
    }

    /// Covariance of azimuth, elevation and 1 / range, with the scale of the path known to the sensor's error or exactly.
    /// Coordinates that are open have the prior's deviation beside what the phases say.
    fn covariance(&self, at: &At, variance: f64, with_scale: bool) -> Matrix3<f64> {
        let mut information = self.information(at, variance);
        let [elevation_sd, _] = self.prior.deviations();
        // Of the cosine, to first order about its mean and at least to second.
        let bent = if self.prior.is_signed() { elevation_sd } else { 1.0 - (2.0 * elevation_sd).min(FRAC_PI_2).cos() };
        let priors = [1.8, bent.max(1e-6), (self.prior.curve_max / 12f64.sqrt()).max(1e-9), self.scale_sd];
        for k in 0..4 {
            let is_open = k == 0 || self.open.0[k - 1] && (k != 3 || with_scale);
            information[(k, k)] += if is_open { priors[k].powi(-2) } else { 1e24 };
        }
        let whole = invert(information).unwrap_or_else(|| Matrix4::from_diagonal(&priors.map(|sd| sd * sd).into()));
        let mut covariance = whole.fixed_view::<3, 3>(0, 0).into_owned();
        if !self.prior.is_signed() {
            // From the cosine to the elevation: an error `d` of a cosine near 1 is an elevation of `sqrt(2 d)`.
            let sd = covariance[(1, 1)].max(0.0).sqrt();
            let sin = at.place.elevation.sin();
            let slope = 1.0 / (sin * sin + 2.0 * sd).sqrt().max(1e-9);
            let scale = Matrix3::from_diagonal(&Vector3::new(1.0, -slope, 1.0));
            covariance = scale * covariance * scale;
        }
        covariance
    }

    /// The posterior about `at`: for each azimuth the likelihood and the prior of the best place that has it.
    fn mode(&self, at: &At, covariance: Matrix3<f64>, variance: f64) -> Mode {
        let mut step = (covariance[(0, 0)].max(0.0).sqrt() * REACH / SIDE as f64).clamp(1e-9, 0.05);
        let (mut atoms, mut too_wide) = (Vec::new(), false);
        for _ in 0..12 {
            let mut logs = vec![(0.0, self.log(&self.best_with(*at, [false, true, true]), variance))];
            for side in [-1.0, 1.0] {
                let mut near = *at;
                for k in 1..=SIDE {
                    let off = side * k as f64 * step;
                    near = self.best_with(self.beside(&near, (0, side * step), variance), [false, true, true]);
                    logs.push((off, self.log(&near, variance)));
                }
            }
            let most = logs.iter().map(|(_, log)| *log).fold(f64::MIN, f64::max);
            logs.iter_mut().for_each(|(_, log)| *log -= most);
            let atom = |(off, log): &(f64, f64)| Atom {
                azimuth: wrap_rad(at.place.azimuth + off),
                width: step,
                mass: log.exp(),
            };
            atoms = logs.iter().map(atom).collect();
            let edge = logs[SIDE].1.max(logs[2 * SIDE].1);
            let inside = logs[SIDE / 4].1.min(logs[SIDE + SIDE / 4].1);
            // Towards the line of a straight motion the azimuth shows to second order only: wider. Too wide: closer.
            if edge > -4.0 && step < WIDEST && !too_wide {
                step = (2.0 * step).min(WIDEST);
            } else if inside < -6.0 && step > 2e-9 {
                too_wide = true;
                step *= 0.3;
            } else {
                break;
            }
        }
        let total: f64 = atoms.iter().map(|atom| atom.mass).sum();
        atoms.iter_mut().for_each(|atom| atom.mass /= total);
        let spread: f64 = atoms.iter().map(|a| a.mass * wrap_rad(a.azimuth - at.place.azimuth).powi(2)).sum();
        let mut covariance = covariance;
        let (own, seen) = (covariance[(0, 0)].max(1e-24).sqrt(), spread.max(0.0).sqrt());
        let scale = Matrix3::from_diagonal(&Vector3::new(seen / own, 1.0, 1.0));
        covariance = scale * covariance * scale;
        if !self.shows_range(at, variance) {
            covariance[(2, 2)] = covariance[(2, 2)].max(self.prior.curve_max.powi(2));
        }
        Mode { place: Place { azimuth: wrap_rad(at.place.azimuth), ..at.place }, covariance, mass: 1.0, atoms }
    }

    /// A mode of motion that shows no elevation (along a line, say), over the elevations of the prior: each has its own azimuth and range.
    fn over_elevations(&self, mode: Mode, at: At, variance: f64) -> Mode {
        let cells = elevations(self.prior);
        let own = cells.iter().rposition(|cell| cell.low <= at.place.elevation).unwrap_or(0);
        let wave = Self { open: Open([true, self.open.0[1], self.open.0[2]]), ..*self };
        let mut mixed = Vec::new();
        let mut take = |near: &At, cell: &Cell, before: &At| {
            let by = wrap_rad(near.place.azimuth - at.place.azimuth);
            let width = wrap_rad(near.place.azimuth - before.place.azimuth).abs();
            let atom =
                |atom: &Atom| Atom { azimuth: wrap_rad(atom.azimuth + by), width: atom.width.max(width), ..*atom };
            let mut mode = Mode { place: near.place, atoms: mode.atoms.iter().map(atom).collect(), ..mode.clone() };
            mode.covariance[(1, 1)] += (cell.high - cell.low).powi(2) / 12.0;
            // Errors of the path count the less, the steeper the place: that one explains more is no evidence for it.
            let less = (0.5 * (self.cost(&at, variance) - self.cost(near, variance))).min(0.0);
            mode.scale(cell.mass * less.exp());
            mixed.push(mode);
        };
        take(&at, &cells[own], &at);
        let (below, above) = (cells[..own].iter().rev(), cells[own + 1..].iter());
        for side in [below.collect::<Vec<_>>(), above.collect()] {
            let mut near = at;
            for cell in side {
                let by = cell.at.cos() - near.place.elevation.cos();
                let turned = wave.best_with(wave.beside(&near, (1, by), variance), [true, false, true]);
                // Towards the line of a straight motion, azimuths of a wide range explain the samples alike: they need not turn.
                let still = At { place: Place { elevation: cell.at, ..near.place }, ..near };
                let still = wave.best_with(still, [false, false, true]);
                let needs_turn = self.cost(&still, variance) > self.cost(&turned, variance) + 0.1;
                let next = if needs_turn { turned } else { still };
                take(&next, cell, &near);
                near = next;
            }
        }
        settle(&mut mixed);
        let mut mixed = mixed.into_iter();
        let mut all = mixed.next().unwrap_or(mode);
        mixed.for_each(|mode| all.absorb(mode));
        all.place.azimuth = wrap_rad(at.place.azimuth);
        all
    }

    /// The place beside `at` by so much in one coordinate whose phases differ least, to first order: elsewhere they would be turns away
    /// from those of the samples.
    fn beside(&self, at: &At, (coordinate, by): (usize, f64), variance: f64) -> At {
        let mut information = self.information(at, variance);
        information[(3, 3)] += self.scale_sd.powi(-2);
        let mut slope = -information.column(coordinate).into_owned() * by;
        for k in (0..4).filter(|k| *k == coordinate || *k > 0 && !self.open.0[k - 1]) {
            information.row_mut(k).fill(0.0);
            information.column_mut(k).fill(0.0);
            (information[(k, k)], slope[k]) = (1.0, 0.0);
        }
        let mut step = solve(information, slope, 1e-9).unwrap_or_default();
        step[coordinate] = by;
        self.moved(at, &step, &[false; 3]).0
    }

    /// Whether much farther and nearer places explain the samples less well: to first order alone, a wave front straight ahead of
    /// a line seems to tell its range by what is the scale of the path or the azimuth.
    fn shows_range(&self, at: &At, variance: f64) -> bool {
        let least = self.log(&self.best_with(*at, [true; 3]), variance);
        let as_likely = |curve: f64| {
            let there = At { place: self.prior.at_height(Place { curve, ..at.place }), ..*at };
            self.log(&self.best_with(there, [true, true, false]), variance) > least - DOUBT
        };
        let curve = at.place.curve;
        curve > 0.0 && !as_likely(0.4 * curve) && !as_likely(2.5 * curve)
    }

    /// `ln` of likelihood and prior, but for a constant.
    fn log(&self, at: &At, variance: f64) -> f64 {
        -0.5 * self.cost(at, variance) + self.prior.log_density(&at.place)
    }

    /// The best place next to `at` with the coordinates (azimuth, elevation, 1 / range) that are not open as they are.
    fn best_with(&self, at: At, open: [bool; 3]) -> At {
        let (mut fit, mut held) = (self.fit(at), [!open[1], !open[2], false]);
        for _ in 0..STEPS {
            let Some((next, hits)) = self.step(&fit, &held, open[0]) else { break };
            let (now, before) = (&next.at.place, &fit.at.place);
            let moved = (now.elevation - before.elevation).abs() + (now.curve - before.curve).abs();
            (fit, held) = (next, hits);
            if moved < 1e-7 {
                break;
            }
        }
        fit.at
    }
}

/// Elevations that a motion does not distinguish.
pub(super) fn elevations(prior: &Prior) -> Vec<Cell> {
    let [low, high] = prior.elevation_rad;
    prior.elevations([low, high], (high - low) * high.sin() / ELEVATIONS as f64)
}

fn information(gradients: &[Gradient], variance: f64) -> Matrix4<f64> {
    gradients.iter().map(|g| g * g.transpose()).sum::<Matrix4<f64>>() / variance
}

/// Solves `information x = slope` in units in which the diagonal is 1, `damping` added to it.
fn solve(information: Matrix4<f64>, slope: Vector4<f64>, damping: f64) -> Option<Vector4<f64>> {
    let (scaled, units) = in_units(information);
    let damped = scaled + Matrix4::identity() * damping;
    let solved = damped.cholesky()?.solve(&slope.component_mul(&units));
    solved.iter().all(|v| v.is_finite()).then(|| solved.component_mul(&units))
}

fn invert(information: Matrix4<f64>) -> Option<Matrix4<f64>> {
    let (scaled, units) = in_units(information);
    let inverse = (scaled + Matrix4::identity() * 1e-14).cholesky()?.inverse();
    let units = Matrix4::from_diagonal(&units);
    Some(units * inverse * units)
}

fn in_units<const N: usize>(matrix: SMatrix<f64, N, N>) -> (SMatrix<f64, N, N>, SVector<f64, N>) {
    let units = matrix.diagonal().map(|v| if v > 0.0 { 1.0 / v.sqrt() } else { 1.0 });
    let scale = SMatrix::<f64, N, N>::from_diagonal(&units);
    (scale * matrix * scale, units)
}

/// Refuses residuals whose cumulative periodogram is not that of white noise (Bartlett's test: the largest distance from the
/// diagonal goes as Kolmogorov's).
fn whiteness(left: &[f64], false_alarm: f64, tier: Tier) -> Result<(), Unexplained> {
    let count = left.len();
    let mut spectrum: Vec<_> = left.iter().map(|e| Complex64::new(*e, 0.0)).collect();
    Ffts::<f64>::new(tier).forward(count).process(&mut spectrum);
    let power: Vec<f64> = spectrum[1..count.div_ceil(2)].iter().map(Complex64::norm_sqr).collect();
    let total: f64 = power.iter().sum();
    if total <= 1e-20 * count as f64 {
        return Ok(());
    }
    let (mut sum, mut furthest, half) = (0.0, 0.0f64, power.len() as f64);
    for (k, own) in power.iter().enumerate() {
        sum += own / total;
        furthest = furthest.max((sum - (k as f64 + 1.0) / half).abs());
    }
    let limit = (-0.5 * (0.5 * false_alarm).ln() / half).sqrt();
    if furthest > limit { Err(Unexplained::NotWhite(furthest / limit)) } else { Ok(()) }
}

/// Refuses a wave beside which another peak of the plane wave's leaves a doubt. Its mirror is judged by the depth of the
/// motion.
fn unambiguous(wave: &Wave<'_>, at: &At, plane_wave: &Estimate, steps: &Steps) -> Result<(), Unexplained> {
    let own = wave.ways.explained(wave.samples, &at.place);
    let near = |azimuth: f64, other: f64| wrap_rad(azimuth - other).abs() < 2.0 * steps.azimuth();
    let is_own = |azimuth: f64| {
        near(azimuth, at.place.azimuth) || plane_wave.mirror_rad.is_some_and(|mirror| near(azimuth, mirror))
    };
    let samples = wave.samples.len() as f64;
    let log_odds = |value: f64| samples * ((1.0 - value).max(1e-9) / (1.0 - own).max(1e-9)).ln();
    let others = plane_wave.peaks.iter().filter(|peak| !is_own(peak.azimuth_rad));
    let doubtful = others.map(|peak| peak.value).any(|value| log_odds(value) < DECISIVE);
    if doubtful { Err(Unexplained::Ambiguous) } else { Ok(()) }
}

/// The highest Bartlett peak of the residual, in units of the mean noise.
fn highest_peak(
    wave: &Wave<'_>,
    Fit { at, left }: &Fit,
    plane_wave: &Estimate,
    false_alarm: f64,
    tier: Tier,
) -> Result<f64, Unexplained> {
    let samples = wave.samples;
    let mut rest = Samples::new(samples.wavelength_m(), samples.path_gain()).map_err(|_| Unexplained::NoPlace)?;
    for (k, ((p, phase), e)) in wave.ways.each(|p| *p).zip(wave.phases(at)).zip(left).enumerate() {
        // As it was before the wave was removed from it.
        let value = Complex64::new(0.0, *e) * Complex64::cis(-phase);
        rest.push(k as f64, value, p, Vector3::zeros()).map_err(|_| Unexplained::NoPlace)?;
    }
    let highest_rad = if plane_wave.elevation_searched { wave.prior.elevation_rad[1] } else { 0.0 };
    // Nothing is left at all, or nothing that could be searched.
    let Ok(found) = Searcher::new(tier).search(&rest, highest_rad.clamp(0.0, FRAC_PI_2)) else { return Ok(1.0) };
    let sizes: f64 = left.iter().map(|e| e * e).sum();
    let sum: f64 = left.iter().map(|e| e.abs()).sum();
    let peak = found.value * sum * sum / sizes;
    let cells = (2 * found.plan.band_limit + 1) * found.plan.rings.max(1);
    let most = (cells as f64 / false_alarm).ln();
    if peak > most { Err(Unexplained::AnotherWave(peak / most)) } else { Ok(peak) }
}
