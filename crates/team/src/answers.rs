//! A bearing of the estimator as the candidates of a link.

use crate::{Mode, wrap};
use csi5300::pipeline::{Answer, CandidateAnswer};

/// Candidates nearer to each other than this are the same, degrees; probabilities of answers are of errors within it.
const WRONG_DEG: f64 = 5.0;

/// Least deviation of a bearing, degrees (the median error in line of sight is about 1 degree, whatever the predicted one).
pub const AZIMUTH_FLOOR_DEG: f64 = 1.15;

/// Outlier share of links.
pub const LINK_OUTLIERS: f64 = 0.1;

/// Outlier share of another sensor's ranges: reflections, or ranges of another robot.
pub const RANGE_OUTLIERS: f64 = 0.1;

/// Ranges from the wave front: least relative deviation, and share of wrong ones.
const RANGE_FLOOR: f64 = 0.3;
const RANGE_MISSED: f64 = 0.5;

/// Upper limit of a link's probability that one of its bearings is within 5 degrees; close to the largest calibrated one.
const MOST_SURE: f64 = 0.95;

/// Probability assumed for an answer without one: it is within 5 degrees as often as not.
pub const UNKNOWN_PROBABILITY: f64 = 0.5;

/// A possible bearing of a link, with its mode in the graph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Way {
    /// The bearing, degrees, in the frame of the answer.
    pub azimuth_deg: f64,
    /// True for the answer's own bearing, to which the elevation belongs.
    pub is_answer: bool,
    /// The mode: azimuth, and range if the wave front gives one.
    pub mode: Mode,
}

/// Standard deviation of a link's bearings, degrees, without the share of the trajectory's heading, which is a variable.
fn deviation_deg(answer: &Answer, heading_sd_deg: f64) -> f64 {
    let share = bearings(answer).first().map_or(1.0, |first| first.1);
    let sure = (answer.confidence.unwrap_or(UNKNOWN_PROBABILITY) / share).clamp(0.01, MOST_SURE);
    let all = stands_for_deg(sure).max(answer.azimuth_sd_deg.unwrap_or_default());
    (all * all - heading_sd_deg * heading_sd_deg).max(0.0).sqrt().hypot(AZIMUTH_FLOOR_DEG)
}

/// Standard deviation of a normal error that is within 5 degrees with probability `sure`, degrees. Inverts the error function
/// by bisection.
fn stands_for_deg(sure: f64) -> f64 {
    let (mut low, mut high) = (0.1, 6.0);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if within(middle) < sure { low = middle } else { high = middle }
    }
    WRONG_DEG / high
}

/// Probability that a normal error is within `x` deviations (Simpson's rule on the density).
fn within(x: f64) -> f64 {
    let n = 64;
    let h = x / f64::from(n);
    let density = |k: i32| (-0.5 * (h * f64::from(k)).powi(2)).exp();
    let inner: f64 = (1..n).map(|k| density(k) * if k % 2 == 1 { 4.0 } else { 2.0 }).sum();
    2.0 * h / 3.0 * (density(0) + inner + density(n)) / std::f64::consts::TAU.sqrt()
}

/// Every possible bearing of a link, degrees, and its share; the answer first. A mirror that is not among the candidates gets
/// a share in proportion to the answer's.
fn bearings(answer: &Answer) -> Vec<(f64, f64)> {
    let Some(azimuth_deg) = answer.azimuth_deg else { return Vec::new() };
    let off = |candidate: &CandidateAnswer, azimuth_deg: f64| wrap_deg(candidate.azimuth_deg - azimuth_deg).abs();
    let usable = || answer.candidates.iter().filter(|own| own.share > 0.0 && own.azimuth_deg.is_finite());
    let own = usable().min_by(|a, b| off(a, azimuth_deg).total_cmp(&off(b, azimuth_deg)));
    let own_share = own.map_or(1.0, |own| own.share);
    let mut all = vec![(azimuth_deg, own_share)];
    all.extend(
        usable()
            .filter(|other| own.is_none_or(|own| !std::ptr::eq(*other, own)))
            .map(|other| (other.azimuth_deg, other.share)),
    );
    let is_listed = |mirror: f64| all.iter().any(|(azimuth, _)| wrap_deg(azimuth - mirror).abs() < WRONG_DEG);
    if let Some(mirror_deg) = answer.mirror_deg.filter(|mirror| !is_listed(*mirror)) {
        let share = answer.mirror_share.unwrap_or(0.5).clamp(0.01, 0.5);
        all.push((mirror_deg, own_share * share / (1.0 - share)));
    }
    let total: f64 = all.iter().map(|(_, share)| share).sum();
    all.into_iter().map(|(azimuth_deg, share)| (azimuth_deg, share / total)).collect()
}

