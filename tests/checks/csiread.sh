#!/usr/bin/env bash
# Compares raw and scaled CSI with csiread from PyPI, over the captures of the stock layout. Exit status 77: cannot run here.
set -u
cd "$(dirname "$0")/../.."
command -v python3 >/dev/null || { echo "no python3"; exit 77; }
[ -d "${CSI5300_CAPTURES:-../shared/captures}/csitool" ] || { echo "no captures beside this checkout"; exit 77; }
scripts/venv.sh csiread==1.4.1 numpy >/dev/null || { echo "csiread cannot be installed from PyPI"; exit 77; }
exec scripts/csiread_compare.sh
