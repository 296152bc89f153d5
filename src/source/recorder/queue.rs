//! The chunks between the receiving side and the thread that writes.

use super::{Chunk, Options, Sink, Totals, Written};
use crate::source::Error;
use crate::time::Instant;
use driver_iface::record::{LENGTH_FIELD, MAX_LENGTH, Record};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

enum Message {
    Write { chunk: Chunk, sync: bool },
    Sync,
}

/// What both sides count. Each number has one writer.
#[derive(Debug, Default)]
pub(super) struct Shared {
    received: AtomicU64,
    dropped: AtomicU64,
    written: Mutex<Written>,
    failing: AtomicBool,
}

impl Shared {
    pub(super) fn totals(&self) -> Totals {
        let written = self.written.lock().unwrap_or_else(PoisonError::into_inner).clone();
        Totals {
            received: self.received.load(Ordering::Relaxed),
            written: written.records,
            dropped: self.dropped.load(Ordering::Relaxed),
            lost_on_disk: written.lost,
            error: written.error,
            failing: self.failing.load(Ordering::Relaxed),
        }
    }

    /// Counts of records that were received, and dropped.
    #[cfg(test)]
    pub(super) fn of(received: u64, dropped: u64) -> Self {
        Self { received: received.into(), dropped: dropped.into(), ..Self::default() }
    }

    fn drop_records(&self, records: u64) {
        self.dropped.fetch_add(records, Ordering::Relaxed);
    }

    pub(super) fn note(&self, written: Written) {
        let mut total = self.written.lock().unwrap_or_else(PoisonError::into_inner);
        total.records += written.records;
        total.lost += written.lost;
        if written.error.is_some() || written.records > 0 {
            self.failing.store(written.error.is_some(), Ordering::Relaxed);
        }
        if written.error.is_some() {
            total.error = written.error;
        }
    }

    /// The writer died: its unwritten records are lost.
    pub(super) fn note_death(&self) {
        let totals = self.totals();
        let lost = totals.received.saturating_sub(totals.written + totals.dropped + totals.lost_on_disk);
        self.note(Written { records: 0, lost, error: Some(Error::WriterDied.to_string()) });
    }
}

/// The receiving side: the chunk being filled, and the way to the writer.
pub(super) struct Queue<W: Sink> {
    options: Options,
    current: Chunk,
    made: usize,
    /// The way to the writer and the writer, until the queue is closed.
    writer: Option<(SyncSender<Message>, JoinHandle<W>)>,
    empty: Receiver<Chunk>,
    shared: Arc<Shared>,
    hand_over_at: Option<Instant>,
    sync_at: Option<Instant>,
    /// The latest time that it was given.
    now: Instant,
}

impl<W: Sink> Queue<W> {
    /// Starts the thread that writes to `sink`.
    pub(super) fn new(sink: W, options: Options) -> Result<Self, Error> {
        // One more than chunks, for a bare request to sync: sending never waits.
        let (full, from_receiver) = sync_channel(options.chunks + 1);
        let (to_receiver, empty) = channel();
        let shared = Arc::new(Shared::default());
        let count = Arc::clone(&shared);
        let write = move || {
            let mut sink = sink;
            while let Ok(message) = from_receiver.recv() {
                work(&mut sink, message, &count, |chunk| drop(to_receiver.send(chunk)));
            }
            count.note(Written { error: sink.sync(), ..Written::default() });
            sink
        };
        let named = std::thread::Builder::new().name("csi5300 writer".into());
        let what = "cannot start the thread that writes the log".into();
        let writer = named.spawn(write).map_err(|source| Error::Io { what, source })?;
        Ok(Self {
            options,
            current: empty_chunk(&options),
            made: 1,
            writer: Some((full, writer)),
            empty,
            shared,
            hand_over_at: None,
            sync_at: None,
            now: Instant::ZERO,
        })
    }

