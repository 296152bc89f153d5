//! Records and the `.dat` log: for each message of the driver a big-endian u16 length, then that many bytes, a code and a body
//! (`log_to_file.c`). No file header, no time stamps, no trailer.
//!
//! [`Framer`] walks such a stream, distinguishes records from damage, and resynchronises.
//!
//! # The framer
//!
//! A sans-IO state machine with the states of `State`.
//!
//! Each [`Framer::step`] classifies the bytes at the front by their head (`Front`), collects the evidence that this class
//! needs, and reaches one `Verdict`. The questions in order; the first one answered with yes decides:
//!
//! | front | question | verdict |
//! |---|---|---|
//! | `Nothing` | is the stream over? | `End(Clean)`, else `Wait` |
//! | `Partial`, stream not over | | `Wait` |
//! | `Partial`, stream over | does a record begin inside? | `Skip` to it |
//! | | is the code unknown, its length read? | `Skip` all: nothing shows that it is a record |
//! | | | `End(Cut)` |
//! | `Damage` | | `Seek` |
//! | `Sure` | is the next record sure, too? | `Take`, state `Vouched` |
//! | | is the next but one sure, and has the one between evidence? | `Take`, state `Followed` |
//! | | do records follow that vouch for it? | `Take` |
//! | | does a record begin inside? | `Skip` to it |
//! | | are a bfee's unused bits zero? | `Take`, else `Seek` after it |
//! | `Followed` | does no sure record begin inside? | `Take`, state `Vouched` |
//! | | is it an MPDU with a correct checksum? | `Take`, else `Seek` |
//! | `Doubtful` | is the next record sure? | as `Followed` |
//! | | do records follow, and does no sure one begin inside? | `Take` |
//! | | is it an MPDU with a correct checksum? | `Take`, else `Seek` |
//!
//! A question that needs bytes beyond the buffer gives `Wait`. `Seek` searches at most `SEARCH` positions for the next record:
//! if it is found, the verdict is a `Skip` to it; if not, a `Skip` of all of them, state `Lost`. In state `Lost` the front is
//! `Damage` from its first byte on; a record found right there ends that state.

use crate::bfee::{Bfee, offset};
use crate::mpdu::fcs_is_good;
use crate::{EmitError, bfee, room};
use core::fmt;

/// Message codes, the first byte of every connector message (`dvm/connector.h`, csitool `iwl_structs.h`).
pub mod code {
    /// CSI of one frame ([`crate::bfee`]).
    pub const BFEE: u8 = 0xBB;
    /// PHY part of a reception; not sent by the 4.15 driver.
    pub const RX_PHY: u8 = 0xC0;
    /// A received frame ([`crate::mpdu`]), sent before its own bfee.
    pub const MPDU: u8 = 0xC1;
    /// Legacy reception; not sent by the 4.15 driver.
    pub const RX: u8 = 0xC3;
    /// Noise floor, i32 dBm.
    pub const NOISE: u8 = 0xD0;
    /// Status (4.15) or an iperf filter (older trees).
    pub const STATUS: u8 = 0xD1;
    /// Parallel packets (older trees).
    pub const PARALLEL: u8 = 0xD2;
    /// Transmission result; not sent by the 4.15 driver.
    pub const TX_RESP: u8 = 0x1C;
    /// Aggregation block, two u32; not sent by the 4.15 driver.
    pub const TX_BLOCK_AGG: u8 = 0xC5;

    /// For logs translated from another card: how far its clock is past the microsecond of the following bfee, u32 picoseconds. No
    /// driver sends it.
    pub const CARD_CLOCK: u8 = 0xCC;
    /// For other cards: bytes of the log without a bfee. Their offset and number, u64 each, then the reason as text.
    pub const LEFT_OUT: u8 = 0xCD;

    /// Codes and their names, in the order of the driver's header, followed by those of translated logs.
    pub const TABLE: [(u8, &str); 11] = [
        (BFEE, "bfee"),
        (RX_PHY, "rx_phy"),
        (MPDU, "mpdu"),
        (RX, "rx"),
        (NOISE, "noise"),
        (TX_RESP, "tx_resp"),
        (TX_BLOCK_AGG, "tx_block_agg"),
        (STATUS, "status"),
        (PARALLEL, "parallel"),
        (CARD_CLOCK, "card_clock"),
        (LEFT_OUT, "left_out"),
    ];

    /// The name of a code, if it has one.
    #[must_use]
    pub fn name(code: u8) -> Option<&'static str> {
        TABLE.iter().find(|(known, _)| *known == code).map(|(_, name)| *name)
    }
}

/// Bytes of the length field.
pub const LENGTH_FIELD: usize = 2;

/// Largest length field that a driver writes: an A-MSDU in the card's 8 KiB receive buffer.
///
/// The field could hold 65,535; such lengths are common in damaged logs and unknown in intact ones.
pub const MAX_LENGTH: usize = 8192;

/// One record: a code and its body (without the code).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'a> {
    /// Message code, see [`code`]: 0xBB bfee, 0xC1 MPDU, others kept and counted.
    pub code: u8,
    /// The body, after the code byte.
    pub body: &'a [u8],
}

impl<'a> Record<'a> {
    /// Splits a datagram's message (code and body); `None` if it is empty.
    #[must_use]
    pub fn from_message(message: &'a [u8]) -> Option<Self> {
        let (&code, body) = message.split_first()?;
        Some(Self { code, body })
    }

    /// Value of the length field: code and body.
    #[must_use]
    pub fn length(&self) -> usize {
        1 + self.body.len()
    }

    /// Bytes in a `.dat` log, length field included.
    #[must_use]
    pub fn emit_len(&self) -> usize {
        LENGTH_FIELD + self.length()
    }

    /// Writes the record as in a `.dat` log: length, code, body. Returns [`Record::emit_len`].
    ///
    /// # Errors
    /// If the body does not fit the length field (65,534 bytes) or `out` is too short.
    pub fn emit(&self, out: &mut [u8]) -> Result<usize, EmitError> {
        let length = u16::try_from(self.length()).map_err(|_| EmitError::Field {
            name: "length",
            got: self.length(),
            max: u16::MAX.into(),
        })?;
        let out = room(out, self.emit_len())?;
        let (head, body) = out.split_at_mut(LENGTH_FIELD + 1);
        let [high, low] = length.to_be_bytes();
        head.copy_from_slice(&[high, low, self.code]);
        body.copy_from_slice(self.body);
        Ok(self.emit_len())
    }
}

/// The content of a [`code::CARD_CLOCK`]'s body, picoseconds.
#[must_use]
pub fn card_clock_ps(body: &[u8]) -> Option<u32> {
    body.try_into().ok().map(u32::from_le_bytes)
}

/// The content of a [`code::LEFT_OUT`]'s body: offset and number of the bytes, and the reason.
#[must_use]
pub fn left_out(body: &[u8]) -> Option<(u64, u64, &str)> {
    let (offset, rest) = body.split_first_chunk()?;
    let (len, why) = rest.split_first_chunk()?;
    Some((u64::from_le_bytes(*offset), u64::from_le_bytes(*len), core::str::from_utf8(why).ok()?))
}

/// The complete records of an intact stream, each with its length field; a cut one at the end is dropped.
pub fn written(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = bytes;
    core::iter::from_fn(move || {
        let length = usize::from(u16::from_be_bytes(*rest.first_chunk::<LENGTH_FIELD>()?));
        let (record, behind) = rest.split_at_checked(LENGTH_FIELD + length)?;
        rest = behind;
        Some(record)
    })
}

/// Bytes and number of the complete records in the first `upto` bytes of an intact stream: where to cut a write that stopped
/// there.
#[must_use]
pub fn whole_records(bytes: &[u8], upto: usize) -> (usize, usize) {
    let whole = written(bytes.get(..upto).unwrap_or(bytes));
    whole.fold((0, 0), |(at, records), record| (at + record.len(), records + 1))
}

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
enum Head {
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
const SURE: u32 = 40;

/// Value of the length field of the shortest bfee: stock, one chain.
const SHORTEST_BFEE: usize = 1 + bfee::STOCK_HEADER + bfee::csi_len(1, 1);

/// Bytes that [`head`] needs at most: length field, code, and the header of a bfee.
const LONGEST_HEAD: usize = LENGTH_FIELD + 1 + bfee::STOCK_HEADER;

/// The codes of records that can be sure by themselves.
const VOUCHING_CODES: [u8; 2] = [code::BFEE, code::NOISE];

/// The length's high byte of such records is below this.
const VOUCHING_LENGTHS: u8 = ((1 + bfee::MAX_BODY) / 256 + 1) as u8;

/// Codes of accepted records, a set of bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Codes([u64; 4]);

impl Codes {
    fn insert(&mut self, code: u8) {
        if let Some(word) = self.0.get_mut(usize::from(code / 64)) {
            *word |= 1 << (code % 64);
        }
    }

