//! The questions of the state machine: what follows a record, and where the next one is.

use super::super::head::{Codes, Head, LONGEST_HEAD, SURE, VOUCHING_CODES, VOUCHING_LENGTHS, head, sure};
use super::super::{LENGTH_FIELD, Record, code};
use super::Framer;
use crate::bfee::Bfee;
use crate::mpdu::fcs_is_good;

/// Records that are examined after a doubtful one.
pub(super) const MAX_LINKS: usize = 6;

/// Bytes whose checksum may be computed at once, and per byte consumed: keeps the work linear if every few bytes pretend to be a
/// long frame. A frame that is not checked for lack of credit counts as unchecked.
pub(super) const CREDIT: usize = 64 * 1024;
pub(super) const CREDIT_PER_BYTE: usize = 8;

/// Result of examining the following records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Chain {
    Yes,
    /// Yes, but only because the stream ends there.
    End,
    No,
    Short,
}

/// Which records may stand between a doubtful one and its witness.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Links {
    /// Those of codes that are known or were met before.
    Known,
    /// Any.
    Any,
}

/// Result of a search.
pub(super) enum Found {
    At(usize),
    Nothing,
    Short,
}

impl Framer {
    /// Follows the lengths from the record at the front until a record vouches for them.
    ///
    /// `len` is that record's length, `bits` its own evidence. A repeated code counts as known.
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

    /// The first position of `from..to` at which a record can be accepted.
    pub(super) fn search(&mut self, front: &[u8], end: bool, from: usize, to: usize) -> Found {
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
    pub(super) fn checksum(&mut self, front: &[u8], len: usize) -> Option<bool> {
        let record = front.get(LENGTH_FIELD..len).and_then(Record::from_message)?;
        if record.code != code::MPDU {
            return None;
        }
        self.credit = self.credit.checked_sub(len)?;
        Some(fcs_is_good(record.body))
    }

    /// The first position inside a record of `len` bytes at which another begins that vouches for itself.
    #[inline(never)]
    pub(super) fn search_sure(&mut self, front: &[u8], end: bool, len: usize) -> Found {
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
pub(super) fn is_plain(front: &[u8], len: usize) -> bool {
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
pub(super) fn gaps_are_clear(front: &[u8], len: usize) -> bool {
    match front.get(LENGTH_FIELD..len).and_then(Record::from_message) {
        Some(Record { code: code::BFEE, body }) => Bfee::new_checked(body).is_ok_and(|bfee| bfee.gaps_are_clear()),
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::head::likely;
    use super::*;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// Bytes in which complete and almost complete heads of bfees and noise records are frequent.
    fn bytes() -> impl Strategy<Value = Vec<u8>> {
        let noise = Just(vec![0, 5, 0xD0, 0xA6, 0xFF, 0xFF, 0xFF]);
        let bfee: Vec<u8> = [[0, 93, 0xBB].as_slice(), &[0; 8], &[1, 1], &[0; 6], &[72, 0, 0, 0]].concat();
        let mpdu = Just(vec![0, 40, code::MPDU, 8, 0]);
        let one = prop::sample::select(vec![0_u8, 1, 2, 3, 5, 93, 0xBB, 0xD0, 0xFF]).prop_map(|byte| vec![byte]);
        let part = prop_oneof![60 => one, 1 => noise, 1 => Just(bfee), 1 => mpdu, 8 => any::<u8>().prop_map(|byte| vec![byte])];
        prop::collection::vec(part, 1..700).prop_map(|parts| parts.concat())
    }

    proptest! {
        #[test]
        fn quick_checks_agree_with_heads(bytes in bytes(), codes in prop::collection::vec(any::<u8>(), 0..5)) {
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
}
