# Two processors: the module is loaded and unloaded fifty times while both cards receive, channels are set, parameters change, and the
# eBPF program is attached to and detached from the same function.
for module in virtio_ring virtio libarc4 rfkill cfg80211 mac80211 iwlwifi iwldvm fakecard; do load "$module"; done
[ "$(grep -c ^processor /proc/cpuinfo)" = 2 ]
monitors 6
dmesg -c >/dev/null
counter() { cat "/sys/module/csi5300/counters/$1"; }

for k in 1 2; do
    CSI5300_STOCK_TRAFFIC=/tmp/stop /tests/live --exact stock::traffic >"/tmp/traffic-$k" 2>&1 &
    eval "traffic_$k=$!"
done
csi5300 record /tmp/races.dat --force 2>/tmp/recorder &
recorder=$!
(
    programs=0
    until [ -e /tmp/enough ]; do
        # Status 3: two senders' packets are mixed, so some notifications lack their reception.
        csi5300 record --stock /tmp/program.dat --force --stop-after 200records 2>/tmp/program || [ "$?" = 3 ] || { cat /tmp/program; exit 1; }
        programs=$((programs + 1))
    done
    echo "$programs" >/tmp/programs
) &
programs=$!
(
    until [ -e /tmp/enough ]; do for channel in 1 6 11; do iw dev wlan1 set channel "$channel" HT20; done; done
) &
channels=$!
for load in $(seq 50); do
    [ $((load % 2)) = 0 ] && named="card=fakecard.1" || named="answer_on=wlan0 ack_len=57"
    insmod /modules/csi5300.ko transmit=fakecard_tx device=0 connector_log=5 $named
    until [ "$(counter delivered)" -gt 3 ]; do :; done
    for name in layout:wsr ask:0 ask:7 monitor_tx_rate:0 connector_log:1; do echo "${name#*:}" >"/sys/module/csi5300/parameters/${name%:*}"; done
    [ "$(counter bfee)" -gt 0 ]
    rmmod csi5300
done
# The programs' recorded data ends them.
touch /tmp/enough
wait "$programs" "$channels"
touch /tmp/stop
wait "$traffic_1" "$traffic_2"
kill -TERM "$recorder"
wait "$recorder" || true
echo "50 loads, $(cat /tmp/programs) programs"

# Packets of both cards at once are counted and become records once, whichever processor handled them.
insmod /modules/csi5300.ko transmit=fakecard_tx device=0
rm -f /tmp/stop
for k in 1 2; do
    CSI5300_STOCK_TRAFFIC=/tmp/stop /tests/live --exact stock::traffic >"/tmp/traffic-$k" 2>&1 &
    eval "traffic_$k=$!"
done
until [ "$(counter bfee)" -gt 5000 ]; do sleep 0.1; done
touch /tmp/stop
wait "$traffic_1" "$traffic_2"
sleep 1
[ "$(counter phy)" = "$(counter bfee)" ] && [ "$(counter phy)" = "$(counter mpdu)" ]
[ "$(($(counter records) + $(counter no_phy) + $(counter bad_bfee)))" = "$(counter bfee)" ]
[ "$(($(counter delivered) + $(counter unheard) + $(counter ring_full)))" = "$(counter records)" ]
echo "$(counter bfee) notifications of two cards at once: $(counter records) records, $(counter no_phy) without their reception, $(counter missed) missed"
rmmod csi5300
dmesg -r | sed -n 's/^<\([0-9]*\)>/\1 /p' | awk '$1 % 8 < 5' | grep -v -e "firmware" -e "taints kernel" -e "verification failed" >/tmp/worse || true
[ ! -s /tmp/worse ] || { cat /tmp/worse; exit 1; }
