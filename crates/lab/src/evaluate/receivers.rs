//! Locates receivers from their links to transmitters at known places, each by a graph of `csi5300-team`.
//!
//! The receiver is a robot with one keyframe at the middle of its trajectory, the origin of its bearings, and one at each
//! range from another sensor. Its yaw has a prior with the heading's deviation. A link is a mixture of its candidates and
//! its mirror. Their deviation is that of the answer: its error bar or, if larger, the one that its probability implies.

use super::find::{Capture, TrajectorySource};
use super::judge::Judged;
use super::quality::horizontal;
use super::shelf::Shelf;
use super::sure::WRONG_DEG;
use super::truth::EvaluateError;
use csi5300::maths::wrap_rad;
use csi5300::motion::pose::Trajectory;
use csi5300::pipeline::{Answer, CandidateAnswer};
use csi5300_team::{KeyframeId, Mode, OdometryNoise, Solution, Team, TeamError};
use nalgebra::{Matrix2, Vector2};
use serde::Serialize;
use std::collections::BTreeMap;

/// Least deviation of a bearing, degrees (the median error in line of sight is about 1 degree, whatever the predicted one).
const AZIMUTH_FLOOR_DEG: f64 = 1.15;

/// Outlier share of links.
const LINK_OUTLIERS: f64 = 0.1;

/// Ranges from the wave front: least relative deviation, and share of wrong ones.
const RANGE_FLOOR: f64 = 0.3;
const RANGE_MISSED: f64 = 0.5;

/// Upper limit of a link's probability that one of its bearings is within 5 degrees; close to the largest calibrated one.
const MOST_SURE: f64 = 0.95;

/// Probability assumed for an answer without one: it is within 5 degrees as often as not.
pub const UNKNOWN_PROBABILITY: f64 = 0.5;

/// Outlier share of another sensor's ranges: reflections, or ranges of another robot.
const RANGE_OUTLIERS: f64 = 0.1;

/// Deviation of the transmitters' known places, metres.
const PLACE_SD_M: f64 = 0.01;

/// Least deviation of a heading after one metre, radians (motion capture: 0.2 degrees), and relative error of lengths.
const TURN_RAD_PER_RT_M: f64 = 0.003_5;
const SLIP: f64 = 0.01;

/// A range between a receiver and a transmitter, from another sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranged {
    /// The transmitter's name: `tx2`.
    pub transmitter: String,
    /// Time on the trajectory's clock, seconds.
    pub t_s: f64,
    /// Position of the receiver's antenna at that time, in the frame of its trajectory, metres.
    pub from_m: [f64; 2],
    /// The range and its standard deviation, metres.
    pub range_m: [f64; 2],
}

impl Capture {
    /// The antenna's trajectory by `source`.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn path(&self, source: TrajectorySource) -> Result<Trajectory, EvaluateError> {
        self.trajectory(&Shelf::default(), source, &mut Vec::new())
    }
}

/// A receiver located from its links.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Receiver {
    /// Name of the capture.
    pub capture: String,
    /// Number of usable links.
    pub links: usize,
    /// Their names, in the order of the lists below.
    pub names: Vec<String>,
    /// Links without a calibrated probability; [`UNKNOWN_PROBABILITY`] is used for them.
    #[serde(skip_serializing_if = "is_zero")]
    pub without_probability: usize,
    /// Position, metres, in the frame of the true transmitters.
    pub position_m: Option<[f64; 2]>,
    /// Its covariance, metres squared, row by row.
    pub covariance_m2: Option<[[f64; 2]; 2]>,
    /// Other positions that fit the links nearly as well, the likeliest first, metres.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub others_m: Vec<[f64; 2]>,
    /// Height, metres, if a link has an elevation and its transmitter's height is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height_m: Option<f64>,
    /// Standard deviation of the height, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height_sd_m: Option<f64>,
    /// Counts of another sensor's ranges: used, and outliers among them.
    #[serde(skip_serializing_if = "is_none")]
    pub ranges: [usize; 2],
    /// For each link, 1 if it is used, 0 if it is an outlier.
    pub weights: Vec<f64>,
    /// For each link, the bearing that fits the position, degrees: the answer, its mirror or another candidate.
    pub azimuths_deg: Vec<f64>,
    /// Their errors against the true bearings from the mean pose, degrees; empty unless all are known.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub azimuth_errors_deg: Vec<f64>,
    /// The same errors for the links' answers.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub answer_errors_deg: Vec<f64>,
    /// Why there is no position.
    pub error: Option<String>,
    /// True mean position of the motion, metres.
    pub true_position_m: Option<[f64; 2]>,
    /// Distance between the position and the true one, metres.
    pub off_m: Option<f64>,
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

