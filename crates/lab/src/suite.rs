//! Simulates the experiments of Dijkstra et al. (\[paper\] in docs/reference/references.md): stationary robots with a constant
//! and with their sinusoidal carrier offset, circles and lines of three sizes. Each goes through TDMA, bytes, pairing and the
//! estimate.

use crate::Failure;
pub use crate::compare::figures::spread_rad;
use crate::compare::figures::true_path;
use crate::compare::{NO_TRANSMITTER, ONE_ROBOT};
use csi5300::maths::wrap_rad;
use csi5300::pipeline::{Bearing, CaptureReport, Options, Phase, Transmitter, bearings};
use csi5300_sim::motion::{Circle, Line, RobotMotion};
use csi5300_sim::scene::{Cfo, PaperCfo, Scene};
use csi5300_sim::{Port, Room};
use num_complex::Complex64;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Durations of the stationary experiments, seconds (\[paper\], section III-A).
const STATIONARY_S: [f64; 5] = [10.0, 30.0, 60.0, 120.0, 300.0];
/// Radii of the circles, metres; lines are as long as the circles.
const RADII_M: [f64; 3] = [0.1, 0.2, 0.3];
/// Repetitions of each simulated experiment (\[paper\]).
pub const REPETITIONS: u64 = 10;

/// The result of one repetition.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Run {
    /// The experiment.
    pub experiment: String,
    /// Number of the repetition, from 1; the scene's seed.
    pub repetition: u64,
    /// Pairs formed.
    pub pairs: usize,
    /// Bearing to the transmitter from the mean pose, degrees. `None` at rest.
    pub truth_deg: Option<f64>,
    /// The answer, degrees. `None` at rest.
    pub azimuth_deg: Option<f64>,
    /// Its mirror, degrees, if it has one.
    pub mirror_deg: Option<f64>,
    /// Azimuth minus the bearing from the mean pose, degrees; for a line, of its two answers the nearer one. `None` at rest.
    pub error_deg: Option<f64>,
    /// |elevation| of the answer, degrees.
    pub abs_elevation_deg: Option<f64>,
    /// Its elevation with sign, degrees, if the motion distinguishes up from down.
    pub elevation_deg: Option<f64>,
    /// Cramer-Rao bound of the azimuth's standard deviation, degrees.
    pub sd_deg: Option<f64>,
    /// Calibrated probability that the azimuth is within five degrees, if there is one.
    pub confidence: Option<f64>,
    /// The confidence of \[paper\]: the profile's maximum over its sum.
    pub likelihood_share: Option<f64>,
    /// `|sum z a| / sum |z|` of the best plane wave.
    pub coherence: Option<f64>,
    /// Spread of the round trip's phase between packets without the motion's phase, radians, as recorded.
    pub residual_rad: f64,
    /// The same after turn-around compensation.
    pub residual_compensated_rad: f64,
}

/// The scenes of all experiments, in the order of \[paper\]; repetitions differ by seed.
#[must_use]
pub fn experiments() -> Vec<Scene> {
    let Some(base) = Scene::built_in("paper-circle") else { return Vec::new() };
    let mut all = Vec::new();
    for (kind, c1) in [("constant CFO", 0.0), ("sinusoidal CFO", PaperCfo::default().c1)] {
        for duration_s in STATIONARY_S {
            let name = format!("stationary {duration_s} s, {kind}");
            let mut scene = Scene { name, duration_s, ..base.clone() };
            scene.cfo = Cfo::Paper(PaperCfo { c1, ..PaperCfo::default() });
            scene.robot[0].motion = RobotMotion::Static;
            all.push(scene);
        }
    }
    for radius_m in RADII_M {
        let duration_s = base.duration_s;
        let circle = RobotMotion::Circle(Circle { radius_m, duration_s, turns: 1.0, start_s: 0.0 });
        let line = RobotMotion::Line(Line { length_m: TAU * radius_m, duration_s, start_s: 0.0 });
        for (kind, motion) in [("circle", circle), ("line", line)] {
            let mut scene = Scene { name: format!("{kind} {:.0} cm", 100.0 * radius_m), ..base.clone() };
            scene.robot[0].motion = motion;
            all.push(scene);
        }
    }
    all
}

/// Runs every experiment this number of times, on all cores of the current rayon pool; results in order.
///
/// # Errors
/// The first repetition that failed, with its experiment, in words.
pub fn run_all(experiments: &[Scene], repetitions: u64, options: &Options) -> Result<Vec<Run>, String> {
    let jobs: Vec<(&Scene, u64)> =
        experiments.iter().flat_map(|experiment| (1..=repetitions).map(move |k| (experiment, k))).collect();
    let one = |(experiment, k): &(&Scene, u64)| {
        run(experiment, *k, options).map_err(|error| format!("{}, repetition {k}: {error}", experiment.name))
    };
    jobs.par_iter().map(one).collect()
}

/// Runs one repetition.
///
/// # Errors
/// If the scene cannot be simulated or gives no link.
pub fn run(experiment: &Scene, repetition: u64, options: &Options) -> Result<Run, Failure> {
    let scene = Scene { seed: repetition, ..experiment.clone() };
    let mut room = Room::new(&scene)?;
    let path = true_path(&room, 0)?;
    let (mut rx, mut tx) = room.card(0).zip(room.card(1)).ok_or(ONE_ROBOT)?;
    [&mut rx, &mut tx].into_iter().for_each(Port::own_only);
    let transmitters = vec![Transmitter { log: &mut tx, trajectory: None }];
    let report = bearings(&mut rx, transmitters, &path, options)?;
    let found = report.links.first().ok_or(NO_TRANSMITTER)?;
    let link = found.link.as_ref().ok_or("no pairs")?;
    let (turn_around, _) = link.phases(options);
    let turn_around = turn_around.ok_or_else(|| format!("{} pairs are too few to measure a link", link.pairs()))?;
    let mut run = Run {
        experiment: experiment.name.clone(),
        repetition,
        pairs: link.pairs(),
        residual_rad: spread_rad(turn_around.coherence_before),
        residual_compensated_rad: spread_rad(turn_around.coherence_after),
        ..Run::default()
    };
    if scene.robot[0].motion != RobotMotion::Static {
        let bearing = found.bearing.as_ref().map_err(|error| error.to_string())?;
        judge(&mut run, bearing, &room);
    }
    Ok(run)
}

