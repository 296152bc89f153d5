#!/usr/bin/env bash
# The oldest compiler that Cargo.toml declares (`rust-version`) builds the library and the program.
# 77: there is no rustup here, or it cannot download that compiler.
set -euo pipefail
cd "$(dirname "$0")/../.."
oldest=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml)
command -v rustup >/dev/null || { echo "no rustup here: the compiler $oldest cannot be tried"; exit 77; }
if ! rustup run "$oldest" rustc --version >/dev/null 2>&1; then
    said=$(timeout 600 rustup toolchain install "$oldest" --profile minimal --no-self-update 2>&1) || {
        printf 'the compiler %s cannot be installed: %s\n' "$oldest" "$(tail -n 1 <<<"$said")"
        exit 77
    }
fi
# `--locked`: the tested versions; a separate target folder, because two compilers share nothing.
rustup run "$oldest" cargo check --quiet --locked --workspace --target-dir target/msrv
printf 'rust %s builds it\n' "$oldest"
