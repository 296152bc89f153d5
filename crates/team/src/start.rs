//! Initial states: places one robot after another where its links to placed robots cross.

use crate::graph::{Link, Mode, Prior, Team, TeamError};
use crate::solve::State;
use nalgebra::{Rotation2, Vector2};
use std::f64::consts::{PI, TAU};

/// Limit of arrangements kept while robots are placed.
const KEPT: usize = 3;

/// Arrangements cost at most this much more than the best (`exp(-15)` as likely).
pub const COSTLIER: f64 = 15.0;

/// Limit of places of a robot tried in each arrangement.
const PLACES: usize = 4;

/// Yaws tried for a frame of unknown yaw.
const YAWS: usize = 36;

/// Limit of links whose crossings are tried.
const CROSSED: usize = 9;

/// Crossings are judged by more and more links: limits of links, and of the best crossings kept.
const JUDGES: [[usize; 2]; 3] = [[5, 2000], [15, 400], [45, 400]];

/// Factor on all deviations, because a tried yaw may be half a step off.
const TEMPER: f64 = 3.0;

/// A prior of this deviation or more says less about a place than links do, metres.
const VAGUE_M: f64 = 10.0;

/// Origin of a robot's odometry in the team's frame: x, y, yaw.
type Frame = [f64; 3];

/// Frames of the robots placed so far, and the cost of their links.
#[derive(Clone)]
struct Arrangement {
    frames: Vec<Option<Frame>>,
    cost: f64,
}

fn composed(frame: Frame, odometry: [f64; 3]) -> [f64; 3] {
    let at = Vector2::new(frame[0], frame[1]) + Rotation2::new(frame[2]) * Vector2::new(odometry[0], odometry[1]);
    [at.x, at.y, crate::wrap(frame[2] + odometry[2])]
}

/// The frame that puts `odometry` at `pose`.
fn frame_by(pose: [f64; 3], odometry: [f64; 3]) -> Frame {
    let yaw = pose[2] - odometry[2];
    let at = Vector2::new(pose[0], pose[1]) - Rotation2::new(yaw) * Vector2::new(odometry[0], odometry[1]);
    [at.x, at.y, yaw]
}

fn direction(angle_rad: f64) -> Vector2<f64> {
    Vector2::new(angle_rad.cos(), angle_rad.sin())
}

/// Initial states. Robots in `before` keep their poses.
pub fn starts(team: &Team, before: Option<&State>) -> Result<Vec<State>, TeamError> {
    let frames: Vec<Option<Frame>> = (0..team.robots.len()).map(|robot| known_frame(team, before, robot)).collect();
    let mut kept = vec![Arrangement { frames, cost: 0.0 }];
    if kept[0].frames.iter().all(Option::is_none) {
        // No prior fixes a whole pose: the first robot's odometry defines the frame.
        kept[0].frames[team.keyframes[0].robot] = Some([0.0; 3]);
    }
    while let Some(robot) = next(team, &kept[0].frames)? {
        kept = placed(team, &kept, robot);
    }
    Ok(kept.into_iter().map(|own| state(team, &own.frames, before)).collect())
}

/// The frame of a robot from an earlier solution or a prior.
fn known_frame(team: &Team, before: Option<&State>, robot: usize) -> Option<Frame> {
    let own = |k: &usize| team.keyframes[*k].robot == robot;
    let solved = before.and_then(|before| (0..before.poses.len()).rev().find(own).map(|k| (k, before.poses[k])));
    let by_prior = || {
        let fixes = |prior: &&Prior| {
            let [x, y, yaw] = prior.sd;
            let is_placed = [x, y].into_iter().all(|sd| sd.is_some_and(|sd| sd < VAGUE_M));
            own(&prior.keyframe) && is_placed && (yaw.is_some() || !team.robots[robot].has_heading)
        };
        team.priors.iter().find(fixes).map(|prior| (prior.keyframe, prior.pose))
    };
    solved.or_else(by_prior).map(|(k, pose)| frame_by(pose, team.keyframes[k].odometry))
}

