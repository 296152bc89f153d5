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

use crate::maths::{unwrap_near, upper_median_ord};
use std::collections::{HashMap, VecDeque};
use std::hash::{BuildHasherDefault, Hasher};

pub(crate) mod by_clock;

/// The log a record is from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkSide {
    /// The log of the robot whose trajectory is known: it heard the backward frames.
    Receiver,
    /// The log of the other robot: it heard the forward frames.
    Transmitter,
}

/// A matched exchange.
#[doc(hidden)] // for the crates of this workspace
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
#[doc(hidden)] // for the crates of this workspace
#[derive(Clone, Debug)]
pub struct Pairing<T> {
    window: usize,
    /// By [`LinkSide`].
    sides: [SideState<T>; 2],
    ready: VecDeque<Pair<T>>,
    clock: Clock,
}

impl<T> Pairing<T> {
    /// A pairing in which at most `window` records of a side wait for their partners.
    ///
    /// 1,024 is enough if the log that is [behind](Self::behind) is read next.
    #[must_use]
    pub fn new(window: usize) -> Self {
        Self { window: window.max(1), sides: Default::default(), ready: VecDeque::new(), clock: Clock::default() }
    }

    /// Takes a record of `side` with its frame number and its card's clock (`timestamp_low`).
    pub fn handle(&mut self, side: LinkSide, number: u32, timestamp_low: u32, item: T) {
        let entry = Entry { clock: timestamp_low, met_other: false, item };
        let own = side as usize;
        for (key, entry) in self.sides[own].place(number, entry).into_iter().flatten() {
            if self.sides[own].wait(key, entry) && self.seek(side, key) {
                self.seek_all();
            }
        }
        self.sides[own].keep(self.window);
    }

    /// Pairs waiting candidates that fit a difference of the clocks that was just accepted.
    fn seek_all(&mut self) {
        let mut keys: Vec<Key> = self.sides[0].waiting.keys().copied().collect();
        keys.sort_unstable();
        for key in keys {
            self.seek(LinkSide::Receiver, key);
        }
    }

