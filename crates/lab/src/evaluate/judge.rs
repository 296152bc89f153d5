//! Evaluates one capture: estimates its links and compares them with the truth.

use super::captures::{Capture, TRUTH_FILE, TrajectorySource, Truth};
use super::quality::horizontal;
use crate::{Failure, wrap_deg};
use csi5300::maths::wrap_rad;
use csi5300::motion::odometry::csv::{self, CsvError};
use csi5300::motion::pose::{Pose, Trajectory, TrajectoryError};
use csi5300::pipeline::{Answer, Bearing, CaptureReport, LinkReport, Options, Transmitter, bearings, lost_something};
use csi5300::signal::channel::Channel;
use csi5300::source::replay::Replay;
use csi5300::source::survey::Survey;
use nalgebra::{Matrix2, Rotation3, Vector2, Vector3};
use serde::Serialize;
use std::io::Read;
use std::path::{Path, PathBuf};

/// A link's answer and truth: a row of `evaluate --json`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Judged {
    /// The answer.
    #[serde(flatten)]
    pub answer: Answer,
    /// Bearing from the first pose of the motion, degrees.
    pub true_from_start_deg: Option<f64>,
    /// Bearing from the mean pose of the used pairs, degrees: the reference for a far-field estimator.
    pub true_from_mean_pose_deg: Option<f64>,
    /// Estimate minus truth, wrapped, degrees.
    pub error_from_start_deg: Option<f64>,
    /// Estimate minus truth, wrapped, degrees.
    pub error_from_mean_pose_deg: Option<f64>,
    /// Horizontal distance from the mean pose to the transmitter, metres.
    pub true_range_m: Option<f64>,
    /// Reported horizontal range minus the true one, metres.
    pub range_error_m: Option<f64>,
    /// Place of the transmitter, metres; for a moving one, the mean of its places over the used pairs.
    pub true_transmitter_m: Option<[f64; 2]>,
    /// Height of the transmitter, metres, if given; no truth file contains it.
    #[serde(skip)]
    pub transmitter_z_m: Option<f64>,
    /// Mean time of the pairs used, seconds on the trajectory's clock.
    #[serde(skip)]
    pub middle_t_s: Option<f64>,
    /// Standard deviation of the heading of the whole trajectory, radians.
    #[serde(skip)]
    pub heading_sd_rad: Option<f64>,
    /// Horizontal distance between the reported position and the transmitter's at that time, metres.
    pub position_error_m: Option<f64>,
    /// The same in deviations of the reported ellipse: 68 % of true places are within 1.52, 95 % within 2.48.
    pub position_error_sd: Option<f64>,
    /// Mean pose of the used pairs, metres, from motion capture; of a told place without it, from the trajectory used.
    pub true_receiver_m: Option<[f64; 2]>,
}

impl Judged {
    /// The set: the first part of the link's name.
    #[must_use]
    pub fn set(&self) -> &str {
        self.answer.link.split('/').next().unwrap_or_default()
    }

    /// The transmitter's name: the last part of the link's.
    #[must_use]
    pub fn transmitter(&self) -> &str {
        self.answer.link.rsplit('/').next().unwrap_or_default()
    }
}

/// The result of a capture's evaluation.
pub struct Evaluated {
    /// One row per transmitter, or a single one if the capture could not be read.
    pub rows: Vec<Judged>,
    /// True if records were lost before a log's tail or a link failed.
    pub lost: bool,
    /// Losses, one line each, with the file's name.
    pub notes: Vec<String>,
}

/// Receives each link's bearing with its name and options.
pub type Look<'a> = dyn FnMut(&str, &Bearing, &Options) + 'a;

impl Capture {
    /// Estimates every link and compares it with the truth. A link that cannot be read becomes a row with its error.
    #[must_use]
    pub fn evaluate(&self, source: TrajectorySource, channel: Option<Channel>, options: &Options) -> Evaluated {
        self.evaluate_and(source, channel, options, &mut |_, _, _| {})
    }

