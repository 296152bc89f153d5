//! Participants that exchange datagrams, and what a stranger can make one do: send little and keep little.

use super::super::wire::Numbers;
use super::*;
use std::net::Ipv4Addr;

const WALL_US: i64 = 1_700_000_000_000_000;

fn at(last: u8, port: u16) -> SocketAddrV4 {
    SocketAddrV4::new(Ipv4Addr::new(127, 0, 0, last), port)
}

/// Participants that exchange datagrams; those that `lose` selects are lost.
struct Net {
    all: Vec<Participant>,
    now: Instant,
    events: Vec<Vec<Event>>,
    lose: fn(usize) -> bool,
    sent: usize,
    /// Last bytes of the participants' addresses.
    places: Vec<u8>,
}

impl Net {
    fn new(count: u8) -> Self {
        let address = |k: u8| at(k + 1, 7410);
        let one = |k: u8| {
            let announce = (0..count).filter(|other| *other != k).map(address).collect();
            let settings = Settings {
                prefix: [k + 1; 12],
                name: format!("p{k}"),
                meta: address(k),
                user: at(k + 1, 7411),
                announce,
            };
            Participant::new(settings, Instant::ZERO)
        };
        let all = (0..count).map(one).collect();
        let events = (0..count).map(|_| Vec::new()).collect();
        Self { all, now: Instant::ZERO, events, lose: |_| false, sent: 0, places: (1..=count).collect() }
    }

    /// Two, of which the first writes a topic that the second reads.
    fn of_topic(written: Qos, read: Qos) -> Self {
        let mut net = Self::new(2);
        net.all[0].add_writer("rt/a", "T", written, WALL_US);
        net.all[1].add_reader("rt/a", "T", read, WALL_US);
        net
    }

    /// Runs this many milliseconds, in steps of ten.
    fn run(&mut self, ms: i64) {
        for _ in 0..ms / 10 {
            self.now += Span::from_ms(10);
            for k in 0..self.all.len() {
                self.all[k].handle_timeout(self.now);
                for (to, bytes) in self.all[k].poll_transmit() {
                    self.sent += 1;
                    let other = self.places.iter().position(|place| *place == to.ip().octets()[3]);
                    if let Some(other) = other.filter(|_| !(self.lose)(self.sent)) {
                        let from = Ipv4Addr::new(127, 0, 0, self.places[k]);
                        self.all[other].handle_datagram(&bytes, from, (self.now, WALL_US), &mut self.events[other]);
                    }
                }
            }
        }
    }

    fn write(&mut self, participant: usize, writer: usize, sample: u8) {
        self.all[participant].write(writer, Arc::from([0, 1, 0, 0, sample]), WALL_US);
    }

    /// Last bytes of the received samples.
    fn came(&self, participant: usize) -> Vec<u8> {
        self.events[participant].iter().map(|event| event.payload[4]).collect()
    }
}

#[test]
fn samples_arrive_in_order_with_a_quarter_of_datagrams_lost() {
    let mut net = Net::of_topic(Qos::reliable(300), Qos::reliable(10));
    // A quarter, in a pattern that no exchange can follow.
    net.lose = |k| (k as u32).wrapping_mul(2_654_435_761) >> 16 & 3 == 0;
    net.run(3_000);
    assert_eq!((net.all[0].writer_state(0).matched, net.all[1].reader_state(0).matched), (1, 1));
    (0..200).for_each(|k| {
        net.write(0, 0, k);
        net.run(10);
    });
    net.run(3_000);
    assert_eq!(net.came(1), (0..200).collect::<Vec<u8>>());
    assert_eq!(net.all[1].reader_state(0).lost, 0);
}

#[test]
fn late_readers_get_only_latched_samples() {
    let mut net = Net::new(2);
    net.all[0].add_writer("rt/latched", "T", Qos::latched(2), WALL_US);
    net.all[0].add_writer("rt/plain", "T", Qos::reliable(10), WALL_US);
    (0..5).for_each(|k| {
        net.write(0, 0, k);
        net.write(0, 1, 100 + k);
    });
    net.run(500);
    net.all[1].add_reader("rt/latched", "T", Qos::latched(10), WALL_US);
    net.all[1].add_reader("rt/plain", "T", Qos::reliable(10), WALL_US);
    net.run(2_000);
    assert_eq!(net.came(1), [3, 4], "the two that are kept");
    net.write(0, 1, 42);
    net.run(500);
    assert_eq!(net.came(1), [3, 4, 42]);
}

