//! Pairing of forward and backward frames by frame number, sans-IO.
//!
//! Two robots exchange a forward and a backward frame with one number. Each side's log holds what its card heard; a
//! [`Pairing`] takes both logs of one link in any interleaving and gives the pairs. Host clocks, which differ by up
//! to a minute between robots, are never looked at.
//!
//! What goes wrong in the field, and what is done:
//! * **restart**: the counter starts anew (the sender was restarted). A jump that the next record confirms opens a
//!   new session; numbers of different sessions never pair.
//! * **wrap**: `u32::MAX` to 0 is a step of one.
//! * **duplicate**: the same number again within a session (overheard echoes, [measured] 892 in one log): the first
//!   stays, the others are counted.
//! * **implausible jump**: a number far from its neighbours that the next record does not confirm (the reference
//!   sender's counter turns to noise after 68,966 packets; stale header fields): dropped and counted.
//! * **wrong session**: one log missed a whole session. The cards' own clocks tell: `clock_tx - clock_rx` of a pair
//!   must continue that of the last pair. Pairs that do not are dropped and counted.

use std::collections::{HashMap, VecDeque};
use std::hash::{BuildHasherDefault, Hasher};

/// The log a record is from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
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

/// Records of one side, by what became of them. `handed = paired + unpaired + duplicates + implausible + mispaired`
/// once [`Pairing::finish`] was called.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct SideCounts {
    /// Records handed in.
    pub handed: u64,
    /// Records that found their partner.
    pub paired: u64,
    /// Records whose partner never came.
    pub unpaired: u64,
    /// Records whose number was there already.
    pub duplicates: u64,
    /// Records with a number far from its neighbours.
    pub implausible: u64,
    /// Records whose would-be partner was from another session.
    pub mispaired: u64,
    /// Times the counter started anew.
    pub restarts: u64,
    /// Numbers skipped within sessions (missing, not necessarily lost: logs may be filtered).
    pub missing: u64,
}

/// Largest forward step of the frame number taken at face value: at the reference's highest rate (1,000 per second)
/// a pause of more than half an hour.
const MAX_STEP: u32 = 1 << 21;
/// Largest step back taken for reordering rather than a restart.
const MAX_REORDER: u32 = 32;
/// How far `clock_tx - clock_rx` of a pair may be from the last pair's: 5 ms of turn-around and 200 ppm of drift.
const CLOCK_SLACK_US: i64 = 5_000;
const CLOCK_DRIFT_PER_S: i64 = 200;
/// So many pairs in a row that agree with each other but not with the past mean that a card's clock was reset.
const CLOCK_RESET_AFTER: u32 = 8;

/// Hashes the few thousand (session, number) keys of a window: one multiplication is plenty where the window is
/// bounded, whoever chose the numbers.
#[derive(Clone, Copy, Debug, Default)]
struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.write_u32(u32::from(*byte)));
    }

    fn write_u32(&mut self, value: u32) {
        self.0 = (self.0.rotate_left(32) ^ u64::from(value)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 ^= self.0 >> 29;
    }
}

type Waiting<T> = HashMap<(u32, u32), Entry<T>, BuildHasherDefault<KeyHasher>>;

#[derive(Clone, Debug)]
struct Entry<T> {
    clock: u32,
    item: T,
}

/// A record with its session and number.
type Placed<T> = (u32, u32, Entry<T>);

#[derive(Clone, Debug)]
struct SideState<T> {
    session: u32,
    last: Option<u32>,
    suspect: Option<(u32, Entry<T>)>,
    waiting: Waiting<T>,
    order: VecDeque<(u32, u32)>,
    seen: VecDeque<(u32, u32)>,
    counts: SideCounts,
}

impl<T> Default for SideState<T> {
    fn default() -> Self {
        Self {
            session: 0,
            last: None,
            suspect: None,
            waiting: Waiting::default(),
            order: VecDeque::new(),
            seen: VecDeque::new(),
            counts: SideCounts::default(),
        }
    }
}

