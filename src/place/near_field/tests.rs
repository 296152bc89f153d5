use super::kernel::powers;
use super::one_wave::{CentreWave, OneWave, Unexplained};
use super::prepared::PreparedAperture;
use super::search::search;
use super::types::{Band, Place, Precision, Taper};
use super::*;
use crate::bartlett::{Tier, direction};
use crate::signal::alignment::CsiRow;
use crate::signal::channel::SUBCARRIERS;
use crate::signal::samples::Samples;
use nalgebra::Vector3;
use num_complex::{Complex32, Complex64};
use std::f64::consts::TAU;

const WAVELENGTH_M: f64 = 0.0541;

/// A fixed sequence of Gaussian noise.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    fn complex(&mut self, sd: f64) -> Complex64 {
        Complex64::from_polar(sd * (-self.uniform().ln()).sqrt(), TAU * self.uniform())
    }
}

/// A curve of a metre, somewhere in the plane.
fn curve(n: usize) -> Vec<Vector3<f64>> {
    (0..n)
        .map(|t| {
            let a = 2.6 * t as f64 / n as f64;
            Vector3::new(1.0 + 0.35 * a.cos(), -0.4 + 0.4 * a.sin() + 0.05 * a, 0.2)
        })
        .collect()
}

/// Rows of `gain` times the path to each of `sources` (position, amplitude), with noise on every subcarrier.
fn rows(path: &[Vector3<f64>], gain: u8, sources: &[(Vector3<f64>, f64)], noise_sd: f64, seed: u64) -> Vec<CsiRow> {
    let mut noise = Noise(seed);
    let kappa = TAU * f64::from(gain) / WAVELENGTH_M;
    let row = |p: &Vector3<f64>| -> CsiRow {
        let wave = |(at, amplitude): &(Vector3<f64>, f64)| Complex64::from_polar(*amplitude, -kappa * (p - at).norm());
        let sum: Complex64 = sources.iter().map(wave).sum();
        std::array::from_fn(|_| {
            let value = sum + noise.complex(noise_sd);
            Complex32::new(value.re as f32, value.im as f32)
        })
    };
    path.iter().map(row).collect()
}

fn limits() -> Limits {
    Limits::new(20f64.to_radians(), 1.8)
}

const ALL: Band = Band::Subcarriers(SUBCARRIERS);
const WHOLE: [View; 1] = [View::new(1, Taper::Hann, ALL)];

fn middle(path: &[Vector3<f64>]) -> Vector3<f64> {
    path.iter().sum::<Vector3<f64>>() / path.len() as f64
}

#[test]
fn the_kernel_is_the_sum_as_written_on_every_tier() {
    let path = curve(137);
    let mut noise = Noise(5);
    // Three shapes over the subcarriers: few enough for the kernel's columns to hold everything.
    let data: Vec<CsiRow> = rows(&path, 1, &[(Vector3::new(3.0, 2.0, 0.5), 1.0)], 0.0, 5)
        .iter()
        .map(|row| {
            let (a, b) = (noise.complex(0.7), noise.complex(0.5));
            std::array::from_fn(|k| {
                let other = a * Complex64::cis(0.3 * k as f64) + b * Complex64::cis(-0.2 * k as f64);
                row[k] + Complex32::new(other.re as f32, other.im as f32)
            })
        })
        .collect();
    let aperture = Aperture { displacement_m: path.clone(), rows: data.clone(), path_gain: 1, ..Aperture::default() };
    let middle = middle(&path);
    let views = [View::new(1, Taper::Hann, ALL), View::new(3, Taper::Hann, ALL)];
    let prepared =
        [PreparedAperture::new(&aperture, &middle, WAVELENGTH_M, 0.6, &views, Tier::detect().level_or_portable())];
    let place = |(azimuth, elevation, curve)| Place { azimuth, elevation, curve };
    let places = [(0.3, 0.1, 0.0), (2.0, 0.0, 0.4), (-1.2, 0.3, 0.55)].map(place);
    let written = |&Place { azimuth, elevation, curve }: &Place| {
        let mut sums = [Complex64::default(); SUBCARRIERS];
        let mut energy = 0.0;
        for (p, row) in path.iter().zip(&data) {
            let p = p - middle;
            let u = direction(azimuth, elevation);
            let excess = if curve == 0.0 { -u.dot(&p) } else { (p - u / curve).norm() - 1.0 / curve };
            for (sum, v) in sums.iter_mut().zip(row) {
                let v = Complex64::new(f64::from(v.re), f64::from(v.im));
                *sum += v * Complex64::cis(TAU * excess / WAVELENGTH_M);
                energy += v.norm_sqr();
            }
        }
        sums.iter().map(Complex64::norm_sqr).sum::<f64>() / (energy * path.len() as f64)
    };
    for tier in Tier::available() {
        let found = powers(tier.level_or_portable(), &prepared, &places, Precision::Exact);
        for (place, own) in places.iter().zip(found.chunks(2)) {
            assert!((f64::from(own[0]) - written(place)).abs() < 1e-5, "{tier:?} {place:?}: {own:?}");
            assert!((0.0..=1.0).contains(&own[1]), "{own:?}");
        }
        // Rough powers: phases a fiftieth of a turn off, so the root of a power is off by an eighth at most.
        let rough = powers(tier.level_or_portable(), &prepared, &places, Precision::Rough);
        assert_ne!(rough, found, "{tier:?}");
        assert!(rough.iter().zip(&found).all(|(a, b)| (a.sqrt() - b.sqrt()).abs() < 0.125), "{rough:?} {found:?}");
    }
}

