//! The 0xBB record: beamforming feedback, the CSI of one received frame.
//!
//! Three layouts exist. The stock csitool driver writes a 20-byte header and the packed CSI. The WSR driver of 2021 puts 14
//! bytes between them (host time, sender), later ones 18 (a frame number, too). `len` is the number of CSI bytes in every
//! layout, so the lengths distinguish them: `body - 20 - len` is 0, 14 or 18.
//!
//! Bytes after the CSI are separate ([`Bfee::behind_csi`]), because other readers ignore them: netlink pads a datagram to four
//! bytes, and a logger may write the padding. The zero bits between the samples identify such a body.
//!
//! Field offsets are those of `struct iwl_bfee_notif` (csitool `netlink/bfee.h`; WSR `dvm/commands.h`), little-endian.

mod antennas;
mod repr;
mod unpack;

pub use antennas::{Antenna, Antennas, InvalidPerm};
pub use repr::Repr;
pub use unpack::{ALL_SUBCARRIERS, Iq, MAX_SAMPLE_BYTES, MAX_SAMPLES};

use byteorder::{ByteOrder, LittleEndian};
use core::fmt;

use crate::Mac;

/// Subcarriers that the card reports, whatever the bandwidth (802.11n-2009 7.3.1.28: Ng = 2 at 20 MHz, 4 at 40 MHz).
pub const SUBCARRIERS: usize = 30;
/// Bytes before the CSI in the stock layout.
pub const STOCK_HEADER: usize = 20;
/// Bytes that the WSR driver adds after the stock header.
pub const WSR_EXTRA: usize = 18;
/// Bytes that the WSR driver of 2021 adds after the stock header: without the frame number.
pub const WSR_2021_EXTRA: usize = 14;
/// Bytes before the CSI in the WSR layout of 2021.
pub const WSR_2021_HEADER: usize = STOCK_HEADER + WSR_2021_EXTRA;
/// Bytes before the CSI in the WSR layout.
pub const WSR_HEADER: usize = STOCK_HEADER + WSR_EXTRA;
/// The longest body: WSR header and 3x3 CSI.
pub const MAX_BODY: usize = WSR_HEADER + 552;
/// Value of `noise` if the driver has no measurement (IWL_NOISE_MEAS_NOT_AVAILABLE): always the case without beacons.
pub const NOISE_UNKNOWN_DBM: i8 = -127;

/// Offsets of the fields in the body (without the code byte). In a `.dat` log add 3, in a datagram 37.
pub mod offset {
    /// u32, microseconds.
    pub const TIMESTAMP_LOW: usize = 0;
    /// u16, wraps.
    pub const BFEE_COUNT: usize = 4;
    /// u16, firmware leftovers.
    pub const RESERVED: usize = 6;
    /// u8, 1 to 3.
    pub const N_RX: usize = 8;
    /// u8, 1 to 3.
    pub const N_TX: usize = 9;
    /// u8 each for antennas A, B, C.
    pub const RSSI: usize = 10;
    /// i8, dBm.
    pub const NOISE: usize = 13;
    /// u8, dB.
    pub const AGC: usize = 14;
    /// u8, three 2-bit antenna numbers.
    pub const ANTENNA_SEL: usize = 15;
    /// u16, bytes of packed CSI.
    pub const LEN: usize = 16;
    /// u16.
    pub const RATE_N_FLAGS: usize = 18;
    /// u32, WSR layouts only.
    pub const TV_SEC: usize = 20;
    /// u32, WSR layouts only.
    pub const TV_USEC: usize = 24;
    /// 6 bytes, WSR layouts only.
    pub const MAC: usize = 28;
    /// u32, WSR layout only, not that of 2021.
    pub const FRAME_COUNT: usize = 34;
}

