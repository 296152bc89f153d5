//! The effects of a card's radio on a channel, and the turn-around of a responder. All are off by default.

use super::maths::amplitude;
use super::random::Stream;
use super::world::TONES;
use csi5300::exchange::tdma::Phy;
use driver_iface::radiotap::Bandwidth;
use serde::{Deserialize, Serialize};

/// A radio.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Radio {
    /// White noise.
    pub noise: Noise,
    /// Phase noise: one angle per frame for all subcarriers, radians (standard deviation).
    pub phase_noise_rad: f64,
    /// Fixed delay of filters and packet detection, nanoseconds. Real cards: 200 (-0.4 radians a subcarrier).
    pub delay_ns: f64,
    /// Standard deviation of the moment of detection between packets, nanoseconds. Real cards: 25 to 60 (0.05 to 0.12
    /// radians a subcarrier).
    pub delay_std_ns: f64,
    /// Sampling time offset: the two cards' sample grids slide over each other as their crystals do, so the delay
    /// is a sawtooth over one sample period (50 ns at 20 MHz).
    #[doc(alias = "STO")]
    pub sampling_offset: bool,
    /// Gain of the sender's and this card's filters at each of the 30 subcarriers, dB; only the shape counts. Without
    /// it they are flat. Real cards: 2 dB less at the edges, and 0.5 dB up and down between.
    pub filter_db: Option<[f64; TONES]>,
    /// How coefficients become 8-bit integers.
    pub gain: Gain,
    /// Transmitted power with antenna gains, dBm.
    pub tx_power_dbm: f64,
    /// Receive chains in use, 1 to 3.
    pub chains: u8,
    /// Phase of the chains of antennas B and C against that of A, degrees: cables, filters.
    pub chain_deg: [f64; 2],
    /// Each load of the firmware adds 0 or 180 degrees at random, as on a 5300.
    pub chain_flips: bool,
    /// Its standard deviation between packets, radians. A 5300 with two antennas on a robot: 0.2.
    pub chain_noise_rad: f64,
    /// Signal of antenna B's chain without an antenna.
    pub stray_b: Stray,
    /// Signal of antenna C's chain without an antenna.
    pub stray_c: Stray,
    /// The order of the chains in a record.
    pub antenna_order: AntennaOrder,
    /// Modulation and coding scheme of sounding frames, 0 to 7.
    pub mcs: u8,
    /// From the rise of a frame on air to the rise of its answer.
    pub turn_around: TurnAround,
    /// Lateness of frames other than answers, microseconds: the mean of an exponential distribution. Real captures'
    /// intervals of 10 ms have quartiles of 40 to 60 us either way and a standard deviation of 114 to 128: 45 to 70,
    /// and [`Radio::send_delay`].
    pub send_jitter_us: f64,
    /// Extra delay of some frames, by a busy host. Real captures: one in 14 to 22, 240 to 280 us.
    pub send_delay: DelayGroup,
    /// From the end of a frame to its record on the host, microseconds: mean.
    pub host_latency_us: f64,
    /// The same, standard deviation. Never less than a tenth of the mean.
    pub host_latency_std_us: f64,
}

impl Default for Radio {
    fn default() -> Self {
        Self {
            noise: Noise::Off,
            phase_noise_rad: 0.0,
            delay_ns: 0.0,
            delay_std_ns: 0.0,
            sampling_offset: false,
            filter_db: None,
            gain: Gain::default(),
            tx_power_dbm: 15.0,
            chains: 3,
            chain_deg: [0.0; 2],
            chain_flips: false,
            chain_noise_rad: 0.0,
            stray_b: Stray::default(),
            stray_c: Stray::default(),
            antenna_order: AntennaOrder::Fixed,
            mcs: 0,
            turn_around: TurnAround::default(),
            send_jitter_us: 0.0,
            send_delay: DelayGroup::default(),
            host_latency_us: 100.0,
            host_latency_std_us: 0.0,
        }
    }
}

/// White Gaussian noise on every coefficient.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Noise {
    /// None.
    #[default]
    Off,
    /// At this ratio to the strongest antenna's mean power in each record, dB (as \[paper\] of docs/reference/references.md adds noise).
    SnrDb(f64),
    /// At this power, dBm: the ratio follows from distance and transmitted power.
    FloorDbm(f64),
}

