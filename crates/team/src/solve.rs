//! Levenberg-Marquardt solver and marginal covariances.

use crate::graph::{Change, KeyframeId, Link, NEAREST_M, Prior, RobotId, Step, Team, TeamError, empty, nearness};
use crate::start::{COSTLIER, again, starts};
use crate::wrap;
use nalgebra::{DMatrix, DVector, Matrix3};

/// Factors on all deviations in successive descents, so that a link far from its candidates still pulls. The factor applies
/// to odometry too, so the balance between them stays the same.
const TEMPERS: [f64; 3] = [4.0, 2.0, 1.0];

/// Limit of steps in one descent.
const STEPS: usize = 60;

/// Weight of the given outlier share as a prior, in links.
const NULL_LINKS: f64 = 4.0;

/// Prior probability that all links of a robot are wrong.
const LIARS: f64 = 0.05;

/// Limit of minima at which outlier shares are learnt.
const SETTLED: usize = 4;

/// Limit of other places tried for robots, in a first solution and in later ones; the robots' links cost least there.
const TRIED: [usize; 2] = [6, 2];

/// After a gain of more than this in cost, the remaining places are computed anew, at most so often.
const GAIN: f64 = 5.0;
const ROUNDS: usize = 4;

/// Descents from perturbations of the best minimum, and the size of these, metres and radians.
const KICKS: usize = 8;
const KICK: [f64; 2] = [0.05, 0.03];

/// Another solution is reported if the best is at most this many times as likely, ...
const AS_LIKELY: f64 = 2.0;

/// ... and one of its keyframes is more than this away, metres.
const APART_M: f64 = 0.3;

/// Cost reduction below which a descent stops: while minima are compared, and at the best one.
const ROUGHLY: f64 = 1e-2;
const EXACTLY: f64 = 1e-8;

/// Descents whose ends differ by less than this, in metres and in cost, are merged.
const NEAR: [f64; 2] = [0.05, 0.05];

/// Deviation of the first pose if the team has no prior, metres and radians. This prior fixes the gauge.
const GAUGE_SD: f64 = 1e-4;

/// Values of all variables.
#[derive(Clone, Debug, Default)]
pub(crate) struct State {
    /// By keyframe: x, y, yaw.
    pub poses: Vec<[f64; 3]>,
    /// By robot: turn per metre, radians, and relative error of lengths, both missing from its odometry.
    pub calibrations: Vec<[f64; 2]>,
}

/// A scalar variable: a component of a keyframe's pose or of a robot's calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Variable {
    Pose(usize, usize),
    Calibration(usize, usize),
}

impl State {
    fn get(&self, variable: Variable) -> f64 {
        match variable {
            Variable::Pose(keyframe, k) => self.poses[keyframe][k],
            Variable::Calibration(robot, k) => self.calibrations[robot][k],
        }
    }

    fn get_mut(&mut self, variable: Variable) -> &mut f64 {
        match variable {
            Variable::Pose(keyframe, k) => &mut self.poses[keyframe][k],
            Variable::Calibration(robot, k) => &mut self.calibrations[robot][k],
        }
    }

    fn is_near(&self, other: &Self) -> bool {
        let near = |(a, b): (&[f64; 3], &[f64; 3])| (a[0] - b[0]).abs().max((a[1] - b[1]).abs()) < NEAR[0];
        self.poses.iter().zip(&other.poses).all(near)
    }

    /// From one keyframe to another: x and y in the team's frame.
    fn between(&self, [from, to]: [usize; 2]) -> (f64, f64) {
        let (a, b) = (self.poses[from], self.poses[to]);
        (b[0] - a[0], b[1] - a[1])
    }

    /// As [`Link::best`], at this state.
    fn best(&self, link: &Link, null_share: f64, temper: f64) -> (Option<usize>, f64) {
        link.best(self.poses[link.from], self.poses[link.to], null_share, temper)
    }
}

/// Linear prior from marginalised keyframes on the remaining variables, about the point `at`.
#[derive(Clone, Debug)]
pub(crate) struct Carried {
    variables: Vec<Variable>,
    at: Vec<f64>,
    /// Residuals are `rows * (x - at) + side`.
    rows: DMatrix<f64>,
    side: DVector<f64>,
}

impl Carried {
    pub fn has_calibration(&self, robot: usize) -> bool {
        self.variables.contains(&Variable::Calibration(robot, 0))
    }
}

/// Order of the variables: moving robots' keyframes in time order, then standing ones, then calibrations.
#[derive(Clone, Debug)]
struct Layout {
    variables: Vec<Variable>,
    poses: Vec<usize>,
    calibrations: Vec<Option<usize>>,
}

impl Layout {
    fn new(team: &Team) -> Self {
        let moving: Vec<bool> = (0..team.robots.len()).map(|robot| team.is_moving(robot)).collect();
        let mut order: Vec<usize> = (0..team.keyframes.len()).filter(|k| !team.keyframes[*k].is_past).collect();
        let key = |k: &usize| (!moving[team.keyframes[*k].robot], team.keyframes[*k].t_s);
        order.sort_by(|a, b| key(a).0.cmp(&key(b).0).then(key(a).1.total_cmp(&key(b).1)));
        let mut layout = Self {
            variables: Vec::new(),
            poses: vec![usize::MAX; team.keyframes.len()],
            calibrations: vec![None; team.robots.len()],
        };
        for k in order {
            layout.poses[k] = layout.variables.len();
            layout.variables.extend((0..team.pose_size(k)).map(|part| Variable::Pose(k, part)));
        }
        for robot in (0..team.robots.len()).filter(|robot| moving[*robot]) {
            layout.calibrations[robot] = Some(layout.variables.len());
            layout.variables.extend((0..2).map(|part| Variable::Calibration(robot, part)));
        }
        layout
    }

