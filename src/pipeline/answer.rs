//! The flat form of a bearing, for printing and for JSON Lines.
//!
//! A place can be carried from one stretch of motion to the next: [`CarriedAnswer`], and a capture cut into stretches.

use super::bearing::{Bearing, BearingAnswer, Candidate, PairCounts, WaveModel};
use super::clocks::ClockOffset;
use super::error::LinkError;
use super::explain::LinkPlan;
use super::link::Link;
use super::one_log::ChainConstant;
use super::options::Options;
use super::{CaptureReport, LinkJoin, LinkReport, estimate};
use crate::bartlett::Geometry;
use crate::estimate::{NoRangeChange, OdometryFit, RangeChange, Sufficient};
use crate::exchange::pairing::{LinkSide, SideCounts};
use crate::motion::pose::Trajectory;
pub use crate::place::{CarriedAnswer, CarriedCandidate};
use crate::place::{Evidence, PeerTrack};
use driver_iface::Mac;
use serde::Serialize;

/// One link in degrees: a line of JSON. Absent values are null.
///
/// Coherence, profile variance and likelihood share are of the best plane wave, everything else of the posterior.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct Answer {
    /// Name of the link.
    pub link: String,
    /// MAC of the transmitter.
    pub mac: Option<String>,
    /// The wave model of the answer; none without an answer.
    pub model: Option<WaveModel>,
    /// Bearing from `origin_m` to the transmitter, in the trajectory's frame, from +x towards +y, (-180, 180].
    pub azimuth_deg: Option<f64>,
    /// Why there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// The same as a value, for programs with messages of their own.
    #[serde(skip)]
    pub cause: Option<LinkError>,
    /// The mean position of the samples used, metres, in the trajectory's frame: azimuth, elevation, mirror, candidates
    /// and range are seen from here. The robot is elsewhere at the end of the motion.
    pub origin_m: Option<[f64; 3]>,
    /// Bearing relative to the robot's heading at the last sample used. With a `position_m` it points there from the antenna
    /// at that sample; else it is `azimuth_deg` less the heading, from `origin_m`.
    pub azimuth_body_deg: Option<f64>,
    /// Its error bar: with a `position_m`, of the place as seen from that sample; else `azimuth_sd_deg`.
    pub azimuth_body_sd_deg: Option<f64>,
    /// |elevation|.
    pub abs_elevation_deg: Option<f64>,
    /// Elevation with its sign, if the motion distinguishes up from down.
    pub elevation_deg: Option<f64>,
    /// Error bar of the azimuth: 68 % of errors are within it (docs/method/accuracy.md).
    pub azimuth_sd_deg: Option<f64>,
    /// The same for 95 % of errors.
    pub azimuth_95_deg: Option<f64>,
    /// Deviation by the likelihood alone, on an exact trajectory: in a clean scene the Cramer-Rao bound.
    pub azimuth_bound_deg: Option<f64>,
    /// The other bearing that fits a motion along a line or in a tilted plane within noise and odometry error: the
    /// first, mirrored in it.
    pub mirror_deg: Option<f64>,
    /// Elevation of the mirror with its sign, where the elevation was searched.
    pub mirror_elevation_deg: Option<f64>,
    /// Share of the mirror in the evidence of both, 0.01 to 0.5.
    pub mirror_share: Option<f64>,
    /// Probability that the azimuth is within five degrees of the truth, 0..1.
    pub confidence: Option<f64>,
    /// `|sum z a| / sum |z|` of the best plane wave, 0..1.
    pub coherence: Option<f64>,
    /// Evidence of the second candidate over the first's, 0..1: powers for a plane wave, probabilities for a spherical
    /// one.
    pub peak_ratio: Option<f64>,
    /// Predicted standard deviation of the elevation, where it was searched.
    pub elevation_sd_deg: Option<f64>,
    /// Range from `origin_m`, metres; only if the wave front's curvature determines it.
    pub range_m: Option<f64>,
    /// Its predicted standard deviation, metres.
    pub range_sd_m: Option<f64>,
    /// Position of the transmitter in the trajectory's frame at `position_t_s`, metres, if there is a range and the first
    /// candidate holds at least 68 % of the probability. Level motion does not distinguish up from down: without an
    /// `elevation_deg` the height is given as positive.
    pub position_m: Option<[f64; 3]>,
    /// The time of the position, seconds on the trajectory's clock: that of the last sample used.
    pub position_t_s: Option<f64>,
    /// Covariance of the position, metres squared, row by row.
    pub position_covariance_m2: Option<[[f64; 3]; 3]>,
    /// How the distance to the transmitter changed over the exchanges used, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range_change: Option<RangeChangeAnswer>,
    /// What the odometry of the drive got wrong, if requested; the bearing is on the corrected trajectory unless `refused`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub odometry_fit: Option<OdometryFit>,
    /// What the phases say of the clocks of log and trajectory, if one wave is not the whole answer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clock_offset: Option<ClockOffset>,
    /// The directions that explain the samples, the most probable first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub candidates: Vec<CandidateAnswer>,
    /// Sampling-time slopes removed, standard deviation, radians per subcarrier.
    pub slope_sd_rad: Option<f64>,
    /// Carrier frequency offset found from the turn-around jitter, Hz; null if that does not show it.
    pub cfo_hz: Option<f64>,
    /// Its change over the record, Hz; null if one offset explains all.
    pub cfo_span_hz: Option<f64>,
    /// Whether turn-around compensation was applied.
    pub compensated: bool,
    /// Coherence of second differences before compensation.
    pub phase_coherence_before: Option<f64>,
    /// Coherence of second differences after compensation.
    pub phase_coherence_after: Option<f64>,
    /// Median of the turn-around jitter, microseconds.
    pub turn_around_jitter_us: Option<f64>,
    /// Drift of one card's clock against the other's, parts per million.
    pub clock_drift_ppm: Option<f64>,
    /// Spread of the next best transmitter over this one's, if the log was matched.
    pub match_margin: Option<f64>,
    /// Profile variance as the WSR toolbox defines it (lower is sharper, 1 is uniform).
    pub wsr_profile_variance: Option<f64>,
    /// Likelihood share of the peak as the code of \[paper\] defines it.
    pub likelihood_share: Option<f64>,
    /// From one log of a robot that turned: the phase that the chains add on each baseline, degrees, and its standard
    /// deviation.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub chain_constants_deg: Vec<[f64; 2]>,
    /// If the answer has both kinds of evidence: azimuth and error bar by the two logs, then by the receiver's log alone, degrees.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub kinds_deg: Vec<[f64; 2]>,
    /// Shape of the motion.
    pub geometry: Option<String>,
    /// Pairs formed; from one log, records of the sender.
    pub pairs: usize,
    /// Pairs used for the bearing.
    pub pairs_in_motion: usize,
    /// Pairs by outcome.
    pub pair_counts: PairCounts,
    /// Records of the link in the receiver's log by outcome.
    pub receiver_records: SideCounts,
    /// Records of the link in the transmitter's log by outcome.
    pub transmitter_records: SideCounts,
    /// The combined evidence of all stretches of motion so far, if they are carried on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub carried: Option<CarriedAnswer>,
    /// The steps computed and skipped, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plan: Option<LinkPlan>,
}

