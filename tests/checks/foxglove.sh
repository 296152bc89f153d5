#!/usr/bin/env bash
# A running node with a websocket client like Foxglove's viewers. 77: the client cannot be installed here.
set -euo pipefail
cd "$(dirname "$0")/../.."
python=$(scripts/venv.sh websockets protobuf 2>/dev/null) || { echo "no Python, or websockets cannot be installed"; exit 77; }
folder=$(mktemp -d)
node=
trap '[ -z "$node" ] || kill "$node" 2>/dev/null || true; rm -rf "$folder"' EXIT
csi5300=$(scripts/program.sh)
port=$("$python" -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
# The robot drives for as long as anybody looks.
sed -e 's/^duration_s = 30.0/duration_s = 270000.0/' -e 's/, duration_s = 27.0/, duration_s = 270000.0, turns = 10000/' scenes/lab-circle.toml >"$folder/room.toml"
cat >"$folder/robot.toml" <<END
name = "burger"
channel = "108"
capture.room = { scene = "room.toml", robot = "rx" }
odometry.room = {}
[estimator]
least_motion_m = 0.2
[[peer]]
name = "tx"
records.room = {}
[output]
bearings = "bearings.jsonl"
foxglove = "127.0.0.1:$port"
END
"$csi5300" node --config "$folder/robot.toml" 2>"$folder/said" &
node=$!
"$python" - "$port" "$folder/bearings.jsonl" <<'PYTHON'
import asyncio, base64, collections, json, math, struct, sys, time
import websockets
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

TOPICS = {
    "/csi/burger": "CsiRow", "/counters/burger": "Counters", "/tf": "FrameTransform", "/pose": "PoseInFrame",
    "/trajectory": "PosesInFrame", "/bearing/tx": "PoseInFrame", "/aoa_profile/tx": "LaserScan",
}
# Only if a bearing has a mirror.
SOMETIMES = {"/mirror/tx": "PoseInFrame"}

def message_of(schema, name):
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(schema))
    pool = descriptor_pool.DescriptorPool()
    left = list(files.file)
    while left:
        # In the order of their imports.
        ready = [f for f in left if all(d not in {o.name for o in left} for d in f.dependency)]
        for file in ready:
            pool.Add(file)
            left.remove(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))

async def connect(url):
    for _ in range(1_000):
        try:
            return await websockets.connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None)
        except OSError:
            await asyncio.sleep(0.1)
    sys.exit("the node does not listen")

def done(got):
    return set(TOPICS) <= set(got) and len(got["/bearing/tx"]) >= 4 and len(got["/aoa_profile/tx"]) >= 4

async def watch(url):
    channels, decoders, got = {}, {}, collections.defaultdict(list)
    async with await connect(url) as socket:
        while not done(got):
            try:
                said = await asyncio.wait_for(socket.recv(), 600)
            except (websockets.ConnectionClosed, asyncio.TimeoutError) as ended:
                came = {topic: len(messages) for topic, messages in got.items()}
                sys.exit(f"{ended!r} after {came} of {sorted(channels.values())}")
            if isinstance(said, str):
                said = json.loads(said)
                if said["op"] == "advertise":
                    wanted = []
                    for channel in said["channels"]:
                        channels[channel["id"]] = channel["topic"]
                        decoders[channel["id"]] = message_of(channel["schema"], channel["schemaName"])
                        kind = (TOPICS | SOMETIMES).get(channel["topic"])
                        assert kind and channel["schemaName"].split(".")[-1] == kind, channel["topic"]
                        assert channel["encoding"] == "protobuf", channel
                        wanted.append({"id": channel["id"], "channelId": channel["id"]})
                    await socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                elif said["op"] == "serverInfo":
                    assert said["name"] == "burger", said
            elif said[0] == 1:
                channel, at = struct.unpack_from("<IQ", said, 1)
                got[channels[channel]].append((at, decoders[channel].FromString(said[13:])))
    return got

