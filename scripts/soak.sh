#!/usr/bin/env bash
# Endurance test of a node in a served room: its peer is repeatedly killed and restarted, a stranger without the key sounds all the time,
# many readers connect to the status socket and stay, and finally the peer is gone. Samples memory and descriptors every second; after the
# first minute of each part they must not grow. Usage: scripts/soak.sh [MINUTES], with the program of `cargo build` or CSI5300.
set -euo pipefail
cd "$(dirname "$0")/.."
exec python3 - "${CSI5300:-${CARGO_TARGET_DIR:-target}/debug/csi5300}" "${1:-10}" <<'PYTHON'
import json, os, shutil, signal, socket, subprocess, sys, tempfile, time

program, minutes = os.path.abspath(sys.argv[1]), float(sys.argv[2])
folder = tempfile.mkdtemp()
SCENE = f"""
duration_s = {60 * minutes + 300}
cfo = "physical"
[radio]
mcs = 1
noise.snr_db = 20.0
[[robot]]
name = "rx"
mac = "02:00:00:00:00:0a"
motion.circle = {{ radius_m = 0.3, duration_s = {60 * minutes + 300}, turns = {int(15 * minutes + 75)} }}
[[robot]]
name = "tx"
mac = "02:00:00:00:00:0b"
position_m = [-386.0, 93.0, 0.0]
[[robot]]
name = "stranger"
mac = "02:66:00:00:00:01"
position_m = [3.0, -120.0, 0.0]
"""
SOUNDING = '[sounding]\nrate_hz = 50.0\nturn_around_us = 6000\nguard_us = 1500\nfifo = false\ninitiate = {initiate}\nkey = "key"\n'

def write(name, text, mode=0o644):
    path = f"{folder}/{name}"
    with open(path, "w") as file:
        file.write(text)
    os.chmod(path, mode)
    return path

def node(own, peer, initiate):
    moves, poses = ("odometry.room = {}\n", "") if own == "rx" else ("", "poses.room = {}\n")
    text = f'channel = "108"\ncapture.served = {{ socket = "room", robot = "{own}" }}\n{moves}[[peer]]\nname = "{peer}"\nrecords.room = {{}}\n{poses}'
    text += f'[estimator]\naccurate = false\n[log]\nfile = "{own}.dat"\nrotate_mib = 1\n[output]\nbearings = "{own}.jsonl"\nstatus_socket = "{own}.sock"\n'
    return start("node", "--config", write(f"{own}.toml", text + SOUNDING.format(initiate=initiate)))

def start(*arguments):
    return subprocess.Popen([program, *arguments], cwd=folder, stdout=subprocess.DEVNULL, stderr=open(f"{folder}/{arguments[0]}.err", "a"))

def held(process):
    status = dict(line.split(":", 1) for line in open(f"/proc/{process.pid}/status") if ":" in line)
    return int(status["VmRSS"].split()[0]), len(os.listdir(f"/proc/{process.pid}/fd"))

def wait(condition, seconds, what):
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            sys.exit(f"{what}: not within {seconds} s")
        time.sleep(0.1)

running = []
try:
    write("key", "3f7c1e9a5b2d8046c1e0f4a7936bd258\n", 0o600)
    room = start("simulate", write("scene.toml", SCENE), "--serve", "--socket", f"{folder}/room")
    running.append(room)
    wait(lambda: os.path.exists(f"{folder}/room"), 60, "the room")
    rx, tx = node("rx", "tx", "true"), node("tx", "rx", "false")
    running += [rx, tx]
    stranger = start("sound", "--room", f"{folder}/room#stranger", "--rate", "100", "--peers", "02:66:00:00:00:02", "--no-fifo")
    running.append(stranger)
    wait(lambda: os.path.exists(f"{folder}/rx.sock"), 60, "the node's status socket")
    part, readers, worst = 60 * minutes / 3, [], {}
    begun = time.monotonic()
    for name in ["the peer is killed over and over", "readers crowd the socket", "the peer is gone"]:
        first, steps, ends = None, 0, time.monotonic() + part
        while time.monotonic() < ends:
            if name.startswith("the peer is killed") and steps % 4 == 0:
                tx.kill(); tx.wait(); running.remove(tx)
                tx = node("tx", "rx", "false")
                running.append(tx)
            if name.startswith("readers"):
                for _ in range(20):
                    reader = socket.socket(socket.AF_UNIX)
                    reader.settimeout(1)
                    try:
                        reader.connect(f"{folder}/rx.sock")
                        readers.append(reader)
                    except OSError:
                        reader.close()
                for reader in readers[:-60]:
                    reader.close()
                readers = readers[-60:]
            if name.endswith("gone") and tx in running:
                tx.kill(); tx.wait(); running.remove(tx)
                [reader.close() for reader in readers]
                readers = []
            if stranger.poll() is not None:
                sys.exit(f"the stranger ended with {stranger.returncode}:\n" + open(f"{folder}/sound.err").read()[-2000:])
            if rx.poll() is not None:
                sys.exit(f"the node ended with {rx.returncode}:\n" + open(f"{folder}/node.err").read()[-2000:])
            memory, descriptors = held(rx)
            at = time.monotonic() - begun
            if first is None and time.monotonic() > ends - part + min(60, part / 3):
                first = memory
            worst.setdefault(name, []).append((at, memory, descriptors))
            steps += 1
            time.sleep(1)
        samples = worst[name]
        later = [memory for at, memory, _ in samples if at > samples[0][0] + min(60, part / 3)]
        grown = max(later) - first
        print(f"{name}: {min(m for _, m, _ in samples) / 1024:.1f} to {max(m for _, m, _ in samples) / 1024:.1f} MB, "
              f"{max(later) / 1024 - first / 1024:+.1f} MB after its first minute, at most {max(d for *_, d in samples)} descriptors", flush=True)
        assert grown < 8 * 1024, f"{grown} KiB more"
        assert max(d for *_, d in samples) < 128, "descriptors"
    lines = [json.loads(line) for line in open(f"{folder}/rx.jsonl")]
    print(f"{len(lines)} reports, {sum(line['state'] == 'bearing' for line in lines)} of them new bearings; {len([f for f in os.listdir(folder) if f.startswith('rx') and f.endswith('.dat')])} logs")
    assert minutes < 3 or any(line["state"] == "bearing" for line in lines), "no bearing"
finally:
    for process in running:
        process.kill()
        process.wait()
    shutil.rmtree(folder)
PYTHON
