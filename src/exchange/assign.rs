//! Finds the logs that belong together: the transmitter of each log, and whether two logs are of the same run.
//!
//! # The transmitter
//! A transmitter's log holds only the receiver's MAC, not its own, and all robots of a round share frame numbers. Time
//! distinguishes them: only the turn-around lies between a robot's reception and its answer, so `clock_tx - clock_rx`
//! of the right match is a straight line with some tens of microseconds of jitter. A wrong match also contains the
//! waits for the sender's slots and spreads more: on the 36 links of the WSR data set at hand that have a choice, 2.2
//! times at least and mostly over 4 times (measured; the median of the deviations separates them better than their mean
//! or root mean square, since outliers of the turn-around are common). The number of common frame numbers does not
//! decide: it is wrong or tied on half of these links.
//!
//! # The run
//! A pair is one exchange if the second frame answers the first. Then both cards' clocks measured the same pause since
//! the last exchange, except for the jitter of the turn-around. In two logs of different runs, paired by numbers that
//! both count from 1, the pauses are unrelated. The correlation of the pauses (each side's deviations from its median)
//! is 1 for one run and 0 +- `1 / sqrt(n)` for two, whatever the clocks' offset, drift and rate.
//!
//! A very regular initiator leaves nothing to correlate; then the pairs' clock difference must be steady by itself.
//!
//! Both logs also heard one channel: its shape over the subcarriers is the same in both directions. The magnitudes of a packet in
//! decibels less their mean over the subcarriers do not depend on gains. While robots move the shape changes; in the two directions of
//! one link it changes alike (correlation 0.91 to 0.99 on 70 real links), in two logs of different runs it does not (-0.16 to 0.21 on
//! 30 pairs of real logs).

use crate::exchange::pairing::by_clock::Refusal;
use crate::exchange::pairing::{Pair, Pairing};
use crate::maths::upper_median;
use crate::signal::cfo::drift_line;
use crate::signal::channel::SUBCARRIERS;
use driver_iface::Mac;
use num_complex::Complex32;

/// Fewest common numbers that decide whether logs match.
pub(crate) const MIN_COMMON: usize = 16;

/// The next best match must spread by at least this factor more.
const MIN_MARGIN: f64 = 1.5;

/// What matching needs of a record: frame number and card clock (`timestamp_low`).
pub type Mark = (u32, u32);

/// How well a transmitter's log matches the frames of one MAC in the receiver's log.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Spread {
    /// Median absolute deviation of `clock_tx - clock_rx` from a straight line, microseconds.
    pub spread_us: f64,
    /// Frame numbers in common.
    pub common: usize,
}

/// Pairs used: a median of a few hundred is stable.
const MAX_COMMON: usize = 384;

/// The first pairs of one transmitter log and the receiver's frames of one MAC, both in log order, with their places in them.
#[must_use]
pub fn common(receiver: &[Mark], transmitter: &[Mark]) -> Vec<Pair<usize>> {
    let mut pairing = Pairing::new(4_096);
    let (mut r, mut t) = (receiver.iter().enumerate(), transmitter.iter().enumerate());
    let mut pairs = Vec::new();
    let mut take = |pairing: &mut Pairing<usize>| {
        pairs.extend(std::iter::from_fn(|| pairing.poll_pair()));
        pairs.len()
    };
    while let Some((side, (place, &(number, timestamp_low)))) = pairing.next(&mut r, &mut t) {
        pairing.handle(side, number, timestamp_low, place);
        if take(&mut pairing) >= MAX_COMMON {
            break;
        }
    }
    pairing.finish();
    take(&mut pairing);
    pairs
}

