//! A participant: its endpoints, what it sends and when, known participants and matched endpoints.

#[cfg(any(test, feature = "fuzzed"))]
pub mod fuzzed;
#[cfg(test)]
mod tests;

use super::discovery::{EndpointData, PARTICIPANT, ParticipantData, Qos, key, key_payload};
use super::reader::{Came, Reader};
use super::wire::{ANY, Body, Datagram, Entity, Guid, Inline, Maker, Prefix, Submessage, VENDOR};
use super::writer::{Outgoing, Writer};
use csi5300::time::{Instant, Span};
use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddrV4};
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

/// Participants that are kept at most.
const PARTICIPANTS: usize = 128;
/// Endpoints of other participants that are kept at most.
const ENDPOINTS: usize = 8_192;
/// Answers that may wait to be sent: datagrams that arrive beyond it are dropped.
const ANSWERS: usize = 4_096;

/// Built-in endpoints (\[rtps\] 9.3.1.5): participants; publications, then subscriptions.
const ANNOUNCER: Entity = [0, 1, 0, 0xc2];
const DETECTOR: Entity = [0, 1, 0, 0xc7];
const BUILT_IN: [(Entity, Entity); 2] = [([0, 0, 3, 0xc2], [0, 0, 3, 0xc7]), ([0, 0, 4, 0xc2], [0, 0, 4, 0xc7])];

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
    /// Matches a compatible endpoint by `add`, which is false if there are too many, and notes why there is no match. True if a
    /// compatible one has no place now.
    fn meet(&mut self, guid: Guid, wrong: Option<&'static str>, add: impl FnOnce(&mut T) -> bool) -> bool {
        let why = wrong.or_else(|| (!add(&mut self.end)).then_some(NO_PLACE));
        let before = match why {
            Some(why) => self.wrong.insert(guid, why),
            None => self.wrong.remove(&guid),
        };
        why == Some(NO_PLACE) && before != why
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
    /// Of publications, and of subscriptions.
    built_in: [(Writer, Reader); 2],
    peers: BTreeMap<Prefix, Peer>,
    /// Others' endpoints: true for writers.
    others: BTreeMap<Guid, (bool, EndpointData)>,
    pub counts: Counts,
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
            built_in: BUILT_IN.map(built_in),
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
        let data = self.announce_end(0, entity(number, 0x03), (topic, kind, &qos), wall_us);
        let (guid, end) = (data.guid, Writer::new(self.settings.prefix, data.guid.entity, qos));
        self.writers.push(Own { end, data, wrong: BTreeMap::new() });
        self.meet_all(false);
        (number, guid)
    }

    /// Adds a reader of `topic`, with the next number; returns its name.
    pub fn add_reader(&mut self, topic: &str, kind: &str, qos: Qos, wall_us: i64) -> Guid {
        let data = self.announce_end(1, entity(self.readers.len(), 0x04), (topic, kind, &qos), wall_us);
        let (guid, end) = (data.guid, Reader::new(self.settings.prefix, data.guid.entity, qos));
        self.readers.push(Own { end, data, wrong: BTreeMap::new() });
        self.meet_all(true);
        guid
    }

    /// Announces an endpoint by one of the built-in writers.
    fn announce_end(
        &mut self,
        by: usize,
        entity: Entity,
        (topic, kind, qos): (&str, &str, &Qos),
        wall_us: i64,
    ) -> EndpointData {
        let (guid, unicast) = (Guid { prefix: self.settings.prefix, entity }, vec![self.settings.user]);
        let data = EndpointData { guid, topic: topic.to_owned(), kind: kind.to_owned(), qos: qos.clone(), unicast };
        self.built_in[by].0.write(data.payload().into(), None, wall_us, &mut self.out);
        data
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
            let built_in = self.built_in.iter_mut().map(|(writer, _)| writer);
            let all = built_in.chain(self.writers.iter_mut().map(|own| &mut own.end));
            all.for_each(|writer| writer.beat(&mut self.out));
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
        announced(*prefix, &data.payload())
    }

    /// Moves to the addresses in `settings` and informs known participants; to the others it appears as a new one.
    pub fn move_to(&mut self, settings: Settings, wall_us: i64) {
        self.settings = Settings { prefix: self.settings.prefix, ..settings };
        self.announced = (0, Instant::ZERO);
        let announcement = self.announcement();
        self.out.extend(self.peers.values().map(|peer| (peer.meta, announcement.clone())));
        let unicast = vec![self.settings.user];
        let writers = self.writers.iter_mut().map(|own| (0, &mut own.data));
        for (by, data) in writers.chain(self.readers.iter_mut().map(|own| (1, &mut own.data))) {
            data.unicast.clone_from(&unicast);
            self.built_in[by].0.write(data.payload().into(), None, wall_us, &mut self.out);
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
        let counts = own.end.counts;
        let wrong = words(&own.wrong);
        TopicState { matched: own.end.writers(), samples: counts.samples, lost: counts.lost, wrong }
    }

    /// Participants that announced themselves and cannot be reached.
    pub fn unreachable(&self) -> impl Iterator<Item = &str> {
        self.unreachable.values().map(String::as_str)
    }

    /// Handles a datagram from `ip`; appends what it brings to `events`.
    pub fn handle_datagram(
        &mut self,
        bytes: &[u8],
        ip: Ipv4Addr,
        (now, wall_us): (Instant, i64),
        events: &mut Vec<Event>,
    ) {
        self.counts.datagrams += 1;
        let Some(mut datagram) = Datagram::new_checked(bytes) else {
            self.counts.malformed += 1;
            return;
        };
        while let Some(next) = datagram.next() {
            if self.out.len() >= ANSWERS {
                self.counts.left_out += 1;
                return;
            }
            let from = datagram.from;
            let Ok(submessage) = next else {
                self.counts.malformed += 1;
                continue;
            };
            if from == self.settings.prefix || submessage.to.is_some_and(|to| to != self.settings.prefix) {
                continue;
            }
            if submessage.writer == ANNOUNCER {
                if let Body::Data { inline, payload, .. } = submessage.body {
                    self.handle_participant(inline, payload, ip, now);
                }
                continue;
            }
            if let Some(peer) = self.peers.get_mut(&from) {
                peer.heard_at = now;
                self.handle_submessage(from, &submessage, wall_us, events);
            }
        }
    }

    fn handle_participant(&mut self, inline: Inline, payload: Option<&[u8]>, ip: Ipv4Addr, now: Instant) {
        if inline.is_over {
            let guid = inline.key.and_then(|key| Guid::from_bytes(&key)).or_else(|| key(payload?));
            if let Some(guid) = guid {
                self.forget(guid.prefix);
            }
            return;
        }
        let read = payload.map(ParticipantData::read);
        let Some(Ok(Some(data))) = read else {
            self.counts.unreadable += 1;
            return;
        };
        if data.prefix == self.settings.prefix {
            return;
        }
        let prefix = data.prefix;
        let meta = reach(&data.meta, ip);
        if data.is_ipv6 || meta.is_none() {
            let why = if data.is_ipv6 { "announces only IPv6 addresses" } else { "accepts nothing over IPv4 UDP" };
            if self.unreachable.len() < PARTICIPANTS {
                self.unreachable.insert(prefix, format!("{} at {ip} {why}", data.name));
            }
        } else {
            self.unreachable.remove(&prefix);
        }
        let Some(meta) = meta else { return };
        let user = reach(&data.user, ip);
        let is_new = !self.peers.contains_key(&prefix);
        if is_new && self.peers.len() >= PARTICIPANTS && !self.make_room() {
            self.counts.refused += 1;
            return;
        }
        let places = |data: &ParticipantData| (data.meta.clone(), data.user.clone());
        let has_moved = self.peers.get(&prefix).is_some_and(|known| places(&known.data) != places(&data));
        self.peers.insert(prefix, Peer { data, meta, user, heard_at: now });
        self.counts.participants = self.peers.len() as u64;
        if is_new {
            self.out.push((meta, self.announcement()));
        }
        let guid = |entity| Guid { prefix, entity };
        for ((writer, reader), (own_writer, own_reader)) in BUILT_IN.into_iter().zip(&mut self.built_in) {
            let known = own_writer.add(guid(reader), meta, true, false, &mut self.out)
                && own_reader.add(guid(writer), meta, true, &mut self.out);
            self.counts.refused += u64::from(!known);
            own_writer.renew(prefix);
        }
        self.writers.iter_mut().for_each(|own| own.end.renew(prefix));
        if has_moved {
            let of = self.others.range(all_of(prefix)).map(|(_, other)| other.clone()).collect::<Vec<_>>();
            of.iter().for_each(|(is_writer, data)| self.meet(*is_writer, data));
        }
    }

    /// Forgets the longest silent participant that matches nothing here. False if there is none.
    fn make_room(&mut self) -> bool {
        let used = |prefix: &Prefix| self.others.range(all_of(*prefix)).next().is_some();
        let idle = self.peers.iter().filter(|(prefix, _)| !used(prefix)).min_by_key(|(_, peer)| peer.heard_at);
        let idle = idle.map(|(prefix, _)| *prefix);
        idle.inspect(|prefix| self.forget(*prefix)).is_some()
    }

    fn forget(&mut self, prefix: Prefix) {
        let of = |guid: &Guid| guid.prefix == prefix;
        self.peers.remove(&prefix);
        self.unreachable.remove(&prefix);
        self.others.retain(|guid, _| !of(guid));
        for (writer, reader) in &mut self.built_in {
            writer.remove(of);
            reader.remove(of);
        }
        self.part(of);
        self.counts.participants = self.peers.len() as u64;
    }

    /// Unmatches the endpoints of this participant.
    fn part(&mut self, is: impl Fn(&Guid) -> bool) {
        for own in &mut self.writers {
            own.end.remove(&is);
            own.wrong.retain(|guid, _| !is(guid));
        }
        for own in &mut self.readers {
            own.end.remove(&is);
            own.wrong.retain(|guid, _| !is(guid));
        }
    }

    fn handle_submessage(&mut self, from: Prefix, what: &Submessage<'_>, wall_us: i64, events: &mut Vec<Event>) {
        let is_for = |entity: Entity| what.reader == ANY || what.reader == entity;
        let writer = Guid { prefix: from, entity: what.writer };
        if let Body::AckNack { missing, count } = &what.body {
            let reader = Guid { prefix: from, entity: what.reader };
            let built_in = self.built_in.iter_mut().map(|(writer, _)| writer);
            let mut all = built_in.chain(self.writers.iter_mut().map(|own| &mut own.end));
            if let Some(own) = all.find(|own| own.entity == what.writer) {
                own.handle_acknack(reader, missing, *count, wall_us, &mut self.out);
            }
            return;
        }
        let mut announced = Vec::new();
        for (by, (_, reader)) in self.built_in.iter_mut().enumerate() {
            if is_for(reader.entity) {
                let came = take(reader, writer, &what.body, &mut self.out);
                announced.extend(came.into_iter().map(|(_, payload)| (by == 0, payload)));
            }
        }
        let has_announced = !announced.is_empty();
        announced.into_iter().for_each(|(is_writer, payload)| self.handle_endpoint(is_writer, from, &payload));
        if has_announced && !self.waiting.is_empty() {
            self.write_waiting(wall_us);
        }
        let vendor = self.peers.get(&from).map_or([0; 2], |peer| peer.data.vendor);
        for (reader, own) in self.readers.iter_mut().enumerate().filter(|(_, own)| is_for(own.end.entity)) {
            let came = take(&mut own.end, writer, &what.body, &mut self.out);
            let event = |(number, payload)| Event { reader, from: (writer, number), vendor, payload };
            events.extend(came.into_iter().map(event));
        }
    }

    fn handle_endpoint(&mut self, is_writer: bool, from: Prefix, payload: &[u8]) {
        match EndpointData::read(payload, is_writer) {
            Ok(Some(data)) if data.guid.prefix == from => {
                let is_new = !self.others.contains_key(&data.guid);
                if is_new && self.others.len() >= ENDPOINTS {
                    self.counts.refused += 1;
                    return;
                }
                self.others.insert(data.guid, (is_writer, data.clone()));
                self.meet(is_writer, &data);
            }
            // Only a key: the endpoint is gone.
            Ok(None) => {
                let Some(over) = key(payload).filter(|guid| guid.prefix == from) else {
                    self.counts.unreadable += 1;
                    return;
                };
                self.others.remove(&over);
                self.part(|guid| *guid == over);
            }
            Ok(Some(_)) | Err(_) => self.counts.unreadable += 1,
        }
    }

    /// Matches again the endpoints that had no place: somebody may have left.
    fn meet_left_out(&mut self) {
        if self.readers.iter().any(Own::left_somebody_out) {
            self.meet_all(true);
        }
        if self.writers.iter().any(Own::left_somebody_out) {
            self.meet_all(false);
        }
    }

    /// Matches all known writers or readers of others with a new endpoint here.
    fn meet_all(&mut self, writers: bool) {
        let all: Vec<EndpointData> =
            self.others.values().filter(|(is_writer, _)| *is_writer == writers).map(|(_, data)| data.clone()).collect();
        all.iter().for_each(|data| self.meet(writers, data));
    }

    /// Matches another's endpoint with those here.
    fn meet(&mut self, is_writer: bool, data: &EndpointData) {
        let Some(peer) = self.peers.get(&data.guid.prefix) else { return };
        let ip = *peer.meta.ip();
        let to = reach(&data.unicast, ip).or(peer.user).unwrap_or(peer.meta);
        let guid = data.guid;
        if is_writer {
            for own in self.readers.iter_mut().filter(|own| own.data.topic == data.topic) {
                let why = wrong(&own.data.kind, &data.kind).or_else(|| data.qos.mismatch(&own.data.qos));
                let is_refused = own.meet(guid, why, |end| end.add(guid, to, data.qos.reliable, &mut self.out));
                self.counts.refused += u64::from(is_refused);
            }
        } else {
            let from_now = data.qos.durability == 0;
            for own in self.writers.iter_mut().filter(|own| own.data.topic == data.topic) {
                let why = wrong(&own.data.kind, &data.kind).or_else(|| own.data.qos.mismatch(&data.qos));
                let is_refused =
                    own.meet(guid, why, |end| end.add(guid, to, data.qos.reliable, from_now, &mut self.out));
                self.counts.refused += u64::from(is_refused);
            }
        }
    }
}