    fn contains(&self, code: u8) -> bool {
        self.0.get(usize::from(code / 64)).is_some_and(|word| word >> (code % 64) & 1 != 0)
    }
}

/// Judges the bytes at a position; `seen` are codes that this stream uses.
#[inline]
fn head(bytes: &[u8], seen: &Codes) -> Head {
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
fn sure(bytes: &[u8]) -> Option<usize> {
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
fn likely(bytes: &[u8], seen: &Codes) -> Option<usize> {
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

/// Bytes of buffer with which [`Framer::step`] can always decide.
pub const LOOKAHEAD: usize = 72 * 1024;

/// Positions searched before a stretch of damage is reported in parts.
const SEARCH: usize = 16 * 1024;

// The furthest byte needed: the head of the last link after a candidate at the end of a search after a bfee.
const _: () = assert!(
    LENGTH_FIELD + 1 + bfee::MAX_BODY + SEARCH + MAX_LINKS * (LENGTH_FIELD + MAX_LENGTH) + LONGEST_HEAD <= LOOKAHEAD
);

/// The front of the buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step<'a> {
    /// A record.
    Record {
        /// Its offset in the stream, bytes.
        offset: u64,
        /// Bytes to consume, length field included.
        used: usize,
        /// The record.
        record: Record<'a>,
    },
    /// More bytes are needed after those offered; [`LOOKAHEAD`] of them are always enough.
    Incomplete,
    /// Damaged bytes.
    Bad {
        /// Their offset in the stream, bytes.
        offset: u64,
        /// Bytes to consume.
        skipped: usize,
        /// Why; [`Reason::StillLost`] continues the previous step.
        reason: Reason,
    },
    /// The stream is over; the rest of the buffer, if any, is the tail.
    End(Tail),
}

/// How a stream of records ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tail {
    /// Nothing is left over.
    Clean,
    /// Inside a record: the normal end of a log whose logger was killed.
    Cut {
        /// Offset of the last record in the stream, bytes.
        offset: u64,
        /// Bytes of it that exist.
        bytes: u64,
        /// Its full length, length field included; `None` if not even that can be read.
        expected: Option<u64>,
    },
}

impl Tail {
    /// True if the stream was cut at a multiple of 4096 bytes: the logger was killed before it flushed its buffer.
    #[must_use]
    pub fn is_unflushed_buffer(&self) -> bool {
        match *self {
            Self::Clean => false,
            Self::Cut { offset, bytes, .. } => (offset + bytes) % 4096 == 0,
        }
    }
}

/// Walks a stream of records; owns no buffer.
///
/// Offer the unconsumed bytes to [`Framer::step`], then drop as many from the front as it returns (`used`, `skipped`). The same
/// bytes give the same steps, whatever the chunks. Work is linear in the bytes; look-ahead is bounded by [`LOOKAHEAD`].
///
/// A record is accepted if its own contents are consistent (a bfee whose lengths match, a noise value, an MPDU with a correct
/// checksum), or if such a record or the stream's end follows where its length says. Otherwise a bfee or MPDU is searched for the
/// head of another record. If there is one inside, bytes are missing from the first, which is discarded: one lost byte, or 100
/// foreign ones, cost only the record that contains them. Records of unknown codes are legal; right after damage one is accepted
/// only if its code was met before.
#[derive(Clone, Debug)]
pub struct Framer {
    offset: u64,
    state: State,
    /// Codes of accepted records.
    seen: Codes,
    known: Known,
    /// Bytes whose checksum may still be computed; see [`CREDIT`].
    credit: usize,
    usual: Usual,
}

/// What is known about the current front.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    /// Positions at which no record begins.
    searched: usize,
    /// Positions at which no record begins that vouches for itself.
    searched_sure: usize,
    /// Whether its checksum is correct, once computed.
    is_right: Option<bool>,
}

impl Default for Framer {
    fn default() -> Self {
        Self::new()
    }
}

/// Bytes of a record, length field included: [`LENGTH_FIELD`] + [`MAX_LENGTH`] at most. Narrow, so that a [`State`] is a word.
type Len = u16;

const _: () = assert!(LENGTH_FIELD + MAX_LENGTH <= Len::MAX as usize);

/// What the previous step knows of the bytes at the front.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Nothing.
    Fresh,
    /// A record of `len` bytes that vouches for itself.
    Vouched { len: Len },
    /// A record of `len` bytes that does not, followed by one of `next` bytes that does.
    Followed { len: Len, next: Len },
    /// They follow damage in which no record was found.
    Lost,
}

/// The class of the bytes at the front, by their head.
enum Front {
    /// None.
    Nothing,
    /// A part of a record; `expected` bytes, if its length can be read.
    Partial { expected: Option<usize> },
    /// No record; the next may begin `from` bytes on.
    Damage { from: usize, reason: Reason },
    /// A complete record that vouches for itself.
    Sure { len: usize },
    /// A complete record by its length, with `bits` of evidence.
    Doubtful { len: usize, bits: u32 },
    /// A complete record by its length, followed by one of `next` bytes that vouches for itself.
    Followed { len: usize, next: Len },
}

/// What to do with the front.
enum Verdict {
    /// It is a record of `len` bytes; `next` is known of the following bytes.
    Take { len: usize, next: State },
    /// The first `len` bytes are damage; `next` is known of the following bytes.
    Skip { len: usize, reason: Reason, next: State },
    /// The first `from` bytes are damage: find the next record.
    Seek { from: usize, reason: Reason },
    /// More bytes are needed.
    Wait,
    /// The stream is over.
    End(Tail),
}

impl Verdict {
    fn take(len: usize) -> Self {
        Self::Take { len, next: State::Fresh }
    }

    /// Skips to a record found at `next`.
    fn skip_to(next: usize, reason: Reason) -> Self {
        Self::Skip { len: next, reason, next: State::Fresh }
    }
}

impl Framer {
    /// At the start of a stream.
    #[must_use]
    pub fn new() -> Self {
        let (seen, known, usual) = (Codes::default(), Known::default(), Usual::default());
        Self { offset: 0, state: State::Fresh, seen, known, credit: CREDIT, usual }
    }

    /// Position in the stream: bytes consumed so far.
    #[must_use]
    pub fn offset(&self) -> u64 {
        self.offset
    }

