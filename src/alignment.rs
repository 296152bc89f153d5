//! Sampling-time offset: the part of it that the round-trip product leaves, taken out packet by packet.
//!
//! Both cards start sampling a little early or late in each frame, which turns the phase of a product by
//! `slope * subcarrier index` (measured: 0.05 to 0.12 rad per index from packet to packet, so a turn at the edges of
//! the band). The mean slope belongs to the path and the radios and says nothing; what changes from one packet to
//! the next cannot be motion, which turns the slope by 2 pi per 153 m. So each packet is turned to the slope of its
//! neighbours, about index 0, where the slope does nothing: the phase at the channel centre is left as it is.

use crate::channel::SUBCARRIERS;
use num_complex::Complex32;

/// One channel sample on every reported subcarrier, in the order of the subcarrier indices.
pub type Row = [Complex32; SUBCARRIERS];

/// Neighbours on either side that a packet is compared with.
const REACH: usize = 7;
/// Rounds: the neighbours' mean gets sharper as they are aligned.
const ROUNDS: usize = 3;
/// Newton steps on each packet's slope in each round.
const STEPS: usize = 2;

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

/// Sums over `2 reach + 1` neighbours (fewer at the ends), for each subcarrier, by running sums.
pub(crate) fn running_sums(rows: &[Row], reach: usize) -> Vec<Row> {
    let mut sum = [Complex32::default(); SUBCARRIERS];
    let add = |sum: &mut Row, row: &Row| sum.iter_mut().zip(row).for_each(|(s, v)| *s += v);
    let take = |sum: &mut Row, row: &Row| sum.iter_mut().zip(row).for_each(|(s, v)| *s -= v);
    rows.iter().take(reach).for_each(|row| add(&mut sum, row));
    let step = |k: usize| {
        if let Some(row) = rows.get(k + reach) {
            add(&mut sum, row);
        }
        if let Some(row) = k.checked_sub(reach + 1).and_then(|left| rows.get(left)) {
            take(&mut sum, row);
        }
        sum
    };
    (0..rows.len()).map(step).collect()
}

/// Takes the slope that all rows have in common out of each: neighbouring subcarriers then differ by the channel only.
pub fn remove_common_slope(rows: &mut [Row], indices: &[i8; SUBCARRIERS]) {
    let step = indices[1] - indices[0];
    let mut turn = Complex32::default();
    for row in rows.iter() {
        turn += neighbour_products(row, indices, step);
    }
    let slope = turn.arg() / f32::from(step);
    rows.iter_mut().for_each(|row| turn_by(row, indices, slope));
}

/// `sum v[k] conj(v[k-1])` over neighbours `step` indices apart.
fn neighbour_products(row: &Row, indices: &[i8; SUBCARRIERS], step: i8) -> Complex32 {
    let apart = |k: &usize| indices[*k] - indices[*k - 1] == step;
    (1..SUBCARRIERS).filter(apart).map(|k| row[k] * row[k - 1].conj()).sum()
}

/// `row[k] *= exp(-j slope index[k])`.
fn turn_by(row: &mut Row, indices: &[i8; SUBCARRIERS], slope: f32) {
    row.iter_mut().zip(turns(slope, indices)).for_each(|(value, turn)| *value *= turn);
}

/// `exp(-j slope index)` for rising indices, by steps of one and two: a sine for each would take most of the time.
fn turns(slope: f32, indices: &[i8; SUBCARRIERS]) -> Row {
    let one = Complex32::cis(-slope);
    let two = one * one;
    let mut at = indices[0];
    let mut turn = Complex32::cis(-slope * f32::from(at));
    indices.map(|index| {
        while at < index {
            let by_two = index - at >= 2;
            turn *= if by_two { two } else { one };
            at += if by_two { 2 } else { 1 };
        }
        turn
    })
}

/// Slopes that are tried first, radians per index: measured outliers reach 0.4. A lobe over 56 indices is 0.22 wide.
const TRIED: [f32; 27] = {
    let mut slopes = [0.0; 27];
    let mut k = 0;
    while k < 27 {
        slopes[k] = 0.04 * (k as f32 - 13.0);
        k += 1;
    }
    slopes
};

/// `exp(-j slope index)` of every slope tried.
fn trial_table(indices: &[i8; SUBCARRIERS]) -> Vec<(f32, Row)> {
    let row = |slope: &f32| (*slope, turns(*slope, indices));
    TRIED.iter().map(row).collect()
}