/// Pairs the two logs of one link. Call [`handle`](Self::handle) for each record of either side in its log's order,
/// [`poll_pair`](Self::poll_pair) until `None` after each, and [`finish`](Self::finish) at the end of both logs.
#[derive(Clone, Debug)]
pub struct Pairing<T> {
    window: usize,
    receiver: SideState<T>,
    transmitter: SideState<T>,
    ready: VecDeque<(u32, Entry<T>, Entry<T>)>,
    clock: Clock,
}

/// Unwraps the two card clocks along the link and judges whether a pair continues it.
#[derive(Clone, Debug, Default)]
struct Clock {
    last: Option<(i64, i64)>,
    rejected: Option<(u32, u32, u32)>,
}

impl Clock {
    /// The unwrapped (receiver clock, difference) of a pair, or `None` if it does not continue the link.
    fn admit(&mut self, rx: u32, tx: u32) -> Option<(i64, i64)> {
        let raw = tx.wrapping_sub(rx);
        let Some((last_rx, last_difference)) = self.last else {
            let first = (i64::from(rx), i64::from(raw.cast_signed()));
            self.last = Some(first);
            return Some(first);
        };
        let step_us = i64::from(rx.wrapping_sub(last_rx as u32).cast_signed());
        let change_us = i64::from(raw.wrapping_sub(last_difference as u32).cast_signed());
        let slack_us = CLOCK_SLACK_US + step_us.abs() / 1_000_000 * CLOCK_DRIFT_PER_S;
        if change_us.abs() <= slack_us {
            self.rejected = None;
        } else if !self.agrees_with_rejected(rx, raw) {
            return None;
        }
        let next = (last_rx + step_us, last_difference + change_us);
        self.last = Some(next);
        Some(next)
    }

    fn agrees_with_rejected(&mut self, rx: u32, raw: u32) -> bool {
        let run = match self.rejected {
            Some((_, last, run)) if i64::from(raw.wrapping_sub(last).cast_signed()).abs() <= CLOCK_SLACK_US => run + 1,
            _ => 1,
        };
        self.rejected = (run < CLOCK_RESET_AFTER).then_some((rx, raw, run));
        run >= CLOCK_RESET_AFTER
    }
}

impl<T> SideState<T> {
    /// Judges the number of a record: gives what is now known to belong to a session, the record itself and one that it
    /// vouches for. Nothing while the record is suspect.
    fn place(&mut self, number: u32, entry: Entry<T>) -> [Option<Placed<T>>; 2] {
        let mut vouched = None;
        self.counts.handed += 1;
        if let Some((suspect, held)) = self.suspect.take() {
            let follows_suspect = plausible_step(suspect, number);
            let follows_last = self.last.is_some_and(|last| plausible_step(last, number));
            if follows_suspect && !(follows_last && number != suspect && close(self.last, number)) {
                self.session += 1;
                self.counts.restarts += 1;
                self.seen.clear();
                self.last = Some(suspect);
                vouched = Some((self.session, suspect, held));
            } else {
                self.counts.implausible += 1;
            }
        }
        match self.last {
            Some(last) if !plausible_step(last, number) => {
                self.suspect = Some((number, entry));
                return [vouched, None];
            }
            Some(last) if number.wrapping_sub(last) <= MAX_STEP && number != last => {
                self.counts.missing += u64::from(number.wrapping_sub(last) - 1);
                self.last = Some(number);
            }
            Some(_) => {}
            None => self.last = Some(number),
        }
        [vouched, Some((self.session, number, entry))]
    }
}

/// True for a step forward within reason (wrap included), a repetition, or a little reordering.
fn plausible_step(last: u32, number: u32) -> bool {
    number.wrapping_sub(last) <= MAX_STEP || last.wrapping_sub(number) <= MAX_REORDER
}

fn close(last: Option<u32>, number: u32) -> bool {
    last.is_some_and(|last| number.wrapping_sub(last) <= 2 * MAX_REORDER)
}

impl<T> Pairing<T> {
    /// A pairing that lets at most `window` records of a side wait for their partners.
    ///
    /// 1,024 is plenty where the log that is [behind](Self::behind) is read next.
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
    pub fn handle(&mut self, side: Side, number: u32, timestamp_low: u32, item: T) {
        let entry = Entry { clock: timestamp_low, item };
        for (session, number, entry) in self.side_mut(side).place(number, entry).into_iter().flatten() {
            self.file(side, session, number, entry);
        }
    }