    /// Judges the front of the unconsumed bytes; `end`: no more will follow.
    #[inline(always)]
    pub fn step<'a>(&mut self, front: &'a [u8], end: bool) -> Step<'a> {
        if let Some((record, len, next)) = self.go_on(front) {
            let offset = self.consume(len, next);
            return Step::Record { offset, used: len, record };
        }
        // Rebuilt here: if the value came back through memory, the step above would use memory, too.
        match self.step_in_doubt(front, end) {
            Step::Record { offset, used, record } => Step::Record { offset, used, record },
            Step::Bad { offset, skipped, reason } => Step::Bad { offset, skipped, reason },
            Step::Incomplete => Step::Incomplete,
            Step::End(tail) => Step::End(tail),
        }
    }

    /// A step that needs more than an intact log's rows.
    #[cold]
    #[inline(never)]
    fn step_in_doubt<'a>(&mut self, front: &'a [u8], end: bool) -> Step<'a> {
        let verdict = self.judge(front, end);
        self.settle(front, end, verdict)
    }

    /// The rows of the table for intact logs: records are alternately `Vouched` and `Followed`, or all `Vouched`, and as usual.
    /// Returns the record at the front, its length and what is known about the following bytes, in registers; `None` leaves it to
    /// [`Self::judge`]. The record's code is known anyway.
    #[inline(always)]
    fn go_on<'a>(&self, front: &'a [u8]) -> Option<(Record<'a>, usize, State)> {
        let (len, next) = match self.state {
            State::Vouched { len } => (len.into(), self.usual.behind_sure(front.get(len.into()..)?)?),
            State::Followed { len, next } if is_plain(front, len.into()) => (len.into(), State::Vouched { len: next }),
            _ => return None,
        };
        Some((Record::from_message(front.get(LENGTH_FIELD..len)?)?, len, next))
    }

    /// What is known about the `rest` after a record that vouches for itself, if that is enough to accept it.
    fn behind_sure(&mut self, rest: &[u8]) -> Option<State> {
        let state = self.look_behind_sure(rest)?;
        self.usual.learn(rest, state);
        Some(state)
    }

    /// [`Self::behind_sure`], by the complete heads.
    #[inline(always)]
    fn look_behind_sure(&self, rest: &[u8]) -> Option<State> {
        if let Some(next) = sure(rest) {
            return Some(State::Vouched { len: next as Len });
        }
        // For example a copy of a frame before its bfee: what `chain` would find, but for both following records.
        let between = likely(rest, &self.seen)?;
        let next = sure(rest.get(between..)?)?;
        Some(State::Followed { len: between as Len, next: next as Len })
    }

    /// Carries out a verdict, after the search of a `Seek`.
    #[inline(never)]
    fn settle<'a>(&mut self, front: &'a [u8], end: bool, verdict: Verdict) -> Step<'a> {
        match verdict {
            Verdict::Take { len, next } => self.take(front, len, next),
            Verdict::Skip { len, reason, next } => Step::Bad { offset: self.consume(len, next), skipped: len, reason },
            Verdict::Wait => Step::Incomplete,
            Verdict::End(tail) => Step::End(tail),
            Verdict::Seek { from, reason } => {
                let found = self.seek(front, end, from, reason);
                self.settle(front, end, found)
            }
        }
    }

    /// The verdict after a search from position `from` on.
    fn seek(&mut self, front: &[u8], end: bool, from: usize, reason: Reason) -> Verdict {
        match self.search(front, end, from, from + SEARCH) {
            // Only in state `Lost`: the front is judged again, as a record.
            Found::At(0) => {
                self.state = State::Fresh;
                self.judge(front, end)
            }
            Found::At(next) => Verdict::skip_to(next, reason),
            Found::Short => Verdict::Wait,
            Found::Nothing => Verdict::Skip { len: (from + SEARCH).min(front.len()), reason, next: State::Lost },
        }
    }

    /// The rows of the table.
    #[inline(always)]
    fn judge(&mut self, front: &[u8], end: bool) -> Verdict {
        match self.class(front) {
            Front::Sure { len } => self.judge_sure(front, end, len),
            Front::Followed { len, next } => self.judge_followed(front, end, len, State::Vouched { len: next }),
            Front::Doubtful { len, bits } => self.judge_doubtful(front, end, len, bits),
            Front::Damage { from, reason } => Verdict::Seek { from, reason },
            Front::Nothing if end => Verdict::End(Tail::Clean),
            Front::Partial { expected } if end => self.judge_tail(front, expected),
            Front::Nothing | Front::Partial { .. } => Verdict::Wait,
        }
    }

    #[inline(always)]
    fn class(&self, front: &[u8]) -> Front {
        match self.state {
            State::Vouched { len } if usize::from(len) <= front.len() => return Front::Sure { len: len.into() },
            State::Followed { len, next } if usize::from(len) <= front.len() => {
                return Front::Followed { len: len.into(), next };
            }
            _ if front.is_empty() => return Front::Nothing,
            State::Lost => return Front::Damage { from: 0, reason: Reason::StillLost },
            State::Fresh | State::Vouched { .. } | State::Followed { .. } => {}
        }
        match head(front, &self.seen) {
            Head::Short => Front::Partial { expected: None },
            Head::Bad(reason) => Front::Damage { from: 1, reason },
            Head::Good { len, .. } if len > front.len() => Front::Partial { expected: Some(len) },
            Head::Good { len, bits } if bits >= SURE => Front::Sure { len },
            Head::Good { len, bits } => Front::Doubtful { len, bits },
        }
    }

    /// A record that vouches for itself, unless another begins inside it.
    #[inline(always)]
    fn judge_sure(&mut self, front: &[u8], end: bool, len: usize) -> Verdict {
        if let Some(next) = front.get(len..).and_then(|rest| self.behind_sure(rest)) {
            return Verdict::Take { len, next };
        }
        self.judge_sure_alone(front, end, len)
    }

    /// A record that vouches for itself and whose successor does not.
    #[inline(never)]
    fn judge_sure_alone(&mut self, front: &[u8], end: bool, len: usize) -> Verdict {
        match self.chain(front, end, len, 0, Links::Known) {
            Chain::Yes | Chain::End => return Verdict::take(len),
            Chain::Short => return Verdict::Wait,
            Chain::No => {}
        }
        match self.search(front, end, 1, len) {
            Found::At(next) => Verdict::skip_to(next, Reason::Overlapped { expect: len, got: next }),
            Found::Short => Verdict::Wait,
            Found::Nothing if gaps_are_clear(front, len) => Verdict::take(len),
            Found::Nothing => Verdict::Seek { from: len, reason: Reason::GapBits },
        }
    }

    /// A record that needs a witness: its successors, or an MPDU's checksum.
    #[inline(never)]
    fn judge_doubtful(&mut self, front: &[u8], end: bool, len: usize, bits: u32) -> Verdict {
        if let Some(next) = front.get(len..).and_then(sure) {
            return self.judge_followed(front, end, len, State::Vouched { len: next as Len });
        }
        match self.chain(front, end, len, bits, Links::Any) {
            Chain::Short => Verdict::Wait,
            Chain::No => self.judge_alone(front, len, Reason::NotFollowed { code: code_of(front), expect: len }),
            Chain::Yes | Chain::End => self.judge_followed(front, end, len, State::Fresh),
        }
    }

    /// A record with a witness after it, unless one that vouches for itself begins inside; `next` is known of the following bytes.
    #[inline(always)]
    fn judge_followed(&mut self, front: &[u8], end: bool, len: usize, next: State) -> Verdict {
        if is_plain(front, len) {
            return Verdict::Take { len, next };
        }
        match self.search_sure(front, end, len) {
            Found::Nothing => Verdict::Take { len, next },
            Found::Short => Verdict::Wait,
            Found::At(next) => self.judge_alone(front, len, Reason::Overlapped { expect: len, got: next }),
        }
    }

    /// A record supported only by an MPDU's checksum; `reason` contradicts it.
    #[inline(never)]
    fn judge_alone(&mut self, front: &[u8], len: usize, reason: Reason) -> Verdict {
        // Computed once, however often it is requested before enough bytes are available.
        let is_right = self.known.is_right.unwrap_or_else(|| self.checksum(front, len) == Some(true));
        self.known.is_right = Some(is_right);
        if is_right { Verdict::take(len) } else { Verdict::Seek { from: 1, reason } }
    }

    /// The stream ends inside the record at the front, or inside what looks like one.
    fn judge_tail(&mut self, front: &[u8], expected: Option<usize>) -> Verdict {
        if let Found::At(next) = self.search(front, true, 1, front.len()) {
            return Verdict::skip_to(next, Reason::Overlapped { expect: expected.unwrap_or(next), got: next });
        }
        if let (Some(expect), Head::Good { bits: 0, .. }) = (expected, head(front, &self.seen)) {
            return Verdict::skip_to(front.len(), Reason::NotFollowed { code: code_of(front), expect });
        }
        let expected = expected.map(|len| len as u64);
        Verdict::End(Tail::Cut { offset: self.offset, bytes: front.len() as u64, expected })
    }

    #[inline(always)]
    fn take<'a>(&mut self, front: &'a [u8], len: usize, next: State) -> Step<'a> {
        let message = front.get(LENGTH_FIELD..len).and_then(Record::from_message);
        let Some(record) = message else { return Step::Incomplete };
        let offset = self.consume(len, next);
        self.seen.insert(record.code);
        Step::Record { offset, used: len, record }
    }

    /// Moves on; returns the offset of the consumed bytes.
    #[inline(always)]
    fn consume(&mut self, bytes: usize, next: State) -> u64 {
        let offset = self.offset;
        self.offset += bytes as u64;
        if self.credit < CREDIT {
            self.credit = self.credit.saturating_add(bytes.saturating_mul(CREDIT_PER_BYTE)).min(CREDIT);
        }
        self.known = Known::default();
        self.state = next;
        offset
    }
}

/// The code byte of the record at the front.
fn code_of(front: &[u8]) -> u8 {
    front.get(LENGTH_FIELD).copied().unwrap_or(0)
}

/// All steps over bytes that are completely in memory; the last one is [`Step::End`].
pub fn events(bytes: &[u8]) -> impl Iterator<Item = Step<'_>> {
    let mut framer = Framer::new();
    let mut rest = Some(bytes);
    core::iter::from_fn(move || {
        let front = rest?;
        let step = framer.step(front, true);
        rest = match step {
            Step::Record { used, .. } => front.get(used..),
            Step::Bad { skipped, .. } => front.get(skipped..),
            Step::Incomplete | Step::End(_) => None,
        };
        Some(step)
    })
}

