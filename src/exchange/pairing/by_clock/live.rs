//! The same while records come: a window of each side, pairs once each.
//!
//! Records are kept until the clocks are understood, which is tried again and again; from then on the line is followed as in a
//! whole log, and a pair is given as soon as no later record can have a part of it: with the next record of each side. A
//! clock that was set back, or a long pause, ends the line: what follows is aligned anew, and so it is where the deviations no longer
//! lie together. There up to [`LOOK`] pairs may be wrong, where a clock was set forward within [`PAUSE_NS`].

use super::{
    CardClock, Claim, Claims, Fit, Follower, LEAST, Line, LinkSide, Overlay, Pair, Refusal, STRETCH, Side, centre,
    nearest, sharpness_of, taken,
};
use std::collections::VecDeque;

/// Records of a side that are kept before the clocks are understood.
const WINDOW: usize = 2 * STRETCH;
/// Records of a side that wait for the other at most.
const BACKLOG: usize = 2 * WINDOW;
/// After a longer pause the clocks are aligned anew: one that was set forward looks like a pause.
const PAUSE_NS: i64 = 30_000_000_000;
/// A line that goes on as before is within so much of it, and of a change of its drift.
const SAME_NS: f64 = 500_000.0;
const MAX_CHANGE: f64 = 5e-6;
/// Deviations after which it is asked whether they still lie on the line, ...
const LOOK: usize = 24;
/// ... and records without as many.
const LONGEST_LOOK: usize = 512;

/// Pairs the records of one link while they come. Call [`handle`](Self::handle) for each record of the frames of one sender on
/// either side, in its card's order, and [`poll_pair`](Self::poll_pair) until `None` after each.
#[derive(Clone, Debug)]
pub(crate) struct Live<T> {
    receiver: Side<T>,
    transmitter: Side<T>,
    lock: Option<Lock>,
    /// Records of the side with fewer when the clocks are next looked at.
    try_at: usize,
    refusal: Option<Refusal>,
    /// The line before the present one.
    before: Option<Line>,
    restarts: u32,
    number: u32,
    ready: VecDeque<Pair<T>>,
}

/// Clocks that are understood.
#[derive(Clone, Debug)]
struct Lock {
    fit: Fit,
    half_ns: f64,
    follower: Follower,
    claims: Claims,
    /// The receiver's first record that is not decided.
    next: usize,
    /// The last pair, by the places of its records.
    last: Option<(usize, usize)>,
    /// Deviations since the last look, and records.
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
        // Earlier ones have no partner: the transmitter's records begin later, or it was silent.
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

    /// The sides have forgotten so many records.
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
    /// A link of two cards with these clocks.
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

    /// The next pair, in the order of the receiver's records; numbers rise.
    pub(crate) fn poll_pair(&mut self) -> Option<Pair<T>> {
        self.ready.pop_front()
    }

    /// How often the clocks did not go on as before: a card was restarted.
    pub(crate) fn restarts(&self) -> u32 {
        self.restarts
    }

    /// Why there are no pairs, where records were looked at in vain.
    pub(crate) fn refusal(&self) -> Option<Refusal> {
        self.refusal.filter(|_| self.lock.is_none())
    }

    /// Ends both sides.
    pub(crate) fn finish(&mut self) {
        if self.lock.is_none() {
            self.try_at = LEAST;
            self.seek();
        }
        self.advance(true);
        [&mut self.receiver, &mut self.transmitter].into_iter().for_each(Side::count_unpaired);
    }

    /// What became of the records of `side`: what is unpaired is known when both have ended.
    #[cfg(test)]
    pub(super) fn counts(&self, side: LinkSide) -> super::ClockCounts {
        match side {
            LinkSide::Receiver => self.receiver.counts,
            LinkSide::Transmitter => self.transmitter.counts,
        }
    }

    /// Records in memory, of the side with more.
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

    /// The card of `side` was restarted, or paused for long. What the other side has beyond the last pair may go with what comes.
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

    /// The clocks are no longer understood. Gives how many records of each side are up to the last pair; without one, those that
    /// were looked at in vain.
    fn unlock(&mut self) -> (usize, usize) {
        self.try_at = 2 * LEAST;
        let Some(lock) = self.lock.take() else { return (0, 0) };
        self.before = Some(lock.follower.line);
        lock.last.map_or((lock.next, 0), |(i, j)| (i + 1, j + 1))
    }

    /// Tries to understand the clocks, once there are enough more records, and before a side forgets some.
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

    /// Decides what can be decided; at the end everything.
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

    /// Forgets what no pair can need any more.
    fn keep(&mut self) {
        let (own, other) = (self.receiver.len(), self.transmitter.len());
        let Some(lock) = &mut self.lock else {
            self.receiver.forget(if own >= WINDOW { STRETCH } else { 0 });
            self.transmitter.forget(if other >= WINDOW { STRETCH } else { 0 });
            return;
        };
        // Pauses of what was decided tell how long an exchange is.
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
    /// Makes a pair of a claim that stands.
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
