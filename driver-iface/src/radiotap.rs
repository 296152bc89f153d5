//! Radiotap headers of injected and received frames.
//!
//! Layout (radiotap.org; Linux `include/net/ieee80211_radiotap.h`, `net/wireless/radiotap.c`): version 0, a pad byte,
//! the header's length as u16, one or more u32 words of presence bits (bit 31: another word follows), then the fields
//! in bit order, each aligned to its own alignment **counted from the start of the header**. All little-endian.
//!
//! [`Packet`] is the checked view of foreign bytes, [`Repr`] the value. Fields of the first radiotap namespace are read; repeats
//! for further antennas, vendor fields and unused fields are skipped by their size.

mod packet;

pub use packet::Packet;
use packet::walk;

use byteorder::{ByteOrder, LittleEndian};
use core::fmt;

/// Bytes of the smallest header: version, pad, length and one presence word.
pub const MIN_LEN: usize = 8;
/// Bytes that hold any header that [`Repr::emit`] writes.
pub const MAX_EMIT_LEN: usize = 48;

/// [`Repr::flags`]: the frame ends with its 4-byte FCS (`IEEE80211_RADIOTAP_F_FCS`).
pub const FLAGS_FCS: u8 = 0x10;
/// [`Repr::flags`]: the 802.11 header is padded to a multiple of 4 bytes (`IEEE80211_RADIOTAP_F_DATAPAD`).
pub const FLAGS_DATAPAD: u8 = 0x20;
/// [`Repr::flags`]: the FCS was wrong (`IEEE80211_RADIOTAP_F_BADFCS`).
pub const FLAGS_BAD_FCS: u8 = 0x40;
/// [`Repr::tx_flags`] of a sent frame: it failed (`IEEE80211_RADIOTAP_F_TX_FAIL`).
pub const TX_FLAGS_FAIL: u16 = 0x0001;
/// [`Repr::tx_flags`]: expect no acknowledgement (`IEEE80211_RADIOTAP_F_TX_NOACK`).
pub const TX_FLAGS_NO_ACK: u16 = 0x0008;

/// Offsets of the fixed part.
mod field {
    pub(super) const VERSION: usize = 0;
    pub(super) const LEN: usize = 2;
    pub(super) const PRESENT: usize = 4;
}

/// Presence bits with a meaning here.
mod bit {
    pub(super) const TSFT: u32 = 0;
    pub(super) const FLAGS: u32 = 1;
    pub(super) const RATE: u32 = 2;
    pub(super) const CHANNEL: u32 = 3;
    pub(super) const DBM_SIGNAL: u32 = 5;
    pub(super) const DBM_NOISE: u32 = 6;
    pub(super) const ANTENNA: u32 = 11;
    pub(super) const RX_FLAGS: u32 = 14;
    pub(super) const TX_FLAGS: u32 = 15;
    pub(super) const DATA_RETRIES: u32 = 17;
    pub(super) const MCS: u32 = 19;
    /// TLVs follow the fields; this crate reads none of them.
    pub(super) const TLV: u32 = 28;
    pub(super) const RADIOTAP_NAMESPACE: u32 = 29;
    pub(super) const VENDOR_NAMESPACE: u32 = 30;
    pub(super) const EXT: u32 = 31;
}

