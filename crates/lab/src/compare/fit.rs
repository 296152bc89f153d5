//! Fits a scene to a recorded capture.
//!
//! Directly measured figures (rates, carrier offset, turn-around, RSSI, gain, latencies, noise of the subcarriers) go into the
//! scene. Properties that act through the whole chain (phase noise, transmitted power, reflections) are adjusted until the
//! simulated figures equal the recorded ones: each round simulates the scene and measures it like the recording.

use super::figures::{Distribution, Figures, LateGroup, QUARTILES, SideFigures, measure_scene, usual};
use crate::Failure;
use csi5300::motion::pose::Trajectory;
use csi5300::pipeline::Options;
use csi5300::signal::channel::{Channel, ChannelError, SPEED_OF_LIGHT_M_PER_S, SUBCARRIER_SPACING_HZ, Width};
use csi5300_sim::crystal::Crystal;
use csi5300_sim::motion::{RecordedMotion, RobotMotion};
use csi5300_sim::radio::{Agc, AntennaOrder, Gain, Noise, Radio, Stray, TurnAround};
use csi5300_sim::scene::{Cfo, Driver, HostClock, Pattern, Robot, Sounding, Wall};
use csi5300_sim::{Faults, Recorded, Scene, SceneError};
use driver_iface::bfee::rate::HT40;
use nalgebra::{SMatrix, SVector, Vector3};
use std::f64::consts::TAU;
use std::path::Path;

/// A fitted scene.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// Its text.
    pub toml: String,
    /// The scene. It has another seed than the one used for fitting, so its figures are no better than any other seed's.
    pub scene: Scene,
}

/// What is known of a recording besides its figures.
pub struct Known<'a> {
    /// The receiver's trajectory.
    pub trajectory: &'a Trajectory,
    /// Its file name in the scene, relative to `folder`.
    pub file: &'a Path,
    /// The folder of the scene.
    pub folder: &'a Path,
}

/// Adjusted values: phase noise of a frame, loss of the walls (no walls for a recording without motion), transmitted power
/// that each side sees, variation of the phase slope on each side (radians per index), spread of the core of turn-arounds.
#[derive(Clone, Copy, Debug)]
struct Adjusted {
    phase_noise_rad: f64,
    wall_loss_db: Option<f64>,
    tx_power_dbm: [f64; 2],
    slope_sd_rad: [f64; 2],
    core_us: f64,
    /// Deviation of the robot from its trajectory, metres: accounts for slowly lost coherence.
    stray_m: f64,
    /// Distance of the walls from the robots, metres: longer paths make subcarriers differ more.
    margin_m: f64,
}

/// Rounds of adjustment.
const ROUNDS: usize = 8;
/// Seed for fitting, and seed of the fitted scene.
const SEEDS: [u64; 2] = [1, 2];
/// Loss of the walls, dB: first guess, least and largest.
const WALL_DB: [f64; 3] = [12.0, 1.0, 40.0];
/// Distance of the walls from the robots, metres: first guess, least and largest, typical of a laboratory.
const MARGIN_M: [f64; 3] = [2.5, 1.5, 4.0];
/// Coefficients are rounded to integers: the power of that error, steps squared.
const ROUNDING: f64 = 2.0 / 12.0;

/// Refuses a recording of another bandwidth than the channel's.
///
/// # Errors
/// If most records have the other bandwidth.
pub fn check_width(recorded: &Figures, channel: Channel) -> Result<(), Failure> {
    let recorded_mhz = if is_wide(&recorded.receiver) { 40 } else { 20 };
    let mhz = if channel.width() == Width::Ht20 { 20 } else { 40 };
    if recorded_mhz == mhz {
        return Ok(());
    }
    Err(format!(
        "the records are {recorded_mhz} MHz wide, channel {channel} is not: add + or - to the number of a 40 MHz channel"
    )
    .into())
}

