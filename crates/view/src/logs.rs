//! Logs, each read once when it is first looked at.

use crate::Error;
use csi5300_lab::course::LogIndex;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Logs that stay read; the one that was looked at longest ago is forgotten first.
const KEPT: usize = 6;

/// One log.
pub(crate) struct Named {
    /// Its name on the page.
    pub name: String,
    /// The file.
    pub path: PathBuf,
    index: Mutex<Option<Arc<LogIndex>>>,
}

/// The logs that can be looked at.
pub(crate) struct Logs {
    all: Vec<Named>,
    recent: Mutex<VecDeque<usize>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Logs {
    pub fn new(logs: Vec<(String, PathBuf)>) -> Self {
        let named = |(name, path)| Named { name, path, index: Mutex::default() };
        Self { all: logs.into_iter().map(named).collect(), recent: Mutex::default() }
    }

    /// All logs below a folder (names in `.dat`), in the order of their names; links are not followed.
    pub fn below(folder: &Path) -> Self {
        let (mut found, mut folders) = (Vec::new(), vec![folder.to_path_buf()]);
        while let Some(next) = folders.pop() {
            for entry in std::fs::read_dir(&next).into_iter().flatten().flatten() {
                match entry.file_type() {
                    Ok(kind) if kind.is_dir() => folders.push(entry.path()),
                    _ if entry.path().extension().is_some_and(|extension| extension == "dat") => {
                        found.push(entry.path());
                    }
                    _ => {}
                }
            }
        }
        found.sort();
        let name = |path: &PathBuf| path.strip_prefix(folder).unwrap_or(path).to_string_lossy().into_owned();
        Self::new(found.into_iter().map(|path| (name(&path), path)).collect())
    }

    pub fn len(&self) -> usize {
        self.all.len()
    }

    pub fn iter(&self) -> impl Iterator<Item = &Named> {
        self.all.iter()
    }

    /// The number of the log at `path`.
    pub fn number(&self, path: &Path) -> Option<usize> {
        self.all.iter().position(|log| log.path == path)
    }

    /// A log and its index, read where it is not yet; whoever asks meanwhile waits for the same.
    pub fn read(&self, number: usize) -> Result<Option<(&Named, Arc<LogIndex>)>, Error> {
        let Some(log) = self.all.get(number) else { return Ok(None) };
        let index = {
            let mut place = lock(&log.index);
            match &*place {
                Some(index) => Arc::clone(index),
                None => Arc::clone(place.insert(Arc::new(LogIndex::read(&log.path)?))),
            }
        };
        let forgotten = {
            let mut recent = lock(&self.recent);
            recent.retain(|other| *other != number);
            recent.push_back(number);
            if recent.len() > KEPT { recent.pop_front() } else { None }
        };
        if let Some(other) = forgotten.and_then(|other| self.all.get(other)) {
            lock(&other.index).take();
        }
        Ok(Some((log, index)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logs_are_read_once_and_the_oldest_is_forgotten() {
        let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures");
        let found = Logs::below(&fixtures);
        assert_eq!(found.len(), 2);
        let log = found.iter().next().map(|log| log.path.clone()).unwrap();
        let many = Logs::new((0..KEPT + 2).map(|k| (k.to_string(), log.clone())).collect());
        let (_, first) = many.read(0).unwrap().unwrap();
        assert!(Arc::ptr_eq(&first, &many.read(0).unwrap().unwrap().1));
        (1..KEPT + 1).for_each(|k| drop(many.read(k).unwrap()));
        assert!(!Arc::ptr_eq(&first, &many.read(0).unwrap().unwrap().1), "it was forgotten");
        assert!(many.read(KEPT + 2).unwrap().is_none());
    }
}
