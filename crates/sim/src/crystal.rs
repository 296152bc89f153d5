//! One crystal per card: it drives the 1 MHz clock, the carrier and the sampling clock.
//!
//! In real captures the relative carrier offset agrees with the drift between two cards' `timestamp_low` to a fraction
//! of a ppm. So the model is one function of time, the crystal's time error `x(t)` (seconds gained since the start of
//! the scene): card time `t + x(t)`, carrier phase `fc x(t)` turns ahead of a perfect card's.

use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A tick of 320 MHz, picoseconds.
const FTM_TICK_PS: i128 = csi_formats::feitcsi::FTM_TICK_PS as i128;
/// Ticks in a microsecond.
pub(crate) const FTM_TICKS_PER_US: u64 = 320;

/// How far a card's crystal is off, as a relative frequency error over time; all zeros is a perfect one.
///
/// `y(t) = offset + drift t + warm_up exp(-t / warm_up_s) + wander sin(2 pi t / wander_period_s)`, in ppm.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Crystal {
    /// Constant offset, ppm; 1 ppm is 5.5 kHz at channel 108. Between real cards: 0.7 to 3.8 ppm.
    pub offset_ppm: f64,
    /// Linear drift, ppm per second.
    pub drift_ppm_per_s: f64,
    /// Extra offset at the start that dies away, ppm.
    pub warm_up_ppm: f64,
    /// Time constant of the warming up, seconds.
    pub warm_up_s: f64,
    /// Amplitude of a slow sinusoidal change, ppm.
    pub wander_ppm: f64,
    /// Its period, seconds.
    pub wander_period_s: f64,
    /// What the card's microsecond clock shows at the start of the scene, as an unwrapped count.
    pub clock_start_us: u64,
}

impl Default for Crystal {
    fn default() -> Self {
        Self {
            offset_ppm: 0.0,
            drift_ppm_per_s: 0.0,
            warm_up_ppm: 0.0,
            warm_up_s: 60.0,
            wander_ppm: 0.0,
            wander_period_s: 60.0,
            clock_start_us: 0,
        }
    }
}

impl Crystal {
    /// Time gained on true time since the scene began, seconds, at true time `t_s`.
    #[must_use]
    pub(crate) fn gained_s(&self, t_s: f64) -> f64 {
        let mut ppm_s = self.offset_ppm * t_s + 0.5 * self.drift_ppm_per_s * t_s * t_s;
        if self.warm_up_ppm != 0.0 {
            ppm_s += self.warm_up_ppm * self.warm_up_s * (1.0 - libm::exp(-t_s / self.warm_up_s));
        }
        if self.wander_ppm != 0.0 {
            let turn = TAU / self.wander_period_s;
            ppm_s += self.wander_ppm / turn * (1.0 - libm::cos(turn * t_s));
        }
        1e-6 * ppm_s
    }

    /// The card's clock in whole microseconds (not wrapped) at a true time in nanoseconds.
    ///
    /// The card truncates, and `timestamp_low` is the lower 32 bits.
    #[must_use]
    pub fn clock_us(&self, t_ns: i64) -> u64 {
        // Whole nanoseconds and the small gain are separate, so an hour loses no microsecond.
        let gained_ns = (self.gained_s(t_ns as f64 * 1e-9) * 1e9).round() as i64;
        self.clock_start_us.wrapping_add_signed(t_ns.saturating_add(gained_ns).div_euclid(1_000))
    }

    /// The clock of an AX210's fine timing measurement at a true time in nanoseconds: whole ticks of 320 MHz, not wrapped, from
    /// the same moment on as [`Crystal::clock_us`].
    #[must_use]
    pub(crate) fn ftm(&self, t_ns: i64) -> u64 {
        let gained_ps = (self.gained_s(t_ns as f64 * 1e-9) * 1e12).round() as i128;
        let ticks = (i128::from(t_ns) * 1_000 + gained_ps).div_euclid(FTM_TICK_PS);
        self.clock_start_us.wrapping_mul(FTM_TICKS_PER_US).wrapping_add_signed(ticks as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wandering() -> Crystal {
        Crystal {
            offset_ppm: -3.2,
            drift_ppm_per_s: 1e-3,
            warm_up_ppm: 0.4,
            warm_up_s: 4.0,
            wander_ppm: 0.1,
            wander_period_s: 20.0,
            clock_start_us: 1_000,
        }
    }

    #[test]
    fn the_gain_is_the_integral_of_the_frequency_error() {
        let c = wandering();
        let frequency_ppm = |t: f64| {
            c.offset_ppm
                + c.drift_ppm_per_s * t
                + c.warm_up_ppm * (-t / c.warm_up_s).exp()
                + c.wander_ppm * (TAU * t / c.wander_period_s).sin()
        };
        for t in [0.0, 1.5, 30.0, 600.0] {
            let slope_ppm = (c.gained_s(t + 1e-3) - c.gained_s(t - 1e-3)) / 2e-3 * 1e6;
            assert!((slope_ppm - frequency_ppm(t)).abs() < 1e-5, "at {t} s: {slope_ppm}");
        }
        assert_eq!(c.gained_s(0.0), 0.0);
    }

    #[test]
    fn the_clock_counts_whole_microseconds_of_the_crystal() {
        let perfect = Crystal { clock_start_us: u64::from(u32::MAX), ..Crystal::default() };
        assert_eq!(perfect.clock_us(1_999), u64::from(u32::MAX) + 1);
        assert_eq!(perfect.clock_us(2_000), u64::from(u32::MAX) + 2);
        assert_eq!(perfect.ftm(25), (u64::from(u32::MAX)) * 320 + 8);
        let fast = Crystal { offset_ppm: 2.0, ..Crystal::default() };
        assert_eq!(fast.ftm(1_000_000_000_000), 1_000_002_000 * 320);
        assert_eq!(fast.clock_us(1_000_000_000_000), 1_000_002_000, "2 ppm over 1,000 s");
    }
}
