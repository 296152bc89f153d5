//! From the likelihood and the prior to directions, error bars and probabilities.
//!
//! A grid over azimuth, elevation and 1 / range, as dense as the aperture asks for, gives the probability of each azimuth.
//! About each of its tops a finer grid closes in until the posterior fills it, so that a sharp top is resolved as well as a
//! flat one. The tops with their probabilities are the candidates; the mass about the highest gives error bar and
//! probability.

use super::likelihood::{Field, Place};
use super::prior::{Cell, Prior};
use super::tuning;
use crate::maths::wrap_rad;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::{PI, TAU};

/// Azimuths of a fine grid.
const FINE: usize = 9;
/// Times that a fine grid closes in at most: each time by half at least, a thousandfold.
const CLOSER: usize = 10;
/// What is this far below the highest, in logarithms, holds less than a tenth of a percent.
const NEGLIGIBLE: f64 = 7.0;
/// One cell in so many is computed first.
const FIRST: usize = 3;
/// The other cells of an azimuth are left out if its first ones are this far below the highest, in logarithms, and below this share
/// of it: beside a sharp top the likelihood has fallen far, but not to what it is elsewhere.
const HOPELESS: f64 = 2.0 * NEGLIGIBLE;
const HOPELESS_SHARE: f64 = 0.2;
/// Tops this far below the highest are looked at closely: they may hold some percent.
const CLOSE: f64 = 4.0;
/// Tops that are looked at closely at most.
const TOPS: usize = 6;
/// Samples times places that a search may take: a second of one core.
const MOST: f64 = 3e8;
/// The coarsest azimuths of a grid, radians.
const COARSEST_RAD: f64 = 4.0 * PI / 180.0;

/// Probability at one azimuth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Atom {
    pub azimuth: f64,
    /// It is spread evenly over so much, radians.
    pub width: f64,
    pub mass: f64,
}

/// A direction that explains the samples, and what lies about it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Mode {
    /// The most probable azimuth, and elevation and 1 / range as their means over the posterior about it.
    pub place: Place,
    /// Covariance of azimuth, elevation and 1 / range.
    pub covariance: Matrix3<f64>,
    /// Its probability.
    pub mass: f64,
    pub atoms: Vec<Atom>,
}

impl Mode {
    /// Multiplies all masses.
    pub fn scale(&mut self, by: f64) {
        self.mass *= by;
        self.atoms.iter_mut().for_each(|atom| atom.mass *= by);
    }

    /// Takes in a mode beside it. The azimuth stays the most probable one, elevation and 1 / range become the means.
    pub fn absorb(&mut self, other: Self) {
        let mass = self.mass + other.mass;
        let share = if mass > 0.0 { other.mass / mass } else { 0.0 };
        let (own, its) = (&mut self.place, &other.place);
        let off =
            Vector3::new(wrap_rad(its.azimuth - own.azimuth), its.elevation - own.elevation, its.curve - own.curve);
        own.elevation += share * off.y;
        own.curve += share * off.z;
        self.covariance = self.covariance * (1.0 - share)
            + other.covariance * share
            + off * off.transpose() * (share * (1.0 - share));
        self.covariance[(0, 0)] += (share * off.x).powi(2);
        self.mass = mass;
        self.atoms.extend(other.atoms);
    }
}

/// Adds modes: those nearer to another than twice `apart_rad` to that one.
pub(crate) fn add(modes: &mut Vec<Mode>, others: Vec<Mode>, apart_rad: f64) {
    for other in others {
        let is_near = |mode: &&mut Mode| wrap_rad(mode.place.azimuth - other.place.azimuth).abs() < 2.0 * apart_rad;
        match modes.iter_mut().find(is_near) {
            Some(mode) => mode.absorb(other),
            None => modes.push(other),
        }
    }
}

/// How densely a motion's places have to be looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Steps {
    azimuth: f64,
    /// Of elevations; of their cosines where motion is level.
    elevation: f64,
    curve: f64,
}

impl Steps {
    /// `window_m` is the largest radius of a window about its own middle, `radius_m` and `tall_m` are those of the motion
    /// and of its heights.
    pub fn new((radius_m, window_m, tall_m): (f64, f64, f64), wavelength_m: f64, path_gain: u8, prior: &Prior) -> Self {
        let turn_m = wavelength_m / f64::from(path_gain);
        let window_m = window_m.max(0.1 * turn_m);
        let azimuth = (turn_m / window_m).min(COARSEST_RAD);
        // Elevation changes the way by the horizontal reach times its sine, and by the height.
        let by_elevation = (window_m * prior.elevation_rad[1].sin() + tall_m).min(window_m).max(0.1 * turn_m);
        Self {
            azimuth,
            elevation: if prior.is_signed() { turn_m / by_elevation } else { 0.5 * turn_m / window_m },
            curve: turn_m / (window_m * radius_m.max(window_m)),
        }
    }

    /// The same for an array on a robot that drives as far as `reach_m`, metres, from its mean place: a range and a direction may explain
    /// about the same as another range with another direction.
    pub fn with_parallax(self, reach_m: f64) -> Self {
        Self { curve: 0.25 * self.azimuth / reach_m, ..self }
    }

    pub fn azimuth(&self) -> f64 {
        self.azimuth
    }

    pub fn curve(&self) -> f64 {
        self.curve
    }

