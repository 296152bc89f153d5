"""Evaluates captures against their truth: :func:`evaluate`."""

from __future__ import annotations

import html
import itertools
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _native, _options
from ._errors import Error, OptionError, OptionFileError
from ._tables import module

if TYPE_CHECKING:
    import pandas
    import polars
    import pyarrow
    import ray.data

TEXTS = ("capture", "error", "link", "mac")
"""Columns that are not numbers."""


SHOWN = ("link", "azimuth_deg", "azimuth_sd_deg", "confidence", "error_from_mean_pose_deg", "mirror_deg", "error")
"""The most important columns."""
MOST_SHOWN = 100
"""Rows shown in a notebook."""


@dataclass(frozen=True)
class Capture:
    """One run below a folder: listed by :func:`find`, evaluated by :func:`one`."""

    place: str
    stamp: str
    folder: str
    transmitters: list[tuple[str, str]]
    loose: tuple[str, str] | None = None
    """The receiver's log and trajectory, if their names are not the usual ones."""

    @property
    def name(self) -> str:
        """Its folder relative to the evaluated one, and its time stamp; of files without usual names the folder's name."""
        return "/".join(part for part in (self.place, self.stamp) if part) or os.path.basename(os.path.abspath(self.folder))


@dataclass
class Evaluation:
    """Rows of an evaluation, one per link (and set of options), in the order of the captures."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    """By the names of ``csi5300 evaluate --json``; a failed capture or link has its ``error``."""
    notes: list[str] = field(default_factory=list)
    """What was lost or skipped in the logs, a line each."""
    lost: bool = False
    """True if something was lost in a log, a folder could not be read, or a link failed."""

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return iter(self.rows)

    def __repr__(self) -> str:
        every = self.summary()["all"]
        lost = "; something was lost, see .notes" if self.lost else ""
        return (
            f"<Evaluation of {every['links']} links, {every['failed']} failed; "
            f"error mean {every['mean']:.2f}, median {every['median']:.2f} deg{lost}>"
        )

    def _repr_html_(self) -> str:
        def cell(value: Any) -> str:
            return html.escape("" if value is None else f"{value:.2f}" if isinstance(value, float) else str(value))

        heads = "".join(f"<th>{name}</th>" for name in SHOWN)
        shown = self.rows[:MOST_SHOWN]
        rows = "".join(f"<tr>{''.join(f'<td>{cell(row.get(name))}</td>' for name in SHOWN)}</tr>" for row in shown)
        more = len(self.rows) - len(shown)
        rest = f"<p>{more} more rows: to_pandas()</p>" if more else ""
        return f"<p>{html.escape(repr(self))}</p><table><tr>{heads}</tr>{rows}</table>{rest}"

    def summary(self) -> dict[str, dict[str, float]]:
        """Absolute errors from the mean pose by set (the first folder) and of ``all``: links, failed, mean, median, 90th
        percentile (degrees), share over 20 degrees."""
        sets: dict[str, list[dict[str, Any]]] = {}
        for row in self.rows:
            sets.setdefault(str(row["link"]).split("/")[0], []).append(row)
        return {name: _errors(rows) for name, rows in [*sorted(sets.items()), ("all", self.rows)]}

    def to_pandas(self) -> pandas.DataFrame:
        """One row per link; needs pandas. Swept values that are neither all numbers nor all texts become texts: lists with commas."""
        table: pandas.DataFrame = module("pandas").DataFrame(_columns(self.rows))
        return table

    def to_polars(self) -> polars.DataFrame:
        """One row per link, as :meth:`to_pandas`; needs polars."""
        table: polars.DataFrame = module("polars").DataFrame(_columns(self.rows), strict=False, nan_to_null=True)
        return table

    def to_arrow(self) -> pyarrow.Table:
        """One row per link, as :meth:`to_pandas`; needs pyarrow."""
        pa = module("pyarrow")
        columns = _columns(self.rows)
        # NaN means "no value", as in pandas.
        table: pyarrow.Table = pa.table({name: pa.array(values, from_pandas=True) for name, values in columns.items()})
        return table

    def to_ray(self) -> ray.data.Dataset:
        """One row per link, as a Ray Dataset on the joined cluster; needs ray and pyarrow."""
        dataset: ray.data.Dataset = module("ray.data").from_arrow(self.to_arrow())
        return dataset


def _columns(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """A column for each name in any row, the most important ones first."""
    every = dict.fromkeys(name for row in rows for name in row)
    names = dict.fromkeys([*(name for name in SHOWN if name in every), *every])
    columns: dict[str, Any] = {name: [row.get(name) for row in rows] for name in names}
    for name, values in columns.items():
        there = [value for value in values if value is not None]
        if not there and name not in TEXTS:
            # Numeric columns without any value stay numeric.
            columns[name] = np.full(len(values), np.nan)
        elif {type(value) for value in there} == {int, float}:
            columns[name] = [None if value is None else float(value) for value in values]
        elif name.startswith("option_") and not _is_plain(there):
            columns[name] = [None if value is None else _words(value) for value in values]
    return columns


def _is_plain(values: list[Any]) -> bool:
    kinds = {type(_options.plain(value)) for value in values}
    return kinds <= {int, float} or kinds == {str} or kinds == {bool}


def _words(value: Any) -> str:
    """An option's value as on the command line: lists with commas."""
    listed = isinstance(value, Iterable) and not isinstance(value, str)
    return ",".join(str(_options.plain(one)) for one in value) if listed else str(_options.plain(value))


