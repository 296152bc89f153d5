//! The one-way channel out of the round trip: `h` from `h^2`, its sign kept by continuity.
//!
//! Forward and backward channel are the same but for the radios, so their product is the square of one channel. With
//! several paths the square also holds the product of each two of them, a wave at the mean of their directions
//! without a source. The square root has only the paths, each once (path gain 1), but its sign is open for every packet and
//! subcarrier.
//!
//! Signs are chosen so that the channel varies as little as it can: from packet to packet along each subcarrier, then
//! in sweeps against the mean of the neighbourhood in time and frequency until nothing changes any more. That is
//! reliable where the channel is strong; where it fades, the sign matters little, and samples count by their
//! magnitude. It needs a channel whose slope over the subcarriers and turn-around phase have been taken out first.
//!
//! Between packets that are far apart motion turns the channel by more than fading does, and what varies least is another
//! channel. So the turn that neighbouring packets have in common, half of the round trips', is taken out meanwhile. From a
//! quarter of a wavelength on nothing tells a turn by half a circle from a change of the sign: [`is_dense_enough`].

use crate::bartlett::Tier;
use crate::signal::alignment::CsiRow;
use crate::signal::alignment::planes::{Around, LANES, Lanes, Planes, lanes, planes_of, sum};
use crate::signal::channel::SUBCARRIERS;
use crate::tuning::TUNING;
use csi5300_kernels::simd::on_tier;
use fearless_simd::Simd;
use num_complex::Complex32;

/// What [`one_way`] gives.
#[derive(Clone, Debug, PartialEq)]
pub struct OneWay {
    /// The one-way channel, up to one common sign: path gain 1.
    pub rows: Vec<CsiRow>,
    /// How well its signs go together.
    pub signs: Signs,
}

/// How well the signs of a one-way channel go together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signs {
    /// Signs that the sweeps still changed after tracking, as a share of all samples, 0..1.
    pub corrected: f64,
    /// Share of the power whose sign disagrees with the packet before it on the same subcarrier: slips, 0..1.
    pub slips: f64,
    /// Coherence of neighbouring packets, 0..1.
    pub coherence: f64,
}

/// Takes the square root of `rows` (round trips, common slope removed, in the order of time, `spacing_wavelengths` apart), on
/// `tier`.
#[must_use]
pub fn one_way(rows: &[CsiRow], spacing_wavelengths: f64, tier: Tier) -> OneWay {
    let mut planes = planes_of(rows);
    let signs = take_roots(&mut planes, spacing_wavelengths, tier);
    OneWay { rows: planes.iter().map(Planes::row).collect(), signs }
}

/// Whether packets so far apart tell the signs of a one-way channel: motion towards the source by a quarter of a wavelength turns
/// it by a quarter of a circle, beyond which the other sign is nearer.
pub(crate) fn is_dense_enough(spacing_wavelengths: f64) -> bool {
    spacing_wavelengths < 0.25
}

/// [`one_way`] in place.
pub(crate) fn take_roots(rows: &mut [Planes], spacing_wavelengths: f64, tier: Tier) -> Signs {
    on_tier!(tier.level_or_portable(), simd => roots_of(simd, rows, turn_reach(spacing_wavelengths)))
}

/// Steps on either side over which the turn of packets so far apart is averaged; `None` where it is not taken out.
fn turn_reach(spacing_wavelengths: f64) -> Option<usize> {
    let reach = TUNING.one_way.turn_reach_wavelengths / spacing_wavelengths;
    (spacing_wavelengths > TUNING.one_way.sparse_wavelengths).then_some(reach.round() as usize)
}

