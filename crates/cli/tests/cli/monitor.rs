//! The monitor interface on TUN devices with the radiotap link type, in a network namespace of its own: bytes that go
//! out, bytes that come in, and every refusal.

use crate::air::Program;
use crate::private::inside;
use csi5300::internal::FrameReceiver;
use csi5300::source::{Error, Injector, NotSent};
use csi5300::time::{Instant, Span};
use csi5300_live::monitor::{Monitor, Options};
use csi5300_live::sys::{radiotap_tun, set_up};
use csi5300_live::wait::{Monotonic, wall_us};
use driver_iface::Mac;
use driver_iface::radiotap::{Bandwidth, Repr, TX_FLAGS_FAIL};
use driver_iface::sounding::native;
use driver_iface::sounding::wsr::{self, Lfsr};
use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::process::{Command, Stdio};

/// Flags and protocol before every packet of a TUN device.
const BEFORE: [u8; 4] = [0, 0, 0, 4];
const A: Mac = Mac([2, 0, 0, 0, 0, 0xa]);

/// A stand-in for a monitor interface; `None`, said, where there is no /dev/net/tun to be had.
fn tun(name: &str, mtu: usize) -> Option<File> {
    match radiotap_tun(name, mtu) {
        Ok(tun) => Some(tun),
        Err(error) => {
            crate::common::skipped(&format!("no TUN device: {error}"));
            None
        }
    }
}

/// One for this test in a network namespace of its own.
fn apart<T>(_: T, name: &str, mtu: usize) -> Option<File> {
    if inside(std::any::type_name::<T>(), "-Urn") { tun(name, mtu) } else { None }
}

/// Without a clock no frame is old, however late a busy machine reads it.
fn options(interface: &str) -> Options {
    Options { mcs: 1, wall_us: || None, ..Options::new(interface, native::MAX_LEN) }
}

/// Nothing here takes that long; a robot that has died is not waited for.
const LONGEST: Span = Span::from_ms(3_000_000);

/// The next packet sent to the device that is behind a radiotap header (IPv6 has its say too).
fn sent(tun: &mut File) -> Vec<u8> {
    let (clock, mut buffer) = (Monotonic::new(), [0; 4_096]);
    loop {
        assert_eq!(clock.wait([tun.as_fd()], Some(clock.now() + LONGEST)).unwrap(), [true], "nobody sends");
        let len = tun.read(&mut buffer).unwrap();
        if buffer[4..8] == [0, 0, 13, 0] {
            return buffer[4..len].to_vec();
        }
    }
}

/// Puts a packet on the device as if it had been received.
fn receive(tun: &mut File, packet: &[u8]) {
    tun.write_all(&[&BEFORE, packet].concat()).unwrap();
}

fn behind(header: &Repr, frame: &[u8]) -> Vec<u8> {
    let mut packet = vec![0; header.header_len()];
    header.emit(&mut packet).unwrap();
    packet.extend(frame);
    packet
}

fn frame(number: u32, len_with_fcs: usize) -> Vec<u8> {
    let mut frame = vec![0; len_with_fcs];
    let repr = wsr::Repr { sender: A, number, len_with_fcs };
    let len = repr.emit(&mut frame, &mut Lfsr::default()).unwrap();
    frame.truncate(len);
    frame
}

fn hear(monitor: &mut Monitor) -> Option<Vec<u8>> {
    monitor.hear().unwrap().map(|heard| heard.frame.to_vec())
}

#[test]
fn frames_go_out_byte_for_byte_behind_their_radiotap_header() {
    let Some(mut tun) = apart(frames_go_out_byte_for_byte_behind_their_radiotap_header, "mon0", 2_304) else { return };
    for (mcs, bandwidth, width) in [(1, Bandwidth::Ht20, 0), (7, Bandwidth::Ht40, 1)] {
        let mut monitor = Monitor::open(&Options { mcs, bandwidth, ..options("mon0") }).unwrap();
        for len in [57, 59, 61, 120] {
            let frame = frame(7, len);
            monitor.inject(Instant::ZERO, &frame).unwrap();
            // Version 0, 13 bytes, TX flags and MCS present; no acknowledgement; bandwidth, index, guard, FEC, STBC known.
            let header = [0, 0, 13, 0, 0, 0x80, 0x08, 0, 0x08, 0, 0x37, width, mcs];
            assert_eq!(sent(&mut tun), [&header[..], &frame].concat());
        }
        assert_eq!((monitor.counters().taken, monitor.counters().not_taken()), (4, 0));
        assert_eq!(hear(&mut monitor), None, "the socket's filter keeps own copies out");
        assert_eq!(monitor.counters().outgoing, 0);
    }
}

