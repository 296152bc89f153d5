//! The side file of a log on disk: the host's receive times of its records, and their checksums where it has them. Its
//! bytes: [`driver_iface::side_file`].

use super::{CsiSource, Next};
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
#[doc(hidden)] // for the crates of this workspace
#[must_use]
pub fn side_path(log: &Path) -> PathBuf {
    let mut name = log.as_os_str().to_owned();
    name.push("stp");
    name.into()
}

/// What a side file with checksums ([`Layout::Checked`]) says of the records of its log.
#[doc(hidden)] // for the crates of this workspace
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
    pub(super) layout: Layout,
    /// Entries read and not used.
    ahead: VecDeque<Entry>,
    /// Records in a row that were wrong.
    strangers: usize,
    checks: Checks,
}

impl SideFile {
    /// The side file of a log, if it has one: beside its name, else beside the file that a link of that name leads to. One with
    /// checksums is compared with the log's first records.
    pub(super) fn of<S: CsiSource>(log: &Path, open: impl FnOnce() -> Option<S>) -> Option<Self> {
        // A pipe of that name would be waited for, and one that is the log is read once.
        let is_file = |path: &Path| std::fs::metadata(path).is_ok_and(|found| found.is_file());
        let there = std::fs::canonicalize(log).ok().filter(|log| is_file(log))?;
        let path = [side_path(log), side_path(&there)].into_iter().find(|path| is_file(path))?;
        let mut side = Self::new(BufReader::new(File::open(path).ok()?))?;
        if side.layout == Layout::Checked {
            side.checks.out_of_step = !side.is_of(open()?);
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
    fn is_of(&mut self, mut log: impl CsiSource) -> bool {
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
pub(super) mod tests {
    use super::*;
    use crate::source::replay::Replay;
    use proptest::prelude::*;

    fn record(number: u16) -> Vec<u8> {
        let [high, low] = number.to_be_bytes();
        vec![0, 6, 0x70, high, low, 1, 2, 3]
    }

    fn entry(number: u16) -> Entry {
        Entry { host_us: Some(i64::from(number) + 1), check: Some(Check::of(&record(number))) }
    }

    /// A side file.
    pub(in crate::source) fn bytes_of(layout: Layout, entries: &[Entry]) -> Vec<u8> {
        let mut bytes = layout.head().to_vec();
        for entry in entries {
            let mut out = [0; 16];
            entry.emit(layout, &mut out).unwrap();
            bytes.extend(&out[..layout.bytes()]);
        }
        bytes
    }

    fn side_file(entries: &[Entry]) -> SideFile<Cursor<Vec<u8>>> {
        SideFile::new(Cursor::new(bytes_of(Layout::Checked, entries))).unwrap()
    }

    /// Takes a log's records one by one; gives the numbers of those that are right with their times, and what was counted.
    fn read(mut side: SideFile<Cursor<Vec<u8>>>, log: &[Vec<u8>]) -> (Vec<Said>, Checks) {
        let said = log.iter().map(|record| side.take(record)).collect();
        side.end();
        (said, side.checks().unwrap())
    }

    const fn right(number: i64) -> Said {
        Said { host_us: Some(number + 1), is_right: true }
    }

    const WRONG: Said = Said { host_us: None, is_right: false };

    #[test]
    fn names_are_those_of_the_log_with_stp() {
        assert_eq!(side_path(Path::new("out.dat")), Path::new("out.datstp"));
    }

    #[test]
    fn what_was_changed_lost_and_made_up_is_found() {
        let entries: Vec<Entry> = (0..6).map(entry).collect();
        let mut changed = record(1);
        changed[5] ^= 4;
        // 1 was changed, 2 and 3 are lost, 99 was never written, 5 is cut off.
        let log = [record(0), changed, record(99), record(4)];
        let (said, checks) = read(side_file(&entries), &log);
        assert_eq!(said, [right(0), WRONG, WRONG, right(4)]);
        assert_eq!(checks, Checks { good: 2, wrong: 2, missing: 4, ..Checks::default() });
        // The first record of all.
        let (said, checks) = read(side_file(&entries), &[record(77), record(0)]);
        assert_eq!(said, [WRONG, right(0)]);
        assert_eq!(checks, Checks { good: 1, wrong: 1, missing: 5, ..Checks::default() });
    }

    #[test]
    fn what_is_not_known_is_not_refused() {
        // The disk was full: an entry of zeros, one with a time only. The recorder was killed: nothing of the last two.
        let entries = [entry(0), Entry::default(), Entry::from(Some(7)), entry(3)];
        let log: Vec<Vec<u8>> = (0..6).map(record).collect();
        let (said, checks) = read(side_file(&entries), &log);
        let unknown = |host_us| Said { host_us, is_right: true };
        assert_eq!(said, [right(0), unknown(None), unknown(Some(7)), right(3), unknown(None), unknown(None)]);
        assert_eq!(checks, Checks { good: 2, unknown: 4, ..Checks::default() });
    }

    #[test]
    fn damage_before_what_is_not_known_costs_only_itself() {
        // The recorder was killed: five entries for nine records. The last of the five was changed.
        let entries: Vec<Entry> = (0..5).map(entry).collect();
        let mut log: Vec<Vec<u8>> = (0..9).map(record).collect();
        log[4][6] ^= 1;
        let (said, checks) = read(side_file(&entries), &log);
        let unknown = Said { host_us: None, is_right: true };
        assert_eq!(said, [right(0), right(1), right(2), right(3), WRONG, unknown, unknown, unknown, unknown]);
        assert_eq!(checks, Checks { good: 4, unknown: 4, wrong: 1, missing: 1, ..Checks::default() });
        // The disk of the side file was full after two, and the second record is lost.
        let entries: Vec<Entry> = (0..2).map(entry).chain((0..200).map(|_| Entry::default())).collect();
        let log: Vec<Vec<u8>> = (0..200).filter(|k| *k != 1).map(record).collect();
        let (said, checks) = read(side_file(&entries), &log);
        // One record is taken for the damaged one, as nothing says that it is not.
        assert_eq!(said.iter().filter(|said| said.is_right).count(), 198);
        assert_eq!((checks.good, checks.wrong, checks.out_of_step), (1, 1, false));
    }

    /// A log in memory.
    fn log(records: &[Vec<u8>]) -> Replay<Cursor<Vec<u8>>> {
        Replay::new(Cursor::new(records.concat()), String::new())
    }

    #[test]
    fn a_side_file_of_another_log_is_not_gone_by() {
        let entries: Vec<Entry> = (0..100).map(entry).collect();
        let records = |numbers: std::ops::Range<u16>| numbers.map(record).collect::<Vec<_>>();
        assert!(side_file(&entries).is_of(log(&[])), "of a log without records it may be");
        assert!(side_file(&entries).is_of(log(&records(90..95))));
        assert!(!side_file(&entries).is_of(log(&records(500..520))));
        // It knows one record, behind many that it does not know: damage is not looked through for ever.
        assert!(side_file(&entries).is_of(log(&[records(1_000..2_023), records(7..8)].concat())));
        assert!(!side_file(&entries).is_of(log(&[records(1_000..2_024), records(7..8)].concat())));
    }

    #[test]
    fn what_was_changed_is_left_out_however_much_of_it_there_is() {
        let number = |count: usize| count as u16;
        let entries: Vec<Entry> = (0..4_000).map(entry).collect();
        for (from, changed) in [(1_000, 63), (1_000, 64), (1_000, 65), (100, 700), (1_000, 3_000), (3_990, 10)] {
            let is_changed = |at: &usize| (from..from + changed).contains(at);
            let log: Vec<Vec<u8>> =
                (0..4_000).map(|at| record(number(if is_changed(&at) { 30_000 + at } else { at }))).collect();
            let (said, checks) = read(side_file(&entries), &log);
            let expected: Vec<Said> =
                (0..4_000).map(|at| if is_changed(&at) { WRONG } else { right(at as i64) }).collect();
            assert!(said == expected, "{changed} from {from}");
            let (good, changed) = (4_000 - changed as u64, changed as u64);
            assert_eq!(checks, Checks { good, wrong: changed, missing: changed, ..Checks::default() });
        }
    }

    #[test]
    fn a_record_is_found_behind_more_changed_ones_than_the_window_has() {
        // Checksums of the numbers themselves: records have 16 bits of their own.
        let checked = |bytes: &[u8]| Entry { check: Some(Check::of(bytes)), ..Entry::default() };
        for changed in [WINDOW + STRANGERS, WINDOW + 2 * STRANGERS + 1, FURTHEST] {
            let entries: Vec<Entry> = (0..changed + 100).map(|at| checked(&at.to_le_bytes())).collect();
            let mut file = side_file(&entries);
            let said: Vec<bool> = (0..changed + 100)
                .map(|at| if at < changed { vec![0xff; 3] } else { at.to_le_bytes().to_vec() })
                .map(|bytes| file.take(&bytes).is_right)
                .collect();
            assert_eq!(said.iter().position(|is_right| *is_right), Some(changed), "{changed}");
            assert_eq!((file.checks().unwrap().wrong, file.checks().unwrap().good), (changed as u64, 100));
        }
    }

    #[test]
    fn behind_a_damaged_stretch_records_are_found_though_more_are_missing_than_the_window_has() {
        let entries: Vec<Entry> = (0..100_000_u32)
            .map(|at| {
                if at < 90_000 {
                    Entry { check: Some(Check::of(&at.to_le_bytes())), ..Entry::default() }
                } else {
                    entry((at - 90_000) as u16)
                }
            })
            .collect();
        let log: Vec<Vec<u8>> = (30_000..30_100).chain(0..1_000).map(record).collect();
        let (said, checks) = read(side_file(&entries), &log);
        // They are looked for that far when there were 64 strangers, and 128.
        assert_eq!((checks.wrong, checks.good, checks.out_of_step), (128, 972, false));
        assert!(said[128..].iter().zip(28..).all(|(said, at)| *said == right(at)));
    }

    #[test]
    fn a_record_is_looked_for_among_as_many_entries_as_the_window_has() {
        let entries = [vec![entry(0)], vec![entry(1); WINDOW - 2], vec![entry(2), entry(3)]].concat();
        let is_right = |number| side_file(&entries).take(&record(number)).is_right;
        assert_eq!([0, 1, 2, 3].map(is_right), [true, true, true, false]);
    }

    #[test]
    fn layouts_without_checksums_give_times_until_bytes_are_skipped() {
        for layout in [Layout::Narrow, Layout::Wide] {
            let times = [1_700_000_000_000_001, 1_700_000_000_000_002].map(|us| Entry::from(Some(us)));
            let side = || SideFile::new(Cursor::new(bytes_of(layout, &times))).unwrap();
            let mut whole = side();
            let said = [(); 3].map(|()| whole.take(&record(0)).host_us);
            assert_eq!(said, [times[0].host_us, times[1].host_us, None]);
            let mut skipped = side();
            skipped.skip();
            assert_eq!(skipped.take(&record(0)), Said::NOTHING);
            assert_eq!((whole.checks(), whole.layout), (None, layout));
        }
    }

    /// A recorder whose disk was full at first leaves entries of zeros, and the times behind them are those of their records.
    #[test]
    fn times_behind_any_number_of_unknown_ones_are_found() {
        let time = 1_700_000_000_000_001;
        for (layout, unknown) in [(Layout::Narrow, 1), (Layout::Narrow, 2), (Layout::Narrow, 7), (Layout::Wide, 3)] {
            let known = [time, time + 1].map(|us| Entry::from(Some(us)));
            let entries = [vec![Entry::default(); unknown], known.to_vec()].concat();
            let mut side = SideFile::new(Cursor::new(bytes_of(layout, &entries))).unwrap();
            let said: Vec<_> = (0..unknown + 2).map(|_| side.take(&record(0)).host_us).collect();
            assert_eq!((side.layout, said.iter().flatten().count()), (layout, 2), "{unknown}");
            assert_eq!(said[unknown..], [Some(time), Some(time + 1)], "{layout:?} {unknown}");
        }
        // Nothing but zeros has an end, and a head that is not the first is none.
        let mut nothing = SideFile::new(std::io::repeat(0)).unwrap();
        assert_eq!(nothing.take(&record(0)), Said::NOTHING);
        let late = [&[0; 32][..], Layout::Checked.head()].concat();
        assert_eq!(SideFile::new(Cursor::new(late)).unwrap().layout, Layout::Narrow);
    }

    #[test]
    fn the_side_file_of_a_log_is_beside_its_name_or_beside_what_that_leads_to() {
        let folder = std::env::temp_dir().join(format!("csi5300-side-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("real")).unwrap();
        let (real, link) = (folder.join("real/a.dat"), folder.join("b.dat"));
        std::fs::write(&real, record(0)).unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        let of = |path: &Path| SideFile::of(path, || Some(log(&[record(0)])));
        let time = |path: &Path| of(path).and_then(|mut side| side.take(&record(0)).host_us);
        assert_eq!((time(&real), time(&link)), (None, None));
        let narrow = |us: i64| bytes_of(Layout::Narrow, &[Entry::from(Some(us))]);
        std::fs::write(side_path(&real), narrow(1_700_000_000_000_001)).unwrap();
        assert_eq!((time(&real), time(&link)), (Some(1_700_000_000_000_001), Some(1_700_000_000_000_001)));
        // With checksums it is known whose it is.
        for (number, of_another) in [(0, false), (9, true)] {
            std::fs::write(side_path(&real), bytes_of(Layout::Checked, &[entry(number)])).unwrap();
            let checks = of(&real).and_then(|side| side.checks());
            assert_eq!(checks.map(|checks| checks.out_of_step), Some(of_another));
        }
        std::fs::write(side_path(&real), narrow(1_700_000_000_000_001)).unwrap();
        std::fs::write(side_path(&link), narrow(1_700_000_000_000_002)).unwrap();
        assert_eq!((time(&real), time(&link)), (Some(1_700_000_000_000_001), Some(1_700_000_000_000_002)));
        std::fs::remove_dir_all(folder).unwrap();
    }

    proptest! {
        /// Whatever is removed from a log: every record that is left has its own time, and every count is exact.
        #[test]
        fn times_survive_any_loss(kept in prop::collection::vec(any::<bool>(), 1..200)) {
            let entries: Vec<Entry> = (0..kept.len() as u16).map(entry).collect();
            let left: Vec<u16> = (0..).zip(&kept).filter(|(_, kept)| **kept).map(|(number, _)| number).collect();
            let log: Vec<Vec<u8>> = left.iter().map(|number| record(*number)).collect();
            let (said, checks) = read(side_file(&entries), &log);
            prop_assert_eq!(said, left.iter().map(|number| right(i64::from(*number))).collect::<Vec<_>>());
            let (good, missing) = (left.len() as u64, (kept.len() - left.len()) as u64);
            prop_assert_eq!(checks, Checks { good, missing, ..Checks::default() });
        }
    }
}
