//! MCAP as `ros2 bag` writes it (\[mcap\]): profile `ros2`, messages in CDR, schemas `ros2msg`. The writer makes uncompressed
//! chunks with indices, and a summary at the end; an unfinished file is readable up to its last chunk. The reader accepts
//! compressed chunks and reads from start to end without the index, so that it also reads files without an end.

use crate::cdr::{Cdr, CdrError, CdrReader};
use crate::unbag::{BagError, Channel, Ended, Used, compressed, compressed_by};
use crc32fast::hash as crc32;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// First bytes of a file.
pub(crate) const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";
/// Kinds of records.
mod kind {
    pub const HEADER: u8 = 0x01;
    pub const FOOTER: u8 = 0x02;
    pub const SCHEMA: u8 = 0x03;
    pub const CHANNEL: u8 = 0x04;
    pub const MESSAGE: u8 = 0x05;
    pub const CHUNK: u8 = 0x06;
    pub const MESSAGE_INDEX: u8 = 0x07;
    pub const CHUNK_INDEX: u8 = 0x08;
    pub const STATISTICS: u8 = 0x0b;
    pub const DATA_END: u8 = 0x0f;
}

/// A chunk of this many bytes is written.
const CHUNK: usize = 1 << 20;

/// A topic of the recording being written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// Its full name.
    pub topic: String,
    /// `nav_msgs/msg/Odometry`.
    pub kind: &'static str,
    /// Messages so far.
    pub messages: u64,
}

/// The place of a chunk.
struct ChunkIndex {
    times: (u64, u64),
    start: u64,
    length: u64,
    /// By channel, the place of its message index.
    offsets: Vec<(u16, u64)>,
    index_length: u64,
    size: u64,
}

/// Times of a channel's messages and their offsets in the chunk.
type MessageIndex = Vec<(u64, u64)>;

/// The chunk being filled.
#[derive(Default)]
struct Chunk {
    bytes: Vec<u8>,
    times: Option<(u64, u64)>,
    messages: BTreeMap<u16, MessageIndex>,
}

/// Writes a recording.
pub struct McapWriter<W> {
    to: W,
    at: u64,
    chunk: Chunk,
    chunks: Vec<ChunkIndex>,
    /// Schemas and channels, for the summary.
    described: Vec<u8>,
    schemas: Vec<&'static str>,
    /// The topics.
    pub channels: Vec<Written>,
    /// Times of the first and the last message, nanoseconds.
    pub times: Option<(u64, u64)>,
}

fn text(text: &str, to: &mut Vec<u8>) {
    to.extend((text.len() as u32).to_le_bytes());
    to.extend(text.as_bytes());
}

fn record(kind: u8, content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u64).to_le_bytes();
    [&[kind][..], &length, content].concat()
}

fn widened(times: Option<(u64, u64)>, time: u64) -> Option<(u64, u64)> {
    Some(times.map_or((time, time), |(first, last)| (first.min(time), last.max(time))))
}

