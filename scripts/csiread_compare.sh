#!/bin/sh
# Compares csi5300 with csiread (PyPI) on logs of the stock layout: raw CSI exactly, scaled CSI to 1e-6.
#
# usage: scripts/csiread_compare.sh [LOG...]
# Without arguments: every stock-layout log in csitool/ below the captures (CSI5300_CAPTURES, or ../shared/captures).
# Exit status 0 agreement, 1 disagreement, 2 nothing to compare.
set -eu
root=$(cd "$(dirname "$0")/.." && pwd)
captures=${CSI5300_CAPTURES:-$root/../shared/captures}
if [ $# -eq 0 ]; then
    set -- "$captures"/csitool/*.dat
fi
if [ ! -e "$1" ]; then
    echo "nothing to compare: no logs at $captures/csitool (set CSI5300_CAPTURES or name logs)" >&2
    exit 2
fi
python=$("$root/scripts/venv.sh" csiread==1.4.1 numpy)
target=${CARGO_TARGET_DIR:-$root/target}
# If CSI5300 names a program, the tests have built the example beside it.
[ -n "${CSI5300:-}" ] || cargo build --quiet --manifest-path "$root/Cargo.toml" --example dump_csi --bin csi5300
exec "$python" "$root/scripts/csiread_compare.py" "$target/debug/examples/dump_csi" "${CSI5300:-$target/debug/csi5300}" "$@"
