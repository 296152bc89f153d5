//! The controller of a TurtleBot3 (OpenCR with the ROS 2 firmware), sans-IO: requests to it, and poses from its answers.
//!
//! Requests one range of its control table with clock, IMU orientation and wheel ticks, so that the three belong
//! together. It never writes to the controller. The table: `turtlebot3_node`'s `control_table.hpp` and the firmware's
//! `turtlebot3.cpp`; its values are refreshed every 20 ms, so faster requests give repetitions, which are skipped and
//! counted.
//!
//! [`OpenCr`] is the dialogue on the line (`Table`), and has what makes poses of its answers (`Poses`): the
//! controller's clock brought onto the host's (`ClockFit`), wheel ticks and the gyroscope's heading on the ground (`Drive`).

use super::NextPose;
use super::dynamixel::{PacketCounts, Parser, Status, emit_read};
use crate::maths::wrap_rad;
use crate::motion::pose::{Pose, heading_of};
use crate::time::{Instant, Span, Unwrap32};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::collections::VecDeque;

/// Counts of a controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct ControllerCounts {
    /// Requests sent.
    pub requests: u64,
    /// Requests that were not answered in time.
    pub unanswered: u64,
    /// Answers with an error, of another device, or of another length.
    pub refused: u64,
    /// Answers whose values had not been refreshed since the last.
    pub repeated: u64,
    /// Times that the controller restarted: what was driven meanwhile is not known.
    pub restarts: u64,
    /// Times that one of the two clocks was set.
    pub clock_steps: u64,
    /// The line.
    pub packets: PacketCounts,
    /// The wheels.
    pub drive: WheelCounts,
}

/// The dialogue with one controller. Call [`poll_transmit`](Self::poll_transmit) and write its bytes;
/// [`handle_bytes`](Self::handle_bytes) with the bytes read; [`poll_found`](Self::poll_found) until `None`; wait until
/// [`poll_timeout`](Self::poll_timeout) or until there are bytes.
#[derive(Debug)]
pub struct OpenCr {
    period: Span,
    known: Known,
    parser: Parser,
    waiting: Option<Request>,
    due: Instant,
    silent: u32,
    /// Answers refused in a row, and the error of the last.
    refused: (u32, u8),
    device_status: i8,
    buffer: Vec<u8>,
    counts: ControllerCounts,
    poses: Poses,
}

impl OpenCr {
    /// A dialogue that asks `rate_hz` times a second, from `now` on. Without a `geometry` the controller says which model
    /// it is.
    #[must_use]
    pub fn new(rate_hz: f64, geometry: Option<Geometry>, now: Instant) -> Self {
        Self {
            period: period(rate_hz),
            known: Known::Nothing,
            parser: Parser::default(),
            waiting: None,
            due: now,
            silent: 0,
            refused: (0, 0),
            device_status: 0,
            buffer: Vec::new(),
            counts: ControllerCounts::default(),
            poses: Poses::new(geometry),
        }
    }

    /// The counts.
    #[must_use]
    pub fn counts(&self) -> ControllerCounts {
        ControllerCounts {
            repeated: self.poses.repeated,
            restarts: self.poses.restarts,
            clock_steps: self.poses.fit.steps,
            packets: self.parser.counts,
            drive: self.poses.drive.counts,
            ..self.counts
        }
    }

    /// What is wrong, in words, if anything is.
    #[must_use]
    pub fn trouble(&self) -> Option<String> {
        match self.known {
            Known::Other(model) => Some(format!(
                "the device answers as model {model:#06x}; the controller of a TurtleBot3 is {MODEL:#06x}: is this its port?"
            )),
            _ if self.refused.0 >= SILENT => Some(format!(
                "the controller refuses to be read ({} times in a row, error {}): is its firmware that of ROS 2?",
                self.refused.0, self.refused.1
            )),
            _ if self.silent < SILENT && self.device_status != 0 => Some(format!(
                "the controller says device status {} (-1: it finds no motors): are its motors connected and powered?",
                self.device_status
            )),
            _ if self.silent < SILENT => None,
            _ if self.parser.counts.packets == 0 && self.parser.counts.skipped_bytes > 0 => Some(
                "bytes come, but not of DYNAMIXEL protocol 2.0: the ROS 1 firmware speaks rosserial, take its /odom instead"
                    .into(),
            ),
            _ => Some(
                "the controller does not answer: is it switched on, and does no other program (turtlebot3_node) hold the port?"
                    .into(),
            ),
        }
    }

