//! A controller's clock brought onto the host's.
//!
//! What a controller reports is old by the time it arrives, by an amount that varies but is never negative. So the
//! host's time minus the controller's is bounded from below by the true difference: the smallest differences of each
//! second lie on a line, the two clocks' offset and drift.

use std::collections::VecDeque;

/// Length of a block of which the smallest difference is kept, microseconds of the controller.
const BLOCK_US: i64 = 1_000_000;
/// Blocks kept.
const BLOCKS: usize = 60;
/// Blocks from which on a drift is fitted.
const DRIFT_BLOCKS: usize = 10;
/// Two crystals do not differ by more than this.
const MAX_DRIFT: f64 = 500e-6;
/// A difference this far from the line means that one clock was set, microseconds.
const STEP_US: f64 = 500_000.0;

/// The fit.
#[derive(Clone, Debug, Default)]
pub struct ClockFit {
    /// (controller's time, smallest host minus controller) of each block, microseconds.
    blocks: VecDeque<(i64, i64)>,
    block_from_us: i64,
    /// Times that a clock was found to have been set.
    pub steps: u64,
}

impl ClockFit {
    /// Takes the two clocks' readings of about one moment, microseconds: the controller's, and the host's before it was
    /// asked and after it had answered. True if one of the clocks was found to have been set.
    pub fn handle(&mut self, controller_us: i64, (asked_us, answered_us): (i64, i64)) -> bool {
        let (least, most) = (asked_us.min(answered_us) - controller_us, asked_us.max(answered_us) - controller_us);
        // The middle of the exchange.
        let difference = least + (most - least) / 2;
        // An exchange may take long, as when the host was busy: only what is outside of it was set.
        let set = self
            .difference_us(controller_us)
            .is_some_and(|expected| expected < least as f64 - STEP_US || expected > most as f64 + STEP_US);
        if set {
            self.blocks.clear();
            self.steps += 1;
        }
        match self.blocks.back_mut() {
            Some(block) if controller_us - self.block_from_us < BLOCK_US => {
                if difference < block.1 {
                    *block = (controller_us, difference);
                }
            }
            _ => {
                self.block_from_us = controller_us;
                self.blocks.push_back((controller_us, difference));
                if self.blocks.len() > BLOCKS {
                    self.blocks.pop_front();
                }
            }
        }
        set
    }

    /// Forgets everything but the count: the controller's clock restarted.
    pub fn restart(&mut self) {
        self.blocks.clear();
    }

    /// The host's time at a time of the controller, microseconds; `None` before the first reading.
    #[must_use]
    pub fn host_us(&self, controller_us: i64) -> Option<f64> {
        Some(controller_us as f64 + self.difference_us(controller_us)?)
    }

    fn difference_us(&self, controller_us: i64) -> Option<f64> {
        let &(origin_x, origin_y) = self.blocks.front()?;
        let points = self.blocks.iter().map(|&(x, y)| ((x - origin_x) as f64, (y - origin_y) as f64));
        let n = self.blocks.len() as f64;
        let slope = if self.blocks.len() >= DRIFT_BLOCKS {
            let (sx, sy) = points.clone().fold((0.0, 0.0), |(sx, sy), (x, y)| (sx + x / n, sy + y / n));
            let (xx, xy) = points
                .clone()
                .fold((0.0, 0.0), |(xx, xy), (x, y)| (xx + (x - sx) * (x - sx), xy + (x - sx) * (y - sy)));
            if xx > 0.0 { (xy / xx).clamp(-MAX_DRIFT, MAX_DRIFT) } else { 0.0 }
        } else {
            0.0
        };
        let lowest = points.map(|(x, y)| y - slope * x).fold(f64::INFINITY, f64::min);
        Some(origin_y as f64 + lowest + slope * (controller_us - origin_x) as f64)
    }
}

/// Detects that the host's wall clock was set: it then advances by more or less than the monotonic one.
#[derive(Clone, Copy, Debug, Default)]
pub struct WallWatch {
    last: Option<i64>,
}

impl WallWatch {
    /// True if the wall clock was set since the last call; both clocks read at about one moment, microseconds.
    pub fn was_set(&mut self, wall_us: i64, monotonic_us: i64) -> bool {
        let difference = wall_us.saturating_sub(monotonic_us);
        let last = self.last.replace(difference);
        last.is_some_and(|last| difference.saturating_sub(last).unsigned_abs() as f64 > STEP_US)
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
    fn offset_and_drift_are_found_below_the_delays() {
        for drift_ppm in [-80.0, 0.0, 120.0] {
            let mut fit = ClockFit::default();
            let true_host = |us: i64| 1.7e15 + us as f64 * (1.0 + drift_ppm * 1e-6);
            for k in 0..6_000_i64 {
                let controller = k * 10_000;
                let delay = 300 + (k * 7_919) % 19_000;
                let host = true_host(controller) as i64 + delay;
                fit.handle(controller, (host, host));
            }
            let late = 60_000_000;
            let error_us = fit.host_us(late).unwrap() - true_host(late);
            assert!((0.0..900.0).contains(&error_us), "{drift_ppm}: {error_us}");
        }
    }

    #[test]
    fn a_clock_that_was_set_begins_a_new_fit() {
        let mut fit = ClockFit::default();
        assert_eq!(fit.host_us(5), None);
        for k in 0..1_000_i64 {
            let jump = if k < 500 { 0 } else { -3_600_000_000 };
            let host = 5_000_000_000 + k * 20_000 + jump + 200;
            assert_eq!(fit.handle(k * 20_000, (host, host)), k == 500);
        }
        assert_eq!(fit.steps, 1);
        assert!((fit.host_us(20_000_000).unwrap() - 1_420_000_200.0).abs() < 1.0);
    }
}
