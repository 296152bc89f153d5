//! Words that pictures, pages and commands have in common.

pub use csi5300_say::{count, fixed};
