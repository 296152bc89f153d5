//! The result of a link: one answer from the posterior, the data that it was computed from, and its evidence about the
//! transmitter's place, for a filter over several motions.

use super::clocks::ClockOffset;
use super::one_log::ChainConstant;
use crate::bartlett::{self, Estimate, Grid, Method, Planner, ProfileOptions};
use crate::estimate::likelihood::{Place, Ways};
use crate::estimate::posterior::Mode;
use crate::estimate::{Found, MovingArray, NoRangeChange, OdometryFit, RangeChange, Sufficient, tuning};
use crate::maths::wrap_rad;
use crate::place::{Evidence, EvidenceMode};
use crate::signal::cfo::TurnAround;
use crate::signal::samples::Samples;
use nalgebra::{Matrix3, Vector2, Vector3};
use std::f64::consts::FRAC_1_SQRT_2;

/// An azimuth within this of the truth counts as right, radians.
const RIGHT_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;
/// Candidates are given down to this probability, and at most this many.
const LEAST_SHARE: f64 = 0.01;
const MOST_CANDIDATES: usize = 5;
/// Data narrow a prior if they leave less than this share of its deviation.
const NARROWED: f64 = 0.5;

/// The wave model of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum WaveModel {
    /// From infinitely far away: a direction only.
    PlaneWave,
    /// From a place: direction and curvature.
    SphericalWave,
}

/// A direction that explains the samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Azimuth, radians in (-pi, pi], from +x towards +y in the trajectory's frame.
    pub azimuth_rad: f64,
    /// |elevation|, radians.
    pub abs_elevation_rad: f64,
    /// The elevation with its sign, radians, if the motion distinguishes up from down; none for other peaks of a plane
    /// wave.
    pub signed_elevation_rad: Option<f64>,
    /// 1 / range, 1/m; 0 for a plane wave.
    pub inverse_range_per_m: f64,
    /// Its probability, 0..1.
    pub share: f64,
}

/// Range of the transmitter from the middle of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Metres.
    pub range_m: f64,
    /// Its predicted standard deviation, metres.
    pub sd_m: f64,
    /// The transmitter in the trajectory's frame at [`position_t_s`](Self::position_t_s), metres. Without an observed
    /// sign of the elevation its height is positive.
    pub position_m: Vector3<f64>,
    /// The time of the position, seconds on the trajectory's clock: the last sample used. A transmitter at rest is
    /// there at any time.
    pub position_t_s: f64,
    /// Covariance of the position, metres squared.
    pub covariance_m2: Matrix3<f64>,
}

/// The transmitter's direction and place by the posterior: see `docs/method/accuracy.md`.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct BearingAnswer {
    /// The wave.
    pub model: WaveModel,
    /// Most probable azimuth of the transmitter from the mean position, radians in (-pi, pi], from +x towards +y in the trajectory's
    /// frame.
    pub azimuth_rad: f64,
    /// Error bar of the azimuth, radians: half the width that holds 68 % of the posterior. With a mirror, of the part
    /// nearer to the azimuth than to the mirror.
    pub azimuth_sd_rad: f64,
    /// The same for 95 %.
    pub azimuth_95_rad: f64,
    /// Deviation of the azimuth by noise alone, radians: the posterior of one wave on an exact trajectory; in a clean
    /// scene the Cramer-Rao bound.
    pub azimuth_bound_rad: f64,
    /// |elevation|, radians: the mean of the posterior.
    pub abs_elevation_rad: f64,
    /// The elevation with its sign, radians, where the motion distinguishes up from down.
    pub signed_elevation_rad: Option<f64>,
    /// Standard deviation of the elevation, radians, if the samples narrow the prior; none if the elevation is not
    /// determined.
    pub elevation_sd_rad: Option<f64>,
    /// The mirror bearing of motion along a line or in a tilted plane, radians: the bearing reflected in it explains
    /// the samples equally well within noise and odometry error.
    pub mirror_rad: Option<f64>,
    /// Elevation of the mirror, radians, with its sign, where the motion distinguishes up from down.
    pub mirror_elevation_rad: Option<f64>,
    /// Share of the mirror in the probability of both, 0..0.5.
    pub mirror_share: Option<f64>,
    /// The directions that explain the samples, the most probable first.
    pub candidates: Vec<Candidate>,
    /// Probability of the second candidate over that of the first, 0..1; none without a second.
    pub peak_ratio: Option<f64>,
    /// Range and position, where the samples narrow the prior of the range.
    pub range: Option<Range>,
    /// Probability that the azimuth is within five degrees of the truth.
    pub probability: f64,
}

