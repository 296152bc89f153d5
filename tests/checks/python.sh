#!/usr/bin/env bash
# The Python package: builds the wheel once (release, for manylinux2014); checks its types (mypy --strict, with tests and examples); runs
# its tests with the libraries that it works with, its examples and notebooks; tests the wheel alone in a clean environment; and runs
# README's lines, with pip building from the clone. Exit status 77: no Python, or no PyPI. If PyPI can be reached, anything that cannot
# be installed is a failure.
set -euo pipefail
cd "$(dirname "$0")/../.."
export PIP_DISABLE_PIP_VERSION_CHECK=1
command -v python3 >/dev/null || { echo "no python3"; exit 77; }
python3 -c 'import sys; sys.exit(sys.version_info < (3, 10))' || { echo "Python 3.10 or newer is needed"; exit 77; }
target=$(realpath -m "${CARGO_TARGET_DIR:-target}")
export CARGO_TARGET_DIR="$target"
captures=$(realpath -m "${CSI5300_CAPTURES:-../shared/captures}")
export CSI5300_CAPTURES="$captures"
own="$target/python-check"
mkdir -p "$own"
[ -x "$own/venv/bin/python" ] || python3 -m venv "$own/venv"
"$own/venv/bin/pip" install --quiet 'maturin>=1.7,<2' mypy pytest numpy || { echo "PyPI cannot be reached"; exit 77; }
step() { printf -- '-- %s (%s s)\n' "$1" "$SECONDS"; }
# A missing requirement: skips the step without PyPI, and fails it with PyPI.
without() {
    if "$own/venv/bin/pip" download --quiet --no-cache-dir --no-deps --dest "$own/reached" pip 2>/dev/null; then
        echo "failed: $1, although PyPI can be reached"
        exit 1
    fi
    echo "skipped: $1: PyPI cannot be reached"
}

