//! One link: its pairs, made into coherent samples along the motion, made into a bearing.

use super::accurate::{self, Placed};
use super::intake::Heard;
use super::{JoinBy, Options};
use crate::bartlett::{self, Estimate, Grid};
use crate::exchange::pairing::{Pair, Pairing, Side, SideCounts};
use crate::maths::{upper_median_ord, wrap_rad};
use crate::motion::pose::{Motion, Trajectory};
use crate::place::near_field::Search;
use crate::signal::cfo::{TurnAround, at_centre, round_trip, round_trip_at_centre};
use crate::signal::samples::Samples;
use driver_iface::Mac;
use nalgebra::Vector3;
use num_complex::Complex64;

/// Why a link gives no bearing.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// No frame of this transmitter is in both logs.
    #[error(
        "no frame number of this link is in both logs ({receiver} records in the receiver's, {transmitter} in the transmitter's): are they of one run?"
    )]
    NoPairs {
        /// Frames in the receiver's log.
        receiver: u64,
        /// Frames in the transmitter's log.
        transmitter: u64,
    },
    /// The receiver's records hold no host time, so they cannot be joined with a trajectory by time.
    #[error(
        "the receiver's records hold no host time (stock layout): join with the trajectory row by row (--join-rows)"
    )]
    NoHostTime,
    /// No pair is left between `--from` and `--to`.
    #[error("all {pairs} pairs are outside --from and --to (the link lasts {length_s:.3} s)")]
    AllCut {
        /// Pairs.
        pairs: usize,
        /// Time from the first to the last pair, s.
        length_s: f64,
    },
    /// The clocks of the pairs have nothing to do with each other.
    #[error(
        "the two logs do not belong together: their clocks' difference spreads by {spread_us:.0} us from pair to pair, where an exchange spreads by some tens"
    )]
    NotOfOneRun {
        /// Median of the deviation from a straight line, microseconds.
        spread_us: f64,
    },
    /// The trajectory reaches further than any array of use.
    #[error(
        "the robots moved {extent_m:.0} m relative to each other: are the trajectories in metres? At most {limit_m:.0} m are used at once (--from and --to cut a piece)"
    )]
    TooLarge {
        /// Extent of the motion, metres.
        extent_m: f64,
        /// The largest that is searched, metres.
        limit_m: f64,
    },
    /// All pairs lie outside the trajectory.
    #[error(
        "the {pairs} pairs (from about {from_s:.3} s) lie outside the trajectory ({start_s:.3} s to {end_s:.3} s): is it of this run? --clock-offset shifts one against the other"
    )]
    OutsideTrajectory {
        /// Pairs.
        pairs: usize,
        /// Time of the first pair on the trajectory's clock, s.
        from_s: f64,
        /// First pose, s.
        start_s: f64,
        /// Last pose, s.
        end_s: f64,
    },
    /// The robots did not move relative to each other.
    #[error(
        "no motion: none of the {pairs} pairs was taken while a robot moved, and without motion there is no bearing"
    )]
    NoMotion {
        /// Pairs.
        pairs: usize,
    },
    /// The transmitter's log could not be matched.
    #[error(transparent)]
    Unmatched(#[from] crate::exchange::assign::Unmatched),
    /// The estimator refused.
    #[error(transparent)]
    Bartlett(#[from] bartlett::Error),
}

/// Pairs by what became of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PairCounts {
    /// Pairs formed.
    pub formed: usize,
    /// Used for the bearing.
    pub in_motion: usize,
    /// Taken while no robot moved.
    pub standing: usize,
    /// Outside the trajectory, or in a gap of it.
    pub no_pose: usize,
    /// Outside `--from`..`--to`.
    pub cut: usize,
    /// Without energy at the antenna.
    pub silent: usize,
    /// Left out evenly, because the link has more pairs than are kept.
    pub thinned: usize,
}

/// What is known of a link once its logs were read.
#[derive(Debug)]
pub struct Link {
    /// The transmitter's MAC.
    pub mac: Mac,
    pairing: Pairing<Heard>,
    rows: Vec<Row>,
    /// The round trip of each row on all subcarriers, where a step of the accuracy layer wants it.
    products: Vec<crate::signal::alignment::Row>,
    silent: usize,
    span_us: Option<(i64, i64)>,
    outside: usize,
    first_us: Option<i64>,
    /// One pair in so many is kept.
    stride: usize,
    thinned: usize,
}

