//! Evidence in three to twenty-three bytes that they are the head of a record.

use core::fmt;

use super::{LENGTH_FIELD, MAX_LENGTH, code};
use crate::bfee;

/// Why bytes were skipped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// A length of zero.
    ZeroLength,
    /// A length that no driver writes.
    ImpossibleLength {
        /// As read.
        got: usize,
        /// The largest possible one, [`MAX_LENGTH`].
        max: usize,
    },
    /// Code 0xBB with a length shorter than that of any bfee.
    BfeeLength {
        /// As read: code and body.
        got: usize,
    },
    /// A bfee whose header contradicts itself or the record's length.
    Bfee(bfee::Error),
    /// The head is valid, but another record begins inside its span: bytes of this one are missing.
    Overlapped {
        /// Bytes that the head announces, length field included.
        expect: usize,
        /// Bytes up to the next head.
        got: usize,
    },
    /// A bfee with set bits in the gaps and no record after it: bytes were inserted.
    GapBits,
    /// No record follows where its length says, and nothing else vouches for it.
    NotFollowed {
        /// Its code.
        code: u8,
        /// Bytes that the head announces, length field included.
        expect: usize,
    },
    /// A record whose bytes do not match the checksum in the log's side file ([`Check`](crate::side_file::Check)): they were changed,
    /// or never written. Reported by readers of both files, not by the framer.
    Checksum,
    /// The damage continues from the previous step: too long for one search.
    StillLost,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::ZeroLength => write!(f, "a record of length 0"),
            Self::ImpossibleLength { got, max } => write!(f, "a record of length {got}, at most {max} is possible"),
            Self::BfeeLength { got } => write!(f, "a bfee record of length {got}, shorter than one of one chain"),
            Self::Bfee(error) => error.fmt(f),
            Self::Overlapped { expect, got } => {
                write!(f, "a record of {expect} bytes, but the next begins after {got}: bytes are missing")
            }
            Self::GapBits => write!(f, "a damaged bfee: bits are set between its samples, and no record follows it"),
            Self::NotFollowed { code, expect } => {
                write!(f, "code {code:#04x}, {expect} bytes, and no record after it")
            }
            Self::Checksum => write!(f, "a record whose checksum differs from the side file's"),
            Self::StillLost => write!(f, "still no record"),
        }
    }
}

/// The evidence at a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Head {
    /// Too few bytes to say.
    Short,
    /// No record can begin like this.
    Bad(Reason),
    /// A record of `len` bytes, length field included.
    Good {
        /// Length field, code and body.
        len: usize,
        /// Bits of evidence that these bytes are a record; certain from [`SURE`] on.
        bits: u32,
    },
}

/// Bits of evidence that count as certain: one error in 10^12 positions.
pub(super) const SURE: u32 = 40;

/// Value of the length field of the shortest bfee: stock, one chain.
const SHORTEST_BFEE: usize = 1 + bfee::STOCK_HEADER + bfee::csi_len(1, 1);

/// Bytes that [`head`] needs at most: length field, code, and the header of a bfee.
pub(super) const LONGEST_HEAD: usize = LENGTH_FIELD + 1 + bfee::STOCK_HEADER;

/// The codes of records that can be sure by themselves.
pub(super) const VOUCHING_CODES: [u8; 2] = [code::BFEE, code::NOISE];

/// The length's high byte of such records is below this.
pub(super) const VOUCHING_LENGTHS: u8 = ((1 + bfee::MAX_BODY) / 256 + 1) as u8;

/// Codes of accepted records, a set of bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Codes([u64; 4]);

impl Codes {
    pub(super) fn insert(&mut self, code: u8) {
        if let Some(word) = self.0.get_mut(usize::from(code / 64)) {
            *word |= 1 << (code % 64);
        }
    }

    pub(super) fn contains(&self, code: u8) -> bool {
        self.0.get(usize::from(code / 64)).is_some_and(|word| word >> (code % 64) & 1 != 0)
    }
}

