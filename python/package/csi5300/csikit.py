"""CSIKit's interface for Intel 5300 logs, over this package's decoder, for scripts written for CSIKit::

    from csi5300.csikit import csitools, get_reader    # for CSIKit.reader.get_reader and CSIKit.util.csitools
    data = get_reader("rx.dat").read_file("rx.dat", scaled=True)
    csi, frames, subcarriers = csitools.get_CSI(data, metric="amplitude")

docs/guides/python.md lists where it differs from CSIKit 2.5.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._errors import OptionError
from ._log import Log, read

__all__ = ["CSIData", "IWLBeamformReader", "IWLCSIFrame", "csitools", "get_reader"]


@dataclass(eq=False)
class IWLCSIFrame:
    """A frame: the fields of its record, and ``csi_matrix``, complex64 (30, n_rx, n_tx)."""

    timestamp_low: int
    bfee_count: int
    n_rx: int
    n_tx: int
    rssi_a: int
    rssi_b: int
    rssi_c: int
    noise: int
    agc: int
    rate: int
    csi_matrix: NDArray[np.complex64]


@dataclass(eq=False)
class CSIData:
    """A log: its frames, and ``timestamps``, seconds after the first by the card's clock."""

    filename: str
    frames: list[IWLCSIFrame] = field(default_factory=list)
    timestamps: list[float] = field(default_factory=list)
    filter_mac: str | None = None
    expected_frames: int = 0
    chipset: str = "Intel IWL5300"
    backend: str = "Linux 802.11n CSI Tool"
    bandwidth: int = 20


def _rows(log: Log, k: int) -> list[int]:
    """The rows of frame ``k``: antennas A, B, C if it has three chains, otherwise its chains in order."""
    chains = int(log.n_rx[k])
    if not log.antennas_known[k]:
        return list(range(chains))
    rows = [log.antennas.index("ABC"[antenna]) for antenna in log.antenna_order[k].compressed()]
    return sorted(rows) if chains == 3 else rows


class IWLBeamformReader:
    """Reads logs of the CSI tool and of the WSR toolbox."""

    def read_file(self, path: str | os.PathLike[str], scaled: bool = False, filter_mac: str | None = None) -> CSIData:
        """The frames of a log, only those of the sender ``filter_mac`` if given; ``scaled`` to sqrt(SNR). Damage is skipped.

        Raises :class:`LogError` for an unreadable file, and for another kind of file, which the message names.
        """
        log = read(path, macs=filter_mac)
        csi, noise = log.scaled() if scaled else log.csi, log._columns["noise_dbm"]
        names = ("timestamp_low", "bfee_count", "n_rx", "n_tx")
        fields = zip(*(getattr(log, name).tolist() for name in names), strict=True)
        data = CSIData(os.path.basename(path), filter_mac=filter_mac, expected_frames=len(log))
        data.timestamps = (log.t - log.t[:1].sum()).tolist()
        for k, of in enumerate(fields):
            matrix = csi[k][_rows(log, k), : of[3]].transpose(2, 0, 1).astype(np.complex64)
            values: list[Any] = [*of, *log.rssi[k].tolist(), int(noise[k]), int(log.agc[k]), int(log.rate[k]), matrix]
            data.frames.append(IWLCSIFrame(*values))
        return data


def get_reader(path: str | os.PathLike[str]) -> IWLBeamformReader:
    """The reader of ``path``: there is one for all; its :meth:`~IWLBeamformReader.read_file` recognises other kinds of files."""
    return IWLBeamformReader()


class csitools:
    """``CSIKit.util.csitools``."""

    @staticmethod
    def get_CSI(
        csi_data: CSIData, metric: str = "amplitude", extract_as_dBm: bool = True, squeeze_output: bool = False
    ) -> tuple[NDArray[Any], int, int]:
        """``(csi, frames, subcarriers)``, csi of (n, 30, n_rx, n_tx), with the first frame's number of chains and streams.

        ``metric`` is ``"amplitude"`` (dB with ``extract_as_dBm``), ``"phase"`` (radians), or ``"complex"``. As in CSIKit, frames with fewer
        chains or streams are skipped, here and in ``timestamps``; ``frames`` counts them.
        """
        if not csi_data.frames:
            raise OptionError(f"{csi_data.filename} has no frame with CSI")
        subcarriers, rows, columns = csi_data.frames[0].csi_matrix.shape
        fits = [frame.n_rx >= rows and frame.n_tx >= columns for frame in csi_data.frames]
        whole = [frame.csi_matrix[:, :rows, :columns] for frame, fit in zip(csi_data.frames, fits, strict=True) if fit]
        # The first call has shortened them.
        if len(csi_data.timestamps) == len(fits):
            csi_data.timestamps = [t for t, fit in zip(csi_data.timestamps, fits, strict=True) if fit]
        csi: NDArray[Any] = np.stack(whole).astype(np.complex128)
        if metric == "amplitude":
            csi = np.abs(csi)
            with np.errstate(divide="ignore"):
                csi = 20 * np.log10(csi) if extract_as_dBm else csi
        elif metric == "phase":
            csi = np.angle(csi)
        return (np.squeeze(csi) if squeeze_output else csi), len(csi_data.frames), subcarriers
