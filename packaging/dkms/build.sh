#!/usr/bin/env bash
# Makes csi5300-dkms_VERSION_all.deb: sources of the module, and what DKMS needs. Usage: build.sh [FOLDER]
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
out=$(realpath "${1:-.}")
version=$(sed -n 's/^version = "\(.*\)"/\1/p' "$here/../../Cargo.toml" | head -n 1)
[ -n "$version" ] || { echo "no version in Cargo.toml"; exit 1; }
tree=$(mktemp -d)
trap 'rm -rf "$tree"' EXIT
chmod 755 "$tree"
src=$tree/usr/src/csi5300-$version
mkdir -p "$src" "$tree/DEBIAN" "$tree/usr/share/doc/csi5300-dkms"
cp "$here"/../../driver-iface/kmod/csi5300{.c,_asks.h,_cards.h,_records.h} "$here/Makefile" "$src"
sed "s/@VERSION@/$version/" "$here/dkms.conf" >"$src/dkms.conf"
cp "$here/../../driver-iface/kmod/README.md" "$tree/usr/share/doc/csi5300-dkms"
for script in postinst prerm; do
    sed "s/@VERSION@/$version/g" "$here/$script" >"$tree/DEBIAN/$script"
    chmod 755 "$tree/DEBIAN/$script"
done
cat >"$tree/DEBIAN/control" <<END
Package: csi5300-dkms
Version: $version
Architecture: all
Section: kernel
Priority: optional
Maintainer: the csi5300 project <csi5300@localhost>
Depends: dkms (>= 2.2), make, gcc
Recommends: linux-headers-amd64 | linux-headers-generic
Description: CSI of the Intel 5300 beside the stock iwlwifi
 A kernel module, written for 4.15 to 7.2, that sends the channel state information
 of an Intel 5300 over the kernel connector as csitool's patched driver does, with the
 distribution's own iwlwifi and iwldvm.
END
find "$src" "$tree/usr/share/doc/csi5300-dkms" -type f -exec chmod 644 {} +
dpkg-deb --root-owner-group --build "$tree" "$out/csi5300-dkms_${version}_all.deb" >/dev/null
echo "$out/csi5300-dkms_${version}_all.deb"
