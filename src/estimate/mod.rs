//! The estimate: from coherent samples to the posterior of a transmitter's direction and range.
//!
//! ```text
//! pairs -> compensation -> alignment -> two-way and one-way channel      signal
//!       -> likelihood of a spherical wave over windows                   likelihood
//!       -> x prior = posterior over azimuth, elevation, range            prior, posterior
//!       -> azimuth, candidates, error bar, probability, range, place     [`Found`]
//! ```
//!
//! `odometry` asks for the path's own errors.
//!
//! A clean scene stops early: where one wave leaves nothing but noise, its place by least squares is the most likely one, and
//! the posterior is that of independent samples (`one_wave`). Everything else is searched with windows, which assume only
//! that a wave stays coherent over some part of the motion.

pub(crate) mod clock;
mod combine;
pub(crate) mod likelihood;
mod mirror;
pub(crate) mod odometry;
pub(crate) mod one_wave;
pub(crate) mod posterior;
pub(crate) mod prior;
pub(crate) mod range_change;
pub(crate) mod signal;
mod start;
pub(crate) mod tuning;

use crate::bartlett::{self, Means, Searcher, Tier};
use crate::maths::wrap_rad;
use crate::signal::channel::SUBCARRIERS;
use crate::signal::planes::Planes;
use crate::signal::samples::Samples;
pub(crate) use clock::OtherTimes;
pub(crate) use combine::both;
use likelihood::{Field, Place, Ways};
use nalgebra::Vector3;
pub use odometry::{OdometryError, OdometryFit};
use one_wave::Heard;
pub use one_wave::Unexplained;
use posterior::{Blur, Mode, Steps, half_width, mass_within};
use prior::{Limits, Prior};
pub use range_change::{NoRangeChange, RangeChange};
use signal::{Aperture, Bins, align, is_dense_enough, remove_slope, take_roots};
use std::f64::consts::{FRAC_PI_2, TAU};
use tuning::{FARTHEST, NEAREST_M};

/// Heights that turn a wave from the expected elevations by less than a quarter of a turn show no elevation: half the
/// motion's height, in turns of phase.
const LEVEL_TURNS: f64 = 0.35;
/// A tracking camera's height drifts by up to a seventh of a circle's radius: heights below this share of the motion's
/// longest side may be no heights at all.
const TALL: f64 = 0.2;
/// Where a wave explains this share of the power, no other direction can hold the only wave: it would leave this one less.
const LARGE_SHARE: f64 = 0.5;
/// Nearest places that a motion leaves free, in its radii: outside, and where the motion goes around the transmitter.
const OUTSIDE: f64 = 1.2;
const INSIDE: f64 = 0.2;
/// Azimuths of a line at two successive elevations belong to one mode if they differ by less than this many steps.
const LINE_STEPS: f64 = 3.0;
/// A smaller change of phase by parallax does not matter, radians.
const SAME_DIRECTION_RAD: f64 = 0.5;
/// From this accuracy on the grid alone will do, radians: of 71 WSR links it moves the azimuth by 1.1 degrees in the median, 2.5 at most.
pub(crate) const COARSE_RAD: f64 = 0.052;

/// Deviation of the heading of a whole path, radians, by sensor.
pub mod heading {
    use super::tuning::sensor;

    /// Motion capture.
    pub const MOTION_CAPTURE_RAD: f64 = sensor::MOTION_CAPTURE_DEG.to_radians();
    /// A tracking camera.
    pub const CAMERA_RAD: f64 = sensor::CAMERA_DEG.to_radians();
    /// A camera's path held to what wheels can roll ([`crate::motion::pose::Trajectory::rolling`]).
    pub const ROLLING_CAMERA_RAD: f64 = sensor::ROLLING_CAMERA_DEG.to_radians();
    /// Wheels, where the place of the antenna on the robot is known.
    pub const WHEELS_RAD: f64 = sensor::WHEELS_DEG.to_radians();
    /// Wheels, where it is not.
    pub const UNMOUNTED_RAD: f64 = sensor::UNMOUNTED_DEG.to_radians();

    /// Standard deviation of a path's scale: what turns a path by an angle stretches it by about as much.
    pub(crate) fn scale_sd(bend_rad: f64) -> f64 {
        sensor::SCALE.hypot(bend_rad)
    }

    /// By how much a path bends, radians: a heading that drifts bends it by about as much as it turns it. Motion capture's does not
    /// drift; its deviation is that of its axes.
    pub(crate) fn bend_rad(heading_sd_rad: f64) -> f64 {
        (heading_sd_rad.powi(2) - MOTION_CAPTURE_RAD.powi(2)).max(0.0).sqrt()
    }
}