    fn index(&self, variable: Variable) -> usize {
        match variable {
            Variable::Pose(keyframe, k) => self.poses[keyframe] + k,
            Variable::Calibration(robot, k) => self.calibrations[robot].unwrap_or(usize::MAX) + k,
        }
    }

    /// An envelope with room for the products of all variables that share a measurement.
    fn envelope(&self, team: &Team) -> Envelope {
        let mut first: Vec<usize> = (0..self.variables.len()).collect();
        let mut group = |variables: &mut dyn Iterator<Item = usize>| {
            let variables: Vec<usize> = variables.collect();
            let lowest = variables.iter().copied().min().unwrap_or_default();
            variables.into_iter().for_each(|variable| first[variable] = first[variable].min(lowest));
        };
        let pose = |k: usize| self.poses[k]..self.poses[k] + team.pose_size(k);
        let calibration = |k: usize| {
            let first = self.calibrations[team.keyframes[k].robot];
            first.into_iter().flat_map(|first| first..first + 2)
        };
        (0..team.keyframes.len()).filter(|k| !team.keyframes[*k].is_past).for_each(|k| group(&mut pose(k)));
        self.calibrations.iter().flatten().for_each(|first| group(&mut (*first..first + 2)));
        team.steps.iter().for_each(|s| group(&mut pose(s.from).chain(pose(s.to)).chain(calibration(s.to))));
        team.links.iter().for_each(|link| group(&mut pose(link.from).chain(pose(link.to))));
        let ends = |change: &Change| [change.first, change.second].concat();
        team.changes.iter().for_each(|change| group(&mut ends(change).into_iter().flat_map(pose)));
        team.carried.iter().for_each(|carried| group(&mut carried.variables.iter().map(|own| self.index(*own))));
        Envelope::zeros(first)
    }
}

/// The lower triangle of a symmetric matrix, or its Cholesky factor, in envelope form: each row is stored from its first
/// entry to the diagonal.
#[derive(Clone, Debug)]
struct Envelope {
    /// Column of the first entry of each row.
    first: Vec<usize>,
    /// Offset of each row in `values`.
    begins: Vec<usize>,
    values: Vec<f64>,
}

impl Envelope {
    /// A zero matrix; row `k` begins at column `first[k]`.
    fn zeros(first: Vec<usize>) -> Self {
        let mut total = 0;
        let begin = |(row, first): (usize, &usize)| {
            let begin = total;
            total += row + 1 - first;
            begin
        };
        let begins = first.iter().enumerate().map(begin).collect();
        Self { first, begins, values: vec![0.0; total] }
    }

    fn len(&self) -> usize {
        self.first.len()
    }

    /// The entries of a row from column `from` up to `end`; `from` must be inside the envelope.
    fn row(&self, row: usize, from: usize, end: usize) -> &[f64] {
        let begin = self.begins[row] + from - self.first[row];
        &self.values[begin..begin + end - from]
    }

    /// Adds to an entry; the envelope must hold it.
    fn add(&mut self, row: usize, column: usize, value: f64) {
        let (row, column) = if row < column { (column, row) } else { (row, column) };
        self.values[self.begins[row] + column - self.first[row]] += value;
    }

    /// Multiplies the diagonal by `1 + damping` and adds 1e-9, so that an unconstrained variable does not move.
    fn damp(&mut self, damping: f64) {
        for row in 0..self.len() {
            let at = self.begins[row] + row - self.first[row];
            self.values[at] = self.values[at] * (1.0 + damping) + 1e-9;
        }
    }

    /// The Cholesky factor. On failure, the row at which the matrix is not positive definite.
    fn factor(mut self) -> Result<Self, usize> {
        for row in 0..self.len() {
            for column in self.first[row]..=row {
                let from = self.first[row].max(self.first[column]);
                let sum = dot(self.row(row, from, column), self.row(column, from, column));
                let at = self.begins[row] + column - self.first[row];
                let rest = self.values[at] - sum;
                self.values[at] = if column < row {
                    rest / self.row(column, column, column + 1)[0]
                } else if rest > 1e-11 * self.values[at] {
                    rest.sqrt()
                } else {
                    return Err(row);
                };
            }
        }
        Ok(self)
    }

    /// Solves `L L' x = side` in place.
    fn solve(&self, side: &mut [f64]) {
        for row in 0..self.len() {
            let first = self.first[row];
            let known = dot(self.row(row, first, row), &side[first..row]);
            side[row] = (side[row] - known) / self.row(row, row, row + 1)[0];
        }
        for row in (0..self.len()).rev() {
            let first = self.first[row];
            side[row] /= self.row(row, row, row + 1)[0];
            let (before, rest) = side.split_at_mut(row);
            let own = self.row(row, first, row);
            before[first..].iter_mut().zip(own).for_each(|(x, a)| *x -= a * rest[0]);
        }
    }
}

/// Dot product in eight partial sums, so that additions need not wait for each other.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (mut sums, tail) = ([0.0; 8], a.len() - a.len() % 8);
    for (a, b) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        sums.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (a, b))| *sum += a * b);
    }
    let rest: f64 = a[tail..].iter().zip(&b[tail..]).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f64>() + rest
}

