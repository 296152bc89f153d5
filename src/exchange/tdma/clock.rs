//! Slots on a robot's own clock, whose epoch follows received frames.

use super::plan::Plan;
use crate::time::{Instant, Span};

/// The origin of slot 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Epoch {
    /// Known beforehand on this robot's clock (clocks are synchronised by other means); never adjusted.
    Common(Instant),
    /// Taken from the forward frames heard; until then slots count from this instant. Robots need no common clock.
    Heard(Instant),
}

/// After this many contradicting frames in a row the epoch is wrong.
const OFF_EPOCH_FRAMES: u32 = 8;
/// The epoch is kept in sixteenths of a microsecond, so that small corrections are not lost to rounding.
const FRACTION: i64 = 16;
/// Weight of an error in sixteenths. Frames can only be late (scheduling, delivery), so an early one has more weight.
const EARLY: i64 = 8;
const LATE: i64 = 1;

/// Slot times on this robot's clock.
#[derive(Clone, Copy, Debug)]
pub(super) struct SlotClock {
    epoch_16: i64,
    follows: bool,
    locked: bool,
    off_epoch: u32,
    /// Errors up to this are followed smoothly, microseconds.
    tolerance_us: i64,
}

impl SlotClock {
    pub(super) fn new(epoch: Epoch, plan: &Plan) -> Self {
        let (at, follows) = match epoch {
            Epoch::Common(at) => (at, false),
            Epoch::Heard(at) => (at, true),
        };
        let tolerance_us = (plan.guard().as_us() * 4).min(i64::from(plan.round_us()) / 2).max(1);
        let epoch_16 = at.as_us().saturating_mul(FRACTION);
        Self { epoch_16, follows, locked: !follows, off_epoch: 0, tolerance_us }
    }

    /// Slot 0 on this robot's clock, rounded down to the microsecond.
    pub(super) fn epoch(&self) -> Instant {
        Instant::from_us(self.epoch_16.div_euclid(FRACTION))
    }

    /// True if the epoch is common or has been taken from a frame since it was last given up.
    pub(super) fn is_locked(&self) -> bool {
        self.locked
    }

    /// Drops the epoch; the next frame sets it.
    pub(super) fn unlock(&mut self) {
        self.locked = !self.follows;
    }

    /// This robot initiates, so its epoch is the one to follow.
    pub(super) fn lock(&mut self) {
        self.locked = true;
    }

    pub(super) fn start(&self, plan: &Plan, slot: i64) -> Instant {
        plan.slot_start(self.epoch(), slot)
    }

    pub(super) fn slot_at(&self, plan: &Plan, now: Instant) -> i64 {
        plan.slot_at(now - self.epoch())
    }

    /// The first slot that does not start before `at`.
    pub(super) fn slot_from(&self, plan: &Plan, at: Instant) -> i64 {
        self.slot_at(plan, at - Span::from_us(1)) + 1
    }

    /// True if a frame of `slot` may begin at `began`: it fits, no epoch is known, or too many frames in a row did not
    /// fit. Call it once per frame.
    pub(super) fn admits(&mut self, plan: &Plan, slot: i64, began: Instant) -> bool {
        if !self.locked {
            return true;
        }
        let fits = self.error_us(plan, slot, began).saturating_abs() <= self.tolerance_us;
        self.off_epoch = if fits { 0 } else { self.off_epoch.saturating_add(1) };
        fits || self.off_epoch > OFF_EPOCH_FRAMES
    }

    /// Follows an admitted frame that began at the start of `slot` on its sender's clock and at `began` on this one.
    pub(super) fn follow(&mut self, plan: &Plan, slot: i64, began: Instant) {
        if !self.follows {
            return;
        }
        let error_us = self.error_us(plan, slot, began);
        if !self.locked || error_us.saturating_abs() > self.tolerance_us {
            self.epoch_16 = self.epoch_16.saturating_add(error_us.saturating_mul(FRACTION));
            (self.locked, self.off_epoch) = (true, 0);
            return;
        }
        self.epoch_16 += error_us * if error_us < 0 { EARLY } else { LATE };
    }

    /// How much later than the start of `slot` `at` is.
    fn error_us(&self, plan: &Plan, slot: i64, at: Instant) -> i64 {
        (at - self.start(plan, slot)).as_us()
    }
}

#[cfg(test)]
mod tests {
    use super::super::plan::Request;
    use super::*;

    fn plan() -> Plan {
        Plan::new(&Request::new(3, 100.0)).unwrap()
    }

