"""Bearings: :func:`bearings`, :class:`Bearing`."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._errors import LinkError, OptionError
from ._log import File, Log, _file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Source: TypeAlias = "File | Log"
Track: TypeAlias = "str | os.PathLike[str] | NDArray[np.floating[Any]] | Sequence[Sequence[float]]"
"""A trajectory: a CSV file, or an array (n, 4) of seconds, x, y, z (metres), or (n, 5) with heading (radians)."""


@dataclass(frozen=True)
class Profile:
    """Evidence over directions: ``|sum z a|^2 / (sum |z|)^2``, 0 to 1."""

    azimuth_deg: NDArray[np.float64]
    """(rows, columns) from +x towards +y of the trajectory's frame."""
    elevation_deg: NDArray[np.float64]
    """(rows, columns) from the xy plane upwards."""
    value: NDArray[np.float64]
    """(rows, columns)."""


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


@dataclass(frozen=True)
class Bearing:
    """One link's answer. False (``if bearing``) where the link has none; :attr:`error` then says why."""

    answer: dict[str, Any]
    """Everything, by the names of ``csi5300 bearing --json``."""
    _link: _native.Link | None = field(repr=False, default=None)
    stretches: list[dict[str, Any]] = field(repr=False, default_factory=list)
    """With ``every``: each stretch of the motion by itself (``from_s``, ``to_s``, seconds on the trajectory's clock, and the names
    of :attr:`answer`), and in ``carried`` what it and those before it give together."""

    def __bool__(self) -> bool:
        return self._link is not None

    @property
    def link(self) -> str:
        """The link's name: the stem of the transmitter's log."""
        return str(self.answer["link"])

    @property
    def mac(self) -> str | None:
        """The transmitter's address, where known."""
        mac: str | None = self.answer["mac"]
        return mac

    @property
    def error(self) -> str | None:
        """Why there is no bearing."""
        return self.answer.get("error")

    @property
    def azimuth_deg(self) -> float:
        """Towards the transmitter, from +x towards +y of the trajectory's frame, degrees; nan without a bearing."""
        return _number(self.answer["azimuth_deg"])

    @property
    def azimuth_sd_deg(self) -> float:
        """Error bar: 68 % of errors within it, 95 % within twice (docs/accuracy.md), degrees."""
        return _number(self.answer["azimuth_sd_deg"])

    @property
    def mirror_deg(self) -> float:
        """The other azimuth that fits motion along a line, degrees; nan where there is none."""
        return _number(self.answer["mirror_deg"])

    @property
    def elevation_deg(self) -> float:
        """With its sign, degrees; nan where the motion does not distinguish up from down."""
        return _number(self.answer["elevation_deg"])

    @property
    def abs_elevation_deg(self) -> float:
        """Magnitude of the elevation, degrees."""
        return _number(self.answer["abs_elevation_deg"])

    @property
    def confidence(self) -> float:
        """Probability that the azimuth is within 5 degrees, 0 to 1; nan where nothing was fitted."""
        return _number(self.answer["confidence"])

    @property
    def range_m(self) -> float:
        """Metres from the middle of the motion; nan where the wave front's curvature does not fix it."""
        return _number(self.answer["range_m"])

    def _held(self) -> _native.Link:
        if self._link is None:
            raise LinkError(f"{self.link}: no bearing: {self.error}")
        return self._link

    def profile(
        self, azimuth: int | ArrayLike = 360, elevation: int | ArrayLike | None = None
    ) -> Profile:
        """The evidence over directions.

        ``azimuth`` and ``elevation`` are numbers of even steps (around the circle from -180 degrees; from -90 to 90), or arrays of
        degrees, all azimuths for each elevation. Without ``elevation``: the horizon. Raises :class:`LinkError` without a bearing.
        """
        link = self._held()
        if isinstance(azimuth, int) and (elevation is None or isinstance(elevation, int)):
            if azimuth < 1 or (elevation is not None and elevation < 1):
                raise OptionError("azimuth, elevation: at least 1 step")
            return Profile(*link.profile(azimuth, elevation or 1, None))
        around = -180 + 360 / azimuth * np.arange(azimuth) if isinstance(azimuth, int) else np.asarray(azimuth, np.float64)
        if elevation is None:
            up = np.zeros(1)
        else:
            up = np.linspace(-90, 90, elevation) if isinstance(elevation, int) else np.asarray(elevation, np.float64)
        pairs = [part.ravel() for part in np.meshgrid(around.ravel(), up.ravel())]
        parts = link.profile(0, 0, np.ascontiguousarray(np.stack(pairs, axis=1)))
        shape = (up.size, around.size)
        return Profile(*(part.reshape(shape) for part in parts))

    @cached_property
    def samples(self) -> dict[str, NDArray[Any]]:
        """What the bearing was made of: ``t_s`` (n), ``z`` (n) complex, ``receiver_m`` (n, 3); ``path_m`` (m, 3) the receiver's whole
        path; ``phase`` (k, 4): seconds, and radians one way, round trip, and compensated."""
        return self._held().samples()

    def plot(self) -> Figure:
        """Profile with the answer marked, and the path with the bearing; needs matplotlib."""
        from . import plot

        return plot.bearing(self)


