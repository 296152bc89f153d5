"""Exports as other programs read them: each value compared with the log's own arrays."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import csi5300
import numpy as np
import pytest
from conftest import CIRCLE, CSITOOL, STAMP

LOGS = [CIRCLE / f"csi_rx_{STAMP}.dat", *CSITOOL]
RENAMED = {"rate_n_flags": "rate", "frame_count": "frame"}
TYPES = {
    "time_us": np.int64,
    "timestamp_low": np.uint32,
    "bfee_count": np.uint16,
    "n_rx": np.uint8,
    "agc": np.uint8,
    "rate_n_flags": np.uint16,
    "offset": np.int64,
    "total_rss_dbm": np.float64,
}


def _same(log: csi5300.Log, name: str, values: np.ndarray[Any, Any]) -> None:
    own = log.total_rss if name == "total_rss_dbm" else getattr(log, RENAMED.get(name, name))
    assert np.array_equal(values, own, equal_nan=name == "total_rss_dbm"), name


@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.name)
@pytest.mark.parametrize("scaled", [False, True])
def test_npz(path: Path, scaled: bool, tmp_path: Path) -> None:
    log = csi5300.read(path)
    unscaled = log.write(tmp_path / "log.npz", scaled=scaled)
    arrays = np.load(tmp_path / "log.npz")
    csi = log.scaled() if scaled else log.csi
    assert arrays["csi"].dtype == np.complex64
    assert np.array_equal(arrays["csi"].transpose(0, 2, 3, 1), csi, equal_nan=True)
    for name, dtype in TYPES.items():
        assert arrays[name].dtype == dtype and arrays[name].shape == (len(log),)
        _same(log, name, arrays[name])
    assert arrays["mac"].shape == (len(log), 6) and arrays["scaled"][0] == scaled
    assert "".join("ABC"[k] for k in arrays["antennas"]) == log.antennas
    assert np.array_equal(arrays["subcarriers"], log.subcarriers)
    assert unscaled == (np.isnan(log.scale).sum() if scaled else 0)


@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.name)
def test_mat(path: Path, tmp_path: Path) -> None:
    io = pytest.importorskip("scipy.io")
    log = csi5300.read(path)
    log.write(tmp_path / "log.mat", scaled=True)
    arrays = io.loadmat(tmp_path / "log.mat")
    assert arrays["csi"].shape == (30, log.streams, len(log.antennas), len(log))
    assert np.array_equal(arrays["csi"].transpose(3, 2, 1, 0), log.scaled(), equal_nan=True)
    for name, dtype in TYPES.items():
        assert arrays[name].shape == (1, len(log)) and arrays[name].dtype == dtype
        _same(log, name, arrays[name].ravel())
    assert arrays["mac"].shape == (6, len(log)) and arrays["scaled"].item() == 1


OCTAVE = """
log = load(argv(){1});
names = argv()(2:end);
for k = 1:numel(names)
    values = log.(names{k});
    printf("%s %s\\n", class(values), mat2str(size(values)));
    to = fopen([names{k} ".bin"], "w");
    fwrite(to, real(values), class(values));
    fwrite(to, imag(values), class(values));
    fclose(to);
