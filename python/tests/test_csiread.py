"""Compares with csiread itself, if installed: everything is equal except for the list in docs/guides/python.md."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import csi5300.csiread
import numpy as np
import pytest
from conftest import CSITOOL
from numpy.typing import NDArray
from oracle import packets

FIELDS = ("timestamp_low", "bfee_count", "Nrx", "Ntx", "rssi_a", "rssi_b", "rssi_c", "noise", "agc", "perm", "rate")
FRAMES = ("fc", "dur", "addr_des", "addr_src", "addr_bssid", "seq", "payload")


@pytest.fixture
def theirs() -> ModuleType:
    module: ModuleType = pytest.importorskip("csiread")
    return module


def stock(path: Path) -> bool:
    """csiread reads the WSR layout's header as CSI."""
    data = path.read_bytes()
    first = next(packets(data), None)
    return first is not None and first.csi.shape[1:] == (first.n_rx, first.n_tx) and _length(data, first.offset) == 20


def _length(data: bytes, at: int) -> int:
    length = int.from_bytes(data[at : at + 2], "big") - 1
    return length - int.from_bytes(data[at + 19 : at + 21], "little")


STOCK = [path for path in CSITOOL if stock(path)]


@pytest.mark.parametrize("path", STOCK, ids=lambda path: path.name)
def test_fields_and_csi_equal_csireads(path: Path, theirs: ModuleType) -> None:
    args: dict[str, Any] = {"nrxnum": 3, "ntxnum": 3, "pl_size": 64, "if_report": False}
    own, other = csi5300.csiread.Intel(str(path), **args), theirs.Intel(str(path), **args)
    own.read()
    other.read()
    assert own.count == other.count > 0
    for name in FIELDS + FRAMES:
        a, b = getattr(own, name), getattr(other, name)
        assert a.dtype == b.dtype and np.array_equal(a, b), name
    # If antenna_sel is not a permutation, csiread writes chains over each other, or outside the array.
    order = np.array([len(set(p[:n])) == n and p[:n].max() < 3 for p, n in zip(own.perm, own.Nrx, strict=True)])
    assert own.csi.dtype == other.csi.dtype and own.csi.shape == other.csi.shape
    assert np.array_equal(own.csi[order], other.csi[order]) and order.mean() > 0.5
    heard = order & ((own.rssi_a + own.rssi_b + own.rssi_c) > 0)
    scaled, reference = own.get_scaled_csi(), other.get_scaled_csi()
    assert np.allclose(scaled[heard], reference[heard], rtol=1e-12, atol=0)
    assert np.allclose(own.apply_sm(scaled)[heard], other.apply_sm(reference)[heard], rtol=1e-12, atol=1e-12)
    assert own[3:5]["csi"].shape == other[3:5]["csi"].shape
    # Scaling one object twice: csiread adds the received power of the first scaling to the second's.
    assert np.array_equal(own.get_scaled_csi(), scaled, equal_nan=True)
    assert not np.allclose(other.get_scaled_csi()[heard], reference[heard])


