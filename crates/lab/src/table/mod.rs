//! Logs as tables in memory: a column for each field, and the CSI packed as the card sent it, decoded into arrays on demand.
//!
//! [`Reading`] reads a source through a [`Filter`] into an [`Arena`] and [`Columns`], once, whatever is asked of it then; [`decode`]
//! writes the CSI of any of its records into memory that the caller has. Exports and the Python package are made of it. [`Held`] is
//! a log as it is, read once to be a source any number of times.

mod arena;
mod block;
mod columns;
mod decode;
mod found;
mod piece;
mod plan;
mod reading;
mod turned;
mod whole;

pub use arena::Arena;
pub use columns::{Advise, Columns, NO_ANTENNA, NO_TIME, Widest, antenna_order, antennas};
pub(crate) use decode::{Decoder, Order, decode_in};
pub use decode::{Form, Rows, decode};
pub use piece::{Held, HeldSource};
pub use reading::{Filter, FilterError, Reading};

#[cfg(test)]
mod tests;
