"""Logs of cards other than the 5300."""

from __future__ import annotations

import io
import os
from pathlib import Path

import csi5300
import numpy as np
import pytest
from conftest import CAPTURES

CASES = Path(os.environ.get("CSI5300_CASES", CAPTURES.parent / "cases")) / "other-cards"


@pytest.mark.parametrize(
    ("name", "format", "shape", "dbm"),
    [
        ("feitcsi/HT20_2452.csi", "FeitCSI", (2, 1, 56), True),
        ("picoscenes/rx_by_iwl5300.csi", "PicoScenes", None, None),
        ("atheros/ath_csi_1.dat", "Atheros CSI tool", None, None),
        ("nexmon/example_4358.pcap", "nexmon pcap", None, None),
        ("esp32/example_csi.csv", "ESP32 CSV", None, True),
    ],
)
def test_each_kind_is_read(name: str, format: str, shape: tuple[int, ...] | None, dbm: bool | None) -> None:
    path = CASES / name
    if not path.is_file():
        pytest.skip(f"no {name} beside the captures")
    log = csi5300.read_card(path)
    assert log.format.startswith(format) and len(log) > 0 and format in repr(log)
    assert log.csi.dtype == np.complex64 and log.csi.shape[-1] == len(log.subcarriers)
    assert shape is None or log.csi.shape[1:] == shape
    assert dbm is None or log.rssi_in_dbm is dbm
    # Each index once; nexmon's and an ESP32's in FFT order.
    assert np.isfinite(log.csi).any() and len(np.unique(log.subcarriers)) == len(log.subcarriers)
    assert log.rssi.shape == log.csi.shape[:2]
    assert len(log.mac) == len(log.host_time) == len(log.t) == len(log)
    # The same from memory, and by sender.
    again = csi5300.read_card(path.read_bytes(), macs=log.mac[0] or None)
    assert 0 < len(again) <= len(log)
    assert len(csi5300.read_card(path, macs=[])) == 0
    with path.open("rb") as file:
        assert len(csi5300.read_card(file)) == len(log)
    if name.startswith("feitcsi"):
        # `read` translates it, wherever its bytes are.
        whole = csi5300.read(path)
        for source in (path.read_bytes(), io.BytesIO(path.read_bytes())):
            np.testing.assert_array_equal(csi5300.read(source).csi, whole.csi)
        assert len(whole) == len(log)
    else:
        # `read` must not take it for an empty log of the 5300.
        with pytest.raises(csi5300.LogError, match="read_card"):
            csi5300.read(path)
        with pytest.raises(csi5300.LogError, match=format.split()[0]):
            csi5300.read(path.read_bytes())
        with path.open("rb") as file, pytest.raises(csi5300.LogError, match="read_card"):
            csi5300.read(file)


def test_a_log_of_the_5300_is_not_of_another_card(rx: Path) -> None:
    with pytest.raises(csi5300.LogError, match=r"csi5300\.read reads"):
        csi5300.read_card(rx)
    with pytest.raises(csi5300.LogError, match="cannot read"):
        csi5300.read_card(rx.with_name("none.csi"))
    # A file opened as text is no path with that text.
    with rx.open(encoding="latin-1") as text, pytest.raises(csi5300.LogError, match="binary mode"):
        csi5300.read_card(text)  # type: ignore[arg-type]
