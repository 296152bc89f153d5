//! The tag of native frames, and the check of records' frames by it: SipHash-2-4 \[siphash2012\] under two keys, half of the tag each.
//!
//! | bytes of the tag | key | what it shows |
//! |---|---|---|
//! | 0 to 7 | the group's | a robot of the group made the frame: enough for whose turn it is, which frames for others say too |
//! | 8 to 15 | the pair's, of sender and destination | one of these two made it: a robot that has only [its own keys](Key::for_robot) cannot pose as another to a third |
//!
//! Both come from one secret by HKDF with SHA-256 \[rfc5869\]: `info` is [`GROUP`], or [`PAIR`] and the two addresses,
//! the lower first. A tag does not show that a frame is new; sessions and numbers do, see [`super::Tdma`].

use crate::source::Next;
use driver_iface::Mac;
use driver_iface::mpdu;
use driver_iface::record::code;
use driver_iface::sounding::native::Repr;
use driver_iface::sounding::{Frame, native};
use hkdf::Hkdf;
use sha2::Sha256;
use siphasher::sip128::{Hasher128, SipHasher24};
use std::fmt;
use std::hash::Hasher;
use std::sync::Arc;
use zeroize::Zeroize;

/// What the group's key is derived with.
pub const GROUP: &[u8] = b"csi5300 group v1";
/// What a pair's key is derived with, before the two addresses.
pub const PAIR: &[u8] = b"csi5300 pair v1";
/// Bytes of a SipHash key, and of half a tag.
const KEY_LEN: usize = 16;
const HALF: usize = native::TAG_LEN / 2;

/// The keys of an exchange: of the group, and of pairs. Its bytes are not printed, and are overwritten when the last
/// copy is dropped.
#[derive(Clone, PartialEq, Eq)]
pub struct Key(Arc<Keys>);

#[derive(PartialEq, Eq)]
struct Keys {
    group: [u8; KEY_LEN],
    pairs: Pairs,
}

/// Where the keys of pairs come from.
#[derive(PartialEq, Eq)]
enum Pairs {
    /// Derived from the group's secret when needed.
    Secret(Vec<u8>),
    /// One robot's: with each peer.
    Of(Mac, Vec<(Mac, [u8; KEY_LEN])>),
}

impl Drop for Keys {
    fn drop(&mut self) {
        self.group.zeroize();
        match &mut self.pairs {
            Pairs::Secret(secret) => secret.zeroize(),
            Pairs::Of(_, keys) => keys.iter_mut().for_each(|(_, key)| key.zeroize()),
        }
    }
}

/// What a tag shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shown {
    /// That sender or destination made the frame.
    Pair,
    /// That a robot of the group did; the pair's key is not known here.
    Group,
    /// Nothing.
    Nothing,
}

impl Key {
    /// A key from a secret of 16 bytes, which should come from a good random source.
    #[must_use]
    pub fn new(secret: [u8; 16]) -> Self {
        Self::from_secret(&secret)
    }

    /// A key from the group's secret: at least 16 bytes from a good random source.
    #[must_use]
    pub(crate) fn from_secret(secret: &[u8]) -> Self {
        let group = derive(secret, &[GROUP]);
        Self(Arc::new(Keys { group, pairs: Pairs::Secret(secret.to_vec()) }))
    }

    /// A robot's own keys: the group's, and one for each peer.
    #[must_use]
    pub(crate) fn of_robot(own: Mac, group: [u8; 16], peers: Vec<(Mac, [u8; 16])>) -> Self {
        Self(Arc::new(Keys { group, pairs: Pairs::Of(own, peers) }))
    }

    /// The keys that `own` needs to exchange frames with `peers`; they cannot make frames between two others. Peers
    /// without a key here are skipped.
    #[must_use]
    pub fn for_robot(&self, own: Mac, peers: &[Mac]) -> Self {
        let peers = peers.iter().filter_map(|peer| Some((*peer, self.pair(own, *peer)?)));
        Self::of_robot(own, self.0.group, peers.collect())
    }

    /// This robot's keys by name: the group's, and those with each peer. `None` for a key that holds the group's secret.
    #[must_use]
    #[allow(clippy::type_complexity)]
    pub(crate) fn robot_keys(&self) -> Option<(Mac, [u8; 16], &[(Mac, [u8; 16])])> {
        match &self.0.pairs {
            Pairs::Secret(_) => None,
            Pairs::Of(own, keys) => Some((*own, self.0.group, keys)),
        }
    }