end
"""


@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.name)
def test_mat_in_octave(path: Path, tmp_path: Path) -> None:
    octave = shutil.which("octave-cli")
    if octave is None:
        pytest.skip("no octave-cli: apt-get install --no-install-recommends octave (260 MB)")
    log = csi5300.read(path)
    log.write(tmp_path / "log.mat", scaled=True)
    (tmp_path / "values.m").write_text(OCTAVE)
    names = ["csi", "mac", *TYPES]
    command = [octave, "--norc", "--quiet", "values.m", "log.mat", *names]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    said.check_returncode()
    classes: dict[Any, str] = {np.float32: "single", np.float64: "double"}
    # Octave drops a trailing dimension of size 1.
    sizes = [30, log.streams, len(log.antennas), len(log)]
    expected = [f"single [{' '.join(map(str, sizes))}]", f"uint8 [6 {len(log)}]"]
    expected += [f"{classes.get(dtype, np.dtype(dtype).name)} [1 {len(log)}]" for dtype in TYPES.values()]
    assert said.stdout.splitlines() == expected
    re, im = np.fromfile(tmp_path / "csi.bin", np.float32).reshape(2, *reversed(sizes))
    assert np.array_equal(re + 1j * im, log.scaled(), equal_nan=True), "column by column in Octave, row by row here"
    for name, dtype in TYPES.items():
        _same(log, name, np.fromfile(tmp_path / f"{name}.bin", dtype)[: len(log)])


@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.name)
def test_parquet_in_polars(path: Path, tmp_path: Path) -> None:
    pl = pytest.importorskip("polars")
    log = csi5300.read(path)
    log.write(tmp_path / "raw.parquet")
    table = pl.read_parquet(tmp_path / "raw.parquet")
    raw = table.select(pl.col("csi_re").list.to_array(log.csi[0].size) if table["csi_re"].dtype == pl.List else "csi_re")
    values = raw["csi_re"].to_numpy().reshape(log.csi.shape)
    assert np.array_equal(values.astype(np.float32), log.csi.real, equal_nan=True)
    assert table["csi_re"].dtype.inner == pl.Int8, "integers as integers"
    assert table["time_us"].to_list() == log.time_us.tolist() and table["mac"].fill_null("").to_list() == log.mac.tolist()
    assert table["noise_dbm"].null_count() == log.noise.mask.sum()
    assert (table["host_time"].dt.replace_time_zone(None).to_numpy() == log.host_time).sum() == (~np.isnat(log.host_time)).sum()


def test_parquet_in_duckdb(rx: Path, tmp_path: Path) -> None:
    duckdb = pytest.importorskip("duckdb")
    log = csi5300.read(rx)
    log.write(tmp_path / "log.parquet", scaled=True)
    query = f"select count(*), max(agc), avg(list_inner_product(csi_re::FLOAT[], csi_re::FLOAT[])) from '{tmp_path}/log.parquet'"
    ((frames, agc, power),) = duckdb.sql(query).fetchall()
    assert (frames, agc) == (len(log), log.agc.max())
    assert power == pytest.approx(np.sum(log.scaled().real.astype(np.float64) ** 2, axis=(1, 2, 3)).mean(), rel=1e-5)
    units = duckdb.sql(f"select decode(value) from parquet_kv_metadata('{tmp_path}/log.parquet') where decode(key) = 'csi5300.scaled'")
    assert units.fetchall() == [("true",)]


def test_units_are_in_the_schema(rx: Path, tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    csi5300.read(rx).write(tmp_path / "log.parquet")
    schema = pq.read_schema(tmp_path / "log.parquet")
    assert schema.field("agc").metadata[b"unit"] == b"dB"
    assert schema.metadata[b"csi5300.subcarriers"].startswith(b"-28,-26,")
    assert schema.metadata[b"csi5300.csi_shape"] == b"3,1,30"


def test_parts_of_a_log_and_refusals(rx: Path, tmp_path: Path) -> None:
    log = csi5300.read(rx, antennas="A")
    part = log[::-2]
    part.write(tmp_path / "part.npz")
    arrays = np.load(tmp_path / "part.npz")
    assert np.array_equal(arrays["csi"].transpose(0, 2, 3, 1), part.csi) and np.array_equal(arrays["time_us"], part.time_us)
    assert part.write(tmp_path / "PART.NPZ") == 0 and len(np.load(tmp_path / "PART.NPZ")["agc"]) == len(part)
    part.write(tmp_path / "part.csv")
    head, *rows = [line.split(",") for line in (tmp_path / "part.csv").read_text().splitlines()]
    assert [int(row[head.index("agc")]) for row in rows] == part.agc.tolist() and "re_0_a_1" in head and "re_0_b_1" not in head
    with pytest.raises(csi5300.ExportError) as caught:
        log.write(tmp_path / "none" / "log.npz")
    assert caught.value.file and "none" in caught.value.file
    assert str(caught.value).startswith(f"cannot write {tmp_path}/none/log.npz: ") and str(os.getpid()) not in str(caught.value)
    with pytest.raises(csi5300.ExportError) as caught:
        log.write(tmp_path / "log.xls")
    assert str(caught.value) == f"cannot write {tmp_path}/log.xls: unknown extension, CSI is exported as .csv, .npz, .mat or .parquet"
