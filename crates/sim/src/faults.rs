//! Injected faults, exact counts of them, and faults of a card or its driver, which falsify records.
//!
//! Each of the latter is one line of a scene, `faults.card = ["clock_steps"]`. The checks of real cards are tested on them.

use csi5300::time::{Instant, Span};
use driver_iface::bfee::{Iq, Repr};
use serde::{Deserialize, Serialize};

/// Losses and mishaps of one robot, each as its receiver sees it. All off by default.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Faults {
    /// Share of frames that this robot's card does not decode.
    pub loss: f64,
    /// Share of frames that arrive a second time, one turn-around later, as in captures with an old responder.
    pub duplicate: f64,
    /// Share of frames that this robot's card sends twice, like a card that waits for an acknowledgement.
    pub retry: f64,
    /// Share of records lost in the driver, after `bfee_count` was counted up.
    pub driver_drop: f64,
    /// Records that the listener's socket holds: 166 with the kernel's default buffer and WSR records (measured).
    pub queue_records: usize,
    /// The listening process stops every so many seconds; 0 for never.
    pub stall_every_s: f64,
    /// Length of each stop, seconds.
    pub stall_s: f64,
    /// Times at which the robot is switched off and on: card clock, `bfee_count` and frame numbers restart.
    pub restart_at_s: Vec<f64>,
    /// How long a restart takes, seconds.
    pub restart_s: f64,
    /// The logger is killed: its file ends at the last full 4,096 bytes, mid-record.
    pub killed: bool,
    /// Faults of the card or its driver.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub card: Vec<CardFault>,
}

impl Default for Faults {
    fn default() -> Self {
        Self {
            loss: 0.0,
            duplicate: 0.0,
            retry: 0.0,
            driver_drop: 0.0,
            queue_records: 166,
            stall_every_s: 0.0,
            stall_s: 0.0,
            restart_at_s: Vec::new(),
            restart_s: 1.0,
            killed: false,
            card: Vec::new(),
        }
    }
}

impl Faults {
    /// If the listening process is stopped at `now`, when it goes on. Stalls begin at whole multiples of their period.
    pub(crate) fn stalled_until(&self, now: Instant) -> Option<Instant> {
        let [every_us, stall_us] = self.stalls_us();
        if every_us <= 0 || stall_us <= 0 || now.as_us() < every_us {
            return None;
        }
        let until_us = now.as_us() / every_us * every_us + stall_us;
        (now.as_us() < until_us).then_some(Instant::from_us(until_us))
    }

    /// Period and length of stalls in whole microseconds, so that rounding does not delay events at the end of a stall.
    fn stalls_us(&self) -> [i64; 2] {
        [self.stall_every_s, self.stall_s].map(|s| Span::from_s(s).as_us())
    }

    /// False if stalls overlap.
    pub(crate) fn goes_on_after_stalls(&self) -> bool {
        let [every_us, stall_us] = self.stalls_us();
        every_us <= 0 || stall_us < every_us
    }
}

/// The exact account of one robot. Tests compare the pipeline's counts with it.
///
/// `received = delivered + unheard + under_way + overheard + unmeasured + driver_dropped + overrun_records`, except for
/// records in the queue of a stopped listener.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Injected {
    /// Frames that this robot sent; second copies ([`Faults::retry`]) do not count.
    pub sent: u64,
    /// Frames that its card received and that asked for a record (duplicates included).
    pub received: u64,
    /// Frames lost: [`Faults::loss`].
    pub lost: u64,
    /// Frames lost because they overlapped with another on air, or because this robot was sending.
    pub collided: u64,
    /// Frames lost because no path reached this robot.
    pub out_of_reach: u64,
    /// Frames lost because this robot was off.
    pub missed_while_off: u64,
    /// Frames received a second time: [`Faults::duplicate`]. Both copies are in `received`, and the driver may lose
    /// either.
    pub duplicated: u64,
    /// Records of others' exchanges, skipped for a reader of its own only ([`super::Port::own_only`]).
    pub overheard: u64,
    /// Records that reached this robot's host while nobody listened there, or no listener had room.
    pub unheard: u64,
    /// Records on their way to the host at that time.
    pub under_way: u64,
    /// Frames without a record: the antennas met, or the signal vanished numerically.
    pub unmeasured: u64,
    /// Records lost in the driver, first and second copies of a frame alike: [`Faults::driver_drop`].
    pub driver_dropped: u64,
    /// Those before the first and after the last delivered record of each run of the robot. They leave no gap in
    /// `bfee_count`: the log looks as if it started later or ended earlier.
    pub driver_dropped_unseen: u64,
    /// Times the socket's queue ran over.
    pub overruns: u64,
    /// Records lost because of it.
    pub overrun_records: u64,
    /// Restarts.
    pub restarts: u64,
    /// Records handed out, whole; in a served room to one program at least, however many listen.
    pub delivered: u64,
    /// Components of channel coefficients cut to -128 or 127.
    pub saturated: u64,
    /// Records lost at the end of a log whose writer was killed, the cut one included.
    pub tail_records: u64,
    /// Bytes left of the cut record, its length field included.
    pub tail_bytes: u64,
    /// Poses handed out.
    pub poses: u64,
    /// Poses that never came.
    pub poses_dropped: u64,
    /// Poses that came late.
    pub poses_late: u64,
}

