//! Time as an argument: instants in whole microseconds, and the unwrapping of the card's counters.
//!
//! Nothing on the floors below `pipeline` reads a clock. Whoever drives a state machine or a backend hands it an
//! [`Instant`] of its own monotonic clock, real or virtual.

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
    /// No time at all.
    pub const ZERO: Self = Self { us: 0 };

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
pub struct Unwrap32 {
    last: Option<i64>,
}

impl Unwrap32 {
    /// The unwrapped value of the next reading, in counts since the first reading's own wrap.
    pub fn next(&mut self, raw: u32) -> i64 {
        self.next_after(raw, None)
    }

    /// The same, where another clock says how long ago the last reading was (to within half an hour): pauses of any
    /// length are then told apart.
    pub fn next_after(&mut self, raw: u32, elapsed_us: Option<i64>) -> i64 {
        let value = match self.last {
            None => i64::from(raw),
            Some(last) => {
                let expected = last.saturating_add(elapsed_us.unwrap_or(0));
                expected.saturating_add(i64::from(raw.wrapping_sub(expected as u32).cast_signed()))
            }
        };
        self.last = Some(value);
        value
    }
}

/// Steps of a 16-bit wrapping counter (`bfee_count`).
#[derive(Clone, Copy, Debug, Default)]
#[doc(alias = "bfee_count")]
pub struct Step16 {
    last: Option<u16>,
}

impl Step16 {
    /// The step from the last reading to this one, modulo 65,536: 1 for consecutive ones, 0 for a repeated one, over
    /// 32,768 for one that went back. `None` for the first.
    pub fn step(&mut self, raw: u16) -> Option<u16> {
        self.last.replace(raw).map(|last| raw.wrapping_sub(last))
    }

    /// Numbers left out between the last reading and this one: 0 for consecutive ones and for the first.
    ///
    /// A repeated number is a step of 65,536 and counts 65,535; callers that know of duplicates look first.
    pub fn missing(&mut self, raw: u16) -> u16 {
        self.step(raw).map_or(0, |step| step.wrapping_sub(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timestamps_unwrap_forward_and_tolerate_reordering() {
        let mut unwrap = Unwrap32::default();
        assert_eq!(unwrap.next(u32::MAX - 10), i64::from(u32::MAX) - 10);
        assert_eq!(unwrap.next(5), i64::from(u32::MAX) + 6);
        assert_eq!(unwrap.next(u32::MAX), i64::from(u32::MAX));
        assert_eq!(unwrap.next(1_000), i64::from(u32::MAX) + 1_001);
    }

    #[test]
    fn another_clock_tells_long_pauses_apart() {
        let hour_us = 3_600_000_000_i64;
        let mut unwrap = Unwrap32::default();
        assert_eq!(unwrap.next(1_000), 1_000);
        assert_eq!(unwrap.next_after((1_000 + hour_us) as u32, Some(hour_us - 70_000)), 1_000 + hour_us);
        assert_eq!(unwrap.next_after(2_000, None), 2_000 + (1 << 32));
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
