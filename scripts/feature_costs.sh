#!/usr/bin/env bash
# The cost of each feature: compiled crates, time of a release build from scratch, size of the stripped program.
# Builds into a temporary folder. Usage: scripts/feature_costs.sh [CARGO_ARGS ...], one row for each argument (such as
# "-p csi5300-node --features zenoh"); without arguments, all rows of the README.
set -euo pipefail
cd "$(dirname "$0")/.."
rows=("-p csi5300-cli --no-default-features" "-p csi5300-cli --no-default-features --features live,plot" "-p csi5300-cli" "-p csi5300-node" "-p csi5300-node --features foxglove"
    "-p csi5300-node --features zenoh")
[ $# -eq 0 ] || rows=("$@")
cargo fetch --quiet
target=$(mktemp -d)
trap 'rm -rf "$target"' EXIT
printf '| build | crates | seconds | megabytes |\n|---|---|---|---|\n'
for row in "${rows[@]}"; do
    rm -rf "${target:?}"/*
    # shellcheck disable=SC2086
    crates=$(cargo tree --edges normal,build --prefix none $row | sed 's/ (\*)$//' | sort -u | wc -l)
    start=$EPOCHREALTIME
    # shellcheck disable=SC2086
    CARGO_TARGET_DIR=$target cargo build --release --quiet $row
    seconds=$(awk -v a="$start" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.0f", b - a }')
    program=csi5300
    [[ $row != *csi5300-node* ]] || program=csi5300-node
    strip -o "$target/stripped" "$target/release/$program"
    megabytes=$(awk -v bytes="$(stat -c %s "$target/stripped")" 'BEGIN { printf "%.1f", bytes / 1e6 }')
    printf '| `%s` | %s | %s | %s |\n' "$row" "$crates" "$seconds" "$megabytes"
done
