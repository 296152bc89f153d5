//! The result of a link: one answer (all of one wave model), and beside it what it was computed from.

use super::accurate::Placed;
use super::direction::Direction;
use super::effort::Sufficient;
use super::options::Options;
use crate::bartlett::{self, Estimate, Grid};
use crate::maths::wrap_rad;
use crate::place::confidence::{
    full_deviation_rad, full_probability, quick_deviation_rad, quick_features, quick_probability, shares,
};
use crate::place::near_field::{Edge, Fix, Limits, Source};
use crate::signal::cfo::TurnAround;
use crate::signal::samples::Samples;
use nalgebra::{Matrix3, Vector3};

/// The wave that an answer is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum WaveModel {
    /// From infinitely far away, at the channel centre: a direction.
    PlaneWave,
    /// From a place, over all subcarriers: a direction and a curvature.
    SphericalWave,
}

/// A direction that explains the samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Azimuth, radians in (-pi, pi], from +x towards +y in the trajectory's frame.
    pub azimuth_rad: f64,
    /// |elevation|, radians.
    pub abs_elevation_rad: f64,
    /// The elevation with its sign, radians, where the motion distinguishes the two; none of a plane wave's other peaks.
    pub signed_elevation_rad: Option<f64>,
    /// 1 / range, 1/m; 0 for a plane wave.
    pub inverse_range_per_m: f64,
    /// How much of the samples it explains, 0..1: of a plane wave `F / (sum w |z|)^2`, of a spherical wave the geometric
    /// mean of the views' normalised powers. Comparable within one answer only.
    pub power: f64,
    /// What it has of the probability, 0..1, as the model of the wave has it; the shares of all candidates sum to 1. Errors
    /// of the model are not in it: the answer's error bar and probability are calibrated, this is not.
    pub share: f64,
}

/// Range of the transmitter from the middle of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Metres.
    pub range_m: f64,
    /// Its predicted standard deviation, metres.
    pub sd_m: f64,
    /// The transmitter in the trajectory's frame at [`position_t_s`](Self::position_t_s), metres. Where the elevation's
    /// sign is not observed its height is drawn upwards.
    pub position_m: Vector3<f64>,
    /// The time that the position is of, seconds on the trajectory's clock: that of the last sample used. A transmitter
    /// that stands still is there at any time.
    pub position_t_s: f64,
    /// Covariance of the position, metres squared.
    pub covariance_m2: Matrix3<f64>,
}

/// Where the transmitter is: every field is of the wave that [`model`](Self::model) names.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct BearingAnswer {
    /// The wave.
    pub model: WaveModel,
    /// Azimuth of the transmitter, radians in (-pi, pi], from +x towards +y in the trajectory's frame.
    pub azimuth_rad: f64,
    /// Error bar of the azimuth, radians: 68 % of errors are within it and 95 % within twice, as calibrated on real
    /// captures (docs/accuracy.md); at most that of a uniform guess, pi / sqrt 3. Where it is wide, `candidates` say which
    /// other directions it stands for.
    pub azimuth_sd_rad: f64,
    /// Cramer-Rao bound of the azimuth's standard deviation, radians: what noise alone leaves if one wave, the trajectory
    /// as it was reported and the right peak are taken for granted.
    pub azimuth_bound_rad: f64,
    /// |elevation|, radians; 0 where it was not searched or cannot be observed.
    pub abs_elevation_rad: f64,
    /// The elevation with its sign, radians, where the motion distinguishes up from down.
    pub signed_elevation_rad: Option<f64>,
    /// Predicted standard deviation of |elevation|, radians, where it was searched.
    pub elevation_sd_rad: Option<f64>,
    /// The mirror bearing of motion along a line or in a tilted plane, radians: reflected in it, the bearing explains the
    /// samples as well as noise and the odometry's error let one tell.
    pub mirror_rad: Option<f64>,
    /// Elevation of the mirror, radians, with its sign, where the elevation was searched.
    pub mirror_elevation_rad: Option<f64>,
    /// Share of the evidence that the mirror has of the two, 0.01 to 0.5.
    pub mirror_share: Option<f64>,
    /// The directions that were chosen from, the best first.
    pub candidates: Vec<Candidate>,
    /// What speaks for the second candidate over what speaks for the first, 0..1; none without a second.
    pub peak_ratio: Option<f64>,
    /// Range and position, where the wave front's curvature fixes them.
    pub range: Option<Range>,
    /// Which limits of the search the answer lies at: the samples may be explained better beyond them, but not so much
    /// better that it outweighs what is expected.
    pub edge: Option<Edge>,
    /// Probability that the azimuth is within five degrees of the truth, calibrated for the wave that `model` names; none
    /// for a plane wave with a mirror, which is as likely as the bearing itself.
    pub probability: Option<f64>,
}

