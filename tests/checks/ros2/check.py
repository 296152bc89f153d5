"""check.py PROGRAM FOLDER: the checks of tests/checks/ros2.sh, except for the recordings."""
import json, math, os, random, re, signal, socket, sys, threading, time
from running import DOMAIN, TRUTH, add_team, add_third, folder, followed, here, off, running, start, start_node, state, until

UNICAST = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>30</MaxAutoParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""
# Only members of the multicast group learn these ports.
GROUP = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/></Interfaces>
<AllowMulticast>true</AllowMulticast></General><Discovery><ParticipantIndex>none</ParticipantIndex></Discovery></Domain></CycloneDDS>"""
os.environ["CYCLONEDDS_URI"] = UNICAST

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
import types_ros2 as ros

reliable = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(50))
best_effort = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(50))
latched = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.Durability.TransientLocal, Policy.History.KeepLast(50))

def start_robots(uri=UNICAST):
    return start(sys.executable, f"{here}/robots.py", str(DOMAIN), env={**os.environ, "CYCLONEDDS_URI": uri})

def goes_on(what):
    before = followed(state())
    until(what, 20, lambda told: followed(told) > before + 20)

class Reader:
    def __init__(self, participant, name, kind, qos):
        self.name, self.reader = name, DataReader(participant, Topic(participant, name, kind), qos=qos)

    def next(self, seconds=600):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for sample in self.reader.take(N=20):
                if sample.sample_info.valid_data:
                    return sample
            time.sleep(0.005)
        raise AssertionError(f"nothing came on {self.name}: {state()['ros2']}, {state()['trouble']}")

NODE = "rt/csi5300_tb3_0"

def bearings(readers):
    worst = 0.0
    for peer, reader in readers.items():
        end, good = time.monotonic() + 600, 0
        while good < 3:
            told = reader.next()
            assert (told.peer, told.header.frame_id) == (peer, "odom"), told
            here_off = off(told.azimuth, TRUTH[peer]) if told.state == "bearing" else math.inf
            good = good + 1 if here_off < 1.0 else 0
            worst = max(worst, here_off if good else 0.0)
            assert time.monotonic() < end, f"{here_off} degrees off: {told}"
    print(f"bearings of two robots over DDS, at most {worst:.2f} degrees off", flush=True)

def outputs(participant):
    """All other published topics."""
    marked, peers, end = Reader(participant, f"{NODE}/markers", ros.MarkerArray, reliable), set(), time.monotonic() + 600
    while peers != set(TRUTH):
        told = marked.next()
        if told.markers[0].ns.startswith("team/"):
            continue
        assert len(told.markers) == 5 and {m.header.frame_id for m in told.markers} == {"odom"}, told
        arrow, words = told.markers[0], told.markers[4]
        if arrow.action == 0:
            (a, b), name = arrow.points, arrow.ns
            if off(math.atan2(b.y - a.y, b.x - a.x), TRUTH[name]) < 1.0 and words.text.startswith(name):
                peers.add(name)
        assert time.monotonic() < end, told
    said = Reader(participant, "rt/diagnostics", ros.DiagnosticArray, reliable).next()
    assert [s.name for s in said.status] == [f"csi5300_tb3_0: {part}" for part in ("card", "odometry", "peer tb3_1", "peer tb3_2", "node", "claims")], said
    assert said.status[0].level == 0 and float(said.status[0].values[1].value) > 50, said
    direction = Reader(participant, f"{NODE}/tb3_1/direction", ros.PoseStamped, reliable).next()
    q = direction.pose.orientation
    assert off(2 * math.atan2(q.z, q.w), TRUTH["tb3_1"]) < 2.0, direction
    csi = Reader(participant, f"{NODE}/csi", ros.Csi, best_effort).next()
    assert len(csi.re) == len(csi.im) == 30 * csi.n_rx * csi.n_tx and csi.mac and csi.frame_count > 0, csi
    graph = Reader(participant, "ros_discovery_info", ros.ParticipantEntitiesInfo, latched).next()
    node = graph.node_entities_info_seq[0]
    assert (node.node_namespace, node.node_name) == ("/", "csi5300_tb3_0") and len(node.writer_gid_seq) > 8, graph
    print("markers, diagnostics, directions, CSI and the graph of nodes are correct", flush=True)

def shown():
    """The topics in the layouts for Foxglove and RViz are published, and have the displayed fields."""
    published = set(state()["ros2"]["published"]) | {"/odom"}
    packaging = f"{here}/../../../packaging"
    text = open(f"{packaging}/foxglove-layout.json").read().replace("burger_1", "tb3_0").replace("burger_2", "tb3_1")
    def strings(value):
        if isinstance(value, dict):
            return [s for key, inner in value.items() for s in [key, *strings(inner)]]
        return [s for inner in value for s in strings(inner)] if isinstance(value, list) else [value] if isinstance(value, str) else []
    paths = [s for s in strings(json.loads(text)) if s.startswith("/")]
    views = open(f"{packaging}/ros2/csi5300_msgs/rviz/csi5300.rviz").read().replace("burger_1", "tb3_0")
    paths += re.findall(r"Value: (/\S+)", views)
    fields = {"/csi5300_tb3_0/tb3_1/bearing": ros.Bearing.__dataclass_fields__}
    for path in paths:
        topic, _, field = path.partition(".")
        assert topic in published, f"{path} is displayed but not published: {sorted(published)}"
        assert not field or field in fields[topic], f"{topic} has no {field}"
    assert len(paths) > 6, paths
    print(f"all {len(paths)} topics of the layouts are published", flush=True)

clients = {}

def client(participant, name):
    """A client as a program has it: one for all its requests."""
    if name not in clients:
        topic = Topic(participant, f"rq/csi5300_tb3_0/{name}Request", ros.TriggerRequest)
        clients[name] = DataWriter(participant, topic, qos=reliable), Reader(participant, f"rr/csi5300_tb3_0/{name}Reply", ros.TriggerResponse, reliable)
    return clients[name]

def service(participant, name, number):
    writer, reader = client(participant, name)
    end = time.monotonic() + 600
    while not writer.get_matched_subscriptions() or not reader.reader.get_matched_publications():
        assert time.monotonic() < end, f"no answer from service {name}"
        time.sleep(0.05)
    writer.write(ros.TriggerRequest(77, number, 0))
    said = reader.next()
    assert (said.client, said.number) == (77, number), said
    return said

def recording(participant):
    said = service(participant, "stop_recording", 1)
    assert said.success and said.message == f"{folder}/run", said
    said = service(participant, "start_recording", 2)
    assert said.success and said.message == f"{folder}/run-r1", said
    before = state()["ros2"]["bag"]["written"]
    until("something is recorded", 60, lambda told: told["ros2"]["bag"]["written"] > before + 800)
    assert service(participant, "stop_recording", 3).success
    assert not service(participant, "stop_recording", 4).success
    os.rename(f"{folder}/run-r1", f"{folder}/again")
    os.rename(f"{folder}/again/run-r1_0.mcap", f"{folder}/again/again_0.mcap")
    text = open(f"{folder}/again/metadata.yaml").read().replace("run-r1_0", "again_0")
    open(f"{folder}/again/metadata.yaml", "w").write(text)
    print("recordings are started and stopped by services", flush=True)

# Claims that may fail on a machine that is busy with other checks.
BUSY = ("host.", "reception.gaps", "exchange.late", "exchange.turn_around")


def self_test(participant):
    """The acceptance claims, from ROS's service for them and in the diagnostics."""
    writer = DataWriter(participant, Topic(participant, "rq/csi5300_tb3_0/self_testRequest", ros.SelfTestRequest), qos=reliable)
    reader = Reader(participant, "rr/csi5300_tb3_0/self_testReply", ros.SelfTestResponse, reliable)
    end = time.monotonic() + 600
    while not writer.get_matched_subscriptions() or not reader.reader.get_matched_publications():
        assert time.monotonic() < end, "no service self_test"
        time.sleep(0.05)
    writer.write(ros.SelfTestRequest(78, 1, 0))
    said = reader.next()
    assert (said.client, said.number, said.id) == (78, 1, state()["name"]), said
    told = {status.name: status for status in said.status}
    failed = [f"{status.name}: {status.message}" for status in said.status if status.level == 2]
    others = [one for one in failed if not one.removeprefix("csi5300: ").startswith(BUSY)]
    assert said.passed == (not failed) and not others, failed
    for name in ["reception.once", "log.whole", "exchange.pairs, tb3_1", "exchange.pairs, tb3_2"]:
        assert told[f"csi5300: {name}"].level == 0, told[f"csi5300: {name}"]
    assert told["csi5300: injection.heard"].level == 3
    reader, end = Reader(participant, "rt/diagnostics", ros.DiagnosticArray, reliable), time.monotonic() + 600
    while (claims := reader.next().status[-1]).level == 3:
        assert time.monotonic() < end, claims
    busy = [value.key for value in claims.values if value.key.startswith(BUSY)]
    assert claims.level == 0 and claims.message.endswith("claims hold") or busy and len(busy) == len(claims.values), claims
    print(f"the service self_test answers for {len(said.status)} claims; diagnostics: {claims.message}", flush=True)