    /// Whether a motion of so many samples can be searched at once.
    pub fn are_affordable(&self, samples: usize, prior: &Prior) -> bool {
        let [low, high] = prior.elevation_rad;
        let span = if prior.is_signed() { high - low } else { (high - low) * high.sin() };
        let count = |span: f64, step: f64| (span / step).ceil().max(1.0);
        let elevations = if prior.elevation_is_open() { count(span, self.elevation) } else { 1.0 };
        let places = count(TAU, self.azimuth) * elevations * count(prior.curve_max, self.curve);
        places * samples as f64 <= MOST
    }
}

/// All modes of the posterior, the most probable first, with masses that sum to 1; before them the logarithm of the
/// evidence for the model. `fine` asks for a closer look at the tops.
pub(crate) fn modes(field: &Field, prior: &Prior, steps: &Steps, fine: bool) -> (f64, Vec<Mode>) {
    let coarse = Coarse::new(field, prior, steps);
    let tops = coarse.tops();
    let highest = tops.first().map_or(0.0, |&top| coarse.logs[top]);
    let close = |rank: usize, top: usize| fine && rank < TOPS && coarse.logs[top] > highest - CLOSE;
    let local = |(rank, &top): (usize, &usize)| close(rank, top).then(|| coarse.local(top, field, prior, steps));
    let locals: Vec<Option<Local>> = tops.iter().enumerate().map(local).collect();
    // A sharp top lies far above what the coarse grid saw of it.
    let highest = locals.iter().flatten().flat_map(|local| &local.logs).copied().fold(highest, f64::max);
    let mode = |(&top, local): (&usize, Option<Local>)| coarse.mode(top, local, highest, prior);
    let mut modes: Vec<Mode> = tops.iter().zip(locals).map(mode).collect();
    let evidence = highest + modes.iter().map(|mode| mode.mass).sum::<f64>().ln();
    let Some(first) = (0..modes.len()).max_by(|a, b| modes[*a].mass.total_cmp(&modes[*b].mass)) else {
        return (evidence, modes);
    };
    let waves = Waves::beside(field, modes[first].place, coarse.cells.len());
    for (rank, &top) in tops.iter().enumerate().take(TOPS).filter(|(rank, _)| *rank != first) {
        let odds = waves.odds(&modes[rank].place);
        let least = odds * modes[first].mass;
        // Smaller odds are less than the probability that nothing found is right.
        if modes[rank].mass < least && odds > tuning::UNEXPLAINED {
            let local = fine.then(|| coarse.local(top, field, prior, steps));
            let highest = local.iter().flat_map(|local| &local.logs).copied().fold(coarse.logs[top], f64::max);
            modes[rank] = coarse.mode(top, local, highest, prior);
            let by = least / modes[rank].mass;
            modes[rank].scale(by);
        }
    }
    settle(&mut modes);
    (evidence, modes)
}

/// Waves beside the likeliest one. More samples make it more certain that a wave exists, not that it is the direct one: reflections
/// exist, too.
struct Waves<'a> {
    field: &'a Field,
    first: Place,
    /// The field without the first one.
    rest: Field,
    /// Log-likelihood that noise alone reaches in the best of all places.
    noise: f64,
}

impl<'a> Waves<'a> {
    fn beside(field: &'a Field, first: Place, places: usize) -> Self {
        Self { field, first, rest: field.without(&first), noise: (places.max(1) as f64).ln() }
    }

    /// Odds, from 0 to just below 1, that a wave from a place is the direct one rather than the first: the ratio of their
    /// log-likelihoods, each without the other wave and beyond noise. 0 if nothing but noise is left there.
    fn odds(&self, place: &Place) -> f64 {
        let own = self.rest.log_likelihoods(&[*place])[0] - self.noise;
        if own <= 0.0 {
            return 0.0;
        }
        let first = self.field.without(place).log_likelihoods(&[self.first])[0] - self.noise;
        (own / first.max(own)).min(1.0 - f64::EPSILON)
    }
}

/// Scales the masses of `modes` to a sum of 1, and orders them.
pub(crate) fn settle(modes: &mut [Mode]) {
    let total: f64 = modes.iter().map(|mode| mode.mass).sum();
    let by = if total > 0.0 { 1.0 / total } else { 0.0 };
    modes.iter_mut().for_each(|mode| mode.scale(by));
    modes.sort_by(|a, b| b.mass.total_cmp(&a.mass));
}

/// Cells of elevation and 1 / range: cell `k` is of elevation `k / curves`.
struct Cells {
    elevations: Vec<Cell>,
    curves: Vec<Cell>,
}

impl Cells {
    fn len(&self) -> usize {
        self.elevations.len() * self.curves.len()
    }

    fn at(&self, k: usize) -> [&Cell; 2] {
        [&self.elevations[k / self.curves.len()], &self.curves[k % self.curves.len()]]
    }

    fn place(&self, azimuth: f64, k: usize) -> Place {
        let [elevation, curve] = self.at(k);
        Place { azimuth, elevation: elevation.at, curve: curve.at }
    }

    /// `ln` of the prior of a cell.
    fn log_prior(&self, k: usize) -> f64 {
        let [elevation, curve] = self.at(k);
        (elevation.mass * curve.mass).ln()
    }

