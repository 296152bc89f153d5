//! The side file of a log on disk: the host's receive times of its records, and their checksums where it has them. Its
//! bytes: [`driver_iface::side_file`].

use super::{CsiSource, Next, replay::Replay};
use crate::time::Instant;
use driver_iface::side_file::{Check, Entry, Layout};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufReader, Chain, Cursor, Read, Repeat, Take};
use std::path::{Path, PathBuf};

/// Entries searched for the checksum of a record: this many records may be missing from a log at one place.
const WINDOW: usize = 1 << 16;
/// After this many unknown records in a row, the whole window is searched for one of this many records only, and for
/// the others this many entries about their expected one.
const STRANGERS: usize = 64;
/// Entries searched when the number of unknown records has doubled: this many records may be missing after a damaged
/// stretch.
const FURTHEST: usize = 1 << 20;
/// A side file that knows none of the first records, up to this number, is of another log.
const FIRST: usize = 1_024;
/// Bytes at the beginning in which nothing is known, beyond which the layout is not looked for.
const UNKNOWN: u64 = 64 << 20;

/// The path of a log's side file: the log's with `stp` behind it, so `a.datstp` of `a.dat`.
#[must_use]
pub fn side_path(log: &Path) -> PathBuf {
    let mut name = log.as_os_str().to_owned();
    name.push("stp");
    name.into()
}

/// What a side file with checksums ([`Layout::Checked`]) says of the records of its log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct Checks {
    /// Records that are as they were written.
    pub good: u64,
    /// Records of which the side file does not know the checksum: its disk was full, or the recorder was killed before it
    /// wrote the last ones.
    pub unknown: u64,
    /// Records that are not as they were written, or never were: skipped.
    pub wrong: u64,
    /// Records that were written and are not in the log, or not as they were.
    pub missing: u64,
    /// The side file knows none of the log's first records: it is of another log, or all were changed. It says nothing.
    pub out_of_step: bool,
}

/// What a side file says of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Said {
    /// When the host received it, microseconds since the Unix epoch; `None` if that is not known.
    pub(super) host_us: Option<i64>,
    /// False where its checksum is another one.
    pub(super) is_right: bool,
}

impl Said {
    /// Of a record about which nothing is known.
    pub(super) const NOTHING: Self = Self { host_us: None, is_right: true };
}

/// Entries of zeros, the bytes by which the layout was seen, then the rest.
type Begun<R> = Chain<Chain<Take<Repeat>, Cursor<Vec<u8>>>, R>;

/// Reads a side file along with its log.
#[derive(Debug)]
pub(super) struct SideFile<R = BufReader<File>> {
    reader: Begun<R>,
    layout: Layout,
    /// Entries read and not used.
    ahead: VecDeque<Entry>,
    /// Records in a row that were wrong.
    strangers: usize,
    checks: Checks,
}

impl SideFile {
    /// The side file of a log, if it has one: beside its name, else beside the file that a link of that name leads to.
    pub(super) fn of(log: &Path) -> Option<Self> {
        // A pipe of that name would be waited for, and one that is the log is read once.
        let is_file = |path: &Path| std::fs::metadata(path).is_ok_and(|found| found.is_file());
        let there = std::fs::canonicalize(log).ok().filter(|log| is_file(log))?;
        let path = [side_path(log), side_path(&there)].into_iter().find(|path| is_file(path))?;
        let mut side = Self::new(BufReader::new(File::open(path).ok()?))?;
        if side.layout == Layout::Checked {
            side.checks.out_of_step = !side.is_of(Replay::new(File::open(log).ok()?, String::new()));
        }
        Some(side)
    }
}

impl<R: Read> SideFile<R> {
    fn new(mut rest: R) -> Option<Self> {
        let (mut unknown, mut head) = (0, Vec::new());
        loop {
            rest.by_ref().take(Layout::Wide.bytes() as u64).read_to_end(&mut head).ok()?;
            if head.iter().any(|byte| *byte != 0) || head.len() < Layout::Wide.bytes() || unknown >= UNKNOWN {
                break;
            }
            unknown += head.len() as u64;
            head.clear();
        }
        // What is not at the very beginning is not the head of one with checksums.
        let layout = match Layout::of(&head) {
            Layout::Checked if unknown > 0 => Layout::Narrow,
            layout => layout,
        };
        let mut start = Cursor::new(head);
        start.set_position(layout.head().len() as u64);
        let reader = std::io::repeat(0).take(unknown).chain(start).chain(rest);
        Some(Self { reader, layout, ahead: VecDeque::new(), strangers: 0, checks: Checks::default() })
    }