/// Summary of the range change of a link; [`RangeChange`] has every exchange. Absent values are omitted.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RangeChangeAnswer {
    /// Distance at the last exchange used less that at the first, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end_m: Option<f64>,
    /// Its predicted standard deviation, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end_sd_m: Option<f64>,
    /// Share of the exchanges whose cycle is known, 0..1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held_share: Option<f64>,
    /// Slips of the unwrapped phase that were removed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slips: Option<usize>,
    /// Why there is no range change.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

impl RangeChangeAnswer {
    fn new(found: &Result<RangeChange, NoRangeChange>) -> Self {
        match found {
            Ok(found) => Self {
                end_m: found.range_change_m.last().copied(),
                end_sd_m: found.deviation_m.last().copied(),
                held_share: Some(found.held_share()),
                slips: Some(found.slips.len()),
                error: None,
            },
            Err(why) => Self { error: Some(why.to_string()), ..Self::default() },
        }
    }
}

/// A direction that explains the samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct CandidateAnswer {
    /// Bearing, degrees.
    pub azimuth_deg: f64,
    /// |elevation|, degrees.
    pub abs_elevation_deg: f64,
    /// Elevation with its sign, degrees, where the motion distinguishes up from down.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub elevation_deg: Option<f64>,
    /// Apparent range, metres; none for a plane wave.
    pub range_m: Option<f64>,
    /// Its probability, 0..1.
    pub share: f64,
}

impl CandidateAnswer {
    fn new(candidate: &Candidate) -> Self {
        let curve = candidate.inverse_range_per_m;
        Self {
            azimuth_deg: candidate.azimuth_rad.to_degrees(),
            abs_elevation_deg: candidate.abs_elevation_rad.to_degrees(),
            elevation_deg: candidate.signed_elevation_rad.map(f64::to_degrees),
            range_m: (curve > 0.0).then(|| 1.0 / curve),
            share: candidate.share,
        }
    }
}

