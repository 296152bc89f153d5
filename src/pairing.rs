//! Pairing of forward and backward frames by frame number, sans-IO.
//!
//! Two robots exchange a forward and a backward frame with one number. Each side's log holds what its card heard; a
//! [`Pairing`] takes both logs of one link in any interleaving and gives the pairs. Host clocks, which differ by up
//! to a minute between robots, are never looked at.
//!
//! What goes wrong in the field, and what is done:
//! * **restart**: the counter starts anew (the sender was restarted). A jump back that the next record confirms opens a
//!   new session.
//! * **wrap**: `u32::MAX` to 0 is a step of one.
//! * **duplicate**: the same number again within a session (overheard echoes, measured 892 in one log): the first
//!   stays, the others are counted.
//! * **implausible jump**: a number more than some frames from its neighbours that the next record does not confirm (a
//!   flipped bit; the reference sender's counter turns to noise after 68,966 packets; stale header fields): dropped and
//!   counted, and nothing else is lost by it.
//! * **another session's partner**: numbers repeat from session to session, and one log may have missed a whole one. The
//!   cards' own clocks tell: `clock_tx - clock_rx` of a pair continues that of the last one to within its drift. A
//!   candidate that does not is left waiting for its real partner. Where nothing fits any more (a card was reset) a new
//!   difference is believed once a run of candidates agrees to within the jitter of a turn-around: exchanges do, frames
//!   of different sessions do not.

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

/// Steps of the frame number, forward or back, that need no confirmation by the next record.
const NEAR: u32 = 32;
/// Largest confirmed step forward within a session: at the reference's highest rate (1,000 per second) a pause of more
/// than half an hour.
const MAX_STEP: u32 = 1 << 21;
/// How far `clock_tx - clock_rx` of a pair may be from the last pair's: 5 ms of turn-around and 200 ppm of drift.
const CLOCK_SLACK_US: i64 = 5_000;
const CLOCK_DRIFT_PER_S: i64 = 200;
/// Candidates in a row that must agree before their clock difference is believed.
const RUN: usize = 16;
/// They agree if the median step of the difference from one to the next is at most this, microseconds: a turn-around
/// jitters by 4 to 22 us (measured, paper-framework), the waits of two independent senders by hundreds.
const RUN_STEP_US: i64 = 80;
/// Without any run that agrees the first so many candidates are believed all the same: a slow responder is no mismatch.
const PATIENCE: u32 = 1_024;
/// Sessions back in which a partner is looked for.
const SESSIONS_BACK: u32 = 3;

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
    /// It met a record of its number whose clock did not fit.
    met_other: bool,
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
/// [`poll_pair`](Self::poll_pair) until `None` after each, [`finish`](Self::finish) at the end of both logs, and
/// [`poll_pair`](Self::poll_pair) until `None` once more. Pairs come in the order of the exchange but for reordering; the
/// first ones only when the clocks are understood.
#[derive(Clone, Debug)]
pub struct Pairing<T> {
    window: usize,
    receiver: SideState<T>,
    transmitter: SideState<T>,
    ready: VecDeque<Pair<T>>,
    clock: Clock,
}

/// Unwraps the two card clocks along the link and judges whether a candidate continues it.
#[derive(Clone, Debug, Default)]
struct Clock {
    /// Receiver's clock and difference of the last pair, unwrapped.
    last: Option<(i64, i64)>,
    /// The latest candidates that do not continue the link: receiver's clock and difference, wrapping.
    run: VecDeque<(u32, u32)>,
    doubtful: u32,
}

impl Clock {
    /// The unwrapped (receiver clock, difference) of a candidate that continues the link.
    fn fits(&self, rx: u32, tx: u32) -> Option<(i64, i64)> {
        let raw = tx.wrapping_sub(rx);
        let (last_rx, last_difference) = self.last?;
        let step_us = i64::from(rx.wrapping_sub(last_rx as u32).cast_signed());
        let change_us = i64::from(raw.wrapping_sub(last_difference as u32).cast_signed());
        let slack_us = CLOCK_SLACK_US + step_us.abs() / 1_000_000 * CLOCK_DRIFT_PER_S;
        (change_us.abs() <= slack_us).then_some((last_rx + step_us, last_difference + change_us))
    }

