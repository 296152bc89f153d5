"""Simulated rooms: :func:`simulate`."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native, _options
from ._bearing import Bearing, bearings
from ._errors import OptionError, SceneError
from ._log import Log, read


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot's log in a room, and the truth about it."""

    name: str
    mac: str
    data: bytes = field(repr=False)
    """Its log, the bytes of a ``.dat`` file."""
    path: NDArray[np.float64] | None = field(repr=False)
    """(m, 5) Positions of its antenna A: seconds on its host's clock, x, y, z (metres), heading (radians)."""
    injected: str
    """Its injected faults, as text."""

    @cached_property
    def log(self) -> Log:
        """Its log."""
        log = read(self.data)
        log.info["name"] = self.name
        return log

    @property
    def start_m(self) -> NDArray[np.float64] | None:
        """(3,) Position of its antenna A at the start, metres."""
        return None if self.path is None else self.path[0, 1:4]


@dataclass(frozen=True, eq=False)
class Room:
    """A simulated scene: its robots, in the scene's order."""

    channel: int | str
    """As :func:`csi5300.bearings` takes it: ``108``, or the centre of a wider one, ``"5510MHz"``."""
    robots: list[Robot]
    initiators: list[str]
    """Names of the initiators; the others answered."""

    def __getitem__(self, name: str) -> Robot:
        for robot in self.robots:
            if robot.name == name:
                return robot
        raise KeyError(f"no robot {name!r} in this room: {', '.join(robot.name for robot in self.robots)}")

    def __iter__(self) -> Iterator[Robot]:
        return iter(self.robots)

    def __len__(self) -> int:
        return len(self.robots)

    def true_azimuth_deg(self, tx: str, rx: str | None = None) -> float:
        """Azimuth from the mean position of ``rx`` (the first initiator) to that of ``tx``, degrees."""
        own, other = self[rx or self.initiators[0]].path, self[tx].path
        if own is None or other is None:
            raise OptionError("a scene too short for a path has no bearing")
        towards = other[:, 1:4].mean(axis=0) - own[:, 1:4].mean(axis=0)
        return float(np.degrees(np.arctan2(towards[1], towards[0])))

    def bearings(self, rx: str | None = None, **options: Any) -> list[Bearing]:
        """Bearings from ``rx`` (the first initiator) to all others, by their true paths; options as of :func:`csi5300.bearings`, with
        ``baseline`` from its log alone."""
        own = self[rx or self.initiators[0]]
        if own.path is None:
            raise OptionError("a scene too short for a path has no bearing")
        if str(options.get("antenna") or "A").upper() != "A":
            raise OptionError(f"antenna: {options['antenna']!r} is not A, which alone sends in rooms and whose paths these are")
        others = [robot for robot in self.robots if robot is not own]
        options.setdefault("channel", self.channel)
        options.setdefault("columns", "t,x,y,z,yaw")
        if options.get("baseline") is not None:
            return bearings(own.log, trajectory=own.path, **options)
        options.setdefault("rx_mac", own.mac)
        options.setdefault("tx_mac", [robot.mac for robot in others])
        options.setdefault("tx_trajectory", [_moved(robot.path, own.path[:, 0]) for robot in others])
        return bearings(own.log, [robot.log for robot in others], trajectory=own.path, **options)


def _moved(path: NDArray[np.float64] | None, seconds: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """A path with another robot's times; None of one that stands. All paths have their rows at the same true times."""
    if path is None or not np.ptp(path[:, 1:4], axis=0).any():
        return None
    return np.column_stack([seconds, path[:, 1:]])


def _json(scene: Mapping[str, Any]) -> str:
    """A scene's values, with NumPy's converted to Python's."""

    def known(value: Any) -> Any:
        if isinstance(value, (np.ndarray, np.generic)):
            return value.tolist()
        if isinstance(value, Mapping):
            return dict(value)
        raise TypeError(f"{value!r} is not a valid scene value")

    try:
        return json.dumps(scene if isinstance(scene, dict) else dict(scene), default=known, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise SceneError(f"the scene: {error}") from None


def simulate(
    scene: str | os.PathLike[str] | Mapping[str, Any],
    *,
    seed: int | None = None,
    layout: str | None = None,
) -> Room:
    """Runs a scene in memory: a ``.toml`` file, the name of a built-in one (``"lab-circle"``), or a dictionary of its values.

    ``seed`` and ``layout`` (``"wsr"``, ``"stock"``) replace the scene's. A seed gives the same bytes on any machine. Raises
    :class:`SceneError`, or its subclass :class:`SceneFileError` if the file cannot be read; :class:`OptionError`.
    """
    is_json = isinstance(scene, Mapping)
    text = _json(scene) if isinstance(scene, Mapping) else os.fspath(scene)
    number = None if seed is None else _options.whole("seed", seed, 0, 2**64 - 1)
    channel, initiators, made = _native.simulate(text, is_json, number, layout)
    robots = [Robot(r["name"], r["mac"], r["log"], r["path"], r["injected"]) for r in made]
    return Room(int(channel) if channel.isdigit() else channel, robots, [robots[number].name for number in initiators])
