#!/usr/bin/env bash
# Builds csi5300 and csi5300-node as static programs for any x86-64 Linux from kernel 3.2 on, with any C library (including Ubuntu 16.04
# and 18.04), and prints their sizes.
set -euo pipefail
cd "$(dirname "$0")/.."
target=x86_64-unknown-linux-gnu
export RUSTFLAGS="-C target-feature=+crt-static ${RUSTFLAGS:-}"
mkdir -p target/dist
# One after the other: built together, each would have the features of both.
for program in csi5300:csi5300-cli csi5300-node:csi5300-node; do
    name=${program%:*}
    cargo build --release --package "${program#*:}" --bin "$name" --target "$target"
    strip -o "target/dist/$name" "target/$target/release/$name"
    # A static-pie executable may have a dynamic section, but no interpreter and no needed library.
    if readelf -ld "target/dist/$name" | grep -E 'INTERP|\(NEEDED\)'; then
        echo "not static" >&2
        exit 1
    fi
    "target/dist/$name" --version
    printf 'target/dist/%s: %s bytes\n' "$name" "$(stat -c %s "target/dist/$name")"
done
# Also as a Debian package, if possible.
! command -v dpkg-deb >/dev/null || scripts/deb.sh
