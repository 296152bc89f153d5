#!/usr/bin/env bash
# Checks licences and duplicates of the crates of all features against deny.toml; advisories if cargo-deny is installed and its database available.
set -euo pipefail
cd "$(dirname "$0")/../.."
python3 -c 'import tomllib' 2>/dev/null || { echo "no Python 3.11 or newer"; exit 77; }
python3 scripts/dependencies.py
if ! command -v cargo-deny >/dev/null; then
    advisories="no cargo-deny"
elif ! timeout 120 cargo deny fetch db >/dev/null 2>&1; then
    advisories="the database cannot be fetched"
else
    cargo deny --all-features check advisories
    exit 0
fi
echo "skipped: advisories ($advisories)"
[ -z "${CSI5300_SKIPS:-}" ] || echo "advisories: $advisories" >>"$CSI5300_SKIPS"
