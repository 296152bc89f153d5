//! Sounding frames: what robots inject to measure the channel between them, in two dialects.
//!
//! Both are 802.11 data frames outside any network, shaped so that a stock CSI driver reports their CSI and a WSR driver logs their
//! sender and number:
//!
//! | offset | size | value |
//! |---|---|---|
//! | 0 | 2 | frame control, bytes `08 00`: data, no ToDS or FromDS |
//! | 2 | 2 | duration, `ff ff` as written; rewritten by mac80211 or the card |
//! | 4 | 6 | addr1: [`MAGIC_MAC`]; the firmware reports CSI for it, the driver applies `monitor_tx_rate` to it |
//! | 10 | 6 | addr2: [`MAGIC_MAC`]; another sender address gives no CSI at the receiver |
//! | 16 | 6 | addr3: the sender's own MAC, which WSR logs |
//! | 22 | 2 | sequence control, 0 and never filled in by mac80211 |
//! | 24 | 4 | **big-endian** frame number, which WSR logs as `frame_count` |
//! | 28 | .. | [`wsr`]: filler; [`native`]: destination, role, turn, slot, measurement, tag |
//!
//! The card appends 4 bytes of FCS, which no buffer here contains; the WSR lengths include it. Sources: WSR
//! `injection/random_packets.c`, driver `dvm/rx.c` and `dvm/tx.c`; field values of the stock sender from csiread's
//! `sample_0x5_64_3000.dat`.

pub mod native;
pub mod wsr;

use crate::Mac;
use byteorder::{BigEndian, ByteOrder};
use core::fmt;

/// addr1 and addr2 of every sounding frame (WSR `random_packets.c`; iwlwifi `dvm/sta.c`, `dvm/tx.c`).
pub const MAGIC_MAC: Mac = Mac([0x00, 0x16, 0xea, 0x12, 0x34, 0x56]);
/// Bytes of the 802.11 header (three addresses, no QoS).
pub const HEADER_LEN: usize = 24;
/// Bytes of the FCS that the card appends on air.
pub const FCS_LEN: usize = 4;
/// Bytes of the shortest sounding frame: header and number.
pub const MIN_LEN: usize = field::NUMBER + 4;

/// Offsets in the MPDU, common to both dialects.
mod field {
    pub(super) const FRAME_CONTROL: usize = 0;
    pub(super) const DURATION: usize = 2;
    pub(super) const ADDR1: usize = 4;
    pub(super) const ADDR2: usize = 10;
    pub(super) const ADDR3: usize = 16;
    pub(super) const NUMBER: usize = 24;
    pub(super) const BODY: usize = 28;
}

/// Frame control of a data frame outside any network, little-endian.
const FRAME_CONTROL: [u8; 2] = [0x08, 0x00];
/// Bits of the second frame control byte that make it another kind of frame: ToDS, FromDS, more fragments, protected.
const FLAGS_MUST_BE_CLEAR: u8 = 0x01 | 0x02 | 0x04 | 0x40;

/// Why bytes are not a sounding frame, or do not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// Too few bytes (or, for a frame of the native dialect, too many).
    Length {
        /// Bytes needed.
        expect: usize,
        /// Bytes available.
        got: usize,
    },
    /// Not a plain data frame; has the first two bytes.
    FrameControl([u8; 2]),
    /// addr1 is not [`MAGIC_MAC`].
    Receiver(Mac),
    /// The body does not begin with [`native::MAGIC`].
    Magic([u8; 3]),
    /// A native frame of a version other than [`native::VERSION`].
    Version(u8),
    /// A native frame with an unknown role.
    Role(u8),
    /// A native frame with unknown flags.
    Flags(u8),
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length { expect, got } => write!(f, "sounding frame of {got} bytes, {expect} needed"),
            Self::FrameControl([a, b]) => write!(f, "frame control {a:02x} {b:02x} is not a plain data frame (08 00)"),
            Self::Receiver(mac) => write!(f, "addr1 {mac} is not the magic MAC {MAGIC_MAC}"),
            Self::Magic(magic) => write!(f, "body begins with {magic:02x?}: not of the native dialect"),
            Self::Version(version) => {
                write!(f, "native dialect version {version}, this is {}; update the other robot", native::VERSION)
            }
            Self::Role(role) => write!(f, "role {role} is neither forward (0) nor backward (1)"),
            Self::Flags(flags) => write!(f, "flags {flags:#04x} hold bits that are not known"),
        }
    }
}