#[test]
fn an_answer_waits_for_the_clients_reader_and_arrives_once() {
    let mut net = Net::new(3);
    net.all[0].add_writer("rr/aReply", "T", Qos::reliable(10), WALL_US);
    // Another client of this service.
    net.all[2].add_reader("rr/aReply", "T", Qos::reliable(10), WALL_US);
    net.run(1_000);
    let answer = |net: &mut Net, sample| {
        let request = (Guid { prefix: [2; 12], entity: [0, 0, 1, 3] }, i64::from(sample));
        let answer = (Arc::from([0, 1, 0, 0, sample]), Some(request));
        net.all[0].answer(0, [2; 12], answer, (net.now, WALL_US));
    };
    answer(&mut net, 9);
    net.run(100);
    assert!(net.came(2).is_empty(), "it is not written before it can be read");
    net.all[1].add_reader("rr/aReply", "T", Qos::reliable(10), WALL_US);
    net.run(1_000);
    assert_eq!((net.came(1), net.came(2)), (vec![9], vec![9]));
    answer(&mut net, 10);
    net.run(100);
    assert_eq!(net.came(1), [9, 10], "once its reader is known it does not wait");
    assert_eq!(net.all[0].counts.unanswered, 0);
    // An unread answer is given up and counted, and the number of waiting answers is bounded.
    let nobody = |net: &mut Net| {
        let answer = (Arc::from([0, 1, 0, 0, 7]), None);
        net.all[0].answer(0, [9; 12], answer, (net.now, WALL_US));
    };
    (0..WAITING + 5).for_each(|_| nobody(&mut net));
    assert_eq!(net.all[0].counts.unanswered, 5);
    net.run(2_000);
    assert_eq!(net.all[0].counts.unanswered, WAITING as u64 + 5);
    assert_eq!(net.came(1), [9, 10]);
}

#[test]
fn a_slow_reader_learns_of_lost_samples_and_continues() {
    let mut net = Net::of_topic(Qos::reliable(4), Qos::reliable(10));
    net.run(2_000);
    net.write(0, 0, 0);
    net.run(500);
    net.lose = |_| true;
    (1..=20).for_each(|k| {
        net.write(0, 0, k);
        net.run(10);
    });
    net.lose = |_| false;
    net.run(1_000);
    assert_eq!(net.came(1), [0, 17, 18, 19, 20]);
    assert_eq!(net.all[1].reader_state(0).lost, 16);
}

#[test]
fn incompatible_endpoints_report_the_reason() {
    let mut net = Net::new(2);
    net.all[0].add_writer("rt/csi", "T", Qos::best_effort(5), WALL_US);
    net.all[0].add_writer("rt/other", "T", Qos::reliable(5), WALL_US);
    net.all[1].add_reader("rt/csi", "T", Qos::reliable(5), WALL_US);
    net.all[1].add_reader("rt/other", "U", Qos::reliable(5), WALL_US);
    net.run(2_000);
    for (topic, why) in [(0, "best effort"), (1, "another type")] {
        for state in [net.all[0].writer_state(topic), net.all[1].reader_state(topic)] {
            assert_eq!(state.matched, 0);
            assert!(state.wrong[0].contains(why), "{:?}", state.wrong);
        }
    }
}

#[test]
fn a_departure_takes_effect_at_once_and_a_death_after_the_lease() {
    let mut net = Net::new(3);
    for k in 1..3 {
        net.all[k].add_writer("rt/a", "T", Qos::reliable(5), WALL_US);
    }
    net.all[0].add_reader("rt/a", "T", Qos::best_effort(5), WALL_US);
    net.run(4_000);
    assert_eq!((net.all[0].counts.participants, net.all[0].reader_state(0).matched), (2, 2));
    net.all[1].leave();
    net.run(20);
    assert_eq!((net.all[0].counts.participants, net.all[0].reader_state(0).matched), (1, 1));
    net.lose = |_| true;
    net.run(25_000);
    let counts = net.all[0].counts;
    assert_eq!((counts.participants, counts.expired, net.all[0].reader_state(0).matched), (0, 1, 0));
    net.lose = |_| false;
    net.run(5_000);
    assert_eq!(net.all[0].reader_state(0).matched, 2, "who is heard again is there again");
}