    /// `ln (prior x likelihood)` of cells at azimuths.
    fn logs(&self, field: &Field, prior: &Prior, chosen: &[(f64, usize)]) -> Vec<f64> {
        let place = |&(azimuth, k): &(f64, usize)| prior.at_height(self.place(azimuth, k));
        let mut logs = field.log_likelihoods(&chosen.iter().map(place).collect::<Vec<_>>());
        logs.iter_mut().zip(chosen).for_each(|(log, (_, k))| *log += self.log_prior(*k));
        logs
    }

    /// Whether a cell is computed first: each cell is one of them or beside one.
    fn is_first(&self, k: usize) -> bool {
        self.len() <= FIRST || (k / self.curves.len() + k % self.curves.len()) % FIRST == 1
    }
}

/// The whole circle, coarsely.
struct Coarse {
    grid: Cells,
    /// `ln (prior x likelihood)` of every cell, azimuth by azimuth.
    cells: Vec<f64>,
    /// `ln` of their sums over each azimuth.
    logs: Vec<f64>,
}

impl Coarse {
    fn new(field: &Field, prior: &Prior, steps: &Steps) -> Self {
        let azimuths = (TAU / steps.azimuth).ceil().max(4.0) as usize;
        let grid = Cells {
            elevations: prior.elevations(prior.elevation_rad, steps.elevation),
            curves: prior.curves([0.0, prior.curve_max], steps.curve),
        };
        let each = grid.len();
        let mut cells = vec![f64::NEG_INFINITY; azimuths * each];
        let compute = |cells: &mut [f64], chosen: &[usize]| {
            let at = |k: &usize| (TAU * (k / each) as f64 / azimuths as f64, k % each);
            let logs = grid.logs(field, prior, &chosen.iter().map(at).collect::<Vec<_>>());
            chosen.iter().zip(logs).for_each(|(k, log)| cells[*k] = log);
        };
        let (first, others): (Vec<usize>, Vec<usize>) = (0..cells.len()).partition(|k| grid.is_first(k % each));
        compute(&mut cells, &first);
        let first_priors: Vec<f64> = (0..each).filter(|k| grid.is_first(*k)).map(|k| grid.log_prior(k)).collect();
        // The mean likelihood of an azimuth's first cells.
        let mean = |cells: &[f64]| log_sum(cells) - log_sum(&first_priors);
        let means: Vec<f64> = cells.chunks(each).map(mean).collect();
        let highest = means.iter().copied().fold(f64::MIN, f64::max);
        let least = (highest - HOPELESS).min(HOPELESS_SHARE * highest);
        let (open, hopeless): (Vec<usize>, Vec<usize>) = others.into_iter().partition(|k| means[k / each] > least);
        compute(&mut cells, &open);
        hopeless.iter().for_each(|&k| cells[k] = means[k / each] + grid.log_prior(k % each));
        let logs = cells.chunks(each).map(log_sum).collect();
        Self { grid, cells, logs }
    }

    fn spacing(&self) -> f64 {
        TAU / self.logs.len() as f64
    }

    /// The local maxima, the highest first.
    fn tops(&self) -> Vec<usize> {
        let count = self.logs.len();
        let is_top = |&k: &usize| {
            let (before, after) = (self.logs[(k + count - 1) % count], self.logs[(k + 1) % count]);
            self.logs[k] >= before && self.logs[k] > after
        };
        let mut tops: Vec<usize> = (0..count).filter(is_top).collect();
        if tops.is_empty() {
            tops.extend((0..count).max_by(|a, b| self.logs[*a].total_cmp(&self.logs[*b])));
        }
        tops.sort_by(|a, b| self.logs[*b].total_cmp(&self.logs[*a]));
        tops
    }

    /// Azimuths on either side of `top` up to the next minimum, `top` among them.
    fn basin(&self, top: usize) -> Vec<usize> {
        let count = self.logs.len();
        let side = |step: usize| {
            let (mut at, mut found) = (top, Vec::new());
            while found.len() < count / 2 {
                let next = (at + step) % count;
                if self.logs[next] > self.logs[at] {
                    break;
                }
                found.push(next);
                at = next;
            }
            // The minimum belongs to the side after it.
            if step != 1 {
                found.pop();
            }
            found
        };
        let mut all = side(1);
        all.push(top);
        all.extend(side(count - 1));
        all
    }

    fn mode(&self, top: usize, local: Option<Local>, highest: f64, prior: &Prior) -> Mode {
        let spacing = self.spacing();
        let atom = |&k: &usize| Atom {
            azimuth: wrap_rad(k as f64 * spacing),
            width: spacing,
            mass: (self.logs[k] - highest).exp() * spacing,
        };
        let basin = self.basin(top);
        let Some(local) = local else {
            let atoms: Vec<Atom> = basin.iter().map(atom).collect();
            let cells = self.bounds(top);
            let place = prior.at_height(Place {
                azimuth: atom(&top).azimuth,
                elevation: cells.elevation.1,
                curve: cells.curve.1,
            });
            let square = |width: f64| width * width / 12.0;
            let covariance = Matrix3::from_diagonal(&Vector3::new(
                square(spacing),
                square(cells.elevation.0[1] - cells.elevation.0[0]),
                square(cells.curve.0[1] - cells.curve.0[0]),
            ));
            return Mode { place, covariance, mass: atoms.iter().map(|atom| atom.mass).sum(), atoms };
        };
        let count = self.logs.len();
        let outside = |k: &&usize| (**k + count - top + 1) % count > 2;
        let mut atoms: Vec<Atom> = basin.iter().filter(outside).map(atom).collect();
        atoms.extend(local.atoms(highest));
        Mode { place: local.place, covariance: local.spread(), mass: atoms.iter().map(|atom| atom.mass).sum(), atoms }
    }

