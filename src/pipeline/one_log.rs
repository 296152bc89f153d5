//! Bearings from one log: two or three antennas on a turning robot, without a partner's log.
//!
//! The receive chains of one card share carrier, sampling clock and gain. These cancel in `z = h_A conj(h_B)`, and the
//! direction remains:
//!
//! ```text
//! z ~ exp(+j 2 pi / lambda * u . R b + j c)
//! ```
//!
//! with `u` the unit vector to the transmitter, `b` the baseline `r_A - r_B` on the robot, `R` the robot's attitude and `c` a
//! constant of the two chains. So a turning baseline is a synthetic array: `R b` is the displacement, the path gain is 1, and
//! the samples go into the same estimate as those of two logs.
//!
//! If the robot only turns, the wave front is assumed to be plane, so there is no range. A robot that drives sees the transmitter from
//! several places: then the ways to both antennas are those of a spherical wave (`MovingArray`), which gives the range.
//!
//! A turn also gives `c` ([`ChainConstant`]). It holds until the firmware is loaded again. With a known `c`
//! ([`Array::with_constants`]) a standing robot has a bearing too; two antennas leave its mirror across the baseline.
//! Two antennas at the same place would measure the phase `c`, so the estimate gets one sample of it at the origin for each
//! record.

use super::bearing::{Bearing, BearingAnswer, Fate, PairCounts, Phase, profile_figures};
use super::draft::{BY_CHANCE, DENSITY_AZIMUTHS, nothing, times_s};
use super::error::LinkError;
use super::first_delay::FirstDelay;
use super::options::{JoinBy, Options};
use super::{CaptureReport, LinkReport, LogReport};
use crate::bartlett;
use crate::estimate::likelihood::{Place, Ways};
use crate::estimate::{Found, MovingArray, Task, estimate, heading};
use crate::maths::wrap_rad;
use crate::motion::pose::{Trajectory, TrajectoryError, TrajectoryKind};
use crate::signal::channel::SUBCARRIERS;
use crate::signal::planes::{Planes, lanes};
use crate::signal::samples::Samples;
use crate::source::survey::SENDERS_KEPT;
use crate::source::{CsiSource, Error, Next};
use crate::time::Instant;
use csi_formats::Frame;
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Antennas};
use nalgebra::{Matrix3, Matrix3x2, UnitVector3, Vector2, Vector3};
use num_complex::{Complex32, Complex64};
use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Limit of records kept of a sender. Above it, every second one is dropped, so memory is bounded for a log of any length.
const MAX_ROWS: usize = 8_192;
/// Longest baseline of one card, metres.
const LONGEST_M: f64 = 1.0;
/// Shortest baseline, metres: about a thousandth of a wavelength.
const SHORTEST_M: f64 = 1e-4;
/// Length of the arm whose end shows when the robot turns, metres. With it, the speed threshold for driving robots means
/// 0.8 degrees a second.
const GATE_ARM_M: f64 = 0.3;
/// Short-term error of the attitude, radians: it moves the end of the baseline.
const ATTITUDE_SD_RAD: f64 = 0.0175;
/// A turn determines the constants if the baseline's end moves by this share of its length, ...
const TELLING: f64 = 0.3;
/// ... and the best direction has this probability.
const CLEAR_SHARE: f64 = 0.9;
/// A turn contradicts a given constant if they differ by more than this, in deviations and in radians. On a 5300 a wrong
/// constant is off by half a turn, on other cards by anything.
const CONTRADICTS_SD: f64 = 4.0;
const CONTRADICTS_RAD: f64 = 0.5;
/// Standard deviation of the first antenna's place relative to the trajectory, metres: if its place on the robot is unknown, and if it
/// is given.
const ON_ROBOT_SD_M: f64 = 0.05;
const GIVEN_SD_M: f64 = 0.005;
/// Standard deviation of the difference of ways in a sample, metres.
const WAY_SD_M: f64 = 0.001;
/// Samples of each baseline in the search for the chains' constants.
const ROUGH_ROWS: usize = 256;

/// Two or three antennas of one card, and their places on the robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    first: Antenna,
    others: Vec<(Antenna, Vector3<f64>)>,
    /// One for each baseline, or empty if unknown.
    constants: Vec<ChainConstant>,
    is_placed: bool,
}

/// The phase that the chains of two antennas add to `h_first conj(h_other)`.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ChainConstant {
    /// Radians.
    pub rad: f64,
    /// Its standard deviation, radians.
    pub sd_rad: f64,
}

/// Invalid antennas or baselines.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ArrayError {
    /// Fewer than two antennas, or more than three.
    #[error("a bearing from one log needs 2 or 3 antennas, such as A,B, not {antennas}")]
    Antennas {
        /// Antennas given.
        antennas: usize,
    },
    /// An antenna is named twice.
    #[error("antenna {antenna} is named twice: name each antenna once")]
    Twice {
        /// The antenna.
        antenna: Antenna,
    },
    /// The number of baselines is not one less than the number of antennas.
    #[error(
        "{baselines} baselines for {antennas} antennas: {} needed, from each other antenna to the first",
        antennas - 1
    )]
    Baselines {
        /// Antennas given.
        antennas: usize,
        /// Baselines given.
        baselines: usize,
    },
    /// A baseline that is too short or too long.
    #[error("a baseline of {length_m} m: metres are expected, {SHORTEST_M} to {LONGEST_M} (4.6 cm are 0.046)")]
    Length {
        /// Its length, metres.
        length_m: f64,
    },
    /// The number of constants is not the number of baselines, or one is not finite.
    #[error(
        "{constants} chain constants for {baselines} baselines: give none, or a finite one for each, with a deviation of 0 or more"
    )]
    Constants {
        /// Constants given.
        constants: usize,
        /// Baselines given.
        baselines: usize,
    },
}

