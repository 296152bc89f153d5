#!/usr/bin/env bash
# The program on a processor without AVX, such as the UP Squared's Goldmont: in `qemu-x86_64 -cpu Denverton` the demo and the claims about
# a simulated room give the same bearings as on this machine, to 0.001 degrees. 77: no qemu-x86_64 can be installed here.
set -euo pipefail
cd "$(dirname "$0")/../.."
cannot() { echo "$1"; exit 77; }
[ "$(uname -sm)" = "Linux x86_64" ] || cannot "not x86-64 Linux"
export DEBIAN_FRONTEND=noninteractive
command -v qemu-x86_64 >/dev/null || apt-get install -y --no-install-recommends qemu-user >/dev/null 2>&1 </dev/null ||
    cannot "qemu-x86_64 is not installed, and apt-get cannot install qemu-user"
grep -q Denverton <<<"$(qemu-x86_64 -cpu help)" || cannot "this QEMU has no processor Denverton"
# Built as by `cargo run --release`, so that nothing is built twice.
cargo build --quiet --release --bin csi5300
program=$PWD/target/release/csi5300
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
for here in native emulated; do
    run=("$program")
    [ "$here" = native ] || run=(qemu-x86_64 -cpu Denverton "$program")
    "${run[@]}" demo --out "$here" --json >"$here-demo.json" 2>"$here.err" || { cat "$here.err"; exit 1; }
    "${run[@]}" doctor --accept lab-circle --json >"$here-claims.json" 2>>"$here.err"
    echo "$here: done after $SECONDS s"
done
python3 - <<'PYTHON'
import json
lines = {here: [json.loads(line) for line in open(f"{here}-demo.json")] for here in ("native", "emulated")}
# For a straight line two directions are equally good: their order is random.
both = lambda line: sorted([line["azimuth_deg"], line["mirror_deg"] or line["azimuth_deg"]])
bearings = {here: [azimuth for line in told if "azimuth_deg" in line for azimuth in both(line)] for here, told in lines.items()}
claims = {}
for here in lines:
    findings = json.load(open(f"{here}-claims.json"))["findings"]
    (processor,) = [finding for finding in findings if finding["id"] == "host.processor"]
    (truth,) = [finding for finding in findings if finding["id"] == "truth.bearing"]
    bearings[here].append(truth["figures"][0]["value"])
    claims[here] = processor
    print(f"{here}: {processor['verdict']}, {processor['found']}; bearings {bearings[here]}")
assert len(bearings["native"]) == len(bearings["emulated"]) == 5
apart = max(abs(a - b) for a, b in zip(*bearings.values()))
print(f"{apart:.6f} degrees apart")
assert apart <= 0.001
found = claims["emulated"]["found"]
assert claims["emulated"]["verdict"] == "holds" and "Sse42" in found and "Avx" not in found, found
PYTHON
