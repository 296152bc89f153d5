//! The oracle: the sum by its definition, in double, with phases exact to the last bit.
//!
//! It is slow. Every other method is tested against it, and a tolerance of 0 selects it.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use num_complex::Complex64;

use super::scene::{Scene, ldexp};
use super::{Error, Grid, Profile, direction};
use crate::signal::samples::Samples;

/// `a * b` as a rounded product and its rounding error \[dekker1971\].
fn two_product(a: f64, b: f64) -> (f64, f64) {
    let p = a * b;
    (p, a.mul_add(b, -p))
}

/// The phase `q . u` in turns, reduced to about one turn around 0 before anything is lost.
fn turns(q: [f64; 3], u: &Vector3<f64>) -> f64 {
    let (mut whole, mut rest) = (0.0, 0.0);
    for (a, b) in q.into_iter().zip([u.x, u.y, u.z]) {
        let (product, error) = two_product(a, b);
        whole += product - product.round();
        rest += error - error.round();
    }
    whole + rest
}

/// A sum with Neumaier's compensation \[neumaier1974\].
#[derive(Clone, Copy, Default)]
struct Compensated {
    sum: f64,
    lost: f64,
}

impl Compensated {
    fn add(&mut self, term: f64) {
        let total = self.sum + term;
        self.lost += if self.sum.abs() >= term.abs() { (self.sum - total) + term } else { (term - total) + self.sum };
        self.sum = total;
    }

    fn value(self) -> f64 {
        self.sum + self.lost
    }
}

/// `f(u) = sum_t z_t exp(-j 2 pi q_t . u)` over the scaled samples of `scene`.
pub(crate) fn sum(scene: &Scene, u: &Vector3<f64>) -> Complex64 {
    let (mut re, mut im) = (Compensated::default(), Compensated::default());
    for t in 0..scene.len() {
        let (sin, cos) = (TAU * turns([scene.x[t], scene.y[t], scene.z[t]], u)).sin_cos();
        re.add(scene.re[t] * cos + scene.im[t] * sin);
        im.add(scene.im[t] * cos - scene.re[t] * sin);
    }
    Complex64::new(re.value(), im.value())
}

/// The profile by the oracle: the sum as written, phases exact to the last bit. Slow; every other path is held to it.
///
/// # Errors
/// As [`super::profile`].
pub fn oracle(samples: &Samples, grid: &Grid) -> Result<Profile, Error> {
    let scene = Scene::new(samples)?;
    grid.check()?;
    let full = scene.sum_abs * scene.sum_abs;
    let value = |(azimuth, elevation)| (sum(&scene, &direction(azimuth, elevation)).norm_sqr() / full).min(1.0);
    let values = (0..grid.len()).map(|i| value(grid.at(i))).collect();
    Ok(Profile { grid: grid.clone(), values, sum_abs: ldexp(scene.sum_abs, -scene.exponent) })
}
