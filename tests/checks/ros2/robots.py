"""robots.py DOMAIN: two robots on circles, and a stationary one; their poses depend only on the time."""
import math, sys, time
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from types_ros2 import Header, Odometry, Point, Pose, PoseStamped, PoseWithCovariance, Quaternion, Time

def stand(x, y, heading):
    return Pose(Point(x, y, 0.0), Quaternion(0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2)))

participant = DomainParticipant(int(sys.argv[1]))
usual = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(10))
sensor = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(5))
circles = [("tb3_0", 0.0, 0.0, 0.3, 0.7, usual), ("tb3_1", 24.0, 10.0, 0.25, -0.4, sensor)]
writers = [DataWriter(participant, Topic(participant, f"rt/{name}/odom", Odometry), qos=qos) for name, *_, qos in circles]
mocap = DataWriter(participant, Topic(participant, "rt/tb3_2/pose", PoseStamped), qos=usual)
while True:
    now = time.time()
    stamp = Time(int(now), int(now % 1 * 1e9))
    for writer, (name, x, y, radius, rate, _) in zip(writers, circles):
        angle = rate * now % (2 * math.pi)
        pose = stand(x + radius * math.cos(angle), y + radius * math.sin(angle), angle + math.copysign(math.pi / 2, rate))
        writer.write(Odometry(Header(stamp, "odom"), f"{name}/base_footprint", PoseWithCovariance(pose)))
    mocap.write(PoseStamped(Header(Time(), "world"), stand(-14.0, 16.0, 0.3)))
    time.sleep(0.02)
