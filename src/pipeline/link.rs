//! One link: the pairs of its frames, each made into a coherent round trip, and kept until a bearing is made of them.

use super::bearing::{PairCounts, Phase};
use super::intake::FrameHeard;
use super::options::Options;
use crate::exchange::kinship::{Kinship, kinship};
use crate::exchange::pairing::{LinkSide, Pair, Pairing, SideCounts};
use crate::maths::upper_median_ord;
use crate::signal::cfo::{TurnAround, at_centre, round_trip, round_trip_at_centre};
use crate::signal::reciprocity::Reciprocity;
use driver_iface::Mac;
use num_complex::Complex64;

/// Most pairs kept of a link. At this number every second pair is dropped, so memory is bounded for a log of any length.
/// At 100 exchanges a second it is over a minute within one trajectory, longer than odometry stays coherent.
const MAX_ROWS: usize = 8_192;

/// Leaves the first of every two.
fn every_second<T>(list: &mut Vec<T>) {
    let mut index = 0;
    list.retain(|_| {
        index += 1;
        index % 2 == 1
    });
}

/// What is known of a link once its logs were read.
#[derive(Debug)]
pub struct Link {
    /// The transmitter's MAC.
    pub mac: Mac,
    pairing: Pairing<FrameHeard>,
    /// Pairs that are not rows yet: where links are worked on side by side, so is what makes rows of them.
    pending: Vec<Pair<FrameHeard>>,
    rows: Vec<PairRow>,
    /// The round trip of each row on all subcarriers, where a step of the accuracy layer wants it.
    products: Vec<crate::signal::alignment::CsiRow>,
    silent: usize,
    span_us: Option<(i64, i64)>,
    outside: usize,
    /// Those of them that are inside by the transmitter's host time.
    partner_inside: usize,
    first_us: Option<i64>,
    /// One pair in so many is kept.
    stride: usize,
    thinned: usize,
    /// Whether both sides heard one channel.
    reciprocity: Reciprocity,
}

/// One pair.
#[derive(Clone, Copy, Debug)]
pub(super) struct PairRow {
    /// The round trip at the channel centre.
    pub z: Complex64,
    /// Time on the receiver's card, microseconds, unwrapped.
    pub clock_rx_us: i64,
    /// The transmitter's card's clock less the receiver's, microseconds, as the pairing gives it.
    pub difference_us: i64,
    /// Host times of receiver and transmitter, microseconds since the Unix epoch.
    pub host_us: Option<i64>,
    pub partner_host_us: Option<i64>,
    /// Number of the frame among those of the link in the receiver's log.
    pub row: u32,
    /// Phase of what the receiver alone heard, radians; 0 where nothing asked for it.
    pub one_way_rad: f64,
}

impl Link {
    /// A link to `mac` with nothing in it yet. Pairs outside `span_us` of the receiver's host time are only counted.
    #[must_use]
    pub(crate) fn new(mac: Mac, span_us: Option<(i64, i64)>) -> Self {
        let pairing = Pairing::new(4_096);
        let (rows, products) = (Vec::new(), Vec::new());
        let reciprocity = Reciprocity::default();
        Self {
            mac,
            pairing,
            pending: Vec::new(),
            rows,
            products,
            silent: 0,
            span_us,
            outside: 0,
            partner_inside: 0,
            first_us: None,
            stride: 1,
            thinned: 0,
            reciprocity,
        }
    }

    /// Which side should be read next.
    #[must_use]
    pub(crate) fn behind(&self) -> LinkSide {
        self.pairing.behind()
    }

    /// Records of one side by fate.
    #[must_use]
    pub fn counts(&self, side: LinkSide) -> SideCounts {
        self.pairing.counts(side)
    }

    /// Pairs so far.
    #[must_use]
    pub fn pairs(&self) -> usize {
        self.rows.len() + self.outside + self.thinned
    }

    /// Pairs left out evenly so far, because the link has more than are kept.
    #[must_use]
    pub fn thinned(&self) -> usize {
        self.thinned
    }

    /// The pairs kept.
    pub(super) fn rows(&self) -> &[PairRow] {
        &self.rows
    }

    /// The round trip of each on all subcarriers; empty where no step wants them.
    pub(super) fn products(&self) -> &[crate::signal::alignment::CsiRow] {
        &self.products
    }

    /// Pairs outside the receiver's host time that is of use.
    pub(super) fn outside(&self) -> usize {
        self.outside
    }