    /// Notes a candidate that does not fit; true if a new difference is now believed.
    fn doubt(&mut self, rx: u32, tx: u32) -> bool {
        self.run.push_back((rx, tx.wrapping_sub(rx)));
        if self.run.len() > RUN {
            self.run.pop_front();
        }
        self.doubtful += 1;
        let patience_ends = self.last.is_none() && self.doubtful >= PATIENCE;
        let agrees = self.run.len() == RUN && self.median_step_us() <= RUN_STEP_US;
        (agrees || patience_ends) && self.believe()
    }

    fn median_step_us(&self) -> i64 {
        let pairs = self.run.iter().zip(self.run.iter().skip(1));
        let mut steps: Vec<i64> = pairs.map(|(a, b)| i64::from(b.1.wrapping_sub(a.1).cast_signed()).abs()).collect();
        let middle = steps.len() / 2;
        if steps.is_empty() { 0 } else { *steps.select_nth_unstable(middle).1 }
    }

    /// Believes the run's own difference (the middle one of the run); false if there is no run.
    fn believe(&mut self) -> bool {
        let Some(&(first, origin)) = self.run.front() else { return false };
        let mut offsets: Vec<i32> = self.run.iter().map(|run| run.1.wrapping_sub(origin).cast_signed()).collect();
        let middle = offsets.len() / 2;
        let offset = *offsets.select_nth_unstable(middle).1;
        let difference = i64::from(origin.cast_signed()) + i64::from(offset);
        // Unwrapped clocks go on where they were, so that time does not jump back over a reset.
        let rx = match self.last {
            None => i64::from(first),
            Some((last_rx, _)) => last_rx + i64::from(first.wrapping_sub(last_rx as u32).cast_signed()),
        };
        self.last = Some((rx, difference));
        self.run.clear();
        true
    }
}

impl<T> SideState<T> {
    /// Judges the number of a record: gives what is now known to belong to a session, the record itself and one that it
    /// vouches for. Nothing while the record is suspect.
    fn place(&mut self, number: u32, entry: Entry<T>) -> [Option<Placed<T>>; 2] {
        let mut vouched = None;
        self.counts.handed += 1;
        if let Some((suspect, held)) = self.suspect.take() {
            let back_to_normal = self.last.is_some_and(|last| near(last, number)) && !is_next(suspect, number);
            if near(suspect, number) && !back_to_normal {
                self.jump(suspect);
                vouched = Some((self.session, suspect, held));
            } else {
                self.counts.implausible += 1;
            }
        }
        match self.last {
            Some(last) if !near(last, number) => {
                self.suspect = Some((number, entry));
                return [vouched, None];
            }
            Some(last) if number != last && number.wrapping_sub(last) <= NEAR => {
                self.counts.missing += u64::from(number.wrapping_sub(last) - 1);
                self.last = Some(number);
            }
            Some(_) => {}
            None => self.last = Some(number),
        }
        [vouched, Some((self.session, number, entry))]
    }

    /// Gives up the record that waited longest.
    fn drop_oldest(&mut self) {
        let Some(oldest) = self.order.pop_front() else { return };
        match self.waiting.remove(&oldest) {
            Some(entry) if entry.met_other => self.counts.mispaired += 1,
            Some(_) => self.counts.unpaired += 1,
            None => {}
        }
    }

    /// A jump that the next record confirmed: a gap if it leads forward within reason, else a restart.
    fn jump(&mut self, to: u32) {
        let step = self.last.map_or(1, |last| to.wrapping_sub(last));
        if step <= MAX_STEP {
            self.counts.missing += u64::from(step.saturating_sub(1));
        } else {
            self.session += 1;
            self.counts.restarts += 1;
            self.seen.clear();
        }
        self.last = Some(to);
    }
}

