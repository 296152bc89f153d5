//! The error bars of `src/place/confidence.rs`, fitted to bearings with known truth.
//!
//! The error of a bearing is taken as Student's t (four degrees of freedom: errors have tails) with the scale
//! `sqrt(exp(base + sum coefficient x feature)^2 + heading^2)`, where `heading` is that of the trajectory: 0 for motion
//! capture, and one number for the tracking camera, which is fitted as well. The likelihood, each place weighing the same,
//! less a ridge of one place on each standardised coefficient is maximised by Fisher's scoring from zero, once for each
//! heading of a list. The first part of the scale is then multiplied until 68 % of errors are within it and 95 % within
//! twice, or rather, since both cannot be had by one factor, until `q68 q95 / 2 = 1`, `q` being quantiles of
//! `|error| / scale`. The same rows give the same digits.

use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// Degrees of freedom of the errors.
const FREEDOM: f64 = 4.0;
/// Ridge on each coefficient, in units of places.
const RIDGE: f64 = 1.0;
/// Steps of the scoring.
const STEPS: usize = 80;
/// Longest step of a standardised coefficient.
const LONGEST: f64 = 0.3;
/// Headings that are tried, degrees.
const HEADINGS_DEG: [f64; 9] = [2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, 8.0];

/// One bearing with its features and its error.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ErrorRow {
    /// The place that it was recorded at.
    pub place: String,
    /// Features of the model.
    pub features: Vec<f64>,
    /// Azimuth less truth, degrees.
    pub error_deg: f64,
    /// True if the trajectory is a tracking camera's.
    pub by_camera: bool,
}

impl ErrorRow {
    /// A row.
    #[must_use]
    pub fn new(place: String, features: Vec<f64>, error_deg: f64, by_camera: bool) -> Self {
        Self { place, features, error_deg, by_camera }
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
    /// Standard deviation of the camera's heading, degrees.
    pub heading_deg: f64,
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
        let mut counts: BTreeMap<&str, f64> = BTreeMap::new();
        rows.iter().for_each(|row| *counts.entry(&row.place).or_default() += 1.0);
        let weight = |row: &&ErrorRow| 1.0 / counts.get(row.place.as_str()).copied().unwrap_or(1.0);
        let weights: Vec<f64> = rows.iter().map(weight).collect();
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

    /// The scores' maximum for one heading, and the penalised log-likelihood there.
    fn solve(&self, rows: &[&ErrorRow], heading_deg: f64) -> Option<(DVector<f64>, f64)> {
        let n = self.means.len() + 1;
        let ridge = DVector::from_fn(n, |i, _| if i == 0 { 1e-9 } else { RIDGE });
        let mut solution = DVector::zeros(n);
        for _ in 0..STEPS {
            let mut slope = -ridge.component_mul(&solution);
            let mut curvature = DMatrix::from_diagonal(&ridge);
            for ((x, row), weight) in self.inputs.iter().zip(rows).zip(&self.weights) {
                let (own, all) = squares(solution.dot(x), row.by_camera, heading_deg);
                let (part, u) = (own / all, row.error_deg.powi(2) / all);
                slope += x * (weight * part * ((FREEDOM + 1.0) * u / (FREEDOM + u) - 1.0));
                let information = 2.0 * FREEDOM * (FREEDOM + 1.0) * u / (FREEDOM + u).powi(2) + 0.1;
                curvature += x * x.transpose() * (weight * part * part * information);
            }
            solution += curvature.lu().solve(&slope)?.map(|step| step.clamp(-LONGEST, LONGEST));
        }
        let each = self.inputs.iter().zip(rows).zip(&self.weights).map(|((x, row), weight)| {
            let (_, all) = squares(solution.dot(x), row.by_camera, heading_deg);
            weight * (0.5 * all.ln() + 0.5 * (FREEDOM + 1.0) * (row.error_deg.powi(2) / all / FREEDOM).ln_1p())
        });
        let penalty = 0.5 * ridge.dot(&solution.component_mul(&solution));
        let likelihood = -each.sum::<f64>() - penalty;
        likelihood.is_finite().then_some((solution, likelihood))
    }
}

/// The square of the first part of a scale, and of all of it.
fn squares(ln_deg: f64, by_camera: bool, heading_deg: f64) -> (f64, f64) {
    let own = (2.0 * ln_deg.clamp(-20.0, 20.0)).exp();
    (own, own + if by_camera { heading_deg.powi(2) } else { 0.0 })
}

impl ErrorBarModel {
    /// Fits `rows`; with `heading_deg`, that heading is taken instead of one of a list. `None` without rows, or if a value
    /// is not finite.
    #[must_use]
    pub fn fit(rows: &[&ErrorRow], heading_deg: Option<f64>) -> Option<Self> {
        let standard = Standard::of(rows)?;
        let tried = heading_deg.map_or(HEADINGS_DEG.to_vec(), |own| vec![own]);
        let solved = tried.into_iter().filter_map(|own| Some((own, standard.solve(rows, own)?)));
        let (heading_deg, (solution, _)) = solved.max_by(|a, b| a.1.1.total_cmp(&b.1.1))?;
        let coefficients: Vec<f64> =
            standard.deviations.iter().enumerate().map(|(i, deviation)| solution[i + 1] / deviation).collect();
        let shift: f64 = coefficients.iter().zip(&standard.means).map(|(c, mean)| c * mean).sum();
        let mut model = Self { base: solution[0] - shift, coefficients, heading_deg };
        model.base += model.widening(rows, &standard.weights);
        Some(model)
    }