@pytest.mark.parametrize("path", STOCK[:1], ids=lambda path: path.name)
def test_seek_pmsg_and_refusals(path: Path, theirs: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    own, other = csi5300.csiread.Intel(None, ntxnum=3, bufsize=8), theirs.Intel(None, ntxnum=3, bufsize=8)
    for reader in (own, other):
        reader.seek(str(path), 0, 5)
    assert own.count == other.count == 5 and np.array_equal(own.csi, other.csi)
    data = path.read_bytes()
    length = int.from_bytes(data[:2], "big")
    own, other = (module.Intel(None, ntxnum=3) for module in (csi5300.csiread, theirs))
    assert own.pmsg(data[2 : 2 + length]) == other.pmsg(data[2 : 2 + length])
    for name in ("csi", "agc", "perm") if data[2] == 0xBB else ("fc", "seq"):
        assert np.array_equal(getattr(own, name), getattr(other, name)), name
    if data[2] == 0xBB:
        # `recv()[36:]` of a netlink socket has the datagram's padding after the record.
        padded = csi5300.csiread.Intel(None, ntxnum=3)
        assert padded.pmsg(data[2 : 2 + length] + bytes(3)) == 0xBB and np.array_equal(padded.csi, own.csi)
    for module in (csi5300.csiread, theirs):
        if max(p.n_rx for p in packets(data)) > 1:
            with pytest.raises(ValueError, match="nrxnum=1 is too small"):
                module.Intel(str(path), nrxnum=1, ntxnum=3, if_report=False).read()
    own.display(0)
    assert "timestamp_low" in capsys.readouterr().out


@pytest.mark.parametrize("path", [p for p in STOCK if Path(f"{p}stp").exists()], ids=lambda path: path.name)
def test_host_times_equal_csireads(path: Path, theirs: ModuleType) -> None:
    own, other = csi5300.csiread.Intel(str(path)), theirs.Intel(str(path))
    assert own.readstp() == other.readstp() and own.stp is not None and np.array_equal(own.stp, other.stp)


# csiread runs in a process of its own: it writes beyond its buffers, and a missing file ends the process.
THEIRS = """
import sys
import csiread
import numpy as np

log = csiread.Intel(None, nrxnum=3, ntxnum=3, if_report=False, bufsize=5000)
log.seek(sys.argv[1], 0, 5000)
np.save(sys.argv[2], log.csi)
"""


def _theirs(log: Path, out: Path) -> tuple[int, NDArray[np.complex128] | None]:
    """csiread's exit status, and the CSI of the packets that it read."""
    run = subprocess.run([sys.executable, "-c", THEIRS, str(log), str(out)], capture_output=True, timeout=120, check=False)
    return run.returncode, np.load(out) if out.exists() else None


def test_logs_that_csiread_cannot_read(rx: Path, tmp_path: Path) -> None:
    # The WSR layout, and a damaged log: csiread reads 18 header bytes as CSI, and ends the process or stops reading.
    reader = csi5300.csiread.Intel(rx, if_report=False)
    reader.read()
    log = csi5300.read(rx)
    chosen = reader.csi[:, :, ["ABC".index(letter) for letter in log.antennas], :1]
    assert np.array_equal(chosen.transpose(0, 2, 3, 1), log.csi)
    assert np.allclose(reader.get_scaled_csi()[:, :, 0, 0], log.scaled()[:, 0, 0], rtol=1e-6)
    data = bytearray(rx.read_bytes())
    at = int(log.offset[20])
    data[at : at + 10] = b"\xff" * 10
    (tmp_path / "broken.dat").write_bytes(data)
    broken = csi5300.csiread.Intel(str(tmp_path / "broken.dat"), if_report=False)
    broken.read()
    assert broken.skipped >= 1 and reader.count - 3 <= broken.count < reader.count
    with pytest.raises(FileNotFoundError):
        csi5300.csiread.Intel(str(tmp_path / "none.dat"))
    with pytest.raises(ValueError, match="at most"):
        csi5300.csiread.Intel(None).pmsg(bytes(70_000))
    assert csi5300.csiread.Intel(None).pmsg(b"") == 0 and csi5300.csiread.Intel(None).pmsg(b"\xbbshort") == 0xBB
    with pytest.raises(ValueError, match="an array of 1 dimensions is not CSI"):
        csi5300.csiread.Intel(None).apply_sm(np.zeros(3, np.complex128))


def test_csiread_fails_on_these_logs(rx: Path, tmp_path: Path) -> None:
    pytest.importorskip("csiread")
    reader = csi5300.csiread.Intel(rx, nrxnum=3, ntxnum=3, if_report=False)
    reader.read()
    status, csi = _theirs(rx, tmp_path / "wsr.npy")
    assert status == 0 and csi is not None and csi.shape == reader.csi.shape
    assert not (csi == reader.csi).all(axis=(1, 2, 3)).any(), "a record of the WSR layout is read"
    assert _theirs(tmp_path / "none.dat", tmp_path / "none.npy") == (255, None), "a missing file ends the process"


@pytest.mark.parametrize("path", STOCK[-1:], ids=lambda path: path.name)
def test_csiread_loses_records_after_damage(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("csiread")
    data = bytearray(path.read_bytes())
    at = int(csi5300.read(path).offset[20])
    data[at : at + 10] = b"\xff" * 10
    (tmp_path / "broken.dat").write_bytes(data)
    broken = csi5300.csiread.Intel(str(tmp_path / "broken.dat"), nrxnum=3, ntxnum=3, if_report=False)
    broken.read()
    status, csi = _theirs(tmp_path / "broken.dat", tmp_path / "broken.npy")
    assert status == 0 and csi is not None and len(csi) < broken.count // 2


@pytest.mark.parametrize("path", STOCK[:1], ids=lambda path: path.name)
def test_a_packet_is_printed_as_csiread_prints_it(path: Path, theirs: ModuleType, capfd: pytest.CaptureFixture[str]) -> None:
    said = []
    for module in (csi5300.csiread, theirs):
        log = module.Intel(str(path), ntxnum=3, pl_size=8, if_report=False)
        assert log.stp is None
        log.read()
        capfd.readouterr()
        log.display(0)
        said.append(capfd.readouterr().out)
    assert said[0] == said[1]


@pytest.mark.parametrize("path", STOCK, ids=lambda path: path.name)
def test_a_report_equals_csireads(path: Path) -> None:
    pytest.importorskip("csiread")
    said = []
    for module in ("csiread", "csi5300.csiread"):
        report = f"from {module} import Intel; import sys; Intel(sys.argv[1], ntxnum=3).read()"
        run = subprocess.run([sys.executable, "-c", report, str(path)], capture_output=True, text=True, timeout=120, check=True)
        said.append(run.stdout)
    assert said[0] == said[1] and "0xbb packets parsed" in said[0]


def test_csireads_utilities() -> None:
    theirs = pytest.importorskip("csiread")
    from csi5300.csiread.utils import calib, phy_fft, phy_ifft, scidx

    assert csi5300.csiread.__version__ == theirs.__version__
    for bw in (20, 40):
        for ng in (1, 2, 4):
            indices = scidx(bw, ng)
            assert np.array_equal(indices, theirs.scidx(bw, ng)), (bw, ng)
            generator = np.random.default_rng(1)
            csi = generator.normal(size=(4, len(indices), 3)) + 1j * generator.normal(size=(4, len(indices), 3))
            phase = np.unwrap(np.angle(csi), axis=1)
            assert np.allclose(calib(phase, indices), theirs.calib(phase, indices))
            delays = phy_ifft(csi, indices)
            assert np.allclose(delays, theirs.phy_ifft(csi, indices))
            assert np.allclose(phy_fft(delays, indices), theirs.phy_fft(delays, indices))
    assert np.array_equal(scidx(20, 2), csi5300.read(CSITOOL[0])[:1].subcarriers) if CSITOOL else True
    with pytest.raises(ValueError, match="bw=80"):
        scidx(80, 2)
