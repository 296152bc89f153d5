//! The graph for other estimators: JSON for GTSAM (`examples/gtsam/factors.py`), and g2o's text.
//!
//! Conventions: metres, radians; yaw from +x towards +y; an azimuth is less the yaw of the keyframe that it was measured from.

use crate::graph::Team;
use crate::solve::Solution;
use crate::{KeyframeId, RobotId};
use serde_json::json;
use std::fmt::Write;

/// All factors as JSON, with the solution beside each variable.
///
/// `robots` (`name`, `has_heading`, `noise`), `keyframes` (`robot`, `t_s`, `odometry`), `priors`, `steps` (`from`, `to`, `motion`,
/// `driven_m`, `sd` of place and turn), `links` (`from`, `to`, `modes`, `null_share`), `changes`; robots and keyframes are
/// numbered from 0. `solution` has `poses`, `covariances` (row by row) and `chosen` candidates; `calibrations` by robot are
/// the turn per metre and the relative error of lengths.
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

/// The graph as g2o's text: `VERTEX_SE2`, `EDGE_PRIOR_SE2` and `EDGE_SE2` as g2o has them. Of links it has the chosen candidates, as
/// `EDGE_BEARING_SE2 FROM TO AZIMUTH INFORMATION` and `EDGE_RANGE_SE2 FROM TO RANGE INFORMATION`, which readers that do not
/// know them skip. Steps are corrected by the calibration found; range changes have no edge.
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
