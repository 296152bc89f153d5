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
    lines = [json.loads(line) for line in subprocess.run(command, capture_output=True, text=True, check=False).stdout.splitlines()]
    return [line for line in lines if "link" in line], [line for line in lines if "capture" in line]


def middle(link: str, folders: list[str], trajectory: str, receivers: dict) -> float:
    """A time of the trajectory at which the receiver is near the middle of its motion, where distances are known."""
    capture, row = link.rsplit("/", 1)[0], receivers[link]
    place, stamp = capture.rsplit("/", 1)
    top = next(folder for folder in folders if os.path.basename(os.path.normpath(folder)) == place.split("/")[0]) if len(folders) > 1 else folders[0]
    folder = os.path.join(top, *(place.split("/")[1:] if len(folders) > 1 else place.split("/")))
    prefix = "" if trajectory == "gt" else f"{trajectory}_"
    best, origin = (math.inf, 0.0), row["origin_m"]
    with open(os.path.join(folder, f"{prefix}rx_trajectory_{stamp}_.csv")) as file:
        for line in file:
            cells = line.split(",")
            try:
                t, x, y = float(cells[0]) + float(cells[1]) * 1e-9, float(cells[2]), float(cells[3])
            except ValueError:
                continue
            best = min(best, (math.hypot(x - origin[0], y - origin[1]), t))
    return best[1]


def main(program: str, folders: list[str]) -> None:
    print("| trajectory | ranges | set | receivers | place, m | answers over 20 deg | from the place over 20 deg |\n|---|---|---|---|---|---|---|")
    for trajectory in ("gt", "t265", "odom"):
        links, _ = bearings(program, folders, trajectory, None)
        rows = {link["link"]: link for link in links if link["azimuth_deg"] is not None and link["true_transmitter_m"]}
        for sd in (None, 0.5, 0.1):
            with tempfile.NamedTemporaryFile("w", suffix=".csv") as file:
                noise = random.Random(1)
                file.write("time_s,from,to,range_m,sd_m\n")
                for link, row in rows.items():
                    t = middle(link, folders, trajectory, rows)
                    file.write(f"{t:.6f},{link.rsplit('/', 1)[0]},{link},{max(row['true_range_m'] + noise.gauss(0, sd or 1), 0.05):.4f},{sd or 1}\n")
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