    /// The port was reopened: nothing that was asked before will be answered.
    pub fn reopened(&mut self, now: Instant) {
        self.parser.reset();
        (self.waiting, self.due, self.known) = (None, now, Known::Nothing);
    }

    /// When it wants to be asked next.
    #[must_use]
    pub fn poll_timeout(&self) -> Instant {
        self.waiting.map_or(self.due, |request| request.until)
    }

    /// True while an answer is awaited.
    #[must_use]
    pub fn is_waiting(&self) -> bool {
        self.waiting.is_some()
    }

    /// The request to write now, if one is due. `wall_us` is the host's wall clock, microseconds since the Unix epoch.
    pub fn poll_transmit(&mut self, now: Instant, wall_us: i64) -> Option<&[u8]> {
        if let Some(request) = self.waiting {
            if now < request.until {
                return None;
            }
            self.give_up(now);
        }
        if now < self.due {
            return None;
        }
        let (address, length) = if self.known == Known::TurtleBot { SENSORS } else { IDENTITY };
        let asked = Asked { at: now, wall_us };
        self.waiting = Some(Request { asked, until: now + PATIENCE, length: usize::from(length) });
        self.due = (self.due + self.period).max(now);
        self.counts.requests += 1;
        self.buffer.clear();
        emit_read(ID, address, length, &mut self.buffer);
        Some(&self.buffer)
    }

    /// Takes what was read from the port at `now`.
    pub fn handle_bytes(&mut self, now: Instant, wall_us: i64, bytes: &[u8]) {
        self.parser.push(bytes);
        while let Some(status) = self.parser.poll_status() {
            let Some(request) = self.waiting.take() else {
                self.counts.refused += 1;
                continue;
            };
            self.silent = 0;
            match status.data(request.length).filter(|_| status.id == ID && status.error & ERROR == 0) {
                Some(data) if self.known == Known::TurtleBot => {
                    let Some(table) = Table::of(&data) else { continue };
                    (self.refused, self.device_status) = ((0, 0), table.device_status);
                    self.poses.handle_sensors(&table, request.asked, now, wall_us);
                }
                Some(data) => self.identify(&data, now),
                None => self.refuse(&status),
            }
        }
    }

    /// The next pose, or the news that those from here on are in a frame of their own.
    pub fn poll_found(&mut self) -> Option<NextPose> {
        self.poses.found.pop_front()
    }

    /// The answer did not come in time.
    fn give_up(&mut self, now: Instant) {
        self.waiting = None;
        self.parser.reset();
        self.counts.unanswered += 1;
        self.silent += 1;
        if self.silent >= SILENT {
            self.known = Known::Nothing;
            self.due = now + RETRY;
        }
    }

    fn refuse(&mut self, status: &Status) {
        self.counts.refused += 1;
        self.refused = (self.refused.0.saturating_add(1), status.error & ERROR);
        if status.id != ID {
            self.known = Known::Other(u16::from(status.id));
        }
    }

    fn identify(&mut self, data: &[u8], now: Instant) {
        let &[low, high, info, ..] = data else { return };
        let model = u16::from_le_bytes([low, high]);
        if model != MODEL {
            self.known = Known::Other(model);
            self.due = now + RETRY;
            return;
        }
        (self.known, self.refused) = (Known::TurtleBot, (0, 0));
        self.poses.handle_identity(info == 1);
    }
}

/// An answer that takes longer does not come.
const PATIENCE: Span = Span::from_ms(100);
/// After this many requests without an answer its identity is requested again: it may be another controller.
const SILENT: u32 = 5;
/// Pause between requests to one that does not answer.
const RETRY: Span = Span::from_ms(500);
/// A period in step with the refresh is shortened by this: values are then met at every age within a second, also at
/// their freshest, by which the clocks are compared.
const OUT_OF_STEP: f64 = 0.97;
/// Bit 7 of a status is an alert of the device and no failure.
const ERROR: u8 = 0x7f;

/// What a controller is, as far as it says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Known {
    Nothing,
    /// Something else answers.
    Other(u16),
    TurtleBot,
}

#[derive(Clone, Copy, Debug)]
struct Request {
    asked: Asked,
    until: Instant,
    length: usize,
}

/// The time of a request.
#[derive(Clone, Copy, Debug)]
struct Asked {
    at: Instant,
    /// Host's wall clock, microseconds.
    wall_us: i64,
}