    /// The same, passing each link's bearing to `look`, for pictures.
    #[must_use]
    pub fn evaluate_and(
        &self,
        source: TrajectorySource,
        channel: Option<Channel>,
        options: &Options,
        look: &mut Look<'_>,
    ) -> Evaluated {
        self.try_evaluate(source, channel, options, look).unwrap_or_else(|error| {
            let row = |name: &str| Judged {
                answer: Answer::failed(self.link_name(name), error.to_string()),
                ..Judged::default()
            };
            let rows = match self.transmitters.as_slice() {
                [] => vec![row("")],
                some => some.iter().map(|(name, _)| row(name)).collect(),
            };
            Evaluated { rows, lost: true, notes: Vec::new() }
        })
    }

    fn try_evaluate(
        &self,
        source: TrajectorySource,
        channel: Option<Channel>,
        options: &Options,
        look: &mut Look<'_>,
    ) -> Result<Evaluated, Failure> {
        let truth = if self.has_truth() { Truth::read(&self.folder)? } else { Truth::default() };
        let mut notes = Vec::new();
        let channel = match (channel, truth.channel(&self.folder)) {
            (Some(asked), own) => {
                // Either half of a channel of 40 MHz may be named.
                let is_other = |own: &Channel| (own.centre_hz() - asked.centre_hz()).abs() > 15e6;
                let own = own.ok().flatten().filter(is_other);
                let file = self.folder.join(TRUTH_FILE);
                notes.extend(own.map(|own| format!("{} names channel {own}, not {asked}", file.display())));
                asked
            }
            (None, own) => {
                own?.ok_or_else(|| format!("unknown WiFi channel: no {TRUTH_FILE} names it; use --channel"))?
            }
        };
        if self.transmitters.is_empty() {
            let stamp = &self.stamp;
            return Err(format!("no csi_txK_{stamp}.dat beside csi_rx_{stamp}.dat").into());
        }
        let trajectory = self.trajectory(source, &mut notes)?;
        let reference = match source {
            TrajectorySource::GroundTruth => Some(trajectory.clone()),
            _ => self.trajectory(TrajectorySource::GroundTruth, &mut notes).ok(),
        };
        let heading_sd_rad = options.heading_sd_rad.unwrap_or(self.heading_sd_rad(source));
        let mut options = Options { heading_sd_rad: Some(heading_sd_rad), ..options.clone() };
        options.channel = channel;
        let moved = self.moved(source, &mut notes)?;
        let part = self.within_s.map(|(from_s, to_s)| trajectory.within(from_s, to_s)).transpose()?;
        let (report, failed) = self.estimate(part.as_ref().unwrap_or(&trajectory), &moved, &options)?;
        let fit = report.links.iter().find_map(|link| link.bearing.as_ref().ok()?.odometry_fit.as_ref());
        let fit = fit.filter(|fit| fit.refused.is_none());
        let heading_sd_rad = fit.map_or(heading_sd_rad, |fit| fit.heading_sd_rad(heading_sd_rad));
        let rx_path = self.receiver_log();
        let contradiction = report.contradiction(std::iter::once(&trajectory).chain(moved.iter().flatten()), &options);
        notes.extend(contradiction.map(|words| format!("{}: {words}", rx_path.display())));
        notes.extend(report.clock_doubt().map(|doubt| format!("{}: {doubt}", rx_path.display())));
        let paths = match source {
            TrajectorySource::GroundTruth => moved,
            _ => self.moved(TrajectorySource::GroundTruth, &mut Vec::new())?,
        };
        for ((name, _), link) in self.transmitters.iter().zip(&report.links) {
            if let Ok(bearing) = &link.bearing {
                look(&self.link_name(name), bearing, &options);
            }
        }
        let judged = |((name, path), link): ((&str, &Option<Trajectory>), &LinkReport)| {
            let answer = Answer::new(self.link_name(name), link);
            let times_s = link.bearing.as_ref().map(|bearing| bearing.samples.t_s()).unwrap_or_default();
            let told = self.told.get(name).map(|place_m| Vector2::from(*place_m));
            let path = path.as_ref().filter(|_| told.is_none());
            let reference = reference.as_ref().or(told.and(Some(&trajectory)));
            let judged =
                judge(answer, &TruePlace { still_m: told.or_else(|| truth.place(name)), path }, reference, times_s);
            Judged { heading_sd_rad: Some(heading_sd_rad), ..judged }
        };
        let names = self.transmitters.iter().map(|(name, _)| name.as_str());
        let mut rows: Vec<Judged> = names.zip(&paths).zip(&report.links).map(judged).collect();
        for (row, error) in rows.iter_mut().zip(failed) {
            if let Some(error) = error {
                row.answer = Answer::failed(row.answer.link.clone(), error.to_string());
            }
        }
        let paths = std::iter::once(&rx_path).chain(self.transmitters.iter().map(|(_, path)| path));
        notes.extend(rows.iter().filter_map(far));
        // Up to here these are losses of trajectories, or doubts about them and the truth.
        let rows_lost = !notes.is_empty();
        let surveys = std::iter::once(&report.receiver).chain(&report.transmitters).map(|log| &log.survey);
        notes.extend(paths.zip(surveys).filter_map(|(path, survey)| loss_note(path, survey)));
        Ok(Evaluated { rows, lost: rows_lost || lost_something(&report), notes })
    }

