//! Admits records of confirmed exchanges to pairing, if the scheduler shares a key.
//!
//! A card measures every frame of the right shape from any sender, and a record in the WSR layout contains only the
//! frame's MAC and number. The scheduler sees the frames and checks their tags. So a record waits until the scheduler
//! has confirmed the exchange of its number with that robot, and a moment longer: if another record has the same
//! number, one of the two frames was forged, and neither is used. (If the driver delivers frames,
//! [`Prover`](super::tdma::Prover) rejects records without a valid tag earlier.)
//!
//! A number counts as contested only if both records are about equally old: frames with future numbers are dropped as
//! unconfirmed.

use super::pairing::LinkSide;
use crate::time::{Instant, Span};
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};

/// How long a record waits for another one of its number: a card reports all frames of a turn-around within a few
/// milliseconds.
pub(crate) const HOLD: Span = Span::from_ms(20);
/// A record and its confirmation arrive within this time; numbers of admitted records are kept as long.
const PATIENCE: Span = Span::from_ms(2_000);
/// Limit of waiting records of a side, and of kept numbers.
const KEPT: usize = 4_096;

/// Records not admitted, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct AdmissionCounts {
    /// Records of exchanges that the scheduler did not confirm.
    pub unconfirmed: u64,
    /// Numbers with two records: an alarm. Neither is used.
    pub contested: u64,
}

/// A record that waits.
#[derive(Clone, Debug)]
struct Held<T> {
    number: u32,
    /// The card's clock: two records with the same one are of one reception.
    clock: u32,
    at: Instant,
    contested: bool,
    item: T,
}

#[derive(Clone, Debug)]
struct Side<T> {
    held: VecDeque<Held<T>>,
    /// Number, card's clock and time of the last admitted record.
    admitted: VecDeque<(u32, u32, Instant)>,
}

impl<T> Default for Side<T> {
    fn default() -> Self {
        Self { held: VecDeque::new(), admitted: VecDeque::new() }
    }
}

/// Lets records of one link through.
#[derive(Clone, Debug)]
pub(crate) struct Admission<T> {
    /// By [`LinkSide`].
    sides: [Side<T>; 2],
    confirmed: BTreeMap<u32, Instant>,
    /// Numbers confirmed, the oldest first.
    order: VecDeque<u32>,
    pub(crate) counts: AdmissionCounts,
}

impl<T> Default for Admission<T> {
    fn default() -> Self {
        Self {
            sides: Default::default(),
            confirmed: BTreeMap::new(),
            order: VecDeque::new(),
            counts: AdmissionCounts::default(),
        }
    }
}

impl<T> Admission<T> {
    /// Takes a record of `side`.
    pub(crate) fn handle(&mut self, side: LinkSide, (number, clock): (u32, u32), now: Instant, item: T) {
        let state = &mut self.sides[side as usize];
        if let Some(twin) = state.held.iter_mut().rev().find(|held| held.number == number) {
            let is_news = twin.clock != clock && !twin.contested;
            twin.contested |= is_news;
            self.counts.contested += u64::from(is_news);
            return;
        }
        while state.admitted.front().is_some_and(|(.., at)| now - *at > PATIENCE) {
            state.admitted.pop_front();
        }
        if let Some((_, admitted, _)) = state.admitted.iter().find(|(admitted, ..)| *admitted == number) {
            let is_other = *admitted != clock;
            self.counts.contested += u64::from(is_other);
            return;
        }
        let full = state.held.len() >= KEPT;
        let lost = full.then(|| state.held.pop_front()).flatten().is_some();
        state.held.push_back(Held { number, clock, at: now, contested: false, item });
        self.counts.unconfirmed += u64::from(lost);
    }

    /// The scheduler has seen the exchange of this number with a valid tag.
    pub(crate) fn confirm(&mut self, number: u32, now: Instant) {
        if self.confirmed.insert(number, now).is_none() {
            self.order.push_back(number);
        }
        if self.order.len() > KEPT
            && let Some(oldest) = self.order.pop_front()
        {
            self.confirmed.remove(&oldest);
        }
    }

    /// The next record to pair, in the order of its log as far as records are confirmed in that order, once it was held for
    /// [`HOLD`], or for nothing at the end of the input. Call it until it returns `None`.
    pub(crate) fn poll(&mut self, now: Instant, hold: Span) -> Option<(LinkSide, Instant, T)> {
        self.poll_side(LinkSide::Transmitter, now, hold).or_else(|| self.poll_side(LinkSide::Receiver, now, hold))
    }