/// The possible bearings of an answer, the answer's own first; none without a bearing. That and its mirror may have a range, and
/// are then given with and without it. `heading_sd_deg` is the deviation of the trajectory's heading, which is a variable of
/// the graph and no part of the modes' deviations.
#[must_use]
pub fn ways(answer: &Answer, heading_sd_deg: f64) -> Vec<Way> {
    let sd_rad = deviation_deg(answer, heading_sd_deg).to_radians();
    let horizontal = answer.abs_elevation_deg.unwrap_or(0.0).to_radians().cos();
    let known = answer.range_m.zip(answer.range_sd_m).filter(|(range, sd)| *range > 0.0 && sd.is_finite());
    let range_m = known.map(|(range, sd)| [range * horizontal, (sd * horizontal).hypot(RANGE_FLOOR * range)]);
    let mut ways = Vec::new();
    for (k, (azimuth_deg, share)) in bearings(answer).into_iter().enumerate() {
        let is_mirror = answer.mirror_deg.is_some_and(|mirror| wrap_deg(mirror - azimuth_deg).abs() < WRONG_DEG);
        let mode = |share: f64| Mode::azimuth(azimuth_deg.to_radians(), sd_rad, share);
        let way = |mode: Mode| Way { azimuth_deg, is_answer: k == 0, mode };
        match range_m.filter(|_| k == 0 || is_mirror) {
            Some(_) => {
                ways.push(way(Mode { range_m, ..mode(share * (1.0 - RANGE_MISSED)) }));
                ways.push(way(mode(share * RANGE_MISSED)));
            }
            None => ways.push(way(mode(share))),
        }
    }
    ways
}

fn wrap_deg(angle: f64) -> f64 {
    wrap(angle.to_radians()).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(azimuth_deg: f64) -> Answer {
        let mut answer = Answer::default();
        (answer.azimuth_deg, answer.confidence) = (Some(azimuth_deg), Some(0.9));
        answer
    }

    #[test]
    fn a_probability_implies_a_deviation() {
        // 68.27 % are within one deviation, 95.45 % within two.
        assert!((stands_for_deg(0.682_689) - 5.0).abs() < 0.01 && (stands_for_deg(0.954_5) - 2.5).abs() < 0.01);
        // The heading's share is subtracted, down to the floor.
        let answer = answer(0.0);
        assert!(deviation_deg(&answer, 0.0) > 2.0 && (deviation_deg(&answer, 5.0) - AZIMUTH_FLOOR_DEG).abs() < 1e-9);
    }

    #[test]
    fn a_mirror_is_a_way_unless_a_candidate_is_in_its_direction() {
        let mut own = answer(10.0);
        (own.mirror_deg, own.mirror_share) = (Some(-30.0), Some(0.25));
        (own.range_m, own.range_sd_m) = (Some(4.0), Some(0.1));
        let found = ways(&own, 0.0);
        let shares: Vec<f64> = found.iter().map(|way| way.mode.share).collect();
        // Three quarters and one quarter, each with the range and without it.
        let expected = [0.375, 0.375, 0.125, 0.125];
        assert!(shares.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9) && shares.len() == 4, "{found:?}");
        assert_eq!(found.iter().map(|way| way.is_answer).collect::<Vec<_>>(), [true, true, false, false]);
        let candidate =
            |azimuth_deg: f64, share: f64| CandidateAnswer { azimuth_deg, share, ..CandidateAnswer::default() };
        // A candidate 360 degrees away is the answer itself.
        own.candidates = vec![candidate(10.0 - 360.0, 0.6), candidate(-30.0, 0.4)];
        (own.range_m, own.range_sd_m) = (None, None);
        assert_eq!(ways(&own, 0.0).len(), 2, "a mirror among the candidates is not added");
        assert_eq!(ways(&Answer::default(), 0.0), []);
    }
}
