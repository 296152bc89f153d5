# Decides when a check may start. Sourced by .ci/run; .ci/budget_test.bash tests it with its own clock.

# A check starts only if it will end by then, in seconds from the start of the run.
limit=4500
# A check that still runs then is stopped, and counted as skipped for lack of time.
stop=5000
# Time on this machine in percent of that on the reference machine. Needs are seconds there.
pace=100

# Seconds since the run began. CSI5300_CI_SLOWER=3 makes every step count three times as long.
clock() { echo $((SECONDS * ${CSI5300_CI_SLOWER:-1})); }

# measured REFERENCE: the run so far took REFERENCE seconds on the reference machine.
measured() { pace=$(($(clock) * 100 / $1)); }

# needs SECONDS: the time on this machine of a step that takes SECONDS on the reference machine.
needs() { echo $((($1 * pace + 99) / 100)); }

# turned COMMIT ITEM...: the items in order, starting with a different one for each commit.
turned() {
    local from=$((16#${1:0:7} % ($# - 1)))
    shift
    printf '%s\n' "${@:from+1}" "${@:1:from}"
}

# spend RUN SKIP "NEED NAME"...: calls RUN NAME for each item that ends in time, and SKIP NAME NEED for the others. A short item may
# still run after a long one was skipped.
spend() {
    local run=$1 skip=$2 item need
    shift 2
    for item; do
        need=$(needs "${item%% *}")
        if [ $(($(clock) + need)) -le "$limit" ]; then
            "$run" "${item#* }"
        else
            "$skip" "${item#* }" "$need"
        fi
    done
}
