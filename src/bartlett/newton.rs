//! The exact profile near a direction, in double: its derivatives, Newton's method from a sampled candidate to the local maximum, and
//! the deviations to be expected there.
//!
//! # Deviations
//! The Cramer-Rao bound of a bearing \[stoica-nehorai1989\], from the geometry and an estimated signal-to-noise ratio.
//!
//! The model is `z_t = A exp(j 2 pi q_t . u) + n_t` with an unknown complex `A` and white complex noise of variance
//! `sigma^2 / w_t`. The Fisher information of a direction coordinate is then `2 |A|^2 / sigma^2` times the weighted,
//! centred second moment of the phase's derivative; for one coordinate and unit weights that is
//! `sd^2 = 1 / (2 g kappa^2 sum ((p_t - mean) . u_perp)^2)`. Samples that are products of a forward and a backward
//! channel have the signal-to-noise ratio `g / (2 + 1/g)` of the product, which is what is estimated here.

use super::scene::Scene;
use csi5300_kernels::sums::{Aim, Columns, Wanted, moments};
use fearless_simd::Level;
use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// The second coordinate of a search; its meaning depends on the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Second {
    /// Level motion sees the cosine of the elevation and nothing else of it.
    Cosine,
    /// Any other motion sees the elevation.
    Elevation,
}

/// A direction: azimuth (radians) and the second coordinate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Point {
    pub azimuth: f64,
    pub second: f64,
}

/// A profile `F = |f|^2` with its search region in the second coordinate.
#[derive(Clone, Copy)]
pub(crate) struct Hill<'a> {
    pub level: Level,
    pub samples: Columns<'a, f64>,
    pub kind: Second,
    pub low: f64,
    pub high: f64,
    /// Trust region: largest steps in azimuth and in the second coordinate.
    pub reach: [f64; 2],
}

/// A local maximum.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Top {
    pub at: Point,
    pub value: f64,
    pub evaluations: usize,
}

/// `F`, its gradient and its Hessian (aa, ab, bb).
#[derive(Clone, Copy, Debug)]
struct Local {
    value: f64,
    gradient: [f64; 2],
    hessian: [f64; 3],
}

impl Local {
    /// How much `F` rises along a small step, to second order.
    fn rise(&self, step: [f64; 2]) -> f64 {
        let ([a, b], [aa, ab, bb]) = (step, self.hessian);
        self.gradient[0] * a + self.gradient[1] * b + 0.5 * (aa * a * a + 2.0 * ab * a * b + bb * b * b)
    }
}

/// How the direction depends on the second coordinate: `s` and height, their first and second derivatives.
struct Bend {
    s: [f64; 3],
    height: [f64; 3],
}

impl Second {
    fn bend(self, b: f64) -> Bend {
        match self {
            Self::Cosine => Bend { s: [b, 1.0, 0.0], height: [0.0; 3] },
            Self::Elevation => {
                let (sin, cos) = b.sin_cos();
                Bend { s: [cos, -sin, -cos], height: [sin, cos, -sin] }
            }
        }
    }

    pub fn elevation(self, b: f64) -> f64 {
        match self {
            Self::Cosine => b.clamp(-1.0, 1.0).acos(),
            Self::Elevation => b,
        }
    }

    pub fn of_elevation(self, elevation: f64) -> f64 {
        match self {
            Self::Cosine => elevation.cos(),
            Self::Elevation => elevation,
        }
    }
}

/// Steps this small, in units of the reach, are taken without another look: the value there follows from the derivatives
/// here to `(2 M step)^3 / 6`, below 2e-12 for the `6 M` samples that make the reach.
const NEAR: f64 = 1e-4;