/// Bits of [`Bfee::rate_n_flags`] (`dvm/commands.h`, RATE_MCS_*); the driver keeps the low 14.
pub mod rate {
    /// HT frame; always set if there is CSI.
    pub const HT: u16 = 0x0100;
    /// CCK.
    pub const CCK: u16 = 0x0200;
    /// Greenfield preamble.
    pub const GREENFIELD: u16 = 0x0400;
    /// 40 MHz wide.
    pub const HT40: u16 = 0x0800;
    /// Duplicate of a 20 MHz frame on both halves.
    pub const DUPLICATE: u16 = 0x1000;
    /// Short guard interval.
    pub const SHORT_GI: u16 = 0x2000;
}

/// Bytes of packed CSI for `n_rx` by `n_tx` chains: 30 groups of 3 + 16 n bits, rounded up (`60 n + 12`).
#[must_use]
pub const fn csi_len(n_rx: u8, n_tx: u8) -> usize {
    60 * n_rx as usize * n_tx as usize + 12
}

/// The driver that wrote the record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Layout {
    /// csitool: 20-byte header.
    Stock,
    /// WSR of 2021: 34-byte header with host time and sender.
    Wsr2021,
    /// WSR: 38-byte header with host time, sender and frame number.
    Wsr,
}

impl Layout {
    /// Bytes before the CSI.
    #[must_use]
    pub const fn header_len(self) -> usize {
        match self {
            Self::Stock => STOCK_HEADER,
            Self::Wsr2021 => WSR_2021_HEADER,
            Self::Wsr => WSR_HEADER,
        }
    }
}

/// Fields that the WSR driver adds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Wsr {
    /// Host wall clock when the record was handled, seconds; steps when the clock is set.
    pub tv_sec: u32,
    /// Microseconds of it.
    pub tv_usec: u32,
    /// Address 3 of the last good frame: its sender.
    ///
    /// The driver clears it if `frame_count` is 0, so zero with count 0 means "unknown". After a frame with a bad checksum both
    /// still show the previous frame.
    pub mac: Mac,
    /// The four bytes after the 802.11 header, read big-endian: the sounding counter, or anything in foreign frames. `None` in the
    /// layout of 2021.
    pub frame_count: Option<u32>,
}

impl Wsr {
    /// False when the driver did not know the sender ([`Wsr::mac`]).
    #[must_use]
    pub fn sender_known(&self) -> bool {
        !(self.mac.is_zero() && self.frame_count.is_none_or(|number| number == 0))
    }
}

/// Why a body is not a bfee.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// Shorter than the header.
    Short {
        /// Bytes of the body.
        got: usize,
    },
    /// `n_rx` or `n_tx` is not 1 to 3.
    Chains {
        /// Receive chains as read.
        n_rx: u8,
        /// Space-time streams as read.
        n_tx: u8,
    },
    /// `len` does not match the chains.
    CsiLength {
        /// `60 n_rx n_tx + 12`.
        expect: usize,
        /// The field as read.
        got: usize,
    },
    /// The body is too short for its CSI, or longer than in any layout.
    BodyLength {
        /// Bytes of CSI.
        csi: usize,
        /// Bytes of the body.
        got: usize,
    },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Short { got } => write!(f, "bfee of {got} bytes, its header needs {STOCK_HEADER}"),
            Self::Chains { n_rx, n_tx } => write!(f, "bfee with n_rx {n_rx}, n_tx {n_tx}; both must be 1 to 3"),
            Self::CsiLength { expect, got } => write!(f, "bfee says {got} bytes of CSI, its chains need {expect}"),
            Self::BodyLength { csi, got } => write!(
                f,
                "bfee of {got} bytes with {csi} of CSI: neither stock ({}) nor WSR ({}, or {} as in 2021)",
                csi + STOCK_HEADER,
                csi + WSR_HEADER,
                csi + WSR_2021_HEADER
            ),
        }
    }
}

impl core::error::Error for Error {}

