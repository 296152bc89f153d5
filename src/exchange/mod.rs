//! The exchange of frames: who sends when, and which frames belong together. State machines without I/O.

pub(crate) mod admission;
pub(crate) mod kinship;
pub mod pairing;
pub mod tdma;

// Public for the tests of this workspace, no part of the library's interface.
#[doc(hidden)]
pub mod assign;
