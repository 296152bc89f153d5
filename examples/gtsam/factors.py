"""Solves a team's graph with GTSAM. Input: JSON from `csi5300 bearing CAPTURE --factors OUT.json` or `cargo run -p csi5300-team --example team -- 5 1 OUT.json`.

Keyframe k is Pose2 k. The calibration of robot r is the vector C(r): turn per metre, relative error of lengths. The optimisation starts from perturbed
poses; it must reach the poses and covariances of the file. Requires `pip install gtsam`. team.ipynb draws the map.
"""

import json
import math
import sys

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C

NEAREST_M = 0.3


def factor(keys: list, sds: list, error) -> gtsam.CustomFactor:
    """A factor with the residuals `error(*values)` and derivatives by finite differences."""

    def with_jacobians(own: gtsam.CustomFactor, values: gtsam.Values, jacobians: list | None) -> np.ndarray:
        at = [values.atPose2(key) if key < C(0) else values.atVector(key) for key in own.keys()]
        if jacobians is not None:
            for side, value in enumerate(at):
                size = 3 if isinstance(value, gtsam.Pose2) else 2
                jacobians[side] = np.zeros((len(sds), size), order="F")
                for k, step in enumerate(1e-6 * np.eye(size)):
                    ends = [error(*at[:side], value.retract(by) if size == 3 else value + by, *at[side + 1 :]) for by in (step, -step)]
                    jacobians[side][:, k] = (ends[0] - ends[1]) / 2e-6
        return error(*at)

    return gtsam.CustomFactor(gtsam.noiseModel.Diagonal.Sigmas(np.array(sds)), keys, with_jacobians)


def wrap(angle: float) -> float:
    return math.remainder(angle, math.tau)


def step_error(step: dict):
    (x, y, turn), driven = step["motion"], step["driven_m"]

    def error(a: gtsam.Pose2, b: gtsam.Pose2, calibration: np.ndarray) -> np.ndarray:
        bias, scale = calibration
        moved = (1 + scale) * gtsam.Rot2(0.5 * bias * driven).rotate(np.array([x, y]))
        return np.append(a.transformTo(b.translation()) - moved, wrap(b.theta() - a.theta() - turn - bias * driven))

    return error


def link_factor(link: dict, null_share: float) -> gtsam.CustomFactor:
    """A max-mixture: the residuals of the likeliest candidate, in deviations, or 0 for the outlier. The third residual is the cost of the component's density, relative to the least one, plus 1."""
    total, options = sum(mode["share"] for mode in link["modes"]), [(-math.log(max(null_share, 1e-300)), None, None)]
    for mode in link["modes"] if null_share < 1 else []:
        cost = -math.log((1 - null_share) * mode["share"] / total)
        for part, uniform in (mode["azimuth_rad"], math.tau), (mode["range_m"], 30.0):
            cost += math.log(part[1] * math.sqrt(math.tau) / uniform) if part else 0.0
        options.append((cost, mode["azimuth_rad"], mode["range_m"]))
    least = min(cost for cost, _, _ in options)

    def error(a: gtsam.Pose2, b: gtsam.Pose2) -> np.ndarray:
        seen = b.translation() - a.translation()
        azimuth, distance = math.atan2(seen[1], seen[0]) - a.theta(), float(np.linalg.norm(seen))
        residuals = []
        for cost, by_azimuth, by_range in options:
            # Below NEAREST_M, the lateral deviation stays what it is at NEAREST_M.
            near = max(min(distance / NEAREST_M, 1.0), 1e-6) if by_azimuth else 1.0
            turned = wrap(azimuth - by_azimuth[0]) / by_azimuth[1] * near if by_azimuth else 0.0
            residuals.append(np.array([turned, (distance - by_range[0]) / by_range[1] if by_range else 0.0, math.sqrt(2 * (1 + cost - least - math.log(near)))]))
        return min(residuals, key=lambda own: own @ own)

    return factor([link["from"], link["to"]], [1.0, 1.0, 1.0], error)


