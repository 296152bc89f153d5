//! Words that pictures, pages and commands have in common.

pub use csi5300_say::{count, fixed};

/// What of many is looked at: `one pair in 2`.
#[must_use]
pub fn one_in(every: usize, one: &str) -> String {
    format!("one {one} in {every}")
}
