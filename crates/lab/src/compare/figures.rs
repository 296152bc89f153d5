//! Measures a capture: what each robot's log shows of its card, driver and host, and the two logs together.

use super::{NO_TRANSMITTER, ONE_ROBOT};
use crate::Failure;
use csi5300::internal::{SENDERS_KEPT, drift_line};
use csi5300::maths::{nearest_rank, wrap_rad};
use csi5300::motion::pose::Trajectory;
use csi5300::pipeline::{Bearing, CaptureReport, Options, Phase, Transmitter, bearings};
use csi5300::source::survey::{Identity, Survey};
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::{Instant, Unwrap32};
use csi5300_sim::motion::RobotMotion;
use csi5300_sim::{Port, Room, Scene};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Bfee, SUBCARRIERS};
use driver_iface::record::Tail;
use num_complex::Complex64;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Figures of a capture of one link.
#[derive(Clone, Debug)]
pub struct Figures {
    /// The log of the robot that moved: backward frames.
    pub receiver: SideFigures,
    /// The other robot's log: forward frames.
    pub transmitter: SideFigures,
    /// Figures of both logs together.
    pub link: LinkFigures,
}

/// Figures of two logs together.
#[derive(Clone, Debug, Default)]
pub struct LinkFigures {
    /// Pairs formed.
    pub pairs: usize,
    /// Carrier frequency offset, Hz; `None` if the turn-arounds jitter too little to show it.
    pub df_hz: Option<f64>,
    /// Drift of the transmitter's card clock against the receiver's, parts per million.
    pub drift_ppm: f64,
    /// Host clock of the transmitter minus the receiver's, median over the pairs, seconds; `None` without host times.
    pub host_apart_s: Option<f64>,
    /// Turn-around minus its median and drift, microseconds: the lateness of an answer.
    pub turn_around_us: Distribution,
    /// Standard deviation of the turn-arounds within [`CORE_US`] of the median, from their quartiles.
    pub core_us: f64,
    /// The other turn-arounds: early (by up to [`FAR_US`]), earlier, late.
    pub groups: [LateGroup; 3],
    /// Mean run length of answers outside the core; `None` if pairs in between were skipped.
    pub run: Option<f64>,
    /// Spread of the round trip's phase from packet to packet before turn-around compensation, radians: the circular
    /// standard deviation of its second difference over sqrt(6), so that motion does not count.
    pub spread_before_rad: f64,
    /// The same after compensation.
    pub spread_after_rad: f64,
    /// `|sum z a| / sum |z|` of the best-fitting plane wave, all pairs in motion; `None` without motion.
    pub coherence: Option<f64>,
    /// Mean coherence within windows of a second, which a curved wave front does not lower; `None` without motion.
    pub short_coherence: Option<f64>,
    /// Azimuth of the transmitter, degrees.
    pub azimuth_deg: Option<f64>,
    /// |elevation| of the bearing, degrees.
    pub abs_elevation_deg: Option<f64>,
    /// Its elevation with its sign, degrees, where the motion distinguishes up from down.
    pub elevation_deg: Option<f64>,
    /// Estimated place of the transmitter, metres, trajectory's frame.
    pub place_m: Option<[f64; 3]>,
    /// The phase of every pair, for pictures.
    pub course: Vec<Phase>,
    /// Turn-around minus median and drift of each pair, for pictures.
    pub late_us: Vec<f64>,
}

/// Turn-arounds outside the core, or frames sent late.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LateGroup {
    /// Share of all.
    pub share: f64,
    /// Mean lateness relative to the core, microseconds.
    pub mean_us: f64,
    /// Standard deviation, microseconds.
    pub sd_us: f64,
}

impl LateGroup {
    /// Of these latenesses among so many frames.
    fn of(late_us: &[f64], all: usize) -> Self {
        let late = Distribution::of(late_us);
        Self { share: late_us.len() as f64 / all.max(1) as f64, mean_us: late.mean, sd_us: late.sd }
    }
}

impl LinkFigures {
    /// Share of the turn-arounds outside the core.
    #[must_use]
    pub fn away(&self) -> f64 {
        self.groups.iter().map(|group| group.share).sum()
    }
}

