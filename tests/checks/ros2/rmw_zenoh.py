"""rmw_zenoh.py PROGRAM FOLDER: checks the node's topics over zenoh, with DDS off. The other end is PyPI's zenoh-ros2-sdk with its own keys,
tokens and attachments; rosbags provides the types, their hashes and CDR, eclipse-zenoh the router."""
import math, os, socket, threading, time
from running import DOMAIN, TRUTH, add_team, add_third, folder, here, off, running, start_node, state, until
import xxhash, zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.discovery import get_topic_info, get_topic_names_and_types
from zenoh_ros2_sdk.keyexpr import topic_keyexpr
from zenoh_ros2_sdk.session import ZenohSession
from zenoh_ros2_sdk.utils import ros2_to_dds_type

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
store = get_typestore(Stores.ROS2_JAZZY)
for name in ("Bearing", "Csi"):
    text = open(f"{here}/../../../packaging/ros2/csi5300_msgs/msg/{name}.msg").read()
    store.register(get_types_from_msg(text, f"csi5300_msgs/msg/{name}"))
with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    PORT = free.getsockname()[1]
network = {"domain_id": DOMAIN, "router_port": PORT}
KINDS = {"bearing": "csi5300_msgs/msg/Bearing", "direction": "geometry_msgs/msg/PoseStamped", "pose": "geometry_msgs/msg/PoseWithCovarianceStamped"}
NODE = "/csi5300_tb3_0"

def of(kind):
    return {"msg_type": kind, "msg_definition": store.generate_msgdef(kind, ros_version=2)[0], "type_hash": store.hash_rihs01(kind), **network}

def key(topic, kind):
    return topic_keyexpr(DOMAIN, topic, ros2_to_dds_type(kind), store.hash_rihs01(kind))

def new(name, *values):
    package, kind = name.split("/")
    return ZenohSession.get_instance().store.types[f"{package}/msg/{kind}"](*values)

def header(frame):
    now = time.time()
    return new("std_msgs/Header", new("builtin_interfaces/Time", int(now), int(now % 1 * 1e9)), frame)

def turned(angle):
    return new("geometry_msgs/Quaternion", 0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))

def transform(parent, child, x, y, angle):
    moved = new("geometry_msgs/Transform", new("geometry_msgs/Vector3", x, y, 0.0), turned(angle))
    return new("geometry_msgs/TransformStamped", header(parent), child, moved)

def robots(over):
    """Publishes two robots that drive circles and one that stands on a plate; poses depend on the time only."""
    import numpy
    none = numpy.zeros(36)
    circles = [("tb3_0", 0.0, 0.0, 0.3, 0.7), ("tb3_1", 24.0, 10.0, 0.25, -0.4)]
    writers = [ROS2Publisher(f"/{name}/odom", node_name=name, **of("nav_msgs/msg/Odometry")) for name, *_ in circles]
    plates = ROS2Publisher("/tf", node_name="plates", **of("tf2_msgs/msg/TFMessage"))
    # Published once, before any subscription, as rmw_zenoh_cpp publishes a transient local topic.
    session = ZenohSession.get_instance()
    once = zenoh.ext.declare_advanced_publisher(session.session, key("/tf_static", "tf2_msgs/msg/TFMessage"),
        cache=zenoh.ext.CacheConfig(max_samples=1), publisher_detection=True)
    fixed = new("tf2_msgs/TFMessage", [transform("tb3_2/plate", "tb3_2/base_footprint", 4.0, 6.0, 0.3)])
    once.put(bytes(session.store.serialize_cdr(fixed, "tf2_msgs/msg/TFMessage")), attachment=Attachment(1, time.time_ns(), bytes(16)).to_bytes())
    yield
    while not over.wait(0.02):
        for writer, (name, x, y, radius, rate) in zip(writers, circles):
            angle = rate * time.time() % (2 * math.pi)
            at = new("geometry_msgs/Point", x + radius * math.cos(angle), y + radius * math.sin(angle), 0.0)
            pose = new("geometry_msgs/Pose", at, turned(angle + math.copysign(math.pi / 2, rate)))
            still = new("geometry_msgs/Twist", new("geometry_msgs/Vector3", 0.0, 0.0, 0.0), new("geometry_msgs/Vector3", 0.0, 0.0, 0.0))
            writer.publish(header=header("odom"), child_frame_id=f"{name}/base_footprint",
                pose=new("geometry_msgs/PoseWithCovariance", pose, none), twist=new("geometry_msgs/TwistWithCovariance", still, none))
        plates.publish(transforms=[transform("world", "tb3_2/plate", -18.0, 10.0, 0.0)])