/// The graph, its variables, and the outlier share of each link.
struct Problem<'a> {
    team: &'a Team,
    layout: Layout,
    zeros: Envelope,
    null_shares: Vec<f64>,
}

type Entry = (Variable, f64);

/// Receives each residual, in deviations, and its derivatives.
type Rows<'a> = dyn FnMut(f64, &[Entry]) + 'a;

/// Divides each residual by `temper`, adds it to the cost and passes it on.
fn tempered<'a>(temper: f64, cost: &'a mut f64, rows: &'a mut Rows<'_>) -> impl FnMut(f64, &[Entry]) {
    let by = 1.0 / temper;
    let mut scaled = Vec::new();
    move |residual, entries| {
        *cost += 0.5 * (residual * by).powi(2);
        scaled.clear();
        scaled.extend(entries.iter().map(|(variable, derivative)| (*variable, derivative * by)));
        rows(residual * by, &scaled);
    }
}

/// Derivatives that pull the ends of a measurement apart.
fn along_line([from, to]: [usize; 2], x: f64, y: f64) -> [Entry; 4] {
    use Variable::Pose;
    [(Pose(from, 0), -x), (Pose(from, 1), -y), (Pose(to, 0), x), (Pose(to, 1), y)]
}

/// `factor` times the derivatives of a range; and the range.
fn gradient_of_range(state: &State, ends: [usize; 2], factor: f64) -> ([Entry; 4], f64) {
    let (x, y) = state.between(ends);
    let range_m = x.hypot(y);
    (along_line(ends, factor * x / range_m.max(1e-9), factor * y / range_m.max(1e-9)), range_m)
}

/// Selects measurements by their keyframes.
type Wanted<'a> = &'a dyn Fn(&[usize]) -> bool;

impl<'a> Problem<'a> {
    fn new(team: &'a Team) -> Self {
        let (layout, null_shares) = (Layout::new(team), team.links.iter().map(|link| link.null_share).collect());
        Self { team, zeros: layout.envelope(team), layout, null_shares }
    }

    /// The cost of the `wanted` measurements at a state: half of the squared residuals plus the constants of the candidates'
    /// densities. `rows` receives each residual.
    fn visit(&self, state: &State, temper: f64, wanted: Wanted<'_>, rows: &mut Rows<'_>) -> f64 {
        let mut cost = 0.0;
        let mut add = tempered(temper, &mut cost, rows);
        for prior in self.team.priors.iter().filter(|prior| wanted(&[prior.keyframe])) {
            for k in 0..self.team.pose_size(prior.keyframe) {
                let Some(sd) = prior.sd[k] else { continue };
                let off = state.poses[prior.keyframe][k] - prior.pose[k];
                add(if k == 2 { wrap(off) } else { off } / sd, &[(Variable::Pose(prior.keyframe, k), 1.0 / sd)]);
            }
        }
        self.team.steps.iter().filter(|s| wanted(&[s.from, s.to])).for_each(|s| self.step(state, s, &mut add));
        for change in self.team.changes.iter().filter(|c| wanted(&[c.first, c.second].concat())) {
            let (first, first_m) = gradient_of_range(state, change.first, -1.0 / change.sd_m);
            let (second, second_m) = gradient_of_range(state, change.second, 1.0 / change.sd_m);
            add((second_m - first_m - change.change_m) / change.sd_m, &[first, second].concat());
        }
        drop(add);
        cost + self.links(state, temper, wanted, rows)
    }

    /// The cost of the calibrations' priors and of the marginalised keyframes. Neither belongs to a keyframe.
    fn shared(&self, state: &State, temper: f64, rows: &mut Rows<'_>) -> f64 {
        let mut cost = 0.0;
        let mut add = tempered(temper, &mut cost, rows);
        let carried = self.team.carried.as_ref();
        for robot in (0..self.team.robots.len()).filter(|robot| self.layout.calibrations[*robot].is_some()) {
            if carried.is_some_and(|carried| carried.has_calibration(robot)) {
                continue;
            }
            let noise = &self.team.robots[robot].noise;
            for (k, sd) in [noise.bias_sd_rad_per_m, noise.scale_sd].into_iter().enumerate() {
                add(state.calibrations[robot][k] / sd, &[(Variable::Calibration(robot, k), 1.0 / sd)]);
            }
        }
        if let Some(own) = carried {
            let off = own.variables.iter().zip(&own.at).map(|(variable, at)| {
                let off = state.get(*variable) - at;
                if matches!(variable, Variable::Pose(_, 2)) { wrap(off) } else { off }
            });
            let residuals = &own.rows * DVector::from_iterator(own.at.len(), off) + &own.side;
            for (row, residual) in residuals.iter().enumerate() {
                let by = own.rows.row(row);
                let entries: Vec<Entry> = own.variables.iter().copied().zip(by.iter().copied()).collect();
                add(*residual, &entries);
            }
        }
        drop(add);
        cost
    }

