#!/usr/bin/env bash
# Prints docs/reference/commands.md: every command with its options, from the program's own help. scripts/commands.sh PROGRAM
# `scripts/commands.sh target/release/csi5300 >docs/reference/commands.md` rewrites the page; tests/checks/docs.sh compares it.
# An option whose text equals that of an earlier command's option is only named.
set -euo pipefail
program=$1
printf '# Commands\n\n'
printf 'Every command with its options, as `csi5300 COMMAND --help` prints them. `packaging/robot.toml` explains every key of the node.\n'
printf '`scripts/commands.sh` writes this page. "As in NAME" names options with the same text as those of another command.\n'
for command in $("$program" help --all 2>/dev/null | awk '/^  [a-z]/ { print $1 }'); do
    printf '\n## %s\n\n' "$command"
    COLUMNS=100 "$program" "$command" --help 2>/dev/null | sed 's| *$||' | cat -s
done | awk '
    # Prints the option read last, or keeps its name for the end of the command.
    function option() {
        if (block == "") return
        if (block in first) also[first[block]] = also[first[block]] ", " name
        else {
            first[block] = command
            printf "%s%s", heading, block
            heading = ""
        }
        block = ""
    }
    function finish(earlier) {
        option()
        if (command == "") return
        for (i = 1; i <= commands; i++) if (order[i] in also) print "As in " order[i] ": " substr(also[order[i]], 3)
        print "```"
        delete also
        heading = ""
    }
    # Every command takes options.
    /^Usage:/ { sub(/ \[OPTIONS\]/, "") }
    /^## / { finish(); command = $2; order[++commands] = $2; print "\n" $0 "\n\n```text"; getline; next }
    /^(  -q, --quiet|  -v, --verbose|      --color|  -h, --help)/ { option(); skip = 1; next }
    /^(  |      )-/ { option(); skip = 0; name = $0; sub(/^ +/, "", name); block = $0 "\n"; next }
    /^[^ ]/ { option(); skip = 0; if (/:$/) { heading = $0 "\n"; next } }
    skip { next }
    block != "" { block = block $0 "\n"; next }
    { printf "%s", heading; heading = ""; print }
    END { finish() }' | cat -s
