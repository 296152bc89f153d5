//! The search against a dense search, the kernels against the oracle, the predicted against the observed deviation.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;
use num_complex::Complex64;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::direct::oracle;
use super::scene::Scene;
use super::*;
use crate::maths::wrap_rad;
use csi5300_kernels::simd::{ROUGH, Real, Tier};
use csi5300_kernels::sums::{Columns, Sines, pairs};

mod guarantee;
mod mirrors;

const WAVELENGTH: f64 = 0.054;

/// A standard normal pair as a complex number of unit variance.
fn noise(rng: &mut ChaCha8Rng) -> Complex64 {
    let radius = (-(1.0 - rng.random::<f64>()).ln()).sqrt();
    Complex64::from_polar(radius, TAU * rng.random::<f64>())
}

/// Plane waves (azimuth, elevation, amplitude) over `points`, in white noise of variance `variance`.
fn samples(points: &[Vector3<f64>], paths: &[(f64, f64, Complex64)], variance: f64, rng: &mut ChaCha8Rng) -> Samples {
    let mut samples = Samples::new(WAVELENGTH, 2).unwrap();
    for (t, p) in points.iter().enumerate() {
        let wave = |&(a, e, g): &(f64, f64, Complex64)| {
            g * Complex64::from_polar(1.0, TAU * 2.0 / WAVELENGTH * direction(a, e).dot(p))
        };
        let z = paths.iter().map(wave).sum::<Complex64>() + noise(rng) * variance.sqrt();
        samples.push(t as f64 * 0.01, z, *p, Vector3::zeros()).unwrap();
    }
    samples
}

fn track(shape: usize, radius: f64, n: usize, rng: &mut ChaCha8Rng) -> Vec<Vector3<f64>> {
    let turn = TAU * rng.random::<f64>();
    let mut walk = Vector3::zeros();
    (0..n)
        .map(|t| {
            let s = t as f64 / (n - 1).max(1) as f64;
            let a = turn + TAU * s;
            match shape {
                0 => Vector3::new(radius * a.cos(), radius * a.sin(), 0.0),
                1 => Vector3::new(turn.cos(), turn.sin(), 0.0) * (radius * (2.0 * s - 1.0)),
                2 => Vector3::new(radius * (turn + 2.0 * s).cos(), radius * (turn + 2.0 * s).sin(), 0.0),
                3 => {
                    let step = noise(rng) * (radius / (n as f64).sqrt());
                    walk += Vector3::new(step.re, step.im, 0.0);
                    walk
                }
                _ => Vector3::new(radius * a.cos(), radius * a.sin(), radius * s),
            }
        })
        .collect()
}

fn random_scene(case: usize, rng: &mut ChaCha8Rng) -> Samples {
    let radius = 0.05 * 30f64.powf(rng.random::<f64>());
    let n = rng.random_range(20..90);
    let points = track(case % 5, radius, n, rng);
    let paths: Vec<_> = (0..rng.random_range(1..=3))
        .map(|_| {
            let gain = Complex64::from_polar(rng.random_range(0.5..1.0), TAU * rng.random::<f64>());
            (TAU * rng.random::<f64>(), rng.random_range(-0.3..0.3), gain)
        })
        .collect();
    samples(&points, &paths, 10f64.powf(rng.random_range(-3.0..0.5)), rng)
}

fn columns(scene: &Scene) -> Columns<'_, f64> {
    Columns { x: &scene.x, y: &scene.y, z: &scene.z, re: &scene.re, im: &scene.im }
}

/// The highest value on a grid far denser than any bound asks for, at the given elevations.
fn dense_max(samples: &Samples, elevations: &[f64], oversampling: f64) -> f64 {
    let scene = Scene::new(samples).unwrap();
    let half = (oversampling * (TAU * scene.radius + 10.0)).ceil() as usize;
    let directions: Vec<[f64; 3]> = elevations
        .iter()
        .flat_map(|&e| (0..2 * half).map(move |i| direction(PI * i as f64 / half as f64, e).into()))
        .collect();
    let sums = pairs::<f64>(Tier::detect().level_or_portable(), columns(&scene), &directions, Sines::Fine);
    let top = sums.iter().map(|s| s.here().norm_sqr().max(s.opposite().norm_sqr())).fold(0.0, f64::max);
    top / (scene.sum_abs * scene.sum_abs)
}

