#!/usr/bin/env bash
# Mutates the changed lines of scheduler, pairing, recorder, senders, keys and driver-iface one by one, and prints the changes that no test notices.
# Since: CSI5300_MUTANTS_SINCE=COMMIT, else where this branch left the default one, else (on it) the previous commit.
# Ends after CSI5300_MUTANTS_MINUTES (4), whatever was tried by then. Fails only with CSI5300_MUTANTS=deny, because an equivalent change survives
# too until .cargo/mutants.toml lists it. Time never causes a failure: a test that takes too long counts as one that noticed.
set -euo pipefail
cd "$(dirname "$0")/../.."
[ -x target/tools/bin/cargo-mutants ] || command -v cargo-mutants >/dev/null || {
    echo "cargo-mutants is not installed; building it takes longer than this check may: cargo install --locked cargo-mutants"
    exit 77
}
git rev-parse --verify --quiet HEAD >/dev/null || { echo "no history to compare with"; exit 77; }
since=${CSI5300_MUTANTS_SINCE:-}
if [ -z "$since" ]; then
    for default in refs/remotes/origin/HEAD refs/heads/main; do
        since=$(git merge-base HEAD "$default" 2>/dev/null) && break
    done
    [ "$since" != "$(git rev-parse HEAD)" ] || since=
    # The first commit of a history, or of a shallow clone, has no predecessor.
    since=${since:-$(git rev-parse --verify --quiet 'HEAD~1' || true)}
fi
[ -n "$since" ] || { echo "no commit before this one"; exit 77; }
git rev-parse --verify --quiet "$since^{commit}" >/dev/null || { echo "CSI5300_MUTANTS_SINCE: $since is not a commit here" >&2; exit 1; }
# Other steps have built most crates; only changed ones are built again.
export CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$PWD/target}
minutes=${CSI5300_MUTANTS_MINUTES:-4}
echo "changes since $(git log -1 --format='%h %s' "$since"), $minutes minutes at most"
status=0
scripts/mutants.sh --since "$since" --minutes "$minutes" || status=$?
case $status in
    0) ;;
    2)
        cat target/mutants/*/mutants.out/missed.txt
        echo "no test notices these changes: add one, or name the change with its reason in .cargo/mutants.toml"
        [ "${CSI5300_MUTANTS:-}" != deny ] || exit 1
        ;;
    *) exit "$status" ;;
esac