    fn step(&self, state: &State, step: &Step, add: &mut Rows<'_>) {
        use Variable::{Calibration, Pose};
        let robot = self.team.keyframes[step.to].robot;
        let (a, b, [bias, scale]) = (state.poses[step.from], state.poses[step.to], state.calibrations[robot]);
        let ((sin, cos), (x, y)) = (a[2].sin_cos(), (b[0] - a[0], b[1] - a[1]));
        let (forward, left) = (cos * x + sin * y, cos * y - sin * x);
        let (turn_sin, turn_cos) = (0.5 * bias * step.driven_m).sin_cos();
        let [mx, my, turn] = step.motion;
        let (mx, my) = (turn_cos * mx - turn_sin * my, turn_sin * mx + turn_cos * my);
        let ([sd_m, sd_rad], half) = (step.sd, 0.5 * step.driven_m * (1.0 + scale));
        let place = |residual: f64, by: [f64; 2], by_yaw: f64, by_bias: f64, by_scale: f64, add: &mut Rows<'_>| {
            let by = by.map(|by| by / sd_m);
            add(
                residual / sd_m,
                &[
                    (Pose(step.from, 0), -by[0]),
                    (Pose(step.from, 1), -by[1]),
                    (Pose(step.from, 2), by_yaw / sd_m),
                    (Pose(step.to, 0), by[0]),
                    (Pose(step.to, 1), by[1]),
                    (Calibration(robot, 0), by_bias / sd_m),
                    (Calibration(robot, 1), by_scale / sd_m),
                ],
            );
        };
        place(forward - (1.0 + scale) * mx, [cos, sin], left, half * my, -mx, add);
        place(left - (1.0 + scale) * my, [-sin, cos], -forward, -half * mx, -my, add);
        let off = wrap(b[2] - a[2] - turn - bias * step.driven_m) / sd_rad;
        let by = 1.0 / sd_rad;
        add(off, &[(Pose(step.from, 2), -by), (Pose(step.to, 2), by), (Calibration(robot, 0), -step.driven_m * by)]);
    }

    fn links(&self, state: &State, temper: f64, wanted: Wanted<'_>, rows: &mut Rows<'_>) -> f64 {
        let mut cost = 0.0;
        for (link, null_share) in self.team.links.iter().zip(&self.null_shares) {
            if !wanted(&[link.from, link.to]) {
                continue;
            }
            let (chosen, own) = state.best(link, *null_share, temper);
            cost += own;
            let Some(mode) = chosen.map(|k| link.modes[k]) else { continue };
            let (ends, yaw) = ([link.from, link.to], state.poses[link.from][2]);
            let (x, y) = state.between(ends);
            let range_m = x.hypot(y);
            if let Some([expected, sd]) = mode.azimuth_rad {
                let (off, near) = (wrap(wrap(y.atan2(x) - yaw) - expected), nearness(range_m));
                let (x, y) = (x / range_m.max(1e-9), y / range_m.max(1e-9));
                let by = near / (sd * temper);
                // Across the line of sight the azimuth changes. Along it, the weight changes below `NEAREST_M`.
                let (across, along) =
                    (by / range_m.max(1e-9), if near < 1.0 { off / (sd * temper * NEAREST_M) } else { 0.0 });
                let (x, y) = (along * x - across * y, along * y + across * x);
                rows(off * by, &[&along_line(ends, x, y)[..], &[(Variable::Pose(link.from, 2), -by)]].concat());
                if near < 1.0 {
                    // The density is proportional to the range: gradient and curvature of its negative logarithm.
                    rows(-1.0, &gradient_of_range(state, ends, 1.0 / range_m.max(1e-9)).0);
                }
            }
            if let Some([expected, sd]) = mode.range_m {
                let by = 1.0 / (sd * temper);
                rows((range_m - expected) * by, &gradient_of_range(state, ends, by).0);
            }
        }
        cost
    }

    fn cost(&self, state: &State, temper: f64) -> f64 {
        self.visit(state, temper, &|_| true, &mut |_, _| {}) + self.shared(state, temper, &mut |_, _| {})
    }

    /// The normal matrix and the gradient at a state.
    fn normal(&self, state: &State, temper: f64) -> (Envelope, Vec<f64>) {
        let (mut matrix, mut side) = (self.zeros.clone(), vec![0.0; self.layout.variables.len()]);
        let mut add = |residual: f64, entries: &[Entry]| {
            for (k, (variable, by)) in entries.iter().enumerate() {
                let row = self.layout.index(*variable);
                side[row] += by * residual;
                for (other, factor) in &entries[..=k] {
                    matrix.add(row, self.layout.index(*other), by * factor);
                }
            }
        };
        self.visit(state, temper, &|_| true, &mut add);
        self.shared(state, temper, &mut add);
        (matrix, side)
    }

    fn moved(&self, state: &State, by: &[f64]) -> State {
        let mut moved = state.clone();
        for (variable, by) in self.layout.variables.iter().zip(by) {
            let value = moved.get_mut(*variable);
            *value -= by;
            if matches!(variable, Variable::Pose(_, 2)) {
                *value = wrap(*value);
            }
        }
        moved
    }

    /// Levenberg-Marquardt \[levenberg1944\] \[marquardt1963\] until a step reduces the cost by at most `least`. Returns the
    /// minimum and its cost.
    fn descend(&self, mut state: State, temper: f64, least: f64) -> (State, f64) {
        let (mut cost, mut damping) = (self.cost(&state, temper), 1e-4);
        for _ in 0..STEPS {
            let (matrix, side) = self.normal(&state, temper);
            let gain = loop {
                let mut damped = matrix.clone();
                damped.damp(damping);
                let by = damped.factor().ok().map(|factor| {
                    let mut by = side.clone();
                    factor.solve(&mut by);
                    by
                });
                // Cost reduction that the linear model predicts.
                let hoped = |by: &Vec<f64>| 0.5 * by.iter().zip(&side).map(|(by, side)| by * side).sum::<f64>();
                if by.as_ref().is_some_and(|by| hoped(by) < least) || damping > 1e8 {
                    break 0.0;
                }
                if let Some(next) = by.map(|by| self.moved(&state, &by)) {
                    let next_cost = self.cost(&next, temper);
                    if next_cost < cost {
                        let gain = cost - next_cost;
                        (state, cost, damping) = (next, next_cost, (0.1 * damping).max(1e-9));
                        break gain;
                    }
                }
                damping *= 10.0;
            };
            if gain <= least {
                break;
            }
        }
        (state, cost)
    }

    /// Learns the outlier share of each robot at a state, and switches off a robot whose links fit no better than chance.
    /// Returns the shares.
    fn learn_shares(&mut self, state: &State) -> Vec<f64> {
        let mut own = vec![(0.0, 0.0, 0.0); self.team.robots.len()];
        let robot = |link: &Link| self.team.keyframes[link.from].robot;
        for link in &self.team.links {
            let (links, nulls, given) = &mut own[robot(link)];
            let is_null = state.best(link, link.null_share, 1.0).0.is_none();
            (*links, *nulls, *given) = (*links + 1.0, *nulls + f64::from(u8::from(is_null)), *given + link.null_share);
        }
        let mean = |(links, _, given): (f64, f64, f64)| if links > 0.0 { given / links } else { 0.0 };
        let share = |own: &(f64, f64, f64)| (own.1 + NULL_LINKS * mean(*own)) / (own.0 + NULL_LINKS);
        let shares: Vec<f64> = own.iter().map(share).collect();
        // A robot's links may have different given shares: the ratios of their odds stay the same.
        let odds = |share: f64| share / (1.0 - share);
        let learnt = |link: &Link| {
            let learnt = odds(link.null_share) * odds(shares[robot(link)]) / odds(mean(own[robot(link)]));
            learnt / (1.0 + learnt)
        };
        self.null_shares = self.team.links.iter().map(learnt).collect();
        let mut costs = vec![0.0; self.team.robots.len()];
        for (link, null_share) in self.team.links.iter().zip(&self.null_shares) {
            costs[robot(link)] += state.best(link, *null_share, 1.0).1;
        }
        for (link, null_share) in self.team.links.iter().zip(&mut self.null_shares) {
            if own[robot(link)].0 > NULL_LINKS && costs[robot(link)] > LIARS.ln() {
                *null_share = 1.0;
            }
        }
        shares
    }

    /// The better of two minima, each with outlier shares learnt there. One descent begins with wider deviations, which
    /// switches robots with right bearings on again.
    fn settle(&mut self, begin: &State) -> Settled {
        let mut best: Option<Settled> = None;
        for tempers in [&[1.0][..], &[3.0, 1.0]] {
            let mut state = begin.clone();
            for temper in tempers {
                self.learn_shares(&state);
                state = self.descend(state, *temper, ROUGHLY).0;
            }
            let own = self.settled(state);
            if best.as_ref().is_none_or(|best| own.cost < best.cost) {
                best = Some(own);
            }
        }
        best.unwrap_or_default()
    }

    /// The minimum near a state, with outlier shares learnt at the state.
    fn settled(&mut self, begin: State) -> Settled {
        let outlier_shares = self.learn_shares(&begin);
        let (state, cost) = self.descend(begin, 1.0, ROUGHLY);
        Settled { state, cost, outlier_shares, null_shares: self.null_shares.clone() }
    }

    /// Descends again from perturbations of a minimum. A chosen candidate holds its pose, so there may be a lower minimum nearby.
    fn kick(&mut self, best: &mut Settled) {
        for kick in 1..=KICKS {
            let mut state = best.state.clone();
            for (k, pose) in state.poses.iter_mut().enumerate() {
                let [m, rad] = KICK;
                let by = |part: usize| even((3 * k + part + 1) * (2 * kick + 1));
                *pose = [pose[0] + m * by(0), pose[1] + m * by(1), wrap(pose[2] + rad * by(2))];
            }
            self.null_shares.clone_from(&best.null_shares);
            let state = self.descend(state, 1.0, ROUGHLY).0;
            let own = self.settled(state);
            if own.cost < best.cost {
                *best = own;
            }
        }
    }

    /// Tries other places for each robot among the others, and adds the minima found. With `is_suspect_only`, for robots with
    /// more outliers than other links.
    fn place_again(&mut self, settled: &mut Vec<Settled>, is_suspect_only: bool) {
        let tried = TRIED[usize::from(is_suspect_only)];
        let rounds = if is_suspect_only { 1 } else { ROUNDS };
        for _ in 0..rounds {
            let Some(best) = settled.first() else { return };
            let (cost, null_shares) = (best.cost, best.null_shares.clone());
            let robots = (0..self.team.robots.len()).filter(|robot| !is_suspect_only || self.is_suspect(best, *robot));
            let mut states: Vec<(f64, State)> =
                robots.flat_map(|robot| again(self.team, &best.state, &null_shares, robot)).collect();
            states.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut lowest = cost;
            for (_, state) in states.into_iter().take(tried) {
                if lowest < cost - GAIN {
                    break;
                }
                self.null_shares.clone_from(&null_shares);
                let state = self.descend(state, 2.0, ROUGHLY).0;
                let (state, own) = self.descend(state, 1.0, ROUGHLY);
                if own < lowest + COSTLIER && !settled.iter().any(|other| state.is_near(&other.state)) {
                    let own = self.settle(&state);
                    lowest = lowest.min(own.cost);
                    settled.push(own);
                }
            }
            settled.sort_by(|a, b| a.cost.total_cmp(&b.cost));
            if lowest >= cost - GAIN {
                return;
            }
        }
    }

    /// True if most links to and from a robot are outliers, without those of switched-off robots.
    fn is_suspect(&self, at: &Settled, robot: usize) -> bool {
        let (mut links, mut outliers) = (0, 0);
        for (link, null_share) in self.team.links.iter().zip(&at.null_shares) {
            let ends = [link.from, link.to].map(|k| self.team.keyframes[k].robot);
            if *null_share < 1.0 && ends.contains(&robot) {
                links += 1;
                outliers += usize::from(at.state.best(link, *null_share, 1.0).0.is_none());
            }
        }
        2 * outliers > links
    }

    /// The linear prior that the measurements of old keyframes leave on the other variables.
    fn carry(&self, state: &State, touches: Wanted<'_>, old: &[usize]) -> Carried {
        let n = self.layout.variables.len();
        let (mut matrix, mut side) = (DMatrix::<f64>::zeros(n, n), DVector::<f64>::zeros(n));
        let mut add = |residual: f64, entries: &[Entry]| {
            for (variable, by) in entries {
                let row = self.layout.index(*variable);
                side[row] += by * residual;
                entries.iter().for_each(|(other, factor)| matrix[(row, self.layout.index(*other))] += by * factor);
            }
        };
        self.visit(state, 1.0, touches, &mut add);
        self.shared(state, 1.0, &mut add);
        let is_old = |k: &usize| matches!(self.layout.variables[*k], Variable::Pose(keyframe, _) if old.binary_search(&keyframe).is_ok());
        let (gone, stay): (Vec<usize>, Vec<usize>) = (0..n).filter(|k| matrix[(*k, *k)] > 0.0).partition(is_old);
        let part = |rows: &[usize], columns: &[usize]| {
            DMatrix::from_fn(rows.len(), columns.len(), |row, column| matrix[(rows[row], columns[column])])
        };
        let of = |rows: &[usize]| DVector::from_iterator(rows.len(), rows.iter().map(|row| side[*row]));
        let mut inner = part(&gone, &gone);
        (0..gone.len()).for_each(|k| inner[(k, k)] *= 1.0 + 1e-12);
        let cross = part(&stay, &gone);
        let inverse = inner.pseudo_inverse(1e-12).unwrap_or_else(|_| DMatrix::zeros(gone.len(), gone.len()));
        let rest = part(&stay, &stay) - &cross * &inverse * cross.transpose();
        let gradient = of(&stay) - &cross * inverse * of(&gone);
        let own = (0.5 * (&rest + rest.transpose())).symmetric_eigen();
        let least = 1e-12 * own.eigenvalues.max();
        let kept: Vec<usize> = (0..stay.len()).filter(|k| own.eigenvalues[*k] > least).collect();
        let root = |k: usize| own.eigenvalues[k].sqrt();
        let rows = DMatrix::from_fn(kept.len(), stay.len(), |row, column| {
            root(kept[row]) * own.eigenvectors[(column, kept[row])]
        });
        let along = kept.iter().map(|k| own.eigenvectors.column(*k).dot(&gradient) / root(*k));
        let side = DVector::from_iterator(kept.len(), along);
        let variables: Vec<Variable> = stay.iter().map(|k| self.layout.variables[*k]).collect();
        let at = variables.iter().map(|variable| state.get(*variable)).collect();
        Carried { variables, at, rows, side }
    }
}