#[test]
fn the_azimuth_search_finds_the_continuous_maximum() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for case in 0..400 {
        let samples = random_scene(case, &mut rng);
        let options = SearchOptions { elevation_max_rad: 0.0, ..SearchOptions::default() };
        let estimate = search(&samples, &options).unwrap();
        let dense = dense_max(&samples, &[0.0], 20.0);
        assert!(estimate.value >= dense * (1.0 - 1e-12), "case {case}: {} below {dense}", estimate.value);
        // Not above what the profile really is.
        let exact = oracle(&samples, &Grid::directions(vec![(estimate.azimuth_rad, 0.0)])).unwrap();
        assert!((exact.values[0] - estimate.value).abs() < 1e-12);
    }
}

#[test]
fn the_search_over_elevation_finds_the_continuous_maximum() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut searched = 0;
    for case in 0..120 {
        let samples = random_scene(case, &mut rng);
        let estimate = search(&samples, &SearchOptions::default()).unwrap();
        if !estimate.elevation_searched {
            continue;
        }
        searched += 1;
        let limit = 20f64.to_radians();
        let elevations: Vec<f64> = (0..=40).map(|i| limit * f64::from(i) / 40.0).collect();
        let dense = dense_max(&samples, &elevations, 4.0);
        assert!(estimate.value >= dense * (1.0 - 1e-12), "case {case}: {} below {dense}", estimate.value);
    }
    assert!(searched > 60, "elevation was searched in {searched} scenes only");
}

#[test]
fn kernels_agree_with_the_oracle_on_every_tier() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for case in 0..10 {
        let scene = Scene::new(&random_scene(case, &mut rng)).unwrap();
        let directions: Vec<Vector3<f64>> =
            (0..37).map(|_| direction(TAU * rng.random::<f64>(), rng.random_range(-1.5..1.5))).collect();
        let single = |c: &[f64]| c.iter().map(|v| f32::of(*v)).collect::<Vec<_>>();
        let c = columns(&scene);
        let (x, y, z, re, im) = (single(c.x), single(c.y), single(c.z), single(c.re), single(c.im));
        let narrow = Columns { x: &x, y: &y, z: &z, re: &re, im: &im };
        let list: Vec<[f64; 3]> = directions.iter().map(|u| (*u).into()).collect();
        let list32: Vec<[f32; 3]> = list.iter().map(|u| u.map(|v| v as f32)).collect();
        for tier in Tier::available() {
            let level = tier.level().unwrap();
            let wide = pairs::<f64>(level, c, &list, Sines::Fine);
            let thin = pairs::<f32>(level, narrow, &list32, Sines::Fine);
            let rough = pairs::<f32>(level, narrow, &list32, Sines::Rough);
            for (i, u) in directions.iter().enumerate() {
                let here = direct::sum(&scene, u);
                let opposite = direct::sum(&scene, &-u);
                // Phases of up to `radius` turns are rounded to 2^-53 (2^-24) of themselves, three times.
                let tolerance = scene.sum_abs * (4.0 + 20.0 * scene.radius);
                for (sum, unit) in [(wide[i], 2f64.powi(-53)), (thin[i], 2f64.powi(-24))] {
                    assert!((sum.here() - here).norm() < tolerance * unit, "{tier:?}");
                    assert!((sum.opposite() - opposite).norm() < tolerance * unit, "{tier:?}");
                }
                let tolerance = tolerance * 2f64.powi(-24) + scene.sum_abs * ROUGH;
                assert!((rough[i].here() - here).norm() < tolerance, "{tier:?}");
                assert!((rough[i].opposite() - opposite).norm() < tolerance, "{tier:?}");
            }
        }
    }
}