/// Time between requests, never in step with the controller's refresh.
fn period(rate_hz: f64) -> Span {
    let refreshes = 2.0 / (rate_hz * REFRESH.as_s());
    let in_step = refreshes > 0.9 && (refreshes - refreshes.round()).abs() < 1.0 - OUT_OF_STEP;
    Span::from_s(if in_step { OUT_OF_STEP } else { 1.0 } / rate_hz)
}

/// The controller's id on the bus.
const ID: u8 = 200;
/// What it says it is.
const MODEL: u16 = 0x5000;
/// Address and length of model number, model information and firmware version.
const IDENTITY: (u16, u16) = (0, 7);
/// Address and length from the clock to the ticks.
const SENSORS: (u16, u16) = (10, 134);
/// How often the controller refreshes its table (`turtlebot3.cpp`, INTERVAL_MS_TO_UPDATE_CONTROL_ITEM).
const REFRESH: Span = Span::from_ms(20);

/// Places within [`SENSORS`].
const MILLIS: usize = 0;
const MICROS: usize = 4;
const STATUS: usize = 8;
const ORIENTATION: usize = 86;
const LEFT: usize = 126;
const RIGHT: usize = 130;

/// The part of the control table that is read.
#[derive(Clone, Copy, Debug)]
struct Table {
    /// The controller's clock, which wraps.
    millis: u32,
    /// The same clock in microseconds, which wraps earlier.
    micros: u32,
    /// What the controller says of itself; 0 is well.
    device_status: i8,
    reading: Reading,
}

impl Table {
    /// From the bytes of [`SENSORS`].
    fn of(data: &[u8]) -> Option<Self> {
        let word = |at: usize| data.get(at..at + 4)?.try_into().ok().map(u32::from_le_bytes);
        let float = |at: usize| word(at).map(f32::from_bits).map(f64::from);
        let q = Quaternion::new(
            float(ORIENTATION)?,
            float(ORIENTATION + 4)?,
            float(ORIENTATION + 8)?,
            float(ORIENTATION + 12)?,
        );
        let is_rotation = (q.norm() - 1.0).abs() < 0.1;
        Some(Self {
            device_status: data.get(STATUS)?.cast_signed(),
            millis: word(MILLIS)?,
            micros: word(MICROS)?,
            reading: Reading {
                left: word(LEFT)?.cast_signed(),
                right: word(RIGHT)?.cast_signed(),
                heading_rad: is_rotation.then(|| heading_of(&UnitQuaternion::from_quaternion(q))),
            },
        })
    }
}

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
struct Poses {
    geometry: Option<Geometry>,
    drive: Drive,
    fit: ClockFit,
    clock: Option<Clock>,
    found: VecDeque<NextPose>,
    repeated: u64,
    restarts: u64,
}

