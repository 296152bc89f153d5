"""CSIKit scripts over this package, compared with CSIKit itself (CSIKIT_PYTHON: it fails with NumPy 2)."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import csi5300
import numpy as np
import pytest
from csi5300.csikit import csitools, get_reader

LOG = "csitool/sample_0x5_64_3000.dat"
SCRIPT = """
import sys, warnings
warnings.simplefilter("ignore")
import numpy as np
from CSIKit.reader import get_reader
from CSIKit.util import csitools
log, out = sys.argv[1:]
found = {}
for scaled in (False, True):
    data = get_reader(log).read_file(log, scaled=scaled)
    for metric in ("amplitude", "phase", "complex"):
        csi, frames, subcarriers = csitools.get_CSI(data, metric=metric)
        found[f"{metric}-{scaled}"] = csi
    found[f"fields-{scaled}"] = [[getattr(f, name) for name in FIELDS] for f in data.frames]
    found[f"time-{scaled}"] = data.timestamps
    found[f"counts-{scaled}"] = [frames, subcarriers]
np.savez(out, **found)
"""
FIELDS = ("timestamp_low", "bfee_count", "n_rx", "n_tx", "rssi_a", "rssi_b", "rssi_c", "noise", "agc", "rate")
# Only the first records: CSIKit reads a few hundred per second.
BYTES = 40_000


def test_a_script_gives_the_same_numbers_as_with_csikit(captures: Path, tmp_path: Path) -> None:
    python = os.environ.get("CSIKIT_PYTHON")
    if not python:
        pytest.skip("CSIKIT_PYTHON names no interpreter with CSIKit")
    log, out = tmp_path / "log.dat", tmp_path / "theirs.npz"
    whole = (captures / LOG).read_bytes()
    end = int(csi5300.read(whole).offset.searchsorted(BYTES))
    log.write_bytes(whole[: csi5300.read(whole).offset[end]])
    script = f"FIELDS = {FIELDS!r}\n{SCRIPT}"
    run = subprocess.run([python, "-c", script, log, out], capture_output=True, text=True, timeout=600, check=False)
    assert run.returncode == 0, run.stderr
    theirs = np.load(out)
    for scaled in (False, True):
        data = get_reader(str(log)).read_file(str(log), scaled=scaled)
        n = len(theirs[f"time-{scaled}"])
        # It skips records that begin within the last 100 bytes.
        assert n > 20 and n in (len(data.frames), len(data.frames) - 1)
        fields = [[getattr(frame, name) for name in FIELDS] for frame in data.frames[:n]]
        assert np.array_equal(fields, theirs[f"fields-{scaled}"])
        assert np.allclose(data.timestamps[:n], theirs[f"time-{scaled}"], atol=1e-6)
        for metric in ("amplitude", "phase", "complex"):
            csi, frames, subcarriers = csitools.get_CSI(data, metric=metric)
            assert (frames - len(data.frames), subcarriers) == (0, theirs[f"counts-{scaled}"][1])
            other = theirs[f"{metric}-{scaled}"]
            # -inf dB in both counts as equal.
            assert csi[:n].shape == other.shape and np.allclose(csi[:n], other, rtol=1e-5, atol=1e-5), (metric, scaled)


def test_frames_with_fewer_streams_are_skipped_and_a_sender_can_be_chosen(rx: Path) -> None:
    data = get_reader(rx).read_file(rx)
    csi, frames, subcarriers = csitools.get_CSI(data)
    log = csi5300.read(rx)
    assert (frames, subcarriers, len(data.timestamps)) == (len(log), 30, len(csi))
    assert np.allclose(csitools.get_CSI(data, "complex")[0][0], data.frames[0].csi_matrix)
    sender = str(log.mac[0])
    assert len(get_reader(rx).read_file(rx, filter_mac=sender).frames) == int((log.mac == sender).sum())
    narrow = data.frames[1]
    narrow.csi_matrix, narrow.n_rx = narrow.csi_matrix[:, :0], 0
    for metric in ("amplitude", "phase"):
        assert len(csitools.get_CSI(data, metric)[0]) == len(log) - 1 == len(data.timestamps)


def test_another_kind_of_file_is_an_error_that_names_it(tmp_path: Path) -> None:
    other = tmp_path / "table.dat"
    other.write_text("1.5,0,0.1,0.2,0.3,\n1.6,0,0.1,0.2,0.3,\n")
    for read in (csi5300.read, get_reader(other).read_file):
        with pytest.raises(csi5300.LogError, match="another kind of file, a table of numbers"):
            read(other)
    empty = tmp_path / "empty.dat"
    empty.write_bytes(b"")
    with pytest.raises(csi5300.OptionError, match="no frame"):
        csitools.get_CSI(get_reader(empty).read_file(empty))