#[inline(always)]
fn roots_of<S: Simd>(_simd: S, roots: &mut [Planes], turn_reach: Option<usize>) -> Signs {
    let turned_rad = turn_reach.map_or_else(Vec::new, |reach| turns_rad(roots, reach));
    roots.iter_mut().zip(&turned_rad).for_each(|(row, turned)| row.turn(-2.0 * turned));
    roots.iter_mut().for_each(root);
    track(roots);
    let mut corrected = 0;
    for _ in 0..TUNING.one_way.sweeps {
        let changed = sweep(roots);
        corrected += changed;
        if changed == 0 {
            break;
        }
    }
    let (mut aligned, mut slipped, mut full) = (Planes::ZERO, [0.0; LANES], [0.0; LANES]);
    for pair in roots.windows(2) {
        let product = pair[1].against(&pair[0]);
        let sizes = product.sizes();
        aligned.add(&product);
        for k in 0..LANES {
            full[k] += sizes[k];
            slipped[k] += if product.re[k] < 0.0 { sizes[k] } else { 0.0 };
        }
    }
    roots.iter_mut().zip(&turned_rad).for_each(|(row, turned)| row.turn(*turned));
    let full = sum(&full);
    let share = |part: f32| if full > 0.0 { f64::from(part / full) } else { 0.0 };
    let samples = (roots.len() * SUBCARRIERS).max(1) as f64;
    Signs { corrected: corrected as f64 / samples, slips: share(sum(&slipped)), coherence: share(aligned.sum().norm()) }
}

/// How far motion has turned the one-way channel at each row since the first, radians: half of what the round trips have turned
/// from row to row, averaged over so many steps on either side. (Averaged over few it would follow a channel through its fades,
/// whose turn is the sign that is looked for, and noise.)
#[inline(always)]
fn turns_rad(rows: &[Planes], reach: usize) -> Vec<f64> {
    let steps: Vec<Complex32> = rows.windows(2).map(|pair| pair[1].against(&pair[0]).sum()).collect();
    let mut turned = vec![0.0; rows.len()];
    let mut total = 0.0;
    for (step, turned) in turned.iter_mut().skip(1).enumerate() {
        let about = step.saturating_sub(reach)..(step + reach + 1).min(steps.len());
        total += 0.5 * f64::from(steps[about].iter().sum::<Complex32>().arg());
        *turned = total;
    }
    turned
}

/// The square root with a positive real part, without the polar form.
#[inline(always)]
fn root(value: &mut Planes) {
    let sizes = value.sizes();
    for (k, size) in sizes.into_iter().enumerate() {
        let (re, im) = (value.re[k], value.im[k]);
        let large = (0.5 * (size + re.abs())).sqrt();
        let small = if large > 0.0 { 0.5 * im.abs() / large } else { 0.0 };
        value.re[k] = if re >= 0.0 { large } else { small };
        value.im[k] = (if re >= 0.0 { small } else { large }).copysign(im);
    }
}

/// The first packet by continuity over the subcarriers, every other by a prediction from those before it.
#[inline(always)]
fn track(roots: &mut [Planes]) {
    let Some((first, others)) = roots.split_first_mut() else { return };
    for k in 1..SUBCARRIERS {
        let before = |plane: &Lanes| plane[k.saturating_sub(3)..k].iter().sum::<f32>();
        if first.re[k] * before(&first.re) + first.im[k] * before(&first.im) < 0.0 {
            (first.re[k], first.im[k]) = (-first.re[k], -first.im[k]);
        }
    }
    let memory = TUNING.one_way.memory;
    let mut predicted = *first;
    for row in others {
        flip(row, &predicted);
        for k in 0..LANES {
            predicted.re[k] = predicted.re[k] * memory + row.re[k];
            predicted.im[k] = predicted.im[k] * memory + row.im[k];
        }
    }
}

/// Turns every place of `row` into the half plane of `expected`; returns how many changed their sign.
#[inline(always)]
fn flip(row: &mut Planes, expected: &Planes) -> usize {
    let mut changed = 0u32;
    for k in 0..LANES {
        let against = row.re[k] * expected.re[k] + row.im[k] * expected.im[k] < 0.0;
        row.re[k] = if against { -row.re[k] } else { row.re[k] };
        row.im[k] = if against { -row.im[k] } else { row.im[k] };
        changed += u32::from(against);
    }
    changed as usize
}

/// Compares every sample with the sum of its neighbours in time and on the subcarriers beside it. Returns how many
/// signs changed.
#[inline(always)]
fn sweep(roots: &mut [Planes]) -> usize {
    let mut changed = 0;
    Around::first(roots, TUNING.one_way.reach).along(
        roots,
        &[],
        #[inline(always)]
        |_, row, sum| {
            let around = Planes { re: beside(&sum.re, &row.re), im: beside(&sum.im, &row.im) };
            changed += flip(row, &around);
        },
    );
    changed
}

