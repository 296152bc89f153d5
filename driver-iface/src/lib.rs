//! The contract with the kernel driver: every byte that crosses the kernel or file boundary.
//!
//! Each format has a checked view (`new_checked` is the only door for foreign bytes; after it no accessor can fail), a small
//! value form, and `emit` next to the parser. Nothing here allocates, reads a clock or does I/O.
//!
//! | module | bytes |
//! |---|---|
//! | [`connector`] | a datagram of the kernel connector: nlmsghdr, cn_msg, then a [`record::Record`] |
//! | [`record`] | `.dat` logs: a sequence of a big-endian length and a record; [`record::Framer`] resynchronises after damage |
//! | [`side_file`] | `.datstp`, the host's receive times beside a `.dat` log |
//! | [`bfee`] | 0xBB, the CSI of one frame, stock and WSR layout |
//! | [`mpdu`] | 0xC1, the frame itself |
//! | [`sounding`], [`radiotap`] | injected frames |
//! | [`stock`] | the card's own packets under an unmodified driver, and the records made of them |
//!
//! All multi-byte fields are little-endian unless noted otherwise; the driver only runs on such hosts.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

#[cfg(test)]
extern crate std;

mod checksum;
#[cfg(test)]
mod errors_tests;
mod mac;

pub mod bfee;
pub mod connector;
pub mod mpdu;
pub mod radiotap;
pub mod record;
pub mod side_file;
pub mod sounding;
pub mod stock;

pub use mac::{Mac, ParseMacError};

use core::fmt;

/// Why a value cannot be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EmitError {
    /// The buffer is too small.
    Buffer {
        /// Bytes needed.
        need: usize,
        /// Bytes available.
        got: usize,
    },
    /// A value does not fit its field.
    Field {
        /// The field, by its name in the format.
        name: &'static str,
        /// Its value.
        got: usize,
        /// The field's largest value.
        max: usize,
    },
    /// The number of I/Q samples is not `30 n_rx n_tx`.
    Samples {
        /// Samples needed.
        expect: usize,
        /// Samples given.
        got: usize,
    },
}

impl fmt::Display for EmitError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Buffer { need, got } => write!(f, "{need} bytes are needed, the buffer has {got}"),
            Self::Field { name, got, max } => write!(f, "{name} is {got}, it can hold at most {max}"),
            Self::Samples { expect, got } => write!(f, "{got} I/Q samples, 30 n_rx n_tx = {expect} are needed"),
        }
    }
}

impl core::error::Error for EmitError {}

/// The first `need` bytes of `out`, or an error with the missing number.
pub(crate) fn room(out: &mut [u8], need: usize) -> Result<&mut [u8], EmitError> {
    let got = out.len();
    out.get_mut(..need).ok_or(EmitError::Buffer { need, got })
}
