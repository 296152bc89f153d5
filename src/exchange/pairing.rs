//! Pairing of forward and backward frames by frame number, sans-IO.
//!
//! Two robots exchange a forward and a backward frame with one number. Each side's log holds what its card heard; a
//! [`Pairing`] takes both logs of one link in any interleaving and gives the pairs. Host clocks, which differ by up to
//! a minute between robots, are not used.
//!
//! Cases in real logs and their treatment:
//! * **restart**: the sender restarted its counter. A jump back that another record confirms starts a new session.
//! * **two initiators**: where both robots initiate in turns, or answer a third, each log has several counts under one
//!   MAC. Our schedulers keep them apart (`numbering`), and each count is followed separately, so a change of turns is
//!   no restart.
//! * **wrap**: `u32::MAX` to 0 is a step of one.
//! * **duplicate**: the same number again within a session (overheard echoes, 892 in one log, measured): the first is
//!   used, the others are counted.
//! * **implausible jump**: a number more than some frames from its neighbours that no record soon after confirms (a
//!   flipped bit; the counter of the WSR toolbox's sender turns to noise after 68,966 packets; stale header fields):
//!   dropped and counted, without further losses.
//! * **another session's partner**: numbers repeat from session to session, and one log may have missed a whole one.
//!   The cards' own clocks distinguish them: `clock_tx - clock_rx` of a pair continues that of the last one to within
//!   its drift. Other candidates continue to wait for their partner. If none fits any more (a card was reset), a new
//!   difference is accepted once a run of candidates agrees to within the jitter of a turn-around: exchanges agree,
//!   frames of different sessions do not.

pub mod by_clock;
mod clock;
pub(crate) mod numbering;
mod side;

use clock::Clock;
use side::{Entry, Key, SideState};
use std::collections::VecDeque;

/// The log a record is from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkSide {
    /// The log of the robot whose trajectory is known: it heard the backward frames.
    Receiver,
    /// The log of the other robot: it heard the forward frames.
    Transmitter,
}

/// A matched exchange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair<T> {
    /// Frame number shared by both frames.
    pub number: u32,
    /// What the receiver's card reported of the backward frame.
    pub receiver: T,
    /// What the transmitter's card reported of the forward frame.
    pub transmitter: T,
    /// `clock_tx - clock_rx`, microseconds, unwrapped along the link.
    pub clock_difference_us: i64,
    /// The receiver's card clock, microseconds, unwrapped along the link.
    pub clock_rx_us: i64,
}

/// Records of one side, by outcome. `handed = paired + unpaired + duplicates + implausible + mispaired` once
/// [`Pairing::finish`] was called.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct SideCounts {
    /// Records handed in.
    pub handed: u64,
    /// Records that found their partner.
    pub paired: u64,
    /// Records whose partner never came.
    pub unpaired: u64,
    /// Records whose number came before.
    pub duplicates: u64,
    /// Records with a number far from its neighbours.
    pub implausible: u64,
    /// Records whose would-be partner was from another session.
    pub mispaired: u64,
    /// Times that a count restarted: the sender restarted, or another robot initiates too.
    pub restarts: u64,
    /// Numbers skipped within sessions (missing, not necessarily lost: logs may be filtered).
    pub missing: u64,
}

/// Pairs the two logs of one link. Call [`handle`](Self::handle) for each record of either side in its log's order,
/// [`poll_pair`](Self::poll_pair) until `None` after each, [`finish`](Self::finish) at the end of both logs, and
/// [`poll_pair`](Self::poll_pair) until `None` once more. Pairs come in the order of the exchange, except for
/// reordering; the first ones only when the clocks' difference is known.
#[derive(Clone, Debug)]
pub struct Pairing<T> {
    window: usize,
    receiver: SideState<T>,
    transmitter: SideState<T>,
    ready: VecDeque<Pair<T>>,
    clock: Clock,
}

impl<T> Pairing<T> {
    /// A pairing in which at most `window` records of a side wait for their partners.
    ///
    /// 1,024 is enough if the log that is [behind](Self::behind) is read next.
    #[must_use]
    pub fn new(window: usize) -> Self {
        Self {
            window: window.max(1),
            receiver: SideState::default(),
            transmitter: SideState::default(),
            ready: VecDeque::new(),
            clock: Clock::default(),
        }
    }

