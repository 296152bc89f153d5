//! Odometry that drifts: a scale and a turn of the heading per metre driven, found by maximising the joint power of the answers
//! of all transmitters.
//!
//! A rotation of the whole trajectory cannot be seen this way (it turns all bearings alike); a wrong scale and a bending
//! path can, because no place explains the phases of all samples then. Two
//! more parameters always raise the power, so the gain has to exceed what they explain by chance (\[akaike1974\] in
//! docs/references.md).

use super::fix::Fix;
use super::search::Search;
use super::types::Warp;
use crate::tuning::TUNING;

/// The change of the odometry that was found.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct Focus {
    /// The change that makes the answers sharpest.
    pub warp: Warp,
    /// By how much: the sum of `ln power` over all links.
    pub gain: f64,
    /// Whether that is more than its parameters explain, and the change was made.
    pub worthwhile: bool,
}

/// Looks for the change of the common trajectory that makes the answers of all `links` (each with what was found
/// without any) sharpest. The searches are left bent by it if it is worthwhile, and as recorded if not.
#[must_use]
pub fn focus(links: &mut [(&mut Search, &Fix)]) -> Focus {
    let mut score = |warp: &Warp| -> f64 {
        let own = |(search, fix): &mut (&mut Search, &Fix)| {
            search.warp(warp);
            search.score_near(&fix.sources[..fix.sources.len().min(TUNING.focus.followed)])
        };
        links.iter_mut().map(own).sum()
    };
    let without = score(&Warp::default());
    let mut best = (Warp::default(), without);
    let mut consider = |warp: Warp, best: &mut (Warp, f64)| {
        let own = score(&warp);
        if own > best.1 {
            *best = (warp, own);
        }
    };
    for scale in TUNING.focus.scales {
        consider(Warp { scale, ..Warp::default() }, &mut best);
    }
    let scale = best.0.scale;
    for turn_rad_per_m in TUNING.focus.turns_rad_per_m {
        consider(Warp { scale, turn_rad_per_m }, &mut best);
    }
    let gain = best.1 - without;
    let worthwhile = gain * TUNING.focus.looks > TUNING.focus.parameters;
    let last = if worthwhile { best.0 } else { Warp::default() };
    links.iter_mut().for_each(|(search, _)| search.warp(&last));
    Focus { warp: best.0, gain, worthwhile }
}
