"""What ranges of another sensor do for bearings: the motion-capture distances of captures plus noise, given to `csi5300 bearing --ranges`.

    python3 research/wsr_ranges.py PROGRAM DIR..

For each trajectory and range deviation: receivers with several links, median error of their places, and how far the bearings from there are off: as
answered, and as the place has them (from the located receiver to each transmitter). The noise has a seed. Captures are estimated once for each row.
"""

import json
import math
import os
import random
import statistics
import subprocess
import sys
import tempfile


def bearings(program: str, folders: list[str], trajectory: str, ranges: str | None) -> tuple[list[dict], list[dict]]:
    command = [program, "bearing", *folders, "--json", "--quiet", "--trajectory", trajectory, *(["--ranges", ranges] if ranges else [])]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 3):
        sys.exit(done.stderr.strip())
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    return [line for line in lines if "link" in line], [line for line in lines if "capture" in line]


def middle(link: str, folders: list[str], origin_m: list[float], transmitter_m: list[float]) -> tuple[float, float]:
    """When the receiver was nearest to the middle of its motion by motion capture, and its distance to the transmitter then."""
    place, stamp = link.rsplit("/", 2)[:2]
    parts = place.split("/")
    top = next(folder for folder in folders if os.path.basename(os.path.normpath(folder)) == parts[0]) if len(folders) > 1 else folders[0]
    best = (math.inf, 0.0, 0.0)
    with open(os.path.join(top, *parts[len(folders) > 1 :], f"rx_trajectory_{stamp}_.csv")) as file:
        for line in file:
            seconds, _, x, y, *_ = map(float, line.rstrip(",\n").split(","))
            off_m = math.hypot(x - origin_m[0], y - origin_m[1])
            best = min(best, (off_m, seconds, math.hypot(x - transmitter_m[0], y - transmitter_m[1])))
    return best[1:]


def main(program: str, folders: list[str]) -> None:
    print("| trajectory | ranges | set | receivers | place, m | answers over 20 deg | from the place over 20 deg |\n|---|---|---|---|---|---|---|")
    links, _ = bearings(program, folders, "gt", None)
    at = {link["link"]: middle(link["link"], folders, link["origin_m"], link["true_transmitter_m"]) for link in links if link["origin_m"]}
    for trajectory in ("gt", "t265", "odom"):
        links, _ = bearings(program, folders, trajectory, None)
        rows = {link["link"]: link for link in links if link["azimuth_deg"] is not None and link["true_transmitter_m"]}
        for sd in (None, 0.5, 0.1):
            with tempfile.NamedTemporaryFile("w", suffix=".csv") as file:
                noise = random.Random(1)
                file.write("time_s,from,to,range_m,sd_m\n")
                for link, (t, distance_m) in at.items():
                    file.write(f"{t:.6f},{link.rsplit('/', 1)[0]},{link},{max(distance_m + noise.gauss(0, sd or 1), 0.05):.4f},{sd or 1}\n")
                file.flush()
                _, receivers = bearings(program, folders, trajectory, file.name if sd else None)
            for name, kind in (("line of sight", "LOS_"), ("behind walls", "NLOS_")):
                own = [r for r in receivers if f"/{kind}" in f"/{r['capture']}" and r.get("position_m") and r["links"] > 1]
                answered, placed = [], []
                for receiver in own:
                    for link in receiver["names"]:
                        (tx, ty), (x, y) = rows[link]["true_transmitter_m"], receiver["position_m"]
                        off = math.degrees(math.atan2(ty - y, tx - x)) - rows[link]["true_from_mean_pose_deg"]
                        placed.append(abs(math.remainder(off, 360)))
                        answered.append(abs(rows[link]["error_from_mean_pose_deg"]))
                over = [sum(value > 20 for value in values) / max(len(values), 1) for values in (answered, placed)]
                place = statistics.median(r["off_m"] for r in own) if own else math.nan
                print(f"| {trajectory} | {f'{sd} m' if sd else 'none'} | {name} | {len(own)} | {place:.2f} | {over[0]:.0%} | {over[1]:.0%} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
