#!/usr/bin/env bash
# Licences and duplicates of the crates of all features, against deny.toml.
set -euo pipefail
cd "$(dirname "$0")/../.."
python3 -c 'import tomllib' 2>/dev/null || { echo "no Python 3.11 or newer"; exit 77; }
python3 scripts/dependencies.py