#[test]
fn a_place_is_found_with_its_range_and_height() {
    let path = curve(900);
    for (x, y, z) in [(4.2, 1.5, 0.9), (-2.0, -2.5, 0.5), (1.5, 3.5, 1.2)] {
        let place = Vector3::new(x, y, z);
        let aperture = Aperture::gather(&path, &rows(&path, 2, &[(place, 1.0)], 0.5, 11), 2, WAVELENGTH_M);
        let fix = search(&[(&aperture, &WHOLE)], middle(&path), WAVELENGTH_M, &limits()).unwrap();
        let true_azimuth = (y - middle(&path).y).atan2(x - middle(&path).x);
        let off = crate::maths::wrap_rad(fix.best().azimuth_rad - true_azimuth);
        assert!(off.abs() < 5.0 * fix.deviations.azimuth_rad.max(2e-4), "{off} {:?}", fix.deviations);
        let (found, covariance) = fix.position().unwrap();
        let error = found - place;
        let level = error.dot(&(covariance.try_inverse().unwrap() * error));
        assert!(level < 25.0 && error.norm() < 0.3, "{error} {covariance}");
        let (range, sd) = fix.range_m(0.3).unwrap();
        assert!((range - (place - middle(&path)).norm()).abs() < 5.0 * sd && sd < 0.2, "{range} {sd}");
    }
}

#[test]
fn errors_are_those_that_the_bound_predicts() {
    let path = curve(300);
    let place = Vector3::new(3.9, 0.8, 0.8);
    let true_azimuth = (place.y - middle(&path).y).atan2(place.x - middle(&path).x);
    let (mut squares, mut predicted, trials) = (0.0, 0.0, 60);
    for seed in 0..trials {
        let data = rows(&path, 2, &[(place, 1.0)], 1.5, 1_000 + seed);
        let aperture = Aperture { displacement_m: path.clone(), rows: data, path_gain: 2, ..Aperture::default() };
        let fix = search(&[(&aperture, &WHOLE)], middle(&path), WAVELENGTH_M, &limits()).unwrap();
        squares += (fix.best().azimuth_rad - true_azimuth).powi(2);
        predicted += fix.deviations.azimuth_rad.powi(2);
    }
    let ratio = (squares / predicted).sqrt();
    // Predictions allow for a scale of the trajectory that is off by a per cent, which it is not here: errors are smaller.
    // (60 trials know a standard deviation to 9 %, one sigma.)
    assert!((0.45..1.28).contains(&ratio), "{ratio}");
}

