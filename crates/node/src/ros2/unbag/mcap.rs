//! Messages of an MCAP file, one after the other, without an index: also of one whose end is missing.

use super::BagError;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read};
use std::path::Path;

const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";
/// Bytes of one record at most.
const LARGEST: u64 = 1 << 30;

/// A topic of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Channel {
    /// Its name.
    pub topic: String,
    /// `nav_msgs/msg/Odometry`.
    pub kind: String,
    /// `cdr`.
    pub encoding: String,
}

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
    fn record<'a>(&mut self, kind: u8, content: &'a [u8]) -> Option<(u16, u64, &'a [u8])> {
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
                fields.take(4)?;
                let time_ns = fields.u64()?;
                fields.take(8)?;
                Some((number, time_ns, fields.0))
            }
            _ => None,
        }
    }
}

/// Each message of a file goes to `used`, with its time in nanoseconds. Gives true if the file ends where it should not.
pub(super) fn read(
    path: &Path,
    mut used: impl FnMut(&Channel, u64, &[u8]) -> Result<(), BagError>,
) -> Result<bool, BagError> {
    let io = |source| BagError::Io { path: path.to_owned(), source };
    let mut from = BufReader::new(File::open(path).map_err(io)?);
    let mut magic = [0; 8];
    if from.read_exact(&mut magic).is_err() || magic != *MAGIC {
        return Err(BagError::NoMcap { path: path.to_owned() });
    }
    let mut state = State::default();
    loop {
        let mut head = [0; 9];
        match from.read_exact(&mut head) {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(true),
            Err(error) => return Err(io(error)),
        }
        let [kind, length @ ..] = head;
        let length = u64::from_le_bytes(length);
        let mut content = Vec::new();
        let taken = from.by_ref().take(length.min(LARGEST)).read_to_end(&mut content).map_err(io)?;
        if taken as u64 != length {
            return Ok(true);
        }
        match kind {
            // The end of the data: the rest says it again.
            0x0f | 0x02 => return Ok(false),
            0x06 => chunk(path, &content, &mut state, &mut used)?,
            _ => hand_over(&mut state, kind, &content, &mut used)?,
        }
    }
}

fn hand_over(
    state: &mut State,
    kind: u8,
    content: &[u8],
    used: &mut impl FnMut(&Channel, u64, &[u8]) -> Result<(), BagError>,
) -> Result<(), BagError> {
    let Some((number, time_ns, payload)) = state.record(kind, content) else { return Ok(()) };
    state.channels.get(&number).map_or(Ok(()), |channel| used(channel, time_ns, payload))
}

fn chunk(
    path: &Path,
    content: &[u8],
    state: &mut State,
    used: &mut impl FnMut(&Channel, u64, &[u8]) -> Result<(), BagError>,
) -> Result<(), BagError> {
    let mut fields = Fields(content);
    let head = (|| {
        fields.take(28)?;
        let compression = fields.text()?;
        fields.u64()?;
        Some(compression)
    })();
    match head.as_deref() {
        Some("") => {}
        Some(other) => return Err(BagError::Compressed { path: path.to_owned(), by: other.to_owned() }),
        None => return Ok(()),
    }
    while let Some((kind, content)) = record(&mut fields) {
        hand_over(state, kind, content, used)?;
    }
    Ok(())
}

fn record<'a>(fields: &mut Fields<'a>) -> Option<(u8, &'a [u8])> {
    let kind = *fields.take(1)?.first()?;
    let length = usize::try_from(fields.u64()?).ok()?;
    Some((kind, fields.take(length)?))
}
