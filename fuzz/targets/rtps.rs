//! Any steps of others at a participant of DDS: it speaks to nobody from whom nothing came, and what it keeps is bounded. The
//! body is beside what it looks into, `crates/ros2/src/rtps/participant/fuzzed.rs`, and runs there in `cargo test`.

pub use csi5300_ros2::fuzz_rtps as run;