/// Answers further than this from the usual turn-around are outside its core, microseconds.
///
/// Measured: 18,320 answers in the six real captures of \[paper\] (docs/reference/references.md), minus the running median of
/// 121, in steps of 10 us. The histogram peaks at 8,802 from 0 to 10 us and falls to less than a hundredth of that at 30 us on
/// either side. It is lowest (16 to 20 a step) from 40 to 60 us early. Half of each core is within 2 to 4 us.
pub const CORE_US: f64 = 25.0;
/// Answers earlier than this form a group of their own, microseconds.
///
/// From the same histogram: the early answers peak at 130 us (720 a step) and at 210 to 220 us (95); the lowest step in between
/// starts here (78).
pub const FAR_US: f64 = 160.0;
/// Answers and frames later than this are outliers, microseconds: the same histogram is empty beyond 310 us early and beyond
/// 200 us late, except for four answers 1,140 to 1,490 us late.
const LOST_US: f64 = 400.0;
/// Assumed range if the curvature shows none, metres.
const USUAL_RANGE_M: f64 = 4.0;
/// Windows of the short coherence, seconds.
const WINDOW_S: f64 = 1.0;
/// Rows per second of a simulated trajectory.
const TRUTH_HZ: f64 = 180.0;

/// Measures a capture; `trajectory` is the receiver's, `displaced` the transmitter's if it moved.
///
/// # Errors
/// If a log cannot be read, or the two have no frame in common.
pub fn measure(
    receiver: &mut (dyn CsiSource + Send),
    transmitter: &mut (dyn CsiSource + Send),
    trajectory: &Trajectory,
    displaced: Option<&Trajectory>,
    options: &Options,
) -> Result<Figures, Failure> {
    let indices = options.channel.subcarriers();
    let (mut rx, mut tx) = (Observed::new(receiver, indices), Observed::new(transmitter, indices));
    let options = Options { keep_course: true, ..options.clone() };
    let transmitters = vec![Transmitter { log: &mut tx, trajectory: displaced }];
    let report = bearings(&mut rx, transmitters, trajectory, &options)?;
    // Either log may contain other senders' frames; the link's sender has the most, as in the pipeline.
    let sender = report.links.first().and_then(|found| found.link.as_ref()).map(|link| link.mac);
    let (receiver, transmitter) = (rx.finish(sender), tx.finish(options.rx_mac));
    let link = link_figures(&report, &options)?;
    Ok(Figures { receiver, transmitter, link })
}

/// Simulates a scene in memory and measures the logs of its first initiator and the next robot, along the initiator's true path or a
/// sensor's trajectory.
///
/// # Errors
/// As [`measure`], and if the scene cannot be simulated.
pub fn measure_scene(scene: &Scene, trajectory: Option<&Trajectory>, options: &Options) -> Result<Figures, Failure> {
    let mut room = Room::new(scene)?;
    let receiver = scene.initiators().first().copied().unwrap_or(0);
    let other = usize::from(receiver == 0);
    let trajectory = match trajectory {
        Some(trajectory) => trajectory.clone(),
        None => true_path(&room, receiver)?,
    };
    let (Some(mut rx), Some(mut tx)) = (room.card(receiver), room.card(other)) else {
        return Err(ONE_ROBOT.into());
    };
    [&mut rx, &mut tx].into_iter().for_each(Port::own_only);
    let moves = scene.robot.get(other).is_some_and(|robot| robot.motion != RobotMotion::Static);
    let displaced = moves.then(|| true_path(&room, other)).transpose()?;
    measure(&mut rx, &mut tx, &trajectory, displaced.as_ref(), options)
}

/// The true path of a robot's antenna A on its host's clock.
///
/// # Errors
/// If the scene is too short for two poses.
pub fn true_path(room: &Room, robot: usize) -> Result<Trajectory, Failure> {
    let short = || format!("a scene of {} s is too short for two poses", room.scene().duration_s);
    room.true_path(robot, TRUTH_HZ).ok_or_else(|| short().into())
}

/// A tick of the card's clock, microseconds: turn-arounds that jitter by less show no carrier offset.
const CLOCK_TICK_US: f64 = 1.0;