impl std::fmt::Display for Injected {
    /// The counts above 0, in words.
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let all = [
            (self.sent, "frames sent"),
            (self.received, "received"),
            (self.lost, "lost"),
            (self.collided, "collided"),
            (self.out_of_reach, "out of reach"),
            (self.missed_while_off, "missed while off"),
            (self.duplicated, "duplicated"),
            (self.overheard, "overheard"),
            (self.unmeasured, "without a record because antennas met or no signal was left"),
            (self.driver_dropped, "records dropped by the driver"),
            (self.driver_dropped_unseen, "of them at an end, where no gap shows them"),
            (self.overruns, "overruns"),
            (self.overrun_records, "records lost in them"),
            (self.restarts, "restarts"),
            (self.unheard, "records nobody listened to"),
            (self.under_way, "records under way"),
            (self.delivered, "records delivered"),
            (self.saturated, "coefficients saturated"),
            (self.tail_records, "records lost at the end of a killed log"),
            (self.tail_bytes, "bytes left of the cut one"),
            (self.poses, "poses"),
            (self.poses_dropped, "poses dropped"),
            (self.poses_late, "poses late"),
        ];
        let words: Vec<String> =
            all.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
        out.write_str(&if words.is_empty() { "nothing".to_owned() } else { words.join(", ") })
    }
}

/// A fault of a card or its driver. Records are changed after the radio has measured and before they are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CardFault {
    /// `antenna_sel` names antennas A and B the wrong way round.
    AntennasSwapped,
    /// `antenna_sel` is A, B, C in every record, whatever the order is.
    AntennasConstant,
    /// `antenna_sel` is no permutation.
    AntennasInvalid,
    /// RSSI of antennas A and B are exchanged.
    RssiSwapped,
    /// Every coefficient is conjugated.
    Conjugated,
    /// The subcarriers are shifted by one place.
    SubcarriersShifted,
    /// The subcarriers are in reverse order.
    SubcarriersReversed,
    /// The card's clock runs 60 ppm fast; its carrier does not.
    ClockFast,
    /// The card's clock steps forward by 0.3 s at the 500th record.
    ClockSteps,
    /// The host's clock steps back by 2 s at the 500th record.
    HostClockSteps,
    /// Every tenth frame is reported under the number of the one before it.
    NumberRepeated,
    /// Every third frame is reported as another robot's.
    OtherSender,
    /// The reported rate is a legacy one.
    LegacyRate,
    /// Every record reports 40 MHz.
    WideTold,
    /// The phase of each record is random.
    PhaseJumps,
    /// The carrier is 7.3 kHz off in reception only.
    CarrierNotShared,
    /// The reported gain is 0 dB.
    NoGain,
    /// Coefficients are six times too large and cut.
    Saturated,
    /// Coefficients are sixteen times too small.
    Faint,
    /// Every second record has one chain fewer.
    ChainsToggle,
    /// Every tenth record's coefficients are all zero.
    ZeroCsi,
    /// Every second record repeats the coefficients of the one before it.
    StaleCsi,
    /// Every second record is written without host time, sender and number.
    NoTail,
    /// Every record ends 20 bytes too early.
    CutShort,
    /// Every 20th record is not made, after `bfee_count` was counted up.
    DropsTwentieth,
    /// `bfee_count` stands still.
    CountStands,
    /// The reported noise floor is -20 dBm.
    NoiseFloor,
    /// The coefficients are mostly noise.
    Deaf,
    /// Antenna B's phase is a quarter of a turn ahead, as after another start state of a divider.
    QuarterTurn,
    /// All phases are half a turn ahead.
    HalfTurn,
}

