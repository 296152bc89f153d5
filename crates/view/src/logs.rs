//! Logs, each read once when it is first looked at, and the CSI of a stretch as the page takes it: a byte a cell.

use crate::Error;
use csi5300::internal::lock;
use csi5300_lab::cards::is_named_as_log;
use csi5300_lab::course::{LogIndex, StretchCsi, letter};
use driver_iface::Mac;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::f64::consts::PI;
use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::SystemTime;

/// Logs that stay read; the one that was looked at longest ago is forgotten first.
const KEPT: usize = 6;

/// One log.
pub(crate) struct Named {
    /// Its name on the page.
    pub name: String,
    /// The file.
    pub path: PathBuf,
    index: Mutex<Read>,
}

/// What was read of a log. The stamp stays when the index is forgotten.
#[derive(Default)]
struct Read {
    index: Option<Arc<LogIndex>>,
    stamp: Option<Stamp>,
}

/// A file as it was when it was read.
#[derive(Clone, Copy)]
struct Stamp {
    device: u64,
    inode: u64,
    bytes: u64,
    /// When it was last written to; not known of a file that grew while it was read.
    modified: Option<SystemTime>,
}

impl Stamp {
    /// Of a file of which `bytes` were read between these two looks.
    fn new(before: &Metadata, after: &Metadata, bytes: u64) -> Self {
        let stood = before.len() == after.len() && before.modified().ok() == after.modified().ok();
        let modified = before.modified().ok().filter(|_| stood);
        Self { device: before.dev(), inode: before.ino(), bytes: bytes.max(before.len()), modified }
    }

    /// What is there now may begin as what was read: the same file, as it was or longer. A log grows while it is recorded.
    fn holds(&self, now: &Metadata) -> bool {
        let is_same = (self.device, self.inode) == (now.dev(), now.ino());
        let stood = self.modified.is_none() || self.modified == now.modified().ok();
        is_same && (now.len() > self.bytes || (now.len() == self.bytes && stood))
    }
}

impl Named {
    /// The file now.
    fn metadata(&self) -> Result<Metadata, Error> {
        self.path.metadata().map_err(|source| Error::missing(&self.path, &source))
    }

    /// The index of the current file.
    fn read(&self, place: &mut Read) -> Result<Arc<LogIndex>, Error> {
        let before = self.metadata()?;
        if !before.is_file() {
            return Err(Error::NoFile { path: self.path.clone() });
        }
        let index = Arc::new(LogIndex::read(&self.path)?);
        place.stamp = Some(Stamp::new(&before, &self.metadata()?, index.bytes));
        Ok(Arc::clone(place.index.insert(index)))
    }
}

/// The logs that can be looked at.
pub(crate) struct Logs {
    all: Vec<Named>,
    /// What has a log's name and is none.
    left_out: Vec<PathBuf>,
    recent: Mutex<VecDeque<usize>>,
}

impl Logs {
    pub fn new(logs: Vec<(String, PathBuf)>) -> Self {
        let named = |(name, path)| Named { name, path, index: Mutex::default() };
        Self { all: logs.into_iter().map(named).collect(), left_out: Vec::new(), recent: Mutex::default() }
    }

    /// All logs below a folder (names in `.dat`, and other cards' logs), in the order of their names, without following
    /// links to folders. Pipes and devices are skipped: opening one could block.
    pub fn below(folder: &Path) -> Self {
        let (mut found, mut left_out, mut folders) = (Vec::new(), Vec::new(), vec![folder.to_path_buf()]);
        while let Some(next) = folders.pop() {
            for entry in std::fs::read_dir(&next).into_iter().flatten().flatten() {
                match entry.file_type() {
                    Ok(kind) if kind.is_dir() => folders.push(entry.path()),
                    _ if is_named_as_log(&entry.path()) => {
                        let is_other = entry.path().metadata().is_ok_and(|there| !there.is_file());
                        (if is_other { &mut left_out } else { &mut found }).push(entry.path());
                    }
                    _ => {}
                }
            }
        }
        found.sort();
        left_out.sort();
        let name = |path: &PathBuf| path.strip_prefix(folder).unwrap_or(path).to_string_lossy().into_owned();
        let logs = Self::new(found.into_iter().map(|path| (name(&path), path)).collect());
        Self { left_out, ..logs }
    }