/// A checked view of a bfee body.
///
/// CSI indices are `subcarrier` 0 to 29, `rx` the raw chain (not the antenna, see [`Bfee::antennas`]), `tx` the space-time
/// stream; in the payload tx varies fastest, then rx, then the subcarrier.
#[derive(Clone, Copy, Debug)]
pub struct Bfee<'a> {
    head: &'a [u8; STOCK_HEADER],
    extra: &'a [u8],
    payload: &'a [u8],
    behind: &'a [u8],
}

/// Checks the header against the length of a body that ends with its CSI.
#[inline]
pub(crate) fn check(head: &[u8; STOCK_HEADER], body_len: usize) -> Result<Layout, Error> {
    let [n_rx, n_tx] = [head[offset::N_RX], head[offset::N_TX]];
    if !(1..=3).contains(&n_rx) || !(1..=3).contains(&n_tx) {
        return Err(Error::Chains { n_rx, n_tx });
    }
    let expect = csi_len(n_rx, n_tx);
    let got = usize::from(u16::from_le_bytes([head[offset::LEN], head[offset::LEN + 1]]));
    if got != expect {
        return Err(Error::CsiLength { expect, got });
    }
    match body_len.checked_sub(expect) {
        Some(STOCK_HEADER) => Ok(Layout::Stock),
        Some(WSR_2021_HEADER) => Ok(Layout::Wsr2021),
        Some(WSR_HEADER) => Ok(Layout::Wsr),
        _ => Err(Error::BodyLength { csi: expect, got: body_len }),
    }
}

impl<'a> Bfee<'a> {
    /// Checks a body (without the code byte). It may continue after its CSI, see [`Bfee::behind_csi`].
    ///
    /// # Errors
    /// If the body is too short, the chains are not 1 to 3, or the lengths disagree.
    pub fn new_checked(body: &'a [u8]) -> Result<Self, Error> {
        let short = Error::Short { got: body.len() };
        let (head, rest) = body.split_first_chunk::<STOCK_HEADER>().ok_or(short)?;
        match check(head, body.len()) {
            Ok(layout) => {
                let (extra, payload) = rest.split_at_checked(layout.header_len() - STOCK_HEADER).ok_or(short)?;
                Ok(Self { head, extra, payload, behind: &[] })
            }
            Err(error @ Error::BodyLength { csi, .. }) => Self::longer(head, rest, csi).ok_or(error),
            Err(error) => Err(error),
        }
    }

    /// A body that continues after its CSI: the first layout that fits and in which the bits between the samples are 0, or stock, as
    /// csitool's readers assume.
    #[cold]
    fn longer(head: &'a [u8; STOCK_HEADER], rest: &'a [u8], csi: usize) -> Option<Self> {
        let as_layout = |layout: Layout| {
            let (extra, rest) = rest.split_at_checked(layout.header_len() - STOCK_HEADER)?;
            let (payload, behind) = rest.split_at_checked(csi)?;
            Some(Self { head, extra, payload, behind })
        };
        let layouts = [Layout::Stock, Layout::Wsr2021, Layout::Wsr];
        layouts.into_iter().filter_map(as_layout).find(Self::gaps_are_clear).or_else(|| as_layout(Layout::Stock))
    }

    fn u16_at(&self, at: usize) -> u16 {
        self.head.get(at..).map_or(0, LittleEndian::read_u16)
    }

    /// The driver that wrote it.
    #[must_use]
    pub fn layout(&self) -> Layout {
        match self.extra.len() {
            WSR_EXTRA => Layout::Wsr,
            WSR_2021_EXTRA => Layout::Wsr2021,
            _ => Layout::Stock,
        }
    }

    /// Low 32 bits of the card's 1 MHz clock when the frame began, microseconds; wraps every 4,294.967296 s.
    #[must_use]
    pub fn timestamp_low(&self) -> u32 {
        LittleEndian::read_u32(self.head)
    }