impl Hill<'_> {
    /// True if the second coordinate is fixed: derivatives by it are then not computed.
    fn is_ring(&self) -> bool {
        self.low >= self.high
    }

    /// Value and derivatives at a point, from the moments of the samples.
    fn local(&self, at: Point) -> Local {
        let Bend { s: [s, ds, dds], height: [height, dh, ddh] } = self.kind.bend(at.second);
        let (sin, cos) = at.azimuth.sin_cos();
        let wanted = if self.is_ring() { Wanted::Azimuth } else { Wanted::Both };
        let m = moments(self.level, self.samples, Aim { cos, sin, s, height }, wanted);
        let j = Complex64::i();
        // With theta = 2 pi (s h + height z): dh/da = v, dv/da = -h.
        let fa = -j * TAU * s * m.v;
        let fb = -j * TAU * (m.h * ds + m.z * dh);
        let faa = j * TAU * s * m.h - TAU * TAU * s * s * m.vv;
        let fab = -j * TAU * ds * m.v - TAU * TAU * s * (m.hv * ds + m.vz * dh);
        let fbb = -j * TAU * (m.h * dds + m.z * ddh)
            - TAU * TAU * (m.hh * (ds * ds) + m.hz * (2.0 * ds * dh) + m.zz * (dh * dh));
        let with = |g: Complex64| 2.0 * (m.one.conj() * g).re;
        let cross = |g: Complex64, h: Complex64| 2.0 * (g.conj() * h).re;
        Local {
            value: m.one.norm_sqr(),
            gradient: [with(fa), with(fb)],
            hessian: [with(faa) + cross(fa, fa), with(fab) + cross(fa, fb), with(fbb) + cross(fb, fb)],
        }
    }

    /// The value at a point.
    pub fn value(&self, at: Point) -> f64 {
        self.local(at).value
    }

    /// Climbs from `start` to the local maximum of its hill.
    pub fn climb(&self, start: Point) -> Top {
        let mut at = Point { azimuth: start.azimuth, second: start.second.clamp(self.low, self.high) };
        let mut here = self.local(at);
        let mut evaluations = 1;
        for _ in 0..40 {
            let mut step = self.step(at, &here);
            if (0..2).all(|i| step[i].abs() <= NEAR * self.reach[i]) && here.hessian[0] < 0.0 {
                let second = (at.second + step[1]).clamp(self.low, self.high);
                here.value += here.rise([step[0], second - at.second]).max(0.0);
                at = Point { azimuth: at.azimuth + step[0], second };
                break;
            }
            let mut moved = false;
            for _ in 0..12 {
                let to =
                    Point { azimuth: at.azimuth + step[0], second: (at.second + step[1]).clamp(self.low, self.high) };
                let there = self.local(to);
                evaluations += 1;
                if there.value >= here.value {
                    (at, here, moved) = (to, there, true);
                    break;
                }
                if step[0].abs() < 1e-9 && step[1].abs() < 1e-9 {
                    break;
                }
                step = step.map(|d| d / 4.0);
            }
            if !moved || (step[0].abs() < 1e-8 && step[1].abs() < 1e-8) {
                break;
            }
        }
        Top { at, value: here.value, evaluations }
    }

    /// A Newton step where the hill is concave, else a step along the gradient; within reach, and along the edge
    /// where the gradient points out of the region.
    fn step(&self, at: Point, local: &Local) -> [f64; 2] {
        let [ga, gb] = local.gradient;
        let [haa, hab, hbb] = local.hessian;
        let at_edge = (at.second <= self.low && gb <= 0.0) || (at.second >= self.high && gb >= 0.0);
        let [ra, rb] = self.reach;
        let fallback = |g: f64, h: f64, r: f64| if h < 0.0 { (-g / h).clamp(-r, r) } else { r.copysign(g) };
        if at_edge || self.is_ring() {
            return [fallback(ga, haa, ra), 0.0];
        }
        let det = haa * hbb - hab * hab;
        if haa < 0.0 && det > 0.0 {
            let step = [(hab * gb - hbb * ga) / det, (hab * ga - haa * gb) / det];
            let shrink = (ra / step[0].abs()).min(rb / step[1].abs()).min(1.0);
            return step.map(|d| d * shrink);
        }
        // Along the gradient of the profile in units of the reach, as far as the reach.
        let (na, nb) = (ga * ra, gb * rb);
        let norm = na.hypot(nb);
        if norm == 0.0 { [0.0; 2] } else { [ra * na / norm, rb * nb / norm] }
    }
}

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

/// Standard deviations of azimuth and of the second coordinate, each with the other as a nuisance: the Cramer-Rao bound.
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
