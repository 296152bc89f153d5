//! What a bearing says of the transmitter's place, for the filter that carries it from one motion to the next.

use super::bearing::{Bearing, BearingAnswer};
use crate::maths::wrap_rad;
use crate::place::confidence::{UNIFORM_RAD, within_by_noise};
use crate::place::track::{Evidence, EvidenceMode};
use crate::tuning::TUNING;
use nalgebra::{Vector2, Vector3};

impl Bearing {
    /// What it says of the transmitter's place: the candidates with their shares, the answer's azimuth for the first, the
    /// reflections of all of them where the motion hides a mirror, and a rest that grows as the probability of the answer
    /// falls. Positions are those of
    /// the receiver less the transmitter's displacement, so a transmitter whose odometry is known counts as standing where
    /// it would be without any; see `PeerTrack`.
    #[doc(hidden)]
    #[must_use]
    pub fn evidence(&self) -> Evidence {
        let samples = &self.samples;
        let sum = samples.displacements_m().fold(Vector3::zeros(), |sum, p| sum + p);
        let middle_m = sum / samples.len().max(1) as f64;
        let t_s = samples.t_s().last().copied().unwrap_or_default();
        let (modes, known) = modes(&self.answer);
        Evidence::new(t_s, Vector2::new(middle_m.x, middle_m.y), modes, known)
    }
}

/// The directions of an answer, and the probability that one of them is right.
fn modes(answer: &BearingAnswer) -> (Vec<EvidenceMode>, f64) {
    let tuning = TUNING.track;
    let sd_rad = (tuning.sd_bounds * answer.azimuth_bound_rad).hypot(tuning.sd_least_deg.to_radians());
    let sd_rad = if sd_rad.is_finite() { sd_rad.min(UNIFORM_RAD) } else { UNIFORM_RAD };
    // Of a motion nearly towards the transmitter the bound grows without end; a direction and its mirror stay two.
    let apart_rad = answer.mirror_rad.map_or(UNIFORM_RAD, |mirror| wrap_rad(answer.azimuth_rad - mirror).abs());
    let sd_rad = sd_rad.min((tuning.mirror_share * apart_rad).max(answer.azimuth_sd_rad));
    let mirror = answer.mirror_rad.zip(answer.mirror_share);
    let right = probability(answer, mirror.map_or(0.0, |(_, share)| share));
    let level = answer.abs_elevation_rad.cos();
    let range_m = answer.range.map(|range| (range.range_m * level, range.sd_m));
    let mode = |azimuth_rad: f64, share: f64| EvidenceMode::new(azimuth_rad, sd_rad, share.powf(tuning.share_power));
    let first = answer.candidates.first().map_or(1.0, |first| first.share);
    let best = mode(answer.azimuth_rad, first).with_range_m(range_m);
    let others = answer.candidates.iter().skip(1).map(|other| mode(other.azimuth_rad, other.share));
    let mut modes: Vec<EvidenceMode> = std::iter::once(best).chain(others).collect();
    if let Some((mirror_rad, share)) = mirror {
        let reflected = |mode: &EvidenceMode| EvidenceMode {
            azimuth_rad: wrap_rad(answer.azimuth_rad + mirror_rad - mode.azimuth_rad),
            share: share * mode.share,
            ..*mode
        };
        let images: Vec<EvidenceMode> = modes.iter().map(reflected).collect();
        modes.iter_mut().for_each(|mode| mode.share *= 1.0 - share);
        modes.extend(images);
    }
    (modes, 1.0 - tuning.none_right * (1.0 - right))
}

/// The probability that the answer is within five degrees of the truth, or its mirror, which has `mirror_share`. Where none
/// is known, that of a normal error with the error bar.
fn probability(answer: &BearingAnswer, mirror_share: f64) -> f64 {
    match answer.probability {
        Some(own) => (own / (1.0 - mirror_share).max(0.5)).clamp(0.0, 1.0),
        None => within_by_noise(answer.azimuth_sd_rad),
    }
}