/// Bytes of a record before its body: length field and code.
const FRONT: usize = LENGTH_FIELD + 1;
/// The first word of a record: length field, code and the first byte of the body.
type Word = u32;
/// In a bfee's first word, everything but the body's byte counts; that is the uppermost byte, shifted out.
const NOT_OF_BFEE: u32 = 8;
/// In a frame's first word, version and type count, too: the low half of its frame control.
const NOT_OF_FRAME: u32 = 4;

/// The usual records of a log: the shapes of the last bfee and the last frame, with which the next ones are compared first.
///
/// A record's offset follows from the lengths of all records before it. Reading them in sequence stalls the processor at each;
/// comparing a length with a remembered one does not. So the code continues with the remembered length, never with the one read.
/// At first the shapes are of possible records. What is known if they follow a record that vouches for
/// itself is kept in the form in which it is passed on.
#[derive(Clone, Copy, Debug)]
struct Usual {
    bfee: Word,
    chains: [u8; 2],
    csi: [u8; 2],
    frame: Word,
    frame_len: Len,
    vouched: State,
    followed: State,
}

impl Default for Usual {
    /// 3x1 as the WSR driver writes it, and an impossible frame.
    fn default() -> Self {
        let csi = bfee::csi_len(3, 1);
        let length = 1 + bfee::WSR_HEADER + csi;
        let [high, low] = (length as u16).to_be_bytes();
        let len = (LENGTH_FIELD + length) as Len;
        Self {
            bfee: Word::from_le_bytes([high, low, code::BFEE, 0]) << NOT_OF_BFEE,
            chains: [3, 1],
            csi: (csi as u16).to_le_bytes(),
            frame: Word::MAX,
            frame_len: 0,
            vouched: State::Vouched { len },
            followed: State::Fresh,
        }
    }
}

impl Usual {
    /// What is known about the `rest` after a record that vouches for itself, if it begins as usual.
    #[inline(always)]
    fn behind_sure(&self, rest: &[u8]) -> Option<State> {
        if self.is_bfee(rest)? {
            return Some(self.vouched);
        }
        let word = rest.first_chunk().map(|word| Word::from_le_bytes(*word))?;
        (word << NOT_OF_FRAME == self.frame && self.is_bfee(rest.get(self.frame_len.into()..)?)?)
            .then_some(self.followed)
    }

    /// True if the record at the front is a bfee as usual; `None` if there are too few bytes.
    #[inline(always)]
    fn is_bfee(&self, bytes: &[u8]) -> Option<bool> {
        let (word, chains, csi) = deciding(bytes.first_chunk()?);
        Some(word << NOT_OF_BFEE == self.bfee && chains == self.chains && csi == self.csi)
    }

    /// Remembers the records after one that vouches for itself: a frame, if `state` is `Followed` because of one, and a bfee.
    fn learn(&mut self, rest: &[u8], state: State) {
        let (between, len) = match state {
            State::Vouched { len } => (0, len),
            State::Followed { len, next } => (len, next),
            State::Fresh | State::Lost => return,
        };
        let Some(bytes) = rest.get(between.into()..).and_then(|rest| rest.first_chunk()) else { return };
        let (word, chains, csi) = deciding(bytes);
        let [.., code, _] = word.to_le_bytes();
        if code != code::BFEE {
            return;
        }
        (self.bfee, self.chains, self.csi, self.vouched) = (word << NOT_OF_BFEE, chains, csi, State::Vouched { len });
        // The frame before it may have another length than the known one.
        (self.frame, self.frame_len, self.followed) = (Word::MAX, 0, State::Fresh);
        if let Some(front) = rest.first_chunk()
            && let word = Word::from_le_bytes(*front)
            && word.to_le_bytes()[LENGTH_FIELD] == code::MPDU
        {
            (self.frame, self.frame_len, self.followed) = (word << NOT_OF_FRAME, between, state);
        }
    }
}

/// The bytes of a bfee's head that identify it: its first word, its chains and its CSI length.
#[inline(always)]
fn deciding(head: &[u8; LONGEST_HEAD]) -> (Word, [u8; 2], [u8; 2]) {
    let at = |at: usize| [head[FRONT + at], head[FRONT + at + 1]];
    (Word::from_le_bytes([head[0], head[1], head[2], head[3]]), at(offset::N_RX), at(offset::LEN))
}

/// Records that are examined after a doubtful one.
const MAX_LINKS: usize = 6;

/// Bytes whose checksum may be computed at once, and per byte consumed: keeps the work linear if every few bytes pretend to be a
/// long frame. A frame that is not checked for lack of credit counts as unchecked.
const CREDIT: usize = 64 * 1024;
const CREDIT_PER_BYTE: usize = 8;

/// Result of examining the following records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Chain {
    Yes,
    /// Yes, but only because the stream ends there.
    End,
    No,
    Short,
}

/// Which records may stand between a doubtful one and its witness.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Links {
    /// Those of codes that are known or were met before.
    Known,
    /// Any.
    Any,
}

/// Result of a search.
enum Found {
    At(usize),
    Nothing,
    Short,
}

impl Framer {
    /// Follows the lengths from the record at the front until a record vouches for them.
    ///
    /// `len` is that record's length, `bits` its own evidence. A repeated code counts as known.
    fn chain(&self, front: &[u8], end: bool, len: usize, mut bits: u32, links: Links) -> Chain {
        let mut seen = self.seen;
        note(&mut seen, front);
        let mut at = len;
        for _ in 0..MAX_LINKS {
            let rest = front.get(at..).unwrap_or_default();
            if at >= front.len() && end {
                return if at == front.len() { Chain::End } else { Chain::No };
            }
            match head(rest, &seen) {
                Head::Short if end => return Chain::End,
                Head::Short => return Chain::Short,
                Head::Bad(_) => return Chain::No,
                Head::Good { bits: 0, .. } if links == Links::Known => return Chain::No,
                Head::Good { len, bits: more } => {
                    bits += more;
                    at += len;
                }
            }
            if bits >= SURE {
                return Chain::Yes;
            }
            note(&mut seen, rest);
        }
        Chain::No
    }

    /// The first position of `from..to` at which a record can be accepted.
    fn search(&mut self, front: &[u8], end: bool, from: usize, to: usize) -> Found {
        for at in from.max(self.known.searched)..to.min(front.len()) {
            let rest = front.get(at..).unwrap_or_default();
            let verdict = match head(rest, &self.seen) {
                Head::Short if end => Chain::No,
                Head::Short => Chain::Short,
                Head::Good { bits, .. } if bits >= SURE => Chain::Yes,
                Head::Good { len, bits } if bits > 0 => self.candidate(rest, end, len, bits),
                _ => Chain::No,
            };
            match verdict {
                Chain::Yes => return Found::At(at),
                Chain::Short if !end => {
                    self.known.searched = at;
                    return Found::Short;
                }
                _ => {}
            }
        }
        if front.len() < to && !end {
            self.known.searched = front.len();
            return Found::Short;
        }
        // An earlier search may have come further before it ran out of bytes.
        self.known.searched = self.known.searched.max(to);
        Found::Nothing
    }

    /// Whether a record after damage that does not vouch for itself can be accepted.
    ///
    /// It needs witnesses after it, not just the stream's end. An MPDU needs both them and its checksum, because among many positions
    /// one or the other occurs by chance.
    fn candidate(&mut self, rest: &[u8], end: bool, len: usize, bits: u32) -> Chain {
        let chain = self.chain(rest, end, len, bits, Links::Known);
        if !matches!(chain, Chain::Yes | Chain::End) {
            return chain;
        }
        match self.checksum(rest, len) {
            Some(true) => Chain::Yes,
            Some(false) => Chain::No,
            None => chain,
        }
    }

    /// Whether an MPDU's checksum is correct; `None` for other records and without credit.
    fn checksum(&mut self, front: &[u8], len: usize) -> Option<bool> {
        let record = front.get(LENGTH_FIELD..len).and_then(Record::from_message)?;
        if record.code != code::MPDU {
            return None;
        }
        self.credit = self.credit.checked_sub(len)?;
        Some(fcs_is_good(record.body))
    }

    /// The first position inside a record of `len` bytes at which another begins that vouches for itself.
    #[inline(never)]
    fn search_sure(&mut self, front: &[u8], end: bool, len: usize) -> Found {
        let mut at = self.known.searched_sure.max(1);
        while at < whole_heads(front, len) {
            let to = whole_heads(front, len).min(at + STRETCH);
            if may_vouch(front, at, to)
                && let Some(found) = (at..to).find(|at| sure_at(front, *at))
            {
                return Found::At(found);
            }
            at = to;
        }
        for at in at..len {
            match head(front.get(at..).unwrap_or_default(), &self.seen) {
                Head::Good { bits, .. } if bits >= SURE => return Found::At(at),
                Head::Short if !end => {
                    self.known.searched_sure = at;
                    return Found::Short;
                }
                _ => {}
            }
        }
        Found::Nothing
    }
}

