"""Live records from a room served by the program, in which two robots sound each other; CSI5300_PROGRAM names it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import csi5300
import numpy as np
import pytest

SCENE = """
duration_s = 8.0
# The program that answers takes its own time.
radio.turn_around = { median_us = 0.0, min_us = 0.0 }
[[robot]]
name = "rx"
motion.circle = { radius_m = 0.3, duration_s = 8.0 }
[[robot]]
name = "tx"
position_m = [3.0, 1.0, 0.5]
"""


@pytest.fixture
def room(tmp_path: Path) -> Iterator[str]:
    program = os.environ.get("CSI5300_PROGRAM")
    if not program:
        pytest.skip("CSI5300_PROGRAM names no csi5300")
    (tmp_path / "scene.toml").write_text(SCENE)
    socket = tmp_path / "room"
    command = [program, "simulate", str(tmp_path / "scene.toml"), "--serve", "--socket", str(socket)]
    respond = [program, "sound", "--answer", "--room", f"{socket}#tx", "--peers", "02:53:00:00:00:00"]
    sound = [program, "sound", "--room", f"{socket}#rx", "--peers", "02:53:00:00:00:01", "--alone", "--rate", "25"]
    # A shared machine is sometimes late: the slots have room.
    sound += ["--guard", "4000", "--turn-around", "8000"]
    with contextlib.ExitStack() as stack:
        served = stack.enter_context(subprocess.Popen(command, stderr=subprocess.PIPE, text=True))
        stack.callback(served.terminate)
        assert served.stderr is not None
        # It prints a line once it listens.
        for _ in served.stderr:
            if socket.exists():
                break
        for robot in (respond, sound):
            quiet = subprocess.DEVNULL
            running = stack.enter_context(subprocess.Popen(robot, stdout=quiet, stderr=quiet))
            stack.callback(running.terminate)
        yield f"{socket}#rx"


def test_options_of_a_card_are_not_ignored_with_a_room() -> None:
    for option in ({"connector_index": 26}, {"allow_user_sender": True}, {"receive_buffer": 1 << 20}):
        with pytest.raises(csi5300.OptionError, match=next(iter(option))):
            csi5300.Stream("room#rx", **option)


def test_a_served_room_is_read_to_its_end(room: str) -> None:
    logs = []
    with csi5300.Stream(room) as stream:
        for log in stream:
            logs.append(log)
            assert not np.isnat(log.host_time).any()
        info = stream.info
    assert stream.ended and info["survey"]["records"] == sum(map(len, logs)) > 10
    times = np.concatenate([log.time_us for log in logs])
    assert (np.diff(times) > 0).all()
    with pytest.raises(csi5300.LiveError, match="closed"):
        stream.read()


def test_async(room: str) -> None:
    async def count() -> int:
        with csi5300.Stream(room) as stream:
            return sum([len(log) async for log in stream])

    assert asyncio.run(count()) > 10


def test_closing_ends_other_threads_waits(room: str) -> None:
    with csi5300.Stream(room) as first:
        # Reads everything; the room's end would end the wait, so it is closed long before.
        stream = csi5300.Stream(room, macs="02:53:00:00:00:77")
        ends: list[str] = []

        def reads() -> None:
            try:
                stream.read()
            except csi5300.LiveError as error:
                ends.append(str(error))

        def iterates() -> None:
            ends.extend("a log" for _ in stream)
            ends.append("over")

        threads = [threading.Thread(target=work) for work in (reads, iterates)]
        for thread in threads:
            thread.start()
        # Counting does not need the readers' lock.
        assert stream.info["survey"]["records"] >= 0 and not stream.ended
        stream.close()
        for thread in threads:
            thread.join(timeout=60)
        assert sorted(ends) == ["over", "the stream is closed"] and not first.ended


def test_closing_ends_tasks_waits(room: str) -> None:
    async def count(stream: csi5300.Stream) -> int:
        return sum([len(log) async for log in stream])

    async def run() -> tuple[list[int], bool]:
        async with csi5300.Stream(room, macs="02:53:00:00:00:77") as stream:
            tasks = [asyncio.ensure_future(count(stream)) for _ in range(2)]
            while len(stream._waiting) < 2:
                await asyncio.sleep(0)
            stream.close()
            done = await asyncio.wait_for(asyncio.gather(*tasks), timeout=60)
        return done, stream.ended

    assert asyncio.run(run()) == ([0, 0], True)


def test_a_wait_without_frames_gives_a_hint(room: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("csi5300._stream._PATIENCE_S", 0.01)
    with csi5300.Stream(room, macs="02:53:00:00:00:77") as stream:
        closing = threading.Timer(0.3, stream.close)
        closing.start()
        with pytest.warns(UserWarning, match="doctor"), pytest.raises(csi5300.LiveError):
            stream.read()
        closing.join()


def test_nobody_there(tmp_path: Path) -> None:
    for room in (f"{tmp_path}/none#rx", "no-address"):
        with pytest.raises(csi5300.LiveError):
            csi5300.Stream(room)
