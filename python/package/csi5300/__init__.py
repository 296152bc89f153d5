"""CSI of the Intel 5300: logs as NumPy arrays, bearings from them, simulated rooms.

>>> import csi5300
>>> log = csi5300.read("rx.dat")                    # doctest: +SKIP
>>> log.csi.shape                                   # doctest: +SKIP
(12000, 1, 1, 30)
>>> bearing, = csi5300.bearings("rx.dat", "tx.dat", trajectory="t.csv", channel=108)   # doctest: +SKIP
>>> bearing.azimuth_deg                             # doctest: +SKIP
42.1

Azimuths are degrees in the trajectory's frame, from +x towards +y, from the receiver to the transmitter. All times that are
not ``datetime64`` are seconds (``t``, ``_s``) or microseconds (``_us``); lengths are metres. Every error is a :class:`Error`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from ._bearing import Bearing, Profile, Track, bearings, read_trajectory
from ._cards import CardLog, read_card
from ._errors import (
    CaptureError,
    Error,
    ExportError,
    InternalError,
    LinkError,
    LiveError,
    LogError,
    LogNotFoundError,
    OptionError,
    OptionFileError,
    SceneError,
    SceneFileError,
    TrajectoryError,
    TrajectoryFileError,
)
from ._evaluate import Evaluation, evaluate
from ._frame import Frame, Loss
from ._log import Log, read
from ._native import __version__
from ._scan import Scan, scan
from ._simulate import Robot, Room, simulate
from ._stream import Stream

__all__ = [
    "Bearing",
    "CaptureError",
    "CardLog",
    "Error",
    "Evaluation",
    "ExportError",
    "Frame",
    "InternalError",
    "LinkError",
    "LiveError",
    "Log",
    "LogError",
    "LogNotFoundError",
    "Loss",
    "OptionError",
    "OptionFileError",
    "Profile",
    "Robot",
    "Room",
    "Scan",
    "SceneError",
    "SceneFileError",
    "Stream",
    "Track",
    "TrajectoryError",
    "TrajectoryFileError",
    "__version__",
    "bearings",
    "evaluate",
    "read",
    "read_card",
    "read_trajectory",
    "scan",
    "simulate",
]


if TYPE_CHECKING:
    from . import csiread, plot, ray
else:

    def __dir__() -> list[str]:
        return sorted({*__all__, "csiread", "plot", "ray"})

    def __getattr__(name: str) -> Any:
        # Modules that most programs do not need are imported on first use.
        if name in ("csiread", "plot", "ray"):
            return importlib.import_module(f"{__name__}.{name}")
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