/// The task of an estimate: inputs and options.
pub(crate) struct Task<'a> {
    /// The samples at the channel centre.
    pub samples: &'a Samples,
    pub indices: [i8; SUBCARRIERS],
    pub limits: Limits,
    /// Error of the positions from moment to moment, metres.
    pub odometry_sd_m: f64,
    pub heading_sd_rad: f64,
    /// By how much the path bends, radians ([`heading::bend_rad`]).
    pub bend_rad: f64,
    /// Standard deviation of the path's scale.
    pub scale_sd: f64,
    pub effort: Effort,
    pub align: bool,
    pub one_way: bool,
    pub tier: Tier,
    /// Of an array on a robot that drives: where its antennas are.
    pub drive: Option<&'a MovingArray>,
    /// If the likelihood at other times is asked for.
    pub other_times: Option<OtherTimes<'a>>,
}

/// An array on a robot that drives: a sample holds the way to the end of a baseline less the way to its foot. The direction changes
/// along the drive, which tells the range.
#[derive(Clone, Debug)]
pub(crate) struct MovingArray {
    /// Ends and feet of the baselines at each sample, metres from the mean of the ends.
    pub ends_m: Vec<Vector3<f64>>,
    pub feet_m: Vec<Vector3<f64>>,
    /// Ends of the samples that have a phase in common ([`Ways::ends`]).
    pub parts: Vec<usize>,
}

impl MovingArray {
    /// Whether baselines of up to `longest_m` cannot tell the directions from these places apart. The antennas may be up to `more_m`
    /// away from the places, metres.
    pub fn is_short(places_m: &[Vector3<f64>], (longest_m, more_m): (f64, f64), wavelength_m: f64) -> bool {
        let parallax_rad = radius_m(places_m).max(more_m) / NEAREST_M;
        TAU * longest_m * parallax_rad < wavelength_m * SAME_DIRECTION_RAD
    }

    pub fn ways(&self) -> Ways<'_> {
        Ways { points: &self.ends_m, feet: &self.feet_m, ends: &self.parts }
    }

    /// The likelihood over windows and channels.
    fn field(&self, task: &Task<'_>, bins: &Bins, apertures: &[Aperture]) -> Field {
        let [ends, feet] = [&self.ends_m, &self.feet_m].map(|points| bins.points_m(points));
        let arms: Vec<Vector3<f64>> = ends.iter().zip(&feet).map(|(end, foot)| end - foot).collect();
        let parts: Vec<usize> = self.parts.iter().map(|end| end.checked_sub(1).map_or(0, |k| bins.of[k] + 1)).collect();
        let path_m: f64 = arms.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
        let wavelength_m = task.samples.wavelength_m();
        let independent = (2.0 * path_m / wavelength_m).min(bins.len() as f64);
        let ways = Ways { points: &ends, feet: &feet, ends: &parts };
        Field::of_array(ways, apertures.to_vec(), wavelength_m, independent, task.tier)
    }

    /// A path whose length measures how much the samples change, metres: by turns of the baselines, and by the parallax of the drive.
    fn probe_m(&self) -> Vec<Vector3<f64>> {
        let arms = || self.ends_m.iter().zip(&self.feet_m).map(|(end, foot)| (end - foot, foot));
        let by_parallax = arms().map(|(arm, _)| arm.norm()).fold(0.0, f64::max) / NEAREST_M;
        arms().map(|(arm, foot)| arm + foot * by_parallax).collect()
    }
}

impl Task<'_> {
    /// The ways to a motion's points, and the places that it covers.
    fn ways<'b>(&'b self, points: &'b [Vector3<f64>]) -> (Ways<'b>, &'b [Vector3<f64>]) {
        self.drive.map_or((Ways::to(points), points), |drive| (drive.ways(), &drive.ends_m))
    }

    fn odometry(&self) -> mirror::Odometry {
        mirror::Odometry { sd_m: self.odometry_sd_m, bend_rad: self.bend_rad }
    }
}

/// How much is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum Effort {
    /// What the scene needs: one wave, where that leaves nothing but noise, else the posterior over windows and channels.
    #[default]
    Needed,
    /// The same; where the azimuth needs to be right to this only, radians, and that is three degrees or more, on the coarse grid alone.
    Within(f64),
    /// The posterior over windows and channels in every scene.
    Everything,
}

/// Which part of the estimate sufficed, and why.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Sufficient {
    /// One wave at the channel centre, which leaves nothing but noise.
    OneWave(Risk),
    /// The posterior over windows and channels, for this reason.
    Posterior(Reason),
}

/// What leaving the posterior out risked.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Risk {
    /// How far it may have moved the azimuth at most, radians: by a wave as strong as the noise could hide.
    pub risk_rad: f64,
}

/// Why the whole posterior was computed.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Reason {
    /// [`Effort::Everything`].
    Asked,
    /// One log of a robot that drives: the direction changes along the drive.
    Drives,
    /// One wave is not the whole answer.
    Unexplained(Unexplained),
}