/// Fits a scene.
///
/// # Errors
/// If the recording lacks what a scene needs or is not of the options' channel, or its scene cannot be simulated.
pub fn fit(recorded: &Figures, known: &Known<'_>, options: &Options) -> Result<Fitted, Failure> {
    check_width(recorded, options.channel)?;
    let no_place = "the transmitter's place is not known, and without motion it cannot be found";
    let place = recorded.link.place_m.ok_or(no_place)?;
    let recording = Recording { figures: recorded, known, place, channel: options.channel };
    let mut adjusted = first(recorded, known.trajectory, place);
    let made = |adjusted: &Adjusted, seed: u64| {
        let scene = recording.scene(adjusted, seed);
        let invalid = |toml: &str, source: SceneError| format!("the fitted scene: {source}\n{toml}");
        let toml = HEADER.to_owned() + &scene.to_toml().map_err(|source| invalid("", source))?;
        let scene = Scene::read(&toml, known.folder).map_err(|source| invalid(&toml, source))?;
        Ok::<_, Failure>(Fitted { toml, scene })
    };
    let mut best = (f64::INFINITY, adjusted);
    for _ in 0..ROUNDS {
        let figures = measure_scene(&made(&adjusted, SEEDS[0])?.scene, Some(known.trajectory), options)?;
        let off = distance(recorded, &figures);
        if off < best.0 {
            best = (off, adjusted);
        }
        adjust(&mut adjusted, recorded, &figures, options.channel.wavelength_m());
    }
    made(&best.1, SEEDS[1])
}

/// The noise power of a subcarrier beyond the rounding of its coefficients, relative to the signal, at one side's antenna.
fn noise(side: &SideFigures) -> f64 {
    let rounding = ROUNDING / side.level[0].median.max(1.0).powi(2);
    (10f64.powf(-0.1 * side.tone_snr_db) - rounding).max(0.0)
}

/// The first guess.
fn first(recorded: &Figures, trajectory: &Trajectory, place: [f64; 3]) -> Adjusted {
    let from_tones = (noise(&recorded.receiver) + noise(&recorded.transmitter)) / 60.0;
    let spread = recorded.link.spread_after_rad;
    let away_m = middle(trajectory).metric_distance(&Vector3::from(place)).max(0.1);
    // Free space over the first metre at 5.5 GHz is 47.3 dB.
    let lost_db = 47.3 + 20.0 * away_m.log10();
    let power = |side: &SideFigures| side.rssi_db[0].mean - 44.0 - side.agc_db.mean + lost_db;
    Adjusted {
        phase_noise_rad: (0.5 * (spread * spread - from_tones)).max(0.0).sqrt(),
        wall_loss_db: recorded.link.coherence.map(|_| WALL_DB[0]),
        tx_power_dbm: [power(&recorded.receiver), power(&recorded.transmitter)],
        core_us: recorded.link.core_us,
        stray_m: 0.0,
        margin_m: MARGIN_M[0],
        slope_sd_rad: [recorded.receiver.slope_rad.sd, recorded.transmitter.slope_rad.sd],
    }
}

fn middle(trajectory: &Trajectory) -> Vector3<f64> {
    let poses = trajectory.poses();
    poses.iter().map(|pose| pose.position_m).sum::<Vector3<f64>>() / poses.len().max(1) as f64
}

/// Ripple over the subcarriers that filters do not explain.
fn selective(side: &SideFigures) -> f64 {
    let filter = Distribution::of(&side.filter);
    (side.ripple.median.powi(2) - (filter.sd / filter.mean.max(1e-6)).powi(2)).max(1e-6).sqrt()
}

/// Each side's figures in both captures.
fn sides<'a>(recorded: &'a Figures, simulated: &'a Figures) -> [(&'a SideFigures, &'a SideFigures); 2] {
    [(&recorded.receiver, &simulated.receiver), (&recorded.transmitter, &simulated.transmitter)]
}

/// Differences of the adjusted figures from the recorded ones.
fn distance(recorded: &Figures, simulated: &Figures) -> f64 {
    let (a, b) = (&recorded.link, &simulated.link);
    let relative = |a: f64, b: f64| (b / a.max(1e-6)).max(1e-6).ln().abs() / 0.15;
    let apart = |a: Option<f64>, b: Option<f64>| a.zip(b).map_or(0.0, |(a, b)| (a - b).abs() / 0.1);
    let coherence = apart(a.coherence, b.coherence).max(apart(a.short_coherence, b.short_coherence));
    let sides = sides(recorded, simulated);
    let gains = sides.map(|(a, b)| (a.agc_db.mean - b.agc_db.mean).abs()).iter().sum::<f64>();
    let spreads = [(a.spread_before_rad, b.spread_before_rad), (a.spread_after_rad, b.spread_after_rad)];
    let spread = spreads.into_iter().map(|(a, b)| relative(a, b)).fold(0.0, f64::max);
    // Figures that depend on the walls, in units of their limits.
    let fading = sides
        .map(|(a, b)| ((a.agc_db.sd - b.agc_db.sd).abs() / 0.7).max((a.ripple.median - b.ripple.median).abs() / 0.05));
    let fading = fading.into_iter().fold(0.0, f64::max);
    spread.max(coherence).max(fading) + 0.1 * gains
}

