//! What runs in the guest of tests/checks/stock.sh: the stock driver on cards that are not there (tests/kernel/fakecard),
//! and csi5300.ko beside it. Each test is a step of a script there and does nothing elsewhere.
//!
//! The air between the cards is a simulated room: what a card transmits, the room carries; what the room's cards receive,
//! the fake cards report to the stock driver as the firmware does.

use csi5300::motion::odometry::csv;
use csi5300::motion::pose::Pose;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;
use csi5300_live::wait::Monotonic;
use csi5300_sim::{Interface, Port, Room, Scene};
use driver_iface::bfee::Bfee;
use driver_iface::record::code;
use netlink_sys::protocols::NETLINK_CONNECTOR;
use netlink_sys::{Socket, SocketAddr};
use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::time::Duration;

/// The step's argument, if this is the guest.
fn step(name: &str) -> Option<String> {
    let argument = std::env::var(name).ok();
    if argument.is_none() {
        crate::common::skipped("runs in the guest of tests/checks/stock.sh");
    }
    argument
}

/// Waits for the rest of the messages: as long as they come, and a second.
fn collect(listener: &LogToFile, records: &mut Vec<Vec<u8>>, expected: usize) {
    let mut last = std::time::Instant::now();
    while records.len() < expected && last.elapsed() < Duration::from_secs(2) {
        match listener.receive() {
            Some(record) => {
                records.push(record);
                last = std::time::Instant::now();
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
    let start = std::time::Instant::now();
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
    let Some(count) = step("CSI5300_STOCK_LATENCY") else { return };
    let records = driver_iface::stock::Options { layout: driver_iface::bfee::Layout::Stock, ..Default::default() };
    let options = csi5300_live::stock::Options { records, ring: csi5300_live::stock::RING, own: None };
    let mut stock = csi5300_live::stock::Stock::open(&options).unwrap();
    let clock = Monotonic::new();
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

const MAGIC: [u8; 6] = [0x00, 0x16, 0xea, 0x12, 0x34, 0x56];

/// 0xC0, 0xC1 and 0xBB of a received frame, as the oracle of the records has them.
fn report(cards: &mut Cards, card: u8, frame: &[u8], bfee: &Bfee<'_>) {
    let heard = Heard {
        timestamp: bfee.timestamp_low().into(),
        rssi: bfee.rssi(),
        agc: bfee.agc(),
        order: bfee.antenna_sel(),
        rate_n_flags: u32::from(bfee.rate_n_flags()) | 0x4000,
        n_rx: bfee.n_rx() as u8,
        n_tx: bfee.n_tx() as u8,
        csi: bfee.payload().to_vec(),
        frame: frame[..frame.len() - 4].to_vec(),
    };
    cards.packet(card, 0xc0, &heard.rx_phy());
    cards.packet(card, 0xc1, &heard.rx_mpdu());
    cards.packet(card, 0xbb, &heard.bfee());
}

/// Everything that a robot's card has received by now.
fn received(cards: &mut Cards, card: u8, port: &mut Port, now: Instant, frame: &mut Vec<u8>) -> bool {
    loop {
        match port.receive(now).unwrap() {
            Next::Record(_, record) if record.code == code::MPDU => {
                frame.clear();
                frame.extend_from_slice(record.body);
            }
            Next::Record(_, record) => report(cards, card, frame, &Bfee::new_checked(record.body).unwrap()),
            Next::End(_) => return false,
            Next::Pending => return true,
            other => panic!("{other:?}"),
        }
    }
}

/// A frame on air must be what csi5300.ko makes of a sounding frame.
fn carried(sent: &Transmission, interface: &mut Interface, now: Instant) {
    assert_eq!(sent.frame[4..10], MAGIC, "{sent:?}");
    assert_eq!((sent.rate_n_flags, sent.tx_flags & 0x10, sent.retries), (0x4101, 0, [0, 0]), "{sent:?}");
    interface.inject_at(now, &sent.frame, (sent.rate_n_flags & 7) as u8).unwrap();
}

/// The first robot's true trajectory, on the host's clock, written as it goes: whoever makes bearings live reads it meanwhile.
struct Course {
    file: std::fs::File,
    begin_us: i64,
    /// The next pose to write, microseconds of the room.
    next_us: i64,
}

impl Course {
    fn write_to(&mut self, room: &Room, until_us: i64) {
        let mut text = String::new();
        while self.next_us < until_us {
            let pose = room.pose(0, self.next_us as f64 * 1e-6).unwrap();
            let (t_s, heading_rad) = ((self.next_us + self.begin_us) as f64 * 1e-6, Some(pose.yaw_rad));
            text.push_str(&csv::line(&Pose { t_s, position_m: pose.position_m, heading_rad }));
            self.next_us += 10_000;
        }
        self.file.write_all(text.as_bytes()).unwrap();
    }
}

/// Argument: the scene's file, the file for the first robot's true trajectory, and the file that ends it.
#[test]
fn a_room_between_the_cards() {
    let Some(argument) = step("CSI5300_STOCK_AIR") else { return };
    let words: Vec<&str> = argument.split_whitespace().collect();
    let [scene, trajectory, stop] = words[..] else { panic!("{argument}") };
    let mut room = Room::quiet(&Scene::parse(&std::fs::read_to_string(scene).unwrap()).unwrap()).unwrap();
    let mut cards = Cards::open();
    let mut robots: Vec<_> = [0, 1].map(|k| (room.interface(k).unwrap(), room.card(k).unwrap(), Vec::new())).into();
    let clock = Monotonic::new();
    let begin_us = csi5300_live::wait::wall_us().unwrap();
    let (origin, mut frames) = (clock.now(), 0);
    let since = |now: Instant| Instant::from_us(now.as_us() - origin.as_us());
    let mut course = Course { file: std::fs::File::create(trajectory).unwrap(), begin_us, next_us: 0 };
    while !std::path::Path::new(stop).exists() {
        let now = since(clock.now());
        while let Some(sent) = cards.transmitted() {
            carried(&sent, &mut robots[sent.card].0, now);
            frames += 1;
        }
        for (k, (_, port, frame)) in robots.iter_mut().enumerate() {
            received(&mut cards, k as u8, port, now, frame);
        }
        course.write_to(&room, now.as_us());
        let wake = robots.iter().filter_map(|(_, port, _)| port.next_at()).min();
        let until = wake.map_or(now.as_us() + 50_000, |at| at.as_us().clamp(now.as_us() + 100, now.as_us() + 50_000));
        clock.wait([cards.fd()], Some(Instant::from_us(origin.as_us() + until))).unwrap();
    }
    course.write_to(&room, since(clock.now()).as_us());
    println!("{frames} frames on air");
}

/// Bytes before the frame of a transmission.
const HEAD: usize = 24;

/// A frame that a card was given to transmit.
#[derive(Debug)]
struct Transmission {
    card: usize,
    rate_n_flags: u32,
    tx_flags: u32,
    retries: [u8; 2],
    frame: Vec<u8>,
}

/// The device.
struct Cards(File);

impl Cards {
    fn open() -> Self {
        Self(OpenOptions::new().read(true).write(true).custom_flags(libc::O_NONBLOCK).open("/dev/fakecard").unwrap())
    }

    fn fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }

    /// Whatever bytes as the packet that a card puts into memory.
    fn raw(&mut self, card: u8, packet: &[u8]) {
        let mut bytes = vec![card, 0];
        bytes.extend_from_slice(&u16::try_from(packet.len()).unwrap().to_le_bytes());
        bytes.extend_from_slice(packet);
        assert_eq!(self.0.write(&bytes).unwrap(), bytes.len());
    }

    /// A packet of this command.
    fn packet(&mut self, card: u8, command: u8, data: &[u8]) {
        let mut packet = u32::try_from(data.len() + 4).unwrap().to_le_bytes().to_vec();
        packet.extend_from_slice(&[command, 0, 0, 0x80]);
        packet.extend_from_slice(data);
        self.raw(card, &packet);
    }

    fn transmitted(&mut self) -> Option<Transmission> {
        let mut bytes = [0; 4_096];
        let len = match self.0.read(&mut bytes) {
            Ok(len) => len,
            Err(error) if error.kind() == ErrorKind::WouldBlock => return None,
            Err(error) => panic!("/dev/fakecard: {error}"),
        };
        let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        Some(Transmission {
            card: bytes[0].into(),
            rate_n_flags: u32_at(4),
            tx_flags: u32_at(8),
            retries: [bytes[12], bytes[13]],
            frame: bytes[HEAD..len].to_vec(),
        })
    }
}

/// Listens and gives the code and body of each message.
struct LogToFile(Socket);

impl LogToFile {
    fn open() -> Self {
        let mut socket = Socket::new(NETLINK_CONNECTOR).unwrap();
        // The index as a bit mask: a mistake of the original, which joins other groups too.
        socket.bind(&SocketAddr::new(std::process::id(), 26)).unwrap();
        socket.add_membership(26).unwrap();
        socket.set_non_blocking(true).unwrap();
        Self(socket)
    }

    /// The next message, if there is one. An overrun is a failure, as there.
    fn receive(&self) -> Option<Vec<u8>> {
        let mut buffer = Vec::with_capacity(4_096);
        match self.0.recv(&mut buffer, 0) {
            Ok(_) => {}
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => return None,
            Err(error) => panic!("recv: {error}"),
        }
        // nlmsghdr, then cn_msg with its length at 16; the data at 20.
        let message = &buffer[16..];
        let len = usize::from(u16::from_le_bytes([message[16], message[17]]));
        Some(message[20..20 + len].to_vec())
    }
}

/// One received frame.
struct Heard {
    timestamp: u64,
    rssi: [u8; 3],
    agc: u8,
    order: u8,
    rate_n_flags: u32,
    n_rx: u8,
    n_tx: u8,
    csi: Vec<u8>,
    /// The frame without its FCS.
    frame: Vec<u8>,
}

/// A generator whose numbers anybody can compute: xorshift64*.
struct Numbers(pub u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.next() >> 33) as usize % bound
    }

    fn bytes(&mut self, len: usize) -> Vec<u8> {
        (0..len).map(|_| (self.next() >> 56) as u8).collect()
    }
}

/// FCS of 802.11, bit by bit.
fn fcs(frame: &[u8]) -> [u8; 4] {
    let mut crc = u32::MAX;
    for byte in frame {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = crc >> 1 ^ if crc & 1 == 1 { 0xedb8_8320 } else { 0 };
        }
    }
    (!crc).to_le_bytes()
}

