# The acceptance claims on mac80211_hwsim: one radio sends and is judged, the other one assists and answers. Claims that hwsim cannot
# decide are not tried, or fail because its CSI is computed from the frame's number.
for module in virtio_ring virtio libarc4 rfkill cfg80211 mac80211; do load "$module" 2>/dev/null || true; done
load mac80211_hwsim radios=2 channels=2 2>/dev/null || true
mkdir -p /tmp/out/claims && cd /tmp/out/claims
for k in 0 1; do
    ip link set "wlan$k" down
    iw dev "wlan$k" set type monitor
    ip link set "wlan$k" mtu 2304
    ip link set "wlan$k" up
done
tune() {
    for k in 0 1; do iw dev "wlan$k" set freq 5540 HT20; done
}
insmod /modules/csi5300_heard.ko interfaces=wlan0,wlan1 idx=26,25 wsr=1
cat >far.toml <<END
channel = "108"
assist = "127.0.0.1:5300"
interface = "wlan1"
answer = true
END
cat >near.toml <<END
channel = "108"
interface = "wlan0"
send = true
peer = "127.0.0.1:5300"
END
# run NAME: runs both robots; the verdicts are in NAME.json.
run() {
    : >"$1.far"
    csi5300 doctor --accept far.toml --connector-index 25 2>"$1.far" &
    far=$!
    until grep -q "for the first robot" "$1.far"; do kill -0 "$far"; done
    csi5300 doctor --accept near.toml --connector-index 26 --json >"$1.json" 2>"$1.near" || true
    wait "$far" || { cat "$1.far" "$1.near"; exit 1; }
    cat "$1.near"
}
# verdict FILE CLAIM OF: `holds`, `fails`, `not_tried` or `measured`.
verdict() {
    sed -n "/\"id\": \"$2\"/,/\"found\"/p" "$1.json" | sed -n "/\"of\": \"$3\"/,/\"found\"/s/.*\"verdict\": \"\(.*\)\".*/\1/p" | head -n 1
}
# are FILE VERDICT OF CLAIM..
are() {
    file=$1 expected=$2 of=$3
    shift 3
    for claim in "$@"; do
        [ "$(verdict "$file" "$claim" "$of")" = "$expected" ] || { sed -n "/\"id\": \"$claim\"/,/}/p" "$file.json" | head -n 30; echo "$claim of $of: $(verdict "$file" "$claim" "$of"), not $expected"; exit 1; }
    done
}

echo "a channel on which nobody may start to transmit"
iw reg set 00
until iw reg get | grep -q "country 00"; do :; done
tune
run forbidden
are forbidden fails link injection.channel injection.confirmed
are forbidden holds link injection.taken

echo "a channel that is free"
iw reg set PA
until iw reg get | grep -q "country PA"; do :; done
tune
run free
are free holds link injection.channel injection.taken injection.confirmed injection.heard injection.numbers exchange.pairs
# At the HT rate, with the right address, once.
for of in near far; do are free holds "$of" reception.rate reception.once log.whole log.layout reception.count reception.gaps; done
are free holds near recorder.same
# No antennas, no module, no meaningful phases.
are free not_tried link truth.bearing phase.retune phase.rest reception.unplugged phase.crystal
are free not_tried host module.csi host.processor
grep -c '"verdict": "holds"' free.json
rmmod csi5300_heard