#[test]
fn a_new_address_is_used_at_once_and_loses_nothing_reliable() {
    let mut net = Net::new(2);
    // Both directions: the one that moves writes and reads.
    net.all[0].add_writer("rt/a", "T", Qos::reliable(300), WALL_US);
    net.all[1].add_reader("rt/a", "T", Qos::reliable(10), WALL_US);
    net.all[1].add_writer("rt/b", "T", Qos::reliable(300), WALL_US);
    net.all[0].add_reader("rt/b", "T", Qos::reliable(10), WALL_US);
    net.run(1_000);
    let exchange = |net: &mut Net, samples: std::ops::Range<u8>| {
        for k in samples {
            (0..2).for_each(|one| net.write(one, 0, k));
            net.run(10);
        }
    };
    exchange(&mut net, 0..50);
    // The old address is gone: whatever is sent there is lost.
    net.places[0] = 9;
    exchange(&mut net, 50..100);
    let settings = |last| Settings {
        prefix: [77; 12],
        name: "p0".into(),
        meta: at(last, 7410),
        user: at(last, 7411),
        announce: vec![at(2, 7410)],
    };
    net.all[0].move_to(settings(9), WALL_US);
    assert_eq!(net.all[0].guid().prefix, [1; 12], "it is the same one");
    exchange(&mut net, 100..150);
    net.run(1_000);
    let all: Vec<u8> = (0..150).collect();
    assert_eq!((net.came(0), net.came(1)), (all.clone(), all));
    assert_eq!(net.all[1].counts.participants, 1);
    // The first announcement of the next address is lost; those of the endpoints come.
    net.places[0] = 8;
    net.all[0].move_to(settings(8), WALL_US);
    for (_, bytes) in net.all[0].poll_transmit().iter().skip(1) {
        let from = Ipv4Addr::new(127, 0, 0, 8);
        net.all[1].handle_datagram(bytes, from, (net.now, WALL_US), &mut net.events[1]);
    }
    net.run(2_000);
    exchange(&mut net, 150..200);
    net.run(1_000);
    let all: Vec<u8> = (0..200).collect();
    assert_eq!((net.came(0), net.came(1)), (all.clone(), all));
}

#[test]
fn damaged_datagrams_and_fake_participants_are_counted_and_bounded() {
    let mut net = Net::of_topic(Qos::reliable(5), Qos::reliable(5));
    net.run(1_000);
    net.write(0, 0, 1);
    let mut seed = 7_u32;
    for (_, bytes) in net.all[0].poll_transmit() {
        for _ in 0..5_000 {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let (mut damaged, place) = (bytes.clone(), seed as usize >> 8);
            let length = damaged.len();
            // Behind the name of the sender.
            damaged[20 + place % (length - 20)] = (seed >> 3) as u8;
            damaged.truncate(20 + (seed as usize >> 5) % (length - 19));
            net.all[1].handle_datagram(&damaged, Ipv4Addr::LOCALHOST, (net.now, WALL_US), &mut net.events[1]);
        }
    }
    assert!(net.all[1].counts.malformed > 0);
    for k in 0..2_000_u32 {
        let mut prefix = [9; 12];
        prefix[..4].copy_from_slice(&k.to_le_bytes());
        let made = announcement(prefix, at(9, 7410));
        net.all[1].handle_datagram(&made, Ipv4Addr::LOCALHOST, (net.now, WALL_US), &mut net.events[1]);
        net.all[1].poll_transmit();
    }
    assert!(net.all[1].counts.participants <= 128);
    assert_eq!(net.all[1].reader_state(0).matched, 1, "the one that goes with a topic here is kept");
}

#[test]
fn a_fragmented_sample_is_assembled() {
    let mut net = Net::of_topic(Qos::reliable(5), Qos::best_effort(5));
    net.run(1_000);
    let sample: Vec<u8> = (0..50).collect();
    let fragment = |first: u32, bytes: &[u8]| {
        let mut made = Maker::new([1; 12], None).finish();
        let ends = [0, 0, 1, 4, 0, 0, 1, 3];
        let body = [
            &[0, 0, 28, 0][..],
            &ends,
            &0_i32.to_le_bytes(),
            &1_u32.to_le_bytes(),
            &first.to_le_bytes(),
            &1_u16.to_le_bytes(),
            &20_u16.to_le_bytes(),
            &50_u32.to_le_bytes(),
            bytes,
        ];
        let body = body.concat();
        made.extend([&[0x16, 1][..], &(body.len() as u16).to_le_bytes(), &body].concat());
        made
    };
    for (first, part) in [(3, &sample[40..]), (1, &sample[..20]), (1, &sample[..20]), (2, &sample[20..40])] {
        assert!(net.events[1].is_empty());
        let datagram = fragment(first, part);
        net.all[1].handle_datagram(&datagram, Ipv4Addr::LOCALHOST, (net.now, WALL_US), &mut net.events[1]);
    }
    assert_eq!(net.events[1].len(), 1);
    assert_eq!(net.events[1][0].payload, sample);
}

