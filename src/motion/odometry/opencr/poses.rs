//! Poses from the controller's sensors: its clock brought onto the host's, its ticks and its heading onto the ground.

use super::super::clock::ClockFit;
use super::super::drive::{Drive, Geometry, Reading, WheelCounts};
use super::Found;
use super::dialogue::Asked;
use super::table::{Identity, Table};
use crate::motion::pose::Pose;
use crate::time::{Instant, Unwrap32};
use std::collections::VecDeque;

/// A controller's clock that advances by this much more or less than the host's has restarted, microseconds.
const RESTART_US: i64 = 500_000;
/// Steps of the controller's two clocks that differ by no more are the same step, microseconds: it reads one after the
/// other.
const SAME_STEP_US: i64 = 2_000;

/// The controller's clock.
#[derive(Clone, Copy, Debug)]
struct Clock {
    millis: Unwrap32,
    last: (i64, u32),
    us: i64,
    /// When it was asked and when it had answered, on the driver's clock: it was read in between.
    asked: Instant,
    at: Instant,
}

/// The robot's pose by its controller's data so far.
#[derive(Debug)]
pub(super) struct Poses {
    geometry: Option<Geometry>,
    drive: Drive,
    fit: ClockFit,
    clock: Option<Clock>,
    found: VecDeque<Found>,
    pub(super) repeated: u64,
    pub(super) restarts: u64,
}

impl Poses {
    pub(super) fn new(geometry: Option<Geometry>) -> Self {
        Self {
            geometry,
            drive: Drive::new(geometry.unwrap_or(Geometry::BURGER)),
            fit: ClockFit::default(),
            clock: None,
            found: VecDeque::new(),
            repeated: 0,
            restarts: 0,
        }
    }

    /// Times that one of the two clocks was set, and what was counted of the wheels.
    pub(super) fn counts(&self) -> (u64, WheelCounts) {
        (self.fit.steps, self.drive.counts)
    }

    pub(super) fn poll_found(&mut self) -> Option<Found> {
        self.found.pop_front()
    }

    /// The controller's model is known, before its first reading.
    pub(super) fn handle_identity(&mut self, identity: Identity) {
        if self.geometry.is_none() && self.clock.is_none() {
            self.drive = Drive::new(if identity.is_burger { Geometry::BURGER } else { Geometry::WAFFLE });
        }
    }

    /// A reading that was requested at `asked` and arrived at `now`.
    pub(super) fn handle_sensors(&mut self, table: &Table, asked: Asked, now: Instant, wall_us: i64) {
        let Some(controller_us) = self.controller_time(table, asked.at, now) else { return };
        // The answer was made up between the two.
        if self.fit.handle(controller_us, (asked.wall_us, wall_us)) {
            // The poses so far have times of another clock.
            self.found.push_back(Found::NewFrame);
        }
        let Some(host_us) = self.fit.host_us(controller_us) else { return };
        let reading = Reading {
            t_s: controller_us as f64 * 1e-6,
            left: table.left,
            right: table.right,
            heading_rad: table.heading_rad,
        };
        if self.drive.handle(reading) {
            let (position_m, heading_rad) = self.drive.place();
            let pose = Pose { t_s: host_us * 1e-6, position_m, heading_rad: Some(heading_rad) };
            self.found.push_back(Found::Pose(pose));
        } else {
            // How far it went in that step is not known.
            self.found.push_back(Found::NewFrame);
        }
    }

    /// The controller's clock, unwrapped microseconds; `None` if nothing was refreshed.
    fn controller_time(&mut self, table: &Table, asked: Instant, now: Instant) -> Option<i64> {
        let mut clock = match self.clock {
            Some(clock) => clock,
            None => {
                let last = (i64::from(table.millis), table.micros);
                Clock { millis: Unwrap32::default(), last, us: 0, asked, at: now }
            }
        };
        let first = self.clock.is_none();
        let millis = clock.millis.next(table.millis);
        let step_us = (millis - clock.last.0) * 1_000;
        // Each reading was made between asking and having the answer, however late that was looked at.
        let (least_us, most_us) = ((asked - clock.at).as_us(), (now - clock.asked).as_us());
        if !first && (step_us < 0 || step_us < least_us - RESTART_US || step_us > most_us + RESTART_US) {
            self.restart();
            return self.controller_time(table, asked, now);
        }
        // Microseconds where the firmware keeps them along with the milliseconds.
        let fine_us = i64::from(table.micros.wrapping_sub(clock.last.1));
        clock.us += if (fine_us - step_us).abs() <= SAME_STEP_US { fine_us } else { step_us };
        let repeated = !first && step_us == 0 && clock.us == self.clock.map_or(0, |last| last.us);
        clock.last = (millis, table.micros);
        (clock.asked, clock.at) = (asked, now);
        self.clock = Some(clock);
        self.repeated += u64::from(repeated);
        (!repeated).then_some(clock.us)
    }

    /// The controller restarted: what was driven meanwhile is not known.
    fn restart(&mut self) {
        self.restarts += 1;
        self.clock = None;
        self.fit.restart();
        self.drive.restart();
        self.found.push_back(Found::NewFrame);
    }
}