impl Answer {
    /// The answer in a link's `report`, under a name.
    #[must_use]
    pub fn new(name: String, report: &LinkReport) -> Self {
        let mut answer = Self::of(name, report.link.as_ref(), report.bearing.as_ref());
        answer.mac = report.mac.map(|mac| mac.to_string());
        answer.match_margin = report.matched.and_then(|matched| matched.margin);
        answer
    }

    /// The answer of a link and its bearing, under a name.
    pub(super) fn of(name: String, link: Option<&Link>, bearing: Result<&Bearing, &LinkError>) -> Self {
        let counts = |side| link.map(|link| link.counts(side)).unwrap_or_default();
        let mut answer = Self {
            link: name,
            mac: link.map(|link| link.mac.to_string()),
            pairs: link.map_or(0, Link::pairs),
            receiver_records: counts(LinkSide::Receiver),
            transmitter_records: counts(LinkSide::Transmitter),
            ..Self::default()
        };
        match bearing {
            Ok(bearing) => answer.take(bearing),
            Err(error) => {
                answer.error = Some(error.to_string());
                answer.cause = Some(*error);
            }
        }
        answer
    }

    fn take(&mut self, bearing: &Bearing) {
        self.take_answer(&bearing.answer);
        self.origin_m = Some(bearing.mean_position_m.into());
        let of_body = bearing.azimuth_body_rad();
        self.azimuth_body_deg = of_body.map(|(azimuth_rad, _)| azimuth_rad.to_degrees());
        self.azimuth_body_sd_deg = of_body.map(|(_, sd_rad)| sd_rad.to_degrees()).filter(|sd| sd.is_finite());
        self.coherence = Some(bearing.plane_wave.coherence);
        self.wsr_profile_variance = bearing.wsr_profile_variance;
        self.likelihood_share = bearing.likelihood_share;
        self.geometry = Some(geometry_words(&bearing.plane_wave.geometry));
        if bearing.samples.path_gain() == 1 {
            // One log has records, no pairs. Probabilities were calibrated on logs of two robots only, so there is one
            // only if a single wave leaves nothing but noise.
            self.pairs = bearing.pairs.formed;
            self.confidence = self.confidence.filter(|_| matches!(bearing.sufficient, Sufficient::OneWave(_)));
        }
        let degrees = |one: &ChainConstant| [one.rad, one.sd_rad].map(f64::to_degrees);
        self.chain_constants_deg = bearing.chain_constants.iter().map(degrees).collect();
        self.kinds_deg = bearing.kinds_rad.iter().map(|kind| kind.map(f64::to_degrees)).collect();
        self.pairs_in_motion = bearing.pairs.in_motion;
        self.pair_counts = bearing.pairs;
        self.compensated = bearing.compensated;
        self.range_change = bearing.range_change.as_ref().map(RangeChangeAnswer::new);
        self.odometry_fit.clone_from(&bearing.odometry_fit);
        self.clock_offset = bearing.clock_offset;
        self.slope_sd_rad = bearing.slope_sd_rad;
        if let Some(turn_around) = &bearing.turn_around {
            // Turn-arounds that are too regular do not show the offset.
            let is_shown = turn_around.worthwhile;
            self.cfo_hz = is_shown.then_some(turn_around.df_hz);
            self.cfo_span_hz = Some(turn_around.df_span_hz()).filter(|hz| is_shown && *hz > 0.0);
            self.phase_coherence_before = Some(turn_around.coherence_before);
            self.phase_coherence_after = Some(turn_around.coherence_after);
            self.turn_around_jitter_us = Some(turn_around.jitter_median_us);
            self.clock_drift_ppm = Some(turn_around.drift_ppm);
        }
    }

    fn take_answer(&mut self, answer: &BearingAnswer) {
        self.model = Some(answer.model);
        self.azimuth_deg = Some(answer.azimuth_rad.to_degrees());
        self.azimuth_sd_deg = Some(answer.azimuth_sd_rad.to_degrees()).filter(|sd| sd.is_finite());
        self.azimuth_95_deg = Some(answer.azimuth_95_rad.to_degrees()).filter(|bar| bar.is_finite());
        self.azimuth_bound_deg = Some(answer.azimuth_bound_rad.to_degrees()).filter(|bound| bound.is_finite());
        // For motion along a line no elevation is searched.
        let is_known = answer.elevation_sd_rad.is_some();
        self.abs_elevation_deg = is_known.then(|| answer.abs_elevation_rad.to_degrees());
        self.elevation_deg = answer.signed_elevation_rad.filter(|_| is_known).map(f64::to_degrees);
        self.elevation_sd_deg = answer.elevation_sd_rad.map(f64::to_degrees);
        self.mirror_deg = answer.mirror_rad.map(f64::to_degrees);
        self.mirror_elevation_deg = answer.mirror_elevation_rad.map(f64::to_degrees);
        self.mirror_share = answer.mirror_share;
        self.peak_ratio = answer.peak_ratio;
        self.confidence = Some(answer.probability);
        if let Some(range) = &answer.range {
            (self.range_m, self.range_sd_m) = (Some(range.range_m), Some(range.sd_m));
            if answer.has_place() {
                self.position_m = Some(range.position_m.into());
                self.position_t_s = Some(range.position_t_s);
                self.position_covariance_m2 = Some(range.covariance_m2.into());
            }
        }
        self.candidates = answer.candidates.iter().map(CandidateAnswer::new).collect();
    }

