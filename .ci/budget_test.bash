#!/usr/bin/env bash
# Tests .ci/budget.bash for machines of different speeds, with a simulated clock: nothing starts too late, nothing is lost.
set -euo pipefail
cd "$(dirname "$0")"
source ./budget.bash
now=0
clock() { echo "$now"; }
fail() { printf 'budget: %s\n' "$1"; exit 1; }
items=("600 long" "30 short" "200 middle" "1 tiny" "9000 never" "300 other")
names=$(printf '%s\n' "${items[@]#* }" | sort)
# A check takes its stated time, plus or minus a quarter.
run() {
    local item took
    for item in "${items[@]}"; do [ "${item#* }" != "$1" ] || took=$(needs "${item%% *}"); done
    [ $((now + took)) -le "$limit" ] || fail "$1 started at $now s and needs $took s"
    now=$((now + took * (75 + RANDOM % 51) / 100))
    done+=("$1")
    ran=$((ran + 1))
}
skip() {
    [ $((now + $2)) -gt "$limit" ] || fail "$1 was skipped at $now s and needs $2 s"
    done+=("$1")
}
RANDOM=5300
first=() most=0 least=99
for ((try = 0; try < 60; try++)); do
    now=$((800 + RANDOM % 3900)) done=() ran=0
    measured 1500
    [ "$pace" = $((now / 15)) ] || fail "the pace of $now s for 1500 is $pace %"
    mapfile -t order < <(turned "$(printf '%07x0f5' $((try * 7919)))" "${items[@]}")
    first+=("${order[0]}")
    spend run skip "${order[@]}"
    [ "$(printf '%s\n' "${done[@]}" | sort)" = "$names" ] || fail "of ${names//$'\n'/ } only ${done[*]}"
    [ "$now" -le "$stop" ] || fail "it ended at $now s"
    [ $ran -le $most ] || most=$ran
    [ $ran -ge $least ] || least=$ran
done
[ "$(printf '%s\n' "${first[@]}" | sort -u | wc -l)" = ${#items[@]} ] || fail "some never come first"
[ $least = 0 ] && [ $most = 5 ] || fail "between $least and $most of the items ran"
echo "budget: $try machines, nothing started too late, nothing lost"
