//! Messages of an MCAP file, one after the other, without an index: also of one whose end is missing.

use super::{BagError, Channel, Ended, Used, compressed};
use driver_iface::mpdu::crc32;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

/// How a file begins.
pub(super) const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";
/// Bytes of one record at most.
const LARGEST: u64 = 1 << 30;
/// Bytes of a summary at most: what it says of topics is of use, and nothing else.
const LARGEST_SUMMARY: u64 = 64 << 20;
/// Bytes of the last record, which says where the summary begins, with the file's last bytes.
const FOOTER: u64 = 9 + 20 + MAGIC.len() as u64;

/// Takes values of MCAP from bytes: little-endian, texts with their length.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(*self.take(4)?.first_chunk()?))
    }

    fn u16(&mut self) -> Option<u16> {
        Some(u16::from_le_bytes(*self.take(2)?.first_chunk()?))
    }

    fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(*self.take(8)?.first_chunk()?))
    }

    fn text(&mut self) -> Option<String> {
        let length = self.u32()?;
        String::from_utf8(self.take(length as usize)?.to_vec()).ok()
    }
}

/// What is known of a file so far.
#[derive(Default)]
struct State {
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, Channel>,
}

impl State {
    /// Takes a record; gives what is in it where that is a message.
    fn record<'a>(&mut self, kind: u8, content: &'a [u8]) -> Option<(u16, &'a [u8])> {
        let mut fields = Fields(content);
        match kind {
            0x03 => {
                let (number, name) = (fields.u16()?, fields.text()?);
                self.schemas.insert(number, name);
                None
            }
            0x04 => {
                let (number, schema) = (fields.u16()?, fields.u16()?);
                let (topic, encoding) = (fields.text()?, fields.text()?);
                let kind = self.schemas.get(&schema).cloned().unwrap_or_default();
                self.channels.insert(number, Channel { topic, kind, encoding });
                None
            }
            0x05 => {
                let number = fields.u16()?;
                // Its number in order, and two times.
                fields.take(20)?;
                Some((number, fields.0))
            }
            _ => None,
        }
    }
}

/// A file that is read.
struct Reading<'a, 'b> {
    path: &'a Path,
    state: State,
    ended: Ended,
    used: &'a mut Used<'b>,
}

/// Each message of a file goes to `used`.
pub(super) fn read(path: &Path, mut from: impl Read, used: &mut Used<'_>) -> Result<Ended, BagError> {
    let io = |source| BagError::Io { path: path.to_owned(), source };
    let mut magic = [0; MAGIC.len()];
    from.read_exact(&mut magic).map_err(io)?;
    let mut reading = Reading { path, state: described(path).unwrap_or_default(), ended: Ended::default(), used };
    loop {
        let mut head = [0; 9];
        match from.read_exact(&mut head) {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(reading.cut()),
            Err(error) => return Err(io(error)),
        }
        let [kind, length @ ..] = head;
        let length = u64::from_le_bytes(length);
        let mut content = Vec::new();
        match from.by_ref().take(length.min(LARGEST)).read_to_end(&mut content) {
            Ok(taken) if taken as u64 == length => {}
            Err(error) if error.kind() != ErrorKind::UnexpectedEof => return Err(io(error)),
            _ => return Ok(reading.cut()),
        }
        match kind {
            // The end of the data: the rest says it again.
            0x0f | 0x02 => return Ok(reading.ended),
            0x06 => reading.chunk(&content)?,
            _ => reading.record(kind, &content)?,
        }
    }
}

