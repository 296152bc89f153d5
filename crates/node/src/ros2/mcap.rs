//! MCAP as `ros2 bag` writes it (profile `ros2`, messages in CDR, schemas `ros2msg`): chunks without compression, an index
//! of them and a summary at the end (\[mcap\]). A file that was not ended is whole up to its last chunk.

use driver_iface::mpdu::crc32;
use std::collections::BTreeMap;
use std::io::{self, Write};

const MAGIC: [u8; 8] = [0x89, b'M', b'C', b'A', b'P', 0x30, b'\r', b'\n'];
/// A chunk is written when it has so many bytes.
const CHUNK: usize = 1 << 20;

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

/// A topic of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Channel {
    /// Its whole name.
    pub topic: String,
    /// `nav_msgs/msg/Odometry`.
    pub kind: &'static str,
    /// Messages so far.
    pub messages: u64,
}

/// Where a chunk is.
struct ChunkIndex {
    times: (u64, u64),
    start: u64,
    length: u64,
    /// By channel, where the index of its messages is.
    offsets: Vec<(u16, u64)>,
    index_length: u64,
    size: u64,
}

/// Times of a channel's messages and where in the chunk they are.
type MessageIndex = Vec<(u64, u64)>;

/// A chunk that is being filled.
#[derive(Default)]
struct Chunk {
    bytes: Vec<u8>,
    times: Option<(u64, u64)>,
    messages: BTreeMap<u16, MessageIndex>,
}

/// Writes a recording.
pub(crate) struct McapWriter<W> {
    to: W,
    at: u64,
    chunk: Chunk,
    chunks: Vec<ChunkIndex>,
    /// Schemas and channels, for the summary.
    described: Vec<u8>,
    schemas: Vec<&'static str>,
    channels: Vec<Channel>,
    times: Option<(u64, u64)>,
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
    /// Begins a recording.
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

    /// The topics.
    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }

    /// Times of the first and the last message, nanoseconds.
    pub fn times(&self) -> Option<(u64, u64)> {
        self.times
    }

    fn channel(&mut self, topic: &str, kind: &'static str, definition: fn() -> String) -> u16 {
        if let Some(known) = self.channels.iter().position(|channel| channel.topic == topic && channel.kind == kind) {
            return known as u16;
        }
        let mut both = Vec::new();
        let schema = self.schemas.iter().position(|known| *known == kind).unwrap_or_else(|| {
            self.schemas.push(kind);
            // Number 0 is of no schema.
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
        self.channels.push(Channel { topic: topic.to_owned(), kind, messages: 0 });
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

    /// Writes what waits.
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
        // Their CRC-32, and no compression.
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
        // No offsets within the summary, no sum.
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
        assert!(bytes.starts_with(&MAGIC) && bytes.ends_with(&MAGIC));
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