/// All names that a participant's endpoints can have.
fn all_of(prefix: Prefix) -> std::ops::RangeInclusive<Guid> {
    Guid { prefix, entity: [0; 4] }..=Guid { prefix, entity: [255; 4] }
}

/// Where a participant that sent from `ip` receives datagrams: at the address of `list` that is `ip`, else at `ip` and the
/// first port of the list. Fast DDS announces one card's address but receives at all of its machine's. Nothing is ever sent
/// to a machine that has sent nothing.
fn reach(list: &[SocketAddrV4], ip: Ipv4Addr) -> Option<SocketAddrV4> {
    let same = list.iter().find(|address| *address.ip() == ip).copied();
    same.or_else(|| list.first().map(|first| SocketAddrV4::new(ip, first.port())))
}

fn wrong(own: &str, other: &str) -> Option<&'static str> {
    (own != other).then_some("the other end has another type of message")
}

/// Passes a submessage to a reader.
fn take(reader: &mut Reader, writer: Guid, body: &Body<'_>, out: &mut Vec<Outgoing>) -> Came {
    match body {
        Body::Data { number, inline: Inline { is_over: true, key: Some(key), .. }, payload: None } => {
            reader.handle_data(writer, *number, &key_payload(*key))
        }
        Body::Data { number, payload, .. } => reader.handle_data(writer, *number, payload.unwrap_or_default()),
        Body::Fragments { number, fragment } => reader.handle_fragment(writer, *number, fragment),
        Body::Heartbeat { first, last, is_final, .. } => {
            reader.handle_heartbeat(writer, (*first, *last), *is_final, out)
        }
        Body::Gap { start, set } => reader.handle_gap(writer, *start, set),
        Body::AckNack { .. } => Vec::new(),
    }
}

/// The datagram in which participant `prefix` announces itself.
fn announced(prefix: Prefix, payload: &[u8]) -> Vec<u8> {
    Maker::new(prefix, None).data((DETECTOR, ANNOUNCER), 1, payload, (None, None)).finish()
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
