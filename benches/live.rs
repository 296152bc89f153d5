//! The live path, measured: sustained rate with recording, latency, CPU, and csitool's own loop for comparison.
//!
//! `cargo bench --bench live [-- SECONDS]`. Runs in a network namespace of its own (unshare(1)).
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../tests/common/mod.rs"]
mod common;
#[path = "../tests/common/private.rs"]
mod private;

use csi5300::source::recorder::{self, LogFiles, Recorder, Rotation};
use csi5300::source::{CsiSource, Next};
use csi5300::time::Span;
use csi5300_live::netlink::{Netlink, Options, Sender};
use csi5300_live::wait::Monotonic;
use driver_iface::bfee::Bfee;
use driver_iface::connector::{CN_IDX, NETLINK_CONNECTOR};
use driver_iface::record::{Record, code};
use netlink_sys::Socket;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use private::body;
use std::hint::black_box;
use std::io::Write;
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

const INSIDE: &str = "CSI5300_BENCH_INSIDE";

fn main() {
    let seconds = std::env::args().skip(1).find_map(|word| word.parse::<u64>().ok()).unwrap_or(60);
    if std::env::var_os(INSIDE).is_none() {
        // With real privileges the receive buffer may be large; in a user namespace it is capped.
        for options in ["-n", "-Urn"] {
            if Command::new("unshare").args([options, "true"]).output().is_ok_and(|out| out.status.success()) {
                let mut again = Command::new("unshare");
                again.arg(options).arg(std::env::current_exe().unwrap()).arg(seconds.to_string()).env(INSIDE, "1");
                std::process::exit(again.status().unwrap().code().unwrap_or(1));
            }
        }
        println!("skipped: no network namespace of its own can be had here");
        return;
    }
    let folder = std::env::current_dir().unwrap().join("target/bench-live");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    sustained(&folder, seconds);
    latency();
    cpu(&folder);
    stall(&folder);
    std::fs::remove_dir_all(&folder).unwrap();
}

fn listener(receive_buffer: usize) -> Netlink {
    let connector_index = Some(CN_IDX);
    let options = Options { connector_index, allow_user_sender: true, receive_buffer, ..Options::default() };
    Netlink::open(&options).unwrap()
}

/// Sends `rate` records a second for `length`, 1,000 times a second as many as are due. Gives how many.
fn send_at(rate: u64, length: Duration) -> u64 {
    let mut sender = Sender::open(CN_IDX, true).unwrap();
    let (start, mut sent) = (Instant::now(), 0_u64);
    let mut record = body(0, 3, 1, false);
    while start.elapsed() < length {
        let due = (start.elapsed().as_secs_f64() * rate as f64) as u64;
        while sent < due {
            record[4..6].copy_from_slice(&(sent as u16).to_le_bytes());
            sender.send(Record { code: code::BFEE, body: &record }).unwrap();
            sent += 1;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    sent
}

fn sustained(folder: &Path, seconds: u64) {
    let (rate, clock) = (20_000, Monotonic::new());
    let files = LogFiles::create(&folder.join("sustained.dat"), Rotation::default(), true).unwrap();
    let mut recorder = Recorder::new(listener(32 << 20), files, recorder::Options::default()).unwrap();
    let socket = recorder.source().as_fd().try_clone_to_owned().unwrap();
    let (done, cpu_from) = (AtomicBool::new(false), thread_cpu());
    let (sent, mut cpu) = std::thread::scope(|scope| {
        let sending = scope.spawn(|| {
            let sent = send_at(rate, Duration::from_secs(seconds));
            done.store(true, Ordering::Release);
            sent
        });
        loop {
            let over = done.load(Ordering::Acquire);
            if matches!(recorder.receive(clock.now()).unwrap(), Next::Pending) {
                if over {
                    break;
                }
                let soon = clock.now() + Span::from_ms(50);
                let until = recorder.next_at().map_or(soon, |at| at.min(soon));
                clock.wait([socket.as_fd()], Some(until)).unwrap();
            }
        }
        (sending.join().unwrap(), thread_cpu())
    });
    cpu -= cpu_from;
    let counters = recorder.source().counters();
    let buffer = recorder.source().receive_buffer;
    let (_, _, totals) = recorder.finish(clock.now()).unwrap();
    println!(
        "sustained: {sent} records of 3x1 sent in {seconds} s ({rate}/s), {} received, {} written, lost: {} (kernel {}, queue {}, disk {}); \
         receiving thread {:.1} % of a core; receive buffer {} KiB",
        totals.received,
        totals.written,
        sent - totals.written,
        counters.kernel_drops,
        totals.dropped,
        totals.lost_on_disk,
        100.0 * cpu / seconds as f64,
        buffer / 1024
    );
}

/// Seconds that this thread has run.
fn thread_cpu() -> f64 {
    schedstat(Path::new("/proc/thread-self/schedstat"))
}

fn schedstat(path: &Path) -> f64 {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    text.split_whitespace().next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(0.0) * 1e-9
}

fn at(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share) as usize]
}