def team(participant, readers):
    """The peers are too far away for bearings from one circle to cross: ranges of another sensor place them."""
    missing = until("ranges are missed", 60, lambda t: t["team"] and len([w for w in t["team"]["notes"] if w.startswith("no range to")]) == 2)
    assert not missing["team"]["robots"], missing["team"]
    stamp = readers["tb3_2"].next().header.stamp
    # The room has a clock of its own.
    ahead, over = stamp.sec + stamp.nanosec * 1e-9 - time.time(), threading.Event()
    writers = {peer: DataWriter(participant, Topic(participant, f"rt/uwb/{peer}", ros.Range), qos=reliable) for peer in TRUTH}

    def measure():
        chance = random.Random(2)
        while not over.wait(0.1):
            now = time.time()
            stamp = ros.Time(int(now + ahead), int((now + ahead) % 1 * 1e9))
            own, other = (0.3 * math.cos(0.7 * now), 0.3 * math.sin(0.7 * now)), (24.0 + 0.25 * math.cos(-0.4 * now), 10.0 + 0.25 * math.sin(-0.4 * now))
            for peer, place in (("tb3_1", other), ("tb3_2", (-14.0, 16.0))):
                told = math.dist(own, place) + chance.gauss(0.0, 0.1)
                writers[peer].write(ros.Range(ros.Header(stamp, "uwb"), min_range=0.3, max_range=50.0, range=told, variance=0.01))
            writers["tb3_2"].write(ros.Range(ros.Header(stamp, "uwb"), min_range=0.3, max_range=50.0, range=math.inf))

    thread = threading.Thread(target=measure)
    thread.start()
    try:
        found = lambda t: {one["name"]: one for one in t["team"]["robots"]}
        told = until("both peers are placed", 120, lambda t: {"tb3_1", "tb3_2"} <= set(found(t)))
        assert any("ranges to tb3_2 are unusable" in w for w in told["team"]["notes"]) and told["ros2"]["subscribed"]["/uwb/tb3_1"]["read"] > 0, told
        robots = found(told)
        (x, y), covariance = robots["tb3_2"]["position_m"], robots["tb3_2"]["covariance"]
        worst_m = math.hypot(x + 14.0, y - 16.0)
        assert worst_m < 2.0 and covariance[0][0] + covariance[1][1] < 2.0, robots
        x, y = robots["tb3_1"]["position_m"]
        worst_m = max(worst_m, math.hypot(x - 24.0, y - 10.0) - 0.25)
        assert worst_m < 2.0, robots
        graph = json.loads(Reader(participant, f"{NODE}/factors", ros.Text, latched).next().data)
        links = graph["graph"]["links"]
        ranges = [link for link in links if link["modes"][0]["azimuth_rad"] is None]
        assert graph["format"] == "csi5300-team" and 0 < len(ranges) < len(links), graph
        marked, names = Reader(participant, f"{NODE}/markers", ros.MarkerArray, reliable), set()
        while len(names) < 3:
            markers = marked.next().markers
            names |= {m.ns for m in markers if m.ns.startswith("team/") and m.header.frame_id == "odom"}
        assert names == {f"team/{own}" for own in (state()["name"], *TRUTH)}, names
        print(f"the team: {len(links)} links, of which {len(ranges)} are ranges of a topic; peers at most {worst_m:.2f} m off; factors and ellipses are published", flush=True)
    finally:
        over.set()
        thread.join()

