//! The scene of a recording, from its figures and adjusted values.

use super::distribution::QUARTILES;
use super::figures::{Figures, LateGroup};
use super::fit::{Adjusted, Known, middle, noise};
use super::pattern::pattern;
use super::side::{SideFigures, usual};
use csi5300::motion::pose::Trajectory;
use csi5300::signal::channel::{Channel, ChannelError, SPEED_OF_LIGHT_M_PER_S, SUBCARRIER_SPACING_HZ, Width};
use csi5300_sim::crystal::Crystal;
use csi5300_sim::motion::{RecordedMotion, RobotMotion};
use csi5300_sim::radio::{Agc, AntennaOrder, Gain, Noise, Radio, Stray, TurnAround};
use csi5300_sim::scene::{Cfo, Driver, HostClock, Robot, Sounding, Wall};
use csi5300_sim::{Faults, Scene, SceneError};
use std::f64::consts::TAU;

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
/// The bit of `rate_n_flags` for 40 MHz.
const RATE_40_MHZ: u16 = driver_iface::bfee::rate::HT40;

/// A recording and the values for its scene.
pub(super) struct Recording<'a> {
    pub(super) figures: &'a Figures,
    pub(super) known: &'a Known<'a>,
    /// The transmitter's antenna, metres.
    pub(super) place: [f64; 3],
    pub(super) channel: Channel,
}

/// The text of a fitted scene.
pub(super) fn text(scene: &Scene) -> Result<String, SceneError> {
    Ok(format!("{HEADER}{}", scene.to_toml()?))
}

impl Recording<'_> {
    /// The scene with this seed.
    pub(super) fn scene(&self, adjusted: &Adjusted, seed: u64) -> Scene {
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
        let seen = pattern(&rx.powers, self.known.trajectory, self.place);
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
            pattern: csi5300_sim::scene::Pattern {
                cos_db: brief(seen.cos_db),
                sin_db: brief(seen.sin_db),
                cos2_db: brief(seen.cos2_db),
                sin2_db: brief(seen.sin2_db),
            },
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
        let apart_ppm = 1e6 * link.df_hz / self.channel.centre_hz();
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
        let away_m = (middle(self.known.trajectory) - nalgebra::Vector3::from(self.place)).norm();
        let flight_ns = 1e9 * away_m / SPEED_OF_LIGHT_M_PER_S;
        let tones = noise(side);
        let [_, level_b, level_c] = &side.level;
        let [rssi_a, rssi_b, rssi_c] = &side.rssi_db;
        let stray = |lsb: f64, rssi: &super::distribution::Distribution| Stray {
            lsb: brief(lsb),
            rssi_db: brief(rssi.mean),
            rssi_std_db: brief(rssi.sd),
        };
        Radio {
            phase_noise_rad: brief(adjusted.phase_noise_rad),
            mcs: usual(&other.rates).map_or(0, |rate| (rate & 7) as u8),
            chains: usual(&side.streams).map_or(3, |streams| (streams / 10) as u8),
            filter_db: side
                .filter
                .iter()
                .all(|gain| *gain > 0.0)
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
            stray_b: stray(level_b.mean, rssi_b),
            stray_c: stray(level_c.mean, rssi_c),
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
pub(super) fn is_wide(side: &SideFigures) -> bool {
    usual(&side.rates).is_some_and(|rate| rate & RATE_40_MHZ != 0)
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

/// The channel of a scene. At 40 MHz the primary channel is the lower half if that is a valid channel; the centre is the same.
///
/// # Errors
/// If no channel has the scene's number.
pub fn channel_of(scene: &Scene) -> Result<Channel, ChannelError> {
    let number = u32::from(scene.channel);
    if scene.bandwidth_mhz != 40 {
        return Channel::new(number, Width::Ht20);
    }
    Channel::new(number.saturating_sub(2), Width::Ht40Plus).or_else(|_| Channel::new(number + 2, Width::Ht40Minus))
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
