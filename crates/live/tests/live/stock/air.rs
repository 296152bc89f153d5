//! The air between the cards: a simulated room. What a card transmits, the room carries; what the room's cards receive,
//! the fake cards report to the stock driver as the firmware does.

use super::card::{Cards, Transmission};
use super::step;
use csi5300::motion::odometry::csv;
use csi5300::motion::pose::Pose;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;
use csi5300_live::wait::Monotonic;
use csi5300_sim::{Interface, Port, Room, Scene};
use driver_iface::bfee::Bfee;
use driver_iface::record::code;
use std::io::Write;

const MAGIC: [u8; 6] = [0x00, 0x16, 0xea, 0x12, 0x34, 0x56];

/// 0xC0, 0xC1 and 0xBB of a received frame, as the oracle of the records has them.
fn report(cards: &mut Cards, card: u8, frame: &[u8], bfee: &Bfee<'_>) {
    let heard = super::oracle::Heard {
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