/// Moves the adjusted values towards the recorded figures.
fn adjust(adjusted: &mut Adjusted, recorded: &Figures, simulated: &Figures, wavelength_m: f64) {
    let (a, b) = (&recorded.link, &simulated.link);
    // Variances add: each frame gets half of the missing part.
    let missing = 0.5 * (a.spread_after_rad.powi(2) - b.spread_after_rad.powi(2));
    adjusted.phase_noise_rad = (adjusted.phase_noise_rad.powi(2) + missing).max(0.0).sqrt();
    // Before compensation, the carrier offset turns the turn-around's spread into phase.
    let rad_per_us = TAU * a.df_hz.unwrap_or_default().abs().max(1_000.0) * 1e-6;
    let missing = (a.spread_before_rad.powi(2) - b.spread_before_rad.powi(2)) / rad_per_us.powi(2);
    let core_us = (adjusted.core_us.powi(2) + missing).max(0.0).sqrt();
    adjusted.core_us = core_us.clamp(0.7 * a.core_us, 1.4 * a.core_us);
    if let (Some(loss_db), Some(wanted), Some(got)) = (adjusted.wall_loss_db, a.short_coherence, b.short_coherence) {
        // Within a second, reflections limit coherence, and their incoherent power scales with the walls' reflection.
        let incoherent = |c: f64| (1.0 - c.powi(2)).clamp(0.01, 0.99);
        let step_db = 5.0 * (incoherent(got) / incoherent(wanted)).log10() * 2.0;
        adjusted.wall_loss_db = Some((loss_db + step_db.clamp(-6.0, 6.0)).clamp(WALL_DB[1], WALL_DB[2]));
    }
    if adjusted.wall_loss_db.is_some() {
        let of = |figures: &Figures| selective(&figures.receiver) + selective(&figures.transmitter);
        let longer = (of(recorded) / of(simulated)).clamp(0.7, 1.4);
        adjusted.margin_m = (adjusted.margin_m * longer).clamp(MARGIN_M[1], MARGIN_M[2]);
    }
    if let (Some(wanted), Some(got)) = (a.coherence, b.coherence) {
        // Over the whole motion, deviations from the path limit coherence: a phase of deviation s leaves exp(-s^2 / 2), and a round
        // trip has 4 pi of phase per wavelength.
        let missing = 2.0 * (got.max(0.01) / wanted.max(0.01)).ln() * (wavelength_m / (2.0 * TAU)).powi(2);
        adjusted.stray_m = (adjusted.stray_m.powi(2) + missing).clamp(0.0, (0.25 * wavelength_m).powi(2)).sqrt();
    }
    let sides = sides(recorded, simulated);
    for (power, (a, b)) in adjusted.tx_power_dbm.iter_mut().zip(sides) {
        *power += b.agc_db.mean - a.agc_db.mean;
    }
    for (slope, (a, b)) in adjusted.slope_sd_rad.iter_mut().zip(sides) {
        *slope = (slope.powi(2) + a.slope_rad.sd.powi(2) - b.slope_rad.sd.powi(2)).max(0.0).sqrt();
    }
}

/// First line of a fitted scene's text.
const HEADER: &str =
    "# Fitted to a recorded capture; see docs/guides/simulation.md for what each figure is taken from.\n";
/// Number of oscillations of a recorded trajectory's deviation: few, because windows of a second stay coherent.
const SWINGS: f64 = 3.0;
/// Decibels of an amplitude factor of e.
const DB_PER_E: f64 = 8.685_889_638;
/// Mean latency of the host minus three deviations, microseconds. A log does not show it; it must be long enough that an early
/// answer is early in the log too.
const LATENCY_US: f64 = 300.0;
/// Median turn-around, microseconds. Two logs with unrelated clocks do not show it; it must be long enough that the earliest
/// answers follow the frame that they answer.
const TURN_AROUND_US: f64 = 450.0;