impl CardFault {
    /// True if it changes what only the WSR driver's records hold: host time, sender, number.
    pub(crate) fn is_of_wsr(self) -> bool {
        matches!(self, Self::HostClockSteps | Self::NumberRepeated | Self::OtherSender | Self::NoTail)
    }

    /// Its name in a scene.
    #[must_use]
    pub fn name(self) -> String {
        serde_json::to_value(self).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default()
    }
}

/// Samples of the largest record of one stream.
const SAMPLES: usize = 90;

/// The faults of one card, and their state.
#[derive(Clone, Debug)]
pub(crate) struct FaultyCard {
    faults: Vec<CardFault>,
    nth: u64,
    last_number: Option<u32>,
    last_csi: [Iq; SAMPLES],
}

/// A random number of 0 to below 1 for a record and a sample: the same on every machine.
fn chance(nth: u64, sample: u64) -> f64 {
    // splitmix64, as in java.util.SplittableRandom.
    let mut x = nth.wrapping_mul(1_000).wrapping_add(sample).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((x ^ (x >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Every coefficient multiplied by `scale` and turned by `turns`, rounded and cut as the card does.
fn turned(csi: &mut [Iq], scale: f64, turns: f64) {
    let angle = std::f64::consts::TAU * turns.fract();
    let (cos, sin) = (libm::cos(angle), libm::sin(angle));
    for iq in csi {
        let (i, q) = (f64::from(iq.i) * scale, f64::from(iq.q) * scale);
        let cut = |x: f64| libm::round(x).clamp(-128.0, 127.0) as i8;
        *iq = Iq { i: cut(i * cos - q * sin), q: cut(i * sin + q * cos) };
    }
}

impl FaultyCard {
    /// A card with these faults; `None` where there are none.
    pub(crate) fn new(faults: &[CardFault]) -> Option<Self> {
        let card = Self { faults: faults.to_vec(), nth: 0, last_number: None, last_csi: [Iq::default(); SAMPLES] };
        (!faults.is_empty()).then_some(card)
    }

    /// Changes a record before it is written; `t_s` is the true time. False if there is no record.
    pub(crate) fn change(&mut self, repr: &mut Repr, csi: &mut [Iq; SAMPLES], t_s: f64) -> bool {
        self.nth += 1;
        let measured = *csi;
        let mut made = true;
        for fault in self.faults.clone() {
            made &= self.apply(fault, repr, csi, t_s);
        }
        self.last_csi = measured;
        made
    }

    fn apply(&mut self, fault: CardFault, repr: &mut Repr, csi: &mut [Iq; SAMPLES], t_s: f64) -> bool {
        let nth = self.nth;
        let n_rx = usize::from(repr.n_rx);
        match fault {
            CardFault::AntennasSwapped => {
                let renamed = |bits: u8| if bits < 2 { bits ^ 1 } else { bits };
                repr.antenna_sel = (0..3).fold(0, |sel, k| sel | renamed(repr.antenna_sel >> (2 * k) & 3) << (2 * k));
            }
            CardFault::AntennasConstant => repr.antenna_sel = 0x24,
            CardFault::AntennasInvalid => repr.antenna_sel = 0x00,
            CardFault::RssiSwapped => repr.rssi.swap(0, 1),
            CardFault::Conjugated => csi.iter_mut().for_each(|iq| iq.q = iq.q.saturating_neg()),
            CardFault::SubcarriersShifted => csi[..30 * n_rx].rotate_right(n_rx),
            CardFault::SubcarriersReversed => {
                csi[..30 * n_rx].reverse();
                csi[..30 * n_rx].chunks_exact_mut(n_rx).for_each(<[Iq]>::reverse);
            }
            CardFault::ClockFast => repr.timestamp_low = repr.timestamp_low.wrapping_add((t_s * 60.0) as u32),
            CardFault::ClockSteps if nth >= 500 => repr.timestamp_low = repr.timestamp_low.wrapping_add(300_000),
            CardFault::HostClockSteps if nth >= 500 => {
                if let Some(wsr) = &mut repr.wsr {
                    wsr.tv_sec = wsr.tv_sec.saturating_sub(2);
                }
            }
            CardFault::NumberRepeated => {
                let number = repr.wsr.as_mut().and_then(|wsr| wsr.frame_count.as_mut());
                if let Some((number, last)) = number.zip(self.last_number.as_mut()) {
                    let told = if nth.is_multiple_of(10) { *last } else { *number };
                    *last = *number;
                    *number = told;
                } else {
                    self.last_number = repr.wsr.and_then(|wsr| wsr.frame_count);
                }
            }
            CardFault::OtherSender if nth.is_multiple_of(3) => {
                if let Some(wsr) = &mut repr.wsr {
                    wsr.mac.0[4] ^= 0x55;
                }
            }
            CardFault::LegacyRate => repr.rate_n_flags = 0x000D,
            CardFault::WideTold => repr.rate_n_flags |= 0x0800,
            CardFault::PhaseJumps => turned(csi, 1.0, chance(nth, 0)),
            CardFault::CarrierNotShared => turned(csi, 1.0, 7_321.0 * t_s),
            CardFault::NoGain => repr.agc = 0,
            CardFault::Saturated => turned(csi, 6.0, 0.0),
            CardFault::Faint => turned(csi, 1.0 / 16.0, 0.0),
            CardFault::ChainsToggle if n_rx > 1 && nth.is_multiple_of(2) => {
                let before = *csi;
                for (to, from) in csi.chunks_exact_mut(n_rx - 1).zip(before.chunks_exact(n_rx)) {
                    to.copy_from_slice(&from[..n_rx - 1]);
                }
                repr.n_rx -= 1;
            }
            CardFault::ZeroCsi if nth.is_multiple_of(10) => *csi = [Iq::default(); SAMPLES],
            CardFault::StaleCsi if nth.is_multiple_of(2) => *csi = self.last_csi,
            CardFault::NoTail if nth.is_multiple_of(2) => repr.wsr = None,
            CardFault::DropsTwentieth => return !nth.is_multiple_of(20),
            CardFault::CountStands => repr.bfee_count = 7,
            CardFault::NoiseFloor => repr.noise_dbm = -20,
            CardFault::Deaf => {
                let noise = |sample: usize, half: u64| {
                    // The sum of four has a standard deviation of 1/sqrt(3).
                    let sum: f64 = (0..4).map(|k| chance(nth, 8 * sample as u64 + 4 * half + k) - 0.5).sum();
                    libm::round(sum * 60.0) as i8
                };
                turned(csi, 0.3, 0.0);
                for (sample, iq) in csi.iter_mut().enumerate() {
                    *iq = Iq { i: iq.i.saturating_add(noise(sample, 0)), q: iq.q.saturating_add(noise(sample, 1)) };
                }
            }
            CardFault::QuarterTurn => {
                let chain = (0..n_rx).find(|chain| repr.antenna_sel >> (2 * chain) & 3 == 1);
                if let Some(chain) = chain {
                    csi[..30 * n_rx].chunks_exact_mut(n_rx).for_each(|row| turned(&mut row[chain..=chain], 1.0, 0.25));
                }
            }
            CardFault::HalfTurn => turned(csi, 1.0, 0.5),
            _ => {}
        }
        true
    }

    /// Bytes of a record's body that are written.
    pub(crate) fn kept(&self, body_len: usize) -> usize {
        if self.faults.contains(&CardFault::CutShort) { body_len.saturating_sub(20) } else { body_len }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stalls_have_their_times() {
        let faults = Faults { stall_every_s: 10.0, stall_s: 2.0, ..Faults::default() };
        let until_ms = |faults: &Faults, ms: i64| {
            faults.stalled_until(Instant::from_us(1_000 * ms)).map(|until| until.as_us() / 1_000)
        };
        assert_eq!(until_ms(&faults, 1_000), None, "the first stall is after one period");
        assert_eq!(until_ms(&faults, 11_000), Some(12_000));
        assert_eq!(until_ms(&faults, 12_000), None);
        let fine = Faults { stall_every_s: 3.0, stall_s: 0.4, ..Faults::default() };
        assert_eq!((until_ms(&fine, 6_399), until_ms(&fine, 6_400)), (Some(6_400), None), "no endless stall");
        assert_eq!(until_ms(&Faults::default(), 20_000), None);
        let rounded = |stall_s| Faults { stall_every_s: 2e-6, stall_s, ..Faults::default() }.goes_on_after_stalls();
        assert_eq!([1.4e-6, 1.6e-6].map(rounded), [true, false], "1 and 2 of 2 us");
    }
}
