//! Checks the tag of a record's frame, if the driver delivers frames.

use super::Key;
use super::auth::Shown;
use crate::source::Next;
use driver_iface::record::code;
use driver_iface::sounding::native::Repr;
use driver_iface::sounding::{FCS_LEN, Frame};

/// What is known about the frame that a record measures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Proof {
    /// The record has no frame, or there is no key.
    #[default]
    Unknown,
    /// Its tag is valid: its sender made it, at some time.
    Good,
    /// It has no tag, or another one.
    Wrong,
}

/// Checks the frames that come before records (0xC1 before 0xBB).
#[derive(Clone, Debug, Default)]
pub struct Prover {
    key: Option<Key>,
    frame: Proof,
}

impl Prover {
    /// The key to check frames with, if any.
    #[must_use]
    pub fn new(key: Option<Key>) -> Self {
        Self { key, frame: Proof::Unknown }
    }

    /// True if there is a key.
    #[must_use]
    pub fn has_key(&self) -> bool {
        self.key.is_some()
    }

    /// Takes the items of a source in order; returns, for a record of CSI, what is known about its frame.
    pub fn note(&mut self, next: &Next<'_>) -> Proof {
        match (next, &self.key) {
            (Next::Record(_, record), Some(key)) if record.code == code::MPDU => {
                let mpdu = record.body.split_at_checked(record.body.len().saturating_sub(FCS_LEN));
                self.frame = mpdu.map_or(Proof::Wrong, |(mpdu, _)| key.prove(mpdu));
                self.frame
            }
            (Next::Record(_, record), _) if record.code == code::BFEE => std::mem::take(&mut self.frame),
            // The frame before may belong to a lost record.
            (Next::Lost(_), _) => std::mem::take(&mut self.frame),
            _ => Proof::Unknown,
        }
    }
}

impl Key {
    /// What the tag of a frame without FCS shows. For frames between two other robots, whose key this robot may lack,
    /// it shows only that a group member made them.
    fn prove(&self, mpdu: &[u8]) -> Proof {
        let parsed = Frame::new_checked(mpdu).and_then(|frame| Repr::parse(&frame));
        match parsed.map(|repr| self.check(mpdu, &repr)) {
            Ok(Shown::Pair) => Proof::Good,
            Ok(Shown::Group) => Proof::Unknown,
            Ok(Shown::Nothing) | Err(_) => Proof::Wrong,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::source::{Loss, Stamps};
    use driver_iface::Mac;
    use driver_iface::record::{Reason, Record, Tail};
    use driver_iface::sounding::native::{self, Role};

    const A: Mac = Mac([2, 0, 0, 0, 0, 1]);
    const B: Mac = Mac([2, 0, 0, 0, 0, 2]);
    const C: Mac = Mac([2, 0, 0, 0, 0, 3]);

    /// A frame from A to B with the key's tag, and a checksum that is not used.
    pub(crate) fn frame(key: &Key) -> Vec<u8> {
        let repr = Repr {
            sender: A,
            number: 7,
            role: Role::Forward,
            destination: B,
            next: A,
            wants_turn: false,
            session: 1,
            sender_session: 1,
            turn: 0,
            left: 0,
            slot: 0,
            round_us: 10_000,
            slots: 1,
            measurement: None,
            tag: Some([0; native::TAG_LEN]),
        };
        let mut bytes = vec![0; native::MAX_LEN];
        let len = repr.emit(&mut bytes).unwrap();
        bytes.truncate(len);
        let tag = key.tag(&bytes, A, B).unwrap();
        native::set_tag(&mut bytes, tag);
        bytes.extend([0; FCS_LEN]);
        bytes
    }

    fn record(code: u8, body: &[u8]) -> Next<'_> {
        Next::Record(Stamps::default(), Record { code, body })
    }

    #[test]
    fn a_record_has_the_proof_of_the_frame_right_before_it() {
        let key = Key::new([7; 16]);
        let good = frame(&key);
        let mut wrong = good.clone();
        wrong[27] ^= 1;
        let mut prover = Prover::new(Some(key));
        assert!(prover.has_key());
        let of = |prover: &mut Prover, mpdu: &[u8]| {
            let frame = prover.note(&record(code::MPDU, mpdu));
            (frame, prover.note(&record(code::BFEE, &[])))
        };
        assert_eq!(of(&mut prover, &good), (Proof::Good, Proof::Good));
        assert_eq!(prover.note(&record(code::BFEE, &[])), Proof::Unknown, "its frame is missing");
        assert_eq!(of(&mut prover, &wrong), (Proof::Wrong, Proof::Wrong));
        assert_eq!(of(&mut prover, &good[..3]), (Proof::Wrong, Proof::Wrong));
        // Another kind of record changes nothing; a loss may be of the record.
        let _ = prover.note(&record(code::MPDU, &good));
        assert_eq!(prover.note(&record(0x7f, &[])), Proof::Unknown);
        assert_eq!(prover.note(&Next::Pending), Proof::Unknown);
        assert_eq!(prover.note(&record(code::BFEE, &[])), Proof::Good);
        let _ = prover.note(&record(code::MPDU, &good));
        let loss = Loss::Bytes { offset: 0, len: 1, reason: Reason::Checksum };
        let _ = prover.note(&Next::Lost(loss));
        assert_eq!(prover.note(&record(code::BFEE, &[])), Proof::Unknown);
        assert_eq!(prover.note(&Next::End(Tail::Clean)), Proof::Unknown);
    }

    #[test]
    fn frames_between_others_prove_only_the_group() {
        let key = Key::new([7; 16]);
        let proof = |key: Option<Key>| Prover::new(key).note(&record(code::MPDU, &frame(&Key::new([7; 16]))));
        assert_eq!(proof(Some(key.for_robot(B, &[A]))), Proof::Good);
        assert_eq!(proof(Some(key.for_robot(C, &[A, B]))), Proof::Unknown);
        assert_eq!(proof(Some(Key::new([8; 16]))), Proof::Wrong);
        assert_eq!(proof(None), Proof::Unknown);
        assert!(!Prover::new(None).has_key());
    }
}