impl Array {
    /// Antennas, and baselines: the vector from each other antenna to the first, metres (robot frame: x forward, y left, z up).
    /// On cards other than the 5300, antennas A, B and C are receive chains 0, 1 and 2.
    ///
    /// # Errors
    /// [`ArrayError`] unless there are two or three different antennas and one baseline of 0.1 mm to 1 m for each but the first.
    pub fn new(antennas: &[Antenna], baselines_m: &[Vector3<f64>]) -> Result<Self, ArrayError> {
        let (Some((&first, others)), 2..=3) = (antennas.split_first(), antennas.len()) else {
            return Err(ArrayError::Antennas { antennas: antennas.len() });
        };
        if let Some((_, &antenna)) = antennas.iter().enumerate().find(|(k, one)| antennas[..*k].contains(one)) {
            return Err(ArrayError::Twice { antenna });
        }
        if baselines_m.len() != others.len() {
            return Err(ArrayError::Baselines { antennas: antennas.len(), baselines: baselines_m.len() });
        }
        let fits = |length_m: &f64| (SHORTEST_M..=LONGEST_M).contains(length_m);
        if let Some(length_m) = baselines_m.iter().map(|b| b.norm()).find(|length_m| !fits(length_m)) {
            return Err(ArrayError::Length { length_m });
        }
        let others = others.iter().copied().zip(baselines_m.iter().copied()).collect();
        Ok(Self { first, others, constants: Vec::new(), is_placed: false })
    }

    /// Sets the constant of each baseline from an earlier turn ([`Bearing::chain_constants`]); none if they are not known.
    /// With constants, records of a standing robot are used too.
    ///
    /// # Errors
    /// [`ArrayError::Constants`] unless there is no constant, or a finite one for each baseline.
    pub fn with_constants(self, constants: &[ChainConstant]) -> Result<Self, ArrayError> {
        let is_known = |one: &ChainConstant| one.rad.is_finite() && one.sd_rad.is_finite() && one.sd_rad >= 0.0;
        if !constants.is_empty() && (constants.len() != self.others.len() || !constants.iter().all(is_known)) {
            return Err(ArrayError::Constants { constants: constants.len(), baselines: self.others.len() });
        }
        Ok(Self { constants: constants.to_vec(), ..self })
    }

    /// States that the trajectory is that of the first antenna. By default the antenna may be 5 cm away from it, and error bars
    /// include that.
    #[must_use]
    pub fn on_trajectory(self) -> Self {
        Self { is_placed: true, ..self }
    }

    /// Length of the first baseline, metres, and true if the chain constants are known.
    pub(super) fn reach(&self) -> (f64, bool) {
        (self.others.first().map_or(0.0, |(_, baseline_m)| baseline_m.norm()), !self.constants.is_empty())
    }

    /// The antennas, in the order given.
    fn antennas(&self) -> impl Iterator<Item = Antenna> + '_ {
        std::iter::once(self.first).chain(self.others.iter().map(|(antenna, _)| *antenna))
    }

    /// The baselines, metres.
    fn baselines_m(&self) -> impl ExactSizeIterator<Item = Vector3<f64>> + '_ {
        self.others.iter().map(|(_, baseline_m)| *baseline_m)
    }
}

/// One frame received by an array: `h_first conj(h_other)` for each other antenna.
#[derive(Clone, Debug, PartialEq)]
pub struct ArrayFrame {
    sender: Mac,
    host_us: Option<i64>,
    products: Vec<[Complex32; SUBCARRIERS]>,
}

impl ArrayFrame {
    /// From the CSI of each antenna and transmitted stream: any number of subcarriers, in order. `csi` returns `None` for CSI
    /// that the card does not have. An unknown sender is [`Mac::default`]. `host_us` is the host's time, microseconds since
    /// the Unix epoch.
    ///
    /// Streams are added, because all come from the same direction. More than 30 subcarriers are added up in 30 groups,
    /// because the phase between two antennas hardly changes over a channel.
    ///
    /// `None` if one of the antennas is not in the frame, received nothing or has another number of subcarriers.
    pub fn new(
        array: &Array,
        sender: Mac,
        host_us: Option<i64>,
        streams: usize,
        csi: impl Fn(Antenna, usize) -> Option<Vec<Complex32>>,
    ) -> Option<Self> {
        let mut products = vec![[Complex32::default(); SUBCARRIERS]; array.others.len()];
        for stream in 0..streams {
            let first = csi(array.first, stream)?;
            for ((antenna, _), product) in array.others.iter().zip(&mut products) {
                let other = csi(*antenna, stream).filter(|other| other.len() == first.len())?;
                let (n, groups) = (first.len().max(1), first.len().clamp(1, SUBCARRIERS));
                for (k, (a, b)) in first.iter().zip(&other).enumerate() {
                    product[k * groups / n] += a * b.conj();
                }
            }
        }
        let is_heard = |product: &[Complex32; SUBCARRIERS]| {
            let sum: Complex32 = product.iter().sum();
            sum.is_finite() && sum.norm_sqr() > 0.0
        };
        products.iter().all(is_heard).then_some(Self { sender, host_us, products })
    }
}

/// The receive chain of an antenna in a frame. A 5300 reports it; on other cards it is the antenna's number.
fn chain(frame: &Frame, antenna: Antenna) -> Option<usize> {
    match frame.antenna_sel {
        Some(sel) => Antennas::new(sel, u8::try_from(frame.n_rx).ok()?, [0; 3]).ok()?.chain_of(antenna),
        None => antenna.index().checked_sub(usize::from(frame.first_rx)),
    }
}

/// A kept frame.
#[derive(Clone, Debug)]
struct Row {
    host_us: Option<i64>,
    /// Its number among the frames of its sender.
    row: usize,
    products: Vec<[Complex32; SUBCARRIERS]>,
}

impl Row {
    /// The sample of a baseline: the sum over subcarriers (delay 0), where each path is multiplied by itself.
    fn z(&self, baseline: usize) -> Complex64 {
        let sum: Complex32 = self.products.get(baseline).into_iter().flatten().sum();
        let z = Complex64::new(f64::from(sum.re), f64::from(sum.im));
        if z.norm() > 0.0 { z / z.norm() } else { Complex64::ONE }
    }

    /// The product on all subcarriers, at unit power, times `turn`.
    fn planes(&self, baseline: usize, turn: Complex64) -> Planes {
        let Some(product) = self.products.get(baseline) else { return Planes::ZERO };
        let power = product.iter().map(Complex32::norm_sqr).sum::<f32>() / SUBCARRIERS as f32;
        let factor = Complex32::new(turn.re as f32, turn.im as f32) / power.sqrt();
        let own = |k: usize| product.get(k).map_or(Complex32::default(), |value| value * factor);
        Planes { re: lanes(|k| own(k).re), im: lanes(|k| own(k).im) }
    }
}