step "the wheel"
status=0
scripts/wheel.sh "$own/wheels" || status=$?
if [ "$status" = 77 ]; then
    without "the wheel for manylinux2014 (built with the C library of this machine instead)"
    rm -f "$own"/wheels/*.whl
    (cd python && PATH="$own/venv/bin:$PATH" maturin build --quiet --release --out "$own/wheels")
elif [ "$status" != 0 ]; then
    exit "$status"
fi
wheel=$(echo "$own"/wheels/*.whl)

step "alone, in a clean environment"
rm -rf "$own/clean"
python3 -m venv "$own/clean"
"$own/clean/bin/pip" install --quiet "$wheel" pytest
"$own/clean/bin/python" -m pytest -q -p no:cacheprovider python/tests

step "types"
"$own/venv/bin/pip" install --quiet --force-reinstall --no-deps "$wheel"
(cd python && "$own/venv/bin/python" -m mypy --cache-dir "$own/mypy")
(cd python && "$own/venv/bin/python" -m mypy --strict --cache-dir "$own/mypy-tests" tests ../examples/python/*.py)
# Compares the native half's type stubs with the module.
(cd "$own" && "$own/venv/bin/python" -m mypy.stubtest csi5300._native)

step "tests, with the libraries that it works with"
libraries=(matplotlib pandas polars xarray pyarrow duckdb scipy fsspec csiread==1.4.1 ray 'moto[server]' s3fs nbclient ipykernel)
if ! "$own/venv/bin/pip" install --quiet "${libraries[@]}"; then
    for library in "${libraries[@]}"; do
        "$own/venv/bin/pip" install --quiet "$library" || without "tests with $library, which cannot be installed"
    done
fi
command -v octave-cli >/dev/null || echo "skipped: .mat in Octave: no octave-cli (apt-get install --no-install-recommends octave, 260 MB)"
# csiread's own examples, run with this package.
if [ ! -d "$own/csiread-1.4.1" ]; then
    if "$own/venv/bin/pip" download --quiet --no-deps --no-binary csiread -d "$own" csiread==1.4.1; then
        tar xzf "$own/csiread-1.4.1.tar.gz" -C "$own"
    else
        without "csiread's examples, whose sources cannot be fetched"
    fi
fi
export CSIREAD_SDIST="$own/csiread-1.4.1"
# CSIKit fails with NumPy 2, so it gets its own environment.
[ -x "$own/csikit/bin/python" ] || python3 -m venv "$own/csikit"
if "$own/csikit/bin/pip" install --quiet CSIKit==2.5 'numpy<2'; then
    export CSIKIT_PYTHON="$own/csikit/bin/python"
else
    without "tests with CSIKit, which cannot be installed"
fi
CSI5300_PROGRAM=$(scripts/program.sh)
export CSI5300_PROGRAM
"$own/venv/bin/python" -m pytest -q -p no:cacheprovider -rs python/tests

step "examples"
examples=$(realpath examples/python)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
python="$own/venv/bin/python"
"$python" "$examples/reading.py"
for log in "$OLDPWD"/tests/fixtures/*/*.dat "$captures"/csitool/*.dat; do
    [ ! -e "$log" ] || "$python" "$examples/reading.py" "$log" >reading.txt || { echo "reading.py $log"; exit 1; }
done
"$python" "$examples/simulation.py"
"$python" "$examples/bearings.py"
"$python" "$examples/cluster.py" "$OLDPWD/tests/fixtures"
if "$own/venv/bin/pip" install --quiet gtsam; then
    "$python" "$examples/../gtsam/team.py"
    # The same graph solved by GTSAM: poses and covariances agree.
    (cd "$OLDPWD" && cargo run --quiet --locked -p csi5300-team --example team -- 3 1 "$work/team.json")
    "$python" "$examples/../gtsam/factors.py" team.json
else
    without "a team's graph, for which GTSAM cannot be installed"
fi
"$CSI5300_PROGRAM" simulate lab-circle --serve --socket "$work/room" 2>served.txt &
started=($!)
until [ -e "$work/room" ] || ! kill -0 "${started[0]}"; do sleep 0.1; done
"$CSI5300_PROGRAM" sound --answer --room "$work/room#tx" --peers 02:53:00:00:00:01 >robots.txt 2>&1 &
started+=($!)
"$CSI5300_PROGRAM" sound --room "$work/room#rx" --peers 02:53:00:00:00:02 --alone --rate 25 --guard 4000 --turn-around 8000 >>robots.txt 2>&1 &
started+=($!)
said=$("$python" "$examples/live.py" "$work/room#rx")
kill "${started[@]}" 2>/dev/null || true
wait "${started[@]}" || true
printf '%s\n' "$said"
[[ "$said" == *" frames, RSSI at A "* ]] || { echo "no frame came: $(cat robots.txt)"; exit 1; }

step "README's lines, pip building from the clone"
block() { awk -v fence="$1" '/^## /{ on = /From Python/ } /^```/{ open = !open; inside = on && open && $0 == "```" fence; next } inside' "$OLDPWD/README.md"; }
[[ "$(block "")" == *$'\npip install ./python matplotlib '* ]] || { echo "README has another line to install"; exit 1; }
rm -rf "$own/readme"
python3 -m venv "$own/readme"
# Not optimised, which takes a third of the time: speed was tested above.
MATURIN_PEP517_ARGS="--profile dev" "$own/readme/bin/pip" install --quiet "$OLDPWD/python" matplotlib
fixture=$OLDPWD/tests/fixtures/small-circle
cp "$fixture"/csi_rx_*.dat rx.dat
cp "$fixture"/csi_tx1_*.dat tx.dat
cp "$fixture"/rx_trajectory_*.csv t.csv
block python >readme.py
"$own/readme/bin/python" readme.py
[ -s csi.png ] && [ -s bearing.png ] || { echo "README's lines made no pictures"; exit 1; }

step "the notebooks"
cp "$examples/first_look.ipynb" "$examples/../gtsam/"{team.ipynb,factors.py} .
[ -e team.json ] || (cd "$OLDPWD" && cargo run --quiet --locked -p csi5300-team --example team -- 3 1 "$work/team.json")
if "$python" -c 'import nbclient, ipykernel'; then
    "$python" - <<'PY'
import nbclient, nbformat

for name, least in ("first_look", 2), ("team", 1):
    notebook = nbformat.read(f"{name}.ipynb", as_version=4)
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    pictures = sum("image/png" in o.get("data", {}) for c in notebook.cells for o in c.get("outputs", []))
    assert pictures >= least, f"{name}.ipynb: {pictures} pictures"
    print(f"{name}.ipynb: {pictures} pictures")
PY
else
    echo "no Jupyter: the notebooks were not executed"
fi
step "done"