    fn poll_side(&mut self, side: LinkSide, now: Instant, hold: Span) -> Option<(LinkSide, Instant, T)> {
        // Records from a network may arrive much later than the scheduler's confirmation.
        let in_time = |at: Instant, confirmed: Instant| match side {
            LinkSide::Receiver => at - confirmed <= PATIENCE && confirmed - at <= PATIENCE,
            LinkSide::Transmitter => confirmed - at <= PATIENCE,
        };
        let state = &mut self.sides[side as usize];
        let mut at = 0;
        while let Some(held) = state.held.get(at) {
            let age = now - held.at;
            let is_confirmed = self.confirmed.get(&held.number).is_some_and(|confirmed| in_time(held.at, *confirmed));
            if age < hold {
                // Those that follow are younger.
                return None;
            }
            if !is_confirmed && age <= PATIENCE {
                at += 1;
                continue;
            }
            let held = state.held.remove(at)?;
            if !is_confirmed {
                self.counts.unconfirmed += 1;
            } else if !held.contested {
                state.admitted.push_back((held.number, held.clock, now));
                if state.admitted.len() > KEPT {
                    state.admitted.pop_front();
                }
                return Some((side, held.at, held.item));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use LinkSide::{Receiver, Transmitter};

    fn ms(ms: i64) -> Instant {
        Instant::from_us(1_000 * ms)
    }

    fn drain(admission: &mut Admission<&'static str>, now: Instant) -> Vec<&'static str> {
        std::iter::from_fn(|| admission.poll(now, HOLD).map(|(.., item)| item)).collect()
    }

    fn counts(admission: &Admission<&'static str>) -> (u64, u64) {
        (admission.counts.unconfirmed, admission.counts.contested)
    }

    #[test]
    fn unconfirmed_records_are_not_used() {
        let mut admission = Admission::default();
        admission.handle(Receiver, (1, 10), ms(0), "confirmed before");
        admission.handle(Receiver, (2, 20), ms(0), "never");
        admission.handle(Receiver, (3, 30), ms(0), "confirmed after");
        admission.confirm(1, ms(0));
        assert!(drain(&mut admission, ms(19)).is_empty(), "another may come");
        assert_eq!(drain(&mut admission, ms(20)), ["confirmed before"]);
        admission.confirm(3, ms(500));
        assert_eq!(drain(&mut admission, ms(501)), ["confirmed after"]);
        assert!(drain(&mut admission, ms(2_001)).is_empty());
        admission.confirm(2, ms(2_100));
        assert!(drain(&mut admission, ms(2_200)).is_empty(), "too late");
        assert_eq!(counts(&admission), (1, 0));
    }

    #[test]
    fn two_records_of_one_number_are_both_refused() {
        for (first, second) in [(ms(0), ms(1)), (ms(0), ms(19))] {
            let mut admission = Admission::default();
            admission.confirm(7, ms(0));
            admission.handle(Receiver, (7, 100), first, "a stranger's");
            admission.handle(Receiver, (7, 400), second, "the peer's");
            admission.handle(Receiver, (7, 700), second, "another stranger's");
            assert!(drain(&mut admission, ms(100)).is_empty());
            assert_eq!(counts(&admission), (0, 1));
        }
    }

    #[test]
    fn a_second_record_that_comes_late_is_an_alarm_and_changes_nothing() {
        let mut admission = Admission::default();
        admission.confirm(7, ms(0));
        admission.handle(Transmitter, (7, 100), ms(0), "the peer's");
        assert_eq!(drain(&mut admission, ms(30)), ["the peer's"]);
        admission.handle(Transmitter, (7, 900), ms(40), "a stranger's");
        assert!(drain(&mut admission, ms(100)).is_empty());
        assert_eq!(counts(&admission), (0, 1));
    }

    #[test]
    fn a_reception_that_is_reported_twice_is_no_alarm() {
        let mut admission = Admission::default();
        admission.confirm(7, ms(0));
        admission.handle(Receiver, (7, 100), ms(0), "once");
        admission.handle(Receiver, (7, 100), ms(0), "twice");
        assert_eq!(drain(&mut admission, ms(30)), ["once"]);
        admission.handle(Receiver, (7, 100), ms(31), "thrice");
        assert!(drain(&mut admission, ms(100)).is_empty());
        assert_eq!(counts(&admission), (0, 0));
    }

    #[test]
    fn records_of_a_network_may_come_much_later() {
        let mut admission = Admission::default();
        admission.confirm(7, ms(0));
        admission.handle(Transmitter, (7, 100), ms(10_000), "late");
        admission.handle(Receiver, (7, 100), ms(10_000), "a tape");
        assert_eq!(drain(&mut admission, ms(10_020)), ["late"]);
        assert!(drain(&mut admission, ms(13_000)).is_empty());
        assert_eq!(counts(&admission), (1, 0));
    }

    #[test]
    fn a_record_and_its_confirmation_are_within_two_seconds() {
        for (record, word, side, expected) in [
            (0, 2_000, Receiver, true),
            (0, 2_001, Receiver, false),
            (2_000, 0, Receiver, true),
            (2_001, 0, Receiver, false),
            (0, 2_000, Transmitter, true),
            (0, 2_001, Transmitter, false),
            (60_000, 0, Transmitter, true),
        ] {
            let mut admission = Admission::default();
            for now in [record.min(word), record.max(word)] {
                if now == record {
                    admission.handle(side, (7, 100), ms(record), "it");
                }
                if now == word {
                    admission.confirm(7, ms(word));
                }
            }
            let now = ms(record.max(word).max(record + 20));
            assert_eq!(drain(&mut admission, now).len(), usize::from(expected), "{record} {word} {side:?}");
            // A record too old to be confirmed is dropped a millisecond after its deadline, not earlier.
            drain(&mut admission, ms(record + 2_000));
            let before = admission.counts.unconfirmed;
            drain(&mut admission, ms(record + 2_001));
            assert_eq!(admission.counts.unconfirmed, u64::from(!expected), "{record} {word} {side:?}");
            assert!(before == 0 || word > 2_000, "{record} {word} {side:?}");
        }
    }

    #[test]
    fn at_the_end_nothing_waits_for_another_record() {
        let mut admission = Admission::default();
        admission.confirm(7, ms(0));
        admission.confirm(8, ms(0));
        admission.handle(Receiver, (7, 100), ms(0), "backward");
        admission.handle(Transmitter, (7, 200), ms(0), "forward");
        admission.handle(Receiver, (8, 300), ms(1), "contested");
        admission.handle(Receiver, (8, 301), ms(1), "contested too");
        admission.handle(Receiver, (9, 400), ms(1), "not confirmed");
        assert!(drain(&mut admission, ms(1)).is_empty());
        let last: Vec<_> = std::iter::from_fn(|| admission.poll(ms(1), Span::default())).collect();
        assert_eq!(last, [(Transmitter, ms(0), "forward"), (Receiver, ms(0), "backward")]);
        assert_eq!(counts(&admission), (0, 1));
    }

    #[test]
    fn numbers_that_were_admitted_are_kept_for_two_seconds_and_not_without_end() {
        let mut admission = Admission::default();
        for number in 0..KEPT as u32 + 5 {
            admission.confirm(number, ms(0));
            admission.handle(Receiver, (number, number), ms(0), "it");
            assert_eq!(drain(&mut admission, ms(20)), ["it"]);
            assert_eq!(admission.sides[0].admitted.len(), KEPT.min(number as usize + 1));
        }
        let second = |admission: &mut Admission<_>, now| {
            let before = admission.counts.contested;
            admission.handle(Receiver, (KEPT as u32, 9), now, "late");
            admission.counts.contested - before
        };
        assert_eq!(second(&mut admission, ms(2_020)), 1, "still known");
        assert_eq!(second(&mut admission, ms(2_021)), 0, "forgotten, and held as a record of its own");
        assert_eq!((admission.sides[0].admitted.len(), admission.sides[0].held.len()), (0, 1));
    }

    #[test]
    fn a_flood_is_bounded_and_counted() {
        let mut admission = Admission::default();
        for number in 0..3 * KEPT as u32 {
            admission.handle(Receiver, (number, number), ms(0), "made up");
            admission.confirm(1_000_000 + number, ms(0));
        }
        assert_eq!(
            (admission.sides[0].held.len(), admission.confirmed.len(), admission.order.len()),
            (KEPT, KEPT, KEPT)
        );
        assert!(drain(&mut admission, ms(3_000)).is_empty());
        assert_eq!(counts(&admission), (3 * KEPT as u64, 0));
    }
}
