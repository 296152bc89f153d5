//! Many pairs of frames at once: [`round_trip_at_centre`](super::round_trip_at_centre), a SIMD lane for each pair.

use crate::signal::channel::SUBCARRIERS;
use csi5300_kernels::simd::{Tier, V, on_tier, sin_cos_turns, turns_of};
use driver_iface::bfee::Iq;
use fearless_simd::{Select, Simd, SimdBase, SimdFloat};
use num_complex::Complex64;

/// What one antenna heard of a frame.
pub(crate) type Heard = [Iq; SUBCARRIERS];

/// The round trip of each pair (forward, backward) at the channel centre, on `tier`; `None` of a pair of which one frame is
/// all zero.
pub(crate) fn round_trips_at_centre(
    pairs: &[[&Heard; 2]],
    indices: &[i8; SUBCARRIERS],
    tier: Tier,
) -> Vec<Option<Complex64>> {
    let mut found = Vec::with_capacity(pairs.len());
    on_tier!(tier.level_or_portable(), simd => centres(simd, pairs, indices, &mut found));
    found
}

/// One direction of a vector of pairs on one subcarrier, real and imaginary.
type Lane<S> = (V<S, f32>, V<S, f32>);

/// One direction of a vector of pairs on subcarrier `k`; lanes beyond them are zero.
#[inline(always)]
fn load<S: Simd>(simd: S, pairs: &[[&Heard; 2]], side: usize, k: usize) -> Lane<S> {
    let iq = |lane: usize| pairs.get(lane).map_or_else(Iq::default, |pair| pair[side][k]);
    let part = |lane: usize| f32::from(iq(lane).i);
    (V::<S, f32>::from_fn(simd, part), V::<S, f32>::from_fn(simd, |lane| f32::from(iq(lane).q)))
}

