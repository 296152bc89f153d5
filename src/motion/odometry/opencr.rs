//! The controller of a TurtleBot3 (OpenCR with the ROS 2 firmware), sans-IO: what to ask it, and poses from its answers.
//!
//! It is asked for one stretch of its control table that holds its clock, the IMU's orientation and the wheels' ticks,
//! so that the three belong together. Nothing is ever written to it. The table: `turtlebot3_node`'s `control_table.hpp`
//! and the firmware's `turtlebot3.cpp`; its values are refreshed every 20 ms, so asking more often gives some twice,
//! which are left out and counted.

use super::clock::ClockFit;
use super::drive::{self, Drive, Geometry, Reading};
use super::dynamixel::{self, Parser, Status, emit_read};
use crate::motion::pose::{Pose, heading_of};
use crate::time::{Instant, Span, Unwrap32};
use nalgebra::{Quaternion, UnitQuaternion};
use std::collections::VecDeque;

/// The controller's id on the bus.
const ID: u8 = 200;
/// What it says it is.
const MODEL: u16 = 0x5000;
/// Address and length of model number, model information and firmware version.
const IDENTITY: (u16, u16) = (0, 7);
/// Address and length from the clock to the ticks.
const SENSORS: (u16, u16) = (10, 134);
/// Places within [`SENSORS`].
const MILLIS: usize = 0;
const MICROS: usize = 4;
const STATUS: usize = 8;
const ORIENTATION: usize = 86;
const LEFT: usize = 126;
const RIGHT: usize = 130;
/// An answer that takes longer does not come.
const PATIENCE: Span = Span::from_ms(100);
/// After so many requests without an answer it is asked again who it is: it may be another one by now.
const SILENT: u32 = 5;
/// Pause between requests to one that does not answer.
const RETRY: Span = Span::from_ms(500);
/// A controller's clock that goes on by so much more or less than the host's began anew, microseconds.
const RESTART_US: i64 = 500_000;
/// How often the controller refreshes its table (`turtlebot3.cpp`, INTERVAL_MS_TO_UPDATE_CONTROL_ITEM).
const REFRESH: Span = Span::from_ms(20);
/// A period in step with the refresh is shortened by this: values are then met at every age within a second, also at
/// their freshest, by which the clocks are compared.
const OUT_OF_STEP: f64 = 0.97;
/// Bit 7 of a status is an alert of the device and no failure.
const ERROR: u8 = 0x7f;

/// What was counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Counts {
    /// Requests sent.
    pub requests: u64,
    /// Requests that were not answered in time.
    pub unanswered: u64,
    /// Answers with an error, of another device, or of a length not asked for.
    pub refused: u64,
    /// Answers whose values had not been refreshed since the last.
    pub repeated: u64,
    /// Times that the controller began anew: what was driven meanwhile is not known.
    pub restarts: u64,
    /// Times that one of the two clocks was set.
    pub clock_steps: u64,
    /// The line.
    pub packets: dynamixel::Counts,
    /// The wheels.
    pub drive: drive::Counts,
}

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
    sent: Instant,
    until: Instant,
    /// Host's wall clock at sending, microseconds.
    wall_us: i64,
    length: usize,
}

/// One thing that comes of the answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Found {
    /// A pose: seconds since the Unix epoch on the host's clock; the frame begins where the robot stood first.
    Pose(Pose),
    /// The poses from here on are in a frame of their own.
    NewFrame,
}

/// The dialogue with one controller. Call [`poll_transmit`](Self::poll_transmit) and write what it gives;
/// [`handle_bytes`](Self::handle_bytes) with whatever was read; [`poll_found`](Self::poll_found) until `None`; wait until
/// [`poll_timeout`](Self::poll_timeout) or until there are bytes.
#[derive(Debug)]
pub struct OpenCr {
    period: Span,
    geometry: Option<Geometry>,
    known: Known,
    parser: Parser,
    waiting: Option<Request>,
    due: Instant,
    silent: u32,
    /// Answers refused in a row, and the error of the last.
    refused: (u32, u8),
    /// What the controller says of itself; 0 is well.
    device_status: i8,
    buffer: Vec<u8>,
    drive: Drive,
    clock: ClockFit,
    controller: Option<Controller>,
    found: VecDeque<Found>,
    counts: Counts,
}

