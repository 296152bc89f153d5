#!/usr/bin/env bash
# Builds one static csi5300 that runs on any x86-64 Linux from kernel 3.2 on, whatever C library it has
# (Ubuntu 16.04 and 18.04 among them), and says how large it is.
set -euo pipefail
cd "$(dirname "$0")/.."
target=x86_64-unknown-linux-gnu
export RUSTFLAGS="-C target-feature=+crt-static ${RUSTFLAGS:-}"
cargo build --release --bin csi5300 --target "$target" "$@"
mkdir -p target/dist
strip -o target/dist/csi5300 "target/$target/release/csi5300"
# A static-pie executable may have a dynamic section, but no interpreter and no library that it needs.
if readelf -ld target/dist/csi5300 | grep -E 'INTERP|\(NEEDED\)'; then
    echo "not static" >&2
    exit 1
fi
target/dist/csi5300 --version
printf 'target/dist/csi5300: %s bytes\n' "$(stat -c %s target/dist/csi5300)"
# As a Debian package too, where that can be made.
! command -v dpkg-deb >/dev/null || scripts/deb.sh
