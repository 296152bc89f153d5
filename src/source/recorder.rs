//! Recording: any source, unchanged, with every record also written to a log.
//!
//! The receiving side only copies records into chunks; a thread of its own writes them. Chunks are recycled, so nothing
//! is allocated per record, and their number is bounded: where the disk cannot keep up, records are dropped **and
//! counted**, and the source is never held up. Chunks hold whole records, and a write that the disk cut short is taken
//! back to the last whole record.
//!
//! Dropping a recorder writes its records before it returns, as [`Recorder::finish`] does.

use super::{CsiSource, Error, Next, side_path};
use crate::internal::lock;
use crate::time::{Instant, Span};
use driver_iface::record::{LENGTH_FIELD, MAX_LENGTH, Record, whole_records, written};
use driver_iface::side_file::{Check, Entry, Layout};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex};
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
    /// Of these, records of earlier chunks: they were in the log, and another program cut it.
    pub gone: u64,
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
        self.queue.totals()
    }

    /// Writes the rest, syncs it, and returns everything.
    ///
    /// # Errors
    /// If the writer thread died.
    pub fn finish(mut self, now: Instant) -> Result<(S, W, Totals), Error> {
        let sink = self.queue.close(now).ok_or(Error::WriterDied)?;
        let totals = self.queue.totals();
        Ok((self.source, sink, totals))
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

enum Message {
    Write { chunk: Chunk, sync: bool },
    Sync,
}

/// What the writer counts, in the log and lost on the disk.
type OnDisk = Mutex<Totals>;

fn note(on_disk: &OnDisk, written: Written) {
    let mut total = lock(on_disk);
    total.written = (total.written + written.records).saturating_sub(written.gone);
    total.lost_on_disk += written.lost;
    if written.error.is_some() || written.records > 0 {
        total.failing = written.error.is_some();
    }
    total.error = written.error.or(total.error.take());
}

/// The receiving side: the chunk being filled, and the way to the writer.
struct Queue<W: Sink> {
    options: Options,
    current: Chunk,
    made: usize,
    /// The way to the writer and the writer, until the queue is closed.
    writer: Option<(SyncSender<Message>, JoinHandle<W>)>,
    empty: Receiver<Chunk>,
    /// Records that passed through, and those that found no room.
    received: u64,
    dropped: u64,
    on_disk: Arc<OnDisk>,
    hand_over_at: Option<Instant>,
    sync_at: Option<Instant>,
    /// The latest time that it was given.
    now: Instant,
}

impl<W: Sink> Queue<W> {
    /// Starts the thread that writes to `sink`.
    fn new(sink: W, options: Options) -> Result<Self, Error> {
        // One more than chunks, for a bare request to sync: sending never waits.
        let (full, from_receiver) = sync_channel(options.chunks + 1);
        let (to_receiver, empty) = channel();
        let on_disk = Arc::new(OnDisk::default());
        let count = Arc::clone(&on_disk);
        let write = move || {
            let mut sink = sink;
            while let Ok(message) = from_receiver.recv() {
                work(&mut sink, message, &count, |chunk| drop(to_receiver.send(chunk)));
            }
            note(&count, Written { error: sink.sync(), ..Written::default() });
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
            received: 0,
            dropped: 0,
            on_disk,
            hand_over_at: None,
            sync_at: None,
            now: Instant::ZERO,
        })
    }

    /// When [`Queue::keep_time`] has something to do. A sync waits for the chunk that is being filled.
    fn next_at(&self) -> Option<Instant> {
        self.hand_over_at.or(self.sync_at)
    }

    /// What is due by now: a chunk that is full or waited long enough, or a sync.
    fn keep_time(&mut self, now: Instant) {
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
    fn push(&mut self, now: Instant, host_us: Option<i64>, record: Record<'_>) {
        self.received += 1;
        if !push(&mut self.current, self.options.chunk_bytes, host_us, record) {
            self.dropped += 1;
            return;
        }
        self.hand_over_at.get_or_insert(now + self.options.hand_over);
        if let (None, Some(every)) = (self.sync_at, self.options.sync_every) {
            self.sync_at = Some(now + every);
        }
    }

    /// Hands over the rest and waits until it is written; `None` if the writer died, or was closed before.
    fn close(&mut self, now: Instant) -> Option<W> {
        let (full, writer) = self.writer.take()?;
        self.current.at = now;
        let chunk = std::mem::take(&mut self.current);
        // Refused only if the writer is dead, which is counted below.
        let _ = full.send(Message::Write { chunk, sync: false });
        drop(full);
        let sink = writer.join();
        if sink.is_err() {
            let Totals { received, written, dropped, lost_on_disk, .. } = self.totals();
            let lost = received.saturating_sub(written + dropped + lost_on_disk);
            note(&self.on_disk, Written { lost, error: Some(Error::WriterDied.to_string()), ..Written::default() });
        }
        sink.ok()
    }

    fn totals(&self) -> Totals {
        Totals { received: self.received, dropped: self.dropped, ..lock(&self.on_disk).clone() }
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
            self.dropped += records;
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
    let from = chunk.bytes.len();
    // A record longer than a whole chunk still gets one of its own.
    let has_room = from == 0 || from + record.emit_len() <= limit;
    let is_taken = has_room && super::append(record, &mut chunk.bytes);
    chunk.host_us.extend(is_taken.then_some(host_us));
    is_taken
}

fn work<W: Sink>(sink: &mut W, message: Message, on_disk: &OnDisk, give_back: impl FnOnce(Chunk)) {
    let sync = match message {
        Message::Sync => true,
        Message::Write { chunk, sync } => {
            let written = if chunk.host_us.is_empty() { Written::default() } else { sink.write(&chunk) };
            note(on_disk, written);
            give_back(chunk);
            sync
        }
    };
    if sync {
        note(on_disk, Written { error: sink.sync(), ..Written::default() });
    }
}

/// When to continue in a new file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rotation {
    /// Before the data file grows beyond this many bytes.
    pub bytes: Option<u64>,
    /// Once the file has been written to for this long.
    pub every: Option<Span>,
}

impl Rotation {
    fn is_on(self) -> bool {
        self.bytes.is_some() || self.every.is_some()
    }
}

/// One file that only ever grows by whole units.
#[derive(Debug)]
struct Grown {
    file: File,
    path: PathBuf,
    len: u64,
}

impl Grown {
    fn create(path: PathBuf, force: bool) -> Result<Self, Error> {
        let mut options = OpenOptions::new();
        options.write(true);
        if force {
            options.create(true).truncate(false);
        } else {
            options.create_new(true);
        }
        let file = options.open(&path).map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => Error::Exists { path: path.clone() },
            _ => Error::Io { what: format!("cannot write {}", path.display()), source },
        })?;
        // Another recorder's log is not overwritten; where there are no locks nothing is known of others.
        if matches!(file.try_lock(), Err(TryLockError::WouldBlock)) {
            return Err(Error::InUse { path });
        }
        Ok(Self { file, path, len: 0 })
    }

    /// Appends as many whole units of `bytes` as the disk takes; `whole` says how many of the first n bytes that is.
    fn append(&mut self, bytes: &[u8], whole: impl Fn(usize) -> usize) -> (usize, io::Result<()>) {
        if self.len == 0 {
            // An earlier log stays until there is something to take its place. A device has no length.
            let _ = self.file.set_len(0);
        }
        match write_on(&mut self.file, bytes) {
            (done, Ok(())) => {
                self.len += done as u64;
                (done, Ok(()))
            }
            (done, Err(error)) => self.take_back(whole(done), error),
        }
    }

    /// True if its name still leads to this file, an empty one.
    fn is_there_and_empty(&self) -> bool {
        let (Ok(own), Ok(named)) = (self.file.metadata(), std::fs::symlink_metadata(&self.path)) else { return false };
        named.is_file() && named.len() == 0 && is_same(&own, &named)
    }

    /// How long the file is where somebody else cut it.
    fn cut_to(&self) -> Option<u64> {
        self.file.metadata().ok().filter(|found| found.is_file() && found.len() < self.len).map(|found| found.len())
    }

    /// After a failed write: ends the file with the last whole unit.
    fn take_back(&mut self, whole: usize, error: io::Error) -> (usize, io::Result<()>) {
        self.len += whole as u64;
        let cut = self.file.set_len(self.len).and_then(|()| self.file.seek(SeekFrom::Start(self.len)));
        (whole, Err(cut.err().unwrap_or(error)))
    }
}

