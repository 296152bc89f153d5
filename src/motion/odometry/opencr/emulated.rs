//! A controller that does what the firmware does.

use super::table::{ID, MODEL};
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
