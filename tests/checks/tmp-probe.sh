#!/usr/bin/env bash
# The distribution's own driver with csi5300.ko beside it, in QEMU: tests/kernel/stock/*.sh on Debian's 6.1 with cards that
# are not there (tests/kernel/fakecard), then module and eBPF program on other kernels. See tests/kernel/README.md.
# Exit status 77: cannot run here, the last line says why.
set -euo pipefail
cd "$(dirname "$0")/../.."
check="stock driver"
source tests/kernel/guest.bash

packages
version=$(dpkg-query -W -f '${Version}' "linux-headers-$V")

# The private headers of iwlwifi, for the fake card: the source package in the version of the headers.
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
grep -q "struct iwl_trans_ops {" "$iwl/iwl-trans.h" || cannot "the transport of $V is no table of functions: no fake card"
build_modules driver-iface/kmod
build_modules tests/kernel/fakecard IWL="$iwl"
printf 'modules built after %s s\n' "$SECONDS"

tree=$place/tree-stock
guest_tree "$tree" tests/kernel/stock "$place/boot" "$place/kmod" "$place/fakecard"
static_binaries "$tree"
# A firmware of 24 bytes of header and zeros: version 8.24.2.12, and sections that tell the init image from the other.
le32() { printf "\\x$(printf %02x $(($1 & 255)))\\x$(printf %02x $(($1 >> 8 & 255)))\\x$(printf %02x $(($1 >> 16 & 255)))\\x$(printf %02x $(($1 >> 24 & 255)))"; }
{
    for word in $((8 << 24 | 24 << 16 | 2 << 8 | 12)) 128 128 64 64 0; do le32 "$word"; done
    head -c 384 /dev/zero
} >"$tree/lib/firmware/iwlwifi-5000-2.ucode"
cp tests/kernel/stock/room.toml "$tree/guest"
# Kernels for which there is no fake card: a module calls what iwldvm would call. 6.12, from the backports (its transport is
# no table of functions any more), 5.10, from Debian 11, and 6.1 with PREEMPT_RT.
program=$tree/bin/csi5300

# series NUMBER SUITE [FLAVOUR]: image and headers of that series, in a folder of its own; why not, where they cannot be had.
series() {
    local key=/usr/share/keyrings/debian-archive-keyring.gpg flavour=${3:-amd64} site security name needs headers
    later=$place/$1-$flavour
    [ ! -e "$later/complete" ] || return 0
    [ -e "$key" ] || { echo "no $key"; return 1; }
    rm -rf "$later"
    mkdir -p "$later"/{debs,root,boot,lists/partial}
    # From where this machine has its own packages.
    site=$(apt-get indextargets --format '$(RELEASE) $(SITE)' 2>/dev/null | sed -n 's/^bookworm //p' | head -n 1)
    [ -n "$site" ] || { echo "apt has no bookworm here"; return 1; }
    echo "deb [signed-by=$key] $site $2 main" >"$later/sources.list"
    # The newest image of a series may be there only; what is not, is not missed.
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
    # The compiler of this machine, whichever built that kernel.
    [ ! -e "$headers/.kernelvariables" ] || sed -i 's/gcc-[0-9]*/gcc/' "$headers/.kernelvariables"
    # Modules are compressed in some, so all of the folder's form.
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
    # What such a kernel can have: no fake card, and no test senders.
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
# What passed has passed, but this is no pass.
[ -z "$missing" ] || cannot "the packages of $missing cannot be had"