impl Heard {
    /// The k-th sounding frame of a sender, with measurements that are all different.
    fn made(numbers: &mut Numbers, number: u32) -> Self {
        let (n_rx, n_tx) = match numbers.below(10) {
            0 => (1 + numbers.below(3) as u8, 1 + numbers.below(3) as u8),
            _ => (3, 1),
        };
        let mut frame = vec![0x08, 0, 0x30, 0];
        frame.extend_from_slice(&[0x00, 0x16, 0xea, 0x12, 0x34, 0x56, 0x00, 0x16, 0xea, 0x12, 0x34, 0x56]);
        frame.extend_from_slice(&[0x00, 0x21, 0x6a, 0x3f, 0x17, numbers.below(4) as u8, 0, 0]);
        frame.extend_from_slice(&number.to_be_bytes());
        let payload = numbers.below(60);
        frame.extend(numbers.bytes(payload));
        Self {
            timestamp: numbers.next() >> 8,
            rssi: [0; 3].map(|_: u8| numbers.below(100) as u8),
            agc: numbers.below(128) as u8,
            order: [0x24, 0x18, 0x09, 0x06, 0x21, 0x12][numbers.below(6)],
            rate_n_flags: [0x0001_4101, 0x0000_4901, 0x0001_c113][numbers.below(3)],
            csi: numbers.bytes(60 * usize::from(n_rx) * usize::from(n_tx) + 12),
            n_rx,
            n_tx,
            frame,
        }
    }

