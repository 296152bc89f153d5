//! Locates receivers from their links to transmitters at known places, each by a graph of `csi5300-team`.
//!
//! The receiver is a robot with one keyframe at the middle of its trajectory, the origin of its bearings, and one at each
//! range from another sensor. Its yaw has a prior with the heading's deviation. A link is a mixture of its candidates and
//! its mirror. Their deviation is that of the answer: its error bar or, if larger, the one that its probability implies.

use super::captures::{Capture, TrajectorySource};
use super::judge::Judged;
use crate::{Failure, wrap_deg};
use csi5300::motion::pose::Trajectory;
pub use csi5300_team::answers::UNKNOWN_PROBABILITY;
use csi5300_team::answers::{AZIMUTH_FLOOR_DEG, LINK_OUTLIERS, RANGE_OUTLIERS, Way, ways};
use csi5300_team::{KeyframeId, Mode, OdometryNoise, Solution, Team, TeamError};
use nalgebra::{Matrix2, Vector2};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Deviation of known places, metres.
pub(super) const PLACE_SD_M: f64 = 0.01;

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

/// The noise of odometry whose heading has this deviation, radians.
pub(super) fn noise(heading_sd_rad: f64) -> OdometryNoise {
    OdometryNoise {
        turn_rad_per_rt_m: heading_sd_rad.max(TURN_RAD_PER_RT_M),
        slip: SLIP,
        bias_sd_rad_per_m: TURN_RAD_PER_RT_M,
        scale_sd: SLIP,
    }
}

impl Capture {
    /// The antenna's trajectory by `source`.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn path(&self, source: TrajectorySource) -> Result<Trajectory, Failure> {
        self.trajectory(source, &mut Vec::new())
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

/// A transmitter at an unknown place, located with the receivers of several captures.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Shared {
    /// Its name in every capture.
    pub transmitter: String,
    /// Number of captures with a bearing of it.
    pub captures: usize,
    /// Position, metres.
    pub position_m: [f64; 2],
    /// Its covariance, metres squared, row by row.
    pub covariance_m2: [[f64; 2]; 2],
    /// Other positions that fit nearly as well, the likeliest first, metres.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub others_m: Vec<[f64; 2]>,
}

/// What the links of captures locate.
#[derive(Clone, Debug, Default)]
pub struct Located {
    /// The receivers, one for each capture.
    pub receivers: Vec<Receiver>,
    /// Transmitters at unknown places.
    pub transmitters: Vec<Shared>,
    /// The graph with its solution: of the captures as one, or of the only capture.
    pub graph: Option<(Team, Solution)>,
}

/// Locates the receiver of every capture from its links to transmitters at known places.
#[must_use]
pub fn receivers(rows: &[Judged]) -> Vec<Receiver> {
    receivers_with(rows, &BTreeMap::new(), false).receivers
}

/// As [`receivers`], with ranges from another sensor by capture.
///
/// With `stand`, transmitters of one name stand at one place in all captures. Captures that share such a transmitter at an
/// unknown place then make one graph, which locates it too.
#[must_use]
pub fn receivers_with(rows: &[Judged], ranges: &BTreeMap<String, Vec<Ranged>>, stand: bool) -> Located {
    let mut by_name: BTreeMap<&str, Vec<&Judged>> = BTreeMap::new();
    for row in rows {
        let name = row.answer.link.rsplit_once('/').map_or("", |(capture, _)| capture);
        by_name.entry(name).or_default().push(row);
    }
    let ranges = |name: &str| ranges.get(name).map(Vec::as_slice).unwrap_or_default();
    let captures: Vec<Links<'_>> =
        by_name.into_iter().map(|(name, rows)| Links { name, rows, ranges: ranges(name) }).collect();
    let mut located = if stand { as_one(&captures) } else { Located::default() };
    let mut graphs = Vec::new();
    for links in &captures {
        if located.receivers.iter().all(|own| own.capture != links.name) {
            let own = links.locate();
            located.receivers.extend(own.receivers);
            graphs.extend(own.graph);
        }
    }
    located.receivers.sort_by(|a, b| a.capture.cmp(&b.capture));
    let alone = || graphs.pop().filter(|_| graphs.is_empty());
    located.graph = located.graph.or_else(alone);
    located
}