    /// The trajectories of moving transmitters: from `source`, or from motion capture if the capture has no other.
    fn moved(&self, source: TrajectorySource, notes: &mut Vec<String>) -> Result<Vec<Option<Trajectory>>, Failure> {
        let file = |name: &str| {
            let names = [source, TrajectorySource::GroundTruth].map(|source| self.trajectory_of(source, name));
            names.into_iter().find(|path| path.is_file())
        };
        let read = |(name, _): &(String, PathBuf)| file(name).map(|path| read_path(path, notes)).transpose();
        self.transmitters.iter().map(read).collect()
    }

    /// The antenna's trajectory by `source`.
    pub(super) fn trajectory(&self, source: TrajectorySource, notes: &mut Vec<String>) -> Result<Trajectory, Failure> {
        let recorded = read_path(self.trajectory_of(source, "rx"), notes)?;
        self.of_antenna(source, recorded).map_err(Failure::from)
    }

    /// The bearings of all links, and the errors of transmitters' logs that could not be opened: each costs only its own link.
    fn estimate(
        &self,
        trajectory: &Trajectory,
        moved: &[Option<Trajectory>],
        options: &Options,
    ) -> Result<(CaptureReport, Vec<Option<csi5300::source::Error>>), Failure> {
        let mut receiver = Replay::open(&self.receiver_log())?;
        let nothing = || Replay::new(Box::new(std::io::empty()) as Box<dyn Read + Send>, String::new());
        let opened = self.transmitters.iter().map(|(_, path)| match Replay::open(path) {
            Ok(log) => (log, None),
            Err(error) => (nothing(), Some(error)),
        });
        let (mut logs, failed): (Vec<_>, Vec<_>) = opened.unzip();
        let transmitters =
            logs.iter_mut().zip(moved).map(|(log, path)| Transmitter { log, trajectory: path.as_ref() }).collect();
        Ok((bearings(&mut receiver, transmitters, trajectory, options)?, failed))
    }
}

/// Reads a trajectory and notes its losses.
fn read_path(path: PathBuf, notes: &mut Vec<String>) -> Result<Trajectory, Failure> {
    let (trajectory, counts) = csv::read(&path, None).map_err(|error| match error {
        // An operating system's error names the file.
        CsvError::Io { .. } => error.to_string(),
        _ => format!("{}: {error}", path.display()),
    })?;
    if counts.lost_something(&trajectory) {
        notes.extend(counts.notes(&trajectory).into_iter().map(|words| format!("{}: {words}", path.display())));
    }
    Ok(trajectory)
}

/// A line about a log's losses before its tail, or `None`.
fn loss_note(path: &Path, survey: &Survey) -> Option<String> {
    let first = survey.losses.first().map(|loss| format!("; the first at offset {}: {}", loss.offset, loss.reason));
    let (damages, bytes, bad) = (survey.damages, survey.damaged_bytes, survey.bad_bfee);
    survey.lost_something().then(|| {
        let first = first.unwrap_or_default();
        format!("{}: {damages} damaged stretches ({bytes} bytes), {bad} impossible records{first}", path.display())
    })
}

/// Largest distance of a transmitter without a doubt, metres: beyond the reach of a card, or millimetres of a room.
const FURTHEST_M: f64 = 1_000.0;

