"""How long `csi5300 view` takes to open captures and a large log, and to answer clicks: first clicks, and clicks when it is idle.

usage: python scripts/view_bench.py PROGRAM CAPTURES [LOG]
CAPTURES is a folder with captures, LOG a log (of 200 MB, for example from `scripts/decode_bench.sh`). Needs only Python's standard
library; the script requests data as the page's scripts do (`crates/view/page`), and asks again for an unfinished link after each event.
Limits: captures open within 1 s, each click is answered within 100 ms, a log of 200 MB opens within 3 s and 200 MB of memory.
The exit status is 1 if one is missed. Times are wall times: measure on an idle machine.
"""

import http.client
import json
import statistics
import subprocess
import sys
import time
import urllib.parse
from pathlib import Path

OPEN_S, CLICK_S, LOG_S, LOG_MB = 1.0, 0.1, 3.0, 200.0
# Links that are clicked first, each in a new process, spread over all.
FIRST_CLICKS = 7
# A link that takes longer than this has failed.
PATIENCE_S = 60


class View:
    """A program that serves the page, and the connection of a browser to it."""

    def __init__(self, program, what):
        start = time.perf_counter()
        self.process = subprocess.Popen([program, "view", str(what)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        url = self.process.stdout.readline().strip()
        if not url:
            sys.exit(f"{program} view {what} says no address")
        self.host = urllib.parse.urlsplit(url).netloc
        self.connection = http.client.HTTPConnection(self.host, timeout=PATIENCE_S)
        self.get("/", parse=False)
        self.overview = self.get("/data/overview")
        self.opened_s = time.perf_counter() - start

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.connection.close()
        self.process.terminate()
        self.process.wait()

    def get(self, path, parse=True):
        self.connection.request("GET", path)
        answer = self.connection.getresponse()
        body = answer.read()
        if answer.status != 200:
            sys.exit(f"{path}: {answer.status} {body[:200]!r}")
        return json.loads(body) if parse else body

    def events(self):
        """The stream of events, open."""
        connection = http.client.HTTPConnection(self.host, timeout=PATIENCE_S)
        connection.request("GET", "/events")
        return connection.getresponse()

    def click(self, link, events):
        """Seconds until a link can be drawn."""
        start = time.perf_counter()
        while self.get(f"/data/link/{link}").get("waiting"):
            while not events.readline().startswith(b"event: rows"):
                pass
        return time.perf_counter() - start

    def peak_mb(self):
        """Peak memory of the program so far, MB (1e6 bytes)."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1]) * 1024 / 1e6


def say(what, measured, asked, unit):
    good = measured <= asked
    print(f"{what}: {measured:.3f} {unit} (asked: {asked:g}){'' if good else ' MISSED'}")
    return good


def captures(program, folder):
    opened, first, links = [], [], 1
    number = 0
    for turn in range(FIRST_CLICKS):
        with View(program, folder) as view:
            links = len(view.overview["links"])
            number = round(turn * (links - 1) / (FIRST_CLICKS - 1))
            events = view.events()
            opened.append(view.opened_s)
            first.append(view.click(number, events))
    with View(program, folder) as view:
        events = view.events()
        for link in range(links):
            view.click(link, events)
        rest = [view.click(link, events) for link in range(links)]
    print(f"{folder}: {links} links; opened in {min(opened):.3f} to {max(opened):.3f} s, first clicks " + " ".join(f"{s * 1e3:.0f}" for s in first) + " ms")
    return all(
        [
            say("open, median", statistics.median(opened), OPEN_S, "s"),
            say("first click, median", statistics.median(first), CLICK_S, "s"),
            say("first click, worst", max(first), CLICK_S, "s"),
            say("click at rest, worst", max(rest), CLICK_S, "s"),
        ]
    )


def log(program, path):
    with View(program, path) as view:
        # The page's first requests.
        start = time.perf_counter()
        view.get("/data/log/0")
        view.get("/data/log/0/levels?columns=600")
        view.get("/data/log/0/csi?columns=600")
        view.opened_s += time.perf_counter() - start
        size = path.stat().st_size / 1e6
        good = say(f"{path.name}, {size:.0f} MB: open with what is drawn", view.opened_s, LOG_S, "s")
        good &= say("memory, peak", view.peak_mb(), LOG_MB, "MB")
        start = time.perf_counter()
        first, last = view.get("/data/log/0")["span_s"]
        third = (last - first) / 3
        view.get(f"/data/log/0/csi?columns=600&from={first + third}&to={last - third}")
        return good & say("zoom into a third", time.perf_counter() - start, CLICK_S, "s")


def main():
    program, folder, *logs = sys.argv[1:]
    program = str(Path(program).resolve())
    good = captures(program, folder)
    for path in logs:
        good &= log(program, Path(path))
    sys.exit(0 if good else 1)


main()