/// The records of one sender.
#[derive(Clone, Debug)]
struct Sender {
    rows: Vec<Row>,
    /// Frames received by all antennas.
    heard: usize,
    /// All its frames; those that an antenna missed count only when joining by row.
    frames: usize,
    /// One in this many records is kept.
    stride: usize,
}

/// Bearings from one log: takes frames, returns bearings. It does no I/O.
#[derive(Debug)]
pub struct OneLog {
    array: Array,
    options: Options,
    log: LogReport,
    senders: BTreeMap<Mac, Sender>,
    /// Limits of senders, and of records of each.
    most: (usize, usize),
    first_delay: FirstDelay,
}

impl OneLog {
    /// An empty state. Options about pairs and about two clocks have no effect.
    #[must_use]
    pub fn new(array: Array, options: Options) -> Self {
        let first_delay = FirstDelay::new(options.tier);
        let (senders, most) = (BTreeMap::new(), (SENDERS_KEPT, MAX_ROWS));
        Self { array, options, log: LogReport::default(), senders, most, first_delay }
    }

    /// Sets the limits of senders, and of records of each.
    pub(super) fn keeping(self, senders: usize, rows: usize) -> Self {
        Self { most: (senders, rows), ..self }
    }

    /// Forgets a sender's records before `host_us`. If no record is left and it is not `is_named`, forgets the sender too.
    pub(super) fn forget_before(&mut self, sender: Mac, host_us: i64, is_named: bool) {
        let Some(own) = self.senders.get_mut(&sender) else { return };
        own.rows.retain(|row| row.host_us.is_some_and(|at| at >= host_us));
        // Thins out later records only as far as needed.
        let mut expected = own.rows.len();
        while own.stride > 1 && expected <= self.most.1 / 4 {
            (own.stride, expected) = (own.stride / 2, expected * 2);
        }
        if own.rows.is_empty() && !is_named {
            self.senders.remove(&sender);
        }
    }

    /// The host time of a sender's first kept record.
    pub(super) fn first_us(&self, sender: Mac) -> Option<i64> {
        self.senders.get(&sender)?.rows.iter().find_map(|row| row.host_us)
    }

    /// The bearing of one sender from the kept records.
    pub(super) fn bearing(
        &self,
        sender: Mac,
        trajectory: &Trajectory,
        options: &Options,
    ) -> Result<Bearing, LinkError> {
        bearing(self.senders.get(&sender).ok_or(LinkError::Unheard)?, &self.array, trajectory, options)
    }

    /// Takes an item from a source of a 5300's records; returns the sender and host time of a frame received by all antennas.
    pub fn note(&mut self, next: &Next<'_>) -> Option<(Mac, Option<i64>)> {
        let (bfee, identity) = self.log.survey.note(next)?;
        let csi = |antenna, stream| {
            let iq = bfee.column(bfee.chain_of(antenna)?, stream)?;
            Some(iq.map(|iq| Complex32::new(f32::from(iq.i), f32::from(iq.q))).to_vec())
        };
        match ArrayFrame::new(&self.array, identity.mac, identity.host_us, bfee.n_tx(), csi) {
            Some(frame) => {
                self.hear(frame);
                Some((identity.mac, identity.host_us))
            }
            None => {
                self.log.unused.no_antenna += 1;
                self.miss(identity.mac);
                None
            }
        }
    }

    /// Takes a frame of another card. Returns false if an antenna is missing or received nothing.
    ///
    /// From frames of 80 MHz and more it takes the first strong delay, where the direct path dominates.
    pub fn note_frame(&mut self, frame: &Frame) -> bool {
        let column = |antenna, stream| frame.column(chain(frame, antenna).filter(|chain| *chain < frame.n_rx)?, stream);
        let mut firsts: Vec<Vec<Complex32>> = Vec::new();
        if FirstDelay::is_of(frame) {
            for stream in 0..frame.n_tx {
                let columns: Option<Vec<_>> = self.array.antennas().map(|antenna| column(antenna, stream)).collect();
                firsts.extend(columns.and_then(|columns| self.first_delay.of(frame, &columns)));
            }
        }
        let csi = |antenna: Antenna, stream: usize| match firsts.get(stream) {
            Some(values) => {
                let place = self.array.antennas().position(|own| own == antenna)?;
                values.get(place).map(|value| vec![*value])
            }
            None => {
                let measured = column(antenna, stream)?.iter().zip(&frame.measured).filter(|(_, measured)| **measured);
                Some(measured.map(|([re, im], _)| Complex32::new(*re, *im)).collect())
            }
        };
        let sender = frame.sender.map(Mac).unwrap_or_default();
        let heard = ArrayFrame::new(&self.array, sender, frame.host_us, frame.n_tx, csi);
        match heard {
            Some(heard) => {
                self.hear(heard);
                true
            }
            None => {
                self.miss(sender);
                false
            }
        }
    }

    /// Takes a frame of any card.
    #[doc(hidden)] // for the crates of this workspace
    pub fn hear(&mut self, frame: ArrayFrame) {
        let ArrayFrame { sender, host_us, products } = frame;
        if products.len() != self.array.others.len() {
            self.log.unused.other_sender += 1;
            return;
        }
        let most_rows = self.most.1;
        let Some((own, row)) = self.next_row(sender) else { return };
        own.heard += 1;
        if !row.is_multiple_of(own.stride) {
            return;
        }
        own.rows.push(Row { host_us, row, products });
        if own.rows.len() > most_rows {
            own.stride = own.stride.saturating_mul(2);
            let stride = own.stride;
            own.rows.retain(|row| row.row.is_multiple_of(stride));
        }
    }

    /// Counts a frame without a product, so that joining by row stays aligned.
    fn miss(&mut self, sender: Mac) {
        if self.options.join == JoinBy::Row {
            self.next_row(sender);
        }
    }

