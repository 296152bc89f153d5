from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import csi5300
import numpy as np
import pytest
from csi5300 import csiread


def test_one_family_with_the_file(tmp_path: Path) -> None:
    with pytest.raises(csi5300.LogNotFoundError) as caught:
        csi5300.read(tmp_path / "none.dat")
    assert isinstance(caught.value, (csi5300.Error, FileNotFoundError))
    assert caught.value.file == str(tmp_path / "none.dat") and "none.dat" in str(caught.value)
    with pytest.raises(csi5300.LogError, match="directory"):
        csi5300.read(tmp_path)
    table = tmp_path / "t.csv"
    table.write_text("1.5,0,0.1,0.2,0.3\n1.6,0,0.1,0.2,0.3\n")
    with pytest.raises(csi5300.LogError, match=r"another kind of file, a table of numbers such as a trajectory: a log is"):
        csi5300.read(table)
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.file, again.offset) == (str(caught.value), caught.value.file, 0)


def test_exceptions_of_a_file_object_are_passed_on() -> None:
    class Broken:
        def __init__(self) -> None:
            self.left = 3

        def read(self, n: int) -> Any:
            self.left -= 1
            if self.left == 0:
                raise RuntimeError("the disk is gone")
            return b"\0" * min(n, 100)

    class Text:
        def read(self, n: int) -> Any:
            return "text"

    with pytest.raises(RuntimeError, match="the disk is gone"):
        csi5300.read(Broken())  # type: ignore[arg-type]
    with pytest.raises(csi5300.LogError, match="binary"):
        csi5300.read(Text())  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        csi5300.read(17)  # type: ignore[arg-type]


def test_wrong_options_are_named(rx: Path, tx: Path, path_csv: Path) -> None:
    def run(**options: Any) -> None:
        csi5300.bearings(rx, tx, trajectory=path_csv, **{"channel": 108, **options})

    for options, word in (
        ({"channel": 0}, "channel"),
        ({"elevation_max": 91}, "elevation_max"),
        ({"without": "everything"}, "everything"),
        ({"antenna": "D"}, "antenna"),
        ({"from_": 2, "to": 1}, "from_"),
        ({"tx_mac": "me"}, "tx_mac"),
        ({"tx_mac": [f"02:00:00:00:00:{k:02}" for k in range(9)]}, "tx_mac: 9 MACs"),
        ({"range_min": 1e-9}, "range_min"),
    ):
        with pytest.raises(csi5300.OptionError, match=word):
            run(**options)
    nan, three = float("nan"), (1, 2, 3)
    for name, value in (
        ("channel", None),
        ("elevation_max", "x"),
        ("elevation_max", True),
        ("clock_offset", nan),
        ("height", np.inf),
        ("threads", -1),
        ("decimate", 1.5),
        ("antenna_offset", (1, 2)),
        ("antenna_offset", 1),
        ("camera_mount", (1, 2, nan)),
        ("no_compensation", 1),
        ("without", "near_field"),
        ("without", 5),
        ("tx_mac", 5),
        ("key", 5),
        ("every", 0),
        ("every", nan),
        ("range_min", -1),
    ):
        with pytest.raises(csi5300.OptionError, match=f"^{name}: ") as caught:
            run(**{name: value})
        assert len(str(caught.value)) < 150
    with pytest.raises(csi5300.OptionError, match="nonsense"):
        csi5300.evaluate(rx.parent, nonsense=three)
    for trajectory in (None, [1.0, 2.0, 3.0, 4.0], np.zeros((2, 2, 4)), [[0, 0, 0, 0], [0, 0]], ["a", "b"], 5):
        with pytest.raises(csi5300.TrajectoryError, match="^trajectory: "):
            csi5300.bearings(rx, tx, trajectory=trajectory, channel=108)  # type: ignore[arg-type]
    with pytest.raises(csi5300.TrajectoryError, match="^tx_trajectory: "):
        run(tx_trajectory=[[1.0]])
    with pytest.raises(csi5300.TrajectoryError):
        csi5300.bearings(rx, tx, trajectory=[[0, 0, 0, 0]], channel=108)
    with pytest.raises(csi5300.TrajectoryError, match=r"\.dat is a log of CSI: a trajectory is"):
        csi5300.bearings(rx, tx, trajectory=rx, channel=108)
    with pytest.raises(csi5300.OptionError):
        csi5300.bearings(rx, [], trajectory=path_csv, channel=108)


