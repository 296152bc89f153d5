//! Messages of an MCAP file, one after the other, without an index: also of one whose end is missing.

use super::{BagError, Channel, Ended, Used, compressed};
use std::collections::BTreeMap;
use std::io::{ErrorKind, Read};
use std::path::Path;

/// How a file begins.
pub(super) const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";
/// Bytes of one record at most.
const LARGEST: u64 = 1 << 30;

/// Takes values of MCAP from bytes: little-endian, texts with their length.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn u16(&mut self) -> Option<u16> {
        Some(u16::from_le_bytes(*self.take(2)?.first_chunk()?))
    }

    fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(*self.take(8)?.first_chunk()?))
    }

    fn text(&mut self) -> Option<String> {
        let length = u32::from_le_bytes(*self.take(4)?.first_chunk()?);
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

/// Each message of a file goes to `used`.
pub(super) fn read(path: &Path, mut from: impl Read, used: &mut Used<'_>) -> Result<Ended, BagError> {
    let io = |source| BagError::Io { path: path.to_owned(), source };
    let mut magic = [0; MAGIC.len()];
    from.read_exact(&mut magic).map_err(io)?;
    let (mut state, mut ended) = (State::default(), Ended::default());
    loop {
        let mut head = [0; 9];
        match from.read_exact(&mut head) {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(Ended { cut: true, ..ended }),
            Err(error) => return Err(io(error)),
        }
        let [kind, length @ ..] = head;
        let length = u64::from_le_bytes(length);
        let mut content = Vec::new();
        match from.by_ref().take(length.min(LARGEST)).read_to_end(&mut content) {
            Ok(taken) if taken as u64 == length => {}
            Err(error) if error.kind() != ErrorKind::UnexpectedEof => return Err(io(error)),
            _ => return Ok(Ended { cut: true, ..ended }),
        }
        match kind {
            // The end of the data: the rest says it again.
            0x0f | 0x02 => return Ok(ended),
            0x06 => ended.damaged_chunks += u64::from(!chunk(path, &content, &mut state, used)?),
            _ => hand_over(&mut state, kind, &content, used)?,
        }
    }
}

fn hand_over(state: &mut State, kind: u8, content: &[u8], used: &mut Used<'_>) -> Result<(), BagError> {
    let Some((number, payload)) = state.record(kind, content) else { return Ok(()) };
    state.channels.get(&number).map_or(Ok(()), |channel| used(channel, payload))
}

/// What is in a chunk; false if nothing can be made of it.
fn chunk(path: &Path, content: &[u8], state: &mut State, used: &mut Used<'_>) -> Result<bool, BagError> {
    let mut fields = Fields(content);
    let head = (|| {
        fields.take(16)?;
        let size = fields.u64()?;
        fields.take(4)?;
        let compression = fields.text()?;
        fields.u64()?;
        Some((size, compression))
    })();
    let Some((size, compression)) = head else { return Ok(false) };
    let unpacked = match compression.as_str() {
        "" => None,
        "zstd" | "lz4" if size > LARGEST => return Ok(false),
        "zstd" => Some(compressed::zstd(fields.0, size)),
        "lz4" => Some(compressed::lz4(fields.0, size)),
        by => {
            let command = "mcap compress --compression none";
            return Err(BagError::Compressed { path: path.to_owned(), by: by.to_owned(), command });
        }
    };
    let unpacked = match unpacked {
        // Cut or damaged: it says how long it is.
        Some(Ok(bytes)) if bytes.len() as u64 == size => Some(bytes),
        Some(_) => return Ok(false),
        None => None,
    };
    let mut fields = Fields(unpacked.as_deref().unwrap_or(fields.0));
    while let Some((kind, content)) = record(&mut fields) {
        hand_over(state, kind, content, used)?;
    }
    Ok(true)
}

fn record<'a>(fields: &mut Fields<'a>) -> Option<(u8, &'a [u8])> {
    let kind = *fields.take(1)?.first()?;
    let length = usize::try_from(fields.u64()?).ok()?;
    Some((kind, fields.take(length)?))
}
