//! Recording: any source, unchanged, with every record also written to a log.
//!
//! The receiving side only copies records into chunks; a thread of its own writes them. Chunks are recycled, so nothing
//! is allocated per record, and their number is bounded: where the disk cannot keep up, records are dropped **and
//! counted**, and the source is never held up. Chunks hold whole records, and a write that the disk cut short is taken
//! back to the last whole record.

mod files;
mod pipe;

pub use files::{LogFiles, Rotation};
pub use pipe::Pipe;

use super::{CsiSource, Error, Next, Stamps};
use crate::time::{Instant, Span};
use driver_iface::record::Record;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

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
    /// Makes everything written so far survive a power cut. Gives what went wrong, if anything.
    fn sync(&mut self) -> Option<String>;
}

/// How records wait for the disk.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Bytes of a chunk; a fuller one is handed over.
    pub chunk_bytes: usize,
    /// Chunks there may be at most, waiting or being filled.
    pub chunks: usize,
    /// A chunk that is not full is handed over this long after its first record.
    pub hand_over: Span,
    /// How often the disk is told to make it last; `None` leaves that to the system.
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
pub struct Totals {
    /// Records that passed through.
    pub received: u64,
    /// Records in the log.
    pub written: u64,
    /// Records dropped because the disk was too slow and the queue full.
    pub dropped: u64,
    /// Records that the disk refused.
    pub lost_on_disk: u64,
    /// The last thing that went wrong on the disk.
    pub error: Option<String>,
}

enum Message {
    Write { chunk: Chunk, sync: bool },
    Sync,
}

/// A source whose records are also written to `W`.
pub struct Recorder<S, W> {
    source: S,
    options: Options,
    current: Chunk,
    made: usize,
    full: SyncSender<Message>,
    empty: Receiver<Chunk>,
    writer: JoinHandle<W>,
    outcome: Arc<Mutex<Written>>,
    received: u64,
    dropped: u64,
    hand_over_at: Option<Instant>,
    sync_at: Option<Instant>,
}

impl<S: CsiSource, W: Sink> Recorder<S, W> {
    /// Records `source` into `sink`, from now on.
    ///
    /// # Errors
    /// If the writer thread cannot be started.
    pub fn new(source: S, sink: W, options: Options) -> Result<Self, Error> {
        // One more than chunks, for a bare request to sync: sending never waits.
        let (full, from_receiver) = sync_channel(options.chunks + 1);
        let (to_receiver, empty) = channel();
        let outcome = Arc::new(Mutex::new(Written::default()));
        let shared = Arc::clone(&outcome);
        let write = move || {
            let mut sink = sink;
            while let Ok(message) = from_receiver.recv() {
                work(&mut sink, message, &shared, |chunk| drop(to_receiver.send(chunk)));
            }
            note(&shared, Written { error: sink.sync(), ..Written::default() });
            sink
        };
        let named = std::thread::Builder::new().name("csi5300 writer".into());
        let what = "cannot start the thread that writes the log".into();
        let writer = named.spawn(write).map_err(|source| Error::Io { what, source })?;
        let current = Chunk { bytes: Vec::with_capacity(options.chunk_bytes), ..Chunk::default() };
        Ok(Self {
            source,
            options,
            current,
            made: 1,
            full,
            empty,
            writer,
            outcome,
            received: 0,
            dropped: 0,
            hand_over_at: None,
            sync_at: None,
        })
    }

    /// The source being recorded.
    pub fn source(&self) -> &S {
        &self.source
    }

    /// What was recorded so far.
    #[must_use]
    pub fn totals(&self) -> Totals {
        let written = self.outcome.lock().unwrap_or_else(PoisonError::into_inner).clone();
        Totals {
            received: self.received,
            written: written.records,
            dropped: self.dropped,
            lost_on_disk: written.lost,
            error: written.error,
        }
    }

    /// Writes what is left, makes it last, and gives everything back.
    ///
    /// # Errors
    /// If the writer thread died.
    pub fn finish(mut self, now: Instant) -> Result<(S, W, Totals), Error> {
        let left = self.current.host_us.len() as u64;
        self.current.at = now;
        let chunk = std::mem::take(&mut self.current);
        if self.full.send(Message::Write { chunk, sync: false }).is_err() {
            self.dropped += left;
        }
        drop(self.full);
        let sink = self.writer.join().map_err(|_| Error::Input("the thread that writes the log died".into()))?;
        let written = self.outcome.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let totals = Totals {
            received: self.received,
            written: written.records,
            dropped: self.dropped,
            lost_on_disk: written.lost,
            error: written.error,
        };
        Ok((self.source, sink, totals))
    }

