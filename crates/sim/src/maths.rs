//! Arithmetic that gives the same bits on every machine.
//!
//! IEEE 754 fixes `+ - * /`, `sqrt` and rounding, but not the transcendental functions: the system's libm differs
//! between machines (glibc even picks another one at run time when the CPU has FMA). A record is 8-bit integers rounded
//! from phases of up to 1e8 turns, so a last-bit difference would show after a few hundred records. So everything that
//! affects bytes uses the `libm` crate, which is plain arithmetic.

use nalgebra::Vector3;
use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// Degrees to radians.
pub fn rad(degrees: f64) -> f64 {
    degrees * (PI / 180.0)
}

/// `exp(j 2 pi turns)`. Whole turns are removed first, exactly, so large phases lose nothing here.
pub fn phasor(turns: f64) -> Complex64 {
    let (sin, cos) = libm::sincos(TAU * (turns - turns.round_ties_even()));
    Complex64::new(cos, sin)
}

/// The amplitude ratio of `db` decibels: `10^(db / 20)`.
pub fn amplitude(db: f64) -> f64 {
    libm::exp(db * (std::f64::consts::LN_10 / 20.0))
}

/// The power ratio of `db` decibels: `10^(db / 10)`.
pub fn power(db: f64) -> f64 {
    libm::exp(db * (std::f64::consts::LN_10 / 10.0))
}

/// Decibels of a power ratio; `-inf` for 0.
pub fn decibel(power: f64) -> f64 {
    10.0 * libm::log10(power)
}

/// The unit vector in the horizontal plane at `yaw_rad` from +x towards +y.
pub fn heading(yaw_rad: f64) -> Vector3<f64> {
    let (sin, cos) = libm::sincos(yaw_rad);
    Vector3::new(cos, sin, 0.0)
}

/// `v` turned by `yaw_rad` about +z.
pub fn turned(v: Vector3<f64>, yaw_rad: f64) -> Vector3<f64> {
    if v.x == 0.0 && v.y == 0.0 {
        return v;
    }
    let (sin, cos) = libm::sincos(yaw_rad);
    Vector3::new(cos * v.x - sin * v.y, sin * v.x + cos * v.y, v.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phasors_are_on_the_circle_at_any_number_of_turns() {
        for turns in [0.0, 0.25, -0.25, 1e8 + 0.125, -7.5, 123_456.75] {
            let z = phasor(turns);
            let want = Complex64::from_polar(1.0, TAU * (turns - turns.floor()));
            assert!((z - want).norm() < 1e-12, "{turns}: {z} is not {want}");
        }
    }

    #[test]
    fn decibels_and_ratios_are_inverse() {
        for db in [-92.0, -3.0, 0.0, 20.0] {
            assert!((decibel(power(db)) - db).abs() < 1e-12);
            assert!((amplitude(db) * amplitude(db) / power(db) - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn turning_goes_from_x_towards_y() {
        let v = turned(Vector3::new(1.0, 0.0, 2.0), PI / 2.0);
        assert!((v - Vector3::new(0.0, 1.0, 2.0)).norm() < 1e-15);
        assert!((heading(PI) - Vector3::new(-1.0, 0.0, 0.0)).norm() < 1e-15);
    }
}