    /// A closer look at a top.
    fn local(&self, top: usize, field: &Field, prior: &Prior, steps: &Steps) -> Local {
        let (cells, spacing) = (self.bounds(top), self.spacing());
        let middle = top as f64 * spacing;
        let start = Bounds {
            azimuth: [middle - spacing, middle + spacing],
            elevation: cells.elevation.0,
            curve: cells.curve.0,
        };
        Local::about(start, field, prior, steps)
    }

    /// The cells of an azimuth that are not negligible, and the best of them.
    fn bounds(&self, azimuth: usize) -> CellBounds {
        let each = self.grid.len();
        let own = &self.cells[azimuth * each..(azimuth + 1) * each];
        let best = own.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(k, _)| k);
        let (mut elevation, mut curve) = ([f64::MAX, f64::MIN], [f64::MAX, f64::MIN]);
        for (k, log) in own.iter().enumerate() {
            if *log > own[best] - NEGLIGIBLE {
                let [e, c] = self.grid.at(k);
                elevation = [elevation[0].min(e.low), elevation[1].max(e.high)];
                curve = [curve[0].min(c.low), curve[1].max(c.high)];
            }
        }
        let [e, c] = self.grid.at(best);
        CellBounds { elevation: (elevation, e.at), curve: (curve, c.at) }
    }
}

/// Limits, and the best value within them.
struct CellBounds {
    elevation: ([f64; 2], f64),
    curve: ([f64; 2], f64),
}

pub(super) fn log_sum(logs: &[f64]) -> f64 {
    let highest = logs.iter().copied().fold(f64::MIN, f64::max);
    highest + logs.iter().map(|log| (log - highest).exp()).sum::<f64>().ln()
}

#[derive(Clone, Copy, Debug)]
struct Bounds {
    azimuth: [f64; 2],
    elevation: [f64; 2],
    curve: [f64; 2],
}

/// The posterior about one top, resolved.
struct Local {
    place: Place,
    /// Covariance over the cells' centres.
    covariance: Matrix3<f64>,
    /// Sizes of a cell: azimuth, elevation, 1 / range.
    cell: Vector3<f64>,
    bounds: Bounds,
    /// `ln` of the mass of each azimuth's cells, per radian.
    logs: Vec<f64>,
}

impl Local {
    fn about(mut bounds: Bounds, field: &Field, prior: &Prior, steps: &Steps) -> Self {
        let outer = bounds;
        let mut local = Self::at(bounds, field, prior, steps);
        for _ in 0..CLOSER {
            let closer = local.closer(&outer);
            let shrinks = |own: [f64; 2], next: [f64; 2]| next[1] - next[0] < 0.65 * (own[1] - own[0]);
            let done = !shrinks(bounds.azimuth, closer.azimuth)
                && !shrinks(bounds.elevation, closer.elevation)
                && !shrinks(bounds.curve, closer.curve);
            if done {
                break;
            }
            bounds = closer;
            local = Self::at(bounds, field, prior, steps);
        }
        local
    }

    fn at(bounds: Bounds, field: &Field, prior: &Prior, steps: &Steps) -> Self {
        let [low, high] = bounds.azimuth;
        let width = (high - low) / FINE as f64;
        let azimuth = |k: usize| low + (k as f64 + 0.5) * width;
        // The coarse steps, or a few in what is left of one.
        let fine = |span: f64, step: f64| if span > 1.5 * step { step } else { span / 3.0 };
        let [e_low, e_high] = bounds.elevation;
        let span = if prior.is_signed() { e_high - e_low } else { (e_high - e_low) * e_high.sin() };
        let grid = Cells {
            elevations: prior.elevations(bounds.elevation, fine(span, steps.elevation)),
            curves: prior.curves(bounds.curve, fine(bounds.curve[1] - bounds.curve[0], steps.curve)),
        };
        let each = grid.len();
        let chosen: Vec<(f64, usize)> = (0..FINE * each).map(|k| (azimuth(k / each), k % each)).collect();
        let cells = grid.logs(field, prior, &chosen);
        let highest = cells.iter().copied().fold(f64::MIN, f64::max);
        let (mut mean, mut second, mut total) = (Vector3::zeros(), Matrix3::zeros(), 0.0);
        for (log, (azimuth, k)) in cells.iter().zip(&chosen) {
            let weight = (log - highest).exp();
            let place = prior.at_height(grid.place(*azimuth, *k));
            let at = Vector3::new(place.azimuth, place.elevation, place.curve);
            mean += at * weight;
            second += at * at.transpose() * weight;
            total += weight;
        }
        mean /= total;
        let cell = Vector3::new(
            width,
            (e_high - e_low) / grid.elevations.len() as f64,
            (bounds.curve[1] - bounds.curve[0]) / grid.curves.len() as f64,
        );
        let covariance = second / total - mean * mean.transpose();
        let logs: Vec<f64> = cells.chunks(each).map(log_sum).collect();
        let place = Place { azimuth: wrap_rad(azimuth(0) + width * top(&logs)), elevation: mean[1], curve: mean[2] };
        Self { place, covariance, cell, bounds, logs }
    }

