//! Newton's method on the exact profile, in double, from a sampled candidate to its local maximum.

use std::f64::consts::TAU;

use fearless_simd::Level;
use num_complex::Complex64;

use csi5300_kernels::sums::{Aim, Columns, Wanted, moments};

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
pub(crate) struct Local {
    pub value: f64,
    pub gradient: [f64; 2],
    pub hessian: [f64; 3],
}

impl Local {
    /// How much `F` rises along a small step, to second order.
    fn rise(&self, step: [f64; 2]) -> f64 {
        let ([a, b], [aa, ab, bb]) = (step, self.hessian);
        self.gradient[0] * a + self.gradient[1] * b + 0.5 * (aa * a * a + 2.0 * ab * a * b + bb * b * b)
    }
}

/// How the direction depends on the second coordinate: `s` and height, their first and second derivatives.
pub(crate) struct Bend {
    pub s: [f64; 3],
    pub height: [f64; 3],
}

impl Second {
    pub fn bend(self, b: f64) -> Bend {
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
    pub fn local(&self, at: Point) -> Local {
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
