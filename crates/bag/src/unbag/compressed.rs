//! Compressed data: chunks, messages, and whole files as `ros2 bag record --compression-mode file` writes them.

use ruzstd::decoding::{FrameDecoder, StreamingDecoder};
use std::fs::File;
use std::io::{self, Read, Seek};
use std::os::unix::fs::OpenOptionsExt;

/// Largest message of CSI or poses, bytes.
pub(super) const LARGEST_MESSAGE: u64 = 16 << 20;
/// Largest chunk, unpacked bytes: recorders start a new chunk after some megabytes.
pub(crate) const LARGEST_CHUNK: u64 = 256 << 20;
/// Largest file that must be unpacked on disk because it needs random access, bytes.
pub(super) const LARGEST_FILE: u64 = 4 << 30;

/// True for bytes that begin as a frame of Zstandard (RFC 8878, 3.1.1). No ROS 2 message does: it begins with a zero.
pub(crate) fn is_zstd(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x28, 0xb5, 0x2f, 0xfd])
}

/// The content of a Zstandard frame, as a stream; a damaged frame ends early.
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

/// The content of consecutive Zstandard frames, as a stream.
pub(crate) struct Frames<'a> {
    rest: &'a [u8],
    frame: Option<StreamingDecoder<&'a [u8], FrameDecoder>>,
}

impl<'a> Frames<'a> {
    /// From bytes in memory.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, frame: None }
    }
}

impl Read for Frames<'_> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        loop {
            if let Some(frame) = &mut self.frame {
                let count = frame.read(to)?;
                if count > 0 || to.is_empty() {
                    return Ok(count);
                }
                self.rest = *frame.get_ref();
            }
            if self.rest.is_empty() {
                return Ok(0);
            }
            self.frame = Some(StreamingDecoder::new(self.rest).map_err(io::Error::other)?);
        }
    }
}

/// The content of an LZ4 frame, at most `most` bytes.
pub(super) fn lz4(bytes: &[u8], most: u64) -> io::Result<Vec<u8>> {
    bounded(lz4_flex::frame::FrameDecoder::new(bytes), most)
}

/// The whole content, if it is at most `most` bytes.
pub(super) fn bounded(from: impl Read, most: u64) -> io::Result<Vec<u8>> {
    let mut all = Vec::new();
    from.take(most.saturating_add(1)).read_to_end(&mut all)?;
    if all.len() as u64 > most {
        return Err(too_much(most));
    }
    Ok(all)
}

/// The whole content in an unnamed file, if it is at most `most` bytes.
pub(super) fn unpacked(from: impl Read, most: u64) -> io::Result<File> {
    let name = format!("csi5300-{}-{:?}.unpacked", std::process::id(), std::thread::current().id());
    let name = std::env::temp_dir().join(name);
    let mut file = File::options().read(true).write(true).create_new(true).mode(0o600).open(&name)?;
    std::fs::remove_file(&name)?;
    if io::copy(&mut from.take(most.saturating_add(1)), &mut file)? > most {
        return Err(too_much(most));
    }
    file.rewind()?;
    Ok(file)
}

fn too_much(most: u64) -> io::Error {
    io::Error::other(format!("it contains more than {} MiB", most >> 20))
}