fn is_none(counts: &[usize; 2]) -> bool {
    counts[0] == 0
}

/// Locates the receiver of every capture from its links to transmitters at known places.
#[must_use]
pub fn receivers(rows: &[Judged]) -> Vec<Receiver> {
    receivers_with(rows, &BTreeMap::new()).into_iter().map(|(receiver, _)| receiver).collect()
}

/// As [`receivers`], with ranges from another sensor by capture. Also returns the graph and solution of each located receiver.
#[must_use]
pub fn receivers_with(
    rows: &[Judged],
    ranges: &BTreeMap<String, Vec<Ranged>>,
) -> Vec<(Receiver, Option<(Team, Solution)>)> {
    let mut captures: BTreeMap<&str, Vec<&Judged>> = BTreeMap::new();
    for row in rows {
        let name = row.answer.link.rsplit_once('/').map_or("", |(capture, _)| capture);
        captures.entry(name).or_default().push(row);
    }
    let none = Vec::new();
    captures.into_iter().map(|(name, rows)| receiver(name, &rows, ranges.get(name).unwrap_or(&none))).collect()
}

fn receiver(capture: &str, rows: &[&Judged], ranges: &[Ranged]) -> (Receiver, Option<(Team, Solution)>) {
    let is_usable =
        |row: &&&Judged| row.answer.azimuth_deg.is_some_and(f64::is_finite) && row.true_transmitter_m.is_some();
    let seen: Vec<&Judged> = rows.iter().filter(is_usable).copied().collect();
    let mut receiver = Receiver {
        capture: capture.into(),
        links: seen.len(),
        names: seen.iter().map(|row| row.answer.link.clone()).collect(),
        without_probability: seen.iter().filter(|row| row.answer.confidence.is_none()).count(),
        true_position_m: rows.iter().find_map(|row| row.true_receiver_m),
        ..Receiver::default()
    };
    if seen.len() < 2 && ranges.is_empty() && seen.iter().all(|row| row.answer.range_m.is_none()) {
        let bearings = if seen.len() == 1 { "bearing" } else { "bearings" };
        let count = seen.len();
        receiver.error = Some(format!(
            "{count} usable {bearings} and no range: a position needs two bearings, or one bearing and a range"
        ));
        return (receiver, None);
    }
    match Graph::new(capture, rows, &seen, ranges).and_then(|graph| Ok((graph.team.solve()?, graph))) {
        Ok((found, graph)) => {
            graph.fill(&mut receiver, &seen, &found);
            (receiver, Some((graph.team, found)))
        }
        Err(error) => {
            receiver.error = Some(error.to_string());
            (receiver, None)
        }
    }
}

/// A possible bearing of a link.
#[derive(Clone, Copy)]
struct Way {
    azimuth_deg: f64,
    /// True for the answer's own bearing, to which the elevation belongs.
    is_answer: bool,
}

/// The graph of a receiver.
struct Graph {
    team: Team,
    /// Keyframe at the middle of the receiver's motion.
    middle: KeyframeId,
    /// For each link, the bearings of its modes, in their order.
    ways: Vec<Vec<Way>>,
    ranges: usize,
}