/// What the summary at the end of a file says of its topics: it says it again, in case that a chunk which said it first is
/// damaged. `None` without a summary, and where its sum is another one.
fn described(path: &Path) -> Option<State> {
    let mut file = File::open(path).ok().filter(|file| file.metadata().is_ok_and(|found| found.is_file()))?;
    let end = file.seek(SeekFrom::End(0)).ok()?;
    file.seek(SeekFrom::Start(end.checked_sub(FOOTER)?)).ok()?;
    let mut footer = Vec::new();
    file.by_ref().take(FOOTER).read_to_end(&mut footer).ok()?;
    let mut fields = Fields(footer.strip_suffix(MAGIC)?.strip_prefix(&[0x02])?);
    let (_, start, _, sum) = (fields.u64()?, fields.u64()?, fields.u64()?, fields.u32()?);
    let length = (end - MAGIC.len() as u64).checked_sub(start).filter(|length| *length <= LARGEST_SUMMARY)?;
    file.seek(SeekFrom::Start(start)).ok().filter(|_| start > 0)?;
    let mut summary = Vec::new();
    file.take(length).read_to_end(&mut summary).ok()?;
    // All but itself.
    let summed = summary.get(..summary.len().checked_sub(4)?)?;
    if sum != 0 && crc32(summed) != sum {
        return None;
    }
    let (mut state, mut fields) = (State::default(), Fields(&summary));
    while let Some((kind, content)) = record(&mut fields) {
        state.record(kind, content);
    }
    Some(state)
}

impl Reading<'_, '_> {
    fn cut(self) -> Ended {
        Ended { cut: true, ..self.ended }
    }

    /// Takes a record; a message goes on.
    fn record(&mut self, kind: u8, content: &[u8]) -> Result<(), BagError> {
        let Some((number, payload)) = self.state.record(kind, content) else { return Ok(()) };
        match self.state.channels.get(&number) {
            Some(channel) => (self.used)(channel, payload),
            None => {
                self.ended.without_topic += 1;
                Ok(())
            }
        }
    }

    /// What is in a chunk; one of which nothing or not all can be made is counted.
    fn chunk(&mut self, content: &[u8]) -> Result<(), BagError> {
        let Some(chunk) = Chunk::of(content) else {
            self.ended.damaged_parts += 1;
            return Ok(());
        };
        let unpacked = match chunk.compression.as_str() {
            "" => None,
            "zstd" | "lz4" if chunk.size > LARGEST => Some(Err(ErrorKind::FileTooLarge.into())),
            "zstd" => Some(compressed::zstd(chunk.records, chunk.size)),
            "lz4" => Some(compressed::lz4(chunk.records, chunk.size)),
            by => {
                let command = "mcap compress --compression none";
                return Err(BagError::Compressed { path: self.path.to_owned(), by: by.to_owned(), command });
            }
        };
        let records = match &unpacked {
            Some(unpacked) => unpacked.as_deref().ok(),
            None => Some(chunk.records),
        };
        // Cut or damaged: it says how long it is, and its sum.
        let Some(records) = records.filter(|records| chunk.is_good(records)) else {
            self.ended.damaged_parts += 1;
            return Ok(());
        };
        let mut fields = Fields(records);
        while let Some((kind, content)) = record(&mut fields) {
            self.record(kind, content)?;
        }
        self.ended.damaged_parts += u64::from(!fields.0.is_empty());
        Ok(())
    }
}

/// The content of a chunk record.
struct Chunk<'a> {
    /// Bytes of its records, unpacked.
    size: u64,
    /// Their CRC-32; 0 where it was not computed.
    sum: u32,
    compression: String,
    records: &'a [u8],
}

impl<'a> Chunk<'a> {
    fn of(content: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(content);
        // The times of the first and the last message.
        fields.take(16)?;
        let (size, sum, compression) = (fields.u64()?, fields.u32()?, fields.text()?);
        let length = usize::try_from(fields.u64()?).ok()?;
        Some(Self { size, sum, compression, records: fields.take(length)? })
    }

    fn is_good(&self, records: &[u8]) -> bool {
        records.len() as u64 == self.size && (self.sum == 0 || crc32(records) == self.sum)
    }
}

fn record<'a>(fields: &mut Fields<'a>) -> Option<(u8, &'a [u8])> {
    let mut ahead = Fields(fields.0);
    let kind = *ahead.take(1)?.first()?;
    let length = usize::try_from(ahead.u64()?).ok()?;
    let content = ahead.take(length)?;
    *fields = ahead;
    Some((kind, content))
}