    /// Where the posterior lies, with a margin.
    fn closer(&self, outer: &Bounds) -> Bounds {
        let around = |axis: usize, mean: f64, outer: [f64; 2]| {
            let half = (3.5 * self.covariance[(axis, axis)].max(0.0).sqrt()).max(0.75 * self.cell[axis]);
            [(mean - half).max(outer[0]), (mean + half).min(outer[1])]
        };
        let azimuth = outer.azimuth[0] + (self.place.azimuth - outer.azimuth[0]).rem_euclid(TAU);
        Bounds {
            azimuth: around(0, azimuth, outer.azimuth),
            elevation: around(1, self.place.elevation, outer.elevation),
            curve: around(2, self.place.curve, outer.curve),
        }
    }

    /// The covariance, that of the cells themselves with it.
    fn spread(&self) -> Matrix3<f64> {
        self.covariance + Matrix3::from_diagonal(&self.cell.component_mul(&self.cell)) / 12.0
    }

    fn atoms(&self, highest: f64) -> impl Iterator<Item = Atom> + '_ {
        let [low, high] = self.bounds.azimuth;
        let width = (high - low) / FINE as f64;
        self.logs.iter().enumerate().map(move |(k, log)| Atom {
            azimuth: wrap_rad(low + (k as f64 + 0.5) * width),
            width,
            mass: (log - highest).exp() * width,
        })
    }
}

/// The place of the maximum, in steps from the first: a parabola through the highest value and its neighbours.
fn top(logs: &[f64]) -> f64 {
    let best = logs.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(k, _)| k);
    let (Some(before), Some(after)) = (best.checked_sub(1).and_then(|k| logs.get(k)), logs.get(best + 1)) else {
        return best as f64;
    };
    let bend = before - 2.0 * logs[best] + after;
    best as f64 + if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

/// How far an azimuth may be off beyond what the posterior of one wave says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Blur {
    /// Deviation of the heading of the whole path, radians.
    pub heading_rad: f64,
    /// Half width of what paths that pass for the direct one add, radians.
    pub model_rad: f64,
}

/// The density about one atom: a mixture of a normal and a Cauchy density of the same full width at half maximum, the
/// nearest to their Voigt profile (Thompson, Cox and Hastings 1987).
#[derive(Clone, Copy)]
struct Kernel {
    full: f64,
    cauchy: f64,
}

impl Kernel {
    /// Of atoms spread over `width` radians.
    fn new(blur: &Blur, width: f64) -> Self {
        let normal = FULL_WIDTH * blur.heading_rad.hypot(width / 12f64.sqrt()).max(1e-9);
        let cauchy = 2.0 * blur.model_rad;
        let terms = [1.0, 2.692_69, 2.428_43, 4.471_63, 0.078_42, 1.0];
        let power = |k: i32| normal.powi(5 - k) * cauchy.powi(k);
        let full = (0..6).zip(terms).map(|(k, term)| term * power(k)).sum::<f64>().powf(0.2);
        let share = cauchy / full;
        Self { full, cauchy: 1.366_03 * share - 0.477_19 * share * share + 0.111_16 * share.powi(3) }
    }

    /// Probability of less than `x`.
    fn below(&self, x: f64) -> f64 {
        let normal = 0.5 * (1.0 + libm::erf(x * FULL_WIDTH / (self.full * std::f64::consts::SQRT_2)));
        let cauchy = 0.5 + (2.0 * x / self.full).atan() / PI;
        self.cauchy * cauchy + (1.0 - self.cauchy) * normal
    }
}

/// Full width at half maximum of a normal density, in deviations.
const FULL_WIDTH: f64 = 2.354_820_045;

/// Probability that the truth is within `half_rad` of one of `centres`.
pub(crate) fn mass_within(modes: &[Mode], blur: &Blur, centres: &[f64], half_rad: f64) -> f64 {
    let (mut explained, mut kernel, mut of) = (0.0, Kernel::new(blur, 0.0), f64::NAN);
    for atom in modes.iter().flat_map(|mode| &mode.atoms).filter(|atom| atom.mass > 0.0) {
        if atom.width != of {
            (kernel, of) = (Kernel::new(blur, atom.width), atom.width);
        }
        let inside = |centre: &f64| {
            let off = wrap_rad(atom.azimuth - centre);
            kernel.below(half_rad - off) - kernel.below(-half_rad - off)
        };
        explained += atom.mass * centres.iter().map(inside).sum::<f64>().min(1.0);
    }
    let anywhere = (half_rad / PI * centres.len() as f64).min(1.0);
    (1.0 - tuning::UNEXPLAINED) * explained + tuning::UNEXPLAINED * anywhere
}

/// The half width about the nearest of `centres` that holds a share of the probability, radians; at most pi.
pub(crate) fn half_width(modes: &[Mode], blur: &Blur, centres: &[f64], share: f64) -> f64 {
    let (mut low, mut high) = (0.0, PI);
    while high - low > 2e-3 * high {
        let middle = if low > 0.0 { 0.5 * (low + high) } else { 0.1 * high };
        if mass_within(modes, blur, centres, middle) < share {
            low = middle
        } else {
            high = middle
        }
        if high < 1e-9 {
            break;
        }
    }
    high
}