impl Poses {
    fn new(geometry: Option<Geometry>) -> Self {
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

    /// The controller's model is known, before its first reading.
    fn handle_identity(&mut self, is_burger: bool) {
        if self.geometry.is_none() && self.clock.is_none() {
            self.drive = Drive::new(if is_burger { Geometry::BURGER } else { Geometry::WAFFLE });
        }
    }

    /// A reading that was requested at `asked` and arrived at `now`.
    fn handle_sensors(&mut self, table: &Table, asked: Asked, now: Instant, wall_us: i64) {
        let Some(controller_us) = self.controller_time(table, asked.at, now) else { return };
        // The answer was made up between the two.
        if self.fit.handle(controller_us, (asked.wall_us, wall_us)) {
            // The poses so far have times of another clock.
            self.found.push_back(NextPose::NewFrame);
        }
        let Some(host_us) = self.fit.host_us(controller_us) else { return };
        if self.drive.handle(controller_us as f64 * 1e-6, table.reading) {
            let Drive { position_m, heading_rad, .. } = self.drive;
            let pose = Pose { t_s: host_us * 1e-6, position_m, heading_rad: Some(heading_rad) };
            self.found.push_back(NextPose::Pose(pose));
        } else {
            // How far it went in that step is not known.
            self.found.push_back(NextPose::NewFrame);
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
        // The clock's fit, and the next reading, begin anew.
        self.fit.blocks.clear();
        self.drive.last = None;
        self.found.push_back(NextPose::NewFrame);
    }
}

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

/// A controller's clock brought onto the host's.
///
/// What a controller reports is old by the time it arrives, by an amount that varies but is never negative. So the
/// host's time minus the controller's is bounded from below by the true difference: the smallest differences of each
/// second lie on a line, the two clocks' offset and drift.
#[derive(Clone, Debug, Default)]
struct ClockFit {
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

/// Turns of the wheel in one tick, radians (TurtleBot3: 4,096 ticks a turn).
const TICK_RAD: f64 = std::f64::consts::TAU / 4_096.0;
/// No TurtleBot3 drives faster than this (0.26 m/s) with a wide margin, m/s.
const MAX_SPEED_M_S: f64 = 2.0;
/// A heading that turns by this much more than the wheels in one step was reset, radians.
const HEADING_JUMP_RAD: f64 = 0.5;
/// A heading that stands still to the last bit while the wheels turn the robot by this much is dead, radians.
const DEAD_HEADING_RAD: f64 = 0.2;

/// Wheels and their distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// Radius of the wheels, metres.
    pub wheel_radius_m: f64,
    /// Distance between the wheels, metres.
    pub separation_m: f64,
}

impl Geometry {
    /// TurtleBot3 Burger (e-Manual, "Dimension").
    pub const BURGER: Self = Self { wheel_radius_m: 0.033, separation_m: 0.160 };
    /// TurtleBot3 Waffle and Waffle Pi.
    pub const WAFFLE: Self = Self { wheel_radius_m: 0.033, separation_m: 0.287 };
}

/// What the sensors show.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reading {
    /// Ticks of the left wheel, wrapping.
    pub left: i32,
    /// Ticks of the right wheel, wrapping.
    pub right: i32,
    /// Heading by the IMU, radians, from anywhere; `None` if it gives no rotation.
    pub heading_rad: Option<f64>,
}

/// What was odd.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct WheelCounts {
    /// Steps whose heading is the IMU's.
    pub by_imu: u64,
    /// Steps whose heading is the wheels', the IMU having none, a dead one, or one that jumped.
    pub by_wheels: u64,
    /// Steps that no wheel can make: skipped.
    pub jumps: u64,
}

/// Dead reckoning. The robot begins at the origin, facing +x.
#[derive(Clone, Debug)]
struct Drive {
    geometry: Geometry,
    last: Option<(f64, Reading)>,
    /// Position of the middle between the wheels, metres, and heading, radians.
    position_m: Vector3<f64>,
    heading_rad: f64,
    /// How far the wheels turned the robot since the IMU's heading last changed, radians.
    unseen_rad: f64,
    /// What was odd.
    pub counts: WheelCounts,
}

impl Drive {
    /// A robot at the origin that has not moved yet.
    #[must_use]
    pub fn new(geometry: Geometry) -> Self {
        let position_m = Vector3::zeros();
        Self { geometry, last: None, position_m, heading_rad: 0.0, unseen_rad: 0.0, counts: WheelCounts::default() }
    }

    /// Takes a reading at `t_s`, seconds of which only differences count; false if it was skipped.
    pub fn handle(&mut self, t_s: f64, reading: Reading) -> bool {
        let Some((last_s, last)) = self.last.replace((t_s, reading)) else { return true };
        let arc_m =
            |now: i32, before: i32| f64::from(now.wrapping_sub(before)) * TICK_RAD * self.geometry.wheel_radius_m;
        let (left_m, right_m) = (arc_m(reading.left, last.left), arc_m(reading.right, last.right));
        let limit_m = MAX_SPEED_M_S * (t_s - last_s).max(0.02);
        if left_m.abs().max(right_m.abs()) > limit_m {
            self.counts.jumps += 1;
            return false;
        }
        let turned_rad = self.turned_rad(&last, &reading, (right_m - left_m) / self.geometry.separation_m);
        // The chord of the arc that was driven.
        let half_rad = 0.5 * turned_rad;
        let (sin, cos) = (self.heading_rad + half_rad).sin_cos();
        let chord = if half_rad.abs() > 1e-6 { half_rad.sin() / half_rad } else { 1.0 };
        let step_m = 0.5 * (left_m + right_m) * chord;
        self.position_m += Vector3::new(step_m * cos, step_m * sin, 0.0);
        self.heading_rad = wrap_rad(self.heading_rad + turned_rad);
        true
    }

