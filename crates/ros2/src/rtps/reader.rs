//! A reader: what came of each writer, in order, and what is asked for again (\[rtps\] 8.4.11).

use super::qos::Qos;
use super::wire::{Entity, Fragment, Guid, Maker, Numbers, Prefix};
use super::writer::Outgoing;
use std::collections::BTreeMap;
use std::net::SocketAddrV4;

/// Samples that wait for one that is missing, of one writer.
const HELD: usize = 256;
/// Bytes of a sample in fragments at most.
pub(crate) const LARGEST: usize = 1 << 20;
/// Samples in fragments at a time, of one writer.
const PARTS: usize = 2;
/// Bytes of samples that wait, for one that is missing or for their own fragments, of all writers of a topic.
pub(super) const WAITING: usize = 8 << 20;
/// Writers of one topic at most: one of each participant, for built-in topics.
const WRITERS: usize = 128;

/// A sample that comes in fragments.
#[derive(Clone, Debug)]
struct Parts {
    bytes: Vec<u8>,
    size: usize,
    have: Vec<bool>,
    left: usize,
}

impl Parts {
    /// Bytes that the sample of a fragment takes, with the marks of its fragments; `None` for one that can be none.
    fn needed(fragment: &Fragment<'_>) -> Option<usize> {
        let (size, total) = (usize::from(fragment.size), fragment.total as usize);
        (size > 0 && (1..=LARGEST).contains(&total)).then(|| total + total.div_ceil(size))
    }

    /// For the sample of a fragment, for which there is a number of bytes that it takes.
    fn new(fragment: &Fragment<'_>) -> Self {
        let (size, total) = (usize::from(fragment.size).max(1), fragment.total as usize);
        let count = total.div_ceil(size);
        Self { bytes: vec![0; total], size, have: vec![false; count], left: count }
    }

    /// Bytes that it takes, with the marks of its fragments.
    fn len(&self) -> usize {
        self.bytes.len() + self.have.len()
    }

    /// Takes what is in `fragment`; false if it is of another sample.
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

/// Samples in their order, with their numbers.
pub(crate) type Came = Vec<(i64, Vec<u8>)>;

/// A writer of another participant.
#[derive(Clone, Debug)]
struct Writing {
    to: SocketAddrV4,
    reliable: bool,
    /// The next number that is handed over; of best effort, `None` before the first.
    next: Option<i64>,
    /// It said what it has: what is below was never for this reader.
    has_begun: bool,
    held: BTreeMap<i64, Vec<u8>>,
    parts: BTreeMap<i64, Parts>,
    asked: u32,
    /// Bytes of `held` and `parts`.
    waiting: usize,
}

impl Writing {
    /// Counts what waits again.
    fn count(&mut self) {
        let held: usize = self.held.values().map(Vec::len).sum();
        let parts: usize = self.parts.values().map(Parts::len).sum();
        self.waiting = held + parts;
    }

    /// Takes away what will be of use last: the sample with the highest number, of those above `number`. False if there is
    /// none.
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

    /// Takes away samples in fragments beyond [`PARTS`]. A reliable writer sends again what is missing, and the lowest
    /// number is what everything waits for: the highest goes. Of best effort nothing comes again: the lowest goes.
    fn bound_parts(&mut self) {
        while self.parts.len() > PARTS {
            let gone = if self.reliable { self.parts.pop_last() } else { self.parts.pop_first() };
            drop(gone);
        }
    }
}

/// What was counted of a reader.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ReaderCounts {
    /// Samples that were handed over.
    pub samples: u64,
    /// Samples that will not come any more.
    pub lost: u64,
}

/// A reader of this participant.
#[derive(Debug)]
pub(crate) struct Reader {
    own: Prefix,
    entity: Entity,
    qos: Qos,
    writers: BTreeMap<Guid, Writing>,
    counts: ReaderCounts,
}

impl Reader {
    /// One that asks for `qos`.
    pub fn new(own: Prefix, entity: Entity, qos: Qos) -> Self {
        Self { own, entity, qos, writers: BTreeMap::new(), counts: ReaderCounts::default() }
    }

    /// Which one it is.
    pub fn entity(&self) -> Entity {
        self.entity
    }

    /// Writers that it hears.
    pub fn writers(&self) -> usize {
        self.writers.len()
    }

    /// What was counted.
    pub fn counts(&self) -> ReaderCounts {
        self.counts
    }

    /// A writer that goes with this reader; questions for it go to `to`. False if there are too many.
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
        // A reliable writer says where a reader begins, with its first heartbeat; the others with what comes.
        let next = reliable.then_some(1);
        let (held, parts) = (BTreeMap::new(), BTreeMap::new());
        self.writers.insert(guid, Writing { to, reliable, next, has_begun: false, held, parts, asked: 0, waiting: 0 });
        if reliable {
            self.ask(guid, 0, true, out);
        }
        true
    }

    /// A writer that is gone.
    pub fn remove(&mut self, is: impl Fn(&Guid) -> bool) {
        self.writers.retain(|guid, _| !is(guid));
    }

    /// Takes a sample; gives what is to be handed over, in order.
    pub fn handle_data(&mut self, guid: Guid, number: i64, payload: &[u8]) -> Came {
        let has_room = self.waiting() + payload.len() <= WAITING;
        let Some(writing) = self.writers.get_mut(&guid).filter(|_| number > 0) else { return Vec::new() };
        let next = *writing.next.get_or_insert(number);
        if number < next {
            return Vec::new();
        }
        if writing.reliable {
            // What has no room is asked for again.
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
        // What came in part and is older will not be handed over.
        writing.parts = writing.parts.split_off(&next);
        writing.count();
        vec![(number, payload.to_vec())]
    }

    /// Takes a part of a sample; gives what is to be handed over.
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

    /// Room for `bytes` of sample `number` of a writer: of the writer of whom most waits, samples give way until there is some,
    /// so that nobody keeps the others' out; of this writer itself those behind the sample. False if there is none to be had.
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

    /// What a writer has: what is missing is asked for, what it has no more is lost.
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

    /// What there will never be.
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

    /// Bytes that wait, of all writers.
    pub(super) fn waiting(&self) -> usize {
        self.writers.values().map(|writing| writing.waiting).sum()
    }

    fn lose(&mut self, samples: u64) {
        self.counts.lost = self.counts.lost.saturating_add(samples);
    }

    /// Asks for what is missing up to `last`, or says that nothing is; `begins`: the writer is to say what it has.
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
#[path = "reader_tests.rs"]
mod tests;
