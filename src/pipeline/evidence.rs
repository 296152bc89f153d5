//! The evidence of a bearing about its transmitter's place, for a filter over several motions.

use super::bearing::{Bearing, BearingAnswer};
use crate::estimate::tuning;
use crate::maths::wrap_rad;
use crate::place::{Evidence, EvidenceMode};
use nalgebra::{Vector2, Vector3};

/// Largest deviation of a mirror's side: two densities closer than four deviations merge.
const MIRROR_SHARE: f64 = 0.25;

impl Bearing {
    /// The candidates with their probabilities, seen from the middle of the samples. Positions are those of the
    /// receiver less the transmitter's displacement, so a transmitter with known odometry counts as standing at its
    /// start; see `PeerTrack`.
    #[doc(hidden)]
    #[must_use]
    pub fn evidence(&self) -> Evidence {
        let samples = &self.samples;
        let sum = samples.displacements_m().fold(Vector3::zeros(), |sum, p| sum + p);
        let middle_m = sum / samples.len().max(1) as f64;
        let t_s = samples.t_s().last().copied().unwrap_or_default();
        Evidence::new(t_s, Vector2::new(middle_m.x, middle_m.y), modes(&self.answer), 1.0 - tuning::UNEXPLAINED)
    }
}

fn modes(answer: &BearingAnswer) -> Vec<EvidenceMode> {
    let apart_rad = answer.mirror_rad.map(|mirror| wrap_rad(answer.azimuth_rad - mirror).abs());
    let most_rad = apart_rad.map_or(f64::MAX, |apart| MIRROR_SHARE * apart);
    let sd_rad =
        answer.azimuth_bound_rad.hypot(tuning::MODEL_DEG.to_radians()).min(most_rad.max(answer.azimuth_bound_rad));
    let range_m = answer.range.map(|range| (range.range_m * answer.abs_elevation_rad.cos(), range.sd_m));
    let mode = |(k, candidate): (usize, &super::Candidate)| {
        EvidenceMode::new(candidate.azimuth_rad, sd_rad, candidate.share).with_range_m(range_m.filter(|_| k == 0))
    };
    answer.candidates.iter().enumerate().map(mode).collect()
}
