//! Words that pictures, pages and commands share.

pub use csi5300_say::{count, fixed};
