#!/usr/bin/env bash
# What each feature costs: crates that it compiles, time of a release build from nothing, size of the stripped program.
# Builds into a folder of its own, which it removes. Usage: scripts/feature_costs.sh [CARGO_ARGS ...], one row for each
# argument (such as "--features zenoh"); all rows of the README without arguments.
set -euo pipefail
cd "$(dirname "$0")/.."
rows=("--no-default-features" "--no-default-features --features live,plot" "" "--features foxglove" "--features ros1" "--features zenoh")
[ $# -eq 0 ] || rows=("$@")
cargo fetch --quiet
target=$(mktemp -d)
trap 'rm -rf "$target"' EXIT
printf '| build | crates | seconds | megabytes |\n|---|---|---|---|\n'
for row in "${rows[@]}"; do
    rm -rf "${target:?}"/*
    # shellcheck disable=SC2086
    crates=$(cargo tree -p csi5300-cli --edges normal,build --prefix none $row | sed 's/ (\*)$//' | sort -u | wc -l)
    start=$EPOCHREALTIME
    # shellcheck disable=SC2086
    CARGO_TARGET_DIR=$target cargo build -p csi5300-cli --release --quiet $row
    seconds=$(awk -v a="$start" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.0f", b - a }')
    strip -o "$target/stripped" "$target/release/csi5300"
    megabytes=$(awk -v bytes="$(stat -c %s "$target/stripped")" 'BEGIN { printf "%.1f", bytes / 1e6 }')
    printf '| `%s` | %s | %s | %s |\n' "${row:-default}" "$crates" "$seconds" "$megabytes"
done