    /// True if frames between the two robots can be made and checked.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn has_pair(&self, a: Mac, b: Mac) -> bool {
        self.pair(a, b).is_some()
    }

    fn pair(&self, a: Mac, b: Mac) -> Option<[u8; KEY_LEN]> {
        match &self.0.pairs {
            Pairs::Secret(secret) => Some(derive(secret, &[PAIR, &a.min(b).0, &a.max(b).0])),
            Pairs::Of(own, keys) => {
                let peer = if a == *own { b } else { a };
                let is_own = a == *own || b == *own;
                keys.iter().find(|(mac, _)| is_own && *mac == peer).map(|(_, key)| *key)
            }
        }
    }

    /// The tag of an emitted frame that has room for one; `None` without the pair's key.
    pub(super) fn tag(&self, mpdu: &[u8], sender: Mac, destination: Mac) -> Option<[u8; native::TAG_LEN]> {
        let mut tag = [0; native::TAG_LEN];
        let (group, pair) = tag.split_at_mut(HALF);
        group.copy_from_slice(&half(&self.0.group, mpdu));
        pair.copy_from_slice(&half(&self.pair(sender, destination)?, mpdu));
        Some(tag)
    }

    /// What the tag of a frame shows; compared without an early exit.
    pub(super) fn check(&self, mpdu: &[u8], repr: &Repr) -> Shown {
        let Some(tag) = &repr.tag else { return Shown::Nothing };
        let (group, pair) = tag.split_at(HALF);
        let is_groups = same(&half(&self.0.group, mpdu), group);
        let key = self.pair(repr.sender, repr.destination);
        match (is_groups, key.map(|key| same(&half(&key, mpdu), pair))) {
            (true, Some(true)) => Shown::Pair,
            (true, None) => Shown::Group,
            _ => Shown::Nothing,
        }
    }

    /// What the tag of a frame without FCS shows. For frames between two other robots, whose key this robot may lack,
    /// it shows only that a group member made them.
    fn prove(&self, mpdu: &[u8]) -> Proof {
        let parsed = Frame::new_checked(mpdu).and_then(|frame| Repr::parse(&frame));
        match parsed.map(|repr| self.check(mpdu, &repr)) {
            Some(Shown::Pair) => Proof::Good,
            Some(Shown::Group) => Proof::Unknown,
            Some(Shown::Nothing) | None => Proof::Wrong,
        }
    }
}

/// HKDF-SHA256 without salt: the secret is random already.
fn derive(secret: &[u8], info: &[&[u8]]) -> [u8; KEY_LEN] {
    let mut key = [0; KEY_LEN];
    // Fails only for more than 255 hashes of output.
    let _ = Hkdf::<Sha256>::new(None, secret).expand_multi_info(info, &mut key);
    key
}

fn half(key: &[u8; KEY_LEN], mpdu: &[u8]) -> [u8; HALF] {
    let mut hasher = SipHasher24::new_with_key(key);
    for part in native::authenticated_parts(mpdu) {
        hasher.write(part);
    }
    let mut half = [0; HALF];
    half.copy_from_slice(hasher.finish128().as_bytes().split_at(HALF).0);
    half
}

