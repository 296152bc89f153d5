//! A card that sends nonsense.

use super::card::Cards;
use super::listener::LogToFile;
use super::oracle::{Heard, Numbers};
use super::step;

/// Argument: packets.
#[test]
fn malformed_packets() {
    let Some(count) = step("CSI5300_STOCK_HOSTILE") else { return };
    let (mut cards, mut numbers) = (Cards::open(), Numbers(0xbad));
    // The stock driver complains about frames before its first 0xC0.
    cards.packet(0, 0xc0, &Heard::made(&mut numbers, 1).rx_phy());
    for _ in 0..count.parse::<u32>().unwrap() {
        let heard = Heard::made(&mut numbers, 1);
        let command = [0xc0, 0xc1, 0xbb][numbers.below(3)];
        let mut data = match command {
            0xc0 => heard.rx_phy(),
            0xc1 => heard.rx_mpdu(),
            _ => heard.bfee(),
        };
        for _ in 0..numbers.below(4) {
            let (at, byte) = (numbers.below(data.len()), numbers.next() as u8);
            data[at] = byte;
        }
        data.truncate(numbers.below(data.len() + 1));
        if command == 0xc1 {
            // A bad checksum, wherever the driver looks for it: what it would hand to mac80211 is not ours to test.
            data.iter_mut().skip(4).for_each(|byte| *byte &= !3);
        }
        // The length in the header may say anything but for frames, where the stock driver itself believes it.
        let said = match numbers.below(3) {
            0 if command != 0xc1 => numbers.below(1 << 14),
            _ => data.len() + 4,
        };
        let mut packet = (said as u32).to_le_bytes().to_vec();
        packet.extend_from_slice(&[command, 0, 0, 0x80]);
        packet.extend_from_slice(&data);
        cards.raw(numbers.below(2) as u8, &packet);
    }
}

/// Good frames for both cards until a file appears. Argument: the file.
#[test]
fn traffic() {
    let Some(stop) = step("CSI5300_STOCK_TRAFFIC") else { return };
    let (mut cards, mut numbers) = (Cards::open(), Numbers(3));
    while !std::path::Path::new(&stop).exists() {
        for card in [0, 1] {
            let heard = Heard::made(&mut numbers, 9);
            cards.packet(card, 0xc0, &heard.rx_phy());
            cards.packet(card, 0xc1, &heard.rx_mpdu());
            cards.packet(card, 0xbb, &heard.bfee());
        }
    }
}

/// Nanoseconds that a packet of no interest and one with CSI take through the driver. Argument: packets of each.
#[test]
fn cost() {
    let Some(count) = step("CSI5300_STOCK_COST") else { return };
    let (count, mut cards): (u32, _) = (count.parse().unwrap(), Cards::open());
    let heard = Heard::made(&mut Numbers(5), 1);
    // 0xd2 has no handler in iwldvm.
    for (name, command, data) in
        [("other", 0xd2, heard.rx_mpdu()), ("phy", 0xc0, heard.rx_phy()), ("bfee", 0xbb, heard.bfee())]
    {
        let start = std::time::Instant::now();
        for _ in 0..count {
            cards.packet(1, command, &data);
        }
        println!("{name} {}", start.elapsed().as_nanos() / u128::from(count));
    }
}

/// From the packet's hand-over to the record in user space, percentiles. Argument: frames.
#[test]
fn latency() {
    let Some(count) = step("CSI5300_STOCK_LATENCY") else { return };
    let listener = LogToFile::open();
    percentiles(&count, || listener.receive().map(|record| record[21..].to_vec()));
}

/// The same by the eBPF program. Argument: frames.
#[test]
fn latency_of_the_program() {
    use csi5300::source::{CsiSource, Next};
    let Some(count) = step("CSI5300_STOCK_LATENCY") else { return };
    let records = driver_iface::stock::Options::default().with_layout(driver_iface::bfee::Layout::Stock);
    let options = csi5300_live::stock::Options::default().with_records(records);
    let mut stock = csi5300_live::stock::Stock::open(&options).unwrap();
    let clock = csi5300_live::wait::Monotonic::new();
    percentiles(&count, || match stock.receive(clock.now()).unwrap() {
        Next::Record(_, record) => Some(record.body[20..].to_vec()),
        Next::Pending => None,
        other => panic!("{other:?}"),
    });
}

/// Gives frames to a card one by one, and takes the CSI of each before the next; says how long each took.
fn percentiles(count: &str, mut csi: impl FnMut() -> Option<Vec<u8>>) {
    let (mut cards, mut numbers) = (Cards::open(), Numbers(6));
    let mut took_us: Vec<_> = (0..count.parse::<u32>().unwrap())
        .map(|k| {
            let heard = Heard::made(&mut numbers, k + 1);
            cards.packet(0, 0xc0, &heard.rx_phy());
            let start = std::time::Instant::now();
            cards.packet(0, 0xbb, &heard.bfee());
            let got = std::iter::repeat_with(&mut csi).find_map(|got| {
                std::thread::yield_now();
                got
            });
            assert_eq!(got.unwrap(), heard.csi, "frame {k}");
            start.elapsed().as_micros()
        })
        .collect();
    took_us.sort_unstable();
    let at = |percent: usize| took_us[(took_us.len() - 1) * percent / 100];
    println!("from packet to user space: p50 {}, p99 {}, max {} us", at(50), at(99), at(100));
}
