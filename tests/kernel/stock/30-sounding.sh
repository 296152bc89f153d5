# sound and respond over mac80211 and the stock driver, with a simulated room as the air: compares bearings with its truth, then tests the
# module's own answers in the WSR dialect.
A=00:21:6a:00:00:01 B=00:21:6a:00:00:02
mkdir -p /tmp/out/stock && cd /tmp/out/stock

# up OPTIONS: loads the module with a connector index for each card, 26 and 25. The first packets are the first card's, so if the slots
# are in another order their names decide.
up() {
    for k in 0 1; do ip link set "wlan$k" down; done
    insmod /modules/csi5300.ko transmit=fakecard_tx device=0 index=26,25 connector_log=5 "$@"
    for k in 0 1; do
        ip link set "wlan$k" mtu 2304
        ip link set "wlan$k" up
        iw dev "wlan$k" set channel 64 HT20
    done
}
# air NAME: simulates the room between the cards until the file NAME.stop exists.
air() {
    rm -f "$1.stop"
    CSI5300_STOCK_AIR="/guest/room.toml $PWD/$1.csv $PWD/$1.stop" /tests/live --exact stock::a_room_between_the_cards --nocapture >"$1.air" 2>&1 &
    air=$!
}
landed() {
    touch "$1.stop"
    wait "$air" || { cat "$1.air"; exit 1; }
    grep "frames on air" "$1.air"
}
counter() { cat "/sys/module/csi5300/counters/$1"; }

echo "a robot alone: it sends, says what it waits for, and how it went"
up
air alone
csi5300 sound --interface wlan0 --peers "$B" --rate 20 --stop-after 4s --alone 2>sound-alone || true
landed alone
grep -q "first frame at once; then waiting for answers of $B" sound-alone
grep -q "forward frames, 0 answered" sound-alone
grep -q "the kernel confirms" sound-alone
[ "$(counter rates_set)" -gt 20 ]
csi5300 sound --interface wlan0 --peers "$B" --rate 20 --stop-after 1s 2>sound-short || true
grep -q "first frame in 6.* s, if no other robot is heard" sound-short
grep -q "no frame was sent" sound-short

echo "two robots at 100 rounds/s; the slots are named by bus address and MAC, in the other order"
rmmod csi5300
up index=25,26 card=fakecard.1,00:21:6A:00:00:01
air two
: >rx.said
csi5300 record rx.dat --force --connector-index 26 2>rx.said &
rx=$!
: >tx.said
csi5300 record tx.dat --force --connector-index 25 2>tx.said &
tx=$!
until grep -q "recording to" rx.said && grep -q "recording to" tx.said; do :; done
slow="--rate 100 --turn-around 6000 --guard 1500"
csi5300 sound --answer --interface wlan1 --peers "$A" $slow --connector-index 25 2>respond &
responder=$!
touch respond
until grep -q "^sending under" respond; do kill -0 "$responder"; done
csi5300 doctor --accept --channel 64 --listen 12s --connector-index 26 --json >claims.json 2>claims.said &
claims=$!
csi5300 sound --interface wlan0 --peers "$B" $slow --alone --stop-after 20s 2>sound
kill -TERM "$responder"
wait "$responder" || true
sleep 1
kill -TERM "$rx" "$tx"
wait "$rx" "$tx" || true
landed two
grep -e "forward frames" -e "turn-around" sound respond
answered=$(sed -n 's/.* forward frames, \([0-9]*\) answered.*/\1/p' sound)
[ "$answered" -ge 1900 ]
csi5300 bearing --rx rx.dat --tx tx.dat --trajectory two.csv --channel 64 --json >bearing.json
# The transmitter is at (3, 1.5), the circle's centre at the origin: seen from there the slope is 0.5, and a difference of 0.0109 is half
# a degree.
within_half_a_degree() {
    sed -n 's/.*"position_m":\[\([^]]*\)\].*/\1/p' bearing.json | awk -F, '
        { off = ($2 / $1 - 0.5) / 0.0109 / 2; printf "transmitter at %.3f, %.3f m, truth 3, 1.5 m: %.3f degrees off\n", $1, $2, off }
        END { exit !(NR == 1 && off > -0.5 && off < 0.5) }'
}
# No pair is missing; both logs may contain a late answer that the sounder did not count.
complete() {
    pairs=$(number pairs)
    [ "$pairs" -ge "$answered" ] && [ "$pairs" -le "$(sed -n 's/\([0-9]*\) forward frames, .*/\1/p' "$1")" ] || { echo "$pairs pairs of $answered answers"; exit 1; }
}
number() { sed -n "s/.*\"$1\":\([-0-9.e]*\).*/\1/p" bearing.json; }
complete sound
within_half_a_degree

echo "the claims about the card: live, and of the logs that it left"
# verdict FILE CLAIM: for the first card with this claim.
verdict() { sed -n "/\"id\": \"$2\"/,/\"found\"/s/.*\"verdict\": \"\(.*\)\".*/\1/p" "$1" | head -n 1; }
# held FILE CLAIM..: all claims hold.
held() {
    file=$1
    shift
    for claim in "$@"; do
        [ "$(verdict "$file" "$claim")" = holds ] || { sed -n "/\"id\": \"$claim\"/,/}/p" "$file" | head -n 20; echo "$claim: $(verdict "$file" "$claim")"; exit 1; }
    done
}
wait "$claims" || true
held claims.json module.csi module.marked module.order module.layout recorder.same host.buffer log.whole log.layout reception.rate reception.width \
    reception.chains reception.order reception.zero reception.fresh reception.once card.clock
# How late an emulated host wakes up is reported; it need not be punctual.
[ "$(verdict claims.json host.lateness)" != not_tried ]
csi5300 doctor --accept rx.dat tx.dat --channel 64 --json >logs.json || true
held logs.json exchange.pairs exchange.drift phase.sign log.whole reception.subcarriers
for file in claims.json logs.json; do grep -c '"verdict": "holds"' "$file"; sed -n 's/.*"id": "\(.*\)".*/\1/p;s/.*"verdict": "\(fails\)".*/  &/p' "$file" | grep -B1 fails || true; done
rmmod csi5300

echo "the module answers itself, in the WSR dialect"
up index=25,26 layout=wsr ack_len=57 answer_on=wlan1
air wsr
csi5300 record wsr-rx.dat --force --connector-index 26 2>rx.said &
rx=$!
csi5300 record wsr-tx.dat --force --connector-index 25 2>tx.said &
tx=$!
until grep -q "recording to" rx.said && grep -q "recording to" tx.said; do :; done
csi5300 sound --interface wlan0 --peers "$B" --rate 100 --guard 1500 --turn-around 6000 --dialect wsr --alone --open-loop --stop-after 20s 2>sound-wsr
sleep 1
kill -TERM "$rx" "$tx"
wait "$rx" "$tx" || true
landed wsr
grep -e "forward frames" -e "answers began" sound-wsr
answered=$(sed -n 's/.* forward frames, \([0-9]*\) answered.*/\1/p' sound-wsr)
[ "$answered" -ge 1900 ]
[ "$(counter answered)" -ge "$answered" ]
[ "$(counter unanswered) $(counter ring_full) $(counter no_phy)" = "0 0 0" ]
csi5300 bearing --rx wsr-rx.dat --tx wsr-tx.dat --trajectory wsr.csv --channel 64 --json >bearing.json
complete sound-wsr
within_half_a_degree
rmmod csi5300