/// Judges the bytes at a position; `seen` are codes that this stream uses.
#[inline]
pub(super) fn head(bytes: &[u8], seen: &Codes) -> Head {
    let &[high, low, ref rest @ ..] = bytes else { return Head::Short };
    let length = usize::from(u16::from_be_bytes([high, low]));
    if length == 0 {
        return Head::Bad(Reason::ZeroLength);
    }
    if length > MAX_LENGTH {
        return Head::Bad(Reason::ImpossibleLength { got: length, max: MAX_LENGTH });
    }
    let Some((&code, body)) = rest.split_first() else { return Head::Short };
    let len = LENGTH_FIELD + length;
    let bits = match code {
        code::BFEE => return bfee_head(body, length),
        code::MPDU => mpdu_bits(body, length),
        code::NOISE => noise_bits(body, length),
        code::TX_BLOCK_AGG if length == 9 => Some(24),
        _ if seen.contains(code) || code::name(code).is_some() => Some(8),
        _ => Some(0),
    };
    bits.map_or(Head::Short, |bits| Head::Good { len, bits })
}

/// Length of the record at the front if [`head`] is sure of it, without the reasons for damage.
#[inline(always)]
pub(super) fn sure(bytes: &[u8]) -> Option<usize> {
    let &[high, low, code, ref body @ ..] = bytes else { return None };
    let length = usize::from(u16::from_be_bytes([high, low]));
    let is_sure = match code {
        code::BFEE => bfee::check(body.first_chunk()?, length.checked_sub(1)?).is_ok(),
        code::NOISE => noise_bits(body, length)? >= SURE,
        _ => false,
    };
    is_sure.then_some(LENGTH_FIELD + length)
}

/// Length of the record at the front if [`head`] has evidence for it but is not sure.
#[inline(always)]
pub(super) fn likely(bytes: &[u8], seen: &Codes) -> Option<usize> {
    if let &[high, low, code::MPDU, ref body @ ..] = bytes {
        let length = usize::from(u16::from_be_bytes([high, low]));
        return (length <= MAX_LENGTH && mpdu_bits(body, length)? > 0).then_some(LENGTH_FIELD + length);
    }
    match head(bytes, seen) {
        Head::Good { len, bits } if (1..SURE).contains(&bits) => Some(len),
        _ => None,
    }
}

/// Bits of evidence of a bfee that is longer than its CSI: numbers of chains, and the matching CSI length.
const LONGER_BFEE: u32 = 28;

/// A bfee's fields are so redundant that nothing else looks like one; a bfee that continues after its CSI needs a witness.
#[inline]
fn bfee_head(body: &[u8], length: usize) -> Head {
    let checked = body.first_chunk().map(|header| bfee::check(header, length - 1));
    match checked {
        Some(Ok(_)) => Head::Good { len: LENGTH_FIELD + length, bits: SURE },
        _ if length < SHORTEST_BFEE => Head::Bad(Reason::BfeeLength { got: length }),
        Some(Err(bfee::Error::BodyLength { csi, got })) if got > csi + bfee::STOCK_HEADER => {
            Head::Good { len: LENGTH_FIELD + length, bits: LONGER_BFEE }
        }
        Some(Err(error)) => Head::Bad(Reason::Bfee(error)),
        None => Head::Short,
    }
}

/// Frame control of an MPDU: version 0 and a type that exists; frames with a bad checksum may have neither.
fn mpdu_bits(body: &[u8], length: usize) -> Option<u32> {
    let &control = body.first()?;
    let plausible = control & 3 == 0 && control >> 2 & 3 != 3 && length > 14;
    Some(if plausible { 13 } else { 0 })
}

/// A noise record: four bytes, an i32 between -255 and -1.
fn noise_bits(body: &[u8], length: usize) -> Option<u32> {
    if length != 5 {
        return Some(0);
    }
    let dbm = i32::from_le_bytes(*body.first_chunk()?);
    Some(if (-255..0).contains(&dbm) { SURE } else { 0 })
}
