//! `csi5300 record` under bad treatment: what is on disk is always a readable log, and what it says is lost is lost. And `view` until a
//! signal comes.

use crate::air::Program;
use crate::commands::Folder;
use crate::private::{queued_bytes, send, send_gently};
use csi5300::source::replay::Replay;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;
use csi5300_live::netlink::Sender;
use driver_iface::bfee::Bfee;
use driver_iface::connector::CN_IDX;
use driver_iface::record::Tail;
use nix::sys::signal::Signal;
use std::path::Path;
use std::process::{Command, Stdio};

/// A `csi5300 record` that is already listening.
fn record(out: &Path, more: &[&str]) -> Program {
    record_by("exec", out, more)
}

/// By these words of the shell, which stand before the program.
fn record_by(shell: &str, out: &Path, more: &[&str]) -> Program {
    let mut command = Command::new("sh");
    command.args(["-c", &format!("{shell} \"$0\" \"$@\""), env!("CARGO_BIN_EXE_csi5300")]);
    command.arg("record").arg(out).args(["--allow-user-sender", "--connector-index", "26"]).args(more);
    let mut program = Program::of(command.stdout(Stdio::piped()));
    program.until("\n");
    assert!(program.said.starts_with("listening on connector index 26 (as given)"), "{}", program.said);
    program.said.clear();
    program
}

/// Stops it, and waits until the kernel reports it as stopped: on a busy processor a signal takes effect later.
fn halt(program: &Program) {
    program.signal(Signal::SIGSTOP);
    while state(program) != 'T' {
        std::thread::yield_now();
    }
}

/// What its receiving thread does: R, runs or would; S, waits; T, is stopped.
fn state(program: &Program) -> char {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", program.child.id())).unwrap();
    stat.rsplit_once(") ").unwrap().1.chars().next().unwrap()
}

/// Waits until it has read everything, and waits for more: only then the kernel drops nothing more.
fn wait_for_rest(program: &Program) {
    while queued_bytes() > 0 || state(program) != 'S' {
        std::thread::yield_now();
    }
}

/// Waits until the log has at least this many bytes.
fn wait_for_bytes(out: &Path, bytes: u64) {
    while std::fs::metadata(out).map_or(0, |about| about.len()) < bytes {
        std::thread::yield_now();
    }
}

/// The `bfee_count`s in a log that is being written.
fn read_so_far(log: &Path) -> Vec<u16> {
    if std::fs::metadata(log).unwrap().len() == 0 { Vec::new() } else { read(log).0 }
}

/// The `bfee_count`s in a log, how it ends, and how many records have a host time.
fn read(log: &Path) -> (Vec<u16>, Tail, usize) {
    let mut replay = Replay::open(log).unwrap();
    let (mut counts, mut stamped) = (Vec::new(), 0);
    loop {
        match replay.receive(Instant::ZERO).unwrap() {
            Next::Record(stamps, record) => {
                counts.push(Bfee::new_checked(record.body).unwrap().bfee_count());
                stamped += usize::from(stamps.host_us.is_some());
            }
            Next::End(tail) => return (counts, tail, stamped),
            other => panic!("{}: {other:?}", log.display()),
        }
    }
}

const RECORD: u64 = 2 + 213;

#[test]
fn a_signal_ends_the_log_whole() {
    let Some(folder) = Folder::inside(a_signal_ends_the_log_whole, "-Urn", "recording-signals") else { return };
    // Tests may run with SIGHUP ignored (`nohup`), and programs that they start with them.
    let env = Command::new("env").args(["--default-signal", "true"]).output();
    let hangup = env.is_ok_and(|output| output.status.success()).then_some(Signal::SIGHUP);
    if hangup.is_none() {
        crate::common::skipped("`env --default-signal` is not there (coreutils 8.31)");
    }
    for signal in [Signal::SIGINT, Signal::SIGTERM].into_iter().chain(hangup) {
        let out = folder.0.join(format!("{signal}.dat"));
        let shell = if hangup == Some(signal) { "exec env --default-signal=HUP" } else { "exec" };
        let running = record_by(shell, &out, &[]);
        let mut sender = Sender::open(CN_IDX, true).unwrap();
        send_gently(&mut sender, 0..1_400);
        // These are still in its socket when the signal comes, or not: it reads them before it ends.
        send(&mut sender, 1_400..1_500);
        let (status, said) = running.end_by(signal);
        assert_eq!(status, Some(0), "{said}");
        assert!(said.contains("1500 records written"), "{said}");
        let (counts, tail, stamped) = read(&out);
        assert_eq!(counts, (0..1_500).collect::<Vec<_>>());
        assert_eq!((tail, stamped), (Tail::Clean, 1_500));
    }
    // A recording that was started to ignore a hangup goes on: had it ended it, the rest would be missing.
    let running = record_by("trap '' HUP; exec", &folder.0.join("log.dat"), &[]);
    let mut sender = Sender::open(CN_IDX, true).unwrap();
    send_gently(&mut sender, 0..100);
    running.signal(Signal::SIGHUP);
    send_gently(&mut sender, 100..1_500);
    let (status, said) = running.end_by(Signal::SIGTERM);
    assert!(status == Some(0) && said.contains("1500 records written"), "{said}");
}

