//! Outputs. One is never an input: every command, with every output option set to every input, by name and by links. What is recovered was
//! written, what already exists stays until something better is whole, and on a disk without room nothing that is cut has a name.
//! Pictures are PNG and SVG, replaced by the next run.

use crate::commands::{Folder, capture, json};
use crate::common::link;
use csi5300::source::recorder::{Chunk, LogFiles, Rotation, Sink};
use csi5300::source::replay::Replay;
use csi5300::source::{CsiSource, Next, side_path};
use csi5300::time::Instant;
use driver_iface::record::Record;
use driver_iface::side_file::Layout;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

const BEARING: &[&str] = &["rx.dat", "tx.dat", "t.csv"];
const CAPTURE: &[&str] = &["set/csi_rx_1.dat", "set/csi_tx1_1.dat", "set/rx_trajectory_1_.csv"];

/// Each option of a command that names an output: the inputs of a run, and its words, in which OUT is the output.
/// `the_list_is_whole` in the program's own tests knows them too.
const RUNS: &[(&[&str], &str)] = &[
    (BEARING, "bearing --rx rx.dat --tx tx.dat --trajectory t.csv --channel 108 --profile OUT"),
    (BEARING, "bearing --rx rx.dat --tx tx.dat --trajectory t.csv --channel 108 --plot OUT"),
    (BEARING, "mcap rx.dat tx.dat --trajectory t.csv --channel 108 --out OUT"),
    (BEARING, "simulate --rx rx.dat --tx tx.dat --trajectory t.csv --channel 108 --out OUT"),
    (&["rx.dat", "rx.datstp"], "export --dat rx.dat OUT"),
    (&["rx.dat"], "export rx.dat OUT"),
    (&["rx.dat"], "info rx.dat --plot OUT"),
    (CAPTURE, "evaluate set --channel 108 --html OUT"),
    (CAPTURE, "evaluate set --plot OUT"),
    (CAPTURE, "bearing set --channel 108 --plot OUT"),
    (CAPTURE, "bearing set/tx1 --channel 108 --out OUT"),
    (&["drive.toml", "t.csv"], "simulate drive.toml --out OUT"),
    (&["recording.mcap"], "unbag recording.mcap --out OUT"),
    (&["group.key"], "sound --answer --interface none0 --peers 00:21:6a:53:89:d2 --key group.key --log OUT"),
    (
        &["group.key", "t.csv"],
        "sound --interface none0 --peers 00:21:6a:53:89:d2 --key group.key --trajectory t.csv --channel 108 --log OUT",
    ),
];

const DRIVE: &str = "channel = 108\nduration_s = 0.2\nsounding.rate_hz = 50\n[[robot]]\nname = \"rx\"\nposition_m = [0.0, 0.0, 0.0]\n\
                     motion.recorded = { file = \"t.csv\" }\n[[robot]]\nname = \"tx\"\nposition_m = [3.0, 1.0, 0.0]\n";

fn inputs(name: &str) -> Folder {
    let folder = Folder::new(name);
    let made = link(300, 1.0);
    folder.link(&made);
    folder.write("rx.datstp", &[0; 8 * 300]);
    std::fs::create_dir(folder.0.join("set")).unwrap();
    folder.write("set/csi_rx_1.dat", &made.rx.concat());
    folder.write("set/csi_tx1_1.dat", &made.tx.concat());
    folder.write("set/rx_trajectory_1_.csv", made.trajectory.as_bytes());
    folder.write("drive.toml", DRIVE.as_bytes());
    folder.write("recording.mcap", b"\x89MCAP0\r\n");
    folder.write("group.key", b"0");
    folder
}

/// All files below, with what is in them.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut all: Vec<_> = entries
        .flat_map(
            |path| if path.is_dir() { contents(&path) } else { vec![(path.clone(), std::fs::read(&path).unwrap())] },
        )
        .collect();
    all.sort();
    all
}

