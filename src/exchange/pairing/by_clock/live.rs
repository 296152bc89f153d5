//! Pairing by clocks while records arrive: a window of each side; each pair is returned once.
//!
//! Records are kept until the clocks are aligned; alignment is tried repeatedly. From then on, the line is followed as in a
//! whole log. A pair is returned once no later record can claim a part of it: after the next record of each side. A
//! clock that was set back, a long pause, or deviations that leave the line end it; later records are aligned again. If a
//! clock was set forward by less than [`PAUSE_NS`], up to [`LOOK`] pairs may be wrong.

use super::{
    CardClock, Claim, Claims, Fit, Follower, LEAST, Line, LinkSide, Overlay, Pair, Refusal, STRETCH, Side, centre,
    nearest, sharpness_of, taken,
};
use std::collections::VecDeque;

/// Limit of records kept of a side before the clocks are aligned.
const WINDOW: usize = 2 * STRETCH;
/// Limit of records of a side that wait for the other side.
const BACKLOG: usize = 2 * WINDOW;
/// After a longer pause, the clocks are aligned again, because a clock that was set forward looks like a pause.
const PAUSE_NS: i64 = 30_000_000_000;
/// A new line continues the one before if it differs by less than this, plus a change of drift.
const SAME_NS: f64 = 500_000.0;
const MAX_CHANGE: f64 = 5e-6;
/// The line is checked after this many deviations, ...
const LOOK: usize = 24;
/// ... and given up after this many records with fewer deviations.
const LONGEST_LOOK: usize = 512;

/// Pairs the records of one link while they arrive. Call [`handle`](Self::handle) for each record of one sender's frames on
/// either side, in its card's order; after each, call [`poll_pair`](Self::poll_pair) until `None`.
#[derive(Clone, Debug)]
pub(crate) struct Live<T> {
    receiver: Side<T>,
    transmitter: Side<T>,
    lock: Option<Lock>,
    /// Number of records, of the side with fewer, at which alignment is next tried.
    try_at: usize,
    refusal: Option<Refusal>,
    /// The previous line.
    before: Option<Line>,
    restarts: u32,
    number: u32,
    ready: VecDeque<Pair<T>>,
}

/// State while the clocks are aligned.
#[derive(Clone, Debug)]
struct Lock {
    fit: Fit,
    half_ns: f64,
    follower: Follower,
    claims: Claims,
    /// The receiver's first undecided record.
    next: usize,
    /// The last pair, by the indices of its records.
    last: Option<(usize, usize)>,
    /// Deviations since the last check, and number of records since then.
    off: Vec<f64>,
    looked: usize,
}

impl<T> Side<T> {
    fn forget(&mut self, count: usize) {
        let count = count.min(self.at_ns.len());
        self.at_ns.drain(..count);
        self.host_us.drain(..count);
        self.items.drain(..count);
        self.starts.truncate(1);
    }

    fn len(&self) -> usize {
        self.at_ns.len()
    }
}

impl Lock {
    fn new(overlay: &Overlay<'_>, line: Line, fit: Fit) -> Self {
        let middle = overlay.a.partition_point(|a| (*a as f64) < line.at);
        let mut wanted = vec![0.0; middle];
        let start = overlay.follow_way(line, overlay.a.iter().take(middle).rev().zip(wanted.iter_mut().rev()));
        // Earlier records have no partner: the transmitter's records begin later, or it was silent.
        let first = overlay.b.first().map_or(0.0, |b| *b as f64) - overlay.half_ns;
        let next = overlay.a.partition_point(|a| start.on_other(*a as f64) < first);
        let (follower, claims, off) = (Follower::new(start), Claims::default(), Vec::new());
        Self { fit, half_ns: overlay.half_ns, follower, claims, next, last: None, off, looked: 0 }
    }

    /// Notes the deviation of a record. False if the records have left the line.
    fn look(&mut self, off: Option<f64>) -> bool {
        self.off.extend(off);
        self.looked += 1;
        if self.off.len() < LOOK {
            return self.looked < LONGEST_LOOK;
        }
        let sharpness = sharpness_of(&self.off);
        let middle = centre(&mut self.off).0;
        (self.looked, self.off) = (0, Vec::new());
        middle.abs() < 0.1 * self.half_ns && sharpness > self.fit.sharpness / 4.0
    }

