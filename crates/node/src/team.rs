//! This robot and its peers as one graph of `csi5300-team`: its odometry, and its bearings of its peers.
//!
//! A bearing enters if it shares no sample with the peer's last one and every step of the estimate made it. It becomes a
//! keyframe of this robot at the mean position of its samples, with the axes of the odometry's frame, and a link. Ranges of
//! another sensor during it become links from this robot's positions at their times. Peers that stand are points. Those that
//! move and publish their poses have keyframes of their own.
//!
//! If places of peers are given, their frame is the team's. Otherwise it is the frame of this robot's odometry at the last keyframe.

use crate::config::{Config, Team as Asked};
use crate::lock;
use crate::machine::{Machine, PoseCounts};
use crate::threads::spawn;
use csi5300::maths::wrap_rad;
use csi5300::pipeline::Bearing;
use csi5300::pipeline::live::{PeerReport, PeerState};
use csi5300::source::Error;
use csi5300_team::answers::{LINK_OUTLIERS, RANGE_OUTLIERS, ways};
use csi5300_team::{KeyframeId, Mode, OdometryNoise, RobotId, Solution, Team, TeamError, factors};
use nalgebra::{Matrix3, Rotation2, Vector2, Vector3};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};

/// Bearings in a graph at most, and bearings and ranges; the oldest are forgotten.
const KEPT: usize = 48;
const LINKS: usize = 96;
/// Ranges during a bearing that become links, at these parts of its time: the errors of neighbours are not independent.
const PARTS: [f64; 2] = [0.25, 0.75];
/// Ranges to a peer that are kept for a bearing.
const RANGES: usize = 1_024;
/// Bytes of the factors at most: a message of ROS 2 holds 64,000.
const LARGEST: usize = 60_000;
/// Deviation of a given place, metres.
const PLACE_SD_M: f64 = 0.01;
/// Deviation of the keyframe that defines the frame, metres and radians.
const GAUGE_SD: f64 = 1e-3;
/// Least deviation between the axes of this robot's frame and those of a peer's, radians: 1 degree.
const AXES_SD_RAD: f64 = 0.017;
/// Steps in which paths are measured, so that noise at rest does not add up, metres.
const STEP_M: f64 = 0.02;
/// Least time between two keyframes of a robot, seconds.
const APART_S: f64 = 1e-6;

/// The team as solved last.
#[derive(Clone, Debug, Default, Serialize)]
pub struct TeamState {
    /// Name of the frame of given places; none in the frame of this robot's odometry.
    pub frame: Option<String>,
    /// Pose of the odometry's frame in the team's: x, y in metres, yaw in radians.
    pub odometry: [f64; 3],
    /// This robot, then the peers that the bearings determine.
    pub robots: Vec<Member>,
    /// Why there is no newer solution, or why peers are missing.
    pub notes: Vec<String>,
    /// Number of solutions so far.
    pub solved: u64,
    /// The graph with its solution, as [`csi5300_team::factors::json`].
    #[serde(skip)]
    pub factors: Arc<str>,
}

/// A robot of the team at its last keyframe; this robot at the end of its last bearing.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Member {
    /// Its name.
    pub name: String,
    /// Host time, seconds since the Unix epoch.
    pub t_s: f64,
    /// Place in the team's frame, metres.
    pub position_m: [f64; 2],
    /// This robot's heading, radians.
    pub heading_rad: Option<f64>,
    /// Covariance of x, y and heading, row by row, metres and radians; zeros for the heading of a peer.
    pub covariance: [[f64; 3]; 3],
    /// Other places that fit nearly as well, the likeliest first.
    pub others_m: Vec<[f64; 2]>,
}

/// A bearing in the graph, and ranges during it.
#[derive(Clone, Debug)]
struct Seen {
    peer: String,
    /// Host times of the first and the last sample, seconds.
    span_s: [f64; 2],
    /// The bearing, then ranges.
    links: Vec<Link>,
    /// This robot at the last sample.
    end_m: Vector2<f64>,
    heading_rad: Option<f64>,
}

