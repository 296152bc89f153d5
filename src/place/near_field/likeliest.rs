//! The most likely place next to one that was climbed to, if noise is all that a single spherical wave leaves: least squares of
//! the residual phases. Azimuth, elevation and range of a short arc follow each other along a ridge too narrow and flat for a
//! climb by the joint power, and the least residual may lie where no place is: below the horizon of level motion, or beyond infinity.

use super::types::Free;
use super::uncertainty::correlation_rows;
use super::waves::Waves;
use crate::maths::wrap_rad;
use crate::tuning::TUNING;

/// The largest step in elevation, and the elevation below which level motion cannot tell one from the horizon, radians.
const HIGHEST_STEP_RAD: f64 = 0.1;
const HORIZON_RAD: f64 = 1e-3;

/// A place of least residual phase.
#[derive(Clone, Copy, Debug)]
pub(super) struct Settled {
    /// Azimuth, elevation and 1 / range.
    pub place: [f64; 3],
    /// What is free there: a coordinate that would leave its limits at the horizon or at infinity stays there.
    pub free: Free,
}

/// The place of least residual phase next to `start`, on the `waves` of what is free; elevations have a sign if they are
/// `signed`. `None` if the steps lead further than `reach_rad` away in azimuth.
pub(super) fn settled<'a, const K: usize>(
    waves: impl Fn(Free) -> Waves<'a, K>,
    start: [f64; 3],
    mut free: Free,
    signed: bool,
    reach_rad: f64,
) -> Option<Settled> {
    let mut at = start;
    for _ in 0..3 {
        let stepped = stepped(&waves(free), at, reach_rad);
        if stepped.is_none() && free.elevation && !free.range && !signed && at[1].abs() < HORIZON_RAD {
            // On the horizon of level motion no phase changes with the elevation: there is no step that way. (Where the range is
            // open too, the ridge that both make leads elsewhere.)
            (at[1], free.elevation) = (0.0, false);
            continue;
        }
        let (mut place, still) = stepped?;
        if free.elevation && !signed {
            // Level motion has the same phases above and below, and none that tells heights near the horizon apart.
            place[1] = place[1].abs();
            if !still || place[1] < HORIZON_RAD {
                (at[1], free.elevation) = (0.0, false);
                continue;
            }
        }
        if free.range && place[2] < 0.0 {
            (at[2], free.range) = (0.0, false);
            continue;
        }
        return Some(Settled { place, free });
    }
    None
}

/// Gauss's and Newton's steps from `start`, and whether the elevation has come to rest; `None` if they lead away.
fn stepped<const K: usize>(waves: &Waves<'_, K>, start: [f64; 3], reach_rad: f64) -> Option<([f64; 3], bool)> {
    let (mut c, mut last) = (start, 0.0);
    for _ in 0..TUNING.deviations.polishes {
        let step = waves.step(c)?;
        last = step[1].clamp(-HIGHEST_STEP_RAD, HIGHEST_STEP_RAD);
        c = [c[0] + step[0], c[1] + last, c[2] + step[2]];
    }
    let near = wrap_rad(c[0] - start[0]).abs() < reach_rad && c.iter().all(|v| v.is_finite());
    near.then_some((c, last.abs() < HORIZON_RAD))
}

/// The settled place if noise is all that its wave leaves, which is when it is the most likely one. Where reflections leave
/// more, no estimate of one place is, and what all views agreed on stays.
pub(super) fn polished<'a, const K: usize>(
    waves: impl Fn(Free) -> Waves<'a, K>,
    start: [f64; 3],
    free: Free,
    signed: bool,
    cell_rad: f64,
) -> Option<[f64; 3]> {
    let narrow = if signed { start[1].cos() } else { 1.0 };
    let reach_rad = TUNING.deviations.polish_cells * cell_rad / narrow.max(1e-3);
    let settled = settled(&waves, start, free, signed, reach_rad)?;
    let tuning = TUNING.deviations;
    let white = if signed { tuning.white_rows_in_space } else { tuning.white_rows };
    let rows = correlation_rows(&waves(settled.free).residual(settled.place));
    (rows <= white).then_some(settled.place)
}
