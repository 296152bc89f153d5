//! Pairing of frames without numbers by the two cards' clocks, sans-IO.
//!
//! Only a turn-around lies between a frame that one card heard and the answer that the other card heard. So `clock_tx -
//! clock_rx` is a straight line, sharp to some tens of microseconds except for outliers of the turn-around; shifted by
//! one exchange or more it spreads like the pauses between exchanges. A little irregularity is enough: on WSR's logs
//! the pauses of 4 to 10 ms vary by 0.1 ms, and the right shift is 2 to 8 times as sharp as the next (measured).
//!
//! 1. A stretch of the receiver's log is laid over the transmitter's at every difference that makes one of its records
//!    meet another. For each difference the deviations from a straight line are sorted into bins of 10 us; the share of
//!    pairs of deviations in the same or neighbouring bins is its **sharpness**. It does not require a single peak:
//!    turn-arounds often have two. Host clocks are not used unless the caller states how well they agree.
//! 2. The sharpest difference is taken if it stands out from all others. Otherwise the two logs do not belong together,
//!    or the exchanges are too regular to be distinguished.
//! 3. From there the line is followed to both ends, so that drift may change with temperature.
//! 4. Two records are paired if each is the other's nearest to the line, within half of the shortest exchange. Two that
//!    are equally near are both skipped.
//!
//! After a step back of a clock, the rest is aligned separately.
//!
//! [`ByClock`] takes whole logs, `Live` the same records as they come.

mod live;

pub(crate) use live::Live;

use super::{LinkSide, Pair};
use std::collections::VecDeque;

/// Fewest records of each side for an alignment.
pub const LEAST: usize = 32;
/// Records of a stretch that is laid over the other log.
const STRETCH: usize = 1_024;
/// Largest drift of two cards against each other: crystals are good to 20 ppm each, cheap ones to 50 (802.11-2016 17.3.9.5).
const MAX_DRIFT: f64 = 120e-6;
/// Width of a bin, ns: half of the jitter of a 5300's turn-around.
const BIN_NS: f64 = 10_000.0;
/// Deviations further out than this many bins share the outermost.
const BINS: usize = 1_024;
/// Most slopes tried on each side of the best fit, as its error requires.
const SLOPES: i32 = 16;
/// Least ratio of the best sharpness to the next: at least 2.0 for logs that belong together, at most 1.0 for others
/// (measured on WSR's and the paper's logs).
const STANDS_OUT: f64 = 1.3;
/// Least distance of the best sharpness from all others, in their deviations: at least 54 for logs that belong
/// together, at most 5 for others.
const DEVIATIONS: f64 = 12.0;
/// Differences that are refined.
const CLOSELY: usize = 64;
/// A record this soon after another one is the same frame, reported twice.
const TWICE_NS: i64 = 300_000;
/// Records between corrections of the line.
const STEP: usize = 128;

/// A clock of a card.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CardClock {
    /// Length of a tick, picoseconds.
    pub tick_ps: u32,
    /// Bits after which it wraps, 1 to 64. No pause may last half of that.
    pub bits: u32,
}

impl CardClock {
    /// `timestamp_low` of an Intel 5300.
    pub const INTEL_5300: Self = Self { tick_ps: 1_000_000, bits: 32 };
    /// The FTM clock of an AX200 or AX210.
    pub const FTM: Self = Self { tick_ps: 3_125, bits: 32 };

    /// Ticks from one reading to the next, negative if the clock was set back.
    fn step(self, from: u64, to: u64) -> i64 {
        let unused = 64_u32.saturating_sub(self.bits.clamp(1, 64));
        (to.wrapping_sub(from) << unused).cast_signed() >> unused
    }
}