#[test]
fn sounding_frames_come_in_and_nothing_else() {
    let Some(mut tun) = apart(sounding_frames_come_in_and_nothing_else, "mon0", 2_304) else { return };
    let mut monitor = Monitor::open(&options("mon0")).unwrap();
    let good = frame(1, 57);
    let mut other = good.clone();
    other[4] ^= 1;
    let received = Repr { flags: Some(0), ..Repr::default() };
    let with_fcs = [&good[..], &[1, 2, 3, 4]].concat();
    let fcs = |flags| Repr { flags: Some(flags), ..received };
    let packets = [
        behind(&received, &other),
        behind(&fcs(0x50), &with_fcs),
        behind(&Repr { tx_flags: Some(0), ..Repr::default() }, &good),
        behind(&Repr { tx_flags: Some(TX_FLAGS_FAIL), data_retries: Some(0), ..Repr::default() }, &good),
        behind(&fcs(0x10), &with_fcs),
        behind(&received, &good),
        // A header that announces a field which it does not hold.
        [&[0, 0, 8, 0, 1, 0, 0, 0][..], &good].concat(),
        [&[0; 8][..], &good].concat(),
        vec![0; 3],
        behind(&received, &frame(2, 59)),
    ];
    packets.iter().for_each(|packet| receive(&mut tun, packet));
    let heard: Vec<_> = std::iter::from_fn(|| hear(&mut monitor)).collect();
    assert_eq!(heard, [good.clone(), good, frame(2, 59)]);
    let counters = monitor.counters();
    assert_eq!((counters.heard, counters.bad_fcs, counters.damaged), (3, 1, 1), "{counters:?}");
    assert_eq!((counters.tx_status, counters.tx_failed, counters.dropped), (2, 1, 0));
    assert_eq!((monitor.sent_for_certain(), monitor.failed_for_certain()), (Some(1), 1));
}

#[test]
fn frames_that_lay_in_the_queue_for_too_long_are_dropped_and_counted() {
    let Some(mut tun) = apart(frames_that_lay_in_the_queue_for_too_long_are_dropped_and_counted, "mon0", 2_304) else {
        return;
    };
    // A host that comes to its frames an hour after they were stamped.
    let later = || wall_us().map(|us| us + 3_600_000_000);
    let mut monitor = Monitor::open(&Options { wall_us: later, ..options("mon0") }).unwrap();
    (1..=3).for_each(|number| receive(&mut tun, &behind(&Repr::default(), &frame(number, 57))));
    assert_eq!(hear(&mut monitor), None);
    assert_eq!((monitor.counters().stale, monitor.counters().heard), (3, 0));
}

#[test]
fn frames_that_are_not_fetched_are_dropped_by_the_kernel_and_counted() {
    let Some(mut tun) = apart(frames_that_are_not_fetched_are_dropped_by_the_kernel_and_counted, "mon0", 2_304) else {
        return;
    };
    let mut monitor = Monitor::open(&options("mon0")).unwrap();
    for number in 1..=5_000 {
        receive(&mut tun, &behind(&Repr::default(), &frame(number, 57)));
    }
    let heard = std::iter::from_fn(|| hear(&mut monitor)).count() as u64;
    let dropped = monitor.counters().dropped;
    assert!(dropped > 0 && heard + dropped == 5_000, "{heard} heard, {dropped} dropped");
    assert_eq!(monitor.counters().dropped, dropped, "each is counted once");
}

#[test]
fn what_the_kernel_does_not_take_is_said_and_counted_and_sending_goes_on() {
    let Some(mut tun) = apart(what_the_kernel_does_not_take_is_said_and_counted_and_sending_goes_on, "mon0", 200)
    else {
        return;
    };
    let mut monitor = Monitor::open(&options("mon0")).unwrap();
    let not_sent = |result: Result<(), Error>| match result {
        Err(Error::NotSent(why)) => why,
        other => panic!("{other:?}"),
    };
    let too_long = vec![0; native::MAX_LEN + 1];
    assert!(matches!(not_sent(monitor.inject(Instant::ZERO, &too_long)), NotSent::TooLong { .. }));
    set_up("mon0", false).unwrap();
    assert_eq!(not_sent(monitor.inject(Instant::ZERO, &frame(1, 57))), NotSent::Down);
    assert_eq!(hear(&mut monitor), None);
    set_up("mon0", true).unwrap();
    assert!(monitor.inject(Instant::ZERO, &frame(2, 57)).is_ok());
    assert_eq!(sent(&mut tun)[13..], frame(2, 57));
    receive(&mut tun, &behind(&Repr::default(), &frame(3, 57)));
    assert_eq!(hear(&mut monitor), Some(frame(3, 57)));
    let counters = monitor.counters();
    assert_eq!((counters.taken, counters.down, counters.too_long, counters.not_taken()), (1, 1, 1, 2));
    drop(tun);
    let gone = monitor.inject(Instant::ZERO, &frame(5, 57)).unwrap_err().to_string();
    assert!(gone.contains("mon0") && gone.contains("gone"), "{gone}");
}