def _errors(rows: list[dict[str, Any]]) -> dict[str, float]:
    found = [row.get("error_from_mean_pose_deg") for row in rows]
    errors = np.abs(np.array([error for error in found if error is not None], dtype=np.float64))
    failed = sum(row.get("azimuth_deg") is None for row in rows)
    if not len(errors):
        nothing = math.nan
        return {"links": len(rows), "failed": failed, "mean": nothing, "median": nothing, "p90": nothing, "over_20": nothing}
    return {
        "links": len(rows),
        "failed": failed,
        "mean": float(errors.mean()),
        "median": float(np.median(errors)),
        "p90": float(np.percentile(errors, 90)),
        "over_20": float((errors > 20).mean()),
    }


def find(root: str | os.PathLike[str]) -> tuple[list[Capture], list[str]]:
    """Captures below a folder, in order of name, and folders that could not be read."""
    found, unreadable = _native.find_captures(root)
    captures = [
        Capture(place, stamp, os.fspath(folder), [(name, os.fspath(log)) for name, log in logs], loose)
        for place, stamp, folder, logs, loose in found
    ]
    return captures, list(unreadable)


NO_CAPTURE = "a capture is a folder with groundtruth_positions.json and csi_rx_TS.dat"


def found_below(folder: str | os.PathLike[str]) -> tuple[list[Capture], list[str]]:
    """As :func:`find`. Raises :class:`OptionError` if there is none, :class:`OptionFileError` if the folder does not exist."""
    name = os.fspath(folder)
    if not os.path.isdir(name):
        raise OptionFileError(f"folder: {name} is not a readable folder", name)
    captures, unreadable = find(name)
    if not captures:
        raise OptionError(f"no capture below {name}: {NO_CAPTURE}", name)
    return captures, unreadable


def workers_of(workers: int | None) -> int:
    """Number of threads; by default one per core."""
    return (0 if workers is None else _options.whole("workers", workers)) or os.cpu_count() or 1


def combinations(options: Mapping[str, Any], sweep: Mapping[str, Sequence[Any]] | None) -> list[dict[str, Any]]:
    """The options of each run: the cartesian product of ``sweep``, combined with ``options``."""
    names, values = _options.combinations(options, sweep)
    runs = [dict(options) | dict(zip(names, chosen, strict=True)) for chosen in itertools.product(*values)]
    for run in runs:
        _run(run)
    return runs


def _run(options: Mapping[str, Any]) -> tuple[str, str]:
    """The trajectory, and the other options for the native half."""
    keywords = dict(options)
    trajectory = keywords.pop("trajectory", None) or "gt"
    return _options.text("trajectory", trajectory), _options.keywords(keywords)


def one(
    capture: Capture,
    runs: Sequence[Mapping[str, Any]],
    swept: Iterable[str] = (),
    cancel: _native.Cancel | None = None,
) -> Evaluation:
    """Evaluates a capture with each set of options. A failure becomes a row with its ``error``, never an
    exception. ``cancel`` ends it early."""
    swept = list(swept)
    done = Evaluation()
    try:
        parts = (capture.place, capture.stamp, capture.folder, capture.transmitters, capture.loose)
        found = _native.evaluate_capture(*parts, [_run(options) for options in runs], cancel)
        results = [json.loads(result) for result in found]
    except OptionError:
        raise
    except Error as error:
        failed = {"link": capture.name, "azimuth_deg": None, "error": str(error)}
        results = [{"rows": [failed], "notes": [], "lost": True} for _ in runs]
    for options, result in zip(runs, results, strict=True):
        chosen = {f"option_{name}": options[name] for name in swept}
        done.rows += [{**row, "capture": capture.name, **chosen} for row in result["rows"]]
        done.notes += [note for note in result["notes"] if note not in done.notes]
        done.lost |= bool(result["lost"])
    return done


def joined(parts: Iterable[Evaluation], unreadable: Iterable[str] = ()) -> Evaluation:
    """Evaluates one after the other."""
    notes = [f"cannot read {folder}" for folder in unreadable]
    whole = Evaluation(notes=notes, lost=bool(notes))
    for part in parts:
        whole.rows += part.rows
        whole.notes += part.notes
        whole.lost |= part.lost
    return whole


def evaluate(
    folder: str | os.PathLike[str],
    *,
    sweep: Mapping[str, Sequence[Any]] | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> Evaluation:
    """Evaluates the captures below ``folder`` (a tree laid out as the WSR data set) against their truth.

    ``options`` are those of ``csi5300 evaluate``, with the same names and units: ``trajectory`` is ``"gt"`` (motion capture),
    ``"t265"`` (tracking camera) or ``"odom"`` (wheels); ``antenna_offset`` is the antenna's position on the robot, and ``camera_mount``
    the tracking camera's, as in :func:`csi5300.bearings`. ``sweep`` maps options to lists of values: every combination is evaluated,
    and a row's ``option_NAME`` has its values. ``workers`` is the number of captures evaluated in parallel (None: one per core).
    ``progress`` is called with the number of captures done and their total.
    """
    runs = combinations(options, sweep)
    workers = workers_of(workers)
    captures, unreadable = found_below(folder)
    parts: list[Evaluation] = []
    cancel = _native.Cancel()
    with ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(one, capture, runs, sweep or (), cancel) for capture in captures]
        try:
            for future in futures:
                parts.append(future.result())
                if progress is not None:
                    progress(len(parts), len(captures))
        except BaseException:
            cancel.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return joined(parts, unreadable)