impl std::fmt::Display for Reason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Asked => f.write_str("everything was asked for"),
            Self::Drives => f.write_str("the robot drives, so the direction changes along the drive"),
            Self::Unexplained(unexplained) => unexplained.fmt(f),
        }
    }
}

/// The posterior of one link.
#[derive(Clone, Debug)]
pub(crate) struct Found {
    /// The best plane wave at the channel centre.
    pub plane_wave: bartlett::Estimate,
    pub sufficient: Sufficient,
    /// Directions with their probabilities, the most probable first.
    pub modes: Vec<Mode>,
    /// Of the first mode, its mirror among them: its place in `modes`.
    pub mirror: Option<usize>,
    /// Whether the motion distinguishes up from down.
    pub signed: bool,
    pub blur: Blur,
    pub prior: Prior,
    /// Cramer-Rao bound of the azimuth, radians.
    pub bound_rad: f64,
    /// Standard deviation of the sampling-time slopes removed, radians per subcarrier index.
    pub slope_sd_rad: Option<f64>,
    /// The middle of the motion, metres.
    pub middle_m: Vector3<f64>,
    /// Standard deviation of the path's scale.
    pub scale_sd: f64,
    /// `ln` of the likelihood at other times ([`clock::offsets_s`]), if [`Task::other_times`] asked for it and one wave is not the whole answer.
    pub at_other_times: Vec<f64>,
}

impl Found {
    fn centres(&self) -> Vec<f64> {
        let mirror = self.mirror.and_then(|k| self.modes.get(k));
        self.modes.first().into_iter().chain(mirror).map(|mode| mode.place.azimuth).collect()
    }

    /// The 1 / range of the first mode, 1/m; for plane waves the prior's mean.
    pub fn expected_curve(&self) -> f64 {
        let known = self.modes.first().map_or(0.0, |mode| mode.place.curve);
        if self.prior.curve_max > 0.0 { known } else { (1.0 - 1.0 / FARTHEST) / (NEAREST_M * FARTHEST.ln()) }
    }

    /// Half width that holds a share of the probability, radians; where the motion hides a mirror, about the nearer of the
    /// two.
    pub fn half_width_rad(&self, share: f64) -> f64 {
        half_width(&self.modes, &self.blur, &self.centres(), share)
    }

    /// The half width of one deviation without the heading of the whole path, which turns everything seen from it alike.
    pub fn direction_sd_rad(&self) -> f64 {
        half_width(&self.modes, &Blur { heading_rad: 0.0, ..self.blur }, &self.centres(), 0.683)
    }

    /// Probability that the truth is within `half_rad` of the answer.
    pub fn probability_within(&self, half_rad: f64) -> f64 {
        self.modes.first().map_or(0.0, |first| self.probability_about(first.place.azimuth, half_rad))
    }

    /// Probability that the truth is within `half_rad` of an azimuth.
    pub fn probability_about(&self, azimuth_rad: f64, half_rad: f64) -> f64 {
        mass_within(&self.modes, &self.blur, &[azimuth_rad], half_rad)
    }

    /// Probability of the truth being at each azimuth, per radian, with everything that blurs it: `count` of them from 0.
    pub fn density(&self, count: usize) -> Vec<f64> {
        let step = std::f64::consts::TAU / count.max(1) as f64;
        (0..count).map(|k| mass_within(&self.modes, &self.blur, &[k as f64 * step], 0.5 * step) / step).collect()
    }
}

/// How far a motion reaches up and down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reach {
    /// Not enough to distinguish elevations by sign.
    Level,
    /// Perhaps: the heights may be a drift of the odometry's, and only the samples say whether they are.
    Low,
    /// Enough.
    Tall,
}

impl Reach {
    fn of(points: &[Vector3<f64>], turn_m: f64) -> Self {
        let (mut low, mut high) = (Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN));
        for p in points {
            (low, high) = (low.inf(p), high.sup(p));
        }
        let half = 0.5 * (high - low);
        match half.z {
            z if z.is_nan() || z < LEVEL_TURNS * turn_m => Self::Level,
            z if z < TALL * half.x.max(half.y) => Self::Low,
            _ => Self::Tall,
        }
    }
}

/// A motion about its middle, as one model of its heights has it.
struct Model {
    points: Vec<Vector3<f64>>,
    prior: Prior,
    steps: Steps,
    /// Whether it may be along a level line, whose azimuths and elevations are one unknown.
    is_line: bool,
}

impl Model {
    /// The same, with what the odometry's error leaves of its shape.
    fn with_line(self, task: &Task<'_>) -> Self {
        let is_line = !self.prior.is_signed() && mirror::is_line(&self.points, task.odometry());
        Self { is_line, ..self }
    }

