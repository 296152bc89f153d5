//! Places of transmitters from several bearings, carried from one motion to the next.

pub(crate) mod track;