/// Why two logs were not paired.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// Too few records.
    #[error(
        "too few records without numbers to be paired by the cards' clocks: {receiver} and {transmitter}, {LEAST} of each are needed"
    )]
    TooFew {
        /// Of the receiver's log.
        receiver: usize,
        /// Of the transmitter's log.
        transmitter: usize,
    },
    /// No difference of the clocks stands out.
    #[error(
        "the logs do not belong together, as far as the cards' clocks tell (frames have no numbers): no difference between them stands out, the best is {ratio:.2} times as sharp as the next where {STANDS_OUT} is needed"
    )]
    Strangers {
        /// Sharpness of the best difference over that of the next.
        ratio: f64,
    },
    /// The exchanges are too regular.
    #[error(
        "exchanges came every {period_us:.0} us too regularly for the cards' clocks to tell one from the next, and frames have no numbers: send at varied times, or say how well the hosts' clocks agree"
    )]
    TooRegular {
        /// Their period, microseconds.
        period_us: f64,
    },
}

/// How the clocks of a link correspond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// `clock_tx - clock_rx` in the middle of the stretch that was aligned, microseconds.
    pub difference_us: f64,
    /// Its drift.
    pub drift_ppm: f64,
    /// Share of pairs of deviations that are within a bin of each other.
    pub sharpness: f64,
    /// Ratio of its sharpness to the next.
    pub ratio: f64,
    /// Whether the hosts' clocks were needed to decide.
    pub by_hosts: bool,
}

/// Records of one side by outcome: `handed = paired + unpaired + twice + ambiguous`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClockCounts {
    /// Records handed in.
    pub handed: usize,
    /// Records that found their partner.
    pub paired: usize,
    /// Records without one.
    pub unpaired: usize,
    /// Records that the card reported twice.
    pub twice: usize,
    /// Records with two partners that are equally near.
    pub ambiguous: usize,
}

#[derive(Clone, Debug)]
struct Side<T> {
    clock: CardClock,
    last: Option<u64>,
    /// Time of the last record.
    now_ns: Option<i64>,
    /// Unwrapped, since the first record, ns, rising.
    at_ns: Vec<i64>,
    host_us: Vec<Option<i64>>,
    items: Vec<Option<T>>,
    /// The first record after each step back of the clock.
    starts: Vec<usize>,
    counts: ClockCounts,
}

impl<T> Side<T> {
    fn new(clock: CardClock) -> Self {
        let (at_ns, host_us, items) = (Vec::new(), Vec::new(), Vec::new());
        let (last, now_ns, starts) = (None, None, vec![0]);
        Self { clock, last, now_ns, at_ns, host_us, items, starts, counts: ClockCounts::default() }
    }

    /// Time from the last record to one with this reading, ns; negative where the clock was set back.
    fn step_ns(&self, ticks: u64) -> i64 {
        let step = self.last.map_or(0, |last| self.clock.step(last, ticks));
        (i128::from(step) * i128::from(self.clock.tick_ps) / 1_000) as i64
    }

    fn push(&mut self, ticks: u64, host_us: Option<i64>, item: T) {
        self.counts.handed += 1;
        let step_ns = self.step_ns(ticks);
        if self.last.is_some() && (0..TWICE_NS).contains(&step_ns) {
            // Time continues from the record kept.
            self.counts.twice += 1;
            return;
        }
        self.last = Some(ticks);
        if step_ns < 0 {
            self.starts.push(self.at_ns.len());
        }
        let now_ns = self.now_ns.unwrap_or(0).saturating_add(step_ns.max(0));
        self.now_ns = Some(now_ns);
        self.at_ns.push(now_ns);
        self.host_us.push(host_us);
        self.items.push(Some(item));
    }

    /// Stretches between two settings of the clock, if long enough to be aligned.
    fn stretches(&self) -> Vec<std::ops::Range<usize>> {
        let ends = self.starts.iter().skip(1).copied().chain([self.at_ns.len()]);
        self.starts.iter().zip(ends).map(|(from, to)| *from..to).filter(|all| all.len() >= LEAST).collect()
    }

    /// Counts what found no partner.
    fn count_unpaired(&mut self) {
        let ClockCounts { handed, paired, twice, ambiguous, .. } = self.counts;
        self.counts.unpaired = handed.saturating_sub(paired + twice + ambiguous);
    }
}