    /// Looks for the partner of a waiting record. True if it found a new difference of the clocks.
    fn seek(&mut self, side: LinkSide, key: Key) -> bool {
        let [receiver, transmitter] = &mut self.sides;
        let (own, other) = match side {
            LinkSide::Receiver => (receiver, transmitter),
            LinkSide::Transmitter => (transmitter, receiver),
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
        let [own, other] = &mut self.sides;
        if let (Some(receiver), Some(transmitter)) = (own.waiting.remove(&rx), other.waiting.remove(&tx)) {
            self.sides.iter_mut().for_each(|side| side.counts.paired += 1);
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
        let [receiver, transmitter] = &self.sides;
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
        if self.clock.last.is_none() && self.clock.believe() {
            self.seek_all();
        }
        self.sides.iter_mut().for_each(SideState::finish);
    }

    /// The next record of two logs: of the one that is behind, or of the other at its end.
    pub(crate) fn next<R>(
        &self,
        receiver: &mut impl Iterator<Item = R>,
        transmitter: &mut impl Iterator<Item = R>,
    ) -> Option<(LinkSide, R)> {
        let mut of = |side| match side {
            LinkSide::Receiver => receiver.next().map(|record| (side, record)),
            LinkSide::Transmitter => transmitter.next().map(|record| (side, record)),
        };
        of(self.behind()).or_else(|| of(LinkSide::Receiver)).or_else(|| of(LinkSide::Transmitter))
    }

    /// The outcome of the records of `side` so far.
    #[must_use]
    pub fn counts(&self, side: LinkSide) -> SideCounts {
        self.sides[side as usize].counts
    }
}

/// Steps of the frame number, forward or back, that need no confirmation by another record.
const NEAR: u32 = 32;
/// Largest confirmed step forward within a session: at the reference's highest rate (1,000 per second) a pause of more
/// than half an hour. Counts that begin [apart](super::tdma::roster::before_first_number) are further from each other. A confirmed step back of no
/// more is a restart of the same count.
const MAX_STEP: u32 = 1 << 21;
/// Counts followed at the same time: one for each robot that initiates, and some that ended.
const MAX_COUNTS: usize = 16;
/// Limit of unconfirmed numbers, and of records until they are confirmed: several robots may take turns of one slot.
const MAX_SUSPECTS: usize = 4;
const SUSPECT_RECORDS: u64 = 8;
/// Sessions back in which a partner is looked for, besides those that continue.
const SESSIONS_BACK: u32 = 3;

/// Hashes the few thousand (session, number) keys of a window: one multiplication is enough for a bounded window,
/// whoever chose the numbers.
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

/// A record that waits for its partner.
#[derive(Clone, Debug)]
struct Entry<T> {
    clock: u32,
    /// It met a record of its number with another clock.
    met_other: bool,
    item: T,
}

/// Session and number.
type Key = (u32, u32);

/// Numbers of one initiator, from one start of it on.
#[derive(Clone, Copy, Debug)]
struct Count {
    session: u32,
    /// Times that it restarted.
    restarts: u32,
    last: u32,
}

/// A number far from all counts, until another one confirms it.
#[derive(Clone, Debug)]
struct Suspect<T> {
    number: u32,
    /// Records handed in with it.
    at: u64,
    entry: Entry<T>,
}

/// One log of a link, with its state: the counts that its records belong to, and the records that wait for their partners.
///
/// A *count* is the run of frame numbers of one initiator since its last start; it is a *session*, numbered in the order
/// in which counts began. A record passes through three states:
///
/// | state | where | leaves it when |
/// |---|---|---|
/// | suspect: its number is near no open count | `suspects` | a number near it follows: its count is opened or continues ([`SideState::jump`]); or too many records pass: *implausible* |
/// | waiting: it belongs to a session | `waiting`, and `order` by age | its partner comes: *paired*; or it is the oldest of a full window: *unpaired*, or *mispaired* where a partner's clock did not fit |
/// | seen: its key is remembered, so that a repetition is a *duplicate* | `seen` | newer keys take its place |
///
/// [`SideState::place`] takes a record to the end of the first state, [`SideState::wait`] to that of the second.
#[derive(Clone, Debug)]
struct SideState<T> {
    /// The next session.
    sessions: u32,
    /// The counts that continue, the one of the newest record last.
    open: Vec<Count>,
    /// Records whose number is near no count, the oldest first.
    suspects: VecDeque<Suspect<T>>,
    waiting: Waiting<T>,
    /// Keys in the order in which their records began to wait; those that left are skipped when their turn comes.
    order: VecDeque<Key>,
    /// The latest keys.
    seen: VecDeque<Key>,
    /// The highest key that ever waited: one above it repeats none.
    highest: Option<Key>,
    counts: SideCounts,
}

impl<T> Default for SideState<T> {
    fn default() -> Self {
        Self {
            sessions: 0,
            open: Vec::new(),
            suspects: VecDeque::new(),
            waiting: Waiting::default(),
            order: VecDeque::new(),
            seen: VecDeque::new(),
            highest: None,
            counts: SideCounts::default(),
        }
    }
}

impl<T> SideState<T> {
    /// Judges the number of a record. Returns the records that now belong to a session: one that this record confirms,
    /// and the record itself; none while it is suspect.
    fn place(&mut self, number: u32, entry: Entry<T>) -> [Option<(Key, Entry<T>)>; 2] {
        self.counts.handed += 1;
        self.drop_old_suspects();
        let mut vouched = None;
        if let Some(suspect) = self.take_confirmed(number) {
            let session = self.jump(suspect.number);
            vouched = Some(((session, suspect.number), suspect.entry));
        }
        if self.open.is_empty() {
            self.begin(number);
        }
        match self.step(number) {
            Some(session) => [vouched, Some(((session, number), entry))],
            None => {
                self.suspects.push_back(Suspect { number, at: self.counts.handed, entry });
                [vouched, None]
            }
        }
    }

    /// The suspect that `number` confirms: the one that it follows, or, if it is near no count, one that it is near to.
    fn take_confirmed(&mut self, number: u32) -> Option<Suspect<T>> {
        let follows = |suspect: &Suspect<T>| number == suspect.number.wrapping_add(1);
        let is_normal = self.open.iter().any(|count| near(count.last, number));
        let at = self.suspects.iter().position(follows).or_else(|| {
            let of = |suspect: &Suspect<T>| near(suspect.number, number);
            self.suspects.iter().rposition(of).filter(|_| !is_normal)
        })?;
        self.suspects.remove(at)
    }

    fn drop_old_suspects(&mut self) {
        let handed = self.counts.handed;
        let is_old = |suspect: &Suspect<T>| handed - suspect.at > SUSPECT_RECORDS;
        while self.suspects.len() >= MAX_SUSPECTS || self.suspects.front().is_some_and(is_old) {
            self.suspects.pop_front();
            self.counts.implausible += 1;
        }
    }

    /// The session of a number near a count: of several the one that had the last record.
    fn step(&mut self, number: u32) -> Option<u32> {
        let at = self.open.iter().rposition(|count| near(count.last, number))?;
        let mut count = self.open.remove(at);
        let step = number.wrapping_sub(count.last);
        if step != 0 && step <= NEAR {
            self.counts.missing += u64::from(step - 1);
            count.last = number;
        }
        self.open.push(count);
        Some(count.session)
    }

    /// A jump that another record confirmed: a gap if it leads forward within reason from one of the counts, a restart if
    /// it leads back within reason, else another count. Gives the session.
    fn jump(&mut self, to: u32) -> u32 {
        if let Some(at) = self.nearest(|count| to.wrapping_sub(count.last)) {
            let count = self.open.remove(at);
            self.counts.missing += u64::from(to.wrapping_sub(count.last).saturating_sub(1));
            self.open.push(Count { last: to, ..count });
            return count.session;
        }
        self.counts.restarts += 1;
        let began_anew = self.nearest(|count| count.last.wrapping_sub(to)).map(|at| self.open.remove(at));
        let session = self.begin(to);
        if let (Some(before), Some(count)) = (began_anew, self.open.last_mut()) {
            count.restarts = before.restarts + 1;
        }
        session
    }

    /// The open count with the smallest `distance` of at most [`MAX_STEP`].
    fn nearest(&self, distance: impl Fn(&Count) -> u32) -> Option<usize> {
        let in_reach = self.open.iter().enumerate().filter(|(_, count)| distance(count) <= MAX_STEP);
        in_reach.min_by_key(|(_, count)| distance(count)).map(|(at, _)| at)
    }

    /// A count begins, in a session of its own.
    fn begin(&mut self, number: u32) -> u32 {
        let session = self.sessions;
        self.sessions += 1;
        if self.open.len() >= MAX_COUNTS {
            self.open.remove(0);
        }
        self.open.push(Count { session, restarts: 0, last: number });
        session
    }

    /// Lets a placed record wait; false if its number came before.
    fn wait(&mut self, key: Key, entry: Entry<T>) -> bool {
        let may_repeat = self.highest.is_some_and(|highest| key <= highest);
        if may_repeat && (self.waiting.contains_key(&key) || self.seen.contains(&key)) {
            self.counts.duplicates += 1;
            return false;
        }
        self.highest = self.highest.max(Some(key));
        self.seen.push_back(key);
        if self.seen.len() > (NEAR as usize) * 2 {
            self.seen.pop_front();
        }
        self.waiting.insert(key, entry);
        self.order.push_back(key);
        true
    }

    /// Sessions in which the partner of another log's record may be: those that continue, the newest first, and the last
    /// ones that ended.
    fn sessions(&self) -> impl Iterator<Item = u32> + use<T> {
        let mut open = [None; MAX_COUNTS];
        for (place, count) in open.iter_mut().zip(self.open.iter().rev()) {
            *place = Some(count.session);
        }
        let ended = (self.sessions.saturating_sub(SESSIONS_BACK + 1)..self.sessions).rev();
        let ended = ended.filter(move |session| !open.contains(&Some(*session)));
        open.into_iter().flatten().chain(ended)
    }

    /// Lets at most `window` records wait: drops those that waited longest.
    fn keep(&mut self, window: usize) {
        while self.order.len() > window {
            let Some(oldest) = self.order.pop_front() else { return };
            match self.waiting.remove(&oldest) {
                Some(entry) if entry.met_other => self.counts.mispaired += 1,
                Some(_) => self.counts.unpaired += 1,
                None => {}
            }
        }
    }

    /// The end of the log: waiting records are unpaired, unconfirmed ones implausible.
    fn finish(&mut self) {
        self.keep(0);
        self.counts.implausible += self.suspects.len() as u64;
        self.suspects.clear();
    }

    /// How far the newest record is ahead of the same count in `other`: restarts, then numbers. `None` if there is no such
    /// count.
    fn ahead_of(&self, other: &Self) -> Option<(i64, i64)> {
        let newest = self.open.last()?;
        let ahead = |count: &Count| newest.last.wrapping_sub(count.last).cast_signed();
        let same = other.open.iter().min_by_key(|count| ahead(count).unsigned_abs())?;
        let is_same = ahead(same).unsigned_abs() <= MAX_STEP;
        is_same.then(|| (i64::from(newest.restarts) - i64::from(same.restarts), i64::from(ahead(same))))
    }
}

/// True for numbers within some frames of each other, wrap included.
fn near(a: u32, b: u32) -> bool {
    b.wrapping_sub(a) <= NEAR || a.wrapping_sub(b) <= NEAR
}

/// Largest change of the clocks' difference between pairs, microseconds (answers of a busy host come up to 10 ms
/// late).
const CLOCK_SLACK_US: i64 = 20_000;

/// The same per second between them, microseconds (200 ppm; 802.11 allows two cards 40).
const CLOCK_DRIFT_PER_S: i64 = 200;

/// Candidates that must agree before their difference is accepted.
const RUN: usize = 16;

/// Candidates after which any agreement is accepted.
const PATIENCE: u32 = 1_024;

/// They agree if the median step is at most this, microseconds (a turn-around jitters by 4 to 22, independent senders
/// by hundreds).
const RUN_STEP_US: i64 = 80;

/// Candidates kept, of all counts.
const RUNS_KEPT: usize = 8;

/// A pair that does not continue the link, if known.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    /// Its count: if both robots initiate, the difference is one turn-around less in one robot's exchanges and one more
    /// in the other's.
    count: u32,
    rx: u32,
    difference: u32,
}

/// Unwraps the two card clocks along the link and judges by them whether a candidate continues it.
#[derive(Clone, Debug, Default)]
struct Clock {
    /// Receiver's clock and difference of the last pair, unwrapped.
    last: Option<(i64, i64)>,
    /// The latest candidates that do not continue the link.
    run: VecDeque<Candidate>,
    doubtful: u32,
}

impl Clock {
    /// Continues the link with a candidate that fits; returns its unwrapped (receiver clock, difference).
    fn follow(&mut self, rx: u32, tx: u32) -> Option<(i64, i64)> {
        let raw = tx.wrapping_sub(rx);
        let (last_rx, last_difference) = self.last?;
        let step_us = i64::from(rx.wrapping_sub(last_rx as u32).cast_signed());
        let change_us = i64::from(raw.wrapping_sub(last_difference as u32).cast_signed());
        let slack_us = CLOCK_SLACK_US + step_us.abs() / 1_000_000 * CLOCK_DRIFT_PER_S;
        let clocks = (change_us.abs() <= slack_us).then_some((last_rx + step_us, last_difference + change_us))?;
        self.last = Some(clocks);
        self.run.clear();
        Some(clocks)
    }

