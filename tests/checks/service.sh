#!/usr/bin/env bash
# The systemd unit: read by systemd's own checker, and how exposed it calls the service. 77: no systemd-analyze.
set -euo pipefail
cd "$(dirname "$0")/../.."
command -v systemd-analyze >/dev/null || { echo "no systemd-analyze"; exit 77; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
# The program is not installed where the unit expects it.
sed 's|/usr/local/bin/csi5300|/bin/true|' packaging/csi5300-node.service >"$folder/csi5300-node.service"
said=$(systemd-analyze verify "$folder/csi5300-node.service" 2>&1) || { echo "$said"; exit 1; }
[ -z "$said" ] || { echo "$said"; exit 1; }
systemd-analyze security --offline=true --threshold=22 "$folder/csi5300-node.service" | tail -n 1