/// Takes a pair out of both sides; none if a part of it is gone already. Its number is to be given.
fn taken<T>(receiver: &mut Side<T>, transmitter: &mut Side<T>, (i, j): (usize, usize)) -> Option<Pair<T>> {
    let (at_rx, at_tx) = (*receiver.at_ns.get(i)?, *transmitter.at_ns.get(j)?);
    let (own, other) = (receiver.items.get_mut(i)?, transmitter.items.get_mut(j)?);
    if own.is_none() || other.is_none() {
        return None;
    }
    let (own, other) = (own.take()?, other.take()?);
    receiver.counts.paired += 1;
    transmitter.counts.paired += 1;
    let (clock_rx_us, difference_ns) = (at_rx / 1_000, at_tx - at_rx);
    let clock_difference_us = (difference_ns + 500).div_euclid(1_000);
    Some(Pair { number: 0, receiver: own, transmitter: other, clock_difference_us, clock_rx_us })
}

/// Pairs the records of one link by clocks. Call [`handle`](Self::handle) for each record of the frames of one sender
/// in either log, in its log's order, then [`finish`](Self::finish), then [`poll_pair`](Self::poll_pair) until `None`.
/// No pair comes before the clocks' difference is known.
#[derive(Clone, Debug)]
pub struct ByClock<T> {
    receiver: Side<T>,
    transmitter: Side<T>,
    hosts_within_us: Option<i64>,
    ready: VecDeque<Pair<T>>,
}

impl<T> ByClock<T> {
    /// A link of two cards with these clocks.
    #[must_use]
    pub fn new(receiver: CardClock, transmitter: CardClock) -> Self {
        let (receiver, transmitter) = (Side::new(receiver), Side::new(transmitter));
        Self { receiver, transmitter, hosts_within_us: None, ready: VecDeque::new() }
    }

    /// The same with hosts' clocks that agree to within this many microseconds: only such pairs are considered.
    #[must_use]
    pub fn with_hosts_within(mut self, us: Option<i64>) -> Self {
        self.hosts_within_us = us;
        self
    }

    /// Takes a record of `side` with its card's clock and its host time, microseconds since the Unix epoch.
    pub fn handle(&mut self, side: LinkSide, ticks: u64, host_us: Option<i64>, item: T) {
        match side {
            LinkSide::Receiver => self.receiver.push(ticks, host_us, item),
            LinkSide::Transmitter => self.transmitter.push(ticks, host_us, item),
        }
    }

    /// The next pair, in the order of the receiver's clock; its number is its place among the pairs.
    pub fn poll_pair(&mut self) -> Option<Pair<T>> {
        self.ready.pop_front()
    }

    /// Outcomes of the records of `side`.
    #[must_use]
    pub fn counts(&self, side: LinkSide) -> ClockCounts {
        match side {
            LinkSide::Receiver => self.receiver.counts,
            LinkSide::Transmitter => self.transmitter.counts,
        }
    }

    /// Ends both logs and pairs their records. Of several stretches (a clock was set) it reports the longest that fits.
    ///
    /// # Errors
    /// Why nothing could be paired.
    pub fn finish(&mut self) -> Result<Fit, Refusal> {
        let (receiver, transmitter) = (self.receiver.stretches(), self.transmitter.stretches());
        let few = Refusal::TooFew { receiver: self.receiver.at_ns.len(), transmitter: self.transmitter.at_ns.len() };
        let (mut refusal, mut fits) = (few, Vec::new());
        for rx in &receiver {
            for tx in &transmitter {
                match self.align(rx.clone(), tx.clone()) {
                    Ok((fit, partners)) => fits.push((fit, rx.start, tx.start, partners)),
                    Err(why) => refusal = why,
                }
            }
        }
        // If two stretches claim one record, the one with more pairs gets it.
        fits.sort_by_key(|(.., partners)| std::cmp::Reverse(partners.pairs.len()));
        for (_, rx, tx, partners) in &fits {
            self.take(*rx, *tx, partners);
        }
        self.ready.make_contiguous().sort_by_key(|pair| pair.clock_rx_us);
        self.ready.iter_mut().zip(0..).for_each(|(pair, number)| pair.number = number);
        [&mut self.receiver, &mut self.transmitter].into_iter().for_each(Side::count_unpaired);
        fits.first().map(|(fit, ..)| *fit).ok_or(refusal)
    }

