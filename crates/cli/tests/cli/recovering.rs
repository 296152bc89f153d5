//! Damaged logs and outputs: what is recovered was written, what already exists stays until something better is whole.

use crate::commands::{Folder, json};
use crate::common::link;
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
        let (status, _, said) = folder.run(&["export", "--dat", "in.dat", "out.dat", "--force"]);
        assert_eq!(status, 3, "case {case}: {said}");
        let found = read(&folder.0.join("out.dat"));
        let (status, _, said) = folder.run(&["export", "--dat", "out.dat", "again.dat", "--force"]);
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
    let made = link(300, 0.0);
    let [all, others] = [made.rx, made.tx].map(|records| records[..50].to_vec());
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
    let words = "checksums of the side file: 48 records right, 1 wrong and skipped, 2 of the side file not in the log";
    assert!(out.contains(words), "{out}");
    let (_, out, _) = folder.run(&["info", "in.dat", "--json"]);
    let checks = &json(&out)["checks"];
    assert_eq!(
        [&checks["good"], &checks["wrong"], &checks["missing"]].map(|n| n.as_u64()),
        [Some(48), Some(1), Some(2)]
    );
    let (status, _, said) = folder.run(&["export", "--dat", "in.dat", "out.dat"]);
    assert_eq!(status, 3, "{said}");
    let times: Vec<i64> = read(&folder.0.join("out.dat")).iter().filter_map(|(_, host_us)| *host_us).collect();
    let left = (0..50).filter(|at| ![20, 30].contains(at)).map(time);
    assert_eq!(times, left.collect::<Vec<_>>());
    // The side file of another log is not gone by.
    write(&log, &others, Layout::Checked);
    std::fs::write(&log, all.concat()).unwrap();
    let (status, out, said) = folder.run(&["info", "in.dat"]);
    assert!(status == 3 && out.contains("it is of another log"), "{out}");
    assert!(said.contains("No record is checked"), "{said}");
    // Nor does recovering vouch for what was not checked.
    let (status, _, said) = folder.run(&["export", "--dat", "in.dat", "unchecked.dat"]);
    assert!(status == 3 && said.contains("50 intact records"), "{said}");
    assert!(!side_path(&folder.0.join("unchecked.dat")).exists());
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