fn link_figures(report: &CaptureReport, options: &Options) -> Result<LinkFigures, Failure> {
    let found = report.links.first().ok_or(NO_TRANSMITTER)?;
    let why = || found.bearing.as_ref().map_or_else(ToString::to_string, |_| "the logs have nothing in common".into());
    let link = found.link.as_ref().ok_or_else(why)?;
    let (turn_around, course) = link.phases(options);
    let turn = turn_around.ok_or_else(|| format!("{} pairs are too few to measure a link", course.len()))?;
    // The jitter is against the drift of the carriers; if these are unknown, against that of the clocks.
    let df_hz = (turn.worthwhile || turn.jitter_median_us >= CLOCK_TICK_US).then_some(turn.df_hz);
    let drift = df_hz.map_or(turn.df_hz / options.channel.centre_hz() - 1e-6 * turn.drift_ppm, |_| 0.0);
    let late = |(jitter_us, phase): (&f64, &Phase)| -jitter_us - drift * 1e6 * phase.t_s;
    let late_us: Vec<f64> = turn.jitter_us.iter().zip(&course).map(late).collect();
    let middle_us = Distribution::of(&late_us).median;
    let mut figures = LinkFigures {
        pairs: link.pairs(),
        df_hz,
        drift_ppm: turn.drift_ppm,
        host_apart_s: link.partner_ahead_s(),
        late_us: late_us.iter().map(|late| late - middle_us).collect(),
        spread_before_rad: spread_rad(turn.coherence_before),
        spread_after_rad: spread_rad(turn.coherence_after),
        ..LinkFigures::default()
    };
    turn_arounds(&mut figures);
    figures.run = figures.run.filter(|_| link.thinned() == 0);
    if let Ok(bearing) = &found.bearing {
        place(&mut figures, bearing);
    }
    figures.course = course;
    Ok(figures)
}

/// The circular standard deviation of one phase, from the coherence of second differences, whose variance is six times as
/// large.
#[must_use]
pub fn spread_rad(coherence: f64) -> f64 {
    (-2.0 * coherence.max(1e-12).ln() / 6.0).max(0.0).sqrt()
}

fn turn_arounds(figures: &mut LinkFigures) {
    figures.turn_around_us = Distribution::of(&figures.late_us);
    let middle_us = figures.turn_around_us.median;
    let within = |low: f64, high: f64| -> Vec<f64> {
        figures.late_us.iter().map(|late| late - middle_us).filter(|late| (low..high).contains(late)).collect()
    };
    figures.core_us = Distribution::of(&within(-CORE_US, CORE_US)).quartile_range() / QUARTILES;
    let group = |low: f64, high: f64| LateGroup::of(&within(low, high), figures.late_us.len());
    figures.groups = [group(-FAR_US, -CORE_US), group(-LOST_US, -FAR_US), group(CORE_US, LOST_US)];
    let away = |late: &f64| (late - middle_us).abs() > CORE_US;
    let runs: Vec<f64> = figures
        .late_us
        .chunk_by(|a, b| away(a) == away(b))
        .filter(|run| run.first().is_some_and(away))
        .map(|run| run.len() as f64)
        .collect();
    figures.run = Some(Distribution::of(&runs).mean);
}

fn place(figures: &mut LinkFigures, bearing: &Bearing) {
    let answer = &bearing.answer;
    figures.coherence = Some(bearing.plane_wave.coherence);
    figures.azimuth_deg = Some(answer.azimuth_rad.to_degrees());
    figures.abs_elevation_deg = Some(answer.abs_elevation_rad.to_degrees());
    figures.elevation_deg = answer.signed_elevation_rad.map(f64::to_degrees);
    let (sin, cos) = answer.azimuth_rad.sin_cos();
    let away_m = answer.range.map_or(USUAL_RANGE_M, |range| range.range_m);
    let middle = bearing.mean_position_m;
    let (up, level) = answer.signed_elevation_rad.unwrap_or(0.0).sin_cos();
    let (away_m, height_m) = (away_m * level, away_m * up);
    figures.place_m = Some([middle.x + away_m * cos, middle.y + away_m * sin, middle.z + height_m]);
    figures.short_coherence = short_coherence(bearing);
}

