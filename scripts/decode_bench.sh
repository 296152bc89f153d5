#!/bin/sh
# Decoding speed against csiread (PyPI): a 200 MB WSR log, 3x1, one thread, warm, alternately, median (and least time) of 15.
#
# usage: scripts/decode_bench.sh [LOG]
# Without LOG, concatenates the real captures of ../shared/captures/paper (or CSI5300_CAPTURES) or, if there are none, uses records made
# by `emit`. Then a log with copies of the frames. Both are written, dropped from the page cache and read once before.
# Floors: all to f32 15x csiread's records per second, one antenna with 30 subcarriers 15x, with 8 subcarriers 25x (15x with copies of
# frames); the exit status is 1 if one is missed. Memory of the decoder: under 30 MB.
set -eu
root=$(cd "$(dirname "$0")/.." && pwd)
captures=${CSI5300_CAPTURES:-$root/../shared/captures}
python=$("$root/scripts/venv.sh" csiread==1.4.1 numpy)
cargo bench --quiet --manifest-path "$root/Cargo.toml" -p driver-iface --bench decode --no-run
target=${CARGO_TARGET_DIR:-$root/target}
bench=$(ls -t "$target"/release/deps/decode-* | grep -v '\.d$' | head -n 1)
exec "$python" "$root/scripts/decode_bench.py" "$bench" "$captures/paper" "$@"
