//! Figures of a set of judged links besides their bearing errors: ranges, refusals, located receivers.

use super::Judged;
use super::sure::{Kept, Sure, WRONG_DEG, surest};
use csi5300::maths::{median, wrap_rad};
use csi5300::pipeline::{Answer, CandidateAnswer};
use csi5300::place::locate::{Elevation, LocateError, Located, Sighting, locate};
use nalgebra::Vector2;
use serde::Serialize;
use std::collections::BTreeMap;

/// The risk-coverage curve: errors when 100, 90, .. 50 % are kept.
#[must_use]
pub fn risk_coverage(rows: &[Judged]) -> Vec<Kept> {
    surest(&sure(rows), (5..=10).rev().map(|tenths| f64::from(tenths) / 10.0))
}

/// The same in steps of 2 %, down to a tenth: for pictures.
#[must_use]
pub fn refusals(rows: &[Judged]) -> Vec<Kept> {
    surest(&sure(rows), (5..=50).rev().map(|fiftieths| f64::from(fiftieths) / 50.0))
}

/// Every link that has a probability and an error.
#[must_use]
pub fn sure(rows: &[Judged]) -> Vec<Sure> {
    rows.iter().filter_map(|row| Some(Sure::new(row.answer.confidence?, row.error_from_mean_pose_deg?))).collect()
}

/// Median of `|error| / deviation`, divided by that of a normal distribution: 1 if deviations are right, whatever a few false
/// answers do. `None` without links that have both.
fn scale(pairs: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let mut ratios: Vec<f64> = pairs.filter(|(_, sd)| *sd > 0.0).map(|(error, sd)| (error / sd).abs()).collect();
    median(&mut ratios).map(|ratio| ratio / 0.674_5)
}

/// The azimuths' errors relative to their error bars: 1 if the bars are right, less if they are too long.
#[must_use]
pub fn over_bound(rows: &[&Judged]) -> Option<f64> {
    scale(rows.iter().filter_map(|row| row.error_from_mean_pose_deg.zip(row.answer.azimuth_sd_deg)))
}

/// Errors of reported ranges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Ranges {
    /// Links with a bearing and a true range.
    pub links: usize,
    /// Number of those that reported a range.
    pub reported: usize,
    /// Median of the absolute errors, metres.
    pub median_m: Option<f64>,
    /// Errors relative to the predicted deviations: 1 if the deviations are right.
    pub over_bound: Option<f64>,
    /// Numbers of reported places with a known truth, and of those within their 68 % and their 95 % ellipses.
    pub places: [usize; 3],
}

/// A plane normal distribution has 68.3 and 95.4 % within these deviations: `sqrt(-2 ln(1 - share))`.
const ELLIPSES: [f64; 2] = [1.515_8, 2.481_6];

/// Accuracy of the ranges.
#[must_use]
pub fn ranges(rows: &[&Judged]) -> Ranges {
    let known = rows.iter().filter(|row| row.true_range_m.is_some() && row.answer.azimuth_deg.is_some());
    let mut errors: Vec<f64> = rows.iter().filter_map(|row| row.range_error_m).map(f64::abs).collect();
    let reported = errors.len();
    // Errors are horizontal, and so are their deviations.
    let sd_m = |answer: &Answer| answer.range_sd_m.map(|sd| sd * horizontal(answer));
    let over_bound = scale(rows.iter().filter_map(|row| row.range_error_m.zip(sd_m(&row.answer))));
    let within = |most: f64| rows.iter().filter(|row| row.position_error_sd.is_some_and(|off| off <= most)).count();
    let places = [within(f64::INFINITY), within(ELLIPSES[0]), within(ELLIPSES[1])];
    Ranges { links: known.count(), reported, median_m: median(&mut errors), over_bound, places }
}

/// The horizontal share of an answer's range: the truth has no heights.
#[must_use]
pub fn horizontal(answer: &Answer) -> f64 {
    answer.abs_elevation_deg.unwrap_or(0.0).to_radians().cos()
}