/// Quasi-random numbers from -1 to 1, the same on every machine: multiples of the golden ratio, modulo 1.
fn even(k: usize) -> f64 {
    2.0 * (k as f64 * 0.618_033_988_749_895).fract() - 1.0
}

/// A minimum and the outlier shares there.
#[derive(Default)]
struct Settled {
    state: State,
    cost: f64,
    outlier_shares: Vec<f64>,
    null_shares: Vec<f64>,
}

/// Another solution that fits nearly as well.
#[derive(Clone, Debug, PartialEq)]
pub struct Other {
    /// Pose of each keyframe: x, y, yaw.
    pub poses: Vec<[f64; 3]>,
    /// Its cost minus that of the solution, from 0 to ln 2: the logarithm of the likelihood ratio.
    pub cost_over: f64,
}

/// Poses of all keyframes, with covariances and the chosen candidates.
#[derive(Clone, Debug)]
pub struct Solution {
    pub(crate) state: State,
    pub(crate) gauge: Option<Prior>,
    pub(crate) null_shares: Vec<f64>,
    layout: Layout,
    factor: Envelope,
    /// For each link, the index of the chosen candidate; `None` for an outlier.
    pub chosen: Vec<Option<usize>>,
    /// Learnt outlier share of each robot's links: near 1 if its bearings are wrong.
    pub outlier_shares: Vec<f64>,
    /// Negative log-likelihood, up to a constant of the graph.
    pub cost: f64,
    /// Other solutions, the likeliest first; a mirror leaves two, for example.
    pub others: Vec<Other>,
}

