"""Compares every shared log with csiread's and CSIKit's reading. Both read 18 bytes of the WSR layout's header as CSI, so they get the
same records without these; CSIKit runs in its own interpreter (CSIKIT_PYTHON: it fails with NumPy 2) and is slow, so it gets fewer."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import csi5300
import numpy as np
import pytest
from conftest import CAPTURES
from numpy.typing import NDArray

# By name, so that new captures, or a folder with more, do not change the comparison.
LOGS = sorted(log for folder in ("csitool", "paper", "wsr") for log in (CAPTURES / folder).rglob("*.dat"))
FEW = 100
CSIKIT = """
import sys, warnings
warnings.simplefilter("ignore")
import numpy as np
from CSIKit.reader import IWLBeamformReader
for log in sys.argv[1:]:
    frames = IWLBeamformReader().read_file(log).frames
    np.savez(log + ".npz", *[frame.csi_matrix for frame in frames])
"""


def _stock(log: csi5300.Log, data: bytes, out: Path, most: int | None = None) -> None:
    """The log's records in the stock layout, and nothing else."""
    records = []
    for at in log.offset[:most].tolist():
        length = int.from_bytes(data[at : at + 2], "big")
        record = data[at : at + 2 + length]
        csi = int.from_bytes(record[19:21], "little")
        body = record[3:23] + record[len(record) - csi :]
        records.append((len(body) + 1).to_bytes(2, "big") + b"\xbb" + body)
    out.write_bytes(b"".join(records))


def _by_antenna(log: csi5300.Log, csi: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """(n, 30, 3, 3): subcarrier, antenna, stream; 0 for missing values."""
    out = np.zeros((len(log), 30, 3, 3), np.complex64)
    rows = ["ABC".index(letter) for letter in log.antennas]
    out[:, :, rows, : log.streams] = np.nan_to_num(csi).transpose(0, 3, 1, 2)
    return out


@pytest.mark.parametrize("path", LOGS, ids=lambda path: str(path.relative_to(CAPTURES)))
def test_csiread(path: Path, tmp_path: Path) -> None:
    csiread = pytest.importorskip("csiread")
    log = csi5300.read(path)
    _stock(log, path.read_bytes(), tmp_path / "stock.dat")
    other = csiread.Intel(str(tmp_path / "stock.dat"), nrxnum=3, ntxnum=3, if_report=False)
    other.read()
    assert other.count == len(log) > 0
    for name, own in (("timestamp_low", log.timestamp_low), ("bfee_count", log.bfee_count), ("agc", log.agc), ("rate", log.rate)):
        assert np.array_equal(getattr(other, name), own), name
    for column, name in enumerate(("rssi_a", "rssi_b", "rssi_c")):
        assert np.array_equal(getattr(other, name), log.rssi[:, column]), name
    # If antenna_sel is not a permutation, csiread writes chains over each other (docs/guides/python.md).
    known = log.antennas_known
    assert known.mean() > 0.5 and np.array_equal(_by_antenna(log, log.csi)[known], other.csi[known])
    heard = known & (log.rssi.sum(axis=1) > 0) & np.isfinite(log.scale)
    own, theirs = _by_antenna(log, log.scaled())[heard], other.get_scaled_csi()[heard]
    assert np.allclose(own, theirs, rtol=1e-5, atol=1e-6)


def test_csikit(captures: Path, tmp_path: Path) -> None:
    python = os.environ.get("CSIKIT_PYTHON")
    if not python:
        pytest.skip("CSIKIT_PYTHON names no interpreter with CSIKit")
    logs = {}
    for number, path in enumerate(LOGS):
        copy = tmp_path / f"{number}.dat"
        logs[copy] = log = csi5300.read(path)
        _stock(log, path.read_bytes(), copy, FEW)
    run = subprocess.run([python, "-c", CSIKIT, *map(str, logs)], capture_output=True, text=True, timeout=600, check=False)
    assert run.returncode == 0, run.stderr
    compared = 0
    for copy, log in logs.items():
        theirs = list(np.load(f"{copy}.npz").values())
        # It skips records that begin within the last 100 bytes.
        assert len(theirs) in (len(log[:FEW]), len(log[:FEW]) - 1)
        for k, csi in enumerate(theirs):
            if not log.antennas_known[k]:
                continue
            rows = [log.antennas.index("ABC"[antenna]) for antenna in log.antenna_order[k].compressed()]
            # Three chains by antenna; fewer in their own order.
            rows = sorted(rows) if len(rows) == 3 else rows
            assert np.array_equal(csi.transpose(1, 2, 0), log.csi[k][rows][:, : log.n_tx[k]]), (copy, k)
            compared += 1
    assert compared > 30 * len(logs)
