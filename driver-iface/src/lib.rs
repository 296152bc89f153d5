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

#[cfg(test)]
mod c_header;
mod checksum;

pub mod bfee;
pub mod connector;
pub mod mpdu;
pub mod radiotap;
pub mod record;
pub mod side_file;
pub mod sounding;
pub mod stock;

use core::fmt;
use core::str::FromStr;

/// A 48-bit MAC address, in transmission order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Mac(pub [u8; 6]);

impl Mac {
    /// All zeros: a WSR driver writes it for an unknown sender.
    pub const ZERO: Self = Self([0; 6]);

    /// True for 00:00:00:00:00:00.
    #[must_use]
    pub fn is_zero(self) -> bool {
        self == Self::ZERO
    }

    /// True for a group address (broadcast, multicast): it receives frames and sends none.
    #[must_use]
    pub fn is_group(self) -> bool {
        self.0[0] & 1 == 1
    }
}

impl fmt::Display for Mac {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c, d, e, g] = self.0;
        write!(f, "{a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{g:02x}")
    }
}

/// The text is not six hexadecimal octets with `:` or `-` between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParseMacError;

impl fmt::Display for ParseMacError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a MAC address is six hexadecimal octets like 00:21:6a:53:89:d2")
    }
}

impl core::error::Error for ParseMacError {}

impl FromStr for Mac {
    type Err = ParseMacError;

    fn from_str(text: &str) -> Result<Self, ParseMacError> {
        let mut octets = [0; 6];
        let mut parts = text.split([':', '-']);
        for octet in &mut octets {
            let part = parts.next().ok_or(ParseMacError)?;
            if part.is_empty() || part.len() > 2 || !part.bytes().all(|b| b.is_ascii_hexdigit()) {
                return Err(ParseMacError);
            }
            *octet = u8::from_str_radix(part, 16).map_err(|_| ParseMacError)?;
        }
        if parts.next().is_some() { Err(ParseMacError) } else { Ok(Self(octets)) }
    }
}

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

/// Writes `bytes` at an offset, if they fit.
pub(crate) fn put(out: &mut [u8], at: usize, bytes: &[u8]) {
    if let Some(place) = out.get_mut(at..at + bytes.len()) {
        place.copy_from_slice(bytes);
    }
}

/// The `N` bytes at an offset; zeros after the end.
#[inline]
pub(crate) fn array<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    bytes.get(at..).and_then(|rest| rest.first_chunk()).copied().unwrap_or([0; N])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bfee::{Antenna, InvalidPerm};
    use crate::record::Reason;
    use std::string::{String, ToString};

    /// True if a number stands alone in a text, not as part of a longer one.
    fn says(text: &str, number: &str) -> bool {
        text.split(|c: char| !c.is_ascii_alphanumeric()).any(|word| word == number)
    }

    /// Every error contains its numbers: the value read and the value expected.
    #[track_caller]
    fn holds(error: impl ToString, numbers: &[&str]) {
        let text: String = error.to_string();
        for number in numbers {
            assert!(says(&text, number), "{number} is not in: {text}");
        }
        assert!(text.split(' ').count() >= 3, "{text}");
    }

    #[test]
    fn errors_of_emit() {
        holds(EmitError::Buffer { need: 31, got: 17 }, &["31", "17"]);
        holds(EmitError::Field { name: "length", got: 70_001, max: 65_535 }, &["length", "70001", "65535"]);
        holds(EmitError::Samples { expect: 270, got: 90 }, &["270", "90"]);
    }

    #[test]
    fn of_records() {
        holds(bfee::Error::Short { got: 7 }, &["7", "20"]);
        holds(bfee::Error::Chains { n_rx: 4, n_tx: 9 }, &["4", "9"]);
        holds(bfee::Error::CsiLength { expect: 72, got: 71 }, &["72", "71"]);
        holds(bfee::Error::BodyLength { csi: 72, got: 99 }, &["99", "72", "92", "110", "106"]);
        holds(InvalidPerm { antenna_sel: 0x39, n_rx: 0 }, &["0x39", "0", "1", "2", "3"]);
        holds(Reason::ZeroLength, &["0"]);
        holds(Reason::ImpossibleLength { got: 9_000, max: 8_192 }, &["9000", "8192"]);
        holds(Reason::BfeeLength { got: 77 }, &["77"]);
        holds(Reason::Bfee(bfee::Error::Short { got: 7 }), &["7", "20"]);
        holds(Reason::Overlapped { expect: 215, got: 100 }, &["215", "100"]);
        holds(Reason::GapBits, &["bits"]);
        holds(Reason::NotFollowed { code: 0xD1, expect: 40 }, &["0xd1", "40"]);
        holds(Reason::Checksum, &["checksum"]);
        holds(Reason::StillLost, &["still"]);
    }

    #[test]
    fn errors_of_datagrams() {
        holds(connector::Error::Short { need: 36, got: 12 }, &["36", "12"]);
        holds(connector::Error::MessageLength { nlmsg_len: 500, received: 90 }, &["500", "90", "36"]);
        holds(connector::Error::MessageType { got: 2 }, &["2", "3"]);
        holds(connector::Error::DataLength { len: 700, left: 50 }, &["700", "50"]);
    }

    #[test]
    fn of_frames() {
        holds(radiotap::Error::Length { expect: 25, got: 8 }, &["25", "8"]);
        holds(radiotap::Error::Version(3), &["3", "0"]);
        holds(radiotap::Error::HeaderLength(5), &["5", "8"]);
        holds(ParseMacError, &["six"]);
        assert_eq!([Antenna::A, Antenna::B, Antenna::C].map(|antenna| antenna.to_string()), ["A", "B", "C"]);
    }

    #[test]
    fn text_and_back() {
        let mac: Mac = "00:21:6A:53-89:d2".parse().unwrap();
        assert_eq!(mac, Mac([0x00, 0x21, 0x6a, 0x53, 0x89, 0xd2]));
        assert_eq!(mac.to_string(), "00:21:6a:53:89:d2");
        assert_eq!("0:1:2:3:4:5".parse(), Ok(Mac([0, 1, 2, 3, 4, 5])));
        for bad in [
            "",
            "00:21:6a:53:89",
            "00:21:6a:53:89:d2:00",
            "00:21:6a:53:89:1d2",
            "00:21:6a:53:89:0d2",
            "00:+1:6a:53:89:d2",
            "::::::",
        ] {
            assert_eq!(bad.parse::<Mac>(), Err(ParseMacError), "{bad}");
        }
    }

    #[test]
    fn one_address_is_zero() {
        assert!(Mac::default().is_zero());
        (0..6).for_each(|at| {
            let mut mac = Mac::default();
            mac.0[at] = 1;
            assert!(!mac.is_zero());
        });
    }
}