impl Solution {
    /// Pose of a keyframe: x, y, yaw; NaN for one added after the solution. The yaw of a point has no meaning.
    #[must_use]
    pub fn pose(&self, keyframe: KeyframeId) -> [f64; 3] {
        self.state.poses.get(keyframe.0).copied().unwrap_or([f64::NAN; 3])
    }

    /// Calibration of a robot's odometry: the turn that it lacks, radians per metre driven, and the relative error of lengths
    /// (0.01: odometry reports 1 % too little). NaN for a robot added after the solution.
    #[must_use]
    pub fn calibration(&self, robot: RobotId) -> [f64; 2] {
        self.state.calibrations.get(robot.0).copied().unwrap_or([f64::NAN; 2])
    }

    /// Marginal covariance of a keyframe's pose (x, y, yaw) in the problem linearised at the solution; it does not cover
    /// `others`. Zero for the yaw of a point, and for a forgotten keyframe; NaN for one added after the solution.
    #[must_use]
    pub fn covariance(&self, keyframe: KeyframeId) -> Matrix3<f64> {
        let mut covariance = Matrix3::zeros();
        let Some(at) = self.layout.poses.get(keyframe.0).copied() else { return Matrix3::from_element(f64::NAN) };
        let own = |k: usize| self.layout.variables.get(at.saturating_add(k)) == Some(&Variable::Pose(keyframe.0, k));
        for column in (0..3).filter(|k| own(*k)) {
            let mut side = vec![0.0; self.layout.variables.len()];
            side[at + column] = 1.0;
            self.factor.solve(&mut side);
            (0..3).filter(|k| own(*k)).for_each(|row| covariance[(row, column)] = side[at + row]);
        }
        covariance
    }
}

