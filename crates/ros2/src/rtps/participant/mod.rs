//! A participant: its endpoints, what it sends, and when.

mod incoming;

use super::discovery::{EndpointData, PARTICIPANT, ParticipantData};
use super::qos::Qos;
use super::reader::Reader;
use super::wire::{Entity, Guid, Maker, Prefix, VENDOR};
use super::writer::{Outgoing, Writer};
use csi5300::time::{Instant, Span};
use std::collections::BTreeMap;
use std::net::SocketAddrV4;
use std::sync::Arc;

/// The lease that this participant announces.
const LEASE: Span = Span::from_ms(20_000);
/// Initial and later announcements: `(how many, how far apart)`.
const EAGER: (u32, Span) = (12, Span::from_ms(250));
/// See [`EAGER`].
const ANNOUNCE: Span = Span::from_ms(3_000);
/// Period of heartbeats while a reliable reader lacks samples.
const BEAT: Span = Span::from_ms(100);
/// How long an answer waits for the client's reader.
const PATIENCE: Span = Span::from_ms(1_000);
/// Answers that may wait.
const WAITING: usize = 64;
/// How often leases are checked.
const LOOK: Span = Span::from_ms(500);

/// Built-in endpoints (\[rtps\] 9.3.1.5): participants, publications, subscriptions.
const ANNOUNCER: Entity = [0, 1, 0, 0xc2];
const DETECTOR: Entity = [0, 1, 0, 0xc7];
const PUBLICATIONS: (Entity, Entity) = ([0, 0, 3, 0xc2], [0, 0, 3, 0xc7]);
const SUBSCRIPTIONS: (Entity, Entity) = ([0, 0, 4, 0xc2], [0, 0, 4, 0xc7]);

/// A participant's addresses, and where it announces them.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    /// Its identity.
    pub prefix: Prefix,
    /// Its name, for people.
    pub name: String,
    /// Where it receives discovery.
    pub meta: SocketAddrV4,
    /// Where it receives samples.
    pub user: SocketAddrV4,
    /// Where it announces itself: the group, and static peers.
    pub announce: Vec<SocketAddrV4>,
}

/// A received sample.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Event {
    /// The reader's number.
    pub reader: usize,
    /// Its writer, and its number there.
    pub from: (Guid, i64),
    /// The vendor of the writer's program.
    pub vendor: [u8; 2],
    /// The sample.
    pub payload: Vec<u8>,
}

/// Counters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Counts {
    /// Received datagrams.
    pub datagrams: u64,
    /// Those that are not RTPS, or are cut.
    pub malformed: u64,
    /// Invalid announcements.
    pub unreadable: u64,
    /// Known participants.
    pub participants: u64,
    /// Participants that went silent.
    pub expired: u64,
    /// Participants and endpoints refused because there are too many, in all or of one topic.
    pub refused: u64,
    /// Answers of services whose client's reader never appeared.
    pub unanswered: u64,
    /// Datagrams, or the rest of them, that were dropped because too many answers waited to be sent.
    pub left_out: u64,
}

/// The state of one of this participant's endpoints.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct TopicState {
    /// Matched endpoints of others.
    pub matched: usize,
    /// Samples that a reader received and lost.
    pub samples: u64,
    /// See `samples`.
    pub lost: u64,
    /// Why endpoints of the same topic do not match, as text.
    pub wrong: Vec<String>,
}

/// Another participant.
#[derive(Clone, Debug)]
struct Peer {
    data: ParticipantData,
    meta: SocketAddrV4,
    user: Option<SocketAddrV4>,
    heard_at: Instant,
}

/// A writer or reader of this participant, with its announcement.
#[derive(Debug)]
struct Own<T> {
    end: T,
    data: EndpointData,
    wrong: BTreeMap<Guid, &'static str>,
}

/// Why a compatible endpoint is not matched.
const NO_PLACE: &str = "there are too many of this topic";

impl<T> Own<T> {
    /// Notes an endpoint without a place; true if that is new.
    fn has_no_place_for(&mut self, guid: Guid) -> bool {
        self.wrong.insert(guid, NO_PLACE) != Some(NO_PLACE)
    }

    fn left_somebody_out(&self) -> bool {
        self.wrong.values().any(|why| *why == NO_PLACE)
    }
}

/// An answer whose reader is not yet known.
#[derive(Debug)]
struct Waiting {
    writer: usize,
    to: Prefix,
    payload: Arc<[u8]>,
    request: Option<(Guid, i64)>,
    until: Instant,
}

/// A participant.
#[derive(Debug)]
pub(crate) struct Participant {
    settings: Settings,
    writers: Vec<Own<Writer>>,
    readers: Vec<Own<Reader>>,
    publications: (Writer, Reader),
    subscriptions: (Writer, Reader),
    peers: BTreeMap<Prefix, Peer>,
    /// Others' endpoints: true for writers.
    others: BTreeMap<Guid, (bool, EndpointData)>,
    counts: Counts,
    /// Unreachable participants, and why.
    unreachable: BTreeMap<Prefix, String>,
    announced: (u32, Instant),
    beat_at: Instant,
    look_at: Instant,
    waiting: Vec<Waiting>,
    out: Vec<Outgoing>,
}

