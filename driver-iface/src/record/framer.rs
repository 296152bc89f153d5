//! The sans-IO reader of a record stream.

use super::head::{Codes, Head, Reason, SURE, head};
use super::{LENGTH_FIELD, MAX_LENGTH, Record, code};
use crate::bfee::{Bfee, MAX_BODY};
use crate::mpdu::fcs_is_good;

/// Bytes of buffer with which [`Framer::step`] can always decide.
pub const LOOKAHEAD: usize = 72 * 1024;

/// Records that are looked at after one in doubt.
const MAX_LINKS: usize = 6;

/// Positions searched before a stretch of damage is reported in parts.
const SEARCH: usize = 16 * 1024;

/// Bytes of which checksums may be taken at once, and per byte consumed: what keeps the work linear when every few
/// bytes pretend to be a long frame. A frame that is not checked for want of credit counts as unchecked.
const CREDIT: usize = 64 * 1024;
const CREDIT_PER_BYTE: usize = 8;

// The furthest byte looked at: the head of the last link after a candidate at the end of a search behind a bfee.
const _: () = assert!(LENGTH_FIELD + 1 + MAX_BODY + SEARCH + MAX_LINKS * (LENGTH_FIELD + MAX_LENGTH) + 23 <= LOOKAHEAD);

/// What the front of the buffer is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step<'a> {
    /// A record.
    Record {
        /// Where it begins in the stream, bytes.
        offset: u64,
        /// Bytes to consume, length field included.
        used: usize,
        /// The record.
        record: Record<'a>,
    },
    /// More bytes are needed, behind those offered; [`LOOKAHEAD`] of them are always enough.
    Incomplete,
    /// Bytes that are no record.
    Bad {
        /// Where they begin in the stream, bytes.
        offset: u64,
        /// Bytes to consume.
        skipped: usize,
        /// Why; [`Reason::StillLost`] continues the step before.
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
    /// In the middle of a record: the normal end of a log whose logger was killed.
    Cut {
        /// Where the last record begins in the stream, bytes.
        offset: u64,
        /// Bytes of it that are there.
        bytes: u64,
        /// Bytes that it should have, length field included; `None` when not even that can be read.
        expected: Option<u64>,
    },
}

impl Tail {
    /// True when the stream was cut at a multiple of 4096 bytes: the logger was killed before it flushed its buffer.
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
/// Offer the bytes not yet consumed to [`Framer::step`], then drop as many from the front as it says (`used`,
/// `skipped`). The same bytes give the same steps whatever the chunks in which they arrive. Work is linear in the
/// bytes; a look further ahead is bounded by [`LOOKAHEAD`].
///
/// A record is believed when its own contents vouch for it (a bfee whose lengths obey the formula, a noise value, an
/// MPDU with a good checksum) or when such a record, or the stream's end, follows where its length says. A bfee or
/// MPDU followed by nothing is searched for the head of another record: if there is one inside, bytes are missing
/// from the first and it is given up, so one lost or 100 foreign bytes cost the record that they are in, no more.
/// Records of unknown codes are legal; right after damage one is believed only if its code was met before.
#[derive(Clone, Debug)]
pub struct Framer {
    offset: u64,
    /// Codes of believed records.
    seen: Codes,
    /// Positions of the present front that are known to begin no record.
    searched: usize,
    /// The step before ended in damage without finding a record.
    lost: bool,
    /// Bytes that checksums may still be taken of; see [`CREDIT`].
    credit: usize,
    /// Length of the record at the front when the step before has found it to vouch for itself.
    ahead: Option<usize>,
}

impl Default for Framer {
    fn default() -> Self {
        Self::new()
    }
}

/// Outcome of a look at what follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Chain {
    Yes,
    /// Yes, but only because the stream ends there.
    End,
    No,
    Short,
}

/// Which records may stand between one in doubt and what vouches for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Links {
    /// Those of codes that are known or were met before.
    Known,
    /// Any.
    Any,
}

/// Outcome of a search.
enum Found {
    At(usize),
    Nothing,
    Short,
}

