//! How late the sender's thread is: `csi5300 sound` at 1,000 rounds/s on a stand-in for a monitor interface, answered by
//! the same program on another one, with SCHED_FIFO and without.
//!
//! `cargo bench --bench lateness` as root (or `-- --seconds 10`). The stand-ins are TUN devices with the radiotap link
//! type in a network namespace of their own; what they show is the host's scheduling, not the air. SCHED_FIFO needs real
//! root: in a user namespace it is refused, and said to be. Before and after each a bare loop of `clock_nanosleep` shows
//! what this host does at best in these very minutes.

use csi5300::exchange::tdma::{Epoch, Request};
use csi5300::time::Span;
use csi5300_live::monitor::Monitor;
use csi5300_live::sounding::{News, Running, Settings, Setup, spread_of};
use csi5300_live::sys::{radiotap_tun, schedule_fifo};
use csi5300_live::wait::Monotonic;
use driver_iface::Mac;
use hdrhistogram::Histogram;
use nix::sys::time::{TimeSpec, TimeValLike};
use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};
use std::fs::File;
use std::io::{Read, Write};
use std::process::Command;

const MACS: [Mac; 2] = [Mac([2, 0, 0, 0, 0, 1]), Mac([2, 0, 0, 0, 0, 2])];
/// Set in the namespace.
const INSIDE: &str = "CSI5300_BENCH_NAMESPACE";

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    if std::env::var_os(INSIDE).is_none() {
        // A user namespace of its own only where it must be: SCHED_FIFO is refused there.
        let is_root = Command::new("unshare").args(["-n", "true"]).status().is_ok_and(|status| status.success());
        let options = if is_root { "-n" } else { "-Urn" };
        let own = std::env::current_exe()?;
        let status = Command::new("unshare").arg(options).arg(own).args(&arguments).env(INSIDE, "1").status()?;
        std::process::exit(status.code().unwrap_or(1));
    }
    let seconds = match arguments.iter().position(|argument| argument == "--seconds") {
        Some(at) => arguments.get(at + 1).ok_or("--seconds N")?.parse::<f64>()?,
        None => 60.0,
    };
    let devices = [radiotap_tun("mona", 2_304)?, radiotap_tun("monb", 2_304)?];
    let [a, b] = devices.map(|device| device.try_clone().map(|copy| (device, copy)));
    let ((a_in, a_out), (b_in, b_out)) = (a?, b?);
    std::thread::spawn(move || carry(a_in, b_out));
    std::thread::spawn(move || carry(b_in, a_out));
    println!("1,000 rounds/s for {seconds} s; slots may start 50 us late at most, later ones are skipped");
    for fifo_priority in [Some(50), None] {
        println!("\n{}", if fifo_priority.is_some() { "SCHED_FIFO" } else { "the ordinary scheduler" });
        println!("  bare loop before            {}", spread_of(&bare(fifo_priority, 10_000)?));
        run(fifo_priority, seconds)?;
        println!("  bare loop after             {}", spread_of(&bare(fifo_priority, 10_000)?));
    }
    Ok(())
}

/// How late `clock_nanosleep` returns, once a millisecond, in a thread that does nothing else.
fn bare(fifo_priority: Option<i32>, times: i64) -> Result<Histogram<u64>, Failure> {
    let mut late_us = Histogram::new(3)?;
    let waiting = move || -> Result<Histogram<u64>, nix::Error> {
        if let Some(priority) = fifo_priority
            && schedule_fifo(priority).is_err()
        {
            eprintln!("the bare loop runs under the ordinary scheduler");
        }
        let clock = ClockId::CLOCK_MONOTONIC;
        let start = clock_gettime(clock)?;
        for k in 1..=times {
            let at = start + TimeSpec::milliseconds(k);
            clock_nanosleep(clock, ClockNanosleepFlags::TIMER_ABSTIME, &at)?;
            late_us.saturating_record((clock_gettime(clock)? - at).num_microseconds().unsigned_abs());
        }
        Ok(late_us)
    };
    Ok(std::thread::spawn(waiting).join().map_err(|_| "the bare loop ended early")??)
}

/// The air: what is sent on one device is received on the other, with an empty radiotap header instead of the sender's.
/// An ordinary thread: the air must not take the processor from the threads that are measured.
fn carry(mut from: File, mut to: File) {
    let mut buffer = [0; 4_096];
    while let Ok(len) = from.read(&mut buffer) {
        let header = usize::from(buffer[6]);
        if buffer[4] == 0 && header == 13 && len > 4 + header {
            let packet = [&[0, 0, 0, 4, 0, 0, 8, 0, 0, 0, 0, 0][..], &buffer[4 + header..len]].concat();
            let _ = to.write_all(&packet);
        }
    }
}

fn robot(own: usize, interface: &str, fifo_priority: Option<i32>, clock: Monotonic) -> Result<Running, Failure> {
    let setup = Setup {
        interface: interface.into(),
        mac: Some(MACS[own]),
        peers: vec![MACS[1 - own]],
        request: Request::new(1, 1_000.0),
        own_index: 0,
        key: None,
    };
    let now = clock.now();
    let opened = setup.open_on(Monitor::open(&setup.options())?, |config| {
        (config.initiate, config.epoch) = (own == 0, Epoch::Heard(now));
        (config.start, config.open_loop, config.silence_slots) = (now, true, 2);
    })?;
    Ok(Running::start(opened, clock, Settings { fifo_priority, ..Settings::default() })?)
}

fn run(fifo_priority: Option<i32>, seconds: f64) -> Result<(), Failure> {
    let clock = Monotonic::new();
    let responder = robot(1, "monb", fifo_priority, clock)?;
    let initiator = robot(0, "mona", fifo_priority, clock)?;
    let end = clock.now() + Span::from_s(seconds);
    let mut granted = String::new();
    while clock.now() < end {
        for robot in [&initiator, &responder] {
            while let Some(news) = robot.news() {
                if let News::Started(said) = news {
                    granted = said;
                }
            }
        }
        clock.sleep_until(end.min(clock.now() + Span::from_ms(100)));
    }
    let (initiator, ..) = initiator.stop()?;
    let (responder, ..) = responder.stop()?;
    let (counts, figures) = (initiator.tdma.counts(), &initiator.figures);
    println!("\n{granted}");
    println!("  {} sent, {} answered", counts.forward, counts.answered);
    println!("  {} skipped, {} perhaps late", counts.missed_slots + figures.too_late, figures.perhaps_late);
    println!("  lateness of every due slot  {}", spread_of(&figures.due_us));
    println!("  lateness of frames sent     {}", spread_of(&figures.lateness_us));
    println!("  turn-around                 {}", spread_of(&responder.figures.turn_around_us));
    println!("  answers skipped as late     {}", responder.tdma.counts().missed_replies);
    println!("  answer began after          {}", spread_of(&figures.answer_us));
    Ok(())
}
