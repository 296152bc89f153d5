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
                // A stream cannot be taken back: half a record may have gone out, so nothing may follow it.
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
