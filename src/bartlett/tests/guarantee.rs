//! `|f~ - f| <= eps sum w |z|` for every path, precision and tier.

use super::*;
use crate::bartlett::plan::*;

/// The largest error over some directions of a grid, relative to `sum w |z|`, and the method that was used.
fn error(
    samples: &Samples,
    grid: &Grid,
    options: &ProfileOptions,
    planner: &mut Planner,
    rng: &mut ChaCha8Rng,
) -> (f64, Explanation) {
    let scene = Scene::new(samples, WAVELENGTH).unwrap();
    let plan = planner.plan_scene(&scene, grid, options).unwrap();
    let sums = planner.sums(&plan, &scene);
    let tilted = plan.explain().skipped.iter().any(|s| s.contains("tilted plane"));
    let mut worst = 0f64;
    for i in 0..60 {
        // Corners, and anywhere.
        let index = if i < 3 { i * (grid.len() - 1) / 2 } else { rng.random_range(0..grid.len()) };
        let (azimuth, elevation) = grid.at(index);
        let exact = direct::sum(&scene, &direction(azimuth, elevation));
        // In the axes of a tilted plane the middle lies in that plane: another phase for each direction, no other change.
        let difference = if tilted { sums[index].norm() - exact.norm() } else { (sums[index] - exact).norm() };
        worst = worst.max(difference.abs() / scene.sum_abs);
    }
    (worst, plan.explain().clone())
}

#[test]
fn every_method_keeps_its_promise() {
    let mut rng = ChaCha8Rng::seed_from_u64(20);
    let methods = [Method::Direct, Method::RingsDirect, Method::RingsNufft, Method::TargetsNufft, Method::Slab];
    for case in 0..12 {
        let samples = random_scene(case, &mut rng);
        let grids = [
            Grid::azimuth(360),
            Grid::azimuth_elevation(72, 37),
            Grid::azimuth_elevation(360, 19),
            Grid::directions((0..50).map(|_| (rng.random_range(-4.0..4.0), rng.random_range(-1.6..1.6))).collect()),
        ];
        for tier in Tier::available() {
            let mut planner = Planner::new(tier);
            for grid in &grids {
                for eps in [1e-3, 1e-4, 1e-6, 1e-9, 1e-12] {
                    let method = methods[rng.random_range(0..methods.len())];
                    let options = ProfileOptions { eps, method: Some(method), precision: None };
                    let (worst, explanation) = error(&samples, grid, &options, &mut planner, &mut rng);
                    if worst > eps * 0.3 {
                        println!("{:.2} {worst:.2e} case {case}, {explanation}", worst / eps);
                    }
                    assert!(worst <= eps, "{worst:.2e} case {case}, {explanation}");
                }
            }
        }
    }
}

#[test]
fn the_promise_holds_from_one_packet_to_many_and_from_no_motion_to_five_metres() {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    let mut planner = Planner::default();
    let mut used = std::collections::BTreeSet::new();
    for case in 0..48 {
        let n = [1, 2, 3, 17, 300, 3_000, 30_000, 100_000][case % 8];
        let radius = if case % 11 == 0 { 0.0 } else { 5.0 * 1e-4f64.powf(rng.random::<f64>()) };
        let mut points = track(case % 5, radius, n, &mut rng);
        if case % 3 == 0 {
            // A tilted plane, or any other turned track.
            let turn = nalgebra::Rotation3::new(Vector3::new(rng.random(), rng.random(), rng.random()));
            points.iter_mut().for_each(|p| *p = turn * *p);
        }
        let samples = samples(&points, &[(rng.random_range(-3.0..3.0), 0.2, Complex64::ONE)], 0.3, &mut rng);
        for eps in [1e-2, 1e-4, 1e-5, 1e-8, 1e-11] {
            let options = ProfileOptions { eps, ..ProfileOptions::default() };
            let grid = if case % 2 == 0 { Grid::azimuth_elevation(48, 13) } else { Grid::azimuth(360) };
            let (worst, explanation) = error(&samples, &grid, &options, &mut planner, &mut rng);
            used.insert(format!("{:?}", explanation.method));
            assert!(worst <= eps, "{worst:.2e} case {case}, {n} packets, {radius} m, {explanation}");
        }
    }
    assert!(used.len() >= 5, "only {used:?} were chosen");
}

