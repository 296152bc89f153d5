"""fastdds.py PROGRAM FOLDER PEER [HOW...]: a node with PEER (fastdds.cpp, compiled), for each HOW that it knows."""
import json, math, os, queue, signal, subprocess, sys, threading, time
from running import DOMAIN, TRUTH, add_third, folder, off, running, start, start_node, until

class Peer:
    """A Fast DDS program and its output, line by line."""
    def __init__(self, how):
        self.process = start(sys.argv[3], str(DOMAIN), how, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, stderr=open(f"{folder}/{how}.log", "w"))
        self.said, self.began = queue.Queue(), time.monotonic()
        threading.Thread(target=self.listen, daemon=True).start()

    def listen(self):
        for line in self.process.stdout:
            self.said.put(json.loads(line))
        self.said.put(None)

    def next(self, key, seconds=600, used=lambda said: True):
        """The next line that has `key` and is used."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                said = self.said.get(timeout=left)
            except queue.Empty:
                break
            assert said is not None, "it ended"
            if key in said and used(said):
                return said
        raise AssertionError(f"never: {key}")

    def tell(self, words):
        self.process.stdin.write(words + "\n")
        self.process.stdin.flush()

    def call(self, name):
        self.tell(f"call {name}")
        number = self.next("asked")["asked"]
        return self.next("answer", used=lambda said: said["answer"] == number)

    def end(self):
        """An orderly end: it announces its departure."""
        self.process.stdin.close()
        assert self.process.wait(30) == 0

def found(peer, how):
    before = until("the node answers", 30, lambda told: True)["ros2"]["subscribed"]
    until(f"odometry comes ({how})", 60, lambda told: told["ros2"]["subscribed"]["/tb3_0/odom"]["read"] > before["/tb3_0/odom"]["read"])
    taken = time.monotonic() - peer.began
    told = until("poses in fragments come", 60, lambda told: told["ros2"]["subscribed"]["/tb3_2/pose"]["read"] > before["/tb3_2/pose"]["read"])
    assert told["ros2"]["subscribed"]["/tb3_2/pose"]["unreadable"] == 0, told["ros2"]
    print(f"Fast DDS ({how}): found {taken:.1f} s after the start of its process", flush=True)

def outputs(peer):
    good = dict.fromkeys(TRUTH, 0)
    end = time.monotonic() + 600
    while min(good.values()) < 3:
        assert time.monotonic() < end, f"no bearings near the truth: {good}"
        said = peer.next("bearing")
        assert said["frame"] == "odom", said
        near = said["state"] == "bearing" and off(said["azimuth"], TRUTH[said["bearing"]]) < 1.0
        good[said["bearing"]] = good[said["bearing"]] + 1 if near else 0
    for name in TRUTH:
        said = peer.next("arrow", used=lambda said: said["arrow"] == name and off(said["azimuth"], TRUTH[name]) < 2.0)
        assert said["of"] == 5, said
    peer.next("direction", used=lambda said: off(said["direction"], TRUTH["tb3_1"]) < 2.0)
    said = peer.next("diagnostics")["diagnostics"]
    assert said == [f"csi5300_tb3_0: {part}" for part in ("card", "odometry", "peer tb3_1", "peer tb3_2", "node", "claims")], said
    peer.next("csi")
    print("  bearings of two robots (one followed by poses in fragments), markers, directions, diagnostics and CSI are correct", flush=True)

def services(peer, number):
    said = peer.call("stop_recording")
    assert said["success"] and said["message"].startswith(f"{folder}/run"), said
    assert not peer.call("stop_recording")["success"]
    said = peer.call("start_recording")
    assert said["success"] and said["message"] == f"{folder}/run-r{number}", said
    peer.tell("greedy")
    until("the mismatch is reported", 30, lambda told: any("/csi5300_tb3_0/csi: the publisher is best effort, and the subscriber asks for reliable" in w for w in told["trouble"]))
    peer.tell("modest")
    until("the mismatch is over", 30, lambda told: not any("best effort" in w for w in told["trouble"]))
    print("  services are answered, a mismatch is reported", flush=True)

def main():
    add_third()
    node = start_node("robot.toml", "node.log")
    until("the node runs", 30, lambda told: True)
    for number, how in enumerate(sys.argv[4:], 1):
        peer = Peer(how)
        found(peer, how)
        said = peer.next("node", used=lambda said: said["node"] == "/csi5300_tb3_0")
        assert said["writers"] > 8, said
        outputs(peer)
        services(peer, number)
        peer.end()
        until("it is gone", 30, lambda told: told["ros2"]["dds"]["participants"] == 0)
    told = until("the node answers", 30, lambda told: True)["ros2"]["dds"]
    assert told["malformed"] == told["unreadable"] == told["refused"] == told["unanswered"] == 0, told
    node.send_signal(signal.SIGTERM)
    assert node.wait(30) in (0, 3), open(f"{folder}/node.log").read()

with running():
    main()