impl Graph {
    fn new(capture: &str, rows: &[&Judged], seen: &[&Judged], ranges: &[Ranged]) -> Result<Self, TeamError> {
        let heading_sd_rad = rows.iter().find_map(|row| row.heading_sd_rad).unwrap_or_default();
        let noise = OdometryNoise {
            turn_rad_per_rt_m: heading_sd_rad.max(TURN_RAD_PER_RT_M),
            slip: SLIP,
            bias_sd_rad_per_m: TURN_RAD_PER_RT_M,
            scale_sd: SLIP,
        };
        let mut team = Team::default();
        let own = team.robot(if capture.is_empty() { "rx" } else { capture }, true, noise)?;
        let origin_m = rows.iter().find_map(|row| row.answer.origin_m).unwrap_or_default();
        let middle_t_s = rows.iter().find_map(|row| row.middle_t_s).unwrap_or_default();
        let mut poses: Vec<(f64, [f64; 2])> = ranges.iter().map(|range| (range.t_s, range.from_m)).collect();
        poses.push((middle_t_s, [origin_m[0], origin_m[1]]));
        poses.sort_by(|a, b| a.0.total_cmp(&b.0));
        poses.dedup_by(|a, b| a.0 == b.0);
        let mut keyframes = Vec::new();
        for (t_s, [x, y]) in &poses {
            keyframes.push(team.keyframe(own, *t_s, [*x, *y, 0.0], 0.0)?);
        }
        let at = |t_s: f64| keyframes[poses.partition_point(|pose| pose.0 < t_s).min(keyframes.len() - 1)];
        let middle = at(middle_t_s);
        let free = f64::INFINITY;
        team.prior(middle, [0.0; 3], [free, free, heading_sd_rad.max(1e-4)])?;
        let mut places = BTreeMap::new();
        for row in rows {
            let (Some([x, y]), name) = (row.true_transmitter_m, transmitter(row)) else { continue };
            let robot = team.robot(name, false, noise)?;
            let keyframe = team.keyframe(robot, middle_t_s, [x, y, 0.0], 0.0)?;
            team.prior(keyframe, [x, y, 0.0], [PLACE_SD_M, PLACE_SD_M, free])?;
            places.insert(name, keyframe);
        }
        let mut ways = Vec::new();
        for row in seen {
            let (own, modes): (Vec<Way>, Vec<Mode>) =
                modes(&row.answer, heading_sd_rad.to_degrees()).into_iter().unzip();
            let Some(place) = places.get(transmitter(row)) else { continue };
            team.link(middle, *place, &modes, LINK_OUTLIERS)?;
            ways.push(own);
        }
        let mut used = 0;
        for range in ranges {
            let Some(place) = places.get(range.transmitter.as_str()) else { continue };
            let [range_m, sd_m] = range.range_m;
            team.link(at(range.t_s), *place, &[Mode::range(range_m, sd_m, 1.0)], RANGE_OUTLIERS)?;
            used += 1;
        }
        Ok(Self { team, middle, ways, ranges: used })
    }

    fn fill(&self, receiver: &mut Receiver, seen: &[&Judged], found: &Solution) {
        let [x, y, _] = found.pose(self.middle);
        let (at, covariance_m2) =
            (Vector2::new(x, y), found.covariance(self.middle).fixed_view::<2, 2>(0, 0).into_owned());
        receiver.position_m = Some([x, y]);
        receiver.covariance_m2 = Some(covariance_m2.into());
        receiver.off_m = receiver.true_position_m.map(|truth| (at - Vector2::from(truth)).norm());
        let other = |other: &csi5300_team::Other| {
            let [x, y, _] = other.poses[self.middle.index()];
            [x, y]
        };
        receiver.others_m = found.others.iter().map(other).collect();
        let chosen = &found.chosen[self.ways.len()..];
        receiver.ranges = [self.ranges, chosen.iter().filter(|chosen| chosen.is_none()).count()];
        let mut elevations = Vec::new();
        for ((row, ways), chosen) in seen.iter().zip(&self.ways).zip(&found.chosen) {
            let Some([tx, ty]) = row.true_transmitter_m else { continue };
            let direction_deg = (ty - y).atan2(tx - x).to_degrees();
            let off = |way: &&Way| wrap_deg(way.azimuth_deg - direction_deg).abs();
            let nearest = || ways.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
            let Some(way) = chosen.and_then(|k| ways.get(k)).or_else(nearest) else { continue };
            let weight = if chosen.is_some() { 1.0 } else { 0.0 };
            receiver.weights.push(weight);
            receiver.azimuths_deg.push(way.azimuth_deg);
            elevations
                .extend(elevation(row, [tx, ty]).filter(|_| way.is_answer && weight > 0.0).map(|own| (own, weight)));
        }
        let chosen = seen.iter().zip(&receiver.azimuths_deg);
        let errors = chosen.map(|(row, azimuth)| Some(wrap_deg(azimuth - row.true_from_mean_pose_deg?)));
        receiver.azimuth_errors_deg = errors.collect::<Option<_>>().unwrap_or_default();
        let errors = seen.iter().map(|row| row.error_from_mean_pose_deg);
        receiver.answer_errors_deg = errors.collect::<Option<_>>().unwrap_or_default();
        (receiver.height_m, receiver.height_sd_m) = height(&at, &covariance_m2, &elevations).unzip();
    }
}

