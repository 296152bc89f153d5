//! Messages of a bag of ROS 1 (\[rosbag\]), in order, read without its index.

use super::{BagError, Channel, Ended, Used, compressed, compressed_by};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

/// First bytes of a file.
pub(super) const MAGIC: &[u8; 13] = b"#ROSBAG V2.0\n";
/// Largest header or data of a record, bytes.
const LARGEST: u64 = 1 << 30;
/// Largest index at the end, bytes.
const LARGEST_INDEX: u64 = 256 << 20;

/// Kinds of records, field `op`.
mod op {
    pub const MESSAGE: u8 = 0x02;
    pub const CHUNK: u8 = 0x05;
    pub const CONNECTION: u8 = 0x07;
}

/// The value of a field of a header: `name=value`, preceded by the length of both.
fn field<'a>(mut header: &'a [u8], name: &str) -> Option<&'a [u8]> {
    while let Some((length, rest)) = header.split_first_chunk::<4>() {
        let (one, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        let value = one.strip_prefix(name.as_bytes()).and_then(|one| one.strip_prefix(b"="));
        if value.is_some() {
            return value;
        }
        header = rest;
    }
    None
}

fn text(header: &[u8], name: &str) -> Option<String> {
    field(header, name).and_then(|value| String::from_utf8(value.to_vec()).ok())
}

fn number(header: &[u8], name: &str) -> Option<u32> {
    field(header, name)?.first_chunk().map(|bytes| u32::from_le_bytes(*bytes))
}

/// Topics of a bag, by number.
type Connections = BTreeMap<u32, Channel>;

/// A record, its header and its data; `None` at the end of the file, an empty header if the record is cut.
fn next(from: &mut impl Read) -> std::io::Result<Option<(Vec<u8>, Vec<u8>)>> {
    let mut part = |first: bool| -> std::io::Result<Option<Vec<u8>>> {
        let mut length = [0; 4];
        match from.read_exact(&mut length[..1]) {
            Err(error) if error.kind() == ErrorKind::UnexpectedEof && first => return Ok(None),
            other => other?,
        }
        from.read_exact(&mut length[1..])?;
        let length = u64::from(u32::from_le_bytes(length));
        let mut bytes = Vec::new();
        let taken = from.by_ref().take(length.min(LARGEST)).read_to_end(&mut bytes)? as u64;
        if taken == length { Ok(Some(bytes)) } else { Err(ErrorKind::UnexpectedEof.into()) }
    };
    let Some(header) = part(true)? else { return Ok(None) };
    Ok(Some((header, part(false)?.unwrap_or_default())))
}

/// Passes each message of a bag to `used`.
pub(super) fn read(path: &Path, mut from: impl Read, used: &mut Used<'_>) -> Result<Ended, BagError> {
    let io = |source| BagError::Io { path: path.to_owned(), source };
    let mut magic = [0; MAGIC.len()];
    from.read_exact(&mut magic).map_err(io)?;
    let (mut connections, mut ended) = (described(path).unwrap_or_default(), Ended::default());
    loop {
        let (header, data) = match next(&mut from) {
            Ok(Some(record)) => record,
            Ok(None) => return Ok(ended),
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(Ended { cut: true, ..ended }),
            Err(error) => return Err(io(error)),
        };
        if field(&header, "op") != Some(&[op::CHUNK]) {
            record(&header, &data, &mut connections, &mut ended, used)?;
            continue;
        }
        let unpacked = match field(&header, "compression") {
            Some(b"none") => Ok(data),
            Some(b"lz4") => compressed::lz4(&data, compressed::LARGEST_CHUNK),
            by => {
                let by = String::from_utf8_lossy(by.unwrap_or(b"?"));
                return Err(compressed_by(path, &by, "rosbag decompress"));
            }
        };
        let Ok(unpacked) = unpacked else {
            ended.damaged_parts += 1;
            continue;
        };
        let mut rest = unpacked.as_slice();
        loop {
            match next(&mut rest) {
                Ok(Some((header, data))) => record(&header, &data, &mut connections, &mut ended, used)?,
                Ok(None) => break,
                Err(_) => {
                    ended.damaged_parts += 1;
                    break;
                }
            }
        }
    }
}

/// Stores a connection, passes on a message.
fn record(
    header: &[u8],
    data: &[u8],
    connections: &mut Connections,
    ended: &mut Ended,
    used: &mut Used<'_>,
) -> Result<(), BagError> {
    let (kind, connection) = (field(header, "op"), number(header, "conn"));
    match (kind, connection) {
        (Some(&[op::CONNECTION]), Some(number)) => {
            connections.insert(number, channel(header, data));
            Ok(())
        }
        (Some(&[op::MESSAGE]), Some(connection)) => {
            let Some(channel) = connections.get(&connection) else {
                ended.without_topic += 1;
                return Ok(());
            };
            used(channel, data)
        }
        (None, _) => {
            ended.damaged_parts += 1;
            Ok(())
        }
        _ => Ok(()),
    }
}

/// The topic of a connection.
fn channel(header: &[u8], data: &[u8]) -> Channel {
    Channel::of_ros1(text(header, "topic").unwrap_or_default(), &text(data, "type").unwrap_or_default())
}

/// The connections in the index at the end of a bag, which repeats them in case the first chunk with one is damaged. `None`
/// for an unfinished bag.
fn described(path: &Path) -> Option<Connections> {
    let mut file = File::open(path).ok().filter(|file| file.metadata().is_ok_and(|found| found.is_file()))?;
    let mut magic = [0; MAGIC.len()];
    file.read_exact(&mut magic).ok().filter(|()| magic == *MAGIC)?;
    let (header, _) = next(&mut file).ok()??;
    let start = u64::from_le_bytes(*field(&header, "index_pos")?.first_chunk()?);
    file.seek(SeekFrom::Start(start)).ok().filter(|_| start > 0)?;
    let (mut index, mut connections) = (BufReader::new(file).take(LARGEST_INDEX), Connections::new());
    while let Ok(Some((header, data))) = next(&mut index) {
        if let (Some(&[op::CONNECTION]), Some(number)) = (field(&header, "op"), number(&header, "conn")) {
            connections.insert(number, channel(&header, &data));
        }
    }
    Some(connections)
}
