//! Interprets the events of the program's ring. It has no kernel, so that tests can stage every case.

use super::StockCounts;
use csi5300::source::Loss;
use csi5300::time::HostTimes;
use driver_iface::Mac;
use driver_iface::bfee::{Bfee, MAX_BODY};
use driver_iface::record::{MAX_LENGTH, Record, code};
use driver_iface::stock::{Card, Event, Options, Packet};

/// Limit of cards, more than a machine can hold. A new one replaces the one seen first.
const CARDS_KEPT: usize = 8;

/// The two clocks, read together.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clocks {
    /// CLOCK_MONOTONIC, nanoseconds.
    pub(super) monotonic_ns: i64,
    /// Wall clock, microseconds since the Unix epoch.
    pub(super) wall_us: Option<i64>,
}

impl Clocks {
    /// The wall clock at another point of the monotonic one, microseconds.
    fn wall_at(&self, monotonic_ns: u64) -> Option<i64> {
        let since_ns = self.monotonic_ns.saturating_sub(i64::try_from(monotonic_ns).ok()?);
        Some(self.wall_us?.saturating_sub(since_ns / 1_000))
    }
}

/// The result of an event.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Turn {
    /// A record: call [`Intake::record`]. With its host time, microseconds.
    Record(Option<i64>),
    /// Packets are missing before this event: call [`Intake::turn`] again, it is kept.
    Lost(Loss),
    /// Nothing: take the next event.
    Next,
}

struct Known {
    key: u64,
    card: Card,
    host_times: HostTimes,
    /// It heard this robot's own frames, so it is another robot's.
    is_others: bool,
}

/// The decisions on the events of one ring.
pub(super) struct Intake {
    options: Options,
    own: Option<Mac>,
    cards: Vec<Known>,
    /// The event at hand, copied from the ring.
    event: Vec<u8>,
    is_held: bool,
    code: u8,
    body: Vec<u8>,
    scratch: Box<[u8; MAX_BODY]>,
    /// The program's counters as the last event had them; they wrap.
    seen: (u32, u32),
    pub(super) counters: StockCounts,
}

impl Intake {
    pub(super) fn new(options: Options, own: Option<Mac>) -> Self {
        Self {
            options,
            own,
            cards: Vec::with_capacity(CARDS_KEPT),
            event: Vec::with_capacity(MAX_LENGTH),
            is_held: false,
            code: 0,
            body: Vec::with_capacity(MAX_LENGTH),
            scratch: Box::new([0; MAX_BODY]),
            seen: (0, 0),
            counters: StockCounts::default(),
        }
    }

    /// Takes an event from the ring.
    pub(super) fn take(&mut self, bytes: &[u8]) {
        self.event.clear();
        self.event.extend_from_slice(bytes);
        self.is_held = true;
        self.counters.events += 1;
    }

    /// True while an event is at hand.
    pub(super) fn is_held(&self) -> bool {
        self.is_held
    }

    /// Everything of all cards so far, and how many there are.
    pub(super) fn counters(&self) -> StockCounts {
        let cards = self.cards.iter().fold(self.counters.cards, |sum, known| sum.plus(&known.card.counts()));
        StockCounts { cards, ..self.counters }
    }

    /// The driver was reloaded: its cards are others.
    pub(super) fn forget_cards(&mut self) {
        self.counters.cards = self.counters().cards;
        self.cards.clear();
    }

    /// Looks at the event at hand.
    pub(super) fn turn(&mut self, clocks: Clocks) -> Turn {
        let Ok(event) = Event::new_checked(&self.event) else {
            self.is_held = false;
            self.counters.malformed += 1;
            self.cards.iter_mut().for_each(|known| known.card.gap());
            return Turn::Next;
        };
        let (ring_full, unreadable) = (event.ring_full(), event.unreadable());
        let missing = [ring_full.wrapping_sub(self.seen.0), unreadable.wrapping_sub(self.seen.1)];
        if missing != [0, 0] {
            // For all cards: none may combine packets before and after the gap.
            self.seen = (ring_full, unreadable);
            self.cards.iter_mut().for_each(|known| known.card.gap());
            self.counters.ring_full += u64::from(missing[0]);
            self.counters.unreadable += u64::from(missing[1]);
            return Turn::Lost(Loss::Overrun { dropped: Some(missing.into_iter().map(u64::from).sum()) });
        }
        self.is_held = false;
        let host_us = clocks.wall_at(event.time_ns());
        let at = place(&mut self.cards, &mut self.counters, event.card());
        let Some(known) = self.cards.get_mut(at) else { return Turn::Next };
        let packet = event.packet();
        if let Packet::RxMpdu(Ok(mpdu)) = &packet {
            let sender = mpdu.sender().map(|(mac, _)| mac);
            known.is_others |= sender.is_some() && sender == self.own;
        }
        let handled = known.card.handle(&self.options, &packet, host_us.unwrap_or(0), &mut self.scratch);
        let Some(record) = handled else { return Turn::Next };
        if known.is_others {
            self.counters.others += 1;
            return Turn::Next;
        }
        if record.code == code::MPDU && known.card.counts().records == 0 {
            // Possibly another kind of card, whose driver shares the function.
            self.counters.held_back += 1;
            return Turn::Next;
        }
        self.code = record.code;
        self.body.clear();
        self.body.extend_from_slice(record.body);
        self.counters.records += 1;
        let stamp = Bfee::new_checked(&self.body).ok().filter(|_| self.code == code::BFEE);
        let came = |us| stamp.map_or(us, |bfee| known.host_times.came_at(us, bfee.timestamp_low()));
        Turn::Record(host_us.map(came))
    }

    /// The record of the last [`Turn::Record`].
    pub(super) fn record(&self) -> Record<'_> {
        Record { code: self.code, body: &self.body }
    }
}

/// The place of a card, made if it is new.
fn place(cards: &mut Vec<Known>, counters: &mut StockCounts, key: u64) -> usize {
    if let Some(at) = cards.iter().position(|known| known.key == key) {
        return at;
    }
    if cards.len() >= CARDS_KEPT {
        counters.cards = counters.cards.plus(&cards.remove(0).card.counts());
    }
    counters.cards_seen += 1;
    cards.push(Known { key, card: Card::default(), host_times: HostTimes::default(), is_others: false });
    cards.len() - 1
}

#[cfg(test)]
mod tests;