/// The spread of one transmitter log against the receiver's frames of one MAC, both in log order.
#[must_use]
pub fn spread(receiver: &[Mark], transmitter: &[Mark]) -> Option<Spread> {
    let pairs = common(receiver, transmitter);
    if pairs.len() < MIN_COMMON {
        return None;
    }
    let clock: Vec<i64> = pairs.iter().map(|pair| pair.clock_rx_us).collect();
    let difference: Vec<i64> = pairs.iter().map(|pair| pair.clock_difference_us).collect();
    let line = drift_line(&clock, &difference);
    let mut deviations: Vec<f64> =
        clock.iter().zip(&difference).map(|(&x, &y)| (y as f64 - line.at(x as f64)).abs()).collect();
    let spread_us = upper_median(&mut deviations)?;
    Some(Spread { spread_us, common: clock.len() })
}

/// A transmitter's log and the MAC found for it.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Match {
    /// Index of the MAC.
    pub mac: usize,
    /// How well it matches.
    pub spread: Spread,
    /// Spread of the next best MAC over that of this one; `None` where no other was possible.
    pub margin: Option<f64>,
}

/// Why a log could not be matched.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Unmatched {
    /// No MAC has enough frame numbers in common with the log.
    #[error(
        "no transmitter in the receiver's log shares {} frame numbers with it: are the two logs of the same run?",
        MIN_COMMON
    )]
    NothingInCommon,
    /// Two MACs match it about equally well.
    #[error(
        "two transmitters match it about equally well ({spread_us:.1} us against {next_us:.1} us; logs of one run differ by some tens): if they are of the same run, name its MAC"
    )]
    Unclear {
        /// Spread of the best, microseconds.
        spread_us: f64,
        /// Spread of the next, microseconds.
        next_us: f64,
    },
    /// Its best MAC was named for another log.
    #[error("its best match ({spread_us:.1} us) was named for another log: check the order of the MACs")]
    Named {
        /// Spread of this log, microseconds.
        spread_us: f64,
    },
    /// Frames have no numbers, and the cards' clocks do not show which belong together.
    #[error(transparent)]
    Clocks(#[from] Refusal),
    /// Both logs contain frames of the same sender, so neither is of the robot that the other heard.
    #[error("both logs hold frames of {mac}: two logs of one link are of two robots, each with frames of the other")]
    SameSender {
        /// The sender.
        mac: Mac,
    },
    /// Another log matches the same MAC better.
    #[error(
        "its best match belongs to another log, which matches better ({other_us:.1} us against {spread_us:.1} us): if the logs are of the same run, name its MAC"
    )]
    Taken {
        /// Spread of this log, microseconds.
        spread_us: f64,
        /// Spread of the other log, microseconds.
        other_us: f64,
    },
}

/// Matches logs to MACs. `spreads[log][mac]`; `taken[mac]` is true for MACs that are named for other logs already.
#[must_use]
pub fn assign(spreads: &[Vec<Option<Spread>>], taken: &[bool]) -> Vec<Result<Match, Unmatched>> {
    let free = |mac: usize| !taken.get(mac).copied().unwrap_or(false);
    let best = |log: &Vec<Option<Spread>>| -> Result<Match, Unmatched> {
        let mut order: Vec<(usize, Spread)> =
            log.iter().enumerate().filter_map(|(mac, s)| s.map(|s| (mac, s))).collect();
        order.sort_by(|a, b| a.1.spread_us.total_cmp(&b.1.spread_us));
        let &(mac, spread) = order.first().ok_or(Unmatched::NothingInCommon)?;
        // Clocks of whole microseconds do not resolve a tenth of a microsecond.
        let margin = order.get(1).map(|next| (next.1.spread_us + 0.1) / (spread.spread_us + 0.1));
        match margin {
            _ if !free(mac) => Err(Unmatched::Named { spread_us: spread.spread_us }),
            Some(margin) if margin < MIN_MARGIN => {
                Err(Unmatched::Unclear { spread_us: spread.spread_us, next_us: order[1].1.spread_us })
            }
            _ => Ok(Match { mac, spread, margin }),
        }
    };
    let found: Vec<_> = spreads.iter().map(best).collect();
    let rival = |log: usize, own: &Match| {
        let others = found.iter().enumerate().filter(|(k, _)| *k != log).filter_map(|(_, m)| m.as_ref().ok());
        others.filter(|m| m.mac == own.mac).map(|m| m.spread.spread_us).min_by(f64::total_cmp)
    };
    let settle = |(log, result): (usize, &Result<Match, Unmatched>)| match result {
        Ok(own) => match rival(log, own) {
            Some(other_us) if other_us <= own.spread.spread_us => {
                Err(Unmatched::Taken { spread_us: own.spread.spread_us, other_us })
            }
            _ => Ok(*own),
        },
        Err(error) => Err(*error),
    };
    found.iter().enumerate().map(settle).collect()
}