    fn align(&self, rx: std::ops::Range<usize>, tx: std::ops::Range<usize>) -> Result<(Fit, Partners), Refusal> {
        let (a, b) = (&self.receiver.at_ns[rx.clone()], &self.transmitter.at_ns[tx.clone()]);
        let (host_a, host_b) = (&self.receiver.host_us[rx], &self.transmitter.host_us[tx]);
        let agree = |i: usize, j: usize| match (self.hosts_within_us, host_a[i], host_b[j]) {
            (Some(within), Some(a), Some(b)) => (b - a).abs() <= within,
            _ => true,
        };
        let overlay = Overlay::new(a, b);
        let (line, fit) = overlay.stands_out(&[0.5, 0.2, 0.8], &agree)?;
        Ok((Fit { by_hosts: self.hosts_within_us.is_some(), ..fit }, overlay.follow(line)))
    }

    fn take(&mut self, rx: usize, tx: usize, partners: &Partners) {
        for &(i, j) in &partners.pairs {
            self.ready.extend(taken(&mut self.receiver, &mut self.transmitter, (rx + i, tx + j)));
        }
        // At least two of the receiver's records claim each of the transmitter's.
        self.transmitter.counts.ambiguous += partners.ambiguous;
        self.receiver.counts.ambiguous += 2 * partners.ambiguous;
    }
}

/// Which records of two stretches are partners, by their places in them.
struct Partners {
    pairs: Vec<(usize, usize)>,
    ambiguous: usize,
}

/// A difference of the clocks: `b = a + difference + drift (a - at)`, ns.
#[derive(Clone, Copy, Debug)]
struct Line {
    at: f64,
    difference: f64,
    drift: f64,
}

impl Line {
    fn on_other(&self, a: f64) -> f64 {
        a + self.difference + self.drift * (a - self.at)
    }
}

/// One difference of the clocks, judged.
#[derive(Clone, Copy, Debug)]
struct Judged {
    line: Line,
    sharpness: f64,
}

/// Two stretches of times, laid over each other.
struct Overlay<'a> {
    a: &'a [i64],
    b: &'a [i64],
    /// Half of the shortest exchange, ns.
    half_ns: f64,
}

/// Time between neighbours, sorted.
fn pauses(times: &[i64]) -> Vec<i64> {
    let mut pauses: Vec<i64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    pauses.sort_unstable();
    pauses
}

/// The value at a share of a sorted list; 0 of an empty one.
fn at_share(sorted: &[i64], share: f64) -> f64 {
    sorted.get((share * (sorted.len().max(1) - 1) as f64) as usize).map_or(0.0, |value| *value as f64)
}

impl<'a> Overlay<'a> {
    fn new(a: &'a [i64], b: &'a [i64]) -> Self {
        let shortest = |times: &[i64]| at_share(&pauses(times), 0.01);
        Self { a, b, half_ns: 0.5 * shortest(a).min(shortest(b)) }
    }

    /// The difference that stands out about one of these places, in shares of `a`.
    fn stands_out(&self, places: &[f64], agree: &dyn Fn(usize, usize) -> bool) -> Result<(Line, Fit), Refusal> {
        let mut refusal = None;
        for place in places {
            match self.best((place * self.a.len() as f64) as usize, agree) {
                Ok(found) => return Ok(found),
                Err(why) => refusal = refusal.or(Some(why)),
            }
        }
        Err(refusal.unwrap_or(Refusal::Strangers { ratio: 1.0 }))
    }

    /// Places in `a` around `middle` that are laid over `b`: as many as drift moves by half of the tolerance.
    fn stretch(&self, middle: usize) -> std::ops::Range<usize> {
        let near = (0.5 * self.half_ns / MAX_DRIFT) as i64;
        let at = self.a[middle];
        let from = self.a.partition_point(|t| *t < at - near).max(middle.saturating_sub(STRETCH / 2));
        from..self.a.partition_point(|t| *t <= at + near).min(middle + STRETCH / 2)
    }

