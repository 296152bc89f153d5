//! Counts of one sender.

use super::clocks::{CardClock, ClockSteps, TimeBase};
use super::senders::Standing;
use crate::maths::upper_median_ord;

/// Counts of frame numbers distinguished for each sender, and how far numbers of one count are from each other at most:
/// initiators begin further apart (`exchange::pairing::numbering`).
pub(super) const COUNTS_KEPT: usize = 16;
pub(super) const SAME_COUNT: u32 = 1 << 22;
/// Inter-packet times kept for the median.
const STEPS_KEPT: usize = 4_096;

/// Steps of a frame number that count as counting up: a sender that several robots share counts past the others' frames.
const COUNTING_UP: std::ops::RangeInclusive<u32> = 1..=64;

/// Frames of one sender in a log.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Sender {
    /// bfee records.
    pub records: u64,
    /// How the card's clock went on from one to the next.
    pub clock_steps: ClockSteps,
    /// Steps of the frame number by 1 to 64.
    #[serde(skip)]
    followed: u64,
    /// Lowest and highest frame number.
    pub frame_count: Option<(u32, u32)>,
    /// Frame numbers skipped on the way up.
    pub frames_skipped: u64,
    /// Frames with the number of the one before: the card reports some twice.
    pub frames_repeated: u64,
    /// Steps back of the frame number: a sender that restarted.
    pub frames_restarted: u64,
    #[serde(skip)]
    numbering: Numbering,
    #[serde(skip)]
    clock: CardClock,
    #[serde(skip)]
    steps_us: Vec<i64>,
    /// Frames that had a number.
    #[serde(skip)]
    pub(crate) numbered: u32,
    #[serde(skip)]
    pub(super) standing: Standing,
}

impl Sender {
    /// The clock that times its records.
    fn time_base(&self) -> TimeBase {
        TimeBase::of(self.records.saturating_sub(1), self.clock_steps.forward_us, self.clock.host_forward_us)
    }

    /// Frames per second from the median time between frames on the card's clock; `None` where that stands.
    #[must_use]
    pub fn rate_hz(&self) -> Option<f64> {
        let median = upper_median_ord(&mut self.steps_us.clone())?;
        (median > 0 && self.time_base() == TimeBase::Card).then(|| 1e6 / median as f64)
    }

    /// Frames per second over the whole log: steps over their sum on the card's clock, pauses included, steps back left
    /// out; where that clock stands, on the host's.
    #[must_use]
    pub fn mean_rate_hz(&self) -> Option<f64> {
        let (steps, us) = match self.time_base() {
            TimeBase::Card => {
                (self.records.saturating_sub(1 + self.clock_steps.steps_back), self.clock_steps.forward_us)
            }
            TimeBase::Host => (self.records.saturating_sub(1), self.clock.host_forward_us),
            TimeBase::Number => return None,
        };
        (us > 0).then(|| 1e6 * steps as f64 / us as f64)
    }

    /// Whether what stands where a sounding frame has its number counts up from frame to frame, in at least half of the
    /// records. Frames of other programs have anything there.
    #[must_use]
    pub fn counts_up(&self) -> bool {
        self.frame_count.is_some() && 2 * self.followed + 2 * self.frames_repeated + 1 >= self.records
    }

    pub(super) fn note(&mut self, frame_count: Option<u32>, timestamp_low: u32, host_us: Option<i64>) {
        self.records += 1;
        self.numbered = self.numbered.saturating_add(u32::from(frame_count.is_some()));
        if let Some(number) = frame_count {
            let (low, high) = self.frame_count.unwrap_or((number, number));
            self.frame_count = Some((low.min(number), high.max(number)));
            self.note_number(number);
        }
        if let (_, Some(step_us)) = self.clock.note(timestamp_low, host_us) {
            self.clock_steps.note(step_us);
            if self.steps_us.len() < STEPS_KEPT {
                self.steps_us.push(step_us);
            }
        }
    }

    fn note_number(&mut self, number: u32) {
        match self.numbering.note(number) {
            NumberStep::New => {}
            NumberStep::Repeated => self.frames_repeated += 1,
            NumberStep::Back => self.frames_restarted += 1,
            NumberStep::Forward(step) => {
                self.followed += u64::from(COUNTING_UP.contains(&step));
                self.frames_skipped += u64::from(step - 1);
            }
        }
    }
}

/// How a frame number went on from those before.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberStep {
    /// The first of a count.
    New,
    /// Up by 1 or more.
    Forward(u32),
    /// The one before once more.
    Repeated,
    /// Back: the sender restarted.
    Back,
}

/// The frame numbers of one sender. Where several robots initiate, a sender's answers bear the numbers of others: there are several
/// counts then, and each number goes on from the nearest one.
#[doc(hidden)]
#[derive(Clone, Debug, Default)]
pub struct Numbering {
    /// The newest number of each count.
    last: Vec<u32>,
}

impl Numbering {
    /// Takes the next number.
    pub fn note(&mut self, number: u32) -> NumberStep {
        let step_from = |last: u32| number.wrapping_sub(last).cast_signed();
        let has_room = self.last.len() < COUNTS_KEPT;
        match self.last.iter_mut().min_by_key(|last| step_from(**last).unsigned_abs()) {
            Some(last) if step_from(*last).unsigned_abs() <= SAME_COUNT => {
                let step = step_from(*last);
                *last = number;
                match step {
                    0 => NumberStep::Repeated,
                    1.. => NumberStep::Forward(step.unsigned_abs()),
                    _ => NumberStep::Back,
                }
            }
            _ if has_room => {
                self.last.push(number);
                NumberStep::New
            }
            _ => NumberStep::Back,
        }
    }
}
