//! The body of a fuzz target: other participants take arbitrary steps. The participant sends only to addresses from which it
//! received something, and what it keeps is bounded.
//!
//! The input is a list of `operation, who, length (2 bytes), bytes`; see [`step`].

use super::super::discovery::{EndpointData, ParticipantData};
use super::super::reader::WAITING;
use super::*;
use std::collections::BTreeSet;
use std::net::Ipv4Addr;

const OWN: Prefix = [1; 12];
const WALL_US: i64 = 1_700_000_000_000_000;
/// Number of other participants.
const OTHERS: u8 = 6;

/// A participant, its time, and the addresses that have sent to it.
struct Fuzzed {
    participant: Participant,
    now: Instant,
    heard: BTreeSet<Ipv4Addr>,
}

/// The address of another participant.
fn ip(who: u8) -> Ipv4Addr {
    Ipv4Addr::new(127, 0, 0, 2 + who % OTHERS)
}

fn prefix(who: u8) -> Prefix {
    [2 + who % OTHERS; 12]
}

/// Another participant's announcement of itself.
fn announcement(who: u8) -> Vec<u8> {
    let at = vec![SocketAddrV4::new(ip(who), 7410)];
    let (prefix, lease) = (prefix(who), Span::from_ms(10_000));
    let data = ParticipantData {
        prefix,
        vendor: VENDOR,
        meta: at.clone(),
        user: at,
        is_ipv6: false,
        lease,
        name: String::new(),
    };
    announced(prefix, &data.payload())
}

/// Another participant's announcement of a writer or reader.
fn end(who: u8, is_writer: bool, number: u8) -> Vec<u8> {
    let kind = if is_writer { 3 } else { 4 };
    let guid = Guid { prefix: prefix(who), entity: entity(usize::from(number), kind) };
    let qos = if number.is_multiple_of(2) { Qos::reliable(10) } else { Qos::best_effort(10) };
    let (topic, kind) = ("rt/a".to_owned(), "T".to_owned());
    let data = EndpointData { guid, topic, kind, qos, unicast: Vec::new() };
    let (writer, reader) = BUILT_IN[usize::from(!is_writer)];
    let made = Maker::new(prefix(who), None);
    made.data((reader, writer), i64::from(number) + 1, &data.payload(), (None, None)).finish()
}

impl Fuzzed {
    fn new() -> Self {
        let at = |port| SocketAddrV4::new(Ipv4Addr::LOCALHOST, port);
        let (name, announce) = ("fuzzed".to_owned(), Vec::new());
        let settings = Settings { prefix: OWN, name, meta: at(7410), user: at(7411), announce };
        let mut participant = Participant::new(settings, Instant::ZERO);
        participant.add_reader("rt/a", "T", Qos::reliable(10), WALL_US);
        participant.add_reader("rt/a", "T", Qos::best_effort(10), WALL_US);
        participant.add_writer("rt/a", "T", Qos::latched(5), WALL_US);
        Self { participant, now: Instant::ZERO, heard: BTreeSet::new() }
    }

    /// One step: time passes; another participant sends a datagram, submessages or an announcement; or a sample is written here.
    fn step(&mut self, operation: u8, who: u8, bytes: &[u8]) {
        match operation % 8 {
            0 => {
                self.now += Span::from_ms(20 * i64::from(who));
                self.participant.handle_timeout(self.now);
            }
            1 => self.hand(who, bytes),
            2 | 3 => self.hand(who, &[&Maker::new(prefix(who), None).finish(), bytes].concat()),
            4 => self.hand(who, &announcement(who)),
            5 => self.hand(who, &end(who, true, bytes.first().copied().unwrap_or(0))),
            6 => self.hand(who, &end(who, false, bytes.first().copied().unwrap_or(0))),
            _ => self.participant.write(0, bytes.into(), WALL_US),
        }
        let spoken: Vec<Ipv4Addr> = self.participant.poll_transmit().iter().map(|(to, _)| *to.ip()).collect();
        assert!(spoken.iter().all(|to| self.heard.contains(to)), "{spoken:?} of {:?}", self.heard);
    }