    /// Counts a frame; returns its sender and its number among the sender's frames. For other senders, counts it and returns
    /// `None`.
    fn next_row(&mut self, sender: Mac) -> Option<(&mut Sender, usize)> {
        let wanted = &self.options.tx_macs;
        let is_wanted = wanted.is_empty() || wanted.contains(&sender);
        let has_room = self.senders.len() < self.most.0 || self.senders.contains_key(&sender);
        if !is_wanted || !has_room {
            self.log.unused.other_sender += 1;
            return None;
        }
        let new = || Sender { rows: Vec::new(), heard: 0, frames: 0, stride: self.options.decimate.get() };
        let own = self.senders.entry(sender).or_insert_with(new);
        let row = own.frames;
        own.frames += 1;
        Some((own, row))
    }

    /// The bearing of every sender, with the robot's trajectory: a link for each, the one with most records first.
    /// [`LinkReport::link`] is `None`, because there are no pairs.
    #[must_use]
    pub fn bearings(self, trajectory: &Trajectory) -> CaptureReport {
        let Self { array, options, log, senders, .. } = self;
        let mut senders: Vec<(Mac, Sender)> = senders.into_iter().filter(|(_, own)| !own.rows.is_empty()).collect();
        senders.sort_by_key(|(_, sender)| std::cmp::Reverse(sender.heard));
        let named = options.tx_macs.iter().filter(|mac| !senders.iter().any(|(own, _)| own == *mac));
        let silent: Vec<Mac> = named.copied().collect();
        let link = |(mac, sender): &(Mac, Sender)| LinkReport {
            mac: Some(*mac).filter(|mac| !mac.is_zero()),
            matched: None,
            link: None,
            bearing: bearing(sender, &array, trajectory, &options),
        };
        let mut links: Vec<LinkReport> = senders.iter().map(link).collect();
        let unheard = |mac| LinkReport { mac: Some(mac), matched: None, link: None, bearing: Err(LinkError::Unheard) };
        links.extend(silent.into_iter().map(unheard));
        CaptureReport { receiver: log, transmitters: Vec::new(), links }
    }
}

/// Bearings to all senders in a 5300's log, by two or three antennas on a turning robot.
///
/// # Errors
/// If the log cannot be read. A sender without a bearing has its error in [`LinkReport::bearing`]; the others continue.
pub fn one_log(
    log: &mut (dyn CsiSource + Send),
    trajectory: &Trajectory,
    array: &Array,
    options: &Options,
) -> Result<CaptureReport, Error> {
    let mut one = OneLog::new(array.clone(), options.clone());
    let mut now = Instant::ZERO;
    loop {
        let next = log.receive(now)?;
        one.note(&next);
        match next {
            Next::End(_) => return Ok(one.bearings(trajectory)),
            Next::Pending => match log.next_at() {
                Some(at) => now = at.max(now),
                None => return Err(Error::Endless),
            },
            Next::Record(..) | Next::Lost(_) => {}
        }
    }
}

/// The samples of one baseline, and the row of each.
struct Baseline {
    samples: Samples,
    rows: Vec<usize>,
    /// Where the first antenna was, metres from the middle of its path; empty if the path is too short to matter.
    places_m: Vec<Vector3<f64>>,
}

impl Baseline {
    /// The samples without the phases that a wave from a place would have.
    fn steered(&self, place: &Place) -> Vec<Complex64> {
        let feet = self.feet_m();
        let drive = Ways { points: &self.places_m, feet: &feet, ends: &[] };
        let ways = if feet.is_empty() { Ways::to(self.samples.receiver_m()) } else { drive };
        ways.turned(&self.samples, place)
    }

    /// Where the other antenna was, metres, as [`Self::places_m`].
    fn feet_m(&self) -> Vec<Vector3<f64>> {
        self.places_m.iter().zip(self.samples.receiver_m()).map(|(place, arm)| place - arm).collect()
    }
}

/// The samples of all baselines, combined in one array.
struct Together {
    /// Anchors of known constants first, then measured samples.
    samples: Samples,
    anchors: usize,
    /// The baseline and row of each measured sample.
    rows: Vec<(usize, usize)>,
    /// The rotation that removed each baseline's constant.
    turns: Vec<Complex64>,
    drive: Option<MovingArray>,
}

/// The records of one sender on the turning robot.
struct Joined {
    baselines: Vec<Baseline>,
    fates: Vec<Fate>,
    /// Path of the first baseline's end over the whole trajectory.
    arm: Trajectory,
    length_m: f64,
    /// The mean place of the first antenna, metres.
    middle_m: Vector3<f64>,
    drives: bool,
}

/// The end of a baseline at a time within the trajectory, metres.
fn end_m(arm: &Trajectory, t_s: f64, length_m: f64) -> Option<Vector3<f64>> {
    // Interpolation between two poses follows the chord of the turn, so the length is restored.
    arm.at(t_s).and_then(|pose| UnitVector3::try_new(pose.position_m, 0.1 * GATE_ARM_M)).map(|way| *way * length_m)
}

impl Joined {
    fn new(
        rows: &[Row],
        times_s: &[Option<f64>],
        array: &Array,
        trajectory: &Trajectory,
        options: &Options,
    ) -> Result<Self, LinkError> {
        let first_s = times_s.iter().flatten().next().copied().unwrap_or_default();
        let mut fates = vec![Fate::Cut; rows.len()];
        let (mut baselines, mut first_arm) = (Vec::new(), None);
        for (k, baseline_m) in array.baselines_m().enumerate() {
            let length_m = baseline_m.norm();
            let arm = trajectory.of_arm(baseline_m * (GATE_ARM_M / length_m)).map_err(|error| match error {
                TrajectoryError::NoHeading => LinkError::NoAttitude,
                _ => LinkError::NotTurned { records: rows.len() },
            })?;
            let motion = arm.motion();
            let samples = Samples::new(options.channel.wavelength_m(), 1)?;
            let mut own = Baseline { samples, rows: Vec::new(), places_m: Vec::new() };
            for (at, (row, t_s)) in rows.iter().zip(times_s).enumerate() {
                let place = t_s.and_then(|t_s| Some((t_s, end_m(&arm, t_s, length_m)?)));
                let fate = match (place, t_s) {
                    (_, Some(t_s)) if !options.keeps(t_s - first_s) => Fate::Cut,
                    (None, _) => Fate::NoPose,
                    (Some((t_s, _)), _) if array.constants.is_empty() && !arm.moves(&motion, t_s) => Fate::Standing,
                    (Some((t_s, end_m)), _) => {
                        own.samples.push(t_s, row.z(k), end_m, Vector3::zeros())?;
                        own.rows.push(at);
                        let own_m = trajectory.at(t_s).map_or_else(Vector3::zeros, |pose| pose.position_m);
                        own.places_m.push(own_m);
                        Fate::Used
                    }
                };
                fates[at] = fates[at].max(fate);
            }
            baselines.push(own);
            first_arm.get_or_insert((arm, length_m));
        }
        let (arm, length_m) = first_arm.ok_or(LinkError::NotTurned { records: rows.len() })?;
        let places_m: Vec<Vector3<f64>> = baselines.iter().flat_map(|own| own.places_m.iter().copied()).collect();
        let middle_m = places_m.iter().sum::<Vector3<f64>>() / places_m.len().max(1) as f64;
        let longest_m = array.baselines_m().map(|baseline_m| baseline_m.norm()).fold(0.0, f64::max);
        // A turn moves the other antennas about the first.
        let turns_m = if array.is_placed { longest_m } else { 0.0 };
        let drives = options.accuracy.near_field
            && !MovingArray::is_short(&places_m, (longest_m, turns_m), options.channel.wavelength_m());
        for own in &mut baselines {
            own.places_m.retain(|_| drives);
            own.places_m.iter_mut().for_each(|place| *place -= middle_m);
        }
        Ok(Self { baselines, fates, arm, length_m, middle_m, drives })
    }

