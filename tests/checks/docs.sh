#!/usr/bin/env bash
# The commands of README.md and of the pages in docs (their ```sh blocks), run as written, each page in an empty folder of its own;
# and every link between pages leads somewhere. A program may be named: tests/checks/docs.sh PROGRAM
set -euo pipefail
cd "$(dirname "$0")/../.."
program=${1:-$(scripts/program.sh)}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir "$folder/bin"
ln -s "$(realpath "$program")" "$folder/bin/csi5300"

for page in README.md docs/*.md; do
    while read -r target; do
        target=${target%%#*}
        [ -z "$target" ] || [ -e "$(dirname "$page")/$target" ] || { echo "$page: no $target"; exit 1; }
    done < <(grep -oE '\]\([^)]+\)' "$page" | sed -E 's/^\]\(//; s/\)$//' | grep -vE '^(https?|mailto):')
done

for page in README.md docs/tutorial.md docs/view.md; do
    grep -q '^```sh$' "$page" || { echo "$page has no commands"; exit 1; }
done
for page in README.md docs/*.md; do
    grep -q '^```sh$' "$page" || continue
    own="$folder/$(basename "$page" .md)"
    mkdir "$own"
    awk '/^```sh$/ { on = 1; next } /^```$/ { on = 0 } on' "$page" >"$own/commands.sh"
    (cd "$own" && PATH="$folder/bin:$PATH" bash -euo pipefail commands.sh >said.txt 2>&1) || {
        echo "$page: status $?"
        tail -n 30 "$own/said.txt"
        exit 1
    }
    echo "$page: $(grep -c . "$own/commands.sh") lines of commands ran"
done
# The tutorial's room has its transmitter at 42.0 degrees.
grep -E '^tx \(.*: 4[123]\.[0-9]+ deg' "$folder/tutorial/said.txt" || { echo "no bearing of 42 degrees"; exit 1; }