/// A recording and the values for its scene.
struct Recording<'a> {
    figures: &'a Figures,
    known: &'a Known<'a>,
    /// The transmitter's antenna, metres.
    place: [f64; 3],
    channel: Channel,
}

impl Recording<'_> {
    /// The scene with this seed.
    fn scene(&self, adjusted: &Adjusted, seed: u64) -> Scene {
        let (rx, tx) = (&self.figures.receiver, &self.figures.transmitter);
        let times = self.times();
        let sounding = Sounding {
            rate_hz: brief(1e6 / tx.interval_us.median.max(1.0)),
            start_s: times.start_s,
            ..Sounding::default()
        };
        let walls = adjusted.wall_loss_db.map(|db| walls(self.known.trajectory, self.place, db, adjusted.margin_m));
        Scene {
            name: "fitted".into(),
            seed,
            duration_s: brief(times.last_s + 0.005),
            channel: scene_channel(self.channel),
            bandwidth_mhz: if is_wide(rx) { 40 } else { 20 },
            driver: if 2 * rx.stock > rx.records { Driver::Stock } else { Driver::Wsr },
            start_unix_s: times.start_unix_s,
            cfo: Cfo::Physical,
            reflections: if walls.is_some() { 2 } else { 0 },
            sounding: Some(sounding),
            robot: vec![self.receiver(adjusted, &times), self.transmitter(adjusted, &times)],
            wall: walls.unwrap_or_default(),
            ..Scene::default()
        }
    }

    fn times(&self) -> Times {
        let (from_s, to_s) = self.known.trajectory.span_s();
        let (first_us, last_us) = self.figures.receiver.host_us.unwrap_or(((from_s * 1e6) as i64, (to_s * 1e6) as i64));
        let start_unix_s = (first_us.div_euclid(1_000_000)).min(from_s.floor() as i64);
        let since = |us: i64| (us - start_unix_s * 1_000_000) as f64 * 1e-6;
        let (first_s, last_s) = (since(first_us), since(last_us));
        Times { start_unix_s, first_s, last_s, start_s: brief((first_s - 0.001).max(0.0)) }
    }

    fn receiver(&self, adjusted: &Adjusted, times: &Times) -> Robot {
        let (rx, tx) = (&self.figures.receiver, &self.figures.transmitter);
        let (from_s, to_s) = self.known.trajectory.span_s();
        let motion = RecordedMotion {
            file: self.known.file.to_owned(),
            start_s: brief(from_s - times.start_unix_s as f64),
            stray_m: brief(adjusted.stray_m),
            stray_s: brief(((to_s - from_s) / SWINGS).max(0.1)),
        };
        let (jitter_us, delay) = lateness(tx);
        let radio = self.radio(adjusted, 0);
        Robot {
            name: "rx".into(),
            position_m: self.known.trajectory.poses().first().map_or([0.0; 3], |pose| pose.position_m.into()),
            motion: RobotMotion::Recorded(motion),
            pattern: pattern(&rx.powers, self.known.trajectory, self.place),
            crystal: Crystal {
                offset_ppm: rx.card_ppm,
                clock_start_us: times.clock_start_us(rx),
                ..Crystal::default()
            },
            faults: Faults {
                loss: brief((rx.missing - tx.missing).max(0.0)),
                killed: rx.tail_bytes > 0,
                ..Faults::default()
            },
            radio: Some(Radio { send_jitter_us: brief(jitter_us), send_delay: group(delay), ..radio }),
            ..Robot::default()
        }
    }

    fn transmitter(&self, adjusted: &Adjusted, times: &Times) -> Robot {
        let (rx, tx, link) = (&self.figures.receiver, &self.figures.transmitter, &self.figures.link);
        // Each card's clock is known relative to its host's, and the hosts' relative to each other; the carrier offset measures the
        // difference between the cards more finely.
        let apart_ppm = link.df_hz.map_or(link.drift_ppm, |hz| 1e6 * hz / self.channel.centre_hz());
        let tx_ppm = brief(rx.card_ppm + apart_ppm);
        // The clocks were compared in the middle of the capture; an answer is later on one side than on the other.
        let host_ppm = tx_ppm - tx.card_ppm;
        let middle_s = 0.5 * (times.first_s + times.last_s);
        let later_us = TURN_AROUND_US + mean_latency_us(rx, 0) - mean_latency_us(tx, 1);
        let offset_s = link.host_apart_s.map_or(0.0, |s| s + 1e-6 * (later_us - host_ppm * middle_s));
        Robot {
            name: "tx".into(),
            position_m: self.place,
            crystal: Crystal { offset_ppm: tx_ppm, clock_start_us: times.clock_start_us(tx), ..Crystal::default() },
            host_clock: HostClock { offset_s, drift_ppm: brief(host_ppm) },
            faults: Faults { loss: brief(tx.missing), killed: tx.tail_bytes > 0, ..Faults::default() },
            radio: Some(Radio { turn_around: self.turn_around(adjusted), ..self.radio(adjusted, 1) }),
            ..Robot::default()
        }
    }

    fn turn_around(&self, adjusted: &Adjusted) -> TurnAround {
        let link = &self.figures.link;
        let ([early, far, late], turn) = (link.groups, &link.turn_around_us);
        TurnAround {
            median_us: TURN_AROUND_US,
            spread_us: brief(adjusted.core_us),
            tail: brief(early.share),
            tail_us: brief(early.mean_us),
            tail_spread_us: brief(early.sd_us),
            far: group(far),
            late: group(late),
            tail_run: brief(link.run.unwrap_or(0.0)),
            min_us: brief((TURN_AROUND_US + turn.min - turn.median).max(0.0)),
            max_us: brief(TURN_AROUND_US + turn.max - turn.median),
        }
    }

    /// A robot's radio, from its own log and the other's records of its frames. `k` is 0 for the receiver.
    fn radio(&self, adjusted: &Adjusted, k: usize) -> Radio {
        let sides = [&self.figures.receiver, &self.figures.transmitter];
        let (side, other) = (sides[k], sides[1 - k]);
        let ns = |slope_rad: f64| 1e9 * slope_rad / (TAU * SUBCARRIER_SPACING_HZ);
        let away_m = (middle(self.known.trajectory) - Vector3::from(self.place)).norm();
        let flight_ns = 1e9 * away_m / SPEED_OF_LIGHT_M_PER_S;
        let tones = noise(side);
        let rssi_a = &side.rssi_db[0];
        let stray = |antenna: usize| {
            let rssi = &side.rssi_db[antenna];
            Stray { lsb: brief(side.level[antenna].mean), rssi_db: brief(rssi.mean), rssi_std_db: brief(rssi.sd) }
        };
        Radio {
            phase_noise_rad: brief(adjusted.phase_noise_rad),
            mcs: usual(&other.rates).map_or(0, |rate| (rate & 7) as u8),
            chains: usual(&side.streams).map_or(3, |streams| (streams / 10) as u8),
            filter_db: (side.filter.iter().all(|gain| *gain > 0.0))
                .then(|| side.filter.map(|gain| brief(20.0 * gain.log10()))),
            noise: if tones > 1e-6 { Noise::SnrDb(brief(-10.0 * tones.log10())) } else { Noise::Off },
            delay_ns: brief(ns(-side.slope_rad.mean) - flight_ns),
            delay_std_ns: brief(ns(adjusted.slope_sd_rad[k])),
            antenna_order: AntennaOrder::ByRssi,
            tx_power_dbm: brief(adjusted.tx_power_dbm[k]),
            host_latency_us: brief(mean_latency_us(side, k)),
            host_latency_std_us: brief(latency_us(side, k)),
            gain: Gain::Agc(Agc {
                target_lsb: brief(side.level[0].median),
                lsb_std_db: brief(DB_PER_E * side.level[0].sd / side.level[0].mean.max(1.0)),
                rssi_db: brief(rssi_a.mean),
                agc_std_db: brief(rssi_a.sd),
            }),
            stray_b: stray(1),
            stray_c: stray(2),
            ..Radio::default()
        }
    }
}

