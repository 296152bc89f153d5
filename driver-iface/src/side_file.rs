//! Side files (`.datstp`): when the host received each record of a log, in the log's order.
//!
//! The records of a stock driver contain no host time, so a logger that knows it writes it beside the log. The first 16 bytes that
//! are not zeros distinguish three layouts; numbers are little-endian.
//!
//! | [`Layout`] | head | entry | written by |
//! |---|---|---|---|
//! | `Narrow` | none | the `struct timeval` of a 32-bit host: two u32, seconds and microseconds since the Unix epoch | csiread's `log_to_file.c`, this project |
//! | `Wide` | none | that of a 64-bit host: two i64 | csiread's `log_to_file.c`, this project |
//! | `Checked` | [`MAGIC`] | i64, microseconds since the Unix epoch; u32, bytes of the record; u32, its CRC-32C | this project |
//!
//! An entry of zeros means "unknown". A [`Check`] covers the record as in the log, length field included: a side file with checks
//! shows which of the log's records are unchanged, and which are missing.

use crate::{EmitError, checksum, room};

/// Microseconds in a second.
const US_PER_S: i64 = 1_000_000;

/// The first bytes of a side file with checksums; as long as an entry.
pub const MAGIC: [u8; 16] = *b"csi5300 checks 1";

/// CRC-32C \[rfc3720\]: the polynomial 0x1EDC6F41, reversed.
static CASTAGNOLI: checksum::Tables = checksum::tables(0x82F6_3B78);

/// The layout of a side file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// 8 bytes per entry: two u32. csiread reads it, and this project's recordings have it.
    Narrow,
    /// 16 bytes per entry: two i64.
    Wide,
    /// 16 bytes per entry: time, and length and checksum of the record. Only this project reads it.
    Checked,
}

impl Layout {
    /// Bytes of an entry.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::Narrow => 8,
            Self::Wide | Self::Checked => 16,
        }
    }

    /// The bytes before the first entry.
    #[must_use]
    pub const fn head(self) -> &'static [u8] {
        match self {
            Self::Narrow | Self::Wide => &[],
            Self::Checked => &MAGIC,
        }
    }

    /// The layout of a side file that begins with `file`: as much of it as includes a time, or all of it.
    ///
    /// `Checked` if 12 of its first 16 bytes match [`MAGIC`], so that damage there does not turn checksums into times. Otherwise
    /// judges by the first 16 bytes that are not all zeros, because zeros are an unknown time in either layout: `Wide` if the high
    /// halves of seconds and microseconds are zero and the low half of the microseconds is below a million. Narrow files have the
    /// second entry's seconds there.
    #[must_use]
    pub fn of(file: &[u8]) -> Self {
        if file.first_chunk().is_some_and(is_magic) {
            return Self::Checked;
        }
        let mut blocks = file.chunks_exact(Self::Wide.bytes());
        let known = blocks.find(|block| block.iter().any(|byte| *byte != 0)).and_then(<[u8]>::first_chunk);
        let Some(&[_, _, _, _, h0, h1, h2, h3, u0, u1, u2, u3, v0, v1, v2, v3]) = known else { return Self::Narrow };
        let us = i64::from(u32::from_le_bytes([u0, u1, u2, u3]));
        let is_wide = [h0, h1, h2, h3] == [0; 4] && [v0, v1, v2, v3] == [0; 4] && us < US_PER_S;
        if is_wide { Self::Wide } else { Self::Narrow }
    }
}

/// True if 12 of the bytes match [`MAGIC`].
fn is_magic(head: &[u8; 16]) -> bool {
    head.iter().zip(MAGIC).filter(|(found, byte)| **found == *byte).count() >= 12
}

/// A side file's check of a record's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Check {
    /// Bytes in the log, length field included; 3 to 65,537.
    pub len: u32,
    /// CRC-32C of these bytes.
    pub crc32c: u32,
}