/// True if a record that vouches for itself begins at a position.
fn sure_at(front: &[u8], at: usize) -> bool {
    front.get(at..).and_then(sure).is_some()
}

/// Positions that [`Framer::search_sure`] examines together.
const STRETCH: usize = 256;

/// The end of the positions inside a record of `len` bytes at which a complete head fits.
fn whole_heads(front: &[u8], len: usize) -> usize {
    len.min((front.len() + 1).saturating_sub(LONGEST_HEAD))
}

/// True if two bytes of each position suffice to show that no record inside one of `len` bytes vouches for itself.
#[inline(always)]
fn is_plain(front: &[u8], len: usize) -> bool {
    let Some(heads) = front.get(..len + LONGEST_HEAD - 1) else { return false };
    match (heads.get(1..len), heads.get(1 + LENGTH_FIELD..len + LENGTH_FIELD)) {
        (Some(highs), Some(codes)) => !any_vouches(highs, codes),
        _ => false,
    }
}

/// False if no record that vouches for itself begins in `from..to`: judges by its code and by its length, which is below
/// [`VOUCHING_LENGTHS`].
#[inline(always)]
fn may_vouch(front: &[u8], from: usize, to: usize) -> bool {
    match (front.get(from..to), front.get(from + LENGTH_FIELD..to + LENGTH_FIELD)) {
        (Some(highs), Some(codes)) => any_vouches(highs, codes),
        _ => true,
    }
}

/// 0 if a head with these first and third bytes may vouch for itself. It has no comparisons, which wide vectors turn into masks.
#[inline(always)]
fn miss(high: u8, code: u8) -> u8 {
    let [bfee, noise] = VOUCHING_CODES;
    (code ^ bfee).min(code ^ noise) | high.saturating_sub(VOUCHING_LENGTHS - 1)
}

/// [`may_vouch`] for the first and third bytes of the positions, in blocks that a compiler can vectorise.
#[inline(always)]
fn any_vouches(highs: &[u8], codes: &[u8]) -> bool {
    const BLOCK: usize = 64;
    let (Some(last_highs), Some(last_codes)) = (highs.last_chunk::<BLOCK>(), codes.last_chunk::<BLOCK>()) else {
        return highs.iter().zip(codes).any(|(high, code)| miss(*high, *code) == 0);
    };
    // The last block overlaps the previous one.
    let mut least = nearer([u8::MAX; BLOCK], last_highs, last_codes);
    let (mut highs, mut codes) = (highs, codes);
    while let (Some((first_highs, more_highs)), Some((first_codes, more_codes))) =
        (highs.split_first_chunk(), codes.split_first_chunk())
    {
        least = nearer(least, first_highs, first_codes);
        (highs, codes) = (more_highs, more_codes);
    }
    let mut any = false;
    for least in least {
        any |= least == 0;
    }
    any
}

/// For each position in a block, the smaller of [`miss`] and the previous value.
#[inline(always)]
fn nearer<const BLOCK: usize>(mut least: [u8; BLOCK], highs: &[u8; BLOCK], codes: &[u8; BLOCK]) -> [u8; BLOCK] {
    for k in 0..BLOCK {
        least[k] = least[k].min(miss(highs[k], codes[k]));
    }
    least
}

/// Remembers the code of the record at the front, unless the record only repeats one byte.
fn note(seen: &mut Codes, front: &[u8]) {
    if let [high, low, code, ..] = front
        && (high != code || low != code)
    {
        seen.insert(*code);
    }
}

