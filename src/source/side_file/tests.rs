use super::*;
use proptest::prelude::*;

fn record(number: u16) -> Vec<u8> {
    let [high, low] = number.to_be_bytes();
    vec![0, 6, 0x70, high, low, 1, 2, 3]
}

fn entry(number: u16) -> Entry {
    Entry { host_us: Some(i64::from(number) + 1), check: Some(Check::of(&record(number))) }
}

fn side_file(entries: &[Entry]) -> SideFile<std::io::Cursor<Vec<u8>>> {
    let mut bytes = Layout::Checked.head().to_vec();
    for entry in entries {
        let mut out = [0; 16];
        entry.emit(Layout::Checked, &mut out).unwrap();
        bytes.extend(out);
    }
    SideFile::new(std::io::Cursor::new(bytes)).unwrap()
}

/// Takes a log's records one by one; gives the numbers of those that are right with their times, and what was counted.
fn read(mut side: SideFile<std::io::Cursor<Vec<u8>>>, log: &[Vec<u8>]) -> (Vec<Said>, Checks) {
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
fn log(records: &[Vec<u8>]) -> Replay<std::io::Cursor<Vec<u8>>> {
    Replay::new(std::io::Cursor::new(records.concat()), String::new())
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
        let expected: Vec<Said> = (0..4_000).map(|at| if is_changed(&at) { WRONG } else { right(at as i64) }).collect();
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
        let mut bytes = Vec::new();
        for time in times {
            let mut out = [0; 16];
            time.emit(layout, &mut out).unwrap();
            bytes.extend(&out[..layout.bytes()]);
        }
        let side = || SideFile::new(std::io::Cursor::new(bytes.clone())).unwrap();
        let mut whole = side();
        let said = [(); 3].map(|()| whole.take(&record(0)).host_us);
        assert_eq!(said, [times[0].host_us, times[1].host_us, None]);
        let mut skipped = side();
        skipped.skip();
        assert_eq!(skipped.take(&record(0)), Said::NOTHING);
        assert_eq!((whole.checks(), whole.layout()), (None, layout));
    }
}

/// A recorder whose disk was full at first leaves entries of zeros, and the times behind them are those of their records.
#[test]
fn times_behind_any_number_of_unknown_ones_are_found() {
    let time = 1_700_000_000_000_001;
    for (layout, unknown) in [(Layout::Narrow, 1), (Layout::Narrow, 2), (Layout::Narrow, 7), (Layout::Wide, 3)] {
        let mut bytes = vec![0; unknown * layout.bytes()];
        for us in [time, time + 1] {
            let mut out = [0; 16];
            Entry::from(Some(us)).emit(layout, &mut out).unwrap();
            bytes.extend(&out[..layout.bytes()]);
        }
        let mut side = SideFile::new(Cursor::new(bytes)).unwrap();
        let said: Vec<_> = (0..unknown + 2).map(|_| side.take(&record(0)).host_us).collect();
        assert_eq!((side.layout(), said.iter().flatten().count()), (layout, 2), "{unknown}");
        assert_eq!(said[unknown..], [Some(time), Some(time + 1)], "{layout:?} {unknown}");
    }
    // Nothing but zeros has an end, and a head that is not the first is none.
    let mut nothing = SideFile::new(std::io::repeat(0)).unwrap();
    assert_eq!(nothing.take(&record(0)), Said::NOTHING);
    let late = [&[0; 32][..], Layout::Checked.head()].concat();
    assert_eq!(SideFile::new(Cursor::new(late)).unwrap().layout(), Layout::Narrow);
}

#[test]
fn the_side_file_of_a_log_is_beside_its_name_or_beside_what_that_leads_to() {
    let folder = std::env::temp_dir().join(format!("csi5300-side-{}", std::process::id()));
    std::fs::create_dir_all(folder.join("real")).unwrap();
    let (real, link) = (folder.join("real/a.dat"), folder.join("b.dat"));
    std::fs::write(&real, record(0)).unwrap();
    std::os::unix::fs::symlink(&real, &link).unwrap();
    let time = |log: &Path| SideFile::of(log).and_then(|mut side| side.take(&record(0)).host_us);
    assert_eq!((time(&real), time(&link)), (None, None));
    let narrow = |us: i64| {
        let mut out = [0; 8];
        Entry::from(Some(us)).emit(Layout::Narrow, &mut out).unwrap();
        out
    };
    std::fs::write(side_path(&real), narrow(1_700_000_000_000_001)).unwrap();
    assert_eq!((time(&real), time(&link)), (Some(1_700_000_000_000_001), Some(1_700_000_000_000_001)));
    // With checksums it is known whose it is.
    for (number, of_another) in [(0, false), (9, true)] {
        let mut bytes = Layout::Checked.head().to_vec();
        let mut out = [0; 16];
        entry(number).emit(Layout::Checked, &mut out).unwrap();
        bytes.extend(out);
        std::fs::write(side_path(&real), bytes).unwrap();
        let checks = SideFile::of(&real).and_then(|side| side.checks());
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