    fn file(&mut self, side: Side, session: u32, number: u32, entry: Entry<T>) {
        let window = self.window;
        let (own, other) = match side {
            Side::Receiver => (&mut self.receiver, &mut self.transmitter),
            Side::Transmitter => (&mut self.transmitter, &mut self.receiver),
        };
        let key = (session, number);
        if own.waiting.contains_key(&key) || own.seen.contains(&key) {
            own.counts.duplicates += 1;
            return;
        }
        own.seen.push_back(key);
        if own.seen.len() > (MAX_REORDER as usize) * 2 {
            own.seen.pop_front();
        }
        if let Some(partner) = other.waiting.remove(&key) {
            let (receiver, transmitter) = match side {
                Side::Receiver => (entry, partner),
                Side::Transmitter => (partner, entry),
            };
            self.ready.push_back((number, receiver, transmitter));
            return;
        }
        own.waiting.insert(key, entry);
        own.order.push_back(key);
        while own.order.len() > window {
            if let Some(oldest) = own.order.pop_front()
                && own.waiting.remove(&oldest).is_some()
            {
                own.counts.unpaired += 1;
            }
        }
    }

    /// The next pair, in the order in which they were completed.
    pub fn poll_pair(&mut self) -> Option<Pair<T>> {
        while let Some((number, receiver, transmitter)) = self.ready.pop_front() {
            if let Some((clock_rx_us, clock_difference_us)) = self.clock.admit(receiver.clock, transmitter.clock) {
                self.receiver.counts.paired += 1;
                self.transmitter.counts.paired += 1;
                return Some(Pair {
                    number,
                    receiver: receiver.item,
                    transmitter: transmitter.item,
                    clock_difference_us,
                    clock_rx_us,
                });
            }
            self.receiver.counts.mispaired += 1;
            self.transmitter.counts.mispaired += 1;
        }
        None
    }

    /// The side whose log is behind in (session, frame number), and so should be read next.
    #[must_use]
    pub fn behind(&self) -> Side {
        let position =
            |side: &SideState<T>| side.last.map(|last| (side.session + u32::from(side.suspect.is_some()), last));
        if position(&self.transmitter) < position(&self.receiver) { Side::Transmitter } else { Side::Receiver }
    }

    /// Ends both logs: what still waits is unpaired, an unconfirmed jump is implausible.
    pub fn finish(&mut self) {
        for side in [&mut self.receiver, &mut self.transmitter] {
            side.counts.unpaired += side.waiting.len() as u64;
            side.counts.implausible += u64::from(side.suspect.take().is_some());
            side.waiting.clear();
            side.order.clear();
        }
    }

    /// What became of the records of `side` so far.
    #[must_use]
    pub fn counts(&self, side: Side) -> SideCounts {
        match side {
            Side::Receiver => self.receiver.counts,
            Side::Transmitter => self.transmitter.counts,
        }
    }