/// MACs to try for a log that is still unclear, the best first.
const TRIED: usize = 4;
/// Most logs that are settled together.
const TOGETHER: usize = 6;

/// Settles the logs that [`assign`] left unclear, all together: each MAC wrote one log, so evidence for one log's MAC
/// is evidence against it for the others. `reciprocity[log][mac]`, where known, is the correlation of the channel's
/// changes in the two directions, 0 for strangers and nearly 1 for the two ends of a link: with the spread `s` and the
/// correlation `r` a match costs `ln s - 2 artanh r`. A log is settled if every other assignment costs at least
/// `MIN_MARGIN` times as much, and its spread is within that factor of its least.
pub fn settle(
    found: &mut [Result<Match, Unmatched>],
    spreads: &[Vec<Option<Spread>>],
    reciprocity: &[Vec<Option<f64>>],
    taken: &[bool],
) {
    let clear: Vec<usize> = found.iter().flatten().map(|own| own.mac).collect();
    let logs: Vec<usize> = (0..found.len()).filter(|&log| is_open(&found[log])).take(TOGETHER).collect();
    let choices: Vec<Vec<(usize, f64)>> = logs
        .iter()
        .map(|&log| {
            let free = |mac: &usize| !clear.contains(mac) && !taken.get(*mac).copied().unwrap_or(false);
            let cost = |mac: usize| {
                let correlation = reciprocity.get(log).and_then(|row| *row.get(mac)?).unwrap_or(0.0);
                Some((mac, (spreads[log][mac]?.spread_us + 0.1).ln() - 2.0 * correlation.clamp(0.0, 0.99).atanh()))
            };
            let mut costs: Vec<_> = (0..spreads[log].len()).filter(free).filter_map(cost).collect();
            costs.sort_by(|a, b| a.1.total_cmp(&b.1));
            costs.truncate(TRIED);
            costs
        })
        .collect();
    let Some((cost, chosen)) = cheapest(&choices, &mut Vec::new(), None) else { return };
    for (k, &log) in logs.iter().enumerate() {
        let mac = chosen[k];
        let margin = cheapest(&choices, &mut Vec::new(), Some((k, mac))).map(|(other, _)| (other - cost).exp());
        let least = spreads[log].iter().flatten().map(|s| s.spread_us).fold(f64::INFINITY, f64::min);
        let Some(spread) = spreads[log][mac] else { continue };
        if margin.is_none_or(|margin| margin >= MIN_MARGIN) && spread.spread_us <= MIN_MARGIN * (least + 0.1) {
            found[log] = Ok(Match { mac, spread, margin });
        }
    }
}

/// True for a log that matches two MACs about equally well, or whose best MAC matches another log better.
pub fn is_open(result: &Result<Match, Unmatched>) -> bool {
    matches!(result, Err(Unmatched::Unclear { .. } | Unmatched::Taken { .. }))
}

/// The cheapest assignment of different MACs to all logs, without one excluded match; `given` are those of the first
/// logs.
fn cheapest(
    choices: &[Vec<(usize, f64)>],
    given: &mut Vec<usize>,
    without: Option<(usize, usize)>,
) -> Option<(f64, Vec<usize>)> {
    let log = given.len();
    let Some(own) = choices.get(log) else { return Some((0.0, given.clone())) };
    let mut best: Option<(f64, Vec<usize>)> = None;
    for &(mac, cost) in own {
        if given.contains(&mac) || without == Some((log, mac)) {
            continue;
        }
        given.push(mac);
        if let Some((rest, macs)) = cheapest(choices, given, without)
            && best.as_ref().is_none_or(|(least, _)| cost + rest < *least)
        {
            best = Some((cost + rest, macs));
        }
        given.pop();
    }
    best
}

