//! Sampling-time offset: the part of it that the round-trip product leaves, taken out packet by packet.
//!
//! Both cards start sampling a little early or late in each frame, which turns the phase of a product by
//! `slope * subcarrier index` (measured: 0.05 to 0.12 rad per index from packet to packet, so a turn at the edges of
//! the band). The mean slope belongs to the path and the radios and is left; what changes from one packet to
//! the next cannot be motion, which turns the slope by 2 pi per 153 m. So each packet is turned to the slope of its
//! neighbours, about index 0, where the slope does nothing: the phase at the channel centre is left as it is.

pub(crate) mod planes;

use crate::bartlett::Tier;
use crate::signal::channel::SUBCARRIERS;
use crate::tuning::TUNING;
use csi5300_kernels::simd::{V, on_tier, sin_cos_turns};
use fearless_simd::{Level, Simd, SimdBase};
use num_complex::Complex32;
use planes::{Around, LANES, Lanes, Planes, lanes, planes_of, settle, sum};

/// One channel sample on every reported subcarrier, in the order of the subcarrier indices.
pub type CsiRow = [Complex32; SUBCARRIERS];

/// What [`align`] found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Alignment {
    /// Standard deviation of the slopes that were taken out, radians per subcarrier index.
    pub slope_sd_rad: f64,
    /// Coherence of each packet with its neighbours over all subcarriers, before, 0..1.
    pub coherence_before: f64,
    /// The same afterwards.
    pub coherence_after: f64,
}

/// Takes the slope that all rows have in common out of each: neighbouring subcarriers then differ by the channel only.
pub fn remove_common_slope(rows: &mut [CsiRow], indices: &[i8; SUBCARRIERS], tier: Tier) {
    let mut planes = planes_of(rows);
    remove_slope(&mut planes, indices, tier);
    rows.iter_mut().zip(&planes).for_each(|(row, planes)| *row = planes.row());
}

/// [`remove_common_slope`] of planes.
pub(crate) fn remove_slope(rows: &mut [Planes], indices: &[i8; SUBCARRIERS], tier: Tier) {
    on_tier!(tier.level_or_portable(), _simd => remove_slope_simd(rows, indices));
}

#[inline(always)]
fn remove_slope_simd(rows: &mut [Planes], indices: &[i8; SUBCARRIERS]) {
    let step = indices[1] - indices[0];
    let neighbours = lanes(|k| f32::from((1..SUBCARRIERS).contains(&k) && indices[k] - indices[k - 1] == step));
    let turn = neighbour_products(rows, &neighbours);
    let turns = Planes::of(&turns(indices, turn.arg() / f32::from(step)));
    rows.iter_mut().for_each(|row| *row = row.times(&turns));
}

/// `sum v[k] conj(v[k-1])` over all rows and the subcarriers where `neighbours` is 1.
#[inline(always)]
fn neighbour_products(rows: &[Planes], neighbours: &Lanes) -> Complex32 {
    let mut sums = Planes::ZERO;
    for row in rows {
        let mut before = Planes::ZERO;
        before.re[1..].copy_from_slice(&row.re[..LANES - 1]);
        before.im[1..].copy_from_slice(&row.im[..LANES - 1]);
        sums.add(&row.against(&before));
    }
    let chosen = |part: &Lanes| sum(&lanes(|k| part[k] * neighbours[k]));
    Complex32::new(chosen(&sums.re), chosen(&sums.im))
}

/// `exp(-j slope index[k])`.
fn turns(indices: &[i8; SUBCARRIERS], slope: f32) -> CsiRow {
    indices.map(|index| Complex32::cis(-slope * f32::from(index)))
}

/// The subcarrier indices, and what is made of them once.
struct Comb {
    index: Lanes,
    square: Lanes,
    /// `exp(-j slope index)` of every slope tried, subcarrier by subcarrier, a place for each slope.
    tried: Vec<Planes>,
}

/// How many slopes are tried: as many as there are places for.
fn number_tried() -> usize {
    TUNING.alignment.tried.min(LANES)
}

/// The slope at place `k` of those tried.
fn tried(k: usize) -> f32 {
    TUNING.alignment.tried_step * (k as f32 - (number_tried() / 2) as f32)
}

