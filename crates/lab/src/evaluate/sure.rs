//! Bearings by probability: how often bearings of similar probability were right, and the effect of refusing the least sure.

use super::Errors;
use serde::Serialize;

/// Bearings further off than this are wrong, degrees; probabilities refer to it.
pub const WRONG_DEG: f64 = 5.0;
/// Edges of the bins of probability, as for the expected calibration error.
const BINS: [f64; 6] = [0.0, 0.2, 0.4, 0.6, 0.8, 1.000_001];

/// A bearing's probability of being within five degrees, and its error.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Sure {
    /// The probability, 0..1.
    pub probability: f64,
    /// Its absolute error, degrees.
    pub error_deg: f64,
}

impl Sure {
    /// A bearing with this probability and this error, degrees (of either sign).
    #[must_use]
    pub fn new(probability: f64, error_deg: f64) -> Self {
        Self { probability, error_deg: error_deg.abs() }
    }

    /// Whether it was within five degrees.
    #[must_use]
    pub fn is_right(&self) -> bool {
        self.error_deg <= WRONG_DEG
    }
}

/// Errors of the remaining bearings after refusing the least sure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Kept {
    /// Share kept, 0..1.
    pub share: f64,
    /// Lowest probability of a kept bearing.
    pub confidence: f64,
    /// Errors of those kept.
    pub errors: Errors,
    /// Share of the refused bearings that was within five degrees: the cost. `None` if nothing was refused.
    pub refused_right: Option<f64>,
}

impl Kept {
    fn of(kept: &[Sure], refused: &[Sure], confidence: f64) -> Self {
        let right = refused.iter().filter(|own| own.is_right()).count();
        Self {
            share: kept.len() as f64 / (kept.len() + refused.len()).max(1) as f64,
            confidence,
            errors: Errors::of(kept.iter().map(|own| own.error_deg)),
            refused_right: (!refused.is_empty()).then(|| right as f64 / refused.len() as f64),
        }
    }
}

/// The result of refusing below each of the probabilities `least`; empty without bearings.
#[must_use]
pub fn above(all: &[Sure], least: &[f64]) -> Vec<Kept> {
    let of = |least: &f64| {
        let (kept, refused): (Vec<Sure>, Vec<Sure>) = all.iter().partition(|own| own.probability >= *least);
        Kept::of(&kept, &refused, *least)
    };
    if all.is_empty() { Vec::new() } else { least.iter().map(of).collect() }
}

/// The result of keeping each of `shares`, rounded up to a whole bearing, the surest first; empty without bearings.
#[must_use]
pub fn surest(all: &[Sure], shares: impl Iterator<Item = f64>) -> Vec<Kept> {
    let mut falling = all.to_vec();
    falling.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    let of = |share: f64| {
        // Rounding errors of a share must not add a bearing.
        let count = ((falling.len() as f64 * share - 1e-9).ceil() as usize).min(falling.len());
        let (kept, refused) = falling.split_at(count);
        Kept { share, ..Kept::of(kept, refused, kept.last().map_or(0.0, |own| own.probability)) }
    };
    if all.is_empty() { Vec::new() } else { shares.map(of).collect() }
}

/// Bearings of similar probability.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Reliability {
    /// Lower edge.
    pub from: f64,
    /// Upper edge.
    pub to: f64,
    /// Number of bearings.
    pub links: usize,
    /// Their mean probability.
    pub said: f64,
    /// Share that was within five degrees.
    pub right: f64,
}

/// How often bearings in each fifth of the probabilities were right, without empty fifths.
#[must_use]
pub fn reliability(all: &[Sure]) -> Vec<Reliability> {
    let bin = |edges: &[f64]| {
        let own: Vec<&Sure> = all.iter().filter(|own| (edges[0]..edges[1]).contains(&own.probability)).collect();
        let n = own.len().max(1) as f64;
        Reliability {
            from: edges[0],
            to: edges[1].min(1.0),
            links: own.len(),
            said: own.iter().map(|own| own.probability).sum::<f64>() / n,
            right: own.iter().filter(|own| own.is_right()).count() as f64 / n,
        }
    };
    BINS.windows(2).map(bin).filter(|bin| bin.links > 0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten bearings, the surest first, with errors of 0, 1, .. 9 degrees.
    fn ten() -> Vec<Sure> {
        (0..10).map(|k| Sure::new(1.0 - 0.1 * f64::from(k), -f64::from(k))).collect()
    }

    #[test]
    fn refusing_the_unsure_lowers_the_error_and_costs_what_was_right() {
        let all = ten();
        let curve = surest(&all, [1.0, 0.5].into_iter());
        assert_eq!((curve[0].errors.links, curve[1].errors.links), (10, 5));
        assert!((curve[1].errors.mean_deg - 2.0).abs() < 1e-12 && (curve[0].errors.mean_deg - 4.5).abs() < 1e-12);
        // One of the five refused is 5 degrees off: still right.
        assert_eq!((curve[0].refused_right, curve[1].refused_right), (None, Some(0.2)));
        let least = above(&all, &[0.0, 0.75, 1.1]);
        assert_eq!(least.iter().map(|kept| kept.errors.links).collect::<Vec<_>>(), [10, 3, 0]);
        assert_eq!((least[1].share, least[1].confidence, least[2].refused_right), (0.3, 0.75, Some(0.6)));
        assert!(surest(&[], [1.0].into_iter()).is_empty() && above(&[], &[0.0]).is_empty());
    }

    #[test]
    fn every_bearing_is_in_one_bin() {
        let bins = reliability(&ten());
        assert_eq!(bins.iter().map(|bin| bin.links).sum::<usize>(), 10);
        let last = bins[bins.len() - 1];
        assert!(last.right == 1.0 && last.said > 0.8 && last.to == 1.0, "{last:?}");
        assert!(reliability(&[]).is_empty());
    }
}