    /// What has a log's name and is none.
    pub fn left_out(&self) -> &[PathBuf] {
        &self.left_out
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

    /// A log and its index, read if needed, changed or grown; concurrent callers wait for the same reading.
    pub fn read(&self, number: usize) -> Result<Option<(&Named, Arc<LogIndex>)>, Error> {
        self.read_if(number, |stamp, now| !stamp.holds(now) || now.len() > stamp.bytes)
    }

    /// The same, read again only where that is `needed`.
    fn read_if(
        &self,
        number: usize,
        needed: impl Fn(&Stamp, &Metadata) -> bool,
    ) -> Result<Option<(&Named, Arc<LogIndex>)>, Error> {
        let Some(log) = self.all.get(number) else { return Ok(None) };
        let index = {
            let mut place = lock(&log.index);
            let holds = place.stamp.is_some_and(|stamp| log.metadata().is_ok_and(|now| !needed(&stamp, &now)));
            match &place.index {
                Some(index) if holds => Arc::clone(index),
                _ => log.read(&mut place)?,
            }
        };
        self.keep(number);
        Ok(Some((log, index)))
    }

    /// The same for a log that must be unchanged since it was read, because the page shows parts of it; it may have grown.
    pub fn read_again(&self, number: usize) -> Result<Option<(&Named, Arc<LogIndex>)>, Error> {
        self.must_hold(number)?;
        self.read_if(number, |stamp, now| !stamp.holds(now))
    }

    /// Refuses a log that is another one than was read last.
    pub fn must_hold(&self, number: usize) -> Result<(), Error> {
        let Some(log) = self.all.get(number) else { return Ok(()) };
        match lock(&log.index).stamp {
            Some(stamp) if !log.metadata().is_ok_and(|now| stamp.holds(&now)) => {
                Err(Error::Changed { path: log.path.clone() })
            }
            _ => Ok(()),
        }
    }

    /// Notes that an index was used, and forgets the one that was not for the longest.
    fn keep(&self, number: usize) {
        let forgotten = {
            let mut recent = lock(&self.recent);
            recent.retain(|other| *other != number);
            recent.push_back(number);
            if recent.len() > KEPT { recent.pop_front() } else { None }
        };
        if let Some(other) = forgotten.and_then(|other| self.all.get(other)) {
            lock(&other.index).index.take();
        }
    }
}

/// The byte of a cell into which nothing fell; values take 0 to 254.
const NOTHING: u8 = 255;

/// All heat maps of a stretch: of one antenna, or of all, and of the only sender whose records they hold, if the log has others.
pub(crate) fn maps(csi: &StretchCsi, antenna: Option<char>, sender: Option<Mac>) -> serde_json::Result<Value> {
    let wanted = csi.antennas.iter().filter(|own| antenna.is_none_or(|wanted| letter(own.antenna) == wanted));
    let maps = wanted.map(|own| {
        let known = || own.amplitude_db.iter().copied().filter(|db| db.is_finite());
        let (low, high) = (known().fold(f64::INFINITY, f64::min), known().fold(f64::NEG_INFINITY, f64::max));
        let (amplitude, phase) = (map(&own.amplitude_db, low, high), map(&own.phase_rad, -PI, PI));
        json!({ "antenna": letter(own.antenna), "amplitude_db": amplitude, "phase_rad": phase })
    });
    let (rows, each, last) = (&csi.rows, csi.rows.each, csi.rows.subcarriers.saturating_sub(1));
    let middles = (0..rows.len()).map(|row| rows.index((row * each + each / 2).min(last)));
    let mut all = serde_json::to_value(csi)?;
    // A row is a subcarrier, or some that are neighbours.
    all["rows"] = rows.len().into();
    all["subcarriers"] = middles.collect();
    all["subcarriers_a_row"] = each.into();
    // Kind and width, of cards other than the 5300.
    all["frames"] = rows.frames.as_deref().into();
    all["sender"] = sender.map(|mac| mac.to_string()).into();
    all["antennas"] = maps.collect();
    Ok(all)
}

/// A heat map: the values of bytes 0 and 254, and base64 of the bytes, `[row][column]`.
fn map(values: &[f64], low: f64, high: f64) -> Value {
    let step = (high - low).max(1e-9) / 254.0;
    let byte = |value: &f64| match value.is_finite() {
        true => ((value - low) / step).round().clamp(0.0, 254.0) as u8,
        false => NOTHING,
    };
    let cells = base64(&values.iter().map(byte).collect::<Vec<u8>>());
    json!({ "low": low, "high": low + 254.0 * step, "cells": cells })
}

/// Base64 with padding (RFC 4648, 4).
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let bits = three.iter().fold(0_u32, |bits, byte| bits << 8 | u32::from(*byte)) << (8 * (3 - three.len()));
        for k in 0..4 {
            let letter = LETTERS.get((bits >> (18 - 6 * k) & 63) as usize).copied().unwrap_or(b'=');
            text.push(if k <= three.len() { char::from(letter) } else { '=' });
        }
    }
    text
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

    /// A folder of its own with a log in it.
    fn folder(name: &str) -> (PathBuf, PathBuf, Vec<u8>) {
        let folder = std::env::temp_dir().join(format!("csi5300-logs-{}-{name}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures");
        let bytes = std::fs::read(&Logs::below(&fixtures).iter().next().unwrap().path).unwrap();
        let log = folder.join("a.dat");
        std::fs::write(&log, &bytes).unwrap();
        (folder, log, bytes)
    }

    #[test]
    fn a_log_that_became_another_one_is_read_anew_and_no_part_of_it_is_shown_as_the_old_ones() {
        let (folder, log, bytes) = folder("changed");
        let logs = Logs::below(&folder);
        let is_changed = || matches!(logs.read_again(0), Err(Error::Changed { .. }));
        let (_, first) = logs.read(0).unwrap().unwrap();
        assert!(!is_changed());
        // Another robot's, of the same size, under the same name.
        std::fs::write(folder.join("other"), &bytes).unwrap();
        std::fs::rename(folder.join("other"), &log).unwrap();
        assert!(is_changed());
        let (_, second) = logs.read(0).unwrap().unwrap();
        assert!(!Arc::ptr_eq(&first, &second) && !is_changed());
        // Cut short, and written to in its place.
        let open = std::fs::File::options().write(true).open(&log).unwrap();
        open.set_len(bytes.len() as u64 / 2).unwrap();
        assert!(is_changed());
        assert!(logs.read(0).unwrap().unwrap().1.bytes < first.bytes && !is_changed());
        open.set_modified(SystemTime::UNIX_EPOCH).unwrap();
        assert!(is_changed());
        let (_, third) = logs.read(0).unwrap().unwrap();
        // One that is recorded grows: what was read of it is still there, and a page that is loaded again has all of it.
        open.set_len(bytes.len() as u64).unwrap();
        assert!(!is_changed() && Arc::ptr_eq(&third, &logs.read_again(0).unwrap().unwrap().1));
        assert_eq!(logs.read(0).unwrap().unwrap().1.bytes, bytes.len() as u64);
        std::fs::remove_file(&log).unwrap();
        assert!(is_changed());
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_log_whose_index_was_forgotten_is_still_known_to_be_another_one() {
        let (folder, log, bytes) = folder("forgotten");
        let mut named = vec![("0".to_owned(), log.clone())];
        let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures");
        let other = Logs::below(&fixtures).iter().next().unwrap().path.clone();
        named.extend((1..=KEPT).map(|k| (k.to_string(), other.clone())));
        let logs = Logs::new(named);
        (0..=KEPT).for_each(|k| drop(logs.read(k).unwrap()));
        std::fs::write(folder.join("other"), &bytes).unwrap();
        std::fs::rename(folder.join("other"), &log).unwrap();
        assert!(matches!(logs.read_again(0), Err(Error::Changed { .. })));
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_pipe_with_a_logs_name_is_left_out_and_not_waited_for() {
        let (folder, log, _) = folder("pipe");
        let pipe = folder.join("p.dat");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.is_ok_and(|status| status.success()), "mkfifo");
        std::os::unix::fs::symlink("p.dat", folder.join("q.dat")).unwrap();
        let logs = Logs::below(&folder);
        assert_eq!(logs.iter().map(|log| log.path.clone()).collect::<Vec<_>>(), [log]);
        assert_eq!(logs.left_out(), [pipe.clone(), folder.join("q.dat")]);
        assert!(matches!(Logs::new(vec![("p".into(), pipe)]).read(0), Err(Error::NoFile { .. })));
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn base64_is_that_of_rfc_4648() {
        let known =
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg=="), ("fooba", "Zm9vYmE=")];
        for (bytes, text) in known {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xfe]), "+//+");
    }

    #[test]
    fn values_come_back_within_a_step_and_nothing_stays_nothing() {
        let made = map(&[-10.0, 2.5, f64::NAN, 20.0], -10.0, 20.0);
        // 0, 106, none, 254
        assert_eq!(made["cells"], base64(&[0, 106, NOTHING, 254]));
        let [low, high] = ["low", "high"].map(|name| made[name].as_f64().unwrap());
        let back = low + 106.0 / 254.0 * (high - low);
        assert!((back - 2.5).abs() <= (high - low) / 508.0, "{back}");
        // A map of one value is one.
        assert_eq!(map(&[3.0, 3.0], 3.0, 3.0)["cells"], base64(&[0, 0]));
    }
}
