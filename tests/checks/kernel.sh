#!/usr/bin/env bash
# Boots Debian's kernel in QEMU and runs tests/kernel/guest/*.sh in it; see tests/kernel/README.md.
# Exit status 77: cannot run here; the last line says why.
set -euo pipefail
cd "$(dirname "$0")/../.."
check="kernel tests"
source tests/kernel/guest.bash

packages
build_modules driver-iface/kmod
printf 'modules built after %s s\n' "$SECONDS"
tree=$place/tree
guest_tree "$tree" tests/kernel/guest "$place/boot" "$place/kmod"
static_binaries "$tree"
boot "$tree" "$(echo "$place"/boot/boot/vmlinuz-*)" 460
[ "$status" = 33 ] || exit 1

# Reads the logs of the guest's robots again on the host: the same pairs, by the same test and by `info`.
rm -rf "$place/out"
mkdir "$place/out"
# The guest's and the host's clocks differ by seconds.
tar -xzmf "$place/out.tar.gz" -C "$place/out"
for links in "$place"/out/*/links; do
    cd "${links%/*}"
    CSI5300_TEST_GUEST_LINKS=$(cat links) "$tree/tests/live" --exact kernel::every_answered_frame_is_a_pair_of_the_logs --nocapture >checked ||
        { cat checked; echo "the copied logs of ${PWD##*/} are not those of the guest"; exit 1; }
    grep -q "1 passed" checked
    printf 'copied out, %s: %s\n' "${PWD##*/}" "$(grep -c pairs checked) links with pairs, $("$tree/bin/csi5300" info --json ./*.dat | wc -l) logs read"
done
[ -d "$place/out/three" ] && [ -d "$place/out/two-wsr" ]
