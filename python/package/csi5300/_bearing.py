"""Bearings: :func:`bearings`, :class:`Bearing`."""

from __future__ import annotations

import html
import json
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native, _options
from ._errors import LinkError, OptionError, TrajectoryError
from ._log import File, Log, _file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Source: TypeAlias = "File | Log"


class Table(Protocol):
    """A table of pandas or polars."""

    @property
    def columns(self) -> Iterable[Any]:
        """Its headings."""

    def __getitem__(self, heading: str, /) -> Any:
        """A column."""

    def __len__(self) -> int:
        """Its rows."""


Track: TypeAlias = "str | os.PathLike[str] | NDArray[np.floating[Any]] | Sequence[Sequence[float]] | Table"
"""A trajectory: a file, or an array (n, 4) of seconds, x, y, z (metres), or (n, 5) with heading (radians); any with ``columns``. A
table has the headings t, x, y and, if known, z, yaw. Masked rows are skipped."""


@dataclass(frozen=True, eq=False)
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


@dataclass(frozen=True, eq=False)
class Bearing:
    """One link's answer. False (``if bearing``) if the link has none; :attr:`error` then says why. A pickle includes everything that
    :meth:`profile` and :attr:`samples` need."""

    answer: dict[str, Any]
    """All values, by the names of ``csi5300 bearing --json``."""
    _link: _native.Link | None = field(repr=False, default=None)
    stretches: list[dict[str, Any]] = field(repr=False, default_factory=list)
    """With ``every``: each stretch of the motion alone (``from_s``, ``to_s``, seconds on the trajectory's clock, and the names of
    :attr:`answer`), and in ``carried`` its answer combined with the earlier ones."""

    def __bool__(self) -> bool:
        return self._link is not None

    def __repr__(self) -> str:
        if not self:
            return f"<Bearing {self.link}: no bearing: {self.error}>"
        mirror = "" if math.isnan(self.mirror_deg) else f" or {self.mirror_deg:.1f}"
        sure = "" if math.isnan(self.confidence) else f", p {self.confidence:.2f}"
        away = "" if math.isnan(self.range_m) else f", {self.range_m:.2f} m"
        return f"<Bearing {self.link} {self.azimuth_deg:.1f}{mirror} deg +- {self.azimuth_sd_deg:.1f}{sure}{away}>"

    def _repr_html_(self) -> str:
        known = {name: value for name, value in self.answer.items() if isinstance(value, (str, int, float)) and name != "link"}
        cells = "".join(
            f"<tr><td>{html.escape(name)}</td><td>{html.escape(f'{value:.6g}' if isinstance(value, float) else str(value))}</td></tr>"
            for name, value in known.items()
        )
        return f"<details><summary>{html.escape(repr(self))}</summary><table>{cells}</table></details>"

    @property
    def link(self) -> str:
        """The link's name: the stem of the transmitter's log."""
        return str(self.answer["link"])

    @property
    def mac(self) -> str | None:
        """The transmitter's address, if known."""
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
        """Error bar: half width that holds 68 % of errors (docs/method/accuracy.md), degrees."""
        return _number(self.answer["azimuth_sd_deg"])

    @property
    def mirror_deg(self) -> float:
        """The mirror, the other azimuth that fits motion along a line, degrees; nan if there is none."""
        return _number(self.answer["mirror_deg"])

    @property
    def elevation_deg(self) -> float:
        """With its sign, degrees; nan if the motion does not distinguish up from down."""
        return _number(self.answer["elevation_deg"])

    @property
    def abs_elevation_deg(self) -> float:
        """Magnitude of the elevation, degrees; nan if none was searched, as for motion along a line."""
        return _number(self.answer["abs_elevation_deg"])

    @property
    def confidence(self) -> float:
        """Probability that the azimuth is within 5 degrees, 0 to 1; nan if nothing was fitted."""
        return _number(self.answer["confidence"])

    @property
    def range_m(self) -> float:
        """Metres from the middle of the motion; nan if the wave front's curvature does not determine it."""
        return _number(self.answer["range_m"])

    def _held(self) -> _native.Link:
        if self._link is None:
            raise LinkError(f"{self.link}: no bearing: {self.error}")
        return self._link

    def profile(
        self, azimuth: int | ArrayLike = 360, elevation: int | ArrayLike | None = None
    ) -> Profile:
        """The evidence over directions.

        ``azimuth`` and ``elevation`` are numbers of even steps (around the circle from -180 degrees; from -90 to 90, with a single step
        on the horizon), or arrays of degrees; all azimuths are combined with each elevation. Without ``elevation``: the horizon. Raises
        :class:`LinkError` without a bearing, :class:`OptionError` for values that are neither whole numbers nor arrays.
        """
        link = self._held()
        columns, rows = _angles("azimuth", azimuth), _angles("elevation", 1 if elevation is None else elevation)
        if isinstance(columns, int) and isinstance(rows, int):
            return Profile(*link.profile(columns, rows, None))
        around = -180 + 360 / columns * np.arange(columns) if isinstance(columns, int) else columns
        if isinstance(rows, int):
            up = np.linspace(-90, 90, rows) if rows > 1 else np.zeros(1)
        else:
            up = rows
        pairs = [part.ravel() for part in np.meshgrid(around, up)]
        parts = link.profile(0, 0, np.ascontiguousarray(np.stack(pairs, axis=1)))
        shape = (up.size, around.size)
        return Profile(*(part.reshape(shape) for part in parts))

    @cached_property
    def samples(self) -> dict[str, NDArray[Any]]:
        """The input of the bearing: ``t_s`` (n), ``z`` (n) complex, ``receiver_m`` (n, 3); ``path_m`` (m, 3), the receiver's whole
        path; ``phase`` (k, 4): seconds, and radians one way, round trip, and compensated;
        ``range_change`` (m, 3), if requested: seconds, metres since the first exchange, and their deviation."""
        return self._held().samples()

    def plot(self, *, truth_deg: float | None = None) -> Figure:
        """Profile with the answer (and ``truth_deg``, degrees) marked, and the path with the bearing; needs matplotlib."""
        from . import plot

        return plot.bearing(self, truth_deg=truth_deg)

    def __getstate__(self) -> dict[str, Any]:
        link = None if self._link is None else self._link.dump()
        return {"answer": self.answer, "link": link, "stretches": self.stretches}

    def __setstate__(self, state: dict[str, Any]) -> None:
        link = None if state["link"] is None else _native.Link.restore(*state["link"])
        self.__dict__.update(answer=state["answer"], _link=link, stretches=state["stretches"])