def degrees(q):
    return math.degrees(2 * math.atan2(q.z, q.w))

def apart(a, b):
    return abs((a - b + 180) % 360 - 180)

got = asyncio.run(watch(f"ws://127.0.0.1:{sys.argv[1]}"))
row = got["/csi/burger"][0][1]
assert len(row.magnitude) == len(row.phase) == 30 and max(row.magnitude) > 0, row
numbers = [m.number for _, m in got["/csi/burger"]]
assert sorted(numbers) == numbers and len(set(numbers)) == len(numbers), "rows out of order"
counters = [m.records for _, m in got["/counters/burger"]]
assert sorted(counters) == counters and counters[-1] > 0, counters
robot = {at: m for at, m in got["/tf"] if m.child_frame_id == "robot"}
pose = got["/pose"][0]
where = pose[1].pose.position
moved = robot[pose[0]].translation
assert robot[pose[0]].parent_frame_id == "odom" and (moved.x, moved.y) == (where.x, where.y), robot
path = got["/trajectory"][-1][1].poses
assert 2 <= len(path) <= 501, len(path)
def bearings_said():
    lines = [json.loads(line) for line in open(sys.argv[2]) if line.endswith("\n")]
    return [l for l in lines if l["state"] == "bearing"]

# A bearing's line is written after its message, later on a busy machine.
for _ in range(600):
    said = bearings_said()
    if len(said) >= len(got["/bearing/tx"]):
        break
    time.sleep(0.1)
for at, bearing in got["/bearing/tx"][:4]:
    azimuth = degrees(bearing.pose.orientation)
    assert min(apart(azimuth, l["azimuth_deg"]) for l in said) < 1e-6, (azimuth, said)
    frames = [m for t, m in got["/tf"] if t == at and m.child_frame_id == "bearing/tx"]
    assert any(apart(degrees(m.rotation), azimuth) < 1e-9 for m in frames), frames
mirrors = dict(got["/mirror/tx"])
assert set(mirrors) <= {at for at, _ in got["/bearing/tx"]}, "a mirror without its bearing"
for at, bearing in got["/bearing/tx"][:4]:
    azimuth = degrees(bearing.pose.orientation)
    line = min(said, key=lambda l: apart(azimuth, l["azimuth_deg"]))
    assert (at in mirrors) == (line["mirror_deg"] is not None), (at, line)
    if at in mirrors:
        assert apart(degrees(mirrors[at].pose.orientation), line["mirror_deg"]) < 1e-6, (mirrors[at], line)
for at, scan in got["/aoa_profile/tx"][:4]:
    assert scan.frame_id == "robot" and max(scan.ranges) == 1.0 and len(scan.ranges) == 360, scan.frame_id
    step = (scan.end_angle - scan.start_angle) / 359
    peak = math.degrees(scan.start_angle + step * list(scan.ranges).index(1.0))
    assert any(apart(peak, l["azimuth_deg"]) < 12 for l in said), peak
    # Body azimuths are relative to the heading. With a place, they are seen from another point.
    own = degrees(dict(got["/bearing/tx"])[at].pose.orientation)
    heading = -degrees(scan.pose.orientation)
    # On the coarse grid two headings can give the same azimuth.
    lines = [l for l in said if apart(own, l["azimuth_deg"]) < 1e-6]
    fits = lambda l: l["azimuth_body_deg"] is None or apart(heading, l["azimuth_deg"] - l["azimuth_body_deg"]) < 1e-6
    assert any(l["position_m"] is not None or fits(l) for l in lines), (heading, lines)
print(f"{sum(map(len, got.values()))} messages on {sum(map(bool, got.values()))} topics, {len(mirrors)} mirrors; bearing {azimuth:.2f} deg")
PYTHON
# On a slow machine the scene, and the node with it, has ended by then.
kill "$node" 2>/dev/null || true
wait "$node" || [ $? = 3 ] || { cat "$folder/said"; exit 1; }
node=
