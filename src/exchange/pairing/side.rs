//! One log of a link: the counts that its records belong to, and the records that wait for their partners.
//!
//! A *count* is the run of frame numbers of one initiator since its last start; it is a *session*, numbered in the order
//! in which counts began. A record passes through three states:
//!
//! | state | where | leaves it when |
//! |---|---|---|
//! | suspect: its number is near no open count | `suspects` | a number near it follows: its count is opened or continues ([`SideState::jump`]); or too many records pass: *implausible* |
//! | waiting: it belongs to a session | `waiting`, and `order` by age | its partner comes: *paired*; or it is the oldest of a full window: *unpaired*, or *mispaired* where a partner's clock did not fit |
//! | seen: its key is remembered, so that a repetition is a *duplicate* | `seen` | newer keys take its place |
//!
//! [`SideState::place`] takes a record to the end of the first state, [`SideState::wait`] to that of the second.

use super::SideCounts;
use std::collections::{HashMap, VecDeque};
use std::hash::{BuildHasherDefault, Hasher};

/// Steps of the frame number, forward or back, that need no confirmation by another record.
const NEAR: u32 = 32;
/// Largest confirmed step forward within a session: at the reference's highest rate (1,000 per second) a pause of more
/// than half an hour. Counts that begin [apart](super::numbering::before_first_number) are further from each other. A confirmed step back of no
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
pub(super) struct KeyHasher(u64);

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

pub(super) type Waiting<T> = HashMap<(u32, u32), Entry<T>, BuildHasherDefault<KeyHasher>>;

/// A record that waits for its partner.
#[derive(Clone, Debug)]
pub(super) struct Entry<T> {
    pub(super) clock: u32,
    /// It met a record of its number with another clock.
    pub(super) met_other: bool,
    pub(super) item: T,
}

/// Session and number.
pub(super) type Key = (u32, u32);

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

/// One side of a link.
#[derive(Clone, Debug)]
pub(super) struct SideState<T> {
    /// The next session.
    sessions: u32,
    /// The counts that continue, the one of the newest record last.
    open: Vec<Count>,
    /// Records whose number is near no count, the oldest first.
    suspects: VecDeque<Suspect<T>>,
    pub(super) waiting: Waiting<T>,
    /// Keys in the order in which their records began to wait; those that left are skipped when their turn comes.
    order: VecDeque<Key>,
    /// The latest keys.
    seen: VecDeque<Key>,
    /// The highest key that ever waited: one above it repeats none.
    highest: Option<Key>,
    pub(super) counts: SideCounts,
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
    pub(super) fn place(&mut self, number: u32, entry: Entry<T>) -> [Option<(Key, Entry<T>)>; 2] {
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
            return self.leap(at, to);
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

    /// The count at `at` continues with number `to`; those between are missing. Gives its session.
    fn leap(&mut self, at: usize, to: u32) -> u32 {
        let count = self.open.remove(at);
        self.counts.missing += u64::from(to.wrapping_sub(count.last).saturating_sub(1));
        self.open.push(Count { last: to, ..count });
        count.session
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
    pub(super) fn wait(&mut self, key: Key, entry: Entry<T>) -> bool {
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
    pub(super) fn sessions(&self) -> impl Iterator<Item = u32> + use<T> {
        let mut open = [None; MAX_COUNTS];
        for (place, count) in open.iter_mut().zip(self.open.iter().rev()) {
            *place = Some(count.session);
        }
        let ended = (self.sessions.saturating_sub(SESSIONS_BACK + 1)..self.sessions).rev();
        let ended = ended.filter(move |session| !open.contains(&Some(*session)));
        open.into_iter().flatten().chain(ended)
    }

    /// Lets at most `window` records wait.
    pub(super) fn keep(&mut self, window: usize) {
        while self.order.len() > window {
            self.drop_oldest();
        }
    }

    /// Drops the record that waited longest.
    fn drop_oldest(&mut self) {
        let Some(oldest) = self.order.pop_front() else { return };
        match self.waiting.remove(&oldest) {
            Some(entry) if entry.met_other => self.counts.mispaired += 1,
            Some(_) => self.counts.unpaired += 1,
            None => {}
        }
    }

    /// The end of the log: waiting records are unpaired, unconfirmed ones implausible.
    pub(super) fn finish(&mut self) {
        self.keep(0);
        self.counts.implausible += self.suspects.len() as u64;
        self.suspects.clear();
    }

    /// How far the newest record is ahead of the same count in `other`: restarts, then numbers. `None` if there is no such
    /// count.
    pub(super) fn ahead_of(&self, other: &Self) -> Option<(i64, i64)> {
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

#[cfg(test)]
mod tests {
    use super::*;
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
}
