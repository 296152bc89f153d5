//! A writer: what it keeps, to whom it sends, and what it sends again (\[rtps\] 8.4.9).

use super::discovery::Qos;
use super::wire::{Entity, Guid, Maker, Numbers, Prefix};
use std::collections::{BTreeMap, VecDeque};
use std::net::SocketAddrV4;
use std::sync::Arc;

/// Bytes of a sample at most: a UDP datagram less the headers.
pub(crate) const LARGEST: usize = 64_000;
/// Samples that a reader is sent again between two heartbeats, however often it asks.
const AGAIN: usize = 64;
/// Unanswered heartbeats after which a reader gets fewer, or none if it never answered.
const UNHEARD: u32 = 10;
/// A reader that fell silent gets one heartbeat in this many, because its link may recover.
const SELDOM: u32 = 5;
/// Heartbeats that an announcement of such a reader adds.
const RENEWED: u32 = 2;
/// Readers of one topic at most.
const READERS: usize = 256;

/// A datagram and its destination.
pub(crate) type Outgoing = (SocketAddrV4, Vec<u8>);

/// A stored sample.
#[derive(Clone, Debug)]
struct Sample {
    number: i64,
    payload: Arc<[u8]>,
    /// The request that it answers.
    request: Option<(Guid, i64)>,
}

/// A reader of another participant.
#[derive(Clone, Debug)]
struct Reading {
    to: SocketAddrV4,
    reliable: bool,
    /// The first sample for it.
    start: i64,
    /// It has all samples below this number.
    acked: i64,
    /// Number of its last request.
    count: Option<u32>,
    /// Samples that it may still be sent again before the next heartbeat.
    again: usize,
    /// Heartbeats since its last answer.
    unheard: u32,
}

/// A writer of this participant.
#[derive(Debug)]
pub(crate) struct Writer {
    own: Prefix,
    /// Its identity.
    pub entity: Entity,
    qos: Qos,
    kept: VecDeque<Sample>,
    last: i64,
    readers: BTreeMap<Guid, Reading>,
    beats: u32,
    /// Times that [`Writer::beat`] was called.
    turns: u32,
}

impl Writer {
    /// A writer that keeps as many samples as `qos` says.
    pub fn new(own: Prefix, entity: Entity, qos: Qos) -> Self {
        Self { own, entity, qos, kept: VecDeque::new(), last: 0, readers: BTreeMap::new(), beats: 0, turns: 0 }
    }

    /// Matched readers.
    pub fn readers(&self) -> usize {
        self.readers.len()
    }

    /// Sends to a reader of this participant.
    pub fn has_reader_of(&self, prefix: Prefix) -> bool {
        self.readers.keys().any(|guid| guid.prefix == prefix)
    }

    fn first(&self) -> i64 {
        self.kept.front().map_or(self.last + 1, |sample| sample.number)
    }

    /// Writes a sample to all readers; `request` is what it answers, if it is an answer.
    pub fn write(&mut self, payload: Arc<[u8]>, request: Option<(Guid, i64)>, wall_us: i64, out: &mut Vec<Outgoing>) {
        self.last += 1;
        let sample = Sample { number: self.last, payload, request };
        let mut sent: Vec<(SocketAddrV4, Prefix)> = Vec::new();
        for (guid, reader) in &self.readers {
            // One datagram serves all readers of a participant.
            if !sent.contains(&(reader.to, guid.prefix)) {
                sent.push((reader.to, guid.prefix));
                out.push((reader.to, self.datagram(guid.prefix, [0; 4], &sample, wall_us)));
            }
        }
        self.kept.push_back(sample);
        while self.kept.len() > self.qos.depth.max(1) as usize {
            self.kept.pop_front();
        }
    }

    fn datagram(&self, to: Prefix, reader: Entity, sample: &Sample, wall_us: i64) -> Vec<u8> {
        let ends = (reader, self.entity);
        let made = Maker::new(self.own, Some(to)).time(wall_us);
        let made = made.data(ends, sample.number, &sample.payload, (None, sample.request));
        made.finish()
    }

    /// Matches a reader and announces the samples for it. `from_now`: earlier samples are not for it. False if there are too
    /// many.
    #[must_use]
    pub fn add(
        &mut self,
        guid: Guid,
        to: SocketAddrV4,
        reliable: bool,
        from_now: bool,
        out: &mut Vec<Outgoing>,
    ) -> bool {
        if let Some(known) = self.readers.get_mut(&guid) {
            known.to = to;
            return true;
        }
        if self.readers.len() >= READERS {
            return false;
        }
        let start = if from_now { self.last + 1 } else { self.first() };
        let reliable = reliable && self.qos.reliable;
        let reading = Reading { to, reliable, start, acked: start, count: None, again: AGAIN, unheard: 0 };
        self.readers.insert(guid, reading);
        self.beat_one(guid, out);
        true
    }

