"""csiread's own examples (its source distribution, unpacked in CSIREAD_SDIST) print and draw the same over this package.

Those that read Intel logs and need neither a window system nor the network. csitest.py compares with MATLAB's reading of
log.all_csi.6.7.6, which is not given away; tests/test_log.py compares that log with csitool's algorithm instead.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import CAPTURES

EXAMPLES = {
    "csiFilterStep.py": ["scipy", "matplotlib"],
    "csieSNR.py": ["scipy", "matplotlib"],
    "csitable.py": ["pandas"],
}

# Runs an example, and prints what it has drawn.
RUN = """
import runpy, sys
module, script, args = sys.argv[1], sys.argv[2], sys.argv[3:]
sys.modules["csiread"] = __import__(module, fromlist=["Intel"])
sys.argv = [script, *args]
try:
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    plt.show = lambda *a, **k: None
except ImportError:
    plt = None
runpy.run_path(script, run_name="__main__")
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
    for needed in EXAMPLES[example]:
        pytest.importorskip(needed)
    sources = Path(os.environ.get("CSIREAD_SDIST", "none")) / "examples"
    if not (sources / example).exists() or not CAPTURES.is_dir():
        pytest.skip("CSIREAD_SDIST names no unpacked csiread, or no captures")
    data = tmp_path / "material" / "5300" / "dataset"
    data.mkdir(parents=True)
    for log in (CAPTURES / "csitool").glob("sample*"):
        (data / log.name).symlink_to(log)
    (tmp_path / "examples").mkdir()
    for name in (example, "utils.py"):
        (tmp_path / "examples" / name).write_text((sources / name).read_text())
    said = []
    for module in ("csiread", "csi5300.csiread"):
        command = [sys.executable, "-c", RUN, module, example]
        run = subprocess.run(command, cwd=tmp_path / "examples", capture_output=True, text=True, timeout=300, check=False)
        lines = [line for line in run.stdout.splitlines() if "packets parsed" not in line and "connector_log" not in line]
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
