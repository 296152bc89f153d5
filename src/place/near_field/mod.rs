//! Positions from spherical waves.
//!
//! A trajectory of half a metre sees a transmitter four metres away with a curved wave front: 10 to 30 radians of phase
//! at its ends that a plane wave has to explain by a wrong bearing. Here the search is over places: azimuth, |elevation|
//! and range about the middle of the trajectory (the mean position of its samples). The curvature changes slowly with
//! range and the focus with height, so few of either suffice, and 1/range is what is sampled evenly.
//!
//! Sources and signs are those of [`crate::bartlett`]. Several views of the same motion are multiplied (the geometric
//! mean of their normalised powers): the round trip, coherent over the whole motion, is sharp and, in line of sight,
//! right; the one-way channel over windows summed in power is blunt, but has no sources that are not there and does
//! not mind when a path comes or goes. What all of them like is where the transmitter is.

mod aperture;
mod field;
mod fix;
mod focus;
mod grid;
mod maps;
mod paths;
mod prior;
mod search;
#[cfg(test)]
mod tests;
mod uncertainty;

pub use aperture::Aperture;
pub use field::{Taper, View};

pub use fix::{Fix, Source};
pub use focus::{Focus, Warp, focus};
pub use maps::Maps;
pub use paths::Path;
pub use search::{Limits, Search, search};
