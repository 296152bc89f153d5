//! The room's account contains every received frame exactly once.

use super::*;
use csi5300::source::{CsiSource, Injector, Next};
use csi5300::time::Instant;

fn frame(number: u32) -> Vec<u8> {
    let mut bytes = vec![0x08, 0, 0xff, 0xff];
    bytes.extend([0x00, 0x16, 0xea, 0x12, 0x34, 0x56].repeat(2));
    bytes.extend([2, 0x53, 0, 0, 0, 1]);
    bytes.extend([0, 0]);
    bytes.extend(number.to_be_bytes());
    bytes.resize(53, 0x55);
    bytes
}

/// A robot `tx`, and `rx` with these lines.
fn scene(rx: &str) -> Scene {
    let text = format!(
        "duration_s = 10.0\n[[robot]]\nname = \"tx\"\nposition_m = [1.5, 0.0, 0.0]\n[[robot]]\nname = \"rx\"\n{rx}\n"
    );
    Scene::from_toml(&text).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

/// `tx` sends frames of these numbers, one every 10 ms.
fn send(tx: &mut Port, numbers: std::ops::Range<u32>) {
    numbers.for_each(|number| tx.inject(Instant::from_us(i64::from(number) * 10_000), &frame(number)).unwrap());
}

/// Reads a card to its end; the number of its records.
fn read(card: &mut Port) -> u64 {
    let (mut records, mut now) = (0, Instant::ZERO);
    loop {
        match card.receive(now).unwrap() {
            Next::Record(..) => records += 1,
            Next::Pending => now = card.next_at().unwrap(),
            Next::Lost(_) => {}
            Next::End(_) => return records,
        }
    }
}

fn sum(of: Injected) -> u64 {
    let lost = of.driver_dropped + of.overrun_records + of.unmeasured;
    of.delivered + of.unheard + of.under_way + of.overheard + lost
}

/// The account of a thousand frames, with `rx`'s card read to its end.
fn counted(scene: &Scene) -> Injected {
    let mut room = Room::quiet(scene).unwrap();
    let (mut tx, mut rx) = (room.card(0).unwrap(), room.card(1).unwrap());
    send(&mut tx, 0..1000);
    let records = read(&mut rx);
    let counts = room.injected()[1];
    assert_eq!((records, sum(counts)), (counts.delivered, counts.received), "{counts}");
    counts
}

#[test]
fn a_frame_that_comes_while_antennas_meet_is_counted_as_such() {
    // It drives over the other's antenna after 5 s, when frame 500 is on air.
    let mut scene = scene("motion.line = { length_m = 3.0, duration_s = 10.0 }");
    let counts = counted(&scene);
    assert_eq!((counts.received, counts.delivered, counts.unmeasured), (1000, 999, 1));
    assert!(counts.to_string().contains("1 without a record because antennas met"), "{counts}");
    // With a second antenna there is no record of that moment either.
    scene.robot[1].antenna_b_m = Some([0.0, 0.5, 0.0]);
    assert_eq!(counted(&scene).unmeasured, 1);
}

#[test]
fn records_that_the_driver_or_a_full_queue_lost_are_in_the_account_too() {
    let counts = counted(&scene(
        "faults = { loss = 0.1, driver_drop = 0.1, queue_records = 20, stall_every_s = 3.0, stall_s = 1.0 }",
    ));
    assert_eq!(counts.received + counts.lost, 1000);
    assert!(counts.driver_dropped > 50 && counts.overrun_records > 100, "{counts}");
}

#[test]
fn records_of_a_card_that_nobody_has_are_counted_as_unheard() {
    let mut room = Room::quiet(&scene("")).unwrap();
    send(&mut room.card(0).unwrap(), 0..1000);
    room.advance(Instant::from_us(10_000_000));
    let counts = room.injected()[1];
    assert_eq!((counts.received, counts.unheard, counts.delivered), (1000, 1000, 0));
    assert!(counts.to_string().contains("1000 records nobody listened to"), "{counts}");
}

#[test]
fn records_let_go_are_counted_as_unheard_and_those_after_them_come() {
    let mut room = Room::quiet(&scene("")).unwrap();
    let (mut tx, mut rx) = (room.card(0).unwrap(), room.card(1).unwrap());
    send(&mut tx, 0..50);
    // Frame 49 is on its way to the host.
    rx.let_go(Instant::from_us(490_150));
    let counts = room.injected()[1];
    assert_eq!((counts.received, counts.unheard, counts.under_way, counts.delivered), (50, 49, 1, 0));
    send(&mut tx, 50..100);
    assert_eq!(read(&mut rx), 51);
    rx.take_back();
    let counts = room.injected()[1];
    assert_eq!((counts.delivered, counts.unheard, sum(counts)), (50, 50, 100), "the last one reached nobody");
}