    /// The array on the drive: `anchors` samples at the origin, then those of all baselines. Each baseline has a phase of its own, unless
    /// the constants are known. `None` if the robot does not drive.
    fn drive(&self, anchors: usize) -> Option<MovingArray> {
        let mut drive = MovingArray {
            ends_m: vec![Vector3::zeros(); anchors],
            feet_m: vec![Vector3::zeros(); anchors],
            parts: Vec::new(),
        };
        for own in self.baselines.iter().filter(|own| !own.samples.is_empty()) {
            drive.ends_m.extend(&own.places_m);
            drive.feet_m.extend(own.feet_m());
            drive.parts.push(drive.feet_m.len());
        }
        if anchors > 0 {
            drive.parts = vec![drive.feet_m.len()];
        }
        self.drives.then_some(drive)
    }

    fn counts(&self, heard: usize) -> PairCounts {
        let thinned = heard - self.fates.len();
        let mut counts = PairCounts { formed: heard, thinned, ..PairCounts::default() };
        self.fates.iter().for_each(|fate| counts.add(*fate));
        counts
    }

    /// Combines the samples of all baselines in one array.
    ///
    /// Each baseline's constant is unknown. Relative to the mean of the baseline's samples it does not depend on the direction,
    /// to first order. So after centring each baseline and removing its constant, one common constant is left.
    fn together(&self, options: &Options) -> Result<Together, LinkError> {
        let heard: Vec<(usize, &Baseline)> =
            self.baselines.iter().enumerate().filter(|(_, own)| !own.samples.is_empty()).collect();
        let rows = |(k, own): &(usize, &Baseline)| own.rows.iter().map(|row| (*k, *row)).collect::<Vec<_>>();
        let all_rows: Vec<(usize, usize)> = heard.iter().flat_map(rows).collect();
        if let [(_, only)] = heard[..] {
            let (samples, turns) = (only.samples.clone(), vec![Complex64::ONE; self.baselines.len()]);
            return Ok(Together { samples, anchors: 0, rows: all_rows, turns, drive: self.drive(0) });
        }
        let groups: Vec<Vec<(Vector3<f64>, Complex64)>> =
            heard.iter().map(|(_, own)| about_middle(&own.samples)).collect();
        let constants = constants(&groups, options);
        let mut turns = vec![Complex64::ONE; self.baselines.len()];
        let mut all = Samples::new(options.channel.wavelength_m(), 1)?;
        for (((k, own), group), constant) in heard.iter().zip(&groups).zip(&constants) {
            turns[*k] = constant.conj();
            for ((place_m, z), t_s) in group.iter().zip(own.samples.t_s()) {
                all.push(*t_s, z * constant.conj(), *place_m, Vector3::zeros())?;
            }
        }
        Ok(Together { samples: all, anchors: 0, rows: all_rows, turns, drive: self.drive(0) })
    }

    /// As [`Self::together`], with known constants: adds one sample of phase 0 at the origin for each measured one.
    fn anchored(&self, constants: &[ChainConstant], options: &Options) -> Result<Together, LinkError> {
        let turns: Vec<Complex64> = constants.iter().map(|constant| Complex64::cis(-constant.rad)).collect();
        let mut all = Samples::new(options.channel.wavelength_m(), 1)?;
        let heard = || self.baselines.iter().map(|own| &own.samples);
        let anchors: usize = heard().map(Samples::len).sum();
        let first_s = heard().filter_map(|own| own.t_s().first()).fold(f64::MAX, |first, t_s| first.min(*t_s));
        for _ in 0..anchors {
            all.push(first_s, Complex64::ONE, Vector3::zeros(), Vector3::zeros())?;
        }
        for (own, turn) in heard().zip(&turns) {
            for ((place_m, z), t_s) in own.receiver_m().iter().zip(own.z()).zip(own.t_s()) {
                all.push(*t_s, z * turn, *place_m, Vector3::zeros())?;
            }
        }
        let rows = self.baselines.iter().enumerate().flat_map(|(k, own)| own.rows.iter().map(move |row| (k, *row)));
        Ok(Together { samples: all, anchors, rows: rows.collect(), turns, drive: self.drive(anchors) })
    }

