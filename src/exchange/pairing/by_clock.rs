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
//!    turn-arounds often have two. Host clocks are not used.
//! 2. The sharpest difference is taken if it stands out from all others. Otherwise the two logs do not belong together,
//!    or the exchanges are too regular to be distinguished.
//! 3. From there the line is followed to both ends, so that drift may change with temperature.
//! 4. Two records are paired if each is the other's nearest to the line, within half of the shortest exchange. Two that
//!    are equally near are both skipped.
//!
//! After a step back of a clock, the rest is aligned separately.
//!
//! [`ByClock`] takes whole logs, `Live` the same records as they come.

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
        "exchanges came every {period_us:.0} us too regularly for the cards' clocks to tell one from the next, and frames have no numbers: send at varied times"
    )]
    TooRegular {
        /// Their period, microseconds.
        period_us: f64,
    },
}

#[derive(Clone, Debug)]
struct Side<T> {
    /// Bits after which the card's clock wraps, 1 to 64.
    bits: u32,
    last: Option<u64>,
    /// Time of the last record.
    now_ns: Option<i64>,
    /// Unwrapped, since the first record, ns, rising.
    at_ns: Vec<i64>,
    items: Vec<Option<T>>,
    /// The first record after each step back of the clock.
    starts: Vec<usize>,
}

impl<T> Side<T> {
    fn new(bits: u32) -> Self {
        let (at_ns, items, starts) = (Vec::new(), Vec::new(), vec![0]);
        Self { bits, last: None, now_ns: None, at_ns, items, starts }
    }

    /// Time from the last record to one with this reading, ns; negative where the clock was set back.
    fn step_ns(&self, us: u64) -> i64 {
        let unused = 64 - self.bits;
        let step = |last: u64| (us.wrapping_sub(last) << unused).cast_signed() >> unused;
        self.last.map_or(0, step).saturating_mul(1_000)
    }

    fn push(&mut self, us: u64, item: T) {
        let step_ns = self.step_ns(us);
        if self.last.is_some() && (0..TWICE_NS).contains(&step_ns) {
            // Time continues from the record kept.
            return;
        }
        self.last = Some(us);
        if step_ns < 0 {
            self.starts.push(self.at_ns.len());
        }
        let now_ns = self.now_ns.unwrap_or(0).saturating_add(step_ns.max(0));
        self.now_ns = Some(now_ns);
        self.at_ns.push(now_ns);
        self.items.push(Some(item));
    }

    /// Stretches between two settings of the clock, if long enough to be aligned.
    fn stretches(&self) -> Vec<std::ops::Range<usize>> {
        let ends = self.starts.iter().skip(1).copied().chain([self.at_ns.len()]);
        self.starts.iter().zip(ends).map(|(from, to)| *from..to).filter(|all| all.len() >= LEAST).collect()
    }

    fn forget(&mut self, count: usize) {
        let count = count.min(self.at_ns.len());
        self.at_ns.drain(..count);
        self.items.drain(..count);
        self.starts.truncate(1);
    }

    fn len(&self) -> usize {
        self.at_ns.len()
    }
}

/// Takes a pair out of both sides; none if a part of it is gone already. Its number is to be given.
fn taken<T>([receiver, transmitter]: &mut [Side<T>; 2], (i, j): (usize, usize)) -> Option<Pair<T>> {
    let (at_rx, at_tx) = (*receiver.at_ns.get(i)?, *transmitter.at_ns.get(j)?);
    let (own, other) = (receiver.items.get_mut(i)?, transmitter.items.get_mut(j)?);
    if own.is_none() || other.is_none() {
        return None;
    }
    let (own, other) = (own.take()?, other.take()?);
    let (clock_rx_us, difference_ns) = (at_rx / 1_000, at_tx - at_rx);
    let clock_difference_us = (difference_ns + 500).div_euclid(1_000);
    Some(Pair { number: 0, receiver: own, transmitter: other, clock_difference_us, clock_rx_us })
}