def change_error(change: dict):
    return lambda a, b, c, d: np.array([np.linalg.norm(d.translation() - c.translation()) - np.linalg.norm(b.translation() - a.translation()) - change["change_m"]])


def solve(document: dict) -> tuple[np.ndarray, np.ndarray, int]:
    """Poses (x, y, yaw) of all keyframes and their covariances in the team's frame, and the number of factors."""
    team, found = document["graph"], document["solution"]
    graph, start, random = gtsam.NonlinearFactorGraph(), gtsam.Values(), np.random.default_rng(1)
    for k, (keyframe, pose) in enumerate(zip(team["keyframes"], found["poses"])):
        start.insert(k, gtsam.Pose2(*(np.array(pose) + random.normal(0, [0.02, 0.02, 0.01]))))
        if not team["robots"][keyframe["robot"]]["has_heading"]:
            graph.add(factor([k], [1.0], lambda pose: np.array([pose.theta()])))  # a point's yaw has no meaning
    for prior in team["priors"]:
        for part, (value, sd) in enumerate(zip(prior["pose"], prior["sd"])):
            if sd and (part < 2 or team["robots"][team["keyframes"][prior["keyframe"]]["robot"]]["has_heading"]):
                off = lambda pose, part=part, value=value: np.array([wrap(pose.theta() - value) if part == 2 else pose.translation()[part] - value])
                graph.add(factor([prior["keyframe"]], [sd], off))
    for robot in sorted({team["keyframes"][step["to"]]["robot"] for step in team["steps"]}):
        noise = team["robots"][robot]["noise"]
        start.insert(C(robot), np.array(found["calibrations"][robot]))
        graph.add(factor([C(robot)], [noise["bias_sd_rad_per_m"], noise["scale_sd"]], lambda calibration: calibration))
    for step in team["steps"]:
        robot, (place, turn) = team["keyframes"][step["to"]]["robot"], step["sd"]
        graph.add(factor([step["from"], step["to"], C(robot)], [place, place, turn], step_error(step)))
    for link in team["links"]:
        graph.add(link_factor(link, link["null_share"]))
    for change in team["changes"]:
        graph.add(factor([*change["first"], *change["second"]], [change["sd_m"]], change_error(change)))

    end = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
    marginals, poses, covariances = gtsam.Marginals(graph, end), [], []
    for k in range(len(team["keyframes"])):
        own, turned = end.atPose2(k), np.eye(3)
        turned[:2, :2] = own.rotation().matrix()
        # GTSAM's covariance is in the frame of the pose.
        covariances.append(turned @ marginals.marginalCovariance(k) @ turned.T)
        poses.append([own.x(), own.y(), own.theta()])
    return np.array(poses), np.array(covariances), graph.size()


def apart(document: dict, poses: np.ndarray, covariances: np.ndarray) -> tuple[float, float]:
    """Largest difference from the file's solution: of poses, in deviations, and of covariances, relative."""
    team, found, worst, most = document["graph"], document["solution"], 0.0, 0.0
    for k, keyframe in enumerate(team["keyframes"]):
        size = 3 if team["robots"][keyframe["robot"]]["has_heading"] else 2  # a point's yaw has no meaning
        off = poses[k] - np.array(found["poses"][k])
        off[2] = wrap(off[2])
        ours = np.array(found["covariances"][k])[:size, :size]
        worst = max(worst, float(np.abs(off[:size] / np.sqrt(np.diag(ours))).max()))
        most = max(most, float(np.abs(covariances[k][:size, :size] - ours).max() / np.abs(ours).max()))
    return worst, most


def main(path: str) -> int:
    with open(path) as file:
        document = json.load(file)
    poses, covariances, factors = solve(document)
    worst, most = apart(document, poses, covariances)
    print(f"{len(poses)} poses, {factors} factors: poses differ by at most {worst:.1e} deviations, covariances by {100 * most:.2g} %")
    return 0 if worst < 0.05 and most < 0.05 else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]) if len(sys.argv) > 1 else __doc__)
