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

from ._bearing import Bearing, Profile, Track, bearings, read_trajectory
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
    SceneError,
    TrajectoryError,
)
from ._evaluate import Evaluation, evaluate
from ._frame import Frame, Loss
from ._log import Log, read, scan
from ._native import __version__
from ._simulate import Robot, Room, simulate
from ._stream import Stream

__all__ = [
    "Bearing",
    "CaptureError",
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
    "Profile",
    "Robot",
    "Room",
    "SceneError",
    "Stream",
    "Track",
    "TrajectoryError",
    "__version__",
    "bearings",
    "evaluate",
    "read",
    "read_trajectory",
    "scan",
    "simulate",
]