#[test]
fn a_kill_at_any_moment_leaves_a_readable_log() {
    let Some(folder) = Folder::inside(a_kill_at_any_moment_leaves_a_readable_log, "-Urn", "recording-kill") else {
        return;
    };
    let mut sender = Sender::open(CN_IDX, true).unwrap();
    for round in 0..12_u16 {
        let out = folder.0.join(format!("{round}.dat"));
        let mut running = record(&out, &["--sync-every", "20ms"]);
        // The moment is somewhere in the middle of the writing, another one each time.
        send_gently(&mut sender, 0..4_000 + round * 997);
        running.signal(Signal::SIGKILL);
        running.child.wait().unwrap();
        let (counts, tail, stamped) = read(&out);
        assert_eq!(counts, (0..counts.len() as u16).collect::<Vec<_>>(), "round {round}");
        assert!(stamped <= counts.len());
        if let Tail::Cut { offset, .. } = tail {
            assert_eq!(offset, counts.len() as u64 * RECORD);
        }
    }
}

#[test]
fn a_full_disk_is_counted_loss() {
    let Some(folder) = Folder::inside(a_full_disk_is_counted_loss, "-Urnm", "recording-full") else { return };
    let Some(disk) = folder.mount("", "256k") else { return };
    let out = disk.join("out.dat");
    // 240 KiB for the data leaves room for less than half; the side file takes its share.
    overfill(record(&out, &[]), &out, 200_000, "No space left");
}

/// Sends a recorder more than the disk takes, which is full after this many bytes of log or some more: what is refused is counted.
fn overfill(running: Program, out: &Path, bytes: u64, why: &str) {
    let mut sender = Sender::open(CN_IDX, true).unwrap();
    send_gently(&mut sender, 0..3_000);
    wait_for_bytes(out, bytes);
    let (status, said) = running.end_by(Signal::SIGTERM);
    assert_eq!(status, Some(3), "{said}");
    let (counts, tail, stamped) = read(out);
    assert_eq!(tail, Tail::Clean, "{said}");
    assert!(counts.is_sorted_by(|a, b| a < b));
    let kept = counts.len();
    assert!(stamped <= kept && kept < 3_000);
    assert!(said.contains(&format!("{kept} records written")), "{said}");
    let lost = format!("{} that it refused", 3_000 - kept);
    assert!(said.contains(&lost) && said.contains(why), "expected {lost}:\n{said}");
}

/// `ulimit -f`, in blocks of 512 or 1,024 bytes by the shell.
#[test]
fn a_limit_of_file_sizes_is_a_full_disk_and_ends_nothing() {
    let Some(folder) = Folder::inside(a_limit_of_file_sizes_is_a_full_disk_and_ends_nothing, "-Urn", "recording-limit")
    else {
        return;
    };
    let out = folder.0.join("out.dat");
    overfill(record_by("ulimit -f 100; exec", &out, &[]), &out, 40_000, "File too large");
}

#[test]
fn a_stopped_recorder_reports_what_it_missed() {
    let Some(folder) = Folder::inside(a_stopped_recorder_reports_what_it_missed, "-Urn", "recording-stopped") else {
        return;
    };
    let out = folder.0.join("out.dat");
    let running = record(&out, &["--receive-buffer", "64k"]);
    let mut sender = Sender::open(CN_IDX, true).unwrap();
    halt(&running);
    send(&mut sender, 0..5_000);
    running.signal(Signal::SIGCONT);
    // It has recovered when something sent later arrives.
    wait_for_rest(&running);
    send(&mut sender, 5_000..5_001);
    while read_so_far(&out).last().is_none_or(|&count| count < 5_000) {
        std::thread::yield_now();
    }
    let (status, said) = running.end_by(Signal::SIGTERM);
    assert_eq!(status, Some(3), "{said}");
    let (counts, tail, _) = read(&out);
    assert_eq!(tail, Tail::Clean);
    let gaps: u64 = counts.windows(2).map(|pair| u64::from(pair[1] - pair[0] - 1)).sum();
    // However often its queue overran: each overrun is told on a line of its own.
    let told: Vec<u64> = said
        .lines()
        .filter_map(|line| line.strip_prefix("overrun: the kernel dropped ")?.split(' ').next()?.parse().ok())
        .collect();
    assert!(!told.is_empty(), "no overrun told:\n{said}");
    let told: u64 = told.iter().sum();
    assert!(gaps > 0 && counts.first() == Some(&0));
    assert!(said.contains(&format!("bfee_count has gaps of {gaps}")), "{gaps} in the log:\n{said}");
    assert!(told >= gaps.saturating_sub(1), "{told} told, {gaps} missing:\n{said}");
}