#[inline(always)]
fn centres<S: Simd>(simd: S, pairs: &[[&Heard; 2]], indices: &[i8; SUBCARRIERS], found: &mut Vec<Option<Complex64>>) {
    let zero = V::<S, f32>::splat(simd, 0.0);
    let usual = indices[1] - indices[0];
    for pairs in pairs.chunks(V::<S, f32>::LEN) {
        // Phase steps of the usual width, and the product of the directions: integers that single precision holds.
        let mut steps = [(zero, zero); 2];
        let mut before = [(zero, zero); 2];
        let mut products = [(zero, zero); SUBCARRIERS];
        for k in 0..SUBCARRIERS {
            let now = [load(simd, pairs, 0, k), load(simd, pairs, 1, k)];
            let (a, b) = (now[0], now[1]);
            products[k] = (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
            if k > 0 && indices[k] - indices[k - 1] == usual {
                for ((re, im), ((x, y), (u, v))) in steps.iter_mut().zip(now.into_iter().zip(before)) {
                    *re += x * u + y * v;
                    *im += y * u - x * v;
                }
            }
            before = now;
        }
        let [forward, backward] = steps.map(|(re, im)| turns_of(simd, re, im));
        let slope = (forward + backward) * V::<S, f32>::splat(simd, 1.0 / f32::from(usual));
        let (re, im, power) = line(simd, &products, indices, slope);
        found.extend((0..pairs.len()).map(|lane| {
            let h = Complex64::new(f64::from(re[lane]), f64::from(im[lane]));
            (power[lane] > 0.0).then_some(h)
        }));
    }
}

/// Least squares through the unwrapped phases of `products`, whose slope is about `slope` turns per index: the value at
/// index 0 of unit magnitude times the root mean square, and the power. A product of zero has no phase and no part in it.
#[inline(always)]
fn line<S: Simd>(
    simd: S,
    products: &[Lane<S>; SUBCARRIERS],
    indices: &[i8; SUBCARRIERS],
    slope: V<S, f32>,
) -> (V<S, f32>, V<S, f32>, V<S, f32>) {
    let splat = |value: f32| V::<S, f32>::splat(simd, value);
    let (zero, one) = (splat(0.0), splat(1.0));
    let [mut n, mut sum_x, mut sum_xx, mut sum, mut sum_xy, mut power, mut last] = [zero; 7];
    for ((re, im), index) in products.iter().zip(indices) {
        let x = splat(f32::from(*index));
        let own = *re * *re + *im * *im;
        let turns = turns_of(simd, *re, *im) - slope * x;
        let step = turns - last;
        let (is_heard, is_first) = (own.simd_gt(zero), n.simd_le(zero));
        let unwrapped = is_first.select(turns, last + (step - step.round_ties_even()));
        last = is_heard.select(unwrapped, last);
        let weight = is_heard.select(one, zero);
        power += own;
        n += weight;
        sum_x += weight * x;
        sum_xx += weight * x * x;
        sum += weight * last;
        sum_xy += weight * last * x;
    }
    // Of a single subcarrier the line has no slope of its own: its spread is 0, and so is what is divided by it.
    let rest = (sum_xy * n - sum * sum_x) / (n * sum_xx - sum_x * sum_x).max(one);
    let (sin, cos) = sin_cos_turns::<S, f32>(simd, (sum - rest * sum_x) / n.max(one));
    let size = (power * splat(1.0 / SUBCARRIERS as f32)).sqrt();
    (cos * size, sin * size, power)
}

#[cfg(test)]
mod tests {
    use super::super::round_trip_at_centre;
    use super::*;
    use crate::signal::channel::INDICES_20_MHZ;
    use num_complex::Complex32;

    #[test]
    fn angles_are_those_of_the_library() {
        fn all<S: Simd>(simd: S, points: &[Complex32]) -> Vec<f32> {
            let lane = |z: &Complex32| {
                let part = |value: f32| V::<S, f32>::splat(simd, value);
                turns_of(simd, part(z.re), part(z.im))[0]
            };
            points.iter().map(lane).collect()
        }
        let around = (0..4_000).map(|k| Complex32::from_polar(1.0 + k as f32, k as f32 * 0.001_571 - 3.1));
        let axes = [
            (0.0, 0.0),
            (1.0, 0.0),
            (0.0, 3.0),
            (0.0, -2.0),
            (-7.0, 0.0),
            (5.0, 5.0),
            (-5.0, 5.0),
            (-0.0, 0.0),
            (-0.0, -0.0),
        ];
        let points: Vec<Complex32> = around.chain(axes.map(|(re, im)| Complex32::new(re, im))).collect();
        for tier in Tier::available() {
            let found = on_tier!(tier.level_or_portable(), simd => all(simd, &points));
            for (z, turns) in points.iter().zip(found) {
                let expected = f64::from(z.im).atan2(f64::from(z.re)) / std::f64::consts::TAU;
                assert!((f64::from(turns) - expected).abs() < 1e-7, "{tier:?} {z} {turns} {expected}");
            }
        }
    }

    #[test]
    fn every_tier_gives_what_one_pair_at_a_time_gives() {
        let mut state = 5u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u32 << 24) as f32 - 0.5
        };
        // A wave with a slope and noise, quantised as the card does; every seventh is silent, and of every fifth some
        // subcarriers are, the first among them.
        let mut heard = |k: usize| -> Heard {
            let (phase, slope) = (6.0 * random(), 1.5 * random());
            std::array::from_fn(|s| {
                let noise = Complex32::new(random(), random()) * 12.0;
                let wave = Complex32::from_polar(50.0, phase + slope * f32::from(INDICES_20_MHZ[s])) + noise;
                let is_silent = k % 7 == 3 || k % 5 == 1 && s % 4 == 0;
                if is_silent { Iq::default() } else { Iq { i: wave.re as i8, q: wave.im as i8 } }
            })
        };
        let frames: Vec<[Heard; 2]> = (0..203).map(|k| [heard(k), heard(k / 2)]).collect();
        let pairs: Vec<[&Heard; 2]> = frames.iter().map(|[forward, backward]| [forward, backward]).collect();
        let csi = |heard: &Heard| heard.map(|iq| Complex32::new(f32::from(iq.i), f32::from(iq.q)));
        let expected: Vec<Option<Complex64>> = frames
            .iter()
            .map(|[forward, backward]| round_trip_at_centre(&csi(forward), &csi(backward), &INDICES_20_MHZ))
            .map(|found| found.map(|coherent| coherent.h))
            .collect();
        assert!(expected.iter().flatten().count() > 100 && expected.iter().any(Option::is_none));
        for tier in Tier::available() {
            let found = round_trips_at_centre(&pairs, &INDICES_20_MHZ, tier);
            assert_eq!(found.len(), expected.len());
            for (found, expected) in found.iter().zip(&expected) {
                match (found, expected) {
                    (Some(found), Some(expected)) => {
                        assert!((found - expected).norm() < 2e-5 * expected.norm(), "{tier:?} {found} {expected}");
                    }
                    _ => assert_eq!(found, expected),
                }
            }
        }
    }
}
