#!/usr/bin/env bash
# Compares logs of other cards with CSIKit and csiread from PyPI, element by element. Exit status 77: cannot run here.
set -eu
cd "$(dirname "$0")/../.."
cases=${CSI5300_CASES:-../shared/cases}
command -v python3 >/dev/null || { echo "no python3"; exit 77; }
[ -d "$cases/other-cards" ] || { echo "no logs of other cards in $cases (CSI5300_CASES)"; exit 77; }
# CSIKit needs NumPy 1, so it gets its own environment.
venv=${CARGO_TARGET_DIR:-target}/python-formats
[ -x "$venv/bin/python" ] || python3 -m venv "$venv"
"$venv/bin/pip" install --quiet "numpy<2" CSIKit==2.5 csiread==1.4.1 || { echo "no CSIKit from PyPI"; exit 77; }
cargo build --quiet -p csi-formats --example frames
"$venv/bin/python" tests/checks/formats.py "${CARGO_TARGET_DIR:-target}/debug/examples/frames" "$cases/other-cards"
