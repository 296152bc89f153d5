//! From the pairs of a link to its bearing: clocks, compensation, selection of pairs in motion, estimate.
//!
//! Of a motion that is too wide for one search the most informative stretch is searched. The number of places grows with the fourth power of the aperture's radius (azimuth, elevation, and twice for range):
//! drives wider than some 2.7 m at 5 GHz have too many, odometry hardly stays coherent over them, and wave fronts are
//! too curved for a plane wave.

use super::bearing::{Bearing, BearingAnswer, Fate, PairCounts, Phase, profile_figures};
use super::error::LinkError;
use super::link::Link;
use super::options::{JoinBy, Options};
use crate::estimate::odometry::{self, OdometryFit, PROBE_M, Stretch};
use crate::estimate::prior::Limits;
use crate::estimate::range_change::range_change;
use crate::estimate::{self, Found, NoRangeChange, RangeChange, Task, estimate, is_searchable};
use crate::exchange::pairing::LinkSide;
use crate::motion::pose::{Motion, Pose, Trajectory, TrajectoryKind};
use crate::signal::cfo::TurnAround;
use crate::signal::planes::{Planes, round_trips};
use crate::signal::samples::Samples;
use nalgebra::{Matrix2, Vector3};
use num_complex::Complex64;
use rayon::prelude::*;
use std::ops::Range;

/// Logs are of one run if one plane wave has a coherence above this, divided by the root of the number of samples (in
/// the best of 10,000 directions, random phases reach sqrt(ln 1e7) once in a thousand times).
pub(super) const BY_CHANCE: f64 = 4.0;

/// A trajectory's times do not fit if more than this share of the pairs lies outside them (logs begin and end some
/// frames apart).
const OUTSIDE_SHARE: f64 = 0.02;

/// Two logs are of one run from this correlation of the pauses between frames on (0.83 to 0.98 on 76 links, up to
/// 0.31 on 30 pairs of unrelated logs).
const CLOCKS_ALIKE: f64 = 0.6;

/// From this correlation from pair to pair on, the changes of the shape are more than noise (noise alone: 0 +- 0.01).
const STEADY: f64 = 0.2;

/// Phases with a coherence of second differences below this are random (1,500 random phases reach 0.17, real links have
/// at least 0.6).
const RANDOM_PHASES: f64 = 0.25;

/// Or from this correlation of the two directions' changes of shape on (0.91 to 0.99 on 76 links, up to 0.58 on 494
/// wrong pairs of 14 captures).
const CHANNEL_ALIKE: f64 = 0.75;

/// Pauses that differ by less than this between frames, median, count as equal, microseconds (a turn-around jitters by
/// 4 to 22).
const PAUSES_US: f64 = 20.0;

/// A trajectory has a row for each frame if their numbers differ by at most this share (some frames are lost).
const ROW_FOR_ROW: f64 = 0.005;

/// A turn-around with more jitter destroys the phase, microseconds (several turns at usual carrier offsets).
const MAX_SPREAD_US: f64 = 500.0;

/// Largest motion that is searched as one array, metres (far more than odometry follows to a wavelength).
const MAX_EXTENT_M: f64 = 50.0;

/// The time of a pair of unknown time: no pose is that late, so the pair is counted as one without a pose.
const NEVER_S: f64 = f64::MAX;
/// Azimuths of the density that pictures show.
pub(super) const DENSITY_AZIMUTHS: usize = 1440;

/// A link and the trajectories that its pairs are joined with, both on the receiver's clock.
#[derive(Clone, Copy, Debug)]
pub struct LinkJoin<'a> {
    /// The link, with all its pairs.
    pub link: &'a Link,
    /// The receiver's trajectory: the same for all links of one call.
    pub receiver: &'a Trajectory,
    /// The transmitter's, if it moved.
    pub transmitter: Option<&'a Trajectory>,
}

/// The bearing of one link.
///
/// # Errors
/// See [`LinkError`].
pub(crate) fn bearing(join: &LinkJoin<'_>, options: &Options) -> Result<Bearing, LinkError> {
    bearing_in(join, join.receiver.motion(), (options, Clocks::AsGiven))
}

/// Whether the likelihood at other times is computed, too, for [`super::clocks::ClockOffset`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Clocks {
    AsGiven,
    Compared,
}