/// At each place the sum over it and the two beside it, less its own value.
#[inline(always)]
fn beside(sum: &Lanes, own: &Lanes) -> Lanes {
    let mut wide = [0.0; LANES + 2];
    wide[1..=LANES].copy_from_slice(sum);
    lanes(|k| wide[k] + wide[k + 1] + wide[k + 2] - own[k])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_paths_come_back_out_of_their_square() {
        let channel = |t: usize, k: usize| {
            let (t, k) = (t as f32, k as f32);
            Complex32::cis(0.11 * t) + Complex32::from_polar(0.6, 1.0 - 0.09 * t + 0.05 * k)
        };
        let truth: Vec<CsiRow> = (0..600).map(|t| std::array::from_fn(|k| channel(t, k))).collect();
        let squared: Vec<CsiRow> = truth.iter().map(|row| row.map(|v| v * v)).collect();
        let found = one_way(&squared, 0.0, Tier::detect());
        let product: Complex32 =
            truth.iter().flatten().zip(found.rows.iter().flatten()).map(|(a, b)| a * b.conj()).sum();
        let power: f32 = truth.iter().flatten().map(Complex32::norm_sqr).sum();
        assert!(product.norm() / power > 0.999, "{}", product.norm() / power);
        assert!(found.signs.slips < 1e-3 && found.signs.coherence > 0.98, "{:?}", found.signs);
    }

    /// Two paths, the stronger of which turns by up to 1.3 radians from packet to packet: faster and slower, and back.
    #[test]
    fn a_channel_that_motion_turns_far_from_packet_to_packet_comes_back_too() {
        let turned = |t: usize| 60.0 * 1.3 * (t as f32 / 60.0).sin();
        let channel = |t: usize, k: usize| {
            let beside = 0.7 + 0.2 * turned(t) + 0.05 * k as f32;
            Complex32::cis(turned(t)) + Complex32::from_polar(0.4, beside)
        };
        let truth: Vec<CsiRow> = (0..600).map(|t| std::array::from_fn(|k| channel(t, k))).collect();
        let squared: Vec<CsiRow> = truth.iter().map(|row| row.map(|v| v * v)).collect();
        let likeness = |spacing_wavelengths: f64| {
            let found = one_way(&squared, spacing_wavelengths, Tier::detect());
            let product: Complex32 =
                truth.iter().flatten().zip(found.rows.iter().flatten()).map(|(a, b)| a * b.conj()).sum();
            product.norm() / truth.iter().flatten().map(Complex32::norm_sqr).sum::<f32>()
        };
        let (sparse, taken_for_dense) = (likeness(0.2), likeness(0.0));
        assert!(sparse > 0.999 && taken_for_dense < 0.5, "{sparse} {taken_for_dense}");
        assert!(is_dense_enough(0.2) && !is_dense_enough(0.25) && !is_dense_enough(f64::NAN));
    }

    #[test]
    fn roots_are_those_of_the_polar_form() {
        for k in 0..64 {
            let value = Complex32::from_polar(0.1 + 0.3 * k as f32, 0.1 * k as f32 - 3.1);
            let mut planes = Planes { re: [value.re; LANES], im: [value.im; LANES] };
            root(&mut planes);
            assert!((planes.row()[5] - value.sqrt()).norm() < 1e-5, "{value}");
        }
        let mut silent = Planes::ZERO;
        root(&mut silent);
        assert_eq!(silent, Planes::ZERO);
    }

    #[test]
    fn random_phases_are_seen_as_slips() {
        let mut state = 3u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u32 << 24) as f32
        };
        let rows: Vec<CsiRow> =
            (0..300).map(|_| std::array::from_fn(|_| Complex32::cis(std::f32::consts::TAU * random()))).collect();
        assert!(one_way(&rows, 0.0, Tier::detect()).signs.coherence < 0.8);
        assert!(one_way(&rows, 0.0, Tier::detect()).signs.slips > 0.05);
        assert!(one_way(&[], 0.0, Tier::detect()).rows.is_empty());
    }
}