/// `rounds` of latencies: of all, and the 99th percentile of the round in the middle. On a virtual machine whose host gives
/// its processor to others for tens of milliseconds, all are ruled by that.
fn percentiles(name: &str, mut rounds: Vec<Vec<f64>>) {
    rounds.iter_mut().for_each(|round| round.sort_by(f64::total_cmp));
    let mut p99: Vec<f64> = rounds.iter().map(|round| at(round, 0.99)).collect();
    p99.sort_by(f64::total_cmp);
    let mut us = rounds.concat();
    us.sort_by(f64::total_cmp);
    println!(
        "latency, {name}: {} records, p50 {:.1} us, p90 {:.1}, p99 {:.1}, max {:.1}; p99 of {} rounds: best {:.1}, middle {:.1}",
        us.len(),
        at(&us, 0.5),
        at(&us, 0.9),
        at(&us, 0.99),
        at(&us, 1.0),
        p99.len(),
        p99[0],
        at(&p99, 0.5)
    );
}

/// Sends `count` records, one a millisecond, each with its own time of sending in the payload.
fn send_stamped(origin: Instant, count: usize) {
    let mut sender = Sender::open(CN_IDX, true).unwrap();
    let mut record = body(0, 3, 1, false);
    for k in 0..count {
        std::thread::sleep(Duration::from_millis(1));
        record[4..6].copy_from_slice(&(k as u16).to_le_bytes());
        let at = record.len() - 8;
        record[at..].copy_from_slice(&(origin.elapsed().as_nanos() as u64).to_le_bytes());
        sender.send(Record { code: code::BFEE, body: &record }).unwrap();
    }
}

fn age_us(origin: Instant, bytes: &[u8]) -> f64 {
    let sent = u64::from_le_bytes(bytes.last_chunk().copied().unwrap());
    (origin.elapsed().as_nanos() as u64 - sent) as f64 * 1e-3
}

/// A round of each in turn, so that both meet the same weather.
fn latency() {
    let clock = Monotonic::new();
    let mut own = listener(4 << 20);
    let mut socket = Socket::new(isize::from(NETLINK_CONNECTOR.cast_signed())).unwrap();
    socket.bind_auto().unwrap();
    let (mut parsed, mut bare) = (Vec::new(), Vec::new());
    for _ in 0..10 {
        parsed.push(round_of(|origin, us| match own.receive(clock.now()).unwrap() {
            Next::Record(_, record) => {
                let bfee = Bfee::new_checked(record.body).unwrap();
                let csi = csi5300::signal::csi::Csi::from_bfee(&bfee).unwrap();
                black_box(&csi);
                us.push(age_us(origin, record.body));
            }
            _ => drop(clock.wait([own.as_fd()], None).unwrap()),
        }));
        // A member only while it is its turn: the other round's records would wait for it.
        socket.add_membership(CN_IDX).unwrap();
        let mut buffer = [0; 4096];
        bare.push(round_of(|origin, us| {
            poll(&mut [PollFd::new(socket.as_fd(), PollFlags::POLLIN)], PollTimeout::NONE).unwrap();
            let got = socket.recv(&mut &mut buffer[..], 0).unwrap();
            // 249 bytes and three of padding.
            us.push(age_us(origin, &buffer[..got - 3]));
        }));
        socket.drop_membership(CN_IDX).unwrap();
        while matches!(own.receive(clock.now()).unwrap(), Next::Record(..)) {}
    }
    percentiles("datagram sent to Csi", parsed);
    percentiles("bare poll and recv", bare);
}

