//! One link: the pairs of its frames as coherent round trips, kept until a bearing is estimated.

use super::bearing::{PairCounts, Phase};
use super::intake::FrameHeard;
use super::options::Options;
use crate::exchange::assign::{Kinship, LEAST_PAUSES, Reciprocal, Reciprocity, kinship};
use crate::exchange::pairing::{LinkSide, Pair, Pairing, SideCounts};
use crate::maths::upper_median_ord;
use crate::motion::pose::Trajectory;
use crate::signal::cfo::{Heard, TurnAround, at_centre, round_trips_at_centre};
use driver_iface::Mac;
use num_complex::{Complex32, Complex64};

/// Most pairs kept of a link. At this number every second pair is dropped, so memory is bounded for a log of any length.
/// At 100 exchanges a second it is over a minute within one trajectory, longer than odometry stays coherent.
const MAX_ROWS: usize = 8_192;

/// Pairs of a log that become rows together: enough for vector code, few enough for a core's cache.
const ROWS_AT_ONCE: usize = 512;

/// Leaves the first of every two.
fn every_second<T>(list: &mut Vec<T>) {
    let mut index = 0;
    list.retain(|_| {
        index += 1;
        index % 2 == 1
    });
}

/// A link after its logs were read.
#[derive(Clone, Debug)]
pub struct Link {
    /// The transmitter's MAC.
    pub mac: Mac,
    pairing: Pairing<FrameHeard>,
    /// Pairs that are not rows yet: many become rows together, all links in parallel.
    pending: Vec<Pair<FrameHeard>>,
    /// How many wait at most.
    most_pending: usize,
    rows: Vec<PairRow>,
    /// Both sides' CSI of each row: forward, backward.
    frames: Vec<[Heard; 2]>,
    silent: usize,
    span_us: Option<(i64, i64)>,
    outside: usize,
    /// Those that are inside by the transmitter's host time.
    partner_inside: usize,
    first_us: Option<i64>,
    /// One in this many pairs is kept.
    stride: usize,
    /// Pairs seen by that thinning.
    offered: usize,
    thinned: usize,
}

/// One pair.
#[derive(Clone, Copy, Debug)]
pub(super) struct PairRow {
    /// The round trip at the channel centre.
    pub z: Complex64,
    /// Time on the receiver's card, microseconds, unwrapped.
    pub clock_rx_us: i64,
    /// The transmitter's card clock less the receiver's, microseconds, from the pairing.
    pub difference_us: i64,
    /// The fraction of a finer clock, microseconds.
    pub finer_us: f64,
    /// Host times of receiver and transmitter, microseconds since the Unix epoch.
    pub host_us: Option<i64>,
    pub partner_host_us: Option<i64>,
    /// Number of the frame among those of the link in the receiver's log.
    pub row: u32,
    /// Phase of the receiver's CSI alone, radians; 0 unless requested.
    pub one_way_rad: f64,
}

impl Link {
    /// An empty link to `mac` that makes rows as soon as pairs come. Pairs outside `span_us` of the receiver's host
    /// time are only counted.
    #[must_use]
    pub(crate) fn new(mac: Mac, span_us: Option<(i64, i64)>) -> Self {
        Self {
            mac,
            pairing: Pairing::new(4_096),
            pending: Vec::new(),
            most_pending: 1,
            rows: Vec::new(),
            frames: Vec::new(),
            silent: 0,
            span_us,
            outside: 0,
            partner_inside: 0,
            first_us: None,
            stride: 1,
            offered: 0,
            thinned: 0,
        }
    }

    /// The same for logs that are read to their ends: rows are made when many pairs wait, and by [`Self::finish`].
    #[must_use]
    pub(super) fn of_logs(self) -> Self {
        Self { most_pending: ROWS_AT_ONCE, ..self }
    }

    /// Which side should be read next.
    #[must_use]
    pub(crate) fn behind(&self) -> LinkSide {
        self.pairing.behind()
    }