/// True unless the record is a bfee with a set bit in the gaps.
fn gaps_are_clear(front: &[u8], len: usize) -> bool {
    match front.get(LENGTH_FIELD..len).and_then(Record::from_message) {
        Some(Record { code: code::BFEE, body }) => Bfee::new_checked(body).is_ok_and(|bfee| bfee.gaps_are_clear()),
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bfee::Iq;
    use crate::mpdu;
    use proptest::collection::vec;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// Records that follow one that vouches for itself: many shapes, frames of many types, noise, and impossible ones.
    fn follower() -> impl Strategy<Value = Vec<u8>> {
        let bfee =
            (0..3_u8, 1..4_u8, 1..4_u8, any::<bool>()).prop_map(|(seed, rx, tx, wsr)| bfee_record(seed, rx, tx, wsr));
        let frame =
            (0..3_u8, prop::sample::select(vec![0_usize, 40, 101])).prop_map(|(seed, len)| mpdu_record(seed, len));
        let other = prop::sample::select(vec![code::MPDU, code::NOISE, 0x42]);
        let other = (other, any::<[u8; 4]>(), prop::sample::select(vec![4_usize, 14, 15, 40]));
        let other =
            other.prop_map(|(code, start, len)| framed(code, &start.into_iter().cycle().take(len).collect::<Vec<_>>()));
        prop_oneof![4 => bfee, 4 => frame, 1 => other]
    }

    /// Checks that the comparison with the usual shapes after `met` agrees with the complete heads of `rest`, or finds nothing.
    fn is_as_a_look_finds(met: &[Vec<u8>], rest: &[u8]) -> bool {
        let mut framer = Framer::new();
        for met in met {
            let _ = framer.behind_sure(met);
        }
        let usual = framer.usual.behind_sure(rest);
        usual.is_none() || usual == framer.look_behind_sure(rest)
    }

    #[test]
    fn the_usual_shape_is_not_mistaken_for_another() {
        let behind = bfee_record(0, 1, 1, false);
        let frame_before = |n_tx| [mpdu_record(1, 101), bfee_record(1, 3, n_tx, true), behind.clone()].concat();
        // The frame was followed by another bfee than the one met last.
        let met = [frame_before(1), [bfee_record(2, 3, 2, true), behind.clone()].concat()];
        assert!(is_as_a_look_finds(&met, &frame_before(2)));
        // A frame of a type that does not exist.
        let mut other = frame_before(1);
        other[LENGTH_FIELD + 1] |= 0x0c;
        assert!(is_as_a_look_finds(&[frame_before(1)], &other));
        // Noise and damage.
        let noise = |dbm: i32| [framed(code::NOISE, &dbm.to_le_bytes()), behind.clone()].concat();
        assert!(is_as_a_look_finds(&[noise(-92)], &noise(92)));
    }

    proptest! {
        /// The comparison agrees with the complete heads; a shape just learnt is usual; with one changed byte of those that identify it, it
        /// is not.
        #[test]
        fn the_usual_shapes_agree_with_complete_heads(
            logs in vec((follower(), follower()), 1..6), at in 0..200_usize, byte: u8,
        ) {
            let mut framer = Framer::new();
            for (first, second) in logs {
                let mut rest = [first, second, bfee_record(0, 1, 1, false)].concat();
                let found = framer.look_behind_sure(&rest);
                let usual = framer.usual.behind_sure(&rest);
                prop_assert!(usual.is_none() || usual == found);
                prop_assert_eq!(framer.behind_sure(&rest), found);
                let is_kept = |state| match state {
                    State::Vouched { .. } => rest[LENGTH_FIELD] == code::BFEE,
                    State::Followed { len, .. } => rest[LENGTH_FIELD] == code::MPDU && rest[usize::from(len) + LENGTH_FIELD] == code::BFEE,
                    State::Fresh | State::Lost => false,
                };
                prop_assert!(!found.is_some_and(is_kept) || framer.usual.behind_sure(&rest) == found);
                let at = at % rest.len();
                rest[at] = byte;
                let usual = framer.usual.behind_sure(&rest);
                prop_assert!(usual.is_none() || usual == framer.look_behind_sure(&rest));
                let is_same_of_fewer_bytes = (0..rest.len()).all(|len| {
                    let (usual, whole) = (framer.usual.behind_sure(&rest[..len]), framer.look_behind_sure(&rest[..len]));
                    usual.is_none() || usual == whole
                });
                prop_assert!(is_same_of_fewer_bytes);
            }
        }
    }

    /// Bytes in which complete and almost complete heads of bfees and noise records are frequent.
    fn bytes() -> impl Strategy<Value = Vec<u8>> {
        let noise = Just(vec![0, 5, 0xD0, 0xA6, 0xFF, 0xFF, 0xFF]);
        let bfee: Vec<u8> = [[0, 93, 0xBB].as_slice(), &[0; 8], &[1, 1], &[0; 6], &[72, 0, 0, 0]].concat();
        let mpdu = Just(vec![0, 40, code::MPDU, 8, 0]);
        let one = prop::sample::select(vec![0_u8, 1, 2, 3, 5, 93, 0xBB, 0xD0, 0xFF]).prop_map(|byte| vec![byte]);
        let part = prop_oneof![60 => one, 1 => noise, 1 => Just(bfee), 1 => mpdu, 8 => any::<u8>().prop_map(|byte| vec![byte])];
        vec(part, 1..700).prop_map(|parts| parts.concat())
    }

    proptest! {
        #[test]
        fn quick_checks_agree_with_heads(bytes in bytes(), codes in vec(any::<u8>(), 0..5)) {
            let mut seen = Codes::default();
            codes.iter().for_each(|code| seen.insert(*code));
            for at in 0..=bytes.len() {
                let rest = &bytes[at..];
                let (is_sure, is_likely) = match head(rest, &seen) {
                    Head::Good { len, bits } if bits >= SURE => (Some(len), None),
                    Head::Good { len, bits } if bits > 0 => (None, Some(len)),
                    _ => (None, None),
                };
                prop_assert_eq!((sure(rest), likely(rest, &seen)), (is_sure, is_likely), "at {}", at);
            }
        }

        #[test]
        fn a_search_equals_a_check_of_every_position(bytes in bytes(), share in 0.0..1.0_f64, end: bool) {
            let mut framer = Framer::new();
            let len = 1 + (share * (bytes.len() - 1) as f64) as usize;
            let whole = whole_heads(&bytes, len);
            let first = (1..len).find(|at| sure_at(&bytes, *at));
            prop_assert!(first.is_none() || !is_plain(&bytes, len));
            for from in (1..whole).step_by(7) {
                let seen = may_vouch(&bytes, from, whole);
                prop_assert!(seen || (from..whole).all(|at| !sure_at(&bytes, at)));
            }
            let short = (1..len).find(|at| matches!(head(&bytes[*at..], &framer.seen), Head::Short));
            match framer.search_sure(&bytes, end, len) {
                Found::At(at) => prop_assert_eq!(Some(at), first),
                Found::Nothing => prop_assert!(first.is_none() && (end || short.is_none())),
                Found::Short => prop_assert!(!end && short.is_some_and(|short| first.is_none_or(|first| short < first))),
            }
        }
    }

    /// A bfee record whose samples depend on `seed`.
    fn bfee_record(seed: u8, n_rx: u8, n_tx: u8, wsr: bool) -> Vec<u8> {
        let wsr = wsr.then(|| bfee::Wsr { tv_sec: 1, frame_count: Some(seed.into()), ..bfee::Wsr::default() });
        let timestamp_low = u32::from(seed) << 20 | 0x1234;
        let repr = bfee::Repr { n_rx, n_tx, bfee_count: seed.into(), timestamp_low, wsr, ..bfee::Repr::default() };
        let mut state = u32::from(seed) + 1;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as i8
        };
        let csi: Vec<Iq> = (0..repr.samples()).map(|_| Iq { i: next(), q: next() }).collect();
        let mut body = vec![0; repr.body_len()];
        repr.emit(&csi, &mut body).unwrap();
        framed(code::BFEE, &body)
    }

    fn mpdu_record(seed: u8, len: usize) -> Vec<u8> {
        let payload: Vec<u8> = (0..len).map(|k| (k as u8).wrapping_mul(37) ^ seed).collect();
        let addr = crate::Mac([0, 0x16, 0xea, 0x12, 0x34, seed]);
        let repr = mpdu::Repr {
            frame_control: 8,
            duration_us: 48,
            addr1: addr,
            addr2: addr,
            addr3: addr,
            seq_ctrl: 0,
            payload: &payload,
        };
        let mut body = vec![0; repr.emit_len()];
        repr.emit(&mut body).unwrap();
        framed(code::MPDU, &body)
    }

    fn framed(code: u8, body: &[u8]) -> Vec<u8> {
        let record = Record { code, body };
        let mut out = vec![0; record.emit_len()];
        assert_eq!(record.emit(&mut out), Ok(out.len()));
        out
    }

    /// WSR, stock, with MPDUs, with noise and unknown codes.
    fn logs() -> Vec<Vec<Vec<u8>>> {
        let wsr = (0..6).map(|k| bfee_record(k, 3, 1, true)).collect();
        let sizes = [(1, 1), (3, 3), (2, 1), (3, 2), (1, 3), (2, 2)];
        let stock = (0..6).map(|k| bfee_record(k, sizes[usize::from(k)].0, sizes[usize::from(k)].1, false)).collect();
        let frames =
            (0..8).map(|k| if k % 2 == 0 { mpdu_record(k, 101) } else { bfee_record(k, 3, 1, false) }).collect();
        let only_mpdu = (0..9).map(|k| mpdu_record(k, 40 + usize::from(k))).collect();
        let mut mixed = Vec::new();
        for k in 0..4 {
            mixed.push(bfee_record(k, 2, 1, k % 2 == 0));
            mixed.push(framed(code::NOISE, &(-92 - i32::from(k)).to_le_bytes()));
            mixed.push(framed(0x42, &[k; 30]));
        }
        vec![wsr, stock, frames, only_mpdu, mixed]
    }

    fn records(bytes: &[u8]) -> Vec<Vec<u8>> {
        events(bytes)
            .filter_map(|step| match step {
                Step::Record { record, .. } => Some(framed(record.code, record.body)),
                _ => None,
            })
            .collect()
    }

    /// The damaged stretches of a stream: offset, length, reason.
    fn damage(bytes: &[u8]) -> Vec<(u64, usize, Reason)> {
        let bad = events(bytes).filter_map(|step| match step {
            Step::Bad { offset, skipped, reason } => Some((offset, skipped, reason)),
            _ => None,
        });
        bad.collect()
    }

    /// Intact records that were not found.
    fn missing(intact: &[Vec<u8>], found: &[Vec<u8>]) -> usize {
        let mut found = found.iter();
        intact.iter().filter(|record| !found.clone().any(|f| f == *record && found.by_ref().any(|g| g == f))).count()
    }

    /// The log without the record in which byte `at` lies, and that record's number.
    fn without(log: &[Vec<u8>], at: usize) -> Vec<Vec<u8>> {
        let mut end = 0;
        let hit = log.iter().position(|record| {
            end += record.len();
            at < end
        });
        log.iter().enumerate().filter(|(k, _)| Some(*k) != hit).map(|(_, record)| record.clone()).collect()
    }

    #[test]
    fn records_that_continue_after_their_csi_are_accepted() {
        let padded = |seed, behind: usize| {
            let record = bfee_record(seed, 3, 1, seed % 2 == 0);
            framed(code::BFEE, &[&record[3..], &vec![0; behind]].concat())
        };
        for behind in [1, 3, 5] {
            let log: Vec<u8> = (0..9).flat_map(|seed| padded(seed, behind)).collect();
            let steps: Vec<_> = events(&log).collect();
            assert_eq!(steps.len(), 10);
            assert_eq!(steps.last(), Some(&Step::End(Tail::Clean)));
            for step in &steps[..9] {
                let Step::Record { record, .. } = step else { panic!("{step:?}") };
                assert_eq!(bfee::Bfee::new_checked(record.body).unwrap().behind_csi().len(), behind);
            }
            // A wrong length field does not count as such a continuation.
            let mut damaged = (0..9).flat_map(|seed| bfee_record(seed, 3, 1, true)).collect::<Vec<u8>>();
            damaged[1] += behind as u8;
            let found = events(&damaged).filter(|step| matches!(step, Step::Record { .. })).count();
            assert_eq!(found, 8);
        }
    }

    #[test]
    fn complete_records_end_at_their_lengths() {
        let bytes = [0, 2, 0xBB, 1, 0, 1, 0xC1, 0, 3, 1, 2, 3];
        let all: Vec<_> = (0..=bytes.len()).map(|upto| whole_records(&bytes, upto)).collect();
        assert_eq!(all[3], (0, 0));
        assert_eq!(all[4], (4, 1));
        assert_eq!(all[7], (7, 2));
        assert_eq!(all[11], (7, 2));
        assert_eq!(all[12], (12, 3));
    }

    #[test]
    fn intact_logs_are_read_whole() {
        for log in logs() {
            let whole = log.concat();
            assert!(records(&whole) == log);
            assert_eq!(events(&whole).last(), Some(Step::End(Tail::Clean)));
        }
    }

    #[test]
    fn records_of_unknown_codes_are_kept() {
        let unknown = |code: u8| framed(code, &[code; 40]);
        let mut log = vec![bfee_record(0, 3, 1, true)];
        log.extend((0..20).map(|_| unknown(0x42)));
        log.extend((0..20).map(|k| unknown(0x43 + k % 2)));
        log.push(framed(0x50, &[]));
        log.push(bfee_record(1, 3, 1, true));
        for log in [&log[..], &log[1..], &log[..21]] {
            assert!(records(&log.concat()) == log);
        }
    }

    #[test]
    fn a_lost_byte_costs_its_record_and_at_most_one_more() {
        for (which, log) in logs().iter().enumerate() {
            let whole = log.concat();
            let last = whole.len() - log.last().unwrap().len();
            let mut lost = 0;
            for at in 0..last {
                let mut cut = whole.clone();
                cut.remove(at);
                let missing = missing(&without(log, at), &records(&cut));
                lost += missing;
                assert!(missing <= 1, "log {which}, byte {at}: {missing} intact records lost");
            }
            // Only a record of unknown code right after the damage may be lost with it.
            let allowed = if which == 4 { last / 2 } else { 0 };
            assert!(lost <= allowed, "log {which}: {lost} intact records lost over all {last} cuts");
        }
    }

    #[test]
    fn garbage_costs_its_record_and_at_most_one_more() {
        let mut state = 7_u32;
        let mut next = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        for (which, log) in logs().iter().enumerate() {
            let whole = log.concat();
            let mut lost = 0;
            for at in 0..whole.len() {
                let garbage: Vec<u8> = match at % 3 {
                    0 => vec![0; 100],
                    1 => vec![0xff; 100],
                    _ => (0..100).map(|_| next()).collect(),
                };
                let mut damaged = whole.clone();
                damaged.splice(at..at, garbage);
                let missing = missing(&without(log, at), &records(&damaged));
                lost += missing;
                assert!(missing <= 1, "log {which}, byte {at}: {missing} intact records lost");
            }
            let allowed = if which == 4 { whole.len() / 2 } else { 0 };
            assert!(lost <= allowed, "log {which}: {lost} intact records lost over all {} places", whole.len());
        }
    }

    #[test]
    fn a_cut_tail_is_reported_with_its_place() {
        let whole = logs()[0].concat();
        let last = 5 * 233;
        for len in last + 1..whole.len() {
            let steps: Vec<_> = events(&whole[..len]).collect();
            let expected = (len - last >= 23).then_some(233);
            let tail = Tail::Cut { offset: last as u64, bytes: (len - last) as u64, expected };
            assert_eq!(steps.last(), Some(&Step::End(tail)));
            assert_eq!(steps.len(), 6);
            assert!(!tail.is_unflushed_buffer());
        }
        let tail = Tail::Cut { offset: 4000, bytes: 96, expected: Some(233) };
        assert!(tail.is_unflushed_buffer() && !Tail::Clean.is_unflushed_buffer());
    }

    #[test]
    fn damage_has_a_reason_with_numbers() {
        let mut log: Vec<Vec<u8>> = (0..4).map(|k| bfee_record(k, 3, 1, true)).collect();
        let reason_of = |log: &[Vec<u8>]| {
            let bytes = log.concat();
            let bad = damage(&bytes);
            assert_eq!(bad.len(), 1, "{bad:?}");
            assert_eq!(records(&bytes).len(), log.len() - 1);
            bad[0]
        };
        let mut with = |change: &dyn Fn(&mut Vec<u8>)| {
            let intact = log[1].clone();
            change(&mut log[1]);
            let reason = reason_of(&log);
            log[1] = intact;
            reason
        };
        assert_eq!(with(&|r| r[..2].fill(0)), (233, 233, Reason::ZeroLength));
        assert_eq!(with(&|r| r[0] = 0x20), (233, 233, Reason::ImpossibleLength { got: 0x20e7, max: 8192 }));
        assert_eq!(
            with(&|r| r[..2].copy_from_slice(&[0x20, 0])),
            (233, 233, Reason::Overlapped { expect: 8194, got: 233 })
        );
        assert_eq!(with(&|r| r[1] = 0xe8), (233, 233, Reason::NotFollowed { code: code::BFEE, expect: 234 }));
        assert_eq!(with(&|r| r[1] = 0x40), (233, 233, Reason::BfeeLength { got: 0x40 }));
        let chains = |n_rx| Reason::Bfee(bfee::Error::Chains { n_rx, n_tx: 1 });
        assert_eq!(with(&|r| r[11] = 0), (233, 233, chains(0)));
        assert_eq!(with(&|r| r[11] = 4), (233, 233, chains(4)));
        let seven = Reason::Bfee(bfee::Error::Chains { n_rx: 7, n_tx: 7 });
        assert_eq!(with(&|r| *r = framed(code::BFEE, &[7; 8191])), (233, 8194, seven));
        let overlapped = Reason::Overlapped { expect: 233, got: 232 };
        assert_eq!(with(&|r| r.truncate(232)), (233, 232, overlapped));
        assert_eq!(with(&|r| drop(r.splice(50..50, [0x55; 10]))), (233, 243, Reason::GapBits));
    }

    #[test]
    fn other_files_yield_no_record() {
        let text = "It was a bright cold day in April, and the clocks were striking thirteen.\n".repeat(3000);
        let same = |byte: u8| vec![byte; 100_000];
        for bytes in [text.as_bytes(), b"hi\n", b"x", &same(0), &same(0x41), &same(0xff), &same(b'\n')] {
            assert!(records(bytes).is_empty());
        }
        assert_eq!(events(&[]).collect::<Vec<_>>(), [Step::End(Tail::Clean)]);
        // Damage of any length is one report and its continuations.
        let zeros = same(0);
        let reasons: Vec<_> = events(&zeros).collect();
        assert!(matches!(reasons[0], Step::Bad { offset: 0, reason: Reason::ZeroLength, .. }));
        let skipped: usize = reasons.iter().map(|s| if let Step::Bad { skipped, .. } = s { *skipped } else { 0 }).sum();
        assert_eq!(skipped, zeros.len());
        let middle = &reasons[1..reasons.len() - 1];
        assert!(middle.iter().all(|step| matches!(step, Step::Bad { reason: Reason::StillLost, .. })));
    }

    #[test]
    fn random_bytes_yield_no_record() {
        let mut state = 1_u64;
        let bytes: Vec<u8> = (0..4_000_000)
            .map(|_| {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                state as u8
            })
            .collect();
        assert!(records(&bytes).is_empty());
    }

    /// The steps if the stream arrives in chunks of the given sizes, repeated.
    fn in_chunks(bytes: &[u8], sizes: &[usize]) -> Vec<(u64, usize, Option<Reason>)> {
        let (mut framer, mut steps) = (Framer::new(), Vec::new());
        let (mut from, mut to) = (0, 0);
        let mut sizes = sizes.iter().cycle();
        loop {
            match framer.step(&bytes[from..to], to == bytes.len()) {
                Step::Record { offset, used, record } => {
                    assert_eq!(used, record.emit_len());
                    steps.push((offset, used, None));
                    from += used;
                }
                Step::Bad { offset, skipped, reason } => {
                    assert!(skipped > 0);
                    steps.push((offset, skipped, Some(reason)));
                    from += skipped;
                }
                Step::Incomplete => {
                    assert!(to - from < LOOKAHEAD, "{LOOKAHEAD} bytes are said to be enough");
                    to = (to + sizes.next().unwrap()).min(bytes.len());
                }
                Step::End(_) => return steps,
            }
            assert_eq!(framer.offset(), from as u64);
        }
    }

    proptest! {
        /// The search for a record inside another tries only these codes.
        #[test]
        fn only_vouching_codes_vouch_for_themselves(mut bytes in vec(any::<u8>(), 23..80), code in any::<u8>(), length in 1_u16..700) {
            bytes[..2].copy_from_slice(&length.to_be_bytes());
            bytes[2] = code;
            let head = head(&bytes, &Codes::default());
            let sure = matches!(head, Head::Good { bits, .. } if bits >= SURE);
            prop_assert!(!sure || VOUCHING_CODES.contains(&code));
            prop_assert!(head != Head::Short);
        }
    }

    #[test]
    fn existing_frame_versions_and_types_are_evidence() {
        let bits = |control: u8, length: u8| match head(&[0, length, code::MPDU, control], &Codes::default()) {
            Head::Good { bits, .. } => bits,
            other => panic!("{other:?}"),
        };
        // Management, control and data of version 0, of any subtype; not type 3 or other versions.
        for (control, plausible) in
            [(0x00, true), (0xd4, true), (0x08, true), (0x88, true), (0x0c, false), (0x09, false), (0x02, false)]
        {
            assert_eq!(bits(control, 60), if plausible { 13 } else { 0 }, "{control:#04x}");
        }
        // An acknowledgement has 14 bytes, and the code is counted.
        assert_eq!([bits(0xd4, 14), bits(0xd4, 15)], [0, 13]);
    }

    #[test]
    fn known_codes_and_lengths_are_evidence() {
        let bits = |seen: &Codes, bytes: &[u8]| match head(bytes, seen) {
            Head::Good { len, bits } => (len, bits),
            other => panic!("{other:?}"),
        };
        let none = Codes::default();
        // Reports of an aggregated transmission have nine bytes; with another length only the code counts.
        assert_eq!(bits(&none, &[0, 9, code::TX_BLOCK_AGG]), (11, 24));
        assert_eq!([8, 10].map(|length| bits(&none, &[0, length, code::TX_BLOCK_AGG]).1), [8, 8]);
        // An unknown code, until it was met in this log.
        let mut seen = Codes::default();
        seen.insert(0x42);
        assert_eq!([bits(&none, &[1, 2, 0x42]), bits(&seen, &[1, 2, 0x42])], [(0x104, 0), (0x104, 8)]);
        // Noise is four bytes, -255 to -1 dBm.
        let noise = |length: u8, dbm: i32| [&[0, length, code::NOISE][..], &dbm.to_le_bytes()].concat();
        for (length, dbm, is_noise) in
            [(5, -92, true), (5, -255, true), (5, -1, true), (5, 0, false), (5, -256, false), (6, -92, false)]
        {
            let bytes = noise(length, dbm);
            assert_eq!(
                bits(&none, &bytes),
                (2 + usize::from(length), if is_noise { SURE } else { 0 }),
                "{length}, {dbm}"
            );
            assert_eq!((sure(&bytes).is_some(), likely(&bytes, &none)), (is_noise, None), "{length}, {dbm}");
        }
        assert_eq!(head(&noise(5, -92)[..6], &none), Head::Short);
    }

    #[test]
    fn an_unfollowed_record_is_reported_with_its_code() {
        let good = [bfee_record(1, 3, 1, true), bfee_record(2, 3, 1, true)];
        let stream = [framed(0x42, &[0; 10]), vec![0; 7], good.concat()].concat();
        assert_eq!(damage(&stream), [(0, 20, Reason::NotFollowed { code: 0x42, expect: 13 })]);
        assert!(records(&stream) == good);
        // The stream's end does not vouch for half a record either.
        let half = [good.concat(), framed(0x42, &[0; 10])[..9].to_vec()].concat();
        assert_eq!(damage(&half), [(466, 9, Reason::NotFollowed { code: 0x42, expect: 13 })]);
    }

    #[test]
    fn any_number_of_frames_with_wrong_checksums_is_refused() {
        // 120 KB of them, each after foreign bytes and before a bfee: only the checksum shows that it is damaged.
        let mut wrong = mpdu_record(3, 3000);
        *wrong.last_mut().unwrap() ^= 1;
        let round =
            |k: u8| [bfee_record(k, 3, 1, true), vec![0xff; 5], wrong.clone(), bfee_record(k + 100, 3, 1, true)];
        let stream: Vec<u8> = (0..40).flat_map(|k| round(k).concat()).collect();
        let bfees: Vec<Vec<u8>> = (0..40).flat_map(|k| [k, k + 100]).map(|k| bfee_record(k, 3, 1, true)).collect();
        assert!(records(&stream) == bfees);
    }

    #[test]
    fn records_whose_unknown_code_equals_their_length_are_kept() {
        for length in [0x42_u8, 0x13] {
            let log = vec![framed(length, &vec![7; usize::from(length) - 1]); 20];
            assert!(records(&log.concat()) == log, "{length}");
        }
    }

    /// Part of a bfee is lost, and the bytes where its length ends, inside the next record, happen to lead to the one after that.
    #[test]
    fn a_chance_successor_hides_no_record() {
        let [cut, mut hidden, last] = [1, 2, 3].map(|k| bfee_record(k, 3, 1, true));
        let kept = 133;
        let lands = cut.len() - kept;
        let leads = u16::try_from(hidden.len() - lands - 2).unwrap().to_be_bytes();
        hidden[lands..lands + 3].copy_from_slice(&[leads[0], leads[1], 0x42]);
        let stream = [&cut[..kept], &hidden, &last].concat();
        assert_eq!(damage(&stream), [(0, kept, Reason::Overlapped { expect: 233, got: kept })]);
        assert!(records(&stream) == [hidden, last]);
    }

    /// A frame loses as many bytes as the following bfee has: where its length ends, a record begins.
    #[test]
    fn a_bfee_in_place_of_a_frames_end_is_found() {
        for (n_rx, n_tx, wsr) in [(1, 1, false), (3, 1, true), (2, 3, false), (3, 3, false), (3, 3, true)] {
            let [first, hidden, last] = [1, 2, 3].map(|k| bfee_record(k, n_rx, n_tx, wsr));
            let frame = mpdu_record(4, 900);
            let kept = frame.len() - hidden.len();
            let stream = [&first, &frame[..kept], &hidden, &last].concat();
            let reason = Reason::Overlapped { expect: frame.len(), got: kept };
            assert_eq!(damage(&stream), [(first.len() as u64, kept, reason)], "{n_rx} x {n_tx}");
            assert!(records(&stream) == [first, hidden, last], "{n_rx} x {n_tx}");
        }
    }

    #[test]
    fn foreign_bytes_before_a_record_cost_no_record() {
        let log = [bfee_record(1, 3, 1, true), bfee_record(2, 2, 2, false)];
        for (foreign, byte) in (0..40).chain([16_380, 20_000, 33_000, 50_000]).flat_map(|n| [(n, 0x00), (n, 0xff)]) {
            let stream = [vec![byte; foreign], log.concat()].concat();
            assert!(records(&stream) == log, "{foreign} bytes {byte:#x}");
            assert_eq!(damage(&stream).iter().map(|(_, skipped, _)| skipped).sum::<usize>(), foreign);
        }
    }

    /// The last four bytes of a frame are lost. The following bfee has numbers that look like a noise record at the frame's expected
    /// end: with only these bytes, nothing can be decided yet.
    #[test]
    fn the_framer_waits_for_a_record_that_begins_in_the_last_bytes() {
        let noise = framed(code::NOISE, &(-92_i32).to_le_bytes());
        let repr = bfee::Repr {
            timestamp_low: u32::from_le_bytes([0, noise[0], noise[1], noise[2]]),
            bfee_count: u16::from_le_bytes([noise[3], noise[4]]),
            reserved: u16::from_le_bytes([noise[5], noise[6]]),
            n_rx: 3,
            n_tx: 1,
            ..bfee::Repr::default()
        };
        let mut body = vec![0; repr.body_len()];
        repr.emit(&vec![Iq { i: 1, q: 2 }; repr.samples()], &mut body).unwrap();
        let (frame, hidden) = (mpdu_record(4, 60), framed(code::BFEE, &body));
        assert_eq!(hidden[4..11], noise);
        let kept = frame.len() - 4;
        let stream = [&frame[..kept], &hidden, &bfee_record(1, 3, 1, true)].concat();
        let whole = in_chunks(&stream, &[stream.len()]);
        assert_eq!(whole[0], (0, kept, Some(Reason::Overlapped { expect: frame.len(), got: kept })));
        assert_eq!(whole.len(), 3);
        for first in frame.len()..frame.len() + 30 {
            assert_eq!(in_chunks(&stream, &[first, stream.len()]), whole, "the first {first} bytes");
        }
    }

    /// Each new byte has the same front judged again. Its checksum is computed once: with the credit used up, a later frame with a bad
    /// checksum would count as unchecked and be accepted.
    #[test]
    fn a_doubtful_frame_is_checked_once_in_any_chunks() {
        let mut wrong = mpdu_record(4, 60);
        *wrong.last_mut().unwrap() ^= 1;
        let good = [bfee_record(1, 3, 1, true), bfee_record(2, 3, 1, true)].concat();
        let stream = [wrong.as_slice(), &[0; 2_000], &wrong, &good].concat();
        let whole = in_chunks(&stream, &[stream.len()]);
        assert_eq!((whole[0].1, whole.len()), (stream.len() - good.len(), 3));
        assert_eq!(in_chunks(&stream, &[1]), whole);
    }
}