/// The captures that share transmitters at unknown places, as one graph. Captures and transmitters that it does not determine
/// are removed from it.
fn as_one(captures: &[Links<'_>]) -> Located {
    let mut left: Vec<&Links<'_>> = captures.iter().collect();
    let mut lost: BTreeSet<String> = BTreeSet::new();
    loop {
        let known = known(&left);
        let mut shared: BTreeMap<&str, usize> = BTreeMap::new();
        for links in &left {
            let unknown = |name: &&str| !known.contains_key(*name) && !lost.contains(*name);
            let names: BTreeSet<&str> =
                links.seen(|_| true).into_iter().map(Judged::transmitter).filter(unknown).collect();
            names.into_iter().for_each(|name| *shared.entry(name).or_default() += 1);
        }
        shared.retain(|_, captures| *captures > 1);
        if shared.is_empty() {
            return Located::default();
        }
        let is_used = |name: &str| shared.contains_key(name) || known.contains_key(name);
        left.retain(|links| links.lack(&links.seen(is_used)).is_none());
        let mut graph = Joint::default();
        let solved = left
            .iter()
            .try_for_each(|links| graph.add(links, &links.seen(is_used), Some(&known)))
            .and_then(|()| graph.team.solve());
        match solved {
            Ok(found) => return graph.located(&left, &shared, found),
            Err(TeamError::Undetermined { robot } | TeamError::Unlinked { robot }) => {
                let count = left.len();
                left.retain(|links| links.name != robot);
                if left.len() == count && !lost.insert(robot) {
                    return Located::default();
                }
            }
            Err(_) => return Located::default(),
        }
    }
}

/// Known places by names. A name with several places is none of a transmitter that stands.
fn known<'a>(captures: &[&Links<'a>]) -> BTreeMap<&'a str, [f64; 2]> {
    let mut places: BTreeMap<&str, Vec<[f64; 2]>> = BTreeMap::new();
    for row in captures.iter().flat_map(|links| &links.rows) {
        places.entry(row.transmitter()).or_default().extend(row.true_transmitter_m);
    }
    let one = |(name, all): (&'a str, Vec<[f64; 2]>)| {
        let first = all.first().copied()?;
        all.iter().all(|place| *place == first).then_some((name, first))
    };
    places.into_iter().filter_map(one).collect()
}

/// The links of a capture.
struct Links<'a> {
    /// Name of the capture.
    name: &'a str,
    rows: Vec<&'a Judged>,
    ranges: &'a [Ranged],
}

impl<'a> Links<'a> {
    /// The links with a bearing to transmitters whose place is known, here or by `is_known`.
    fn seen(&self, is_known: impl Fn(&str) -> bool) -> Vec<&'a Judged> {
        let is_placed = |row: &&&Judged| row.true_transmitter_m.is_some() || is_known(row.transmitter());
        let has_bearing = |row: &&&Judged| row.answer.azimuth_deg.is_some_and(f64::is_finite);
        self.rows.iter().filter(has_bearing).filter(is_placed).copied().collect()
    }

    /// Why these links locate nothing, if they are too few.
    fn lack(&self, seen: &[&Judged]) -> Option<String> {
        let count = seen.len();
        let bearings = if count == 1 { "bearing" } else { "bearings" };
        (count < 2 && self.ranges.is_empty() && seen.iter().all(|row| row.answer.range_m.is_none())).then(|| {
            format!("{count} usable {bearings} and no range: a position needs two bearings, or one bearing and a range")
        })
    }

    fn receiver(&self, seen: &[&Judged]) -> Receiver {
        Receiver {
            capture: self.name.into(),
            links: seen.len(),
            names: seen.iter().map(|row| row.answer.link.clone()).collect(),
            without_probability: seen.iter().filter(|row| row.answer.confidence.is_none()).count(),
            true_position_m: self.rows.iter().find_map(|row| row.true_receiver_m),
            ..Receiver::default()
        }
    }

    /// The receiver from these links alone, with its graph.
    fn locate(&self) -> Located {
        let seen = self.seen(|_| false);
        let mut graph = Joint::default();
        let solved = match self.lack(&seen) {
            Some(lack) => Err(lack),
            None => graph.add(self, &seen, None).and_then(|()| graph.team.solve()).map_err(|error| error.to_string()),
        };
        match solved {
            Ok(found) => graph.located(&[self], &BTreeMap::new(), found),
            Err(error) => {
                let receiver = Receiver { error: Some(error), ..self.receiver(&seen) };
                Located { receivers: vec![receiver], ..Located::default() }
            }
        }
    }
}

