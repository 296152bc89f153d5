//! Recording: any source, unchanged, with every record also written to a log.
//!
//! The receiving side only copies records into chunks; a thread of its own writes them. Chunks are recycled, so nothing
//! is allocated per record, and their number is bounded: where the disk cannot keep up, records are dropped **and
//! counted**, and the source is never held up. Chunks hold whole records, and a write that the disk cut short is taken
//! back to the last whole record.
//!
//! Dropping a recorder writes its records before it returns, as [`Recorder::finish`] does; an earlier [`Tally`] has the
//! result.

mod files;
mod pipe;
mod queue;

pub use files::{LogFiles, Rotation};
pub use pipe::Pipe;

use super::{CsiSource, Error, Next};
use crate::time::{Instant, Span};
use queue::{Queue, Shared};
use std::sync::Arc;

/// Whole records on their way to the disk.
#[derive(Debug, Default)]
pub struct Chunk {
    /// Records as a `.dat` log has them, one after another.
    pub bytes: Vec<u8>,
    /// Host receive time of each record, microseconds since the Unix epoch.
    pub host_us: Vec<Option<i64>>,
    /// When the chunk was handed over, on the driver's clock.
    pub at: Instant,
}

/// What came of a chunk.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// Records that are in the log now.
    pub records: u64,
    /// Records that are not, and will not be.
    pub lost: u64,
    /// What went wrong, in words.
    pub error: Option<String>,
}

/// Where chunks go. Called on the writer thread; may block.
pub trait Sink: Send + 'static {
    /// Writes a chunk's whole records, or as many of them as can be.
    fn write(&mut self, chunk: &Chunk) -> Written;
    /// Makes everything written so far survive a power cut. Returns the error, if any.
    fn sync(&mut self) -> Option<String>;
}

/// How records wait for the disk.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Options {
    /// Bytes of a chunk; a fuller one is handed over.
    pub chunk_bytes: usize,
    /// Chunks there may be at most, waiting or being filled.
    pub chunks: usize,
    /// A chunk that is not full is handed over this long after its first record.
    pub hand_over: Span,
    /// How often the files are synchronised to the disk (`fsync`); `None` leaves that to the system.
    pub sync_every: Option<Span>,
}

impl Default for Options {
    /// 16 MiB of queue (four seconds at 20,000 records of 3x1 a second); 100 ms to the file, 1 s to the disk.
    fn default() -> Self {
        Self {
            chunk_bytes: 64 * 1024,
            chunks: 256,
            hand_over: Span::from_ms(100),
            sync_every: Some(Span::from_ms(1_000)),
        }
    }
}

/// What was recorded. `received = written + dropped + lost_on_disk` once the recorder is finished.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct Totals {
    /// Records that passed through.
    pub received: u64,
    /// Records in the log.
    pub written: u64,
    /// Records dropped because the disk was too slow and the queue full.
    pub dropped: u64,
    /// Records that the disk refused, or that its thread took with it when it died.
    pub lost_on_disk: u64,
    /// The last thing that went wrong on the disk.
    pub error: Option<String>,
    /// It is wrong still: nothing was written without it since.
    pub failing: bool,
}

/// The totals of a recorder, for any thread, and after its end.
#[derive(Clone, Debug)]
pub struct Tally(Arc<Shared>);

impl Tally {
    /// What was recorded so far.
    #[must_use]
    pub fn totals(&self) -> Totals {
        self.0.totals()
    }
}

/// A source whose records are also written to `W`.
pub struct Recorder<S, W: Sink> {
    source: S,
    queue: Queue<W>,
}

impl<S: CsiSource, W: Sink> Recorder<S, W> {
    /// Records `source` into `sink`, from its next record on.
    ///
    /// # Errors
    /// If the writer thread cannot be started.
    pub fn new(source: S, sink: W, options: Options) -> Result<Self, Error> {
        Ok(Self { source, queue: Queue::new(sink, options)? })
    }

    /// The source being recorded.
    pub fn source(&self) -> &S {
        &self.source
    }

    /// What was recorded so far.
    #[must_use]
    pub fn totals(&self) -> Totals {
        self.queue.shared().totals()
    }

    /// The totals, which outlive the recorder.
    #[must_use]
    pub fn tally(&self) -> Tally {
        Tally(Arc::clone(self.queue.shared()))
    }

    /// Writes the rest, syncs it, and returns everything.
    ///
    /// # Errors
    /// If the writer thread died.
    pub fn finish(mut self, now: Instant) -> Result<(S, W, Totals), Error> {
        let sink = self.queue.close(now).ok_or(Error::WriterDied)?;
        Ok((self.source, sink, self.queue.shared().totals()))
    }
}

impl<S: CsiSource, W: Sink> CsiSource for Recorder<S, W> {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        self.queue.keep_time(now);
        let next = self.source.receive(now)?;
        if let Next::Record(stamps, record) = &next {
            self.queue.push(now, stamps.host_us, *record);
        }
        Ok(next)
    }

    fn next_at(&self) -> Option<Instant> {
        self.source.next_at().into_iter().chain(self.queue.next_at()).min()
    }
}

#[cfg(test)]
mod tests;