/// The controller's clock.
#[derive(Clone, Copy, Debug)]
struct Controller {
    millis: Unwrap32,
    last: (i64, u32),
    us: i64,
    /// When it was asked and when it had answered, on the driver's clock: it was read in between.
    asked: Instant,
    at: Instant,
}

impl OpenCr {
    /// A dialogue that asks `rate_hz` times a second, from `now` on. Without a `geometry` the controller says which model
    /// it is.
    #[must_use]
    pub fn new(rate_hz: f64, geometry: Option<Geometry>, now: Instant) -> Self {
        Self {
            period: period(rate_hz),
            geometry,
            known: Known::Nothing,
            parser: Parser::default(),
            waiting: None,
            due: now,
            silent: 0,
            refused: (0, 0),
            device_status: 0,
            buffer: Vec::new(),
            drive: Drive::new(geometry.unwrap_or(Geometry::BURGER)),
            clock: ClockFit::default(),
            controller: None,
            found: VecDeque::new(),
            counts: Counts::default(),
        }
    }

    /// What was counted.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let (packets, drive, clock_steps) = (self.parser.counts, self.drive.counts, self.clock.steps);
        Counts { packets, drive, clock_steps, ..self.counts }
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

    /// The port was opened anew: nothing that was asked before will be answered.
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
            self.waiting = None;
            self.parser.reset();
            self.counts.unanswered += 1;
            self.silent += 1;
            if self.silent >= SILENT {
                self.known = Known::Nothing;
                self.due = now + RETRY;
            }
        }
        if now < self.due {
            return None;
        }
        let (address, length) = if self.known == Known::TurtleBot { SENSORS } else { IDENTITY };
        self.waiting = Some(Request { sent: now, until: now + PATIENCE, wall_us, length: usize::from(length) });
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
                Some(data) if self.known == Known::TurtleBot => self.sensors(&data, &request, now, wall_us),
                Some(data) => self.identity(&data, now),
                None => self.refuse(&status),
            }
        }
    }

    /// The next pose, or what else is to be known.
    pub fn poll_found(&mut self) -> Option<Found> {
        self.found.pop_front()
    }

    fn refuse(&mut self, status: &Status) {
        self.counts.refused += 1;
        self.refused = (self.refused.0.saturating_add(1), status.error & ERROR);
        if status.id != ID {
            self.known = Known::Other(u16::from(status.id));
        }
    }

    fn identity(&mut self, data: &[u8], now: Instant) {
        let &[low, high, info, ..] = data else { return };
        let model = u16::from_le_bytes([low, high]);
        if model != MODEL {
            self.known = Known::Other(model);
            self.due = now + RETRY;
            return;
        }
        if self.geometry.is_none() && self.controller.is_none() {
            self.drive = Drive::new(if info == 1 { Geometry::BURGER } else { Geometry::WAFFLE });
        }
        self.known = Known::TurtleBot;
        self.refused = (0, 0);
    }

    fn sensors(&mut self, data: &[u8], request: &Request, now: Instant, wall_us: i64) {
        let Some(table) = Table::of(data) else { return };
        (self.refused, self.device_status) = ((0, 0), table.device_status);
        let Some(controller_us) = self.controller_time(&table, request.sent, now) else { return };
        // The answer was made up between the two.
        if self.clock.handle(controller_us, (request.wall_us, wall_us)) {
            // The poses so far have times of another clock.
            self.found.push_back(Found::NewFrame);
        }
        let Some(host_us) = self.clock.host_us(controller_us) else { return };
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
        let mut controller = match self.controller {
            Some(controller) => controller,
            None => {
                let last = (i64::from(table.millis), table.micros);
                Controller { millis: Unwrap32::default(), last, us: 0, asked, at: now }
            }
        };
        let first = self.controller.is_none();
        let millis = controller.millis.next(table.millis);
        let step_us = (millis - controller.last.0) * 1_000;
        // Each reading was made between asking and having the answer, however late that was looked at.
        let (least_us, most_us) = ((asked - controller.at).as_us(), (now - controller.asked).as_us());
        if !first && (step_us < 0 || step_us < least_us - RESTART_US || step_us > most_us + RESTART_US) {
            self.counts.restarts += 1;
            self.controller = None;
            self.clock.restart();
            self.drive.restart();
            self.found.push_back(Found::NewFrame);
            return self.controller_time(table, asked, now);
        }
        // Microseconds where the firmware keeps them along with the milliseconds.
        let fine_us = i64::from(table.micros.wrapping_sub(controller.last.1));
        controller.us += if (fine_us - step_us).abs() <= 2_000 { fine_us } else { step_us };
        let repeated = !first && step_us == 0 && controller.us == self.controller.map_or(0, |c| c.us);
        controller.last = (millis, table.micros);
        (controller.asked, controller.at) = (asked, now);
        self.controller = Some(controller);
        self.counts.repeated += u64::from(repeated);
        (!repeated).then_some(controller.us)
    }
}

