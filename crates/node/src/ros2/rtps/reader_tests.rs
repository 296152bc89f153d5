use super::*;
use std::net::Ipv4Addr;

const TO: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7411);

fn guid(number: u8) -> Guid {
    Guid { prefix: [number; 12], entity: [0, 0, 1, 3] }
}

/// A reader with so many reliable writers.
fn with_writers(count: u8) -> Reader {
    let mut reader = Reader::new([200; 12], [0, 0, 1, 4], Qos::reliable(10));
    (0..count).for_each(|number| reader.add(guid(number), TO, true, &mut Vec::new()));
    reader
}

#[test]
fn what_waits_is_bounded_in_bytes_and_comes_when_it_is_asked_for_again() {
    let mut reader = with_writers(100);
    let bytes = vec![7; 60_000];
    for number in 0..100 {
        // The first is missing.
        (2..=40).for_each(|sample| drop(reader.handle_data(guid(number), sample, &bytes)));
        let fragment = Fragment { first: 1, size: 1_000, total: LARGEST as u32, bytes: &bytes[..1_000] };
        assert!(reader.handle_fragment(guid(number), 50, &fragment).is_empty());
    }
    let held = reader.writers.values().flat_map(|writing| writing.held.values().map(Vec::len));
    let parts = reader.writers.values().flat_map(|writing| writing.parts.values().map(Parts::len));
    let waiting: usize = held.chain(parts).sum();
    assert_eq!(waiting, reader.waiting());
    assert!((WAITING / 2..=WAITING).contains(&waiting), "{waiting}");
    // One that has nothing that waits gets all of its samples all the same, and the room of the others is free afterwards.
    let came: usize = (1..=40).map(|sample| reader.handle_data(guid(99), sample, &bytes).len()).sum();
    assert_eq!(came, 40);
    for number in 0..99 {
        (1..=40).for_each(|sample| drop(reader.handle_data(guid(number), sample, &bytes)));
    }
    let parts: usize = reader.writers.values().flat_map(|writing| writing.parts.values().map(Parts::len)).sum();
    assert_eq!((reader.waiting(), reader.counts().samples), (parts, 4_000));
    reader.remove(|_| true);
    assert_eq!(reader.waiting(), 0);
}

#[test]
fn ranges_without_end_are_asked_for_in_part_and_counted_without_overflow() {
    let mut reader = with_writers(1);
    let mut out = Vec::new();
    reader.handle_heartbeat(guid(0), (1, i64::MAX), false, &mut out);
    assert!(out.iter().all(|(_, bytes)| bytes.len() < 120), "one set of 256 numbers at most");
    for round in 0..4 {
        reader.handle_heartbeat(guid(0), (i64::MAX - 1, i64::MAX), false, &mut out);
        reader.handle_data(guid(0), i64::MAX, &[0; 8]);
        reader.handle_gap(guid(0), 1, &Numbers::of(i64::MAX - 1, [i64::MAX - 1, i64::MAX].into_iter()));
        assert!(reader.counts().lost > i64::MAX as u64 / 2 * (round + 1).min(3), "{:?}", reader.counts());
        // It goes, and comes again.
        reader.remove(|_| true);
        reader.add(guid(0), TO, true, &mut out);
        reader.handle_heartbeat(guid(0), (1, 5), false, &mut out);
    }
    // Best effort.
    let mut reader = Reader::new([200; 12], [0, 0, 1, 4], Qos::best_effort(10));
    for _ in 0..4 {
        reader.add(guid(1), TO, false, &mut out);
        reader.handle_data(guid(1), 1, &[0; 8]);
        reader.handle_data(guid(1), i64::MAX, &[0; 8]);
        reader.remove(|_| true);
    }
    assert_eq!(reader.counts().lost, u64::MAX);
    assert_eq!(reader.counts().samples, 8);
}