/// The same with the receiver's motion.
fn bearing_in(
    join: &LinkJoin<'_>,
    motion: Motion,
    (options, clocks): (&Options, Clocks),
) -> Result<Bearing, LinkError> {
    let LinkJoin { link, receiver, transmitter } = *join;
    something(link, receiver, options)?;
    let phases = Compensated::new(link, options);
    let times_s = times_of(link, receiver, options)?;
    // If a robot moves far between irregular frames, phases look as random as those of two runs, but they follow its
    // motion.
    let doubt = of_one_run(link, phases.turn_around.as_ref())?.or(phases.check().err());
    let gate = Gate::new(link, (receiver, motion), transmitter, &times_s, options);
    let found = gate.pass(&times_s, &phases.z).and_then(|mut gated| {
        gated.pairs.no_pose_by_transmitter = match options.join {
            JoinBy::Time => link.outside_by_transmitter(receiver, options).map(|outside| {
                // Gaps of the trajectory say nothing about the logs.
                let (start_s, end_s) = receiver.span_s();
                let outside_by_receiver = times_s.iter().filter(|t_s| !(start_s..=end_s).contains(*t_s)).count();
                outside + gated.pairs.no_pose.saturating_sub(outside_by_receiver + link.counts_before().no_pose)
            }),
            JoinBy::Row => None,
        };
        gated.check(&times_s, receiver)?;
        rows_or_times(link, receiver, &gated.pairs, options)?;
        // If the motion is too wide for one search, its most informative stretch.
        if let Some(stretch) = gated.searchable(options) {
            gated = gated.within(stretch, &gate)?;
        }
        let displacement_m = |t_s| gate.displacement_m(t_s);
        let other_times = estimate::OtherTimes { times_s: &times_s, z: &phases.z, displacement_m: &displacement_m };
        let is_compared = clocks == Clocks::Compared && options.join == JoinBy::Time;
        let task = Task { other_times: is_compared.then_some(other_times), ..options.task(&gated.samples, receiver) };
        let found = estimate(&task, || phases.round_trips(link, options), &gated.used)?;
        Ok((gated, found))
    });
    let follows =
        |(gated, found): &(Gated, Found)| found.plane_wave.coherence > BY_CHANCE / (gated.samples.len() as f64).sqrt();
    let (gated, found) = match doubt.filter(|_| !found.as_ref().is_ok_and(follows)) {
        Some(doubt) => return Err(doubt),
        None => found?,
    };
    let samples = &gated.samples;
    let sum = samples.receiver_m().iter().fold(Vector3::zeros(), |sum, p| sum + p);
    let answer = BearingAnswer::of(&found, samples);
    let [wsr_profile_variance, likelihood_share] = if options.figures { profile_figures(samples)? } else { [None; 2] };
    Ok(Bearing {
        answer: if gated.pairs.may_be_exchanged() { answer.halved() } else { answer },
        range_change: options.range_change.then(|| gated.range_change(&found, link, &phases, options)),
        sufficient: found.sufficient,
        heading_rad: gated.heading_rad,
        wsr_profile_variance,
        likelihood_share,
        compensated: phases.compensated,
        turn_around: phases.turn_around,
        chain_constants: Vec::new(),
        pairs: gated.pairs,
        mean_position_m: sum / samples.len() as f64,
        drive: None,
        end_m: samples.receiver_m().last().copied().unwrap_or_default(),
        density: if options.keep_course { found.density(DENSITY_AZIMUTHS) } else { Vec::new() },
        slope_sd_rad: found.slope_sd_rad,
        plane_wave: found.plane_wave.clone(),
        course: if options.keep_course { gated.course(link, &times_s, &phases.z) } else { Vec::new() },
        samples: gated.samples,
        found,
        kinds_rad: Vec::new(),
        odometry_fit: None,
        clock_offset: None,
        path_m: receiver.poses().iter().filter(|_| options.keep_course).map(|pose| pose.position_m).collect(),
    })
}

