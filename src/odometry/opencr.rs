//! The controller of a TurtleBot3 (OpenCR with the ROS 2 firmware), sans-IO: what to ask it, and poses from its answers.
//!
//! It is asked for one stretch of its control table that holds its clock, the IMU's orientation and the wheels' ticks,
//! so that the three belong together. Nothing is ever written to it. The table: `turtlebot3_node`'s `control_table.hpp`
//! and the firmware's `turtlebot3.cpp`; its values are refreshed every 20 ms, so asking more often gives some twice,
//! which are left out and counted.

use super::clock::ClockFit;
use super::drive::{self, Drive, Geometry, Reading};
use super::dynamixel::{self, Parser, Status, emit_read};
use crate::pose::{Pose, heading_of};
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
    /// When it was read, on the driver's clock.
    at: Instant,
}

impl OpenCr {
    /// A dialogue that asks `rate_hz` times a second, from `now` on. Without a `geometry` the controller says which model
    /// it is.
    #[must_use]
    pub fn new(rate_hz: f64, geometry: Option<Geometry>, now: Instant) -> Self {
        Self {
            period: Span::from_s(1.0 / rate_hz),
            geometry,
            known: Known::Nothing,
            parser: Parser::default(),
            waiting: None,
            due: now,
            silent: 0,
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
        self.waiting = Some(Request { until: now + PATIENCE, wall_us, length: usize::from(length) });
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
            // Bit 7 is an alert of the device and no failure.
            match status.data(request.length).filter(|_| status.id == ID && status.error & 0x7f == 0) {
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
    }

    fn sensors(&mut self, data: &[u8], request: &Request, now: Instant, wall_us: i64) {
        let Some(table) = Table::of(data) else { return };
        let Some(controller_us) = self.controller_time(&table, now) else { return };
        // The middle of the exchange: the answer was made up between the two.
        self.clock.handle(controller_us, request.wall_us + (wall_us - request.wall_us) / 2);
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
        }
    }

    /// The controller's clock, unwrapped microseconds; `None` if nothing was refreshed.
    fn controller_time(&mut self, table: &Table, now: Instant) -> Option<i64> {
        let mut controller = match self.controller {
            Some(controller) => controller,
            None => {
                let last = (i64::from(table.millis), table.micros);
                Controller { millis: Unwrap32::default(), last, us: 0, at: now }
            }
        };
        let first = self.controller.is_none();
        let millis = controller.millis.next(table.millis);
        let step_us = (millis - controller.last.0) * 1_000;
        let elapsed_us = (now - controller.at).as_us();
        if !first && (step_us < 0 || (step_us - elapsed_us).abs() > RESTART_US) {
            self.counts.restarts += 1;
            self.controller = None;
            self.clock.restart();
            self.drive.restart();
            self.found.push_back(Found::NewFrame);
            return self.controller_time(table, now);
        }
        // Microseconds where the firmware keeps them along with the milliseconds.
        let fine_us = i64::from(table.micros.wrapping_sub(controller.last.1));
        controller.us += if (fine_us - step_us).abs() <= 2_000 { fine_us } else { step_us };
        let repeated = !first && step_us == 0 && controller.us == self.controller.map_or(0, |c| c.us);
        (controller.last, controller.at) = ((millis, table.micros), now);
        self.controller = Some(controller);
        self.counts.repeated += u64::from(repeated);
        (!repeated).then_some(controller.us)
    }
}

/// The part of the control table that is read.
#[derive(Clone, Copy, Debug)]
struct Table {
    millis: u32,
    micros: u32,
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
        data.get(STATUS)?;
        Some(Self {
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
    use crate::odometry::dynamixel::{crc16, emit, instruction};

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
        received: Vec<u8>,
    }

    impl Emulated {
        pub fn new() -> Self {
            let boot_us = (u64::from(u32::MAX) - 3_000) * 1_000;
            Self { model: MODEL, radius_m: 0.3, turn_s: 20.0, boot_us, imu: true, ticks_from: -100, received: vec![] }
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
    }
}