def read_trajectory(path: str | os.PathLike[str]) -> NDArray[np.float64]:
    """A trajectory file (CSV with 5, 6, 9 or 15 columns) as an array (n, 5): seconds, x, y, z (metres), heading (radians, nan)."""
    return _native.read_trajectory(path)


def _source(log: Source) -> Any:
    return log._held() if isinstance(log, Log) else _file(log)


def _logs(tx: Source | Sequence[Source]) -> list[Source]:
    alone: Any = tx
    one = isinstance(tx, (str, os.PathLike, bytes, bytearray, memoryview, Log)) or hasattr(tx, "read")
    return [alone] if one else list(alone)


def _track(track: Track) -> Any:
    if isinstance(track, (str, os.PathLike)):
        return track
    return np.ascontiguousarray(track, dtype=np.float64)


def _name(log: Source, index: int) -> str:
    if isinstance(log, (str, os.PathLike)):
        return Path(log).stem
    return Path(log.name).stem if isinstance(log, Log) else f"tx{index + 1}"


def _keywords(options: dict[str, Any]) -> str:
    """Options as the native half takes them: what is None is as by default."""
    given = {name: value for name, value in options.items() if value is not None}
    for name in ("without", "tx_mac"):
        if isinstance(given.get(name), str):
            given[name] = [given[name]]
        elif name in given:
            given[name] = list(given[name])
    for name in ("antenna_offset", "camera_mount"):
        if name in given:
            given[name] = [float(number) for number in given[name]]
    if "channel" in given:
        given["channel"] = str(given["channel"])
    if "key" in given:
        given["key"] = os.fspath(given["key"])
    try:
        return json.dumps(given)
    except (TypeError, ValueError) as error:
        raise OptionError(f"options: {error}") from None


def bearings(
    rx: Source,
    tx: Source | Sequence[Source],
    *,
    trajectory: Track,
    channel: int | str,
    tx_trajectory: Sequence[Track | None] = (),
    antenna: str | None = None,
    clock_offset: float | None = None,
    elevation_max: float | None = None,
    no_compensation: bool = False,
    without: str | Iterable[str] | None = None,
    accuracy: float | None = None,
    range_min: float | None = None,
    height: float | None = None,
    heading_sd: float | None = None,
    from_: float | None = None,
    to: float | None = None,
    decimate: int | None = None,
    join_rows: bool = False,
    antenna_offset: Sequence[float] | None = None,
    camera_mount: Sequence[float] | None = None,
    min_confidence: float | None = None,
    every: float | None = None,
    explain: bool = False,
    key: str | os.PathLike[str] | None = None,
    tx_mac: str | Iterable[str] | None = None,
    rx_mac: str | None = None,
    threads: int = 0,
) -> list[Bearing]:
    """Bearings from the receiver, whose ``trajectory`` it is, to each transmitter, in the order of ``tx``.

    Logs are paths, bytes, file objects or :class:`Log`. Options are those of ``csi5300 bearing`` under the same names and in the same
    units (``from_`` for ``--from``). ``antenna_offset`` is where the antenna is seen from what the trajectory is of: metres forward,
    left, up; with ``camera_mount`` (metres forward and left of the middle between the wheels, and heading less the robot's, degrees)
    the trajectory is a tracking camera's, is held to what wheels can roll, and the antenna is seen from that middle. ``decimate`` uses
    every so manieth pair of frames, what slower sounding would give. ``every`` (seconds) fills :attr:`Bearing.stretches`, ``explain`` ``answer["plan"]``. A link without a bearing is in the list, is False, and has its
    :attr:`Bearing.error`; so is one whose probability of being within 5 degrees is below ``min_confidence``, or not known.

    Raises :class:`LogError`, :class:`TrajectoryError`, :class:`OptionError`.
    """
    options = dict(locals())
    for name in ("rx", "tx", "trajectory", "tx_trajectory"):
        del options[name]
    logs = _logs(tx)
    if not logs:
        raise OptionError("tx: at least one log of a transmitter")
    if len(tx_trajectory) > len(logs):
        raise OptionError("tx_trajectory: more than tx")
    names = [_name(log, index) for index, log in enumerate(logs)]
    tracks = [None if track is None else _track(track) for track in tx_trajectory]
    found = _native.bearings(
        _source(rx), [_source(log) for log in logs], names, _track(trajectory), tracks, _keywords(options)
    )
    return [Bearing(json.loads(answer), link, [json.loads(one) for one in own]) for answer, link, own in found]