#[test]
fn an_ipv6_only_participant_is_named() {
    let mut net = Net::new(1);
    let announced_by = |prefix: u8, ids: &[u8]| {
        let (meta, user, lease) = (vec![at(9, 7410)], vec![at(9, 7411)], LEASE);
        let name = format!("p{prefix}");
        let prefix = [prefix; 12];
        let data = ParticipantData { prefix, vendor: VENDOR, meta, user, is_ipv6: false, lease, name };
        let mut payload = data.payload();
        for at in 0..payload.len() - 4 {
            // The number of the parameter, its length, and the kind of address.
            if ids.contains(&payload[at]) && payload[at + 1..at + 8] == [0, 24, 0, 1, 0, 0, 0] {
                payload[at + 4] = 2;
            }
        }
        announced(prefix, &payload)
    };
    for (prefix, ids) in [(7, &[0x32, 0x31][..]), (8, &[0x31]), (9, &[])] {
        let from = (net.now, WALL_US);
        net.all[0].handle_datagram(&announced_by(prefix, ids), Ipv4Addr::new(127, 0, 0, 9), from, &mut net.events[0]);
    }
    let named: Vec<&str> = net.all[0].unreachable().collect();
    let expected = ["p7 at 127.0.0.9 announces only IPv6 addresses", "p8 at 127.0.0.9 announces only IPv6 addresses"];
    assert_eq!((named, net.all[0].counts.unreadable), (expected.to_vec(), 0));
}

const STRANGER: Prefix = [9; 12];

/// The announcement of participant `prefix`, which receives everything at `at`.
fn announcement(prefix: Prefix, at: SocketAddrV4) -> Vec<u8> {
    let (meta, user, lease) = (vec![at], vec![at], Span::from_ms(1 << 40));
    let data = ParticipantData { prefix, vendor: VENDOR, meta, user, is_ipv6: false, lease, name: String::new() };
    announced(prefix, &data.payload())
}

/// The announcement of a reader of the stranger.
fn reader_of(topic: &str, number: i64) -> Vec<u8> {
    let guid = Guid { prefix: STRANGER, entity: entity(number as usize, 4) };
    let (topic, kind) = (topic.to_owned(), "T".to_owned());
    let data = EndpointData { guid, topic, kind, qos: Qos::latched(10), unicast: Vec::new() };
    let ends = (BUILT_IN[1].1, BUILT_IN[1].0);
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
    let mut net = Net::of_topic(Qos::latched(10), Qos::latched(10));
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
    let ends = (BUILT_IN[0].1, BUILT_IN[0].0);
    let range = |k: i64| (k + 1, i64::MAX);
    let made =
        (0..1_500_i64).fold(Maker::new(STRANGER, None), |made, k| made.heartbeat(ends, range(k), k as u32, false));
    let bytes = made.finish();
    assert!(bytes.len() < 1 << 16);
    (0..64).for_each(|_| hand(&mut net, &bytes));
    let out = net.all[0].poll_transmit();
    assert!((1_000..5_000).contains(&out.len()), "{}", out.len());
    assert!(net.all[0].counts.left_out > 50);
    // It can be reached as before.
    hand(&mut net, &reader_of("rt/a", 1));
    assert_eq!(net.all[0].writer_state(0).matched, 1);
}

#[test]
fn overlong_names_are_not_stored_and_readers_are_bounded() {
    let mut net = alone();
    hand(&mut net, &announcement(STRANGER, at(9, 7410)));
    hand(&mut net, &reader_of(&"x".repeat(60_000), 1));
    assert_eq!((net.all[0].counts.unreadable, net.all[0].others.len()), (1, 0));
    // A reliable writer's sample numbers: the previous one was accepted.
    for number in 2..10_000 {
        hand(&mut net, &reader_of("rt/a", number));
        net.all[0].poll_transmit();
    }
    assert_eq!(net.all[0].writer_state(0).matched, 256);
    assert!(net.all[0].others.len() <= 8_192 && net.all[0].counts.refused > 1_000);
}

/// The announcement of writer `number` of participant `prefix`, from 1.
fn writer_of(prefix: Prefix, number: i64) -> Vec<u8> {
    let guid = Guid { prefix, entity: entity(number as usize, 3) };
    let (topic, kind) = ("rt/a".to_owned(), "T".to_owned());
    let data = EndpointData { guid, topic, kind, qos: Qos::reliable(10), unicast: Vec::new() };
    let ends = (BUILT_IN[0].1, BUILT_IN[0].0);
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
    assert_eq!((state.matched, net.all[0].counts.refused), (128, 2));
    assert!(state.wrong.iter().any(|why| why.contains("too many")), "{:?}", state.wrong);
    // It is checked repeatedly but counted once.
    sent(&mut net, 2_000);
    assert_eq!(net.all[0].counts.refused, 2);
    net.all[0].forget(strangers[0]);
    sent(&mut net, 600);
    let state = net.all[0].reader_state(0);
    assert_eq!((state.matched, state.wrong), (128, vec![]));
}
