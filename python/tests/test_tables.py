from __future__ import annotations

from pathlib import Path

import csi5300
import csi5300.plot
import numpy as np
import pytest


def test_xarray(rx: Path) -> None:
    pytest.importorskip("xarray")
    log = csi5300.read(rx)
    data = log.to_xarray(scaled=True)
    assert data.csi.dims == ("time", "rx", "tx", "subcarrier") and data.csi.attrs["units"] == "sqrt(SNR)"
    assert np.array_equal(data.csi.sel(rx="A", tx=1, subcarrier=-28).values, log.scaled()[:, 0, 0, 0])
    assert np.array_equal(data.time.values, log.t) and np.array_equal(data.mac.values, log.mac)


def test_pandas(rx: Path) -> None:
    pytest.importorskip("pandas")
    log = csi5300.read(rx)
    table = log.to_pandas()
    assert len(table) == len(log) and table.frame.dtype == "Int64"
    assert np.array_equal(table.rssi_a.to_numpy(), log.rssi[:, 0])
    assert table.noise.isna().sum() == log.noise.mask.sum()


def test_polars(rx: Path) -> None:
    pl = pytest.importorskip("polars")
    log = csi5300.read(rx)
    table = log.to_polars()
    assert table["csi_re"].dtype == pl.Array(pl.Float32, log.csi.shape[1:])
    assert np.array_equal(table["csi_re"].to_numpy() + 1j * table["csi_im"].to_numpy(), log.csi, equal_nan=True)
    assert table["noise"].null_count() == log.noise.mask.sum()


def test_pictures(rx: Path, tx: Path, path_csv: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    log = csi5300.read(rx)
    (bearing,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, without="near-field")
    for number, figure in enumerate((log.plot(), log.plot(antenna="a"), bearing.plot(), csi5300.plot.trajectory([bearing]))):
        figure.savefig(tmp_path / f"{number}.png")
        assert (tmp_path / f"{number}.png").stat().st_size > 5_000
        assert figure._repr_png_().startswith(b"\x89PNG"), "what notebooks show"
    with pytest.raises(csi5300.OptionError):
        log.plot(antenna="C" if "C" not in log.antennas else "D")
    with pytest.raises(csi5300.OptionError):
        csi5300.read(b"").plot()
