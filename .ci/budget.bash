# When a check may start. Sourced by .ci/run; .ci/budget_test.bash tries it with a clock of its own.

# A check starts only where it will have ended by then, in seconds from the start of the run.
limit=4500
# A check that is still running then is stopped, and counted among those without time.
stop=5000
# What this machine takes, in percent of what the reference machine takes. Needs are seconds there.
pace=100

# Seconds since the run began. CSI5300_CI_SLOWER=3 makes every step take three times as long as it does.
clock() { echo $((SECONDS * ${CSI5300_CI_SLOWER:-1})); }

# measured REFERENCE: the run so far took REFERENCE seconds on the reference machine.
measured() { pace=$(($(clock) * 100 / $1)); }

# needs SECONDS: what takes so long on the reference machine takes so long here.
needs() { echo $((($1 * pace + 99) / 100)); }

# turned COMMIT ITEM...: the items in their order, beginning with another one for each commit.
turned() {
    local from=$((16#${1:0:7} % ($# - 1)))
    shift
    printf '%s\n' "${@:from+1}" "${@:1:from}"
}

# spend RUN SKIP "NEED NAME"...: calls RUN NAME for each item that ends in time, and SKIP NAME NEED for the others. A short
# item may still run where a long one before it may not.
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