def test_scalars_of_numpy_are_numbers(rx: Path, tx: Path, path_csv: Path) -> None:
    plain = csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, to=1.5, decimate=2, no_compensation=True)
    options = {"to": np.float32(1.5), "decimate": np.int16(2), "no_compensation": np.True_, "channel": np.uint8(108)}
    (bearing,) = csi5300.bearings(rx, tx, trajectory=path_csv, **options)  # type: ignore[arg-type]
    assert bearing.azimuth_deg == plain[0].azimuth_deg


def test_skipped_rows_of_a_trajectory_give_a_warning(path_csv: Path, tmp_path: Path) -> None:
    whole = csi5300.read_trajectory(path_csv)
    rows = path_csv.read_text().splitlines()
    rows[7] = "?,0,1,2,3,"
    damaged = tmp_path / "damaged.csv"
    damaged.write_text("\n".join(rows) + "\n")
    with pytest.warns(UserWarning, match=r"damaged.csv: 1 rows skipped, the first in line 8: column 1 is not"):
        track = csi5300.read_trajectory(damaged)
    assert len(track) == len(whole) - 1


def test_file_errors_are_also_os_errors(rx: Path, tx: Path, path_csv: Path, tmp_path: Path) -> None:
    none = tmp_path / "none"
    with pytest.raises(csi5300.TrajectoryFileError) as caught:
        csi5300.read_trajectory(none)
    assert isinstance(caught.value, (OSError, csi5300.TrajectoryError)) and caught.value.file == str(none)
    with pytest.raises(csi5300.SceneFileError):
        csi5300.simulate(none)
    with pytest.raises(csi5300.OptionFileError, match="^key: "):
        csi5300.bearings(rx, tx, trajectory=path_csv, channel=108, key=none)
    for of_a_folder in (csi5300.evaluate, csi5300.ray.evaluate, lambda uri: csi5300.ray.convert(uri, tmp_path)):
        with pytest.raises(csi5300.OptionFileError, match="not a readable folder"):
            of_a_folder(none)
    with pytest.raises(csi5300.LogNotFoundError, match="datstp"):
        csiread.Intel(str(rx), if_report=False).readstp()
    for error in (csi5300.TrajectoryFileError, csi5300.SceneFileError, csi5300.OptionFileError, csi5300.ExportError):
        assert issubclass(error, csi5300.Error) and issubclass(error, OSError)


def test_argument_errors_belong_to_the_family(rx: Path) -> None:
    for call in (
        lambda: csi5300.simulate("lab-circle", seed=-1),
        lambda: csi5300.simulate("lab-circle", seed=2**64),
        lambda: csi5300.evaluate(rx.parent, workers=-1),
        lambda: csi5300.evaluate(rx.parent, sweep={"elevation_max": 5}),  # type: ignore[dict-item]
        lambda: csi5300.evaluate(rx.parent, sweep={"without": "alignment"}),
        lambda: csi5300.evaluate(rx.parent, sweep=5),  # type: ignore[arg-type]
        lambda: csi5300.evaluate(rx.parent, trajectory=5),
        lambda: csi5300.ray.evaluate(rx.parent, use_ray=False, workers=1.5),  # type: ignore[arg-type]
        lambda: csi5300.read(rx, macs=5),  # type: ignore[arg-type]
        lambda: csi5300.read(rx, antennas=5),  # type: ignore[arg-type]
    ):
        with pytest.raises(csi5300.OptionError):
            call()


def test_modules_are_imported_on_first_use() -> None:
    name = "import csi5300; print(csi5300.ray.RETRIES, csi5300.plot.COLUMNS, csi5300.csiread.__version__)"
    said = subprocess.run([sys.executable, "-c", name], capture_output=True, text=True, timeout=120, check=False)
    assert said.stdout.split()[2:] == ["1.4.1"], said.stderr
    with pytest.raises(AttributeError, match="nothing"):
        csi5300.nothing  # type: ignore[attr-defined]


