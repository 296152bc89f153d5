//! Not a test: the last binary of `cargo test --workspace` prints which tests were skipped in part, and why.
// Without the test harness the compiler does not treat it as a test, so it gets none of the lint exceptions for tests.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

#[path = "../../tests/common/mod.rs"]
mod shared;

use std::collections::BTreeMap;

fn main() {
    // Other runners ask every binary for its list of tests.
    if std::env::args().any(|argument| argument == "--list") {
        return;
    }
    let text = std::fs::read_to_string(shared::skips()).unwrap_or_default();
    let _ = std::fs::remove_file(shared::skips());
    let mut tests: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for line in text.lines() {
        let (test, why) = line.trim_start_matches("skipped: ").split_once(": ").unwrap_or(("", line));
        tests.entry(why).or_default().push(test);
    }
    println!("\ntests that did not run whole: {}", tests.values().map(Vec::len).sum::<usize>());
    for (why, tests) in &tests {
        println!("  {}: {why}", tests.join(", "));
    }
}
