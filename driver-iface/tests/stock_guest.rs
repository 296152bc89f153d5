//! Steps of the guest's script tests/kernel/stock/40-ebpf.sh: sends packets to the fake cards under the real driver, and compares
//! the records of `csi5300 record --stock` byte by byte. Outside the guest, each test does nothing.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../tests/common/stock.rs"]
mod common;
#[path = "../../tests/common/mod.rs"]
mod shared;

use common::{Oracle, Packet, Random, any, sounding};
use std::io::Write;
use std::time::{Duration, Instant};

/// The step's argument, in the guest.
fn step(name: &str) -> Option<String> {
    let argument = std::env::var(name).ok();
    if argument.is_none() {
        shared::skipped("runs in the guest of tests/checks/stock.sh");
    }
    argument
}

/// The packets of a kind, with their cards.
fn stream(kind: &str, count: u32, seed: u64) -> Vec<(u8, Packet)> {
    let mut random = Random(seed << 8 | 0x5300);
    let mut out: Vec<(u8, Packet)> = Vec::new();
    match kind {
        // Sounding frames of card 0: 1 ms apart on its clock.
        "steady" => {
            for k in 0..count {
                let mac = [0, 0x21, 0x6a, 0, 0, (k % 5) as u8];
                out.extend(sounding(&mut random, mac, k + 1, k * 1_000).map(|packet| (0, packet)));
            }
        }
        // The same with a cut 0xBB after each frame; headers claim more than there is, see `feed`.
        "lying" => {
            for k in 0..count {
                out.extend(sounding(&mut random, [0, 0x21, 0x6a, 0, 0, 1], k + 1, k * 1_000).map(|packet| (0, packet)));
                let mut cut = common::csi(&mut random, 3, 1, 0);
                cut.1.truncate(100);
                out.extend([(0, common::phy(&mut random, 1, 1)), (0, cut)]);
            }
        }
        // An unknown command.
        "foreign" => out.extend((0..count).map(|_| (0, (0xee, vec![0x5a; 120])))),
        // Random packets from two cards. Frames have a correct length and a bad checksum: frames that the driver itself accepts and passes
        // to mac80211 are not tested here.
        "hostile" => {
            out.extend([0, 1].map(|card| (card, common::phy(&mut random, 1, 1))));
            while out.len() < count as usize {
                let (command, mut data) = any(random.next() as u8, random.next(), random.next());
                if !matches!(command, 0xC0 | 0xC1 | 0xBB) || data.len() > 4_000 {
                    continue;
                }
                if command == 0xC1 {
                    data.iter_mut().skip(4).for_each(|byte| *byte &= !3);
                }
                out.push(((random.next() % 2) as u8, (command, data)));
            }
        }
        other => panic!("kind {other}"),
    }
    out
}

/// The messages expected in the log. A card's frames are held back until it has made a record.
fn expected(packets: &[(u8, Packet)], wsr: bool, log: u8) -> Vec<Vec<u8>> {
    let mut oracles = [Oracle::default(), Oracle::default()];
    let mut messages = Vec::new();
    for (card, packet) in packets {
        let oracle = &mut oracles[usize::from(*card)];
        let message = oracle.packet(wsr, log, packet, (0, 0));
        messages.extend(message.filter(|message| message[0] == 0xBB || oracle.counts[3] > 0));
    }
    messages
}

/// Argument: kind, count, seed, frames of three packets per second (0: as fast as possible).
#[test]
fn feed() {
    let Some(argument) = step("CSI5300_EBPF_FEED") else { return };
    let words: Vec<&str> = argument.split(' ').collect();
    let [kind, count, seed, rate] = words[..] else { panic!("{argument}") };
    let rate: f64 = rate.parse().unwrap();
    let packets = stream(kind, count.parse().unwrap(), seed.parse().unwrap());
    let mut cards = std::fs::OpenOptions::new().write(true).open("/dev/fakecard").unwrap();
    let begin = Instant::now();
    for (k, (card, (command, data))) in packets.iter().enumerate() {
        let said = if kind == "lying" && *command == 0xBB { 0x3fff } else { data.len() + 4 };
        let mut packet = u32::try_from(said).unwrap().to_le_bytes().to_vec();
        packet.extend([*command, 0, 0, 0x80]);
        packet.extend(data);
        let mut bytes = vec![*card, 0];
        bytes.extend(u16::try_from(packet.len()).unwrap().to_le_bytes());
        bytes.extend(packet);
        if rate > 0.0 && k % 3 == 0 {
            let at = begin + Duration::from_secs_f64((k / 3) as f64 / rate);
            std::thread::sleep(at.saturating_duration_since(Instant::now()));
        }
        assert_eq!(cards.write(&bytes).unwrap(), bytes.len());
    }
    println!("{} packets in {:.2} s of the guest", packets.len(), begin.elapsed().as_secs_f64());
}

/// The records of a log as code and body, by their lengths alone: the CSI is of random bits, which no card would send.
fn records_of(log: &str) -> Vec<Vec<u8>> {
    let bytes = std::fs::read(log).unwrap();
    let (mut records, mut rest) = (Vec::new(), &bytes[..]);
    while let Some((&[high, low], after)) = rest.split_first_chunk() {
        let (record, after) = after.split_at(usize::from(u16::from_be_bytes([high, low])));
        records.push(record.to_vec());
        rest = after;
    }
    assert!(rest.is_empty(), "{log}: {} bytes at its end", rest.len());
    records
}

/// Removes WSR's eight bytes of host time from a record; they must not run backwards.
fn without_time(record: &mut [u8], last_us: &mut u64) {
    if record[0] != 0xBB {
        return;
    }
    let field = |at: usize| u64::from(u32::from_le_bytes(record[at..at + 4].try_into().unwrap()));
    let us = field(21) * 1_000_000 + field(25);
    assert!(us >= *last_us && us > 1_000_000, "{us} us after {last_us}");
    *last_us = us;
    record[21..29].fill(0);
}

/// Argument: log, layout (wsr or csitool), connector_log, `all` or `some` (an overrun is allowed), then as for `feed`.
#[test]
fn every_record_is_what_the_patched_driver_makes() {
    let Some(argument) = step("CSI5300_EBPF_CHECK") else { return };
    let words: Vec<&str> = argument.split(' ').collect();
    let [log, layout, bits, which, kind, count, seed, _] = words[..] else { panic!("{argument}") };
    let wsr = layout == "wsr";
    let packets = stream(kind, count.parse().unwrap(), seed.parse().unwrap());
    let expect = expected(&packets, wsr, bits.parse().unwrap());
    let mut got = records_of(log);
    if wsr {
        let mut last_us = 0;
        got.iter_mut().for_each(|record| without_time(record, &mut last_us));
    }
    if which == "all" {
        assert_eq!(got.len(), expect.len());
        assert!(got == expect, "the first that differs: {:?}", got.iter().zip(&expect).position(|(a, b)| a != b));
    } else {
        // Each record belongs to some frame, in order; its number is one more than the previous record's.
        let mut rest = expect.iter();
        for (k, record) in got.iter().enumerate() {
            assert_eq!(record[5..7], (k as u16 + 1).to_le_bytes(), "record {k}");
            let same = |other: &&Vec<u8>| {
                other.len() == record.len() && other[..5] == record[..5] && other[7..] == record[7..]
            };
            assert!(rest.any(|other| same(&other)), "record {k} is no frame's own");
        }
        assert!(got.len() < expect.len() && got.len() > 10, "{} of {}", got.len(), expect.len());
    }
    println!("{} of {} records, byte for byte", got.len(), expect.len());
}