#[derive(Clone, Copy, Debug)]
struct Row {
    z: Complex64,
    clock_rx_us: i64,
    difference_us: i64,
    host_us: Option<i64>,
    partner_host_us: Option<i64>,
    row: u32,
    one_way_rad: f64,
}

/// Everything that a link gave.
#[derive(Clone, Debug)]
pub struct Bearing {
    /// The estimate, azimuth in the trajectory's frame.
    pub estimate: Estimate,
    /// What spherical waves and all subcarriers added; the estimate's azimuth and elevation are then its own.
    pub placed: Option<Placed>,
    /// The search that placed it, until what takes all links of a capture is done.
    pub(super) search: Option<Search>,
    /// The robot's heading at the last sample used, radians.
    pub heading_rad: Option<f64>,
    /// Turn-around compensation, where both clocks allowed one.
    pub turn_around: Option<TurnAround>,
    /// Whether it was applied.
    pub compensated: bool,
    /// Pairs by fate.
    pub pairs: PairCounts,
    /// Mean receiver position of the samples used, metres, trajectory frame.
    pub mean_position_m: Vector3<f64>,
    /// The figures that the peers report beside their bearings.
    pub peers: PeerFigures,
    /// The samples used.
    pub samples: Samples,
    /// The receiver's whole path, if [`Options::keep_course`] asked for it, metres.
    pub path_m: Vec<Vector3<f64>>,
    /// The phase of every pair, if [`Options::keep_course`] asked for it.
    pub course: Vec<Phase>,
}

impl Bearing {
    /// Azimuth relative to the robot's heading at the last sample used, radians.
    #[must_use]
    pub fn azimuth_body_rad(&self) -> Option<f64> {
        self.heading_rad.map(|heading| wrap_rad(self.estimate.azimuth_rad - heading))
    }
}

/// The phase of one pair, for pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phase {
    /// Seconds from the link's first pair.
    pub t_s: f64,
    /// Phase of what the receiver alone heard, at the channel centre, radians.
    pub one_way_rad: f64,
    /// Phase of the round-trip product, radians.
    pub round_trip_rad: f64,
    /// The same after turn-around compensation, radians.
    pub compensated_rad: f64,
}

/// Figures of merit as the peers define them, from an azimuth profile on the WSR toolbox's grid.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PeerFigures {
    /// The WSR toolbox's profile variance: lower is sharper, 1 is uniform.
    pub wsr_profile_variance: Option<f64>,
    /// The paper's likelihood share: the highest entry over the sum (its code prints half, holding each column twice).
    pub likelihood_share: Option<f64>,
}

impl PeerFigures {
    fn of(samples: &Samples) -> Result<Self, bartlett::Error> {
        // The toolbox's planar mode: one azimuth profile, the same for each of its polar angles.
        let profile = bartlett::profile(samples, &Grid::wsr_azimuths())?;
        let likelihood_share = profile.likelihood_share();
        Ok(Self { wsr_profile_variance: bartlett::wsr_planar_profile_variance(&profile), likelihood_share })
    }
}

/// With a turn-around that jitters by more than this no phase survives the product of two frames, microseconds: at the
/// offsets that cards have (4 to 21 kHz) it is several turns.
const MAX_SPREAD_US: f64 = 500.0;
/// Largest motion that is searched as one array, metres: far beyond what odometry follows to a fraction of a wavelength.
const MAX_EXTENT_M: f64 = 50.0;

/// Pairs kept of a link; of more every second one goes, again and again, so that a log of any length costs no more memory.
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

/// The longest side of the box that holds all displacements, metres.
fn extent_m(samples: &Samples) -> f64 {
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for p in samples.displacements_m() {
        (low, high) = (low.inf(&p), high.sup(&p));
    }
    (high - low).max()
}

impl Link {
    /// A link to `mac` with nothing in it yet. Pairs outside `span_us` of the receiver's host time are only counted.
    #[must_use]
    pub fn new(mac: Mac, span_us: Option<(i64, i64)>) -> Self {
        let pairing = Pairing::new(4_096);
        let (rows, products) = (Vec::new(), Vec::new());
        Self { mac, pairing, rows, products, silent: 0, span_us, outside: 0, first_us: None, stride: 1, thinned: 0 }
    }

    /// Which side should be read next.
    #[must_use]
    pub fn behind(&self) -> Side {
        self.pairing.behind()
    }