impl Drop for Grown {
    fn drop(&mut self) {
        // Even if a starting process holds a copy of the descriptor. Without a lock there is nothing to end.
        let _ = self.file.unlock();
    }
}

/// Writes as much of `bytes` as can be: how many.
fn write_on(out: &mut impl Write, bytes: &[u8]) -> (usize, io::Result<()>) {
    let mut done = 0;
    while done < bytes.len() {
        match out.write(bytes.get(done..).unwrap_or_default()) {
            Ok(0) => return (done, Err(io::ErrorKind::WriteZero.into())),
            Ok(more) => done += more,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return (done, Err(error)),
        }
    }
    (done, Ok(()))
}

/// The bytes of the whole entries, and of the head, in the first `done` of a side file: the head is as long as an entry,
/// or empty.
fn whole_entries(layout: Layout, done: usize) -> usize {
    done - done % layout.bytes()
}

/// A log on disk: a [`Sink`] of data file and side file. Without a record in it, it is removed when it is dropped.
#[derive(Debug)]
pub struct LogFiles {
    path: PathBuf,
    force: bool,
    rotation: Rotation,
    number: u32,
    since: Option<Instant>,
    data: Grown,
    /// None of a log of bodies.
    side: Option<Grown>,
    /// Of the side file.
    layout: Layout,
    /// Records in the data file: the side file is brought up to it.
    records: u64,
    finished: Vec<PathBuf>,
}

impl LogFiles {
    /// Creates the log and its side file; with a rotation, the first of a row (`name-0001.dat`).
    ///
    /// # Errors
    /// If a file already exists and `force` is not set, is a pipe, is another recorder's, or cannot be written.
    pub fn create(path: &Path, rotation: Rotation, force: bool) -> Result<Self, Error> {
        Self::begin(path, rotation, force, true)
    }

    /// The same for a log that holds the bodies of its records alone, one after another, without a side file: what another
    /// program's log is, where the source hands out its records unchanged.
    ///
    /// # Errors
    /// As [`LogFiles::create`].
    #[doc(hidden)] // for the crates of this workspace
    pub fn create_bodies(path: &Path, rotation: Rotation, force: bool) -> Result<Self, Error> {
        Self::begin(path, rotation, force, false)
    }

    fn begin(path: &Path, rotation: Rotation, force: bool, has_side: bool) -> Result<Self, Error> {
        let number = u32::from(rotation.is_on());
        // The row would end at a file that is there.
        if let Some(path) = Self::earlier(path, rotation).filter(|_| rotation.is_on() && !force) {
            return Err(Error::Exists { path });
        }
        let (data, side) = open_files(&numbered(path, number), force, has_side)?;
        Ok(Self {
            path: path.into(),
            force,
            rotation,
            number,
            since: None,
            data,
            side,
            layout: Layout::Narrow,
            records: 0,
            finished: Vec::new(),
        })
    }

    /// With side files of another layout than the narrow one, which csiread reads. Call it before the first record.
    #[must_use]
    pub fn with_side_layout(mut self, layout: Layout) -> Self {
        self.layout = layout;
        self
    }

    /// A file of an earlier log of this name: itself or its side file; with a rotation, any of its row.
    #[must_use]
    pub fn earlier(path: &Path, rotation: Rotation) -> Option<PathBuf> {
        let of = |number| {
            let log = numbered(path, number);
            [log.clone(), side_path(&log)].into_iter().find(|file| file.exists())
        };
        let first = of(u32::from(rotation.is_on()));
        if first.is_some() || !rotation.is_on() {
            return first;
        }
        // The first ones may have been deleted.
        let begin = format!("{}-", path.file_stem()?.to_string_lossy());
        let names = std::fs::read_dir(path.with_file_name(".")).ok()?.flatten().map(|entry| entry.file_name());
        let number = |name: std::ffi::OsString| {
            let digits = name.to_str()?.strip_prefix(&begin)?.split(|c: char| !c.is_ascii_digit()).next()?;
            digits.parse().ok().filter(|number| *number > 0)
        };
        names.filter_map(number).filter_map(of).min()
    }

    /// The data files written, in order, the current one last.
    #[must_use]
    pub fn paths(&self) -> Vec<PathBuf> {
        self.finished.iter().chain([&self.data.path]).cloned().collect()
    }

    /// The file that is next in the row, where there is one already: it is of an earlier recording.
    #[doc(hidden)] // for the crates of this workspace
    #[must_use]
    pub fn left_over(&self) -> Option<PathBuf> {
        Some(numbered(&self.path, self.number + 1)).filter(|next| self.number > 0 && next.exists())
    }

    /// The file has been written to for as long as one is.
    fn is_old(&self, now: Instant) -> bool {
        self.records > 0 && self.rotation.every.zip(self.since).is_some_and(|(every, since)| now - since >= every)
    }

    /// How much of `rest` goes into the current file: bytes and records. A record that is larger than a file has one of its own.
    fn fitting(&self, rest: &[u8]) -> (usize, usize) {
        let room = self.rotation.bytes.map_or(u64::MAX, |limit| limit.saturating_sub(self.data.len));
        let room = usize::try_from(room).unwrap_or(usize::MAX);
        let fits = if self.side.is_some() { whole_records(rest, room) } else { whole_bodies(rest, room) };
        match fits {
            (0, _) if self.records == 0 => written(rest).next().map_or((0, 0), |record| (record.len(), 1)),
            fits => fits,
        }
    }