/// Poses from the frames, or from `before` where it has them.
fn state(team: &Team, frames: &[Option<Frame>], before: Option<&State>) -> State {
    let pose = |k: usize| {
        let known = before.and_then(|before| before.poses.get(k)).copied();
        let own = &team.keyframes[k];
        known.unwrap_or_else(|| composed(frames[own.robot].unwrap_or_default(), own.odometry))
    };
    let mut calibrations = before.map(|before| before.calibrations.clone()).unwrap_or_default();
    calibrations.resize(team.robots.len(), [0.0; 2]);
    State { poses: (0..team.keyframes.len()).map(pose).collect(), calibrations }
}

/// The unplaced robot with the most links to placed ones.
fn next(team: &Team, frames: &[Option<Frame>]) -> Result<Option<usize>, TeamError> {
    let mut counts = vec![0; frames.len()];
    for link in &team.links {
        let (from, to) = (team.keyframes[link.from].robot, team.keyframes[link.to].robot);
        match (frames[from], frames[to]) {
            (Some(_), None) => counts[to] += 1,
            (None, Some(_)) => counts[from] += 1,
            _ => {}
        }
    }
    let has_keyframe = |robot: usize| team.keyframes.iter().any(|own| own.robot == robot);
    let open = (0..frames.len()).filter(|robot| frames[*robot].is_none() && has_keyframe(*robot));
    let Some(robot) = open.max_by_key(|robot| counts[*robot]) else { return Ok(None) };
    if counts[robot] == 0 {
        Err(TeamError::Unlinked { robot: team.robots[robot].name.clone() })
    } else {
        Ok(Some(robot))
    }
}

/// At most `most` elements of a list, evenly spaced.
fn some<T: Copy>(all: &[T], most: usize) -> Vec<T> {
    let step = all.len().div_ceil(most).max(1);
    all.iter().step_by(step).copied().collect()
}

/// The arrangements extended by `robot` at each of its likeliest places.
fn placed(team: &Team, kept: &[Arrangement], robot: usize) -> Vec<Arrangement> {
    let mut longer: Vec<Arrangement> = Vec::new();
    for own in kept {
        let end = |k: usize| {
            let other = &team.keyframes[k];
            own.frames[other.robot].map(|frame| composed(frame, other.odometry))
        };
        let shares = team.links.iter().map(|link| link.null_share);
        for (frame, cost) in places(team, &links_of(team, robot, end, shares), robot, None) {
            let mut frames = own.frames.clone();
            frames[robot] = Some(frame);
            longer.push(Arrangement { frames, cost: own.cost + cost });
        }
    }
    longer.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let most = longer.first().map_or(0.0, |best| best.cost) + COSTLIER;
    longer.retain(|own| own.cost <= most);
    longer.truncate(KEPT);
    longer
}

/// Possible origins of the robot's frame by a link, at a given yaw: a ray from `centre`, a circle about it, or a point.
#[derive(Clone, Copy)]
struct Locus {
    link: usize,
    centre: Vector2<f64>,
    /// Direction from `centre` to the frame.
    ray: Option<Vector2<f64>>,
    range_m: Option<f64>,
}

/// A link to a placed robot: its outlier share, the robot's own keyframe, and the pose at the other end.
struct Seen<'a> {
    link: &'a Link,
    null_share: f64,
    own: usize,
    other: [f64; 3],
}

impl Seen<'_> {
    /// The link's cost with the robot's own keyframe at `own`.
    fn cost(&self, own: [f64; 3]) -> f64 {
        let (from, to) = if self.link.from == self.own { (own, self.other) } else { (self.other, own) };
        self.link.best(from, to, self.null_share, TEMPER).1
    }
}

/// A robot's links to keyframes with a pose. Links that are switched off are left out.
fn links_of(
    team: &Team,
    robot: usize,
    pose: impl Fn(usize) -> Option<[f64; 3]>,
    null_shares: impl Iterator<Item = f64>,
) -> Vec<Seen<'_>> {
    let seen = |(link, null_share): (_, f64)| {
        let link: &Link = link;
        let (from, to) = (team.keyframes[link.from].robot, team.keyframes[link.to].robot);
        let (own, other) = match (from == robot, to == robot) {
            (true, _) => (link.from, link.to),
            (_, true) => (link.to, link.from),
            _ => return None,
        };
        Some(Seen { link, null_share, own, other: pose(other).filter(|_| null_share < 1.0)? })
    };
    team.links.iter().zip(null_shares).filter_map(seen).collect()
}