fn same(a: &[u8; HALF], b: &[u8]) -> bool {
    b.len() == HALF && a.iter().zip(b).fold(0, |differs, (a, b)| differs | (a ^ b)) == 0
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(..)")
    }
}

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
                let split = record.body.split_at_checked(record.body.len().saturating_sub(mpdu::FCS));
                self.frame = split.map_or(Proof::Wrong, |(mpdu, _)| key.prove(mpdu));
                self.frame
            }
            (Next::Record(_, record), _) if record.code == code::BFEE => std::mem::take(&mut self.frame),
            // The frame before may belong to a lost record.
            (Next::Lost(_), _) => std::mem::take(&mut self.frame),
            _ => Proof::Unknown,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::source::{Loss, Stamps};
    use driver_iface::record::{Reason, Record, Tail};
    use driver_iface::sounding::native::Role;

    const A: Mac = Mac([2, 0, 0, 0, 0, 1]);
    const B: Mac = Mac([2, 0, 0, 0, 0, 2]);
    const C: Mac = Mac([2, 0, 0, 0, 0, 3]);

    fn frame(sender: Mac, destination: Mac, key: &Key) -> Vec<u8> {
        let repr = Repr {
            sender,
            number: 7,
            role: Role::Backward,
            destination,
            next: sender,
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
        let tag = key.tag(&bytes, sender, destination).unwrap_or([0; native::TAG_LEN]);
        native::set_tag(&mut bytes, tag);
        bytes
    }

    fn shown(key: &Key, bytes: &[u8]) -> Shown {
        key.check(bytes, &Repr::parse(&Frame::new_checked(bytes).unwrap()).unwrap())
    }

    #[test]
    fn a_tag_holds_for_its_frame_and_key_only() {
        let key = Key::new([7; 16]);
        let bytes = frame(A, B, &key);
        assert_eq!(shown(&key, &bytes), Shown::Pair);
        assert_eq!(shown(&Key::new([8; 16]), &bytes), Shown::Nothing);
        // Addresses, number, session, slot, and every byte of the tag.
        let tag = bytes.len() - native::TAG_LEN..bytes.len();
        for at in [21, 24, 27, 34, 46, 50, 60, 67].into_iter().chain(tag) {
            let mut other = bytes.clone();
            other[at] ^= 1;
            assert_eq!(shown(&key, &other), Shown::Nothing, "byte {at} is not covered");
        }
        let mut rewritten = bytes;
        for at in [2, 3, 22, 23] {
            rewritten[at] ^= 0xff; // what the card and mac80211 may rewrite
        }
        assert_eq!(shown(&key, &rewritten), Shown::Pair);
        assert_eq!(format!("{key:?}"), "Key(..)");
    }

    #[test]
    fn every_byte_of_a_secret_counts() {
        let secret: Vec<u8> = (0..32).collect();
        let key = Key::from_secret(&secret);
        for at in 0..32 {
            let mut other = secret.clone();
            other[at] ^= 1;
            let other = Key::from_secret(&other);
            assert_eq!(shown(&key, &frame(A, B, &other)), Shown::Nothing, "byte {at}");
        }
    }

    #[test]
    fn a_robot_cannot_pose_as_another_to_a_third() {
        let key = Key::from_secret(&[9; 32]);
        let (a, b, c) = (key.for_robot(A, &[B, C]), key.for_robot(B, &[A, C]), key.for_robot(C, &[A, B]));
        let honest = frame(A, B, &a);
        assert_eq!([&b, &a, &c].map(|key| shown(key, &honest)), [Shown::Pair, Shown::Pair, Shown::Group]);
        // C has the group's key and its own with A and B: it takes what it has.
        assert_eq!(c.tag(&honest, A, B), None);
        let mut forged = frame(A, B, &a);
        let group = half(&c.0.group, &forged);
        for (_, own) in &c.robot_keys().unwrap().2.to_vec() {
            let pair = half(own, &forged);
            let tag: Vec<u8> = group.into_iter().chain(pair).collect();
            native::set_tag(&mut forged, tag.try_into().unwrap());
            assert_eq!(shown(&b, &forged), Shown::Nothing);
        }
        assert!(key.has_pair(A, B) && a.has_pair(B, A) && !a.has_pair(B, C) && !c.has_pair(A, B));
        assert_eq!(Key::of_robot(A, a.robot_keys().unwrap().1, a.robot_keys().unwrap().2.to_vec()), a);
    }

    #[test]
    fn keys_are_derived_as_rfc_5869_says() {
        // By `openssl kdf -keylen 16 -kdfopt digest:SHA256 -kdfopt hexkey:00..0f -kdfopt info:"csi5300 group v1" HKDF`.
        let secret: Vec<u8> = (0..16).collect();
        let hex = derive(&secret, &[GROUP]).map(|byte| format!("{byte:02x}")).concat();
        assert_eq!(hex, "61122350fb8ae3a88f56179a123baf17");
    }

    #[test]
    fn equal_errors_in_a_tags_bytes_do_not_cancel() {
        let key = Key::new([7; 16]);
        let bytes = frame(A, B, &key);
        for half in [bytes.len() - native::TAG_LEN, bytes.len() - HALF] {
            let mut other = bytes.clone();
            other[half] ^= 1;
            other[half + 5] ^= 1;
            assert_eq!(shown(&key, &other), Shown::Nothing);
        }
    }

    #[test]
    fn keys_are_the_same_where_all_of_them_are() {
        let key = |secret: u8| Key::new([secret; 16]);
        let robot = |secret, own, peers: &[Mac]| key(secret).for_robot(own, peers);
        assert!(key(1) == key(1) && robot(1, A, &[B]) == robot(1, A, &[B]));
        let others = [key(2), robot(1, A, &[B]), robot(1, A, &[B, C]), robot(1, B, &[A]), robot(2, A, &[B])];
        assert!(others.iter().all(|other| *other != key(1)));
        assert!(others.iter().filter(|other| **other == robot(1, A, &[B])).count() == 1);
    }

    /// A frame from A to B with the key's tag, and a checksum that is not used: the body of a record.
    pub(crate) fn recorded(key: &Key) -> Vec<u8> {
        [frame(A, B, key), vec![0; mpdu::FCS]].concat()
    }

    fn record(code: u8, body: &[u8]) -> Next<'_> {
        Next::Record(Stamps::default(), Record { code, body })
    }

    #[test]
    fn a_record_has_the_proof_of_the_frame_right_before_it() {
        let key = Key::new([7; 16]);
        let good = recorded(&key);
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
        let proof = |key: Option<Key>| Prover::new(key).note(&record(code::MPDU, &recorded(&Key::new([7; 16]))));
        assert_eq!(proof(Some(key.for_robot(B, &[A]))), Proof::Good);
        assert_eq!(proof(Some(key.for_robot(C, &[A, B]))), Proof::Unknown);
        assert_eq!(proof(Some(Key::new([8; 16]))), Proof::Wrong);
        assert_eq!(proof(None), Proof::Unknown);
        assert!(!Prover::new(None).has_key());
    }
}