class Reader:
    def __init__(self, topic, kind):
        self.topic, self.came = topic, []
        self.subscriber = ROS2Subscriber(topic, callback=self.came.append, node_name="reader", **of(kind))

    def next(self, seconds=600):
        end = time.monotonic() + seconds
        while not self.came:
            assert time.monotonic() < end, f"no message on {self.topic}: {state()['ros2']}, {state()['network']}, {state()['trouble']}"
            time.sleep(0.005)
        return self.came.pop(0)

def bearings():
    worst = 0.0
    for peer, truth in TRUTH.items():
        reader, end, good = Reader(f"{NODE}/{peer}/bearing", KINDS["bearing"]), time.monotonic() + 600, 0
        while good < 3:
            told = reader.next()
            assert (told.peer, told.header.frame_id) == (peer, "odom"), told
            here_off = off(told.azimuth, truth) if told.state == "bearing" else math.inf
            good = good + 1 if here_off < 1.0 else 0
            worst = max(worst, here_off if good else 0.0)
            assert time.monotonic() < end, f"{here_off} degrees off: {told}"
    print(f"rmw_zenoh: bearings of two robots, at most {worst:.2f} degrees off", flush=True)

def complete(look, wanted):
    """Looks until the answer is complete: on a busy machine, the network answers late."""
    end = time.monotonic() + 600
    while (seen := look()) != wanted:
        assert time.monotonic() < end, (seen, wanted)

def graph():
    """Checks the output of `ros2 topic list` and `ros2 topic info`; returns the token of the CSI topic."""
    own = {f"{NODE}/{peer}/{part}": kind for peer in TRUTH for part, kind in KINDS.items()}
    own |= {f"{NODE}/markers": "visualization_msgs/msg/MarkerArray", f"{NODE}/csi": "csi5300_msgs/msg/Csi"}
    own[f"{NODE}/factors"] = "std_msgs/msg/String"
    own |= {"/diagnostics": "diagnostic_msgs/msg/DiagnosticArray", "/tf": "tf2_msgs/msg/TFMessage"}
    read = {"/tb3_0/odom": "nav_msgs/msg/Odometry", "/tb3_1/odom": "nav_msgs/msg/Odometry", "/tf": "tf2_msgs/msg/TFMessage", "/tf_static": "tf2_msgs/msg/TFMessage"}
    read |= {f"/uwb/{peer}": "sensor_msgs/msg/Range" for peer in TRUTH}
    complete(lambda: dict(get_topic_names_and_types(**network)), {topic: [kind] for topic, kind in (own | read).items()})
    for topics, which, usual in ((own, "publishers", "::,32:,:,:,,"), (read, "subscribers", "2::,64:,:,:,,")):
        for topic, kind in topics.items():
            def ends(topic=topic, which=which):
                info = get_topic_info(topic, verbose=True, **network)
                all = getattr(info, which) if info else []
                return [(t.topic_type, t.type_hash, t.qos) for t in all if t.node_name.strip("/") == "csi5300_tb3_0" and t.node_namespace == "/"]
            qos = {f"{NODE}/csi": "2::,5:,:,:,,", "/tf_static": ":1:,64:,:,:,,", f"{NODE}/factors": ":1:,1:,:,:,,"}.get(topic, usual)
            complete(ends, [(kind, store.hash_rihs01(kind), qos)])
    tokens = []
    def count():
        # Of one answer: the next one may be incomplete again.
        seen = [str(reply.ok.key_expr) for reply in ZenohSession.get_instance().liveliness.get(f"@ros2_lv/{DOMAIN}/**")]
        tokens[:] = [token for token in seen if token.split("/")[8] == "csi5300_tb3_0"]
        return len(tokens)
    complete(count, len(own) + len(read) + 1)
    ids = [token.split("/")[2:6] for token in tokens]
    assert len({session for session, *_ in ids}) == 1 and {node for _, node, *_ in ids} == {"0"}, tokens
    assert len({number for *_, number, _ in ids}) == len(ids) == len(own) + len(read) + 1, tokens
    assert [token.split("/")[6:] for token in tokens if "/NN/" in token] == [["%", "%", "csi5300_tb3_0"]], tokens
    print(f"rmw_zenoh: one node, {len(own)} publishers and {len(read)} subscriptions in the graph", flush=True)
    return next(token for token in tokens if "%csi/" in token)

