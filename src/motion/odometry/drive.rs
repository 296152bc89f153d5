//! A differential drive: wheel ticks and a gyroscope's heading into a pose.

use crate::maths::wrap_rad;
use nalgebra::Vector3;

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

/// One reading of the sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Time, seconds; only differences count.
    pub t_s: f64,
    /// Ticks of the left wheel, wrapping.
    pub left: i32,
    /// Ticks of the right wheel, wrapping.
    pub right: i32,
    /// Heading by the IMU, radians, from anywhere; `None` if it has none.
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
pub struct Drive {
    geometry: Geometry,
    last: Option<Reading>,
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

    /// Position of the middle between the wheels, metres, and heading, radians.
    #[must_use]
    pub fn place(&self) -> (Vector3<f64>, f64) {
        (self.position_m, self.heading_rad)
    }

    /// The next reading counts from itself: the controller restarted, and what was driven meanwhile is not known.
    pub fn restart(&mut self) {
        self.last = None;
    }

    /// Takes a reading; false if it was skipped.
    pub fn handle(&mut self, reading: Reading) -> bool {
        let Some(last) = self.last.replace(reading) else { return true };
        let arc_m =
            |now: i32, before: i32| f64::from(now.wrapping_sub(before)) * TICK_RAD * self.geometry.wheel_radius_m;
        let (left_m, right_m) = (arc_m(reading.left, last.left), arc_m(reading.right, last.right));
        let limit_m = MAX_SPEED_M_S * (reading.t_s - last.t_s).max(0.02);
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
    use std::f64::consts::{FRAC_PI_2, TAU};

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
            assert!(drive.handle(Reading {
                t_s: f64::from(k) * 0.02,
                left: start.wrapping_add(left),
                right: start.wrapping_add(right),
                heading_rad: imu(turned),
            }));
        }
        drive
    }

    #[test]
    fn a_circle_closes_with_the_imu_and_without() {
        for geometry in [Geometry::BURGER, Geometry::WAFFLE] {
            for with_imu in [true, false] {
                let drive = circle(0.3, geometry, |turned| with_imu.then(|| wrap_rad(2.0 + turned)));
                let (at, heading) = drive.place();
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
            drive.handle(Reading { t_s: f64::from(k) * 0.05, left, right, heading_rad: Some(turned) });
        }
        let (at, heading) = drive.place();
        assert!((at - Vector3::new(0.3, 0.3, 0.0)).norm() < 1e-3 && (heading - FRAC_PI_2).abs() < 1e-9, "{at}");
    }

    #[test]
    fn a_dead_or_jumping_heading_leaves_the_turning_to_the_wheels() {
        let dead = circle(0.3, Geometry::BURGER, |_| Some(1.25));
        // Until it is known to be dead it is believed: the circle is out of true by that much.
        assert!((dead.place().1 + DEAD_HEADING_RAD).abs() < 0.03, "{:?}", dead.place());
        assert!(dead.counts.by_wheels > 900);
        let jump =
            circle(0.3, Geometry::BURGER, |turned| Some(wrap_rad(turned + if turned > 3.0 { 2.0 } else { 0.0 })));
        assert!(jump.place().0.norm() < 2e-3, "{:?}", jump.place());
        assert_eq!(jump.counts.by_wheels, 1);
    }

    #[test]
    fn impossible_steps_are_left_out() {
        let mut drive = Drive::new(Geometry::BURGER);
        let reading = |t_s, ticks| Reading { t_s, left: ticks, right: ticks, heading_rad: None };
        assert!(drive.handle(reading(0.0, 0)));
        assert!(!drive.handle(reading(0.02, 1 << 24)));
        assert!(drive.handle(reading(0.04, (1 << 24) + 10)));
        assert_eq!(drive.counts.jumps, 1);
        assert!((drive.place().0.x - 10.0 * TICK_RAD * 0.033).abs() < 1e-12);
    }
}