impl BearingAnswer {
    /// The elevation with its sign where that is known, else its magnitude, radians.
    #[must_use]
    pub fn elevation_rad(&self) -> f64 {
        self.signed_elevation_rad.unwrap_or(self.abs_elevation_rad)
    }

    /// The answer of the plane wave alone; `compensated` says whether the turn-around was taken out of its samples.
    pub(super) fn of_plane_wave(direction: &Direction, compensated: bool, options: &Options) -> Self {
        let plane_wave = &direction.plane_wave;
        let signed = |peak: &bartlett::Peak| plane_wave.peaks.first().filter(|best| *best == peak);
        let heading_sd_rad = options.heading_sd_rad.unwrap_or_default();
        let features = quick_features(plane_wave, compensated, options.channel.wavelength_m());
        let bound_rad = plane_wave.azimuth_sd_rad;
        let shares = shares(plane_wave.peaks.iter().map(|peak| peak.value));
        let candidate = |(peak, share): (&bartlett::Peak, f64)| Candidate {
            signed_elevation_rad: signed(peak).and(plane_wave.signed_elevation_rad),
            azimuth_rad: peak.azimuth_rad,
            abs_elevation_rad: peak.abs_elevation_rad,
            inverse_range_per_m: 0.0,
            power: peak.value,
            share,
        };
        Self {
            model: WaveModel::PlaneWave,
            azimuth_rad: plane_wave.azimuth_rad,
            azimuth_sd_rad: quick_deviation_rad(features, heading_sd_rad, bound_rad),
            azimuth_bound_rad: bound_rad,
            abs_elevation_rad: plane_wave.abs_elevation_rad,
            signed_elevation_rad: plane_wave.signed_elevation_rad,
            edge: Edge::of(false, direction.at_edge),
            elevation_sd_rad: plane_wave.elevation_searched.then_some(plane_wave.elevation_sd_rad),
            mirror_rad: plane_wave.mirror_rad,
            mirror_elevation_rad: plane_wave.mirror_elevation_rad,
            mirror_share: plane_wave.mirror_share,
            candidates: plane_wave.peaks.iter().zip(shares).map(candidate).collect(),
            peak_ratio: plane_wave.peak_ratio,
            range: None,
            probability: plane_wave.mirror_rad.is_none().then(|| quick_probability(features, heading_sd_rad)),
        }
    }

    /// The answer of a search over places. Its mirror is its reflection in the line or plane that the plane wave and its own
    /// mirror give.
    pub(super) fn of_spherical_wave(
        placed: &Placed,
        plane_wave: &Estimate,
        samples: &Samples,
        options: &Options,
    ) -> Self {
        let heading_sd_rad = options.heading_sd_rad.unwrap_or_default();
        let fix = &placed.fix;
        let best = fix.best();
        let (mirror_rad, mirror_elevation_rad) = mirror_of(fix, plane_wave).unzip();
        let mirror_share = plane_wave.mirror_share.filter(|_| mirror_rad.is_some());
        Self {
            model: WaveModel::SphericalWave,
            azimuth_rad: fix.azimuth_rad,
            azimuth_sd_rad: full_deviation_rad(fix, mirror_rad, heading_sd_rad),
            azimuth_bound_rad: fix.deviations.azimuth_rad,
            abs_elevation_rad: best.abs_elevation_rad,
            signed_elevation_rad: best.signed_elevation_rad,
            edge: fix.edge(),
            elevation_sd_rad: fix.elevation_searched.then_some(fix.deviations.elevation_rad),
            mirror_rad,
            mirror_elevation_rad: mirror_elevation_rad.filter(|_| fix.elevation_searched),
            mirror_share,
            candidates: candidates(fix),
            peak_ratio: fix.sources.get(1).map(|other| (other.evidence / best.evidence).min(1.0)),
            range: range(placed, samples),
            probability: Some(full_probability(fix, mirror_rad.zip(mirror_share), heading_sd_rad)),
        }
    }
}

/// Azimuth and signed elevation of the reflection of a search's answer, if its motion hides one.
fn mirror_of(fix: &Fix, plane_wave: &Estimate) -> Option<(f64, f64)> {
    let (mirror, normal) = (plane_wave.mirror_rad?, plane_wave.mirror_normal?);
    let best = fix.best();
    let like_plane_wave = || best.abs_elevation_rad.copysign(plane_wave.signed_elevation_rad.unwrap_or(1.0));
    let elevation = best.signed_elevation_rad.unwrap_or_else(like_plane_wave);
    if normal.z == 0.0 {
        // About a line: the course of the motion bends its axis for both alike.
        return Some((wrap_rad(plane_wave.azimuth_rad + mirror - fix.azimuth_rad), elevation));
    }
    let towards = bartlett::direction(fix.azimuth_rad, elevation);
    let image = towards - normal * (2.0 * towards.dot(&normal));
    let azimuth = image.y.atan2(image.x);
    let level = bartlett::is_level(&normal, wrap_rad(azimuth - fix.azimuth_rad).abs());
    (!level).then(|| (azimuth, image.z.clamp(-1.0, 1.0).asin()))
}

