//! No code: see the crate's manifest.
