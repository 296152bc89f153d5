//! Side files (`.datstp`): when the host received each record of a log, in the log's order.
//!
//! The records of a stock driver hold no host time, so a logger that knows it writes it beside the log. The first 16
//! bytes that are not zeros distinguish three layouts; numbers are little-endian.
//!
//! | [`Layout`] | head | entry | written by |
//! |---|---|---|---|
//! | `Narrow` | none | the `struct timeval` of a 32-bit host: two u32, seconds and microseconds since the Unix epoch | csiread's `log_to_file.c`, this project |
//! | `Wide` | none | that of a 64-bit host: two i64 | csiread's `log_to_file.c`, this project |
//! | `Checked` | [`MAGIC`] | i64, microseconds since the Unix epoch; u32, bytes of the record; u32, its CRC-32C | this project |
//!
//! An entry of zeros says that nothing is known. A [`Check`] is of the record as the log has it, length field included: a
//! log whose side file has them shows which of its records are as they were written, and which are not in it.

use crate::{EmitError, checksum, room};

/// Microseconds in a second.
const US_PER_S: i64 = 1_000_000;

/// The first bytes of a side file with checksums, as many as an entry has.
pub const MAGIC: [u8; 16] = *b"csi5300 checks 1";

/// CRC-32C \[rfc3720\]: the polynomial 0x1EDC6F41, reversed.
static CASTAGNOLI: checksum::Tables = checksum::tables(0x82F6_3B78);

/// How a side file is laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// 8 bytes an entry: two u32. What csiread reads, and what recordings of this project have.
    Narrow,
    /// 16 bytes an entry: two i64.
    Wide,
    /// 16 bytes an entry: time, and length and checksum of the record. Read by this project only.
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

    /// What stands before the first entry.
    #[must_use]
    pub const fn head(self) -> &'static [u8] {
        match self {
            Self::Narrow | Self::Wide => &[],
            Self::Checked => &MAGIC,
        }
    }

    /// The layout of a side file that begins with `file`: as much of it as has a time, or all of it.
    ///
    /// `Checked` where 12 of its first 16 bytes are those of [`MAGIC`]: damage there must not make times of checksums.
    /// Else by the first 16 bytes that are not all zeros, which a time that is not known is in either layout. `Wide` where the
    /// high half of the entry's seconds and of its microseconds are zero and the low half of its microseconds is below a
    /// million: there narrow entries have the second one's seconds.
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

/// True for bytes of which 12 are those of [`MAGIC`].
fn is_magic(head: &[u8; 16]) -> bool {
    head.iter().zip(MAGIC).filter(|(found, byte)| **found == *byte).count() >= 12
}

/// What a side file knows of a record's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Check {
    /// Bytes in the log, length field included; 3 to 65,537.
    pub len: u32,
    /// CRC-32C of these bytes.
    pub crc32c: u32,
}

impl Check {
    /// Of a record as the log has it: length field, code and body.
    #[must_use]
    pub fn of(record: &[u8]) -> Self {
        Self { len: u32::try_from(record.len()).unwrap_or(u32::MAX), crc32c: checksum::of(&CASTAGNOLI, record) }
    }
}

/// What a side file says of one record.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Entry {
    /// When the host received it, microseconds since the Unix epoch; `None` if that is not known.
    pub host_us: Option<i64>,
    /// Its length and checksum; `None` if they are not known, and in layouts that have none.
    pub check: Option<Check>,
}

impl From<Option<i64>> for Entry {
    /// With the time only.
    fn from(host_us: Option<i64>) -> Self {
        Self { host_us, check: None }
    }
}

impl Entry {
    /// Reads an entry. A too short `bytes`, a microsecond field of a second or more, and a time further from 1970 than
    /// 292,000 years mean unknown.
    #[must_use]
    pub fn parse(bytes: &[u8], layout: Layout) -> Self {
        let parsed = match layout {
            Layout::Narrow => narrow(bytes).map(Self::from),
            Layout::Wide => wide(bytes).map(Self::from),
            Layout::Checked => checked(bytes),
        };
        parsed.unwrap_or_default()
    }

    /// Writes an entry: zeros for what is not known. A layout without checksums has the time only. Returns
    /// [`Layout::bytes`].
    ///
    /// # Errors
    /// When the seconds do not fit a narrow entry (before 1970, after 2106) or `out` is too short.
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
mod tests;
