//! How sure a bearing is: the probability that it is within five degrees of the truth.
//!
//! A logistic model of four things that can be read off a search: how much of the signal the answer explains in all
//! views (log of the joint power), how close the next answer comes (log of the ratio of evidence), how far the views would
//! disagree if each were asked alone (log of the largest difference of azimuths), and whether the answer is physically
//! plausible (inside of what was searched, not at its edge). The coefficients were fitted with the ratio of powers instead
//! of evidence. See `docs/accuracy.md` for the data it was fitted to, how
//! it does on places and rooms that it was not fitted to, and how the share of hard links in that data was brought to
//! that of the whole data set.

use crate::place::near_field::Fix;

/// Intercept.
const BASE: f64 = 2.3;
/// Per unit of `ln(joint power)`.
const PER_POWER: f64 = 0.15;
/// Per unit of `ln(next / highest)`.
const PER_RATIO: f64 = -0.45;
/// For an answer at the edge of what was searched.
const AT_EDGE: f64 = -0.55;
/// Per unit of `ln(degrees between the views)`.
const PER_SPREAD: f64 = -0.8;
/// Views that differ by less agree, degrees; by more they say the same: nothing.
const SPREAD_DEG: (f64, f64) = (1.0, 90.0);
/// The ratio that stands for no other answer at all: below it none is looked for.
const NO_OTHER: f64 = 0.3;
/// No claim goes beyond what some tens of independent places can support.
const LIMITS: (f64, f64) = (0.02, 0.98);

/// Probability that the azimuth of `fix` is within five degrees of the truth.
#[must_use]
pub fn confidence(fix: &Fix) -> f64 {
    let best = fix.best();
    let ratio = fix.sources.get(1).map_or(NO_OTHER, |other| (other.evidence / best.evidence).clamp(NO_OTHER, 1.0));
    let edge = if fix.at_edge() { AT_EDGE } else { 0.0 };
    let spread = fix.view_spread_rad().to_degrees().clamp(SPREAD_DEG.0, SPREAD_DEG.1);
    let logit = BASE + PER_POWER * best.power.max(1e-6).ln() + PER_RATIO * ratio.ln() + PER_SPREAD * spread.ln() + edge;
    (1.0 / (1.0 + (-logit).exp())).clamp(LIMITS.0, LIMITS.1)
}