#[test]
fn one_way_windows_and_round_trip_agree_where_there_is_one_path() {
    let path = curve(500);
    let place = Vector3::new(-3.0, 1.0, 0.6);
    let round = Aperture::gather(&path, &rows(&path, 2, &[(place, 1.0)], 0.3, 3), 2, WAVELENGTH_M);
    let once = Aperture::gather(&path, &rows(&path, 1, &[(place, 1.0)], 0.3, 4), 1, WAVELENGTH_M);
    let windows = [
        View::new(3, Taper::Hann, Band::Subcarriers(6)).with_weight(0.5),
        View::new(6, Taper::Block, Band::Subcarriers(6)).with_weight(0.5),
    ];
    let fix = search(&[(&round, &WHOLE), (&once, &windows)], middle(&path), WAVELENGTH_M, &limits()).unwrap();
    assert_eq!((fix.view_azimuths_rad.len(), fix.view_powers.len()), (3, 3));
    let azimuth = fix.best().azimuth_rad;
    assert!(fix.view_azimuths_rad.iter().all(|a| crate::maths::wrap_rad(a - azimuth).abs() < 0.05), "{fix:?}");
    assert!((fix.position().unwrap().0 - place).norm() < 0.1);
}

#[test]
fn small_arrays_see_plane_waves_and_say_nothing_of_range() {
    let path: Vec<_> = curve(200).iter().map(|p| p * 0.02).collect();
    let aperture =
        Aperture::gather(&path, &rows(&path, 2, &[(Vector3::new(40.0, 10.0, 0.0), 1.0)], 0.2, 9), 2, WAVELENGTH_M);
    let fix = search(&[(&aperture, &WHOLE)], middle(&path), WAVELENGTH_M, &limits()).unwrap();
    assert!(!fix.range_searched && fix.range_m(0.3).is_none() && fix.position().is_none());
    assert!(search(&[], middle(&path), WAVELENGTH_M, &limits()).is_none());
    let empty = Aperture::default();
    assert!(search(&[(&empty, &WHOLE)], middle(&path), WAVELENGTH_M, &limits()).is_none());
    let huge: Vec<_> = curve(50).iter().map(|p| p * 1e6).collect();
    let aperture = Aperture::gather(&huge, &rows(&huge, 2, &[], 1.0, 1), 2, WAVELENGTH_M);
    assert!(search(&[(&aperture, &WHOLE)], middle(&huge), WAVELENGTH_M, &limits()).is_none());
}

/// The square of the sum of the waves, as a round trip is.
fn squared(path: &[Vector3<f64>], sources: &[(Vector3<f64>, f64)], noise_sd: f64) -> Vec<CsiRow> {
    let mut noise = Noise(77);
    let square = |row: &CsiRow| row.map(|v| v * v);
    let noisy = |row: CsiRow| {
        row.map(|v| {
            let other = noise.complex(noise_sd);
            v + Complex32::new(other.re as f32, other.im as f32)
        })
    };
    rows(path, 1, sources, 0.0, 1).iter().map(square).map(noisy).collect()
}

#[test]
fn paths_come_out_of_their_square_and_their_product_is_named() {
    let path = curve(600);
    let own = [(Vector3::new(4.0, 1.0, 0.3), 1.0), (Vector3::new(3.6, 2.6, 0.3), 0.7)];
    let round = Aperture::gather(&path, &squared(&path, &own, 0.2), 2, WAVELENGTH_M);
    let once = Aperture::gather(&path, &rows(&path, 1, &own, 0.2, 8), 1, WAVELENGTH_M);
    let windows = [View::new(3, Taper::Hann, ALL).with_weight(2.0)];
    let layers: [(&Aperture, &[View]); 2] = [(&round, &WHOLE), (&once, &windows)];
    let mut search = Search::new(&layers, middle(&path), WAVELENGTH_M, &limits()).unwrap();
    let fix = search.run().unwrap();
    let paths = search.paths(&fix.best());
    let sources: Vec<&Path> = paths.iter().filter(|path| path.cross_term_of.is_none()).collect();
    let azimuth = |at: &Vector3<f64>| (at.y - middle(&path).y).atan2(at.x - middle(&path).x);
    for (at, amplitude) in &own {
        let near = |p: &&&Path| crate::maths::wrap_rad(p.azimuth_rad - azimuth(at)).abs() < 0.02;
        let found = sources.iter().find(near).unwrap_or_else(|| panic!("{at}: {paths:?}"));
        assert!((found.relative_power_db - 20.0 * f64::log10(*amplitude)).abs() < 1.0, "{paths:?}");
    }
    // Products are of sources: none is explained by another product.
    let products: Vec<[usize; 2]> = paths.iter().filter_map(|path| path.cross_term_of).collect();
    assert!(!products.is_empty(), "{paths:?}");
    assert!(products.iter().flatten().all(|parent| paths[*parent].cross_term_of.is_none()), "{paths:?}");
    assert_eq!(sources.len(), 2, "{paths:?}");
}