#[test]
fn an_output_may_be_a_link_of_another_ending_or_standard_output() {
    let folder = inputs("linked");
    std::os::unix::fs::symlink("run-12", folder.0.join("latest.npz")).unwrap();
    folder.says(&["export", "rx.dat", "latest.npz"], 0, &[]);
    folder.says(&["export", "rx.dat", "latest.npz", "--force"], 0, &[]);
    assert!(folder.0.join("latest.npz").is_symlink() && folder.0.join("run-12").is_file());
    folder.says(&["export", "rx.dat", "plain.csv"], 0, &[]);
    let plain = std::fs::read_to_string(folder.0.join("plain.csv")).unwrap();
    std::os::unix::fs::symlink("/dev/stdout", folder.0.join("piped.csv")).unwrap();
    assert_eq!(folder.says(&["export", "rx.dat", "piped.csv"], 0, &[]).0, plain);
    let mut piped = Command::new(env!("CARGO_BIN_EXE_csi5300"));
    piped.current_dir(&folder.0).args(["export", "--dat", "rx.dat", "/dev/stdout"]);
    assert_eq!(piped.output().unwrap().stdout, std::fs::read(folder.0.join("rx.dat")).unwrap());
}

#[test]
fn no_output_is_an_input() {
    let folder = inputs("outputs");
    // Names with the endings that commands ask of their outputs.
    let endings = ["csv", "npz", "mcap", "html", "dat"];
    let mut refused = 0;
    for (read, args) in RUNS {
        for input in *read {
            for (k, ending) in endings.iter().enumerate() {
                let link = folder.0.join(format!("link.{ending}"));
                let outputs = [(*input).to_owned(), format!("./{input}"), format!("link.{ending}")];
                match k % 2 {
                    0 => std::os::unix::fs::symlink(folder.0.join(input), &link).unwrap(),
                    _ => std::fs::hard_link(folder.0.join(input), &link).unwrap(),
                }
                let before = contents(&folder.0);
                for output in outputs {
                    let mut args: Vec<&str> =
                        args.split(' ').map(|arg| if arg == "OUT" { output.as_str() } else { arg }).collect();
                    // `info` and `evaluate --plot` replace pictures unasked.
                    let is_pictures = args[0] == "info" || args.starts_with(&["evaluate", "set", "--plot"]);
                    if !is_pictures && (args[0] != "unbag" || output.contains("recording")) {
                        args.push("--force");
                    }
                    let (status, _, err) = folder.run(&args);
                    assert!(status != 0, "{args:?}");
                    assert!(contents(&folder.0) == before, "{args:?} changed what is there: {err}");
                    refused += u32::from(err.contains("input"));
                }
                std::fs::remove_file(link).unwrap();
            }
        }
    }
    assert!(refused > 200, "{refused}: the rest was refused for another reason");
}

#[test]
fn what_a_folder_gets_is_no_input_either() {
    let folder = inputs("folders");
    // The dataset's trajectory would have the name of the one that is driven along.
    let (status, ..) = folder.run(&["simulate", "drive.toml", "--out", "first"]);
    assert_eq!(status, 0);
    let made = contents(&folder.0.join("first"));
    let (own, _) = made.iter().find(|(path, _)| path.to_string_lossy().contains("rx_trajectory_")).unwrap();
    let own = own.strip_prefix(&folder.0).unwrap().to_string_lossy().into_owned();
    folder.write("again.toml", DRIVE.replace("t.csv", &own).as_bytes());
    let (_, err) = folder.says(&["simulate", "again.toml", "--out", "first", "--force"], 1, &["is an input"]);
    assert!(contents(&folder.0.join("first")) == made, "{err}");
    a_picture_that_leads_to_the_log_is_refused(&folder);
    // A page beside the captures is no input.
    for _ in 0..2 {
        let (status, _, err) =
            folder.run(&["evaluate", "set", "--channel", "108", "--html", "set/page.html", "--force"]);
        assert!(status == 0 || status == 3, "{status}: {err}");
    }
}

