from __future__ import annotations

from pathlib import Path
from typing import Any

import csi5300
import csi5300.plot
import numpy as np
import pytest
from numpy.typing import NDArray


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


def test_an_empty_log_is_a_table(rx: Path) -> None:
    pl = pytest.importorskip("polars")
    log = csi5300.read(rx)
    nothing = log[:0].to_polars()
    assert nothing.schema == log.to_polars().schema and nothing.height == 0
    assert pl.concat([nothing, log.to_polars()]).height == len(log)
    assert csi5300.read(b"").to_polars().height == 0


def _drawn(figure: Any) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Edges of the first heat map's cells along time, and which cells are drawn."""
    mesh = figure.axes[0].collections[0]
    cells: NDArray[np.bool_] = np.isfinite(np.ma.filled(mesh.get_array(), np.nan))
    return mesh.get_coordinates()[0, :, 0], np.logical_or.reduce(cells, axis=0)


def test_a_pause_is_white(rx: Path) -> None:
    pytest.importorskip("matplotlib")
    log = csi5300.read(rx)
    # A pause of an hour in the middle, and one of a second.
    columns = {**log._columns, "time_us": log.time_us.copy()}
    columns["time_us"][100:] += 3_600_000_000
    columns["time_us"][200:] += 1_000_000
    with_pauses = csi5300.Log(log._records, columns, log.info, log.antennas, None, log.streams)
    edges, is_drawn = _drawn(with_pauses.plot())
    assert (np.diff(edges) > 0).all()
    widths = np.diff(edges)
    assert widths[is_drawn].sum() < 2 * (log.t[-1] - log.t[0]) and widths[~is_drawn].sum() > 3_599
    assert is_drawn.sum() == len(log), "no frame is left out for a pause"
    edges, is_drawn = _drawn(log[::-1].plot())
    assert (np.diff(edges) > 0).all() and is_drawn.all()
    # A slow log has no pauses, and neither has one of which few frames are drawn.
    columns["time_us"] = log.time_us * 100
    assert _drawn(csi5300.Log(log._records, columns, log.info, log.antennas).plot())[1].all()
    # Frames without times are drawn by number.
    columns["time_us"] = np.full(len(log), 7)
    edges, is_drawn = _drawn(csi5300.Log(log._records, columns, log.info, log.antennas).plot())
    assert is_drawn.all() and np.allclose(np.diff(edges), 1)


def test_a_heat_map_has_one_sender(rx: Path, tx: Path) -> None:
    pytest.importorskip("matplotlib")
    some = tx.read_bytes()
    log, both = csi5300.read(rx), csi5300.read(rx.read_bytes() + some[: len(some) // 2])
    assert len(set(both.mac)) == 2
    figure = both.plot()
    assert np.array_equal(_drawn(figure)[0], _drawn(log.plot())[0])
    assert figure.axes[0].get_title().endswith(f", sender {log.mac[0]}") and "sender" not in log.plot().axes[0].get_title()


def test_pictures(rx: Path, tx: Path, path_csv: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    log = csi5300.read(rx)
    (bearing,) = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, without="near-field")
    for number, figure in enumerate((log.plot(), log.plot(antenna="a"), bearing.plot(), csi5300.plot.trajectory([bearing]))):
        figure.savefig(tmp_path / f"{number}.png")
        assert (tmp_path / f"{number}.png").stat().st_size > 5_000
        assert figure._repr_png_().startswith(b"\x89PNG"), "what notebooks show"  # type: ignore[attr-defined, unused-ignore]
    for antenna in ("C" if "C" not in log.antennas else "D", "AB", "", 0):
        with pytest.raises(csi5300.OptionError, match="antenna"):
            log.plot(antenna=antenna)  # type: ignore[arg-type]
    with pytest.raises(csi5300.OptionError, match="stream"):
        log.plot(stream=3)
    legend = bearing.plot(truth_deg=120.0).axes[0].get_legend()
    assert legend and "truth 120.0 deg" in [text.get_text() for text in legend.get_texts()]
    with pytest.raises(csi5300.OptionError, match="bearings"):
        csi5300.plot.trajectory([])
    with pytest.raises(csi5300.OptionError):
        csi5300.read(b"").plot()