def _angles(name: str, given: Any) -> int | NDArray[np.float64]:
    """A number of steps, or degrees."""
    try:
        degrees = None if np.ndim(given) == 0 else np.asarray(given, np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise OptionError(f"{name}: {error}: a number of steps, or an array of degrees") from None
    if degrees is None:
        return _options.whole(name, given, 1)
    if not degrees.size:
        raise OptionError(f"{name}: no direction")
    return degrees


def read_trajectory(path: str | os.PathLike[str], *, columns: str | None = None) -> NDArray[np.float64]:
    """A trajectory file (docs/reference/formats.md) as an array (n, 5): seconds, x, y, z (metres), heading (radians, nan).

    ``columns`` names the columns instead of the file's headings: ``"t,x,y,yaw"``.

    Raises :class:`TrajectoryError`; if the file cannot be read, its subclass :class:`TrajectoryFileError`.
    """
    return _native.read_trajectory(path, columns)


def _source(log: Source) -> Any:
    return log._held() if isinstance(log, Log) else _file(log)


def _logs(tx: Source | Sequence[Source]) -> list[Source]:
    alone: Any = tx
    one = isinstance(tx, (str, os.PathLike, bytes, bytearray, memoryview, Log)) or hasattr(tx, "read")
    return [alone] if one else list(alone)


def _by_headings(name: str, table: Any) -> list[Any]:
    """The columns of a table (pandas, polars) in the order of arrays, by their headings."""
    headings = [str(heading) for heading in table.columns]
    if not {"t", "x", "y"} <= set(headings) <= {"t", "x", "y", "z", "yaw"} or len(set(headings)) < len(headings):
        words = f"a table with the headings {', '.join(headings)}: name them t, x, y, z, yaw (seconds, metres, radians)"
        raise TrajectoryError(f"{name}: {words}, or give their order as columns=")
    columns: list[Any] = [np.asarray(table[own]) if own in headings else np.zeros(len(table)) for own in ("t", "x", "y", "z")]
    if columns[0].dtype.kind == "M":
        columns[0] = (columns[0] - np.datetime64(0, "s")) / np.timedelta64(1, "s")
    if "yaw" in headings:
        # With nanoseconds, as in files: nobody can take x for these.
        columns = [columns[0], np.zeros(len(table)), *columns[1:], np.asarray(table["yaw"])]
    return list(zip(*columns, strict=True))


def _track(name: str, track: Track, named: bool) -> Any:
    if isinstance(track, (str, os.PathLike)):
        return track
    if isinstance(track, np.ma.MaskedArray):
        # What is under a mask is no measurement: such rows are skipped.
        track = np.ma.filled(track.astype(np.float64), np.nan)
    elif not named and any(isinstance(heading, str) for heading in getattr(track, "columns", ())):
        track = _by_headings(name, track)
    needed = "a path, or rows of 4 or 5 numbers: seconds, x, y, z (metres), heading (radians), or others that columns= names"
    try:
        rows = np.asarray(track, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TrajectoryError(f"{name}: {error}: {needed}") from None
    if rows.ndim != 2:
        what = "None" if track is None else f"an array of shape {rows.shape}"
        raise TrajectoryError(f"{name}: {what} is not a trajectory: {needed}")
    return np.ascontiguousarray(rows)


def _tracks(tracks: Any) -> list[Any]:
    """One trajectory, or a list with one for each transmitter."""
    alone = isinstance(tracks, (str, os.PathLike)) or (not isinstance(tracks, (list, tuple)) and np.ndim(tracks) == 2)
    return [tracks] if alone else list(() if tracks is None else tracks)


def _is_given(value: Any) -> bool:
    plain = _options.plain(value)
    return not (plain is None or plain is False or (hasattr(plain, "__len__") and len(plain) == 0))


def _name(log: Source, index: int) -> str:
    if isinstance(log, (str, os.PathLike)):
        return Path(log).stem
    return Path(log.name).stem if isinstance(log, Log) else f"tx{index + 1}"


def _baselines(baseline: Any) -> list[list[float]]:
    try:
        rows = [baseline] if np.ndim(baseline[0]) == 0 else baseline
        return [[float(value) for value in row] for row in rows]
    except (TypeError, ValueError, IndexError, KeyError) as error:
        raise OptionError(f"baseline: {error}: three numbers, metres, or a list of such") from None


def bearings(
    rx: Source,
    tx: Source | Sequence[Source] | None = None,
    *,
    trajectory: Track,
    channel: int | str,
    tx_trajectory: Track | Sequence[Track | None] | None = (),
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
    columns: str | None = None,
    min_confidence: float | None = None,
    every: float | None = None,
    explain: bool = False,
    range_change: bool = False,
    fit: str | None = None,
    key: str | os.PathLike[str] | None = None,
    tx_mac: str | Iterable[str] | None = None,
    rx_mac: str | None = None,
    threads: int = 0,
    antennas: str | Iterable[str] | None = None,
    baseline: Sequence[float] | Sequence[Sequence[float]] | None = None,
) -> list[Bearing]:
    """Bearings from the receiver, whose ``trajectory`` is given, to each transmitter, in the order of ``tx``.

    Logs are paths, bytes, file objects or :class:`Log`. Options are those of ``csi5300 bearing``, with the same names and units
    (``from_`` for ``--from``). ``antenna_offset`` is the antenna's position relative to the tracked point: metres forward, left, up.
    With ``camera_mount`` (metres forward and left of the middle between the wheels, and heading minus the robot's, degrees) the
    trajectory is a tracking camera's. It is then reduced to what wheels can roll, and the antenna's position is relative to that
    middle. ``columns`` (``"t,x,y,yaw"``) names the columns of trajectory files and arrays. ``decimate`` uses every n-th pair of
    frames, as slower sounding would give. ``every`` (seconds) fills :attr:`Bearing.stretches`, ``explain`` ``answer["plan"]``,
    ``range_change`` ``answer["range_change"]`` and an array of :attr:`Bearing.samples`. ``fit="odometry"`` corrects the trajectory
    by the phases of all links first: ``answer["odometry_fit"]``. ``heading_sd`` (degrees) is the deviation of the trajectory's heading:
    arrays, and files that name no sensor, count as motion capture (0.3); a tracking camera has 4, wheels 20, or 1.5 with
    ``antenna_offset``. A link without a bearing is in the list, is False, and has an :attr:`Bearing.error`. The same applies to a
    link whose probability of being within 5 degrees is below ``min_confidence`` or unknown.

    Without ``tx``: the bearing to every sender in ``rx``, from two or three ``antennas`` (``"AB"``) of one robot that turns.
    ``baseline`` is the first antenna's position relative to the second, metres forward, left, up; for three antennas a list of two.
    After the metres may follow the constant of the chains and its deviation, degrees, from an earlier turn
    (``answer["chain_constants_deg"]``): with it a stationary robot has a bearing, too.

    Raises :class:`LogError`, :class:`TrajectoryError`, :class:`OptionError`, whose message names the argument.
    """
    options = dict(locals())
    for name in ("rx", "tx", "trajectory", "tx_trajectory", "antennas", "baseline"):
        del options[name]
    if baseline is not None:
        of_two: dict[str, Any] = {"tx": tx, "tx_trajectory": tx_trajectory, "antenna": antenna, "rx_mac": rx_mac, "key": key}
        of_two |= {"camera_mount": camera_mount, "explain": explain, "every": every, "fit": fit}
        of_two |= {"range_change": range_change, "range_min": range_min, "no_compensation": no_compensation}
        of_two["without"] = set(_options.texts("without", without or ())) - {"elevation", "near-field"}
        wrong = [name for name, value in of_two.items() if _is_given(value)]
        if wrong:
            raise OptionError(f"{wrong[0]}: not allowed with baseline, which uses one robot's own log")
        letters = _options.letters(antennas) or "AB"
        own = _track("trajectory", trajectory, columns is not None)
        found = _native.one_log(_source(rx), _name(rx, 0), own, letters, _baselines(baseline), _options.keywords(options))
        return [Bearing(json.loads(answer), link) for answer, link, _ in found]
    if antennas is not None:
        raise OptionError("antennas: needs baseline, which gives their positions")
    logs = [] if tx is None else _logs(tx)
    if not logs:
        raise OptionError("tx: name the other robot's log; for a bearing from one log, give antennas and baseline")
    tracks = _tracks(tx_trajectory)
    if len(tracks) > len(logs):
        raise OptionError("tx_trajectory: more than tx")
    names = [_name(log, index) for index, log in enumerate(logs)]
    moved = [None if track is None else _track("tx_trajectory", track, columns is not None) for track in tracks]
    own = _track("trajectory", trajectory, columns is not None)
    sources = [_source(log) for log in logs]
    found = _native.bearings(_source(rx), sources, names, own, moved, _options.keywords(options))
    return [Bearing(json.loads(answer), link, [json.loads(one) for one in own]) for answer, link, own in found]
