//! Records into a stream: standard output, a pipe, a socket.

use super::{Chunk, Sink, Written};
use std::io::Write;

/// A [`Sink`] that writes chunks to `W` until that fails once; what comes after is counted as lost.
#[derive(Debug)]
pub struct Pipe<W> {
    writer: W,
    broken: bool,
}

impl<W: Write> Pipe<W> {
    /// Writes to `writer`.
    pub fn new(writer: W) -> Self {
        Self { writer, broken: false }
    }
}

impl<W: Write + Send + 'static> Sink for Pipe<W> {
    fn write(&mut self, chunk: &Chunk) -> Written {
        let records = chunk.host_us.len() as u64;
        if self.broken {
            return Written { lost: records, ..Written::default() };
        }
        match self.writer.write_all(&chunk.bytes).and_then(|()| self.writer.flush()) {
            Ok(()) => Written { records, ..Written::default() },
            Err(error) => {
                // A stream cannot be undone: half a record may have been sent, so nothing may follow it.
                self.broken = true;
                Written {
                    lost: records,
                    error: Some(format!("the reader of the records went away: {error}")),
                    records: 0,
                }
            }
        }
    }

    fn sync(&mut self) -> Option<String> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Instant;

    /// A reader that goes away after some writes.
    struct Reader(usize, Vec<u8>);

    impl Write for Reader {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0 = self.0.checked_sub(1).ok_or(std::io::ErrorKind::BrokenPipe)?;
            self.1.extend(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn nothing_follows_a_chunk_that_was_not_written_whole() {
        let chunk = |byte: u8| Chunk { bytes: vec![byte; 4], host_us: vec![None; 3], at: Instant::ZERO };
        let mut pipe = Pipe::new(Reader(2, Vec::new()));
        for byte in [1, 2] {
            assert_eq!(pipe.write(&chunk(byte)), Written { records: 3, ..Written::default() });
        }
        let broken = pipe.write(&chunk(3));
        assert_eq!((broken.records, broken.lost), (0, 3));
        assert!(broken.error.is_some_and(|error| error.contains("went away")));
        pipe.writer.0 = 9;
        assert_eq!(pipe.write(&chunk(4)), Written { lost: 3, ..Written::default() });
        assert_eq!((pipe.sync(), pipe.writer.1), (None, [[1; 4], [2; 4]].concat()));
    }
}
