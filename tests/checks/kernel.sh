#!/usr/bin/env bash
# Boots Debian's kernel in QEMU and runs tests/kernel/guest/*.sh in it; see tests/kernel/README.md.
# Everything is downloaded into target/kernel and unpacked there; only the kernel's headers are installed.
# Exit status 77: cannot run here, the last line says why.
set -euo pipefail
cd "$(dirname "$0")/../.."
root=$PWD
place=$root/target/kernel
MODULES="virtio virtio_ring libarc4 rfkill cfg80211 mac80211 mac80211_hwsim"
TARGET=x86_64-unknown-linux-gnu
export DEBIAN_FRONTEND=noninteractive CARGO_TERM_COLOR=never

cannot() {
    printf 'skipped, kernel tests: %s\n' "$1"
    exit 77
}
quietly() {
    "$@" >"$place/last.log" 2>&1 </dev/null || { tail -n 5 "$place/last.log"; return 1; }
}

[ "$(uname -sm)" = "Linux x86_64" ] || cannot "not x86-64 Linux"
for tool in apt-get apt-cache dpkg dpkg-deb make; do
    command -v "$tool" >/dev/null || cannot "$tool is not installed"
done
mkdir -p "$place/debs"

# The newest kernel of the archive: old versions leave it.
version() { apt-cache depends linux-image-amd64 2>/dev/null | sed -n 's/.*Depends: linux-image-//p' | head -n 1; }
V=$(version)
[ -n "$V" ] || { quietly apt-get update || true; V=$(version); }
[ -n "$V" ] || cannot "apt knows no linux-image-amd64"

# Headers have to be installed: unpacked ones do not build. Nothing may be removed for them.
if [ ! -e "/usr/src/linux-headers-$V/Makefile" ]; then
    [ "$(id -u)" = 0 ] || cannot "linux-headers-$V is not installed, and installing it needs root"
    quietly apt-get install -y --no-install-recommends --no-remove "linux-headers-$V" ||
        { quietly apt-get update && quietly apt-get install -y --no-install-recommends --no-remove "linux-headers-$V"; } ||
        cannot "linux-headers-$V cannot be installed"
fi

# QEMU and the guest's tools, with what they need and this machine lacks, into a folder of their own.
if [ ! -e "$place/complete-$V" ]; then
    rm -rf "$place"/complete-* "$place/unpacked" "$place/boot"
    mkdir -p "$place/unpacked" "$place/boot"
    wanted="qemu-system-x86 busybox-static cpio iw wireless-regdb"
    names=$(apt-get install -y --no-install-recommends --reinstall --print-uris $wanted 2>/dev/null </dev/null |
        sed -n "s/^'[^']*' \([a-z0-9.+-]*\)_.*\.deb .*/\1/p") || true
    [ -n "$names" ] || cannot "apt finds no qemu-system-x86"
    (cd "$place/debs" && quietly apt-get download $names "linux-image-$V") || cannot "the packages cannot be downloaded"
    for deb in "$place"/debs/*.deb; do
        case "$deb" in
            */linux-image-*) ;;
            *) dpkg-deb --extract "$deb" "$place/unpacked" ;;
        esac
    done
    wildcards=("./boot/vmlinuz*")
    for module in $MODULES; do wildcards+=("*/$module.ko"); done
    dpkg-deb --fsys-tarfile "$place/debs/linux-image-$V"_*.deb |
        tar -x -C "$place/boot" --wildcards "${wildcards[@]}" || cannot "linux-image-$V has no uncompressed modules"
    rm -f "$place"/debs/*
    touch "$place/complete-$V"
fi
unpacked=$place/unpacked
libraries=$unpacked/usr/lib/x86_64-linux-gnu:$unpacked/lib/x86_64-linux-gnu
printf 'kernel %s: packages ready after %s s\n' "$V" "$SECONDS"

# The modules, with the compiler of the headers.
rm -rf "$place/kmod"
cp -r driver-iface/kmod "$place/kmod"
quietly make -C "/usr/src/linux-headers-$V" M="$place/kmod" modules || { echo "the modules do not build"; exit 1; }
strip --strip-debug "$place"/kmod/*.ko
printf 'modules built after %s s\n' "$SECONDS"

# Static binaries: the program, and the tests that run in the guest.
export RUSTFLAGS="-C target-feature=+crt-static"
{
    cargo test --quiet --no-run -p csi5300-live --test live --target "$TARGET" --message-format=json &&
        cargo build --quiet -p csi5300-cli --no-default-features --features live --target "$TARGET" --message-format=json
} >"$place/built.json" </dev/null || { echo "the static binaries do not build"; exit 1; }
rm -rf "$place/tree"
mkdir -p "$place/tree"/{bin,tests,modules,guest,lib/firmware}
binary() { sed -n "s/.*\"name\":\"$1\".*\"executable\":\"\([^\"]*\)\".*/\1/p" "$place/built.json" | tail -n 1; }
strip -o "$place/tree/tests/live" "$(binary live)"
strip -o "$place/tree/bin/csi5300" "target/$TARGET/debug/csi5300"
printf 'binaries built after %s s\n' "$SECONDS"