#[test]
fn estimates_agree_across_tiers() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for case in 0..5 {
        let samples = random_scene(case, &mut rng);
        let reference = search(&samples, &SearchOptions::default()).unwrap();
        for tier in Tier::available() {
            let options = SearchOptions { tier, ..SearchOptions::default() };
            let estimate = search(&samples, &options).unwrap();
            assert!((estimate.value - reference.value).abs() < 1e-12);
        }
    }
}

#[test]
fn the_observed_deviation_is_the_cramer_rao_bound() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let points = track(0, 0.3, 1_000, &mut rng);
    for (variance, elevation_max_rad) in [(0.01, 0.0), (0.5, 0.0), (0.5, 0.35)] {
        let (mut squares, mut predicted, mut elevation) = (0.0, 0.0, 0.0);
        let trials = 400;
        for _ in 0..trials {
            let truth = TAU * rng.random::<f64>();
            let raised = if elevation_max_rad > 0.0 { 0.2 } else { 0.0 };
            let samples = samples(&points, &[(truth, raised, Complex64::ONE)], variance, &mut rng);
            let options = SearchOptions { elevation_max_rad, ..SearchOptions::default() };
            let estimate = search(&samples, &options).unwrap();
            squares += wrap_rad(estimate.azimuth_rad - truth).powi(2);
            predicted += estimate.azimuth_sd_rad;
            elevation += ((estimate.abs_elevation_rad - raised) / estimate.elevation_sd_rad).powi(2);
            assert!((estimate.snr * variance - 1.0).abs() < 0.3);
        }
        let kappa = TAU * 2.0 / WAVELENGTH;
        let bound = 1.0 / (kappa * 0.3 * (1_000.0 / variance).sqrt())
            * if elevation_max_rad > 0.0 { 1.0 / 0.2f64.cos() } else { 1.0 };
        let rms = (squares / f64::from(trials)).sqrt();
        // 400 trials: the standard deviation of an observed one is 3.5 percent of it.
        assert!((rms / bound - 1.0).abs() < 0.12, "observed {rms} bound {bound}");
        assert!((predicted / f64::from(trials) / bound - 1.0).abs() < 0.03);
        if elevation_max_rad > 0.0 {
            assert!(((elevation / f64::from(trials)).sqrt() - 1.0).abs() < 0.12);
        }
    }
}

#[test]
fn a_raised_transmitter_does_not_bias_the_azimuth_of_an_arc() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let points = track(2, 0.5, 300, &mut rng);
    let samples = samples(&points, &[(0.7, 0.25, Complex64::ONE)], 1e-4, &mut rng);
    let free = search(&samples, &SearchOptions::default()).unwrap();
    assert!((free.azimuth_rad - 0.7).abs() < 5.0 * free.azimuth_sd_rad);
    assert!((free.abs_elevation_rad - 0.25).abs() < 5.0 * free.elevation_sd_rad);
    assert_eq!(free.signed_elevation_rad, None);
    let options = SearchOptions { elevation_max_rad: 0.0, ..SearchOptions::default() };
    let level = search(&samples, &options).unwrap();
    assert!((level.azimuth_rad - 0.7).abs() > 5.0 * free.azimuth_sd_rad, "the bias that the elevation removes");
}

#[test]
fn a_helix_tells_the_sign_of_the_elevation() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for elevation in [-0.2, 0.2] {
        let points = track(4, 0.3, 300, &mut rng);
        let samples = samples(&points, &[(2.0, elevation, Complex64::ONE)], 0.1, &mut rng);
        let estimate = search(&samples, &SearchOptions::default()).unwrap();
        assert_eq!(estimate.geometry, Geometry::Spatial);
        assert!((estimate.signed_elevation_rad.unwrap() - elevation).abs() < 5.0 * estimate.elevation_sd_rad);
    }
}

