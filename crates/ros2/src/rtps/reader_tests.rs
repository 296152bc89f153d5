use super::*;
use std::net::Ipv4Addr;

const TO: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7411);

fn guid(number: u8) -> Guid {
    Guid { prefix: [number; 12], entity: [0, 0, 1, 3] }
}

/// A reader with this many reliable writers.
fn with_writers(count: u8) -> Reader {
    let mut reader = Reader::new([200; 12], [0, 0, 1, 4], Qos::reliable(10));
    (0..count).for_each(|number| assert!(reader.add(guid(number), TO, true, &mut Vec::new())));
    reader
}

#[test]
fn waiting_bytes_are_bounded_and_dropped_samples_are_requested_again() {
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
    // A writer without waiting samples still delivers all of its own, and the others' room is free afterwards.
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
fn endless_ranges_are_requested_in_part_and_counted_without_overflow() {
    let mut reader = with_writers(1);
    let mut out = Vec::new();
    reader.handle_heartbeat(guid(0), (1, i64::MAX), false, &mut out);
    assert!(out.iter().all(|(_, bytes)| bytes.len() < 120), "one set of 256 numbers at most");
    for round in 0..4 {
        reader.handle_heartbeat(guid(0), (i64::MAX - 1, i64::MAX), false, &mut out);
        reader.handle_data(guid(0), i64::MAX, &[0; 8]);
        reader.handle_gap(guid(0), 1, &Numbers::of(i64::MAX - 1, [i64::MAX - 1, i64::MAX].into_iter()));
        assert!(reader.counts().lost > i64::MAX as u64 / 2 * (round + 1).min(3), "{:?}", reader.counts());
        // It leaves and returns.
        reader.remove(|_| true);
        assert!(reader.add(guid(0), TO, true, &mut out));
        reader.handle_heartbeat(guid(0), (1, 5), false, &mut out);
    }
    // Best effort.
    let mut reader = Reader::new([200; 12], [0, 0, 1, 4], Qos::best_effort(10));
    for _ in 0..4 {
        assert!(reader.add(guid(1), TO, false, &mut out));
        reader.handle_data(guid(1), 1, &[0; 8]);
        reader.handle_data(guid(1), i64::MAX, &[0; 8]);
        reader.remove(|_| true);
    }
    assert_eq!(reader.counts().lost, u64::MAX);
    assert_eq!(reader.counts().samples, 8);
}

/// A sample of `LARGEST` bytes, all `number`, in fragments of 60,000.
fn fragments(number: u8) -> impl Iterator<Item = (u32, Vec<u8>)> {
    let bytes = vec![number; LARGEST];
    let parts: Vec<Vec<u8>> = bytes.chunks(60_000).map(<[u8]>::to_vec).collect();
    (1..).zip(parts)
}

fn hand(reader: &mut Reader, from: u8, number: u8, (first, bytes): &(u32, Vec<u8>)) -> Vec<i64> {
    let fragment = Fragment { first: *first, size: 60_000, total: LARGEST as u32, bytes };
    let came = reader.handle_fragment(guid(from), i64::from(number), &fragment);
    came.iter()
        .for_each(|(number, bytes)| assert!(bytes.len() == LARGEST && bytes.iter().all(|b| *b == *number as u8)));
    came.into_iter().map(|(number, _)| number).collect()
}

#[test]
fn samples_with_interleaved_fragments_all_complete() {
    let mut reader = with_writers(1);
    let mut came = Vec::new();
    // A writer sends again what is missing, round by round; fragments of four samples alternate.
    let samples: Vec<Vec<(u32, Vec<u8>)>> = (1..=4).map(|number| fragments(number).collect()).collect();
    for k in (0..4).flat_map(|_| 0..samples[0].len()) {
        for (number, parts) in (1..).zip(&samples) {
            came.extend(hand(&mut reader, 0, number, &parts[k]));
        }
    }
    assert_eq!(came, [1, 2, 3, 4]);
    assert_eq!(reader.waiting(), 0);
    // Best-effort fragments are not sent again: the latest samples become complete, older ones are dropped.
    let mut reader = Reader::new([200; 12], [0, 0, 1, 4], Qos::best_effort(10));
    assert!(reader.add(guid(0), TO, false, &mut Vec::new()));
    (1..=3).for_each(|number| assert!(hand(&mut reader, 0, number, &fragments(number).next().unwrap()).is_empty()));
    let came: Vec<i64> = fragments(4).flat_map(|part| hand(&mut reader, 0, 4, &part)).collect();
    assert_eq!((came, reader.waiting()), (vec![4], 0));
}

#[test]
fn the_writer_with_most_waiting_bytes_gives_way() {
    let mut reader = with_writers(100);
    let bytes = vec![7; 60_000];
    // Strangers whose first sample never arrives fill all the room.
    for number in 1..100 {
        (2..=200).for_each(|sample| drop(reader.handle_data(guid(number), sample, &bytes)));
    }
    assert!(reader.waiting() > WAITING - 60_000);
    let came: Vec<i64> = fragments(1).flat_map(|part| hand(&mut reader, 0, 1, &part)).collect();
    assert_eq!(came, [1]);
    assert!(reader.waiting() <= WAITING);
    // A writer that filled it itself makes room for the sample that all the others wait for, and for no later one.
    let mut reader = with_writers(1);
    (2..=200).for_each(|sample| drop(reader.handle_data(guid(0), sample, &bytes)));
    let held = reader.writers[&guid(0)].held.len();
    let late = Fragment { first: 1, size: 60_000, total: LARGEST as u32, bytes: &bytes };
    assert!(reader.handle_fragment(guid(0), 250, &late).is_empty());
    assert_eq!((reader.writers[&guid(0)].held.len(), reader.writers[&guid(0)].parts.len()), (held, 0));
    let mut came = Vec::new();
    for (first, part) in fragments(1) {
        let fragment = Fragment { first, size: 60_000, total: LARGEST as u32, bytes: &part };
        came.extend(reader.handle_fragment(guid(0), 1, &fragment).into_iter().map(|(number, _)| number));
    }
    assert!(came.len() > 100 && came.iter().copied().eq(1..=came.len() as i64), "{came:?}");
}
