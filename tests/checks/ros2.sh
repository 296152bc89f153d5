#!/usr/bin/env bash
# The simulated room follows scripted robots over ROS 2, published by CycloneDDS with types defined here; bearings, markers, diagnostics,
# CSI and services come back. Also: discovery with and without multicast, incompatible endpoints, invalid messages and datagrams, a flood,
# peers that die and return, recordings read by other programs, and the topics over zenoh as nodes with rmw_zenoh have them. All over
# loopback, in a network namespace where one can be made. 77: CycloneDDS's Python package cannot be installed here.
set -euo pipefail
cd "$(dirname "$0")/../.."
python=$(scripts/venv.sh cyclonedds rosbags mcap mcap-ros2-support 2>/dev/null) ||
    { echo "no Python, or cyclonedds, rosbags or mcap cannot be installed"; exit 77; }
csi5300=$(scripts/program.sh)
folder=$(mktemp -d)
space=c5-ros2-$$
clean() {
    ip netns del "$space" 2>/dev/null || true
    rm -rf "$folder"
}
trap clean EXIT
cp examples/ros2/*.toml "$folder"
mkdir "$folder/zenoh" && cp examples/ros2/*.toml "$folder/zenoh"
inside=()
if ip netns add "$space" 2>/dev/null && ip -n "$space" link set lo up multicast on 2>/dev/null; then
    inside=(ip netns exec "$space")
    export C5_MULTICAST=1
else
    echo "no network namespace can be made here: without multicast"
fi
"${inside[@]}" "$python" tests/checks/ros2/check.py "$csi5300" "$folder"
"$python" tests/checks/ros2/bags.py "$folder"/run "$folder"/again
"$python" tests/checks/ros2/kinds.py "$csi5300" "$folder/run"
# Converts a recording back to a log.
messages=$({ "$csi5300" unbag "$folder/run" --out "$folder/logs" || [ $? = 3 ]; } | awk '$1 ~ /csi.dat:$/ { print $2 }')
records=$("$csi5300" info --json "$folder/logs/csi5300_tb3_0_csi.dat" | "$python" -c 'import json, sys; print(sum(json.loads(l)["wsr"] for l in sys.stdin))')
echo "$messages messages of CSI are $records records"
[ "$messages" = "$records" ] && [ "$records" -gt 100 ]
if python=$(scripts/venv.sh eclipse-zenoh rosbags xxhash zenoh-ros2-sdk 2>/dev/null); then
    "${inside[@]}" "$python" tests/checks/ros2/rmw_zenoh.py "$csi5300" "$folder/zenoh"
else
    echo "eclipse-zenoh, xxhash or zenoh-ros2-sdk cannot be installed: the topics over zenoh were not tried"
fi
