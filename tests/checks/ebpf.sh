#!/usr/bin/env bash
# Builds the eBPF program from its source with Debian's clang-14 and compares it with the committed object, byte by byte.
# --write replaces the object. tests/checks/stock.sh (tests/kernel/stock/40-ebpf.sh) runs the program.
# Exit status 77: cannot run here; the last line says why.
set -euo pipefail
cd "$(dirname "$0")/../.."
place=$PWD/target/ebpf
export DEBIAN_FRONTEND=noninteractive

cannot() {
    printf 'skipped, eBPF object: %s\n' "$1"
    exit 77
}
[ "$(uname -sm)" = "Linux x86_64" ] || cannot "not x86-64 Linux"

clang=$(command -v clang-14 || true)
if [ -z "$clang" ]; then
    clang=$place/unpacked/usr/lib/llvm-14/bin/clang
    if [ ! -x "$clang" ]; then
        # Unpacks the packages without installing them; also downloads libraries that this machine already has.
        command -v apt-get >/dev/null && command -v dpkg-deb >/dev/null || cannot "neither clang-14 nor apt-get is installed"
        rm -rf "$place/debs" "$place/unpacked"
        mkdir -p "$place/debs" "$place/unpacked"
        packages="clang-14 libclang-cpp14 libllvm14 libclang-common-14-dev"
        download() { (cd "$place/debs" && apt-get download $packages) >"$place/last.log" 2>&1 </dev/null; }
        download || { apt-get update >/dev/null 2>&1 || true; download; } || cannot "apt has no clang-14: $(tail -n 1 "$place/last.log")"
        for deb in "$place"/debs/*.deb; do dpkg-deb --extract "$deb" "$place/unpacked"; done
        rm -rf "$place/debs"
    fi
    export LD_LIBRARY_PATH=$place/unpacked/usr/lib/llvm-14/lib:$place/unpacked/usr/lib/x86_64-linux-gnu
    "$clang" --version >"$place/last.log" 2>&1 || cannot "clang-14 does not start: $(tail -n 1 "$place/last.log")"
fi
version=$("$clang" --version | head -n 1)

# The object contains the source's name, so it is compiled in its own folder.
mkdir -p "$place"
(cd driver-iface/bpf && "$clang" -target bpfel -mcpu=v2 -O2 -Wall -Wextra -Werror -ffreestanding -nostdinc -fno-ident -fno-addrsig \
    -c csi5300.bpf.c -o "$place/csi5300.bpf.o")
if [ "${1:-}" = --write ]; then
    cp "$place/csi5300.bpf.o" driver-iface/bpf/csi5300.bpf.o
fi
cmp "$place/csi5300.bpf.o" driver-iface/bpf/csi5300.bpf.o || {
    printf 'driver-iface/bpf/csi5300.bpf.o differs from what %s builds: run tests/checks/ebpf.sh --write\n' "$version"
    exit 1
}
printf '%s: the object of %s bytes matches its source\n' "$version" "$(stat -c %s driver-iface/bpf/csi5300.bpf.o)"
