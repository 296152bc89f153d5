//! Real logs of other cards, intact and damaged.
//!
//! The logs are not part of the repository: `CSI5300_CASES` names their folder; the default is `../shared/cases` beside it.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../../../tests/common/corpus.rs"]
mod corpus;
#[path = "../../../fuzz/targets/formats.rs"]
mod target;

use corpus::Random;
use csi_formats::{Card, Endian, Format, Frame, Item, Kind, detect, items};
use std::path::PathBuf;

/// The folder of logs; if there is none, prints a line and returns `None`.
fn folder() -> Option<PathBuf> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../../shared/cases");
    let near = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/cases");
    let named = std::env::var_os("CSI5300_CASES").map(PathBuf::from);
    let folder = named.into_iter().chain([near.into(), beside.into()]).map(|folder| folder.join("other-cards"));
    let found = folder.into_iter().find(|folder| folder.is_dir());
    if found.is_none() {
        println!("skipped: no logs of other cards (CSI5300_CASES)");
    }
    found
}

/// A log of each format: its number of frames and of their subcarriers, 0 if they vary.
const LOGS: [(&str, Format, Card, usize, usize); 9] = [
    ("feitcsi/HT20_2452.csi", Format::FeitCsi, Card::Ax2xx, 48, 56),
    ("feitcsi/HESU20_5500.csi", Format::FeitCsi, Card::Ax2xx, 28, 242),
    ("feitcsi/VHT80_5500.csi", Format::FeitCsi, Card::Ax2xx, 40, 242),
    ("picoscenes/picoscenes_ax200_example.csi", Format::PicoScenes, Card::Ax2xx, 0, 0),
    ("picoscenes/rx_by_iwl5300.csi", Format::PicoScenes, Card::Intel5300, 0, 30),
    ("nexmon/example_4358.pcap", Format::Nexmon, Card::Broadcom("4358"), 4, 256),
    ("nexmon/example_43455c0.pcap", Format::Nexmon, Card::Broadcom("43455c0"), 0, 256),
    ("esp32/example_data.csv", Format::Esp32, Card::Esp32, 60, 64),
    ("atheros/ath_csi_1.dat", Format::Atheros(Endian::Little), Card::Qca9300, 0, 56),
];

fn frames(bytes: &[u8]) -> Vec<Frame> {
    let all = items(bytes).unwrap();
    all.filter_map(|item| if let Item::Frame(frame) = item { Some(frame) } else { None }).collect()
}

#[test]
fn every_log_is_recognised_and_read() {
    let Some(folder) = folder() else { return };
    for (name, format, card, records, subcarriers) in LOGS {
        let bytes = std::fs::read(folder.join(name)).unwrap();
        assert_eq!(detect(&bytes), Some(format), "{name}");
        let frames = frames(&bytes);
        println!("{name}: {} frames", frames.len());
        assert!(frames.len() == records || records == 0 && !frames.is_empty(), "{name}: {}", frames.len());
        for frame in &frames {
            let n = frame.subcarriers.len();
            assert_eq!((frame.card, frame.measured.len()), (card, n), "{name}");
            assert!(n == subcarriers || subcarriers == 0, "{name}: {n}");
            assert_eq!(frame.csi.len(), frame.n_rx * frame.n_tx * n, "{name}");
            assert!(frame.clock.is_some() || frame.host_us.is_some(), "{name}");
        }
    }
}

#[test]
fn csitool_logs_are_not_recognised_as_other_cards() {
    let Some(folder) = folder() else { return };
    for name in ["reports/logs/managed_no_fcs.dat", "wsr-2021/floor/csi_rx_2021-03-04_154746.dat"] {
        let bytes = std::fs::read(folder.parent().unwrap().join(name)).unwrap();
        assert_eq!(detect(&bytes), None, "{name}");
    }
}

