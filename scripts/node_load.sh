#!/usr/bin/env bash
# What a node costs: N robots are simulated into logs, then one node replays its own and its peers' at their own pace.
# Prints processor share, memory, and how long estimates took. Usage: scripts/node_load.sh [ROBOTS ...]
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release --quiet
csi5300=$PWD/${CARGO_TARGET_DIR:-target}/release/csi5300
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
for robots in "${@:-2 4 8}"; do
    for count in $robots; do
        python3 - "$count" >"$folder/scene.toml" <<'PYTHON'
import math, sys
n = int(sys.argv[1])
print('name = "load"\nduration_s = 24.0\nchannel = 108\ncfo = "physical"\n[sounding]\nrate_hz = 100.0\n[radio]\nphase_noise_rad = 0.1')
for k in range(n):
    a, d = 0.4 + math.tau * k / n, 0 if k == 0 else 9
    print(f'[[robot]]\nname = "r{k}"\nposition_m = [{d * math.cos(a):.3f}, {d * math.sin(a):.3f}, 0.2]')
    if k == 0:
        print("motion.circle = { radius_m = 0.3, duration_s = 20.0, start_s = 1.5 }\nodometry = { rate_hz = 50.0 }")
PYTHON
        rm -rf "$folder/logs"
        "$csi5300" simulate "$folder/scene.toml" --out "$folder/logs" >/dev/null
        rx=$(find "$folder/logs" -name 'csi_rx_*.dat')
        mac=$(printf '02:53:00:00:00:%02x' 0)
        {
            echo "mac = \"$mac\""
            echo 'channel = "108"'
            echo "capture.replay = { file = '$rx', speed = 1.0 }"
            echo "odometry.csv.file = '$(find "$folder/logs" -name 'rx_trajectory_*.csv')'"
            for k in $(seq 1 $((count - 1))); do
                log=$(find "$folder/logs" -name "csi_tx${k}_*.dat")
                printf '[[peer]]\nname = "r%d"\nmac = "02:53:00:00:00:%02x"\nrecords.replay.file = "%s"\n' "$k" "$k" "$log"
            done
            printf '[output]\nbearings = "%s/lines.jsonl"\nstatus_socket = "%s/s"\n' "$folder" "$folder"
        } >"$folder/robot.toml"
        rm -f "$folder/lines.jsonl"
        "$csi5300" node --config "$folder/robot.toml" 2>"$folder/err" &
        node=$!
        sleep 20
        "$csi5300" watch "$folder/s" --once >"$folder/state.json"
        read -r _ _ _ _ _ _ _ _ _ _ _ _ _ user system _ <"/proc/$node/stat"
        wait "$node" || cat "$folder/err"
        python3 - "$folder" "$count" "$((user + system))" <<'PYTHON'
import json, os, sys
state = json.load(open(sys.argv[1] + "/state.json"))
took = sorted(l["took_ms"] for l in map(json.loads, open(sys.argv[1] + "/lines.jsonl")) if l["state"] == "bearing" and l["took_ms"])
share = int(sys.argv[3]) / os.sysconf("SC_CLK_TCK") / state["uptime_s"] * 100
at = lambda part: took[min(len(took) - 1, int(part * len(took)))]
print(f"{sys.argv[2]} robots: {share:.1f} % of a core, {state['load']['memory_mib']:.1f} MiB; {len(took)} estimates, "
      f"median {at(.5):.1f} ms, 99 % {at(.99):.1f} ms")
PYTHON
    done
done