/// States like a solved one, but with one robot at another place where its links fit, and by how much more they cost there.
pub fn again(team: &Team, state: &State, null_shares: &[f64], robot: usize) -> Vec<(f64, State)> {
    let seen = links_of(team, robot, |k| Some(state.poses[k]), null_shares.iter().copied());
    if seen.is_empty() || !team.robots[robot].has_heading {
        return Vec::new();
    }
    let dearer = |other: &State| -> f64 {
        seen.iter().map(|own| own.cost(other.poses[own.own]) - own.cost(state.poses[own.own])).sum()
    };
    let moved = |(frame, _): (Frame, f64)| {
        let mut other = state.clone();
        other.calibrations[robot] = [0.0; 2];
        for (pose, own) in other.poses.iter_mut().zip(&team.keyframes).filter(|(_, own)| own.robot == robot) {
            *pose = composed(frame, own.odometry);
        }
        (dearer(&other), other)
    };
    places(team, &seen, robot, Some(state)).into_iter().map(moved).collect()
}

/// The likeliest frames of a robot, with the cost of its links.
/// Those near the robot's place in the state `but` are left out.
fn places(team: &Team, seen: &[Seen<'_>], robot: usize, but: Option<&State>) -> Vec<(Frame, f64)> {
    let all: Vec<usize> = (0..seen.len()).collect();
    let crossed = some(&all, CROSSED);
    let mut found: Vec<(Frame, f64)> = Vec::new();
    for yaw in yaws(team, seen, robot) {
        let loci: Vec<Locus> = crossed.iter().flat_map(|k| loci(team, &seen[*k], *k, yaw)).collect();
        found.extend(crossings(&loci).into_iter().map(|at| ([at.x, at.y, yaw], 0.0)));
    }
    for [judges, kept] in JUDGES {
        let judges = some(&all, judges);
        let links = seen.len() as f64 / judges.len() as f64;
        for (frame, cost) in &mut found {
            let of = |k: &usize| seen[*k].cost(composed(*frame, team.keyframes[seen[*k].own].odometry));
            *cost = links * judges.iter().map(of).sum::<f64>();
        }
        found.sort_by(|a, b| a.1.total_cmp(&b.1));
        found.truncate(kept);
    }
    let middle = seen[seen.len() / 2].own;
    let mut apart: Vec<[f64; 3]> = but.map(|state| state.poses[middle]).into_iter().collect();
    let most = apart.len() + PLACES;
    found.retain(|(frame, _)| {
        let own = composed(*frame, team.keyframes[middle].odometry);
        let near = |other: &[f64; 3]| {
            (own[0] - other[0]).hypot(own[1] - other[1]) < 0.5 && crate::wrap(own[2] - other[2]).abs() < 0.4
        };
        let is_kept = apart.len() < most && !apart.iter().any(near);
        apart.extend(Some(own).filter(|_| is_kept));
        is_kept
    });
    found
}

/// Yaws to try for a robot's frame: 0 for a point; those of its prior; else a full turn, and the yaws at which mutual
/// bearings agree.
fn yaws(team: &Team, seen: &[Seen<'_>], robot: usize) -> Vec<f64> {
    if !team.robots[robot].has_heading {
        return vec![0.0];
    }
    let own = |prior: &Prior| {
        let sd = prior.sd[2].filter(|_| team.keyframes[prior.keyframe].robot == robot)?;
        let yaw = prior.pose[2] - team.keyframes[prior.keyframe].odometry[2];
        Some([0.0, -1.0, 1.0, -2.0, 2.0].map(|by| yaw + by * sd))
    };
    if let Some(known) = team.priors.iter().find_map(own) {
        return if known[4] - known[0] > 0.05 { known.to_vec() } else { vec![known[0]] };
    }
    let mut yaws: Vec<f64> = (0..YAWS).map(|k| TAU * k as f64 / YAWS as f64 - PI).collect();
    let mut azimuths: [Vec<f64>; 2] = [Vec::new(), Vec::new()];
    for Seen { link, own, other, .. } in seen {
        let is_own = link.from == *own;
        // Directions from the robot in its own frame, or to the robot in the team's frame.
        let turned = if is_own { team.keyframes[*own].odometry[2] } else { other[2] };
        azimuths[usize::from(is_own)].extend(link.modes.iter().filter_map(|mode| Some(mode.azimuth_rad?[0] + turned)));
    }
    let [there, here] = azimuths.map(|all| some(&all, 6));
    yaws.extend(there.iter().flat_map(|there| here.iter().map(move |here| crate::wrap(there + PI - here))));
    yaws
}

/// Possible origins of the frame, by each candidate of a link.
fn loci(team: &Team, seen: &Seen<'_>, index: usize, yaw: f64) -> Vec<Locus> {
    let odometry = team.keyframes[seen.own].odometry;
    let offset = Rotation2::new(yaw) * Vector2::new(odometry[0], odometry[1]);
    let centre = Vector2::new(seen.other[0], seen.other[1]) - offset;
    let is_own = seen.link.from == seen.own;
    let locus = |mode: &Mode| {
        let ray = mode.azimuth_rad.map(|[azimuth, _]| match is_own {
            true => -direction(yaw + odometry[2] + azimuth),
            false => direction(seen.other[2] + azimuth),
        });
        Locus { link: index, centre, ray, range_m: mode.range_m.map(|[range_m, _]| range_m) }
    };
    seen.link.modes.iter().map(locus).collect()
}

/// Crossings of candidates of different links, and ends of candidates with azimuth and range; without any, points along the
/// rays and circles.
fn crossings(loci: &[Locus]) -> Vec<Vector2<f64>> {
    let mut found = Vec::new();
    for (k, a) in loci.iter().enumerate() {
        if let (Some(ray), Some(range_m)) = (a.ray, a.range_m) {
            found.push(a.centre + ray * range_m);
        }
        for b in loci[k + 1..].iter().filter(|b| b.link != a.link) {
            match (a.ray, b.ray) {
                (Some(u), Some(v)) => {
                    let (cross, between) = (u.perp(&v), b.centre - a.centre);
                    let (along, other) = (between.perp(&v) / cross, between.perp(&u) / cross);
                    if cross.abs() > 1e-3 && along > 0.0 && other > 0.0 {
                        found.push(a.centre + u * along);
                    }
                }
                (Some(ray), None) => on_circle(a.centre, ray, b, &mut found),
                (None, Some(ray)) => on_circle(b.centre, ray, a, &mut found),
                (None, None) => of_circles(a, b, &mut found),
            }
        }
    }
    if found.is_empty() {
        for own in loci {
            let rays = own
                .ray
                .map_or_else(|| (0..12).map(|k| direction(TAU * f64::from(k) / 12.0)).collect(), |ray| vec![ray]);
            let lengths_m = own.range_m.map_or_else(|| vec![1.0, 2.0, 4.0, 8.0], |range_m| vec![range_m]);
            found
                .extend(rays.iter().flat_map(|ray| lengths_m.iter().map(move |length_m| own.centre + ray * *length_m)));
        }
    }
    found
}

/// Intersections of a ray and a circle; without one, the point of the ray nearest to the centre.
fn on_circle(from: Vector2<f64>, ray: Vector2<f64>, circle: &Locus, found: &mut Vec<Vector2<f64>>) {
    let Some(range_m) = circle.range_m else { return };
    let to = circle.centre - from;
    let (along, across) = (to.dot(&ray), to.perp(&ray));
    let half = (range_m * range_m - across * across).max(0.0).sqrt();
    found.extend([along - half, along + half].into_iter().filter(|s| *s > 0.0).map(|s| from + ray * s));
}

/// Intersections of two circles; without one, a point between them.
fn of_circles(a: &Locus, b: &Locus, found: &mut Vec<Vector2<f64>>) {
    let (Some(own_m), Some(other_m)) = (a.range_m, b.range_m) else { return };
    let between = b.centre - a.centre;
    let distance = between.norm();
    if distance < 1e-3 {
        return;
    }
    let along = (distance * distance + own_m * own_m - other_m * other_m) / (2.0 * distance);
    let half = (own_m * own_m - along * along).max(0.0).sqrt();
    let (u, v) = (between / distance, Vector2::new(-between.y, between.x) / distance);
    found.extend([half, -half].map(|half| a.centre + u * along + v * half));
}