impl Check {
    /// For a record as in the log: length field, code and body.
    #[must_use]
    pub fn of(record: &[u8]) -> Self {
        Self { len: u32::try_from(record.len()).unwrap_or(u32::MAX), crc32c: checksum::of(&CASTAGNOLI, record) }
    }
}

/// A side file's entry for one record.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Entry {
    /// Host time of reception, microseconds since the Unix epoch; `None` if unknown.
    pub host_us: Option<i64>,
    /// Its length and checksum; `None` if unknown, and in layouts without them.
    pub check: Option<Check>,
}

impl From<Option<i64>> for Entry {
    /// With the time only.
    fn from(host_us: Option<i64>) -> Self {
        Self { host_us, check: None }
    }
}

impl Entry {
    /// Reads an entry. Too few `bytes`, a microsecond field of a second or more, and a time more than 292,000 years from 1970 mean
    /// unknown.
    #[must_use]
    pub fn parse(bytes: &[u8], layout: Layout) -> Self {
        let parsed = match layout {
            Layout::Narrow => narrow(bytes).map(Self::from),
            Layout::Wide => wide(bytes).map(Self::from),
            Layout::Checked => checked(bytes),
        };
        parsed.unwrap_or_default()
    }

    /// Writes an entry: zeros for unknown values. A layout without checksums has only the time. Returns [`Layout::bytes`].
    ///
    /// # Errors
    /// If the seconds do not fit a narrow entry (before 1970, after 2106) or `out` is too short.
    pub fn emit(&self, layout: Layout, out: &mut [u8]) -> Result<usize, EmitError> {
        let us = self.host_us.unwrap_or(0);
        let (seconds, part) = (us.div_euclid(US_PER_S), us.rem_euclid(US_PER_S));
        let out = room(out, layout.bytes())?;
        let (head, tail) = out.split_at_mut(layout.bytes() / 2);
        match layout {
            Layout::Narrow => {
                let too_large = |_| EmitError::Field {
                    name: "tv_sec",
                    got: usize::try_from(seconds).unwrap_or(usize::MAX),
                    max: u32::MAX as usize,
                };
                head.copy_from_slice(&u32::try_from(seconds).map_err(too_large)?.to_le_bytes());
                tail.copy_from_slice(&(part as u32).to_le_bytes());
            }
            Layout::Wide => {
                head.copy_from_slice(&seconds.to_le_bytes());
                tail.copy_from_slice(&part.to_le_bytes());
            }
            Layout::Checked => {
                let Check { len, crc32c } = self.check.unwrap_or(Check { len: 0, crc32c: 0 });
                let (length, crc) = tail.split_at_mut(4);
                head.copy_from_slice(&us.to_le_bytes());
                length.copy_from_slice(&len.to_le_bytes());
                crc.copy_from_slice(&crc32c.to_le_bytes());
            }
        }
        Ok(layout.bytes())
    }
}

fn narrow(bytes: &[u8]) -> Option<Option<i64>> {
    let (seconds, rest) = bytes.split_first_chunk()?;
    let part = u32::from_le_bytes(*rest.first_chunk()?);
    Some(time(i64::from(u32::from_le_bytes(*seconds)), i64::from(part)))
}

fn wide(bytes: &[u8]) -> Option<Option<i64>> {
    let (seconds, rest) = bytes.split_first_chunk()?;
    Some(time(i64::from_le_bytes(*seconds), i64::from_le_bytes(*rest.first_chunk()?)))
}

fn checked(bytes: &[u8]) -> Option<Entry> {
    let (us, rest) = bytes.split_first_chunk()?;
    let (len, rest) = rest.split_first_chunk()?;
    let crc32c = u32::from_le_bytes(*rest.first_chunk()?);
    let (us, len) = (i64::from_le_bytes(*us), u32::from_le_bytes(*len));
    Some(Entry { host_us: (us != 0).then_some(us), check: (len != 0).then_some(Check { len, crc32c }) })
}