    /// Notes a candidate of `count` that does not fit; true if a new difference is accepted by it.
    fn doubt(&mut self, count: u32, rx: u32, tx: u32) -> bool {
        self.run.push_back(Candidate { count, rx, difference: tx.wrapping_sub(rx) });
        if self.run.len() > RUNS_KEPT * RUN {
            self.run.pop_front();
        }
        self.doubtful += 1;
        let run = self.newest_run();
        let patience_ends = self.last.is_none() && self.doubtful >= PATIENCE;
        let agrees = run.len() == RUN && median_step_us(&run) <= RUN_STEP_US;
        (agrees || patience_ends) && self.believe()
    }

    /// The latest candidates of the newest one's count, in order.
    fn newest_run(&self) -> Vec<Candidate> {
        let Some(newest) = self.run.back() else { return Vec::new() };
        let mut run: Vec<Candidate> =
            self.run.iter().rev().filter(|other| other.count == newest.count).take(RUN).copied().collect();
        run.reverse();
        run
    }

    /// Accepts the newest run's difference (the middle one of the run); false without a run.
    fn believe(&mut self) -> bool {
        let run = self.newest_run();
        let Some(&Candidate { rx: first, difference: origin, .. }) = run.first() else { return false };
        let mut offsets: Vec<i32> = run.iter().map(|one| one.difference.wrapping_sub(origin).cast_signed()).collect();
        let Some(offset) = upper_median_ord(&mut offsets) else { return false };
        let difference = i64::from(origin.cast_signed()) + i64::from(offset);
        // Unwrapped clocks continue, so that time does not jump back over a reset.
        let rx = match self.last {
            None => i64::from(first),
            Some((last_rx, _)) => unwrap_near(last_rx, first),
        };
        self.last = Some((rx, difference));
        self.run.clear();
        true
    }
}

fn median_step_us(run: &[Candidate]) -> i64 {
    let step = |pair: &[Candidate]| match pair {
        [a, b] => i64::from(b.difference.wrapping_sub(a.difference).cast_signed()).abs(),
        _ => 0,
    };
    let mut steps: Vec<i64> = run.windows(2).map(step).collect();
    upper_median_ord(&mut steps).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exchange::tdma::roster::before_first_number;
    use proptest::prelude::*;
    use std::collections::HashSet;
    use std::hash::Hash;

    fn entry() -> Entry<()> {
        Entry { clock: 0, met_other: false, item: () }
    }

    #[test]
    fn keys_of_a_window_are_spread_over_the_table() {
        let hash = |key: Key| {
            let mut hasher = KeyHasher::default();
            key.hash(&mut hasher);
            hasher.finish()
        };
        let keys = || (0..4).flat_map(|session| (0..1_024).map(move |number| (session, number)));
        assert_eq!(keys().map(hash).collect::<HashSet<_>>().len(), 4_096);
        // As many as with random numbers: 1 - 1/e of all values of the bits that select the place.
        let low: HashSet<_> = keys().map(|key| hash(key) & 0xfff).collect();
        assert!(low.len() > 2_300, "{} of 4,096", low.len());
        // Numbers of initiators that begin far apart differ in their upper bits.
        let apart: HashSet<_> = (0..4_096).map(|k| hash((0, k << 20)) & 0xfff).collect();
        assert!(apart.len() > 2_300, "{} of 4,096", apart.len());
        let of = |bytes: &[u8]| {
            let mut hasher = KeyHasher::default();
            hasher.write(bytes);
            hasher.finish()
        };
        assert!(of(b"ab") != of(b"ba") && of(b"ab") != of(b"ac"));
    }

    #[test]
    fn a_jump_is_confirmed_within_eight_records_or_not_at_all() {
        for (between, confirmed) in [(0, true), (7, true), (8, false)] {
            let mut side = SideState::default();
            side.place(1, entry());
            assert!(side.place(1_000, entry()).iter().all(Option::is_none));
            for number in 2..2 + between {
                assert!(side.place(number, entry())[1].is_some());
            }
            let placed = side.place(1_001, entry()).into_iter().flatten().map(|(key, _)| key.1).collect::<Vec<_>>();
            assert_eq!(placed, if confirmed { vec![1_000, 1_001] } else { Vec::new() }, "{between} between");
            assert_eq!(side.counts.implausible, u64::from(!confirmed), "{between} between");
        }
    }

    #[test]
    fn a_number_is_a_repetition_while_it_is_among_the_last_64() {
        for (others, is_new) in [(63, false), (64, true)] {
            let mut side = SideState::default();
            assert!(side.wait((0, 0), entry()));
            (1..=others).for_each(|number| assert!(side.wait((0, number), entry())));
            side.waiting.clear();
            assert_eq!(side.wait((0, 0), entry()), is_new, "{others} others");
            assert_eq!(side.counts.duplicates, u64::from(!is_new));
        }
    }

    #[test]
    fn a_log_is_ahead_by_restarts_and_then_by_numbers() {
        let side = |restarts, last| SideState::<()> {
            sessions: 1,
            open: vec![Count { session: 0, restarts, last }],
            ..Default::default()
        };
        assert_eq!(side(3, 40).ahead_of(&side(1, 50)), Some((2, -10)));
        assert_eq!(side(1, 50).ahead_of(&side(3, 40)), Some((-2, 10)));
        assert_eq!(side(0, 5).ahead_of(&side(0, u32::MAX)), Some((0, 6)), "numbers wrap");
        assert_eq!(side(0, MAX_STEP).ahead_of(&side(0, 0)), Some((0, i64::from(MAX_STEP))));
        assert_eq!(side(0, MAX_STEP + 1).ahead_of(&side(0, 0)), None, "another count");
    }

    #[test]
    fn partners_are_looked_for_where_counts_go_on_and_in_the_last_ones_that_ended() {
        let count = |session| Count { session, restarts: 0, last: 0 };
        let mut side = SideState::<()> { sessions: 10, open: vec![count(2), count(9), count(7)], ..Default::default() };
        assert_eq!(side.sessions().collect::<Vec<_>>(), [7, 9, 2, 8, 6]);
        side.sessions = 3;
        side.open = vec![count(2)];
        assert_eq!(side.sessions().collect::<Vec<_>>(), [2, 1, 0]);
    }

    /// Candidates 10 ms apart with these differences; the place of the first that is believed.
    fn believed(differences: impl IntoIterator<Item = u32>) -> (Option<usize>, Clock) {
        let mut clock = Clock::default();
        let mut candidates = (0..).zip(differences);
        let at = candidates.find(|(k, difference)| clock.doubt(0, 10_000 * k, 10_000 * k + difference));
        (at.map(|(k, _)| k as usize), clock)
    }

    #[test]
    fn an_agreeing_run_is_accepted_at_its_middle() {
        let (at, clock) = believed((0..).map(|k| 500 + 20 * (k % 3)));
        assert_eq!((at, clock.last.is_some()), (Some(RUN - 1), true));
        let mut middle: Vec<i64> = (0..RUN as i64).map(|k| 500 + 20 * (k % 3)).collect();
        assert_eq!(clock.last.map(|(_, difference)| difference), upper_median_ord(&mut middle));
    }

    #[test]
    fn disagreeing_candidates_are_accepted_after_a_limit_only_without_a_known_difference() {
        let apart = || (0..3_000).map(|k| 100_000 * (k % 7));
        let (at, mut clock) = believed(apart());
        assert_eq!(at, Some(PATIENCE as usize - 1));
        assert!(clock.last.is_some());
        assert!((0..).zip(apart()).all(|(k, difference)| !clock.doubt(0, 10_000 * k, 10_000 * k + difference)));
    }

    #[test]
    fn two_cards_may_drift_apart_by_so_much_a_second() {
        let allowed_us = (CLOCK_SLACK_US + 100 * CLOCK_DRIFT_PER_S) as u32;
        for (change_us, follows) in [(allowed_us, true), (allowed_us + 1, false)] {
            let (_, mut clock) = believed(std::iter::repeat(1_000_000));
            let (rx, difference) = clock.last.unwrap();
            let (rx, tx) = (rx as u32 + 100_000_000, rx as u32 + 100_000_000 + difference as u32 - change_us);
            assert_eq!(clock.follow(rx, tx).is_some(), follows, "{change_us} us in 100 s");
        }
    }

    #[test]
    fn candidates_of_eight_runs_are_kept_of_all_counts() {
        let kept = RUNS_KEPT * RUN;
        for (others, agrees) in [(kept - RUN, true), (kept - RUN + 1, false)] {
            let mut clock = Clock::default();
            let mut doubt = |count, k: usize, difference: u32| {
                let rx = 10_000 * k as u32;
                clock.doubt(count, rx, rx.wrapping_add(difference))
            };
            assert!(!doubt(0, 0, 500));
            // Each of another count, as of initiators that are heard once.
            assert!((1..=others).all(|k| !doubt(k as u32, k, 1_000_000 * k as u32)));
            let last = (1..RUN).map(|k| doubt(0, others + k, 500)).collect::<Vec<_>>();
            assert_eq!(last, [vec![false; RUN - 2], vec![agrees]].concat(), "{others} others between");
        }
    }

    #[test]
    fn no_difference_is_followed_before_one_is_accepted() {
        let mut clock = Clock::default();
        assert!(clock.last.is_none() && clock.follow(0, 0).is_none() && !clock.believe());
    }

    /// Reads two logs of (number, clock, item): the pairs.
    fn pair<T: Copy>(receiver: &[(u32, u32, T)], transmitter: &[(u32, u32, T)]) -> (Vec<Pair<T>>, Pairing<T>) {
        let mut pairing = Pairing::new(1_024);
        let (mut r, mut t) = (receiver.iter(), transmitter.iter());
        let mut pairs = Vec::new();
        while let Some((side, &(number, clock, item))) = pairing.next(&mut r, &mut t) {
            pairing.handle(side, number, clock, item);
            pairs.extend(std::iter::from_fn(|| pairing.poll_pair()));
        }
        pairing.finish();
        pairs.extend(std::iter::from_fn(|| pairing.poll_pair()));
        (pairs, pairing)
    }

    /// The numbers of the pairs of two logs of (number, clock).
    fn run(receiver: &[(u32, u32)], transmitter: &[(u32, u32)]) -> (Vec<u32>, Pairing<u32>) {
        let log = |log: &[(u32, u32)]| log.iter().map(|&(number, clock)| (number, clock, number)).collect::<Vec<_>>();
        let (pairs, pairing) = pair(&log(receiver), &log(transmitter));
        assert!(pairs.iter().all(|pair| pair.receiver == pair.transmitter));
        (pairs.iter().map(|pair| pair.number).collect(), pairing)
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
        let counts = pairing.counts(LinkSide::Receiver);
        assert_eq!(counts.handed, counts.paired + counts.unpaired);
    }

    #[test]
    fn restart_opens_a_session_and_old_numbers_do_not_pair_with_new_ones() {
        let r: Vec<_> = log((1..50).chain(1..30), 0);
        let t: Vec<_> = log((1..50).chain(1..30), 77);
        let (numbers, pairing) = run(&r, &t);
        assert_eq!(numbers.len(), 49 + 29);
        assert_eq!(pairing.counts(LinkSide::Receiver).restarts, 1);
        assert_eq!(pairing.counts(LinkSide::Receiver).duplicates, 0);
    }

    /// Numbers from 1, 10 ms apart, the sender's timer off by up to a millisecond.
    fn session(count: u32, at_us: u32, salt: u32) -> impl Iterator<Item = (u32, u32)> {
        (1..=count).map(move |n| {
            let noise = ((n ^ (salt << 12)).wrapping_mul(0x9e37_79b9) ^ (n * 77)).wrapping_mul(0x85eb_ca6b) >> 22;
            (n, at_us.wrapping_add(n * 10_000 + noise))
        })
    }

    #[test]
    fn card_clocks_identify_a_session_that_one_log_missed() {
        // The receiver logged three sessions; the transmitter missed the middle one, or all but the last.
        let starts = [0, 100_000_000, 200_000_000];
        let of = |k: usize| session(200, starts[k], k as u32);
        let r: Vec<_> = (0..3).flat_map(of).collect();
        let late = |k: usize| of(k).map(|(n, c)| (n, c + 250));
        let t: Vec<_> = late(0).chain(late(2)).collect();
        let (_, pairing) = run(&r, &t);
        let counts = pairing.counts(LinkSide::Receiver);
        assert_eq!((counts.paired, pairing.counts(LinkSide::Transmitter).paired), (400, 400), "{counts:?}");
        let (_, pairing) = run(&r, &late(2).collect::<Vec<_>>());
        assert_eq!(pairing.counts(LinkSide::Transmitter).paired, 200);
    }

    #[test]
    fn pairs_continue_after_a_reset_of_a_card() {
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
            assert_eq!(numbers.len(), 398, "{off}: {:?}", pairing.counts(LinkSide::Transmitter));
            assert_eq!(pairing.counts(LinkSide::Transmitter).implausible, 1, "{off}");
        }
    }

