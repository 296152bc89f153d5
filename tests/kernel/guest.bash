# Shared by the checks with a kernel (tests/checks/kernel.sh, stock.sh, dkms.sh): sourced from the project's root.
# Everything is downloaded to target/kernel and unpacked there; only the kernel's headers are installed.
# Exit status 77: cannot run here; the last line says why.
root=$PWD
place=$root/target/kernel
MODULES="virtio virtio_ring libarc4 rfkill cfg80211 mac80211 mac80211_hwsim iwlwifi iwldvm"
TARGET=x86_64-unknown-linux-gnu
export DEBIAN_FRONTEND=noninteractive CARGO_TERM_COLOR=never

cannot() {
    printf 'skipped, %s: %s\n' "$check" "$1"
    exit 77
}
quietly() {
    "$@" >"$place/last.log" 2>&1 </dev/null || { tail -n 5 "$place/last.log"; return 1; }
}

# headers: sets V, the kernel's version, and installs its headers.
headers() {
    [ "$(uname -sm)" = "Linux x86_64" ] || cannot "not x86-64 Linux"
    for tool in apt-get apt-cache dpkg dpkg-deb make; do
        command -v "$tool" >/dev/null || cannot "$tool is not installed"
    done
    mkdir -p "$place/debs"
    # The archive's newest kernel; it drops old versions.
    version() { apt-cache depends linux-image-amd64 2>/dev/null | sed -n 's/.*Depends: linux-image-//p' | head -n 1; }
    V=$(version)
    [ -n "$V" ] || { quietly apt-get update || true; V=$(version); }
    [ -n "$V" ] || cannot "apt knows no linux-image-amd64"
    # Headers must be installed: unpacked ones do not build.
    [ -e "/usr/src/linux-headers-$V/Makefile" ] || installed "linux-headers-$V"
}

# installed PACKAGE: installs it, unless that would remove another package.
installed() {
    [ "$(id -u)" = 0 ] || cannot "$1 is not installed, and installing it needs root"
    quietly apt-get install -y --no-install-recommends --no-remove "$1" ||
        { quietly apt-get update && quietly apt-get install -y --no-install-recommends --no-remove "$1"; } ||
        cannot "$1 cannot be installed"
}

# packages: the headers, then the kernel's image and the tools, unpacked.
packages() {
    headers
    [ -e "$place/complete-3-$V" ] || unpack_packages
    unpacked=$place/unpacked
    libraries=$unpacked/usr/lib/x86_64-linux-gnu:$unpacked/lib/x86_64-linux-gnu
    printf 'kernel %s: packages ready after %s s\n' "$V" "$SECONDS"
}

# QEMU and the guest's tools, with dependencies that this machine lacks, in their own folder.
unpack_packages() {
    local wanted="qemu-system-x86 busybox-static cpio iw libcap2-bin wireless-regdb" names wildcards deb module
    rm -rf "$place"/complete-* "$place/unpacked" "$place/boot"
    mkdir -p "$place/unpacked" "$place/boot"
    names=$(apt-get install -y --no-install-recommends --reinstall --print-uris $wanted 2>/dev/null </dev/null |
        sed -n "s/^'[^']*' \([a-z0-9.+-]*\)_.*\.deb .*/\1/p") || true
    [ -n "$names" ] || cannot "apt finds no qemu-system-x86"
    (cd "$place/debs" && quietly apt-get download $names "linux-image-$V") || cannot "the packages cannot be downloaded"
    for deb in "$place"/debs/*.deb; do
        case "$deb" in
            */linux-*) ;;
            *) dpkg-deb --extract "$deb" "$place/unpacked" ;;
        esac
    done
    wildcards=("./boot/vmlinuz*")
    for module in $MODULES; do wildcards+=("*/$module.ko"); done
    dpkg-deb --fsys-tarfile "$place/debs/linux-image-$V"_*.deb |
        tar -x -C "$place/boot" --wildcards "${wildcards[@]}" || cannot "linux-image-$V has no uncompressed modules"
    rm -f "$place"/debs/*
    touch "$place/complete-3-$V"
}

# build_modules FOLDER [VARIABLE=VALUE ...]: builds the modules of a copy of that folder, with the headers' compiler.
build_modules() {
    local copy=$place/${1##*/}
    rm -rf "$copy"
    cp -r "$1" "$copy"
    quietly make -C "/usr/src/linux-headers-$V" M="$copy" W=1 "${@:2}" modules || { echo "the modules of $1 do not build"; exit 1; }
    if grep -q "warning:" "$place/last.log"; then
        grep -A 5 "warning:" "$place/last.log"
        exit 1
    fi
    strip --strip-debug "$copy"/*.ko
}

# static_binaries TREE: the program, and the tests that run in the guest. CSI5300_GUEST_BINARIES names a folder that already has them
# (`live`, `stock_guest`, `csi5300`); they need not be static.
static_binaries() {
    local from=${CSI5300_GUEST_BINARIES:-}
    binary() { sed -n "s/.*\"name\":\"$1\".*\"executable\":\"\([^\"]*\)\".*/\1/p" "$place/built.json" | tail -n 1; }
    if [ -n "$from" ]; then
        strip -o "$1/tests/live" "$from/live"
        strip -o "$1/tests/stock_guest" "$from/stock_guest"
        strip -o "$1/bin/csi5300" "$from/csi5300"
        with_libraries "$1" "$1/tests/live" "$1/tests/stock_guest" "$1/bin/csi5300"
        return 0
    fi
    {
        RUSTFLAGS="-C target-feature=+crt-static" \
            cargo test --quiet --no-run -p csi5300-live --test live --target "$TARGET" --message-format=json &&
            RUSTFLAGS="-C target-feature=+crt-static" \
                cargo test --quiet --no-run -p driver-iface --test stock_guest --target "$TARGET" --message-format=json &&
            RUSTFLAGS="-C target-feature=+crt-static" \
                cargo build --quiet -p csi5300-cli --target "$TARGET" --message-format=json
    } >"$place/built.json" </dev/null || { echo "the static binaries do not build"; exit 1; }
    strip -o "$1/tests/live" "$(binary live)"
    strip -o "$1/tests/stock_guest" "$(binary stock_guest)"
    strip -o "$1/bin/csi5300" "target/$TARGET/debug/csi5300"
    printf 'binaries built after %s s\n' "$SECONDS"
}