/// Latencies of a thousand records, as `receive` pushes them.
fn round_of(mut receive: impl FnMut(Instant, &mut Vec<f64>)) -> Vec<f64> {
    const COUNT: usize = 1_000;
    let origin = Instant::now();
    let mut us = Vec::with_capacity(COUNT);
    std::thread::scope(|scope| {
        scope.spawn(|| send_stamped(origin, COUNT));
        while us.len() < COUNT {
            receive(origin, &mut us);
        }
    });
    us
}

/// What `csi5300 record` and a bare loop of poll and recv beside it spend on the same records, a second at a time.
fn cpu(folder: &Path) {
    let seconds = 20;
    let out = folder.join("cpu.dat");
    let mut recording = Command::new(env!("CARGO_BIN_EXE_csi5300"));
    recording.arg("record").arg(&out).args(["--allow-user-sender", "--connector-index", "26"]);
    let mut child = recording.stderr(std::process::Stdio::null()).spawn().unwrap();
    let done = AtomicBool::new(false);
    let (mut own, mut bare) = std::thread::scope(|scope| {
        let (sender, bare_thread) = std::sync::mpsc::channel();
        let done = &done;
        scope.spawn(move || {
            sender.send(std::fs::read_link("/proc/thread-self").unwrap()).unwrap();
            bare_loop(done);
        });
        let bare_file = Path::new("/proc").join(bare_thread.recv().unwrap()).join("schedstat");
        std::thread::sleep(Duration::from_millis(500));
        let tasks = PathBuf::from(format!("/proc/{}/task", child.id()));
        let spent = || -> (f64, f64) {
            let tasks = std::fs::read_dir(&tasks).unwrap().flatten();
            let own = tasks.map(|task| schedstat(&task.path().join("schedstat"))).sum();
            (own, schedstat(&bare_file))
        };
        let (mut own, mut bare) = (Vec::new(), Vec::new());
        for _ in 0..seconds {
            let from = spent();
            let start = Instant::now();
            send_at(1_000, Duration::from_secs(1));
            let (to, length) = (spent(), start.elapsed().as_secs_f64());
            own.push(100.0 * (to.0 - from.0) / length);
            bare.push(100.0 * (to.1 - from.1) / length);
        }
        done.store(true, Ordering::Release);
        (own, bare)
    });
    child.kill().unwrap();
    child.wait().unwrap();
    for (name, shares) in [("`csi5300 record`", &mut own), ("bare poll and recv beside it", &mut bare)] {
        shares.sort_by(f64::total_cmp);
        let mean = shares.iter().sum::<f64>() / shares.len() as f64;
        println!(
            "cpu at 1000/s, {seconds} times a second, {name}: least {:.2} % of a core, middle {:.2}, mean {mean:.2}",
            shares[0],
            at(shares, 0.5)
        );
    }
}

/// Receives, and nothing else.
fn bare_loop(done: &AtomicBool) {
    let mut socket = Socket::new(isize::from(NETLINK_CONNECTOR.cast_signed())).unwrap();
    socket.bind_auto().unwrap();
    socket.add_membership(CN_IDX).unwrap();
    let mut buffer = [0; 4096];
    while !done.load(Ordering::Acquire) {
        if poll(&mut [PollFd::new(socket.as_fd(), PollFlags::POLLIN)], 50_u16).unwrap() > 0 {
            black_box(socket.recv(&mut &mut buffer[..], 0).unwrap());
        }
    }
}