    /// Records of one side by outcome.
    #[must_use]
    pub fn counts(&self, side: LinkSide) -> SideCounts {
        self.pairing.counts(side)
    }

    /// Pairs so far.
    #[must_use]
    pub fn pairs(&self) -> usize {
        self.rows.len() + self.outside + self.thinned
    }

    /// Pairs skipped evenly so far, because the link has more than are kept.
    #[must_use]
    pub fn thinned(&self) -> usize {
        self.thinned
    }

    /// The pairs kept.
    pub(super) fn rows(&self) -> &[PairRow] {
        &self.rows
    }

    /// Both sides' CSI of each: forward, backward.
    pub(super) fn frames(&self) -> &[[Heard; 2]] {
        &self.frames
    }

    /// Pairs outside the usable span of the receiver's host time.
    pub(super) fn outside(&self) -> usize {
        self.outside
    }

    /// Whether more than `share` of the pairs are outside by the receiver's host time, but nearly all inside by the
    /// transmitter's.
    pub(super) fn other_fits(&self, share: f64) -> bool {
        let inside = |row: &&PairRow| {
            let within = |at| self.span_us.is_none_or(|(from, to)| (from..=to).contains(&at));
            row.partner_host_us.is_some_and(within)
        };
        // Each kept row stands for the skipped ones too.
        let stands_for = (self.rows.len() + self.thinned) as f64 / self.rows.len().max(1) as f64;
        let partner = stands_for * self.rows.iter().filter(inside).count() as f64 + self.partner_inside as f64;
        let all = self.pairs() as f64;
        self.outside as f64 > share * all && partner >= (1.0 - share) * all
    }

    /// Pairs outside the receiver's trajectory by the transmitter's host times, without the evenly skipped ones; none
    /// without such times.
    pub(super) fn outside_by_transmitter(&self, receiver: &Trajectory, options: &Options) -> Option<usize> {
        let (start_s, end_s) = receiver.span_s();
        let inside = |us: i64| (start_s..=end_s).contains(&(us as f64 * 1e-6 + options.clock_offset_s));
        let outside = self.rows.iter().filter(|row| !row.partner_host_us.is_some_and(inside)).count();
        let is_known = self.partner_inside > 0 || self.rows.iter().any(|row| row.partner_host_us.is_some());
        is_known.then_some(outside + self.outside - self.partner_inside)
    }

    /// The receiver's host time of the first pair, microseconds since the Unix epoch.
    pub(super) fn first_us(&self) -> Option<i64> {
        self.first_us
    }

    /// The dropped pairs, by reason.
    pub(super) fn counts_before(&self) -> PairCounts {
        PairCounts {
            formed: self.pairs() + self.silent,
            silent: self.silent,
            no_pose: self.outside,
            thinned: self.thinned,
            ..PairCounts::default()
        }
    }

    /// Takes a frame of one side.
    pub(crate) fn handle(&mut self, side: LinkSide, heard: FrameHeard, options: &Options) {
        self.pairing.handle(side, heard.number, heard.timestamp_low, heard);
        self.take_pairs(options);
    }

    fn take_pairs(&mut self, options: &Options) {
        while let Some(pair) = self.pairing.poll_pair() {
            self.pending.push(pair);
        }
        if self.pending.len() >= self.most_pending {
            self.settle(options);
        }
    }

    /// Makes rows of the waiting pairs.
    fn settle(&mut self, options: &Options) {
        let mut pending = std::mem::take(&mut self.pending);
        let heard: Vec<[&Heard; 2]> =
            pending.iter().map(|pair| [pair.transmitter.heard(), pair.receiver.heard()]).collect();
        let centres = round_trips_at_centre(&heard, &options.channel.subcarriers(), options.tier);
        let more = pending.len().min(MAX_ROWS - self.rows.len());
        self.rows.reserve(more);
        self.frames.reserve(more);
        pending.iter().zip(centres).for_each(|(pair, centre)| self.keep(pair, centre, options));
        // The next ones reuse its memory.
        pending.clear();
        self.pending = pending;
    }