#[test]
fn a_bent_trajectory_is_straightened_where_it_pays_and_left_alone_where_not() {
    let path = curve(500);
    let places = [Vector3::new(4.2, 1.5, 0.4), Vector3::new(-2.0, -3.0, 0.5), Vector3::new(0.5, 4.0, 0.2)];
    // Odometry that reports too little: too much would pass for elevation, which shortens the horizontal wave.
    let wrong = Warp { scale: 0.95, turn_rad_per_m: -0.2 };
    let middle = middle(&path);
    let about: Vec<_> = path.iter().map(|p| p - middle).collect();
    let bent: Vec<_> = wrong.applied(&about).iter().map(|p| p + middle).collect();
    for (reported, drifts) in [(&path, false), (&bent, true)] {
        let search = |(k, place): (usize, &Vector3<f64>)| {
            let data = rows(&path, 2, &[(*place, 1.0)], 0.5, 40 + k as u64);
            let aperture = Aperture::gather(reported, &data, 2, WAVELENGTH_M);
            Search::new(&[(&aperture, &WHOLE)], middle, WAVELENGTH_M, &limits()).unwrap()
        };
        let mut searches: Vec<Search> = places.iter().enumerate().map(search).collect();
        let fixes: Vec<Fix> = searches.iter_mut().map(|search| search.run().unwrap()).collect();
        let mut clones = searches.clone();
        let mut links: Vec<(&mut Search, &Fix)> = searches.iter_mut().zip(&fixes).collect();
        let found = focus(&mut links, false);
        assert_eq!(focus(&mut clones.iter_mut().zip(&fixes).collect::<Vec<_>>(), true), found);
        assert_eq!(found.worthwhile, drifts, "{found:?}");
        if drifts {
            assert!(found.warp.scale > 1.0, "{found:?}");
            let error = |(search, place): (&mut Search, &Vector3<f64>)| {
                let offset = search.run().unwrap().best().azimuth_rad - (place.y - middle.y).atan2(place.x - middle.x);
                crate::maths::wrap_rad(offset).abs()
            };
            let before = fixes.iter().zip(&places).map(|(fix, place)| {
                let offset = fix.best().azimuth_rad - (place.y - middle.y).atan2(place.x - middle.x);
                crate::maths::wrap_rad(offset).abs()
            });
            let before: f64 = before.sum();
            let after: f64 = searches.iter_mut().zip(&places).map(error).sum();
            assert!(after < before, "{before} {after}");
        }
    }
}