/// csitool's `log_to_file`, as far as its loop goes: default buffer, 4096 bytes, a line for each packet, and an end at
/// the first error. Gives the number of records written and why it stopped.
fn log_to_file(socket: &Socket, out: &Path, stall_at: u64, done: &AtomicBool) -> (u64, String) {
    let mut file = std::io::BufWriter::new(std::fs::File::create(out).unwrap());
    let mut screen = std::fs::File::create("/dev/null").unwrap();
    let mut buffer = [0; 4096];
    let mut count = 0;
    loop {
        let got = match socket.recv(&mut &mut buffer[..], 0) {
            Ok(got) => got,
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock && !done.load(Ordering::Acquire) => {
                poll(&mut [PollFd::new(socket.as_fd(), PollFlags::POLLIN)], 50_u16).unwrap();
                continue;
            }
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {
                return (count, "everything was read".into());
            }
            Err(error) => return (count, error.to_string()),
        };
        let length = u16::from_le_bytes([buffer[32], buffer[33]]);
        file.write_all(&length.to_be_bytes()).unwrap();
        file.write_all(&buffer[36..36 + usize::from(length)]).unwrap();
        count += 1;
        writeln!(screen, "wrote {got} bytes [msgcnt={count}]").unwrap();
        if count == stall_at {
            std::thread::sleep(Duration::from_millis(500));
        }
    }
}

/// Both loops with one stall of half a second at 2,000 records a second.
fn stall(folder: &Path) {
    let (rate, length, stall_at) = (2_000, Duration::from_secs(3), 1_000);
    let mut socket = Socket::new(isize::from(NETLINK_CONNECTOR.cast_signed())).unwrap();
    socket.bind_auto().unwrap();
    socket.add_membership(CN_IDX).unwrap();
    socket.set_non_blocking(true).unwrap();
    let done = AtomicBool::new(false);
    let (sent, (kept, why)) = std::thread::scope(|scope| {
        let sending = scope.spawn(|| {
            let sent = send_at(rate, length);
            done.store(true, Ordering::Release);
            sent
        });
        let kept = log_to_file(&socket, &folder.join("stall.dat"), stall_at, &done);
        (sending.join().unwrap(), kept)
    });
    println!("stall of 0.5 s at {rate}/s, loop of log_to_file: {kept} of {sent} records, stopped by: {why}");
    drop(socket);

    let clock = Monotonic::new();
    let mut own = listener(106_496);
    let buffer = own.receive_buffer / 1024;
    done.store(false, Ordering::Release);
    let (sent, kept) = std::thread::scope(|scope| {
        let sending = scope.spawn(|| {
            let sent = send_at(rate, length);
            done.store(true, Ordering::Release);
            sent
        });
        let mut kept = 0;
        loop {
            let over = done.load(Ordering::Acquire);
            match own.receive(clock.now()).unwrap() {
                Next::Record(..) => {
                    kept += 1;
                    if kept == stall_at {
                        std::thread::sleep(Duration::from_millis(500));
                    }
                }
                Next::Pending if over => break,
                Next::Pending => {
                    clock.wait([own.as_fd()], Some(clock.now() + Span::from_ms(50))).unwrap();
                }
                _ => {}
            }
        }
        (sending.join().unwrap(), kept)
    });
    let counters = own.counters();
    println!(
        "stall of 0.5 s at {rate}/s, this listener with the same buffer ({buffer} KiB): {kept} of {sent} records, {} overruns, \
         {} dropped by the kernel, bfee_count gap {}",
        counters.overruns, counters.kernel_drops, counters.overrun_bfee_gap
    );
}
