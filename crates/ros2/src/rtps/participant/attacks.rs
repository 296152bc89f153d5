//! What a stranger can make a participant do: send little and keep little.

use super::super::discovery::{EndpointData, ParticipantData};
use super::super::wire::Numbers;
use super::tests::{Net, WALL_US, at};
use super::*;
use std::net::Ipv4Addr;

const STRANGER: Prefix = [9; 12];

/// The announcement of participant `prefix`, which receives everything at `at`.
fn announcement(prefix: Prefix, at: SocketAddrV4) -> Vec<u8> {
    let (meta, user, lease) = (vec![at], vec![at], Span::from_ms(1 << 40));
    let data = ParticipantData { prefix, vendor: VENDOR, meta, user, is_ipv6: false, lease, name: String::new() };
    Maker::new(prefix, None).data((DETECTOR, ANNOUNCER), 1, &data.payload(), (None, None)).finish()
}

/// The announcement of a reader of the stranger.
fn reader_of(topic: &str, number: i64) -> Vec<u8> {
    let guid = Guid { prefix: STRANGER, entity: entity(number as usize, 4) };
    let (topic, kind) = (topic.to_owned(), "T".to_owned());
    let data = EndpointData { guid, topic, kind, qos: Qos::latched(10), unicast: Vec::new() };
    let ends = (SUBSCRIPTIONS.1, SUBSCRIPTIONS.0);
    Maker::new(STRANGER, None).data(ends, number, &data.payload(), (None, None)).finish()
}

fn hand(net: &mut Net, bytes: &[u8]) {
    let from = Ipv4Addr::new(127, 0, 0, 9);
    let mut events = Vec::new();
    net.all[0].handle_datagram(bytes, from, (net.now, WALL_US), &mut events);
}

/// Datagrams of the first participant within this many milliseconds.
fn sent(net: &mut Net, ms: i64) -> Vec<Outgoing> {
    let mut all = Vec::new();
    for _ in 0..ms / 10 {
        net.now += Span::from_ms(10);
        net.all[0].handle_timeout(net.now);
        all.extend(net.all[0].poll_transmit());
    }
    all
}

/// One participant that announces itself to nobody, with a topic of stored samples of 1,000 bytes.
fn alone() -> Net {
    let mut net = Net::new(1);
    net.all[0].add_writer("rt/a", "T", Qos::latched(300), WALL_US);
    (0..300).for_each(|_| net.all[0].write(0, Arc::from([0; 1_000]), WALL_US));
    net
}

#[test]
fn a_silent_stranger_is_sent_little_and_nobody_else_anything() {
    let mut net = alone();
    let (mut handed, mut out) = (0, Vec::new());
    for _ in 0..40 {
        // It announces somebody else's address.
        let bytes = announcement(STRANGER, at(77, 7410));
        handed += bytes.len();
        hand(&mut net, &bytes);
        out.extend(sent(&mut net, 3_000));
    }
    let size: usize = out.iter().map(|(_, bytes)| bytes.len()).sum();
    assert!(out.len() > 20, "it is spoken to: {}", out.len());
    assert!(out.iter().all(|(to, _)| *to == at(9, 7410)), "where it sent from, and nowhere else");
    assert!(size < 3 * handed, "{size} bytes for {handed}");
    // A stranger that sends only one announcement.
    let mut net = alone();
    let bytes = announcement(STRANGER, at(9, 7410));
    hand(&mut net, &bytes);
    let size: usize = sent(&mut net, 120_000).iter().map(|(_, bytes)| bytes.len()).sum();
    assert!(size < 20 * bytes.len(), "{size} bytes for {}", bytes.len());
}

#[test]
fn a_reader_that_was_silent_for_a_while_gets_what_it_missed() {
    let mut net = Net::new(2);
    net.all[0].add_writer("rt/a", "T", Qos::latched(10), WALL_US);
    net.all[1].add_reader("rt/a", "T", Qos::latched(10), WALL_US);
    net.run(1_000);
    net.lose = |_| true;
    net.write(0, 0, 5);
    // Longer than heartbeats continue, shorter than its lease.
    net.run(10_000);
    net.lose = |_| false;
    net.run(4_000);
    assert_eq!(net.came(1), [5]);
}

