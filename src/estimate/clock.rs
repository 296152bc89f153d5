//! How well the phases fit the trajectory at other times.
//!
//! If the trajectory's clock is ahead of the log's by `d`, each sample gets the place where the robot was at another time. On a circle
//! that turns the bearing by the angle that the robot covers in `d`, and the error bar does not contain it. Starts, stops and changes of
//! speed give the offset away: they have to coincide in phases and trajectory. So the likelihood is computed for shifted times, each with
//! the place turned as the motion is, and beside it; in all directions where the motion is not only turned, as in a figure of eight.
//! Pairs taken at rest count, too: by another clock the robot may move.

use super::likelihood::{Field, Place};
use super::one_wave::Rest;
use super::posterior::log_sum;
use super::signal::{Aperture, Bins};
use super::{Model, Task, radius_m, tuning};
use crate::signal::planes::Planes;
use crate::signal::samples::Samples;
use nalgebra::Vector3;
use num_complex::Complex64;
use std::f64::consts::TAU;

/// Largest shift and step, seconds.
const REACH_S: f64 = 3.0;
pub(crate) const STEP_S: f64 = 0.1;
/// Turns of a path's phase that a step may hold. While the robot drives faster, steps are smaller, down to a fifth.
const TURNS: f64 = 0.4;
const FINEST: i32 = 5;
/// One shift in so many is looked at closely: those that the turned place alone makes likeliest.
const CLOSELY: usize = 3;
/// Longer motions are not compared, seconds: the robot rested in between, or they were recorded in parts.
const LONGEST_S: f64 = 300.0;
/// A shifted motion less alike than this is not only turned: any direction may be right by it.
const ALIKE: f64 = 0.97;
/// Azimuths searched on each side of the turned one, and their spacing as a share of the motion's resolution.
const BESIDE: i32 = 2;
const AZIMUTH_STEP: f64 = 0.5;
/// Phases are averaged over stretches of at most this many wavelengths and this many seconds.
const BIN_WAVELENGTHS: f64 = 0.15;
const BIN_S: f64 = 0.06;
/// A robot rests within so many wavelengths of its nearest sample.
const AT_REST: f64 = 0.1;
/// Spacing of the sampled path, seconds: straight lines between its points err by at most 0.4 mm at 3 m/s^2.
const PATH_S: f64 = 0.03;

/// What is needed to look at other times.
#[derive(Clone, Copy)]
pub(crate) struct OtherTimes<'a> {
    /// Of all pairs of the link, seconds on the trajectory's clock.
    pub times_s: &'a [f64],
    /// Their round trips at the channel centre.
    pub z: &'a [Complex64],
    /// Receiver less transmitter at a time, metres.
    pub displacement_m: &'a (dyn Fn(f64) -> Option<Vector3<f64>> + Sync),
}

/// Seconds to be added to the times of the samples: what [`OtherTimes::logs`] has values for.
pub(crate) fn offsets_s() -> impl DoubleEndedIterator<Item = f64> + ExactSizeIterator {
    let steps = ((REACH_S / STEP_S).round() as i32 - 1) * FINEST + FINEST / 2;
    (-steps..steps + 1).map(|k| f64::from(k) * STEP_S / f64::from(FINEST))
}