    /// Makes a row of a pair with its round trip at the channel centre, unless it is skipped.
    fn keep(&mut self, pair: &Pair<FrameHeard>, centre: Option<Complex64>, options: &Options) {
        if let Some(host_us) = pair.receiver.host_us {
            self.first_us.get_or_insert(host_us);
            if let Some((from, to)) = self.span_us.filter(|(from, to)| !(from..=to).contains(&&host_us)) {
                let partner_inside = pair.transmitter.host_us.is_some_and(|at| (from..=to).contains(&at));
                self.outside += 1;
                self.partner_inside += usize::from(partner_inside);
                return;
            }
        }
        let at = self.offered;
        self.offered += 1;
        if !at.is_multiple_of(self.stride.saturating_mul(options.decimate.get())) {
            self.thinned += 1;
            return;
        }
        if self.rows.len() >= MAX_ROWS {
            every_second(&mut self.rows);
            every_second(&mut self.frames);
            self.thinned += MAX_ROWS - self.rows.len();
            self.stride *= 2;
        }
        let Some(z) = centre else {
            self.silent += 1;
            return;
        };
        let one_way = || at_centre(&pair.receiver.csi(), &options.channel.subcarriers());
        let one_way = options.keep_course.then(one_way).flatten();
        self.rows.push(PairRow {
            one_way_rad: one_way.map_or(0.0, |one_way| one_way.arg()),
            z,
            clock_rx_us: pair.clock_rx_us,
            difference_us: pair.clock_difference_us,
            finer_us: 1e-6 * (f64::from(pair.transmitter.left_ps) - f64::from(pair.receiver.left_ps)),
            host_us: pair.receiver.host_us,
            partner_host_us: pair.transmitter.host_us,
            row: pair.receiver.row,
        });
        self.frames.push([*pair.transmitter.heard(), *pair.receiver.heard()]);
    }

    /// Forgets the pairs before `host_us` of the receiver: a live window moves on.
    pub(crate) fn forget_before(&mut self, host_us: i64) {
        let stays: Vec<bool> = self.rows.iter().map(|row| row.host_us.is_none_or(|at| at >= host_us)).collect();
        let (mut rows, mut frames) = (stays.iter(), stays.iter());
        self.rows.retain(|_| rows.next().is_some_and(|stays| *stays));
        self.frames.retain(|_| frames.next().is_some_and(|stays| *stays));
        // Later pairs are kept as densely as the remaining ones allow; after a long rest every pair.
        let mut expected = self.rows.len();
        while self.stride > 1 && expected <= MAX_ROWS / 4 {
            (self.stride, expected) = (self.stride / 2, expected * 2);
        }
    }

    /// The receiver's host time of the last pair kept, microseconds since the Unix epoch.
    #[must_use]
    pub(crate) fn last_us(&self) -> Option<i64> {
        self.rows.iter().rev().find_map(|row| row.host_us)
    }