/// Alignment and size in bytes of the fields behind presence bits 0 to 27 (radiotap.org, "defined fields").
const FIELDS: [(usize, usize); 28] = [
    (8, 8),  // 0 TSFT
    (1, 1),  // 1 flags
    (1, 1),  // 2 rate
    (2, 4),  // 3 channel
    (2, 2),  // 4 FHSS
    (1, 1),  // 5 dBm antenna signal
    (1, 1),  // 6 dBm antenna noise
    (2, 2),  // 7 lock quality
    (2, 2),  // 8 TX attenuation
    (2, 2),  // 9 dB TX attenuation
    (1, 1),  // 10 dBm TX power
    (1, 1),  // 11 antenna
    (1, 1),  // 12 dB antenna signal
    (1, 1),  // 13 dB antenna noise
    (2, 2),  // 14 RX flags
    (2, 2),  // 15 TX flags
    (1, 1),  // 16 RTS retries
    (1, 1),  // 17 data retries
    (4, 8),  // 18 XChannel
    (1, 3),  // 19 MCS
    (4, 8),  // 20 A-MPDU status
    (2, 12), // 21 VHT
    (8, 12), // 22 timestamp
    (2, 12), // 23 HE
    (2, 12), // 24 HE-MU
    (2, 6),  // 25 HE-MU other user
    (1, 1),  // 26 zero-length PSDU
    (2, 4),  // 27 L-SIG
];

/// Why bytes are not a radiotap header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// The header, or an announced field, is longer than the buffer.
    Length {
        /// Bytes needed.
        expect: usize,
        /// Bytes available.
        got: usize,
    },
    /// A version other than 0.
    Version(u8),
    /// An announced header length shorter than the fixed part.
    HeaderLength(u16),
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length { expect, got } => write!(f, "radiotap header cut: {expect} bytes needed, {got} there"),
            Self::Version(version) => write!(f, "radiotap version {version}, only 0 is known; is it a radiotap link?"),
            Self::HeaderLength(len) => write!(f, "radiotap header length {len}, at least {MIN_LEN} needed"),
        }
    }
}

impl core::error::Error for Error {}

/// Channel of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Channel {
    /// Centre of the primary 20 MHz channel, MHz; 0 if the writer does not state it.
    pub freq_mhz: u16,
    /// `IEEE80211_CHAN_*` bits (0x0020 CCK, 0x0040 OFDM, 0x0080 2 GHz, 0x0100 5 GHz).
    pub flags: u16,
}

/// Channel width of an HT frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Bandwidth {
    /// 20 MHz.
    #[default]
    Ht20,
    /// 40 MHz.
    Ht40,
}

/// The MCS field: which parts are known, their values, the index.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mcs {
    /// `IEEE80211_RADIOTAP_MCS_HAVE_*`: 0x01 bandwidth, 0x02 index, 0x04 guard interval, 0x10 FEC, 0x20 STBC.
    pub known: u8,
    /// 0x03 bandwidth (0 20 MHz, 1 40 MHz, 2 20L, 3 20U), 0x04 short guard interval, 0x10 LDPC, 0x60 STBC streams.
    pub flags: u8,
    /// MCS index, 0 to 76 (802.11-2016 clause 19.5).
    pub index: u8,
}

impl Mcs {
    /// The field for injecting: bandwidth, index, long guard interval, BCC and no STBC, all marked as known (0x37).
    #[must_use]
    pub const fn injected(index: u8, bandwidth: Bandwidth) -> Self {
        let flags = match bandwidth {
            Bandwidth::Ht20 => 0,
            Bandwidth::Ht40 => 1,
        };
        Self { known: 0x37, flags, index }
    }

    /// The channel width, if the field contains it; 20L and 20U are 20 MHz wide.
    #[must_use]
    pub const fn bandwidth(&self) -> Option<Bandwidth> {
        match (self.known & 1, self.flags & 3) {
            (0, _) => None,
            (_, 1) => Some(Bandwidth::Ht40),
            _ => Some(Bandwidth::Ht20),
        }
    }
}

