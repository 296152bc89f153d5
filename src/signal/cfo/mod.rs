//! From two CSI vectors to one coherent sample: the round-trip product, the channel centre, and what the product
//! leaves of the carrier frequency offset (CFO).
//!
//! With the forward frame heard at `t` and the backward one at `t + tau`, the product of the two CSI vectors holds the
//! path twice and the CFO only as `2 pi df tau`. `df tau` would be a constant, were it not that the turn-around `tau`
//! jitters by microseconds to hundreds of them: at `df` of several kHz that is most of the phase noise left.
//! Both cards' 1 MHz clocks (`timestamp_low`) measure the jitter, so it can be removed again.
//!
//! Convention: `z * exp(+j 2 pi df d)`, with `d = clock_tx - clock_rx` less the drift `df / carrier`. The drift has the same
//! crystals behind it as `df`: `df ~ drift * carrier` to within about 1 kHz while the turn-around itself is steady
//! (measured on the captures of \[paper\] and \[wsr\]).
//!
//! `round_trip` multiplies the two directions, `centre` brings the product to the channel's centre, `abreast` does both for
//! many pairs at once; `drift_line` fits the drift of one card's clock against the other's, `turn_around` estimates `df` and
//! takes it out, `offset` is the search for it.

mod abreast;
mod centre;
pub(crate) mod drift_line;
mod offset;
mod round_trip;
#[cfg(test)]
mod tests;
mod turn_around;

pub(crate) use abreast::{Heard, round_trips_at_centre};
pub use centre::at_centre;
pub use round_trip::round_trip_at_centre;
pub use turn_around::TurnAround;
