#!/usr/bin/env bash
# Builds and tests the workspace research/ against the other crates, and runs its programs on simulated rooms.
set -euo pipefail
cd "$(dirname "$0")/../.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$PWD/target}"
cargo test --quiet --locked --manifest-path research/Cargo.toml
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
run() { cargo run --quiet --locked --manifest-path research/Cargo.toml -- "$@"; }
run rooms "$folder" 1
run folds "$folder" >"$folder/said"
grep -q 'motion capture, rooms_LOS: 1 places, 3 links' "$folder/said"
run over-time "$folder" >"$folder/said"
grep -q 'quarter 4' "$folder/said"
run skipping "$folder" >"$folder/said"
grep -q '^6 links' "$folder/said"
cargo run --quiet --locked --manifest-path research/Cargo.toml --bin range_change -- "$folder" >"$folder/said"
grep -q '^| motion capture, rooms_LOS | 3 |' "$folder/said"
cargo run --quiet --locked --manifest-path research/Cargo.toml --bin odometry -- "$folder" >"$folder/said"
grep -q '^| wheels, scale +3 %, antenna 0.08, 0.12, rooms_LOS | 3 |' "$folder/said"
cargo run --quiet --locked --manifest-path research/Cargo.toml --bin fleet -- 10 >"$folder/said"
grep -q '^| 10 | 3 | 3 of 4 |' "$folder/said"
