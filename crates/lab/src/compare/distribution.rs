//! Mean, spread and order statistics of a set of numbers.

use csi5300::maths::nearest_rank;

/// Interquartile range of a normal distribution of deviation 1.
pub(super) const QUARTILES: f64 = 1.349;

/// A quantity over all records or pairs that have it. All zero if none has.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Distribution {
    /// Number of values.
    pub count: usize,
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
    /// Smallest.
    pub min: f64,
    /// First percentile.
    pub p01: f64,
    /// First quartile.
    pub q1: f64,
    /// Median.
    pub median: f64,
    /// Third quartile.
    pub q3: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

impl Distribution {
    /// Summarises finite values.
    #[must_use]
    pub fn of(values: &[f64]) -> Self {
        let mut sorted: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let (Some(&min), Some(&max)) = (sorted.first(), sorted.last()) else { return Self::default() };
        let n = sorted.len() as f64;
        let mean = sorted.iter().sum::<f64>() / n;
        let variance = sorted.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n;
        let at = |share: f64| nearest_rank(&sorted, share).unwrap_or(f64::NAN);
        Self {
            count: sorted.len(),
            mean,
            sd: variance.sqrt(),
            min,
            p01: at(0.01),
            q1: at(0.25),
            median: at(0.5),
            q3: at(0.75),
            p99: at(0.99),
            max,
        }
    }

    /// Interquartile range.
    #[must_use]
    pub(crate) fn quartile_range(&self) -> f64 {
        self.q3 - self.q1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_statistics_of_a_ramp_are_exact() {
        let mut values: Vec<f64> = (0..=100).rev().map(f64::from).collect();
        values.push(f64::NAN);
        let d = Distribution::of(&values);
        assert_eq!((d.count, d.mean, d.min, d.max), (101, 50.0, 0.0, 100.0));
        assert_eq!((d.p01, d.q1, d.median, d.q3, d.p99), (1.0, 25.0, 50.0, 75.0, 99.0));
        assert!((d.sd - (850f64).sqrt()).abs() < 1e-12);
        assert_eq!(Distribution::of(&[]), Distribution::default());
    }
}