/// The time span of a recording, by its receiver's host.
struct Times {
    /// The scene's start, seconds since the Unix epoch.
    start_unix_s: i64,
    /// First and last record, seconds into the scene.
    first_s: f64,
    last_s: f64,
    /// First round.
    start_s: f64,
}

impl Times {
    /// The card's clock at the scene's start, microseconds.
    fn clock_start_us(&self, side: &SideFigures) -> u64 {
        let first_us = side.clock_us.map_or(0, |(first, _)| first);
        (first_us - (self.start_s * 1e6) as i64).rem_euclid(1 << 32) as u64
    }
}

fn group(group: LateGroup) -> csi5300_sim::radio::DelayGroup {
    let [share, us, spread_us] = [group.share, group.mean_us, group.sd_us].map(brief);
    csi5300_sim::radio::DelayGroup { share, us, spread_us }
}

/// How late the sender sends: the mean of the exponential lateness of most frames, microseconds, and the extra delays of the
/// others.
///
/// The difference of two exponential latenesses is symmetric; half of `exp(-x / mean)` of it lies beyond `x` on one side. A
/// delayed frame makes one interval long and the next one short, so it counts on either side.
fn lateness(side: &SideFigures) -> (f64, LateGroup) {
    let share = side.delayed.share.min(0.2);
    let beyond = (0.25 - share) / (1.0 - 2.0 * share);
    let mean_us = 0.5 * side.interval_us.quartile_range() / -(2.0 * beyond).ln();
    // A delayed frame has the usual lateness in addition.
    let sd_us = (side.delayed.sd_us.powi(2) - 2.0 * mean_us.powi(2)).max(0.0).sqrt();
    (mean_us, LateGroup { share, sd_us, ..side.delayed })
}

