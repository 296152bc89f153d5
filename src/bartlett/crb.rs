//! The Cramer-Rao bound of a bearing \[stoica-nehorai1989\], from the geometry and an estimated signal-to-noise ratio.
//!
//! The model is `z_t = A exp(j 2 pi q_t . u) + n_t` with an unknown complex `A` and white complex noise of variance
//! `sigma^2 / w_t`. The Fisher information of a direction coordinate is then `2 |A|^2 / sigma^2` times the weighted,
//! centred second moment of the phase's derivative; for one coordinate and unit weights that is
//! `sd^2 = 1 / (2 g kappa^2 sum ((p_t - mean) . u_perp)^2)`. Samples that are products of a forward and a backward
//! channel have the signal-to-noise ratio `g / (2 + 1/g)` of the product, which is what is estimated here.

use std::f64::consts::{PI, TAU};

use super::newton::{Bend, Point, Second};
use super::scene::Scene;

/// No bearing is worse than a uniform guess over the circle: pi / sqrt(3).
const SD_MAX: f64 = PI / 1.732_050_807_568_877_2;

/// What a fit of one plane wave leaves.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fit {
    /// `|A|^2 / sigma^2` for unit (scaled) weight.
    ratio: f64,
    /// The same for a sample of mean weight: the signal-to-noise ratio.
    pub snr: f64,
}

impl Fit {
    /// From `F = |f|^2` at the estimate. The amplitude is relieved of the noise's own share.
    pub fn new(scene: &Scene, value: f64) -> Self {
        let used = scene.weight.iter().filter(|w| **w > 0.0).count() as f64;
        let w = scene.weight_sum;
        let residual = (scene.energy - value / w).max(0.0);
        // One complex amplitude and two angles are fitted: two complex degrees of freedom.
        let variance = if used > 2.0 { residual / (used - 2.0) } else { f64::INFINITY };
        let amplitude = (value / (w * w) - variance / w).max(0.0);
        let ratio = if variance == f64::INFINITY { 0.0 } else { amplitude / variance };
        Self { ratio, snr: ratio * w / used }
    }
}

/// Weighted, centred second moments of the positions about an azimuth, turns squared: hh, hv, vv, hz, vz, zz.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Spread([f64; 6]);

impl Spread {
    pub fn new(scene: &Scene, azimuth: f64) -> Self {
        let [xx, xy, yy, xz, yz, zz] = scene.weighted_scatter();
        let (s, c) = azimuth.sin_cos();
        // h = c x + s y, v = c y - s x.
        Self([
            c * c * xx + 2.0 * c * s * xy + s * s * yy,
            c * s * (yy - xx) + (c * c - s * s) * xy,
            s * s * xx - 2.0 * c * s * xy + c * c * yy,
            c * xz + s * yz,
            c * yz - s * xz,
            zz,
        ])
    }
}

/// Standard deviations of azimuth and of the second coordinate, each with the other as a nuisance.
///
/// With `second_known` the azimuth stands alone (and the second deviation is infinite); along the motion it is known by the
/// square of its change. Nothing exceeds a uniform guess for the azimuth.
pub(crate) fn deviations(fit: Fit, spread: Spread, kind: Second, at: Point, second_known: bool) -> [f64; 2] {
    let gain = 2.0 * fit.ratio * TAU * TAU;
    let [aa, ab, bb] = information(spread, kind, at);
    let det = aa * bb - ab * ab;
    let sd = |information: f64| if information > 0.0 { (1.0 / information).sqrt() } else { f64::INFINITY };
    if second_known {
        // Towards or away from the motion phases do not change with the azimuth to first order, and by half of its square to
        // second: then that square is what is known.
        let [s, ..] = kind.bend(at.second).s;
        let by_square = (2.0 * sd(gain * s * s * spread.0[0])).sqrt();
        return [sd(gain * aa).min(by_square).min(SD_MAX), f64::INFINITY];
    }
    // A determinant of the size of rounding errors: the two coordinates have the same effect on the phases.
    if det <= 1e-13 * aa * bb {
        return [SD_MAX, f64::INFINITY];
    }
    [sd(gain * det / bb).min(SD_MAX), sd(gain * det / aa)]
}

/// How far the phases that a change of azimuth makes differ from those that a change of the second coordinate makes:
/// `1 - r^2` of their correlation over the trajectory, 0 (the same, as on a line) to 1 (a circle).
pub(crate) fn independence(spread: Spread, kind: Second, at: Point) -> f64 {
    let [aa, ab, bb] = information(spread, kind, at);
    if aa * bb > 0.0 { (1.0 - ab * ab / (aa * bb)).max(0.0) } else { 0.0 }
}

/// Information on azimuth, on both, and on the second coordinate, but for a common factor.
fn information(spread: Spread, kind: Second, at: Point) -> [f64; 3] {
    let Bend { s: [s, ds, _], height: [_, dh, _] } = kind.bend(at.second);
    let [hh, hv, vv, hz, vz, zz] = spread.0;
    [s * s * vv, s * (ds * hv + dh * vz), ds * ds * hh + 2.0 * ds * dh * hz + dh * dh * zz]
}

/// Standard deviation of |elevation|, radians, from that of its cosine.
///
/// Near the horizon the cosine is flat: an error `d` of it is an elevation of `sqrt(2 d)`.
pub(crate) fn elevation_deviation(elevation: f64, cosine_sd: f64) -> f64 {
    let sin = elevation.sin();
    (cosine_sd / (sin * sin + 2.0 * cosine_sd).sqrt()).min(PI / 2.0)
}