fn a_picture_that_leads_to_the_log_is_refused(folder: &Folder) {
    std::fs::create_dir(folder.0.join("pictures")).unwrap();
    std::os::unix::fs::symlink("../rx.dat", folder.0.join("pictures/rx-csi.png")).unwrap();
    let log = std::fs::read(folder.0.join("rx.dat")).unwrap();
    let (status, _, err) = folder.run(&["info", "rx.dat", "--plot", "pictures"]);
    assert!(status != 0 && err.contains("by another name: name another output"), "{status}: {err}");
    assert_eq!(std::fs::read(folder.0.join("rx.dat")).unwrap(), log);
}

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
        folder.says(&["export", "--dat", "in.dat", "out.dat", "--force"], 3, &[]);
        let found = read(&folder.0.join("out.dat"));
        folder.says(&["export", "--dat", "out.dat", "again.dat", "--force"], 0, &[]);
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
    let (out, _) = folder.says(&["info", "in.dat"], 0, &[]);
    assert!(out.contains("checksums of the side file: 50 records right\n"), "{out}");
    // One bit of one sample; one record gone with all its bytes.
    let mut changed = all.clone();
    *changed[20].last_mut().unwrap() ^= 0x10;
    changed.remove(30);
    std::fs::write(&log, changed.concat()).unwrap();
    let (out, _) = folder.says(&["info", "in.dat"], 3, &[]);
    let words = "checksums of the side file: 48 records right, 1 wrong and skipped, 2 of the side file not in the log";
    assert!(out.contains(words), "{out}");
    let (_, out, _) = folder.run(&["info", "in.dat", "--json"]);
    let checks = &json(&out)["checks"];
    assert_eq!(
        [&checks["good"], &checks["wrong"], &checks["missing"]].map(|n| n.as_u64()),
        [Some(48), Some(1), Some(2)]
    );
    folder.says(&["export", "--dat", "in.dat", "out.dat"], 3, &[]);
    let times: Vec<i64> = read(&folder.0.join("out.dat")).iter().filter_map(|(_, host_us)| *host_us).collect();
    let left = (0..50).filter(|at| ![20, 30].contains(at)).map(time);
    assert_eq!(times, left.collect::<Vec<_>>());
    // The side file of another log is not gone by.
    write(&log, &others, Layout::Checked);
    std::fs::write(&log, all.concat()).unwrap();
    let (out, said) = folder.says(&["info", "in.dat"], 3, &[]);
    assert!(out.contains("it is of another log"), "{out}");
    assert!(said.contains("No record is checked"), "{said}");
    // Nor does recovering vouch for what was not checked.
    folder.says(&["export", "--dat", "in.dat", "unchecked.dat"], 3, &["50 intact records"]);
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
    let (out, _) = folder.says(&["info", "log.dat"], 0, &[]);
    assert!(out.contains("20 records"), "{out}");
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
        folder.says(&["export", "input", name, "--force"], 0, &["20 records written"]);
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
                folder.says(&["export", "--dat", "log.dat", "link.dat"], 1, &["stp already exists: --force"]);
                assert!(!real.exists());
            }
        }
        let args = ["export", "--dat", "log.dat", "link.dat", "--force"];
        folder.says(if force { &args } else { &args[..4] }, 0, &[]);
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
    folder.says(
        &["export", "--dat", "timed.dat", "/dev/null"],
        0,
        &["host times, which go into a side file, are not written"],
    );
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
    folder.write("old.dat", b"old");
    let before = names(&folder.0);
    // Tests may run with signals ignored (`nohup`, a job in the background), and programs that they start with them.
    let env = Command::new("env").args(["--default-signal", "true"]).output();
    if !env.is_ok_and(|output| output.status.success()) {
        return crate::common::skipped("`env --default-signal` is not there (coreutils 8.31)");
    }
    let pid = |child: &std::process::Child| nix::unistd::Pid::from_raw(child.id() as i32);
    // It writes while it reads; tables of a pipe are written at its end.
    let args = &["export", "--dat", "input", "old.dat", "--force", "--layout", "stock"];
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
    assert_ne!(std::fs::read(folder.0.join("old.dat")).unwrap(), b"old");
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
            let (out, errors) =
                folder.says(&[&["export", "log.dat", name, "--json", "--force"], more].concat(), 0, &[]);
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

