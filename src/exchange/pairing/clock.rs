//! The cards' clocks along a link: decides whether two records of the same number are of the same exchange.

use crate::maths::{unwrap_near, upper_median_ord};
use std::collections::VecDeque;

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

/// Unwraps the two card clocks along the link and judges whether a candidate continues it.
#[derive(Clone, Debug, Default)]
pub(super) struct Clock {
    /// Receiver's clock and difference of the last pair, unwrapped.
    last: Option<(i64, i64)>,
    /// The latest candidates that do not continue the link.
    run: VecDeque<Candidate>,
    doubtful: u32,
}

impl Clock {
    /// True once a difference is accepted.
    pub(super) fn is_known(&self) -> bool {
        self.last.is_some()
    }

    /// Continues the link with a candidate that fits; returns its unwrapped (receiver clock, difference).
    pub(super) fn follow(&mut self, rx: u32, tx: u32) -> Option<(i64, i64)> {
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
    pub(super) fn doubt(&mut self, count: u32, rx: u32, tx: u32) -> bool {
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
    pub(super) fn believe(&mut self) -> bool {
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

    /// Candidates 10 ms apart with these differences; the place of the first that is believed.
    fn believed(differences: impl IntoIterator<Item = u32>) -> (Option<usize>, Clock) {
        let mut clock = Clock::default();
        let mut candidates = (0..).zip(differences);
        let at = candidates.find(|(k, difference)| clock.doubt(0, 10_000 * k, 10_000 * k + difference));
        (at.map(|(k, _)| k as usize), clock)
    }

    #[test]
    fn an_agreeing_run_is_accepted_at_its_middle() {
        let run = RUN;
        let (at, clock) = believed((0..).map(|k| 500 + 20 * (k % 3)));
        assert_eq!((at, clock.is_known()), (Some(run - 1), true));
        let mut middle: Vec<i64> = (0..run as i64).map(|k| 500 + 20 * (k % 3)).collect();
        assert_eq!(clock.last.map(|(_, difference)| difference), upper_median_ord(&mut middle));
    }

    #[test]
    fn disagreeing_candidates_are_accepted_after_a_limit_only_without_a_known_difference() {
        let apart = || (0..3_000).map(|k| 100_000 * (k % 7));
        let (at, mut clock) = believed(apart());
        assert_eq!(at, Some(PATIENCE as usize - 1));
        assert!(clock.is_known());
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
        let run = RUN;
        let kept = RUNS_KEPT * run;
        for (others, agrees) in [(kept - run, true), (kept - run + 1, false)] {
            let mut clock = Clock::default();
            let mut doubt = |count, k: usize, difference: u32| {
                let rx = 10_000 * k as u32;
                clock.doubt(count, rx, rx.wrapping_add(difference))
            };
            assert!(!doubt(0, 0, 500));
            // Each of another count, as of initiators that are heard once.
            assert!((1..=others).all(|k| !doubt(k as u32, k, 1_000_000 * k as u32)));
            let last = (1..run).map(|k| doubt(0, others + k, 500)).collect::<Vec<_>>();
            assert_eq!(last, [vec![false; run - 2], vec![agrees]].concat(), "{others} others between");
        }
    }

    #[test]
    fn no_difference_is_followed_before_one_is_accepted() {
        let mut clock = Clock::default();
        assert!(!clock.is_known() && clock.follow(0, 0).is_none() && !clock.believe());
    }
}
