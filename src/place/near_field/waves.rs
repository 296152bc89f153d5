//! Spherical waves over the rows of an aperture: their phases, how these change with the place, and what a wave leaves.

use super::aperture::Aperture;
use super::types::Free;
use crate::bartlett::direction;
use crate::signal::channel::SUBCARRIERS;
use nalgebra::{Matrix3, Vector3, Vector4};
use num_complex::{Complex32, Complex64};
use std::borrow::Cow;
use std::f64::consts::TAU;

/// Spherical waves over rows of `K` values: azimuth, elevation and 1 / range are their coordinates.
pub(super) struct Waves<'a, const K: usize> {
    rows: Cow<'a, [[Complex32; K]]>,
    /// Where the rows were taken, from the middle, metres.
    points: Vec<Vector3<f64>>,
    /// Radians per metre of way.
    kappa: f64,
    /// Which coordinates are not known.
    pub free: [bool; 3],
}

impl<'a> Waves<'a, SUBCARRIERS> {
    /// Over all subcarriers.
    pub fn of_subcarriers(aperture: &'a Aperture, middle_m: &Vector3<f64>, wavelength_m: f64, free: Free) -> Self {
        Self::new(Cow::Borrowed(&aperture.rows), aperture, middle_m, wavelength_m, free)
    }
}

impl Waves<'_, 1> {
    /// At the channel centre.
    pub fn at_centre(aperture: &Aperture, middle_m: &Vector3<f64>, wavelength_m: f64, free: Free) -> Self {
        let rows: Vec<[Complex32; 1]> = aperture.centre.iter().map(|z| [*z]).collect();
        Self::new(Cow::Owned(rows), aperture, middle_m, wavelength_m, free)
    }
}

/// A wave front at one place, ready for many rows: its direction, and the direction's changes with azimuth and elevation.
struct Front {
    towards: Vector3<f64>,
    by_azimuth: Vector3<f64>,
    by_elevation: Vector3<f64>,
    curve: f64,
}

impl Front {
    fn new([azimuth, elevation, curve]: [f64; 3]) -> Self {
        let ((sin_a, cos_a), (sin_e, cos_e)) = (azimuth.sin_cos(), elevation.sin_cos());
        Self {
            towards: direction(azimuth, elevation),
            by_azimuth: Vector3::new(-sin_a * cos_e, cos_a * cos_e, 0.0),
            by_elevation: Vector3::new(-cos_a * sin_e, -sin_a * sin_e, cos_e),
            curve,
        }
    }

    /// `length^2 / range^2 = 1 + curve * bend`, for a row at `p` from the middle: bend and length / range.
    fn bend(&self, p: &Vector3<f64>) -> (f64, f64) {
        let bend = self.curve * p.norm_squared() - 2.0 * self.towards.dot(p);
        (bend, (1.0 + self.curve * bend).max(0.0).sqrt())
    }

    /// `length - range`, metres, without cancellation.
    fn excess_m(&self, p: &Vector3<f64>) -> f64 {
        let (bend, ratio) = self.bend(p);
        bend / (ratio + 1.0)
    }

    /// How the excess changes with azimuth, elevation, 1 / range, and a scale of the trajectory.
    fn gradient(&self, p: &Vector3<f64>) -> Vector4<f64> {
        let (bend, ratio) = self.bend(p);
        // The excess is (ratio - 1) / curve, so it changes by half of the bend's change over the ratio.
        let ratio = ratio.max(1e-9);
        let square = p.norm_squared();
        let by_curve = (square - bend * (bend + self.curve * square) / (2.0 * ratio * (ratio + 1.0))) / (ratio + 1.0);
        Vector4::new(
            -self.by_azimuth.dot(p) / ratio,
            -self.by_elevation.dot(p) / ratio,
            by_curve,
            (self.curve * square - self.towards.dot(p)) / ratio,
        )
    }
}

impl<'a, const K: usize> Waves<'a, K> {
    fn new(
        rows: Cow<'a, [[Complex32; K]]>,
        aperture: &Aperture,
        middle_m: &Vector3<f64>,
        wavelength_m: f64,
        free: Free,
    ) -> Self {
        let kappa = TAU * f64::from(aperture.path_gain) / wavelength_m;
        let points = aperture.displacement_m.iter().map(|p| p - middle_m).collect();
        Self { rows, points, kappa, free: free.each() }
    }

