"""csiread's own examples (its source distribution, unpacked in CSIREAD_SDIST) print and draw the same with this package.

All examples for published Intel logs, except those that draw live from a network in a window (csiclient, csiratioA and B, csirealtime,
csiviewer). Of examples for other cards, too, only the functions for Intel's run. csitest.py compares with MATLAB's reading of
log.all_csi.6.7.6, which is not published; tests/test_log.py compares that log with csitool's algorithm instead.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import CAPTURES

LOGS = "../material/5300/dataset/"
LONG = f"{LOGS}sample_0x5_64_3000.dat"
DRAWS = ["scipy", "matplotlib"]
EXAMPLES: dict[str, tuple[list[str], list[str], str]] = {
    "csiFilterStep": (DRAWS, [], ""),
    "csieSNR": (DRAWS, [], ""),
    "csitable": (["pandas"], [], ""),
    "csiDoppler": (DRAWS, [LONG, "-i", "15"], ""),
    "csimemoryerror": ([], [], ""),
    **{f"csishow -t {kind}": (DRAWS, [f"{LOGS}sample_0x1_ap.dat", "-t", kind], "") for kind in "12345689"},
    "csidrcsi": (DRAWS, [], f"log = csiread.Intel({LONG!r}, ntxnum=1, if_report=False); log.read(); fig_2(log); fig_6(log)"),
    "csiexample": ([], [], f"intel({LOGS + 'sample_0x1_ap.dat'!r}, 10, ntxnum=2); intel({LONG!r}, 10, ntxnum=1)"),
    "csimpdu": ([], [], f"Intel5300MPDU2({LONG!r}, 10)"),
    "csiseek": ([], [], f"seekIntel({LONG!r}, 64)"),
}
"""An example's requirements, its arguments, and the call if only a part of it runs."""

# Not compared: what csiread's C code prints beside Python's output; durations; unused room in arrays (docs/guides/python.md).
LEFT_OUT = re.compile(r"packets parsed|connector_log|[\d.e-]+ ?s$")
ROOM = re.compile(r"base\.size=\d+")

# Runs an example, and prints what it has drawn.
RUN = """
import runpy, sys
module, script, call, args = sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4:]
sys.modules["csiread"] = __import__(module, fromlist=["Intel"])
# One example imports it, for functions that are not called.
sys.modules["scapy"] = sys.modules["scapy.all"] = type(sys)("scapy")
sys.modules["scapy"].Dot11 = None
sys.argv = [script, *args]
try:
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    plt.show = lambda *a, **k: None
except ImportError:
    plt = None
scope = runpy.run_path(script, run_name="a module" if call else "__main__")
exec(call, scope)
import numpy as np
for number in plt.get_fignums() if plt else []:
    for axes in plt.figure(number).axes:
        for line in axes.lines:
            x, y = (np.nan_to_num(np.asarray(v, dtype=float)) for v in (line.get_xdata(), line.get_ydata()))
            print(f"line of {len(y)}: {np.sum(x):.6g} {np.sum(np.abs(y)):.6g}")
        for mesh in [*axes.images, *axes.collections]:
            values = mesh.get_array()
            if values is not None:
                print(f"picture of {np.size(values)}: {np.sum(np.abs(np.nan_to_num(np.asarray(values, dtype=float)))):.6g}")
"""


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_prints_and_draws_the_same(example: str, tmp_path: Path) -> None:
    pytest.importorskip("csiread")
    needs, args, call = EXAMPLES[example]
    script = f"{example.split()[0]}.py"
    for needed in needs:
        pytest.importorskip(needed)
    sources = Path(os.environ.get("CSIREAD_SDIST", "none")) / "examples"
    if not (sources / script).exists() or not CAPTURES.is_dir():
        pytest.skip("CSIREAD_SDIST names no unpacked csiread, or no captures")
    data = tmp_path / "material" / "5300" / "dataset"
    data.mkdir(parents=True)
    for log in (CAPTURES / "csitool").glob("sample*"):
        (data / log.name).symlink_to(log)
    (tmp_path / "examples").mkdir()
    for name in (script, "utils.py"):
        (tmp_path / "examples" / name).write_text((sources / name).read_text())
    said = []
    for module in ("csiread", "csi5300.csiread"):
        command = [sys.executable, "-c", RUN, module, script, call, *args]
        run = subprocess.run(command, cwd=tmp_path / "examples", capture_output=True, text=True, timeout=300, check=False)
        lines = [ROOM.sub("", line) for line in run.stdout.splitlines() if not LEFT_OUT.search(line)]
        said.append((run.returncode, lines, run.stderr.strip().splitlines()[-1:] if run.returncode else []))
    theirs, own = said
    assert theirs[0] == 0 and own[0] == 0, said
    assert [_words(line)[0] for line in own[1]] == [_words(line)[0] for line in theirs[1]]
    for a, b in zip(own[1], theirs[1], strict=True):
        assert _words(a)[1] == pytest.approx(_words(b)[1], rel=1e-5)


def _words(line: str) -> tuple[list[str], list[float]]:
    """The words of a line, and its numbers."""
    words: list[str] = []
    numbers: list[float] = []
    for word in line.split():
        try:
            numbers.append(float(word))
        except ValueError:
            words.append(word)
    return words, numbers
