//! The control table of the controller: the fields that are read, and their places.

use crate::motion::heading::heading_of;
use crate::time::Span;
use nalgebra::{Quaternion, UnitQuaternion};

/// The controller's id on the bus.
pub(super) const ID: u8 = 200;
/// What it says it is.
pub(super) const MODEL: u16 = 0x5000;
/// Address and length of model number, model information and firmware version.
pub(super) const IDENTITY: (u16, u16) = (0, 7);
/// Address and length from the clock to the ticks.
pub(super) const SENSORS: (u16, u16) = (10, 134);
/// How often the controller refreshes its table (`turtlebot3.cpp`, INTERVAL_MS_TO_UPDATE_CONTROL_ITEM).
pub(super) const REFRESH: Span = Span::from_ms(20);

/// Places within [`SENSORS`].
const MILLIS: usize = 0;
const MICROS: usize = 4;
const STATUS: usize = 8;
const ORIENTATION: usize = 86;
const LEFT: usize = 126;
const RIGHT: usize = 130;

/// What a controller says that it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Identity {
    pub(super) model: u16,
    /// Model information: 1 is a Burger.
    pub(super) is_burger: bool,
}

impl Identity {
    /// From the bytes of [`IDENTITY`].
    pub(super) fn of(data: &[u8]) -> Option<Self> {
        let &[low, high, info, ..] = data else { return None };
        Some(Self { model: u16::from_le_bytes([low, high]), is_burger: info == 1 })
    }
}

/// The part of the control table that is read.
#[derive(Clone, Copy, Debug)]
pub(super) struct Table {
    /// The controller's clock, which wraps.
    pub(super) millis: u32,
    /// The same clock in microseconds, which wraps earlier.
    pub(super) micros: u32,
    /// What the controller says of itself; 0 is well.
    pub(super) device_status: i8,
    /// Ticks of the wheels, which wrap.
    pub(super) left: i32,
    pub(super) right: i32,
    /// The IMU's, if it gives a rotation.
    pub(super) heading_rad: Option<f64>,
}

impl Table {
    /// From the bytes of [`SENSORS`].
    pub(super) fn of(data: &[u8]) -> Option<Self> {
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
