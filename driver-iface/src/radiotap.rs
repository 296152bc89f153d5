//! Radiotap headers of injected and received frames.
//!
//! Layout (radiotap.org; Linux `include/net/ieee80211_radiotap.h`, `net/wireless/radiotap.c`): version 0, a pad byte,
//! the header's length as u16, one or more u32 words of presence bits (bit 31: another word follows), then the fields
//! in bit order, each aligned to its own alignment **counted from the start of the header**. All little-endian.
//!
//! [`Repr`] has the fields that are used. Fields of the first radiotap namespace are read; repeats
//! for further antennas, vendor fields and unused fields are skipped by their size.

use crate::{array, put};
use core::fmt;
use core::ops::Range;

/// Bytes of the smallest header: version, pad, length and one presence word.
pub const MIN_LEN: usize = 8;
/// Bytes that hold any header that [`Repr::emit`] writes.
pub const MAX_EMIT_LEN: usize = 48;

/// [`Repr::flags`]: the frame ends with its 4-byte FCS (`IEEE80211_RADIOTAP_F_FCS`).
pub(crate) const FLAGS_FCS: u8 = 0x10;
/// [`Repr::flags`]: the FCS was wrong (`IEEE80211_RADIOTAP_F_BADFCS`).
pub(crate) const FLAGS_BAD_FCS: u8 = 0x40;
/// [`Repr::tx_flags`] of a sent frame: it failed (`IEEE80211_RADIOTAP_F_TX_FAIL`).
pub const TX_FLAGS_FAIL: u16 = 0x0001;
/// [`Repr::tx_flags`]: expect no acknowledgement (`IEEE80211_RADIOTAP_F_TX_NOACK`).
pub(crate) const TX_FLAGS_NO_ACK: u16 = 0x0008;

/// Offsets of the fixed part.
mod field {
    pub(super) const LEN: usize = 2;
    pub(super) const PRESENT: usize = 4;
}

/// Presence bits of the fields that are read and written, and of what follows the fields.
mod bit {
    pub(super) const FLAGS: u32 = 1;
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

/// The fields of a radiotap header that are used. `None` is an absent field.
///
/// [`Repr::default`] is the 8-byte header without fields; the driver then chooses the rate (the CSI tool's driver:
/// `monitor_tx_rate`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Repr {
    /// `IEEE80211_RADIOTAP_F_*`.
    pub flags: Option<u8>,
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
    pub fn injected(index: u8, bandwidth: Bandwidth) -> Self {
        Self { tx_flags: Some(TX_FLAGS_NO_ACK), mcs: Some(Mcs::injected(index, bandwidth)), ..Self::default() }
    }

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

    /// The fields of the header at the start of `bytes`, and where the 802.11 frame after it is, without an announced FCS.
    ///
    /// # Errors
    /// [`Error`] with the failed check: version, lengths, presence words, an announced field or FCS that is not there.
    pub fn parse(bytes: &[u8]) -> Result<(Self, Range<usize>), Error> {
        let cut = |expect| Error::Length { expect, got: bytes.len() };
        let &[version, _, low, high, ..] = bytes else { return Err(cut(MIN_LEN)) };
        if version != 0 {
            return Err(Error::Version(version));
        }
        let len = u16::from_le_bytes([low, high]);
        let start = usize::from(len);
        if start < MIN_LEN {
            return Err(Error::HeaderLength(len));
        }
        let (header, behind) = bytes.split_at_checked(start).ok_or(cut(start))?;
        let mut repr = Self::default();
        walk(header, |present_bit, bytes| repr.take(present_bit, bytes))?;
        let fcs_len = if repr.has_fcs() { 4 } else { 0 };
        let frame_len = behind.len().checked_sub(fcs_len);
        let frame_len = frame_len.ok_or(Error::Length { expect: fcs_len, got: behind.len() })?;
        Ok((repr, start..start + frame_len))
    }