#[cfg(test)]
mod tests {
    //! The oracle: the same posterior by its definition, slowly. Sums over a dense grid, in double, with its own copies of the
    //! likelihood, the prior and the blur.

    use super::*;
    use crate::estimate::prior::Limits;
    use crate::estimate::signal::{Aperture, Bins};
    use num_complex::Complex64;

    const WAVELENGTH_M: f64 = 0.054;
    const INDEPENDENT: f64 = 24.0;
    const AZIMUTHS: usize = 720;
    const ELEVATIONS: usize = 10;
    const CURVES: usize = 24;

    /// A wave from a place with another from elsewhere and noise, at each point.
    struct Scene {
        points: Vec<Vector3<f64>>,
        waves: Vec<(Place, f64)>,
        noise: f64,
    }

    impl Scene {
        fn new(count: usize, at: impl Fn(f64) -> Vector3<f64>, waves: &[(Place, f64)], noise: f64) -> Self {
            let points: Vec<Vector3<f64>> = (0..count).map(|k| at(k as f64 / (count - 1) as f64)).collect();
            let middle = points.iter().sum::<Vector3<f64>>() / count as f64;
            Self { points: points.iter().map(|p| p - middle).collect(), waves: waves.to_vec(), noise }
        }

        fn heard(&self, gain: f64) -> Vec<Complex64> {
            // Noise of a fixed seed, the same for every run.
            let mut state = 17_u64;
            let mut random = move || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
            };
            let wave = |p: &Vector3<f64>, (place, power): &(Place, f64)| {
                *power * Complex64::cis(-TAU * gain * way_m(p, place) / WAVELENGTH_M)
            };
            self.points
                .iter()
                .map(|p| {
                    self.waves.iter().map(|own| wave(p, own)).sum::<Complex64>()
                        + self.noise * Complex64::new(random(), random())
                })
                .collect()
        }
    }

    /// How much longer the way from `place` to `p` is than to the middle of the motion, metres.
    fn way_m(p: &Vector3<f64>, place: &Place) -> f64 {
        let u = crate::bartlett::direction(place.azimuth, place.elevation);
        if place.curve > 0.0 { (u / place.curve - p).norm() - 1.0 / place.curve } else { -u.dot(p) }
    }

    /// `sum over channels and window lengths of (N - windows) (-ln(1 - rho))`, over their number.
    fn slow_log_likelihood(points: &[Vector3<f64>], channels: &[(Vec<Complex64>, f64)], place: &Place) -> f64 {
        let (count, mut sum) = (points.len(), 0.0);
        for (z, gain) in channels {
            let turned: Vec<Complex64> = (0..count)
                .map(|k| z[k] * Complex64::cis(TAU * gain * way_m(&points[k], place) / WAVELENGTH_M))
                .collect();
            for windows in [1, 2, 4, 8] {
                let edge = |k: usize| (k * (8 / windows) * count + 4) / 8;
                let (mut found, mut full) = (0.0, 0.0);
                for w in 0..windows {
                    let inside = edge(w)..edge(w + 1);
                    found += turned[inside.clone()].iter().sum::<Complex64>().norm_sqr();
                    full += inside.len() as f64 * turned[inside].iter().map(|z| z.norm_sqr()).sum::<f64>();
                }
                sum -= (INDEPENDENT - windows as f64).max(0.0) * (1.0 - found / full).ln();
            }
        }
        sum / (4 * channels.len()) as f64
    }

    /// The channels without a wave from a place, of another amplitude in each eighth.
    fn without(
        points: &[Vector3<f64>],
        channels: &[(Vec<Complex64>, f64)],
        place: &Place,
    ) -> Vec<(Vec<Complex64>, f64)> {
        let edge = |k: usize| (k * points.len() + 4) / 8;
        let rest = |(z, gain): &(Vec<Complex64>, f64)| {
            let wave = |k: usize| Complex64::cis(-TAU * gain * way_m(&points[k], place) / WAVELENGTH_M);
            let one = |w: usize| {
                let inside = edge(w)..edge(w + 1);
                let mean = inside.clone().map(|k| z[k] * wave(k).conj()).sum::<Complex64>() / inside.len() as f64;
                inside.map(move |k| z[k] - mean * wave(k)).collect::<Vec<_>>()
            };
            ((0..8).flat_map(one).collect(), *gain)
        };
        channels.iter().map(rest).collect()
    }

    /// The posterior on a grid of [`AZIMUTHS`] x [`ELEVATIONS`] x [`CURVES`].
    struct Oracle {
        /// Places with their probabilities, azimuth by azimuth.
        cells: Vec<(Place, f64)>,
    }

    impl Oracle {
        /// Of level motion: |elevation| is uniform up to 20 degrees, ln range from 1.8 to 36 m and 1 / range beyond.
        fn new(points: &[Vector3<f64>], channels: &[(Vec<Complex64>, f64)]) -> Self {
            let (highest, curve_max) = (20f64.to_radians(), 1.0 / 1.8);
            let mut cells = Vec::new();
            for k in 0..AZIMUTHS * ELEVATIONS * CURVES {
                let (azimuth, rest) = (k / (ELEVATIONS * CURVES), k % (ELEVATIONS * CURVES));
                let place = Place {
                    azimuth: TAU * azimuth as f64 / AZIMUTHS as f64,
                    elevation: highest * ((rest / CURVES) as f64 + 0.5) / ELEVATIONS as f64,
                    curve: curve_max * ((rest % CURVES) as f64 + 0.5) / CURVES as f64,
                };
                let density = 1.0 / place.curve.max(curve_max / 20.0);
                cells.push((place, density.ln() + slow_log_likelihood(points, channels, &place)));
            }
            let highest = cells.iter().map(|cell| cell.1).fold(f64::MIN, f64::max);
            cells.iter_mut().for_each(|cell| cell.1 = (cell.1 - highest).exp());
            let total: f64 = cells.iter().map(|cell| cell.1).sum();
            cells.iter_mut().for_each(|cell| cell.1 /= total);
            Self { cells }
        }

        /// The same where the second of two waves may be the direct one, too: its odds are the ratio of what each explains of what the
        /// other leaves, less `noise`. Each place counts with the nearer of the two.
        fn with_waves(
            mut self,
            points: &[Vector3<f64>],
            channels: &[(Vec<Complex64>, f64)],
            [first, other]: [Place; 2],
            noise: f64,
        ) -> Self {
            let left = |taken: &Place, place: &Place| {
                slow_log_likelihood(points, &without(points, channels, taken), place) - noise
            };
            let (own, odds) = (left(&first, &other), left(&first, &other) / left(&other, &first));
            let off = |from: &Place, to: &Place| wrap_rad(from.azimuth - to.azimuth).abs();
            let is_other = |place: &Place| off(place, &other) < off(place, &first);
            let mass = |others: bool| {
                let own = self.cells.iter().filter(|(place, _)| is_other(place) == others);
                own.map(|cell| cell.1).sum::<f64>()
            };
            let raised = if own > 0.0 { (odds.min(1.0) * mass(false) / mass(true)).max(1.0) } else { 1.0 };
            self.cells.iter_mut().filter(|(place, _)| is_other(place)).for_each(|cell| cell.1 *= raised);
            let total: f64 = self.cells.iter().map(|cell| cell.1).sum();
            self.cells.iter_mut().for_each(|cell| cell.1 /= total);
            self
        }

        /// Probability of each azimuth.
        fn azimuths(&self) -> Vec<f64> {
            self.cells.chunks(ELEVATIONS * CURVES).map(|own| own.iter().map(|cell| cell.1).sum()).collect()
        }

        /// The most probable azimuth within 30 degrees of another, the vertex of a parabola in its logarithm.
        fn azimuth(&self, about: f64) -> f64 {
            let mass = self.azimuths();
            let azimuth = |k: usize| TAU * k as f64 / AZIMUTHS as f64;
            let near = (0..AZIMUTHS).filter(|&k| wrap_rad(azimuth(k) - about).abs() < PI / 6.0);
            let best = near.max_by(|a, b| mass[*a].total_cmp(&mass[*b])).unwrap_or_default();
            let [before, at, after] = [AZIMUTHS - 1, 0, 1].map(|step| mass[(best + step) % AZIMUTHS].ln());
            azimuth(1) * (best as f64 + 0.5 * (before - after) / (before - 2.0 * at + after))
        }

        /// Probability of the most probable azimuth, by the largest.
        fn share_of(&self, azimuth: f64) -> f64 {
            let mass = self.azimuths();
            let k = (azimuth.rem_euclid(TAU) / TAU * AZIMUTHS as f64).round() as usize % AZIMUTHS;
            mass[k] / mass.iter().copied().fold(0.0, f64::max)
        }

        /// Mean and deviation of a figure of the places within `half_rad` of an azimuth.
        fn moments(&self, about: f64, half_rad: f64, figure: impl Fn(&Place) -> f64) -> (f64, f64) {
            let near = || self.cells.iter().filter(|(place, _)| wrap_rad(place.azimuth - about).abs() < half_rad);
            let total: f64 = near().map(|cell| cell.1).sum();
            let mean = near().map(|(place, mass)| figure(place) * mass).sum::<f64>() / total;
            let square = near().map(|(place, mass)| (figure(place) - mean).powi(2) * mass).sum::<f64>() / total;
            (mean, square.sqrt())
        }

        /// Probability within `half_rad` of an azimuth, the posterior convolved with a normal and a Cauchy density in turn.
        fn within(&self, about: f64, half_rad: f64, blur: &Blur) -> f64 {
            let mass = self.azimuths();
            let step = TAU / AZIMUTHS as f64;
            let turn = |by: usize, k: usize| (k + by) % AZIMUTHS;
            let convolve = |mass: &[f64], below: &dyn Fn(f64) -> f64| -> Vec<f64> {
                let share = |by: usize| {
                    let off = wrap_rad(by as f64 * step);
                    below(off + 0.5 * step) - below(off - 0.5 * step)
                };
                let shares: Vec<f64> = (0..AZIMUTHS).map(share).collect();
                (0..AZIMUTHS).map(|k| (0..AZIMUTHS).map(|by| mass[turn(by, k)] * shares[by]).sum()).collect()
            };
            let normal = |x: f64| 0.5 * (1.0 + libm::erf(x / (blur.heading_rad * std::f64::consts::SQRT_2)));
            let cauchy = |x: f64| 0.5 + (x / blur.model_rad).atan() / PI;
            let blurred = convolve(&convolve(&mass, &normal), &cauchy);
            // A part of the cell at each edge.
            let inside = |k: usize| {
                let off = wrap_rad(k as f64 * step - about).abs();
                ((half_rad - off) / step + 0.5).clamp(0.0, 1.0)
            };
            let explained: f64 = blurred.iter().enumerate().map(|(k, mass)| mass * inside(k)).sum();
            0.99 * explained + 0.01 * half_rad / PI
        }
    }

    /// Holds the search against the oracle; the probability of the first mode.
    fn compare(scene: &Scene) -> f64 {
        let channels = [(scene.heard(2.0), 2.0), (scene.heard(1.0), 1.0)];
        let bins = Bins::along(&scene.points.iter().map(|p| p * 100.0).collect::<Vec<_>>(), WAVELENGTH_M);
        assert_eq!(bins.len(), scene.points.len());
        let apertures = channels.iter().map(|(z, gain)| Aperture::of_phasors(z, &bins, *gain as u8)).collect();
        let tier = crate::bartlett::Tier::detect();
        let field = Field::new(&scene.points, apertures, WAVELENGTH_M, INDEPENDENT, tuning::WINDOW_LENGTHS, tier);
        let prior = Prior::new(&Limits { near_field: true, ..Limits::default() }, false);
        let radius_m = scene.points.iter().map(|p| p.norm()).fold(0.0, f64::max);
        let steps = Steps::new((radius_m, radius_m, 0.0), WAVELENGTH_M, 2, &prior);
        let noise = (Coarse::new(&field, &prior, &steps).cells.len() as f64).ln();
        let (_, modes) = modes(&field, &prior, &steps, true);
        let [first, other] = [0, 1].map(|k| &modes[k]);
        let oracle = Oracle::new(&scene.points, &channels);
        let oracle = oracle.with_waves(&scene.points, &channels, [first.place, other.place], noise);

        let own = oracle.azimuth(first.place.azimuth);
        assert!(oracle.share_of(own) > 0.9, "the oracle prefers another: {}", oracle.share_of(own));
        let deviation = first.covariance[(0, 0)].sqrt();
        let off = wrap_rad(first.place.azimuth - own);
        assert!(off.abs() < 0.15 * deviation, "azimuth off by {off} of {deviation}");
        let near = 4.0 * deviation;
        let (_, sd) = oracle.moments(own, near, |place| wrap_rad(place.azimuth - own));
        assert!((deviation / sd - 1.0).abs() < 0.15, "deviation {deviation}, {sd}");
        for (axis, at, figure) in [
            (1, first.place.elevation, (|place| place.elevation) as fn(&Place) -> f64),
            (2, first.place.curve, |place| place.curve),
        ] {
            let (mean, sd) = oracle.moments(own, near, figure);
            let deviation = first.covariance[(axis, axis)].sqrt();
            assert!((at - mean).abs() < 0.25 * sd, "axis {axis}: {at} {mean} of {sd}");
            assert!((deviation / sd - 1.0).abs() < 0.2, "axis {axis}: deviation {deviation} {sd}");
        }
        let blur = Blur { heading_rad: 1f64.to_radians(), model_rad: tuning::MODEL_DEG.to_radians() };
        for degrees in [1.0_f64, 2.5, 5.0, 10.0, 45.0] {
            let half = degrees.to_radians();
            let (fast, slow) = (mass_within(&modes, &blur, &[own], half), oracle.within(own, half, &blur));
            assert!((fast - slow).abs() < 0.035, "within {degrees} degrees: {fast} {slow}");
        }
        for share in [0.68, 0.95] {
            let half = half_width(&modes, &blur, &[own], share);
            let slow = oracle.within(own, half, &blur);
            assert!((slow - share).abs() < 0.035, "{share} within {half}: {slow}");
        }
        first.mass
    }

    fn place(azimuth: f64, curve: f64) -> Place {
        Place { azimuth, elevation: 0.1, curve }
    }

    fn arc(t: f64) -> Vector3<f64> {
        let (sin, cos) = (2.0 * t).sin_cos();
        Vector3::new(0.12 * cos, 0.12 * sin, 0.0)
    }

    #[test]
    fn a_wave_in_noise_is_what_the_oracle_says() {
        let mass = compare(&Scene::new(40, arc, &[(place(0.7, 0.3), 1.0)], 1.6));
        assert!(mass > 0.8, "{mass}");
    }

    #[test]
    fn two_waves_have_the_oracles_shares() {
        for (power, share) in [(0.9, 0.4..0.6), (0.7, 0.5..0.95)] {
            let waves = [(place(0.7, 0.1), 1.0), (place(2.9, 0.2), power)];
            let mass = compare(&Scene::new(40, arc, &waves, 0.8));
            assert!(share.contains(&mass), "{power}: {mass}");
        }
    }

    #[test]
    fn both_sides_of_a_line_have_half_each() {
        let line = |t: f64| Vector3::new(0.25 * t, 0.0, 0.0);
        let mass = compare(&Scene::new(40, line, &[(place(1.1, 0.05), 1.0)], 1.2));
        assert!((mass - 0.5).abs() < 0.02, "{mass}");
    }
}
