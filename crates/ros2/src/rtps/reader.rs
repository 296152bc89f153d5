//! A reader: each writer's samples, in order, and requests for missing ones (\[rtps\] 8.4.11).

use super::discovery::Qos;
use super::wire::{Entity, Fragment, Guid, Maker, Numbers, Prefix};
use super::writer::Outgoing;
use std::collections::BTreeMap;
use std::net::SocketAddrV4;

/// Samples of one writer that wait for a missing one.
const HELD: usize = 256;
/// Bytes of a sample in fragments at most.
pub(crate) const LARGEST: usize = 1 << 20;
/// Fragmented samples of one writer at a time.
const PARTS: usize = 2;
/// Bytes of samples that wait for a missing one or for their own fragments, over all writers of a topic.
pub(super) const WAITING: usize = 8 << 20;
/// Writers of one topic at most: one per participant, for built-in topics.
const WRITERS: usize = 128;

/// A sample that arrives in fragments.
#[derive(Clone, Debug)]
struct Parts {
    bytes: Vec<u8>,
    size: usize,
    have: Vec<bool>,
    left: usize,
}

impl Parts {
    /// Bytes that a fragment's sample takes, with the flags of its fragments; `None` for an invalid one.
    fn needed(fragment: &Fragment<'_>) -> Option<usize> {
        let (size, total) = (usize::from(fragment.size), fragment.total as usize);
        (size > 0 && (1..=LARGEST).contains(&total)).then(|| total + total.div_ceil(size))
    }

    /// A new sample for this fragment, of a valid size.
    fn new(fragment: &Fragment<'_>) -> Self {
        let (size, total) = (usize::from(fragment.size).max(1), fragment.total as usize);
        let count = total.div_ceil(size);
        Self { bytes: vec![0; total], size, have: vec![false; count], left: count }
    }

    /// Bytes that it takes, with the flags of its fragments.
    fn len(&self) -> usize {
        self.bytes.len() + self.have.len()
    }

    /// Stores what is in `fragment`; false if it belongs to another sample.
    fn take(&mut self, fragment: &Fragment<'_>) -> bool {
        if fragment.total as usize != self.bytes.len() || usize::from(fragment.size) != self.size {
            return false;
        }
        let first = (fragment.first as usize).saturating_sub(1);
        for (part, bytes) in (first..).zip(fragment.bytes.chunks(self.size)) {
            let start = part.saturating_mul(self.size);
            let Some(place) = self.bytes.get_mut(start..) else { break };
            let length = place.len().min(self.size);
            let (Some(to), Some(from), Some(have)) =
                (place.get_mut(..length), bytes.get(..length), self.have.get_mut(part))
            else {
                break;
            };
            to.copy_from_slice(from);
            self.left -= usize::from(!std::mem::replace(have, true));
        }
        true
    }
}

/// Samples in order, with their numbers.
pub(crate) type Came = Vec<(i64, Vec<u8>)>;

/// A writer of another participant.
#[derive(Clone, Debug)]
struct Writing {
    to: SocketAddrV4,
    reliable: bool,
    /// The next number to deliver; with best effort, `None` before the first.
    next: Option<i64>,
    /// It has announced its samples: lower numbers were never for this reader.
    has_begun: bool,
    held: BTreeMap<i64, Vec<u8>>,
    parts: BTreeMap<i64, Parts>,
    asked: u32,
    /// Bytes of `held` and `parts`.
    waiting: usize,
}

impl Writing {
    /// Counts the waiting bytes again.
    fn count(&mut self) {
        let held: usize = self.held.values().map(Vec::len).sum();
        let parts: usize = self.parts.values().map(Parts::len).sum();
        self.waiting = held + parts;
    }

    /// Discards the sample needed last: that with the highest number above `number`. False if there is none.
    fn give_way(&mut self, number: i64) -> bool {
        let last_held = self.held.last_key_value().map(|(last, _)| *last);
        let last_part = self.parts.last_key_value().map(|(last, _)| *last);
        let is_held = last_held > last_part;
        if last_held.max(last_part).is_none_or(|last| last <= number) {
            return false;
        }
        if is_held {
            self.held.pop_last();
        } else {
            self.parts.pop_last();
        }
        self.count();
        true
    }

    /// Discards fragmented samples beyond [`PARTS`]. A reliable writer sends missing ones again, and all wait for the lowest
    /// number: the highest goes. Best-effort samples do not come again: the lowest goes.
    fn bound_parts(&mut self) {
        while self.parts.len() > PARTS {
            let gone = if self.reliable { self.parts.pop_last() } else { self.parts.pop_first() };
            drop(gone);
        }
    }
}