#[test]
fn plans_are_reused_and_the_oracle_is_exact() {
    let mut rng = ChaCha8Rng::seed_from_u64(22);
    let mut planner = Planner::default();
    let grid = Grid::azimuth_elevation(72, 37);
    for turn in 0..5 {
        let points: Vec<_> = track(0, 0.3 - 1e-4 * f64::from(turn), 500, &mut rng);
        let samples = samples(&points, &[(1.0, 0.0, Complex64::ONE)], 0.1, &mut rng);
        planner.profile(&samples, WAVELENGTH, &grid, &ProfileOptions::default()).unwrap();
    }
    assert!(planner.built() <= 2, "{} plans for one aperture", planner.built());
    let points = track(4, 0.3, 50, &mut rng);
    let samples = samples(&points, &[(1.0, 0.0, Complex64::ONE)], 0.1, &mut rng);
    let options = ProfileOptions { eps: 0.0, ..ProfileOptions::default() };
    let exact = planner.profile(&samples, WAVELENGTH, &grid, &options).unwrap();
    let reference = oracle(&samples, WAVELENGTH, &grid).unwrap();
    assert!(exact.values.iter().zip(&reference.values).all(|(a, b)| (a - b).abs() < 1e-15));
    let bad = ProfileOptions { eps: -1.0, ..options };
    assert!(matches!(planner.profile(&samples, WAVELENGTH, &grid, &bad), Err(Error::Tolerance { .. })));
}

#[test]
fn explanations_say_what_was_left_out() {
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    let mut planner = Planner::default();
    let mut explain = |shape: usize, radius: f64, grid: &Grid| {
        let points = track(shape, radius, 1_000, &mut rng);
        let samples = samples(&points, &[(1.0, 0.0, Complex64::ONE)], 0.1, &mut rng);
        planner.plan(&samples, WAVELENGTH, grid, &ProfileOptions::default()).unwrap().explain().clone()
    };
    let full = Grid::azimuth_elevation(360, 181);
    let planar = explain(0, 0.3, &full);
    assert_eq!(planar.method, Method::RingsNufft);
    assert!(planar.to_string().contains("the lower hemisphere"));
    assert!(planar.evaluated * 6 < planar.directions);
    assert!(explain(0, 0.3, &Grid::azimuth(360)).to_string().contains("every elevation"));
    assert!(explain(1, 0.3, &full).to_string().contains("across the line"));
    assert_eq!(explain(0, 1e-9, &full).method, Method::Constant);
    assert!(!explain(4, 0.3, &full).to_string().contains("hemisphere"));
}

#[test]
fn a_stream_gives_the_profile_of_its_window() {
    let mut rng = ChaCha8Rng::seed_from_u64(24);
    let grid = Grid::azimuth_elevation(72, 37);
    for window in [None, Some(400)] {
        let options = StreamOptions {
            wavelength_m: WAVELENGTH,
            path_gain: 2,
            middle_m: Vector3::new(5.0, -3.0, 0.0),
            reach_m: 0.4,
            window,
            eps: 1e-4,
            tier: Tier::detect(),
        };
        let mut stream = Stream::new(options, &grid).unwrap();
        let mut out = Vec::new();
        assert_eq!(stream.query(&mut out), Err(Error::Empty));
        let points: Vec<_> = track(0, 0.3, 1_237, &mut rng).into_iter().map(|p| p + options.middle_m).collect();
        let all = samples(&points, &[(1.0, 0.1, Complex64::new(1e-9, 0.0))], 1e-19, &mut rng);
        for (t, (z, p)) in all.z.iter().zip(&all.receiver_m).enumerate() {
            stream.push(*z, *p).unwrap();
            if t % 300 == 7 || t + 1 == all.len() {
                let mut covered = Samples::new(2);
                for i in t + 1 - stream.len()..=t {
                    covered.push(0.0, all.z[i], all.receiver_m[i], Vector3::zeros());
                }
                let sum_abs = stream.query(&mut out).unwrap();
                let exact = oracle(&covered, WAVELENGTH, &grid).unwrap();
                assert!((sum_abs / exact.sum_abs - 1.0).abs() < 1e-12);
                // |f~^2 - f^2| <= 2 eps for |f| <= 1.
                assert!(out.iter().zip(&exact.values).all(|(a, b)| (a - b).abs() < 2e-4));
            }
        }
        assert!(window.is_none_or(|w| stream.len() <= w + w / 8 && stream.len() + w / 8 >= w));
        assert!(matches!(stream.push(Complex64::ONE, Vector3::zeros()), Err(Error::Aperture { .. })));
        assert!(matches!(stream.push(Complex64::new(f64::NAN, 0.0), options.middle_m), Err(Error::NonFinite { .. })));
    }
}