    /// Shifts the indices after the sides have forgotten records.
    fn forget(&mut self, receiver: usize, transmitter: usize) {
        self.next = self.next.saturating_sub(receiver);
        let moved = |i: usize, j: usize| Some((i.checked_sub(receiver)?, j.checked_sub(transmitter)?));
        self.last = self.last.and_then(|(i, j)| moved(i, j));
        self.claims.0 = self.claims.0.and_then(|claim| {
            let (i, j) = moved(claim.i, claim.j)?;
            Some(Claim { i, j, ..claim })
        });
    }
}

impl<T> Live<T> {
    /// A link between two cards with these clocks.
    pub(crate) fn new(receiver: CardClock, transmitter: CardClock) -> Self {
        Self {
            receiver: Side::new(receiver),
            transmitter: Side::new(transmitter),
            lock: None,
            try_at: 2 * LEAST,
            refusal: None,
            before: None,
            restarts: 0,
            number: 0,
            ready: VecDeque::new(),
        }
    }

    /// Takes a record of `side` with its card's clock.
    pub(crate) fn handle(&mut self, side: LinkSide, ticks: u64, item: T) {
        let own = self.side_mut(side);
        let step_ns = own.step_ns(ticks);
        if !(0..=PAUSE_NS).contains(&step_ns) {
            self.part(side);
        }
        self.side_mut(side).push(ticks, None, item);
        if self.lock.is_none() {
            self.seek();
        }
        self.advance(false);
        self.keep();
    }

    /// The next pair, in the order of the receiver's records; pair numbers increase.
    pub(crate) fn poll_pair(&mut self) -> Option<Pair<T>> {
        self.ready.pop_front()
    }

    /// How often the clocks did not continue the previous line: card restarts.
    pub(crate) fn restarts(&self) -> u32 {
        self.restarts
    }

    /// Why alignment failed, while there are no pairs.
    pub(crate) fn refusal(&self) -> Option<Refusal> {
        self.refusal.filter(|_| self.lock.is_none())
    }

    /// Ends both sides and decides what remains.
    pub(crate) fn finish(&mut self) {
        if self.lock.is_none() {
            self.try_at = LEAST;
            self.seek();
        }
        self.advance(true);
        [&mut self.receiver, &mut self.transmitter].into_iter().for_each(Side::count_unpaired);
    }

    /// Counts of `side`; unpaired records are counted when both sides have ended.
    #[cfg(test)]
    pub(super) fn counts(&self, side: LinkSide) -> super::ClockCounts {
        match side {
            LinkSide::Receiver => self.receiver.counts,
            LinkSide::Transmitter => self.transmitter.counts,
        }
    }

    /// Number of records in memory, of the side with more.
    #[cfg(test)]
    pub(super) fn kept(&self) -> usize {
        self.receiver.len().max(self.transmitter.len())
    }

    fn side_mut(&mut self, side: LinkSide) -> &mut Side<T> {
        match side {
            LinkSide::Receiver => &mut self.receiver,
            LinkSide::Transmitter => &mut self.transmitter,
        }
    }

    /// Ends the line: the card of `side` was restarted, or paused for long. The other side keeps its records after the last
    /// pair, because they may pair with later ones.
    fn part(&mut self, side: LinkSide) {
        self.advance(true);
        let (i, j) = self.unlock();
        let (receiver, transmitter) = match side {
            LinkSide::Receiver => (self.receiver.len(), j),
            LinkSide::Transmitter => (i, self.transmitter.len()),
        };
        self.receiver.forget(receiver);
        self.transmitter.forget(transmitter);
    }

    /// Gives up the alignment. Returns, for each side, the number of records up to the last pair or, without a pair, the number
    /// tried.
    fn unlock(&mut self) -> (usize, usize) {
        self.try_at = 2 * LEAST;
        let Some(lock) = self.lock.take() else { return (0, 0) };
        self.before = Some(lock.follower.line);
        lock.last.map_or((lock.next, 0), |(i, j)| (i + 1, j + 1))
    }

