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
    let mut worst = 0f64;
    for i in 0..60 {
        // Corners, and anywhere.
        let index = if i < 3 { i * (grid.len() - 1) / 2 } else { rng.random_range(0..grid.len()) };
        let (azimuth, elevation) = grid.at(index);
        let exact = direct::sum(&scene, &direction(azimuth, elevation));
        worst = worst.max((sums[index] - exact).norm() / scene.sum_abs);
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