    #[test]
    fn a_long_gap_is_no_restart() {
        let kept = |n: &u32| !(100..400).contains(n);
        let (numbers, pairing) = run(&timed((1..600).filter(kept), 0), &timed(1..600, 70));
        assert_eq!(numbers.len(), 299);
        let counts = pairing.counts(LinkSide::Receiver);
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
        assert_eq!(pairing.counts(LinkSide::Transmitter).implausible, 1);
        assert_eq!(pairing.counts(LinkSide::Receiver).restarts, 0);
    }

    #[test]
    fn duplicates_keep_the_first_and_are_counted() {
        let mut r = log(1..100, 0);
        r.insert(40, r[39]);
        r.insert(60, r[58]);
        let (numbers, pairing) = run(&r, &log(1..100, 0));
        assert_eq!(numbers, (1..100).collect::<Vec<_>>());
        assert_eq!(pairing.counts(LinkSide::Receiver).duplicates, 2);
    }

    proptest! {
        #[test]
        fn nothing_panics_and_the_books_balance(
            r in prop::collection::vec((any::<u32>(), any::<u32>()), 0..200),
            t in prop::collection::vec((0..50u32, 0..1_000u32), 0..200),
        ) {
            let (numbers, pairing) = run(&r, &t);
            for side in [LinkSide::Receiver, LinkSide::Transmitter] {
                let c = pairing.counts(side);
                prop_assert_eq!(c.handed, c.paired + c.unpaired + c.duplicates + c.implausible + c.mispaired);
                prop_assert_eq!(c.paired, numbers.len() as u64);
            }
        }
    }

