# The module is unloaded under traffic, a card sends garbage, and the driver goes away under the module.
dmesg -c >/dev/null
rm -f /tmp/stop
CSI5300_STOCK_TRAFFIC=/tmp/stop /tests/live --exact stock::traffic >/tmp/traffic 2>&1 &
traffic=$!
csi5300 record /tmp/trouble.dat --force 2>/tmp/recorder &
recorder=$!
for k in $(seq 50); do
    insmod /modules/csi5300.ko transmit=fakecard_tx device=0 layout="$([ $((k % 2)) = 0 ] && echo stock || echo wsr)"
    until [ "$(cat /sys/module/csi5300/counters/delivered)" -gt 3 ]; do :; done
    rmmod csi5300
done
touch /tmp/stop
wait "$traffic"
kill -TERM "$recorder"
wait "$recorder" || true
echo "50 times loaded and unloaded under traffic"

insmod /modules/csi5300.ko transmit=fakecard_tx device=0 connector_log=5
CSI5300_STOCK_HOSTILE=100000 /tests/live --exact stock::malformed_packets >/tmp/said 2>&1 || { cat /tmp/said; exit 1; }
grep -q "1 passed" /tmp/said
echo "100,000 malformed packets: $(cd /sys/module/csi5300/counters && grep . phy mpdu bfee records bad_phy bad_mpdu bad_bfee no_phy | tr '\n' ' ')"
[ "$(cat /sys/module/csi5300/counters/bad_bfee)" -gt 1000 ]
[ "$(cat /sys/module/csi5300/counters/bad_phy)" -gt 1000 ]

# The probe's cost per packet, in the emulator's time of 2 ns per instruction.
for loaded in no yes; do
    [ "$loaded" = yes ] || rmmod csi5300
    [ "$loaded" = no ] || insmod /modules/csi5300.ko transmit=fakecard_tx device=0
    CSI5300_STOCK_COST=20000 /tests/live --exact stock::cost --nocapture | grep -e "^other" -e "^phy" -e "^bfee" -e " other " >"/tmp/cost-$loaded"
done
sed 's/.* other /other /' /tmp/cost-no >/tmp/cost-without
sed 's/.* other /other /' /tmp/cost-yes | paste -d ' ' /tmp/cost-without - |
    awk '{ printf "cost of a hit, %s: %d ns\n", $1, $4 - $2; if ($1 == "other" && $4 - $2 > 1000) bad = 1 } END { exit bad || NR != 3 }'
# latency WAY TEST: from the packet to the record in user space, 2,000 frames, by the guest's clock.
latency() {
    CSI5300_STOCK_LATENCY=2000 /tests/live --exact "stock::$2" --nocapture >/tmp/said 2>&1 || { cat /tmp/said; exit 1; }
    grep -q "1 passed" /tmp/said
    echo "from packet to user space, $1: $(sed -n 's/.*from packet to user space: //p' /tmp/said)"
}
latency "the module" latency
rmmod csi5300
echo 1 >/sys/module/fakecard/parameters/patched
latency "the patched drivers' way" latency
echo 0 >/sys/module/fakecard/parameters/patched
/tests/live --list >/tmp/listed
if grep -q latency_of_the_program /tmp/listed; then latency "the eBPF program" latency_of_the_program; fi
insmod /modules/csi5300.ko transmit=fakecard_tx device=0 connector_log=5

# Cards and driver are reloaded, and after each reload packets of another driver's card come first. The probes follow, and each card has
# its own index: records of the first go out on index 21, those of the second on 25.
rmmod csi5300
insmod /modules/csi5300.ko transmit=fakecard_tx device=0 connector_log=5 index=21,25
for reload in 1 2 3; do
    rmmod caller 2>/dev/null || true
    rmmod fakecard iwldvm iwlwifi
    load iwlwifi
    insmod /modules/caller.ko count=1
    for module in iwldvm fakecard; do load "$module"; done
    monitors 64
    rm -f /tmp/stop
    for index in 21 25; do
        : >"/tmp/said-$index"
        csi5300 record "/tmp/reload-$index.dat" --force --connector-index "$index" --stop-after 3s 2>"/tmp/said-$index" &
        until grep -q "recording to" "/tmp/said-$index"; do :; done
    done
    CSI5300_STOCK_TRAFFIC=/tmp/stop /tests/live --exact stock::traffic >/tmp/traffic 2>&1 &
    before=$(cat /sys/module/csi5300/counters/delivered)
    until [ "$(cat /sys/module/csi5300/counters/delivered)" -gt "$((before + 100))" ]; do :; done
    sleep 3
    touch /tmp/stop
    wait
    for index in 21 25; do
        [ -s "/tmp/reload-$index.dat" ] || { echo "reload $reload: nothing on connector index $index"; cat /tmp/said-*; exit 1; }
    done
done
rmmod caller
echo "three reloads of the driver: both cards on their own connector index"
before=$(cat /sys/module/csi5300/counters/phy)
rm -f /tmp/stop
CSI5300_STOCK_TRAFFIC=/tmp/stop /tests/live --exact stock::traffic >/tmp/traffic 2>&1 &
until [ "$(cat /sys/module/csi5300/counters/phy)" -gt "$((before + 100))" ]; do :; done
touch /tmp/stop
wait
rmmod csi5300
# No message above "info", except those about loading an out-of-tree module.
dmesg -r | sed -n 's/^<\([0-9]*\)>/\1 /p' | awk '$1 % 8 < 6' | grep -v -e "firmware" -e "taints kernel" -e "verification failed" -e "no function fakecard_tx" >/tmp/worse || true
[ ! -s /tmp/worse ] || { cat /tmp/worse; exit 1; }
