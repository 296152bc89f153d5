//! The usual records of a log: the shapes of those met last, with which the next ones are compared first.
//!
//! A record's offset follows from the lengths of all records before it. Reading them in sequence stalls the processor at each;
//! comparing a length with a remembered one does not. So the code continues with the remembered length, never with the one read.

use super::super::{LENGTH_FIELD, code};
use super::{Len, State};
use crate::bfee::{STOCK_HEADER, WSR_HEADER, csi_len, offset};

/// Bytes of a record before its body: length field and code.
const FRONT: usize = LENGTH_FIELD + 1;
/// Bytes of a bfee's head that identify it; see [`crate::bfee::check`].
const DECIDING: usize = FRONT + STOCK_HEADER;

/// The first word of a record: length field, code and the first byte of the body.
type Word = u32;
/// In a bfee's first word, everything but the body's byte counts; that is the uppermost byte, shifted out.
const NOT_OF_BFEE: u32 = 8;
/// In a frame's first word, version and type count, too: the low half of its frame control.
const NOT_OF_FRAME: u32 = 4;

/// Shapes of the last bfee and the last frame; at first, of possible ones. What is known if they follow a record that vouches for
/// itself is kept in the form in which it is passed on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Usual {
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
        let csi = csi_len(3, 1);
        let length = 1 + WSR_HEADER + csi;
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
    pub(super) fn behind_sure(&self, rest: &[u8]) -> Option<State> {
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
    pub(super) fn learn(&mut self, rest: &[u8], state: State) {
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
fn deciding(head: &[u8; DECIDING]) -> (Word, [u8; 2], [u8; 2]) {
    let at = |at: usize| [head[FRONT + at], head[FRONT + at + 1]];
    (Word::from_le_bytes([head[0], head[1], head[2], head[3]]), at(offset::N_RX), at(offset::LEN))
}

#[cfg(test)]
mod tests {
    use super::super::super::tests::{bfee_record, framed, mpdu_record};
    use super::super::Framer;
    use super::*;
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
            logs in prop::collection::vec((follower(), follower()), 1..6), at in 0..200_usize, byte: u8,
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
}
