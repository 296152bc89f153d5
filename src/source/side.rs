//! Side files: the host's receive time of each record of a log, in the log's order.
//!
//! An entry is seconds and microseconds, little-endian: 16 bytes when a 64-bit host wrote it, 8 from a 32-bit one.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// Reads a side file along with its log.
#[derive(Debug)]
pub struct Side {
    reader: BufReader<File>,
    wide: bool,
    read_ahead: Vec<u8>,
}

/// True for 16-byte entries, judged by the first of them: the high half of its seconds and of its microseconds are
/// zero and the low half of its microseconds is below a million, where 8-byte entries have the next one's seconds.
fn is_wide(head: &[u8]) -> bool {
    let word = |at: usize| head.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let (Some(high_seconds), Some(us), Some(high_us)) = (word(4), word(8), word(12)) else { return false };
    high_seconds == 0 && us < 1_000_000 && high_us == 0
}

impl Side {
    /// The side file of a log, if it has one.
    #[must_use]
    pub fn of(log: &Path) -> Option<Self> {
        let mut reader = BufReader::new(File::open(super::recorder::side_path(log)).ok()?);
        let mut read_ahead = Vec::with_capacity(16);
        reader.by_ref().take(16).read_to_end(&mut read_ahead).ok()?;
        let wide = is_wide(&read_ahead);
        Some(Self { reader, wide, read_ahead })
    }

    /// The next record's receive time, microseconds since the Unix epoch; `None` where it is not known.
    pub fn next_us(&mut self) -> Option<i64> {
        let mut entry = [0; 16];
        let wanted = entry.get_mut(..if self.wide { 16 } else { 8 })?;
        let ahead = self.read_ahead.len().min(wanted.len());
        let (from_ahead, from_file) = wanted.split_at_mut(ahead);
        from_ahead.copy_from_slice(self.read_ahead.get(..ahead)?);
        self.read_ahead.drain(..ahead);
        self.reader.read_exact(from_file).ok()?;
        let [s0, s1, s2, s3, s4, s5, s6, s7, u0, u1, u2, u3, u4, u5, u6, u7] = entry;
        let (seconds, us) = if self.wide {
            let seconds = i64::from_le_bytes([s0, s1, s2, s3, s4, s5, s6, s7]);
            (seconds, i64::from_le_bytes([u0, u1, u2, u3, u4, u5, u6, u7]))
        } else {
            let seconds = u32::from_le_bytes([s0, s1, s2, s3]);
            (i64::from(seconds), i64::from(u32::from_le_bytes([s4, s5, s6, s7])))
        };
        let sensible = (0..1_000_000).contains(&us) && (seconds, us) != (0, 0);
        sensible.then(|| seconds.saturating_mul(1_000_000).saturating_add(us))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widths_are_told_apart_by_the_first_entries() {
        let narrow: Vec<u8> = [1_700_000_000_u32, 250_000, 1_700_000_000, 260_000].map(u32::to_le_bytes).concat();
        assert!(!is_wide(&narrow));
        assert!(!is_wide(&narrow[..8]));
        let wide: Vec<u8> = [1_700_000_000_i64, 250_000].map(i64::to_le_bytes).concat();
        assert!(is_wide(&wide));
        // The first record came on a whole second.
        let even: Vec<u8> = [1_700_000_000_u32, 0, 1_700_000_000, 10_000].map(u32::to_le_bytes).concat();
        assert!(!is_wide(&even));
        // A first time that is not known.
        assert!(is_wide(&[0; 16]));
    }
}
