//! Logs as tables in memory: a column per field, and the CSI packed as the card sent it, decoded into arrays on demand.
//!
//! [`Reading`] reads a source once through a [`Filter`] into an [`Arena`] and [`Columns`]; [`decode`] writes the CSI of
//! any of its records into the caller's memory. Exports, pictures of logs, the page and the Python package use it.
//! [`Held`] is a log in memory that can be read any number of times.

mod again;
mod columns;
mod decode;
mod memory;
mod reading;
mod whole;

pub(crate) use again::LogReader;
pub use columns::{Advise, Columns, NO_ANTENNA, NO_TIME, Widest, antenna_order, antennas};
pub(crate) use decode::{Decoder, Order, decode_in};
pub use decode::{Form, Rows, decode};
pub use memory::{Arena, Held, HeldSource};
pub use reading::{Filter, FilterError, Reading};

#[cfg(test)]
mod tests;