/// Deviations of pauses are clipped to this many median deviations: lost frames and stalls of an operating system.
const CLIP: f64 = 5.0;
/// Fewest pauses, or pairs, that decide.
pub(crate) const LEAST_PAUSES: usize = 24;

/// How the pauses of two logs correlate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Kinship {
    /// Correlation of the pauses, -1 to 1.
    pub correlation: f64,
    /// Median deviation of the receiver's pauses from their median, microseconds.
    pub pause_us: f64,
    /// Pauses compared.
    pub pauses: usize,
}

/// Compares the pauses between pairs on both cards' clocks: `clock_rx_us` is the receiver's, `difference_us` the
/// transmitter's less the receiver's, both unwrapped, one entry a pair. `None` with fewer than 24 ordinary pauses.
#[must_use]
pub(crate) fn kinship(clock_rx_us: &[i64], difference_us: &[i64]) -> Option<Kinship> {
    let step = |values: &[i64]| values.windows(2).map(|w| (w[1] - w[0]) as f64).collect::<Vec<f64>>();
    let receiver = step(clock_rx_us);
    let transmitter: Vec<f64> = receiver.iter().zip(step(difference_us)).map(|(pause, more)| pause + more).collect();
    let usual = [upper_median(&mut receiver.clone())?, upper_median(&mut transmitter.clone())?];
    // Lost frames make longer pauses on both sides, in any two logs.
    let ordinary = |pause: f64, side: usize| pause > 0.5 * usual[side] && pause < 1.5 * usual[side];
    let both: Vec<(f64, f64)> =
        receiver.into_iter().zip(transmitter).filter(|(r, t)| ordinary(*r, 0) && ordinary(*t, 1)).collect();
    if both.len() < LEAST_PAUSES {
        return None;
    }
    let (r, pause_us) = clipped(both.iter().map(|pair| pair.0).collect())?;
    let (t, _) = clipped(both.iter().map(|pair| pair.1).collect())?;
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let norm = (dot(&r, &r) * dot(&t, &t)).sqrt();
    let correlation = if norm > 0.0 { dot(&r, &t) / norm } else { 0.0 };
    Some(Kinship { correlation, pause_us, pauses: both.len() })
}

/// Deviations from the median, clipped, their mean removed, and their median size.
fn clipped(values: Vec<f64>) -> Option<(Vec<f64>, f64)> {
    let middle = upper_median(&mut values.clone())?;
    let usual = upper_median(&mut values.iter().map(|v| (v - middle).abs()).collect::<Vec<_>>())?;
    let limit = CLIP * usual.max(1.0);
    let mut off: Vec<f64> = values.iter().map(|v| (v - middle).clamp(-limit, limit)).collect();
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    off.iter_mut().for_each(|v| *v -= mean);
    Some((off, usual))
}

/// Magnitudes below this count as this: less than one step of the card's numbers.
const SMALLEST: f32 = 0.5;

type Shape = [f64; SUBCARRIERS];

/// Sums over the pairs of one subcarrier, forward and backward: values, squares, product, products with the pair before.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    one: [f64; 2],
    square: [f64; 2],
    product: f64,
    before: [f64; 2],
}

/// Sums over the pairs of a link, from which the shapes' correlation follows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Reciprocity {
    pairs: f64,
    sums: [Sums; SUBCARRIERS],
    last: Option<[Shape; 2]>,
}

/// What the sums say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reciprocal {
    /// Correlation of the two directions' changes of shape, -1 to 1.
    pub correlation: f64,
    /// The lower of the two directions' correlations from one pair to the next: near 0 where the shape changes by noise alone.
    pub steadiness: f64,
}

