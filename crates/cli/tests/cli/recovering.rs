//! Damaged logs and outputs: what is recovered was written, what is there already stays until something better is whole.

use crate::commands::{Folder, json};
use crate::common::link::link;
use csi5300::source::recorder::{Chunk, LogFiles, Rotation, Sink};
use csi5300::source::{CsiSource, Next, replay::Replay, side_path};
use csi5300::time::Instant;
use driver_iface::record::Record;
use driver_iface::side_file::Layout;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// xorshift64.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % n as u64) as usize
    }
}

/// Records of a link, some of a code that nobody knows among them.
fn records(random: &mut Random) -> Vec<Vec<u8>> {
    let mut records = Vec::new();
    for record in link(300, 0.0).rx {
        records.push(record);
        if random.below(4) == 0 {
            let body: Vec<u8> = (0..random.below(80)).map(|_| random.below(256) as u8).collect();
            let record = Record { code: 0x70 + random.below(3) as u8, body: &body };
            let mut bytes = vec![0; record.emit_len()];
            record.emit(&mut bytes).unwrap();
            records.push(bytes);
        }
    }
    records
}

/// Some bytes overwritten, taken out, put in; a stretch of zeros; the end cut.
fn damage(random: &mut Random, log: &mut Vec<u8>) {
    for _ in 0..1 + random.below(60) {
        let at = random.below(log.len());
        match random.below(4) {
            0 => drop(log.remove(at)),
            1 => log.insert(at, random.below(256) as u8),
            2 => log.iter_mut().skip(at).take(random.below(600)).for_each(|byte| *byte = 0),
            _ => log[at] ^= 1 << random.below(8),
        }
    }
    let cut = log.len() - random.below(300);
    log.truncate(cut);
}

/// The host's time of a record, by its place among those written.
fn time(at: usize) -> i64 {
    1_700_000_000_000_000 + 10_000 * at as i64
}

fn write(log: &Path, records: &[Vec<u8>], layout: Layout) {
    let mut files = LogFiles::create(log, Rotation::default(), true).unwrap().with_side_layout(layout);
    let host_us = (0..records.len()).map(|at| Some(time(at))).collect();
    let written = files.write(&Chunk { bytes: records.concat(), host_us, at: Instant::ZERO });
    assert_eq!((written.records, written.error), (records.len() as u64, None));
}

/// The records of a log with their times; nothing in it may be lost.
fn read(log: &Path) -> Vec<(Vec<u8>, Option<i64>)> {
    let mut replay = Replay::open(log).unwrap();
    let mut records = Vec::new();
    loop {
        match replay.receive(Instant::ZERO).unwrap() {
            Next::Record(stamps, record) => {
                let mut bytes = vec![0; record.emit_len()];
                record.emit(&mut bytes).unwrap();
                records.push((bytes, stamps.host_us));
            }
            Next::End(driver_iface::record::Tail::Clean) => return records,
            other => panic!("{}: {other:?}", log.display()),
        }
    }
}

#[test]
fn what_is_recovered_is_a_log_from_which_nothing_more_is_to_be_recovered() {
    let folder = Folder::new("settled");
    let mut random = Random(0x5300_0020);
    let (mut kept, mut invented) = (0, 0);
    for case in 0..24 {
        let checked = case % 2 == 0;
        let all = records(&mut random);
        let log = folder.0.join("in.dat");
        write(&log, &all, if checked { Layout::Checked } else { Layout::Narrow });
        let mut bytes = all.concat();
        damage(&mut random, &mut bytes);
        std::fs::write(&log, &bytes).unwrap();
        let (status, _, said) = folder.run(&["recover", "in.dat", "out.dat", "--force"]);
        assert_eq!(status, 3, "case {case}: {said}");
        let found = read(&folder.0.join("out.dat"));
        let (status, _, said) = folder.run(&["recover", "out.dat", "again.dat", "--force"]);
        assert_eq!(status, 0, "case {case}: {said}");
        for (one, other) in [("out.dat", "again.dat"), ("out.datstp", "again.datstp")] {
            let same = std::fs::read(folder.0.join(one)).unwrap() == std::fs::read(folder.0.join(other)).unwrap();
            assert!(same, "case {case}: {one} and {other} differ");
        }
        let known: BTreeSet<&Vec<u8>> = all.iter().collect();
        let new = found.iter().filter(|(record, _)| !known.contains(record)).count();
        assert!(!checked || new == 0, "case {case}: {new} records that were never written");
        // A changed sample is in the record that it was written as, where there is no checksum.
        let made_up = |record: &&Vec<u8>| !known.contains(record) && !all.iter().any(|own| own.len() == record.len());
        invented += found.iter().map(|(record, _)| record).filter(made_up).count();
        kept += found.len();
        if checked {
            let mut at = 0;
            for (record, host_us) in &found {
                at += all[at..].iter().position(|own| own == record).expect("in the order of the log");
                assert!(host_us.is_some_and(|us| all[usize::try_from((us - time(0)) / 10_000).unwrap()] == *record));
            }
        }
        assert!(found.len() > all.len() / 4, "case {case}: {} of {} records", found.len(), all.len());
    }
    // Without checksums damage can look like a record; one of a thousand would be too many.
    assert!(1_000 * invented < kept, "{invented} of {kept} records");
}