impl OtherTimes<'_> {
    /// Round trips of the pairs just before, after and between the samples where the robot rests, with displacements from `middle_m`,
    /// metres: each rest apart. `used` are the samples' rows.
    pub(super) fn rests(&self, samples: &Samples, used: &[usize], middle_m: Vector3<f64>) -> Vec<Rest> {
        let [from_s, to_s] = span_s(samples);
        let most_m = AT_REST * samples.wavelength_m();
        let mut rests = vec![Vec::new(); used.len() + 1];
        for (k, (&t_s, &z)) in self.times_s.iter().zip(self.z).enumerate() {
            let Err(samples_before) = used.binary_search(&k) else { continue };
            if (from_s - REACH_S..=to_s + REACH_S).contains(&t_s)
                && let Some(place) = (self.displacement_m)(t_s)
                && (place - between(samples, t_s)).norm() < most_m
            {
                rests[samples_before].push((z, place - middle_m));
            }
        }
        rests.retain(|rest| !rest.is_empty());
        rests
    }

    /// `ln` of the likelihood of a place, metres from the motion's middle, turned with the motion, at each of [`offsets_s`]. `rows` are all
    /// pairs of the link, as round trips or one-way channels: a path's phase is so many times in them.
    pub(super) fn logs(
        &self,
        task: &Task<'_>,
        (rows, gain): (&[Planes], u8),
        model: &Model,
        (middle_m, place): (Vector3<f64>, Place),
    ) -> Vec<f64> {
        let samples = task.samples;
        let wavelength_m = samples.wavelength_m();
        let [from_s, to_s] = span_s(samples);
        if to_s - from_s > LONGEST_S {
            return Vec::new();
        }
        let is_near = |t_s: &f64| (from_s - REACH_S..=to_s + REACH_S).contains(t_s);
        let (times_s, rows): (Vec<f64>, Vec<&Planes>) =
            self.times_s.iter().zip(rows).filter(|(t_s, _)| is_near(t_s)).unzip();
        // Beyond the trajectory the robot is taken to stand, in its gaps to drive on evenly.
        let point = |t_s: f64| {
            let point = (self.displacement_m)(t_s).unwrap_or_else(|| between(samples, t_s)) - middle_m;
            if model.prior.is_signed() { point } else { Vector3::new(point.x, point.y, 0.0) }
        };
        let path = Path::new([from_s - 2.0 * REACH_S, to_s + 2.0 * REACH_S], point);
        let points: Vec<Vector3<f64>> = times_s.iter().map(|t_s| path.at(*t_s)).collect();
        let bins = Bins::of_way_and_time((BIN_WAVELENGTHS * wavelength_m, &points), (BIN_S, &times_s));
        let own = bins.points_m(&points);
        let path_m: f64 = own.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
        let independent = (2.0 * path_m * f64::from(samples.path_gain()) / wavelength_m).min(bins.len() as f64);
        let mut apertures = vec![Aperture::of_subcarriers(rows.iter().copied(), &bins, gain, task.tier)];
        if gain == 1 && samples.path_gain() == 2 {
            let squares: Vec<Planes> = rows.iter().map(|row| row.times(row)).collect();
            apertures.push(Aperture::of_subcarriers(squares.iter(), &bins, 2, task.tier));
        }
        let mut field = Field::new(&own, apertures, wavelength_m, independent, tuning::WINDOW_LENGTHS, task.tier);
        let times_s = bins.means_of(&times_s);
        let apart_rad = wavelength_m / f64::from(samples.path_gain()) / radius_m(&model.points);
        let at = |azimuth: f64| model.prior.at_height(Place { azimuth, ..place });
        let around = |field: &Field, azimuth: f64, side: i32| {
            let near = |k: i32| at(azimuth + f64::from(k) * AZIMUTH_STEP * apart_rad);
            log_sum(&field.log_likelihoods(&(-side..=side).map(near).collect::<Vec<_>>()))
        };
        let turns = STEP_S / (to_s - from_s) * path_m * f64::from(samples.path_gain()) / wavelength_m;
        let fine = ((turns / TURNS).ceil() as i32).clamp(1, FINEST);
        let steps = (REACH_S / STEP_S).round() as i32 * fine;
        let log = |k: i32, closely: bool| {
            let offset_s = STEP_S * f64::from(k) / f64::from(fine);
            let shifted: Vec<Vector3<f64>> = times_s.iter().map(|t_s| path.at(t_s + offset_s)).collect();
            let (turned_rad, alike) = turned(&own, &shifted);
            if alike < ALIKE && k % fine != 0 {
                return None;
            }
            field.set_points(&shifted);
            let side = if closely || alike < ALIKE { BESIDE } else { 0 };
            let by_turn = around(&field, place.azimuth + turned_rad, side);
            let anywhere = (alike < ALIKE).then(|| around(&field, likeliest_rad(&field, model, at), BESIDE));
            Some(Log { log: anywhere.map_or(by_turn, |log| by_turn.max(log)), is_close: side > 0 })
        };
        let logs = searched((steps, fine as usize), log);
        offsets_s().map(|offset_s| parabola(&logs, 1, (offset_s + REACH_S) / STEP_S * f64::from(fine))).collect()
    }
}

/// Times of the first and the last sample, seconds.
fn span_s(samples: &Samples) -> [f64; 2] {
    let times_s = samples.t_s();
    [times_s.iter().copied().fold(f64::MAX, f64::min), times_s.iter().copied().fold(f64::MIN, f64::max)]
}

/// `ln` of the likelihood at one shift, and whether azimuths beside the turned one were looked at, too.
#[derive(Clone, Copy)]
struct Log {
    log: f64,
    is_close: bool,
}