    /// By how much the logarithm of the first part of the scale has to grow for the coverage that error bars promise.
    fn widening(&self, rows: &[&ErrorRow], weights: &[f64]) -> f64 {
        let excess = |ln: f64| {
            let wider = Self { base: self.base + ln, ..self.clone() };
            let ratio = |row: &&ErrorRow| row.error_deg.abs() / wider.error_bar_deg(&row.features, row.by_camera);
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

    /// The error bar of a bearing with these features, degrees.
    #[must_use]
    pub fn error_bar_deg(&self, features: &[f64], by_camera: bool) -> f64 {
        let ln_deg = self.coefficients.iter().zip(features).fold(self.base, |sum, (c, x)| sum + c * x);
        squares(ln_deg, by_camera, self.heading_deg).1.sqrt()
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

    /// Errors of 200 places, normal with a deviation of `exp(0.5 + 0.8 x)` degrees, and by the camera with 4 degrees more
    /// in quadrature.
    fn rows() -> Vec<ErrorRow> {
        let mut random = Stream::of_seed(3);
        let row = |k: usize| {
            let (x, by_camera) = (random.between(-2.0, 2.0), k % 2 == 1);
            let deviation = (0.5 + 0.8 * x).exp().hypot(if by_camera { 4.0 } else { 0.0 });
            ErrorRow::new((k / 10).to_string(), vec![x, 7.0], deviation * random.normal(), by_camera)
        };
        (0..2_000).map(row).collect()
    }

    #[test]
    fn scale_and_heading_are_found_again() {
        let rows = rows();
        let rows: Vec<&ErrorRow> = rows.iter().collect();
        let model = ErrorBarModel::fit(&rows, None).unwrap();
        assert!((model.coefficients[0] - 0.8).abs() < 0.1 && model.coefficients[1].abs() < 1e-6, "{model:?}");
        assert!((3.0..=4.5).contains(&model.heading_deg), "{model:?}");
        let bar = |row: &&&ErrorRow| row.error_deg.abs() / model.error_bar_deg(&row.features, row.by_camera);
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
        assert_eq!(ErrorBarModel::fit(&rows, None), ErrorBarModel::fit(&rows, None));
        assert_eq!(ErrorBarModel::fit(&rows, Some(3.0)).unwrap().heading_deg, 3.0);
        assert!(ErrorBarModel::fit(&[], None).is_none());
    }
}