#[test]
fn endless_requests_are_answered_at_the_heartbeat_rate() {
    let mut net = alone();
    hand(&mut net, &announcement(STRANGER, at(9, 7410)));
    hand(&mut net, &reader_of("rt/a", 1));
    sent(&mut net, 200);
    assert_eq!(net.all[0].writer_state(0).matched, 1);
    let ends = (entity(1, 4), entity(0, 3));
    for count in 1..=1_000 {
        let missing = Numbers::of(1, 1..=200);
        hand(&mut net, &Maker::new(STRANGER, None).acknack(ends, &missing, count, false).finish());
    }
    let again = net.all[0].poll_transmit().into_iter().filter(|(_, bytes)| bytes.len() > 1_000).count();
    assert_eq!(again, 64, "for a thousand questions");
    sent(&mut net, 200);
    hand(&mut net, &Maker::new(STRANGER, None).acknack(ends, &Numbers::of(1, 1..=9), 1_001, false).finish());
    let again = net.all[0].poll_transmit().into_iter().filter(|(_, bytes)| bytes.len() > 1_000).count();
    assert_eq!(again, 9, "and it goes on");
}

#[test]
fn a_datagram_full_of_heartbeats_gets_a_bounded_answer() {
    let mut net = alone();
    hand(&mut net, &announcement(STRANGER, at(9, 7410)));
    net.all[0].poll_transmit();
    let ends = (PUBLICATIONS.1, PUBLICATIONS.0);
    let range = |k: i64| (k + 1, i64::MAX);
    let made =
        (0..1_500_i64).fold(Maker::new(STRANGER, None), |made, k| made.heartbeat(ends, range(k), k as u32, false));
    let bytes = made.finish();
    assert!(bytes.len() < 1 << 16);
    (0..64).for_each(|_| hand(&mut net, &bytes));
    let out = net.all[0].poll_transmit();
    assert!((1_000..5_000).contains(&out.len()), "{}", out.len());
    assert!(net.all[0].counts().left_out > 50);
    // It can be reached as before.
    hand(&mut net, &reader_of("rt/a", 1));
    assert_eq!(net.all[0].writer_state(0).matched, 1);
}

#[test]
fn overlong_names_are_not_stored_and_readers_are_bounded() {
    let mut net = alone();
    hand(&mut net, &announcement(STRANGER, at(9, 7410)));
    hand(&mut net, &reader_of(&"x".repeat(60_000), 1));
    assert_eq!((net.all[0].counts().unreadable, net.all[0].others.len()), (1, 0));
    // A reliable writer's sample numbers: the previous one was accepted.
    for number in 2..10_000 {
        hand(&mut net, &reader_of("rt/a", number));
        net.all[0].poll_transmit();
    }
    assert_eq!(net.all[0].writer_state(0).matched, 256);
    assert!(net.all[0].others.len() <= 8_192 && net.all[0].counts().refused > 1_000);
}

/// The announcement of writer `number` of participant `prefix`, from 1.
fn writer_of(prefix: Prefix, number: i64) -> Vec<u8> {
    let guid = Guid { prefix, entity: entity(number as usize, 3) };
    let (topic, kind) = ("rt/a".to_owned(), "T".to_owned());
    let data = EndpointData { guid, topic, kind, qos: Qos::reliable(10), unicast: Vec::new() };
    let ends = (PUBLICATIONS.1, PUBLICATIONS.0);
    Maker::new(prefix, None).data(ends, number, &data.payload(), (None, None)).finish()
}

#[test]
fn an_endpoint_over_the_limit_is_counted_and_matched_once_one_leaves() {
    let mut net = Net::new(1);
    net.all[0].add_reader("rt/a", "T", Qos::reliable(10), WALL_US);
    // Two writers in each of 65 participants.
    let strangers: Vec<Prefix> = (0..65).map(|k| [100 + k; 12]).collect();
    for prefix in &strangers {
        hand(&mut net, &announcement(*prefix, at(9, 7410)));
        (1..=2).for_each(|number| hand(&mut net, &writer_of(*prefix, number)));
        net.all[0].poll_transmit();
    }
    let state = net.all[0].reader_state(0);
    assert_eq!((state.matched, net.all[0].counts().refused), (128, 2));
    assert!(state.wrong.iter().any(|why| why.contains("too many")), "{:?}", state.wrong);
    // It is checked repeatedly but counted once.
    sent(&mut net, 2_000);
    assert_eq!(net.all[0].counts().refused, 2);
    net.all[0].forget(strangers[0]);
    sent(&mut net, 600);
    let state = net.all[0].reader_state(0);
    assert_eq!((state.matched, state.wrong), (128, vec![]));
}
