//! Measures a capture: each robot's log, and the two together.

use super::CompareError;
use super::distribution::{Distribution, QUARTILES};
use super::side::{Observed, SideFigures};
use csi5300::motion::pose::Trajectory;
use csi5300::pipeline::{Bearing, Phase};
use csi5300::pipeline::{CaptureReport, Options, Transmitter, bearings};
use csi5300::source::CsiSource;
use csi5300_sim::motion::RobotMotion;
use csi5300_sim::{Port, Room, Scene};
use std::f64::consts::TAU;

/// Figures of a capture of one link.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Figures {
    /// The log of the robot that moved: backward frames.
    pub receiver: SideFigures,
    /// The other robot's log: forward frames.
    pub transmitter: SideFigures,
    /// Figures of both logs together.
    pub link: LinkFigures,
}

/// Figures of two logs together.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct LinkFigures {
    /// Pairs formed.
    pub pairs: usize,
    /// Carrier frequency offset, Hz.
    pub df_hz: f64,
    /// Drift of the transmitter's card clock against the receiver's, parts per million.
    pub drift_ppm: f64,
    /// Host clock of the transmitter minus the receiver's, median over the pairs, seconds; `None` without host times.
    pub host_apart_s: Option<f64>,
    /// Turn-around minus its median and drift, microseconds: the lateness of an answer.
    pub turn_around_us: Distribution,
    /// Standard deviation of the turn-arounds within [`CORE_US`] of the median, from their quartiles.
    pub core_us: f64,
    /// The other turn-arounds: early (by up to [`FAR_US`]), earlier, late.
    pub groups: [LateGroup; 3],
    /// Mean run length of answers outside the core; `None` if pairs in between were skipped.
    pub run: Option<f64>,
    /// Spread of the round trip's phase from packet to packet before turn-around compensation, radians: the circular
    /// standard deviation of its second difference over sqrt(6), so that motion does not count.
    pub spread_before_rad: f64,
    /// The same after compensation.
    pub spread_after_rad: f64,
    /// `|sum z a| / sum |z|` of the best-fitting plane wave, all pairs in motion; `None` without motion.
    pub coherence: Option<f64>,
    /// Mean coherence within windows of a second, which a curved wave front does not lower; `None` without motion.
    pub short_coherence: Option<f64>,
    /// Azimuth of the transmitter, degrees.
    pub azimuth_deg: Option<f64>,
    /// |elevation| of the bearing, degrees.
    pub abs_elevation_deg: Option<f64>,
    /// Its elevation with its sign, degrees, where the motion distinguishes up from down.
    pub elevation_deg: Option<f64>,
    /// Horizontal distance of the transmitter, metres, if the curvature shows it.
    pub range_m: Option<f64>,
    /// Estimated place of the transmitter, metres, trajectory's frame.
    pub place_m: Option<[f64; 3]>,
    /// The phase of every pair, for pictures.
    #[serde(skip)]
    pub course: Vec<Phase>,
    /// Turn-around minus median and drift of each pair, for pictures.
    #[serde(skip)]
    pub late_us: Vec<f64>,
}

/// Turn-arounds outside the core, or frames sent late.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct LateGroup {
    /// Share of all.
    pub share: f64,
    /// Mean lateness relative to the core, microseconds.
    pub mean_us: f64,
    /// Standard deviation, microseconds.
    pub sd_us: f64,
}

impl LinkFigures {
    /// Share of the turn-arounds outside the core.
    #[must_use]
    pub fn away(&self) -> f64 {
        self.groups.iter().map(|group| group.share).sum()
    }
}

/// Answers further than this from the usual turn-around are outside its core, microseconds.
///
/// Measured: 18,320 answers in the six real captures of \[paper\] (docs/reference/references.md), minus the running median of
/// 121, in steps of 10 us. The histogram peaks at 8,802 from 0 to 10 us and falls to less than a hundredth of that at 30 us on
/// either side. It is lowest (16 to 20 a step) from 40 to 60 us early. Half of each core is within 2 to 4 us.
pub const CORE_US: f64 = 25.0;
/// Answers earlier than this form a group of their own, microseconds.
///
/// From the same histogram: the early answers peak at 130 us (720 a step) and at 210 to 220 us (95); the lowest step in between
/// starts here (78).
pub const FAR_US: f64 = 160.0;
/// Answers and frames later than this are outliers, microseconds: the same histogram is empty beyond 310 us early and beyond
/// 200 us late, except for four answers 1,140 to 1,490 us late.
pub(super) const LOST_US: f64 = 400.0;
/// Assumed range if the curvature shows none, metres.
const USUAL_RANGE_M: f64 = 4.0;
/// Windows of the short coherence, seconds.
const WINDOW_S: f64 = 1.0;
/// Rows per second of a simulated trajectory.
const TRUTH_HZ: f64 = 180.0;