/// Pairs the records of one link by clocks. Call [`handle`](Self::handle) for each record of the frames of one sender
/// in either log, in its log's order, then [`finish`](Self::finish), then [`poll_pair`](Self::poll_pair) until `None`.
/// No pair comes before the clocks' difference is known.
#[derive(Clone, Debug)]
pub struct ByClock<T> {
    /// By [`LinkSide`].
    sides: [Side<T>; 2],
    ready: VecDeque<Pair<T>>,
}

impl<T> ByClock<T> {
    /// A link of two cards whose clocks, microseconds, wrap after this many bits. No pause may last half of that.
    #[must_use]
    pub fn new(bits: u32) -> Self {
        Self { sides: [bits; 2].map(Side::new), ready: VecDeque::new() }
    }

    /// Takes a record of `side` with its card's clock.
    pub fn handle(&mut self, side: LinkSide, us: u64, item: T) {
        self.sides[side as usize].push(us, item);
    }

    /// The next pair, in the order of the receiver's clock; its number is its place among the pairs.
    pub fn poll_pair(&mut self) -> Option<Pair<T>> {
        self.ready.pop_front()
    }

    /// Records of each side; what a card reported twice is one.
    #[must_use]
    pub fn records(&self) -> [usize; 2] {
        self.sides.each_ref().map(Side::len)
    }

    /// Ends both logs and pairs their records. Gives the sharpness; of several stretches (a clock was set) that of the longest.
    ///
    /// # Errors
    /// Why nothing could be paired.
    pub fn finish(&mut self) -> Result<f64, Refusal> {
        let [receiver, transmitter] = self.sides.each_ref().map(Side::stretches);
        let few = Refusal::TooFew { receiver: self.sides[0].len(), transmitter: self.sides[1].len() };
        let (mut refusal, mut fits) = (few, Vec::new());
        for rx in &receiver {
            for tx in &transmitter {
                match self.align(rx.clone(), tx.clone()) {
                    Ok((sharpness, pairs)) => fits.push((sharpness, rx.start, tx.start, pairs)),
                    Err(why) => refusal = why,
                }
            }
        }
        // If two stretches claim one record, the one with more pairs gets it.
        fits.sort_by_key(|(.., pairs)| std::cmp::Reverse(pairs.len()));
        for (_, rx, tx, pairs) in &fits {
            self.ready.extend(pairs.iter().filter_map(|(i, j)| taken(&mut self.sides, (rx + i, tx + j))));
        }
        self.ready.make_contiguous().sort_by_key(|pair| pair.clock_rx_us);
        self.ready.iter_mut().zip(0..).for_each(|(pair, number)| pair.number = number);
        fits.first().map(|(sharpness, ..)| *sharpness).ok_or(refusal)
    }

    /// How sharp the difference of two stretches' clocks is, and which of their records are partners, by their places in them.
    fn align(&self, rx: std::ops::Range<usize>, tx: std::ops::Range<usize>) -> Result<(f64, Partners), Refusal> {
        let overlay = Overlay::new(&self.sides[0].at_ns[rx], &self.sides[1].at_ns[tx]);
        let Judged { line, sharpness } = overlay.stands_out(&[0.5, 0.2, 0.8])?;
        Ok((sharpness, overlay.follow(line)))
    }
}

