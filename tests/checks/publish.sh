#!/usr/bin/env bash
# Packages the library and its dependencies for crates.io, and builds them from their packages alone.
# 77: crates.io cannot be reached.
set -euo pipefail
cd "$(dirname "$0")/../.."
said=$(mktemp)
# A new folder each time: Cargo keeps unpacked packages of a version, by the folder in which they were packed.
mkdir -p target
packed=$(mktemp -d target/publish-XXXXXX)
trap 'rm -rf "$said" "$packed"' EXIT
# Without optimisation: only the build matters.
plain=(--config profile.dev.debug=0)
for crate in csi5300 csi5300-kernels csi-formats driver-iface; do plain+=(--config "profile.dev.package.$crate.opt-level=0"); done
if ! cargo publish "${plain[@]}" --dry-run --allow-dirty --target-dir "$packed" -p driver-iface -p csi-formats -p csi5300-kernels -p csi5300 2>"$said"; then
    cat "$said"
    grep -qE 'failed to (get|fetch|download)|network|spurious' "$said" && { echo "crates.io cannot be reached"; exit 77; }
    exit 1
fi
grep -E 'Packaged|Uploading' "$said"
