//! Beyond the plane wave: places of transmitters (spherical waves) and of receivers, the probability of a bearing, and
//! places of peers carried from one motion to the next.

pub(crate) mod confidence;
pub mod locate;
pub mod near_field;
pub(crate) mod track;
