#!/bin/sh
# Makes (once) a Python virtual environment below target/ with the named packages, and prints its interpreter.
set -eu
root=$(cd "$(dirname "$0")/.." && pwd)
venv=${CARGO_TARGET_DIR:-$root/target}/python
if [ ! -x "$venv/bin/python" ]; then
    python3 -m venv "$venv" >&2
fi
"$venv/bin/pip" install --quiet --disable-pip-version-check "$@" >&2
echo "$venv/bin/python"