impl<W: Write> McapWriter<W> {
    /// Starts a recording.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn new(mut to: W) -> io::Result<Self> {
        let mut header = Vec::new();
        text("ros2", &mut header);
        text(concat!("csi5300 ", env!("CARGO_PKG_VERSION")), &mut header);
        let begin = [&MAGIC[..], &record(kind::HEADER, &header)].concat();
        to.write_all(&begin)?;
        let (at, chunk, chunks) = (begin.len() as u64, Chunk::default(), Vec::new());
        let (described, schemas, channels) = (Vec::new(), Vec::new(), Vec::new());
        Ok(Self { to, at, chunk, chunks, described, schemas, channels, times: None })
    }

    fn channel(&mut self, topic: &str, kind: &'static str, definition: fn() -> String) -> u16 {
        if let Some(known) = self.channels.iter().position(|channel| channel.topic == topic && channel.kind == kind) {
            return known as u16;
        }
        let mut both = Vec::new();
        let schema = self.schemas.iter().position(|known| *known == kind).unwrap_or_else(|| {
            self.schemas.push(kind);
            // Schema number 0 means "none".
            let mut schema = (self.schemas.len() as u16).to_le_bytes().to_vec();
            text(kind, &mut schema);
            text("ros2msg", &mut schema);
            text(&definition(), &mut schema);
            both.extend(record(kind::SCHEMA, &schema));
            self.schemas.len() - 1
        });
        let number = self.channels.len() as u16;
        let mut channel = number.to_le_bytes().to_vec();
        channel.extend((schema as u16 + 1).to_le_bytes());
        text(topic, &mut channel);
        text("cdr", &mut channel);
        let mut qos = Vec::new();
        text("offered_qos_profiles", &mut qos);
        text("", &mut qos);
        channel.extend((qos.len() as u32).to_le_bytes());
        channel.extend(qos);
        both.extend(record(kind::CHANNEL, &channel));
        self.described.extend_from_slice(&both);
        self.chunk.bytes.extend(both);
        self.channels.push(Written { topic: topic.to_owned(), kind, messages: 0 });
        number
    }

    /// Records a message, its time in nanoseconds since the Unix epoch.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn put(
        &mut self,
        (topic, kind, definition): (&str, &'static str, fn() -> String),
        time_ns: u64,
        payload: &[u8],
    ) -> io::Result<()> {
        let number = self.channel(topic, kind, definition);
        let Some(channel) = self.channels.get_mut(usize::from(number)) else { return Ok(()) };
        channel.messages += 1;
        let mut message = number.to_le_bytes().to_vec();
        message.extend((channel.messages as u32).to_le_bytes());
        message.extend(time_ns.to_le_bytes());
        message.extend(time_ns.to_le_bytes());
        message.extend(payload);
        let offset = self.chunk.bytes.len() as u64;
        self.chunk.messages.entry(number).or_default().push((time_ns, offset));
        self.chunk.bytes.extend(record(kind::MESSAGE, &message));
        self.chunk.times = widened(self.chunk.times, time_ns);
        self.times = widened(self.times, time_ns);
        if self.chunk.bytes.len() >= CHUNK { self.flush() } else { Ok(()) }
    }

    /// Writes the current chunk.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn flush(&mut self) -> io::Result<()> {
        let chunk = std::mem::take(&mut self.chunk);
        let Some(times) = chunk.times else {
            self.chunk = chunk;
            return Ok(());
        };
        let size = chunk.bytes.len() as u64;
        let mut content = [times.0, times.1, size].map(u64::to_le_bytes).concat();
        // CRC-32 of the records; no compression.
        content.extend(crc32(&chunk.bytes).to_le_bytes());
        content.extend([0; 4]);
        content.extend(size.to_le_bytes());
        content.extend(chunk.bytes);
        let bytes = record(kind::CHUNK, &content);
        let (start, length) = (self.at, bytes.len() as u64);
        self.emit(&bytes)?;
        let (begin, mut offsets) = (self.at, Vec::new());
        for (number, messages) in chunk.messages {
            offsets.push((number, self.at));
            let mut content = number.to_le_bytes().to_vec();
            content.extend((messages.len() as u32 * 16).to_le_bytes());
            content
                .extend(messages.iter().flat_map(|(time, offset)| [time.to_le_bytes(), offset.to_le_bytes()].concat()));
            self.emit(&record(kind::MESSAGE_INDEX, &content))?;
        }
        self.chunks.push(ChunkIndex { times, start, length, offsets, index_length: self.at - begin, size });
        self.to.flush()
    }

    fn emit(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.to.write_all(bytes)?;
        self.at += bytes.len() as u64;
        Ok(())
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        self.emit(&record(kind::DATA_END, &[0; 4]))?;
        let summary = self.at;
        let mut bytes = std::mem::take(&mut self.described);
        for chunk in &self.chunks {
            let mut content = [chunk.times.0, chunk.times.1, chunk.start, chunk.length].map(u64::to_le_bytes).concat();
            content.extend((chunk.offsets.len() as u32 * 10).to_le_bytes());
            for (number, offset) in &chunk.offsets {
                content.extend(number.to_le_bytes());
                content.extend(offset.to_le_bytes());
            }
            content.extend(chunk.index_length.to_le_bytes());
            content.extend([0; 4]);
            content.extend([chunk.size, chunk.size].map(u64::to_le_bytes).concat());
            bytes.extend(record(kind::CHUNK_INDEX, &content));
        }
        bytes.extend(self.statistics());
        let mut footer = summary.to_le_bytes().to_vec();
        // No offsets within the summary, no CRC.
        footer.extend([0; 12]);
        bytes.extend(record(kind::FOOTER, &footer));
        bytes.extend(MAGIC);
        self.emit(&bytes)?;
        self.to.flush()
    }

    fn statistics(&self) -> Vec<u8> {
        let messages: u64 = self.channels.iter().map(|channel| channel.messages).sum();
        let (first, last) = self.times.unwrap_or_default();
        let mut content = messages.to_le_bytes().to_vec();
        content.extend((self.schemas.len() as u16).to_le_bytes());
        content.extend((self.channels.len() as u32).to_le_bytes());
        content.extend([0; 8]);
        content.extend((self.chunks.len() as u32).to_le_bytes());
        content.extend([first, last].map(u64::to_le_bytes).concat());
        content.extend((self.channels.len() as u32 * 10).to_le_bytes());
        for (number, channel) in self.channels.iter().enumerate() {
            content.extend((number as u16).to_le_bytes());
            content.extend(channel.messages.to_le_bytes());
        }
        record(kind::STATISTICS, &content)
    }
}

