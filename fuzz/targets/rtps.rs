//! Other DDS participants take arbitrary steps: the participant sends only to addresses from which it received something, and what it
//! keeps is bounded. The body needs private items, so it is in `crates/ros2/src/rtps/participant/fuzzed.rs`; `cargo test` runs it.

pub use csi5300_ros2::fuzz_rtps as run;
