//! Logs as tables in memory: a column for each field, and the CSI packed as the card sent it, decoded into arrays on demand.
//!
//! [`Reading`] reads a source through a [`Filter`] into an [`Arena`] and [`Columns`], once, whatever is asked of it then; [`decode`]
//! writes the CSI of any of its records into memory that the caller has. Exports and the Python package are made of it.

mod arena;
mod columns;
mod decode;
mod reading;

pub use arena::Arena;
pub use columns::{Columns, NO_ANTENNA, NO_TIME, antenna_order, antennas};
pub use decode::{Form, Rows, decode};
pub use reading::{Filter, FilterError, Reading};

#[cfg(test)]
mod tests;