    fn hand(&mut self, who: u8, bytes: &[u8]) {
        self.heard.insert(ip(who));
        let mut events = Vec::new();
        self.participant.handle_datagram(bytes, ip(who), (self.now, WALL_US), &mut events);
        assert!(events.iter().all(|event| event.reader < 2 && event.from.1 > 0));
        let readers = self.participant.readers.iter().map(|own| &own.end);
        let built_in = self.participant.built_in.iter().map(|(_, reader)| reader);
        for reader in readers.chain(built_in) {
            assert!(reader.waiting() <= WAITING && reader.writers() <= 128);
        }
        assert!(self.participant.counts.participants <= 128 && self.participant.others.len() <= 8_192);
    }
}

/// Runs the target.
pub fn run(bytes: &[u8]) {
    let (mut rest, mut fuzzed) = (bytes, Fuzzed::new());
    while let Some((&[operation, who, low, high], behind)) = rest.split_first_chunk() {
        let (part, behind) = behind.split_at(behind.len().min(usize::from(u16::from_le_bytes([low, high]))));
        fuzzed.step(operation, who, part);
        rest = behind;
    }
}

#[cfg(test)]
#[path = "../../../../../tests/common/corpus.rs"]
mod corpus;

/// What two participants send each other, as input of the target: a writer and its matching reader, samples, some lost
/// datagrams, and a departure.
#[cfg(test)]
fn simulated(lose: impl Fn(usize) -> bool) -> Vec<u8> {
    let settings = |prefix: Prefix, ip: Ipv4Addr, other: Ipv4Addr| {
        let at = |port| SocketAddrV4::new(ip, port);
        let announce = vec![SocketAddrV4::new(other, 7410)];
        Settings { prefix, name: String::new(), meta: at(7410), user: at(7411), announce }
    };
    let (one, two) = (Ipv4Addr::LOCALHOST, ip(0));
    let mut all =
        [settings(OWN, one, two), settings(prefix(0), two, one)].map(|it| Participant::new(it, Instant::ZERO));
    all[0].add_reader("rt/a", "T", Qos::reliable(10), WALL_US);
    all[0].add_reader("rt/a", "T", Qos::best_effort(10), WALL_US);
    all[0].add_writer("rt/a", "T", Qos::latched(5), WALL_US);
    all[1].add_reader("rt/a", "T", Qos::latched(10), WALL_US);
    all[1].add_writer("rt/a", "T", Qos::latched(5), WALL_US);
    let (mut input, mut sent, mut events, mut now) = (Vec::new(), 0, Vec::new(), Instant::ZERO);
    for round in 0..40_u8 {
        now += Span::from_ms(20);
        input.extend([0, 1, 0, 0]);
        if round % 8 == 4 {
            all[0].write(0, Arc::from([round; 8]), WALL_US);
            input.extend([7, 0, 8, 0].into_iter().chain([round; 8]));
            all[1].write(0, Arc::from([round; 8]), WALL_US);
        }
        if round == 38 {
            all[1].leave();
        }
        for k in 0..2 {
            all[k].handle_timeout(now);
            for (_, bytes) in all[k].poll_transmit() {
                sent += 1;
                let from = if k == 0 { one } else { two };
                if !lose(sent) {
                    all[1 - k].handle_datagram(&bytes, from, (now, WALL_US), &mut events);
                    if k == 1 {
                        input.extend([1, 0]);
                        input.extend((bytes.len() as u16).to_le_bytes());
                        input.extend(bytes);
                    }
                }
            }
        }
    }
    assert!(events.iter().any(|event| event.payload == [36; 8]), "{events:?}");
    input
}

#[cfg(test)]
#[test]
fn arbitrary_steps_of_others() {
    for lossy in [false, true] {
        let input = simulated(|sent| lossy && sent % 5 == 3);
        run(&input);
        // Changes one byte in seventy, different ones each time.
        for start in 0..10 {
            let mut damaged = input.clone();
            damaged.iter_mut().skip(start).step_by(10 * 7).for_each(|byte| *byte = byte.wrapping_add(1 + start as u8));
            run(&damaged);
        }
    }
    corpus::replay("rtps", run);
}
