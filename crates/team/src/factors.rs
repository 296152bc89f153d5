//! Exports the graph: JSON for GTSAM (`examples/gtsam/factors.py`), or g2o's text format.
//!
//! Units are metres and radians. Yaw grows from +x towards +y. An azimuth is relative to the yaw of the observing keyframe.

use crate::graph::Team;
use crate::solve::Solution;
use crate::{KeyframeId, RobotId};
use serde_json::json;
use std::fmt::Write;

/// The graph and its solution as JSON.
///
/// `graph` has `robots` (`name`, `has_heading`, `noise`), `keyframes` (`robot`, `t_s`, `odometry`), `priors`, `steps` (`from`,
/// `to`, `motion`, `driven_m`, `sd` of position and turn), `links` (`from`, `to`, `modes`, `null_share`) and `changes`. Robots
/// and keyframes are numbered from 0. `solution` has `poses`, `covariances` (row by row), `chosen` candidates,
/// `outlier_shares`, `cost` and, for each robot, `calibrations`: the turn per metre and the relative error of lengths.
#[must_use]
pub fn json(team: &Team, found: &Solution) -> String {
    let mut team = team.clone();
    team.priors.extend(found.gauge);
    team.links.iter_mut().zip(&found.null_shares).for_each(|(link, learnt)| link.null_share = *learnt);
    let keyframes = || (0..team.keyframes.len()).map(KeyframeId);
    let covariance = |id: KeyframeId| -> [[f64; 3]; 3] { found.covariance(id).transpose().into() };
    let solution = json!({
        "poses": keyframes().map(|id| found.pose(id)).collect::<Vec<_>>(),
        "covariances": keyframes().map(covariance).collect::<Vec<_>>(),
        "calibrations": (0..team.robots.len()).map(|k| found.calibration(RobotId(k))).collect::<Vec<_>>(),
        "chosen": found.chosen,
        "outlier_shares": found.outlier_shares,
        "cost": found.cost,
    });
    format!("{}\n", json!({ "format": "csi5300-team", "version": 1, "graph": team, "solution": solution }))
}

/// The graph in g2o's text format, with its `VERTEX_SE2`, `EDGE_PRIOR_SE2` and `EDGE_SE2`.
///
/// The chosen candidate of each link becomes `EDGE_BEARING_SE2 FROM TO AZIMUTH INFORMATION`,
/// `EDGE_RANGE_SE2 FROM TO RANGE INFORMATION`, or both. Readers that do not know these two edges skip them. Steps are
/// corrected by the estimated calibration. Outliers and range changes have no edge.
#[must_use]
pub fn g2o(team: &Team, found: &Solution) -> String {
    let mut text = String::new();
    let weight = |sd: f64| 1.0 / (sd * sd);
    for (k, own) in team.keyframes.iter().enumerate().filter(|(_, own)| !own.is_past) {
        let [x, y, yaw] = found.pose(KeyframeId(k));
        let name = &team.robots[own.robot].name;
        let _ = writeln!(text, "# {k}: {} at {} s", name.escape_debug(), own.t_s);
        let _ = writeln!(text, "VERTEX_SE2 {k} {x} {y} {yaw}");
    }
    for prior in team.priors.iter().chain(&found.gauge) {
        let ([x, y, yaw], [a, b, c]) = (prior.pose, prior.sd.map(|sd| sd.map_or(0.0, weight)));
        let _ = writeln!(text, "EDGE_PRIOR_SE2 {} {x} {y} {yaw} {a} 0 0 {b} 0 {c}", prior.keyframe);
    }
    for step in &team.steps {
        let [bias, scale] = found.calibration(RobotId(team.keyframes[step.to].robot));
        let ([x, y, turn], (sin, cos)) = (step.motion, (0.5 * bias * step.driven_m).sin_cos());
        let (x, y) = ((1.0 + scale) * (cos * x - sin * y), (1.0 + scale) * (sin * x + cos * y));
        let ([place, yaw], turn) = (step.sd.map(weight), turn + bias * step.driven_m);
        let _ = writeln!(text, "EDGE_SE2 {} {} {x} {y} {turn} {place} 0 0 {place} 0 {yaw}", step.from, step.to);
    }
    for (link, chosen) in team.links.iter().zip(&found.chosen) {
        let Some(mode) = chosen.and_then(|k| link.modes.get(k)) else { continue };
        let kinds = [("BEARING", mode.azimuth_rad), ("RANGE", mode.range_m)];
        for (kind, [value, sd]) in kinds.into_iter().filter_map(|(kind, own)| Some((kind, own?))) {
            let _ = writeln!(text, "EDGE_{kind}_SE2 {} {} {value} {}", link.from, link.to, weight(sd));
        }
    }
    text
}
