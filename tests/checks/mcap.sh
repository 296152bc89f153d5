#!/usr/bin/env bash
# Reads what `csi5300 mcap` writes with the Python mcap reader. 77: it cannot be installed here.
set -euo pipefail
cd "$(dirname "$0")/../.."
python=$(scripts/venv.sh mcap mcap-ros2-support 2>/dev/null) || { echo "no Python, or mcap cannot be installed"; exit 77; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
csi5300=$(scripts/program.sh)
capture=tests/fixtures/small-circle
logs=$(find "$capture" -name 'csi_rx_*.dat'; find "$capture" -name 'csi_tx*_*.dat' | sort)
path=$(find "$capture" -name 'rx_trajectory_*.csv')
# shellcheck disable=SC2086
"$csi5300" mcap $logs --trajectory "$path" --channel 108 --out "$folder/out.mcap" --json >"$folder/row.json"
records=$("$csi5300" info --json $logs | "$python" -c 'import json, sys; print(sum(json.loads(l)["wsr"] for l in sys.stdin))')
"$python" - "$folder/row.json" "$records" <<'PYTHON'
import json, sys

row = json.load(open(sys.argv[1]))
assert sum(log["records"] for log in row["logs"]) == int(sys.argv[2]) and row["output"].endswith("out.mcap"), row
assert len(row["bearings"]) == len(row["logs"]) - 1 and all(link["error"] is None for link in row["bearings"]), row
PYTHON
"$python" - "$folder/out.mcap" "$records" <<'PYTHON'
import collections, math, sys
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

seen, messages, last = collections.Counter(), collections.defaultdict(list), 0
with open(sys.argv[1], "rb") as stream:
    for schema, channel, message, decoded in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
        seen[channel.topic] += 1
        messages[channel.topic].append((schema.name, decoded))
rows = sum(count for topic, count in seen.items() if topic.startswith("/csi/"))
assert rows == int(sys.argv[2]), (rows, sys.argv[2])
row = next(m for t, ms in messages.items() if t.startswith("/csi/") for _, m in ms)
assert len(row.magnitude) == len(row.phase) == 30, row
bearing = [t for t in seen if t.startswith("/bearing/")]
assert len(bearing) == 1 and messages[bearing[0]][0][0] == "geometry_msgs/msg/PoseStamped", seen
q = messages[bearing[0]][0][1].pose.orientation
azimuth = math.degrees(2 * math.atan2(q.z, q.w))
scan = messages[bearing[0].replace("bearing", "aoa_profile")][0][1]
# Around the middle of the motion, from the bearing on.
assert scan.header.frame_id == bearing[0].lstrip("/"), scan.header
peak = math.degrees(scan.angle_min + scan.angle_increment * max(range(len(scan.ranges)), key=lambda k: scan.ranges[k]))
assert abs(peak) < 10 and max(scan.ranges) == 1.0, peak
# A transform for each pose, and one for the bearing.
assert seen["/tf"] == seen["/pose"] + len(bearing), seen
assert seen["/pose"] == len(messages["/trajectory"][0][1].poses) > 100, seen
print(f"{sum(seen.values())} messages on {len(seen)} topics; bearing {azimuth:.2f} deg, peak of its profile {peak:.0f} deg off")
PYTHON
