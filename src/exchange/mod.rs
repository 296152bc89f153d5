//! The exchange of frames: who sends when, and which frames belong together. State machines without I/O.

pub mod assign;
pub mod pairing;
pub mod tdma;
