"""Live records from a room that the program serves; CSI5300_PROGRAM names it."""

from __future__ import annotations

import asyncio
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import csi5300
import numpy as np
import pytest

SCENE = """
duration_s = 3.0
sounding.rate_hz = 100
[[robot]]
name = "rx"
motion.circle = { radius_m = 0.3, duration_s = 3.0 }
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
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as served:
        assert served.stderr is not None
        # It says so once it listens.
        for _ in served.stderr:
            if socket.exists():
                break
        yield f"{socket}#rx"
        served.terminate()


def test_a_served_room_is_read_to_its_end(room: str) -> None:
    logs = []
    with csi5300.Stream(room) as stream:
        for log in stream:
            logs.append(log)
            assert not np.isnat(log.host_time).any()
        info = stream.info
    assert stream.ended and info["survey"]["records"] == sum(map(len, logs)) > 100
    times = np.concatenate([log.time_us for log in logs])
    assert (np.diff(times) > 0).all()
    with pytest.raises(csi5300.LiveError, match="closed"):
        stream.read()


def test_async(room: str) -> None:
    async def count() -> int:
        with csi5300.Stream(room) as stream:
            return sum([len(log) async for log in stream])

    assert asyncio.run(count()) > 100


def test_nobody_there(tmp_path: Path) -> None:
    for room in (f"{tmp_path}/none#rx", "no-address"):
        with pytest.raises(csi5300.LiveError):
            csi5300.Stream(room)