impl Reciprocity {
    /// Takes the two frames of a pair.
    pub fn add(&mut self, forward: &[Complex32; SUBCARRIERS], backward: &[Complex32; SUBCARRIERS]) {
        let now = [shape(forward), shape(backward)];
        self.pairs += 1.0;
        for (k, sums) in self.sums.iter_mut().enumerate() {
            sums.product += now[0][k] * now[1][k];
            for (side, own) in now.iter().enumerate() {
                sums.one[side] += own[k];
                sums.square[side] += own[k] * own[k];
                sums.before[side] += self.last.map_or(own[k], |last| last[side][k]) * own[k];
            }
        }
        self.last = Some(now);
    }

    /// The correlations; none with too few pairs, or where a side's shape never changes.
    pub fn get(&self) -> Option<Reciprocal> {
        let n = self.pairs;
        let mean = |a: f64, b: f64| a * b / (n * n);
        let sum = |of: &dyn Fn(&Sums) -> f64| self.sums.iter().map(of).sum::<f64>();
        let square = [0, 1].map(|side| sum(&|s| s.square[side] / n - mean(s.one[side], s.one[side])));
        let before = [0, 1].map(|side| sum(&|s| s.before[side] / n - mean(s.one[side], s.one[side])));
        let product = sum(&|s| s.product / n - mean(s.one[0], s.one[1]));
        let norm = (square[0] * square[1]).sqrt();
        (n >= LEAST_PAUSES as f64 && norm > 1e-12).then(|| Reciprocal {
            correlation: product / norm,
            steadiness: (before[0] / square[0]).min(before[1] / square[1]),
        })
    }
}

