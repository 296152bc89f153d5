//! The turn-around of a responder.

use super::random::Stream;
use serde::{Deserialize, Serialize};

/// The turn-around time of a responder, air rise to air rise.
///
/// A normal core about the median, and up to three groups of answers away from it; all kept within the bounds. The WSR
/// driver's: 145 to 322 us, median 225. In the captures of \[paper\] (docs/reference/references.md) the core is 4 to 8
/// us wide and the rest early, by some 110 us for a tenth to a third of the answers, by some 210 for a few in a
/// hundred, or late by some 70: the responder's driver answers when it is interrupted, and sometimes that is at once.
/// The responder's records of such exchanges reach its host earlier by the same times (measured in its host times),
/// here too. Answers outside the core come in runs (measured: of 2 to 3 on average).
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct TurnAround {
    /// Median, microseconds.
    pub median_us: f64,
    /// Standard deviation of the core, microseconds.
    pub spread_us: f64,
    /// Share of answers in the first group away from the core.
    pub tail: f64,
    /// How much later those are than the others, microseconds; negative for earlier.
    pub tail_us: f64,
    /// Its standard deviation, microseconds.
    pub tail_spread_us: f64,
    /// A second group away from the core.
    pub far: DelayGroup,
    /// A third.
    pub late: DelayGroup,
    /// Mean run length of answers of one group; 0 if answers are independent.
    pub tail_run: f64,
    /// Lower bound, microseconds.
    pub min_us: f64,
    /// Upper bound, microseconds.
    pub max_us: f64,
}

/// Answers away from the core.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct DelayGroup {
    /// Share of all answers.
    pub share: f64,
    /// How much later they are than the core, microseconds; negative for earlier.
    pub us: f64,
    /// Standard deviation, microseconds.
    pub spread_us: f64,
}

/// The group of the last answer, if it was outside the core.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Away(Option<usize>);

impl Default for TurnAround {
    fn default() -> Self {
        Self {
            median_us: 225.0,
            spread_us: 0.0,
            tail: 0.0,
            tail_us: -100.0,
            tail_spread_us: 0.0,
            far: DelayGroup::default(),
            late: DelayGroup::default(),
            tail_run: 0.0,
            min_us: 145.0,
            max_us: 322.0,
        }
    }
}

impl TurnAround {
    /// The groups away from the core.
    #[must_use]
    pub fn groups(&self) -> [DelayGroup; 3] {
        [DelayGroup { share: self.tail, us: self.tail_us, spread_us: self.tail_spread_us }, self.far, self.late]
    }

    /// One turn-around, nanoseconds. `away_ns` is what [`TurnAround::draw_away_ns`] gave for the frame that is answered.
    pub(crate) fn draw_ns(&self, away_ns: i64, stream: &mut Stream) -> i64 {
        let us = self.median_us + stream.spread(self.spread_us) + away_ns as f64 * 1e-3;
        (us.clamp(self.min_us, self.max_us) * 1e3).round() as i64
    }

    /// Deviation of one frame's interrupt from the usual, nanoseconds; 0 in the core.
    pub(crate) fn draw_away_ns(&self, last: &mut Away, stream: &mut Stream) -> i64 {
        let groups = self.groups();
        let share = groups.iter().map(|group| group.share).sum::<f64>();
        let runs = self.tail_run > 1.0 && share < 1.0;
        let chance = match last.0 {
            Some(_) if runs => 1.0 - 1.0 / self.tail_run,
            None if runs => share / ((1.0 - share) * self.tail_run),
            _ => share,
        };
        if !stream.happens(chance) {
            last.0 = None;
            return 0;
        }
        let group = match last.0.filter(|_| runs) {
            Some(group) => group,
            None => pick(&groups, share, stream),
        };
        last.0 = Some(group);
        let DelayGroup { us, spread_us, .. } = groups[group];
        ((us + stream.spread(spread_us)) * 1e3).round() as i64
    }
}

/// The number of a group, by their shares; nothing is drawn for a single one.
fn pick(groups: &[DelayGroup; 3], share: f64, stream: &mut Stream) -> usize {
    if let Some(only) = groups.iter().position(|group| group.share == share) {
        return only;
    }
    let mut left = stream.uniform() * share;
    let found = groups.iter().position(|group| {
        left -= group.share;
        left < 0.0
    });
    found.unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::super::random::Purpose;
    use super::*;

    #[test]
    fn turn_arounds_keep_to_their_bounds_and_shape() {
        let turn =
            TurnAround { spread_us: 6.0, tail: 0.2, tail_us: -100.0, tail_spread_us: 30.0, ..TurnAround::default() };
        let mut stream = Stream::new(1, 0, Purpose::Timing);
        let draw = |turn: &TurnAround, stream: &mut Stream| {
            let away_ns = turn.draw_away_ns(&mut Away::default(), stream);
            turn.draw_ns(away_ns, stream)
        };
        let mut drawn: Vec<i64> = (0..20_000).map(|_| draw(&turn, &mut stream)).collect();
        drawn.sort_unstable();
        assert_eq!(drawn[0], 145_000, "kept within the bounds");
        assert!(drawn[19_999] < 255_000);
        // A fifth away from the core: the median of the rest is at 0.2 + 0.8 / 2 of all.
        assert!((drawn[12_000] - 225_000).abs() < 1_000, "core {}", drawn[12_000]);
        assert!(drawn[3_800] < 205_000 && drawn[4_300] > 205_000, "{} {}", drawn[3_800], drawn[4_300]);
        assert_eq!(draw(&TurnAround::default(), &mut stream), 225_000);
    }
    #[test]
    fn answers_outside_the_core_come_in_runs_and_groups() {
        let group = |share, us| DelayGroup { share, us, spread_us: 0.0 };
        let turn = TurnAround {
            tail: 0.1,
            far: group(0.06, -200.0),
            late: group(0.04, 70.0),
            tail_run: 4.0,
            ..TurnAround::default()
        };
        let (mut stream, mut away) = (Stream::new(2, 0, Purpose::Timing), Away::default());
        let drawn: Vec<i64> = (0..200_000).map(|_| turn.draw_away_ns(&mut away, &mut stream)).collect();
        let share = |ns: i64| drawn.iter().filter(|&&d| d == ns).count() as f64 / 200_000.0;
        for (ns, expected) in [(0, 0.8), (-100_000, 0.1), (-200_000, 0.06), (70_000, 0.04)] {
            // Runs of four make the count's deviation about sqrt(8) times that of independent draws.
            assert!((share(ns) - expected).abs() < 0.008, "{ns}: {}", share(ns));
        }
        let runs = drawn.chunk_by(|a, b| a == b).filter(|run| run[0] != 0).count();
        let mean = 200_000.0 * 0.2 / runs as f64;
        assert!((mean - 4.0).abs() < 0.25, "{mean} answers a run");
    }
}
