//! How sure an azimuth is: the calibrated probability that it is within five degrees of the truth, and an error bar.
//!
//! Both are models of the same features, one set for answers of a near-field search ([`full_features`]) and one for
//! bearings by a plane wave at the channel centre ([`quick_features`]): they fail in different ways and show different
//! things.
//!
//! * probability: `1 / (1 + exp(-(base + sum coefficient x feature + per_heading x ln(1 + heading / 5 deg))))`;
//! * error bar: `sqrt(exp(base + sum coefficient x feature)^2 + heading^2)`, at least the Cramer-Rao bound, which knows
//!   noise alone, and at most that of a uniform guess. 68 % of errors are meant to be within it and 95 % within twice.
//!
//! `heading` is the standard deviation of the heading of the whole trajectory, a figure of the sensor: a trajectory that is
//! turned as a whole leaves no trace in any phase. `docs/tuning.md` has the data that both were fitted to and how they do
//! on places that they were not fitted to; the example `fit_confidence` of `csi5300-lab` fits them again.

use crate::bartlett::Estimate;
use crate::maths::{median, wrap_rad};
use crate::place::near_field::Fix;
use crate::tuning::TUNING;

/// Standard deviation of an azimuth of which nothing is known, radians.
pub(crate) const UNIFORM_RAD: f64 = 1.813_799_364_234_217_8;

/// Least and largest probability that is said.
#[must_use]
pub fn probability_limits() -> [f64; 2] {
    TUNING.certainty.limits
}

/// Standard deviation of the heading of a tracking camera's trajectory, radians.
#[must_use]
pub fn camera_heading_rad() -> f64 {
    TUNING.certainty.camera_heading_deg.to_radians()
}

/// The same of one held to what wheels can roll ([`crate::motion::rolling`]).
#[must_use]
pub fn rolling_camera_heading_rad() -> f64 {
    TUNING.certainty.rolling_camera_heading_deg.to_radians()
}

/// The same of wheel odometry where the place of the antenna on the robot is known.
#[must_use]
pub fn wheels_heading_rad() -> f64 {
    TUNING.certainty.wheels_heading_deg.to_radians()
}

/// The same of wheel odometry where it is not.
#[must_use]
pub fn unmounted_heading_rad() -> f64 {
    TUNING.certainty.unmounted_heading_deg.to_radians()
}

/// What each of the directions that were chosen from has of the probability, as the model of the search has it: powers
/// (or evidence) to the number of independent looks, with a sum of 1.
#[must_use]
pub(crate) fn shares(evidence: impl Iterator<Item = f64>) -> Vec<f64> {
    let looks = TUNING.certainty.looks;
    let powers: Vec<f64> = evidence.map(|own| own.max(1e-12).powf(looks)).collect();
    let total: f64 = powers.iter().sum();
    powers.into_iter().map(|own| if total > 0.0 { own / total } else { 0.0 }).collect()
}

/// Features of an answer of the near field: ln of the spread of all candidates about the answer (root mean square, each
/// with its share), and ln of how far the views by themselves are from it (median), both of degrees. Where the motion hides
/// a mirror what is on the mirror's side counts from the mirror.
#[must_use]
pub fn full_features(fix: &Fix, mirror_rad: Option<f64>) -> [f64; 2] {
    let tuning = TUNING.certainty;
    let off_deg = |azimuth_rad: f64| {
        let off = |from_rad: f64| wrap_rad(azimuth_rad - from_rad).abs();
        mirror_rad.map_or(off(fix.azimuth_rad), |mirror| off(mirror).min(off(fix.azimuth_rad))).to_degrees()
    };
    let shares = shares(fix.sources.iter().map(|source| source.evidence));
    let square: f64 =
        fix.sources.iter().zip(shares).map(|(source, share)| share * off_deg(source.azimuth_rad).powi(2)).sum();
    let mut views: Vec<f64> = fix.view_azimuths_rad.iter().map(|azimuth| off_deg(*azimuth)).collect();
    let views_deg = median(&mut views).unwrap_or(tuning.views_deg[1]);
    [
        square.sqrt().clamp(tuning.spread_deg[0], tuning.spread_deg[1]).ln(),
        views_deg.clamp(tuning.views_deg[0], tuning.views_deg[1]).ln(),
    ]
}

/// Probability that the azimuth of `fix` is within five degrees of the truth. Where the motion hides a mirror it is that of
/// the azimuth or the mirror, less the mirror's share of the evidence (`mirror`: its azimuth, radians, and that share).
#[must_use]
pub fn full_probability(fix: &Fix, mirror: Option<(f64, f64)>, heading_sd_rad: f64) -> f64 {
    let tuning = TUNING.full_probability;
    let features = full_features(fix, mirror.map(|(azimuth_rad, _)| azimuth_rad));
    let logit = linear(tuning.base, [tuning.per_spread, tuning.per_views], features);
    let either = probability(logit + tuning.per_heading * heading_feature(heading_sd_rad));
    let either = either.min(within_by_noise(fix.deviations.azimuth_rad));
    either * (1.0 - mirror.map_or(0.0, |(azimuth_rad, share)| share * apart(wrap_rad(azimuth_rad - fix.azimuth_rad))))
}

/// What the wrong one of two directions costs that are `by_rad` apart: nothing where an azimuth that is right for one is within
/// five degrees of the other, all from ten degrees on.
fn apart(by_rad: f64) -> f64 {
    (by_rad.abs().to_degrees() / 5.0 - 1.0).clamp(0.0, 1.0)
}