def messages(token):
    """Checks the other published messages, and the attachments."""
    marked = Reader(f"{NODE}/markers", "visualization_msgs/msg/MarkerArray")
    while (told := marked.next()).markers[0].ns.startswith("team/"):
        pass
    assert len(told.markers) == 5 and {m.header.frame_id for m in told.markers} == {"odom"}, told
    assert Reader("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray").next().status[0].name == "csi5300_tb3_0: card"
    csi = Reader(f"{NODE}/csi", "csi5300_msgs/msg/Csi").next()
    assert len(csi.re) == len(csi.im) == 30 * csi.n_rx * csi.n_tx and csi.mac, csi
    came = []
    raw = ZenohSession.get_instance().session.declare_subscriber(key(f"{NODE}/csi", "csi5300_msgs/msg/Csi"), came.append)
    until("records arrive", 60, lambda _: len(came) > 100)
    raw.undeclare()
    beside = [sample.attachment.to_bytes() for sample in came]
    assert {len(bytes) for bytes in beside} == {33} and {bytes(sample.payload)[:4] for sample in came} == {b"\0\1\0\0"}
    beside = [Attachment.from_bytes(bytes) for bytes in beside]
    numbers = [one.sequence_id for one in beside]
    # A slow reader misses some.
    assert numbers[0] > 0 and all(b > a for a, b in zip(numbers, numbers[1:])), numbers
    assert all(abs(one.timestamp_ns - time.time_ns()) < 60e9 for one in beside), beside[0]
    assert {one.gid for one in beside} == {xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")}, beside[0]
    print(f"rmw_zenoh: markers, diagnostics, CSI; attachments of {len(beside)} of {numbers[-1] - numbers[0] + 1} messages", flush=True)

def main():
    add_third()
    add_team()
    text = open(f"{folder}/robot.toml").read()
    text = text.replace('{ topic = "/tb3_2/pose", type = "pose" }', '{ type = "tf", frame = "world", child = "tb3_2/base_footprint" }')
    open(f"{folder}/robot.toml", "w").write(text + f'[network]\nros2 = true\nconnect = ["tcp/127.0.0.1:{PORT}"]\n')
    router = zenoh.Config()
    for name, value in (("mode", '"router"'), ("listen/endpoints", f'["tcp/127.0.0.1:{PORT}"]'), ("scouting/multicast/enabled", "false")):
        router.insert_json5(name, value)
    with zenoh.open(router):
        over = threading.Event()
        ZenohSession.get_instance(router_port=PORT)
        moving = robots(over)
        next(moving)
        thread = threading.Thread(target=lambda: list(moving))
        thread.start()
        try:
            node = start_node("robot.toml", "node.log")
            bearings()
            messages(graph())
            dds = state()["ros2"]
            assert all(one["publishers"] == 0 for one in dds["subscribed"].values()), dds
            node.terminate()
            assert node.wait(600) in (0, 3), open(f"{folder}/node.log").read()
            end = time.monotonic() + 600
            while get_topic_info(f"{NODE}/tb3_1/pose", **network):
                assert time.monotonic() < end, "the node has ended, but its topics remain"
        finally:
            over.set()
            thread.join()
            ZenohSession.get_instance().close()

with running():
    main()