/// Mean over windows of the coherence with a plane wave from the answer's direction.
fn short_coherence(bearing: &Bearing) -> Option<f64> {
    let level = bearing.answer.abs_elevation_rad.cos();
    let up = bearing.answer.signed_elevation_rad.map_or(0.0, f64::sin);
    let (sin, cos) = bearing.answer.azimuth_rad.sin_cos();
    let samples = &bearing.samples;
    let displaced = samples.receiver_m().iter().zip(samples.transmitter_m()).map(|(rx, tx)| rx - tx);
    let turned = samples.z().iter().zip(displaced).map(|(z, p)| {
        let turns = 2.0 * (level * (p.x * cos + p.y * sin) + up * p.z) / samples.wavelength_m();
        z * Complex64::cis(-TAU * turns)
    });
    let timed: Vec<(f64, Complex64)> = samples.t_s().iter().copied().zip(turned).collect();
    let windows = timed.chunk_by(|a, b| (a.0 / WINDOW_S).floor() == (b.0 / WINDOW_S).floor());
    // A window that the motion only touches is not representative.
    let coherence = windows.filter(|window| window.len() >= 8).map(|window| {
        let (sum, norms) =
            window.iter().fold((Complex64::ZERO, 0.0), |(sum, norms), (_, z)| (sum + z, norms + z.norm()));
        sum.norm() / norms
    });
    let coherence: Vec<f64> = coherence.collect();
    (!coherence.is_empty()).then(|| coherence.iter().sum::<f64>() / coherence.len() as f64)
}

/// Number of records by the value of a field.
pub type Histogram = BTreeMap<i64, u64>;

/// Figures of one sender's frames in one log.
#[derive(Clone, Debug, Default)]
pub struct SideFigures {
    /// Intact bfee records of the sender.
    pub records: usize,
    /// Those of them in the stock layout.
    pub stock: usize,
    /// Records by length on disk, bytes.
    pub lengths: Histogram,
    /// Records by receive chains and streams, `10 n_rx + n_tx`.
    pub streams: Histogram,
    /// Records by `noise`, dBm.
    pub noise_dbm: Histogram,
    /// Records by `fake_rate_n_flags`.
    pub rates: Histogram,
    /// Records by `antenna_sel`.
    pub antenna_sel: Histogram,
    /// RSSI of antennas A, B, C, dB.
    pub rssi_db: [Distribution; 3],
    /// Gain, dB.
    pub agc_db: Distribution,
    /// Root mean square of the coefficients of antennas A, B, C, ADC steps.
    pub level: [Distribution; 3],
    /// Share of frame numbers that are missing between the first and the last.
    pub missing: f64,
    /// Time between frames of consecutive numbers on the card's clock, microseconds.
    pub interval_us: Distribution,
    /// Unusually late frames: by at least twice the interquartile range.
    pub delayed: LateGroup,
    /// The same on the host's clock.
    pub host_interval_us: Distribution,
    /// Host time minus card time without its drift, microseconds; its median is about 0.
    pub latency_us: Distribution,
    /// Standard deviation of its core: that of a normal distribution with the same shortest half, microseconds.
    pub latency_core_us: f64,
    /// How much faster the card's clock runs than the host's, parts per million.
    pub card_ppm: f64,
    /// Slope of the phase, radians per subcarrier index, antenna A.
    pub slope_rad: Distribution,
    /// Ripple of the magnitude over the subcarriers, standard deviation over mean, antenna A.
    pub ripple: Distribution,
    /// Mean magnitude of each subcarrier relative to the root mean square of all, antenna A: the filters' effect.
    pub filter: [f64; SUBCARRIERS],
    /// Signal to noise ratio of single subcarriers, from their change between packets, antenna A, dB.
    pub tone_snr_db: f64,
    /// First and last host time, microseconds since the Unix epoch.
    pub host_us: Option<(i64, i64)>,
    /// First and last time on the card's clock, unwrapped microseconds.
    pub clock_us: Option<(i64, i64)>,
    /// Bytes of a cut last record.
    pub tail_bytes: usize,
    /// Power at antenna A, RSSI minus gain, dB, by host time, seconds since the Unix epoch.
    pub powers: Vec<(f64, f64)>,
}

/// Passes a source's items on and measures its records.
struct Observed<'a> {
    source: &'a mut (dyn CsiSource + Send),
    /// The subcarriers of the source's channel.
    indices: [i8; SUBCARRIERS],
    survey: Survey,
    unwrap: Unwrap32,
    senders: BTreeMap<Mac, Collector>,
}