    /// Replaces the bearing by an error if the probability that it is within five degrees is below `least`, or unknown.
    #[doc(hidden)] // for the crates of this workspace
    pub fn refuse_below(&mut self, least: f64) {
        let error = match self.confidence {
            _ if self.azimuth_deg.is_none() => return,
            Some(confidence) if confidence >= least => return,
            Some(confidence) => format!("refused: confidence {confidence:.2} is below {least}"),
            None => format!("refused: no probability is known for a bearing of this kind, and {least} was asked for"),
        };
        self.error = Some(error);
        self.azimuth_deg = None;
        (self.origin_m, self.azimuth_body_deg, self.azimuth_body_sd_deg) = (None, None, None);
        (self.azimuth_sd_deg, self.azimuth_95_deg, self.azimuth_bound_deg) = (None, None, None);
        (self.mirror_deg, self.mirror_elevation_deg, self.mirror_share) = (None, None, None);
        (self.abs_elevation_deg, self.elevation_deg) = (None, None);
        self.elevation_sd_deg = None;
        (self.range_m, self.range_sd_m) = (None, None);
        self.range_change = None;
        (self.position_m, self.position_t_s, self.position_covariance_m2) = (None, None, None);
    }

    /// A link about which nothing is known yet.
    #[must_use]
    pub(crate) fn nothing(name: String, mac: Mac) -> Self {
        Self { link: name, mac: Some(mac.to_string()), ..Self::default() }
    }

    /// A link that failed before its logs were read.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn failed(link: String, error: String) -> Self {
        Self { link, error: Some(error), ..Self::default() }
    }
}

fn geometry_words(geometry: &Geometry) -> String {
    let words = match geometry {
        Geometry::Static => "no motion",
        Geometry::Line => "along a line",
        Geometry::Planar => "in a horizontal plane",
        Geometry::TiltedPlane => "in a tilted plane",
        Geometry::NearlyPlanar => "nearly in a plane",
        Geometry::Spatial => "in three dimensions",
    };
    words.into()
}

/// True if any log lost records before its tail, or any link failed or is in doubt: exit status 3.
#[must_use]
pub fn lost_something(report: &CaptureReport) -> bool {
    let logs = std::iter::once(&report.receiver).chain(&report.transmitters);
    logs.into_iter().any(|log| log.survey.lost_something())
        || report.links.iter().any(|link| !matches!(&link.bearing, Ok(bearing) if !bearing.is_in_doubt()))
}

/// One stretch of a capture's motion, of one link.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct StretchAnswer {
    /// It begins here, seconds on the trajectory's clock.
    pub from_s: f64,
    /// It ends here, seconds on the trajectory's clock.
    pub to_s: f64,
    /// The answer of the stretch alone, with the combined evidence up to its end in `carried`.
    #[serde(flatten)]
    pub answer: Answer,
}

impl CaptureReport {
    /// The links in stretches of motion of `every_s` seconds, each alone and carried on from those before; a last
    /// stretch shorter than half of that belongs to the one before. One list for each link, in their order; empty for a
    /// link without a bearing. `transmitters` are the trajectories of those that moved. Links joined row by row give
    /// errors, because stretches lack the whole trajectory's rows.
    #[must_use]
    pub fn in_stretches(
        &self,
        trajectory: &Trajectory,
        transmitters: &[Option<&Trajectory>],
        every_s: f64,
        options: &Options,
    ) -> Vec<Vec<StretchAnswer>> {
        let mut tracks = vec![(PeerTrack::new(options.heading_sd_of(trajectory)), None); self.links.len()];
        let mut answers: Vec<Vec<StretchAnswer>> = vec![Vec::new(); self.links.len()];
        for stretch in stretches(trajectory, every_s) {
            let (from_s, to_s) = stretch.span_s();
            let used = || self.links.iter().enumerate().filter_map(|(k, report)| Some((k, report.link.as_ref()?)));
            let transmitter = |k: usize| transmitters.get(k).copied().flatten();
            let join = |(k, link)| LinkJoin { link, receiver: &stretch, transmitter: transmitter(k) };
            let joins: Vec<LinkJoin<'_>> = used().map(join).collect();
            for ((k, link), made) in used().zip(estimate(&joins, options)) {
                let mut answer = Answer::of(String::new(), Some(link), made.as_ref());
                if let Some((track, last_s)) = tracks.get_mut(k) {
                    answer.carried = carry(track, last_s, trajectory, &made);
                }
                if let Some(own) = answers.get_mut(k) {
                    own.push(StretchAnswer { from_s, to_s, answer });
                }
            }
        }
        answers
    }
}