/// Counters of a reader.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ReaderCounts {
    /// Delivered samples.
    pub samples: u64,
    /// Samples that can no longer arrive.
    pub lost: u64,
}

/// A reader of this participant.
#[derive(Debug)]
pub(crate) struct Reader {
    own: Prefix,
    /// Its identity.
    pub entity: Entity,
    qos: Qos,
    writers: BTreeMap<Guid, Writing>,
    /// The counters.
    pub counts: ReaderCounts,
}

impl Reader {
    /// A reader that requests `qos`.
    pub fn new(own: Prefix, entity: Entity, qos: Qos) -> Self {
        Self { own, entity, qos, writers: BTreeMap::new(), counts: ReaderCounts::default() }
    }

    /// Matched writers.
    pub fn writers(&self) -> usize {
        self.writers.len()
    }

    /// Matches a writer; requests for it go to `to`. False if there are too many.
    #[must_use]
    pub fn add(&mut self, guid: Guid, to: SocketAddrV4, reliable: bool, out: &mut Vec<Outgoing>) -> bool {
        if let Some(known) = self.writers.get_mut(&guid) {
            known.to = to;
            return true;
        }
        if self.writers.len() >= WRITERS {
            return false;
        }
        let reliable = reliable && self.qos.reliable;
        // A reliable writer's first heartbeat says where a reader starts; a best-effort writer's first sample does.
        let next = reliable.then_some(1);
        let (held, parts) = (BTreeMap::new(), BTreeMap::new());
        self.writers.insert(guid, Writing { to, reliable, next, has_begun: false, held, parts, asked: 0, waiting: 0 });
        if reliable {
            self.ask(guid, 0, true, out);
        }
        true
    }

    /// Removes a writer.
    pub fn remove(&mut self, is: impl Fn(&Guid) -> bool) {
        self.writers.retain(|guid, _| !is(guid));
    }

    /// Takes a sample; returns the samples to deliver, in order.
    pub fn handle_data(&mut self, guid: Guid, number: i64, payload: &[u8]) -> Came {
        let has_room = self.waiting() + payload.len() <= WAITING;
        let Some(writing) = self.writers.get_mut(&guid).filter(|_| number > 0) else { return Vec::new() };
        let next = *writing.next.get_or_insert(number);
        if number < next {
            return Vec::new();
        }
        if writing.reliable {
            // A sample without room is requested again.
            if number == next || (has_room && writing.held.len() < HELD) {
                writing.held.insert(number, payload.to_vec());
                writing.count();
            }
            return self.hand_over(guid);
        }
        self.lose((number - next).unsigned_abs());
        let Some(writing) = self.writers.get_mut(&guid) else { return Vec::new() };
        self.counts.samples += 1;
        let next = number.saturating_add(1);
        writing.next = Some(next);
        // Older incomplete samples are not delivered any more.
        writing.parts = writing.parts.split_off(&next);
        writing.count();
        vec![(number, payload.to_vec())]
    }

    /// Takes a fragment; returns the samples to deliver, in order.
    pub fn handle_fragment(&mut self, guid: Guid, number: i64, fragment: &Fragment<'_>) -> Came {
        let Some(writing) = self.writers.get(&guid).filter(|_| number > 0) else { return Vec::new() };
        if writing.next.is_some_and(|next| number < next) || writing.held.contains_key(&number) {
            return Vec::new();
        }
        if !writing.parts.contains_key(&number) {
            let has_room = Parts::needed(fragment).is_some_and(|bytes| self.make_room(guid, number, bytes));
            let Some(writing) = self.writers.get_mut(&guid).filter(|_| has_room) else { return Vec::new() };
            writing.parts.insert(number, Parts::new(fragment));
        }
        let Some(writing) = self.writers.get_mut(&guid) else { return Vec::new() };
        let is_whole = writing.parts.get_mut(&number).is_some_and(|parts| parts.take(fragment) && parts.left == 0);
        let whole = if is_whole { writing.parts.remove(&number) } else { None };
        writing.bound_parts();
        writing.count();
        whole.map(|parts| self.handle_data(guid, number, &parts.bytes)).unwrap_or_default()
    }