    fn new(
        points: &[Vector3<f64>],
        samples: &Samples,
        limits: &Limits,
        drive: Option<&MovingArray>,
        (reach, signed): (Reach, bool),
    ) -> Self {
        let flat = |p: &Vector3<f64>| if signed { *p } else { Vector3::new(p.x, p.y, 0.0) };
        let points: Vec<Vector3<f64>> = points.iter().map(flat).collect();
        let prior = Prior::new(limits, signed);
        // Heights that may be a drift are no evidence of a rare elevation.
        let prior = if reach == Reach::Low { prior.with_expected_elevations() } else { prior };
        let steps = steps(&points, samples, drive, &prior);
        Self { points, prior, steps, is_line: false }
    }
}

/// The density of a search over these points.
fn steps(points: &[Vector3<f64>], samples: &Samples, drive: Option<&MovingArray>, prior: &Prior) -> Steps {
    let path_m: f64 = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let windows = (path_m / tuning::COHERENT_M).ceil().max(1.0) as usize;
    let widest = points.chunks(points.len().div_ceil(windows).max(1)).map(radius_m).fold(0.0, f64::max);
    let tall = points.iter().map(|p| p.z.abs()).fold(0.0, f64::max);
    let steps = Steps::new((radius_m(points), widest, tall), samples.wavelength_m(), samples.path_gain(), prior);
    drive.map_or(steps, |drive| steps.with_parallax(radius_m(&drive.feet_m)))
}

/// The largest distance of points from their mean, metres.
fn radius_m(points: &[Vector3<f64>]) -> f64 {
    let middle = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    points.iter().map(|p| (p - middle).norm()).fold(0.0, f64::max)
}

/// How far a motion reaches from its middle, metres; `points` are about it.
fn farthest_m(points: &[Vector3<f64>]) -> f64 {
    points.iter().map(|p| p.norm()).fold(0.0, f64::max)
}

/// Displacements about their mean, and the mean, metres.
fn about_middle(samples: &Samples) -> (Vec<Vector3<f64>>, Vector3<f64>) {
    let middle_m = samples.displacements_m().fold(Vector3::zeros(), |sum, p| sum + p) / samples.len().max(1) as f64;
    (samples.displacements_m().map(|p| p - middle_m).collect(), middle_m)
}

/// Whether all of a motion can be searched at once.
pub(crate) fn is_searchable(points_m: &[Vector3<f64>], wavelength_m: f64, path_gain: u8, limits: &Limits) -> bool {
    let Ok(samples) = Samples::new(wavelength_m, path_gain) else { return false };
    let reach = Reach::of(points_m, wavelength_m / f64::from(path_gain));
    let model = Model::new(points_m, &samples, limits, None, (reach, reach == Reach::Tall));
    model.steps.are_affordable(Bins::along(&model.points, wavelength_m).len(), &model.prior)
}