/// Pairs of places in two stretches.
type Partners = Vec<(usize, usize)>;

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
    fn stands_out(&self, places: &[f64]) -> Result<Judged, Refusal> {
        let mut refusal = None;
        for place in places {
            match self.best((place * self.a.len() as f64) as usize) {
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
    fn best(&self, middle: usize) -> Result<Judged, Refusal> {
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
            judged.extend(self.b.iter().filter_map(|b| self.judge(own, b - self.a[anchor], 0, &mut room)));
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
        Ok(best)
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
        let claim = |(i, at): (usize, &f64)| {
            let (j, off) = nearest(self.b, *at, self.half_ns)?;
            claims.claim(i, j, off)
        };
        let mut settled: Vec<Claim> = wanted.iter().enumerate().filter_map(claim).collect();
        settled.extend(claims.0);
        settled.iter().filter(|claim| !claim.is_ambiguous).map(|claim| (claim.i, claim.j)).collect()
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

/// Limit of records kept of a side before the clocks are aligned.
const WINDOW: usize = 2 * STRETCH;
/// Limit of records of a side that wait for the other side.
const BACKLOG: usize = 2 * WINDOW;
/// After a longer pause, the clocks are aligned again, because a clock that was set forward looks like a pause.
const PAUSE_NS: i64 = 30_000_000_000;
/// A new line continues the one before if it differs by less than this, plus a change of drift.
const SAME_NS: f64 = 500_000.0;
const MAX_CHANGE: f64 = 5e-6;
/// The line is checked after this many deviations, ...
const LOOK: usize = 24;
/// ... and given up after this many records with fewer deviations.
const LONGEST_LOOK: usize = 512;

/// Pairing by clocks while records arrive: a window of each side; each pair is returned once.
///
/// Records are kept until the clocks are aligned; alignment is tried repeatedly. From then on, the line is followed as in a
/// whole log. A pair is returned once no later record can claim a part of it: after the next record of each side. A
/// clock that was set back, a long pause, or deviations that leave the line end it; later records are aligned again. If a
/// clock was set forward by less than `PAUSE_NS`, up to `LOOK` pairs may be wrong.
///
/// Call [`handle`](Self::handle) for each record of one sender's frames on
/// either side, in its card's order; after each, call [`poll_pair`](Self::poll_pair) until `None`.
#[derive(Clone, Debug)]
pub(crate) struct Live<T> {
    /// By [`LinkSide`].
    sides: [Side<T>; 2],
    lock: Option<Lock>,
    /// Number of records, of the side with fewer, at which alignment is next tried.
    try_at: usize,
    refusal: Option<Refusal>,
    /// The previous line.
    before: Option<Line>,
    restarts: u32,
    number: u32,
    ready: VecDeque<Pair<T>>,
}

/// State while the clocks are aligned.
#[derive(Clone, Debug)]
struct Lock {
    /// Of the alignment.
    sharpness: f64,
    half_ns: f64,
    follower: Follower,
    claims: Claims,
    /// The receiver's first undecided record.
    next: usize,
    /// The last pair, by the indices of its records.
    last: Option<(usize, usize)>,
    /// Deviations since the last check, and number of records since then.
    off: Vec<f64>,
    looked: usize,
}

impl Lock {
    fn new(overlay: &Overlay<'_>, Judged { line, sharpness }: Judged) -> Self {
        let middle = overlay.a.partition_point(|a| (*a as f64) < line.at);
        let mut wanted = vec![0.0; middle];
        let start = overlay.follow_way(line, overlay.a.iter().take(middle).rev().zip(wanted.iter_mut().rev()));
        // Earlier records have no partner: the transmitter's records begin later, or it was silent.
        let first = overlay.b.first().map_or(0.0, |b| *b as f64) - overlay.half_ns;
        let next = overlay.a.partition_point(|a| start.on_other(*a as f64) < first);
        let (follower, claims, off) = (Follower::new(start), Claims::default(), Vec::new());
        Self { sharpness, half_ns: overlay.half_ns, follower, claims, next, last: None, off, looked: 0 }
    }

    /// Notes the deviation of a record. False if the records have left the line.
    fn look(&mut self, off: Option<f64>) -> bool {
        self.off.extend(off);
        self.looked += 1;
        if self.off.len() < LOOK {
            return self.looked < LONGEST_LOOK;
        }
        let sharpness = sharpness_of(&self.off);
        let middle = centre(&mut self.off).0;
        (self.looked, self.off) = (0, Vec::new());
        middle.abs() < 0.1 * self.half_ns && sharpness > self.sharpness / 4.0
    }

    /// Shifts the indices after the sides have forgotten records.
    fn forget(&mut self, [receiver, transmitter]: [usize; 2]) {
        self.next = self.next.saturating_sub(receiver);
        let moved = |i: usize, j: usize| Some((i.checked_sub(receiver)?, j.checked_sub(transmitter)?));
        self.last = self.last.and_then(|(i, j)| moved(i, j));
        self.claims.0 = self.claims.0.and_then(|claim| {
            let (i, j) = moved(claim.i, claim.j)?;
            Some(Claim { i, j, ..claim })
        });
    }

    /// Makes a pair of a decided claim, unless it is ambiguous.
    fn settle<T>(&mut self, claim: Option<Claim>, sides: &mut [Side<T>; 2], number: &mut u32) -> Option<Pair<T>> {
        let claim = claim.filter(|claim| !claim.is_ambiguous)?;
        let pair = taken(sides, (claim.i, claim.j))?;
        self.last = Some((claim.i, claim.j));
        *number = number.wrapping_add(1);
        Some(Pair { number: *number, ..pair })
    }
}

impl<T> Live<T> {
    /// A link between two cards whose clocks, microseconds, wrap after 32 bits.
    pub(crate) fn new() -> Self {
        Self {
            sides: [32; 2].map(Side::new),
            lock: None,
            try_at: 2 * LEAST,
            refusal: None,
            before: None,
            restarts: 0,
            number: 0,
            ready: VecDeque::new(),
        }
    }

    /// Takes a record of `side` with its card's clock.
    pub(crate) fn handle(&mut self, side: LinkSide, us: u64, item: T) {
        let own = side as usize;
        if !(0..=PAUSE_NS).contains(&self.sides[own].step_ns(us)) {
            self.part(own);
        }
        self.sides[own].push(us, item);
        if self.lock.is_none() {
            self.seek();
        }
        self.advance(false);
        self.keep();
    }

    /// The next pair, in the order of the receiver's records; pair numbers increase.
    pub(crate) fn poll_pair(&mut self) -> Option<Pair<T>> {
        self.ready.pop_front()
    }

    /// How often the clocks did not continue the previous line: card restarts.
    pub(crate) fn restarts(&self) -> u32 {
        self.restarts
    }

    /// Why alignment failed, while there are no pairs.
    pub(crate) fn refusal(&self) -> Option<Refusal> {
        self.refusal.filter(|_| self.lock.is_none())
    }

    /// Ends both sides and decides what remains.
    pub(crate) fn finish(&mut self) {
        if self.lock.is_none() {
            self.try_at = LEAST;
            self.seek();
        }
        self.advance(true);
    }

    /// Ends the line: the card of `side` was restarted, or paused for long. The other side keeps its records after the last
    /// pair, because they may pair with later ones.
    fn part(&mut self, side: usize) {
        self.advance(true);
        let mut counts = self.unlock();
        counts[side] = self.sides[side].len();
        self.forget(counts);
    }

    fn forget(&mut self, counts: [usize; 2]) {
        self.sides.iter_mut().zip(counts).for_each(|(side, count)| side.forget(count));
    }

    /// Gives up the alignment. Returns, for each side, the number of records up to the last pair or, without a pair, the number
    /// tried.
    fn unlock(&mut self) -> [usize; 2] {
        self.try_at = 2 * LEAST;
        let Some(lock) = self.lock.take() else { return [0, 0] };
        self.before = Some(lock.follower.line);
        lock.last.map_or([lock.next, 0], |(i, j)| [i + 1, j + 1])
    }

    /// Tries to align the clocks, once there are enough new records and before a side forgets some.
    fn seek(&mut self) {
        let [own, other] = self.sides.each_ref().map(Side::len);
        let (count, most) = (own.min(other), own.max(other));
        if count < self.try_at && (count < LEAST || most < WINDOW) {
            return;
        }
        let overlay = Overlay::new(&self.sides[0].at_ns, &self.sides[1].at_ns);
        match overlay.stands_out(&[0.5]) {
            Ok(judged) => {
                let line = judged.line;
                let goes_on = |before: Line| {
                    let off = line.difference - (before.difference + before.drift * (line.at - before.at));
                    off.abs() < SAME_NS + MAX_CHANGE * (line.at - before.at).abs()
                };
                self.restarts += u32::from(!self.before.is_none_or(goes_on));
                self.lock = Some(Lock::new(&overlay, judged));
            }
            Err(why) => self.refusal = Some(why),
        }
        self.try_at = count + count.div_ceil(2);
    }

    /// Decides all records that can be decided; `at_end`, all that remain.
    fn advance(&mut self, at_end: bool) {
        let Some(lock) = &mut self.lock else { return };
        let sides = &mut self.sides;
        let [own_to, other_to] = sides.each_ref().map(|side| side.at_ns.last().copied().unwrap_or_default() as f64);
        let mut is_on = true;
        while let Some(a) = sides[0].at_ns.get(lock.next).map(|a| *a as f64) {
            let wanted = lock.follower.line.on_other(a);
            let is_past = other_to >= wanted + lock.half_ns;
            if !is_on || !(is_past || at_end) {
                break;
            }
            let near = nearest(&sides[1].at_ns, wanted, lock.half_ns);
            let ended = match near {
                Some((j, off)) => lock.claims.claim(lock.next, j, off),
                None => lock.claims.0.take(),
            };
            self.ready.extend(lock.settle(ended, sides, &mut self.number));
            let off = near.map(|(_, off)| off);
            lock.next += 1;
            is_on = lock.look(off);
            if lock.follower.note(a, off) {
                lock.half_ns = Overlay::new(&sides[0].at_ns, &sides[1].at_ns).half_ns;
            }
        }
        let is_safe = |claim: &Claim| {
            let at = sides[1].at_ns.get(claim.j).map_or(0.0, |b| *b as f64);
            at_end || lock.follower.line.on_other(own_to) > at + lock.half_ns
        };
        if lock.claims.0.as_ref().is_some_and(is_safe) {
            let claim = lock.claims.0.take();
            self.ready.extend(lock.settle(claim, sides, &mut self.number));
        }
        if !is_on {
            let counts = self.unlock();
            self.forget(counts);
        }
    }

    /// Forgets records that no pair can need any more.
    fn keep(&mut self) {
        let lens = self.sides.each_ref().map(Side::len);
        let Some(lock) = &mut self.lock else {
            return self.forget(lens.map(|len| if len >= WINDOW { STRETCH } else { 0 }));
        };
        // Decided records are kept, because their pauses show the length of an exchange.
        let mut gone = [0, 0];
        if lock.next > WINDOW {
            gone[0] = lock.next - STRETCH;
            let from = lock.follower.line.on_other(self.sides[0].at_ns.get(gone[0]).map_or(0.0, |a| *a as f64));
            gone[1] = self.sides[1].at_ns.partition_point(|b| (*b as f64) < from);
        } else if lens.iter().any(|len| *len > BACKLOG + WINDOW) {
            gone = lens.map(|len| len.saturating_sub(BACKLOG));
        }
        if gone != [0, 0] {
            lock.forget(gone);
            self.forget(gone);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// xorshift: the same on every run.
    struct Random(u64);

    impl Random {
        fn new(seed: u64) -> Self {
            Self((seed + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15))
        }

        /// Between two values.
        fn between(&mut self, from: f64, to: f64) -> f64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            from + (to - from) * (self.0 >> 11) as f64 / (1_u64 << 53) as f64
        }

        fn chance(&mut self, of: f64) -> bool {
            self.between(0.0, 1.0) < of
        }
    }

    /// What is exchanged, and how it is heard.
    #[derive(Clone, Copy)]
    struct Link {
        exchanges: usize,
        /// Mean pause, and how far it varies to both sides, us.
        pause_us: (f64, f64),
        lost: f64,
        drift: f64,
        seed: u64,
    }

    const USUAL: Link = Link { exchanges: 1_500, pause_us: (10_000.0, 250.0), lost: 0.0, drift: 15e-6, seed: 7 };

    /// Records of the two logs: ticks, and the exchange that they are of.
    type Heard = [Vec<(u64, usize)>; 2];

    impl Link {
        /// Frames at the ticks of a timer that come late by up to `pause_us.1`; answers after some tens of us, a tenth of them later.
        fn heard(self) -> Heard {
            let mut random = Random::new(self.seed);
            let offsets = [random.between(0.0, 4e9), random.between(0.0, 4e9)];
            let mut heard = [Vec::new(), Vec::new()];
            for k in 0..self.exchanges {
                let sent = k as f64 * self.pause_us.0 + random.between(-self.pause_us.1, self.pause_us.1);
                let much = if random.chance(0.1) { 250.0 } else { 30.0 };
                let late = random.between(0.0, much);
                for (side, at) in [(0, sent + 300.0 + late), (1, sent)] {
                    if !random.chance(self.lost) {
                        let rate = if side == 1 { 1.0 + self.drift } else { 1.0 };
                        heard[side].push((ticks((at + 1e6) * rate + offsets[side]), k));
                    }
                }
            }
            heard
        }
    }

    /// A time as a card's clock shows it.
    fn ticks(us: f64) -> u64 {
        us as u64 & u64::from(u32::MAX)
    }

    /// Pairs found, by the exchanges of their two records.
    fn pair(heard: &Heard) -> Result<Vec<(usize, usize)>, Refusal> {
        let mut machine = ByClock::new(32);
        for (side, records) in [LinkSide::Receiver, LinkSide::Transmitter].into_iter().zip(heard) {
            records.iter().for_each(|(ticks, exchange)| machine.handle(side, *ticks, *exchange));
        }
        machine.finish()?;
        let pairs: Vec<Pair<usize>> = std::iter::from_fn(|| machine.poll_pair()).collect();
        assert!(pairs.iter().zip(0..).all(|(pair, number)| pair.number == number));
        assert!(pairs.windows(2).all(|two| two[0].clock_rx_us < two[1].clock_rx_us));
        Ok(pairs.into_iter().map(|pair| (pair.receiver, pair.transmitter)).collect())
    }

    fn wrong(pairs: &[(usize, usize)]) -> usize {
        pairs.iter().filter(|(a, b)| a != b).count()
    }

    /// Exchanges that are in both logs.
    fn common(heard: &Heard) -> usize {
        heard[0].iter().filter(|(_, k)| heard[1].iter().any(|(_, other)| other == k)).count()
    }

    #[test]
    fn exchanges_are_found_whatever_the_clocks_and_however_many_are_lost() {
        let wide = (20_000.0, 8_000.0);
        for (name, link) in [
            ("usual", USUAL),
            ("30 % lost on each side", Link { lost: 0.3, ..USUAL }),
            ("100 ppm", Link { drift: 100e-6, ..USUAL }),
            ("-100 ppm, 30 % lost", Link { drift: -100e-6, lost: 0.3, ..USUAL }),
            ("irregular, few", Link { exchanges: 80, pause_us: wide, ..USUAL }),
            ("irregular, many lost", Link { exchanges: 400, pause_us: wide, lost: 0.3, drift: 60e-6, ..USUAL }),
            ("4 ms", Link { pause_us: (4_000.0, 150.0), exchanges: 900, ..USUAL }),
        ] {
            for seed in 0..3 {
                let link = Link { seed, ..link };
                let heard = link.heard();
                let pairs = pair(&heard).unwrap_or_else(|why| panic!("{name}, seed {seed}: {why}"));
                let (found, wrong, common) = (pairs.len(), wrong(&pairs), common(&heard));
                assert!(
                    found as f64 >= 0.995 * common as f64 && wrong == 0,
                    "{name}: {found} of {common}, {wrong} wrong"
                );
            }
        }
    }

    #[test]
    fn logs_of_two_runs_are_refused_and_so_is_a_rate_without_any_variation() {
        for seed in 0..4 {
            let [own, _] = Link { seed, ..USUAL }.heard();
            let [_, other] = Link { seed: seed + 100, ..USUAL }.heard();
            assert!(matches!(pair(&[own, other]), Err(Refusal::Strangers { .. })), "seed {seed}");
            let regular = Link { pause_us: (10_000.0, 2.0), seed, ..USUAL };
            let Err(Refusal::TooRegular { period_us }) = pair(&regular.heard()) else { panic!("seed {seed}") };
            assert!((period_us - 10_000.0).abs() < 30.0);
        }
        let few = Link { exchanges: 20, ..USUAL };
        assert_eq!(pair(&few.heard()), Err(Refusal::TooFew { receiver: 20, transmitter: 20 }));
    }

    #[test]
    fn a_set_clock_splits_a_log_and_loses_nothing_else() {
        let mut heard = USUAL.heard();
        // The transmitter's card restarts in the middle.
        let at = heard[1].len() / 2;
        let from = heard[1][at].0 - 5_000;
        heard[1][at..].iter_mut().for_each(|(ticks, _)| *ticks = ticks.wrapping_sub(from) & 0xffff_ffff);
        let pairs = pair(&heard).unwrap();
        assert!(pairs.len() >= USUAL.exchanges - 8 && wrong(&pairs) == 0, "{}", pairs.len());
    }

    #[test]
    fn frames_of_others_and_frames_that_are_reported_twice_take_no_partner() {
        let heard = USUAL.heard();
        let mut random = Random::new(1);
        // The transmitter also hears what the receiver sends to a third robot, some 5 ms after each; some records come twice.
        let mut tx: Vec<(u64, usize)> = Vec::new();
        for &(ticks, k) in &heard[1] {
            tx.push((ticks, k));
            if k % 10 == 0 {
                tx.push((ticks + 40, usize::MAX));
            }
            if random.chance(0.6) {
                tx.push((ticks + 5_000 + random.between(0.0, 200.0) as u64, usize::MAX));
            }
        }
        let pairs = pair(&[heard[0].clone(), tx]).unwrap();
        assert!(pairs.len() as f64 >= 0.995 * USUAL.exchanges as f64 && wrong(&pairs) == 0, "{}", pairs.len());
    }

    #[test]
    fn a_log_that_covers_a_part_of_the_other_is_paired_there() {
        let heard = USUAL.heard();
        let part = heard[1][900..].to_vec();
        let pairs = pair(&[heard[0].clone(), part]).unwrap();
        assert_eq!((pairs.len(), wrong(&pairs)), (600, 0));
    }

    /// The same as records come, the transmitter's `late` of them behind: pairs, and wrong ones.
    fn pair_live(heard: &Heard, late: usize) -> (Vec<(usize, usize)>, Live<usize>) {
        let mut machine = Live::new();
        let [rx, tx] = heard;
        let mut pairs = Vec::new();
        let mut records = |machine: &mut Live<usize>, side, record: Option<&(u64, usize)>| {
            record.into_iter().for_each(|(ticks, exchange)| machine.handle(side, *ticks, *exchange));
            pairs.extend(std::iter::from_fn(|| machine.poll_pair()).map(|pair| (pair.receiver, pair.transmitter)));
        };
        let (mut i, mut j) = (0, 0);
        while i < rx.len() || j < tx.len() {
            let own_is_next = rx.get(i).is_some_and(|(_, k)| tx.get(j).is_none_or(|(_, other)| *k < other + late));
            if own_is_next {
                records(&mut machine, LinkSide::Receiver, rx.get(i));
                i += 1;
            } else {
                records(&mut machine, LinkSide::Transmitter, tx.get(j));
                j += 1;
            }
        }
        machine.finish();
        records(&mut machine, LinkSide::Receiver, None);
        (pairs, machine)
    }

    /// Number of records in memory, of the side with more.
    fn kept(machine: &Live<usize>) -> usize {
        machine.sides[0].len().max(machine.sides[1].len())
    }

    #[test]
    fn records_are_paired_as_they_come_as_in_whole_logs() {
        let wide = (20_000.0, 8_000.0);
        for (name, link) in [
            ("usual", USUAL),
            ("30 % lost on each side", Link { lost: 0.3, ..USUAL }),
            ("100 ppm, 30 % lost, many", Link { drift: 100e-6, lost: 0.3, exchanges: 9_000, ..USUAL }),
            ("irregular, many lost", Link { exchanges: 400, pause_us: wide, lost: 0.3, drift: 60e-6, ..USUAL }),
        ] {
            for (seed, late) in [(0, 0), (1, 1), (2, 150)] {
                let link = Link { seed, ..link };
                let heard = link.heard();
                let whole = pair(&heard).unwrap();
                let (live, _) = pair_live(&heard, late);
                assert_eq!(live, whole, "{name}, seed {seed}");
            }
        }
    }

    #[test]
    fn a_pair_comes_with_the_next_exchange_once_the_clocks_are_understood() {
        let [rx, tx] = USUAL.heard();
        let mut machine = Live::new();
        let (mut first, mut newest) = (None, 0);
        for ((a, i), (b, j)) in rx.iter().zip(&tx) {
            machine.handle(LinkSide::Receiver, *a, *i);
            machine.handle(LinkSide::Transmitter, *b, *j);
            newest = std::iter::from_fn(|| machine.poll_pair()).map(|pair| pair.receiver).last().unwrap_or(newest);
            first = first.or((newest > 0).then_some(*i));
            assert!(first.is_none() || newest + 1 >= *i, "{newest} at {i}");
        }
        assert!(first.is_some_and(|first| first < 200), "{first:?}");
        assert!(kept(&machine) <= WINDOW_KEPT);
    }

    /// Records of a side that may be in memory while clocks are understood and no side is behind.
    const WINDOW_KEPT: usize = 2 * STRETCH + 2;

    #[test]
    fn either_card_may_restart_while_records_come_and_clocks_may_jump() {
        for (side, jump_us) in [(1, None), (0, None), (1, Some(7_003_000)), (0, Some(200_000_000))] {
            let mut heard = Link { exchanges: 3_000, ..USUAL }.heard();
            let at = heard[side].len() / 2;
            let from = heard[side][at].0 - 5_000;
            for (ticks, _) in &mut heard[side][at..] {
                *ticks = jump_us.map_or(ticks.wrapping_sub(from), |us| *ticks + us) & 0xffff_ffff;
            }
            let (pairs, machine) = pair_live(&heard, 0);
            assert_eq!(machine.restarts(), 1, "{side} {jump_us:?}");
            let wrong = wrong(&pairs);
            let most = if jump_us == Some(7_003_000) { 24 } else { 0 };
            assert!(pairs.len() >= 2_900 && wrong <= most, "{side} {jump_us:?}: {} pairs, {wrong} wrong", pairs.len());
        }
    }

    #[test]
    fn records_of_two_runs_give_no_pairs_as_they_come_and_memory_is_bounded() {
        let [own, _] = Link { exchanges: 5_000, ..USUAL }.heard();
        let [_, other] = Link { exchanges: 5_000, seed: 107, ..USUAL }.heard();
        let (pairs, machine) = pair_live(&[own, other], 0);
        assert!(pairs.is_empty(), "{}", pairs.len());
        assert!(matches!(machine.refusal(), Some(Refusal::Strangers { .. })), "{:?}", machine.refusal());
        assert!(kept(&machine) <= WINDOW_KEPT);
        // A feed that stops does not fill the memory either, and goes on where it comes back.
        let link = Link { exchanges: 9_000, ..USUAL };
        let [rx, tx] = link.heard();
        let stops: Vec<(u64, usize)> = tx.iter().filter(|(_, k)| !(2_000..2_900).contains(k)).copied().collect();
        let (pairs, machine) = pair_live(&[rx, stops], 0);
        assert!(pairs.len() >= 8_000 && wrong(&pairs) == 0, "{} {}", pairs.len(), wrong(&pairs));
        assert!(kept(&machine) <= WINDOW_KEPT, "{}", kept(&machine));
    }
}