    /// The first given constant that the turn contradicts, if any.
    fn contradiction(
        &self,
        sender: &Sender,
        given: &[ChainConstant],
        trajectory: &Trajectory,
        options: &Options,
    ) -> Result<Option<LinkError>, LinkError> {
        let apart = |own: &Baseline| {
            let places = own.samples.receiver_m();
            places.first().is_some_and(|first| places.iter().any(|m| (m - first).norm() > TELLING * first.norm()))
        };
        if given.is_empty() || !self.baselines.iter().any(apart) {
            return Ok(None);
        }
        let together = self.together(options)?;
        let found = self.estimate(&together, sender, trajectory, options)?;
        let is_steady = found.plane_wave.coherence > BY_CHANCE / (together.rows.len() as f64).sqrt();
        let is_clear = is_steady && found.modes.first().is_some_and(|first| first.mass > CLEAR_SHARE);
        let Some(towards) = Towards::of(&found).filter(|_| is_clear) else { return Ok(None) };
        let wrong = |(given, turn): (&ChainConstant, ChainConstant)| {
            let off_rad = wrap_rad(given.rad - turn.rad).abs();
            (off_rad > CONTRADICTS_SD * given.sd_rad.hypot(turn.sd_rad) && off_rad > CONTRADICTS_RAD).then_some(
                LinkError::WrongConstant {
                    given_deg: given.rad.to_degrees(),
                    turn_deg: turn.rad.to_degrees(),
                    sd_deg: turn.sd_rad.to_degrees(),
                },
            )
        };
        Ok(given.iter().zip(self.constants(&towards)).find_map(wrong))
    }

    /// The posterior of the direction.
    fn estimate(
        &self,
        together: &Together,
        sender: &Sender,
        trajectory: &Trajectory,
        options: &Options,
    ) -> Result<Found, LinkError> {
        let planes = |(baseline, row): &(usize, usize)| {
            let turn = together.turns.get(*baseline).copied().unwrap_or(Complex64::ONE);
            sender.rows.get(*row).map_or(Planes::ZERO, |row| row.planes(*baseline, turn))
        };
        let all: Vec<usize> = (0..together.samples.len()).collect();
        let rows =
            || std::iter::repeat_n(Planes::ONE, together.anchors).chain(together.rows.iter().map(planes)).collect();
        // A ruler measured the baseline; noise of the attitude makes a small turn seem larger (errors in variables).
        let noise = if together.anchors > 0 { 0.0 } else { self.noise_of_turn() };
        let (bend_rad, scale_sd) = (0.0, heading::scale_sd(noise));
        // Turns show the direction wherever the antennas are on the robot.
        let at_wheels = (trajectory.kind() == TrajectoryKind::Wheels).then_some(heading::WHEELS_RAD);
        let options = Options { heading_sd_rad: options.heading_sd_rad.or(at_wheels), ..options.clone() };
        let drive = together.drive.as_ref();
        let task = Task { bend_rad, scale_sd, drive, ..options.task(&together.samples, trajectory) };
        Ok(estimate(&task, rows, &all)?)
    }

    /// The variance of the attitude's noise over that of the turn.
    fn noise_of_turn(&self) -> f64 {
        let (mut apart, mut whole) = (0.0, 0.0);
        for own in &self.baselines {
            let ends = own.samples.receiver_m();
            let middle_m = ends.iter().sum::<Vector3<f64>>() / ends.len().max(1) as f64;
            apart += ends.iter().map(|end| (end - middle_m).norm_squared()).sum::<f64>();
            whole += ends.iter().map(|end| end.norm_squared()).sum::<f64>();
        }
        if apart > 0.0 { (ATTITUDE_SD_RAD.powi(2) * whole / apart).min(1.0) } else { 0.0 }
    }

    /// The path of the robot if it drives, else of the end of its first baseline, metres.
    fn path_m(&self, trajectory: &Trajectory) -> Vec<Vector3<f64>> {
        let (path, scale) = if self.drives { (trajectory, 1.0) } else { (&self.arm, self.length_m / GATE_ARM_M) };
        path.poses().iter().map(|pose| pose.position_m * scale).collect()
    }

    /// What an antenna's error of `sd_m`, metres, on the robot adds to the covariance of azimuth, elevation and 1 / range of the first
    /// mode, by least squares. The error turns with the robot, so whole turns leave little of it.
    fn covariance_on_robot(&self, found: &Found, sd_m: f64, with_constants: bool) -> Matrix3<f64> {
        const STEP: f64 = 1e-4;
        let Some(first) = found.modes.first() else { return Matrix3::zeros() };
        let place = Place { curve: found.expected_curve(), ..first.place };
        let of_place = [
            Place { azimuth: place.azimuth + STEP, ..place },
            Place { elevation: place.elevation + STEP, ..place },
            Place { curve: place.curve + STEP, ..place },
        ];
        let of_robot = [[STEP, 0.0], [0.0, STEP]];
        let changes = of_place.map(|to| (to, [0.0; 2])).into_iter().chain(of_robot.map(|off| (place, off)));
        let opens = |is_open: bool| f64::from(u8::from(is_open));
        let elevation_is_open = found.prior.elevation_is_open();
        let (mut information, mut slopes) = (Matrix3::zeros(), Matrix3x2::zeros());
        for own in &self.baselines {
            let ways = |(place, [along, across]): (Place, [f64; 2])| -> Vec<f64> {
                let way_m = place.ways_m();
                let of = |(k, arm): (usize, &Vector3<f64>)| {
                    let ahead = arm.xy().try_normalize(0.0).unwrap_or_default();
                    let off = Vector3::new(along * ahead.x - across * ahead.y, along * ahead.y + across * ahead.x, 0.0);
                    let end = own.places_m.get(k).copied().unwrap_or_default() + off;
                    way_m(&end) - way_m(&(end - arm))
                };
                own.samples.receiver_m().iter().enumerate().map(of).collect()
            };
            let still = ways((place, [0.0; 2]));
            let slope = |change| {
                let each: Vec<f64> = ways(change).iter().zip(&still).map(|(way, still)| (way - still) / STEP).collect();
                let mean = if with_constants { 0.0 } else { each.iter().sum::<f64>() / each.len().max(1) as f64 };
                each.into_iter().map(|slope| slope - mean).collect()
            };
            let each: Vec<Vec<f64>> = changes.clone().map(slope).collect();
            let [azimuth, elevation, curve, along, across] = &each[..] else { continue };
            for ((((a, e), c), along), across) in azimuth.iter().zip(elevation).zip(curve).zip(along).zip(across) {
                let gradient = Vector3::new(*a, e * opens(elevation_is_open), c * opens(self.drives));
                information += gradient * gradient.transpose();
                slopes += gradient * Vector2::new(*along, *across).transpose();
            }
        }
        let [elevation_sd, _] = found.prior.deviations();
        // Azimuths are uniform over the circle.
        let prior_sd = Vector3::new(1.8, elevation_sd.max(1e-3), found.prior.curve_max.max(1e-3) / 12f64.sqrt());
        let floor = Matrix3::from_diagonal(&prior_sd.map(|sd| (WAY_SD_M / sd).powi(2)));
        let moves = (information + floor).try_inverse().unwrap_or_default() * slopes * sd_m;
        moves * moves.transpose()
    }