/// Damages bytes as logs get damaged: flips bits, removes bytes, inserts others, cuts the end.
fn damage(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..=random.next() % 4 {
        let at = random.next() as usize % bytes.len().max(1);
        let many = (random.next() % 300) as usize;
        match random.next() % 4 {
            0 => bytes.get_mut(at).into_iter().for_each(|byte| *byte ^= 1 << (random.next() % 8)),
            1 => drop(bytes.drain(at..(at + many).min(bytes.len()))),
            2 => drop(bytes.splice(at..at, (0..many).map(|k| (k * 37) as u8).collect::<Vec<_>>())),
            _ => bytes.truncate(at.max(1)),
        }
    }
}

/// 10,000 damaged copies: none causes a panic, every byte is accounted for, and every frame has the stated number of samples.
#[test]
fn damage_is_skipped_and_never_a_panic() {
    let Some(folder) = folder() else { return };
    let mut random = Random(88_172_645_463_325_252);
    let (mut copies, mut frames, mut skipped) = (0, 0, 0);
    for (name, format, ..) in LOGS {
        let whole = std::fs::read(folder.join(name)).unwrap();
        let from = if format == Format::Esp32 { 600 } else { 8_000 };
        for _ in 0..1_112 {
            let mut bytes = whole.get(..from).unwrap_or(&whole).to_vec();
            damage(&mut bytes, &mut random);
            copies += 1;
            let (more, bad) = target::read(format, &bytes);
            (frames, skipped) = (frames + more, skipped + bad);
        }
    }
    println!("{copies} damaged copies: {frames} frames, {skipped} stretches skipped");
    assert!(copies >= 10_000 && frames > copies && skipped > 0);
}

/// A big-endian logger's version of the same log.
#[test]
fn a_big_endian_atheros_log_reads_the_same() {
    let Some(folder) = folder() else { return };
    let little = std::fs::read(folder.join("atheros/ath_csi_1.dat")).unwrap();
    let mut big = little.clone();
    let mut at = 0;
    while let Some(record) = big.get_mut(at..).filter(|rest| rest.len() > 27) {
        let len = usize::from(u16::from_le_bytes([record[0], record[1]]));
        for (from, to) in [(0, 2), (2, 10), (10, 12), (12, 14), (25, 27)] {
            record[from..to].reverse();
        }
        at += 2 + len;
    }
    assert_eq!(detect(&big), Some(Format::Atheros(Endian::Big)));
    assert!(frames(&little) == frames(&big));
}

#[test]
fn an_ax210_measures_no_pilots() {
    let Some(folder) = folder() else { return };
    let bytes = std::fs::read(folder.join("feitcsi/VHT80_5500.csi")).unwrap();
    let frame = &frames(&bytes)[0];
    assert_eq!((frame.kind, frame.width_mhz), (Some(Kind::Vht), 80));
    assert_eq!(frame.measured.iter().filter(|measured| !**measured).count(), 8);
    // The firmware's value at a pilot is unrelated to its neighbours.
    let power = |k: usize| 1.0 + frame.csi[k].iter().map(|part| part * part).sum::<f32>();
    let jumps = |k: usize| (power(k) / power(k - 1)).ln().abs();
    let at_pilots = (1..242).filter(|k| !frame.measured[*k]).map(jumps).sum::<f32>() / 8.0;
    let elsewhere = (2..242).filter(|k| frame.measured[*k] && frame.measured[k - 1]).map(jumps).sum::<f32>() / 226.0;
    println!("mean step of log power: {at_pilots:.2} at pilots, {elsewhere:.2} elsewhere");
    assert!(at_pilots > 2.0 * elsewhere);
}

/// Bytes of no log at all, and parts of each kind of log read as another kind.
#[test]
fn any_bytes_are_read_without_a_panic() {
    let mut random = Random(4_101_842_887_655_102_017);
    for len in [0, 1, 3, 11, 27, 60, 272, 300, 2_000] {
        let bytes: Vec<u8> = (0..len).map(|_| (random.next() >> 32) as u8).collect();
        target::run(&bytes);
        target::run(&vec![0; len]);
        target::run(&vec![0xff; len]);
    }
    let Some(folder) = folder() else { return };
    for (name, ..) in LOGS {
        let bytes = std::fs::read(folder.join(name)).unwrap();
        target::run(bytes.get(..9_000).unwrap_or(&bytes));
    }
}