/// A radiotap header as a value. `None` is an absent field.
///
/// [`Repr::default`] is the 8-byte header without fields; the driver then chooses the rate (the CSI tool's driver:
/// `monitor_tx_rate`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Repr {
    /// MAC time of the first bit's arrival, microseconds.
    pub tsft_us: Option<u64>,
    /// `IEEE80211_RADIOTAP_F_*`, see [`FLAGS_FCS`].
    pub flags: Option<u8>,
    /// Legacy rate, 500 kb/s units.
    pub rate: Option<u8>,
    /// Channel.
    pub channel: Option<Channel>,
    /// Signal at the antenna, dBm.
    pub signal_dbm: Option<i8>,
    /// Noise at the antenna, dBm.
    pub noise_dbm: Option<i8>,
    /// Antenna number.
    pub antenna: Option<u8>,
    /// Properties of a received frame.
    pub rx_flags: Option<u16>,
    /// Properties of a frame to send, or of a sent one.
    pub tx_flags: Option<u16>,
    /// Retries of a sent frame.
    pub data_retries: Option<u8>,
    /// HT rate.
    pub mcs: Option<Mcs>,
}

impl Repr {
    /// For injecting an HT frame without acknowledgement: TX flags and MCS, 13 bytes.
    #[must_use]
    pub const fn injected(index: u8, bandwidth: Bandwidth) -> Self {
        Self { tx_flags: Some(TX_FLAGS_NO_ACK), mcs: Some(Mcs::injected(index, bandwidth)), ..Self::NONE }
    }

    /// The header that LORCON writes: flags 0, rate 0 (the default), the channel with flags 0; 14 bytes.
    #[must_use]
    #[doc(alias = "mac80211inject")]
    pub const fn lorcon(freq_mhz: u16) -> Self {
        Self { flags: Some(0), rate: Some(0), channel: Some(Channel { freq_mhz, flags: 0 }), ..Self::NONE }
    }

    const NONE: Self = Self {
        tsft_us: None,
        flags: None,
        rate: None,
        channel: None,
        signal_dbm: None,
        noise_dbm: None,
        antenna: None,
        rx_flags: None,
        tx_flags: None,
        data_retries: None,
        mcs: None,
    };

    /// True for a copy of a frame that this host sent: only those have TX flags or a retry count.
    ///
    /// Linux gives every monitor a tx-status copy of each sent frame, which `PACKET_IGNORE_OUTGOING` does not remove.
    #[must_use]
    pub const fn is_own_echo(&self) -> bool {
        self.tx_flags.is_some() || self.data_retries.is_some()
    }

    /// True if the frame after the header ends with an FCS.
    #[must_use]
    pub fn has_fcs(&self) -> bool {
        self.flags.is_some_and(|flags| flags & FLAGS_FCS != 0)
    }

    /// True if the receiver found a wrong FCS.
    #[must_use]
    pub fn is_bad_fcs(&self) -> bool {
        self.flags.is_some_and(|flags| flags & FLAGS_BAD_FCS != 0)
    }

    /// Parses a checked header.
    ///
    /// # Errors
    /// [`Error::Length`] if an announced field exceeds the header's length.
    pub fn parse<T: AsRef<[u8]>>(packet: &Packet<T>) -> Result<Self, Error> {
        let mut repr = Self::default();
        walk(packet.header(), |present_bit, bytes| repr.take(present_bit, bytes))?;
        Ok(repr)
    }

    /// Stores one field; a repeated one (of a further antenna) does not replace the first.
    fn take(&mut self, present_bit: u32, bytes: &[u8]) {
        let u8_at = |at: usize| bytes.get(at).copied().unwrap_or(0);
        let u16_at = |at: usize| u16::from_le_bytes([u8_at(at), u8_at(at + 1)]);
        match present_bit {
            bit::TSFT => keep(&mut self.tsft_us, bytes.get(..8).map_or(0, LittleEndian::read_u64)),
            bit::FLAGS => keep(&mut self.flags, u8_at(0)),
            bit::RATE => keep(&mut self.rate, u8_at(0)),
            bit::CHANNEL => keep(&mut self.channel, Channel { freq_mhz: u16_at(0), flags: u16_at(2) }),
            bit::DBM_SIGNAL => keep(&mut self.signal_dbm, u8_at(0).cast_signed()),
            bit::DBM_NOISE => keep(&mut self.noise_dbm, u8_at(0).cast_signed()),
            bit::ANTENNA => keep(&mut self.antenna, u8_at(0)),
            bit::RX_FLAGS => keep(&mut self.rx_flags, u16_at(0)),
            bit::TX_FLAGS => keep(&mut self.tx_flags, u16_at(0)),
            bit::DATA_RETRIES => keep(&mut self.data_retries, u8_at(0)),
            bit::MCS => keep(&mut self.mcs, Mcs { known: u8_at(0), flags: u8_at(1), index: u8_at(2) }),
            _ => {}
        }
    }

