#!/usr/bin/env bash
# The simulated room follows scripted robots over a real ROS 1 master; bearings, poses and CSI come back on topics, also after the
# master was killed and restarted. Installs ROS from Debian. 77: it cannot be installed here.
set -euo pipefail
cd "$(dirname "$0")/../.."
packages=(python3-rospy python3-rosmaster python3-roslaunch python3-rostopic python3-genpy python3-std-msgs python3-geometry-msgs
    python3-nav-msgs python3-sensor-msgs python3-actionlib-msgs ros-std-msgs)
# Only this check needs it; the node does not need diagnostic_msgs.
packages+=(python3-diagnostic-msgs python3-rosservice)
missing=()
for package in "${packages[@]}"; do
    dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
done
if [ ${#missing[@]} -gt 0 ]; then
    install() { apt-get install -y --no-remove --no-install-recommends "${missing[@]}"; }
    export DEBIAN_FRONTEND=noninteractive
    { install || { apt-get update && install; }; } >/dev/null 2>&1 ||
        { echo "cannot install ${missing[*]} (no root, or no Debian with ROS)"; exit 77; }
fi
csi5300=$(scripts/program.sh)

folder=$(mktemp -d)
pids=()
# Each process leads its own group; processes that roscore starts are found by their log folder.
clean() {
    for pid in "${pids[@]}"; do kill -9 -- "-$pid" 2>/dev/null || true; done
    for command in $(grep -lsF -- "$folder" /proc/[0-9]*/cmdline); do kill -9 "$(basename "$(dirname "$command")")" 2>/dev/null || true; done
    rm -rf "$folder"
}
trap clean EXIT
start() { # NAME COMMAND...: in the background; its process id is in $started
    setsid "${@:2}" >"$folder/$1.log" 2>&1 </dev/null &
    started=$!
    pids+=("$started")
    [ "$1" = node ] || disown
}
# roscore's scripts are in Python; another Python first in PATH has no rospy.
mkdir "$folder/bin" && ln -s /usr/bin/python3 "$folder/bin/python3" && export PATH="$folder/bin:/usr/bin:$PATH"
port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
export ROS_MASTER_URI=http://127.0.0.1:$port ROS_HOSTNAME=127.0.0.1 ROS_LOG_DIR=$folder/log ROS_HOME=$folder/home

# Generates the shipped messages as catkin would.
python3 - packaging/ros/csi5300_msgs "$folder/python" <<'PYTHON'
import os, sys
import genpy.generator, genpy.genpy_main
package, to = sys.argv[1], os.path.join(sys.argv[2], "csi5300_msgs", "msg")
os.makedirs(to)
files = sorted(os.path.join(package, "msg", f) for f in os.listdir(os.path.join(package, "msg")))
search = {"csi5300_msgs": [os.path.join(package, "msg")], "std_msgs": ["/usr/share/std_msgs/msg"]}
failed = genpy.generator.MsgGenerator().generate_messages("csi5300_msgs", files, to, search)
assert not failed, failed
open(os.path.join(sys.argv[2], "csi5300_msgs", "__init__.py"), "w").close()
with open(os.path.join(to, "__init__.py"), "w") as init:
    init.writelines(f"from ._{os.path.basename(f)[:-4]} import *\n" for f in files)
PYTHON
export PYTHONPATH=$folder/python

# The example, with a third, stationary robot that is followed by a PoseStamped.
cp examples/ros/*.toml "$folder"
cat >>"$folder/room.toml" <<'TOML'
[[robot]]
name = "tb3_2"
position_m = [-14.0, 16.0, 0.0]
antenna_m = [-0.03, 0.0, 0.20]
motion.followed = {}
TOML
sed -i 's|^tb3_1.ros = .*|&\ntb3_2.ros = { topic = "/tb3_2/pose", type = "pose" }|' "$folder/robot.toml"
cat >>"$folder/robot.toml" <<'TOML'
[[peer]]
name = "tb3_2"
records.room = {}
poses.room = {}
antenna_offset_m = [-0.03, 0.0, 0.20]
TOML
cat >"$folder/robots.py" <<'PYTHON'
"""Two robots on circles, and a stationary one; their poses depend only on the time."""
import math, time, rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry

def stand(pose, x, y, heading):
    pose.position.x, pose.position.y = x, y
    pose.orientation.z, pose.orientation.w = math.sin(heading / 2), math.cos(heading / 2)

rospy.init_node("robots", disable_signals=True)
circles = [("tb3_0", 0.0, 0.0, 0.3, 0.7), ("tb3_1", 24.0, 10.0, 0.25, -0.4)]
publishers = [rospy.Publisher(f"/{name}/odom", Odometry, queue_size=10) for name, *_ in circles]
mocap = rospy.Publisher("/tb3_2/pose", PoseStamped, queue_size=10)
while True:
    now = time.time()
    for publisher, (name, x, y, radius, rate) in zip(publishers, circles):
        angle = rate * now % (2 * math.pi)
        told = Odometry(child_frame_id=f"{name}/base_footprint")
        told.header.stamp, told.header.frame_id = rospy.Time.from_sec(now), "odom"
        heading = angle + math.copysign(math.pi / 2, rate)
        stand(told.pose.pose, x + radius * math.cos(angle), y + radius * math.sin(angle), heading)
        publisher.publish(told)
    told = PoseStamped()
    told.header.frame_id = "world"
    stand(told.pose, -14.0, 16.0, 0.3)
    mocap.publish(told)
    time.sleep(0.02)
PYTHON
cat >"$folder/look.py" <<'PYTHON'
"""look.py state | bearings: prints the node's state, or reads bearings over rostopic until they are right."""
import json, math, socket, subprocess, sys, time, yaml

def state():
    with socket.socket(socket.AF_UNIX) as s:
        s.connect(sys.argv[2])
        return json.loads(s.makefile().readline())

def until(what, seconds, condition):
    # A busy machine needs longer.
    end = time.monotonic() + 20 * seconds
    while True:
        told = state()
        if condition(told):
            return told
        assert time.monotonic() < end, f"never: {what}: {json.dumps({k: told[k] for k in ('trouble', 'odometry', 'ros', 'poses')})}"
        time.sleep(0.2)

def followed(told):
    return told["odometry"]["followed"]["poses"]

def goes_on():
    before = followed(state())
    until("poses go on", 5, lambda told: followed(told) > before + 20)

def once(topic):
    text = subprocess.run(["rostopic", "echo", "-n", "1", topic], capture_output=True, text=True, timeout=300, check=True).stdout
    return yaml.safe_load(text.split("---")[0])

def off(radians, truth):
    return abs(math.degrees((radians - truth + math.pi) % (2 * math.pi) - math.pi))

def bearings(node):
    worst = 0.0
    for peer, truth in [("tb3_1", math.atan2(10.0, 24.0)), ("tb3_2", math.atan2(16.0, -14.0))]:
        end, good = time.monotonic() + 600, 0
        while good < 3:
            told = once(f"{node}/{peer}/bearing")
            assert told["peer"] == peer and told["header"]["frame_id"] == "odom", told
            here = off(told["azimuth"], truth) if told["state"] == "bearing" else math.inf
            good = good + 1 if here < 1.0 else 0
            worst = max(worst, here if good else 0.0)
            assert time.monotonic() < end, f"{here} degrees off: {told}"
        # On a busy machine, a bearing in between has few exchanges.
        here = math.inf
        while not here < 1.0:
            pose = once(f"{node}/{peer}/direction")
            q = pose["pose"]["orientation"]
            here = off(2 * math.atan2(q["z"], q["w"]), truth)
            assert time.monotonic() < end and pose["header"]["frame_id"] == "odom", pose
        assert math.hypot(pose["pose"]["position"]["x"], pose["pose"]["position"]["y"]) < 0.5, pose
    print(f"bearings of two robots over rostopic, at most {worst:.2f} degrees off")

def csi(node):
    told = once(f"{node}/csi")
    assert len(told["re"]) == len(told["im"]) == 30 * told["n_rx"] * told["n_tx"] and told["mac"] and told["frame_count"] > 0, told
    # Succeeds only if the checksums of both sides agree.
    import rospy
    from csi5300_msgs.msg import Bearing, Csi
    rospy.init_node("reader", disable_signals=True)
    assert rospy.wait_for_message(f"{node}/csi", Csi, 300).timestamp_low > 0
    assert rospy.wait_for_message(f"{node}/tb3_1/bearing", Bearing, 300).pairs > 0

def self_test(node):
    """The service, and the claims in /diagnostics, with Debian's diagnostic_msgs."""
    import rospy
    from diagnostic_msgs.msg import DiagnosticArray
    from diagnostic_msgs.srv import SelfTest
    rospy.init_node("tester", disable_signals=True)
    rospy.wait_for_service(f"{node}/self_test", 300)
    ask = rospy.ServiceProxy(f"{node}/self_test", SelfTest)
    end = time.monotonic() + 600
    while True:
        said = ask()
        levels = {status.name: status.level for status in said.status}
        if levels.get("csi5300: exchange.pairs, tb3_1") == 0:
            break
        assert time.monotonic() < end, said
        time.sleep(1)
    assert said.id and levels["csi5300: exchange.pairs, tb3_2"] == 0, said
    assert 3 in levels.values(), "a simulated card cannot answer every claim"
    end = time.monotonic() + 600
    while True:
        parts = {status.name: status for status in rospy.wait_for_message("/diagnostics", DiagnosticArray, 300).status}
        if parts["csi5300_tb3_0: claims"].level != 3:
            break
        assert time.monotonic() < end, parts
    assert "csi5300_tb3_0: peer tb3_1" in parts and parts["csi5300_tb3_0: card"].level == 0, parts
    print(f"the service self_test answers for {len(said.status)} claims; diagnostics: {parts['csi5300_tb3_0: claims'].message}")
PYTHON
look() { (cd "$folder" && python3 -c "import sys; sys.argv = ['look', '', '$folder/status.sock']; from look import *; $1"); }
master() {
    start roscore roscore -p "$port"
    core=$started
    for _ in $(seq 1000); do
        if rostopic list >/dev/null 2>&1; then
            # roscore starts it in its own group.
            core_master=$(python3 -c "import xmlrpc.client; print(xmlrpc.client.ServerProxy('$ROS_MASTER_URI').getPid('/check')[2])")
            return
        fi
        sleep 0.2
    done
    cat "$folder/roscore.log"
    exit 1
}
failed() { echo "failed; the logs:"; tail -n 20 "$folder"/*.log; }
trap failed ERR

# The node starts first and finds no master.
start node "$csi5300" node --config "$folder/robot.toml"
node=$started
until [ -S "$folder/status.sock" ] || ! kill -0 "$node"; do sleep 0.1; done
look 'until("no master", 10, lambda t: any("does not answer" in w for w in t["trouble"]))'
master
start robots python3 "$folder/robots.py"
robots=$started
look 'until("poses", 10, lambda t: followed(t) > 100 and not t["trouble"])'
look 'bearings("/csi5300_tb3_0"); csi("/csi5300_tb3_0")'

# Without a master the robots continue; the node registers with a restarted one, and restarted robots are heard.
kill -9 -- "-$core" "$core_master"
look 'until("the master is missed", 10, lambda t: any("any more" in w for w in t["trouble"])); goes_on()'
connections=$(look 'print(state()["ros"]["connections"])')
master
look "until('registered again', 15, lambda t: t['ros']['connections'] > $connections and not t['trouble']); goes_on()"
kill -9 -- "-$robots"
look 'until("silence is reported", 10, lambda t: any("nothing comes any more" in w for w in t["trouble"]))'
start robots python3 "$folder/robots.py"
look 'until("poses again", 10, lambda t: not t["trouble"]); goes_on(); bearings("/csi5300_tb3_0"); self_test("/csi5300_tb3_0")'

# An orderly end: the master no longer lists the node.
kill -TERM "$node"
# Status 3: a busy machine lost records of the served room, and the node reports them.
status=0
wait "$node" || status=$?
[ "$status" = 0 ] || { [ "$status" = 3 ] && grep '^lost: ' "$folder/node.log"; }
if rostopic list | grep csi5300; then echo "the node left topics behind"; exit 1; fi
tail -n 4 "$folder/node.log"
