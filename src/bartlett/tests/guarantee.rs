//! `|f~ - f| <= eps sum w |z|` for every path, precision and tier.

use super::*;

/// The largest error over some directions of a grid, relative to `sum w |z|`, and the method that was used.
fn error(
    samples: &Samples,
    grid: &Grid,
    options: &ProfileOptions,
    planner: &mut Planner,
    rng: &mut ChaCha8Rng,
) -> (f64, Explanation) {
    let scene = Scene::new(samples).unwrap();
    let plan = planner.plan_scene(&scene, grid, options).unwrap();
    let sums = planner.sums(&plan, &scene);
    let tilted = plan.explanation.skipped.iter().any(|s| s.contains("tilted plane"));
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
    (worst, plan.explanation.clone())
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

/// Directions of a grid to be checked, with the exact sums there.
struct Exact {
    scene: Scene,
    grid: Grid,
    sums: Vec<(usize, Complex64)>,
}

impl Exact {
    fn new(samples: &Samples, grid: Grid, count: usize, rng: &mut ChaCha8Rng) -> Self {
        let scene = Scene::new(samples).unwrap();
        let indices =
            (0..count).map(|i| if i < 3 { i * (grid.len() - 1) / 2 } else { rng.random_range(0..grid.len()) });
        let exact = |index| {
            let (azimuth, elevation) = grid.at(index);
            (index, direct::sum(&scene, &direction(azimuth, elevation)))
        };
        let sums = indices.map(exact).collect();
        Self { scene, grid, sums }
    }

    /// The largest error of the plan for these options, relative to `sum w |z|`.
    fn error(&self, planner: &mut Planner, options: &ProfileOptions) -> (f64, Explanation) {
        let plan = planner.plan_scene(&self.scene, &self.grid, options).unwrap();
        let values = planner.sums(&plan, &self.scene);
        let tilted = plan.explanation.skipped.iter().any(|s| s.contains("tilted plane"));
        let off = |(index, exact): &(usize, Complex64)| {
            // In the axes of a tilted plane the middle lies in that plane: another phase for each direction, no other change.
            let value = values[*index];
            if tilted { (value.norm() - exact.norm()).abs() } else { (value - exact).norm() }
        };
        (self.sums.iter().map(off).fold(0.0, f64::max) / self.scene.sum_abs, plan.explanation.clone())
    }
}

/// A scene of `n` packets within `radius` metres, turned out of the plane in every third case, on the axis of a line in some.
fn wide_scene(case: usize, n: usize, radius: f64, rng: &mut ChaCha8Rng) -> Samples {
    let mut points = track(case % 5, radius, n, rng);
    if case.is_multiple_of(3) {
        let turn = nalgebra::Rotation3::new(Vector3::new(rng.random(), rng.random(), rng.random()));
        points.iter_mut().for_each(|p| *p = turn * *p);
    }
    if case % 10 == 1 {
        points.iter_mut().for_each(|p| *p = Vector3::new(p.x, 0.0, 0.0));
    }
    samples(&points, &[(rng.random_range(-3.0..3.0), 0.2, Complex64::ONE)], 0.3, rng)
}

#[test]
fn the_promise_holds_from_one_packet_to_many_and_from_no_motion_to_five_metres_on_every_tier() {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    let mut used = std::collections::BTreeSet::new();
    for case in 0..56 {
        // Many packets take most of the time, and their cases are alike: twice each.
        let n = [1, 2, 3, 17, 300, 3_000, 30_000, 100_000][case % if case < 16 { 8 } else { 6 }];
        let radius = if case % 11 == 0 { 0.0 } else { 5.0 * 1e-4f64.powf(rng.random::<f64>()) };
        let samples = wide_scene(case, n, radius, &mut rng);
        let grid = if case % 2 == 0 { Grid::azimuth_elevation(48, 13) } else { Grid::azimuth(360) };
        let exact = Exact::new(&samples, grid, if n > 3_000 { 12 } else { 60 }, &mut rng);
        for tier in Tier::available() {
            let mut planner = Planner::new(tier);
            for eps in [1e-2, 1e-4, 1e-5, 1e-8, 1e-11] {
                let (worst, explanation) =
                    exact.error(&mut planner, &ProfileOptions { eps, ..ProfileOptions::default() });
                used.insert(format!("{:?}", explanation.method));
                assert!(worst <= eps, "{worst:.2e} case {case}, {n} packets, {radius} m, {explanation}");
            }
        }
    }
    assert!(used.len() >= 6, "only {used:?} were chosen");
}

/// Every path, not only the cheapest, from one packet to 100,000 and up to five metres.
#[test]
fn every_path_keeps_the_promise_at_every_size_on_every_tier() {
    let mut rng = ChaCha8Rng::seed_from_u64(26);
    let methods =
        [Method::Direct, Method::RingsDirect, Method::RingsNufft, Method::TargetsNufft, Method::Slab, Method::Cone];
    let mut used = std::collections::BTreeMap::<String, usize>::new();
    for (case, n) in [1, 3, 30, 1_000, 10_000, 100_000].into_iter().cycle().take(10).enumerate() {
        // Slabs of metres take seconds in a test build; apertures of few metres have the same code.
        let radius = if n > 1_000 { 1.0 } else { 5.0 } * 1e-3f64.powf(rng.random::<f64>());
        let samples = wide_scene(case, n, radius, &mut rng);
        let exact = Exact::new(&samples, Grid::azimuth_elevation(24, 7), if n > 1_000 { 6 } else { 40 }, &mut rng);
        for tier in Tier::available() {
            let mut planner = Planner::new(tier);
            for method in methods {
                for eps in [1e-4, 1e-10] {
                    let options = ProfileOptions { eps, method: Some(method), precision: None };
                    let (worst, explanation) = exact.error(&mut planner, &options);
                    *used.entry(format!("{:?}", explanation.method)).or_default() += 1;
                    assert!(worst <= eps, "{worst:.2e} case {case}, {n} packets, {radius} m, {explanation}");
                }
            }
        }
    }
    assert!(methods.iter().all(|m| used.contains_key(&format!("{m:?}"))), "{used:?}");
}

/// The floors that single precision is trusted with are what was measured, for direct sums with less than a factor of ten to spare: they
/// hold for few packets, where rounding errors cannot average out.
#[test]
fn floors_of_single_precision_are_measured() {
    let mut rng = ChaCha8Rng::seed_from_u64(27);
    for radius in [0.03, 0.3, 1.0, 5.0, 20.0] {
        for method in [Method::Direct, Method::RingsDirect, Method::RingsNufft] {
            let (mut worst, mut floor, mut planner) = (0f64, 0f64, Planner::default());
            for case in 0..20 {
                let points = track(2, radius, if method == Method::Direct { 1 } else { 4 } + case % 3, &mut rng);
                let samples = samples(&points, &[(1.0, 0.0, Complex64::ONE)], 0.01, &mut rng);
                let exact = Exact::new(&samples, Grid::azimuth(360), 60, &mut rng);
                let eps = 4e-6;
                let options = ProfileOptions { eps, method: Some(method), precision: Some(Precision::Single) };
                let (error, explanation) = exact.error(&mut planner, &options);
                if explanation.method == method {
                    worst = worst.max(error);
                    floor = crate::bartlett::cost::single_floor(method, TAU * exact.scene.radius);
                }
            }
            assert!(worst <= floor, "{method:?} {radius} m: {worst:.1e} above the floor {floor:.1e}");
            assert!(
                method != Method::Direct || worst > 0.1 * floor,
                "{method:?} {radius} m: {worst:.1e}, the floor of {floor:.1e} is no measurement"
            );
        }
    }
}

#[test]
fn a_line_takes_one_dimension_and_gives_both_mirrors() {
    let mut rng = ChaCha8Rng::seed_from_u64(28);
    for (n, along) in [(200, Vector3::x()), (6_000, Vector3::new(0.6, 0.8, 0.0)), (200, Vector3::new(0.48, 0.6, 0.64))]
    {
        let points: Vec<_> = (0..n).map(|t| along * (0.5 * (f64::from(t) / f64::from(n) - 0.5))).collect();
        let samples = samples(&points, &[(1.0, 0.2, Complex64::ONE)], 0.1, &mut rng);
        let grid = Grid::azimuth_elevation(72, 37);
        for eps in [1e-3, 1e-5, 1e-9, 1e-12] {
            let mut planner = Planner::default();
            let options = ProfileOptions { eps, method: Some(Method::Cone), precision: None };
            let exact = Exact::new(&samples, grid.clone(), 100, &mut rng);
            let (worst, explanation) = exact.error(&mut planner, &options);
            assert_eq!(explanation.method, Method::Cone);
            assert!(worst <= eps, "{worst:.2e}, {explanation}");
            assert!(explanation.to_string().contains("across the line"));
            // Level lines need no lower hemisphere.
            assert_eq!(explanation.evaluated < grid.len(), along.z == 0.0, "{explanation}");
            if along == Vector3::x() {
                let values = planner.profile(&samples, &grid, &options).unwrap().values;
                let row = &values[20 * 72..21 * 72];
                assert!((1..36).all(|j| (row[j] - row[72 - j]).abs() <= 2.0 * eps), "azimuth a and -a");
            }
        }
    }
}

#[test]
fn plans_are_reused_and_the_oracle_is_exact() {
    let mut rng = ChaCha8Rng::seed_from_u64(22);
    let mut planner = Planner::default();
    let grid = Grid::azimuth_elevation(72, 37);
    for turn in 0..5 {
        let points: Vec<_> = track(0, 0.3 - 1e-4 * f64::from(turn), 500, &mut rng);
        let samples = samples(&points, &[(1.0, 0.0, Complex64::ONE)], 0.1, &mut rng);
        planner.profile(&samples, &grid, &ProfileOptions::default()).unwrap();
    }
    assert!(planner.built() <= 2, "{} plans for one aperture", planner.built());
    let points = track(4, 0.3, 50, &mut rng);
    let samples = samples(&points, &[(1.0, 0.0, Complex64::ONE)], 0.1, &mut rng);
    let options = ProfileOptions { eps: 0.0, ..ProfileOptions::default() };
    let exact = planner.profile(&samples, &grid, &options).unwrap();
    let reference = oracle(&samples, &grid).unwrap();
    assert!(exact.values.iter().zip(&reference.values).all(|(a, b)| (a - b).abs() < 1e-15));
    let bad = ProfileOptions { eps: -1.0, ..options };
    assert!(matches!(planner.profile(&samples, &grid, &bad), Err(Error::Tolerance { .. })));
}

#[test]
fn explanations_say_what_was_left_out() {
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    let mut planner = Planner::default();
    let mut explain = |shape: usize, radius: f64, grid: &Grid| {
        let points = track(shape, radius, 1_000, &mut rng);
        let samples = samples(&points, &[(1.0, 0.0, Complex64::ONE)], 0.1, &mut rng);
        planner.explain(&samples, grid, &ProfileOptions::default()).unwrap()
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