impl Team {
    /// Solves for all poses from several initial states. They place one robot after another where candidates of its links to
    /// placed robots cross.
    ///
    /// # Errors
    /// [`TeamError`] if there is no keyframe, a robot has no link, or the measurements do not determine a robot.
    pub fn solve(&self) -> Result<Solution, TeamError> {
        self.solve_all(None)
    }

    /// As [`Team::solve`], but starts from an earlier solution. New robots are placed as in [`Team::solve`].
    ///
    /// # Errors
    /// As [`Team::solve`].
    pub fn solve_from(&self, before: &Solution) -> Result<Solution, TeamError> {
        self.solve_all(Some(before))
    }

    fn solve_all(&self, before: Option<&Solution>) -> Result<Solution, TeamError> {
        if self.keyframes.is_empty() {
            return Err(empty());
        }
        let (mut team, mut gauge) = (std::borrow::Cow::Borrowed(self), None);
        if self.priors.is_empty() && self.carried.is_none() {
            let first = Prior { keyframe: 0, pose: self.keyframes[0].odometry, sd: [Some(GAUGE_SD); 3] };
            gauge = Some(first);
            team.to_mut().priors.push(first);
        }
        let mut problem = Problem::new(&team);
        let tempers = if before.is_some() { &TEMPERS[2..] } else { &TEMPERS[..] };
        let begun = starts(&team, before.map(|own| &own.state))?;
        let mut solved: Vec<(State, f64)> = begun.into_iter().map(|state| (state, 0.0)).collect();
        for temper in tempers {
            solved = solved.into_iter().map(|(state, _)| problem.descend(state, *temper, ROUGHLY)).collect();
            solved.sort_by(|a, b| a.1.total_cmp(&b.1));
            // Merges descents that reached the same minimum.
            solved.dedup_by(|a, b| (a.1 - b.1).abs() < NEAR[1] && a.0.is_near(&b.0));
        }
        let most = solved.first().map_or(0.0, |best| best.1) + COSTLIER;
        solved.retain(|own| own.1 <= most);
        solved.truncate(SETTLED);
        let mut settled: Vec<Settled> = solved.iter().map(|(state, _)| problem.settle(state)).collect();
        settled.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        problem.place_again(&mut settled, before.is_some());
        if let (Some(best), None) = (settled.first_mut(), before) {
            problem.kick(best);
        }
        let mut rest = settled.into_iter();
        let Settled { state, outlier_shares, null_shares, .. } = rest.next().ok_or_else(empty)?;
        problem.null_shares = null_shares;
        let (state, cost) = problem.descend(state, 1.0, EXACTLY);
        let robot_of = |at: usize| match problem.layout.variables[at] {
            Variable::Pose(keyframe, _) => self.keyframes[keyframe].robot,
            Variable::Calibration(robot, _) => robot,
        };
        let undetermined = |at| TeamError::Undetermined { robot: self.robots[robot_of(at)].name.clone() };
        let factor = problem.normal(&state, 1.0).0.factor().map_err(undetermined)?;
        if !factor.values.iter().chain([&cost]).all(|value| value.is_finite()) {
            return Err(TeamError::Refused("the measurements have numbers too large or too small to solve for".into()));
        }
        let choose = |(link, null_share): (&Link, &f64)| state.best(link, *null_share, 1.0).0;
        let chosen = self.links.iter().zip(&problem.null_shares).map(choose).collect();
        let Problem { layout, null_shares, .. } = problem;
        let mut found =
            Solution { state, gauge, null_shares, layout, factor, chosen, outlier_shares, cost, others: Vec::new() };
        for other in rest.filter(|other| other.cost - cost < AS_LIKELY.ln()) {
            if self.is_another(&found, &other.state) {
                found.others.push(Other { poses: other.state.poses, cost_over: other.cost - cost });
            }
        }
        Ok(found)
    }

