//! How the clocks behind a log went on: the card's from record to record, and the host's beside it.

use super::bounds::PAUSE_US;
use crate::maths::unwrap_near;

/// How the card's clock went on from record to record.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct ClockSteps {
    /// Sum of the steps forward, microseconds.
    pub forward_us: i64,
    /// Steps back: the card was reset, or its clock jumped.
    pub steps_back: u64,
    /// The largest of them, microseconds, positive.
    pub furthest_back_us: i64,
    /// Steps forward of a second and more.
    pub pauses: u64,
    /// The longest of them, microseconds.
    pub longest_pause_us: i64,
}

impl ClockSteps {
    pub(super) fn note(&mut self, step_us: i64) {
        if step_us < 0 {
            self.steps_back += 1;
            self.furthest_back_us = self.furthest_back_us.max(step_us.saturating_neg());
            return;
        }
        self.forward_us = self.forward_us.saturating_add(step_us);
        if step_us >= PAUSE_US {
            self.pauses += 1;
            self.longest_pause_us = self.longest_pause_us.max(step_us);
        }
    }
}

/// The clock that times the records of a log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum TimeBase {
    /// The card's clock, `timestamp_low`.
    #[default]
    Card,
    /// The host's times: the card's clock stands.
    Host,
    /// Nothing: the card's clock stands and there are no host times. Records have their numbers.
    Number,
}

/// A card's clock that advances by less than this a record, microseconds, stands still: the preamble and SIGNAL field
/// of a frame alone take as long (802.11-2016 table 17-5).
const LEAST_US: i64 = 20;

impl TimeBase {
    /// Of so many steps between records, with the sums of the steps forward of both clocks, microseconds.
    pub(super) fn of(steps: u64, card_us: i64, host_us: i64) -> Self {
        let least_us = i64::try_from(steps).unwrap_or(i64::MAX).saturating_mul(LEAST_US);
        match () {
            () if steps == 0 || card_us >= least_us => Self::Card,
            () if host_us > 0 => Self::Host,
            () => Self::Number,
        }
    }
}

/// The card's clock from record to record. The host's beside it says how often it wrapped in a pause.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::source) struct CardClock {
    /// The last reading, and its unwrapped value.
    last: Option<(u32, i64)>,
    /// Unwrapped time and host time of the last record that had both.
    last_both: Option<(i64, i64)>,
    /// Sum of the host's steps forward, microseconds.
    pub(super) host_forward_us: i64,
}

impl CardClock {
    /// The unwrapped time of the next record and the step to it from the one before, microseconds; `timestamp_low` as the card
    /// gives it, `host_us` since the Unix epoch.
    pub(in crate::source) fn note(&mut self, timestamp_low: u32, host_us: Option<i64>) -> (i64, Option<i64>) {
        let now_us = self.unwrap(timestamp_low, host_us);
        let step_us = self.last.replace((timestamp_low, now_us)).map(|(_, last)| now_us.saturating_sub(last));
        if let Some(host_us) = host_us {
            let host_step_us =
                self.last_both.replace((now_us, host_us)).map_or(0, |(_, last)| host_us.saturating_sub(last));
            self.host_forward_us = self.host_forward_us.saturating_add(host_step_us.max(0));
        }
        (now_us, step_us)
    }

    /// The reading nearest to the last one; where the host's clock went on by so many wraps more, it was a pause of those. A
    /// host's clock that was set tells nothing about the card's, and one that did not move at all stands.
    fn unwrap(&self, timestamp_low: u32, host_us: Option<i64>) -> i64 {
        let Some((last, last_us)) = self.last else { return i64::from(timestamp_low) };
        let near_us = unwrap_near(last_us, timestamp_low);
        let Some((both_us, last_host_us)) = self.last_both.filter(|_| last != timestamp_low) else { return near_us };
        let Some(elapsed_us) = host_us.map(|now| now.saturating_sub(last_host_us)) else { return near_us };
        let off_us = elapsed_us.saturating_sub(near_us.saturating_sub(both_us));
        let usual_us = SET_US.saturating_add(elapsed_us / SLEW).min(FURTHEST_US);
        if is_whole_wraps(off_us, usual_us) {
            unwrap_near(both_us.saturating_add(elapsed_us), timestamp_low)
        } else {
            near_us
        }
    }
}

