"""Times csiread and benches/decode on one log, alternately; see decode_bench.sh."""

import glob
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time

ROUNDS = 15
SIZE = 200_000_000
FLOORS = {"all": 15.0, "antenna30": 15.0, "antenna8": 25.0}
# Floor for a log with a copy of each record's frame before it, for any task.
FRAMES_FLOORS = dict.fromkeys(FLOORS, 15.0)
MEMORY_MB = 30.0
CSIREAD = """
import csiread, sys, time
start = time.perf_counter()
log = csiread.Intel(sys.argv[1], nrxnum=3, ntxnum=1, if_report=False)
log.read()
print(time.perf_counter() - start, log.count)
"""


def whole_records(path):
    """The file without its cut tail."""
    data = open(path, "rb").read()
    at = 0
    while at + 2 <= len(data):
        end = at + 2 + int.from_bytes(data[at : at + 2], "big")
        if end > len(data):
            break
        at = end
    return data[:at]


def concatenate(paths, out):
    once = b"".join(whole_records(path) for path in paths)
    for _ in range(round(SIZE / len(once))):
        out.write(once)
    out.flush()


def emitted(bench, out, option="--write"):
    """A log made by `emit`: one record repeated; with `--write-frames`, each after a copy of its frame."""
    subprocess.run([bench, option, out.name], check=True)


def csiread_rate(log):
    out = subprocess.run([sys.executable, "-c", CSIREAD, log], check=True, capture_output=True, text=True).stdout
    seconds, count = out.split()[-2:]
    return int(count) / float(seconds)


def our_rates(bench, log):
    """Records per second of each task after a warm-up run, and the decoder's memory in MB."""
    out = subprocess.run([bench, log, "1"], check=True, capture_output=True, text=True).stdout
    rates = {}
    for line in out.splitlines():
        name, records, _, seconds, *_ = line.split()
        rates[name] = int(records) / float(seconds)
    return rates


def as_from_disk(path):
    """Loads the file into the page cache by reading it in large pieces. Pages from small writes cost the kernel four times as much to
    read."""
    with open(path, "r+b") as file:
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        while file.read(1 << 20):
            pass


def measure(bench, log, floors):
    csiread, ours = [], {name: [] for name in floors}
    csiread_rate(log), our_rates(bench, log)
    for _ in range(ROUNDS):
        csiread.append(csiread_rate(log))
        for name, rate in our_rates(bench, log).items():
            ours[name].append(rate)
    theirs, quickest = statistics.median(csiread), max(csiread)
    print(f"csiread Intel.read(), with its constructor: {theirs / 1e6:.2f} M records/s, in its least time {quickest / 1e6:.2f}")
    good = True
    for name, rates in ours.items():
        rate = statistics.median(rates)
        met = rate >= floors[name] * theirs
        good &= met
        print(
            f"{name}: {rate / 1e6:.2f} M records/s, {rate / theirs:.1f} x csiread (floor {floors[name]:.0f}){'' if met else ' MISSED'}; "
            f"by the least times {max(rates) / 1e6:.2f} and {max(rates) / quickest:.1f} x"
        )
    return good


def memory_mb(bench, log):
    """Peak memory of the decoder, MB (1e6 bytes)."""
    before = os.fork()
    if before == 0:
        subprocess.run([bench, log, "1"], check=True, stdout=subprocess.DEVNULL)
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e6
        print(f"peak memory of the decoder: {peak:.1f} MB (floor {MEMORY_MB:.0f})", flush=True)
        os._exit(0 if peak <= MEMORY_MB else 1)
    return os.waitstatus_to_exitcode(os.waitpid(before, 0)[1]) == 0


def main():
    bench, captures, *named = sys.argv[1:]
    real = sorted(glob.glob(os.path.join(captures, "*", "csi_*_real_*.dat")))
    with tempfile.NamedTemporaryFile(suffix=".dat") as out, tempfile.NamedTemporaryFile(suffix=".dat") as frames:
        if named:
            log = named[0]
        else:
            log = out.name
            concatenate(real, out) if real else emitted(bench, out)
        print(f"{log}: {os.path.getsize(log) / 1e6:.0f} MB, {'named' if named else 'real captures' if real else 'emitted'}")
        if not named:
            as_from_disk(log)
        good = measure(bench, log, FLOORS)
        good &= memory_mb(bench, log)
        emitted(bench, frames, "--write-frames")
        print(f"each record behind a copy of its frame (0xC1): {os.path.getsize(frames.name) / 1e6:.0f} MB, emitted")
        as_from_disk(frames.name)
        good &= measure(bench, frames.name, FRAMES_FLOORS)
    sys.exit(0 if good else 1)


main()