    /// The steering of each row towards a place: what undoes its path.
    pub fn steering(&self, c: [f64; 3]) -> impl Iterator<Item = Complex64> + '_ {
        let front = Front::new(c);
        self.points.iter().map(move |p| Complex64::cis(self.kappa * front.excess_m(p)))
    }

    /// Each row's phase by azimuth, elevation, 1 / range (0 where they are known) and by the trajectory's scale.
    pub fn gradients(&self, c: [f64; 3]) -> Vec<Vector4<f64>> {
        let front = Front::new(c);
        let known = |gradient: Vector4<f64>| {
            Vector4::from_fn(|i, _| if self.free.get(i) == Some(&false) { 0.0 } else { gradient[i] })
        };
        self.points.iter().map(|p| known(front.gradient(p) * self.kappa)).collect()
    }

    /// What the place leaves of each row's phase: rows are turned back, matched over their values with their mean, and
    /// the quadrature part against the mean is taken (the part that a wrong place would explain).
    pub fn residual(&self, c: [f64; 3]) -> Vec<f64> {
        let wide = |v: &Complex32| Complex64::new(f64::from(v.re), f64::from(v.im));
        let turn = |(row, back): (&[Complex32; K], Complex64)| -> [Complex64; K] {
            std::array::from_fn(|k| wide(&row[k]) * back)
        };
        let turned: Vec<[Complex64; K]> = self.rows.iter().zip(self.steering(c)).map(turn).collect();
        let mut mean = [Complex64::default(); K];
        for row in &turned {
            mean.iter_mut().zip(row).for_each(|(m, v)| *m += v);
        }
        let matched: Vec<Complex64> =
            turned.iter().map(|row| row.iter().zip(&mean).map(|(v, m)| v * m.conj()).sum()).collect();
        let level = matched.iter().map(|m| m.re).sum::<f64>() / matched.len().max(1) as f64;
        matched.iter().map(|m| if level > 0.0 { m.im / level } else { 0.0 }).collect()
    }

    /// The step to where the residual phases are least, to first order (Gauss and Newton).
    pub fn step(&self, c: [f64; 3]) -> Option<Vector3<f64>> {
        let gradients = self.gradients(c);
        let mean = gradients.iter().sum::<Vector4<f64>>() / gradients.len() as f64;
        let (mut scatter, mut towards) = (Matrix3::zeros(), Vector3::zeros());
        for (gradient, e) in gradients.iter().zip(self.residual(c)) {
            let gradient = (gradient - mean).xyz();
            scatter += gradient * gradient.transpose();
            towards -= gradient * e;
        }
        for i in (0..3).filter(|i| !self.free[*i]) {
            scatter[(i, i)] = 1.0;
        }
        Some(scatter.try_inverse()? * towards)
    }

    /// Where the rows were taken, from the middle, metres.
    pub fn points(&self) -> &[Vector3<f64>] {
        &self.points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_are_the_differences_of_phases() {
        let points = [Vector3::new(0.4, -0.2, 0.1), Vector3::new(-0.3, 0.5, -0.2), Vector3::new(0.0, 0.01, 0.0)];
        for c in [[0.7, 0.2, 0.5], [-2.0, -0.9, 0.0], [3.0, 0.0, 1.4]] {
            for p in points {
                let found = Front::new(c).gradient(&p);
                let step = 1e-6;
                let excess = |c: [f64; 3], scale: f64| Front::new(c).excess_m(&(p * scale));
                for i in 0..4 {
                    let at = |by: f64| match i {
                        3 => excess(c, 1.0 + by),
                        _ => excess(std::array::from_fn(|k| c[k] + if k == i { by } else { 0.0 }), 1.0),
                    };
                    let expected = (at(step) - at(-step)) / (2.0 * step);
                    assert!((found[i] - expected).abs() < 1e-8, "{c:?} {p} {i}: {} {expected}", found[i]);
                }
            }
        }
    }
}
