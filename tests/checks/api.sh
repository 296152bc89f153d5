#!/usr/bin/env bash
# Compares the public items of the published crates with the committed lists in docs/reference/api, so that reviews show API changes.
# `tests/checks/api.sh --write` rewrites the lists. 77: cargo-public-api cannot be installed here.
set -euo pipefail
cd "$(dirname "$0")/../.."
version=0.52.0
tool=target/tools/bin/cargo-public-api
if [ "$("$tool" --version 2>/dev/null || true)" != "cargo-public-api $version" ]; then
    # An unoptimised build takes a third of the time, and reads these lists in a third of a second.
    CARGO_PROFILE_DEV_DEBUG=0 cargo install --quiet --locked --debug --root target/tools "cargo-public-api@$version" || { echo "cargo-public-api cannot be installed"; exit 77; }
fi
different=0
for crate in driver-iface csi5300; do
    # The list comes from rustdoc's JSON, which the stable compiler only writes with this variable.
    # .ci/run has it from the doctests.
    [ -n "${CSI5300_API_WRITTEN:-}" ] ||
        RUSTC_BOOTSTRAP=1 cargo rustdoc --quiet -p "$crate" --lib --target-dir target/api -- -Z unstable-options --output-format json
    found=target/api/$crate.txt
    "$tool" --rustdoc-json "target/api/doc/${crate//-/_}.json" -sss >"$found"
    # Fields, variants and required trait items are not listed separately.
    items=$(awk '
        /^impl/ { of_a_trait = / for /; next }
        /^(#\[non_exhaustive\] )?pub (struct|enum|trait|mod|use)/ { of_a_trait = 0 }
        /^(#\[non_exhaustive\] )?pub (const fn|fn|struct|enum|trait|const|static|type|mod|macro|use|unsafe fn)/ { items += !of_a_trait }
        END { print items }' "$found")
    printf '%s: %s public items\n' "$crate" "$items"
    if [ "${1:-}" = --write ]; then
        mkdir -p docs/reference/api && cp "$found" "docs/reference/api/$crate.txt"
    elif ! diff -u "docs/reference/api/$crate.txt" "$found"; then
        echo "the public API of $crate changed: if that is meant, tests/checks/api.sh --write, and a line in CHANGELOG.md"
        different=1
    fi
done
exit "$different"
