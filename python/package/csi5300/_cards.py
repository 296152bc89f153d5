"""Logs of cards other than the Intel 5300: :func:`read_card`."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native, _options
from ._errors import LogError
from ._log import File, _file


def _known(values: NDArray[np.int64]) -> np.ma.MaskedArray[Any, np.dtype[Any]]:
    return np.ma.masked_array(values, mask=values < 0)


class CardLog:
    """Frames of another card's log that have the same width and chains: a NumPy array for each field, all of length ``n``.

    A field that the log does not contain is masked, NaN, NaT, empty or None, never 0.
    """

    def __init__(self, name: str, format: str, counts: tuple[int, int, int], fields: dict[str, Any]) -> None:
        self.name = name
        """The log's path, or ``bytes``."""
        self.format = format
        """The kind of log: ``FeitCSI``, ``PicoScenes``, ``nexmon pcap``, ``ESP32 CSV``, ``Atheros CSI tool``."""
        self.other_shapes, self.left_out, self.damaged = counts
        self.card: str | None = fields["card"]
        """The card's name."""
        self.kind: str | None = fields["kind"]
        """``HT``, ``VHT``, ``HE`` or ``legacy``."""
        self.width_mhz: int | None = fields["width_mhz"]
        """Width of the frames, MHz."""
        self.csi: NDArray[np.complex64] = fields["csi"]
        """(n, n_rx, n_tx, n_subcarriers) In units of the card; NaN where it measured nothing (pilots, the centre)."""
        self.subcarriers: NDArray[np.int16] = fields["subcarriers"]
        """(n_subcarriers,) Index relative to the channel's centre, in units of ``spacing_hz``."""
        self.spacing_hz: float | None = fields["spacing_hz"]
        """Subcarrier spacing, Hz."""
        self.t: NDArray[np.float64] = fields["t"]
        """(n,) Seconds from the log's first frame by the card's clock, else by the host's."""
        self.clock_ticks = _known(fields["clock_ticks"])
        """(n,) The card's finest clock as recorded; it wraps."""
        self.tick_ps: int | None = fields["tick_ps"]
        """Length of one of its ticks, picoseconds."""
        self.sequence = _known(fields["sequence"])
        """(n,) Sequence number of the 802.11 frame, 0 to 4095."""
        self.rssi: NDArray[np.float64] = fields["rssi"]
        """(n, n_rx) dBm if ``rssi_in_dbm``, else dB above the card's reference."""
        self.rssi_in_dbm: bool | None = fields["rssi_in_dbm"]
        self.first_rx: NDArray[np.int64] = fields["first_rx"]
        """(n,) First receive chain of ``csi``: nexmon has a frame for each chain."""
        self.first_tx: NDArray[np.int64] = fields["first_tx"]
        """(n,) First stream of ``csi``."""
        self._host_us: NDArray[np.int64] = fields["host_us"]
        self._mac: NDArray[np.uint8] = fields["mac"]

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        _, n_rx, n_tx, n = self.csi.shape
        return f"<CardLog {self.format}, {len(self)} frames, {n_rx} x {n_tx} chains, {n} subcarriers of {self.width_mhz} MHz>"

    @property
    def host_time(self) -> NDArray[np.datetime64]:
        """(n,) datetime64[us] of the host's clock (UTC)."""
        us = np.where(self._host_us < 0, np.iinfo(np.int64).min, self._host_us)
        time: NDArray[np.datetime64] = us.view("datetime64[us]")
        return time

    @property
    def mac(self) -> NDArray[np.str_]:
        """(n,) The sender's address."""
        return np.array([":".join(f"{octet:02x}" for octet in mac) if mac.any() else "" for mac in self._mac], dtype=np.str_)


def read_card(file: File, *, macs: str | Iterable[str] | None = None) -> CardLog:
    """Reads a log of another card: FeitCSI (AX200, AX210), PicoScenes, nexmon, ESP32, Atheros CSI tool; recognised by its content.

    ``file`` is a path, bytes, or an object with ``read`` (binary). Keeps the frames of the senders ``macs`` that have the most frequent width and number of chains;
    ``CardLog.other_shapes`` counts the others, ``CardLog.damaged`` the stretches that could not be read.

    Raises :class:`LogError` if the file cannot be read, or is none of these kinds.
    """
    data = _file(file)
    if not isinstance(data, (str, bytes, os.PathLike)):
        data = data.read()
        if not isinstance(data, bytes):
            raise LogError('read() of the file object returned no bytes: open it in binary mode ("rb")')
    format, counts, fields = _native.read_card(data, _options.macs(macs))
    return CardLog("bytes" if isinstance(data, bytes) else os.fspath(data), format, counts, fields)
