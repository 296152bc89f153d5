//! Several subcarriers at the same positions: one spreading for all, one transform each.

use std::f64::consts::TAU;

use num_complex::{Complex, Complex64};

use super::bessel::tail_order;
use super::error::Error;
use super::evaluate::Places;
use super::fft::Ffts;
use super::grid::{Grid, Layout, Profile};
use super::nufft::{CARRY, Nufft, Setting, Work};
use super::plan::{Planner, ProfileOptions};
use super::rings::{RingWork, Rings};
use super::scene::{Scene, ldexp};
use super::simd::{Real, Tier};
use crate::signal::samples::Samples;

/// The samples of one subcarrier.
#[derive(Clone, Debug, PartialEq)]
pub struct Subcarrier {
    /// Its wavelength, metres.
    pub wavelength_m: f64,
    /// One value per position.
    pub z: Vec<Complex64>,
}

/// The sum of the subcarriers' profiles, `sum_k F_k / sum_k (sum_t w_t |z_kt|)^2`, each under the guarantee of `eps` (at
/// least 1e-12; 0 and a motion out of the plane, or a grid without rings in quarters, go through a [`Planner`] one by
/// one). Positions and weights come from `samples`, whose own values are not used.
///
/// In the plane the subcarriers share the kernel weights of their spreading: wavelengths differ by a fraction, and only
/// shorten the direction cosines.
///
/// # Errors
/// As [`Planner::profile`]; [`Error::Lengths`] for a subcarrier of another length than the positions, [`Error::Empty`] for
/// no subcarrier.
pub fn subcarrier_profile(
    samples: &Samples,
    subcarriers: &[Subcarrier],
    grid: &Grid,
    eps: f64,
    tier: Tier,
) -> Result<Profile, Error> {
    let one = |s: &Subcarrier| Samples { z: s.z.clone(), ..samples.clone() };
    let shortest = subcarriers.iter().map(|s| s.wavelength_m).fold(f64::INFINITY, f64::min);
    let mut scenes = Vec::with_capacity(subcarriers.len());
    for s in subcarriers {
        scenes.push(Scene::new(&one(s), s.wavelength_m)?);
    }
    let Some(first) = subcarriers.iter().position(|s| s.wavelength_m == shortest) else { return Err(Error::Empty) };
    let sums: Vec<f64> = scenes.iter().map(|s| ldexp(s.sum_abs, -s.exponent)).collect();
    let full = sums.iter().map(|s| s * s).sum::<f64>();
    let shares: Vec<f64> = sums.iter().map(|s| s * s / full).collect();
    let mut values = vec![0.0; grid.len()];
    let ratio = |k: usize| shortest / subcarriers[k].wavelength_m;
    let single = Setting::for_eps(eps / 4.0, true).filter(|_| eps >= 1e-5 && samples.len() <= CARRY);
    let double = Setting::for_eps(eps / 4.0, false);
    let shared = match (&*grid.layout, scenes[first].half_height * grid.steepest * TAU <= eps / 8.0) {
        (Layout::Rings { azimuths, .. }, true) if azimuths % 4 == 0 => single.or(double),
        _ => None,
    };
    match shared {
        Some(setting) if single.is_some() => {
            together::<f32>(&scenes, first, &ratio, &shares, grid, eps, setting, tier, &mut values);
        }
        Some(setting) => together::<f64>(&scenes, first, &ratio, &shares, grid, eps, setting, tier, &mut values),
        None => {
            let mut planner = Planner::new(tier);
            let options = ProfileOptions { eps, ..ProfileOptions::default() };
            for (s, share) in subcarriers.iter().zip(&shares) {
                let profile = planner.profile(&one(s), s.wavelength_m, grid, &options)?;
                values.iter_mut().zip(&profile.values).for_each(|(v, p)| *v += share * p);
            }
        }
    }
    Ok(Profile { grid: grid.clone(), values, sum_abs: full.sqrt() })
}

/// Level motion over rings: one spreading, and one transform per subcarrier.
#[allow(clippy::too_many_arguments)]
fn together<T: Real>(
    scenes: &[Scene],
    first: usize,
    ratio: &impl Fn(usize) -> f64,
    shares: &[f64],
    grid: &Grid,
    eps: f64,
    setting: Setting,
    tier: Tier,
    values: &mut [f64],
) {
    let Layout::Rings { azimuths, elevations_rad } = &*grid.layout else { return };
    let scene = &scenes[first];
    let mut ffts = Ffts::<T>::new(tier);
    let order = tail_order(TAU * scene.radius, eps / 8.0);
    let rings = Rings::new(*azimuths, elevations_rad, [order; 2], false, tier.level_or_portable(), &mut ffts);
    let places = Places::Rings { d: rings.d, nodes: rings.nodes.clone(), tall: false };
    let reach = |c: &[f64]| c.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    let nufft = Nufft::new([reach(&scene.x), reach(&scene.y)], setting, &mut ffts);
    let zero = Complex::new(T::of(0.0), T::of(0.0));
    let mut cells = vec![zero; nufft.cells() * scenes.len()];
    let column = |part: fn(&Scene) -> &[f64]| -> Vec<T> {
        scenes.iter().flat_map(|s| part(s).iter().map(|v| T::of(*v))).collect()
    };
    nufft.spread([&scene.x, &scene.y], &column(|s| &s.re), &column(|s| &s.im), &mut cells);
    let (mut work, mut ring_work) = (Work::default(), RingWork::default());
    let (mut found, mut sorted, mut row) = (Vec::new(), Vec::new(), vec![0.0; values.len()]);
    for (k, (scene, cells)) in scenes.iter().zip(cells.chunks_exact(nufft.cells())).enumerate() {
        nufft.transform(cells, &mut work);
        nufft.interpolate(&work.plane, &places.targets(&nufft, ratio(k)), &mut found);
        places.sort(&mut found, &mut sorted);
        rings.powers(&sorted, shares[k] / (scene.sum_abs * scene.sum_abs), &mut ring_work, &mut row);
        values.iter_mut().zip(&row).for_each(|(v, p)| *v += p);
    }
}