    /// Continues in the next file; if that fails, the old one continues to grow.
    fn rotate(&mut self) -> Option<String> {
        let problem = self.sync();
        match open_files(&numbered(&self.path, self.number + 1), self.force, self.side.is_some()) {
            Ok((data, side)) => {
                self.finished.push(std::mem::replace(&mut self.data, data).path.clone());
                self.side = side;
                self.number += 1;
                (self.since, self.records) = (None, 0);
                problem
            }
            Err(error) => Some(format!("cannot continue in a new file, so the old one grows: {error}")),
        }
    }

    /// Continues in another file if another program cut this one: later bytes would follow zeros. Returns a message,
    /// and the number of lost records, which is an estimate if some remain.
    fn go_on_if_cut(&mut self) -> (Option<String>, u64) {
        let (data, side) = (self.data.cut_to(), self.side.as_ref().is_some_and(|side| side.cut_to().is_some()));
        if data.is_none() && !side {
            return (None, 0);
        }
        let (path, was, records) = (self.data.path.display().to_string(), self.data.len, self.records);
        let left = data.unwrap_or(was);
        let kept = (u128::from(records) * u128::from(left)).checked_div(u128::from(was)).unwrap_or(0) as u64;
        let what = if data.is_some() { path } else { side_path(&self.data.path).display().to_string() };
        let number = self.number;
        let refused = self.rotate();
        if self.number == number {
            for grown in std::iter::once(&mut self.data).chain(&mut self.side) {
                grown.len = grown.file.seek(SeekFrom::End(0)).unwrap_or(grown.len);
            }
            return (refused, records - kept);
        }
        let next = self.data.path.display();
        (Some(format!("{what} was cut by another program while it was recorded: it goes on in {next}")), records - kept)
    }

    /// Brings the side file up to the data file: zeros for what an earlier failure missed, then the first `records` of
    /// a part, of which `before` were in the log already.
    fn stamp(&mut self, before: u64, part: Part<'_>, records: usize) -> io::Result<()> {
        let Some(side) = &mut self.side else { return Ok(()) };
        let (length, head) = (self.layout.bytes(), self.layout.head());
        let there = side.len.saturating_sub(head.len() as u64) / length as u64;
        let behind = before.saturating_sub(there) as usize;
        let check = |record| (self.layout == Layout::Checked).then(|| Check::of(record));
        let known = part.host_us.iter().zip(written(part.bytes)).take(records);
        let known = known.map(|(host_us, record)| Entry { host_us: *host_us, check: check(record) });
        let mut bytes = if side.len == 0 { head.to_vec() } else { Vec::new() };
        for entry in std::iter::repeat_n(Entry::default(), behind).chain(known) {
            let mut out = [0; Layout::Wide.bytes()];
            // A time that a narrow entry cannot hold (before 1970, after 2106) stays zeros: not known.
            let _ = entry.emit(self.layout, &mut out);
            bytes.extend_from_slice(out.split_at(length).0);
        }
        let layout = self.layout;
        side.append(&bytes, |done| whole_entries(layout, done)).1
    }

    /// Appends to the current file, and counts in `sum`; false once the disk is full.
    fn append(&mut self, part: Part<'_>, sum: &mut Written) -> bool {
        let (records, outcome) = match &self.side {
            Some(_) => {
                let (done, outcome) = self.data.append(part.bytes, |done| whole_records(part.bytes, done).0);
                (whole_records(part.bytes, done).1, outcome)
            }
            None => {
                let bodies: Vec<u8> = bodies(part.bytes).flatten().copied().collect();
                let whole = |most| bodies_within(part.bytes, most);
                let (done, outcome) = self.data.append(&bodies, |done| whole(done).0);
                (whole(done).1, outcome)
            }
        };
        let before = self.records;
        self.records += records as u64;
        let stamped = self.stamp(before, part, records);
        let words = |path: &Path, error: io::Error| format!("writing {}: {error}", path.display());
        sum.records += records as u64;
        let takes = outcome.is_ok();
        let error = outcome.map_err(|error| words(&self.data.path, error)).err();
        let error = error.or_else(|| stamped.map_err(|error| words(&side_path(&self.data.path), error)).err());
        sum.error = error.or(sum.error.take());
        takes
    }
}

/// Whole records of a chunk, and their host times.
#[derive(Clone, Copy)]
struct Part<'a> {
    bytes: &'a [u8],
    host_us: &'a [Option<i64>],
}

impl<'a> Part<'a> {
    /// The first of it, and the rest.
    fn split(self, bytes: usize, records: usize) -> Option<(Self, Self)> {
        let (bytes, more) = self.bytes.split_at_checked(bytes)?;
        let (host_us, later) = self.host_us.split_at_checked(records)?;
        Some((Self { bytes, host_us }, Self { bytes: more, host_us: later }))
    }
}

/// True for a pipe with a name, and for `-`, by which standard output is meant.
fn is_pipe(path: &Path) -> bool {
    if path.as_os_str() == "-" {
        return true;
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        std::fs::metadata(path).is_ok_and(|found| found.file_type().is_fifo())
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        false
    }
}

impl Drop for LogFiles {
    /// Removes a log without a record, so that repeated starts without records leave none.
    fn drop(&mut self) {
        for grown in std::iter::once(&self.data).chain(&self.side) {
            if self.data.len == 0 && grown.is_there_and_empty() {
                let _ = std::fs::remove_file(&grown.path);
            }
        }
    }
}

/// True for the metadata of one file; where that cannot be told, of two.
fn is_same(a: &std::fs::Metadata, b: &std::fs::Metadata) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        (a.dev(), a.ino()) == (b.dev(), b.ino())
    }
    #[cfg(not(unix))]
    {
        let _ = (a, b);
        false
    }
}

/// True for a file that has no name any more.
fn is_deleted(file: &File) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        file.metadata().is_ok_and(|found| found.is_file() && found.nlink() == 0)
    }
    #[cfg(not(unix))]
    {
        let _ = file;
        false
    }
}

fn open_files(path: &Path, force: bool, has_side: bool) -> Result<(Grown, Option<Grown>), Error> {
    let side = has_side.then(|| side_path(path));
    // Before anything is overwritten: opening a pipe would wait for a reader.
    if let Some(path) = std::iter::once(path.to_path_buf()).chain(side.clone()).find(|path| is_pipe(path)) {
        return Err(Error::IntoPipe { path });
    }
    let data = Grown::create(path.into(), force)?;
    let side = side.map(|side| Grown::create(side, force)).transpose().inspect_err(|_| {
        // Nothing is left behind; an earlier log stays.
        if data.is_there_and_empty() {
            let _ = std::fs::remove_file(path);
        }
    })?;
    Ok((data, side))
}

/// The bodies of whole records.
fn bodies(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    written(bytes).map(|record| record.get(LENGTH_FIELD + 1..).unwrap_or_default())
}

/// The first bodies that are within so many bytes: their bytes, and how many.
fn bodies_within(bytes: &[u8], most: usize) -> (usize, usize) {
    let add = |sum: &mut usize, body: &[u8]| {
        *sum += body.len();
        Some(*sum)
    };
    let ends = bodies(bytes).scan(0, |sum, body| add(sum, body)).take_while(|end| *end <= most);
    ends.fold((0, 0), |(_, count), end| (end, count + 1))
}

