"""Connects csi5300-node with a ROS 1 master: JSON lines on standard input and output. The node contains it and starts it (`[ros]`).
It needs rospy: Debian's python3-rospy, or a sourced setup.bash of Melodic (Python 2) or Noetic.

In: first {"master", "node", "read": [{"topic", "type"}], "write": [{"topic", "type"}], "serves", "definitions": {type: text}},
then {"to": NUMBER, "message": {...}} for each message and {"answer": NUMBER, "message": {...}} for each call of ~self_test. Out:
{"topic": NUMBER, "publisher", "stamp", "frame", "position", "orientation"} for each received pose (topic only if a value is not
a number; publisher is the number of its connection),
{"asked": NUMBER} for each call, and {"connections", "trouble", "wrong": [...]} once a second.
"""
from __future__ import print_function
import itertools, json, os, signal, sys, threading, time

for ignored in (signal.SIGINT, signal.SIGTERM):  # the node ends it by closing its input
    signal.signal(ignored, signal.SIG_IGN)
asked = json.loads(sys.stdin.readline())
node, uri = asked["node"], asked["master"]
os.environ["ROS_MASTER_URI"], os.environ["ROS_NAMESPACE"] = uri, node.rpartition("/")[0] or "/"
# rospy logs to standard output.
out = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)
import genpy.dynamic, rosgraph, rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Empty
try:
    from xmlrpc.client import ServerProxy
except ImportError:
    from xmlrpclib import ServerProxy

master, lock, publishers, services, headers = rosgraph.Master(node, uri), threading.Lock(), [], [], []
kinds = {"nav_msgs/Odometry": Odometry, "geometry_msgs/PoseStamped": PoseStamped}
for name, text in asked["definitions"].items():
    made = genpy.dynamic.generate_dynamic(name, text)
    kinds.update((kind, made[kind]) for kind in made if kind == name or kind not in kinds)
calls, answered, answers = itertools.count(), threading.Condition(), {}


class SelfTest(object):
    """The service diagnostic_msgs/SelfTest, which a bare rospy lacks."""
    _type, _md5sum = "diagnostic_msgs/SelfTest", "ac21b1bab7ab17546986536c22eb34e9"
    _request_class, _response_class = Empty, kinds["diagnostic_msgs/SelfTestResponse"]


def say(**told):
    with lock:
        out.write(json.dumps(told) + "\n")
        out.flush()


def connection(message):
    """The number of the connection by which it came: each has a header of its own."""
    known = message._connection_header
    with lock:
        found = next((number for number, one in enumerate(headers) if one is known), len(headers))
        if found == len(headers):
            headers.append(known)
    return found


def heard(message, number):
    pose, header = getattr(message.pose, "pose", message.pose), message.header
    position = [pose.position.x, pose.position.y, pose.position.z]
    orientation = [pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w]
    if all(abs(x) < 1e300 for x in position + orientation):
        say(topic=number, publisher=connection(message), stamp=[header.stamp.secs, header.stamp.nsecs], frame=header.frame_id,
            position=position, orientation=orientation)
    else:
        say(topic=number)


def fill(message, told):
    for name, kind in zip(message.__slots__, message._slot_types):
        value = told.get(name)
        if kind == "time":
            value = rospy.Time(value["sec"], value["nanosec"])
        elif isinstance(value, dict):
            value = fill(getattr(message, name), value)
        elif isinstance(value, list) and kind[:-2] in kinds:
            value = [fill(kinds[kind[:-2]](), one) for one in value]
        elif value is None and name in told:
            value = float("nan")  # JSON has no such number
        if value is not None:
            setattr(message, name, value)
    return message


def self_test(_):
    with answered:
        call, end = next(calls), time.time() + 10
        answers[call] = None
        say(asked=call)
        while answers[call] is None and time.time() < end:
            answered.wait(0.1)
        answer = answers.pop(call)
    if answer is None:
        raise rospy.ServiceException("csi5300-node does not answer")
    return fill(SelfTest._response_class(), answer)


def register():
    """Registers again with a restarted master; existing connections continue."""
    own = rospy.get_node_uri()
    for one in asked["write"]:
        master.registerPublisher(one["topic"], one["type"], own)
    for one in services:
        master.registerService(one.resolved_name, one.uri, own)
    for one in asked["read"]:
        found = master.registerSubscriber(one["topic"], one["type"], own)
        if found:
            ServerProxy(own).publisherUpdate("/master", one["topic"], found)


def is_known(state):
    publishing, subscribing, serving = [dict(part) for part in state]
    return (all(node in serving.get(one.resolved_name, []) for one in services)
            and all(node in publishing.get(one["topic"], []) for one in asked["write"])
            and all(node in subscribing.get(one["topic"], []) for one in asked["read"]))


def watch():
    """Joins a master and watches it."""
    connections, unknown = 0, 0
    while True:
        try:
            if not connections:
                master.getPid()
                rospy.init_node(node.rpartition("/")[2], disable_signals=True)
                for number, one in enumerate(asked["read"]):
                    rospy.Subscriber(one["topic"], kinds[one["type"]], heard, number, queue_size=64, tcp_nodelay=True)
                if asked["serves"]:
                    services.append(rospy.Service("~self_test", SelfTest, self_test))
                publishers.extend(rospy.Publisher(one["topic"], kinds[one["type"]], queue_size=64) for one in asked["write"])
                connections = 1
            unknown = 0 if is_known(master.getSystemState()) else unknown + 1
            if unknown >= 2:  # registering takes a moment
                register()
                connections, unknown = connections + 1, 0
            types = dict(master.getTopicTypes())
            wrong = [types.get(one["topic"], "*") for one in asked["read"]]
            wrong = [None if is_ in ("*", one["type"]) else "its type is %s, not %s" % (is_, one["type"])
                     for is_, one in zip(wrong, asked["read"])]
            if rospy.is_shutdown():
                say(connections=connections, trouble="this node was told to end: has another one its name?", wrong=wrong)
                os._exit(1)
            say(connections=connections, trouble=None, wrong=wrong)
        except Exception as error:
            words = "does not answer any more" if connections else "does not answer"
            say(connections=connections, trouble="the ROS master at %s %s: %s" % (uri, words, error), wrong=None)
        time.sleep(1.0 if connections else 0.5)


thread = threading.Thread(target=watch)
thread.daemon = True
thread.start()
for line in iter(sys.stdin.readline, ""):
    told = json.loads(line)
    if "answer" in told:
        with answered:
            if told["answer"] in answers:  # or it came too late
                answers[told["answer"]] = told["message"]
                answered.notify_all()
    elif told["to"] < len(publishers):
        publisher = publishers[told["to"]]
        publisher.publish(fill(publisher.data_class(), told["message"]))
time.sleep(0.2)  # rospy sends from threads of its own
rospy.signal_shutdown("the node has ended")
os._exit(0)
