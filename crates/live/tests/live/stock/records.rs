//! Records of the module, byte for byte.

use super::card::Cards;
use super::listener::LogToFile;
use super::oracle::{Heard, Numbers};
use super::step;
use std::time::{Duration, Instant};

/// Waits for the rest of the messages: as long as they come, and a second.
fn collect(listener: &LogToFile, records: &mut Vec<Vec<u8>>, expected: usize) {
    let mut last = Instant::now();
    while records.len() < expected && last.elapsed() < Duration::from_secs(2) {
        match listener.receive() {
            Some(record) => {
                records.push(record);
                last = Instant::now();
            }
            None => std::thread::sleep(Duration::from_millis(1)),
        }
    }
}

/// Argument: layout, connector_log, frames, frames per second, and the file for what a log must hold.
#[test]
fn every_record_is_what_the_patched_driver_makes() {
    let Some(argument) = step("CSI5300_STOCK_RECORDS") else { return };
    let words: Vec<&str> = argument.split_whitespace().collect();
    let [layout, log, count, rate, file] = words[..] else { panic!("{argument}") };
    let (wsr, log): (bool, u8) = (layout == "wsr", log.parse().unwrap());
    let (count, rate): (u32, u32) = (count.parse().unwrap(), rate.parse().unwrap());
    let (mut cards, listener, mut numbers) = (Cards::open(), LogToFile::open(), Numbers(0x5300));
    let (mut expected, mut got) = (Vec::new(), Vec::new());
    let start = Instant::now();
    for k in 0..count {
        let due = Duration::from_secs(1) * k / rate;
        if let Some(early) = due.checked_sub(start.elapsed()) {
            std::thread::sleep(early);
        }
        let heard = Heard::made(&mut numbers, k + 1);
        cards.packet(0, 0xc0, &heard.rx_phy());
        cards.packet(0, 0xc1, &heard.rx_mpdu());
        cards.packet(0, 0xbb, &heard.bfee());
        if log & 4 != 0 {
            expected.push([&[0xc1][..], &heard.on_air()].concat());
        }
        let bfee_count = (k + 1) as u16;
        expected.push(if wsr { heard.wsr(bfee_count) } else { heard.stock(bfee_count) });
        got.extend(std::iter::from_fn(|| listener.receive()));
    }
    let took = start.elapsed();
    collect(&listener, &mut got, expected.len());
    assert_eq!(got.len(), expected.len(), "messages");
    let mut bytes = Vec::new();
    for (k, (got, expected)) in got.iter_mut().zip(&expected).enumerate() {
        bytes.extend_from_slice(&(got.len() as u16).to_be_bytes());
        bytes.extend_from_slice(got);
        if wsr && got[0] == 0xbb {
            let seconds = u32::from_le_bytes(got[21..25].try_into().unwrap());
            let micros = u32::from_le_bytes(got[25..29].try_into().unwrap());
            assert!(seconds > 0 && micros < 1_000_000, "record {k}: {seconds} s, {micros} us");
            got[21..29].fill(0);
        }
        assert_eq!(got, expected, "message {k}");
    }
    // What csitool's logger would have written; the script compares the log of `csi5300 record` with it.
    std::fs::write(file, bytes).unwrap();
    println!("{count} frames in {:.1} s: {} messages as expected", took.as_secs_f64(), expected.len());
}

/// Frames that lack something, in known numbers.
#[test]
fn missing_parts_are_dropped_or_marked_and_counted() {
    if step("CSI5300_STOCK_DROPS").is_none() {
        return;
    }
    let (mut cards, listener, mut numbers) = (Cards::open(), LogToFile::open(), Numbers(77));
    let mut expected = Vec::new();
    for k in 0..10_u32 {
        let heard = Heard::made(&mut numbers, k + 1);
        // Without its 0xC0, and twice after one.
        cards.packet(0, 0xbb, &heard.bfee());
        cards.packet(0, 0xc0, &heard.rx_phy());
        cards.packet(0, 0xbb, &heard.bfee());
        cards.packet(0, 0xbb, &heard.bfee());
        expected.push(heard.stock((k + 1) as u16));
        // A cut 0xC0 takes the one before it away.
        cards.packet(0, 0xc0, &heard.rx_phy());
        cards.packet(0, 0xc0, &heard.rx_phy()[..59]);
        cards.packet(0, 0xbb, &heard.bfee());
        // Without the configurable part: the order of the antennas is not known.
        let mut phy = heard.rx_phy();
        phy[1] = 0;
        cards.packet(0, 0xc0, &phy[..60]);
        cards.packet(0, 0xbb, &heard.bfee()[..19]);
    }
    let heard = Heard { order: 0xff, ..Heard::made(&mut numbers, 11) };
    let mut phy = heard.rx_phy();
    phy[1] = 0;
    cards.packet(0, 0xc0, &phy[..60]);
    cards.packet(0, 0xbb, &heard.bfee());
    expected.push(heard.stock(11));
    let mut got = Vec::new();
    collect(&listener, &mut got, expected.len());
    assert_eq!(got, expected);
    let counter = |name: &str| -> u32 {
        let text = std::fs::read_to_string(format!("/sys/module/csi5300/counters/{name}")).unwrap();
        text.trim().parse().unwrap()
    };
    let names = ["phy", "bfee", "records", "bad_phy", "bad_bfee", "no_phy", "no_order", "delivered", "ring_full"];
    assert_eq!(names.map(counter), [41, 51, 11, 10, 10, 30, 1, 11, 0], "{names:?}");
}