/// Whole records whose bodies are within so many bytes: bytes of the records, and how many.
fn whole_bodies(bytes: &[u8], most: usize) -> (usize, usize) {
    let count = bodies_within(bytes, most).1;
    (written(bytes).take(count).map(<[u8]>::len).sum(), count)
}

/// `name-0003.dat` for number 3, the name itself for 0.
fn numbered(path: &Path, number: u32) -> PathBuf {
    if number == 0 {
        return path.into();
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map_or(String::new(), |extension| format!(".{}", extension.to_string_lossy()));
    path.with_file_name(format!("{stem}-{number:04}{extension}"))
}

impl Sink for LogFiles {
    fn write(&mut self, chunk: &Chunk) -> Written {
        let (cut, gone) = self.go_on_if_cut();
        let mut sum = Written { error: cut, gone, ..Written::default() };
        if self.is_old(chunk.at) {
            sum.error = self.rotate().or(sum.error);
        }
        let mut rest = Part { bytes: &chunk.bytes, host_us: &chunk.host_us };
        while !rest.bytes.is_empty() {
            let mut fits = self.fitting(rest.bytes);
            if fits.1 == 0 {
                let number = self.number;
                sum.error = self.rotate().or(sum.error);
                let went_on = self.number > number;
                fits = if went_on { self.fitting(rest.bytes) } else { (rest.bytes.len(), rest.host_us.len()) };
            }
            self.since.get_or_insert(chunk.at);
            let Some((part, more)) = rest.split(fits.0, fits.1).filter(|(part, _)| !part.bytes.is_empty()) else {
                break;
            };
            if !self.append(part, &mut sum) {
                break;
            }
            rest = more;
        }
        sum.lost = chunk.host_us.len() as u64 - sum.records + gone;
        sum
    }

    fn sync(&mut self) -> Option<String> {
        let side = self.side.as_ref();
        let synced = self.data.file.sync_data().and_then(|()| side.map_or(Ok(()), |side| side.file.sync_data()));
        let synced = synced.err().map(|error| format!("syncing {}: {error}", self.data.path.display()));
        let gone = || format!("{} was deleted: later records are lost with it", self.data.path.display());
        let cut = |grown: &Grown| {
            grown.cut_to().map(|len| format!("{} was cut to {len} bytes by another program", grown.path.display()))
        };
        synced
            .or_else(|| is_deleted(&self.data.file).then(gone))
            .or_else(|| cut(&self.data))
            .or_else(|| side.and_then(cut))
    }
}

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
                let error = Some(format!("the reader of the records went away: {error}"));
                Written { lost: records, error, ..Written::default() }
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
    use crate::source::Stamps;
    use crate::source::replay::Replay;
    use driver_iface::bfee;
    use driver_iface::record::{Tail, code};
    use std::collections::VecDeque;
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::sync::mpsc::Sender;

    /// A disk that remembers in a place that outlives it. It may say when a write begins, wait for permission before it, and die at a chunk.
    #[derive(Default)]
    struct Disk {
        entered: Option<Sender<()>>,
        gate: Option<Receiver<()>>,
        dies_at: Option<usize>,
        /// Records of each chunk.
        chunks: Vec<usize>,
        log: Arc<Mutex<Vec<u8>>>,
        syncs: Arc<AtomicU64>,
    }

    impl Disk {
        fn behind(gate: Receiver<()>) -> Self {
            Self { gate: Some(gate), ..Self::default() }
        }
    }

    impl Sink for Disk {
        fn write(&mut self, chunk: &Chunk) -> Written {
            let _ = self.entered.as_ref().map(|entered| entered.send(()));
            let _ = self.gate.as_ref().map(Receiver::recv);
            assert!(self.dies_at != Some(self.chunks.len()), "a disk that dies");
            self.chunks.push(chunk.host_us.len());
            self.log.lock().unwrap().extend_from_slice(&chunk.bytes);
            Written { records: chunk.host_us.len() as u64, ..Written::default() }
        }

        fn sync(&mut self) -> Option<String> {
            self.syncs.fetch_add(1, Ordering::Relaxed);
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
            let mut queue = Queue::new(Disk::default(), options).unwrap();
            for us in [0, 1] {
                queue.push(Instant::from_us(us), None, record);
                queue.keep_time(Instant::from_us(us));
            }
            assert_eq!(queue.close(Instant::from_us(2)).map(|sink| sink.chunks), Some(chunks), "{chunk_bytes} bytes");
        }
    }

    #[test]
    fn a_sync_for_which_there_is_no_room_is_asked_for_again_after_a_while() {
        let (entered, is_writing) = channel();
        let (open, gate) = channel();
        let (hand_over, sync_every) = (Span::from_ms(10), Some(Span::from_ms(5)));
        let options = Options { chunk_bytes: 1 << 16, chunks: 5, hand_over, sync_every };
        let mut queue = Queue::new(Disk { entered: Some(entered), ..Disk::behind(gate) }, options).unwrap();
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
        assert_eq!(queue.totals().written, 4);
    }

    /// A reader that goes away after some writes.
    struct Reader(usize, Vec<u8>);

    impl Write for Reader {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0 = self.0.checked_sub(1).ok_or(io::ErrorKind::BrokenPipe)?;
            self.1.extend(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
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

    /// A source of numbered records, as many as it is made with.
    struct Numbered {
        left: VecDeque<Option<u32>>,
        body: Vec<u8>,
    }

    /// Bytes of a record in the log: length, code, and a 1x1 bfee.
    const RECORD: usize = 3 + bfee::STOCK_HEADER + bfee::csi_len(1, 1);

    impl Numbered {
        fn new(records: impl IntoIterator<Item = Option<u32>>) -> Self {
            let mut body = vec![0; RECORD - 3];
            (body[bfee::offset::N_RX], body[bfee::offset::N_TX]) = (1, 1);
            body[bfee::offset::LEN] = bfee::csi_len(1, 1) as u8;
            Self { left: records.into_iter().collect(), body }
        }
    }

    impl CsiSource for Numbered {
        fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
            match self.left.pop_front() {
                None => Ok(Next::End(Tail::Clean)),
                Some(None) => Ok(Next::Pending),
                Some(Some(number)) => {
                    self.body[..4].copy_from_slice(&number.to_le_bytes());
                    let stamps = Stamps { at: now, host_us: Some(i64::from(number) + 5_000_000), ..Stamps::default() };
                    Ok(Next::Record(stamps, Record { code: code::BFEE, body: &self.body }))
                }
            }
        }

        fn next_at(&self) -> Option<Instant> {
            None
        }
    }

    fn numbers(log: &[u8]) -> Vec<u32> {
        log.chunks(RECORD).map(|record| u32::from_le_bytes(record[3..7].try_into().unwrap())).collect()
    }

    fn drain<W: Sink>(recorder: &mut Recorder<Numbered, W>, now: Instant) -> u64 {
        let mut records = 0;
        loop {
            match recorder.receive(now).unwrap() {
                Next::Record(..) => records += 1,
                Next::End(_) => return records,
                _ => {}
            }
        }
    }

    #[test]
    fn a_stopped_disk_makes_counted_loss_and_never_holds_the_source() {
        let (open, gate) = channel();
        // Chunks that hold the largest record and one small one; three of them.
        let options = Options { chunk_bytes: 8_200, chunks: 3, ..Options::default() };
        let source = Numbered::new((0..10_000).map(Some));
        let mut recorder = Recorder::new(source, Disk::behind(gate), options).unwrap();
        // Every record arrives although nothing is written.
        assert_eq!(drain(&mut recorder, Instant::ZERO), 10_000);
        let dropped = recorder.totals().dropped;
        assert!(dropped > 0, "the queue never filled");
        assert_eq!(recorder.totals().written, 0);
        drop(open);
        let (_, sink, totals) = recorder.finish(Instant::ZERO).unwrap();
        assert_eq!((totals.received, totals.dropped), (10_000, dropped));
        assert_eq!(totals.written, 10_000 - dropped);
        // Two chunks that were handed over with a record each, as the largest would not have fitted behind it, and all of a third.
        assert_eq!(totals.written, 2 + (8_200 / RECORD) as u64);
        let kept = numbers(&sink.log.lock().unwrap());
        assert_eq!(kept.len() as u64, totals.written);
        assert!(kept.is_sorted_by(|a, b| a < b));
    }

    #[test]
    fn chunks_and_syncs_keep_time() {
        let source = Numbered::new([Some(1), None, None, None, None]);
        let options =
            Options { sync_every: Some(Span::from_ms(25)), hand_over: Span::from_ms(10), ..Options::default() };
        let mut recorder = Recorder::new(source, Disk::default(), options).unwrap();
        assert_eq!(recorder.next_at(), None);
        let _ = recorder.receive(Instant::ZERO).unwrap();
        assert_eq!(recorder.next_at(), Some(Instant::from_us(10_000)));
        let _ = recorder.receive(Instant::from_us(10_000)).unwrap();
        assert_eq!(recorder.next_at(), Some(Instant::from_us(25_000)));
        let _ = recorder.receive(Instant::from_us(25_000)).unwrap();
        assert_eq!(recorder.next_at(), None, "nothing is left to write");
        let (_, sink, totals) = recorder.finish(Instant::from_us(26_000)).unwrap();
        assert_eq!((sink.syncs.load(Ordering::Relaxed), numbers(&sink.log.lock().unwrap())), (2, vec![1]));
        assert_eq!(totals.written, 1);
    }

    #[test]
    fn while_the_disk_stands_still_it_is_asked_again_after_a_while_and_not_at_once() {
        let (open, gate) = channel();
        let source = Numbered::new([Some(1), None, Some(2), None, None, None]);
        let options = Options { chunks: 2, hand_over: Span::from_ms(10), ..Options::default() };
        let mut recorder = Recorder::new(source, Disk::behind(gate), options).unwrap();
        let mut at = |ms: i64| {
            let _ = recorder.receive(Instant::from_us(1_000 * ms)).unwrap();
            recorder.next_at().map(|at| at.as_us() / 1_000)
        };
        // The first chunk is with the disk, which does not take it; there is one other.
        assert_eq!([at(0), at(10), at(11), at(21)], [Some(10), Some(1_000), Some(21), Some(31)]);
        // It is due and cannot be handed over: it is tried again, and a sync waits for it.
        assert_eq!([at(31), at(1_010)], [Some(41), Some(1_020)]);
        drop(open);
        let (_, sink, totals) = recorder.finish(Instant::from_us(2_000_000)).unwrap();
        assert_eq!((numbers(&sink.log.lock().unwrap()), totals.written, totals.dropped), (vec![1, 2], 2, 0));
    }

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("csi5300-recorder-{}-{name}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn what_is_recorded_replays_with_its_host_times() {
        let folder = folder("replay");
        let path = folder.join("out.dat");
        let files = LogFiles::create(&path, Rotation::default(), false).unwrap();
        let mut recorder = Recorder::new(Numbered::new((0..500).map(Some)), files, Options::default()).unwrap();
        drain(&mut recorder, Instant::ZERO);
        let (_, _, totals) = recorder.finish(Instant::ZERO).unwrap();
        assert_eq!((totals.written, totals.error), (500, None));
        let mut replay = Replay::open(&path).unwrap();
        for number in 0..500_u32 {
            let Next::Record(stamps, record) = replay.receive(Instant::ZERO).unwrap() else {
                panic!("record {number}")
            };
            assert_eq!(record.body[..4], number.to_le_bytes());
            assert_eq!(stamps.host_us, Some(i64::from(number) + 5_000_000));
        }
        assert!(matches!(replay.receive(Instant::ZERO).unwrap(), Next::End(Tail::Clean)));
        // Nothing is overwritten unless asked for, not even half of the pair.
        let again = LogFiles::create(&path, Rotation::default(), false).unwrap_err();
        assert!(matches!(&again, Error::Exists { path: there } if *there == path), "{again}");
        std::fs::remove_file(&path).unwrap();
        let side_only = LogFiles::create(&path, Rotation::default(), false).unwrap_err();
        assert!(side_only.to_string().contains("out.datstp"), "{side_only}");
        assert!(!path.exists());
        LogFiles::create(&path, Rotation::default(), true).unwrap();
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn an_earlier_log_outlives_a_side_file_that_cannot_be_written() {
        let folder = folder("side-refused");
        let path = folder.join("out.dat");
        std::fs::create_dir_all(side_path(&path)).unwrap();
        let refused = || LogFiles::create(&path, Rotation::default(), true).unwrap_err().to_string();
        assert!(refused().contains("out.datstp") && !path.exists());
        std::fs::write(&path, b"an earlier log").unwrap();
        assert!(refused().contains("out.datstp"));
        assert_eq!(std::fs::read(&path).unwrap(), b"an earlier log");
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn what_an_earlier_row_leaves_behind_a_new_one_is_known() {
        let folder = folder("left-over");
        let path = folder.join("out.dat");
        std::fs::write(folder.join("out-0002.dat"), b"an earlier log").unwrap();
        let row = Rotation { bytes: Some(1), every: None };
        let left = |rotation| LogFiles::create(&path, rotation, true).unwrap().left_over();
        assert_eq!(left(row), Some(folder.join("out-0002.dat")));
        std::fs::write(folder.join("out-0001.dat"), b"another one").unwrap();
        assert_eq!(left(Rotation::default()), None, "no row");
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_row_whose_first_files_were_deleted_is_an_earlier_log() {
        let folder = folder("earlier");
        let path = folder.join("out.dat");
        let (row, single) = (Rotation { bytes: Some(1), every: None }, Rotation::default());
        for other in ["out-a.dat", "out-0000.dat", "out-0003.txt", "other-0003.dat", "out-3.dat"] {
            std::fs::write(folder.join(other), b"another").unwrap();
        }
        assert_eq!(LogFiles::earlier(&path, row), None);
        for left in ["out-0012.datstp", "out-0012.dat"] {
            let left = folder.join(left);
            std::fs::write(&left, b"an earlier log").unwrap();
            assert_eq!([row, single].map(|rotation| LogFiles::earlier(&path, rotation)), [Some(left.clone()), None]);
            let refused = LogFiles::create(&path, row, false).unwrap_err();
            assert!(matches!(&refused, Error::Exists { path } if *path == left), "{refused}");
        }
        assert!(!folder.join("out-0001.dat").exists());
        drop(LogFiles::create(&path, row, true).unwrap());
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_dropped_recorder_writes_what_it_was_handed() {
        let sink = Disk::default();
        let (log, syncs) = (Arc::clone(&sink.log), Arc::clone(&sink.syncs));
        let options = Options { chunk_bytes: 10_000, chunks: 1_000, ..Options::default() };
        let mut recorder = Recorder::new(Numbered::new((0..1_000).map(Some)), sink, options).unwrap();
        let on_disk = Arc::clone(&recorder.queue.on_disk);
        drain(&mut recorder, Instant::ZERO);
        assert_eq!((recorder.totals().received, recorder.totals().dropped), (1_000, 0));
        drop(recorder);
        let totals = lock(&on_disk).clone();
        assert_eq!((totals.written, totals.lost_on_disk), (1_000, 0));
        assert_eq!(numbers(&log.lock().unwrap()), (0..1_000).collect::<Vec<_>>());
        assert_eq!(syncs.load(Ordering::Relaxed), 1);
    }

    #[test]
    fn what_a_dead_writer_took_with_it_is_counted() {
        for finish in [false, true] {
            let sink = Disk { dies_at: Some(1), ..Disk::default() };
            let log = Arc::clone(&sink.log);
            let options = Options { chunk_bytes: 10_000, chunks: 1_000, ..Options::default() };
            let mut recorder = Recorder::new(Numbered::new((0..1_000).map(Some)), sink, options).unwrap();
            let on_disk = Arc::clone(&recorder.queue.on_disk);
            drain(&mut recorder, Instant::ZERO);
            let Totals { received, dropped, .. } = recorder.totals();
            if finish {
                assert!(matches!(recorder.finish(Instant::ZERO), Err(Error::WriterDied)));
            } else {
                drop(recorder);
            }
            let totals = Totals { received, dropped, ..lock(&on_disk).clone() };
            assert!(totals.written > 0 && totals.lost_on_disk + totals.dropped > 0, "{totals:?}");
            assert_eq!(totals.received, totals.written + totals.dropped + totals.lost_on_disk);
            assert_eq!(totals.written, numbers(&log.lock().unwrap()).len() as u64);
            assert!(totals.error.is_some_and(|error| error.contains("died")));
        }
    }

    #[test]
    fn after_a_failure_only_a_record_that_is_written_ends_it() {
        let on_disk = OnDisk::default();
        let note = |records, error: Option<&str>| {
            super::note(&on_disk, Written { records, error: error.map(str::to_owned), ..Written::default() });
            let totals = lock(&on_disk).clone();
            (totals.failing, totals.error)
        };
        let full = Some("full".to_owned());
        assert_eq!(note(0, None), (false, None));
        assert_eq!(note(2, Some("full")), (true, full.clone()));
        assert_eq!(note(0, None), (true, full.clone()), "a sync without an error writes nothing");
        assert_eq!(note(1, None), (false, full), "what went wrong is remembered");
    }

    #[test]
    fn a_sync_that_went_with_a_chunk_is_not_asked_for_again() {
        let source = Numbered::new([Some(1), None, Some(2), None]);
        let options =
            Options { sync_every: Some(Span::from_ms(25)), hand_over: Span::from_ms(10), ..Options::default() };
        let mut recorder = Recorder::new(source, Disk::default(), options).unwrap();
        let mut at = |ms: i64| {
            let _ = recorder.receive(Instant::from_us(1_000 * ms)).unwrap();
            recorder.next_at().map(|at| at.as_us() / 1_000)
        };
        // The second chunk is handed over when a sync is due, and takes it along: the next one is 25 ms later.
        assert_eq!([at(0), at(10), at(20), at(30)], [Some(10), Some(25), Some(30), Some(55)]);
    }

    #[test]
    fn a_log_that_another_recorder_writes_is_left_alone_and_a_deleted_one_is_noticed() {
        let folder = folder("locked");
        let log = folder.join("out.dat");
        let mut first = LogFiles::create(&log, Rotation::default(), false).unwrap();
        assert!(matches!(LogFiles::create(&log, Rotation::default(), true), Err(Error::InUse { .. })));
        assert_eq!(first.sync(), None);
        std::fs::remove_file(&log).unwrap();
        assert!(first.sync().unwrap().contains("was deleted"));
        drop(first);
        let again = LogFiles::create(&log, Rotation::default(), true).unwrap();
        assert_eq!(again.data.file.metadata().unwrap().len(), 0);
        std::fs::remove_dir_all(folder).unwrap();
    }

    /// A pipe takes bytes and cannot be synced: both files are asked to.
    #[test]
    fn what_cannot_be_synced_is_said() {
        let folder = folder("sync");
        let (_reader, writer) = io::pipe().unwrap();
        let pipe = || File::from(std::os::fd::OwnedFd::from(writer.try_clone().unwrap()));
        for side in [false, true] {
            let mut files = LogFiles::create(&folder.join("out.dat"), Rotation::default(), true).unwrap();
            *(if side { &mut files.side.as_mut().unwrap().file } else { &mut files.data.file }) = pipe();
            assert!(files.sync().unwrap().contains("syncing"), "side file: {side}");
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn what_is_no_file_is_not_cut() {
        assert!(Grown::create("/dev/null".into(), true).is_ok(), "a device has no length");
    }

    /// Opening a pipe would wait for a reader, and no signal would end it.
    #[test]
    fn a_log_is_not_written_into_a_pipe() {
        let folder = folder("pipe");
        let log = folder.join("out.dat");
        for name in [log.clone(), side_path(&log)] {
            let made = std::process::Command::new("mkfifo").arg(&name).status();
            assert!(made.is_ok_and(|status| status.success()), "mkfifo");
            for force in [false, true] {
                let refused = LogFiles::create(&log, Rotation::default(), force);
                assert!(matches!(refused, Err(Error::IntoPipe { path }) if path == name), "{}", name.display());
            }
            std::fs::remove_file(&name).unwrap();
            assert!(!log.exists() && !side_path(&log).exists());
        }
        let refused = LogFiles::create(Path::new("-"), Rotation::default(), true);
        assert!(matches!(refused, Err(Error::IntoPipe { .. })), "no file of that name is made");
        std::fs::remove_dir_all(folder).unwrap();
    }

    /// A record as the log has it.
    fn record(number: u8) -> Vec<u8> {
        vec![0, 4, 0xBB, number, 7, 7]
    }

    fn chunk(numbers: std::ops::Range<u8>) -> Chunk {
        let host_us = numbers.clone().map(|number| Some(1_700_000_000_000_000 + i64::from(number))).collect();
        Chunk { bytes: numbers.flat_map(record).collect(), host_us, at: Instant::ZERO }
    }

    #[test]
    fn a_log_without_a_record_is_taken_back_and_nothing_else_is() {
        let folder = folder("empty");
        let log = folder.join("out.dat");
        let create = |rotation| LogFiles::create(&log, rotation, false).unwrap();
        let there = || [log.exists(), side_path(&log).exists()];
        drop(create(Rotation::default()));
        assert_eq!(there(), [false, false]);
        // Another's of the same name, made after this one was deleted.
        let files = create(Rotation::default());
        std::fs::remove_file(&log).unwrap();
        std::fs::write(&log, "").unwrap();
        drop(files);
        assert_eq!(there(), [true, false]);
        std::fs::remove_file(&log).unwrap();
        // One with a record, and the first of a row.
        let mut files = create(Rotation::default());
        assert_eq!(files.write(&chunk(0..1)).records, 1);
        drop(files);
        assert_eq!(there(), [true, true]);
        // Where nothing comes, the earlier one stays.
        let again = || LogFiles::create(&log, Rotation::default(), true).unwrap();
        let sizes = || [&log, &side_path(&log)].map(|file| file.metadata().unwrap().len());
        let before = sizes();
        drop(again());
        assert_eq!(sizes(), before);
        assert_eq!(again().write(&chunk(0..2)).records, 2);
        assert!(sizes()[0] == 2 * before[0] && sizes()[1] > before[1], "{:?} {before:?}", sizes());
        drop(create(Rotation { bytes: Some(1 << 20), every: None }));
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 2);
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn side_files_of_every_layout_keep_step_with_the_log() {
        let folder = folder("layouts");
        for layout in [Layout::Narrow, Layout::Wide, Layout::Checked] {
            let log = folder.join("out.dat");
            let mut files = LogFiles::create(&log, Rotation::default(), true).unwrap().with_side_layout(layout);
            assert_eq!(files.write(&chunk(0..3)), Written { records: 3, ..Written::default() });
            // The side file's disk refuses a chunk: its records get entries of zeros with the next one.
            let side = std::mem::replace(&mut files.side.as_mut().unwrap().file, File::open("/dev/null").unwrap());
            let refused = files.write(&chunk(3..5));
            assert!(refused.records == 2 && refused.error.is_some_and(|error| error.contains("datstp")));
            files.side.as_mut().unwrap().file = side;
            assert_eq!(files.write(&chunk(5..6)), Written { records: 1, ..Written::default() });
            drop(files);
            let bytes = std::fs::read(side_path(&log)).unwrap();
            assert_eq!(Layout::of(&bytes), layout);
            let entries = bytes[layout.head().len()..].chunks(layout.bytes()).map(|entry| Entry::parse(entry, layout));
            let expected = (0..6).map(|number| {
                let known = !(3..5).contains(&number);
                Entry {
                    host_us: known.then_some(1_700_000_000_000_000 + i64::from(number)),
                    check: (known && layout == Layout::Checked).then(|| Check::of(&record(number))),
                }
            });
            assert_eq!(entries.collect::<Vec<_>>(), expected.collect::<Vec<_>>(), "{layout:?}");
            assert_eq!(std::fs::read(&log).unwrap(), (0..6).flat_map(record).collect::<Vec<_>>());
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn either_rotation_makes_a_row_of_files() {
        let folder = folder("either");
        let first = |bytes, every| {
            let files = LogFiles::create(&folder.join("out.dat"), Rotation { bytes, every }, false).unwrap();
            files.paths().remove(0).file_name().unwrap().to_owned()
        };
        assert_eq!(first(None, None), "out.dat");
        for (bytes, every) in [(Some(1), None), (None, Some(Span::from_ms(1))), (Some(1), Some(Span::from_ms(1)))] {
            assert_eq!(first(bytes, every), "out-0001.dat", "{bytes:?} {every:?}");
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_file_is_left_for_the_next_once_it_holds_something() {
        let folder = folder("due");
        let log = folder.join("out.dat");
        let ms = |ms| Instant::ZERO + Span::from_ms(ms);
        let rotation = Rotation { bytes: Some(18), every: Some(Span::from_ms(10)) };
        let mut files = LogFiles::create(&log, rotation, false).unwrap();
        let mut made = Vec::new();
        // Four records, of which the first file takes three; the next is filled to its last byte; in the third 6 more would fit and
        // come too late.
        for (at, numbers) in [(0, 0..4), (1, 4..5), (2, 5..6), (3, 6..7), (4, 7..8), (13, 8..9), (14, 9..10)] {
            assert_eq!(files.write(&Chunk { at: ms(at), ..chunk(numbers) }).error, None);
            made.push(files.paths().len());
        }
        assert_eq!(made, [2, 2, 2, 3, 3, 4, 4]);
        let lengths = files.paths().iter().map(|path| std::fs::metadata(path).unwrap().len()).collect::<Vec<_>>();
        assert_eq!(lengths, [18, 18, 12, 12]);
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn no_file_is_larger_than_was_asked_for_however_much_comes_at_once() {
        let folder = folder("limit");
        // 6 bytes a record: as many as fit, and one where none does.
        for (limit, lengths) in
            [(13, vec![12, 12, 12, 12, 12]), (24, vec![24, 24, 12]), (5, vec![6; 10]), (99, vec![60])]
        {
            let log = folder.join(format!("{limit}.dat"));
            let rotation = Rotation { bytes: Some(limit), every: None };
            let mut files = LogFiles::create(&log, rotation, false).unwrap().with_side_layout(Layout::Checked);
            assert_eq!(files.write(&chunk(0..10)), Written { records: 10, ..Written::default() });
            let paths = files.paths();
            let logs: Vec<Vec<u8>> = paths.iter().map(|path| std::fs::read(path).unwrap()).collect();
            assert_eq!(logs.iter().map(Vec::len).collect::<Vec<_>>(), lengths, "{limit}");
            assert_eq!(logs.concat(), chunk(0..10).bytes, "{limit}");
            let mut number = 0;
            for (path, log) in paths.iter().zip(&logs) {
                let side = std::fs::read(side_path(path)).unwrap();
                let entries = side[Layout::Checked.head().len()..].chunks(Layout::Checked.bytes());
                assert_eq!(entries.len(), log.len() / 6);
                for entry in entries {
                    let expected = Check::of(&record(number));
                    assert_eq!(Entry::parse(entry, Layout::Checked).check, Some(expected), "{limit}: {number}");
                    number += 1;
                }
            }
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn where_there_is_no_next_file_the_old_one_takes_all_that_came() {
        let folder = folder("no-next");
        let rotation = Rotation { bytes: Some(12), every: None };
        let mut files = LogFiles::create(&folder.join("out.dat"), rotation, false).unwrap();
        std::fs::write(folder.join("out-0002.dat"), "another's").unwrap();
        for (numbers, bytes) in [(0..5, 30), (5..6, 36)] {
            let written = files.write(&chunk(numbers.clone()));
            assert_eq!((written.records, written.lost), (numbers.len() as u64, 0));
            assert!(written.error.unwrap().contains("so the old one grows"));
            assert_eq!(std::fs::metadata(folder.join("out-0001.dat")).unwrap().len(), bytes);
        }
        assert_eq!(std::fs::read(folder.join("out-0002.dat")).unwrap(), b"another's");
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn what_a_full_disk_left_out_of_a_chunk_is_counted_over_all_its_files() {
        let folder = folder("part");
        let rotation = Rotation { bytes: Some(12), every: None };
        let mut files = LogFiles::create(&folder.join("out.dat"), rotation, false).unwrap();
        files.data.file = File::open("/dev/null").unwrap();
        let written = files.write(&chunk(0..5));
        assert_eq!((written.records, written.lost), (0, 5));
        assert!(written.error.unwrap().contains("out-0001.dat"));
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_write_that_failed_leaves_whole_units_and_the_next_goes_behind_them() {
        let folder = folder("taken-back");
        let path = folder.join("out.dat");
        let mut grown = Grown::create(path.clone(), false).unwrap();
        assert!(matches!(grown.append(b"0123456789", |done| done), (10, Ok(()))));
        grown.file.write_all(b"abcdefg").unwrap();
        let (whole, outcome) = grown.take_back(4, io::ErrorKind::WriteZero.into());
        assert_eq!((whole, outcome.unwrap_err().kind(), grown.len), (4, io::ErrorKind::WriteZero, 14));
        assert!(grown.append(b"XY", |done| done).1.is_ok());
        assert_eq!(std::fs::read(&path).unwrap(), b"0123456789abcdXY");
        std::fs::remove_dir_all(folder).unwrap();
    }

    /// A disk that takes three bytes at a time, each time after an interruption, and `room` at most.
    struct Small {
        taken: Vec<u8>,
        room: usize,
        interrupted: bool,
    }

    impl Write for Small {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.interrupted = !self.interrupted;
            if self.interrupted {
                return Err(io::ErrorKind::Interrupted.into());
            }
            let count = bytes.len().min(3).min(self.room - self.taken.len());
            self.taken.extend_from_slice(&bytes[..count]);
            Ok(count)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_write_goes_on_where_it_was_interrupted_until_the_disk_is_full() {
        for (room, failed) in
            [(20, None), (10, None), (7, Some(io::ErrorKind::WriteZero)), (0, Some(io::ErrorKind::WriteZero))]
        {
            let mut disk = Small { taken: Vec::new(), room, interrupted: false };
            let (done, outcome) = write_on(&mut disk, b"0123456789");
            assert_eq!((done, outcome.err().map(|error| error.kind())), (room.min(10), failed), "room for {room}");
            assert_eq!(disk.taken, b"0123456789"[..done]);
        }
        let mut nothing = File::open("/dev/null").unwrap();
        assert!(matches!(write_on(&mut nothing, b"0"), (0, Err(_))), "it is not open for writing");
    }

    #[test]
    fn what_is_kept_of_a_side_file_is_whole_entries() {
        for (layout, bytes) in [(Layout::Narrow, 8), (Layout::Wide, 16), (Layout::Checked, 16)] {
            let kept = [0, bytes - 1, bytes, bytes + 1, 5 * bytes - 1].map(|done| whole_entries(layout, done));
            assert_eq!(kept, [0, 0, bytes, bytes, 4 * bytes], "{layout:?}");
        }
    }

    #[test]
    fn a_log_that_somebody_cuts_goes_on_in_another_file() {
        let folder = folder("cut");
        let log = folder.join("out.dat");
        let side = side_path(&log);
        for (cut, left, gone) in [(&log, 0, 4), (&log, 12, 2), (&side, 0, 0)] {
            let mut files = LogFiles::create(&log, Rotation::default(), true).unwrap();
            assert_eq!(files.write(&chunk(0..4)).records, 4);
            OpenOptions::new().write(true).open(cut).unwrap().set_len(left).unwrap();
            // Also where nothing is recorded after that.
            assert!(files.sync().unwrap().contains(&format!("was cut to {left} bytes")));
            let written = files.write(&chunk(4..6));
            assert_eq!((written.records, written.lost), (2, gone), "{} to {left}", cut.display());
            let on_disk = OnDisk::default();
            note(&on_disk, Written { records: 4, ..Written::default() });
            note(&on_disk, written.clone());
            let totals = lock(&on_disk);
            assert_eq!(6, totals.written + totals.lost_on_disk, "each record is counted once");
            assert!(written.error.unwrap().contains("was cut by another program"));
            assert_eq!(files.write(&chunk(6..7)), Written { records: 1, ..Written::default() });
            let next = folder.join("out-0001.dat");
            assert_eq!(files.paths(), [log.clone(), next.clone()]);
            drop(files);
            assert_eq!(std::fs::metadata(cut).unwrap().len(), left);
            assert_eq!(std::fs::read(&next).unwrap(), (4..7).flat_map(record).collect::<Vec<_>>());
            std::fs::remove_file(&next).unwrap();
            std::fs::remove_file(side_path(&next)).unwrap();
        }
        // The next name is somebody's: it goes on behind what is left.
        let mut files = LogFiles::create(&log, Rotation::default(), true).unwrap();
        files.write(&chunk(0..4));
        std::fs::write(folder.join("out-0001.dat"), "precious").unwrap();
        files.force = false;
        OpenOptions::new().write(true).open(&log).unwrap().set_len(6).unwrap();
        assert!(files.write(&chunk(4..5)).error.unwrap().contains("cannot continue in a new file"));
        drop(files);
        assert_eq!(std::fs::read(&log).unwrap(), [record(0), record(4)].concat());
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_log_of_bodies_has_no_side_file_and_is_cut_between_bodies() {
        let folder = folder("bodies");
        let bodies: Vec<Vec<u8>> = (1..=9_u8).map(|k| vec![k; 10 * usize::from(k)]).collect();
        let mut chunk = Chunk::default();
        for body in &bodies {
            assert!(push(&mut chunk, usize::MAX, Some(7), Record { code: 0xBB, body }));
        }
        let mut files = LogFiles::create_bodies(&folder.join("a.csi"), Rotation::default(), false).unwrap();
        assert_eq!(files.write(&chunk), Written { records: 9, ..Written::default() });
        drop(files);
        assert_eq!(std::fs::read(folder.join("a.csi")).unwrap(), bodies.concat());
        let hundred = Rotation { bytes: Some(100), every: None };
        let mut files = LogFiles::create_bodies(&folder.join("b.csi"), hundred, false).unwrap();
        assert_eq!(files.write(&chunk).records, 9);
        let parts: Vec<usize> = files.paths().iter().map(|path| std::fs::read(path).unwrap().len()).collect();
        assert_eq!(parts, [100, 50, 60, 70, 80, 90]);
        drop(files);
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 7, "no side files");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