/// Six significant digits: no figure is known better.
fn brief(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

/// Whether the card reported channels of 40 MHz.
fn is_wide(side: &SideFigures) -> bool {
    usual(&side.rates).is_some_and(|rate| rate & i64::from(HT40) != 0)
}

/// Standard deviation of a host's latency, microseconds: the core, without the responder's early answers.
fn latency_us(side: &SideFigures, k: usize) -> f64 {
    if k == 1 { side.latency_core_us } else { side.latency_us.quartile_range() / QUARTILES }
}

fn mean_latency_us(side: &SideFigures, k: usize) -> f64 {
    LATENCY_US + 3.0 * latency_us(side, k)
}

/// Four walls about both robots.
fn walls(trajectory: &Trajectory, place: [f64; 3], loss_db: f64, margin_m: f64) -> Vec<Wall> {
    let mut low = [place[0], place[1]];
    let mut high = low;
    for pose in trajectory.poses() {
        for axis in 0..2 {
            low[axis] = low[axis].min(pose.position_m[axis]);
            high[axis] = high[axis].max(pose.position_m[axis]);
        }
    }
    let ([x0, y0], [x1, y1]) = (low.map(|v| brief(v - margin_m)), high.map(|v| brief(v + margin_m)));
    let corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]];
    let wall = |ends: &[[f64; 2]]| Wall { bottom_m: -1.0, loss_db: brief(loss_db), ..Wall::between(ends[0], ends[1]) };
    corners.windows(2).map(wall).collect()
}

/// A channel's number in a scene: at 40 MHz that of the centre, two above or below the primary channel's.
#[must_use]
pub fn scene_channel(channel: Channel) -> u16 {
    let number = channel.number() as u16;
    match channel.width() {
        Width::Ht20 => number,
        Width::Ht40Plus => number + 2,
        Width::Ht40Minus => number.saturating_sub(2),
    }
}

/// The channel of a scene.
///
/// # Errors
/// If no channel has the scene's number.
pub fn channel_of(scene: &Scene) -> Result<Channel, ChannelError> {
    channel_about(scene.channel.into(), scene.bandwidth_mhz == 40)
}

/// The channel whose centre has this number. At 40 MHz the primary channel is the lower half if that is a valid channel.
///
/// # Errors
/// If no channel has the number.
pub fn channel_about(number: u32, is_wide: bool) -> Result<Channel, ChannelError> {
    if !is_wide {
        return Channel::new(number, Width::Ht20);
    }
    Channel::new(number.saturating_sub(2), Width::Ht40Plus).or_else(|_| Channel::new(number + 2, Width::Ht40Minus))
}

/// Fewer records than this show no pattern.
const FEWEST: u32 = 100;
/// Largest length of the mean heading vector: headings must point in all directions.
const LOPSIDED: f64 = 0.5;

