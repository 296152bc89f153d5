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
    /// Share of frames that come a second time, one turn-around later, as in captures with an old responder.
    pub duplicate: f64,
    /// Share of frames that this robot's card sends a second time, as one does that waits for an acknowledgement.
    pub retry: f64,
    /// Share of records lost in the driver, after `bfee_count` was counted up.
    pub driver_drop: f64,
    /// Records that the listener's socket holds: 166 with the kernel's default buffer and WSR records (measured).
    pub queue_records: usize,
    /// The listening process stops every so many seconds; 0 for never.
    pub stall_every_s: f64,
    /// And for so long, seconds.
    pub stall_s: f64,
    /// Times at which the robot is switched off and on: card clock, `bfee_count` and frame numbers begin anew.
    pub restart_at_s: Vec<f64>,
    /// How long a restart takes, seconds.
    pub restart_s: f64,
    /// The logger is killed: its file ends at the last full 4,096 bytes, mid-record.
    pub killed: bool,
    /// What is wrong with the card or its driver.
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

    /// From stall to stall, and the length of one, in whole microseconds: what is due at the end of a stall must not be found
    /// stalled by a rounding error.
    fn stalls_us(&self) -> [i64; 2] {
        [self.stall_every_s, self.stall_s].map(|s| Span::from_s(s).as_us())
    }

    /// False if one stall would begin before the one before it ended.
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

/// What was done to one robot, exactly. The pipeline's own counts are held against it.
///
/// Every frame received is in one place: `received = delivered + unheard + under_way + overheard + unmeasured + driver_dropped +
/// overrun_records`, but for what waits in the queue of a listener that has stopped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Injected {
    /// Frames that this robot sent; a second copy ([`Faults::retry`]) is no other frame.
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
    /// either: a frame counts here although only one of its records was handed on.
    pub duplicated: u64,
    /// Records of others' exchanges, left out by a reader who wants only its own ([`super::Port::own_only`]).
    pub overheard: u64,
    /// Records that reached this robot's host while nobody listened there, or no listener had room.
    pub unheard: u64,
    /// Records on their way to the host when the room was asked.
    pub under_way: u64,
    /// Frames of which no record could be made: the antennas met, or of the signal less was left than numbers tell.
    pub unmeasured: u64,
    /// Records lost in the driver, first and second copies of a frame alike: [`Faults::driver_drop`].
    pub driver_dropped: u64,
    /// Those of them before the first and after the last record that the driver handed on, from each switching on to the
    /// next. No gap in `bfee_count` shows them: a log that ends with lost records has the bytes of one that ended before
    /// them, and one that begins after them those of one that was begun later.
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
    /// What there was any of, in words.
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