    /// Records of one side by fate.
    #[must_use]
    pub fn counts(&self, side: Side) -> SideCounts {
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

    /// Takes a frame of one side.
    pub fn handle(&mut self, side: Side, heard: Heard, options: &Options) {
        self.pairing.handle(side, heard.number, heard.timestamp_low, heard);
        self.take_pairs(options);
    }

    fn take_pairs(&mut self, options: &Options) {
        while let Some(pair) = self.pairing.poll_pair() {
            self.keep(&pair, options);
        }
    }

    fn keep(&mut self, pair: &Pair<Heard>, options: &Options) {
        if let Some(host_us) = pair.receiver.host_us {
            self.first_us.get_or_insert(host_us);
            if self.span_us.is_some_and(|(from, to)| !(from..=to).contains(&host_us)) {
                self.outside += 1;
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
        let one_way = || at_centre(&pair.receiver.csi(), &options.channel.subcarriers());
        let one_way = options.keep_course.then(one_way).flatten();
        self.rows.push(Row {
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
    pub fn forget_before(&mut self, host_us: i64) {
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
    pub fn last_us(&self) -> Option<i64> {
        self.rows.iter().rev().find_map(|row| row.host_us)
    }

    /// How far the transmitter's host clock is ahead of the receiver's, seconds: the median over the pairs kept. Both
    /// stamp an exchange within the turn-around and the jitter of interrupts.
    #[must_use]
    pub fn partner_ahead_s(&self) -> Option<f64> {
        let ahead = |row: &Row| Some(row.partner_host_us?.saturating_sub(row.host_us?));
        let mut ahead_us: Vec<i64> = self.rows.iter().filter_map(ahead).collect();
        upper_median_ord(&mut ahead_us).map(|us| us as f64 * 1e-6)
    }

    /// Ends both logs.
    pub fn finish(&mut self, options: &Options) {
        self.pairing.finish();
        self.take_pairs(options);
    }

    /// The bearing, from everything read.
    ///
    /// # Errors
    /// If there is nothing to make one from; see [`LinkError`].
    pub fn bearing(
        &self,
        receiver: &Trajectory,
        transmitter: Option<&Trajectory>,
        options: &Options,
    ) -> Result<Bearing, LinkError> {
        if self.rows.is_empty() && self.outside > 0 {
            let at_s = self.first_us.map_or(0.0, |us| us as f64 * 1e-6 + options.clock_offset_s);
            let (start_s, end_s) = receiver.span_s();
            return Err(LinkError::OutsideTrajectory { pairs: self.outside, from_s: at_s, start_s, end_s });
        }
        if self.rows.is_empty() {
            let handed = |side| self.counts(side).handed;
            return Err(LinkError::NoPairs {
                receiver: handed(Side::Receiver),
                transmitter: handed(Side::Transmitter),
            });
        }
        let raw: Vec<Complex64> = self.rows.iter().map(|row| row.z).collect();
        let mut z = raw.clone();
        let turn_around = self.turn_around(&raw, options.channel.centre_hz());
        let compensated = options.compensate && turn_around.as_ref().is_some_and(|t| t.worthwhile);
        if let Some(turn_around) = turn_around.as_ref().filter(|_| compensated) {
            turn_around.apply(&mut z);
        }
        let times = self.times_s(receiver, options)?;
        if let Some(spread_us) = turn_around.as_ref().map(|t| t.jitter_median_us).filter(|us| *us > MAX_SPREAD_US) {
            return Err(LinkError::NotOfOneRun { spread_us });
        }
        let formed = self.pairs() + self.silent;
        let (silent, no_pose, thinned) = (self.silent, self.outside, self.thinned);
        let mut pairs = PairCounts { formed, silent, no_pose, thinned, ..PairCounts::default() };
        let first_s =
            self.first_us.filter(|_| options.join == JoinBy::Time).map(|us| us as f64 * 1e-6 + options.clock_offset_s);
        let first_s = first_s.unwrap_or(times[0]);
        let mut samples = Samples::new(options.channel.wavelength_m(), 2).map_err(bartlett::Error::from)?;
        let mut heading_rad = None;
        let mut used = Vec::new();
        let motion = (receiver.motion(), transmitter.map(Trajectory::motion));
        for (index, (&t_s, &z)) in times.iter().zip(&z).enumerate() {
            if !options.keeps(t_s - first_s) {
                pairs.cut += 1;
                continue;
            }
            let partner = match transmitter {
                Some(trajectory) => trajectory.at(t_s).map(|pose| pose.position_m),
                None => Some(Vector3::zeros()),
            };
            let (Some(pose), Some(partner)) = (receiver.at(t_s), partner) else {
                pairs.no_pose += 1;
                continue;
            };
            let moves = |trajectory: &Trajectory, motion: &Motion| {
                let inside = motion.window_s.is_some_and(|(from, to)| (from..=to).contains(&t_s));
                inside && trajectory.speed_m_per_s(t_s) > motion.floor_m_per_s
            };
            let other =
                transmitter.zip(motion.1.as_ref()).is_some_and(|(trajectory, motion)| moves(trajectory, motion));
            if !other && !moves(receiver, &motion.0) {
                pairs.standing += 1;
                continue;
            }
            heading_rad = pose.heading_rad;
            used.push(index);
            samples.push(t_s, z / z.norm(), pose.position_m, partner).map_err(bartlett::Error::from)?;
        }
        pairs.in_motion = samples.len();
        if samples.is_empty() {
            return Err(self.no_samples(&pairs, &times, receiver));
        }
        let extent_m = extent_m(&samples);
        if extent_m > MAX_EXTENT_M {
            return Err(LinkError::TooLarge { extent_m, limit_m: MAX_EXTENT_M });
        }
        let mut estimate = bartlett::search(&samples, &options.search)?;
        let (placed, search) = match options.accuracy.near_field {
            true => {
                let turned = self.products.iter().zip(self.rows.iter().zip(&z));
                let rows = turned.map(|(product, (row, z))| accurate::compensated(product, z / row.z));
                accurate::place(&samples, rows.collect(), &used, &mut estimate, options).unzip()
            }
            false => (None, None),
        };
        let sum = samples.receiver_m().iter().fold(Vector3::zeros(), |sum, p| sum + p);
        Ok(Bearing {
            heading_rad,
            estimate,
            placed,
            search,
            peers: PeerFigures::of(&samples)?,
            turn_around,
            compensated,
            pairs,
            mean_position_m: sum / samples.len() as f64,
            samples,
            path_m: receiver.poses().iter().filter(|_| options.keep_course).map(|pose| pose.position_m).collect(),
            course: if options.keep_course { self.course(&times, &z) } else { Vec::new() },
        })
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

    fn course(&self, times_s: &[f64], z: &[Complex64]) -> Vec<Phase> {
        let phase = |((row, z), t_s): ((&Row, &Complex64), &f64)| Phase {
            t_s: t_s - times_s[0],
            one_way_rad: row.one_way_rad,
            round_trip_rad: row.z.arg(),
            compensated_rad: z.arg(),
        };
        self.rows.iter().zip(z).zip(times_s).map(phase).collect()
    }

    fn turn_around(&self, z: &[Complex64], carrier_hz: f64) -> Option<TurnAround> {
        let clock: Vec<i64> = self.rows.iter().map(|row| row.clock_rx_us).collect();
        let difference: Vec<i64> = self.rows.iter().map(|row| row.difference_us).collect();
        TurnAround::estimate(z, &clock, &difference, carrier_hz)
    }

    /// The time of each pair on the trajectory's clock.
    fn times_s(&self, trajectory: &Trajectory, options: &Options) -> Result<Vec<f64>, LinkError> {
        // A time after the end has no pose: the single pair without a time is counted, not the link given up.
        let never = f64::MAX;
        let time = |row: &Row| match options.join {
            JoinBy::Time => row.host_us.map_or(never, |us| us as f64 * 1e-6 + options.clock_offset_s),
            JoinBy::Row => trajectory.poses().get(row.row as usize).map_or(never, |pose| pose.t_s),
        };
        if options.join == JoinBy::Time && self.rows.iter().all(|row| row.host_us.is_none()) {
            return Err(LinkError::NoHostTime);
        }
        Ok(self.rows.iter().map(time).collect())
    }

    fn no_samples(&self, pairs: &PairCounts, times: &[f64], trajectory: &Trajectory) -> LinkError {
        let (start_s, end_s) = trajectory.span_s();
        let known = || times.iter().copied().filter(|t| *t != f64::MAX);
        let (from_s, to_s) = known().fold((f64::MAX, f64::MIN), |(low, high), t| (low.min(t), high.max(t)));
        if pairs.standing > 0 {
            return LinkError::NoMotion { pairs: pairs.formed };
        }
        if pairs.cut > 0 && pairs.no_pose == 0 {
            return LinkError::AllCut { pairs: pairs.formed, length_s: to_s - from_s };
        }
        LinkError::OutsideTrajectory { pairs: pairs.formed, from_s, start_s, end_s }
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
        let mut heard = Heard::measured(&measurement, k);
        heard.host_us = Some(i64::from(k) * 10_000);
        link.handle(Side::Receiver, heard, options);
        link.handle(Side::Transmitter, heard, options);
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