impl BearingAnswer {
    /// The elevation with its sign if that is known, else its magnitude, radians.
    #[must_use]
    pub fn elevation_rad(&self) -> f64 {
        self.signed_elevation_rad.unwrap_or(self.abs_elevation_rad)
    }

    /// True if the range gives a position: its direction, [`Self::azimuth_rad`], holds at least 68 % of the
    /// probability, the share of an ellipse of one deviation.
    #[must_use]
    pub fn has_place(&self) -> bool {
        self.range.is_some() && self.candidates.first().is_some_and(|first| first.share >= ONE_DEVIATION)
    }

    /// The same if the logs may be exchanged: then the direction is random.
    pub(super) fn halved(self) -> Self {
        self.times(0.5)
    }

    /// The same if other times are far likelier: its probability is at most that by their posterior, and its error bars contain their bearing.
    pub(super) fn doubted(mut self, likelier: &Bearing) -> Self {
        let probability = likelier.found.probability_about(self.azimuth_rad, RIGHT_RAD);
        let others = [Some(likelier.answer.azimuth_rad), likelier.answer.mirror_rad].into_iter().flatten();
        let off_rad = others.map(|other| wrap_rad(other - self.azimuth_rad).abs()).fold(f64::INFINITY, f64::min);
        self.azimuth_sd_rad = self.azimuth_sd_rad.hypot(off_rad);
        self.azimuth_95_rad = self.azimuth_95_rad.hypot(2.0 * off_rad).min(std::f64::consts::PI);
        if let Some(range) = &mut self.range {
            let across_m =
                Vector3::new(-self.azimuth_rad.sin(), self.azimuth_rad.cos(), 0.0) * (range.range_m * off_rad);
            range.covariance_m2 += across_m * across_m.transpose();
        }
        let by = probability / self.probability.max(f64::MIN_POSITIVE);
        self.times(by.min(1.0))
    }

    fn times(mut self, by: f64) -> Self {
        self.probability *= by;
        self.candidates.iter_mut().for_each(|candidate| candidate.share *= by);
        self
    }

