//! The product of a forward and a backward frame.

use super::centre::{centre, slope};
use crate::signal::channel::SUBCARRIERS;
use crate::signal::samples::Coherent;
use num_complex::Complex32;

/// The round trip of one antenna pair: `forward[k] * backward[k]`, no conjugate, so the path is in it twice and the
/// CFO, which has opposite signs, cancels \[paper\] \[wsr\].
#[must_use]
fn round_trip(forward: &[Complex32; SUBCARRIERS], backward: &[Complex32; SUBCARRIERS]) -> [Complex32; SUBCARRIERS] {
    std::array::from_fn(|k| forward[k] * backward[k])
}

/// The round trip at the channel centre: [`at_centre`](super::at_centre) of the product, with the slopes of the two directions removed
/// one by one.
///
/// Path and radios together turn one direction by about 0.8 rad from one reported subcarrier to the next and the product
/// by twice that (measured); taken one by one the slopes stay unambiguous up to 800 ns each way (about 180 m of path).
/// `None` if one of them is all zero.
#[must_use]
pub fn round_trip_at_centre(
    forward: &[Complex32; SUBCARRIERS],
    backward: &[Complex32; SUBCARRIERS],
    indices: &[i8; SUBCARRIERS],
) -> Option<Coherent> {
    let slope = slope(forward, indices) + slope(backward, indices);
    let h = centre(&round_trip(forward, backward), indices, slope)?;
    Some(Coherent { h, path_gain: 2 })
}