    fn side_mut(&mut self, side: Side) -> &mut SideState<T> {
        match side {
            Side::Receiver => &mut self.receiver,
            Side::Transmitter => &mut self.transmitter,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn run(receiver: &[(u32, u32)], transmitter: &[(u32, u32)]) -> (Vec<u32>, Pairing<u32>) {
        let mut pairing = Pairing::new(1_024);
        let (mut r, mut t) = (receiver.iter(), transmitter.iter());
        let mut numbers = Vec::new();
        loop {
            let side = pairing.behind();
            let next = match side {
                Side::Receiver => {
                    r.next().map(|n| (Side::Receiver, n)).or_else(|| t.next().map(|n| (Side::Transmitter, n)))
                }
                Side::Transmitter => {
                    t.next().map(|n| (Side::Transmitter, n)).or_else(|| r.next().map(|n| (Side::Receiver, n)))
                }
            };
            let Some((side, &(number, clock))) = next else { break };
            pairing.handle(side, number, clock, number);
            while let Some(pair) = pairing.poll_pair() {
                assert_eq!(pair.receiver, pair.transmitter);
                numbers.push(pair.number);
            }
        }
        pairing.finish();
        (numbers, pairing)
    }

    fn log(numbers: impl IntoIterator<Item = u32>, start_us: u32) -> Vec<(u32, u32)> {
        numbers.into_iter().enumerate().map(|(k, n)| (n, start_us.wrapping_add(10_000 * k as u32))).collect()
    }

    /// The same, with the clock tied to the number, so that missing numbers leave gaps in time.
    fn timed(numbers: impl IntoIterator<Item = u32>, start_us: u32) -> Vec<(u32, u32)> {
        numbers.into_iter().map(|n| (n, start_us.wrapping_add(n.wrapping_mul(10_000)))).collect()
    }

    #[test]
    fn loss_on_either_side_costs_only_those_numbers() {
        let (numbers, pairing) =
            run(&timed((1..100).filter(|n| n % 7 != 0), 5), &timed((1..120).filter(|n| n % 5 != 0), 900_000));
        assert_eq!(numbers, (1..100).filter(|n| n % 7 != 0 && n % 5 != 0).collect::<Vec<_>>());
        let counts = pairing.counts(Side::Receiver);
        assert_eq!(counts.handed, counts.paired + counts.unpaired);
    }

    #[test]
    fn restart_opens_a_session_and_old_numbers_do_not_pair_with_new_ones() {
        let r: Vec<_> = log((1..50).chain(1..30), 0);
        let t: Vec<_> = log((1..50).chain(1..30), 77);
        let (numbers, pairing) = run(&r, &t);
        assert_eq!(numbers.len(), 49 + 29);
        assert_eq!(pairing.counts(Side::Receiver).restarts, 1);
        assert_eq!(pairing.counts(Side::Receiver).duplicates, 0);
    }

    #[test]
    fn a_session_that_one_log_missed_is_told_by_the_card_clocks() {
        // Receiver: sessions of 1..=200 at 0 s, at 100 s and at 200 s; the transmitter missed the middle one.
        let session = |at: u32| (1..=200u32).map(move |n| (n, at + n * 10_000));
        let r: Vec<_> = session(0).chain(session(100_000_000)).chain(session(200_000_000)).collect();
        let t: Vec<_> = session(0).chain(session(200_000_000)).map(|(n, c)| (n, c + 250)).collect();
        let (_, pairing) = run(&r, &t);
        let counts = pairing.counts(Side::Receiver);
        assert!(counts.mispaired > 0, "{counts:?}");
        assert_eq!(counts.handed, counts.paired + counts.unpaired + counts.mispaired + counts.duplicates);
    }

    #[test]
    fn wrap_is_a_step_of_one_and_noise_in_the_counter_is_dropped() {
        let around = |k: u32| u32::MAX.wrapping_sub(20).wrapping_add(k);
        let r = log((0..50).map(around), 0);
        let mut t = r.clone();
        t.insert(25, (0x1f3d_5b79, 250_001));
        let (numbers, pairing) = run(&r, &t);
        assert_eq!(numbers.len(), 50);
        assert_eq!(pairing.counts(Side::Transmitter).implausible, 1);
        assert_eq!(pairing.counts(Side::Receiver).restarts, 0);
    }

    #[test]
    fn duplicates_keep_the_first_and_are_counted() {
        let mut r = log(1..100, 0);
        r.insert(40, r[39]);
        r.insert(60, r[58]);
        let (numbers, pairing) = run(&r, &log(1..100, 0));
        assert_eq!(numbers, (1..100).collect::<Vec<_>>());
        assert_eq!(pairing.counts(Side::Receiver).duplicates, 2);
    }

    proptest! {
        #[test]
        fn nothing_panics_and_the_books_balance(
            r in prop::collection::vec((any::<u32>(), any::<u32>()), 0..200),
            t in prop::collection::vec((0..50u32, 0..1_000u32), 0..200),
        ) {
            let (numbers, pairing) = run(&r, &t);
            for side in [Side::Receiver, Side::Transmitter] {
                let c = pairing.counts(side);
                prop_assert_eq!(c.handed, c.paired + c.unpaired + c.duplicates + c.implausible + c.mispaired);
                prop_assert_eq!(c.paired, numbers.len() as u64);
            }
        }
    }
}