/// The bearings of all links of a capture, in their order.
#[must_use]
pub(crate) fn estimate_all(links: &[LinkJoin<'_>], options: &Options) -> Vec<Result<Bearing, LinkError>> {
    estimate_with(links, (options, Clocks::AsGiven))
}

/// The same, with or without what the phases say of the clocks.
pub(super) fn estimate_with(
    links: &[LinkJoin<'_>],
    (options, clocks): (&Options, Clocks),
) -> Vec<Result<Bearing, LinkError>> {
    // Links of one capture share their receiver, and so its motion.
    let Some((first, motion)) = links.first().map(|join| (join.receiver, join.receiver.motion())) else {
        return Vec::new();
    };
    let one = |join: &LinkJoin<'_>| {
        let is_shared = std::ptr::eq(join.receiver, first);
        bearing_in(join, if is_shared { motion } else { join.receiver.motion() }, (options, clocks))
    };
    if options.parallel { links.par_iter().map(one).collect() } else { links.iter().map(one).collect() }
}

/// What the receiver's odometry gets wrong, from the phases of all links, and the trajectory without it, with the deviation of its heading.
pub(super) fn fit_odometry(links: &[LinkJoin<'_>], options: &Options) -> (OdometryFit, Option<(Trajectory, f64)>) {
    let Some(receiver) = links.first().map(|join| join.receiver) else {
        return (odometry::fit(Vec::new(), false), None);
    };
    if receiver.kind() == TrajectoryKind::Camera {
        return (OdometryFit::refused("a tracking camera drifts, which no scale, turn or offset mends"), None);
    }
    let (mut all, mut why) = (Vec::new(), None);
    for (k, join) in links.iter().enumerate() {
        match stretches(join, options, k) {
            Ok(own) => all.extend(own),
            Err(refused) => why = refused.or(why),
        }
    }
    let found = match why.filter(|_| all.is_empty()) {
        Some(why) => OdometryFit::refused(why),
        None => odometry::fit(all, options.parallel),
    };
    let corrected = found.corrected(receiver).filter(|_| found.refused.is_none());
    let heading_sd_rad = found.heading_sd_rad(options.heading_sd_of(receiver));
    (found, corrected.map(|trajectory| (trajectory, heading_sd_rad)))
}

/// The stretches of a link along its whole motion, for [`odometry::fit`]; an error says why there are none, if that is the trajectory's fault.
fn stretches(join: &LinkJoin<'_>, options: &Options, number: usize) -> Result<Vec<Stretch>, Option<&'static str>> {
    let LinkJoin { link, receiver, transmitter } = *join;
    let usable = || {
        something(link, receiver, options)?;
        let phases = Compensated::new(link, options);
        of_one_run(link, phases.turn_around.as_ref())?.or(phases.check().err()).map_or(Ok(()), Err)?;
        Ok::<_, LinkError>((phases, times_of(link, receiver, options)?))
    };
    let (phases, times_s) = usable().map_err(|_| None)?;
    let probe = receiver.with_antenna_offset(PROBE_M * Vector3::x()).map_err(|_| Some(odometry::NO_HEADINGS))?;
    let gate = Gate::new(link, (&probe, probe.motion()), transmitter, &times_s, options);
    let gated = gate.pass(&times_s, &phases.z).map_err(|_| None)?;
    let poses: Option<Vec<Pose>> = gated.samples.t_s().iter().map(|t_s| receiver.at(*t_s)).collect();
    let poses = poses.filter(|poses| !poses.is_empty()).ok_or(None)?;
    let task = options.task(&gated.samples, receiver);
    odometry::stretches(&task, phases.round_trips(link, options), &gated.used, &poses, number).map_err(Some)
}

/// Refuses a link without any pair to join.
fn something(link: &Link, receiver: &Trajectory, options: &Options) -> Result<(), LinkError> {
    options.check()?;
    if !link.rows().is_empty() {
        return Ok(());
    }
    if link.outside() > 0 {
        return Err(outside(link, receiver, options));
    }
    if let silent @ 1.. = link.counts_before().silent {
        return Err(LinkError::Silent { pairs: silent });
    }
    let handed = |side| link.counts(side).handed;
    Err(LinkError::NoPairs { receiver: handed(LinkSide::Receiver), transmitter: handed(LinkSide::Transmitter) })
}

/// The pairs lie outside the trajectory.
fn outside(link: &Link, receiver: &Trajectory, options: &Options) -> LinkError {
    let from_s = link.first_us().map_or(0.0, |us| us as f64 * 1e-6 + options.clock_offset_s);
    let (start_s, end_s) = receiver.span_s();
    let other_fits = link.other_fits(OUTSIDE_SHARE);
    LinkError::OutsideTrajectory { pairs: link.outside(), from_s, start_s, end_s, other_fits }
}

/// Refuses logs that do not belong together: one log for both sides, and logs whose clocks and channels are both
/// uncorrelated. If only random phases contradict them, returns that as a doubt: if a robot moves far between irregular
/// frames, phases look random too, but follow its motion.
fn of_one_run(link: &Link, turn_around: Option<&TurnAround>) -> Result<Option<LinkError>, LinkError> {
    if link.is_one_log() {
        return Err(LinkError::OneLogTwice);
    }
    let apart = link.kinship().filter(|clocks| clocks.correlation < CLOCKS_ALIKE);
    let both = apart.and_then(|clocks| Some((clocks, link.reciprocity()?)));
    let Some((clocks, channel)) = both else { return Ok(None) };
    let changes = channel.steadiness > STEADY;
    // A channel of noise only cannot be compared: then random phases decide together with the clocks, if pauses differ
    // by more than turn-arounds do.
    let random = turn_around.is_some_and(|found| found.coherence_after.max(found.coherence_before) < RANDOM_PHASES);
    // Noise decorrelates the two directions as much as consecutive pairs.
    let alike = CHANNEL_ALIKE * channel.steadiness.min(1.0);
    let speaks = if changes { channel.correlation < alike } else { random && clocks.pause_us > PAUSES_US };
    let two_runs = LinkError::OfTwoRuns { clocks: clocks.correlation, channel: channel.correlation };
    match (speaks, changes) {
        (true, true) => Err(two_runs),
        (speaks, _) => Ok(speaks.then_some(two_runs)),
    }
}

/// Refuses a join by time if the trajectory has a row for each frame and yet many pairs lie outside its times: it has
/// another clock, and wrong times give a wrong bearing without any other sign.
fn rows_or_times(link: &Link, receiver: &Trajectory, pairs: &PairCounts, options: &Options) -> Result<(), LinkError> {
    let (rows, frames) = (receiver.poses().len(), link.counts(LinkSide::Receiver).handed as usize);
    let as_many = rows.abs_diff(frames) as f64 <= ROW_FOR_ROW * rows as f64;
    let outside = pairs.no_pose as f64 > OUTSIDE_SHARE * pairs.formed as f64;
    let may_be_wrong = options.join == JoinBy::Time && options.clock_offset_s == 0.0;
    if may_be_wrong && link.other_fits(OUTSIDE_SHARE) {
        return Err(self::outside(link, receiver, options));
    }
    match may_be_wrong && as_many && outside {
        true => Err(LinkError::RowsNotTimes { rows, outside: pairs.no_pose, pairs: pairs.formed }),
        false => Ok(()),
    }
}

/// The time of each pair on the trajectory's clock.
fn times_of(link: &Link, trajectory: &Trajectory, options: &Options) -> Result<Vec<f64>, LinkError> {
    let rows = link.rows().iter().map(|row| (row.host_us, row.row as usize));
    Ok(times_s(rows, trajectory, options)?.into_iter().map(|t_s| t_s.unwrap_or(NEVER_S)).collect())
}

/// The times of pairs or records, given as host time and row, on the trajectory's clock, seconds; `None` if unknown.
pub(super) fn times_s(
    rows: impl Iterator<Item = (Option<i64>, usize)>,
    trajectory: &Trajectory,
    options: &Options,
) -> Result<Vec<Option<f64>>, LinkError> {
    let time = |(host_us, row): (Option<i64>, usize)| match options.join {
        JoinBy::Time => host_us.map(|us| us as f64 * 1e-6 + options.clock_offset_s),
        JoinBy::Row => trajectory.poses().get(row).map(|pose| pose.t_s),
    };
    let times: Vec<Option<f64>> = rows.map(time).collect();
    let none_is_known = options.join == JoinBy::Time && times.iter().all(Option::is_none);
    if none_is_known { Err(LinkError::NoHostTime) } else { Ok(times) }
}

/// Why there is no sample; `still` is the reason if pairs are left where nothing moved.
pub(super) fn nothing(
    pairs: &PairCounts,
    times_s: impl Iterator<Item = f64>,
    trajectory: &Trajectory,
    still: LinkError,
) -> LinkError {
    let (start_s, end_s) = trajectory.span_s();
    let (from_s, to_s) = times_s.fold((f64::MAX, f64::MIN), |(low, high), t_s| (low.min(t_s), high.max(t_s)));
    match pairs {
        PairCounts { standing: 1.., .. } => still,
        PairCounts { cut: 1.., no_pose: 0, .. } => LinkError::AllCut { pairs: pairs.formed, length_s: to_s - from_s },
        _ => LinkError::OutsideTrajectory { pairs: pairs.formed, from_s, start_s, end_s, other_fits: false },
    }
}

/// The round trips at the channel centre, with the turn-around removed if that helps.
struct Compensated {
    z: Vec<Complex64>,
    turn_around: Option<TurnAround>,
    compensated: bool,
}

impl Compensated {
    fn new(link: &Link, options: &Options) -> Self {
        let mut z: Vec<Complex64> = link.rows().iter().map(|row| row.z).collect();
        let turn_around = link.turn_around(&z, options.channel.centre_hz());
        let compensated = options.compensate && turn_around.as_ref().is_some_and(|t| t.worthwhile);
        if let Some(turn_around) = turn_around.as_ref().filter(|_| compensated) {
            turn_around.apply(&mut z);
        }
        Self { z, turn_around, compensated }
    }

    /// Refuses clocks that no exchange ties together.
    fn check(&self) -> Result<(), LinkError> {
        let spread_us = self.turn_around.as_ref().map(|t| t.jitter_median_us).filter(|us| *us > MAX_SPREAD_US);
        spread_us.map_or(Ok(()), |spread_us| Err(LinkError::NotOfOneRun { spread_us }))
    }

    /// The round trips on all subcarriers, with the rotation of those at the channel centre.
    fn round_trips(&self, link: &Link, options: &Options) -> Vec<Planes> {
        let turns = link.rows().iter().zip(&self.z).map(|(row, z)| z / row.z);
        round_trips(link.frames(), turns, options.tier)
    }
}

/// Selects the pairs that become samples, by requested stretch, trajectories and motion.
struct Gate<'a> {
    receiver: (&'a Trajectory, Motion),
    transmitter: Option<(&'a Trajectory, Motion)>,
    options: &'a Options,
    /// The link's first pair on the trajectory's clock.
    first_s: f64,
    /// Pairs dropped earlier.
    before: PairCounts,
}

/// A pair's place: receiver, transmitter, heading.
struct PairPlace {
    receiver_m: Vector3<f64>,
    transmitter_m: Vector3<f64>,
    heading_rad: Option<f64>,
}

impl<'a> Gate<'a> {
    fn new(
        link: &Link,
        receiver: (&'a Trajectory, Motion),
        transmitter: Option<&'a Trajectory>,
        times_s: &[f64],
        options: &'a Options,
    ) -> Self {
        let by_time = link.first_us().filter(|_| options.join == JoinBy::Time);
        let first_s = by_time.map(|us| us as f64 * 1e-6 + options.clock_offset_s);
        Self {
            receiver,
            transmitter: transmitter.map(|trajectory| (trajectory, trajectory.motion())),
            options,
            first_s: first_s.or_else(|| times_s.first().copied()).unwrap_or(NEVER_S),
            before: link.counts_before(),
        }
    }

    /// The samples that pass, with unit phases.
    fn pass(&self, times_s: &[f64], z: &[Complex64]) -> Result<Gated, LinkError> {
        let samples = Samples::new(self.options.channel.wavelength_m(), 2)?;
        let mut gated = Gated { samples, used: Vec::new(), heading_rad: None, pairs: self.before };
        for (index, (&t_s, &z)) in times_s.iter().zip(z).enumerate() {
            let place = self.place(t_s);
            gated.pairs.add(place.as_ref().err().copied().unwrap_or(Fate::Used));
            if let Ok(place) = place {
                gated.heading_rad = place.heading_rad;
                gated.used.push(index);
                gated.samples.push(t_s, z / z.norm(), place.receiver_m, place.transmitter_m)?;
            }
        }
        Ok(gated)
    }

    /// The transmitter's displacement at a time.
    fn transmitter_m(&self, t_s: f64) -> Option<Vector3<f64>> {
        match &self.transmitter {
            Some((trajectory, _)) => trajectory.at(t_s).map(|pose| pose.position_m),
            None => Some(Vector3::zeros()),
        }
    }

    /// Receiver less transmitter at a time.
    fn displacement_m(&self, t_s: f64) -> Option<Vector3<f64>> {
        Some(self.receiver.0.at(t_s)?.position_m - self.transmitter_m(t_s)?)
    }

    fn place(&self, t_s: f64) -> Result<PairPlace, Fate> {
        if !self.options.keeps(t_s - self.first_s) {
            return Err(Fate::Cut);
        }
        let (Some(pose), Some(transmitter_m)) = (self.receiver.0.at(t_s), self.transmitter_m(t_s)) else {
            return Err(Fate::NoPose);
        };
        let moves = |(trajectory, motion): &(&Trajectory, Motion)| trajectory.moves(motion, t_s);
        if !self.transmitter.as_ref().is_some_and(moves) && !moves(&self.receiver) {
            return Err(Fate::Standing);
        }
        Ok(PairPlace { receiver_m: pose.position_m, transmitter_m, heading_rad: pose.heading_rad })
    }
}

/// The selected samples.
struct Gated {
    samples: Samples,
    /// Their rows in the link.
    used: Vec<usize>,
    /// The robot's heading at the last of them.
    heading_rad: Option<f64>,
    pairs: PairCounts,
}

impl Gated {
    /// The stretch that can be searched, if not all of it.
    fn searchable(&self, options: &Options) -> Option<Range<usize>> {
        let points: Vec<Vector3<f64>> = self.samples.displacements_m().collect();
        searchable(&points, self.samples.wavelength_m(), self.samples.path_gain(), &options.limits())
    }

    /// How the distance to where `found` has the transmitter changed over the samples.
    fn range_change(
        &self,
        found: &Found,
        link: &Link,
        phases: &Compensated,
        options: &Options,
    ) -> Result<RangeChange, NoRangeChange> {
        let mode = found.modes.first().ok_or(NoRangeChange::Doubtful { direction_sd_rad: f64::INFINITY })?;
        let all = phases.round_trips(link, options);
        let rows = self.used.iter().map(|&k| all.get(k).copied().unwrap_or(Planes::ZERO)).collect();
        let indices = options.channel.subcarriers();
        let place = (&mode.place, found.direction_sd_rad());
        range_change(&self.samples, rows, &indices, place, found.middle_m, options.tier)
    }

    /// The phases of all of the link's pairs, with those marked that are among the samples.
    fn course(&self, link: &Link, times_s: &[f64], z: &[Complex64]) -> Vec<Phase> {
        let mut course = link.course(times_s, z);
        for index in &self.used {
            if let Some(phase) = course.get_mut(*index) {
                phase.is_used = true;
            }
        }
        course
    }

    /// The same of a stretch of the samples.
    fn within(self, stretch: Range<usize>, gate: &Gate<'_>) -> Result<Self, LinkError> {
        let all = &self.samples;
        let mut samples = Samples::new(all.wavelength_m(), all.path_gain())?;
        for k in stretch.clone() {
            samples.push(all.t_s()[k], all.z()[k], all.receiver_m()[k], all.transmitter_m()[k])?;
        }
        let last = samples.t_s().last().and_then(|t_s| gate.place(*t_s).ok());
        let too_wide = self.pairs.too_wide + all.len() - samples.len();
        let pairs = PairCounts { in_motion: samples.len(), too_wide, ..self.pairs };
        let (used, heading_rad) = (self.used[stretch].to_vec(), last.and_then(|place| place.heading_rad));
        Ok(Self { samples, used, heading_rad, pairs })
    }

    /// Refuses samples without a bearing, with the reason.
    fn check(&self, times_s: &[f64], receiver: &Trajectory) -> Result<(), LinkError> {
        if self.samples.is_empty() {
            let known = times_s.iter().copied().filter(|t| *t != NEVER_S);
            return Err(nothing(&self.pairs, known, receiver, LinkError::NoMotion { pairs: self.pairs.formed }));
        }
        let extent_m = extent_m(&self.samples);
        if extent_m > MAX_EXTENT_M {
            return Err(LinkError::TooLarge { extent_m, limit_m: MAX_EXTENT_M });
        }
        Ok(())
    }
}

/// The longest side of the box that holds all displacements, metres.
fn extent_m(samples: &Samples) -> f64 {
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for p in samples.displacements_m() {
        (low, high) = (low.inf(&p), high.sup(&p));
    }
    (high - low).max()
}

/// Compared stretches have the longest possible length; each starts this share of it before the next.
const OVERLAP: usize = 4;
/// Weight of spread along the motion relative to spread across it: a line does not distinguish its sides.
const ALONG: f64 = 1e-3;

/// The most informative stretch of these displacements, metres, in the order of time, within `limits`; `None` if all
/// can be searched together, or no two.
fn searchable(
    displacement_m: &[Vector3<f64>],
    wavelength_m: f64,
    path_gain: u8,
    limits: &Limits,
) -> Option<Range<usize>> {
    let fits = |range: Range<usize>| is_searchable(&displacement_m[range], wavelength_m, path_gain, limits);
    let count = displacement_m.len();
    if fits(0..count) {
        return None;
    }
    let longest = |from: usize| {
        // Doubles the length while it fits, then bisects.
        let mut inside = from + 1;
        while inside < count && fits(from..(2 * inside - from).min(count)) {
            inside = (2 * inside - from).min(count);
        }
        let mut outside = (2 * inside - from).min(count + 1);
        while outside - inside > 1 {
            let middle = inside.midpoint(outside);
            if fits(from..middle) { inside = middle } else { outside = middle }
        }
        from..inside
    };
    let (mut from, mut best) = (0, None);
    while from < count {
        let range = longest(from);
        let spread_m2 = spread_m2(&displacement_m[range.clone()]);
        from = if range.end == count { count } else { from + (range.len() / OVERLAP).max(1) };
        if range.len() > 1 && best.as_ref().is_none_or(|(most_m2, _)| spread_m2 > *most_m2) {
            best = Some((spread_m2, range));
        }
    }
    best.map(|(_, range)| range)
}

/// Sum of squared distances from the mean across the motion, and a little of those along it: horizontal, square metres.
fn spread_m2(displacement_m: &[Vector3<f64>]) -> f64 {
    let mean = displacement_m.iter().sum::<Vector3<f64>>() / displacement_m.len().max(1) as f64;
    let scatter: Matrix2<f64> = displacement_m.iter().map(|p| (p - mean).xy()).map(|p| p * p.transpose()).sum();
    let across_and_along = scatter.symmetric_eigenvalues();
    across_and_along.min() + ALONG * across_and_along.max()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const WAVELENGTH_M: f64 = 0.054;

    fn circle(radius_m: f64, from: f64, to: f64, count: usize) -> impl Iterator<Item = Vector3<f64>> {
        let angle = move |k: usize| TAU * (from + (to - from) * k as f64 / count as f64);
        (0..count).map(move |k| Vector3::new(radius_m * angle(k).cos(), radius_m * angle(k).sin(), 0.0))
    }

    #[test]
    fn a_wide_motion_is_cut_to_its_most_informative_stretch() {
        let limits = Limits { near_field: true, ..Limits::default() };
        let small: Vec<_> = circle(0.5, 0.0, 1.0, 400).collect();
        assert_eq!(searchable(&small, WAVELENGTH_M, 2, &limits), None);
        assert_eq!(searchable(&[], WAVELENGTH_M, 2, &limits), None);
        // Ten metres straight on, a turn on the spot, and ten metres on.
        let line = |from_m: f64| (0..1_000).map(move |k| Vector3::new(from_m + 0.01 * f64::from(k), 0.5, 0.0));
        let drive: Vec<_> = line(-10.0).chain(circle(0.5, 0.25, 1.25, 400)).chain(line(0.0)).collect();
        let stretch = searchable(&drive, WAVELENGTH_M, 2, &limits).unwrap();
        assert!(is_searchable(&drive[stretch.clone()], WAVELENGTH_M, 2, &limits));
        assert!(
            stretch.start <= 1_000 && stretch.end >= 1_400 && stretch.len() < 1_500,
            "{stretch:?}: the turn is in it"
        );
        // One that cannot end sooner than it begins.
        let jump = [Vector3::zeros(), Vector3::new(40.0, 0.0, 0.0)];
        assert_eq!(searchable(&jump, WAVELENGTH_M, 2, &limits), None);
    }
}
