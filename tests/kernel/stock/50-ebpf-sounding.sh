# sound and respond with --stock: their records by the eBPF program, and the module beside it for the rate of what they send. It
# is silent (connector_log=0). Both robots are on this machine, so each of them leaves out what the other's card hears.
A=00:21:6a:00:00:01 B=00:21:6a:00:00:02
mkdir -p /tmp/out/stock && cd /tmp/out/stock
for module in virtio_ring virtio libarc4 rfkill cfg80211 mac80211 iwlwifi iwldvm fakecard; do load "$module"; done
until [ -e /sys/class/net/wlan1 ]; do sleep 0.1; done
insmod /modules/csi5300.ko transmit=fakecard_tx connector_log=0
for k in 0 1; do
    ip link set "wlan$k" down
    iw dev "wlan$k" set type monitor
    ip link set "wlan$k" mtu 2304
    ip link set "wlan$k" up
    iw dev "wlan$k" set channel 64 HT20
done
CSI5300_STOCK_AIR="/guest/room.toml $PWD/ebpf.csv $PWD/ebpf.stop" /tests/live --exact stock::air::a_room_between_the_cards --nocapture >ebpf.air 2>&1 &
air=$!
slow="--rate 100 --turn-around 6000 --guard 1500"
: >respond-ebpf
csi5300 respond --stock --interface wlan1 --peers "$A" $slow --log tx-ebpf.dat 2>respond-ebpf &
responder=$!
until grep -q "^sending under" respond-ebpf; do kill -0 "$responder" || { cat respond-ebpf; exit 1; }; done
grep -q "packets of the unpatched iwlwifi" respond-ebpf
csi5300 sound --stock --interface wlan0 --peers "$B" $slow --alone --stop-after 15s --log rx-ebpf.dat 2>sound-ebpf || { cat sound-ebpf; exit 1; }
kill -TERM "$responder"
wait "$responder" || { cat respond-ebpf; exit 1; }
touch ebpf.stop
wait "$air" || { cat ebpf.air; exit 1; }
grep -e "forward frames" -e "records written" sound-ebpf respond-ebpf
answered=$(sed -n 's/.* forward frames, \([0-9]*\) answered.*/\1/p' sound-ebpf)
[ "$answered" -ge 1400 ]
counter() { cat "/sys/module/csi5300/counters/$1"; }
[ "$(counter delivered)" = 0 ] && [ "$(counter rates_set)" -ge "$((2 * answered))" ]
# One sender in each log: the other robot.
csi5300 info rx-ebpf.dat | grep -q "$B"
csi5300 info tx-ebpf.dat | grep -q "$A"
csi5300 info rx-ebpf.dat | grep -q "$A" && exit 1
csi5300 info tx-ebpf.dat | grep -q "$B" && exit 1
csi5300 bearing --rx rx-ebpf.dat --tx tx-ebpf.dat --trajectory ebpf.csv --channel 64 --json >bearing.json
# The first and the last frames may be outside of the trajectory.
[ "$(sed -n 's/.*"pairs":\([0-9]*\).*/\1/p' bearing.json)" -ge "$((answered - 10))" ]
# As in 30-sounding.sh: the transmitter is at (3, 1.5).
sed -n 's/.*"position_m":\[\([^]]*\)\].*/\1/p' bearing.json | awk -F, '
    { off = ($2 / $1 - 0.5) / 0.0109 / 2; printf "transmitter at %.3f, %.3f m, truth 3, 1.5 m: %.3f degrees off\n", $1, $2, off }
    END { exit !(NR == 1 && off > -0.5 && off < 0.5) }'
rmmod csi5300
