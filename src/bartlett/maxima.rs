//! Local maxima of a sampled profile.

use super::sampler::Sampled;

/// Samples that none of their eight neighbours exceeds, with their values.
pub(super) fn local_maxima(sampled: &Sampled, ring: usize) -> Vec<(usize, f64)> {
    let rows = sampled.elevations.len();
    let mut maxima = Vec::new();
    let around = |i: usize| (if i == 0 { ring - 1 } else { i - 1 }, if i + 1 == ring { 0 } else { i + 1 });
    if rows == 1 {
        let values = &sampled.values;
        let top = |&i: &usize| {
            let (before, after) = around(i);
            values[i] >= values[before] && values[i] >= values[after]
        };
        maxima.extend((0..ring).filter(top).map(|i| (i, values[i])));
        return maxima;
    }
    for row in 0..rows {
        let own = &sampled.values[row * ring..(row + 1) * ring];
        let beside = [row.checked_sub(1), Some(row + 1).filter(|next| *next < rows)];
        for (column, &value) in own.iter().enumerate() {
            let (before, after) = around(column);
            // Most are below a neighbour on their own ring.
            if own[before] > value || own[after] > value {
                continue;
            }
            let below = |r: usize| [before, column, after].iter().all(|c| sampled.values[r * ring + c] <= value);
            if beside.into_iter().flatten().all(below) {
                maxima.push((row * ring + column, value));
            }
        }
    }
    maxima
}

/// Offset, in steps, of the vertex of the parabola through the logarithms of a sample and its neighbours around the ring.
pub(super) fn vertex(values: &[f64], index: usize, ring: usize) -> f64 {
    let (row, column) = (index / ring * ring, index % ring);
    let [before, here, after] = [ring - 1, 0, 1].map(|d| values[row + (column + d) % ring].max(f64::MIN_POSITIVE).ln());
    let bend = before - 2.0 * here + after;
    if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

/// Index and value of the largest; (0, 0) if there is none.
pub(super) fn argmax(values: &[f64]) -> (usize, f64) {
    values.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0))
}
