//! Records from an unmodified driver's packets: this crate's code, the kernel module's C code, and an oracle that shares no code
//! with either give the same bytes for the same streams.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../tests/common/stock.rs"]
mod common;
#[path = "../../tests/common/mod.rs"]
mod shared;

use common::{Counts, Oracle, Packet, Random, any};
use driver_iface::bfee::{Layout, MAX_BODY};
use driver_iface::stock::{self, Card, Event, Options, flag};
use proptest::collection::vec;
use proptest::{num, prop_assert, prop_assert_eq, proptest};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// For a module with a version, the kernel's build adds a hash of the sources (`srcversion`), by which `csi5300 setup`
/// distinguishes builds.
#[test]
fn the_module_has_this_version() {
    let module = include_str!("../kmod/csi5300.c");
    assert!(module.contains(concat!("MODULE_VERSION(\"", env!("CARGO_PKG_VERSION"), "\");")));
}

/// The result of a stream of packets: for each packet the message (code and body), and the counts.
type Answer = (Vec<Option<Vec<u8>>>, Counts);

/// Layout and `connector_log` of a case.
#[derive(Clone, Copy, Debug)]
struct How {
    wsr: bool,
    log: u8,
}

impl How {
    fn options(self) -> Options {
        let layout = if self.wsr { Layout::Wsr } else { Layout::Stock };
        Options { layout, csi: self.log & 1 != 0, frames: self.log & 4 != 0 }
    }
}

/// Arrival time of packet `k`: seconds, microseconds.
fn time_of(k: usize) -> (u32, u32) {
    (1_700_000_000 + k as u32, (k as u32 * 7_919) % 1_000_000)
}

fn counts(c: stock::Counts) -> Counts {
    let seen = [c.phy, c.mpdu, c.bfee, c.records];
    let dropped = [c.bad_phy, c.bad_mpdu, c.mpdu_no_phy, c.bad_bfee, c.no_phy];
    [&seen[..], &dropped, &[c.no_order, c.no_sender]].concat().try_into().unwrap()
}

fn by_the_oracle(how: How, stream: &[Packet]) -> Answer {
    let mut oracle = Oracle::default();
    let one = |(k, packet)| oracle.packet(how.wsr, how.log, packet, time_of(k));
    let messages = stream.iter().enumerate().map(one).collect();
    (messages, oracle.counts)
}

/// The program's event for a packet; frames are cut unless they are wanted whole (`fill` of `bpf/csi5300.bpf.c`).
fn event_of(how: How, (command, data): &Packet) -> Vec<u8> {
    let whole = how.log & 4 != 0;
    let kept = match command {
        0x01 => 0,
        0xC0 => 64,
        0xBB => 572,
        _ if whole => 8_199,
        _ => 32,
    };
    let mut flags = 0;
    let mut data_kept = data[..kept.min(data.len())].to_vec();
    let count = data.first_chunk().map_or(0, |bytes| usize::from(u16::from_le_bytes(*bytes)));
    if *command == 0xC1 && !whole && data.len() >= 32 && (14..=8_191).contains(&count) && 8 + count <= data.len() {
        flags = flag::FRAME_START;
        data_kept.extend(&data[4 + count..8 + count]);
    }
    let mut out = vec![0; 32 + data_kept.len()];
    let (command, data_len) = (*command, data.len() as u32);
    Event { command, data_len, flags, data: &data_kept, ..Event::default() }.emit(&mut out).unwrap();
    out
}

/// The result of this crate, from whole packets or from the program's events.
fn by_rust(how: How, stream: &[Packet], events: bool) -> Answer {
    let (mut card, mut body, options) = (Card::default(), [0xa5; MAX_BODY], how.options());
    let mut counts_of_all = stock::Counts::default();
    let mut messages = Vec::new();
    for (k, packet) in stream.iter().enumerate() {
        let (seconds, us) = time_of(k);
        let host_us = i64::from(seconds) * 1_000_000 + i64::from(us);
        let event = event_of(how, packet);
        let packet = match events {
            // The ring contains no other commands.
            true => Event::new_checked(&event).unwrap().packet(),
            false => stock::Packet::new(packet.0, &packet.1),
        };
        let record = card.handle(&mut counts_of_all, &options, &packet, host_us, &mut body);
        messages.push(record.map(|record| [&[record.code], record.body].concat()));
    }
    (messages, counts(counts_of_all))
}

/// The kernel module's code, compiled for user space; deleted when dropped.
struct InC {
    program: Child,
    folder: PathBuf,
}