/// A receiver, located from its links.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Receiver {
    /// Name of the capture.
    pub capture: String,
    /// Links used.
    pub links: usize,
    /// Their names, in the order of the lists below.
    pub names: Vec<String>,
    /// Those without a calibrated probability: they are weighted with [`UNKNOWN_PROBABILITY`].
    #[serde(skip_serializing_if = "is_zero")]
    pub without_probability: usize,
    /// Position, metres, in the frame of the true transmitters.
    pub position_m: Option<[f64; 2]>,
    /// Its covariance, metres squared, row by row.
    pub covariance_m2: Option<[[f64; 2]; 2]>,
    /// Other places that the links fit nearly as well, the likeliest first, metres.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub others_m: Vec<[f64; 2]>,
    /// Height and its standard deviation, metres, if links with an elevation have transmitters of known height.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height_m: Option<f64>,
    /// Its standard deviation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height_sd_m: Option<f64>,
    /// Share of its weight that each link kept.
    pub weights: Vec<f64>,
    /// The bearing of each link that fits the place, degrees: the answer, its mirror or another candidate.
    pub azimuths_deg: Vec<f64>,
    /// Their errors relative to the true bearings from the mean pose, degrees, if all are known.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub azimuth_errors_deg: Vec<f64>,
    /// The same for the links' answers.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub answer_errors_deg: Vec<f64>,
    /// Why there is none.
    pub error: Option<String>,
    /// True mean position of the motion, metres.
    pub true_position_m: Option<[f64; 2]>,
    /// Distance between the position and the true one, metres.
    pub off_m: Option<f64>,
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// Locates the receiver of every capture from its links to transmitters with known places.
#[must_use]
pub fn receivers(rows: &[Judged]) -> Vec<Receiver> {
    let mut captures: BTreeMap<&str, Vec<&Judged>> = BTreeMap::new();
    for row in rows {
        let name = row.answer.link.rsplit_once('/').map_or("", |(capture, _)| capture);
        captures.entry(name).or_default().push(row);
    }
    captures.into_iter().map(|(name, rows)| receiver(name, &rows)).collect()
}

fn receiver(capture: &str, rows: &[&Judged]) -> Receiver {
    let (sightings, seen): (Vec<Sighting>, Vec<&Judged>) =
        rows.iter().filter_map(|row| Some((sighting(row)?, *row))).unzip();
    let truth = rows.iter().find_map(|row| row.true_receiver_m);
    let found: Result<Located, LocateError> = locate(&sightings);
    let mut receiver = Receiver {
        capture: capture.into(),
        links: sightings.len(),
        names: seen.iter().map(|row| row.answer.link.clone()).collect(),
        without_probability: rows.iter().filter(|row| is_unweighed(row)).count(),
        position_m: None,
        covariance_m2: None,
        others_m: Vec::new(),
        height_m: None,
        height_sd_m: None,
        weights: Vec::new(),
        azimuths_deg: Vec::new(),
        azimuth_errors_deg: Vec::new(),
        answer_errors_deg: Vec::new(),
        error: None,
        true_position_m: truth,
        off_m: None,
    };
    match found {
        Ok(found) => {
            receiver.off_m = truth.map(|truth| (found.position_m - Vector2::from(truth)).norm());
            receiver.position_m = Some(found.position_m.into());
            receiver.covariance_m2 = Some(found.covariance_m2.into());
            receiver.others_m = found.others_m.into_iter().map(Into::into).collect();
            receiver.weights = found.weights;
            receiver.azimuths_deg = found.azimuths_rad.into_iter().map(f64::to_degrees).collect();
            let chosen = seen.iter().zip(&receiver.azimuths_deg);
            let errors = chosen.map(|(row, azimuth)| Some(wrap_deg(azimuth - row.true_from_mean_pose_deg?)));
            receiver.azimuth_errors_deg = errors.collect::<Option<_>>().unwrap_or_default();
            let errors = seen.iter().map(|row| row.error_from_mean_pose_deg);
            receiver.answer_errors_deg = errors.collect::<Option<_>>().unwrap_or_default();
            (receiver.height_m, receiver.height_sd_m) = found.height_m.unzip();
        }
        Err(error) => receiver.error = Some(error.to_string()),
    }
    receiver
}

/// True for a used link without a calibrated probability.
fn is_unweighed(row: &Judged) -> bool {
    sighting(row).is_some() && row.answer.confidence.is_none()
}

/// The assumed probability of a link without one: even odds of being within five degrees.
pub const UNKNOWN_PROBABILITY: f64 = 0.5;

/// Upper limit of a bearing's probability, its mirror's included: the largest calibrated one.
const MOST_SURE: f64 = 0.98;