impl core::error::Error for Error {}

/// A frame with the shape of a sounding frame: data, magic MAC, a number. Checked once, then total.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    bytes: &'a [u8],
}

impl<'a> Frame<'a> {
    /// Checks an MPDU without FCS: length, frame control and addr1.
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::FrameControl`] or [`Error::Receiver`].
    pub fn new_checked(bytes: &'a [u8]) -> Result<Self, Error> {
        if bytes.len() < MIN_LEN {
            return Err(Error::Length { expect: MIN_LEN, got: bytes.len() });
        }
        let frame = Self { bytes };
        let control = frame.array(field::FRAME_CONTROL);
        if control[0] != FRAME_CONTROL[0] || control[1] & FLAGS_MUST_BE_CLEAR != 0 {
            return Err(Error::FrameControl(control));
        }
        let addr1 = Mac(frame.array(field::ADDR1));
        if addr1 != MAGIC_MAC { Err(Error::Receiver(addr1)) } else { Ok(frame) }
    }

    /// The `N` bytes at a fixed offset; zeros after the end, which callers have checked.
    fn array<const N: usize>(&self, at: usize) -> [u8; N] {
        self.bytes.get(at..).and_then(|rest| rest.first_chunk()).copied().unwrap_or([0; N])
    }

    /// addr2: [`MAGIC_MAC`] in frames whose CSI the receiver reports.
    #[must_use]
    pub fn addr2(&self) -> Mac {
        Mac(self.array(field::ADDR2))
    }

    /// addr3: the sender's own MAC.
    #[must_use]
    #[doc(alias = "addr3")]
    pub fn sender(&self) -> Mac {
        Mac(self.array(field::ADDR3))
    }

    /// The frame number.
    #[must_use]
    #[doc(alias = "frame_count")]
    pub fn number(&self) -> u32 {
        BigEndian::read_u32(&self.array::<4>(field::NUMBER))
    }

    /// Everything after the number.
    #[must_use]
    pub fn body(&self) -> &'a [u8] {
        self.bytes.get(field::BODY..).unwrap_or(&[])
    }

    /// The whole MPDU, without FCS.
    #[must_use]
    pub fn mpdu(&self) -> &'a [u8] {
        self.bytes
    }

    /// MPDU length **with** FCS, as WSR counts it (`byte_count`).
    #[must_use]
    pub fn len_with_fcs(&self) -> usize {
        self.bytes.len() + FCS_LEN
    }
}

/// Writes header and number at the start of `buffer` (at least [`MIN_LEN`] long; otherwise writes nothing).
fn emit_header(buffer: &mut [u8], sender: Mac, number: u32) {
    if let Some(header) = buffer.first_chunk_mut::<MIN_LEN>() {
        header.fill(0);
        put(header, field::FRAME_CONTROL, &FRAME_CONTROL);
        put(header, field::DURATION, &[0xff, 0xff]);
        put(header, field::ADDR1, &MAGIC_MAC.0);
        put(header, field::ADDR2, &MAGIC_MAC.0);
        put(header, field::ADDR3, &sender.0);
        put(header, field::NUMBER, &number.to_be_bytes());
    }
}

fn put(buffer: &mut [u8], at: usize, bytes: &[u8]) {
    if let Some(place) = buffer.get_mut(at..at + bytes.len()) {
        place.copy_from_slice(bytes);
    }
}
