"""csiread's interface for Intel 5300 logs, over this package's decoder: ``import csi5300.csiread as csiread``.

:class:`Intel` has the attributes, methods, shapes and types of ``csiread.Intel`` (csiread 1.4.1); docs/guides/python.md lists the
differences and their reasons.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _native
from .._errors import LogError, LogNotFoundError
from .utils import calib, phy_fft, phy_ifft, scidx

__all__ = ["Intel", "calib", "phy_fft", "phy_ifft", "scidx"]

__version__ = "1.4.1"
"""The version of the csiread with this interface: scripts compare it."""

_FIELDS = ("timestamp_low", "bfee_count", "Nrx", "Ntx", "rssi_a", "rssi_b", "rssi_c", "noise", "agc", "rate")
_FRAMES = ("fc", "dur", "seq")
_ADDRESSES = ("addr_des", "addr_src", "addr_bssid")
_PACKETS = (*_FIELDS, "perm", "csi")
_OTHERS = (*_FRAMES, *_ADDRESSES, "payload")
_ALL = _PACKETS + _OTHERS
# In csiread's order of printing.
_RSSI = ("rssi_b", "rssi_c", "rssi_a")
_SHOWN = ("timestamp_low", "bfee_count", "Nrx", "Ntx", *_RSSI, "noise", "agc", "perm", "rate", "csi")
_SHOWN_OF_FRAMES = ("fc", "dur", "addr_src", "addr_des", "addr_bssid", "seq", "payload")


def _mapping(turns: list[list[float]]) -> list[complex]:
    """A unitary matrix with these angles, row by row, rounded to nine decimals."""
    values = (np.exp(2j * np.pi * np.array(turns)) / np.sqrt(len(turns))).ravel()
    return [*values, *[0j] * (9 - len(values))]


# csitool's sm_matrices.m, streams by transmit antennas: for 2 and 3 streams at 20 MHz, then at 40 MHz.
_SM = np.array(
    [
        _mapping([[0, 0], [0, 0.5]]),
        _mapping([[-1 / 16, -33 / 80, 3 / 80], [23 / 80, 13 / 48, 13 / 240], [-13 / 80, 37 / 240, 13 / 48]]),
        _mapping([[0, 0.25], [0.25, 0]]),
        _mapping([[-1 / 16, -13 / 80, 23 / 80], [-37 / 80, -11 / 48, -107 / 240], [7 / 80, -83 / 240, -11 / 48]]),
    ]
)


class Intel:
    """A log of the Intel 5300, as ``csiread.Intel`` reads it.

    ``file`` is a path, or None for :meth:`seek` and :meth:`pmsg`. ``nrxnum`` and ``ntxnum`` are the numbers of antennas and streams for
    which arrays have room, ``pl_size`` the bytes of frames kept in ``payload``, ``bufsize`` the most packets of :meth:`seek`.
    """

    count: int
    timestamp_low: NDArray[np.uint32]
    bfee_count: NDArray[np.intp]
    Nrx: NDArray[np.intp]
    Ntx: NDArray[np.intp]
    rssi_a: NDArray[np.intp]
    rssi_b: NDArray[np.intp]
    rssi_c: NDArray[np.intp]
    noise: NDArray[np.intp]
    agc: NDArray[np.intp]
    perm: NDArray[np.intp]
    rate: NDArray[np.intp]
    csi: NDArray[np.complex128]
    stp: NDArray[np.float64] | None
    fc: NDArray[np.intp]
    dur: NDArray[np.intp]
    addr_des: NDArray[np.intp]
    addr_src: NDArray[np.intp]
    addr_bssid: NDArray[np.intp]
    seq: NDArray[np.intp]
    payload: NDArray[np.uint8]

    def __init__(
        self,
        file: str | os.PathLike[str] | None,
        nrxnum: int = 3,
        ntxnum: int = 2,
        pl_size: int = 0,
        if_report: bool = True,
        bufsize: int = 0,
    ) -> None:
        self.file = None if file is None else os.fspath(file)
        if self.file is not None and not os.path.isfile(self.file):
            if os.path.exists(self.file):
                raise LogError(f"{self.file} is not a regular file, and Intel needs random access: use csi5300.read", self.file)
            raise LogNotFoundError(f"no such log: {self.file}", self.file)
        self.nrxnum, self.ntxnum, self.pl_size = nrxnum, ntxnum, pl_size
        self.if_report, self.bufsize = if_report, bufsize
        self.skipped = 0
        """Damaged stretches and impossible records of the last reading (csiread does not count them)."""
        self.count = 0
        self.stp = None
        nothing = {name: np.zeros(0, np.intp) for name in (*_FIELDS, *_FRAMES)}
        nothing |= {name: np.zeros((0, 6), np.intp) for name in _ADDRESSES}
        nothing |= {"perm": np.zeros((0, 3), np.intp), "payload": np.zeros((0, pl_size), np.uint8)}
        self._take({**nothing, "csi": np.zeros((0, 30, nrxnum, ntxnum), np.complex128)}, _ALL)

    def _take(self, arrays: dict[str, Any], names: Iterable[str]) -> None:
        """Stores arrays under their names, in csiread's types."""
        kept = {"timestamp_low": np.uint32, "payload": np.uint8, "csi": np.complex128}
        for name in names:
            # A view, like csiread's arrays: scripts use their `base`.
            setattr(self, name, arrays[name].astype(kept.get(name, np.intp), copy=False)[:])

    def __getitem__(self, index: Any) -> dict[str, Any]:
        return {name: getattr(self, name)[index] for name in _PACKETS}

    def read(self) -> None:
        """Reads the file: its packets with CSI (0xbb) and frames (0xc1)."""
        if self.file is None:
            raise LogError("no file was named: Intel(file), or seek(file, pos, num)")
        self._read(self.file, 0, 0)

    def seek(self, file: str | os.PathLike[str], pos: int, num: int) -> None:
        """Reads ``num`` packets with CSI (0: all) of a file from byte ``pos`` on."""
        if self.bufsize and num > self.bufsize:
            raise ValueError(f"num={num} is more than bufsize={self.bufsize}")
        self._read(os.fspath(file), pos, num or self.bufsize)

    def _read(self, file: str, pos: int, num: int) -> None:
        arrays = _native.classic(file, pos, num, (self.nrxnum, self.ntxnum), self.pl_size)
        n_rx, n_tx = arrays["largest"]
        if n_rx > self.nrxnum:
            raise ValueError(f"nrxnum={self.nrxnum} is too small!\n")
        if n_tx > self.ntxnum:
            raise ValueError(f"ntxnum={self.ntxnum} is too small!\n")
        self.skipped = arrays["skipped"]
        self._take(arrays, _ALL)
        self.count = len(self.timestamp_low)
        if self.if_report:
            kinds = (1 | 4 if len(self.fc) else 1) if self.count else 4
            print(f"connector_log={kinds:#x}")
            if kinds & 4:
                print(f"{len(self.fc)} 0xc1 packets parsed")
            if kinds & 1:
                print(f"{self.count} 0xbb packets parsed")
            if self.skipped:
                print(f"{self.skipped} damaged stretches skipped")

    def pmsg(self, data: bytes) -> int:
        """Reads one packet from a socket, code first; returns its code and stores its arrays (0xbb, 0xc1)."""
        if not data:
            return 0
        if len(data) > 0xFFFF:
            raise ValueError(f"a packet of {len(data)} bytes: records have 65,535 at most")
        # A record as in logs: its length, then code and body.
        record = len(data).to_bytes(2, "big") + bytes(data)
        arrays = _native.classic(record, 0, 0, (self.nrxnum, self.ntxnum), self.pl_size)
        n_rx, n_tx = arrays["largest"]
        if n_rx > self.nrxnum or n_tx > self.ntxnum:
            raise ValueError(f"nrxnum={self.nrxnum} or ntxnum={self.ntxnum} is too small!\n")
        kept, first = (_PACKETS, "timestamp_low") if data[0] == 0xBB else (_OTHERS, "fc")
        if data[0] in (0xBB, 0xC1) and len(arrays[first]):
            self._take(arrays, kept)
            self.count = 1
        return int(data[0])

    def readstp(self, endian: str = "little") -> float:
        """Reads the host times beside the log (``<file>stp``: seconds and microseconds, u32 each) into ``stp``; returns the first."""
        if self.file is None:
            raise LogError("no file was named: Intel(file)")
        name = self.file + "stp"
        if not os.path.isfile(name):
            raise LogNotFoundError(f"no host times beside the log: {name}", name)
        words = np.fromfile(name, dtype="<u4" if endian == "little" else ">u4")
        pairs = words[: len(words) // 2 * 2].reshape(-1, 2)
        stp: NDArray[np.float64] = pairs[:, 0] + pairs[:, 1] / 1e6
        self.stp = stp
        return float(stp[0])

    def get_total_rss(self) -> NDArray[np.float64]:
        """Received power of each packet over all antennas, dBm; 0 if all RSSI are 0."""
        power = np.zeros(self.count)
        for rssi in (self.rssi_a, self.rssi_b, self.rssi_c):
            power += np.where(rssi > 0, 10 ** (rssi / 10.0), 0.0)
        heard = power > 0
        level: NDArray[np.float64] = np.where(heard, 10 * np.log10(np.where(heard, power, 1.0)) - 44 - self.agc, 0.0)
        return level

    def _columns(self, *names: str) -> list[NDArray[np.int64]]:
        return [np.ascontiguousarray(getattr(self, name), np.int64) for name in names]

    def get_scaled_csi(self, inplace: bool = False) -> NDArray[np.complex128]:
        """(count, 30, nrxnum, ntxnum) CSI in sqrt(SNR); ``inplace`` replaces ``csi``."""
        fields = self._columns("rssi_a", "rssi_b", "rssi_c", "agc", "noise", "Nrx", "Ntx")
        csi = np.ascontiguousarray(self.csi, np.complex128)
        out = csi if inplace else np.empty_like(csi)
        _native.classic_scaled(None if inplace else csi, fields, out)
        if inplace and out is not self.csi:
            self.csi[...] = out
        return self.csi if inplace else out

    def get_scaled_csi_sm(self, inplace: bool = False) -> NDArray[np.complex128]:
        """The same with the transmitter's spatial mapping removed."""
        scaled = self.get_scaled_csi(inplace)
        unmapped = self._unmap(scaled)
        if inplace and unmapped is not scaled:
            scaled[...] = unmapped
        return scaled if inplace else unmapped

    def apply_sm(self, scaled_csi: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Removes the spatial mapping of Intel transmitters: columns become transmit antennas."""
        return self._unmap(np.array(scaled_csi, np.complex128, order="C"))

    def _unmap(self, csi: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """The same in place, for memory in C order."""
        csi = np.ascontiguousarray(csi)
        if csi.ndim != 4:
            raise ValueError(f"an array of {csi.ndim} dimensions is not CSI, which has 4")
        n_tx, rate = self._columns("Ntx", "rate")
        _native.classic_unmapped(csi, n_tx, rate, _SM)
        return csi

    def display(self, index: int) -> None:
        """Prints a packet."""
        values = {name: getattr(self, name)[index] for name in _SHOWN}
        values["csi"] = values["csi"].shape
        if len(self.fc) > index:
            values |= {name: getattr(self, name)[index] for name in _SHOWN_OF_FRAMES}
            for name in _ADDRESSES:
                values[name] = bytes(values[name].tolist()).hex(":")
            values["payload"] = values["payload"].tobytes().hex(" ")
        lines = {"file": self.file, "count": self.count, **values}
        print("\n".join([f"{index}th packet:", *(f"  {name:<20}: {value}" for name, value in lines.items())]))
