#!/usr/bin/env bash
# Builds the wheel for every x86-64 Linux with glibc 2.17 (2014) or later (manylinux2014) and Python 3.10 or later, linked by zig against
# that library's symbols, and prints auditwheel's result. Exit status 77: PyPI cannot be reached.
# usage: scripts/wheel.sh [FOLDER]      (default: target/wheels)
set -euo pipefail
cd "$(dirname "$0")/.."
export PIP_DISABLE_PIP_VERSION_CHECK=1
CARGO_TARGET_DIR=$(realpath -m "${CARGO_TARGET_DIR:-target}")
export CARGO_TARGET_DIR
out=$(realpath -m "${1:-$CARGO_TARGET_DIR/wheels}")
tools=$CARGO_TARGET_DIR/wheel-tools
[ -x "$tools/bin/python" ] || python3 -m venv "$tools"
"$tools/bin/pip" install --quiet 'maturin>=1.7,<2' ziglang auditwheel || { echo "PyPI cannot be reached"; exit 77; }
rm -f "$out"/csi5300-*.whl
(cd python && PATH="$tools/bin:$PATH" maturin build --quiet --release --zig --compatibility manylinux2014 --out "$out")
wheel=$(echo "$out"/csi5300-*.whl)
found=$("$tools/bin/auditwheel" show "$wheel" | tr -s '\n' ' ')
[[ "$found" == *'platform tag: "manylinux_2_17_x86_64"'* ]] || { echo "it is not what its name says: $found"; exit 1; }
ls -l "$wheel"
