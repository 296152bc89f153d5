#!/usr/bin/env bash
# Mutation testing of the rooms where a wrong line would go unseen: scheduler, pairing, admission, the recorder, senders, keys and every byte of driver-iface.
# usage: scripts/mutants.sh [BASE]
# With BASE (a commit) only lines that changed since are mutated, otherwise all of these rooms, which takes hours. Exit status 2: some mutant survived.
# Mutants that survived are in target/mutants.out/missed.txt.
set -euo pipefail
cd "$(dirname "$0")/.."
tool=target/tools/bin/cargo-mutants
[ -x "$tool" ] || cargo install --quiet --locked --root target/tools cargo-mutants
rooms=(src/exchange src/source/recorder src/source/survey src/source/key_file driver-iface/src)
files=()
for room in "${rooms[@]}"; do files+=(--file "$room/**" --file "$room.rs"); done
if [ $# -gt 0 ]; then
    git diff "$1" -- src driver-iface >target/mutants.diff
    [ -s target/mutants.diff ] || { echo "nothing changed since $1"; exit 0; }
    files+=(--in-diff target/mutants.diff)
fi
# The library's own tests and those of its scheduler: the other crates' would take minutes for each mutant.
exec "$tool" mutants --package csi5300 --package driver-iface --test-package csi5300,driver-iface "${files[@]}" \
    --output target --timeout 300 --baseline skip --colors never -- --lib --test library --test fuzz_targets