/// A line about a truth that no frame comes from, or `None`.
fn far(row: &Judged) -> Option<String> {
    let (link, km) = (&row.answer.link, row.true_range_m.filter(|range_m| *range_m > FURTHEST_M)? / 1_000.0);
    Some(format!("{link}: its true place is {km:.1} km from the receiver: is it in metres, in the trajectory's frame?"))
}

/// A transmitter's true place.
struct TruePlace<'a> {
    /// At the start, metres.
    still_m: Option<Vector2<f64>>,
    /// Its trajectory from there on, if it moved.
    path: Option<&'a Trajectory>,
}

impl TruePlace<'_> {
    fn at(&self, t_s: f64) -> Option<Vector2<f64>> {
        self.path.map_or(self.still_m, |path| path.at(t_s).map(|pose| pose.position_m.xy()))
    }

    fn mean(&self, times_s: &[f64]) -> Option<Vector2<f64>> {
        if self.path.is_none() {
            return self.still_m;
        }
        let places: Vec<Vector2<f64>> = times_s.iter().filter_map(|&t_s| self.at(t_s)).collect();
        (!places.is_empty()).then(|| places.iter().sum::<Vector2<f64>>() / places.len() as f64)
    }
}

/// The origin of the reference's frame may differ from that of the bearing's.
fn judge(answer: Answer, transmitter: &TruePlace<'_>, reference: Option<&Trajectory>, times_s: &[f64]) -> Judged {
    let start = reference.and_then(|path| path.at(path.motion().window_s.map_or(path.span_s().0, |(from, _)| from)));
    let position = transmitter.mean(times_s);
    let bearing_from =
        |from: Vector3<f64>, to: Option<Vector2<f64>>| to.map(|p| (p.y - from.y).atan2(p.x - from.x).to_degrees());
    let mean = reference.and_then(|path| {
        let seen: Vec<_> = times_s.iter().filter_map(|&t| path.at(t)).collect();
        let sum = seen.iter().fold(Vector3::zeros(), |sum, pose| sum + pose.position_m);
        (!seen.is_empty()).then(|| sum / seen.len() as f64)
    });
    let origin_m =
        mean.zip(answer.origin_m).map_or(Vector2::zeros(), |(there, here)| (there - Vector3::from(here)).xy());
    let true_from_start_deg = start.and_then(|pose| bearing_from(pose.position_m, transmitter.at(pose.t_s)));
    let true_from_mean_pose_deg = mean.and_then(|mean| bearing_from(mean, position));
    let reported = answer.position_m.zip(answer.position_t_s.and_then(|t_s| transmitter.at(t_s)));
    let off = reported.map(|([x, y, _], truth)| Vector2::new(x, y) + origin_m - truth);
    let error = |truth: Option<f64>| Some(wrap_deg(answer.azimuth_deg? - truth?));
    let true_range_m = position.zip(mean).map(|(p, from)| (p.x - from.x).hypot(p.y - from.y));
    Judged {
        true_range_m,
        range_error_m: answer.range_m.zip(true_range_m).map(|(range, truth)| range * horizontal(&answer) - truth),
        true_transmitter_m: position.map(|p| [p.x, p.y]),
        transmitter_z_m: None,
        middle_t_s: (!times_s.is_empty()).then(|| times_s.iter().sum::<f64>() / times_s.len() as f64),
        heading_sd_rad: None,
        position_error_sd: off.zip(answer.position_covariance_m2).and_then(|(off, c)| {
            let inverse = Matrix2::new(c[0][0], c[0][1], c[1][0], c[1][1]).try_inverse()?;
            Some(off.dot(&(inverse * off)).max(0.0).sqrt())
        }),
        position_error_m: off.map(|off| off.norm()),
        true_receiver_m: mean.map(|mean| [mean.x, mean.y]),
        error_from_start_deg: error(true_from_start_deg),
        error_from_mean_pose_deg: error(true_from_mean_pose_deg),
        true_from_start_deg,
        true_from_mean_pose_deg,
        answer,
    }
}

/// A link with an answer, for tests.
#[cfg(test)]
pub(super) fn row(link: &str, azimuth_deg: f64, error_deg: f64, confidence: f64) -> Judged {
    let mut answer = Answer::failed(link.into(), String::new());
    (answer.error, answer.azimuth_deg, answer.confidence) = (None, Some(azimuth_deg), Some(confidence));
    Judged { answer, error_from_mean_pose_deg: Some(error_deg), ..Judged::default() }
}

