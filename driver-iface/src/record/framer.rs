//! The sans-IO reader of a record stream: a state machine with the states of [`State`].
//!
//! Each [`Framer::step`] classifies the bytes at the front by their head ([`Front`]), collects the evidence that this class
//! needs, and reaches one [`Verdict`]. The questions in order; the first one answered with yes decides:
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
//! A question that needs bytes beyond the buffer gives `Wait`. `Seek` searches at most [`SEARCH`] positions for the next record:
//! if it is found, the verdict is a `Skip` to it; if not, a `Skip` of all of them, state `Lost`. In state `Lost` the front is
//! `Damage` from its first byte on; a record found right there ends that state.

mod evidence;
mod usual;

use super::head::{Codes, Head, Reason, SURE, head, likely, sure};
use super::{LENGTH_FIELD, MAX_LENGTH, Record};
use crate::bfee::MAX_BODY;
use evidence::{CREDIT, CREDIT_PER_BYTE, Chain, Found, Links, MAX_LINKS, gaps_are_clear, is_plain};
use usual::Usual;

/// Bytes of buffer with which [`Framer::step`] can always decide.
pub const LOOKAHEAD: usize = 72 * 1024;

/// Positions searched before a stretch of damage is reported in parts.
const SEARCH: usize = 16 * 1024;

// The furthest byte needed: the head of the last link after a candidate at the end of a search after a bfee.
const _: () = assert!(LENGTH_FIELD + 1 + MAX_BODY + SEARCH + MAX_LINKS * (LENGTH_FIELD + MAX_LENGTH) + 23 <= LOOKAHEAD);

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