#[test]
fn a_line_reports_both_bearings() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for case in 0..20 {
        let points = track(1, 0.4, 200, &mut rng);
        let axis = points[199].y.atan2(points[199].x);
        let off = rng.random_range(0.4..2.7);
        let samples = samples(&points, &[(axis + off, 0.0, Complex64::ONE)], 0.1, &mut rng);
        let estimate = search(&samples, &SearchOptions::default()).unwrap();
        assert_eq!(estimate.geometry, Geometry::Line);
        assert!(!estimate.elevation_searched);
        let mirror = estimate.mirror_rad.unwrap();
        let pair = [estimate.azimuth_rad, mirror];
        for expected in [axis + off, axis - off] {
            assert!(
                pair.iter().any(|a| wrap_rad(a - expected).abs() < 0.02),
                "case {case}: {pair:?} without {expected}"
            );
        }
        assert!(estimate.peak_ratio.unwrap() < 0.9);
    }
}

/// The columns of samples, to be changed and made samples again.
struct Parts {
    wavelength_m: f64,
    path_gain: u8,
    z: Vec<Complex64>,
    receiver_m: Vec<Vector3<f64>>,
    weight: Vec<f64>,
}

impl Parts {
    fn of(samples: &Samples) -> Self {
        Self {
            wavelength_m: samples.wavelength_m(),
            path_gain: samples.path_gain(),
            z: samples.z().to_vec(),
            receiver_m: samples.receiver_m().to_vec(),
            weight: samples.weight().to_vec(),
        }
    }

    fn samples(&self) -> Result<Samples, Error> {
        let mut samples = Samples::new(self.wavelength_m, self.path_gain)?;
        for ((z, p), w) in self.z.iter().zip(&self.receiver_m).zip(&self.weight) {
            samples.push_weighted(0.0, *z, *p, Vector3::zeros(), *w)?;
        }
        Ok(samples)
    }
}

#[test]
fn bad_input_has_its_own_error_each() {
    use crate::signal::samples::SamplesError::{NonFinite, PathGain, Wavelength, Weight};
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let points = track(0, 0.3, 50, &mut rng);
    let good = samples(&points, &[(1.0, 0.0, Complex64::ONE)], 0.1, &mut rng);
    let run = |change: &dyn Fn(&mut Parts)| {
        let mut parts = Parts::of(&good);
        change(&mut parts);
        search(&parts.samples()?, &SearchOptions::default())
    };
    assert!(run(&|_| ()).is_ok());
    assert_eq!(run(&|s| s.z.clear()).unwrap_err(), Error::Empty);
    assert!(matches!(run(&|s| s.z[7].im = f64::NAN), Err(Error::Samples(NonFinite { what: "sample", index: 7 }))));
    assert!(matches!(run(&|s| s.receiver_m[3].z = f64::INFINITY), Err(Error::Samples(NonFinite { index: 3, .. }))));
    assert!(matches!(run(&|s| s.receiver_m[3].z = f64::MAX), Err(Error::NonFinite { .. })));
    assert!(matches!(run(&|s| s.weight[2] = -1.0), Err(Error::Samples(Weight { index: 2, .. }))));
    assert!(matches!(run(&|s| s.z.fill(Complex64::ZERO)), Err(Error::ZeroEnergy { count: 50 })));
    assert!(matches!(run(&|s| s.path_gain = 0), Err(Error::Samples(PathGain))));
    assert!(matches!(run(&|s| s.receiver_m.fill(Vector3::x())), Err(Error::NoMotion { .. })));
    assert!(matches!(run(&|s| s.receiver_m.iter_mut().for_each(|p| *p *= 1e9)), Err(Error::Aperture { .. })));
    for wavelength in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(run(&|s| s.wavelength_m = wavelength), Err(Error::Samples(Wavelength { .. }))));
    }
    let options = SearchOptions { elevation_max_rad: 2.0, ..SearchOptions::default() };
    assert!(matches!(search(&good, &options), Err(Error::ElevationMax { .. })));
    assert!(matches!(profile(&good, &Grid::directions(vec![(0.0, f64::NAN)])), Err(Error::Direction { .. })));
}