/// A bearing or a range.
#[derive(Clone, Debug)]
struct Link {
    t_s: f64,
    /// This robot, in the frame of its odometry.
    own: Stretch,
    /// The peer, with the axes of that frame; `None` if it stands.
    other: Option<Stretch>,
    modes: Vec<Mode>,
    outliers: f64,
}

/// A robot's motion during a bearing: its mean position, or that of a range, and its mean speed.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    at_m: Vector2<f64>,
    speed_m_per_s: f64,
}

impl Stretch {
    fn of(path_m: &[Vector3<f64>], seconds: f64) -> Self {
        let at_m = path_m.iter().sum::<Vector3<f64>>().xy() / path_m.len().max(1) as f64;
        let (mut length_m, mut last) = (0.0, path_m.first().map(Vector3::xy).unwrap_or_default());
        for at in path_m.iter().map(Vector3::xy) {
            let step_m = (at - last).norm();
            if step_m >= STEP_M {
                (length_m, last) = (length_m + step_m, at);
            }
        }
        Self { at_m, speed_m_per_s: length_m / seconds.max(1e-3) }
    }

    /// At one time of the stretch, by its path.
    fn at(self, t_s: f64, times_s: &[f64], path_m: &[Vector3<f64>]) -> Self {
        let after = times_s.partition_point(|at_s| *at_s < t_s).clamp(1, times_s.len().max(2) - 1);
        let pair = |values: &[f64]| Some([*values.get(after - 1)?, *values.get(after)?]);
        let (Some([from_s, to_s]), Some(from), Some(to)) = (pair(times_s), path_m.get(after - 1), path_m.get(after))
        else {
            return self;
        };
        let part = ((t_s - from_s) / (to_s - from_s).max(1e-6)).clamp(0.0, 1.0);
        Self { at_m: from.lerp(to, part).xy(), ..self }
    }
}

/// The bearings so far, as a graph.
#[derive(Clone, Debug)]
pub struct Graph {
    name: String,
    asked: Asked,
    heading_sd_rad: f64,
    /// Bearings of the coarse grid only are all that there are.
    is_coarse: bool,
    seen: VecDeque<Seen>,
    ranges: Ranges,
    /// Frames that this robot's and each peer's poses were in.
    frames: (PoseCounts, BTreeMap<String, u64>),
}

impl Graph {
    /// An empty graph of the robot `name`, if the configuration asks for one, with the ranges that come.
    #[must_use]
    pub fn new(config: &Config, name: &str, ranges: Ranges) -> Option<Self> {
        Some(Self {
            name: name.to_owned(),
            asked: config.team.clone()?,
            heading_sd_rad: config.heading_sd_deg().to_radians(),
            is_coarse: !config.estimator.accurate,
            seen: VecDeque::new(),
            ranges,
            frames: Default::default(),
        })
    }

    /// Takes the machine's last report about a peer. True if the graph changed.
    pub fn note(&mut self, peer: usize, report: &PeerReport, machine: &Machine) -> bool {
        let Some((known, _)) = machine.estimator.peers().nth(peer) else { return false };
        let counts = PoseCounts { poses: 0, incomplete: 0, refused: 0, ..machine.pose_counts };
        if counts != self.frames.0 {
            // Earlier keyframes are in another frame.
            self.seen.clear();
            self.frames.0 = counts;
        }
        let frames = self.frames.1.entry(known.name.clone()).or_default();
        if std::mem::replace(frames, machine.peer_frames(peer)) != machine.peer_frames(peer) {
            self.seen.retain(|seen| seen.peer != known.name);
        }
        let is_whole = report.state == PeerState::Bearing && (report.accurate || self.is_coarse);
        let bearing = machine.estimator.bearing(peer).filter(|_| is_whole);
        let seen = bearing.and_then(|bearing| self.seen(&known.name, report, bearing));
        let is_new = seen.is_some();
        self.seen.extend(seen);
        let links = |seen: &VecDeque<Seen>| seen.iter().map(|seen| seen.links.len()).sum::<usize>();
        while self.seen.len() > KEPT || links(&self.seen) > LINKS {
            self.seen.pop_front();
        }
        is_new
    }