/// A graph of captures.
#[derive(Default)]
struct Joint {
    team: Team,
    /// The transmitters: those of known places that differ between captures with the capture's name before their own.
    places: BTreeMap<String, KeyframeId>,
    own: Vec<Graph>,
}

/// A receiver in the graph.
struct Graph {
    /// Keyframe at the middle of the receiver's motion.
    middle: KeyframeId,
    /// For each link, its place in the graph, its transmitter, and its possible bearings, in the order of its modes.
    links: Vec<(usize, KeyframeId, Vec<Way>)>,
    /// The places of the ranges in the graph.
    ranges: Vec<usize>,
}

impl Joint {
    /// Adds a capture. `known` are places of transmitters that stand, if there are several captures.
    fn add(
        &mut self,
        links: &Links<'_>,
        seen: &[&Judged],
        known: Option<&BTreeMap<&str, [f64; 2]>>,
    ) -> Result<(), TeamError> {
        let Links { name: capture, rows, ranges } = links;
        let heading_sd_rad = rows.iter().find_map(|row| row.heading_sd_rad).unwrap_or_default();
        let noise = noise(heading_sd_rad);
        let team = &mut self.team;
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
        let mut own_places = BTreeMap::new();
        for row in rows {
            let name = row.transmitter();
            let place_m = row.true_transmitter_m.or_else(|| known?.get(name).copied());
            let is_seen = seen.iter().any(|seen| seen.transmitter() == name);
            if place_m.is_none() && !is_seen {
                continue;
            }
            // One whose place is another in another capture is another robot.
            let is_one = known.is_none_or(|known| known.contains_key(name)) || place_m.is_none();
            let key = if is_one { name.to_owned() } else { format!("{capture}/{name}") };
            let keyframe = match self.places.get(&key) {
                Some(keyframe) => *keyframe,
                None => {
                    let robot = team.robot(&key, false, noise)?;
                    let [x, y] = place_m.unwrap_or_default();
                    let keyframe = team.keyframe(robot, middle_t_s, [x, y, 0.0], 0.0)?;
                    if place_m.is_some() {
                        team.prior(keyframe, [x, y, 0.0], [PLACE_SD_M, PLACE_SD_M, free])?;
                    }
                    keyframe
                }
            };
            self.places.insert(key, keyframe);
            own_places.insert(name, keyframe);
        }
        let mut graph = Graph { middle, links: Vec::new(), ranges: Vec::new() };
        for row in seen {
            let own = ways(&row.answer, heading_sd_rad.to_degrees());
            let Some(place) = own_places.get(row.transmitter()) else { continue };
            let modes: Vec<Mode> = own.iter().map(|way| way.mode).collect();
            graph.links.push((team.link(middle, *place, &modes, LINK_OUTLIERS)?, *place, own));
        }
        for range in *ranges {
            let Some(place) = own_places.get(range.transmitter.as_str()) else { continue };
            let [range_m, sd_m] = range.range_m;
            graph.ranges.push(team.link(at(range.t_s), *place, &[Mode::range(range_m, sd_m, 1.0)], RANGE_OUTLIERS)?);
        }
        self.own.push(graph);
        Ok(())
    }