    /// The driver's record counter; wraps after 65,535.
    #[must_use]
    pub fn bfee_count(&self) -> u16 {
        self.u16_at(offset::BFEE_COUNT)
    }

    /// Reserved by the firmware; 0 in all known captures.
    #[must_use]
    pub fn reserved(&self) -> u16 {
        self.u16_at(offset::RESERVED)
    }

    /// Receive chains used, 1 to 3.
    #[must_use]
    #[doc(alias = "Nrx")]
    pub fn n_rx(&self) -> usize {
        usize::from(self.head[offset::N_RX])
    }

    /// Space-time streams, 1 to 3 (not transmit antennas).
    #[must_use]
    #[doc(alias = "Ntx")]
    pub fn n_tx(&self) -> usize {
        usize::from(self.head[offset::N_TX])
    }

    /// RSSI of antennas A, B, C in dB above an internal reference; 0 for an unused antenna. Never permuted.
    #[must_use]
    pub fn rssi(&self) -> [u8; 3] {
        [self.head[offset::RSSI], self.head[offset::RSSI + 1], self.head[offset::RSSI + 2]]
    }

    /// Noise floor in dBm, or [`NOISE_UNKNOWN_DBM`].
    #[must_use]
    pub fn noise_dbm(&self) -> i8 {
        self.head[offset::NOISE].cast_signed()
    }

    /// Receiver gain, dB.
    #[must_use]
    pub fn agc(&self) -> u8 {
        self.head[offset::AGC]
    }

    /// The antenna of each chain, packed; [`Bfee::antennas`] decodes it.
    #[must_use]
    pub fn antenna_sel(&self) -> u8 {
        self.head[offset::ANTENNA_SEL]
    }

    /// Rate and flags of the frame, see [`rate`].
    #[must_use]
    #[doc(alias = "fake_rate_n_flags")]
    pub fn rate_n_flags(&self) -> u16 {
        self.u16_at(offset::RATE_N_FLAGS)
    }

    /// True for a 40 MHz frame.
    #[must_use]
    pub fn is_40_mhz(&self) -> bool {
        self.rate_n_flags() & rate::HT40 != 0
    }

    /// Host time, sender and frame number, in the WSR layouts.
    #[must_use]
    #[inline]
    pub fn wsr(&self) -> Option<Wsr> {
        let (host_and_sender, number) = self.extra.split_first_chunk::<WSR_2021_EXTRA>()?;
        let [s0, s1, s2, s3, u0, u1, u2, u3, m0, m1, m2, m3, m4, m5] = *host_and_sender;
        Some(Wsr {
            tv_sec: u32::from_le_bytes([s0, s1, s2, s3]),
            tv_usec: u32::from_le_bytes([u0, u1, u2, u3]),
            mac: Mac([m0, m1, m2, m3, m4, m5]),
            frame_count: number.first_chunk().map(|number| u32::from_le_bytes(*number)),
        })
    }

    /// The packed CSI, `60 n_rx n_tx + 12` bytes.
    #[must_use]
    pub fn payload(&self) -> &'a [u8] {
        self.payload
    }

    /// Bytes after the CSI: none as a driver writes it, padding if a logger wrote whole datagrams.
    #[must_use]
    pub fn behind_csi(&self) -> &'a [u8] {
        self.behind
    }

    /// The antenna of each raw chain.
    ///
    /// # Errors
    /// [`InvalidPerm`], see [`Antennas::new`].
    #[inline]
    pub fn antennas(&self) -> Result<Antennas, InvalidPerm> {
        Antennas::new(self.antenna_sel(), self.head[offset::N_RX], self.rssi())
    }

    /// The raw chain of an antenna; `None` if it was not used or the permutation is invalid.
    #[must_use]
    #[inline]
    pub fn chain_of(&self, antenna: Antenna) -> Option<usize> {
        self.antennas().ok()?.chain_of(antenna)
    }
}

#[cfg(test)]
mod planes_tests;
#[cfg(test)]
mod tests;