/// How coefficients become integers.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Gain {
    /// The same for every record.
    Fixed(FixedGain),
    /// Automatic gain control.
    Agc(Agc),
}

impl Default for Gain {
    fn default() -> Self {
        Self::Agc(Agc::default())
    }
}

/// See [`Gain::Fixed`].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FixedGain {
    /// Size of a coefficient at a distance of 1 m in free space, in steps of the converter. In the circles of \[paper\]: 256.
    pub lsb_at_1m: f64,
    /// The `agc` field, dB.
    #[serde(default)]
    pub agc_db: u8,
}

/// See [`Gain::Agc`]. The defaults are steady versions of what real captures show.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Agc {
    /// Root mean square of the strongest antenna's coefficients, in steps of the converter. Real captures: 31.
    pub target_lsb: f64,
    /// Its standard deviation between records, dB.
    pub lsb_std_db: f64,
    /// RSSI that the gain control aims at, dB. Real captures: 36 to 40.
    pub rssi_db: f64,
    /// Standard deviation of its setting between records, dB.
    pub agc_std_db: f64,
}

impl Default for Agc {
    fn default() -> Self {
        Self { target_lsb: 31.0, lsb_std_db: 0.0, rssi_db: 38.0, agc_std_db: 0.0 }
    }
}

/// A chain without an antenna: crosstalk and noise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Stray {
    /// Root mean square of its coefficients, in steps of the converter.
    pub lsb: f64,
    /// Its RSSI, dB: mean.
    pub rssi_db: f64,
    /// The same, standard deviation.
    pub rssi_std_db: f64,
}

/// The order of the chains in a record (`antenna_sel`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
#[doc(alias = "antenna_sel")]
pub enum AntennaOrder {
    /// A, B, C.
    #[default]
    Fixed,
    /// Strongest first, by the RSSI of each packet, as real cards do.
    ByRssi,
}

impl Radio {
    /// A lateness in sending, nanoseconds.
    pub(crate) fn send_jitter_ns(&self, stream: &mut Stream) -> i64 {
        let mut us = 0.0;
        if self.send_jitter_us != 0.0 {
            us -= self.send_jitter_us * libm::log(1.0 - stream.uniform());
        }
        let DelayGroup { share, us: delay_us, spread_us } = self.send_delay;
        if stream.happens(share) {
            us += (delay_us + stream.spread(spread_us)).max(0.0);
        }
        (us * 1e3) as i64
    }

    /// From the end of a frame on air to its record on the host, nanoseconds.
    pub(crate) fn host_latency_ns(&self, away_ns: i64, stream: &mut Stream) -> i64 {
        let us = self.host_latency_us + stream.spread(self.host_latency_std_us) + away_ns as f64 * 1e-3;
        (us.max(0.1 * self.host_latency_us) * 1e3).round() as i64
    }

    /// How long a frame of `len` bytes (with FCS) is on air in one stream, nanoseconds.
    #[must_use]
    pub(crate) fn airtime_ns(&self, len: usize, wide: bool) -> i64 {
        let bandwidth = if wide { Bandwidth::Ht40 } else { Bandwidth::Ht20 };
        i64::from(Phy { mcs: self.mcs & 7, bandwidth }.airtime_us(len)) * 1_000
    }

    /// The filters' amplitude at each subcarrier, of unit mean square; `None` if they are flat.
    #[must_use]
    pub(super) fn filter(&self) -> Option<[f64; TONES]> {
        let gains = self.filter_db?.map(amplitude);
        let rms = (gains.iter().map(|gain| gain * gain).sum::<f64>() / TONES as f64).sqrt();
        Some(gains.map(|gain| gain / rms))
    }

    /// `fake_rate_n_flags`: HT, the scheme, and 40 MHz (bit 11). Long guard interval, no antenna bits, as recorded.
    #[must_use]
    pub(crate) fn rate_n_flags(&self, wide: bool) -> u16 {
        0x100 | u16::from(self.mcs & 7) | if wide { 0x800 } else { 0 }
    }
}

