"""Python has every option of the command line; positions of antenna and camera on the robot."""

from __future__ import annotations

import inspect
import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import csi5300
import numpy as np
import pytest
from conftest import CIRCLE, STAMP
from numpy.typing import NDArray

Poses = NDArray[np.float64]
OUTPUT = {"bag", "color", "help", "json", "quiet", "verbose", "force", "profile", "grid", "plot"}
OUTPUT |= {"place", "transmitters", "frame", "stretches", "ranges", "factors"}
"""Options about recordings, printing and pictures, for which Python has arrays, attributes and methods; and options of captures."""
OFFSET, MOUNT = (0.05, 0.16, 0.0), (0.04, 0.17, -1.5)


@pytest.fixture
def program() -> str:
    program = os.environ.get("CSI5300_PROGRAM")
    if not program:
        pytest.skip("CSI5300_PROGRAM names no csi5300")
    return program


def _options(program: str, command: str) -> set[str]:
    said = subprocess.run([program, command, "--help"], capture_output=True, text=True, check=True).stdout
    return set(re.findall(r"^\s+(?:-\w, )?--([a-z-]+)", said, re.MULTILINE))


def test_bearings_has_every_option_of_the_command_line(program: str) -> None:
    theirs = {name.replace("-", "_") for name in _options(program, "bearing") - OUTPUT}
    ours = {name.rstrip("_") for name in inspect.signature(csi5300.bearings).parameters}
    assert len(theirs) > 15 and theirs <= ours, theirs - ours


def _camera(path_csv: Path) -> Poses:
    """The fixture's circle with headings along it, and a sideways drift of positions."""
    track = csi5300.read_trajectory(path_csv)
    steps = np.gradient(track[:, 1:3], axis=0)
    moving = np.hypot(*steps.T) > 1e-6
    heading = np.interp(track[:, 0], track[moving, 0], np.unwrap(np.arctan2(steps[moving, 1], steps[moving, 0])))
    drift = 0.01 * np.stack([-np.sin(heading), np.cos(heading)], axis=1) * (track[:, :1] - track[0, 0])
    return np.column_stack([track[:, 0], track[:, 1:3] + drift, track[:, 3], np.angle(np.exp(1j * heading))])


def _turned(heading: NDArray[np.float64], forward: float, left: float) -> Poses:
    sin, cos = np.sin(heading), np.cos(heading)
    return np.stack([cos * forward - sin * left, sin * forward + cos * left], axis=1)


def _antenna(camera: Poses, mount: tuple[float, ...] | None, offset: tuple[float, ...]) -> Poses:
    """The antenna's path, step by step."""
    own = camera.copy()
    if mount is not None:
        own[:, 4] -= np.radians(mount[2])
        own[:, 1:3] -= _turned(own[:, 4], mount[0], mount[1])
        for k in range(len(own) - 1, 0, -1):
            middle = own[k - 1, 4] + np.angle(np.exp(1j * (own[k, 4] - own[k - 1, 4]))) / 2
            along = np.array([np.cos(middle), np.sin(middle)])
            own[k, 1:3] = along * ((own[k, 1:3] - own[k - 1, 1:3]) @ along)
        own[:, 1:3] = np.cumsum(own[:, 1:3], axis=0)
    own[:, 1:3] += _turned(own[:, 4], offset[0], offset[1])
    own[:, 3] += offset[2]
    return own


@pytest.mark.parametrize("mount", [None, MOUNT])
def test_the_antenna_is_at_the_given_offset(rx: Path, tx: Path, path_csv: Path, mount: tuple[float, ...] | None) -> None:
    camera = _camera(path_csv)
    common: dict[str, Any] = {"channel": 108, "without": "near-field"}
    (said,) = csi5300.bearings(rx, tx, trajectory=camera, antenna_offset=OFFSET, camera_mount=mount, **common)
    (by_hand,) = csi5300.bearings(rx, tx, trajectory=_antenna(camera, mount, OFFSET), **common)
    (bare,) = csi5300.bearings(rx, tx, trajectory=camera, **common)
    assert said.azimuth_deg == pytest.approx(by_hand.azimuth_deg, abs=1e-4)
    assert abs(said.azimuth_deg - bare.azimuth_deg) > 0.01 or said.azimuth_sd_deg != bare.azimuth_sd_deg