/// Files of a folder, by name.
fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
    let mut names: Vec<String> = entries.map(|name| name.to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// How many records of a log have the host times that [`write`] gave them.
fn timed(log: &Path) -> usize {
    read(log).iter().enumerate().filter(|(at, (_, host_us))| *host_us == Some(time(*at))).count()
}

#[test]
fn a_link_as_output_stays_one_and_its_side_file_is_that_of_its_log() {
    let folder = Folder::new("recover-link");
    write(&folder.0.join("log.dat"), &link(20, 0.0).rx, Layout::Narrow);
    std::fs::create_dir(folder.0.join("real")).unwrap();
    let (real, linked) = (folder.0.join("real/out.dat"), folder.0.join("link.dat"));
    std::os::unix::fs::symlink("real/out.dat", &linked).unwrap();
    // First to where nothing is, then over an older log with side files beside both names, of which none may stay.
    for force in [false, true] {
        if force {
            [&real, &side_path(&real)].into_iter().for_each(|old| std::fs::remove_file(old).unwrap());
            for old in [side_path(&linked), side_path(&real)] {
                std::fs::write(&old, [7; 160]).unwrap();
                let (status, _, errors) = folder.run(&["export", "--dat", "log.dat", "link.dat"]);
                assert!(status == 1 && errors.contains("stp already exists: --force"), "{errors}");
                assert!(!real.exists());
            }
        }
        let args = ["export", "--dat", "log.dat", "link.dat", "--force"];
        let (status, _, errors) = folder.run(if force { &args } else { &args[..4] });
        assert_eq!(status, 0, "{errors}");
        assert!(linked.is_symlink());
        assert_eq!((timed(&real), timed(&linked)), (20, 20));
        assert_eq!(names(&folder.0), ["link.dat", "log.dat", "log.datstp", "real"]);
        assert_eq!(names(&folder.0.join("real")), ["out.dat", "out.datstp"]);
    }
    // A log without times leaves none.
    std::fs::remove_file(folder.0.join("log.datstp")).unwrap();
    let (status, _, errors) = folder.run(&["export", "--dat", "log.dat", "link.dat", "--force"]);
    assert_eq!((status, names(&folder.0.join("real"))), (0, vec!["out.dat".to_owned()]), "{errors}");
    // What is no file has no side file.
    write(&folder.0.join("timed.dat"), &link(20, 0.0).rx, Layout::Narrow);
    let (status, _, errors) = folder.run(&["export", "--dat", "timed.dat", "/dev/null"]);
    assert!(status == 0 && errors.contains("host times, which go into a side file, are not written"), "{errors}");
    assert!(!Path::new("/dev/nullstp").exists());
}

/// Starts a command that reads the pipe `input` of the folder, hands it half a log and waits until it writes a draft.
fn begun(folder: &Folder, prefix: &str, args: &[&str]) -> (std::process::Child, std::fs::File) {
    use std::io::Write;
    let line = format!("{prefix} \"$0\" \"$@\"");
    let mut command = Command::new("sh");
    command.current_dir(&folder.0).args(["-c", &line, env!("CARGO_BIN_EXE_csi5300")]).args(args);
    let mut child = command.stdin(std::process::Stdio::null()).stderr(std::process::Stdio::null()).spawn().unwrap();
    // Without blocking: a command that ended before it opened the pipe fails the test instead of holding it up.
    let mut options = std::fs::OpenOptions::new();
    std::os::unix::fs::OpenOptionsExt::custom_flags(options.write(true), nix::libc::O_NONBLOCK);
    let mut pipe = loop {
        if let Ok(pipe) = options.open(folder.0.join("input")) {
            break pipe;
        }
        assert_eq!(child.try_wait().unwrap(), None, "it ended before it read anything");
        std::thread::yield_now();
    };
    pipe.write_all(&link(20, 0.0).rx.concat()).unwrap();
    while !names(&folder.0).iter().any(|name| name.contains(".part-")) {
        assert_eq!(child.try_wait().unwrap(), None, "it ended before it wrote anything");
        std::thread::yield_now();
    }
    (child, pipe)
}

#[test]
fn a_signal_leaves_the_old_output_and_nothing_else() {
    use nix::sys::signal::{Signal, kill};
    use std::os::unix::process::ExitStatusExt;
    let folder = Folder::new("draft-signals");
    pipe(&folder.0.join("input"));
    folder.write("old.csv", b"old");
    folder.write("old.dat", b"old");
    let before = names(&folder.0);
    // Tests may run with signals ignored (`nohup`, a job in the background), and programs that they start with them.
    let env = Command::new("env").args(["--default-signal", "true"]).output();
    if !env.is_ok_and(|output| output.status.success()) {
        return crate::common::skipped("`env --default-signal` is not there (coreutils 8.31)");
    }
    let pid = |child: &std::process::Child| nix::unistd::Pid::from_raw(child.id() as i32);
    for args in [
        &["export", "input", "old.csv", "--force"][..],
        &["export", "--dat", "input", "old.dat", "--force", "--layout", "stock"],
    ] {
        for signal in [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP] {
            let (mut child, input) = begun(&folder, "exec env --default-signal", args);
            kill(pid(&child), signal).unwrap();
            assert_eq!(child.wait().unwrap().signal(), Some(signal as i32), "{args:?}");
            drop(input);
            assert_eq!(names(&folder.0), before, "{args:?} {signal}");
        }
        // What it was started to ignore, as under nohup, it ignores.
        let (mut child, input) = begun(&folder, "trap '' HUP; exec", args);
        kill(pid(&child), Signal::SIGHUP).unwrap();
        drop(input);
        assert!(child.wait().unwrap().success(), "{args:?}");
        let output = args.iter().find(|arg| arg.starts_with("old.")).unwrap();
        assert_ne!(std::fs::read(folder.0.join(output)).unwrap(), b"old");
    }
}

#[test]
fn an_export_counts_records_without_antennas_among_those_it_writes() {
    let folder = Folder::new("export-antennas");
    let mut records = link(20, 0.0).rx;
    // No antenna at any chain, in the second and in the last record.
    let sel = driver_iface::record::LENGTH_FIELD + 1 + driver_iface::bfee::offset::ANTENNA_SEL;
    [1, 19].into_iter().for_each(|k| records[k][sel] = 0xff);
    folder.write("log.dat", &records.concat());
    for name in ["out.csv", "out.npz"] {
        let written = |more: &[&str]| {
            let (status, out, errors) = folder.run(&[&["export", "log.dat", name, "--json", "--force"], more].concat());
            assert_eq!(status, 0, "{errors}");
            let row = json(out.lines().next().unwrap());
            let said = errors.contains("without a valid antenna_sel");
            let without = row["without_antennas"].as_u64().unwrap();
            assert_eq!(said, without > 0, "{errors}");
            (row["records"].as_u64().unwrap(), row["left_out"].as_u64().unwrap(), without)
        };
        assert_eq!(written(&[]), (20, 0, 2), "{name}");
        let first_us = |k: usize| driver_iface::bfee::Bfee::new_checked(&records[k][3..]).unwrap().timestamp_low();
        let half_s = f64::from(first_us(10).wrapping_sub(first_us(0))) * 1e-6;
        assert_eq!(written(&["--to", &half_s.to_string()]), (10, 10, 1), "{name}");
        assert_eq!(written(&["--from", &half_s.to_string()]), (10, 10, 1), "{name}");
    }
}
