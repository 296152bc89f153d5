//! A Bartlett profile of two paths, at 30 and 100 degrees. Draws it in the terminal: the squared channel shows a false peak
//! between them.
//!
//! `cargo run --example two_paths`

use csi5300::bartlett::{Grid, profile};
use csi5300::signal::samples::Samples;
use nalgebra::Vector3;
use num_complex::Complex64;
use std::f64::consts::TAU;

fn main() -> Result<(), csi5300::bartlett::Error> {
    let wavelength_m = 0.0541;
    let one_way = |p: &Vector3<f64>| {
        let path = |azimuth_deg: f64, strength: f64| {
            let azimuth = azimuth_deg.to_radians();
            strength * Complex64::cis(TAU * (p.x * azimuth.cos() + p.y * azimuth.sin()) / wavelength_m)
        };
        path(30.0, 1.0) + path(100.0, 0.6)
    };
    let mut samples = Samples::new(wavelength_m, 2)?;
    for k in 0..800 {
        let (sin, cos) = (TAU * f64::from(k) / 800.0).sin_cos();
        let p = Vector3::new(0.2 * cos, 0.2 * sin, 0.0);
        // Forward times backward: the channel, squared.
        let channel = one_way(&p);
        samples.push(f64::from(k) * 0.01, channel * channel, p, Vector3::zeros())?;
    }
    let profile = profile(&samples, &Grid::azimuth(72))?;
    for (index, value) in profile.values.iter().enumerate() {
        let azimuth_deg = profile.grid.at(index).0.to_degrees();
        if (-20.0..=160.0).contains(&azimuth_deg) {
            println!("{azimuth_deg:6.1} {}", "#".repeat((value * 120.0) as usize));
        }
    }
    Ok(())
}
