//! Confidence: the calibrated probability that an azimuth is within five degrees of the truth.
//!
//! `p = 1 / (1 + exp(-(base + sum coefficient x feature)))`, with one model for answers of a near-field search
//! ([`full_probability`]) and one for bearings by a plane wave at the channel centre ([`quick_probability`]): they fail
//! in different ways and see different things. Neither is the coherence of the samples, which is one of the features of
//! the second. `docs/tuning.md` has the data that they were fitted to and how they do on places that they were not
//! fitted to; the example `fit_confidence` of `csi5300-lab` fits them again.

use crate::bartlett::Estimate;
use crate::place::near_field::Fix;
use crate::tuning::TUNING;

/// Features of `full_probability`, in the order of their coefficients.
#[must_use]
pub fn full_features(fix: &Fix) -> [f64; 4] {
    let tuning = TUNING.full_probability;
    let best = fix.best();
    let no_other = tuning.no_other;
    let ratio = fix.sources.get(1).map_or(no_other, |other| (other.evidence / best.evidence).clamp(no_other, 1.0));
    let [least, most] = tuning.spread_deg;
    let spread = fix.view_spread_rad().to_degrees().clamp(least, most);
    [best.power.max(1e-6).ln(), ratio.ln(), spread.ln(), if fix.at_edge() { 1.0 } else { 0.0 }]
}

/// Probability that the azimuth of `fix` is within five degrees of the truth. Its features: how much of the signal the
/// answer explains in all views (ln of the joint power), how close the next answer comes (ln of the ratio of evidence),
/// how far the views by themselves disagree (ln of the largest difference of azimuths in degrees), and whether the answer
/// lies at the edge of what was searched (0 or 1).
#[must_use]
pub fn full_probability(fix: &Fix) -> f64 {
    let tuning = TUNING.full_probability;
    let coefficients = [tuning.per_power, tuning.per_ratio, tuning.per_spread, tuning.at_edge];
    logistic(tuning.base, coefficients, full_features(fix), tuning.limits)
}

/// Features of [`quick_probability`], in the order of their coefficients.
#[must_use]
pub fn quick_features(estimate: &Estimate, compensated: bool, wavelength_m: f64) -> [f64; 4] {
    let tuning = TUNING.quick_probability;
    let ratio = estimate.peak_ratio.map_or(tuning.no_other, |ratio| ratio.clamp(tuning.no_other, 1.0));
    let [least, most] = tuning.aperture_wavelengths;
    let aperture = (2.0 * estimate.shape.half_extent_m[0] / wavelength_m).clamp(least, most);
    [estimate.coherence.max(1e-3).ln(), ratio.ln(), aperture.ln(), if compensated { 1.0 } else { 0.0 }]
}

/// Probability that the azimuth of a bearing by a plane wave is within five degrees of the truth. Its features: ln of the
/// coherence, ln of the second highest peak over the highest, ln of the aperture's longest side in wavelengths (clamped to
/// what the fit has seen), and whether the turn-around was compensated (0 or 1).
///
/// `None` where the motion is along a line: its mirror is as likely, whatever the signal.
#[must_use]
pub fn quick_probability(estimate: &Estimate, compensated: bool, wavelength_m: f64) -> Option<f64> {
    let tuning = TUNING.quick_probability;
    let coefficients = [tuning.per_coherence, tuning.per_ratio, tuning.per_aperture, tuning.compensated];
    let features = quick_features(estimate, compensated, wavelength_m);
    estimate.mirror_rad.is_none().then(|| logistic(tuning.base, coefficients, features, tuning.limits))
}

fn logistic(base: f64, coefficients: [f64; 4], features: [f64; 4], limits: [f64; 2]) -> f64 {
    let logit = coefficients.iter().zip(features).fold(base, |sum, (coefficient, x)| sum + coefficient * x);
    (1.0 / (1.0 + (-logit).exp())).clamp(limits[0], limits[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probabilities_stay_within_what_the_data_support() {
        let at = |x: f64| logistic(0.0, [1.0, 0.0, 0.0, 0.0], [x, 0.0, 0.0, 0.0], [0.02, 0.98]);
        assert_eq!([at(-99.0), at(0.0), at(99.0)], [0.02, 0.5, 0.98]);
    }
}