impl Capture {
    /// The antenna's trajectory from the one recorded by `source`.
    fn of_antenna(&self, source: TrajectorySource, recorded: Trajectory) -> Result<Trajectory, TrajectoryError> {
        if source == TrajectorySource::GroundTruth {
            return Ok(recorded);
        }
        let rolls = source == TrajectorySource::RollingT265;
        let camera = rolls.then(|| self.camera.unwrap_or_default());
        self.turned(source, recorded)?.of_antenna(camera, self.antenna_offset_m.map(Vector3::from))
    }

    /// Unless they are reset, wheels continue from the previous run's heading. Their trajectory is rotated to the heading that
    /// motion capture, or else the tracking camera, has at the same time at the start.
    fn turned(&self, source: TrajectorySource, recorded: Trajectory) -> Result<Trajectory, TrajectoryError> {
        if source != TrajectorySource::Odometry {
            return Ok(recorded);
        }
        let mut others = [TrajectorySource::GroundTruth, TrajectorySource::T265].into_iter();
        let turn_rad = others.find_map(|other| {
            let other = csv::read(&self.trajectory_of(other, "rx"), None).ok()?.0;
            heading_between_rad(&recorded, &other)
        });
        turn_rad.map_or(Ok(recorded.clone()), |turn_rad| turned_by(&recorded, turn_rad))
    }
}

/// The heading of `to` minus that of `from` at the first common time, radians.
fn heading_between_rad(from: &Trajectory, to: &Trajectory) -> Option<f64> {
    let t_s = from.span_s().0.max(to.span_s().0);
    Some(wrap_rad(to.at(t_s)?.heading_rad? - from.at(t_s)?.heading_rad?))
}

/// A trajectory rotated about its first position.
fn turned_by(trajectory: &Trajectory, turn_rad: f64) -> Result<Trajectory, TrajectoryError> {
    let first = trajectory.poses().first().map_or(Vector3::zeros(), |pose| pose.position_m);
    let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), turn_rad);
    let turned = |pose: &Pose| Pose {
        t_s: pose.t_s,
        position_m: first + rotation * (pose.position_m - first),
        heading_rad: pose.heading_rad.map(|heading| wrap_rad(heading + turn_rad)),
    };
    Trajectory::new(trajectory.poses().iter().map(turned).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot on an arc of 0.15 m with its heading along it, starting at `heading_rad`.
    fn wheels(heading_rad: f64) -> Trajectory {
        let pose = |k: usize| {
            let heading = heading_rad - 0.01 * (k.clamp(50, 350) as f64 - 50.0);
            let place = Vector3::new(-heading.sin(), heading.cos(), 0.0) * 0.15;
            Pose { t_s: 0.05 * k as f64, position_m: place, heading_rad: Some(wrap_rad(heading)) }
        };
        Trajectory::new((0..400).map(pose).collect()).unwrap()
    }

    #[test]
    fn unreset_wheels_are_rotated_to_another_sensors_heading() {
        let (zeroed, going_on) = (wheels(0.0), wheels(-0.25));
        let turn_rad = heading_between_rad(&going_on, &zeroed).unwrap();
        assert!((turn_rad - 0.25).abs() < 1e-9, "{turn_rad}");
        let turned = turned_by(&going_on, turn_rad).unwrap();
        let moved = |trajectory: &Trajectory, k: usize| {
            let poses = trajectory.poses();
            poses[k].position_m - poses[0].position_m
        };
        for k in 0..400 {
            assert!((moved(&turned, k) - moved(&zeroed, k)).norm() < 1e-9, "{k}");
        }
        assert_eq!(heading_between_rad(&turned, &wheels(1.0)).map(|rad| (rad * 1e6).round()), Some(1e6));
    }

    #[test]
    fn a_truth_in_millimetres_is_in_doubt() {
        let at = |true_range_m| far(&Judged { true_range_m, ..row("a/tx1", 0.0, 0.0, 0.9) });
        assert_eq!((at(None), at(Some(999.0))), (None, None));
        assert!(at(Some(3368.0)).unwrap().contains("a/tx1: its true place is 3.4 km from the receiver"));
    }
}
