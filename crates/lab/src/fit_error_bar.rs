//! The error bars of `src/place/confidence.rs`, fitted to bearings with known truth.
//!
//! The error of a bearing is taken as Student's t (four degrees of freedom: errors have tails) with the scale
//! `sqrt(exp(base + sum coefficient x feature)^2 + heading^2)`, where `heading` is that of the trajectory, a figure of the
//! sensor (0 for motion capture). The likelihood, places and their lengths of motion weighing the same, less a ridge of one place on each
//! standardised coefficient is maximised by Fisher's scoring from zero. The first part of the scale is then multiplied until
//! 68 % of errors are within it and 95 % within twice, or rather, since both cannot be had by one factor, until
//! `q68 q95 / 2 = 1`, `q` being quantiles of `|error| / scale`. The same rows give the same digits.

use crate::fit_confidence::weights;
use nalgebra::{DMatrix, DVector};

/// Degrees of freedom of the errors.
const FREEDOM: f64 = 4.0;
/// Ridge on each coefficient, in units of places.
const RIDGE: f64 = 1.0;
/// Steps of the scoring.
const STEPS: usize = 80;
/// Longest step of a standardised coefficient.
const LONGEST: f64 = 0.3;

/// One bearing with its features and its error.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ErrorRow {
    /// The place that it was recorded at.
    pub place: String,
    /// Parts that its motion was cut into.
    pub parts: u32,
    /// Features of the model.
    pub features: Vec<f64>,
    /// Azimuth less truth, degrees.
    pub error_deg: f64,
    /// Standard deviation of the trajectory's heading, degrees.
    pub heading_deg: f64,
}

impl ErrorRow {
    /// A row.
    #[must_use]
    pub fn new(place: String, parts: u32, features: Vec<f64>, error_deg: f64, heading_deg: f64) -> Self {
        Self { place, parts, features, error_deg, heading_deg }
    }
}

/// A fitted model.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ErrorBarModel {
    /// Intercept, ln degrees.
    pub base: f64,
    /// Per unit of each feature.
    pub coefficients: Vec<f64>,
}

/// Features in units of their deviations from their means, beside what turns coefficients back.
struct Standard {
    inputs: Vec<DVector<f64>>,
    means: Vec<f64>,
    deviations: Vec<f64>,
    weights: Vec<f64>,
}

impl Standard {
    fn of(rows: &[&ErrorRow]) -> Option<Self> {
        let n = rows.first()?.features.len();
        let weights = weights(rows.iter().map(|row| (row.place.as_str(), row.parts)));
        let total: f64 = weights.iter().sum();
        let mean = |of: &dyn Fn(&ErrorRow) -> f64| {
            rows.iter().zip(&weights).map(|(row, weight)| weight * of(row)).sum::<f64>() / total
        };
        let means: Vec<f64> = (0..n).map(|i| mean(&|row| row.features[i])).collect();
        let deviation = |i: usize| mean(&|row| (row.features[i] - means[i]).powi(2)).sqrt();
        let deviations: Vec<f64> = (0..n).map(|i| Some(deviation(i)).filter(|d| *d > 1e-9).unwrap_or(1.0)).collect();
        let input = |row: &&ErrorRow| {
            DVector::from_fn(n + 1, |i, _| match i.checked_sub(1) {
                None => 1.0,
                Some(k) => (row.features[k] - means[k]) / deviations[k],
            })
        };
        Some(Self { inputs: rows.iter().map(input).collect(), means, deviations, weights })
    }

    /// Where the scores have their maximum.
    fn solve(&self, rows: &[&ErrorRow]) -> Option<DVector<f64>> {
        let n = self.means.len() + 1;
        let ridge = DVector::from_fn(n, |i, _| if i == 0 { 1e-9 } else { RIDGE });
        let mut solution = DVector::zeros(n);
        for _ in 0..STEPS {
            let mut slope = -ridge.component_mul(&solution);
            let mut curvature = DMatrix::from_diagonal(&ridge);
            for ((x, row), weight) in self.inputs.iter().zip(rows).zip(&self.weights) {
                let (own, all) = squares(solution.dot(x), row.heading_deg);
                let (part, u) = (own / all, row.error_deg.powi(2) / all);
                slope += x * (weight * part * ((FREEDOM + 1.0) * u / (FREEDOM + u) - 1.0));
                let information = 2.0 * FREEDOM * (FREEDOM + 1.0) * u / (FREEDOM + u).powi(2) + 0.1;
                curvature += x * x.transpose() * (weight * part * part * information);
            }
            solution += curvature.lu().solve(&slope)?.map(|step| step.clamp(-LONGEST, LONGEST));
        }
        solution.iter().all(|v| v.is_finite()).then_some(solution)
    }
}

