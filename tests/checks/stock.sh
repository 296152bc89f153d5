#!/usr/bin/env bash
# The distribution's own driver with csi5300.ko beside it, in QEMU: runs tests/kernel/stock/*.sh on Debian's 6.1 with fake cards
# (tests/kernel/fakecard), then the module and the eBPF program on other kernels. See tests/kernel/README.md.
# Exit status 77: cannot run here; the last line says why.
set -euo pipefail
cd "$(dirname "$0")/../.."
check="stock driver"
source tests/kernel/guest.bash

packages
version=$(dpkg-query -W -f '${Version}' "linux-headers-$V")

# The fake card needs iwlwifi's private headers: the source package in the version of the headers.
iwl=$place/source-$version/drivers/net/wireless/intel/iwlwifi
if [ ! -e "$place/source-$version/complete" ]; then
    rm -rf "$place"/source-*
    mkdir -p "$place/source-$version"
    series=$(echo "$V" | cut -d. -f1-2)
    (cd "$place/debs" && quietly apt-get download "linux-source-$series=$version") || cannot "linux-source-$series=$version cannot be downloaded"
    dpkg-deb --fsys-tarfile "$place"/debs/linux-source-*.deb | tar -xO --wildcards './usr/src/linux-source-*.tar.xz' |
        tar -xJ -C "$place/source-$version" --strip-components=1 --wildcards '*/drivers/net/wireless/intel/iwlwifi'
    rm -f "$place"/debs/linux-source-*
    touch "$place/source-$version/complete"
fi
grep -q "struct iwl_trans_ops {" "$iwl/iwl-trans.h" || cannot "the transport of $V is not a table of functions: no fake card"
build_modules driver-iface/kmod
build_modules tests/kernel/fakecard IWL="$iwl"
printf 'modules built after %s s\n' "$SECONDS"

tree=$place/tree-stock
guest_tree "$tree" tests/kernel/stock "$place/boot" "$place/kmod" "$place/fakecard"
static_binaries "$tree"
# A firmware file of a 24-byte header and zeros: version 8.24.2.12, and section sizes that distinguish the init image.
le32() { printf "\\x$(printf %02x $(($1 & 255)))\\x$(printf %02x $(($1 >> 8 & 255)))\\x$(printf %02x $(($1 >> 16 & 255)))\\x$(printf %02x $(($1 >> 24 & 255)))"; }
{
    for word in $((8 << 24 | 24 << 16 | 2 << 8 | 12)) 128 128 64 64 0; do le32 "$word"; done
    head -c 384 /dev/zero
} >"$tree/lib/firmware/iwlwifi-5000-2.ucode"
cp tests/kernel/stock/room.toml "$tree/guest"
boot "$tree" "$(echo "$place"/boot/boot/vmlinuz-*)" 900
[ "$status" = 33 ] || exit 1
rm "$tree"/guest/*.sh
cp tests/kernel/stock-races/*.sh "$tree/guest"
cpus=2 boot "$tree" "$(echo "$place"/boot/boot/vmlinuz-*)" 600
[ "$status" = 33 ] || exit 1

# Kernels without a fake card: a module makes iwldvm's calls instead. 6.12 from the backports (its transport is no longer a table of
# functions), 5.10 from Debian 11, and 6.1 with PREEMPT_RT.
program=$tree/bin/csi5300

# series NUMBER SUITE [FLAVOUR]: downloads image and headers of that series into their own folder, or says why not.
series() {
    local key=/usr/share/keyrings/debian-archive-keyring.gpg flavour=${3:-amd64} site security name needs headers
    later=$place/$1-$flavour
    [ ! -e "$later/complete" ] || return 0
    [ -e "$key" ] || { echo "no $key"; return 1; }
    rm -rf "$later"
    mkdir -p "$later"/{debs,root,boot,lists/partial}
    # From this machine's own package source.
    site=$(apt-get indextargets --format '$(RELEASE) $(SITE)' 2>/dev/null | sed -n 's/^bookworm //p' | head -n 1)
    [ -n "$site" ] || { echo "apt has no bookworm here"; return 1; }
    echo "deb [signed-by=$key] $site $2 main" >"$later/sources.list"
    # The newest image of a series may only be in the security archive, which need not exist.
    security=$(apt-get indextargets --format '$(RELEASE) $(SITE)' 2>/dev/null | sed -n "s/^$2-security //p" | head -n 1)
    [ -z "$security" ] || echo "deb [signed-by=$key] $security $2-security main" >>"$later/sources.list"
    apt_of() {
        local verb=$1
        shift
        "apt-$verb" -o Dir::Etc::sourcelist="$later/sources.list" -o Dir::Etc::sourceparts=- -o Dir::State::lists="$later/lists" \
            -o Dir::Cache::pkgcache= -o Dir::Cache::srcpkgcache= "$@"
    }
    quietly apt_of get update || return 1
    name=$(apt_of cache depends "linux-image-$flavour" 2>/dev/null | sed -n "s/.*Depends: linux-image-\(${1/./\\.}\.[^ ]*\)\$/\1/p" | head -n 1)
    [ -n "$name" ] || { echo "$2 has no $1 $flavour"; return 1; }
    needs=$(apt_of cache depends "linux-headers-$name" 2>/dev/null | sed -n 's/.*Depends: \(linux-kbuild-[^ ]*\|linux-headers-[^ ]*-common\(-rt\)\?\)$/\1/p')
    (cd "$later/debs" && quietly apt_of get download "linux-image-$name" "linux-headers-$name" $needs) || return 1
    for deb in "$later"/debs/linux-headers-*.deb "$later"/debs/linux-kbuild-*.deb; do dpkg-deb --extract "$deb" "$later/root"; done
    headers=$later/root/usr/src/linux-headers-$name
    sed -i "s#include /usr/src#include $later/root/usr/src#" "$headers/Makefile"
    # This machine's compiler, whichever built that kernel.
    [ ! -e "$headers/.kernelvariables" ] || sed -i 's/gcc-[0-9]*/gcc/' "$headers/.kernelvariables"
    # Some packages have compressed modules, so the folder's modules are uncompressed.
    dpkg-deb --fsys-tarfile "$later"/debs/linux-image-*.deb | tar -x -C "$later/boot" --wildcards './boot/vmlinuz*' \
        '*/libarc4.ko*' '*/rfkill.ko*' '*/cfg80211.ko*' '*/mac80211.ko*' '*/iwlwifi.ko*' '*/iwldvm.ko*' || return 1
    find "$later/boot" -name '*.xz' -exec unxz {} +
    rm -rf "$later/debs"
    echo "$name" >"$later/complete"
}