    /// 0xC0: struct iwl_rx_phy_res and one word of the configurable part.
    fn rx_phy(&self) -> Vec<u8> {
        let mut data = vec![8, 1, 0, 0];
        data.extend_from_slice(&self.timestamp.to_le_bytes());
        data.extend_from_slice(&[0; 4]); // beacon time
        data.extend_from_slice(&[0; 2]); // flags: 5 GHz
        data.extend_from_slice(&64_u16.to_le_bytes());
        let [a, b, c] = self.rssi.map(u32::from);
        // The bits between the fields are the out-of-band values, which nobody reads.
        let words = [0x1111_2222, u32::from(self.agc) << 9 | 0xabcd_0055, 0x7700_6600 | a | b << 16, 0x5544_3300 | c];
        for word in words.into_iter().chain([0; 4]) {
            data.extend_from_slice(&word.to_le_bytes());
        }
        data.extend_from_slice(&self.rate_n_flags.to_le_bytes());
        data.extend_from_slice(&((self.frame.len() + 4) as u16).to_le_bytes());
        data.extend_from_slice(&44_u16.to_le_bytes());
        data.extend_from_slice(&[self.order, 0x99, 0x88, 0x77]);
        data
    }

    /// The frame with its FCS.
    fn on_air(&self) -> Vec<u8> {
        [&self.frame[..], &fcs(&self.frame)].concat()
    }