/// The turn-around time of a responder, air rise to air rise.
///
/// A normal core about the median, and up to three groups of answers away from it; all kept within the bounds. The WSR
/// driver's: 145 to 322 us, median 225. In the captures of \[paper\] (docs/reference/references.md) the core is 4 to 8
/// us wide and the rest early, by some 110 us for a tenth to a third of the answers, by some 210 for a few in a
/// hundred, or late by some 70: the responder's driver answers when it is interrupted, and sometimes that is at once.
/// The responder's records of such exchanges reach its host earlier by the same times (measured in its host times),
/// here too. Answers outside the core come in runs (measured: of 2 to 3 on average).
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct TurnAround {
    /// Median, microseconds.
    pub median_us: f64,
    /// Standard deviation of the core, microseconds.
    pub spread_us: f64,
    /// Share of answers in the first group away from the core.
    pub tail: f64,
    /// How much later those are than the others, microseconds; negative for earlier.
    pub tail_us: f64,
    /// Its standard deviation, microseconds.
    pub tail_spread_us: f64,
    /// A second group away from the core.
    pub far: DelayGroup,
    /// A third.
    pub late: DelayGroup,
    /// Mean run length of answers of one group; 0 if answers are independent.
    pub tail_run: f64,
    /// Lower bound, microseconds.
    pub min_us: f64,
    /// Upper bound, microseconds.
    pub max_us: f64,
}

/// Answers away from the core.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct DelayGroup {
    /// Share of all answers.
    pub share: f64,
    /// How much later they are than the core, microseconds; negative for earlier.
    pub us: f64,
    /// Standard deviation, microseconds.
    pub spread_us: f64,
}

/// The group of the last answer, if it was outside the core.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Away(Option<usize>);

impl Default for TurnAround {
    fn default() -> Self {
        Self {
            median_us: 225.0,
            spread_us: 0.0,
            tail: 0.0,
            tail_us: -100.0,
            tail_spread_us: 0.0,
            far: DelayGroup::default(),
            late: DelayGroup::default(),
            tail_run: 0.0,
            min_us: 145.0,
            max_us: 322.0,
        }
    }
}

impl TurnAround {
    /// The groups away from the core.
    #[must_use]
    pub fn groups(&self) -> [DelayGroup; 3] {
        [DelayGroup { share: self.tail, us: self.tail_us, spread_us: self.tail_spread_us }, self.far, self.late]
    }

    /// One turn-around, nanoseconds. `away_ns` is what [`TurnAround::draw_away_ns`] gave for the frame that is answered.
    pub(crate) fn draw_ns(&self, away_ns: i64, stream: &mut Stream) -> i64 {
        let us = self.median_us + stream.spread(self.spread_us) + away_ns as f64 * 1e-3;
        (us.clamp(self.min_us, self.max_us) * 1e3).round() as i64
    }

    /// Deviation of one frame's interrupt from the usual, nanoseconds; 0 in the core.
    pub(crate) fn draw_away_ns(&self, last: &mut Away, stream: &mut Stream) -> i64 {
        let groups = self.groups();
        let share = groups.iter().map(|group| group.share).sum::<f64>();
        let runs = self.tail_run > 1.0 && share < 1.0;
        let chance = match last.0 {
            Some(_) if runs => 1.0 - 1.0 / self.tail_run,
            None if runs => share / ((1.0 - share) * self.tail_run),
            _ => share,
        };
        if !stream.happens(chance) {
            last.0 = None;
            return 0;
        }
        let group = match last.0.filter(|_| runs) {
            Some(group) => group,
            None => pick(&groups, share, stream),
        };
        last.0 = Some(group);
        let DelayGroup { us, spread_us, .. } = groups[group];
        ((us + stream.spread(spread_us)) * 1e3).round() as i64
    }
}