    /// The participant of a reader announced itself: the reader gets a few more heartbeats.
    pub fn renew(&mut self, prefix: Prefix) {
        let of = self.readers.iter_mut().filter(|(guid, _)| guid.prefix == prefix);
        of.for_each(|(_, one)| one.unheard = one.unheard.min(UNHEARD - RENEWED));
    }

    /// Removes a reader.
    pub fn remove(&mut self, is: impl Fn(&Guid) -> bool) {
        self.readers.retain(|guid, _| !is(guid));
    }

    /// Sends a heartbeat to each reliable reader that lacks samples. A reader that never answered soon gets none, because its
    /// address may be forged. One that fell silent gets fewer until its participant's lease ends.
    pub fn beat(&mut self, out: &mut Vec<Outgoing>) {
        self.readers.values_mut().for_each(|one| one.again = AGAIN);
        self.turns = self.turns.wrapping_add(1);
        let seldom = self.turns.is_multiple_of(SELDOM);
        let is_due = |one: &Reading| one.unheard < UNHEARD || (seldom && one.count.is_some());
        let is_behind = |one: &Reading| one.reliable && one.acked <= self.last && is_due(one);
        let behind: Vec<Guid> = self.readers.iter().filter(|(_, one)| is_behind(one)).map(|(guid, _)| *guid).collect();
        behind.iter().for_each(|guid| self.beat_one(*guid, out));
    }

    fn beat_one(&mut self, guid: Guid, out: &mut Vec<Outgoing>) {
        let (first, Some(reader)) = (self.first(), self.readers.get_mut(&guid)) else { return };
        if reader.reliable {
            reader.unheard = reader.unheard.saturating_add(1);
            self.beats = self.beats.wrapping_add(1);
            let range = (first.max(reader.start), self.last);
            let made = Maker::new(self.own, Some(guid.prefix));
            let made = made.heartbeat((guid.entity, self.entity), range, self.beats, false);
            out.push((reader.to, made.finish()));
        }
    }

    /// What a reader lacks: sends it again, or says that it will never arrive.
    pub fn handle_acknack(&mut self, guid: Guid, missing: &Numbers, count: u32, wall_us: i64, out: &mut Vec<Outgoing>) {
        let (first, last) = (self.first(), self.last);
        let Some(reader) = self.readers.get_mut(&guid).filter(|reader| reader.reliable) else { return };
        // A repeated or overtaken request; a restarted reader counts from the start.
        if reader.count.is_some_and(|before| count <= before && before - count < 1_000) {
            return;
        }
        (reader.count, reader.unheard) = (Some(count), 0);
        reader.acked = missing.base.clamp(reader.start, last + 1);
        let (to, from) = (reader.to, first.max(reader.start));
        let mut gone: Option<(i64, i64)> = None;
        let asked: Vec<i64> = missing.iter().take_while(|number| *number <= last).take(reader.again).collect();
        reader.again -= asked.len();
        for number in asked {
            match self.kept.iter().find(|sample| sample.number == number && number >= from) {
                Some(sample) => out.push((to, self.datagram(guid.prefix, guid.entity, sample, wall_us))),
                None => gone = Some((gone.map_or(number, |(start, _)| start), from.max(number + 1))),
            }
        }
        if let Some(range) = gone {
            let made = Maker::new(self.own, Some(guid.prefix));
            out.push((to, made.gap((guid.entity, self.entity), range).finish()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_silent_reader_gets_heartbeats_unless_it_never_answered() {
        let mut writer = Writer::new([1; 12], [0, 0, 1, 3], Qos::reliable(100));
        let guid = |k: u8| Guid { prefix: [k; 12], entity: [0, 0, 1, 4] };
        let at = |k: u8| SocketAddrV4::new([127, 0, 0, k].into(), 7_411);
        let mut out = Vec::new();
        for k in [2, 3] {
            assert!(writer.add(guid(k), at(k), true, true, &mut out));
        }
        writer.write(Arc::from([0_u8; 4]), None, 0, &mut out);
        writer.handle_acknack(guid(2), &Numbers::none(1), 1, 0, &mut out);
        let mut beats_to = |k: u8, turns: usize| {
            let mut all = Vec::new();
            (0..turns).for_each(|_| writer.beat(&mut all));
            all.iter().filter(|(to, _)| *to == at(k)).count()
        };
        // Four seconds of ten heartbeats each without a link.
        let heard = beats_to(2, 40);
        assert!((10..=20).contains(&heard), "{heard}");
        assert_eq!(beats_to(3, 10), 0, "its beats are used up");
        let within_half_a_second = beats_to(2, SELDOM as usize);
        assert_eq!(within_half_a_second, 1);
    }
}
