#!/usr/bin/env bash
# Runs the commands of README.md and of the pages in docs (their ```sh blocks) as written, each page in its own empty folder. Other
# commands in them name readers' files, so only their names and options are checked. Every link between pages must lead somewhere.
# Usage: tests/checks/docs.sh [PROGRAM]
set -euo pipefail
cd "$(dirname "$0")/../.."
program=${1:-$(scripts/program.sh)}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir "$folder/bin"
ln -s "$(realpath "$program")" "$folder/bin/csi5300"
# The node: beside the program, or beside the one that other checks use.
for node in "$(dirname "${CSI5300:-$program}")/csi5300-node" "$(dirname "$program")/csi5300-node"; do
    [ ! -x "$node" ] || ln -sf "$(realpath "$node")" "$folder/bin/csi5300-node"
done

for page in README.md docs/*.md docs/*/*.md; do
    while read -r target; do
        target=${target%%#*}
        [ -z "$target" ] || [ -e "$(dirname "$page")/$target" ] || { echo "$page: the link to $target leads nowhere"; exit 1; }
    done < <(grep -oE '\]\([^)]+\)' "$page" | sed -E 's/^\]\(//; s/\)$//' | grep -vE '^(https?|mailto):')
done

# A test that a page names exists, in the module of that name.
for name in $(grep -ohE '`([a-z_0-9]+::)+([a-z_0-9]+|\*)`' docs/method/*.md | tr -d '`' | sort -u); do
    module=${name%::*}
    module=${module%::tests}
    test=${name##*::}
    git grep -qF "fn ${test#\*}" -- "*/${module##*::}.rs" "*/${module##*::}/*.rs" || { echo "docs/method names a test that is not there: $name"; exit 1; }
done

if grep -n '\.\./shared' README.md docs/*.md docs/*/*.md; then
    echo "these pages name a folder that readers do not have"
    exit 1
fi
# Language: sentence length, and phrases to avoid.
if command -v python3 >/dev/null; then
    git ls-files -z '*.md' | xargs -0 python3 scripts/prose.py
else
    echo "skipped: the language of the pages: no python3"
fi
# The command reference equals the program's help.
scripts/commands.sh "$program" >"$folder/commands.md"
diff -u docs/reference/commands.md "$folder/commands.md" || { echo "docs/reference/commands.md differs from the program's help: run scripts/commands.sh PROGRAM >docs/reference/commands.md"; exit 1; }
# Lines of blocks (fenced or indented) and text in backticks; " #" starts a comment.
commands() { grep -oE '^(    )?csi5300 [a-z].*|`csi5300 [a-z][^`]*`' "$1" | tr -d '`' | sed 's/ #.*//'; }
known=0
for page in README.md docs/*.md docs/*/*.md; do
    while read -r _ command rest; do
        # Not a command: the magic number of a side file.
        [ "$command $rest" != "checks 1" ] || continue
        help="$folder/help-$command"
        [ -e "$help" ] || "$program" "$command" --help >"$help" 2>&1 || {
            echo "$page: csi5300 $command is not a command"
            exit 1
        }
        for option in $(grep -oE -- '(^|[^a-z-])--[a-z][a-z-]*' <<<"$rest" | grep -oE -- '--.*' | sort -u); do
            grep -qE -- "(^|[^a-z-])$option([^a-z-]|$)" "$help" || grep -q 'was built without it' "$help" || {
                echo "$page: csi5300 $command has no $option"
                exit 1
            }
            known=$((known + 1))
        done
    done < <(commands "$page")
done
echo "$known options of commands that are not run: all known"
for page in README.md docs/guides/node.md docs/guides/one-log.md docs/guides/simulation.md docs/guides/tutorial.md docs/guides/view.md; do
    grep -q '^```sh$' "$page" || { echo "$page has no commands"; exit 1; }
done
# The output in ```text blocks must equal what the page's commands print. A real-time room prints different numbers each time.
printed() {
    local shown=0 line mask=cat
    ! grep -q -- --serve "$1" || mask='sed -E s/[0-9]+(\.[0-9]+)?/#/g'
    while IFS= read -r line; do
        grep -qxF -- "$line" <($mask "$2") || { echo "$1 shows a line that no command prints: $line"; return 1; }
        shown=$((shown + 1))
    done < <(awk '/^```text$/ { on = 1; next } /^```$/ { on = 0 } on && NF' "$1" | $mask)
    echo "$1: all $shown shown lines are printed"
    [ "$1" != README.md ] || [ "$shown" -gt 5 ] || { echo "$1 shows nothing"; return 1; }
}
for page in README.md docs/*.md docs/*/*.md; do
    grep -q '^```sh$' "$page" || continue
    own="$folder/$(basename "$page" .md)"
    awk '/^```sh$/ { on = 1; next } /^```$/ { on = 0 } on' "$page" >"$own.sh"
    # The tutorial's room runs in real time: on a busy machine its robots are late, so it gets several tries.
    tries=1
    ! grep -q -- --serve "$own.sh" || tries=4
    for try in $(seq "$tries"); do
        rm -rf "$own"
        mkdir "$own"
        status=0
        (cd "$own" && PATH="$folder/bin:$PATH" timeout 900 bash -euo pipefail ../"$(basename "$own.sh")" >said.txt 2>&1) || status=$?
        # The quick start also runs a second time in the same folder.
        if [ "$status" = 0 ] && [ "$page" = README.md ]; then
            (cd "$own" && PATH="$folder/bin:$PATH" bash -euo pipefail ../README.sh >>said.txt 2>&1) || status=$?
        fi
        # The transmitter is at 42.0 degrees.
        if [ "$status" = 0 ] && [ "$page" = docs/guides/tutorial.md ]; then
            grep -E '^tx \(.*: 4[123]\.[0-9]+ deg' "$own/said.txt" || { echo "no bearing of 42 degrees" && status=1; }
        fi
        [ "$status" != 0 ] || printed "$page" "$own/said.txt" || status=1
        [ "$status" != 0 ] || break
        echo "$page: status $status (try $try of $tries)"
        tail -n 30 "$own/said.txt"
    done
    [ "$status" = 0 ] || exit 1
    echo "$page: $(grep -c . "$own.sh") lines of commands ran"
done