fn judge(run: &mut Run, bearing: &Bearing, room: &Room) {
    let answer = &bearing.answer;
    let truth_rad = room.antenna(1, 0.0).map(|place| {
        let to = place - bearing.mean_position_m;
        to.y.atan2(to.x)
    });
    run.truth_deg = truth_rad.map(f64::to_degrees);
    run.azimuth_deg = Some(answer.azimuth_rad.to_degrees());
    run.mirror_deg = answer.mirror_rad.map(f64::to_degrees);
    let off = |azimuth: f64| truth_rad.map(|truth| wrap_rad(azimuth - truth).to_degrees());
    let answers = [Some(answer.azimuth_rad), answer.mirror_rad];
    let errors = answers.into_iter().flatten().filter_map(off);
    run.error_deg = errors.min_by(|a, b| a.abs().total_cmp(&b.abs()));
    run.abs_elevation_deg = Some(answer.abs_elevation_rad.to_degrees());
    run.elevation_deg = answer.signed_elevation_rad.map(f64::to_degrees);
    run.sd_deg = Some(answer.azimuth_bound_rad.to_degrees());
    run.confidence = Some(answer.probability);
    run.likelihood_share = bearing.likelihood_share;
    run.coherence = Some(bearing.plane_wave.coherence);
}

/// The phase of two stationary robots, which only the radios change, and its spreads between packets: `demo --json`.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Standing {
    /// The phase of every pair.
    #[serde(skip)]
    pub course: Vec<Phase>,
    /// Pairs.
    pub exchanges: usize,
    /// Carrier frequency offset, Hz.
    pub cfo_hz: f64,
    /// Median deviation of the turn-around from its line, microseconds.
    pub turn_around_jitter_us: f64,
    /// Spread of one direction, radians.
    pub phase_one_way_rad: f64,
    /// The same for both directions multiplied.
    pub phase_before_rad: f64,
    /// The same with the turn-around removed.
    pub phase_after_rad: f64,
}

/// The phase of the first link of `report`; one-way phases need [`Options::keep_course`]. `None` without a link, or with too
/// few pairs.
#[must_use]
pub fn standing(report: &CaptureReport, options: &Options) -> Option<Standing> {
    let link = report.links.first()?.link.as_ref()?;
    let (turn_around, course) = link.phases(options);
    let turn_around = turn_around?;
    let one_way: Vec<f64> = course.iter().map(|phase| phase.one_way_rad).collect();
    let turned = |three: &[f64]| Complex64::cis(three[0] - 2.0 * three[1] + three[2]);
    let sum: Complex64 = one_way.windows(3).map(turned).sum();
    let coherence = sum.norm() / one_way.windows(3).len().max(1) as f64;
    Some(Standing {
        exchanges: course.len(),
        cfo_hz: turn_around.df_hz,
        turn_around_jitter_us: turn_around.jitter_median_us,
        phase_one_way_rad: spread_rad(coherence),
        phase_before_rad: spread_rad(turn_around.coherence_before),
        phase_after_rad: spread_rad(turn_around.coherence_after),
        course,
    })
}

/// The repetitions of one experiment.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Summary {
    /// The experiment.
    pub experiment: String,
    /// Its repetitions.
    pub repetitions: usize,
    /// Mean absolute error, degrees. `None` at rest.
    pub mean_error_deg: Option<f64>,
    /// Largest absolute error, degrees.
    pub largest_error_deg: Option<f64>,
    /// Means over the repetitions that have them.
    pub confidence: Option<f64>,
    /// Mean of [`Run::likelihood_share`].
    pub likelihood_share: Option<f64>,
    /// Mean of [`Run::coherence`].
    pub coherence: Option<f64>,
    /// Mean of [`Run::residual_rad`].
    pub residual_rad: f64,
    /// Mean of [`Run::residual_compensated_rad`].
    pub residual_compensated_rad: f64,
}

/// Summarises runs by experiment, in their order.
#[must_use]
pub fn summarise(runs: &[Run]) -> Vec<Summary> {
    runs.chunk_by(|a, b| a.experiment == b.experiment).filter_map(Summary::of).collect()
}

impl Summary {
    fn of(runs: &[Run]) -> Option<Self> {
        let mean = |of: fn(&Run) -> Option<f64>| {
            let values: Vec<f64> = runs.iter().filter_map(of).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        let errors = runs.iter().filter_map(|run| run.error_deg).map(f64::abs);
        Some(Self {
            experiment: runs.first()?.experiment.clone(),
            repetitions: runs.len(),
            mean_error_deg: mean(|run| run.error_deg.map(f64::abs)),
            largest_error_deg: errors.max_by(f64::total_cmp),
            confidence: mean(|run| run.confidence),
            likelihood_share: mean(|run| run.likelihood_share),
            coherence: mean(|run| run.coherence),
            residual_rad: mean(|run| Some(run.residual_rad))?,
            residual_compensated_rad: mean(|run| Some(run.residual_compensated_rad))?,
        })
    }
}
