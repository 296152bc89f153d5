//! The live path, measured: sustained rate with recording, latency, CPU, and csitool's own loop for comparison.
//!
//! `cargo bench --bench live [-- SECONDS]`. Runs in a network namespace of its own (unshare(1)).
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../tests/common/private.rs"]
mod private;

use csi5300::backend::netlink::{Netlink, Options, Sender};
use csi5300::backend::recorder::{self, LogFiles, Recorder, Rotation};
use csi5300::backend::{CsiSource, Next};
use csi5300::time::Span;
use csi5300::wait::{Monotonic, wall_us};
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
    let options = Options { connector_index: Some(CN_IDX), allow_user_sender: true, receive_buffer, wall_us };
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
    let buffer = recorder.source().receive_buffer();
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

fn percentiles(name: &str, mut us: Vec<f64>) {
    us.sort_by(f64::total_cmp);
    let at = |share: f64| us[((us.len() - 1) as f64 * share) as usize];
    println!(
        "latency, {name}: {} records, p50 {:.1} us, p90 {:.1}, p99 {:.1}, max {:.1}",
        us.len(),
        at(0.5),
        at(0.9),
        at(0.99),
        at(1.0)
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

fn latency() {
    const COUNT: usize = 10_000;
    let origin = Instant::now();
    let clock = Monotonic::new();
    let mut own = listener(4 << 20);
    let mut us = Vec::with_capacity(COUNT);
    std::thread::scope(|scope| {
        scope.spawn(|| send_stamped(origin, COUNT));
        while us.len() < COUNT {
            match own.receive(clock.now()).unwrap() {
                Next::Record(_, record) => {
                    let bfee = Bfee::new_checked(record.body).unwrap();
                    let csi = csi5300::csi::Csi::from_bfee(&bfee).unwrap();
                    black_box(&csi);
                    us.push(age_us(origin, record.body));
                }
                _ => drop(clock.wait([own.as_fd()], None).unwrap()),
            }
        }
    });
    percentiles("datagram sent to Csi", us);
    drop(own);

    let mut socket = Socket::new(isize::from(NETLINK_CONNECTOR.cast_signed())).unwrap();
    socket.bind_auto().unwrap();
    socket.add_membership(CN_IDX).unwrap();
    let mut buffer = [0; 4096];
    let mut us = Vec::with_capacity(COUNT);
    std::thread::scope(|scope| {
        scope.spawn(|| send_stamped(origin, COUNT));
        while us.len() < COUNT {
            poll(&mut [PollFd::new(socket.as_fd(), PollFlags::POLLIN)], PollTimeout::NONE).unwrap();
            let got = socket.recv(&mut &mut buffer[..], 0).unwrap();
            // 249 bytes and three of padding.
            us.push(age_us(origin, &buffer[..got - 3]));
        }
    });
    percentiles("bare poll and recv", us);
}

fn cpu(folder: &Path) {
    let seconds = 10;
    let out = folder.join("cpu.dat");
    let mut recording = Command::new(env!("CARGO_BIN_EXE_csi5300"));
    recording.arg("record").arg(&out).args(["--allow-user-sender", "--connector-index", "26"]);
    let mut child = recording.stderr(std::process::Stdio::null()).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(500));
    let tasks = PathBuf::from(format!("/proc/{}/task", child.id()));
    let spent = || -> f64 {
        let tasks = std::fs::read_dir(&tasks).unwrap().flatten();
        tasks.map(|task| schedstat(&task.path().join("schedstat"))).sum()
    };
    let from = spent();
    let sent = send_at(1_000, Duration::from_secs(seconds));
    let used = spent() - from;
    child.kill().unwrap();
    child.wait().unwrap();
    println!("cpu: `csi5300 record` at 1000/s ({sent} records): {:.2} % of a core", 100.0 * used / seconds as f64);
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
    let buffer = own.receive_buffer() / 1024;
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
