#!/usr/bin/env bash
# Checks the systemd unit with systemd's own checker, alone and with the files for a serial port, sounding and the stock driver, and the
# exposure level that systemd computes (of 10; alone at most 1.5). 77: no systemd-analyze.
set -euo pipefail
cd "$(dirname "$0")/../.."
command -v systemd-analyze >/dev/null || { echo "no systemd-analyze"; exit 77; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
# The program is not installed where the unit expects it.
sed 's|/usr/local/bin/csi5300-node|/bin/true|' packaging/csi5300-node.service >"$folder/csi5300-node.service"
verify() {
    said=$(systemd-analyze verify "$folder/csi5300-node.service" 2>&1) || { echo "$said"; exit 1; }
    [ -z "$said" ] || { echo "$said"; exit 1; }
}
exposure() { SYSTEMD_UNIT_PATH="$folder:" systemd-analyze security --offline=true --threshold="$1" csi5300-node.service | tail -n 1; }
verify
exposure 15
mkdir "$folder/csi5300-node.service.d"
cp packaging/csi5300-node-{serial,sounding}.conf "$folder/csi5300-node.service.d/"
verify
exposure 21
# The files grant the rights that they are for: systemd adds them to the unit's lists.
given=$(SYSTEMD_UNIT_PATH="$folder:" systemd-analyze security --offline=true csi5300-node.service)
for right in 'PrivateDevices=' 'ttyACM' 'RestrictAddressFamilies=~AF_PACKET' 'RestrictRealtime=' 'SystemCallFilter=~@resources' \
    'NET_(BIND_SERVICE|BROADCAST|RAW)'; do
    grep -F "$right" <<<"$given" | grep -q '✗' || { echo "the files beside the unit do not give: $right"; exit 1; }
done

# With only the stock driver: two capabilities (systemd's list has no line for CAP_PERFMON); with sounding, its own as well.
held() {
    SYSTEMD_UNIT_PATH="$folder:" systemd-analyze security --offline=true csi5300-node.service |
        sed -n 's/^✗ CapabilityBoundingSet=~\([^ ]*\).*/\1/p' | sort | tr '\n' ' '
}
rm "$folder"/csi5300-node.service.d/*
cp packaging/csi5300-node-stock.conf "$folder/csi5300-node.service.d/05-stock.conf"
verify
exposure 17
[ "$(held)" = "CAP_BPF " ] || { echo "with the stock driver the service holds $(held)"; exit 1; }
for set in AmbientCapabilities CapabilityBoundingSet; do
    [ "$(grep "^$set=" packaging/csi5300-node-stock.conf | tr '\n' ' ')" = "$set= $set=CAP_BPF CAP_PERFMON " ] || { echo "$set is not what --stock needs"; exit 1; }
done
grep -q '/csi5300-node.service.d/05-stock.conf' packaging/csi5300-node-stock.conf
cp packaging/csi5300-node-sounding.conf "$folder/csi5300-node.service.d/sounding.conf"
verify
[ "$(held)" = "CAP_BPF CAP_NET_(BIND_SERVICE|BROADCAST|RAW) " ] || { echo "with the stock driver and sounding the service holds $(held)"; exit 1; }