/// A link as an equation for its receiver. The bearing's deviation is the one that corresponds to its probability (a normal
/// error is within five degrees with that probability; [`UNKNOWN_PROBABILITY`] if there is none), but at least the predicted
/// one.
fn sighting(row: &Judged) -> Option<Sighting> {
    let answer = &row.answer;
    // The probability that the bearing or its mirror is within five degrees: the place decides between the two.
    let either = |confidence: f64| confidence / (1.0 - answer.mirror_share.unwrap_or(0.0).min(0.5));
    let sure = answer.confidence.map_or(UNKNOWN_PROBABILITY, |confidence| either(confidence).min(MOST_SURE));
    let horizontal = horizontal(answer);
    let azimuth_sd_rad = deviation_rad(sure).max(answer.azimuth_sd_deg.unwrap_or(0.0).to_radians());
    let range_m = answer.range_m.zip(answer.range_sd_m).map(|(range, sd)| (range * horizontal, sd * horizontal));
    let mut sighting = Sighting::new(row.true_transmitter_m?.into(), answer.azimuth_deg?.to_radians(), azimuth_sd_rad);
    let elevation = answer.elevation_deg.zip(answer.elevation_sd_deg).zip(row.transmitter_z_m);
    sighting.elevation = elevation.map(|((elevation_deg, sd_deg), transmitter_z_m)| Elevation {
        transmitter_z_m,
        elevation_rad: elevation_deg.to_radians(),
        sd_rad: sd_deg.to_radians(),
    });
    (sighting.mirror_rad, sighting.range_m) = (answer.mirror_deg.map(f64::to_radians), range_m);
    sighting.others = others(answer);
    Some(sighting)
}

fn wrap_deg(angle: f64) -> f64 {
    wrap_rad(angle.to_radians()).to_degrees()
}

/// The candidates besides the answer and its mirror, radians, each with its evidence relative to the answer's.
fn others(answer: &Answer) -> Vec<(f64, f64)> {
    let off = |candidate: &CandidateAnswer, azimuth_deg: f64| wrap_deg(candidate.azimuth_deg - azimuth_deg).abs();
    let Some(azimuth_deg) = answer.azimuth_deg else { return Vec::new() };
    let nearest = answer.candidates.iter().min_by(|a, b| off(a, azimuth_deg).total_cmp(&off(b, azimuth_deg)));
    let Some(own) = nearest.filter(|own| own.share > 0.0) else { return Vec::new() };
    let is_mirror = |other: &CandidateAnswer| answer.mirror_deg.is_some_and(|mirror| off(other, mirror) < WRONG_DEG);
    let beside = answer.candidates.iter().filter(|other| !std::ptr::eq(*other, own) && !is_mirror(other));
    beside.map(|other| (other.azimuth_deg.to_radians(), other.share / own.share)).collect()
}

/// Standard deviation of a normal error that is within five degrees with probability `sure`: inverts the error function by
/// bisection.
fn deviation_rad(sure: f64) -> f64 {
    let (mut low, mut high) = (0.1, 6.0);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if within(middle) < sure { low = middle } else { high = middle }
    }
    WRONG_DEG.to_radians() / high
}