    #[test]
    fn the_epoch_is_found_and_kept_under_jitter_and_skew() {
        let plan = plan();
        let mut clock = SlotClock::new(Epoch::Heard(Instant::ZERO), &plan);
        let mut state = 1u64;
        let mut worst_us = 0;
        for slot in 10..30_000i64 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let jitter_us = (state >> 33) as i64 % 60;
            let ideal_us = 7_000_123 + plan.offset_of(slot).as_us();
            let skewed_us = ideal_us + ideal_us / 10_000; // 100 ppm
            clock.follow(&plan, slot, Instant::from_us(skewed_us + jitter_us));
            if slot > 1_000 {
                worst_us = worst_us.max((clock.start(&plan, slot).as_us() - skewed_us).abs());
            }
        }
        assert!(clock.is_locked());
        assert!(worst_us < plan.guard().as_us(), "{worst_us} us");
    }

    #[test]
    fn a_stray_frame_does_not_move_the_epoch_and_many_do() {
        let plan = plan();
        let mut clock = SlotClock::new(Epoch::Heard(Instant::ZERO), &plan);
        assert!(clock.admits(&plan, 0, Instant::from_us(500)));
        clock.follow(&plan, 0, Instant::from_us(500));
        for slot in 1..=8 {
            assert!(!clock.admits(&plan, slot, clock.start(&plan, slot) + Span::from_ms(2)));
        }
        assert!(clock.admits(&plan, 9, clock.start(&plan, 9)), "one that fits starts the count anew");
        for slot in 10..=17 {
            assert!(!clock.admits(&plan, slot, clock.start(&plan, slot) + Span::from_ms(2)));
        }
        let late = clock.start(&plan, 18) + Span::from_ms(2);
        assert!(clock.admits(&plan, 18, late));
        clock.follow(&plan, 18, late);
        assert_eq!(clock.epoch(), Instant::from_us(2_500));
    }

    #[test]
    fn a_common_epoch_stays() {
        let plan = plan();
        let mut common = SlotClock::new(Epoch::Common(Instant::from_us(5)), &plan);
        assert!(common.admits(&plan, 0, Instant::from_us(105)));
        assert!(!common.admits(&plan, 0, Instant::from_us(900)));
        common.follow(&plan, 0, Instant::from_us(105));
        assert_eq!(common.epoch(), Instant::from_us(5));
    }

    #[test]
    fn slots_are_found_from_both_sides_of_their_start() {
        let plan = plan();
        let mut clock = SlotClock::new(Epoch::Heard(Instant::from_us(1_000)), &plan);
        for slot in [-3, 0, 7] {
            let (start, us) = (clock.start(&plan, slot), Span::from_us(1));
            assert_eq!(start, Instant::from_us(1_000) + plan.offset_of(slot));
            assert_eq!([start - us, start, start + us].map(|at| clock.slot_at(&plan, at)), [slot - 1, slot, slot]);
            assert_eq!([start - us, start, start + us].map(|at| clock.slot_from(&plan, at)), [slot, slot, slot + 1]);
        }
        // After a drop the next frame sets the epoch, however near it is; an early frame weighs eight times a late one.
        clock.lock();
        let near = Span::from_us(4);
        clock.follow(&plan, 0, clock.start(&plan, 0) + near);
        assert_eq!(clock.epoch_16, 16_000 + 4);
        clock.follow(&plan, 0, clock.start(&plan, 0) - near);
        assert_eq!(clock.epoch_16, 16_004 - 8 * 4);
        // Errors up to the limit are followed smoothly, larger ones at once.
        let (before, most) = (clock.epoch_16, Span::from_us(clock.tolerance_us));
        clock.follow(&plan, 0, clock.start(&plan, 0) + most);
        assert_eq!(clock.epoch_16, before + clock.tolerance_us);
        let (before, more) = (clock.epoch_16, Span::from_us(clock.tolerance_us + 1));
        clock.follow(&plan, 0, clock.start(&plan, 0) + more);
        assert_eq!(clock.epoch_16, before + 16 * (clock.tolerance_us + 1));
        clock.unlock();
        assert!(!clock.is_locked());
        clock.follow(&plan, 0, Instant::from_us(1_004));
        assert_eq!((clock.epoch(), clock.is_locked()), (Instant::from_us(1_004), true));
        let mut common = SlotClock::new(Epoch::Common(Instant::ZERO), &plan);
        common.unlock();
        assert!(common.is_locked(), "a common epoch is not given up");
    }
}