# with_libraries TREE PROGRAM...: copies the programs' shared libraries to where their loader looks.
with_libraries() {
    local tree=$1 program library
    for program in "${@:2}"; do
        LD_LIBRARY_PATH=$libraries ldd "$program" | grep -o '/[^ ]*' | while read -r library; do
            case "$library" in
                */ld-linux*) mkdir -p "$tree/lib64" && cp -L "$library" "$tree/lib64" ;;
                *) mkdir -p "$tree/lib/x86_64-linux-gnu" && cp -L "$library" "$tree/lib/x86_64-linux-gnu" ;;
            esac
        done
    done
}

# guest_tree TREE SCRIPTS MODULES: makes a root with these scripts and the modules of these folders.
guest_tree() {
    local tree=$1 file found tool
    rm -rf "$tree"
    mkdir -p "$tree"/{bin,tests,modules,guest,lib/firmware}
    for file in "${@:3}"; do find "$file" -name '*.ko' -exec cp {} "$tree/modules" \;; done
    cp "$2"/*.sh "$tree/guest"
    cp tests/kernel/init "$tree/init"
    cp tests/kernel/load tests/kernel/monitors "$tree/bin"
    chmod +x "$tree/init" "$tree/bin/load" "$tree/bin/monitors"
    cp "$unpacked"/bin/busybox "$tree/bin/busybox"
    for file in regulatory.db regulatory.db.p7s; do
        found=$(find "$unpacked/lib/firmware" "$unpacked/usr/lib/firmware" -name "$file-debian" 2>/dev/null | head -n 1 || true)
        [ -z "$found" ] || cp "$found" "$tree/lib/firmware/$file"
    done
    for tool in iw setcap; do
        found=$(find "$unpacked" -path "*bin/$tool" -type f | head -n 1)
        [ -n "$found" ] || continue
        cp "$found" "$tree/bin/$tool"
        with_libraries "$tree" "$tree/bin/$tool"
    done
}

# boot TREE KERNEL SECONDS: leaves the guest's status in `status`; the guest ends with 33 if all scripts passed. A kernel warning ends
# it, too. CSI5300_GUEST_APPEND: more kernel options.
# Plain emulation in virtual time: KVM is not available everywhere, and results must not depend on it. `cpus` sets a number of
# processors, which take turns; time is then this machine's, because QEMU counts instructions of a single processor only. Parallel
# processors (thread=multi) jump to address 0 when any kprobe, even an empty one, is set or removed (QEMU 7.2).
boot() {
    local cpio
    cpio=$(find "$unpacked" -path '*bin/cpio' -type f | head -n 1)
    (cd "$1" && find . | "$cpio" --quiet -o -H newc >"$place/initramfs")
    printf 'initramfs of %s KiB after %s s\n' "$(($(stat -c %s "$place/initramfs") / 1024))" "$SECONDS"
    status=0
    local machine=(-accel "tcg,thread=single" -icount "shift=1,sleep=off" -smp 1)
    [ -z "${cpus:-}" ] || machine=(-accel "tcg,thread=single" -smp "$cpus")
    LD_LIBRARY_PATH=$libraries timeout "$3" "$unpacked/usr/bin/qemu-system-x86_64" \
        -L "$unpacked/usr/share/qemu" -L "$unpacked/usr/share/seabios" \
        "${machine[@]}" -m 512 -nodefaults -no-reboot -display none \
        -serial stdio -serial "file:$place/out.tar.gz" -device isa-debug-exit,iobase=0xf4,iosize=4 \
        -kernel "$2" -initrd "$place/initramfs" \
        -append "console=ttyS0 panic=-1 panic_on_warn=1 oops=panic quiet ${CSI5300_GUEST_APPEND:-}" </dev/null | tee "$place/guest.log" || status=${PIPESTATUS[0]}
    printf 'guest ended with status %s after %s s\n' "$status" "$SECONDS"
}