    /// How far the robot turned: by the IMU where it is plausible, by the wheels elsewhere.
    fn turned_rad(&mut self, last: &Reading, now: &Reading, by_wheels: f64) -> f64 {
        let by_imu = last.heading_rad.zip(now.heading_rad).map(|(from, to)| wrap_rad(to - from));
        self.unseen_rad = if by_imu == Some(0.0) { self.unseen_rad + by_wheels } else { 0.0 };
        match by_imu {
            Some(turned)
                if (turned - by_wheels).abs() < HEADING_JUMP_RAD && self.unseen_rad.abs() < DEAD_HEADING_RAD =>
            {
                self.counts.by_imu += 1;
                turned
            }
            _ => {
                self.counts.by_wheels += 1;
                by_wheels
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::odometry::dynamixel::{self, crc16, emit, instruction};
    use std::f64::consts::{FRAC_PI_2, TAU};

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

    fn ticks(metres: f64) -> i32 {
        (metres / (Geometry::BURGER.wheel_radius_m * TICK_RAD)).round() as i32
    }

    /// Drives a circle to the left in 100 steps; `imu` makes a heading of the true one.
    fn circle(radius_m: f64, geometry: Geometry, imu: impl Fn(f64) -> Option<f64>) -> Drive {
        let mut drive = Drive::new(geometry);
        for k in 0..=1_000 {
            let turned = TAU * f64::from(k) / 1_000.0;
            let half = 0.5 * geometry.separation_m;
            let (left, right) = (ticks(turned * (radius_m - half)), ticks(turned * (radius_m + half)));
            let start = i32::MAX - 500;
            let (left, right) = (start.wrapping_add(left), start.wrapping_add(right));
            assert!(drive.handle(f64::from(k) * 0.02, Reading { left, right, heading_rad: imu(turned) }));
        }
        drive
    }

    #[test]
    fn a_circle_closes_with_the_imu_and_without() {
        for geometry in [Geometry::BURGER, Geometry::WAFFLE] {
            for with_imu in [true, false] {
                let drive = circle(0.3, geometry, |turned| with_imu.then(|| wrap_rad(2.0 + turned)));
                let (at, heading) = (drive.position_m, drive.heading_rad);
                assert!(at.norm() < 2e-3 && heading.abs() < 0.02, "{at} {heading}");
                let counts = drive.counts;
                assert_eq!((counts.by_imu > 0, counts.by_wheels > 0, counts.jumps), (with_imu, !with_imu, 0));
            }
        }
    }

    #[test]
    fn a_quarter_ends_where_geometry_says() {
        let mut drive = Drive::new(Geometry::BURGER);
        for k in 0..=100 {
            let turned = FRAC_PI_2 * f64::from(k) / 100.0;
            let (left, right) = (ticks(turned * 0.22), ticks(turned * 0.38));
            drive.handle(f64::from(k) * 0.05, Reading { left, right, heading_rad: Some(turned) });
        }
        let (at, heading) = (drive.position_m, drive.heading_rad);
        assert!((at - Vector3::new(0.3, 0.3, 0.0)).norm() < 1e-3 && (heading - FRAC_PI_2).abs() < 1e-9, "{at}");
    }

    #[test]
    fn a_dead_or_jumping_heading_leaves_the_turning_to_the_wheels() {
        let dead = circle(0.3, Geometry::BURGER, |_| Some(1.25));
        // Until it is known to be dead it is believed: the circle is out of true by that much.
        assert!((dead.heading_rad + DEAD_HEADING_RAD).abs() < 0.03, "{dead:?}");
        assert!(dead.counts.by_wheels > 900);
        let jump =
            circle(0.3, Geometry::BURGER, |turned| Some(wrap_rad(turned + if turned > 3.0 { 2.0 } else { 0.0 })));
        assert!(jump.position_m.norm() < 2e-3, "{jump:?}");
        assert_eq!(jump.counts.by_wheels, 1);
    }

    #[test]
    fn impossible_steps_are_left_out() {
        let mut drive = Drive::new(Geometry::BURGER);
        let reading = |ticks| Reading { left: ticks, right: ticks, heading_rad: None };
        assert!(drive.handle(0.0, reading(0)));
        assert!(!drive.handle(0.02, reading(1 << 24)));
        assert!(drive.handle(0.04, reading((1 << 24) + 10)));
        assert_eq!(drive.counts.jumps, 1);
        assert!((drive.position_m.x - 10.0 * TICK_RAD * 0.033).abs() < 1e-12);
    }

    /// A TurtleBot3 that drives a circle to the left.
    pub struct Emulated {
        pub model: u16,
        pub radius_m: f64,
        pub turn_s: f64,
        /// Microseconds of its clock at time 0, which wraps.
        pub boot_us: u64,
        pub imu: bool,
        /// Ticks of both wheels at time 0.
        pub ticks_from: i32,
        pub device_status: i8,
        received: Vec<u8>,
    }

    impl Emulated {
        pub fn new() -> Self {
            let boot_us = (u64::from(u32::MAX) - 3_000) * 1_000;
            Self {
                model: MODEL,
                radius_m: 0.3,
                turn_s: 20.0,
                boot_us,
                imu: true,
                ticks_from: -100,
                device_status: 0,
                received: vec![],
            }
        }

        /// Its control table at `t_us`, refreshed every 20 ms.
        fn table(&self, t_us: i64) -> Vec<u8> {
            let t_us = t_us.div_euclid(20_000) * 20_000;
            let mut table = vec![0; 400];
            let mut put = |at: usize, bytes: &[u8]| table[at..at + bytes.len()].copy_from_slice(bytes);
            let clock_us = self.boot_us + t_us as u64;
            let turned = (t_us as f64 * 1e-6 / self.turn_s).min(1.0) * std::f64::consts::TAU;
            let tick_m = 0.033 * std::f64::consts::TAU / 4_096.0;
            let ticks = |radius_m: f64| self.ticks_from.wrapping_add((turned * radius_m / tick_m).round() as i32);
            put(0, &self.model.to_le_bytes());
            put(2, &1u32.to_le_bytes());
            put(6, &[4, ID]);
            put(10, &((clock_us / 1_000) as u32).to_le_bytes());
            put(14, &(clock_us as u32).to_le_bytes());
            put(18, &self.device_status.to_le_bytes());
            if self.imu {
                put(96, &((0.5 * (turned + 1.0)).cos() as f32).to_le_bytes());
                put(108, &((0.5 * (turned + 1.0)).sin() as f32).to_le_bytes());
            }
            put(136, &ticks(self.radius_m - 0.08).to_le_bytes());
            put(140, &ticks(self.radius_m + 0.08).to_le_bytes());
            table
        }

        /// Answers what was asked.
        pub fn answer(&mut self, t_us: i64, request: &[u8]) -> Vec<u8> {
            self.received.extend(request);
            let mut out = Vec::new();
            while self.received.len() >= 14 {
                let asked: Vec<u8> = self.received.drain(..14).collect();
                assert_eq!(crc16(&asked[..12]).to_le_bytes(), asked[12..]);
                assert_eq!(asked[7], instruction::READ, "only reading is allowed");
                let word = |at: usize| usize::from(u16::from_le_bytes([asked[at], asked[at + 1]]));
                let (from, length) = (word(8), word(10));
                let data = &self.table(t_us)[from..from + length];
                emit(ID, instruction::STATUS, &[&[0x80], data].concat(), &mut out);
            }
            out
        }
    }

    const WALL_US: i64 = 1_700_000_000_000_000;

    /// Runs the dialogue from `from_s` to `to_s` in virtual time; `line` may spoil what the controller says.
    fn talk(
        opencr: &mut OpenCr,
        device: &mut Emulated,
        (from_s, to_s): (f64, f64),
        mut line: impl FnMut(f64, Vec<u8>) -> Vec<u8>,
    ) -> Vec<NextPose> {
        let mut now = Instant::from_us((from_s * 1e6) as i64);
        let mut found = Vec::new();
        while now.as_s() < to_s {
            let asked = opencr.poll_transmit(now, WALL_US + now.as_us()).map(<[u8]>::to_vec);
            if let Some(asked) = asked {
                // A tenth of a millisecond there, half a one back.
                let at = now + Span::from_us(100);
                let answer = line(now.as_s(), device.answer(at.as_us(), &asked));
                let at = at + Span::from_us(500);
                opencr.handle_bytes(at, WALL_US + at.as_us(), &answer);
                now = at;
            }
            found.extend(std::iter::from_fn(|| opencr.poll_found()));
            now = opencr.poll_timeout().max(now + Span::from_us(1));
        }
        found
    }

    fn poses(found: &[NextPose]) -> Vec<Pose> {
        found.iter().filter_map(|found| if let NextPose::Pose(pose) = found { Some(*pose) } else { None }).collect()
    }

    /// Where the emulated robot is, in the frame of its start.
    fn truth(t_s: f64) -> Vector3<f64> {
        let turned = (t_s / 20.0).min(1.0) * std::f64::consts::TAU;
        Vector3::new(0.3 * turned.sin(), 0.3 - 0.3 * turned.cos(), 0.0)
    }

    #[test]
    fn a_circle_is_followed_in_place_and_time() {
        for imu in [true, false] {
            let (mut opencr, mut device) = (OpenCr::new(100.0, None, Instant::ZERO), Emulated::new());
            device.imu = imu;
            let poses = poses(&talk(&mut opencr, &mut device, (0.0, 22.0), |_, bytes| bytes));
            assert!(poses.len() > 1_050 && poses.len() <= 1_101, "{} poses of 50 Hz", poses.len());
            for pose in poses.iter().skip(60) {
                let off = (pose.position_m - truth(pose.t_s - WALL_US as f64 * 1e-6)).norm();
                assert!(off < 2e-3, "{off} m at {}", pose.t_s);
            }
            let counts = opencr.counts();
            assert_eq!((counts.unanswered, counts.refused, counts.restarts), (0, 0, 0), "{counts:?}");
            assert!(counts.repeated > 900 && (counts.drive.by_imu > 0) == imu, "{counts:?}");
            assert_eq!(opencr.trouble(), None);
        }
    }

    #[test]
    fn damage_and_silence_cost_what_was_lost_and_no_more() {
        let (mut opencr, mut device) = (OpenCr::new(100.0, None, Instant::ZERO), Emulated::new());
        let mut n = 0;
        let found = talk(&mut opencr, &mut device, (0.0, 22.0), |t_s, mut bytes| {
            n += 1;
            match n % 10 {
                _ if (8.0..10.0).contains(&t_s) => return Vec::new(),
                3 => bytes[20] ^= 1,
                5 => bytes.truncate(40),
                7 => drop(bytes.splice(0..0, [0xFF, 0xFF, 0xFD])),
                _ => {}
            }
            bytes
        });
        assert!(!found.contains(&NextPose::NewFrame));
        let last = poses(&found).last().copied().unwrap();
        assert!((last.position_m - truth(22.0)).norm() < 3e-3, "{last:?}");
        let counts = opencr.counts();
        assert!(counts.packets.bad_crc > 10 && counts.unanswered > 20, "{counts:?}");
    }

    #[test]
    fn a_controller_that_began_anew_opens_a_new_frame() {
        let (mut opencr, mut device) = (OpenCr::new(50.0, None, Instant::ZERO), Emulated::new());
        let before = talk(&mut opencr, &mut device, (0.0, 5.0), |_, bytes| bytes);
        opencr.reopened(Instant::from_us(5_000_000));
        (device.boot_us, device.ticks_from) = (0, 12_345);
        let after = talk(&mut opencr, &mut device, (5.0, 6.0), |_, bytes| bytes);
        assert_eq!(after.first(), Some(&NextPose::NewFrame));
        let (before, after) = (poses(&before), poses(&after));
        assert!((after[0].position_m - before[before.len() - 1].position_m).norm() < 1e-9);
        assert!((after[40].t_s - (WALL_US as f64 * 1e-6 + 5.8)).abs() < 0.1, "{}", after[40].t_s);
        assert_eq!(opencr.counts().restarts, 1);
    }

    #[test]
    fn a_stall_of_this_host_is_no_restart_of_the_controller() {
        let (mut opencr, mut device) = (OpenCr::new(100.0, None, Instant::ZERO), Emulated::new());
        let mut now = Instant::ZERO;
        let mut got = Vec::new();
        while now.as_s() < 20.0 {
            let Some(asked) = opencr.poll_transmit(now, WALL_US + now.as_us()).map(<[u8]>::to_vec) else {
                now = opencr.poll_timeout().max(now + Span::from_us(1));
                continue;
            };
            let answer = device.answer(now.as_us() + 100, &asked);
            // Every fifth second the answer lies there for 1.2 s before it is looked at, the next one for none.
            let stalled = now.as_s() > 3.0 && now.as_us() / 10_000 % 500 < 2;
            now += if stalled { Span::from_ms(1_200) } else { Span::from_us(600) };
            opencr.handle_bytes(now, WALL_US + now.as_us(), &answer);
            got.extend(std::iter::from_fn(|| opencr.poll_found()));
        }
        let counts = opencr.counts();
        assert!(!got.contains(&NextPose::NewFrame) && poses(&got).len() > 700, "{counts:?}");
        assert_eq!((counts.restarts, counts.clock_steps, counts.drive.jumps), (0, 0, 0), "{counts:?}");
        let off = |pose: &Pose| (pose.position_m - truth(pose.t_s - WALL_US as f64 * 1e-6)).norm();
        assert!(poses(&got).iter().skip(60).all(|pose| off(pose) < 2e-3));
    }

    #[test]
    fn a_clock_that_was_set_and_a_jump_of_the_ticks_open_a_new_frame() {
        let (mut opencr, mut device) = (OpenCr::new(100.0, None, Instant::ZERO), Emulated::new());
        assert!(!talk(&mut opencr, &mut device, (0.0, 5.0), |_, bytes| bytes).contains(&NextPose::NewFrame));
        device.ticks_from += 1 << 20;
        let jumped = talk(&mut opencr, &mut device, (5.0, 6.0), |_, bytes| bytes);
        assert_eq!(jumped.iter().filter(|found| **found == NextPose::NewFrame).count(), 1);
        // The host's clock is set back by an hour.
        let (now, back_us) = (Instant::from_us(6_100_000), WALL_US - 3_600_000_000);
        let asked = opencr.poll_transmit(now, back_us + now.as_us()).unwrap().to_vec();
        let answer = device.answer(now.as_us(), &asked);
        opencr.handle_bytes(now, back_us + now.as_us(), &answer);
        assert_eq!(opencr.poll_found(), Some(NextPose::NewFrame));
        let Some(NextPose::Pose(pose)) = opencr.poll_found() else { panic!("a pose on the new clock") };
        assert!((pose.t_s - (back_us as f64 * 1e-6 + 6.1)).abs() < 0.1, "{pose:?}");
    }

    #[test]
    fn the_clocks_are_compared_where_values_are_fresh() {
        for rate_hz in [25.0, 50.0, 100.0] {
            let (mut opencr, mut device) = (OpenCr::new(rate_hz, None, Instant::ZERO), Emulated::new());
            // Always asked 9 ms after a refresh, were it in step.
            let found = talk(&mut opencr, &mut device, (0.009, 12.0), |_, bytes| bytes);
            for pose in poses(&found).iter().filter(|pose| pose.t_s > WALL_US as f64 * 1e-6 + 5.0) {
                let age_ms = ((pose.t_s - WALL_US as f64 * 1e-6) * 1e3 + 1.0).rem_euclid(20.0) - 1.0;
                assert!(age_ms < 2.5, "{rate_hz} Hz: {age_ms} ms after the refresh");
            }
        }
    }

    #[test]
    fn wrong_devices_are_named() {
        let (mut opencr, mut device) = (OpenCr::new(50.0, None, Instant::ZERO), Emulated::new());
        device.model = 0x0406;
        assert!(talk(&mut opencr, &mut device, (0.0, 3.0), |_, bytes| bytes).is_empty());
        assert!(opencr.trouble().unwrap().contains("0x0406"));
        let mut opencr = OpenCr::new(50.0, None, Instant::ZERO);
        talk(&mut opencr, &mut device, (0.0, 3.0), |_, _| Vec::new());
        assert!(opencr.trouble().unwrap().contains("does not answer"));
        let mut opencr = OpenCr::new(50.0, None, Instant::ZERO);
        talk(&mut opencr, &mut device, (0.0, 3.0), |_, _| vec![0xFF, 0xFE, 8, 0, 0xF7]);
        assert!(opencr.trouble().unwrap().contains("rosserial"));
        let (mut opencr, mut device) = (OpenCr::new(50.0, None, Instant::ZERO), Emulated::new());
        device.device_status = -1;
        assert!(!talk(&mut opencr, &mut device, (0.0, 1.0), |_, bytes| bytes).is_empty());
        assert!(opencr.trouble().unwrap().contains("device status -1"));
        device.device_status = 0;
        talk(&mut opencr, &mut device, (1.0, 2.0), |_, bytes| bytes);
        assert_eq!(opencr.trouble(), None);
        let refusal = |_, _| {
            let mut out = Vec::new();
            dynamixel::emit(ID, dynamixel::instruction::STATUS, &[7], &mut out);
            out
        };
        talk(&mut opencr, &mut device, (2.0, 4.0), refusal);
        assert!(opencr.trouble().unwrap().contains("error 7"), "{:?}", opencr.trouble());
    }
}