    /// The logs of two robots that initiate in turns of `slots` slots: what both logs hold of the link, each record with
    /// its exchange as its item. `lost(side, exchange)` is not in that log.
    fn in_turns(
        slots: u32,
        exchanges: u32,
        first: [u32; 2],
        lost: impl Fn(LinkSide, u32) -> bool,
    ) -> [Vec<(u32, u32, u32)>; 2] {
        let mut next = first;
        let (mut receiver, mut transmitter) = (Vec::new(), Vec::new());
        for exchange in 0..exchanges {
            let initiator = (exchange / slots % 2) as usize;
            let number = next[initiator];
            next[initiator] = number.wrapping_add(1);
            // 300 us of turn-around, before or after the other's clock, and some jitter.
            let at = exchange * 5_000 + (exchange.wrapping_mul(0x9e37_79b9) >> 28);
            let (rx, tx) = if initiator == 0 { (at + 300, at) } else { (at, at + 300) };
            if !lost(LinkSide::Receiver, exchange) {
                receiver.push((number, rx, exchange));
            }
            if !lost(LinkSide::Transmitter, exchange) {
                transmitter.push((number, tx.wrapping_sub(77_000), exchange));
            }
        }
        [receiver, transmitter]
    }

    /// Pairs, and those of which the two frames are not of one exchange.
    fn pair_in_turns([receiver, transmitter]: &[Vec<(u32, u32, u32)>; 2]) -> (usize, usize, Pairing<u32>) {
        let (pairs, pairing) = pair(receiver, transmitter);
        (pairs.len(), pairs.iter().filter(|pair| pair.receiver != pair.transmitter).count(), pairing)
    }