    /// How far the transmitter's host clock is ahead of the receiver's, seconds: the median over the pairs kept. Both
    /// stamp an exchange within the turn-around and the jitter of interrupts.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn partner_ahead_s(&self) -> Option<f64> {
        let ahead = |row: &PairRow| Some(row.partner_host_us?.saturating_sub(row.host_us?));
        let mut ahead_us: Vec<i64> = self.rows.iter().filter_map(ahead).collect();
        upper_median_ord(&mut ahead_us).map(|us| us as f64 * 1e-6)
    }

    /// Correlation of the channel in both directions; none with too few pairs or without changes.
    pub(super) fn reciprocity(&self) -> Option<Reciprocal> {
        let mut sums = Reciprocity::default();
        let csi = |heard: &Heard| heard.map(|iq| Complex32::new(f32::from(iq.i), f32::from(iq.q)));
        self.frames.iter().for_each(|[forward, backward]| sums.add(&csi(forward), &csi(backward)));
        sums.get()
    }

    /// True if both frames of every pair and the times of both cards are equal: one log was given for both sides.
    /// Frames alone are also equal without noise and motion.
    pub(super) fn is_one_log(&self) -> bool {
        self.frames.len() >= LEAST_PAUSES
            && self.frames.iter().all(|[forward, backward]| forward == backward)
            && self.rows.iter().all(|row| row.difference_us == 0)
    }

    /// Correlation of the pauses between exchanges on both clocks.
    pub(super) fn kinship(&self) -> Option<Kinship> {
        let clock: Vec<i64> = self.rows.iter().map(|row| row.clock_rx_us).collect();
        let difference: Vec<i64> = self.rows.iter().map(|row| row.difference_us).collect();
        kinship(&clock, &difference)
    }

    /// Ends both logs.
    pub(crate) fn finish(&mut self, options: &Options) {
        self.pairing.finish();
        self.take_pairs(options);
        self.settle(options);
    }

    /// The turn-around compensation and the phase of every pair kept, in motion or not, by the receiver's card clock.
    /// One-way phases only if [`Options::keep_course`] asked for them.
    #[must_use]
    pub fn phases(&self, options: &Options) -> (Option<TurnAround>, Vec<Phase>) {
        let mut z: Vec<Complex64> = self.rows.iter().map(|row| row.z).collect();
        let turn_around = self.turn_around(&z, options.channel.centre_hz());
        if let Some(turn_around) = &turn_around {
            turn_around.apply(&mut z);
        }
        let times_s: Vec<f64> = self.rows.iter().map(|row| row.clock_rx_us as f64 * 1e-6).collect();
        (turn_around, self.course(&times_s, &z))
    }

    pub(super) fn course(&self, times_s: &[f64], z: &[Complex64]) -> Vec<Phase> {
        let phase = |((row, z), t_s): ((&PairRow, &Complex64), &f64)| Phase {
            t_s: t_s - times_s[0],
            one_way_rad: row.one_way_rad,
            round_trip_rad: row.z.arg(),
            compensated_rad: z.arg(),
            is_used: false,
        };
        self.rows.iter().zip(z).zip(times_s).map(phase).collect()
    }

    /// The turn-around compensation of `z`, one for each pair kept, where both clocks allow one.
    pub(super) fn turn_around(&self, z: &[Complex64], carrier_hz: f64) -> Option<TurnAround> {
        let clock: Vec<i64> = self.rows.iter().map(|row| row.clock_rx_us).collect();
        let difference: Vec<f64> = self.rows.iter().map(|row| row.difference_us as f64 + row.finer_us).collect();
        TurnAround::estimate(z, &clock, &difference, carrier_hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use driver_iface::sounding::native::Measurement;

    /// Exchange number `k`, 10 ms after the one before.
    fn exchange(link: &mut Link, options: &Options, k: u32) {
        let measurement = Measurement {
            number: k,
            timestamp_low: k * 10_000,
            rx_antenna: 0,
            antenna_sel: 0,
            rssi: [40; 3],
            noise_dbm: -127,
            agc: 20,
            iq: [[9, 1]; 30],
        };
        let mut heard = FrameHeard::measured(&measurement, k);
        heard.host_us = Some(i64::from(k) * 10_000);
        link.handle(LinkSide::Receiver, heard, options);
        link.handle(LinkSide::Transmitter, heard, options);
    }

    #[test]
    fn after_a_long_rest_every_pair_is_kept_again() {
        let options = Options::new("108".parse().unwrap());
        let mut link = Link::new(Mac([2; 6]), None);
        (0..60_000).for_each(|k| exchange(&mut link, &options, k));
        assert!(link.stride > 4 && link.rows.len() <= MAX_ROWS, "{}", link.stride);
        link.forget_before(599_000_000);
        (60_000..60_500).for_each(|k| exchange(&mut link, &options, k));
        let kept = link.rows.iter().filter(|row| row.row >= 60_000).count();
        assert_eq!(kept, 500);
        // Data beside the rows are dropped with them.
        assert_eq!(link.frames.len(), link.rows.len());
    }
}
