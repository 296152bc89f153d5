//! Side files (`.datstp`): when the host received each record of a log, in the log's order.
//!
//! The records of a stock driver hold no host time, so a logger that knows it writes it beside the log. An entry is the
//! `struct timeval` of the host that wrote it, seconds and microseconds since the Unix epoch, little-endian: two i64 from
//! a 64-bit host, two u32 from a 32-bit one (csiread's `log_to_file.c`). There is no header; the [`Width`] shows in the
//! first entry. An entry of zeros says that the time is not known.

use crate::{EmitError, room};

/// Microseconds in a second.
const US_PER_S: i64 = 1_000_000;

/// Size of a side file's entries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// 8 bytes: two u32. What csiread reads, and what recordings of this project have.
    Narrow,
    /// 16 bytes: two i64.
    Wide,
}

impl Width {
    /// Bytes of an entry.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::Narrow => 8,
            Self::Wide => 16,
        }
    }

    /// The width of a side file that begins with `head`, of which 16 bytes are looked at.
    ///
    /// Wide where the high half of the first entry's seconds and of its microseconds are zero and the low half of its
    /// microseconds is below a million: there narrow entries have the second one's seconds.
    #[must_use]
    pub fn of(head: &[u8]) -> Self {
        let wide =
            head.first_chunk::<16>().is_some_and(|&[_, _, _, _, h0, h1, h2, h3, u0, u1, u2, u3, v0, v1, v2, v3]| {
                let us = u32::from_le_bytes([u0, u1, u2, u3]);
                [h0, h1, h2, h3] == [0; 4] && [v0, v1, v2, v3] == [0; 4] && i64::from(us) < US_PER_S
            });
        if wide { Self::Wide } else { Self::Narrow }
    }
}

/// The time in an entry, microseconds since the Unix epoch.
///
/// `None` for an entry of zeros, for microseconds of a second or more, and when `entry` is too short.
#[must_use]
pub fn parse(entry: &[u8], width: Width) -> Option<i64> {
    let (seconds, us) = match width {
        Width::Wide => {
            let (seconds, rest) = entry.split_first_chunk()?;
            (i64::from_le_bytes(*seconds), i64::from_le_bytes(*rest.first_chunk()?))
        }
        Width::Narrow => {
            let (seconds, rest) = entry.split_first_chunk()?;
            (i64::from(u32::from_le_bytes(*seconds)), i64::from(u32::from_le_bytes(*rest.first_chunk()?)))
        }
    };
    let is_known = (0..US_PER_S).contains(&us) && (seconds, us) != (0, 0);
    is_known.then(|| seconds.saturating_mul(US_PER_S).saturating_add(us))
}

/// Writes an entry: zeros for `None`. Returns [`Width::bytes`].
///
/// # Errors
/// When the seconds do not fit a narrow entry (before 1970, after 2106) or `out` is too short.
pub fn emit(host_us: Option<i64>, width: Width, out: &mut [u8]) -> Result<usize, EmitError> {
    let us = host_us.unwrap_or(0);
    let (seconds, us) = (us.div_euclid(US_PER_S), us.rem_euclid(US_PER_S));
    let out = room(out, width.bytes())?;
    match width {
        Width::Wide => out.copy_from_slice(&emit_wide(host_us)),
        Width::Narrow => {
            let too_large = |_| EmitError::Field {
                name: "tv_sec",
                got: usize::try_from(seconds).unwrap_or(usize::MAX),
                max: u32::MAX as usize,
            };
            let (head, tail) = out.split_at_mut(4);
            head.copy_from_slice(&u32::try_from(seconds).map_err(too_large)?.to_le_bytes());
            tail.copy_from_slice(&(us as u32).to_le_bytes());
        }
    }
    Ok(width.bytes())
}

/// A wide entry, which holds every time.
#[must_use]
pub fn emit_wide(host_us: Option<i64>) -> [u8; Width::Wide.bytes()] {
    let us = host_us.unwrap_or(0);
    let [s0, s1, s2, s3, s4, s5, s6, s7] = us.div_euclid(US_PER_S).to_le_bytes();
    let [u0, u1, u2, u3, u4, u5, u6, u7] = us.rem_euclid(US_PER_S).to_le_bytes();
    [s0, s1, s2, s3, s4, s5, s6, s7, u0, u1, u2, u3, u4, u5, u6, u7]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn entries(times: &[Option<i64>], width: Width) -> Vec<u8> {
        let mut bytes = std::vec![0; times.len() * width.bytes()];
        for (time, entry) in times.iter().zip(bytes.chunks_exact_mut(width.bytes())) {
            assert_eq!(emit(*time, width, entry), Ok(width.bytes()));
        }
        bytes
    }

    #[test]
    fn widths_are_told_apart_by_the_first_entries() {
        let narrow: Vec<u8> = [1_700_000_000_u32, 250_000, 1_700_000_000, 260_000].map(u32::to_le_bytes).concat();
        assert_eq!(Width::of(&narrow), Width::Narrow);
        assert_eq!(Width::of(&narrow[..8]), Width::Narrow);
        let wide: Vec<u8> = [1_700_000_000_i64, 250_000].map(i64::to_le_bytes).concat();
        assert_eq!(Width::of(&wide), Width::Wide);
        // The first record came on a whole second.
        let even: Vec<u8> = [1_700_000_000_u32, 0, 1_700_000_000, 10_000].map(u32::to_le_bytes).concat();
        assert_eq!(Width::of(&even), Width::Narrow);
        // A first time that is not known.
        assert_eq!(Width::of(&[0; 16]), Width::Wide);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let mut out = [0; 16];
        assert_eq!(emit(Some(1), Width::Wide, &mut out[..15]), Err(EmitError::Buffer { need: 16, got: 15 }));
        let after_2106 = (i64::from(u32::MAX) + 1) * US_PER_S;
        assert!(matches!(emit(Some(after_2106), Width::Narrow, &mut out), Err(EmitError::Field { .. })));
        assert!(matches!(emit(Some(-1), Width::Narrow, &mut out), Err(EmitError::Field { .. })));
        assert_eq!(parse(&out[..15], Width::Wide), None);
        let [us, whole] = [1_000_000_u32, 999_999].map(|us| [7_u32, us].map(u32::to_le_bytes).concat());
        assert_eq!((parse(&us, Width::Narrow), parse(&whole, Width::Narrow)), (None, Some(7_999_999)));
    }

    proptest! {
        #[test]
        fn emit_then_parse_is_the_identity(times in prop::collection::vec(prop::option::of(1..i64::MAX), 1..20)) {
            let wide = entries(&times, Width::Wide);
            let got: Vec<_> = wide.chunks(16).map(|entry| parse(entry, Width::Wide)).collect();
            prop_assert_eq!(&got, &times);
            for (time, entry) in times.iter().zip(wide.chunks(16)) {
                prop_assert_eq!(&emit_wide(*time)[..], entry);
            }
        }

        /// Times of this century: what a host's clock can say, and what the width is seen by.
        #[test]
        fn width_and_times_of_a_file_come_back(
            times in prop::collection::vec(946_684_800_000_000..4_102_444_800_000_000_i64, 2..20),
        ) {
            let times: Vec<_> = times.into_iter().map(Some).collect();
            for width in [Width::Narrow, Width::Wide] {
                let bytes = entries(&times, width);
                prop_assert_eq!(Width::of(&bytes), width);
                let got: Vec<_> = bytes.chunks(width.bytes()).map(|entry| parse(entry, width)).collect();
                prop_assert_eq!(&got, &times);
            }
        }
    }
}