/// `ln` of the likelihood at each shift from `-steps` to `steps`, the likeliest and the middle looked at closely. Where `log` gives
/// none, it is interpolated between every `fine`-th one.
fn searched((steps, fine): (i32, usize), mut log: impl FnMut(i32, bool) -> Option<Log>) -> Vec<f64> {
    let mut logs: Vec<Option<Log>> = (-steps..=steps).map(|k| log(k, false)).collect();
    let all = logs.iter().zip(-steps..).filter_map(|(own, k)| own.map(|own| (own, k)));
    let mut open: Vec<(Log, i32)> = all.filter(|(own, _)| !own.is_close).collect();
    open.sort_by(|a, b| b.0.log.total_cmp(&a.0.log));
    let closely = open.len().div_ceil(CLOSELY);
    for (_, (_, k)) in open.into_iter().enumerate().filter(|(rank, (_, k))| *rank < closely || *k == 0) {
        logs[(k + steps) as usize] = log(k, true);
    }
    let logs: Vec<f64> = logs.iter().map(|own| own.map_or(f64::NAN, |own| own.log)).collect();
    let filled = |k: usize| if logs[k].is_nan() { parabola(&logs, fine, k as f64) } else { logs[k] };
    (0..logs.len()).map(filled).collect()
}

/// The value at `at` of a row that is known at every so many places: a parabola through the nearest three.
fn parabola(row: &[f64], every: usize, at: f64) -> f64 {
    let middle = ((at / every as f64).round() as usize * every).clamp(every, row.len() - 1 - every);
    let [before, here, after] = [middle - every, middle, middle + every].map(|k| row[k]);
    let u = (at - middle as f64) / every as f64;
    here + 0.5 * (after - before) * u + 0.5 * (before - 2.0 * here + after) * u * u
}

/// A path in equal steps of time.
struct Path {
    from_s: f64,
    points: Vec<Vector3<f64>>,
}

impl Path {
    fn new([from_s, to_s]: [f64; 2], point: impl Fn(f64) -> Vector3<f64>) -> Self {
        let count = ((to_s - from_s) / PATH_S).ceil() as usize + 1;
        Self { from_s, points: (0..=count).map(|k| point(from_s + PATH_S * k as f64)).collect() }
    }

    fn at(&self, t_s: f64) -> Vector3<f64> {
        let steps = ((t_s - self.from_s) / PATH_S).max(0.0);
        let k = (steps as usize).min(self.points.len() - 2);
        self.points[k] + (self.points[k + 1] - self.points[k]) * (steps - k as f64).min(1.0)
    }
}

/// The displacement at a time between samples, metres; before and after them, the nearest one.
fn between(samples: &Samples, t_s: f64) -> Vector3<f64> {
    let at = |k: usize| samples.receiver_m()[k] - samples.transmitter_m()[k];
    let times_s = samples.t_s();
    let next = times_s.partition_point(|own| *own < t_s);
    match (next.checked_sub(1), times_s.get(next)) {
        (Some(last), Some(next_s)) => {
            let share = (t_s - times_s[last]) / (next_s - times_s[last]);
            at(last) + (at(next) - at(last)) * share
        }
        (Some(last), None) => at(last),
        (None, _) => at(0),
    }
}

/// The azimuth of the likeliest of places all around, radians.
fn likeliest_rad(field: &Field, model: &Model, at: impl Fn(f64) -> Place) -> f64 {
    let count = (TAU / model.steps.azimuth()).ceil().max(1.0) as usize;
    let places: Vec<Place> = (0..count).map(|k| at(TAU * k as f64 / count as f64)).collect();
    let logs = field.log_likelihoods(&places);
    let best = (0..count).max_by(|a, b| logs[*a].total_cmp(&logs[*b])).unwrap_or(0);
    places[best].azimuth
}

/// By how much a motion is turned about the vertical against another, by least squares over its steps, radians, and how much it is then
/// alike: 1 where each step is turned by as much. Where either rests, it tells nothing.
fn turned(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> (f64, f64) {
    let (mut along, mut across, mut most) = (0.0, 0.0, 0.0);
    for (from, to) in from.windows(2).zip(to.windows(2)) {
        let (from, to) = ((from[1] - from[0]).xy(), (to[1] - to[0]).xy());
        along += from.dot(&to);
        across += from.perp(&to);
        most += from.norm() * to.norm();
    }
    (across.atan2(along), across.hypot(along) / most.max(f64::MIN_POSITIVE))
}