/// True for numbers within some frames of each other, wrap included.
fn near(a: u32, b: u32) -> bool {
    b.wrapping_sub(a) <= NEAR || a.wrapping_sub(b) <= NEAR
}

fn is_next(a: u32, b: u32) -> bool {
    b == a.wrapping_add(1)
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
        let entry = Entry { clock: timestamp_low, met_other: false, item };
        for (session, number, entry) in self.side_mut(side).place(number, entry).into_iter().flatten() {
            self.file(side, session, number, entry);
        }
    }

    fn file(&mut self, side: Side, session: u32, number: u32, entry: Entry<T>) {
        let window = self.window;
        let own = self.side_mut(side);
        let key = (session, number);
        if own.waiting.contains_key(&key) || own.seen.contains(&key) {
            own.counts.duplicates += 1;
            return;
        }
        own.seen.push_back(key);
        if own.seen.len() > (NEAR as usize) * 2 {
            own.seen.pop_front();
        }
        own.waiting.insert(key, entry);
        own.order.push_back(key);
        if self.seek(side, key) {
            // What now is believed may fit others that wait.
            let mut keys: Vec<(u32, u32)> = self.receiver.waiting.keys().copied().collect();
            keys.sort_unstable();
            for key in keys {
                self.seek(Side::Receiver, key);
            }
        }
        let own = self.side_mut(side);
        while own.order.len() > window {
            own.drop_oldest();
        }
    }

    /// Looks for the partner of a waiting record. True if the clocks' difference was learnt anew.
    fn seek(&mut self, side: Side, (session, number): (u32, u32)) -> bool {
        let (own, other) = match side {
            Side::Receiver => (&mut self.receiver, &mut self.transmitter),
            Side::Transmitter => (&mut self.transmitter, &mut self.receiver),
        };
        let Some(entry) = own.waiting.get_mut(&(session, number)) else { return false };
        let mut learnt = false;
        for candidate in (other.session.saturating_sub(SESSIONS_BACK)..=other.session).rev() {
            let Some(partner) = other.waiting.get_mut(&(candidate, number)) else { continue };
            let (rx, tx) = match side {
                Side::Receiver => (entry.clock, partner.clock),
                Side::Transmitter => (partner.clock, entry.clock),
            };
            if let Some(clocks) = self.clock.fits(rx, tx) {
                self.clock.last = Some(clocks);
                self.clock.run.clear();
                self.pair_up(side, session, candidate, number, clocks);
                return learnt;
            }
            (entry.met_other, partner.met_other) = (true, true);
            learnt |= self.clock.doubt(rx, tx);
        }
        learnt
    }

    fn pair_up(&mut self, side: Side, own: u32, other: u32, number: u32, (clock_rx_us, difference): (i64, i64)) {
        let (rx_session, tx_session) = match side {
            Side::Receiver => (own, other),
            Side::Transmitter => (other, own),
        };
        let receiver = self.receiver.waiting.remove(&(rx_session, number));
        let transmitter = self.transmitter.waiting.remove(&(tx_session, number));
        if let (Some(receiver), Some(transmitter)) = (receiver, transmitter) {
            self.receiver.counts.paired += 1;
            self.transmitter.counts.paired += 1;
            self.ready.push_back(Pair {
                number,
                receiver: receiver.item,
                transmitter: transmitter.item,
                clock_difference_us: difference,
                clock_rx_us,
            });
        }
    }

    /// The next pair.
    pub fn poll_pair(&mut self) -> Option<Pair<T>> {
        self.ready.pop_front()
    }

    /// The side whose log is behind in (session, frame number), and so should be read next.
    #[must_use]
    pub fn behind(&self) -> Side {
        let position =
            |side: &SideState<T>| side.last.map(|last| (side.session + u32::from(side.suspect.is_some()), last));
        if position(&self.transmitter) < position(&self.receiver) { Side::Transmitter } else { Side::Receiver }
    }

    /// Ends both logs: what still waits is unpaired, an unconfirmed jump is implausible. Logs too short to understand
    /// their clocks give their pairs now.
    pub fn finish(&mut self) {
        if self.clock.last.is_none() && self.clock.believe() {
            let mut keys: Vec<(u32, u32)> = self.receiver.waiting.keys().copied().collect();
            keys.sort_unstable();
            for key in keys {
                self.seek(Side::Receiver, key);
            }
        }
        for side in [&mut self.receiver, &mut self.transmitter] {
            while !side.order.is_empty() {
                side.drop_oldest();
            }
            side.counts.implausible += u64::from(side.suspect.take().is_some());
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
        while let Some(pair) = pairing.poll_pair() {
            assert_eq!(pair.receiver, pair.transmitter);
            numbers.push(pair.number);
        }
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

    /// Numbers from 1, 10 ms apart, the sender's timer off by up to a millisecond.
    fn session(count: u32, at_us: u32, salt: u32) -> impl Iterator<Item = (u32, u32)> {
        (1..=count).map(move |n| {
            let noise = ((n ^ (salt << 12)).wrapping_mul(0x9e37_79b9) ^ (n * 77)).wrapping_mul(0x85eb_ca6b) >> 22;
            (n, at_us.wrapping_add(n * 10_000 + noise))
        })
    }

    #[test]
    fn a_session_that_one_log_missed_is_told_by_the_card_clocks() {
        // The receiver logged three sessions; the transmitter missed the middle one, or all but the last.
        let starts = [0, 100_000_000, 200_000_000];
        let of = |k: usize| session(200, starts[k], k as u32);
        let r: Vec<_> = (0..3).flat_map(of).collect();
        let late = |k: usize| of(k).map(|(n, c)| (n, c + 250));
        let t: Vec<_> = late(0).chain(late(2)).collect();
        let (_, pairing) = run(&r, &t);
        let counts = pairing.counts(Side::Receiver);
        assert_eq!((counts.paired, pairing.counts(Side::Transmitter).paired), (400, 400), "{counts:?}");
        let (_, pairing) = run(&r, &late(2).collect::<Vec<_>>());
        assert_eq!(pairing.counts(Side::Transmitter).paired, 200);
    }

    #[test]
    fn a_card_that_was_reset_is_understood_again() {
        let r: Vec<_> =
            session(300, 0, 1).chain((301..=600).zip(session(300, 3_000_000, 2)).map(|(n, (_, c))| (n, c))).collect();
        let reset = |(n, c): (u32, u32)| (n, if n > 300 { c - 3_000_000 } else { c + 250 });
        let t: Vec<_> = r.iter().copied().map(reset).collect();
        let (numbers, _) = run(&r, &t);
        assert_eq!(numbers, (1..=600).collect::<Vec<_>>());
    }

    #[test]
    fn one_altered_number_costs_one_pair() {
        for off in [33, 40, 1_000, 1 << 20, 1 << 22, 1 << 31, u32::MAX - 300] {
            let r = log(1..400, 0);
            let mut t = r.clone();
            t[200].0 = t[200].0.wrapping_add(off);
            let (numbers, pairing) = run(&r, &t);
            assert_eq!(numbers.len(), 398, "{off}: {:?}", pairing.counts(Side::Transmitter));
            assert_eq!(pairing.counts(Side::Transmitter).implausible, 1, "{off}");
        }
    }

    #[test]
    fn a_long_gap_is_no_restart() {
        let kept = |n: &u32| !(100..400).contains(n);
        let (numbers, pairing) = run(&timed((1..600).filter(kept), 0), &timed(1..600, 70));
        assert_eq!(numbers.len(), 299);
        let counts = pairing.counts(Side::Receiver);
        assert_eq!((counts.restarts, counts.missing), (0, 300));
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
