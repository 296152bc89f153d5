#!/usr/bin/env bash
# Installs the kernel module's package with dpkg and DKMS: built for the installed headers (whatever kernel runs), installed, and
# removed without a trace. Exit status 77: cannot run here; the last line says why.
set -euo pipefail
cd "$(dirname "$0")/../.."
check="DKMS"
source tests/kernel/guest.bash

headers
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
quietly packaging/dkms/build.sh "$folder" || { echo "the package is not made"; exit 1; }
deb=$(echo "$folder"/csi5300-dkms_*_all.deb)
version=$(dpkg-deb --field "$deb" Version)
# The installed sources also build without DKMS.
dpkg-deb --extract "$deb" "$folder/root"
quietly make -C "$folder/root/usr/src/csi5300-$version" KDIR="/usr/src/linux-headers-$V" || { echo "the package's module does not build"; exit 1; }
# Leaves a module or package that this machine uses alone.
[ ! -e /sys/module/csi5300 ] || cannot "the module is loaded on this machine"
! dpkg-query -W -f '${Status}' csi5300-dkms 2>/dev/null | grep -q "^install" || cannot "the package is installed on this machine"
[ "$(id -u)" = 0 ] || cannot "installing a package needs root"
command -v dkms >/dev/null || installed dkms

gone() { dpkg --purge csi5300-dkms >/dev/null 2>&1 || true; }
trap 'gone; rm -rf "$folder"' EXIT
quietly dpkg --install "$deb" || { cat "$place/last.log"; exit 1; }
status=$(dkms status -m csi5300 -v "$version" -k "$V")
echo "$status"
grep -q "^csi5300/$version, $V, x86_64: installed$" <<<"$status" || { cat "$place/last.log"; exit 1; }
module=$(find "/lib/modules/$V/updates/dkms" -name 'csi5300.ko*')
[ "$(echo "$module" | wc -w)" = 1 ] || { echo "installed: ${module:-nothing}"; exit 1; }
modinfo -F vermagic "$module" | grep -q "^$V " || { echo "it is for another kernel"; exit 1; }
modinfo -F license "$module" | grep -q "^GPL"
# Installed again over itself, as an upgrade does.
quietly dpkg --install "$deb" || { cat "$place/last.log"; exit 1; }
dkms status -m csi5300 -v "$version" -k "$V" | grep -q ": installed$"
quietly dpkg --purge csi5300-dkms || { cat "$place/last.log"; exit 1; }
left=$(dkms status -m csi5300; find /lib/modules /usr/src /var/lib/dkms -maxdepth 4 -name '*csi5300*')
[ -z "$left" ] || { echo "left behind: $left"; exit 1; }
echo "installed for $V, upgraded and removed after $SECONDS s"