/// Probability that a normal error with this deviation is less than five degrees: no bearing is surer than its bound allows.
pub(crate) fn within_by_noise(bound_rad: f64) -> f64 {
    let times = 5f64.to_radians() / bound_rad;
    // 2 Phi(x) - 1 by the logistic curve that is nearest to Phi, within 0.02.
    if times.is_finite() { 2.0 / (1.0 + (-1.702 * times).exp()) - 1.0 } else { 1.0 }
}

/// Error bar of the azimuth of `fix`, radians; of a motion that hides a mirror it is that of the bearing on its own side.
#[must_use]
pub fn full_deviation_rad(fix: &Fix, mirror_rad: Option<f64>, heading_sd_rad: f64) -> f64 {
    let tuning = TUNING.full_error_bar;
    let ln_deg = linear(tuning.base, [tuning.per_spread, tuning.per_views], full_features(fix, mirror_rad));
    deviation_rad(ln_deg, heading_sd_rad, fix.deviations.azimuth_rad)
}

/// Features of a bearing by a plane wave: ln of the coherence, ln of the second highest peak over the highest, ln of the
/// aperture's longest side in wavelengths (clamped to what the fit has seen), and whether the turn-around was compensated
/// (0 or 1).
#[must_use]
pub fn quick_features(estimate: &Estimate, compensated: bool, wavelength_m: f64) -> [f64; 4] {
    let tuning = TUNING.quick_probability;
    let ratio = estimate.peak_ratio.map_or(tuning.no_other, |ratio| ratio.clamp(tuning.no_other, 1.0));
    let [least, most] = tuning.aperture_wavelengths;
    let aperture = (2.0 * estimate.shape.half_extent_m[0] / wavelength_m).clamp(least, most);
    [estimate.coherence.max(1e-3).ln(), ratio.ln(), aperture.ln(), if compensated { 1.0 } else { 0.0 }]
}

/// Probability that the azimuth of a bearing by a plane wave with these features is within five degrees of the truth. It
/// does not hold where the motion is along a line, whose mirror is as likely.
#[must_use]
pub fn quick_probability(features: [f64; 4], heading_sd_rad: f64) -> f64 {
    let tuning = TUNING.quick_probability;
    let coefficients = [tuning.per_coherence, tuning.per_ratio, tuning.per_aperture, tuning.compensated];
    probability(linear(tuning.base, coefficients, features) + tuning.per_heading * heading_feature(heading_sd_rad))
}

/// Error bar of the azimuth of a bearing by a plane wave with these features, radians; `bound_rad` is its Cramer-Rao bound.
/// Of a motion along a line it is that of the bearing on its own side.
#[must_use]
pub fn quick_deviation_rad(features: [f64; 4], heading_sd_rad: f64, bound_rad: f64) -> f64 {
    let tuning = TUNING.quick_error_bar;
    let coefficients = [tuning.per_coherence, tuning.per_ratio, tuning.per_aperture, tuning.compensated];
    deviation_rad(linear(tuning.base, coefficients, features), heading_sd_rad, bound_rad)
}

/// What a probability sees of the trajectory's heading.
#[must_use]
pub fn heading_feature(heading_sd_rad: f64) -> f64 {
    (heading_sd_rad / 5f64.to_radians()).ln_1p()
}

fn linear<const N: usize>(base: f64, coefficients: [f64; N], features: [f64; N]) -> f64 {
    coefficients.iter().zip(features).fold(base, |sum, (coefficient, x)| sum + coefficient * x)
}

fn probability(logit: f64) -> f64 {
    let [least, most] = TUNING.certainty.limits;
    (1.0 / (1.0 + (-logit).exp())).clamp(least, most)
}

fn deviation_rad(ln_deg: f64, heading_sd_rad: f64, bound_rad: f64) -> f64 {
    let own_rad = ln_deg.exp().to_radians().hypot(heading_sd_rad);
    // A bound that is not a number (no samples to speak of) says nothing.
    if bound_rad.is_finite() { own_rad.max(bound_rad).min(UNIFORM_RAD) } else { UNIFORM_RAD }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probabilities_stay_within_what_the_data_support() {
        assert_eq!([probability(-99.0), probability(0.0), probability(99.0)], [0.02, 0.5, 0.98]);
    }

    #[test]
    fn error_bars_lie_between_the_bound_and_a_uniform_guess() {
        let degree = 1f64.to_radians();
        assert!((deviation_rad(0.0, 0.0, 0.1 * degree) - degree).abs() < 1e-12);
        assert!((deviation_rad(3f64.ln(), 4.0 * degree, 0.1 * degree) - 5.0 * degree).abs() < 1e-12);
        assert_eq!(deviation_rad(0.0, 0.0, 0.2), 0.2);
        assert_eq!([deviation_rad(99.0, 0.0, 0.1), deviation_rad(0.0, 0.0, f64::NAN)], [UNIFORM_RAD; 2]);
        assert!((UNIFORM_RAD - std::f64::consts::PI / 3f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn shares_are_those_of_independent_looks() {
        let own = shares([0.5, 0.5, 0.25].into_iter());
        assert!((own.iter().sum::<f64>() - 1.0).abs() < 1e-12 && own[0] == own[1]);
        assert!((own[2] / own[0] - 0.5f64.powf(TUNING.certainty.looks)).abs() < 1e-12, "{own:?}");
        assert!(shares(std::iter::empty()).is_empty());
    }

    #[test]
    fn a_heading_that_is_not_known_makes_bearings_less_sure() {
        let features = [-0.5, -0.7, 2.0, 1.0];
        let known = (quick_probability(features, 0.0), quick_deviation_rad(features, 0.0, 0.0));
        let turned = (quick_probability(features, 0.1), quick_deviation_rad(features, 0.1, 0.0));
        assert!(turned.0 < known.0 && turned.1 > known.1.max(0.1), "{known:?} {turned:?}");
    }
}