    /// A bearing, if none of its samples is in the graph yet.
    fn seen(&self, peer: &str, report: &PeerReport, bearing: &Bearing) -> Option<Seen> {
        let samples = &bearing.samples;
        let span_s = [*samples.t_s().first()?, *samples.t_s().last()?];
        let before = self.seen.iter().rev().find(|seen| seen.peer == peer);
        let modes: Vec<Mode> =
            ways(&report.answer, self.heading_sd_rad.to_degrees()).into_iter().map(|way| way.mode).collect();
        if modes.is_empty() || before.is_some_and(|before| span_s[0] <= before.span_s[1]) {
            return None;
        }
        let (path_m, other_m, seconds) = (samples.receiver_m(), samples.transmitter_m(), span_s[1] - span_s[0]);
        let own = Stretch::of(path_m, seconds);
        let moves = other_m.iter().any(|at| *at != Vector3::zeros());
        let other = moves.then(|| Stretch::of(other_m, seconds));
        let bearing_link = Link { t_s: 0.5 * (span_s[0] + span_s[1]), own, other, modes, outliers: LINK_OUTLIERS };
        let range_link = |range: Ranged| {
            let [range_m, sd_m] = range.range_m;
            Link {
                t_s: range.t_s,
                own: own.at(range.t_s, samples.t_s(), path_m),
                other: other.map(|other| other.at(range.t_s, samples.t_s(), other_m)),
                modes: vec![Mode::range(range_m, sd_m, 1.0)],
                outliers: RANGE_OUTLIERS,
            }
        };
        let ranges = self.ranges.within(peer, span_s).into_iter().map(range_link);
        Some(Seen {
            peer: peer.to_owned(),
            span_s,
            links: std::iter::once(bearing_link).chain(ranges).collect(),
            end_m: path_m.last()?.xy(),
            heading_rad: bearing.heading_rad,
        })
    }

    /// Poses of this robot and of the peers that the bearings determine.
    ///
    /// # Errors
    /// If they determine no peer.
    pub fn solve(&self) -> Result<TeamState, TeamError> {
        let mut graph = self.clone();
        loop {
            let state = graph.solve_all()?;
            if state.factors.len() <= LARGEST || graph.seen.pop_front().is_none() {
                return Ok(state);
            }
        }
    }

    fn solve_all(&self) -> Result<TeamState, TeamError> {
        let (mut missing, mut notes) = (BTreeSet::new(), Vec::new());
        loop {
            let built = Built::new(self, &missing)?;
            match built.team.solve() {
                Ok(found) => return Ok(TeamState { notes, ..built.state(self, &found) }),
                Err(TeamError::Undetermined { robot } | TeamError::Unlinked { robot })
                    if built.peers.contains_key(&robot) && built.peers.len() > 1 =>
                {
                    notes.push(format!("{robot} is missing: the bearings do not determine its place yet"));
                    missing.insert(robot);
                }
                Err(error) => return Err(error),
            }
        }
    }
}

/// The graph of the team, with its keyframes.
struct Built<'a> {
    team: Team,
    /// This robot's last keyframe, and its place in the frame of the odometry.
    own: Option<(Keyframe, Vector2<f64>)>,
    /// The last bearing.
    last: Option<&'a Seen>,
    /// The last keyframe of each peer.
    peers: BTreeMap<String, Keyframe>,
}

/// A keyframe and its time, seconds.
type Keyframe = (KeyframeId, f64);