impl Drop for InC {
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

impl InC {
    /// `None`, with a message, if no C compiler is installed.
    fn start(name: &str) -> Option<Self> {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let folder = std::env::temp_dir().join(format!("csi5300-assembly-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let program = folder.join("shim");
        let compile = |sanitizers: &[&str]| {
            let mut cc = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
            cc.args(["-std=gnu11", "-O1", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function"]).args(sanitizers);
            cc.arg("-I").arg(here.join("kmod")).arg(here.join("tests/stock_shim.c")).arg("-o").arg(&program);
            cc.output()
        };
        let sanitized = compile(&["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]);
        let Ok(first) = sanitized else {
            shared::skipped("the comparison with the assembly in C: no C compiler (cc, or $CC)");
            return None;
        };
        if !first.status.success() {
            // For systems without the sanitizers' libraries.
            let plain = compile(&[]).unwrap();
            assert!(plain.status.success(), "{}", String::from_utf8_lossy(&plain.stderr));
        }
        let started = Command::new(&program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        Some(Self { program: started, folder })
    }

    fn answer(&mut self, how: How, stream: &[Packet]) -> Answer {
        let mut question = vec![u8::from(how.wsr), how.log];
        question.extend((stream.len() as u32).to_le_bytes());
        for (k, (command, data)) in stream.iter().enumerate() {
            let (seconds, us) = time_of(k);
            for field in [u32::from(*command), data.len() as u32, seconds, us] {
                question.extend(field.to_le_bytes());
            }
            question.extend(data);
        }
        self.program.stdin.as_mut().unwrap().write_all(&question).unwrap();
        self.program.stdin.as_mut().unwrap().flush().unwrap();
        let out = self.program.stdout.as_mut().unwrap();
        let mut messages = Vec::new();
        for _ in stream {
            let mut message = vec![0; number(out) as usize];
            out.read_exact(&mut message).unwrap();
            messages.push(Some(message).filter(|message| !message.is_empty()));
        }
        (messages, std::array::from_fn(|_| number(out)))
    }
}

/// A u32 of the program's output.
fn number(out: &mut impl Read) -> u32 {
    let mut bytes = [0; 4];
    out.read_exact(&mut bytes).expect("the C assembly has ended; its own words are above");
    u32::from_le_bytes(bytes)
}

fn hows() -> impl Iterator<Item = How> {
    [false, true].into_iter().flat_map(|wsr| [0, 1, 4, 5].map(|log| How { wsr, log }))
}

/// All results for a stream equal the oracle's.
fn compare(in_c: Option<&mut InC>, how: How, stream: &[Packet]) -> Counts {
    let expect = by_the_oracle(how, stream);
    assert!(by_rust(how, stream, false) == expect, "whole packets, {how:?}: {stream:02x?}");
    assert!(by_rust(how, stream, true) == expect, "events, {how:?}: {stream:02x?}");
    if let Some(in_c) = in_c {
        assert!(in_c.answer(how, stream) == expect, "C, {how:?}: {stream:02x?}");
    }
    expect.1
}

#[test]
fn long_streams_of_good_and_hostile_packets() {
    let mut in_c = InC::start("long");
    let mut total = [0_u64; 11];
    for how in hows() {
        let mut random = Random(0x5300_0000 + u64::from(how.log));
        for _ in 0..40 {
            let stream: Vec<_> = (0..250).map(|_| any(random.next() as u8, random.next(), random.next())).collect();
            let counts = compare(in_c.as_mut(), how, &stream);
            total.iter_mut().zip(counts).for_each(|(sum, count)| *sum += u64::from(count));
        }
    }
    println!("80,000 packets: {total:?}");
    // Every branch for a packet was taken often.
    assert!(total.iter().all(|&count| count > 500), "{total:?}");
}

proptest! {
    #[test]
    fn short_streams(kinds in vec((any_u8(), any_u32(), any_u32()), 0..24), wsr in any_bool(), log in 0_u8..8) {
        let stream: Vec<_> = kinds.into_iter().map(|(kind, a, b)| any(kind, a, b)).collect();
        compare(None, How { wsr, log }, &stream);
    }

    #[test]
    fn events_are_read_or_refused(bytes in vec(any_u8(), 0..120), fix in any_bool(), cut in any_u8()) {
        let mut bytes = bytes;
        if fix && bytes.len() > 32 {
            let kept = (bytes.len() - 32 - usize::from(cut) % (bytes.len() - 32)) as u16;
            bytes[29] &= flag::FRAME_START;
            bytes[30..32].copy_from_slice(&kept.to_le_bytes());
        }
        if let Some(event) = Event::new_checked(&bytes) {
            let mut body = [0; MAX_BODY];
            prop_assert!(Card::default().handle(&mut stock::Counts::default(), &Options::default(), &event.packet(), 0, &mut body).is_none());
        }
    }

    #[test]
    fn emitted_events_are_read(
        card in proptest::num::u64::ANY, time_ns in proptest::num::u64::ANY, full in any_u32(), lost in any_u32(),
        command in any_u8(), data in vec(any_u8(), 0..700), more in 0_u32..90, padding in 0_usize..9,
    ) {
        let data_len = data.len() as u32 + more;
        let event =
            Event { card, time_ns, ring_full: full, unreadable: lost, data_len, command, flags: 0, data: &data };
        let mut out = vec![0xa5; 32 + data.len() + padding];
        prop_assert_eq!(event.emit(&mut out), Ok(32 + data.len()));
        prop_assert_eq!(Event::new_checked(&out), Some(event));
    }
}

fn any_u8() -> num::u8::Any {
    num::u8::ANY
}

fn any_u32() -> num::u32::Any {
    num::u32::ANY
}

fn any_bool() -> proptest::bool::Any {
    proptest::bool::ANY
}
