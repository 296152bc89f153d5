//! Places of receivers and transmitters from several bearings: at once, and carried from one motion to the next.

pub mod locate;
pub(crate) mod track;
