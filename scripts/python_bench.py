"""Times csi5300's reader against csiread and CSIKit on one log: wall time and peak memory, each run in a process of its own.

usage: python scripts/python_bench.py [--log LOG.dat] [--megabytes 200] [--runs 5] [--csikit]
Needs csi5300 (the wheel), csiread and, with --csikit, CSIKit in the interpreter that runs it; without --log it writes one of
random 3x1 records, stock layout.

Rows: `read` (arrays of the fields and raw CSI), `read + scaled`; and the same decoding without Python (`records/s` of the
native half alone: arrays of a Log are filled by it, the difference is Python's share).
"""

from __future__ import annotations

import argparse
import json
import os
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
    "csi5300 native half, read + scaled": (
        "from csi5300 import _native\nr, c, i = _native.read(path)\nr.csi(None, 'ABC', 1, True, False)\nn = len(r)"
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

RUN = """
import json, resource, sys, time
path = sys.argv[1]
{imports}
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
began = time.perf_counter()
{job}
took = time.perf_counter() - began
print(json.dumps([took, n, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, before]))
"""


def write_log(path: Path, megabytes: int) -> None:
    """Records of 3x1 in the stock layout, of random CSI whose gaps are 0."""
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


def measure(job: str, log: Path) -> tuple[float, int, int]:
    imports = "\n".join(line for line in job.splitlines() if line.startswith(("import", "from")))
    body = "\n".join(line for line in job.splitlines() if not line.startswith(("import", "from")))
    code = RUN.format(imports=imports, job=body)
    done = subprocess.run([sys.executable, "-c", code, str(log)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(done.stderr.strip().splitlines()[-1] if done.stderr else f"status {done.returncode}")
    took, n, peak, _ = json.loads(done.stdout.splitlines()[-1])
    return took, n, peak


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--log", type=Path)
    parser.add_argument("--megabytes", type=int, default=200)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--csikit", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        log = args.log or Path(folder) / "bench.dat"
        if args.log is None:
            write_log(log, args.megabytes)
        jobs = {name: job for name, job in JOBS.items() if args.csikit or not name.startswith("CSIKit")}
        took: dict[str, list[float]] = {name: [] for name in jobs}
        counts, peaks = {}, {}
        for _ in range(args.runs):  # in turns, so that all see the same machine
            for name, job in list(jobs.items()):
                try:
                    seconds, counts[name], peaks[name] = measure(job, log)
                except RuntimeError as error:
                    print(f"{name}: {error}")
                    del jobs[name]
                    continue
                took[name].append(seconds)
        print(f"{log.name}: {os.path.getsize(log) / 1e6:.0f} MB, {os.cpu_count()} cores, median of {args.runs}")
        for name in jobs:
            seconds = statistics.median(took[name])
            rate = counts[name] / seconds / 1e6
            print(f"{name:36} {seconds:8.3f} s  {counts[name]:9} records  {rate:6.2f} M/s  peak {peaks[name] / 1024:7.0f} MiB")
        for what in ("read", "read + scaled"):
            pair = [f"csiread {what}", f"csi5300 {what}"]
            if all(name in jobs for name in pair):
                theirs, ours = (statistics.median(took[name]) for name in pair)
                print(f"{what}: {theirs / ours:.1f} times as fast as csiread")


main()