def wrong_ends(participant):
    """A subscriber that requests more than is offered, or a publisher of another type, is reported."""
    eager = DataReader(participant, Topic(participant, f"{NODE}/csi", ros.Csi), qos=reliable)
    until("the mismatch is reported", 60, lambda t: any("/csi5300_tb3_0/csi: the publisher is best effort, and the subscriber asks for reliable" in w for w in t["trouble"]))
    del eager
    until("the mismatch is over", 60, lambda t: not any("best effort" in w for w in t["trouble"]))
    other = DataWriter(participant, Topic(participant, "rt/tb3_2/pose", ros.Odometry), qos=reliable)
    until("the other type is reported", 60, lambda t: any("another type" in w for w in t["trouble"] + [json.dumps(t["odometry"])]))
    del other
    print("incompatible endpoints are reported", flush=True)

def hostile(participant):
    node = state()
    words = [node["ros2"]["subscribed"]["/tb3_0/odom"]["unreadable"], node["ros2"]["dds"]["malformed"], node["load"]["memory_mib"]]
    # The right type name with other content.
    topic = Topic(participant, "rt/tb3_0/odom", ros.NoOdometry)
    writer = DataWriter(participant, topic, qos=reliable)
    end = time.monotonic() + 600
    while not writer.get_matched_subscriptions():
        assert time.monotonic() < end
        time.sleep(0.05)
    for k in range(500):
        writer.write(ros.NoOdometry("x" * (k % 40)))
    until("unreadable messages are counted", 60, lambda t: t["ros2"]["subscribed"]["/tb3_0/odom"]["unreadable"] >= words[0] + 100)
    del writer
    # Invalid datagrams, some of them nearly valid.
    host, port = node["ros2"]["address"].split(":")
    noise, chance = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), random.Random(1)
    for k in range(20_000):
        head = b"RTPS\x02\x04\x00\x00" + bytes(12) if k % 2 else b""
        noise.sendto(head + chance.randbytes(chance.randrange(1, 200)), (host, int(port) + k % 2))
        if k % 100 == 0:
            time.sleep(0.002)
    until("invalid datagrams are counted", 60, lambda t: t["ros2"]["dds"]["malformed"] > words[1] + 1_000)
    # A flood of poses of a robot that only the room follows: as fast as they can be written.
    flood = DataWriter(participant, Topic(participant, "rt/tb3_2/pose", ros.PoseStamped), qos=best_effort)
    end = time.monotonic() + 600
    while not flood.get_matched_subscriptions():
        assert time.monotonic() < end
        time.sleep(0.05)
    before, begun, sent = state(), time.monotonic(), 0
    pose = ros.PoseStamped(ros.Header(ros.Time(), "world"), ros.Pose(ros.Point(-14.0, 16.0, 0.0)))
    while time.monotonic() < begun + 5:
        flood.write(pose)
        sent += 1
    del flood
    came = until("the node answers", 60, lambda t: True)["ros2"]["subscribed"]["/tb3_2/pose"]["read"] - before["ros2"]["subscribed"]["/tb3_2/pose"]["read"]
    goes_on("poses go on after a flood")
    grown = state()["load"]["memory_mib"] - words[2]
    assert grown < 24, f"{grown} MiB more"
    print(f"malformed messages and datagrams are counted; a flood of {sent} poses in 5 s ({came} read) stops nothing; {grown:.1f} MiB more", flush=True)