# The guest's root.
tree=$place/tree
find "$place/boot" -name '*.ko' -exec cp {} "$tree/modules" \;
cp "$place"/kmod/*.ko "$tree/modules"
cp tests/kernel/guest/*.sh "$tree/guest"
cp tests/kernel/init "$tree/init"
cp tests/kernel/load "$tree/bin/load"
chmod +x "$tree/init" "$tree/bin/load"
cp "$unpacked"/bin/busybox "$tree/bin/busybox"
for file in regulatory.db regulatory.db.p7s; do
    found=$(find "$unpacked/lib/firmware" "$unpacked/usr/lib/firmware" -name "$file-debian" 2>/dev/null | head -n 1 || true)
    [ -z "$found" ] || cp "$found" "$tree/lib/firmware/$file"
done
iw=$(find "$unpacked" -path '*bin/iw' -type f | head -n 1)
if [ -n "$iw" ]; then
    cp "$iw" "$tree/bin/iw"
    LD_LIBRARY_PATH=$libraries ldd "$iw" | grep -o '/[^ ]*' | while read -r library; do
        case "$library" in
            */ld-linux*) mkdir -p "$tree/lib64" && cp -L "$library" "$tree/lib64" ;;
            *) mkdir -p "$tree/lib/x86_64-linux-gnu" && cp -L "$library" "$tree/lib/x86_64-linux-gnu" ;;
        esac
    done
fi
cpio=$(find "$unpacked" -path '*bin/cpio' -type f | head -n 1)
(cd "$tree" && find . | "$cpio" --quiet -o -H newc >"$place/initramfs")
printf 'initramfs of %s KiB after %s s\n' "$(($(stat -c %s "$place/initramfs") / 1024))" "$SECONDS"

# Plain emulation, in virtual time: KVM is not to be had everywhere, and the answer must not depend on it.
status=0
LD_LIBRARY_PATH=$libraries timeout 400 "$unpacked/usr/bin/qemu-system-x86_64" \
    -L "$unpacked/usr/share/qemu" -L "$unpacked/usr/share/seabios" \
    -accel tcg,thread=single -icount shift=1,sleep=off -m 512 -smp 1 -nodefaults -no-reboot -display none \
    -serial stdio -serial "file:$place/out.tar.gz" -device isa-debug-exit,iobase=0xf4,iosize=4 \
    -kernel "$place"/boot/boot/vmlinuz-* -initrd "$place/initramfs" \
    -append "console=ttyS0 panic=-1 quiet" </dev/null | tee "$place/guest.log" || status=${PIPESTATUS[0]}
printf 'guest ended with status %s after %s s\n' "$status" "$SECONDS"
[ "$status" = 33 ] || exit 1

# The logs of the guest's robots, read once more here: the same pairs, by the same test and by `info`.
rm -rf "$place/out"
mkdir "$place/out"
# The guest and the host tell the time apart by seconds.
tar -xzmf "$place/out.tar.gz" -C "$place/out"
for links in "$place"/out/*/links; do
    cd "${links%/*}"
    CSI5300_TEST_GUEST_LINKS=$(cat links) "$tree/tests/live" --exact kernel_sounding::every_answered_frame_is_a_pair_of_the_logs --nocapture >checked ||
        { cat checked; echo "the copied logs of ${PWD##*/} are not those of the guest"; exit 1; }
    grep -q "1 passed" checked
    printf 'copied out, %s: %s\n' "${PWD##*/}" "$(grep -c pairs checked) links with pairs, $("$tree/bin/csi5300" info --json ./*.dat | wc -l) logs read"
done
[ -d "$place/out/three" ] && [ -d "$place/out/two-wsr" ]