    #[test]
    fn where_both_robots_initiate_every_exchange_is_one_pair() {
        let apart = [before_first_number(0, 2) + 1, before_first_number(1, 2) + 1];
        for slots in [1, 2, 7, 32, 5_000] {
            let (pairs, wrong, pairing) = pair_in_turns(&in_turns(slots, 20_000, apart, |_, _| false));
            let counts = pairing.counts(LinkSide::Receiver);
            assert_eq!((pairs, wrong), (20_000, 0), "{slots} slots: {counts:?}");
            assert_eq!((counts.restarts, counts.missing), (1, 0), "{slots} slots");
        }
    }

    #[test]
    fn losses_and_restarts_of_two_initiators_make_no_wrong_pair() {
        let dice = |side: LinkSide, exchange: u32| {
            let salt = if side == LinkSide::Receiver { 1 } else { 2 };
            (exchange ^ salt << 20).wrapping_mul(0x85eb_ca6b) >> 24
        };
        let apart = [before_first_number(0, 2) + 1, before_first_number(1, 2) + 1];
        for slots in [1, 4, 32] {
            // A fifth of the records is lost, whole turns among them, and the second robot restarts half-way.
            let lost =
                |side: LinkSide, exchange: u32| dice(side, exchange) < 51 || dice(side, exchange / 50 + 9_000) < 4;
            let [mut r, mut t] = in_turns(slots, 10_000, apart, lost);
            let both = r.iter().filter(|one| t.iter().any(|other| other.2 == one.2)).count();
            let (pairs, wrong, pairing) = pair_in_turns(&[r.clone(), t.clone()]);
            let counts = pairing.counts(LinkSide::Receiver);
            assert_eq!(wrong, 0, "{slots} slots");
            assert!(pairs + 8 >= both, "{slots} slots: {pairs} of {both}: {counts:?}");
            for log in [&mut r, &mut t] {
                for one in log.iter_mut().filter(|one| one.2 >= 5_000 && one.0 >= apart[1]) {
                    one.0 -= 2_500;
                }
            }
            let (pairs, wrong, _) = pair_in_turns(&[r, t]);
            assert_eq!(wrong, 0, "{slots} slots, restarted");
            assert!(pairs + 16 >= both, "{slots} slots, restarted: {pairs} of {both}");
        }
    }