impl Framer {
    /// At the start of a stream.
    #[must_use]
    pub fn new() -> Self {
        Self { offset: 0, seen: Codes::default(), searched: 0, lost: false, credit: CREDIT, ahead: None }
    }

    /// Position in the stream: bytes consumed so far.
    #[must_use]
    pub fn offset(&self) -> u64 {
        self.offset
    }

    /// Looks at the front of the unconsumed bytes; `end` says that no more will follow.
    pub fn step<'a>(&mut self, front: &'a [u8], end: bool) -> Step<'a> {
        if let Some(len) = self.ahead
            && len <= front.len()
        {
            return self.sure(front, end, len);
        }
        if front.is_empty() {
            return if end { Step::End(Tail::Clean) } else { Step::Incomplete };
        }
        if self.lost {
            return self.resync(front, end, 0, Reason::StillLost);
        }
        match head(front, &self.seen) {
            Head::Short if end => self.tail(front, None),
            Head::Short => Step::Incomplete,
            Head::Bad(reason) => self.resync(front, end, 1, reason),
            Head::Good { len, .. } if len > front.len() && end => self.tail(front, Some(len)),
            Head::Good { len, .. } if len > front.len() => Step::Incomplete,
            Head::Good { len, bits } if bits >= SURE => self.sure(front, end, len),
            Head::Good { len, bits } => self.doubtful(front, end, len, bits),
        }
    }

    /// A record that vouches for itself and is there in full, unless another begins inside it.
    fn sure<'a>(&mut self, front: &'a [u8], end: bool, len: usize) -> Step<'a> {
        if let Some(rest) = front.get(len..)
            && let Head::Good { len: next, bits } = head(rest, &self.seen)
            && bits >= SURE
        {
            let step = self.accept(front, len);
            self.ahead = Some(next);
            return step;
        }
        match self.chain(front, end, len, 0, Links::Known) {
            Chain::Yes | Chain::End => return self.accept(front, len),
            Chain::Short => return Step::Incomplete,
            Chain::No => {}
        }
        match self.search(front, end, 1, len) {
            Found::At(next) => self.bad(next, Reason::Overlapped { expect: len, got: next }),
            Found::Short => Step::Incomplete,
            Found::Nothing if gaps_are_clear(front, len) => self.accept(front, len),
            Found::Nothing => self.resync(front, end, len, Reason::GapBits),
        }
    }

    /// A record that needs a witness: what follows it, or an MPDU's checksum.
    fn doubtful<'a>(&mut self, front: &'a [u8], end: bool, len: usize, bits: u32) -> Step<'a> {
        let reason = match self.chain(front, end, len, bits, Links::Any) {
            Chain::Short => return Step::Incomplete,
            Chain::No => Reason::NotFollowed { code: code_of(front), expect: len },
            Chain::Yes | Chain::End => match self.search_sure(front, end, len) {
                Found::Nothing => return self.accept(front, len),
                Found::Short => return Step::Incomplete,
                Found::At(next) => Reason::Overlapped { expect: len, got: next },
            },
        };
        if self.checksum(front, len) == Some(true) {
            self.accept(front, len)
        } else {
            self.resync(front, end, 1, reason)
        }
    }

    /// Follows the lengths from the record at the front on, until something vouches for them.
    ///
    /// `len` is that record's length, `bits` the evidence that it brings. A code that comes again counts as known.
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

    /// The first position of `from..to` at which a record can be believed.
    fn search(&mut self, front: &[u8], end: bool, from: usize, to: usize) -> Found {
        for at in from.max(self.searched)..to.min(front.len()) {
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
                    self.searched = at;
                    return Found::Short;
                }
                _ => {}
            }
        }
        if front.len() < to && !end {
            self.searched = front.len();
            return Found::Short;
        }
        self.searched = to;
        Found::Nothing
    }

    /// Whether a record after damage can be believed that does not vouch for itself.
    ///
    /// It needs witnesses behind it, not just the stream's end; an MPDU needs both them and its checksum, for among
    /// many positions one or the other is met by chance.
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

    /// Whether an MPDU's checksum is right; `None` for other records and when the credit is used up.
    fn checksum(&mut self, front: &[u8], len: usize) -> Option<bool> {
        let record = front.get(LENGTH_FIELD..len).and_then(Record::from_message)?;
        if record.code != code::MPDU {
            return None;
        }
        self.credit = self.credit.checked_sub(len)?;
        Some(fcs_is_good(record.body))
    }

    /// The first position inside a record of `len` bytes at which another begins that vouches for itself.
    fn search_sure(&mut self, front: &[u8], end: bool, len: usize) -> Found {
        for at in self.searched.max(1)..len {
            match head(front.get(at..).unwrap_or_default(), &self.seen) {
                Head::Good { bits, .. } if bits >= SURE => return Found::At(at),
                Head::Short if !end => {
                    self.searched = at;
                    return Found::Short;
                }
                _ => {}
            }
        }
        Found::Nothing
    }

    /// Gives up the front and looks for the next record from position `from` on.
    fn resync<'a>(&mut self, front: &'a [u8], end: bool, from: usize, reason: Reason) -> Step<'a> {
        let to = from + SEARCH;
        match self.search(front, end, from, to) {
            Found::At(0) => {
                self.lost = false;
                self.step(front, end)
            }
            Found::At(next) => self.bad(next, reason),
            Found::Short => Step::Incomplete,
            Found::Nothing => {
                let skipped = to.min(front.len());
                let step = self.bad(skipped, reason);
                self.lost = true;
                step
            }
        }
    }

    /// The stream ends inside the record at the front, or in what looks like one.
    fn tail<'a>(&mut self, front: &'a [u8], expected: Option<usize>) -> Step<'a> {
        match self.search(front, true, 1, front.len()) {
            Found::At(next) => {
                let expect = expected.unwrap_or(next);
                return self.bad(next, Reason::Overlapped { expect, got: next });
            }
            Found::Nothing | Found::Short => {}
        }
        let doubtful = match head(front, &self.seen) {
            Head::Good { bits, .. } => bits == 0,
            _ => false,
        };
        if let (true, Some(expect)) = (doubtful, expected) {
            let code = code_of(front);
            return self.bad(front.len(), Reason::NotFollowed { code, expect });
        }
        let expected = expected.map(|len| len as u64);
        Step::End(Tail::Cut { offset: self.offset, bytes: front.len() as u64, expected })
    }

    fn accept<'a>(&mut self, front: &'a [u8], len: usize) -> Step<'a> {
        let message = front.get(LENGTH_FIELD..len).and_then(Record::from_message);
        let Some(record) = message else { return Step::Incomplete };
        let offset = self.consume(len);
        self.seen.insert(record.code);
        Step::Record { offset, used: len, record }
    }

    fn bad<'a>(&mut self, skipped: usize, reason: Reason) -> Step<'a> {
        let offset = self.consume(skipped);
        Step::Bad { offset, skipped, reason }
    }

    /// Moves on; returns where the consumed bytes began.
    fn consume(&mut self, bytes: usize) -> u64 {
        let offset = self.offset;
        self.offset += bytes as u64;
        self.credit = self.credit.saturating_add(bytes.saturating_mul(CREDIT_PER_BYTE)).min(CREDIT);
        self.searched = 0;
        self.lost = false;
        self.ahead = None;
        offset
    }
}

/// Remembers the code of the record at the front, unless it is only the same byte over and over.
fn note(seen: &mut Codes, front: &[u8]) {
    if let [high, low, code, ..] = front
        && (high != code || low != code)
    {
        seen.insert(*code);
    }
}

/// The code byte of the record at the front.
fn code_of(front: &[u8]) -> u8 {
    front.get(LENGTH_FIELD).copied().unwrap_or(0)
}

/// True unless the record is a bfee with bits where none should be.
fn gaps_are_clear(front: &[u8], len: usize) -> bool {
    match front.get(LENGTH_FIELD..len).and_then(Record::from_message) {
        Some(Record { code: code::BFEE, body }) => Bfee::new_checked(body).is_ok_and(|bfee| bfee.gaps_are_clear()),
        _ => true,
    }
}

/// All steps over bytes that are wholly in memory, the last of them [`Step::End`].
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