fn transmitter(row: &Judged) -> &str {
    row.answer.link.rsplit('/').next().unwrap_or_default()
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

/// The possible bearings of a link and their modes. The answer and its mirror may have a range.
fn modes(answer: &Answer, heading_sd_deg: f64) -> Vec<(Way, Mode)> {
    let sd_rad = deviation_deg(answer, heading_sd_deg).to_radians();
    let horizontal = horizontal(answer);
    let known = answer.range_m.zip(answer.range_sd_m).filter(|(range, sd)| *range > 0.0 && sd.is_finite());
    let range_m = known.map(|(range, sd)| [range * horizontal, (sd * horizontal).hypot(RANGE_FLOOR * range)]);
    let mut modes = Vec::new();
    for (k, (azimuth_deg, share)) in bearings(answer).into_iter().enumerate() {
        let is_mirror = answer.mirror_deg.is_some_and(|mirror| wrap_deg(mirror - azimuth_deg).abs() < WRONG_DEG);
        let way = Way { azimuth_deg, is_answer: k == 0 };
        let mode = |share: f64| Mode::azimuth(azimuth_deg.to_radians(), sd_rad, share);
        match range_m.filter(|_| k == 0 || is_mirror) {
            Some(_) => {
                modes.push((way, Mode { range_m, ..mode(share * (1.0 - RANGE_MISSED)) }));
                modes.push((way, mode(share * RANGE_MISSED)));
            }
            None => modes.push((way, mode(share))),
        }
    }
    modes
}

/// A transmitter's place and height, and its elevation from the receiver.
struct Elevation {
    transmitter_m: Vector2<f64>,
    transmitter_z_m: f64,
    elevation_rad: f64,
    sd_rad: f64,
}

fn elevation(row: &Judged, transmitter_m: [f64; 2]) -> Option<Elevation> {
    let answer = &row.answer;
    let ((elevation_deg, sd_deg), transmitter_z_m) =
        answer.elevation_deg.zip(answer.elevation_sd_deg).zip(row.transmitter_z_m)?;
    let (elevation_rad, sd_rad) = (elevation_deg.to_radians(), sd_deg.hypot(AZIMUTH_FLOOR_DEG).to_radians());
    Some(Elevation { transmitter_m: transmitter_m.into(), transmitter_z_m, elevation_rad, sd_rad })
}

/// The height at `at` and its deviation: mean over the elevations, weighted by inverse variance and by the link's weight. They
/// share the errors of the position, which do not average out.
fn height(at: &Vector2<f64>, covariance_m2: &Matrix2<f64>, elevations: &[(Elevation, f64)]) -> Option<(f64, f64)> {
    let (mut sum, mut height_m, mut along) = (0.0, 0.0, Vector2::zeros());
    for (own, weight) in elevations {
        let to = own.transmitter_m - at;
        let distance = to.norm().max(1e-3);
        let (tan, sd_m) = (own.elevation_rad.tan(), distance * own.sd_rad / own.elevation_rad.cos().powi(2));
        let share = weight / (sd_m * sd_m);
        let own_m = own.transmitter_z_m - distance * tan;
        if share.is_finite() && own_m.is_finite() {
            sum += share;
            height_m += share * own_m;
            along += to * (share * tan / distance);
        }
    }
    let by_place = along / sum;
    let variance = 1.0 / sum + (by_place.transpose() * covariance_m2 * by_place)[0];
    (sum > 0.0).then(|| (height_m / sum, variance.sqrt()))
}

fn wrap_deg(angle: f64) -> f64 {
    wrap_rad(angle.to_radians()).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::super::judge::row;
    use super::*;

    #[test]
    fn a_receiver_is_located_where_its_bearings_cross() {
        let seen = |name: &str, tx: [f64; 2]| Judged {
            true_transmitter_m: Some(tx),
            true_receiver_m: Some([1.0, 2.0]),
            ..row(&format!("place/stamp/{name}"), (tx[1] - 2.0).atan2(tx[0] - 1.0).to_degrees(), 0.0, 0.9)
        };
        let found = receivers(&[seen("tx2", [4.0, 2.5]), seen("tx3", [1.5, -3.0]), seen("tx4", [-2.0, 4.0])]);
        assert_eq!((found.len(), found[0].links, found[0].capture.as_str()), (1, 3, "place/stamp"));
        assert!(found[0].off_m.unwrap() < 1e-6 && found[0].height_m.is_none());
        assert!(found[0].azimuth_errors_deg.is_empty(), "no true bearing is given");
        // Elevation of 45 degrees to a transmitter of known height.
        let mut rows = [seen("tx2", [4.0, 2.0]), seen("tx3", [1.5, -3.0]), seen("tx4", [-2.0, 4.0])];
        rows[0].transmitter_z_m = Some(3.5);
        (rows[0].answer.elevation_deg, rows[0].answer.elevation_sd_deg) = (Some(45.0), Some(1.0));
        assert!(
            (receivers(&rows)[0].height_m.unwrap() - 0.5).abs() < 1e-6
                && receivers(&rows)[0].height_sd_m.unwrap() > 0.05
        );
    }

    #[test]
    fn the_position_selects_among_the_candidates_of_a_link() {
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
        // A candidate 360 degrees away is the answer itself.
        rows[1].answer.candidates = vec![candidate(truth + 60.0 - 360.0, 0.6), candidate(truth, 0.4)];
        let found = &receivers(&rows)[0];
        assert!((found.azimuths_deg[1] - truth).abs() < 1e-9 && found.azimuth_errors_deg[1].abs() < 1e-9);
        assert_eq!((found.answer_errors_deg[1], found.names[1].as_str()), (60.0, "place/stamp/tx3"));
        assert!((found.position_m.unwrap()[0] - 1.0).hypot(found.position_m.unwrap()[1] - 2.0) < 0.1, "{found:?}");
        rows[1].answer.mirror_deg = Some(truth);
        assert_eq!(bearings(&rows[1].answer).len(), 2, "a mirror among the candidates is not added");
    }

    const RECEIVER: [f64; 2] = [0.3, -0.4];
    const ROBOTS: [[f64; 2]; 4] = [[-2.4, 2.7], [2.5, -2.7], [-3.7, -1.5], [3.0, 3.0]];

    fn seen(k: usize, off_deg: f64) -> Judged {
        let [x, y] = ROBOTS[k];
        let truth = (y - RECEIVER[1]).atan2(x - RECEIVER[0]).to_degrees();
        let row = row(&format!("a/tx{k}"), truth + off_deg, off_deg, 0.9);
        Judged { true_transmitter_m: Some([x, y]), true_receiver_m: Some(RECEIVER), ..row }
    }

    #[test]
    fn one_reflected_bearing_is_an_outlier() {
        let rows = [seen(0, 0.3), seen(1, 70.0), seen(2, 0.3), seen(3, 0.3)];
        let found = &receivers(&rows)[0];
        assert!(found.off_m.unwrap() < 0.1 && found.weights[1] == 0.0 && found.weights[0] == 1.0, "{found:?}");
    }

    #[test]
    fn a_heading_error_that_all_links_share_is_estimated() {
        let turned = |sd_deg: f64| {
            let rows: Vec<Judged> =
                (0..4).map(|k| Judged { heading_sd_rad: Some(f64::to_radians(sd_deg)), ..seen(k, 12.0) }).collect();
            receivers(&rows)[0].off_m.unwrap()
        };
        assert!(turned(10.0) < 0.1 && turned(0.1) > 0.3, "{} {}", turned(10.0), turned(0.1));
    }

    #[test]
    fn a_link_with_a_mirror_leaves_two_positions_and_ranges_leave_one() {
        let mut one = seen(3, 0.0);
        let azimuth_deg = one.answer.azimuth_deg.unwrap();
        (one.answer.mirror_deg, one.answer.mirror_share) = (Some(-azimuth_deg), Some(0.5));
        let range_m = (ROBOTS[3][0] - RECEIVER[0]).hypot(ROBOTS[3][1] - RECEIVER[1]);
        (one.answer.range_m, one.answer.range_sd_m) = (Some(range_m), Some(0.1));
        let found = receivers(std::slice::from_ref(&one)).remove(0);
        let mut places = vec![found.position_m.unwrap()];
        places.extend(&found.others_m);
        let near = |to: [f64; 2]| places.iter().filter(|at| (at[0] - to[0]).hypot(at[1] - to[1]) < 0.05).count();
        let mirrored = [RECEIVER[0], 2.0 * ROBOTS[3][1] - RECEIVER[1]];
        assert!(places.len() == 2 && near(RECEIVER) == 1 && near(mirrored) == 1, "{found:?}");
        // Ranges to a transmitter without a bearing: two good ones, and one that is 5 m too long.
        let silent = Judged { answer: Answer::failed("a/tx0".into(), String::new()), ..seen(0, 0.0) };
        let range = |t_s: f64, from_m: [f64; 2], late_m: f64| {
            let to = [ROBOTS[0][0] - RECEIVER[0] - from_m[0], ROBOTS[0][1] - RECEIVER[1] - from_m[1]];
            Ranged { transmitter: "tx0".into(), t_s, from_m, range_m: [to[0].hypot(to[1]) + late_m, 0.1] }
        };
        let ranges = vec![range(1.0, [0.5, 0.0], 0.0), range(2.0, [0.5, 0.5], 5.0), range(3.0, [0.0, 0.5], 0.0)];
        let (found, graph) = receivers_with(&[one, silent], &BTreeMap::from([("a".to_owned(), ranges)])).remove(0);
        assert!(found.others_m.is_empty() && found.off_m.unwrap() < 0.05 && found.ranges == [3, 1], "{found:?}");
        assert!(graph.is_some());
    }

    #[test]
    fn a_receiver_that_is_not_located_has_a_reason() {
        let found = &receivers(&[seen(0, 0.0)])[0];
        assert!(found.error.as_ref().is_some_and(|why| why.starts_with("1 usable bearing and no range")), "{found:?}");
        // Two links in the same direction do not cross.
        let mut rows = [seen(0, 0.0), seen(1, 0.0)];
        rows[1].answer.azimuth_deg = rows[0].answer.azimuth_deg;
        rows[1].true_transmitter_m = Some([ROBOTS[0][0] + 0.5, ROBOTS[0][1]]);
        let found = &receivers(&rows)[0];
        assert!(found.position_m.is_none() == found.error.is_some(), "{found:?}");
        // A NaN makes the link unusable.
        rows[1].answer.azimuth_deg = Some(f64::NAN);
        assert!(receivers(&rows)[0].error.is_some());
    }

    #[test]
    fn a_probability_implies_a_deviation() {
        // 68.27 % are within one deviation, 95.45 % within two.
        assert!((stands_for_deg(0.682_689) - 5.0).abs() < 0.01 && (stands_for_deg(0.954_5) - 2.5).abs() < 0.01);
        // The heading's share is subtracted, down to the floor.
        let answer = seen(0, 0.0).answer;
        assert!(deviation_deg(&answer, 0.0) > 2.0 && (deviation_deg(&answer, 5.0) - AZIMUTH_FLOOR_DEG).abs() < 1e-9);
    }
}
