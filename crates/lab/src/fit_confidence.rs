//! The logistic models of `src/place/confidence.rs`, fitted to captures with known truth.
//!
//! A row is one bearing: its features, and whether it was within five degrees. Bearings of one place are near copies of
//! each other, so the place is the unit: every place has the same weight in the fit, however many bearings it has, and within
//! it whole motions together as much as halves or quarters; calibration is judged on places that the fit has not seen (leave one out). The fit maximises the weighted likelihood
//! less a ridge on the coefficients of standardised features (not on the intercept), by Newton's method from zero: the
//! same rows give the same digits.

use crate::evaluate::BINS;
use nalgebra::{DMatrix, DVector};
use std::collections::{BTreeMap, BTreeSet};

/// Ridge on each coefficient, in units of places.
const RIDGE: f64 = 1.0;
/// Newton steps; the last ones change nothing.
const STEPS: usize = 50;

/// One bearing with its features and whether it was right.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct LabelledBearing {
    /// The place that it was recorded at.
    pub place: String,
    /// Parts that its motion was cut into.
    pub parts: u32,
    /// Features of the model.
    pub features: Vec<f64>,
    /// Whether the azimuth was within [`crate::evaluate::WRONG_DEG`] of the bearing from the mean pose.
    pub right: bool,
    /// A probability to be judged, 0..1; not a number where none was made.
    pub probability: f64,
}

/// A fitted model.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct LogisticModel {
    /// Intercept.
    pub base: f64,
    /// Per unit of each feature.
    pub coefficients: Vec<f64>,
}

/// How well probabilities agree with what happened; each place weighs the same.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Calibration {
    /// Mean squared difference between the probability and 0 or 1.
    pub brier: f64,
    /// Mean over five bins of the difference between mean probability and share right, weighed by their bearings.
    pub expected_error: f64,
}

/// The weight of each bearing, of its place and the number of parts that its motion was cut into: those of a place sum to one,
/// and of its lengths of motion each has the same.
pub(crate) fn weights<'a>(rows: impl Iterator<Item = (&'a str, u32)> + Clone) -> Vec<f64> {
    let mut places: BTreeMap<&str, BTreeMap<u32, f64>> = BTreeMap::new();
    rows.clone().for_each(|(place, parts)| *places.entry(place).or_default().entry(parts).or_default() += 1.0);
    let weight = |(place, parts): (&str, u32)| {
        let lengths = places.get(place)?;
        Some(1.0 / (lengths.len() as f64 * lengths.get(&parts)?))
    };
    rows.map(|row| weight(row).unwrap_or(0.0)).collect()
}

impl LabelledBearing {
    fn unit(&self) -> (&str, u32) {
        (&self.place, self.parts)
    }
}

fn sigmoid(logit: f64) -> f64 {
    1.0 / (1.0 + (-logit).exp())
}

impl LogisticModel {
    /// Fits `rows`; `None` if there are none, or if a feature is not finite.
    #[must_use]
    pub fn fit(rows: &[&LabelledBearing]) -> Option<Self> {
        let n = rows.first()?.features.len();
        let weights = weights(rows.iter().map(|row| row.unit()));
        let total: f64 = weights.iter().sum();
        let mean_of = |f: &dyn Fn(&LabelledBearing) -> f64| {
            rows.iter().zip(&weights).map(|(row, weight)| weight * f(row)).sum::<f64>() / total
        };
        let means: Vec<f64> = (0..n).map(|i| mean_of(&|row| row.features[i])).collect();
        let deviation = |i: usize| mean_of(&|row| (row.features[i] - means[i]).powi(2)).sqrt();
        // A feature that never changes has no coefficient: any deviation serves.
        let deviations: Vec<f64> = (0..n).map(|i| Some(deviation(i)).filter(|d| *d > 1e-9).unwrap_or(1.0)).collect();
        let standard = |row: &LabelledBearing| {
            DVector::from_fn(n + 1, |i, _| match i.checked_sub(1) {
                None => 1.0,
                Some(k) => (row.features[k] - means[k]) / deviations[k],
            })
        };
        let inputs: Vec<DVector<f64>> = rows.iter().map(|row| standard(row)).collect();
        let solution = newton(&inputs, rows, &weights)?;
        let coefficients: Vec<f64> = (0..n).map(|i| solution[i + 1] / deviations[i]).collect();
        let shift: f64 = coefficients.iter().zip(&means).map(|(c, mean)| c * mean).sum();
        Some(Self { base: solution[0] - shift, coefficients })
    }