#[test]
fn sums_over_runs_have_the_powers_of_their_samples() {
    let path = curve(900);
    let own = [(Vector3::new(4.0, 1.0, 0.3), 1.0), (Vector3::new(-1.6, 2.6, 0.3), 0.7)];
    let round = Aperture::gather(&path, &squared(&path, &own, 0.2), 2, WAVELENGTH_M);
    let once = Aperture::gather(&path, &rows(&path, 1, &own, 0.2, 8), 1, WAVELENGTH_M);
    let windows = [View::new(3, Taper::Hann, ALL), View::new(8, Taper::Block, ALL)];
    let layers: [(&Aperture, &[View]); 2] = [(&round, &WHOLE), (&once, &windows)];
    let search = Search::new(&layers, middle(&path), WAVELENGTH_M, &limits()).unwrap();
    for (aperture, axes) in search.apertures.iter().zip(&search.own_axes) {
        let summed = search.powers_on(aperture, axes);
        let all = powers(search.level(), std::slice::from_ref(aperture), &axes.places(), Precision::Rough);
        let apart = summed.iter().zip(&all).map(|(a, b)| (a.sqrt() - b.sqrt()).abs()).fold(0.0, f32::max);
        assert!(summed.len() == all.len() && apart < 0.04, "{apart}");
    }
    let start = Place { azimuth: 0.3, elevation: 0.1, curve: 0.2 };
    let few: Vec<usize> = search.apertures_about(&search.apertures, &start).iter().map(PreparedAperture::len).collect();
    let many: Vec<usize> = search.apertures.iter().map(PreparedAperture::len).collect();
    assert!(few.iter().zip(&many).all(|(few, many)| 3 * few < 2 * many), "{few:?} of {many:?}");
}

/// What one wave is found to leave of the phases of `sources` along `path`.
fn one_wave(path: &[Vector3<f64>], sources: &[(Vector3<f64>, f64)], noise_sd: f64) -> Result<OneWave, Unexplained> {
    let mut samples = Samples::new(WAVELENGTH_M, 2).unwrap();
    for (k, (p, row)) in path.iter().zip(rows(path, 2, sources, noise_sd, 21)).enumerate() {
        let z = Complex64::new(f64::from(row[0].re), f64::from(row[0].im));
        samples.push(k as f64, z / z.norm(), *p, Vector3::zeros()).unwrap();
    }
    let plane_wave = crate::bartlett::search(&samples, &crate::bartlett::SearchOptions::default()).unwrap();
    CentreWave::new(&samples, &limits()).unwrap().explain(&plane_wave)
}

#[test]
fn one_wave_is_enough_where_it_leaves_noise_and_only_there() {
    let path = curve(500);
    let (direct, other) = (Vector3::new(4.2, 1.5, 0.6), Vector3::new(-1.0, 4.0, 0.4));
    let true_azimuth = (direct.y - middle(&path).y).atan2(direct.x - middle(&path).x);
    let one = one_wave(&path, &[(direct, 1.0)], 0.1).unwrap();
    let off = crate::maths::wrap_rad(one.fix.azimuth_rad - true_azimuth);
    assert!(off.abs() < 4.0 * one.fix.deviations.azimuth_rad, "{off} {:?}", one.fix.deviations);
    assert!(one.risk_rad > one.fix.deviations.azimuth_rad * 0.5 && one.risk_rad < 0.02, "{}", one.risk_rad);
    assert!((one.fix.position().unwrap().0 - direct).norm() < 0.5, "{:?}", one.fix.position());
    // Noise hides more as it grows.
    assert!(one_wave(&path, &[(direct, 1.0)], 0.3).unwrap().risk_rad > 2.0 * one.risk_rad);
    let with_another = one_wave(&path, &[(direct, 1.0), (other, 0.15)], 0.1);
    assert!(matches!(with_another, Err(Unexplained::AnotherWave(_) | Unexplained::Neighbours(_))), "{with_another:?}");
    let bent: Vec<_> = path.iter().map(|p| p + Vector3::new(0.0, 0.01 * (9.0 * p.x).sin(), 0.0)).collect();
    let mut samples = Samples::new(WAVELENGTH_M, 2).unwrap();
    for (k, (p, row)) in bent.iter().zip(rows(&path, 2, &[(direct, 1.0)], 0.1, 5)).enumerate() {
        let z = Complex64::new(f64::from(row[0].re), f64::from(row[0].im));
        samples.push(k as f64, z / z.norm(), *p, Vector3::zeros()).unwrap();
    }
    let plane_wave = crate::bartlett::search(&samples, &crate::bartlett::SearchOptions::default()).unwrap();
    let bent = CentreWave::new(&samples, &limits()).unwrap().explain(&plane_wave);
    assert!(bent.is_err(), "{bent:?}");
    assert!(matches!(one_wave(&curve(20), &[(direct, 1.0)], 0.1), Err(Unexplained::FewRows(20))));
}