    /// Bytes of the header that [`Repr::emit`] writes; at most [`MAX_EMIT_LEN`].
    #[must_use]
    pub fn header_len(&self) -> usize {
        let mut out = Writer { buffer: &mut [], at: MIN_LEN, present: 0 };
        self.write(&mut out);
        out.at
    }

    /// Writes the header at the start of `buffer` and returns its length.
    ///
    /// # Errors
    /// [`Error::Length`] if `buffer` is shorter than [`Repr::header_len`].
    pub fn emit(&self, buffer: &mut [u8]) -> Result<usize, Error> {
        let len = self.header_len();
        let got = buffer.len();
        let header = buffer.get_mut(..len).ok_or(Error::Length { expect: len, got })?;
        header.fill(0);
        let mut out = Writer { buffer: &mut *header, at: MIN_LEN, present: 0 };
        self.write(&mut out);
        let present = out.present;
        put(header, field::LEN, &(len as u16).to_le_bytes());
        put(header, field::PRESENT, &present.to_le_bytes());
        Ok(len)
    }

    fn write(&self, out: &mut Writer<'_>) {
        out.field(bit::TSFT, self.tsft_us.map(u64::to_le_bytes));
        out.field(bit::FLAGS, self.flags.map(u8::to_le_bytes));
        out.field(bit::RATE, self.rate.map(u8::to_le_bytes));
        out.field(bit::CHANNEL, self.channel.map(channel_bytes));
        out.field(bit::DBM_SIGNAL, self.signal_dbm.map(i8::to_le_bytes));
        out.field(bit::DBM_NOISE, self.noise_dbm.map(i8::to_le_bytes));
        out.field(bit::ANTENNA, self.antenna.map(u8::to_le_bytes));
        out.field(bit::RX_FLAGS, self.rx_flags.map(u16::to_le_bytes));
        out.field(bit::TX_FLAGS, self.tx_flags.map(u16::to_le_bytes));
        out.field(bit::DATA_RETRIES, self.data_retries.map(u8::to_le_bytes));
        out.field(bit::MCS, self.mcs.map(|mcs| [mcs.known, mcs.flags, mcs.index]));
    }
}

fn keep<V>(slot: &mut Option<V>, value: V) {
    slot.get_or_insert(value);
}

fn channel_bytes(channel: Channel) -> [u8; 4] {
    let [a, b] = channel.freq_mhz.to_le_bytes();
    let [c, d] = channel.flags.to_le_bytes();
    [a, b, c, d]
}

fn put(buffer: &mut [u8], at: usize, bytes: &[u8]) {
    if let Some(place) = buffer.get_mut(at..at + bytes.len()) {
        place.copy_from_slice(bytes);
    }
}

/// Lays fields out; with an empty buffer it only measures.
struct Writer<'a> {
    buffer: &'a mut [u8],
    at: usize,
    present: u32,
}

impl Writer<'_> {
    fn field<const N: usize>(&mut self, present_bit: u32, value: Option<[u8; N]>) {
        let (Some(bytes), Some((align, _))) = (value, FIELDS.get(present_bit as usize)) else { return };
        self.at = self.at.next_multiple_of(*align);
        put(self.buffer, self.at, &bytes);
        self.at += N;
        self.present |= 1 << present_bit;
    }
}

#[cfg(test)]
#[path = "radiotap_tests.rs"]
mod tests;
