#!/usr/bin/env bash
# The load of a ROS 2 node: simulates two robots into logs at 100 rounds a second. A node replays the first in real time with the second
# as its peer and publishes everything, including CSI, over DDS on loopback; CycloneDDS reads. Prints the delay of bearings after the last
# record, the delay of DDS, the node's processor load and memory, and its memory each minute. The first robot drives circles of 20 s each
# for SECONDS (60). Usage: scripts/ros2_load.sh [SECONDS [PROGRAM]]
set -euo pipefail
cd "$(dirname "$0")/.."
python=$(scripts/venv.sh cyclonedds)
program=${2:-${CARGO_TARGET_DIR:-target}/release/csi5300}
[ $# -ge 2 ] || { cargo build --release --quiet -p csi5300-cli && cargo build --release --quiet -p csi5300-node; }
exec "$python" - "$program" "${1:-60}" <<'PYTHON'
import glob, json, os, shutil, subprocess, sys, tempfile, time
sys.path.insert(0, "tests/checks/ros2")
os.environ["CYCLONEDDS_URI"] = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>30</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""
from cyclonedds.core import ReadCondition, SampleState, InstanceState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
import types_ros2 as ros

csi5300, seconds, folder, DOMAIN = os.path.abspath(sys.argv[1]), float(sys.argv[2]), tempfile.mkdtemp(), 91
TICKS = os.sysconf("SC_CLK_TCK")

def found(name):
    return glob.glob(f"{folder}/logs/**/{name}", recursive=True)[0]

def cost(pid):
    fields = open(f"/proc/{pid}/stat").read().rsplit(")", 1)[1].split()
    status = dict(line.split(":", 1) for line in open(f"/proc/{pid}/status") if ":" in line)
    return (int(fields[11]) + int(fields[12])) / TICKS, int(status["VmRSS"].split()[0]) / 1024

def at(values, part):
    values = sorted(values)
    return values[min(len(values) - 1, int(part * len(values)))]

try:
    with open(f"{folder}/scene.toml", "w") as file:
        file.write(f'name = "load"\nduration_s = {seconds + 4}\nchannel = 108\ncfo = "physical"\n[sounding]\nrate_hz = 100.0\n[radio]\nphase_noise_rad = 0.1\n'
                   f'[[robot]]\nname = "r0"\nposition_m = [0.0, 0.0, 0.2]\nmotion.circle = {{ radius_m = 0.3, duration_s = {seconds}, turns = {seconds / 20}, start_s = 1.5 }}\nodometry = {{ rate_hz = 50.0 }}\n'
                   '[[robot]]\nname = "r1"\nposition_m = [8.0, 4.0, 0.2]\n')
    subprocess.run([csi5300, "simulate", f"{folder}/scene.toml", "--out", f"{folder}/logs"], check=True, stdout=subprocess.DEVNULL)
    with open(f"{folder}/robot.toml", "w") as file:
        file.write(f'name = "r0"\nmac = "02:53:00:00:00:00"\nchannel = "108"\ncapture.replay.file = "{found("csi_rx_*.dat")}"\nodometry.csv.file = "{found("rx_trajectory_*.csv")}"\n'
                   f'[[peer]]\nname = "r1"\nmac = "02:53:00:00:00:01"\nrecords.replay.file = "{found("csi_tx1_*.dat")}"\n'
                   f'[output]\nbearings = "{folder}/bearings.jsonl"\n[ros2]\ndomain = {DOMAIN}\npublish_csi = true\n')
    participant = DomainParticipant(DOMAIN)
    readers = []
    for name, kind, reliability in [("r1/bearing", ros.Bearing, Policy.Reliability.Reliable(duration(seconds=1))), ("markers", ros.MarkerArray, Policy.Reliability.Reliable(duration(seconds=1))),
                                    ("csi", ros.Csi, Policy.Reliability.BestEffort)]:
        readers.append(DataReader(participant, Topic(participant, f"rt/csi5300_r0/{name}", kind), qos=Qos(reliability, Policy.History.KeepLast(500))))
    waiting = WaitSet(participant)
    conditions = [ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any) for reader in readers]
    waiting.attach(conditions[0])
    node = subprocess.Popen([csi5300, "node", "--config", f"{folder}/robot.toml"], stderr=open(f"{folder}/err", "w"))
    begun, before, handed, counts, memory = None, None, [], [0, 0, 0], []
    while node.poll() is None:
        waiting.wait(duration(milliseconds=200))
        now = time.time_ns()
        for number, reader in enumerate(readers):
            for sample in reader.take(N=500):
                if sample.sample_info.valid_data:
                    counts[number] += 1
                    if number == 0:
                        handed.append((now - sample.sample_info.source_timestamp) / 1e6)
        try:
            if begun is None and sum(counts) > 300:
                begun, before = time.monotonic(), cost(node.pid)
            if begun is not None:
                last = (time.monotonic(), cost(node.pid))
                if last[0] >= begun + 60 * len(memory):
                    memory.append(last[1][1])
        except (FileNotFoundError, IndexError, KeyError):
            pass
    memory.append(last[1][1])
    share = 100 * (last[1][0] - before[0]) / (last[0] - begun)
    lines = [json.loads(line) for line in open(f"{folder}/bearings.jsonl")]
    latency = [line["latency_ms"] for line in lines if line["state"] == "bearing" and line["latency_ms"] is not None and not line["accurate"]]
    print(f"{counts[0]} bearings, {counts[1]} markers, {counts[2]} CSI over DDS; bearings published {at(latency, .5):.2f} ms after the last record (99 %: {at(latency, .99):.2f}), "
          f"handed over by DDS in {at(handed, .5):.2f} ms (99 %: {at(handed, .99):.2f}); node {share:.1f} % of a core; MiB at first, each minute, at last: {', '.join(f'{m:.1f}' for m in memory)}; load {os.getloadavg()[0]:.1f}")
finally:
    shutil.rmtree(folder)
PYTHON
