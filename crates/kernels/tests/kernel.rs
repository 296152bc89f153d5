//! The spreading window of the NUFFT.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use csi5300_kernels::nufft::Kernel;
use std::f64::consts::PI;

#[test]
fn the_transform_is_the_integral_of_the_value() {
    for (width, oversampling) in [(4, 1.5), (8, 2.0), (16, 1.5)] {
        let kernel = Kernel::new(width, oversampling);
        for xi in [0.0, 0.1, 0.33] {
            let n = 20_000;
            let h = width as f64 / f64::from(n);
            let sum: f64 = (0..n)
                .map(|i| {
                    let x = (f64::from(i) + 0.5) * h - width as f64 / 2.0;
                    kernel.value(x) * (2.0 * PI * xi * x).cos() * h
                })
                .sum();
            assert!((sum - kernel.transform(xi)).abs() < 1e-7, "{width} {xi}");
        }
    }
}

#[test]
fn polynomials_follow_the_kernel() {
    for (width, degree, tolerance) in [(4, 9, 2e-7), (8, 12, 2e-8), (12, 17, 1e-12), (16, 20, 3e-14)] {
        let kernel = Kernel::new(width, 1.5);
        let powers = kernel.polynomials(degree);
        for step in 0..=10 {
            let s = f64::from(step) / 10.0 - 0.5;
            for j in 0..width {
                let value = powers.iter().fold(0.0, |v, row| v * s + row[j]);
                let exact = kernel.value(s + (width as f64 - 1.0) / 2.0 - j as f64);
                assert!((value - exact).abs() < tolerance, "w {width} s {s} j {j}: {value} {exact}");
            }
        }
    }
}

#[test]
fn losses_fall_with_width_and_oversampling() {
    for (width, oversampling, loss) in [(4, 2.0, 1.1e-3), (8, 1.5, 3.7e-6), (8, 2.0, 1.9e-7), (16, 2.0, 2e-14)] {
        assert!(Kernel::new(width, oversampling).loss() < loss, "{width} {oversampling}");
    }
}
