//! The accuracy layer on one link of 900 packets in motion (1,550 in all), step by step, on every tier; ratios are against
//! the plain double-precision sum of the same search, taken on some of its places in the same run.
//!
//! `cargo bench --bench place`
#![allow(clippy::expect_used)]

mod common;

use common::{Table, banner, quickest};
use csi5300::bartlett::Tier;
use csi5300::internal::{
    Aperture, Band, CsiRow, Limits, Search, Searcher, Taper, View, align, one_way, remove_common_slope,
};
use csi5300::signal::channel::{INDICES_20_MHZ, SUBCARRIERS};
use csi5300::signal::samples::Samples;
use csi5300_sim::random::Stream;
use nalgebra::Vector3;
use num_complex::{Complex32, Complex64};
use std::f64::consts::TAU;

const WAVELENGTH_M: f64 = 0.0541;
const STANDING: usize = 650;
const MOVING: usize = 900;

/// Positions of all packets: at rest, then an arc of a metre.
fn path() -> Vec<Vector3<f64>> {
    let at = |k: usize| {
        let a = 2.6 * k.saturating_sub(STANDING) as f64 / MOVING as f64;
        Vector3::new(0.38 * a.cos(), 0.38 * a.sin(), 0.0)
    };
    (0..STANDING + MOVING).map(at).collect()
}

/// The square of two paths on every subcarrier, with a slope of its own in every packet, and noise.
fn rows(path: &[Vector3<f64>]) -> Vec<CsiRow> {
    let mut stream = Stream::of_seed(7);
    let mut random = move || stream.between(-0.5, 0.5) as f32;
    let ways = [(Vector3::new(3.8, 1.2, 0.4), 1.0f32), (Vector3::new(-1.0, 5.0, 0.4), 0.5)];
    let row = |p: &Vector3<f64>| -> CsiRow {
        let slope = 0.3 * random();
        std::array::from_fn(|k| {
            let index = f32::from(INDICES_20_MHZ[k]);
            let wave = |(at, size): &(Vector3<f64>, f32)| {
                let length_m = (p - at).norm();
                let turns = length_m / WAVELENGTH_M + length_m * 312_500.0 * f64::from(index) / 299_792_458.0;
                Complex32::from_polar(*size, (-TAU * turns.fract()) as f32)
            };
            let h: Complex32 = ways.iter().map(wave).sum();
            h * h * Complex32::cis(slope * index) + Complex32::new(random(), random())
        })
    };
    path.iter().map(row).collect()
}

fn main() {
    banner("One link, all steps");
    let (path, raw) = (path(), rows(&path()));
    let mut aligned = raw.clone();
    align(&mut aligned, &INDICES_20_MHZ, Tier::detect());
    remove_common_slope(&mut aligned, &INDICES_20_MHZ, Tier::detect());
    let steps_m = path[STANDING..].windows(2).map(|pair| (pair[1] - pair[0]).norm());
    let spacing = steps_m.sum::<f64>() / MOVING as f64 / WAVELENGTH_M;
    let roots = one_way(&aligned, spacing, Tier::detect()).rows;
    let round = Aperture::gather(&path[STANDING..], &aligned[STANDING..], 2, WAVELENGTH_M);
    let once = Aperture::gather(&path[STANDING..], &roots[STANDING..], 1, WAVELENGTH_M);
    let view = |windows, taper, subcarriers| View::new(windows, taper, Band::Subcarriers(subcarriers));
    let whole = [view(1, Taper::Hann, SUBCARRIERS)];
    let windows = [view(3, Taper::Hann, SUBCARRIERS), view(8, Taper::Block, SUBCARRIERS), view(6, Taper::Hann, 6)];
    let layers: [(&Aperture, &[View]); 2] = [(&round, &whole), (&once, &windows)];
    let middle = path[STANDING..].iter().sum::<Vector3<f64>>() / MOVING as f64;
    let mut table = Table::new("place", &[("tier", 10), ("step", 28), ("ms", 10), ("over oracle", 12)]);
    let mut row = |tier: &str, step: &str, ms: f64, ratio: Option<f64>| {
        let ratio = ratio.map_or("-".into(), |ratio| format!("{ratio:.0}"));
        table.row(&[tier.into(), step.into(), format!("{ms:.3}"), ratio]);
    };
    let place_ms = oracle_ms(&round, &middle) + oracle_ms(&once, &middle) * 3.5;
    for tier in Tier::available() {
        let name = format!("{tier:?}");
        let alignment = quickest(300.0, || {
            let mut own = raw.clone();
            align(&mut own, &INDICES_20_MHZ, tier);
            remove_common_slope(&mut own, &INDICES_20_MHZ, tier);
        });
        row(&name, "alignment, 1,550 packets", alignment, None);
        let root = quickest(300.0, || drop(one_way(&aligned, spacing, tier)));
        row(&name, "one-way channel", root, None);
        let limits = Limits::new(20f64.to_radians(), 1.8).with_tier(tier);
        let mut evaluations = 0;
        let searching = quickest(300.0, || {
            let mut search = Search::new(&layers, middle, WAVELENGTH_M, &limits).expect("a search");
            evaluations = search.run().expect("a place").evaluations;
        });
        row(&name, "search", searching, Some(place_ms * evaluations as f64 / searching));
        let mut search = Search::new(&layers, middle, WAVELENGTH_M, &limits).expect("a search");
        let best = search.run().expect("a place").sources[0];
        let paths = quickest(300.0, || drop(search.paths(&best)));
        row(&name, "paths", paths, None);
        row(&name, "everything", alignment + root + searching + paths, None);
        let samples = samples(&path, &aligned);
        let mut searcher = Searcher::new(tier);
        let lean = quickest(300.0, || {
            searcher.search(&samples, 0.0).expect("a bearing");
        });
        row(&name, "plane wave, azimuth only", lean, None);
    }
    table.save();
}

/// The samples at the channel centre, as a plane wave takes them.
fn samples(path: &[Vector3<f64>], rows: &[CsiRow]) -> Samples {
    let mut samples = Samples::new(WAVELENGTH_M, 2).expect("a wavelength");
    for (k, (p, row)) in path.iter().zip(rows).enumerate().skip(STANDING) {
        let h = row[14] + row[15];
        let h = Complex64::new(f64::from(h.re), f64::from(h.im));
        samples.push(0.01 * k as f64, h, *p, Vector3::zeros()).expect("finite samples");
    }
    samples
}

/// Time of the plain sum at one place: every packet, every subcarrier, in double.
fn oracle_ms(aperture: &Aperture, middle: &Vector3<f64>) -> f64 {
    let wave = TAU * f64::from(aperture.path_gain) / WAVELENGTH_M;
    let mut kept = 0.0;
    let ms = quickest(50.0, || {
        let place = middle + Vector3::new(3.0, 1.0 + kept * 1e-12, 0.3);
        let mut sums = [Complex64::default(); SUBCARRIERS];
        for (p, row) in aperture.displacement_m.iter().zip(&aperture.rows) {
            let turn = Complex64::cis(wave * (p - place).norm());
            for (sum, v) in sums.iter_mut().zip(row) {
                *sum += Complex64::new(f64::from(v.re), f64::from(v.im)) * turn;
            }
        }
        kept = sums.iter().map(Complex64::norm_sqr).sum();
    });
    assert!(kept > 0.0);
    ms
}