/// The pattern of a robot's antennas, estimated from the power of its records (host time, dB) along its trajectory: the first
/// two harmonics of the azimuth to `place` in the robot's frame, by least squares. None of them if the robot did not turn round.
fn pattern(powers: &[(f64, f64)], trajectory: &Trajectory, place: [f64; 3]) -> Pattern {
    let (from_s, to_s) = trajectory.span_s();
    let path = Recorded::from_trajectory(trajectory);
    let mut normal = SMatrix::<f64, 5, 5>::zeros();
    let mut right = SVector::<f64, 5>::zeros();
    let (mut count, mut mean) = (0, [0.0; 2]);
    for &(t_s, power_db) in powers.iter().filter(|(t_s, _)| (from_s..=to_s).contains(t_s)) {
        let pose = path.at(t_s - from_s);
        let way = Vector3::from(place) - pose.position_m;
        let (sin, cos) = (way.y.atan2(way.x) - pose.yaw_rad).sin_cos();
        let row = SVector::from([1.0, cos, sin, 2.0 * cos * cos - 1.0, 2.0 * sin * cos]);
        normal += row * row.transpose();
        right += row * power_db;
        count += 1;
        mean = [mean[0] + cos, mean[1] + sin];
    }
    let lopsided = mean[0].hypot(mean[1]) > LOPSIDED * f64::from(count);
    let found = normal.cholesky().filter(|_| count >= FEWEST && !lopsided);
    let [_, cos_db, sin_db, cos2_db, sin2_db] = found.map_or([0.0; 5], |normal| normal.solve(&right).map(brief).into());
    Pattern { cos_db, sin_db, cos2_db, sin2_db }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::motion::pose::Pose;

    #[test]
    fn a_scenes_channel_has_its_centre_and_width() {
        let scene = |channel, bandwidth_mhz| Scene { channel, bandwidth_mhz, ..Scene::default() };
        let named = |scene: &Scene| channel_of(scene).map(|channel| channel.to_string());
        assert_eq!(named(&scene(36, 20)), Ok("36".into()));
        assert_eq!(named(&scene(110, 40)), Ok("108+".into()));
        // No channel is two below the lowest of a band.
        assert_eq!([named(&scene(34, 40)), named(&scene(2, 40))], [Ok("36-".into()), Ok("4-".into())]);
        for (number, mhz) in [(36, 20), (110, 40), (34, 40), (3, 40), (196, 40)] {
            let channel = channel_of(&scene(number, mhz)).unwrap();
            assert_eq!((scene_channel(channel), channel.width() != Width::Ht20), (number, mhz == 40));
        }
        assert!(channel_of(&scene(20, 20)).is_err());
    }

    /// Half a minute on a circle of 30 cm, `turns` times round.
    fn driven(turns: f64) -> Trajectory {
        let pose = |k: i32| {
            let (t_s, angle) = (f64::from(k) * 0.01, TAU * turns * f64::from(k) / 3_000.0);
            let position_m = Vector3::new(0.3 * angle.sin(), -0.3 * angle.cos(), 0.0);
            Pose { t_s, position_m, heading_rad: Some(angle) }
        };
        Trajectory::new((0..=3_000).map(pose).collect()).unwrap()
    }

    #[test]
    fn a_robot_that_turns_shows_its_pattern_and_one_that_does_not_shows_none() {
        let truth = Pattern { cos_db: 0.5, sin_db: -2.0, cos2_db: 1.0, sin2_db: 0.25 };
        let (place, trajectory) = ([-30.0, 20.0, 1.0], driven(3.0));
        let path = Recorded::from_trajectory(&trajectory);
        let powers = |path: &Recorded| -> Vec<(f64, f64)> {
            let power = |k: u32| {
                let t_s = f64::from(k) * 0.01;
                let pose = path.at(t_s);
                let way = Vector3::from(place) - pose.position_m;
                let a = way.y.atan2(way.x) - pose.yaw_rad;
                let fading = if k.is_multiple_of(2) { 1.0 } else { -1.0 };
                (t_s, -40.0 + truth.gain_db(a.cos(), a.sin()) + fading)
            };
            (0..3_000).map(power).collect()
        };
        let found = pattern(&powers(&path), &trajectory, place);
        for (found, truth) in [
            (found.cos_db, truth.cos_db),
            (found.sin_db, truth.sin_db),
            (found.cos2_db, truth.cos2_db),
            (found.sin2_db, truth.sin2_db),
        ] {
            assert!((found - truth).abs() < 0.05, "{found} of {truth}");
        }
        let still = driven(0.05);
        let lopsided = pattern(&powers(&Recorded::from_trajectory(&still)), &still, place);
        assert_eq!(lopsided, Pattern::default());
        assert_eq!(pattern(&powers(&path)[..50], &trajectory, place), Pattern::default());
    }
}