    pub(super) fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }

    /// When [`Queue::keep_time`] has something to do. A sync waits for the chunk that is being filled.
    pub(super) fn next_at(&self) -> Option<Instant> {
        self.hand_over_at.or(self.sync_at)
    }

    /// What is due by now: a chunk that is full or waited long enough, or a sync.
    pub(super) fn keep_time(&mut self, now: Instant) {
        self.now = now;
        if self.hand_over_at.is_some_and(|at| at <= now) && !self.hand_over(now) {
            self.hand_over_at = Some(now + self.options.hand_over);
        }
        if self.hand_over_at.is_none() && self.sync_at.is_some_and(|at| at <= now) {
            // A full channel means that a chunk is being written: ask again with the next one.
            self.sync_at = if self.send(Message::Sync) { None } else { Some(now + self.options.hand_over) };
        }
        if self.current.bytes.len() + MAX_LENGTH + LENGTH_FIELD > self.options.chunk_bytes {
            self.hand_over(now);
        }
    }

    /// Copies a record into the current chunk, or counts it as dropped.
    pub(super) fn push(&mut self, now: Instant, host_us: Option<i64>, record: Record<'_>) {
        self.shared.received.fetch_add(1, Ordering::Relaxed);
        if !push(&mut self.current, self.options.chunk_bytes, host_us, record) {
            return self.shared.drop_records(1);
        }
        self.hand_over_at.get_or_insert(now + self.options.hand_over);
        if let (None, Some(every)) = (self.sync_at, self.options.sync_every) {
            self.sync_at = Some(now + every);
        }
    }

    /// Hands over the rest and waits until it is written; `None` if the writer died, or was closed before.
    pub(super) fn close(&mut self, now: Instant) -> Option<W> {
        let (full, writer) = self.writer.take()?;
        self.current.at = now;
        let chunk = std::mem::take(&mut self.current);
        // Refused only if the writer is dead, which is counted below.
        let _ = full.send(Message::Write { chunk, sync: false });
        drop(full);
        let sink = writer.join();
        if sink.is_err() {
            self.shared.note_death();
        }
        sink.ok()
    }

    fn send(&self, message: Message) -> bool {
        self.writer.as_ref().is_some_and(|(full, _)| full.try_send(message).is_ok())
    }

    /// An empty chunk, if the bound allows one.
    fn spare(&mut self) -> Option<Chunk> {
        match self.empty.try_recv() {
            Ok(mut chunk) => {
                chunk.bytes.clear();
                chunk.host_us.clear();
                Some(chunk)
            }
            Err(_) if self.made < self.options.chunks => {
                self.made += 1;
                Some(empty_chunk(&self.options))
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
        if !self.send(Message::Write { chunk, sync }) {
            self.shared.drop_records(records);
        }
        self.hand_over_at = None;
        self.sync_at = match self.sync_at {
            Some(at) if !sync => Some(at),
            _ => self.options.sync_every.map(|every| now + every),
        };
        true
    }
}

impl<W: Sink> Drop for Queue<W> {
    fn drop(&mut self) {
        self.close(self.now);
    }
}

fn empty_chunk(options: &Options) -> Chunk {
    let mut chunk = Chunk::default();
    chunk.bytes.reserve_exact(options.chunk_bytes);
    chunk
}

/// Copies a record into the chunk; false if it does not fit the chunk.
fn push(chunk: &mut Chunk, limit: usize, host_us: Option<i64>, record: Record<'_>) -> bool {
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
    chunk.host_us.push(host_us);
    true
}

fn work<W: Sink>(sink: &mut W, message: Message, shared: &Shared, give_back: impl FnOnce(Chunk)) {
    let sync = match message {
        Message::Sync => true,
        Message::Write { chunk, sync } => {
            let written = if chunk.host_us.is_empty() { Written::default() } else { sink.write(&chunk) };
            shared.note(written);
            give_back(chunk);
            sync
        }
    };
    if sync {
        shared.note(Written { error: sink.sync(), ..Written::default() });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Span;

    /// Remembers the records of each chunk.
    struct Chunks(Vec<usize>);

    impl Sink for Chunks {
        fn write(&mut self, chunk: &Chunk) -> Written {
            self.0.push(chunk.host_us.len());
            Written { records: chunk.host_us.len() as u64, ..Written::default() }
        }

        fn sync(&mut self) -> Option<String> {
            None
        }
    }

    #[test]
    fn records_fill_a_chunk_to_its_last_byte() {
        let record = Record { code: 0x42, body: &[7; 10] };
        for (limit, fit) in [(26, 2), (25, 1), (39, 3), (38, 2), (1, 1)] {
            let mut chunk = Chunk::default();
            let fitted = (0..5).take_while(|_| push(&mut chunk, limit, None, record)).count();
            assert_eq!((fitted, chunk.bytes.len(), chunk.host_us.len()), (fit, 13 * fit, fit), "{limit} bytes");
        }
        assert!(!push(&mut Chunk::default(), 1 << 20, None, Record { code: 0x42, body: &vec![0; 1 << 16] }));
    }

    #[test]
    fn a_chunk_without_room_for_the_longest_record_is_handed_over_at_once() {
        let record = Record { code: 0x42, body: &[7; 10] };
        let longest = MAX_LENGTH + LENGTH_FIELD;
        for (chunk_bytes, chunks) in [(13 + longest, vec![2]), (12 + longest, vec![1, 1])] {
            let options = Options { chunk_bytes, chunks: 9, hand_over: Span::from_ms(10), sync_every: None };
            let mut queue = Queue::new(Chunks(Vec::new()), options).unwrap();
            for us in [0, 1] {
                queue.push(Instant::from_us(us), None, record);
                queue.keep_time(Instant::from_us(us));
            }
            assert_eq!(queue.close(Instant::from_us(2)).map(|sink| sink.0), Some(chunks), "{chunk_bytes} bytes");
        }
    }

    /// A disk that says when it was given something, and takes it once the gate is open.
    struct Held(std::sync::mpsc::Sender<()>, Receiver<()>);

    impl Sink for Held {
        fn write(&mut self, chunk: &Chunk) -> Written {
            let _ = self.0.send(());
            let _ = self.1.recv();
            Written { records: chunk.host_us.len() as u64, ..Written::default() }
        }

        fn sync(&mut self) -> Option<String> {
            None
        }
    }

    #[test]
    fn a_sync_for_which_there_is_no_room_is_asked_for_again_after_a_while() {
        let (entered, is_writing) = channel();
        let (open, gate) = channel();
        let (hand_over, sync_every) = (Span::from_ms(10), Some(Span::from_ms(5)));
        let options = Options { chunk_bytes: 1 << 16, chunks: 5, hand_over, sync_every };
        let mut queue = Queue::new(Held(entered, gate), options).unwrap();
        let ms = |ms: i64| Instant::from_us(1_000 * ms);
        // One chunk is with the disk; behind it three others and three syncs are as much as there is room for.
        for (round, again) in [(0, None), (20, None), (40, None), (60, Some(ms(85)))] {
            queue.push(ms(round), None, Record { code: 0x42, body: &[7; 10] });
            queue.keep_time(ms(round + 10));
            if round == 0 {
                is_writing.recv().unwrap();
            }
            assert_eq!(queue.next_at(), Some(ms(round + 15)), "a sync went with the chunk");
            queue.keep_time(ms(round + 15));
            assert_eq!(queue.next_at(), again, "at {round}");
        }
        drop(open);
        assert!(queue.close(ms(90)).is_some());
        assert_eq!(queue.shared().totals().written, 4);
    }
}
