# The requests that the patched drivers send to the card and the stock one does not, checked by the commands that the cards receive (cards.c).
asked() { cat "/sys/module/fakecard/parameters/$1"; }
counter() { cat "/sys/module/csi5300/counters/$1"; }
# more NAME COMMAND...: the command increases the cards' count of NAME and no other RXON count.
before() { for name in plain beamforming stations orders; do eval "old_$name=$(asked $name)"; done; }
grown() { eval "echo \$(($(asked "$1") - \$old_$1))"; }
expect() {
    said="plain $(grown plain), beamforming $(grown beamforming), stations $(grown stations), orders $(grown orders)"
    for word in "$@"; do
        name=${word%%[=>]*}
        case "$word" in
            *=0) [ "$(grown "$name")" = 0 ] || { echo "$*: $said"; exit 1; } ;;
            *) [ "$(grown "$name")" -gt 0 ] || { echo "$*: $said"; exit 1; } ;;
        esac
    done
    echo "$said"
}
before
iw dev wlan0 set channel 60 HT20
expect 'plain>0' beamforming=0 stations=0 orders=0

# A card that is not a 5300 on PCI, such as these, gets no requests, unless all cards should.
insmod /modules/csi5300.ko transmit=fakecard_tx
dmesg | grep -q "csi5300: probe at iwl_restore_stations"
before
iw dev wlan0 set channel 52 HT20
expect 'plain>0' beamforming=0 stations=0 orders=0
[ "$(counter rxons)" = 0 ] && [ "$(counter unasked)" -ge "$(grown plain)" ]
rmmod csi5300

insmod /modules/csi5300.ko transmit=fakecard_tx device=0
before
iw dev wlan0 set channel 56 HT20
expect plain=0 'beamforming>0' 'stations>0' 'orders>0'
[ "$(grown stations)" = "$(grown orders)" ]
[ "$(counter stations) $(counter orders)" = "$(grown stations) $(grown orders)" ]
[ "$(counter rxons)" -ge "$(grown beamforming)" ]
# Reloaded firmware: the interface goes down and up.
before
ip link set wlan0 down
ip link set wlan0 up
iw dev wlan0 set channel 60 HT20
expect plain=0 'beamforming>0' 'stations>0' 'orders>0'
for one in 1 2 4; do
    echo "$one" >/sys/module/csi5300/parameters/ask
    before
    iw dev wlan0 set channel "$((48 + 4 * one))" HT20
    case "$one" in
        1) expect plain=0 'beamforming>0' stations=0 orders=0 ;;
        2) expect 'plain>0' 'stations>0' orders=0 ;;
        4) expect 'plain>0' stations=0 'orders>0' ;;
    esac
done
rmmod csi5300
before
iw dev wlan0 set channel 36 HT20
expect 'plain>0' beamforming=0 stations=0 orders=0
for k in 0 1; do iw dev "wlan$k" set channel 64 HT20; done