impl Comb {
    fn new(indices: &[i8; SUBCARRIERS]) -> Self {
        let index = lanes(|k| indices.get(k).map_or(0.0, |index| f32::from(*index)));
        let turns = |index: &i8| {
            let turn = |k: usize| Complex32::cis(-tried(k) * f32::from(*index));
            Planes { re: lanes(|k| turn(k).re), im: lanes(|k| turn(k).im) }
        };
        Self { index, square: lanes(|k| index[k] * index[k]), tried: indices.iter().map(turns).collect() }
    }

    /// `exp(-j slope index)`.
    #[inline(always)]
    fn turns<S: Simd>(&self, simd: S, slope: f32) -> Planes {
        let mut turns = Planes::ZERO;
        let wide = V::<S, f32>::LEN;
        let per_index = V::<S, f32>::splat(simd, -slope / std::f32::consts::TAU);
        let places = turns.re.chunks_exact_mut(wide).zip(turns.im.chunks_exact_mut(wide));
        for ((re, im), index) in places.zip(self.index.chunks_exact(wide)) {
            let (sin, cos) = sin_cos_turns::<S, f32>(simd, V::<S, f32>::from_slice(simd, index) * per_index);
            cos.store_slice(re);
            sin.store_slice(im);
        }
        turns
    }

    /// The best of the slopes tried.
    #[inline(always)]
    fn best_tried(&self, row: &Planes) -> f32 {
        let mut sums = Planes::ZERO;
        for (k, turns) in self.tried.iter().enumerate() {
            let (re, im) = (row.re[k], row.im[k]);
            for place in 0..LANES {
                sums.re[place] += re * turns.re[place] - im * turns.im[place];
                sums.im[place] += re * turns.im[place] + im * turns.re[place];
            }
        }
        let (mut best, mut most) = (number_tried() / 2, f32::MIN);
        for k in 0..number_tried() {
            let power = sums.re[k] * sums.re[k] + sums.im[k] * sums.im[k];
            (best, most) = if power > most { (k, power) } else { (best, most) };
        }
        tried(best)
    }

    /// The slope at which `|sum row[k] exp(-j slope index[k])|` is largest: Newton's method from `slope`.
    #[inline(always)]
    fn climb<S: Simd>(&self, simd: S, row: &Planes, mut slope: f32) -> f32 {
        for _ in 0..TUNING.alignment.steps {
            let turned = row.times(&self.turns(simd, slope));
            let (b, b1, b2) = (turned.sum(), turned.moment(&self.index), turned.moment(&self.square));
            // |B|^2 has the derivatives 2 Im(conj(B) B1) and 2 (|B1|^2 - Re(conj(B) B2)).
            let first = (b.conj() * b1).im;
            let second = b1.norm_sqr() - (b.conj() * b2).re;
            if !(second < 0.0 && first.is_finite()) {
                break;
            }
            slope += (-first / second).clamp(-0.03, 0.03);
        }
        slope
    }
}

/// `|sum_k v conj(m)| / sum_k |v||m|` of each packet, `m` the sum of the neighbours.
#[inline(always)]
fn coherences(part: Part<'_>) -> Vec<f64> {
    let mut found = vec![0.0; part.rows.len()];
    part.around.along(
        part.rows,
        part.behind,
        #[inline(always)]
        |k, row, around| {
            let mut others = *around;
            others.take(row);
            let product = row.against(&others);
            let full = sum(&product.sizes());
            if full > 0.0 {
                found[k] = f64::from(product.sum().norm() / full);
            }
        },
    );
    found
}

/// One round: each packet is turned to the sum of its neighbours as they were before it. (Packets that were already
/// turned must not lead those that were not: the slope would wander off along the record, while the mean over
/// neighbours as recorded keeps to what the cards have in common.) Gives the slopes that were taken out.
#[inline(always)]
fn round<S: Simd>(simd: S, part: Part<'_>, comb: &Comb, first: bool) -> Vec<f32> {
    let mut slopes = vec![0.0; part.rows.len()];
    part.around.along(
        part.rows,
        part.behind,
        #[inline(always)]
        |k, row, around| {
            let mut others = *around;
            others.take(row);
            let against = row.against(&others);
            let from = if first { comb.best_tried(&against) } else { 0.0 };
            let slope = comb.climb(simd, &against, from);
            if slope.is_finite() {
                *row = row.times(&comb.turns(simd, slope));
                slopes[k] = slope;
            }
        },
    );
    slopes
}