#[test]
fn what_has_no_room_has_no_name_either() {
    let Some(folder) = Folder::inside(what_has_no_room_has_no_name_either, "-Urnm", "full") else { return };
    folder.write("rx.dat", &link(2_000, 20.0).rx.concat());
    std::fs::create_dir(folder.0.join("small")).unwrap();
    let Some(small) = folder.mount("small", "32k") else { return };
    let is_empty = || std::fs::read_dir(&small).unwrap().next().is_none();
    for output in ["small/out.npz", "small/out.mat"] {
        let (_, err) = folder.says(&["export", "rx.dat", output], 1, &[]);
        assert!(err.contains(output) && err.contains("No space left") && !err.contains(".part-"), "{output}: {err}");
        assert!(!err.contains("ZipWriter") && err.trim_end().lines().count() == 1, "{output}: {err}");
        assert!(is_empty(), "{output}");
    }
    let (status, _, err) = folder.run(&["info", "rx.dat", "--plot", "small"]);
    assert!(status != 0 && err.contains("No space left") && !err.contains(".part-"), "{status} {err}");
    for there in std::fs::read_dir(&small).unwrap() {
        // Of two pictures the first may have had room.
        let path = there.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        assert!(name.starts_with("rx-csi.") || name.starts_with("rx-levels."), "{name}");
        assert!(std::fs::metadata(&path).unwrap().len() > 0 && !err.contains(&name), "{name}: {err}");
    }
}

#[test]
fn pictures_and_maps_are_replaced_by_the_next_run() {
    let folder = Folder::new("drawing");
    folder.link(&link(300, 2.0));
    capture(&folder, "tree/A/good", &link(600, 2.0));
    let named = ["bearing", "--rx", "rx.dat", "--tx", "tx.dat", "--trajectory", "t.csv", "--channel", "108"];
    for (into, words, pictures) in [
        ("link", &named[..], &["tx-phase", "tx-profile", "tx-trajectory"][..]),
        ("all", &["evaluate", "tree"], &["errors", "refusals", "reliability", "map-A_good_1"]),
        ("maps", &["bearing", "tree"], &["map-"]),
    ] {
        for _ in 0..2 {
            folder.says(&[words, &["--plot", into]].concat(), 0, &[]);
            let drawn = names(&folder.0.join(into));
            for (picture, kind) in pictures.iter().flat_map(|picture| [(picture, ".png"), (picture, ".svg")]) {
                let name = drawn.iter().find(|name| name.starts_with(picture) && name.ends_with(kind));
                let name = name.unwrap_or_else(|| panic!("{into}: {picture}{kind}: {drawn:?}"));
                let file = folder.0.join(into).join(name);
                assert!(std::fs::read(&file).unwrap().len() > 100, "{into}: {name}");
                std::fs::write(file, "old").unwrap();
            }
        }
    }
}

#[test]
fn a_page_has_its_ending_and_says_why_a_link_has_no_bearing() {
    let folder = Folder::new("drawing-page");
    capture(&folder, "tree/A/good", &link(300, 2.0));
    let (out, _) = folder.says(&["evaluate", "tree", "--html", "x.pdf"], 2, &["x.pdf: the page is HTML"]);
    assert!(out.is_empty());
    assert!(!folder.0.join("x.pdf").exists());
    assert_eq!(folder.run(&["evaluate", "tree", "--html", "x.HTML"]).0, 0);
    folder.says(&["evaluate", "tree", "--html", "x.HTML"], 1, &["--force"]);
    assert_eq!(folder.run(&["evaluate", "tree", "tree/A", "--html", "y.html"]).0, 2, "a page is of one folder");
    // A capture whose channel nobody knows, beside one that names its own.
    capture(&folder, "tree/A/bad", &link(300, 2.0));
    std::fs::remove_file(folder.0.join("tree/A/bad/groundtruth_positions.json")).unwrap();
    let (_, _, err) = folder.run(&["evaluate", "tree", "--html", "i.html"]);
    assert!(err.contains("A/bad") && err.contains("unknown WiFi channel") && err.contains("--channel"), "{err}");
}