/// Logarithms of the magnitudes less their mean.
fn shape(csi: &[Complex32; SUBCARRIERS]) -> Shape {
    let level = csi.map(|h| f64::from(0.5 * h.norm_sqr().max(SMALLEST * SMALLEST).ln()));
    let mean = level.iter().sum::<f64>() / SUBCARRIERS as f64;
    level.map(|v| v - mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(us: f64) -> Option<Spread> {
        Some(Spread { spread_us: us, common: 400 })
    }

    /// Three robots answer in slots 3 ms apart, each within its own turn-around jitter; the slots wander by 200 us.
    fn round(robot: u32, jitter: u32) -> (Vec<Mark>, Vec<Mark>) {
        let noise = |n: u32, salt: u32| {
            let mixed = (n ^ (salt << 16)).wrapping_mul(0x9e37_79b9);
            (mixed ^ (mixed >> 15)).wrapping_mul(0x85eb_ca6b) >> 22
        };
        let forward = |n: u32| n * 10_000 + robot * 3_000 + noise(n, robot) / 4;
        let turn_around = |n: u32| 220 + noise(n, 77 + robot) * jitter / 1_024;
        let transmitter = (1..400).map(|n| (n, forward(n).wrapping_add(robot * 1_000_000))).collect();
        let receiver = (1..400).map(|n| (n, forward(n) + turn_around(n))).collect();
        (receiver, transmitter)
    }

    #[test]
    fn each_log_finds_its_robot() {
        let links: Vec<_> = (0..3).map(|robot| round(robot, 20)).collect();
        let order = [2, 0, 1];
        let row = |&log: &usize| (0..3).map(|mac| spread(&links[mac].0, &links[log].1)).collect();
        let spreads: Vec<Vec<_>> = order.iter().map(row).collect();
        for (found, expected) in assign(&spreads, &[]).iter().zip(order) {
            let found = found.unwrap();
            assert_eq!(found.mac, expected);
            assert!(found.margin.unwrap() > 3.0, "{found:?}");
        }
        let named = assign(&spreads[1..2], &[true, false, false])[0];
        assert!(matches!(named, Err(Unmatched::Named { .. })), "{named:?}");
    }

    #[test]
    fn unclear_logs_are_settled_together_and_by_the_channel() {
        // Each alone is unclear (1.3 times); both together are clear (1.7 times).
        let spreads = [vec![of(10.0), of(13.0)], vec![of(13.0), of(10.0)]];
        let mut found = assign(&spreads, &[]);
        assert!(found.iter().all(is_open));
        settle(&mut found, &spreads, &[], &[]);
        assert_eq!(found.iter().map(|f| f.unwrap().mac).collect::<Vec<_>>(), [0, 1]);
        // One log with two senders: the channel decides, even against the spread.
        let spreads = [vec![of(26.8), of(32.1)]];
        for (correlations, mac) in [([0.98, 0.1], 0), ([0.1, 0.98], 1)] {
            let mut found = assign(&spreads, &[]);
            settle(&mut found, &spreads, &[correlations.map(Some).to_vec()], &[]);
            assert_eq!(found[0].unwrap().mac, mac);
        }
        // Without a decision it stays unclear. A log given twice does not get a MAC that does not match.
        let mut found = assign(&spreads, &[]);
        settle(&mut found, &spreads, &[], &[]);
        assert!(matches!(found[0], Err(Unmatched::Unclear { .. })));
        let twice = [vec![of(5.0), of(300.0)], vec![of(5.0), of(300.0)]];
        let mut found = assign(&twice, &[]);
        settle(&mut found, &twice, &[], &[]);
        assert!(found.iter().all(|f| matches!(f, Err(Unmatched::Taken { .. }))), "{found:?}");
    }

    #[test]
    fn spreads_below_what_clocks_can_tell_decide_nothing_by_their_ratio() {
        let margin = |a: f64, b: f64| assign(&[vec![of(a), of(b)]], &[])[0].map(|found| found.margin);
        assert_eq!(margin(0.0, 0.1), Ok(Some(2.0)), "a tenth of a microsecond is added to both");
        assert!(matches!(margin(0.0, 0.04), Err(Unmatched::Unclear { .. })), "1.4 times");
        // One log alone stays unclear unless the channel decides.
        let spreads = [vec![of(0.0), of(0.04)]];
        for (reciprocity, mac) in [(vec![], None), (vec![vec![Some(0.5), None]], Some(0))] {
            let mut found = assign(&spreads, &[]);
            settle(&mut found, &spreads, &reciprocity, &[]);
            assert_eq!(found[0].ok().map(|found| found.mac), mac);
        }
    }

    #[test]
    fn the_cheapest_assignment_is_taken() {
        let spreads = [vec![of(10.0), of(13.0)]];
        let mut found = assign(&spreads, &[]);
        settle(&mut found, &spreads, &[vec![Some(0.5), None]], &[]);
        let found = found[0].unwrap();
        // ln 13.1 - (ln 10.1 - 2 artanh 0.5), as a ratio.
        assert_eq!(found.mac, 0);
        assert!((found.margin.unwrap() - 13.1 / 10.1 * 3.0).abs() < 1e-9, "{found:?}");
        // The best choices of each log alone cost more together: 10 + 40 against 12 + 13, in tenths.
        let costs = vec![vec![(0, 1.0), (1, 1.2)], vec![(0, 1.3), (1, 4.0)]];
        let (cost, macs) = cheapest(&costs, &mut Vec::new(), None).unwrap();
        assert!((cost - 2.5).abs() < 1e-12 && macs == [1, 0], "{cost} {macs:?}");
        let (other, macs) = cheapest(&costs, &mut Vec::new(), Some((0, 1))).unwrap();
        assert!((other - 5.0).abs() < 1e-12 && macs == [0, 1], "{other} {macs:?}");
    }

    #[test]
    fn sixteen_numbers_in_common_are_enough_and_half_as_much_again_is_clear() {
        let (receiver, transmitter) = round(0, 20);
        let common = |records: usize| spread(&receiver[..records], &transmitter).map(|found| found.common);
        assert_eq!([common(MIN_COMMON - 1), common(MIN_COMMON)], [None, Some(MIN_COMMON)]);
        // Both are a tenth of a microsecond more: 1 and 1.5.
        assert_eq!(assign(&[vec![of(0.9), of(1.4)]], &[])[0].map(|found| found.mac), Ok(0));
        assert!(assign(&[vec![of(0.9), of(1.39)]], &[])[0].is_err());
    }

    #[test]
    fn of_two_logs_of_one_sender_the_better_keeps_it() {
        let found = assign(&[vec![of(5.0), of(300.0)], vec![of(8.0), of(300.0)]], &[]);
        assert_eq!(found[0].map(|found| found.mac), Ok(0));
        assert_eq!(found[1], Err(Unmatched::Taken { spread_us: 8.0, other_us: 5.0 }));
        assert_eq!([&found[0], &found[1]].map(is_open), [false, true]);
    }

    #[test]
    fn an_unclear_log_gets_the_remaining_sender() {
        // The first sender clearly belongs to another log, or is named for one.
        let clear = [vec![of(5.0), of(300.0)], vec![of(8.0), of(9.0)]];
        let named = [vec![None, None], vec![of(9.0), of(8.0)]];
        for (spreads, taken) in [(&clear, [false, false]), (&named, [true, false])] {
            let mut found = assign(spreads, &taken);
            assert_eq!([&found[0], &found[1]].map(is_open), [false, true]);
            let first = found[0];
            settle(&mut found, spreads, &[], &taken);
            assert_eq!((found[0], found[1].map(|found| found.mac)), (first, Ok(1)));
        }
    }

    #[test]
    fn unclear_and_unrelated_logs_are_refused() {
        let (receiver, transmitter) = round(0, 20);
        let same = spread(&receiver, &transmitter);
        assert!(matches!(assign(&[vec![same, same]], &[])[0], Err(Unmatched::Unclear { .. })));
        assert!(matches!(assign(&[vec![same], vec![same]], &[])[0], Err(Unmatched::Taken { .. })));
        assert_eq!(spread(&receiver[..10], &transmitter), None);
        assert_eq!(assign(&[vec![None]], &[])[0], Err(Unmatched::NothingInCommon));
    }

    /// Pauses of 10 ms with a jitter of `jitter_us`, as a card's clock shows their ends.
    fn ends(seed: u64, jitter_us: i64) -> Vec<i64> {
        let mut state = seed;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as i64
        };
        (0..600).map(|k| 10_000 * k + if jitter_us > 0 { random() % jitter_us } else { 0 }).collect()
    }

    fn kinship_of(rx: &[i64], tx: &[i64]) -> Kinship {
        let difference: Vec<i64> = rx.iter().zip(tx).map(|(rx, tx)| tx - rx).collect();
        kinship(rx, &difference).unwrap()
    }

    #[test]
    fn the_pauses_of_an_exchange_go_together_whatever_the_clocks() {
        let rx = ends(1, 200);
        let turn_around = ends(2, 30);
        // Another zero, 20 ppm of drift, a turn-around that jitters, every fiftieth frame lost.
        let tx: Vec<i64> = rx
            .iter()
            .zip(&turn_around)
            .enumerate()
            .map(|(k, (r, t))| r - t % 10_000 + 7_000_000 + r / 50_000 + k as i64 % 2)
            .collect();
        let keep = |v: &[i64]| v.iter().enumerate().filter(|(k, _)| k % 50 != 7).map(|(_, v)| *v).collect::<Vec<_>>();
        let found = kinship_of(&keep(&rx), &keep(&tx));
        // 588 of 600 frames, without the pauses over lost ones.
        assert!(found.correlation > 0.9 && found.pauses == 587 - 12, "{found:?}");
    }

    #[test]
    fn the_pauses_of_two_runs_do_not() {
        let found = kinship_of(&ends(1, 200), &ends(9, 200));
        assert!(found.correlation.abs() < 0.2, "{found:?}");
        // Two runs at two rates.
        let slower: Vec<i64> = ends(9, 200).iter().map(|end| 2 * end).collect();
        assert!(kinship_of(&ends(1, 200), &slower).correlation.abs() < 0.2);
        let regular = kinship_of(&ends(1, 0), &ends(1, 0));
        assert_eq!((regular.correlation, regular.pause_us), (0.0, 0.0));
        let few = |records: usize| kinship(&ends(1, 5)[..records], &vec![0; records]).map(|found| found.pauses);
        assert_eq!([few(20), few(24), few(25)], [None, None, Some(24)]);
    }

    #[test]
    fn a_pause_far_from_the_others_counts_no_more_than_five_usual_ones() {
        // The median is 1,000, the median deviation 10.
        let values = vec![980.0, 990.0, 990.0, 1_000.0, 1_010.0, 1_010.0, 5_000.0];
        let (off, usual) = clipped(values).unwrap();
        let clipped_off = [-20.0, -10.0, -10.0, 0.0, 10.0, 10.0, 50.0];
        let mean = 30.0 / 7.0;
        assert_eq!(usual, 10.0);
        assert!(off.iter().zip(clipped_off).all(|(off, is)| (off - (is - mean)).abs() < 1e-9), "{off:?}");
        // Pauses that are all equal, in whole microseconds.
        let (off, usual) = clipped(vec![7.0, 7.0, 7.0, 90.0]).unwrap();
        assert_eq!((usual, off), (0.0, vec![-1.25, -1.25, -1.25, 3.75]));
    }

    #[test]
    fn a_pause_of_half_as_much_again_is_over_a_lost_frame() {
        let at = |long: i64| (0..200).map(|k| 10_000 * k + long * (k / 10)).collect::<Vec<i64>>();
        let pauses = |rx: &[i64], tx: &[i64]| kinship_of(rx, tx).pauses;
        let (short, long) = (at(4_999), at(5_000));
        assert_eq!(pauses(&short, &short), 199);
        assert_eq!([pauses(&long, &long), pauses(&long, &short), pauses(&short, &long)], [199 - 19; 3]);
        // One of half the length is not this initiator's.
        let (half, more) = (at(-5_000), at(-4_999));
        assert_eq!([pauses(&half, &half), pauses(&half, &more), pauses(&more, &more)], [199 - 19, 199 - 19, 199]);
    }

    /// A channel of two paths, `k` pairs on, with noise of its own for each direction.
    fn channel(k: u32, seed: u32, noise: f32) -> [Complex32; SUBCARRIERS] {
        let turn = 0.05 * k as f32 + seed as f32;
        let mut state = k.wrapping_mul(0x9e37_79b9) ^ seed.wrapping_mul(0x85eb_ca6b);
        std::array::from_fn(|s| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let phase = (state >> 8) as f32 * 1e-6;
            let paths = Complex32::new(20.0, 0.0) + Complex32::from_polar(12.0, turn + 0.3 * s as f32);
            paths + Complex32::from_polar(noise, phase)
        })
    }

    fn shapes(forward: u32, backward: u32, noise: f32) -> Reciprocal {
        let mut sums = Reciprocity::default();
        for k in 0..400 {
            let turned = if backward == forward { k } else { 3 * k + k * k / 97 };
            let back = channel(turned, backward, 0.0);
            let own = channel(k, forward, noise);
            sums.add(&own, &back.map(|h| h * 0.3));
        }
        sums.get().unwrap()
    }

    #[test]
    fn one_channel_is_told_from_two() {
        let (same, other) = (shapes(1, 1, 1.0), shapes(1, 5, 1.0));
        assert!(same.correlation > 0.9 && same.steadiness > 0.8, "{same:?}");
        assert!(other.correlation.abs() < 0.3 && other.steadiness > 0.5, "{other:?}");
        let mut few = Reciprocity::default();
        (0..20).for_each(|k| few.add(&channel(k, 1, 0.0), &channel(k, 1, 1.0)));
        assert_eq!(few.get(), None);
    }

    #[test]
    fn a_shape_that_never_changes_says_nothing() {
        let mut still = Reciprocity::default();
        (0..100).for_each(|_| still.add(&channel(7, 2, 0.0), &channel(7, 2, 1.0)));
        assert_eq!(still.get(), None);
    }
}