/// Some rows in a run, with what their sums over neighbours need of the others.
struct Part<'a> {
    rows: &'a mut [Planes],
    around: Around,
    behind: &'a [Planes],
}

/// What `own` gives for all `rows`; if `parallel`, of both halves side by side on the threads of the current rayon pool, to the
/// same numbers.
fn by_parts<T: Send>(
    rows: &mut [Planes],
    level: Level,
    parallel: bool,
    own: impl Fn(Part<'_>) -> Vec<T> + Sync,
) -> Vec<T> {
    let reach = TUNING.alignment.reach;
    let around = Around::first(rows, reach);
    if !parallel {
        return own(Part { rows, around, behind: &[] });
    }
    let middle = rows.len() / 2;
    let (later, behind) = on_tier!(level, _simd => Around::parted(rows, reach, middle));
    let (front, back) = rows.split_at_mut(middle);
    let (mut first, second) = rayon::join(
        || own(Part { rows: front, around, behind: &behind }),
        || own(Part { rows: back, around: later, behind: &[] }),
    );
    first.extend(second);
    first
}

/// Aligns `rows`, one per packet in the order of time, in place, on `tier`.
///
/// Rows should be of like magnitude. With fewer than three rows nothing is done.
pub fn align(rows: &mut [CsiRow], indices: &[i8; SUBCARRIERS], tier: Tier) -> Alignment {
    let mut planes = planes_of(rows);
    let found = align_planes(&mut planes, indices, tier, false);
    rows.iter_mut().zip(&planes).for_each(|(row, planes)| *row = planes.row());
    found
}

/// [`align`] of planes; if `parallel`, on all threads of the current rayon pool.
pub(crate) fn align_planes(rows: &mut [Planes], indices: &[i8; SUBCARRIERS], tier: Tier, parallel: bool) -> Alignment {
    if rows.len() < 3 {
        return Alignment::default();
    }
    let (level, comb) = (tier.level_or_portable(), Comb::new(indices));
    let in_middle = |k: usize| indices.get(k).is_some_and(|index| f32::from(index.abs()) <= TUNING.alignment.middle);
    let middle = lanes(|k| f32::from(in_middle(k)));
    let mut turned = vec![0.0; rows.len()];
    // While slopes differ, only the middle of the band gives packets' phases.
    on_tier!(level, _simd => settle(rows, &middle, &mut turned));
    let count = rows.len() as f64;
    let coherence = |rows: &mut [Planes]| {
        let each = by_parts(rows, level, parallel, |part| on_tier!(level, _simd => coherences(part)));
        each.iter().sum::<f64>() / count
    };
    let mut slopes = vec![0f32; rows.len()];
    let coherence_before = coherence(rows);
    for number in 0..TUNING.alignment.rounds {
        let own = |part: Part<'_>| on_tier!(level, simd => round(simd, part, &comb, number == 0));
        let more = by_parts(rows, level, parallel, own);
        slopes.iter_mut().zip(more).for_each(|(slope, more)| *slope += more);
    }
    let mean = slopes.iter().map(|s| f64::from(*s)).sum::<f64>() / count;
    let variance = slopes.iter().map(|s| (f64::from(*s) - mean).powi(2)).sum::<f64>() / count;
    let coherence_after = coherence(rows);
    on_tier!(level, _simd => rows.iter_mut().zip(turned).for_each(|(row, turned)| row.turn(turned)));
    Alignment { slope_sd_rad: variance.sqrt(), coherence_before, coherence_after }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::channel::INDICES_20_MHZ;

    /// Packets along a path of two rays, each with its own slope about a common one.
    fn packets(jitter_rad: f32) -> (Vec<CsiRow>, Vec<CsiRow>) {
        let mut state = 7u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u32 << 24) as f32 - 0.5
        };
        let channel = |t: usize, k: usize| {
            let x = f32::from(INDICES_20_MHZ[k]);
            let t = t as f32;
            Complex32::cis(0.2 * t - 0.8 * x) + Complex32::from_polar(0.4, -0.15 * t - 0.83 * x)
        };
        let clean: Vec<CsiRow> = (0..200).map(|t| std::array::from_fn(|k| channel(t, k))).collect();
        let jittered = clean.iter().map(|row| {
            let turns = turns(&INDICES_20_MHZ, jitter_rad * random());
            std::array::from_fn(|k| row[k] * turns[k])
        });
        let jittered = jittered.collect();
        (clean, jittered)
    }

    #[test]
    fn packets_are_turned_to_a_common_slope_and_keep_their_centre_phase() {
        let (clean, mut rows) = packets(0.3);
        let found = align(&mut rows, &INDICES_20_MHZ, Tier::detect());
        let level = Tier::detect().level_or_portable();
        let each = by_parts(&mut planes_of(&clean), level, false, coherences);
        let best = each.iter().sum::<f64>() / each.len() as f64;
        assert!(best > 0.99 && found.coherence_before < 0.65 && found.coherence_after > 0.88, "{found:?} {best}");
        assert!((found.slope_sd_rad - 0.3 / 12f64.sqrt()).abs() < 0.025, "{found:?}");
        // What is left of each packet's own slope: common or slowly wandering, and nothing at the channel centre.
        let left: Vec<CsiRow> =
            clean.iter().zip(&rows).map(|(a, b)| std::array::from_fn(|k| b[k] * a[k].conj())).collect();
        let full = |row: &CsiRow| row.iter().map(Complex32::norm_sqr).sum::<f32>();
        assert!(left.iter().all(|row| (row[14] + row[15]).arg().abs() < 0.01));
        let alike = |pair: &[CsiRow]| {
            let product: Complex32 = pair[1].iter().zip(&pair[0]).map(|(b, a)| b * a.conj()).sum();
            product.norm() / (full(&pair[0]) * full(&pair[1])).sqrt()
        };
        let mean = left.windows(2).map(alike).sum::<f32>() / (left.len() - 1) as f32;
        assert!(mean > 0.8, "{mean}");
    }

    #[test]
    fn every_tier_finds_the_same_slopes() {
        let (_, rows) = packets(0.3);
        let found = |tier| {
            let mut own = rows.clone();
            (align(&mut own, &INDICES_20_MHZ, tier), own)
        };
        let (expected, turned) = found(Tier::Portable);
        for tier in Tier::available() {
            let (alignment, own) = found(tier);
            assert!((alignment.slope_sd_rad - expected.slope_sd_rad).abs() < 1e-4, "{tier:?} {alignment:?}");
            let apart = own.iter().flatten().zip(turned.iter().flatten()).map(|(a, b)| (a - b).norm());
            assert!(apart.fold(0.0, f32::max) < 5e-3, "{tier:?}");
        }
    }

    #[test]
    fn halves_side_by_side_give_the_same_numbers() {
        let (_, rows) = packets(0.3);
        for (tier, count) in Tier::available().into_iter().flat_map(|tier| [3, 8, 15, 200].map(|count| (tier, count))) {
            let found = |parallel| {
                let mut own = planes_of(&rows[..count]);
                (align_planes(&mut own, &INDICES_20_MHZ, tier, parallel), own)
            };
            assert_eq!(found(true), found(false), "{tier:?}, {count}");
        }
    }

    #[test]
    fn a_common_slope_goes_and_nothing_else() {
        let (clean, _) = packets(0.0);
        let mut rows = clean.clone();
        remove_common_slope(&mut rows, &INDICES_20_MHZ, Tier::detect());
        let apart = |k: &usize| INDICES_20_MHZ[*k] - INDICES_20_MHZ[*k - 1] == 2;
        let turn = |row: &CsiRow| (1..SUBCARRIERS).filter(apart).map(|k| row[k] * row[k - 1].conj()).sum::<Complex32>();
        assert!(rows.iter().map(turn).sum::<Complex32>().arg().abs() < 1e-3);
        assert!(clean.iter().flatten().zip(rows.iter().flatten()).all(|(a, b)| (a.norm() - b.norm()).abs() < 1e-4));
    }

    #[test]
    fn silence_and_short_records_are_left_alone() {
        let mut rows = vec![[Complex32::default(); SUBCARRIERS]; 5];
        assert_eq!(align(&mut rows, &INDICES_20_MHZ, Tier::Portable).coherence_after, 0.0);
        assert!(rows.iter().flatten().all(|v| *v == Complex32::default()));
        assert_eq!(align(&mut [], &INDICES_20_MHZ, Tier::Portable), Alignment::default());
    }
}