/// Measures a capture; `trajectory` is the receiver's, `displaced` the transmitter's if it moved.
///
/// # Errors
/// If a log cannot be read, or the two have no frame in common.
pub fn measure(
    receiver: &mut (dyn CsiSource + Send),
    transmitter: &mut (dyn CsiSource + Send),
    trajectory: &Trajectory,
    displaced: Option<&Trajectory>,
    options: &Options,
) -> Result<Figures, CompareError> {
    let indices = options.channel.subcarriers();
    let (mut rx, mut tx) = (Observed::new(receiver, indices), Observed::new(transmitter, indices));
    let options = options.clone().with_keep_course(true);
    let transmitters = vec![Transmitter { log: &mut tx, trajectory: displaced }];
    let report = bearings(&mut rx, transmitters, trajectory, &options)?;
    // Either log may contain other senders' frames; the link's sender has the most, as in the pipeline.
    let sender = report.links.first().and_then(|found| found.link.as_ref()).map(|link| link.mac);
    let (receiver, transmitter) = (rx.finish(sender), tx.finish(options.rx_mac));
    let link = link_figures(&report, &options)?;
    Ok(Figures { receiver, transmitter, link })
}

/// Simulates a scene in memory and measures the logs of its first initiator and the next robot along the initiator's true
/// path.
///
/// # Errors
/// As [`measure`], and if the scene cannot be simulated.
pub fn measure_scene(scene: &Scene, options: &Options) -> Result<Figures, CompareError> {
    simulated(scene, None, options)
}

/// As [`measure_scene`], with a sensor's trajectory instead of the true path.
///
/// # Errors
/// As [`measure_scene`].
pub fn measure_scene_along(scene: &Scene, trajectory: &Trajectory, options: &Options) -> Result<Figures, CompareError> {
    simulated(scene, Some(trajectory), options)
}

fn simulated(scene: &Scene, trajectory: Option<&Trajectory>, options: &Options) -> Result<Figures, CompareError> {
    let mut room = Room::new(scene)?;
    let receiver = scene.initiators().first().copied().unwrap_or(0);
    let other = usize::from(receiver == 0);
    let trajectory = match trajectory {
        Some(trajectory) => trajectory.clone(),
        None => true_path(&room, receiver)?,
    };
    let (Some(mut rx), Some(mut tx)) = (room.card(receiver), room.card(other)) else {
        return Err(CompareError::OneRobot);
    };
    [&mut rx, &mut tx].into_iter().for_each(Port::own_only);
    let moves = scene.robot.get(other).is_some_and(|robot| robot.motion != RobotMotion::Static);
    let displaced = moves.then(|| true_path(&room, other)).transpose()?;
    measure(&mut rx, &mut tx, &trajectory, displaced.as_ref(), options)
}

/// The true path of a robot's antenna A on its host's clock.
///
/// # Errors
/// If the scene is too short for two poses.
pub fn true_path(room: &Room, robot: usize) -> Result<Trajectory, CompareError> {
    room.true_path(robot, TRUTH_HZ).ok_or_else(|| CompareError::Short { duration_s: room.scene().duration_s })
}

fn link_figures(report: &CaptureReport, options: &Options) -> Result<LinkFigures, CompareError> {
    let found = report.links.first().ok_or(CompareError::NoTransmitter)?;
    let link = found.link.as_ref().ok_or_else(|| {
        let reason = match &found.bearing {
            Err(error) => error.to_string(),
            Ok(_) => "the logs have nothing in common".into(),
        };
        CompareError::NoLink { reason }
    })?;
    let (turn_around, course) = link.phases(options);
    let turn = turn_around.ok_or(CompareError::FewPairs { pairs: course.len() })?;
    let mut figures = LinkFigures {
        pairs: link.pairs(),
        df_hz: turn.df_hz,
        drift_ppm: turn.drift_ppm,
        host_apart_s: link.partner_ahead_s(),
        late_us: turn.jitter_us.iter().map(|d| -d).collect(),
        spread_before_rad: spread_rad(turn.coherence_before),
        spread_after_rad: spread_rad(turn.coherence_after),
        ..LinkFigures::default()
    };
    turn_arounds(&mut figures);
    figures.run = figures.run.filter(|_| link.thinned() == 0);
    if let Ok(bearing) = &found.bearing {
        place(&mut figures, bearing);
    }
    figures.course = course;
    Ok(figures)
}