    /// The probability of a bearing with these features.
    #[must_use]
    pub fn probability(&self, features: &[f64]) -> f64 {
        sigmoid(self.coefficients.iter().zip(features).fold(self.base, |sum, (c, x)| sum + c * x))
    }
}

/// The maximum of the weighted likelihood less the ridge.
fn newton(inputs: &[DVector<f64>], rows: &[&LabelledBearing], weights: &[f64]) -> Option<DVector<f64>> {
    let n = inputs.first()?.len();
    let ridge = DVector::from_fn(n, |i, _| if i == 0 { 1e-9 } else { RIDGE });
    let mut solution = DVector::zeros(n);
    for _ in 0..STEPS {
        let mut slope = -ridge.component_mul(&solution);
        let mut curvature = DMatrix::from_diagonal(&ridge);
        for ((x, row), weight) in inputs.iter().zip(rows).zip(weights) {
            let p = sigmoid(solution.dot(x));
            slope += x * (weight * (f64::from(u8::from(row.right)) - p));
            curvature += x * x.transpose() * (weight * p * (1.0 - p));
        }
        solution += curvature.lu().solve(&slope)?;
    }
    solution.iter().all(|v| v.is_finite()).then_some(solution)
}

/// Calibration of one probability for each of `rows`.
#[must_use]
pub fn calibration(rows: &[&LabelledBearing], probabilities: &[f64]) -> Calibration {
    let weights = weights(rows.iter().map(|row| row.unit()));
    let total: f64 = weights.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    let each = || rows.iter().zip(&weights).zip(probabilities);
    let label = |row: &LabelledBearing| f64::from(u8::from(row.right));
    let brier = each().map(|((row, weight), p)| weight * (p - label(row)).powi(2)).sum::<f64>() / total;
    let gap = |edges: &[f64]| {
        let inside = each().filter(|(_, p)| (edges[0]..edges[1]).contains(*p));
        inside.map(|((row, weight), p)| weight * (p - label(row))).sum::<f64>().abs()
    };
    Calibration { brier, expected_error: BINS.windows(2).map(gap).sum::<f64>() / total }
}

/// The probability of each bearing by a model that was fitted to all other places, and how well those agree with what
/// happened.
#[must_use]
pub fn leave_one_place_out(rows: &[LabelledBearing]) -> Option<Calibration> {
    let places: BTreeSet<&str> = rows.iter().map(|row| row.place.as_str()).collect();
    let (mut judged, mut probabilities) = (Vec::new(), Vec::new());
    for place in places {
        let (own, others): (Vec<_>, Vec<_>) = rows.iter().partition(|row| row.place == place);
        let model = LogisticModel::fit(&others)?;
        probabilities.extend(own.iter().map(|row| model.probability(&row.features)));
        judged.extend(own);
    }
    Some(calibration(&judged, &probabilities))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(place: usize, x: f64, right: bool) -> LabelledBearing {
        let (place, parts) = (place.to_string(), 1 + u32::from(x > 0.0));
        LabelledBearing { place, parts, features: vec![x, 7.0], right, probability: 0.5 }
    }

    #[test]
    fn a_feature_that_tells_right_from_wrong_is_found_and_one_that_does_not_is_left() {
        let rows: Vec<_> =
            (0..200).map(|k| row(k % 40, f64::from(k as u32 % 20) - 9.5, k % 20 + k / 20 % 3 > 10)).collect();
        let all: Vec<&LabelledBearing> = rows.iter().collect();
        let model = LogisticModel::fit(&all).unwrap();
        assert!(model.coefficients[0] > 0.2 && model.coefficients[1].abs() < 1e-6, "{model:?}");
        let own: Vec<f64> = all.iter().map(|row| model.probability(&row.features)).collect();
        let (fitted, base) = (calibration(&all, &own), calibration(&all, &[0.5; 200]));
        assert!(fitted.brier < base.brier && base.brier == 0.25, "{fitted:?}");
        assert!(leave_one_place_out(&rows).unwrap().brier < base.brier);
    }

    #[test]
    fn places_weigh_the_same_and_so_do_their_lengths_of_motion() {
        let rows = [("a", 1), ("a", 2), ("a", 2), ("b", 1), ("b", 1)];
        assert_eq!(weights(rows.into_iter()), [0.5, 0.25, 0.25, 0.5, 0.5]);
    }

    #[test]
    fn without_rows_there_is_no_model() {
        assert!(LogisticModel::fit(&[]).is_none());
    }
}