#[test]
fn refusals_say_what_to_do() {
    if !inside(concat!(module_path!(), "::refusals_say_what_to_do"), "-Urn") {
        return;
    }
    let refused = |options: &Options| Monitor::open(options).unwrap_err().to_string();
    assert!(refused(&options("mon7")).contains("no interface mon7"));
    set_up("lo", true).unwrap();
    let said = refused(&options("lo"));
    assert!(said.contains("link type 772") && said.contains("set type monitor"), "{said}");
    let Some(_tun) = tun("mon0", 100) else { return };
    let said = refused(&options("mon0"));
    assert!(said.contains("100 bytes at most") && said.contains("mtu 2304"), "{said}");
    assert!(Monitor::open(&Options { mcs: 1, ..Options::new("mon0", 57) }).is_ok());
    set_up("mon0", false).unwrap();
    let said = refused(&options("mon0"));
    assert!(said.contains("mon0 is down") && said.contains("ip link set mon0 up"), "{said}");
}

#[test]
fn a_missing_capability_is_reported_with_its_remedy() {
    // Without -r the user is mapped to nobody, and exec takes the new namespace's capabilities away.
    if !inside(concat!(module_path!(), "::a_missing_capability_is_reported_with_its_remedy"), "-Un") {
        return;
    }
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let effective = status.lines().find_map(|line| line.strip_prefix("CapEff:")).unwrap().trim();
    if u64::from_str_radix(effective, 16).unwrap() & 1 << 13 != 0 {
        crate::common::skipped("CAP_NET_RAW is still held");
        return;
    }
    let refused = Monitor::open(&options("lo")).unwrap_err().to_string();
    assert!(refused.contains("setcap cap_net_raw"), "{refused}");
}

#[test]
fn frames_that_vanish_are_noticed() {
    let Some(_tun) = apart(frames_that_vanish_are_noticed, "mona", 2_304) else { return };
    let mut command = Command::new(env!("CARGO_BIN_EXE_csi5300"));
    command.args(["sound", "--interface", "mona", "--mac", "02:00:00:00:00:0a", "--peers", "02:00:00:00:00:0b"]);
    command.args(["--alone", "--open-loop", "--rate", "100", "--guard", "4000"]);
    command.env("XDG_STATE_HOME", env!("CARGO_TARGET_TMPDIR"));
    let mut sender = Program::of(command.stdout(Stdio::null()));
    // However long it takes a busy machine to send that many.
    sender.until("reports none of them as sent");
    let (status, said) = sender.end_by(nix::sys::signal::Signal::SIGINT);
    assert!(said.contains("regulatory domain is left"), "{said}");
    assert_eq!(status, Some(1), "{said}");
}

#[test]
fn a_wait_for_a_deadline_ends_at_it_or_when_something_comes() {
    let clock = Monotonic::new();
    let (reader, mut writer) = std::io::pipe().unwrap();
    let until = clock.now() + Span::from_us(2_000);
    assert_eq!(clock.wait_closely([reader.as_fd()], None, Some(until)).unwrap(), [false]);
    assert!(clock.now() >= until);
    writer.write_all(b"x").unwrap();
    let far = clock.now() + LONGEST;
    assert_eq!(clock.wait_closely([reader.as_fd()], None, Some(far)).unwrap(), [true]);
    assert!(clock.now() < far);
    assert_eq!(clock.wait_closely([reader.as_fd()], None, None).unwrap(), [true]);
    // However near the deadline is.
    assert_eq!(clock.wait_closely([reader.as_fd()], None, Some(clock.now())).unwrap(), [true]);
    // A deadline that may be met roughly, long before the one that is to be met closely.
    let (quiet, _writer) = std::io::pipe().unwrap();
    let until = clock.now() + Span::from_us(500);
    assert_eq!(clock.wait_closely([quiet.as_fd()], Some(until), Some(clock.now() + LONGEST)).unwrap(), [false]);
    assert!(clock.now() < until + LONGEST);
}
