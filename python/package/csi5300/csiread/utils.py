"""csiread's functions besides its readers (``csiread.utils``): subcarrier indices, phases without their linear trend, and transforms
between subcarriers and delays, for this card's 802.11n channels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["calib", "phy_fft", "phy_ifft", "scidx"]

_OUTER_AND_INNER = {20: (28, 1), 40: (58, 2)}


def scidx(bw: int, ng: int, standard: str = "n") -> NDArray[np.int_]:
    """Subcarrier indices of ``bw`` MHz (20, 40) in groups of ``ng`` (1, 2, 4): IEEE 802.11n-2009, table 7-25f. ``scidx(20, 2)`` gives
    the card's 30. Raises ``ValueError`` for other values, including 802.11ac (``standard="ac"``)."""
    if standard != "n" or bw not in _OUTER_AND_INNER or ng not in (1, 2, 4):
        raise ValueError(f"bw={bw}, ng={ng}, standard={standard!r}: bw 20 or 40 and ng 1, 2 or 4 of standard 'n' are known here")
    outer, inner = _OUTER_AND_INNER[bw]
    below, above = np.arange(-outer, -inner, ng), np.arange(inner, outer, ng)
    return np.concatenate([below, [-inner], above, [outer]])


def calib(phase: ArrayLike, k: ArrayLike, axis: int = 1) -> NDArray[Any]:
    """Unwrapped phases without their mean and without the line from the first to the last subcarrier of ``k`` along ``axis``."""
    along, indices = np.moveaxis(np.asarray(phase), axis, -1), np.asarray(k)
    slope = (along[..., -1:] - along[..., :1]) / (indices[-1] - indices[0])
    level: NDArray[Any] = np.moveaxis(along - slope * indices - along.mean(axis=-1, keepdims=True), -1, axis)
    return level


def _turns(indices: NDArray[Any]) -> NDArray[np.complex128]:
    """(delays, subcarriers) ``exp(j 2 pi k n / N)``; N is 64 or 128, by the width of the indices."""
    size = 64 * round(float(indices[-1]) / 30)
    turns: NDArray[np.complex128] = np.exp(2j * np.pi * np.outer(np.arange(size), indices) / size)
    return turns


def phy_ifft(x: NDArray[Any], k: ArrayLike, axis: int = 1) -> NDArray[Any]:
    """Subcarriers ``k`` along ``axis`` to 64 (20 MHz) or 128 delays of one sample each: IEEE 802.11-2016, equation 19-25."""
    response = np.moveaxis(x, axis, -1) @ _turns(np.asarray(k)).T / x.shape[axis]
    return np.moveaxis(response, -1, axis)


def phy_fft(x: NDArray[Any], k: ArrayLike, axis: int = 1) -> NDArray[Any]:
    """Delays along ``axis`` to the subcarriers ``k``: the inverse of :func:`phy_ifft`."""
    turns = _turns(np.asarray(k))
    channel = np.moveaxis(x, axis, -1) @ turns.conj() * (turns.shape[1] / turns.shape[0])
    return np.moveaxis(channel, -1, axis)
