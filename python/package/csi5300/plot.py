"""Pictures with matplotlib: :func:`heat_map`, :func:`bearing`, :func:`trajectory`.

Each returns a ``Figure`` that no window shows: notebooks draw it, ``figure.savefig("name.png")`` writes it.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ._errors import OptionError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ._bearing import Bearing
    from ._log import Log

COLUMNS = 1_500
"""Frames drawn at most, evenly chosen by their number."""
GAP_S = 0.5
"""Longer pauses between frames are left white."""


def _figure(width: float, height: float) -> Figure:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("pictures need matplotlib: pip install matplotlib") from error

    class Picture(Figure):  # type: ignore[misc, unused-ignore]
        """A figure that notebooks show, whether pyplot was imported or not."""

        def _repr_png_(self) -> bytes:
            out = io.BytesIO()
            self.savefig(out, format="png", dpi=100)
            return out.getvalue()

    return Picture(figsize=(width, height), layout="constrained")


def _edges(places: NDArray[np.float64]) -> NDArray[np.float64]:
    between = (places[1:] + places[:-1]) / 2
    return np.concatenate([[2 * places[0] - between[0]], between, [2 * places[-1] - between[-1]]])


def _without_line(h: NDArray[np.complex64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Phases (n, 30) without offset and slope; the slope is that of neighbours at the usual distance."""
    step = np.diff(places)
    usual = np.median(step)
    pairs = np.flatnonzero(step == usual)
    turn = np.nansum(h[:, pairs + 1] * np.conj(h[:, pairs]), axis=1, keepdims=True)
    level = h * np.exp(-1j * np.angle(turn) / usual * places)
    phase: NDArray[np.float64] = np.angle(level * np.exp(-1j * np.angle(np.nansum(level, axis=1, keepdims=True))))
    return phase


def heat_map(log: Log, *, antenna: str | None = None, stream: int = 0) -> Figure:
    """Amplitude (dB, the card's integers) and phase over time and subcarrier of one antenna and stream.

    The phase is what is left of each frame's without its offset and its slope over subcarriers: those of carrier and sampling
    clock differ from frame to frame and hide the channel. Raises :class:`OptionError` for an antenna or stream that the log does not have.
    """
    letter = (antenna or log.antennas[:1]).upper()
    if len(log) < 2 or letter not in log.antennas or not letter or not 0 <= stream < log.streams:
        raise OptionError(f"a log of {len(log)} frames, antennas {log.antennas or 'none'}, {log.streams} streams has no such picture")
    chosen = np.unique(np.linspace(0, len(log) - 1, min(COLUMNS, len(log))).astype(np.int64))
    part = log[chosen]
    h = part.csi[:, part.antennas.index(letter), stream, :]
    level = 20 * np.log10(np.maximum(np.abs(h), 0.5))
    turned = _without_line(h, part.subcarriers.astype(np.float64))
    t = log.t[chosen]
    alone = np.diff(t, prepend=t[0]) > GAP_S
    level[alone], turned[alone] = np.nan, np.nan
    most = max(0.1, float(np.nanpercentile(np.abs(turned), 99))) if np.isfinite(turned).any() else np.pi
    figure = _figure(9, 5)
    upper, lower = figure.subplots(2, 1, sharex=True)
    along, up = _edges(t), _edges(part.subcarriers.astype(np.float64))
    for axes, values, words, more in (
        (upper, level, "amplitude, dB", {"cmap": "viridis"}),
        (lower, turned, "phase, rad", {"cmap": "coolwarm", "vmin": -most, "vmax": most}),
    ):
        drawn = axes.pcolormesh(along, up, values.T, rasterized=True, **more)
        figure.colorbar(drawn, ax=axes, label=words)
        axes.set_ylabel("subcarrier")
    upper.set_title(f"{log.name}, antenna {letter}, stream {stream + 1}", fontsize="medium")
    lower.set_xlabel("seconds after the first frame")
    return figure


def _mark(axes: Any, degrees: float, style: str, words: str) -> None:
    if np.isfinite(degrees):
        axes.plot([np.radians(degrees)] * 2, [0, 1], style, label=f"{words} {degrees:.1f} deg")


def bearing(found: Bearing, *, truth_deg: float | None = None) -> Figure:
    """The profile over azimuth with the answer (and its mirror, and the truth) marked, and the path with the bearing.

    The profile is the plane wave's on the horizon, its largest value drawn as 1. Raises :class:`LinkError` without a bearing.
    """
    profile = found.profile(720)
    figure = _figure(9, 4.5)
    polar = figure.add_subplot(1, 2, 1, projection="polar")
    around = np.radians(np.append(profile.azimuth_deg.ravel(), profile.azimuth_deg.flat[0]))
    value = np.append(profile.value.ravel(), profile.value.flat[0]) / max(float(profile.value.max()), 1e-300)
    polar.fill(around, value, alpha=0.4)
    _mark(polar, found.azimuth_deg, "r-", "answer")
    _mark(polar, found.mirror_deg, "r:", "mirror")
    if truth_deg is not None:
        _mark(polar, truth_deg, "k--", "truth")
    polar.set_yticklabels([])
    polar.legend(loc="lower left", fontsize="small")
    confidence = f", confidence {found.confidence:.2f}" if np.isfinite(found.confidence) else ""
    polar.set_title(f"{found.link}: {found.azimuth_deg:.1f} +- {found.azimuth_sd_deg:.1f} deg{confidence}", fontsize="medium")
    _path(figure.add_subplot(1, 2, 2), [found])
    return figure


def trajectory(bearings: list[Bearing]) -> Figure:
    """The receiver's path from above, with an arrow for each bearing."""
    figure = _figure(5, 5)
    _path(figure.add_subplot(), [found for found in bearings if found])
    return figure


def _path(axes: Any, bearings: list[Bearing]) -> None:
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    for number, found in enumerate(bearings):
        samples = found.samples
        path, used = samples["path_m"], samples["receiver_m"]
        if number == 0:
            axes.plot(path[:, 0], path[:, 1], "-", color="0.7", linewidth=1, label="path")
            axes.plot(used[:, 0], used[:, 1], ".", markersize=2, label="samples used")
        x, y = used[:, 0].mean(), used[:, 1].mean()
        length = max(float(np.ptp(used[:, 0])), float(np.ptp(used[:, 1])), 0.1)
        towards = np.radians(found.azimuth_deg)
        tip = (x + length * np.cos(towards), y + length * np.sin(towards))
        axes.annotate("", tip, (x, y), arrowprops={"arrowstyle": "->", "color": "red"})
        axes.plot(*tip, alpha=0)
        axes.text(*tip, found.link, fontsize="small")
    axes.legend(loc="best", fontsize="small")
