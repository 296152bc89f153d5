//! Angles in radians: brought into one turn, and followed over many.

use std::f64::consts::{PI, TAU};

/// An angle brought into (-pi, pi].
#[must_use]
pub fn wrap_rad(angle_rad: f64) -> f64 {
    let wrapped = angle_rad - TAU * (angle_rad / TAU).round();
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}

/// Unwraps phases: each within pi of the one before it; the first stays as it is.
#[must_use]
pub fn unwrap_rad(phases: &[f64]) -> Vec<f64> {
    let mut last = phases.first().copied().unwrap_or(0.0);
    phases
        .iter()
        .map(|&phase| {
            let step = phase - last;
            last += step - TAU * ((step + PI) / TAU).floor();
            last
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unwrapping_follows_the_phase() {
        let course: Vec<f64> = (0..200).map(|k| 0.3 * f64::from(k)).collect();
        let wrapped: Vec<f64> = course.iter().map(|&p| wrap_rad(p)).collect();
        assert!(unwrap_rad(&wrapped).iter().zip(&course).all(|(a, b)| (a - b).abs() < 1e-9));
    }

    #[test]
    fn half_a_turn_is_positive() {
        assert_eq!((wrap_rad(PI), wrap_rad(-PI), wrap_rad(3.0 * PI)), (PI, PI, PI));
        assert_eq!((wrap_rad(0.0), wrap_rad(-1.0)), (0.0, -1.0));
    }
}