    /// 0xC1: count, the frame, and that its checksum was good.
    fn rx_mpdu(&self) -> Vec<u8> {
        let on_air = self.on_air();
        let mut data = (on_air.len() as u16).to_le_bytes().to_vec();
        data.extend_from_slice(&[0, 0]);
        data.extend_from_slice(&on_air);
        data.extend_from_slice(&0x3_u32.to_le_bytes());
        data
    }

    /// 0xBB: the fields that the driver fills in have other bytes here.
    fn bfee(&self) -> Vec<u8> {
        let mut data = vec![0xde, 0xad, 0xbe, 0xef, 0x55, 0xaa, 0x12, 0x34, self.n_rx, self.n_tx];
        data.extend_from_slice(&[0xee; 6]);
        data.extend_from_slice(&(self.csi.len() as u16).to_le_bytes());
        data.extend_from_slice(&[0xcc; 2]);
        data.extend_from_slice(&self.csi);
        data
    }

    /// The record's first 20 bytes, which both drivers have.
    fn header(&self, bfee_count: u16) -> Vec<u8> {
        let mut body = (self.timestamp as u32).to_le_bytes().to_vec();
        body.extend_from_slice(&bfee_count.to_le_bytes());
        body.extend_from_slice(&[0x12, 0x34, self.n_rx, self.n_tx]);
        body.extend_from_slice(&self.rssi);
        body.extend_from_slice(&[-127_i8 as u8, self.agc, self.order]);
        body.extend_from_slice(&(self.csi.len() as u16).to_le_bytes());
        body.extend_from_slice(&((self.rate_n_flags & 0x3fff) as u16).to_le_bytes());
        body
    }

    /// Code and body as csitool's driver sends them.
    fn stock(&self, bfee_count: u16) -> Vec<u8> {
        [&[0xbb][..], &self.header(bfee_count), &self.csi].concat()
    }

    /// Code and body as the WSR driver sends them; the eight bytes of the host's time are zeros.
    fn wsr(&self, bfee_count: u16) -> Vec<u8> {
        let number = u32::from_be_bytes(self.frame[24..28].try_into().unwrap()).to_le_bytes();
        [&[0xbb][..], &self.header(bfee_count), &[0; 8], &self.frame[16..22], &number, &self.csi].concat()
    }
}