/// Adds a robot's keyframe, later than its last one.
fn add(
    team: &mut Team,
    robot: RobotId,
    t_s: f64,
    at: Stretch,
    before: Option<Keyframe>,
) -> Result<Keyframe, TeamError> {
    let before_s = before.map_or(t_s - APART_S, |(_, before_s)| before_s);
    let t_s = t_s.max(before_s + APART_S);
    let id = team.keyframe(robot, t_s, [at.at_m.x, at.at_m.y, 0.0], (t_s - before_s) * at.speed_m_per_s)?;
    Ok((id, t_s))
}

impl<'a> Built<'a> {
    fn new(graph: &'a Graph, missing: &BTreeSet<String>) -> Result<Self, TeamError> {
        let usual = OdometryNoise::default();
        let noise = OdometryNoise { turn_rad_per_rt_m: usual.turn_rad_per_rt_m.max(graph.heading_sd_rad), ..usual };
        let seen = || graph.seen.iter().filter(|seen| !missing.contains(&seen.peer));
        let mut links: Vec<(&Seen, &Link)> =
            seen().flat_map(|seen| seen.links.iter().map(move |link| (seen, link))).collect();
        links.sort_by(|(_, a), (_, b)| a.t_s.total_cmp(&b.t_s));
        let is_moving = |(_, link): &&(&Seen, &Link)| link.other.is_some();
        let moving: BTreeSet<&String> = links.iter().filter(is_moving).map(|(seen, _)| &seen.peer).collect();
        let mut team = Team::default();
        let robot = team.robot(&graph.name, true, noise)?;
        let last = seen().max_by(|a, b| a.span_s[1].total_cmp(&b.span_s[1]));
        let mut built = Self { team, own: None, last, peers: BTreeMap::new() };
        for (seen, link) in links {
            let own = add(&mut built.team, robot, link.t_s, link.own, built.own.map(|(before, _)| before))?;
            let to = built.peer(graph, (&seen.peer, link), moving.contains(&seen.peer).then_some(noise))?;
            built.team.link(own.0, to, &link.modes, link.outliers)?;
            built.own = Some((own, link.own.at_m));
        }
        let places = &graph.asked.places;
        if !places.is_empty() && !built.peers.keys().any(|name| places.contains_key(name)) {
            return Err(TeamError::Unlinked { robot: graph.name.clone() });
        }
        if let Some(((last, _), at_m)) = built.own.filter(|_| places.is_empty()) {
            built.team.prior(last, [at_m.x, at_m.y, 0.0], [GAUGE_SD; 3])?;
        }
        Ok(built)
    }

    /// The keyframe of the peer that a link leads to; `noise` is that of its odometry if it moves.
    fn peer(
        &mut self,
        graph: &Graph,
        (name, link): (&String, &Link),
        noise: Option<OdometryNoise>,
    ) -> Result<KeyframeId, TeamError> {
        let (known, free) = (self.peers.get(name).copied(), f64::INFINITY);
        if let Some((place, _)) = known.filter(|_| noise.is_none()) {
            return Ok(place);
        }
        let robot = match known {
            Some(_) => self.team.named(name)?,
            None => self.team.robot(name, noise.is_some(), noise.unwrap_or_default())?,
        };
        let still = Stretch { at_m: Vector2::zeros(), speed_m_per_s: 0.0 };
        let keyframe = add(&mut self.team, robot, link.t_s, link.other.unwrap_or(still), known)?;
        match graph.asked.places.get(name) {
            Some([x, y]) => {
                self.team.prior(keyframe.0, [*x, *y, 0.0], [PLACE_SD_M, PLACE_SD_M, free])?;
            }
            _ if noise.is_some() && known.is_none() && graph.asked.places.is_empty() => {
                // Its frame has the axes of this robot's.
                let sd_rad = graph.heading_sd_rad.max(AXES_SD_RAD);
                self.team.prior(keyframe.0, [0.0; 3], [free, free, sd_rad])?;
            }
            _ => {}
        }
        self.peers.insert(name.clone(), keyframe);
        Ok(keyframe.0)
    }

