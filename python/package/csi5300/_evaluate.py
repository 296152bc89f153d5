"""Captures against their truth: :func:`evaluate`."""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _native
from ._bearing import _keywords
from ._errors import Error, OptionError

if TYPE_CHECKING:
    import pandas
    import polars
    import pyarrow
    import ray.data

TRAJECTORIES = ("gt", "t265", "odom")


@dataclass(frozen=True)
class Capture:
    """One run below a folder: what :func:`find` lists and :func:`one` evaluates."""

    place: str
    stamp: str
    folder: str
    transmitters: list[tuple[str, str]]

    @property
    def name(self) -> str:
        """Its folder below the one evaluated, and its time stamp."""
        return "/".join(part for part in (self.place, self.stamp) if part)


@dataclass
class Evaluation:
    """Rows of an evaluation, one a link (and a set of options), in the order of the captures."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    """By the names of ``csi5300 evaluate --json``; a capture or link that failed has its ``error``."""
    notes: list[str] = field(default_factory=list)
    """What was lost in the logs or left out, a line each."""
    lost: bool = False
    """True if something was lost in a log, a folder could not be read, or a link failed."""

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return iter(self.rows)

    def summary(self) -> dict[str, dict[str, float]]:
        """Absolute errors from the mean pose by set (the first folder) and of ``all``: links, failed, mean, median, 90th
        percentile (degrees), share over 20 degrees."""
        sets: dict[str, list[dict[str, Any]]] = {}
        for row in self.rows:
            sets.setdefault(str(row["link"]).split("/")[0], []).append(row)
        return {name: _errors(rows) for name, rows in [*sorted(sets.items()), ("all", self.rows)]}

    def to_pandas(self) -> pandas.DataFrame:
        """A row a link; needs pandas."""
        import pandas as pd

        return pd.DataFrame(self.rows)

    def to_polars(self) -> polars.DataFrame:
        """A row a link; needs polars."""
        import polars as pl

        return pl.DataFrame(self.rows, infer_schema_length=None)

    def to_arrow(self) -> pyarrow.Table:
        """A row a link; needs pyarrow."""
        import pyarrow as pa

        return pa.Table.from_pylist(_rectangular(self.rows))

    def to_ray(self) -> ray.data.Dataset:
        """A row a link, as a Ray Dataset on the cluster that was joined; needs ray and pyarrow."""
        import ray.data

        return ray.data.from_arrow(self.to_arrow())


def _rectangular(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    names = list(dict.fromkeys(name for row in rows for name in row))
    return [{name: row.get(name) for name in names} for row in rows]


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
    """Captures below a folder, in the order of their names, and folders that could not be read."""
    found, unreadable = _native.find_captures(root)
    captures = [
        Capture(place, stamp, os.fspath(folder), [(name, os.fspath(log)) for name, log in logs])
        for place, stamp, folder, logs in found
    ]
    return captures, list(unreadable)


def combinations(options: Mapping[str, Any], sweep: Mapping[str, Sequence[Any]] | None) -> list[dict[str, Any]]:
    """The options of each run: the cartesian product of ``sweep``, each with ``options``."""
    sweep = sweep or {}
    twice = set(sweep) & set(options)
    if twice:
        raise OptionError(f"{', '.join(sorted(twice))}: both an option and swept")
    values = itertools.product(*sweep.values())
    return [dict(options) | dict(zip(sweep, chosen, strict=True)) for chosen in values]


def _run(options: Mapping[str, Any]) -> tuple[str, str]:
    """The trajectory, and the other options as the native half takes them."""
    keywords = dict(options)
    trajectory = keywords.pop("trajectory", None) or "gt"
    return trajectory, _keywords(keywords)


def one(
    capture: Capture,
    runs: Sequence[Mapping[str, Any]],
    swept: Iterable[str] = (),
    cancel: _native.Cancel | None = None,
) -> Evaluation:
    """Evaluates a capture, whose files are read once, with each set of options. What fails becomes a row with its ``error``, never an
    exception. ``cancel`` ends it early."""
    swept = list(swept)
    done = Evaluation()
    try:
        parts = (capture.place, capture.stamp, capture.folder, capture.transmitters)
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
    """Evaluations one after the other."""
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

    ``options`` are those of ``csi5300 evaluate`` under the same names and in the same units: ``trajectory`` is ``"gt"`` (motion capture),
    ``"t265"`` (tracking camera) or ``"odom"`` (wheels); ``antenna_offset`` says where the antenna is on the robot, and ``camera_mount``
    how the tracking camera is mounted, as in :func:`csi5300.bearings`. ``sweep`` maps options to lists of values: every combination is evaluated, and ``option_NAME`` says which a row is of. ``workers``
    captures are worked on at a time (None: one a core). ``progress`` is called with captures done and all.
    """
    captures, unreadable = find(folder)
    if not captures:
        raise OptionError(
            f"no capture below {os.fspath(folder)}: a capture is a folder with groundtruth_positions.json and csi_rx_TS.dat"
        )
    runs = combinations(options, sweep)
    parts: list[Evaluation] = []
    cancel = _native.Cancel()
    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
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