    /// Whether many pairs are outside by the receiver's host time, and nearly all inside by the transmitter's; `share` is how
    /// many are many.
    pub(super) fn other_fits(&self, share: f64) -> bool {
        let inside = |row: &&PairRow| {
            let within = |at| self.span_us.is_none_or(|(from, to)| (from..=to).contains(&at));
            row.partner_host_us.is_some_and(within)
        };
        // Each row kept stands for those that were thinned out.
        let stands_for = (self.rows.len() + self.thinned) as f64 / self.rows.len().max(1) as f64;
        let partner = stands_for * self.rows.iter().filter(inside).count() as f64 + self.partner_inside as f64;
        let all = self.pairs() as f64;
        self.outside as f64 > share * all && partner >= (1.0 - share) * all
    }

    /// The receiver's host time of the first pair, microseconds since the Unix epoch.
    pub(super) fn first_us(&self) -> Option<i64> {
        self.first_us
    }

    /// The pairs that are not kept, by why.
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
        if !options.parallel || self.pending.len() >= MAX_ROWS {
            self.settle(options);
        }
    }

    /// Makes rows of the pairs that wait for it.
    fn settle(&mut self, options: &Options) {
        for pair in std::mem::take(&mut self.pending) {
            self.keep(&pair, options);
        }
    }

    fn keep(&mut self, pair: &Pair<FrameHeard>, options: &Options) {
        if let Some(host_us) = pair.receiver.host_us {
            self.first_us.get_or_insert(host_us);
            if let Some((from, to)) = self.span_us.filter(|(from, to)| !(from..=to).contains(&&host_us)) {
                let partner_inside = pair.transmitter.host_us.is_some_and(|at| (from..=to).contains(&at));
                self.outside += 1;
                self.partner_inside += usize::from(partner_inside);
                return;
            }
        }
        if !(self.rows.len() + self.thinned).is_multiple_of(self.stride) {
            self.thinned += 1;
            return;
        }
        if self.rows.len() >= MAX_ROWS {
            every_second(&mut self.rows);
            every_second(&mut self.products);
            self.thinned += MAX_ROWS - self.rows.len();
            self.stride *= 2;
        }
        let (forward, backward) = (pair.transmitter.csi(), pair.receiver.csi());
        let Some(coherent) = round_trip_at_centre(&forward, &backward, &options.channel.subcarriers()) else {
            self.silent += 1;
            return;
        };
        self.reciprocity.add(&forward, &backward);
        let one_way = || at_centre(&pair.receiver.csi(), &options.channel.subcarriers());
        let one_way = options.keep_course.then(one_way).flatten();
        self.rows.push(PairRow {
            one_way_rad: one_way.map_or(0.0, |one_way| one_way.h.arg()),
            z: coherent.h,
            clock_rx_us: pair.clock_rx_us,
            difference_us: pair.clock_difference_us,
            host_us: pair.receiver.host_us,
            partner_host_us: pair.transmitter.host_us,
            row: pair.receiver.row,
        });
        if options.accuracy.near_field {
            self.products.push(round_trip(&forward, &backward));
        }
    }

    /// Forgets the pairs before `host_us` of the receiver: a live window moves on.
    pub(crate) fn forget_before(&mut self, host_us: i64) {
        let stays: Vec<bool> = self.rows.iter().map(|row| row.host_us.is_none_or(|at| at >= host_us)).collect();
        if self.products.len() == self.rows.len() {
            // Row by row with them.
            let mut stays = stays.iter();
            self.products.retain(|_| stays.next().is_some_and(|stays| *stays));
        }
        let mut stays = stays.iter();
        self.rows.retain(|_| stays.next().is_some_and(|stays| *stays));
        // As dense from here on as what remains allows: after a long rest that is every pair again.
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

    /// How alike the channel was in both directions.
    pub(super) fn reciprocity(&self) -> &Reciprocity {
        &self.reciprocity
    }

    /// How the pauses between exchanges go together on both clocks.
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
        };
        self.rows.iter().zip(z).zip(times_s).map(phase).collect()
    }

    /// The turn-around compensation of `z`, one for each pair kept, where both clocks allow one.
    pub(super) fn turn_around(&self, z: &[Complex64], carrier_hz: f64) -> Option<TurnAround> {
        let clock: Vec<i64> = self.rows.iter().map(|row| row.clock_rx_us).collect();
        let difference: Vec<i64> = self.rows.iter().map(|row| row.difference_us).collect();
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
        // What goes with the rows is forgotten with them.
        assert_eq!(link.products.len(), link.rows.len());
    }
}
