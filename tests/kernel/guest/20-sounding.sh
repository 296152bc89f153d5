# Sounding over mac80211: the program injects frames, which cross simulated radios, and answers them on another radio; a kernel module
# turns received frames into the driver's records. Times are the emulator's and mean nothing.
for module in virtio_ring virtio libarc4 rfkill cfg80211 mac80211; do load "$module"; done
load mac80211_hwsim radios=3 channels=2
A=02:00:00:00:00:00 B=02:00:00:00:01:00 C=02:00:00:00:02:00
slow="--turn-around 6000 --guard 1500"
tune() {
    for k in 0 1 2; do iw dev "wlan$k" set freq 5540 HT20; done
}
for k in 0 1 2; do
    iw dev "wlan$k" set type monitor
    ip link set "wlan$k" mtu 2304
    ip link set "wlan$k" up
done
tune

echo "a channel on which nobody may start to transmit: the kernel drops every frame, which is noticed"
if csi5300 sound --interface wlan0 --peers "$B" --alone --rate 50 $slow --stop-after 4s 2>/tmp/said; then
    echo "a run whose frames all vanish is not a success"
    exit 1
fi
cat /tmp/said
grep -q "it reports none of them as sent" /tmp/said
grep -q "confirms none of" /tmp/said
iw reg set PA
until iw reg get | grep -q "country PA"; do :; done
tune

# listen NAME INDEX: records a card's messages.
recorders=
listen() {
    : >"$1.said"
    csi5300 record "$1.dat" --force --connector-index "$2" 2>"$1.said" &
    recorders="$recorders $!"
    until grep -q "recording to" "$1.said"; do :; done
}
stop() {
    # The last records are still in transit.
    sleep 1
    kill -TERM $recorders
    for pid in $recorders; do wait "$pid"; done
    recorders=
}
# ready FILE PID: waits until the sender's thread reports that it runs.
ready() {
    touch "$1"
    until grep -q "^sending under" "$1"; do kill -0 "$2"; done
}
# check LINKS: checks the logs of this folder, here and again on the host, to which /init copies /tmp/out.
check() {
    echo "$1" >links
    CSI5300_TEST_GUEST_LINKS="$1" /tests/live --exact kernel::every_answered_frame_is_a_pair_of_the_logs --nocapture >/tmp/checked 2>&1 || {
        cat /tmp/checked
        exit 1
    }
    cat /tmp/checked
    grep -q "1 passed" /tmp/checked
}

for dialect in native wsr; do
    echo "two radios, $dialect"
    mkdir -p "/tmp/out/two-$dialect" && cd "/tmp/out/two-$dialect"
    wsr=0 own="--connector-index 25"
    [ "$dialect" = native ] || { wsr=1 own="--ack-len 57"; }
    insmod /modules/csi5300_heard.ko interfaces=wlan0,wlan1 idx=26,25 wsr=$wsr
    listen a 26
    listen b 25
    csi5300 sound --answer --interface wlan1 --peers "$A" --dialect "$dialect" $own --rate 50 $slow 2>respond &
    responder=$!
    ready respond "$responder"
    csi5300 sound --interface wlan0 --peers "$B" --dialect "$dialect" --alone --rate 50 $slow --stop-after 10s 2>sound
    kill -TERM "$responder"
    wait "$responder"
    stop
    cat sound respond
    grep -q "sending under SCHED_FIFO, memory locked" sound
    check "a.dat $A b.dat $B sound"
    rmmod csi5300_heard
done

echo "three radios, native, with a key: two initiators in turn"
mkdir -p /tmp/out/three && cd /tmp/out/three
(umask 077 && head -c 16 /dev/urandom >/tmp/key)
insmod /modules/csi5300_heard.ko interfaces=wlan0,wlan1,wlan2 idx=26,25,23
listen a 26
listen b 25
listen c 23
common="--rate 40 $slow --links 2 --key /tmp/key"
csi5300 sound --answer --interface wlan2 --peers "$A,$B" $common --connector-index 23 2>respond &
responder=$!
ready respond "$responder"
csi5300 sound --interface wlan1 --peers "$A,$C" $common 2>sound-b &
second=$!
ready sound-b "$second"
csi5300 sound --interface wlan0 --peers "$B,$C" $common --log own.dat --connector-index 26 --stop-after 20s 2>sound-a
kill -TERM "$second" "$responder"
wait "$second"
wait "$responder"
stop
cat sound-a sound-b respond
check "a.dat $A b.dat $B sound-a
a.dat $A c.dat $C sound-a
own.dat $A c.dat $C sound-a
b.dat $B a.dat $A sound-b
b.dat $B c.dat $C sound-b"
rmmod csi5300_heard