#[test]
fn a_recording_of_nothing_leaves_nothing() {
    let Some(folder) = Folder::inside(a_recording_of_nothing_leaves_nothing, "-Urn", "recording-nothing") else {
        return;
    };
    let out = folder.0.join("out.dat");
    for _ in 0..2 {
        // The second try finds nothing in its way.
        let (status, said) = record(&out, &[]).end_by(Signal::SIGINT);
        assert_eq!(status, Some(1), "{said}");
        assert!(said.contains("nothing came: `csi5300 doctor") && said.contains("nothing to write: no "), "{said}");
        assert_eq!(std::fs::read_dir(&folder.0).unwrap().count(), 0, "{said}");
    }
    // An earlier one stays.
    std::fs::write(&out, "earlier").unwrap();
    let (status, said) = record(&out, &["--force"]).end_by(Signal::SIGINT);
    assert_eq!(status, Some(1), "{said}");
    assert_eq!((std::fs::read(&out).unwrap(), std::fs::read_dir(&folder.0).unwrap().count()), (b"earlier".to_vec(), 1));
}

#[test]
fn a_replayed_log_arrives_through_the_kernel() {
    let Some(folder) = Folder::inside(a_replayed_log_arrives_through_the_kernel, "-Urn", "recording-replay") else {
        return;
    };
    let (first, second) = (folder.0.join("a.dat"), folder.0.join("b.dat"));
    let mut running = record(&first, &["--stop-after", "300records"]);
    send(&mut Sender::open(CN_IDX, true).unwrap(), 0..300);
    assert!(running.child.wait().unwrap().success());
    let mut running = record(&second, &["--stop-after", "300records", "--json"]);
    let mut replay = Command::new(env!("CARGO_BIN_EXE_csi5300"));
    let replay = replay.arg("replay").arg(&first).args(["--speed", "max", "--connector", "--json"]).output().unwrap();
    assert!(replay.status.success(), "{}", String::from_utf8_lossy(&replay.stderr));
    let said = String::from_utf8(replay.stdout).unwrap();
    let row = crate::commands::json(&said);
    assert_eq!((row["records"].as_u64(), row["cut"].as_bool()), (Some(300), Some(false)), "{said}");
    assert!(crate::documented::are_documented(&said) >= 7);
    assert!(running.child.wait().unwrap().success());
    let said = running.output();
    assert_eq!(crate::commands::json(&said)["records"], 300, "{said}");
    assert!(crate::documented::are_documented(&said) >= 7, "{said}");
    assert_eq!(std::fs::read(&first).unwrap(), std::fs::read(&second).unwrap());
}

#[test]
fn a_log_that_its_target_does_not_take_is_not_played() {
    let folder = Folder::new("replay-full");
    // Less than is written at once.
    folder.write("rx.dat", &crate::common::link(2, 1.0).rx.concat());
    for (target, speed, status) in
        [("/dev/full", "max", 3), ("/dev/full", "1", 3), ("closed", "max", 0), ("closed", "1", 0)]
    {
        let mut replay = Command::new(env!("CARGO_BIN_EXE_csi5300"));
        replay.args(["replay", "rx.dat", "--speed", speed]).current_dir(&folder.0);
        match target {
            "closed" => replay.stdout(std::io::pipe().unwrap().1),
            _ => replay.stdout(std::fs::OpenOptions::new().write(true).open(target).unwrap()),
        };
        let output = replay.output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(status), "{target} {speed}: {said}");
        assert_eq!(said.contains("standard output: No space left"), status == 3, "{target} {speed}: {said}");
    }
}

#[test]
fn a_signal_ends_the_page_as_it_ends_a_recording() {
    let folder = Folder::new("view-signals");
    folder.write("rx.dat", &crate::common::link(100, 1.0).rx.concat());
    for signal in [Signal::SIGTERM, Signal::SIGINT, Signal::SIGHUP] {
        let Some(mut command) = crate::common::with_usual_signals(env!("CARGO_BIN_EXE_csi5300")) else { return };
        command.arg("view").arg(folder.0.join("rx.dat")).stdout(Stdio::piped());
        let mut page = Program::of(&mut command);
        // An answer comes from a server that has begun, and with it its signals.
        let place = crate::cards::place(&mut page);
        crate::cards::get(&place, "/data/overview");
        page.signal(signal);
        assert_eq!(page.child.wait().unwrap().code(), Some(0), "{signal}");
    }
}

#[test]
fn a_pipe_is_no_log_for_the_page() {
    let folder = Folder::new("view-pipe");
    let made = Command::new("mkfifo").arg(folder.0.join("p.dat")).status();
    assert!(made.is_ok_and(|status| status.success()), "mkfifo");
    folder.says(&["view", "p.dat"], 1, &["p.dat is a pipe or a device"]);
}
