//! Runs the fuzz target of recordings on its corpus.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../../tests/common/corpus.rs"]
mod corpus;
#[path = "../../../fuzz/targets/recording.rs"]
mod recording;

#[test]
fn corpora() {
    corpus::replay("recording", recording::run);
}
