//! Beyond the plane wave: places of transmitters and of receivers, and how sure.

pub mod confidence;
pub mod locate;
pub mod near_field;
