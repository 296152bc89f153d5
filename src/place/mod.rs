//! Beyond the plane wave: places of transmitters (spherical waves) and of receivers, and the probability of a bearing.

pub(crate) mod confidence;
pub mod locate;
pub mod near_field;
