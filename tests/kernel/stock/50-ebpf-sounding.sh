# sound and respond with --stock: records from the eBPF program; the module beside it only sets the rate of sent frames (connector_log=0).
# Both robots are on this machine, so each ignores what the other's card hears.
A=00:21:6a:00:00:01 B=00:21:6a:00:00:02
mkdir -p /tmp/out/stock && cd /tmp/out/stock
for module in virtio_ring virtio libarc4 rfkill cfg80211 mac80211 iwlwifi iwldvm fakecard; do load "$module"; done
until [ -e /sys/class/net/wlan1 ]; do sleep 0.1; done
insmod /modules/csi5300.ko transmit=fakecard_tx device=0 connector_log=0
for k in 0 1; do
    ip link set "wlan$k" down
    iw dev "wlan$k" set type monitor
    ip link set "wlan$k" mtu 2304
    ip link set "wlan$k" up
    iw dev "wlan$k" set channel 64 HT20
done
slow="--rate 100 --turn-around 6000 --guard 1500"
counter() { cat "/sys/module/csi5300/counters/$1"; }

# exchange NAME SECONDS KEY OPTIONS...: rounds of two robots with --stock, logged in NAME-rx.dat and NAME-tx.dat; keys one.KEY and two.KEY,
# or none for `-`. The room's first robot drives its circle meanwhile.
exchange() {
    name=$1 seconds=$2 key=$3
    shift 3
    [ "$key" = - ] && one="" two="" || one="--key one.$key" two="--key two.$key"
    CSI5300_STOCK_AIR="/guest/room.toml $PWD/$name.csv $PWD/$name.stop" /tests/live --exact stock::a_room_between_the_cards --nocapture >"$name.air" 2>&1 &
    air=$!
    rates_before=$(counter rates_set)
    : >"$name.respond"
    csi5300 sound --answer --stock --interface wlan1 --peers "$A" $slow --log "$name-tx.dat" $two 2>"$name.respond" &
    responder=$!
    until grep -q "^sending under" "$name.respond"; do kill -0 "$responder" || { cat "$name.respond"; exit 1; }; done
    grep -q "packets of the unpatched iwlwifi" "$name.respond"
    csi5300 sound --stock --interface wlan0 --peers "$B" $slow --alone --stop-after "${seconds}s" --log "$name-rx.dat" $one "$@" \
        >"$name.live" 2>"$name.sound" || { cat "$name.sound"; exit 1; }
    kill -TERM "$responder"
    wait "$responder" || { cat "$name.respond"; exit 1; }
    touch "$name.stop"
    wait "$air" || { cat "$name.air"; exit 1; }
    grep -e "forward frames" -e "records written" "$name.sound" "$name.respond"
    sounded=$(sed -n 's/\([0-9]*\) forward frames, .*/\1/p' "$name.sound")
    answered=$(sed -n 's/.* forward frames, \([0-9]*\) answered.*/\1/p' "$name.sound")
    [ "$answered" -ge "$((95 * seconds))" ]
    [ "$(counter delivered)" = 0 ] && [ "$(($(counter rates_set) - rates_before))" -ge "$((2 * answered))" ]
}

echo "records and logs of two robots by the eBPF program"
exchange ebpf 15 -
# Each log has one sender: the other robot.
csi5300 info ebpf-rx.dat | grep -q "$B"
csi5300 info ebpf-tx.dat | grep -q "$A"
csi5300 info ebpf-rx.dat | grep -q "$A" && exit 1
csi5300 info ebpf-tx.dat | grep -q "$B" && exit 1
csi5300 bearing --rx ebpf-rx.dat --tx ebpf-tx.dat --trajectory ebpf.csv --channel 64 --json >bearing.json
# No pair is missing; both logs may contain a late answer that the sounder did not count.
pairs=$(sed -n 's/.*"pairs":\([0-9]*\).*/\1/p' bearing.json)
[ "$pairs" -ge "$answered" ] && [ "$pairs" -le "$sounded" ] || { echo "$pairs pairs of $answered answers"; exit 1; }
# As in 30-sounding.sh: the transmitter is at (3, 1.5).
sed -n 's/.*"position_m":\[\([^]]*\)\].*/\1/p' bearing.json | awk -F, '
    { off = ($2 / $1 - 0.5) / 0.0109 / 2; printf "transmitter at %.3f, %.3f m, truth 3, 1.5 m: %.3f degrees off\n", $1, $2, off }
    END { exit !(NR == 1 && off > -0.5 && off < 0.5) }'

echo "with keys: a record counts where its frame (0xC1), which has the tag, came with it"
csi5300 key new group.key
csi5300 key robot --group group.key --mac "$A" --peers "$B" one.key
csi5300 key robot --group group.key --mac "$B" --peers "$A" two.key
exchange keyed 21 key --trajectory keyed.csv --channel 64 --bearing-every 19s --json
# The bearing made while they sounded is seen from the middle of the circle, (0, 0.3), to the transmitter at (3, 1.5): 21.80 degrees.
grep '"azimuth_deg":[0-9-]' keyed.live | head -n 1 | sed 's/.*"pairs":\([0-9]*\),"azimuth_deg":\([-0-9.]*\),.*/\1 \2/' | awk '
    { off = $2 - 21.80; printf "live: %.2f degrees of %d pairs, %.2f degrees off\n", $2, $1, off }
    END { exit !(NR == 1 && $1 > 1700 && off > -1 && off < 1) }' || { cat keyed.live; exit 1; }
# A card's first frame is held back until the card has sent CSI.
[ "$(csi5300 info keyed-rx.dat | sed -n 's/.*code 0xC1 (mpdu): //p')" -ge "$((answered - 1))" ]
rmmod csi5300
