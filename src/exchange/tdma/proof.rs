//! Whether a record's frame has a valid tag, where the driver hands frames over.

use super::Key;
use super::auth::Shown;
use crate::source::Next;
use driver_iface::record::code;
use driver_iface::sounding::native::Repr;
use driver_iface::sounding::{FCS_LEN, Frame};

/// What is known of the frame that a record measures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Proof {
    /// There is no frame with the record, or no key to check it with.
    #[default]
    Unknown,
    /// Its tag is valid: its sender has made it, some time.
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
    /// Frames are checked with this key, if there is one.
    #[must_use]
    pub fn new(key: Option<Key>) -> Self {
        Self { key, frame: Proof::Unknown }
    }

    /// True if there is a key.
    #[must_use]
    pub fn has_key(&self) -> bool {
        self.key.is_some()
    }

    /// Takes what a source gave, in its order; of a record of CSI, what is known of its frame.
    pub fn note(&mut self, next: &Next<'_>) -> Proof {
        match (next, &self.key) {
            (Next::Record(_, record), Some(key)) if record.code == code::MPDU => {
                let mpdu = record.body.split_at_checked(record.body.len().saturating_sub(FCS_LEN));
                self.frame = mpdu.map_or(Proof::Wrong, |(mpdu, _)| key.prove(mpdu));
                self.frame
            }
            (Next::Record(_, record), _) if record.code == code::BFEE => std::mem::take(&mut self.frame),
            // The frame before may be that of a record which is lost.
            (Next::Lost(_), _) => std::mem::take(&mut self.frame),
            _ => Proof::Unknown,
        }
    }
}

impl Key {
    /// What the tag of a frame without FCS shows. Of frames between two other robots, whose key a robot need not have, no
    /// more is known than that one of the group made them.
    fn prove(&self, mpdu: &[u8]) -> Proof {
        let parsed = Frame::new_checked(mpdu).and_then(|frame| Repr::parse(&frame));
        match parsed.map(|repr| self.check(mpdu, &repr)) {
            Ok(Shown::Pair) => Proof::Good,
            Ok(Shown::Group) => Proof::Unknown,
            Ok(Shown::Nothing) | Err(_) => Proof::Wrong,
        }
    }
}
