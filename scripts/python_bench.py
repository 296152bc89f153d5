"""Compares csi5300's reader with csiread and CSIKit on one log: wall time, processor time (user and system, all threads) and peak
memory, each run in its own process.

usage: python scripts/python_bench.py [--log LOG.dat] [--megabytes 200] [--runs 5] [--csikit PYTHON] [--rust PROGRAM]
Needs csi5300 (the wheel) and csiread in this interpreter; without --log, writes a log of random 3x1 records, stock layout. PYTHON is an
interpreter with CSIKit==2.5 and numpy<2. PROGRAM is from `cargo build --release --example read_scaled` in python/: the same work without
Python, compiled like the wheel.

Rows: `read` (arrays of the fields and raw CSI), `read + scaled`; csiread at its fastest (`bufsize` known, scaled in place); ours on one
core; and into reused memory. All run alternately, each in its own process, CSIKit once; the log is read once before. Prints least and
median times, and for each pair the ratios of both.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

JOBS = {
    "csi5300 read": "import csi5300\nlog = csi5300.read(path)\nlog.csi\nn = len(log)",
    "csi5300 read + scaled": "import csi5300\nlog = csi5300.read(path)\nlog.scaled()\nn = len(log)",
    "csi5300.csiread read": "from csi5300 import csiread\nd = csiread.Intel(path, 3, 1, if_report=False)\nd.read()\nn = d.count",
    "csi5300.csiread read + scaled": (
        "from csi5300 import csiread\nd = csiread.Intel(path, 3, 1, if_report=False)\nd.read()\nd.get_scaled_csi()\nn = d.count"
    ),
    "csiread read": "import csiread\nd = csiread.Intel(path, 3, 1, if_report=False)\nd.read()\nn = d.count",
    "csiread read + scaled": (
        "import csiread\nd = csiread.Intel(path, 3, 1, if_report=False)\nd.read()\nd.get_scaled_csi()\nn = d.count"
    ),
    "csiread read + scaled in place": (
        "import csiread\nd = csiread.Intel(path, 3, 1, if_report=False, bufsize=records)\nd.read()\n"
        "d.get_scaled_csi(inplace=True)\nn = d.count"
    ),
    "csi5300 read + scaled, one core": (
        "import csi5300\nimport os\nos.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "log = csi5300.read(path)\nlog.scaled()\nn = len(log)"
    ),
    "csi5300 read + scaled, memory again": (
        "import csi5300\nimport numpy as np\nout = np.ones((records, 3, 1, 30), np.complex64)\n"
        "began, used = time.perf_counter(), time.process_time()\n"
        "log = csi5300.read(path)\nlog.scaled(out=out)\nn = len(log)"
    ),
    "CSIKit read": (
        "from CSIKit.reader import IWLBeamformReader\nd = IWLBeamformReader().read_file(path)\nn = len(d.frames)"
    ),
    "CSIKit read + scaled": (
        "from CSIKit.reader import IWLBeamformReader\n"
        "from CSIKit.util.csitools import get_CSI\n"
        "d = IWLBeamformReader().read_file(path, scaled=True)\nget_CSI(d)\nn = len(d.frames)"
    ),
}

PAIRS = [
    ("csiread read", "csi5300 read"),
    ("csiread read + scaled", "csi5300 read + scaled"),
    ("csiread read + scaled in place", "csi5300 read + scaled"),
    ("csiread read + scaled in place", "csi5300 read + scaled, one core"),
    ("csiread read + scaled", "csi5300.csiread read + scaled"),
    ("csiread read", "csi5300.csiread read"),
    ("CSIKit read", "csi5300 read"),
    ("CSIKit read + scaled", "csi5300 read + scaled"),
    ("csi5300 read + scaled", "Rust, read + scaled"),
]

RUN = """
import json, resource, sys, time
path, records = sys.argv[1], int(sys.argv[2])
{imports}
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
began, used = time.perf_counter(), time.process_time()
{job}
took, used = time.perf_counter() - began, time.process_time() - used
print(json.dumps([took, used, n, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, before]))
"""


def write_log(path: Path, megabytes: int) -> None:
    """Records of 3x1 in the stock layout, with random CSI whose gap bits are 0."""
    import random

    random.seed(1)
    records = []
    for number in range(997):
        bits = at = 0
        for _ in range(30):
            at += 3
            for _ in range(6):
                bits |= random.randrange(256) << at
                at += 8
        csi = bits.to_bytes(192, "little")
        head = struct.pack("<IHHBBBBBbBBHH", number * 1000, number, 0, 3, 1, 40, 38, 35, -127, 30, 0b100100, 192, 0x1101)
        records.append(struct.pack(">HB", len(head) + len(csi) + 1, 0xBB) + head + csi)
    block = b"".join(records)
    with path.open("wb") as out:
        for _ in range(megabytes * 1_000_000 // len(block)):
            out.write(block)


def measure(job: str, log: Path, records: int, python: str = sys.executable) -> tuple[float, float, int, int]:
    """Seconds, seconds of processor time, records and peak memory (KiB)."""
    if job.startswith("/"):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([job, str(log)], capture_output=True, text=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        took, n, peak = done.stdout.split()
        used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return float(took), used, int(n), int(peak)
    imports = "\n".join(line for line in job.splitlines() if line.startswith(("import", "from")))
    body = "\n".join(line for line in job.splitlines() if not line.startswith(("import", "from")))
    code = RUN.format(imports=imports, job=body)
    command = [python, "-c", code, str(log), str(records)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(done.stderr.strip().splitlines()[-1] if done.stderr else f"status {done.returncode}")
    took, used, n, peak, _ = json.loads(done.stdout.splitlines()[-1])
    return took, used, n, peak


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--log", type=Path)
    parser.add_argument("--megabytes", type=int, default=200)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--csikit")
    parser.add_argument("--rust", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        log = args.log or Path(folder) / "bench.dat"
        if args.log is None:
            write_log(log, args.megabytes)
        jobs = {name: job for name, job in JOBS.items() if args.csikit or not name.startswith("CSIKit")}
        if args.rust:
            jobs["Rust, read + scaled"] = str(args.rust.resolve())
        _, _, records, _ = measure(JOBS["csi5300 read"], log, 0)
        took: dict[str, list[float]] = {name: [] for name in jobs}
        used: dict[str, list[float]] = {name: [] for name in jobs}
        counts, peaks = {}, {}
        for turn in range(args.runs):  # alternately, so that all see the same load
            for name, job in list(jobs.items()):
                if turn > 0 and name.startswith("CSIKit"):  # it takes minutes
                    continue
                try:
                    python = args.csikit if name.startswith("CSIKit") else sys.executable
                    seconds, processor, counts[name], peaks[name] = measure(job, log, records, python)
                except RuntimeError as error:
                    print(f"{name}: {error}")
                    del jobs[name]
                    continue
                if counts[name] != records:
                    print(f"{name}: {counts[name]} records, not {records}")
                took[name].append(seconds)
                used[name].append(processor)
        print(f"{log.name}: {os.path.getsize(log) / 1e6:.0f} MB, {records} records, {os.cpu_count()} cores, {args.runs} runs")
        print("| | wall time, least (median) | processor time, least (median) | peak memory |\n|---|---|---|---|")
        for name in jobs:
            wall, processor = (f"{min(of[name]):.3f} s ({statistics.median(of[name]):.3f})" for of in (took, used))
            print(f"| {name} | {wall} | {processor} | {peaks[name] / 1024:.0f} MiB |")
        for pair in PAIRS:
            if all(name in jobs for name in pair):
                least, middle, processor = (
                    of_all(of[pair[0]]) / of_all(of[pair[1]])
                    for of, of_all in ((took, min), (took, statistics.median), (used, min))
                )
                print(f"{pair[0]} / {pair[1]}: {least:.2f} (medians {middle:.2f}; processor time, least {processor:.2f})")


main()