/// The number of a group, by their shares; nothing is drawn for a single one.
fn pick(groups: &[DelayGroup; 3], share: f64, stream: &mut Stream) -> usize {
    if let Some(only) = groups.iter().position(|group| group.share == share) {
        return only;
    }
    let mut left = stream.uniform() * share;
    let found = groups.iter().position(|group| {
        left -= group.share;
        left < 0.0
    });
    found.unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Purpose;

    #[test]
    fn frames_leave_late_as_stated() {
        let send_delay = DelayGroup { share: 0.1, us: 300.0, spread_us: 10.0 };
        let radio = Radio { send_jitter_us: 50.0, send_delay, ..Radio::default() };
        let mut stream = Stream::new(1, 0, Purpose::Timing);
        let late: Vec<f64> = (0..50_000).map(|_| radio.send_jitter_ns(&mut stream) as f64 * 1e-3).collect();
        let mean = late.iter().sum::<f64>() / 50_000.0;
        assert!((mean - 80.0).abs() < 2.0, "{mean}");
        // Beyond 250 us: nearly all of the delayed, and exp(-5) of the others.
        let share = late.iter().filter(|late| **late > 250.0).count() as f64 / 50_000.0;
        assert!((share - 0.1 - 0.9 * (-5f64).exp()).abs() < 0.005, "{share}");
        assert_eq!(Radio::default().send_jitter_ns(&mut stream), 0);
    }

    #[test]
    fn a_sounding_frame_takes_its_time() {
        let radio = Radio::default();
        // 57 bytes: 478 bits, 19 symbols of 26.
        assert_eq!(radio.airtime_ns(57, false), 36_000 + 19 * 4_000);
        assert_eq!(Radio { mcs: 1, ..radio }.airtime_ns(57, false), 36_000 + 10 * 4_000);
        assert_eq!(radio.airtime_ns(57, true), 36_000 + 9 * 4_000);
        assert_eq!((radio.rate_n_flags(false), Radio { mcs: 1, ..radio }.rate_n_flags(true)), (0x100, 0x901));
    }

    #[test]
    fn turn_arounds_keep_to_their_bounds_and_shape() {
        let turn =
            TurnAround { spread_us: 6.0, tail: 0.2, tail_us: -100.0, tail_spread_us: 30.0, ..TurnAround::default() };
        let mut stream = Stream::new(1, 0, Purpose::Timing);
        let draw = |turn: &TurnAround, stream: &mut Stream| {
            let away_ns = turn.draw_away_ns(&mut Away::default(), stream);
            turn.draw_ns(away_ns, stream)
        };
        let mut drawn: Vec<i64> = (0..20_000).map(|_| draw(&turn, &mut stream)).collect();
        drawn.sort_unstable();
        assert_eq!(drawn[0], 145_000, "kept within the bounds");
        assert!(drawn[19_999] < 255_000);
        // A fifth away from the core: the median of the rest is at 0.2 + 0.8 / 2 of all.
        assert!((drawn[12_000] - 225_000).abs() < 1_000, "core {}", drawn[12_000]);
        assert!(drawn[3_800] < 205_000 && drawn[4_300] > 205_000, "{} {}", drawn[3_800], drawn[4_300]);
        assert_eq!(draw(&TurnAround::default(), &mut stream), 225_000);
    }
    #[test]
    fn answers_outside_the_core_come_in_runs_and_groups() {
        let group = |share, us| DelayGroup { share, us, spread_us: 0.0 };
        let turn = TurnAround {
            tail: 0.1,
            far: group(0.06, -200.0),
            late: group(0.04, 70.0),
            tail_run: 4.0,
            ..TurnAround::default()
        };
        let (mut stream, mut away) = (Stream::new(2, 0, Purpose::Timing), Away::default());
        let drawn: Vec<i64> = (0..200_000).map(|_| turn.draw_away_ns(&mut away, &mut stream)).collect();
        let share = |ns: i64| drawn.iter().filter(|&&d| d == ns).count() as f64 / 200_000.0;
        for (ns, expected) in [(0, 0.8), (-100_000, 0.1), (-200_000, 0.06), (70_000, 0.04)] {
            // Runs of four make the count's deviation about sqrt(8) times that of independent draws.
            assert!((share(ns) - expected).abs() < 0.008, "{ns}: {}", share(ns));
        }
        let runs = drawn.chunk_by(|a, b| a == b).filter(|run| run[0] != 0).count();
        let mean = 200_000.0 * 0.2 / runs as f64;
        assert!((mean - 4.0).abs() < 0.25, "{mean} answers a run");
    }
}