    /// The posterior's answer.
    pub(super) fn of(found: &Found, samples: &Samples) -> Self {
        let first = found.modes.first();
        let (place, covariance) = first.map_or((NOWHERE, Matrix3::identity()), |mode| (mode.place, mode.covariance));
        let mirror = found.mirror.and_then(|k| found.modes.get(k)).filter(|mirror| mirror.mass > 0.0);
        let [elevation_sd, ln_range_sd] = found.prior.deviations();
        let own_sd = covariance[(1, 1)].max(0.0).sqrt();
        let narrowed = found.prior.elevation_is_open() && own_sd < NARROWED * elevation_sd;
        let curve_sd = covariance[(2, 2)].max(0.0).sqrt();
        let has_range = found.prior.curve_max > 0.0 && curve_sd < NARROWED * ln_range_sd * place.curve;
        let azimuth_sd_rad = found.half_width_rad(ONE_DEVIATION);
        let candidate = |mode: &Mode| Candidate {
            azimuth_rad: mode.place.azimuth,
            abs_elevation_rad: mode.place.elevation.abs(),
            signed_elevation_rad: found.signed.then_some(mode.place.elevation),
            inverse_range_per_m: mode.place.curve,
            share: mode.mass,
        };
        let given = |(k, mode): &(usize, &Mode)| *k == 0 || mode.mass >= LEAST_SHARE;
        let candidates: Vec<Candidate> = found
            .modes
            .iter()
            .enumerate()
            .filter(given)
            .map(|(_, mode)| candidate(mode))
            .take(MOST_CANDIDATES)
            .collect();
        Self {
            model: if found.prior.curve_max > 0.0 { WaveModel::SphericalWave } else { WaveModel::PlaneWave },
            azimuth_rad: place.azimuth,
            azimuth_sd_rad,
            azimuth_95_rad: found.half_width_rad(0.954),
            azimuth_bound_rad: found.bound_rad,
            abs_elevation_rad: place.elevation.abs(),
            signed_elevation_rad: found.signed.then_some(place.elevation),
            elevation_sd_rad: narrowed.then_some(own_sd),
            mirror_rad: mirror.map(|mirror| mirror.place.azimuth),
            mirror_elevation_rad: mirror.filter(|_| found.signed).map(|mirror| mirror.place.elevation),
            mirror_share: mirror.zip(first).map(|(mirror, first)| mirror.mass / (mirror.mass + first.mass)),
            peak_ratio: candidates.get(1).zip(candidates.first()).map(|(other, best)| other.share / best.share),
            candidates,
            range: has_range.then(|| range(found, &place, &covariance, azimuth_sd_rad, samples)).flatten(),
            probability: found.probability_within(RIGHT_RAD),
        }
    }
}

/// Largest share of pairs without a pose that differing host clocks cause at a log's ends: at most 2.6 % on 71 WSR
/// links.
const MANY_OUTSIDE: f64 = 0.05;

/// What becomes of a pair, or of a record for a baseline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Fate {
    Cut,
    NoPose,
    Standing,
    Used,
}

impl PairCounts {
    pub(super) fn add(&mut self, fate: Fate) {
        *match fate {
            Fate::Cut => &mut self.cut,
            Fate::NoPose => &mut self.no_pose,
            Fate::Standing => &mut self.standing,
            Fate::Used => &mut self.in_motion,
        } += 1;
    }

    /// True if far more pairs lack a pose by the receiver's times than by the transmitter's: the two logs may be
    /// exchanged.
    #[must_use]
    pub fn may_be_exchanged(&self) -> bool {
        let more = |other: usize| self.no_pose.saturating_sub(other) as f64;
        self.no_pose_by_transmitter.is_some_and(|other| more(other) > MANY_OUTSIDE * self.formed as f64)
    }
}

/// The probability within one deviation of a normal distribution.
const ONE_DEVIATION: f64 = 0.683;
/// The result of a posterior without any mode.
const NOWHERE: Place = Place { azimuth: 0.0, elevation: 0.0, curve: 0.0 };

/// Range and position. The search finds the transmitter's place without its own displacements; at the last sample it is
/// displaced from there. Across the line of sight, the azimuth's error bar gives the uncertainty.
fn range(
    found: &Found,
    place: &Place,
    covariance: &Matrix3<f64>,
    azimuth_sd_rad: f64,
    samples: &Samples,
) -> Option<Range> {
    let (displaced_m, position_t_s) = samples.transmitter_m().last().zip(samples.t_s().last())?;
    let (a, e, range_m) = (place.azimuth, place.elevation, 1.0 / place.curve);
    let towards = bartlett::direction(a, e);
    let by_azimuth = Vector3::new(-a.sin(), a.cos(), 0.0) * (range_m * e.cos());
    let by_elevation = Vector3::new(-a.cos() * e.sin(), -a.sin() * e.sin(), e.cos()) * range_m;
    let jacobian = Matrix3::from_columns(&[by_azimuth, by_elevation, towards * (-range_m * range_m)]);
    let mut covariance = *covariance;
    covariance[(0, 0)] = covariance[(0, 0)].max(azimuth_sd_rad * azimuth_sd_rad);
    // A wrong scale of the path scales the place too.
    let scale_m = range_m * found.scale_sd;
    // To second order the elevation's deviation changes the distance in the plane, too.
    let shorter = Vector3::new(towards.x, towards.y, 0.0) * (FRAC_1_SQRT_2 * covariance[(1, 1)] * range_m);
    let covariance_m2 = jacobian * covariance * jacobian.transpose()
        + towards * towards.transpose() * (scale_m * scale_m)
        + shorter * shorter.transpose();
    let sd_m = (covariance[(2, 2)].max(0.0).sqrt() * range_m * range_m).hypot(scale_m);
    let position_m = found.middle_m + towards * range_m + displaced_m;
    Some(Range { range_m, sd_m, position_m, position_t_s: *position_t_s, covariance_m2 })
}