/// Time between requests, never in step with the controller's refresh.
fn period(rate_hz: f64) -> Span {
    let refreshes = 2.0 / (rate_hz * REFRESH.as_s());
    let in_step = refreshes > 0.9 && (refreshes - refreshes.round()).abs() < 1.0 - OUT_OF_STEP;
    Span::from_s(if in_step { OUT_OF_STEP } else { 1.0 } / rate_hz)
}

/// The part of the control table that is read.
#[derive(Clone, Copy, Debug)]
struct Table {
    millis: u32,
    micros: u32,
    device_status: i8,
    left: i32,
    right: i32,
    heading_rad: Option<f64>,
}

impl Table {
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
            left: word(LEFT)?.cast_signed(),
            right: word(RIGHT)?.cast_signed(),
            heading_rad: is_rotation.then(|| heading_of(&UnitQuaternion::from_quaternion(q))),
        })
    }
}

/// A controller that does what the firmware does, for tests.
#[cfg(test)]
pub(super) mod emulated {
    use super::*;
    use crate::motion::odometry::dynamixel::{crc16, emit, instruction};

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
}

#[cfg(test)]
mod tests {
    use super::emulated::Emulated;
    use super::*;
    use nalgebra::Vector3;

    const WALL_US: i64 = 1_700_000_000_000_000;

    /// Runs the dialogue from `from_s` to `to_s` in virtual time; `line` may spoil what the controller says.
    fn talk(
        opencr: &mut OpenCr,
        device: &mut Emulated,
        (from_s, to_s): (f64, f64),
        mut line: impl FnMut(f64, Vec<u8>) -> Vec<u8>,
    ) -> Vec<Found> {
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

    fn poses(found: &[Found]) -> Vec<Pose> {
        found.iter().filter_map(|found| if let Found::Pose(pose) = found { Some(*pose) } else { None }).collect()
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
        assert!(!found.contains(&Found::NewFrame));
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
        assert_eq!(after.first(), Some(&Found::NewFrame));
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
        assert!(!got.contains(&Found::NewFrame) && poses(&got).len() > 700, "{counts:?}");
        assert_eq!((counts.restarts, counts.clock_steps, counts.drive.jumps), (0, 0, 0), "{counts:?}");
        let off = |pose: &Pose| (pose.position_m - truth(pose.t_s - WALL_US as f64 * 1e-6)).norm();
        assert!(poses(&got).iter().skip(60).all(|pose| off(pose) < 2e-3));
    }

    #[test]
    fn a_clock_that_was_set_and_a_jump_of_the_ticks_open_a_new_frame() {
        let (mut opencr, mut device) = (OpenCr::new(100.0, None, Instant::ZERO), Emulated::new());
        assert!(!talk(&mut opencr, &mut device, (0.0, 5.0), |_, bytes| bytes).contains(&Found::NewFrame));
        device.ticks_from += 1 << 20;
        let jumped = talk(&mut opencr, &mut device, (5.0, 6.0), |_, bytes| bytes);
        assert_eq!(jumped.iter().filter(|found| **found == Found::NewFrame).count(), 1);
        // The host's clock is set back by an hour.
        let (now, back_us) = (Instant::from_us(6_100_000), WALL_US - 3_600_000_000);
        let asked = opencr.poll_transmit(now, back_us + now.as_us()).unwrap().to_vec();
        let answer = device.answer(now.as_us(), &asked);
        opencr.handle_bytes(now, back_us + now.as_us(), &answer);
        assert_eq!(opencr.poll_found(), Some(Found::NewFrame));
        let Some(Found::Pose(pose)) = opencr.poll_found() else { panic!("a pose on the new clock") };
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