    /// The best difference, if it stands out.
    fn best(&self, middle: usize, agree: &dyn Fn(usize, usize) -> bool) -> Result<(Line, Fit), Refusal> {
        let stretch = self.stretch(middle);
        let few = Refusal::TooFew { receiver: stretch.len(), transmitter: self.b.len() };
        if stretch.len() < LEAST {
            return Err(few);
        }
        let own = &self.a[stretch.clone()];
        // Any of these records may have lost its partner, but hardly all.
        let anchors = [stretch.len() / 2, stretch.len() / 3, 2 * stretch.len() / 3].map(|at| stretch.start + at);
        let mut room = Room::default();
        let mut judged: Vec<Judged> = Vec::new();
        for anchor in anchors {
            let met = (0..self.b.len()).filter(|j| agree(anchor, *j));
            judged.extend(met.filter_map(|j| self.judge(own, self.b[j] - self.a[anchor], 0, &mut room)));
        }
        let mut all: Vec<f64> = judged.iter().map(|judged| judged.sharpness).collect();
        judged.sort_by(|x, y| y.sharpness.total_cmp(&x.sharpness));
        judged.truncate(CLOSELY);
        let closely = |judged: &Judged| self.judge(own, judged.line.difference as i64, SLOPES, &mut room);
        let mut judged: Vec<Judged> = judged.iter().filter_map(closely).collect();
        judged.sort_by(|x, y| y.sharpness.total_cmp(&x.sharpness));
        let best = *judged.first().ok_or(Refusal::Strangers { ratio: 1.0 })?;
        let is_other = |judged: &&Judged| (judged.line.difference - best.line.difference).abs() > self.half_ns;
        let next = judged.iter().find(is_other).map_or(0.0, |judged| judged.sharpness).max(self.by_chance());
        let (median, deviation) = centre(&mut all);
        let ratio = best.sharpness / next;
        // A few differences give no statistics of the others.
        let is_far = all.len() < LEAST || best.sharpness > median + DEVIATIONS * deviation;
        if ratio < STANDS_OUT || !is_far {
            return Err(self.why_not(own, ratio));
        }
        let Line { difference, drift, .. } = best.line;
        let fit = Fit {
            difference_us: difference * 1e-3,
            drift_ppm: drift * 1e6,
            sharpness: best.sharpness,
            ratio,
            by_hosts: false,
        };
        Ok((best.line, fit))
    }

    /// Sharpness of a few deviations by chance, for lack of other differences: four times that of uniform deviations
    /// within half an exchange.
    fn by_chance(&self) -> f64 {
        4.0 * 3.0 * BIN_NS / (2.0 * self.half_ns)
    }

    /// Whether the exchanges are too regular: their pauses vary by less than the bins resolve.
    fn why_not(&self, own: &[i64], ratio: f64) -> Refusal {
        let pauses = pauses(own);
        let varies = at_share(&pauses, 0.9) - at_share(&pauses, 0.1);
        match varies < 6.0 * BIN_NS {
            true => Refusal::TooRegular { period_us: at_share(&pauses, 0.5) * 1e-3 },
            false => Refusal::Strangers { ratio },
        }
    }