#[test]
fn checksums_show_what_the_layout_of_a_log_cannot() {
    let folder = Folder::new("checksums");
    let all = link(50, 0.0).rx;
    let log = folder.0.join("in.dat");
    write(&log, &all, Layout::Checked);
    let (status, out, _) = folder.run(&["info", "in.dat"]);
    assert!(status == 0 && out.contains("checksums of the side file: 50 records right\n"), "{out}");
    // One bit of one sample; one record gone with all its bytes.
    let mut changed = all.clone();
    *changed[20].last_mut().unwrap() ^= 0x10;
    changed.remove(30);
    std::fs::write(&log, changed.concat()).unwrap();
    let (status, out, _) = folder.run(&["info", "in.dat"]);
    assert_eq!(status, 3, "{out}");
    let words = "checksums of the side file: 48 records right, 1 wrong and left out, 2 of the side file not in the log";
    assert!(out.contains(words), "{out}");
    let (_, out, _) = folder.run(&["info", "in.dat", "--json"]);
    let checks = &json(&out)["checks"];
    assert_eq!(
        [&checks["good"], &checks["wrong"], &checks["missing"]].map(|n| n.as_u64()),
        [Some(48), Some(1), Some(2)]
    );
    let (status, _, said) = folder.run(&["recover", "in.dat", "out.dat"]);
    assert_eq!(status, 3, "{said}");
    let times: Vec<i64> = read(&folder.0.join("out.dat")).iter().filter_map(|(_, host_us)| *host_us).collect();
    let left = (0..50).filter(|at| ![20, 30].contains(at)).map(time);
    assert_eq!(times, left.collect::<Vec<_>>());
    // The side file of another log is not gone by.
    write(&log, &link(50, 0.0).tx, Layout::Checked);
    std::fs::write(&log, all.concat()).unwrap();
    let (status, out, _) = folder.run(&["info", "in.dat"]);
    assert!(status == 0 && out.contains("it is of another log"), "{out}");
}

fn pipe(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

#[test]
fn a_pipe_beside_a_log_is_not_waited_for() {
    let folder = Folder::new("side-pipe");
    let log = folder.write("log.dat", &link(20, 0.0).rx.concat());
    pipe(&side_path(&log));
    let (status, out, _) = folder.run(&["info", "log.dat"]);
    assert!(status == 0 && out.contains("20 records"), "{out}");
}

#[test]
fn an_export_reads_a_pipe_once_and_leaves_the_old_output_until_the_new_one_is_whole() {
    let folder = Folder::new("export-pipe");
    let bytes = link(20, 0.0).rx.concat();
    for name in ["out.csv", "out.npz"] {
        folder.write(name, b"old");
        for input in ["none.dat", "empty.dat"] {
            folder.write("empty.dat", b"");
            let (status, ..) = folder.run(&["export", input, name, "--force"]);
            assert_eq!(status, 1);
            assert_eq!(std::fs::read(folder.0.join(name)).unwrap(), b"old", "{name} after {input}");
        }
        let input = folder.0.join("input");
        pipe(&input);
        let bytes = bytes.clone();
        let writer = std::thread::spawn({
            let input = input.clone();
            move || std::fs::write(input, bytes)
        });
        let (status, _, said) = folder.run(&["export", "input", name, "--force"]);
        assert!(status == 0 && said.contains("20 records written"), "{said}");
        writer.join().unwrap().unwrap();
        assert!(std::fs::metadata(folder.0.join(name)).unwrap().len() > 1_000);
        std::fs::remove_file(input).unwrap();
    }
    let left = std::fs::read_dir(&folder.0)
        .unwrap()
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().contains(".part"));
    assert_eq!(left.count(), 0);
}
