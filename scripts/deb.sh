#!/usr/bin/env bash
# Makes a .deb of the programs: scripts/deb.sh [PROGRAM] [FOLDER]. PROGRAM, with csi5300-node beside it, defaults to the static one of
# scripts/dist.sh, FOLDER to target/dist.
# Contents: the programs, completions and manual pages, the service's unit (neither enabled nor started) and an example configuration.
# An upgrade restarts a running service; a removal stops and disables it.
set -euo pipefail
cd "$(dirname "$0")/.."
program=${1:-target/dist/csi5300}
out=${2:-target/dist}
[ -x "$program" ] || { echo "no program at $program: scripts/dist.sh makes a static one" >&2; exit 1; }
node=$(dirname "$program")/csi5300-node
[ -x "$node" ] || { echo "no program at $node: scripts/dist.sh makes a static one" >&2; exit 1; }
command -v dpkg-deb >/dev/null || { echo "no dpkg-deb (apt-get install dpkg)" >&2; exit 1; }
version=$("$program" --version | cut -d' ' -f2)
arch=$(dpkg --print-architecture)
root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT
chmod 755 "$root"

install -D -m 755 "$program" "$root/usr/bin/csi5300"
install -D -m 755 "$node" "$root/usr/bin/csi5300-node"
strip "$root"/usr/bin/*
completions() { mkdir -p "$root$(dirname "$2")" && "$program" completions "$1" >"$root$2"; }
completions bash /usr/share/bash-completion/completions/csi5300
completions zsh /usr/share/zsh/vendor-completions/_csi5300
completions fish /usr/share/fish/vendor_completions.d/csi5300.fish
# A manual page for each program and command: its --help.
page() { # NAME COMMAND...
    mkdir -p "$root/usr/share/man/man1"
    {
        printf '.TH %s 1 "" "csi5300 %s"\n.SH NAME\n%s \\- %s\n.SH DESCRIPTION\n.nf\n' "$1" "$version" "$1" "$("${@:2}" --help | head -n 1)"
        "${@:2}" --help | tail -n +2 | sed 's/\\/\\\\/g; s/-/\\-/g; s/^\([.'"'"']\)/\\\&\1/'
    } >"$root/usr/share/man/man1/$1.1"
}
page csi5300 "$program"
page csi5300-node "$node"
for command in $("$program" --help | sed -n '/^Commands:/,/^$/p' | awk '/^  [a-z]/ && $1 != "help" { print $1 }'); do
    page "csi5300-$command" "$program" "$command"
done
gzip -9n "$root"/usr/share/man/man1/*.1
install -D -m 644 packaging/csi5300-node.service "$root/usr/lib/systemd/system/csi5300-node.service"
# The repository's unit is for a program that was installed by hand.
sed -i 's|/usr/local/bin/csi5300-node|/usr/bin/csi5300-node|' "$root/usr/lib/systemd/system/csi5300-node.service"
install -D -m 644 -t "$root/usr/share/doc/csi5300/examples" packaging/csi5300-node-*.conf
install -D -m 644 packaging/robot.toml "$root/usr/share/doc/csi5300/examples/robot.toml"
install -m 644 README.md SECURITY.md CHANGELOG.md "$root/usr/share/doc/csi5300/"
gzip -9n "$root/usr/share/doc/csi5300/CHANGELOG.md"
# Includes the licence of the page's plotting library.
cat LICENSE-MIT LICENSE-APACHE crates/view/page/vendor/uPlot.LICENSE >"$root/usr/share/doc/csi5300/copyright"

# A static program needs no packages.
depends=
readelf -l "$root/usr/bin/csi5300" | grep -q INTERP && depends="Depends: libc6 (>= $(objdump -T "$root"/usr/bin/* | grep -oE 'GLIBC_[0-9.]+' | sort -Vu | tail -1 | cut -d_ -f2)), libgcc-s1"
mkdir -p "$out"
install -D -m 755 -t "$root/DEBIAN" packaging/deb/postinst packaging/deb/prerm
{
    printf 'Package: csi5300\nVersion: %s\nArchitecture: %s\nMaintainer: csi5300 developers <csi5300@invalid>\n' "$version" "$arch"
    printf 'Installed-Size: %s\nSection: science\nPriority: optional\n' "$(du -sk --exclude=DEBIAN "$root" | cut -f1)"
    [ -z "$depends" ] || printf '%s\n' "$depends"
    printf 'Description: Bearings between robots from WiFi alone\n'
    printf ' CSI of the Intel 5300, live, replayed or simulated: bearings from a moving receiver to transmitters.\n'
} >"$root/DEBIAN/control"
deb="$out/csi5300_${version}_$arch.deb"
dpkg-deb --root-owner-group --build "$root" "$deb" >/dev/null
printf '%s: %s bytes\n' "$deb" "$(stat -c %s "$deb")"
