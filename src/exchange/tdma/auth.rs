//! The shared-key tag of native frames: SipHash-2-4 with a 128-bit key and a 128-bit output.
//!
//! SipHash is a keyed function made for authenticating short messages \[siphash2012\]; the full
//! 128-bit output is sent. It shows that a frame was made by someone with the key, not that it is new: for that
//! there are sessions and numbers, see [`super::Tdma`].

use driver_iface::sounding::native;
use siphasher::sip128::{Hasher128, SipHasher24};
use std::fmt;
use std::hash::Hasher;

/// A key that all robots of an exchange share. Its bytes are not printed.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Key([u8; 16]);

impl Key {
    /// A key of 16 bytes, which should come from a good random source.
    #[must_use]
    pub fn new(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }

    /// The tag of an emitted frame that has room for one.
    pub(super) fn tag(&self, mpdu: &[u8]) -> [u8; native::TAG_LEN] {
        let mut hasher = SipHasher24::new_with_key(&self.0);
        for part in native::authenticated_parts(mpdu) {
            hasher.write(part);
        }
        hasher.finish128().as_bytes()
    }

    /// True if `tag` is that of the frame; compared without an early exit.
    pub(super) fn verifies(&self, mpdu: &[u8], tag: &[u8; native::TAG_LEN]) -> bool {
        u128::from_ne_bytes(self.tag(mpdu)) ^ u128::from_ne_bytes(*tag) == 0
    }
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(..)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tag_holds_for_its_frame_and_key_only() {
        let frame: Vec<u8> = (0..100).collect();
        let key = Key::new([7; 16]);
        let tag = key.tag(&frame);
        assert!(key.verifies(&frame, &tag));
        assert!(!Key::new([8; 16]).verifies(&frame, &tag));
        for at in [4, 21, 24, 60, 83] {
            let mut other = frame.clone();
            other[at] ^= 1;
            assert!(!key.verifies(&other, &tag), "byte {at} is not covered");
        }
        let mut rewritten = frame;
        for at in [0, 1, 2, 3, 22, 23] {
            rewritten[at] ^= 0xff; // what the card and mac80211 may rewrite
        }
        assert!(key.verifies(&rewritten, &tag));
        assert_eq!(format!("{key:?}"), "Key(..)");
    }
}