fn time(seconds: i64, us: i64) -> Option<i64> {
    let is_known = (0..US_PER_S).contains(&us) && (seconds, us) != (0, 0);
    seconds.checked_mul(US_PER_S)?.checked_add(us).filter(|_| is_known)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn entries(entries: &[Entry], layout: Layout) -> Vec<u8> {
        let mut bytes = layout.head().to_vec();
        for entry in entries {
            let mut out = [0; 16];
            assert_eq!(entry.emit(layout, &mut out), Ok(layout.bytes()));
            bytes.extend(&out[..layout.bytes()]);
        }
        bytes
    }

    fn parsed(file: &[u8]) -> (Layout, Vec<Entry>) {
        let layout = Layout::of(file);
        let rest = &file[layout.head().len()..];
        (layout, rest.chunks(layout.bytes()).map(|entry| Entry::parse(entry, layout)).collect())
    }

    #[test]
    fn the_first_entries_distinguish_layouts() {
        let narrow: Vec<u8> = [1_700_000_000_u32, 250_000, 1_700_000_000, 260_000].map(u32::to_le_bytes).concat();
        assert_eq!(Layout::of(&narrow), Layout::Narrow);
        assert_eq!(Layout::of(&narrow[..8]), Layout::Narrow);
        let wide: Vec<u8> = [1_700_000_000_i64, 250_000].map(i64::to_le_bytes).concat();
        assert_eq!(Layout::of(&wide), Layout::Wide);
        // The first record was received at a whole second.
        let even: Vec<u8> = [1_700_000_000_u32, 0, 1_700_000_000, 10_000].map(u32::to_le_bytes).concat();
        assert_eq!(Layout::of(&even), Layout::Narrow);
        // A microsecond field of a second is invalid.
        let second: Vec<u8> = [1_700_000_000_i64, 1_000_000].map(i64::to_le_bytes).concat();
        assert_eq!(Layout::of(&second), Layout::Narrow);
        for high in [4, 7, 12, 15] {
            let mut other = wide.clone();
            other[high] = 1;
            assert_eq!(Layout::of(&other), Layout::Narrow, "byte {high}");
        }
        // Unknown first times: zeros in either layout.
        for unknown in 1..6 {
            assert_eq!(Layout::of(&[&[0; 16].repeat(unknown)[..], &wide].concat()), Layout::Wide, "{unknown}");
            assert_eq!(Layout::of(&[&[0; 8].repeat(unknown)[..], &narrow].concat()), Layout::Narrow, "{unknown}");
            assert_eq!(Layout::of(&[0; 16].repeat(unknown)), Layout::Narrow, "nothing is known in it");
            assert_eq!(Layout::of(&[&[0; 16].repeat(unknown)[..], &MAGIC].concat()), Layout::Narrow, "it is the first");
        }
        assert_eq!(Layout::of(&MAGIC), Layout::Checked);
        for at in 0..16 {
            let mut other = MAGIC;
            other[at] ^= 1;
            assert_eq!(Layout::of(&other), Layout::Checked, "byte {at}");
        }
        assert_eq!(Layout::of(&[&MAGIC[..11], &[0xff; 5]].concat()), Layout::Narrow);
    }

    #[test]
    fn values_that_do_not_fit_are_refused() {
        let mut out = [0; 16];
        let (us, late) = (Entry::from(Some(1)), Entry::from(Some((i64::from(u32::MAX) + 1) * US_PER_S)));
        for layout in [Layout::Narrow, Layout::Wide, Layout::Checked] {
            let short = layout.bytes() - 1;
            assert_eq!(us.emit(layout, &mut out[..short]), Err(EmitError::Buffer { need: short + 1, got: short }));
            assert_eq!(Entry::parse(&[1; 15][..short], layout), Entry::default());
        }
        assert!(matches!(late.emit(Layout::Narrow, &mut out), Err(EmitError::Field { .. })));
        assert!(matches!(Entry::from(Some(-1)).emit(Layout::Narrow, &mut out), Err(EmitError::Field { .. })));
        let [second, whole] = [1_000_000_u32, 999_999].map(|us| [7_u32, us].map(u32::to_le_bytes).concat());
        let time = |entry: &[u8]| Entry::parse(entry, Layout::Narrow).host_us;
        assert_eq!((time(&second), time(&whole)), (None, Some(7_999_999)));
    }

    #[test]
    fn checksums_are_those_of_rfc_3720() {
        // Appendix B.4: 32 bytes of zeros, of ones, counting up; and the check string of the catalogue of CRCs.
        let up: Vec<u8> = (0..32).collect();
        for (bytes, expect) in [
            (&[0; 32][..], 0x8A91_36AA_u32),
            (&[0xff; 32], 0x62A8_AB43),
            (&up, 0x46DD_794E),
            (b"123456789", 0xE306_9283),
        ] {
            assert_eq!(Check::of(bytes), Check { len: bytes.len() as u32, crc32c: expect });
        }
    }

    /// The bytes of the format as in docs/reference/formats.md.
    #[test]
    fn a_checked_side_file_has_a_head_and_16_bytes_per_record() {
        let check = Check { len: 0x0102, crc32c: 0x0304_0506 };
        let file = entries(&[Entry { host_us: Some(0x0708), check: Some(check) }, Entry::default()], Layout::Checked);
        assert_eq!(&file[..16], b"csi5300 checks 1");
        assert_eq!(file[16..32], [8, 7, 0, 0, 0, 0, 0, 0, 2, 1, 0, 0, 6, 5, 4, 3]);
        assert_eq!(file[32..], [0; 16]);
    }

    /// Found by fuzzing: a time too large for microseconds came back as another one.
    #[test]
    fn a_time_beyond_64_bits_is_unknown() {
        let last = i64::MAX / US_PER_S;
        for (seconds, us, expect) in [
            (last, i64::MAX % US_PER_S, Some(i64::MAX)),
            (last, i64::MAX % US_PER_S + 1, None),
            (last + 1, 0, None),
            (-last, 0, Some(-last * US_PER_S)),
            (i64::MIN, 0, None),
        ] {
            let entry = [seconds, us].map(i64::to_le_bytes).concat();
            assert_eq!(Entry::parse(&entry, Layout::Wide).host_us, expect, "{seconds} s, {us} us");
        }
    }

    fn any_check() -> impl Strategy<Value = Check> {
        (1..=u32::MAX, any::<u32>()).prop_map(|(len, crc32c)| Check { len, crc32c })
    }

    proptest! {
        #[test]
        fn emit_then_parse_is_the_identity(
            entry in (prop::option::of(1..i64::MAX), prop::option::of(any_check())), negative in i64::MIN..0,
        ) {
            let entry = Entry { host_us: entry.0, check: entry.1 };
            for host_us in [entry.host_us, Some(negative)] {
                let mut out = [0; 16];
                let checked = Entry { host_us, ..entry };
                checked.emit(Layout::Checked, &mut out).unwrap();
                prop_assert_eq!(Entry::parse(&out, Layout::Checked), checked);
            }
            let mut out = [0; 16];
            entry.emit(Layout::Wide, &mut out).unwrap();
            prop_assert_eq!(Entry::parse(&out, Layout::Wide), Entry { check: None, ..entry });
        }

        /// Times of this century: the range of a host's clock, which the layout is recognised by.
        #[test]
        fn layout_and_times_of_a_file_come_back(
            times in prop::collection::vec(946_684_800_000_000..4_102_444_800_000_000_i64, 2..20),
            unknown in 0..9_usize,
        ) {
            let times = std::iter::repeat_n(None, unknown).chain(times.into_iter().map(Some));
            let times: Vec<_> = times.map(Entry::from).collect();
            for layout in [Layout::Narrow, Layout::Wide, Layout::Checked] {
                prop_assert_eq!(parsed(&entries(&times, layout)), (layout, times.clone()));
            }
        }
    }
}