/// The square of the first part of a scale, and of all of it.
fn squares(ln_deg: f64, heading_deg: f64) -> (f64, f64) {
    let own = (2.0 * ln_deg.clamp(-20.0, 20.0)).exp();
    (own, own + heading_deg.powi(2))
}

impl ErrorBarModel {
    /// Fits `rows`. `None` without rows, or if a value is not finite.
    #[must_use]
    pub fn fit(rows: &[&ErrorRow]) -> Option<Self> {
        let standard = Standard::of(rows)?;
        let solution = standard.solve(rows)?;
        let coefficients: Vec<f64> =
            standard.deviations.iter().enumerate().map(|(i, deviation)| solution[i + 1] / deviation).collect();
        let shift: f64 = coefficients.iter().zip(&standard.means).map(|(c, mean)| c * mean).sum();
        let mut model = Self { base: solution[0] - shift, coefficients };
        model.base += model.widening(rows, &standard.weights);
        Some(model)
    }

    /// By how much the logarithm of the first part of the scale has to grow for the coverage that error bars promise.
    fn widening(&self, rows: &[&ErrorRow], weights: &[f64]) -> f64 {
        let excess = |ln: f64| {
            let wider = Self { base: self.base + ln, ..self.clone() };
            let ratio = |row: &&ErrorRow| row.error_deg.abs() / wider.error_bar_deg(&row.features, row.heading_deg);
            let mut ratios: Vec<(f64, f64)> = rows.iter().map(ratio).zip(weights.iter().copied()).collect();
            ratios.sort_by(|a, b| a.0.total_cmp(&b.0));
            (quantile(&ratios, 0.68) * quantile(&ratios, 0.95) / 2.0).ln()
        };
        let (mut low, mut high) = (-3.0, 3.0);
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            if excess(middle) > 0.0 { low = middle } else { high = middle }
        }
        high
    }

    /// The error bar of a bearing with these features by a trajectory whose heading has this deviation, degrees.
    #[must_use]
    pub fn error_bar_deg(&self, features: &[f64], heading_deg: f64) -> f64 {
        let ln_deg = self.coefficients.iter().zip(features).fold(self.base, |sum, (c, x)| sum + c * x);
        squares(ln_deg, heading_deg).1.sqrt()
    }
}

/// The value that a share of the weight is not above; `ratios` are sorted.
fn quantile(ratios: &[(f64, f64)], share: f64) -> f64 {
    let total: f64 = ratios.iter().map(|(_, weight)| weight).sum();
    let mut sum = 0.0;
    let reached = |(_, weight): &&(f64, f64)| {
        sum += weight;
        sum >= share * total
    };
    ratios.iter().find(reached).or(ratios.last()).map_or(1.0, |(ratio, _)| ratio.max(1e-12))
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300_sim::random::Stream;

    /// Errors of 200 places, normal with a deviation of `exp(0.5 + 0.8 x)` degrees, and of every other one with 4 degrees
    /// more in quadrature.
    fn rows() -> Vec<ErrorRow> {
        let mut random = Stream::of_seed(3);
        let row = |k: usize| {
            let (x, heading_deg) = (random.between(-2.0, 2.0), if k % 2 == 1 { 4.0 } else { 0.0 });
            let deviation = (0.5 + 0.8 * x).exp().hypot(heading_deg);
            ErrorRow::new((k / 10).to_string(), 1, vec![x, 7.0], deviation * random.normal(), heading_deg)
        };
        (0..2_000).map(row).collect()
    }

    #[test]
    fn the_scale_beside_a_heading_is_found_again() {
        let rows = rows();
        let rows: Vec<&ErrorRow> = rows.iter().collect();
        let model = ErrorBarModel::fit(&rows).unwrap();
        assert!((model.coefficients[0] - 0.8).abs() < 0.1 && model.coefficients[1].abs() < 1e-6, "{model:?}");
        let bar = |row: &&&ErrorRow| row.error_deg.abs() / model.error_bar_deg(&row.features, row.heading_deg);
        let within = |times: f64| rows.iter().filter(|row| bar(row) <= times).count() as f64 / rows.len() as f64;
        assert!(
            (within(1.0) - 0.68).abs() < 0.04 && (within(2.0) - 0.95).abs() < 0.03,
            "{} {}",
            within(1.0),
            within(2.0)
        );
    }

    #[test]
    fn the_same_rows_give_the_same_digits_and_none_give_nothing() {
        let rows = rows();
        let rows: Vec<&ErrorRow> = rows.iter().collect();
        assert_eq!(ErrorBarModel::fit(&rows), ErrorBarModel::fit(&rows));
        assert!(ErrorBarModel::fit(&[]).is_none());
    }
}
