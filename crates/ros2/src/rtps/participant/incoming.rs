//! Incoming datagrams: known participants and matching endpoints.

use super::super::discovery::{EndpointData, ParticipantData, key, key_payload};
use super::super::reader::{Came, Reader};
use super::super::wire::{ANY, Body, Datagram, Entity, Guid, Inline, Prefix, Submessage};
use super::super::writer::Outgoing;
use super::{ANNOUNCER, Event, PUBLICATIONS, Participant, Peer, SUBSCRIPTIONS};
use csi5300::time::Instant;
use std::net::{Ipv4Addr, SocketAddrV4};

/// Participants that are kept at most.
const PARTICIPANTS: usize = 128;
/// Endpoints of other participants that are kept at most.
const ENDPOINTS: usize = 8_192;
/// Answers that may wait to be sent: datagrams that arrive beyond it are dropped.
const ANSWERS: usize = 4_096;

impl Participant {
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
        for ((writer, reader), (own_writer, own_reader)) in
            [(PUBLICATIONS, &mut self.publications), (SUBSCRIPTIONS, &mut self.subscriptions)]
        {
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

    pub(super) fn forget(&mut self, prefix: Prefix) {
        let of = |guid: &Guid| guid.prefix == prefix;
        self.peers.remove(&prefix);
        self.unreachable.remove(&prefix);
        self.others.retain(|guid, _| !of(guid));
        for (writer, reader) in [&mut self.publications, &mut self.subscriptions] {
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
            let built_in = [&mut self.publications.0, &mut self.subscriptions.0];
            let mut all = built_in.into_iter().chain(self.writers.iter_mut().map(|own| &mut own.end));
            if let Some(own) = all.find(|own| own.entity() == what.writer) {
                own.handle_acknack(reader, missing, *count, wall_us, &mut self.out);
            }
            return;
        }
        let mut announced = Vec::new();
        for (is_writer, reader) in [(true, &mut self.publications.1), (false, &mut self.subscriptions.1)] {
            if is_for(reader.entity()) {
                let came = take(reader, writer, &what.body, &mut self.out);
                announced.extend(came.into_iter().map(|(_, payload)| (is_writer, payload)));
            }
        }
        let has_announced = !announced.is_empty();
        announced.into_iter().for_each(|(is_writer, payload)| self.handle_endpoint(is_writer, from, &payload));
        if has_announced && !self.waiting.is_empty() {
            self.write_waiting(wall_us);
        }
        let vendor = self.peers.get(&from).map_or([0; 2], |peer| peer.data.vendor);
        for (reader, own) in self.readers.iter_mut().enumerate().filter(|(_, own)| is_for(own.end.entity())) {
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
    pub(super) fn meet_left_out(&mut self) {
        for writers in [true, false] {
            let waits = if writers {
                self.readers.iter().any(|own| own.left_somebody_out())
            } else {
                self.writers.iter().any(|own| own.left_somebody_out())
            };
            if waits {
                self.meet_all(writers);
            }
        }
    }

    /// Matches all known writers or readers of others with a new endpoint here.
    pub(super) fn meet_all(&mut self, writers: bool) {
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
                match wrong(&own.data.kind, &data.kind).or_else(|| data.qos.mismatch(&own.data.qos)) {
                    None if own.end.add(guid, to, data.qos.reliable, &mut self.out) => drop(own.wrong.remove(&guid)),
                    None => self.counts.refused += u64::from(own.has_no_place_for(guid)),
                    Some(why) => drop(own.wrong.insert(guid, why)),
                }
            }
        } else {
            let from_now = data.qos.durability == 0;
            for own in self.writers.iter_mut().filter(|own| own.data.topic == data.topic) {
                match wrong(&own.data.kind, &data.kind).or_else(|| own.data.qos.mismatch(&data.qos)) {
                    None if own.end.add(guid, to, data.qos.reliable, from_now, &mut self.out) => {
                        own.wrong.remove(&guid);
                    }
                    None => self.counts.refused += u64::from(own.has_no_place_for(guid)),
                    Some(why) => drop(own.wrong.insert(guid, why)),
                }
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