impl<'a> Observed<'a> {
    fn new(source: &'a mut (dyn CsiSource + Send), indices: [i8; SUBCARRIERS]) -> Self {
        let (survey, unwrap, senders) = (Survey::default(), Unwrap32::default(), BTreeMap::new());
        Self { source, indices, survey, unwrap, senders }
    }

    /// The figures of one sender; by default the one with the most numbered frames.
    fn finish(mut self, sender: Option<Mac>) -> SideFigures {
        let most = || self.senders.iter().max_by_key(|(_, collector)| collector.frames).map(|(mac, _)| *mac);
        let collector = sender.or_else(most).and_then(|mac| self.senders.remove(&mac));
        let mut side = collector.map_or_else(SideFigures::default, Collector::finish);
        if let Some(Tail::Cut { bytes, .. }) = self.survey.tail {
            side.tail_bytes = bytes as usize;
        }
        side
    }
}

impl CsiSource for Observed<'_> {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        let Self { source, indices, survey, unwrap, senders } = self;
        let next = source.receive(now)?;
        if let Some((bfee, identity)) = survey.note(&next) {
            let clock_us = unwrap.next(bfee.timestamp_low());
            if senders.len() < SENDERS_KEPT || senders.contains_key(&identity.mac) {
                let new = || Collector { indices: *indices, ..Collector::default() };
                let length = if let Next::Record(_, record) = &next { record.emit_len() } else { 0 };
                senders.entry(identity.mac).or_insert_with(new).note(&bfee, identity, clock_us, length);
            }
        }
        Ok(next)
    }

    fn next_at(&self) -> Option<Instant> {
        self.source.next_at()
    }
}

/// Values collected from one sender's frames.
#[derive(Default)]
struct Collector {
    indices: [i8; SUBCARRIERS],
    last: Option<LastFrame>,
    /// Frames with a number.
    frames: usize,
    /// Numbers present, and numbers expected.
    numbers: (u64, u64),
    side: SideFigures,
    rssi: [Vec<f64>; 3],
    agc: Vec<f64>,
    level: [Vec<f64>; 3],
    intervals: [Vec<f64>; 2],
    clocks: Vec<i64>,
    ahead: Vec<i64>,
    slopes: Vec<f64>,
    ripples: Vec<f64>,
    /// The last two packets, without slope and mean phase.
    rows: [Tones; 2],
    /// Noise power, and the number of tones it was summed over.
    noise: (f64, f64),
}

type Tones = [Complex64; SUBCARRIERS];

#[derive(Clone, Copy)]
struct LastFrame {
    number: u32,
    clock_us: i64,
    host_us: Option<i64>,
}

impl Collector {
    fn note(&mut self, bfee: &Bfee<'_>, identity: Identity, clock_us: i64, length: usize) {
        *self.side.lengths.entry(length as i64).or_default() += 1;
        self.fields(bfee);
        self.tones(bfee);
        if let Some(host_us) = identity.host_us {
            let power_db = f64::from(bfee.rssi()[0]) - f64::from(bfee.agc());
            self.side.powers.push((host_us as f64 * 1e-6, power_db));
            self.clocks.push(clock_us);
            self.ahead.push(host_us - clock_us);
            self.side.host_us = Some((self.side.host_us.map_or(host_us, |(first, _)| first), host_us));
        }
        self.step(identity, clock_us);
    }

    fn fields(&mut self, bfee: &Bfee<'_>) {
        let side = &mut self.side;
        side.records += 1;
        side.stock += usize::from(bfee.wsr().is_none());
        *side.streams.entry((10 * bfee.n_rx() + bfee.n_tx()) as i64).or_default() += 1;
        *side.noise_dbm.entry(bfee.noise_dbm().into()).or_default() += 1;
        *side.rates.entry(bfee.rate_n_flags().into()).or_default() += 1;
        *side.antenna_sel.entry(bfee.antenna_sel().into()).or_default() += 1;
        self.agc.push(f64::from(bfee.agc()));
        for (values, rssi) in self.rssi.iter_mut().zip(bfee.rssi()) {
            values.push(f64::from(rssi));
        }
    }

