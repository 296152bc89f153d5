#!/usr/bin/env bash
# `csi5300 view` in headless Chromium, with real clicks and keys: captures, a log, a running node, and the page as one file.
# 77: Chromium or Playwright cannot be installed here.
set -euo pipefail
cd "$(dirname "$0")/../.."
browser() { command -v chromium || command -v chromium-browser || command -v google-chrome; }
if ! browser >/dev/null; then
    install() { DEBIAN_FRONTEND=noninteractive apt-get install -y --no-remove --no-install-recommends chromium; }
    { install || { apt-get update && install; }; } >/dev/null 2>&1 || { echo "no Chromium, and Debian's cannot be installed"; exit 77; }
fi
python=$(scripts/venv.sh playwright 2>/dev/null) || { echo "no Python, or playwright cannot be installed"; exit 77; }
csi5300=${CSI5300:-$(scripts/program.sh)}
folder=$(mktemp -d)
started=()
trap 'for one in "${started[@]}"; do kill "$one" 2>/dev/null || true; done; rm -rf "$folder"' EXIT

# Three sets with one capture each, one of them without the receiver's log, and another program's answers.
for set in LOS_A LOS_B NLOS; do
    mkdir -p "$folder/captures/$set"
    cp -r tests/fixtures/small-circle "$folder/captures/$set/P1"
done
rm "$folder"/captures/NLOS/P1/csi_rx_*.dat
stamp=$(basename "$folder"/captures/LOS_A/P1/csi_rx_*.dat .dat | cut -c8-)
tx=$(basename "$folder"/captures/LOS_A/P1/csi_tx*_"$stamp".dat "_$stamp.dat" | cut -c5-)
cat >"$folder/captures/links.csv" <<END
capture,tx,displacement,peer_est_deg,peer_err_from_mean_pose_deg
LOS_A/P1/$stamp,$tx,gt,30.0,6.5
LOS_B/P1/$stamp,$tx,gt,30.0,-12.5
END

# The robot drives for as long as anybody looks.
sed -e 's/^duration_s = 30.0/duration_s = 270000.0/' -e 's/, duration_s = 27.0/, duration_s = 270000.0, turns = 10000/' scenes/lab-circle.toml >"$folder/room.toml"
cat >"$folder/robot.toml" <<END
name = "burger"
channel = "108"
capture.room = { scene = "room.toml", robot = "rx", speed = 1.0 }
odometry.room = {}
[estimator]
least_motion_m = 0.2
accurate_every_s = 1.0
window_m = 0.8
[team]
[[peer]]
name = "tx"
records.room = {}
[output]
bearings = "bearings.jsonl"
status_socket = "status.sock"
END
serve() { # what, where its address is written
    "$csi5300" view "$1" >"$2" &
    started+=($!)
    while kill -0 "$!" 2>/dev/null; do [ ! -s "$2" ] || return 0; sleep 0.1; done
    echo "csi5300 view $1 says no address"; exit 1
}
serve "$folder/captures" "$folder/captures.url"
mkdir "$folder/logs"
cp "$folder"/captures/LOS_A/P1/csi_*.dat "$folder/logs"
serve "$folder/logs" "$folder/log.url"
status=0
"$csi5300" evaluate "$folder/captures" --html "$folder/page.html" || status=$?
[ "$status" = 3 ] || { echo "a capture without its log: exit status $status instead of 3"; exit 1; }
(cd "$folder" && exec "$csi5300" node --config robot.toml) 2>"$folder/said" &
started+=($!)
node=$!
until [ -S "$folder/status.sock" ] || ! kill -0 "$node"; do sleep 0.1; done
serve "$folder/status.sock" "$folder/node.url"
sed 's/faults = { loss = 0.0018, killed = true }/faults = { card = ["clock_steps"] }/' scenes/lab-circle.toml >"$folder/broken.toml"
status=0
"$csi5300" doctor --accept "$folder/broken.toml" --report "$folder/desk" >"$folder/said" || status=$?
[ "$status" = 1 ] || { echo "a card with a fault: exit status $status instead of 1"; exit 1; }
"$python" tests/checks/view.py "$(browser)" "$(cat "$folder/captures.url")" "$(cat "$folder/log.url")" \
    "$(cat "$folder/node.url")" "$folder/page.html" "$folder/desk/report.html" "${VIEW_PICTURES:-}" "$node"
# A signal ends it with status 0.
kill -INT "${started[0]}"
wait "${started[0]}" || { echo "after SIGINT: exit status $?"; exit 1; }
