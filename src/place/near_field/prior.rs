//! Prior of elevation and range, and what follows from it and the joint power `P`:
//!
//! * the evidence of an azimuth, `(mean of P^n)^(1/n)` over elevations and ranges, `n` = `prior.looks_between_peaks`;
//! * the azimuth of an answer as the mean of a posterior, with the weights `P^(m p / (1 - p))`, `m` =
//!   `prior.looks_within_peak`, `p` the joint power of the answer.
//!
//! The highest point over azimuth, elevation and range favours an azimuth that finds, among all heights and ranges, one
//! that happens to fit; a trajectory that is bent or a reflection always offers some. Bayes' rule takes the mean over all
//! of them, weighted by their prior. `|elevation|` is taken as uniform up to its limit and less likely by
//! `prior.above` beyond it, range as uniform in its logarithm up to `prior.farthest` times the shortest one; a little is left
//! for all beyond that. A motion has hundreds of pairs, but what reflections and odometry leave is shared by many of them:
//! `n` and `m` are numbers of independent looks.

use super::grid::Axes;
use super::types::Free;
use crate::tuning::TUNING;

/// The share of the prior that each cell of one azimuth has, in the order of [`Axes::places`]; their sum is 1.
/// `expected_rad` is the limit of |elevation|.
pub(super) fn shares(axes: &Axes, expected_rad: f64) -> Vec<f64> {
    let elevations = lengths(&axes.elevations, |elevation| match elevation.abs() - expected_rad {
        above if above > 0.0 => (expected_rad + TUNING.prior.above * above).copysign(elevation),
        _ => elevation,
    });
    let nearest = axes.curves.last().copied().unwrap_or_default();
    let farthest = nearest / TUNING.prior.farthest;
    let ranges = lengths(&axes.curves, |curve| match curve / farthest {
        beyond if beyond < 1.0 => TUNING.prior.beyond * (beyond - 1.0),
        times => times.ln(),
    });
    elevations.iter().flat_map(|elevation| ranges.iter().map(move |range| elevation * range)).collect()
}

/// The length of each value's cell as a share of all; cells end halfway between values, and are measured by `scale`.
fn lengths(values: &[f64], scale: impl Fn(f64) -> f64) -> Vec<f64> {
    let (Some(&first), Some(&last)) = (values.first(), values.last()) else { return Vec::new() };
    let whole = scale(last) - scale(first);
    if values.len() == 1 || whole.is_nan() || whole <= 0.0 {
        return vec![1.0 / values.len() as f64; values.len()];
    }
    let inner = values.windows(2).map(|pair| 0.5 * pair.iter().sum::<f64>());
    let edges: Vec<f64> = std::iter::once(first).chain(inner).chain([last]).map(scale).collect();
    edges.windows(2).map(|cell| if let [low, high] = cell { (high - low) / whole } else { 0.0 }).collect()
}

/// What an azimuth's evidence adds to its highest score: `ln` of the mean over its cells of `(power / highest)^looks`, in
/// the terms of `scores`, which are `weight x ln power`. Never above 0.
pub(super) fn averaging(scores: &[f64], shares: &[f64], weight: f64) -> f64 {
    let highest = scores.iter().copied().fold(f64::MIN, f64::max);
    let rate = TUNING.prior.looks_between_peaks / weight;
    let mean: f64 = scores.iter().zip(shares).map(|(score, share)| share * (rate * (score - highest)).exp()).sum();
    mean.max(f64::MIN_POSITIVE).ln() / rate
}

/// A place about an answer, at which it is weighed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Offset {
    /// Azimuth from the answer's, in cells of the grid.
    pub azimuth_cells: f64,
    /// |elevation| as a share of its limit; `None` where it is not searched.
    pub elevation_share: Option<f64>,
    /// 1 / range as a share of its limit; `None` where it is not searched.
    pub curve_share: Option<f64>,
}