/// The complete result of a link.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Bearing {
    /// Where the transmitter is.
    pub answer: BearingAnswer,
    /// Which part of the estimate was sufficient.
    pub sufficient: Sufficient,
    /// The best plane wave at the channel centre, the start of every estimate. Its coherence is the share of the
    /// samples that one plane wave explains.
    pub plane_wave: Estimate,
    /// Probability of each azimuth from 0 on, per radian, if [`super::Options::keep_course`] asked for it.
    pub density: Vec<f64>,
    /// Standard deviation of the removed sampling-time slopes, radians per subcarrier index, if any were removed.
    pub slope_sd_rad: Option<f64>,
    /// The robot's heading at the last sample used, radians.
    pub heading_rad: Option<f64>,
    /// Turn-around compensation, if both clocks allowed one.
    pub turn_around: Option<TurnAround>,
    /// Whether it was applied.
    pub compensated: bool,
    /// How the distance to the transmitter changed from exchange to exchange, or why that is not known, if
    /// [`super::Options::range_change`] asked for it. Never for one log, whose phases contain the path once.
    pub range_change: Option<Result<RangeChange, NoRangeChange>>,
    /// From one log: the phase that the chains add on each baseline, estimated from the turn; none if they were given,
    /// or for two logs.
    pub chain_constants: Vec<ChainConstant>,
    /// What the odometry of the whole drive got wrong, if [`super::Options::fit_odometry`] asked for it: the same for all links of a
    /// receiver.
    pub odometry_fit: Option<OdometryFit>,
    /// What the phases of all links of the receiver say of its clock and the trajectory's; none if one wave is the whole answer.
    pub clock_offset: Option<ClockOffset>,
    /// Pairs by fate.
    pub pairs: PairCounts,
    /// Mean receiver position of the samples used, metres, trajectory frame: the origin of the answer's azimuth and
    /// range.
    pub mean_position_m: Vector3<f64>,
    /// The receiver's position at the last sample used, metres.
    pub(super) end_m: Vector3<f64>,
    /// Of one log: the drive that the estimate took into account.
    pub(super) drive: Option<MovingArray>,
    /// The WSR toolbox's variance of the plane wave's azimuth profile: lower is sharper, 1 is uniform.
    pub wsr_profile_variance: Option<f64>,
    /// The likelihood share of \[paper\], of the same profile: the highest entry over the sum (its code prints half,
    /// holding each column twice).
    pub likelihood_share: Option<f64>,
    /// The samples used.
    pub samples: Samples,
    /// The receiver's whole path, if [`super::Options::keep_course`] asked for it, metres.
    pub path_m: Vec<Vector3<f64>>,
    /// The phase of every pair, if [`super::Options::keep_course`] asked for it.
    pub course: Vec<Phase>,
    /// The posterior that the answer was read from.
    pub(super) found: Found,
    /// Azimuth and error bar by two logs, and by one, radians, if the answer has both kinds of evidence.
    pub(super) kinds_rad: Vec<[f64; 2]>,
}

impl Bearing {
    /// Whether it may be wrong by far more than its error bar: the logs may be exchanged, or the clocks differ.
    pub(super) fn is_in_doubt(&self) -> bool {
        self.pairs.may_be_exchanged() || self.clock_offset.is_some_and(|found| found.doubt)
    }

