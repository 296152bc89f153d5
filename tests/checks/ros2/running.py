"""Runs a ROS 2 node in the simulated room, for check.py and fastdds.py; both are called with PROGRAM FOLDER."""
import contextlib, json, math, os, random, socket, subprocess, sys, time

csi5300, folder = os.path.abspath(sys.argv[1]), os.path.abspath(sys.argv[2])
here = os.path.dirname(os.path.abspath(__file__))
# Its ports are below those that the system assigns.
DOMAIN = random.randrange(10, 100)
# Relative to tb3_0, as in robots.py and fastdds.cpp.
TRUTH = {"tb3_1": math.atan2(10.0, 24.0), "tb3_2": math.atan2(16.0, -14.0)}
started = []

def start(*words, **more):
    process = subprocess.Popen(words, **{"stdin": subprocess.DEVNULL, **more})
    started.append(process)
    return process

def state():
    with socket.socket(socket.AF_UNIX) as s:
        s.settimeout(100)
        s.connect(f"{folder}/status.sock")
        return json.loads(s.makefile().readline())

def until(what, seconds, condition):
    # A busy machine needs longer.
    end = time.monotonic() + 10 * seconds
    while True:
        try:
            told = state()
            if condition(told):
                return told
        except (OSError, json.JSONDecodeError):
            told = None
        assert time.monotonic() < end, f"never: {what}: {json.dumps(told and {k: told[k] for k in ('trouble', 'odometry', 'ros2', 'poses')})}"
        time.sleep(0.1)

def start_node(config, log):
    return start(csi5300, "node", "--config", f"{folder}/{config}", stdout=subprocess.DEVNULL, stderr=open(f"{folder}/{log}", "w"),
                 env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)})

def add_third():
    """Adds a robot that motion capture follows to the configuration of examples/ros2."""
    with open(f"{folder}/room.toml", "a") as room:
        room.write('[[robot]]\nname = "tb3_2"\nposition_m = [-14.0, 16.0, 0.0]\nantenna_m = [-0.03, 0.0, 0.20]\nmotion.followed = {}\n')
    text = open(f"{folder}/robot.toml").read()
    text = text.replace('[[peer]]', 'tb3_2.ros2 = { topic = "/tb3_2/pose", type = "pose" }\n\n[[peer]]', 1)
    text = text.replace("[ros2]\n", f'[[peer]]\nname = "tb3_2"\nrecords.room = {{}}\nposes.room = {{}}\nantenna_offset_m = [-0.03, 0.0, 0.20]\n\n[ros2]\nbag = "run"\n')
    open(f"{folder}/robot.toml", "w").write(text)

def add_team():
    """Asks for the graph of the team, with ranges to both peers."""
    with open(f"{folder}/robot.toml", "a") as robot:
        robot.write('[team]\n' + "".join(f'ranges.{peer} = {{ topic = "/uwb/{peer}" }}\n' for peer in TRUTH))

def followed(told):
    return told["odometry"]["followed"]["poses"]

def off(radians, truth):
    return abs(math.degrees((radians - truth + math.pi) % (2 * math.pi) - math.pi))

@contextlib.contextmanager
def running():
    """Ends all started processes; after a failure prints their logs."""
    try:
        yield
    except BaseException:
        for name in os.listdir(folder):
            if name.endswith(".log"):
                print(f"{name}:\n{open(f'{folder}/{name}').read()[-2000:]}")
        raise
    finally:
        for process in started:
            if process.poll() is None:
                process.kill()
                process.wait()
