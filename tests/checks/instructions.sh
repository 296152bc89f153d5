#!/usr/bin/env bash
# The work of a profile and of a link, in instructions beside the direct sums of a profile (`benches/instructions.rs`): a build in which
# FFTs or vector code are no longer inlined takes several times as many. 77: there is no valgrind and it cannot be installed.
set -euo pipefail
cd "$(dirname "$0")/../.."
install() { apt-get install -y --no-remove --no-install-recommends valgrind; }
command -v valgrind >/dev/null || install >/dev/null 2>&1 </dev/null || { echo "no valgrind, and it cannot be installed"; exit 77; }
cargo bench --no-run --bench instructions
program=$(cargo bench --no-run --bench instructions --message-format=json 2>/dev/null | sed -n 's/.*"executable":"\([^"]*\)".*/\1/p' | tail -n 1)
run() { valgrind --tool=callgrind --callgrind-out-file=/dev/null "$program" "$@" 2>&1 | sed -n 's/.*Collected : //p'; }
# Of one run, without what is done once.
count() { echo $((($(run "$1" 3) - $(run "$1" 1)) / 2)); }
direct=$(count direct)
failed=0
# Job, and its instructions in percent of the direct sums: half as much again as was measured.
for bound in "profile 45" "link 230"; do
    read -r job most <<<"$bound"
    share=$((100 * $(count "$job") / direct))
    printf '%s: %s %% of the instructions of direct sums in 3,600 directions, at most %s\n' "$job" "$share" "$most"
    [ "$share" -le "$most" ] || failed=1
done
exit $failed