impl Participant {
    /// A participant that starts to announce itself at `now`.
    pub fn new(settings: Settings, now: Instant) -> Self {
        let own = settings.prefix;
        // The built-in writers keep as many samples as there are endpoints.
        let built_in = |(writer, reader): (Entity, Entity)| {
            (Writer::new(own, writer, Qos::latched(4_096)), Reader::new(own, reader, Qos::latched(4_096)))
        };
        Self {
            settings,
            writers: Vec::new(),
            readers: Vec::new(),
            publications: built_in(PUBLICATIONS),
            subscriptions: built_in(SUBSCRIPTIONS),
            peers: BTreeMap::new(),
            others: BTreeMap::new(),
            counts: Counts::default(),
            unreachable: BTreeMap::new(),
            announced: (0, now),
            beat_at: now,
            look_at: now,
            waiting: Vec::new(),
            out: Vec::new(),
        }
    }

    /// Its own name.
    pub fn guid(&self) -> Guid {
        Guid { prefix: self.settings.prefix, entity: PARTICIPANT }
    }

    /// Adds a writer of `topic`, with DDS names; returns its number and name.
    pub fn add_writer(&mut self, topic: &str, kind: &str, qos: Qos, wall_us: i64) -> (usize, Guid) {
        let number = self.writers.len();
        // Writers and readers without keys.
        let entity = entity(number, 0x03);
        let data = self.announced_as(entity, topic, kind, &qos);
        let guid = data.guid;
        self.publications.0.write(data.payload().into(), None, wall_us, &mut self.out);
        let end = Writer::new(self.settings.prefix, entity, qos);
        self.writers.push(Own { end, data, wrong: BTreeMap::new() });
        self.meet_all(false);
        (number, guid)
    }

    /// Adds a reader of `topic`, with the next number; returns its name.
    pub fn add_reader(&mut self, topic: &str, kind: &str, qos: Qos, wall_us: i64) -> Guid {
        let number = self.readers.len();
        let entity = entity(number, 0x04);
        let data = self.announced_as(entity, topic, kind, &qos);
        let guid = data.guid;
        self.subscriptions.0.write(data.payload().into(), None, wall_us, &mut self.out);
        let end = Reader::new(self.settings.prefix, entity, qos);
        self.readers.push(Own { end, data, wrong: BTreeMap::new() });
        self.meet_all(true);
        guid
    }

    fn announced_as(&self, entity: Entity, topic: &str, kind: &str, qos: &Qos) -> EndpointData {
        let guid = Guid { prefix: self.settings.prefix, entity };
        let unicast = vec![self.settings.user];
        EndpointData { guid, topic: topic.to_owned(), kind: kind.to_owned(), qos: qos.clone(), unicast }
    }

    /// Writes a sample.
    pub fn write(&mut self, writer: usize, payload: Arc<[u8]>, wall_us: i64) {
        if let Some(own) = self.writers.get_mut(writer) {
            own.end.write(payload, None, wall_us, &mut self.out);
        }
    }

    /// Writes an answer to participant `to`; `request` is what it answers, if that is sent beside the sample. A request may
    /// arrive before the client's reader is announced, and a volatile reader receives nothing written before it matched: then
    /// the answer waits.
    pub fn answer(
        &mut self,
        writer: usize,
        to: Prefix,
        (payload, request): (Arc<[u8]>, Option<(Guid, i64)>),
        (now, wall_us): (Instant, i64),
    ) {
        let Some(own) = self.writers.get_mut(writer) else { return };
        if own.end.has_reader_of(to) {
            own.end.write(payload, request, wall_us, &mut self.out);
        } else if self.waiting.len() < WAITING {
            self.waiting.push(Waiting { writer, to, payload, request, until: now + PATIENCE });
        } else {
            self.counts.unanswered += 1;
        }
    }

    /// Writes the answers whose readers are known by now.
    fn write_waiting(&mut self, wall_us: i64) {
        for waiting in std::mem::take(&mut self.waiting) {
            match self.writers.get_mut(waiting.writer).filter(|own| own.end.has_reader_of(waiting.to)) {
                Some(own) => own.end.write(waiting.payload, waiting.request, wall_us, &mut self.out),
                None => self.waiting.push(waiting),
            }
        }
    }

    /// Datagrams to send, with their destinations.
    pub fn poll_transmit(&mut self) -> Vec<Outgoing> {
        std::mem::take(&mut self.out)
    }

    /// When to call [`Self::handle_timeout`] next.
    pub fn next_at(&self) -> Instant {
        self.announced.1.min(self.beat_at).min(self.look_at)
    }

