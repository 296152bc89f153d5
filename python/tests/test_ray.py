"""Many captures: on threads, on Ray's own cluster utility with several nodes, and with a node killed during the work."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import csi5300
import csi5300.ray
import numpy as np
import pytest
from conftest import CIRCLE, STAMP


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Six captures, one of which cannot be read."""
    for number in range(6):
        shutil.copytree(CIRCLE, tmp_path / "data" / f"set{number % 2}" / f"run{number}")
    (tmp_path / "data" / "set1" / "run5" / f"csi_rx_{STAMP}.dat").unlink()
    return tmp_path / "data"


@pytest.fixture
def cluster() -> Iterator[Any]:
    pytest.importorskip("ray")
    import ray
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    made.add_node(num_cpus=1)
    ray.init(address=made.address, log_to_driver=False)
    yield made
    ray.shutdown()
    made.shutdown()


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A bucket of an S3 server in this process; later processes find it by the environment."""
    s3fs, server = pytest.importorskip("s3fs"), pytest.importorskip("moto.server")
    made = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    made.start()
    host, port = made.get_host_and_port()
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "test")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    s3fs.S3FileSystem.clear_instance_cache()
    # Buckets of an earlier server in this process persist.
    s3fs.S3FileSystem().mkdir(f"wifi-{port}")
    yield f"s3://wifi-{port}"
    s3fs.S3FileSystem.clear_instance_cache()
    made.stop()


def _without_texts(result: csi5300.Evaluation) -> list[dict[str, Any]]:
    """Rows without the text of their errors, which names folders."""
    return [{**row, "error": bool(row.get("error"))} for row in _rows(result)]


def _rows(result: csi5300.Evaluation) -> list[dict[str, Any]]:
    return json.loads(json.dumps(result.rows))  # type: ignore[no-any-return]


def test_threads_give_the_same_rows_as_evaluate(tree: Path) -> None:
    whole = csi5300.evaluate(tree)
    result = csi5300.ray.evaluate(tree, use_ray=False, workers=2)
    assert _rows(result) == _rows(whole) and len(result) == 6
    bad = [row for row in result if row.get("error")]
    assert len(bad) == 1 and bad[0]["capture"].startswith("set1/run5") and result.lost


def test_a_sweep_is_the_product(tree: Path) -> None:
    result = csi5300.ray.sweep(tree / "set0", {"without": [[], ["near-field"]], "to": [1.0, 2.0]}, use_ray=False)
    assert len(result) == 3 * 4
    assert {(str(row["option_without"]), row["option_to"]) for row in result} == {
        (without, to) for without in ("[]", "['near-field']") for to in (1.0, 2.0)
    }
    with pytest.raises(csi5300.OptionError, match="nonsense"):
        csi5300.ray.evaluate(tree, use_ray=False, nonsense=1)


def test_remote_files(tree: Path) -> None:
    fsspec = pytest.importorskip("fsspec")
    memory = fsspec.filesystem("memory")
    memory.put(str(tree), "/bucket/data", recursive=True)
    result = csi5300.ray.evaluate("memory://bucket/data", use_ray=False, workers=2)
    assert _without_texts(result) == _without_texts(csi5300.evaluate(tree))
    # The names of [paper].
    run = tree.parent / "paper"
    run.mkdir()
    for file in CIRCLE.iterdir():
        name = file.name.replace(STAMP, "run").replace("csi_tx1_", "csi_tx_").replace("rx_trajectory_run_", "rx_movement_run")
        (run / name).write_bytes(file.read_bytes())
    memory.put(str(run), "/bucket/paper", recursive=True)
    (row,) = csi5300.ray.evaluate("memory://bucket/paper", use_ray=False)
    assert row["azimuth_deg"] is not None and _rows(csi5300.evaluate(run)) == [row]


def _through_s3(tree: Path, bucket: str, use_ray: bool) -> None:
    import s3fs

    system = s3fs.S3FileSystem()
    system.put(str(tree), f"{bucket}/data", recursive=True)
    result = csi5300.ray.evaluate(f"{bucket}/data", use_ray=use_ray, workers=2)
    assert _without_texts(result) == _without_texts(csi5300.evaluate(tree))
    pq = pytest.importorskip("pyarrow.parquet")
    done = csi5300.ray.convert(f"{bucket}/data", f"{bucket}/out", chunk=100, use_ray=use_ray, workers=2)
    assert len(done) == 11 and not any(one.error for one in done)
    tables = []
    for part in done[0].parts:
        with system.open(part) as file:
            tables.append(pq.read_table(file))
    log = csi5300.read(tree / done[0].log)
    assert sum((table["time_us"].to_pylist() for table in tables), []) == log.time_us.tolist()
    again = csi5300.ray.convert(f"{bucket}/data", f"{bucket}/out", chunk=1000, use_ray=use_ray, workers=2)
    system.invalidate_cache()
    assert len(system.find(f"{bucket}/out")) == sum(len(one.parts) for one in again) < sum(len(one.parts) for one in done)


def test_s3(tree: Path, bucket: str) -> None:
    _through_s3(tree, bucket, use_ray=False)


def test_s3_from_the_nodes_of_a_cluster(tree: Path, bucket: str, cluster: Any) -> None:
    _through_s3(tree, bucket, use_ray=True)


def test_conversion(tree: Path, tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    (tree / "bad.dat").write_bytes(b"It was a dark and stormy night. " * 20)
    done = csi5300.ray.convert(tree, tmp_path / "out", chunk=100, use_ray=False, workers=2)
    frames = {c.log: c.frames for c in done}
    assert frames["bad.dat"] == 0 and next(c for c in done if c.log == "bad.dat").parts == []
    log = csi5300.read(CIRCLE / f"csi_rx_{STAMP}.dat")
    one = next(c for c in done if c.log == f"set0/run0/csi_rx_{STAMP}.dat")
    assert one.frames == len(log) and len(one.parts) == -(-len(log) // 100)
    tables = [pq.read_table(part) for part in one.parts]
    assert sum((table["time_us"].to_pylist() for table in tables), []) == log.time_us.tolist()


def test_conversion_reports_losses(tmp_path: Path) -> None:
    data = (CIRCLE / f"csi_rx_{STAMP}.dat").read_bytes()
    log = csi5300.read(data)
    (tmp_path / "garbage.dat").write_bytes(b"It was a dark and stormy night. " * 20)
    (tmp_path / "behind.dat").write_bytes(data[: int(log.offset[-1])] + b"\xff" * 5000)
    (tmp_path / "cut.dat").write_bytes(data[: int(log.offset[-1]) + 40])
    done = csi5300.ray.convert(tmp_path, tmp_path / "out", chunk=len(log) - 1, use_ray=False)
    said = {c.log: (c.frames, len(c.parts), c.lost_something, c.tail is not None) for c in done}
    assert said == {
        "behind.dat": (len(log) - 1, 1, True, False),
        "cut.dat": (len(log) - 1, 1, False, True),
        "garbage.dat": (0, 0, False, False),
    }
    errors = {c.log: c.error for c in done if c.error is not None}
    assert list(errors) == ["garbage.dat"] and "another kind of file" in errors["garbage.dat"]


def test_a_repeated_conversion_counts_once(tree: Path, tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    out = tmp_path / "out"
    csi5300.ray.convert(tree, out, chunk=100, use_ray=False)
    (tmp_path / "out" / "notes.parquet").write_text("not ours")
    done = csi5300.ray.convert(tree, out, chunk=200, use_ray=False)
    there = sorted(str(file) for file in out.glob("log=*/*"))
    assert there == sorted(part for one in done for part in one.parts) and (out / "notes.parquet").exists()
    assert sum(pq.read_metadata(part).num_rows for part in there) == sum(one.frames for one in done)
    assert csi5300.ray.convert(tree, out, macs="02:53:00:00:00:77", use_ray=False)[0].frames == 0
    assert not list(out.glob("log=*/*")), "what is filtered now was not removed"
    twin = tree / f"set0__run0__csi_rx_{STAMP}.dat"
    twin.write_bytes(b"")
    with pytest.raises(csi5300.OptionError, match="one partition"):
        csi5300.ray.convert(tree, out, use_ray=False)


def _shape(file: str) -> bytes:
    import pyarrow.parquet as pq

    shape: bytes = pq.read_schema(file).metadata[b"csi5300.csi_shape"]
    return shape


def test_a_conversion_reads_as_one_table(captures: Path, tmp_path: Path) -> None:
    pl, dataset, duckdb = (pytest.importorskip(name) for name in ("polars", "pyarrow.dataset", "duckdb"))
    for scaled, values in ((False, pl.Int8), (True, pl.Float32)):
        out = tmp_path / f"scaled={scaled}"
        done = csi5300.ray.convert(captures / "csitool", out, chunk=1000, scaled=scaled, use_ray=False)
        frames = sum(one.frames for one in done)
        assert not any(one.error for one in done) and len({_shape(part) for one in done for part in one.parts}) == 1
        table = pl.read_parquet(out / "**" / "*.parquet", hive_partitioning=True)
        assert table.height == frames and table["csi_re"].dtype == pl.Array(values, 270)
        assert dataset.dataset(out, partitioning="hive").to_table().num_rows == frames
        ((rows, size),) = duckdb.sql(f"select count(*), max(len(csi_re)) from '{out}/**/*.parquet'").fetchall()
        assert (rows, size) == (frames, 270)
        for one in done:
            log = csi5300.read(captures / "csitool" / one.log)
            own = table.filter(pl.col("log") == one.log).sort("offset")
            csi = own["csi_re"].to_numpy().reshape(-1, 3, 3, 30)
            rows_of = ["ABC".index(letter) for letter in log.antennas]
            expected = (log.scaled() if scaled else log.csi).real
            assert np.array_equal(csi[:, rows_of, : log.streams].astype(np.float32), expected, equal_nan=True), one.log
    done = csi5300.ray.convert(captures / "csitool", tmp_path / "a", antennas="A", streams=1, t=(0, 1), use_ray=False)
    for one in done:
        log = csi5300.read(captures / "csitool" / one.log, antennas="A", t=(0, 1))
        assert one.frames == len(log) and {_shape(part) for part in one.parts} <= {b"1,1,30"}


def test_ray_gives_the_same_rows(tree: Path, cluster: Any) -> None:
    result = csi5300.ray.evaluate(tree, use_ray=True)
    assert _rows(result) == _rows(csi5300.evaluate(tree, threads=1))


def test_rows_as_a_ray_dataset(tree: Path, cluster: Any) -> None:
    for package in ("pandas", "pyarrow"):
        pytest.importorskip(package)
    result = csi5300.ray.evaluate(tree, use_ray=True)
    taken = {row["capture"]: row for row in result.to_ray().take_all()}
    assert len(taken) == len(result) == 6
    for row in result:
        assert {name: taken[row["capture"]][name] for name in row if not isinstance(row[name], (list, dict))} == {
            name: value for name, value in row.items() if not isinstance(value, (list, dict))
        }


def test_a_killed_node_changes_nothing(tree: Path, cluster: Any) -> None:
    node = cluster.add_node(num_cpus=2)
    killed: list[int] = []

    def progress(done: int, of: int) -> None:
        if not killed:
            killed.append(done)
            cluster.remove_node(node, allow_graceful=False)

    result = csi5300.ray.evaluate(tree, use_ray=True, sweep={"to": [1.0, 1.5, 2.0]}, progress=progress)
    assert killed and _rows(result) == _rows(csi5300.evaluate(tree, threads=1, sweep={"to": [1.0, 1.5, 2.0]}))


@pytest.mark.parametrize("engine", ["threads", "cluster"])
def test_the_shared_captures_give_the_programs_numbers(captures: Path, engine: str, request: pytest.FixtureRequest) -> None:
    use_ray = engine == "cluster"
    if use_ray:
        request.getfixturevalue("cluster")
    program = os.environ.get("CSI5300_PROGRAM")
    if not program or not (captures / "wsr").is_dir():
        pytest.skip("CSI5300_PROGRAM names no csi5300, or no captures of the WSR data set")
    said = subprocess.run([program, "evaluate", captures / "wsr", "--json"], capture_output=True, text=True, check=False)
    theirs = [json.loads(line) for line in said.stdout.splitlines()[:-1]]
    ours = _rows(csi5300.ray.evaluate(captures / "wsr", use_ray=use_ray))
    assert len(ours) == len(theirs) > 30
    for own, other in zip(ours, theirs, strict=True):
        own.pop("capture")
        own.pop("error", None)
        other.pop("error", None)
        assert own == other
