//! Bytes that were compressed: chunks and messages, and whole files as `ros2 bag record --compression-mode file` writes them.

use ruzstd::decoding::StreamingDecoder;
use std::io::{self, Read};

/// Bytes of a chunk or message at most.
const LARGEST: u64 = 1 << 30;
/// Bytes of a message of ours, or of poses, at most.
pub(super) const LARGEST_MESSAGE: u64 = 16 << 20;
/// Bytes of a chunk that does not say how long it is.
pub(super) const LARGEST_CHUNK: u64 = 256 << 20;
/// Bytes of a file that cannot be read from its beginning to its end, and is kept.
pub(super) const LARGEST_FILE: u64 = 4 << 30;

/// True for bytes that begin as a frame of Zstandard (RFC 8878, 3.1.1). No message of ROS 2 does: it begins with a zero.
pub(super) fn is_zstd(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x28, 0xb5, 0x2f, 0xfd])
}

/// What is in a frame of Zstandard, as it is read: where it is damaged it ends too soon.
pub(super) fn stream(from: impl Read) -> io::Result<impl Read> {
    StreamingDecoder::new(from).map(Unpacked).map_err(io::Error::other)
}

struct Unpacked<R>(R);

impl<R: Read> Read for Unpacked<R> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let too_soon = |error: io::Error| io::Error::new(io::ErrorKind::UnexpectedEof, error);
        self.0
            .read(to)
            .map_err(|error| if error.kind() == io::ErrorKind::Interrupted { error } else { too_soon(error) })
    }
}

/// What is in frames of Zstandard, at most `most` bytes.
pub(super) fn zstd(mut bytes: &[u8], most: u64) -> io::Result<Vec<u8>> {
    let mut all = Vec::new();
    while !bytes.is_empty() {
        let left = most.min(LARGEST) - all.len() as u64;
        all.extend(bounded(stream(&mut bytes)?, left)?);
    }
    Ok(all)
}

/// What is in a frame of LZ4, at most `most` bytes.
pub(super) fn lz4(bytes: &[u8], most: u64) -> io::Result<Vec<u8>> {
    bounded(lz4_flex::frame::FrameDecoder::new(bytes), most.min(LARGEST))
}

/// All of it, if it is not more than `most` bytes.
pub(super) fn bounded(from: impl Read, most: u64) -> io::Result<Vec<u8>> {
    let mut all = Vec::new();
    from.take(most.saturating_add(1)).read_to_end(&mut all)?;
    if all.len() as u64 > most {
        return Err(io::Error::other(format!("there are more than {} MiB in it", most >> 20)));
    }
    Ok(all)
}