/// Probability that a normal error is within `x` deviations (Simpson's rule on the density).
fn within(x: f64) -> f64 {
    let n = 64;
    let h = x / f64::from(n);
    let density = |k: i32| (-0.5 * (h * f64::from(k)).powi(2)).exp();
    let inner: f64 = (1..n).map(|k| density(k) * if k % 2 == 1 { 4.0 } else { 2.0 }).sum();
    2.0 * h / 3.0 * (density(0) + inner + density(n)) / std::f64::consts::TAU.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::pipeline::Answer;

    fn row(link: &str, azimuth_deg: f64, error_deg: f64, confidence: f64) -> Judged {
        let mut answer = Answer::failed(link.into(), String::new());
        (answer.error, answer.azimuth_deg, answer.confidence) = (None, Some(azimuth_deg), Some(confidence));
        Judged { answer, error_from_mean_pose_deg: Some(error_deg), ..Judged::default() }
    }

    #[test]
    fn refusing_the_unsure_lowers_the_error() {
        let rows: Vec<Judged> = (0..10).map(|k| row("a/x", 0.0, f64::from(k), 1.0 - f64::from(k) * 0.1)).collect();
        let curve = risk_coverage(&rows);
        assert_eq!(curve.len(), 6);
        assert_eq!((curve[0].errors.links, curve[5].errors.links), (10, 5));
        assert!((curve[5].errors.mean_deg - 2.0).abs() < 1e-12 && (curve[0].errors.mean_deg - 4.5).abs() < 1e-12);
        assert!(risk_coverage(&[]).is_empty());
    }

    #[test]
    fn correct_deviations_have_a_scale_of_one() {
        let with_sd = |k: i32| {
            let mut row = row("a/x", 0.0, f64::from(k), 0.5);
            row.answer.azimuth_sd_deg = Some(10.0);
            row
        };
        // Half of all normal errors are within 0.6745 deviations.
        let rows: Vec<Judged> = (-13..=13).map(with_sd).collect();
        let rows: Vec<&Judged> = rows.iter().collect();
        assert!((over_bound(&rows).unwrap() - 0.7 / 0.674_5).abs() < 1e-9, "{:?}", over_bound(&rows));
        assert_eq!(over_bound(&[]), None);
        assert_eq!(ranges(&rows), Ranges { links: 0, reported: 0, median_m: None, over_bound: None, places: [0; 3] });
        // At an elevation of 60 degrees, half a slant deviation is a whole horizontal one.
        let slant = |elevation_deg: f64| {
            let mut row = row("a/x", 0.0, 0.0, 0.5);
            row.answer.abs_elevation_deg = Some(elevation_deg);
            (row.answer.range_sd_m, row.range_error_m, row.true_range_m) = (Some(0.2), Some(0.1), Some(3.0));
            ranges(&[&row])
        };
        assert!((slant(60.0).over_bound.unwrap() - 1.0 / 0.674_5).abs() < 1e-9, "{:?}", slant(60.0));
        assert!((slant(0.0).over_bound.unwrap() - 0.5 / 0.674_5).abs() < 1e-9, "{:?}", slant(0.0));
    }

    #[test]
    fn a_receiver_is_where_its_bearings_meet() {
        let seen = |name: &str, tx: [f64; 2]| Judged {
            true_transmitter_m: Some(tx),
            true_receiver_m: Some([1.0, 2.0]),
            ..row(&format!("place/stamp/{name}"), (tx[1] - 2.0).atan2(tx[0] - 1.0).to_degrees(), 0.0, 0.9)
        };
        let found = receivers(&[seen("tx2", [4.0, 2.5]), seen("tx3", [1.5, -3.0]), seen("tx4", [-2.0, 4.0])]);
        assert_eq!((found.len(), found[0].links, found[0].capture.as_str()), (1, 3, "place/stamp"));
        assert!(found[0].off_m.unwrap() < 1e-6 && found[0].height_m.is_none());
        assert!(found[0].azimuth_errors_deg.is_empty(), "no true bearing was given");
        // 45 degrees up to a transmitter whose height is given.
        let mut rows = [seen("tx2", [4.0, 2.0]), seen("tx3", [1.5, -3.0]), seen("tx4", [-2.0, 4.0])];
        rows[0].transmitter_z_m = Some(3.5);
        (rows[0].answer.elevation_deg, rows[0].answer.elevation_sd_deg) = (Some(45.0), Some(1.0));
        assert!(
            (receivers(&rows)[0].height_m.unwrap() - 0.5).abs() < 1e-6
                && receivers(&rows)[0].height_sd_m.unwrap() > 0.05
        );
    }

    #[test]
    fn a_place_chooses_among_the_candidates_of_a_link() {
        let receiver = [1.0, 2.0];
        let seen = |name: &str, tx: [f64; 2], off_deg: f64| {
            let truth = (tx[1] - receiver[1]).atan2(tx[0] - receiver[0]).to_degrees();
            let mut row = row(&format!("place/stamp/{name}"), truth + off_deg, off_deg, 0.6);
            (row.true_transmitter_m, row.true_from_mean_pose_deg) = (Some(tx), Some(truth));
            row
        };
        let candidate =
            |azimuth_deg: f64, share: f64| CandidateAnswer { azimuth_deg, share, ..CandidateAnswer::default() };
        let mut rows = [seen("tx2", [4.0, 2.5], 0.5), seen("tx3", [1.5, -3.0], 60.0), seen("tx4", [-2.0, 4.0], -0.5)];
        let truth = rows[1].true_from_mean_pose_deg.unwrap();
        // 360 degrees away is the same candidate; an answer that matches none has no name.
        rows[1].answer.candidates = vec![candidate(truth + 60.0 - 360.0, 0.6), candidate(truth, 0.4)];
        let found = &receivers(&rows)[0];
        assert!((found.azimuths_deg[1] - truth).abs() < 1e-9 && found.azimuth_errors_deg[1].abs() < 1e-9);
        assert_eq!((found.answer_errors_deg[1], found.names[1].as_str()), (60.0, "place/stamp/tx3"));
        assert!((found.position_m.unwrap()[0] - 1.0).hypot(found.position_m.unwrap()[1] - 2.0) < 0.1, "{found:?}");
        rows[1].answer.mirror_deg = Some(truth);
        assert!(others(&rows[1].answer).is_empty(), "a mirror is no other candidate");
    }

    #[test]
    fn a_deviation_corresponds_to_its_confidence() {
        // 68.27 % within one deviation, 95.45 % within two.
        assert!((deviation_rad(0.682_689).to_degrees() - 5.0).abs() < 0.01);
        assert!((deviation_rad(0.954_5).to_degrees() - 2.5).abs() < 0.01);
    }
}