    /// This bearing, of two logs, with what `one` tells of the same transmitter by antennas on the same robot over the same
    /// path: their log-likelihoods over azimuths add. Ranges and elevations are those of two logs.
    #[doc(hidden)] // for the crates of this workspace
    #[must_use]
    pub fn with_one_log(&self, one: &Self) -> Self {
        let found = crate::estimate::both(
            &self.found,
            &one.found,
            self.found.blur.heading_rad,
            (self.mean_position_m - one.mean_position_m).norm(),
        );
        let count = self.density.len();
        let kind = |own: &BearingAnswer| [own.azimuth_rad, own.azimuth_sd_rad];
        // A doubt about the two logs remains one.
        let undoubted = self.found.probability_within(RIGHT_RAD);
        let believed =
            if self.is_in_doubt() { self.answer.probability / undoubted.max(f64::MIN_POSITIVE) } else { 1.0 };
        Self {
            answer: BearingAnswer::of(&found, &self.samples).times(believed.min(1.0)),
            density: if count > 0 { found.density(count) } else { Vec::new() },
            chain_constants: one.chain_constants.clone(),
            kinds_rad: vec![kind(&self.answer), kind(&one.answer)],
            found,
            ..self.clone()
        }
    }

    /// Where the receiver was at each sample, metres; of one log of a robot that only turned, the end of its baseline.
    #[doc(hidden)] // for the crates of this workspace
    #[must_use]
    pub fn used_m(&self) -> Vec<Vector3<f64>> {
        let Some(drive) = &self.drive else { return self.samples.receiver_m().to_vec() };
        let driven = drive.ends_m.iter().zip(&drive.feet_m).filter(|(end, foot)| end != foot);
        driven.map(|(end, _)| end + self.mean_position_m).collect()
    }

    /// What the answer leaves of each sample's phase, about their mean, radians.
    #[doc(hidden)] // for the crates of this workspace
    #[must_use]
    pub fn residuals_rad(&self) -> Vec<f64> {
        let Some(best) = self.answer.candidates.first() else { return Vec::new() };
        let elevation = best.signed_elevation_rad.unwrap_or(best.abs_elevation_rad);
        let place = Place { azimuth: self.answer.azimuth_rad, elevation, curve: best.inverse_range_per_m };
        let points: Vec<Vector3<f64>> = self.samples.displacements_m().map(|p| p - self.found.middle_m).collect();
        let ways = self.drive.as_ref().map_or(Ways::to(&points), MovingArray::ways);
        ways.residuals_rad(&self.samples, &place)
    }

    /// Azimuth relative to the robot's heading at the last sample used, radians. With a place
    /// ([`BearingAnswer::has_place`]) it is seen from the receiver's antenna at that time; else from the mean position,
    /// like [`BearingAnswer::azimuth_rad`]. The second value is its error bar, radians, at most pi; with a place, from
    /// its covariance.
    #[must_use]
    pub fn azimuth_body_rad(&self) -> Option<(f64, f64)> {
        let (azimuth_rad, sd_rad) = self.at_the_end().unwrap_or((self.answer.azimuth_rad, self.answer.azimuth_sd_rad));
        self.heading_rad.map(|heading| (wrap_rad(azimuth_rad - heading), sd_rad))
    }

    /// Azimuth of the place from the last sample's position, and its deviation, radians.
    fn at_the_end(&self) -> Option<(f64, f64)> {
        let range = self.answer.range.filter(|_| self.answer.has_place())?;
        let mut away_m = range.position_m - self.end_m;
        away_m.z = 0.0;
        let across = Vector3::new(-away_m.y, away_m.x, 0.0) / away_m.norm_squared();
        let sd_rad = (across.transpose() * range.covariance_m2 * across).x.max(0.0).sqrt();
        Some((away_m.y.atan2(away_m.x), sd_rad.min(std::f64::consts::PI)))
    }
}