/// Estimates the posterior. `rows` gives the round trips of all pairs of the link on all subcarriers, of unit power and in
/// the order of time: those taken at rest say nothing of the direction, but help to find slopes and signs. `used` are the
/// rows of the samples.
///
/// # Errors
/// As [`bartlett::search`].
pub(crate) fn estimate(
    task: &Task<'_>,
    rows: impl FnOnce() -> Vec<Planes>,
    used: &[usize],
) -> Result<Found, bartlett::Error> {
    let samples = task.samples;
    let (points, middle_m) = about_middle(samples);
    let turn_m = samples.wavelength_m() / f64::from(samples.path_gain());
    let reach = Reach::of(&points, turn_m);
    let signs: &[bool] = match reach {
        Reach::Level => &[false],
        Reach::Low => &[false, true],
        Reach::Tall => &[true],
    };
    let models: Vec<Model> = signs
        .iter()
        .map(|&signed| Model::new(&points, samples, &task.limits, task.drive, (reach, signed)).with_line(task))
        .collect();
    let probe = task.drive.map(MovingArray::probe_m);
    let bins = Bins::along(probe.as_ref().unwrap_or(&models[0].points), samples.wavelength_m());
    let means = bins.means(samples, &points);
    let mut searcher = Searcher::new(task.tier);
    let plane_wave = plane_wave(task, &mut searcher, &models, means.as_ref())?;
    let few = means.as_ref().filter(|_| task.drive.is_none()).map(|means| (means, &bins));
    let rests = task.other_times.as_ref().map(|other_times| move || other_times.rests(samples, used, middle_m));
    let at_rest = rests.as_ref().map(|rests| rests as &one_wave::AtRest<'_>);
    let early = |models: &[Model], start| early(task, models, (few, at_rest), start, middle_m);
    let mut reason = match early(&models, (&plane_wave, None)) {
        Ok(found) => return Ok(found),
        Err(reason) => reason,
    };
    // Near or steep, a wave does not show as a plane one at expected elevations.
    let hidden = !matches!(reason, Reason::Asked | Reason::Drives) && plane_wave.coherence.powi(2) < LARGE_SHARE;
    let strongest = models.last().filter(|_| hidden).and_then(|model| strongest(task, model));
    if strongest.is_some() {
        match early(&models, (&plane_wave, strongest)) {
            Ok(found) => return Ok(found),
            Err(Reason::Unexplained(Unexplained::Faint(_))) => {}
            Err(of_strongest) => reason = of_strongest,
        }
    }
    let mut rows = rows();
    let (slope_sd_rad, apertures) = channels(task, &bins, &mut rows, used);
    let gain = apertures.last().map_or(samples.path_gain(), |last| last.path_gain);
    let fine = !matches!(task.effort, Effort::Within(asked) if asked >= COARSE_RAD);
    let mut best: Option<Windowed> = None;
    for model in models {
        let field = field(task, &bins, &model, &apertures);
        let own = Windowed::new(&field, model, fine);
        let wider = own.wider(task, strongest).map(|model| Windowed::new(&field, model, fine));
        // Nearer places than are expected have to be likelier by their prior odds.
        let unexpected = wider.map(|wider| {
            let is_nearer = wider.model.prior.curve_max > own.model.prior.curve_max;
            let odds = if is_nearer { prior::NEARER.ln() } else { 0.0 };
            Windowed { evidence: wider.evidence + odds, ..wider }
        });
        for own in [Some(own), unexpected].into_iter().flatten() {
            if best.as_ref().is_none_or(|best| own.evidence > best.evidence) {
                best = Some(own);
            }
        }
    }
    let Some(Windowed { model, mut modes, .. }) = best else { return Err(bartlett::Error::Empty) };
    // A wave that the plane wave did not lead to.
    let start = modes.first().map(|mode| mode.place);
    if let Ok(found) = early(std::slice::from_ref(&model), (&plane_wave, start)) {
        return Ok(found);
    }
    let bound_rad = modes.first().map_or(f64::INFINITY, |mode| mode.covariance[(0, 0)].max(0.0).sqrt());
    let at_other_times = match (&task.other_times, start) {
        (Some(other_times), Some(place)) => other_times.logs(task, (&rows, gain), &model, (middle_m, place)),
        _ => Vec::new(),
    };
    let mirror = mirror::mix(&mut modes, &model.points, &model.steps, &model.prior, task.odometry());
    widen(&mut modes, &model, task);
    Ok(Found {
        plane_wave,
        sufficient: Sufficient::Posterior(reason),
        signed: model.prior.is_signed() && !mirror.level,
        mirror: mirror.of_first,
        bound_rad,
        modes,
        blur: Blur { heading_rad: task.heading_sd_rad, model_rad: tuning::MODEL_DEG.to_radians() },
        prior: model.prior,
        slope_sd_rad,
        middle_m,
        scale_sd: task.scale_sd,
        at_other_times,
    })
}

/// Widens elevations and ranges by the model's error, as [`Blur`] does azimuths, and by what the sensor gets wrong of the path. Phases
/// that turn the azimuth by an angle pass for a stretch of as much.
fn widen(modes: &mut [Mode], Model { points, prior, is_line, .. }: &Model, task: &Task<'_>) {
    // Half the width that holds 68 % of a Cauchy density, in units of its scale.
    let model_rad = 1.84 * tuning::MODEL_DEG.to_radians();
    let stretch = model_rad.hypot(task.scale_sd);
    for mode in &mut *modes {
        let by_stretch = elevation_by(stretch, &mode.place, points, prior.is_signed());
        mode.covariance[(1, 1)] += model_rad * model_rad + by_stretch * by_stretch;
        if *is_line {
            // What seems to tell the elevation are errors of the path: they count the less, the steeper the place.
            mode.covariance[(1, 1)] = mode.covariance[(1, 1)].max(prior.deviations()[0].powi(2));
        }
    }
    bend(modes, points, model_rad.hypot(task.bend_rad));
}

/// By how much a path that is stretched by `d` changes the elevation `e` of a place, radians. Level motion shows its cosine; an error
/// `d` of a cosine of 1 is `sqrt(2 d)`. Motion with heights `z`, and `a` towards the place, turns it by least squares:
/// `d sin e cos e (a^2 - z^2) / (a^2 sin^2 e + z^2 cos^2 e)` (mean squares).
fn elevation_by(stretch: f64, place: &Place, points: &[Vector3<f64>], signed: bool) -> f64 {
    let (sin, cos) = place.elevation.sin_cos();
    if !signed {
        return stretch / (sin * sin + 2.0 * stretch).sqrt();
    }
    let (sin_a, cos_a) = place.azimuth.sin_cos();
    let sum2 = |of: &dyn Fn(&Vector3<f64>) -> f64| points.iter().map(|p| of(p).powi(2)).sum::<f64>();
    let (along2, high2) = (sum2(&|p| cos_a * p.x + sin_a * p.y), sum2(&|p| p.z));
    let turned =
        stretch * sin * cos * (along2 - high2) / (along2 * sin * sin + high2 * cos * cos).max(f64::MIN_POSITIVE);
    turned.abs().min((2.0 * stretch).sqrt())
}

/// Widens ranges by a bend of the path: what turns the azimuth by an angle `d` across the motion changes 1 / range by
/// `2 d / radius`.
fn bend(modes: &mut [Mode], points: &[Vector3<f64>], bend_rad: f64) {
    let radius_m = farthest_m(points).max(f64::MIN_POSITIVE);
    for mode in modes {
        mode.covariance[(2, 2)] += (2.0 * bend_rad / radius_m).powi(2);
    }
}

/// The likelihood over windows and channels for one model of the heights.
fn field(task: &Task<'_>, bins: &Bins, model: &Model, apertures: &[Aperture]) -> Field {
    let (wavelength_m, gain) = (task.samples.wavelength_m(), f64::from(task.samples.path_gain()));
    if let Some(drive) = task.drive {
        return drive.field(task, bins, apertures);
    }
    let points = bins.points_m(&model.points);
    let path_m: f64 = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    // One sample in half a turn of the round trip is independent of the next.
    let independent = (2.0 * path_m * gain / wavelength_m).min(bins.len() as f64);
    Field::new(&points, apertures.to_vec(), wavelength_m, independent, tuning::WINDOW_LENGTHS, task.tier)
}

/// The posterior over windows for one model.
struct Windowed {
    model: Model,
    /// `ln` of the evidence for the model.
    evidence: f64,
    modes: Vec<Mode>,
}

impl Windowed {
    fn new(field: &Field, model: Model, fine: bool) -> Self {
        if model.is_line && model.prior.elevation_is_open() {
            return Self::along_line(field, model, fine);
        }
        let (evidence, modes) = posterior::modes(field, &model.prior, &model.steps, fine);
        Self { model, evidence, modes }
    }

    /// The same for motion along a level line, which shows no elevation: each elevation has its own azimuths. Errors of the path count
    /// less for a steeper place, so a better fit there is no evidence for it.
    fn along_line(field: &Field, model: Model, fine: bool) -> Self {
        let (mut level, mut modes) = (None, Vec::<Mode>::new());
        // The azimuth of each mode at the last elevation, radians.
        let mut azimuths: Vec<f64> = Vec::new();
        for cell in one_wave::elevations(&model.prior) {
            let prior = model.prior.between([cell.low, cell.high]);
            let (evidence, own) = posterior::modes(field, &prior, &model.steps, fine);
            let evidence = evidence - cell.mass.ln();
            let less = (evidence - *level.get_or_insert(evidence)).min(0.0);
            for mut mode in own {
                mode.scale(cell.mass * less.exp());
                let azimuth = mode.place.azimuth;
                let off = |at: &f64| wrap_rad(at - azimuth).abs();
                let near = azimuths.iter().enumerate().min_by(|a, b| off(a.1).total_cmp(&off(b.1)));
                match near.filter(|(_, at)| off(at) < LINE_STEPS * model.steps.azimuth()).map(|(k, _)| k) {
                    Some(k) => {
                        modes[k].absorb(mode);
                        azimuths[k] = azimuth;
                    }
                    None => {
                        modes.push(mode);
                        azimuths.push(azimuth);
                    }
                }
            }
        }
        posterior::settle(&mut modes);
        Self { model, evidence: level.unwrap_or(f64::MIN), modes }
    }

    /// The model with nearer places, if the nearest place is the best or most of the power comes from nearer, and with steeper ones, if
    /// most comes from there, as far as the limits are the defaults.
    fn wider(&self, task: &Task<'_>, strongest: Option<Place>) -> Option<Model> {
        let Model { points, prior, .. } = &self.model;
        let curve = self.modes.first().map_or(0.0, |mode| mode.place.curve);
        let at_limit = prior.curve_max > 0.0 && curve > 0.9 * prior.curve_max;
        let (ways, reach) = task.ways(points);
        let explains = |place: &Place| ways.explained(task.samples, &prior.at_height(*place)) > LARGE_SHARE;
        let strongest = strongest.filter(explains);
        let is_nearer = at_limit || strongest.is_some_and(|place| place.curve > prior.curve_max);
        // Only heights beyond a drift are evidence of a rare elevation. Errors of a level path count the less, the steeper the place:
        // steep ones always seem to explain more.
        let tall_m = points.iter().map(|p| p.z.abs()).fold(0.0, f64::max);
        let is_steeper = prior.is_signed()
            && tall_m > 2.0 * task.bend_rad * farthest_m(points)
            && strongest.is_some_and(|place| place.elevation.abs() > prior.elevation_rad[1]);
        let mut wider = *prior;
        if is_nearer && task.limits.range_min_m.is_none() {
            let radii = if task.drive.is_some() { INSIDE } else { OUTSIDE };
            wider = wider.with_curve_max(nearest_curve(reach, radii, task.samples.wavelength_m()));
        }
        if is_steeper && task.limits.elevation_max_rad.is_none() {
            wider = wider.with_any_elevation();
        }
        let steps = steps(points, task.samples, task.drive, &wider);
        let is_open = wider != *prior && steps.are_affordable(points.len(), &wider);
        is_open.then(|| Model { points: points.clone(), prior: wider, steps, is_line: self.model.is_line })
    }
}

/// 1 / range of a place as far from the middle as so many radii of the motion, 1/m.
fn nearest_curve(points: &[Vector3<f64>], radii: f64, wavelength_m: f64) -> f64 {
    1.0 / (radii * farthest_m(points)).max(wavelength_m)
}

/// The best plane wave within the expected elevations.
fn plane_wave(
    task: &Task<'_>,
    searcher: &mut Searcher,
    models: &[Model],
    means: Option<&Samples>,
) -> Result<bartlett::Estimate, bartlett::Error> {
    let means = means.map(|samples| Means { samples, lost: signal::MEANS_LOSE });
    searcher.search_with(task.samples, means, highest_expected_rad(task, models), task.odometry_sd_m)
}

/// Largest |elevation| that the plane wave is looked for at first, radians.
fn highest_expected_rad(task: &Task<'_>, models: &[Model]) -> f64 {
    let widest = models.iter().map(|model| model.prior.elevation_rad[1]).fold(0.0, f64::max);
    if task.limits.height_m.is_some() { FRAC_PI_2 } else { widest }
}

/// The place of the strongest wave within the limits of [`free`]; of motion along a level line, at the horizon.
fn strongest(task: &Task<'_>, model: &Model) -> Option<Place> {
    let prior = free(task, model, true);
    let prior = if model.is_line { prior.level() } else { prior };
    let means = Bins::for_start(&model.points, task.samples.wavelength_m()).samples(task.samples, &model.points)?;
    let points: Vec<Vector3<f64>> = means.displacements_m().collect();
    let place = start::anywhere(&means, &points, &prior, task.tier)?;
    Some(one_wave::unwrapped(&means, &points, place, &prior, task.scale_sd))
}

/// The prior of a clean wave front, which shows a near place by itself, and unless motion is along a line a high one: only requested
/// limits apply. `inside` are places that the motion goes around.
fn free(task: &Task<'_>, Model { points, prior, is_line, .. }: &Model, inside: bool) -> Prior {
    let nearest =
        nearest_curve(task.ways(points).1, if inside { INSIDE } else { OUTSIDE }, task.samples.wavelength_m());
    let is_free = task.limits.range_min_m.is_none() && task.limits.near_field;
    let prior = if is_free { prior.with_curve_max(prior.curve_max.max(nearest)) } else { *prior };
    if task.limits.elevation_max_rad.is_none() && !is_line { prior.with_any_elevation() } else { prior }
}

/// The answer of one wave, where that is all there is. With means of the samples, these have to pass the same tests first, which
/// takes less time.
fn early(
    task: &Task<'_>,
    models: &[Model],
    (means, at_rest): (Option<(&Samples, &Bins)>, Option<&one_wave::AtRest<'_>>),
    start: (&bartlett::Estimate, Option<Place>),
    middle_m: Vector3<f64>,
) -> Result<Found, Reason> {
    // A plane wave is no start of it.
    if task.drive.is_some() && start.1.is_none() {
        return Err(Reason::Drives);
    }
    if task.effort == Effort::Everything {
        return Err(Reason::Asked);
    }
    let samples = task.samples;
    let scale_sd = task.scale_sd;
    let false_alarm = one_wave::FALSE_ALARM / if means.is_some() { 2.0 } else { 1.0 };
    let mut failed = Reason::Unexplained(Unexplained::NoPlace);
    let mut found: Vec<(f64, Found)> = Vec::new();
    for model in models {
        let outside = free(task, model, false);
        let is_inside = start.1.is_some_and(|place| place.curve > outside.curve_max);
        let prior = if is_inside { free(task, model, true) } else { outside };
        let checked = means.map_or(Ok(()), |(samples, bins)| {
            let points = bins.points_m(&model.points);
            let heard = Heard { samples, ways: Ways::to(&points), false_alarm, scale_sd, at_rest: None };
            one_wave::alone(heard, start, &prior, &model.steps, task.tier).map(drop)
        });
        let heard = Heard { samples, ways: task.ways(&model.points).0, false_alarm, scale_sd, at_rest };
        let explain = |prior, start| one_wave::explain(heard, start, prior, &model.steps, task.tier);
        match checked.and_then(|()| explain(&prior, start)) {
            Ok(one) => {
                let expected = prior.expected(model.prior.curve_max);
                let odds: f64 = one.modes.iter().map(|mode| expected.log_odds(&mode.place)).sum();
                let nearest = start.1.filter(|_| task.drive.is_some()).map(|place| expected.nearest(place));
                if odds < 0.0
                    && let Ok(one) = explain(&expected, (start.0, nearest))
                {
                    found.push((one.log_likelihood, of_one_wave(task, model, expected, one, start.0, middle_m)));
                }
                found.push((one.log_likelihood + odds, of_one_wave(task, model, prior, one, start.0, middle_m)));
            }
            Err(unexplained) => failed = Reason::Unexplained(unexplained),
        }
    }
    // Two models of the heights, or an expected place and a near or steep one, may both leave noise: then the truth may be either's.
    let weighed = |(log, found): &(f64, Found)| log + found.modes.first().map_or(f64::MIN, |mode| mode.mass.ln());
    found.sort_by(|a, b| weighed(b).total_cmp(&weighed(a)));
    let mut found = found.into_iter();
    let (log, mut best) = found.next().ok_or(failed)?;
    let apart_rad = mirror::apart_rad(&best.modes, &models[0].steps);
    let mirrored = best.mirror.map(|k| [0, k].map(|k| best.modes[k].place.azimuth));
    for (other_log, mut other) in found {
        other.modes.iter_mut().for_each(|mode| mode.scale((other_log - log).exp()));
        posterior::add(&mut best.modes, other.modes, apart_rad);
        posterior::settle(&mut best.modes);
        let is_mirrored = |mode: &Mode| mirrored.is_some_and(|pair| pair.contains(&mode.place.azimuth));
        let others = best.modes.split_first().filter(|(first, _)| is_mirrored(first)).map(|(_, others)| others);
        best.mirror = others.and_then(|others| others.iter().position(is_mirrored)).map(|k| k + 1);
    }
    Ok(best)
}

/// The answer of one wave by one model of the heights.
fn of_one_wave(
    task: &Task<'_>,
    model: &Model,
    prior: Prior,
    one: one_wave::OneWave,
    plane_wave: &bartlett::Estimate,
    middle_m: Vector3<f64>,
) -> Found {
    let mut modes = one.modes;
    let heard = (task.samples, task.ways(&model.points).0);
    let mirror = mirror::of_one_wave(&mut modes, heard, &model.points, &prior, &model.steps, task.odometry());
    bend(&mut modes, &model.points, task.bend_rad);
    Found {
        plane_wave: plane_wave.clone(),
        sufficient: Sufficient::OneWave(Risk { risk_rad: one.risk_rad }),
        signed: prior.is_signed() && !mirror.level,
        mirror: mirror.of_first,
        modes,
        blur: Blur { heading_rad: task.heading_sd_rad, model_rad: 0.0 },
        prior,
        bound_rad: one.bound_rad,
        slope_sd_rad: None,
        middle_m,
        scale_sd: task.scale_sd,
        at_other_times: Vec::new(),
    }
}

/// The channels along the motion, averaged, and the standard deviation of the slopes that were removed.
fn channels(task: &Task<'_>, bins: &Bins, rows: &mut [Planes], used: &[usize]) -> (Option<f64>, Vec<Aperture>) {
    let samples = task.samples;
    let gain = samples.path_gain();
    if rows.is_empty() {
        return (None, vec![Aperture::of_phasors(samples.z(), bins, gain)]);
    }
    let slope_sd_rad = task.align.then(|| {
        remove_slope(rows, &task.indices, task.tier);
        align(rows, &task.indices, task.tier)
    });
    remove_slope(rows, &task.indices, task.tier);
    let silent = Planes::ZERO;
    let own = |rows: &[Planes]| -> Aperture {
        let chosen = used.iter().map(|&k| rows.get(k).unwrap_or(&silent));
        Aperture::of_subcarriers(chosen, bins, gain, task.tier)
    };
    let mut apertures = vec![own(rows)];
    if task.one_way && gain == 2 && is_dense_enough(samples.spacing_m() / samples.wavelength_m()) {
        take_roots(rows, task.tier);
        let chosen = used.iter().map(|&k| rows.get(k).unwrap_or(&silent));
        apertures.push(Aperture::of_subcarriers(chosen, bins, 1, task.tier));
    }
    (slope_sd_rad, apertures)
}