/// The places about an answer at which it is weighed. All have the same prior.
pub(super) fn offsets(free: Free) -> Vec<Offset> {
    let even = |free: bool, n: usize, at: &dyn Fn(f64) -> f64| -> Vec<Option<f64>> {
        if free { (0..n).map(|i| Some(at((i as f64 + 0.5) / n as f64))).collect() } else { vec![None] }
    };
    let elevations = even(free.elevation, TUNING.prior.elevations, &|share| share);
    let curves = even(free.range, TUNING.prior.ranges, &|share| TUNING.prior.farthest.powf(-share));
    let mut offsets = Vec::new();
    for step in -TUNING.prior.azimuth_steps..=TUNING.prior.azimuth_steps {
        let azimuth_cells = f64::from(step) * TUNING.prior.azimuth_step_cells;
        for &elevation_share in &elevations {
            offsets.extend(curves.iter().map(|&curve_share| Offset { azimuth_cells, elevation_share, curve_share }));
        }
    }
    offsets
}

/// The mean azimuth of places, each as likely as its score says, in cells of azimuth from the answer. `power` is the joint
/// power of the answer: likelihood goes with what is left unexplained, so that a clean answer hardly moves.
pub(super) fn mean_cells(offsets: &[Offset], scores: &[f64], weight: f64, power: f64) -> f64 {
    let rate = TUNING.prior.looks_within_peak / weight * power / (1.0 - power).max(1e-3);
    let highest = scores.iter().copied().fold(f64::MIN, f64::max);
    let (mut sum, mut total) = (0.0, 0.0);
    for (offset, score) in offsets.iter().zip(scores) {
        let likely = (rate * (score - highest)).exp();
        sum += likely * offset.azimuth_cells;
        total += likely;
    }
    if total > 0.0 { sum / total } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_prior_is_one_whatever_the_cells() {
        for (elevations, curves) in [(1, 1), (3, 1), (1, 5), (4, 9), (2, 60)] {
            let axes = Axes {
                azimuths: 16,
                elevations: (0..elevations).map(|i| 0.1 * f64::from(i)).collect(),
                curves: (0..curves).map(|i| 0.07 * f64::from(i)).collect(),
            };
            let shares = shares(&axes, 0.25);
            assert_eq!(shares.len(), (elevations * curves) as usize);
            assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{shares:?}");
            assert!(shares.iter().all(|share| *share > 0.0), "{shares:?}");
        }
    }

    #[test]
    fn an_azimuth_that_fits_at_every_range_has_all_its_evidence() {
        assert_eq!(averaging(&[-0.7; 4], &[0.25; 4], 1.0), 0.0);
        let less = averaging(&[-0.7, -60.0, -60.0, -60.0], &[0.25; 4], 1.0);
        assert!((less - 0.25f64.ln() / TUNING.prior.looks_between_peaks).abs() < 1e-12, "{less}");
        let empty = averaging(&[], &[], 1.0);
        assert!(empty.is_finite(), "{empty}");
    }

    #[test]
    fn what_is_even_about_an_answer_leaves_it() {
        let offsets = offsets(Free { elevation: true, range: true });
        assert_eq!(offsets.len(), 11 * TUNING.prior.elevations * TUNING.prior.ranges);
        let scores: Vec<f64> = offsets.iter().map(|offset| -offset.azimuth_cells * offset.azimuth_cells).collect();
        assert!(mean_cells(&offsets, &scores, 1.0, 0.5).abs() < 1e-12);
        // One that leans to one side does so less the more of the power it explains.
        let lean = |offset: &Offset| -offset.azimuth_cells.abs() + 0.5 * offset.azimuth_cells;
        let leaning: Vec<f64> = offsets.iter().map(lean).collect();
        let moved = [0.2, 0.5, 0.9].map(|power| mean_cells(&offsets, &leaning, 1.0, power));
        assert!(moved[0] > moved[1] && moved[1] > moved[2] && moved[2] > 0.0, "{moved:?}");
    }
}