def test_invalid_mounts_are_refused(rx: Path, tx: Path, path_csv: Path) -> None:
    def run(**options: Any) -> None:
        csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, **options)

    for options, word in (
        ({"camera_mount": MOUNT}, "antenna_offset"),
        ({"camera_mount": (0, 0), "antenna_offset": OFFSET}, "camera_mount"),
        ({"antenna_offset": (0, float("nan"), 0)}, "antenna_offset"),
        ({"accuracy": 181}, "accuracy"),
        ({"min_confidence": 2}, "min_confidence"),
        ({"every": 0}, "every"),
        ({"every": 1, "join_rows": True}, "every"),
    ):
        with pytest.raises(csi5300.OptionError, match=word):
            run(**options)
    with pytest.raises(csi5300.TrajectoryError, match="heading"):
        run(antenna_offset=OFFSET)


def test_stretches_refusals_and_plans(rx: Path, tx: Path, path_csv: Path) -> None:
    common: dict[str, Any] = {"trajectory": path_csv, "channel": 108}
    (bearing,) = csi5300.bearings(rx, tx, every=1.0, explain=True, accuracy=0, **common)
    (plain,) = csi5300.bearings(rx, tx, **common)
    assert len(bearing.stretches) >= 2 and plain.stretches == [] and "plan" not in plain.answer
    assert all(a["to_s"] <= b["from_s"] + 1e-9 for a, b in zip(bearing.stretches, bearing.stretches[1:], strict=False))
    assert bearing.answer["carried"] and bearing.answer["plan"]
    (sure,) = csi5300.bearings(rx, tx, min_confidence=0.0, **common)
    (refused,) = csi5300.bearings(rx, tx, min_confidence=1.0, **common)
    assert sure and sure.azimuth_deg == plain.azimuth_deg
    assert not refused and refused.error and "refused" in refused.error and np.isnan(refused.azimuth_deg)


def test_captures_use_the_mount(tmp_path: Path, path_csv: Path) -> None:
    shutil.copytree(CIRCLE, tmp_path / "tree")
    camera = _camera(path_csv)
    rows = np.column_stack([camera[:, 0], np.zeros(len(camera)), camera[:, 1:]])
    np.savetxt(tmp_path / "tree" / f"t265_rx_trajectory_{STAMP}_.csv", rows, fmt="%.9f", delimiter=",")
    options: dict[str, Any] = {"antenna_offset": OFFSET, "camera_mount": MOUNT, "without": "near-field"}
    (row,) = csi5300.evaluate(tmp_path / "tree", trajectory="t265", **options)
    rx, tx = (tmp_path / "tree" / f"csi_{side}_{STAMP}.dat" for side in ("rx", "tx1"))
    (by_hand,) = csi5300.bearings(rx, tx, trajectory=_antenna(camera, MOUNT, OFFSET), channel=108, without="near-field")
    assert row["azimuth_deg"] == pytest.approx(by_hand.azimuth_deg, abs=1e-3)
    swept = csi5300.evaluate(tmp_path / "tree", trajectory="t265", sweep={"antenna_offset": [OFFSET, (0.0, 0.0, 0.0)]}, **{
        name: value for name, value in options.items() if name != "antenna_offset"
    })
    assert swept.rows[0]["azimuth_deg"] == row["azimuth_deg"] != swept.rows[1]["azimuth_deg"]
    for trajectory, wrong, word in (
        ("gt", {"camera_mount": MOUNT, "antenna_offset": OFFSET}, "tracking camera"),
        ("t265", {"camera_mount": MOUNT}, "antenna_offset"),
        ("gt", {"every": 1.0}, "every"),
    ):
        with pytest.raises(csi5300.OptionError, match=word):
            csi5300.evaluate(tmp_path / "tree", trajectory=trajectory, **wrong)


def test_mounted_captures_give_the_programs_numbers(captures: Path, program: str) -> None:
    if not (captures / "wsr").is_dir():
        pytest.skip("no captures of the WSR data set")
    numbers = [",".join(str(number) for number in numbers) for numbers in (MOUNT, OFFSET)]
    options = ["--trajectory", "t265", "--camera-mount", numbers[0], "--antenna-offset", numbers[1]]
    said = subprocess.run([program, "evaluate", captures / "wsr", "--json", *options], capture_output=True, text=True, check=False)
    theirs = [json.loads(line) for line in said.stdout.splitlines()[:-1]]
    ours = csi5300.evaluate(captures / "wsr", trajectory="t265", camera_mount=MOUNT, antenna_offset=OFFSET)
    assert len(ours) == len(theirs) > 30
    assert [row["azimuth_deg"] for row in ours] == [row["azimuth_deg"] for row in theirs]