    fn state(&self, graph: &Graph, found: &Solution) -> TeamState {
        let mut robots: Vec<Member> = self.own_member(graph, found).into_iter().collect();
        let odometry = self.own.map(|((last, _), at_m)| odometry(found.pose(last), at_m)).unwrap_or_default();
        robots.extend(self.peers.iter().map(|(name, (keyframe, t_s))| {
            let [x, y, _] = found.pose(*keyframe);
            let mut covariance = found.covariance(*keyframe);
            covariance.row_mut(2).fill(0.0);
            covariance.column_mut(2).fill(0.0);
            let other = |pose: &[f64; 3]| [pose[0], pose[1]];
            Member {
                name: name.clone(),
                t_s: *t_s,
                position_m: [x, y],
                heading_rad: None,
                covariance: covariance.transpose().into(),
                others_m: found.others.iter().filter_map(|own| own.poses.get(keyframe.index()).map(other)).collect(),
            }
        }));
        let frame = (!graph.asked.places.is_empty()).then(|| graph.asked.frame.clone());
        let factors = factors::json(&self.team, found).into();
        TeamState { frame, odometry, robots, factors, ..TeamState::default() }
    }

    /// This robot at the end of its last bearing.
    fn own_member(&self, graph: &Graph, found: &Solution) -> Option<Member> {
        let (((last, _), at_m), seen) = (self.own?, self.last?);
        let at = |pose: [f64; 3]| {
            let [x, y, yaw] = odometry(pose, at_m);
            Vector2::new(x, y) + Rotation2::new(yaw) * seen.end_m
        };
        let pose = found.pose(last);
        let end = at(pose);
        // An error of the keyframe's yaw turns the way from there to the end.
        let mut turn = Matrix3::identity();
        (turn[(0, 2)], turn[(1, 2)]) = (pose[1] - end.y, end.x - pose[0]);
        let covariance = turn * found.covariance(last) * turn.transpose();
        let others = found.others.iter().filter_map(|own| own.poses.get(last.index()));
        Some(Member {
            name: graph.name.clone(),
            t_s: seen.span_s[1],
            position_m: end.into(),
            heading_rad: seen.heading_rad.map(|heading| wrap_rad(heading + pose[2])),
            covariance: covariance.transpose().into(),
            others_m: others.map(|pose| at(*pose).into()).collect(),
        })
    }
}

/// Pose of the odometry's frame, by the pose of a keyframe and its place in that frame.
fn odometry([x, y, yaw]: [f64; 3], at_m: Vector2<f64>) -> [f64; 3] {
    let origin = Vector2::new(x, y) - Rotation2::new(yaw) * at_m;
    [origin.x, origin.y, yaw]
}

/// A graph that is solved on its own thread, so that the robot never waits for it.
pub struct Solver {
    graph: Graph,
    /// The graph has a bearing that was not given to the thread.
    is_new: bool,
    /// Graphs given to the thread without an answer yet, and how many of these are of a frame that is over.
    asked: [usize; 2],
    to: SyncSender<Graph>,
    from: Receiver<Result<TeamState, String>>,
    state: TeamState,
    /// Why there is no newer solution, or why peers are missing.
    notes: Vec<String>,
}