    /// Coherence of the samples with a wave from a place, whatever the constants.
    fn coherence(&self, place: &Place) -> f64 {
        let sums = self.baselines.iter().map(|own| own.steered(place).iter().sum::<Complex64>().norm());
        let count: usize = self.baselines.iter().map(|own| own.samples.len()).sum();
        sums.sum::<f64>() / count.max(1) as f64
    }

    /// The constants, given the direction of the transmitter.
    fn constants(&self, towards: &Towards) -> Vec<ChainConstant> {
        self.baselines.iter().map(|own| towards.constant(own)).collect()
    }
}

/// A place and the deviations of its direction.
struct Towards {
    place: Place,
    azimuth_sd_rad: f64,
    elevation_sd_rad: f64,
}

impl Towards {
    fn of(found: &Found) -> Option<Self> {
        let first = found.modes.first()?;
        Some(Self {
            place: first.place,
            azimuth_sd_rad: found.direction_sd_rad(),
            elevation_sd_rad: first.covariance[(1, 1)].max(0.0).sqrt(),
        })
    }

    /// Derivative of a place's phase by azimuth and by elevation.
    fn slopes(&self, place_m: &Vector3<f64>, wavelength_m: f64) -> [f64; 2] {
        let ((sin_a, cos_a), (sin_e, cos_e)) = (self.place.azimuth.sin_cos(), self.place.elevation.sin_cos());
        let by_azimuth = Vector3::new(-sin_a, cos_a, 0.0) * cos_e;
        let by_elevation = Vector3::new(-cos_a * sin_e, -sin_a * sin_e, cos_e);
        [by_azimuth, by_elevation].map(|by| TAU / wavelength_m * by.dot(place_m))
    }

    /// The residual phase of a baseline and its deviation: from the spread of correlated samples, and from the direction's
    /// error, if the turn is not centred.
    fn constant(&self, baseline: &Baseline) -> ChainConstant {
        let samples = &baseline.samples;
        let (n, wavelength_m) = (samples.len().max(1) as f64, samples.wavelength_m());
        let left = baseline.steered(&self.place);
        let rad = left.iter().sum::<Complex64>().arg();
        let off: Vec<f64> = left.iter().map(|z| (z * Complex64::cis(-rad)).arg()).collect();
        let square: f64 = off.iter().map(|rad| rad * rad).sum();
        let shared: f64 = off.windows(2).map(|two| two[0] * two[1]).sum::<f64>() / square.max(f64::MIN_POSITIVE);
        let alike = shared.clamp(0.0, 0.99);
        let spread = square / n / n * (1.0 + alike) / (1.0 - alike);
        let middle_m = samples.receiver_m().iter().sum::<Vector3<f64>>() / n;
        let [by_azimuth, by_elevation] = self.slopes(&middle_m, wavelength_m);
        let by_direction = (by_azimuth * self.azimuth_sd_rad).hypot(by_elevation * self.elevation_sd_rad);
        ChainConstant { rad, sd_rad: spread.sqrt().hypot(by_direction) }
    }

    /// Deviation of the azimuth due to the constants' deviations, by least squares.
    fn azimuth_sd_of(&self, constants: &[ChainConstant], together: &Together) -> f64 {
        let places = together.samples.receiver_m();
        let middle_m = places.iter().sum::<Vector3<f64>>() / places.len().max(1) as f64;
        let slope = |place_m: &Vector3<f64>| self.slopes(&(place_m - middle_m), together.samples.wavelength_m())[0];
        let all: f64 = places.iter().map(|place_m| slope(place_m).powi(2)).sum();
        let of = |(k, constant): (usize, &ChainConstant)| {
            let own = together.rows.iter().zip(places.iter().skip(together.anchors)).filter(|((own, _), _)| *own == k);
            (constant.sd_rad * own.map(|(_, place_m)| slope(place_m)).sum::<f64>()).powi(2)
        };
        let sum: f64 = constants.iter().enumerate().map(of).sum();
        sum.sqrt() / all.max(f64::MIN_POSITIVE)
    }
}

fn about_middle(samples: &Samples) -> Vec<(Vector3<f64>, Complex64)> {
    let middle_m = samples.receiver_m().iter().sum::<Vector3<f64>>() / samples.len().max(1) as f64;
    samples.receiver_m().iter().zip(samples.z()).map(|(place_m, z)| (place_m - middle_m, *z)).collect()
}

/// The sum of a baseline's samples, steered towards a direction.
fn steered(group: &[(Vector3<f64>, Complex64)], towards: &Vector3<f64>, wavelength_m: f64, step: usize) -> Complex64 {
    let turn =
        |(place_m, z): &(Vector3<f64>, Complex64)| z * Complex64::cis(-TAU * towards.dot(place_m) / wavelength_m);
    group.iter().step_by(step.max(1)).map(turn).sum()
}