def test_a_missing_library_is_named(rx: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = csi5300.read(rx)
    for name, table in (("pandas", log.to_pandas), ("polars", log.to_polars), ("xarray", log.to_xarray)):
        monkeypatch.setitem(sys.modules, name, None)
        with pytest.raises(ImportError, match=f"pip install {name}"):
            table()


def test_scenes_are_refused() -> None:
    for scene in ("no-such-scene", {"duration_s": "long"}, {"nonsense": 1}, {"duration_s": -1.0, "robot": []}, {"robot": {1, 2}}):
        with pytest.raises(csi5300.SceneError):
            csi5300.simulate(scene)
    with pytest.raises(csi5300.SceneError, match="Out of range float"):
        csi5300.simulate({"duration_s": float("nan")})


LONG = """
import contextlib, csi5300, csi5300.ray, pathlib, signal, sys, time

work, rx, tx, path, folder = sys.argv[1:]

class Endless:
    def __init__(self, name):
        self.data, self.at = pathlib.Path(name).read_bytes(), 0

    def read(self, n):
        part = self.data[self.at : self.at + n]
        self.at = (self.at + len(part)) % len(self.data)
        return part

def ten_hours():
    robots = [
        {"name": "rx", "motion": {"circle": {"radius_m": 0.3, "duration_s": 36_000.0}}},
        {"name": "tx", "position_m": [3.0, 1.0, 0.5]},
    ]
    csi5300.simulate({"duration_s": 36_000.0, "sounding": {"rate_hz": 200.0}, "robot": robots})

def endless_logs():
    csi5300.bearings(Endless(rx), Endless(tx), trajectory=path, channel=108)

def endless_reading():
    csi5300.read(Endless(rx))

def long_sweep():
    csi5300.ray.evaluate(folder, use_ray=False, sweep={"to": [2.0 + k * 1e-6 for k in range(20_000)]})

def threads():
    for thread in pathlib.Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):
            yield (thread / "comm").read_text().strip()

signal.signal(signal.SIGALRM, signal.default_int_handler)
signal.setitimer(signal.ITIMER_REAL, 0.5)
try:
    globals()[work]()
except KeyboardInterrupt:
    # The work, on a thread of this name, ends, too.
    end = time.monotonic() + 60
    while "csi5300" in threads() and time.monotonic() < end:
        time.sleep(0.01)
    print("interrupted", "csi5300" in threads())
"""


@pytest.mark.parametrize("work", ["ten_hours", "endless_logs", "endless_reading", "long_sweep"])
def test_an_interrupt_ends_a_long_call_and_its_work(work: str, rx: Path, tx: Path, path_csv: Path) -> None:
    command = [sys.executable, "-c", LONG, work, str(rx), str(tx), str(path_csv), str(rx.parent)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.stdout == "interrupted False\n", done.stderr


WAITING = """
import pathlib, signal, sys
import csi5300
import numpy as np
from csi5300 import csiread

work, fifo, rx, path = sys.argv[1:]

def reading():
    csi5300.read(fifo)

def scanning():
    for _ in csi5300.scan(fifo):
        pass

def bearings():
    csi5300.bearings(fifo, rx, trajectory=path, channel=108)

def a_trajectory():
    csi5300.bearings(rx, rx, trajectory=fifo, channel=108)

def a_silent_writer():
    # The FIFO has a writer that writes nothing.
    with open(fifo, "r+b", buffering=0):
        csi5300.read(fifo)

signal.signal(signal.SIGALRM, signal.default_int_handler)
signal.setitimer(signal.ITIMER_REAL, 0.5)
try:
    globals()[work]()
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.parametrize("work", ["reading", "scanning", "bearings", "a_trajectory", "a_silent_writer"])
def test_an_interrupt_ends_the_wait_for_a_fifo(work: str, rx: Path, path_csv: Path, tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    command = [sys.executable, "-c", WAITING, work, str(fifo), str(rx), str(path_csv)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.stdout == "interrupted\n", done.stderr


def test_a_fifo_is_read_to_the_end_of_its_writer(rx: Path, tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    whole = csi5300.read(rx)
    # It opens the FIFO at any time, possibly after the reader.
    writer = subprocess.Popen(["cp", str(rx), str(fifo)])
    log = csi5300.read(fifo)
    assert writer.wait(timeout=120) == 0
    assert len(log) == len(whole) and np.array_equal(log.csi, whole.csi, equal_nan=True)
    with pytest.raises(csi5300.LogError, match="not a regular file"):
        csiread.Intel(str(fifo), 3, 1).read()


def test_standard_input_is_a_log(rx: Path, tmp_path: Path) -> None:
    # Other files do not matter.
    (tmp_path / "-").write_bytes(b"")
    for log in ("csi5300.read('-')", "next(csi5300.scan('-'))"):
        count = f"import csi5300; log = {log}; print(len(log), log.info['name'])"
        with rx.open("rb") as file:
            command = [sys.executable, "-c", count]
            done = subprocess.run(command, stdin=file, cwd=tmp_path, capture_output=True, text=True, timeout=120)
        assert done.stdout == f"{len(csi5300.read(rx))} standard input\n", done.stderr


def test_a_pickled_log_that_was_damaged_is_refused(rx: Path) -> None:
    state = csi5300.read(rx)[:3].__getstate__()
    state["packed"] = state["packed"][:-1]
    with pytest.raises(csi5300.LogError):
        csi5300.Log.__new__(csi5300.Log).__setstate__(state)