    /// Sharpness of one difference, at the best of some slopes around the best fit; none if few records meet.
    fn judge(&self, own: &[i64], difference: i64, slopes: i32, room: &mut Room) -> Option<Judged> {
        self.deviations(own, difference, room);
        let n = room.x.len();
        if n < LEAST.max(2 * own.len() / 5) {
            return None;
        }
        let mean = |values: &[f64]| values.iter().sum::<f64>() / n as f64;
        let (at, off) = (mean(&room.x), mean(&room.y));
        room.x.iter_mut().for_each(|x| *x -= at);
        room.y.iter_mut().for_each(|y| *y -= off);
        let xx: f64 = room.x.iter().map(|x| x * x).sum();
        let slope = room.x.iter().zip(&room.y).map(|(x, y)| x * y).sum::<f64>() / xx.max(1.0);
        let left: f64 = room.x.iter().zip(&room.y).map(|(x, y)| (y - slope * x).powi(2)).sum();
        let error = (left / n as f64 / xx.max(1.0)).sqrt();
        let span = room.x.last()? - room.x.first()?;
        let step = BIN_NS / span.max(1.0);
        let most = slopes.min((2.5 * error / step).ceil() as i32);
        let mut best = (0.0, slope);
        for k in -most..=most {
            let slope = slope + f64::from(k) * step;
            let sharpness = room.sharpness(slope);
            if sharpness > best.0 {
                best = (sharpness, slope);
            }
        }
        let at = at + own[0] as f64;
        let line = Line { at, difference: difference as f64 + off, drift: best.1 };
        (best.1.abs() < 1.5 * MAX_DRIFT).then_some(Judged { line, sharpness: best.0 })
    }

    /// Deviations of the nearest records of the other side from a difference, by time since the first of `own`.
    fn deviations(&self, own: &[i64], difference: i64, room: &mut Room) {
        room.x.clear();
        room.y.clear();
        let first = own[0];
        let mut j = self.b.partition_point(|b| *b < first.saturating_add(difference));
        for a in own {
            let wanted = a.saturating_add(difference);
            while self.b.get(j).is_some_and(|b| *b < wanted) {
                j += 1;
            }
            let after = self.b.get(j).map(|b| b - wanted);
            let before = j.checked_sub(1).and_then(|j| self.b.get(j)).map(|b| b - wanted);
            let nearest = [before, after].into_iter().flatten().min_by_key(|off| off.abs());
            if let Some(off) = nearest.filter(|off| (off.abs() as f64) < self.half_ns) {
                room.x.push((a - first) as f64);
                room.y.push(off as f64);
            }
        }
    }

    /// Follows a line to both ends of the stretches and pairs what lies on it.
    fn follow(&self, line: Line) -> Partners {
        let middle = self.a.partition_point(|a| (*a as f64) < line.at);
        let mut wanted = vec![0.0; self.a.len()];
        let (before, after) = wanted.split_at_mut(middle);
        self.follow_way(line, self.a[middle..].iter().zip(after));
        self.follow_way(line, self.a[..middle].iter().rev().zip(before.iter_mut().rev()));
        self.pair_up(&wanted)
    }

    /// One way: where each record's partner should be, and the line at the end.
    fn follow_way<'t>(&self, line: Line, records: impl Iterator<Item = (&'t i64, &'t mut f64)>) -> Line {
        let mut follower = Follower::new(line);
        for (a, wanted) in records {
            let a = *a as f64;
            *wanted = follower.line.on_other(a);
            follower.note(a, nearest(self.b, *wanted, self.half_ns).map(|(_, off)| off));
        }
        follower.line
    }

    /// One to one.
    fn pair_up(&self, wanted: &[f64]) -> Partners {
        let mut claims = Claims::default();
        let mut partners = Partners { pairs: Vec::new(), ambiguous: 0 };
        for (i, at) in wanted.iter().enumerate() {
            if let Some((j, off)) = nearest(self.b, *at, self.half_ns) {
                partners.settle(claims.claim(i, j, off));
            }
        }
        partners.settle(claims.0);
        partners
    }
}

/// The record nearest to a time, and how far it is from it, ns; none if that is half of the shortest exchange.
fn nearest(b: &[i64], at: f64, half_ns: f64) -> Option<(usize, f64)> {
    let after = b.partition_point(|b| (*b as f64) < at);
    let places = [after.checked_sub(1), Some(after)].into_iter().flatten();
    let off = places.filter_map(|j| Some((j, *b.get(j)? as f64 - at)));
    off.min_by(|x, y| x.1.abs().total_cmp(&y.1.abs())).filter(|(_, off)| off.abs() < half_ns)
}

/// A line that follows its records: it is corrected by the median deviation of every few.
#[derive(Clone, Debug)]
struct Follower {
    line: Line,
    off: Vec<f64>,
    since: usize,
}

