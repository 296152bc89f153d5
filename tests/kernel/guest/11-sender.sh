# A kernel module sends records as the driver does; the program receives all of them.
for chains in "3 1" "3 3"; do
    set -- $chains
    log=/tmp/$1x$2.dat
    : >/tmp/said
    csi5300 record "$log" --stop-after 2000records 2>/tmp/said &
    recorder=$!
    until grep -q "listening on connector" /tmp/said; do :; done
    # Nothing is registered yet, so the program joins both indices.
    grep -q "index 26 and 25" /tmp/said
    insmod /modules/csi5300_sender.ko count=2000 period_us=1000 n_rx="$1" n_tx="$2"
    grep -q "iwlagn *26:1" /proc/net/connector
    wait "$recorder"
    cat /tmp/said
    CSI5300_TEST_GUEST_LOG=$log CSI5300_TEST_GUEST_CHAINS="$1 $2" CSI5300_TEST_GUEST_COUNT=2000 \
        /tests/live --exact kernel::the_module_s_records_are_in_the_log --nocapture
    # A later listener finds the index by name.
    csi5300 record /tmp/none.dat --stop-after 100ms 2>/tmp/said || true
    grep -q "index 26 (where the driver is registered)" /tmp/said
    rm -f /tmp/none.dat*
    rmmod csi5300_sender
done
