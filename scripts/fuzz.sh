#!/usr/bin/env bash
# Coverage-guided fuzzing with libFuzzer and the stable compiler: instrumented code, no address sanitizer (there is no `unsafe`).
# usage: scripts/fuzz.sh [SECONDS [TARGET...]]
# SECONDS of CPU time for each target (60; user and system time of its process from /proc, so that other load does not shorten it);
# TARGETs default to all of fuzz/fuzz_targets. New inputs go into fuzz/corpus/TARGET, reduced to those that add coverage.
# A failing input is written to target/fuzz/found; exit status 1.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-60}
shift || true
targets=("$@")
[ ${#targets[@]} -gt 0 ] || targets=($(basename -s .rs fuzz/fuzz_targets/*.rs))
host=$(rustc -vV | sed -n 's/^host: //p')
features=(--no-default-features)
for target in "${targets[@]}"; do
    case $target in
        bfee | connector | formats | frame | record_stream | side_file | stock) ;;
        recording | rtps) features+=(--features ros) ;;
        *) features+=(--features library) ;;
    esac
done
# With a target triple, flags apply only to the fuzzed code, not to build scripts.
export RUSTFLAGS="--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 -Cllvm-args=-sanitizer-coverage-inline-8bit-counters \
    -Cllvm-args=-sanitizer-coverage-pc-table -Cllvm-args=-sanitizer-coverage-trace-compares -Ccodegen-units=1"
bins=()
for target in "${targets[@]}"; do bins+=(--bin "$target"); done
(cd fuzz && CARGO_TARGET_DIR=../target/fuzz cargo build --quiet --release --target "$host" "${features[@]}" "${bins[@]}")
mkdir -p target/fuzz/found
tick=$(getconf CLK_TCK)
# Seconds of CPU time of a process of this shell, with one decimal; fails once it has ended.
cpu_s() {
    local stat
    stat=$(cat "/proc/$1/stat" 2>/dev/null) || return 1
    # After the name, which is in brackets, user and system time are fields 12 and 13.
    set -- ${stat##*) }
    [ "$1" != Z ] || return 1
    echo $(((${12} + ${13}) * 10 / tick))
}
status=0
for target in "${targets[@]}"; do
    program=target/fuzz/$host/release/$target
    corpus=fuzz/corpus/$target
    grown=target/fuzz/grown/$target
    mkdir -p "$corpus" "$grown"
    # A minute of wall time for one input: on a busy machine that is a few seconds of CPU time.
    "$program" -max_len=8192 -timeout=60 -rss_limit_mb=1024 -artifact_prefix=target/fuzz/found/"$target"- -print_final_stats=1 \
        "$grown" "$corpus" 2>target/fuzz/"$target".log &
    run=$! used=0
    while now=$(cpu_s $run); do
        used=$now
        [ "$used" -lt $((seconds * 10)) ] || break
        sleep 1
    done
    # libFuzzer ends on this signal and prints its statistics.
    kill -USR1 $run 2>/dev/null || true
    wait $run || { status=1; tail -n 30 target/fuzz/"$target".log; }
    # Small inputs first; the committed corpus stays under 16 KiB per target.
    reduced=target/fuzz/reduced/$target
    rm -rf "$reduced" && mkdir -p "$reduced"
    "$program" -merge=1 -max_len=1024 "$reduced" "$corpus" "$grown" 2>>target/fuzz/"$target".log || true
    rm -rf "$corpus" && mkdir -p "$corpus"
    size=0
    while read -r bytes file; do
        size=$((size + bytes))
        [ $size -le 16384 ] || break
        cp "$file" "$corpus/"
    done < <(find "$reduced" -type f -printf '%s %p\n' | sort -n)
    sed -n 's/^stat::\(number_of_executed_units\|average_exec_per_sec\): */\1 /p' target/fuzz/"$target".log | paste -sd ' ' | sed "s/^/$target: $((used / 10)).$((used % 10)) s of CPU time, /"
    echo "$target: $(find "$corpus" -type f | wc -l) inputs kept"
done
exit $status