impl Solver {
    /// Starts the thread, if the configuration asks for a graph.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start(config: &Config, name: &str, ranges: Ranges) -> Result<Option<Self>, Error> {
        let Some(graph) = Graph::new(config, name, ranges) else { return Ok(None) };
        let (to, asked) = sync_channel::<Graph>(0);
        let (tell, from) = sync_channel(1);
        let solve = move || {
            while let Ok(graph) = asked.recv() {
                if tell.send(graph.solve().map_err(|why| why.to_string())).is_err() {
                    return;
                }
            }
        };
        spawn("csi5300 team", "cannot start the thread that solves the team", solve)?;
        let (state, notes) = (TeamState::default(), Vec::new());
        Ok(Some(Self { graph, is_new: false, asked: [0; 2], to, from, state, notes }))
    }

    /// Takes the machine's last report about a peer.
    pub fn note(&mut self, peer: usize, report: &PeerReport, machine: &Machine) {
        let frame = self.graph.frames.0;
        self.is_new |= self.graph.note(peer, report, machine);
        if self.graph.frames.0 != frame {
            self.asked[1] = self.asked[0];
            self.state = TeamState { solved: self.state.solved, ..TeamState::default() };
            self.notes = vec!["this robot's poses are in another frame: the team begins anew".into()];
        }
    }

    /// The team as solved last. A graph with new bearings is solved next.
    pub fn look(&mut self) -> &TeamState {
        if let Ok(found) = self.from.try_recv() {
            let is_old = self.asked[1] > 0;
            self.asked = self.asked.map(|asked| asked.saturating_sub(1));
            match found {
                _ if is_old => {}
                Ok(state) => {
                    self.notes.clone_from(&state.notes);
                    self.state = TeamState { solved: self.state.solved + 1, ..state };
                }
                Err(why) => self.notes = vec![why],
            }
        }
        self.state.notes = self.notes.iter().cloned().chain(self.range_notes()).collect();
        // A thread that still solves is given the graph at a later look.
        if self.is_new && self.to.try_send(self.graph.clone()).is_ok() {
            self.is_new = false;
            self.asked[0] += 1;
        }
        &self.state
    }

    /// Topics of ranges without usable messages.
    fn range_notes(&self) -> impl Iterator<Item = String> {
        self.graph.asked.ranges.iter().filter_map(|(peer, asked)| {
            let topic = &asked.topic;
            match self.graph.ranges.counts(peer) {
                (0, _) => Some(format!("no range to {peer} yet on {topic}")),
                (_, 0) => None,
                (came, unusable) => Some(format!(
                    "{unusable} of {came} ranges to {peer} are unusable: not finite, outside of their own limits, without \
                     a time, or not sensor_msgs/msg/Range"
                )),
            }
        })
    }
}

/// A range to a peer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ranged {
    /// Host time, seconds since the Unix epoch.
    pub t_s: f64,
    /// The range and its standard deviation, metres.
    pub range_m: [f64; 2],
}

/// The last ranges to each peer, shared by an adapter and the graph.
#[derive(Clone, Debug, Default)]
pub struct Ranges(Arc<Mutex<BTreeMap<String, RangesTo>>>);

/// Messages of one peer's topic: all, those that could not be used, and the last ranges.
#[derive(Debug, Default)]
struct RangesTo {
    came: u64,
    unusable: u64,
    last: VecDeque<Ranged>,
}

impl Ranges {
    /// Adds a message about `peer`; `range` is `None` if it cannot be used.
    pub fn put(&self, peer: &str, range: Option<Ranged>) {
        let mut all = lock(&self.0);
        let own = all.entry(peer.to_owned()).or_default();
        own.came += 1;
        own.unusable += u64::from(range.is_none());
        own.last.extend(range);
        if own.last.len() > RANGES {
            own.last.pop_front();
        }
    }

    /// The ranges next to the [`PARTS`] of a bearing's time.
    fn within(&self, peer: &str, [from_s, to_s]: [f64; 2]) -> Vec<Ranged> {
        let all = lock(&self.0);
        let within =
            || all.get(peer).into_iter().flat_map(|own| &own.last).filter(|own| (from_s..=to_s).contains(&own.t_s));
        let next_to = |part: f64| {
            let at_s = from_s + part * (to_s - from_s);
            within().min_by(|a, b| (a.t_s - at_s).abs().total_cmp(&(b.t_s - at_s).abs()))
        };
        let mut found: Vec<Ranged> = PARTS.into_iter().filter_map(next_to).copied().collect();
        found.dedup();
        found
    }

    /// The messages about `peer` so far, and those that could not be used.
    fn counts(&self, peer: &str) -> (u64, u64) {
        lock(&self.0).get(peer).map_or((0, 0), |own| (own.came, own.unusable))
    }
}
