//! Injected faults, and exact counts of them.

use super::card_fault::CardFault;
use csi5300::time::{Instant, Span};
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
    #[must_use]
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

    /// If the robot is off at `t_s`.
    #[must_use]
    pub fn is_off(&self, t_s: f64) -> bool {
        self.restart_at_s.iter().any(|&at_s| (at_s..at_s + self.restart_s).contains(&t_s))
    }
}

/// The exact account of one robot. Tests compare the pipeline's counts with it.
///
/// `received = delivered + unheard + under_way + overheard + unmeasured + driver_dropped + overrun_records`, except for
/// records in the queue of a stopped listener.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stalls_and_restarts_have_their_times() {
        let faults =
            Faults { stall_every_s: 10.0, stall_s: 2.0, restart_at_s: vec![3.0], restart_s: 0.5, ..Faults::default() };
        let until_ms = |faults: &Faults, ms: i64| {
            faults.stalled_until(Instant::from_us(1_000 * ms)).map(|until| until.as_us() / 1_000)
        };
        assert_eq!(until_ms(&faults, 1_000), None, "the first stall is after one period");
        assert_eq!(until_ms(&faults, 11_000), Some(12_000));
        assert_eq!(until_ms(&faults, 12_000), None);
        let fine = Faults { stall_every_s: 3.0, stall_s: 0.4, ..Faults::default() };
        assert_eq!((until_ms(&fine, 6_399), until_ms(&fine, 6_400)), (Some(6_400), None), "no endless stall");
        assert!(!faults.is_off(2.9) && faults.is_off(3.2) && !faults.is_off(3.5));
        assert_eq!(until_ms(&Faults::default(), 20_000), None);
        let rounded = |stall_s| Faults { stall_every_s: 2e-6, stall_s, ..Faults::default() }.goes_on_after_stalls();
        assert_eq!([1.4e-6, 1.6e-6].map(rounded), [true, false], "1 and 2 of 2 us");
    }
}