    fn tones(&mut self, bfee: &Bfee<'_>) {
        for antenna in 0..Antenna::ALL.len() {
            let Some(chain) = bfee.chain_of(Antenna::ALL[antenna]) else { continue };
            let Some(iq) = bfee.column(chain, 0) else { continue };
            let tones = iq.map(|iq| Complex64::new(f64::from(iq.i), f64::from(iq.q)));
            let rms = (tones.iter().map(Complex64::norm_sqr).sum::<f64>() / SUBCARRIERS as f64).sqrt();
            self.level[antenna].push(rms);
            if antenna == 0 && rms > 0.0 {
                let (slope, row) = flattened(&tones, rms, &self.indices);
                self.slopes.push(slope);
                self.side.filter.iter_mut().zip(&row).for_each(|(sum, h)| *sum += h.norm());
                let mean = row.iter().map(|h| h.norm()).sum::<f64>() / SUBCARRIERS as f64;
                self.ripples.push((1.0 - mean * mean).max(0.0).sqrt() / mean);
                change(&mut self.rows, &mut self.noise, row);
            }
        }
    }

    /// The step from the last frame to this one.
    fn step(&mut self, identity: Identity, clock_us: i64) {
        let Some(number) = identity.frame_count else { return };
        let this = LastFrame { number, clock_us, host_us: identity.host_us };
        self.frames += 1;
        let Some(before) = self.last.replace(this) else { return };
        let ahead = number.wrapping_sub(before.number);
        // A restart or a repeated number is not a gap.
        if (1..1_000).contains(&ahead) {
            self.numbers = (self.numbers.0 + 1, self.numbers.1 + u64::from(ahead));
        }
        if ahead == 1 {
            self.intervals[0].push((clock_us - before.clock_us) as f64);
            self.intervals[1].extend(this.host_us.zip(before.host_us).map(|(now, then)| (now - then) as f64));
        }
    }

    fn finish(self) -> SideFigures {
        let mut side = self.side;
        side.rssi_db = self.rssi.map(|values| Distribution::of(&values));
        side.level = self.level.map(|values| Distribution::of(&values));
        side.agc_db = Distribution::of(&self.agc);
        side.filter.iter_mut().for_each(|sum| *sum /= self.ripples.len().max(1) as f64);
        side.delayed = delayed(&self.intervals[0]);
        [side.interval_us, side.host_interval_us] = self.intervals.map(|values| Distribution::of(&values));
        side.slope_rad = Distribution::of(&self.slopes);
        side.ripple = Distribution::of(&self.ripples);
        let (there, all) = self.numbers;
        side.missing = if all == 0 { 0.0 } else { 1.0 - there as f64 / all as f64 };
        side.tone_snr_db = if self.noise.0 > 0.0 { -10.0 * (self.noise.0 / self.noise.1).log10() } else { f64::NAN };
        side.clock_us = self.clocks.first().copied().zip(self.clocks.last().copied());
        if let (8.., Some(&first)) = (self.ahead.len(), self.ahead.first()) {
            // Relative to the first: a double has too few digits for parts per million of microseconds since 1970.
            let ahead: Vec<i64> = self.ahead.iter().map(|ahead| ahead - first).collect();
            let line = drift_line(&self.clocks, &ahead);
            let late = self.clocks.iter().zip(&ahead).map(|(&clock, &ahead)| ahead as f64 - line.at(clock as f64));
            let late: Vec<f64> = late.collect();
            side.latency_us = Distribution::of(&late);
            side.latency_core_us = shortest_half(late) / QUARTILES;
            let from = self.clocks.first().map_or(0.0, |&clock| clock as f64);
            side.card_ppm = -(line.at(from + 1e6) - line.at(from));
        }
        side
    }
}

/// Unusually late frames. A late frame makes one interval longer and the next one shorter, so only the long ones are counted.
fn delayed(intervals_us: &[f64]) -> LateGroup {
    let usual = Distribution::of(intervals_us);
    let late = intervals_us.iter().map(|interval| interval - usual.median);
    let late: Vec<f64> = late.filter(|&late| late > 2.0 * usual.quartile_range() && late < LOST_US).collect();
    LateGroup::of(&late, intervals_us.len())
}

/// The most frequent value.
pub(super) fn usual(counts: &Histogram) -> Option<i64> {
    counts.iter().max_by_key(|(_, count)| **count).map(|(key, _)| *key)
}