#[test]
fn offsets_and_magnitudes_cost_nothing() {
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let points = track(2, 0.3, 100, &mut rng);
    let samples = samples(&points, &[(1.0, 0.1, Complex64::ONE)], 0.1, &mut rng);
    let reference = search(&samples, &SearchOptions::default()).unwrap();
    for (offset, scale) in [(1e6, 1.0), (0.0, 1e-300), (0.0, 1e300), (-1e6, 1e-30)] {
        let mut moved = Parts::of(&samples);
        moved.receiver_m.iter_mut().for_each(|p| *p += Vector3::new(offset, -offset, 0.0));
        moved.z.iter_mut().for_each(|z| *z *= scale);
        let estimate = search(&moved.samples().unwrap(), &SearchOptions::default()).unwrap();
        // At 1e6 m the positions themselves are rounded to 1e-10 m.
        assert!(wrap_rad(estimate.azimuth_rad - reference.azimuth_rad).abs() < 1e-7);
        assert!((estimate.value - reference.value).abs() < 1e-7);
        assert!((estimate.snr / reference.snr - 1.0).abs() < 1e-5);
    }
}

#[test]
fn grids_have_the_directions_they_promise() {
    let degrees = |(a, e): (f64, f64)| (a.to_degrees(), e.to_degrees());
    let close = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).abs() < 1e-9 && (a.1 - b.1).abs() < 1e-9;
    let plain = Grid::azimuth_elevation(360, 181);
    assert_eq!((plain.len(), plain.shape()), (65_160, (181, 360)));
    assert!(close(degrees(plain.at(0)), (-180.0, -90.0)));
    assert!(close(degrees(plain.at(90 * 360 + 190)), (10.0, 0.0)));
    let wsr = Grid::wsr();
    assert_eq!((wsr.len(), wsr.shape()), (32_400, (90, 360)));
    assert!(close(degrees(wsr.at(359)), (180.0, 90.0)));
    assert!(close(degrees(wsr.at(89 * 360)), (-180.0, 0.0)));
    assert!(close(degrees(wsr.at(360 + 1)), (-180.0 + 360.0 / 359.0, 90.0 - 90.0 / 89.0)));
}

#[test]
fn profile_variance_is_that_of_the_row_repeated_for_each_polar_angle() {
    // By its definition; steps across the wrap are single ones.
    let tiled = |row: &[f64]| {
        let peak = row.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0 as i32;
        let (mut weighted, mut plain) = (0.0, 0.0);
        for up in 0..90 {
            for (column, value) in row.iter().enumerate() {
                let across = (column as i32 - peak).rem_euclid(360).min((peak - column as i32).rem_euclid(360));
                let d2 = f64::from(across * across + up * up);
                (weighted, plain) = (weighted + d2 * value, plain + d2);
            }
        }
        weighted / (90.0 * row.iter().sum::<f64>()) / (plain / (90.0 * 360.0))
    };
    let profile = |values: Vec<f64>| Profile { grid: Grid::wsr_azimuths(), values, sum_abs: 1.0 };
    let mut sharp = vec![0.0; 360];
    (sharp[359], sharp[0]) = (1.0, 0.5);
    for row in [vec![0.5; 360], (0..360).map(|i| f64::from(i * 37 % 101)).collect(), sharp.clone()] {
        let found = wsr_planar_profile_variance(&profile(row.clone())).unwrap();
        assert!((found / tiled(&row) - 1.0).abs() < 1e-12, "{found}");
    }
    assert!((wsr_planar_profile_variance(&profile(vec![0.5; 360])).unwrap() - 1.0).abs() < 1e-12);
    assert!((profile(vec![0.5; 360]).likelihood_share().unwrap() - 1.0 / 360.0).abs() < 1e-15);
    assert!((profile(sharp).likelihood_share().unwrap() - 2.0 / 3.0).abs() < 1e-15);
}