impl Follower {
    fn new(line: Line) -> Self {
        Self { line, off: Vec::new(), since: 0 }
    }

    /// Takes the deviation of the next record, if a partner is near. True if the line was corrected by it.
    fn note(&mut self, a: f64, off: Option<f64>) -> bool {
        self.off.extend(off);
        self.since += 1;
        if self.since < STEP {
            return false;
        }
        if self.off.len() >= STEP / 4 {
            let line = self.line;
            let (by, gone) = (centre(&mut self.off).0, a - line.at);
            // Half of a step that noise alone would make is noise.
            let drift = (line.drift + 0.25 * by / gone.abs().max(1.0) * gone.signum()).clamp(-MAX_DRIFT, MAX_DRIFT);
            self.line = Line { at: a, difference: line.difference + line.drift * gone + by, drift };
        }
        self.off.clear();
        self.since = 0;
        true
    }
}

/// A record of the receiver's that wants one of the transmitter's.
#[derive(Clone, Copy, Debug)]
struct Claim {
    i: usize,
    j: usize,
    off: f64,
    is_ambiguous: bool,
}

/// One to one, record by record: of two records that want one the nearer has it, unless they are equally near.
#[derive(Clone, Debug, Default)]
struct Claims(Option<Claim>);

impl Claims {
    /// Record `i` wants `j`, in the order of both. Gives the claim before it, if that is of another record.
    fn claim(&mut self, i: usize, j: usize, off: f64) -> Option<Claim> {
        let mut own = Claim { i, j, off, is_ambiguous: false };
        match self.0 {
            Some(before) if before.j == j => {
                let is_nearer = off.abs() < before.off.abs();
                let are_equal = (off.abs() - before.off.abs()).abs() < BIN_NS;
                own = if is_nearer { own } else { before };
                own.is_ambiguous = before.is_ambiguous || are_equal;
                self.0 = Some(own);
                None
            }
            _ => self.0.replace(own),
        }
    }
}

impl Partners {
    fn settle(&mut self, claim: Option<Claim>) {
        match claim {
            Some(Claim { i, j, is_ambiguous: false, .. }) => self.pairs.push((i, j)),
            Some(_) => self.ambiguous += 1,
            None => {}
        }
    }
}

/// Deviations of one difference, kept for the next one's.
struct Room {
    x: Vec<f64>,
    y: Vec<f64>,
    bins: Vec<u32>,
}

impl Default for Room {
    fn default() -> Self {
        Self { x: Vec::new(), y: Vec::new(), bins: vec![0; BINS] }
    }
}

impl Room {
    /// Share of pairs of deviations that are within a bin of each other, less those of a deviation with itself.
    fn sharpness(&mut self, slope: f64) -> f64 {
        self.bins.fill(0);
        let last = (BINS - 1) as f64;
        for (x, y) in self.x.iter().zip(&self.y) {
            let bin = ((y - slope * x) / BIN_NS + 0.5 * last).clamp(0.0, last);
            self.bins[bin as usize] += 1;
        }
        let own: u64 = self.bins.iter().map(|n| u64::from(*n) * u64::from(n.saturating_sub(1))).sum();
        let near: u64 = self.bins.windows(2).map(|two| u64::from(two[0]) * u64::from(two[1])).sum();
        (own + 2 * near) as f64 / (self.x.len() as f64).powi(2)
    }
}

/// Sharpness of some deviations.
fn sharpness_of(off: &[f64]) -> f64 {
    let mut room = Room::default();
    room.y.extend_from_slice(off);
    room.x.resize(off.len(), 0.0);
    room.sharpness(0.0)
}

/// Median, and the deviation of a normal distribution that spreads as much around it.
fn centre(values: &mut [f64]) -> (f64, f64) {
    let median = |values: &mut [f64]| crate::maths::upper_median(values).unwrap_or(0.0);
    let middle = median(values);
    let mut off: Vec<f64> = values.iter().map(|value| (value - middle).abs()).collect();
    (middle, 1.482_6 * median(&mut off))
}

#[cfg(test)]
mod tests;