/// Takes a stretch's bearing; the answer is that of all so far, `None` without a bearing. `last_s` is the time of the last
/// stretch's last sample.
fn carry(
    track: &mut PeerTrack,
    last_s: &mut Option<f64>,
    trajectory: &Trajectory,
    made: &Result<Bearing, LinkError>,
) -> Option<CarriedAnswer> {
    let evidence = made.as_ref().ok()?.evidence();
    let driven_m = last_s.map_or(0.0, |last_s| way_m(trajectory, last_s, evidence.t_s));
    *last_s = Some(evidence.t_s);
    track.update(&Evidence { driven_m, ..evidence })
}

/// Way driven between two times, metres.
fn way_m(trajectory: &Trajectory, from_s: f64, to_s: f64) -> f64 {
    let inside = || trajectory.poses().iter().filter(|pose| (from_s..=to_s).contains(&pose.t_s));
    inside().zip(inside().skip(1)).map(|(a, b)| (b.position_m - a.position_m).norm()).sum()
}

/// The motion of a trajectory cut every `every_s` seconds.
fn stretches(trajectory: &Trajectory, every_s: f64) -> Vec<Trajectory> {
    let Some((start_s, end_s)) = trajectory.motion().window_s.filter(|_| every_s > 0.0) else { return Vec::new() };
    let count = (((end_s - start_s) / every_s).round() as usize).clamp(1, trajectory.poses().len());
    let edge_s = |k: usize| if k == count { end_s } else { start_s + every_s * k as f64 };
    (0..count).filter_map(|k| trajectory.within(edge_s(k), edge_s(k + 1)).ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::pose::{Pose, TrajectoryKind};
    use nalgebra::Vector3;

    fn trajectory() -> Trajectory {
        let at = |k: usize| Vector3::new(0.01 * (k.clamp(100, 600) as f64 - 100.0), 0.0, 0.0);
        let pose = |k: usize| Pose { t_s: 0.02 * k as f64, position_m: at(k), heading_rad: None };
        Trajectory::new((0..800).map(pose).collect()).unwrap()
    }

    #[test]
    fn stretches_follow_each_other_and_hold_the_motion() {
        let whole = trajectory();
        let (start_s, end_s) = whole.motion().window_s.unwrap();
        for every_s in [0.7, 2.0, 3.0, 4.0] {
            let cut: Vec<(f64, f64)> = stretches(&whole, every_s).iter().map(Trajectory::span_s).collect();
            let (first, last) = (cut[0], cut[cut.len() - 1]);
            assert!((first.0 - start_s).abs() < 0.03 && (last.1 - end_s).abs() < 0.03, "{every_s}: {cut:?}");
            assert!(cut.windows(2).all(|two| (two[1].0 - two[0].1).abs() < 0.03), "{every_s}: {cut:?}");
            assert!(last.1 - last.0 > 0.45 * every_s && last.1 - last.0 < 1.55 * every_s, "{every_s}: {cut:?}");
        }
        assert_eq!(stretches(&whole, 1e9).len(), 1);
        let camera = stretches(&whole.clone().with_kind(TrajectoryKind::Camera), 2.0);
        assert!(camera.iter().all(|stretch| stretch.kind() == TrajectoryKind::Camera), "its heading's deviation");
        assert!([0.0, -1.0, f64::NAN].iter().all(|every_s| stretches(&whole, *every_s).is_empty()));
    }

    #[test]
    fn the_driven_distance_is_that_of_the_poses_between() {
        let whole = trajectory();
        assert!((way_m(&whole, 4.0, 6.0) - 1.0).abs() < 0.02, "{}", way_m(&whole, 4.0, 6.0));
        assert_eq!([way_m(&whole, 6.0, 4.0), way_m(&whole, 100.0, 200.0)], [0.0, 0.0]);
    }
}
