"""Three robots find each other's places: bearings as factors of a GTSAM graph.

Every robot knows only its own motion, in the frame of its odometry. It drives a circle while the others answer, and so gets a bearing to each of them,
with candidates. The unknowns are the frames: origin and rotation of each robot's odometry. A factor connects two
frames; one range, for example from a UWB pair, determines the scale. Run it with `pip install gtsam csi5300`.
"""

import math
import sys

import csi5300
import gtsam
import numpy as np

HOMES = np.array([[0.0, 0.0], [4.0, 0.5], [1.5, 3.5]])  # where the robots are
TURNS = np.radians([0.0, 70.0, -130.0])  # rotations of their odometry's frames
UWB_SD_M = 0.1


def scene(mover: int) -> dict:
    """A room in which one robot drives a circle about its place and sounds the others."""
    robots = [{"name": f"r{k}", "position_m": [*HOMES[k], 0.3]} for k in range(3)]
    robots[mover]["motion"] = {"circle": {"radius_m": 0.3, "duration_s": 10.0}}
    radio = {"noise": {"snr_db": 20.0}, "phase_noise_rad": 0.1, "turn_around": {"spread_us": 20.0}}
    sounding = {"rate_hz": 100.0, "initiators": [f"r{mover}"]}
    return {"duration_s": 10.0, "seed": mover + 1, "cfo": "physical", "radio": radio, "sounding": sounding, "robot": robots}


def in_own_frame(path: np.ndarray, robot: int) -> np.ndarray:
    """A true path (t, x, y, z, yaw) in the frame of the robot's odometry."""
    own, (cos, sin) = path.copy(), (math.cos(TURNS[robot]), math.sin(TURNS[robot]))
    x, y = path[:, 1] - HOMES[robot, 0], path[:, 2] - HOMES[robot, 1]
    own[:, 1], own[:, 2], own[:, 4] = cos * x + sin * y, cos * y - sin * x, path[:, 4] - TURNS[robot]
    return own


def bearing_factor(i: int, j: int, bearing: csi5300.Bearing, noise: gtsam.noiseModel.Base) -> gtsam.CustomFactor:
    """Robot i sees robot j: uses the best-fitting candidate, with a penalty for less likely ones (max-mixture)."""
    origin = np.array(bearing.answer["origin_m"][:2])
    options = [(math.radians(one["azimuth_deg"]), one["share"]) for one in bearing.answer["candidates"]] or [(math.radians(bearing.azimuth_deg), 1.0)]
    sd = math.radians(bearing.azimuth_sd_deg)

    def residual(frame_i: gtsam.Pose2, frame_j: gtsam.Pose2) -> float:
        seen = frame_i.transformTo(frame_j.transformFrom(np.zeros(2))) - origin
        direction = math.atan2(seen[1], seen[0])
        off = [(math.remainder(direction - azimuth, math.tau), share) for azimuth, share in options]
        return min(off, key=lambda one: (one[0] / sd) ** 2 - 2.0 * math.log(max(one[1], 1e-6)))[0]

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list | None) -> np.ndarray:
        frames = [values.atPose2(i), values.atPose2(j)]
        here = residual(*frames)
        if jacobians is not None:
            for side in range(2):
                row = np.zeros((1, 3))
                for axis in range(3):
                    moved = list(frames)
                    moved[side] = frames[side].retract(1e-6 * np.eye(3)[axis])
                    row[0, axis] = math.remainder(residual(*moved) - here, math.tau) / 1e-6
                jacobians[side] = row
        return np.array([here])

    return gtsam.CustomFactor(noise, [i, j], error)


def main() -> int:
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
    for i in range(3):
        room = csi5300.simulate(scene(i))
        others = [j for j in range(3) if j != i]
        found = csi5300.bearings(
            room[f"r{i}"].log, [room[f"r{j}"].log for j in others], trajectory=in_own_frame(room[f"r{i}"].path, i), columns="t,x,y,z,yaw",
            channel=room.channel, tx_mac=[room[f"r{j}"].mac for j in others],
        )
        for j, bearing in zip(others, found):
            if not bearing:
                print(f"r{i} does not see r{j}: {bearing.error}")
                continue
            print(f"r{i} sees r{j} at {bearing.azimuth_deg:7.2f} +- {bearing.azimuth_sd_deg:.2f} deg of its own frame, {100 * bearing.confidence:.0f} % sure")
            sigma = gtsam.noiseModel.Isotropic.Sigma(1, math.radians(bearing.azimuth_sd_deg))
            huber = gtsam.noiseModel.mEstimator.Huber.Create(1.345)
            graph.add(bearing_factor(i, j, bearing, gtsam.noiseModel.Robust.Create(huber, sigma)))
    measured = float(np.linalg.norm(HOMES[1] - HOMES[0])) + np.random.default_rng(1).normal(0.0, UWB_SD_M)
    graph.add(gtsam.RangeFactorPose2(0, 1, measured, gtsam.noiseModel.Isotropic.Sigma(1, UWB_SD_M)))

    # From several starts, because angles have several local solutions; keeps the best one.
    best: tuple[float, gtsam.Values] | None = None
    random = np.random.default_rng(5)
    for _ in range(20):
        start = gtsam.Values()
        start.insert(0, gtsam.Pose2())
        for k in (1, 2):
            start.insert(k, gtsam.Pose2(*random.uniform(-5.0, 5.0, 2), random.uniform(-math.pi, math.pi)))
        end = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
        if best is None or graph.error(end) < best[0]:
            best = (graph.error(end), end)
    assert best is not None
    covariances = gtsam.Marginals(graph, best[1])
    worst = 0.0
    for k in (1, 2):
        pose, sd = best[1].atPose2(k), np.sqrt(np.diag(covariances.marginalCovariance(k)))
        off = math.hypot(*(pose.translation() - HOMES[k]))
        turned = math.degrees(math.remainder(pose.theta() - TURNS[k], math.tau))
        worst = max(worst, off)
        print(f"r{k}: x {pose.x():.2f} y {pose.y():.2f} m, turned {math.degrees(pose.theta()):.1f} deg; "
              f"off by {off:.2f} m and {turned:+.2f} deg (predicted {math.hypot(sd[0], sd[1]):.2f} m, {math.degrees(sd[2]):.2f} deg)")
    return 0 if worst < 0.5 else 1


if __name__ == "__main__":
    sys.exit(main())
