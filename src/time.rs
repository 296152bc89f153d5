//! Time as an argument: instants in whole microseconds, and the unwrapping of the card's counters.
//!
//! No module of this library reads a clock. The caller of a state machine or a source hands it an
//! [`Instant`] of a monotonic clock, real or virtual.

use crate::maths::unwrap_near;
use std::ops::{Add, AddAssign, Sub};

/// A point on the driver's own monotonic clock, in microseconds from an arbitrary origin.
///
/// It is only good for waiting: host wall clocks, the cards' 1 MHz clocks and trajectories are domains of their own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Instant {
    us: i64,
}

/// A length of time in microseconds; may be negative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Span {
    us: i64,
}

impl Instant {
    /// The origin of the clock.
    pub const ZERO: Self = Self { us: 0 };

    /// The instant `us` microseconds after the origin.
    #[must_use]
    pub const fn from_us(us: i64) -> Self {
        Self { us }
    }

    /// Microseconds since the origin.
    #[must_use]
    pub const fn as_us(self) -> i64 {
        self.us
    }

    /// Seconds since the origin.
    #[must_use]
    pub fn as_s(self) -> f64 {
        self.us as f64 * 1e-6
    }
}

impl Span {
    /// A span of `us` microseconds.
    #[must_use]
    pub const fn from_us(us: i64) -> Self {
        Self { us }
    }

    /// A span of `ms` milliseconds, saturating.
    #[must_use]
    pub const fn from_ms(ms: i64) -> Self {
        Self { us: ms.saturating_mul(1_000) }
    }

    /// A span of `s` seconds, rounded to the microsecond, saturating.
    #[must_use]
    pub fn from_s(s: f64) -> Self {
        Self { us: (s * 1e6).round() as i64 }
    }

    /// The span in microseconds.
    #[must_use]
    pub const fn as_us(self) -> i64 {
        self.us
    }

    /// The span in seconds.
    #[must_use]
    pub fn as_s(self) -> f64 {
        self.us as f64 * 1e-6
    }
}

impl Add<Span> for Instant {
    type Output = Self;
    fn add(self, span: Span) -> Self {
        Self { us: self.us.saturating_add(span.us) }
    }
}

impl AddAssign<Span> for Instant {
    fn add_assign(&mut self, span: Span) {
        *self = *self + span;
    }
}

impl Sub<Span> for Instant {
    type Output = Self;
    fn sub(self, span: Span) -> Self {
        Self { us: self.us.saturating_sub(span.us) }
    }
}

impl Sub for Instant {
    type Output = Span;
    fn sub(self, earlier: Self) -> Span {
        Span { us: self.us.saturating_sub(earlier.us) }
    }
}

impl Add for Span {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { us: self.us.saturating_add(other.us) }
    }
}

impl Sub for Span {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self { us: self.us.saturating_sub(other.us) }
    }
}

/// Unwraps a 32-bit microsecond counter (`timestamp_low`, wraps every 4,294.967296 s).
///
/// A step of more than 2^31 us (35.8 min) either way is ambiguous; the nearer reading is taken.
/// Reordered stamps (small steps back) are allowed and unwrap to a smaller value.
#[derive(Clone, Copy, Debug, Default)]
#[doc(alias = "timestamp_low")]
#[doc(hidden)]
pub struct Unwrap32 {
    last: Option<i64>,
}

impl Unwrap32 {
    /// The unwrapped value of the next reading, in counts since the first reading's own wrap.
    pub fn next(&mut self, raw: u32) -> i64 {
        let value = self.last.map_or_else(|| i64::from(raw), |last| unwrap_near(last, raw));
        self.last = Some(value);
        value
    }
}

/// When records reached the host, by the card's own clock: records that are read late, several at once, carry host stamps
/// that are late by an amount that differs from record to record.
///
/// The record with the least delay so far is the reference; the card's clock leads on from it, and no record is put later
/// than it was read. The reference is let go by 1e-4 of the time since, so that the clocks may drift apart;
/// where a record was read more than 50 ms after it should have come (a clock was set, a card restarted, a file played slowly),
/// its reading is believed and is the new reference.
#[derive(Clone, Copy, Debug, Default)]
#[doc(hidden)]
pub struct HostTimes {
    card: Unwrap32,
    /// Host's and card's time of the reference, microseconds.
    reference: Option<(i64, i64)>,
}

impl HostTimes {
    /// How much slower than the host's the card's clock may run: twice the 20 ppm that 802.11 grants each, and more.
    pub(crate) const DRIFT: f64 = 1e-4;
    /// A reading later than this is not put down to the reader.
    pub(crate) const LATE_US: i64 = 50_000;

    /// Host time at which the record came, microseconds, from when it was read and its `timestamp_low`.
    pub fn came_at(&mut self, read_us: i64, timestamp_low: u32) -> i64 {
        let card = self.card.next(timestamp_low);
        if let Some((host, reference)) = self.reference
            && card >= reference
        {
            let since = card - reference;
            let came = host.saturating_add(since).saturating_add((since as f64 * Self::DRIFT) as i64);
            if (0..=Self::LATE_US).contains(&read_us.saturating_sub(came)) {
                return came;
            }
        }
        self.reference = Some((read_us, card));
        read_us
    }
}