    /// Stores one field; a repeated one (of a further antenna) does not replace the first.
    fn take(&mut self, present_bit: u32, bytes: &[u8]) {
        let u8_at = |at: usize| bytes.get(at).copied().unwrap_or(0);
        match present_bit {
            bit::FLAGS => keep(&mut self.flags, u8_at(0)),
            bit::TX_FLAGS => keep(&mut self.tx_flags, u16::from_le_bytes(array(bytes, 0))),
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
        out.field(bit::FLAGS, self.flags.map(u8::to_le_bytes));
        out.field(bit::TX_FLAGS, self.tx_flags.map(u16::to_le_bytes));
        out.field(bit::DATA_RETRIES, self.data_retries.map(u8::to_le_bytes));
        out.field(bit::MCS, self.mcs.map(|mcs| [mcs.known, mcs.flags, mcs.index]));
    }
}

fn keep<V>(slot: &mut Option<V>, value: V) {
    slot.get_or_insert(value);
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

fn present_word(header: &[u8], number: usize) -> Result<u32, Error> {
    let at = field::PRESENT + 4 * number;
    let word = header.get(at..).and_then(|rest| rest.first_chunk());
    word.map(|word| u32::from_le_bytes(*word)).ok_or(Error::Length { expect: at + 4, got: header.len() })
}

/// Offset of the first field: after the last presence word.
fn fields_start(header: &[u8]) -> Result<usize, Error> {
    let mut words = 0;
    loop {
        let word = present_word(header, words)?;
        words += 1;
        if word & (1 << bit::EXT) == 0 {
            return Ok(field::PRESENT + 4 * words);
        }
    }
}

/// The owner of a presence word's bits.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Namespace {
    /// Radiotap's own table, from bit 0.
    Radiotap,
    /// Radiotap's table beyond bit 31, where nothing is defined: the sizes are unknown.
    Beyond,
    /// A vendor's; its fields are skipped together.
    Vendor,
}

/// Calls `each` with the bit number and bytes of every field of the radiotap namespace.
///
/// As in Linux (`ieee80211_radiotap_iterator_next`), a field of unknown size ends the walk: nothing after it can be located.
fn walk(header: &[u8], mut each: impl FnMut(u32, &[u8])) -> Result<(), Error> {
    let mut at = fields_start(header)?;
    let mut namespace = Namespace::Radiotap;
    for number in 0.. {
        let word = present_word(header, number)?;
        let has = |present_bit: u32| word & (1 << present_bit) != 0;
        if namespace == Namespace::Beyond && word & ((1 << bit::RADIOTAP_NAMESPACE) - 1) != 0 {
            return Ok(());
        }
        for (present_bit, &(align, size)) in (0u32..).zip(&FIELDS) {
            if namespace != Namespace::Radiotap || !has(present_bit) {
                continue;
            }
            at = at.next_multiple_of(align);
            let bytes = header.get(at..at + size);
            each(present_bit, bytes.ok_or(Error::Length { expect: at + size, got: header.len() })?);
            at += size;
        }
        if namespace == Namespace::Radiotap && has(bit::TLV) {
            return Ok(());
        }
        if has(bit::VENDOR_NAMESPACE) {
            at = after_vendor_fields(header, at)?;
        }
        if !has(bit::EXT) {
            return Ok(());
        }
        namespace = match (has(bit::RADIOTAP_NAMESPACE), has(bit::VENDOR_NAMESPACE), namespace) {
            (true, _, _) => Namespace::Radiotap,
            (_, true, _) | (_, _, Namespace::Vendor) => Namespace::Vendor,
            _ => Namespace::Beyond,
        };
    }
    Ok(())
}

/// The vendor namespace field: OUI (3), sub-namespace (1), u16 length of the vendor's fields, aligned to 2.
fn after_vendor_fields(header: &[u8], at: usize) -> Result<usize, Error> {
    let at = at.next_multiple_of(2);
    let cut = |expect| Error::Length { expect, got: header.len() };
    let skip = header.get(at + 4..).and_then(|rest| rest.first_chunk()).ok_or(cut(at + 6))?;
    let end = at + 6 + usize::from(u16::from_le_bytes(*skip));
    if end > header.len() { Err(cut(end)) } else { Ok(end) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn emitted(repr: Repr) -> Vec<u8> {
        let mut buffer = [0xee; MAX_EMIT_LEN];
        let len = repr.emit(&mut buffer).unwrap();
        buffer[..len].to_vec()
    }

    /// The fields of a header, with room for an FCS behind it.
    fn parsed(header: &[u8]) -> Repr {
        Repr::parse(&[header, &[0; 4]].concat()).unwrap().0
    }

    #[test]
    fn injection_headers_have_their_known_bytes() {
        // Accepted by mac80211 (6.1, mac80211_hwsim) as HT MCS 7, no acknowledgement.
        let ht = emitted(Repr::injected(7, Bandwidth::Ht20));
        assert_eq!(ht, [0, 0, 13, 0, 0, 0x80, 8, 0, 8, 0, 0x37, 0, 7]);
        assert_eq!(emitted(Repr::injected(1, Bandwidth::Ht40))[10..], [0x37, 1, 1]);
        assert_eq!(emitted(Repr::default()), [0, 0, 8, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn a_received_frame_of_linux_is_read() {
        // Presence 0x0008482b as mac80211_hwsim (6.1) delivers an HT frame, 29 bytes.
        let mut bytes = std::vec![0, 0, 29, 0, 0x2b, 0x48, 8, 0];
        bytes.extend(0x0102_0304_0506_0708u64.to_le_bytes()); // TSFT at 8
        bytes.extend([0x00]); // flags at 16
        bytes.extend([0x00]); // pad to 18
        bytes.extend([0xa4, 0x15, 0x40, 0x01]); // channel 5540, OFDM 5 GHz
        bytes.extend([(-50i8).cast_unsigned(), 0]); // signal, antenna
        bytes.extend([0, 0]); // RX flags at 24
        bytes.extend([7, 0, 7]); // MCS
        assert_eq!(bytes.len(), 29);
        bytes.extend([1, 2, 3, 4, 5]);
        let (repr, frame) = Repr::parse(&bytes).unwrap();
        assert_eq!(repr.mcs.map(|mcs| mcs.index), Some(7));
        assert_eq!(repr.mcs.and_then(|mcs| mcs.bandwidth()), Some(Bandwidth::Ht20));
        assert!(!repr.is_own_echo());
        assert_eq!(bytes[frame], [1, 2, 3, 4, 5]);
    }

    #[test]
    fn an_announced_fcs_is_not_part_of_the_frame() {
        let mut bytes = emitted(Repr { flags: Some(FLAGS_FCS | FLAGS_BAD_FCS), ..Repr::default() });
        bytes.extend([1, 2, 3, 4, 5]);
        let (repr, frame) = Repr::parse(&bytes).unwrap();
        assert!(repr.has_fcs() && repr.is_bad_fcs());
        assert_eq!(bytes[frame], [1]);
        assert_eq!(Repr::parse(&bytes[..12]), Err(Error::Length { expect: 4, got: 3 }));
    }

    #[test]
    fn a_wrong_checksum_has_its_own_bit() {
        for (flags, bad) in
            [(None, false), (Some(0), false), (Some(0xff ^ FLAGS_BAD_FCS), false), (Some(FLAGS_BAD_FCS), true)]
        {
            assert_eq!(parsed(&emitted(Repr { flags, ..Repr::default() })).is_bad_fcs(), bad, "{flags:?}");
        }
    }

    #[test]
    fn a_tx_status_copy_is_known_by_its_tx_flags() {
        let status = parsed(&emitted(Repr { tx_flags: Some(0), data_retries: Some(0), ..Repr::default() }));
        assert!(status.is_own_echo());
        assert!(parsed(&emitted(Repr::injected(0, Bandwidth::Ht20))).is_own_echo());
    }

    #[test]
    fn per_antenna_words_are_skipped_and_the_first_value_kept() {
        // As iwlwifi writes for several chains: signal in word 0, then words of {signal, antenna} in the same namespace.
        let bytes = [
            0, 0, 23, 0, 0x22, 0, 0, 0xa0, 0x20, 0x08, 0, 0xa0, 0x20, 0x08, 0, 0, // three words
            0x10, 0xce, // flags, signal -50 dBm
            0xcc, 0, // signal -52 dBm on antenna 0
            0xca, 1, // signal -54 dBm on antenna 1
            0,
        ];
        assert_eq!(parsed(&bytes).flags, Some(0x10));
        assert_eq!(parsed(&[0, 0, 14, 0, 2, 0, 0, 0xa0, 2, 0, 0, 0, 0x10, 0x20]).flags, Some(0x10));
    }

    #[test]
    fn vendor_fields_are_skipped_by_their_length() {
        let bytes = [
            0, 0, 31, 0, 0x02, 0, 0, 0xc0, // flags, vendor namespace, more
            0xff, 0xff, 0xff, 0xbf, // the vendor's bits: all, then the radiotap namespace again, more
            0, 0, 2, 0, // retries
            0x40, 0, // flags at 16, pad
            1, 2, 3, 0, 6, 0, // OUI, sub-namespace, 6 bytes of vendor's fields
            9, 9, 9, 9, 9, 9, 0xce, // retries
        ];
        let repr = parsed(&bytes);
        assert_eq!((repr.flags, repr.data_retries), (Some(0x40), Some(0xce)));
        // They may end the header, but not exceed it.
        for (len, fits) in [(1, true), (2, true), (3, false), (0xffff, false)] {
            let mut header = std::vec![0, 0, 16, 0, 0, 0, 0, 0x40, 1, 2, 3, 0, 0, 0, 9, 9];
            header[12..14].copy_from_slice(&u16::to_le_bytes(len));
            assert_eq!(Repr::parse(&header).is_ok(), fits, "{len} bytes of vendor's fields");
        }
    }

    #[test]
    fn every_skipped_field_has_the_right_size_and_alignment() {
        // TX flags after bits 4, 7, 8, 9, 10, 12, 13; MCS after 16 and 18: offsets by hand.
        let present: u32 =
            1 << 4 | 1 << 7 | 1 << 8 | 1 << 9 | 1 << 10 | 1 << 12 | 1 << 13 | 1 << 15 | 1 << 16 | 1 << 18;
        let mut bytes = std::vec![0, 0, 0, 0];
        bytes.extend((present | 1 << 19 | 1 << 22 | 1 << 27).to_le_bytes());
        bytes.extend([1, 1, 2, 2, 3, 3, 4, 4, 5, 6, 7, 0]); // FHSS 8, lock 10, att 12, dB 14, power 16, 17, 18, pad
        bytes.extend([0x18, 0, 8, 0]); // TX flags at 20, RTS retries 22, pad to 24
        bytes.extend([9; 8]); // XChannel at 24
        bytes.extend([0x37, 0, 5]); // MCS at 32
        bytes.extend([0; 5]); // to 40
        bytes.extend([0; 12]); // timestamp at 40
        bytes.extend([0; 4]); // L-SIG at 52
        let len = bytes.len();
        assert_eq!(len, 56);
        bytes[2] = len as u8;
        let repr = parsed(&bytes);
        assert_eq!(repr.tx_flags, Some(0x18));
        assert_eq!(repr.mcs, Some(Mcs { known: 0x37, flags: 0, index: 5 }));
        bytes[2] = len as u8 - 1;
        let cut = Repr::parse(&bytes);
        assert_eq!(cut, Err(Error::Length { expect: 56, got: 55 }));
    }

    #[test]
    fn invalid_headers_are_refused_with_numbers() {
        let check = |bytes: &[u8]| Repr::parse(bytes);
        assert_eq!(check(&[0, 0]), Err(Error::Length { expect: 8, got: 2 }));
        assert_eq!(check(&[1, 0, 8, 0, 0, 0, 0, 0]), Err(Error::Version(1)));
        assert_eq!(check(&[0, 0, 7, 0, 0, 0, 0, 0]), Err(Error::HeaderLength(7)));
        assert_eq!(check(&[0, 0, 9, 0, 0, 0, 0, 0]), Err(Error::Length { expect: 9, got: 8 }));
        assert_eq!(check(&[0, 0, 8, 0, 0, 0, 0, 0x80]), Err(Error::Length { expect: 12, got: 8 }));
        let mut small = [0; 12];
        assert_eq!(Repr::injected(0, Bandwidth::Ht20).emit(&mut small), Err(Error::Length { expect: 13, got: 12 }));
    }

    fn any_repr() -> impl Strategy<Value = Repr> {
        any::<(Option<u8>, Option<u16>, Option<u8>, Option<(u8, u8, u8)>)>().prop_map(|fields| Repr {
            flags: fields.0,
            tx_flags: fields.1,
            data_retries: fields.2,
            mcs: fields.3.map(|(known, flags, index)| Mcs { known, flags, index }),
        })
    }

    proptest! {
        #[test]
        fn emit_then_parse_is_the_identity(repr in any_repr(), tail in proptest::collection::vec(any::<u8>(), 0..40)) {
            let mut bytes = emitted(repr);
            prop_assert_eq!(bytes.len(), repr.header_len());
            bytes.extend(&tail);
            let fcs_len = if repr.has_fcs() { 4 } else { 0 };
            prop_assume!(tail.len() >= fcs_len);
            prop_assert_eq!(Repr::parse(&bytes), Ok((repr, repr.header_len()..bytes.len() - fcs_len)));
        }

        #[test]
        fn foreign_bytes_never_panic(mut bytes in proptest::collection::vec(any::<u8>(), 0..120), plausible: bool) {
            if plausible && bytes.len() >= 8 {
                let len = bytes.len() as u8;
                bytes[..4].copy_from_slice(&[0, 0, len, 0]);
            }
            if let Ok((_, frame)) = Repr::parse(&bytes) {
                prop_assert!(bytes.get(frame).is_some());
            }
        }
    }

    #[test]
    fn a_width_is_known_if_its_bit_is_set() {
        let width = |known, flags| Mcs { known, flags, index: 1 }.bandwidth();
        use Bandwidth::{Ht20, Ht40};
        assert_eq!([0, 1, 2, 3].map(|flags| width(1, flags)), [Some(Ht20), Some(Ht40), Some(Ht20), Some(Ht20)]);
        // Other bits of both bytes have other meanings.
        assert_eq!([0, 1, 2, 3].map(|flags| width(0xfe, flags)), [None; 4]);
        assert_eq!([width(0xff, 0xfd), width(0xff, 0xfc)], [Some(Ht40), Some(Ht20)]);
    }

    #[test]
    fn fields_of_an_unknown_namespace_end_the_walk() {
        const EXT: u32 = 1 << 31;
        const VENDOR: u32 = 1 << 30;
        const RADIOTAP: u32 = 1 << 29;
        const RETRIES: u32 = 1 << 17;
        let header = |words: &[u32], fields: &[u8]| {
            let len = (4 + 4 * words.len() + fields.len()) as u8;
            let mut bytes = std::vec![0, 0, len, 0];
            words.iter().for_each(|word| bytes.extend(word.to_le_bytes()));
            bytes.extend(fields);
            bytes
        };
        // The second word has no namespace. Without fields it leads on to a word of radiotap's.
        assert_eq!(parsed(&header(&[EXT, EXT | RADIOTAP, RETRIES], &[12])).data_retries, Some(12));
        // With a field, of unknown size, nothing after it can be located: neither retries nor vendor fields.
        for field in [0, 5, 28] {
            assert_eq!(
                parsed(&header(&[EXT, EXT | RADIOTAP | 1 << field, RETRIES], &[12])).data_retries,
                None,
                "{field}"
            );
            assert_eq!(parsed(&header(&[EXT, VENDOR | 1 << field], &[])), Repr::default(), "{field}");
        }
        let cut = Repr::parse(&header(&[EXT, VENDOR], &[]));
        assert_eq!(cut, Err(Error::Length { expect: 18, got: 12 }));
    }
}
