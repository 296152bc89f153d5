"""Cost of many captures on Ray against one process: throughput, cost per capture, and the extrapolation to a million on 1,000 cores.

usage: python scripts/ray_bench.py FOLDER [--copies 8] [--nodes 2] [--runs 3]
FOLDER is a tree of captures laid out as the WSR data set. Each capture is used `copies` times, through links with different names in a
temporary folder. Needs csi5300 (the wheel) and ray. All variants are measured alternately: captures one after the other in this process
(1 thread), threads of this process, and a cluster of `nodes` nodes of one core each on this machine, whose workers have already started
and imported the package.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import csi5300
import csi5300.ray


def copies_of(folder: Path, copies: int, out: Path) -> Path:
    """A tree with each capture `copies` times, as links to its files."""
    for number in range(copies):
        for file in folder.rglob("*"):
            if file.is_file():
                target = out / f"copy{number}" / file.relative_to(folder)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.symlink_to(file.resolve())
    return out


def cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--copies", type=int, default=8)
    parser.add_argument("--nodes", type=int, default=2)
    parser.add_argument("--runs", type=int, default=3)
    args = parser.parse_args()
    import ray
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1 if args.nodes else 0})
    for _ in range(args.nodes - 1):
        cluster.add_node(num_cpus=1)
    ray.init(address=cluster.address, log_to_driver=False)
    with tempfile.TemporaryDirectory() as scratch:
        tree = copies_of(args.folder, args.copies, Path(scratch))
        ways: dict[str, Callable[[], Any]] = {
            "one process, one thread": lambda: csi5300.ray.evaluate(tree, use_ray=False, workers=1),
            f"one process, {os.cpu_count()} threads": lambda: csi5300.ray.evaluate(tree, use_ray=False, workers=os.cpu_count()),
            f"Ray, {args.nodes} nodes of one core": lambda: csi5300.ray.evaluate(tree, use_ray=True),
        }
        captures = len({row["capture"] for row in ways[f"Ray, {args.nodes} nodes of one core"]()})
        took: dict[str, list[float]] = {way: [] for way in ways}
        busy: dict[str, list[float]] = {way: [] for way in ways}
        rows: dict[str, list[Any]] = {}
        for _ in range(args.runs):
            for way, run in ways.items():
                began, used = time.perf_counter(), cpu_s()
                rows[way] = run().rows
                took[way].append(time.perf_counter() - began)
                busy[way].append(cpu_s() - used)
        # Ray's own overhead: the same number of empty tasks.
        nothing = ray.remote(num_cpus=1)(lambda: None)
        ray.get([nothing.remote() for _ in range(10)])
        began = time.perf_counter()
        ray.get([nothing.remote() for _ in range(captures)])
        empty_s = time.perf_counter() - began
    ray.shutdown()
    cluster.shutdown()
    same = all(found == rows["one process, one thread"] for found in rows.values())
    print(f"{captures} captures, {len(rows['one process, one thread'])} links, {os.cpu_count()} cores, rows equal: {same}")
    for way in ways:
        seconds = statistics.median(took[way])
        print(f"{way:32} {seconds:7.2f} s  {captures / seconds:7.1f} captures/s  driver {statistics.median(busy[way]):.2f} s of processor time")
    alone, spread = (statistics.median(took[way]) for way in (list(ways)[0], list(ways)[-1]))
    core_s = spread * args.nodes / captures
    print(f"a capture: {alone / captures * 1e3:.1f} ms in one process, {core_s * 1e3:.1f} ms of a core on Ray ({core_s * captures / alone - 1:+.0%})")
    print(f"an empty task: {empty_s / captures * 1e3:.2f} ms of wall time")
    driver_s = statistics.median(busy[list(ways)[-1]]) / captures
    print(
        f"1e6 captures on 1,000 cores: {core_s * 1e6 / 3600:.0f} core hours, {core_s * 1e3 / 60:.1f} minutes if the cores are kept busy; "
        f"the driver's {driver_s * 1e3:.2f} ms a capture take {driver_s * 1e6 / 60:.1f} minutes"
    )


main()