/// Largest record, bytes.
const LARGEST: u64 = 1 << 30;
/// Largest record in a chunk that is decoded, bytes.
const LARGEST_IN_CHUNK: u64 = 32 << 20;
/// Largest summary, bytes: only its description of topics is used.
const LARGEST_SUMMARY: u64 = 64 << 20;
/// Length of the footer, which locates the summary, with the file's last bytes.
const FOOTER: u64 = 9 + 20 + MAGIC.len() as u64;

/// What is known of a file so far.
#[derive(Default)]
struct State {
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, Channel>,
}

impl State {
    /// Handles a record; returns the message if it contains one.
    fn record<'a>(&mut self, kind: u8, content: &'a [u8]) -> Result<Option<(u16, &'a [u8])>, CdrError> {
        let mut from = CdrReader::packed(content);
        match kind {
            kind::SCHEMA => {
                let (number, name) = (u16::read(&mut from)?, String::read(&mut from)?);
                self.schemas.insert(number, name);
            }
            kind::CHANNEL => {
                let (number, schema) = (u16::read(&mut from)?, u16::read(&mut from)?);
                let (topic, encoding) = (String::read(&mut from)?, String::read(&mut from)?);
                let kind = self.schemas.get(&schema).cloned().unwrap_or_default();
                let channel = match encoding.as_str() {
                    "ros1" => Channel::of_ros1(topic, &kind),
                    _ => Channel { topic, kind, encoding },
                };
                self.channels.insert(number, channel);
            }
            kind::MESSAGE => {
                let number = u16::read(&mut from)?;
                // Sequence number and two times.
                from.take(20)?;
                return Ok(Some((number, from.rest())));
            }
            _ => {}
        }
        Ok(None)
    }
}

/// A file being read.
struct Reading<'a, 'b> {
    path: &'a Path,
    state: State,
    ended: Ended,
    used: &'a mut Used<'b>,
}

/// Passes each message of a file to `used`.
pub(crate) fn read(path: &Path, mut from: impl Read, used: &mut Used<'_>) -> Result<Ended, BagError> {
    let io = |source| BagError::Io { path: path.to_owned(), source };
    let mut magic = [0; MAGIC.len()];
    from.read_exact(&mut magic).map_err(io)?;
    let mut reading = Reading { path, state: described(path).unwrap_or_default(), ended: Ended::default(), used };
    let mut has_data = true;
    loop {
        match next_record(&mut from, LARGEST) {
            // The summary behind it repeats the data.
            Ok(Some((kind::DATA_END, _))) => has_data = false,
            Ok(Some((kind::FOOTER, _))) => {
                let mut marks = Vec::new();
                from.by_ref().take(2 * MAGIC.len() as u64).read_to_end(&mut marks).map_err(io)?;
                match marks.strip_prefix(MAGIC) {
                    // Another file was put behind.
                    Some(next) if next == MAGIC => (reading.state, has_data) = (State::default(), true),
                    Some([_, ..]) => {
                        return Ok(Ended { damaged_parts: reading.ended.damaged_parts + 1, ..reading.ended });
                    }
                    _ => return Ok(reading.ended),
                }
            }
            Ok(Some((kind::CHUNK, content))) => reading.chunk(&content)?,
            Ok(Some((kind, content))) => reading.record(kind, &content)?,
            Err(error) if error.kind() != ErrorKind::UnexpectedEof => return Err(io(error)),
            Ok(None) | Err(_) => return Ok(Ended { cut: has_data, ..reading.ended }),
        }
    }
}