    /// Takes a record of `side` with its frame number and its card's clock (`timestamp_low`).
    pub fn handle(&mut self, side: LinkSide, number: u32, timestamp_low: u32, item: T) {
        let entry = Entry { clock: timestamp_low, met_other: false, item };
        for (key, entry) in self.side_mut(side).place(number, entry).into_iter().flatten() {
            if self.side_mut(side).wait(key, entry) && self.seek(side, key) {
                self.seek_all();
            }
        }
        let window = self.window;
        self.side_mut(side).keep(window);
    }

    /// Pairs waiting candidates that fit a difference of the clocks that was just accepted.
    fn seek_all(&mut self) {
        let mut keys: Vec<Key> = self.receiver.waiting.keys().copied().collect();
        keys.sort_unstable();
        for key in keys {
            self.seek(LinkSide::Receiver, key);
        }
    }

    /// Looks for the partner of a waiting record. True if it found a new difference of the clocks.
    fn seek(&mut self, side: LinkSide, key: Key) -> bool {
        let (own, other) = match side {
            LinkSide::Receiver => (&mut self.receiver, &mut self.transmitter),
            LinkSide::Transmitter => (&mut self.transmitter, &mut self.receiver),
        };
        let Some(entry) = own.waiting.get_mut(&key) else { return false };
        let mut learnt = false;
        for session in other.sessions() {
            let candidate = (session, key.1);
            let Some(partner) = other.waiting.get_mut(&candidate) else { continue };
            let (receiver, transmitter, rx, tx) = match side {
                LinkSide::Receiver => (key, candidate, entry.clock, partner.clock),
                LinkSide::Transmitter => (candidate, key, partner.clock, entry.clock),
            };
            if let Some(clocks) = self.clock.follow(rx, tx) {
                self.pair_up(receiver, transmitter, clocks);
                return learnt;
            }
            (entry.met_other, partner.met_other) = (true, true);
            learnt |= self.clock.doubt(receiver.0, rx, tx);
        }
        learnt
    }

    fn pair_up(&mut self, rx: Key, tx: Key, (clock_rx_us, clock_difference_us): (i64, i64)) {
        let (receiver, transmitter) = (self.receiver.waiting.remove(&rx), self.transmitter.waiting.remove(&tx));
        if let (Some(receiver), Some(transmitter)) = (receiver, transmitter) {
            self.receiver.counts.paired += 1;
            self.transmitter.counts.paired += 1;
            let (receiver, transmitter) = (receiver.item, transmitter.item);
            self.ready.push_back(Pair { number: rx.1, receiver, transmitter, clock_difference_us, clock_rx_us });
        }
    }

    /// The next pair.
    pub fn poll_pair(&mut self) -> Option<Pair<T>> {
        self.ready.pop_front()
    }

    /// The side whose log is behind in (session, frame number) and should be read next, by the newest record of either
    /// side. If only one side has a count, that side is ahead.
    #[must_use]
    pub fn behind(&self) -> LinkSide {
        let (receiver, transmitter) = (&self.receiver, &self.transmitter);
        let is_ahead = |ahead: Option<(i64, i64)>| ahead.is_some_and(|by| by > (0, 0));
        let (by_receiver, by_transmitter) = (receiver.ahead_of(transmitter), transmitter.ahead_of(receiver));
        match (is_ahead(by_receiver), is_ahead(by_transmitter)) {
            (true, false) => LinkSide::Transmitter,
            (false, true) => LinkSide::Receiver,
            (false, false) if by_receiver.is_some() => LinkSide::Receiver,
            (false, false) if by_transmitter.is_some() => LinkSide::Transmitter,
            _ if transmitter.counts.handed < receiver.counts.handed => LinkSide::Transmitter,
            _ => LinkSide::Receiver,
        }
    }

    /// Ends both logs: waiting records are unpaired, an unconfirmed jump is implausible. Logs too short to find the
    /// clocks' difference give their pairs now.
    pub fn finish(&mut self) {
        if !self.clock.is_known() && self.clock.believe() {
            self.seek_all();
        }
        self.receiver.finish();
        self.transmitter.finish();
    }

    /// The outcome of the records of `side` so far.
    #[must_use]
    pub fn counts(&self, side: LinkSide) -> SideCounts {
        match side {
            LinkSide::Receiver => self.receiver.counts,
            LinkSide::Transmitter => self.transmitter.counts,
        }
    }

    fn side_mut(&mut self, side: LinkSide) -> &mut SideState<T> {
        match side {
            LinkSide::Receiver => &mut self.receiver,
            LinkSide::Transmitter => &mut self.transmitter,
        }
    }
}

#[cfg(test)]
mod tests;