    /// An empty chunk, if the bound allows one.
    fn spare(&mut self) -> Option<Chunk> {
        match self.empty.try_recv() {
            Ok(mut chunk) => {
                chunk.bytes.clear();
                chunk.host_us.clear();
                Some(chunk)
            }
            Err(TryRecvError::Empty | TryRecvError::Disconnected) if self.made < self.options.chunks => {
                self.made += 1;
                Some(Chunk { bytes: Vec::with_capacity(self.options.chunk_bytes), ..Chunk::default() })
            }
            Err(_) => None,
        }
    }

    /// Gives the current chunk to the writer; false if there is no other to go on with.
    fn hand_over(&mut self, now: Instant) -> bool {
        let Some(spare) = self.spare() else { return false };
        let mut chunk = std::mem::replace(&mut self.current, spare);
        chunk.at = now;
        let sync = self.sync_at.is_some_and(|at| at <= now);
        let records = chunk.host_us.len() as u64;
        if self.full.try_send(Message::Write { chunk, sync }).is_err() {
            self.dropped += records;
        }
        self.hand_over_at = None;
        self.sync_at = match self.sync_at {
            Some(at) if !sync => Some(at),
            _ => self.options.sync_every.map(|every| now + every),
        };
        true
    }

    /// What is due by now: a chunk that waited long enough, or a sync.
    fn keep_time(&mut self, now: Instant) {
        if self.hand_over_at.is_some_and(|at| at <= now) && !self.hand_over(now) {
            self.hand_over_at = Some(now + self.options.hand_over);
        }
        if self.hand_over_at.is_none() && self.sync_at.is_some_and(|at| at <= now) {
            // A full channel means that a chunk is being written: ask again with the next one.
            let sent = self.full.try_send(Message::Sync).is_ok();
            self.sync_at = if sent { None } else { Some(now + self.options.hand_over) };
        }
    }
}

/// Copies a record into the chunk; false if it does not fit the chunk.
fn push(chunk: &mut Chunk, limit: usize, stamps: Stamps, record: Record<'_>) -> bool {
    let (from, need) = (chunk.bytes.len(), record.emit_len());
    // A record longer than a whole chunk still gets one of its own.
    if from > 0 && from + need > limit {
        return false;
    }
    chunk.bytes.resize(from + need, 0);
    let Some(room) = chunk.bytes.get_mut(from..) else { return false };
    if record.emit(room).is_err() {
        chunk.bytes.truncate(from);
        return false;
    }
    chunk.host_us.push(stamps.host_us);
    true
}

fn work<W: Sink>(sink: &mut W, message: Message, shared: &Mutex<Written>, give_back: impl FnOnce(Chunk)) {
    let sync = match message {
        Message::Sync => true,
        Message::Write { chunk, sync } => {
            let written = if chunk.host_us.is_empty() { Written::default() } else { sink.write(&chunk) };
            note(shared, written);
            give_back(chunk);
            sync
        }
    };
    if sync {
        note(shared, Written { error: sink.sync(), ..Written::default() });
    }
}

fn note(shared: &Mutex<Written>, written: Written) {
    let mut total = shared.lock().unwrap_or_else(PoisonError::into_inner);
    total.records += written.records;
    total.lost += written.lost;
    if written.error.is_some() {
        total.error = written.error;
    }
}

impl<S: CsiSource, W: Sink> CsiSource for Recorder<S, W> {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        self.keep_time(now);
        // The source lends its buffer, so the recorder's own parts are borrowed one by one from here on.
        if self.current.bytes.len() + driver_iface::record::MAX_LENGTH + 2 > self.options.chunk_bytes {
            self.hand_over(now);
        }
        let next = self.source.receive(now)?;
        if let Next::Record(stamps, record) = &next {
            self.received += 1;
            if push(&mut self.current, self.options.chunk_bytes, *stamps, *record) {
                self.hand_over_at.get_or_insert(now + self.options.hand_over);
                if let (None, Some(every)) = (self.sync_at, self.options.sync_every) {
                    self.sync_at = Some(now + every);
                }
            } else {
                self.dropped += 1;
            }
        }
        Ok(next)
    }

    fn next_at(&self) -> Option<Instant> {
        [self.source.next_at(), self.hand_over_at, self.sync_at].into_iter().flatten().min()
    }
}

#[cfg(test)]
mod tests;
