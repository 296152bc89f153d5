//! Reads records of a log again, by offset, from a window that moves through the file: for CSI of a log whose columns are known.

use driver_iface::bfee::Bfee;
use driver_iface::record::{LENGTH_FIELD, MAX_LENGTH, Record, code};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// Bytes of the window: large enough to cost few calls, small enough to stay in the second-level cache.
const WINDOW: usize = 256 * 1024;
/// Bytes of the longest record.
const LONGEST: usize = LENGTH_FIELD + MAX_LENGTH;

/// A log that was read before and whose records are read again.
pub(crate) struct LogReader {
    file: File,
    window: Vec<u8>,
    /// Offset of the window in the file.
    start: u64,
    /// Bytes in the window.
    filled: usize,
}

impl LogReader {
    /// Opens a log; the file must be seekable.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self { file: File::open(path)?, window: vec![0; WINDOW], start: 0, filled: 0 })
    }

    /// The bfee record at an offset of the log; `None` if there is none (any more). Fast if offsets rise.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn bfee(&mut self, offset: i64) -> io::Result<Option<Bfee<'_>>> {
        let place = u64::try_from(offset).unwrap_or(u64::MAX);
        let inside = place.checked_sub(self.start).and_then(|at| usize::try_from(at).ok());
        let at = match inside.filter(|at| at.saturating_add(LONGEST) <= self.filled) {
            Some(at) => at,
            None => {
                self.move_to(place)?;
                0
            }
        };
        Ok(bfee_at(self.window.get(at..self.filled).unwrap_or_default()))
    }

    /// Moves the window to an offset: keeps the overlapping bytes and reads the others, as many as there are.
    fn move_to(&mut self, place: u64) -> io::Result<()> {
        let end = self.start + self.filled as u64;
        let kept = if (self.start..end).contains(&place) { (end - place) as usize } else { 0 };
        self.window.copy_within(self.filled - kept..self.filled, 0);
        self.file.seek(SeekFrom::Start(place + kept as u64))?;
        (self.start, self.filled) = (place, kept);
        while let Some(room) = self.window.get_mut(self.filled..).filter(|room| !room.is_empty()) {
            match self.file.read(room) {
                Ok(0) => break,
                Ok(read) => self.filled += read,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

/// The bfee record at the front of some bytes.
fn bfee_at(bytes: &[u8]) -> Option<Bfee<'_>> {
    let length = u16::from_be_bytes(*bytes.first_chunk::<LENGTH_FIELD>()?);
    let record = Record::from_message(bytes.get(LENGTH_FIELD..LENGTH_FIELD + usize::from(length))?)?;
    (record.code == code::BFEE).then(|| Bfee::new_checked(record.body).ok())?
}