/// The next record, its kind and its content, which is skipped if it is longer than `most` bytes; `None` at the end.
fn next_record(from: &mut impl Read, most: u64) -> io::Result<Option<(u8, Vec<u8>)>> {
    let mut head = [0; 9];
    match from.read_exact(&mut head[..1]) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
        read => read?,
    }
    from.read_exact(&mut head[1..])?;
    let [kind, length @ ..] = head;
    let length = u64::from_le_bytes(length);
    let (mut part, mut content) = (from.take(length), Vec::new());
    let taken = match length > most {
        true => io::copy(&mut part, &mut io::sink())?,
        false => part.read_to_end(&mut content)? as u64,
    };
    if taken == length { Ok(Some((kind, content))) } else { Err(ErrorKind::UnexpectedEof.into()) }
}

/// The topics in the summary at the end of a file, which repeats them in case the first chunk with them is damaged. `None`
/// without a summary or if its CRC is wrong.
fn described(path: &Path) -> Option<State> {
    let mut file = File::open(path).ok().filter(|file| file.metadata().is_ok_and(|found| found.is_file()))?;
    let end = file.seek(SeekFrom::End(0)).ok()?;
    file.seek(SeekFrom::Start(end.checked_sub(FOOTER)?)).ok()?;
    let mut footer = Vec::new();
    (&file).take(FOOTER).read_to_end(&mut footer).ok()?;
    let mut from = CdrReader::packed(footer.strip_suffix(MAGIC)?.strip_prefix(&[kind::FOOTER])?);
    let [_, start, _] = <[u64; 3]>::read(&mut from).ok()?;
    let sum = u32::read(&mut from).ok()?;
    let length = (end - MAGIC.len() as u64).checked_sub(start).filter(|length| *length <= LARGEST_SUMMARY)?;
    file.seek(SeekFrom::Start(start)).ok().filter(|_| start > 0)?;
    let mut summary = Vec::new();
    file.take(length).read_to_end(&mut summary).ok()?;
    // All but the CRC itself.
    let summed = summary.get(..summary.len().checked_sub(4)?)?;
    if sum != 0 && crc32(summed) != sum {
        return None;
    }
    let (mut state, mut from) = (State::default(), summary.as_slice());
    while let Ok(Some((kind, content))) = next_record(&mut from, LARGEST_SUMMARY) {
        // A record that cannot be read describes nothing.
        let _ = state.record(kind, &content);
    }
    Some(state)
}

impl Reading<'_, '_> {
    /// Handles a record; passes on a message.
    fn record(&mut self, kind: u8, content: &[u8]) -> Result<(), BagError> {
        let Ok(Some((number, payload))) = self.state.record(kind, content) else { return Ok(()) };
        match self.state.channels.get(&number) {
            Some(channel) => (self.used)(channel, payload),
            None => {
                self.ended.without_topic += 1;
                Ok(())
            }
        }
    }

    /// Handles a chunk; counts it if it is damaged. It is unpacked twice, first to check that it is complete: nothing of a
    /// damaged chunk is used, and only one of its records is in memory at a time.
    fn chunk(&mut self, content: &[u8]) -> Result<(), BagError> {
        let chunk = match ReadChunk::of(content) {
            Ok(chunk) if !["", "zstd", "lz4"].contains(&chunk.compression.as_str()) => {
                return Err(compressed_by(self.path, &chunk.compression, "mcap compress --compression none"));
            }
            Ok(chunk) if chunk.is_good() => chunk,
            _ => {
                self.ended.damaged_parts += 1;
                return Ok(());
            }
        };
        let mut from = chunk.unpacked();
        loop {
            // A longer one is an image or a point cloud: no message of ours is so large.
            match next_record(&mut from, LARGEST_IN_CHUNK) {
                Ok(Some((kind, content))) => self.record(kind, &content)?,
                Ok(None) => return Ok(()),
                Err(_) => {
                    self.ended.damaged_parts += 1;
                    return Ok(());
                }
            }
        }
    }
}

/// The content of a chunk record.
struct ReadChunk<'a> {
    /// Unpacked bytes of its records.
    size: u64,
    /// Their CRC-32; 0 where it was not computed.
    sum: u32,
    compression: String,
    records: &'a [u8],
}

