//! Logs on disk: the data file, the side file with host times, and their rotation.

use super::{Chunk, Sink, Written};
use crate::source::Error;
use crate::source::side_file::side_path;
use crate::time::{Instant, Span};
use driver_iface::record::{LENGTH_FIELD, whole_records, written};
use driver_iface::side_file::{Check, Entry, Layout};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

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
        if force && file.metadata().is_ok_and(|found| found.is_file()) {
            let io = |source| Error::Io { what: format!("cannot write {}", path.display()), source };
            file.set_len(0).map_err(io)?;
        }
        Ok(Self { file, path, len: 0 })
    }

    /// Appends as many whole units of `bytes` as the disk takes; `whole` says how many of the first n bytes that is.
    fn append(&mut self, bytes: &[u8], whole: impl Fn(usize) -> usize) -> (usize, io::Result<()>) {
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
        let (data, side) = open_files(&Self::first(path, rotation), force, has_side)?;
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

    /// The data file that [`LogFiles::create`] makes first.
    #[must_use]
    pub fn first(path: &Path, rotation: Rotation) -> PathBuf {
        numbered(path, u32::from(rotation.is_on()))
    }

    /// The data files written, in order, the current one last.
    #[must_use]
    pub fn paths(&self) -> Vec<PathBuf> {
        self.finished.iter().chain([&self.data.path]).cloned().collect()
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

/// True for a pipe with a name.
fn is_pipe(path: &Path) -> bool {
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
        // The data file is ours and empty: leave nothing behind.
        let _ = std::fs::remove_file(path);
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

impl LogFiles {
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
}

impl Sink for LogFiles {
    fn write(&mut self, chunk: &Chunk) -> Written {
        let (cut, gone) = self.go_on_if_cut();
        let mut sum = Written { error: cut, ..Written::default() };
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

#[cfg(test)]
mod tests;
