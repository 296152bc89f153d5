//! Limits of a survey's lists, and of a pause.

/// Losses kept with their place; further ones are only counted.
pub const LOSSES_KEPT: usize = 16;
/// Senders that are surveyed one by one, besides those [named](super::Survey::with_known). Noise and malice make up any
/// number of them: beyond this the one with the least evidence is forgotten for each that is new.
pub const SENDERS_KEPT: usize = 256;
/// Records this far apart on the card's clock, microseconds, have a pause between them.
pub const PAUSE_US: i64 = 1_000_000;