impl<'a> ReadChunk<'a> {
    fn of(content: &'a [u8]) -> Result<Self, CdrError> {
        let mut from = CdrReader::packed(content);
        // Times of the first and the last message.
        from.take(16)?;
        let (size, sum, compression) = (u64::read(&mut from)?, u32::read(&mut from)?, String::read(&mut from)?);
        let length = u64::read(&mut from)?;
        Ok(Self { size, sum, compression, records: from.take(usize::try_from(length).unwrap_or(usize::MAX))? })
    }

    /// Its records.
    fn unpacked(&self) -> Box<dyn Read + 'a> {
        match self.compression.as_str() {
            "" => Box::new(self.records),
            "zstd" => Box::new(compressed::Frames::new(self.records)),
            _ => Box::new(lz4_flex::frame::FrameDecoder::new(self.records)),
        }
    }

    /// True if it unpacks to the stated number of bytes with the stated CRC.
    fn is_good(&self) -> bool {
        let (mut from, mut sum, mut length) = (self.unpacked(), crc32fast::Hasher::new(), 0);
        let mut buffer = [0; 1 << 14];
        if self.size > compressed::LARGEST_CHUNK {
            return false;
        }
        loop {
            match from.read(&mut buffer) {
                Ok(0) => return length == self.size && (self.sum == 0 || sum.finalize() == self.sum),
                Ok(count) => {
                    sum.update(buffer.get(..count).unwrap_or_default());
                    length += count as u64;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return false,
            }
            if length > self.size {
                return false;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Kinds and contents of the records in `bytes`.
    fn records(mut bytes: &[u8]) -> Vec<(u8, &[u8])> {
        let mut all = Vec::new();
        while bytes.len() >= 9 {
            let length = u64::from_le_bytes(bytes[1..9].try_into().unwrap()) as usize;
            all.push((bytes[0], &bytes[9..9 + length]));
            bytes = &bytes[9 + length..];
        }
        all
    }

    #[test]
    fn a_converted_bag_of_ros_1_has_the_types_of_ros_2() {
        let mut state = State::default();
        let of = |numbers: &[u16], words: [&str; 2]| {
            let mut content: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
            words.iter().for_each(|word| text(word, &mut content));
            content
        };
        state.record(kind::SCHEMA, &of(&[7], ["nav_msgs/Odometry", "ros1msg"])).unwrap();
        state.record(kind::CHANNEL, &of(&[2, 7], ["/odom", "ros1"])).unwrap();
        assert_eq!(state.channels[&2].kind, "nav_msgs/msg/Odometry");
    }

    #[test]
    fn indices_and_the_summary_lead_to_every_message() {
        let mut writer = McapWriter::new(Vec::new()).unwrap();
        let schema = || "uint8 x\n".to_owned();
        for k in 0..5_u8 {
            writer.put((if k % 2 == 0 { "/a" } else { "/b" }, "p/msg/X", schema), 100 + u64::from(k), &[k; 6]).unwrap();
            if k == 2 {
                writer.flush().unwrap();
            }
        }
        writer.finish().unwrap();
        let bytes = writer.to;
        assert!(bytes.starts_with(MAGIC) && bytes.ends_with(MAGIC));
        let all = records(&bytes[8..bytes.len() - 8]);
        let kinds: Vec<u8> = all.iter().map(|(kind, _)| *kind).collect();
        assert_eq!(kinds, [1, 6, 7, 7, 6, 7, 7, 15, 3, 4, 4, 8, 8, 11, 2]);
        let number = |bytes: &[u8], at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
        assert_eq!(bytes[number(all[14].1, 0)], kind::SCHEMA, "the summary begins where the footer says");
        for (_, index) in all.iter().filter(|(kind, _)| *kind == kind::CHUNK_INDEX) {
            let (start, length) = (number(index, 16), number(index, 24));
            let chunk = records(&bytes[start..start + length])[0];
            assert_eq!(chunk.0, kind::CHUNK);
            let inside = &chunk.1[40..];
            assert_eq!(chunk.1[24..28], crc32(inside).to_le_bytes());
            assert_eq!(number(chunk.1, 32), inside.len());
            for entry in index[36..56].chunks(10) {
                let messages = records(&bytes[number(entry, 2)..])[0].1;
                assert_eq!(messages[..2], entry[..2], "of its channel");
                for one in messages[6..].chunks(16) {
                    let message = records(&inside[number(one, 8)..])[0];
                    assert_eq!((message.0, number(message.1, 6)), (kind::MESSAGE, number(one, 0)));
                }
            }
        }
        assert_eq!(number(all[13].1, 0), 5);
    }
}
