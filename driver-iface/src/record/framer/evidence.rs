//! The questions of the state machine: what stands behind a record, and where the next one is.

use super::super::head::{Codes, Head, LONGEST_HEAD, SURE, VOUCHING_CODES, head};
use super::super::{LENGTH_FIELD, Record, code};
use super::Framer;
use crate::bfee::Bfee;
use crate::mpdu::fcs_is_good;

/// Records that are looked at after one in doubt.
pub(super) const MAX_LINKS: usize = 6;

/// Bytes of which checksums may be taken at once, and per byte consumed: what keeps the work linear when every few
/// bytes pretend to be a long frame. A frame that is not checked for want of credit counts as unchecked.
pub(super) const CREDIT: usize = 64 * 1024;
pub(super) const CREDIT_PER_BYTE: usize = 8;

/// Outcome of a look at what follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Chain {
    Yes,
    /// Yes, but only because the stream ends there.
    End,
    No,
    Short,
}

/// Which records may stand between one in doubt and what vouches for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Links {
    /// Those of codes that are known or were met before.
    Known,
    /// Any.
    Any,
}

/// Outcome of a search.
pub(super) enum Found {
    At(usize),
    Nothing,
    Short,
}

impl Framer {
    /// Follows the lengths from the record at the front on, until something vouches for them.
    ///
    /// `len` is that record's length, `bits` the evidence that it brings. A code that comes again counts as known.
    pub(super) fn chain(&self, front: &[u8], end: bool, len: usize, mut bits: u32, links: Links) -> Chain {
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
    pub(super) fn search(&mut self, front: &[u8], end: bool, from: usize, to: usize) -> Found {
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
    pub(super) fn checksum(&mut self, front: &[u8], len: usize) -> Option<bool> {
        let record = front.get(LENGTH_FIELD..len).and_then(Record::from_message)?;
        if record.code != code::MPDU {
            return None;
        }
        self.credit = self.credit.checked_sub(len)?;
        Some(fcs_is_good(record.body))
    }

    /// The first position inside a record of `len` bytes at which another begins that vouches for itself.
    pub(super) fn search_sure(&mut self, front: &[u8], end: bool, len: usize) -> Found {
        let mut at = self.searched.max(1);
        // Where a head is whole, most positions are ruled out by one byte.
        let whole = len.min((front.len() + 1).saturating_sub(LONGEST_HEAD));
        while let Some(next) = next_vouching_code(front, at, whole) {
            match head(front.get(next..).unwrap_or_default(), &self.seen) {
                Head::Good { bits, .. } if bits >= SURE => return Found::At(next),
                _ => at = next + 1,
            }
        }
        for at in at.max(whole)..len {
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
}

/// The first position of `from..to` with the code of a record that can vouch for itself.
fn next_vouching_code(front: &[u8], from: usize, to: usize) -> Option<usize> {
    let codes = front.get(from + LENGTH_FIELD..to + LENGTH_FIELD)?;
    let [bfee, noise] = VOUCHING_CODES;
    let vouches = |byte: &u8| *byte == bfee || *byte == noise;
    // In blocks that a compiler compares at once.
    let has_any = |block: &[u8; 32]| {
        block.iter().fold(0, |any, byte| any | u8::from(*byte == bfee) | u8::from(*byte == noise)) != 0
    };
    let blocks = codes.as_chunks().0.iter().take_while(|block| !has_any(block)).count();
    let behind = codes.get(32 * blocks..)?;
    behind.iter().position(vouches).map(|more| from + 32 * blocks + more)
}

/// Remembers the code of the record at the front, unless it is only the same byte over and over.
fn note(seen: &mut Codes, front: &[u8]) {
    if let [high, low, code, ..] = front
        && (high != code || low != code)
    {
        seen.insert(*code);
    }
}

/// True unless the record is a bfee with bits where none should be.
pub(super) fn gaps_are_clear(front: &[u8], len: usize) -> bool {
    match front.get(LENGTH_FIELD..len).and_then(Record::from_message) {
        Some(Record { code: code::BFEE, body }) => Bfee::new_checked(body).is_ok_and(|bfee| bfee.gaps_are_clear()),
        _ => true,
    }
}
