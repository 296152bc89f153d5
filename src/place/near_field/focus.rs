//! Odometry that drifts: a scale and a turn of the heading per metre driven, found from how sharp the answers of all
//! transmitters get.
//!
//! A rotation of the whole trajectory cannot be seen this way (it turns all bearings alike); a wrong scale and a bending
//! path can, because no place explains the phases of all samples then. Sharper answers alone prove nothing: two
//! parameters more always fit a little better, so the gain has to exceed what they explain.

use super::fix::Fix;
use super::search::Search;
use nalgebra::Vector3;

/// How a trajectory is changed.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Warp {
    /// Metres driven per metre reported.
    pub scale: f64,
    /// Turn of the heading that was not reported, radians per metre driven, counter-clockwise.
    pub turn_rad_per_m: f64,
}

impl Default for Warp {
    fn default() -> Self {
        Self { scale: 1.0, turn_rad_per_m: 0.0 }
    }
}

impl Warp {
    /// Points of a path after the change: in its middle the heading is right, and the mean stays where it was.
    #[must_use]
    pub fn applied(&self, path_m: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        if *self == Self::default() || path_m.is_empty() {
            return path_m.to_vec();
        }
        let step = |pair: &[Vector3<f64>]| pair[1] - pair[0];
        let half_m = path_m.windows(2).map(|pair| step(pair).norm()).sum::<f64>() / 2.0;
        let (mut at, mut driven_m) = (path_m[0], 0.0);
        let mut warped = vec![at];
        for pair in path_m.windows(2) {
            let step = step(pair);
            let angle = self.turn_rad_per_m * (driven_m + 0.5 * step.norm() - half_m);
            let (sin, cos) = angle.sin_cos();
            at += Vector3::new(cos * step.x - sin * step.y, sin * step.x + cos * step.y, step.z) * self.scale;
            driven_m += step.norm();
            warped.push(at);
        }
        let mean = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / points.len() as f64;
        let shift = mean(path_m) - mean(&warped);
        warped.iter().map(|p| p + shift).collect()
    }
}

/// What the odometry was found to lack.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Focus {
    /// The change that makes the answers sharpest.
    pub warp: Warp,
    /// By how much: the sum of `ln power` over all links.
    pub gain: f64,
    /// Whether that is more than its parameters explain, and the change was made.
    pub worthwhile: bool,
}

/// Scales that are tried.
const SCALES: [f64; 4] = [0.95, 0.975, 1.025, 1.05];
/// Turns that are tried, radians per metre: 6 and 12 degrees.
const TURNS: [f64; 4] = [-0.2, -0.1, 0.1, 0.2];
/// Answers of each link that are followed: which of them is right may change.
const FOLLOWED: usize = 2;
/// Independent looks that a motion gives: the blocks in which the one-way channel is summed.
const LOOKS: f64 = 8.0;
/// Parameters that are fitted; each explains half a unit of log-likelihood by chance, and Akaike's criterion asks for one.
const PARAMETERS: f64 = 2.0;

/// Looks for the change of the common trajectory that makes the answers of all `links` (each with what was found
/// without any) sharpest. The searches are left bent by it if it is worthwhile, and as recorded if not.
#[must_use]
pub fn focus(links: &mut [(&mut Search, &Fix)]) -> Focus {
    let mut score = |warp: &Warp| -> f64 {
        let own = |(search, fix): &mut (&mut Search, &Fix)| {
            search.bend(warp);
            search.score_near(&fix.sources[..fix.sources.len().min(FOLLOWED)])
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
    for scale in SCALES {
        consider(Warp { scale, ..Warp::default() }, &mut best);
    }
    let scale = best.0.scale;
    for turn_rad_per_m in TURNS {
        consider(Warp { scale, turn_rad_per_m }, &mut best);
    }
    let gain = best.1 - without;
    let worthwhile = gain * LOOKS > PARAMETERS;
    let last = if worthwhile { best.0 } else { Warp::default() };
    links.iter_mut().for_each(|(search, _)| search.bend(&last));
    Focus { warp: best.0, gain, worthwhile }
}