    /// Makes room for `bytes` of sample `number` of a writer. The writer with the most waiting bytes gives way, so that nobody
    /// shuts the others out; the same writer gives up only samples after this one. False if there is no room.
    fn make_room(&mut self, guid: Guid, number: i64, bytes: usize) -> bool {
        while self.waiting() + bytes > WAITING {
            let own = self.writers.get(&guid).map_or(0, |writing| writing.waiting) + bytes;
            let most = self.writers.iter().filter(|(other, _)| **other != guid).max_by_key(|(_, one)| one.waiting);
            let (whose, above) = match most {
                Some((other, one)) if one.waiting > own => (*other, 0),
                _ => (guid, number),
            };
            if !self.writers.get_mut(&whose).is_some_and(|writing| writing.give_way(above)) {
                return false;
            }
        }
        true
    }

    /// A writer's range: requests missing samples, counts those that it no longer has as lost.
    pub fn handle_heartbeat(
        &mut self,
        guid: Guid,
        (first, last): (i64, i64),
        is_final: bool,
        out: &mut Vec<Outgoing>,
    ) -> Came {
        let Some(writing) = self.writers.get_mut(&guid).filter(|writing| writing.reliable) else { return Vec::new() };
        if first <= 0 || last < first - 1 {
            return Vec::new();
        }
        let next = *writing.next.get_or_insert(first);
        let had_begun = std::mem::replace(&mut writing.has_begun, true);
        if next < first {
            writing.next = Some(first);
            writing.held = writing.held.split_off(&first);
            writing.parts = writing.parts.split_off(&first);
            writing.count();
            self.lose(if had_begun { (first - next).unsigned_abs() } else { 0 });
        }
        let samples = self.hand_over(guid);
        let has_all = self.writers.get(&guid).and_then(|writing| writing.next).is_some_and(|next| next > last);
        if !(has_all && is_final) {
            self.ask(guid, last, false, out);
        }
        samples
    }

    /// Numbers that will never arrive.
    pub fn handle_gap(&mut self, guid: Guid, start: i64, set: &Numbers) -> Came {
        let Some(writing) = self.writers.get_mut(&guid).filter(|writing| writing.reliable) else { return Vec::new() };
        if start <= 0 || set.base < start {
            return Vec::new();
        }
        let gone: Vec<i64> = set.iter().collect();
        if let Some(next) = &mut writing.next {
            if start <= *next {
                *next = (*next).max(set.base);
            }
            while gone.contains(next) && *next < i64::MAX {
                *next += 1;
            }
            writing.held = writing.held.split_off(next);
        }
        writing.count();
        self.hand_over(guid)
    }

    /// Waiting bytes of all writers.
    pub(super) fn waiting(&self) -> usize {
        self.writers.values().map(|writing| writing.waiting).sum()
    }

    fn lose(&mut self, samples: u64) {
        self.counts.lost = self.counts.lost.saturating_add(samples);
    }

    /// Requests what is missing up to `last`, or acknowledges; `begins`: asks the writer for its range.
    fn ask(&mut self, guid: Guid, last: i64, begins: bool, out: &mut Vec<Outgoing>) {
        let Some(writing) = self.writers.get_mut(&guid) else { return };
        let next = writing.next.unwrap_or(last.saturating_add(1));
        let missing = (next..=last).take(HELD).filter(|number| !writing.held.contains_key(number));
        let missing = Numbers::of(next, missing);
        let has_all = missing.iter().next().is_none();
        writing.asked = writing.asked.wrapping_add(1);
        let made = Maker::new(self.own, Some(guid.prefix));
        let made = made.acknack((self.entity, guid.entity), &missing, writing.asked, has_all && !begins);
        out.push((writing.to, made.finish()));
    }

    fn hand_over(&mut self, guid: Guid) -> Came {
        let Some(writing) = self.writers.get_mut(&guid) else { return Vec::new() };
        let mut samples = Vec::new();
        while let Some(sample) = writing.next.and_then(|next| writing.held.remove_entry(&next)) {
            writing.next = Some(sample.0.saturating_add(1));
            writing.waiting = writing.waiting.saturating_sub(sample.1.len());
            samples.push(sample);
        }
        self.counts.samples += samples.len() as u64;
        samples
    }
}

#[cfg(test)]
mod tests {
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
        assert_eq!((reader.waiting(), reader.counts.samples), (parts, 4_000));
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
            assert!(reader.counts.lost > i64::MAX as u64 / 2 * (round + 1).min(3), "{:?}", reader.counts);
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
        assert_eq!(reader.counts.lost, u64::MAX);
        assert_eq!(reader.counts.samples, 8);
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
}
