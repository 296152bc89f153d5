#!/usr/bin/env bash
# The node's topics over zenoh with a node made with hiroz, an independent implementation of rmw_zenoh's format in Rust
# (tests/checks/ros2/hiroz, which fetches and builds 400 crates): robots' odometry in; directions, the team's factors and four other
# standard messages back, with their attachments; and the graph. 77: crates.io cannot be reached.
set -euo pipefail
cd "$(dirname "$0")/../.."
manifest=tests/checks/ros2/hiroz/Cargo.toml
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$PWD/target}"
cargo fetch --quiet --locked --manifest-path "$manifest" 2>/dev/null || { echo "hiroz cannot be fetched from crates.io"; exit 77; }
csi5300=$(scripts/program.sh)
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cargo build --quiet --locked --offline --manifest-path "$manifest"
cp examples/ros2/*.toml "$folder"
"$CARGO_TARGET_DIR/debug/csi5300-hiroz-check" "$csi5300" "$folder"
