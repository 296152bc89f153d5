//! Positions from spherical waves.
//!
//! A trajectory of half a metre sees a transmitter four metres away with a curved wave front: 10 to 30 radians of phase
//! at its ends that a plane wave has to explain by a wrong bearing. Here the search is over places: azimuth, elevation
//! (|elevation| where level motion does not distinguish up from down) and range about the middle of the trajectory (the mean position of its samples). The curvature changes slowly with
//! range and the focus with height, so few of either suffice, and 1/range is what is sampled evenly.
//!
//! Sources and signs are those of [`crate::bartlett`]. What is maximised is the joint power: the geometric mean of the
//! normalised powers of several views of the same motion. The round trip, coherent over the whole motion, has the
//! narrowest beam, and products of paths in it; the one-way channel over windows summed in power has wider beams, no
//! products of paths, and does not need a path to last for the whole motion.
//!
//! ```text
//!   Aperture (round trip)      Aperture (one way)         rows of subcarriers, and where they were taken
//!     | View, View               | View, View, View       windows, taper, band, weight
//!     v                          v
//!   PreparedAperture           PreparedAperture           positions in turns; BendPolynomial for rough powers
//!     PreparedView               PreparedView             its windows, and the power of a perfect match
//!       Window                     Window                 weighted columns, three abreast
//!     |                          |
//!     +------------+-------------+
//!                  |   Place: azimuth, elevation, 1 / range
//!                  v
//!   kernel::powers(apertures, places, Precision)          one power for each view and place
//!                  |   sum weight ln power = score
//!                  v
//!   Search   scan:  grid of Axes  -> peaks by evidence (prior)       Precision::Rough
//!            climb: peaks         -> tops                            Rough, the answer's Exact
//!            polish or weigh the answer (likeliest, prior)
//!                  |
//!                  v
//!   Fix: Sources, Deviations      beside it: Search::paths (waves one by one), Search::maps (pictures),
//!                                 focus (one Warp of the trajectory for several searches)
//! ```
//!
//! Files depend on those above them only: `types`, `aperture`, `bend`; `prepared`; `kernel`; `grid`, `prior`, `fix`,
//! `waves`, `uncertainty` and `likeliest`; `search` with `scan`, `thin`, `climb` and `mirror`; `one_wave`, `paths`, `maps`, `focus`.

pub(crate) mod aperture;
mod bend;
mod climb;
pub(crate) mod cost;
mod fix;
mod focus;
mod grid;
mod kernel;
mod likeliest;
mod maps;
pub(crate) mod mirror;
pub(crate) mod one_wave;
mod paths;
mod prepared;
mod prior;
mod scan;
pub(crate) mod search;
#[cfg(test)]
mod tests;
mod thin;
pub(crate) mod types;
mod uncertainty;
mod waves;

pub(crate) use aperture::Aperture;
pub use fix::{Deviations, Edge, Fix, Source};
pub use focus::Focus;
pub(crate) use focus::focus;
pub(crate) use grid::is_searchable;
pub use maps::{Evidence, Maps};
pub use one_wave::Unexplained;
pub use paths::Path;
pub(crate) use search::Search;
pub use types::Warp;
pub(crate) use types::{Elevations, Limits, View, one_way_views, round_trip_views};
