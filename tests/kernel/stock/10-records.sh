# The stock driver starts on two fake cards; the module's records, byte by byte.
for module in virtio_ring virtio libarc4 rfkill cfg80211 mac80211 iwlwifi iwldvm; do load "$module"; done
load fakecard
until [ -e /sys/class/net/wlan1 ]; do sleep 0.1; done
dmesg | grep "Detected Intel(R) Ultimate N WiFi Link 5300 AGN" | tail -n 1
dmesg | grep -q "loaded firmware version 8.24.2.12 5000-2.ucode op_mode iwldvm"
iw reg set PA
until iw reg get | grep -q "country PA"; do :; done
for k in 0 1; do
    iw dev "wlan$k" set type monitor
    ip link set "wlan$k" mtu 2304
    ip link set "wlan$k" up
    iw dev "wlan$k" set channel 64 HT20
done

# step NAME VARIABLE ARGUMENT: runs a test of crates/live as a step of this script.
step() {
    env "$2=$3" /tests/live --exact "stock::$1" --nocapture >/tmp/said 2>&1 || { cat /tmp/said; exit 1; }
    grep -q "1 passed" /tmp/said
    grep -v -e "^running" -e "^test " -e "^$" /tmp/said || true
}
counter() { cat "/sys/module/csi5300/counters/$1"; }

# The driver is loaded, so names that it lacks are wrong, which is reported.
insmod /modules/csi5300.ko symbol=typo transmit=typo2
for wrong in "no function typo: is symbol=" "no function typo2: is transmit="; do
    dmesg -r | grep -q "^<4>.*$wrong" || { dmesg | tail -n 5; exit 1; }
done
rmmod csi5300
insmod /modules/csi5300.ko transmit=fakecard_tx device=0
grep -q "iwlagn *26:1" /proc/net/connector
echo "frames that lack something"
step missing_parts_are_dropped_or_marked_and_counted CSI5300_STOCK_DROPS yes
rmmod csi5300

# records LAYOUT CONNECTOR_LOG FRAMES RATE: csitool's way of logging, and `csi5300 record` beside it.
records() {
    echo "$3 frames at $4/s, layout $1, connector_log $2"
    insmod /modules/csi5300.ko transmit=fakecard_tx device=0 layout="$1" connector_log="$2"
    : >/tmp/recorder
    csi5300 record /tmp/recorded.dat --force 2>/tmp/recorder &
    recorder=$!
    until grep -q "recording to" /tmp/recorder; do :; done
    step every_record_is_what_the_patched_driver_makes CSI5300_STOCK_RECORDS "$1 $2 $3 $4 /tmp/expected.dat"
    sleep 1
    kill -TERM "$recorder"
    wait "$recorder"
    cmp /tmp/expected.dat /tmp/recorded.dat
    [ "$(counter records)" = "$3" ]
    [ "$(counter delivered)" = "$((2 == $2 / 2 ? 2 * $3 : $3))" ]
    for zero in ring_full unheard missed no_phy no_order no_sender bad_phy bad_mpdu bad_bfee mpdu_no_phy; do
        [ "$(counter $zero)" = 0 ] || { echo "$zero is $(counter $zero)"; exit 1; }
    done
    rmmod csi5300
}
records stock 5 10000 1000
records wsr 1 2000 1000
