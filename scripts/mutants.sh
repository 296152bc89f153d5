#!/usr/bin/env bash
# Mutation testing of the parts where an error would go unnoticed: scheduler, pairing, admission, the recorder, senders, keys and all of driver-iface.
# usage: scripts/mutants.sh [ROOM...] [--since COMMIT] [--shard K/N] [--minutes M]
# ROOM: driver-iface, exchange, recorder, intake (default: all). --since: only lines changed since COMMIT. --shard: every N-th mutant.
# --minutes: stops then and prints how many were not tried. Runs only the room's tests; the library is built with less optimisation.
# Prints caught and missed mutants by room; missed ones are in target/mutants/ROOM/mutants.out/missed.txt. Exit status 2: some survived.
# .cargo/mutants.toml lists equivalent mutants, which no test can detect, with the reason.
set -euo pipefail
cd "$(dirname "$0")/.."
rooms=() since= minutes=0 shard=()
while [ $# -gt 0 ]; do
    case $1 in
        --since) since=$2; shift ;;
        --shard) shard=(--shard "$2" --sharding round-robin); shift ;;
        --minutes) minutes=$2; shift ;;
        driver-iface | exchange | recorder | intake) rooms+=("$1") ;;
        *) echo "no room $1" >&2; exit 64 ;;
    esac
    shift
done
[ ${#rooms[@]} -gt 0 ] || rooms=(driver-iface exchange recorder intake)
tool=target/tools/bin/cargo-mutants
[ -x "$tool" ] || tool=$(command -v cargo-mutants) || { tool=target/tools/bin/cargo-mutants && cargo install --quiet --locked --root target/tools cargo-mutants; }
common=(--baseline skip --jobs 1 --colors never --no-times --timeout 120 "${shard[@]}")
if [ -n "$since" ]; then
    mkdir -p target
    git diff "$since" -- src driver-iface >target/mutants.diff
    [ -s target/mutants.diff ] || { echo "nothing changed in these rooms since $since"; exit 0; }
    common+=(--in-diff target/mutants.diff)
fi
# Building optimised code takes longer than it saves here.
export CARGO_INCREMENTAL=1 CARGO_PROFILE_DEV_DEBUG=0
quick=(-C=--config=profile.dev.package.csi5300.opt-level=1 -C=--config=profile.dev.package.csi5300-kernels.opt-level=1)

# The files of a room, and the tests that cover them.
of_room() {
    case $1 in
        driver-iface) files=(--file 'driver-iface/src/**') arguments=(--package driver-iface -C=--lib -C=--test=fuzz_targets) filter=() ;;
        exchange)
            files=(--file 'src/exchange/**')
            arguments=(--package csi5300 "${quick[@]}" -C=--lib -C=--test=library)
            filter=(exchange:: tdma:: fuzz::)
            ;;
        recorder)
            files=(--file 'src/source/recorder.rs' --file 'src/source/side_file.rs' --file 'src/source/replay.rs')
            arguments=(--package csi5300 "${quick[@]}" -C=--lib)
            filter=(source::)
            ;;
        intake)
            files=(--file 'src/source/survey.rs' --file 'src/source/key_file.rs' --file 'src/source/remote.rs' --file 'src/pipeline/intake.rs')
            arguments=(--package csi5300 "${quick[@]}" -C=--lib)
            filter=(source:: pipeline::)
            ;;
    esac
}

end=$((SECONDS + 60 * minutes))
missed=0
for room in "${rooms[@]}"; do
    of_room "$room"
    out=target/mutants/$room
    mkdir -p "$out"
    all=$("$tool" mutants --list --colors never "${files[@]}" --package "${arguments[1]}" "${shard[@]}" ${since:+--in-diff target/mutants.diff} 2>/dev/null | wc -l)
    [ "$all" -gt 0 ] || { echo "$room: no mutants"; continue; }
    bound=()
    if [ "$minutes" -gt 0 ]; then
        left=$((end - SECONDS))
        [ $left -gt 0 ] || { echo "$room: none of $all tried, the time is over"; continue; }
        bound=(timeout --signal=INT --kill-after=30 "$left")
    fi
    rm -rf "$out/mutants.out"
    "${bound[@]}" "$tool" mutants "${common[@]}" "${files[@]}" "${arguments[@]}" --output "$out" -- ${filter[@]:+-- "${filter[@]}"} >"$out/log.txt" 2>&1 && ended= || ended=$?
    count() { cat "$out/mutants.out/$1.txt" 2>/dev/null | wc -l; }
    caught=$(($(count caught) + $(count timeout))) lost=$(count missed) unviable=$(count unviable)
    tried=$((caught + lost + unviable))
    [ $tried -gt 0 ] || { echo "$room: nothing was tried:"; tail -n 5 "$out/log.txt"; continue; }
    share=$((caught + lost > 0 ? 100 * caught / (caught + lost) : 100))
    echo "$room: $caught caught, $lost missed ($share % caught), $unviable do not compile; $((all - tried)) of $all not tried$([ "$ended" != 124 ] || echo ", the time is over")"
    missed=$((missed + lost))
done
[ $missed -eq 0 ] || exit 2
