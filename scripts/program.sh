#!/usr/bin/env bash
# Builds the program with all features as .ci/run's tests do, so that nothing is built twice, and prints its path.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo test --quiet -p csi5300-sim -p csi5300-live -p csi5300-node -p csi5300-cli --all-features --no-run >&2
realpath "${CARGO_TARGET_DIR:-target}/debug/csi5300"