    /// Tries to align the clocks, once there are enough new records and before a side forgets some.
    fn seek(&mut self) {
        let (count, most) =
            (self.receiver.len().min(self.transmitter.len()), self.receiver.len().max(self.transmitter.len()));
        if count < self.try_at && (count < LEAST || most < WINDOW) {
            return;
        }
        let overlay = Overlay::new(&self.receiver.at_ns, &self.transmitter.at_ns);
        match overlay.stands_out(&[0.5], &|_, _| true) {
            Ok((line, fit)) => {
                let goes_on = |before: Line| {
                    let off = line.difference - (before.difference + before.drift * (line.at - before.at));
                    off.abs() < SAME_NS + MAX_CHANGE * (line.at - before.at).abs()
                };
                self.restarts += u32::from(!self.before.is_none_or(goes_on));
                self.lock = Some(Lock::new(&overlay, line, fit));
            }
            Err(why) => self.refusal = Some(why),
        }
        self.try_at = count + count.div_ceil(2);
    }

    /// Decides all records that can be decided; `at_end`, all that remain.
    fn advance(&mut self, at_end: bool) {
        let Some(lock) = &mut self.lock else { return };
        let (receiver, transmitter) = (&mut self.receiver, &mut self.transmitter);
        let (own_to, other_to) = (receiver.at_ns.last().copied(), transmitter.at_ns.last().copied());
        let (own_to, other_to) = (own_to.unwrap_or_default() as f64, other_to.unwrap_or_default() as f64);
        let mut is_on = true;
        while let Some(a) = receiver.at_ns.get(lock.next).map(|a| *a as f64) {
            let wanted = lock.follower.line.on_other(a);
            let is_past = other_to >= wanted + lock.half_ns;
            if !is_on || !(is_past || at_end) {
                break;
            }
            let near = nearest(&transmitter.at_ns, wanted, lock.half_ns);
            let ended = match near {
                Some((j, off)) => lock.claims.claim(lock.next, j, off),
                None => lock.claims.0.take(),
            };
            self.ready.extend(lock.settle(ended, receiver, transmitter, &mut self.number));
            let off = near.map(|(_, off)| off);
            lock.next += 1;
            is_on = lock.look(off);
            if lock.follower.note(a, off) {
                lock.half_ns = Overlay::new(&receiver.at_ns, &transmitter.at_ns).half_ns;
            }
        }
        let is_safe = |claim: &Claim| {
            let at = transmitter.at_ns.get(claim.j).map_or(0.0, |b| *b as f64);
            at_end || lock.follower.line.on_other(own_to) > at + lock.half_ns
        };
        if lock.claims.0.as_ref().is_some_and(is_safe) {
            let claim = lock.claims.0.take();
            self.ready.extend(lock.settle(claim, receiver, transmitter, &mut self.number));
        }
        if !is_on {
            let (i, j) = self.unlock();
            self.receiver.forget(i);
            self.transmitter.forget(j);
        }
    }

    /// Forgets records that no pair can need any more.
    fn keep(&mut self) {
        let (own, other) = (self.receiver.len(), self.transmitter.len());
        let Some(lock) = &mut self.lock else {
            self.receiver.forget(if own >= WINDOW { STRETCH } else { 0 });
            self.transmitter.forget(if other >= WINDOW { STRETCH } else { 0 });
            return;
        };
        // Decided records are kept, because their pauses show the length of an exchange.
        let mut gone = (0, 0);
        if lock.next > WINDOW {
            gone.0 = lock.next - STRETCH;
            let from = lock.follower.line.on_other(self.receiver.at_ns.get(gone.0).map_or(0.0, |a| *a as f64));
            gone.1 = self.transmitter.at_ns.partition_point(|b| (*b as f64) < from);
        } else if own.max(other) > BACKLOG + WINDOW {
            gone = (own.saturating_sub(BACKLOG), other.saturating_sub(BACKLOG));
        }
        if gone != (0, 0) {
            lock.forget(gone.0, gone.1);
            self.receiver.forget(gone.0);
            self.transmitter.forget(gone.1);
        }
    }
}

impl Lock {
    /// Makes a pair of a decided claim, unless it is ambiguous.
    fn settle<T>(
        &mut self,
        claim: Option<Claim>,
        receiver: &mut Side<T>,
        transmitter: &mut Side<T>,
        number: &mut u32,
    ) -> Option<Pair<T>> {
        let claim = claim?;
        if claim.is_ambiguous {
            receiver.counts.ambiguous += 2;
            transmitter.counts.ambiguous += 1;
            return None;
        }
        let pair = taken(receiver, transmitter, (claim.i, claim.j))?;
        self.last = Some((claim.i, claim.j));
        *number = number.wrapping_add(1);
        Some(Pair { number: *number, ..pair })
    }
}