    /// True if it knows one of the first records of a log, or there is none.
    fn is_of<S: Read>(&mut self, mut log: Replay<S>) -> bool {
        let (mut bytes, mut records) = (Vec::new(), 0);
        while records < FIRST {
            match log.receive(Instant::ZERO) {
                Ok(Next::Record(_, record)) => {
                    records += 1;
                    bytes.resize(record.emit_len(), 0);
                    if record.emit(&mut bytes).is_ok() && self.find(Check::of(&bytes)).is_some() {
                        return true;
                    }
                }
                Ok(Next::Lost(_)) => {}
                Ok(Next::Pending | Next::End(_)) | Err(_) => return records == 0,
            }
        }
        false
    }

    pub(super) fn layout(&self) -> Layout {
        self.layout
    }

    /// The results of its checks so far; `None` without checksums.
    pub(super) fn checks(&self) -> Option<Checks> {
        (self.layout == Layout::Checked).then_some(self.checks)
    }

    /// Bytes of the log were skipped, with an unknown number of records. Entries with checksums are found again, others
    /// are out of step from here on.
    pub(super) fn skip(&mut self) {
        self.checks.out_of_step |= self.layout != Layout::Checked;
    }

    /// At the end of the log: the remaining entries' records are missing.
    pub(super) fn end(&mut self) {
        while self.checks().is_some_and(|checks| !checks.out_of_step) {
            let Some(entry) = self.ahead.pop_front().or_else(|| self.read()) else { return };
            self.checks.missing += u64::from(entry.check.is_some());
        }
    }

    /// Checks the next record, as the log has it.
    pub(super) fn take(&mut self, record: &[u8]) -> Said {
        if self.checks.out_of_step {
            return Said::NOTHING;
        }
        match self.layout {
            Layout::Narrow | Layout::Wide => Said { host_us: self.read().unwrap_or_default().host_us, is_right: true },
            Layout::Checked => match self.find(Check::of(record)) {
                Some(at) => self.take_good(at),
                None => self.take_other(),
            },
        }
    }

    /// The record of the entry at `at`; those before it are not in the log.
    fn take_good(&mut self, at: usize) -> Said {
        self.checks.missing += self.ahead.drain(..at).filter(|entry| entry.check.is_some()).count() as u64;
        (self.checks.good, self.strangers) = (self.checks.good + 1, 0);
        Said { host_us: self.ahead.pop_front().unwrap_or_default().host_us, is_right: true }
    }

    /// A record whose checksum is in no entry that was looked at.
    fn take_other(&mut self) -> Said {
        // As many records as there are entries with checksums were others already: these are damaged or gone, and what
        // follows is what nothing is known of. Of the entries before this one that was seen to be not so.
        if self.ahead.get(self.strangers).is_none_or(|entry| entry.check.is_none()) {
            let known = self.ahead.drain(..self.strangers.min(self.ahead.len())).count();
            self.checks.missing += known as u64;
            (self.checks.unknown, self.strangers) = (self.checks.unknown + 1, 0);
            return Said { host_us: self.ahead.pop_front().unwrap_or_default().host_us, is_right: true };
        }
        self.checks.wrong += 1;
        self.strangers += 1;
        Said { host_us: None, is_right: false }
    }

    /// The place of the first entry with this checksum among those looked at.
    fn find(&mut self, check: Check) -> Option<usize> {
        let is_same = |entry: &Entry| entry.check == Some(check);
        self.read_ahead(1);
        if self.ahead.front().is_some_and(is_same) {
            return Some(0);
        }
        let strangers = self.strangers;
        // Wherever it is looked for, it is about where its own entry would be, too.
        let own = strangers + STRANGERS;
        let (from, to) = match strangers {
            far if far >= STRANGERS && far.is_power_of_two() => (0, FURTHEST.max(own)),
            near if near.is_multiple_of(STRANGERS) || near < STRANGERS => (0, WINDOW.max(own)),
            _ => (strangers - STRANGERS, own),
        };
        self.read_ahead(to);
        let to = to.min(self.ahead.len());
        let at = self.ahead.range(from.min(to)..to).position(is_same)?;
        Some(from + at)
    }

    /// Has so many entries ahead, as far as there are so many.
    fn read_ahead(&mut self, entries: usize) {
        while self.ahead.len() < entries {
            let Some(entry) = self.read() else { return };
            self.ahead.push_back(entry);
        }
    }

    /// The next entry of the file; `None` at its end, and where it cannot be read.
    fn read(&mut self) -> Option<Entry> {
        let mut entry = [0; Layout::Wide.bytes()];
        let entry = entry.get_mut(..self.layout.bytes())?;
        self.reader.read_exact(entry).ok()?;
        Some(Entry::parse(entry, self.layout))
    }
}

#[cfg(test)]
mod tests;