    /// What the solved graph locates.
    fn located(self, captures: &[&Links<'_>], shared: &BTreeMap<&str, usize>, found: Solution) -> Located {
        let known = known(captures);
        let is_used = |name: &str| shared.contains_key(name) || known.contains_key(name);
        let receiver = |(links, own): (&&Links<'_>, &Graph)| {
            let seen = links.seen(is_used);
            let mut receiver = links.receiver(&seen);
            own.fill(&mut receiver, &seen, &found);
            receiver
        };
        let receivers = captures.iter().zip(&self.own).map(receiver).collect();
        let place = |(name, captures): (&&str, &usize)| {
            let keyframe = *self.places.get(*name)?;
            let (position_m, covariance_m2, others_m) = place(&found, keyframe);
            Some(Shared { transmitter: (*name).to_owned(), captures: *captures, position_m, covariance_m2, others_m })
        };
        let transmitters = shared.iter().filter_map(place).collect();
        Located { receivers, transmitters, graph: Some((self.team, found)) }
    }
}

/// Position of a keyframe, its covariance, and other positions that fit nearly as well.
pub(super) fn place(found: &Solution, keyframe: KeyframeId) -> ([f64; 2], [[f64; 2]; 2], Vec<[f64; 2]>) {
    let xy = |[x, y, _]: [f64; 3]| [x, y];
    let covariance_m2 = found.covariance(keyframe).fixed_view::<2, 2>(0, 0).into_owned();
    let others = found.others.iter().map(|other| xy(other.poses[keyframe.index()])).collect();
    (xy(found.pose(keyframe)), covariance_m2.into(), others)
}

impl Graph {
    fn fill(&self, receiver: &mut Receiver, seen: &[&Judged], found: &Solution) {
        let ([x, y], covariance_m2, others_m) = place(found, self.middle);
        let at = Vector2::new(x, y);
        receiver.position_m = Some([x, y]);
        receiver.covariance_m2 = Some(covariance_m2);
        receiver.off_m = receiver.true_position_m.map(|truth| (at - Vector2::from(truth)).norm());
        receiver.others_m = others_m;
        receiver.ranges = [self.ranges.len(), self.ranges.iter().filter(|link| found.chosen[**link].is_none()).count()];
        let mut elevations = Vec::new();
        for (row, (link, keyframe, ways)) in seen.iter().zip(&self.links) {
            let [tx, ty] = row.true_transmitter_m.unwrap_or_else(|| place(found, *keyframe).0);
            let direction_deg = (ty - y).atan2(tx - x).to_degrees();
            let off = |way: &&Way| wrap_deg(way.azimuth_deg - direction_deg).abs();
            let nearest = || ways.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
            let chosen = found.chosen[*link];
            let Some(way) = chosen.and_then(|k| ways.get(k)).or_else(nearest) else { continue };
            receiver.weights.push(if chosen.is_some() { 1.0 } else { 0.0 });
            receiver.azimuths_deg.push(way.azimuth_deg);
            elevations.extend(elevation(row, [tx, ty]).filter(|_| way.is_answer && chosen.is_some()));
        }
        let chosen = seen.iter().zip(&receiver.azimuths_deg);
        let errors = chosen.map(|(row, azimuth)| Some(wrap_deg(azimuth - row.true_from_mean_pose_deg?)));
        receiver.azimuth_errors_deg = errors.collect::<Option<_>>().unwrap_or_default();
        let errors = seen.iter().map(|row| row.error_from_mean_pose_deg);
        receiver.answer_errors_deg = errors.collect::<Option<_>>().unwrap_or_default();
        (receiver.height_m, receiver.height_sd_m) = height(&at, &covariance_m2.into(), &elevations).unzip();
    }
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

/// The height at `at` and its deviation: mean over the elevations, weighted by inverse variance. They share the errors of
/// the position, which do not average out.
fn height(at: &Vector2<f64>, covariance_m2: &Matrix2<f64>, elevations: &[Elevation]) -> Option<(f64, f64)> {
    let (mut sum, mut height_m, mut along) = (0.0, 0.0, Vector2::zeros());
    for own in elevations {
        let to = own.transmitter_m - at;
        let distance = to.norm().max(1e-3);
        let (tan, sd_m) = (own.elevation_rad.tan(), distance * own.sd_rad / own.elevation_rad.cos().powi(2));
        let share = 1.0 / (sd_m * sd_m);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::judge::row;
    use csi5300::pipeline::{Answer, CandidateAnswer};

    /// A link from a receiver to a transmitter whose bearing is off by so much.
    fn link(name: &str, from: [f64; 2], to: [f64; 2], off_deg: f64) -> Judged {
        let truth_deg = (to[1] - from[1]).atan2(to[0] - from[0]).to_degrees();
        let row = row(name, truth_deg + off_deg, off_deg, 0.9);
        Judged { true_transmitter_m: Some(to), true_receiver_m: Some(from), ..row }
    }

    #[test]
    fn a_receiver_is_located_where_its_bearings_cross() {
        let seen = |name: &str, tx: [f64; 2]| link(&format!("place/stamp/{name}"), [1.0, 2.0], tx, 0.0);
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
    }

    const RECEIVER: [f64; 2] = [0.3, -0.4];
    const ROBOTS: [[f64; 2]; 4] = [[-2.4, 2.7], [2.5, -2.7], [-3.7, -1.5], [3.0, 3.0]];

    fn seen(k: usize, off_deg: f64) -> Judged {
        link(&format!("a/tx{k}"), RECEIVER, ROBOTS[k], off_deg)
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
        let located = receivers_with(&[one, silent], &BTreeMap::from([("a".to_owned(), ranges)]), false);
        let found = &located.receivers[0];
        assert!(found.others_m.is_empty() && found.off_m.unwrap() < 0.05 && found.ranges == [3, 1], "{found:?}");
        assert!(located.graph.is_some());
    }

    #[test]
    fn captures_that_share_an_unknown_transmitter_are_one_graph() {
        let (known, unknown) = ([[4.0, 0.0], [0.0, 5.0]], [-3.0, 2.0]);
        let places = [("a", [0.0, 0.0]), ("b", [1.0, -3.0]), ("c", [3.0, 3.0])];
        let mut rows = Vec::new();
        for (capture, at) in &places {
            // Capture c has a bearing of one known place only.
            let count = if *capture == "c" { 1 } else { 2 };
            rows.extend((0..count).map(|k| link(&format!("{capture}/tx{k}"), *at, known[k], 0.0)));
            rows.push(Judged { true_transmitter_m: None, ..link(&format!("{capture}/tx9"), *at, unknown, 0.0) });
        }
        let alone = receivers_with(&rows, &BTreeMap::new(), false);
        assert!(alone.transmitters.is_empty() && alone.graph.is_none());
        assert!(alone.receivers[2].error.as_ref().is_some_and(|why| why.starts_with("1 usable bearing")));
        let one = receivers_with(&rows, &BTreeMap::new(), true);
        for (receiver, (name, _)) in one.receivers.iter().zip(&places) {
            assert_eq!((receiver.capture.as_str(), receiver.links), (*name, if *name == "c" { 2 } else { 3 }));
            assert!(receiver.off_m.unwrap() < 1e-3 && receiver.weights.iter().all(|own| *own == 1.0), "{receiver:?}");
        }
        let found = &one.transmitters[0];
        let off_m = (found.position_m[0] - unknown[0]).hypot(found.position_m[1] - unknown[1]);
        assert!(one.transmitters.len() == 1 && found.captures == 3 && off_m < 1e-3, "{found:?}");
        // Further bearings cannot make a receiver less certain.
        let trace = |own: &Receiver| own.covariance_m2.map(|own| own[0][0] + own[1][1]).unwrap();
        (0..2).for_each(|k| assert!(trace(&one.receivers[k]) < trace(&alone.receivers[k]) + 1e-12));
        // Names of different places are different robots, and connect nothing.
        let (team, _) = one.graph.unwrap();
        assert!(team.named("tx9").is_ok() && team.named("tx0").is_ok() && team.named("c").is_ok());
        let mut apart = rows.clone();
        apart[0].true_transmitter_m = Some([40.0, 0.0]);
        let (team, _) = receivers_with(&apart, &BTreeMap::new(), true).graph.unwrap();
        assert!(team.named("a/tx0").is_ok() && team.named("b/tx0").is_ok() && team.named("tx0").is_err());
        // One bearing of an unknown place is of no use.
        let one = receivers_with(&rows[..3], &BTreeMap::new(), true);
        assert!(one.transmitters.is_empty() && one.receivers[0].links == 2 && one.graph.is_some(), "{one:?}");
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
}