    /// Does what is due at `now`.
    pub fn handle_timeout(&mut self, now: Instant) {
        if now >= self.announced.1 {
            let data = self.announcement();
            self.out.extend(self.settings.announce.iter().map(|to| (*to, data.clone())));
            self.announced.0 = self.announced.0.saturating_add(1);
            self.announced.1 = now + if self.announced.0 < EAGER.0 { EAGER.1 } else { ANNOUNCE };
        }
        if now >= self.beat_at {
            let built_in = [&mut self.publications.0, &mut self.subscriptions.0];
            let all = built_in.into_iter().chain(self.writers.iter_mut().map(|own| &mut own.end));
            let mut out = Vec::new();
            all.for_each(|writer| writer.beat(&mut out));
            self.out.append(&mut out);
            self.beat_at = now + BEAT;
        }
        if now >= self.look_at {
            let silent = |peer: &&Peer| now - peer.heard_at > peer.data.lease;
            let gone: Vec<Prefix> = self.peers.values().filter(silent).map(|peer| peer.data.prefix).collect();
            self.counts.expired += gone.len() as u64;
            gone.into_iter().for_each(|prefix| self.forget(prefix));
            let waited = self.waiting.len();
            self.waiting.retain(|waiting| now < waiting.until);
            self.counts.unanswered += (waited - self.waiting.len()) as u64;
            self.meet_left_out();
            self.look_at = now + LOOK;
        }
    }

    fn announcement(&self) -> Vec<u8> {
        let Settings { prefix, name, meta, user, .. } = &self.settings;
        let (meta, user) = (vec![*meta], vec![*user]);
        let (is_ipv6, lease, name) = (false, LEASE, name.clone());
        let data = ParticipantData { prefix: *prefix, vendor: VENDOR, meta, user, is_ipv6, lease, name };
        Maker::new(*prefix, None).data((DETECTOR, ANNOUNCER), 1, &data.payload(), (None, None)).finish()
    }

    /// Moves to the addresses in `settings` and informs known participants; to the others it appears as a new one.
    pub fn move_to(&mut self, settings: Settings, wall_us: i64) {
        self.settings = Settings { prefix: self.settings.prefix, ..settings };
        self.announced = (0, Instant::ZERO);
        let announcement = self.announcement();
        self.out.extend(self.peers.values().map(|peer| (peer.meta, announcement.clone())));
        let unicast = vec![self.settings.user];
        for own in &mut self.writers {
            own.data.unicast.clone_from(&unicast);
            self.publications.0.write(own.data.payload().into(), None, wall_us, &mut self.out);
        }
        for own in &mut self.readers {
            own.data.unicast.clone_from(&unicast);
            self.subscriptions.0.write(own.data.payload().into(), None, wall_us, &mut self.out);
        }
    }

    /// Announces that this participant leaves.
    pub fn leave(&mut self) {
        let own = self.settings.prefix;
        let over = Some(Guid { prefix: own, entity: PARTICIPANT }.bytes());
        let words = Maker::new(own, None).data((DETECTOR, ANNOUNCER), 2, &[], (over, None)).finish();
        let peers = self.peers.values().map(|peer| peer.meta);
        let all = self.settings.announce.iter().copied().chain(peers);
        self.out.extend(all.map(|to| (to, words.clone())));
    }

    /// The state of a writer.
    pub fn writer_state(&self, writer: usize) -> TopicState {
        let Some(own) = self.writers.get(writer) else { return TopicState::default() };
        TopicState { matched: own.end.readers(), wrong: words(&own.wrong), ..TopicState::default() }
    }

    /// The state of a reader.
    pub fn reader_state(&self, reader: usize) -> TopicState {
        let Some(own) = self.readers.get(reader) else { return TopicState::default() };
        let counts = own.end.counts();
        let wrong = words(&own.wrong);
        TopicState { matched: own.end.writers(), samples: counts.samples, lost: counts.lost, wrong }
    }

    /// The counters.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Participants that announced themselves and cannot be reached.
    pub fn unreachable(&self) -> impl Iterator<Item = &str> {
        self.unreachable.values().map(String::as_str)
    }
}

/// Entity of this participant's writer or reader number `number`; 0 is reserved.
fn entity(number: usize, kind: u8) -> Entity {
    let [_, high, middle, low] = u32::try_from(number + 1).unwrap_or(u32::MAX).to_be_bytes();
    [high, middle, low, kind]
}

fn words(wrong: &BTreeMap<Guid, &'static str>) -> Vec<String> {
    let mut words: Vec<String> = wrong.values().map(|why| (*why).to_owned()).collect();
    words.dedup();
    words
}

#[cfg(test)]
mod attacks;
#[cfg(any(test, feature = "fuzzed"))]
pub mod fuzzed;
#[cfg(test)]
mod tests;
