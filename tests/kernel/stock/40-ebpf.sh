# CSI from the stock driver with the eBPF program of `csi5300 record --stock`, without the module.
for module in csi5300 fakecard iwldvm iwlwifi; do rmmod "$module" 2>/dev/null || true; done
dmesg -c >/dev/null
cards() {
    for module in virtio_ring virtio libarc4 rfkill cfg80211 mac80211 iwlwifi iwldvm fakecard; do load "$module"; done
    monitors 6
}
step() {
    env "CSI5300_EBPF_$1=$3" /tests/stock_guest --exact "$2" --nocapture >/tmp/said 2>&1 || { cat /tmp/said; exit 1; }
    grep -q "1 passed" /tmp/said
    grep -E "packets in|records, byte" /tmp/said
}
feed() { step FEED feed "$1"; }
check() { step CHECK every_record_is_what_the_patched_driver_makes "$1"; }
# start ARGUMENTS: starts a recorder and waits until it listens.
start() {
    : >/tmp/recorder
    csi5300 record --stock /tmp/ebpf.dat --force "$@" 2>/tmp/recorder &
    recorder=$!
    until grep -q "recording to" /tmp/recorder; do
        [ -e "/proc/$recorder" ] || { cat /tmp/recorder; exit 1; }
        sleep 0.1
    done
}
# stop STATUS: ends the recorder and checks its status.
stop() {
    status=0
    kill -TERM "$recorder"
    wait "$recorder" || status=$?
    [ "$status" = "$1" ] || { cat /tmp/recorder; echo "status $status, not $1"; exit 1; }
}
# The kernel's statistics of the program: number of runs, and nanoseconds.
cost() {
    file=$(grep -l run_cnt "/proc/$recorder"/fdinfo/* | head -n 1)
    ran=$(sed -n 's/^run_cnt:[^0-9]*//p' "$file")
    ns=$(sed -n 's/^run_time_ns:[^0-9]*//p' "$file")
}

cards
echo "10,000 frames at 1,000/s, csitool's layout"
start --stock=csitool
feed "steady 10000 1 1000"
sleep 1
stop 0
check "/tmp/ebpf.dat csitool 1 all steady 10000 1 -"
grep "packets of the driver" /tmp/recorder

echo "1,000 frames in WSR's layout, with the frames"
start --stock=wsr-frames
feed "steady 1000 2 1000"
sleep 1
stop 0
check "/tmp/ebpf.dat wsr 5 all steady 1000 2 -"

echo "100,000 packets, most of them hostile"
start --receive-buffer 64M
feed "hostile 100000 3 0"
sleep 1
stop 3
check "/tmp/ebpf.dat wsr 1 all hostile 100000 3 -"
grep "inconsistent" /tmp/recorder

echo "headers that claim more than their page: nothing beyond it is read"
echo Y >/sys/module/fakecard/parameters/at_end
start --stock=csitool
feed "lying 200 13 0"
sleep 1
stop 3
check "/tmp/ebpf.dat csitool 1 all lying 200 13 -"
grep "^  200 inconsistent CSI notifications (0xBB)" /tmp/recorder
echo N >/sys/module/fakecard/parameters/at_end

echo "a ring that is too small and a recorder that is stopped"
start --receive-buffer 64k --stock=csitool
kill -STOP "$recorder"
feed "steady 300 4 0"
kill -CONT "$recorder"
sleep 1
feed "steady 100 5 1000"
sleep 1
stop 3
grep -q "overrun: the kernel dropped" /tmp/recorder
grep "ring was full" /tmp/recorder

echo "what a hit costs"
sysctl -w kernel.bpf_stats_enabled=1 >/dev/null
start
cost
foreign_ran=$ran
foreign_ns=$ns
feed "foreign 20000 6 0"
cost
echo "a packet that is nobody's: $(((ns - foreign_ns) / (ran - foreign_ran))) ns of the guest, $((ran - foreign_ran)) hits"
before_ran=$ran
before_ns=$ns
feed "steady 2000 7 0"
cost
echo "0xC0, 0xC1 and 0xBB: $(((ns - before_ns) / (ran - before_ran))) ns of the guest each"
sleep 1
stop 0

if [ -x /bin/setcap ]; then
    echo "a user that is not root, with CAP_BPF and CAP_PERFMON on the program and nothing else"
    mkdir -p /etc
    echo "robot:x:1000:1000::/tmp:/bin/sh" >/etc/passwd
    mkdir -p /tmp/robot
    chown 1000:1000 /tmp/robot
    cp /bin/csi5300 /tmp/robot/csi5300
    # as_robot CAPABILITIES SECONDS: runs that user's recorder; its exit status is in `status`.
    as_robot() {
        setcap "$1" /tmp/robot/csi5300
        status=0
        su -s /bin/sh robot -c "/tmp/robot/csi5300 record --stock /tmp/robot/few.dat --force --stop-after $2" 2>/tmp/recorder || status=$?
    }
    sysctl -w kernel.perf_event_paranoid=2
    : >/tmp/recorder
    as_robot cap_bpf,cap_perfmon+ep 60s &
    robot=$!
    until grep -q "recording to" /tmp/recorder; do [ -e "/proc/$robot" ] || { cat /tmp/recorder; exit 1; }; done
    grep "^CapEff" "/proc/$(pidof csi5300)/status"
    grep -q "^Uid:.1000.1000.1000.1000" "/proc/$(pidof csi5300)/status"
    grep -q "^CapEff:.000000c000000000" "/proc/$(pidof csi5300)/status"
    feed "steady 100 11 0"
    kill -TERM "$(pidof csi5300)"
    wait "$robot"
    check "/tmp/robot/few.dat wsr 1 all steady 100 11 -"
    # Debian's default level: then a probe needs CAP_SYS_ADMIN.
    sysctl -w kernel.perf_event_paranoid=3
    as_robot cap_bpf,cap_perfmon+ep 100ms
    [ "$status" = 1 ] && grep "perf_event_paranoid" /tmp/recorder || { cat /tmp/recorder; exit 1; }
    as_robot cap_net_admin+ep 100ms
    [ "$status" = 1 ] && grep -q "CAP_BPF and CAP_PERFMON are needed" /tmp/recorder || { cat /tmp/recorder; exit 1; }
fi

echo "beside the module: both make the same records of the same packets"
insmod /modules/csi5300.ko transmit=fakecard_tx device=0
: >/tmp/beside
csi5300 record /tmp/beside.dat --force 2>/tmp/beside &
beside=$!
until grep -q "recording to" /tmp/beside; do :; done
start --stock=csitool
feed "steady 2000 12 1000"
sleep 1
kill -TERM "$beside"
wait "$beside"
stop 0
check "/tmp/ebpf.dat csitool 1 all steady 2000 12 -"
cmp /tmp/ebpf.dat /tmp/beside.dat
rmmod csi5300

echo "the driver goes and comes under a recorder"
start --stock=csitool
for k in 1 2 3; do
    feed "steady 100 8 0"
    rmmod fakecard iwldvm iwlwifi
    sleep 1
    cards
    sleep 3
done
feed "steady 100 8 0"
sleep 1
stop 0
grep "was reloaded" /tmp/recorder
[ "$(grep -c . /tmp/recorder)" -gt 0 ]
grep "^400 records written" /tmp/recorder

echo "recorders come and go under traffic"
rm -f /tmp/fed
(feed "steady 8000 9 1000" >/dev/null; touch /tmp/fed) &
feeder=$!
recorders=0
until [ -e /tmp/fed ]; do
    start --stop-after 200ms
    wait "$recorder" || true
    recorders=$((recorders + 1))
done
wait "$feeder"
echo "$recorders recorders"
[ "$recorders" -ge 3 ]
rmmod fakecard iwldvm iwlwifi
status=0
csi5300 record --stock /tmp/none.dat 2>/tmp/recorder || status=$?
[ "$status" = 1 ]
grep "iwlwifi is not loaded" /tmp/recorder
dmesg -r | sed -n 's/^<\([0-9]*\)>/\1 /p' | awk '$1 % 8 < 5' | grep -v -e "firmware" -e "taints kernel" -e "verification failed" >/tmp/worse || true
[ ! -s /tmp/worse ] || { cat /tmp/worse; exit 1; }
