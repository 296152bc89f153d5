"""Prepares arguments for the native half. They are checked here so that an error names the argument. NumPy's scalars are numbers."""

from __future__ import annotations

import json
import math
import numbers
import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from ._errors import OptionError

STEPS = ("compensation", "alignment", "one-way", "near-field", "elevation")


def plain(value: Any) -> Any:
    """A NumPy scalar as Python's; any other value unchanged."""
    return value.item() if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0) else value


def number(name: str, value: Any) -> float:
    """A finite number."""
    given = plain(value)
    if isinstance(given, bool) or not isinstance(given, numbers.Real):
        raise OptionError(f"{name}: {value!r} is not a number")
    if not math.isfinite(given):
        raise OptionError(f"{name}: {given} is not a finite number")
    return float(given)


def whole(name: str, value: Any, least: int = 0, most: int = 2**63 - 1) -> int:
    """A whole number from ``least`` to ``most``."""
    given = plain(value)
    if isinstance(given, bool) or not isinstance(given, numbers.Integral):
        raise OptionError(f"{name}: {value!r} is not a whole number")
    if not least <= int(given) <= most:
        raise OptionError(f"{name}: {given} is not {f'{least} to {most}' if most < 2**63 - 1 else f'{least} or more'}")
    return int(given)


def flag(name: str, value: Any) -> bool:
    """True or False."""
    given = plain(value)
    if not isinstance(given, bool):
        raise OptionError(f"{name}: {value!r} is not True or False")
    return given


def text(name: str, value: Any) -> str:
    """A text."""
    if not isinstance(value, str):
        raise OptionError(f"{name}: {value!r} is not a text")
    return str(value)


def texts(name: str, value: Any) -> list[str]:
    """One text, or several."""
    if isinstance(value, str):
        return [str(value)]
    if not isinstance(value, Iterable):
        raise OptionError(f"{name}: {value!r} is neither a text nor a list of texts")
    return [text(name, one) for one in value]


def steps(name: str, value: Any) -> list[str]:
    """Names of steps."""
    given = texts(name, value)
    for one in given:
        if one not in STEPS:
            raise OptionError(f"{name}: {one!r} is not one of {', '.join(STEPS)}")
    return given


def triple(name: str, value: Any) -> list[float]:
    """Three finite numbers."""
    given = list(value) if isinstance(value, Iterable) and not isinstance(value, str) else [value]
    if len(given) != 3:
        raise OptionError(f"{name}: {value!r} is not three numbers")
    return [number(name, one) for one in given]


def channel(name: str, value: Any) -> str:
    """A channel, by its number or in words."""
    return str(plain(value))


def path(name: str, value: Any) -> str:
    """A path."""
    if not isinstance(value, (str, os.PathLike)):
        raise OptionError(f"{name}: {value!r} is not a path")
    return os.fsdecode(value)


def fitted(name: str, value: Any) -> str:
    """What is fitted."""
    if value != "odometry":
        raise OptionError(f"{name}: {value!r} is not 'odometry'")
    return "odometry"


KINDS: Mapping[str, Callable[[str, Any], Any]] = {
    "channel": channel,
    "antenna": text,
    "clock_offset": number,
    "elevation_max": number,
    "no_compensation": flag,
    "without": steps,
    "accuracy": number,
    "range_min": number,
    "height": number,
    "heading_sd": number,
    "from_": number,
    "to": number,
    "decimate": whole,
    "join_rows": flag,
    "columns": text,
    "antenna_offset": triple,
    "camera_mount": triple,
    "min_confidence": number,
    "every": number,
    "explain": flag,
    "range_change": flag,
    "fit": fitted,
    "key": path,
    "tx_mac": texts,
    "rx_mac": text,
    "threads": whole,
}
"""The type of each option of bearings and evaluations; the native half checks the ranges."""


def keywords(options: Mapping[str, Any]) -> str:
    """Options for the native half; None means the default."""
    given = {}
    for name, value in options.items():
        if name not in KINDS:
            raise OptionError(f"{name}: there is no such option")
        if value is not None:
            given[name] = KINDS[name](name, value)
    return json.dumps(given)


def combinations(options: Mapping[str, Any], sweep: Mapping[str, Any] | None) -> tuple[list[str], list[list[Any]]]:
    """The swept names, and the values of each."""
    if sweep is None:
        return [], []
    if not isinstance(sweep, Mapping):
        raise OptionError(f"sweep: {sweep!r} does not map options to lists of values")
    for name, values in sweep.items():
        if isinstance(values, (str, Mapping)) or not isinstance(values, Iterable):
            raise OptionError(f"sweep: {name}: {values!r} is not a list of values")
        if name in options:
            raise OptionError(f"{name}: both an option and swept")
    return list(sweep), [list(values) for values in sweep.values()]


# Filters of logs.


def macs(value: str | Iterable[str] | None) -> list[str] | None:
    """Senders."""
    return None if value is None else texts("macs", value)


def letters(value: str | Iterable[str] | None) -> str | None:
    """Letters of antennas."""
    return None if value is None else "".join(texts("antennas", value))


def streams(value: int | None) -> int | None:
    """Streams of the card."""
    return None if value is None else whole("streams", value, 1, 3)


def stretch(value: Any) -> tuple[float | None, float | None] | None:
    """From and to, seconds; each may be None."""
    if value is None:
        return None
    ends = list(value) if isinstance(value, Iterable) and not isinstance(value, (str, Mapping)) else []
    if len(ends) != 2:
        raise OptionError(f"t: {value!r} is not (from, to), seconds or None")
    ends = [plain(end) for end in ends]
    for end in ends:
        if end is not None and (isinstance(end, bool) or not isinstance(end, numbers.Real) or math.isnan(end)):
            raise OptionError(f"t: {end!r} is not a number of seconds")
    start, stop = (None if end is None else float(end) for end in ends)
    if start is not None and stop is not None and start >= stop:
        raise OptionError(f"t: from {start} to {stop} s is not a stretch of time")
    return start, stop