#[test]
fn errors_are_drawn_beside_those_of_another_program_on_the_same_links() {
    let folder = Folder::new("drawing-beside");
    capture(&folder, "tree/nlos/P1", &link(300, 2.0));
    capture(&folder, "tree/NLOS_Set_A/P1", &link(300, 2.0));
    let rows = "capture,tx,displacement,peer_est_deg,peer_err_from_mean_pose_deg\nnlos/P1/1,tx2,gt,30.0,-6.5\n";
    folder.write("tree/links.csv", rows.as_bytes());
    let (out, _) = folder.says(&["evaluate", "tree", "--plot", "p"], 0, &[]);
    let drawn = std::fs::read_to_string(folder.0.join("p/errors.svg")).unwrap();
    assert!(drawn.contains("toolbox, the same links (median 6.50)"), "{drawn}");
    assert!(drawn.contains("toolbox on all links of NLOS_Set_A by motion capture"), "{drawn}");
    // `all` comes last whatever the sets are called, and unknown figures are not printed.
    let line =
        |start: &str| out.lines().position(|line| line.starts_with(start)).unwrap_or_else(|| panic!("{start}: {out}"));
    assert!(line("nlos: 1 link, 0 failed") < line("all: 2 links, 0 failed"), "{out}");
    assert!(!out.contains("0 of 0 links") && !out.contains("median error -"), "{out}");
}

/// Every command that reads a side table reports a wrong one, and rows without numbers, before the work, and counts them as a loss.
#[test]
fn what_is_left_out_of_another_programs_answers_is_said_and_is_a_loss() {
    let folder = Folder::new("drawing-bad-table");
    capture(&folder, "tree/A/good", &link(300, 2.0));
    // A failed link is reported too.
    capture(&folder, "tree/A/short", &link(5, 2.0));
    let head = "capture,tx,displacement,peer_est_deg,peer_err_from_mean_pose_deg";
    let row = format!("{head}\nA/good/1,tx2,gt,30.0,x\n");
    let cases = [
        ("a,b\n1,2\n", "tree: links.csv has no column `capture`: it is skipped"),
        (row.as_str(), "tree: links.csv: 1 row without numbers skipped"),
    ];
    for (table, words) in cases {
        folder.write("tree/links.csv", table.as_bytes());
        let mut commands = vec![&["evaluate", "tree", "--plot", "p"][..]];
        commands.push(&["evaluate", "tree", "--html", "i.html", "--force"]);
        for command in commands {
            let (_, err) = folder.says(command, 3, &[]);
            assert!(err.lines().any(|line| line == words));
            assert!(err.contains("A/short/1/tx2: "), "{command:?}: {err}");
        }
        assert!(folder.0.join("p/errors.svg").is_file());
        std::fs::remove_dir_all(folder.0.join("p")).unwrap();
    }
    // Without pictures nobody asked for it.
    let (_, _, err) = folder.run(&["evaluate", "tree"]);
    assert!(!err.contains("links.csv"), "{err}");
}

#[test]
fn pictures_that_cannot_be_drawn_are_said_and_links_are_judged_all_the_same() {
    let folder = Folder::new("drawing-nowhere");
    capture(&folder, "tree/A/good", &link(300, 2.0));
    folder.write("file", b"");
    capture(&folder, "tree/A/short", &link(5, 2.0));
    let refused = "cannot write into file/p: Not a directory (os error 20); check the folder and its rights";
    let (out, _) = folder.says(&["evaluate", "tree", "--plot", "file/p"], 1, &["A/short/1/tx2: ", refused]);
    assert!(out.contains("A/good/1/tx2"), "{out}");
}

#[test]
fn a_log_that_lost_records_is_drawn_and_ends_with_3_as_its_account_does() {
    let folder = Folder::new("drawing-damaged");
    let mut log = link(300, 1.0).rx.concat();
    log.drain(20_000..20_050);
    folder.write("torn.dat", &log);
    assert_eq!(folder.run(&["info", "torn.dat", "--plot", "p"]).0, 3);
    let drawn = std::fs::read_to_string(folder.0.join("p/torn-levels.svg")).unwrap();
    assert!(drawn.contains("1 damaged stretch<") && drawn.contains("missing from bfee_count"), "{drawn}");
    folder.write("whole.dat", &link(300, 1.0).rx.concat());
    assert_eq!(folder.run(&["info", "whole.dat", "--plot", "p"]).0, 0);
}