fn candidates(fix: &Fix) -> Vec<Candidate> {
    let shares = shares(fix.sources.iter().map(|source| source.evidence));
    let candidate = |(source, share): (&Source, f64)| Candidate {
        azimuth_rad: source.azimuth_rad,
        abs_elevation_rad: source.abs_elevation_rad,
        signed_elevation_rad: source.signed_elevation_rad,
        inverse_range_per_m: source.inverse_range_per_m,
        power: source.power,
        share,
    };
    fix.sources.iter().zip(shares).map(candidate).collect()
}

/// Range and position. The search sees the transmitter where it would stand if its own displacements were zero; at the last
/// sample it is its displacement there away.
fn range(placed: &Placed, samples: &Samples) -> Option<Range> {
    let (range_m, sd_m) = placed.range_m()?;
    let (at_rest_m, covariance_m2) = placed.fix.position()?;
    let (displaced_m, position_t_s) = samples.transmitter_m().last().zip(samples.t_s().last())?;
    Some(Range { range_m, sd_m, position_m: at_rest_m + displaced_m, position_t_s: *position_t_s, covariance_m2 })
}

/// Everything that a link gave.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Bearing {
    /// Where the transmitter is.
    pub answer: BearingAnswer,
    /// How much of the estimate sufficed.
    pub sufficient: Sufficient,
    /// What a search over places may expect, for the plan.
    pub(super) limits: Limits,
    /// The best plane wave at the channel centre: the answer itself where no spherical waves were searched, and its own
    /// value where they were. Its coherence says how much of the samples one plane wave explains.
    pub plane_wave: Estimate,
    /// What the search over places found and what it was made of, where it was made.
    pub placed: Option<Placed>,
    /// The robot's heading at the last sample used, radians.
    pub heading_rad: Option<f64>,
    /// Turn-around compensation, where both clocks allowed one.
    pub turn_around: Option<TurnAround>,
    /// Whether it was applied.
    pub compensated: bool,
    /// Pairs by fate.
    pub pairs: PairCounts,
    /// Mean receiver position of the samples used, metres, trajectory frame.
    pub mean_position_m: Vector3<f64>,
    /// Figures of merit of the plane wave's azimuth profile, as other programs define them.
    pub figures: ProfileFigures,
    /// The samples used.
    pub samples: Samples,
    /// The receiver's whole path, if [`super::Options::keep_course`] asked for it, metres.
    pub path_m: Vec<Vector3<f64>>,
    /// The phase of every pair, if [`super::Options::keep_course`] asked for it.
    pub course: Vec<Phase>,
}

impl Bearing {
    /// Azimuth of the answer relative to the robot's heading at the last sample used, radians.
    #[must_use]
    pub fn azimuth_body_rad(&self) -> Option<f64> {
        self.heading_rad.map(|heading| wrap_rad(self.answer.azimuth_rad - heading))
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
    /// Those that would be outside the trajectory by the host times of the transmitter's log: far fewer where the two logs were
    /// exchanged. None where that log has no host times.
    pub no_pose_by_transmitter: Option<usize>,
    /// Outside the stretch that was asked for.
    pub cut: usize,
    /// Without energy at the antenna.
    pub silent: usize,
    /// Left out evenly, because the link has more pairs than are kept or only every so manieth was asked for.
    pub thinned: usize,
    /// Taken in motion outside the stretch that is searched, because all of it is too wide to be searched as one aperture.
    pub too_wide: usize,
}

/// The phase of one pair, for pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phase {
    /// Seconds from the link's first pair.
    pub t_s: f64,
    /// Phase of what the receiver alone heard, at the channel centre, radians.
    pub one_way_rad: f64,
    /// Phase of the round-trip product, radians.
    pub round_trip_rad: f64,
    /// The same after turn-around compensation, radians.
    pub compensated_rad: f64,
    /// True if it is one of the bearing's samples: in motion, and inside of what was searched.
    pub is_used: bool,
}

/// Figures of merit as other programs define them, from an azimuth profile on the WSR toolbox's grid.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProfileFigures {
    /// The WSR toolbox's profile variance: lower is sharper, 1 is uniform.
    pub wsr_profile_variance: Option<f64>,
    /// The likelihood share of \[paper\]: the highest entry over the sum (its code prints half, holding each column twice).
    pub likelihood_share: Option<f64>,
}

impl ProfileFigures {
    pub(super) fn of(samples: &Samples) -> Result<Self, bartlett::Error> {
        // The toolbox's planar mode: one azimuth profile, the same for each of its polar angles.
        let profile = bartlett::profile(samples, &Grid::wsr_azimuths())?;
        let likelihood_share = profile.likelihood_share();
        Ok(Self { wsr_profile_variance: bartlett::wsr_planar_profile_variance(&profile), likelihood_share })
    }
}