    /// True if the state differs from the solution, and from each of its `others`, in a keyframe's position.
    fn is_another(&self, found: &Solution, state: &State) -> bool {
        let far = |poses: &[[f64; 3]]| {
            let alive = (0..self.keyframes.len()).filter(|k| !self.keyframes[*k].is_past);
            alive.into_iter().any(|k| {
                let off = nalgebra::Vector2::new(state.poses[k][0] - poses[k][0], state.poses[k][1] - poses[k][1]);
                let inverse = || found.covariance(KeyframeId(k)).fixed_view::<2, 2>(0, 0).try_inverse();
                off.norm() > APART_M && inverse().is_none_or(|inverse| off.dot(&(inverse * off)) > 9.0)
            })
        };
        far(&found.state.poses) && found.others.iter().all(|other| far(&other.poses))
    }

    /// Marginalises keyframes before `before_s`, seconds, with their measurements: a Schur complement at the solution replaces
    /// them by one linear term. The last keyframe of each robot stays.
    pub fn forget(&mut self, solution: &Solution, before_s: f64) {
        let last = |k: usize| self.keyframes.iter().rposition(|own| own.robot == self.keyframes[k].robot) == Some(k);
        let is_old = |k: &usize| self.keyframes[*k].t_s < before_s && !self.keyframes[*k].is_past && !last(*k);
        let old: Vec<usize> = (0..self.keyframes.len()).filter(is_old).collect();
        if old.is_empty() {
            return;
        }
        let touches = |keyframes: &[usize]| keyframes.iter().any(|k| old.binary_search(k).is_ok());
        if let (Some(gauge), true) = (solution.gauge, self.priors.is_empty()) {
            self.priors.push(gauge);
        }
        let carried = {
            let mut problem = Problem::new(self);
            problem.null_shares.iter_mut().zip(&solution.null_shares).for_each(|(own, learnt)| *own = *learnt);
            problem.carry(&solution.state, &touches, &old)
        };
        self.carried = Some(carried);
        self.priors.retain(|own| !touches(&[own.keyframe]));
        self.steps.retain(|own| !touches(&[own.from, own.to]));
        self.links.retain(|own| !touches(&[own.from, own.to]));
        self.changes.retain(|own| !touches(&[own.first, own.second].concat()));
        old.iter().for_each(|k| self.keyframes[*k].is_past = true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Mode, OdometryNoise};

    #[test]
    fn the_gradient_agrees_with_finite_differences_of_the_cost() {
        // Two robots that pass at 0.1 m, a point, and each kind of measurement; no residual is 0.
        let mut team = Team::default();
        let noise = OdometryNoise::default();
        let robots = ["a", "b"].map(|name| team.robot(name, true, noise).unwrap());
        let drive = |team: &mut Team, robot: RobotId, y: f64| {
            [0.0, 1.0].map(|t_s| team.keyframe(robot, t_s, [t_s, y, 0.2 * t_s], 1.1).unwrap())
        };
        let (a, b) = (drive(&mut team, robots[0], 0.0), drive(&mut team, robots[1], 0.1));
        let point = team.robot("c", false, noise).unwrap();
        let point = team.keyframe(point, 0.0, [0.0; 3], 0.0).unwrap();
        team.prior(a[0], [0.1, -0.1, 0.05], [0.3; 3]).unwrap();
        team.link(a[0], b[0], &[Mode::azimuth(0.9, 0.1, 1.0)], 0.1).unwrap();
        team.link(b[1], point, &[Mode { range_m: Some([3.1, 0.2]), ..Mode::azimuth(0.5, 0.1, 1.0) }], 0.1).unwrap();
        team.range_change([a[0], point], [a[1], point], -0.6, 0.1).unwrap();
        let problem = Problem::new(&team);
        let poses = vec![[0.0, 0.0, 0.1], [1.05, 0.1, 0.2], [0.03, 0.1, 0.0], [1.1, 0.2, 0.1], [3.5, 2.0, 0.0]];
        let state = State { poses, calibrations: vec![[0.02, 0.01], [-0.03, 0.02], [0.0; 2]] };
        let (_, gradient) = problem.normal(&state, 1.0);
        for (k, gradient) in gradient.iter().enumerate() {
            let cost = |by: f64| {
                let mut step = vec![0.0; problem.layout.variables.len()];
                step[k] = -by;
                problem.cost(&problem.moved(&state, &step), 1.0)
            };
            let difference = (cost(1e-6) - cost(-1e-6)) / 2e-6;
            let variable = problem.layout.variables[k];
            assert!(
                (gradient - difference).abs() < 1e-5 * (1.0 + difference.abs()),
                "{variable:?}: {gradient} {difference}"
            );
        }
    }
    #[test]
    fn envelope_and_dense_cholesky_give_the_same_solution() {
        let first = vec![0, 0, 1, 1, 3, 0];
        let mut own = Envelope::zeros(first.clone());
        let mut dense = DMatrix::<f64>::zeros(6, 6);
        for row in 0..6 {
            for column in first[row]..=row {
                let value = if row == column { 5.0 + row as f64 } else { 1.0 / (1.0 + (row + 2 * column) as f64) };
                own.add(column, row, value);
                (dense[(row, column)], dense[(column, row)]) = (value, value);
            }
        }
        let side = DVector::from_fn(6, |k, _| k as f64 - 2.5);
        let mut x = side.as_slice().to_vec();
        own.clone().factor().unwrap().solve(&mut x);
        let expected = dense.cholesky().unwrap().solve(&side);
        assert!((DVector::from_vec(x) - expected).norm() < 1e-12);
        own.add(3, 3, -20.0);
        assert_eq!(own.factor().unwrap_err(), 3);
    }
}