/// The circular standard deviation of one phase, from the coherence of second differences, whose variance is six times as
/// large.
#[must_use]
pub fn spread_rad(coherence: f64) -> f64 {
    (-2.0 * coherence.max(1e-12).ln() / 6.0).max(0.0).sqrt()
}

fn turn_arounds(figures: &mut LinkFigures) {
    figures.turn_around_us = Distribution::of(&figures.late_us);
    let middle_us = figures.turn_around_us.median;
    let within = |low: f64, high: f64| -> Vec<f64> {
        figures.late_us.iter().map(|late| late - middle_us).filter(|late| (low..high).contains(late)).collect()
    };
    figures.core_us = Distribution::of(&within(-CORE_US, CORE_US)).quartile_range() / QUARTILES;
    let group = |low: f64, high: f64| {
        let values = within(low, high);
        let d = Distribution::of(&values);
        LateGroup { share: values.len() as f64 / figures.late_us.len().max(1) as f64, mean_us: d.mean, sd_us: d.sd }
    };
    figures.groups = [group(-FAR_US, -CORE_US), group(-LOST_US, -FAR_US), group(CORE_US, LOST_US)];
    let away = |late: &f64| (late - middle_us).abs() > CORE_US;
    let runs: Vec<f64> = figures
        .late_us
        .chunk_by(|a, b| away(a) == away(b))
        .filter(|run| run.first().is_some_and(away))
        .map(|run| run.len() as f64)
        .collect();
    figures.run = Some(Distribution::of(&runs).mean);
}

fn place(figures: &mut LinkFigures, bearing: &Bearing) {
    let answer = &bearing.answer;
    figures.coherence = Some(bearing.plane_wave.coherence);
    figures.azimuth_deg = Some(answer.azimuth_rad.to_degrees());
    figures.abs_elevation_deg = Some(answer.abs_elevation_rad.to_degrees());
    figures.elevation_deg = answer.signed_elevation_rad.map(f64::to_degrees);
    let range = answer.range.map(|range| range.range_m);
    figures.range_m = range;
    let (sin, cos) = answer.azimuth_rad.sin_cos();
    let away_m = range.unwrap_or(USUAL_RANGE_M);
    let middle = bearing.mean_position_m;
    let (up, level) = answer.signed_elevation_rad.unwrap_or(0.0).sin_cos();
    let (away_m, height_m) = (away_m * level, away_m * up);
    figures.place_m = Some([middle.x + away_m * cos, middle.y + away_m * sin, middle.z + height_m]);
    figures.short_coherence = short_coherence(bearing);
}

/// Mean over windows of the coherence with a plane wave from the answer's direction.
fn short_coherence(bearing: &Bearing) -> Option<f64> {
    let level = bearing.answer.abs_elevation_rad.cos();
    let up = bearing.answer.signed_elevation_rad.map_or(0.0, f64::sin);
    let (sin, cos) = bearing.answer.azimuth_rad.sin_cos();
    let samples = &bearing.samples;
    let displaced = samples.receiver_m().iter().zip(samples.transmitter_m()).map(|(rx, tx)| rx - tx);
    let turned = samples.z().iter().zip(displaced).map(|(z, p)| {
        let turns = 2.0 * (level * (p.x * cos + p.y * sin) + up * p.z) / samples.wavelength_m();
        z * num_complex::Complex64::cis(-TAU * turns)
    });
    let turned: Vec<_> = turned.collect();
    let windows = samples.t_s().chunk_by(|a, b| (a / WINDOW_S).floor() == (b / WINDOW_S).floor());
    let (mut at, mut sum, mut count) = (0, 0.0, 0.0);
    for window in windows {
        let part = &turned[at..at + window.len()];
        at += window.len();
        // A window that the motion only touches is not representative.
        if part.len() >= 8 {
            sum += part.iter().sum::<num_complex::Complex64>().norm() / part.iter().map(|z| z.norm()).sum::<f64>();
            count += 1.0;
        }
    }
    (count > 0.0).then(|| sum / count)
}