# probe NUMBER SUITE [FLAVOUR]: csi5300.ko and the eBPF program on that kernel.
probe() {
    if ! series "$@"; then
        echo "$*: its packages cannot be had (above)"
        missing="${missing:+$missing, }$*"
        return 0
    fi
    local folder tree
    for folder in driver-iface/kmod tests/kernel/fakecard; do
        rm -rf "$later/${folder##*/}"
        cp -r "$folder" "$later/${folder##*/}"
    done
    # Only what such a kernel supports: no fake card and no test senders.
    echo "obj-m := csi5300.o" >"$later/kmod/Makefile"
    echo "obj-m := caller.o" >"$later/fakecard/Makefile"
    for folder in kmod fakecard; do
        quietly make -C "$later/root/usr/src/linux-headers-$(cat "$later/complete")" M="$later/$folder" W=1 CONFIG_DEBUG_INFO_BTF_MODULES= modules ||
            { echo "the modules do not build for $*"; exit 1; }
        if grep -A 5 "warning: .*\(csi5300\|caller\)\|\(csi5300\|caller\).*warning:" "$place/last.log"; then exit 1; fi
        strip --strip-debug "$later/$folder"/*.ko
    done
    tree=$place/tree-probe
    guest_tree "$tree" tests/kernel/stock-probe "$later/boot" "$later/kmod" "$later/fakecard"
    cp "$program" "$tree/bin/csi5300"
    [ -z "${CSI5300_GUEST_BINARIES:-}" ] || with_libraries "$tree" "$tree/bin/csi5300"
    boot "$tree" "$(echo "$later"/boot/boot/vmlinuz-*)" 300
    [ "$status" = 33 ] || exit 1
}
missing=
probe 6.12 bookworm-backports
probe 5.10 bullseye
probe 6.1 bookworm rt-amd64
# All that ran has passed, but the check is incomplete.
[ -z "$missing" ] || cannot "the packages of $missing cannot be had"