/// The constant of each baseline at the direction with the greatest sum of magnitudes, the likeliest one for unknown
/// constants.
fn constants(groups: &[Vec<(Vector3<f64>, Complex64)>], options: &Options) -> Vec<Complex64> {
    let wavelength_m = options.channel.wavelength_m();
    let highest = options.accuracy.elevation_max_rad.unwrap_or(FRAC_PI_2);
    let radius_m = groups.iter().flatten().map(|(place_m, _)| place_m.norm()).fold(0.0, f64::max);
    let height_m = groups.iter().flatten().map(|(place_m, _)| place_m.z.abs()).fold(0.0, f64::max);
    let lowest = if height_m > 1e-3 * radius_m { -highest } else { 0.0 };
    let sum = |[azimuth, elevation]: [f64; 2], rough: bool| -> f64 {
        let towards = bartlett::direction(azimuth, elevation);
        let size = |group: &Vec<(Vector3<f64>, Complex64)>| {
            let step = if rough { group.len().div_ceil(ROUGH_ROWS) } else { 1 };
            steered(group, &towards, wavelength_m, step).norm() * step as f64
        };
        groups.iter().map(size).sum()
    };
    // Eight directions per width of the main lobe.
    let mut step = (wavelength_m / (16.0 * radius_m.max(1e-3))).clamp(0.01, 0.1);
    let count = |width: f64| (width / step).ceil().max(1.0) as usize;
    let heights = if highest > 0.0 { count(highest - lowest) } else { 0 };
    let (mut best, mut at) = (f64::MIN, [0.0, 0.0]);
    for e in 0..=heights {
        let elevation = lowest + (highest - lowest) * e as f64 / heights.max(1) as f64;
        for a in 0..count(TAU) {
            let here = [a as f64 * step, elevation];
            let value = sum(here, true);
            if value > best {
                (best, at) = (value, here);
            }
        }
    }
    best = sum(at, false);
    while step > 1e-6 {
        let [azimuth, elevation] = at;
        let bounded = |elevation: f64| elevation.clamp(lowest, highest);
        let near = [
            [azimuth + step, elevation],
            [azimuth - step, elevation],
            [azimuth, bounded(elevation + step)],
            [azimuth, bounded(elevation - step)],
        ];
        let better = near.into_iter().map(|here| (sum(here, false), here)).max_by(|a, b| a.0.total_cmp(&b.0));
        match better.filter(|(value, _)| *value > best) {
            Some((value, here)) => (best, at) = (value, here),
            None => step *= 0.5,
        }
    }
    let towards = bartlett::direction(at[0], at[1]);
    let constant = |group: &Vec<(Vector3<f64>, Complex64)>| {
        let sum = steered(group, &towards, wavelength_m, 1);
        if sum.norm() > 0.0 { sum / sum.norm() } else { Complex64::ONE }
    };
    groups.iter().map(constant).collect()
}

/// The bearing to one sender.
fn bearing(sender: &Sender, array: &Array, trajectory: &Trajectory, options: &Options) -> Result<Bearing, LinkError> {
    options.check()?;
    let rows = sender.rows.iter().map(|row| (row.host_us, row.row));
    let times_s = times_s(rows, trajectory, options)?;
    let joined = Joined::new(&sender.rows, &times_s, array, trajectory, options)?;
    let counts = joined.counts(sender.heard);
    if counts.in_motion == 0 {
        let still = LinkError::NotTurned { records: counts.formed };
        return Err(nothing(&counts, times_s.iter().flatten().copied(), trajectory, still));
    }
    let together = match &array.constants[..] {
        [] => joined.together(options)?,
        known => joined.anchored(known, options)?,
    };
    let Together { samples, anchors, rows: used, .. } = &together;
    let mut options = options.clone();
    options.accuracy.near_field = joined.drives;
    // One card has one sampling clock, so slopes do not differ between packets.
    options.accuracy.align = false;
    options.odometry_sd_m = options.odometry_sd_m.min(ATTITUDE_SD_RAD * joined.length_m);
    if let Some(wrong) = joined.contradiction(sender, &array.constants, trajectory, &options)? {
        return Err(wrong);
    }
    let mut found = joined.estimate(&together, sender, trajectory, &options)?;
    let towards = Towards::of(&found);
    let coherence = match &towards {
        Some(towards) if joined.drives || *anchors > 0 => joined.coherence(&towards.place),
        _ => found.plane_wave.coherence,
    };
    if coherence <= BY_CHANCE / (used.len() as f64).sqrt() {
        return Err(LinkError::Unsteady { records: used.len(), coherence });
    }
    let constants_sd_rad = towards.as_ref().map_or(0.0, |towards| towards.azimuth_sd_of(&array.constants, &together));
    let place_sd_m = if array.is_placed { GIVEN_SD_M } else { ON_ROBOT_SD_M };
    let off = joined.covariance_on_robot(&found, place_sd_m, *anchors > 0);
    if let Some(first) = found.modes.first_mut() {
        first.covariance += off;
    }
    let off_rad = off[(0, 0)].sqrt();
    found.blur.heading_rad = found.blur.heading_rad.hypot(constants_sd_rad).hypot(off_rad);
    found.middle_m = joined.middle_m;
    let last_s = samples.t_s().iter().skip(*anchors).copied().fold(f64::MIN, f64::max);
    let last = trajectory.at(last_s);
    let keeps = options.keep_course;
    let [wsr_profile_variance, likelihood_share] = profile_figures(samples)?;
    Ok(Bearing {
        answer: BearingAnswer::of(&found, samples),
        sufficient: found.sufficient,
        heading_rad: last.and_then(|pose| pose.heading_rad),
        wsr_profile_variance,
        likelihood_share,
        compensated: false,
        turn_around: None,
        range_change: None,
        odometry_fit: None,
        clock_offset: None,
        pairs: counts,
        mean_position_m: joined.middle_m,
        end_m: last.map_or(joined.middle_m, |pose| pose.position_m),
        density: if keeps { found.density(DENSITY_AZIMUTHS) } else { Vec::new() },
        slope_sd_rad: None,
        plane_wave: found.plane_wave.clone(),
        course: if keeps { course(sender, &times_s, &joined) } else { Vec::new() },
        path_m: if keeps { joined.path_m(trajectory) } else { Vec::new() },
        drive: together.drive.clone(),
        chain_constants: towards.filter(|_| *anchors == 0).map(|at| joined.constants(&at)).unwrap_or_default(),
        samples: samples.clone(),
        found,
        kinds_rad: Vec::new(),
    })
}

/// The phase of the first baseline in each record.
fn course(sender: &Sender, times_s: &[Option<f64>], joined: &Joined) -> Vec<Phase> {
    let first_s = times_s.iter().flatten().next().copied().unwrap_or_default();
    let phase = |((row, t_s), fate): ((&Row, &Option<f64>), &Fate)| {
        let rad = row.z(0).arg();
        let t_s = t_s.as_ref()? - first_s;
        let is_used = *fate == Fate::Used;
        Some(Phase { t_s, one_way_rad: rad, round_trip_rad: rad, compensated_rad: rad, is_used })
    };
    sender.rows.iter().zip(times_s).zip(&joined.fates).filter_map(phase).collect()
}
