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
use rayon::prelude::*;

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
/// without any) sharpest, on all threads of the current rayon pool if it may be `parallel`. The searches are left bent by it
/// if it is worthwhile, and as recorded if not.
#[must_use]
pub fn focus(links: &mut [(&mut Search, &Fix)], parallel: bool) -> Focus {
    let scales = TUNING.focus.scales.map(|scale| Warp { scale, ..Warp::default() });
    let first: Vec<Warp> = std::iter::once(Warp::default()).chain(scales).collect();
    let scored = scores(links, &first, parallel);
    let without = scored[0];
    let higher = |best: (Warp, f64), own: (&Warp, f64)| if own.1 > best.1 { (*own.0, own.1) } else { best };
    let best = first.iter().zip(scored).fold((Warp::default(), without), higher);
    let turns = TUNING.focus.turns_rad_per_m.map(|turn_rad_per_m| Warp { turn_rad_per_m, ..best.0 });
    let best = turns.iter().zip(scores(links, &turns, parallel)).fold(best, higher);
    let gain = best.1 - without;
    let worthwhile = gain * TUNING.focus.looks > TUNING.focus.parameters;
    if worthwhile {
        links.iter_mut().for_each(|(search, _)| search.warp(&best.0));
    }
    Focus { warp: best.0, gain, worthwhile }
}

/// How sharp each of `warps` makes the answers of all links: the sum of `ln power`.
fn scores(links: &mut [(&mut Search, &Fix)], warps: &[Warp], parallel: bool) -> Vec<f64> {
    let each: Vec<(&Warp, usize)> =
        warps.iter().flat_map(|warp| (0..links.len()).map(move |link| (warp, link))).collect();
    let own = |&(warp, link): &(&Warp, usize)| {
        let (search, fix) = &links[link];
        search.score_near(warp, &fix.sources[..fix.sources.len().min(TUNING.focus.followed)])
    };
    let scored: Vec<(f64, usize)> = match parallel {
        true => each.par_iter().map(own).collect(),
        false => each.iter().map(own).collect(),
    };
    for ((_, link), (_, evaluations)) in each.iter().zip(&scored) {
        links[*link].0.evaluations += evaluations;
    }
    scored.chunks(links.len().max(1)).map(|own| own.iter().map(|(score, _)| score).sum()).collect()
}