/// Pairs by what became of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct PairCounts {
    /// Pairs formed.
    pub formed: usize,
    /// Used for the bearing.
    pub in_motion: usize,
    /// Taken while no robot moved.
    pub standing: usize,
    /// Outside the trajectory, or in a gap of it.
    pub no_pose: usize,
    /// Pairs outside the trajectory by the host times of the transmitter's log, and those in its gaps: far fewer if the two
    /// logs were exchanged. None if that log has no host times.
    pub no_pose_by_transmitter: Option<usize>,
    /// Outside the requested stretch.
    pub cut: usize,
    /// Without energy at the antenna.
    pub silent: usize,
    /// Skipped evenly, because the link has more pairs than are kept or only every n-th was requested.
    pub thinned: usize,
    /// In motion but outside the searched stretch, because the whole motion is too wide for one search.
    pub too_wide: usize,
}

/// The phase of one pair, for pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phase {
    /// Seconds from the link's first pair.
    pub t_s: f64,
    /// Phase of the receiver's CSI alone, at the channel centre, radians.
    pub one_way_rad: f64,
    /// Phase of the round-trip product, radians.
    pub round_trip_rad: f64,
    /// The same after turn-around compensation, radians.
    pub compensated_rad: f64,
    /// True if it is one of the bearing's samples.
    pub is_used: bool,
}

/// Figures of merit as other programs define them, from an azimuth profile on the WSR toolbox's grid:
/// [`Bearing::wsr_profile_variance`] and [`Bearing::likelihood_share`].
pub(super) fn profile_figures(samples: &Samples) -> Result<[Option<f64>; 2], bartlett::Error> {
    // The toolbox's planar mode: one azimuth profile, the same for each of its polar angles.
    // Tables that serve one profile cost more than its sums.
    let options = ProfileOptions { method: Some(Method::Direct), ..ProfileOptions::default() };
    let profile = Planner::default().profile(samples, &Grid::wsr_azimuths(), &options)?;
    Ok([bartlett::wsr_planar_profile_variance(&profile), profile.likelihood_share()])
}

/// Largest deviation of a mirror's side: two densities closer than four deviations merge.
const MIRROR_SHARE: f64 = 0.25;

impl Bearing {
    /// The candidates with their probabilities, seen from the middle of the samples. Positions are those of the
    /// receiver less the transmitter's displacement, so a transmitter with known odometry counts as standing at its
    /// start; see `PeerTrack`.
    #[doc(hidden)]
    #[must_use]
    pub fn evidence(&self) -> Evidence {
        let middle_m = self.found.middle_m;
        let t_s = self.samples.t_s().last().copied().unwrap_or_default();
        Evidence {
            t_s,
            position_m: Vector2::new(middle_m.x, middle_m.y),
            driven_m: 0.0,
            modes: modes(&self.answer),
            known: 1.0 - tuning::UNEXPLAINED,
            fresh: 1.0,
        }
    }
}

fn modes(answer: &BearingAnswer) -> Vec<EvidenceMode> {
    let apart_rad = answer.mirror_rad.map(|mirror| wrap_rad(answer.azimuth_rad - mirror).abs());
    let most_rad = apart_rad.map_or(f64::MAX, |apart| MIRROR_SHARE * apart);
    let sd_rad =
        answer.azimuth_bound_rad.hypot(tuning::MODEL_DEG.to_radians()).min(most_rad.max(answer.azimuth_bound_rad));
    let range_m = answer.range.map(|range| (range.range_m * answer.abs_elevation_rad.cos(), range.sd_m));
    let mode = |(k, candidate): (usize, &Candidate)| {
        let range_m = range_m.filter(|_| k == 0);
        EvidenceMode { azimuth_rad: candidate.azimuth_rad, sd_rad, share: candidate.share, range_m }
    };
    answer.candidates.iter().enumerate().map(mode).collect()
}
