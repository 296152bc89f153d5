"""Processor time (user and system) of `csi5300 export LOG OUT.npz` against csiread's `Intel.read()` and `numpy.savez` of its arrays.

usage: python scripts/export_bench.py PROGRAM LOG... [RUNS]
Needs csiread and NumPy in this interpreter, and room for both files in the temporary folder. All commands run alternately, each in its
own process, whose own times and peak memory are measured; the time to start Python and import csiread is measured and subtracted. Each
round begins with another command, and written files are removed before the next one: new memory and new pages cost a loaded machine
more at some times than at others, and this spreads the cost evenly. Prints medians, least times and both ratios for each log.
The exit status is 1 if csiread takes less than 3 times as much, by medians or by the least times.
"""

import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ASKED = 3.0
FIELDS = "timestamp_low bfee_count Nrx Ntx rssi_a rssi_b rssi_c noise agc perm rate csi"
CSIREAD = f"""
import csiread, numpy, sys
if sys.argv[1]:
    log = csiread.Intel(sys.argv[1], nrxnum=3, ntxnum=1, if_report=False)
    log.read()
    numpy.savez(sys.argv[2], **{{name: getattr(log, name) for name in "{FIELDS}".split()}})
"""


def used(command):
    """Seconds of user and of system time of a command, and its peak memory, MB (1e6 bytes)."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command[:2])} ...: exit status {process.returncode}")
    return usage.ru_utime, usage.ru_stime, usage.ru_maxrss * 1024 / 1e6


def turns(commands, outputs, runs):
    """The measurements of each run of each command, alternately."""
    taken = {name: [] for name in commands}
    names = list(commands)
    for turn in range(runs):
        for k in range(len(names)):
            name = names[(turn + k) % len(names)]
            taken[name].append(used(commands[name]))
            for output in outputs:
                Path(output).unlink(missing_ok=True)
    return taken


def measure(program, log, runs):
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = str(Path(folder) / "ours.npz"), str(Path(folder) / "theirs.npz")
        commands = {
            "csi5300 export": [program, "export", log, ours, "--force"],
            "csiread, savez": [sys.executable, "-c", CSIREAD, log, theirs],
            "Python alone": [sys.executable, "-c", CSIREAD, "", ""],
        }
        taken = turns(commands, [ours, theirs], runs)
    print(f"{Path(log).name}, {Path(log).stat().st_size / 1e6:.0f} MB, {runs} runs")
    total, least = {}, {}
    for name, all_runs in taken.items():
        sums = [user + system for user, system, _ in all_runs]
        total[name], least[name] = statistics.median(sums), min(sums)
        user, system, peak = (statistics.median(column) for column in zip(*all_runs))
        print(f"  {name}: {total[name]:.3f} s (user {user:.3f}, system {system:.3f}; least {least[name]:.3f}), peak {peak:.0f} MB")
    ratios = [(by["csiread, savez"] - by["Python alone"]) / by["csi5300 export"] for by in (total, least)]
    print(f"  csiread takes {ratios[0]:.1f} times as much by medians, {ratios[1]:.1f} by the least (asked: {ASKED:g})")
    return min(ratios) >= ASKED


def main():
    program, *logs = sys.argv[1:]
    runs = int(logs.pop()) if logs[-1].isdecimal() else 5
    program = str(Path(program).resolve())
    sys.exit(0 if all([measure(program, log, runs) for log in logs]) else 1)


main()