/// The slope at which `|sum row[k] exp(-j slope index[k])|` is largest: the best of `tried` (none: 0), then Newton's
/// method.
fn slope_of(row: &Row, indices: &[i8; SUBCARRIERS], tried: &[(f32, Row)]) -> f32 {
    let power = |turns: &Row| row.iter().zip(turns).map(|(v, t)| v * t).sum::<Complex32>().norm_sqr();
    let first = tried.iter().map(|(slope, turns)| (*slope, power(turns)));
    let mut slope = first.max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0.0, |(slope, _)| slope);
    for _ in 0..STEPS {
        let (mut b, mut b1, mut b2) = (Complex32::default(), Complex32::default(), Complex32::default());
        for ((value, &index), turn) in row.iter().zip(indices).zip(turns(slope, indices)) {
            let x = f32::from(index);
            let turned = value * turn;
            b += turned;
            b1 += turned * x;
            b2 += turned * (x * x);
        }
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

/// Mean over packets of `|sum_k v conj(m)| / sum_k |v||m|`, `m` the sum of the neighbours.
fn coherence(rows: &[Row], sums: &[Row]) -> f64 {
    let mut total = 0.0;
    for (row, sum) in rows.iter().zip(sums) {
        let (mut aligned, mut full) = (Complex32::default(), 0.0);
        for (v, s) in row.iter().zip(sum) {
            let product = v * (s - v).conj();
            aligned += product;
            full += product.norm_sqr().sqrt();
        }
        if full > 0.0 {
            total += f64::from(aligned.norm() / full);
        }
    }
    total / rows.len().max(1) as f64
}

/// One round: each packet is turned to the sum of its neighbours as they were before it. (Packets that were already
/// turned must not lead those that were not: the slope would wander off along the record, while the mean over
/// neighbours as recorded keeps to what the cards have in common.)
fn round(rows: &mut [Row], indices: &[i8; SUBCARRIERS], tried: &[(f32, Row)], slopes: &mut [f32]) {
    let sums = running_sums(rows, REACH);
    for ((row, sum), total) in rows.iter_mut().zip(&sums).zip(slopes) {
        let against: Row = std::array::from_fn(|k| row[k] * (sum[k] - row[k]).conj());
        let slope = slope_of(&against, indices, tried);
        if slope.is_finite() {
            turn_by(row, indices, slope);
            *total += slope;
        }
    }
}

/// Aligns `rows`, one per packet in the order of time, in place.
///
/// Rows should be of like magnitude. With fewer than three rows nothing is done.
pub fn align(rows: &mut [Row], indices: &[i8; SUBCARRIERS]) -> Alignment {
    if rows.len() < 3 {
        return Alignment::default();
    }
    let mut slopes = vec![0f32; rows.len()];
    let coherence_before = coherence(rows, &running_sums(rows, REACH));
    let table = trial_table(indices);
    for number in 0..ROUNDS {
        let tried: &[(f32, Row)] = if number == 0 { &table } else { &[] };
        round(rows, indices, tried, &mut slopes);
    }
    let sums = running_sums(rows, REACH);
    let mean = slopes.iter().map(|s| f64::from(*s)).sum::<f64>() / slopes.len() as f64;
    let variance = slopes.iter().map(|s| (f64::from(*s) - mean).powi(2)).sum::<f64>() / slopes.len() as f64;
    Alignment { slope_sd_rad: variance.sqrt(), coherence_before, coherence_after: coherence(rows, &sums) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::channel::INDICES_20_MHZ;

    /// Packets along a path of two rays, each with its own slope about a common one.
    fn packets(jitter_rad: f32) -> (Vec<Row>, Vec<Row>) {
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
        let clean: Vec<Row> = (0..200).map(|t| std::array::from_fn(|k| channel(t, k))).collect();
        let jittered = clean.iter().map(|row| {
            let mut row = *row;
            turn_by(&mut row, &INDICES_20_MHZ, jitter_rad * random());
            row
        });
        let jittered = jittered.collect();
        (clean, jittered)
    }

    #[test]
    fn packets_are_turned_to_a_common_slope_and_keep_their_centre_phase() {
        let (clean, mut rows) = packets(0.3);
        let found = align(&mut rows, &INDICES_20_MHZ);
        let best = coherence(&clean, &running_sums(&clean, REACH));
        assert!(best > 0.99 && found.coherence_before < 0.65 && found.coherence_after > 0.88, "{found:?} {best}");
        assert!((found.slope_sd_rad - 0.3 / 12f64.sqrt()).abs() < 0.025, "{found:?}");
        // What is left of each packet's own slope: common or slowly wandering, and nothing at the channel centre.
        let left: Vec<Row> =
            clean.iter().zip(&rows).map(|(a, b)| std::array::from_fn(|k| b[k] * a[k].conj())).collect();
        let full = |row: &Row| row.iter().map(Complex32::norm_sqr).sum::<f32>();
        assert!(left.iter().all(|row| (row[14] + row[15]).arg().abs() < 0.01));
        let alike = |pair: &[Row]| {
            let product: Complex32 = pair[1].iter().zip(&pair[0]).map(|(b, a)| b * a.conj()).sum();
            product.norm() / (full(&pair[0]) * full(&pair[1])).sqrt()
        };
        let mean = left.windows(2).map(alike).sum::<f32>() / (left.len() - 1) as f32;
        assert!(mean > 0.8, "{mean}");
    }

    #[test]
    fn a_common_slope_goes_and_nothing_else() {
        let (clean, _) = packets(0.0);
        let mut rows = clean.clone();
        remove_common_slope(&mut rows, &INDICES_20_MHZ);
        let turn: Complex32 = rows.iter().map(|row| neighbour_products(row, &INDICES_20_MHZ, 2)).sum();
        assert!(turn.arg().abs() < 1e-3);
        assert!(clean.iter().flatten().zip(rows.iter().flatten()).all(|(a, b)| (a.norm() - b.norm()).abs() < 1e-4));
    }

    #[test]
    fn silence_and_short_records_are_left_alone() {
        let mut rows = vec![[Complex32::default(); SUBCARRIERS]; 5];
        assert_eq!(align(&mut rows, &INDICES_20_MHZ).coherence_after, 0.0);
        assert!(rows.iter().flatten().all(|v| *v == Complex32::default()));
        assert_eq!(align(&mut [], &INDICES_20_MHZ), Alignment::default());
    }
}