    #[test]
    fn counts_that_begin_together_cost_pairs_and_make_no_wrong_ones() {
        for slots in [1, 32, 100] {
            let (pairs, wrong, pairing) = pair_in_turns(&in_turns(slots, 10_000, [1, 1], |_, _| false));
            assert_eq!(wrong, 0, "{slots} slots: {:?}", pairing.counts(LinkSide::Receiver));
            assert!(pairs >= 4_000, "{slots} slots: {pairs}");
        }
    }

    #[test]
    fn a_third_robots_count_in_one_log_delays_no_pair() {
        // The receiver's log also has what the transmitter answers a third robot; the transmitter's has not.
        let count = |from: u32| (0..20_000).map(move |k| (from + k, 10_000 * k));
        let third = before_first_number(2, 3) + 1;
        let r: Vec<_> = count(1).zip(count(third)).flat_map(|((n, c), (m, _))| [(n, c), (m, c + 5_000)]).collect();
        let (numbers, pairing) = run(&r, &count(1).map(|(n, c)| (n, c + 70)).collect::<Vec<_>>());
        assert_eq!(numbers.len(), 20_000, "{:?}", pairing.counts(LinkSide::Receiver));
    }

    #[test]
    fn counts_of_many_robots_begin_far_apart() {
        for robots in [1, 2, 3, 12, 256] {
            let numbers: Vec<u32> = (0..robots as u16).map(|rank| before_first_number(rank, robots)).collect();
            assert_eq!(numbers[0], 0);
            assert!(numbers.windows(2).all(|two| two[1] - two[0] >= 1 << 23), "{numbers:?}");
        }
    }

