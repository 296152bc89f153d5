#!/usr/bin/env bash
# Makes the .deb of the programs that the README's main command built, unpacks it, and tries it in place.
set -euo pipefail
cd "$(dirname "$0")/../.."
command -v dpkg-deb >/dev/null || { echo "no dpkg-deb: no Debian"; exit 77; }
# Built as by `cargo run`, so that nothing is built twice.
cargo build --quiet --release --bin csi5300
cargo build --quiet --release --package csi5300-node
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
scripts/deb.sh target/release/csi5300 "$folder"
deb=$(echo "$folder"/*.deb)
dpkg-deb --info "$deb" | sed -n '/Package:/,$p'
dpkg-deb --extract "$deb" "$folder/root"
root=$folder/root

"$root/usr/bin/csi5300" --version
"$root/usr/bin/csi5300-node" --version
# Every documented command has a manual page and a completion.
commands=$("$root/usr/bin/csi5300" --help | sed -n '/^Commands:/,/^$/p' | awk '/^  [a-z]/ { print $1 }' | grep -v '^help$')
for command in $commands; do
    [ -s "$root/usr/share/man/man1/csi5300-$command.1.gz" ] || { echo "no manual page of $command"; exit 1; }
done
echo "pages: $(ls "$root/usr/share/man/man1" | wc -l)"
bash -euc '
    source "$1/usr/share/bash-completion/completions/csi5300"
    COMP_WORDS=(csi5300 bea) COMP_CWORD=1 COMPREPLY=()
    _csi5300 csi5300 bea csi5300
    [ "${COMPREPLY[*]}" = bearing ] || { echo "bash completes bea to: ${COMPREPLY[*]}"; exit 1; }
    COMP_WORDS=(csi5300 bearing --ante) COMP_CWORD=2 COMPREPLY=()
    _csi5300 csi5300 --ante bearing
    [[ " ${COMPREPLY[*]} " == *" --antenna "* ]] || { echo "bash completes --ante to: ${COMPREPLY[*]}"; exit 1; }
' bash "$root"
# The unit runs the program where the package installs it.
grep -q '^ExecStart=/usr/bin/csi5300-node ' "$root/usr/lib/systemd/system/csi5300-node.service"
for rights in packaging/csi5300-node-*.conf; do
    [ -s "$root/usr/share/doc/csi5300/examples/$(basename "$rights")" ] || { echo "no $rights"; exit 1; }
done
# An upgrade restarts a running service, a removal leaves none without its program, and nothing else is touched.
dpkg-deb --control "$deb" "$folder/control"
mkdir "$folder/fake"
printf '#!/bin/sh\necho "$*" >>"%s"\n' "$folder/asked" >"$folder/fake/systemctl"
chmod 755 "$folder/fake/systemctl"
asks() { # EXPECTED SCRIPT ARGUMENT...
    : >"$folder/asked"
    PATH=$folder/fake:$PATH "$folder/control/$2" "${@:3}"
    [ "$(tr '\n' ';' <"$folder/asked")" = "$1" ] || { echo "$2 ${*:3} asks for: $(cat "$folder/asked")"; exit 1; }
}
asks 'daemon-reload;try-restart csi5300-node.service;' postinst configure 0.0.1
asks '' postinst abort-remove
asks 'disable --now csi5300-node.service;' prerm remove
asks '' prerm upgrade 0.0.2
# Its example configuration is valid, except for features that this build lacks.
"$root/usr/bin/csi5300" node --config "$root/usr/share/doc/csi5300/examples/robot.toml" --check >/dev/null 2>"$folder/said" ||
    ! grep -v 'needs a program built with' "$folder/said" || { echo "the example is refused"; exit 1; }
if command -v lintian >/dev/null; then lintian --fail-on error "$deb"; fi
echo "ok"