/// Length of the shortest interval that holds half of the values: a few outliers on one side do not widen it.
fn shortest_half(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let lengths = values.iter().zip(values.iter().skip(values.len() / 2)).map(|(from, to)| to - from);
    lengths.min_by(f64::total_cmp).unwrap_or(0.0)
}

/// Power of the second difference of each subcarrier over time: six times its noise power.
fn change(rows: &mut [Tones; 2], noise: &mut (f64, f64), row: Tones) {
    if rows[0].iter().any(|h| *h != Complex64::default()) {
        let second = (0..SUBCARRIERS).map(|k| (rows[0][k] - 2.0 * rows[1][k] + row[k]).norm_sqr() / 6.0);
        noise.0 += second.sum::<f64>();
        noise.1 += SUBCARRIERS as f64;
    }
    *rows = [rows[1], row];
}

/// The phase slope per subcarrier index, and the tones at unit power without slope and mean phase.
fn flattened(tones: &Tones, rms: f64, indices: &[i8; SUBCARRIERS]) -> (f64, Tones) {
    let usual = indices[1] - indices[0];
    let steps = (1..SUBCARRIERS).filter(|&k| indices[k] - indices[k - 1] == usual);
    let rough = steps.map(|k| tones[k] * tones[k - 1].conj()).sum::<Complex64>().arg() / f64::from(usual);
    let flat = |slope: f64, phase: f64| -> Tones {
        std::array::from_fn(|k| tones[k] * Complex64::from_polar(1.0 / rms, -slope * f64::from(indices[k]) - phase))
    };
    let mean = |row: &Tones| row.iter().sum::<Complex64>().arg();
    let once = flat(rough, 0.0);
    let phase = mean(&once);
    // After the rough slope, only a small tilt about the mean remains.
    let (mut sum_xx, mut sum_xy) = (0.0, 0.0);
    for (h, &index) in once.iter().zip(indices) {
        let x = f64::from(index);
        sum_xx += h.norm_sqr() * x * x;
        sum_xy += h.norm_sqr() * x * wrap_rad(h.arg() - phase);
    }
    let slope = rough + if sum_xx > 0.0 { sum_xy / sum_xx } else { 0.0 };
    let twice = flat(slope, 0.0);
    let phase = mean(&twice);
    (slope, twice.map(|h| h * Complex64::cis(-phase)))
}

/// Interquartile range of a normal distribution of deviation 1.
pub(super) const QUARTILES: f64 = 1.349;

/// A quantity over all records or pairs that have it. All zero if none has.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distribution {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
    /// Smallest.
    pub min: f64,
    /// First percentile.
    pub p01: f64,
    /// First quartile.
    pub q1: f64,
    /// Median.
    pub median: f64,
    /// Third quartile.
    pub q3: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

impl Distribution {
    /// Summarises finite values.
    #[must_use]
    pub fn of(values: &[f64]) -> Self {
        let mut sorted: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let (Some(&min), Some(&max)) = (sorted.first(), sorted.last()) else { return Self::default() };
        let n = sorted.len() as f64;
        let mean = sorted.iter().sum::<f64>() / n;
        let variance = sorted.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n;
        let at = |share: f64| nearest_rank(&sorted, share).unwrap_or(f64::NAN);
        Self {
            mean,
            sd: variance.sqrt(),
            min,
            p01: at(0.01),
            q1: at(0.25),
            median: at(0.5),
            q3: at(0.75),
            p99: at(0.99),
            max,
        }
    }

    /// Interquartile range.
    #[must_use]
    pub(crate) fn quartile_range(&self) -> f64 {
        self.q3 - self.q1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_statistics_of_a_ramp_are_exact() {
        let mut values: Vec<f64> = (0..=100).rev().map(f64::from).collect();
        values.push(f64::NAN);
        let d = Distribution::of(&values);
        assert_eq!((d.mean, d.min, d.max), (50.0, 0.0, 100.0));
        assert_eq!((d.p01, d.q1, d.median, d.q3, d.p99), (1.0, 25.0, 50.0, 75.0, 99.0));
        assert!((d.sd - (850f64).sqrt()).abs() < 1e-12);
        assert_eq!(Distribution::of(&[]), Distribution::default());
    }
}