    #[test]
    fn logs_too_short_to_understand_their_clocks_give_their_pairs_at_the_end() {
        for pairs in 1..5 {
            let (numbers, _) = run(&log(1..=pairs, 7), &log(1..=pairs, 900));
            assert_eq!(numbers, (1..=pairs).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_single_pair_with_other_clocks_is_refused_once_they_are_known() {
        let (mut r, mut t) = (log(1..50, 0), log(1..50, 77));
        r.push((50, 490_000));
        t.push((50, 10_490_000));
        let (numbers, pairing) = run(&r, &t);
        assert_eq!(numbers, (1..50).collect::<Vec<_>>());
        for side in [LinkSide::Receiver, LinkSide::Transmitter] {
            assert_eq!((pairing.counts(side).mispaired, pairing.counts(side).unpaired), (1, 0), "{side:?}");
        }
    }

    #[test]
    fn clocks_of_pairs_go_on_over_their_wrap_and_a_pause() {
        let start = u32::MAX - 1_000_000;
        // 10 ms apart, then a pause of 1,000 s in which the clocks part by 100 ppm.
        let at = |n: u32| n * 10_000 + if n > 300 { 1_000_000_000 } else { 0 };
        let parted = |n: u32| if n > 300 { 100_000 } else { 0 };
        let mut pairing = Pairing::new(1_024);
        for n in 1..=400_u32 {
            pairing.handle(LinkSide::Receiver, n, start.wrapping_add(at(n)), n);
            pairing.handle(LinkSide::Transmitter, n, start.wrapping_add(at(n) + 77 + parted(n)), n);
        }
        let mut first = None;
        let mut pairs = 0;
        while let Some(pair) = pairing.poll_pair() {
            let (rx, difference) = *first.get_or_insert((pair.clock_rx_us - i64::from(at(pair.number)), 77));
            assert_eq!(pair.clock_rx_us - i64::from(at(pair.number)), rx, "{}", pair.number);
            assert_eq!(pair.clock_difference_us, difference + i64::from(parted(pair.number)), "{}", pair.number);
            pairs += 1;
        }
        assert_eq!(pairs, 400);
    }

    #[test]
    fn the_log_that_is_behind_is_read_next() {
        use LinkSide::{Receiver, Transmitter};
        let behind = |records: &[(LinkSide, u32)]| {
            let mut pairing = Pairing::new(64);
            records.iter().for_each(|(side, number)| pairing.handle(*side, *number, 0, ()));
            pairing.behind()
        };
        assert_eq!(behind(&[]), Receiver);
        assert_eq!(behind(&[(Receiver, 1)]), Transmitter);
        assert_eq!(behind(&[(Transmitter, 1)]), Receiver);
        assert_eq!(behind(&[(Receiver, 9), (Transmitter, 8)]), Transmitter);
        assert_eq!(behind(&[(Receiver, 8), (Transmitter, 9)]), Receiver);
        // At the same number, however many records were handed in.
        assert_eq!(behind(&[(Receiver, 8), (Receiver, 8), (Transmitter, 8)]), Receiver);
        // Counts that have nothing to do with each other: by records.
        assert_eq!(behind(&[(Receiver, 1), (Transmitter, 1 << 24)]), Receiver);
        assert_eq!(behind(&[(Receiver, 1), (Receiver, 2), (Transmitter, 1 << 24)]), Transmitter);
        // The receiver's newest record is of a count that the other log has not.
        let third = 1 << 24;
        let ahead = [(Receiver, 1), (Receiver, third), (Receiver, third + 1)];
        assert_eq!(behind(&[&ahead[..], &[(Transmitter, 1); 9]].concat()), Transmitter);
        // One restarted: it is ahead, though its numbers are lower.
        let again = (40..60).chain([1, 2]).map(|number| (Receiver, number));
        let still = (40..50).map(|number| (Transmitter, number));
        assert_eq!(behind(&again.chain(still).collect::<Vec<_>>()), Transmitter);
        // Both begin anew: neither is ahead by that.
        let log = |side| (40..60).chain([1, 2]).map(move |number| (side, number));
        let anew: Vec<_> = log(Receiver).chain(log(Transmitter)).chain([(Receiver, 2)]).collect();
        assert_eq!(behind(&anew), Receiver);
    }
}
