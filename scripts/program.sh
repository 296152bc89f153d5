#!/usr/bin/env bash
# Prints the path of the program with all features: CSI5300 (.ci/run has built it for its tests), or a new build.
set -euo pipefail
[ -z "${CSI5300:-}" ] || exec realpath "$CSI5300"
cd "$(dirname "$0")/.."
cargo test --quiet -p csi5300-node -p csi5300-cli --all-features --no-run >&2
realpath "${CARGO_TARGET_DIR:-target}/debug/csi5300"
