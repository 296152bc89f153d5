"""Pictures with matplotlib: :func:`heat_map`, :func:`bearing`, :func:`trajectory`.

Each returns a ``Figure`` without a window: notebooks display it, ``figure.savefig("name.png")`` writes it.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _options
from ._errors import OptionError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ._bearing import Bearing
    from ._log import Log

COLUMNS = 1_500
"""Frames drawn at most, evenly spaced by number, besides those at both ends of a pause."""
GAP_S = 0.5
GAP_STEPS = 5
"""Pauses between frames are white if they exceed both this many seconds and this many usual intervals."""


def _figure(width: float, height: float) -> Figure:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("pictures need matplotlib: pip install matplotlib") from error

    class Picture(Figure):  # type: ignore[misc, unused-ignore]
        """A figure that notebooks display, with or without pyplot."""

        def _repr_png_(self) -> bytes:
            out = io.BytesIO()
            self.savefig(out, format="png", dpi=100)
            return out.getvalue()

    return Picture(figsize=(width, height), layout="constrained")


def _edges(places: NDArray[np.float64]) -> NDArray[np.float64]:
    between = (places[1:] + places[:-1]) / 2
    return np.concatenate([[2 * places[0] - between[0]], between, [2 * places[-1] - between[-1]]])


def _columns(places: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    """For frames at these positions, in order: which to draw, the edges of the cells, and which cells belong to a frame; the others
    are pauses, in which nothing is drawn."""
    steps = np.diff(places)
    usual = float(np.median(steps[steps > 0]))
    pauses = np.flatnonzero(steps > max(GAP_S, GAP_STEPS * usual))
    # Only the longest, if there are many.
    pauses = np.sort(pauses[np.argsort(-steps[pauses], kind="stable")[:COLUMNS]])
    evenly = np.linspace(0, len(places) - 1, min(COLUMNS, len(places))).astype(np.int64)
    drawn = np.unique(np.concatenate([evenly, pauses, pauses + 1]))
    between = (places[drawn[1:]] + places[drawn[:-1]]) / 2
    half = usual / 2
    before = np.searchsorted(drawn, pauses)
    edges = np.concatenate([[places[0] - half], between, [places[-1] + half]])
    # A pause has two edges, half an interval from its ends.
    edges[before + 1] = places[pauses] + half
    edges = np.insert(edges, before + 2, places[pauses + 1] - half)
    is_frame = np.insert(np.ones(len(drawn), dtype=bool), before + 1, False)
    return drawn, edges, is_frame


def _without_line(h: NDArray[np.complex64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Phases (n, 30) without offset and slope; the slope is measured between neighbours at the usual distance."""
    step = np.diff(places)
    usual = np.median(step)
    pairs = np.flatnonzero(step == usual)
    turn = np.nansum(h[:, pairs + 1] * np.conj(h[:, pairs]), axis=1, keepdims=True)
    level = h * np.exp(-1j * np.angle(turn) / usual * places)
    phase: NDArray[np.float64] = np.angle(level * np.exp(-1j * np.angle(np.nansum(level, axis=1, keepdims=True))))
    return phase


def heat_map(log: Log, *, antenna: str | None = None, stream: int = 0) -> Figure:
    """Amplitude (dB, the card's integers) and phase over time and subcarrier of one antenna and stream, of the sender with the most frames.

    Each frame's phase is drawn without its offset and slope over subcarriers: those of carrier and sampling clock vary from frame to
    frame and hide the channel. Pauses are white; frames that all have the same time are drawn by number. Raises :class:`OptionError`
    for an antenna or stream that the log does not have.
    """
    log, sender = _most_heard(log)
    letter, column = _which(log, antenna, stream)
    order = np.argsort(log.time_us, kind="stable")
    t = log.t[order]
    is_timed = bool(t[-1] > t[0])
    chosen, along, is_frame = _columns(t if is_timed else np.arange(len(log), dtype=np.float64))
    part = log[order[chosen]]
    h = part.csi[:, part.antennas.index(letter), column, :]
    level = 20 * np.log10(np.maximum(np.abs(h), 0.5))
    turned = _without_line(h, part.subcarriers.astype(np.float64))
    most = max(0.1, float(np.nanpercentile(np.abs(turned), 99))) if np.isfinite(turned).any() else np.pi
    figure = _figure(9, 5)
    upper, lower = figure.subplots(2, 1, sharex=True)
    up = _edges(part.subcarriers.astype(np.float64))
    for axes, values, words, more in (
        (upper, level, "amplitude, dB", {"cmap": "viridis"}),
        (lower, turned, "phase, rad", {"cmap": "coolwarm", "vmin": -most, "vmax": most}),
    ):
        cells = np.full((len(is_frame), values.shape[1]), np.nan)
        cells[is_frame] = values
        drawn = axes.pcolormesh(along, up, cells.T, rasterized=True, **more)
        figure.colorbar(drawn, ax=axes, label=words)
        axes.set_ylabel("subcarrier")
    upper.set_title(f"{log.name}, antenna {letter}, stream {column + 1}{sender}", fontsize="medium")
    lower.set_xlabel("seconds after the log's first record" if is_timed else "frame number: all have the same time")
    return figure


def _most_heard(log: Log) -> tuple[Log, str]:
    """The frames of the sender with the most, and words for the title; of a log with one sender all frames, and no words."""
    macs, counts = np.unique(log.mac, return_counts=True)
    if len(macs) < 2:
        return log, ""
    most = macs[np.argmax(counts)]
    return log[log.mac == most], f", sender {most or 'unknown'}"


def _which(log: Log, antenna: str | None, stream: int) -> tuple[str, int]:
    """The antenna's letter and the stream, if the log has them."""
    if len(log) < 2:
        raise OptionError(f"a log of {len(log)} frames has no picture: 2 are needed")
    letter = log.antennas[:1] if antenna is None else antenna
    if not isinstance(letter, str) or letter.upper() not in tuple(log.antennas):
        raise OptionError(f"antenna: {letter!r} is not one of this log's, {log.antennas or 'none'}")
    return letter.upper(), _options.whole("stream", stream, 0, log.streams - 1)


def _mark(axes: Any, degrees: float, style: str, words: str) -> None:
    if np.isfinite(degrees):
        axes.plot([np.radians(degrees)] * 2, [0, 1], style, label=f"{words} {degrees:.1f} deg")


def bearing(found: Bearing, *, truth_deg: float | None = None) -> Figure:
    """The profile over azimuth with answer, mirror and truth marked, and the path with the bearing.

    The profile is the plane wave's on the horizon, scaled to a maximum of 1. Raises :class:`LinkError` without a bearing.
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
    """The receiver's path from above, with an arrow for each bearing. Raises :class:`OptionError` without any bearing."""
    drawn = [found for found in bearings if found]
    if not drawn:
        raise OptionError("bearings: none of these links has a bearing")
    figure = _figure(5, 5)
    _path(figure.add_subplot(), drawn)
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
