#!/usr/bin/env bash
# Prints docs/reference/commands.md: every command with its options, from the program's own tables. scripts/commands.sh PROGRAM
# `scripts/commands.sh target/release/csi5300 >docs/reference/commands.md` writes the page anew; tests/checks/docs.sh compares it.
set -euo pipefail
program=$1
printf '# Commands\n\n'
printf 'Every command with its options, as `csi5300 COMMAND --help` prints them. `packaging/robot.toml` explains every key of the node.\n'
printf '`scripts/commands.sh` writes this page from the program.\n'
for command in $("$program" help --all 2>/dev/null | awk '/^Of the version before/ { exit } /^  [a-z]/ { print $1 }'); do
    printf '\n## %s\n\n```text\n' "$command"
    COLUMNS=100 "$program" "$command" --help 2>/dev/null |
        awk '/^(  -q, --quiet|  -v, --verbose|      --color|  -h, --help)/ { skip = 1; next } /^ {0,6}-/ || /^[^ ]/ { skip = 0 } !skip' | sed 's| *$||' | cat -s
    printf '```\n'
done
