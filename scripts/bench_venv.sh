#!/bin/sh
# Makes the virtual environment with FINUFFT and NumPy that `cargo bench --bench pareto` compares with.
set -eu
cd "$(dirname "$0")/.."
mkdir -p target
python3 -m venv target/venv
target/venv/bin/pip install --quiet numpy finufft
target/venv/bin/python -c 'import numpy, finufft; print("numpy", numpy.__version__, "finufft", finufft.__version__)'
