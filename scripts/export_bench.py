"""Processor time (user and system) of `csi5300 export LOG OUT.npz` against csiread's `Intel.read()` and `numpy.savez` of its arrays.

usage: python scripts/export_bench.py PROGRAM LOG [RUNS]
Needs csiread and NumPy in the interpreter that runs it, and room for both files where temporary ones go. In turns, each in a process
of its own; what it takes to start Python and import csiread is measured too and taken off.
"""

import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

FIELDS = "timestamp_low bfee_count Nrx Ntx rssi_a rssi_b rssi_c noise agc perm rate csi"
CSIREAD = f"""
import csiread, numpy, sys
if sys.argv[1]:
    log = csiread.Intel(sys.argv[1], nrxnum=3, ntxnum=1, if_report=False)
    log.read()
    numpy.savez(sys.argv[2], **{{name: getattr(log, name) for name in "{FIELDS}".split()}})
"""


def used(command):
    """Seconds of user and system time that a command takes."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime, after.ru_stime - before.ru_stime


def main():
    program, log, *runs = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = str(Path(folder) / "ours.npz"), str(Path(folder) / "theirs.npz")
        commands = {
            "csi5300 export": [str(Path(program).resolve()), "export", log, ours, "--force"],
            "csiread, savez": [sys.executable, "-c", CSIREAD, log, theirs],
            "Python alone": [sys.executable, "-c", CSIREAD, "", ""],
        }
        times = {name: [] for name in commands}
        for _ in range(int(runs[0]) if runs else 5):
            for name, command in commands.items():
                times[name].append(used(command))
    total = {}
    for name, runs in times.items():
        total[name] = statistics.median(map(sum, runs))
        user, system = (statistics.median(column) for column in zip(*runs))
        print(f"{name}: {total[name]:.3f} s (user {user:.3f}, system {system:.3f}; least {min(map(sum, runs)):.3f})")
    ratio = (total["csiread, savez"] - total["Python alone"]) / total["csi5300 export"]
    print(f"{Path(log).name}, {Path(log).stat().st_size / 1e6:.0f} MB: csiread takes {ratio:.1f} times as much (asked: 3)")


main()
