//! Logs on disk: the data file, the side file with host times, and their rotation.

use super::{Chunk, Sink, Written};
use crate::source::Error;
use crate::source::side_file::side_path;
use crate::time::{Instant, Span};
use driver_iface::record::whole_records;
use driver_iface::side_file::{Width, emit};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// When to go on in a new file.
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
        let mut done = 0;
        while done < bytes.len() {
            match self.file.write(bytes.get(done..).unwrap_or_default()) {
                Ok(0) => return self.take_back(whole(done), io::ErrorKind::WriteZero.into()),
                Ok(more) => done += more,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return self.take_back(whole(done), error),
            }
        }
        self.len += done as u64;
        (done, Ok(()))
    }

    /// After a failed write: ends the file with the last whole unit.
    fn take_back(&mut self, whole: usize, error: io::Error) -> (usize, io::Result<()>) {
        self.len += whole as u64;
        let cut = self.file.set_len(self.len).and_then(|()| self.file.seek(SeekFrom::Start(self.len)));
        (whole, Err(cut.err().unwrap_or(error)))
    }
}

/// A log on disk: a [`Sink`] of data file and side file.
#[derive(Debug)]
pub struct LogFiles {
    path: PathBuf,
    force: bool,
    rotation: Rotation,
    number: u32,
    since: Option<Instant>,
    data: Grown,
    side: Grown,
    /// Of the side file's entries.
    width: Width,
    /// Records in the data file: the side file is brought up to it.
    records: u64,
    finished: Vec<PathBuf>,
}

impl LogFiles {
    /// Creates the log and its side file; with a rotation, the first of a row (`name-0001.dat`).
    ///
    /// # Errors
    /// If a file is there already and `force` is not set, or cannot be written.
    pub fn create(path: &Path, rotation: Rotation, force: bool) -> Result<Self, Error> {
        let number = u32::from(rotation.is_on());
        let (data, side) = open_pair(&Self::first(path, rotation), force)?;
        Ok(Self {
            path: path.into(),
            force,
            rotation,
            number,
            since: None,
            data,
            side,
            width: Width::Narrow,
            records: 0,
            finished: Vec::new(),
        })
    }

    /// With side files of another width: narrow, as csiread and its logger on a 32-bit host have them, is what is written
    /// otherwise. Call it before the first record.
    #[must_use]
    pub fn with_side_width(mut self, width: Width) -> Self {
        self.width = width;
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

    fn is_due(&self, chunk: &Chunk) -> bool {
        let larger = self.rotation.bytes.is_some_and(|limit| self.data.len + chunk.bytes.len() as u64 > limit);
        let older = self.rotation.every.zip(self.since).is_some_and(|(every, since)| chunk.at - since >= every);
        self.records > 0 && (larger || older)
    }

    /// Goes on in the next file; where that cannot be had, the old one goes on growing.
    fn rotate(&mut self) -> Option<String> {
        let problem = self.sync();
        match open_pair(&numbered(&self.path, self.number + 1), self.force) {
            Ok((data, side)) => {
                self.finished.push(std::mem::replace(&mut self.data, data).path);
                self.side = side;
                self.number += 1;
                (self.since, self.records) = (None, 0);
                problem
            }
            Err(error) => Some(format!("cannot go on in a new file, so the old one grows: {error}")),
        }
    }

    /// Brings the side file up to the data file: zeros for what an earlier failure left out, then `times`.
    fn stamp(&mut self, before: u64, times: &[Option<i64>]) -> io::Result<()> {
        let length = self.width.bytes();
        let behind = before.saturating_sub(self.side.len / length as u64) as usize;
        let entries: Vec<Option<i64>> = std::iter::repeat_n(None, behind).chain(times.iter().copied()).collect();
        let mut bytes = vec![0; entries.len() * length];
        for (time, entry) in entries.into_iter().zip(bytes.chunks_exact_mut(length)) {
            // A time that a narrow entry cannot hold (before 1970, after 2106) stays zeros: not known.
            let _ = emit(time, self.width, entry);
        }
        self.side.append(&bytes, |done| done - done % length).1
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

fn open_pair(path: &Path, force: bool) -> Result<(Grown, Grown), Error> {
    let data = Grown::create(path.into(), force)?;
    let side = Grown::create(side_path(path), force).inspect_err(|_| {
        // The data file is ours and empty: leave nothing behind.
        let _ = std::fs::remove_file(path);
    })?;
    Ok((data, side))
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
        let rotated = if self.is_due(chunk) { self.rotate() } else { None };
        self.since.get_or_insert(chunk.at);
        let (done, outcome) = self.data.append(&chunk.bytes, |done| whole_records(&chunk.bytes, done).0);
        let records = whole_records(&chunk.bytes, done).1;
        let lost = chunk.host_us.len() - records;
        let before = self.records;
        self.records += records as u64;
        let stamped = self.stamp(before, chunk.host_us.get(..records).unwrap_or_default());
        let words = |path: &Path, error: io::Error| format!("writing {}: {error}", path.display());
        let error = outcome.map_err(|error| words(&self.data.path, error)).err();
        let error = error.or_else(|| stamped.map_err(|error| words(&self.side.path, error)).err()).or(rotated);
        Written { records: records as u64, lost: lost as u64, error }
    }

    fn sync(&mut self) -> Option<String> {
        let synced = self.data.file.sync_data().and_then(|()| self.side.file.sync_data());
        let synced = synced.err().map(|error| format!("syncing {}: {error}", self.data.path.display()));
        let gone =
            || format!("{} was deleted: what is recorded from here on is lost with it", self.data.path.display());
        synced.or_else(|| is_deleted(&self.data.file).then(gone))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_that_another_recorder_writes_is_left_alone_and_a_deleted_one_is_noticed() {
        let folder = std::env::temp_dir().join(format!("csi5300-locked-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
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
        let folder = std::env::temp_dir().join(format!("csi5300-sync-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (_reader, writer) = io::pipe().unwrap();
        let pipe = || File::from(std::os::fd::OwnedFd::from(writer.try_clone().unwrap()));
        for side in [false, true] {
            let mut files = LogFiles::create(&folder.join("out.dat"), Rotation::default(), true).unwrap();
            *(if side { &mut files.side.file } else { &mut files.data.file }) = pipe();
            assert!(files.sync().unwrap().contains("syncing"), "side file: {side}");
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn names_in_a_row() {
        assert_eq!(numbered(Path::new("a/out.dat"), 0), Path::new("a/out.dat"));
        assert_eq!(numbered(Path::new("a/out.dat"), 12), Path::new("a/out-0012.dat"));
        assert_eq!(numbered(Path::new("out"), 1), Path::new("out-0001"));
    }
}