/// Steps of a 16-bit wrapping counter (`bfee_count`).
#[derive(Clone, Copy, Debug, Default)]
#[doc(alias = "bfee_count")]
#[doc(hidden)]
pub struct Step16 {
    last: Option<u16>,
}

impl Step16 {
    /// The step from the last reading to this one, modulo 65,536: 1 for consecutive ones, 0 for a repeated one, over
    /// 32,768 for one that went back. `None` for the first.
    pub fn step(&mut self, raw: u16) -> Option<u16> {
        self.last.replace(raw).map(|last| raw.wrapping_sub(last))
    }

    /// Numbers skipped between the last reading and this one: 0 for consecutive ones and for the first.
    ///
    /// A repeated number is a step of 65,536 and counts 65,535; callers that know of duplicates look first.
    pub fn missing(&mut self, raw: u16) -> u16 {
        self.step(raw).map_or(0, |step| step.wrapping_sub(1))
    }
}

/// Two clocks that drift apart by this much at once were not steered: one was set, microseconds.
const SET_US: f64 = 500_000.0;

/// Detects that the host's wall clock was set: it then advances by more or less than the monotonic one.
#[derive(Clone, Copy, Debug, Default)]
#[doc(hidden)]
pub struct WallWatch {
    last: Option<i64>,
}

impl WallWatch {
    /// True if the wall clock was set since the last call; both clocks read at about one moment, microseconds.
    pub fn was_set(&mut self, wall_us: i64, monotonic_us: i64) -> bool {
        let difference = wall_us.saturating_sub(monotonic_us);
        let last = self.last.replace(difference);
        last.is_some_and(|last| difference.saturating_sub(last).unsigned_abs() as f64 > SET_US)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_clock_that_was_set_is_told_from_one_that_is_steered() {
        let mut watch = WallWatch::default();
        // 500 ppm for an hour, in looks of half a second.
        assert!((0..7_200).all(|k| !watch.was_set(1_700_000_000_000_000 + k * 500_250, k * 500_000)));
        let (wall_us, at_us) = (1_700_000_000_000_000 + 7_200 * 500_250, 7_200 * 500_000);
        assert!(watch.was_set(wall_us - 2_000_000, at_us));
        assert!(!watch.was_set(wall_us - 2_000_000 + 500_000, at_us + 500_000));
        assert!(watch.was_set(wall_us + 3_600_000_000, at_us + 1_000_000));
    }

    #[test]
    fn timestamps_unwrap_forward_and_tolerate_reordering() {
        let mut unwrap = Unwrap32::default();
        assert_eq!(unwrap.next(u32::MAX - 10), i64::from(u32::MAX) - 10);
        assert_eq!(unwrap.next(5), i64::from(u32::MAX) + 6);
        assert_eq!(unwrap.next(u32::MAX), i64::from(u32::MAX));
        assert_eq!(unwrap.next(1_000), i64::from(u32::MAX) + 1_001);
    }

    #[test]
    fn records_read_late_and_together_get_the_times_at_which_they_came() {
        // A card 40 ppm slow, a record each 1.3 ms or so that takes 50 us or more, read every 10 ms.
        let mut times = HostTimes::default();
        let (mut last, mut worst) = (0, 0);
        for k in 0..50_000_i64 {
            let came = 7_000_000_000 + k * 1_300 + 50 + k * 7_919 % 300;
            let read = (came / 10_000 + 1) * 10_000;
            let card = 4_294_000_000.0 + (k * 1_300) as f64 * (1.0 - 4e-5);
            let stamp = times.came_at(read, card as u64 as u32);
            assert!(stamp <= read && stamp >= last, "record {k}: {stamp} after {last}, read at {read}");
            last = stamp;
            if k > 1_000 {
                worst = worst.max((stamp - came).abs());
            }
        }
        assert!(worst < 1_500, "{worst} us off, where readings alone are up to 10,000 off");
    }

    #[test]
    fn clocks_that_are_set_are_followed() {
        let mut times = HostTimes::default();
        assert_eq!(times.came_at(1_000_000, 500), 1_000_000);
        assert_eq!(times.came_at(1_012_000, 1_500), 1_001_000, "read late");
        assert_eq!(times.came_at(9_000_000, 2_500), 9_000_000, "the host's clock was set");
        assert_eq!(times.came_at(9_001_000, 3_500), 9_001_000);
        assert_eq!(times.came_at(8_000_000, 4_500), 8_000_000, "and set back");
        assert_eq!(times.came_at(8_001_000, 0), 8_001_000, "the card restarted");
        assert_eq!(times.came_at(8_002_500, 1_000), 8_002_000);
    }

    #[test]
    fn bfee_count_gaps_are_counted_across_the_wrap() {
        let mut step = Step16::default();
        assert_eq!(step.missing(65_534), 0);
        assert_eq!(step.missing(65_535), 0);
        assert_eq!(step.missing(0), 0);
        assert_eq!(step.missing(5), 4);
    }
}