/// Beside pauses of any length clocks do not differ by more, microseconds; of clocks that were set, one in 200 does not by chance.
const FURTHEST_US: i64 = 10_000_000;
/// Period of the card's clock, microseconds.
const WRAP_US: i64 = 1 << 32;

/// True if a clock that was off by so much went on by a wrap of the card's clock or several, to within `usual_us`.
fn is_whole_wraps(off_us: i64, usual_us: i64) -> bool {
    let from_whole = off_us.saturating_add(WRAP_US / 2).rem_euclid(WRAP_US).abs_diff(WRAP_US / 2);
    off_us > 0 && from_whole < usual_us.unsigned_abs()
}

/// A host's clock may be this far from the card's between two records, microseconds, and be no clock that was set: records
/// are read late, and network time is slewed.
const SET_US: i64 = 500_000;
/// And this share of the time between them.
const SLEW: i64 = 1_000;

/// How the host's clock went on beside the card's, from record to record.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct HostSteps {
    /// Times that it was set: half a second and more off what the card's clock says went by.
    pub set: u64,
    /// The furthest of them, microseconds, negative where it was set back.
    pub furthest_us: i64,
    /// Card's clock and host time of the last record that had both.
    #[serde(skip)]
    last: Option<(u32, i64)>,
}

impl HostSteps {
    /// Takes the next record. The card's clock wraps every 71.6 minutes: how often between two records nobody knows, so a
    /// clock that was set on by just that is a pause. Where the card's clock went back, it is that clock which restarted.
    pub(super) fn note(&mut self, timestamp_low: u32, host_us: Option<i64>) {
        let Some(host_us) = host_us else { return };
        let Some((card, host)) = self.last.replace((timestamp_low, host_us)) else { return };
        let card_us = i64::from(timestamp_low.wrapping_sub(card).cast_signed());
        let off_us = host_us.saturating_sub(host).saturating_sub(card_us);
        let is_pause = is_whole_wraps(off_us, SET_US);
        let usual_us = SET_US.saturating_add(card_us.abs() / SLEW);
        if card_us < 0 || is_pause || off_us.saturating_abs() <= usual_us {
            return;
        }
        self.set += 1;
        if off_us.saturating_abs() > self.furthest_us.saturating_abs() {
            self.furthest_us = off_us;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seconds on the card's clock and on the host's, a record each.
    fn steps(records: &[(f64, f64)]) -> (u64, i64) {
        let mut steps = HostSteps::default();
        for (card, host) in records {
            steps.note((card * 1e6) as u64 as u32, Some(1_700_000_000_000_000 + (host * 1e6) as i64));
        }
        (steps.set, steps.furthest_us)
    }

    #[test]
    fn a_clock_that_stands_is_no_step_back_and_a_second_is_a_pause() {
        let mut steps = ClockSteps::default();
        for step_us in [0, PAUSE_US - 1, PAUSE_US, -1, -3, -2, 5] {
            steps.note(step_us);
        }
        let forward_us = 2 * PAUSE_US + 4;
        let expected =
            ClockSteps { forward_us, steps_back: 3, furthest_back_us: 3, pauses: 1, longest_pause_us: PAUSE_US };
        assert_eq!(steps, expected);
    }

    #[test]
    fn a_pause_longer_than_half_a_wrap_is_one_where_the_host_was_beside_it() {
        let steps = |host: [Option<i64>; 2]| {
            let mut clock = CardClock::default();
            clock.note(1_000, host[0]);
            clock.note(1_000 + 3_000_000_000, host[1]).1
        };
        assert_eq!(steps([Some(0), Some(3_000_400_000)]), Some(3_000_000_000));
        assert_eq!(steps([None, None]), Some(3_000_000_000 - (1 << 32)), "the nearer reading");
    }

    /// Sum of the card's steps forward over records of (card's clock, host's) in seconds; none where the host's is not known.
    fn forward_s(records: impl Iterator<Item = (f64, Option<f64>)>) -> f64 {
        let (mut clock, mut steps) = (CardClock::default(), ClockSteps::default());
        for (card_s, host_s) in records {
            let host_us = host_s.map(|at_s| 1_700_000_000_000_000 + (at_s * 1e6) as i64);
            if let Some(step_us) = clock.note((card_s * 1e6) as u64 as u32, host_us).1 {
                steps.note(step_us);
            }
        }
        assert_eq!(steps.steps_back, 0);
        steps.forward_us as f64 * 1e-6
    }

    #[test]
    fn a_hosts_clock_that_is_not_known_for_long_or_set_is_no_pause_of_the_cards() {
        // A record a second for 50 minutes; the host's times are known at both ends only.
        let known = |k: usize| (!(10..2_990).contains(&k)).then_some(k as f64);
        assert_eq!(forward_s((0..3_000).map(|k| (k as f64, known(k)))), 2_999.0);
        // Set on by a year, and back by a day.
        for set_s in [31_536_000.3, -86_400.3] {
            let host_s = |k: u32| f64::from(k) + if k < 50 { 0.0 } else { set_s };
            assert_eq!(forward_s((0..100).map(|k| (f64::from(k), Some(host_s(k))))), 99.0);
        }
        // A clock that stands through a pause.
        assert_eq!(
            forward_s([(5.0, 0.0), (5.0, 1.0), (5.0, 4_295.0)].map(|(card, host)| (card, Some(host))).into_iter()),
            0.0
        );
        // Pauses with a host's clock that is read late, and that drifts.
        let paused = [(0.0, 0.0), (1.0, 1.0), (3_601.0, 3_601.9), (12_001.0, 12_003.0)];
        assert_eq!(forward_s(paused.map(|(card, host)| (card, Some(host))).into_iter()), 12_001.0);
    }

    #[test]
    fn a_clock_that_stands_is_none() {
        assert_eq!(TimeBase::of(0, 0, 5), TimeBase::Card);
        assert_eq!(TimeBase::of(10, 10 * LEAST_US, 5), TimeBase::Card);
        assert_eq!(TimeBase::of(10, 10 * LEAST_US - 1, 5), TimeBase::Host);
        assert_eq!(TimeBase::of(10, 0, 0), TimeBase::Number);
        assert_eq!(TimeBase::of(u64::MAX, i64::MAX, 0), TimeBase::Card);
    }

    #[test]
    fn a_hosts_clock_that_is_set_is_seen_and_what_is_usual_is_not() {
        assert_eq!(steps(&[(0.0, 0.0), (1.0, 1.4), (2.0, 2.0), (3.0, 3.0)]), (0, 0), "records that were read late");
        assert_eq!(steps(&[(0.0, 0.0), (1.0, 3_601.0), (2.0, 3_602.0)]), (1, 3_600_000_000), "an hour on");
        assert_eq!(
            steps(&[(0.0, 0.0), (1.0, 4.0), (2.0, -7.0), (3.0, -6.0)]),
            (2, -12_000_000),
            "on, and further back"
        );
        assert_eq!(steps(&[(0.0, 0.0), (1.0, 1.6)]), (1, 600_000));
        assert_eq!(steps(&[(1.0, 0.0), (1.0, 1.0)]), (1, 1_000_000), "two records of one microsecond");
        // A pause in which the card's clock wraps twice, one in which it does not, and a clock that drifts by 500 ppm in it.
        let wrap = 4_294.967_296;
        assert_eq!(steps(&[(0.0, 0.0), (10.0, 10.0 + 2.0 * wrap), (1_800.0, 1_800.9 + 2.0 * wrap)]), (0, 0));
        // As far from a whole number of wraps as is no pause any more.
        let past_a_wrap = |off_us: i64| {
            let mut steps = HostSteps::default();
            [(0, 0), (10, (1 << 32) + off_us + 10)].iter().for_each(|(card, host)| steps.note(*card, Some(*host)));
            steps.set
        };
        assert_eq!([SET_US - 1, SET_US, 1 - SET_US, -SET_US].map(past_a_wrap), [0, 1, 0, 1]);
        // The card was reset.
        assert_eq!(steps(&[(500.0, 0.0), (0.0, 0.2), (1.0, 1.2)]), (0, 0));
        // Records without a time are passed over.
        let mut passed = HostSteps::default();
        for (card, host_us) in [(0, Some(1)), (1, None), (2_000_000, Some(2_000_001))] {
            passed.note(card, host_us);
        }
        assert_eq!(passed.set, 0);
    }
}
