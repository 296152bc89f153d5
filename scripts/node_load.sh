#!/usr/bin/env bash
# The load of a node: simulates N robots into logs at 100 rounds a second; N nodes in separate processes replay them in real time and
# exchange records and poses through zenoh. The first robot drives a circle of 30 cm. Prints the errors of its bearings after the circle,
# their delay after the last record, and the load of the first node (with all others as peers) and of the others (with it as their
# peer). Usage: scripts/node_load.sh [ROBOTS ...]
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release --quiet --package csi5300-cli
cargo build --release --quiet --package csi5300-node --features zenoh
exec python3 - "${CARGO_TARGET_DIR:-target}/release/csi5300" "${@:-2 4 8}" <<'PYTHON'
import glob, json, math, os, shutil, socket, subprocess, sys, tempfile, time

csi5300 = os.path.abspath(sys.argv[1])
TICKS = os.sysconf("SC_CLK_TCK")

def place(k, robots):
    angle = 0.4 + math.tau * k / robots
    return (0.0, 0.0) if k == 0 else (9 * math.cos(angle), 9 * math.sin(angle))

def simulate(folder, robots):
    text = 'name = "load"\nduration_s = 24.0\nchannel = 108\ncfo = "physical"\n[sounding]\nrate_hz = 100.0\n[radio]\nphase_noise_rad = 0.1\n'
    for k in range(robots):
        x, y = place(k, robots)
        text += f'[[robot]]\nname = "r{k}"\nposition_m = [{x:.3f}, {y:.3f}, 0.2]\n'
        if k == 0:
            text += "motion.circle = { radius_m = 0.3, duration_s = 20.0, start_s = 1.5 }\nodometry = { rate_hz = 50.0 }\n"
    with open(f"{folder}/scene.toml", "w") as file:
        file.write(text)
    subprocess.run([csi5300, "simulate", f"{folder}/scene.toml", "--out", f"{folder}/logs"], check=True, stdout=subprocess.DEVNULL)
    def found(name):
        return glob.glob(f"{folder}/logs/**/{name}", recursive=True)[0]
    return [found("csi_rx_*.dat")] + [found(f"csi_tx{k}_*.dat") for k in range(1, robots)], found("rx_trajectory_*.csv")

def configure(folder, k, logs, path, port):
    mac = lambda k: f"02:53:00:00:00:{k:02x}"
    text = f'name = "r{k}"\nmac = "{mac(k)}"\nchannel = "108"\ncapture.replay = {{ file = "{logs[k]}" }}\n'
    peer = lambda k: f'[[peer]]\nname = "r{k}"\nmac = "{mac(k)}"\nrecords.network = {{}}\n'
    if k == 0:
        text += f'odometry.csv.file = "{path}"\n' + "".join(peer(other) for other in range(1, len(logs)))
        network = f'listen = ["tcp/127.0.0.1:{port}"]\n'
    else:
        text += peer(0) + "poses.network = {}\n"
        network = f'connect = ["tcp/127.0.0.1:{port}"]\n'
    text += f'[output]\nbearings = "{folder}/r{k}.jsonl"\nstatus_socket = "{folder}/s{k}"\n'
    text += f'[network]\nzenoh = "{folder}/zenoh.json5"\n{network}publish_records = true\npublish_poses = true\n'
    with open(f"{folder}/r{k}.toml", "w") as file:
        file.write(text)

def cost(node):
    fields = open(f"/proc/{node.pid}/stat").read().rsplit(")", 1)[1].split()
    status = dict(line.split(":", 1) for line in open(f"/proc/{node.pid}/status") if ":" in line)
    return (int(fields[11]) + int(fields[12])) / TICKS, int(status["VmRSS"].split()[0]) / 1024

def at(values, part):
    values = sorted(values)
    return values[min(len(values) - 1, int(part * len(values)))] if values else math.nan

def measure(robots):
    folder = tempfile.mkdtemp()
    nodes = []
    try:
        logs, path = simulate(folder, robots)
        with open(f"{folder}/zenoh.json5", "w") as file:
            file.write("{ scouting: { multicast: { enabled: false } } }")
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        for k in range(robots):
            configure(folder, k, logs, path, port)
            command = [csi5300, "node", "--config", f"{folder}/r{k}.toml"]
            nodes.append(subprocess.Popen(command, stderr=open(f"{folder}/r{k}.err", "w")))
        time.sleep(4)
        begun, before = time.monotonic(), [cost(node) for node in nodes]
        time.sleep(16)
        seconds, after = time.monotonic() - begun, [cost(node) for node in nodes]
        load = os.getloadavg()[0]
        state = json.loads(subprocess.run([csi5300, "watch", f"{folder}/s0"], check=True, stdout=subprocess.PIPE).stdout)
        for node in nodes:
            node.wait(timeout=60)
        share = [100 * (b[0] - a[0]) / seconds for a, b in zip(before, after)]
        lines = [json.loads(line) for line in open(f"{folder}/r0.jsonl")]
        made = [line for line in lines if line["state"] == "bearing" and line["took_ms"] is not None]
        quick = [line for line in made if not line["accurate"]]
        layers = [line["took_ms"] for line in made if line["accurate"]]
        off = []
        for k in range(1, robots):
            x, y = place(k, robots)
            truth = math.degrees(math.atan2(y - 0.3, x))
            # A circle takes 20 s: the last bearings cover all of it.
            for line in [line for line in lines if line["link"] == f"r{k}" and line["azimuth_deg"] is not None][-4:]:
                off.append(abs((line["azimuth_deg"] - truth + 180) % 360 - 180))
        lost = sum(counts["missing"] + counts["overflowed"] for _, _, counts in state["network"]["subscriptions"])
        latency = [line["latency_ms"] for line in quick]
        took = [line["took_ms"] for line in quick]
        print(f"{robots} robots: after the circle at most {max(off):.3f} deg off; {len(quick)} bearings while driving, "
              f"{at(latency, .5):.2f} ms after the last record (99 %: {at(latency, .99):.2f}, most {max(latency):.2f}), of which "
              f"{at(took, .5):.2f} ms are the estimate; accuracy layer {len(layers)} times, {at(layers, .5):.1f} ms (most "
              f"{max(layers, default=math.nan):.1f}); the first node {share[0]:.1f} % of a core and {after[0][1]:.1f} MiB, the others "
              f"{at(share[1:], .5):.1f} % and {at([a[1] for a in after[1:]], .5):.1f} MiB; {lost} records lost; load {load:.1f}", flush=True)
    finally:
        for node in nodes:
            node.kill()
            node.wait()
        shutil.rmtree(folder)

for robots in " ".join(sys.argv[2:]).split():
    measure(int(robots))
PYTHON