def discovery(uri, what):
    before = state()["ros2"]["subscribed"]["/tb3_0/odom"]["read"]
    begun = time.monotonic()
    robots = start_robots(uri)
    # The earlier processes send nothing more.
    until(f"robots are found {what}", 60, lambda t: t["ros2"]["subscribed"]["/tb3_0/odom"]["read"] > before)
    taken = time.monotonic() - begun
    until("poses come", 60, lambda t: t["ros2"]["subscribed"]["/tb3_0/odom"]["read"] > before + 20)
    print(f"found {what} {taken:.1f} s after the start of its process", flush=True)
    return robots

def end(process):
    process.send_signal(signal.SIGKILL)
    process.wait()

def main():
    add_third()
    add_team()
    node = start_node("robot.toml", "node.log")
    until("the node runs", 60, lambda t: True)
    robots = discovery(UNICAST, "without multicast")
    participant = DomainParticipant(DOMAIN)
    readers = {peer: Reader(participant, f"{NODE}/{peer}/bearing", ros.Bearing, reliable) for peer in TRUTH}
    bearings(readers)
    team(participant, readers)
    outputs(participant)
    shown()
    recording(participant)
    self_test(participant)
    wrong_ends(participant)
    hostile(participant)
    # A dead robot is missed; a restarted one is heard.
    end(robots)
    until("silence is reported", 60, lambda t: any("nothing comes any more" in w for w in t["trouble"]))
    robots = discovery(UNICAST, "again")
    until("no trouble is left", 60, lambda t: not t["trouble"])
    bearings(readers)
    if os.environ.get("C5_MULTICAST"):
        end(robots)
        time.sleep(1)
        robots = discovery(GROUP, "by multicast")
    node.send_signal(signal.SIGTERM)
    assert node.wait(60) in (0, 3), open(f"{folder}/node.log").read()
    print(open(f"{folder}/node.log").read()[-300:])

with running():
    main()
